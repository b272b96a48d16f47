"""Numbers in a user's files that no structure has: one line that names file and key."""

import h5py
import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.modal.modes import CovarianceFactors, ModalData, ModalSet, read_modes, write_modes
from probupdate.model.parameters import Parameter
from probupdate.structure.matrices import matrix_of
from probupdate.structure.parameter_table import correlation_matrix
from probupdate.verbs import diagnose


@pytest.mark.parametrize("scale", [1e300, 1e40, 1e-40, 1e-300])
@pytest.mark.parametrize("form", ["dense", "parts"])
def test_matrices_of_no_unit_are_refused(tmp_path, scale, form):
    matrix = scale * np.array([[2.0, -1.0], [-1.0, 1.0]])
    content = {"K0": matrix} if form == "dense" else {
        "K0_data": matrix.ravel(), "K0_indices": np.array([0, 1, 0, 1]), "K0_indptr": np.array([0, 2, 4])}
    with pytest.raises(InputError, match=r"model\.npz, K0: its largest entry is .*no stiffness or mass is in any unit"):
        matrix_of(tmp_path / "model.npz", content, "K0")


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e15])
def test_matrices_in_any_usual_unit_are_read(tmp_path, scale):
    assert matrix_of(tmp_path / "model.npz", {"K0": scale * np.eye(3)}, "K0").shape == (3, 3)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1.5, -2, 1e300])
def test_a_correlation_beyond_one_is_refused(value):
    items = [Parameter(name=n, unit="-", initial=1.0, std=0.1, lower=0.5, upper=2.0) for n in "ab"]
    with pytest.raises(InputError, match=r"p\.toml, correlation\.a\.b: .* is not a number in -1 to 1"):
        correlation_matrix(items, {"a": {"b": value}}, "p.toml")


@pytest.mark.parametrize("amount", ["1e12", "-1e308", "inf", "nan", "0.0"])
def test_a_group_changes_by_an_amount_that_a_parameter_can(tmp_path, amount):
    path = tmp_path / "groups.toml"
    path.write_text(f"[legs]\nk_t = 1.0\nk_p = {amount}\n")
    data = ModalData(channels=("a",), sets=(ModalSet(
        id="1", frequency_hz=np.ones(1), damping_ratio=np.full(1, 0.01), shape=np.ones((1, 1), complex),
        frequency_std_hz=np.full(1, 0.01), shape_std=np.full((1, 1), 0.01)),))
    with pytest.raises(InputError, match=r"groups\.toml: legs: k_p = .* is not a plausible change of a parameter"):
        diagnose("as_built", data, groups=path)


def test_factors_with_holes_are_refused(tmp_path):
    factors = CovarianceFactors(ln_frequency=np.full((2, 3), 1e-3), damping_ratio=np.full((2, 3), 1e-3),
                                shape=np.full((1, 2, 3), 1e-3, complex))
    one = ModalSet(id="1", frequency_hz=np.array([1.0, 2.0]), damping_ratio=np.full(2, 0.01),
                   shape=np.ones((1, 2), complex), frequency_std_hz=np.full(2, 0.01), shape_std=np.full((1, 2), 0.01),
                   covariance_factors=factors)
    write_modes(ModalData(channels=("a",), sets=(one,)), tmp_path / "modes.json")
    read_modes(tmp_path / "modes.json")
    with h5py.File(tmp_path / "modes.deviations.h5", "r+") as file:
        file["1"]["ln_frequency"][0, 1] = np.nan
    with pytest.raises(InputError, match=r"modes\.deviations\.h5: does not hold what was written"):
        read_modes(tmp_path / "modes.json")
