"""Poles picked and rejected by hand: what `identify` makes of them, and which choices it refuses."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
from known_frame import MACHINE_HZ, modes, nearest, pole, write_campaign, write_choice

import probupdate
from probupdate.errors import InputError
from probupdate.identification.block_store import choice_head, stored_block, stored_ids
from probupdate.modal.modes import mac, read_modes


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    """A campaign of two blocks and the folder of its poles."""
    folder = tmp_path_factory.mktemp("frame")
    campaign = write_campaign(folder / "campaign", blocks=2)
    probupdate.identify(campaign, store=folder / "blocks")
    return campaign, folder / "blocks"


def chosen(store, path, wanted=(20, 20, 20, 8), reject: bool = True):
    """A choice of the four modes, each at a model order, in the first block, without the machine."""
    first = stored_ids(store)[0]
    block = stored_block(store, first)
    picked = [pole(block, order, f) for order, f in zip(wanted, modes()[0], strict=True)]
    rejected = [pole(block, 20, MACHINE_HZ, reason="machine on storey 2")] if reject else []
    return write_choice(path, choice_head(store, [first]), picked, rejected), picked


def test_picked_poles_are_the_modes_and_no_others(frame, tmp_path, validation):
    campaign, store = frame
    path, picked = chosen(store, tmp_path / "choice.json")
    found = probupdate.identify(campaign, choice=path, store=store)
    first, second = found.data.sets
    np.testing.assert_allclose(first.frequency_hz, [p["frequency_hz"] for p in picked], rtol=1e-9)
    np.testing.assert_allclose(first.damping_ratio, [p["damping_ratio"] for p in picked], rtol=1e-6)
    # in the other block the same modes, followed by their frequency and shape
    frequency, shape = modes()
    row = validation(what="modes picked by hand in one block, followed into another: frequencies",
                     reference="frame by scipy.linalg.eigh, response by scipy.signal", unit="standard deviations")
    row.error(np.max(np.abs(second.frequency_hz - frequency) / second.frequency_std_hz), below=4.0)
    assert np.all(np.diag(mac(second.shape, shape)) > 0.99)
    assert np.all(np.isfinite(first.frequency_std_hz)) and np.all(first.frequency_std_hz < 0.01 * frequency)
    assert found.data.labels == ("1", "2", "3", "4")


def test_a_rejected_pole_is_gone_with_its_reason_in_the_record(frame, tmp_path):
    campaign, store = frame
    path, _ = chosen(store, tmp_path / "choice.json")
    found = probupdate.identify(campaign, choice=path, store=store)
    gone = found.poles[found.poles["criterion"] == "rejected"]
    assert set(gone["reason"]) == {"machine on storey 2"} and set(found.poles["reason"]) == {"", *gone["reason"]}
    assert len(gone) > 5 and np.all(np.abs(gone["frequency_hz"] - MACHINE_HZ) < 0.05)
    assert "machine on storey 2" in found.summary and "4 poles in 1 block" in found.summary
    found.write(tmp_path / "modes.json")
    kept = read_modes(tmp_path / "modes.json").choice
    assert kept == found.data.choice and kept.rejected[0].reason == "machine on storey 2"
    assert json.loads(path.read_text())["picked"] == [
        {k: v for k, v in asdict(p).items() if k != "reason"} for p in kept.picked]


def test_the_report_says_that_modes_were_picked_by_hand(frame, tmp_path):
    from probupdate.reporting.measurement_sections import identification_section
    from probupdate.reporting.run_files import read_run

    campaign, store = frame
    path, _ = chosen(store, tmp_path / "choice.json")
    probupdate.identify(campaign, choice=path, store=store).write(tmp_path / "modes.json")
    (tmp_path / "modes.poles.csv").unlink()
    items = identification_section(read_run(tmp_path, lambda *a: None)).items
    (found,) = (i for i in items if getattr(i, "title", "") == "Modes picked by hand")
    assert found.statements[0] == "Modes as picked by hand: 4 poles in 1 block, 1 rejected."
    assert "machine on storey 2" in found.statements[1]


def test_picks_in_two_blocks_are_one_mode_where_alike(frame, tmp_path):
    campaign, store = frame
    ids = stored_ids(store)
    blocks = [stored_block(store, one) for one in ids]
    frequency = modes()[0]
    picked = [pole(blocks[0], 20, f) for f in frequency[:3]] + [pole(blocks[1], 18, f) for f in frequency[1:]]
    path = write_choice(tmp_path / "choice.json", choice_head(store, ids), picked, [])
    sets = probupdate.identify(campaign, choice=path, store=store).data.sets
    assert sets[0].frequency_hz.size == 4
    # where something was picked, nothing else stands
    assert np.array_equal(sets[0].measured, [True, True, True, False])
    assert np.array_equal(sets[1].measured, [False, True, True, True])


def test_a_choice_made_on_other_records_is_refused(frame, tmp_path):
    _, store = frame
    path, _ = chosen(store, tmp_path / "choice.json")
    other = write_campaign(tmp_path / "other", seed=8)
    with pytest.raises(InputError, match="was made on other records: block 2026-01-01T00:00Z was made of b0.h5"):
        probupdate.identify(other, choice=path)
    text = (other / "campaign.toml").read_text()
    (other / "campaign.toml").write_text(text.replace("storey-4", "roof"))
    with pytest.raises(InputError, match=r"other channels .*storey-4 .* there, roof .* here"):
        probupdate.identify(other, choice=path)


def spoilt(content: dict, how: str) -> None:
    if how == "pole":
        content["picked"][0]["frequency_hz"] *= 1.01
    elif how == "twins":
        content["picked"][1] = content["picked"][0] | content["twin"]
    elif how == "block":
        content["blocks"][0]["id"] = "2026-01-02T00:00Z"
        for p in content["picked"]:
            p["block"] = "2026-01-02T00:00Z"
    elif how == "none":
        content["picked"] = []
    elif how == "both":
        content["rejected"] = [content["picked"][0]]
    elif how == "order":
        content["picked"][0] |= {"order": 998}
    content.pop("twin")


@pytest.mark.parametrize(("how", "said"), [
    ("pole", "has no pole at 1.6"), ("twins", "which are one mode; keep one of them"),
    ("block", "has no block 2026-01-02"), ("none", "no pole was picked"), ("both", "stands twice"),
    ("order", "has not"),
])
def test_a_choice_that_is_not_of_these_poles_is_refused(frame, tmp_path, how, said):
    campaign, store = frame
    path, picked = chosen(store, tmp_path / "choice.json", reject=False)
    content = json.loads(path.read_text())
    k, f, zeta = nearest(stored_block(store, picked[0]["block"]), 18, picked[0]["frequency_hz"])
    content["twin"] = {"order": 18, "index": k, "frequency_hz": f, "damping_ratio": zeta}
    spoilt(content, how)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=said):
        probupdate.identify(campaign, choice=path, store=store)


def test_poles_that_differ_by_rounding_are_found_again(frame, tmp_path):
    campaign, store = frame
    path, picked = chosen(store, tmp_path / "choice.json", reject=False)
    content = json.loads(path.read_text())
    content["blocks"][0]["poles_hash"] = "0" * 32
    content["picked"][0]["frequency_hz"] *= 1 + 1e-9
    path.write_text(json.dumps(content))
    found = probupdate.identify(campaign, choice=path, store=store)
    assert found.data.sets[0].frequency_hz[0] == pytest.approx(picked[0]["frequency_hz"], rel=1e-8)
    assert any("differ by rounding" in note for note in found.notes)


def test_settings_that_are_not_the_choices_are_refused(frame, tmp_path):
    from probupdate.identification.settings import IdentificationSettings

    campaign, store = frame
    path, _ = chosen(store, tmp_path / "choice.json")
    with pytest.raises(InputError, match="was made with order 20, and 30 is stated"):
        probupdate.identify(campaign, choice=path, settings=IdentificationSettings(order=30), store=store)


def test_singular_values_add_up_to_the_spectrum(frame):
    block = stored_block(frame[1], stored_ids(frame[1])[0])
    # four channels have four
    np.testing.assert_allclose(block.singular.sum(axis=0), block.spectrum, rtol=1e-4)
