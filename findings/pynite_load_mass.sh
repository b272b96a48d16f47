#!/usr/bin/env bash
# PyNiteFEA 3.2.0, analyze_modal: the mass of distributed loads changes with the length of members, and a factor of the
#   self-weight counts for statics only.
# Expected: a cantilever of 50 m whose weight is a line load in the mass combination has its closed form, 0.819 Hz, with
#   10, 25 or 50 members; a tenth more self-weight lowers it by 4.7 %.
# Seen: 1.351, 1.112 and 0.818 Hz: the mass comes out divided by the members' length, so that only members of length one
#   are right. With a self-weight of 1.1 it stays 0.819 Hz.
# Consequence: frequencies of a model with equipment or growth as line loads are as wrong as its mesh is coarse, in units
#   in which members are not one long.
# probupdate: takes matrices. To check: total mass from M, or the same model with half the members' length.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check PyNiteFEA==3.2.0 numpy==2.4.6 scipy==1.17.1
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from Pynite import FEModel3D

E, G, AREA, SECOND, TORSION, LENGTH = 210e9, 81e9, 0.1, 0.05, 0.1, 50.0
GRAVITY, DENSITY = 9.81, 7850.0
WEIGHT = DENSITY * GRAVITY


def lowest(members, self_weight=None, line=None):
    """First bending frequency (Hz) of a cantilever."""
    model = FEModel3D()
    model.add_material("steel", E, G, 0.3, WEIGHT)
    model.add_section("tube", AREA, SECOND, SECOND, TORSION)
    for k in range(members + 1):
        model.add_node(f"N{k}", LENGTH * k / members, 0, 0)
    model.def_support("N0", *[True] * 6)
    for k in range(members):
        model.add_member(f"M{k}", f"N{k}", f"N{k + 1}", "steel", "tube")
        if line:
            model.add_member_dist_load(f"M{k}", "FY", -line, -line, case="mass")
    if self_weight:
        model.add_member_self_weight("FY", -self_weight, "mass")
    model.add_load_combo("combination", {"mass": 1.0})
    model.analyze_modal(2, "combination", "Y", GRAVITY)
    return float(model.frequencies[0])


exact = 1.8751041**2 / (2 * np.pi * LENGTH**2) * np.sqrt(E * SECOND / (DENSITY * AREA))
by_mesh = [lowest(members, line=WEIGHT * AREA) for members in (10, 25, 50)]
heavier = lowest(10, self_weight=1.1)
print(f"closed form {exact:.4f} Hz; own weight {lowest(10, self_weight=1.0):.4f} Hz")
print("the same weight as a line load, members of 5, 2 and 1 m:", np.round(by_mesh, 3), "Hz")
print(f"self-weight times 1.1: {heavier:.4f} Hz, expected {exact / np.sqrt(1.1):.4f} Hz")
assert abs(lowest(10, self_weight=1.0) / exact - 1) < 1e-3
assert by_mesh[0] > 1.6 * exact and by_mesh[1] > 1.3 * exact and abs(by_mesh[2] / exact - 1) < 1e-2
assert abs(heavier / exact - 1) < 1e-3
PYTHON
cd "$work"
venv/bin/python run.py
