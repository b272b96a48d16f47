"""Structures that nobody drew by hand, from their files to a verdict: exit codes, silence, and what is named."""

import numpy as np
import pytest
from drawn import commands, structures
from drawn.cases import Case

from probupdate import modes

# kind, what is hidden, seed: small ones of every form; the others in studies/drawn
QUICK = [("matrices truss", "null", 0), ("matrices truss", "structural", 0), ("matrices bridge", "null", 0),
         ("matrices bridge", "measurement", 1), ("matrices building", "null", 0), ("matrices monopile", "null", 1),
         ("matrices monopile", "structural", 1), ("subdyn monopile", "null", 0)]


@pytest.mark.parametrize("kind", structures.KINDS)
def test_two_programs_agree_on_a_drawn_structure(kind: str, tmp_path, validation):
    """OpenSees or scipy, of a finer mesh, at the parameters as designed; both with shear where members are stout."""
    row = validation(what="first modes of structures drawn at random (jackets as model.toml, SubDyn files, matrices): "
                          "frequencies", reference="OpenSees, lumped mass, or scipy, both of a finer mesh",
                     why="mesh and element theory")
    drawn = structures.draw(kind, 4 if kind == "turbine" else 3, small=True, designed=True)
    args = drawn.write(tmp_path)
    theirs = drawn.solve(count=3).frequency_hz
    row.error(np.asarray(modes(args[1], count=3).frequency_hz) / theirs - 1, 5e-3)


@pytest.mark.parametrize(("kind", "hidden", "seed"), QUICK)
def test_a_drawn_structure_comes_to_a_verdict(kind: str, hidden: str, seed: int, tmp_path, validation):
    row = validation(what="structures drawn at random, by `modes`, `update` and `diagnose`: exit codes, verdict",
                     reference="what is hidden (rates in `studies/drawn`)")
    line = commands.run_case(Case(kind, hidden, seed, small=True), tmp_path / "run", extend=False,
                             only=("modes", "update", "diagnose"))
    row.equal([(c["command"], c["last"]) for c in line["commands"] if c["code"]], [], "exits", case=line["title"])
    row.equal(line["judged"] in (("silent",) if hidden == "null" else ("right", "in the set", "silent")), True,
              "verdict", case=line)
