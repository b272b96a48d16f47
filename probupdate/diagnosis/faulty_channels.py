"""Which channels of a campaign a diagnosis found to be measured wrongly."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from probupdate.diagnosis.proposals import crosstalk_effects
from probupdate.diagnosis.wording import channel_response_parts, finding_words, name_of
from probupdate.effects.catalogue import measurement_effects
from probupdate.modal.modes import Sensor


def faulty_channels(
    content: Mapping, sensors: Sequence[Sensor], others: Sequence[str] = ()
) -> dict[str, tuple[str, ...]]:
    """Of a diagnosis.json each finding on the measurement, in words -> the channels, of these sensors, that it is
    about: those of the catalogue's row at this place, else those that the place names; all where it names none.
    others: channels that the diagnosis had and that may be missing here."""
    names = tuple(s.channel for s in sensors)
    rows = (*measurement_effects(names, sensors), *crosstalk_effects(names))
    at = {e.location: tuple(names[k] for k in e.channels_changed) for e in rows}
    found = {}
    for f in content.get("findings", ()):
        if f["kind"] == "measurement":
            found[finding_words(f, content)] = _channels_at(f["location"], at, names, others)
    for part in channel_response_parts(content):
        found[name_of(part)] = tuple(c for c in names if c in part["channels"])
    return {words: channels for words, channels in found.items() if channels}


def _channels_at(
    place: str, at: Mapping[str, tuple[str, ...]], names: tuple[str, ...], others: Sequence[str]
) -> tuple[str, ...]:
    if at.get(place):
        return at[place]
    named = [c for c in dict.fromkeys((*names, *others)) if re.search(rf"(?<![\w-]){re.escape(c)}(?![\w-])", place)]
    return tuple(c for c in names if c in named) if named else names
