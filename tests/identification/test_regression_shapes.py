"""Covariates that are not followed along a line: lags, bends, saturations, steps, angles, on drawn data."""

import numpy as np
import pytest
from scipy import integrate

from probupdate.identification.regression import regress

SEEDS = range(8)


def lasting(rng, time, std, hours):
    covariance = std**2 * np.exp(-np.abs(time[:, None] - time) / hours)
    return np.linalg.cholesky(covariance + 1e-12 * np.eye(len(time))) @ rng.standard_normal(len(time))


def drawn(effect, seed, n=400):
    """Half hours over eight days; effect(time, air temperature, heading, level) is ln f beside noise of 0.1 % and an
    error that lasts for 12 h."""
    rng = np.random.default_rng(seed)
    time = 0.5 * np.arange(n)
    air = 2 + 6 * np.sin(2 * np.pi * (time - 9) / 24) + lasting(rng, time, 4.0, 48.0)
    heading = np.mod(200 + lasting(rng, time, 120.0, 20.0), 360)
    std = np.full(n, 1e-3)
    value = effect(time, air, heading) + 1e-3 * rng.standard_normal(n) + lasting(rng, time, 1e-3, 12.0)
    return regress("ln f", value, time, {"air": air, "nacelle_heading_deg": heading}, std)


def behind(time, air):
    """dz/dt = (air - z) / 6 h by a solver of ordinary differential equations, from a state nobody measured."""
    found = integrate.solve_ivp(lambda t, z: (np.interp(t, time, air) - z) / 6.0, (0, time[-1]), [air.mean()],
                                t_eval=time, rtol=1e-8, max_step=0.25)
    return found.y[0]


def slope(fit, name):
    k = fit.names.index(name)
    return fit.coefficient[k], fit.std_error[k]


def test_a_structure_that_lags_six_hours_keeps_its_slope(validation):
    row = validation(what="regression on a temperature that lags by 6 h: slope within two standard errors",
                     reference="-1.0e-3 per K", why="three of eight outside by chance in 0.6 % of runs")
    score, hours = [], []
    for seed in SEEDS:
        fit = drawn(lambda t, air, _: -1e-3 * behind(t, air), seed)
        (shape,) = fit.shapes
        assert (shape.kind, shape.covariate) == ("lag", "air")
        value, std = slope(fit, "air")
        score.append((value + 1e-3) / std)
        hours.append((shape.constant - 6) / shape.constant_std)
    row.count(int(np.sum(np.abs(score) < 2)), 8, least=6)
    assert np.sum(np.abs(hours) < 2) >= 6


def test_ice_bends_at_its_temperature():
    for seed in SEEDS[:3]:
        fit = drawn(lambda t, air, _: np.where(air < 0, -3e-3, -0.5e-3) * air, seed)
        (shape,) = fit.shapes
        assert shape.kind == "bend" and abs(shape.constant) < 4 * shape.constant_std + 0.05
        for name, true in zip(shape.names, (-3e-3, -0.5e-3), strict=True):
            value, std = slope(fit, name)
            assert abs(value - true) < 4 * std
        assert any("bends at air" in note for note in fit.notes)


def test_a_step_beside_a_slope_is_no_outlier():
    for seed in SEEDS[:3]:
        fit = drawn(lambda t, air, _: -1e-3 * air - 0.02 * (t >= 60), seed)
        (shape,) = fit.shapes
        assert shape.kind == "step" and abs(shape.constant - 60) <= 0.5 and fit.n_outlier <= 1
        value, std = slope(fit, "air")
        assert abs(value + 1e-3) < 4 * std and abs(slope(fit, shape.names[0])[0] + 0.02) < 4e-3


def test_a_step_beside_a_lag_is_dated_and_both_keep_their_sizes():
    fit = drawn(lambda t, air, _: -1e-3 * behind(t, air) - 0.01 * (t >= 120), 11)
    assert {s.kind for s in fit.shapes} == {"step", "lag"} and fit.n_outlier == 0
    step = next(s for s in fit.shapes if s.kind == "step")
    assert abs(step.constant - 120) <= 0.5
    for name, true in (("air", -1e-3), (step.names[0], -0.01)):
        value, std = slope(fit, name)
        assert abs(value - true) < 3 * std


def test_what_lags_bends_too():
    """One slope of -1.7e-3 before, and no word."""
    fit = drawn(lambda t, air, _: np.where(behind(t, air) < 0, -3e-3, -0.5e-3) * behind(t, air), 5)
    assert {s.kind for s in fit.shapes} == {"lag", "bend"} and not any("still follows" in note for note in fit.notes)
    lag, bend = sorted(fit.shapes, key=lambda s: s.kind == "bend")
    assert abs(lag.constant - 6) < 3 * lag.constant_std and abs(bend.constant) < 4 * bend.constant_std + 0.05
    for name, true in zip(bend.names, (-3e-3, -0.5e-3), strict=True):
        value, std = slope(fit, name)
        assert abs(value - true) < 4 * std


def test_a_drift_is_no_lag_of_anything():
    fit = drawn(lambda t, air, _: -1e-4 * t, 5)
    assert [s.kind for s in fit.shapes] == ["drift"]
    value, std = slope(fit, "days")
    assert abs(value + 2.4e-3) < 4 * std


def test_two_steps_are_two():
    fit = drawn(lambda t, air, _: -1e-3 * air - 0.01 * (t >= 60) + 0.008 * (t >= 140), 12)
    assert [s.kind for s in fit.shapes] == ["step"] * 2 and fit.n_outlier == 0
    assert sorted(round(s.constant) for s in fit.shapes) == [60, 140]
    for s, true in zip(sorted(fit.shapes, key=lambda s: s.constant), (-0.01, 0.008), strict=True):
        value, std = slope(fit, s.names[0])
        assert abs(value - true) < 4 * std


def slack(width):
    """What rests within a gap of `width` that moves with the air's temperature, in steps of three minutes."""
    def effect(time, air, _):
        fine = np.arange(0, time[-1] + 1e-9, 0.05)
        x, z = np.interp(fine, time, air), np.full(len(fine), air[0])
        for k in range(1, len(x)):
            z[k] = np.clip(z[k - 1], x[k] - width / 2, x[k] + width / 2)
        return -1e-3 * np.interp(time, fine, z)
    return effect


@pytest.mark.parametrize(("width", "seed"), [(4.0, 2), (8.0, 1), (8.0, 3)])
def test_hysteresis_is_found_with_its_width_and_slope(width, seed):
    fit = drawn(slack(width), seed)
    (shape,) = fit.shapes
    assert (shape.kind, shape.covariate) == ("hysteresis", "air")
    assert abs(shape.constant - width) < 4 * shape.constant_std
    value, std = slope(fit, "air")
    assert abs(value + 1e-3) < 4 * std


def rounded_loop(amplitude, linear):
    """Bouc and Wen's law, dz = dx (1 - (1 + sign(z dx)) |z| / (2 amplitude)), beside a linear part."""
    def effect(time, air, _):
        fine = np.arange(0, time[-1] + 1e-9, 0.02)
        x, z = np.interp(fine, time, air), np.zeros(len(fine))
        for k in range(1, len(x)):
            dx = x[k] - x[k - 1]
            z[k] = z[k - 1] + dx * (1 - (1 + np.sign(z[k - 1] * dx)) * abs(z[k - 1]) / (2 * amplitude))
        return -1e-3 * np.interp(time, fine, linear * x + (1 - linear) * z)
    return effect


@pytest.mark.parametrize("seed", [1, 2])
def test_hysteresis_of_rounded_loops_is_no_daily_period(seed):
    fit = drawn(rounded_loop(4.0, 0.4), seed)
    assert [(s.kind, s.covariate) for s in fit.shapes] == [("hysteresis", "air")]
    # of large changes, on which z rests at its amplitude; the law is rounder than means of play operators
    assert slope(fit, "air")[0] == pytest.approx(-0.4e-3, rel=0.5)


def test_a_saturation_and_a_daily_period_are_found():
    fit = drawn(lambda t, air, _: -1e-3 * np.minimum(air, 4), 1)
    assert [s.kind for s in fit.shapes] == ["saturation"] and abs(fit.shapes[0].constant - 4) < 1
    fit = drawn(lambda t, air, heading: 3e-3 * np.cos(2 * np.pi * t / 24), 1)
    assert "day" in [s.kind for s in fit.shapes] or "lag" in [s.kind for s in fit.shapes]


def test_a_tide_that_nobody_recorded_is_a_period():
    fit = drawn(lambda t, air, _: -1e-3 * air + 3e-3 * np.sin(2 * np.pi * t / 12.42 + 1), 4, n=300)
    assert [s.kind for s in fit.shapes] == ["tide"] and any("as of the tide" in note for note in fit.notes)
    value, std = slope(fit, "air")
    assert abs(value + 1e-3) < 3 * std


@pytest.mark.parametrize("turns", [1, 2])
def test_angles_go_round(turns):
    fit = drawn(lambda t, air, heading: 3e-3 * np.cos(turns * np.radians(heading - 40)), 3)
    names = [f"{part} {'2 ' if turns == 2 else ''}nacelle_heading_deg" for part in ("cos", "sin")]
    amplitude = np.hypot(*(slope(fit, name)[0] for name in names))
    assert amplitude == pytest.approx(3e-3, rel=0.15) and dict(fit.joint)[tuple(names)] < 1e-9


def test_lines_and_nothing_have_no_shape():
    for seed in SEEDS:
        assert not drawn(lambda t, air, _: -1e-3 * air, seed, n=200).shapes
        assert not drawn(lambda t, air, _: 0 * t, seed, n=200).shapes


def test_what_is_in_no_shape_is_said():
    fit = drawn(lambda t, air, _: 4e-3 * np.sin(1.2 * air), 2)
    assert any("the residual still follows air" in note for note in fit.notes)
