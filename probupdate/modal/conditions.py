"""Names of environmental and operational conditions, in scada.csv and in the environment of a modal set."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

COLUMNS = (
    "wind_speed_mps", "wind_direction_deg", "power_kw", "rotor_speed_rpm", "pitch_deg", "nacelle_heading_deg",
    "yaw_rate_degps", "water_level_m", "air_temperature_c", "wave_height_m", "wave_period_s",
)
# what only a turbine has
OF_TURBINES = ("power_kw", "rotor_speed_rpm", "pitch_deg", "nacelle_heading_deg", "yaw_rate_degps")
KNOWN_COLUMNS = tuple(f"{c}{ending}" for c in COLUMNS for ending in ("", "_std", "_min", "_max"))
# similarity of names from which one is a slip of the pen for the other, and from which it may be the same thing
MISSPELT, SIMILAR = 0.88, 0.6


def of_turbine(columns: Iterable[str]) -> bool:
    """Whether any is a turbine's, or a statistic of one."""
    return any(str(c).startswith(OF_TURBINES) for c in columns)


def find_misnamed(columns: Iterable[str], alike: float) -> dict[str, str]:
    """Known column that is absent -> a column that may be it, by its name alone. Of several that are as near, the
    first."""
    given = [str(c) for c in columns]
    # such as wind_speed_mps_p95: another statistic beside the mean
    others = [c for c in given if c not in KNOWN_COLUMNS and not c.startswith(tuple(f"{k}_" for k in COLUMNS))]
    plain = {c.strip().lower(): c for c in reversed(others)}
    found = {}
    for known in KNOWN_COLUMNS:
        if known in given:
            continue
        close = difflib.get_close_matches(known, list(plain), n=1, cutoff=alike)
        # nearest to this one of all known names
        if close and difflib.get_close_matches(close[0], KNOWN_COLUMNS, n=1, cutoff=alike) == [known]:
            found[known] = plain[close[0]]
    return found


def misspelt(columns: Iterable[str]) -> dict[str, str]:
    """Known column that is absent -> its slip of the pen. One that begins otherwise is another quantity, such as
    water_temperature_c."""
    close = find_misnamed(columns, MISSPELT)
    return {known: given for known, given in close.items() if given.strip().lower().startswith(known[0])}
