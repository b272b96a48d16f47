"""What a logger loses: hours that were never written, files that end early, samples that are not a number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from probupdate.errors import InputError
from probupdate.virtual.operation import Plan

MISSING_HOUR, SHORT_FILE = "missing hour", "file ends early"
LOST_SAMPLES, LOST_ROW = "lost samples", "missing SCADA row"


@dataclass(frozen=True, kw_only=True)
class Gap:
    """A span without data: start and length in s; `channel` is empty where it is all of them."""

    kind: str
    start_s: float
    duration_s: float
    channel: str = ""


def _whole_samples(seconds: float) -> float:
    """The nearest whole number of samples (25 Hz), in seconds."""
    return round(float(seconds) * 25) / 25


def draw_gaps(plan: Plan, channels: tuple[str, ...], given: Mapping, rng: np.random.Generator) -> tuple[Gap, ...]:
    """Gaps of a campaign, sorted by start.

    One missing hour a day, in the first day not in the long stop (where the quiet blocks are); every tenth file
    ends 2 to 60 s early; a dropped packet of up to 0.8 s on all channels every three hours; one channel lost for
    5 to 90 s twice a day; two SCADA rows a day.
    """
    n_hour = -(-plan.n_slot // 6)
    gaps = []
    stopped = [bool(plan.maintenance[6 * k : 6 * k + 6].any()) for k in range(n_hour)]
    if "missing_hours" in given:
        hours = given["missing_hours"]
        if not all(0 <= h < n_hour for h in hours):
            raise InputError("operation.missing_hours", f"{hours!r} are not hours of the campaign",
                             f"give whole numbers from 0 to {n_hour - 1}")
    else:
        hours = []
        for day in range(n_hour // 24):
            free = [h for h in range(24 * day, 24 * day + 24) if day > 0 or not stopped[h]]
            hours.append(int(rng.choice(free)) if free else 24 * day)
    gaps += [Gap(kind=MISSING_HOUR, start_s=3600.0 * h, duration_s=3600.0) for h in sorted(set(hours))]
    early, length = rng.random(n_hour), rng.uniform(2.0, 60.0, n_hour)
    for hour in np.flatnonzero(early < 0.1):
        end = min(3600.0 * (hour + 1), 600.0 * plan.n_slot)
        lost = _whole_samples(length[hour])
        gaps.append(Gap(kind=SHORT_FILE, start_s=end - lost, duration_s=lost))
    total = 600.0 * plan.n_slot
    for _ in range(rng.poisson(total / 10800)):
        start, lost = _whole_samples(rng.uniform(0, total - 1)), _whole_samples(rng.uniform(0.04, 0.8))
        gaps.append(Gap(kind=LOST_SAMPLES, start_s=start, duration_s=lost))
    for _ in range(rng.poisson(total / 43200)):
        start, lost = _whole_samples(rng.uniform(0, total - 90)), _whole_samples(rng.uniform(5, 90))
        channel = channels[int(rng.integers(len(channels)))]
        gaps.append(Gap(kind=LOST_SAMPLES, start_s=start, duration_s=lost, channel=channel))
    for _ in range(rng.poisson(2 * total / 86400)):
        row = int(rng.integers(plan.n_slot))
        gaps.append(Gap(kind=LOST_ROW, start_s=600.0 * row, duration_s=600.0))
    return tuple(sorted(gaps, key=lambda gap: (gap.start_s, gap.kind)))
