"""Seconds that `diagnose` takes for modal sets of a month, bootstrap included, against the fewest sets, in one run.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_diagnosis.py [--blocks 48 240 1440]

Half hours of the virtual turbine in all states, of as many days as it takes (a month has some 700 undisturbed ones).
Nothing is hidden, or joints of one face loosened from the middle on and a sensor's gain. Making the model ready is told
apart.
"""

from __future__ import annotations

import argparse
import sys
import time

from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.prepare import prepare
from probupdate.structure.load import reference_model
from probupdate.virtual.modal_blocks import simulate_modes

STATES = ("idling", "below rated", "rated")
PER_DAY = 22  # undisturbed half hours
HIDDEN = [
    {"kind": "joint_stiffness", "face": "BC", "bay": 2, "leg": "all", "end": "all", "factor": 0.3,
     "time_profile": "step",
     "at_hour": 360.0},
    {"kind": "sensor_gain", "channel": "T66-x", "factor": 0.85},
]


def seconds(call) -> tuple[object, float, float]:
    """What a call gives, its seconds by the clock and of processor time."""
    clock, cpu = time.perf_counter(), time.process_time()
    result = call()
    return result, time.perf_counter() - clock, time.process_time() - cpu


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blocks", type=int, nargs="+", default=[48, 240, 1440])
    parser.add_argument("--seed", type=int, default=3)
    a = parser.parse_args()
    ready, clock, cpu = seconds(lambda: prepare(reference_model("updated")))
    sys.stdout.write(f"the model made ready: {clock:.1f} s, {cpu:.1f} s of processor time\n")
    for name, hidden in (("nothing hidden", []), ("two hidden", HIDDEN)):
        least = None
        for n in a.blocks:
            days = max(30.0, n / PER_DAY)
            data = simulate_modes(truth={"effect": hidden}, seed=a.seed, states=STATES, n_block=n, days=days).data
            outcome, clock, cpu = seconds(lambda data=data: examine(ready, data, seed=1))
            least = least or (cpu, len(data.sets))
            found = outcome.diagnosis
            causes = "; ".join(f"{f.cause}, {f.location}" for f in found.findings)
            sys.stdout.write(
                f"{name}, {len(data.sets)} sets: {clock:.1f} s, {cpu:.1f} s of processor time, "
                f"{cpu / least[0]:.1f} times that of {least[1]} sets; {found.verdict} {causes}\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
