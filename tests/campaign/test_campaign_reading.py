"""campaign.toml, the records' heads and SCADA: what is read, and one clear line for every mistake."""

import numpy as np
import pandas as pd
import pytest

from probupdate.campaign.reading import read_campaign
from probupdate.campaign.scada import (
    StateRule,
    block_conditions,
    read_scada,
    row_states,
    turning_range,
    with_rated_power,
)
from probupdate.errors import InputError


def test_a_campaign_is_read_in_the_order_of_the_starts(campaign_folder, signal):
    folder = campaign_folder([(600, signal(6000)), (0, signal(6000))], names=["a.h5", "z.h5"])
    campaign = read_campaign(folder)
    assert campaign.channels == ("a-x", "a-y")
    assert [f.path.name for f in campaign.files] == ["z.h5", "a.h5"]
    assert campaign.unit_factor == pytest.approx([1.0, 9.80665])
    assert campaign.scada is None and campaign.water_depth_m is None and campaign.x_axis_heading_deg == 180


def test_a_byte_order_mark_of_an_editor_is_no_mistake(campaign_folder, signal):
    head = campaign_folder([(0, signal(10))]) / "campaign.toml"
    head.write_bytes(b"\xef\xbb\xbf" + head.read_bytes())
    assert read_campaign(head.parent).channels == ("a-x", "a-y")


WRONG_HEADS = [
    ('sampling_rate_hz = 10.0', 'sampling_rate = 10.0', "unknown key 'sampling_rate'", "mean 'sampling_rate_hz'"),
    ('sampling_rate_hz = 10.0', '', "'sampling_rate_hz' is missing", "add it"),
    ('sampling_rate_hz = 10.0', 'sampling_rate_hz = "10"', "'10' is not a number", "without quotes"),
    ('block_minutes = 10', 'block_minutes = 0', "0 is not a number above 0", "another"),
    ('block_minutes = 10', 'block_minutes = 10\nx_axis_heading_deg = 400', "400 is not in -360 to 360", "another"),
    ('block_minutes = 10', 'block_minutes = 0.001', "0.001 minutes at 10 Hz are fewer", "at least 0.167 minutes"),
    ('block_minutes = 10', 'block_minutes = 0.12', "at 10 Hz are fewer than 100 samples", "at least 0.167 minutes"),
    ('block_minutes = 10', 'block_minutes = 1e9', "1e+09 is more than a day", "such as 30"),
    ('sampling_rate_hz = 10.0', 'sampling_rate_hz = 1e9', "1e+09 Hz is above 100000", "samples a second"),
    ('sampling_rate_hz = 10.0', 'sampling_rate_hz = 1e5', "960 MB a block", "at most 1.4 minutes"),
    ('name = "Small"', 'name = "Small', "not TOML", "correct"),
    ('channel = "a-y"', 'channel = "a-x"', "the channel is listed twice", "once"),
    ('channel = "a-y"', 'channel = ""', "'' is empty", "another"),
    ('channel = "a-y"', 'chanel = "a-y"', "unknown key 'chanel'", "did you mean 'channel'"),
    ('level = "a"', '', "'level' is missing", "add it"),
    ('unit = "g"', 'unit = "kg"', "unit 'kg' is none of acceleration", "m/s2"),
    ('unit = "g"', 'unit = "mm/s"', "unit 'mm/s' is none of acceleration", "m/s2"),
    ('quantity = "acceleration"', 'quantity = "accel"', "quantity 'accel' is unknown", "acceleration"),
    ('direction = [0.0, 1.0, 0.0]', 'direction = [0.0, 2.0, 0.0]', "not a unit vector", "add up to 1"),
]


@pytest.mark.parametrize(("right", "wrong", "problem", "remedy"), WRONG_HEADS, ids=[w[2] for w in WRONG_HEADS])
def test_every_mistake_in_the_head_has_its_line(campaign_folder, signal, head, right, wrong, problem, remedy):
    assert right in head
    folder = campaign_folder([(0, signal(10))], head=head.replace(right, wrong))
    with pytest.raises(InputError) as error:
        read_campaign(folder)
    assert "campaign.toml" in error.value.where or "sensor" in error.value.where
    assert problem in error.value.problem and remedy in error.value.remedy
    assert "\n" not in str(error.value).strip()


def test_a_folder_without_its_parts(tmp_path, campaign_folder, head):
    with pytest.raises(InputError, match="is not a directory"):
        read_campaign(tmp_path / "none")
    (tmp_path / "campaign").mkdir()
    with pytest.raises(InputError, match=r"is not a directory; give the folder .*; did you mean '.*campaign'"):
        read_campaign(tmp_path / "campaing")
    with pytest.raises(InputError, match="no such file"):
        read_campaign(tmp_path)
    with pytest.raises(InputError, match=r"holds no \.h5 file"):
        read_campaign(campaign_folder([]))
    (tmp_path / "campaign.toml").write_text(head.split("[[sensor]]")[0])
    with pytest.raises(InputError, match=r"there is no \[\[sensor\]\]"):
        read_campaign(tmp_path)


def test_records_that_do_not_fit_the_head(campaign_folder, write_file, signal):
    folder = campaign_folder([(0, signal(10))])
    write_file(folder, "1.h5", "2019-06-03T11:00Z", signal(10), rate=25.0)
    with pytest.raises(InputError, match=r"1\.h5: is sampled at 25 Hz, campaign.toml says 10 Hz"):
        read_campaign(folder)
    write_file(folder, "1.h5", "2019-06-03T11:00Z", signal(10)[:, :1])
    with pytest.raises(InputError, match=r"1\.h5: 'data' is \(10, 1\), campaign.toml lists 2 channels"):
        read_campaign(folder)
    write_file(folder, "1.h5", "2019-06-03T11:00Z", signal(10), attributes={"start": "yesterday evening"})
    with pytest.raises(InputError, match="'yesterday evening' is not a time"):
        read_campaign(folder)
    (folder / "acceleration" / "1.h5").write_text("no HDF5")
    with pytest.raises(InputError, match=r"1\.h5: cannot be opened as HDF5"):
        read_campaign(folder)


def test_a_file_without_its_dataset_or_attribute(campaign_folder, signal):
    import h5py

    folder = campaign_folder([(0, signal(10))])
    with h5py.File(folder / "acceleration" / "0.h5", "r+") as file:
        del file["data"].attrs["start"]
    with pytest.raises(InputError, match="'data' has no attribute 'start'"):
        read_campaign(folder)
    with h5py.File(folder / "acceleration" / "0.h5", "r+") as file:
        del file["data"]
    with pytest.raises(InputError, match="holds no dataset 'data'"):
        read_campaign(folder)


def test_a_start_with_another_zone_is_brought_to_utc(campaign_folder, write_file, signal):
    folder = campaign_folder([])
    write_file(folder, "0.h5", "2019-06-03T12:00+02:00", signal(10))
    assert read_campaign(folder).files[0].start == pd.Timestamp("2019-06-03T10:00Z")


# SCADA -------------------------------------------------------------------------------------------------------------


def scada(**columns) -> pd.DataFrame:
    n = len(next(iter(columns.values())))
    index = pd.date_range("2019-06-03T10:00Z", periods=n, freq="10min", name="time")
    return pd.DataFrame(columns, index=index, dtype=float)


def test_scada_is_sorted_and_its_mistakes_named(tmp_path):
    path = tmp_path / "scada.csv"
    path.write_text("time,power_kw\n2019-06-03T10:10:00Z,2\n2019-06-03T10:00:00Z,1\n2019-06-03T10:10:00Z,3\n")
    table = read_scada(path)
    assert list(table["power_kw"]) == [1, 2] and str(table.index.tz) == "UTC"
    for text, problem in (
        ("date,power_kw\n1,2\n", "has no column 'time'"),
        ("time,power_kw\n2019-06-03T10:00:00Z,1\nyesterday,2\n", "row 3, time: 'yesterday' is not a time"),
        ("time,power_kw\n,2\n", "row 2: has no time"),
        ("time,power_kw\n2019-06-03T10:00:00Z,much\n", "power_kw: 'much' is not a number"),
        ("", "not a table"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=problem):
            read_scada(path)
    with pytest.raises(InputError, match="no such file"):
        read_scada(tmp_path / "none.csv")


def test_states_by_power_and_by_the_highest_power_where_the_rated_one_is_not_known():
    table = scada(power_kw=[-20, 10, 25, 26, 3000, 4850, 5000, np.nan])
    expected = ["idling"] * 3 + ["below rated"] * 2 + ["rated"] * 2 + ["unknown"]
    assert list(row_states(table, StateRule(rated_power_kw=5000))) == expected
    assert with_rated_power(StateRule(), table).rated_power_kw == 5000
    assert list(row_states(table, StateRule())) == expected
    assert set(row_states(table.drop(columns="power_kw"), StateRule())) == {"unknown"}


def test_conditions_of_a_block_are_those_of_its_own_rows():
    table = scada(
        power_kw=[9e3, -20, -20, -30, 9e3], nacelle_heading_deg=[90, 350, 10, 0, 90], pitch_deg=[0, 80, 81, 80, 0],
        pitch_deg_max=[0, 80, 90, 80, 0], pitch_deg_min=[0, 79, 81, 80, 0], wind_speed_mps=[1, np.nan, 3, 5, 1],
    )
    start = pd.Timestamp("2019-06-03T10:10Z")
    found = block_conditions(table, start, 30, StateRule(rated_power_kw=5000))
    assert found["state"] == "idling" and found["scada_rows"] == 3 and found["scada_coverage"] == 1
    assert found["wind_speed_mps"] == 4  # the row without a number is left out
    assert min(found["nacelle_heading_deg"], 360 - found["nacelle_heading_deg"]) < 1e-6  # across north
    assert found["nacelle_heading_deg_range"] == pytest.approx(20)
    assert found["pitch_deg_range"] == 11 and found["pitch_deg_max"] == 90
    assert "rotor_speed_rpm" not in found
    mixed = block_conditions(table, start - pd.Timedelta(minutes=10), 30, StateRule(rated_power_kw=5000))
    assert mixed["state"] == "mixed"


def test_a_block_within_ten_minutes_has_their_row():
    table = scada(wind_speed_mps=[1.0, 2.0, 3.0])
    rule, start = StateRule(rated_power_kw=5000), pd.Timestamp("2019-06-03T10:00Z")
    assert table.index[0] == start
    for minute, expected in ((0, 1.0), (5, 1.0), (12, 2.0), (24, 3.0)):
        found = block_conditions(table, start + pd.Timedelta(minutes=minute), 5, rule)
        assert (found["wind_speed_mps"], found["scada_rows"], found["scada_coverage"]) == (expected, 1, 1)
    for minute in (-5, 30):
        assert block_conditions(table, start + pd.Timedelta(minutes=minute), 5, rule)["scada_rows"] == 0


def test_conditions_without_rows_or_power_are_unknown():
    table = scada(wind_speed_mps=[1.0])
    late = pd.Timestamp("2019-06-05T00:00Z")
    assert block_conditions(None, late, 30, StateRule())["state"] == "unknown"
    assert block_conditions(table, late, 30, StateRule())["scada_rows"] == 0
    assert block_conditions(table, table.index[0], 30, StateRule())["state"] == "unknown"


def _speeds(share: float) -> dict[str, list[float]]:
    """Middle row of three: the rotor stands (0.1 rpm) for a share of it and turns at 12 rpm, else."""
    speed = np.where(np.arange(600) < 600 * share, 0.1, 12.0)
    return {"": [0.1, float(speed.mean()), 12.0], "_min": [0.1, 0.1, 11.8], "_max": [0.1, 12.0, 12.2],
            "_std": [0.0, float(speed.std()), 0.05]}


@pytest.mark.parametrize("share", (0.2, 0.5, 0.7))
@pytest.mark.parametrize("recorded", (("",), ("", "_min", "_max"), ("", "_min", "_max", "_std")))
@pytest.mark.parametrize("rows", ((0, 3), (1, 1)))
def test_a_rotor_that_stood_and_turned_has_the_speed_at_which_it_turned(share, recorded, rows):
    table = scada(**{f"rotor_speed_rpm{end}": _speeds(share)[end] for end in recorded})
    found = block_conditions(table, table.index[rows[0]], 10 * rows[1], StateRule())
    low, high = turning_range(found)
    assert found["rotor_speed_rpm_min"] < 11.7 and 11.7 < low <= high < 12.3


def test_a_rotor_that_passed_every_speed_turned_at_all_of_them():
    table = scada(rotor_speed_rpm=[6.0, 6.0], rotor_speed_rpm_min=[0.0, 0.0], rotor_speed_rpm_max=[12.0, 12.0],
                  rotor_speed_rpm_std=[12 / np.sqrt(12)] * 2)
    assert turning_range(block_conditions(table, table.index[0], 10, StateRule())) == (3.0, 12.0)
