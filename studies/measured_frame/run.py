"""The measured laboratory frame, braced in y in its lowest storey: is the brace named from a uniform model?

python studies/measured_frame/run.py OUT [--data DIR] [--discrepancy 1 4 6 10]

Identifies fifteen roving setups, resolves the lasers' motions into those of rigid floors, writes uniform models that
are equal in x and y, and asks the diagnosis, the model discrepancy that it assumes as it is and several times as large.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from pathlib import Path

import numpy as np
from scipy.linalg import eigh

import probupdate
from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.prepare import prepare
from probupdate.modal.modes import ModalData, ModalSet, read_modes, write_modes

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "weimar_frame"
N_SETUP = 15
LEVELS_M = (0.192, 0.392, 0.592, 0.792, 0.98)
STOREY_M = np.diff([0.0, *LEVELS_M])
# three bending modes each way; torsion and what may be a harmonic (12.598 Hz) are left out
BENDING_HZ = (1.2285, 1.4358, 4.0171, 4.7707, 7.6158, 9.6655)
# per unit mass of a floor: of the columns of a storey, and what holds a floor from turning; fitted to the three
# frequencies in x, which no brace stiffens
EI, FLOOR = 1.703, 28.273
CHANNELS = tuple(f"F{k + 1}-{axis}" for k in range(5) for axis in "xy")
# of diagnosis.setting: ln f, cross term of a pair, shape, phase
FLOORS = ("DISCREPANCY_LOG", "DISCREPANCY_CROSS", "DISCREPANCY_SHAPE", "DISCREPANCY_PHASE")


def floor_modes(folder: Path) -> ModalData:
    """Bending modes as motions of rigid floors, from three oblique velocities at three corners of each."""
    merged = probupdate.identify_setups([folder / f"s{k:02d}" for k in range(1, N_SETUP + 1)])
    data = merged.data
    place, direction = {}, {}
    for path in sorted(folder.glob("s*/campaign.toml")):
        for row in tomllib.loads(path.read_text(encoding="utf-8"))["sensor"]:
            place[row["channel"]], direction[row["channel"]] = np.array(row["position_m"]), np.array(row["direction"])
    one = data.sets[0]
    chosen = [int(np.argmin(np.abs(one.frequency_hz - f))) for f in BENDING_HZ]
    shape = np.zeros((len(CHANNELS), len(chosen)), complex)
    std = np.zeros(shape.shape)
    for level, height in enumerate(LEVELS_M):
        rows = [k for k, c in enumerate(data.channels) if c.startswith("N") and abs(place[c][2] - height) < 0.01]
        nodes = sorted({data.channels[k].split("-")[0] for k in rows})
        matrix = []
        for k in rows:
            name, d, (x, y, _) = data.channels[k], direction[data.channels[k]], place[data.channels[k]]
            matrix.append([d[0], d[1], x * d[1] - y * d[0], *(d[2] * (name.split("-")[0] == n) for n in nodes)])
        for column, mode in enumerate(chosen):
            seen = one.shape[rows, mode]
            known = np.isfinite(seen)
            inverse = np.linalg.pinv(np.array(matrix)[known])[:2]
            shape[2 * level : 2 * level + 2, column] = inverse @ seen[known]
            std[2 * level : 2 * level + 2, column] = np.sqrt(inverse**2 @ one.shape_std[rows, mode][known] ** 2)
    scale = shape[np.argmax(np.abs(shape), axis=0), np.arange(len(chosen))]
    resolved = ModalSet(id=one.id, frequency_hz=one.frequency_hz[chosen], damping_ratio=one.damping_ratio[chosen],
                        frequency_std_hz=one.frequency_std_hz[chosen], shape=shape / scale,
                        shape_std=std / np.abs(scale))
    return ModalData(channels=CHANNELS, sets=(resolved,))


def storey(k: int) -> tuple[np.ndarray, np.ndarray]:
    """(10, 10) of five translations and five rotations: a storey's columns; a brace in it of their shear stiffness."""
    columns, brace, h = np.zeros((12, 12)), np.zeros((12, 12)), STOREY_M[k]
    bending = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2], [-12, -6 * h, 12, -6 * h],
                        [6 * h, 2 * h**2, -6 * h, 4 * h**2]])
    rows = [k, 6 + k, k + 1, 7 + k]
    columns[np.ix_(rows, rows)] = EI / h**3 * bending
    brace[np.ix_([k, k + 1], [k, k + 1])] = 12 * EI / h**3 * np.array([[1, -1], [-1, 1]])
    # the foot neither moves nor turns
    free = [1, 2, 3, 4, 5, 7, 8, 9, 10, 11]
    return columns[np.ix_(free, free)], brace[np.ix_(free, free)]


def row(name: str, initial: float, std: float, lower: float, upper: float) -> str:
    return (f'[[parameter]]\nname = "{name}"\nunit = "-"\ninitial = {initial}\nstd = {std}\nlower = {lower}\n'
            f"upper = {upper}\n\n")


def write_frame(folder: Path) -> Path:
    """Uniform frame: columns of one stiffness, floors that turn; a brace may stand in each storey each way."""
    folder.mkdir(parents=True, exist_ok=True)
    mass = np.diag(np.tile(np.r_[np.ones(5), np.full(5, 1e-6)], 2))
    arrays, rows = {"M0": mass, "K0": np.zeros((20, 20))}, []
    for a, axis in enumerate("xy"):
        own = np.ix_(range(10 * a, 10 * a + 10), range(10 * a, 10 * a + 10))
        for k in range(5):
            columns, brace = storey(k)
            arrays["K0"][own] += columns
            arrays[f"K_brace_{axis}{k + 1}"] = np.zeros((20, 20))
            arrays[f"K_brace_{axis}{k + 1}"][own] = brace
            rows.append(row(f"brace_{axis}{k + 1}", 0.0, 0.2, 0.0, 20.0))
        arrays[f"K_floor_{axis}"] = np.zeros((20, 20))
        arrays[f"K_floor_{axis}"][own] = FLOOR * np.diag(np.r_[np.zeros(5), np.ones(5)])
        rows.append(row(f"floor_{axis}", 1.0, 0.2, 0.1, 10.0))
    return _written(folder, arrays, rows, 10)


def write_shear(folder: Path) -> Path:
    """Uniform shear building: lumped floors that do not turn, the first frequency in x met."""
    folder.mkdir(parents=True, exist_ok=True)
    stiffness = (2 * np.pi * BENDING_HZ[0] / (2 * np.sin(np.pi / 22))) ** 2
    arrays, rows = {"M0": np.eye(10), "K0": np.zeros((10, 10))}, []
    for a, axis in enumerate("xy"):
        for k in range(5):
            arrays[f"K_k_{axis}{k + 1}"] = matrix = np.zeros((10, 10))
            matrix[5 * a + k, 5 * a + k] = stiffness
            if k:
                below = [5 * a + k - 1, 5 * a + k]
                matrix[np.ix_(below, below)] = stiffness * np.array([[1, -1], [-1, 1]])
            rows.append(row(f"k_{axis}{k + 1}", 1.0, 0.2, 0.2, 40.0))
    return _written(folder, arrays, rows, 5)


def _written(folder: Path, arrays: dict, rows: list[str], of_one_axis: int) -> Path:
    channel = np.zeros((len(CHANNELS), len(arrays["M0"])))
    for k, name in enumerate(CHANNELS):
        channel[k, of_one_axis * "xy".index(name[-1]) + int(name[1]) - 1] = 1.0
    np.savez(folder / "model.npz", **arrays, channel=np.array(CHANNELS), channel_row=channel)
    (folder / "parameters.toml").write_text("".join(rows), encoding="utf-8")
    return folder / "model.npz"


def frequencies(path: Path, **sizes: float) -> np.ndarray:
    """Six lowest, of the neutral model with these parameters moved."""
    neutral = {n["name"]: n["initial"] for n in tomllib.loads(
        path.with_name("parameters.toml").read_text(encoding="utf-8"))["parameter"]}
    with np.load(path) as arrays:
        K = arrays["K0"] + sum(sizes.get(n, x) * arrays[f"K_{n}"] for n, x in neutral.items())
        return np.sqrt(eigh(K, arrays["M0"], eigvals_only=True)[:6]) / (2 * np.pi)


def asked(path: Path, data: ModalData, times: float) -> dict:
    """The diagnosis as it is, or with the model discrepancy that it assumes so many `times` as large."""
    prepared = prepare(path)
    if times == 1:
        outcome = examine(prepared, data.compared(), seed=1)
    else:
        from probupdate.diagnosis import problem

        before = {name: getattr(problem, name) for name in FLOORS}
        try:
            for name, value in before.items():
                setattr(problem, name, times * value)
            outcome = examine(prepared, data.compared(), seed=1)
        finally:
            for name, value in before.items():
                setattr(problem, name, value)
    found = outcome.diagnosis
    return {
        "model": path.parent.name, "discrepancy": times, "verdict": found.verdict, "adequacy": found.adequacy_p,
        "findings": [[f.location, f.size, f.size_std, f.posterior_probability] for f in found.findings],
        "taken_in": [[n.effect.cause, n.effect.location, n.size] for n in outcome.fitted.included],
        "notes": list(found.notes),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--discrepancy", type=float, nargs="*", default=[1.0],
                        help="times the usual discrepancy from which its scale is estimated")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    path = a.out / "modes.json"
    if not path.is_file():
        write_modes(floor_modes(a.data), path)
    data = read_modes(path)
    measured = data.sets[0].frequency_hz
    frame, shear = write_frame(a.out / "frame"), write_shear(a.out / "shear")
    for name, model, sizes in (("shear building", shear, {}), ("frame", frame, {}),
                               ("frame, brace in y 1", frame, {"brace_y1": 7.86})):
        error = 100 * (frequencies(model, **sizes) / np.sort(measured) - 1)
        sys.stdout.write(f"{name}: {error.round(1).tolist()} % of {np.sort(measured).round(3).tolist()} Hz\n")
    lines = []
    for times in a.discrepancy:
        for model in (shear, frame):
            lines.append(asked(model, data, times))
            sys.stdout.write(json.dumps({k: v for k, v in lines[-1].items() if k != "notes"}) + "\n")
            sys.stdout.flush()
    (a.out / "asked.json").write_text(json.dumps(lines, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
