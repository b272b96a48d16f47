"""What remains after a fit: its stated standard deviations against a dense covariance and drawn records; what is
shown."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import probupdate
from probupdate.diagnosis.adequacy import Residual, free_directions, slope_share
from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.residuals import residuals, whiten
from probupdate.diagnosis.splitting import distinguishing_z
from probupdate.diagnosis.time_profiles import TimeProfile, step_profile
from probupdate.modal.modes import Sensor
from probupdate.reporting import figures, report

N_BLOCK, SIZES, HELD = 14, (5, 4), [0, 1, 3]


@pytest.fixture(scope="module")
def design():
    """Three nuisances, of which two are fitted; one named effect with a step, whose signature is uncertain."""
    rng = np.random.default_rng(8)
    covariances = [a @ a.T + np.eye(m) for m in SIZES for a in [rng.standard_normal((m, m))]]
    weights = [rng.uniform(0.5, 2.0, N_BLOCK) for _ in SIZES]
    weights[0][3] = 0.0
    noise = Noise(covariance=tuple(covariances), precision=tuple(np.linalg.inv(c) for c in covariances),
                  weight=tuple(weights))
    time_profiles = (TimeProfile(kind="constant", value=np.ones(N_BLOCK)), step_profile(N_BLOCK, 5))
    return Design(
        bin_of=rng.integers(0, 2, N_BLOCK), nuisance=tuple(rng.standard_normal((2, m, 3)) for m in SIZES),
        nuisance_std=np.array([0.7, 1.0, 1.5]), discrepancy_std=tuple(np.full(m, 0.4) for m in SIZES),
        effect=tuple(rng.standard_normal((2, m, 2)) for m in SIZES), time_profiles=time_profiles,
        which=np.array([(j, c) for j in range(2) for c in range(2)]), noise=noise,
        included=((1, step_profile(N_BLOCK, 7), 0.9),),
        model_errors=((step_profile(N_BLOCK, 7), tuple(rng.uniform(0.1, 0.6, (2, m)) for m in SIZES)),),
    )


def fitted(design, residuals) -> Residual:
    """The residual after the best values of the unknowns HELD are taken off."""
    solved = design.unknowns(residuals)
    chosen = np.zeros_like(solved)
    chosen[HELD] = solved[HELD]
    left = tuple(np.where(w[:, None] > 0, y - m, 0.0) for y, m, w in
                 zip(residuals, design.expected_residuals(chosen), design.noise.weight, strict=True))
    return Residual(design=design, left=left, held=np.array(HELD), held_cov=design.unknowns_cov(HELD))


def shares(r: Residual, q: int):
    time_profile = slope_share(r, q, np.sin(np.arange(N_BLOCK)))
    return {"mean": r.mean_share(q), "slope": time_profile}


def test_deviations_are_those_of_the_covariance_written_out(design, validation):
    """cov(r) = W V^-1 W, both dense: V of all that is measured, W the same without what was fitted."""
    row = validation(what="means and slopes of residuals: covariance, standard deviations, covariance between groups",
                     reference="W V^-1 W written out", why="rounding, of each and of a tenth at least")
    rows = [(q, b, i) for q, m in enumerate(SIZES) for b in np.flatnonzero(design.noise.weight[q]) for i in range(m)]
    unknown = np.eye(design.n_unknown)
    G = np.array([[y[q][b, i] for q, b, i in rows] for y in map(design.expected_residuals, unknown)]).T
    noise = np.array([[design.noise.covariance[q][i, j] / design.noise.weight[q][b] if (p, c) == (q, b) else 0.0
                       for p, c, j in rows] for q, b, i in rows])
    others = np.setdiff1d(np.arange(design.n_unknown), HELD)
    S = design.prior_std**2
    W = noise + (G[:, others] * S[others]) @ G[:, others].T
    V = W + (G[:, HELD] * S[HELD]) @ G[:, HELD].T
    exact = W @ np.linalg.solve(V, W)
    r = fitted(design, design.simulate(np.random.default_rng(0)))
    for q, m in enumerate(SIZES):
        for share in shares(r, q).values():
            pick = np.zeros((m, len(rows)))
            for k, (p, b, i) in enumerate(rows):
                if p == q:
                    pick[i, k] = share[b]
            expected = pick @ exact @ pick.T
            found = r.spread_between(q, share, q, share) + r.own_noise(q, share)
            row.error((found - expected) / np.maximum(np.abs(expected), 0.1), 1e-9, "covariance")
            row.error(r.share_mean(q, share)[1] / np.sqrt(np.diag(expected)) - 1, 1e-9, "standard deviations")
    mean, covariance = r.means
    first = np.zeros((SIZES[0], len(rows)))
    second = np.zeros((SIZES[1], len(rows)))
    for k, (p, b, i) in enumerate(rows):
        (first, second)[p][i, k] = r.mean_share(p)[b]
    between = first @ exact @ second.T
    row.error((covariance[: SIZES[0], SIZES[0] :] - between) / np.maximum(np.abs(between), 0.1), 1e-9, "between groups")
    assert mean.shape == (sum(SIZES),)


def test_standardised_remainders_of_drawn_records_are_standard_normal(design, validation):
    row = validation(what="standardised means and slopes of residuals, 400 drawn records: variance, mean; "
                          "Kolmogorov-Smirnov's p", reference="standard normal", why="18 of them",
                     unit="standard errors")
    rng = np.random.default_rng(2)
    z = []
    for _ in range(400):
        r = fitted(design, design.simulate(rng))
        z.append(np.concatenate([np.divide(*r.share_mean(q, s)) for q in range(2) for s in shares(r, q).values()]))
    z = np.array(z)
    # 400 draws: a variance is known to 7 %, 18 of them
    row.error((np.mean(z**2, axis=0) - 1) / np.sqrt(2 / 400), 4, "variance")
    row.error(z.mean(axis=0) * np.sqrt(400), 4, "mean")
    row.least(stats.kstest(z[:, 0], "norm").pvalue, 1e-3, "p")


def test_directions_that_an_alignment_takes_away_are_left_out():
    rng = np.random.default_rng(4)
    target = rng.standard_normal((6, 2)) + 0.1j * rng.standard_normal((6, 2))
    free = free_directions(target, 3)
    # k^2 complex numbers of a group of k modes
    assert free.shape == (3 + 24, 3 + 24 - 8)
    change = 1e-6 * (rng.standard_normal((6, 2)) + 1j * rng.standard_normal((6, 2)))
    measured = (target + change) @ rng.standard_normal((2, 2))
    projected = measured @ np.linalg.pinv(measured) @ target - target
    flat = projected.T.ravel()
    row = np.concatenate([np.zeros(3), flat.real, flat.imag])
    assert np.linalg.norm(row - free @ (free.T @ row)) < 1e-4 * np.linalg.norm(row)


def test_whitening_leaves_out_what_rounding_fills():
    rng = np.random.default_rng(6)
    columns = rng.standard_normal((5, 3)) * np.array([[1e-3], [1.0], [10.0], [1.0], [1e-2]])
    drawn = columns @ rng.standard_normal((3, 20000))
    white = whiten(columns @ columns.T, drawn)
    assert white.shape == (3, 20000) and np.cov(white) == pytest.approx(np.eye(3), abs=0.05)


@pytest.fixture(scope="module")
def prepared(frame_file):
    return prepare(frame_file)


def placed():
    return tuple(
        Sensor(channel=f"{axis}{k}", level=f"storey {k}", position_m=(0.0, 0.0, 3.0 * k),
               direction=(1.0, 0.0, 0.0) if axis == "x" else (0.0, 1.0, 0.0), quantity="acceleration", unit="m/s2")
        for k in range(1, 6) for axis in "xy"
    )


def test_a_wrong_gain_stands_out_before_and_is_gone_after(prepared, record):
    found = residuals(examine(prepared, record(5, gain=("y4", 1.12))), placed())
    assert found["states"] == ["before", "after"]
    z = {(row["mode"], c): (row["z"][0][k], row["z"][1][k]) for row in found["channels"]
         if row["part"] == "in phase" for k, c in enumerate(row["channels"])}
    worst = max(z, key=lambda key: abs(z[key][0]))
    assert worst[1] == "y4" and abs(z[worst][0]) > 4 and abs(z[worst][1]) < 3
    gains = next(r for r in found["measurement"] if r["cause"] == "sensor gain" and r["time_profile"] == "constant")
    assert gains["location"] == "y4" and gains["tried"] == 10
    # a month's worth of blocks may be ten times as many; numbers only, no NaN
    assert len(json.dumps(found, allow_nan=False)) < 100_000


def test_the_axes_of_a_pair_have_different_names(prepared, record):
    outcome = examine(prepared, record(4))
    for direction, names in (((0.0, 0.0, 1.0), {"along 0 deg", "vertical"}), ((1.0, 0.0, 0.0), {"axis 1", "axis 2"})):
        sensors = [replace(s, direction=direction) if s.channel.startswith("y") else s for s in placed()]
        series = residuals(outcome, sensors)["time"]["series"]
        assert {n for n in names for s in series if n in s["name"]} == names


def test_a_step_shows_along_the_record_and_with_no_covariate(prepared, record):
    found = residuals(examine(prepared, record(4, storey=2, factor=0.9, from_block=20)), placed())
    names = [s["name"] for s in found["time"]["series"]]
    assert any("along 0 deg" in n for n in names) and any("along 90 deg" in n for n in names)
    step = []
    for series in found["time"]["series"]:
        if not np.isfinite(series["moved_z"] or np.nan):
            before, after = (np.array(p, float) for p in series["percent"])
            step.append([before[20:].mean() - before[:20].mean(), after[20:].mean() - after[:20].mean()])
    step = np.abs(step)
    # 10 % of one of five storeys: some frequency falls by more than half a per cent; 0.1 % of noise, 20 blocks a side
    assert step[:, 0].max() > 0.5 and step[:, 1].max() < 4 * 0.1 * np.sqrt(2 / 20)
    (size,) = found["time"]["sizes"]
    found_here, time_profile = np.array(size["size"]), np.array(size["time_profile"])
    # each block's own size: none before, 0.1 after; 0.1 % of noise in frequencies shows a storey's 10 % well
    assert found_here[20:].mean() - found_here[:20].mean() == pytest.approx(-0.1, abs=0.015)
    assert time_profile[0] == 0 and time_profile[-1] == pytest.approx(-0.1, abs=0.01) and np.std(found_here
                                                                                                 - time_profile) < 0.02
    (tide,) = found["covariates"]
    assert tide["column"] == "water_level_m" and sum(tide["blocks"]) == 40


def test_the_page_of_a_diagnosis_alone_holds_it(prepared, record, tmp_path, monkeypatch):
    # built, but not written out
    monkeypatch.setattr(figures, "svg_text", lambda figure, prefix: f'<svg id="{prefix}-"></svg>')
    outcome = examine(prepared, record(4, storey=2, factor=0.9, from_block=20))
    found = replace(outcome.diagnosis, details={"residuals": residuals(outcome, placed())})
    found.write(tmp_path / "diagnosis.json")
    page = report(tmp_path, tmp_path / "report.html").read_text()
    for id in ("causes", "moderest", "restmap", "restplace", "calendar", "covariates", "prior_shift",
               "detectable_sizes"):
        assert f'id="{id}-' in page
    assert "Fault identified" in page and "parameter k3" in page
    # what the directory lacks is named once, not section by section
    assert 'id="posterior"' not in page and "posterior.nc" in page


def test_bands_of_a_record_with_nothing_wrong_hold_what_they_say(prepared, record, validation):
    row = validation(what="90 % band of single blocks, frame with nothing hidden: share; p of the means, of the "
                          "parameters; p of the means with a gain of 1.3 that is left out",
                     reference="95 % range of a binomial share; uniform",
                     why="2 % for noise estimated from the same blocks")
    outcome = examine(prepared, record(2))
    assert outcome.fitted.included == () and outcome.diagnosis.verdict == "none"
    found = residuals(outcome)
    assert found["states"] == ["before"] and found["sensors"] == []
    (bands,) = found["bands"]
    low, high = bands["blocks"]["within_90_expected"]
    # noise is estimated from the blocks themselves, and is what was drawn: the two bands hold their shares
    row.between(bands["blocks"]["within_90"], low - 0.02, high + 0.02, "share")
    # the floor is wider than what this record's model gets wrong, never narrower
    assert bands["means"]["within_90"] >= bands["means"]["within_90_expected"][0]
    row.least(bands["means"]["p"], 1e-3, "means")
    row.least(found["prior_shift"]["p_together"][0], 1e-3, "parameters")
    # by how much the data would shift a parameter: of its prior variance what they take away
    width = np.sqrt(np.diag(outcome.fitted.design.unknowns_cov(range(len(outcome.problem.updated))))) / [
        p.std for p in outcome.problem.prior.items]
    shift = [one["expected"][0] for one in found["prior_shift"]["parameters"]]
    assert shift == pytest.approx(np.sqrt(1 - width**2), abs=5e-4)
    # the discrepancy allowed for makes the p of the means large; a gain that is left out of the fit it does see
    (left,) = residuals(examine(prepared, record(2, gain=("y4", 1.3)), most=0))["bands"]
    row.error(left["means"]["p"], 1e-3, "means with a gain")


def test_twins_are_told_to_be_alike_and_what_would_split_them(frame_file, record, validation):
    """A group that is one parameter by another name cannot be distinguished from it; a neighbour could."""
    row = validation(what="size in z at which causes of score correlation 0.8 and 0.95 are distinguished",
                     reference="5.2 and 10.4, power of a likelihood ratio", why="digits", unit="of z")
    prepared = prepare(frame_file, groups={"second storey": {"k2": 0.1}})
    found = probupdate.diagnose(prepared, record(9, storey=1, factor=0.93, from_block=18), extend=False)
    assert found.verdict == "ambiguous"
    (sentence, *_) = found.splits
    assert "parameter k2" in sentence and "group of parameters, second storey" in sentence
    assert "no record of these modes" in sentence
    row.error([distinguishing_z(0.8) - 5.2, distinguishing_z(0.95) - 10.4], 0.05)
    # evidence divided by 1 + (0.1 z)^2 / 4: z^2 = 10.4^2 (1 + z^2 / 400), and never more than 20 of noise alone
    assert distinguishing_z(0.95, 0.1) == pytest.approx(10.4 / np.sqrt(1 - 10.4**2 / 400), rel=1e-3)
    assert np.isinf(distinguishing_z(0.99, 0.1))
    assert "to split them:" in found.summary
    assert (f"threshold |z| = {found.threshold:.1f} of the whole catalogue, before any finding is included (2 % of "
            "false alarms); ") in found.summary
