"""alpha by rule against closed forms of a linear problem; the trust region against Gauss-Newton; remarks on alpha."""

import numpy as np
import pytest
from scipy import stats
from updating_cases import (
    LINEAR_HZ,
    LINEAR_PARAMETERS,
    SLOPE,
    chain_problem,
    linear_data,
    linear_model,
    linear_problem,
)

from probupdate.errors import ConvergenceError, InputError
from probupdate.updating import alpha as alpha_module
from probupdate.updating import laplace
from probupdate.updating.alpha import ALPHAS, alpha_path, choose
from probupdate.updating.laplace import maximum_a_posteriori, trust_region
from probupdate.updating.problem import build_problem
from probupdate.updating.tikhonov import update

# one parameter's effect is large, the data are noisier than a model at its prior: every rule has an answer
DATA = LINEAR_HZ + np.array([0.05, -0.06, 0.12, 0.28, -0.45])


@pytest.fixture(scope="module")
def linear():
    problem = linear_problem(DATA)
    return problem, alpha_path(problem)


def closed_form(problem, alpha):
    start = problem.parameters.initial
    response, S = problem.sensitivity(start)
    A, b = S / problem.std[:, None], (problem.measured - response) / problem.std
    W = np.linalg.inv(problem.parameters.covariance)
    return start + np.linalg.solve(A.T @ A + alpha * W, A.T @ b), A, b, W


def test_the_path_is_the_closed_form_at_every_alpha(linear, validation):
    row = validation(what="anchored update over alpha, linear problem", reference="closed form",
                     why="derivatives by differences", unit="in theta")
    problem, path = linear
    assert path.alpha == pytest.approx(ALPHAS) and np.all(path.settled)
    for alpha, theta, misfit in zip(path.alpha, path.theta, path.misfit, strict=True):
        exact, A, b, _ = closed_form(problem, alpha)
        row.error(theta - exact, below=1e-6)
        assert misfit == pytest.approx(np.sum((A @ (exact - problem.parameters.initial) - b) ** 2), rel=1e-5)
    assert np.all(np.diff(path.misfit) >= 0) and np.all(np.diff(path.penalty) <= 0)


def test_log_evidence_of_alpha_is_the_density_of_the_data(linear, validation):
    row = validation(what="evidence of alpha, linear problem", reference="density of the data",
                     why="derivatives by differences", unit="in ln p")
    problem, path = linear
    _, A, b, W = closed_form(problem, 1.0)
    exact = [stats.multivariate_normal(np.zeros(len(b)), np.eye(len(b)) + A @ np.linalg.inv(a * W) @ A.T).logpdf(b)
             for a in path.alpha]
    row.error(path.log_evidence - path.log_evidence[0] - (np.array(exact) - exact[0]), below=1e-4)


def test_the_discrepancy_principle_meets_the_effective_number_of_data():
    # ten prior standard deviations from the prior: held there it misses the data by far, left alone it meets them
    problem = linear_problem(LINEAR_HZ + SLOPE @ (10 * LINEAR_PARAMETERS.std))
    path = alpha_path(problem)
    theta, A, b, _ = closed_form(problem, choose(path, "discrepancy"))
    misfit = np.sum((A @ (theta - problem.parameters.initial) - b) ** 2)
    below, above = (path.misfit[path.misfit < problem.n_effective].max(),
                    path.misfit[path.misfit >= problem.n_effective].min())
    # interpolated between two values of the path
    assert below < misfit < above


def test_a_corner_is_found_where_there_is_one():
    """An ill-posed linear problem in diagonal form, noise on what hardly counts: curvature by differences of a fine
    path, on which no relation of the two terms is used."""
    singular = np.logspace(1, -3, 12)
    rng = np.random.default_rng(3)
    b = singular + 0.02 * rng.standard_normal(12)

    def terms(alpha):
        x = singular * b / (singular**2 + alpha[:, None])
        slope = -2 * np.sum(x**2 / (singular**2 + alpha[:, None]), axis=1)
        return np.sum((singular * x - b) ** 2, axis=1), np.sum(x**2, axis=1), slope

    alpha = np.logspace(-5, 1, 13)
    found, _ = alpha_module.curve_corner(alpha, *terms(alpha))
    fine = np.logspace(-5, 1, 4001)
    misfit, penalty, slope = terms(fine)
    x, y = (np.gradient(np.log(v), np.log(fine)) for v in (misfit, penalty))
    bend = (x * np.gradient(y, np.log(fine)) - y * np.gradient(x, np.log(fine))) / (x**2 + y**2) ** 1.5
    inside = slice(100, -100)
    exact = alpha_module.curvature(fine, misfit, penalty, slope)
    assert exact[inside] == pytest.approx(bend[inside], rel=0.02, abs=0.02)
    assert found == pytest.approx(fine[np.argmax(bend[inside]) + 100], rel=1.0)


@pytest.mark.parametrize("seed", [0, 3, 4, 5])
def test_a_corner_at_the_windows_end_is_none(seed):
    """Well-posed: the data determine what they can, and the curve ends in a point that no alpha below changes."""
    rng = np.random.default_rng(seed)
    theta = LINEAR_PARAMETERS.std * rng.standard_normal(3)
    measured = LINEAR_HZ + SLOPE @ theta + 2e-4 * LINEAR_HZ * rng.standard_normal(5)
    path = alpha_path(build_problem(linear_model(), linear_data(measured, cov=2e-4)))
    assert np.isnan(path.chosen["l-curve"]) and "bends most at the window's end" in path.remarks["l-curve"]
    with pytest.raises(InputError, match="no corner"):
        choose(path, "l-curve")


def test_a_rule_without_an_answer_is_refused_with_the_reason():
    path = alpha_path(linear_problem(LINEAR_HZ * 1.0001))
    assert np.isnan(path.chosen["discrepancy"])
    with pytest.raises(InputError, match="does not pass the"):
        choose(path, "discrepancy")
    with pytest.raises(InputError, match="'maximum' is unknown"):
        choose(path, "maximum")


def test_levenberg_marquardt_ends_where_gauss_newton_does(validation):
    row = validation(what="Levenberg-Marquardt's end", reference="Gauss-Newton's", why="where both stop",
                     unit="posterior standard deviations")
    problem = chain_problem(noise=0.01)
    newton, trust = (update(problem, method=m) for m in ("gauss-newton", "levenberg-marquardt"))
    assert trust.converged and trust.status.startswith("converged")
    top = maximum_a_posteriori(problem, [newton.theta[-1]])
    row.error((trust.theta[-1] - newton.theta[-1]) / np.sqrt(np.diag(top.covariance)), below=1e-4)
    # its iterates are kept: each lowers the objective
    assert np.all(np.diff(trust.objective) < 1e-6 * trust.objective[0])
    with pytest.raises(InputError, match="its own step"):
        update(problem, penalty="step", method="levenberg-marquardt")


def test_the_maximum_states_how_far_its_gradient_is_from_zero():
    problem = chain_problem(noise=0.01)
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    assert top.projected_gradient < 1e-4
    rough = trust_region(problem, problem.parameters.initial)
    assert np.abs(rough - top.theta) / np.sqrt(np.diag(top.covariance)) == pytest.approx(0, abs=1e-3)


def test_a_climb_that_does_not_end_is_at_a_maximum_where_two_ways_end_as_high(monkeypatch):
    """As on a crease, where two modes of the model are equal and slopes jump: an `update` of a mast alike both ways had
    ended without one. Two ways that end elsewhere are none."""
    problem = chain_problem(noise=0.01)
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    restless = laplace._climb
    monkeypatch.setattr(laplace, "_climb", lambda *a: (*restless(*a)[:2], False))
    found = maximum_a_posteriori(problem, [problem.parameters.initial])
    assert np.abs(found.theta - top.theta) / np.sqrt(np.diag(top.covariance)) == pytest.approx(0, abs=1e-3)
    away = np.clip(top.theta + 0.5 * problem.parameters.std, problem.parameters.lower, problem.parameters.upper)
    monkeypatch.setattr(laplace, "trust_region", lambda *a: away)
    with pytest.raises(ConvergenceError, match="maximum was not reached"):
        maximum_a_posteriori(problem, [problem.parameters.initial])


def test_an_alpha_that_leaves_the_data_no_weight_is_told():
    run = update(linear_problem(DATA), alpha=1e300)
    assert run.converged and "leaves the data no weight" in run.status
    assert "leaves the data no weight" not in update(linear_problem(DATA)).status
