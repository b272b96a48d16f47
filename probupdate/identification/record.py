"""One record: its poles of every order, and the deviations of those that are asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    ObservabilityDeviation,
    observability_deviation,
    pole_deviations,
    sub_record_covariances,
)
from probupdate.modes import ModalDeviation


@dataclass(frozen=True, eq=False, kw_only=True)
class IdentifiedRecord:
    """poles: those of the chosen order; stability (n_pole,): the share of the orders around it in which each comes
    back; by_order: the poles of every order, ascending, the chosen one among them.

    observability_deviation: what deviations are made of; None for a record identified without sub-records.
    """

    poles: Poles
    stability: np.ndarray
    by_order: tuple[Poles, ...]
    factorisation: Factorisation
    observability_deviation: ObservabilityDeviation | None

    def deviations(self, indices: np.ndarray, order: int | None = None) -> ModalDeviation:
        """Deviations of the poles `indices` of the chosen order, or of another of `by_order`; one column a sub-record.

        indices (n_mode,); -1 gives NaN, so that the poles taken for modes, some of them absent, can be asked for as
        they are. Shapes are scaled by `modes.unit_largest`. All are NaN where the order parts equal singular values.
        First order: an order above what the record holds leaves little between singular values, or puts a pole of the
        noise beside that of a mode; deviations of such blocks come out large, and larger than the poles scatter.
        """
        if self.observability_deviation is None:
            raise InputError("deviations", "the record was identified without sub-records", "give sub_records, say 30")
        order = self.poles.order if order is None else order
        if order not in [one.order for one in self.by_order]:
            raise InputError("order", f"{order} was not identified", "choose one of by_order")
        return pole_deviations(self.observability_deviation, self.factorisation, order=order, indices=indices)


def identify_record(
    data: np.ndarray, rate_hz: float, *, order: int, block_rows: int, spread: int = 0, sub_records: int = 0,
    references: int | tuple[int, ...] | None = None,
) -> IdentifiedRecord:
    """SSI-cov of one record (n_sample, n_channel), its mean taken out before.

    Poles at every second order from 2 or 3 to order + spread, as far as block rows allow; stability over those up to
    `spread` below and above `order` (1 without). sub_records: parts of the record whose scatter gives deviations, 0 for
    none; their deviations are known to 1 / sqrt(2 (sub_records - 1)), 13 % for 30. references: channels whose past is
    used, or how many combinations of channels (`ssi.reference_projection`); without, all.
    """
    data = np.asarray(data, dtype=float)
    n_lag = 2 * block_rows - 1
    check_record(data, n_lag)
    covariance, projection, scatter = None, None, None
    if references is not None:
        covariance = output_covariances(data, n_lag)
        projection = reference_projection(covariance, references)
        covariance = covariance @ projection
    if sub_records:
        covariance, scatter = sub_record_covariances(data, n_lag, sub_records, projection)
    elif covariance is None:
        covariance = output_covariances(data, n_lag)
    n_channel, n_reference = covariance.shape[1:]
    highest = max(order, min(order + spread, n_channel * (block_rows - 1), n_reference * block_rows))
    factorisation = factorise(covariance, block_rows, highest, rate_hz)
    by_order = poles(factorisation, tuple(range(2 + order % 2, highest + 1, 2)))
    chosen = next(one for one in by_order if one.order == order)
    around = tuple(one for one in by_order if one is not chosen and abs(one.order - order) <= spread)
    return IdentifiedRecord(
        poles=chosen, by_order=by_order, factorisation=factorisation,
        stability=stability(chosen, around) if around else np.ones(len(chosen.frequency_hz)),
        observability_deviation=None if scatter is None else observability_deviation(
            covariance, scatter, factorisation, block_rows),
    )
