"""Every reader with files spoilt by chance: each is read, or one line names a file; nothing else, in bounded time and
memory."""

import json
import os
import resource
import signal
import sys
import time
import traceback
from pathlib import Path

import h5py
import numpy as np
import pytest
from mutations import spoilt
from reader_cases import CASES, readers_in_the_code

from probupdate.diagnosis.results import Diagnosis, read_diagnosis
from probupdate.errors import InputError

SEED = 1
MUTATIONS, LONG = 200, 5000
# of one case where all are run in continuous integration; slow readers get fewer mutations, never fewer than FEWEST
SHARE_S, FEWEST = 0.6, 12
HANGS_S = 20
CORPUS = Path(__file__).with_name("corpus")


class Hung(BaseException):
    pass


def tried(folder: Path, paths, read, content: dict[Path, bytes]) -> str:
    """'' where the files are read or refused in one line that names one of them; else what happened."""

    def hung(number, frame):
        raise Hung

    before = signal.signal(signal.SIGALRM, hung)
    signal.alarm(HANGS_S)
    try:
        read()
    except InputError as error:
        text = str(error)
        if len(text.splitlines()) != 1 or not text.isprintable() or len(text) > 4000:
            return f"not one line: {text[:200]!r}"
        return "" if str(folder) in text else f"names no file: {text[:200]}"
    except Hung:
        return f"not ended after {HANGS_S} s"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)
        ours = [f for f in place if "probupdate" in f.filename] or place
        return f"{type(error).__name__}: {str(error)[:120]} ({Path(ours[-1].filename).name}:{ours[-1].lineno})"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    return ""


def fuzz(case: str, folder: Path, seed: int, number: int, seconds: float = np.inf, keep: Path | None = None):
    """(mutations done, what happened -> count) of one reader. keep: folder for what failed."""
    paths, read = CASES[case][0](folder)
    whole = {path: path.read_bytes() for path in paths}
    read()
    rng, found, done, begun = np.random.default_rng([seed, *case.encode()]), {}, 0, time.monotonic()
    for done in range(1, number + 1):
        path = paths[rng.integers(len(paths))]
        content = spoilt(path.name, whole[path], rng)
        path.write_bytes(content)
        words = tried(folder, paths, read, whole)
        path.write_bytes(whole[path])
        if words:
            found[words] = found.get(words, 0) + 1
            if keep is not None and found[words] == 1:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{case}-{len(found)}-{path.name}").write_bytes(content)
        if done >= FEWEST and time.monotonic() - begun > seconds:
            break
    return done, found


def test_every_reader_of_the_code_is_in_the_table():
    covered = {name for _, names in CASES.values() for name in names}
    missing = readers_in_the_code() - covered
    assert not missing, f"add a case to reader_cases.CASES for {sorted(missing)}"


@pytest.mark.parametrize("case", CASES)
def test_spoilt_files_are_read_or_refused_in_one_line(case, tmp_path):
    _, found = fuzz(case, tmp_path, SEED, MUTATIONS, SHARE_S)
    assert not found


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_thousands_of_spoilt_files(case, tmp_path):
    _, found = fuzz(case, tmp_path, 2, LONG)
    assert not found
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2 * 2**20


@pytest.mark.parametrize("name", sorted(p.name for p in CORPUS.iterdir()) if CORPUS.exists() else [])
def test_what_once_failed(name, tmp_path):
    case, _, target = name.split("-", 2)
    paths, read = CASES[case][0](tmp_path)
    path = next(p for p in paths if p.name == target)
    path.write_bytes((CORPUS / name).read_bytes())
    assert not tried(tmp_path, paths, read, {})


@pytest.mark.parametrize("case", ["block_poles", "block_deviations"])
def test_an_array_of_a_block_that_was_changed_is_refused(case, tmp_path):
    (path, *_), read = CASES[case][0](tmp_path)
    with np.load(path) as archive:
        content = dict(archive)
    damping = content["damping_ratio"].copy()
    damping[0] = np.nan
    np.savez(path, **content | {"damping_ratio": damping})
    with pytest.raises(InputError, match=f"{path.name}: does not hold what was written"):
        read()


@pytest.mark.parametrize(("case", "name", "fewest"), [
    ("poles_csv", "poles.csv", 30), ("gauges", "gauges.csv", 20), ("lifetime_table", "draws.csv", 7),
    ("run", "modes.poles.csv", 30), ("calculix", "job.sti", 10), ("elastodyn", "tower.dat", 20),
])
def test_a_table_that_is_cut_within_its_last_row_is_refused(case, name, fewest, tmp_path):
    """At every byte of it; a cut between two rows does not show."""
    paths, read = CASES[case][0](tmp_path)
    path = next(p for p in paths if p.name == name)
    whole = path.read_bytes().rstrip()
    row = whole.rindex(b"\n") + 1
    cuts = range(row + 1, len(whole))
    for end in cuts:
        path.write_bytes(whole[:end])
        with pytest.raises(InputError, match=name):
            read()
    assert len(cuts) >= fewest


@pytest.mark.parametrize("change", [
    lambda file: file["2019-06-03T01:00Z/damping_ratio"].write_direct(np.full((3, 5), 2.0, np.float32)),
    lambda file: file.pop("2019-06-03T01:00Z"),
    lambda file: file["2019-06-03T01:00Z"].attrs.modify("id", "another"),
])
def test_covariance_factors_that_were_changed_are_refused(change, tmp_path):
    (_, path), read = CASES["modes"][0](tmp_path)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(InputError, match=f"{path.name}: does not hold what was written"):
        read()


def test_a_number_changed_in_what_a_diagnosis_draws_is_refused(tmp_path):
    path = tmp_path / "diagnosis.json"
    Diagnosis(verdict="none", p_value=0.5, findings=(), detectable_sizes=(), threshold=3.0, adequacy_p=0.5, notes=(),
              parameters=(), details={"residuals": {"time": {"hours": [0.5, 1.25]}}}).write(path)
    assert read_diagnosis(path)["details"]["residuals"]["time"]["hours"] == [0.5, 1.25]
    path.write_text(path.read_text().replace("1.25", "1.5"))
    with pytest.raises(InputError, match=r"diagnosis\.json: does not hold what was written"):
        read_diagnosis(path)


@pytest.mark.parametrize(("case", "name", "old", "new", "words"), [
    ("head", "campaign.toml", "position_m = [0.0", 'position_m = ["0.0"', "which is no number"),
    ("head", "campaign.toml", "position_m = [0.0", "position_m = [true", "which is no number"),
    ("head", "campaign.toml", "water_depth_m = 30.0", "water_depth_m = inf", "water_depth_m"),
    ("head", "campaign.toml", 'channel = "T-x"', 'channel = "T\\n-x"', "channel"),
    ("head", "campaign.toml", 'level = "T"', 'level = "T\\u0000"', "control character"),
    ("farm", "farm.toml", 'name = "North"', 'name = "North\\u001b[2J"', "control character"),
    ("fatigue", "fatigue.toml", 'name = "', 'name = "\\n', "control character"),
    ("truth", "truth.toml", "depth_m = 2.0", "depth_m = 1e308", "depth_m"),
    ("modes", "modes.json", '"format": 2', '"format": 0', "format"),
    ("modes", "modes.json", '"2019-06-03T01:00Z"', "true", "no name"),
    ("modes", "modes.json", '"SS1"', '"S\\nS1"', "labels"),
    ("comparison", "compare.json", '"mean":', '"meant":', "rows.0"),
    ("views", "sets.json", '"p_value": 0.01', '"p_value": 1.01', "p_value"),
    ("information", "information.json", '"contraction": ', '"contraction": -', "contraction"),
    ("diagnosis", "diagnosis.json", '"p_value": ', '"p_value": 2, "own": ', "p_value"),
    ("gauges", "gauges.csv", "1.5", "1e308", "MPa"),
])
def test_what_no_such_file_holds_is_refused_by_its_key(case, name, old, new, words, tmp_path):
    paths, read = CASES[case][0](tmp_path)
    path = next(p for p in paths if p.name == name)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read()
    assert name in str(error.value) and words in str(error.value)


def main() -> None:
    """python test_readers_fuzzed.py SEED NUMBER [CASE ...]: a line of JSON a case, each in a process of its own."""
    import subprocess
    import tempfile
    import warnings

    warnings.simplefilter("error")
    seed, number, *cases = sys.argv[1:]
    if len(cases) == 1:
        with tempfile.TemporaryDirectory() as folder:
            keep = os.environ.get("KEEP")
            done, found = fuzz(cases[0], Path(folder), int(seed), int(number), keep=Path(keep) if keep else None)
        rss = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
        sys.stdout.write(json.dumps({"case": cases[0], "done": done, "failed": found, "memory_mb": round(rss)}) + "\n")
        return
    for case in cases or CASES:
        ended = subprocess.run([sys.executable, __file__, seed, number, case], capture_output=True, text=True)
        sys.stdout.write(ended.stdout
                         or json.dumps({"case": case, "ended": ended.returncode, "words": ended.stderr[-800:]})
                         + "\n" * (not ended.stdout))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
