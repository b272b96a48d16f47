"""The IASC-ASCE benchmark frame: its own equations against others', and what the diagnosis names on a few cases."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import opensees_loader
import pytest

from probupdate.diagnosis.adequacy import adequacy
from probupdate.diagnosis.blocks import gather
from probupdate.diagnosis.evidence import linear_evidence, log_evidence
from probupdate.diagnosis.expected import residuals_at
from probupdate.diagnosis.fitting import (
    design_without_candidates,
    effect_model_errors,
    fit,
    fitted_without_candidates,
    noise_of,
)
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.diagnosis.proposals import changed_together
from probupdate.diagnosis.search import drawn_scores, search
from probupdate.structure.load import load_model

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "studies" / "iasc_asce"))
import cases
import frame
import run

# of the shear building, MN/m and MN m: columns 12 E I / h^3 and braces E A / l cos^2 by hand
STOREY_STIFFNESS = (106.60, 67.90)
DEFINED = {(c.number, p.number): (c, p) for c in cases.CASES for p in cases.PATTERNS}


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("iasc")
    ready = {}

    def of(case):
        key = (case.n_dof, case.heavy)
        if key not in ready:
            ready[key] = run.ready(case, folder)
        return ready[key]

    return of


def test_the_shear_building_has_the_storey_stiffness_and_mass_by_hand(validation):
    row = validation(what="IASC-ASCE shear building: stiffness of a storey in MN/m, mass",
                     reference="12 E I / h^3 and E A / l cos^2 by hand (106.60, 67.90), members and slabs by hand",
                     why="digits; rounding")
    K, M = cases.stiffness_of({}, 12), frame.mass(12, False)
    row.error(K[9:11, 9:11].diagonal() / 1e6 - STOREY_STIFFNESS, 0.005, "stiffness")
    prior_scales = 4 * sum(frame.SLAB_KG)
    steel = sum(7800 * {"column": frame.COLUMN, "beam": frame.BEAM, "brace": frame.BRACE}[m.kind][0]
                * np.linalg.norm(frame.position_m(m.ends[1]) - frame.position_m(m.ends[0]))
                * (0.5 if m.storey == 1 and m.kind != "beam" else 1.0) for m in frame.members())
    row.error(M[0::3, 0::3].sum() / (prior_scales + steel) - 1, 1e-12, "mass")
    heavy = frame.mass(12, True)
    assert heavy[9, 9] - M[9, 9] == pytest.approx(150.0) and heavy[9, 11] == pytest.approx(150 * frame.BAY_M / 2)


def test_the_frame_of_120_moves_rigidly_without_force_and_holds_the_shear_building():
    K, M = cases.stiffness_of({}, 120), frame.mass(120, False)
    assert K[:12, :12] == pytest.approx(cases.stiffness_of({}, 12), rel=1e-12, abs=1e-3)
    assert M[:12, :12] == pytest.approx(frame.mass(12, False), rel=1e-12, abs=1e-9)
    for member in (m for m in frame.members() if m.storey == 2):
        rigid = np.zeros((12, 6))
        for k, node in enumerate(member.ends):
            x, y, z = frame.position_m(node)
            rigid[6 * k : 6 * k + 6] = np.eye(6)
            rigid[6 * k : 6 * k + 3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        stiffness = frame.element(member)[0]
        assert np.abs(stiffness @ rigid).max() < 1e-9 * np.abs(stiffness).max()


def test_frequencies_of_the_frame_are_those_of_opensees(validation):
    """The same frame of 120 degrees of freedom with rigid diaphragms."""
    row = validation(what="IASC-ASCE benchmark frame, 120 degrees of freedom, twelve frequencies, by equations of its "
                          "own", reference="OpenSees, rigid diaphragms", why="members' polar inertia")
    try:
        ops = opensees_loader.load_opensees()
    except (ImportError, OSError) as error:
        pytest.skip(f"no OpenSees here: {error}")
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    mass = np.zeros((5 * frame.N_PLAN, 3))
    for n in range(len(mass)):
        ops.node(n + 1, *frame.position_m(n).tolist())
        if n < frame.N_PLAN:
            ops.fix(n + 1, *[1] * 6)
    ops.geomTransf("Linear", 1, 1.0, 0.0, 0.0)
    ops.geomTransf("Linear", 2, 0.0, 0.0, 1.0)
    ops.uniaxialMaterial("Elastic", 1, frame.YOUNGS_PA)
    shear = frame.YOUNGS_PA / (2 * (1 + frame.POISSON))
    for k, m in enumerate(frame.members()):
        area, strong, weak, torsion = {"column": frame.COLUMN, "beam": frame.BEAM, "brace": frame.BRACE}[m.kind]
        ends = [n + 1 for n in m.ends]
        if m.kind == "brace":
            ops.element("Truss", k + 1, *ends, area, 1)
        else:
            ops.element("elasticBeamColumn", k + 1, *ends, area, frame.YOUNGS_PA, shear, torsion, strong, weak,
                        1 if m.kind == "column" else 2)
        length = np.linalg.norm(frame.position_m(m.ends[1]) - frame.position_m(m.ends[0]))
        mass[list(m.ends)] += frame.DENSITY_KGPM3 * area * length / 2
    for discrepancy_std, prior_scale in enumerate(frame.SLAB_KG):
        nodes = np.arange(frame.N_PLAN * (discrepancy_std + 1), frame.N_PLAN * (discrepancy_std + 2))
        centre = np.array([frame.BAY_M, frame.BAY_M, frame.STOREY_M * (discrepancy_std + 1)])
        ops.node(100 + discrepancy_std, *centre.tolist())
        ops.fix(100 + discrepancy_std, 0, 0, 1, 1, 1, 0)
        ops.rigidDiaphragm(3, 100 + discrepancy_std, *[int(n) + 1 for n in nodes])
        away = sum(mass[n, 0] * np.sum((frame.position_m(n) - centre) ** 2) for n in nodes)
        turning = 4 * prior_scale * (frame.BAY_M**2 / 6 + frame.BAY_M**2 / 2) + away
        along = float(4 * prior_scale + mass[nodes, 0].sum())
        ops.mass(100 + discrepancy_std, along, along, 0.0, 0.0, 0.0, float(turning))
        for n in nodes:
            ops.mass(int(n) + 1, 0.0, 0.0, float(mass[n, 2]), 1e-6, 1e-6, 0.0)
    ops.constraints("Transformation")
    ops.numberer("Plain")
    ops.system("FullGeneral")
    found = np.sort(np.sqrt(ops.eigen("-fullGenLapack", 12))) / (2 * np.pi)
    ops.wipe()
    ours, _ = frame.modes(cases.stiffness_of({}, 120), frame.mass(120, False))
    # members' polar inertia about their own axis, which OpenSees is not given
    row.error(ours / found - 1, 1e-4)


def test_the_models_that_are_given_are_the_benchmarks(tmp_path):
    for n_dof in (12, 120):
        model = load_model(cases.write_model(tmp_path / str(n_dof), n_dof=n_dof, heavy=True))
        theta = np.array(model.parameters.initial)
        theta[model.parameters.names.index("b1x+")] = 0.5
        theta[model.parameters.names.index("c2y")] = 1.1
        expected, _ = frame.modes(cases.stiffness_of({"b1x+": 0.5, "c2y": 1.1}, n_dof), frame.mass(n_dof, True), 6)
        assert model.solve(theta, 6).frequency_hz == pytest.approx(expected, rel=1e-9)


def test_the_loose_end_of_a_beam_changes_next_to_nothing():
    """Pattern 5 against pattern 4: frequencies that identify nothing at 1 % of noise; the shear building has none."""
    of = [frame.modes(cases.stiffness_of({}, 120, cases.PATTERNS[k]), frame.mass(120, True))[0] for k in (4, 5)]
    assert -0.01 < np.min(of[1] / of[0] - 1) < -0.003
    assert np.median(np.abs(of[1] / of[0] - 1)) < 5e-4


def test_a_mode_that_falls_by_a_third_and_stays_there_is_kept(validation):
    row = validation(what="a mode that falls by a third at a step; two single sets 30 % off: blocks left out",
                     reference="none; these two")
    case, pattern = DEFINED[4, 1]
    data = cases.record(case, pattern, 1, time_profile="step")
    fallen = data.sets[-1].frequency_hz[0] / data.sets[0].frequency_hz[0]
    assert fallen < 0.75
    blocks = gather(data)
    assert len(blocks.labels) == data.n_mode
    row.equal(np.flatnonzero(~np.isfinite(blocks.frequency_hz).all(axis=1)).tolist(), [])
    # what is off in single sets was taken for another mode, as before
    sets = list(data.sets)
    for k in (3, 11):
        sets[k] = replace(sets[k], frequency_hz=sets[k].frequency_hz * np.r_[1.3, np.ones(data.n_mode - 1)])
    blocks = gather(replace(data, sets=tuple(sets)))
    row.equal(np.flatnonzero(~np.isfinite(blocks.frequency_hz[:, 0])).tolist(), [3, 11])


def test_a_group_ends_where_the_first_of_its_members_does(prepared, validation):
    row = validation(what="bounds of a group of parameters, all of it lost at 1",
                     reference="where its first member's bound is reached")
    case, _ = DEFINED[4, 0]
    own = {e.location: (e.lower, e.upper) for e in prepared(case).own}
    row.equal(own["braces of storey 1"], (-1.0, 1.0))


@pytest.mark.parametrize(("number", "pattern", "seed"), [(1, 0, 1), (3, 0, 2)])
def test_nothing_hidden_nothing_named(prepared, number, pattern, seed):
    case, pattern = DEFINED[number, pattern]
    line = run.run_one(prepared(case), case, pattern, seed, "step")
    assert line["judged"] == "silent"


@pytest.mark.parametrize(("number", "pattern", "time_profile"), [(3, 1, "constant"), (4, 6, "step")])
def test_braces_that_are_lost_are_named(prepared, number, pattern, time_profile, validation):
    row = validation(what="braces lost in the IASC-ASCE frame, as a step and throughout (rates in "
                          "`studies/iasc_asce`): cause and place; size in its standard deviations",
                     reference="the pattern")
    case, pattern = DEFINED[number, pattern]
    line = run.run_one(prepared(case), case, pattern, 1, time_profile)
    row.equal(line["judged"], "right", "cause, place")
    (one,) = line["findings"]
    row.error((one["size"] - run.true_size(pattern, one["location"])) / one["std"], 3, "size")


@pytest.mark.long
def test_two_braces_at_one_step_of_which_each_alone_is_fitted_in_vain_are_named(prepared, validation):
    """Neither settles in 40 steps by itself, and beside it first order promises the other one nothing."""
    row = validation(what="one brace each of two storeys lost at a step in the IASC-ASCE frame: judged; sizes (a half "
                          "of each pair)", reference="the pattern", why="two standard deviations, 0.05 each")
    case, pattern = DEFINED[5, 4]
    line = run.run_one(prepared(case), case, pattern, 23, "step")
    row.equal(line["judged"], "right", "judged")
    row.error([f["size"] + 0.5 for f in line["findings"]], 0.1, "size")


def test_storeys_of_which_neither_alone_explains_much_are_found_together(prepared, validation):
    """Step by step one of them was found, whose fit did not settle: all of the structure that may have changed since
    the step is asked at once, of which few are large."""
    row = validation(what="two storeys' braces lost at a step, of which neither alone explains much: the first "
                          "two that changed together; named in all; sizes less one", reference="the pattern")
    case, pattern = DEFINED[1, 2]
    problem, theta = diagnosis_problem(prepared(case), cases.record(case, pattern, 28, time_profile="step"))
    profile = next(c for c in problem.time_profiles if c.kind == "step" and c.at == 8)
    rows = [k for k, (_, c) in enumerate(problem.which) if problem.time_profiles[c] is profile]
    _, parts = changed_together(problem, (), rows, profile, 3)
    row.equal({problem.effects[problem.which[t.candidate, 0]].location for t in parts[:2]}, pattern.places, "together")
    line = run.run_one(prepared(case), case, pattern, 28, "step")
    row.equal(line["judged"], "right", "judged")
    row.error([f["size"] - 1 for f in line["findings"]], 0.05, "size")


@pytest.fixture(scope="module")
def two_storeys(prepared):
    """Problem, start, the step at which storeys 1 and 3 lose all braces (case 5, seed 47), and the effects by place."""
    case, pattern = DEFINED[5, 2]
    problem, theta = diagnosis_problem(prepared(case), cases.record(case, pattern, 47, time_profile="step"))
    profile = next(c for c in problem.time_profiles if c.kind == "step" and c.at == 8)
    return problem, theta, profile, {e.location: e for e in problem.effects}


def test_modes_of_either_state_are_those_that_were_measured_in_it(prepared, two_storeys, validation):
    """A mode that falls from 36 to 22 Hz looks in the mean of all blocks like neither state, another one of the model
    was taken for it, and a fit that had come there stayed 1400 below in ln."""
    row = validation(what="two storeys of the IASC-ASCE frame that lose all braces at a step, fitted from half and "
                          "from all of them lost: ln evidence less the best; sizes less one",
                     reference="the same maximum from every start", why="steps of a fit; two standard deviations")
    problem, theta, profile, of = two_storeys
    (case, pattern), evidence = DEFINED[5, 2], []
    for size in (0.5, 0.9, 1.0):
        included = [IncludedEffect(effect=of[place], time_profile=profile, size=size) for place in pattern.places]
        fitted = fitted_without_candidates(problem, theta, included)
        assert fitted.settled
        evidence.append(log_evidence(problem, fitted))
        row.error([n.size - 1 for n in fitted.included], 0.2, "sizes")
    row.error(np.array(evidence) - max(evidence), 2.0, "ln evidence")
    states = [problem.predictor_at_state(included, (value, value)) for value in (0.0, 1.0)]
    fallen = states[1].log_frequency[3] - states[0].log_frequency[3]
    assert fallen < np.log(0.65) and problem.predictor not in states
    # what moves nothing far has the pairing of the whole record
    sound, _ = diagnosis_problem(prepared(case), cases.record(case, cases.PATTERNS[0], 47, time_profile="step"))
    assert sound.predictor_at_state(included, (1.0, 1.0)) is sound.predictor


def test_a_group_loses_a_share_of_what_its_members_have(two_storeys, validation):
    """Of members that are all lost nothing is left, whatever each of them had: signatures in the state after a loss."""
    row = validation(what="a group of parameters that loses a part at a step: signatures of its members and of its "
                          "size after it; residuals with all of it lost, at two values of a member",
                     reference="differences of residuals", why="steps of 1e-4")
    problem, theta, profile, of = two_storeys
    storey = of["braces of storey 1"]
    member, other = (problem.predictor.parameters.names.index(name) for name in ("b1x+", "c1x"))
    theta = np.array(theta)
    theta[member] = 1.1

    def left(theta, size):
        return residuals_at(problem, theta, [IncludedEffect(effect=storey, time_profile=profile, size=size)])

    included = [IncludedEffect(effect=storey, time_profile=profile, size=0.6)]
    noise = noise_of(problem, left(theta, 0.6))
    design = design_without_candidates(problem, theta, included, noise)
    number = design.included[0][0]
    for column in (member, other, None):
        ends = [theta + h * (np.arange(len(theta)) == column) for h in (1e-4, -1e-4)]
        sizes = (0.6, 0.6) if column is not None else (0.6 + 1e-4, 0.6 - 1e-4)
        up, down = (left(end, size) for end, size in zip(ends, sizes, strict=True))
        for q, (a, b) in enumerate(zip(up, down, strict=True)):
            there = design.effect[q][:, :, number] if column is None else design.nuisance[q][:, :, column]
            found = -(a - b)[8:] / 2e-4
            row.error(np.abs(found - there[design.bin_of[8:]]).max() / np.abs(there).max(), 1e-3, "signature")
    sound = np.array(problem.predictor.parameters.initial)
    row.error(max(np.abs(a - b)[8:].max() for a, b in zip(left(theta, 1.0), left(sound, 1.0), strict=True)), 1e-9,
              "all lost")


def test_model_errors_along_one_time_profile_are_one(prepared):
    """Independent errors of the same responses at the same times: their variances add, and nothing else changes."""
    case, pattern = DEFINED[4, 4]
    problem, theta = diagnosis_problem(prepared(case), cases.record(case, pattern, 3, time_profile="step"))
    profile = next(c for c in problem.time_profiles if c.kind == "step" and c.at == 8)
    places = sorted(pattern.places)
    included = [IncludedEffect(effect=next(e for e in problem.effects if e.location == place), time_profile=profile,
                               size=-0.5) for place in places]
    noise = noise_of(problem, residuals_at(problem, theta, included))
    together = design_without_candidates(problem, theta, included, noise)
    ((_, spread),) = together.model_errors
    signatures = [[e[:, :, number] for e in together.effect] for number, _, _ in together.included[:2]]
    apart = replace(together, model_errors=tuple(
        error for n, own in zip(included, signatures, strict=True)
        for error in effect_model_errors(problem, [n], [own])))
    for q, own in enumerate(spread):
        assert own == pytest.approx(np.sqrt(sum(s[q] ** 2 for _, s in apart.model_errors)))
    residuals = residuals_at(problem, theta, included)
    assert len(apart.model_errors) == 2
    assert linear_evidence(together, residuals) == pytest.approx(linear_evidence(apart, residuals), rel=1e-9)


@pytest.mark.parametrize(("number", "pattern", "seed"), [
    pytest.param(1, 2, 1, marks=pytest.mark.long), (3, 1, 1), (1, 1, 21)],
                         ids=["two storeys", "one storey", "one storey, a mode beside an unmeasured one"])
def test_storeys_that_lose_all_braces_at_a_step_are_named(prepared, number, pattern, seed, validation):
    """What is left of a storey without braces shows 3 % of one pair: a group's members lose their own tolerance too.
    Of two storeys' steps the lesser one is no chance where the greater alone explains nothing. And how far the fourth
    mode in y (48.41 Hz) turns towards that in x (48.43 Hz), which was not measured, is not known from the model."""
    row = validation(what="storeys of the IASC-ASCE frame that lose all braces at a step, two at once, one, one "
                          "beside a mode whose mate was not measured: the storeys alone; p of the residual without "
                          "and with them; size less one", reference="the pattern")
    case, pattern = DEFINED[number, pattern]
    line = run.run_one(prepared(case), case, pattern, seed, "step")
    row.equal((line["judged"], len(line["findings"])), ("right", len(pattern.places)), "storeys")
    # what is left is tested by a test that sees the storeys where they are not in the model
    problem, theta = diagnosis_problem(prepared(case), cases.record(case, pattern, seed, time_profile="step"))
    null = fit(problem, theta)
    found, drawn = search(problem, null, seed=seed), drawn_scores(null.design, seed)
    row.error(adequacy(problem, null, found, drawn)[0], 0.01, "p without")
    row.least(line["adequacy"], 0.05, "p with")
    row.error([f["size"] - 1 for f in line["findings"]], 0.05, "size")


@pytest.mark.long
@pytest.mark.parametrize("case", cases.CASES, ids=lambda c: f"case {c.number}")
def test_nothing_is_found_in_twenty_sound_frames(prepared, case, validation):
    row = validation(what="IASC-ASCE frame, nothing hidden, twenty records of each case (long): silent",
                     reference="none", why="of alarms in 5 % four or more of twenty have a probability of 0.016")
    lines = [run.run_one(prepared(case), case, cases.PATTERNS[0], seed, "step") for seed in range(1, 21)]
    row.count(sum(x["judged"] == "silent" for x in lines), len(lines), 17)


@pytest.mark.long
@pytest.mark.parametrize("time_profile", ["step", "constant"])
@pytest.mark.parametrize("number", [4, 5])
def test_one_lost_brace_is_named_in_most_of_twenty_records(prepared, number, time_profile, validation):
    row = validation(what="IASC-ASCE frame, one brace lost, as a step and throughout, cases 4 and 5, twenty records of "
                          "each (long): that pair alone",
                     reference="the pattern", why="at a rate of 95 % sixteen or fewer of twenty have one of 0.016")
    case, pattern = DEFINED[number, 3]
    lines = [run.run_one(prepared(case), case, pattern, seed, time_profile) for seed in range(1, 21)]
    row.count(sum(x["judged"] == "right" for x in lines), len(lines), 17)
