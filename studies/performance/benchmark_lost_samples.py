"""What identification costs where samples are lost, beside the same record without losses, in one run.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_lost_samples.py

Two hours at 20 and 25 Hz, of 4 and 18 channels, identified as `probupdate identify` does it (settings proposed from the
record, four blocks, standard deviations of 30 parts); a tenth of the samples lost at random: of one channel, of all at
the same times, of each by itself. Least processor time of three.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from scipy import signal

from probupdate import identify

SHARE = 0.1


def record(n_channel: int, rate_hz: float, frequency_hz: tuple[float, ...]) -> np.ndarray:
    """Two hours of (n_sample, n_channel): modes of a cantilever's look under white forces, with sensor noise."""
    rng, n = np.random.default_rng(0), int(7200 * rate_hz)
    data = np.zeros((n, n_channel))
    for k, f in enumerate(frequency_hz):
        pole = np.exp((-0.01 + 1j) * 2 * np.pi * f / rate_hz)
        q = signal.lfilter([1, 0, -1], np.poly([pole, pole.conj()]).real, rng.standard_normal(n))
        data += np.outer(q / q.std(), np.sin((k + 0.5) * np.pi * np.linspace(0.1, 1, n_channel)))
    return 0.1 * (data + 0.02 * rng.standard_normal(data.shape))


def lost(data: np.ndarray, kind: str) -> np.ndarray:
    rng, data = np.random.default_rng(1), data.copy()
    if kind == "one":
        data[rng.random(len(data)) < SHARE, -1] = np.nan
    elif kind == "all together":
        data[rng.random(len(data)) < SHARE] = np.nan
    elif kind == "each by itself":
        data[rng.random(data.shape) < SHARE] = np.nan
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


def main() -> None:
    for n_channel, rate, frequency in ((4, 20.0, (2.0, 4.1, 6.3)), (18, 25.0, (0.33, 1.25, 2.2))):
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


if __name__ == "__main__":
    main()
