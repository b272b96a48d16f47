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
from probupdate.modal.modes import CovarianceFactors

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
        scatter. `order_average` corrects that.
        """
        if self.observability_change is None:
            raise InputError("sub-records", "the record was identified without sub-records", "give sub_records, say 30")
        order = self.poles.order if order is None else order
        if order not in [one.order for one in self.by_order]:
            raise InputError("order", f"{order} was not identified", "choose one of by_order")
        return pole_factors(self.observability_change, self.factorisation, order=order, indices=indices)


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
