"""Tables as they are published: a few sets without standard deviations, frequencies alone."""

import json

import pytest

from probupdate.cli import main
from probupdate.modal.modes import ModalData, write_modes


def command(tmp_path, frame_file, record, *options, n=2, **hidden):
    whole = record(4, **hidden)
    write_modes(ModalData(channels=whole.channels, sets=whole.sets[:n]), tmp_path / "modes.json")
    code = main(["diagnose", "--model", str(frame_file), "--modes", str(tmp_path / "modes.json"), "--no-extend",
                 "--out", str(tmp_path / "d.json"), *options])
    return code, json.loads((tmp_path / "d.json").read_text()) if code == 0 else None


def test_two_sets_without_scatter_name_the_options_to_state_it(tmp_path, frame_file, record, capsys):
    code, _ = command(tmp_path, frame_file, record)
    assert code == 2
    assert "--frequency-std" in capsys.readouterr().err


@pytest.mark.parametrize("hidden, verdicts", [({}, {"none"}), ({"gain": ("x4", 1.4)}, {"named"})])
def test_two_sets_with_a_stated_scatter_are_diagnosed(tmp_path, frame_file, record, hidden, verdicts):
    code, found = command(tmp_path, frame_file, record, "--frequency-std", "0.001", "--shape-std", "0.005", **hidden)
    assert code == 0 and found["verdict"] in verdicts
    assert [f["location"] for f in found["findings"]] == ([hidden["gain"][0]] if hidden else [])


def test_frequencies_alone_blame_no_sensor(tmp_path, frame_file, record):
    code, found = command(tmp_path, frame_file, record, "--shapes", "none", n=20, gain=("x4", 1.4))
    assert code == 0 and found["verdict"] == "none"
    assert any("no set has a shape" in note for note in found["notes"])


@pytest.mark.parametrize(("option", "share", "remedy"), [
    ("--frequency-std", "5", "0.05 for 5 %"), ("--shape-std", "2", "0.02 for 2 %")])
def test_a_scatter_in_per_cent_is_refused_with_its_share(tmp_path, frame_file, record, capsys, option, share, remedy):
    code, _ = command(tmp_path, frame_file, record, option, share)
    said = capsys.readouterr().err
    assert code == 2 and f"{share} is no share" in said and remedy in said


@pytest.mark.parametrize(("stated", "option", "kind"), [
    ((0.003, 0.01), "--frequency-std", "frequency"), ((0.003, 0.01), "--shape-std", "shape"),
    ((None, None), "--shape-std", None)])
def test_a_scatter_that_replaces_nothing_is_refused(tmp_path, frame_file, record, capsys, stated, option, kind):
    data = record(4).with_std(*stated)
    write_modes(data, tmp_path / "modes.json")
    code = main(["diagnose", "--model", str(frame_file), "--modes", str(tmp_path / "modes.json"), "--no-extend",
                 *(["--shapes", "none"] if kind is None else []), "--out", str(tmp_path / "d.json"), option, "0.05"])
    said = capsys.readouterr().err
    assert code == 2 and f"no {kind or 'shape'} lacks a standard deviation above zero" in said
