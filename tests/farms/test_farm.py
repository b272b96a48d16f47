"""A small farm: finished months are kept, killed runs and shards go on, one month that fails is one line."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from farm_cases import DESCRIPTION, write_campaign, write_farm

import probupdate
from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.farms import month as months
from probupdate.farms import run as farms_run
from probupdate.farms.description import read_farm
from probupdate.farms.run import run_one
from probupdate.modal.modes import read_modes
from probupdate.runtime.executors import executor, limit_threads_of_workers, processes

RESULTS = ("modes.json", "nine.json", "update.json", "diagnosis.json")


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    return write_farm(tmp_path_factory.mktemp("farm") / "data")


@pytest.fixture(scope="module")
def undisturbed(described, tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    return out, probupdate.farm(described, out)


def results(out):
    return {f"{p.parent.parent.name}/{p.parent.name}/{p.name}": p.read_bytes() for name in RESULTS
            for p in out.glob(f"*/*/{name}")}


def changed(out):
    return {p.relative_to(out): p.stat().st_mtime_ns for name in (*RESULTS, "*.npz") for p in out.rglob(name)}


def table(out):
    with (out / "farm.csv").open(newline="") as stream:
        return {(row["turbine"], row["month"]): row for row in csv.DictReader(stream)}


def test_every_month_has_its_results_and_the_page_says_what_changed(undisturbed, validation):
    checked = validation(what="frequencies' change of a building 6 % softer", reference="sqrt(0.94)")
    out, run = undisturbed
    assert run.run == 4 and not run.failed and len(results(out)) == 16
    rows = table(out)
    assert [row["state"] for row in rows.values()] == ["done"] * 4
    before, after = (float(rows["B", f"2024-{m}"]["X1_hz"]) for m in ("05", "06"))
    # by a square root of 0.94
    checked.error(after / before - 0.94**0.5, below=3e-3)
    assert float(rows["B", "2024-06"]["X1_change"]) == pytest.approx(after / before - 1, abs=1e-5)
    assert "X1 -3" in rows["B", "2024-06"]["changes"] and not rows["A", "2024-06"]["changes"]
    assert abs(float(rows["B", "2024-06"]["k1"]) + 0.06) < 4 * float(rows["B", "2024-06"]["k1_std"])
    page = (out / "farm.html").read_text()
    assert "Three buildings" in page and page.count("<table>") == 1 and page.count("<svg") == 1
    assert "B, 2024-06: X1 −3" in page or "B, 2024-06: X1 -3" in page
    assert "http://" not in page.replace("http://www.w3.org", "") and "src=" not in page


def test_a_month_s_diagnosis_is_that_of_the_command(described, undisturbed, tmp_path):
    """Though the model with its effects is made once for all months."""
    out = tmp_path / "diagnosis.json"
    modes = undisturbed[0] / "B" / "2024-06" / "modes.json"
    probupdate.diagnose(described.parent / "model.npz", modes, seed=1, out=out, extend=False).write(out)
    assert out.read_bytes() == (modes.parent / "diagnosis.json").read_bytes()


def test_a_finished_farm_is_not_done_again(described, undisturbed):
    out, _ = undisturbed
    before = changed(out)
    assert probupdate.farm(described, out).run == 0 and changed(out) == before


KILLED = """
import sys
sys.path[:0] = [sys.argv[3]]
from probupdate import farm
if __name__ == "__main__":
    farm(sys.argv[1], sys.argv[2], jobs=int(sys.argv[4]), shard=sys.argv[5] or None)
"""


def started(described, out, jobs=1, shard=""):
    folder = out.parent / "script.py"
    folder.write_text(KILLED)
    words = [sys.executable, str(folder), str(described), str(out), str(folder.parent), str(jobs), shard]
    return subprocess.Popen(words, env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})


@pytest.mark.long
def test_killed_in_two_processes_and_resumed_has_the_bytes_of_an_undisturbed_run(described, undisturbed, tmp_path):
    out = tmp_path / "out"
    child = started(described, out, jobs=2)
    deadline = time.monotonic() + 90
    while not list(out.glob("*/*/month.json")) and child.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    child.kill()
    child.wait()
    time.sleep(0.5)
    left = changed(out)
    finished = {p: json.loads(p.read_text())["finished"] for p in out.glob("*/*/month.json")}
    assert finished
    run = probupdate.farm(described, out)
    assert results(out) == results(undisturbed[0]) and not run.failed
    # what a finished step wrote was not written again
    after = changed(out)
    for path, steps in finished.items():
        for name, step in (("modes.json", "identify"), ("nine.json", "select"), ("update.json", "update")):
            key = (path.parent / name).relative_to(out)
            assert step not in steps or after[key] == left[key]
    poles = [key for key in left if key.name.endswith(".poles.npz")]
    assert all(after[key] == left[key] for key in poles)


def test_two_shards_give_the_whole(described, undisturbed, tmp_path):
    out = tmp_path / "out"
    first = probupdate.farm(described, out, shard="1/2")
    assert first.run == 2 and "2 waiting" in first.summary
    assert {key for key, row in table(out).items() if row["state"] == "done"} == {("A", "2024-05"), ("A", "2024-06")}
    second = probupdate.farm(described, out, shard="2/2")
    assert second.run == 2 and "4 done" in second.summary and results(out) == results(undisturbed[0])


def finished_steps(out):
    """Of every month that is known, what its finished steps wrote."""
    wrote = {"identify": "modes.json", "select": "nine.json", "update": "update.json", "diagnose": "diagnosis.json"}
    return [(p.parent / wrote[step]).relative_to(out) for p in out.glob("*/*/month.json")
            for step in json.loads(p.read_text())["finished"]]


def until(there, *children, seconds=120):
    deadline = time.monotonic() + seconds
    while not there() and time.monotonic() < deadline and all(child.poll() is None for child in children):
        time.sleep(0.01)
    assert there()


def test_two_shards_killed_and_resumed_lose_nothing_and_write_nothing_twice(described, undisturbed, tmp_path):
    out = tmp_path / "out"
    shards = [started(described, out, shard=f"{k}/2") for k in (1, 2)]
    until(lambda: len(list(out.glob("*/*/month.json"))) >= 2, *shards)
    for child in shards:
        child.kill()
        child.wait()
    kept, left = finished_steps(out), changed(out)
    assert kept and len(results(out)) < 16
    again = [started(described, out, shard=f"{k}/2") for k in (1, 2)]
    assert [child.wait(timeout=300) for child in again] == [0, 0]
    assert results(out) == results(undisturbed[0]) and probupdate.farm(described, out).run == 0
    after = changed(out)
    assert all(after[name] == left[name] for name in kept)
    poles = [name for name in left if name.name.endswith(".poles.npz")]
    assert poles and all(after[name] == left[name] for name in poles)


@pytest.mark.long
def test_two_runs_of_one_farm_on_one_folder_give_the_bytes_of_one(described, undisturbed, tmp_path):
    """Without shards both do all months; what one has just written the other takes, or writes once more."""
    out = tmp_path / "out"
    both = [started(described, out) for _ in range(2)]
    assert [child.wait(timeout=300) for child in both] == [0, 0]
    assert results(out) == results(undisturbed[0]) and probupdate.farm(described, out).run == 0
    assert not list(out.rglob("*.part")) and [row["state"] for row in table(out).values()] == ["done"] * 4


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning",
                            "ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_dask_worker_killed_at_a_month_loses_nothing_and_no_finished_step_is_done_twice(
    described, undisturbed, tmp_path
):
    distributed = pytest.importorskip("distributed", reason="the extra `dask` is not installed")
    out, found = tmp_path / "out", []
    with limit_threads_of_workers(), distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0",
            local_directory=str(tmp_path / "dask")) as cluster:
        def run():
            with executor(1, cluster.scheduler_address) as runs:
                found.append(probupdate.farm(described, out, jobs=runs))

        thread = threading.Thread(target=run)
        thread.start()
        until(lambda: list(out.glob("*/*/month.json")))
        with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
            # those that are at a month
            busy = [address for address, tasks in client.processing().items() if tasks]
            pid = client.run(os.getpid, workers=busy[:1])[busy[0]]
        kept = finished_steps(out)
        left = changed(out)
        os.kill(pid, signal.SIGKILL)
        thread.join(300)
        assert not thread.is_alive()
    (run,) = found
    assert not run.failed and len(run.rows) == 4 and results(out) == results(undisturbed[0])
    after = changed(out)
    assert kept and all(after[name] == left[name] for name in kept)


def test_an_update_has_the_same_bytes_in_processes(described, undisturbed, tmp_path):
    modes, model = undisturbed[0] / "B" / "2024-06" / "modes.json", described.parent / "model.npz"
    for jobs in (1, 2):
        probupdate.update(model, modes, jobs=jobs).write(tmp_path / f"{jobs}.json")
    first = json.loads((tmp_path / "1.json").read_text())
    assert len(first["sets"]["ids"]) > 2 and (tmp_path / "1.json").read_bytes() == (tmp_path / "2.json").read_bytes()


@pytest.fixture
def copied(described, undisturbed, tmp_path):
    """The farm with all of its months done, to be spoilt."""
    shutil.copytree(described.parent, tmp_path / "data")
    shutil.copytree(undisturbed[0], tmp_path / "out")
    return tmp_path / "data" / "farm.toml", tmp_path / "out"


def test_a_month_that_fails_is_one_line_and_the_others_go_on(copied, capsys):
    description, out = copied
    shutil.rmtree(out)
    record = description.parent / "A" / "2024-06" / "acceleration" / "all.h5"
    content = record.read_bytes()
    record.write_bytes(content[: len(content) // 2])
    assert main(["farm", str(description), "--out", str(out)]) == 1
    answer = capsys.readouterr()
    assert "A, 2024-06: failed at identify: " in answer.out and "all.h5" in answer.out
    # on a slow machine a line of progress stands before it
    assert "1 of 4 turbine-months failed" in answer.err.splitlines()[-1] and answer.err.count("probupdate farm:") == 1
    rows = table(out)
    assert [row["state"] for row in rows.values()] == ["done", "failed", "done", "done"]
    assert rows["A", "2024-06"]["failed_step"] == "identify"
    assert "A, 2024-06, at identify" in (out / "farm.html").read_text()
    # corrected, it is the one month that is worked on
    record.write_bytes(content)
    again = probupdate.farm(description, out)
    assert again.run == 1 and not again.failed


def test_a_defect_in_one_month_keeps_its_trace_and_the_others_go_on(copied, monkeypatch):
    description, out = copied
    shutil.rmtree(out)
    description.write_text(DESCRIPTION.replace(', "select", "update", "diagnose"]', "]").replace(
        DESCRIPTION[DESCRIPTION.index("[select]"): DESCRIPTION.index("[[turbine]]")], ""))
    whole = months._RUN["identify"]

    def broken(month, folder, options, seed):
        if month.turbine == "B" and month.month == "2024-05":
            raise ZeroDivisionError("by nothing")
        whole(month, folder, options, seed)

    monkeypatch.setitem(months._RUN, "identify", broken)
    run = probupdate.farm(description, out)
    (failed,) = run.failed
    assert failed.failed == ("a defect of the program (ZeroDivisionError: by nothing); its trace is in "
                             "B/2024-05/failure.txt")
    assert "by nothing" in (out / "B" / "2024-05" / "failure.txt").read_text()


def test_new_records_another_model_other_options_are_done_again(copied):
    description, out = copied
    later = description.parent / "A" / "2024-07"
    write_campaign(later, 1.0, 9, "2024-07-01T00:00:00Z")
    assert probupdate.farm(description, out).run == 1
    # the block that came since, and no other, is identified
    poles = {k: v for k, v in changed(out).items() if "2024-07" in k.parts and k.name.endswith(".poles.npz")}
    shutil.copy(later / "acceleration" / "all.h5", later / "acceleration" / "more.h5")
    import h5py

    with h5py.File(later / "acceleration" / "more.h5", "r+") as file:
        file["data"].attrs["start"] = "2024-07-01T01:00:00Z"
    assert probupdate.farm(description, out).run == 1
    after = changed(out)
    assert (len(read_modes(out / "A" / "2024-07" / "modes.json").sets) == 8
            and all(after[k] == v for k, v in poles.items()))
    description.write_text(DESCRIPTION.replace("count = 2", "count = 3"))
    assert probupdate.farm(description, out).run == 5


def lost(month, farm, out):
    if month.turbine == "A" and month.month == "2024-06":
        os.kill(os.getpid(), signal.SIGKILL)
    return run_one(month, farm, out)


def test_a_month_that_ends_its_process_fails_alone(copied):
    description, out = copied
    farm = replace(read_farm(description), steps=("identify",))
    tasks = [(month, farm, out) for month in farm.months]
    with processes(2) as runs:
        found = list(runs.as_completed(lost, tasks, least=1, lost=lambda task: (task[0], months.ended_month(*task))))
    assert {(m.turbine, m.month): bool(s.failed) for m, s in found} == {
        ("A", "2024-05"): False, ("A", "2024-06"): True, ("B", "2024-05"): False, ("B", "2024-06"): False}
    assert len(found) == 4 and "ended from outside" in next(s.failed for _, s in found if s.failed)


@pytest.mark.parametrize(("old", "new", "said"), [
    ('name = "A"', 'name = "../A"', "'../A' becomes a folder's name and cannot"),
    ('name = "A"', 'name = "b"', "turbine 'b' stands twice"),
    ('campaigns = "A/2024-*"', 'campaigns = "A/2023-*"', "'A/2023-*' finds no folder with a campaign.toml"),
    ('campaigns = "A/2024-*"', 'campaigns = "../A/*"', "is not a pattern of folders below farm.toml's"),
    ('campaigns = "A/2024-*"', 'campaigns = "/etc/*"', "is not a pattern of folders below farm.toml's"),
    ('campaigns = "A/2024-*"', 'campains = "A/*"', "unknown key 'campains'; did you mean 'campaigns'"),
    ('model = "model.npz"', 'model = "../model.npz"', "leaves the folder"),
    ('model = "model.npz"\n', "", "has no model, and the farm has none"),
    ('"update", "diagnose"]', '"update", "compare"]', "'compare' needs 'sample'"),
    ('["identify", "select", ', '["select", ', "'select' needs 'identify'"),
    ('"diagnose"]', '"diagnos"]', "'diagnos' is unknown; did you mean 'diagnose'"),
    ("lowest = 3", "lowest = 0", "lowest: 0 is not in 1 to 1000"),
    ("[diagnose]", "[sample]\ness = 5\n[diagnose]", "is a table of a step that is not among steps"),
    ("[[turbine]]", "[[turbines]]", "unknown key 'turbines'; did you mean 'turbine'"),
    ("[select]", '[select]\ndeviations = "identification"', "unknown key 'deviations'; known are preset, std_from"),
])
def test_mistakes_of_the_description_are_named(described, tmp_path, old, new, said):
    assert old in DESCRIPTION
    path = described.parent / "wrong.toml"
    path.write_text(DESCRIPTION.replace(old, new))
    with pytest.raises(InputError) as error:
        read_farm(path)
    assert said in str(error.value) and "wrong.toml" in str(error.value)


def test_two_shards_that_begin_in_the_same_moment_take_one_folder(described, tmp_path, monkeypatch):
    """The other's head may be written right after it was looked for."""
    out, farm, exists = tmp_path / "out", read_farm(described), Path.exists

    def looked_for(path, **options):
        there = exists(path, **options)
        if path == out / "farm.json" and not there:
            path.parent.mkdir()
            path.write_text(json.dumps({"format": 1, "name": farm.name}))
        return there

    monkeypatch.setattr(Path, "exists", looked_for)
    farms_run.claim_folder(out, farm)
    assert json.loads((out / "farm.json").read_text())["name"] == farm.name


def test_a_folder_of_something_else_is_refused(described, undisturbed, tmp_path):
    (tmp_path / "a.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty and holds no farm's results"):
        probupdate.farm(described, tmp_path)
    other = described.parent / "other.toml"
    other.write_text(DESCRIPTION.replace("Three", "Four"))
    with pytest.raises(InputError, match="holds the results of the farm 'Three buildings', not of 'Four buildings'"):
        probupdate.farm(other, undisturbed[0])
