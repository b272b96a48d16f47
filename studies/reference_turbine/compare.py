"""Ours beside the paper for the three model files as they are: Tables 3, 4 and 6, mesh error, gravity, shear.

    python studies/reference_turbine/compare.py > tables.md
"""

from __future__ import annotations

import numpy as np

from probupdate.modal.labels import mode_character
from probupdate.modal.modes import Sensor, mac
from probupdate.reporting.paper_tables import FREQUENCY_HZ, MAC, MODES, PILE_HEAD_NPM, UPDATED
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.load import load_model, reference_model, turbine_model
from probupdate.structure.parameter_table import read_toml

STATES = {"design": "design", "as-built": "as_built", "updated": "updated"}
N_MODE = 10


def solved(model, description, theta=None):
    """-> {label: Hz}, {label: shape (n_channel,)}, {"k_xy", "k_z"}."""
    theta = np.array([p.initial for p in model.parameters]) if theta is None else theta
    solution = model.solve(theta, N_MODE)
    sensors = tuple(Sensor(channel=s.channel, level=s.level, position_m=s.position_m, direction=s.direction)
                    for s in description.sensor)
    labels = mode_character(solution.shape, sensors).labels
    return (dict(zip(labels, solution.frequency_hz, strict=True)), dict(zip(labels, solution.shape.T, strict=True)),
            {name: function(theta) for name, function in model.derived.items()})


def changed(state: str, change) -> tuple[dict, dict, dict]:
    """The state's file with its [mesh] table changed."""
    path = reference_model(STATES[state])
    raw = read_toml(path)
    change(raw["mesh"])
    description = parse_description(raw, str(path))
    return solved(turbine_model(description, where=str(path)), description)


def finer(mesh) -> None:
    mesh["elements_per_member"] = {group: 2 * number for group, number in mesh["elements_per_member"].items()}


def heavy(mesh) -> None:
    mesh["geometric_stiffness"] = True


def with_shear(mesh) -> None:
    mesh["theory"] = "timoshenko"


def beside(value: float, paper: float, digits: int) -> str:
    return f"{value:.{digits}f} / {paper:.2f} ({100 * (value / paper - 1):+.1f} %)"


def main() -> None:
    found = {}
    for state, name in STATES.items():
        path = reference_model(name)
        found[state] = solved(load_model(path), read_description(path))
    print("| Hz, ours / paper | " + " | ".join(MODES) + " | T1 | first local mode | modes 6 to 8 |\n|" + "---|" * 8)
    for state, (f, _, _) in found.items():
        cells = [beside(f[m], p, 4) for m, p in zip(MODES, FREQUENCY_HZ[state], strict=True)]
        local = min((value for label, value in f.items() if label.startswith("L")), default=np.nan)
        above = ", ".join(f"{label} {value:.3f}" for label, value in list(f.items())[5:8])
        print(f"| {state} | " + " | ".join([*cells, f"{f['T1']:.3f}", f"{local:.3f}", above]) + " |")
    print("\n| 1e5 kN/m, ours / paper | k_xy | k_z |\n|---|---|---|")
    for state, (_, _, k) in found.items():
        cells = [beside(k[name] / 1e8, paper / 1e8, 2) for name, paper in PILE_HEAD_NPM[state].items()]
        print(f"| {state} | " + " | ".join(cells) + " |")
    print("\n| MAC, ours to the updated state / paper's to the measured one | " + " | ".join(MODES) + " |")
    print("|" + "---|" * 5)
    for state in ("design", "as-built"):
        cells = [float(mac(found[state][1][m][:, None], found["updated"][1][m][:, None])[0, 0]) for m in MODES]
        print(f"| {state} | " + " | ".join(f"{a:.4f} / {b:.2f}" for a, b in zip(cells, MAC[state], strict=True)) + " |")
    names = (*MODES[:2], "T1", *MODES[2:])
    for title, change in (("mesh error", finer), ("effect of gravity", heavy), ("effect of shear", with_shear)):
        print(f"\n| {title}, relative | " + " | ".join(names) + " | k_xy | k_z |\n|" + "---|" * 8)
        for state, (f, _, k) in found.items():
            other, _, head = changed(state, change)
            pairs = [(f[m], other[m]) for m in names] + [(k[n], head[n]) for n in k]
            sign = -1 if change is finer else 1
            print(f"| {state} | " + " | ".join(f"{sign * (b / a - 1):+.1e}" for a, b in pairs) + " |")
    model, description = load_model(reference_model("as_built")), read_description(reference_model("as_built"))
    ratio = UPDATED["k_TP"][4]
    values = {name: row[3] for name, row in UPDATED.items()} | {"k_TP": ratio}
    f, _, _ = solved(model, description, np.array([values[p.name] for p in model.parameters]))
    print(f"\nk_TP {ratio} instead of {UPDATED['k_TP'][3]}: " + ", ".join(f"{m} {f[m]:.4f}" for m in MODES))
    print(f"\nDegrees of freedom: {model.mass[0].shape[0]}")


if __name__ == "__main__":
    main()
