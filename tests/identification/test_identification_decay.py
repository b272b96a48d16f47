"""Free decays: damping without the bias of stationary correlations. Motion by closed form."""

from itertools import product

import h5py
import numpy as np
import pytest
from scipy import signal

import probupdate
from probupdate.identification.free_decay import decay_of
from probupdate.identification.lost_samples import WholeRecord

SHAPES = np.array([[0.3, 0.8, -0.9], [0.6, 0.9, 0.3], [0.85, 0.1, 1.0], [1.0, -1.0, -0.6]])


def decay(frequency, damping, seconds, rate, *, releases=(0.0,), noise=0.0, seed=1, across=0):
    """Each release of another size; `across`: so many sensors across the motion, which read their noise."""
    t = np.arange(round(seconds * rate)) / rate
    rng = np.random.default_rng(seed)
    y = np.zeros((len(t), 4))
    for (j, (f, zeta)), (k, release) in product(enumerate(zip(frequency, damping, strict=True)), enumerate(releases)):
        w, after = 2 * np.pi * f, np.clip(t - release, 0, None)
        q = np.exp(-zeta * w * after) * np.cos(w * np.sqrt(1 - zeta**2) * after + rng.uniform(0, 6)) * (t >= release)
        y += np.outer(q, (1.0, 0.4, 1.5)[k] * SHAPES[:, j] * (np.arange(4) >= across))
    return y + noise * rng.standard_normal(y.shape)


def identified(folder, data, rate, minutes):
    (folder / "acceleration").mkdir(parents=True)
    text = f'name = "Pluck"\nsampling_rate_hz = {rate}\nblock_minutes = {minutes}\n'
    for k in range(4):
        text += (f'[[sensor]]\nchannel = "A{k}"\nlevel = "{k}"\nposition_m = [0.0, 0.0, {3.0 + 3 * k}]\n'
                 'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n')
    (folder / "campaign.toml").write_text(text)
    with h5py.File(folder / "acceleration" / "0.h5", "w") as file:
        file.create_dataset("data", data=data)
        file["data"].attrs["start"], file["data"].attrs["sampling_rate_hz"] = "2024-05-01T00:00:00Z", rate
    return probupdate.identify(folder)


CASES = {
    "clean": ((1.1, 3.0, 4.7), (0.012, 0.008, 0.010), 120, 20.0, {}),
    "slow, noisy": ((0.31, 1.4, 2.2), (0.006, 0.01, 0.007), 120, 10.0, {"noise": 0.003}),
    "released late": ((1.1, 3.0, 4.7), (0.012, 0.008, 0.010), 120, 20.0, {"releases": (17.3,), "noise": 0.001}),
    # channel by channel half of such a record is noise, and damping was 5 to 30 % low
    "along one axis": ((0.9, 2.6), (0.013, 0.009), 120, 20.0, {"noise": 0.001, "across": 2}),
    # damping was 20 % low
    "plucked three times": ((0.9, 2.6, 4.4), (0.01, 0.012, 0.008), 150, 20.0,
                            {"releases": (0, 50, 100), "noise": 0.002}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_ringdown_has_its_damping_and_it_is_said(name, tmp_path):
    frequency, damping, seconds, rate, more = CASES[name]
    found = identified(tmp_path / "c", decay(frequency, damping, seconds, rate, **more), rate, seconds / 60)
    one = found.data.sets[0]
    place = [int(np.nanargmin(np.abs(one.frequency_hz - f))) for f in frequency]
    assert one.frequency_hz[place] == pytest.approx(frequency, rel=1e-3)
    # what noise leaves; the bias of correlations of a stationary record is 4 to 50 times as much
    assert one.damping_ratio[place] == pytest.approx(damping, rel=0.02)
    assert any("free decay" in note for note in found.notes)
    assert "in 1 of 1 blocks: free decay" in found.summary


def driven(seed, zeta=0.01, first_hz=0.3, seconds=600, rate=5.0):
    rng = np.random.default_rng(seed)
    n, y = round(seconds * rate), 0.0
    for j, f in enumerate((first_hz, 1.2, 1.9)):
        w = 2 * np.pi * f
        pole = np.exp((-zeta + 1j) * w / rate)
        q = signal.lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal(n + 4000))[4000:]
        y = y + np.outer(q / q.std(), SHAPES[:, j])
    return y


@pytest.mark.parametrize("wind", ["steady", "fading", "gusts"])
def test_what_something_drives_is_no_free_decay(wind):
    for seed in range(20):
        data, t = driven(seed), np.linspace(0, 1, 3000)[:, None]
        data = data * np.exp({"steady": 0, "fading": -3 * t, "gusts": 2 * np.cos(8 * np.pi * t + seed)}[wind])
        assert decay_of(WholeRecord(data=data, target_hz=5.0), edge=0, order=20, block_rows=30) is None


def test_a_line_folded_among_the_modes_is_said_whatever_its_damping(tmp_path):
    """A pump at 24.6 Hz: its damping comes out on either side of none, by 0.04 %."""
    t = np.arange(9_000) / 5.0
    line = 0.4 * np.outer(np.sin(2 * np.pi * 24.6 * t), [1.0, 0.3, -0.2, 0.5])
    found = identified(tmp_path, driven(1, first_hz=0.31, seconds=1800) + line, 5.0, 10)
    assert any(np.abs(s.frequency_hz - 0.4).min() < 1e-3 for s in found.data.sets)
    (said,) = [note for note in found.notes if "do not tell from none" in note]
    assert said.startswith("0.400 Hz has a damping of 0.04")
