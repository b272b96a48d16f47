"""Detection of modes with a right model, with grossly wrong ones and with none, on virtual days with their truth.

    python studies/data_first/run.py OUT [--days 1] [--seeds 11 12] [--state as_built]

simulates the days in OUT (or takes those there), identifies each once and names its modes by every model; the old way
is beside: the paper's classifier, whose poles need a MAC above 0.80 to the model's. Writes OUT/table.md.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd

import probupdate
from probupdate.identification import classification as rules
from probupdate.structure.load import reference_model
from probupdate.virtual.truth import read_truth_modes

WANTED = ("FA1", "SS1", "T1", "FA2", "SS2")
# a pole further from the mode's true frequency is another thing: five standard deviations of the weakest in half an
# hour
FAR = 0.03
GONE = ('[[parameter]]\nname = "gone_{face}"\nkind = "stiffness"\n'
        'on = {{ group = "brace", face = "{face}", bay = 2 }}\nunit = "-"\n'
        "initial = 0.01\nstd = 0.3\nlower = 0.0\nupper = 2.0\nupdate = false\n")


def initial(text: str, name: str, value: float) -> str:
    """The model's text with another initial value, and bounds about it, of a parameter."""
    before, after = re.split(rf'(?<=name = "{name}"\n)', text, maxsplit=1)
    head, *tail = re.split(r"(?=\n\[\[)", after, maxsplit=1)
    for key, number in (("initial", value), ("lower", value / 50), ("upper", 50 * value)):
        head = re.sub(rf"^{key} = .*$", f"{key} = {number:g}", head, count=1, flags=re.MULTILINE)
    return before + head + "".join(tail)


def wrong_models(text: str) -> dict[str, str]:
    """Name -> model.toml."""
    moved = re.sub(r"^offset_m = \[([-0-9.]+), ([-0-9.]+),", lambda m: f"offset_m = [{m[1]}, {float(m[2]) + 1:g},",
                   text, flags=re.MULTILINE)
    soft, stiff = text, text
    for name in ("py", "tz", "qw"):
        soft, stiff = initial(soft, name, 0.1), initial(stiff, name, 10.0)
    first = text.index("[[parameter]]")
    gone = text[:first] + "".join(GONE.format(face=face) for face in ("AB", "CD")) + text[first:]
    return {"right": text, "RNA 1 m to the side": moved, "k_TP / 3": initial(text, "k_TP", 1 / 3),
            "k_TP x 3": initial(text, "k_TP", 3.0), "soil / 10": soft, "soil x 10": stiff,
            "half a bay's braces gone": gone}


def found_of(data, truth, column_of: dict[str, int]) -> dict[str, tuple[int, int, int]]:
    """Mode -> blocks in which it is found at its true frequency, in which something else stands there, usable
    blocks."""
    usable = [s for s in data.sets if not s.environment.get("excluded")]
    result = {}
    for label in WANTED:
        right = wrong = 0
        for s in usable:
            near = nearest(truth, s)
            f = s.frequency_hz[column_of[label]] if label in column_of else np.nan
            error = abs(f / near.frequency_hz[near.labels.index(label)] - 1)
            right += bool(error <= FAR)
            wrong += bool(error > FAR)
        result[label] = right, wrong, len(usable)
    return result


def nearest(truth, s):
    heading = float(s.environment.get("nacelle_heading_deg", 0.0))
    return min(truth, key=lambda m: abs((m.heading_deg - heading + 180) % 360 - 180))


def by_number(data, truth) -> dict[str, int]:
    """Of modes without names the one nearest to each true frequency."""
    middle = np.array([r.frequency_hz for r in data.records])
    true = truth[0].frequency_hz[[truth[0].labels.index(label) for label in WANTED]]
    return {label: int(np.argmin(np.abs(np.log(middle / f)))) for label, f in zip(WANTED, true, strict=True)}


def false_modes(data, truth) -> int:
    """Persistent modes at no true frequency."""
    return sum(bool(np.min(np.abs(truth[0].frequency_hz / r.frequency_hz - 1)) > FAR) for r in data.records if r.found)


def by_paper(found, truth) -> dict[str, tuple[int, int, int]]:
    """The same of the paper's classifier at order 20: of a mode's poles that pass the best MAC."""
    usable = [s for s in found.data.sets if not s.environment.get("excluded")]
    table = found.poles[(found.poles["order"] == 20) & (found.poles["paper_criterion"] == rules.KEPT)]
    at = dict(list(table.groupby("time")))
    result = {}
    for label in WANTED:
        right = wrong = 0
        for s in usable:
            rows = at.get(pd.Timestamp(s.id))
            mine = None if rows is None else rows[rows["mode"] == label]
            if mine is None or not len(mine):
                continue
            near = nearest(truth, s)
            f = float(mine.loc[mine["mac"].idxmax(), "frequency_hz"])
            error = abs(f / near.frequency_hz[near.labels.index(label)] - 1)
            right += error <= FAR
            wrong += error > FAR
        result[label] = int(right), int(wrong), len(usable)
    return result


def row(name: str, way: str, parts: list[dict], false: str) -> str:
    cells = []
    for label in WANTED:
        right, wrong, blocks = (sum(p[label][k] for p in parts) for k in range(3))
        cells.append(f"{100 * right / blocks:.1f} ({wrong})")
    return f"| {name} | {way} | {' | '.join(cells)} | {false} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--days", type=float, default=1.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12])
    parser.add_argument("--state", default="as_built")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    models = wrong_models(reference_model(a.state).read_text(encoding="utf-8"))
    campaigns = {}
    for seed in a.seeds:
        campaigns[seed] = a.out / f"day{seed}"
        if not campaigns[seed].exists():
            probupdate.simulate(campaigns[seed], model=a.state, days=a.days, seed=seed)
    settings = probupdate.IdentificationSettings(rate_hz=5.0, order=20, block_rows=30)
    lines = ["| model | way | " + " | ".join(WANTED) + " | false modes |", "|" + "---|" * (len(WANTED) + 3)]
    said = []
    for name, text in [*models.items(), ("none", None)]:
        ours, paper, false = [], [], 0
        for seed, folder in campaigns.items():
            truth = read_truth_modes(folder / "truth.toml")
            store, model = a.out / f"blocks{seed}", None
            if text is not None:
                model = a.out / f"{re.sub('[^A-Za-z0-9]+', '_', name)}.toml"
                model.write_text(text, encoding="utf-8")
            found = probupdate.identify(folder, model, settings=settings, store=store)
            data = found.data
            columns = by_number(data, truth) if model is None else {t: data.labels.index(t) for t in WANTED}
            ours.append(found_of(data, truth, columns))
            false += false_modes(data, truth)
            if model is not None:
                paper.append(by_paper(found, truth))
                said += [f"{name}, seed {seed}: {r.label} {r.match} {r.model_label} MAC {r.mac:.2f}"
                         for r in data.records if r.match != "alike" and r.found]
        lines.append(row(name, "data first", ours, str(false)))
        if paper:
            lines.append(row(name, "paper", paper, ""))
    blocks = sum(p["T1"][2] for p in ours)
    text = "\n".join([*lines, "", f"{len(campaigns)} days, {blocks} usable blocks; percent of blocks with the mode at "
                      "its true frequency, in brackets blocks with something else in its place", "", *said]) + "\n"
    (a.out / "table.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
