"""What is stated of gravity in the readings of accelerometers, and is wrong of all of them alike."""

from __future__ import annotations

from collections.abc import Sequence

from probupdate.effects.catalogue import Effect
from probupdate.structure.extend import EffectParameter

CAUSE = "gravity in the readings"
# a statement is right or wrong; what lies beyond is noise
SCALE, LARGEST_SIZE = 1.0, 1.5


def gravity_effects(channels: Sequence[tuple[str, bool]], taken: Sequence[str] = ()) -> tuple[Effect, ...]:
    """A row for the horizontal channels whose readings are stated to hold gravity, and one for those that are stated
    not to: (name, stated). Its parameter is called unlike those `taken`."""
    found: list[Effect] = []
    for held in (True, False):
        own = tuple(name for name, stated in channels if stated == held)
        if not own:
            continue
        where = "all horizontal channels" if len(own) == len(channels) else (
            f"horizontal channels that are stated {'with' if held else 'without'} it")
        name = "gravity_reversed" if not found else "gravity_reversed_2"
        while name in taken:
            name += "_"
        adds = EffectParameter(name=name, kind="sensor_gravity", settings={"channels": own}, std=SCALE, lower=0.0,
                               upper=LARGEST_SIZE, cause=CAUSE, location=where)
        stated = "it is stated to be in them and is not" if held else "it is stated to be taken out and is not"
        found.append(Effect(
            kind="measurement", cause=CAUSE, location=where, unit="-", tolerance=0.0, prior_scale=SCALE, lower=0.0,
            upper=LARGEST_SIZE, adds=adds, time_profiles=("constant",),
            signature=f"{stated}: horizontal channels differ by g/w^2 times the slope of the shape, near the foot "
                      "and in the lowest modes most",
            check=f"state gravity = {'false' if held else 'true'} of these sensors in campaign.toml, or of the "
                  "channels in modes.json"))
    return tuple(found)
