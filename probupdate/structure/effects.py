"""Effects as parameters of a turbine: what `kind` a [[parameter]] may be, and where in the structure it acts.

A parameter without `kind` is a row of Table 2 and acts everywhere. One with a kind acts where its table `on` says: on
members of a group, leg, face, bay, part or band of levels, on a body of the rotor-nacelle assembly, or on the whole. At
its kind's neutral value the structure is as described.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, Strict

from probupdate.structure.schema import Mistake, Number, Positive, Table, nearest

if TYPE_CHECKING:
    from probupdate.structure.description import Description

GROUPS = ("leg", "brace", "pile", "column", "strut", "tie", "tower")
WET_GROUPS = ("leg", "brace", "pile")
MEMBER_KEYS = ("group", "leg", "face", "bay", "part", "level_m")
LEVEL_TOLERANCE_M = 1e-6


class On(Table):
    """Where an effect acts; every key that is given narrows the choice.

    group; leg (a name; for joints the leg at the brace's end); face (its two legs, "AB"); bay (counted from the lowest,
    1); part ("brace AB-1", "tower"); level_m, the lower and upper end of a band; body of the rotor-nacelle assembly.
    """

    group: Literal["leg", "brace", "pile", "column", "strut", "tie", "tower"] | None = None
    leg: str | None = None
    face: str | None = None
    bay: Annotated[int, Strict(), Field(ge=1)] | None = None
    part: str | None = None
    level_m: tuple[Number, Number] | None = None
    body: str | None = None

    @property
    def given(self) -> tuple[str, ...]:
        return tuple(key for key in type(self).model_fields if getattr(self, key) is not None)


class EffectKeys(Table):
    """The keys that a [[parameter]] with a kind has beside those of every parameter."""

    kind: str | None = None
    on: On = On()
    motion: Literal["all", "axial", "bending", "in plane", "out of plane"] | None = None
    curve: Literal["all", "py", "tz", "qw"] | None = None
    at_m: Number | None = None
    axis: Literal["x", "y", "z"] | None = None
    relative_per_degc: Number | None = None
    inertia_per_kg_m2: tuple[Number, Number, Number] | None = None
    frequency_hz: Positive | None = None


SETTINGS = ("motion", "curve", "at_m", "axis", "relative_per_degc", "inertia_per_kg_m2", "frequency_hz")


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One way of acting. `lowest` is the least value that makes a structure (`above`: it must lie above it); `keys`
    are those of `on` that it knows, `needs` and `may` the settings it must and may have, `groups` what it acts on."""

    neutral: float
    unit: str
    lowest: float
    meaning: str
    above: bool = False
    keys: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    may: tuple[str, ...] = ()
    motions: tuple[str, ...] = ()


KINDS: Mapping[str, Kind] = MappingProxyType({
    "stiffness": Kind(
        neutral=1.0, unit="-", lowest=0.0, above=True, keys=MEMBER_KEYS, groups=GROUPS, may=("motion",),
        motions=("all", "axial", "bending"),
        meaning="factor on E and G of members; motion = \"axial\" or \"bending\" (with torsion) for one of them alone",
    ),
    "shear": Kind(
        neutral=0.0, unit="-", lowest=0.0, keys=MEMBER_KEYS, groups=GROUPS,
        meaning="share of the members' flexibility in shear that is counted beyond what mesh.theory does (1: all that "
                "Timoshenko's theory says, where mesh.theory is \"bernoulli-euler\")",
    ),
    "joint": Kind(
        neutral=1.0, unit="-", lowest=0.0, keys=("leg", "face", "bay", "part"), groups=("brace",), may=("motion",),
        motions=("all", "axial", "in plane", "out of plane"),
        meaning="factor on the stiffness of brace-to-leg joints, 0 for an end that is released",
    ),
    "hinge": Kind(
        neutral=0.0, unit="rad/(GN m)", lowest=0.0, keys=("group", "leg", "part"), groups=GROUPS, needs=("at_m",),
        meaning="flexibility in bending of a connection (flange, grout) at the level at_m of the members",
    ),
    "slip": Kind(
        neutral=0.0, unit="m/GN", lowest=0.0, keys=("group", "leg", "part"), groups=GROUPS, needs=("at_m",),
        meaning="flexibility along the members of a connection (grout) at the level at_m",
    ),
    "soil": Kind(
        neutral=1.0, unit="-", lowest=0.0, above=True, keys=("leg", "level_m"), groups=("pile",), needs=("curve",),
        meaning="factor on the stiffness of the soil's p-y, t-z or q-z springs, or of all",
    ),
    "scour": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, keys=("leg",), groups=("pile",),
        meaning="scour depth beyond the parameter sc",
    ),
    "growth": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, keys=MEMBER_KEYS, groups=WET_GROUPS,
        meaning="thickness of marine growth beyond the parameter mg, where growth is",
    ),
    "corrosion": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, keys=MEMBER_KEYS, groups=GROUPS,
        meaning="external wall loss beyond the parameter corr",
    ),
    "added_mass": Kind(
        neutral=1.0, unit="-", lowest=0.0, keys=MEMBER_KEYS, groups=WET_GROUPS,
        meaning="factor on the added mass of the surrounding water",
    ),
    "flooding": Kind(
        neutral=0.0, unit="-", lowest=-1.0, keys=MEMBER_KEYS, groups=("leg", "brace"),
        meaning="share of the submerged bore that holds water, beyond what the file says (-1: a flooded one is dry)",
    ),
    "mass": Kind(
        neutral=0.0, unit="kg", lowest=-np.inf, keys=(*MEMBER_KEYS, "body"), groups=GROUPS, may=("inertia_per_kg_m2",),
        meaning="mass added to a body, or evenly along members",
    ),
    "temperature": Kind(
        neutral=0.0, unit="degC", lowest=-np.inf, keys=MEMBER_KEYS, groups=GROUPS, needs=("relative_per_degc",),
        meaning="steel temperature above that of the file's E: factor 1 + relative_per_degc x value on E and G of "
                "members and joints",
    ),
    "centre_of_mass": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, keys=("body",), needs=("axis",),
        meaning="shift of a body's (without `on`: all bodies') centre of mass along the nacelle's axis",
    ),
    "inertia": Kind(
        neutral=0.0, unit="kg m2", lowest=-np.inf, keys=("body",), needs=("axis",),
        meaning="moment of inertia added to a body about the nacelle's axis",
    ),
    "oscillator": Kind(
        neutral=1e-4, unit="-", lowest=0.0, above=True, keys=("body",), needs=("axis", "frequency_hz"),
        meaning="share of a body's mass that swings by itself along the axis (blades); at the neutral value it is "
                "too light to be seen",
    ),
    "water_level": Kind(
        neutral=0.0, unit="m", lowest=-np.inf,
        meaning="rise of the water above site.water_level_m: length with added mass and flooding; growth stays",
    ),
    "weight": Kind(
        neutral=0.0, unit="-", lowest=-np.inf,
        meaning="share of the dry weight whose geometric stiffness is added to what mesh.geometric_stiffness says",
    ),
    "thrust": Kind(
        neutral=0.0, unit="N", lowest=-np.inf,
        meaning="mean rotor thrust along the nacelle's x axis at the hub: geometric stiffness of the member forces",
    ),
})  # fmt: skip


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
    """Either order of a face's two legs -> its name, in the order of the legs."""
    names = d.jacket.leg_names
    found = {}
    for first, second in zip(names, (*names[1:], names[0]), strict=True):
        found |= {first + second: first + second, second + first: first + second}
    return found


def bay_at(d: Description, z_m: float) -> int | None:
    """The number of the bay that reaches over a level, None between and beyond them."""
    return next((k for k, bay in enumerate(d.jacket.bay, 1) if bay.bottom_m < z_m < bay.top_m), None)


class Effects:
    """The effects of a description; remembers which of them have found a place."""

    def __init__(self, d: Description):
        self._faces = faces(d)
        self._entries = [p for p in d.parameter if p.kind is not None]
        # an element asks for a dozen kinds: a turbine with a hundred tolerances is meshed in half the time
        self._of: dict[str, list] = {}
        for p in self._entries:
            self._of.setdefault(p.kind, []).append(p)
        self._found: set[str] = set()

    def of(self, kind: str) -> list:
        """The parameters of a kind, as in the file."""
        return list(self._of.get(kind, ()))

    def at(self, kind: str, place: Place, **settings) -> tuple[str, ...]:
        """Names of the parameters of a kind that act at a place; settings narrow them, "all" fits any."""
        chosen = [p for p in self.of(kind) if all(self._answers(p, *item) for item in settings.items())]
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
        chosen = [p for p in self.of(kind)
                  if p.on.body == body or (p.on.body is None and kind == "centre_of_mass")]  # fmt: skip
        self._found.update(p.name for p in chosen)
        return chosen

    def on_all(self, kind: str) -> list:
        """The parameters of a kind that knows no place."""
        self._found.update(p.name for p in self.of(kind))
        return self.of(kind)

    def levels(self, group: str) -> tuple[float, ...]:
        """Where members of a group must have a node: ends of bands, connections."""
        levels = set()
        for p in self._entries:
            if group in KINDS[p.kind].groups and p.on.group in (None, group):
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


def check_effect(p, key: str, d: Description) -> Iterator[Mistake]:
    """What is wrong with a [[parameter]] that has a kind; `key` is its place in the file."""
    if p.kind not in KINDS:
        yield f"{key}.kind", f"'{p.kind}' is unknown", nearest(p.kind, KINDS)
        return
    kind = KINDS[p.kind]
    yield from _check_settings(p, key, kind)
    yield from _check_on(p.on, f"{key}.on", p.kind, d)
    if p.kind in ("mass", "inertia") and not p.on.given:
        yield f"{key}.on", "says nothing", "name a body" + (" or members" if p.kind == "mass" else "")
    if p.on.body is not None and set(p.on.given) != {"body"}:
        yield f"{key}.on", "names a body and members", "keep one of them"
    if p.inertia_per_kg_m2 is not None and p.on.body is None:
        yield f"{key}.inertia_per_kg_m2", "belongs to a body", "name one in `on`, or leave it out"
    if p.kind in ("hinge", "slip") and not {"group", "part"} & set(p.on.given):
        yield f"{key}.on", "does not say which members are joined", "name their group or part"
    if p.kind == "oscillator" and "body" not in p.on.given:
        yield f"{key}.on", "names no body", "say which body's mass swings"
    # one motion alone may vanish: the others still hold the member's nodes
    above = kind.above and p.motion != "axial"
    for name in ("lower", "initial") if p.update else ("initial",):
        value = getattr(p, name)
        if value < kind.lowest or (above and value == kind.lowest):
            word = "above" if above else "not below"
            yield f"{key}.{name}", f"{value} makes no structure: it must be {word} {kind.lowest:g}", "raise it"
    yield from _check_range(p, key, d)


def _check_settings(p, key: str, kind: Kind) -> Iterator[Mistake]:
    for name in SETTINGS:
        value = getattr(p, name)
        if value is None and name in kind.needs:
            yield f"{key}.{name}", f"is missing for the kind '{p.kind}'", "add it"
        elif value is not None and name not in (*kind.needs, *kind.may):
            yield f"{key}.{name}", f"means nothing for the kind '{p.kind}'", "remove it"
        elif name == "motion" and value is not None and value not in kind.motions:
            yield f"{key}.motion", f"'{value}' is not one of the kind '{p.kind}'", nearest(value, kind.motions)


def _check_on(on: On, key: str, name: str, d: Description) -> Iterator[Mistake]:
    kind = KINDS[name]
    for part in on.given:
        if part not in kind.keys:
            yield f"{key}.{part}", f"means nothing for the kind '{name}'", "remove it"
    if on.group is not None and on.group not in kind.groups:
        yield f"{key}.group", f"the kind '{name}' does not act on '{on.group}'", nearest(on.group, kind.groups)
    known = {"leg": d.jacket.leg_names, "face": faces(d), "body": [body.name for body in d.rna]}
    for part, names in known.items():
        value = getattr(on, part)
        if value is not None and value not in names:
            yield f"{key}.{part}", f"'{value}' is not in this structure", nearest(value, names)
    if on.bay is not None and on.bay > len(d.jacket.bay):
        yield f"{key}.bay", f"there is no bay {on.bay}", f"count from the lowest, 1 to {len(d.jacket.bay)}"
    if on.level_m is not None and not on.level_m[0] < on.level_m[1]:
        yield f"{key}.level_m", f"{on.level_m[0]} is not below {on.level_m[1]}", "give the lower end first"


def _check_range(p, key: str, d: Description) -> Iterator[Mistake]:
    """What the kind's range alone cannot tell."""
    low, high = ends(p)
    if p.kind == "water_level" and not np.all(np.isfinite((low, high))):
        yield f"{key}.upper", "the water's range is not bounded", "give lower and upper in m"
    if p.kind == "oscillator" and high >= 1:
        yield f"{key}.upper", f"{high} of the body's mass cannot swing", "stay below 1"
    if p.kind == "flooding" and high > 1:
        yield f"{key}.upper", f"{high} is more than a full bore", "stay below or at 1"
    bodies = [body for body in d.rna if body.name == p.on.body]
    if p.kind == "inertia" and bodies and p.axis is not None:
        own = bodies[0].inertia_kgm2["xyz".index(p.axis)]
        if low < -own:
            yield f"{key}.lower", f"{low} is more than the body's own {own:g} kg m2", "raise it"
    if p.kind == "mass" and bodies and low <= -bodies[0].mass_kg:
        yield f"{key}.lower", f"{low} is all of the body's {bodies[0].mass_kg:g} kg", "raise it"


def ends(p) -> tuple[float, float]:
    """The range of a parameter of the file: its bounds where it is updated, else its value twice."""
    return (p.lower, p.upper) if p.update else (p.initial, p.initial)


def check_sums(d: Description) -> Iterator[Mistake]:
    """Depths and thicknesses that several parameters make up: none may fall below zero or lay a pile's tip bare.

    Scour is added leg by leg; for growth and corrosion all that reduce them are taken as acting at one place.
    """
    rows = {p.name: ends(p) for p in d.parameter}
    scour = [p for p in d.parameter if p.kind == "scour"]
    for leg in d.jacket.leg_names if scour else ():
        low, high = (rows.get("sc", (0.0, 0.0))[k] + sum(ends(p)[k] for p in scour if p.on.leg in (None, leg))
                     for k in (0, 1))  # fmt: skip
        if low < 0 or high >= d.site.mudline_m - d.pile.tip_m:
            depth, problem = (low, "is none") if low < 0 else (high, "lays the pile tip bare")
            yield (f"parameter {scour[0].name}", f"with sc, scour of {depth:g} m at leg {leg} {problem}",
                   f"{'raise the lower' if low < 0 else 'lower the upper'} bounds")  # fmt: skip
            return
    for name, kind in (("mg", "growth"), ("corr", "corrosion")):
        effects = [p for p in d.parameter if p.kind == kind]
        low = rows.get(name, (0.0, 0.0))[0] + sum(min(ends(p)[0], 0.0) for p in effects)
        if effects and low < 0:
            yield (f"parameter {effects[0].name}.lower", f"{kind} and {name} at their least come to {low:g} m",
                   "raise the lower bounds")  # fmt: skip
