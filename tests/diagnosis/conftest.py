"""A small frame with sensors in three places, its matrices as a user's model.npz, and a month of blocks of it."""

import numpy as np
import pytest

from probupdate.diagnosis.prepare import prepare
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.structure.parameter_table import read_parameters

N_STOREY, N_BLOCK, HEIGHT = 5, 40, 3.0
CHANNELS = tuple(f"{axis}{storey}" for storey in range(1, N_STOREY + 1) for axis in "xy")
STIFFNESS_X, STIFFNESS_Y, MASS = 2.0e6, 2.06e6, 1000.0


def storeys(factor_x, factor_y, mass):
    """K and M (10, 10) of two shear chains, x and y in turn; factors (5,)."""
    size = 2 * N_STOREY
    K = np.zeros((size, size))
    for axis, (stiffness, factor) in enumerate(((STIFFNESS_X, factor_x), (STIFFNESS_Y, factor_y))):
        for k in range(N_STOREY):
            at = 2 * k + axis
            K[at, at] += stiffness * factor[k]
            if k:
                K[at - 2, at - 2] += stiffness * factor[k]
                K[at, at - 2] -= stiffness * factor[k]
                K[at - 2, at] -= stiffness * factor[k]
    return K, np.diag(np.repeat(np.asarray(mass, float), 2))


def with_mass_on_spring(K, M, mass, hz, storey):
    """K and M (11, 11) of a frame on a storey of which a mass hangs along x, its own degree of freedom the last."""
    K, M = np.pad(K, (0, 1)), np.pad(M, (0, 1))
    both = np.zeros(len(K))
    both[[2 * storey, -1]] = 1.0, -1.0
    K += mass * (2 * np.pi * hz) ** 2 * np.outer(both, both)
    M[-1, -1] = mass
    return K, M


def moving_most(phi):
    """The mode in which that mass moves most against all storeys, of shapes (11, n)."""
    return int(np.argmax(np.abs(phi[-1]) / np.linalg.norm(phi[:-1], axis=0)))


@pytest.fixture(scope="session")
def frame_file(tmp_path_factory):
    """model.npz with a parameter for the stiffness of each storey (both axes) and one for the top mass."""
    folder = tmp_path_factory.mktemp("frame")
    one = np.ones(N_STOREY)
    K0, M0 = storeys(0 * one, 0 * one, MASS * one)
    arrays = {"K0": K0, "M0": M0, "channel": np.array(CHANNELS), "channel_dof": np.arange(2 * N_STOREY)}
    tables = []
    for k in range(N_STOREY):
        K, _ = storeys(one * (np.arange(N_STOREY) == k), one * (np.arange(N_STOREY) == k), one)
        arrays[f"K_k{k + 1}"] = K
        tables.append(f'[[parameter]]\nname = "k{k + 1}"\nunit = "-"\ninitial = 1.0\ncov = 0.05\nlower = 0.2\n'
                      "upper = 2.0\n")
    np.savez(folder / "model.npz", **arrays)
    (folder / "model.toml").write_text("".join(tables))
    return folder / "model.npz"


@pytest.fixture(scope="session")
def pictured_frame(frame_file, tmp_path_factory):
    """The frame made ready with a picture: its storeys one above the other."""
    with np.load(frame_file) as found:
        arrays = {name: found[name] for name in found.files}
    node = np.column_stack([np.zeros((N_STOREY, 2)), HEIGHT * (1 + np.arange(N_STOREY))])
    arrays |= {"node_position_m": node, "dof_node": np.repeat(np.arange(N_STOREY), 2),
               "dof_direction": np.tile([0, 1], N_STOREY), "line": np.column_stack([np.arange(4), np.arange(1, 5)])}
    path = tmp_path_factory.mktemp("pictured") / "model.npz"
    np.savez(path, **arrays)
    return prepare(path, parameters=read_parameters(frame_file.with_name("model.toml")))


@pytest.fixture(scope="session")
def record():
    """record(seed, ...) -> ModalData: a stepped storey, a wrong gain, a mass, a tide, a stay from a degree of freedom
    to the ground (N/m), noise of 0.1 % and 0.5 %."""

    def make(seed=1, *, storey=None, factor=1.0, from_block=0, gain=None, mass=None, level=0.0, stay=None,
             n_mode=4):
        rng = np.random.default_rng(seed)
        base = 1 + 0.02 * rng.standard_normal(N_STOREY)
        sets = []
        tide = rng.standard_normal(N_BLOCK)
        for b in range(N_BLOCK):
            here = base.copy()
            if storey is not None and b >= from_block:
                here[storey] *= factor
            masses = MASS * np.ones(N_STOREY)
            masses[0] *= 1 + level * tide[b]
            if mass is not None:
                masses[mass[0]] *= mass[1]
            K, M = storeys(here, here, masses)
            if stay is not None:
                K[stay[0], stay[0]] += stay[1]
            root = np.sqrt(np.diag(M))
            value, vector = np.linalg.eigh(K / np.outer(root, root))
            f, phi = np.sqrt(value[:n_mode]) / (2 * np.pi), vector[:, :n_mode] / root[:, None]
            f = f * (1 + 1e-3 * rng.standard_normal(n_mode))
            phi = phi / np.abs(phi).max(axis=0)
            phi = phi + 5e-3 * (rng.standard_normal(phi.shape) + 1j * rng.standard_normal(phi.shape))
            if gain is not None:
                phi[CHANNELS.index(gain[0])] *= gain[1]
            sets.append(ModalSet(
                id=str(np.datetime64("2020-01-01T00:00:00") + np.timedelta64(6 * b, "h")), frequency_hz=f, shape=phi,
                damping_ratio=np.full(n_mode, 0.01), frequency_std_hz=np.full(n_mode, np.nan),
                shape_std=np.full(phi.shape, np.nan), environment={"water_level_m": float(tide[b])},
            ))
        return ModalData(channels=CHANNELS, sets=tuple(sets))

    return make


@pytest.fixture(scope="session")
def stepped(frame_file, record):
    """(prepared, data, outcome): the third storey loosens by a tenth from block 18 on."""
    from probupdate.diagnosis.diagnose import examine
    from probupdate.diagnosis.prepare import prepare

    prepared, data = prepare(frame_file), record(4, storey=2, factor=0.9, from_block=18)
    return prepared, data, examine(prepared, data)


@pytest.fixture(scope="session")
def turbine():
    """The reference turbine as updated, made ready for a diagnosis."""
    from probupdate.diagnosis.prepare import prepare
    from probupdate.structure.load import reference_model

    return prepare(reference_model("updated"))
