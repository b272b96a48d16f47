"""`check` finds what was put in, and nothing in clean data."""

import json

import numpy as np
import pandas as pd
import pytest

from probupdate.campaign.blocks import blocks
from probupdate.campaign.checking import check
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.usable import no_block_remedy, remedy
from probupdate.errors import InputError


def four_channels(head: str) -> str:
    """a-x, a-y and two more along x at the same level, as on two legs."""
    more = head.split("[[sensor]]")[1]
    return head + "".join("[[sensor]]" + more.replace("a-x", name) for name in ("b-x", "c-x"))


def noise(n=12000, channels=4) -> np.ndarray:
    return np.random.default_rng(3).standard_normal((n, channels)) * np.array([1, 1 / 9.80665, 1, 1])


def conditions() -> pd.DataFrame:
    return pd.DataFrame({
        "time": ["2019-06-03T10:00:00Z", "2019-06-03T10:10:00Z"], "power_kw": [-20.0, 5000.0], "pitch_deg": [84.0, 0.0],
        "rotor_speed_rpm": [0.2, 14.0], "nacelle_heading_deg": [0.0, 0.0], "yaw_rate_degps": [0.0, 0.0],
        "wind_speed_mps": [3.0, 13.0], "water_level_m": [0.0, 0.1], "air_temperature_c": [12.0, 12.0],
    })


def test_clean_data_have_no_findings(campaign_folder, head):
    result = check(read_campaign(campaign_folder([(0, noise())], head=four_channels(head), scada=conditions())))
    assert result.findings == ()
    assert "2 blocks can be identified" in result.uses[0]
    assert list(result.blocks["state"]) == ["idling", "rated"]


def test_everything_that_was_put_in_is_found(campaign_folder, head, tmp_path):
    data = noise()
    data[:6000, 0] = 0.5  # flat in the first block
    data[7000, 1] += 30  # a spike
    data[:, 2] = np.clip(data[:, 2] + np.sin(np.arange(12000) / 50), -1.5, 1.5)  # clipped
    data[:, 3] *= 9.80665 * 2  # in another unit than its neighbours
    data[9000:9100, 1] = np.nan  # lost, and no reason to leave a block out
    # a-x is flat half of the time, so compare with the others of its direction
    folder = campaign_folder([(0, data), (590, data[:200]), (3600, data)], head=four_channels(head))
    result = check(read_campaign(folder))
    text = "\n".join(result.findings)
    for words in ("a-x is flat in 2 of 4 blocks", "a-y has 2 spikes", "c-x moves", "wrong unit or scale",
                  "no scada.csv", "blocks between the first and the last have no record",
                  "in 2 of 4 blocks, first 2019",
                  "a-y lacks 0.8 % of its samples: modes are identified from the pairs that were measured"):
        assert words in text, words
    assert next(f for f in result.findings if "clipped" in f).startswith("b-x")
    path = result.write(tmp_path / "check.json")
    content = json.loads(path.read_text())
    assert content["findings"] == list(result.findings) and len(content["channels"]) == 4


@pytest.mark.parametrize("value", [3e38, -2e9, np.inf])
def test_a_sample_that_no_sensor_measures_is_said_to_be_lost(campaign_folder, head, value):
    data = noise()
    data[7000, 1] = value
    campaign = read_campaign(campaign_folder([(0, data)], head=four_channels(head), scada=conditions()))
    (finding,) = check(campaign).findings
    assert finding.startswith("a-y has 1 sample beyond 1e+09 (SI)") and "in 1 block: counted as lost" in finding
    clean, damaged = blocks(campaign)
    assert not clean.notes and damaged.notes[0].startswith("1 sample of a-y beyond")
    assert np.isnan(damaged.data).sum(axis=0).tolist() == damaged.impossible.tolist() == [0, 1, 0, 0]


def test_a_dead_channel_costs_no_blocks_once_it_is_left_out(campaign_folder, head):
    data = noise()
    data[:, 1] = 0.25  # a-y never moves
    text = four_channels(head)
    folder = campaign_folder([(0, data)], head=text, scada=conditions())
    before = check(read_campaign(folder))
    # what identification would refuse is not promised
    assert before.uses[0] == "0 blocks can be identified"
    assert before.uses[1] == '2 more can be identified without a-y: write leave_out = ["a-y"] into campaign.toml'
    (folder / "campaign.toml").write_text('leave_out = ["a-y"]\n' + text)
    campaign = read_campaign(folder)
    assert campaign.channels == ("a-x", "b-x", "c-x") and campaign.left_out == ("a-y",)
    after = check(campaign)
    assert after.findings == () and after.uses[0] == "2 blocks can be identified"
    assert "a-y left out, as campaign.toml says" in after.uses
    block = next(blocks(campaign))
    assert block.data == pytest.approx(data[: len(block.data)][:, [0, 2, 3]].astype(np.float32))


@pytest.mark.parametrize(("value", "words"), [
    ('"a-y"', "is not a list"), ('["a_y"]', "'a_y' is not a channel; did you mean 'a-y'"),
    ('["a-x", "a-y", "b-x", "c-x"]', "leaves no channel"),
])
def test_a_mistaken_leave_out_is_one_line(campaign_folder, head, value, words):
    folder = campaign_folder([(0, noise())], head=f"leave_out = {value}\n" + four_channels(head))
    with pytest.raises(InputError, match=words):
        read_campaign(folder)


def test_a_wrong_unit_beside_its_like_is_a_suspicion(campaign_folder, head):
    data = noise()
    data[:, 3] *= 1000
    found = check(read_campaign(campaign_folder([(0, data)], head=four_channels(head), scada=conditions()))).findings
    assert [f for f in found if "c-x" in f and "wrong unit" in f] and all(
        f.startswith("suspect: ") for f in found if "wrong unit" in f)


@pytest.mark.parametrize("value", [7999.0, -50.0])
def test_samples_that_stand_alone_are_lost_to_every_step(campaign_folder, head, value):
    """As a logger's number beyond its range; an impact of that size rings."""
    data = noise()
    data[3000:3060, 1] += 8 * np.exp(-0.1 * np.arange(60)) * np.cos(np.arange(60))
    data[[500, 9000], 0] = value
    campaign = read_campaign(campaign_folder([(0, data)], head=four_channels(head)))
    lost = np.isnan(np.concatenate([block.data for block in blocks(campaign)]))
    assert np.argwhere(lost).tolist() == [[500, 0], [9000, 0]]
    assert "a-x has 2 spikes that stand alone, in 2 blocks" in check(campaign).findings


def test_a_storm_of_impacts_is_no_spike(campaign_folder, head):
    """A ringing answer to a blow is signal: 20 standard deviations high, but not alone."""
    data = noise() * 0.05
    t = np.arange(300) / 10
    ring = 20 * np.exp(-t / 5) * np.cos(2 * np.pi * 2.0 * t)
    data[3000:3300] += ring[:, None]
    result = check(read_campaign(campaign_folder([(0, data)], head=four_channels(head), scada=conditions())))
    assert not [f for f in result.findings if "spike" in f]


def test_scada_rows_of_one_time_are_counted_where_they_differ(campaign_folder, head):
    table = conditions()
    changed = table.assign(power_kw=1.0)
    for more, words in ((table, ""), (changed, "2 SCADA rows with the time of an earlier one and other values")):
        folder = campaign_folder([(0, noise())], head=four_channels(head), scada=pd.concat([table, more]))
        text = "\n".join(check(read_campaign(folder)).findings)
        assert ("the time of an earlier one" in text) == bool(words) and words in text
        assert read_campaign(folder).scada["power_kw"].tolist() == [-20.0, 5000.0]
    folder = campaign_folder([(0, noise())], head=four_channels(head), scada=table[:0])
    assert "SCADA has a header and no rows" in "\n".join(check(read_campaign(folder)).findings)


def test_missing_scada_columns_say_what_cannot_be_done(campaign_folder, head):
    table = conditions().drop(columns=["pitch_deg", "rotor_speed_rpm"])
    table.loc[1, "time"] = "2019-06-03T10:20:00Z"
    result = check(read_campaign(campaign_folder([(0, noise())], head=four_channels(head), scada=table)))
    text = "\n".join(result.findings)
    assert "SCADA has no pitch_deg; it is needed for: criterion 'no pitching'" in text
    assert "SCADA has no rotor_speed_rpm; it is needed for: harmonics distinguished from modes" in text
    assert "1 of 3 SCADA rows are missing" in text


def test_progress_is_told(campaign_folder, head):
    reports = []
    campaign = read_campaign(campaign_folder([(0, noise())], head=four_channels(head)))
    check(campaign, progress=lambda *a: reports.append(a))
    assert reports[-1] == ("checking blocks", 2, 2)


@pytest.mark.parametrize("more", [1, 5, 900])
def test_what_is_cut_off_at_the_end_is_no_fault_of_channels(campaign_folder, head, more):
    found = check(read_campaign(campaign_folder([(0, noise(n=12000 + more))], head=four_channels(head)))).findings
    assert any("1 block at the ends of recordings" in f for f in found)
    assert not [f for f in found if "lack" in f or "flat" in f or "suspect" in f]


def test_records_shorter_than_a_block_are_the_blocks_fault_not_the_sensors(campaign_folder, head):
    data = noise(n=4500)  # 7.5 minutes of blocks of 10
    campaign = read_campaign(campaign_folder([(0, data)], head=four_channels(head)))
    text = "\n".join(check(campaign).findings)
    assert "no record covers a whole block: set block_minutes in campaign.toml to 7.5 or less" in text
    assert "all channels lack 25.0 %" in text and "a-x lacks" not in text and "gaps too long" not in text
    # two that follow each other are one
    whole = read_campaign(campaign_folder([(300, noise(n=4500)), (750, noise(n=2000))], head=four_channels(head)))
    assert no_block_remedy(whole) == ""


@pytest.mark.parametrize(("value", "dead"), [(0.0, [1]), (np.nan, [1]), (0.0, [1, 3])])
def test_dead_channels_are_named_with_the_advice_of_check(campaign_folder, head, value, dead):
    data = noise(channels=4)
    data[:, dead] = value
    campaign = read_campaign(campaign_folder([(0, data)], head=four_channels(head)))
    names = [campaign.channels[k] for k in dead]
    advice = f"write leave_out = {json.dumps(names)} into campaign.toml"
    assert remedy(campaign) == f"{advice}: 2 of 2 blocks can be used without it"
    if len(dead) == 1:
        assert f"2 more can be identified without {names[0]}: {advice}" in check(campaign).uses
