"""Priors: truncated normal and lognormal against quadrature, the joint prior against its conditional."""

import numpy as np
import pytest
from scipy import integrate

from probupdate.errors import InputError
from probupdate.model.parameters import Parameter, Parameters


def make(**kwargs):
    return Parameter(**({"name": "p", "unit": "-", "initial": 1.0, "std": 1.0} | kwargs))


def test_half_cut_normal_has_the_published_moments():
    # Normal(1, 1) cut at zero: mean 1.288, median 1.200, real CoV 0.616 (a standard result of the truncated normal)
    d = make(lower=0.0).distribution
    assert d.mean() == pytest.approx(1.288, abs=5e-4)
    assert d.median() == pytest.approx(1.200, abs=5e-4)
    assert d.std() / d.mean() == pytest.approx(0.616, abs=5e-4)


@pytest.mark.parametrize("bounds", [(0.01, 3.0), (0.0, np.inf), (0.5, 1.2)])
def test_lognormal_against_quadrature(bounds):
    p = make(lower=bounds[0], upper=bounds[1], prior="lognormal", std=0.6)
    d = p.distribution
    low, high = max(bounds[0], 1e-9), min(bounds[1], 400.0)
    moment = [integrate.quad(lambda t, k=k: t**k * np.exp(d.logpdf(t)), low, high, limit=400, points=[1.0])[0]
              for k in range(3)]
    assert moment[0] == pytest.approx(1, abs=1e-6)
    assert d.mean() == pytest.approx(moment[1], rel=1e-5)
    assert d.std() == pytest.approx(np.sqrt(moment[2] - moment[1] ** 2), rel=1e-4)
    assert d.cdf(d.ppf(0.3)) == pytest.approx(0.3)


def test_uncut_lognormal_has_the_stated_median_and_deviation():
    d = make(prior="lognormal", initial=2.0, std=0.5, lower=0.0).distribution
    assert d.median() == pytest.approx(2.0)
    assert d.std() == pytest.approx(0.5)


def test_log_density_is_minus_infinity_outside_the_bounds():
    ps = Parameters((make(lower=0.0), make(name="q", lower=0.0, prior="lognormal")))
    values = ps.log_density(np.array([[1.0, 1.0], [-0.1, 1.0], [1.0, -1.0]]))
    assert np.isfinite(values[0]) and values[1] == -np.inf and values[2] == -np.inf


def test_correlated_log_density_differences_match_the_joint_normal():
    c = np.array([[1.0, 0.6], [0.6, 1.0]])
    ps = Parameters((make(), make(name="q", std=0.5)), c)
    inverse = np.linalg.inv(ps.covariance)
    a, b = np.array([1.3, 0.4]), np.array([0.2, 1.1])
    expected = -0.5 * ((a - 1) @ inverse @ (a - 1) - (b - 1) @ inverse @ (b - 1))
    assert ps.log_density(a) - ps.log_density(b) == pytest.approx(expected)


def test_draws_follow_the_prior_and_the_correlation():
    c = np.array([[1.0, 0.6], [0.6, 1.0]])
    ps = Parameters((make(), make(name="q", std=0.5, prior="lognormal")), c)
    draws = ps.draw(np.random.default_rng(1), 20000)
    z = np.column_stack([draws[:, 0] - 1, np.log(draws[:, 1])])
    # standard error of a correlation of 20 000 draws is 0.0045
    assert np.corrcoef(z.T)[0, 1] == pytest.approx(0.6, abs=0.02)
    same = ps.draw(np.random.default_rng(1), 20000)
    assert np.array_equal(draws, same)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"std": 0.0}, "standard deviation"),
        ({"std": float("nan")}, "standard deviation"),
        ({"initial": float("nan")}, "initial"),
        ({"lower": 2.0, "upper": 1.0}, "bounds"),
        ({"lower": 1.5}, "outside"),
        ({"prior": "flat"}, "unknown"),
        ({"prior": "lognormal", "initial": -1.0}, "positive initial"),
    ],
)
def test_each_mistake_is_named(change, word):
    with pytest.raises(InputError, match=word) as caught:
        make(**change)
    assert "parameter p" in str(caught.value)


def test_correlation_must_be_a_correlation():
    items = (make(), make(name="q"))
    with pytest.raises(InputError, match="symmetric"):
        Parameters(items, np.array([[1, 0.5], [0.4, 1]]))
    with pytest.raises(InputError, match="positive definite"):
        Parameters(items, np.array([[1, 1.0], [1.0, 1]]))
    with pytest.raises(InputError, match="twice"):
        Parameters((make(), make()))
