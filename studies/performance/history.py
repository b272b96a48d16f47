"""Ratios of benchmarks over the project's history: a run's are added to history.csv, and the page is made from all.

    python -m studies.performance --out DIR          # the benchmarks, with DIR/study.json and DIR/printed.txt
    python studies/performance/history.py [DIR]      # adds that run, writes docs/benchmarks.md and benchmarks.svg

A ratio compares two ways within one run, so that machines and what else they do matter less than to seconds. Without
DIR the page alone is written. A commit's row replaces an earlier one of the same ratio.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "studies" / "performance" / "history.csv"
COLUMNS = ("date", "commit", "machine", "cores", "python", "ratio", "value")
# ratio -> (what it compares, where it stands in what the benchmarks print)
RATIOS = {
    "identification": ("a block's poles: plain numpy over this package",
                       r"^without deviations: .*ratio ([\d.]+)"),
    "identification, std": ("the same with standard deviations of all poles, by plain numpy each part again",
                            r"^with deviations of all poles: .*ratio ([\d.]+)"),
    "reduced basis": ("modes a second: reduced basis, 1000 points at once, over the full model",
                      r"^reduced basis, 1000 at once +[\d.]+ +([\d.]+)"),
    "sampler": ("effective draws a second over emcee's stretch move; later, all of `sample` over its evolution moves",
                r"^all of sample over emcee, ten parameters: ([\d.]+)"),
    "report": ("a report's sections: matplotlib's own layout over ticks found once",
               r"^a page of .*? ratio ([\d.]+); .*pages are the same"),
}


def found(run: Path) -> list[dict[str, str]]:
    """A row for every ratio that the run in this folder printed."""
    study = json.loads((run / "study.json").read_text(encoding="utf-8"))
    printed = (run / "printed.txt").read_text(encoding="utf-8")
    head = {name: str(study[name]) for name in COLUMNS[:5]}
    matches = {name: re.search(pattern, printed, re.MULTILINE) for name, (_, pattern) in RATIOS.items()}
    return [{**head, "ratio": name, "value": match[1]} for name, match in matches.items() if match]


def merged(rows: list[dict[str, str]], new: list[dict[str, str]]) -> list[dict[str, str]]:
    """In the order of their dates; a commit has one value of a ratio, the last."""
    by_key = {(row["commit"], row["ratio"]): row for row in [*rows, *new]}
    return sorted(by_key.values(), key=lambda row: row["date"])


def page(rows: list[dict[str, str]]) -> str:
    """The page as Markdown text: a line a commit."""
    commits = dict.fromkeys(row["commit"] for row in rows)
    value = {(row["commit"], row["ratio"]): row["value"] for row in rows}
    line = "{date} | `{commit}` | {machine}, {cores} cores, Python {python}"
    head = {row["commit"]: line.format(**row) for row in rows}
    lines = ["# Benchmarks over time", "",
             "Each ratio compares two ways within one run; more is faster. Written by",
             "`python studies/performance/history.py` from `history.csv`; what the benchmarks do, and seconds, stand",
             "in [studies/performance](../studies/performance/RESULTS.md). The first five commits were measured on",
             "2026-11-23, each by its own script, but `3be15b6`, whose ratios are that page's. No ratio is measured at",
             "every commit.", "",
             *(f"- {name}: {what}." for name, (what, _) in RATIOS.items()), "",
             "![Ratios over the commits at which they were measured](benchmarks.svg)", "",
             f"| date | commit | machine | {' | '.join(RATIOS)} |", f"|---|---|---|{'---|' * len(RATIOS)}"]
    lines += [f"| {head[c]} | {' | '.join(value.get((c, name), '') for name in RATIOS)} |" for c in commits]
    return "\n".join(lines) + "\n"


def draw(rows: list[dict[str, str]], path: Path) -> None:
    from probupdate.reporting import style

    @style.with_style
    def figure():
        drawn = style.new_figure(style.FULL_IN, 3.0)
        axes = drawn.subplots()
        commits = list(dict.fromkeys(row["commit"] for row in rows))
        looks = ((style.BLUE, "o"), (style.ORANGE, "s"), (style.GREEN, "^"), (style.RED, "v"), (style.PURPLE, "P"))
        for (color, marker), name in zip(looks, RATIOS, strict=True):
            mine = [row for row in rows if row["ratio"] == name]
            place = [commits.index(row["commit"]) for row in mine]
            axes.plot(place, [float(row["value"]) for row in mine], color=color, marker=marker, ms=5, label=name)
        axes.set_yscale("log")
        axes.set_yticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
        axes.yaxis.set_minor_formatter(lambda value, _: "")
        axes.set_xticks(range(len(commits)), commits)
        style.label_axes(axes, "commit", "ratio [-]")
        drawn.legend(loc="outside upper left", ncols=len(RATIOS))
        return drawn

    style.save_figure(figure(), path)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, nargs="?", metavar="DIR", help="folder of a run of the benchmarks")
    a = parser.parse_args(arguments)
    with open(TABLE, encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    if a.run is not None:
        new = found(a.run)
        if not new:
            parser.error(f"{a.run / 'printed.txt'} has no ratio of a benchmark")
        rows = merged(rows, new)
        with open(TABLE, "w", encoding="utf-8", newline="") as stream:
            table = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(rows)
    (ROOT / "docs" / "benchmarks.md").write_text(page(rows), encoding="utf-8")
    draw(rows, ROOT / "docs" / "benchmarks.svg")
    return 0


if __name__ == "__main__":
    sys.exit(main())
