"""Clocks that drift beyond the range in which delays are sought: by the steps between blocks, never as a constant."""

import numpy as np
import pandas as pd
import pytest

from probupdate.campaign.findings import Compared, clock_findings, runaway_clocks

CHANNELS = ("a", "b", "c")


def blocks(ppm, n=48, seed=0):
    """Half hours: the delay of b, NaN or at a wrong period where it is beyond two seconds."""
    rng, found = np.random.default_rng(seed), []
    for k in range(n):
        late = ppm * 1e-6 * 1800 * (k + 0.5)
        seen = late if late < 2 else rng.uniform(-1, 1) if rng.random() < 0.1 else np.nan
        start = pd.Timestamp("2024-05-01T00:00Z") + k * pd.Timedelta(minutes=30)
        found.append(Compared(id=start.strftime("%H:%M"), start=start, state="unknown", suspicions=(), pieces=(),
                              delay_s=np.array([0.0, seen, 0.001]) + 0.001 * rng.standard_normal(3),
                              delay_std_s=np.full(3, 0.002), lowest_hz=0.3))
    return found


@pytest.mark.parametrize("ppm", [30, 100, 150, 200, -40])
def test_a_drift_beyond_the_range_is_named_by_its_size(ppm):
    compared = blocks(ppm)
    if ppm < 0:
        compared = [c for c in compared if c.delay_s[1] > -2]
    drift, _ = runaway_clocks(compared, CHANNELS)["b"]
    assert drift / 0.0864 == pytest.approx(ppm, rel=0.02)
    (text,) = clock_findings(compared, CHANNELS)[0]
    assert text.startswith("suspect: the clock of b drifts by") and "beyond the 2 s" in text


@pytest.mark.parametrize("ppm", [0, 10])
def test_what_stays_within_the_range_is_no_runaway(ppm):
    assert runaway_clocks(blocks(ppm), CHANNELS) == {}
