"""What the data say of each parameter: strongly or weakly identified, keeps its prior, or pinned at a bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from probupdate.updating.identifiability import (
    BOUND,
    DIAGNOSED,
    KNOWN,
    PARTLY,
    PRIOR,
    gaussian_width,
    identifiability,
    sampled_width,
)
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.update_file import UpdateRecord, is_unproven

__all__ = ["BOUND", "DIAGNOSED", "KNOWN", "PARTLY", "PRIOR", "Estimate", "Identifiability", "contraction", "estimate",
           "names_of", "identifiabilities"]


@dataclass(frozen=True, kw_only=True)
class Identifiability:
    """`kind` is one of the five; `words` say which bound; `width` is the posterior over the prior standard deviation;
    `shift` the value after the update as a standardised shift from the prior: the standard normal quantile of its
    prior probability."""

    name: str
    kind: str
    words: str
    width: float
    shift: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate:
    """The one estimate that stands as "after" all over the page: median of the posterior, with its own 5 and 95 %
    quantiles, or where nothing was sampled the most probable parameters (MAP), without. theta, low, high (n_param,);
    frequency_hz (n_mode,) in the order of the update's labels."""

    name: str
    theta: np.ndarray
    frequency_hz: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None


def estimate(update: UpdateRecord, posterior: Posterior | None) -> Estimate:
    if posterior is None:
        return Estimate(name="MAP", theta=update.map_theta, frequency_hz=update.map_hz)
    low, middle, high = np.percentile(posterior.draws, [5, 50, 95], axis=0)
    predicted = dict(zip(posterior.mode_labels, np.median(posterior.frequency_hz, axis=0), strict=False))
    hz = np.array([predicted.get(label, np.nan) for label in update.labels], float)
    # a posterior written without its predictions says nothing of frequencies
    known = np.isfinite(hz).any()
    return Estimate(name="posterior median", theta=middle, frequency_hz=hz if known else update.map_hz, low=low,
                    high=high)


def contraction(update: UpdateRecord, posterior: Posterior | None) -> np.ndarray:
    """Posterior over prior standard deviation (n_param,): of the draws over the prior as cut at its bounds, or, where
    nothing was sampled, of the Gaussian at the maximum."""
    if posterior is None:
        return gaussian_width(update.map_covariance, update.parameters)
    return sampled_width(posterior.draws, update.parameters)


def identifiabilities(update: UpdateRecord, posterior: Posterior | None) -> tuple[Identifiability, ...]:
    """One for each parameter. A parameter whose most probable value is a bound is said to be there whatever its
    width: the bound, not the data, may be what makes its posterior narrow."""
    found, after = [], estimate(update, posterior).theta
    for k, (p, width) in enumerate(zip(update.parameters, contraction(update, posterior), strict=True)):
        if update.map_at_bound[k]:
            low = abs(update.map_theta[k] - p.lower) <= abs(update.map_theta[k] - p.upper)
            kind, words = BOUND, f"at its {'lower' if low else 'upper'} bound"
        else:
            kind = words = identifiability(width, at_bound=False, unproven=is_unproven(update),
                                           description=p.description)
        found.append(Identifiability(name=p.name, kind=kind, words=words, width=float(width),
                                     shift=float(stats.norm.ppf(np.clip(p.distribution.cdf(after[k]), 1e-12,
                                                                        1 - 1e-12)))))
    return tuple(found)


def names_of(found: tuple[Identifiability, ...], kind: str) -> list[str]:
    return [s.name for s in found if s.kind == kind]
