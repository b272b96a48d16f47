#!/usr/bin/env bash
# openseespy 3.7.1.2, elasticBeamColumn with -cMass in three dimensions: the rotary inertia about the beam's own axis is
# the density times the torsion constant J, where the polar second moment Iy + Iz is meant.
# Expected: a clamped bar in torsion, first frequency sqrt(G J / (rho (Iy + Iz))) / 4 L.
# Seen: sqrt(G / rho) / 4 L for any section: right for tubes, 4.2 times too high for a plate of 400 x 50 mm.
# Consequence: torsion of open and flat sections (plate and I girders, ice cones, bridge decks) comes out too stiff by
#   sqrt((Iy + Iz) / J); K and M exported from such a model carry it into every update.
# probupdate: takes M as it is, since element data are not in it. Without -cMass, give the nodes' rotary inertia yourself.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check openseespy==3.7.1.2 numpy==2.4.6
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
import openseespy.opensees as ops

E, G, RHO, LENGTH, N = 2.1e11, 8.1e10, 7850.0, 4.0, 20


def first_torsion(area, iy, iz, torsion):
    """Hz of a bar clamped at one end that can only turn about its axis."""
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    ops.geomTransf("Linear", 1, 0, 0, 1)
    for k in range(N + 1):
        ops.node(k + 1, LENGTH * k / N, 0.0, 0.0)
        ops.fix(k + 1, 1, 1, 1, int(k == 0), 1, 1)
    for k in range(N):
        ops.element("elasticBeamColumn", k + 1, k + 1, k + 2, area, E, G, torsion, iy, iz, 1,
                    "-mass", RHO * area, "-cMass")
    return np.sqrt(ops.eigen("-fullGenLapack", 1)[0]) / (2 * np.pi)


wide, thick = 0.4, 0.05
plate = (wide * thick, thick * wide**3 / 12, wide * thick**3 / 12,
         wide * thick**3 * (1 / 3 - 0.21 * thick / wide * (1 - (thick / wide) ** 4 / 12)))
outer, inner = 0.25, 0.22
bend = np.pi / 4 * (outer**4 - inner**4)
tube = (np.pi * (outer**2 - inner**2), bend, bend, 2 * bend)
for name, section, ratio in (("plate", plate, 4.2), ("tube", tube, 1.0)):
    area, iy, iz, torsion = section
    right = np.sqrt(G * torsion / (RHO * (iy + iz))) / (4 * LENGTH)
    seen = first_torsion(*section)
    print(f"{name}: {seen:.1f} Hz, expected {right:.1f} Hz")
    assert abs(seen / right - ratio) < 0.01 * ratio
PYTHON
cd "$work"
venv/bin/python run.py
