"""Covariance-driven stochastic subspace identification (SSI-cov): from a record to its poles, Eq. 1-3 of the paper.

Peeters & De Roeck (1999), Reference-based stochastic subspace identification for output-only modal analysis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, linalg

from probupdate.errors import InputError
from probupdate.identification.settings import CONSTANTS
from probupdate.modal.modes import mac
from probupdate.runtime.arrays import frozen_array

LEAST_SINGULAR, SMALL, SPLIT = CONSTANTS.least_singular, CONSTANTS.small_singular, CONSTANTS.split_singular
EPS = float(np.finfo(float).eps)


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

    singular_value (order,) descending; columns 0..n-1 of `observability` are those of model order n. whole: of all
    singular values their squares, left vectors as columns and the squares' rounding (`left_singular_vectors`);
    None where only the leading ones were asked for.
    """

    n_channel: int
    sampling_rate_hz: float
    observability: np.ndarray
    singular_value: np.ndarray
    whole: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @property
    def rank(self) -> int:
        """How many states the record holds: a record without noise may hold fewer than asked for."""
        return int(np.sum(self.singular_value > LEAST_SINGULAR * self.singular_value[0]))


@dataclass(frozen=True, eq=False, kw_only=True)
class Realisation:
    """A and C of one order: all eigenvalues (n,) of A and eigenvectors (n, n), columns, and which of them are the
    order's poles (`oscillating`, ascending in frequency); output C (n_channel, n)."""

    eigenvalue: np.ndarray
    vector: np.ndarray
    oscillating: np.ndarray
    output: np.ndarray
    sampling_rate_hz: float

    @property
    def continuous(self) -> np.ndarray:
        """(n_pole,) lambda = f_s ln mu, rad/s."""
        return self.sampling_rate_hz * np.log(self.eigenvalue[self.oscillating])


def check_record(data: np.ndarray, n_lag: int) -> None:
    """Raise InputError where a record (n_sample, n_channel) has nothing to identify: too short, NaN, a flat channel."""
    if data.ndim != 2 or data.shape[1] == 0:
        raise InputError("record", f"has shape {data.shape}", "give (n_sample, n_channel)")
    n_sample = data.shape[0]
    if n_sample <= n_lag:
        raise InputError("record", f"{n_sample} samples for {n_lag} lags", "give a longer record or fewer block rows")
    lost = np.flatnonzero(~np.all(np.isfinite(data), axis=0))
    if lost.size:
        raise InputError("record", f"channel {_list_columns(lost)} holds NaN or an infinite number",
                         "fill short gaps or leave the record out")
    still = np.flatnonzero(np.ptp(data, axis=0) == 0)
    if still.size:
        raise InputError("record", f"channel {_list_columns(still)} is constant", "leave the channel out")


def _list_columns(columns: np.ndarray) -> str:
    return ", ".join(str(k) for k in columns)


class LaggedProducts:
    """Sums of products of a record's channels at lags 0..n_lag, data (n_sample, n_channel), over the parts
    [edges[j], edges[j + 1]): y(t + k) y(t)^T with t in the part; t + k may lie in the next one, so that the parts' sums
    add up to those of the whole record.

    By Fourier transforms of short segments, each transformed once: a segment is correlated with itself and, turned by
    their distance, with those after it; the spectra of a part's segments are added before one transform back. Of
    records in single precision in that.
    """

    def __init__(self, data: np.ndarray, n_lag: int, edges: np.ndarray):
        kind = np.result_type(data.dtype, np.float32)
        shortest, longest = int(np.diff(edges).min()), int(np.diff(edges).max())
        # segments as long as the lags cost least; the last one of a part is no shorter, so that lags end in the next
        self.n_lag, each = n_lag, max(shortest // max(n_lag, 64), 1)
        while each > 1 and shortest - (each - 1) * -(-longest // each) < n_lag:
            each -= 1
        self.each, step = each, -(-longest // each)
        inner = edges[:-1, None] + step * np.arange(each)
        self.n_segment = inner.size
        # samples after the last part are met by lags alone
        start = np.concatenate([inner.ravel(), np.arange(edges[-1], min(edges[-1] + n_lag, len(data)), step)])
        end = np.append(start[1:], max(edges[-1], min(start[-1] + step, len(data))))
        # distance in samples of each segment to the following ones, as far as lags reach
        self.following = []
        while True:
            apart = start[len(self.following) + 1:] - start[: len(start) - len(self.following) - 1]
            apart = apart[: self.n_segment]
            if not np.any(apart < n_lag + step):
                break
            self.following.append(apart)
        farthest = max((int(x.max()) for x in self.following), default=0)
        self.size = fft.next_fast_len(max(farthest + step, step + n_lag + 1), real=True)
        segments = np.zeros((self.size, len(start), data.shape[1]), kind)
        for k, (first, after) in enumerate(zip(start, np.minimum(end, len(data)), strict=True)):
            segments[: max(after - first, 0), k] = data[first:after]
        self.spectrum = fft.rfft(segments, axis=0, overwrite_x=True)  # (n_line, n_segment, n_channel)

    def sums(self, part: int, rows: np.ndarray | None = None, past: np.ndarray | None = None,
             projection: np.ndarray | None = None) -> np.ndarray:
        """(n_lag + 1, n_row, n_past) of one part: channels `rows` with the earlier channels `past`, None for all, or
        combinations of these."""
        first, after = part * self.each, (part + 1) * self.each
        window = self.spectrum[:, first: after + len(self.following)]
        ahead, behind = (window if some is None or len(some) == window.shape[2] else window[:, :, some]
                         for some in (rows, past))
        later = ahead[:, : self.each].copy()
        line = np.arange(len(later))[:, None, None]
        for k, apart in enumerate(self.following, start=1):
            some = apart[first:after]
            distance = some[:1] if np.all(some == some[:1]) else some
            turn = np.exp(-2j * np.pi / self.size * (line * distance[:, None])).astype(later.dtype)
            later[:, : len(some)] += turn * ahead[:, k: k + len(some)]
        earlier = behind[:, : self.each].conj()
        if projection is not None:
            earlier = earlier @ projection
        return fft.irfft(np.matmul(later.transpose(0, 2, 1), earlier), n=self.size, axis=0)[: self.n_lag + 1]


def product_sums(
    data: np.ndarray, n_lag: int, edges: np.ndarray, projection: np.ndarray | None = None
) -> np.ndarray:
    """`LaggedProducts` of all parts: (n_part, n_lag + 1, n_channel, n_reference); the past of all channels, or of their
    combinations by projection (n_channel, n_reference)."""
    products = LaggedProducts(data, n_lag, edges)
    return np.stack([products.sums(j, projection=projection) for j in range(len(edges) - 1)])


def output_covariances(data: np.ndarray, n_lag: int, projection: np.ndarray | None = None) -> np.ndarray:
    """R_k = 1/(N - k) sum_t y(t+k) y_ref(t)^T, k = 0..n_lag: (n_lag + 1, n_channel, n_reference).

    data (n_sample, n_channel); y_ref = projection^T y, projection (n_channel, n_reference), or all channels. Exact
    sums over all N - k products. Divided by N instead, the covariances would decay too fast and every damping ratio
    come out 1 / (omega T) too high, 0.0003 at 0.3 Hz.
    """
    n_sample = len(data)
    if n_sample <= n_lag:
        raise InputError("record", f"{n_sample} samples for {n_lag} lags", "give a longer record or fewer block rows")
    sums = product_sums(data, n_lag, np.array([0, n_sample]), projection)[0]
    return sums / (n_sample - np.arange(n_lag + 1))[:, None, None]


def reference_projection(covariance: np.ndarray, references: int | tuple[int, ...]) -> np.ndarray:
    """(n_past, n_reference), of covariance (n_lag + 1, n_channel, n_past), n_past usually all channels: the past of
    those channels alone, or, for a number, of the so many orthonormal combinations of channels that keep most of
    sum_k |R_k|^2, k > 0.

    Lag 0 is left out, in which the noise of channels is.
    """
    n_channel = covariance.shape[2]
    if isinstance(references, int | np.integer):
        if not 1 <= references <= n_channel:
            raise InputError("references", f"{references} of {n_channel} channels", f"choose 1 to {n_channel}")
        past = covariance[1:].reshape(-1, n_channel)
        return linalg.eigh(past.T @ past)[1][:, ::-1][:, :references]
    chosen = np.asarray(references)
    if chosen.ndim != 1 or chosen.size == 0 or chosen.dtype.kind not in "iu" or len(set(references)) < chosen.size \
            or chosen.min() < 0 or chosen.max() >= n_channel:
        raise InputError("references", f"{references} are not different channels of {n_channel}",
                         f"give numbers from 0 to {n_channel - 1}")
    return np.eye(n_channel)[:, chosen]


def block_toeplitz(covariance: np.ndarray, block_rows: int) -> np.ndarray:
    """T (n_channel br, n_reference br) with R_(br + i - j) in block row i, block column j; covariance to lag 2 br - 1.
    """
    lag = block_rows + np.arange(block_rows)[:, None] - np.arange(block_rows)
    blocks = covariance[lag].transpose(0, 2, 1, 3)
    return blocks.reshape(block_rows * covariance.shape[1], block_rows * covariance.shape[2])


def left_singular_vectors(
    toeplitz: np.ndarray, count: int, needed: int | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The `count` leading singular values of T, descending, squared, left singular vectors (rows, count), and the
    rounding (count,) that the squares may hold.

    From the eigenvalues of T T^T: a third of the work of a full decomposition. Their rounding is that of the largest,
    so that where the `needed` first ones (all) fall below 1e-5 of it, those below 1e-3 are found again in the
    complement of the vectors above: the same in two steps, each with a rounding of its own. A tall T is made square by
    a QR decomposition.
    """
    tall = toeplitz.shape[0] > toeplitz.shape[1]
    q, square = np.linalg.qr(toeplitz) if tall else (None, toeplitz)
    size = len(square)
    value, vector = _leading_vectors(square, count)
    rounding = np.full(count, EPS * max(float(value[0]), 0.0))
    last = (needed or count) - 1
    if value[last] < SMALL**2 * value[0]:
        above = int(np.sum(value > SPLIT**2 * value[0]))
        complement = linalg.qr(vector[:, :above])[0][:, above:]
        below, turned = _leading_vectors(complement.T @ square, min(count, size) - above)
        value = np.concatenate([value[:above], below])
        vector = np.concatenate([vector[:, :above], complement @ turned], axis=1)
        # beside its own, T holds that of its largest elements
        own = np.sqrt(np.maximum(below, 0.0) * value[0])
        rounding = np.concatenate([rounding[:above], EPS * (max(float(below[0]), 0.0) + own)])
    return value, q @ vector if tall else vector, rounding


def _leading_vectors(matrix: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    size = len(matrix)
    # of all of them, dividing and conquering is a fifth faster
    asked = {"driver": "evd"} if count == size else {"subset_by_index": [size - count, size - 1]}
    value, vector = linalg.eigh(matrix @ matrix.T, overwrite_a=True, **asked)
    return value[::-1], vector[:, ::-1]


def factorise(
    covariance: np.ndarray, block_rows: int, order: int, sampling_rate_hz: float, *, whole: bool = False
) -> Factorisation:
    """Leading singular vectors of T = O Gamma, with O = U sqrt(S); O holds C, CA, CA^2, ... one below the other. whole:
    all of them are kept, which covariance factors ask for."""
    n_channel, n_reference = covariance.shape[1:]
    most = min(n_channel * (block_rows - 1), n_reference * block_rows)
    if order > most:
        raise InputError("order", f"{order} is above {most}, what {block_rows} block rows allow",
                         "raise the block rows or lower the order")
    toeplitz = block_toeplitz(covariance, block_rows)
    found = left_singular_vectors(toeplitz, min(toeplitz.shape) if whole else order, order)
    value, vector = found[0][:order], found[1][:, :order]
    singular = np.sqrt(np.maximum(value, 0))
    return Factorisation(
        n_channel=n_channel, sampling_rate_hz=sampling_rate_hz,
        observability=frozen_array(vector * np.sqrt(singular)), singular_value=frozen_array(singular),
        whole=found if whole else None,
    )


def realisations(factorisation: Factorisation, orders: tuple[int, ...]) -> tuple[Realisation, ...]:
    """A and C of each order by shift invariance, O_up A = O_down in least squares (Eq. 3), with the eigenvectors of A.

    One QR decomposition of O_up serves every order, its leading columns being those of the lower orders. No more
    states are used than the record holds.
    """
    observability, m = factorisation.observability, factorisation.n_channel
    q, r = np.linalg.qr(observability[:-m])
    projected = q.T @ observability[m:]
    result = []
    for order in orders:
        n = min(order, factorisation.rank)
        state = linalg.solve_triangular(r[:n, :n], projected[:n, :n])
        eigenvalue, vector = np.linalg.eig(state)
        oscillating = np.flatnonzero(np.imag(eigenvalue) > 0)
        rising = np.argsort(np.abs(np.log(eigenvalue[oscillating])))
        result.append(Realisation(
            eigenvalue=eigenvalue, vector=vector, oscillating=oscillating[rising], output=observability[:m, :n],
            sampling_rate_hz=factorisation.sampling_rate_hz,
        ))
    return tuple(result)


def poles(factorisation: Factorisation, orders: tuple[int, ...]) -> tuple[Poles, ...]:
    """The poles of each order: f = |lambda| / 2 pi, zeta = -Re lambda / |lambda|, phi = C psi."""
    return tuple(_poles(order, one) for order, one in zip(orders, realisations(factorisation, orders), strict=True))


def _poles(order: int, realisation: Realisation) -> Poles:
    pole = realisation.continuous
    return Poles(
        order=order, frequency_hz=frozen_array(np.abs(pole) / (2 * np.pi)),
        damping_ratio=frozen_array(-np.real(pole) / np.abs(pole)),
        shape=frozen_array(realisation.output @ realisation.vector[:, realisation.oscillating], complex),
    )


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
