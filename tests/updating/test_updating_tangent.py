"""The tangent of a function as matrices: its modes and their derivatives, by the matrices that the function hides."""

import numpy as np
import pytest
from updating_cases import CHAIN_PARAMETERS, chain_model, modal_set

import probupdate
from probupdate.modal.modes import ModalData
from probupdate.structure.functions import FunctionModel
from probupdate.structure.load import load_model
from probupdate.structure.tangent import write_tangent

N_MODE = 6


def function_of(own) -> FunctionModel:
    def function(theta):
        found = own.solve(theta, N_MODE + 2)
        # in a scale of its own
        return found.frequency_hz, found.shape * np.arange(1, N_MODE + 3)

    return FunctionModel(name="chain", parameters=own.parameters, channels=own.channels, function=function, version="1")


def test_tangent_has_the_functions_modes_and_derivatives(tmp_path, validation):
    row = validation(what="Tangent of a function as matrices: derivatives of frequencies and shapes",
                     reference="exact ones of the matrices that the function hides",
                     why="central differences", unit="of the largest")
    own = chain_model(asymmetry=0.3)
    tangent = load_model(write_tangent(function_of(own), tmp_path / "tangent.npz").path)
    theta = np.array(CHAIN_PARAMETERS.initial)
    exact = own.solve(theta, N_MODE, derivatives=True)
    found = tangent.solve(theta, N_MODE, derivatives=True)
    assert found.frequency_hz == pytest.approx(exact.frequency_hz, rel=1e-9)
    row.error((found.frequency_derivative - exact.frequency_derivative) / np.abs(exact.frequency_derivative).max(),
              1e-5, of="frequencies")
    for j in range(N_MODE):
        scale = (found.shape[:, j] @ exact.shape[:, j]) / (exact.shape[:, j] @ exact.shape[:, j])
        change = found.shape_derivative[:, j] / scale - exact.shape_derivative[:, j]
        own_part = exact.shape[:, j] / np.linalg.norm(exact.shape[:, j])
        # what only scales a shape is no change of it
        row.error((change - np.outer(own_part, own_part @ change)) / np.abs(exact.shape_derivative).max(), 1e-4,
                  of="shapes")


def test_the_note_says_how_far_it_holds(tmp_path):
    note = write_tangent(function_of(chain_model(asymmetry=0.3)), tmp_path / "tangent.npz").note
    assert note.startswith("chain is a function") and "one prior standard deviation away" in note


def test_a_function_is_diagnosed(tmp_path):
    """A parameter that changes half way through the record, by a function alone."""
    own, rng, sets = chain_model(asymmetry=0.3), np.random.default_rng(0), []
    for k in range(12):
        theta = np.array(CHAIN_PARAMETERS.initial) + [0.0, -0.04 if k >= 6 else 0.0, 0.0, 0.0]
        found = own.solve(theta, N_MODE)
        shape = found.shape / np.abs(found.shape).max(axis=0) + 0.01 * rng.standard_normal(found.shape.shape)
        sets.append(modal_set(found.frequency_hz * (1 + 0.001 * rng.standard_normal(N_MODE)), shape,
                              id=f"2026-06-01T{k:02d}:00Z", std=0.001 * found.frequency_hz,
                              shape_std=np.full(shape.shape, 0.01)))
    data = ModalData(channels=own.channels, sets=tuple(sets))
    found = probupdate.diagnose(function_of(own), data, extend=False, out=tmp_path / "diagnosis.json")
    assert found.findings, found.summary
    first = found.findings[0]
    assert (found.verdict, first.location) == ("named", "upper")
    assert first.size == pytest.approx(-0.04, abs=3 * first.size_std)
    assert first.time_profile_start.startswith("2026-06-01T06:00")
    assert found.notes[0].startswith("chain is a function") and (tmp_path / "diagnosis.tangent.npz").is_file()
