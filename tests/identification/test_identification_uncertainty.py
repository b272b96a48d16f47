"""Deviations of poles: against finite differences, a plain second route, another program, and statistics."""

import numpy as np
import pytest

from probupdate.identification.record import identify_record
from probupdate.identification.ssi import factorise, poles
from probupdate.modes import unit_largest

RATE, BLOCK_ROWS, ORDER, SPREAD = 5.0, 30, 20, 8


@pytest.fixture(scope="module")
def data(jacket):
    return jacket.record(9000, seed=4)


@pytest.fixture(scope="module", params=[None, 6, (0, 1, 4, 12, 16)], ids=["all", "projected", "chosen"])
def record(request, data):
    return identify_record(data, RATE, order=ORDER, block_rows=BLOCK_ROWS, spread=SPREAD, sub_records=30,
                           references=request.param)


@pytest.mark.parametrize("order", [ORDER, 12])
def test_deviations_are_finite_differences_of_the_identification(record, order):
    """Every pole's ln f, damping and complex shape, two sub-records: covariances moved by +-h dR and identified anew.
    A central difference of h = 1e-4 is wrong by h^2 times the third derivative, largest for poles of the noise."""
    here = next(one for one in record.by_order if one.order == order)
    found = record.deviations(np.arange(len(here.frequency_hz)), order)
    step = 1e-4
    for j in (0, 17):
        after, before = (
            poles(factorise(record.covariance + h * record.covariance_deviation[j], BLOCK_ROWS, 28, RATE), (order,))[0]
            for h in (step, -step)
        )
        shape = (unit_largest(after.shape) - unit_largest(before.shape)) / (2 * step)
        assert found.ln_frequency[:, j] == pytest.approx(
            np.log(after.frequency_hz / before.frequency_hz) / (2 * step), rel=2e-4)
        assert found.damping_ratio[:, j] == pytest.approx(
            (after.damping_ratio - before.damping_ratio) / (2 * step), rel=2e-4)
        largest = np.abs(shape).max(axis=0)
        assert np.all(np.abs(found.shape[:, :, j] - shape) < 1e-4 * largest)
