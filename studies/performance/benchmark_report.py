"""Seconds of a page's figures: ticks found once against matplotlib's way, sections in two processes against one.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_report.py RUN [--repeat 1]

RUN: a folder that the demonstration wrote, or writes now. All of it is timed in turns in one run, so that ratios do not
depend on what else the machine does as much as seconds do; pages are compared byte by byte.
"""

from __future__ import annotations

import sys
import time
from contextlib import nullcontext
from importlib import import_module
from unittest import mock

from demonstrated import asked

from probupdate.reporting import compose, style
from probupdate.reporting.run_files import read_run
from probupdate.runtime.executors import executor


def main() -> None:
    a = asked(__doc__)
    run = read_run(a.run, lambda *_: None)
    least: dict[str, list[float]] = {}
    pages = set()

    def timed(name: str, jobs) -> None:
        clock, cpu = time.perf_counter(), time.process_time()
        pages.add(compose(run, jobs=jobs))
        taken = time.perf_counter() - clock, time.process_time() - cpu
        least[name] = [min(pair) for pair in zip(taken, least.get(name, taken), strict=True)]

    with executor(2) as two:
        # what is imported is not timed
        two.prepare(2, "probupdate.reporting.run_files", "matplotlib.backends.backend_svg")
        import_module("matplotlib.backends.backend_svg")
        for _ in range(a.repeat):
            with mock.patch.object(style, "ticks_found_once", nullcontext):
                timed("plain", 1)
            timed("once", 1)
            timed("two", two)
    plain, once, pair = (least[name] for name in ("plain", "once", "two"))
    sys.stdout.write(
        f"a page of {len(next(iter(pages))) / 1e6:.1f} MB: {plain[1]:.1f} s of processor time with matplotlib's own "
        f"layout, {once[1]:.1f} s with ticks found once, ratio {plain[1] / once[1]:.2f}; by the clock {plain[0]:.1f}, "
        f"{once[0]:.1f} and in two processes {pair[0]:.1f} s, ratios {plain[0] / once[0]:.2f} and "
        f"{plain[0] / pair[0]:.2f}; pages are {'the same' if len(pages) == 1 else 'NOT the same'}\n")


if __name__ == "__main__":
    main()
