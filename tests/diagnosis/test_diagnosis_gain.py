"""The gain on held-out blocks: densities written out, its size, its calibration, and that a wrong effect has none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from probupdate.diagnosis import gain
from probupdate.diagnosis.expected import residuals_at
from probupdate.diagnosis.fitting import centred_residuals, design_at, fit
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.prediction import carried_unknowns, crps, predict
from probupdate.diagnosis.time_profiles import TimeProfile, step_profile

N_BLOCK, N_EFFECT, N_NUISANCE = 60, 3, 3
SIZES = (5, 4)


def make_design(seed=3, included=(), n_block=N_BLOCK, discrepancy_std=0.3, model_errors=(), noise=1.0):
    rng = np.random.default_rng(seed)
    bin_of = rng.integers(0, 2, n_block)
    covariances = [noise**2 * (a @ a.T / m + np.eye(m)) for m in SIZES for a in [rng.standard_normal((m, m))]]
    weights = [rng.uniform(0.5, 2.0, n_block) for _ in SIZES]
    weights[1][4] = 0.0
    noises = Noise(covariance=tuple(covariances), precision=tuple(np.linalg.inv(c) for c in covariances),
                  weight=tuple(weights))
    nuisance = tuple(rng.standard_normal((2, m, N_NUISANCE)) for m in SIZES)
    effect = tuple(rng.standard_normal((2, m, N_EFFECT)) for m in SIZES)
    return Design(
        bin_of=bin_of, nuisance=nuisance, nuisance_std=np.array([0.5, 1.0, 2.0]),
        discrepancy_std=tuple(np.full(m, discrepancy_std) for m in SIZES), effect=effect,
        time_profiles=(TimeProfile(kind="constant", value=np.ones(n_block)),), which=np.zeros((0, 2), int),
                  noise=noises,
        included=tuple(included), model_errors=tuple(model_errors),
    )


def dense(design, rows):
    """X (n, n_unknown), R (n, n) of the measured numbers of blocks `rows`, and which (group, position) each one is."""
    X, R, places = [], [], []
    for q, m in enumerate(SIZES):
        for at, b in enumerate(rows):
            w = design.noise.weight[q][b]
            if w == 0:
                continue
            g, first = design.bin_of[b], design.n_common + sum(SIZES[:q])
            full = np.zeros((m, design.n_unknown))
            full[:, :N_NUISANCE] = design.nuisance[q][g]
            for k, (effect, profile, _) in enumerate(design.included):
                full[:, N_NUISANCE + k] = profile.value[b] * design.effect[q][g][:, effect]
            full[:, first : first + m] = np.eye(m)
            for k, (profile, spread) in enumerate(design.model_errors, start=1):
                at_error = first + k * sum(SIZES)
                full[:, at_error : at_error + m] = profile.value[b] * np.diag(spread[q][g])
            X.append(full)
            R.append(design.noise.covariance[q] / w)
            places.append((q, at))
    n = sum(len(r) for r in R)
    block = np.zeros((n, n))
    start = 0
    for r in R:
        block[start : start + len(r), start : start + len(r)] = r
        start += len(r)
    return np.concatenate(X), block, places


def stacked(y, places):
    return np.concatenate([y[q][at] for q, at in places])


def test_predictive_density_is_that_of_the_written_out_joint_normal(validation):
    """Route two knows no Woodbury and no posterior: training and held-out numbers are one normal vector, the held-out
    ones with an offset that has nothing to do with the training's share of what predicts them."""
    row = validation(what="held-out blocks, steps and covariates included: log density, residuals, standard "
                          "deviations, squared distance", reference="the joint normal written out", why="rounding")
    included = ((1, step_profile(N_BLOCK, 25), 0.8), (2, TimeProfile(kind="covariate", value=np.sin(np.arange(N_BLOCK)),
                                                           column="water_level_m"), 0.4))
    error_scale = tuple(np.random.default_rng(7).uniform(0.1, 0.3, (2, m)) for m in SIZES)
    design = make_design(included=included, model_errors=((included[0][1], error_scale),))
    y = design.simulate(np.random.default_rng(8))
    held = gain.folds(N_BLOCK) == 1
    found = predict(design, y, held)
    train, test = np.flatnonzero(~held), np.flatnonzero(held)
    Xt, Rt, places_t = dense(design, train)
    Xh, Rh, places_h = dense(design, test)
    S = np.diag(design.prior_std**2)
    V = Xt @ S @ Xt.T + Rt
    offset = np.arange(design.n_unknown) >= design.n_common
    common = np.where(offset, 0.0, 1.0)
    operator = S @ Xt.T @ np.linalg.inv(V)
    mean = common * (operator @ stacked([v[train] for v in y], places_t))
    residual = stacked([v[test] for v in y], places_h) - Xh @ mean
    # u - (common part of its estimate): exact covariance over all records of this design
    left = np.eye(design.n_unknown) - common[:, None] * (operator @ Xt)
    Q = left @ S @ left.T + (common[:, None] * operator) @ Rt @ (common[:, None] * operator).T
    C = Xh @ Q @ Xh.T + Rh
    density = stats.multivariate_normal(np.zeros(len(C)), C, allow_singular=False).logpdf(residual)
    row.error(found.log_density / density - 1, 1e-9, "log density")
    row.error(stacked(found.residual, places_h) - residual, 1e-9, "residuals")
    row.error(stacked(found.std, places_h) / np.sqrt(np.diag(C)) - 1, 1e-9, "standard deviations")
    row.error(found.squared / (residual @ np.linalg.solve(C, residual)) - 1, 1e-9, "squared distance")


def test_held_out_blocks_are_where_they_are_expected_when_nothing_is_wrong(validation):
    """The squared distance of a held-out fold is chi-square; 60 records, each predicted once from the rest."""
    row = validation(what="squared distance of held-out folds, nothing wrong, 60 records: Kolmogorov-Smirnov's p",
                     reference="chi-square")
    design = make_design(n_block=30)
    rng = np.random.default_rng(9)
    held = gain.folds(30) == 2
    u = []
    for _ in range(60):
        found = predict(design, design.simulate(rng), held)
        u.append(stats.chi2.cdf(found.squared, found.n_number))
    # uniform: the Kolmogorov-Smirnov distance stays under its 0.1 % point
    row.least(stats.kstest(u, "uniform").pvalue, 1e-3)


def shifted(design, time_profile, rng):
    """A record of the design in which its first effect has the size `time_profile` (n_block,)."""
    return [np.where(w[:, None] > 0, y + time_profile[:, None] * effect[design.bin_of, :, 0], 0.0)
            for y, effect, w in zip(design.simulate(rng), design.effect, design.noise.weight, strict=True)]


@pytest.mark.parametrize("snr", [6.0, 12.0])
def test_gain_of_a_true_step_is_about_half_its_squared_snr(snr, validation):
    """log score: d^2 / 2 +- d for an effect of SNR d, d given by the design alone."""
    row = validation(what="gain in nat of a step of signal-to-noise ratio d = 6 and 12, mean of eight records; in its "
                          "standard errors; scatter between records over its standard error",
                     reference="d^2 / 2 = 18 and 72; d / 2 = 3 and 6; one",
                     why="3.3 standard errors of the mean and 10 %; chi-square's 99.9 %")
    time_profile = step_profile(N_BLOCK, 30)
    plain = make_design()
    rng = np.random.default_rng(10)
    trial = make_design(included=((0, time_profile, 1.0),))
    d_unit = 1 / np.sqrt(trial.unknowns_cov([N_NUISANCE])[0, 0] ** -1 - 1.0) ** -1
    size = snr / d_unit
    extended = make_design(included=((0, time_profile, size),))
    gains, errors = [], []
    for _ in range(8):
        y = shifted(plain, size * time_profile.value, rng)
        found = gain.contest((plain, y), (extended, y))
        gains.append(found.elpd)
        errors.append(found.elpd_se)
    # mean of eight, each with standard deviation d; what four fifths of the record leave unsure of the size costs a
    # little more
    expected = snr**2 / 2
    within = 3.3 * snr / np.sqrt(8) + 0.1 * expected
    row.between(np.mean(gains), expected - within, expected + within, f"gain, {snr:g}")
    # d / 2 standard errors
    within = 1.2 + 0.1 * snr
    row.between(np.mean(np.array(gains) / np.array(errors)), snr / 2 - within, snr / 2 + within,
                f"standard errors, {snr:g}")
    # the stated error is that of the scatter between records: chi-square of 7 degrees of freedom, 99.9 %
    row.between(np.std(gains, ddof=1) / np.mean(errors), 0.2, 1.9, "scatter")


@pytest.mark.parametrize("noise", [1.0, 0.02])
def test_gain_of_a_true_constant_is_about_half_its_squared_snr(noise, validation):
    """However small the noise is beside the offset that hides it: 0.02 is a hundredth of the offset. What a
    prediction from four fifths of the record misses of the whole record's is then many times the noise."""
    row = validation(what="gain in nat of a constant of signal-to-noise ratio d = 8, noise as large as the residual "
                          "and a hundredth of it, mean of twelve records; scatter between records over its standard "
                          "error; median standard error", reference="d^2 / 2 = 32; one; d = 8",
                     why="3.3 standard errors of the mean and 10 %; chi-square's 99.9 %; half of d")
    plain, snr = make_design(noise=noise), 8.0
    constant = TimeProfile(kind="constant", value=np.ones(N_BLOCK))
    trial = make_design(included=((0, constant, 1.0),), noise=noise)
    size = snr * np.sqrt(1 / (1 / trial.unknowns_cov([N_NUISANCE])[0, 0] - 1.0))
    extended, rng = make_design(included=((0, constant, size),), noise=noise), np.random.default_rng(13)
    found = []
    for _ in range(12):
        y = shifted(plain, size * constant.value, rng)
        found.append(gain.contest((plain, y), (extended, y)))
    gains, errors = np.array([c.elpd for c in found]), np.array([c.elpd_se for c in found])
    within = 3.3 * snr / np.sqrt(12) + 0.1 * snr**2 / 2
    row.between(gains.mean(), snr**2 / 2 - within, snr**2 / 2 + within, "gain")
    # chi-square of 11 degrees of freedom, 99.9 %
    row.between(np.std(gains, ddof=1) / errors.mean(), 0.4, 1.7, "scatter")
    # the larger of two, one of which is estimated from eight batches alone
    row.between(np.median(errors), 0.5 * snr, 1.5 * snr, "standard error")


def test_gain_where_one_stretch_alone_tells_an_unknown(validation):
    """A tolerance that shows at one heading, which the nacelle had in the first fold only: left out, that fold is
    predicted far worse than the rest, which must not make what all share less than nothing."""
    row = validation(what="where one fold alone informs an unknown: least eigenvalue of covariances over the prior's; "
                          "gain in nat of a constant of signal-to-noise ratio d = 8, mean of twelve records; scatter "
                          "between records over its standard error", reference="zero; d^2 / 2 = 32; one or less",
                     why="rounding; 3.3 standard errors of the mean and 10 %; chi-square's 99.9 %")
    snr, rng = 8.0, np.random.default_rng(14)
    constant = TimeProfile(kind="constant", value=np.ones(N_BLOCK))

    def only_once(included=()):
        design = make_design(included=included, noise=0.02)
        nuisance = tuple(a.copy() for a in design.nuisance)
        for a in nuisance:
            a[0, :, 2] = 0.0
        return replace(design, bin_of=(np.arange(N_BLOCK) < N_BLOCK // gain.N_FOLD).astype(int), nuisance=nuisance)

    plain, trial = only_once(), only_once(((0, constant, 1.0),))
    size = snr * np.sqrt(1 / (1 / trial.unknowns_cov([N_NUISANCE])[0, 0] - 1.0))
    extended, found = only_once(((0, constant, size),)), []
    for _ in range(12):
        y = shifted(plain, size * constant.value, rng)
        found.append(gain.contest((plain, y), (extended, y)))
    fold, prior = gain.folds(N_BLOCK), plain.prior_std
    shared, own = gain.shared_covariance(plain, carried_unknowns(plain, y, np.arange(N_BLOCK))[1],
                               [predict(plain, y, fold == k) for k in range(gain.N_FOLD)])
    for covariance in (shared, *(c for _, c in own)):
        # of numbers of one, as the prior's standard deviations are; without the correct -0.04
        std = prior[: len(covariance)]
        row.least(np.linalg.eigvalsh(covariance / np.outer(std, std))[0], -1e-9, "eigenvalue")
    gains, errors = np.array([c.elpd for c in found]), np.array([c.elpd_se for c in found])
    # as where all folds show the same: half the squared SNR, each with standard deviation SNR
    within = 3.3 * snr / np.sqrt(12) + 0.1 * snr**2 / 2
    row.between(gains.mean(), snr**2 / 2 - within, snr**2 / 2 + within, "gain")
    # chi-square of 11 degrees of freedom, 99.9 %; too large is what it may be, as differences of folds cancel
    row.error(np.std(gains, ddof=1) / errors.mean(), 1.7, "scatter")


def test_a_wrong_effect_gains_nothing(validation):
    """Twenty records with nothing wrong: an effect taken in all the same is significant at most at the rate of its two
    errors."""
    row = validation(what="gain of an effect that is not there, 20 records: not significant", reference="none is there",
                     why="2.3 % each")
    plain, rng = make_design(), np.random.default_rng(11)
    extended = make_design(included=((0, step_profile(N_BLOCK, 20), 1.0),))
    found = [gain.contest((plain, y), (extended, y)) for y in (plain.simulate(rng) for _ in range(20))]
    # an effect that is not there costs, or gains by chance as much as its own error
    assert np.mean([c.elpd for c in found]) < 0.5
    # 2.3 % each: four and more of twenty would be p = 0.001
    row.count(sum(not c.significant for c in found), len(found), 17)


def test_error_of_a_constant_effect_counts_that_all_blocks_share_what_is_unknown():
    """More blocks make nothing surer where an offset common to all of them hides it."""
    short, long = (make_design(n_block=n, discrepancy_std=0.5) for n in (40, 160))
    ratio = []
    for plain in (short, long):
        n = len(plain.bin_of)
        time_profile = TimeProfile(kind="constant", value=np.ones(n))
        extended = make_design(n_block=n, discrepancy_std=0.5, included=((0, time_profile, 2.0),))
        y = shifted(plain, 1.5 * time_profile.value, np.random.default_rng(12))
        found = gain.contest((plain, y), (extended, y))
        ratio.append(found.elpd / found.elpd_se)
    # with independent blocks four times as many would double it
    assert ratio[1] < 1.6 * ratio[0]


def test_each_side_of_a_step_is_told_by_other_stretches():
    class One:
        def __init__(self, at):
            self.time_profile = step_profile(48, at)

    assert gain.count_folds(48, []) == gain.count_folds(48, [One(24)]) == gain.N_FOLD
    for at in (8, 40):
        n = gain.count_folds(48, [One(at)])
        fold = gain.folds(48, n)
        for side in (fold[:at], fold[at:]):
            assert max(np.bincount(side)) <= len(side) / 2 + 1


def test_crps_is_its_integral():
    grid = np.linspace(-12, 12, 200_001)
    for residual, std in ((0.3, 0.8), (-2.0, 1.5)):
        step = (grid >= residual).astype(float)
        integral = np.trapezoid((stats.norm.cdf(grid, 0, std) - step) ** 2, grid)
        assert float(crps(np.array(residual), np.array(std))) == pytest.approx(integral, abs=1e-4)


def test_error_of_a_sum_counts_correlation():
    rng = np.random.default_rng(13)
    white = rng.standard_normal((200, 400))
    slow = np.zeros_like(white)
    slow[:, 0] = white[:, 0]
    for k in range(1, 400):
        slow[:, k] = 0.6 * slow[:, k - 1] + 0.8 * white[:, k]
    for series, variance in ((white, 1.0), (slow, 1.6 / 0.4)):
        stated = np.sqrt(np.mean([gain.batch_error(s) ** 2 for s in series]) / 400)
        # batches of twenty leave out a few per cent of what correlation of length four adds
        assert stated == pytest.approx(np.sqrt(variance), rel=0.1)


def test_a_finding_carries_its_gain(stepped):
    """A storey that loosens by a tenth: what it gains, in the keys that outside readers rely on."""
    prepared, data, outcome = stepped
    (found_here,) = gain.gains(outcome)
    assert found_here["significant"] is True and found_here["heldout_elpd"] > 4 * found_here["heldout_elpd_se"] > 0
    # 10 % of one of five storeys moves frequencies by about 1 %, of which a temperature that nobody recorded may be a
    # part; blocks are good to 0.1 %
    assert found_here["max_frequency_error_after"] < 0.002 < 0.0025 < found_here["max_frequency_error_before"]
    assert found_here["crps_frequency_after"] < found_here["crps_frequency_before"]
    assert found_here["min_mac_after"] > 0.999
    assert "predicted better" in found_here["statement"]


def test_predictions_of_a_model_fitted_to_the_other_blocks_are_those_of_the_linear_way(stepped, validation):
    """The plain way: from where nothing is known the model is fitted to the other blocks alone, and the held-out ones
    are predicted from there; frequencies of every fold."""
    row = validation(what="held-out frequencies by linear conditioning, five folds: error over how far a fit moves "
                          "them and a fifth of what a fold's mean is known to",
                     reference="the model fitted again to the other blocks from where nothing is known",
                     why="both linearise, at places that differ by that")
    outcome = stepped[2]
    problem, fitted = outcome.problem, outcome.fitted
    noise, (one,) = fitted.design.noise, fitted.included
    for number in range(gain.N_FOLD):
        held = gain.folds(len(problem.blocks)) == number
        linear = predict(gain.with_noise(fitted.design, noise), fitted.centred, held)
        train = np.flatnonzero(~held)
        cut = replace(one, size=0.5 * one.size,
                      time_profile=replace(one.time_profile, value=one.time_profile.value[train]))
        less = replace(problem.select_blocks(train), which=np.zeros((0, 2), int),
                       time_profiles=(TimeProfile(kind="constant", value=np.ones(len(train))),))
        again = fit(less, problem.prior.initial, (cut,))
        # it came all the way, and not to the very place
        assert again.settled and abs(again.included[0].size - cut.size) > 0.3 * abs(one.size)
        assert not np.array_equal(again.theta, fitted.theta)
        included = (replace(one, size=again.included[0].size),)
        design = design_at(problem, again.theta, included, noise)
        seen = residuals_at(problem, again.theta, included)
        refitted = predict(gain.with_noise(design, noise),
                           centred_residuals(problem, design, again.theta, included, seen), held)
        for q in range(len(seen)):
            # what is predicted: frequencies seen there less what is left of them
            known = seen[q][held].mean(axis=0)[:3] - fitted.residuals[q][held].mean(axis=0)[:3]
            difference = (refitted.residual[q] - linear.residual[q]).mean(axis=0)[:3]
            # the two linearise at places that differ by `known`: a tenth of it, and a fiftieth of what the mean of
            # eight blocks of 0.1 % is known to
            row.error(difference / (np.abs(known).max() + 0.2 * 1e-3 / np.sqrt(8)), 0.1)
