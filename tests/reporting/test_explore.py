"""The page of `explore`: what it holds of stored poles and of a campaign, its size, and what it refuses."""

from __future__ import annotations

import base64
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from known_frame import modes, write_campaign

import probupdate
from probupdate.errors import InputError
from probupdate.identification.block_store import BlockStore, stored_block, stored_ids, stored_settings
from probupdate.identification.identify import SSISettings
from probupdate.identification.settings import IdentificationSettings
from probupdate.modal.modes import mac
from probupdate.model.interface import Wireframe
from probupdate.reporting import explore


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run's directory with campaign/, modes.json, its poles and their blocks."""
    folder = tmp_path_factory.mktemp("run")
    campaign = write_campaign(folder / "campaign", blocks=2)
    probupdate.identify(campaign, store=folder / "modes.json.blocks").write(folder / "modes.json")
    return folder


def data_of(page) -> dict:
    return json.loads(re.search(r'id="explore-data">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)[1])


def test_the_page_holds_the_stored_poles_of_a_run(run, tmp_path):
    found = probupdate.explore(run, tmp_path / "page.html")
    assert (found.shown, found.blocks) == (2, 2) and "2 of 2 blocks" in found.summary
    assert found.to_frame()["shown"].tolist() == [2]
    data = data_of(found.path)
    for values in data["blocks"]:
        block = stored_block(run / "modes.json.blocks", values["id"])
        order, index = np.array(values["order"]), np.array(values["index"])
        for poles in block.every_order:
            mine = order == poles.order
            np.testing.assert_allclose(np.array(values["hz"])[mine][np.argsort(index[mine])], poles.frequency_hz,
                                       rtol=1e-11)
        whole = np.frombuffer(base64.b64decode(values["shape"]), "<i2").reshape(len(order), 4, 2) / 32767
        whole = whole[..., 0] + 1j * whole[..., 1]
        assert np.all(np.abs(np.abs(whole).max(axis=1) - 1) < 1e-4)
        mine = np.flatnonzero(order == block.poles.order)
        assert np.all(np.diag(mac(whole[mine].T, block.poles.shape[:, index[mine]])) > 1 - 1e-6)
        level = 10 * np.log10(block.singular[0][1:])
        assert np.allclose(np.array(values["lines"][0][1:]), level, atol=0.06)
    # of every pole of the block that it opens with, of the modes in others
    first = next(b for b in data["blocks"] if b["id"] == data["first"])
    assert None not in first["hz_std"]
    for values in data["blocks"]:
        labelled = [k for k, mode in enumerate(values["mode"]) if mode]
        assert len(labelled) >= 4 and all(values["hz_std"][k] is not None for k in labelled)


def test_the_page_needs_no_other_file_and_no_network(run, tmp_path):
    page = probupdate.explore(run, tmp_path / "page.html").path.read_text(encoding="utf-8")
    assert set(re.findall(r"https?://[^\"' ]*", page)) == {"http://www.w3.org/2000/svg"}
    assert not re.search(r"<(link|img|iframe)\b|<script[^>]* src|@import|url\(", page)
    assert "default-src 'none'" in page and page.count("<script>") == 1


def test_a_block_of_a_campaign_is_identified_and_that_is_said(run, tmp_path):
    found = probupdate.explore(run / "campaign", tmp_path / "page.html", block="2026-01-01T01:00Z",
                               settings=IdentificationSettings(order=14, rate_hz=20.0, block_rows=20))
    assert found.block == "2026-01-01T01:00Z" and (found.shown, found.blocks) == (1, 2)
    assert "was identified, as asked, of 2 blocks" in found.summary
    data = data_of(found.path)
    assert data["head"]["settings"]["order"] == 14
    # what would be the modes were this block all there is
    near = [min(abs(hz / f - 1) for _, hz in data["blocks"][0]["modes"]) for f in modes()[0]]
    assert max(near) < 0.01
    assert data["blocks"][0]["head"]["records"][0].startswith("b1.h5")


def test_more_blocks_than_a_page_holds_are_thinned_and_that_is_said(run, tmp_path, monkeypatch):
    source = tmp_path / "run"
    shutil.copytree(run / "modes.json.blocks", source / "modes.json.blocks")
    for name in ("modes.json", "modes.deviations.h5"):
        shutil.copy(run / name, source)
    store = source / "modes.json.blocks"
    block = stored_block(store, stored_ids(store)[0])
    from probupdate.identification.block_store import write_block_poles

    for k in range(2, 60):
        start = block.start + pd.Timedelta(hours=k)
        write_block_poles(store / f"{start:%Y%m%dT%H%M%SZ}.poles.npz",
                          replace(block, id=f"{start:%Y-%m-%dT%H:%MZ}", start=start), ["made up"])
    monkeypatch.setattr(explore, "MOST_BYTES", 300_000)
    found = probupdate.explore(source, tmp_path / "page.html")
    assert 5 < found.shown < found.blocks == 60
    text = found.path.read_text(encoding="utf-8")
    assert len(text) < 500_000 and f"{found.shown} of 60 blocks are in this page" in text
    times = pd.to_datetime([b["id"] for b in data_of(found.path)["blocks"]])
    assert times.is_monotonic_increasing and times[-1] - times[0] > pd.Timedelta(hours=50)


def test_a_model_s_nodes_follow_a_shape_of_its_own(run, tmp_path, validation):
    row = validation(what="shape of a model's nodes continued from its sensors", reference="the mode itself",
                     unit="", why="rounding of the page's matrix")
    store, ids = run / "modes.json.blocks", stored_ids(run / "modes.json.blocks")
    campaign = probupdate.verbs.exploring.read_campaign(run / "campaign")
    height = np.linspace(0, 12, 25)
    moved = np.zeros((25, 3, 3))
    moved[:, 0] = np.column_stack([np.sin((2 * k - 1) * np.pi * height / 24) for k in (1, 2, 3)])
    wire = Wireframe(node_m=np.column_stack([0 * height, 0 * height, height]), displacement=moved,
                     line=np.column_stack([np.arange(24), np.arange(1, 25)]), line_group=("column",) * 24)
    at_sensors = moved[[6, 12, 18, 24], 0]
    explore.write_explorer(explore.PoleSource(title="t", folder=store, ids=ids, first=ids[0], sensors=campaign.sensors,
                                              wire=wire, at_sensors=at_sensors), tmp_path / "page.html")
    data = data_of(tmp_path / "page.html")
    node = (np.array(data["node_matrix"]) @ at_sensors).reshape(25, 3, 3)
    row.error(np.max(np.abs(node - moved)), below=5e-4)
    point = (np.array(data["point_matrix"]) @ at_sensors).reshape(4, 3, 3)
    np.testing.assert_allclose(point[:, 0], at_sensors)


def test_neighbouring_sensors_are_joined_by_the_shortest_lines():
    points = np.array([[0, 0, 0], [0, 0, 9.0], [0, 0, 3.0], [5.0, 0, 3.0]])
    assert {tuple(sorted(line)) for line in explore.neighbours(points).tolist()} == {(0, 2), (1, 2), (2, 3)}


def test_standard_deviations_of_the_page_are_those_of_the_pole(run):
    """Of a pole by itself, not of an average over orders: larger than the scatter of the averages."""
    campaign, store = run / "campaign", run / "modes.json.blocks"
    opened = probupdate.verbs.exploring.read_campaign(campaign)
    blocks = BlockStore(store, opened, replace(SSISettings(), **stored_settings(store)).of_blocks)
    block = stored_block(store, stored_ids(store)[0])
    std = blocks.std_of(block)
    assert set(std) == {(p.order, k) for p in block.every_order for k in range(len(p.frequency_hz))}
    for f in modes()[0]:
        k = int(np.argmin(np.abs(block.poles.frequency_hz - f)))
        assert abs(block.poles.frequency_hz[k] - f) < 5 * std[block.poles.order, k][0] < 0.05 * f


@pytest.mark.parametrize(("how", "said"), [
    ("nothing", "holds neither campaign.toml nor modes.json"), ("no blocks", "there are no poles to show"),
    ("setups", "poles of several setups"), ("block", "has no block 2031"), ("settings", "holds poles already"),
    ("channels", "has other channels than modes.json"), ("campaign block", "has no block 2031"),
])
def test_what_cannot_be_shown_is_refused_in_one_line(run, tmp_path, how, said):
    source, more = tmp_path / "run", {}
    source.mkdir()
    if how != "nothing":
        shutil.copy(run / "modes.json", source)
    if how in ("block", "settings", "channels"):
        source = run
    if how == "setups":
        (source / "modes.json.blocks" / "one").mkdir(parents=True)
    if how == "campaign block":
        source = run / "campaign"
    if "block" in how and "no" not in how:
        more = {"block": "2031-01-01T00:00Z"}
    if how == "settings":
        more = {"settings": IdentificationSettings(order=30)}
    if how == "channels":
        other = write_campaign(tmp_path / "other")
        (other / "campaign.toml").write_text((other / "campaign.toml").read_text().replace("storey-4", "roof"))
        more = {"campaign": other}
    with pytest.raises(InputError, match=said):
        probupdate.explore(source, tmp_path / "page.html", **more)
    assert not (tmp_path / "page.html").exists()
