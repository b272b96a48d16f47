"""Which computed mode is which measured one: order, close pairs, crossings, and what is refused with its reason."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from updating_cases import (
    CHAIN_TRUTH,
    CHANNELS,
    LINEAR_HZ,
    chain_model,
    measured_chain,
    modal_set,
    turned,
)

from probupdate.errors import InputError
from probupdate.modal.frequency_pairs import ALIKE_OVER, pair_in_order
from probupdate.modal.matching import SPARE, assign, channel_rows, close_clusters, match
from probupdate.modal.modes import ModalData
from probupdate.model.interface import ModalSolution
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.pairing import paired_modes
from probupdate.updating.problem import build_problem

ROWS = np.arange(len(CHANNELS))


def solution_at(theta=CHAIN_TRUTH, n_mode=10):
    return chain_model().solve(np.asarray(theta, float), n_mode)


def test_modes_measured_in_any_order_find_their_computed_ones():
    exact = solution_at()
    order = [6, 2, 0]
    found = match(modal_set(exact.frequency_hz[order], exact.shape[:, order]), exact, ROWS, clusters=[(0,), (1,), (2,)])
    assert dict(zip(found.measured, found.computed, strict=True)) == {0: 6, 1: 2, 2: 0}
    assert found.n_mode == 7 + SPARE
    best = [found.criterion[j, i] for j, i in zip(found.measured, found.computed, strict=True)]
    assert best == pytest.approx([1, 1, 1])
    assert found.left_out == ()


def test_missing_channels_and_channels_in_another_order_do_not_change_the_pairing():
    model = chain_model()
    exact = solution_at()
    pick = [7, 1, 4, 2, 9, 5]
    channels = tuple(CHANNELS[k] for k in pick)
    found = match(modal_set(exact.frequency_hz[:4], exact.shape[pick, :4]), exact, channel_rows(model, channels))
    assert sorted(zip(found.measured, found.computed, strict=True)) == [(0, 0), (1, 1), (2, 2), (3, 3)]


def test_a_channel_the_model_does_not_have_is_named():
    with pytest.raises(InputError, match="channel z1: is in the measured modes but not in the model two-way chain"):
        channel_rows(chain_model(), ("x1", "z1"))


@pytest.mark.parametrize("angle", [0.3, np.pi / 4, 1.2, np.pi / 2])
def test_a_pair_turned_in_its_plane_is_matched_alike(angle):
    exact = solution_at()
    data = modal_set(exact.frequency_hz[:4], exact.shape[:, :4] / np.max(np.abs(exact.shape[:, :4]), axis=0))
    straight = match(data, solution_at(), ROWS)
    bent = match(modal_set(data.frequency_hz, turned(data.shape, (0, 1), angle)), solution_at(), ROWS)
    assert straight.pairs == bent.pairs == ((0, 1), (2, 3))
    assert straight.computed == bent.computed == (0, 1, 2, 3)
    assert bent.criterion == pytest.approx(straight.criterion, abs=1e-10)


def test_close_clusters_by_frequency_alone():
    # neighbours within 10 % of their mean: 1.00-1.10 (9.5 %) are close, 1.10-1.22 (10.3 %) are not; a run may be longer
    assert close_clusters(np.array([1.0, 1.1, 1.22, np.nan, 5.0])) == [(0, 1), (2,), (4,)]
    assert close_clusters(np.array([3.0, 1.0, 1.08, 1.17])) == [(1, 2, 3), (0,)]


def test_frequencies_alone_are_paired_as_of_all_pairings_the_most_probable(validation):
    row = validation(what="pairing of two to six ln f with eight computed ones, 200 times: excess of -2 ln density "
                          "over the least of all pairings that keep their order",
                     reference="normal density whose correlation falls by 1/e over an e-fold of f, every pairing "
                               "written out",
                     unit="", why="rounding")
    rng, excess = np.random.default_rng(8), []
    for _ in range(200):
        # spaced so that no gap is below OWN_ERROR
        measured = np.cumsum(rng.uniform(0.02, 0.5, rng.integers(2, 7)))
        computed = np.cumsum(rng.uniform(0.02, 0.5, 8)) + rng.normal(0, 0.2)
        precision = np.linalg.inv(np.exp(-np.abs(measured[:, None] - measured) / ALIKE_OVER))
        every = {chosen: error @ precision @ error for chosen in combinations(range(8), len(measured))
                 for error in [measured - computed[list(chosen)]]}
        found = pair_in_order(measured, computed)
        assert np.all(np.diff(found) > 0)
        excess.append(every[tuple(int(i) for i in found)] - min(every.values()))
    row.error(excess, 1e-9)


def test_a_close_pair_of_a_soft_model_stays_a_pair():
    """A jacket a tenth and second bending a fifth below what is measured, a local mode and one of the next order
    unmeasured."""
    measured = np.log([0.3145, 0.3169, 1.338, 1.954, 2.028])
    computed = np.log([0.3044, 0.3075, 0.7, 1.2218, 1.549, 1.6187, 2.4723])
    assert pair_in_order(measured, computed).tolist() == [0, 1, 3, 4, 5]
    one = modal_set(np.exp(measured), np.full((0, 5), np.nan))
    assert pair_in_order(measured[:1], computed).tolist() == [1]
    wide = ModalSolution(theta=np.zeros(1), frequency_hz=np.exp(computed), shape=np.zeros((0, 7)))
    assert match(one, wide, np.zeros(0, int)).computed == (0, 1, 3, 4, 5)


def crossing_model(gap=0.3):
    """Two modes of fixed shape whose frequencies cross where theta = 0; twelve others far above."""
    shape = np.linalg.qr(np.random.default_rng(2).standard_normal((16, 16)))[0]
    spare = 50.0 * 1.5 ** np.arange(14)

    def function(theta):
        return np.concatenate([[2.0 + theta[0], 2.0 - gap * theta[0]], spare]), shape

    parameters = Parameters((Parameter(name="t", unit="-", initial=-0.5, std=0.5, lower=-1, upper=1),))
    return FunctionModel(name="crossing", parameters=parameters, channels=tuple(f"c{k}" for k in range(16)),
                         function=function, version="1"), shape


def test_separate_modes_are_followed_through_a_crossing():
    model, shape = crossing_model()
    data = ModalData(channels=model.channels, sets=(modal_set([1.5, 2.15], shape[:, :2]),))
    problem = build_problem(model, data)
    assert problem.matching.pairs == ()
    path = np.linspace(-0.5, 0.5, 11)[:, None]
    predicted = problem.predict_many(path)
    # by shape, not by order: each column follows its own line through the crossing
    assert predicted.frequency_hz[:, 0] == pytest.approx(2.0 + path[:, 0])
    assert predicted.frequency_hz[:, 1] == pytest.approx(2.0 - 0.3 * path[:, 0])
    assert predicted.mac == pytest.approx(np.ones((11, 2)))


def test_a_mode_no_computed_one_resembles_is_left_out_by_name():
    exact = solution_at()
    shape = np.array(exact.shape[:, [0, 4]])
    # orthogonal to every computed mode that is looked at
    shape[:, 1] = np.linalg.svd(exact.shape[:, :9])[0][:, 9]
    found = match(modal_set([exact.frequency_hz[0], 3.0], shape), exact_first(9), ROWS, labels=("FA1", "odd"))
    assert found.measured == (0,)
    (sentence,) = found.left_out
    assert "odd in set one: no computed mode resembles odd" in sentence and "highest" not in sentence
    # of the mean of several sets, above all that were computed
    high = modal_set([exact.frequency_hz[0], 90.0], shape, id="36 of 36 sets")
    (sentence,) = match(high, exact_first(9), ROWS, labels=("FA1", "odd")).left_out
    assert sentence.startswith("odd in 36 of 36 sets: no computed mode")
    assert "it is at 90 Hz, and the highest computed mode, number 9" in sentence


def test_a_high_mode_is_looked_for_beyond_the_many_below_it():
    exact = solution_at(n_mode=18)
    data = ModalData(channels=CHANNELS, sets=(modal_set(exact.frequency_hz[[0, 15]], exact.shape[:, [0, 15]]),))
    found = build_problem(chain_model(), data).matching
    assert found.measured == (0, 1) and found.computed == (0, 15)


def exact_first(n):
    return solution_at(n_mode=n)


def test_a_mode_not_identified_is_left_out_with_its_set():
    exact = solution_at()
    frequency, shape = np.array(exact.frequency_hz[:3]), np.array(exact.shape[:, :3])
    frequency[2], shape[:, 2] = np.nan, np.nan
    found = match(modal_set(frequency, shape, id="noon"), exact, ROWS, labels=("FA1", "SS1", "FA2"))
    assert found.left_out == ("FA2 was not identified in set noon",)
    assert np.all(np.isnan(found.criterion[2]))
    assert found.computed == (0, 1)


def test_a_mode_with_one_shape_component_is_left_out():
    exact = solution_at()
    shape = np.array(exact.shape[:, [0, 4]])
    shape[1:, 1] = np.nan
    found = match(modal_set(exact.frequency_hz[[0, 4]], shape), exact, ROWS)
    assert found.left_out == ("mode 2 has fewer than two measured shape components in set one",)


def test_no_usable_mode_at_all_is_one_clear_line():
    exact = solution_at()
    with pytest.raises(InputError, match="set one: none of its modes can be used") as error:
        match(modal_set([np.nan, np.nan], np.full((len(CHANNELS), 2), np.nan)), exact, ROWS, labels=("FA1", "SS1"))
    assert "\n" not in str(error.value) and "FA1" in str(error.value)


def test_a_pair_with_too_few_shared_channels_is_left_out_not_guessed():
    # two rows are spanned by any two shapes: their plane says nothing
    exact = solution_at()
    shape = np.array(exact.shape[:, :3])
    shape[2:, :2] = np.nan
    found = match(modal_set(exact.frequency_hz[[0, 1, 4]], shape[:, [0, 1, 2]]), exact, ROWS, clusters=[(0, 1), (2,)])
    assert 0 not in found.measured and 1 not in found.measured
    assert len(found.left_out) == 1 and "mode 1 and mode 2" in found.left_out[0]


def test_members_of_a_pair_are_ascending_in_frequency_also_where_the_clusters_are_given():
    # another set may have measured the pair in the other order; computed members come in ascending order
    exact = solution_at()
    frequency = exact.frequency_hz[[1, 0, 2, 3]]
    found = match(modal_set(frequency, exact.shape[:, [1, 0, 2, 3]]), exact, ROWS, clusters=[(0, 1), (2, 3)])
    assert found.groups[0].measured == (1, 0)
    assert found.groups[0].computed == (0, 1)


def test_a_set_whose_pair_came_in_the_other_order_predicts_the_same_misfit():
    model = chain_model()
    straight = measured_chain(noise=0.002, seed=8)
    one = straight.sets[0]
    swap = [1, 0, 2, 3]
    other = ModalData(channels=CHANNELS, sets=(modal_set(one.frequency_hz[swap], one.shape[:, swap]),))
    a = build_problem(model, straight, clusters=[(0, 1), (2, 3)])
    b = build_problem(model, other, clusters=[(0, 1), (2, 3)])
    assert b.misfit(b.predict(CHAIN_TRUTH)) == pytest.approx(a.misfit(a.predict(CHAIN_TRUTH)), rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_assignment_is_the_best_of_all_permutations(seed):
    from itertools import permutations

    criterion = np.random.default_rng(seed).uniform(size=(3, 5))
    criterion[1] = criterion[0] + 0.01  # two rows that want the same column
    found = assign(criterion)
    best = max(sum(criterion[k, p[k]] for k in range(3)) for p in permutations(range(5), 3))
    assert sum(criterion[k, found[k]] for k in range(3)) == pytest.approx(best)
    assert len(set(found)) == 3


def test_a_solution_with_exactly_the_measured_modes_can_be_matched():
    exact = solution_at(n_mode=2)
    found = match(modal_set(exact.frequency_hz, exact.shape), ModalSolution(
        theta=exact.theta, frequency_hz=exact.frequency_hz, shape=exact.shape), ROWS)
    assert found.computed == (0, 1)


def test_the_linear_cases_frequencies_form_no_pair():
    assert all(len(c) == 1 for c in close_clusters(LINEAR_HZ))


# what is refused, with its reason


def test_a_shape_between_two_computed_modes_is_refused_with_both_macs():
    pair = solution_at()
    # halfway between two modes that are no close pair: no choice is right
    exact = replace(pair, frequency_hz=np.concatenate([[0.85 * pair.frequency_hz[0]], pair.frequency_hz[1:]]))
    shape = (exact.shape[:, [0]] / np.linalg.norm(exact.shape[:, 0])
             + 0.98 * exact.shape[:, [1]] / np.linalg.norm(exact.shape[:, 1]))
    with pytest.raises(InputError, match=r"as well, mode 1 at .* MAC 0\.5\d and mode 2 at .* MAC 0\.4\d") as error:
        match(modal_set(exact.frequency_hz[:1], shape), exact, ROWS, clusters=[(0,)])
    assert "\n" not in str(error.value)


def test_a_like_shape_far_off_in_frequency_is_no_alternative():
    """Sensors on one level see a column's bending modes alike; frequencies distinguish them."""
    exact = solution_at()
    rows = np.array([3, 8])  # one level, x and y
    found = match(modal_set(exact.frequency_hz[:2], exact.shape[rows][:, :2]), exact, rows, clusters=[(0,), (1,)])
    assert found.criterion[0, 4] > 0.9 and found.computed == (0, 1)


def test_a_mode_that_is_a_little_more_alike_but_far_off_does_not_take_its_place():
    """A torsion whose shape a mode of thrice the frequency has by 0.01 better, on these channels."""
    axes = np.eye(len(CHANNELS))
    own = np.sqrt(0.98) * axes[2] + np.sqrt(0.02) * axes[3]
    shape = np.column_stack([axes[0], axes[1], own, axes[5], np.sqrt(0.99) * axes[2] + np.sqrt(0.01) * axes[4]])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([0.3, 0.31, 1.34, 2.0, 4.3]), shape=shape)
    measured = modal_set([0.3, 0.31, 1.32], axes[:, :3])
    assert match(measured, solution, ROWS).computed == (0, 1, 2)
    # a nearer one that is another measured mode's own is not taken from it
    beside = np.cos(np.radians(20.3)) * axes[0] + np.sin(np.radians(20.3)) * axes[1]
    stiff = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([1.05, 1.5, 2.6, 5.0]),
                          shape=np.column_stack([beside, axes[0], axes[2], axes[3]]))
    crossed = modal_set([1.0, 1.2, 2.5], np.column_stack([axes[0], beside, axes[2]]))
    with pytest.raises(InputError, match="match (it )?about as well"):
        match(crossed, stiff, ROWS, clusters=[(0,), (1,), (2,)])

    def at(degrees):
        return np.cos(np.radians(degrees)) * axes[0] + np.sin(np.radians(degrees)) * axes[1]

    stiffer = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([1.05, 1.5, 3.75, 5.0]),
                            shape=np.column_stack([at(-22.5), at(13), axes[2], axes[3]]))
    clear = modal_set([0.7, 1.0, 2.5], np.column_stack([at(-36), at(0), axes[2]]))
    assert match(clear, stiffer, ROWS, clusters=[(0,), (1,), (2,)]).computed == (0, 1, 2)
    # as near as the other one, it is what it was: no choice is right
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([0.3, 0.31, 1.34, 1.6, 1.7]), shape=shape)
    found = match(measured, solution, ROWS)
    assert found.computed == (0, 1) and "mode 3 in set one: two computed modes match it" in found.left_out[0]


def test_measured_modes_an_octave_apart_do_not_change_their_partners():
    """Sensors on the top floor alone see first and second sway alike; that the two exchanged would be as alike in all
    was a reason to refuse both."""
    axes = np.eye(len(CHANNELS))
    second = np.sqrt(0.98) * axes[0] + np.sqrt(0.02) * axes[2]
    shape = np.column_stack([axes[0], axes[1], second])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([134.0, 147.0, 300.0]), shape=shape)
    assert match(modal_set([131.0, 150.0, 295.0], shape), solution, ROWS).computed == (0, 1, 2)
    # where either could be either, it is said, and so many of three are too many
    near = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([134.0, 147.0, 170.0]), shape=shape)
    with pytest.raises(InputError, match="match (it )?about as well"):
        match(modal_set([131.0, 150.0, 167.0], shape), near, ROWS, clusters=[(0,), (1,), (2,)])


def test_an_alternative_that_the_prior_cannot_bring_near_is_none():
    """A bridge's bending at 9.5 Hz, and one at 12 Hz that is a little less alike: refused, although no stiffness
    allows it."""
    axes = np.eye(len(CHANNELS))
    shape = np.column_stack([axes[0], np.sqrt(0.15) * axes[1] + np.sqrt(0.85) * axes[0]])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([9.534, 11.98]), shape=shape)
    measured = modal_set([9.55], np.sqrt(0.99) * axes[:, :1] + np.sqrt(0.01) * axes[:, 1:2])
    assert match(measured, solution, ROWS, prior_cov=lambda: np.diag([0.02, 0.03]) ** 2).computed == (0,)
    # a soft soil's mode may be there
    for cov in (None, lambda: np.diag([0.02, 0.2]) ** 2):
        with pytest.raises(InputError, match="match (it )?about as well"):
            match(measured, solution, ROWS, prior_cov=cov)


def test_what_other_modes_say_of_the_soil_says_where_its_modes_are():
    """A pile's mode that the prior of the soil could bring down to a measured one, if second bending did not show the
    soil as it was thought to be."""
    axes = np.eye(len(CHANNELS))
    shape = np.column_stack([axes[0], axes[1], np.sqrt(0.99) * axes[1] + np.sqrt(0.01) * axes[2]])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([0.9, 1.34, 1.6]), shape=shape)
    measured = modal_set([0.905, 1.35], axes[:, :2])

    def cov():
        slope = np.array([0.3, 0.3, 0.5])  # of ln f, for a standard deviation of the soil
        return np.outer(slope, slope) * 0.25

    assert match(measured, solution, ROWS, prior_cov=cov).computed == (0, 1)
    with pytest.raises(InputError, match="match (it )?about as well"):
        match(measured, solution, ROWS, prior_cov=lambda: np.diag(np.diag(cov())))


def test_of_two_modes_of_one_shape_frequencies_choose():
    """Few sensors see two modes alike: the better shape, by 0.02, is the wrong one."""
    axes = np.eye(len(CHANNELS))
    like = np.sqrt(0.98) * axes[1] + np.sqrt(0.02) * axes[2]
    shape = np.column_stack([axes[0], axes[1], like])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([0.9, 1.6, 1.9]), shape=shape)
    measured = modal_set([0.9, 1.88], axes[:, :2])
    cov = np.array([[4.0, 3.0, 3.0], [3.0, 4.0, 3.9], [3.0, 3.9, 4.0]]) * 1e-4
    assert match(measured, solution, ROWS, prior_cov=lambda: cov).computed == (0, 2)
    # halfway between the two it may be either, and far from both the prior is none to judge by
    for halfway in (1.74, 2.3):
        with pytest.raises(InputError, match="match (it )?about as well") as error:
            match(modal_set([0.9, halfway], axes[:, :2]), solution, ROWS, prior_cov=lambda: cov)
        assert "list the other modes" in str(error.value)
    # what the sentence advises
    assert match(modal_set([0.9], axes[:, :1]), solution, ROWS, prior_cov=lambda: cov).computed == (0,)


def test_frequencies_choose_where_two_groups_are_wrong_by_their_shapes():
    """Braces' own modes have the shapes of the tower's at its sensors, a little better, in two groups at once."""
    axes = np.eye(len(CHANNELS))

    def near(k, other):
        return np.sqrt(0.97) * axes[k] + np.sqrt(0.03) * axes[other]

    shape = np.column_stack([near(0, 5), near(1, 6), 0.2 * axes[0], 0.2 * axes[1]])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([1.07, 1.40, 1.43, 1.80]), shape=shape)
    measured = modal_set([1.08, 1.41], axes[:, :2])
    cov = 0.02**2 * np.eye(4)
    assert match(measured, solution, ROWS, prior_cov=lambda: cov).computed == (0, 1)
    with pytest.raises(InputError, match="match (it )?about as well"):
        match(measured, solution, ROWS, prior_cov=lambda: 400 * cov)


def test_a_mode_that_the_sensors_hardly_see_is_no_partner():
    """A pile's torsion has, by a trace of bending in it, the shape of bending at the sensors on its axis."""
    axes = np.eye(len(CHANNELS))
    trace = 0.002 * (np.sqrt(0.5) * axes[1] + np.sqrt(0.5) * axes[2])
    off = np.sqrt(0.995) * axes[2] + np.sqrt(0.005) * axes[4]
    shape = np.column_stack([axes[0], trace, axes[1], off, axes[3]])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([0.39, 1.68, 1.82, 1.94, 3.6]), shape=shape)
    found = match(modal_set([0.39, 1.85, 1.97], axes[:, :3]), solution, ROWS)
    assert found.computed == (0, 2, 3)
    assert np.linalg.norm(trace) < found.least_motion < 0.1


def test_one_axis_of_sensors_does_not_ask_for_the_pairs_other_half():
    model = chain_model()
    exact = model.solve(np.array([0.7, 1.06, 0.97, 0.0]), 10)
    rows = np.arange(5)
    x = [k for k in range(10) if np.linalg.norm(exact.shape[rows, k]) > 1e-6][:2]
    found = match(modal_set(exact.frequency_hz[x], exact.shape[rows][:, x]), exact, rows)
    assert found.computed == tuple(x)


@pytest.mark.parametrize("seed", range(4))
def test_modes_of_shuffled_channels_are_refused_with_their_macs(seed):
    exact = solution_at()
    order = np.random.default_rng(seed).permutation(len(CHANNELS))
    with pytest.raises(InputError, match=r"this model's: the best MACs are mode 1 0\.\d\d, mode 2 0\.\d\d") as error:
        match(modal_set(exact.frequency_hz[:4], exact.shape[order][:, :4]), exact, ROWS)
    assert "check the order, names and signs of the channels" in str(error.value)


@pytest.mark.parametrize("factor", [2 * np.pi, 1 / 60])
def test_frequencies_in_another_unit_are_refused(factor):
    exact = solution_at()
    with pytest.raises(InputError, match=r"times .median. those of modes of like shape; give Hz"):
        match(modal_set(factor * exact.frequency_hz[:4], exact.shape[:, :4]), exact, ROWS)


def test_groups_whose_best_modes_are_their_own_are_paired_as_by_the_assignment(validation):
    """The quick choice and the assignment problem, where single modes do and do not ask for the same one."""
    checked = validation(what="pairing of many draws at once", reference="assignment problem, row by row")
    model, data = chain_model(), measured_chain(CHAIN_TRUTH, noise=0.004, seed=3)
    problem = build_problem(model, data, clusters=[(k,) for k in range(data.n_mode)])
    base = model.solve(model.parameters.initial, problem.matching.n_mode)
    rng = np.random.default_rng(4)
    hz = base.frequency_hz * np.exp(0.2 * rng.standard_normal((300, base.frequency_hz.size)))
    for share in (0.1, 3.0):
        shape = base.shape + share * np.abs(base.shape).mean(axis=0) * rng.standard_normal((300, *base.shape.shape))
        computed, criterion = paired_modes(problem.groups, hz, shape, problem.matching.least_motion)
        measured_hz = np.concatenate([g.frequency_hz for g in problem.groups])
        # up to 0.15 of a MAC for 35 per cent of the frequency
        off = np.minimum(np.abs(np.log(hz[:, None] / measured_hz[:, None])) / 0.3, 1.0)
        plain = [linear_sum_assignment(-row)[1] for row in criterion - 0.15 * off]
        checked.equal(computed, np.array(plain))
    assert len(np.unique(computed, axis=0)) > 5


def test_a_plane_stays_with_two_modes_that_span_it_as_parameters_change():
    """Two floors of a building: a mode of a third of the frequency has the shape of one of a measured pair, and damage
    has turned the other's; by shapes alone the pair was compared with a mode at a third of its frequency."""
    axes = np.eye(len(CHANNELS))

    def turned_by(degrees):
        return np.cos(np.radians(degrees)) * axes[3] + np.sin(np.radians(degrees)) * axes[7]

    def low(theta):
        shape = np.column_stack([axes[0], np.sqrt(0.994) * axes[2] + np.sqrt(0.006) * axes[6], axes[2],
                                 turned_by(30 * theta[0]), axes[5]])
        return np.array([3.0, 4.2, 12.4, 13.3 + theta[0], 18.0]), shape

    parameters = Parameters((Parameter(name="d", unit="-", initial=0.1, std=0.5, lower=0.0, upper=2.0),))
    model = FunctionModel(name="floors", channels=CHANNELS, version="1", parameters=parameters, function=low)
    problem = build_problem(model, ModalData(channels=CHANNELS, sets=(modal_set([12.4, 13.3], axes[:, 2:4]),)))
    found = problem.predict_many(np.array([[0.1], [0.7], [1.4]]))
    assert found.computed.tolist() == [[2, 3]] * 3
    assert found.frequency_hz[:, 1] == pytest.approx([13.4, 14.0, 14.7])


def test_members_of_a_plane_that_trade_places_are_no_second_change():
    """A third computed mode, 31 degrees off the measured plane, is worse by 0.26 for the one mode it replaces."""
    axes = np.eye(len(CHANNELS))
    third = np.sqrt(0.74) * axes[0] + np.sqrt(0.26) * axes[2]
    for first, second in ((0, 1), (1, 0)):
        shape = np.column_stack([axes[first], axes[second], third, axes[5], axes[6]])
        solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([1.0, 1.01, 1.05, 3.0, 4.0]), shape=shape)
        found = match(modal_set([1.0, 1.01], axes[:, :2]), solution, ROWS)
        assert found.groups[0].computed == (0, 1)
    near = np.sqrt(0.9) * axes[0] + np.sqrt(0.1) * axes[2]
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=solution.frequency_hz,
                             shape=np.column_stack([axes[0], axes[1], near, axes[5], axes[6]]))
    with pytest.raises(InputError, match="match (it )?about as well"):
        match(modal_set([1.0, 1.01], axes[:, :2]), solution, ROWS)


def test_two_measured_modes_of_one_shape_are_the_mistake_that_is_named():
    """Equal rows of shape_re: each computed mode is as alike to one as to the other, whatever its MAC."""
    axes = np.eye(len(CHANNELS))
    first, second = axes[0], np.sqrt(0.6) * axes[0] + np.sqrt(0.4) * axes[1]
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([1.1, 1.2, 2.5, 3.0]),
                             shape=np.column_stack([first, second, axes[5], axes[6]]))
    twice = modal_set([1.0, 1.3, 2.5], np.column_stack([first, first, axes[5]]))
    with pytest.raises(InputError) as error:
        match(twice, solution, ROWS, clusters=[(0,), (1,), (2,)])
    said = str(error.value)
    assert "mode 1 and mode 2: their measured shapes are the same (MAC 1.00)" in said
    assert "check that they are two different modes" in said
    # as paired and exchanged: the two sums are equal, which two MACs of one mode did not show
    assert said.count("MAC 0.60") == 2 and said.count("with MAC 1.00") == 2 and "two computed modes" not in said


def test_two_modes_that_look_alike_span_no_plane_of_a_pair():
    """A monopile's torsion, in which tower sensors see second bending one way, beside that bending: each by itself is
    the best half of the measured plane, and both were taken for it, or refused as a second choice."""
    axes = np.eye(len(CHANNELS))
    torsion = np.sqrt(0.999) * axes[2] + np.sqrt(0.001) * axes[4]
    shape = np.column_stack([axes[0], np.sqrt(0.98) * axes[1] + np.sqrt(0.02) * axes[5], axes[2], torsion])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([0.9, 1.58, 1.74, 1.66]), shape=shape)
    measured = modal_set([0.9, 1.6, 1.73], axes[:, :3])

    def cov():
        return np.full((4, 4), 0.05**2) + 0.05**2 * np.eye(4)

    assert match(measured, solution, ROWS, prior_cov=cov, refuse=False).computed == (0, 1, 2)
    # by frequency the torsion may be either where it is near, and is none of both where it is far
    far = replace(solution, frequency_hz=np.array([0.9, 1.58, 1.74, 2.2]))
    assert match(measured, far, ROWS, prior_cov=cov).computed == (0, 1, 2)
    with pytest.raises(InputError, match="mode 2 at 1.58 Hz.*and mode 3 at 1.74 Hz.*or mode 2 .*and mode 4 at 1.66 Hz"):
        match(measured, solution, ROWS, prior_cov=cov)


def test_a_mode_that_the_prior_cannot_bring_where_it_was_measured_is_left_out():
    """Heave of a tripod, which horizontal sensors see only where its feet differ: the model as designed shows them none
    of it, and a mode of 2.6 times its frequency has its shape."""
    axes = np.eye(len(CHANNELS))
    shape = np.column_stack([axes[0], axes[1], 0.001 * axes[5], axes[2]])
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([0.41, 2.7, 4.9, 12.5]), shape=shape)
    measured = modal_set([0.4, 2.69, 4.76], axes[:, :3])
    found = match(measured, solution, ROWS, prior_cov=lambda: 0.05**2 * np.eye(4))
    assert found.computed == (0, 1)
    assert "mode 3 in set one: the computed mode of like shape is at 12.5 Hz, 18 prior standard" in found.left_out[0]
    # a prior that allows it, and a model that is wrong by one factor
    assert match(measured, solution, ROWS, prior_cov=lambda: 0.5**2 * np.eye(4)).computed == (0, 1, 3)
    softer = modal_set([0.2, 1.35, 6.2], axes[:, :3])
    assert match(softer, solution, ROWS, prior_cov=lambda: 0.05**2 * np.eye(4)).computed == (0, 1, 3)


def test_a_change_for_nothing_elsewhere_makes_no_pairing_doubtful():
    """Four computed modes lie in the plane of three measured ones; the first has its own, and another is worse by 0.21.
    """
    axes = np.eye(len(CHANNELS))
    worse = np.sqrt(0.79) * axes[0] + np.sqrt(0.21) * axes[5]
    nearly = np.sqrt(0.98) * axes[3] + np.sqrt(0.02) * axes[4]
    solution = ModalSolution(theta=CHAIN_TRUTH, frequency_hz=np.array([0.5, 0.6, 1.22, 2.0, 2.05, 2.64]),
                             shape=np.column_stack([axes[0], worse, axes[3], axes[1], nearly, axes[2]]))
    with pytest.raises(InputError, match="set one, mode 2 and mode 3 and mode 4: two computed modes match it"):
        match(modal_set([0.5, 2.0, 2.02, 2.04], axes[:, :4]), solution, ROWS, clusters=[(0,), (1, 2, 3)])
