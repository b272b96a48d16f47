#!/usr/bin/env bash
# koma-python 1.3.6, koma.modal.mac: no complex conjugate, so the MAC of complex shapes is no MAC.
# Expected: |a^H b|^2 / (a^H a  b^H b), between 0 and 1 and the same for a shape times any phase.
# Seen: shapes (1, 0.9i) and (1, 0.5) give 5.06 where the MAC is 0.53; two shapes a quarter of a period apart in one
#   channel, (1, i) with itself, give NaN where the MAC is 1. Real shapes are right.
# Consequence: SSI gives complex shapes; pairing and stability criteria on this number accept or reject at random where
#   channels are out of phase (closely spaced modes, clock offsets).
# probupdate: conjugates (probupdate.modal.shape_criteria). To check in imported MACs: none above 1.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check koma-python==1.3.6
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from koma.modal import mac


def expected(a, b):
    return abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real)


a, b, quarter = np.array([1, 0.9j]), np.array([1, 0.5 + 0j]), np.array([1, 1j])
with np.errstate(all="ignore"):
    seen, alone = mac(a, b), mac(quarter, quarter)
print(f"mac {seen:.2f}, expected {expected(a, b):.2f}; of (1, i) with itself {alone}, expected 1")
assert seen > 5 and expected(a, b) < 0.54
assert not abs(alone - 1) < 0.01
assert np.isclose(mac(np.array([1.0, 0.9]), b.real), expected(np.array([1.0, 0.9]), b.real))
PYTHON
cd "$work"
venv/bin/python run.py
