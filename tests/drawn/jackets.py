"""Jacket turbines as `model.toml`: three and four legs, one to six bays, narrow and wide, rigid and flexible joints."""

from __future__ import annotations

import math

import numpy as np

from drawn.hiding import Hidden, on_parts
from drawn.skeleton import Body, Change, Member, Skeleton, Spring, State, Steel

LEG_NAMES = {3: ("ABC", ("1", "2", "3"), ("P1", "P2", "P3"), ("North", "West", "East")),
             4: ("ABCD", ("1", "2", "3", "4"), ("A1", "A2", "B2", "B1"), ("NE", "NW", "SW", "SE"))}
PRIOR = {"k_j": (0.05, 0.5, 1.5), "k_t": (0.1, 0.2, 4.0), "k_TP": (0.25, 0.1, 3.0), "k_p": (0.1, 0.3, 2.0),
         "LJF": (0.5, 0.05, 5.0), "a_m": (0.3, 0.05, 4.0), "m_h": (0.02, 0.8, 1.2), "py": (0.5, 0.05, 10.0),
         "tz": (0.5, 0.05, 10.0), "qw": (0.5, 0.05, 10.0)}
PILE_PIECE_M = 2.0


def _tube(diameter: float, ratio: float) -> dict:
    return {"diameter_m": round(diameter, 3), "thickness_m": round(diameter / ratio, 4)}


def draw(rng: np.random.Generator, *, small: bool = False) -> dict:
    """model.toml as a dictionary; small: one or two bays and a coarse mesh."""
    legs = int(rng.choice([3, 4]))
    bays = int(rng.integers(1, 3 if small else 7))
    depth = float(rng.uniform(12, 20) + (8.0 if small else rng.uniform(5, 9)) * bays)
    power = float(rng.uniform(0.6, 1.6))  # of a 5 MW turbine
    top, bottom = round(float(rng.uniform(8, 18)), 2), round(-depth + float(rng.choice([0.0, 0.5, 1.5])), 2)
    spacing_top = round(float(rng.uniform(6, 11) * math.sqrt(power)), 2)
    spacing = round(spacing_top + (top - bottom) * float(rng.uniform(0.03, 0.4)), 2)
    leg = _tube(float(rng.uniform(0.95, 1.5) * math.sqrt(power)), float(rng.uniform(26, 42)))
    brace = leg["diameter_m"] * float(rng.uniform(0.45, 0.62))
    levels = _levels(rng, bays, bottom, top)
    tower = _tower(rng, power, top)
    tp_top = round(top + float(rng.uniform(2, 4)), 2)
    rna = 350e3 * power * float(rng.uniform(0.85, 1.15))
    raw = {
        "format": 1, "name": f"drawn jacket of {legs} legs and {bays} bays",
        "site": {"mudline_m": round(-depth, 2), "water_level_m": 0.0, "water_density_kgpm3": 1025.0,
                 "gravity_mps2": 9.81},
        "steel": {"youngs_modulus_pa": 2.1e11, "poisson_ratio": 0.3, "density_kgpm3": 7850.0},
        "mesh": {"theory": str(rng.choice(["timoshenko", "timoshenko", "bernoulli-euler"])),
                 "geometric_stiffness": False,
                 "elements_per_member": {"leg": 1, "brace": 1 if small else 2, "pile": 6 if small else 10, "column": 1,
                                         "strut": 1, "tie": 1, "tower": 3 if small else 5}},
        "jacket": {
            "leg_names": list(LEG_NAMES[legs][int(rng.integers(4))]),
            "first_leg_angle_deg": 45.0 if legs == 4 and rng.random() < 0.7 else round(float(rng.uniform(0, 90)), 1),
            "bottom": {"z_m": bottom, "leg_spacing_m": spacing}, "top": {"z_m": top, "leg_spacing_m": spacing_top},
            "leg": leg, "flooded": bool(rng.random() < 0.7),
            "bay": [{"bottom_m": low, "top_m": high,
                     "brace": _tube(brace * (1 - 0.04 * k), float(rng.uniform(30, 48)))}
                    for k, (low, high) in enumerate(zip(levels[:-1], levels[1:], strict=True))],
            "joints": {"law": str(rng.choice(["fessler", "rigid"]))}},
        "hydrodynamics": {"added_mass_coefficient": 1.0, "growth_density_kgpm3": 1300.0, "growth_top_m": -2.0},
        "corrosion": {"bottom_m": -3.0, "top_m": min(4.0, top - 1)},
        "pile": {"tip_m": round(-depth - float(rng.uniform(22, 45)), 2), "flooded": bool(rng.random() < 0.7),
                 **_tube(leg["diameter_m"] * float(rng.uniform(1.2, 1.8)), float(rng.uniform(32, 45)))},
        "soil": {"submerged_unit_weight_npm3": round(float(rng.uniform(7e3, 1.1e4)), 0),
                 "undrained_shear_strength_pa": {"at_mudline": round(float(rng.uniform(4e4, 1.5e5)), -3),
                                                 "gradient_per_m": round(float(rng.uniform(0, 2500)), 0)},
                 "strain_50": round(float(rng.uniform(0.005, 0.012)), 4), "matlock_j": 0.5},
        "transition_piece": {
            "column_bottom_m": top, "column": {"diameter_m": tower[0]["diameter_m"], "thickness_m": 0.08},
            "strut_top_m": tp_top, "strut": _tube(leg["diameter_m"] * 1.3, 38),
            "tie": _tube(leg["diameter_m"] * 0.9, 38), "lumped_mass_kg": round(1.2e5 * power, 0)},
        "tower": {"secondary_steel_kgpm": 180.0,
                  "station": [{**s, "z_m": round(s["z_m"] + tp_top - top + 1.0, 2)} for s in tower]},
        "rna": [{"name": "nacelle", "mass_kg": round(0.65 * rna, 0), "offset_m": [1.8, 0.0, 1.8],
                 "inertia_kgm2": [0.6e6 * power, 2.6e6 * power, 2.6e6 * power]},
                {"name": "hub", "mass_kg": round(0.35 * rna, 0), "offset_m": [-4.6, 0.0, 2.2],
                 "inertia_kgm2": [1e5 * power, 1.6e7 * power**2, 1.6e7 * power**2]}],
    }
    raw["sensor"] = _sensors(rng, raw)
    raw["parameter"] = _parameters(rng, raw)
    return raw


def _levels(rng, bays: int, bottom: float, top: float) -> list[float]:
    """Bays that become lower upwards; the lowest begins at the legs' foot, a hand above it, or a metre above."""
    low, high = bottom + float(rng.choice([0.0, 0.06, 1.5])), top - float(rng.choice([0.0, 0.07, 2.0]))
    heights = np.linspace(1.0, rng.uniform(0.6, 1.0), bays)
    return [round(float(z), 2) for z in low + (high - low) * np.r_[0, np.cumsum(heights)] / heights.sum()]


def _tower(rng, power: float, top: float) -> list[dict]:
    height, number = float(rng.uniform(55, 75) * power**0.3), int(rng.integers(3, 6))
    foot = float(rng.uniform(5.2, 6.2) * power**0.45)
    z = np.linspace(top, top + height, number)
    return [{"z_m": float(at), "diameter_m": round(foot * (1 - 0.35 * k / (number - 1)), 3),
             "thickness_m": round((0.030 - 0.013 * k / (number - 1)) * power**0.3, 4),
             "flange_kg": round(float(rng.uniform(4e3, 1e4)), 0)} for k, at in enumerate(z)]


def leg_point(raw: dict, leg: int, z: float) -> np.ndarray:
    low, high, number = raw["jacket"]["bottom"], raw["jacket"]["top"], len(raw["jacket"]["leg_names"])
    share = (z - low["z_m"]) / (high["z_m"] - low["z_m"])
    side = low["leg_spacing_m"] + share * (high["leg_spacing_m"] - low["leg_spacing_m"])
    angle = math.radians(raw["jacket"]["first_leg_angle_deg"] + 360 * leg / number)
    radius = side / (2 * math.sin(math.pi / number))
    return np.array([radius * math.cos(angle), radius * math.sin(angle), z])


def leg_levels(raw: dict) -> list[float]:
    j = raw["jacket"]
    return sorted({j["bottom"]["z_m"], j["top"]["z_m"], *(z for b in j["bay"] for z in (b["bottom_m"], b["top_m"]))})


def _sensors(rng, raw: dict) -> list[dict]:
    """Two axes on some legs' tops (some with z), at two to four heights of the tower, now and then a level below."""
    rows, names = [], raw["jacket"]["leg_names"]

    def add(label, level, part, at, axes):
        for axis in axes:
            rows.append({"channel": f"{label}{axis}", "level": level, "part": part,
                         "position_m": [round(float(x), 3) for x in at],
                         "direction": [float(axis.lower() == k) for k in "xyz"]})

    dash, big = str(rng.choice(["-", "_", " "])), bool(rng.random() < 0.2)
    plane, space = ("XY", "XYZ") if big else ("xy", "xyz")
    top = raw["jacket"]["top"]["z_m"]
    chosen = sorted(rng.choice(len(names), int(rng.integers(2, len(names) + 1)), replace=False).tolist())
    upright = bool(rng.random() < 0.6)
    for k in chosen:
        add(f"TP{dash}{names[k]}{dash}", "TP", f"leg {names[k]}", leg_point(raw, k, top), space if upright else plane)
    inner = leg_levels(raw)[1:-1]
    if inner and rng.random() < 0.4:
        z = inner[len(inner) // 2]
        for k in chosen[:2]:
            add(f"J{dash}{names[k]}{dash}", "jacket", f"leg {names[k]}", leg_point(raw, k, z), plane)
    stations = raw["tower"]["station"]
    for s in stations[-int(rng.integers(2, len(stations))):]:
        add(f"T{s['z_m']:.0f}{dash}", f"tower {s['z_m']:.0f}", "tower", [0, 0, s["z_m"]], plane)
    return rows


def _parameters(rng, raw: dict) -> list[dict]:
    rows = []
    for name, (cov, lower, upper) in PRIOR.items():
        if name == "LJF" and raw["jacket"]["joints"]["law"] == "rigid":
            continue
        centre = next(b["mass_kg"] for b in raw["rna"] if b["name"] == "hub") if name == "m_h" else 1.0
        rows.append({"name": name, "unit": "kg" if name == "m_h" else "-", "initial": centre, "cov": cov,
                     "lower": lower * centre, "upper": upper * centre, "prior": "normal"})
    return rows


# the truth -----------------------------------------------------------------------------------------------------------


def near(rng, std: float, most: float = 2.0) -> float:
    """Normal, cut at so many standard deviations."""
    return float(np.clip(rng.standard_normal(), -most, most)) * std


def sound_state(raw: dict, rng: np.random.Generator):
    """State with parameters from the prior and everything that a user's drawings leave open -> (state, theta)."""
    theta = {}
    for row in raw["parameter"]:
        drawn = row["initial"] * (1 + near(rng, row["cov"]))
        theta[row["name"]] = float(np.clip(drawn, 0.4 * row["initial"], 2.5 * row["initial"]))
    changes = []
    names = raw["jacket"]["leg_names"]
    faces = [a + b for a, b in zip(names, [*names[1:], names[0]], strict=True)]
    for group in ("tower", "leg", "brace", "pile"):
        changes.append(Change(what="stiffness", on={"group": group}, value=1 + near(rng, 0.01)))
    for bay in range(1, len(raw["jacket"]["bay"]) + 1):
        changes += [Change(what="stiffness", on={"group": "brace", "bay": bay, "face": f}, value=1 + near(rng, 0.01))
                    for f in faces]
        changes += [Change(what="stiffness", on={"group": "leg", "bay": bay, "leg": n}, value=1 + near(rng, 0.01))
                    for n in names]
    for curve in ("py", "tz", "qw"):
        changes.append(Change(what="soil", on={"curve": curve}, value=1 + near(rng, 0.15)))
        changes += [Change(what="soil", on={"curve": curve, "leg": n}, value=1 + float(rng.uniform(-0.1, 0.1)))
                    for n in names]
    changes.append(Change(what="mass", on={"group": "nacelle"}, value=1 + near(rng, 0.01)))
    changes.append(Change(what="offset", on={"group": "rna", "axis": "x"}, value=near(rng, 0.05)))
    changes.append(Change(what="mass", on={"group": "tp mass"}, value=1 + near(rng, 0.02)))
    return State(changes=tuple(changes)), theta


class Mesh:
    """Collects nodes and members of one state."""

    def __init__(self, raw: dict, theta: dict, state: State, level: float):
        self.raw, self.theta, self.state, self.level = raw, theta, state, level
        s = raw["steel"]
        self.steel = Steel(E=s["youngs_modulus_pa"], G=s["youngs_modulus_pa"] / (2 * (1 + s["poisson_ratio"])),
                           density=s["density_kgpm3"])
        self.place, self.members, self.bodies, self.springs, self.rigid = {}, [], [], [], []

    def scaled(self, name: str) -> Steel:
        f = self.theta.get(name, 1.0)
        return Steel(E=self.steel.E * f, G=self.steel.G * f, density=self.steel.density)

    def wet(self, low: float, high: float) -> float:
        a, b = sorted((low, high))
        return float(b <= self.level) if b - a < 1e-9 else float(np.clip((self.level - a) / (b - a), 0, 1))

    def line(self, a, b, entry, steel, tags, *, pieces, flooded=False, water=True) -> None:
        """A member in pieces, each with its own water."""
        start, end = self.place[a], self.place[b]
        nodes = [a, *(f"{a}>{b}:{tags.get('part', '')}:{k}" for k in range(1, pieces)), b]
        for k in range(1, pieces):
            self.place[nodes[k]] = start + (end - start) * k / pieces
        D, t = entry["diameter_m"], entry["thickness_m"]
        water_density, hydro = self.raw["site"]["water_density_kgpm3"], self.raw["hydrodynamics"]
        for one, two in zip(nodes[:-1], nodes[1:], strict=True):
            z = 0.5 * (self.place[one][2] + self.place[two][2])
            own = {**tags, "above": z > self.raw["site"]["water_level_m"], "z_band": _band(tags, z)}
            along = across = 0.0
            if water:
                share = self.wet(self.place[one][2], self.place[two][2])
                grown = self.state.amount("growth", own) if z < hydro["growth_top_m"] else 0.0
                across = share * self.theta.get("a_m", 1.0) * hydro["added_mass_coefficient"] * water_density * (
                    math.pi / 4) * (D + 2 * grown) ** 2
                along = hydro["growth_density_kgpm3"] * math.pi * grown * (D + grown)
                if flooded or self.state.amount("flooded", own):
                    along += share * water_density * math.pi / 4 * (D - 2 * t) ** 2
            self.members.append(Member(a=one, b=two, diameter=D, wall=t, steel=steel, tags=own, along_kgpm=along,
                                       across_kgpm=across, pieces=1))


def _band(tags, z: float) -> str:
    return f"{tags['group']} {math.floor(z)}"


def skeleton(raw: dict, theta: dict, state: State, *, level: float = 0.0, fine: int = 1) -> Skeleton:
    """The turbine in a state, at a water level in m: legs and braces in three pieces or more, piles in pieces of 2 m,
    a tower of twelve pieces between flanges."""
    m = Mesh(raw, theta, state, level)
    _legs(m, fine)
    _braces(m, fine)
    for k, name in enumerate(raw["jacket"]["leg_names"]):
        _pile(m, k, name)
    _above(m, fine)
    return Skeleton(place=m.place, members=tuple(m.members), bodies=tuple(m.bodies), springs=tuple(m.springs),
                    rigid=tuple(m.rigid))


def anchors(raw: dict, rng) -> list[tuple[str, int]]:
    """Where something unknown may be fastened: (node, axis)."""
    found = [(f"tower {len(raw['tower']['station']) - 2}", int(rng.integers(2)))]
    names = raw["jacket"]["leg_names"]
    for z in leg_levels(raw)[1:]:
        found.append((node_of_leg(str(rng.choice(names)), z), int(rng.integers(2))))
    return found


def node_of_leg(name: str, z: float) -> str:
    return f"leg {name} at {z}"


def _bay_of(raw, z: float):
    """Of a leg: the bay at a level; below the lowest the first, above the highest the last."""
    bays = raw["jacket"]["bay"]
    for k, bay in enumerate(bays):
        if z < bay["top_m"]:
            return k + 1
    return len(bays)


def _legs(m: Mesh, fine: int) -> None:
    raw, levels = m.raw, leg_levels(m.raw)
    for k, name in enumerate(raw["jacket"]["leg_names"]):
        for z in levels:
            m.place[node_of_leg(name, z)] = leg_point(raw, k, z)
        for low, high in zip(levels[:-1], levels[1:], strict=True):
            tags = {"group": "leg", "leg": name, "bay": _bay_of(raw, 0.5 * (low + high)), "part": f"leg {name}"}
            m.line(node_of_leg(name, low), node_of_leg(name, high), raw["jacket"]["leg"], m.scaled("k_j"), tags,
                   pieces=max(1, min(4 * fine, math.ceil((high - low) * fine / 3.0))),
                   flooded=raw["jacket"]["flooded"])


def _braces(m: Mesh, fine: int) -> None:
    raw, names = m.raw, m.raw["jacket"]["leg_names"]
    for number, bay in enumerate(raw["jacket"]["bay"], 1):
        for k, left in enumerate(names):
            right = names[(k + 1) % len(names)]
            low = [m.place[node_of_leg(n, bay["bottom_m"])] for n in (left, right)]
            high = [m.place[node_of_leg(n, bay["top_m"])] for n in (left, right)]
            w0, w1 = (np.linalg.norm(p[1] - p[0]) for p in (low, high))
            centre = f"cross {left}{right} {number}"
            m.place[centre] = low[0] + w0 / (w0 + w1) * (high[1] - low[0])
            for first, second in ((left, right), (right, left)):
                # one diagonal rises from the first leg, the other from the second
                part = f"brace {first}{second}-{number}"
                tags = {"group": "brace", "face": left + right, "bay": number, "part": part}
                for leg, z in ((first, bay["bottom_m"]), (second, bay["top_m"])):
                    end = _brace_end(m, leg, z, m.place[centre], bay["brace"], {**tags, "leg": leg})
                    m.line(end, centre, bay["brace"], m.scaled("k_j"), {**tags, "half": leg}, pieces=2 * fine)


def _brace_end(m: Mesh, leg: str, z: float, centre, brace: dict, tags) -> str:
    chord_node = node_of_leg(leg, z)
    if m.raw["jacket"]["joints"]["law"] == "rigid":
        return chord_node
    k = m.raw["jacket"]["leg_names"].index(leg)
    chord = leg_point(m.raw, k, m.raw["jacket"]["top"]["z_m"]) - leg_point(m.raw, k, m.raw["jacket"]["bottom"]["z_m"])
    x = (centre - m.place[chord_node]) / np.linalg.norm(centre - m.place[chord_node])
    chord /= np.linalg.norm(chord)
    normal = np.cross(chord, x)
    normal /= np.linalg.norm(normal)
    own = m.raw["jacket"]["leg"]
    D, gamma = own["diameter_m"], own["diameter_m"] / (2 * own["thickness_m"])
    beta, sine = brace["diameter_m"] / D, math.sin(math.acos(abs(float(chord @ x))))
    # Fessler, Mockford and Webster (1986), one brace at a time
    loosened = m.state.factor("joint", {**tags, "group": "joint"})
    E = m.steel.E * m.theta.get("LJF", 1.0) * m.theta.get("k_j", 1.0) * loosened
    axial = E * D / (1.95 * gamma**2.15 * (1 - beta) ** 1.3 * sine**2.19)
    in_plane = E * D**3 / (134.0 * gamma**1.73 * math.exp(-4.52 * beta) * sine**1.22)
    out = E * D**3 / (85.5 * gamma**2.2 * math.exp(-3.85 * beta) * sine**2.16)
    end = f"{chord_node} {tags['part']}"
    m.place[end] = m.place[chord_node]
    # x along the brace, y out of its plane with the chord's: z is the axis in that plane
    m.springs.append(Spring(node=end, other=chord_node, x=tuple(map(float, x)), y=tuple(map(float, normal)),
                            stiffness=(axial, math.inf, math.inf, math.inf, in_plane, out),
                            tags={"group": "joint", **{key: tags[key] for key in ("face", "bay", "leg")}}))
    return end


def _pile(m: Mesh, number: int, name: str) -> None:
    raw, pile, soil = m.raw, m.raw["pile"], m.raw["soil"]
    head, mud = raw["jacket"]["bottom"]["z_m"], raw["site"]["mudline_m"]
    scour = m.state.amount("scour", {"leg": name})
    foot = node_of_leg(name, head)
    stops = [] if head - mud < 1e-9 else [mud]
    n = math.ceil((mud - pile["tip_m"]) / PILE_PIECE_M)
    stops += [mud + (pile["tip_m"] - mud) * k / n for k in range(1, n + 1)]
    above, length = foot, {}
    for z in stops:
        here = f"pile {name} at {z:.3f}"
        m.place[here] = np.array([*m.place[foot][:2], z])
        middle = 0.5 * (m.place[above][2] + z)
        # what stands free of the soil carries the water beside it
        free = middle > mud - scour
        m.line(above, here, pile, m.scaled("k_p"), {"group": "pile", "leg": name, "part": f"pile {name}"}, pieces=1,
               water=free)
        fill = 1025.0 * math.pi / 4 * (pile["diameter_m"] - 2 * pile["thickness_m"]) ** 2 if pile["flooded"] else 0.0
        last = m.members[-1]
        m.members[-1] = Member(**{**vars(last), "along_kgpm": last.along_kgpm + fill})
        high = m.place[above][2]
        if z < mud - 1e-9:
            for node in (above, here):
                length[node] = length.get(node, []) + [(high, z)]
        above = here
    for node, spans in length.items():
        _soil(m, node, name, spans, scour)
    tip = f"pile {name} at {pile['tip_m']:.3f}"
    q = 0.25 / 0.002 * 9 * strength(soil, mud - pile["tip_m"]) * math.pi * pile["diameter_m"] / 4
    factor = m.state.factor("soil", {"curve": "qw", "leg": name}) / m.theta.get("qw", 1.0)
    m.springs.append(Spring(node=tip, stiffness=(0, 0, q * factor, 0, 0, 0), tags={"group": "soil", "leg": name}))


def strength(soil: dict, depth: float) -> float:
    s = soil["undrained_shear_strength_pa"]
    return s["at_mudline"] + s["gradient_per_m"] * depth


def soil_stiffness(soil: dict, D: float, depth: float, scour: float) -> tuple[float, float]:
    """API RP 2GEO: initial stiffness of p-y and t-z, N/m per m of pile of diameter D, at a depth below the mudline."""
    if depth - scour <= 0:
        return 0.0, 0.0
    s, w = strength(soil, depth), soil["submerged_unit_weight_npm3"] * (depth - scour)
    p = D * min(3 * s + w + soil["matlock_j"] * s * (depth - scour) / D, 9 * s)
    psi = s / w
    alpha = min(0.5 * psi**-0.5 if psi <= 1 else 0.5 * psi**-0.25, 1.0)
    return 2.3 * p / (2.5 * soil["strain_50"] * D), 0.3 / 0.0016 * math.pi * alpha * s


def _soil(m: Mesh, node: str, leg: str, spans, scour: float) -> None:
    """Lumped at a node: the halves of its pieces."""
    soil, D, mud = m.raw["soil"], m.raw["pile"]["diameter_m"], m.raw["site"]["mudline_m"]
    z0 = m.place[node][2]
    lateral = axial = 0.0
    for high, low in spans:
        # the half of the piece that is nearest to the node, by eight points
        near, far = (high, 0.5 * (high + low)) if abs(high - z0) < 1e-9 else (0.5 * (high + low), low)
        points = near + (far - near) * (np.arange(8) + 0.5) / 8
        for z in points:
            p, t = soil_stiffness(soil, D, mud - z, scour)
            lateral, axial = lateral + abs(near - far) / 8 * p, axial + abs(near - far) / 8 * t
    lateral *= m.state.factor("soil", {"curve": "py", "leg": leg}) / m.theta.get("py", 1.0)
    axial *= m.state.factor("soil", {"curve": "tz", "leg": leg}) / m.theta.get("tz", 1.0)
    m.springs.append(Spring(node=node, stiffness=(lateral, lateral, axial, 0, 0, 0),
                            tags={"group": "soil", "leg": leg}))


def _above(m: Mesh, fine: int) -> None:
    raw, tp, stations = m.raw, m.raw["transition_piece"], m.raw["tower"]["station"]
    m.place |= {"foot": np.array([0, 0, tp["column_bottom_m"]]), "struts": np.array([0, 0, tp["strut_top_m"]])}
    steel, top = m.scaled("k_TP"), raw["jacket"]["top"]["z_m"]
    tower = [f"tower {k}" for k in range(len(stations))]
    for node, s in zip(tower, stations, strict=True):
        m.place[node] = np.array([0.0, 0.0, s["z_m"]])
    for a, b in (("foot", "struts"), ("struts", tower[0])):
        if m.place[b][2] - m.place[a][2] > 1e-9:
            m.line(a, b, tp["column"], steel, {"group": "column", "part": "column"}, pieces=3, water=False)
    for name in raw["jacket"]["leg_names"]:
        for end, group in (("struts", "strut"), ("foot", "tie")):
            tags = {"group": group, "leg": name, "part": f"{group} {name}"}
            m.line(node_of_leg(name, top), end, tp[group], steel, tags, pieces=3, water=False)
    m.bodies.append(Body(node="struts", mass=tp["lumped_mass_kg"] + m.state.amount("kg", {"group": "column"}),
                         tags={"group": "tp mass"}))
    for k, (low, high) in enumerate(zip(stations[:-1], stations[1:], strict=True)):
        section(m, tower[k], tower[k + 1], low, high, k, 6 * fine)
    for node, s in zip(tower, stations, strict=True):
        m.bodies.append(Body(node=node, mass=s["flange_kg"], tags={"group": "flange"}))
    rna(m, tower[-1])


def section(m: Mesh, a: str, b: str, low: dict, high: dict, number: int, pieces: int) -> None:
    nodes = [a, *(f"{a} {k}" for k in range(1, pieces)), b]
    for k in range(1, pieces):
        m.place[nodes[k]] = m.place[a] + (m.place[b] - m.place[a]) * k / pieces
    more = m.state.amount("kg", {"group": "tower", "station": number}) / (high["z_m"] - low["z_m"])
    for k in range(pieces):
        t = (k + 0.5) / pieces
        D, w = (low[key] + t * (high[key] - low[key]) for key in ("diameter_m", "thickness_m"))
        m.members.append(Member(a=nodes[k], b=nodes[k + 1], diameter=D, wall=w, steel=m.scaled("k_t"),
                                along_kgpm=m.raw["tower"]["secondary_steel_kgpm"] + more,
                                tags={"group": "tower", "station": number, "above": True}))


def rna(m: Mesh, top: str) -> None:
    more = m.state.amount("offset", {"group": "rna", "axis": "x"})
    for body in m.raw["rna"]:
        node = f"rna {body['name']}"
        m.place[node] = m.place[top] + np.array(body["offset_m"]) + [more, 0, 0]
        m.rigid.append((top, node))
        mass = m.theta.get("m_h", body["mass_kg"]) if body["name"] == "hub" else body["mass_kg"]
        kg = m.state.amount("kg", {"group": body["name"]})
        inertia = tuple(i + 3.0 * kg * i / body["mass_kg"] * (body["name"] == "hub") for i in body["inertia_kgm2"])
        m.bodies.append(Body(node=node, mass=mass + kg, inertia=inertia, tags={"group": body["name"]}))


# what is hidden ------------------------------------------------------------------------------------------------------


def fault(rng, raw: dict) -> Hidden:
    names = raw["jacket"]["leg_names"]
    k, bay = int(rng.integers(len(names))), int(rng.integers(1, len(raw["jacket"]["bay"]) + 1))
    leg, face = names[k], names[k] + names[(k + 1) % len(names)]
    kinds = ["brace", "brace", "one brace", "leg", "scour", "lateral", "axial", "nacelle", "piece", "growth"]
    if raw["jacket"]["joints"]["law"] != "rigid":
        kinds += ["joints", "joints"]
    kind = str(rng.choice(kinds))
    lost = float(rng.uniform(0.35, 0.95))
    profile = str(rng.choice(["step", "step", "constant"]))

    def made(cause, location, size, changes, profile=profile) -> Hidden:
        return Hidden(kind="structural", name=kind, right=frozenset({(cause, location)}), size=size, changes=changes,
                      profile=profile)

    def left(amount):
        return 1 - amount * lost

    if kind == "brace":
        return made("brace stiffness lost", f"face {face}, bay {bay}", -lost,
                    on_parts("stiffness", {"group": "brace", "face": face, "bay": bay}, left))
    if kind == "one brace":
        part = f"brace {face}-{bay}"
        return made("brace stiffness lost", f"face {face}, bay {bay}", -lost / 2,
                    on_parts("stiffness", {"part": part}, left))
    if kind == "leg":
        lost = 0.6 * lost
        return made("leg stiffness lost", f"leg {leg}, bay {bay}", -lost,
                    on_parts("stiffness", {"group": "leg", "leg": leg, "bay": bay}, left))
    if kind == "joints":
        return made("joints loosened", f"face {face}, bay {bay}", -lost,
                    on_parts("joint", {"group": "joint", "face": face, "bay": bay}, left))
    if kind == "scour":
        depth = float(rng.uniform(1.0, 5.0))
        return made("scour", f"leg {leg}", depth, on_parts("scour", {"leg": leg}, lambda a: a * depth))
    if kind in ("lateral", "axial"):
        return made(f"{kind} soil stiffness", f"leg {leg}", -lost,
                    on_parts("soil", {"curve": "py" if kind == "lateral" else "tz", "leg": leg}, left))
    if kind == "nacelle":
        kg = float(rng.uniform(0.06, 0.25)) * raw["rna"][0]["mass_kg"]
        return made("nacelle mass", "nacelle", kg, on_parts("kg", {"group": "nacelle"}, lambda a: a * kg))
    if kind == "piece":
        kg = float(rng.uniform(0.3, 1.0)) * raw["transition_piece"]["lumped_mass_kg"]
        return made("transition-piece mass", "column", kg, on_parts("kg", {"group": "column"}, lambda a: a * kg))
    thickness = float(rng.uniform(0.06, 0.2))
    low = [b for b in range(1, len(raw["jacket"]["bay"]) + 1) if raw["jacket"]["bay"][b - 1]["top_m"] < 0] or [1]
    bay = low[int(rng.integers(len(low)))]

    def grown(amount):
        return tuple(Change(what="growth", on={"group": g, "bay": bay}, value=amount * thickness)
                     for g in ("leg", "brace"))
    return made("marine growth", f"bay {bay}", thickness, grown, "constant")
