"""Models of matrices with a group of their parameters as one parameter more: the same structure, files that load."""

import numpy as np
import pytest
from scipy import sparse

from probupdate.errors import InputError
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.extend_matrices import Group, group_parameter, write_grouped
from probupdate.structure.load import load_model
from probupdate.structure.matrices import SPARSE_PARTS

N = 7
NAMES = ("a", "b", "m")


def parameters(correlation=None):
    items = tuple(Parameter(name=n, unit="-", initial=i, std=0.1, lower=lo, upper=hi)
                  for n, i, lo, hi in zip(NAMES, (1.0, 0.8, 0.2), (0.4, 0.2, -0.3), (2.0, 2.0, 0.9), strict=True))
    return Parameters(items, correlation)


def matrices():
    """A chain of springs: `a` scales the first three, `b` the others, `m` adds mass at the end."""
    springs = []
    for k in range(N):
        K = np.zeros((N, N))
        K[k, k] = 100.0 + k
        if k:
            K[k - 1, k - 1] += 100.0 + k
            K[k - 1, k] = K[k, k - 1] = -(100.0 + k)
        springs.append(K)
    last = np.zeros((N, N))
    last[-1, -1] = 2.0
    return {"K0": 0.1 * sum(springs) + np.eye(N), "M0": np.eye(N), "K_a": sum(springs[:3]), "K_b": sum(springs[3:]),
            "M_m": last}


def written(folder, how):
    folder.mkdir()
    content = {"channel": np.array(["x", "y"]), "channel_dof": np.array([0, N - 1])}
    for name, matrix in matrices().items():
        if how == "dense":
            content[name] = matrix
        else:
            rows = sparse.csr_array(matrix)
            parts = zip(SPARSE_PARTS, (rows.data, rows.indices, rows.indptr), strict=True)
            content |= {name + part: values for part, values in parts}
    np.savez(folder / "model.npz", **content)
    return folder / "model.npz"


# moves stiffness both ways and mass with it
GROUP = Group(name="lower part, and mass", parts={"a": -0.2, "b": 0.1, "m": 0.3}, std=0.9)


@pytest.mark.parametrize("how", ["dense", "sparse"])
@pytest.mark.parametrize("size", [0.0, 0.7, -1.3])
def test_the_groups_parameter_moves_its_members_together(tmp_path, how, size, validation):
    row = validation(what="model of matrices with a group's parameter, dense and sparse",
                     reference="its members moved by that size in the original", why="rounding")
    path = written(tmp_path / how, how)
    model = load_model(write_grouped(path, parameters(), [GROUP], tmp_path / "extended.model.toml"))
    plain = load_model(path, parameters=parameters())
    theta = np.array([1.1, 0.9, 0.1])
    moved = theta + size * np.array([GROUP.parts[n] for n in NAMES])
    expected, found = plain.solve(moved, 4), model.solve([*theta, size], 4)
    row.error(found.frequency_hz / expected.frequency_hz - 1, below=1e-12)
    np.testing.assert_allclose(np.abs(found.shape), np.abs(expected.shape), atol=1e-9)
    if size:
        still = plain.solve(theta, 4).frequency_hz
        assert np.max(np.abs(found.frequency_hz / still - 1)) > 0.01


def test_the_file_keeps_priors_and_correlation_and_gives_the_group_its_own(tmp_path):
    correlation = np.array([[1.0, 0.4, 0.0], [0.4, 1.0, -0.2], [0.0, -0.2, 1.0]])
    path = written(tmp_path / "dense", "dense")
    model = load_model(write_grouped(path, parameters(correlation), [GROUP], tmp_path / "extended.model.toml"))
    assert model.name == "model" and model.parameters.names == (*NAMES, "lower_part_and_mass")
    assert model.parameters.items[:3] == parameters().items
    np.testing.assert_array_equal(model.parameters.correlation[:3, :3], correlation)
    np.testing.assert_array_equal(model.parameters.correlation[3], [0, 0, 0, 1])
    added = model.parameters.items[3]
    assert (added.initial, added.std, added.prior) == (0.0, 0.9, "normal")
    # the tightest member each way: m may rise by 0.7 at 0.3 a unit, and fall by 0.5
    assert added.upper == pytest.approx(0.7 / 0.3) and added.lower == pytest.approx(-0.5 / 0.3)


def test_names_are_parts_of_a_matrixs_name_and_of_none_other():
    assert group_parameter("lower storeys", NAMES) == "lower_storeys"
    assert group_parameter("a", NAMES) == "a_group"
    assert group_parameter("odd_indptr", NAMES) == "odd_indptr_group"
    assert group_parameter("0", NAMES) == "0_group" and group_parameter("??", NAMES) == "group"


def test_a_group_that_moves_nothing_and_a_file_in_its_own_place_are_refused(tmp_path):
    path = written(tmp_path / "dense", "dense")
    with pytest.raises(InputError, match="add up to nothing"):
        write_grouped(path, parameters(), [Group(name="none", parts={"a": 0.0}, std=1.0)], tmp_path / "x.toml")
    before = path.read_bytes()
    with pytest.raises(InputError, match="is the model itself"):
        write_grouped(path, parameters(), [GROUP], path.with_suffix(".toml"))
    assert path.read_bytes() == before
