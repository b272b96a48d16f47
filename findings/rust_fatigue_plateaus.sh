#!/usr/bin/env bash
# rust-fatigue 0.1.9, damage_equiv_load: a peak that lasts two equal samples is no peak.
# Expected: the worked example of ASTM E1049-85 (-2 1 -3 5 -1 3 -4 4 -2) with every sample written twice has the damage of
#   the example; holding a value adds no cycle and takes none away.
# Seen: the equivalent load (m = 4, one cycle) falls from 9.59 to 0. Noise of a strain gauge in steps of its converter, 32
#   of them from peak to peak, has 0.47 of the equivalent load that the same record has by rainflow 3.2.0, and by this
#   package with a rise of 1e-9 per sample added; its damage is 0.05 of its value.
# Consequence: the coarser a logger resolves or the faster it samples, the longer the life that comes out.
# probupdate: takes repeated values as one before it counts. To check: add a rise far below the resolution and count again.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check rust-fatigue==0.1.9 rainflow==3.2.0 numpy==2.3.5
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
import rainflow
from rustfatigue import damage_equiv_load

SLOPE = 4


def right(record):
    return sum(count * size**SLOPE for size, _, count, _, _ in rainflow.extract_cycles(record)) ** (1 / SLOPE)


def seen(record):
    return damage_equiv_load(record, SLOPE, 1)


example = np.array([-2.0, 1, -3, 5, -1, 3, -4, 4, -2])
twice = np.repeat(example, 2)
print(f"example {seen(example):.2f}, every sample twice {seen(twice):.2f}; "
      f"by rainflow {right(example):.2f}, {right(twice):.2f}")
assert np.isclose(seen(example), 8449**0.25) and np.isclose(right(twice), 8449**0.25)
assert seen(twice) < 1e-6

smooth = np.convolve(np.random.default_rng(0).standard_normal(12000), np.ones(20) / 20, "same")
stepped = np.round(20 * smooth)
risen = stepped + 1e-9 * np.arange(stepped.size)
share, share_risen = seen(stepped) / right(stepped), seen(risen) / right(stepped)
print(f"record of {np.ptp(stepped):.0f} steps: {share:.3f} of the equivalent load, {share**SLOPE:.3f} of the damage; "
      f"with a slight rise {share_risen:.4f}")
assert share < 0.7 and abs(share_risen - 1) < 1e-3
PYTHON
cd "$work"
venv/bin/python run.py
