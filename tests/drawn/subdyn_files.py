"""Plans as a SubDyn input file with its soil files and the TOML that names groups and parameters."""

from __future__ import annotations

from pathlib import Path

from subdyn_text import subdyn

from drawn import toml_text
from drawn.plans import Plan
from drawn.skeleton import Change, Spring

ACTS = {"stiffness": "stiffness", "mass": "mass", "spring": "soil"}


def write(plan: Plan, folder: Path, *, fem: int, div: int, layout: str) -> list[str]:
    """model.dat, a soil file for each foot on springs, model.toml -> the arguments that name them."""
    folder.mkdir(parents=True, exist_ok=True)
    s = plan.skeleton
    number = {name: k + 1 for k, name in enumerate(s.place)}
    sections = list(dict.fromkeys((m.steel.E, m.steel.G, m.steel.density, m.diameter, m.wall) for m in s.members))
    members = []
    for m in s.members:
        k = sections.index((m.steel.E, m.steel.G, m.steel.density, m.diameter, m.wall)) + 1
        members.append(f"{number[m.a]} {number[m.b]} {k} {k} 1c" + ("" if layout == "v4.0" else " 0"))
    feet = [p for p in s.springs if p.other is None]
    reactions = [f"{number[name]} 1 1 1 1 1 1" for name in s.held]
    for p in feet:
        soil = f"soil_{number[p.node]}.txt"
        (folder / soil).write_text(_soil_text(p), encoding="utf-8")
        reactions.append(f'{number[p.node]} 0 0 0 0 0 0 "{soil}"')
    masses = [f"{number[b.node]} {b.mass!r} {' '.join(map(repr, b.inertia))} 0 0 0 0 0 0" for b in s.bodies]
    text = subdyn([f"{x!r} {y!r} {z!r}" for x, y, z in (map(float, p) for p in s.place.values())], members, reactions,
                  interface=(), layout=layout, fem=fem, div=div, title=plan.kind, mass=masses,
                  circular=[f"{k} {' '.join(map(repr, row))}" for k, row in enumerate(sections, 1)])
    (folder / "model.dat").write_text(text, encoding="utf-8")
    groups, rows = {}, []
    for p in plan.parameters:
        groups[f"of_{p.name}"] = _group(plan, p, number)
        rows.append({"name": p.name, "acts": ACTS[p.what], "on": f"of_{p.name}", "unit": "-", "initial": 1.0,
                     "std": p.std, "lower": p.lower, "upper": p.upper})
    sensors = [{"channel": r.channel, "level": r.level, "joint": number[r.node],
                "direction": [float(r.axis == k) for k in range(3)]} for r in plan.readings]
    tables = {"name": f"drawn {plan.kind}", "subdyn": {"file": "model.dat"}, "group": groups, "parameter": rows,
              "sensor": sensors}
    (folder / "model.toml").write_text(toml_text.text(tables), encoding="utf-8")
    return ["--model", str(folder / "model.toml")]


def _group(plan: Plan, p, number) -> dict:
    s, acts = plan.skeleton, Change(what=p.what, on=p.on, value=1.0)
    if p.what == "stiffness":
        return {"members": [k for k, m in enumerate(s.members, 1) if acts.acts_on(m.tags)]}
    if p.what == "mass":
        return {"masses": [number[b.node] for b in s.bodies if acts.acts_on(b.tags)]}
    return {"reactions": [number[x.node] for x in s.springs if acts.acts_on(x.tags)]}


def _soil_text(p: Spring) -> str:
    names = ("x", "y", "z", "tx", "ty", "tz")
    lines = ["! soil of one foot"]
    for i, a in enumerate(names):
        for j, b in enumerate(names[: i + 1]):
            lines.append(f"{p.stiffness[i] if i == j else 0.0!r} K{b}{a}")
    return "\n".join(lines) + "\n"

