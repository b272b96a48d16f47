"""What a turbine may stand on: a monopile with its transition piece, land, jackets of other legs and bays."""

import copy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import opensees_builder
import pytest
from scipy import linalg, optimize

import probupdate
from probupdate.effects.tolerances import TurbineUncertainty, turbine_rows
from probupdate.effects.turbine import turbine_effects
from probupdate.errors import InputError
from probupdate.structure.assembly import assemble
from probupdate.structure.description_file import parse_description
from probupdate.structure.extend import extended_model
from probupdate.structure.frame import Body
from probupdate.structure.load import load_model, turbine_model
from probupdate.structure.mode_labels import mode_labels
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.places import place_of
from probupdate.structure.reduced import reduce_basis
from probupdate.structure.turbine_frame import build_frame

TEMPLATES = Path(probupdate.__file__).parent / "templates"


@cache
def packaged(kind):
    return read_toml(TEMPLATES / f"{kind}.toml")


def raw(kind):
    return copy.deepcopy(packaged(kind))


def grouted():
    made = raw("monopile")
    piece = made["transition_piece"]
    del piece["flange"]
    piece |= {"connection": "grouted", "bottom_m": 2.0, "tube": {"diameter_m": 9.92, "thickness_m": 0.06},
              "grout": {"thickness_m": 0.1, "youngs_modulus_pa": 5e10, "poisson_ratio": 0.19, "density_kgpm3": 2400.0}}
    return made


def without_piece():
    made = raw("monopile")
    del made["transition_piece"]
    made["monopile"]["station"][-1]["z_m"] = 15.0
    made["parameter"] = [p for p in made["parameter"] if p["name"] not in ("k_TP", "k_c")]
    for sensor in made["sensor"]:
        sensor["part"] = "monopile" if sensor["level"] == "TP" else "tower"
    return made


def clamped():
    made = raw("tower")
    made["foundation"] = {"support": "clamped"}
    made["parameter"] = [p for p in made["parameter"] if p["name"] != "k_f"]
    return made


def jacket(legs, bays):
    made = raw("jacket")
    made["jacket"]["leg_names"] = list("ABCDEF"[:legs])
    edges = np.linspace(-34.0, 10.0, bays + 1)
    brace = made["jacket"]["bay"][0]["brace"]
    made["jacket"]["bay"] = [{"bottom_m": float(a), "top_m": float(b), "brace": brace}
                             for a, b in zip(edges[:-1], edges[1:], strict=True)]
    made["sensor"] = [s for s in made["sensor"] if s["part"] == "tower"]
    return made


OTHERS = {"bolted": lambda: raw("monopile"), "grouted": grouted, "without piece": without_piece,
          "on springs": lambda: raw("tower"), "clamped": clamped, "three legs, one bay": lambda: jacket(3, 1),
          "three legs, six bays": lambda: jacket(3, 6), "four legs, two bays": lambda: jacket(4, 2)}


def described(name):
    return parse_description(OTHERS[name](), name)


def modelled(name):
    return turbine_model(described(name), where=name)


@pytest.mark.parametrize("name", OTHERS)
def test_each_has_its_modes_and_every_parameter_acts(name):
    model = modelled(name)
    found = model.solve(model.parameters.initial, 8, derivatives=True)
    labels = mode_labels(model, found)
    assert {"FA1", "SS1", "T1", "FA2", "SS2"} <= set(labels)
    change = np.abs(found.frequency_derivative * model.parameters.std / found.frequency_hz[:, None]).max(axis=0)
    assert np.all(change > 1e-7), dict(zip(model.parameters.names, change, strict=True))


@pytest.mark.parametrize("name", OTHERS)
def test_derivatives_of_every_parameter_are_those_of_differences(name):
    made = OTHERS[name]()
    for entry in made["parameter"]:
        entry["update"] = True
        if entry["initial"] == entry["lower"]:
            entry["initial"] += 0.1 * entry["std"]
    model = turbine_model(parse_description(made, name), where=name)
    theta = model.parameters.initial
    exact = model.solve(theta, 4, derivatives=True).frequency_derivative
    for k, step in enumerate(1e-4 * model.parameters.std):
        moved = theta + step * np.eye(len(theta))[k], theta - step * np.eye(len(theta))[k]
        up, down = (model.solve(one, 4).frequency_hz for one in moved)
        scale = np.abs(exact[:, k]).max() + 1e-9
        assert (up - down) / (2 * step) == pytest.approx(exact[:, k], abs=2e-3 * scale), model.parameters.names[k]


@pytest.mark.parametrize("name", ["bolted", "grouted", "without piece", "on springs"])
def test_frequencies_are_those_of_opensees(ops, name, validation):
    """Element for element, with the same nodes: the connection, the soil at the nodes and the foundation's springs."""
    row = validation(what="monopiles and a tower on land: frequencies of the first two pairs and of torsion",
                     reference="OpenSees", why="soil lumped at the nodes; no rotary inertia in OpenSees")
    made = OTHERS[name]()
    made["mesh"] |= {"theory": "bernoulli-euler", "geometric_stiffness": False}
    made["mesh"]["elements_per_member"] = {"pile": 20, "column": 4, "tower": 8}
    d = parse_description(made, name)
    frame = build_frame(d)
    # dry: OpenSees would let water turn about the members' axes
    frame = replace(frame, beams=tuple(replace(b, carried=()) for b in frame.beams))
    built = assemble(frame, updated=(), values=d.values)
    value = linalg.eigh(built.stiffness[0].toarray(), built.mass[0].toarray(), subset_by_index=[0, 4],
                        eigvals_only=True)
    opensees_builder.build(ops, frame, d.values)
    row.error(opensees_builder.frequencies(ops, 5) * 2 * np.pi / np.sqrt(value) - 1, below=3e-3)


def rocking_beam(stiffness_ei, mass_per_m, length, top_mass, k_h, k_r):
    """First frequency in Hz of a uniform beam on a horizontal and a rocking spring with a mass on top: the zero of the
    characteristic determinant."""

    def determinant(omega):
        b = (mass_per_m * omega**2 / stiffness_ei) ** 0.25
        ends = []
        for x, across, turning in ((0.0, k_h, k_r), (length, -top_mass * omega**2, 0.0)):
            c, s, ch, sh = np.cos(b * x), np.sin(b * x), np.cosh(b * x), np.sinh(b * x)
            w, w1 = np.array([c, s, ch, sh]), b * np.array([-s, c, sh, ch])
            w2, w3 = b**2 * np.array([-c, -s, ch, sh]), b**3 * np.array([s, -c, sh, ch])
            # at the foot the springs hold what the beam's end exerts, at the top the mass does
            side = 1.0 if x == 0.0 else -1.0
            ends += [stiffness_ei * w3 + side * across * w, stiffness_ei * w2 - side * turning * w1]
        rows = np.array(ends)
        return linalg.det(rows / np.abs(rows).max(axis=1)[:, None])

    guesses = np.linspace(0.01, 3.0, 400) * 2 * np.pi
    values = [determinant(w) for w in guesses]
    k = next(k for k in range(len(values) - 1) if values[k] * values[k + 1] < 0)
    return optimize.brentq(determinant, guesses[k], guesses[k + 1]) / (2 * np.pi)


def test_a_uniform_tower_on_springs_has_the_frequency_of_its_closed_form(validation):
    row = validation(what="uniform tower on springs with a mass on top: first frequency",
                     reference="determinant of the Bernoulli-Euler beam", why="cubic elements")
    made = raw("tower")
    made["mesh"] |= {"theory": "bernoulli-euler", "geometric_stiffness": False}
    for station in made["tower"]["station"]:
        station |= {"diameter_m": 4.0, "thickness_m": 0.03, "flange_kg": 0.0}
    made["tower"]["secondary_steel_kgpm"] = 0.0
    made["foundation"] |= {"mass_kg": 0.0, "inertia_kgm2": [0.0, 0.0, 0.0]}
    for body in made["rna"]:
        body |= {"offset_m": [0.0, 0.0, 0.0], "inertia_kgm2": [0.0, 0.0, 0.0]}
    model = turbine_model(parse_description(made, "uniform"), where="uniform")
    second = np.pi / 64 * (4.0**4 - 3.94**4)
    foundation = made["foundation"]
    closed = rocking_beam(2.1e11 * second, 7850 * np.pi / 4 * (4.0**2 - 3.94**2), 90.0, 145000.0,
                          foundation["horizontal_npm"], foundation["rocking_nmprad"])
    # the rotary inertia of the section, which the closed form leaves out, takes some 1e-4
    row.error(model.solve(model.parameters.initial, 2).frequency_hz / closed - 1, below=5e-4)


def test_a_stiff_connection_is_none(validation):
    row = validation(what="bolted connection made stiff: frequencies of one continuous tube",
                     reference="the same tube without a connection", why="what stiffness is left")
    whole = without_piece()
    bolted = raw("monopile")
    piece = bolted["transition_piece"]
    # one wall all the way up, nothing added
    for made in (whole, bolted):
        made["monopile"]["station"][-1] |= {"thickness_m": 0.055}
    whole["monopile"]["station"][-1] |= {"thickness_m": 0.055, "z_m": 10.0}
    whole["monopile"]["station"].append({"z_m": 15.0, "diameter_m": 9.6, "thickness_m": 0.055})
    piece |= {"tube": {"diameter_m": 9.6, "thickness_m": 0.055}, "lumped_mass_kg": 0.0}
    piece["flange"] |= {"bending_stiffness_nmprad": 1e18, "mass_kg": 0.0}
    one, other = (turbine_model(parse_description(made, "m"), where="m", sensors=()) for made in (whole, bolted))
    a, b = (m.solve(m.parameters.initial, 6).frequency_hz for m in (one, other))
    row.error(b / a - 1, below=1e-4)


def test_a_softer_connection_lowers_the_second_bending():
    for name in ("bolted", "grouted"):
        made = OTHERS[name]()
        frequency = []
        for value in (1.0, 0.05):
            next(p for p in made["parameter"] if p["name"] == "k_c")["initial"] = value
            model = turbine_model(parse_description(made, name), where=name)
            frequency.append(model.solve(model.parameters.initial, 5).frequency_hz)
        assert np.all(frequency[1] <= frequency[0] * (1 + 1e-12)) and frequency[1][4] < frequency[0][4] * (1 - 1e-5)


def test_the_monopile_weighs_what_its_sections_do():
    """Steel, water inside and around: the mass that a rigid sideways motion carries."""
    d = described("without piece")
    frame = build_frame(d)
    made = assemble(frame, updated=(), values=d.values)
    M = sum(made.mass[1:], made.mass[0])
    ends = [(s.z_m, s.diameter_m, s.thickness_m) for s in (*d.monopile.station, *d.tower.station[1:])]
    z = np.linspace(-75.0, 144.0, 200001)
    diameter, wall = (np.interp(z, [e[0] for e in ends], [e[k] for e in ends]) for k in (1, 2))
    # the tower begins with a wall of its own
    wall = np.where(z > 15.0, np.interp(z, [s.z_m for s in d.tower.station], [s.thickness_m for s in d.tower.station]),
                    wall)
    steel = np.pi * (diameter - wall) * wall * 7850
    inside = np.where(z < 0.0, np.pi / 4 * (diameter - 2 * wall) ** 2 * 1025, 0.0)
    around = np.where((z < 0.0) & (z > -30.0), np.pi / 4 * diameter**2 * 1025, 0.0)
    expected = np.trapezoid(steel + inside + around, z) + 300.0 * 129.0 + 39000.0 + 1015000.0
    along_x = np.zeros(6 * len(frame.node_m))
    along_x[::6] = 1.0
    q = np.linalg.lstsq(made.transform.toarray(), along_x, rcond=None)[0]
    assert q @ (M @ q) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("name", OTHERS)
def test_each_row_of_the_catalogue_builds_and_shows(name, tmp_path):
    path = write(tmp_path, OTHERS[name]())
    d = parse_description(read_toml(path), str(path))
    rows = [row for row in turbine_effects(d) if row.adds is not None]
    names = [row.adds.name for row in rows]
    places = [(row.cause, row.location) for row in rows]
    assert len(set(names)) == len(names) and len(set(places)) == len(places)
    model = extended_model(path, [row.adds for row in rows])
    found = model.solve(model.parameters.initial, 8, derivatives=True)
    picked = [model.parameters.names.index(n) for n in names]
    scale = model.parameters.std[picked]
    moves = (np.abs(found.frequency_derivative[:, picked] * scale / found.frequency_hz[:, None]).max(axis=0)
             + np.abs(found.shape_derivative[:, :, picked] * scale).max(axis=(0, 1)) / np.abs(found.shape).max())
    assert np.all(moves > 1e-9), [n for n, m in zip(names, moves, strict=True) if m <= 1e-9]


@pytest.mark.parametrize("name", ["bolted", "clamped", "three legs, one bay"])
def test_tolerances_are_those_the_structure_has(name, tmp_path):
    path = write(tmp_path, OTHERS[name]())
    d = parse_description(read_toml(path), str(path))
    model = load_model(path)
    known = TurbineUncertainty.from_description(path, model, None, None)
    assert known.changes(model.parameters.initial, 5, ()).frequency_derivative.shape[1] == len(known.sources)
    words = " ".join(row.source.description for row in turbine_rows(d))
    assert ("leg" in words) == name.startswith("three") and ("soil" in words) == (name != "clamped")


def write(folder, made):
    path = folder / "model.toml"
    path.write_text(toml(made))
    return path


def toml(table):
    """A table as TOML: enough for a model."""

    def value(x):
        if isinstance(x, bool):
            return str(x).lower()
        if isinstance(x, dict):
            return "{ " + ", ".join(f"{k} = {value(v)}" for k, v in x.items()) + " }"
        if isinstance(x, list):
            return "[" + ", ".join(value(v) for v in x) + "]"
        return f'"{x}"' if isinstance(x, str) else repr(x)

    return "\n".join(f"{key} = {value(own)}" for key, own in table.items()) + "\n"


def test_places_are_said_in_the_structures_words():
    d = described("grouted")
    assert place_of(d, np.array([0.0, 0.0, -10.0])) == "monopile, z = -10.0 m"
    assert place_of(d, np.array([4.9, 0.0, 12.0])) == "transition piece, z = 12.0 m"
    assert place_of(d, np.array([0.0, 0.0, 100.0])) == "tower, z = 100.0 m"
    assert place_of(described("clamped"), np.array([0.0, 0.0, 10.0])) == "tower, z = 10.0 m"
    assert place_of(described("three legs, one bay"), np.array([0.0, 0.0, 15.0])).startswith("transition piece")


@pytest.mark.parametrize(("change", "key", "problem"), [
    (lambda m: m["transition_piece"].update(bottom_m=9.0), "transition_piece.bottom_m", "is not the monopile's top"),
    (lambda m: m["transition_piece"].pop("flange"), "transition_piece.flange", "is missing for a bolted connection"),
    (lambda m: m["monopile"]["station"].reverse(), "monopile.station", ""),
    (lambda m: m["parameter"][0].update(name="k_j"), "parameter[1] k_j", "which stands on a monopile"),
    (lambda m: m.update(foundation={"support": "clamped"}), "foundation", "stands beside [monopile]"),
    (lambda m: m.update(monopil=m.pop("monopile")), "monopile", "is missing"),
    (lambda m: m["mesh"]["elements_per_member"].pop("pile"), "mesh.elements_per_member", "pile missing"),
    (lambda m: m["parameter"].append(dict(name="e", kind="scour", unit="m", initial=0.0, std=1.0, lower=0.0, upper=50.0,
                                          on={"leg": "A"})), "parameter[13] e.on.leg", "is not in this structure"),
])
def test_mistakes_in_a_monopile_are_named(change, key, problem):
    made = raw("monopile")
    change(made)
    with pytest.raises(InputError) as found:
        parse_description(made, "m")
    assert found.value.where.startswith(f"m: {key}") and problem in found.value.problem


def test_a_grout_that_does_not_fit_is_refused():
    made = grouted()
    made["transition_piece"]["grout"]["thickness_m"] = 0.3
    with pytest.raises(InputError, match="let tube, grout and pile fit"):
        parse_description(made, "m")


def test_bodies_of_a_tower_on_land_are_its_own():
    frame = build_frame(described("on springs"))
    assert all(isinstance(body, Body) for body in frame.bodies) and frame.pile_head is None


def stepped(rise):
    """The template with a thinner wall from each inner station upwards, over a taper of that rise (m)."""
    made = raw("monopile")
    for table in (made["monopile"], made["tower"]):
        first, *inner, last = table["station"]
        table["station"] = [first]
        for station in inner:
            above = {key: 0.0 for key in station if key == "flange_kg"}
            above |= {"z_m": station["z_m"] + rise, "thickness_m": 0.9 * station["thickness_m"]}
            table["station"] += [station, station | above]
        table["station"].append(last)
    return parse_description(made, "model.toml")


def test_two_stations_at_one_level_are_a_step():
    """The limit of ever shorter tapers: what 10 mm miss is their length over the station's, not more."""
    step, short, long = (turbine_model(stepped(rise), where="model.toml") for rise in (0.0, 0.01, 1.0))
    found, near = (m.solve(m.parameters.initial, 6).frequency_hz for m in (step, short))
    assert step.n_dof < short.n_dof
    assert found == pytest.approx(near, rel=0.01 / 20)
    assert np.all(np.abs(found / long.solve(step.parameters.initial, 6).frequency_hz - 1)[:2] > 1e-5)
    names = [row.name for row in turbine_effects(stepped(0.0))]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("rise", [0.02, 0.001])
def test_millimetres_between_stations_leave_a_basis(rise):
    """Rounding in elements so stiff hid the energy of small vectors, and no basis was built."""
    model = turbine_model(stepped(rise), where="model.toml")
    own = model.parameters
    box = (np.maximum(own.lower, own.initial - 2 * own.std), np.minimum(own.upper, own.initial + 2 * own.std))
    reduced = reduce_basis(model, n_mode=5, box=box, frequency_tolerance=2e-6, n_snapshot=48, n_verify=24)
    theta = np.random.default_rng(77).uniform(*box, (5, len(own)))
    exact = [model.solve(row, 5).frequency_hz for row in theta]
    assert reduced.solve_many(theta, 5).frequency_hz == pytest.approx(np.array(exact), rel=2e-6)
