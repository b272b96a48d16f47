"""Records of a Gaussian process by their spectrum."""

import numpy as np


def gaussian_record(
    frequency_hz: np.ndarray, spectrum: np.ndarray, *, rate_hz: float, n_sample: int, rng: np.random.Generator
) -> np.ndarray:
    """(n_sample,) with the one-sided spectrum (n_frequency,), random amplitudes and phases; linear between
    frequencies, nothing beyond them."""
    line = np.fft.rfftfreq(n_sample, 1 / rate_hz)
    density = np.interp(line, frequency_hz, spectrum, left=0.0, right=0.0)
    z = rng.standard_normal((2, len(line)))
    half = np.sqrt(density * rate_hz / n_sample / 2) * (z[0] + 1j * z[1]) * n_sample / np.sqrt(2)
    half[0] = 0.0
    return np.fft.irfft(half, n_sample)
