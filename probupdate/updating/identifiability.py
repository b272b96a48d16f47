"""What the data say of a parameter, in one scale for every command: strongly or weakly identified, prior, bound.

The scale is of a width, the posterior's standard deviation over the prior's, and there are two: `gaussian_width` by the
Gaussian approximation at the MAP, all that an update has, and `sampled_width` by the draws of the posterior. They
differ where the posterior is skewed or cut by bounds: whoever states a kind states by which width.
"""

from __future__ import annotations

import numpy as np

from probupdate.model.parameters import Parameter, Parameters
from probupdate.updating.settings import CONSTANTS

STRONG, BLIND = CONSTANTS.strong, CONSTANTS.blind
KNOWN, PARTLY, PRIOR, BOUND = "strongly identified", "weakly identified", "keeps its prior", "at a bound"
# of a parameter whose prior is the size that a diagnosis found by a change within the record; the model's file says so
# in its description
DIAGNOSED = "known from the diagnosis"


def gaussian_width(covariance: np.ndarray, parameters: Parameters) -> np.ndarray:
    """(n_param,) standard deviation of the Gaussian approximation over the prior's, both as if there were no bounds."""
    flat = np.array([p.prior == "uniform" for p in parameters], bool)
    width = np.sqrt(np.diag(covariance)) / parameters.std
    return np.where(flat, np.minimum(width, 1.0), width)


def cov_of(mean: float, std: float, parameter: Parameter) -> float:
    """Coefficient of variation; NaN of what may be zero, as a change about zero, where it would be over next to
    nothing: zero within two standard deviations, and expected there or allowed below."""
    about_zero = parameter.lower < 0 or parameter.initial == 0
    near = parameter.prior != "lognormal" and about_zero and abs(mean) < 2 * std
    return float("nan") if near or mean == 0 else std / abs(mean)


def sampled_width(draws: np.ndarray, parameters: Parameters) -> np.ndarray:
    """(n_param,) standard deviation of the draws (n_draw, n_param) over the joint prior's, both within all bounds."""
    return np.std(draws, axis=0, ddof=1) / parameters.moments[1]


def identifiability(width: float, *, at_bound: bool, unproven: bool, description: str = "") -> str:
    """What the data say of a parameter, by its posterior's standard deviation over its prior's.

    One at a bound is said to be there whatever its width: the bound, not the data, may be what makes it narrow. Where
    the fit says nothing for the parameters (`update_file.unproven`), no width proves that one is known.
    """
    if at_bound:
        return BOUND
    if width < STRONG:
        return PARTLY if unproven else KNOWN
    if width <= BLIND:
        return PARTLY
    return DIAGNOSED if DIAGNOSED in description else PRIOR


def is_too_narrow(std: np.ndarray, source_std: np.ndarray, approximate_std: np.ndarray, theta: np.ndarray,
                  parameters: Parameters) -> np.ndarray:
    """(n_param,) bool: draws with a smaller standard deviation than the stated error sources alone give the estimate,
    source_std (n_source, n_param), where no bound is within two of `approximate_std` of the maximum. A source's effect
    is linear about the maximum; where responses bend, what it could be mistaken for is no longer the same."""
    cut = (theta - 2 * approximate_std < parameters.lower) | (theta + 2 * approximate_std > parameters.upper)
    return (std < np.sqrt(np.sum(np.square(source_std), axis=0))) & ~cut


def too_narrow_sentence(name: str, std: float, source_std: float, approximate_std: float) -> str:
    return (f"TOO NARROW: the draws of {name} scatter by {std:.2g}, though the model's stated tolerances alone leave "
            f"{source_std:.2g} open: they count as linear about the MAP, where responses bend; take the "
            f"{approximate_std:.2g} of the Gaussian approximation, as `update` has it")
