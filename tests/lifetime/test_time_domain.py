"""Annual damage beside another program's stresses in time, of one drawn monopile; more of them in studies/lifetime."""

import sys
from pathlib import Path

import numpy as np

from probupdate.lifetime.spectral import rainflow

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "studies" / "lifetime"))
import time_domain

# first mode at 0.185 Hz, operating with 0.9 and in storms with 0.1 of the year
MONOPILE = 3


def test_annual_damage_is_that_of_stresses_in_time(ops, validation):
    row = validation(what="annual damage of a drawn monopile's worst ten spots, two states",
                     reference="OpenSees' K and M integrated in time, ten-minute pieces counted",
                     why="mesh, lumped soil, Park's fit")
    found = time_domain.run(MONOPILE, batches=1, count=rainflow)
    assert max(np.array(found["error"]) / found["counted"]) < 0.02
    row.error(np.array(found["damage"]) / found["counted"] - 1, below=0.1)
