"""The scores of all candidates against the same test with the covariance written out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from probupdate.diagnosis import diagnose, linear, wording
from probupdate.diagnosis.arrow import ArrowFactor
from probupdate.diagnosis.evidence import ERROR_SCALES, error_scale_mean, linear_evidence
from probupdate.diagnosis.fitting import driver_profiles
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import Noise, estimate_noise
from probupdate.diagnosis.results import Diagnosis, Finding
from probupdate.diagnosis.search import conditional_scores, model_error_dispersion
from probupdate.diagnosis.time_profiles import TimeProfile, step_profile

N_BLOCK, N_EFFECT, N_NUISANCE = 12, 4, 3
SIZES = (5, 4)


@pytest.fixture(scope="module")
def design():
    rng = np.random.default_rng(3)
    bin_of = rng.integers(0, 2, N_BLOCK)
    covariances = [a @ a.T + np.eye(m) for m in SIZES for a in [rng.standard_normal((m, m))]]
    weights = [rng.uniform(0.5, 2.0, N_BLOCK) for _ in SIZES]
    weights[1][4] = 0.0
    noise = Noise(covariance=tuple(covariances), precision=tuple(np.linalg.inv(c) for c in covariances),
                  weight=tuple(weights))
    time_profiles = (TimeProfile(kind="constant", value=np.ones(N_BLOCK)), step_profile(N_BLOCK, 5),
                     TimeProfile(kind="covariate", value=rng.standard_normal(N_BLOCK), column="water_level_m"))
    which = np.array([(j, c) for j in range(N_EFFECT) for c in range(3)])
    return Design(
        bin_of=bin_of, nuisance=tuple(rng.standard_normal((2, m, N_NUISANCE)) for m in SIZES),
        nuisance_std=np.array([0.5, 1.0, 2.0]), discrepancy_std=tuple(np.full(m, 0.3) for m in SIZES),
        effect=tuple(rng.standard_normal((2, m, N_EFFECT)) for m in SIZES), time_profiles=time_profiles, which=which,
                  noise=noise,
        included=((1, step_profile(N_BLOCK, 7), 0.8),),
        model_errors=((step_profile(N_BLOCK, 7), tuple(rng.uniform(0.1, 0.6, (2, m)) for m in SIZES)),),
    )


def dense(design):
    """X (n, n_candidate), V (n, n) over all measured numbers, and how residuals are laid out."""
    columns, blocks, owners = [], [], []
    for q, m in enumerate(SIZES):
        weight = design.noise.weight[q]
        for b in np.flatnonzero(weight):
            blocks.append(design.noise.covariance[q] / weight[b])
            owners.append((q, b, m))
    n = sum(m for _, _, m in owners)
    V = np.zeros((n, n))
    starts = np.concatenate([[0], np.cumsum([m for _, _, m in owners])])
    for (_, _, m), at, block in zip(owners, starts[:-1], blocks, strict=True):
        V[at : at + m, at : at + m] = block

    def stacked(of):
        return np.concatenate([of(q, b) for q, b, _ in owners])

    for k, std in enumerate(design.nuisance_std):
        columns.append(std * stacked(lambda q, b, k=k: design.nuisance[q][design.bin_of[b], :, k]))
    for effect, time_profile, std in design.included:
        columns.append(std * stacked(
            lambda q, b, e=effect, c=time_profile: c.value[b] * design.effect[q][design.bin_of[b], :, e]))
    for q, m in enumerate(SIZES):
        for r in range(m):
            columns.append(design.discrepancy_std[q][r] * stacked(
                lambda p, b, q=q, r=r: (np.arange(SIZES[p]) == r) * float(p == q)))
    for time_profile, spread in design.model_errors:
        for q, m in enumerate(SIZES):
            for r in range(m):
                def one(p, b, q=q, r=r, c=time_profile, s=spread):
                    here = (np.arange(SIZES[p]) == r) * float(p == q)
                    return design.error_scale * c.value[b] * here * s[q][design.bin_of[b], r]

                columns.append(stacked(one))
    low_rank = np.column_stack(columns)
    V += low_rank @ low_rank.T
    X = []
    for j, c in design.which:
        time_profile = design.time_profiles[c]

        def one(q, b, j=j, time_profile=time_profile):
            weight = design.noise.weight[q]
            mean = 0.0 if time_profile.kind == "constant" else np.average(time_profile.value, weights=weight)
            return (time_profile.value[b] - mean) * design.effect[q][design.bin_of[b], :, j]

        X.append(stacked(one))
    return np.column_stack(X), V, stacked


def test_scores_information_and_likeness_are_those_of_the_written_out_covariance(design, validation):
    row = validation(what="scores, information, score correlation of all candidates",
                     reference="the covariance written out", why="rounding")
    X, V, stacked = dense(design)
    rng = np.random.default_rng(4)
    y = [np.where(design.noise.weight[q][:, None] > 0, rng.standard_normal((N_BLOCK, m)), 0.0)
         for q, m in enumerate(SIZES)]
    solved = np.linalg.solve(V, X)
    information = X.T @ solved
    row.error(design.scores(y) / (solved.T @ stacked(lambda q, b: y[q][b])) - 1, 1e-8, "scores")
    row.error(design.information / np.diag(information) - 1, 1e-8, "information")
    size = np.sqrt(np.diag(information))
    rows = np.arange(len(design.which))
    row.error(design.score_correlation(rows) - information / np.outer(size, size), 1e-8, "score correlation")


@pytest.mark.parametrize("error_scale", [1.0, 0.2])
def test_misfit_is_that_of_the_written_out_covariance(design, error_scale, validation):
    row = validation(what="misfit; volume with density of the noise, volume alone, of the evidence",
                     reference="the covariance written out: its inverse, its ln determinant", why="rounding")
    design = replace(design, error_scale=error_scale)
    _, V, stacked = dense(design)
    y = [np.random.default_rng(5).standard_normal((N_BLOCK, m)) * (design.noise.weight[q][:, None] > 0)
         for q, m in enumerate(SIZES)]
    flat = stacked(lambda q, b: y[q][b])
    row.error(design.misfit(y, []) / (flat @ np.linalg.solve(V, flat)) - 1, 1e-8, "misfit")
    found_here = -2 * (design.log_volume + design.log_noise)
    row.error(found_here / np.linalg.slogdet(V)[1] - 1, 1e-8, "volume and density")
    noise_alone = sum(
        float(np.sum(np.linalg.slogdet(design.noise.covariance[q])[1] - m * np.log(w[w > 0])))
        for q, (m, w) in enumerate(zip(SIZES, design.noise.weight, strict=True))
    )
    row.error(-2 * design.log_volume / (np.linalg.slogdet(V)[1] - noise_alone) - 1, 1e-8, "volume")


def test_evidence_is_the_mean_density_over_how_well_fingerprints_are_known(design, validation):
    """Against scipy's normal density with the covariance written out for each model-error scale."""
    row = validation(what="ln evidence over four model-error scales of signatures",
                     reference="scipy's normal density with each covariance written out", why="rounding", unit="nat")
    rng = np.random.default_rng(6)
    y = [rng.standard_normal((N_BLOCK, m)) * (design.noise.weight[q][:, None] > 0) for q, m in enumerate(SIZES)]
    densities = []
    for error_scale in ERROR_SCALES:
        _, V, stacked = dense(replace(design, error_scale=error_scale))
        densities.append(stats.multivariate_normal.logpdf(stacked(lambda q, b: y[q][b]), cov=V))
    powers = 0.5 * len(V) * np.log(2 * np.pi)
    found_here = error_scale_mean(design, lambda d: linear_evidence(d, y))
    row.error(found_here - np.log(np.mean(np.exp(densities))) - powers, 1e-8)
    # nothing found, no model error
    plain = replace(design, model_errors=())
    assert error_scale_mean(plain, lambda d: linear_evidence(d, y)) == linear_evidence(plain, y)


def test_a_long_fingerprint_that_fits_is_not_held_against_a_short_one_that_does_not(design):
    """Twenty times as long a signature that the record follows to a hundredth, and one that leaves three deviations:
    a model-error scale of a tenth of its length alone would choose the second."""
    long = tuple(20 * e[:, :, 1] for e in design.effect)
    step = design.model_errors[0][0]
    plain = replace(design, included=(), model_errors=())
    model_errors = replace(plain, model_errors=((step, tuple(0.1 * np.abs(e) for e in long)),))
    nothing_left = [np.zeros((N_BLOCK, m)) for m in SIZES]
    other = [np.zeros((N_BLOCK, m)) for m in SIZES]
    other[0][0] = 1.0
    other[0] *= np.sqrt(3**2 / plain.misfit(other, []))
    behind = linear_evidence(plain, other)
    assert linear_evidence(model_errors, nothing_left) < behind
    assert error_scale_mean(model_errors, lambda d: linear_evidence(d, nothing_left)) > behind


def test_draws_have_the_covariance_of_the_scores(design, validation):
    row = validation(what="6000 bootstrap draws of the scores: covariance, mean", reference="covariance of the scores",
                     why="78 entries, 12 means", unit="standard errors")
    X, V, _ = dense(design)
    information = X.T @ np.linalg.solve(V, X)
    n = 6000
    drawn = design.draw(np.random.default_rng(6), n)
    size = np.sqrt(np.diag(information))
    found = np.cov((drawn / size).T)
    # an entry of a sample covariance of n unit normals has standard deviation at most sqrt(2 / n); 78 of them, 4.5
    # standard deviations
    row.error((found - information / np.outer(size, size)) / np.sqrt(2 / n), 4.5, "covariance")
    row.error(drawn.mean(axis=0) / size * np.sqrt(n), 4.5, "mean")


def test_noise_is_not_blown_up_by_a_step_or_a_stray_block():
    rng = np.random.default_rng(7)
    y = 1e-2 * rng.standard_normal((60, 7))
    clean = estimate_noise((y,), (np.ones(60, bool),), (1,), np.ones((60, 1)), np.full(60, ""))
    stepped = y.copy()
    stepped[30:] += 0.3
    stepped[10] += 1.0
    noise = estimate_noise((stepped,), (np.ones(60, bool),), (1,), np.ones((60, 1)), np.full(60, ""))
    ratio = np.diag(noise.covariance[0]) / np.diag(clean.covariance[0])
    # the clipped differences are four out of 59
    assert np.all((ratio > 0.7) & (ratio < 1.4))


def test_a_group_with_two_blocks_beyond_a_step_does_not_tell_of_it(design):
    """One of two blocks gone wrong is no step: the other group alone shows of it."""
    late = replace(design, time_profiles=(*design.time_profiles[:1], step_profile(N_BLOCK, N_BLOCK - 4),
                                          *design.time_profiles[2:]))
    weight = design.noise.weight[1].copy()
    weight[N_BLOCK - 4 : N_BLOCK - 2] = 0.0
    few = replace(late, noise=replace(design.noise, weight=(design.noise.weight[0], weight)))
    rng = np.random.default_rng(4)
    y = [rng.standard_normal((N_BLOCK, m)) * (w[:, None] > 0) for m, w in zip(SIZES, few.noise.weight, strict=True)]
    changed = [y[0], y[1].copy()]
    changed[1][N_BLOCK - 1] += 5.0
    steps = few.which[:, 1] == 1
    none = np.zeros(few.n_unknown)
    alone = few.raw_scores(changed, none) - few.raw_scores(y, none)
    assert np.all(alone[steps] == 0) and np.all(alone[few.which[:, 1] == 0] != 0)
    # with three it does
    weight[N_BLOCK - 3] = 1.0
    found_here = replace(late, noise=replace(design.noise, weight=(design.noise.weight[0], weight)))
    assert np.all((found_here.raw_scores(changed, none) - found_here.raw_scores(y, none))[steps] != 0)


def test_unknowns_that_change_shapes_without_bound_are_let_go_and_nothing_else(design):
    """Where two modes nearly meet two tolerances may do the same 10^8 times over: scores are those of a record in which
    what they do is not looked at."""
    rng = np.random.default_rng(8)
    wild = [rng.standard_normal((2, m, 1)) for m in SIZES]
    almost = [1e8 * np.concatenate([w, w * (1 + 1e-12 * rng.standard_normal(w.shape))], axis=2) for w in wild]
    both, one = (
        replace(design, nuisance_std=np.array([*design.nuisance_std, *np.ones(n)]), nuisance=tuple(
            np.concatenate([own, a[:, :, :n]], axis=2) for own, a in zip(design.nuisance, almost, strict=True)))
        for n in (2, 1)
    )
    y = [rng.standard_normal((N_BLOCK, m)) for m in SIZES]
    z = [d.scores(y) / np.sqrt(d.information) for d in (both, one)]
    # twice the column is 1.4 times a column without bound
    assert np.allclose(z[0], z[1], rtol=1e-4, atol=1e-4)
    assert not np.allclose(z[0], design.scores(y) / np.sqrt(design.information), atol=1e-2)


def test_drawn_records_are_the_same_summed_up_at_once_or_one_by_one(design, monkeypatch, validation):
    row = validation(what="scores of drawn records, summed up one by one", reference="at once",
                     why="rounding, of the largest")
    whole = design.draw(np.random.default_rng(4), 9)
    monkeypatch.setattr(linear, "SUMMED", 1)
    # a sum of a record's numbers in another order differs by rounding
    row.error((design.draw(np.random.default_rng(4), 9) - whole) / np.abs(whole).max(), 1e-10)
    assert not whole.flags.writeable


@pytest.mark.parametrize("kind", ["step", "covariate"])
def test_beside_a_strong_effect_its_model_error_is_an_unknown_along_its_own_profile(design, kind, validation):
    """Against the written-out covariance with that unknown in it, candidate by candidate, of a column with that along
    its parabola too; nothing changes beside what a sensor does, and along the very same profile v falls as the
    dispersion says."""
    row = validation(what="scores and information beside a strong effect's model error",
                     reference="the covariance written out with that unknown in it", why="rounding")
    rng = np.random.default_rng(8)
    y = [rng.standard_normal((N_BLOCK, m)) * (design.noise.weight[q][:, None] > 0) for q, m in enumerate(SIZES)]
    own, z = step_profile(N_BLOCK, 7), 60.0
    if kind == "covariate":
        own = TimeProfile(kind="covariate", value=rng.gamma(2.0, 1.0, N_BLOCK) - 2.0, column="rms_mps2")
    problem = SimpleNamespace(effects=(None,) * N_EFFECT, time_profiles=design.time_profiles)
    strong = SimpleNamespace(effect=SimpleNamespace(kind="structural", time_profiles=("rms_mps2",)), time_profile=own,
                             exact=kind == "step")
    profiles = (own, *driver_profiles(problem, strong))
    assert len(profiles) == (1 if kind == "step" else 2)
    u, v = conditional_scores(problem, design, y, [strong], [z])
    alongs = [replace(design, time_profiles=(*design.time_profiles, profile),
                      which=np.array([(j, 3) for j in range(N_EFFECT)])) for profile in profiles]
    X, V, stacked = dense(design)
    columns = [dense(along)[0] for along in alongs]
    flat = stacked(lambda q, b: y[q][b])
    for k, (j, _) in enumerate(design.which):
        wider = V.copy()
        for F, profile in zip(columns, profiles, strict=True):
            shorter = np.linalg.norm(profile.value) / np.linalg.norm(own.value)
            variance = (model_error_dispersion(z * shorter) - 1) / (F[:, j] @ np.linalg.solve(V, F[:, j]))
            wider += variance * np.outer(F[:, j], F[:, j])
        solved = np.linalg.solve(wider, X[:, k])
        row.error(u[k] / (solved @ flat) - 1, 1e-7, "scores")
        row.error(v[k] / (solved @ X[:, k]) - 1, 1e-7, "information")
    if kind == "step":
        _, there = conditional_scores(problem, alongs[0], y, [strong], [z])
        row.error(there * model_error_dispersion(z) / alongs[0].information - 1, 1e-9,
                  "information along its own profile")
    sensor = SimpleNamespace(effect=SimpleNamespace(kind="measurement"), time_profile=own)
    np.testing.assert_array_equal(conditional_scores(problem, design, y, [sensor], [z])[1], design.information)


# two thresholds: of the first search, and of those beside findings ---------------------------------------------------


@pytest.mark.parametrize(("candidates", "words"), [
    ((), "scores |z| = 5.0, beyond the threshold of 4.8; by their evidence"),
    ((3,), "scores |z| = 5.0 beside the findings, beyond the threshold of 4.8 that holds there (of the first search "
           "4.6);"),
])
def test_a_note_says_of_which_search_its_threshold_is(candidates, words):
    last = SimpleNamespace(statistic=np.array([1.0, 5.0]), threshold=4.8, which=np.array([[0, 0], [1, 0]]))
    problem = SimpleNamespace(effects=[SimpleNamespace(name="soil"), SimpleNamespace(name="a gain")],
                              time_profiles=[SimpleNamespace(name="constant")])
    explored = SimpleNamespace(one_more=False, last=last, first=SimpleNamespace(threshold=4.6), problem=problem,
                               hypotheses=[SimpleNamespace(candidates=candidates)])
    (note,) = diagnose.chance_note(explored)
    assert note.startswith("a gain (constant) ") and words in note
    last.threshold = 5.1
    assert diagnose.chance_note(explored) == []


def test_a_frequency_error_that_grows_is_said_with_its_reason():
    gain = {"heldout_elpd": 30.0, "heldout_elpd_se": 4.0, "max_frequency_error_before": 0.011,
            "max_frequency_error_after": 0.006}
    assert wording.gain_words({"gain": gain}).endswith("1.1 % before, 0.6 % after")
    assert "(larger: " in wording.gain_words({"gain": gain | {"max_frequency_error_after": 0.02}})


def test_a_score_of_nothing_has_no_sign():
    finding = Finding(kind="measurement", cause="sensor polarity", location="a", size=-2.0, size_std=0.0, unit="-",
                      time_profile="constant", time_profile_start="", z=-0.04, posterior_probability=1.0,
                      alternatives=(), check="turn it")
    said = Diagnosis(verdict="named", p_value=0.0, findings=(finding,), detectable_sizes=(), threshold=4.0,
                     adequacy_p=1.0, notes=(), parameters=()).summary
    # named as the glossary names it: no size over the standard deviation that stands beside it
    assert "; score 0.0, " in said and " z " not in said.replace("|z|", "")
    assert "included (2 % of false alarms)" in said


def test_the_stated_threshold_is_said_to_be_of_the_first_search():
    assert wording.threshold_words({"threshold": 4.61, "details": {}}) == (
        "threshold |z| = 4.6 of the whole catalogue, before any finding is included")
    assert "of the first look" in wording.threshold_words({"threshold": 3.2, "details": {"without_model": True}})
    assert "nothing can be distinguished" in wording.threshold_words({"threshold": None, "details": {}})
    assert wording.threshold_words({"details": {}}) == ""


@pytest.mark.parametrize("sizes, n_shared", [((90, 3, 70, 20, 1), 6), ((70, 80), 0), ((5,), 2)])
def test_equations_of_groups_that_share_unknowns_have_the_dense_solution(sizes, n_shared, validation):
    row = validation(what="equations of groups that meet in shared unknowns: solution, half of it, ln determinant",
                     reference="dense solution and determinant", why="rounding")
    rng, n = np.random.default_rng(5), sum(sizes) + n_shared
    numbers = rng.permutation(n)
    *groups, shared = np.split(numbers, np.cumsum(sizes))
    A = np.zeros((n, n))
    for own in groups:
        seen = np.concatenate([own, shared])
        root = rng.standard_normal((len(seen), len(seen) + 3))
        A[np.ix_(seen, seen)] += root @ root.T
    scale, right = rng.uniform(0.1, 3.0, n), rng.standard_normal((n, 4))
    factor = ArrowFactor.factorise(A, groups, shared, scale, 0.0)
    dense = np.eye(n) + A * np.outer(scale, scale)
    exact = np.linalg.solve(dense, right)
    row.error(factor.solve(right) - exact, 1e-11, of="solution")
    row.error(factor.solve(right[:, 0]) - exact[:, 0], 1e-11, of="solution")
    row.error(np.sum(factor.half_solve(right) ** 2, axis=0) - np.sum(right * exact, axis=0), 1e-11, of="half")
    row.error(factor.log_diagonal - 0.5 * np.linalg.slogdet(dense)[1], 1e-10, of="ln determinant")


def test_unknowns_held_are_left_out_of_the_equations():
    rng = np.random.default_rng(6)
    root = rng.standard_normal((9, 9))
    A, groups = root @ root.T, [np.arange(4), np.arange(4, 6)]
    A[:4, 4:6] = A[4:6, :4] = 0.0
    right, used = rng.standard_normal((9, 2)), [*range(7), 8]
    half = ArrowFactor.factorise(A, groups, np.array([6, 8]), np.full(9, 0.1), 0.0).half_solve(right)
    exact = np.linalg.solve(np.eye(8) + 0.01 * A[np.ix_(used, used)], right[used])
    assert np.allclose(np.sum(half**2, axis=0), np.sum(right[used] * exact, axis=0), rtol=1e-12) and not half[7].any()
