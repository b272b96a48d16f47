"""No result in the place of what it is made from; one line and an exit code for whatever the machine refuses."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from probupdate.cli import argument_paths, build_parser, main
from probupdate.errors import InputError
from probupdate.io import files
from probupdate.io.outputs import refuse_overwriting


def run(*arguments, **options):
    return subprocess.run([sys.executable, "-m", "probupdate.cli", *map(str, arguments)], capture_output=True,
                          text=True, **options)


@pytest.mark.parametrize("verb, out, given", [
    ("select", "modes.csv", ["modes.json"]), ("select", "modes.json", ["modes.json"]),
    ("update", "parameters.toml", ["model.npz", "nine.json"]), ("update", "part.npz", ["matrices.toml", "nine.json"]),
    ("check", "run/campaign.toml", ["run"]), ("check", "run/acceleration/a.json", ["run"]),
    ("report", "run/update.json", ["run"]), ("identify", "modes.toml", ["modes.json", "model.npz"]),
])
def test_results_never_take_an_inputs_place(tmp_path, monkeypatch, verb, out, given):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run" / "acceleration").mkdir(parents=True)
    for name in ("modes.json", "modes.deviations.h5", "nine.json", "model.npz", "parameters.toml", "part.npz",
                 "run/campaign.toml", "run/update.json"):
        (tmp_path / name).write_text("")
    (tmp_path / "matrices.toml").write_text('[matrices]\nfile = "part.npz"\n')
    with pytest.raises(InputError, match="would be written over|lies among the records"):
        refuse_overwriting(verb, out, given)
    refuse_overwriting(verb, "other/new.json" if verb != "report" else "run/report.html", given)


def test_a_new_page_may_take_an_old_ones_place(tmp_path):
    (tmp_path / "report.html").write_text("old")
    refuse_overwriting("report", str(tmp_path / "report.html"), [str(tmp_path)])


@pytest.mark.parametrize("out", ["x" * 300, "a\0b", "/dev/null/x", "/proc/none/x"])
def test_names_that_cannot_be(out, capsys, tmp_path):
    assert main(["modes", "design", "--out", out]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_links_and_devices_are_not_written_over(tmp_path):
    (tmp_path / "there").write_text("kept")
    (tmp_path / "link").symlink_to(tmp_path / "there")
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("link", "is a link"), ("pipe", "is a pipe")):
        with pytest.raises(InputError, match=words):
            files.write_text(tmp_path / name, "new")
    assert (tmp_path / "there").read_text() == "kept"


def limit_files(size: int) -> dict:
    """Options of a process whose files end after `size` bytes; it compiles nothing, or half a module would stay."""
    return {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
            "env": os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}}


def test_a_full_disk_is_one_line_and_leaves_what_was_there(tmp_path):
    out = tmp_path / "modes.json"
    out.write_text("before")
    ended = run("modes", "design", "--out", out, **limit_files(20))
    assert ended.returncode == 1 and len(ended.stderr.splitlines()) == 1
    assert "modes.json: File too large; make room" in ended.stderr
    assert out.read_text() == "before" and [p.name for p in tmp_path.iterdir()] == ["modes.json"]


def test_closed_and_full_output_is_one_line():
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run([sys.executable, "-m", "probupdate.cli", "modes", "design"], stdout=full,
                               stderr=subprocess.PIPE, text=True)
    assert ended.returncode == 1 and len(ended.stderr.splitlines()) == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_is_one_line_and_130(tmp_path, number):
    # a run in the background hands on that Ctrl-C is ignored
    begun = subprocess.Popen([sys.executable, "-m", "probupdate.cli", "simulate", tmp_path / "c", "--days", "3"],
                             stderr=subprocess.PIPE, text=True,
                             preexec_fn=lambda: signal.signal(number, signal.SIG_DFL))
    end = time.monotonic() + 60
    while not list(tmp_path.glob("c/acceleration/*.h5")) and time.monotonic() < end:
        time.sleep(0.1)
    begun.send_signal(number)
    _, words = begun.communicate(timeout=60)
    assert begun.returncode == 130
    assert [line for line in words.splitlines() if not line.startswith("  ")] == [
        "probupdate simulate: interrupted; what was finished is kept"]
    assert list(tmp_path.glob("c/acceleration/*.h5")) and not list(tmp_path.rglob("*.part"))


def test_only_the_dead_lose_their_temporary_files(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    host = files.host_name()
    names = {f"a.json.{host}.{dead.pid}.0123abcd.part": False, f"a.json.{host}.{os.getpid()}.0123abcd.part": True,
             f"a.json.elsewhere.{dead.pid}.0123abcd.part": True, "old.part": False}
    for name in names:
        (tmp_path / name).write_text("")
    os.utime(tmp_path / "old.part", (1, 1))
    files.remove_stale(tmp_path)
    assert {name: (tmp_path / name).exists() for name in names} == names


def test_a_folder_is_there_whole_or_not_at_all(tmp_path):
    """What a killed process left beside it is removed, and what goes wrong names the folder that was asked for."""
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left = tmp_path / f"out.{files.host_name()}.{dead.pid}.0123abcd.part" / "models"
    left.mkdir(parents=True)
    (left / "a.json").write_text("{")
    with pytest.raises(InputError, match=f"^{tmp_path}/out/a.json: not JSON"), files.whole_folder(
            tmp_path / "out") as folder:
        (folder / "a.json").write_text("{")
        files.read_json(folder / "a.json")
    assert not list(tmp_path.iterdir())
    with files.whole_folder(tmp_path / "out") as folder:
        files.write_json(folder / "models" / "a.json", {})
        assert not (tmp_path / "out").exists()
    assert [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.json")] == ["out/models/a.json"]
    with pytest.raises(InputError, match="holds something already"), files.whole_folder(tmp_path / "out"):
        pass


def test_two_writers_at_once_leave_one_whole_file(tmp_path):
    code = ("import sys, numpy as np\nfrom probupdate.io import files\n"
            "for k in range(60): files.write_arrays(sys.argv[1], {'a': np.full(20000, int(sys.argv[2]))})")
    path = tmp_path / "a.npz"
    both = [subprocess.Popen([sys.executable, "-c", code, path, str(k)]) for k in (1, 2)]
    while any(p.poll() is None for p in both):
        if path.exists():
            found = files.archive_arrays(path, "is broken", "stop")["a"]
            assert len(found) == 20000 and len(set(found)) == 1
    assert [p.returncode for p in both] == [0, 0] and [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_cells_are_no_formulas(tmp_path):
    import pandas as pd

    table = pd.DataFrame({"=a": ["=1+1", "-3", "@x", "+y", "a"], "b": np.arange(5) / 2})
    text = files.write_table(tmp_path / "t.csv", table).read_text().splitlines()
    assert text == ["'=a,b", "'=1+1,0", "-3,0.5", "'@x,1", "'+y,1.5", "a,2"]


def test_escapes_of_a_file_do_not_reach_the_terminal(tmp_path):
    error = InputError("a", "value \x1b[2J" + "x" * 100_000, "correct it")
    assert str(error).isprintable() and len(str(error)) < 2000


def test_a_campaign_whose_first_file_found_no_room_is_simulated_again(tmp_path):
    out = tmp_path / "campaign"
    words = ["simulate", out, "--days", "0.03", "--seed", "3"]
    limited = run(*words, **limit_files(3000))
    assert limited.returncode == 1 and len(limited.stderr.splitlines()) == 1 and not list(out.rglob("*.part"))
    (out / "truth.toml.another.1.0a0a0a0a.part").write_text("left")
    assert run(*words).returncode == 0


@pytest.mark.parametrize("size", [3000, 20000])
def test_a_full_disk_ends_no_process_that_writes_hdf5(tmp_path, size):
    """The library itself fails once more where it closes a file that found no room: a trace on the screen, or worse."""
    code = ("import sys, numpy as np; from pathlib import Path; "
            "from probupdate.virtual.campaign_files import write_acceleration\n"
            "try: write_acceleration(Path(sys.argv[1]), np.ones((20000, 3)), np.datetime64('2020-01-01T00:00'), 10.0)\n"
            "except OSError as error: print(error.strerror, error.filename)")
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.h5")], capture_output=True, text=True,
                          **limit_files(size))
    assert done.returncode == 0 and not done.stderr and "File too large" in done.stdout and "a.h5" in done.stdout
    assert not list(tmp_path.iterdir())


def test_a_folder_may_have_the_name_of_an_option_s_choice():
    assert argument_paths(build_parser().parse_args(["convert", "raw", "campaign"])) == ["raw"]


def test_a_posterior_is_not_written_over_another_steps_result():
    with pytest.raises(InputError, match="ends in .nc"):
        refuse_overwriting("sample", "run/update.json", [])
    refuse_overwriting("sample", "run/posterior.nc", [])
