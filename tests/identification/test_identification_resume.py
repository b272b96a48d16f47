"""The store of identified blocks: killed and resumed, any number of processes, other campaigns refused."""

import gc
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest

from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError, ProbupdateError
from probupdate.identification import block_store, tracking
from probupdate.identification.classification import PoleStack
from probupdate.identification.identify import SSISettings, identify
from probupdate.identification.reference import ReferenceModes
from probupdate.io import files
from probupdate.modal.modes import CovarianceFactors, StoredFactors
from probupdate.runtime import executors
from probupdate.runtime.executors import iterate_completed
from probupdate.structure.load import REFERENCE_STATES, reference_model

# six channels at two tower levels and one leg: enough for five modes, and quick
ROWS = [0, 1, 14, 15, 16, 17]
MINUTES, N_BLOCK, RATE = 4, 24, 5.0
SETTINGS = {"order": 14, "block_rows": 20, "spread": 4, "sub_records": 10}


def write_hour(folder, structure, sensor_list, *, seed=0, n_block=N_BLOCK, unit="m/s2", minutes=MINUTES):
    """Two files, the second of which begins within a block."""
    lines = [f'name = "Hour"\nsampling_rate_hz = {RATE}\nblock_minutes = {minutes}\n']
    for k in ROWS:
        s = sensor_list[k]
        lines.append(f'[[sensor]]\nchannel = "{s.channel}"\nlevel = "{s.level}"\nposition_m = {s.position_m.tolist()}\n'
                     f'direction = {s.direction.tolist()}\nunit = "{unit}"\n')
    (folder / "acceleration").mkdir(parents=True)
    (folder / "campaign.toml").write_text("".join(lines))
    record = structure.record(round(n_block * MINUTES * 60 * RATE), seed=seed)[:, ROWS].astype(np.float32)
    half = len(record) // 2 + 17
    for k, (piece, offset_s) in enumerate(((record[:half], 0), (record[half:], half / RATE))):
        with h5py.File(folder / "acceleration" / f"{k}.h5", "w") as file:
            data = file.create_dataset("data", data=piece)
            minute, second = divmod(offset_s, 60)
            data.attrs["start"] = f"2019-06-03T{10 + int(minute // 60):02d}:{int(minute % 60):02d}:{second:09.6f}Z"
            data.attrs["sampling_rate_hz"] = RATE
    return folder


@pytest.fixture(scope="module")
def hour(jacket, sensor_list, tmp_path_factory):
    return write_hour(tmp_path_factory.mktemp("hour") / "campaign", jacket, sensor_list)


@pytest.fixture(scope="module")
def rough(jacket) -> ReferenceModes:
    return ReferenceModes(labels=("FA1", "SS1", "T1", "FA2", "SS2"), frequency_hz=jacket.frequency_hz,
                          shape=jacket.shape[ROWS], pairs=((0, 1), (3, 4)))


def run(folder, rough, out, jobs=1, progress=lambda *a: None, **changed):
    campaign = read_campaign(folder)
    result = identify(campaign, rough, settings=SSISettings(**SETTINGS | changed), store=f"{out}.blocks", jobs=jobs,
                      progress=progress)
    return result.write(out)


@pytest.fixture(scope="module")
def undisturbed(hour, rough, tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed") / "modes.json"
    run(hour, rough, out)
    return out


def stored(out) -> dict[str, tuple[int, bytes]]:
    """File of the store -> time of its last change, content."""
    return {p.name: (p.stat().st_mtime_ns, p.read_bytes()) for p in (out.parent / f"{out.name}.blocks").glob("*.npz")}


def same_results(out, other) -> bool:
    names = ("modes.json", "modes.poles.csv", "modes.deviations.h5")
    equal = [(out.parent / name).read_bytes() == (other.parent / name).read_bytes() for name in names]
    return all(equal) and {k: v[1] for k, v in stored(out).items()} == {k: v[1] for k, v in stored(other).items()}


KILLED = """
import json, sys
from probupdate.campaign.reading import read_campaign
from probupdate.runtime import executors
from probupdate.identification.identify import SSISettings, identify
from probupdate.identification.reference import ReferenceModes
import numpy as np
executors.LEAST_TASKS = 1
given = json.loads(sys.argv[1])
rough = ReferenceModes(labels=tuple(given["labels"]), frequency_hz=np.array(given["frequency_hz"]),
                       shape=np.array(given["shape"]), pairs=((0, 1), (3, 4)))
identify(read_campaign(given["campaign"]), rough, settings=SSISettings(**given["settings"]), store=given["store"],
         jobs=2)
"""


def poles_of(content: bytes) -> set[tuple[int, int]]:
    """(model order, index) of the poles whose standard deviations a file holds."""
    with np.load(io.BytesIO(content), allow_pickle=False) as held:
        return {tuple(key) for key in held["key"].tolist()}


def test_a_killed_run_goes_on_with_nothing_lost_and_nothing_done_twice(hour, rough, undisturbed, tmp_path):
    """kill -9 of the parent of two processes once a drawn number of files is there: the processes end too, and the
    next run, in one process, keeps what is there and gives the bytes of an undisturbed one."""
    out = tmp_path / "modes.json"
    store = tmp_path / "modes.json.blocks"
    given = {"labels": rough.labels, "frequency_hz": rough.frequency_hz.tolist(), "shape": rough.shape.tolist(),
             "campaign": str(hour), "settings": SETTINGS, "store": str(store)}
    moment = random.SystemRandom().randrange(1, 2 * N_BLOCK - 4)
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(KILLED), json.dumps(given)],
                             env=os.environ | {"OMP_NUM_THREADS": "1"})
    deadline = time.monotonic() + 120
    while len(list(store.glob("*.npz"))) < moment and child.poll() is None and time.monotonic() < deadline:
        time.sleep(0.002)
    child.send_signal(signal.SIGKILL)
    child.wait()
    # the processes it had started learn of it and end: no further file appears
    for _ in range(100):
        before = {p.name for p in store.iterdir()}
        time.sleep(0.2)
        if {p.name for p in store.iterdir()} == before:
            break
    left = stored(out)
    assert len(left) >= moment, "the run ended before it was killed"
    reports = []
    run(hour, rough, out, progress=lambda *a: reports.append(a))
    assert same_results(out, undisturbed)
    again = stored(out)
    for name, there in left.items():
        # standard deviations of a block grow where a later round chooses another pole; nothing else is written twice
        grown = name.endswith(".deviations.npz") and poles_of(there[1]) < poles_of(again[name][1])
        assert grown or again[name] == there, f"{name} was finished and written again"
    n_poles = sum(name.endswith(".poles.npz") for name in left)
    assert reports[0] == ("identifying blocks", n_poles, N_BLOCK)
    assert len(reports) - 1 >= N_BLOCK - n_poles and not list(store.glob("*.part"))


@pytest.mark.long
def test_the_number_of_processes_changes_nothing(hour, rough, undisturbed, tmp_path, monkeypatch, validation):
    row = validation(what="identification of an hour in three processes (long): bytes of all files and of the store",
                     reference="one process")
    monkeypatch.setattr(executors, "LEAST_TASKS", 8)
    before = dict(os.environ)
    run(hour, rough, tmp_path / "modes.json", jobs=3)
    row.equal(same_results(tmp_path / "modes.json", undisturbed), True)
    assert dict(os.environ) == before


def test_an_interruption_keeps_what_was_finished(hour, rough, undisturbed, tmp_path):
    out = tmp_path / "modes.json"

    def stop(what, done, total):
        if what == "identifying blocks" and done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(hour, rough, out, progress=stop)
    assert len(stored(out)) == 5
    run(hour, rough, out)
    assert same_results(out, undisturbed)


def test_another_classifier_takes_the_stored_poles(hour, rough, undisturbed, tmp_path):
    """Thresholds and model are asked of stored poles: no block is identified again."""
    out = tmp_path / "modes.json"
    run(hour, rough, out)
    before = stored(out)
    campaign, reports = read_campaign(hour), []
    classifier = replace(SSISettings().classifier, plane_mac=0.97)
    strict = identify(campaign, replace(rough, frequency_hz=rough.frequency_hz * 0.95), store=f"{out}.blocks",
                      settings=SSISettings(**SETTINGS, classifier=classifier), progress=lambda *a: reports.append(a))
    after = stored(out)
    poles = [name for name in before if name.endswith(".poles.npz")]
    assert all(after[name] == before[name] for name in poles) and reports[0] == ("identifying blocks", N_BLOCK, N_BLOCK)
    anew = identify(campaign, replace(rough, frequency_hz=rough.frequency_hz * 0.95),
                    settings=SSISettings(**SETTINGS, classifier=classifier))
    for a, b in zip(strict.data.sets, anew.data.sets, strict=True):
        assert a.frequency_hz == pytest.approx(b.frequency_hz, nan_ok=True, rel=1e-12)
        assert a.frequency_std_hz == pytest.approx(b.frequency_std_hz, nan_ok=True, rel=1e-5)


@pytest.fixture
def filled(jacket, sensor_list, rough, tmp_path):
    """A campaign of three blocks and its store."""
    folder = write_hour(tmp_path / "campaign", jacket, sensor_list, n_block=3)
    run(folder, rough, tmp_path / "modes.json")
    return folder


@pytest.mark.parametrize(("change", "said"), [
    ({"order": 16}, r"order 14 there, 16 here"), ({"block_rows": 22}, "block_rows 20 there, 22 here"),
    ({"sub_records": 12, "spread": 2}, "spread 4 there, 2 here; sub_records 10 there, 12 here"),
])
def test_other_settings_are_refused_by_name(filled, rough, tmp_path, change, said):
    with pytest.raises(InputError, match=f"holds blocks of another identification: {said}; give another --out"):
        run(filled, rough, tmp_path / "modes.json", **change)


def test_other_channels_lengths_and_records_are_refused_by_name(filled, jacket, sensor_list, rough, tmp_path):
    out = tmp_path / "modes.json"
    for number, (change, said) in enumerate((
        ({"unit": "g"}, r"channel TP-A-x \[acceleration, m/s2\] there, TP-A-x \[acceleration, g\] here"),
        ({"minutes": 3}, "block_minutes 4 there, 3 here"),
        ({"seed": 1}, r"20190603T100000Z\.poles\.npz: was made of other records: then 0\.h5, .* content"),
    )):
        other = write_hour(tmp_path / f"other{number}", jacket, sensor_list, n_block=3, **{"seed": 0} | change)
        with pytest.raises(InputError, match=said):
            run(other, rough, out)
    (filled / "acceleration" / "1.h5").unlink()
    with pytest.raises(InputError, match=r"is a block of which the campaign has no record|was made of other records"):
        run(filled, rough, out)


def test_a_record_that_came_since_is_identified_and_no_other(filled, rough, tmp_path):
    """A campaign that grows: the block that the second file completes, and those after it."""
    out = tmp_path / "grown.json"
    late = filled / "acceleration" / "1.h5"
    late.rename(tmp_path / "1.h5")
    run(filled, rough, out)
    before = stored(out)
    (tmp_path / "1.h5").rename(late)
    run(filled, rough, out)
    after = stored(out)
    unchanged = {name for name in before if after[name] == before[name]}
    # poles of the first block stay; which of them stand for modes is the whole campaign's to say
    assert {name[:15] for name in unchanged if name.endswith(".poles.npz")} == {"20190603T100000"}
    whole = stored(tmp_path / "modes.json")
    assert set(after) == set(whole)
    assert all(after[name][1] == whole[name][1] for name in whole if name.endswith(".poles.npz"))
    grown, modes = (json.loads((tmp_path / name).read_text()) for name in ("grown.json", "modes.json"))
    # averages over orders are computed together for the poles that are asked for, so that sums round otherwise
    for one, other in zip(grown["sets"], modes["sets"], strict=True):
        assert one.keys() == other.keys() and one["id"] == other["id"] and one["environment"] == other["environment"]
        for key in one.keys() - {"id", "environment"}:
            np.testing.assert_allclose(np.array(one[key], float), np.array(other[key], float), rtol=1e-9, atol=1e-12)


def test_a_copied_folder_is_the_same_and_one_changed_sample_is_another(filled, rough, tmp_path):
    """Content counts, not the time of a file."""
    out = tmp_path / "modes.json"
    before = stored(out)
    copied = tmp_path / "elsewhere" / "campaign"
    shutil.copytree(filled, copied, copy_function=shutil.copy)
    for path in copied.rglob("*.h5"):
        os.utime(path, (1.6e9, 1.6e9))
    run(copied, rough, out)
    assert stored(out) == before
    with h5py.File(copied / "acceleration" / "0.h5", "r+") as file:
        file["data"][1234, 2] += np.float32(1e-3)
    os.utime(copied / "acceleration" / "0.h5", (1.6e9, 1.6e9))
    with pytest.raises(InputError, match=r"was made of other records: then 0\.h5, .* content"):
        run(copied, rough, out)


def test_a_large_file_is_known_by_head_tail_and_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(block_store, "WHOLE_BYTES", 1000)
    monkeypatch.setattr(block_store, "PIECE_BYTES", 10)
    rng = np.random.default_rng(8)
    content = bytearray(rng.bytes(100_000))
    path = tmp_path / "a.h5"

    def hashed():
        path.write_bytes(content)
        block_store._hash.cache_clear()
        return block_store.content_hash(path)

    first = hashed()
    for place, seen in ((0, True), (99_999, True), (100, False)):
        content[place] ^= 1
        assert (hashed() != first) == seen
        content[place] ^= 1
    content.append(0)
    assert hashed() != first


def test_files_that_another_process_is_writing_stay(filled, rough, tmp_path):
    """Opening the store removes the temporary files of dead processes of this computer, no living one's."""
    store = tmp_path / "modes.json.blocks"
    other = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    names = [f"x.poles.npz.{files.host_name()}.{p.pid}.0123abcd.part" for p in (other, dead)]
    names.append(f"x.poles.npz.elsewhere.{dead.pid}.0123abcd.part")
    for name in names:
        (store / name).write_bytes(b"half")
    block_store.BlockStore(store, read_campaign(filled), SSISettings(**SETTINGS).of_blocks)
    assert [(store / name).exists() for name in names] == [True, False, True]
    other.communicate(b"\n")


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def rewritten(name, value):
    """A file whose array holds other numbers, as whole as the format asks."""
    def change(path):
        with np.load(path) as content:
            arrays = dict(content)
        arrays[name] = np.full_like(arrays[name], value)
        np.savez(path, **arrays)
    return change


@pytest.mark.parametrize("kind", ["poles", "deviations"])
@pytest.mark.parametrize("damage", [cut, rewritten("damping_ratio", np.nan), rewritten("damping_ratio", 0.0)],
                         ids=["cut", "nan", "zeroed"])
def test_a_damaged_block_is_found_and_made_anew(filled, rough, tmp_path, kind, damage):
    out, store = tmp_path / "modes.json", tmp_path / "modes.json.blocks"
    path, modes = store / f"20190603T100400Z.{kind}.npz", out.read_bytes()
    before = path.read_bytes()
    damage(path)
    assert path.read_bytes() != before
    run(filled, rough, out)
    assert path.read_bytes() == before and out.read_bytes() == modes


def test_strangers_are_named(filled, rough, tmp_path):
    out, store = tmp_path / "modes.json", tmp_path / "modes.json.blocks"
    (store / "store.json").write_text("{")
    with pytest.raises(InputError, match=r"store\.json: not JSON"):
        run(filled, rough, out)
    (store / "store.json").unlink()
    with pytest.raises(InputError, match="holds something else than identified blocks"):
        run(filled, rough, out)


def test_standard_deviations_that_are_no_numbers_end_the_run(hour, rough, monkeypatch):
    """A defect of the program is named where it arises; the search for other poles has no end of its own then."""
    whole = block_store.read_block_factors

    def spoilt(path):
        found = whole(path)
        factors = replace(found.poles.factors, ln_frequency=np.full_like(found.poles.factors.ln_frequency, np.nan))
        return replace(found, poles=replace(found.poles, factors=factors))

    monkeypatch.setattr(block_store, "read_block_factors", spoilt)
    with pytest.raises(ProbupdateError, match="standard deviations of its poles are not finite"):
        identify(read_campaign(hour), rough, settings=SSISettings(**SETTINGS))


def test_a_mistake_in_a_process_comes_back_in_one_line():
    with pytest.raises(InputError, match="jobs: 0 is not a number of processes"):
        list(iterate_completed(int, [("1",)], jobs=0))
    # raised in another process, it arrives whole
    with pytest.raises(InputError, match="state 'sunk' is unknown") as here:
        list(iterate_completed(reference_model, [("sunk",)] * 2, jobs=2, least=1))
    assert here.value.remedy == "choose from " + ", ".join(REFERENCE_STATES)


def test_without_a_store_the_result_is_the_same_and_covariance_factors_are_in_it(hour, rough, undisturbed, tmp_path):
    campaign, settings = read_campaign(hour), SSISettings(**SETTINGS)
    alone = identify(campaign, rough, settings=settings)
    alone.write(tmp_path / "modes.json")
    for ending in ("json", "deviations.h5", "poles.csv"):
        assert (tmp_path / f"modes.{ending}").read_bytes() == undisturbed.with_name(f"modes.{ending}").read_bytes()
    kept = identify(campaign, rough, settings=settings, store=f"{undisturbed}.blocks")
    for result, kind in ((alone, CovarianceFactors), (kept, StoredFactors)):
        there = [s.covariance_factors for s in result.data.sets if s.covariance_factors]
        assert len(there) > N_BLOCK / 2 and all(isinstance(one, kind) for one in there)


def test_poles_of_one_block_are_in_memory_at_a_time(hour, rough, undisturbed, monkeypatch):
    """A year's are gigabytes: what is kept of a block are its votes, then its choice."""
    alive = []

    def counted(function):
        def called(*arguments):
            alive.append(sum(isinstance(one, PoleStack) for one in gc.get_objects()))
            return function(*arguments)

        return called

    for name in ("votes_of", "paths", "choose"):
        monkeypatch.setattr(tracking, name, counted(getattr(tracking, name)))
    gc.collect()
    before = sum(isinstance(one, PoleStack) for one in gc.get_objects())
    identify(read_campaign(hour), rough, settings=SSISettings(**SETTINGS), store=f"{undisturbed}.blocks")
    # the one at hand, and the one before it until its name is given to the next
    assert len(alive) > 2 * N_BLOCK / 2 and max(alive) - before <= 2


def test_samples_that_no_sensor_measures_are_said(hour, rough, tmp_path):
    folder = tmp_path / "campaign"
    shutil.copytree(hour, folder)
    path = sorted(folder.rglob("*.h5"))[0]
    with h5py.File(path, "r+") as file:
        file["data"][500:503, 1] = 1e12
    found = identify(read_campaign(folder), rough, settings=SSISettings(**SETTINGS))
    assert "samples that no sensor measures, counted as lost, in 1 of" in found.summary
