"""What no row explains as elementary parts: on a frame whose records come from other equations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from probupdate.diagnosis import diagnose
from probupdate.diagnosis import elementary as elementary_parts
from probupdate.diagnosis import free_form as free_form_module
from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.elementary import PART_CAUSES, alternative_parts, elementary, points
from probupdate.diagnosis.fitting import fitted_without_candidates
from probupdate.diagnosis.free_form import free_form
from probupdate.diagnosis.gain import SIGNIFICANT, measures
from probupdate.diagnosis.part_places import PartKey
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.diagnosis.proposals import changed_together
from probupdate.diagnosis.ranking import log_prior
from probupdate.diagnosis.results import Alternative, Finding
from probupdate.diagnosis.small_model import N_CORE, Attachment
from probupdate.diagnosis.wording import free_form_words
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.interface import Wireframe
from probupdate.runtime.executors import processes
from probupdate.structure.load import reference_model
from probupdate.structure.parameter_table import read_parameters
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


@pytest.fixture(name="frame", scope="module")
def _frame(pictured_frame):
    return pictured_frame


def block(rng, number, value, phi):
    """The modal set of a block: eigenvalues (6,) and shapes (10, 6) as identified."""
    phi = phi / np.max(np.abs(phi), axis=0)
    f = np.sqrt(value) / (2 * np.pi)
    return ModalSet(
        id=str(np.datetime64("2026-01-01T00:00:00") + np.timedelta64(30 * number, "m")),
        frequency_hz=f * (1 + 1e-3 * rng.standard_normal(6)), damping_ratio=np.full(6, 0.01),
        shape=(phi + 5e-3 * rng.standard_normal(phi.shape)).astype(complex), frequency_std_hz=1e-3 * f,
        shape_std=np.full(phi.shape, 5e-3),
    )


def record(seed, *, spring=0.0, mass=0.0, storey=3, from_block=20):
    """Blocks of a frame that from one on has a spring to ground along x, or a mass, at a storey."""
    rng = np.random.default_rng(seed)
    base, sets = 1 + 0.02 * rng.standard_normal(N_STOREY), []
    for b in range(N_BLOCK):
        masses = MASS * np.ones(N_STOREY)
        masses[storey] += mass * (b >= from_block)
        K, M = storeys(base, base, masses)
        K[2 * storey, 2 * storey] += spring * (b >= from_block)
        value, phi = linalg.eigh(K, M, subset_by_index=(0, 5))
        sets.append(block(rng, b, value, phi))
    return ModalData(channels=CHANNELS, sets=tuple(sets))


@pytest.mark.parametrize(("hidden", "cause", "where"), [
    ({"spring": 5e4}, PART_CAUSES[0], "(0.0, 0.0, 12.0) m, along 0 deg"),
    pytest.param({"spring": 3e5}, PART_CAUSES[0], "(0.0, 0.0, 12.0) m, along 0 deg", marks=pytest.mark.long),
    pytest.param({"mass": 250.0, "storey": 1}, PART_CAUSES[2], "(0.0, 0.0, 6.0) m", marks=pytest.mark.long),
])
def test_a_part_outside_the_catalogue_is_placed_and_sized(frame, hidden, cause, where, validation):
    row = validation(what="a spring to ground (50 kN/m, long: 300, at storey 4, along x), a mass (250 kg at storey 2) "
                          "from block 20 on, in no row of the catalogue: part, place, time profile, onset; size in its "
                          "standard deviations, its relative standard deviation; held-out gain over its standard "
                          "error",
                     reference="what was hidden")
    data = record(3, **hidden)
    known = examine(frame, data)
    assert known.diagnosis.verdict != "named"
    found = free_form(frame, known, data)
    (part,) = found.content["parts"]
    row.equal((part["cause"], part["location"], part["time_profile"], part["since"], part["elementary"]),
              (cause, where, "step", data.sets[20].id, True), "part")
    size = hidden.get("spring") or hidden["mass"]
    row.error((part["size"] - size) / part["size_std"], 3, "size", case=cause)
    row.error(part["size_std"] / size, 0.3, "its standard deviation", case=cause)
    assert found.content["complete"]
    # a spring makes modes along x faster, a mass all of them slower
    assert part["modes"] and all((m["frequency_percent"] > 0) == ("spring" in hidden) for m in part["modes"])
    outcome = found.outcome
    gain = measures(outcome.problem, outcome.null, outcome.fitted, noise=outcome.null.design.noise)
    row.least(gain["heldout_elpd"] / gain["heldout_elpd_se"], SIGNIFICANT, "gain")
    assert gain["significant"]
    said = free_form_words({"details": {"free_form": found.content | {"gain": gain}}})
    article = "an" if cause == PART_CAUSES[2] else "a"
    assert said[0].startswith(f"something like {article} {cause}, {where}") and "no row of the catalogue" in said[1]


@pytest.mark.parametrize(("storey", "starts"), [("k1", (0.5, 4.0)), ("k2", (0.5, 4.0, -4.0))])
def test_fits_that_went_to_and_fro_settle_at_one_place(frame, storey, starts, validation):
    """A storey is none of what happened, so that much is left over. What is not known of its effect grows with its
    size, and from each of two points the other one is better: of these five fits four were still on their way after
    forty steps, at other sizes and parameters."""
    row = validation(what="a storey's change fitted to a record of something else, begun at two and three sizes: fits "
                          "that settle; largest difference of sizes, in the effect's own standard deviations",
                     reference="one another", why="steps of a tenth of a standard deviation end a fit")
    problem, theta = diagnosis_problem(frame, record(3, spring=3e5))
    effect = next(e for e in problem.effects if e.parameter == storey)
    step = min((profile for profile in problem.time_profiles if profile.kind == "step"),
               key=lambda profile: abs(profile.at - 20))
    null = fitted_without_candidates(problem, theta)
    fitted = [fitted_without_candidates(problem, null.theta, [
        IncludedEffect(effect=effect, time_profile=step, size=start * effect.prior_scale)]) for start in starts]
    row.equal([one.settled for one in fitted], [True] * len(starts), "settled", case=storey)
    row.error(np.ptp([one.included[0].size for one in fitted]) / effect.prior_scale, 0.2, "sizes", case=storey)


def hung_record(seed, *, mass, hz, storey, from_block=20):
    """Blocks of a frame on a storey of which a mass hangs along x from one block on, its own degree of freedom among
    the equations; of the modes the one in which that mass moves most, against all storeys, is not identified."""
    rng = np.random.default_rng(seed)
    base, sets = 1 + 0.02 * rng.standard_normal(N_STOREY), []
    for b in range(N_BLOCK):
        K, M = storeys(base, base, MASS * np.ones(N_STOREY))
        if b >= from_block:
            K, M = with_mass_on_spring(K, M, mass, hz, storey)
        value, phi = linalg.eigh(K, M, subset_by_index=(0, 6))
        apart = moving_most(phi) if b >= from_block else 6
        value, phi = np.delete(value, apart), np.delete(phi[: 2 * N_STOREY], apart, axis=1)
        sets.append(block(rng, b, value, phi))
    return ModalData(channels=CHANNELS, sets=tuple(sets))


@pytest.mark.long
def test_a_mass_on_springs_is_placed_sized_and_its_frequency_estimated(frame, validation):
    row = validation(what="a mass of 150 kg on a spring along x at storey 5, at 1.15 times the first frequency, from "
                          "block 20 on: part and place; size and ln of its frequency in their standard deviations and "
                          "relative; held-out gain over its standard error", reference="what was hidden")
    K, M = storeys(np.ones(N_STOREY), np.ones(N_STOREY), MASS * np.ones(N_STOREY))
    hz = 1.15 * np.sqrt(linalg.eigvalsh(K, M)[0]) / (2 * np.pi)
    data = hung_record(3, mass=150.0, hz=hz, storey=4)
    found = free_form(frame, examine(frame, data), data)
    (part,) = found.content["parts"]
    place, direction, _ = part["location"].rsplit(", ", 2)
    row.equal((part["cause"], place, direction, part["since"]),
              (PART_CAUSES[3], "(0.0, 0.0, 15.0) m", "along 0 deg", data.sets[20].id), "part")
    row.error((part["size"] - 150.0) / part["size_std"], 3, "size")
    row.error(part["size_std"] / 150.0, 0.3, "its standard deviation")
    row.error((part["frequency_hz"] - hz) / part["frequency_std_hz"], 3, "frequency")
    row.error(part["frequency_std_hz"] / hz, 0.04, "its standard deviation, relative")
    outcome = found.outcome
    gain = measures(outcome.problem, outcome.null, outcome.fitted, noise=outcome.null.design.noise)
    row.least(gain["heldout_elpd"] / gain["heldout_elpd_se"], SIGNIFICANT, "gain")
    said = free_form_words({"details": {"free_form": found.content | {"gain": gain}}})
    assert f"by itself at {part['frequency_hz']:.3g}" in said[0] and "no row of the catalogue" in said[1]


def test_a_plane_model_has_parts_along_its_plane_alone(tmp_path):
    """Of a model that knows no motion along y a spring "along 90 deg" was one of 1e-32 N/m along x."""
    K, M = (part[::2, ::2] for part in storeys(np.ones(N_STOREY), np.ones(N_STOREY), MASS * np.ones(N_STOREY)))
    node = np.column_stack([np.zeros((N_STOREY, 2)), HEIGHT * (1 + np.arange(N_STOREY))])
    np.savez(tmp_path / "model.npz", K0=0.5 * K, K_k1=0.5 * K, M0=M, channel=np.array(CHANNELS[::2]),
             channel_dof=np.arange(N_STOREY), node_position_m=node, dof_node=np.arange(N_STOREY),
             dof_direction=np.zeros(N_STOREY, int), line=np.column_stack([np.arange(4), np.arange(1, 5)]))
    (tmp_path / "model.toml").write_text('[[parameter]]\nname = "k1"\nunit = "-"\ninitial = 1.0\ncov = 0.05\n'
                                         "lower = 0.2\nupper = 2.0\n")
    plane = prepare(tmp_path / "model.npz", parameters=read_parameters(tmp_path / "model.toml"))
    ways = {effect.location.split(", along ")[-1].split(",")[0] for effect, _ in elementary(plane.small, str, heights=5)
            if effect.cause in (PART_CAUSES[0], PART_CAUSES[3])}
    assert ways == {"0 deg"}


def test_masses_on_springs_are_not_estimated_all_at_once(frame):
    """A hundred of them bring more modes than the mean's are taken of: an unknown cause on a jacket had ended there."""
    rows = elementary(frame.small, str, heights=5)
    hung = [part for part in rows if part[0].cause == PART_CAUSES[3]][:100]
    wider = free_form_module.model_with_parts(frame, [part for part in rows if part[0].cause == PART_CAUSES[0]] + hung)
    problem, theta = diagnosis_problem(wider, record(5, spring=3e5))
    step = min((number for number, profile in enumerate(problem.time_profiles) if profile.kind == "step"),
               key=lambda number: abs(problem.time_profiles[number].at - 20))
    rows = np.flatnonzero(problem.which[:, 1] == step)
    _, found = changed_together(problem, (), rows, problem.time_profiles[step], most=3)
    first = problem.effects[problem.which[found[0].candidate, 0]]
    assert (first.cause, first.location) == (PART_CAUSES[0], "[ 0.  0. 12.], along 0 deg")
    heavy = np.array(theta)
    heavy[[one.column for one in wider.small.tuned]] = 1.0
    local = wider.small.evaluate(heavy)
    assert local.n_search > N_CORE == local.solve(0.0, local.n_search).frequency_hz.size


def test_a_mass_on_springs_has_the_modes_and_slopes_of_the_whole_equations(frame, validation):
    """Its own degree of freedom against the matrices written out; derivatives with its mass and frequency against
    finite differences; what is not there yet against the smallest that is."""
    row = validation(what="a mass on springs on the small basis: frequencies; derivatives of eigenvalues and shapes "
                          "with its mass and ln of its frequency; with a mass that is not there yet",
                     reference="the matrices with its own degrees of freedom; central differences; the smallest mass",
                     why="eigensolver; step")
    rows = elementary(frame.small, str, heights=5)
    part = next(a for e, a in rows if e.cause == PART_CAUSES[3] and "along 45 deg" in e.location and a.tuned_hz > 3)
    small = frame.small.attach_parts([part])
    (one,) = small.tuned
    theta = np.append(frame.small.parameters.initial, [200.0, 0.05])
    storey = int(np.argmax(np.abs(part.mass[0] @ np.linalg.pinv(frame.small.at_nodes)))) // 3
    hz = part.tuned_hz * np.exp(0.05)
    K, M = (np.pad(x, (0, 1)) for x in storeys(np.ones(N_STOREY), np.ones(N_STOREY), MASS * np.ones(N_STOREY)))
    both = np.zeros(len(K))
    both[[2 * storey, 2 * storey + 1, -1]] = np.sqrt(0.5), np.sqrt(0.5), -1.0
    K += 200.0 * (2 * np.pi * hz) ** 2 * np.outer(both, both)
    M[-1, -1] = 200.0
    modes = small.evaluate(theta).solve()
    row.error(modes.frequency_hz / (np.sqrt(linalg.eigvalsh(K, M)) / (2 * np.pi)) - 1, 1e-9, "frequencies")
    clusters = [[k] for k in range(6)]

    def slopes_at(point):
        local = small.evaluate(point)
        return local, local.derivatives(local.slopes([one.column, one.tuning]), [(0.0, local.solve(), clusters)])[0]

    def value_and_shape(point, k, like):
        local = small.evaluate(point)
        found = local.solve()
        shape = local.at_channels @ found.vectors[:, k]
        return (2 * np.pi * found.frequency_hz[k]) ** 2, shape * np.sign(shape @ like)

    local, found = slopes_at(theta)
    for k, (coupling, change) in enumerate(found):
        value, shape = (2 * np.pi * modes.frequency_hz[k]) ** 2, local.at_channels @ modes.vectors[:, k]
        for p, h in ((0, 0.2), (1, 1e-4)):
            up, down = (value_and_shape(theta + s * h * np.eye(len(theta))[one.column + p], k, shape) for s in (1, -1))
            scale = max(abs(coupling[0, 0, p]), 1e-3 * value / (200.0, 1.0)[p])
            row.error((coupling[0, 0, p] - (up[0] - down[0]) / (2 * h)) / scale, 1e-4, "eigenvalues")
            slope = (up[1] - down[1]) / (2 * h)
            least = 1e-3 * np.abs(shape).max() / (200.0, 1.0)[p]
            # of modes 3 % apart what turns them into each other is smoothed by (EQUAL / 0.03)^2 = 1.1e-3
            row.error(np.abs(change[:, 0, p] - slope).max() / max(np.abs(slope).max(), least), 2e-3, "shapes")
    none, small_one = theta.copy(), theta.copy()
    none[one.column], small_one[one.column] = 0.0, 1e-3
    own, with_it = slopes_at(none)[1], small.evaluate(small_one).solve()
    apart = int(np.argmin(np.abs(with_it.frequency_hz - hz)))
    value = (2 * np.pi * np.delete(with_it.frequency_hz, apart)[:6]) ** 2
    away = np.abs(1 - value / one.square(theta))
    smooth = 1 / (1 + (0.05 / away) ** 2)
    slope = np.array([coupling[0, 0, 0] for coupling, _ in own])
    expected = (value - (2 * np.pi * small.evaluate(none).solve().frequency_hz[:6]) ** 2) / 1e-3
    row.error((slope - smooth * expected) / np.abs(expected).max(), 1e-3, "not there yet")


@pytest.mark.long
def test_parts_are_looked_for_in_processes_too(frame):
    """The model with its parts goes to other processes, which answer as this one does."""
    data = record(3, spring=3e5)
    known = examine(frame, data)
    alone = free_form(frame, known, data)
    with processes(2) as runs:
        assert free_form(frame, known, data, runs=runs).content == alone.content


@pytest.mark.parametrize(("hidden", "nearest", "part"), [
    ({"spring": 3e4}, "parameter k2", "spring to ground: (0.0, 0.0, 12.0) m, along 0 deg"),
    pytest.param({"mass": 60.0, "storey": 2}, "parameter k2", "added mass at a point: (0.0, 0.0, 9.0) m",
                 marks=pytest.mark.long),
])
def test_a_part_is_more_probable_than_the_row_that_comes_nearest(frame, hidden, nearest, part, validation):
    """Small enough for stiffness of storeys to come near; the part is at its place, among all of its kind."""
    row = validation(what="a spring to ground, a mass, small enough for stiffness of storeys to come near: "
                          "*unexplained*, the part at its place more probable than the row",
                     reference="what was hidden")
    found = examine(frame, record(11, **hidden)).diagnosis
    (note,) = [n for n in found.notes if "an elementary part" in n]
    row.count(found.verdict == "unexplained" and nearest in note and f"an elementary part, {part}" in note, 1, 1,
              case=note)


@pytest.mark.numbers
@pytest.mark.parametrize(("spring", "storey"), [(6e4, 2), pytest.param(1e5, 3, marks=pytest.mark.long),
                                                pytest.param(2e5, 4, marks=pytest.mark.long)])
def test_a_part_is_more_probable_than_what_is_said_of_sensors(frame, spring, storey, validation):
    """The catalogue follows these springs with the clock of all channels and a crosstalk or two, of which a channel's
    own response is more probable than the crosstalk: no channel is wrong."""
    row = validation(what="a spring to ground that the catalogue follows with what sensors do: *unexplained*, the part "
                          "at its place more probable than a finding, no channel with a response of its own",
                     reference="what was hidden")
    outcome = examine(frame, record(11, spring=spring, storey=storey - 1))
    part = f"spring to ground: (0.0, 0.0, {HEIGHT * storey:.1f}) m, along 0 deg"
    notes = [n for n in outcome.diagnosis.notes if "an elementary part" in n]
    # of 200 kN/m at storey 4 masses stand in the place of two of three findings, the spring in that of the first
    row.count(outcome.diagnosis.verdict == "unexplained" and any(f"an elementary part, {part}" in n for n in notes)
              and outcome.own_response is None and "measurement" in {f.kind for f in outcome.proposed}, 1, 1,
              case="; ".join(notes))


@pytest.mark.long
@pytest.mark.numbers
def test_one_part_stands_for_several_findings(frame, monkeypatch, validation):
    """A spring is a sampling rate and two crosstalks to the catalogue. In place of two of them the part explains what
    it does in place of one, and is more probable for the row that it spares."""
    row = validation(what="a spring to ground in place of two findings over that in place of one: ln evidence; ln "
                          "prior over that of the row which it spares", reference="none; zero")
    offered, rows = {}, []

    def in_place(parts, problem, best, numbers):
        offered[numbers] = alternative_parts(parts, problem, best, numbers)
        rows[:] = [log_prior(problem, [k]) for k in best.candidates]
        return offered[numbers]

    monkeypatch.setattr(diagnose, "alternative_parts", in_place)
    examine(frame, record(11, spring=1e5, storey=4))
    (effect, alone, prior), (other, both, more) = (offered[numbers][0] for numbers in ((0,), (0, 1)))
    where = effect.location
    row.equal((effect.cause, where), (PART_CAUSES[0], "(0.0, 0.0, 15.0) m, along 0 deg"), "part")
    row.equal((other.cause, other.location), (effect.cause, where), "part in place of both")
    row.least([both - alone], -1, "evidence")
    # odds of one part among its kind differ with what the others explain
    row.error(more - prior + rows[1], 1, "prior")


@pytest.mark.parametrize(("mass", "share", "storey"), [
    (60.0, 2.2, 3), pytest.param(25.0, 1.3, 4, marks=pytest.mark.long),
    pytest.param(30.0, 1.15, 4, marks=pytest.mark.long)])
def test_a_mass_on_springs_is_more_probable_than_the_row_that_comes_nearest(frame, mass, share, storey, validation):
    row = validation(what="mass of 60 kg (long: 25 and 30) on a spring of its own at a storey, at 2.2 (1.3 and 1.15) "
                          "times the first frequency, from block 20 on: verdict, the most probable part beside the row "
                          "that comes nearest, its storey and direction", reference="what was hidden")
    K, M = storeys(np.ones(N_STOREY), np.ones(N_STOREY), MASS * np.ones(N_STOREY))
    first_hz = np.sqrt(linalg.eigvalsh(K, M)[0]) / (2 * np.pi)
    outcome = examine(frame, hung_record(7, mass=mass, hz=share * first_hz, storey=storey))
    part = outcome.proposed[0].alternatives[0]
    row.equal((outcome.diagnosis.verdict, part.cause, part.location.rsplit(", ", 1)[0]),
              ("unexplained", PART_CAUSES[3], f"(0.0, 0.0, {3.0 * (storey + 1)}) m, along 0 deg"), "part")


def test_a_row_that_explains_the_record_keeps_its_name_beside_all_parts(frame, stepped, validation, monkeypatch):
    """By what they promise to first order no part comes near; each kind's best one is fitted here all the same."""
    row = validation(what="a storey that loosens, beside all elementary parts: verdict, cause, place; how much less "
                          "probable the best part of each kind is, fitted, in ln",
                     reference="as without them; the right row")
    _, data, alone = stepped
    offered = []

    def all_compared(parts, problem, best, numbers):
        monkeypatch.setattr(elementary_parts, "FIRST_ORDER_ERRS", 1e9)
        offered.extend(alternative_parts(parts, problem, best, numbers))
        return offered

    monkeypatch.setattr(diagnose, "alternative_parts", all_compared)
    found = examine(frame, data).diagnosis
    (finding,), (before,) = found.findings, alone.diagnosis.findings
    row.equal((found.verdict, finding.cause, finding.location), ("named", before.cause, before.location), "name")
    assert len(offered) >= 2 and {effect.cause for effect, _, _ in offered} <= set(PART_CAUSES)
    row.least([-(evidence + prior) for _, evidence, prior in offered], 5, "ln")


def test_of_parts_that_promise_alike_the_one_that_fits_best_stands_for_its_kind(frame, monkeypatch):
    """First order says that several do; what the fits find, here 3 for the second and less for the others, decides, and
    the kind is at least as probable as that one alone."""
    asked, answers = [], []

    def compared(problem, best, rest, numbers, part, size):
        first = not any(part[0].cause == one[0].cause for one in asked)
        second = sum(part[0].cause == one[0].cause for one in asked) == 1
        asked.append(part)
        return (-2.0 if first else 3.0 if second else 1.0), float(np.log(part[0].odds))

    def in_place(parts, problem, best, numbers):
        # of the first effect alone
        if answers:
            return []
        monkeypatch.setattr(elementary_parts, "MARGIN", 1e9)
        answers.extend(alternative_parts(parts, problem, best, numbers))
        return answers

    monkeypatch.setattr(elementary_parts, "_compare_part", compared)
    monkeypatch.setattr(diagnose, "alternative_parts", in_place)
    examine(frame, record(11, spring=3e4))
    kinds = {effect.cause for effect, _, _ in answers}
    assert len(answers) == len(kinds) >= 2
    for effect, evidence, prior in answers:
        tried = [part for part, _ in asked if part.cause == effect.cause]
        assert len(tried) == elementary_parts.FITTED and effect.location == tried[1].location and evidence == 3.0
        assert prior == pytest.approx(np.log(effect.odds)) and effect.odds > tried[1].odds


@pytest.mark.long
@pytest.mark.parametrize(("mass", "share", "storey"), [(400.0, 1.05, 4), (300.0, 1.1, 3)])
def test_a_heavy_mass_on_springs_all_through_the_record_is_at_its_place(frame, mass, share, storey):
    """Begun to first order, which promises more at another storey: the modes are nowhere near linear in it."""
    K, M = storeys(np.ones(N_STOREY), np.ones(N_STOREY), MASS * np.ones(N_STOREY))
    hz = share * np.sqrt(linalg.eigvalsh(K, M)[0]) / (2 * np.pi)
    data = hung_record(5, mass=mass, hz=hz, storey=storey - 1, from_block=0)
    (part,) = free_form(frame, examine(frame, data), data).content["parts"]
    assert part["location"].startswith(f"(0.0, 0.0, {HEIGHT * storey:.1f}) m, along 0 deg")
    assert part["size"] == pytest.approx(mass, abs=3 * part["size_std"])


def test_places_that_a_part_may_have_instead_are_said():
    part = {"cause": PART_CAUSES[0], "location": "leg B, mud line, along 90 deg", "size": 2e7, "size_std": 3e6,
            "unit": "N/m", "time_profile": "constant", "since": "", "elementary": True, "modes": [],
            "posterior_probability": 0.6, "alternatives": [
                {"cause": PART_CAUSES[0], "location": "leg B, z = 2.0 m, along 90 deg", "posterior_probability": 0.31}]}
    said = free_form_words({"details": {"free_form": {"parts": [part], "complete": True, "gain": {}}}})
    assert said[0].endswith("all through the record; or spring to ground, leg B, z = 2.0 m, along 90 deg (0.31)")


def test_masses_on_springs_at_one_place_are_one_whatever_their_frequency():
    placed = {}

    def one(node, way, where, hz, p):
        key = PartKey(cause=PART_CAUSES[3], at=(node,), way=way, tuned_hz=hz)
        placed[hz] = Attachment(key=key, where=where)
        return Alternative(cause=key.cause, location=f"{where}, about {hz:g} Hz", posterior_probability=p, key=hz)

    def row(cause, p):
        return Alternative(cause=cause, location="", posterior_probability=p, key=cause)

    others = (one(9, 2, "tower, z = 72 m, along 45 deg", 3.1, 0.25), one(4, None, "leg A, horizontal", 1.0, 0.2),
              one(4, None, "leg A, horizontal", 1.3, 0.1), row("chance alone", 0.1), row("scour", 0.03),
              one(8, 2, "tower, z = 72 m, along 45 deg", 3.8, 0.06))
    own = one(9, 2, "tower, z = 72 m, along 45 deg", 3.9, 0.32)
    found = Finding(kind="structural", cause=own.cause, location=own.location, size=1e4, size_std=2e3, unit="kg",
                    time_profile="step", time_profile_start="", z=9.0, posterior_probability=0.32,
                    prior_probability=0.1, alternatives=others, check="", key=own.key)
    said = free_form_module.place_probabilities(found, placed)
    assert said["posterior_probability"] == pytest.approx(0.57)
    assert [(a["location"], round(a["posterior_probability"], 2)) for a in said["alternatives"]] == [
        ("leg A, horizontal", 0.3), ("", 0.1), ("tower, z = 72 m, along 45 deg", 0.06)]


def test_nothing_is_added_where_nothing_is_hidden(frame):
    data = record(4)
    assert free_form(frame, examine(frame, data), data) is None


def test_parts_of_a_model_without_a_picture_are_those_at_its_channels(frame):
    bare = replace(frame.small, wire=None)
    places = {effect.location for effect, _ in elementary(bare, str) if effect.cause == PART_CAUSES[0]}
    assert places == {f"channel {name}, along it" for name in bare.channels}


@pytest.mark.long
def test_parts_of_a_model_without_a_picture_are_at_its_channels(frame, validation):
    row = validation(what="the spring to ground of 3e5 N/m, of a model that has no picture: part, channel, time "
                          "profile; size in its standard deviations", reference="what was hidden")
    data, bare = record(3, spring=3e5), replace(frame, small=replace(frame.small, wire=None))
    found = free_form(bare, examine(bare, data), data)
    (part,) = found.content["parts"]
    row.equal((part["cause"], part["location"], part["time_profile"]), (PART_CAUSES[0], "channel x4, along it", "step"),
              "part")
    row.error((part["size"] - 3e5) / part["size_std"], 3, "size")


def test_attached_parts_are_the_full_models(frame, validation):
    """Frequencies with a spring and a mass attached against the matrices with both added."""
    row = validation(what="frequencies with elementary parts on the small basis",
                     reference="the matrices with both added", why="eigensolver")
    rows = elementary(frame.small, str)
    spring = next(a for e, a in rows if e.cause == PART_CAUSES[0] and e.location.endswith("along 90 deg"))
    mass = next(a for e, a in rows if e.cause == PART_CAUSES[2])
    small = frame.small.attach_parts([spring, mass])
    theta = np.append(frame.small.parameters.initial, [2e5, 300.0])
    K, M = storeys(np.ones(N_STOREY), np.ones(N_STOREY), MASS * np.ones(N_STOREY))
    node = int(round(min(float(e.location.split()[-1].strip("[],")) for e, _ in rows
                         if e.cause == PART_CAUSES[2]) / HEIGHT)) - 1
    K[2 * node + 1, 2 * node + 1] += 2e5
    M[2 * node : 2 * node + 2, 2 * node : 2 * node + 2] += 300.0 * np.eye(2)
    expected = np.sqrt(linalg.eigvalsh(K, M)) / (2 * np.pi)
    row.error(small.evaluate(theta).solve().frequency_hz / expected - 1, 1e-9)


def test_points_are_where_members_meet_or_end_and_then_far_apart():
    node = np.array([[0, 0, 0], [0, 0, 5], [0, 0, 10], [0.01, 0, 10], [3, 0, 10], [0, 3, 10.0]])
    line = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [2, 5]])
    wire = Wireframe(node_m=node, line=line, line_group=("leg",) * 5)
    # two and three are one place, where three members meet
    assert points(wire, most=4).tolist() == [0, 2, 4, 5]
    assert points(wire).tolist() == [0, 1, 2, 4, 5]


@pytest.mark.numbers
def test_points_of_the_turbine_have_names():
    from probupdate.structure.description_file import read_description
    from probupdate.structure.load import load_model
    from probupdate.structure.places import place_of

    model, described = load_model(reference_model("updated")), read_description(reference_model("updated"))
    names = [place_of(described, model.wire.node_m[k]) for k in points(model.wire)]
    assert len(set(names)) == len(names) and all(names)
    assert {f"face {f}, bay {b}" for f in ("AB", "BC", "CD", "DA") for b in (1, 2, 3, 4)} <= set(names)
