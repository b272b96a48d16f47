"""Effects in model.toml: extended files, mistakes named in one line, the catalogue."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from effects_turbine import SAMPLES, entry, model, sample, with_effects
from small_turbine import SENSORS

from probupdate.effects.turbine import turbine_effects
from probupdate.errors import InputError
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.effect_kinds import KINDS
from probupdate.structure.extend import EffectParameter, extended_model, extended_text, parameter_text, write_extended
from probupdate.structure.load import load_model, reference_model
from probupdate.structure.parameter_table import KEYS

REFERENCE = reference_model("as_built")
CHOSEN = (
    EffectParameter(name="face \"AB\" lost", kind="stiffness", on={"group": "brace", "face": "AB", "bay": 2},
           settings={"motion": "axial"}, std=0.1 + 0.2, lower=0.0, upper=2.0, cause="brace loss", location="face AB"),
    EffectParameter(name="scour_A", kind="scour", on={"leg": "A"}, std=1.0, lower=0.0, upper=5.0),
    EffectParameter(name="band", kind="growth", on={"level_m": (-15.0, -5.0)}, std=0.05, lower=0.0, upper=0.3,
           prior="normal"),
    EffectParameter(name="ice", kind="mass", on={"body": "hub"}, settings={"inertia_per_kg_m2": (0.0, 100.0, 1e-17)},
           std=1e3, lower=0.0, upper=1e5),
)


def test_the_written_file_is_the_extended_model(tmp_path):
    extended = extended_model(REFERENCE, CHOSEN)
    path = write_extended(REFERENCE, CHOSEN, tmp_path / "model.toml")
    read = load_model(path)
    assert read.fingerprint() == extended.fingerprint() != load_model(REFERENCE).fingerprint()
    assert read.parameters.items == extended.parameters.items
    theta = extended.parameters.initial + 0.1 * extended.parameters.std
    assert np.array_equal(read.solve(theta, 6).frequency_hz, extended.solve(theta, 6).frequency_hz)
    # a second time, on what was written
    again = write_extended(path, [EffectParameter(name="more", kind="weight", std=1.0, lower=0.0, upper=2.0)], path)
    assert load_model(again).parameters.names == (*extended.parameters.names, "more")


def test_the_user_s_own_text_stays():
    own = REFERENCE.read_text(encoding="utf-8")
    text = extended_text(REFERENCE, CHOSEN)
    assert text.startswith(own) and "#" in own
    added = tomllib.loads(text[len(own) :])["parameter"]
    assert [table["name"] for table in added] == [effect.name for effect in CHOSEN]
    assert added[0]["on"] == {"group": "brace", "face": "AB", "bay": 2} and added[0]["std"] == 0.1 + 0.2


@pytest.mark.parametrize("value", [1, True, -1.5, 1e-300, np.inf, -np.inf, "a \"quoted\" \\ name\n", [1.0, 2.0],
                                   {"a": [1], "b": "c"}, "Gründung"])
def test_values_survive_being_written(value):
    (table,) = tomllib.loads(parameter_text({"name": value}))["parameter"]
    assert table == {"name": value}


def test_own_parameters_sensors_and_the_nacelle_come_along():
    one = Parameters(
        (Parameter(name="k_t", unit="-", initial=1.2, std=0.1), Parameter(name="k_j", unit="-", initial=1.0, std=0.1)),
        np.array([[1.0, 0.4], [0.4, 1.0]]),
    )
    sensor = Sensor(channel="new", level="top", position_m=[0, 0, 80.0], direction=[0, 1.0, 0])
    found = extended_model(REFERENCE, CHOSEN[1:2], parameters=one, sensors=[sensor], nacelle_angle_deg=30.0)
    assert found.parameters.names == ("k_t", "k_j", "scour_A") and found.channels == ("new",)
    assert found.parameters.correlation == pytest.approx(np.array([[1, 0.4, 0], [0.4, 1, 0], [0, 0, 1]]))
    bare = load_model(REFERENCE, parameters=one, sensors=[sensor], nacelle_angle_deg=30.0)
    expected = bare.solve(one.initial, 6)
    neutral = found.solve(found.parameters.initial, 6)
    assert neutral.frequency_hz == pytest.approx(expected.frequency_hz, rel=1e-10)


def test_sensors_on_the_members_that_effects_cut():
    raw = with_effects([entry("e", "corrosion", {"group": "tower", "level_m": [29.5, 30.2]}, None, (0.0, 0.01))])
    found = model(raw)
    assert found.channels == tuple(name for name, *_ in SENSORS)
    coarse, fine = (m.solve(m.parameters.initial, 2).shape for m in (model(with_effects([sample("scour")])), found))
    # the channel at 30 m now sits in another element
    assert np.abs(fine) == pytest.approx(np.abs(coarse), abs=1e-3 * np.abs(coarse).max())


def mistake(entries, **rows):
    with pytest.raises(InputError) as caught:
        model(with_effects(entries, **rows))
    text = str(caught.value)
    assert text.startswith("model.toml: ") and "\n" not in text
    return text.removeprefix("model.toml: ")


BRACE = {"group": "brace", "face": "AB"}


@pytest.mark.parametrize(
    ("table", "key", "problem"),
    [
        (entry("e", "stiffness", {"group": "deck"}), "parameter[18].on.group", "'deck' is wrong"),
        (entry("e", "stiffness", BRACE) | {"kind": "stifness"}, "parameter[18] e.kind",
         "'stifness' is unknown; did you mean 'stiffness'?"),
        (entry("k_t", "stiffness", BRACE, None, (0.1, 2.0)), "parameter", "'k_t' is listed twice"),
        (entry("e", "stiffness", {"face": "AC"}, None, (0.1, 2.0)), "parameter[18] e.on.face",
         "'AC' is not in this structure"),
        (entry("e", "stiffness", {"leg": "E"}, None, (0.1, 2.0)), "parameter[18] e.on.leg", "not in this structure"),
        (entry("e", "stiffness", {"bay": 2}, None, (0.1, 2.0)), "parameter[18] e.on.bay",
         "there is no bay 2; count from the lowest, 1 to 1"),
        (entry("e", "stiffness", {"level_m": [3.0, 1.0]}, None, (0.1, 2.0)), "parameter[18] e.on.level_m",
         "3.0 is not below 1.0"),
        (entry("e", "stiffness", {"part": "brace AB-7"}, None, (0.1, 2.0)), "parameter e",
         "finds nothing to act on at part = brace AB-7"),
        (entry("e", "stiffness", {"group": "leg", "level_m": [20.0, 30.0]}, None, (0.1, 2.0)), "parameter e",
         "finds nothing to act on at group = leg"),
        (entry("e", "stiffness", {"level": 2}, None, (0.1, 2.0)), "parameter[18].on.level",
         "not a key of this file; did you mean 'level_m'?"),
        (entry("e", "stiffness", BRACE, None, (0.0, 2.0)), "parameter[18] e.lower", "it must be above 0"),
        (entry("e", "joint", BRACE, None, (-0.1, 2.0)), "parameter[18] e.on.group", "means nothing for the kind"),
        (entry("e", "joint", {"bay": 1}, None, (-0.1, 2.0)), "parameter[18] e.lower", "it must be not below 0"),
        (entry("e", "joint", {"bay": 1}, {"motion": "bending"}, (0.1, 2.0)), "parameter[18] e.motion",
         "'bending' is not one of the kind 'joint'"),
        (entry("e", "soil", {"leg": "A"}, None, (0.1, 2.0)), "parameter[18] e.curve", "is missing for the kind 'soil'"),
        (entry("e", "scour", {"leg": "A"}, {"curve": "py"}, (0.0, 2.0)), "parameter[18] e.curve",
         "means nothing for the kind 'scour'"),
        (entry("e", "scour", {"leg": "A"}, None, (-0.9, 2.0)), "parameter e", "scour of -0.2 m at leg A is none"),
        (entry("e", "scour", {"leg": "A"}, None, (0.0, 25.0)), "parameter e", "lays the pile tip bare"),
        (entry("e", "growth", None, None, (-0.1, 0.2)), "parameter e.lower", "growth and mg at their least come to"),
        (entry("e", "corrosion", BRACE, None, (0.0, 0.02)), "parameter e",
         "corrosion at its upper bounds leaves brace AB-1 a wall of -4.0 mm"),
        (entry("e", "hinge", {"leg": "A"}, {"at_m": -19.0}, (0.0, 1.0)), "parameter[18] e.on",
         "does not say which members are joined"),
        (entry("e", "hinge", {"group": "tower"}, {"at_m": 5.0}, (0.0, 1.0)), "parameter e", "finds nothing to act on"),
        (entry("e", "mass", None, None, (0.0, 1.0)), "parameter[18] e.on", "says nothing; name a body or members"),
        (entry("e", "mass", {"body": "spinner"}, None, (0.0, 1.0)), "parameter[18] e.on.body", "not in this structure"),
        (entry("e", "mass", {"body": "hub", "leg": "A"}, None, (0.0, 1.0)), "parameter[18] e.on",
         "names a body and members"),
        (entry("e", "mass", {"body": "hub"}, None, (-7e4, 1.0)), "parameter[18] e.lower", "is all of the body's"),
        (entry("e", "mass", {"leg": "A"}, {"inertia_per_kg_m2": [0.0, 0.0, 1.0]}, (0.0, 1.0)),
         "parameter[18] e.inertia_per_kg_m2", "belongs to a body"),
        (entry("e", "inertia", {"body": "hub"}, {"axis": "z"}, (-7e6, 1.0)), "parameter[18] e.lower",
         "is more than the body's own 6e+06 kg m2"),
        (entry("e", "oscillator", None, {"axis": "x", "frequency_hz": 1.0}, (1e-4, 0.5)), "parameter[18] e.on",
         "names no body"),
        (entry("e", "oscillator", {"body": "hub"}, {"axis": "x", "frequency_hz": 1.0}, (1e-4, 1.0)),
         "parameter[18] e.upper", "1.0 of the body's mass cannot swing"),
        (entry("e", "water_level", None, None, (-np.inf, 1.0)), "parameter[18] e.upper", "range is not bounded"),
        (entry("e", "flooding", BRACE, None, (0.0, 1.5)), "parameter[18] e.upper", "1.5 is more than a full bore"),
        ({"name": "e", "unit": "-", "initial": 1.0, "std": 0.1, "on": BRACE}, "parameter[18] e",
         "'e' is not a parameter of this model"),
    ],
)
def test_mistakes_are_named(table, key, problem):
    text = mistake([table])
    assert text.startswith(f"{key}: "), text
    assert problem in text
    assert len(text.split("; ")) >= 2, "no remedy"


def test_rows_of_table_2_act_everywhere():
    raw = with_effects([sample("scour")])
    raw["parameter"][1]["on"] = {"leg": "A"}
    with pytest.raises(InputError, match=r"parameter\[2\] k_t: says where or how it acts, but not of which kind"):
        model(raw)
    raw = with_effects([sample("scour")])
    raw["parameter"][1] |= {"kind": "stiffness"}
    with pytest.raises(InputError, match=r"parameter\[2\] k_t\.kind: 'k_t' is a parameter of the whole structure"):
        model(raw)


def test_two_connections_in_one_element_are_refused():
    raw = with_effects([entry("low", "hinge", {"group": "column"}, {"at_m": 11.0}, (0.0, 1.0)),
                        entry("high", "hinge", {"group": "column"}, {"at_m": 12.0}, (0.0, 1.0))])
    with pytest.raises(InputError, match="a hinge at either end"):
        model(raw)
    raw["mesh"]["elements_per_member"]["column"] = 2
    assert model(raw).parameters.names == ("low", "high")


def test_rigid_joints_have_nothing_to_loosen():
    raw = with_effects([entry("e", "joint", {"bay": 1}, None, (0.0, 2.0))])
    raw["jacket"]["joints"]["law"] = "rigid"
    with pytest.raises(InputError, match="finds nothing to act on"):
        model(raw)


def test_effects_at_different_places_are_told_apart():
    prints = {model(with_effects([e])).fingerprint() for e in (
        entry("e", "scour", {"leg": "A"}, None, (0.0, 1.0)), entry("e", "scour", {"leg": "B"}, None, (0.0, 1.0)),
        entry("e", "scour", None, None, (0.0, 1.0)), entry("e", "soil", {"leg": "A"}, {"curve": "py"}, (0.1, 2.0)),
        entry("e", "soil", {"leg": "A"}, {"curve": "tz"}, (0.1, 2.0)),
    )}
    assert len(prints) == 5


def test_models_of_matrices_take_none(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text('format = 1\nname = "m"\n[matrices]\nfile = "model.npz"\n')
    with pytest.raises(InputError, match="a model of matrices takes no effects"):
        extended_model(path, CHOSEN)
    with pytest.raises(InputError, match="the kind 'loss' is unknown"):
        EffectParameter(name="e", kind="loss", std=1.0, lower=0.0, upper=1.0)


def test_kinds_have_a_meaning_and_do_not_clash_with_keys():
    for name, kind in KINDS.items():
        assert kind.meaning and kind.unit and kind.lowest <= kind.neutral, name
        assert not set(kind.needs) & set(kind.may) and not {*kind.needs, *kind.may} & set(KEYS)
    assert {kind for kind, *_ in SAMPLES.values()} == set(KINDS)


@pytest.fixture(scope="module")
def catalogue():
    d = parse_description(with_effects([sample("scour")]), "m")
    return tuple(row.adds for row in turbine_effects(d))


def test_the_catalogue_covers_every_leg_face_bay_and_kind(catalogue):
    names = [effect.name for effect in catalogue]
    assert len(set(names)) == len(names)
    # the factor on added mass is a row of Table 2 and no effect of its own
    assert {effect.kind for effect in catalogue} == set(KINDS) - {"added_mass"}
    for leg in "ABCD":
        for cause in ("scour", "soil stiffness", "lateral soil stiffness", "axial soil stiffness",
                      "pile tip's soil stiffness", "marine growth", "corrosion", "leg stiffness lost",
                      "grout flexibility in bending", "grout flexibility along the pile",
                      "transition-piece flexibility", "leg not flooded"):
            assert any(e.cause == cause and e.on.get("leg") == leg for e in catalogue), (cause, leg)
    for face in ("AB", "BC", "CD", "DA"):
        for cause in ("brace stiffness lost", "joints loosened", "flooded braces"):
            assert any(e.cause == cause and e.on.get("face") == face and e.on["bay"] == 1 for e in catalogue)
    assert all(effect.lower <= effect.neutral <= effect.upper and effect.location for effect in catalogue)
    assert all(effect.prior == "normal" or effect.neutral > 0 for effect in catalogue)


def test_every_effect_of_the_catalogue_shows_at_the_channels(catalogue):
    """All at once, exact slopes at neutral: each moves a frequency or a shape by more than rounding when it is as
    large as its prior's standard deviation."""
    raw = with_effects([effect.table() for effect in catalogue])
    # sensors see the legs in both directions: an effect on one leg or face must not hide in symmetry
    turbine = model(raw)
    assert turbine.parameters.names == tuple(effect.name for effect in catalogue)
    solution = turbine.solve(turbine.parameters.initial, 7, derivatives=True)
    std = turbine.parameters.std
    relative = np.abs(solution.frequency_derivative * std / solution.frequency_hz[:, None]).max(axis=0)
    shape = np.abs(solution.shape_derivative * std).max(axis=(0, 1)) / np.abs(solution.shape).max()
    weak = [e.name for e, r, s in zip(catalogue, relative, shape, strict=True) if max(r, s) < 1e-7]
    assert not weak


def test_the_reference_turbine_s_catalogue_is_accepted_as_a_file(tmp_path):
    for state in ("design", "as_built", "updated"):
        path = reference_model(state)
        effects = [row.adds for row in turbine_effects(read_description(path))]
        assert len(effects) > 130
        text = extended_text(path, effects)
        assert len(tomllib.loads(text)["parameter"]) == 17 + len(effects)
        # walls stay where the catalogue's corrosion and the file's own parameters take most of them
        assert len(extended_model(path, effects).parameters) >= len(effects)


@pytest.mark.parametrize("state", ["design", "as_built", "updated"])
def test_the_reference_files_tell_of_every_kind_and_their_example_works(state, tmp_path):
    text = reference_model(state).read_text(encoding="utf-8")
    lines = [line.removeprefix("# ").removeprefix("#") for line in text[text.index("# Effects:") :].splitlines()]
    for name, kind in KINDS.items():
        (row,) = (line.split() for line in lines if line.startswith(f"{name} "))
        assert float(row[1]) == kind.neutral and " ".join(row[2:4]).startswith(kind.unit), name
        known = " ".join(lines)
        assert all(key in known for key in (*kind.needs, *kind.may)), name
    example = lines[lines.index("[[parameter]]") : lines.index("upper = 2.0") + 1]
    path = tmp_path / "model.toml"
    path.write_text(text + "\n".join(example))
    assert load_model(path).parameters.names[-1] == "face_AB_2"


def test_the_lines_of_the_page_run(tmp_path, monkeypatch):
    page = (Path(__file__).resolve().parents[2] / "docs" / "howto" / "python.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```py\n(.*?)```", page, re.DOTALL)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "model.toml").write_bytes(REFERENCE.read_bytes())
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(block, "python.md", "exec"), names)
    assert f"{len(names['effects'])} for the reference" in block
    assert load_model(tmp_path / "run" / "extended.toml").fingerprint() == names["model"].fingerprint()


def test_what_changes_in_a_structure_may_do_so_within_a_record():
    """A nacelle that moved within a record was *unexplained*: its row knew a constant only. A theory changes never."""
    rows = [e for e in turbine_effects(read_description(REFERENCE)) if e.kind == "structural"]
    only = {e.cause for e in rows if not {"constant", "step"} <= set(e.time_profiles)}
    assert len(rows) > 50 and only <= {"shear deformation"}


@pytest.mark.parametrize(("growth_top_m", "splash_m"), [(-25.0, (-3.0, 2.0)), (-0.5, (40.0, 44.0))])
def test_no_row_of_the_catalogue_acts_on_nothing(tmp_path, growth_top_m, splash_m):
    """Growth that ends below bays that are under water, a splash zone above the jacket."""
    text = REFERENCE.read_text(encoding="utf-8")
    for key, table, value in (("growth_top_m", "hydrodynamics", growth_top_m), ("bottom_m", "corrosion", splash_m[0]),
                              ("top_m", "corrosion", splash_m[1])):
        before, own = text.split(f"[{table}]")
        text = f"{before}[{table}]{re.sub(rf'^{key} = [-0-9.]+', f'{key} = {value}', own, count=1, flags=re.MULTILINE)}"
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    assert read_description(path).hydrodynamics.growth_top_m == growth_top_m
    rows = [row.adds for row in turbine_effects(read_description(path))]
    assert len(extended_model(path, rows).parameters) >= len(rows)
