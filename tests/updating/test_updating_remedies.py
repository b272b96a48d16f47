"""What an error advises where channels are reversed, exchanged or point elsewhere is done as it says, and works."""

import json
import re

import h5py
import numpy as np
import pytest
from scipy.linalg import eigh

from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.verbs import update
from probupdate.verbs.identifying import reference_at

N, K, MASS = 4, 2.0e6, 5.0e3
PARAMETERS = '[[parameter]]\nname = "k"\nunit = "-"\ninitial = 1.0\nstd = 0.1\nlower = 0.5\nupper = 2.0\n'


def matrices():
    stiffness = K * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    stiffness[-1, -1] = K
    return stiffness, MASS * np.eye(N)


def write_model(folder, sign=(1, 1, 1, 1)):
    stiffness, mass = matrices()
    np.savez(folder / "model.npz", K0=0 * stiffness, M0=mass, K_k=stiffness, channel=[f"A{j}" for j in range(1, 5)],
             channel_dof=np.arange(N), channel_sign=np.array(sign),
             node_position_m=np.outer(np.arange(1, 5), [0, 0, 3.0]),
             dof_node=np.arange(N), dof_direction=np.zeros(N, int))
    (folder / "parameters.toml").write_text(PARAMETERS)
    return folder / "model.npz"


def write_modes(folder, channels=("A1", "A2", "A3", "A4"), sign=(1, 1, 1, 1)):
    stiffness, mass = matrices()
    squares, shape = np.linalg.eigh(stiffness / MASS)
    shape = (shape / np.abs(shape).max(axis=0) * np.array(sign)[:, None])[:, :3]
    frequency = np.sqrt(squares[:3]) / (2 * np.pi)
    content = {"channels": list(channels), "sets": [{
        "id": "one", "frequency_hz": frequency.tolist(), "damping_ratio": [0.01] * 3,
        "frequency_std_hz": (0.005 * frequency).tolist(), "shape_re": shape.T.tolist(),
        "shape_std": np.full(shape.T.shape, 0.01).tolist()}]}
    (folder / "modes.json").write_text(json.dumps(content))
    return folder / "modes.json"


def test_a_reversed_channel_of_matrices_is_mended_by_its_sign_in_the_model(tmp_path):
    modes = write_modes(tmp_path, sign=(1, 1, 1, -1))
    with pytest.raises(InputError, match=r"A4 with the opposite sign.*channel_sign, or its row of channel_row"):
        update(write_model(tmp_path), modes)
    found = update(write_model(tmp_path, sign=(1, 1, 1, -1)), modes)
    assert found.map_theta[0] == pytest.approx(1.0, abs=0.01)


def test_exchanged_channels_are_mended_by_their_names_in_the_modes(tmp_path):
    model = write_model(tmp_path)
    said = update(model, write_modes(tmp_path, channels=("A4", "A2", "A3", "A1"))).suspected
    assert re.search(r"A[14] and A[14] exchanged.*`channels` of the modes' file", said)
    assert not update(model, write_modes(tmp_path)).suspected


def write_campaign(folder, directions):
    text = 'name = "x"\nsampling_rate_hz = 20.0\nblock_minutes = 1\n'
    for k, direction in enumerate(directions, 1):
        text += (f'[[sensor]]\nchannel = "A{k}"\nlevel = "l"\nposition_m = [0.0, 0.0, {3.0 * k}]\n'
                 f'direction = {list(direction)}\nquantity = "acceleration"\nunit = "m/s2"\n')
    (folder / "campaign.toml").write_text(text)
    (folder / "acceleration").mkdir(exist_ok=True)
    with h5py.File(folder / "acceleration/0.h5", "w") as file:
        data = file.create_dataset("data", data=np.zeros((1200, N), np.float32))
        data.attrs.update(start="2024-05-01T10:00Z", sampling_rate_hz=20.0)
    return read_campaign(folder)


X, BACK, Y = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def test_a_direction_and_the_models_sign_must_agree(tmp_path):
    model, turned = write_model(tmp_path), write_campaign(tmp_path, (X, X, X, BACK))
    with pytest.raises(InputError, match=r"channel A4: points along.*channel_sign in the model's archive"):
        reference_at([turned], model, where=tmp_path)
    # either of the two that are named
    assert reference_at([write_campaign(tmp_path, (X, X, X, X))], model, where=tmp_path).modes is not None
    assert reference_at([turned], write_model(tmp_path, sign=(1, 1, 1, -1)), where=tmp_path).modes is not None


def test_a_channel_across_its_row_of_the_model_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"channel A2: points along.*channel_row for an oblique"):
        reference_at([write_campaign(tmp_path, (X, Y, X, X))], write_model(tmp_path), where=tmp_path)


PIECES, LENGTH, NODES = 24, 53.0, np.array([3, 6, 8, 13, 16, 19, 22])


def deck(stiffness, mass, held):
    """Stiffness and mass of a beam of PIECES, bending stiffness and mass of each: vertical motion and slope of its
    ends; held: springs by node."""
    h = LENGTH / PIECES
    bend = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                     [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]) / h**3
    inert = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                      [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]) * h / 420
    size = 2 * PIECES + 2
    stiff, heavy = np.zeros((size, size)), np.zeros((size, size))
    for e in range(PIECES):
        rows = slice(2 * e, 2 * e + 4)
        stiff[rows, rows] += stiffness[e] * bend
        heavy[rows, rows] += mass[e] * inert
    for node, spring in held.items():
        stiff[2 * node, 2 * node] += spring
    return stiff, heavy


def write_bridge(folder, seed, channels):
    """Two spans with two stays: a model, and modes of a bridge whose pieces scatter by 3 % about it."""
    rng, one, first = np.random.default_rng(seed), np.ones(PIECES), np.arange(PIECES) < 10
    names = [f"V{k}" for k in range(1, 8)]
    np.savez(folder / "model.npz", M0=deck(one, 1200 * one, {})[1],
             K0=deck(0 * one, one, {0: 2e9, 10: 2e9, 24: 2e9})[0], K_first=deck(1.68e9 * first, one, {})[0],
             K_second=deck(1.68e9 * ~first, one, {})[0], K_stays=deck(0 * one, one, {5: 2e6, 16: 2e6})[0],
             channel=names, channel_dof=2 * NODES)
    (folder / "parameters.toml").write_text("".join(
        PARAMETERS.replace('"k"', f'"{name}"') for name in ("first", "second", "stays")))
    scatter = 1 + 0.03 * rng.standard_normal((2, PIECES))
    held = {0: 2e9, 10: 1.2e9, 24: 2e9, 5: 1.7e6, 16: 2.2e6}
    squares, phi = eigh(*deck(1.68e9 * scatter[0], 1200 * scatter[1], held))
    frequency, shape = np.sqrt(squares[:6]) / (2 * np.pi), phi[2 * NODES, :6]
    shape = shape / np.abs(shape).max(axis=0)
    (folder / "modes.json").write_text(json.dumps({"channels": list(channels), "sets": [{
        "id": "one", "frequency_hz": frequency.tolist(), "damping_ratio": [0.01] * 6,
        "frequency_std_hz": (5e-4 * frequency).tolist(), "shape_re": shape.T.tolist(),
        "shape_std": np.full((6, 7), 0.006).tolist()}]}))
    return folder / "model.npz", folder / "modes.json"


@pytest.mark.parametrize("seed", [1, 8])
def test_an_exchange_is_named_where_no_maximum_is_reached(tmp_path, seed):
    wrong = ("V1", "V2", "V3", "V5", "V4", "V6", "V7")
    with pytest.raises(InputError, match="channels V5 and V4 exchanged would explain it.*exchange the two names") as e:
        update(*write_bridge(tmp_path, seed, wrong))
    assert "no maximum of the posterior was reached" in str(e.value)
    mended = update(*write_bridge(tmp_path, seed, sorted(wrong)))
    assert not mended.suspected and mended.map_theta[:2] == pytest.approx(1.0, abs=0.06)
