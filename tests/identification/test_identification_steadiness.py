"""Modes that a machine or a limit cycle keeps going are said, and those that random forces move are not."""

import h5py
import numpy as np
import pytest
from scipy import signal

import probupdate
from probupdate.identification.steadiness import amplitude_kurtosis, of_steady_modes, of_vague_modes
from probupdate.modal.modes import ModalData, ModalSet

RATE = 5.0
FREQUENCY, SHAPE = np.array([0.4, 1.1]), np.array([[1.0, -0.6], [0.7, 0.9], [0.3, 0.7]])


def motion(seconds, steady, seed):
    """(n, 3): two modes with 1 % of damping under white forces; to the first a steady oscillation beside it of `steady`
    times its root mean square."""
    rng, n = np.random.default_rng(seed), round(seconds * RATE)
    y = 0.01 * rng.standard_normal((n, 3))
    for j, f in enumerate(FREQUENCY):
        pole = np.exp(2 * np.pi * f / RATE * (-0.01 + 1j))
        q = signal.lfilter([1], [1, -pole], rng.standard_normal(n + 2000))[2000:].real
        q /= q.std()
        if j == 0:
            q = q + steady * np.sqrt(2) * np.cos(2 * np.pi * 1.001 * f * np.arange(n) / RATE + rng.uniform(0, 6))
        y += np.outer(q, SHAPE[:, j])
    return y


@pytest.mark.parametrize("steady", [0.0, 1.0, 2.0])
def test_the_kurtosis_of_an_amplitude_is_that_of_its_steady_share(steady, validation):
    """Two less the squared share of power that is steady; over 20 half hours, whose means scatter by 2 / sqrt(20 N)."""
    found = np.mean([amplitude_kurtosis(motion(1800, steady, k), RATE, FREQUENCY, np.full(2, 0.01), SHAPE)
                     for k in range(20)], axis=0)
    share = steady**2 / (1 + steady**2)
    row = validation(what="kurtosis of modal amplitudes, steady share 0, 1/2, 4/5", reference="2 - share^2",
                     why="three standard errors of 20 half hours, and their bias")
    count = 0.01 * 2 * np.pi * FREQUENCY * 1800
    row.error(found - (2 - np.array([share, 0.0]) ** 2), below=3 * 2 / np.sqrt(20 * count.min()) + 2 / count.min())


@pytest.mark.parametrize("steady", [0.0, 1.5])
def test_a_limit_cycle_is_said_of_its_mode_alone(tmp_path, steady):
    (tmp_path / "acceleration").mkdir()
    text = f'name = "cycle"\nsampling_rate_hz = {RATE}\nblock_minutes = 20\n'
    for k in range(3):
        text += (f'[[sensor]]\nchannel = "c{k}"\nlevel = "c{k}"\nposition_m = [0.0, 0.0, {3.0 * k + 3}]\n'
                 'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n')
    (tmp_path / "campaign.toml").write_text(text)
    with h5py.File(tmp_path / "acceleration" / "0.h5", "w") as file:
        file.create_dataset("data", data=motion(8 * 1200, steady, 1))
        file["data"].attrs["start"], file["data"].attrs["sampling_rate_hz"] = "2024-05-01T00:00:00Z", RATE
    settings = probupdate.IdentificationSettings(rate_hz=RATE, order=8, block_rows=20)
    notes = [n for n in probupdate.identify(tmp_path, settings=settings).notes if "keeps its amplitude" in n]
    assert [n[:9] for n in notes] == ["1 at 0.40"] * bool(steady)


def kurtosis_of_record(on, fade, seed, line_hz=0.7):
    """(1, 3) of half an hour of the two modes, and of a line of 0.7 Hz that runs a share `on` of the time; `fade`: by
    how much all forces grow and fade, in standard deviations of ln."""
    rng, n = np.random.default_rng([seed, 7]), round(1800 * RATE)
    y = motion(1800, 0.0, seed)
    first = rng.integers(0, n - round(on * n) + 1)
    line = np.zeros(n)
    line[first : first + round(on * n)] = 1
    line *= np.cos(2 * np.pi * line_hz * np.arange(n) / RATE)
    y += 0.3 * np.outer(line, [0.2, 1.0, 0.4])
    y *= np.exp(fade * np.interp(np.arange(n), np.linspace(0, n, 13), rng.standard_normal(13)))[:, None]
    f, shape = np.append(FREQUENCY, line_hz), np.column_stack([SHAPE, [0.2, 1.0, 0.4]])
    return amplitude_kurtosis(y, RATE, f, np.array([0.01, 0.01, 0.003]), shape)


@pytest.mark.parametrize(("on", "fade", "said"), [(0.1, 0.0, ["3 at 0.7 Hz"]), (0.3, 0.0, ["3 at 0.7 Hz"]),
                                                  (1.0, 0.0, []), (0.0, 0.0, []), (0.0, 0.7, [])])
def test_a_line_that_runs_at_times_is_said_of_its_mode_alone(on, fade, said):
    """Forces that grow and fade move all modes alike: of noise at 0.7 Hz too."""
    found = np.array([kurtosis_of_record(on, fade, seed) for seed in range(8)])
    f = np.broadcast_to(np.append(FREQUENCY, 0.7), found.shape)
    notes = of_steady_modes(["1", "2", "3"], found, f, np.full(found.shape, 0.01), 1800.0)
    assert [note.split(" comes")[0] for note in notes if "comes and goes" in note] == said


@pytest.mark.parametrize(("std_hz", "said"), [(0.0020, False), (0.0070, True)])
def test_a_frequency_known_far_less_well_than_modes_are_is_said(std_hz, said):
    """Of 1 % of damping at 2 Hz in half an hour the Cramer-Rao bound is 0.00094 Hz."""
    modes = ModalSet(id="a", frequency_hz=np.array([2.0]), damping_ratio=np.array([0.01]), shape=np.ones((2, 1)),
                     frequency_std_hz=np.array([std_hz]), shape_std=np.full((2, 1), np.nan))
    found = of_vague_modes(ModalData(channels=("a", "b"), sets=(modes,), labels=("1",)), 1800.0)
    assert [text.startswith("1 at 2 Hz") for text in found] == [True] * said
