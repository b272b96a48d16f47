"""Modes followed over a campaign: drift, step, gap, absence; the pole among the orders that stands for each."""

from dataclasses import replace

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification import tracking
from probupdate.identification.classification import ClassifierSettings, PoleStack

SETTINGS = ClassifierSettings()
NO_BANDS = np.zeros((0, 2))
ORDERS = tuple(range(12, 33, 4))


def block(k, jacket, reference, *, factor=1.0, absent=(), orders=ORDERS, strays=2, bands=NO_BANDS, line=None):
    """Every mode at every order, frequencies times `factor`, scattered; strays alike in shape and anywhere in
    frequency, at one order each; `line`: (Hz, damping, mode) at all orders."""
    rng = np.random.default_rng([7, k])
    there = [j for j in range(5) if j not in absent]
    own = jacket.frequency_hz * factor * (1 + 0.003 * rng.standard_normal(5))
    order, frequency, damping, shape = [], [], [], []

    def add(n, f, zeta, column):
        noise = 0.02 * (rng.standard_normal(18) + 1j * rng.standard_normal(18))
        order.append(n), frequency.append(f), damping.append(zeta), shape.append(column + noise)

    for n in orders:
        for j in there:
            add(n, own[j] * (1 + 0.0005 * rng.standard_normal()), jacket.damping_ratio[j], jacket.shape[:, j])
        if line is not None:
            add(n, line[0], line[1], jacket.shape[:, line[2]])
    for _ in range(strays):
        j = int(rng.integers(5))
        f = jacket.frequency_hz[j] * rng.uniform(0.7, 1.4)
        add(int(rng.choice(orders)), f, rng.uniform(0.01, 0.08), jacket.shape[:, j])
    stack = PoleStack(order=np.array(order), frequency_hz=np.array(frequency), damping_ratio=np.array(damping),
                      shape=np.column_stack(shape))
    like = rules.comparison(stack, reference)
    return tracking.JudgedPoles(
        id=str(k), poles=stack, comparison=like, bands=bands, reference=reference,
        verdict=rules.block_criteria(stack, like, reference, SETTINGS),
    ), own


def errors(tracked, blocks) -> np.ndarray:
    """(n_block, n_mode) relative error of the chosen poles' frequencies; NaN where there is none."""
    found = np.full(tracked.centre_hz.shape, np.nan)
    for k, (judged, own) in enumerate(blocks):
        for j, pole in enumerate(tracked.choices[k].pole):
            if pole >= 0:
                found[k, j] = judged.poles.frequency_hz[pole] / own[j] - 1
    return found


@pytest.mark.parametrize("course", ["drift", "step", "tide"])
def test_a_change_of_eight_percent_does_not_lose_a_mode(jacket, reference, course, validation):
    """Over 60 blocks down by 8 % steadily, at once, or 4 % up and down as with a tide. Each mode at every block, and
    never another's pole: errors stay at the scatter between orders, 0.05 %."""
    row = validation(what="modes followed through drift, step and tide of 8 %: poles chosen; path",
                     reference="the poles put in",
                     why="six times the scatter between orders; a mode's scatter and the grid")
    n = 60
    factor = {
        "drift": 1 - 0.08 * np.arange(n) / n, "step": np.where(np.arange(n) < 25, 1, 0.92),
        "tide": 1 + 0.02 * np.sin(2 * np.pi * np.arange(n) / 25),
    }[course]
    blocks = [block(k, jacket, reference, factor=factor[k]) for k in range(n)]
    tracked = tracking.track([b for b, _ in blocks], SETTINGS)
    wrong = errors(tracked, blocks)
    assert np.all(np.isfinite(wrong))
    row.error(wrong, below=0.003, of="poles")
    # the path itself is within a mode's own scatter from block to block, and the grid
    row.error(np.log(tracked.centre_hz / [own for _, own in blocks]), below=0.02, of="path")


def test_one_centre_for_the_campaign_would_lose_it(jacket, reference):
    """Why it is followed: about one centre, the second half of the step above lies outside any window as narrow."""
    blocks = [block(k, jacket, reference, factor=1 if k < 6 else 0.92) for k in range(12)]
    still = [tracking.choose(b, jacket.frequency_hz, SETTINGS) for b, _ in blocks]
    assert all((c.pole >= 0).all() for c in still[:6])
    assert all(c.pole[2] < 0 for c in still[6:])


def test_absent_modes_leave_the_others_and_come_back(jacket, reference):
    """Torsion is gone for a third of the blocks, SS2 altogether, everything in one block."""
    absent = [{4} | ({2} if 10 <= k < 20 else set()) | (set(range(5)) if k == 25 else set()) for k in range(30)]
    blocks = [block(k, jacket, reference, absent=absent[k], strays=0 if k == 25 else 2) if k != 25
              else block(k, jacket, reference, strays=1, absent=absent[k], orders=(12, 16)) for k in range(30)]
    tracked = tracking.track([b for b, _ in blocks], SETTINGS)
    wrong = errors(tracked, blocks)
    assert np.isnan(wrong[10:20, 2]).all() and np.isnan(wrong[25, :4]).all()
    rows = np.setdiff1d(np.arange(30), [25])
    assert np.isfinite(wrong[np.ix_(rows, [0, 1, 3])]).all() and np.nanmax(np.abs(wrong[:, [0, 1, 3]])) < 0.003
    assert np.isfinite(wrong[[9, 20], 2]).all()
    assert np.isnan(wrong[:, 4]).sum() >= 27  # a stray may pass now and then, not be a mode
    # the path goes on over the gap
    assert np.all(np.isfinite(tracked.centre_hz[:, :4]))


def test_a_mode_never_seen_has_no_path(jacket, reference):
    blocks = [block(k, jacket, reference, absent={2}, strays=0) for k in range(5)]
    tracked = tracking.track([b for b, _ in blocks], SETTINGS)
    assert np.isnan(tracked.centre_hz[:, 2]).all() and all(c.pole[2] == -1 for c in tracked.choices)


def test_a_harmonic_beside_a_mode_is_removed_and_the_mode_stays(jacket, reference):
    """6P of 14.8 rpm stands at 1.48 Hz, 4.5 % below a mode at 1.55 Hz, bends as it does and shows 0.6 % of damping."""
    factor = 1.55 / jacket.frequency_hz[3]
    bands = rules.rotor_bands({"rotor_speed_rpm_min": 14.6, "rotor_speed_rpm_max": 15.0}, SETTINGS)
    near = replace(reference, frequency_hz=reference.frequency_hz * factor)
    blocks = [block(k, jacket, near, factor=factor, bands=bands if k % 2 else NO_BANDS,
                    line=(1.48, 0.006, 3) if k % 2 else None) for k in range(20)]
    tracked = tracking.track([b for b, _ in blocks], SETTINGS)
    assert np.abs(errors(tracked, blocks)[:, 3]).max() < 0.003
    for k in range(1, 20, 2):
        judged = blocks[k][0]
        lines = np.flatnonzero(judged.poles.frequency_hz == 1.48)
        assert set(tracked.choices[k].criterion[lines]) == {rules.HARMONIC}


def test_a_mode_inside_the_swept_band_all_the_time_is_still_followed(jacket, reference):
    bands = rules.rotor_bands({"rotor_speed_rpm_min": 6.0, "rotor_speed_rpm_max": 14.8}, SETTINGS)
    blocks = [block(k, jacket, reference, bands=bands) for k in range(8)]
    wrong = errors(tracking.track([b for b, _ in blocks], SETTINGS), blocks)
    assert np.isfinite(wrong).all() and np.abs(wrong).max() < 0.003


def with_poles(full, reference, rows):
    """The block with these of its poles alone (n_pole,), judged again."""
    poles = full.poles
    stack = PoleStack(order=poles.order[rows], frequency_hz=poles.frequency_hz[rows],
                      damping_ratio=poles.damping_ratio[rows], shape=poles.shape[:, rows])
    like = rules.comparison(stack, reference)
    return replace(full, poles=stack, comparison=like,
                   verdict=rules.block_criteria(stack, like, reference, SETTINGS))


def test_a_weak_mode_at_few_orders_is_found_there(jacket, reference):
    """Torsion at two of six orders, the chosen one not among them; at one of eight it is too scarce."""
    full, own = block(0, jacket, reference, strays=0)
    poles = full.poles
    torsion = np.abs(poles.frequency_hz / own[2] - 1) < 0.01
    for kept, expected in (((24, 28), True), ((28,), False)):
        rows = ~torsion | np.isin(poles.order, kept)
        judged = with_poles(full, reference, rows)
        choice = tracking.track([judged], SETTINGS).choices[0]
        assert (choice.pole[2] >= 0) == expected
        assert choice.share[2] == pytest.approx(len(kept) / 6)
        if not expected:
            scarce = np.flatnonzero(np.abs(judged.poles.frequency_hz / own[2] - 1) < 0.01)
            assert set(choice.criterion[scarce]) == {rules.UNSTABLE}


def test_of_a_pair_whose_members_are_never_found_together_one_is_taken(jacket, reference):
    """Each at two of six orders, none at both: as a mode of a mast that shook along one of its axes at a time."""
    full, own = block(0, jacket, reference, strays=0)
    poles = full.poles
    (pair,) = [g for g in reference.groups if len(g) == 2 and 3 in g]
    rows = np.ones(len(poles.order), bool)
    for member, orders in zip(pair, (ORDERS[:2], ORDERS[2:4]), strict=True):
        rows &= ~(np.abs(poles.frequency_hz / own[member] - 1) < 1e-3) | np.isin(poles.order, orders)
    choice = tracking.track([with_poles(full, reference, rows)], SETTINGS).choices[0]
    assert list(choice.share[list(pair)]) == pytest.approx([2 / 6, 2 / 6])
    assert sum(choice.pole[j] >= 0 for j in pair) == 1


def test_of_the_orders_the_most_central_stands_for_the_mode(jacket, reference):
    judged, own = block(3, jacket, reference, strays=0)
    choice = tracking.track([judged], SETTINGS).choices[0]
    f = judged.poles.frequency_hz
    for j in (2,):
        mine = np.flatnonzero(np.abs(f / own[j] - 1) < 0.01)
        assert sorted(np.abs(f[mine] - np.median(f[mine]))).index(abs(f[choice.pole[j]] - np.median(f[mine]))) <= 1
        assert set(choice.criterion[mine]) == {rules.KEPT, rules.OTHER_ORDER}


def test_uncertain_poles_are_out_where_deviations_are_known(jacket, reference):
    judged, own = block(0, jacket, reference, strays=0)
    third = np.flatnonzero(np.abs(judged.poles.frequency_hz / own[2] - 1) < 0.01)
    verdict = rules.block_criteria(judged.poles, judged.comparison, reference, SETTINGS, uncertain=third)
    assert (verdict == rules.UNCERTAIN).sum() == len(ORDERS) and (verdict == rules.KEPT).sum() == 4 * len(ORDERS)
    choice = tracking.track([replace(judged, verdict=verdict)], SETTINGS).choices[0]
    assert choice.pole[2] == -1 and (choice.pole[[0, 1, 3, 4]] >= 0).all()


def plain_best(votes, low, high):
    """The second route for `follow`: all pairs of places, no running maxima."""
    grid = np.arange(low, high + tracking.GRID, tracking.GRID)
    cost = tracking.COST * np.abs(grid[:, None] - grid)
    reward = []
    for place, weight in votes:
        near = np.exp(-0.5 * ((grid[:, None] - place) / tracking.VOTE_WIDTH) ** 2) @ weight
        reward.append(np.log(tracking.FLOOR + near))
    total = reward[0]
    for row in reward[1:]:
        total = row + (total[None, :] - cost).max(axis=1)
    return total.max(), grid, reward


def test_the_path_is_the_best_of_all_paths(validation):
    row = validation(what="the path over the campaign", reference="the best of all paths, all pairs of places",
                     why="rounding")
    rng = np.random.default_rng(4)
    votes = [(rng.uniform(-0.1, 0.1, 3), rng.uniform(0.1, 1, 3)) for _ in range(12)]
    best, grid, reward = plain_best(votes, -0.12, 0.12)
    exact = tracking.follow(votes, -0.12, 0.12, refine=False)
    index = np.array([np.argmin(np.abs(grid - x)) for x in exact])
    value = sum(r[i] for r, i in zip(reward, index, strict=True))
    value -= tracking.COST * np.sum(np.abs(np.diff(grid[index])))
    row.error(value - best, below=1e-9)
    assert tracking.follow([(np.zeros(0), np.zeros(0))] * 3, -1, 1) is None


def test_no_block_is_refused():
    with pytest.raises(InputError, match="there is no block"):
        tracking.track([], SETTINGS)


@pytest.mark.parametrize(("change", "problem"), [
    ({"mac": 1.2}, "classifier, mac: 1.2 is not in 0 to 1"), ({"cluster": 0.0}, "classifier, cluster: 0.0"),
    ({"damping": (0.1, 0.0)}, r"classifier, damping: \[0.1, 0.0\] is empty"),
])
def test_thresholds_that_make_no_sense_are_refused(change, problem):
    with pytest.raises(InputError, match=problem):
        ClassifierSettings(**change)
