"""`check` on the virtual turbine: silent on clean data, and each planted defect is named, channel and size."""

import re
import shutil

import h5py
import numpy as np
import pytest
from scipy import signal

from probupdate.campaign.checking import check
from probupdate.campaign.reading import read_campaign
from probupdate.virtual.simulation import simulate

DAYS = 0.125


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """Three hours, idling and running."""
    folder = tmp_path_factory.mktemp("clean") / "campaign"
    simulate(folder, days=DAYS, seed=11)
    return folder


@pytest.fixture
def with_defect(clean, tmp_path):
    """with_defect(change) -> findings and check of a copy whose records went through change(data, channels, file)."""

    def plant(change=None, head=None):
        folder = tmp_path / "campaign"
        shutil.copytree(clean, folder)
        if head is not None:
            text = (folder / "campaign.toml").read_text()
            (folder / "campaign.toml").write_text(head(text))
        channels = read_campaign(folder).channels
        for number, path in enumerate(sorted((folder / "acceleration").glob("*.h5"))):
            if change is None:
                continue
            with h5py.File(path, "r+") as file:
                data = np.array(file["data"][:], float)
                file["data"][...] = change(data, {c: k for k, c in enumerate(channels)}, number)
        result = check(read_campaign(folder))
        return [f for f in result.findings if "SCADA rows" not in f and "gaps too long" not in f], result

    return plant


@pytest.mark.parametrize(
    "seed", [11, *(pytest.param(s, marks=pytest.mark.long) for s in (12, 13, 14, 15, 16))])
def test_clean_data_are_not_suspected(clean, tmp_path, seed):
    if seed != 11:
        simulate(tmp_path / "c", days=DAYS, seed=seed)
    result = check(read_campaign(clean if seed == 11 else tmp_path / "c"))
    known = r"SCADA rows are missing|gaps too long|no record|lacks"
    assert [f for f in result.findings if not re.search(known, f)] == []
    assert any("clocks of 18 of 18 channels compared" in u for u in result.uses)


def scaled(name, factor):
    def change(data, at, _):
        data[:, at[name]] *= factor
        return data
    return change


def exchanged(a, b):
    def change(data, at, _):
        data[:, [at[a], at[b]]] = data[:, [at[b], at[a]]]
        return data
    return change


@pytest.mark.parametrize("name", ["TP-B-x", "TP-C-z", "T90-y"])
def test_a_flipped_channel_is_named(with_defect, name):
    found, _ = with_defect(scaled(name, -1))
    (one,) = found
    assert one.startswith(f"suspect: {name} looks flipped")


@pytest.mark.parametrize(("a", "b"), [("TP-A-x", "TP-A-y"), ("TP-B-z", "TP-D-z"), ("T66-x", "T66-y"),
                                      ("T66-y", "T90-x")])
def test_swapped_channels_are_named(with_defect, a, b):
    found, _ = with_defect(exchanged(a, b))
    assert any(f"{a} and {b} look swapped" in f for f in found), found
    assert len(found) == 1


@pytest.mark.parametrize(("name", "factor"), [("TP-D-y", 1.6), ("T66-x", 9.80665), ("T18-y", 1 / 9.80665),
                                              ("TP-A-z", 1e-3), ("T90-x", 100.0)])
def test_a_channel_in_another_unit_or_scale_is_named(with_defect, name, factor, validation):
    row = validation(what="a channel scaled from 1.6 times on: named, nothing else; its factor",
                     reference="what was planted", why="levels move alike")
    found, _ = with_defect(scaled(name, factor))
    mine = [f for f in found if f.removeprefix("suspect: ").startswith(name)]
    assert len(mine) == len(found) == 1 and "wrong unit or scale" in mine[0]
    size = float(re.search(r"(?:moves|reads) ([\d.e+-]+) times", mine[0])[1])
    row.error(size / factor - 1, below=0.25)


@pytest.mark.parametrize(("name", "kind", "corner_hz", "words"), [
    ("T66-x", "high", 0.4, "high"), ("T66-y", "low", 0.25, "low")])
def test_a_filtered_channel_is_no_scale(with_defect, name, kind, corner_hz, words, validation):
    row = validation(what="a channel behind a first-order filter: said, with gain and phase at the lowest motion",
                     reference="its transfer function", why="crosstalk of two modes")

    def change(data, at, _):
        filtered = signal.butter(1, corner_hz, kind, fs=25.0)
        data[:, at[name]] = signal.lfilter(*filtered, data[:, at[name]])
        return data

    found, _ = with_defect(change)
    (one,) = found
    gain, lead, side = re.search(r"reads ([0-9.]+) times .* (\d+) deg (ahead|behind)", one).groups()
    assert f"({words}-pass)" in one and "wrong unit" not in one
    _, exact = signal.freqz(*signal.butter(1, corner_hz, kind, fs=25.0), worN=[0.32], fs=25.0)
    response = float(gain) * np.exp(1j * np.radians(float(lead) * (1 if side == "ahead" else -1)))
    row.error(abs(response / exact[0] - 1), below=0.1, case=one)


def test_a_sensor_fixed_askew_is_named(with_defect):
    def turned(data, at, _):
        x, y = data[:, at["T66-x"]].copy(), data[:, at["T66-y"]].copy()
        angle = np.radians(35)
        data[:, at["T66-x"]] = np.cos(angle) * x + np.sin(angle) * y
        data[:, at["T66-y"]] = np.cos(angle) * y - np.sin(angle) * x
        return data

    found, _ = with_defect(turned)
    assert found and all("looks turned by about" in f and "T66" in f for f in found)
    assert abs(float(re.search(r"about (-?\d+) deg", found[0])[1])) == pytest.approx(35, abs=8)


def test_a_dead_channel_is_named(with_defect):
    rng = np.random.default_rng(1)

    def dead(data, at, _):
        data[:, at["T66-y"]] = 1e-3 * rng.standard_normal(len(data))
        return data

    found, _ = with_defect(dead)
    assert len(found) == 1 and found[0].startswith("suspect: T66-y looks dead")


@pytest.mark.parametrize(("name", "copy", "factor"), [("TP-A-x", "TP-B-x", 1.0), ("T66-x", "T90-y", -2.5)])
def test_a_copied_channel_is_named_with_its_original(with_defect, name, copy, factor):
    def copied(data, at, _):
        data[:, at[copy]] = factor * data[:, at[name]]
        return data

    found, _ = with_defect(copied)
    (one,) = (f for f in found if "one signal" in f)
    assert one.startswith(f"suspect: {name} and {copy} are one signal at every frequency"), one
    assert ("0.4 times the size" in one) == (factor != 1.0)


@pytest.mark.parametrize(("names", "delay_s"), [(("T66-x", "T66-y"), 0.04), (("TP-A-x", "TP-A-y", "TP-A-z"), -0.012),
                                                (("T90-x", "T90-y"), 0.68)])
def test_a_late_logger_is_named_and_measured(with_defect, names, delay_s, validation):
    row = validation(what="clocks 40, -12 and 680 ms off, in stated standard deviations or quarters of a millisecond",
                     reference="what was planted")
    def late(data, at, _):
        # a delay by interpolation through the spectrum; what is lost stays lost
        for name in names:
            column = data[:, at[name]]
            lost = np.isnan(column)
            spectrum = np.fft.rfft(np.where(lost, 0, column))
            phase = np.exp(-2j * np.pi * np.fft.rfftfreq(len(column), 1 / 25.0) * delay_s)
            data[:, at[name]] = np.where(lost, np.nan, np.fft.irfft(spectrum * phase, len(column)))
        return data

    found, _ = with_defect(late)
    assert len(found) == 1, found
    value, error = map(float, re.search(r"is ([\d.]+) \+- ([\d.]+) ms", found[0]).groups())
    assert all(n in found[0] for n in names) and ("recorded late by them" in found[0]) == (delay_s > 0)
    row.error((value - 1e3 * abs(delay_s)) / max(error, 0.25), below=4)


@pytest.mark.parametrize("true_rate", [25.6, 20.0])
def test_another_sampling_rate_shows_in_the_rotor_s_lines(tmp_path, true_rate):
    """Records of a logger at another rate, labelled 25 Hz: as many rows as fit, resampled from the true motion."""
    simulate(tmp_path / "c", days=DAYS, seed=15)

    def resampled(data):
        time = np.arange(len(data)) * 25.0 / true_rate
        index = np.arange(len(data))
        # beyond the hour's end the motion is mirrored: lines stay where they are
        mirrored = np.where(time < len(data) - 1, time, 2 * (len(data) - 1) - time)
        return np.column_stack([np.interp(mirrored, index, c) for c in np.nan_to_num(data).T])

    for path in (tmp_path / "c" / "acceleration").glob("*.h5"):
        with h5py.File(path, "r+") as file:
            file["data"][...] = resampled(np.array(file["data"][:], float))
    found = check(read_campaign(tmp_path / "c")).findings
    rate = [f for f in found if "lines of the rotor" in f]
    assert len(rate) == 1, found
    low, high = map(float, re.search(r"would be ([\d.]+) to ([\d.]+) Hz", rate[0]).groups())
    assert low < true_rate < high


def test_everything_in_another_unit_is_suspected(with_defect):
    found, _ = with_defect(head=lambda text: text.replace('unit = "m/s2"', 'unit = "mg"'))
    assert len(found) == 1 and "are all channels in the stated unit" in found[0]
    assert with_gravity(found) is None


def with_gravity(found):
    return next((f for f in found if "gravity" in f), None)


def test_gravity_in_vertical_channels_tells_the_unit(with_defect):
    def gravity(data, at, _):
        for name, k in at.items():
            if name.endswith("-z"):
                data[:, k] += 9.80665
        return data / 9.80665

    found, _ = with_defect(gravity)
    assert "they seem to be in g" in with_gravity(found)


def test_drifts_jumps_and_stops_are_named(with_defect):
    def change(data, at, number):
        data[:, at["TP-A-x"]] += np.linspace(0, 0.2, len(data))
        data[30000:, at["T18-x"]] += 0.1
        if number == 1:
            data[1000:1200, at["T90-y"]] = data[1000, at["T90-y"]]
            data[5000, at["TP-B-z"]] += 0.03
            limit = 1.5 * np.nanstd(data[:, at["T66-x"]])
            data[:, at["T66-x"]] = np.clip(data[:, at["T66-x"]], -limit, limit)
        return data

    found, _ = with_defect(change)
    text = "\n".join(found)
    for words in ("TP-A-x drifts", "T18-x drifts", "T90-y is constant for up to 8.0 s in 1 blocks",
                  "TP-B-z has 1 spikes", "T66-x stands at its extreme value"):
        assert words in text, (words, text)
    assert len(found) == 5, text


def test_the_table_has_a_row_a_block_and_channel(with_defect, tmp_path):
    _, result = with_defect(scaled("T66-x", -1))
    path = result.write(tmp_path / "check.json")
    lines = path.with_name("check.channels.csv").read_text().splitlines()
    assert len(lines) == 1 + len(result.blocks) * 18 and lines[0].endswith("delay_ms,suspicion")
    assert sum(line.endswith(",flipped") for line in lines) >= 4
