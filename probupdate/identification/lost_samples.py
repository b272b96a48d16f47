"""Covariances of records that lack samples: over the pairs that were measured, at every lag.

E[y_i(t + k) y_j(t)] is estimated by the mean over those t at which both were measured, at the rate of the record; what
decimation does to a record, its filter's autocorrelation does to the covariance function, which is then taken at the
lags of the lower rate. Nothing is filled in. Of a channel that lacks samples only what is new in it is taken so: its
regression on the channels that lack none of these is subtracted before and added after, as a control variate is; what
a pattern of losses would fold to other frequencies is little then. A channel that has no pairs at some lag, such as
one of which every second sample was measured, is not a reference: its past is left out, its row stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import fft

from probupdate.campaign.gaps import fill_short_gaps, zero_filled
from probupdate.errors import InputError
from probupdate.identification.preprocessing import PASS_SHARE, covariance_weights, resample
from probupdate.identification.record import IdentifiedRecord, identify_covariances, identify_record
from probupdate.identification.ssi import LaggedProducts, output_covariances, reference_projection
from probupdate.runtime.arrays import frozen_array

# a reference has this share of all pairs with each channel, at every lag, at least
LEAST_PAIRS = 0.05
# numbers of lagged products in memory at a time
LARGEST_PRODUCTS = 2**25
# what is lost may add so much of a channel's lowest spectral density, for its record to count as whole
LEAST_NOISE = 0.1
# segments of the spectrum that goes beside a stabilisation diagram: 512 samples are 100 s at 5 Hz
SPECTRUM_SAMPLES = 512
# singular values that are kept of its matrix: of more than a few modes at one frequency nothing is seen
SINGULAR_VALUES = 4
# lags at which the parts' pairs are counted
SHARE_LAGS = 6
# distances of samples at which it is asked whether a channel has pairs at all
NEAR_LAGS = 64


@dataclass(frozen=True, eq=False, kw_only=True)
class WholeRecord:
    """data (n_sample, n_channel) at target_hz, nothing missing."""

    data: np.ndarray
    target_hz: float

    def identify(self, *, limited: int | None, sub_records: int, **settings) -> IdentifiedRecord:
        """`record.identify_record` of it."""
        return identify_record(self.data, self.target_hz, limited=limited, sub_records=sub_records, **settings)

    @property
    def whole(self) -> WholeRecord:
        """Itself: its spectra are what was measured."""
        return self

    def channel_spectra(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (n_line,) in Hz and power spectral densities (n_line, n_channel) in SI units squared per Hz;
        Welch's mean over half-overlapping Hann windows."""
        from scipy import signal

        return signal.welch(self.data, fs=self.target_hz, nperseg=min(SPECTRUM_SAMPLES, len(self.data)), axis=0)

    def summed_spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """As `channel_spectra`, summed over the channels."""
        line, density = self.channel_spectra()
        return frozen_array(line), frozen_array(density.sum(axis=1))

    def singular_spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (n_line,) in Hz and the largest singular values (n_value, n_line) of the spectral matrix at each,
        in SI units squared per Hz; of the same windows as `summed_spectrum`."""
        from scipy import signal

        size = min(SPECTRUM_SAMPLES, len(self.data))
        line, _, transform = signal.stft(self.data.T, fs=self.target_hz, nperseg=size, boundary=None, padded=False,
                                         scaling="psd", detrend="constant")
        # (n_line, n_channel, n_window); of one side: all but the mean and Nyquist's line stand for two
        value = np.linalg.svd(transform.transpose(1, 0, 2), compute_uv=False) ** 2 / transform.shape[2]
        value[1 : (size + 1) // 2] *= 2
        return frozen_array(line), frozen_array(value[:, :SINGULAR_VALUES].T)


@dataclass(frozen=True, eq=False, kw_only=True)
class LossyRecord:
    """data (n_sample, n_channel) at rate_hz, NaN where a sample is missing, to be identified at target_hz."""

    data: np.ndarray
    rate_hz: float
    target_hz: float

    def identify(self, *, limited: int | None, sub_records: int, block_rows: int, **settings) -> IdentifiedRecord:
        """`record.identify_covariances` of the pairs that were measured."""
        found = pair_covariances(self.data, self.rate_hz, self.target_hz, 2 * block_rows - 1, sub_records=sub_records,
                                 limited=limited)
        return identify_covariances(found.covariance, found.changes, self.target_hz, block_rows=block_rows, **settings)

    def summed_spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """As of a whole record, with what is lost as noise (`gaps.zero_filled`)."""
        return self._filled_samples.summed_spectrum()

    def singular_spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """As of a whole record, with what is lost as noise."""
        return self._filled_samples.singular_spectrum()

    @property
    def whole(self) -> WholeRecord | None:
        """As a whole record, with what is lost as noise, where that is far below what else the channels have at any
        frequency; None where it is not."""
        lost = np.mean(~np.isfinite(self.data), axis=0)
        line, density = self._filled_samples.channel_spectra()
        least = density[(line > 0) & (line < PASS_SHARE * self.target_hz / 2)].min(axis=0, initial=np.inf)
        noise = 2 * lost / (1 - lost) * np.nanvar(self.data, axis=0) / self.rate_hz
        return self._filled_samples if np.all(noise <= LEAST_NOISE * least) else None

    @cached_property
    def _filled_samples(self) -> WholeRecord:
        return WholeRecord(data=resample(zero_filled(self.data), self.rate_hz, self.target_hz),
                           target_hz=self.target_hz)

    def interpolate_gaps(self) -> np.ndarray:
        """(n_sample, n_channel) at target_hz with straight lines over gaps: good for following a rotor's angle."""
        return resample(fill_short_gaps(self.data, len(self.data))[0], self.rate_hz, self.target_hz)

    def without_part(self, part: np.ndarray) -> LossyRecord:
        """Without a part (n_sample, n_channel) that was found at target_hz and is slow beside it."""
        from scipy import signal

        ratio = Fraction(self.target_hz / self.rate_hz).limit_denominator(1000)
        if ratio != 1:
            part = signal.resample_poly(part, ratio.denominator, ratio.numerator, axis=0)
        return replace(self, data=self.data - part[: len(self.data)])


def without_pairs(known: np.ndarray, repeated: np.ndarray, rate_hz: float) -> str:
    """Why covariances of a record cannot be estimated, where no channel has pairs with all others at every small
    distance in time; empty where one has. known (n_sample, n_channel) bool, repeated (n_channel,) share."""
    # what two channels lack both is at most the sum of what each lacks
    least = known.mean(axis=0)
    if np.max(least) + np.min(least) - 1 >= LEAST_PAIRS + NEAR_LAGS / len(known):
        return ""
    mask = np.where(known, 1.0, np.nan)
    if len(_Pairs(mask, 0, min(NEAR_LAGS, len(mask)) - 1).references()):
        return ""
    if repeated.min() > 0.1:
        own = rate_hz * (1 - repeated.max())
        return (f"gaps: every channel repeats its values, so that no two samples are {1 / rate_hz:g} s apart: convert "
                f"every {1 / (1 - repeated.max()):.3g}th row, with a sampling rate of {own:.4g} Hz")
    return ("gaps: at some time lags no pair of samples of any channel was measured: convert the record at the "
            "rate at which it was measured")


@dataclass(frozen=True, eq=False, kw_only=True)
class PairCovariances:
    """covariance (n_lag + 1, n_channel, n_reference), and its changes (n_sub, ...) scaled as those of
    `uncertainty.sub_record_covariances`; None where none were asked for."""

    covariance: np.ndarray
    changes: np.ndarray | None


def _control(data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every channel less its regression on those that were measured wherever it was, and elsewhere too: (n_sample,
    n_channel) with the same samples missing, and B (n_channel, n_channel), so that the channels are B times these."""
    known = np.isfinite(data)
    centred = data - np.nanmean(data, axis=0)
    single = known.astype("f4")
    together = np.round(single.T @ single)
    measured = together.diagonal()
    slope = np.zeros((data.shape[1],) * 2)
    for c in np.flatnonzero(measured < len(data)):
        wider = np.flatnonzero((measured > measured[c]) & (together[c] == measured[c]))
        if len(wider):
            mine = known[:, c]
            others = centred[:, wider][mine]
            slope[c, wider] = np.linalg.lstsq(others.T @ others, others.T @ centred[mine, c], rcond=None)[0]
    rest = centred - np.nan_to_num(centred) @ slope.T if slope.any() else centred
    return rest, np.linalg.inv(np.eye(len(slope)) - slope)


class _Pairs:
    """A record's products and their number, at lags from `first_lag` to `last_lag`: data (n_sample, n_channel) about
    its mean, NaN where lost. Channels that lack the same samples share a mask. Pairs are counted in single
    precision. Of negative lags the later sample is the
    reference's: the same products as at positive ones, transposed."""

    def __init__(self, data: np.ndarray, first_lag: int, last_lag: int):
        known = np.isfinite(data)
        self.n_sample, self.ahead, self.last = len(data), -first_lag, last_lag
        columns = [column.tobytes() for column in np.packbits(np.ascontiguousarray(known.T), axis=1)]
        kinds = list(dict.fromkeys(columns))
        self.kind, one = np.array([kinds.index(x) for x in columns]), [columns.index(x) for x in kinds]
        self.value = np.where(known, data, 0.0)
        self.mask = known[:, one].astype("f4")
        every = np.arange(len(kinds))
        # (n_lag, n_kind, n_kind)
        self.number = np.round(self._sums_both_ways(self._lagged_products(self.mask), 0, every, every)[0])

    def _lagged_products(self, columns: np.ndarray) -> LaggedProducts:
        return LaggedProducts(columns, self.last, np.array([0, self.n_sample]))

    def _sums_both_ways(self, lagged: LaggedProducts, part: int, rows: np.ndarray, references: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
        """(n_lag, n_row, n_reference), and the same with rows and references exchanged."""
        ahead = lagged.sums(part, rows, references)
        back = ahead if rows is references else lagged.sums(part, references, rows)
        return tuple(np.concatenate([a[self.ahead:0:-1].transpose(0, 2, 1), b])
                     for a, b in ((back, ahead), (ahead, back)))

    def shares(self, lags: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """(n_part, n_lag, n_kind, n_kind) of all pairs at these lags those with the earlier sample in a part, counted
        at a few of them: shares change slowly with the lag, but for none."""
        few = np.unique(np.r_[0, 1, np.linspace(1, len(lags) - 1, SHARE_LAGS)].astype(int).clip(0, len(lags) - 1))
        counted = np.empty((len(edges) - 1, len(few), *self.number.shape[1:]))
        for j, (first, after) in enumerate(pairwise(edges)):
            for k, lag in enumerate(lags[few]):
                later = self.mask[first + lag: after + lag]
                counted[j, k] = later.T @ self.mask[first: first + len(later)]
        counted /= np.maximum(self.number[lags[few] + self.ahead], 1.0)
        between = np.array([np.interp(np.arange(len(lags)), few, row) for row in np.eye(len(few))])
        return np.einsum("jkab,kl->jlab", counted, between, optimize=True)

    def products(self, rows: np.ndarray, references: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n_lag, n_row, n_reference) sums of products, and those with rows and references exchanged."""
        return self._sums_both_ways(self._lagged_products(self.value), 0, rows, references)

    def by_channels(self, number: np.ndarray, rows: np.ndarray, references: np.ndarray) -> np.ndarray:
        """Numbers by kinds as numbers by channels and references."""
        return number[:, self.kind[rows][:, None], self.kind[references]]

    def references(self) -> np.ndarray:
        """Channels that were measured together with every channel at every lag; a channel's own lack of pairs costs
        that channel alone."""
        lag = np.abs(np.arange(-self.ahead, self.last + 1))
        share = np.min(self.number / np.maximum(self.n_sample - lag, 1)[:, None, None], axis=0)
        return np.flatnonzero((share >= LEAST_PAIRS).all(axis=0)[self.kind])


def pair_covariances(
    data: np.ndarray, rate_hz: float, target_hz: float, n_lag: int, *, sub_records: int = 0, limited: int | None = None,
) -> PairCovariances:
    """Output covariances to `n_lag` at target_hz of a record (n_sample, n_channel) at rate_hz, NaN where lost.

    sub_records: parts whose scatter gives standard deviations, 0 for none. limited: combinations of channels to take
    the past of (`ssi.reference_projection`), where memory asks for it. Raises InputError where no channel was measured
    at all lags. The change of a part is what its products have beyond the record's covariance, each over the number of
    all pairs, so that parts that lost more weigh less.
    """
    first_lag, weights = covariance_weights(rate_hz, target_hz, n_lag)
    rest, back = _control(data)
    # in single precision: what is lost leaves far more scatter
    pairs = _Pairs(rest.astype("f4"), first_lag, first_lag + weights.shape[1] - 1)
    references = pairs.references()
    if not len(references):
        raise InputError("record", "at some time lag no pair of samples of a channel was measured",
                         "convert the record at the rate at which it was measured, or leave channels out")
    lossy = np.asarray(np.isnan(data).any(axis=0))
    thin = resample(pairs.value, rate_hz, target_hz) if sub_records or not lossy.all() else np.empty((0, len(lossy)))
    # the past may be of any combinations of channels
    covariance = back @ _covariances_of_pairs(pairs, weights, references, thin, lossy)
    changes = back @ _changes_of_parts(pairs, weights, references, thin, rate_hz / target_hz, sub_records)
    if limited is not None and limited < len(references):
        projection = reference_projection(covariance, limited)
        covariance, changes = covariance @ projection, changes @ projection
    return PairCovariances(covariance=frozen_array(covariance), changes=frozen_array(changes) if sub_records else None)


def _covariances_of_pairs(
    pairs: _Pairs, weights: np.ndarray, references: np.ndarray, thin: np.ndarray, lossy: np.ndarray
) -> np.ndarray:
    """Covariances (n_lag, n_channel, n_reference); of channels that lack nothing as of any record, by `thin`."""
    every, whole = np.arange(len(lossy)), np.flatnonzero(~lossy)
    covariance = np.empty((len(weights), len(every), len(references)))
    if len(whole):
        # where all channels are so that is less work by far
        place = np.ix_(np.arange(len(weights)), whole, ~lossy[references])
        covariance[place] = output_covariances(thin[:, whole], len(weights) - 1)
    size = max(LARGEST_PRODUCTS // (weights.shape[1] * len(every)), 1)
    missing = np.flatnonzero(lossy)
    for first in range(0, len(missing), size):
        some = every if len(missing) == len(every) <= size else missing[first: first + size]
        # all channels with these, and these with all
        ways = ((every, some),) if some is every else ((every, some), (some, every))
        for (rows, past), products in zip(ways, pairs.products(every, some), strict=False):
            column = np.flatnonzero(np.isin(references, past))
            chosen = np.searchsorted(past, references[column])
            # none at all only where the past is of a channel that is not a reference
            number = np.maximum(pairs.by_channels(pairs.number, rows, past), 1.0)
            covariance[:, rows[:, None], column] = _select_lags(weights, products / number)[:, :, chosen]
    return covariance


def _changes_of_parts(
    pairs: _Pairs, weights: np.ndarray, references: np.ndarray, thin: np.ndarray, down: float, sub_records: int
) -> np.ndarray:
    """Changes (n_sub, n_lag, n_channel, n_reference) by the products of the decimated record with zeros for what is
    lost, over what is left of the pairs after the filter: what a pattern of losses folds to other frequencies counts
    as scatter."""
    n_lag, every = len(weights) - 1, np.arange(thin.shape[1])
    if not sub_records:
        return np.empty((0, n_lag + 1, len(every), len(references)))
    edges = np.round(np.linspace(0, len(thin), sub_records + 1)).astype(int)
    products = LaggedProducts(thin, n_lag, edges)
    changes = np.stack([products.sums(j, None, references) for j in range(sub_records)])
    number = _select_lags(weights, pairs.number) / down
    changes /= pairs.by_channels(number, every, references)
    lags = np.round(np.arange(n_lag + 1) * down).astype(int)
    share = pairs.shares(lags, np.round(edges * down).astype(int).clip(max=pairs.n_sample))
    of_parts = pairs.by_channels(share.reshape(-1, *share.shape[2:]), every, references).reshape(changes.shape)
    changes -= of_parts * changes.sum(axis=0)
    return changes * np.sqrt(sub_records / (sub_records - 1))


def _select_lags(weights: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return (weights @ covariance.reshape(len(covariance), -1)).reshape(len(weights), *covariance.shape[1:])


def pair_spectra(data: np.ndarray, rate_hz: float, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n_line,) in Hz and cross-spectra (n_line, n, n) of the channels that can be references, as Welch's
    of Hann windows of `length` samples are on average (a transform of the covariances in the windows' autocorrelation),
    each channel over its variance. data (n_sample, n_channel), NaN where lost; what a loss adds as noise stands as a
    white floor, above which alone a line stands out."""
    from scipy import signal

    window = np.hanning(length + 1)[:-1]
    taper = signal.correlate(window, window)[length - 1:]
    # in single precision: a spectrum's own scatter is far larger
    pairs = _Pairs((data - np.nanmean(data, axis=0)).astype("f4"), 0, length - 1)
    some = pairs.references()
    covariance = pairs.products(some, some)[0] / pairs.by_channels(pairs.number, some, some)
    scale = np.sqrt(covariance[0].diagonal())
    covariance *= ((taper / taper[0])[:, None, None] / np.outer(scale, scale)).astype("f4")
    # lags to both sides, of which every second line of a transform of twice the length is taken
    covariance[1:] += covariance[:0:-1].transpose(0, 2, 1)
    density = fft.rfft(covariance, axis=0)
    lost = 1 - np.isfinite(data[:, some]).mean(axis=0)
    density[:, np.arange(len(some)), np.arange(len(some))] += lost / (1 - lost)
    return fft.rfftfreq(length, 1 / rate_hz), density
