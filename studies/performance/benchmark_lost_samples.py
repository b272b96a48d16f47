"""What a block costs that lacks samples, beside one that lacks none, in one run.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_lost_samples.py

Half an hour of 18 channels at 25 Hz, identified at 5 Hz (30 block rows, order 20, every second order to 36), without
standard deviations and with those of 30 parts; a tenth of the samples lost at random, of one channel and of all.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from probupdate.identification.lost_samples import LossyRecord, WholeRecord
from probupdate.identification.preprocessing import resampled

RATE, TARGET, SHARE = 25.0, 5.0, 0.1


def seconds(work: Callable[[], object], repeat: int = 3) -> float:
    """The least processor time of `repeat`."""
    times = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    rng = np.random.default_rng(0)
    data = rng.standard_normal((45000, 18)).cumsum(axis=0)
    data -= data.mean(axis=0)
    lost = rng.random(len(data)) < SHARE
    of_one, of_all = data.copy(), data.copy()
    of_one[lost, 3], of_all[lost] = np.nan, np.nan
    settings = {"order": 20, "block_rows": 30, "spread": 16, "limited": None}
    for parts in (0, 30):
        whole = seconds(lambda p=parts: WholeRecord(data=resampled(data, RATE, TARGET), target_hz=TARGET).identified(
            sub_records=p, **settings))
        ratios = [seconds(lambda p=parts, d=some: LossyRecord(data=d, rate_hz=RATE, target_hz=TARGET).identified(
            sub_records=p, **settings)) / whole for some in (of_one, of_all)]
        print(f"{parts} parts: nothing lost {1e3 * whole:.0f} ms; a tenth lost of one channel {ratios[0]:.2f} times, "
              f"of all {ratios[1]:.2f} times", flush=True)


if __name__ == "__main__":
    main()
