"""What finding modes without a model costs beside identifying the blocks: shares of one run's time.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_data_first.py [--hours 6]

A virtual campaign is identified in one process; the ratio is the time of everything after the blocks' poles and
standard deviations, over the time of those. Ratios of one run do not depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import probupdate
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.scada import StateRule
from probupdate.identification.block_store import BlockStore
from probupdate.identification.identify import SSISettings, identify, physical_of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=6.0)
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        probupdate.simulate(Path(folder) / "campaign", days=a.hours / 24, seed=1)
        campaign, settings = read_campaign(Path(folder) / "campaign"), SSISettings()
        store = Path(folder) / "blocks"
        clock = [time.process_time()]
        blocks = BlockStore(store, campaign, settings.of_blocks)
        blocks.fill()
        clock.append(time.process_time())
        found = physical_of(blocks, campaign, settings=settings, rule=StateRule(rated_power_kw=5000.0))
        clock.append(time.process_time())
        identify(campaign, None, settings=settings, store=store)
        clock.append(time.process_time())
        identify(campaign, None, settings=settings, store=store)
        clock.append(time.process_time())
    poles, modes, _, again = (b - a for a, b in zip(clock, clock[1:], strict=False))
    deviations = clock[3] - clock[2] - again
    n = len(blocks.starts)
    sys.stdout.write(
        f"{n} blocks, {len(found.modes.labels)} modes; per block: poles {1e3 * poles / n:.1f} ms, standard deviations "
        f"{1e3 * deviations / n:.1f} ms, modes out of poles {1e3 * modes / n:.1f} ms "
        f"({100 * modes / (poles + deviations):.1f} % of the former two), all that follows the poles "
        f"{1e3 * again / n:.1f} ms\n")


if __name__ == "__main__":
    main()
