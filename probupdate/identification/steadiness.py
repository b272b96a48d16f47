"""Whether a mode's amplitude varies as under random forces, or as a machine or a limit cycle has it.

The squared amplitude of a narrow-band Gaussian motion is exponentially distributed, so that its mean square is twice
its squared mean; of a steady oscillation both are equal (the spectral kurtosis; Antoni 2006). A share s of the power
that is steady gives 2 - s^2. Random forces that grow and fade give more than 2, of all modes alike; a line that runs a
share d of the time gives 1 / d, of that mode alone. Neither says anything of the structure's damping.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import fft

from probupdate.identification.classification import frequency_bound
from probupdate.modal.modes import ModalData

# half the band about a mode, in its half-power half-widths and in lines of the record
WIDE, LINES = 4.0, 4
# a mode with half its power steady has 1.75; asked of those that have less than this
STEADY = 1.6
# a line that runs two thirds of the time has this over a steady one; asked of a mode over the other modes' median
BURSTS, FEWEST_OTHERS = 1.5, 2
# blocks from which their own scatter is taken, and its multiples that the mean lies below that of random forces
OWN_SCATTER, SURE = 6, 3.0
# damping ratios below this state too little of how often an amplitude changes
LEAST_DAMPING = 0.003
# of 192 modes that were drawn, half of them in records that lack a fifth of a channel, the frequency's standard
# deviation was at most 4.5 times the Cramer-Rao bound, of 16 of noise at least 8.0
VAGUE = 6.0


def amplitude_kurtosis(
    data: np.ndarray, rate_hz: float, frequency_hz: np.ndarray, damping_ratio: np.ndarray, shape: np.ndarray
) -> np.ndarray:
    """(n_mode,) mean square of each mode's squared amplitude over its squared mean: 2 for random, 1 for steady motion.

    data (n_sample, n_channel) without its mean; shape (n_channel, n_mode). A mode's coordinate is that of a least
    squares fit of all shapes in its band.
    """
    n = len(data)
    line, spectrum = fft.rfftfreq(n, 1 / rate_hz), fft.rfft(data, axis=0)
    found = np.full(len(frequency_hz), np.nan)
    for j, (f, zeta) in enumerate(zip(frequency_hz, damping_ratio, strict=True)):
        half = min(max(WIDE * zeta * f, LINES * rate_hz / n), 0.2 * f)
        band = np.flatnonzero(np.abs(line - f) <= half)
        near = np.flatnonzero((np.abs(frequency_hz - f) <= half) & (np.arange(len(frequency_hz)) != j))
        near = near[: max(shape.shape[0] - 1, 0)]
        fitted = np.linalg.pinv(np.column_stack([shape[:, j], shape[:, near]]))[0]
        analytic = np.zeros(n, complex)
        analytic[band] = spectrum[band] @ fitted
        power = np.abs(fft.ifft(analytic)) ** 2
        if np.any(power > 0):
            found[j] = np.mean(power**2) / np.mean(power) ** 2
    return found


def of_steady_modes(
    names: Sequence[str], kurtosis: np.ndarray, frequency_hz: np.ndarray, damping_ratio: np.ndarray, seconds: float
) -> list[str]:
    """Sentences on modes that keep their amplitude; all (n_block, n_mode), NaN where a mode was not found."""
    said = []
    for j, (name, of_mode, hz, zeta) in enumerate(zip(names, kurtosis.T, frequency_hz.T, damping_ratio.T, strict=True)):
        there = np.isfinite(of_mode)
        if not there.any():
            continue
        value, f = of_mode[there], float(np.median(hz[there]))
        # how many independent amplitudes a block has, and what so few have on average
        count = max(float(np.median(zeta[there])), LEAST_DAMPING) * 2 * np.pi * f * seconds
        own = len(value) >= OWN_SCATTER
        std = float(np.std(value, ddof=1)) if own else 2 / np.sqrt(count)
        mean = float(np.mean(value))
        if mean < STEADY and mean + SURE * std / np.sqrt(len(value)) < 2 * count / (count + 1):
            said.append(
                f"{name} at {f:.4g} Hz keeps its amplitude (mean square of its power over squared mean {mean:.2f}; 2 "
                "under random forces, 1 of a steady line): a machine's line or a limit cycle is in it, and its damping "
                "is not the structure's")
        beside = _of_others(kurtosis, j)
        both = there & np.isfinite(beside)
        if both.any() and _in_bursts(np.log(of_mode[both] / beside[both]), count):
            said.append(
                f"{name} at {f:.4g} Hz comes and goes where other modes do not (mean square of its power over squared "
                f"mean {np.median(of_mode[both]):.2g}, of the others {np.median(beside[both]):.2g}): a machine that "
                "runs at times, or a force in bursts; its damping may not be the structure's")
    return said


def _of_others(kurtosis: np.ndarray, mode: int) -> np.ndarray:
    """(n_block,) the median of the other modes, NaN where fewer than FEWEST_OTHERS were found."""
    others = np.delete(kurtosis, mode, axis=1)
    enough = np.isfinite(others).sum(axis=1) >= FEWEST_OTHERS
    found = np.full(len(kurtosis), np.nan)
    found[enough] = np.nanmedian(others[enough], axis=1)
    return found


def _in_bursts(log_ratio: np.ndarray, count: float) -> bool:
    """Whether a mode's kurtosis over the others' (n_block,), of `count` amplitudes a block, is surely over BURSTS."""
    std = np.std(log_ratio, ddof=1) if len(log_ratio) >= OWN_SCATTER else 1 / np.sqrt(count)
    return bool(np.mean(log_ratio) - SURE * std / np.sqrt(len(log_ratio)) > np.log(BURSTS))


def of_vague_modes(data: ModalData, seconds: float) -> list[str]:
    """Sentences on modes whose frequency is known far less well than that of a mode whose own motion stands out."""
    said = []
    for j, name in enumerate(data.labels):
        found = [(s.frequency_hz[j], s.frequency_std_hz[j], s.damping_ratio[j]) for s in data.sets
                 if s.frequency_std_hz is not None and np.isfinite([s.frequency_hz[j], s.frequency_std_hz[j]]).all()]
        over = [std / (f * frequency_bound(max(zeta, LEAST_DAMPING), f, seconds)) for f, std, zeta in found]
        if over and (times := float(np.median(over))) > VAGUE:
            said.append(f"{name} at {np.median([f for f, _, _ in found]):.4g} Hz: the standard deviation of its "
                        f"frequency is {times:.2g} times that of a mode of its damping in a clear record: a weak mode, "
                        "or poles of noise; look at it with `probupdate explore` before you use it")
    return said
