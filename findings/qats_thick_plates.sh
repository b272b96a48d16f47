#!/usr/bin/env bash
# qats 5.5.0, SNCurve.n: with a thickness the wrong branch of a two-slope curve is taken near its knee.
# Expected: cycles to failure at the range that `fatigue_strength` gives for N cycles are N, whatever the thickness
#   (DNV-RP-C203: the range times the thickness factor is what the curve is read with).
# Seen: a curve of slopes 3 and 5 (knee at 1e6 cycles, thickness exponent 0.2 from 25 mm) at 100 mm gives 315 000 cycles
#   where 500 000 belong, since the branch is chosen by the range without the factor; at 25 mm all is right. `minersum` of
#   exponential ranges is 8.9 % above `minersum_weibull` of the same ranges, which applies the factor first.
# Consequence: damage of thick walls (monopiles of 80 to 100 mm) is too high, up to twice in ranges near the knee, and two
#   functions of one package disagree on one spot.
# probupdate: multiplies ranges by the thickness effect before it reads the curve. To do: multiply ranges yourself, no `th`.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.3.5 scipy==1.17.1 pandas==2.3.3 \
    matplotlib==3.10.7 h5py==3.15.1 npTDMS==1.13.0 pymatreader==1.1.0 openpyxl==3.1.5
"$work/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps qats==5.5.0
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from qats.fatigue.sn import SNCurve, minersum, minersum_weibull

curve = SNCurve("two slopes", m1=3, loga1=11.764, m2=5, nswitch=1e6, t_exp=0.2, t_ref=25)
SCALE, CYCLES = 20.0, 1e7
edges = np.linspace(0, 800, 80001)
ranges, count = (edges[1:] + edges[:-1]) / 2, -CYCLES * np.diff(np.exp(-edges / SCALE))
for thickness, share, excess in (25.0, 1.0, 1.0), (100.0, 0.63, 1.089):
    cycles = float(curve.n(np.array([curve.fatigue_strength(5e5, thickness)]), thickness)[0])
    ratio = minersum(ranges, count, curve, th=thickness) / minersum_weibull(SCALE, 1.0, curve, CYCLES, td=1.0, th=thickness)
    by_hand = minersum(ranges * (thickness / 25) ** 0.2, count, curve)
    by_hand /= minersum_weibull(SCALE, 1.0, curve, CYCLES, td=1.0, th=thickness)
    print(f"{thickness:.0f} mm: {cycles:.0f} cycles where 500000 belong; minersum over minersum_weibull {ratio:.3f}, "
          f"with the factor applied before {by_hand:.3f}")
    assert abs(cycles / 5e5 - share) < 0.01
    assert abs(ratio - excess) < 0.005 and abs(by_hand - 1) < 1e-3
PYTHON
cd "$work"
venv/bin/python run.py
