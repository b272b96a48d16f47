"""Numbers of a model.toml that digits or units miswrite are refused or said with their key; drawn turbines are not."""

import copy

import numpy as np
import pytest
from drawn import jackets, monopiles, toml_text

from probupdate.errors import InputError
from probupdate.structure.description_file import parse_description
from probupdate.structure.own_modes import modes_of_model
from probupdate.structure.plausible_turbine import odd_sizes
from tests.structure.test_fe_description import put

# key, the factors that a slip of units or of a digit puts on it
JACKET = [
    ("jacket.leg.diameter_m", (1e-3, 0.1, 10, 1e3)), ("jacket.leg.thickness_m", (1e-3, 0.1, 10, 1e3)),
    ("jacket.bay[1].brace.diameter_m", (1e-3, 0.1, 10, 1e3)), ("jacket.bay[1].brace.thickness_m", (1e-3, 10, 1e3)),
    ("pile.diameter_m", (1e-3, 0.1, 10, 1e3)), ("pile.tip_m", (10, 1e3)),
    ("jacket.top.leg_spacing_m", (1e-3, 10, 1e3)), ("jacket.bottom.leg_spacing_m", (1e-3, 0.1, 1e3)),
    ("transition_piece.strut.diameter_m", (1e-3, 0.1, 10, 1e3)), ("transition_piece.lumped_mass_kg", (1e-3, 100, 1e3)),
    ("transition_piece.column.thickness_m", (1e-3, 10, 1e3)), ("tower.station[2].diameter_m", (1e-3, 0.1, 10, 1e3)),
    ("tower.station[1].thickness_m", (1e-3, 0.1, 10, 1e3)), ("tower.station[2].flange_kg", (1e-3, 100, 1e3)),
    ("tower.secondary_steel_kgpm", (1e-3, 100, 1e3)), ("soil.strain_50", (1e-3, 0.1, 10, 100)),
    ("soil.submerged_unit_weight_npm3", (1e-3, 0.1, 10, 1e3)), ("soil.matlock_j", (1e-3, 0.1, 10)),
    ("soil.undrained_shear_strength_pa.at_mudline", (1e-3, 100)), ("steel.youngs_modulus_pa", (1e-3, 0.1, 10)),
    ("steel.density_kgpm3", (1e-3, 0.1, 10)), ("steel.poisson_ratio", (1e-3, 0.1, 10)),
    ("hydrodynamics.growth_density_kgpm3", (1e-3, 0.1, 10)), ("hydrodynamics.added_mass_coefficient", (1e-2, 10)),
    ("rna[1].inertia_kgm2[3]", (0.01, 0.1, 10, 1e3)), ("rna[2].mass_kg", (1e-3, 0.1, 10)), ("rna[1].mass_kg", (10,)),
    ("rna[2].offset_m[1]", (10, 1e3)), ("corrosion.bottom_m", (1e3,)), ("hydrodynamics.growth_top_m", (1e3,)),
]
MONOPILE = [
    ("monopile.station[2].diameter_m", (1e-3, 0.1, 10, 1e3)), ("monopile.station[2].thickness_m", (1e-3, 0.1, 10)),
    ("monopile.station[1].z_m", (10, 1e3)), ("site.mudline_m", (1e3,)), ("tower.station[-1].z_m", (10, 1e3)),
]


def number(raw, path):
    found = copy.deepcopy(raw)
    put(found, path, None)
    steps = [step.rstrip("]") for part in path.split(".") for step in part.split("[")]
    for step in steps:
        raw = raw[int(step) - (int(step) > 0)] if isinstance(raw, list) else raw[step]
    return raw


@pytest.mark.parametrize(("on", "path", "factor"), [
    (on, path, f) for on, rows in ((jackets, JACKET), (monopiles, MONOPILE)) for path, factors in rows for f in
      factors])
def test_a_slip_is_refused_or_said_with_its_key(on, path, factor):
    raw = next(raw for seed in range(50) for raw in [on.draw(np.random.default_rng(seed), small=True)]
               if "monopile" not in raw or len(raw["tower"]["station"]) > 2)
    path = path.replace("[-1]", f"[{len(raw['tower']['station'])}]")
    put(raw, path, number(raw, path) * factor)
    # what a key is beside may be the one that is wrong: of two stations' walls either is named
    table = path.split(".")[0].split("[")[0]
    try:
        said = odd_sizes(parse_description(raw, "model.toml"))
    except InputError as error:
        said = (str(error).removeprefix("model.toml: "),)
    assert any(table in words and "\n" not in words for words in said), said


@pytest.mark.parametrize("on", [jackets, monopiles])
def test_nothing_is_said_of_drawn_turbines(on):
    for seed in range(150):
        raw = on.draw(np.random.default_rng([seed, 3]), small=seed % 2 == 0)
        assert odd_sizes(parse_description(raw, "drawn")) == ()


def test_the_modes_of_a_turbine_out_of_proportion_say_so(tmp_path):
    raw = jackets.draw(np.random.default_rng(4), small=True)
    raw["jacket"]["bay"][0]["brace"]["diameter_m"] *= 10
    raw["jacket"]["bay"][0]["brace"]["thickness_m"] *= 10
    (tmp_path / "model.toml").write_text(toml_text.text(raw))
    notes = modes_of_model(tmp_path / "model.toml", 3).notes
    assert any("jacket.bay[1].brace.diameter_m" in n and "implausible" in n and "check its digits" in n for n in notes)
