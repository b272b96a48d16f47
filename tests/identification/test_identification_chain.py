"""Setups of which no channel is common to all, merged along the chain of shared ones. Motion by scipy alone."""

import h5py
import numpy as np
import pytest
from scipy import linalg, signal

import probupdate
from probupdate.errors import InputError

RATE = 20.0
STOREYS = 6


def storeys():
    stiffness = 2 * np.eye(STOREYS) - np.eye(STOREYS, k=1) - np.eye(STOREYS, k=-1)
    stiffness[-1, -1] = 1
    value, shape = linalg.eigh(stiffness)
    return 0.8 * np.sqrt(value / value[0])[:3], shape[:, :3] / np.abs(shape[:, :3]).max(axis=0)


def measured(folder, floors, seed, minutes=30, gain=None):
    frequency, shape = storeys()
    rng = np.random.default_rng(seed)
    n = round(60 * minutes * RATE)
    y = np.zeros((n, STOREYS))
    for f, column in zip(frequency, shape.T, strict=True):
        pole = np.exp((-0.01 + 1j) * 2 * np.pi * f / RATE)
        q = signal.lfilter([1, 0, -1], np.poly([pole, pole.conj()]).real, rng.standard_normal(n + 2000))[2000:]
        y += np.outer(q / q.std(), column)
    data = (y + 0.02 * rng.standard_normal(y.shape))[:, [k - 1 for k in floors]]
    data *= [(gain or {}).get(k, 1.0) for k in floors]
    (folder / "acceleration").mkdir(parents=True)
    text = f'name = "Chain"\nsampling_rate_hz = {RATE}\nblock_minutes = 10\n'
    for k in floors:
        text += (f'[[sensor]]\nchannel = "F{k}"\nlevel = "F{k}"\nposition_m = [0.0, 0.0, {3.0 * k}]\n'
                 'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n')
    (folder / "campaign.toml").write_text(text)
    with h5py.File(folder / "acceleration" / "0.h5", "w") as file:
        file.create_dataset("data", data=data)
        file["data"].attrs["start"], file["data"].attrs["sampling_rate_hz"] = "2024-05-01T00:00:00Z", RATE
    return folder


CHAINS = {
    "the middle one shares one channel with each": ((1, 2, 6), (1, 3, 4), (5, 6)),
    "in a row, two channels shared": ((1, 2, 3), (2, 3, 4, 5), (4, 5, 6)),
    "four in a row": ((1, 2), (2, 3, 4), (4, 5), (5, 6)),
}


@pytest.mark.parametrize("name", CHAINS)
def test_shapes_of_a_chain_of_setups_are_right(name, tmp_path):
    folders = [measured(tmp_path / f"s{k}", floors, 10 + k) for k, floors in enumerate(CHAINS[name])]
    found = probupdate.identify_setups(folders)
    frequency, shape = storeys()
    one = found.data.sets[0]
    place = [int(np.argmin(np.abs(one.frequency_hz - f))) for f in frequency]
    assert one.frequency_hz[place] == pytest.approx(frequency, rel=0.005)
    rows = [int(c[1:]) - 1 for c in found.data.channels]
    assert sorted(rows) == list(range(STOREYS))
    for j, k in enumerate(place):
        truth = shape[rows, j]
        mine = np.real(one.shape[:, k] / one.shape[np.argmax(np.abs(truth)), k]) * truth[np.argmax(np.abs(truth))]
        assert np.abs(mine - truth).max() < 0.05
        std = np.linalg.norm(one.covariance_factors.shape[:, k].real, axis=1)
        assert np.all(np.abs(mine - truth) < 4 * std + 0.005)
    assert "along the chain" in found.summary


def test_setups_that_nothing_joins_are_refused(tmp_path):
    folders = [measured(tmp_path / f"s{k}", floors, k, 20) for k, floors in enumerate(((1, 2), (2, 3), (5, 6)))]
    with pytest.raises(InputError, match="no channel in common: s0, s1 and s2"):
        probupdate.identify_setups(folders)


@pytest.mark.parametrize("name", CHAINS)
def test_setups_of_a_chain_are_compared_two_by_two(name, tmp_path):
    folders = [measured(tmp_path / f"s{k}", floors, 10 + k, minutes=10) for k, floors in enumerate(CHAINS[name])]
    said = probupdate.check_setups(folders)
    assert not said.findings and "s0 and s1: references" in said.summary


def test_a_reference_that_some_setups_share_is_compared_among_these(tmp_path):
    """F1 and F2 are in all, F6 in four of six, in one of these 10 % too large."""
    floors = [(1, 2, 3, 6), (1, 2, 4, 6), (1, 2, 5, 6), (1, 2, 6), (1, 2, 3), (1, 2, 4)]
    folders = [measured(tmp_path / f"s{k}", own, 10 + k, 20, {6: 1.1} if k == 2 else None)
               for k, own in enumerate(floors)]
    (found,) = probupdate.check_setups(folders).findings
    assert found.channel == "F6" and found.since == "s2" and abs(found.size - 1.1) < 4 * found.std


def test_what_scaling_leaves_is_of_all_references_that_a_setup_has(tmp_path):
    """F6 is in two of three setups, which both are scaled by F2 to the longest record: 10 % too large in one, it is
    off the merged shape by 10 % in both together, as they weigh."""
    floors = [(1, 2, 3), (2, 4, 6), (2, 5, 6)]
    folders = [measured(tmp_path / f"s{k}", own, 10 + k, (60, 20, 20)[k], {6: 1.1} if k == 2 else None)
               for k, own in enumerate(floors)]
    table = probupdate.identify_setups(folders).table
    lowest = table[table["label"] == table["label"].iloc[0]].set_index("setup")["misfit"]
    _, shape = storeys()
    expected = 0.1 * shape[5, 0] / np.hypot(shape[1, 0], shape[5, 0])
    # both shapes are known to a few per cent of the tenth
    assert np.sqrt(lowest[["s1", "s2"]]).sum() == pytest.approx(expected, rel=0.1)
