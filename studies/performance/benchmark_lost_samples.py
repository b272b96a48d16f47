"""What identification costs where samples are lost, beside the same record without losses, in one run; and whether
stated standard deviations hold the truth there.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_lost_samples.py [pulls]

Two hours at 20 and 25 Hz, of 4 and 18 channels, identified as `probupdate identify` does it (settings proposed from the
record, four blocks, standard deviations of 30 parts); a tenth of the samples lost at random: of one channel, of all at
the same times, of each by itself. Least processor time of three. `pulls`: twenty hours of each, up to 30 % lost of each
channel by itself, at random and in bursts of 15 samples on average; root mean square over blocks and modes of
estimate less truth over the stated standard deviation.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from scipy import signal

from probupdate import identify

SHARE, DAMPING, BURST = 0.1, 0.01, 15
STRUCTURES = ((4, 20.0, (2.0, 4.1, 6.3)), (18, 25.0, (0.33, 1.25, 2.2)))


def shapes(n_channel: int, n_mode: int) -> np.ndarray:
    """(n_channel, n_mode) of a cantilever's look."""
    return np.sin(np.outer(np.linspace(0.1, 1, n_channel), (np.arange(n_mode) + 0.5) * np.pi))


def record(n_channel: int, rate_hz: float, frequency_hz: tuple[float, ...], hours: float = 2.0) -> np.ndarray:
    """(n_sample, n_channel) of modes under white forces, with sensor noise."""
    rng, n = np.random.default_rng(0), int(3600 * hours * rate_hz)
    data = np.zeros((n, n_channel))
    for f, shape in zip(frequency_hz, shapes(n_channel, len(frequency_hz)).T, strict=True):
        pole = np.exp((-DAMPING + 1j * np.sqrt(1 - DAMPING**2)) * 2 * np.pi * f / rate_hz)
        q = signal.lfilter([1, 0, -1], np.poly([pole, pole.conj()]).real, rng.standard_normal(n))
        data += np.outer(q / q.std(), shape)
    return 0.1 * (data + 0.02 * rng.standard_normal(data.shape))


def lost(data: np.ndarray, kind: str, share: float = SHARE) -> np.ndarray:
    rng, data = np.random.default_rng(1), data.copy()
    if kind == "one":
        data[rng.random(len(data)) < share, -1] = np.nan
    elif kind == "all together":
        data[rng.random(len(data)) < share] = np.nan
    elif kind == "each by itself":
        data[rng.random(data.shape) < share] = np.nan
    elif kind == "in bursts":
        for column in data.T:
            # measured and lost by turns, each of geometric length
            n = len(column) // BURST
            ends = np.cumsum(np.column_stack([rng.geometric(share / (BURST * (1 - share)), n),
                                              rng.geometric(1 / BURST, n)]).ravel())
            column[np.searchsorted(ends, np.arange(len(column)), side="right") % 2 == 1] = np.nan
    return data


def campaign(folder: Path, data: np.ndarray, rate_hz: float) -> Path:
    (folder / "acceleration").mkdir(parents=True)
    sensors = "".join(f'[[sensor]]\nchannel = "C{k}"\nlevel = "C{k}"\nposition_m = [0.0, 0.0, {3.0 * k}]\n'
                      'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n'
                      for k in range(data.shape[1]))
    (folder / "campaign.toml").write_text(
        f'name = "lost"\nsampling_rate_hz = {rate_hz}\nblock_minutes = 30\n{sensors}')
    with h5py.File(folder / "acceleration" / "a.h5", "w") as file:
        written = file.create_dataset("data", data=data.astype("f4"))
        written.attrs.update(start="2026-01-01T00:00:00Z", sampling_rate_hz=rate_hz)
    return folder


def print_costs() -> None:
    for n_channel, rate, frequency in STRUCTURES:
        data, least = record(n_channel, rate, frequency), {}
        kinds = ("nothing", "one", "all together", "each by itself")
        with tempfile.TemporaryDirectory() as folder:
            paths = {kind: campaign(Path(folder) / kind, lost(data, kind), rate) for kind in kinds}
            identify(paths["nothing"])
            # kinds in turn, so that what else the machine does meets all alike
            for _ in range(3):
                for kind, path in paths.items():
                    start = time.process_time()
                    identify(path)
                    least[kind] = min(least.get(kind, np.inf), time.process_time() - start)
        print(f"{n_channel} channels: nothing lost {least['nothing']:.2f} s; "
              + ", ".join(f"{kind} {least[kind] / least['nothing']:.2f} times" for kind in kinds[1:]), flush=True)


def pulls(sets, frequency_hz: tuple[float, ...]) -> tuple[list[list[float]], int]:
    """Errors over standard deviations of ln f, damping and shapes (root mean square of a shape's components), and the
    columns that are no mode."""
    true = shapes(sets[0].shape.shape[0], len(frequency_hz))
    near = [int(np.argmin(abs(np.log(frequency_hz / np.nanmedian(f)))))
            if np.min(abs(np.log(frequency_hz / np.nanmedian(f)))) < 0.03 else -1
            for f in np.transpose([s.frequency_hz for s in sets])]
    found: list[list[float]] = [[], [], []]
    for s in sets:
        for j, k in enumerate(near):
            if k < 0 or np.isnan(s.frequency_hz[j]):
                continue
            shape, std = s.shape[:, j].real, s.shape_std[:, j].real
            known = std > 1e-9
            scaled = true[:, k] * (shape[~known][0] / true[~known, k][0])
            found[0].append((s.frequency_hz[j] - frequency_hz[k]) / s.frequency_std_hz[j])
            found[1].append((s.damping_ratio[j] - DAMPING) / s.damping_ratio_std[j])
            found[2].append(np.sqrt(np.mean(((shape - scaled)[known] / std[known]) ** 2)))
    return found, near.count(-1)


def print_pulls() -> None:
    for n_channel, rate, frequency in STRUCTURES:
        data = record(n_channel, rate, frequency, hours=20.0)
        for kind in ("each by itself", "in bursts"):
            for share in (0.05, 0.1, 0.2, 0.3):
                with tempfile.TemporaryDirectory() as folder:
                    sets = identify(campaign(Path(folder) / "camp", lost(data, kind, share), rate)).data.sets
                found, false = pulls(sets, frequency)
                root = [np.sqrt(np.mean(np.square(v))) for v in found]
                print(f"{n_channel} channels, {100 * share:.0f} % {kind}: pulls of f, damping, shapes "
                      + ", ".join(f"{v:.2f}" for v in root)
                      + f"; {len(found[0])} of {len(frequency) * len(sets)} found, {false} false", flush=True)


if __name__ == "__main__":
    print_pulls() if sys.argv[1:] == ["pulls"] else print_costs()
