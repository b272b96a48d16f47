"""What is wrong with a description although each of its values may stand: levels, walls, names, bounds, effects."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from probupdate.structure.description import (
    ALL_NEUTRAL,
    POSITIVE,
    Description,
    FoundationTurbine,
    JacketTurbine,
    MonopileTurbine,
    Offshore,
    ParameterEntry,
    Section,
    Sleeve,
    TubeEntry,
)
from probupdate.structure.effect_kinds import KINDS, SETTINGS, Kind, Place
from probupdate.structure.effects import ends, faces
from probupdate.structure.schema import RANGES, Mistake, suggest


def tubes_of(d: Description) -> Iterator[tuple[str, float, float]]:
    """Key, diameter and wall of every tube."""
    if isinstance(d, JacketTurbine):
        yield "jacket.leg", d.jacket.leg.diameter_m, d.jacket.leg.thickness_m
        for k, bay in enumerate(d.jacket.bay):
            yield f"jacket.bay[{k + 1}].brace", bay.brace.diameter_m, bay.brace.thickness_m
        yield "pile", d.pile.diameter_m, d.pile.thickness_m
        for name in ("column", "strut", "tie"):
            tube = getattr(d.transition_piece, name)
            yield f"transition_piece.{name}", tube.diameter_m, tube.thickness_m
    if isinstance(d, MonopileTurbine):
        for k, section in enumerate(d.monopile.station):
            yield f"monopile.station[{k + 1}]", section.diameter_m, section.thickness_m
        if d.transition_piece is not None:
            yield "transition_piece.tube", d.transition_piece.tube.diameter_m, d.transition_piece.tube.thickness_m
    for k, station in enumerate(d.tower.station):
        yield f"tower.station[{k + 1}]", station.diameter_m, station.thickness_m


def _check_walls(d: Description) -> Iterator[Mistake]:
    for key, diameter, wall in tubes_of(d):
        if wall >= diameter / 2:
            yield (f"{key}.thickness_m", f"{wall} m does not fit into a tube of {diameter} m (at most half of it)",
                   "check the unit: metres")


# undrained shear strength, Pa, ten metres down: below it no clay stands, above it is rock; at the mudline, where a
# profile may begin at 0
LEAST_STRENGTH_PA, MOST_STRENGTH_PA, LEAST_AT_MUDLINE_PA = 1000.0, 1e6, 200.0
# tube, grout and pile of a connection fit into one another within this, m
GAP_M = 0.02


def _numbers(table: object, key: str = "", name: str = "") -> Iterator[tuple[str, str, float]]:
    """Key as messages count it, key without numbers, and value of all numbers in nested tables and lists."""
    if isinstance(table, dict):
        for own, value in table.items():
            yield from _numbers(value, f"{key}.{own}".removeprefix("."), f"{name}.{own}".removeprefix("."))
    elif isinstance(table, tuple | list):
        for k, value in enumerate(table):
            yield from _numbers(value, f"{key}[{k + 1}]", name)
    elif isinstance(table, float):
        yield key, name, table


def _check_units(d: Description) -> Iterator[Mistake]:
    for key, name, value in _numbers(d.model_dump(exclude={"sensor", "parameter", "correlation"})):
        low, high, unit = RANGES.get(name) or RANGES.get(name.rpartition(".")[2]) or (-np.inf, np.inf, "")
        if value != 0 and not low <= value <= high:
            yield key, f"{value:g} is outside {low:g} to {high:g}, the plausible range", f"give it in {unit}"
    if isinstance(d, Offshore):
        strength, key = d.soil.undrained_shear_strength_pa, "soil.undrained_shear_strength_pa"
        deep = strength.at_mudline + 10.0 * strength.gradient_per_m
        said = f"{strength.at_mudline:g} at the mudline and {strength.gradient_per_m:g} a metre are"
        if deep < LEAST_STRENGTH_PA:
            yield key, f"{said} less than {LEAST_STRENGTH_PA:g} Pa ten metres down", "give Pa, not kPa"
        elif deep > MOST_STRENGTH_PA:
            yield key, f"{said} more than {MOST_STRENGTH_PA:g} Pa ten metres down", "give clay's in Pa; rock has others"
        elif 0 < strength.at_mudline < LEAST_AT_MUDLINE_PA:
            yield (f"{key}.at_mudline", f"{strength.at_mudline:g} is less than {LEAST_AT_MUDLINE_PA:g} Pa",
                   "give Pa, not kPa, or 0 where its strength begins at nothing")


def _check_order(rows: Iterable[tuple[str, float, str, float]]) -> Iterator[Mistake]:
    for low_key, low, high_key, high in rows:
        if not low < high:
            yield low_key, f"{low} is not below {high_key} = {high}", "put the levels in order, upwards"


def _check_upwards(key: str, stations) -> Iterator[Mistake]:
    z = [station.z_m for station in stations]
    for k in range(1, len(z)):
        is_step = z[k] == z[k - 1] and 1 < k < len(z) - 1 and z[k - 2] < z[k]
        if not (z[k - 1] < z[k] or is_step):
            yield (f"{key}[{k + 1}].z_m", f"{z[k]} is not above {z[k - 1]}",
                   "list the stations upwards; two at one level, with others below and above, are a step of the wall")


def _check_levels(d: Description) -> Iterator[Mistake]:
    if isinstance(d, Offshore):
        tip = "pile.tip_m" if isinstance(d, JacketTurbine) else "monopile.station[1].z_m"
        yield from _check_order((
            (tip, d.pile_tip_m, "site.mudline_m", d.site.mudline_m),
            ("site.mudline_m", d.site.mudline_m, "site.water_level_m", d.site.water_level_m),
            ("corrosion.bottom_m", d.corrosion.bottom_m, "corrosion.top_m", d.corrosion.top_m),
        ))
    if isinstance(d, JacketTurbine):
        yield from _jacket_levels(d)
    if isinstance(d, MonopileTurbine):
        yield from _monopile_levels(d)
    yield from _check_upwards("tower.station", d.tower.station)


def _jacket_levels(d: JacketTurbine) -> Iterator[Mistake]:
    jacket, tp = d.jacket, d.transition_piece
    yield from _check_order((
        ("jacket.bottom.z_m", jacket.bottom.z_m, "jacket.top.z_m", jacket.top.z_m),
        ("transition_piece.column_bottom_m", tp.column_bottom_m, "transition_piece.strut_top_m", tp.strut_top_m),
        ("jacket.top.z_m", jacket.top.z_m, "transition_piece.strut_top_m", tp.strut_top_m),
    ))
    if not d.site.mudline_m <= jacket.bottom.z_m:
        yield ("jacket.bottom.z_m", f"{jacket.bottom.z_m} is below the mudline {d.site.mudline_m}",
               "let the pile heads stand at or above the mudline")
    if not tp.strut_top_m <= d.tower.station[0].z_m:
        yield ("transition_piece.strut_top_m", f"{tp.strut_top_m} is above the tower's foot {d.tower.station[0].z_m}",
               "end the struts on the column")


def _monopile_levels(d: MonopileTurbine) -> Iterator[Mistake]:
    top, foot, sleeve = d.monopile.station[-1], d.tower.station[0].z_m, d.transition_piece
    yield from _check_upwards("monopile.station", d.monopile.station)
    yield from _check_order((("site.water_level_m", d.site.water_level_m, "monopile's top", top.z_m),))
    if sleeve is None:
        if top.z_m != foot:
            yield ("tower.station[1].z_m", f"{foot} is not the monopile's top, {top.z_m}, and there is no transition "
                   "piece between", "let the tower begin there, or describe [transition_piece]")
        return
    yield from _check_order((("transition_piece.bottom_m", sleeve.bottom_m, "tower.station[1].z_m", foot),
                          ("monopile's top", top.z_m, "tower.station[1].z_m", foot)))
    if not sleeve.bottom_m <= sleeve.lumped_mass_m <= foot:
        yield ("transition_piece.lumped_mass_m", f"{sleeve.lumped_mass_m} is not between {sleeve.bottom_m} and {foot}",
               "let it be a level of the transition piece")
    yield from _connection(d, sleeve)


def _connection(d: MonopileTurbine, sleeve: Sleeve) -> Iterator[Mistake]:
    top = d.monopile.station[-1]
    kind, own, other = ("grout", sleeve.grout, sleeve.flange) if sleeve.connection == "grouted" else (
        "flange", sleeve.flange, sleeve.grout)
    if own is None:
        yield f"transition_piece.{kind}", f"is missing for a {sleeve.connection} connection", "add it"
    if other is not None:
        yield (f"transition_piece.{'flange' if kind == 'grout' else 'grout'}",
               f"means nothing for a {sleeve.connection} connection", "remove it")
    if sleeve.connection == "bolted":
        if sleeve.bottom_m != top.z_m:
            yield ("transition_piece.bottom_m", f"{sleeve.bottom_m} is not the monopile's top, {top.z_m}",
                   "a bolted transition piece begins at the flange")
        return
    if not d.site.mudline_m < sleeve.bottom_m < top.z_m:
        yield ("transition_piece.bottom_m", f"{sleeve.bottom_m} leaves no overlap with the monopile, whose top is at "
               f"{top.z_m}", "a grouted one reaches down over the pile")
    elif own is not None:
        inside = sleeve.tube.diameter_m - 2 * sleeve.tube.thickness_m - 2 * sleeve.grout.thickness_m  # type: ignore
        if abs(inside - top.diameter_m) > GAP_M:
            yield ("transition_piece.grout.thickness_m", f"inside tube and grout is room for {inside:.3f} m, and the "
                   f"monopile's top has {top.diameter_m:.3f} m", "let tube, grout and pile fit into one another")


def _check_foundation(d: Description) -> Iterator[Mistake]:
    if not isinstance(d, FoundationTurbine):
        return
    for key in ("horizontal_npm", "vertical_npm", "rocking_nmprad", "torsion_nmprad"):
        value = getattr(d.foundation, key)
        if d.foundation.support == "springs" and value is None:
            yield f"foundation.{key}", "is missing for support on springs", "add it"
        if d.foundation.support == "clamped" and value is not None:
            yield f"foundation.{key}", "means nothing for a clamped foot", 'remove it, or set support = "springs"'


def _check_bays(d: Description) -> Iterator[Mistake]:
    if not isinstance(d, JacketTurbine):
        return
    low, high = d.jacket.bottom.z_m, d.jacket.top.z_m
    for k, bay in enumerate(d.jacket.bay):
        key = f"jacket.bay[{k + 1}]"
        if not bay.bottom_m < bay.top_m:
            yield f"{key}.bottom_m", f"{bay.bottom_m} is not below top_m = {bay.top_m}", "swap them"
        if bay.bottom_m < low or bay.top_m > high:
            yield (key, f"from {bay.bottom_m} to {bay.top_m} m it reaches beyond the legs, {low} to {high} m",
                   "move the bay or lengthen the legs")
    for k, (a, b) in enumerate(zip(d.jacket.bay[:-1], d.jacket.bay[1:], strict=True)):
        if b.bottom_m < a.top_m:
            yield (f"jacket.bay[{k + 2}].bottom_m", f"{b.bottom_m} lies below the top {a.top_m} of the bay before",
                   "list bays upwards, without overlap")


def legs_of(d: Description) -> tuple[str, ...]:
    return d.jacket.leg_names if isinstance(d, JacketTurbine) else ()


def _check_names(d: Description) -> Iterator[Mistake]:
    missing = sorted(set(d.groups) - set(d.mesh.elements_per_member))
    if missing:
        yield "mesh.elements_per_member", f"{', '.join(missing)} missing", "give a number for each group"
    for key, names in (
        ("jacket.leg_names", list(legs_of(d))),
        ("rna", [body.name for body in d.rna]),
        ("sensor", [sensor.channel for sensor in d.sensor]),
        ("parameter", [p.name for p in d.parameter]),
    ):
        # blanks around a name are seen by nobody
        shown = [n.strip() for n in names]
        twice = sorted({n for n in shown if shown.count(n) > 1})
        if "" in shown:
            yield f"{key}[{shown.index('') + 1}]", f"'{names[shown.index('')]}' is no name", "give each one a name"
        elif twice:
            yield key, f"'{twice[0]}' is listed twice", "keep one of them, or give them different names"
    if "hub" not in [body.name for body in d.rna]:
        yield "rna", "no body is named 'hub', whose mass is the parameter m_h", "name the hub and rotor so"


def _check_sensors(d: Description) -> Iterator[Mistake]:
    for k, sensor in enumerate(d.sensor):
        length = float(np.linalg.norm(np.clip(sensor.direction, -1e6, 1e6)))
        if abs(length - 1) > 1e-3:
            yield (f"sensor[{k + 1}] {sensor.channel}.direction", f"its length is {length:.3g}, not 1",
                   "give a unit vector")


def _check_parameters(d: Description) -> Iterator[Mistake]:
    for k, p in enumerate(d.parameter):
        key = f"parameter[{k + 1}] {p.name}"
        if p.kind is None and p.name not in d.own_parameters:
            which = f"this model, which stands on a {d.stands_on}" if p.name in ALL_NEUTRAL else "this model"
            yield (key, f"'{p.name}' is not a parameter of {which}",
                   suggest(p.name, d.own_parameters) + " (an effect at a place needs a kind)")
            continue
        if p.kind is not None and p.name in ALL_NEUTRAL:
            yield f"{key}.kind", f"'{p.name}' is a parameter of the whole structure", "give the effect another name"
            continue
        if p.kind is None and (p.on.given or any(getattr(p, name) is not None for name in SETTINGS)):
            yield key, "says where or how it acts, but not of which kind it is", f"add kind: {', '.join(KINDS)}"
        if (p.cov is None) == (p.std is None):
            both = "neither cov nor std" if p.cov is None else "both cov and std"
            yield key, f"{both} given", "give one of them"
        elif p.cov is not None and p.initial == 0:
            yield f"{key}.cov", "is relative to an initial value of 0", "give std in the parameter's unit"
        yield from check_effect(p, key, d) if p.kind is not None else _check_lowest(p, key)
        if not p.lower <= p.initial <= p.upper:
            yield f"{key}.initial", f"{p.initial} is outside [{p.lower}, {p.upper}]", "widen the bounds"
    updated = [p.name for p in d.parameter if p.update]
    if not updated:
        yield "parameter", "none has update = true", "let at least one vary"
    for name, row in (d.correlation or {}).items():
        for other in (name, *row):
            if other not in updated:
                yield f"correlation.{name}", f"'{other}' is not an updated parameter", suggest(other, updated)


def _check_lowest(p: ParameterEntry, key: str) -> Iterator[Mistake]:
    lowest = "above" if p.name in POSITIVE else "not below"
    for name in ("lower", "initial") if p.update else ("initial",):
        value = getattr(p, name)
        if value < 0 or (value == 0 and p.name in POSITIVE):
            yield f"{key}.{name}", f"{value} makes no structure: it must be {lowest} 0", "raise it"


def _corroding_tubes(d: Offshore) -> Iterator[tuple[str, str, str, TubeEntry | Section]]:
    """Names of the factors on diameter and wall ("" without), key and size of the tubes that corr thins."""
    if isinstance(d, JacketTurbine):
        yield "D_l", "t_l", "jacket.leg", d.jacket.leg
        for k, bay in enumerate(d.jacket.bay):
            yield "D_b", "t_b", f"jacket.bay[{k + 1}].brace", bay.brace
    if isinstance(d, MonopileTurbine):
        for k, section in enumerate(d.monopile.station):
            if section.z_m > d.site.mudline_m:
                yield "", "", f"monopile.station[{k + 1}]", section
        if d.transition_piece is not None:
            yield "", "", "transition_piece.tube", d.transition_piece.tube


def _check_section_range(d: Description) -> Iterator[Mistake]:
    """Walls of what corrodes at the ends of the updated parameters' bounds; the pile below the deepest scour."""
    if not isinstance(d, Offshore):
        return
    low, high = d.values, d.values
    for p in d.parameter:
        if p.update:
            low[p.name], high[p.name] = p.lower, p.upper
    for diameter_name, wall_name, key, tube in _corroding_tubes(d):
        thinnest = tube.thickness_m * low.get(wall_name, 1.0) - high["corr"]
        if thinnest <= 0:
            yield ((key, f"{wall_name} and corr at their bounds leave a wall of {1000 * thinnest:.1f} mm",
                    f"raise the lower bound of {wall_name} or lower the upper bound of corr") if wall_name else
                   (key, f"corr at its upper bound leaves a wall of {1000 * thinnest:.1f} mm", "lower that bound"))
        bore = tube.diameter_m * low.get(diameter_name, 1.0) - 2 * tube.thickness_m * high.get(wall_name, 1.0)
        if bore <= 0:
            yield (key, f"{diameter_name} and {wall_name} at their bounds close the bore",
                   f"lower the upper bound of {wall_name}")
    if high["sc"] >= d.site.mudline_m - d.pile_tip_m:
        yield "parameter sc", f"scour of {high['sc']} m lays the pile tip bare", "lower its upper bound"


def check_effect(p, key: str, d: Description) -> Iterator[Mistake]:
    """What is wrong with a [[parameter]] that has a kind; `key` is its place in the file."""
    if p.kind not in KINDS:
        yield f"{key}.kind", f"'{p.kind}' is unknown", suggest(p.kind, KINDS)
        return
    kind = KINDS[p.kind]
    yield from _check_settings(p, key, kind)
    yield from _check_on(p.on, f"{key}.on", p.kind, d)
    if p.kind in ("scour", "soil", "water_level", "growth") and not isinstance(d, Offshore):
        yield f"{key}.kind", f"'{p.kind}' means nothing on land", "remove it"
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
            yield f"{key}.motion", f"'{value}' is not one of the kind '{p.kind}'", suggest(value, kind.motions)


def _check_on(on: Place, key: str, name: str, d: Description) -> Iterator[Mistake]:
    kind = KINDS[name]
    for part in on.given:
        if part not in kind.keys:
            yield f"{key}.{part}", f"means nothing for the kind '{name}'", "remove it"
    if on.group is not None and on.group not in kind.groups:
        yield f"{key}.group", f"the kind '{name}' does not act on '{on.group}'", suggest(on.group, kind.groups)
    known = {"leg": legs_of(d), "face": faces(d), "body": [body.name for body in d.rna]}
    for part, names in known.items():
        value = getattr(on, part)
        if value is not None and value not in names:
            yield (f"{key}.{part}", f"'{value}' is not in this structure",
                   suggest(value, names) if names else f"a {d.stands_on} has none: remove it")
    bays = len(d.jacket.bay) if isinstance(d, JacketTurbine) else 0
    if on.bay is not None and on.bay > bays:
        yield (f"{key}.bay", f"there is no bay {on.bay}",
               f"count from the lowest, 1 to {bays}" if bays else f"a {d.stands_on} has none: remove it")
    if on.level_m is not None and not on.level_m[0] < on.level_m[1]:
        yield f"{key}.level_m", f"{on.level_m[0]} is not below {on.level_m[1]}", "give the lower end first"


def _check_range(p, key: str, d: Description) -> Iterator[Mistake]:
    """What the kind's range alone cannot rule out."""
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


def _check_scour(d: Offshore, rows: dict[str, tuple[float, float]]) -> Iterator[Mistake]:
    scour = [p for p in d.parameter if p.kind == "scour"]
    for leg in (legs_of(d) or ("",)) if scour else ():
        low, high = (rows.get("sc", (0.0, 0.0))[k] + sum(ends(p)[k] for p in scour if p.on.leg in (None, leg))
                     for k in (0, 1))
        if low < 0 or high >= d.site.mudline_m - d.pile_tip_m:
            depth, problem = (low, "is none") if low < 0 else (high, "lays the pile tip bare")
            where = f" at leg {leg}" if leg else ""
            yield (f"parameter {scour[0].name}", f"with sc, scour of {depth:g} m{where} {problem}",
                   f"{'raise the lower' if low < 0 else 'lower the upper'} bounds")
            return


def check_sums(d: Description) -> Iterator[Mistake]:
    """Depths and thicknesses that several parameters make up: none may fall below zero or lay a pile's tip bare.

    Scour is added leg by leg; for growth and corrosion all that reduce them are taken as acting at one place.
    """
    rows = {p.name: ends(p) for p in d.parameter}
    if isinstance(d, Offshore):
        yield from _check_scour(d, rows)
    for name, kind in (("mg", "growth"), ("corr", "corrosion")):
        effects = [p for p in d.parameter if p.kind == kind]
        low = rows.get(name, (0.0, 0.0))[0] + sum(min(ends(p)[0], 0.0) for p in effects)
        if effects and low < 0:
            yield (f"parameter {effects[0].name}.lower", f"{kind} and {name} at their least come to {low:g} m",
                   "raise the lower bounds")


CHECKS: tuple[Callable[[Description], Iterator[Mistake]], ...] = (
    _check_walls, _check_units, _check_levels, _check_foundation, _check_bays, _check_names, _check_sensors,
    _check_parameters,
    _check_section_range, check_sums,
)
