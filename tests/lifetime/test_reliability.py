"""FORM beside closed forms and Monte Carlo; annual indices; model factors add up."""

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from probupdate.errors import ConvergenceError
from probupdate.lifetime.conditions import Lognormal, Uncertainty
from probupdate.lifetime.reliability import (
    DamageCurve,
    annual_index,
    form,
    life_quantiles,
    log_std,
    reliability,
    simulated_index,
    survival,
)
from probupdate.lifetime.spectral import Curve, dirlik

STATED = Uncertainty(
    x_load=Lognormal(median=1.0, cov=0.10),
    x_scf=Lognormal(median=1.0, cov=0.15),
    miner=Lognormal(median=1.0, cov=0.3),
    log10_a_std=0.2,
)
T = Curve(log10_a1=11.764, m1=3.0, log10_a2=15.606, m2=5.0)


def two_slopes() -> DamageCurve:
    """Of three spectra, from little to much stress."""
    at = np.arange(-2.5, 2.55, 0.05)
    year = 365.25 * 86400
    columns = []
    for sigma in (3.0, 6.0, 12.0):
        one = dirlik(sigma**2 * np.array([1.0, 0.2, 0.06, 0.02]))
        columns.append([np.log(year * float(one.damage(T, np.exp(b)))) for b in at])
    return DamageCurve(at=at, log_damage=np.array(columns).T)


def test_form_of_planes_is_exact():
    def limit(u):
        slope = np.array([[1.0, -2.0, 0.5], [-0.3, 0.0, 4.0]])
        return np.array([3.0, -1.0]) + np.sum(slope * u, axis=-1), slope

    beta, u = form(limit, (2,), 3)
    np.testing.assert_allclose(beta, [3 / np.sqrt(5.25), -1 / np.sqrt(16.09)])
    np.testing.assert_allclose(limit(u)[0], 0, atol=1e-9)


def test_form_that_does_not_settle_says_so():
    def wild(u):
        return np.exp(-u[..., 0]), -np.exp(-u)

    with pytest.raises(ConvergenceError, match="did not converge"):
        form(wild, (1,), 1)


def test_one_slope_has_the_lognormal_closed_form(validation):
    row = validation(what="FORM, one slope", reference="closed form", why="differences of probabilities")
    at = np.array([-2.5, 0.0, 2.5])
    curve = DamageCurve(at=at, log_damage=(np.log(1e-2) + 4.0 * at)[:, None])
    found = reliability(curve, np.array([0.05]), np.array([0.08]), STATED, years=30, target=3.3)
    std = np.sqrt(
        16 * (0.08**2 + log_std(STATED.x_load) ** 2 + log_std(STATED.x_scf) ** 2)
        + log_std(STATED.miner) ** 2
        + (np.log(10) * 0.2) ** 2
    )
    expected = (-np.log(1e-2) - 0.2 - np.log(np.arange(1, 31))) / std
    row.error(found.cumulative[0] / expected - 1, below=1e-9, of="cumulative")
    failed = stats.norm.cdf(-expected)
    annual = np.diff(failed, prepend=0.0) / (1 - np.concatenate([[0.0], failed[:-1]]))
    row.error(found.annual[0] / -stats.norm.ppf(annual) - 1, below=1e-8, of="annual")
    assert found.first_below[0] == np.argmax(found.annual[0] < 3.3) + 1


def test_annual_indices_keep_their_digits_where_failure_is_rare():
    cumulative = np.array([8.0, 7.9, 7.85])
    p = stats.norm.sf(cumulative)
    np.testing.assert_allclose(stats.norm.sf(annual_index(cumulative)), np.diff(p, prepend=0.0), rtol=1e-9)


def test_form_and_monte_carlo_agree_on_two_slopes(validation):
    row = validation(what="FORM, two slopes: reliability index", reference="importance sampling; quadrature",
                     why="a bent limit state")
    curve, mean, std = two_slopes(), np.array([0.0, -0.05, 0.1]), np.array([0.05, 0.1, 0.2])
    found = reliability(curve, mean, std, STATED, years=25, target=3.3)
    simulated, error = simulated_index(curve, mean, std, STATED, years=25, n=100_000, rng=np.random.default_rng(1))
    assert error.max() < 0.005
    row.error(simulated - found.cumulative, below=0.02, of="sampling")
    # and by integration over the stress factor, for what either of them may share
    spread = np.sqrt(std**2 + log_std(STATED.x_load) ** 2 + log_std(STATED.x_scf) ** 2)
    resistance = np.hypot(log_std(STATED.miner), np.log(10) * 0.2)
    for k in range(3):
        for year in (1, 10, 25):
            one = curve.select([k])

            def failing(z, k=k, year=year, one=one):
                value = one.value(np.array([[mean[k] + spread[k] * z]]))[0][0, 0]
                return stats.norm.cdf((np.log(year) + value) / resistance) * stats.norm.pdf(z)

            p = quad(failing, -9, 9, limit=400, points=[0.0, 3.0, 6.0])[0]
            row.error(-stats.norm.ppf(p) - found.cumulative[k, year - 1], below=0.02, of="quadrature")


def test_life_of_the_median_factor_is_the_damage_turned_over():
    curve = two_slopes()
    sure = Uncertainty(
        x_load=Lognormal(median=1.0, cov=0.0),
        x_scf=Lognormal(median=1.0, cov=0.0),
        miner=Lognormal(median=0.5, cov=0.0),
        log10_a_std=0.0,
    )
    lives = life_quantiles(curve, np.zeros(3), np.zeros(3), sure, np.array([0.1, 0.9]))
    at_one = curve.value(np.zeros((3, 1)))[0][:, 0]
    np.testing.assert_allclose(lives, 0.5 * np.exp(-at_one)[:, None] * np.ones(2), rtol=1e-10)


def test_a_factor_is_found_again_from_its_damage():
    curve = two_slopes()
    # the last: forty times the stress, beyond the table, where it was held at twelve
    for b in (np.array([-0.3, 0.02, 0.4]), np.array([-0.7, 2.4, np.log(40.0)])):
        np.testing.assert_allclose(curve.factor(curve.value(b[:, None])[0][:, 0]), b, atol=1e-6)


def drawn_lives(curve, mean, std, n, rng):
    """Lives (n_spot, n) by plain drawing of every variable."""
    z = rng.standard_normal((5, curve.n_spot, n))
    miner, load, scf = (np.sqrt(np.log1p(v.cov**2)) for v in (STATED.miner, STATED.x_load, STATED.x_scf))
    factor = mean[:, None] + std[:, None] * z[0] + load * z[1] + scf * z[2]
    return np.exp(miner * z[3] + np.log(10) * STATED.log10_a_std * z[4] - curve.value(factor)[0])


def test_remaining_life_given_survival_is_that_of_drawn_lives(validation):
    curve, mean, std = two_slopes(), np.array([0.0, 0.1, -0.2]), np.array([0.1, 0.2, 0.15])
    lives = drawn_lives(curve, mean, std, 400_000, np.random.default_rng(4))
    row = validation(what="quantiles of remaining life, given survival to the median life and without",
                     reference="400 000 drawn lives", why="standard errors of quantiles in ln years")
    levels = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    for spot in range(3):
        age = float(np.median(lives[spot]))
        one = curve.select([spot])
        for survived in (0.0, age):
            kept = np.log(lives[spot][lives[spot] > survived])
            expected = np.quantile(kept, levels)
            found = np.log(life_quantiles(one, mean[[spot]], std[[spot]], STATED, levels, survived_years=survived)[0])
            # sqrt(p (1 - p) / n) over the density, by neighbouring quantiles
            density = 0.02 / (np.quantile(kept, levels + 0.01) - np.quantile(kept, levels - 0.01))
            row.error((found - expected) / (np.sqrt(levels * (1 - levels) / len(kept)) / density), below=4.5)


def test_survival_is_the_cumulative_index(validation):
    curve, mean, std = two_slopes(), np.zeros(3), np.full(3, 0.15)
    years = np.array([1, 10, 40])
    found = survival(curve, mean, std, STATED, np.tile(np.log(years), (3, 1)))
    index = reliability(curve, mean, std, STATED, years=40, target=3.3).cumulative[:, years - 1]
    validation(what="survival by quadrature as an index", reference="FORM", why="a bent limit state").error(
        -stats.norm.ppf(-np.expm1(found)) - index, below=0.02)
