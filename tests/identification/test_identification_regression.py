"""Regression on covariates: against dense algebra, with errors that last, outliers, gaps and twins."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from probupdate.errors import InputError
from probupdate.identification.regression import regress, regress_modes, whiten_columns
from probupdate.modal.modes import ModalData, ModalSet


def slow(rng, time, std, hours):
    covariance = std**2 * np.exp(-np.abs(time[:, None] - time) / hours)
    return np.linalg.cholesky(covariance + 1e-12 * np.eye(len(time))) @ rng.standard_normal(len(time))


def case(seed, n=200, slow_std=0.002, hours=12.0, noise=0.002):
    """Half hours with gaps; covariates that last for hours; ln f = 0.1 - 0.004 level + 0.0005 (T - 15) + errors."""
    rng = np.random.default_rng(seed)
    time = 0.5 * np.sort(rng.choice(int(1.5 * n), n, replace=False))
    level = np.cos(2 * np.pi * time / 12.42 + rng.uniform(0, 6)) + 0.2 * rng.standard_normal(n)
    temperature = 15 + slow(rng, time, 3.0, 24.0)
    std = noise * rng.uniform(0.5, 2.0, n)
    value = 0.1 - 0.004 * level + 0.0005 * (temperature - 15) + slow(rng, time, slow_std, hours)
    return time, {"level": level, "temperature": temperature}, value + std * rng.standard_normal(n), std


def test_whitening_is_that_of_the_dense_covariance(validation):
    row = validation(what="regression: whitening", reference="dense Cholesky factor", why="rounding")
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.3, 5, 40))
    noise, columns = rng.uniform(0.5, 2, 40), rng.standard_normal((40, 3))
    white, log_determinant = whiten_columns(columns, noise, 1.7, np.exp(-np.diff(time) / 4.0))
    dense = np.diag(noise**2) + 1.7**2 * np.exp(-np.abs(time[:, None] - time) / 4.0)
    factor = np.linalg.cholesky(dense)
    row.error(white - np.linalg.solve(factor, columns), below=1e-10)
    row.error(log_determinant - 2 * np.sum(np.log(np.diag(factor))), below=1e-10)


def test_standard_errors_cover_as_they_say_where_errors_last(validation):
    """30 campaigns: errors over standard errors have a root mean square of 1 within its own scatter (60 numbers: 9 %,
    three of them), where plain least squares states the temperature's far too small."""
    row = validation(what="regression: errors over stated errors, 30 campaigns whose errors last 12 h", reference="1",
                     why="three of its own standard deviations")
    score, plain = [], []
    for seed in range(30):
        time, x, value, std = case(seed, n=100)
        fit = regress("ln f", value, time, x, std)
        score.append((fit.coefficient - [-0.004, 0.0005]) / fit.std_error)
        table = np.column_stack([np.ones(len(time)), *x.values()])
        coefficient, left, *_ = np.linalg.lstsq(table, value, rcond=None)
        error = np.sqrt(left[0] / (len(time) - 3) * np.linalg.inv(table.T @ table)[2, 2])
        plain.append((coefficient[2] - 0.0005) / error)
    row.between(np.sqrt(np.mean(np.square(score))), 0.73, 1.30)
    assert np.sqrt(np.mean(np.square(plain))) > 1.5


def test_a_response_that_does_not_vary_is_refused():
    """Damping given as one number for all blocks: "100 % explained" by rounding."""
    time, x, value, _ = case(1)
    with pytest.raises(InputError, match=r"it is 0\.01 in all 200 blocks"):
        regress("damping ratio", np.full_like(value, 0.01), time, x)


def test_outliers_are_left_out_and_counted():
    time, x, value, std = case(1)
    clean = regress("ln f", value, time, x, std)
    bad = value.copy()
    bad[::10] += 0.08 * np.random.default_rng(0).choice([-1, 1], len(bad[::10]))
    fit = regress("ln f", bad, time, x, std)
    assert fit.n_outlier == len(bad[::10]) and np.isnan(fit.residual[::10]).all()
    assert np.all(np.abs(fit.coefficient - clean.coefficient) < 2 * clean.std_error)


def test_without_any_influence_none_is_found():
    """p below 0.01 in about one of a hundred: at most four of 60."""
    low = 0
    for seed in range(30):
        time, x, value, std = case(seed, n=100)
        value = value + 0.004 * x["level"] - 0.0005 * x["temperature"]
        low += np.sum(regress("ln f", value, time, x, std).p_value < 0.01)
    assert low <= 4


def test_what_is_missing_constant_or_the_same_is_said():
    time, x, value, _ = case(2)
    known = x["level"].copy()
    known[:20] = np.nan
    rare = np.where(np.arange(len(time)) < 150, np.nan, x["level"])
    x = {"level": known, "temperature": x["temperature"], "rare": rare, "still": np.full(len(time), 3.0),
         "kelvin": x["temperature"] + 273.15,
         "twin": x["temperature"] + 0.3 * np.random.default_rng(0).standard_normal(len(time))}
    value = value.copy()
    value[-5:] = np.nan
    fit = regress("ln f", value, time, x, None)
    assert fit.names == ("level", "temperature", "twin") and fit.n_missing == 20
    text = " | ".join(fit.notes)
    assert "rare left out: known in 45 of 195 blocks" in text and "still left out: it does not change" in text
    assert "kelvin left out: a combination of level, temperature" in text
    assert "temperature and twin are indistinguishable" in text and fit.inflation[1] > 10
    # the sum is known all the same
    assert fit.coefficient[1] + fit.coefficient[2] == pytest.approx(0.0005, abs=0.0003)


def test_twins_are_said_once_and_tested_together():
    """What either of two covariates may have done, both together did: alone neither is clear."""
    time, x, value, std = case(6, n=300)
    rng = np.random.default_rng(6)
    twins = {"level": x["level"], "temperature": x["temperature"],
             "twin": x["temperature"] + 0.3 * rng.standard_normal(len(time))}
    # 0.0015 a degree over 3 degrees, beside a slow error of 0.002 that lasts half a day
    fit = regress("ln f", value + 0.001 * (x["temperature"] - 15), time, twins, std)
    ((pair, p),) = fit.joint
    assert pair == ("temperature", "twin") and p < 1e-3
    assert sum("are indistinguishable" in note for note in fit.notes) == 1
    # of an effect that is not there the two together say so too
    none = regress("ln f", value - 0.0005 * (x["temperature"] - 15), time, twins, std)
    assert none.joint[0][1] > 1e-3



def test_too_few_blocks_and_times_that_do_not_rise_are_refused():
    time, x, value, std = case(3)
    with pytest.raises(InputError, match="9 blocks have the mode and level, temperature; 3 coefficients need"):
        regress("ln f", value[:9], time[:9], {k: v[:9] for k, v in x.items()}, std[:9])
    with pytest.raises(InputError, match="times do not rise"):
        regress("ln f", value, time[::-1], x, std)


def modal_data(n=80, seed=0) -> ModalData:
    """Mode 2 follows the level by -0.3 % a metre; mode 1 nothing; mode 3 was never measured."""
    rng = np.random.default_rng(seed)
    sets = []
    for k in range(n):
        start = pd.Timestamp("2019-06-03T10:00Z") + pd.Timedelta(minutes=30 * k)
        level = float(np.sin(2 * np.pi * k / 25))
        f = np.array([0.3, 1.9 * (1 - 0.003 * level), np.nan]) * (1 + 0.001 * rng.standard_normal(3))
        damping = np.where(np.isnan(f), np.nan, 0.01 + 0.002 * rng.standard_normal(3))
        sets.append(ModalSet(
            id=start.strftime("%Y-%m-%dT%H:%MZ"), frequency_hz=f, damping_ratio=damping,
            frequency_std_hz=np.array([3e-4, 1.9e-3, np.nan]), shape=np.ones((2, 3)), shape_std=np.full((2, 3), np.nan),
            environment={"water_level_m": level, "wind_speed_mps": 8 + float(rng.standard_normal()),
                         "state": "rated" if k % 4 == 0 else "idling"},
        ))
    return ModalData(channels=("a", "b"), sets=tuple(sets), labels=("FA1", "FA2", "T1"))


def test_every_mode_of_a_campaign_and_its_table(tmp_path):
    data = modal_data()
    result = regress_modes(data)
    level = result.table[(result.table["mode"] == "FA2") & (result.table["covariate"] == "water_level_m")]
    level = level[level["response"] == "ln frequency"].iloc[0]
    assert abs(level["coefficient"] + 0.003) < 4 * level["std_error"] and level["p_value"] < 1e-6
    assert set(result.fits) == {"FA1", "FA2"} and any(note.startswith("T1: regression of") for note in result.notes)
    assert any("rotor_speed_rpm left out: known in 0 of 80" in note for note in result.notes)
    assert "FA2, ln frequency: water_level_m -0.0" in result.summary
    # identification's own standard deviations are about right here, and the factor on them says so
    assert result.fits["FA2"][0].noise_factor == pytest.approx(1.0, abs=0.3)
    written = pd.read_csv(result.write(tmp_path / "regression.csv"))
    assert len(written) == len(result.table) == 2 * 2 * 3
    idling = regress_modes(data, state="idling")
    assert idling.fits["FA2"][0].n == 60
    with pytest.raises(InputError, match="no usable block in state 'parked'"):
        regress_modes(data, state="parked")


def test_residuals_are_drawn_over_time_and_what_changed(tmp_path):
    from probupdate.cli import main
    from probupdate.modal.modes import write_modes
    from probupdate.reporting.figures_regression import residuals

    data = modal_data()
    write_modes(data, tmp_path / "modes.json")
    words = ["regress", str(tmp_path / "modes.json"), "--out", str(tmp_path / "r.csv"), "--figures"]
    assert main([*words, str(tmp_path / "pictures")]) == 0
    assert sorted(p.name for p in (tmp_path / "pictures").iterdir()) == [
        f"residual_{label}_{what}.png" for label in ("FA1", "FA2") for what in ("damping_ratio", "ln_frequency")]
    result = regress_modes(data)
    fit = result.fits["FA2"][0]
    axes = residuals("FA2", fit, result.hours, dict(result.columns)).axes
    # over time, wind and water level; the rotor's speed is known of no block
    assert [a.get_xlabel() for a in axes] == ["hours from the first block", "wind_speed_mps", "water_level_m"]
    drawn = axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(drawn, 100 * fit.residual[np.isfinite(fit.residual)])


@pytest.mark.parametrize("name", ["", "NaT", "2007"])
def test_a_set_that_no_time_names_is_refused_by_its_name(name):
    """Of an empty name the time was none, and of a number a year."""
    data = modal_data(20)
    data = replace(data, sets=(*data.sets[:7], replace(data.sets[7], id=name), *data.sets[8:]))
    with pytest.raises(InputError, match=f"such as '{name}' are not named by a time"):
        regress_modes(data)
