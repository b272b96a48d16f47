"""Maxima of randomised posteriors: the posterior's own draws of a linear problem, on the ridge of a curved one."""

import numpy as np
import pytest
from test_updating_importance import half_of_two_modes
from test_updating_transport import by_quadrature, ridge
from updating_cases import LINEAR_HZ, linear_problem

from probupdate.runtime.progress import silent
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.randomised import randomised_maxima


def test_those_of_a_linear_problem_are_its_posterior(validation):
    row = validation(what="maxima of randomised posteriors of a linear problem: means, standard deviations",
                     reference="its Gaussian, closed form", unit="standard errors")
    problem = linear_problem(LINEAR_HZ + 0.05)
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    points, solved = randomised_maxima(problem, np.random.default_rng(2), silent)
    n, std = len(points), np.sqrt(np.diag(top.covariance))
    assert n == 200 and solved < 12 * 4 * 200
    row.error((points.mean(axis=0) - top.theta) / std * np.sqrt(n), below=4, of="means")
    row.error((points.std(axis=0) / std - 1) * np.sqrt(2 * n), below=4, of="standard deviations")


@pytest.mark.parametrize(("kind", "prior"), [("product", "lognormal"), ("series", "normal")])
def test_they_lie_all_over_a_thin_ridge(kind, prior):
    problem = ridge(kind, 1e-4, prior)
    points, _ = randomised_maxima(problem, np.random.default_rng(2), silent)
    off = problem.whiten(problem.measured - problem.predict_many(points).response)
    _, mean, std = by_quadrature(problem, kind, 1e-4)
    # where a proposal begins: the posterior's place and width along the ridge, its thickness across
    assert len(points) > 150 and 0.8 < off.std() < 1.2 and np.all(problem.parameters.inside(points))
    assert np.abs(points.mean(axis=0) - mean) == pytest.approx(0.0, abs=0.3 * std.max())
    assert points.std(axis=0) == pytest.approx(std, rel=0.3)


def test_they_keep_to_where_the_model_has_modes():
    problem, asked = half_of_two_modes()
    points, _ = randomised_maxima(problem, np.random.default_rng(2), silent)
    assert asked and len(points) > 50 and np.all(points[:, 0] >= 0)
