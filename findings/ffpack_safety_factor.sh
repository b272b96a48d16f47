#!/usr/bin/env bash
# ffpack 0.3.3, lcc.goodmanCorrection / soderbergCorrection / gerberCorrection: the safety factor n does nothing or harm.
# Expected (Goodman): S_a / S_e + S_m / S_u = 1 / n, so for 20 to 180 MPa and S_u = 500 MPa the equivalent amplitude grows
#   from 100 MPa (n = 1) to 171, 267 and 600 MPa (n = 1.5, 2, 3).
# Seen: Goodman and Soderberg return 100 MPa for every n (the stresses are multiplied by n and the sum divided by it).
#   Gerber applies n twice: 83, 226, 889 and then -321 MPa for n = 1, 1.5, 2, 3 (expected 83, 132, 190 and 375 MPa).
#   numpy has to be installed beside it, although it imports numpy.
# Consequence: a fatigue check with n = 1.5 is one with n = 1.
# probupdate: has no safety factor in its cycles. To check: recompute an imported equivalent amplitude by hand once.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check ffpack==0.3.3 numpy==2.3.5 scipy==1.17.1
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from ffpack.lcc import gerberCorrection, goodmanCorrection, soderbergCorrection

LOWEST, HIGHEST, STRENGTH = 20.0, 180.0, 500.0
AMPLITUDE, MEAN = 80.0, 100.0
FACTORS = (1.0, 1.5, 2.0, 3.0)
seen = {f.__name__: np.array([f([LOWEST, HIGHEST], STRENGTH, n=n) for n in FACTORS])
        for f in (goodmanCorrection, soderbergCorrection, gerberCorrection)}
n = np.array(FACTORS)
linear = AMPLITUDE / (1 / n - MEAN / STRENGTH)
parabola = n * AMPLITUDE / (1 - (n * MEAN / STRENGTH) ** 2)
for name, value in seen.items():
    print(name, np.round(value, 1), "expected", np.round(parabola if "gerber" in name else linear, 1))
for name in ("goodmanCorrection", "soderbergCorrection"):
    assert np.allclose(seen[name], 100.0) and linear[-1] > 500
assert np.isclose(seen["gerberCorrection"][0], parabola[0])
assert seen["gerberCorrection"][2] > 4 * parabola[2] and seen["gerberCorrection"][3] < 0 < parabola[3]
PYTHON
cd "$work"
venv/bin/python run.py
