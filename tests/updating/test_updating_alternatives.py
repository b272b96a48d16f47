"""Other models of the same structure as directions of the model's error, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from updating_cases import modal_set

from probupdate import verbs
from probupdate.effects.alternatives import MEAN, STD, AlternativeModels
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.problem import Weights, build_problem

N = 5
CHANNELS = tuple(f"x{k}" for k in range(N))
PARAMETERS = Parameters((Parameter(name="k", unit="-", initial=1.0, std=0.3, lower=0.2, upper=3.0),
                         Parameter(name="m", unit="-", initial=1.0, std=0.1, lower=0.5, upper=2.0)))


def chain(soft: float = 0.0, *, parameters=PARAMETERS, order=range(N), both_ways: bool = False) -> FunctionModel:
    """Masses on springs, the upper ones softer by a share that the model leaves out; both ways: two such, a hair apart,
    turned into each other as far as `soft` says."""
    def function(theta):
        k = theta[0] * np.where(np.arange(N) < 2, 1.0, 1.0 - soft) * 900.0
        K = np.diag(k) + np.diag(np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
        value, phi = linalg.eigh(K, theta[1] * np.eye(N))
        f, phi = np.sqrt(value) / (2 * np.pi), phi[list(order)]
        if not both_ways:
            return f, phi
        c, s = np.cos(3 * soft), np.sin(3 * soft)
        pair = np.kron(phi, np.array([[c, -s], [s, c]]))
        return np.column_stack([f, 1.002 * f]).ravel(), pair

    names = [CHANNELS[k] for k in order]
    channels = tuple(f"{c}{n}" for n in names for c in "xy") if both_ways else tuple(names)
    return FunctionModel(name="chain", parameters=parameters, channels=channels, function=function, version="1")


def data_of(model: FunctionModel, theta, n_mode=3) -> ModalData:
    one = model.solve(np.asarray(theta, float), n_mode)
    shape = one.shape / np.abs(one.shape).max(axis=0)
    return ModalData(channels=model.channels, sets=(modal_set(
        one.frequency_hz, shape, std=2e-3 * one.frequency_hz, shape_std=np.full(shape.shape, 0.01)),))


def beside(model, *others) -> FunctionModel:
    return replace(model, uncertainty=AlternativeModels(model=model, others=tuple(
        (f"other {k}", one) for k, one in enumerate(others))))


def test_the_direction_is_the_difference_of_the_two_models(validation):
    row = validation(what="alternative model as a direction of the error: frequencies, shapes", reference="both solved")
    # channels in another order, a parameter more
    more = Parameters((*PARAMETERS, Parameter(name="extra", unit="-", initial=1.0, std=0.1)))
    model, other = chain(), chain(0.05, parameters=more, order=(4, 2, 0, 1, 3))
    problem = build_problem(beside(model, other), data_of(chain(0.1), [1.1, 0.95]),
                            weights=Weights(tolerances=True))
    at = problem.parameters.initial
    difference = build_problem(chain(0.05), data_of(chain(0.1), [1.1, 0.95])).predict(at) - build_problem(
        model, data_of(chain(0.1), [1.1, 0.95])).predict(at)
    n = problem.n_frequency
    row.error(problem.error.factor[:n, 0] / (STD * difference[:n]) - 1, below=1e-9, of="frequencies")
    # shapes are aligned by a first-order scale
    row.error((problem.error.factor[n:, 0] - STD * difference[n:]) / np.abs(difference[n:]).max(), below=0.05,
              of="shapes")
    assert problem.error.mean == pytest.approx(MEAN / STD * problem.error.factor[:, 0])


def test_pairs_turned_into_each_other_are_no_error_of_the_model():
    model = chain(both_ways=True)

    def turned(theta):
        f, phi = model.function(theta)
        c, s = np.cos(0.7), np.sin(0.7)
        return f, phi @ np.kron(np.eye(N), np.array([[c, -s], [s, c]]))

    problem = build_problem(beside(model, replace(model, function=turned)), data_of(model, [1.0, 1.0], 4),
                            weights=Weights(tolerances=True))
    assert np.abs(problem.error.factor).max() < 1e-9


@pytest.mark.parametrize("missed", [0.05, 0.15, 0.25])
def test_an_error_that_acts_like_a_parameter_is_held(missed):
    """Springs that the model leaves out: its intervals miss the truth, beside the alternative they hold it."""
    truth = np.array([1.1, 1.0])
    model, other = chain(), chain(0.2)
    sharp = replace(PARAMETERS.items[1], std=0.01)
    model, other = (replace(m, parameters=Parameters((PARAMETERS.items[0], sharp))) for m in (model, other))
    data, error = data_of(chain(missed), truth), {}
    for name, alternatives in (("alone", ()), ("beside", (other,))):
        found = verbs.update(model, data, likelihood=LikelihoodSettings(alternatives=alternatives, shapes="none"))
        error[name] = (found.map_theta[0] - truth[0]) / np.sqrt(found.map_covariance[0, 0])
    assert error["alone"] < -1.645 and abs(error["beside"]) < 1.645


def test_another_structure_is_no_alternative():
    other = chain()
    other = replace(other, function=lambda theta: (np.arange(1.0, N + 1), np.eye(N)))
    with pytest.raises(InputError, match="has no mode like the model's mode"):
        verbs.update(chain(), data_of(chain(0.1), [1.0, 1.0]), likelihood=LikelihoodSettings(alternatives=(other,)))


def test_weights_that_marginalise_nothing_refuse_alternatives():
    with pytest.raises(InputError, match="give --tolerances too"):
        verbs.update(chain(), data_of(chain(0.1), [1.0, 1.0]), likelihood=LikelihoodSettings(
            weights=(0.01, 0.01, 0.01), alternatives=(chain(0.2),)))
