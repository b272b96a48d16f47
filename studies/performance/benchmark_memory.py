"""Largest resident memory of one `diagnose` by what it is at, in one process.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_memory.py RUN

RUN: a folder that the demonstration wrote, or writes now. Each line is the largest until then, so that what is smaller
than an earlier one shows as that one. Where pyarrow is installed pandas imports it: 33 MB more.
"""

from __future__ import annotations

import resource
import sys
import time
from importlib.util import find_spec

from demonstrated import asked


def largest() -> int:
    """Resident memory of this process at its largest so far, MB."""
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    run = asked(__doc__).run
    from probupdate.diagnosis import run as imported
    from probupdate.verbs import diagnose

    peaks = {f"imports ({imported.__name__})": largest()}

    def progress(what: str, *_) -> None:
        # the last call of a step comes when it has ended
        peaks[what] = largest()

    found = diagnose(run / "model.toml", run / "modes.json", campaign=run / "campaign",
                     out=run / "benchmark_memory.json", progress=progress)
    peaks["all"] = largest()
    lines = "\n".join(f"| {what} | {megabytes} |" for what, megabytes in peaks.items())
    sys.stdout.write(f"{lines}\n{time.process_time():.0f} s of processor time, {len(found.findings)} findings, pyarrow "
                     f"{'not ' if find_spec('pyarrow') is None else ''}installed\n")


if __name__ == "__main__":
    main()
