#!/usr/bin/env bash
# wetb 0.1.33, signal.spectrum.psd: with no_segments the amplitudes are averaged and the mean is squared.
# Expected: the mean of the segments' spectra, as its description says; the area is the variance for any number of them.
# Seen: for white noise of variance 1 the area is 1.00 with one segment, 0.86 with three and 0.79 with a hundred (pi / 4,
#   the squared mean of a Rayleigh distribution over its mean square). scipy's welch gives 1.00 for all.
# Consequence: a spectrum of load, response or excitation is up to 21 % too low, a standard deviation from it 11 %, while a
#   harmonic keeps its height: lines of the rotor stand out further than they do.
# probupdate: estimates its spectra itself by Welch's method. To check: area under the spectrum against the variance.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.3.5 scipy==1.17.1
"$work/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps wetb==0.1.33
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from scipy.signal import welch
from wetb.signal.spectrum import psd

RATE, N = 20.0, 360000
noise = np.random.default_rng(1).standard_normal(N)
sine = np.sqrt(2) * np.sin(2 * np.pi * 2.0 * np.arange(N) / RATE)


def area(record, segments):
    frequency, density = psd(record, RATE, segments)
    return density.sum() * (frequency[1] - frequency[0])


for segments, expected in (1, 1.0), (3, 1 / 3 + 2 / 3 * np.pi / 4), (100, 0.01 + 0.99 * np.pi / 4):
    seen = area(noise, segments)
    frequency, density = welch(noise, RATE, "boxcar", N // segments, 0, detrend=False)
    reference = density.sum() * frequency[1]
    print(f"{segments} segments: noise {seen:.3f}, welch {reference:.3f}; harmonic {area(sine, segments):.3f}")
    assert abs(seen - expected) < 0.01 and abs(reference - 1) < 0.01
    assert abs(area(sine, segments) - 1) < 0.01
PYTHON
cd "$work"
venv/bin/python run.py
