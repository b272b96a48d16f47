#!/usr/bin/env bash
# pyNastran 1.3.4, OP4: form 6 ("symmetric") does not mirror, and names in ASCII files end after eight letters.
# Expected: a matrix marked symmetric and stored as one triangle comes back whole; two matrices with names of their own
#   come back as two.
# Seen: the upper triangle of a stiffness matrix comes back as the upper triangle; STIFFNESS_TOWER and STIFFNESS_SOIL
#   come back under the one key STIFFNES, which holds a list of two matrices. No warning in either case.
# Consequence: the triangle read as a full matrix has wrong eigenvalues without an error where a solver reads the other
#   one; the two stiffnesses cannot be distinguished by name.
# probupdate: refuses a matrix that is not symmetric and says so. To check: mirror a triangle, keep names to eight letters.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check pyNastran==1.3.4 numpy==2.3.5
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from pyNastran.op4.op4 import OP4, read_op4

tower = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
OP4().write_op4("one.op4", {"KGG": (6, np.triu(tower))}, is_binary=False)
form, back = read_op4("one.op4", debug=False)["KGG"]
print(f"form {form}, lower triangle {back[1, 0]}, {back[2, 1]}")
assert form == 6
assert np.array_equal(back, np.triu(tower))

OP4().write_op4("two.op4", {"STIFFNESS_TOWER": (6, tower), "STIFFNESS_SOIL": (6, 3 * tower)}, is_binary=False)
both = read_op4("two.op4", debug=False)
print("names", list(both), "matrices", len(both["STIFFNES"][1]))
assert list(both) == ["STIFFNES"] and len(both["STIFFNES"][1]) == 2
PYTHON
cd "$work"
venv/bin/python run.py
