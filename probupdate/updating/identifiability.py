"""What the data say of a parameter, in one scale for every command: strongly or weakly identified, prior, bound."""

from __future__ import annotations

from probupdate.updating.settings import CONSTANTS

STRONG, BLIND = CONSTANTS.strong, CONSTANTS.blind
KNOWN, PARTLY, PRIOR, BOUND = "strongly identified", "weakly identified", "keeps its prior", "at a bound"


def identifiability(contraction: float, *, at_bound: bool, misses: bool) -> str:
    """What the data say of a parameter, by its posterior's standard deviation over its prior's.

    One at a bound is said to be there whatever its width: the bound, not the data, may be what makes it narrow. Where
    the model misses the data beyond what is stated (`update_file.misses`), no width proves that a parameter is known.
    """
    if at_bound:
        return BOUND
    if contraction < STRONG:
        return PARTLY if misses else KNOWN
    return PARTLY if contraction <= BLIND else PRIOR
