"""A month in which the tide moves the wetted length, one joint loosens half-way and one gain is wrong: what is found.

python studies/discovery/run.py OUT [--seed 7] [--hidden one-joint|face]

Writes OUT/modes.json (the month's modal sets), OUT/diagnosis.json with the files that go with it (extended model,
corrected sets, their mean), OUT/story.json (what the plain update makes of the month, what the diagnosis names, what
each finding gains, the truth) and two pictures.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from probupdate.cli.terminal import terminal_progress
from probupdate.diagnosis.diagnose import Outcome, examine
from probupdate.diagnosis.extension import extend
from probupdate.diagnosis.gain import gains
from probupdate.diagnosis.prepare import prepare
from probupdate.modal.modes import read_modes, write_modes
from probupdate.structure.load import load_model, nacelle_angle_deg, reference_model
from probupdate.updating.discrepancy import default_likelihood
from probupdate.updating.problem import build_problem
from probupdate.updating.runs import find_maximum
from probupdate.virtual.modal_blocks import simulate_modes

HALF_WAY_H = 360.0
STEP = {"time_profile": "step", "at_hour": HALF_WAY_H}
JOINTS = {
    "one-joint": {"kind": "joint_stiffness", "bay": 2, "face": "BC", "leg": "C", "end": "top", "factor": 0.05, **STEP},
    "face": {"kind": "joint_stiffness", "bay": 2, "face": "BC", "leg": "all", "end": "all", "factor": 0.3, **STEP},
}
TIDE, GAIN = {"kind": "wetted_length", "gain": 1.0}, {"kind": "sensor_gain", "channel": "T66-x", "factor": 0.85}
HIDDEN = (TIDE, JOINTS["one-joint"], GAIN)
WORDS = (
    ("wetted length", "all members"), ("joints loosened", "face BC, bay 2"), ("sensor gain", "T66-x"),
)


def month(seed: int, effects=HIDDEN):
    """All undisturbed idling half hours of thirty days."""
    return simulate_modes(truth={"effect": list(effects)}, seed=seed, days=30.0, n_block=None)


def share_of_scatter(run, plain) -> list[float]:
    """By how many of a block's own standard deviations the effects move ln f at most, per mode; lost modes left out."""
    moved = np.abs(np.log(run.frequency_hz / plain.frequency_hz)).max(axis=0)
    own = np.nanmedian([s.frequency_std_hz / s.frequency_hz for s in run.data.sets], axis=0)
    return (moved / own).tolist()


def updated(path: Path, mean: Path) -> dict:
    """Of every parameter the most probable value for the mean of the blocks with its standard deviation, and how many
    prior standard deviations it lies from the prior's centre; `misfit` of as many `numbers`."""
    data = read_modes(mean)
    model = load_model(path, nacelle_angle_deg=nacelle_angle_deg(data.sets[0].environment, mean.name))
    problem = build_problem(model, data, weights=default_likelihood(model, data))
    top = find_maximum(problem, [problem.parameters.initial])
    std = np.sqrt(np.diag(top.covariance))
    return {"misfit": float(problem.misfit(problem.predict_many(top.theta[None]).response)[0]),
            "numbers": problem.measured.size,
            "parameters": [{"name": p.name, "prior": p.initial, "prior_std": p.std, "value": float(value),
                            "std": float(own), "prior_shift": float((value - p.initial) / p.std)}
                           for p, value, own in zip(problem.parameters, top.theta, std, strict=True)]}


def pushes(updates: list[dict], truth: dict[str, float]) -> dict[str, list[float]]:
    """Parameter -> prior standard deviations from the prior's centre: most probable values of each update, and the
    truth."""
    gains_of = [{p["name"]: p["prior_shift"] for p in u["parameters"]} for u in updates]
    return {p["name"]: [*(t[p["name"]] for t in gains_of), (truth[p["name"]] - p["prior"]) / p["prior_std"]]
            for p in updates[0]["parameters"] if p["name"] in truth}


def draw_month(outcome: Outcome, path: Path) -> None:
    """What is left of the frequencies over the month, before and after the findings."""
    import matplotlib.pyplot as plt

    blocks = outcome.problem.blocks
    figure, axes = plt.subplots(2, 2, figsize=(9, 4.6), sharex=True, sharey="row", layout="constrained")
    single = next(q for q, group in enumerate(blocks.groups) if len(group) == 1)
    last = len(blocks.groups) - 1
    swing = [np.ptp(outcome.null.residuals[last][:, i]) for i in (0, 1)]
    chosen = [(single, 0, blocks.group_name(single)), (last, int(np.argmax(swing)), blocks.group_name(last))]
    for column, (fit, word) in enumerate(((outcome.null, "model as it is"), (outcome.fitted, "with the findings"))):
        for row, (q, i, name) in enumerate(chosen):
            measured = fit.design.noise.weight[q] > 0
            left = 100 * fit.residuals[q][measured, i]
            axes[row, column].plot(blocks.hours[measured] / 24, left, ".", ms=3, color="#30507a")
            axes[row, column].axhline(0, color="0.6", lw=0.8)
            axes[row, column].axvline(HALF_WAY_H / 24, color="#b03030", lw=1, ls="--")
            axes[row, 0].set_ylabel(f"{name}: measured less\ncomputed ln f, %")
        axes[0, column].set_title(word, fontsize=10)
        axes[1, column].set_xlabel("day of the record")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_shifts(shifted: dict[str, list[float]], path: Path) -> None:
    """How far parameters moved from their prior."""
    import matplotlib.pyplot as plt

    figure, left = plt.subplots(figsize=(4.8, 3.6), layout="constrained")
    place = np.arange(len(shifted))
    sides = (("#c08040", "plain update"), ("#30507a", "with the findings"))
    thick = 0.8 / len(sides)
    for side, (colour, word) in enumerate(sides):
        left.barh(place - 0.4 + thick * (side + 0.5), [v[side] for v in shifted.values()], thick, color=colour,
                  label=word)
    left.set_yticks(place, list(shifted))
    left.invert_yaxis()
    left.plot([v[-1] for v in shifted.values()], place, "k|", ms=12, label="truth")
    left.axvline(0, color="0.4", lw=0.8)
    left.set_xlabel("shift from the prior's centre, prior standard deviations")
    left.legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--hidden", choices=tuple(JOINTS), default="one-joint")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    hidden = (TIDE, JOINTS[a.hidden], GAIN)
    run, plain = month(a.seed, hidden), month(a.seed, ())
    write_modes(run.data, a.out / "modes.json")
    prepared = prepare(reference_model("updated"))
    begun = time.process_time()
    with terminal_progress() as progress:
        outcome = examine(prepared, run.data, seed=a.seed, progress=progress)
    spent = time.process_time() - begun
    # what was taken in is followed to its gain even where something remains and the verdict is "unexplained"
    gains_of = list(gains(outcome))
    more = extend(prepared, outcome, run.data, a.out / "diagnosis.json")
    found = outcome.diagnosis
    findings = tuple(replace(f, gain=g) for f, g in zip(found.findings, gains_of, strict=False))
    found = replace(found, findings=findings, extended_model=more.model, extension=more.content)
    found.write(a.out / "diagnosis.json")
    mean = a.out / "diagnosis.mean.json"
    updates = [updated(reference_model("updated"), mean), updated(a.out / "diagnosis.model.toml", mean)]
    truth = {k: float(v) for k, v in run.truth.parameters.items()}
    taken = [(n.effect.cause, n.effect.location) for n in outcome.fitted.included]
    story = {
        "blocks": len(run.data.sets), "hidden": list(hidden), "cpu_s": spent,
        "moved_in_deviations": dict(zip(run.data.labels, share_of_scatter(run, plain), strict=True)),
        "verdict": found.verdict, "p_value": found.p_value, "adequacy_p": found.adequacy_p,
        "taken_in": [{"cause": n.effect.cause, "location": n.effect.location, "time_profile": n.time_profile.name,
                      "block": n.time_profile.at, "size": n.size} for n in outcome.fitted.included],
        "found": {f"{cause}, {where}": (cause, where) in taken for cause, where in WORDS},
        "updates": dict(zip(("plain", "with the findings"), updates, strict=True)), "gains": gains_of,
        "extension": more.content, "notes": list(found.notes), "truth": truth,
    }
    (a.out / "story.json").write_text(json.dumps(story, indent=1) + "\n")
    draw_month(outcome, a.out / "month.png")
    draw_shifts(pushes(updates, truth), a.out / "shifts.png")
    print(found.summary)


if __name__ == "__main__":
    main()
