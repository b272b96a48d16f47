#!/usr/bin/env bash
# qats 5.5.0, signal.lowpass and highpass (also wetb 0.1.33, low_pass): cut-offs far below the sampling rate give numbers
#   that are none.
# Expected: the quasi-static part (below 0.05 Hz) of a record at 200 Hz with mean 5 has mean 5; a vibration of 0.3 Hz
#   passes a high pass of 0.01 Hz at 100 Hz with amplitude 1. Sections of second order of the same filter do both.
# Seen: mean 3.20 where the low pass ends, and an amplitude of 17: the default filter is of fifth order and is run as
#   a ratio of polynomials, whose poles lie too close together for double precision. No warning.
# Consequence: the mean and slow stress of a strain record, or a drift that was to be removed, come out at random; fatigue
#   damage and thermal corrections follow them.
# probupdate: filters with a symmetric FIR only, where it decimates. To check: the mean before and after; decimate first or
#   give order=2.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.3.5 scipy==1.17.1 pandas==2.3.3 \
    matplotlib==3.10.7 h5py==3.15.1 npTDMS==1.13.0 pymatreader==1.1.0 openpyxl==3.1.5
"$work/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps qats==5.5.0 wetb==0.1.33
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from qats.signal import highpass, lowpass
from scipy.signal import butter, sosfiltfilt
from wetb.signal.filters.frq_filters import low_pass


def record(rate):
    time = np.arange(0, 600, 1 / rate)
    return time, np.sin(2 * np.pi * 0.3 * time)


time, wave = record(200.0)
inner = (time >= 200) & (time < 400)
sections = sosfiltfilt(butter(5, 0.05, fs=200.0, output="sos"), wave + 5)[inner].mean()
seen = lowpass(wave + 5, 1 / 200.0, 0.05)[inner].mean()
other = low_pass(wave + 5, 200.0, 0.05)[inner].mean()
print(f"mean below 0.05 Hz at 200 Hz: qats {seen:.3f}, wetb {other:.3f}, sections {sections:.3f}, expected 5")
assert abs(sections - 5) < 1e-3
assert abs(seen - 5) > 0.5 and abs(other - 5) > 0.5

time, wave = record(100.0)
inner = (time >= 200) & (time < 400)
sections = np.sqrt(2) * sosfiltfilt(butter(5, 0.01, "high", fs=100.0, output="sos"), wave)[inner].std()
seen = np.sqrt(2) * highpass(wave, 0.01, 0.01)[inner].std()
print(f"amplitude of 0.3 Hz above 0.01 Hz at 100 Hz: qats {seen:.3f}, sections {sections:.3f}, expected 1")
assert abs(sections - 1) < 0.01
assert seen > 2
PYTHON
cd "$work"
venv/bin/python run.py
