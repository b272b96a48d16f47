"""Deviations of poles: against finite differences, a plain second route, another program, and statistics."""

import numpy as np
import pytest

from probupdate.identification.record import identify_record
from probupdate.identification.ssi import block_toeplitz, factorise, poles
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


def pyoma2():
    # importing it switches numpy's warnings off for good
    with np.errstate():
        return pytest.importorskip("pyoma2.functions.ssi", reason="pyOMA2, a peer to compare with, is not installed")


def peer_deviations(ssi, toeplitz, deviation, block_rows, order):
    """(f, zeta, std f, std zeta) of its poles at `order`, ascending in f, from that matrix and those columns."""
    with np.errstate():
        obs, state, output, _ = ssi.SSI_fast(toeplitz, block_rows, order, step=1)
        f, zeta, _, eigenvalue, f_std, zeta_std, _ = ssi.SSI_poles(
            obs, state, output, order, 1 / RATE, step=1, HC=False, calc_unc=True, H=toeplitz, T=deviation)
    column = np.flatnonzero(eigenvalue[:, order].imag > 0)
    column = column[np.argsort(f[column, order])]
    return tuple(table[column, order] for table in (f, zeta, f_std, zeta_std))


def test_pyoma2_gives_the_same_deviations(jacket):
    """The same block Toeplitz matrix and the same columns of deviations, at step 1: to rounding, which its inverses
    of (H^T H / s^2 - I) enlarge. Then its own matrices, with sums over common windows of 8941 of the 9000 samples in
    30 parts of 298: the same estimates within a third of a deviation, deviations within their own 13 % twice."""
    ssi = pyoma2()
    data = jacket.record(9000, seed=4)[:, [0, 1, 4, 12, 13]]
    block_rows, order = 12, 10
    record = identify_record(data, RATE, order=order, block_rows=block_rows, sub_records=30)
    found = record.deviations(np.arange(len(record.poles.frequency_hz)))
    std_f = record.poles.frequency_hz * np.linalg.norm(found.ln_frequency, axis=1)
    std_zeta = np.linalg.norm(found.damping_ratio, axis=1)

    toeplitz = block_toeplitz(record.covariance, block_rows)
    columns = np.column_stack([block_toeplitz(one, block_rows).ravel(order="F") for one in record.covariance_deviation])
    for ours, theirs in zip((record.poles.frequency_hz, record.poles.damping_ratio, std_f, std_zeta),
                            peer_deviations(ssi, toeplitz, columns, block_rows, order), strict=True):
        assert ours == pytest.approx(theirs, rel=1e-8)

    hankel, columns = ssi.build_hank(data.T, data.T, block_rows, "cov", calc_unc=True, nb=30)
    f, zeta, f_std, zeta_std = peer_deviations(ssi, hankel, columns, block_rows, order)
    for target in jacket.frequency_hz[2:]:
        ours, theirs = np.argmin(abs(record.poles.frequency_hz - target)), np.argmin(abs(f - target))
        assert abs(record.poles.frequency_hz[ours] - f[theirs]) < std_f[ours] / 3
        assert abs(record.poles.damping_ratio[ours] - zeta[theirs]) < std_zeta[ours] / 3
        assert std_f[ours] == pytest.approx(f_std[theirs], rel=0.26)
        assert std_zeta[ours] == pytest.approx(zeta_std[theirs], rel=0.26)
