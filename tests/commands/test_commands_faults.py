"""A small version of studies/faults: kill -9, two writers and signals at drawn moments, full disks, for light
commands."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_cases import modes_table, write_building

from probupdate.cli import EXAMPLES

STUDY = Path(__file__).resolve().parents[2] / "studies" / "faults"
TRIED = ("kill -9 at a drawn moment", "kill -9 as a file takes its place", "two writers", "SIGTERM", "Ctrl-C",
         "full disk (limit on file size)", "input gone midway")


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks /proc for orphan processes")
def test_nothing_finished_is_lost_and_nothing_is_left(tmp_path):
    code = (f"import sys; sys.path.insert(0, {str(STUDY)!r}); import faults; from pathlib import Path\n"
            f"faults.run(Path({str(tmp_path)!r}), 11, ['select', 'convert'], faults={TRIED!r}, rounds=1)")
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
                   "PYTHONPATH": str(STUDY.parents[1])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert len(lines) == 2 * len(TRIED)
    assert sum(one["what"].get("kills", 0) for one in lines) == 10
    bad = ("torn", "again_differs", "parts_left", "orphans", "traceback", "more_lines", "other_exit")
    assert not [one for one in lines if any(one["what"].get(key) for key in bad)]


def test_the_study_tries_every_command_or_says_which_it_does_not():
    sys.path.insert(0, str(STUDY))
    import fault_inputs

    tried = {words[0] for words in fault_inputs.commands(Path("i"), Path("o")).values()}
    assert tried | set(fault_inputs.UNTRIED) == set(EXAMPLES) and not tried & set(fault_inputs.UNTRIED)


def test_the_study_knows_a_torn_file(tmp_path):
    """What judges the trials, on files of which a half is there."""
    sys.path.insert(0, str(STUDY))
    from fault_bench import is_whole

    np.savez(tmp_path / "a.npz", a=np.arange(100.0))
    (tmp_path / "a.json").write_text(json.dumps({"a": list(range(100))}))
    (tmp_path / "a.csv").write_text("a,b\n1,2\n3,444\n")
    (tmp_path / "a.html").write_text("<html><p>text</p></html>\n")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data"] = np.random.default_rng(1).standard_normal(5000)
    for path in list(tmp_path.iterdir()):
        assert is_whole(path), path.name
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        assert not is_whole(path), path.name


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_while_the_program_is_being_loaded_is_one_line(number):
    """Sent when the interpreter has come to this program, before anything else of it is there."""
    code = ("import sys, os, signal, importlib.abc\n"
            "class Finder(importlib.abc.MetaPathFinder):\n"
            "    def find_spec(self, name, path, target=None):\n"
            f"        if name == 'probupdate.cli': os.kill(os.getpid(), {int(number)})\n"
            "sys.meta_path.insert(0, Finder())\n"
            "from probupdate.__main__ import main; sys.exit(main())")
    ended = subprocess.run([sys.executable, "-c", code, "modes", "design"], capture_output=True, text=True,
                           preexec_fn=lambda: signal.signal(number, signal.SIG_DFL))
    assert ended.returncode == 130 and ended.stderr == "probupdate: interrupted before anything was done\n"


@pytest.mark.parametrize("begun", ["from probupdate.__main__ import main", "from probupdate.cli.program import main"])
def test_linear_algebra_has_one_thread_in_the_program_itself(begun):
    """They read the environment once, when numpy is first imported."""
    code = ("import sys, os, importlib.abc\nsaid = []\n"
            "class Finder(importlib.abc.MetaPathFinder):\n"
            "    def find_spec(self, name, path, target=None):\n"
            "        if name == 'numpy': said.append([os.environ.get(n) for n in NAMES])\n"
            "NAMES = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')\n"
            "sys.meta_path.insert(0, Finder())\n"
            f"{begun}\nmain()\nassert said == [['1'] * 3], said")
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    ended = subprocess.run([sys.executable, "-c", code, "modes", "design"], capture_output=True, text=True,
                           env=environment)
    assert not ended.returncode, ended.stderr


def test_a_signal_that_falls_into_an_exec_keeps_the_exit_code(tmp_path):
    """Python itself ends by the signal where a KeyboardInterrupt has passed through an exec, caught or not."""
    code = ("import os, signal, sys\nfrom probupdate import __main__\nfrom probupdate.cli import beginning\n"
            "def action(a, progress): exec('import os, signal; os.kill(os.getpid(), signal.SIGTERM)')\n"
            "beginning.run_modes = action\nsys.argv = ['probupdate', 'modes', 'design']\nsys.exit(__main__.main())")
    (tmp_path / "run.py").write_text(code)
    ended = subprocess.run([sys.executable, tmp_path / "run.py"], capture_output=True, text=True)
    assert ended.returncode == 130 and ended.stderr == "probupdate modes: interrupted; nothing of this run is kept\n"


def test_ctrl_c_that_is_ignored_stays_ignored(tmp_path):
    """As in a script's background."""
    begun = subprocess.Popen([sys.executable, "-m", "probupdate", "modes", "design"], stdout=subprocess.DEVNULL,
                             stderr=subprocess.PIPE, text=True,
                             preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
    while begun.poll() is None:
        begun.send_signal(signal.SIGINT)
        time.sleep(0.05)
    assert begun.returncode == 0 and not begun.communicate()[1]


def test_a_diagnosis_that_is_stopped_keeps_nothing_and_says_so(tmp_path):
    """Stopped when its findings are put into the sets: files of an earlier diagnosis stay as they are."""
    paths, out = write_building(tmp_path), tmp_path / "out"
    table = modes_table(12)
    for k, one in enumerate(table["sets"]):
        one["id"] = f"2026-06-01T{k:02d}:00Z"
        if k > 5:
            one["shape_re"] = [[1.6 * x if c == 1 else x for c, x in enumerate(row)] for row in one["shape_re"]]
    Path(paths["modes"]).write_text(json.dumps(table))
    out.mkdir()
    for name in ("diagnosis.json", "diagnosis.mean.json", "diagnosis.modes.json"):
        (out / name).write_text("{}")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    code = ("import os, signal, sys\nfrom probupdate.diagnosis import extension\nstage = extension.mean_set\n"
            "def stopped(*given):\n"
            "    os.kill(os.getpid(), signal.SIGTERM)\n    return stage(*given)\n"
            "extension.mean_set = stopped\nfrom probupdate.__main__ import main\nsys.exit(main())")
    ended = subprocess.run(
        [sys.executable, "-c", code, "diagnose", "--model", paths["model"], "--parameters", paths["parameters"],
         "--modes", paths["modes"], "--out", str(out / "diagnosis.json")], capture_output=True, text=True)
    assert ended.returncode == 130, ended.stderr
    assert ended.stderr.splitlines()[-1] == "probupdate diagnose: interrupted; nothing of this run is kept"
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
