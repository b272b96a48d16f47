"""SCADA as control systems write it: fillers, other units, angles across north, doubled rows, other time zones."""

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy import signal

import probupdate
from probupdate.campaign.blocks import blocks
from probupdate.campaign.checking import check, suspected_time
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.scada import StatedScada, StateRule, read_scada, row_states
from probupdate.campaign.scada_time import record_rows, time_findings
from probupdate.errors import InputError

N, RATED = 36, 5000.0
INDEX = pd.date_range("2024-05-01T00:00Z", periods=N, freq="10min")


def scada(**changes) -> pd.DataFrame:
    """Three hours idling, three at rated power; a change is a column or (row -> value) of it."""
    run = np.arange(N) >= N // 2
    table = pd.DataFrame({
        "time": INDEX.strftime("%Y-%m-%dT%H:%M:%SZ"), "wind_speed_mps": np.where(run, 13.0, 2.0),
        "power_kw": np.where(run, RATED, -20.0), "rotor_speed_rpm": np.where(run, 12.0, 0.1),
        "pitch_deg": np.where(run, 6.0, 88.0), "nacelle_heading_deg": np.where(run, 5.0, 200.0),
        "air_temperature_c": 9.0})
    for column, change in changes.items():
        if isinstance(change, dict):
            table[column] = table[column].astype(object)
            for row, value in change.items():
                table.loc[row, column] = value
        else:
            table[column] = change
    return table


def read(tmp_path, table, **options):
    table.to_csv(tmp_path / "scada.csv", index=False)
    return read_scada(tmp_path / "scada.csv", rated_power_kw=options.pop("rated", RATED), **options)


@pytest.mark.parametrize("value", [-999, -9999, 9999.9, 99999, -32768, "9" * 30, 1e30, 9.96921e36, -99.9])
@pytest.mark.parametrize("column", ["wind_speed_mps", "rotor_speed_rpm", "air_temperature_c"])
def test_a_filler_is_a_missing_value(tmp_path, column, value):
    found = read(tmp_path, scada(**{column: {5: value}}))
    assert np.isnan(found[column].iloc[5]) and found[column].notna().sum() == N - 1
    assert f"1 value of {column} in SCADA" in found.attrs["notes"][0]


@pytest.mark.parametrize("value", [-999, 99999, -32768])
def test_a_filler_in_power_is_missing_too(tmp_path, value):
    found = read(tmp_path, scada(power_kw={20: value}))
    assert np.isnan(found["power_kw"].iloc[20])


def test_numbers_of_nines_among_others_stay(tmp_path):
    power = np.linspace(-20, 4999, N)
    power[7] = 999
    found = read(tmp_path, scada(power_kw=power, wind_speed_mps=np.linspace(3, 12, N), rotor_speed_rpm=12.0))
    assert found["power_kw"].iloc[7] == 999 and found["power_kw"].iloc[-1] == 4999 and not found.attrs["notes"]


def test_a_right_table_says_nothing(tmp_path):
    found = read(tmp_path, scada())
    assert found.attrs["notes"] == () and found.shape[1] == 6


@pytest.mark.parametrize(("column", "factor", "words"), [
    ("power_kw", 1e-3, "is it in MW"), ("power_kw", 1e3, "is it in W"), ("power_kw", 0.02, "is it in percent"),
    ("rotor_speed_rpm", 2 * np.pi / 60, "is it in rad/s"), ("rotor_speed_rpm", 97.0, "is it the generator's"),
    ("rotor_speed_rpm", 1 / 60, "is it in turns a second"), ("pitch_deg", np.pi / 180, "is it in radians"),
])
def test_another_unit_is_said_not_used_and_converted_when_stated(tmp_path, column, factor, words):
    wrong = scada(**{column: scada()[column] * factor})
    found = read(tmp_path, wrong)
    assert column not in found and any(words in n and column in n for n in found.attrs["notes"])
    (tmp_path / "campaign.toml").write_text(
        f'name = "x"\nsampling_rate_hz = 25.0\nblock_minutes = 30\nrated_power_kw = {RATED}\n[scada]\n'
        f'factor = {{ {column} = {1 / factor} }}\n[[sensor]]\nchannel = "a"\nlevel = "a"\n'
        'position_m = [0.0, 0.0, 1.0]\ndirection = [1.0, 0.0, 0.0]\n')
    (tmp_path / "acceleration").mkdir()
    with h5py.File(tmp_path / "acceleration/a.h5", "w") as file:
        data = file.create_dataset("data", data=np.zeros((100, 1), np.float32))
        data.attrs.update(start="2024-05-01T00:00Z", sampling_rate_hz=25.0)
    mended = read_campaign(tmp_path).scada
    np.testing.assert_allclose(mended[column], scada()[column])
    assert mended.attrs["notes"] == ()


def test_power_in_megawatt_is_said_with_wind_and_speed(tmp_path):
    found = read(tmp_path, scada(power_kw=scada()["power_kw"] / 1000))
    assert "reaches 5 (0.1 % of rated_power_kw) at 13 m/s and 12 rpm" in found.attrs["notes"][0]


@pytest.mark.parametrize("megawatt", [2.0, 5.0, 8.0, 15.0])
def test_without_rated_power_a_large_rotor_tells_megawatt(tmp_path, megawatt):
    found = read(tmp_path, scada(power_kw=scada()["power_kw"] / RATED * megawatt), rated=None)
    assert "power_kw" not in found and "MW" in found.attrs["notes"][0]


def test_watts_are_said_without_rated_power_and_rotor(tmp_path):
    table = scada(power_kw=1e3 * scada()["power_kw"]).drop(columns="rotor_speed_rpm")
    assert "is it in W?" in read(tmp_path, table, rated=None).attrs["notes"][0]


def test_without_rated_power_percent_is_said_in_wind_of_more(tmp_path):
    wind = np.linspace(3, 14, N)
    table = scada(wind_speed_mps=wind, power_kw=100 * power_curve(wind, 12.0) / RATED, rotor_speed_rpm=12.0)
    assert "percent" in read(tmp_path, table, rated=None).attrs["notes"][0]
    assert not read(tmp_path, table.assign(wind_speed_mps=wind / 2), rated=None).attrs["notes"]


@pytest.mark.parametrize("rated", [850.0, 2300.0, 15000.0])
def test_power_in_percent_is_said_of_small_turbines_too(tmp_path, rated):
    power = scada()["power_kw"] / RATED
    found = read(tmp_path, scada(power_kw=100 * power, rotor_speed_rpm=15.0 if rated < 3000 else 8.0), rated=rated)
    assert "power_kw" not in found and f"{{ power_kw = {rated / 100:g} }}" in found.attrs["notes"][0]
    # curtailed to a tenth, in no other unit
    curtailed = scada(power_kw=0.1 * rated * power, rotor_speed_rpm=15.0 if rated < 3000 else 8.0)
    assert rated == 850.0 or not read(tmp_path, curtailed, rated=rated).attrs["notes"]


@pytest.mark.parametrize("column", ["wind_speed_mps", "rotor_speed_rpm"])
def test_a_zero_while_power_is_given_is_missing(tmp_path, column):
    found = read(tmp_path, scada(**{column: {25: 0.0, 30: 0.0}}))
    assert np.flatnonzero(found[column].isna()).tolist() == [25, 30]
    assert f"2 values of {column} in SCADA below" in found.attrs["notes"][0]


@pytest.mark.parametrize("value", [-1, 0])
def test_no_power_while_the_rotor_turns_in_wind_is_missing(tmp_path, value):
    found = read(tmp_path, scada(power_kw={3: value, 25: value, 30: value}))
    assert np.flatnonzero(found["power_kw"].isna()).tolist() == [25, 30]
    assert "2 values of power_kw in SCADA below" in found.attrs["notes"][0]


def winds(seed, digits, n=1008):
    """A week of ten-minute means: a slow weather (a day) and what is left of turbulence, as rounded; and its power."""
    rng = np.random.default_rng(seed)
    slow = signal.lfilter([np.sqrt(1 - 0.99**2)], [1, -0.99], rng.standard_normal(n))
    wind = np.abs(9 + 2 * slow + 0.4 * rng.standard_normal(n))
    power = power_curve(wind * (1 + 0.03 * rng.standard_normal(n)), 12.0)
    time = pd.date_range("2024-05-01T00:00Z", periods=n, freq="10min").strftime("%Y-%m-%dT%H:%M:%SZ")
    return pd.DataFrame({"time": time, "wind_speed_mps": np.round(wind, digits), "power_kw": np.round(power)})


@pytest.mark.parametrize(("digits", "rows"), [(1, 18), (2, 18), (0, 72)])
def test_a_stuck_anemometer_is_said_and_missing(tmp_path, digits, rows):
    clean = sum(bool(read(tmp_path, winds(seed, digits)).attrs["notes"]) for seed in range(20))
    assert clean == 0
    table = winds(50, digits)
    table.loc[300: 299 + rows, "wind_speed_mps"] = table.loc[300, "wind_speed_mps"]
    found = read(tmp_path, table)
    assert set(range(300, 300 + rows)) <= set(np.flatnonzero(found["wind_speed_mps"].isna()))
    assert found["wind_speed_mps"].isna().sum() <= rows + 2 and "stuck anemometer" in found.attrs["notes"][0]


def power_curve(wind, at_rated):
    return RATED * np.clip((wind / at_rated) ** 3, 0, 1)


@pytest.mark.parametrize("rated", [RATED, None])
@pytest.mark.parametrize("at_rated", [9.5, 12.0, 13.0])
@pytest.mark.parametrize(("unit", "metres"), [("knots", 0.514444), ("miles an hour", 0.44704), ("km/h", 1 / 3.6)])
def test_wind_in_another_unit_is_said_with_it(tmp_path, unit, metres, at_rated, rated):
    wind = np.linspace(3, 14, N)
    table = scada(wind_speed_mps=wind, power_kw=power_curve(wind, at_rated), rotor_speed_rpm=12.0)
    assert not read(tmp_path, table, rated=rated).attrs["notes"]
    found = read(tmp_path, table.assign(wind_speed_mps=wind / metres), rated=rated)
    (sentence,) = found.attrs["notes"]
    assert unit in sentence and f"{metres:.6g}" in sentence and "wind_speed_mps" not in found


@pytest.mark.parametrize(("unit", "metres"), [("knots", 0.514444), ("km/h", 1 / 3.6)])
def test_wind_at_rated_power_in_another_unit_is_said(tmp_path, unit, metres):
    """No row gives a part of the power."""
    found = read(tmp_path, scada(wind_speed_mps=scada()["wind_speed_mps"] / metres))
    (sentence,) = found.attrs["notes"]
    assert unit in sentence and f"{metres:.6g}" in sentence and "wind_speed_mps" not in found


@pytest.mark.parametrize("number", [0.0, -1.0, 1.0])
def test_rows_of_one_number_are_missing(tmp_path, number):
    table = scada(power_kw_std=3.0)
    table.loc[[20, 21], table.columns != "time"] = number
    found = read(tmp_path, table)
    assert found.iloc[[20, 21]].isna().all(axis=None) and found["power_kw"].notna().sum() == N - 2
    assert found.attrs["notes"] == (f"2 rows of SCADA with one number in all columns ({number:g}): taken as missing",)


def test_a_direction_as_wind_speed_is_no_filler(tmp_path):
    found = read(tmp_path, scada(wind_speed_mps=np.linspace(150, 230, N)))
    assert "wind_speed_mps in SCADA is 190 in the middle of its rows" in found.attrs["notes"][0]


def test_a_curtailed_turbine_has_no_other_wind(tmp_path):
    wind = np.linspace(3, 20, N)
    curtailed = np.minimum(power_curve(wind, 12.0), 0.4 * RATED)
    assert not read(tmp_path, scada(wind_speed_mps=wind, power_kw=curtailed, rotor_speed_rpm=12.0)).attrs["notes"]


def test_an_angle_averaged_across_north_is_missing(tmp_path):
    heading = np.tile([350.0, 8.0, 355.0, 3.0], N // 4)
    heading[[10, 21]] = [178.0, 181.0]
    found = read(tmp_path, scada(nacelle_heading_deg=heading))
    assert np.flatnonzero(found["nacelle_heading_deg"].isna()).tolist() == [10, 21]
    assert "averaged across north" in found.attrs["notes"][0]


def test_extremes_on_both_sides_of_north_tell_a_wrong_mean(tmp_path):
    found = read(tmp_path, scada(wind_direction_deg=180.0, wind_direction_deg_min=2.0, wind_direction_deg_max=358.0))
    assert found["wind_direction_deg"].isna().all()


def test_a_nacelle_that_turns_by_half_a_turn_is_no_mean(tmp_path):
    heading = np.where(np.arange(N) < 18, 5.0, 185.0)
    found = read(tmp_path, scada(nacelle_heading_deg=heading))
    assert found["nacelle_heading_deg"].notna().all()


@pytest.mark.parametrize(("both", "turned"), [(True, 4.0), (False, 4.0), (False, 184.0)])
def test_a_heading_in_radians_is_said_with_and_without_wind(tmp_path, both, turned):
    wind = np.linspace(20, 300, N)
    table = scada(wind_direction_deg=wind, nacelle_heading_deg=np.radians((wind + turned) % 360))
    found = read(tmp_path, table if both else table.drop(columns="wind_direction_deg"))
    assert ["nacelle_heading_deg" in n and "is it in radians" in n and "57.2958" in n for n in found.attrs["notes"]
            ] == [True]


def test_wind_and_heading_that_stay_north_are_no_radians(tmp_path):
    gust = np.sin(np.arange(N))
    table = scada(wind_direction_deg=(3 + 5 * gust) % 360, nacelle_heading_deg=3 + 2 * gust)
    assert read(tmp_path, table).attrs["notes"] == ()
    # of whole degrees there are few, and a nacelle that stands has one heading
    assert read(tmp_path, scada(nacelle_heading_deg=np.round(3 + 3 * gust))).attrs["notes"] == ()
    assert read(tmp_path, scada(nacelle_heading_deg=4.0)).attrs["notes"] == ()


@pytest.mark.parametrize(("low", "high", "said"), [(33.0, 50.0, True), (-5.0, 31.0, False), (22.0, 36.0, False)])
def test_air_that_no_climate_has_is_asked_for_fahrenheit(tmp_path, low, high, said):
    notes = read(tmp_path, scada(air_temperature_c=np.linspace(low, high, N))).attrs["notes"]
    assert any("Fahrenheit" in n and "(value - 32) / 1.8" in n for n in notes) == said == bool(notes)


def test_an_empty_row_before_the_good_one_is_filled_from_it(tmp_path):
    table = scada()
    empty = table.iloc[[20]].copy()
    empty.loc[:, empty.columns != "time"] = np.nan
    found = read(tmp_path, pd.concat([table.iloc[:20], empty, table.iloc[20:]]))
    assert len(found) == N and found.attrs["contradicted"] == 0 and found["power_kw"].iloc[20] == RATED
    other = table.iloc[[20]].assign(power_kw=4000.0)
    assert read(tmp_path, pd.concat([table, other])).attrs["contradicted"] == 1


def test_states_are_those_of_the_turbine_with_missing_values(tmp_path):
    found = read(tmp_path, scada(power_kw={20: -999}))
    states = row_states(found, StateRule(rated_power_kw=RATED))
    assert states[20] == "unknown" and set(np.delete(states, 20)) == {"idling", "rated"}


def test_words_that_are_no_number_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"power_kw: 'idle' is not a number"):
        read(tmp_path, scada(power_kw={3: "idle"}))
    assert np.isnan(read(tmp_path, scada(power_kw={3: "NAN"}))["power_kw"].iloc[3])


@pytest.mark.parametrize(("text", "words"), [
    ("time;power_kw\n2024-05-01T00:00Z;5,5\n", "has one column, 'time;power_kw'; separate columns by commas"),
    ('time,power_kw\n2024-05-01T00:00Z,"5,5"\n', "power_kw: '5,5' is not a number; write decimals with a point")])
def test_commas_of_another_language_are_named(tmp_path, text, words):
    (tmp_path / "scada.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_scada(tmp_path / "scada.csv")


# Times --------------------------------------------------------------------------------------------------------------


def turbine(folder, shift_h=0.0, line=0.03, seed=4):
    """Six hours at 10 Hz: one mode throughout, from three hours on the rotor's line too."""
    rate, n = 10.0, 6 * 36000
    rng, t = np.random.default_rng(seed), np.arange(6 * 36000) / 10.0
    pole = np.exp((-0.01 + 1j) * 2 * np.pi * 0.33 / rate)
    y = np.real(signal.lfilter([1], [1, -pole], rng.standard_normal(n)))
    y = 0.05 * y / y.std() + 0.002 * rng.standard_normal(n)
    y += np.where(t > 3 * 3600, line * np.sin(2 * np.pi * 0.6 * t), 0)
    (folder / "acceleration").mkdir(parents=True)
    with h5py.File(folder / "acceleration/a.h5", "w") as file:
        data = file.create_dataset("data", data=np.column_stack([y, 0.6 * y + 0.002 * rng.standard_normal(n)]).astype(
            np.float32))
        data.attrs.update(start="2024-05-01T00:00Z", sampling_rate_hz=rate)
    text = f'name = "x"\nsampling_rate_hz = {rate}\nblock_minutes = 30\nrated_power_kw = {RATED}\n'
    for k in (1, 2):
        text += (f'[[sensor]]\nchannel = "{k}"\nlevel = "{k}"\nposition_m = [0.0, 0.0, {20.0 - 5 * k}]\n'
                 'direction = [1.0, 0.0, 0.0]\n')
    (folder / "campaign.toml").write_text(text)
    table = scada()
    table["time"] = (INDEX + pd.Timedelta(hours=shift_h)).strftime("%Y-%m-%dT%H:%M:%SZ")
    table.to_csv(folder / "scada.csv", index=False)
    return folder


@pytest.mark.parametrize("hours", [2.0, -2.0, 1.0])
def test_another_time_zone_is_said_and_mended(tmp_path, hours):
    folder = turbine(tmp_path / "c", hours)
    (sentence,) = [f for f in check(read_campaign(folder)).findings if "time zone" in f]
    assert f"{abs(hours):g} h {'earlier' if hours > 0 else 'later'}" in sentence
    assert f"shift_minutes = {round(-60 * hours)}" in sentence
    assert suspected_time(read_campaign(folder)) == [sentence]
    if hours == 1.0:
        # as whoever has not asked `check` reads it
        assert sentence in probupdate.identify(folder).summary
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(
        text.replace("[[sensor]]", f"[scada]\nshift_minutes = {-60 * hours}\n[[sensor]]", 1))
    assert not [f for f in check(read_campaign(folder)).findings if "time zone" in f]


def test_right_times_say_nothing(tmp_path):
    campaign = read_campaign(turbine(tmp_path / "c"))
    rows = [r for block in blocks(campaign) for r in record_rows(block)]
    assert len(rows) == N and not time_findings(rows, campaign.scada)


def test_a_rotor_that_the_record_knows_nothing_of_has_no_other_time(tmp_path):
    campaign = read_campaign(turbine(tmp_path / "c", line=0.0))
    rows = [r for block in blocks(campaign) for r in record_rows(block)]
    rng = np.random.default_rng(1)
    for _ in range(20):
        rotor = np.where(np.cumsum(rng.standard_normal(N)) > 0, 12.0, 0.1)
        assert not time_findings(rows, campaign.scada.assign(rotor_speed_rpm=rotor))


def follow_rotor(folder, wind_as_rotor=False, late=0):
    """A day at 5 Hz: one mode, and three lines a turn of a rotor that follows the wind; its SCADA, `late` rows after
    it."""
    rng, rate, n = np.random.default_rng(7), 5.0, 144
    slow = signal.lfilter([np.sqrt(1 - 0.9**2)], [1, -0.9], rng.standard_normal(n))
    wind = np.clip(8 + 2 * slow, 4.5, 11.5)
    rotor = 1.25 * wind + 0.3 * rng.standard_normal(n)
    turns = np.cumsum(np.repeat(rotor / 60, int(600 * rate))) / rate
    pole = np.exp((-0.01 + 1j) * 2 * np.pi * 0.33 / rate)
    y = np.real(signal.lfilter([1], [1, -pole], rng.standard_normal(len(turns))))
    y = 0.05 * y / y.std() + 0.01 * np.sin(6 * np.pi * turns)
    folder = turbine(folder)
    with h5py.File(folder / "acceleration/a.h5", "w") as file:
        data = np.column_stack([y, 0.6 * y]) + 0.002 * rng.standard_normal((len(y), 2))
        file.create_dataset("data", data=data.astype(np.float32)).attrs.update(
            start="2024-05-01T00:00Z", sampling_rate_hz=rate)
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(text.replace("sampling_rate_hz = 10.0", "sampling_rate_hz = 5.0"))
    time = pd.date_range("2024-05-01T00:00Z", periods=n, freq="10min") + pd.Timedelta(minutes=10 * late)
    both = (rotor, wind) if wind_as_rotor else (wind, rotor)
    pd.DataFrame({"time": time.strftime("%Y-%m-%dT%H:%M:%SZ"), "wind_speed_mps": both[0],
                  "rotor_speed_rpm": both[1]}).to_csv(folder / "scada.csv", index=False)
    return suspected_time(read_campaign(folder))


@pytest.mark.parametrize("rows", [0, 1, 2, -1])
def test_stamps_at_the_ends_of_ten_minutes_are_said(tmp_path, rows):
    found = follow_rotor(tmp_path / "c", late=rows)
    assert len(found) == bool(rows) and all(f"shift_minutes = {-10 * rows} " in f for f in found)


def test_wind_and_rotor_exchanged_are_said_by_the_lines(tmp_path):
    (sentence,) = follow_rotor(tmp_path / "c", wind_as_rotor=True)
    assert "lines" in sentence and "wind_speed_mps" in sentence and "exchange" in sentence


@pytest.mark.parametrize(("rated", "slowest", "rise", "fastest"), [(3000.0, 7, 1.2, 15), (8000.0, 5, 0.6, 10.5)])
def test_wind_and_rotor_exchanged_are_said_by_rated_power(tmp_path, rated, slowest, rise, fastest):
    wind = np.linspace(2, 18, N)
    rotor = np.where(wind > 4, np.clip(slowest + rise * (wind - 4), slowest, fastest), 0.1)
    table = scada(wind_speed_mps=wind, rotor_speed_rpm=rotor, power_kw=rated * power_curve(wind, 12.0) / RATED)
    assert not read(tmp_path, table, rated=rated).attrs["notes"]
    found = read(tmp_path, table.assign(wind_speed_mps=rotor, rotor_speed_rpm=wind), rated=rated)
    assert "exchange" in found.attrs["notes"][0] and not {"wind_speed_mps", "rotor_speed_rpm"} & set(found)


def test_a_rotor_that_turns_alike_while_the_turbine_stands_is_missing(tmp_path):
    table = winds(3, 2)
    turns = table["wind_speed_mps"] > 8
    table["power_kw"] = table["power_kw"].where(turns, -15.0)
    # a stall-controlled turbine has one speed, and stands still
    assert not read(tmp_path, table.assign(rotor_speed_rpm=np.where(turns, 12.0, 0.0))).attrs["notes"]
    found = read(tmp_path, table.assign(rotor_speed_rpm=12.0))
    assert found["rotor_speed_rpm"].isna().all() and "stuck" in found.attrs["notes"][0]


@pytest.mark.parametrize("stuck", [10.03, 6.4, 13.0])
def test_a_rotor_stuck_while_the_turbine_runs_is_missing(tmp_path, stuck):
    """Of a turbine whose speed follows the cube root of its power, and is held at its rated one."""
    table = winds(4, 6)
    power = table["power_kw"] / table["power_kw"].max()
    table["rotor_speed_rpm"] = (12.1 * np.clip(1.08 * np.cbrt(power), 0.55, 1.0)).round(1)
    assert not read(tmp_path, table).attrs["notes"]
    table.loc[30:65, "rotor_speed_rpm"] = stuck
    found = read(tmp_path, table)
    assert found["rotor_speed_rpm"].iloc[30:66].isna().all() and "stuck sensor" in found.attrs["notes"][0]


@pytest.mark.parametrize("minutes", [5, 0, 3, 10])
def test_stamps_in_the_middle_of_ten_minutes_are_said(tmp_path, minutes):
    moved = scada(time=(INDEX + pd.Timedelta(minutes=minutes)).strftime("%Y-%m-%dT%H:%M:%SZ"))
    assert any("shift_minutes = -5 " in n for n in read(tmp_path, moved).attrs["notes"]) == (minutes == 5)
    assert not read(tmp_path, moved, stated=StatedScada(shift_minutes=-5.0 if minutes == 5 else 0.0)).attrs["notes"]


@pytest.mark.parametrize(("cut", "words"), [(2, "cut off"), (6, "cut off"), (1, "")])
def test_a_last_row_that_is_cut_off_is_left_out_and_said(tmp_path, cut, words):
    """By two characters the temperature has no decimals, by more it is gone; by the line's end nothing lacks."""
    path = tmp_path / "scada.csv"
    scada().to_csv(path, index=False)
    path.write_bytes(path.read_bytes()[:-cut])
    table = read_scada(path)
    assert len(table) == N - bool(words) and len(table.attrs["notes"]) == bool(words)
    assert words in "".join(table.attrs["notes"])
