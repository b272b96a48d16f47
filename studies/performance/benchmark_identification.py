"""How fast a block is identified, with and without deviations: against pyOMA2 and against plain numpy.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_identification.py

One block of 18 channels x 9000 samples (30 min at 5 Hz), 30 block rows, order 20, 30 sub-records. pyOMA2 takes a minute
and 2 GB with deviations; where it is not installed that is said, and only plain numpy is compared with.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

import numpy as np
from scipy import signal

from probupdate.identification.record import identify_record

RATE, BLOCK_ROWS, ORDER, PARTS = 5.0, 30, 20, 30


def block() -> np.ndarray:
    """(9000, 18): five modes of a column, two close pairs and a torsion, driven by white noise, and noise of channels;
    no number is drawn that the time taken could depend on."""
    rng = np.random.default_rng(0)
    frequency, damping = np.array([0.316, 0.323, 1.29, 1.93, 2.02]), np.array([0.015, 0.012, 0.01, 0.01, 0.012])
    data = 0.01 * rng.standard_normal((9000, 18))
    for f, zeta in zip(frequency, damping, strict=True):
        pole = np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * 2 * np.pi * f / RATE)
        white = rng.standard_normal((11000, 2)) @ np.array([1, 1j])
        motion = signal.lfilter([np.sqrt(1 - abs(pole) ** 2)], [1.0, -pole], white)[2000:].real
        data += np.outer(motion, rng.standard_normal(18))
    return data - data.mean(axis=0)


def seconds(work: Callable[[], object], repeat: int) -> float:
    """The least processor time of `repeat`: what else the machine does only adds."""
    times = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def plain_covariances(data: np.ndarray) -> np.ndarray:
    n = len(data)
    return np.array([data[k:].T @ data[: n - k] / (n - k) for k in range(2 * BLOCK_ROWS)])


def plain_poles(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f and zeta by a full singular value decomposition and a pseudo-inverse for every even order; the last's."""
    m = covariance.shape[1]
    toeplitz = np.block([[covariance[BLOCK_ROWS + i - j] for j in range(BLOCK_ROWS)] for i in range(BLOCK_ROWS)])
    u, s, _ = np.linalg.svd(toeplitz)
    for order in range(2, ORDER + 1, 2):
        observability = u[:, :order] * np.sqrt(s[:order])
        value = np.linalg.eigvals(np.linalg.pinv(observability[:-m]) @ observability[m:])
    pole = RATE * np.log(value[value.imag > 0])
    pole = pole[np.argsort(abs(pole))]
    return abs(pole) / (2 * np.pi), -pole.real / abs(pole)


def plain_std(data: np.ndarray) -> np.ndarray:
    """Standard deviations of f by identifying again for every part of the record, its covariances added in small."""
    covariance, length, step = plain_covariances(data), len(data) // PARTS, 1e-4
    f, _ = plain_poles(covariance)
    moved = []
    for j in range(PARTS):
        part = data[j * length: (j + 1) * length + 2 * BLOCK_ROWS]
        covariance_factors = (plain_covariances(part) - covariance) / np.sqrt(PARTS * (PARTS - 1))
        moved.append((plain_poles(covariance + step * covariance_factors)[0] - f) / step)
    return np.linalg.norm(moved, axis=0)


def pyoma2_work(data: np.ndarray, ssi, deviations: bool) -> Callable[[], object]:
    def work():
        hankel, columns = ssi.build_hank(data.T, data.T, BLOCK_ROWS, "cov", calc_unc=deviations, nb=PARTS)
        observability, state, output, _ = ssi.SSI_fast(hankel, BLOCK_ROWS, ORDER, step=1)
        return ssi.SSI_poles(observability, state, output, ORDER, 1 / RATE, step=1, calc_unc=deviations, H=hankel,
                             T=columns)

    return work


def main() -> None:
    data = block()

    def ours(**options):
        return identify_record(data, RATE, order=ORDER, block_rows=BLOCK_ROWS, **options)

    def with_std(**options):
        record = ours(sub_records=PARTS, **options)
        return record.factors(np.arange(len(record.poles.frequency_hz)))

    with_std()
    rows = [("without deviations", seconds(ours, 15), seconds(lambda: plain_poles(plain_covariances(data)), 3), False),
            ("with deviations of all poles", seconds(with_std, 9), seconds(lambda: plain_std(data), 1),
             True)]
    rows_projected = [seconds(lambda: ours(references=6), 15), seconds(lambda: with_std(references=6), 9)]
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    try:
        from pyoma2.functions import ssi
    except ImportError as error:
        ssi = None
        print(f"pyOMA2 left out: {error}")
    for (name, mine, plain, deviations), projected in zip(rows, rows_projected, strict=True):
        print(f"{name}: {1e3 * mine:.0f} ms; 6 projected references {1e3 * projected:.0f} ms; "
              f"plain numpy {plain:.2f} s, ratio {plain / mine:.1f}", flush=True)
        if ssi is not None:
            theirs = seconds(pyoma2_work(data, ssi, deviations), 1 if deviations else 3)
            print(f"    pyOMA2, every order: {theirs:.2f} s, ratio {theirs / mine:.1f}", flush=True)
    print(f"peak memory before pyOMA2: {megabytes:.0f} MiB")


if __name__ == "__main__":
    main()
