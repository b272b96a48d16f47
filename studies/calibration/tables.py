"""What came out of `run.py`: for each case coverage with binomial bands, uniformity of ranks, histograms.

    python studies/calibration/tables.py OUT
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from ranks import LEVELS, band, coverage, histogram, uniformity
from run import read_lines

INTERVALS = (("posterior", "rank"), ("MAP, Gauss-Newton", "rank_map"), ("Eq. 7, 10 iterations", "rank_printed"),
             ("MAP, scatter of nine", "rank_nine"))


def table(lines: list[dict]) -> str:
    """Markdown of one case."""
    good = [line for line in lines if "refused" not in line]
    names = good[0]["names"]
    text = [f"{len(good)} replicates, {len(lines) - len(good)} refused; drawn by the chain in "
            f"{sum(line['by'] == 'chain' for line in good)}; effective draws {_low(good, 'effective'):.0f} at least, "
            f"Pareto k {max(line['pareto_k'] for line in good):.2f} at most; misfit at the truth "
            f"{np.mean([line['misfit'] for line in good]):.1f} where {good[0]['n_effective']} is expected", ""]
    for title, key in INTERVALS:
        rows = np.array([line[key] for line in good if key in line])
        if not len(rows):
            continue
        columns = list(names)
        if key == "rank":
            rows = np.column_stack([rows, [line["rank_log_likelihood"] for line in good]])
            columns.append("log-likelihood")
        bands = {level: band(level, len(rows)) for level in LEVELS}
        limits = ", ".join(f"{100 * level:.0f} %: {100 * a:.0f} to {100 * b:.0f} %" for level, (a, b) in bands.items())
        text += [f"{title}, {len(rows)} replicates (calibrated {limits})", "",
                 "| | " + " | ".join(f"{100 * level:.0f} %" for level in LEVELS) + " | p uniform | tenths |",
                 "|---|" + "---|" * (len(LEVELS) + 2)]
        for name, column in zip(columns, rows.T, strict=True):
            shares = [_marked(coverage(column, level), bands[level]) for level in LEVELS]
            counts = " ".join(str(k) for k in histogram(column))
            text.append(f"| {name} | {' | '.join(shares)} | {uniformity(column):.2g} | {counts} |")
        text.append("")
    return "\n".join(text)


def _low(lines: list[dict], key: str) -> float:
    return min(line[key] for line in lines)


def _marked(share: float, limits: tuple[float, float]) -> str:
    """In bold where it lies outside the band."""
    text = f"{100 * share:.0f}"
    return text if limits[0] <= share <= limits[1] else f"**{text}**"


def main() -> int:
    folder = Path(sys.argv[1])
    for case in sorted({path.name.split(".")[0] for path in folder.glob("*.jsonl")}):
        sys.stdout.write(f"## {case}\n\n{table(read_lines(folder, case))}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
