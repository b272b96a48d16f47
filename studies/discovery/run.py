"""A month in which the tide moves the wetted length, one joint loosens half-way and one gain is wrong: what is found.

python studies/discovery/run.py OUT [--seed 7]

Writes OUT/modes.json (the month's modal sets), OUT/diagnosis.json and OUT/story.json: what the plain update makes of
the month, what the diagnosis names, how the blocks of the last week are predicted before and after.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from probupdate.diagnosis.diagnose import diagnose
from probupdate.diagnosis.prepare import prepare
from probupdate.modes import write_modes
from probupdate.structure.load import reference_model
from probupdate.virtual.modal_blocks import simulate_modes

HALF_WAY_H = 360.0
HIDDEN = (
    {"kind": "wetted_length", "gain": 1.0},
    {"kind": "joint_stiffness", "bay": 2, "face": "BC", "leg": "C", "end": "top", "factor": 0.05, "course": "step",
     "at_hour": HALF_WAY_H},
    {"kind": "sensor_gain", "channel": "T66-x", "factor": 0.85},
)  # fmt: skip
WORDS = (
    ("wetted length", "all members"), ("joints loosened", "face BC, bay 2"), ("sensor gain", "T66-x"),
)


def month(seed: int, effects=HIDDEN):
    """All undisturbed idling half hours of thirty days."""
    return simulate_modes(truth={"effect": list(effects)}, seed=seed, days=30.0, n_block=None)


def share_of_scatter(run, plain) -> list[float]:
    """By how many of a block's own deviations the effects move ln f at most, per mode; lost modes left out."""
    moved = np.abs(np.log(run.frequency_hz / plain.frequency_hz)).max(axis=0)
    own = np.nanmedian([s.frequency_std_hz / s.frequency_hz for s in run.data.sets], axis=0)
    return (moved / own).tolist()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=7)
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    run, plain = month(a.seed), month(a.seed, ())
    write_modes(run.data, a.out / "modes.json")
    found = diagnose(prepare(reference_model("updated")), run.data, seed=a.seed)
    found.write(a.out / "diagnosis.json")
    named = [(f.cause, f.location) for f in found.findings]
    story = {
        "blocks": len(run.data.sets),
        "hidden": list(HIDDEN),
        "moved_in_deviations": dict(zip(run.data.labels, share_of_scatter(run, plain), strict=True)),
        "verdict": found.verdict,
        "p_value": found.p_value,
        "findings": found.content()["findings"],
        "found": {f"{cause}, {where}": (cause, where) in named for cause, where in WORDS},
        "plain_update": found.content()["parameters"],
        "truth": {k: float(v) for k, v in run.truth.parameters.items()},
    }
    (a.out / "story.json").write_text(json.dumps(story, indent=1) + "\n")
    print(found)


if __name__ == "__main__":
    main()
