"""What the scatter of blocks is estimated from, and how surely: against draws of a known covariance."""

import numpy as np
import pytest
from scipy import stats

from probupdate.diagnosis.fitting import with_column_scatter
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.mode_numbers import numbers_of_modes
from probupdate.diagnosis.noise import Noise, agrees, estimate_noise, factor_covariance, mixing_of
from probupdate.diagnosis.problem import IncludedEffect
from probupdate.diagnosis.search import least_by_chance, tail, value_exceeded_by
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import Effect


@pytest.mark.parametrize("mixing", [0.0, 0.3, 1.0, 8.0])
def test_few_columns_do_not_make_what_is_least_known_look_small(mixing, validation):
    """Fifteen blocks of twenty columns in sixty dimensions: inverted as it is, such a covariance makes signatures
    that lean on its small directions too sure by n / (n - m) and more (Hartlap et al. 2007); shrunk to the diagonal it
    loses them where modes mix strongly. Channels' own scatter and six directions of mixing."""
    row = validation(what="z with a noise pattern from 300 columns in 60 dimensions: its variance; power over the "
                          "best; variance where the pattern is inverted as it is", reference="the true covariance",
                     why="n / (n - m) and more would be lost")
    rng = np.random.default_rng(3)
    mixed = mixing * rng.standard_normal((60, 6)) * np.geomspace(1.0, 0.125, 6)
    true = np.eye(60) + mixed @ mixed.T
    root, best = np.linalg.cholesky(true), np.linalg.inv(true)
    variance, power = {}, {}
    for _ in range(10):
        sample = rng.standard_normal((300, 60)) @ root.T
        prints = rng.standard_normal((50, 60))
        for name, found_here in (("raw", sample.T @ sample / 300), ("factored", factor_covariance(sample))):
            weight = prints @ np.linalg.inv(found_here)
            own, length = np.einsum("ni,ij,nj->n", weight, true, weight), np.einsum("ni,ni->n", weight, prints)
            # variance that a signature's z really has, and what is left of the largest z that can be had
            variance.setdefault(name, []).append(own / length)
            power.setdefault(name, []).append(length / np.sqrt(own * np.einsum("ni,ij,nj->n", prints, best, prints)))
    row.error(np.mean(variance["factored"]) - 1, 0.1, "variance")
    row.least(np.mean(power["factored"]), 0.97, "power")
    row.least(np.mean(variance["raw"]), 1.4, "inverted as it is")


MODES = np.array([[1.0, 0.9, -0.8], [0.8, -0.3, 1.0], [0.6, -0.9, 0.2], [0.4, -1.0, -0.7], [0.2, -0.6, -0.9],
                  [0.1, -0.3, -0.5]])


def identified_numbers(rng, n, scatter, own):
    """(n_group, n, n_response) of n identifications of three modes: eigenvalues and vectors of a matrix of poles whose
    entries are off at random, by `scatter` of ln f, and a scatter of every component's `own`."""
    f, result = np.array([1.0, 1.3, 1.9]), []
    size = scatter * np.sqrt(np.outer(f, f))
    for _ in range(n):
        pole, mixed = np.linalg.eig(np.diag(f).astype(complex) + size * (rng.standard_normal((3, 3))
                                                                        + 1j * rng.standard_normal((3, 3))))
        order = np.argsort(pole.real)
        shape = MODES @ mixed[:, order] / np.diag(mixed[:, order])
        shape = shape + own * (rng.standard_normal((6, 3)) + 1j * rng.standard_normal((6, 3)))
        result.append([numbers_of_modes(pole.real[order][None, [k]], shape[None, :, [k]], MODES[:, [k]])[0][0]
                       for k in range(3)])
    return np.array(result).transpose(1, 0, 2), f


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("scatter", [0.0003, 0.003])
def test_shapes_scatter_along_those_of_other_modes(scatter, stated, validation):
    """Of 90 sound records of drawn structures 19 had p of 0.1 or less: shapes scatter along the shapes of other modes,
    where the structure's changes lie, by twice what standard deviations or correlations of twelve blocks said."""
    row = validation(what="twelve identifications of three modes: variance of z along the other modes' shapes, mean of "
                          "25 records; without mixing", reference="one; eigenvectors of poles that are off at random",
                     why="a variance from eleven differences is off by an eighth, its inverse by more")
    rng, own = np.random.default_rng(21), 0.002
    many, f = identified_numbers(rng, 400, scatter, own)
    true = [np.cov(y.T) for y in many]
    mixing = mixing_of([MODES[:, [k]] for k in range(3)], f)
    pattern = [np.diag(np.diag(C)) for C in true] if stated else None
    variance = {"with": [], "without": []}
    for _ in range(25):
        y, _ = identified_numbers(rng, 12, scatter, own)
        for name, how in (("with", mixing), ("without", None)):
            noise = estimate_noise(tuple(y), (np.ones(12, bool),) * 3, (1,) * 3, np.ones((12, 3)), np.full(12, ""),
                                   pattern, std_alone=True, mixing=how)
            for q, made in enumerate(mixing.made):
                for p in {0, 1, 2} - {q}:
                    along = np.zeros(13)
                    along[1:7] = np.linalg.eigh(made[p])[1][:, -1]
                    turned = noise.precision[q] @ along
                    variance[name].append(turned @ true[q] @ turned / (along @ turned))
    row.between(np.mean(variance["with"]), 0.75, 1.35, "with")
    if scatter > 0.001:
        row.least(np.mean(variance["without"]), 2.0, "without")


def test_blocks_far_from_both_neighbours_are_said_and_not_what_stands_between_them_or_at_a_step(validation):
    row = validation(what="thirty blocks of twenty responses, two of them far from their neighbours with one between, "
                          "a step: the blocks that are said to be stray", reference="those that were moved")
    rng = np.random.default_rng(4)
    n, m, moved, at = 30, 20, [7, 9], 18
    y = rng.standard_normal((n, m)) + np.where(np.arange(n) >= at, 5.0, 0.0)[:, None]
    y[moved] += 6 * rng.standard_normal((2, m))
    # nothing stated: one covariance of all
    noise = estimate_noise((y,), (np.ones(n, bool),), (1,), np.ones((n, 1)), np.full(n, ""))
    row.equal(np.flatnonzero(noise.stray[0]).tolist(), moved)
    assert np.ptp(np.delete(noise.weight[0], moved)) == 0
    np.testing.assert_array_equal(noise.select_blocks(np.array([1, 7])).stray[0], [False, True])


@pytest.mark.parametrize(("size", "n_log"), [(1, 1), (2, 3)])
def test_degrees_of_freedom_are_those_of_the_scale_that_was_told(size, n_log, validation):
    """The variance of a scale estimated from differences of n blocks, over 3000 records, is 2 over its degrees."""
    row = validation(what="degrees of freedom of a noise's scale, frequencies and shapes",
                     reference="variance of the scale over 3000 records",
                     why="3 % sampling, the rest cut-off of far differences")
    rng = np.random.default_rng(5)
    m = n_log + 8
    pattern = np.diag(np.geomspace(1e-5, 1e-4, m))
    n = 25
    scales, degrees = [], None
    for _ in range(3000):
        y = rng.standard_normal((n, m)) * np.sqrt(np.diag(pattern))
        noise = estimate_noise((y,), (np.ones(n, bool),), (size,), np.ones((n, 1)), np.full(n, ""), [pattern])
        found_here = np.diag(noise.covariance[0]) / np.diag(pattern)
        scales.append([found_here[0], found_here[-1]])
        degrees = noise.degrees[0]
    spread = np.var(scales, axis=0) / np.mean(scales, axis=0) ** 2
    # a variance of 3000 draws is known to 3 %; differences far out are cut off, which takes a few per cent
    row.error(spread[0] * degrees[0] / 2 - 1, 0.12, "frequencies")
    row.error(spread[1] * degrees[-1] / 2 - 1, 0.12, "shapes")


def test_phases_have_a_scale_of_their_own_where_standard_deviations_alone_were_stated(validation):
    """Shapes that lie in one phase scatter less across it than a standard deviation of both parts says: real parts were
    believed 1.35 times too much, and of 24 sound records one was *unexplained* and six had p below 0.05."""
    row = validation(what="scatter of real parts and of phases, a third of theirs, where standard deviations of shapes "
                          "alone were stated: over what was drawn", reference="1", why="differences of 60 blocks")
    rng = np.random.default_rng(9)
    n, n_part = 60, 12
    std = np.r_[1e-3, np.full(n_part, 1e-2), np.full(n_part, 3e-3)]
    y = rng.standard_normal((n, len(std))) * std
    pattern = np.diag(np.r_[1e-3, np.full(2 * n_part, 1e-2)] ** 2)

    def scatter(std_alone):
        noise = estimate_noise((y,), (np.ones(n, bool),), (1,), np.ones((n, 1)), np.full(n, ""), [pattern],
                               std_alone=std_alone)
        return np.sqrt(np.diag(noise.covariance[0])) / std, noise.degrees[0]

    found, degrees = scatter(std_alone=True)
    row.error(found[[0, 1, -1]] - 1, 0.3, "over")
    row.error(found[[1, -1]] - 1, 0.1, "shapes")
    together, of_all = scatter(std_alone=False)
    row.error(together[1] - np.sqrt((1 + 0.3**2) / 2), 0.05, "stated together: real parts less")
    assert of_all[-1] == pytest.approx(2 * degrees[-1])


def test_ways_that_are_free_count_by_what_is_not_known_along_them(validation):
    row = validation(what="precision with two ways free, one of them twice; with what another noise leaves free too",
                     reference="the inverse of C + W W^T")
    rng = np.random.default_rng(4)
    root = rng.standard_normal((6, 6))
    C = root @ root.T + np.eye(6)
    noise = Noise(covariance=(C,), precision=(np.linalg.inv(C),), weight=(np.ones(4),))
    W, more = 30.0 * rng.standard_normal((6, 2)), 20.0 * rng.standard_normal((6, 1))
    free = noise.with_free([W])
    row.error(free.precision[0] - np.linalg.inv(C + W @ W.T), 1e-10, "precision")
    row.error(free.also_free(noise.with_free([more])).precision[0] - np.linalg.inv(C + W @ W.T + more @ more.T), 1e-10,
              "together")
    assert noise.with_free([W[:, :0]]) is noise and free.also_free(noise) is free
    # the same ways again, or ways within the scatter, are no more
    assert free.also_free(noise.with_free([0.7 * W])) is free
    assert noise.also_free(noise.with_free([0.1 * root[:, :1]])) is noise
    assert free.select_blocks(np.arange(2)).free is free.free and free.of_groups([]).free == ()


def test_scales_are_drawn_together_where_they_were_told_together():
    own = np.array([7.0, 30.0, 30.0])
    noise = Noise(covariance=(np.eye(3),), precision=(np.eye(3),), weight=(np.ones(4),), degrees=(own,))
    (drawn,) = noise.scales(np.random.default_rng(1), 4000)
    assert np.array_equal(drawn[:, 1], drawn[:, 2]) and not np.allclose(drawn[:, 0], drawn[:, 1])
    for column, found_here in ((0, 7.0), (1, 30.0)):
        assert stats.kstest(found_here / drawn[:, column] ** 2, "chi2", (found_here,)).pvalue > 1e-3
    known = Noise(covariance=(np.eye(3),), precision=(np.eye(3),), weight=(np.ones(4),))
    assert known.scales(np.random.default_rng(1), 4) == []


@pytest.mark.parametrize("share", [0.1, 0.02, 0.01])
def test_the_threshold_is_where_the_tail_has_its_share(share):
    maxima = np.random.default_rng(2).gumbel(3.2, 0.3, 400)
    limit = value_exceeded_by(maxima, share)
    assert tail(maxima, limit * 1.001) <= share * 1.05
    assert tail(maxima, limit * 0.97) > share
    # 400 draws of a known distribution: its quantile to three of its own standard deviations
    exact = stats.gumbel_r.isf(share, 3.2, 0.3)
    assert limit == pytest.approx(exact, abs=0.25)
    values = np.sort(np.append(maxima, [4.0, 4.5, 5.5]))
    assert np.all(np.diff([tail(maxima, v) for v in values]) <= 0)


def test_scores_by_noise_of_a_few_blocks_have_a_tail_that_is_a_power(validation):
    """Two sound buildings of twelve blocks had scores of 5.7 and 6.8, p = 0.0009 and 0.0004 by a Gumbel distribution,
    and a cause *named*: noise estimated from each of 800 such records gives them p = 0.006 and 0.004."""
    row = validation(what="p of the largest of 700 Student t of twelve degrees of freedom, by 400 draws: ln of it over "
                          "the exact one, p = 0.002, mean of 200 times; threshold of 0.02, relative",
                     reference="the distribution of the largest of so many", why="a power of forty draws")
    n, degrees, rng = 700, 12, np.random.default_rng(8)
    exact = [stats.t.isf(0.5 * -np.expm1(np.log1p(-share) / n), degrees) for share in (0.002, 0.02)]
    p, by_gumbel, limit = [], [], []
    for _ in range(200):
        maxima = np.abs(stats.t.isf(0.5 * -np.expm1(np.log(rng.random(400)) / n), degrees))
        p.append(np.log(tail(maxima, exact[0], heavy=True) / 0.002))
        by_gumbel.append(np.log(tail(maxima, exact[0]) / 0.002))
        limit.append(value_exceeded_by(maxima, 0.02, heavy=True) / exact[1] - 1)
    row.error(np.mean(p), 0.4, "p")
    row.error(np.mean(limit), 0.03, "threshold")
    assert np.mean(by_gumbel) < -0.7
    assert np.all(np.diff([tail(maxima, v, heavy=True) for v in np.linspace(3, 30, 50)]) <= 0)


@pytest.mark.parametrize("p", [1e-6, 0.003, 0.02, 0.3, 0.5, 1.0])
def test_chance_keeps_the_odds_that_no_cause_can_take_from_it(p, validation):
    row = validation(what="least odds of chance at p", reference="one over the largest density b p^(b - 1) of p, by "
                     "search among 0 < b < 1 (Sellke, Bayarri & Berger 2001)", why="grid of b")
    b = np.geomspace(1e-3, 1, 20001)
    row.error(least_by_chance(p) * np.max(b * p ** (b - 1)) - 1, 1e-6)


def record(rng, n=40, m=37):
    pattern = np.diag(np.full(m, 1e-4))
    return rng.standard_normal((n, m)) * 1e-2, pattern


def noise_of(y, pattern):
    n = len(y)
    return estimate_noise((y,), (np.ones(n, bool),), (1,), np.ones((n, 1)), np.full(n, ""), [pattern])


@pytest.mark.parametrize("at", [0, 1, 20, 39])
def test_a_block_gone_wrong_counts_less_and_its_neighbours_as_before(at, validation):
    row = validation(what="a block with three times the noise: its variance; weights of all others",
                     reference="9 for each of 37 responses, as all of them together are one standard deviation off; "
                               "as before", why="a factor of 1.6: one block of 37 responses")
    y, pattern = record(np.random.default_rng(8))
    y[at] *= 3.0
    weight = noise_of(y, pattern).weight[0]
    # nine times the variance: estimated from one block of 37 responses, and as the difference to a neighbour
    row.between(1 / weight[at] / y.shape[1], 9 / 1.6, 9 * 1.6, "variance")
    row.equal(np.delete(weight, at), np.ones(len(y) - 1), "weights")


def test_blocks_at_a_step_and_blocks_of_a_quiet_record_count_whole():
    for seed in range(30):
        y, pattern = record(np.random.default_rng(seed))
        assert np.all(noise_of(y, pattern).weight[0] == 1.0)
        y[25:] += 0.04
        assert np.all(noise_of(y, pattern).weight[0] == 1.0)


@pytest.mark.parametrize("n", [24, 48])
@pytest.mark.parametrize("real", [False, True])
def test_standard_deviations_alone_are_believed_where_blocks_scatter_so(n, real):
    """Independent noise as stated, at any scale; and the same standard deviations made by one common turn."""
    rng, p = np.random.default_rng(12), 40
    std = 0.01 * (1 + rng.random(p))
    if real:
        # phases that do not scatter at all
        std[p // 2 :] = 0.01
    for scale in (0.5, 1.0, 3.0):
        noise = scale * std * rng.standard_normal((n, p))
        noise[:, p // 2 :] *= not real
        assert agrees(np.diag(std**2), noise, 2)
        # one block that went wrong and a step change nothing of how the others scatter
        noise[5] += 20 * scale * std * rng.standard_normal(p)
        noise[n // 2 :] += 20 * scale * std * rng.standard_normal(p)
        assert agrees(np.diag(std**2), noise, 2)
    turned = std * rng.standard_normal((n, 1)) + 0.2 * std * rng.standard_normal((n, p))
    assert not agrees(np.diag(1.04 * std**2), turned, 2)


@pytest.mark.parametrize("n", [8, 24, 48])
@pytest.mark.parametrize("which", [0, 5, 30], ids=["frequency", "real part", "phase"])
def test_standard_deviations_of_which_one_is_far_too_small_are_not_believed(n, which):
    """A slip of the unit in one of forty; the kinds, two frequencies, real parts, phases, may each have their scale."""
    rng, p = np.random.default_rng(13), 40
    std, scale = 0.01 * (1 + rng.random(p)), np.repeat([3.0, 1.0, 0.05], [2, 19, 19])
    noise = scale * std * rng.standard_normal((n, p))
    assert agrees(np.diag(std**2), noise, 2)
    std[which] *= 1e-3
    assert not agrees(np.diag(std**2), noise, 2)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.2])
def test_what_blocks_scatter_about_a_column_is_found_along_the_effect(share, validation):
    """Forty-eight blocks of two groups of modes, twenty records: each block has its effect times 1 + share N(0, 1),
    the same in both groups."""
    row = validation(what="scatter of an effect about its column, of 0, 0.1 and 0.2 of the effect (mean of twenty "
                          "records of 48 blocks)", reference="what was drawn",
                     why="three standard errors of such a mean, and what the prior draws back")
    rng, n, m = np.random.default_rng(11), 48, 6
    effect = Effect(kind="environmental", cause="soil", location="all legs", unit="-", tolerance=0.0, prior_scale=1.0,
                    parameter="soft")
    signatures = tuple(rng.standard_normal((1, m, 1)) for _ in range(2))
    found = []
    for _ in range(20):
        profile = TimeProfile(kind="covariate", value=rng.gamma(2.0, 2.0, n) - 4.0, column="rms_mps2")
        noise = Noise(covariance=(np.eye(m),) * 2, precision=(np.eye(m),) * 2, weight=(np.ones(n),) * 2)
        design = Design(
            bin_of=np.zeros(n, int), nuisance=(np.zeros((1, m, 0)),) * 2, nuisance_std=np.zeros(0),
            discrepancy_std=(np.full(m, 1e-3),) * 2, effect=signatures, time_profiles=(), which=np.zeros((0, 2), int),
            noise=noise, included=((0, profile, 1.0),))
        included = [IncludedEffect(effect=effect, time_profile=profile, size=2.0)]
        off = share * rng.standard_normal(n)
        left = [rng.standard_normal((n, m)) + (2.0 * off * profile.value)[:, None] * s[0, :, 0] for s in signatures]
        after = with_column_scatter(design, noise, included, left)
        typical = 4.0 * np.mean(profile.value**2)
        square = [np.trace(C - np.eye(m)) / (typical * np.sum(s**2))
                  for C, s in zip(after.covariance, signatures, strict=True)]
        assert square[0] == pytest.approx(square[1], rel=1e-9)
        np.testing.assert_allclose(after.precision[0] @ after.covariance[0], np.eye(m), atol=1e-9)
        found.append(np.sqrt(max(square[0], 0.0)))
    row.error(np.mean(found) - share, 0.02, "share")
