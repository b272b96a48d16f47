"""SSI-cov against what is known exactly, a plain second route, another program, and statistics."""

from itertools import pairwise

import numpy as np
import pytest
from one_record import identify_poles
from peer_packages import peer
from scipy import signal

from probupdate.errors import InputError
from probupdate.identification import preprocessing
from probupdate.identification.preprocessing import resample
from probupdate.identification.record import identify_record
from probupdate.identification.ssi import (
    block_toeplitz,
    factorise,
    output_covariances,
    poles,
    product_sums,
    reference_projection,
    stability,
)
from probupdate.modal.modes import mac

RATE, BLOCK_ROWS, ORDER = 5.0, 30, 20


def direct_covariances(data: np.ndarray, n_lag: int) -> np.ndarray:
    n = len(data)
    return np.array([data[k:].T @ data[: n - k] / (n - k) for k in range(n_lag + 1)])


@pytest.mark.parametrize("n", [500, 9000, 300, 61])
def test_covariances_are_the_direct_sums(n):
    data = np.random.default_rng(1).standard_normal((n, 4)).cumsum(axis=0)
    expected = direct_covariances(data, 59)
    assert output_covariances(data, 59) == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(("n", "n_lag", "edges"), [(300, 40, np.arange(0, 301, 25)), (700, 100, [0, 50, 90, 400]),
                                                  (700, 20, [0, 340, 401])])
def test_products_of_parts_are_the_direct_sums(n, n_lag, edges):
    """Parts shorter and longer than the lags, of unequal lengths, and a record that goes on after the last."""
    data = np.random.default_rng(1).standard_normal((n, 3)).cumsum(axis=0)
    found = product_sums(data, n_lag, np.array(edges))
    for part, (first, after) in enumerate(pairwise(edges)):
        for lag in range(n_lag + 1):
            earlier = data[first: min(after, n - lag)]
            expected = data[first + lag: first + lag + len(earlier)].T @ earlier
            assert found[part, lag] == pytest.approx(expected, abs=1e-12 * np.abs(found).max())


def test_too_short_a_record_is_refused():
    with pytest.raises(InputError, match="50 samples for 59 lags"):
        output_covariances(np.ones((50, 2)), 59)


def test_toeplitz_blocks_are_where_they_belong():
    covariance = np.random.default_rng(2).standard_normal((8, 3, 3))
    toeplitz = block_toeplitz(covariance, 4)
    for i in range(4):
        for j in range(4):
            assert (toeplitz[3 * i: 3 * i + 3, 3 * j: 3 * j + 3] == covariance[4 + i - j]).all()


def exact_covariances(structure, n_lag: int) -> np.ndarray:
    """R_k of the known system: Re(q) of variance s^2 has covariance s^2 Re(mu^k); channel noise at lag 0 only."""
    mu = structure.eigenvalue()
    table = structure.strength**2 * (mu[None, :] ** np.arange(n_lag + 1)[:, None]).real
    found = np.einsum("ci,ki,di->kcd", structure.shape, table, structure.shape)
    found[0] += structure.noise**2 * np.eye(len(structure.shape))
    return found


def test_exact_covariances_give_the_exact_modes(jacket, validation):
    """No sampling error left: frequencies, damping and shapes of all five modes, the close pair too, to rounding."""
    row = validation(what="SSI-cov on exact covariances", reference="known system with a close pair", why="rounding")
    order = 2 * len(jacket.frequency_hz)
    (found,) = poles(factorise(exact_covariances(jacket, 59), BLOCK_ROWS, order, RATE), (order,))
    row.error(found.frequency_hz / jacket.frequency_hz - 1, below=1e-7, of="f")
    row.error(found.damping_ratio / jacket.damping_ratio - 1, below=1e-5, of="damping")
    row.error(np.diag(mac(found.shape, jacket.shape)) - 1, below=1e-7, of="MAC")


def test_a_system_without_noise_has_no_more_states_than_it_has(jacket):
    covariance = exact_covariances(jacket, 59)
    (found,) = poles(factorise(covariance, BLOCK_ROWS, ORDER, RATE), (ORDER,))
    assert found.order == ORDER and found.frequency_hz == pytest.approx(jacket.frequency_hz, rel=1e-6)


def plain_poles(data: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The second route: direct sums, a full singular value decomposition, a pseudo-inverse."""
    m, br = data.shape[1], BLOCK_ROWS
    covariance = direct_covariances(data, 2 * br - 1)
    toeplitz = np.block([[covariance[br + i - j] for j in range(br)] for i in range(br)])
    u, s, _ = np.linalg.svd(toeplitz)
    observability = u[:, :order] * np.sqrt(s[:order])
    state = np.linalg.pinv(observability[:-m]) @ observability[m:]
    value, vector = np.linalg.eig(state)
    keep = value.imag > 0
    pole = RATE * np.log(value[keep])
    order_up = np.argsort(abs(pole))
    pole = pole[order_up]
    return abs(pole) / 2 / np.pi, -pole.real / abs(pole), (observability[:m] @ vector[:, keep])[:, order_up]


def test_the_plain_route_gives_the_same_poles(jacket, validation):
    row = validation(what="SSI-cov on a record", reference="direct sums, full SVD, pseudo-inverse", why="rounding")
    data = jacket.record(9000, seed=4)
    found, _ = identify_poles(data, RATE, order=ORDER, block_rows=BLOCK_ROWS)
    frequency, damping, shape = plain_poles(data, ORDER)
    row.error(found.frequency_hz / frequency - 1, below=1e-8)
    row.error(found.damping_ratio - damping, below=1e-8)
    row.error(np.diag(mac(found.shape, shape)) - 1, below=1e-8)


def poles_of(state: np.ndarray, output: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    value, vector = np.linalg.eig(state)
    keep = value.imag > 0
    pole = RATE * np.log(value[keep])
    rising = np.argsort(abs(pole))
    pole, shape = pole[rising], (output @ vector[:, keep])[:, rising]
    return abs(pole) / 2 / np.pi, -pole.real / abs(pole), shape


def test_pyoma2_gives_the_same_poles(jacket, validation):
    """Its realisation of the same matrix to rounding; its own matrix, whose sums run over a common window (60 of 9000
    samples fewer), within a third of the estimate's own scatter."""
    row = validation(what="SSI-cov on a record: frequencies, damping, shapes; frequency by its own matrix over a third "
                          "of the estimate's scatter",
                     reference="pyOMA2 1.4.3, realisation of the same matrix; of its own", why="rounding")
    ssi = peer("pyoma2.functions.ssi")
    data = jacket.record(9000, seed=4)
    found, _ = identify_poles(data, RATE, order=ORDER, block_rows=BLOCK_ROWS)
    toeplitz = block_toeplitz(direct_covariances(data, 2 * BLOCK_ROWS - 1), BLOCK_ROWS)
    _, state, output = ssi.SSI(toeplitz, BLOCK_ROWS, ORDER)
    frequency, damping, shape = poles_of(state[ORDER], output[ORDER])
    row.error(found.frequency_hz / frequency - 1, 1e-8, "frequencies")
    row.error(found.damping_ratio - damping, 1e-8, "damping")
    row.error(np.diag(mac(found.shape, shape)) - 1, 1e-8, "MAC")

    hankel, _ = ssi.build_hank(data.T, data.T, BLOCK_ROWS, "cov")
    _, state, output = ssi.SSI(hankel, BLOCK_ROWS, ORDER)
    frequency, damping, _ = poles_of(state[ORDER], output[ORDER])
    f, zeta = jacket.frequency_hz[2], jacket.damping_ratio[2]  # the mode that stands alone
    ours, theirs = np.argmin(abs(found.frequency_hz - f)), np.argmin(abs(frequency - f))
    scatter = 2 * np.sqrt(zeta / (4 * np.pi * f * 1800))  # twice the Cramer-Rao bound, relative
    row.error((found.frequency_hz[ours] / frequency[theirs] - 1) / (scatter / 3), 1, "its own matrix")


def test_every_order_is_what_it_is_alone(jacket):
    covariance = output_covariances(jacket.record(9000, seed=5), 59)
    together = poles(factorise(covariance, BLOCK_ROWS, 24, RATE), (8, 16, 24))
    for one in together:
        (alone,) = poles(factorise(covariance, BLOCK_ROWS, one.order, RATE), (one.order,))
        assert one.frequency_hz == pytest.approx(alone.frequency_hz, rel=1e-8)
        assert one.damping_ratio == pytest.approx(alone.damping_ratio, abs=1e-8)


def test_an_order_beyond_the_block_rows_is_refused():
    with pytest.raises(InputError, match="order: 20 is above 18"):
        factorise(np.zeros((20, 2, 2)), 10, 20, RATE)


def test_estimates_scatter_about_the_truth(jacket, validation):
    """Sixty half hours. Means within 3.5 standard errors of the truth; the scatter of f not below the Cramer-Rao
    bound of a single mode, f sqrt(zeta / (4 pi f T)) (Gersch 1974), and not above four times it."""
    row = validation(what="mean of f and damping over 60 half hours; scatter of f",
                     reference="truth; Cramer-Rao bound of a single mode")
    n_record, time = 60, 1800.0
    frequency, damping = np.full((n_record, 5), np.nan), np.full((n_record, 5), np.nan)
    for k in range(n_record):
        found, _ = identify_poles(jacket.record(9000, seed=100 + k), RATE, order=10, block_rows=BLOCK_ROWS)
        for j in (2, 3, 4):
            p = int(np.argmin(abs(found.frequency_hz - jacket.frequency_hz[j])))
            frequency[k, j], damping[k, j] = found.frequency_hz[p], found.damping_ratio[p]
    for j in (2, 3, 4):
        error = np.std(frequency[:, j], ddof=1) / np.sqrt(n_record)
        row.error((np.mean(frequency[:, j]) - jacket.frequency_hz[j]) / error, below=3.5, of="f in standard errors")
        error = np.std(damping[:, j], ddof=1) / np.sqrt(n_record)
        row.error((np.mean(damping[:, j]) - jacket.damping_ratio[j]) / error, below=3.5, of="damping likewise")
        bound = jacket.frequency_hz[j] * np.sqrt(jacket.damping_ratio[j] / (4 * np.pi * jacket.frequency_hz[j] * time))
        # a standard deviation of sixty numbers is itself known to 9 %
        row.between(np.std(frequency[:, j], ddof=1) / bound, 0.75, 4, of="scatter over its bound")


def test_a_mode_is_stable_over_the_orders_and_noise_is_not(jacket):
    found, share = identify_poles(jacket.record(9000, seed=6), RATE, order=ORDER, block_rows=BLOCK_ROWS, spread=8)
    for f in jacket.frequency_hz[2:]:
        assert share[np.argmin(abs(found.frequency_hz - f))] >= 0.75
    strange = np.array([min(abs(f / jacket.frequency_hz - 1)) > 0.1 for f in found.frequency_hz])
    assert strange.any() and np.median(share[strange]) < 0.75
    assert stability(found, ()) == pytest.approx(np.zeros(len(share)))


# References, orders, records that cannot be used ---------------------------------------------------------------------


@pytest.mark.parametrize("references", [4, (0, 1, 4, 12, 17)])
def test_references_are_the_same_as_fewer_columns(jacket, references):
    """Projected and chosen channels: covariances with y_ref alone, a tall block Toeplitz matrix, and the exact modes
    still where covariances are exact."""
    data = jacket.record(2000, seed=7)
    whole = output_covariances(data, 59)
    projection = reference_projection(whole, references)
    assert projection.T @ projection == pytest.approx(np.eye(projection.shape[1]), abs=1e-12)
    fewer = output_covariances(data, 59, projection=projection)
    assert fewer == pytest.approx(whole @ projection, abs=1e-12 * np.abs(whole).max())
    (found,) = poles(factorise(exact_covariances(jacket, 59) @ projection, BLOCK_ROWS, 10, RATE), (10,))
    assert found.frequency_hz == pytest.approx(jacket.frequency_hz, rel=1e-7)
    assert found.damping_ratio == pytest.approx(jacket.damping_ratio, rel=1e-5)
    assert np.diag(mac(found.shape, jacket.shape)) == pytest.approx(np.ones(5), abs=1e-7)


def test_projected_references_keep_the_most(jacket):
    """No other four combinations keep more of sum |R_k P|^2: against a hundred random ones and the first channels."""
    whole = output_covariances(jacket.record(2000, seed=7), 59)

    def kept(projection: np.ndarray) -> float:
        return np.linalg.norm(whole[1:] @ projection)

    best, rng = kept(reference_projection(whole, 4)), np.random.default_rng(0)
    others = [np.linalg.qr(rng.standard_normal((18, 4)))[0] for _ in range(100)]
    assert max(kept(p) for p in [*others, np.eye(18)[:, :4]]) < best <= kept(np.eye(18))


@pytest.mark.parametrize("references", [0, 19, (), (1, 1), (-1,), (18,), (0.5,)])
def test_references_that_are_none_are_refused(references):
    with pytest.raises(InputError, match="references"):
        reference_projection(np.zeros((4, 18, 18)), references)


def test_a_record_keeps_the_poles_of_every_order(jacket):
    data = jacket.record(9000, seed=6)
    record = identify_record(data, RATE, order=ORDER, block_rows=BLOCK_ROWS, spread=8)
    assert [one.order for one in record.by_order] == list(range(2, 29, 2))
    found, share = identify_poles(data, RATE, order=ORDER, block_rows=BLOCK_ROWS, spread=8)
    assert record.poles.frequency_hz == pytest.approx(found.frequency_hz, rel=1e-9)
    assert record.stability == pytest.approx(share)
    odd = identify_record(data, RATE, order=9, block_rows=BLOCK_ROWS)
    assert [one.order for one in odd.by_order] == [3, 5, 7, 9]


def test_a_record_that_cannot_be_used_is_refused(jacket):
    data = jacket.record(400, seed=6)

    def identified(changed):
        return identify_record(changed, RATE, order=6, block_rows=10)

    broken, flat = data.copy(), data.copy()
    broken[7, 3], flat[:, 5] = np.nan, 2.5
    with pytest.raises(InputError, match="channel 3 holds NaN"):
        identified(broken)
    with pytest.raises(InputError, match="channel 5 is constant"):
        identified(flat)
    with pytest.raises(InputError, match="19 samples for 19 lags"):
        identified(data[:19])
    with pytest.raises(InputError, match=r"shape \(400,\)"):
        identified(data[:, 0])
    # one channel is a structure too
    alone = identified(data[:, [16]]).poles
    ringing = alone.frequency_hz[(alone.damping_ratio > 0) & (alone.damping_ratio < 0.05)]
    assert ringing == pytest.approx(jacket.frequency_hz[[0, 3]], rel=0.01)


# Resampling --------------------------------------------------------------------------------------------------------


def sine(frequency_hz: float, rate: float = 25.0, seconds: float = 200.0, phase: float = 0.3) -> np.ndarray:
    t = np.arange(round(rate * seconds)) / rate
    return np.cos(2 * np.pi * frequency_hz * t + phase)[:, None]


@pytest.mark.parametrize("frequency_hz", [0.1, 0.32, 1.3, 1.99, 2.25])
def test_what_is_of_interest_passes_without_a_shift(frequency_hz, validation):
    row = validation(what="decimation, band of interest", reference="sine", why="ripple of the filter")
    thinned = resample(sine(frequency_hz), 25.0, 5.0)[:, 0]
    expected = sine(frequency_hz, rate=5.0)[:, 0]
    inside = slice(50, -50)
    # 70 dB: a ripple of 0.03 %, and no phase
    row.error(thinned[inside] - expected[inside], below=1e-3)


@pytest.mark.parametrize("frequency_hz", [2.75, 3.5, 5.0, 9.0, 12.0])
def test_what_would_fold_back_is_stopped(frequency_hz):
    thinned = resample(sine(frequency_hz), 25.0, 5.0)[50:-50, 0]
    assert np.abs(thinned).max() < 10 ** (-68 / 20)


@pytest.mark.parametrize(("rate", "target", "n_sample"), [
    (25.0, 5.0, 4500), (25.0, 5.0, 4503), (100.0, 12.5, 999), (10.0, 7.0, 3000), (64.0, 5.0, 2047), (25.0, 4.96, 1800),
    (200.0, 80.0, 40), (25.0, 5.0, 3)])
def test_matrix_products_are_scipy_s_polyphase_filter(rate, target, n_sample, monkeypatch, validation):
    row = validation(what="decimation by matrix products, eight rates and lengths",
                     reference="scipy's polyphase filter, same taps", why="rounding")
    data = np.random.default_rng(1).standard_normal((n_sample, 3)) + 2.0
    found = resample(data, rate, target)
    monkeypatch.setattr(preprocessing, "_filter_polyphase", lambda data, up, down, taps: signal.resample_poly(
        data, up, down, axis=0, window=taps / up))
    plain = resample(data, rate, target)
    assert found.shape == plain.shape
    row.error(found - plain, below=1e-14)


def test_rates_that_are_no_simple_ratio_are_refused_and_others_kept():
    data = np.random.default_rng(0).standard_normal((1000, 2)) + 3.0
    assert resample(data, 5.0, 5.0).mean(axis=0) == pytest.approx([0, 0], abs=1e-12)
    assert len(resample(data, 25.0, 10.0)) == 400
    with pytest.raises(InputError, match=r"30 Hz is not in \(0, 25\]"):
        resample(data, 25.0, 30.0)
    with pytest.raises(InputError, match="not a ratio of small numbers"):
        resample(data, 25.0, 5.0012345)
