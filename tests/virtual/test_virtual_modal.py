"""Modal sets without vibration: against full solutions, against the noise they claim, and themselves again."""

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.modal.modes import read_modes, write_modes
from probupdate.virtual import dynamics, frame, modal_blocks, modal_noise, turbine_file

BUSY = {
    "parameters_from": "prior",
    "effect": [
        {"kind": "wetted_length", "gain": 1.0},
        {"kind": "scour", "leg": "B", "depth_m": 1.5, "time_profile": "ramp", "from_hour": 10.0, "to_hour": 100.0},
        {"kind": "brace_stiffness", "bay": 2, "face": "BC", "factor": 0.4, "time_profile": "step", "at_hour": 60.0},
        {"kind": "rna_mass", "mass_kg": 3000.0, "time_profile": "step", "at_hour": 30.0},
        {"kind": "sensor_gain", "channel": "T66-x", "factor": 0.9},
    ],
}


@pytest.fixture(scope="module")
def busy():
    return modal_blocks.simulate_modes(truth=BUSY, seed=3, days=6, n_block=12)


def test_the_small_basis_gives_what_the_structure_gives(busy, validation):
    """Frequencies within a tenth of what a month's mean of an identification resolves, shapes likewise."""
    checked = validation(what="modal sets from a small basis, four varying effects", reference="the whole structure",
                         why="a tenth of what a month's mean resolves")
    file = turbine_file.read_turbine(turbine_file.reference_file())
    for k in (6, 11):
        structure = frame.build_structure(file, busy.truth, busy.amount[k])
        full = dynamics.heading_modes(structure, busy.truth.damping_ratio, busy.heading_deg[k])
        checked.error(busy.frequency_hz[k][:3] / full.frequency_hz[:3] - 1, below=1e-4, of="first three f")
        found = np.argmin(np.abs(full.frequency_hz[:, None] - busy.frequency_hz[k]), axis=0)
        checked.error(busy.frequency_hz[k] / full.frequency_hz[found] - 1, below=3e-4, of="all f")
        assert busy.damping_ratio[k] == pytest.approx(full.damping_ratio["idling"][found], rel=0.02)
        for j, i in enumerate(found):
            ours, theirs = busy.shape[k][:, j].real, full.observed_shape[:, i]
            theirs = theirs * np.sign(ours @ theirs)
            # the close pair turns by (error of eigenvalue) / (their distance)
            checked.error((ours - theirs) / np.abs(theirs).max(), below=0.01, of="shapes")


def test_columns_stay_with_their_modes():
    """Headings a quarter turn apart: each column is one mode of the structure, no higher one that looks alike."""
    run = modal_blocks.simulate_modes(truth={"parameters_from": "prior"}, seed=1, days=30, n_block=24, scatter=0.0)
    assert np.ptp(run.heading_deg) > 60
    assert np.all(np.ptp(np.log(run.frequency_hz), axis=0) < 0.02)
    assert np.all(run.frequency_hz[:, 2] < 1.6)


@pytest.mark.parametrize("effect", [
    {"kind": "tuned_mass", "z_m": 60.0, "direction_deg": 80.0, "frequency_hz": 1.4, "mass_kg": 8e3},
    {"kind": "second_structure", "leg": "B", "z_m": 8.0, "frequency_hz": 1.2, "mass_kg": 3e4},
])
def test_what_hangs_on_springs_is_there_from_its_hour_and_no_mode_of_the_five(effect, validation):
    """Before its hour a mass of a gram, whose mode no sensor sees, changes nothing; after it the five are the modes of
    the whole structure with the most of their strain energy in common with those of the structure without it."""
    checked = validation(what="modal sets before and after a mass on springs", reference="the whole structure",
                         why="a tenth of what a month's mean resolves")
    seed, times = 7, {"days": 6, "n_block": 8, "scatter": 0.0}
    late = {**effect, "time_profile": "step", "at_hour": 72.0}
    with_it = modal_blocks.simulate_modes(truth={"parameters_from": "prior", "effect": [late]}, seed=seed, **times)
    without = modal_blocks.simulate_modes(truth={"parameters_from": "prior"}, seed=seed, **times)
    before = with_it.amount[:, 0] == 0
    assert 0 < before.sum() < len(before)
    checked.error(with_it.frequency_hz[before] / without.frequency_hz[before] - 1, below=1e-4, of="f before")
    file = turbine_file.read_turbine(turbine_file.reference_file())
    heading, damping = with_it.heading_deg[-1], with_it.truth.damping_ratio
    there = frame.build_structure(file, with_it.truth, with_it.amount[-1])
    full = dynamics.heading_modes(there, damping, heading)
    alone = frame.build_structure(file, without.truth, np.zeros(0))
    plain = dynamics.heading_modes(alone, damping, heading)
    n = alone.stiffness.shape[0]
    # in units of modal mass the strain energy of a mode is half its squared angular frequency
    own = [(2 * np.pi * m.frequency_hz) ** 2 for m in (plain, full)]
    common = (plain.shape.T @ alone.stiffness @ full.shape[:n]) ** 2 / np.outer(*own)
    five = [int(np.argmin(np.abs(plain.frequency_hz - f))) for f in without.frequency_hz[-1]]
    first, torsion, second = five[:2], five[2:3], five[3:]
    most = [set(np.argsort(-common[group].sum(axis=0))[: len(group)].tolist()) for group in (first, torsion, second)]
    found = np.sort(with_it.frequency_hz[-1])
    wanted = np.sort(full.frequency_hz[sorted(set.union(*most))])
    assert len(wanted) == 5
    checked.error(found / wanted - 1, below=3e-4, of="f after")


def test_effects_take_their_time_profile(busy):
    hour = (np.array([np.datetime64(s.id[:-1]) for s in busy.data.sets]) - modal_blocks.START) / np.timedelta64(1, "h")
    level = [s.environment["water_level_m"] for s in busy.data.sets]
    assert busy.amount[:, 0] == pytest.approx(level, abs=1e-3)
    assert busy.amount[:, 1] == pytest.approx(np.clip((hour + 0.25 - 10) / 90, 0, 1), abs=1e-9)
    assert np.array_equal(busy.amount[:, 2] > 0.5, hour >= 60)
    assert np.all(busy.amount[:, 4] == 1)


def test_same_seed_same_sets_and_another_seed_others(busy, tmp_path):
    again = modal_blocks.simulate_modes(truth=BUSY, seed=3, days=6, n_block=12)
    other = modal_blocks.simulate_modes(truth={"parameters_from": "prior"}, seed=4, days=1, n_block=2)
    for a, b in zip(busy.data.sets, again.data.sets, strict=True):
        assert np.array_equal(a.shape, b.shape, equal_nan=True) and a.environment == b.environment
    assert other.frequency_hz[0, 0] != busy.frequency_hz[0, 0]
    write_modes(busy.data, tmp_path / "modes.json")
    back = read_modes(tmp_path / "modes.json")
    assert back.channels == busy.data.channels and back.labels == busy.data.labels
    assert back.sets[2].frequency_std_hz == pytest.approx(busy.data.sets[2].frequency_std_hz, nan_ok=True)


def test_scatter_is_as_large_as_it_says(validation):
    """400 identifications of one state: their scatter against the law of its size and against their own estimates."""
    checked = validation(what="their scatter, 400 draws; what each states; shapes of a pair",
                         reference="the law that they are drawn by", why="four standard deviations of the first")
    rng = np.random.default_rng(8)
    frequency, damping = np.array([0.308, 0.320, 1.32, 1.93, 2.03]), np.full(5, 0.012)
    shape = np.linalg.qr(rng.standard_normal((18, 5)))[0]
    labels = modal_blocks.LABELS
    runs = [modal_noise.identified_modes(frequency, damping, shape, labels, 1800.0, rng) for _ in range(400)]
    f = np.array([r[0] for r in runs])
    entries = np.array([np.sqrt((r[3].ln_frequency**2).sum(axis=1)) for r in runs])
    law = modal_noise.ln_frequency_std(frequency, damping, 1800.0, labels)
    # standard deviation of a standard deviation from 400 runs 3.5 %; four of them
    checked.error(np.std(np.log(f), axis=0) / law - 1, below=0.14, of="scatter")
    checked.error(np.sqrt((entries**2).mean(axis=0)) / law - 1, below=0.05, of="stated")
    # the second pair is 5 % apart: its shapes scatter as its first-order estimate says
    scatter = np.std(np.array([r[2][:, 3].real for r in runs]), axis=0)
    estimate = np.sqrt(np.mean([(r[3].shape[:, 3].real ** 2).sum(axis=1) for r in runs], axis=0))
    moving = estimate > 0.02
    assert moving.sum() > 5
    checked.error(scatter[moving] / estimate[moving] - 1, below=0.25, of="shapes")
    still = modal_noise.identified_modes(frequency, damping, shape, labels, 1800.0, rng, scale=0.0)
    assert still[0] == pytest.approx(frequency, rel=1e-12) and still[1] == pytest.approx(damping, rel=1e-9)


def test_sensor_faults_reach_the_shapes_and_nothing_else():
    def run(**effect):
        truth = {"effect": [effect]} if effect else {}
        return modal_blocks.simulate_modes(truth=truth, seed=5, days=1, n_block=2, scatter=0.0, missing_share=0.0)

    plain = run()
    names = plain.data.channels
    clock = run(kind="clock_offset", level="tower top", offset_s=0.02)
    rows = [names.index("T90-x"), names.index("T90-y")]
    turned = clock.shape[0] / plain.shape[0]
    expected = np.exp(2j * np.pi * clock.frequency_hz[0] * 0.02)
    assert turned[rows] == pytest.approx(np.tile(expected, (2, 1)), rel=1e-6)
    assert np.array_equal(np.delete(clock.shape, rows, axis=1), np.delete(plain.shape, rows, axis=1))
    swap = run(kind="sensor_swap", channel="TP-A-x", other="TP-C-y", swapped=1)
    i, j = names.index("TP-A-x"), names.index("TP-C-y")
    assert swap.shape[:, i] == pytest.approx(plain.shape[:, j]) and swap.shape[:, j] == pytest.approx(plain.shape[:, i])
    rate = run(kind="sampling_rate", ratio=1.03)
    assert rate.frequency_hz == pytest.approx(plain.frequency_hz / 1.03, rel=1e-9)
    looks = run(kind="heading_offset", angle_deg=10.0)
    entries = [s.environment["nacelle_angle_deg"] for s in looks.data.sets]
    true = [s.environment["nacelle_angle_deg"] for s in plain.data.sets]
    assert (np.array(entries) - true) % 360 == pytest.approx(np.full(2, 350.0))
    assert looks.frequency_hz == pytest.approx(plain.frequency_hz)


def test_mistakes_are_one_line():
    for how, says in (
        ({"states": ("idle",)}, "choose from"),
        ({"truth": {"effect": [{"kind": "scour", "leg": "E", "depth_m": 1.0}]}}, "did you mean|choose from"),
        ({"truth": {"effect": [{"kind": "scour", "leg": "A", "depth_m": -1.0}]}}, "not in"),
        ({"truth": {"effect": [{"kind": "scour", "leg": "A", "depth_m": 1.0, "time_profile": "step"}]}}, "at_hour"),
        ({"truth": {"effect": [{"kind": "scour", "leg": "A", "depth_m": 1.0, "at_hour": 3}]}}, "unknown"),
        ({"truth": {"effect": [{"kind": "icing", "mass_kg": 1e3, "time_profile": "covariate", "covariate": "ice",
                                "reference": 0.0, "scale": 1.0}]}}, "covariate"),
    ):
        with pytest.raises(InputError, match=says):
            modal_blocks.simulate_modes(seed=1, days=1, **how)
