"""What the data say of each parameter: strongly or weakly identified, keeps its prior, or pinned at a bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.comparison import BOUND, KNOWN, PARTLY, PRIOR, identifiability
from probupdate.estimators.posterior_file import Posterior
from probupdate.estimators.update_file import UpdateRecord, misses

__all__ = ["BOUND", "KNOWN", "PARTLY", "PRIOR", "Standing", "contraction", "names_of", "standings"]


@dataclass(frozen=True, kw_only=True)
class Standing:
    """`kind` is one of the four; `words` say which bound; `width` is the posterior over the prior deviation."""

    name: str
    kind: str
    words: str
    width: float


def contraction(update: UpdateRecord, posterior: Posterior | None) -> np.ndarray:
    """Posterior over prior deviation (n_param,): of the draws over the prior as cut at its bounds, or, where nothing
    was sampled, of the Gaussian at the maximum, sqrt(1 - R_jj)."""
    if posterior is None:
        return np.sqrt(np.clip(1 - update.map_resolution, 0, None))
    prior = np.array([p.distribution.std() for p in update.parameters])
    return np.std(posterior.draws, axis=0, ddof=1) / prior


def standings(update: UpdateRecord, posterior: Posterior | None) -> tuple[Standing, ...]:
    """One for each parameter. A parameter whose most probable value is a bound is said to be there whatever its
    width: the bound, not the data, may be what makes its posterior narrow."""
    found = []
    for k, (p, width) in enumerate(zip(update.parameters, contraction(update, posterior), strict=True)):
        if update.map_at_bound[k]:
            low = abs(update.map_theta[k] - p.lower) <= abs(update.map_theta[k] - p.upper)
            kind, words = BOUND, f"at its {'lower' if low else 'upper'} bound"
        else:
            kind = words = identifiability(width, at_bound=False, misses=misses(update))
        found.append(Standing(name=p.name, kind=kind, words=words, width=float(width)))
    return tuple(found)


def names_of(found: tuple[Standing, ...], kind: str) -> list[str]:
    return [s.name for s in found if s.kind == kind]
