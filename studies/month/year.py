"""What memory a year of blocks takes in one `identify`, by stand-ins for its blocks.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/month/year.py OUT [--blocks 500 1500]

Half a day of the virtual turbine is measured and identified once; its stored blocks, poles and covariance factors stand
for every later half day, and so do its rows of SCADA. All that `identify` does with stored blocks then runs on so many
of them, each number in a process of its own: classification, tracking, the choice of poles, names, modes.json,
covariance factors, table of poles. Not run are the records' own passes, which hold one block at a time. Printed are the
largest resident memory, bytes a block between two numbers of blocks, and what a year of half hours would take by that
line.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import time
from dataclasses import replace
from pathlib import Path

import pandas as pd

import probupdate
from probupdate.campaign.reading import read_campaign
from probupdate.identification.block_store import BlockStore
from probupdate.identification.identify import identify as identify_campaign
from probupdate.identification.settings import IdentificationSettings
from probupdate.verbs import model_path
from probupdate.verbs.identifying import reference_at, ssi_settings

YEAR = 365 * 48
MODEL = "as_built"


class StandIn(BlockStore):
    """A store whose blocks stand again and again, one every half hour."""

    count = 0

    def __init__(self, *given):
        super().__init__(*given)
        self._real = [t for t in self._files if self.read_real(t).poles is not None]
        first = self._real[0]
        self._real_of = {first + k * pd.Timedelta(minutes=30): self._real[k % len(self._real)]
                         for k in range(self.count)}
        self._wanted: dict = {}

    @property
    def starts(self):
        return tuple(self._real_of)

    def read_real(self, start):
        return super().read(start)

    def pending(self):
        return []

    def read(self, start):
        return replace(super().read(self._real_of[start]), id=f"{start:%Y-%m-%dT%H:%MZ}", start=start)

    def fill_factors(self, wanted, **_):
        self._wanted |= wanted
        return 0

    def read_factors(self, start):
        """Of the real block, under the keys that are asked for: a path over a year may choose another order's pole."""
        real, wanted = super().read_factors(self._real_of[start]), tuple(self._wanted[start])
        rows = [k % len(real.key) for k in range(len(wanted))]
        return replace(real, key=wanted, ln_frequency=real.ln_frequency[rows], damping_ratio=real.damping_ratio[rows],
                       shape=real.shape[:, rows])


def repeated(scada: pd.DataFrame, count: int) -> pd.DataFrame:
    """The rows again and again until so many half hours are covered."""
    span = scada.index[-1] - scada.index[0] + pd.Timedelta(minutes=10)
    times = int(count * pd.Timedelta(minutes=30) / span) + 1
    return pd.concat([scada.set_axis(scada.index + k * span) for k in range(times)])


def stand_for(out: Path, count: int, answer) -> None:
    from probupdate.identification import identify as module

    StandIn.count = count
    module.BlockStore = StandIn
    opened = read_campaign(out / "campaign")
    opened = replace(opened, scada=repeated(opened.scada, count))
    sought = reference_at([opened], model_path(MODEL), where=out / "campaign")
    reference, others = sought.modes, sought.others
    settings, *_ = ssi_settings([opened], model_path(MODEL), IdentificationSettings(), reference)
    before, begun = peak_mb(), time.process_time()
    found = identify_campaign(opened, reference, others=others, settings=settings,
                              store=out / "real" / "modes.json.blocks")
    identified = peak_mb()
    found.write(out / f"{count}" / "modes.json")
    sizes = {p.name: p.stat().st_size / 1e6 for p in sorted((out / f"{count}").glob("modes*"))}
    answer.put({"blocks": count, "n_mode": found.data.n_mode, "before_mb": before, "identified_mb": identified,
                "written_mb": peak_mb(), "processor_s": time.process_time() - begun, "files_mb": sizes})


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--blocks", type=int, nargs="+", default=[500, 1500])
    a = parser.parse_args()
    if not (a.out / "real" / "modes.json").exists():
        probupdate.simulate(a.out / "campaign", model="updated", days=0.5, seed=1)
        probupdate.identify(a.out / "campaign", MODEL, store=a.out / "real" / "modes.json.blocks").write(
            a.out / "real" / "modes.json")
    rows = []
    context = multiprocessing.get_context("spawn")
    for count in a.blocks:
        answer = context.Queue()
        job = context.Process(target=stand_for, args=(a.out, count, answer))
        job.start()
        rows.append(answer.get(timeout=6 * 3600))
        job.join()
        print(json.dumps(rows[-1]), flush=True)
    if len(rows) > 1:
        first, last = rows[0], rows[-1]
        slope = (last["written_mb"] - first["written_mb"]) / (last["blocks"] - first["blocks"])
        year = last["written_mb"] + slope * (YEAR - last["blocks"])
        print(f"{1000 * slope:.1f} kB a block; {YEAR} blocks, a year of half hours: {year:.0f} MB by that line",
              flush=True)
    (a.out / "year.json").write_text(json.dumps({"rows": rows, "load": os.getloadavg()}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
