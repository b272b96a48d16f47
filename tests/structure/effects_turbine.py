"""The small turbine with effects as its only updated parameters, for the tests of effects."""

from small_turbine import small_turbine

from probupdate.structure.description_file import parse_description
from probupdate.structure.effect_kinds import KINDS
from probupdate.structure.load import turbine_model

# one of every kind, in several places: kind, on, settings, value off neutral, bounds
SAMPLES = {
    "brace": ("stiffness", {"group": "brace", "face": "CB", "bay": 1}, {}, 0.6, (0.1, 2.0)),
    "brace_axial": ("stiffness", {"part": "brace AB-1"}, {"motion": "axial"}, 0.4, (0.0, 2.0)),
    "leg_bending": ("stiffness", {"group": "leg", "leg": "C", "level_m": [-10.0, 2.0]}, {"motion": "bending"}, 0.5,
                    (0.1, 2.0)),
    "shear": ("shear", {}, {}, 0.7, (0.0, 3.0)),
    "shear_tower": ("shear", {"group": "tower", "level_m": [12.0, 30.0]}, {}, 1.4, (0.0, 3.0)),
    "joint": ("joint", {"leg": "A", "face": "DA"}, {}, 0.05, (0.0, 3.0)),
    "joint_in_plane": ("joint", {"bay": 1}, {"motion": "in plane"}, 0.3, (0.0, 3.0)),
    "flange": ("hinge", {"group": "tower"}, {"at_m": 12.0}, 0.3, (0.0, 9.0)),
    "bearing": ("hinge", {"part": "tower"}, {"at_m": 50.0}, 0.5, (0.0, 9.0)),
    "grout": ("hinge", {"group": "pile", "leg": "D"}, {"at_m": -19.0}, 2.0, (0.0, 99.0)),
    "slip": ("slip", {"group": "pile", "leg": "B"}, {"at_m": -19.0}, 5.0, (0.0, 99.0)),
    "soil_py": ("soil", {"leg": "A"}, {"curve": "py"}, 3.0, (0.1, 9.0)),
    "soil_tz": ("soil", {"level_m": [-30.0, -20.0]}, {"curve": "tz"}, 0.3, (0.1, 9.0)),
    "soil": ("soil", {"leg": "B"}, {"curve": "all"}, 0.4, (0.1, 9.0)),
    "soil_qw": ("soil", {"leg": "C"}, {"curve": "qw"}, 4.0, (0.1, 9.0)),
    "scour": ("scour", {}, {}, 0.9, (0.0, 4.0)),
    "scour_B": ("scour", {"leg": "B"}, {}, 1.3, (-0.7, 4.0)),
    "growth": ("growth", {"level_m": [-12.5, -3.0]}, {}, 0.08, (-0.06, 0.3)),
    "corrosion": ("corrosion", {"group": "leg", "leg": "B"}, {}, 0.004, (0.0, 0.008)),
    "corrosion_tower": ("corrosion", {"group": "tower", "level_m": [30.0, 45.0]}, {}, 0.002, (0.0, 0.004)),
    "added_mass": ("added_mass", {"group": "leg"}, {}, 1.6, (0.0, 3.0)),
    "flooding": ("flooding", {"group": "brace", "face": "AB"}, {}, 0.5, (0.0, 1.0)),
    "dry_leg": ("flooding", {"group": "leg", "leg": "C"}, {}, -0.4, (-1.0, 0.0)),
    "ice": ("mass", {"body": "hub"}, {"inertia_per_kg_m2": [0.0, 80.0, 80.0]}, 4e3, (0.0, 1e4)),
    "ice_tower": ("mass", {"group": "tower", "level_m": [20.0, 44.0]}, {}, 9e3, (0.0, 2e4)),
    "warmth": ("temperature", {"group": "leg"}, {"relative_per_degc": -3e-4}, 25.0, (-40.0, 40.0)),
    "com_x": ("centre_of_mass", {}, {"axis": "x"}, 0.7, (-2.0, 2.0)),
    "com_y": ("centre_of_mass", {"body": "hub"}, {"axis": "y"}, -0.6, (-2.0, 2.0)),
    "com_z": ("centre_of_mass", {"body": "nacelle"}, {"axis": "z"}, 0.5, (-2.0, 2.0)),
    "yaw_inertia": ("inertia", {"body": "hub"}, {"axis": "z"}, 2e6, (-3e6, 9e6)),
    "blades": ("oscillator", {"body": "hub"}, {"axis": "x", "frequency_hz": 0.9}, 0.15, (1e-5, 0.5)),
    "water": ("water_level", {}, {}, -1.3, (-3.0, 3.0)),
    "weight": ("weight", {}, {}, 0.8, (-1.0, 2.0)),
    "thrust": ("thrust", {}, {}, 4e5, (-1e6, 1e6)),
    "height": ("sensor_height", {}, {"channels": ["T30-x", "T30-y"]}, 2.7, (-6.0, 6.0)),
    "gravity": ("sensor_gravity", {}, {"channels": ["T50-x", "TP-A-y"]}, 0.6, (0.0, 1.5)),
}


def entry(name, kind, on=None, settings=None, bounds=(-1.0, 1.0), std=0.1):
    """A [[parameter]] as read, neutral."""
    table = {"name": name, "unit": KINDS[kind].unit, "kind": kind, "initial": KINDS[kind].neutral, "std": std,
             "lower": bounds[0], "upper": bounds[1]}
    return table | ({"on": on} if on else {}) | (settings or {})


def sample(name):
    kind, on, settings, _, bounds = SAMPLES[name]
    return entry(name, kind, on, settings, bounds)


def with_effects(entries, **values):
    """The turbine as read, with effects alone updated; values: of rows of Table 2."""
    raw = small_turbine()
    for row in raw["parameter"]:
        row["update"] = False
        row["initial"] = values.get(row["name"], row["initial"])
    raw["parameter"] += entries
    return raw


def model(raw, **kwargs):
    return turbine_model(parse_description(raw, "model.toml"), where="model.toml", **kwargs)


def plain(raw=None, **values):
    """The same without effects; k_t is updated as one parameter at least must be."""
    raw = with_effects([], **values) if raw is None else raw
    next(row for row in raw["parameter"] if row["name"] == "k_t")["update"] = True
    return model(raw)
