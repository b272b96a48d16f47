"""The diagnosis without a model on hidden effects: false alarms, what is found and named, by kind.

python studies/blind/without_model.py OUT.jsonl [--first K] [--most N]      goes on where it stopped
python studies/blind/without_model.py OUT.jsonl --table
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

CHANNELS = (*(f"TP-{leg}-{axis}" for leg in "ABCD" for axis in "xy"),
            *(f"T{z}-{a}" for z in (18, 66, 90) for a in "xy"))
LEVELS = {"TP": "all of TP", "tower bottom": "T18", "tower top": "T90"}
STEEL_PER_DEGC = -3.6e-4
N_NULL, N_EACH = 40, 6


def _step(rng) -> dict:
    return {"time_profile": "step", "at_hour": float(rng.uniform(0.25, 0.75) * 720)}


def _gain_step(rng):
    c = str(rng.choice(CHANNELS))
    return {"kind": "sensor_gain", "channel": c, "factor": 1 + float(rng.choice([-1, 1]) * rng.uniform(0.03, 0.2)),
            **_step(rng)}, "named", ("sensor gain", c)


def _gain_constant(rng):
    c = str(rng.choice(CHANNELS[:8]))
    return {"kind": "sensor_gain", "channel": c, "factor": 1 + float(rng.choice([-1, 1]) * rng.uniform(0.1, 0.3))}, (
        "named"), ("sensor gain", c)


def _clock(rng):
    level = str(rng.choice(list(LEVELS)))
    ms = float(rng.choice([-1, 1]) * rng.uniform(4, 30))
    time_profile = _step(rng) if rng.random() < 0.5 else {}
    # an early clock and a filter turn phases alike
    return {"kind": "clock_offset", "level": level, "offset_s": ms / 1000, **time_profile}, "named", (
        "clock offset", LEVELS[level])


def _rotation(rng):
    name = str(rng.choice(["TP-A", "TP-B", "TP-C", "TP-D", "T18", "T66", "T90"]))
    return {"kind": "sensor_rotation", "channel": f"{name}-x", "angle_deg": float(rng.uniform(4, 25)), **_step(rng)}, (
        "named"), ("sensor rotation", f"{name} about z")


def _reversed(rng):
    c = str(rng.choice(CHANNELS))
    time_profile = _step(rng) if rng.random() < 0.5 else {}
    return {"kind": "sensor_gain", "channel": c, "factor": -1.0, **time_profile}, "named", ("sensor polarity", c)


def _water(rng):
    return {"kind": "wetted_length", "gain": float(rng.uniform(2.5, 5))}, "named", ("wetted length", "all members")


def _temperature(rng):
    return {"kind": "steel_temperature", "per_kelvin": float(rng.uniform(6, 12)) * STEEL_PER_DEGC}, "named", (
        "temperature of the steel", "all members")


def _softening(rng):
    return {"kind": "soil_softening", "per_unit": float(rng.uniform(0.15, 0.4))}, "named", (
        "frequencies follow the amplitude", "all modes")


def _structure(rng):
    kind = int(rng.integers(3))
    hidden = (
        {"kind": "joint_stiffness", "bay": int(rng.integers(1, 5)), "face": str(rng.choice(["AB", "BC", "CD", "DA"])),
         "leg": "all", "end": "all", "factor": float(rng.uniform(0.05, 0.2))},
        {"kind": "scour", "leg": "all", "depth_m": float(rng.uniform(0.7, 3))},
        {"kind": "tp_mass", "mass_kg": float(rng.uniform(4e4, 1.2e5))},
    )[kind]
    return {**hidden, **_step(rng)}, "unexplained", None


KINDS = {"gain step": _gain_step, "gain constant, TP": _gain_constant, "clock": _clock, "rotation step": _rotation,
         "reversed": _reversed, "water level": _water, "temperature": _temperature, "amplitude": _softening,
         "structure step": _structure}


def cases(first: int):
    for number in range(first, first + N_NULL):
        yield f"null-{number:02d}", 5000 + number, None, "none", None
    for k, (name, draw) in enumerate(KINDS.items()):
        for number in range(first, first + N_EACH):
            rng = np.random.default_rng([k, number])
            yield f"{name}-{number:02d}", int(rng.integers(2**31)), *draw(rng)


def run(name, seed, effect, wanted, who) -> dict:
    from probupdate.diagnosis.without_model import diagnose_without_model
    from probupdate.errors import InputError
    from probupdate.virtual.modal_blocks import simulate_modes

    truth = {"parameters_from": "prior", **({"effect": [effect]} if effect else {})}
    record = simulate_modes(truth=truth, seed=seed, days=30.0, n_block=48)
    begun = time.process_time()
    try:
        found = diagnose_without_model(record.data, record.sensors)
    except InputError as error:
        # three modes close together are refused: a result of the study, counted
        return {"id": name, "effect": effect, "wanted": wanted, "who": who, "verdict": "refused", "why": str(error)}
    return {"id": name, "effect": effect, "wanted": wanted, "who": who, "verdict": found.verdict,
            "p_value": found.p_value, "cpu_s": time.process_time() - begun,
            "findings": [[f.kind, f.cause, f.location, f.time_profile, f.size, f.size_std, f.posterior_probability,
                          [[a.cause, a.location] for a in f.alternatives]] for f in found.findings],
            "changes": found.details["changes"]}


def outcome(row: dict) -> str:
    """right, ambiguous with the right one in the set, missed, wrong name, or false alarm."""
    if row["verdict"] == "refused":
        return "refused"
    if row["wanted"] == "none":
        return "right" if row["verdict"] == "none" else "false alarm"
    if row["verdict"] == "none":
        return "missed"
    if row["wanted"] == "unexplained":
        return "right" if row["verdict"] == "unexplained" and not row["findings"] else "wrong name"
    first = [f for f in row["findings"] if [f[1], f[2]] == row["who"]]
    if row["verdict"] == "named" and len(row["findings"]) == 1 and first:
        return "right"
    inside = any([f[1], f[2]] == row["who"] or row["who"] in f[7] for f in row["findings"])
    if row["verdict"] == "ambiguous" and inside:
        return "ambiguous, right one in the set"
    return "unexplained beside it" if row["verdict"] == "unexplained" else "wrong name"


def table(path: Path) -> str:
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    kinds: dict[str, list[dict]] = {}
    for row in rows:
        kinds.setdefault(row["id"].rsplit("-", 1)[0], []).append(row)
    lines = ["| hidden | n | outcome |", "|---|---|---|"]
    for kind, some in kinds.items():
        hidden = [outcome(r) for r in some]
        counts = ", ".join(f"{hidden.count(o)} {o}" for o in dict.fromkeys(hidden))
        lines.append(f"| {kind} | {len(some)} | {counts} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each kind")
    parser.add_argument("--most", type=int, default=10**6, help="cases to run now")
    parser.add_argument("--table", action="store_true")
    a = parser.parse_args()
    if not a.table:
        done = {json.loads(x)["id"] for x in a.out.read_text().splitlines()} if a.out.is_file() else set()
        with a.out.open("a") as file:
            for case in [c for c in cases(a.first) if c[0] not in done][: a.most]:
                file.write(json.dumps(run(*case)) + "\n")
                file.flush()
    print(table(a.out))


if __name__ == "__main__":
    main()
