"""`--alternatives`: another model's file beside the model's, on the command line."""

import numpy as np
import pytest
from scipy import linalg

from probupdate.cli import main
from probupdate.modal.modes import ModalData, ModalSet, write_modes
from probupdate.updating.update_file import read_update

N, MASS = 4, 2e4


def building(spring) -> np.ndarray:
    return np.diag(spring) + np.diag(np.append(spring[1:], 0.0)) - np.diag(spring[1:], 1) - np.diag(spring[1:], -1)


SPRING = 3e7 * np.linspace(1.0, 0.7, N)
# what softens storeys above the first, in the truth and in the other model
TRUTH, OTHER = np.array([1.0, 0.88, 0.88, 0.88]), np.array([1.0, 0.8, 0.8, 0.8])


@pytest.fixture
def case(tmp_path):
    names = np.array([f"floor {k + 1}" for k in range(N)])
    for name, soft in (("model", 1.0), ("flexible joints", OTHER)):
        K = building(SPRING * soft)
        np.savez(tmp_path / f"{name}.npz", K0=K, K_k=K, M0=MASS * np.eye(N), channel=names, channel_dof=np.arange(N))
    (tmp_path / "parameters.toml").write_text(
        '[[parameter]]\nname = "k"\nunit = "-"\ninitial = 0.0\nstd = 0.15\nlower = -0.5\nupper = 1.0\n')
    value, shape = linalg.eigh(1.1 * building(SPRING * TRUTH), MASS * np.eye(N))
    hz = np.sqrt(value[:3]) / (2 * np.pi)
    shape = shape[:, :3] / np.abs(shape[:, :3]).max(axis=0)
    one = ModalSet(id="one", frequency_hz=hz, damping_ratio=np.full(3, 0.01), shape=shape, frequency_std_hz=1e-3 * hz,
                   shape_std=np.full(shape.shape, 0.01))
    write_modes(ModalData(channels=tuple(names), sets=(one,)), tmp_path / "modes.json")
    return tmp_path


def updated(case, *words) -> tuple[float, float]:
    """The parameter at the maximum, and its standard deviation."""
    out = case / "update.json"
    assert main(["update", "--model", str(case / "model.npz"), "--parameters", str(case / "parameters.toml"), "--modes",
                 str(case / "modes.json"), "--out", str(out), *words]) == 0
    found = read_update(out)
    return found.map_theta[0], np.sqrt(found.map_covariance[0, 0])


def test_the_truth_between_two_models_is_held_beside_the_other(case):
    alone, beside = updated(case), updated(case, "--alternatives", str(case / "flexible joints.npz"))
    assert "flexible joints" in read_update(case / "update.json").settings["alternatives"]
    assert abs(alone[0] - 0.1) > 3 * alone[1] and abs(beside[0] - 0.1) < 1.645 * beside[1]


def test_an_alternative_that_is_not_there_is_refused(case, capsys):
    words = ["update", "--model", str(case / "model.npz"), "--parameters", str(case / "parameters.toml"), "--modes",
             str(case / "modes.json"), "--out", str(case / "u.json"), "--alternatives", str(case / "none.npz")]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "none.npz" in said and "Traceback" not in said
