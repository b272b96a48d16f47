#!/usr/bin/env bash
# meshio 5.3.5, read of Nastran and Abaqus decks: nodes given in a local coordinate system are put into the global one.
# Expected: GRID 3 at radius 5 m, 90 degrees, height 3 m of a cylindrical system (CORD2C, field CP) is at (0, 5, 3), as
#   pyNastran 1.3.4 has it; the same for Abaqus's *NODE, SYSTEM=C.
# Seen: (5, 90, 3) from both, and (1, 2, 3) for a node whose system begins at x = 10; the cards are skipped without a word.
# Consequence: tripods, tower shells and transition pieces that were modelled in cylinder coordinates come out with metres
#   and degrees mixed: distances to sensors, mode shapes on a mesh and lengths of members are wrong.
# probupdate: takes coordinates of nodes from the user's table, not from a deck. To check: CP fields and *SYSTEM in the deck.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check meshio==5.3.5 pyNastran==1.3.4 numpy==1.26.4
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/tower.bdf" <<'DECK'
CEND
BEGIN BULK
CORD2R,1,,10.,0.,0.,10.,0.,1.
,11.,0.,0.
CORD2C,2,,0.,0.,0.,0.,0.,1.
,1.,0.,0.
GRID,1,,0.,0.,0.
GRID,2,1,1.,2.,3.
GRID,3,2,5.,90.,3.
CBAR,1,1,1,2,0.,0.,1.
CBAR,2,1,2,3,0.,0.,1.
PBAR,1,1,0.1,0.05,0.05,0.1
MAT1,1,2.1+11,,0.3,7850.
ENDDATA
DECK
cat > "$work/tower.inp" <<'DECK'
*NODE, SYSTEM=C
1,0.,0.,0.
2,1.,0.,3.
3,5.,90.,3.
*ELEMENT, TYPE=B31, ELSET=tower
1,1,2
2,2,3
DECK
cat > "$work/run.py" <<'PYTHON'
import meshio
import numpy as np
from pyNastran.bdf.bdf import read_bdf

nastran = meshio.read("tower.bdf").points
reference = read_bdf("tower.bdf", debug=False, xref=True, validate=False, punch=False)
right = np.array([reference.nodes[k].get_position() for k in (1, 2, 3)])
abaqus = meshio.read("tower.inp").points
print("meshio", nastran[1:].tolist(), "pyNastran", right[1:].round(9).tolist(), "Abaqus deck by meshio", abaqus[2].tolist())
assert np.allclose(right[1:], [[11, 2, 3], [0, 5, 3]])
assert np.allclose(nastran[1:], [[1, 2, 3], [5, 90, 3]]) and np.allclose(abaqus[2], [5, 90, 3])
PYTHON
cd "$work"
venv/bin/python run.py
