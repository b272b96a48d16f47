"""Models of one to six degrees of freedom: each gives as many modes as it has masses, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.interface import Wireframe
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel
from probupdate.structure.own_modes import modes_of_model
from probupdate.updating.problem import build_problem
from probupdate.verbs.sought import reference_modes

K_STOREY, MASS = 2.0e6, 5.0e3  # N/m, kg


def shear_building(n: int, massless: int = 0) -> AffineModel:
    """n equal storeys fixed at the base; the lowest `massless` floors have no mass."""
    stiffness = K_STOREY * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    stiffness[-1, -1] = K_STOREY
    mass = MASS * np.diag(np.arange(n) >= massless).astype(float)
    return AffineModel(
        name="building", channels=tuple(f"F{k}_x" for k in range(1, n + 1)), hash_key=f"{n} {massless}",
        parameters=Parameters((Parameter(name="k", unit="-", initial=1.0, std=0.1, lower=0.5, upper=2.0),)),
        stiffness=(sparse.csc_array(stiffness),), mass=(sparse.csc_array(mass),),
        coefficients=lambda theta: (theta[..., :1], np.ones_like(theta[..., :1])),
        channel_matrix=sparse.csr_array(np.eye(n)),
    )


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_every_degree_of_freedom_gives_its_mode(n, validation):
    row = validation(what="small models, 1 to 6 degrees of freedom: frequencies, derivatives of frequencies, of shapes",
                     reference="closed form of a shear building", why="rounding")
    model = shear_building(n)
    assert model.n_available == n
    found = model.solve(model.parameters.initial, n, derivatives=True)
    # Blevins: omega_j = 2 sqrt(k/m) sin((2 j - 1) pi / (2 (2 n + 1)))
    j = np.arange(1, n + 1)
    expected = np.sqrt(K_STOREY / MASS) / np.pi * np.sin((2 * j - 1) * np.pi / (2 * (2 * n + 1)))
    row.error(found.frequency_hz / expected - 1, 1e-10, "frequencies")
    # all stiffness scales with the parameter: df/dk = f / 2, and no shape moves
    row.error(found.frequency_derivative[:, 0] / (expected / 2) - 1, 1e-9, "derivatives")
    row.error(found.shape_derivative / np.abs(found.shape).max(), 1e-9, "of shapes")
    row.error(modes_of_model(model, n).frequency_hz / expected - 1, 1e-10, "frequencies")


def test_more_modes_than_degrees_of_freedom_are_refused():
    model = shear_building(3)
    with pytest.raises(InputError, match="4 modes asked of 3 degrees of freedom"):
        model.solve(model.parameters.initial, 4)


def test_a_floor_without_mass_gives_no_mode():
    # the lower two of three springs in series: one mass on k / 3 where two floors have none
    model = shear_building(3, massless=2)
    assert model.n_available == 1
    frequency = model.solve(model.parameters.initial, 1).frequency_hz
    assert frequency == pytest.approx([np.sqrt(K_STOREY / 3 / MASS) / (2 * np.pi)], rel=1e-10)


@pytest.mark.parametrize(("n_model", "n_measured"), [(1, 2), (2, 3), (3, 6), (3, 3), (6, 3)])
def test_a_model_smaller_than_the_record_takes_its_own_modes_and_says_the_rest(n_model, n_measured):
    # the model's own modes 2 % up, and further ones that it has not
    whole, seen = shear_building(6), min(n_model, n_measured)
    model = shear_building(n_model)
    own = model.solve(model.parameters.initial, seen)
    found = whole.solve(whole.parameters.initial, n_measured)
    frequency, shape = found.frequency_hz.copy(), found.shape[: max(n_model, 2)].copy()
    # the others lie well above, so that none makes a close pair with one of the model's
    frequency[seen:] *= 2.0
    frequency[:seen], shape[:n_model, :seen] = 1.02 * own.frequency_hz, own.shape
    channels = tuple(f"F{k}_x" for k in range(1, len(shape) + 1))
    if n_model == 1:
        model = replace(model, channels=channels, channel_matrix=sparse.csr_array(np.array([[1.0], [0.5]])))
        shape[:, 0] = [1.0, 0.5]
    one = ModalSet(id="one", frequency_hz=frequency, shape=shape, damping_ratio=np.full(n_measured, 0.01),
                   frequency_std_hz=0.01 * frequency, shape_std=np.full(shape.shape, 0.02))
    problem = build_problem(model, ModalData(channels=channels, sets=(one,)))
    assert list(problem.used) == list(range(seen))
    said = problem.matching.left_out
    assert all(f"the model has {n_model} modes" in line for line in said)
    # each one that is left out is named, of a close pair both
    assert [k for k in range(n_measured) if f"mode {k + 1}" in " ".join(said)] == list(range(seen, n_measured))
    # frequencies go with the root of the stiffness
    assert problem.misfit(problem.predict(np.array([1.02**2]))) < 1e-12


def test_without_a_count_a_small_model_gives_what_it_has():
    assert len(modes_of_model(shear_building(3)).frequency_hz) == 3
    with pytest.raises(InputError, match="4 modes are asked for, it has 3"):
        modes_of_model(shear_building(3), 4)


@pytest.mark.parametrize(("stiffness", "mass", "height", "said"), [
    (1.0, 1.0, 9.0, ""), (1.0, 1.0, None, ""),
    (1e-6, 1.0, 9.0, "0.0014"), (1e-6, 1.0, None, "0.00142 Hz; 0.02 to 1000 Hz"),  # E in MPa
    (1.0, 1e-3, 30.0, "Hz; 0.067 to 17 Hz is usual for an extent of 30 m"),  # masses in t
    (None, None, 9.0, "exchanged"), (None, None, None, "exchanged"),
    # right frequencies, places in mm and divided by 1000 once too often
    (1.0, 1.0, 9000.0, "places in mm"), (1.0, 1.0, 0.02, "a thousandth of m"),
    (1e-3, 1.0, 1e4, "more than structures have"),
])
def test_frequencies_of_no_structure_are_said_to_be(stiffness, mass, height, said):
    model = shear_building(3)
    if stiffness is None:
        model = replace(model, stiffness=(model.mass[0],), mass=(model.stiffness[0],))
    else:
        model = replace(model, stiffness=(stiffness * model.stiffness[0],), mass=(mass * model.mass[0],))
    if height is not None:
        nodes = np.column_stack([np.zeros((3, 2)), height * np.array([0.0, 0.5, 1.0])])
        wire = Wireframe(node_m=nodes, line=np.array([[0, 1], [1, 2]]), line_group=("", ""))
        model = replace(model, wire=wire, wire_matrix=sparse.csr_array(np.zeros((9, 3))))
    notes = modes_of_model(model, 3).notes
    assert len(notes) == bool(said)
    assert all(said in note and note.startswith("implausible: the lowest frequency is") for note in notes)


def test_more_modes_to_look_for_than_the_model_has_are_refused():
    with pytest.raises(InputError,
                       match=r"building: 7 modes are to be looked for \(--lowest\), it has 3; ask for at most 3"):
        reference_modes(shear_building(3), (), lowest=7)
