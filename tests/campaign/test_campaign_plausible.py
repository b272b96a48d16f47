"""Columns of time among the channels, and channels in another unit than the stated one."""

import numpy as np
import pandas as pd
import pytest
from scipy import linalg, signal

from probupdate.campaign.checking import check
from probupdate.campaign.converting import convert
from probupdate.campaign.findings import scale_findings
from probupdate.campaign.plausible import refuse_time
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.scada import read_scada
from probupdate.errors import InputError
from probupdate.identification.block_poles import usable_block
from probupdate.modal.modes import Sensor

RATE_HZ = 10.0


def head(units) -> str:
    return 'name = "b"\nsampling_rate_hz = 10.0\nblock_minutes = 10\n' + "".join(
        f'[[sensor]]\nchannel = "f{k + 1}"\nlevel = "f{k + 1}"\nposition_m = [0.0, 0.0, {3.0 * (k + 1)}]\n'
        f'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "{unit}"\n' for k, unit in enumerate(units))


def building(n: int = 3, size: int = 12000) -> np.ndarray:
    """Accelerations in m/s2 (size, n) of a shear building in the wind, with the sensors' own noise."""
    K = 500.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = 500.0
    value, shape = linalg.eigh(K)
    force = np.random.default_rng(5).standard_normal((size, n))
    motion = np.empty((size, n))
    for j, w in enumerate(np.sqrt(value)):
        b, a, _ = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 0.02 * w, w * w]), 1 / RATE_HZ, method="zoh")
        motion[:, j] = signal.lfilter(b.ravel(), a, force @ shape[:, j])
    return 1e-2 * (motion @ shape.T + 1e-3 * np.random.default_rng(6).standard_normal((size, n)))


def suspected(folder) -> list[str]:
    return [f for f in check(read_campaign(folder)).findings if "says?" in f or "stated in g" in f]


@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_building_in_its_unit_is_not_asked_about(campaign_folder, n):
    assert suspected(campaign_folder([(0, building(n))], head=head(["m/s2"] * n))) == []


@pytest.mark.parametrize("odd", [0, 1, 2])
def test_one_channel_of_three_in_g_is_asked_about(campaign_folder, odd):
    data = building()
    data[:, odd] /= 9.80665
    found = suspected(campaign_folder([(0, data)], head=head(["m/s2"] * 3)))
    assert len(found) == 1 and f"is f{odd + 1} in m/s2, as campaign.toml says?" in found[0], found
    assert "g and m/s2" in found[0]


def test_one_of_three_stated_in_g_that_is_not(campaign_folder):
    found = suspected(campaign_folder([(0, building())], head=head(["m/s2", "g", "m/s2"])))
    assert len(found) == 1 and "is f2 in g, as campaign.toml says?" in found[0], found


def test_one_of_three_in_g_stated_in_mg_is_asked_about_in_these_units(campaign_folder):
    said = check(read_campaign(campaign_folder([(0, building() / 9.80665)], head=head(["g", "mg", "g"])))).findings
    found = [f for f in said if f.startswith("suspect") and "f2" in f]
    assert len(found) == 1 and "mg and g" in found[0], said


def mast(height, both=True, size=36000):
    """Accelerations along x and y of a clamped uniform mast at height and at three places above it; its sensors."""
    root, place = np.array([1.87510407, 4.69409113, 7.85475744]), np.array([height, 0.4, 0.7, 1.0])
    k = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))
    shape = np.array([np.cosh(b * place) - np.cos(b * place) - c * (np.sinh(b * place) - np.sin(b * place))
                      for b, c in zip(root, k, strict=True)]).T
    rng, columns = np.random.default_rng(3), []
    for axis in range(2):
        y = 0.0
        for j, w in enumerate(2 * np.pi * 0.3 * (1 + 0.03 * axis) * (root[:2] / root[0]) ** 2):
            b, a, _ = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 0.02 * w, w * w]), 1 / RATE_HZ, method="zoh")
            y = y + np.outer(signal.lfilter(b.ravel(), a, rng.standard_normal(size)), shape[:, j])
        columns.append(y)
    data = np.stack(columns[: 1 + both], axis=2).reshape(size, -1)
    text = 'name = "b"\nsampling_rate_hz = 10.0\nblock_minutes = 10\n' + "".join(
        f'[[sensor]]\nchannel = "m{n}{a}"\nlevel = "m{n}"\nposition_m = [0.0, 0.0, {40 * z}]\n'
        f'direction = {[float(a == "x"), float(a == "y"), 0.0]}\nunit = "m/s2"\n'
        for n, z in enumerate(place) for a in "xy"[: 1 + both])
    return 1e-2 * (data + 3e-3 * data.std(axis=0).max() * rng.standard_normal(data.shape)), text


@pytest.mark.parametrize("height", [0.04, 0.12])
def test_a_sensor_beside_a_stiff_foot_is_in_its_unit(campaign_folder, height):
    data, text = mast(height)
    assert suspected(campaign_folder([(0, data)], head=text)) == []
    data[:, 4] /= 9.80665
    assert any("m2x" in f for f in check(read_campaign(campaign_folder([(0, data)], head=text))).findings)


def test_sensors_near_both_supports_of_a_deck_are_in_their_unit(campaign_folder):
    places, rng = np.array([0.03, 0.25, 0.5, 0.75, 0.97]), np.random.default_rng(2)
    data = 0.0
    for n, hz in ((1, 0.6), (2, 2.4)):
        b, a, _ = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 0.13 * hz, (2 * np.pi * hz) ** 2]), 1 / RATE_HZ,
                                       method="zoh")
        data = data + np.outer(signal.lfilter(b.ravel(), a, rng.standard_normal(36000)), np.sin(np.pi * n * places))
    text = 'name = "b"\nsampling_rate_hz = 10.0\nblock_minutes = 10\n' + "".join(
        f'[[sensor]]\nchannel = "d{n}"\nlevel = "deck"\nposition_m = [{20 * x}, 0.0, 0.0]\n'
        'direction = [0.0, 0.0, 1.0]\nunit = "m/s2"\n' for n, x in enumerate(places))
    data = data / data.std() + 3e-3 * rng.standard_normal(data.shape)
    assert suspected(campaign_folder([(0, 1e-2 * data)], head=text)) == []
    data[:, 3] *= 9.80665
    assert any("d3 moves" in f for f in check(read_campaign(campaign_folder([(0, 1e-2 * data)], head=text))).findings)


def test_of_one_direction_a_support_is_named_beside_the_unit(campaign_folder):
    """Sound, it is silent: below the second mode the lowest sensor moves as little as noise is large."""
    data, text = mast(0.04, both=False)
    assert suspected(campaign_folder([(0, data)], head=text)) == []
    data[:, 0] /= 9.80665
    (found,) = suspected(campaign_folder([(0, data)], head=text))
    assert "m0x" in found and "support" in found


@pytest.mark.parametrize(("one", "names"), [(1.0, []), (9.80665, ["f1x or f2x"])], ids=["all right", "one in g"])
def test_what_acts_along_one_axis_is_no_wrong_unit(campaign_folder, one, names):
    """Four floors that the wind shakes six times as much along x; of the last two, y alone has a sensor."""
    both = np.column_stack([6 * building(4)[:, :2], building(4, 24000)[12000:]])
    both[:, 1] /= one
    units = ["m/s2"] * 6
    text = head(units)
    for k, name in enumerate(("f1x", "f2x", "f1y", "f2y", "f3y", "f4y")):
        text = text.replace(f'channel = "f{k + 1}"', f'channel = "{name}"').replace(
            f'position_m = [0.0, 0.0, {3.0 * (k + 1)}]\ndirection = [1.0, 0.0, 0.0]',
            f'position_m = [0.0, 0.0, {3.0 * int(name[1])}]\ndirection = {[float(k < 2), float(k > 1), 0.0]}')
    found = suspected(campaign_folder([(0, both)], head=text))
    assert [f.split("is ")[-1].split(" in")[0] for f in found] == names


def test_of_two_channels_either_may_be_the_wrong_one(campaign_folder):
    data = building(2)
    data[:, 1] /= 9.80665
    found = suspected(campaign_folder([(0, data)], head=head(["m/s2"] * 2)))
    assert len(found) == 1 and "is f1 or f2 in m/s2" in found[0], found


def test_all_stated_in_g_are_asked_about_where_no_structure_moves_so(campaign_folder):
    data = building()
    data *= 0.5 / data.std()
    found = suspected(campaign_folder([(0, data)], head=head(["g"] * 3)))
    assert len(found) == 1 and "f1, f2, f3 vibrate" in found[0] and "are these numbers m/s2?" in found[0]
    assert suspected(campaign_folder([(0, data)], head=head(["m/s2"] * 3))) == []


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("start", [0.0, 1559556000.0])
def test_a_column_of_time_is_refused_as_a_channel(dtype, start):
    data = building(size=6000)
    refuse_time("x", ("a", "b", "c"), data)
    data[:, 1] = (start + np.arange(6000) * (0.1 if dtype == np.float64 else 1.0)).astype(dtype)
    with pytest.raises(InputError, match=r"x, channel b: its samples rise evenly, by .* looks like the column of time"):
        refuse_time("x", ("a", "b", "c"), data)
    data[:, 1] = 7.0
    refuse_time("x", ("a", "b", "c"), data)
    data[:, 1] = np.linspace(0, 1, 6000) + 1e-3 * data[:, 0] / data[:, 0].std()
    refuse_time("x", ("a", "b", "c"), data)


def test_check_identify_and_convert_refuse_it_by_name(campaign_folder, tmp_path):
    data = building()
    data[:, 0] = 0.1 * np.arange(len(data))
    campaign = read_campaign(campaign_folder([(0, data)], head=head(["m/s2"] * 3)))
    with pytest.raises(InputError, match="channel f1: its samples rise evenly, by 0.1 each"):
        check(campaign)
    with pytest.raises(InputError, match="channel f1"):
        usable_block(campaign, campaign.files[0].start, campaign.files)
    raw = tmp_path / "raw"
    raw.mkdir()
    np.savetxt(raw / "one.csv", data, delimiter=",", header="t,a,b", comments="")
    (tmp_path / "convert.toml").write_text(
        'files = "*.csv"\nstart = "2024-05-01T00:00:00Z"\n[columns]\nf1 = 1\nf2 = 2\nf3 = 3\n')
    with pytest.raises(InputError, match=r"one.csv, channel f1: .*\[columns\]"):
        convert(raw, tmp_path)


@pytest.mark.parametrize(("given", "words"), [
    ("windspeed_mps", "unknown column 'windspeed_mps'; did you mean 'wind_speed_mps'?"),
    ("Rotor_Speed_rpm", "unknown column 'Rotor_Speed_rpm'; did you mean 'rotor_speed_rpm'?"),
    ("pich_deg_max", "did you mean 'pitch_deg_max'?"),
])
def test_a_misspelt_column_of_scada_is_asked_about(tmp_path, given, words):
    (tmp_path / "scada.csv").write_text(f"time,{given}\n2020-01-01T00:00Z,1\n")
    with pytest.raises(InputError) as caught:
        read_scada(tmp_path / "scada.csv")
    assert words in str(caught.value) and str(tmp_path / "scada.csv") in str(caught.value)


def test_other_columns_of_scada_are_left_alone_and_a_similar_one_is_named_where_it_lacks(campaign_folder, tmp_path):
    (tmp_path / "scada.csv").write_text("time,wind_speed_mps,wind_speed_mps_p95,power,status\n"
                                        "2019-06-03T10:00Z,1,1,1,1\n")
    found = check(read_campaign(campaign_folder([(0, building())], head=head(["m/s2"] * 3)))).findings
    assert any(f.startswith("SCADA has no power_kw (rename 'power' if that is it); it is needed for") for f in found)


SPOILT = {
    "one huge": lambda x: np.where(np.arange(x.size).reshape(x.shape) == 17, 3e38, x), "all huge": lambda x: x * 1e38,
    "nothing": lambda x: x * 0, "tiny": lambda x: x * 1e-36, "impulses": lambda x: x * 0 + np.eye(*x.shape),
    "all alike": lambda x: np.repeat(x[:, :1], x.shape[1], axis=1), "all lost": lambda x: x * np.nan,
}


@pytest.mark.parametrize(("name", "said"), [
    ("one huge", "f2 has 1 sample beyond 1e+09 (SI)"), ("all huge", "all channels lack 100.0 % of their samples"),
    ("nothing", "f4 is flat in 1 of 1"),
    ("tiny", "suspect: the top moves with 4.9e-38 m/s2"), ("impulses", "f1 is constant for up to 599.9 s"),
    ("all alike", "suspect: f1 and f2 are one signal at every frequency"),
    ("all lost", "all channels lack 100.0 % of their samples"),
])
def test_spoilt_records_are_checked_without_a_warning_and_named(campaign_folder, name, said):
    with np.errstate(over="ignore"):
        data = SPOILT[name](building(4, 6000)).astype(np.float32)
    result = check(read_campaign(campaign_folder([(0, data)], head=head(["m/s2"] * 4))))
    found = [f for f in result.findings if not f.startswith("no scada.csv")]
    assert any(f.startswith(said) for f in found)
    assert not any("nan" in f for f in found)


@pytest.mark.parametrize("value", ["inf", "-1e300", "1e8"])
def test_numbers_that_no_turbine_has_are_missing_and_said(tmp_path, value):
    (tmp_path / "scada.csv").write_text(f"time,power_kw\n2020-01-01T00:00Z,{value}\n2020-01-01T00:10Z,500\n")
    table = read_scada(tmp_path / "scada.csv")
    np.testing.assert_array_equal(table["power_kw"], [np.nan, 500.0])
    assert "1 value of power_kw" in table.attrs["notes"][0]


def test_kelvin_are_no_degrees_celsius(tmp_path):
    rows = "".join(f"2020-01-01T00:{minute}0Z,{value}\n" for minute, value in enumerate(("", 281.3, 282.0)))
    (tmp_path / "scada.csv").write_text("time,air_temperature_c\n" + rows)
    with pytest.raises(InputError, match=r"scada\.csv, air_temperature_c: a median of 281.6 .* convert it from kelvin"):
        read_scada(tmp_path / "scada.csv")


# Gravity in the mean ------------------------------------------------------------------------------------------------


def flipped(folder) -> list[str]:
    return [f for f in check(read_campaign(folder)).findings if "looks flipped" in f and "gravity" in f]


def upright(direction_z, unit="g") -> str:
    text = head([unit] * len(direction_z))
    for k, z in enumerate(direction_z):
        text = text.replace(f"{3.0 * (k + 1)}]\ndirection = [1.0, 0.0, 0.0]",
                            f"{3.0 * (k + 1)}]\ndirection = [{(1 - z * z) ** 0.5}, 0.0, {z}]")
    return text


def resting(mean, seed=3) -> np.ndarray:
    """Records (6000, n) whose sensors' zero offsets are some hundredths."""
    rng = np.random.default_rng(seed)
    return np.array(mean) * (1 + 0.01 * rng.standard_normal(len(mean))) + 1e-3 * rng.standard_normal((6000, len(mean)))


@pytest.mark.parametrize(("stated", "mean", "names", "unit", "size"), [
    ([1, 1, 1, 1], [1, 1, -1, 1], ["f3"], "m/s2", 9.80665),
    ([1, 1, 1, 1], [1, 1, -1, 1], ["f3"], "m/s2", 1.0),
    ([1, -1, 1, 1], [1, 1, 1, 1], ["f2"], "g", 1.0),
    ([1, -1, 1, -1], [1, -1, 1, -1], [], "g", 1.0),
    # a logger that counts gravity's pull, of which one is reversed
    ([1, 1, 1, 1], [-1, -1, -1, 1], ["f4"], "g", 1.0),
    ([1, 1, 1, 1], [-1, -1, -1, -1], [], "g", 1.0),
    ([1, 1], [-1, 1], ["f1"], "g", 1.0),
    ([1], [-1], ["f1"], "g", 1.0),
    # an oblique one holds its share of gravity, a horizontal one none but its tilt's
    ([1, 1, 0.6, 0.0], [1, 1, -0.6, -0.02], ["f3"], "g", 1.0),
    # without a constant part most do not hold gravity
    ([1, 1, 1, 1], [0.001, -0.002, -1, 0.003], [], "g", 1.0),
])
def test_a_mean_against_gravity_names_the_reversed_channel(campaign_folder, stated, mean, names, unit, size):
    folder = campaign_folder([(0, resting(size * np.array(mean)))], head=upright(stated, unit))
    found = flipped(folder)
    assert [f.split()[1] for f in found] == names, found
    if not names:
        return
    said = check(read_campaign(folder)).findings
    assert any("read gravity as" in f for f in said) == ((unit, size) == ("m/s2", 1.0))
    # what the sentence asks for ends it
    text = (folder / "campaign.toml").read_text().split("[[sensor]]")
    k = int(names[0][1:])
    z = float(stated[k - 1])
    text[k] = upright([*stated[: k - 1], -z, *stated[k:]], unit).split("[[sensor]]")[k]
    (folder / "campaign.toml").write_text("[[sensor]]".join(text))
    assert flipped(folder) == []


@pytest.mark.parametrize("along", ["x", "z"])
def test_of_a_turbine_alone_is_it_said_that_operation_is_not_known(campaign_folder, along):
    text = head(["m/s2"] * 3)
    if along == "x":
        for k in range(3):
            text = text.replace(f"[0.0, 0.0, {3.0 * (k + 1)}]", f"[{3.0 * (k + 1)}, 0.0, 0.0]")
    said = [f for f in check(read_campaign(campaign_folder([(0, building())], head=text))).findings if "scada.csv" in f]
    assert len(said) == 1 and ("turbine" in said[0]) == (along == "z")


@pytest.mark.parametrize(("state", "rms", "said"), [
    ("idling", 0.31, False), ("idling", 9.81 * 0.31, True), ("rated", 0.5, False), ("rated", 300.0, True),
    ("idling", 3e-5, True)])
def test_a_monopile_that_idles_in_waves_is_not_suspected(state, rms, said):
    """A unit mistaken is 9.8, 100 or 1000 times as much; 0.31 m/s2 is a slender monopile without a rotor's damping."""
    sensors = [Sensor(channel=f"T{z:g}", level=f"{z:g}", position_m=(0.0, 0.0, z), direction=(1.0, 0.0, 0.0))
               for z in (15.0, 60.0, 102.0)]
    table = pd.DataFrame([{"id": f"b{k}", "channel": s.channel, "rms": rms, "flat": False, "offset": 0.0}
                          for s in sensors for k in range(4)])
    found = scale_findings(table, {f"b{k}": state for k in range(4)}, sensors, [])
    assert any("the top moves" in sentence for sentence in found) == said
