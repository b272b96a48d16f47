"""[joint] in farm.toml: one inference after the turbines' own, kept until something changes, refused early."""

import csv
import shutil

import pytest
from farm_cases import DESCRIPTION, write_farm

import probupdate
from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.farms.description import read_farm
from probupdate.updating.joint_file import read_joint

JOINT = DESCRIPTION.replace(', "diagnose"', "").replace("[diagnose]\nrecords = false\nextend = false\n", "")
VARYING = JOINT + '[joint]\nvarying = ["k1", "k2", "k3"]\n'


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joint")
    path = write_farm(folder / "data")
    path.write_text(VARYING)
    return path, folder / "out", probupdate.farm(path, folder / "out")


def test_every_turbine_and_month_has_its_values_and_the_page_shows_them(ran, validation):
    row = validation(what="springs of two buildings in one inference after records of half an hour, one 6 % softer",
                     reference="the drawn springs", unit="posterior standard deviations")
    _, out, run = ran
    found = read_joint(out / "farm_joint.json")
    assert run.joint.run and found.settled and found.converged and found.corrected
    for r in found.rows:
        row.error((r.mean - (-0.06 if r.turbine == "B" else 0.0)) / r.std, below=5)
        assert r.low < r.mean < r.high and r.role == "varying"
    changed = {(m.turbine, m.month) for m in found.months if m.changed}
    assert changed == {("B", "2024-06")} and len(found.months) == 12
    with (out / "farm_joint.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 6
    page = (out / "farm.html").read_text()
    assert "All turbines in one inference" in page and "What to measure next" in page and page.count("<svg") == 3
    assert "k1, mean over turbines" in run.summary and "what to measure next" in run.summary


@pytest.mark.long
def test_it_is_kept_until_something_it_is_made_of_changes(ran, tmp_path):
    path, out, _ = ran
    before = (out / "farm_joint.json").read_bytes()
    again = probupdate.farm(path, out)
    assert again.run == 0 and not again.joint.run and (out / "farm_joint.json").read_bytes() == before
    # by two processes the same bytes
    shutil.copytree(path.parent, tmp_path / "data")
    shutil.copytree(out, tmp_path / "out")
    (tmp_path / "out" / "farm_joint.json").unlink()
    both = probupdate.farm(tmp_path / "data" / "farm.toml", tmp_path / "out", jobs=2)
    assert both.run == 0 and both.joint.run and (tmp_path / "out" / "farm_joint.json").read_bytes() == before
    (tmp_path / "data" / "farm.toml").write_text(VARYING + "spread = 0.5\n")
    other = probupdate.farm(tmp_path / "data" / "farm.toml", tmp_path / "out")
    assert other.run == 0 and other.joint.run and "0.5 prior" in other.joint.found.settings["hyper-prior of tau"]


def test_a_shard_leaves_it_to_the_run_of_all(ran):
    path, out, _ = ran
    assert probupdate.farm(path, out, shard="1/2").joint is None


@pytest.mark.parametrize("text, said", [
    (JOINT + "[joint]\n", "names no parameter"),
    (JOINT + '[joint]\ncommon = ["k1"]\nvarying = ["k1"]\n', "under common and under varying"),
    (JOINT + '[joint]\nvaryng = ["k1"]\n', "varyng"),
    (JOINT.replace('"select", ', "").replace("[select]\npreset = \"structure\"\ncount = 2\n", "")
     + '[joint]\ncommon = ["k1"]\n', "needs 'select'"),
    (JOINT.split('[[turbine]]\nname = "B"')[0] + '[joint]\ncommon = ["k1"]\n', "several turbines"),
])
def test_a_table_that_cannot_be_is_refused(ran, tmp_path, text, said):
    path = ran[0].parent / "wrong.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_farm(path)


def test_an_unknown_parameter_is_refused_before_any_work(ran, tmp_path, capsys):
    path = ran[0].parent / "unknown.toml"
    path.write_text(JOINT + '[joint]\ncommon = ["k9"]\n')
    assert main(["farm", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "k9" in said and "choose from k1, k2, k3" in said and not (tmp_path / "out" / "A").exists()
