"""A farm whose records are replaced and whose folders are misnamed: what is done again, and what is said."""

import os
import shutil

import numpy as np
import pytest
from farm_cases import DESCRIPTION, write_campaign, write_farm

import probupdate
from probupdate.farms.description import read_farm
from probupdate.farms.month import MonthState, month_sources, still_finished
from probupdate.identification.block_store import stored_settings
from probupdate.modal.modes import read_modes


@pytest.fixture
def farm(tmp_path):
    """Two months of one turbine, identified and updated."""
    description = write_farm(tmp_path / "data")
    shutil.rmtree(tmp_path / "data" / "B")
    text = DESCRIPTION.replace('"select", "update", "diagnose"]', '"update"]').replace(
        DESCRIPTION[DESCRIPTION.index("[select]"): DESCRIPTION.index("[[turbine]]")], "")
    description.write_text(text[: text.index('[[turbine]]\nname = "B"')])
    first = probupdate.farm(description, tmp_path / "out")
    assert first.run == 2 and not first.failed, first.summary
    return description, tmp_path / "out"


def lowest_hz(out, month):
    return sorted(s.frequency_hz[0] for s in read_modes(out / "A" / month / "modes.json").sets)[1]


def replaced(description, month, factor=0.81):
    """The month's record becomes that of a softer building: same name, same size, same time of change."""
    record, other = description.parent / "A" / month / "acceleration" / "all.h5", description.parent / "other"
    stat = record.stat()
    write_campaign(other, factor, 7, f"{month}-01T00:00:00Z")
    content = (other / "acceleration" / "all.h5").read_bytes()
    assert len(content) == stat.st_size
    record.write_bytes(content)
    os.utime(record, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    shutil.rmtree(other)


def test_a_record_replaced_by_one_of_its_name_and_size_is_seen(farm):
    description, out = farm
    before = lowest_hz(out, "2024-05")
    times = {p: p.stat().st_mtime_ns for p in (out / "A" / "2024-05").rglob("*.poles.npz")}
    replaced(description, "2024-06")
    run = probupdate.farm(description, out)
    assert run.run == 1 and not run.failed, run.summary
    # as stiff by a factor of 0.81: 0.9 of the frequency, known to a per cent from such blocks
    assert lowest_hz(out, "2024-06") / before == pytest.approx(0.9, abs=0.02)
    assert times and {p: p.stat().st_mtime_ns for p in times} == times


def test_a_record_that_other_settings_are_proposed_for_is_identified_anew(farm):
    """Lower frequencies ask for more block rows, of which the poles kept were not."""
    description, out = farm
    before, store = lowest_hz(out, "2024-06"), out / "A" / "2024-06" / "modes.json.blocks"
    settings = stored_settings(store)
    replaced(description, "2024-06", 0.6)
    run = probupdate.farm(description, out)
    assert run.run == 1 and not run.failed, run.summary
    assert stored_settings(store) != settings
    assert lowest_hz(out, "2024-06") / before == pytest.approx(np.sqrt(0.6), abs=0.02)


def test_another_change_finds_no_blocks_of_other_records(farm):
    description, out = farm
    replaced(description, "2024-06")
    parameters = description.parent / "parameters.toml"
    parameters.write_text(parameters.read_text().replace("0.15", "0.2"))
    description.write_text(description.read_text().replace("lowest = 3", "lowest = 3\norder = 12"))
    run = probupdate.farm(description, out)
    assert run.run == 2 and not run.failed and all(row.frequency for row in run.rows), run.summary


def test_only_steps_whose_inputs_changed_are_done_again(farm):
    description, out = farm
    before = {p: p.stat().st_mtime_ns for p in out.rglob("modes.json")}
    text = description.read_text()
    description.write_text(text.replace('[identify]\n', '[update]\nfrequencies = "log"\n[identify]\n'))
    assert probupdate.farm(description, out).run == 2
    assert len(before) == 2 and {p: p.stat().st_mtime_ns for p in before} == before
    # a record that was only touched is the same record
    (description.parent / "A" / "2024-05" / "acceleration" / "all.h5").touch()
    assert probupdate.farm(description, out).run == 0


def test_corrected_scada_is_in_the_conditions_of_the_sets(tmp_path):
    """They stand in modes.json: the month's sets were chosen by what SCADA had said before."""
    farm = read_farm(write_farm(tmp_path))
    before = month_sources(farm.months[0], farm)
    known = MonthState(format=1, made_of=before, finished=dict.fromkeys(farm.steps, 1.0))
    assert list(still_finished(known, farm, before)) == list(farm.steps)
    (farm.months[0].campaign / "scada.csv").write_text("time,wind_speed_mps\n")
    assert not still_finished(known, farm, month_sources(farm.months[0], farm))


def test_folders_without_a_campaign_are_in_a_line(farm):
    description, out = farm
    for name, file in (("2024-07", "campain.toml"), ("2024-08", "notes.txt")):
        (description.parent / "A" / name).mkdir()
        (description.parent / "A" / name / file).write_text("")
    run = probupdate.farm(description, out)
    assert "A, 2024-07: left out: has no campaign.toml; rename campain.toml if that is it" in run.summary
    assert "A, 2024-08: left out: has no campaign.toml" in run.summary and "2 turbine-months: 2 done" in run.summary
    assert "Folders left out" in (out / "farm.html").read_text() and "2024-08" in (out / "farm.csv").read_text()
