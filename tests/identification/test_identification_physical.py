"""Modes out of made-up poles: what comes back is found, weak or turning; the rotor's, the sea's and doubles are not."""

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.identification.block_poles import STAY, TAKEN_OUT
from probupdate.identification.classification import ClassifierSettings, PoleStack
from probupdate.identification.physical import (
    MOST_BLOCKS,
    PersistenceSettings,
    block_candidates,
    even_blocks,
    gather_candidates,
    physical_modes,
    stays,
)
from probupdate.identification.summary import harmonics_removed
from probupdate.modal.modes import mac, plane_mac

MODES_HZ, N_BLOCK, ORDERS = (0.33, 1.25, 1.9), 30, (14, 16, 18, 20, 22)


def stack(rng, rows, n_noise=4, orders=ORDERS) -> PoleStack:
    """rows: (frequency, damping, shape (12,), orders) of what comes back, with a little noise; poles of noise anywhere,
    of random shape, at one order each."""
    order, frequency, damping, shape = [], [], [], []
    for f, zeta, column, where in rows:
        for n in where:
            order.append(n)
            frequency.append(f * (1 + 5e-4 * rng.standard_normal()))
            damping.append(zeta)
            shape.append(column + 0.02 * (rng.standard_normal(12) + 1j * rng.standard_normal(12)))
    for _ in range(n_noise):
        order.append(int(rng.choice(orders)))
        frequency.append(np.exp(rng.uniform(np.log(0.1), np.log(2.4))))
        damping.append(rng.uniform(0.005, 0.1))
        shape.append(rng.standard_normal(12) + 1j * rng.standard_normal(12))
    return PoleStack(order=np.array(order), frequency_hz=np.array(frequency), damping_ratio=np.array(damping),
                     shape=np.array(shape).T)


def found_in(stacks, **how):
    parts = [block_candidates(one, k, ClassifierSettings(), PersistenceSettings()) for k, one in enumerate(stacks)]
    return physical_modes(gather_candidates(parts), n_block=len(stacks), **how)


def plain(rng, extra=()):
    rows = [(f * (1 + 2e-3 * rng.standard_normal()), 0.01, np.eye(12)[k], ORDERS) for k, f in enumerate(MODES_HZ)]
    return stack(rng, [*rows, *extra])


def swept(speeds_rpm):
    return [np.outer([1, 3], [0.98 * rpm / 60, 1.02 * rpm / 60]) for rpm in speeds_rpm]


def test_three_modes_among_noise_and_their_ranges(validation):
    row = validation(what="three modes out of made-up poles among noise: frequencies, MAC",
                     reference="the modes put in", why="means of thirty draws of 0.2 %")
    rng = np.random.default_rng(1)
    found = found_in([plain(rng) for _ in range(N_BLOCK)])
    assert found.modes.labels == ("1", "2", "3") and found.notes == ()
    row.error(found.modes.frequency_hz / MODES_HZ - 1, 2e-3, "frequencies")
    assert np.all(found.modes.range_hz[:, 0] < MODES_HZ) and np.all(found.modes.range_hz[:, 1] > MODES_HZ)
    row.least(np.diag(mac(found.modes.shape, np.eye(12)[:, :3])), 0.99, "MAC")


@pytest.mark.parametrize(("blocks", "orders"), [(range(N_BLOCK), (20,)), (range(0, N_BLOCK, 4), ORDERS)],
                         ids=["at one order of five in every block", "at all orders of every fourth block"])
def test_a_weak_or_seldom_excited_mode_is_found_by_all_blocks_together(blocks, orders, validation):
    row = validation(what="a mode at one order of five in every block, or in every fourth block, beside three: "
                          "frequencies", reference="the modes put in", why="means of draws of 0.2 %")
    rng = np.random.default_rng(2)
    weak = (0.8, 0.01, np.eye(12)[5], orders)
    found = found_in([plain(rng, [weak] if k in blocks else []) for k in range(N_BLOCK)])
    row.error(found.modes.frequency_hz / [0.33, 0.8, 1.25, 1.9] - 1, 3e-3)


def test_a_mode_of_one_turbine_state_is_found_by_its_state():
    rng = np.random.default_rng(3)
    state = ["rated" if k < 12 else "idling" for k in range(120)]
    stacks = [plain(rng, [(0.8, 0.01, np.eye(12)[5], (18, 20))] if k < 12 else []) for k in range(120)]
    assert len(found_in(stacks).modes.labels) == 3
    assert len(found_in(stacks, state=state).modes.labels) == 4


def test_noise_alone_is_no_mode():
    rng = np.random.default_rng(4)
    with pytest.raises(InputError, match="no pole is stable over the model orders and the 20 blocks"):
        found_in([stack(rng, [], n_noise=30) for _ in range(20)])


def test_a_close_pair_that_turns_with_every_block_is_one_plane():
    """0.5 % apart and turned at random: the chain of directions is the plane, of two modes."""
    rng = np.random.default_rng(5)
    stacks = []
    for _ in range(N_BLOCK):
        a = rng.uniform(0, np.pi)
        first, second = np.zeros(12), np.zeros(12)
        first[:2], second[:2] = (np.cos(a), np.sin(a)), (-np.sin(a), np.cos(a))
        stacks.append(stack(rng, [(0.330, 0.01, first, ORDERS), (0.3317, 0.012, second, ORDERS),
                                  (1.25, 0.01, np.eye(12)[4], ORDERS)]))
    found = found_in(stacks).modes
    assert found.labels == ("1", "2", "3") and found.pairs == ((0, 1),)
    assert plane_mac(found.shape[:, [0, 1]], np.eye(12)[:, :2]) > 0.99


@pytest.mark.parametrize("seed", range(6))
def test_a_pair_that_turns_from_order_to_order_of_one_block_is_two_modes(seed, validation):
    checked = validation(what="a close pair whose shapes turn from order to order of one block: frequencies, plane",
                         reference="two modes")
    rng, rows = np.random.default_rng(seed), []
    for order, turn in zip(ORDERS, rng.uniform(0, np.pi / 2, len(ORDERS)), strict=True):
        plane = np.eye(12)[:2].T @ [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        rows += [(f, 0.01, plane[:, k], (order,)) for k, f in enumerate((0.330, 0.333))]
    found = found_in([stack(rng, [*rows, (1.25, 0.01, np.eye(12)[2], ORDERS)], n_noise=2)])
    checked.error(found.modes.frequency_hz / [0.330, 0.333, 1.25] - 1, below=5e-3, of="frequencies")
    checked.least(plane_mac(found.modes.shape[:, :2], np.eye(12)[:, :2]), above=0.98, of="MAC of the plane")


@pytest.mark.parametrize("blocks", [4, N_BLOCK])
def test_a_third_mode_in_the_plane_of_two_others_is_a_mode(blocks, validation):
    """As torsion and both second bendings of a monopile with its rotor off the axis, seen by tower sensors."""
    row = validation(what="three modes 2.2 and 4.5 % apart with shapes in one plane: frequencies",
                     reference="the modes put in", why="means of draws of 0.2 %")
    rng, frequency = np.random.default_rng(8), np.array([0.782, 0.7995, 0.838, 1.47])
    mixed = (np.eye(12)[0] * np.sin(0.3) + np.eye(12)[1] * np.cos(0.3))
    shapes = (np.eye(12)[0], mixed, np.eye(12)[1], np.eye(12)[4])
    assert mac(mixed, np.eye(12)[1])[0, 0] > 0.9
    found = found_in([stack(rng, [(f * (1 + 5e-4 * rng.standard_normal()), 0.01, shape, ORDERS)
                                  for f, shape in zip(frequency, shapes, strict=True)]) for _ in range(blocks)]).modes
    row.error(found.frequency_hz / frequency - 1, below=2e-3)


def test_a_pair_at_three_headings_of_the_nacelle_is_one_plane():
    """Each heading has two directions of its own, never three at once."""
    rng, stacks = np.random.default_rng(9), []
    for k in range(N_BLOCK):
        a = (0.0, 0.5, 1.0)[k * 3 // N_BLOCK]
        first, second = np.cos(a) * np.eye(12)[0] + np.sin(a) * np.eye(12)[1], (
            np.cos(a) * np.eye(12)[1] - np.sin(a) * np.eye(12)[0])
        stacks.append(stack(rng, [(1.70, 0.01, first, ORDERS), (1.80, 0.01, second, ORDERS)], n_noise=2))
    found = found_in(stacks).modes
    assert found.pairs == ((0, 1),) and plane_mac(found.shape[:, [0, 1]], np.eye(12)[:, :2]) > 0.99


def test_poles_of_one_direction_beside_a_mode_are_no_pair():
    rng = np.random.default_rng(3)
    rows = [(0.330, 0.01, np.eye(12)[0], ORDERS), (0.333, 0.02, np.eye(12)[0], ORDERS),
            (1.25, 0.01, np.eye(12)[2], ORDERS)]
    assert found_in([stack(rng, rows, n_noise=2)]).modes.frequency_hz == pytest.approx([0.33, 1.25], rel=6e-3)


def test_a_step_of_five_percent_stays_one_mode():
    rng = np.random.default_rng(6)
    rows = [[(1.25 * (1 if k < 15 else 0.95), 0.01, np.eye(12)[4], ORDERS)] for k in range(N_BLOCK)]
    found = found_in([stack(rng, row) for row in rows]).modes
    assert found.labels == ("1",) and found.range_hz[0, 0] < 1.19 and found.range_hz[0, 1] > 1.249


def test_what_has_a_strong_mode_s_shape_beside_it_is_its_double_and_said():
    rng = np.random.default_rng(7)
    stacks = [plain(rng, [(1.1, 0.02, np.eye(12)[1], (14, 16, 18))] if k % 3 == 0 else []) for k in range(N_BLOCK)]
    found = found_in(stacks)
    assert len(found.modes.labels) == 3
    assert any(text.startswith("1.100 Hz has the shape of 1.2") for text in found.notes)


def test_a_mode_that_moves_by_a_tenth_near_the_end_is_no_double():
    """It was: two of eight blocks lost it, and a bearing that gave way was found nowhere."""
    rng = np.random.default_rng(7)
    hz = [*MODES_HZ[:1], 1.1, 1.25, *MODES_HZ[2:]]
    stacks = [stack(rng, [(f, 0.01, np.eye(12)[int(f * 2)], ORDERS) for f in hz if f != (1.25 if k > 5 else 1.1)])
              for k in range(8)]
    found = found_in(stacks)
    assert found.modes.frequency_hz == pytest.approx(hz, rel=5e-3) and found.notes == ()


def test_what_the_sea_drives_is_left_out_and_said():
    rng = np.random.default_rng(8)
    stacks = [plain(rng, [(0.45, 0.05, np.eye(12)[5], ORDERS)]) for _ in range(4)]
    assert len(found_in(stacks).modes.labels) == 4
    found = found_in(stacks, wave_hz=[0.44] * 4)
    assert len(found.modes.labels) == 3 and "0.450 Hz lies at the waves' peak" in found.notes[0]
    # hardly damped it is no sea
    light = [plain(rng, [(0.45, 0.01, np.eye(12)[5], ORDERS)]) for _ in range(4)]
    assert len(found_in(light, wave_hz=[0.44] * 4).modes.labels) == 4


def record(speeds_rpm, seed=1):
    """Blocks with three modes and a line at 3P of each block's speed."""
    rng = np.random.default_rng(seed)
    return [plain(rng, [(3 * rpm / 60, 0.01, np.eye(12)[7], ORDERS)]) for rpm in speeds_rpm]


def test_a_line_that_moves_with_the_rotor_is_left_out_and_said():
    # each speed holds in a third of the blocks, enough for its line to pass for a mode
    speeds = np.tile([8.0, 10.0, 12.0], N_BLOCK // 3)
    assert len(found_in(record(speeds)).modes.labels) == 6
    found = found_in(record(speeds), bands=swept(speeds))
    assert found.modes.frequency_hz == pytest.approx(MODES_HZ, rel=3e-3)
    assert [t.split()[0] for t in found.notes] == ["0.400", "0.500", "0.600"]
    assert all("moves with the rotor's speed" in t for t in found.notes)


def test_one_line_that_comes_back_with_two_shapes_is_said_once():
    speeds, rng = np.tile([8.0, 10.0, 12.0], N_BLOCK // 3), np.random.default_rng(1)
    twice = [plain(rng, [(share * 3 * rpm / 60, 0.01, np.eye(12)[k], ORDERS) for share, k in ((1.0, 7), (1.002, 9))])
             for rpm in speeds]
    found = found_in(twice, bands=swept(speeds))
    assert found.modes.frequency_hz == pytest.approx(MODES_HZ, rel=3e-3)
    assert len(found.notes) == 3 and all("moves with the rotor's speed" in t for t in found.notes)


def test_a_mode_that_the_rotor_crosses_now_and_then_stays():
    # 3P passes 0.33 Hz at 6.6 rpm in a third of the blocks
    speeds = np.where(np.arange(N_BLOCK) % 3 == 0, 6.6, 12.0)
    rng = np.random.default_rng(5)
    found = found_in([plain(rng) for _ in range(N_BLOCK)], bands=swept(speeds))
    assert found.modes.frequency_hz == pytest.approx(MODES_HZ, rel=3e-3) and found.notes == ()


def test_at_a_constant_speed_a_line_is_kept_and_doubted():
    speeds = np.full(N_BLOCK, 12.0)
    found = found_in(record(speeds), bands=swept(speeds))
    assert len(found.modes.labels) == 4
    (sentence,) = found.notes
    assert sentence.startswith("0.600 Hz") and "may be its line" in sentence


def test_months_are_thinned_out_evenly_and_rare_states_less():
    state = ["idling"] * 1400 + ["rated"] * 40
    chosen = even_blocks(state)
    assert len(chosen) <= MOST_BLOCKS + 40 and sum(k >= 1400 for k in chosen) == 40
    assert max(np.diff([k for k in chosen if k < 1400])) <= 3
    assert even_blocks(state[:100]) == list(range(100))


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="share: 0 is not in"):
        PersistenceSettings(share=0)


def test_what_became_of_harmonics_is_counted():
    notes = [f"{TAKEN_OUT}3P, 6P"] * 3 + [f"{TAKEN_OUT}3P"]
    notes += [f"{STAY}the rotor stood or idled: {rpm} rpm" for rpm in (0.3, 1)]
    assert harmonics_removed([*notes, "gaps of up to 1 s interpolated"]) == [
        "harmonics taken out in 4 of 6 blocks: 3P in 4, 6P in 3",
        "harmonics stay in 2 blocks: the rotor stood or idled"]
    assert harmonics_removed(["gaps"]) == []


def of_three_channels(rng, steady):
    """Two modes of one direction at three channels, 8 % apart; the second keeps its place, or strays by 1 %."""
    rows = []
    for _ in range(12):
        one, two = 1.25 * (1 + 5e-4 * rng.standard_normal()), 1.35 * (1 + (5e-4 if steady else 0.01)
                                                                      * rng.standard_normal())
        shape = np.array([[-0.6, 1.0, 0.8], [-0.6, 1.0, 0.8]]) + 0.01 * rng.standard_normal((2, 3))
        orders = np.array([*ORDERS, *ORDERS[1:4]])
        frequency = np.array([*[one] * len(ORDERS), *[two] * 3])
        rows.append(PoleStack(order=orders, frequency_hz=frequency, damping_ratio=np.full(8, 0.01),
                              shape=shape[[*[0] * len(ORDERS), 1, 1, 1]].T.astype(complex)))
    return rows


@pytest.mark.parametrize("seed", range(5))
def test_of_three_channels_what_strays_beside_a_mode_is_its_double(seed):
    rng = np.random.default_rng(seed)
    assert found_in(of_three_channels(rng, steady=True)).modes.frequency_hz == pytest.approx([1.25, 1.35], rel=2e-3)
    strays = found_in(of_three_channels(rng, steady=False))
    assert strays.modes.frequency_hz == pytest.approx([1.25], rel=2e-3)


@pytest.mark.parametrize("damping", [3e-5, 1e-4, 2e-3])
def test_a_line_is_said_of_the_mode_that_it_is(damping):
    rng = np.random.default_rng(4)
    found = found_in([plain(rng, [(0.4, damping, np.eye(12)[5], ORDERS)]) for _ in range(N_BLOCK)])
    assert np.min(np.abs(found.modes.frequency_hz / 0.4 - 1)) < 2e-3
    said = [note for note in found.notes if "a machine's line" in note]
    assert bool(said) == (damping < 1e-3) and all(note.startswith("0.400 Hz has a damping of") for note in said)


@pytest.mark.parametrize(("scatter", "kept"), [(0.0006, True), (0.005, True), (0.03, False)])
def test_what_stands_at_other_frequencies_in_each_block_is_no_mode(scatter, kept):
    """ln f of eight blocks of half an hour: a mode of 8.3 Hz scatters by 0.0006, one that temperature moves by more;
    poles of noise that happen to come back scatter over their cluster."""
    steps = np.diff(scatter * np.random.default_rng(0).standard_normal(9))
    assert stays(steps, 8.3, 0.012, 1800.0) == kept
    assert stays(steps[:3], 8.3, 0.012, 1800.0)
