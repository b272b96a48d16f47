"""Covariance-driven stochastic subspace identification (SSI-cov): from a record to its poles, Eq. 1-3 of the paper.

Peeters & De Roeck (1999), Reference-based stochastic subspace identification for output-only modal analysis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from probupdate.errors import InputError
from probupdate.modes import frozen_array, mac

# relative to the largest: below it a singular value from T T^T is rounding
LEAST_SINGULAR = 1e-7


@dataclass(frozen=True, eq=False, kw_only=True)
class Poles:
    """Poles of one model order, ascending in frequency, one of each conjugate pair; real eigenvalues are left out.

    frequency_hz, damping_ratio (n_pole,); shape (n_channel, n_pole) complex, not scaled.
    """

    order: int
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Factorisation:
    """The block Toeplitz matrix's leading left side: observability (n_channel block_rows, order), one for all orders.

    singular_value (order,) descending; columns 0..n-1 of `observability` are those of model order n.
    """

    n_channel: int
    sampling_rate_hz: float
    observability: np.ndarray
    singular_value: np.ndarray


def output_covariances(data: np.ndarray, n_lag: int, segment: int = 0) -> np.ndarray:
    """R_k = 1/(N - k) sum_t y(t+k) y(t)^T, k = 0..n_lag: (n_lag + 1, n_channel, n_channel); data (n_sample, n_channel).

    Exact sums over all N - k products, by Fourier transforms of short segments: each segment is correlated with
    itself and the n_lag samples after it, and the spectra are added before one transform back. Divided by N instead,
    the covariances would decay too fast and every damping ratio come out 1 / (omega T) too high, 0.0003 at 0.3 Hz.
    """
    n_sample, n_channel = data.shape
    if n_sample <= n_lag:
        raise InputError("record", f"{n_sample} samples for {n_lag} lags", "give a longer record or fewer block rows")
    # segments of a few times the lag cost least; a power of two transforms fast
    size = segment + n_lag if segment else 1 << int(np.ceil(np.log2(4 * n_lag + 1)))
    step = size - n_lag
    n_segment = -(-n_sample // step)
    padded = np.zeros((n_segment * step + n_lag, n_channel))
    padded[:n_sample] = data
    windows = np.lib.stride_tricks.sliding_window_view(padded, size, axis=0)[::step]  # (n_segment, n_channel, size)
    long = np.fft.rfft(windows, axis=2)
    short = np.fft.rfft(windows[:, :, :step], n=size, axis=2)
    spectrum = np.matmul(long.transpose(2, 1, 0), short.conj().transpose(2, 0, 1))  # (n_line, n_channel, n_channel)
    products = n_sample - np.arange(n_lag + 1)
    return np.fft.irfft(spectrum, n=size, axis=0)[: n_lag + 1] / products[:, None, None]


def block_toeplitz(covariance: np.ndarray, block_rows: int) -> np.ndarray:
    """T (n_channel br, n_channel br) with R_(br + i - j) in block row i, block column j; covariance to lag 2 br - 1."""
    n_channel = covariance.shape[1]
    lag = block_rows + np.arange(block_rows)[:, None] - np.arange(block_rows)
    return covariance[lag].transpose(0, 2, 1, 3).reshape(block_rows * n_channel, block_rows * n_channel)


def factorise(covariance: np.ndarray, block_rows: int, order: int, sampling_rate_hz: float) -> Factorisation:
    """Leading singular vectors of T = O Gamma, with O = U sqrt(S); O holds C, CA, CA^2, ... one below the other.

    The left singular vectors come from the eigenvalues of T T^T: a third of the work of a full decomposition, and
    singular values down to 1e-8 of the largest are right, far below those of an order that is of use.
    """
    n_channel = covariance.shape[1]
    size = n_channel * block_rows
    if order > size - n_channel:
        raise InputError("order", f"{order} is above {size - n_channel}, what {block_rows} block rows allow",
                         "raise the block rows or lower the order")
    toeplitz = block_toeplitz(covariance, block_rows)
    value, vector = linalg.eigh(toeplitz @ toeplitz.T, subset_by_index=[size - order, size - 1], overwrite_a=True)
    singular = np.sqrt(np.maximum(value[::-1], 0))
    return Factorisation(
        n_channel=n_channel, sampling_rate_hz=sampling_rate_hz,
        observability=frozen_array(vector[:, ::-1] * np.sqrt(singular)), singular_value=frozen_array(singular),
    )


def poles(factorisation: Factorisation, orders: tuple[int, ...]) -> tuple[Poles, ...]:
    """A and C of each order by shift invariance, O_up A = O_down in least squares (Eq. 3), and their eigenvalues.

    mu = eig(A), lambda = f_s ln mu, f = |lambda| / 2 pi, zeta = -Re lambda / |lambda|, phi = C psi. One QR
    decomposition of O_up serves every order, its leading columns being those of the lower orders. A record without
    noise may hold fewer states than asked for: then no more than it has are used.
    """
    value = factorisation.singular_value
    rank = int(np.sum(value > LEAST_SINGULAR * value[0]))
    observability, m = factorisation.observability, factorisation.n_channel
    q, r = np.linalg.qr(observability[:-m])
    projected = q.T @ observability[m:]
    result = []
    for order in orders:
        n = min(order, rank)
        state = linalg.solve_triangular(r[:n, :n], projected[:n, :n])
        eigenvalue, vector = np.linalg.eig(state)
        oscillating = eigenvalue.imag > 0
        pole = factorisation.sampling_rate_hz * np.log(eigenvalue[oscillating])
        shape = observability[:m, :n] @ vector[:, oscillating]
        rising = np.argsort(np.abs(pole))
        pole, shape = pole[rising], shape[:, rising]
        result.append(Poles(
            order=order, frequency_hz=frozen_array(np.abs(pole) / (2 * np.pi)),
            damping_ratio=frozen_array(-pole.real / np.abs(pole)), shape=frozen_array(shape, complex),
        ))
    return tuple(result)


def stability(
    chosen: Poles, others: tuple[Poles, ...], *, frequency: float = 0.01, least_mac: float = 0.90
) -> np.ndarray:
    """(n_pole,) share of the other orders in which each pole has a twin: frequency within `frequency` of its own and
    MAC of at least `least_mac`. A mode of the structure comes back at most orders, a pole of the noise does not."""
    twins = np.zeros(len(chosen.frequency_hz))
    for other in others:
        close = np.abs(other.frequency_hz / chosen.frequency_hz[:, None] - 1) <= frequency
        twins += np.any(close & (mac(chosen.shape, other.shape) >= least_mac), axis=1)
    return frozen_array(twins / max(len(others), 1))


def identify_poles(
    data: np.ndarray, rate_hz: float, *, order: int, block_rows: int, spread: int = 0
) -> tuple[Poles, np.ndarray]:
    """Poles of one record (n_sample, n_channel) at one model order, and their stability (n_pole,) over the even
    distances up to `spread` below and above it (1 without)."""
    covariance = output_covariances(data, 2 * block_rows - 1)
    highest = min(order + spread, data.shape[1] * (block_rows - 1))
    around = tuple(n for n in range(order - spread, highest + 1, 2) if n != order and n >= 2)
    found = poles(factorise(covariance, block_rows, max(order, highest), rate_hz), (order, *around))
    return found[0], stability(found[0], found[1:]) if around else np.ones(len(found[0].frequency_hz))
