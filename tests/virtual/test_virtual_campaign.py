"""`simulate`: the files, read back by plain means; same seed, same bytes; spectra against the truth."""

import hashlib
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pandas
import pytest
from scipy.signal import welch

from probupdate.errors import InputError
from probupdate.virtual import losses, simulation, truth

AS_BUILT = "as_built"


def digest(folder):
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(Path(folder).rglob("*"))
        if p.is_file()
    }


def write(path, text):
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def idle(tmp_path_factory):
    """Three hours at a standstill in a fresh breeze, without losses in the first two."""
    folder = tmp_path_factory.mktemp("idle")
    given = write(folder / "given.toml", "[operation]\nmaintenance_hours = [[0, 3]]\nwind_speed_mean_mps = 11.0\n")
    return simulation.simulate(folder / "out", model=AS_BUILT, days=0.125, truth=given, seed=21)


@pytest.mark.parametrize("time_profile", ['"step"\nat_hour = 3.0', '"ramp"\nfrom_hour = 5.0\nto_hour = 9.0'])
def test_an_effect_that_begins_behind_the_records_end_is_refused(tmp_path, time_profile):
    given = write(tmp_path / "T.toml", '[[effect]]\nkind = "sensor_gain"\nchannel = "T90-x"\nfactor = 1.1\n'
                  f"time_profile = {time_profile}\n")
    with pytest.raises(InputError, match=r"T\.toml, effect 1 .sensor_gain., (at|from)_hour: .* end at 3 h"):
        simulation.simulate(tmp_path / "out", model=AS_BUILT, days=0.125, truth=given, seed=1)
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    folder = tmp_path_factory.mktemp("short")
    given = write(folder / "given.toml", "[operation]\nmissing_hours = [1]\n")
    return simulation.simulate(folder / "out", model=AS_BUILT, days=0.13, truth=given, seed=5)


def load(path):
    with h5py.File(path) as file:
        return file["data"][:], dict(file["data"].attrs)


def test_files_are_those_of_the_interface(short):
    campaign = tomllib.loads((short.path / "campaign.toml").read_text())
    assert campaign["sampling_rate_hz"] == 25.0 and campaign["block_minutes"] == 30
    assert campaign["water_depth_m"] == 38.0
    assert len(campaign["sensor"]) == 18
    assert set(campaign["sensor"][0]) == {"channel", "level", "position_m", "direction", "quantity", "unit", "gravity"}
    files = sorted((short.path / "acceleration").iterdir())
    # 19 slots = 3 h 10 min; hour 1 is missing
    assert len(files) == short.n_file == 3
    starts = []
    for path in files:
        data, attributes = load(path)
        assert data.dtype == np.float32 and data.shape[1] == 18
        assert attributes["sampling_rate_hz"] == 25.0
        starts.append(np.datetime64(attributes["start"].removesuffix("Z")))
    hours = (np.array(starts) - np.datetime64("2019-06-01")) / np.timedelta64(1, "h")
    assert hours == pytest.approx([0, 2, 3])
    assert len(load(files[-1])[0]) <= 600 * 25
    scada = pandas.read_csv(short.path / "scada.csv", parse_dates=["time"])
    for name in ("wind_speed_mps", "wind_direction_deg", "power_kw", "rotor_speed_rpm", "pitch_deg",
                 "nacelle_heading_deg", "yaw_rate_degps", "water_level_m", "air_temperature_c", "wave_height_m",
                 "wave_period_s", "pitch_deg_std", "power_kw_min", "wind_speed_mps_max"):
        assert scada[name].notna().all()
    record = tomllib.loads(short.truth_path.read_text())
    lost = sum(g["kind"] == losses.LOST_ROW for g in record.get("gap", []))
    assert 19 - lost <= len(scada) <= 19


def test_losses_in_the_data_are_those_of_the_truth(tmp_path):
    result = simulation.simulate(tmp_path / "out", model=AS_BUILT, days=0.25, seed=2)
    record = tomllib.loads(result.truth_path.read_text())
    channels = [s["channel"] for s in tomllib.loads((result.path / "campaign.toml").read_text())["sensor"]]
    expected = np.zeros((6 * 90000, 18), bool)
    for gap in record["gap"]:
        low = round(gap["start_s"] * 25)
        high = round((gap["start_s"] + gap["duration_s"]) * 25)
        if gap["kind"] in (losses.MISSING_HOUR, losses.SHORT_FILE):
            expected[low:high] = True
        elif gap["kind"] == losses.LOST_SAMPLES:
            expected[low:high, channels.index(gap["channel"]) if gap["channel"] else slice(None)] = True
    found = np.ones_like(expected)
    for path in (result.path / "acceleration").iterdir():
        data, attributes = load(path)
        since = np.datetime64(attributes["start"].removesuffix("Z")) - np.datetime64("2019-06-01")
        first = round(since / np.timedelta64(1, "s") * 25)
        found[first : first + len(data)] = np.isnan(data)
    assert expected.any()
    assert np.array_equal(found, expected)


def test_same_seed_same_bytes_and_a_stopped_run_goes_on(tmp_path, short):
    given = tmp_path / "given.toml"
    given.write_text("[operation]\nmissing_hours = [1]\n")
    again = tmp_path / "again"
    simulation.simulate(again, model=AS_BUILT, days=0.13, truth=given, seed=5)
    first = digest(short.path)
    assert digest(again) == first
    # as if stopped before the second file was whole; what a killed process leaves is tests/commands' matter
    sorted((again / "acceleration").iterdir())[1].unlink()
    simulation.simulate(again, model=AS_BUILT, days=0.13, truth=given, seed=5)
    assert digest(again) == first
    with pytest.raises(InputError, match="holds something else"):
        simulation.simulate(again, model=AS_BUILT, days=0.13, truth=given, seed=6)
    other = simulation.simulate(tmp_path / "other", model=AS_BUILT, days=0.05, seed=6)
    assert other.frequency_hz[0] != short.frequency_hz[0]


def test_the_record_can_be_given_back(tmp_path, short):
    back = simulation.simulate(tmp_path / "back", model=AS_BUILT, days=0.13, truth=short.truth_path, seed=5)
    assert digest(back.path) == digest(short.path)


def test_prior_draws_differ_and_given_parameters_hold(tmp_path):
    given = write(tmp_path / "given.toml", 'parameters_from = "prior"\n[parameters]\nk_t = 1.83\n')
    drawn = []
    for seed in (1, 2):
        result = simulation.simulate(tmp_path / str(seed), model=AS_BUILT, days=0.021, truth=given, seed=seed)
        drawn.append(tomllib.loads(result.truth_path.read_text())["parameters"])
    assert drawn[0]["k_t"] == drawn[1]["k_t"] == 1.83
    assert drawn[0]["k_j"] != drawn[1]["k_j"]
    assert drawn[0]["sc"] == drawn[1]["sc"]  # not updated, so not drawn


def test_neighbouring_hours_join(idle):
    """The last samples of a file and the first of the next are one motion: no jump beyond the usual step."""
    files = sorted((idle.path / "acceleration").iterdir())
    a, b = load(files[0])[0], load(files[1])[0]
    if len(a) < 90000:
        pytest.fail("the first file ends early with this seed: choose another")
    step = np.nanstd(np.diff(a, axis=0), axis=0)
    assert np.all(np.abs(b[0] - a[-1]) < 6 * step)
    # slow motion goes on: extrapolate the low-passed tower-top signal over the seam
    joined = np.concatenate([a[-50:, -1], b[:50, -1]])
    smooth = np.convolve(joined, np.ones(15) / 15, mode="valid")
    jumps = np.abs(np.diff(smooth, 2))
    assert jumps[40:46].max() < 3 * np.delete(jumps, np.arange(36, 50)).max()


def test_vibration_while_idling_is_plausible_and_holds_the_true_modes(idle):
    record = tomllib.loads(idle.truth_path.read_text())
    data = np.concatenate([load(p)[0] for p in sorted((idle.path / "acceleration").iterdir())])
    data = np.nan_to_num(data - np.nanmean(data, axis=0))
    campaign = tomllib.loads((idle.path / "campaign.toml").read_text())
    names = [s["channel"] for s in campaign["sensor"]]
    top = [names.index("T90-x"), names.index("T90-y")]
    level = data.std(axis=0)
    assert np.all((level[top] > 0.002) & (level[top] < 0.05))
    assert np.all(level > 5 * np.max(record["drawn"]["noise_std_mps2"]))
    modes = truth.read_truth_modes(idle.truth_path)
    assert len(modes) == 1
    f, shape = modes[0].frequency_hz, modes[0].shape
    assert modes[0].labels[:3] == ("FA1", "SS1", "T1") and set(modes[0].labels) > {"FA2", "SS2"}
    assert record["idling_hz"]["T1"] == pytest.approx(f[2], abs=1e-6)
    # power of each mode's plane: frequency domain decomposition at 1/164 Hz
    frequency, density = welch(data, 25, nperseg=4096, axis=0)
    resolution = frequency[1]
    trace = density.sum(axis=1)
    for group in ([0, 1], [2], [3, 4]):
        low, high = f[group[0]], f[group[-1]]
        window = (frequency > 0.93 * low) & (frequency < 1.07 * high)
        peak = frequency[window][np.argmax(trace[window])]
        # half a line, and the peak's own scatter of about zeta f / 2 on a 1.5 % damped mode
        assert low - resolution - 0.01 * low < peak < high + resolution + 0.01 * high
        wave = np.hanning(4096) * np.exp(-2j * np.pi * peak / 25 * np.arange(4096))
        line = np.array([wave @ data[k : k + 4096] for k in range(0, len(data) - 4096, 2048)])
        vector = np.linalg.svd(line.T @ line.conj())[0][:, 0]
        basis = np.linalg.qr(shape[:, group])[0]
        assert np.linalg.norm(basis.T @ vector) ** 2 > 0.95


def test_operating_shows_harmonics_and_more_motion(tmp_path, idle):
    given = write(tmp_path / "given.toml", "[operation]\nmaintenance_hours = []\nwind_speed_mean_mps = 16.0\n")
    result = simulation.simulate(tmp_path / "out", model=AS_BUILT, days=0.042, truth=given, seed=6)
    assert result.state_share["idling"] == 0
    data = np.nan_to_num(load(next((result.path / "acceleration").iterdir()))[0].astype(float))
    still = np.nan_to_num(load(sorted((idle.path / "acceleration").iterdir())[0])[0])
    data, still = data - data.mean(axis=0), still - still.mean(axis=0)
    assert data[:, -2].std() > 2 * still[:, -2].std()
    scada = pandas.read_csv(result.path / "scada.csv")
    third = 3 * scada["rotor_speed_rpm"].mean() / 60
    frequency, density = welch(data[:, -2], 25, nperseg=4096)
    near = np.abs(frequency - third) < 0.03
    beside = (np.abs(frequency - third) > 0.08) & (np.abs(frequency - third) < 0.15)
    assert density[near].max() > 5 * np.median(density[beside])


def test_mistakes_are_one_line(tmp_path):
    for kwargs, says in (
        ({"days": 0.0, "seed": 1}, "shorter than one block"),
        ({"days": float("nan"), "seed": 1}, "shorter than one block"),
        ({"seed": -1}, "whole number"),
        ({"seed": 1.5}, "whole number"),
        ({"seed": 1, "model": tmp_path / "none.toml"}, "no such file"),
        ({"seed": 1, "truth": tmp_path / "none.toml"}, "no such file"),
    ):
        with pytest.raises(InputError, match=says):
            simulation.simulate(tmp_path / "out", **{"model": AS_BUILT, **kwargs})
    assert not (tmp_path / "out").exists()


def test_progress_is_told(tmp_path):
    entries = []
    simulation.simulate(
        tmp_path / "out", model=AS_BUILT, days=0.021, seed=1, progress=lambda *report: entries.append(report)
    )
    assert entries[0] == ("simulating hours", 0, 1) and entries[-1] == ("simulating hours", 1, 1)
