#!/usr/bin/env bash
# asammdf 8.8.28, MDF.to_dataframe: samples between those of a slow channel are made up, by its number type.
# Expected: a power signal at 1 Hz beside an accelerometer at 100 Hz keeps its samples, or is held for all channels alike.
# Seen: stored as floats, a step from 0 to 10 becomes a ramp: 99 samples with values that were never measured. Stored
#   as integers, the same step is held. No mark in the table tells measured samples from the others.
# Consequence: mean and scatter of a block's operating conditions depend on a storage type, and a turbine that stops
#   at once appears to run down over one period of its logger.
# probupdate: reads operating conditions with their own times (SCADA table). To check: export slow channels by themselves.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check asammdf==8.8.28 numpy==2.3.5 pandas==3.1.1
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from asammdf import MDF, Signal

fast, slow = np.arange(0, 10, 0.01), np.arange(0, 10, 1.0)
step = np.where(slow >= 5, 10, 0)
record = MDF()
record.append([Signal(np.sin(fast), fast, name="acceleration")])
record.append([Signal(step.astype(float), slow, name="power_float"), Signal(step, slow, name="power_integer")])
table = record.to_dataframe()
made_up = {name: int(((table[name] > 0) & (table[name] < 10)).sum()) for name in ("power_float", "power_integer")}
print("samples between 0 and 10 that were never measured:", made_up)
assert made_up["power_float"] == 99
assert made_up["power_integer"] == 0
PYTHON
cd "$work"
venv/bin/python run.py
