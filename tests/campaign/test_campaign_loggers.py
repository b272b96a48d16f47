"""Loggers' files through `convert`: written by each format's own library, read with their rates, starts and gaps."""

import json
import re
import struct
import sys
import tomllib

import numpy as np
import pandas as pd
import pytest
import scipy.io.wavfile
from source_table import records

from probupdate.campaign.converting import convert
from probupdate.cli.program import main
from probupdate.errors import InputError

RATE, START = 10.0, pd.Timestamp("2026-01-01T00:00:00.25Z")
OWN = 'files = "*.*"\ntime = "file"\n'
COLUMNS = '[columns]\n"a-x" = "east"\n"a-y" = "north"\n'
# campaign.toml of the fixture has a-x in m/s2 and a-y in g
INTO_SI = np.array([1.0, 9.80665])


def library(name: str):
    return pytest.importorskip(name, reason=f"{name} is an extra that this environment does not have")


def noise(n=3000, seed=1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, 2))


def tdms(path, channels, mode="w"):
    """channels: (name, data, step in s, start or None, unit)."""
    nptdms = library("nptdms")
    with nptdms.TdmsWriter(path, mode=mode) as writer:
        writer.write_segment([nptdms.ChannelObject("g", name, data, {
            **({} if start is None else {"wf_start_time": start.tz_convert(None).to_datetime64()}),
            **({} if step is None else {"wf_increment": step}), "unit_string": unit,
        }) for name, data, step, start, unit in channels])


def mdf(path, groups, start=START):
    """groups: (times, [(name, samples, unit)])."""
    asammdf = library("asammdf")
    with asammdf.MDF(version="4.10") as file:
        file.start_time = start.to_pydatetime()
        for times, own in groups:
            file.append([asammdf.Signal(data, times, name=name, unit=unit) for name, data, unit in own])
        file.save(path, overwrite=True)


def sac(path, data, start=START, *, station="TP", component="HNX", delta=0.1, order="<", idep=8, begins=0.0):
    """A SAC file of version 6 by its published layout."""
    numbers, whole = np.full(70, -12345.0, f"{order}f4"), np.full(40, -12345, f"{order}i4")
    numbers[0], numbers[5] = delta, begins
    whole[:6] = start.year, start.day_of_year, start.hour, start.minute, start.second, start.microsecond // 1000
    whole[6], whole[9], whole[15], whole[16], whole[35] = 6, len(data), 1, idep, 1
    text = f"{station:8}{'':16}{'00':8}".ljust(160, " ") + f"{component:8}{'XX':8}".ljust(32)
    path.write_bytes(numbers.tobytes() + whole.tobytes() + text.encode() + np.asarray(data, f"{order}f4").tobytes())


def miniseed(path, pieces, **options):
    """pieces: (channel, data, start); by libmseed's own writer."""
    pymseed = library("pymseed")
    traces = pymseed.MS3TraceList()
    for channel, data, start in pieces:
        traces.add_data(sourceid=f"FDSN:XX_TP_00_H_N_{channel}", data_samples=data, sample_type=data.dtype.char,
                        sample_rate=options.get("rate", RATE), starttime=start.as_unit("ns").value)
    traces.to_file(str(path))


SEED = '[columns]\n"a-x" = "XX.TP.00.HNX"\n"a-y" = "XX.TP.00.HNY"\n'


# What the file says of itself ---------------------------------------------------------------------------------------


def test_tdms_gives_samples_start_and_units(job):
    raw, campaign = job(OWN + COLUMNS)
    data = noise()
    tdms(raw / "r.tdms", [("east", data[:, 0], 0.1, START, "g"), ("north", data[:, 1], 0.1, START, "mg")])
    text = convert(raw, campaign).summary
    (start, found), = records(campaign)
    assert start == START
    np.testing.assert_allclose(found, data * [9.80665, 1e-3], rtol=1e-6)
    assert "g was turned into m/s2" in text


def test_mdf_gives_samples_start_and_units(job):
    raw, campaign = job(OWN + COLUMNS)
    data, zone = noise(), START.tz_convert("Europe/Berlin")
    mdf(raw / "r.mf4", [(np.arange(3000) / 10, [("east", data[:, 0], "m/s²"), ("north", data[:, 1], "m/s2")])], zone)
    convert(raw, campaign)
    (start, found), = records(campaign)
    assert start == START
    np.testing.assert_allclose(found, data / INTO_SI, rtol=1e-6)


def test_mdf_samples_marked_invalid_are_lost(job):
    asammdf = library("asammdf")
    raw, campaign = job(OWN + COLUMNS)
    data, invalid = noise(), np.zeros(3000, bool)
    invalid[7] = True
    with asammdf.MDF(version="4.10") as file:
        file.start_time = START.to_pydatetime()
        file.append([asammdf.Signal(data[:, k], np.arange(3000) / 10, name=name, invalidation_bits=bits)
                     for k, (name, bits) in enumerate([("east", None), ("north", invalid)])])
        file.save(raw / "r.mf4")
    convert(raw, campaign)
    (_, found), = records(campaign)
    assert np.argwhere(np.isnan(found)).tolist() == [[7, 1]]
    assert len(found) == 3000


def test_miniseed_gives_samples_and_start(job):
    raw, campaign = job(OWN + SEED)
    data = noise()
    miniseed(raw / "XX.TP.00.HN.D.2026.001", [("X", data[:, 0].copy(), START), ("Y", data[:, 1].copy(), START)])
    convert(raw, campaign)
    (start, found), = records(campaign)
    assert start == START
    np.testing.assert_array_equal(found, data.astype(np.float32))


def test_counts_of_miniseed_ask_for_a_factor(job):
    raw, campaign = job(OWN + SEED)
    counts = np.arange(100, dtype=np.int32) % 7
    miniseed(raw / "r.mseed", [("X", counts, START), ("Y", counts, START)])
    with pytest.raises(InputError, match=r"is in counts.*give m/s2 per counts under \[factor\]"):
        convert(raw, campaign)


@pytest.mark.parametrize("order", ["<", ">"])
def test_sac_files_of_a_channel_each_are_joined(job, order):
    raw, campaign = job(OWN + "join_pattern = '^(\\d+)'\n[columns]\n\"a-x\" = \"XX.TP.00.HNX\"\n\"a-y\" = \"HNY\"\n")
    data = noise()
    sac(raw / "2026001.X.sac", 1e9 * data[:, 0], order=order)
    sac(raw / "2026001.Y.SAC", 1e9 * data[:, 1], component="HNY", order=order)
    convert(raw, campaign)
    (start, found), = records(campaign)
    assert start == START
    np.testing.assert_allclose(found, data / INTO_SI, rtol=1e-6)


@pytest.mark.filterwarnings("ignore")
def test_sac_agrees_with_obspy(job):
    obspy = library("obspy")
    raw, campaign = job(OWN + 'join_pattern = "(r)"\noverrule = ["unit"]\n' + SEED)
    data = noise().astype(np.float32)
    for k, name in enumerate(("HNX", "HNY")):
        trace = obspy.Trace(data[:, k], {"network": "XX", "station": "TP", "location": "00", "channel": name,
                                         "sampling_rate": RATE, "starttime": obspy.UTCDateTime(START.timestamp())})
        trace.write(str(raw / f"r{k}.sac"), format="SAC")
    convert(raw, campaign)
    (start, found), = records(campaign)
    assert start == START
    np.testing.assert_array_equal(found, data)


@pytest.mark.parametrize(("kind", "steps"), [("u1", 2**7), ("<i2", 2**15), ("<i4", 2**31)])
def test_wav_is_in_shares_of_full_scale(job, kind, steps):
    text = ('files = "*.wav"\nstart_pattern = \'(\\d{8}T\\d{6})\'\nzone = "UTC"\n[columns]\n"a-x" = 1\n"a-y" = 2\n'
            '[factor]\n"a-x" = 20.0\n"a-y" = 2.0\n')
    raw, campaign = job(text, 100.0)
    share = np.round(0.2 * np.clip(noise(), -4, 4) * steps) / steps
    stored = share * steps + (128 if kind == "u1" else 0)
    scipy.io.wavfile.write(raw / "20260101T000000.wav", 100, stored.astype(kind))
    convert(raw, campaign)
    (start, found), = records(campaign)
    assert start == pd.Timestamp("2026-01-01T00:00:00Z")
    np.testing.assert_allclose(found, share * [20.0, 2.0], rtol=1e-6, atol=1e-7)


def test_a_start_is_stated_beside_the_file_s_own_rate(job):
    raw, campaign = job(OWN + 'start = "2026-01-01T00:00Z"\n[columns]\n"a-x" = 1\n"a-y" = 2\n')
    scipy.io.wavfile.write(raw / "r.wav", 10, noise().astype(np.float32))
    convert(raw, campaign)
    assert records(campaign)[0][0] == pd.Timestamp("2026-01-01T00:00Z")


def test_whole_numbers_of_wav_ask_for_a_factor(job):
    raw, campaign = job('files = "*.wav"\nstart = "2026-01-01T00:00Z"\n[columns]\n"a-x" = 1\n"a-y" = 2\n', 100.0)
    scipy.io.wavfile.write(raw / "r.wav", 100, np.zeros((500, 2), np.int16))
    with pytest.raises(InputError, match="is in full scale"):
        convert(raw, campaign)


# Rates --------------------------------------------------------------------------------------------------------------


def unequal(raw):
    data, slow = noise(), noise(300)
    tdms(raw / "r.tdms", [("east", data[:, 0], 0.1, START, ""), ("north", slow[:, 1], 1.0, START, "")])


@pytest.mark.parametrize(("rate", "remedy"), [(10.0, "take g/north out of campaign.toml"), (1.0, "decimate = true")])
def test_channels_of_unequal_rates_are_refused(job, rate, remedy):
    raw, campaign = job(OWN + COLUMNS, rate)
    unequal(raw)
    with pytest.raises(InputError, match="unequal rates: g/east 10 Hz; g/north 1 Hz") as error:
        convert(raw, campaign)
    assert remedy in str(error.value)


def test_only_whole_multiples_are_advised_to_decimate(job):
    raw, campaign = job(OWN + COLUMNS)
    tdms(raw / "r.tdms", [(name, noise()[:, 0], step, START, "") for name, step in (("east", 0.1), ("north", 0.102))])
    with pytest.raises(InputError, match="take g/north out of campaign.toml; nothing is interpolated"):
        convert(raw, campaign)


def test_mdf_rasters_of_unequal_rates_are_refused(job):
    raw, campaign = job(OWN + COLUMNS)
    mdf(raw / "r.mf4", [(np.arange(3000) / 10, [("east", np.ones(3000), "")]),
                        (np.arange(300.0), [("north", np.ones(300), "")])])
    with pytest.raises(InputError, match="unequal rates"):
        convert(raw, campaign)


def test_stated_decimation_keeps_phase_and_amplitude(job):
    raw, campaign = job(OWN + "decimate = true\n" + COLUMNS)
    fine, coarse = np.arange(30000) / 100, np.arange(3000) / 10
    tdms(raw / "r.tdms", [
        # 2 Hz stays, 8 Hz would come back as 2 Hz
        ("east", np.sin(4 * np.pi * fine) + np.sin(16 * np.pi * fine + 1), 0.01, START, ""),
        ("north", np.sin(4 * np.pi * coarse), 0.1, START, "")])
    text = convert(raw, campaign).summary
    (start, found), = records(campaign)
    assert start == START
    assert "g/east: decimated 10:1 with zero phase" in text
    whole = np.isfinite(found[:, 0])
    assert whole.sum() == len(found) - 32
    assert np.abs(found[whole, 0] - found[whole, 1]).max() < 1.5e-3


def test_marked_samples_are_lost_before_decimation(job):
    raw, campaign = job(OWN + "decimate = true\nlost = [-999.0]\n" + COLUMNS)
    fine = np.ones(10000)
    fine[5000] = -999.0
    tdms(raw / "r.tdms", [("east", fine, 0.01, START, ""), ("north", np.ones(1000), 0.1, START, "")])
    convert(raw, campaign)
    (_, found), = records(campaign)
    assert np.flatnonzero(np.isnan(found[16:-16, 0])).tolist() == list(range(500 - 32, 500 + 1))
    np.testing.assert_allclose(found[np.isfinite(found)], 1.0, rtol=1e-3)


# Gaps and overlaps --------------------------------------------------------------------------------------------------


def test_gaps_of_one_channel_stay_lost(job):
    raw, campaign = job(OWN + SEED)
    data = noise()
    later = START + pd.Timedelta(seconds=150)
    miniseed(raw / "r.mseed", [("X", data[:1000, 0].copy(), START), ("X", data[1500:, 0].copy(), later),
                               ("Y", data[:, 1].copy(), START)])
    convert(raw, campaign)
    (_, found), = records(campaign)
    expected = data.astype(np.float32)
    expected[1000:1500, 0] = np.nan
    np.testing.assert_array_equal(found, expected)


def overlapping(raw, difference):
    data = noise()
    for k, (a, b) in enumerate([(0, 2000), (1800, 3000)]):
        later = START + pd.Timedelta(seconds=a / RATE)
        for c, name in enumerate(("HNX", "HNY")):
            sac(raw / f"r.{k}.{name}.sac", data[a:b, c] + k * difference, later, component=name, idep=5)
    return data


def test_overlaps_that_agree_are_joined(job):
    raw, campaign = job(OWN + 'join_pattern = "(r)"\n' + SEED)
    data = overlapping(raw, 1e-8)
    text = convert(raw, campaign).summary
    (_, found), = records(campaign)
    np.testing.assert_allclose(found, data, atol=1e-6)
    assert "XX.TP.00.HNX: 200 samples stand twice, agree and were joined" in text


def test_overlaps_that_differ_name_both_files(job):
    raw, campaign = job(OWN + 'join_pattern = "(r)"\n' + SEED)
    overlapping(raw, 1e-3)
    with pytest.raises(InputError, match=r"r\.1\.HNX\.sac.*overlaps .*r\.0\.HNX\.sac by 200 samples"):
        convert(raw, campaign)


@pytest.mark.parametrize("difference", [0.0, 1e-3])
def test_overlaps_between_sources_agree_or_are_refused(job, difference):
    raw, campaign = job(OWN + "join_pattern = '^(r.\\d)'\n" + SEED)
    overlapping(raw, difference)
    if not difference:
        assert "overlap by 200 samples, which agree" in convert(raw, campaign).summary
        return
    with pytest.raises(InputError, match=r"r\.1\.HNX\.sac: overlaps r\.0\.HNX\.sac .* by 200 samples"):
        convert(raw, campaign)
    assert len(records(campaign)) == 1


def test_samples_between_those_of_another_channel_are_refused(job):
    raw, campaign = job(OWN + COLUMNS)
    later = START + pd.Timedelta(seconds=0.03)
    tdms(raw / "r.tdms", [("east", np.ones(500), 0.1, START, ""), ("north", np.ones(500), 0.1, later, "")])
    with pytest.raises(InputError, match=r"samples of g/north lie 0\.30 samples \(30 ms\) from those of g/east"):
        convert(raw, campaign)


def test_a_channel_that_starts_later_is_lost_until_then(job):
    raw, campaign = job(OWN + COLUMNS)
    data = noise()
    later = START + pd.Timedelta(seconds=20)
    tdms(raw / "r.tdms", [("east", data[:, 0], 0.1, START, ""), ("north", data[200:, 1], 0.1, later, "")])
    convert(raw, campaign)
    (_, found), = records(campaign)
    assert np.isnan(found[:200, 1]).all()
    np.testing.assert_allclose(found[200:], data[200:], rtol=1e-6)


def test_tdms_that_was_started_twice_is_refused(job):
    raw, campaign = job(OWN + COLUMNS)
    for mode, start in (("w", START), ("a", START + pd.Timedelta(hours=1))):
        tdms(raw / "r.tdms", [("east", np.ones(500), 0.1, start, ""), ("north", np.ones(500), 0.1, start, "")], mode)
    with pytest.raises(InputError, match="several recordings in a row"):
        convert(raw, campaign)


def test_an_own_start_is_not_replaced_in_silence(job):
    raw, campaign = job('files = "*.tdms"\nstart = "2020-01-01T00:00Z"\n' + COLUMNS)
    tdms(raw / "r.tdms", [("east", np.ones(500), 0.1, START, ""), ("north", np.ones(500), 0.1, START, "")])
    with pytest.raises(InputError, match="states its own start, 2026-01-01 00:00:00.25"):
        convert(raw, campaign)


# Missing and spoilt -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("module", "ending", "extra"), [
    ("nptdms", "tdms", "tdms"), ("asammdf", "mf4", "mdf"), ("pymseed", "mseed", "miniseed")])
def test_a_missing_library_is_named_with_its_extra(job, monkeypatch, module, ending, extra):
    raw, campaign = job(OWN)
    (raw / f"r.{ending}").write_bytes(b"-")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"pip install probupdate\[{extra}\]"):
        convert(raw, campaign)


@pytest.mark.parametrize(("module", "ending"), [
    ("nptdms", "tdms"), ("asammdf", "mf4"), ("pymseed", "mseed"), ("numpy", "sac"), ("numpy", "wav")])
@pytest.mark.parametrize("content", [b"", b"TDSm" + bytes(range(200)), struct.pack("<70i", *range(70)) * 4])
@pytest.mark.filterwarnings("ignore")
def test_spoilt_logger_files_are_refused_in_one_line(job, module, ending, content):
    library(module)
    raw, campaign = job(OWN)
    (raw / f"r.{ending}").write_bytes(content)
    with pytest.raises(InputError) as error:
        convert(raw, campaign)
    assert f"r.{ending}" in str(error.value) and len(str(error.value).splitlines()) == 1


# Files to fill in ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("line, rate", [
    ("Sampling rate: 51.2 Hz", 51.2), ("# fs = 100", 100.0), ("Sample Rate (Hz);200", 200.0), ("% dt: 0,01 s", 100.0),
    ("Channels: 5", None),
])
def test_a_rate_stated_above_a_table_is_its_rate(tmp_path, line, rate):
    rows = "".join(f"{0.02 * k:.3f};{k}.5;{k}.1\n" for k in range(30))
    (tmp_path / "raw.csv").write_text(f"{line}\nt;A1 [m/s2];A2 [m/s2]\n{rows}")
    out = tmp_path / "described" / "campaign.toml"
    assert main(["convert", "--describe", str(tmp_path / "raw.csv"), "--out", str(out)]) == 0
    assert tomllib.loads(out.read_text())["sampling_rate_hz"] == (rate or "?")


def described(folder, *, fill=()):
    out = folder / "described" / "campaign.toml"
    assert main(["convert", "--describe", str(folder / "raw"), "--out", str(out)]) == 0
    text = out.read_text()
    for blank, value in fill:
        text = text.replace(blank, value)
    out.write_text(text)
    return out


@pytest.mark.parametrize("ending", ["tdms", "mf4", "sac", "mseed"])
def test_a_described_file_converts_once_filled_in(job, tmp_path, ending):
    raw, _ = job("")
    data = np.ones(600)
    if ending == "tdms":
        tdms(raw / "r.tdms", [("east", data, 0.1, START, "g")])
    elif ending == "mf4":
        mdf(raw / "r.mf4", [(np.arange(600) / 10, [("east", data, "g")])])
    elif ending == "sac":
        sac(raw / "r.sac", data)
    else:
        miniseed(raw / "r.mseed", [("X", data, START)])
    out = described(tmp_path, fill=[
        ('position_m = "?"', "position_m = [0.0, 0.0, 1.0]"), ('direction = "?"', "direction = [1.0, 0.0, 0.0]"),
        ('block_minutes = "?"', "block_minutes = 1"), ('level = "?"', 'level = "a"'),
        ('quantity = "?"', 'quantity = "acceleration"'), ('unit = "?"', 'unit = "m/s2"')])
    convert(raw, out.parent)
    (start, found), = records(out.parent)
    assert start == START
    np.testing.assert_allclose(found, 1e-9 if ending == "sac" else 1.0, rtol=1e-6)


LOGGERS = {
    "lines of a logger": ("Logger 7\nSite: north\n\ntime,F1,F2\n", "", ",", "."),
    "units below the names": ("Station;3\nwhen;F1;F2\n-;mg;mg\n", "units_row = 3\n", ";", ","),
    "tabs and a rate": ("# sampling rate 10 Hz\ntime [s]\tF1 [g]\tF2 [g]\n", "", "\t", "."),
}


def logger_file(raw, kind):
    """A minute of two channels; the lines above its numbers."""
    head, _, separator, decimal = LOGGERS[kind]
    seconds = np.arange(600) / 10
    times = seconds.astype(str) if "[s]" in head else [
        (pd.Timestamp("2024-05-01") + pd.Timedelta(t, "s")).isoformat() for t in seconds]
    rows = [separator.join([time, *(f"{np.sin(k + c):.5f}".replace(".", decimal) for c in (0, 1))])
            for k, time in enumerate(times)]
    (raw / "r.csv").write_text(head + "\n".join(rows) + "\n")
    return head.splitlines()


@pytest.mark.parametrize("kind", LOGGERS)
def test_lines_above_a_tables_names_are_counted_in_the_remedy(job, kind):
    """The value that the error says is set, and the file converts."""
    raw, campaign = job("")
    lines = logger_file(raw, kind)
    names = lines[-1 - bool(LOGGERS[kind][1])].split(LOGGERS[kind][2])
    text = (f'files = "*.csv"\ntime = "{names[0]}"\nzone = "UTC"\nseparator = {json.dumps(LOGGERS[kind][2])}\n'
            + f'decimal = "{LOGGERS[kind][3]}"\n' + LOGGERS[kind][1]
            + ('time_unit = "s"\nstart = "2024-05-01T00:00:00"\n' if "[s]" in names[0] else ""))
    columns = '[columns]\n"a-x" = "F1"\n"a-y" = "F2"\n'
    job(text + columns)
    with pytest.raises(InputError) as refused:
        convert(raw, campaign)
    said = re.search(r"skip_rows = \d", str(refused.value))
    assert said and "columns' names in line" in str(refused.value)
    job(text + said[0] + "\n" + columns)
    convert(raw, campaign)
    (_, found), = records(campaign)
    assert found.shape == (600, 2)


@pytest.mark.parametrize("kind", LOGGERS)
def test_a_described_table_converts_once_filled_in(job, tmp_path, kind):
    raw, _ = job("")
    logger_file(raw, kind)
    out = described(tmp_path, fill=[
        ('sampling_rate_hz = "?"', "sampling_rate_hz = 10.0"), ('position_m = "?"', "position_m = [0.0, 0.0, 1.0]"),
        ('direction = "?"', "direction = [1.0, 0.0, 0.0]"), ('block_minutes = "?"', "block_minutes = 1"),
        ('level = "?"', 'level = "a"'), ('quantity = "?"', 'quantity = "acceleration"'),
        ('unit = "?"', 'unit = "m/s2"')])
    beside = out.with_name("convert.toml")
    beside.write_text(beside.read_text().replace('zone = "?"', 'zone = "UTC"').replace(
        'time_unit = "?"', 'start = "2024-05-01T00:00:00Z"\ntime_unit = "s"'))
    convert(raw, out.parent)
    (_, found), = records(out.parent)
    np.testing.assert_allclose(found[:, 0], np.sin(np.arange(600)), atol=1e-4)
    unit = {"units below the names": "mg", "tabs and a rate": "g"}.get(kind, "m/s2")
    assert out.read_text().count(f'unit = "{unit}"') == 2


@pytest.mark.parametrize(("unit", "ending"), [
    ("ms", "parquet"), ("s", "parquet"), ("ns", "csv"), ("stamps", "parquet")])
def test_unix_times_are_described_with_their_unit(job, tmp_path, unit, ending):
    raw, _ = job("")
    pytest.importorskip("pyarrow")
    times = pd.date_range("2024-05-01T10:00:00Z", periods=600, freq="100ms")
    count = times.as_unit("ns").asi8
    numbers = {"stamps": times, "ns": count, "ms": count // 10**6, "s": count / 1e9}[unit]
    table = pd.DataFrame({"time": numbers, "F1 [g]": np.sin(np.arange(600.0))})
    table.to_parquet(raw / "a.parquet") if ending == "parquet" else table.to_csv(raw / "a.csv", index=False)
    out = described(tmp_path, fill=[
        ('position_m = "?"', "position_m = [0.0, 0.0, 1.0]"), ('direction = "?"', "direction = [1.0, 0.0, 0.0]"),
        ('block_minutes = "?"', "block_minutes = 1"), ('level = "?"', 'level = "a"')])
    beside = out.with_name("convert.toml")
    beside.write_text(beside.read_text().replace('zone = "?"', 'zone = "UTC"'))
    convert(raw, out.parent)
    (start, found), = records(out.parent)
    np.testing.assert_allclose(found[:, 0], np.sin(np.arange(600)), atol=1e-4)
    assert pd.Timestamp(start) == times[0] and 'unit = "g"' in out.read_text()


@pytest.mark.parametrize(("days", "shown", "written"), [
    ([14], "%d.%m.%Y %H:%M:%S,%f", "%d.%m.%Y %H:%M:%S,%f"),
    ([14], "%m/%d/%Y %I:%M:%S.%f %p", "%m/%d/%Y %I:%M:%S.%f %p"),
    # the second file's day shows what the first one's does not
    ([12, 13], "%d/%m/%Y %H:%M:%S.%f", "%d/%m/%Y %H:%M:%S.%f"),
    ([2], "%d/%m/%Y %H:%M:%S.%f", "?"), ([14], "%Y-%m-%d %H:%M:%S.%f", None), ([14], "%d.%m.%y %H:%M:%S,%f", "?"),
])
def test_stamps_that_are_not_iso_are_described(tmp_path, days, shown, written):
    (tmp_path / "raw").mkdir()
    for k, day in enumerate(days):
        stamps = pd.date_range(f"2025-10-{day:02d} 09:00", periods=60, freq="20ms")
        rows = "".join(f"{t.strftime(shown)};{0.1 * (n % 7):.4f};{0.2 * (n % 5):.4f}\n" for n, t in enumerate(stamps))
        (tmp_path / "raw" / f"{k}.csv").write_text(f"when;F1 [g];F2 [g]\n{rows}")
    out = described(tmp_path)
    found = tomllib.loads(out.with_name("convert.toml").read_text())
    assert found.get("time_format") == written
    assert tomllib.loads(out.read_text())["sampling_rate_hz"] == 50.0
    if written == "?":
        assert shown in out.with_name("convert.toml").read_text()


def test_check_names_the_blanks_of_a_described_campaign(job, tmp_path, capsys):
    raw, _ = job("")
    sac(raw / "r.sac", np.ones(600))
    out = described(tmp_path)
    (out.parent / "acceleration").mkdir()
    capsys.readouterr()
    assert main(["check", str(out.parent)]) == 2
    said = capsys.readouterr().err
    assert 'block_minutes; level, position_m, direction' in said and "of HNX" in said


def test_a_described_campaign_is_not_written_over(job, tmp_path, capsys):
    raw, _ = job("")
    sac(raw / "r.sac", np.ones(600))
    out = described(tmp_path)
    assert main(["convert", "--describe", str(raw), "--out", str(out)]) == 2
    assert "already exists" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--describe", "raw"], ["raw"], ["raw", "x", "--describe", "raw"]])
def test_convert_without_its_paths_says_what_to_give(words, capsys):
    assert main(["convert", *words]) == 2
    assert "--describe RAW --out campaign.toml" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"a,b\n\x00\x01,\x02\n", b'a,b\n"' + b"x" * 200_000 + b"\n", b"", b"\n\n"])
def test_a_text_that_is_no_table_is_not_described(tmp_path, capsys, content):
    (tmp_path / "raw.csv").write_bytes(content)
    out = tmp_path / "c" / "campaign.toml"
    assert main(["convert", "--describe", str(tmp_path / "raw.csv"), "--out", str(out)]) == 2
    assert "has no rows of numbers" in capsys.readouterr().err


def test_a_second_loggers_table_is_not_left_out_in_silence(tmp_path, capsys):
    """Half of the channels had been described, without a word, and conversion asked to rename the others."""
    raw = tmp_path / "raw"
    raw.mkdir()
    for name, channels in (("L1_00", "A1,A2"), ("L1_01", "A1,A2"), ("L2_00", "B1,B2")):
        rows = [f"2024-05-01T00:00:{0.1 * k:04.1f},{0.01 * k},{0.02 * k}" for k in range(40)]
        (raw / f"{name}.csv").write_text("\n".join([f"time,{channels}", *rows]) + "\n")
    assert main(["convert", "--describe", str(raw), "--out", str(tmp_path / "campaign.toml")]) == 0
    said = capsys.readouterr().out
    assert "1 of 3 files have other columns than L1_00.csv (L2_00.csv: B1, B2)" in said
    assert "a table [[logger]] for each" in said
