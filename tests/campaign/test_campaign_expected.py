"""What a model's own modes look like beside one another is no fault of a sensor; what they do not look like is."""

import h5py
import numpy as np
import pytest
from scipy import signal

import probupdate

RATE_HZ, SECONDS, HEIGHTS = 10.0, 1200, (20.0, 35.0, 50.0, 65.0)
FREQUENCY_HZ = np.array([0.41, 0.44, 1.9, 2.3])
CHANNELS = ("leg-x", "leg-y", *(f"{axis}{int(z)}" for z in HEIGHTS for axis in "xy"), "up")
PARAMETERS = '[[parameter]]\nname = "k"\nunit = "-"\ninitial = 1.0\nstd = 0.1\nlower = 0.5\nupper = 1.6\n'


def shapes(leg):
    """(n_channel, 4) of a tower's two bending pairs. Where its leg stands between joints it moves as `leg` (2, 2) has
    it, and the vertical sensor on the axis not at all."""
    z = np.array(HEIGHTS) / HEIGHTS[-1]
    first, second = z**1.8, z**1.5 * (1 - 1.35 * z)
    own = [np.kron(profile[:, None], np.eye(2)) for profile in (first, second)]
    legs = 0.03 * np.hstack([np.array(leg), -2 * np.array(leg)])
    return np.vstack([legs, np.hstack(own), np.zeros(4)])


def write(folder, shape, seed, change=lambda data: data):
    """A model of matrices with these modes, and a campaign of its motion under white noise."""
    rng = np.random.default_rng(seed)
    n = len(CHANNELS)
    # the other modes far above, anyhow
    every = np.column_stack([shape, np.linalg.svd(shape)[0][:, 4:]])
    back = np.linalg.inv(every)
    square = (2 * np.pi * np.r_[FREQUENCY_HZ, np.linspace(9, 14, n - 4)]) ** 2
    np.savez(folder / "model.npz", K0=np.zeros((n, n)), K_k=back.T @ np.diag(square) @ back, M0=back.T @ back,
             channel=list(CHANNELS), channel_dof=np.arange(n))
    (folder / "parameters.toml").write_text(PARAMETERS)
    n_sample = int(RATE_HZ * SECONDS * 4)
    data = np.zeros((n_sample, n))
    for w, phi in zip(2 * np.pi * FREQUENCY_HZ, shape.T, strict=True):
        b, a, _ = signal.cont2discrete(([1.0, 0, 0], [1.0, 0.02 * w, w * w]), 1 / RATE_HZ, method="bilinear")
        data += np.outer(signal.lfilter(b.ravel(), a, rng.standard_normal(n_sample)), phi)
    data = 0.03 * change(data) / np.std(data)
    data = data + 2e-3 * np.std(data) * rng.standard_normal(data.shape)
    text = f'name = "tower"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = {SECONDS / 60:g}\n'
    for name in CHANNELS:
        at = {"leg-x": (3.0, 2.0, 8.0), "leg-y": (3.0, 2.0, 8.0), "up": (0.0, 0.0, 65.0)}.get(
            name, (0.0, 0.0, float(name[1:]) if name[1:].isdigit() else 0.0))
        d = (0.0, 0.0, 1.0) if name == "up" else (1.0, 0.0, 0.0) if "x" in name else (0.0, 1.0, 0.0)
        text += (f'[[sensor]]\nchannel = "{name}"\nlevel = "z{at[2]:g}"\nposition_m = {list(at)}\n'
                 f'direction = {list(d)}\nquantity = "acceleration"\nunit = "m/s2"\n')
    (folder / "campaign.toml").write_text(text)
    (folder / "acceleration").mkdir()
    with h5py.File(folder / "acceleration" / "0.h5", "w") as file:
        held = file.create_dataset("data", data=data.astype(np.float32))
        held.attrs.update(start="2026-06-01T00:00:00Z", sampling_rate_hz=RATE_HZ)


def suspected(found):
    return [one for one in found.findings if one.startswith("suspect")]


@pytest.mark.parametrize(("leg", "seed"), [(((1.0, 0.0), (-0.8, 1.0)), 1), (((1.0, 0.9), (0.1, 0.8)), 2)])
def test_what_the_model_s_modes_look_like_is_not_suspected(tmp_path, leg, seed):
    write(tmp_path, shapes(leg), seed)
    alone, beside = probupdate.check(tmp_path), probupdate.check(tmp_path, tmp_path / "model.npz")
    assert any("turned" in one for one in suspected(alone)) and any("up looks dead" in one for one in suspected(alone))
    assert suspected(beside) == []
    (said,) = [use for use in beside.uses if "no more than by the model's modes" in use]
    assert "up (dead)" in said and "leg-" in said


def turned(data):
    """The sensor at 50 m fixed 60 deg askew."""
    x, y = CHANNELS.index("x50"), CHANNELS.index("y50")
    return np.column_stack([*data.T[:x], np.cos(np.pi / 3) * data[:, x] + np.sin(np.pi / 3) * data[:, y],
                            *data.T[x + 1 :]])


def dead(data):
    return data * (np.array(CHANNELS) != "y35")


@pytest.mark.parametrize(("change", "channel"), [(turned, "x50"), (dead, "y35")])
def test_what_they_do_not_look_like_is(tmp_path, change, channel):
    write(tmp_path, shapes(((1.0, 0.0), (-0.8, 1.0))), 3, change)
    found = probupdate.check(tmp_path, tmp_path / "model.npz")
    assert any(channel in one for one in suspected(found)), found.summary
