"""The OC4 jacket in OpenSees: its modes beside the SubDyn file's, every hidden place at its name, and a few
records."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import opensees_loader
import pytest

from probupdate.cli import main
from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.without_model import diagnose_without_model
from probupdate.modal.modes import read_modes, write_modes
from probupdate.structure.load import load_model

STUDY = Path(__file__).resolve().parents[2] / "studies" / "oc4_jacket"
OC4 = Path(__file__).resolve().parents[3] / "shared" / "reference" / "oc4"
pytestmark = pytest.mark.skipif(not OC4.exists(), reason="the OC4 input files of ../shared/reference/oc4 are not here")


@pytest.fixture(scope="module")
def study():
    """The study's script; another study's is called run too."""
    try:
        opensees_loader.load_opensees()
    except (ImportError, OSError) as error:
        pytest.skip(f"no OpenSees here: {error}")
    sys.path.insert(0, str(STUDY))
    try:
        spec = importlib.util.spec_from_file_location("oc4_jacket_run", STUDY / "run.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(STUDY))
    return module


@pytest.fixture(scope="module")
def described(study):
    return study.jacket.read_description(OC4)


@pytest.fixture(scope="module")
def model(study, described, tmp_path_factory):
    return study.cases.write_model(OC4, tmp_path_factory.mktemp("oc4_jacket"), described)


def test_the_jacket_of_opensees_has_the_frequencies_of_the_subdyn_file_within_shear(study, described, validation):
    """In air; tubes that give way in shear lower the third pair by 1.3 %, lumped mass some more. Rigid links, pile
    heads and the assembly's offset and product of inertia are made otherwise there."""
    row = validation(what="OC4 jacket with tower in air by OpenSees (Timoshenko, lumped mass, springs below the pile "
                          "heads): how much lower five and nine frequencies are", reference="its SubDyn file",
                     why="shear")
    found, _ = study.jacket.Build(described, study.jacket.State(), dry=True).modes(9, [24])
    own = load_model(OC4 / study.jacket.INPUT).solve(np.zeros(0), 9).frequency_hz
    drop = 1 - found / own
    row.between(drop[:5], 0, 4e-3, "five")
    row.between(drop, 0, 1.5e-2, "nine")


def test_the_user_s_water_is_that_of_the_truth_within_the_waterline(study, described, model):
    cases = study.cases
    growth = {
        m: cases._thickness(described, m, cases.GROWTH_KGPM) for bay in cases.WET_BAYS for m in cases.bay_members(bay)
    }
    found, shape = cases.true_modes(described, study.jacket.State(growth_m=growth))
    one = load_model(model)
    own = one.solve(np.array(one.parameters.initial), cases.N_MODE)
    assert one.channels == cases.CHANNELS
    # the water's mass along members, which the user's line masses have, is not in the truth
    assert found == pytest.approx(own.frequency_hz, rel=1.5e-2)
    score_correlation = (
        np.abs(np.sum(shape * own.shape, axis=0)) / np.linalg.norm(shape, axis=0) / np.linalg.norm(own.shape, axis=0)
    )
    assert np.all(score_correlation > 0.995)


def signature(cases, before, after):
    """Changes of ln f and of shapes of one sign, in one vector."""
    frequency, shape = cases._as_named(*after, before[1])
    return np.r_[np.log(frequency / before[0]), (shape - before[1]).ravel()]


def test_every_hidden_place_is_at_the_parameter_of_its_name(study, described, model, validation):
    """A wrong number of a member would make a right diagnosis wrong: of all parameters of a kind, that of the name
    has the signature most like what was hidden, or as good as that; opposite legs and neighbouring bays are nearly
    alike."""
    row = validation(what="hidden places of the OC4 jacket: cosine of the signature of the parameter of that name "
                          "behind the nearest of its kind; how many places", reference="the user's model",
                     why="opposite legs and neighbouring bays are nearly alike")
    cases, jacket = study.cases, study.jacket
    one = load_model(model)
    theta, names = np.array(one.parameters.initial), one.parameters.names
    amounts = {"brace": -0.45, "wall": -0.15, "growth": 200.0, "lateral": -0.5, "axial": -0.5}

    def solved(name=None):
        moved = theta.copy()
        if name:
            moved[names.index(name)] += amounts[name.split("_")[0]]
        solution = one.solve(moved, cases.N_MODE)
        shape = np.real(solution.shape)
        return solution.frequency_hz, shape / np.abs(shape).max(axis=0)

    base = cases._as_named(*solved(), None)
    own = {name: signature(cases, base, solved(name)) for name in names if name.split("_")[0] in amounts}
    nominal = jacket.State()
    truth = cases._as_named(*cases.true_modes(described, nominal), base[1])
    seen = set()
    for number in range(9 * 40):
        (effect,) = cases.make_case("single", number).effects
        if effect.cause != "parameter" or effect.kind == "ice" or effect.location in seen:
            continue
        seen.add(effect.location)
        after = cases.true_modes(described, cases.damaged(nominal, effect, 1.0))
        hidden = signature(cases, truth, after)
        alike = {
            name: vector @ hidden / np.linalg.norm(vector) / np.linalg.norm(hidden)
            for name, vector in own.items()
            if name.split("_")[0] == effect.location.split("_")[0]
        }
        row.error(max(alike.values()) - alike[effect.location], 0.03, "behind", case=(effect, alike))
    # every pile both ways, every wetted bay, and most of 32 faces and walls
    row.least(len(seen), 35, "places")


def test_members_lie_where_their_groups_say(study, described):
    cases, d = study.cases, described
    depth = {1: (-45.6, -24.6), 2: (-24.7, -8.9), 3: (-9.0, 4.4), 4: (4.3, 16.2)}
    middle = {m: 0.5 * (d.place[one] + d.place[two]) for m, (one, two, _) in d.circular.items()}
    quadrant = {"A": (1, 1), "B": (-1, 1), "C": (-1, -1), "D": (1, -1)}
    face = {"px": (0, 1), "mx": (0, -1), "py": (1, 1), "my": (1, -1)}
    for (leg, bay), members in cases.LEG_MEMBERS.items():
        for at in (middle[m] for m in members):
            assert tuple(np.sign(at[:2]).astype(int)) == quadrant[leg] and depth[bay][0] < at[2] < depth[bay][1]
    for (bay, name), members in cases.BRACE_MEMBERS.items():
        axis, side = face[name]
        for at in (middle[m] for m in members):
            assert at[axis] * side > abs(at[1 - axis]) and depth[bay][0] < at[2] < depth[bay][1]
        # what is cut is one brace from leg to leg: its halves are in line
        for one, two in (members[:2], members[2:]):
            ends = [np.subtract(*(d.place[j] for j in d.circular[m][:2])) for m in (one, two)]
            assert abs(ends[0] @ ends[1]) > 0.99 * np.linalg.norm(ends[0]) * np.linalg.norm(ends[1])
    found_here = [m for members in (*cases.LEG_MEMBERS.values(), *cases.BRACE_MEMBERS.values()) for m in members]
    assert len(found_here) == len(set(found_here))


def test_what_is_attached_in_opensees_moves_modes_as_perturbation_says(study, described, validation):
    """Springs and a mass so weak that they are of first order: d lambda = k (d . phi)^2, -lambda m |phi|^2 of what
    swings far above the modes."""
    row = validation(what="weak springs to ground and between two joints, a mass that swings far above the modes, in "
                          "OpenSees: changes of five eigenvalues over the largest of them",
                     reference="first-order perturbation of the modes without them", why="second order")
    jacket = study.jacket
    leg, tower, water = 23, study.cases.tower_joint(described, 60.0), 22
    frequency, shape = jacket.Build(described, jacket.State()).modes(5, [leg, tower, water])
    value = (2 * np.pi * frequency) ** 2
    along = described.place[tower] - described.place[leg]
    along = along / np.linalg.norm(along)
    way = np.array([0.6, 0.8, 0.0])
    for one, expected in (
        (jacket.Attached(joint=water, direction=(0.6, 0.8, 0.0), stiffness=1e4), 1e4 * (way @ shape[2]) ** 2),
        (jacket.Attached(joint=leg, other=tower, stiffness=1e5), 1e5 * (along @ (shape[1] - shape[0])) ** 2),
        (jacket.Attached(joint=tower, mass=20.0, frequency_hz=60.0), -value * 20 * np.sum(shape[1, :2] ** 2, axis=0)),
    ):
        found, _ = jacket.Build(described, jacket.State(attached=(one,))).modes(5, [leg])
        change = (2 * np.pi * found) ** 2 - value
        row.error(np.max(np.abs(change - expected)) / np.max(np.abs(expected)), 0.02, "change", case=one)


def test_the_modes_that_are_looked_for_are_followed_beside_a_second_structure(study, described):
    """Five of each half hour, whichever share their frequency with what swings beside the leg."""
    case = study.cases.unknown_case(described, 3)
    assert case.effects[0].kind == "second structure" and case.effects[0].time_profile == "constant"
    data = study.cases.record(described, case)
    shapes = np.array([s.shape / np.linalg.norm(s.shape, axis=0) for s in data.sets])
    frequency = np.array([s.frequency_hz for s in data.sets])
    assert np.abs(frequency / frequency.mean(axis=0) - 1).max() < 0.02
    # both pairs turn freely from half hour to half hour: what stays is their plane
    for own in (slice(0, 2), slice(2, 4), slice(4, 5)):
        cosines = [np.linalg.svd(shapes[0][:, own].conj().T @ one[:, own], compute_uv=False) for one in shapes]
        whole = [np.linalg.svd(one[:, own], compute_uv=False) for one in shapes]
        assert np.min(np.prod(cosines, axis=1) / np.prod(whole, axis=1) / np.prod(whole[0])) > 0.98


def test_a_mount_that_resonates_below_one_channel_is_no_filter_of_its_sensor(study, described, model, validation):
    row = validation(what="a mount that resonates at 3.3 Hz below one channel of the OC4 jacket's tower in OpenSees: "
                          "channel; factor and phase in three groups of modes in their standard deviations",
                     reference="the mount's frequency response", why="three modes, not independent")
    case = study.cases.mount_case(0)
    (effect,) = case.effects
    outcome = examine(prepare(model), study.cases.record(described, case))
    own, blocks = outcome.own_response, outcome.problem.blocks
    row.equal((outcome.diagnosis.verdict, own.row.location), ("unexplained", effect.location), "channel")
    hz = {blocks.group_name(q): np.median(blocks.frequency_hz[:, list(g)]) for q, g in enumerate(blocks.groups)}
    for one in own.factors():
        true = study.cases.of_mount(hz[one["mode"]], effect.parts["resonance_hz"])
        row.error((one["factor"] - abs(true)) / one["factor_std"], 3, "factor", case=one["mode"])
        row.error((one["phase_deg"] - np.degrees(np.angle(true))) / one["phase_std_deg"], 3, "phase", case=one["mode"])


def test_sensor_faults_act_on_the_channels_they_name(study):
    cases = study.cases
    shape = np.arange(1.0, 1 + len(cases.CHANNELS) * cases.N_MODE).reshape(len(cases.CHANNELS), -1)
    for number in range(90):
        (effect,) = cases.make_case("single", number).effects
        changed = {cases.CHANNELS[k] for k in np.flatnonzero(np.any(cases.seen(shape, effect, 1.0) != shape, axis=1))}
        assert changed == (set(effect.location.split(" and ")) if effect.cause != "parameter" else set())


def test_a_case_is_the_same_for_ever(study, described):
    case = study.cases.make_case("single", 1)
    one, two = (study.cases.record(described, case).sets[3] for _ in range(2))
    np.testing.assert_allclose(one.shape, two.shape, rtol=0, atol=1e-6)
    np.testing.assert_allclose(one.frequency_hz, two.frequency_hz, rtol=1e-9)


def test_what_sets_state_of_their_scatter_is_the_same_written_otherwise(study, described):
    one = study.cases.record(described, study.cases.make_case("null", 0)).sets[0]
    stated = study.cases.as_stated(one, "std")
    covariance = one.frequency_hz**2 * np.sum(one.covariance_factors.ln_frequency**2, axis=1)
    np.testing.assert_allclose(stated.frequency_std_hz, np.sqrt(covariance))
    assert stated.covariance_factors is None
    scatter = np.sum(one.covariance_factors.shape.real ** 2, axis=-1)
    np.testing.assert_allclose(stated.shape_std, np.sqrt(scatter), rtol=1e-9, atol=1e-12)
    assert np.isnan(study.cases.as_stated(one, "none").frequency_std_hz).all()


@pytest.mark.parametrize(("family", "number", "judged"), [("null", 0, "silent"), ("single", 1, "right")])
def test_a_record_of_opensees_by_the_command_line(study, described, model, tmp_path, family, number, judged,
                                                  validation):
    """Nothing hidden, and a channel of the jacket that shows a fifth too much: files as a user has them."""
    row = validation(what="records of the OC4 jacket by OpenSees, nothing hidden and a gain of a fifth (rates in "
                          "`studies/oc4_jacket`): silent, cause and place; size in its standard deviations",
                     reference="what was hidden")
    case = study.cases.make_case(family, number)
    modes, out = tmp_path / "modes.json", tmp_path / "diagnosis.json"
    write_modes(study.cases.record(described, case), modes)
    assert read_modes(modes).sets[0].covariance_factors is not None
    assert main(["diagnose", "--model", str(model), "--modes", str(modes), "--no-extend", "--out", str(out)]) == 0
    found = json.loads(out.read_text())
    hidden = [study.hidden_row(e, ()) for e in case.effects]
    for finding in found["findings"]:
        finding["alternatives"] = [[a["cause"], a["location"]] for a in finding["alternatives"]]
    row.equal(study.judged(found["verdict"], found["findings"], hidden), judged, "cause, place")
    if case.effects:
        (finding,) = found["findings"]
        row.error((finding["size"] - case.effects[0].size) / finding["size_std"], 3, "size")


def test_without_a_model_the_jacket_s_tide_at_most_is_named(study, described, model, validation):
    """Its tower's three heights are one level by name, its legs' levels are not rigid; a step of the structure has its
    block and no name."""
    row = validation(what="OC4 jacket of OpenSees without a model, two records with tide, temperature and wind alone: "
                          "silent, or the tide", reference="none")
    sensors, cases = prepare(model).sensors, study.cases
    found = [diagnose_without_model(cases.record(described, cases.make_case("null", k)), sensors) for k in range(2)]
    row.count(sum({f.time_profile for f in one.findings} <= {"water_level_m"} and one.verdict in ("none", "named")
                  for one in found), 2, 2, case=str([one.verdict for one in found]))
    lowered = cases.make_case("single", 7)
    (effect,) = lowered.effects
    assert (effect.kind, effect.time_profile) == ("axial", "step")
    one = diagnose_without_model(cases.record(described, lowered), sensors)
    assert one.verdict == "unexplained" and not any(f.kind == "measurement" for f in one.findings)


@pytest.mark.long
def test_without_a_model_what_the_structure_does_is_no_sensor_s(study, described, model):
    """A bay without most of a brace (a gain of -15 % at 0.993 where only sensors competed), growth along a ramp (two
    gains and a step of the sampling rate at 1.00)."""
    sensors, cases = prepare(model).sensors, study.cases
    for number, kind in ((414, "brace"), (447, "growth")):
        case = cases.make_case("single", number)
        assert case.effects[0].kind == kind
        found = diagnose_without_model(cases.record(described, case), sensors)
        assert found.verdict != "named", found.findings
        assert not [f for f in found.findings if f.kind == "measurement" and f.posterior_probability > 0.5]
