"""What is stated of gravity in the readings of accelerometers, and is wrong of all of them alike, or of one sensor."""

from __future__ import annotations

from collections.abc import Sequence

from probupdate.effects.catalogue import Effect, positions
from probupdate.modal.modes import Sensor
from probupdate.structure.extend import EffectParameter

# the locations of rows of more than one sensor hold these words
CAUSE, ALL = "gravity in the readings", "horizontal channels"
# a statement is right or wrong; what lies beyond is noise
SCALE, LARGEST_SIZE = 1.0, 1.5


def gravity_effects(
    channels: Sequence[tuple[str, bool]], sensors: Sequence[Sensor] = (), taken: Sequence[str] = ()
) -> tuple[Effect, ...]:
    """A row for the horizontal channels whose readings are stated to hold gravity, and one for those that are stated
    not to: (name, stated); then one for each of several places of `sensors`. Parameters are called unlike those
    `taken`."""
    found: list[tuple[tuple[str, ...], bool, str]] = []
    for held in (True, False):
        own = tuple(name for name, stated in channels if stated == held)
        where = f"all {ALL}" if len(own) == len(channels) else (
            f"{ALL} that are stated {'with' if held else 'without'} it")
        found += [(own, held, where)] if own else []
    for own, held, _ in tuple(found):
        places = positions([s for s in sensors if s.channel in own], {c: k for k, c in enumerate(own)})
        found += [(tuple(s.channel for s in there), held, name) for name, _, there in places if len(places) > 1]
    names: list[str] = []
    for k in range(1, len(found) + 1):
        name = "gravity_reversed" if k == 1 else f"gravity_reversed_{k}"
        while name in taken:
            name += "_"
        names.append(name)
    return tuple(_row(name, *row) for name, row in zip(names, found, strict=True))


def _row(name: str, channels: tuple[str, ...], held: bool, where: str) -> Effect:
    adds = EffectParameter(name=name, kind="sensor_gravity", settings={"channels": channels}, std=SCALE, lower=0.0,
                           upper=LARGEST_SIZE, cause=CAUSE, location=where)
    stated = "it is stated to be in them and is not" if held else "it is stated to be taken out and is not"
    return Effect(
        kind="measurement", cause=CAUSE, location=where, unit="-", tolerance=0.0, prior_scale=SCALE, lower=0.0,
        upper=LARGEST_SIZE, adds=adds, time_profiles=("constant",),
        signature=f"{stated}: horizontal channels differ by g/w^2 times the slope of the shape, near the foot and in "
                  "the lowest modes most",
        check=f"state gravity = {'false' if held else 'true'} of these sensors in campaign.toml, or of the channels in "
              "modes.json")
