"""Where the effects of a description act: places of the structure, and the parameters with a kind that reach them."""

from __future__ import annotations

from dataclasses import dataclass

from probupdate.structure.description import Description, JacketTurbine
from probupdate.structure.effect_kinds import KINDS

# a node stands at the level of a connection within this
LEVEL_TOLERANCE_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where an element, joint or spring is: group, part, leg (None for braces' members), face, bay, z of its middle."""

    group: str
    part: str
    z_m: float
    leg: str | None = None
    face: str | None = None
    bay: int | None = None


def faces(d: Description) -> dict[str, str]:
    """Either order of a face's two legs -> its name, in the order of the legs; of a jacket only."""
    found: dict[str, str] = {}
    if not isinstance(d, JacketTurbine):
        return found
    for name, (first, second) in d.jacket.faces.items():
        found |= {name: name, d.jacket.face_between(second, first): name}
    return found


def bay_at(d: Description, z_m: float) -> int | None:
    """The number of the bay that reaches over a level, None between and beyond them."""
    bays = d.jacket.bay if isinstance(d, JacketTurbine) else ()
    return next((k for k, bay in enumerate(bays, 1) if bay.bottom_m < z_m < bay.top_m), None)


class Effects:
    """The effects of a description; remembers which of them have found a place."""

    def __init__(self, d: Description):
        self._faces = faces(d)
        self._entries = [p for p in d.parameter if p.kind is not None]
        # an element asks for a dozen kinds: a turbine with a hundred tolerances is meshed in half the time
        self._of: dict[str | None, list] = {}
        for p in self._entries:
            self._of.setdefault(p.kind, []).append(p)
        self._found: set[str] = set()

    def of_kind(self, kind: str) -> list:
        """The parameters of a kind, as in the file."""
        return list(self._of.get(kind, ()))

    def names_at(self, kind: str, place: Place, **settings) -> tuple[str, ...]:
        """Names of the parameters of a kind that act at a place; settings narrow them, "all" fits any."""
        chosen = [p for p in self.of_kind(kind) if all(self._answers(p, *item) for item in settings.items())]
        return tuple(p.name for p in chosen if self.acts(p, place))

    def acts(self, p, place: Place) -> bool:
        """Whether a parameter acts at a place, which then is noted."""
        if self.fits(p, place):
            self.note(p)
            return True
        return False

    def note(self, p) -> None:
        self._found.add(p.name)

    def fits(self, p, place: Place) -> bool:
        on = p.on
        if place.group not in KINDS[p.kind].groups or (on.face is not None and self._faces[on.face] != place.face):
            return False
        if on.level_m is not None and not on.level_m[0] < place.z_m < on.level_m[1]:
            return False
        wanted = [key for key in ("group", "leg", "bay", "part") if getattr(on, key) is not None]
        return all(getattr(on, key) == getattr(place, key) for key in wanted)

    def on_body(self, kind: str, body: str) -> list:
        """The parameters of a kind that act on a body: those that name it, and those of a whole assembly."""
        chosen = [p for p in self.of_kind(kind)
                  if p.on.body == body or (p.on.body is None and kind == "centre_of_mass")]
        self._found.update(p.name for p in chosen)
        return chosen

    def on_all(self, kind: str) -> list:
        """The parameters of a kind that knows no place."""
        self._found.update(p.name for p in self.of_kind(kind))
        return self.of_kind(kind)

    def levels(self, group: str) -> tuple[float, ...]:
        """Where members of a group must have a node: ends of bands, connections."""
        levels = set()
        for p in self._entries:
            if group in KINDS[str(p.kind)].groups and p.on.group in (None, group):
                levels.update(p.on.level_m or ())
                levels.update(() if p.at_m is None else (p.at_m,))
        return tuple(sorted(levels))

    def lost(self) -> list:
        """Parameters that act nowhere."""
        return [p for p in self._entries if p.name not in self._found]

    @staticmethod
    def _answers(p, key: str, value) -> bool:
        own = getattr(p, key)
        return own == value or own == "all" or (key == "motion" and own is None)


def ends(p) -> tuple[float, float]:
    """The range of a parameter of the file: its bounds where it is updated, else its value twice."""
    return (p.lower, p.upper) if p.update else (p.initial, p.initial)
