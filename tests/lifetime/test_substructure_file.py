"""SubDyn files of turbines described by model.toml: read back below their towers they are the turbines."""

import copy

import numpy as np
import pytest
from drawn import jackets

from probupdate.errors import InputError
from probupdate.lifetime.substructure_file import differences, write_substructure
from probupdate.structure.description_file import parse_description
from probupdate.structure.load import reference_model
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.subdyn_writing import NoSubDynKeyword
from probupdate.structure.substructure import NoSubstructure
from probupdate.verbs.templates import template

GROUT = {"thickness_m": 0.1, "youngs_modulus_pa": 5e10, "poisson_ratio": 0.19, "density_kgpm3": 2400.0}


def templated(kind, folder):
    template(kind, folder)
    return read_toml(folder / "model.toml")


def grouted(folder):
    raw = templated("monopile", folder)
    piece = raw["transition_piece"]
    del piece["flange"]
    piece |= {"connection": "grouted", "bottom_m": 2.0, "grout": GROUT}
    piece["tube"]["diameter_m"] = raw["monopile"]["station"][-1]["diameter_m"] + 2 * (
        GROUT["thickness_m"] + piece["tube"]["thickness_m"])
    return raw


TURBINES = {
    "reference": lambda folder: read_toml(reference_model("as_built")),
    "bolted monopile": lambda folder: templated("monopile", folder),
    "grouted monopile": grouted,
    # three legs with flexible joints, four with rigid ones
    **{f"drawn jacket {seed}": lambda folder, seed=seed: jackets.draw(np.random.default_rng(seed), small=True)
       for seed in (1, 4)},
}
# away from where they change nothing
MOVED = {"k_j": 0.8, "k_TP": 1.2, "k_p": 0.9, "k_c": 0.5, "py": 2.0, "tz": 0.6, "LJF": 0.5, "sc": 1.5, "corr": 0.004}


def moved(raw):
    raw = copy.deepcopy(raw)
    for p in raw["parameter"]:
        p["initial"] = MOVED.get(p["name"], p["initial"])
    return raw


@pytest.mark.parametrize("name", TURBINES)
def test_a_turbine_on_its_subdyn_file_is_the_turbine(name, tmp_path, validation):
    row = validation(what="jackets and monopiles of model.toml written as SubDyn files, read back, below their towers: "
                          "six frequencies, also at parameters far from the initial ones",
                     reference="the turbine's own frame without water and prestress",
                     why="piles condensed at their heads, carried masses lumped, SubDyn's own mass matrices")
    raw = TURBINES[name](tmp_path)
    for one in (raw, moved(raw)):
        d = parse_description(one, "model.toml")
        path, *soil = write_substructure(d, tmp_path, "a remark")
        assert len(soil) == len(raw["jacket"]["leg_names"] if "jacket" in raw else [1])
        row.error(differences(d, path), 2e-3, case=name)
    # a file of other parameters is another structure
    with pytest.raises(InputError, match="differ by"):
        differences(parse_description(raw, "model.toml"), path)


def test_what_subdyn_has_no_word_for_is_named(tmp_path):
    raw = templated("monopile", tmp_path)
    raw["parameter"].append({"name": "soft", "kind": "hinge", "on": {"group": "pile"}, "at_m": -10.0, "initial": 1e-3,
                             "unit": "rad/(GN m)", "std": 1e-3, "lower": 0.0, "upper": 0.1})
    with pytest.raises(NoSubDynKeyword, match="soft"):
        write_substructure(parse_description(raw, "model.toml"), tmp_path, "")
    with pytest.raises(NoSubstructure):
        write_substructure(parse_description(templated("tower", tmp_path / "tower"), "model.toml"), tmp_path, "")
