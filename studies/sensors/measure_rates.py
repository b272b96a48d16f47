"""False alarms and detection rates of `check`'s comparisons on virtual days: gains that change, headings, loggers.

python studies/sensors/measure_rates.py --first 931 --days 4     (about half a minute a day)
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from probupdate.campaign.blocks import block_files, read_block
from probupdate.campaign.checking import check, compare_block
from probupdate.campaign.gain_steps import gain_steps, parts_of_campaign
from probupdate.campaign.heading import block_sway, heading_findings, heading_offset
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.rigid_bodies import campaign_gains
from probupdate.campaign.samples import channel_table
from probupdate.campaign.scada import StateRule, block_conditions, with_rated_power
from probupdate.virtual.simulation import simulate


def scaled(pieces, channels, gain, at):
    """The pieces with channels' gain changed from number `at` on."""
    found = []
    for number, piece in enumerate(pieces):
        density = piece.density.copy()
        for c in channels if number >= at else ():
            density[:, c, :] *= gain
            density[:, :, c] *= gain
        found.append(replace(piece, density=density))
    return found


def day(folder: Path, rng: np.random.Generator, said: dict[str, list[bool]]) -> None:
    campaign = read_campaign(folder)
    rule = with_rated_power(StateRule(rated_power_kw=campaign.rated_power_kw), campaign.scada)
    said["no false alarm"].append(not check(campaign).measured)
    pieces, sways, lowest = [], [], []
    for start, touching in block_files(campaign).items():
        block = read_block(campaign, start, touching)
        rows = channel_table(block, campaign.channels)
        conditions = block_conditions(campaign.scada, start, block.minutes, rule)
        found = compare_block(campaign, block, str(conditions["state"]), conditions, rows, pieces=1)
        if found is not None:
            pieces += found.pieces
            lowest.append(found.lowest_hz)
        sway = block_sway(block, campaign.sensors, block.measured >= 0.5, conditions)
        sways += [] if sway is None else [sway]
    lowest_hz, n = float(np.nanmedian(lowest)), len(pieces)
    cases = [("10 % in a channel", [int(c)], float(rng.choice([0.9, 1.1]))) for c in rng.choice(18, 5, replace=False)]
    cases += [("10 % in a logger", list(g), 1.1) for g in ((0, 1, 2), (14, 15))]
    cases += [("sign turned", [int(rng.integers(18))], -1.0), ("5 % in a channel", [int(rng.integers(18))], 1.05)]
    for what, channels, gain in cases:
        at = int(rng.integers(8, n - 8))
        found, _ = gain_steps(scaled(pieces, channels, gain, at), campaign.sensors, lowest_hz)
        name = ", ".join(campaign.channels[c] for c in channels)
        said[what].append(len(found) == 1 and found[0].channel == name and abs(found[0].size - gain) < 3 * found[0].std)
    leg, gain = 3 * int(rng.integers(4)), float(rng.choice([0.7, 1.3]))
    density, known = parts_of_campaign(scaled(pieces, range(leg, leg + 3), gain, 0), lowest_hz)
    found, _ = campaign_gains(density, [campaign.sensors[k] for k in known], ())
    said["gain of a leg"].append([f.channel for f in found] == [", ".join(campaign.channels[leg: leg + 3])])
    for off in (90.0, float(rng.uniform(15, 60)), -float(rng.uniform(15, 60))):
        turned = [replace(s, heading_deg=s.heading_deg + off) for s in sways]
        answer = heading_offset(turned, campaign.x_axis_heading_deg, lowest_hz)
        error = (answer.offset_deg + off + 90) % 180 - 90
        error = (error + 45) % 90 - 45 if answer.either else error
        named = len(heading_findings(answer)[0]) == 1
        said["heading off by 90" if off == 90 else "heading off by 15 to 60"].append(named)
        if named:
            said["offset right"].append(bool(abs(error) < 4 * np.hypot(answer.std_deg, 2.0)))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--first", type=int, default=931, help="seed of the first day")
    options.add_argument("--days", type=int, default=4)
    chosen = options.parse_args()
    said: dict[str, list[bool]] = defaultdict(list)
    for seed in range(chosen.first, chosen.first + chosen.days):
        with tempfile.TemporaryDirectory() as folder:
            simulate(Path(folder) / "c", days=1, seed=seed)
            day(Path(folder) / "c", np.random.default_rng([seed, 7]), said)
        sys.stdout.write(f"{seed}: " + ", ".join(f"{k} {sum(v)}/{len(v)}" for k, v in said.items()) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
