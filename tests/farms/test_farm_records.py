"""A month is known by what its records hold; months stand in the order in which they are read."""

import os

import h5py
import numpy as np
from farm_cases import write_farm

from probupdate.campaign.blocks import block_files
from probupdate.campaign.reading import read_campaign
from probupdate.farms.description import natural_order, read_farm
from probupdate.farms.month import month_sources
from probupdate.identification import block_store
from probupdate.identification.block_poles import BlockPoles
from probupdate.identification.ssi import Poles


def test_a_record_of_the_same_name_and_size_is_another(tmp_path):
    farm = read_farm(write_farm(tmp_path / "data"))
    month = farm.months[0]
    before, path = month_sources(month, farm), next(month.campaign.rglob("*.h5"))
    size = path.stat().st_size
    with h5py.File(path, "r+") as file:
        file["data"][10, 0] += 1.0
    os.utime(path, (1.6e9, 1.6e9))
    assert path.stat().st_size == size
    after = month_sources(month, farm)
    assert after["records"] != before["records"]
    assert {k: v for k, v in after.items() if k != "records"} == {k: v for k, v in before.items() if k != "records"}


def test_blocks_of_a_replaced_record_are_forgotten_and_no_others(tmp_path):
    write_farm(tmp_path / "data")
    farm = read_farm(next((tmp_path / "data").rglob("farm.toml")))
    folder = farm.months[0].campaign
    campaign = read_campaign(folder)
    store, starts = tmp_path / "blocks", list(block_files(campaign))
    store.mkdir()
    poles = Poles(order=2, frequency_hz=np.ones(1), damping_ratio=np.full(1, 0.01), shape=np.ones((3, 1), complex))
    block = BlockPoles(id="b", start=starts[0], minutes=10.0, quantity="acceleration", excluded="", notes=(), rms=0.1,
                       poles=poles, others=(), line_hz=np.ones(2), spectrum=np.ones(2), unmeasured=np.zeros((3, 3)))
    now = block_store.sources(campaign.files)
    block_store.write_block_poles(store / "kept.poles.npz", block, [*now, "rotor 1 to 2 rpm"])
    block_store.write_block_poles(store / "other.poles.npz", block, [now[0].replace("content ", "content 0")])
    assert block_store.forget_changed(store, campaign.files) == 1
    assert [p.name for p in store.iterdir()] == ["kept.poles.npz"]


def test_months_are_sorted_as_they_are_read():
    names = ["2019-10", "2019-9", "2020-1", "a2", "2019-1", "a10"]
    assert sorted(names, key=natural_order) == ["2019-1", "2019-9", "2019-10", "2020-1", "a2", "a10"]
    words = ["2019-11", "Apr 2020", "Oct 2019", "2019-9", "Dez_2019", "March 2020", "Marburg 2020"]
    assert sorted(words, key=natural_order) == [
        "2019-9", "Oct 2019", "2019-11", "Dez_2019", "March 2020", "Apr 2020", "Marburg 2020"]
