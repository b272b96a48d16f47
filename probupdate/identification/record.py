"""One record: its poles of every order, and the standard deviations of those that are asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from probupdate.errors import InputError
from probupdate.identification.ssi import (
    Factorisation,
    Poles,
    check_record,
    factorise,
    output_covariances,
    poles,
    reference_projection,
    stability,
)
from probupdate.identification.uncertainty import (
    ObservabilityChange,
    observability_change,
    pole_factors,
    sub_record_covariances,
)
from probupdate.modal.modes import CovarianceFactors, mac, unit_largest
from probupdate.runtime.arrays import frozen_array

# what the identification of one record may take in memory, and how few combinations of channels are still worth it
MEMORY_BYTES, FEWEST_REFERENCES = 2**30, 4
# lags by which combinations are chosen where all of them would not fit
CHOSEN_LAGS = 12


def memory_bytes(n_channel: int, n_reference: int, *, block_rows: int, highest_order: int, sub_records: int) -> float:
    """About what identify_record takes, within a fifth (60 to 500 channels were measured): covariances of the parts and
    their spectra, the Toeplitz matrix with its square, changes of the singular vectors."""
    covariances = 8.0 * n_channel * n_reference * (10 * block_rows * max(sub_records, 1) + 3.5 * block_rows**2)
    return covariances + 32.0 * highest_order * n_channel * block_rows * sub_records


def references_within(
    n_channel: int, *, block_rows: int, highest_order: int, sub_records: int, budget: float = MEMORY_BYTES
) -> int | None:
    """How many combinations of channels to take the past of, so that a record fits in memory; None where all do.

    Raises InputError with the bytes that would be needed where even a few do not fit.
    """
    options = {"block_rows": block_rows, "highest_order": highest_order, "sub_records": sub_records}
    whole = memory_bytes(n_channel, n_channel, **options)
    if whole <= budget:
        return None
    fixed, one = memory_bytes(n_channel, 0, **options), memory_bytes(n_channel, 1, **options)
    found = int((budget - fixed) / (one - fixed))
    if found < max(FEWEST_REFERENCES, -(-highest_order // block_rows)):
        least = memory_bytes(n_channel, FEWEST_REFERENCES, **options)
        raise InputError("record", f"{n_channel} channels with {block_rows} block rows and {sub_records} parts would "
                         f"take {least / 2**30:.2g} GB of memory with {FEWEST_REFERENCES} references, "
                         f"{whole / 2**30:.2g} GB with all, and {budget / 2**30:.2g} GB are allowed", "leave channels "
                         "out (leave_out in campaign.toml), or lower --block-rows")
    return found


def _lagged_projection(data: np.ndarray, n_lag: int, references: int) -> np.ndarray:
    """`reference_projection` by a few lags, one in memory at a time: (n_channel, n_reference)."""
    past = np.zeros((data.shape[1],) * 2)
    for lag in np.unique(np.linspace(1, n_lag, CHOSEN_LAGS).astype(int)):
        covariance = data[lag:].T @ data[:-lag] / (len(data) - lag)
        past += covariance.T @ covariance
    return linalg.eigh(past, subset_by_index=[len(past) - references, len(past) - 1])[1][:, ::-1]


@dataclass(frozen=True, eq=False, kw_only=True)
class CertainPoles:
    """Of each mode the pole of one order: order, index (n_mode,) say which, -1 for a mode that is absent.

    frequency_hz, damping_ratio (n_mode,), shape (n_channel, n_mode) scaled by `modes.unit_largest`; NaN where absent.
    covariance_factors: of all of them together, so that covariances between modes hold across orders.
    """

    order: np.ndarray
    index: np.ndarray
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    covariance_factors: CovarianceFactors


@dataclass(frozen=True, eq=False, kw_only=True)
class IdentifiedRecord:
    """poles: those of the chosen order; stability (n_pole,): the share of the orders around it in which each comes
    back; by_order: the poles of every order, ascending, the chosen one among them.

    observability_change: what covariance factors are made of; None for a record identified without sub-records.
    """

    poles: Poles
    stability: np.ndarray
    by_order: tuple[Poles, ...]
    factorisation: Factorisation
    observability_change: ObservabilityChange | None

    def factors(self, indices: np.ndarray, order: int | None = None) -> CovarianceFactors:
        """Covariance factors of the poles `indices` of the chosen order, or of another of `by_order`; one column a
        sub-record.

        indices (n_mode,); -1 gives NaN, so that the poles taken for modes, some of them absent, can be asked for as
        they are. Shapes are scaled by `modes.unit_largest`. All are NaN where the order parts equal singular values.
        First order: an order above what the record holds leaves little between singular values, or puts a pole of the
        noise beside that of a mode; standard deviations of such blocks come out large, and larger than the poles
        scatter.
        """
        if self.observability_change is None:
            raise InputError("sub-records", "the record was identified without sub-records", "give sub_records, say 30")
        order = self.poles.order if order is None else order
        if order not in [one.order for one in self.by_order]:
            raise InputError("order", f"{order} was not identified", "choose one of by_order")
        return pole_factors(self.observability_change, self.factorisation, order=order, indices=indices)

    def most_certain(
        self, indices: np.ndarray, *, lowest: int = 2, frequency: float = 0.01, least_mac: float = 0.90
    ) -> CertainPoles:
        """Of each of the chosen order's poles `indices` (n_mode,), -1 for none, the twin with the least standard
        deviation.

        Twins are poles of the orders from `lowest`, frequency within `frequency` and MAC of at least `least_mac`, that
        are no better a twin of another of the poles asked for. The least is that of |d lambda / lambda|, frequency and
        damping together. An order too high for the record lets poles of the noise come close to that of a mode and
        pull at it; in another order they lie elsewhere.
        """
        indices = np.asarray(indices)
        best = self.factors(indices)
        ln_frequency, damping, shape = (np.array(a) for a in (best.ln_frequency, best.damping_ratio, best.shape))
        at_order, at_index = np.where(indices >= 0, self.poles.order, -1), indices.copy()
        there = np.flatnonzero(indices >= 0)
        start_f, start_shape = self.poles.frequency_hz[indices[there]], self.poles.shape[:, indices[there]]
        least = np.nan_to_num(_size(best)[there], nan=np.inf)
        for one in self.by_order:
            if one.order < lowest or one is self.poles or len(one.frequency_hz) == 0 or there.size == 0:
                continue
            comparison = mac(start_shape, one.shape)
            comparison[(np.abs(one.frequency_hz / start_f[:, None] - 1) > frequency) | (comparison < least_mac)] = 0
            twin = np.argmax(comparison, axis=1)
            mutual = (np.argmax(comparison, axis=0)[twin] == np.arange(len(twin))) & (comparison.max(axis=1) > 0)
            if not mutual.any():
                continue
            found = self.factors(np.where(mutual, twin, -1), one.order)
            size = np.nan_to_num(_size(found), nan=np.inf)
            better = size < least
            least[better] = size[better]
            mode = there[better]
            at_order[mode], at_index[mode] = one.order, twin[better]
            ln_frequency[mode], damping[mode] = found.ln_frequency[better], found.damping_ratio[better]
            shape[:, mode] = found.shape[:, better]
        return self._gathered(at_order, at_index, CovarianceFactors(
            ln_frequency=ln_frequency, damping_ratio=damping, shape=shape))

    def _gathered(self, order: np.ndarray, index: np.ndarray, covariance_factors: CovarianceFactors) -> CertainPoles:
        of_order = {one.order: one for one in self.by_order}
        n_channel, n_mode = len(self.poles.shape), len(order)
        frequency, damping = np.full(n_mode, np.nan), np.full(n_mode, np.nan)
        shape = np.full((n_channel, n_mode), np.nan + 0j)
        for mode in np.flatnonzero(index >= 0):
            one, k = of_order[order[mode]], index[mode]
            frequency[mode], damping[mode] = one.frequency_hz[k], one.damping_ratio[k]
            shape[:, mode] = unit_largest(one.shape[:, [k]])[:, 0]
        return CertainPoles(
            order=frozen_array(order, int), index=frozen_array(index, int), frequency_hz=frozen_array(frequency),
            damping_ratio=frozen_array(damping), shape=frozen_array(shape, complex),
                            covariance_factors=covariance_factors)


def _size(covariance_factors: CovarianceFactors) -> np.ndarray:
    """(n_mode,) standard deviation of |lambda| and damping together."""
    return np.sqrt(np.sum(covariance_factors.ln_frequency**2 + covariance_factors.damping_ratio**2, axis=1))


def identify_record(
    data: np.ndarray, rate_hz: float, *, order: int, block_rows: int, spread: int = 0, sub_records: int = 0,
    references: int | tuple[int, ...] | None = None, limited: int | None = None,
    orders: tuple[int, ...] | None = None,
) -> IdentifiedRecord:
    """SSI-cov of one record (n_sample, n_channel), its mean taken out before.

    Poles at every second order from 2 or 3 to order + spread, as far as block rows allow; stability over those up to
    `spread` below and above `order` (1 without). sub_records: parts of the record whose scatter gives standard
    deviations, 0 for none; their standard deviations are known to 1 / sqrt(2 (sub_records - 1)), 13 % for 30.
    references: channels whose past is used, or how many combinations of channels (`ssi.reference_projection`); without,
    all. limited: such a number that memory asked for (`references_within`): combinations are chosen without the
    covariances of all channels. orders: only these model orders, `order` among them; lower ones are the same whatever
    the highest is.
    """
    data = np.asarray(data, dtype=float)
    n_lag = 2 * block_rows - 1
    check_record(data, n_lag)
    covariance, projection, scatter = None, None, None
    if limited is not None:
        projection = _lagged_projection(data - data.mean(axis=0), n_lag, limited)
        covariance = None if sub_records else output_covariances(data, n_lag, projection=projection)
    elif references is not None:
        covariance = output_covariances(data, n_lag)
        projection = reference_projection(covariance, references)
        covariance = covariance @ projection
    if sub_records:
        covariance, scatter = sub_record_covariances(data, n_lag, sub_records, projection)
    elif covariance is None:
        covariance = output_covariances(data, n_lag)
    return identify_covariances(covariance, scatter, rate_hz, order=order, block_rows=block_rows, spread=spread,
                                orders=orders)


def identify_covariances(
    covariance: np.ndarray, changes: np.ndarray | None, rate_hz: float, *, order: int, block_rows: int,
    spread: int = 0, orders: tuple[int, ...] | None = None,
) -> IdentifiedRecord:
    """The same from output covariances (2 block_rows, n_channel, n_reference) and their changes by sub-records
    (`uncertainty.sub_record_covariances`), None for none."""
    n_channel, n_reference = covariance.shape[1:]
    highest = max(order, min(order + spread, n_channel * (block_rows - 1), n_reference * block_rows))
    asked = tuple(range(2 + order % 2, highest + 1, 2)) if orders is None else tuple(sorted(orders))
    factorisation = factorise(covariance, block_rows, max(asked), rate_hz, whole=changes is not None)
    by_order = poles(factorisation, asked)
    chosen = next(one for one in by_order if one.order == order)
    around = tuple(one for one in by_order if one is not chosen and abs(one.order - order) <= spread)
    return IdentifiedRecord(
        poles=chosen, by_order=by_order, factorisation=factorisation,
        stability=stability(chosen, around) if around else np.ones(len(chosen.frequency_hz)),
        observability_change=None if changes is None else observability_change(
            covariance, changes, factorisation, block_rows),
    )
