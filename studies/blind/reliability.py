"""Reliability diagram of the diagnosis' probabilities: how often what was given a probability was so.

python studies/blind/reliability.py OUT/cases.jsonl [MORE.jsonl ...] [--figure reliability.png]

Takes lines of run.py (and of studies/oc4_jacket/run.py) that state probabilities; lines without any are counted and
left out. A finding's candidates, itself and its alternatives, are right where cause and place are among what was
hidden; "chance alone" is right where nothing was hidden, or where all that was hidden stands in other findings and
this one is none of it. First candidates are one to a finding; all candidates of a finding are not independent, so
that the intervals of the second series are too narrow.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tables import interval

CHANCE = "chance alone"
# ends of the bins of probability: narrow where a name is given
EDGES = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0)


@dataclass(frozen=True)
class Stated:
    """A candidate's probability, whether it was so, whether it came first of its finding, and what the truth could
    tell: a chance candidate of a record in which something is hidden is judged by exclusion."""

    probability: float
    right: bool
    first: bool
    case: str


def candidates(finding: dict) -> list[tuple[str, str, float]]:
    """(cause, place, probability) of a finding and of its alternatives; none where a line does not state them."""
    if finding.get("probability") is None:
        return []
    own = (finding["cause"], finding["location"], float(finding["probability"]))
    rest = finding["alternatives"]
    if "probabilities" in finding:
        rest = [[*a[:2], p] for a, p in zip(rest, finding["probabilities"], strict=True)]
    return [own, *((cause, where, float(p)) for cause, where, p in rest)]


def truth(line: dict) -> set[tuple[str, str]]:
    """(cause, place) of all that was hidden and has a name in the catalogue."""
    return {(e["cause"], e["location"]) for e in line.get("effects", line["hidden"])}


def stated(lines: Iterable[dict]) -> tuple[list[Stated], int]:
    """All candidates with a probability; and how many findings stated none. Records with something hidden that no row
    describes have no right name: their candidates count as wrong."""
    found, without = [], 0
    for line in lines:
        if "failed" in line or line["verdict"] not in ("named", "ambiguous"):
            continue
        hidden = truth(line)
        for finding in line["findings"]:
            own = candidates(finding)
            if not own:
                without += 1
                continue
            about = any((cause, where) in hidden for cause, where, _ in own)
            for k, (cause, where, probability) in enumerate(own):
                # a finding that is about none of what was hidden is chance, if the truth has nothing without a name
                right = (cause, where) in hidden or (
                    cause == CHANCE and not about and bool(hidden or not line["hidden"])
                )
                found.append(Stated(probability, right, k == 0, line["id"]))
    return found, without


def bins(values: list[Stated]) -> list[tuple[float, int, int, float, float]]:
    """(mean probability, right, number, 95 % interval) of each bin that holds any; 1 belongs to the last."""
    rows = []
    place = np.digitize([v.probability for v in values], EDGES[1:-1]) if values else np.zeros(0, int)
    for k in range(len(EDGES) - 1):
        own = [v for v, at in zip(values, place, strict=True) if at == k]
        if own:
            hits = sum(v.right for v in own)
            rows.append((float(np.mean([v.probability for v in own])), hits, len(own), *interval(hits, len(own))))
    return rows


def brier(values: list[Stated]) -> tuple[float, float]:
    """Mean squared error of the probabilities, and what a calibrated one of these values expects: mean of p (1 -
    p)."""
    p = np.array([v.probability for v in values])
    return float(np.mean((p - [v.right for v in values]) ** 2)), float(np.mean(p * (1 - p)))


def table(values: list[Stated]) -> str:
    rows = ["| stated, mean | right | of | share | 95 % interval | holds the stated |", "|---|---|---|---|---|---|"]
    for mean, hits, n, low, high in bins(values):
        rows.append(
            f"| {mean:.3f} | {hits} | {n} | {hits / n:.2f} | {low:.2f} to {high:.2f} | "
            f"{'yes' if low <= mean <= high else 'no'} |"
        )
    if values:
        score, expected = brier(values)
        rows += ["", f"Brier score {score:.3f}; {expected:.3f} if calibrated."]
    return "\n".join(rows) + "\n"


def draw(series: dict[str, list[Stated]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axis = pyplot.subplots(figsize=(5.2, 5.0), layout="constrained")
    axis.plot([0, 1], [0, 1], color="0.6", linewidth=1, zorder=0)
    for (name, values), mark, colour in zip(series.items(), "os", ("tab:blue", "tab:orange"), strict=False):
        rows = bins(values)
        x = np.array([r[0] for r in rows])
        y = np.array([r[1] / r[2] for r in rows])
        low, high = y - [r[3] for r in rows], [r[4] for r in rows] - y
        axis.errorbar(
            x,
            y,
            yerr=np.clip([low, high], 0, None),
            fmt=mark,
            color=colour,
            capsize=3,
            markersize=5,
            label=f"{name} ({len(values)})",
        )
        for at, share, row in zip(x, y, rows, strict=True):
            axis.annotate(
                str(row[2]), (at, share), textcoords="offset points", xytext=(6, -10), fontsize=7, color=colour
            )
    axis.set(
        xlabel="stated probability", ylabel="share that was so, 95 % interval", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02)
    )
    axis.legend(loc="upper left", fontsize=8)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lines", type=Path, nargs="+")
    parser.add_argument("--figure", type=Path, help="draw the diagram there")
    a = parser.parse_args()
    lines = [json.loads(row) for path in a.lines for row in path.read_text(encoding="utf-8").splitlines()]
    values, without = stated(lines)
    if not values:
        sys.stderr.write("no line states a probability: run studies/blind/run.py of this version\n")
        return 2
    first = [v for v in values if v.first]
    sys.stdout.write(
        f"{len(lines)} records, {len({v.case for v in values})} with candidates, {without} findings without "
        f"probabilities left out\n\nFirst candidates:\n\n{table(first)}\nAll candidates:\n\n{table(values)}"
    )
    if a.figure:
        draw({"first of a finding": first, "all candidates": values}, a.figure)
    return 0


if __name__ == "__main__":
    sys.exit(main())
