"""Every mistake in a model file is one line that names the file, the key and the remedy."""

import re

import numpy as np
import pytest
from drawn import toml_text

import probupdate
from probupdate.errors import InputError
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.load import load_model, reference_model, turbine_model
from probupdate.structure.parameter_table import read_toml


def put(raw, path, value):
    """Set raw[a][b].. from 'a.b[1].c', counted from 1 as the messages count."""
    steps = [int(s) - 1 if s.isdigit() else s for s in re.findall(r"\w+", path)]
    for step in steps[:-1]:
        raw = raw[step]
    raw[steps[-1]] = value


def message(raw):
    with pytest.raises(InputError) as caught:
        parse_description(raw, "model.toml")
    text = str(caught.value)
    assert text.startswith("model.toml: ") and "\n" not in text
    return text.removeprefix("model.toml: ")


@pytest.mark.parametrize(
    ("path", "value", "key", "problem"),
    [
        ("jacket.leg.thickness_m", -0.03, "jacket.leg.thickness_m", "-0.03 is wrong: input should be greater than 0"),
        ("jacket.leg.thickness_m", 0.5, "jacket.leg.thickness_m", "0.5 m does not fit into a tube of 0.9 m"),
        ("tower.station[2].thickness_m", 1.9, "tower.station[2].thickness_m", "does not fit into a tube of 3.5 m"),
        ("steel.density_kgpm3", float("nan"), "steel.density_kgpm3", "nan is not a finite number"),
        ("steel.youngs_modulus_pa", 2.1e5, "steel.youngs_modulus_pa", "210000 is outside 1e+10 to 1e+12"),
        ("steel.density_kgpm3", 7.85, "steel.density_kgpm3", "7.85 is outside 500 to 25000"),
        ("site.water_density_kgpm3", 1.025, "site.water_density_kgpm3", "give it in kg/m3: sea water has 1025"),
        ("soil.submerged_unit_weight_npm3", 9.0, "soil.submerged_unit_weight_npm3", "give it in N/m3"),
        ("soil.undrained_shear_strength_pa", {"at_mudline": 60.0, "gradient_per_m": 1.5},
         "soil.undrained_shear_strength_pa", "give Pa, not kPa"),
        ("soil.strain_50", float("inf"), "soil.strain_50", "inf is not a finite number"),
        ("steel.youngs_modulus_pa", "2.1e11", "steel.youngs_modulus_pa", "'2.1e11' is wrong"),
        ("steel.poisson_ratio", 0.5, "steel.poisson_ratio", "0.5 is wrong"),
        ("jacket.flooded", 1, "jacket.flooded", "1 is wrong"),
        ("jacket.leg.thikness_m", 0.03, "jacket.leg.thikness_m", "not a key of this file; did you mean 'thickness_m'?"),
        ("jakcet", {}, "jakcet", "not a key of this file; did you mean 'jacket'?"),
        ("pile.tip_m", -10.0, "pile.tip_m", "-10.0 is not below site.mudline_m = -20.0"),
        ("jacket.bottom.z_m", -21.0, "jacket.bottom.z_m", "below the mudline"),
        ("jacket.top.z_m", 30.0, "jacket.top.z_m", "is not below transition_piece.strut_top_m"),
        ("transition_piece.strut_top_m", 12.5, "transition_piece.strut_top_m", "is above the tower's foot 12.0"),
        ("tower.station[2].z_m", 11.5, "tower.station[2].z_m", "11.5 is not above 12.0"),
        ("tower.station[2].z_m", 12.0, "tower.station[2].z_m", "are a step of the wall"),
        ("jacket.bay[1].top_m", 9.0, "jacket.bay[1]", "beyond the legs, -19.0 to 8.0 m"),
        ("jacket.bay[1].top_m", -18.5, "jacket.bay[1].bottom_m", "-18.0 is not below top_m = -18.5"),
        ("jacket.leg_names", ["A", "B", "B", "D"], "jacket.leg_names", "'B' is listed twice"),
        ("rna[2].name", "rotor", "rna", "no body is named 'hub'"),
        ("sensor[2].channel", "TP-A-x", "sensor", "'TP-A-x' is listed twice"),
        ("sensor[1].direction", [1.0, 1.0, 0.0], "sensor[1] TP-A-x.direction", "its length is 1.41, not 1"),
        ("sensor[1].quantity", "speed", "sensor[1].quantity", "'speed' is wrong"),
        ("mesh.theory", "euler", "mesh.theory", "'euler' is wrong"),
        ("mesh.elements_per_member.leg", 0, "mesh.elements_per_member.leg", "0 is wrong"),
        ("parameter[1].name", "kj", "parameter[1] kj", "not a parameter of this model; did you mean 'k_j'?"),
        ("parameter[1].cov", 0.1, "parameter[1] k_j", "both cov and std given"),
        ("parameter[1].std", None, "parameter[1] k_j", "neither cov nor std given"),
        ("parameter[1].initial", 5.0, "parameter[1] k_j.initial", "5.0 is outside [0.2, 3.0]"),
        ("parameter[1].lower", 0.0, "parameter[1] k_j.lower", "0.0 makes no structure: it must be above 0"),
        ("parameter[10].lower", -1.0, "parameter[10] sc.lower", "-1.0 makes no structure: it must be not below 0"),
        ("parameter[10].upper", 40.0, "parameter sc", "scour of 40.0 m lays the pile tip bare"),
        ("parameter[11].upper", 0.03, "jacket.leg", "leave a wall of -9.0 mm"),
        ("parameter[9].upper", 40.0, "jacket.bay[1].brace", "close the bore"),
        ("parameter[2].name", "k_j", "parameter", "'k_j' is listed twice"),
        ("jacket.leg_names", ["A", "B", "C", " "], "jacket.leg_names[4]", "' ' is no name"),
        ("jacket.leg_names", ["1", "2", "3", "1 "], "jacket.leg_names", "'1' is listed twice"),
        ("parameter[1].prior", "flat", "parameter[1].prior", "'flat' is wrong"),
        ("correlation", {"k_j": {"k_q": 0.5}}, "correlation.k_j", "'k_q' is not an updated parameter"),
        ("correlation", {"k_j": {"k_t": 1.5}}, "correlation.k_j.k_t", "1.5 is wrong"),
    ],
)
def test_mistakes_are_named(raw, path, value, key, problem):
    put(raw, path, value)
    text = message(raw)
    assert text.startswith(f"{key}: "), text
    assert problem in text
    assert len(text.split("; ")) >= 2, "no remedy"


@pytest.mark.parametrize("table", ["site", "steel", "soil", "jacket", "tower", "rna"])
def test_missing_tables_are_named(raw, table):
    del raw[table]
    assert message(raw).startswith(f"{table}: is missing; add it")


def test_other_mistakes_are_counted(raw):
    raw["transition_piece"]["tie"]["thickness_m"] = 0.5
    raw["pile"]["thickness_m"] = 0.9
    assert message(raw).endswith("(1 more mistake in this file: transition_piece.tie.thickness_m)")
    raw["tower"]["station"][0]["thickness_m"] = 9.0
    assert "(2 more mistakes in this file: " in message(raw)


def test_a_list_whose_entries_have_mistakes_is_not_called_short(raw):
    for station in raw["tower"]["station"]:
        del station["flange_kg"]
    assert message(raw).startswith("tower.station[1].flange_kg: is missing; add it")
    assert "tower.station[2].flange_kg" in message(raw) and "tuple" not in message(raw)
    raw["tower"]["station"] = [{"z_m": 20.0, "diameter_m": 5.0, "thickness_m": 0.03, "flange_kg": 0.0}]
    assert message(raw).startswith("tower.station: has 1 of at least 2 entries; add another [[tower.station]]")


def test_a_number_where_a_table_belongs_is_shown_the_table(raw):
    raw["soil"]["undrained_shear_strength_pa"] = 80000.0
    assert message(raw).startswith(
        "soil.undrained_shear_strength_pa: 80000.0 is not a table; write undrained_shear_strength_pa = { at_mudline = "
        "..., gradient_per_m = ... }")


def test_cov_of_a_zero_initial_value(raw):
    entry = raw["parameter"][9]
    assert entry.pop("std") and entry["name"] == "sc"
    entry |= {"initial": 0.0, "cov": 0.1}
    assert message(raw).startswith("parameter[10] sc.cov: is relative to an initial value of 0; give std")


def test_no_updated_parameter(raw):
    for entry in raw["parameter"]:
        entry["update"] = False
    assert message(raw).startswith("parameter: none has update = true")


def model(raw, **kwargs):
    return turbine_model(parse_description(raw, "model.toml"), where="model.toml", **kwargs)


def test_sensors_that_cannot_be_where_they_are_said(raw):
    raw["sensor"][0]["position_m"] = [9.0, 9.0, 8.0]
    with pytest.raises(InputError, match=r"model\.toml: sensor TP-A-x: 8\.\d m from the surface of leg A \(at most 2"):
        model(raw)
    raw["sensor"][0] |= {"position_m": [2.5, 2.5, 8.0], "part": "leg Q"}
    with pytest.raises(InputError, match="sensor TP-A-x: part 'leg Q' is not in the model; did you mean 'leg"):
        model(raw)
    raw["sensor"] = []
    with pytest.raises(InputError, match=r"lists no \[\[sensor\]\]"):
        model(raw)


def test_joint_law_that_is_not_there(raw):
    raw["jacket"]["joints"]["law"] = "buitrago"
    with pytest.raises(InputError, match=r"jacket\.joints\.law: 'buitrago' is unknown"):
        model(raw)


def test_parameters_from_outside(raw):
    other = Parameters((Parameter(name="k_h", unit="-", initial=1.0, std=0.1),))
    with pytest.raises(InputError, match=r"parameter k_h: the model has no such parameter; did you mean '[km]_"):
        model(raw, parameters=other)
    one = Parameters((Parameter(name="k_t", unit="-", initial=1.2, std=0.1, lower=0.5, upper=2.0),))
    assert model(raw, parameters=one).parameters.names == ("k_t",)


def test_sensors_of_a_campaign_replace_the_models_own(raw):
    sensor = Sensor(channel="new", level="top", position_m=[0, 0, 49.0], direction=[0, 1.0, 0])
    found = model(raw, sensors=[sensor])
    assert found.channels == ("new",)
    assert found.channel_matrix.shape == (1, found.n_dof)
    theta = found.parameters.initial
    top = model(raw).solve(theta, 2).shape[8]
    # a metre below the tower's top the first two modes move almost as the top does
    assert found.solve(theta, 2).shape[0] == pytest.approx(top, rel=0.05, abs=0.05 * np.abs(top).max())


def test_files_that_are_no_model(tmp_path):
    with pytest.raises(InputError, match=r"gone\.toml: no such file"):
        load_model(tmp_path / "gone.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("format = = 1")
    with pytest.raises(InputError, match=r"broken\.toml: not TOML"):
        load_model(broken)
    with pytest.raises(InputError, match=r"gone\.npz: no such file"):
        load_model(tmp_path / "gone.npz", sensors=())
    with pytest.raises(InputError, match="is not a form of model"):
        load_model(tmp_path / "model.inp")
    with pytest.raises(InputError, match="updatd: is not a state .* did you mean 'updated'"):
        load_model("updatd")
    with pytest.raises(InputError, match="is a directory.*did you mean '.*broken.toml'"):
        load_model(tmp_path)
    with pytest.raises(InputError, match=r"'\.tml' is not a form of model; did you mean '.*broken\.toml'"):
        load_model(tmp_path / "broken.tml")
    with pytest.raises(InputError, match=r"brokn\.toml: no such file; .*did you mean '.*broken\.toml'"):
        load_model(tmp_path / "brokn.toml")
    with pytest.raises(InputError, match="state 'worn' is unknown; choose from design, as_built, updated"):
        reference_model("worn")


def test_reference_models_that_are_shipped_load_and_stand():
    for state in ("design", "as_built", "updated"):
        path = reference_model(state)
        description = read_description(path)
        assert len(description.parameter) == 17
        found = load_model(path)
        frequency = found.solve(found.parameters.initial, 6).frequency_hz
        # first pair, torsion, second pair, and braces above them
        assert np.all((frequency[:2] > 0.29) & (frequency[:2] < 0.33)) and 1.1 < frequency[2] < 1.4
        assert np.all((frequency[3:5] > 1.3) & (frequency[3:5] < 2.1)) and frequency[5] > 2.2
        assert found.wireframe(found.parameters.initial, 1).displacement.shape == (*found.wire.node_m.shape, 1)


@pytest.mark.parametrize("kind", ["monopile", "jacket", "tower"])
@pytest.mark.parametrize("inertia", [1.0, 1e-3], ids=["inertia in kg m2", "in t m2"])
def test_a_rotor_and_nacelle_in_tonnes_are_asked_about(kind, inertia, tmp_path):
    probupdate.template(kind, tmp_path / "sound.toml")
    raw = read_toml(tmp_path / "sound.toml")
    for row in (*raw["rna"], *(p for p in raw["parameter"] if p["name"] == "m_h")):
        row |= {key: row[key] / 1000 for key in ("mass_kg", "initial", "std", "lower", "upper") if key in row}
        row |= {"inertia_kgm2": [inertia * x for x in row["inertia_kgm2"]]} if "inertia_kgm2" in row else {}
    (tmp_path / "tonnes.toml").write_text(toml_text.text(raw), encoding="utf-8")
    for name, said in (("sound", False), ("tonnes", True)):
        assert said is any("kg, not t" in note for note in probupdate.modes(tmp_path / f"{name}.toml", count=2).notes)
