#!/usr/bin/env bash
# pylife 2.3.1, FourPointDetector and ThreePointDetector: `recorder.collective` lacks what has not closed, as a rule the
#   largest cycle of the record.
# Expected: ten minutes with one slow swing of +-50 MPa and waves of +-5 MPa have a largest range of 110 MPa, as fatpack
#   0.7.8 counts it.
# Seen: the largest range of the collective is 10 MPa and the damage (slope 3) 24 times smaller; the swing is in
#   `detector.residuals`, which no damage sum takes up by itself. Of the record joined to itself it is counted.
# Consequence: records of ten minutes or an hour that are counted one by one leave out the slow wind and the start and
#   stop in each, which make most of the damage.
# probupdate: its own rainflow has half cycles. To check: largest range against maximum minus minimum.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check pylife==2.3.1 fatpack==0.7.8 numpy==2.4.6 \
    pandas==3.1.1 scipy==1.17.1
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import fatpack
import numpy as np
import pandas as pd
import pylife.strength.fatigue  # noqa: F401
import pylife.stress.rainflow as rainflow

time = np.arange(0, 600, 0.05)
stress = 50 * np.sin(2 * np.pi * time / 600) + 5 * np.sin(2 * np.pi * time / 7)
curve = pd.Series({"SD": 100.0, "ND": 1e6, "k_1": 3.0})


def counted(detector, record):
    """Largest range and damage of what the recorder has."""
    recorder = rainflow.recorders.FullRecorder()
    detector(recorder=recorder).process(record)
    cycles = recorder.collective
    damage = curve.fatigue.miner_elementary().damage(cycles.load_collective).sum()
    return float(np.abs(cycles["to"] - cycles["from"]).max()), float(damage)


ranges = fatpack.find_rainflow_ranges(stress, k=2**16)
whole = float(np.sum((ranges / 200) ** 3) / 1e6)
print(f"maximum minus minimum {np.ptp(stress):.1f} MPa; fatpack: largest range {ranges.max():.1f} MPa, damage {whole:.2e}")
for detector in (rainflow.FourPointDetector, rainflow.ThreePointDetector):
    largest, damage = counted(detector, stress)
    twice, _ = counted(detector, np.concatenate([stress, stress]))
    print(f"{detector.__name__}: largest range {largest:.1f} MPa, damage {damage:.2e}; of the record twice {twice:.1f} MPa")
    assert largest < 0.1 * np.ptp(stress) < np.ptp(stress) < 1.01 * twice
    assert 20 * damage < whole < 30 * damage
PYTHON
cd "$work"
venv/bin/python run.py
