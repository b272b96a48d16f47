"""Turbines on a monopile as `model.toml`: with a bolted transition piece or without one."""

from __future__ import annotations

import math

import numpy as np

from drawn import jackets
from drawn.hiding import Hidden
from drawn.jackets import PILE_PIECE_M, PRIOR, Mesh, near, strength
from drawn.skeleton import Body, Change, Member, Skeleton, Spring, State

NAME = "monopile"
FREE_PIECE_M = 3.0
OWN_PRIOR = {"k_c": (0.3, 0.05, 5.0)}


def draw(rng: np.random.Generator, *, small: bool = False) -> dict:
    """model.toml as a dictionary; small: a coarse mesh."""
    power = float(rng.uniform(0.5, 1.8))  # of an 8 MW turbine
    depth, buried = round(float(rng.uniform(15, 40)), 2), round(float(rng.uniform(25, 45)), 2)
    D, top = round(float(rng.uniform(6.5, 8.5) * power**0.3), 3), round(float(rng.uniform(8, 14)), 2)
    bolted = bool(rng.random() < 0.7)
    wall = D / float(rng.uniform(110, 150))
    z = [-depth - buried, -depth, round(float(rng.uniform(-0.5 * depth, -4)), 2), top]
    stations = [{"z_m": at, "diameter_m": round(D * f, 3), "thickness_m": round(wall * w, 4)}
                for at, f, w in zip(z, (1.0, 1.0, 0.96, 0.94), (0.9, 1.05, 1.0, 0.9), strict=True)]
    foot = round(top + float(rng.uniform(4, 8)), 2) if bolted else top
    head = stations[-1]["diameter_m"]
    number, height = int(rng.integers(3, 5)), float(rng.uniform(75, 95) * power**0.3)
    levels = np.round(np.linspace(foot, foot + height, number), 2)
    rna = 480e3 * power * float(rng.uniform(0.85, 1.15))
    raw = {
        "format": 1, "name": f"drawn monopile of {D:.1f} m in {depth:.0f} m",
        "site": {"mudline_m": -depth, "water_level_m": 0.0, "water_density_kgpm3": 1025.0, "gravity_mps2": 9.81},
        "steel": {"youngs_modulus_pa": 2.1e11, "poisson_ratio": 0.3, "density_kgpm3": 7850.0},
        "mesh": {"theory": "timoshenko", "geometric_stiffness": False,
                 "elements_per_member": {"pile": 8 if small else 12, "column": 2, "tower": 3 if small else 5}},
        "monopile": {"flooded": True, "station": stations},
        "hydrodynamics": {"added_mass_coefficient": 1.0, "growth_density_kgpm3": 1300.0, "growth_top_m": -2.0},
        "corrosion": {"bottom_m": -3.0, "top_m": 4.0},
        "soil": {"submerged_unit_weight_npm3": round(float(rng.uniform(7e3, 1.1e4)), 0),
                 "undrained_shear_strength_pa": {"at_mudline": round(float(rng.uniform(4e4, 1.5e5)), -3),
                                                 "gradient_per_m": round(float(rng.uniform(0, 4000)), 0)},
                 "strain_50": round(float(rng.uniform(0.005, 0.01)), 4), "matlock_j": 0.5},
        "tower": {"secondary_steel_kgpm": 250.0, "station": [
            {"z_m": float(at), "diameter_m": round(head * (1 - 0.35 * k / (number - 1)), 3),
             "thickness_m": round(head / 190 * (1 - 0.35 * k / (number - 1)), 4),
             "flange_kg": round(float(rng.uniform(5e3, 1.5e4)), 0)} for k, at in enumerate(levels)]},
        "rna": [{"name": "nacelle", "mass_kg": round(0.65 * rna, 0), "offset_m": [2.5, 0.0, 2.5],
                 "inertia_kgm2": [3e6 * power, 8e6 * power, 8e6 * power]},
                {"name": "hub", "mass_kg": round(0.35 * rna, 0), "offset_m": [-6.0, 0.0, 3.0],
                 "inertia_kgm2": [5e5 * power, 5e7 * power**2, 5e7 * power**2]}],
    }
    if bolted:
        raw["transition_piece"] = {
            "connection": "bolted", "bottom_m": top, "tube": {"diameter_m": head, "thickness_m": round(head / 170, 4)},
            "lumped_mass_kg": round(7e4 * power, 0), "lumped_mass_m": round(0.5 * (top + foot), 2),
            "flange": {"bending_stiffness_nmprad": float(f"{10 ** rng.uniform(12.3, 13.0):.3g}"), "mass_kg": 1.5e4}}
    rows = [("TP", "transition piece" if bolted else NAME, raw["transition_piece"]["lumped_mass_m"] if bolted else top)]
    rows += [(f"T{at:.0f}", "tower", float(at)) for at in levels[1:]]
    raw["sensor"] = [{"channel": f"{label}-{axis}", "level": label, "part": part, "position_m": [0.0, 0.0, at],
                      "direction": [float(axis == k) for k in "xyz"]} for label, part, at in rows for axis in "xy"]
    raw["parameter"] = []
    for name, (cov, lower, upper) in (PRIOR | OWN_PRIOR).items():
        if name in ("k_j", "LJF") or not bolted and name in ("k_c", "k_TP"):
            continue
        c = raw["rna"][1]["mass_kg"] if name == "m_h" else 1.0
        raw["parameter"].append({"name": name, "unit": "kg" if name == "m_h" else "-", "initial": c, "cov": cov,
                                 "lower": lower * c, "upper": upper * c, "prior": "normal"})
    return raw


# the truth -----------------------------------------------------------------------------------------------------------


def sound_state(raw: dict, rng: np.random.Generator):
    """State with parameters from the prior and what drawings leave open -> (state, theta)."""
    theta = {}
    for row in raw["parameter"]:
        drawn = row["initial"] * (1 + near(rng, row["cov"]))
        theta[row["name"]] = float(np.clip(drawn, 0.4 * row["initial"], 2.5 * row["initial"]))
    changes = [Change(what="stiffness", on={"group": g}, value=1 + near(rng, 0.01)) for g in ("tower", "column")]
    changes += [Change(what="stiffness", on={"group": "pile", "band": k}, value=1 + near(rng, 0.01)) for k in range(3)]
    changes += [Change(what="soil", on={"curve": c}, value=1 + near(rng, 0.15)) for c in ("py", "tz", "qw")]
    changes += [Change(what="mass", on={"group": "nacelle"}, value=1 + near(rng, 0.01)),
                Change(what="offset", on={"group": "rna", "axis": "x"}, value=near(rng, 0.05))]
    return State(changes=tuple(changes)), theta


def skeleton(raw: dict, theta: dict, state: State, *, level: float = 0.0, fine: int = 1) -> Skeleton:
    """Pieces of 3 m above the seabed and of 2 m below it, a tower of six pieces between flanges."""
    m = Mesh(raw, theta, state, level)
    top = _pile(m)
    stations, piece = raw["tower"]["station"], raw.get("transition_piece")
    tower = [f"tower {k}" for k in range(len(stations))]
    for node, s in zip(tower, stations, strict=True):
        m.place[node] = np.array([0.0, 0.0, s["z_m"]])
        m.bodies.append(Body(node=node, mass=s["flange_kg"], tags={"group": "flange"}))
    if piece is None:
        m.rigid.append((top, tower[0]))
    else:
        m.place |= {"sleeve": m.place[top], "platform": np.array([0.0, 0.0, piece["lumped_mass_m"]])}
        k = piece["flange"]["bending_stiffness_nmprad"] * theta.get("k_c", 1.0) * state.factor("connection", {})
        m.springs.append(Spring(node="sleeve", other=top, stiffness=(*[math.inf] * 3, k, k, math.inf)))
        m.bodies += [Body(node=top, mass=piece["flange"]["mass_kg"]),
                     Body(node="platform", mass=piece["lumped_mass_kg"])]
        for a, b in (("sleeve", "platform"), ("platform", tower[0])):
            m.line(a, b, piece["tube"], m.scaled("k_TP"), {"group": "column", "part": "column"}, pieces=2 * fine,
                   water=False)
    for k, (low, high) in enumerate(zip(stations[:-1], stations[1:], strict=True)):
        jackets.section(m, tower[k], tower[k + 1], low, high, k, 6 * fine)
    jackets.rna(m, tower[-1])
    return Skeleton(place=m.place, members=tuple(m.members), bodies=tuple(m.bodies), springs=tuple(m.springs),
                    rigid=tuple(m.rigid))


def node_at(z: float) -> str:
    return f"pile at {z:.3f}"


def _stops(raw: dict) -> list[float]:
    """Levels of the pile's nodes, from above."""
    mud, z = raw["site"]["mudline_m"], [s["z_m"] for s in raw["monopile"]["station"]]
    levels = {mud, *z, *(x for x in (raw["site"]["water_level_m"], raw["hydrodynamics"]["growth_top_m"])
                         if mud < x < z[-1])}
    ordered = sorted(levels, reverse=True)
    stops = ordered[:1]
    for high, low in zip(ordered[:-1], ordered[1:], strict=True):
        n = math.ceil((high - low) / (PILE_PIECE_M if high <= mud + 1e-9 else FREE_PIECE_M))
        stops += [high + (low - high) * k / n for k in range(1, n + 1)]
    return stops


def _pile(m: Mesh) -> str:
    """-> its top."""
    raw, mud, stations = m.raw, m.raw["site"]["mudline_m"], m.raw["monopile"]["station"]
    scour, stops, spans = m.state.amount("scour", {"leg": NAME}), _stops(m.raw), {}
    z = [s["z_m"] for s in stations]
    for at in stops:
        m.place[node_at(at)] = np.array([0.0, 0.0, at])
    for high, low in zip(stops[:-1], stops[1:], strict=True):
        middle = 0.5 * (high + low)
        D, wall = (float(np.interp(middle, z, [s[k] for s in stations])) for k in ("diameter_m", "thickness_m"))
        free = middle > mud - scour
        tags = {"group": "pile", "part": NAME, "band": int(np.searchsorted(z[1:], middle))}
        m.line(node_at(high), node_at(low), {"diameter_m": D, "thickness_m": wall}, m.scaled("k_p"), tags, pieces=1,
               water=free, flooded=middle > mud)
        if middle < mud:
            last = m.members[-1]
            fill = raw["site"]["water_density_kgpm3"] * math.pi / 4 * (D - 2 * wall) ** 2
            m.members[-1] = Member(**{**vars(last), "along_kgpm": last.along_kgpm + fill})
            for node, near_end in ((high, high), (low, low)):
                spans.setdefault(node, []).append((near_end, middle, D))
    for node, own in spans.items():
        _soil(m, node, own, scour)
    tip, D = stops[-1], stations[0]["diameter_m"]
    q = 0.25 / 0.002 * 9 * strength(raw["soil"], mud - tip) * math.pi * D / 4
    q *= m.state.factor("soil", {"curve": "qw"}) / m.theta.get("qw", 1.0)
    m.springs.append(Spring(node=node_at(tip), stiffness=(0, 0, q, 0, 0, 0), tags={"group": "soil"}))
    return node_at(stops[0])


def _soil(m: Mesh, z: float, spans, scour: float) -> None:
    """API RP 2GEO, lumped at a node: p-y and t-z of the halves of its pieces; friction at the radius holds the spin."""
    lateral = axial = spin = 0.0
    for near_end, middle, D in spans:
        for at in near_end + (middle - near_end) * (np.arange(8) + 0.5) / 8:
            p, t = jackets.soil_stiffness(m.raw["soil"], D, m.raw["site"]["mudline_m"] - at, scour)
            share = abs(near_end - middle) / 8
            lateral, axial, spin = lateral + share * p, axial + share * t, spin + share * t * D**2 / 4
    lateral *= m.state.factor("soil", {"curve": "py"}) / m.theta.get("py", 1.0)
    turned = m.state.factor("soil", {"curve": "tz"}) / m.theta.get("tz", 1.0)
    m.springs.append(Spring(node=node_at(z), stiffness=(lateral, lateral, axial * turned, 0, 0, spin * turned),
                            tags={"group": "soil"}))


# what is hidden ------------------------------------------------------------------------------------------------------


def anchors(raw: dict, rng) -> list[tuple[str, int]]:
    """Where something unknown may be fastened: (node, axis)."""
    free = [z for z in _stops(raw) if z > raw["site"]["mudline_m"] + 1]
    return [(f"tower {len(raw['tower']['station']) - 2}", int(rng.integers(2))),
            *((node_at(z), int(rng.integers(2))) for z in (free[1], free[len(free) // 2], free[-1]))]


def fault(rng, raw: dict) -> Hidden:
    kinds = ["pile", "scour", "lateral", "nacelle", *(["connection"] * 2 if "transition_piece" in raw else [])]
    kind, lost = str(rng.choice(kinds)), float(rng.uniform(0.35, 0.9))
    profile = str(rng.choice(["step", "step", "constant"]))

    def made(cause, location, size, what, on, value) -> Hidden:
        return Hidden(kind="structural", name=kind, right=frozenset({(cause, location)}), size=size, profile=profile,
                      changes=lambda amount: (Change(what=what, on=on, value=value(amount)),))

    def left(amount):
        return 1 - amount * lost

    if kind == "pile":
        lost, band = 0.5 * lost, int(rng.integers(1, 3))
        z = [s["z_m"] for s in raw["monopile"]["station"]]
        return made("monopile stiffness lost", f"{z[band]:g} to {z[band + 1]:g} m", -lost, "stiffness",
                    {"group": "pile", "band": band}, left)
    if kind == "scour":
        depth = float(rng.uniform(1.0, 5.0))
        return made("scour", NAME, depth, "scour", {"leg": NAME}, lambda a: a * depth)
    if kind == "lateral":
        return made("lateral soil stiffness", NAME, -lost, "soil", {"curve": "py"}, left)
    if kind == "connection":
        return made("bolted connection loosened", "monopile to transition piece", -lost, "connection", {}, left)
    kg = float(rng.uniform(0.06, 0.25)) * raw["rna"][0]["mass_kg"]
    return made("nacelle mass", "nacelle", kg, "kg", {"group": "nacelle"}, lambda a: a * kg)
