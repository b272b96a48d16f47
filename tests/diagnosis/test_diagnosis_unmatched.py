"""Modes that are in most sets and none of the model's: a mass on springs that it lacks, or something else."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg, stats

import probupdate
from probupdate.diagnosis import unmatched
from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.elementary import PART_CAUSES, elementary, parts_of
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import DISCREPANCY_PHASE, diagnosis_problem
from probupdate.diagnosis.run import ModelSource, diagnose_files, read_groups
from probupdate.diagnosis.unmatched import anywhere, group_of_label, noise_of_sets, unmatched_modes, with_unmatched
from probupdate.diagnosis.wording import SELDOM
from probupdate.errors import ConvergenceError
from probupdate.modal.modes import ModalData, ModalSet, ModeRecord
from tests.diagnosis.conftest import (
    CHANNELS,
    HEIGHT,
    MASS,
    N_BLOCK,
    N_STOREY,
    moving_most,
    storeys,
    with_mass_on_spring,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "studies" / "other_worlds"))
from campaigns import write_campaign
from records import draw_record

LABELS = ("A", "B", "C", "D", "E", "F", "7")


def sets_of(rng, state):
    """Blocks of a frame in which seven modes were identified. `state`: block's number -> f (7,), shapes (10, 7)."""
    sets = []
    for b in range(N_BLOCK):
        f, phi = state(b)
        f, phi = np.array(f), phi / np.max(np.abs(phi), axis=0)
        sets.append(ModalSet(
            id=str(np.datetime64("2026-01-01T00:00:00") + np.timedelta64(30 * b, "m")),
            frequency_hz=f * (1 + 1e-3 * rng.standard_normal(7)), damping_ratio=np.full(7, 0.01),
            shape=(phi + 5e-3 * rng.standard_normal(phi.shape)).astype(complex), frequency_std_hz=1e-3 * f,
            shape_std=np.full(phi.shape, 5e-3)))
    found = [int(sum(np.isfinite(s.frequency_hz[j]) for s in sets)) for j in range(7)]
    records = tuple(ModeRecord(label=label, frequency_hz=float(np.nanmean([s.frequency_hz[j] for s in sets])),
                               found=found[j], blocks=N_BLOCK, match="none" if label == "7" else "alike")
                    for j, label in enumerate(LABELS))
    return ModalData(channels=CHANNELS, sets=tuple(sets), labels=LABELS, records=records)


def frame_modes(*, mass=0.0, hz=0.0, storey=4, scale=1.0):
    """f and shapes of the lowest seven modes of a frame on a storey of which a mass hangs along x, by its own degree of
    freedom; that in which the mass moves most against all storeys last."""
    K, M = storeys(scale * np.ones(N_STOREY), scale * np.ones(N_STOREY), MASS * np.ones(N_STOREY))
    if not mass:
        value, phi = linalg.eigh(K, M, subset_by_index=(0, 6))
        return np.sqrt(value) / (2 * np.pi), phi
    value, phi = linalg.eigh(*with_mass_on_spring(K, M, mass, hz, storey), subset_by_index=(0, 6))
    apart = moving_most(phi)
    order = [*(k for k in range(7) if k != apart), apart]
    return (np.sqrt(value) / (2 * np.pi))[order], phi[:-1, order]


def hung(seed, *, mass, storey, from_block):
    rng = np.random.default_rng(seed)
    scale, hz = 1 + 0.02 * rng.standard_normal(), 1.15 * frame_modes()[0][0]

    def state(b):
        f, phi = frame_modes(mass=mass if b >= from_block else 0.0, hz=hz, storey=storey, scale=scale)
        if b < from_block:
            f, phi = np.append(f[:6], np.nan), np.column_stack([phi[:, :6], np.full(len(phi), np.nan)])
        return f, phi

    return sets_of(rng, state), hz


@pytest.mark.parametrize(("mass", "storey", "from_block"), [(150.0, 4, 0), (120.0, 3, 10)])
def test_a_mode_that_the_model_lacks_is_a_mass_on_springs(pictured_frame, mass, storey, from_block, validation):
    """Its place, size, frequency and onset, where the model as it is takes up what the other modes show (*none*) or
    names nothing; the frame's own equations have the mass as a degree of freedom."""
    row = validation(what="a mass of 120 or 150 kg on a spring along x at storey 4 or 5 of a frame, all through the "
                          "record or from block 10 on, whose own mode is identified too and none of the model's: "
                          "verdict, part, place, direction, onset; size and frequency in their standard deviations; "
                          "MAC of the computed mode", reference="what was hidden")
    data, hz = hung(5, mass=mass, storey=storey, from_block=from_block)
    found = diagnose_files(ModelSource(model=pictured_frame), data, extend=False)
    (part,) = found.details["free_form"]["parts"]
    place, direction = part["location"].rsplit(", ", 1)
    row.equal((found.verdict, part["cause"], place, direction, part["since"]),
              ("unexplained", PART_CAUSES[3], f"(0.0, 0.0, {HEIGHT * (storey + 1):.1f}) m", "along 0 deg",
               data.sets[from_block].id if from_block else ""), "part")
    row.error((part["size"] - mass) / part["size_std"], 3, "size")
    row.error((part["frequency_hz"] - hz) / part["frequency_std_hz"], 3, "frequency")
    row.error(1 - part["has_mode"]["mac"], 0.01, "1 - MAC")
    assert any("a mass on springs explains it" in note for note in found.notes)
    assert ("lacks one that is in most sets" in found.summary) == (found.p_value >= SELDOM)
    assert "it has mode 7 at" in found.summary


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3, 4, 5))])
def test_a_mode_of_something_else_is_none(pictured_frame, seed, validation):
    """Nothing hidden, and a mode of any frequency and shape beside it (a cable, a machine that sways by itself)."""
    row = validation(what="nothing hidden in a frame, and beside its modes one of any frequency and shape: verdict; "
                          "probability that a mass on springs has it", reference="none; zero")
    rng = np.random.default_rng(seed)
    f, phi = frame_modes(scale=1 + 0.02 * rng.standard_normal())
    other = np.exp(rng.uniform(*np.log(f[[0, 5]]))), rng.standard_normal(len(phi))
    data = sets_of(rng, lambda b: (np.append(f[:6], other[0]), np.column_stack([phi[:, :6], other[1]])))
    known = examine(pictured_frame, data)
    (said,) = unmatched_modes(pictured_frame, known, data)
    row.error(said.of_mass, 1e-3, "probability")
    found = with_unmatched(known.diagnosis, [said])
    row.equal((found.verdict, "free_form" in found.details), ("none", False), "verdict")
    assert any("no mass on springs" in note for note in found.notes)


def test_a_mode_of_the_model_that_was_not_recognised_is_none_of_something_else(pictured_frame, validation):
    """The fifth mode of the frame, of a number by its identification: a light mass tuned to it would have it too."""
    row = validation(what="nothing hidden in a frame, one of its modes taken for none of the model's: verdict; "
                          "probability that it is the model's own", reference="none; one")
    f, phi = frame_modes(scale=1.01)
    order = [0, 1, 2, 3, 5, 6, 4]
    data = sets_of(np.random.default_rng(4), lambda b: (f[order], phi[:, order]))
    known = examine(pictured_frame, data)
    (said,) = unmatched_modes(pictured_frame, known, data)
    row.least(said.of_model, 0.9, "probability")
    found = with_unmatched(known.diagnosis, [said])
    row.equal((found.verdict, "free_form" in found.details), ("none", False), "verdict")
    assert any("no measured mode was recognised as" in note for note in found.notes)


def test_the_price_of_a_mode_of_something_else(pictured_frame, validation):
    """Against the covariance of all numbers of all blocks written out, with the uniform prior as a normal one."""
    row = validation(what="ln p of a mode of any frequency and shape", reference="one normal density of all numbers of "
                     "all blocks", why="rounding: its covariance is of condition 1e7")
    data, _ = hung(7, mass=150.0, storey=4, from_block=0)
    problem, _ = diagnosis_problem(pictured_frame, data, ("7",))
    q, noise = group_of_label(problem, "7"), noise_of_sets(problem)
    y, used = problem.measured[0][q], problem.measured[1][q]
    y, weight = y[used], noise.weight[q][used]
    y = y[weight > 0]
    weight = weight[weight > 0]
    axis, n = problem.predictor.axes[q][:, 0], len(CHANNELS)
    hz = np.array([r.frequency_hz for r in data.records])
    reach = max(np.log(hz.max() / hz.min()), 1.0)
    half_sphere = 0.5 * 2 * np.pi ** (n / 2) / np.prod(np.arange(1, n // 2))
    std = (np.linalg.norm(axis) ** (n - 1) * half_sphere / (2 * np.pi) ** ((n - 1) / 2)) ** (1 / (n - 1))
    across = std**2 * (np.eye(n) - np.outer(axis, axis) / (axis @ axis))
    prior = np.zeros((1 + 2 * n, 1 + 2 * n))
    prior[0, 0], prior[1 : 1 + n, 1 : 1 + n] = reach**2 / (2 * np.pi), across
    prior[1 + n :, 1 + n :] = DISCREPANCY_PHASE**2 * np.eye(n)
    V = np.kron(np.ones((len(y), len(y))), prior) + np.kron(np.diag(1 / weight), noise.covariance[q])
    mean = np.tile(np.append(np.average(y[:, 0], weights=weight), np.zeros(2 * n)), len(y))
    expected = stats.multivariate_normal(mean, V).logpdf(y.ravel()) + 0.5 * y.size * np.log(2 * np.pi)
    row.error(anywhere(problem, noise, q) / expected - 1, 1e-8, "ln p, relative")


@pytest.mark.parametrize("number", [66, *(pytest.param(one, marks=pytest.mark.long) for one in (2, 15, 16, 34))])
def test_accelerations_of_structures_with_a_tuned_mass(number, tmp_path, validation):
    """Of trusses, a beam and storeys drawn at random, whose models have no picture: the mass hangs at a channel. In 66
    a stiffness of the truss had been *named* for what the mass does to the other modes."""
    row = validation(what="accelerations of a truss with a tuned mass (long: of another, of a beam and, from a block "
                          "on, of a truss and storeys too), by `identify` and `diagnose`: verdict, channel, onset; "
                          "mass and frequency in their standard deviations", reference="what was hidden")
    record = draw_record("tuned mass", number)
    path = record.world.write(tmp_path / "model")
    campaign = write_campaign(record, tmp_path / "campaign")
    data = probupdate.identify(campaign, path, lowest=record.world.n_mode).data
    groups = read_groups(path.with_name("groups.toml")) if record.world.groups else None
    found = probupdate.diagnose(prepare(path, groups=groups, sensors=record.world.sensors), data, extend=False)
    (part,) = found.details["free_form"]["parts"]
    K, M = record.scene.state(10**6)
    dof = int(np.argmin(K[-1, :-1]))
    channel = record.world.sensors[int(np.argmax(np.abs(record.world.rows[:, dof])))].channel
    row.equal((found.verdict, part["cause"], part["location"].split(", ")[0], part["time_profile"]),
              ("unexplained", PART_CAUSES[3], f"channel {channel}", record.time_profile), "part")
    row.error((part["size"] - M[-1, -1]) / part["size_std"], 3, "mass")
    own_hz = np.sqrt(K[-1, -1] / M[-1, -1]) / (2 * np.pi)
    row.error((part["frequency_hz"] - own_hz) / part["frequency_std_hz"], 3, "frequency")


def test_few_sets_few_shapes_and_models_of_few_modes_are_not_searched(pictured_frame):
    data, _ = hung(9, mass=150.0, storey=4, from_block=0)
    known = examine(pictured_frame, data)
    few = replace(known, problem=replace(known.problem, blocks=replace(known.problem.blocks, few=True)))
    assert unmatched_modes(pictured_frame, few, data) == []
    gone = [int(k) for k in np.arange(N_BLOCK) if k % 8]
    lacking = [replace(s, shape=np.where(np.arange(7) == 6, np.nan, s.shape)) if k in gone else s
               for k, s in enumerate(data.sets)]
    assert unmatched_modes(pictured_frame, known, replace(data, sets=tuple(lacking))) == []
    small = replace(pictured_frame, small=replace(pictured_frame.small, n_search=6))
    assert unmatched_modes(small, known, data) == []


def test_masses_on_springs_with_which_no_fit_can_begin_are_left_out(pictured_frame, monkeypatch):
    def no_modes(*_):
        raise ConvergenceError("no modes on the small basis", np.zeros(1))

    data, _ = hung(9, mass=150.0, storey=4, from_block=0)
    problem, _ = diagnosis_problem(pictured_frame, data)
    parts = elementary(pictured_frame.small, str, heights=2)
    assert unmatched.initialise_tuned_mass(problem, noise_of_sets(problem), parts)
    monkeypatch.setattr(unmatched, "first_steps", no_modes)
    assert not unmatched.initialise_tuned_mass(problem, noise_of_sets(problem), parts)


def test_first_steps_are_made_at_the_heading_known_best(pictured_frame):
    problem, _ = diagnosis_problem(pictured_frame, hung(9, mass=150.0, storey=4, from_block=0)[0])
    angle = 40.0 * np.arange(N_BLOCK)
    angle[4:12], angle[[14, 15, 16, *range(24, 30)]] = 90.0, 270.0
    turned = replace(problem, blocks=replace(problem.blocks, angle_deg=angle))
    assert unmatched.blocks_at_one_heading(turned).tolist() == [14, 15, 16, *range(24, 30)]


def test_a_channel_that_no_mode_moves_is_no_place_for_parts(pictured_frame):
    rows = np.array(pictured_frame.small.at_channels)
    rows[0] = 0.0
    bare = replace(pictured_frame, small=replace(pictured_frame.small, wire=None, at_channels=rows))
    places = {effect.location for effect, _ in parts_of(bare)}
    assert places == {f"channel {name}, along it" for name in CHANNELS[1:]}
