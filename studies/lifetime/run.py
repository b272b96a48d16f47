"""From a run's posterior to the remaining life of its three worst hot spots: exports, then writes one page.

    probupdate demo RUN
    python studies/lifetime/run.py RUN OUT [--draws 100]

Loads, details and uncertainties are those of fatigue.toml beside this file. OUT/export is the export, OUT/RESULTS.md
the page; a finished export is taken as it is.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import probupdate
from probupdate.io.files import read_json
from probupdate.lifetime.tables import read_table

HERE = Path(__file__).parent
WORST = 3


def page(folder: Path) -> str:
    manifest = read_json(folder / "manifest.json")
    spots, factors, life, index, next_ = (
        read_table(folder / f"{name}.csv")
        for name in ("hot_spots", "model_factors", "remaining_life", "reliability", "next_measurement")
    )
    place = {n: k for k, n in enumerate(spots["hot_spot"])}

    def name(spot: int) -> str:
        k = place[spot]
        return f"{spots['member'][k]}, {spots['side'][k]}, {spots['angle_deg'][k]:.0f} deg"

    rows = list(
        zip(life["case"], life["hot_spot"], *(life[q] for q in ("q05", "q25", "q50", "q75", "q95")), strict=True)
    )
    own = sorted((r for r in rows if r[0] == "updated"), key=lambda r: r[4])[:WORST]
    worst = [r[1] for r in own]
    first = {
        (c, h): y for c, h, y in zip(index["case"], index["hot_spot"], index["first_year_below_target"], strict=True)
    }
    cases = list(dict.fromkeys(life["case"]))
    summary = manifest["fatigue"]
    lines = [
        f"Export: {manifest['verdict']}; {manifest['draws']} draws; basis within {100 * summary['basis_error']:.2g} % "
        f"of the full model's ranges; FORM and Monte Carlo within {summary['form_minus_monte_carlo']:.3f} (standard "
        f"error {summary['monte_carlo_standard_error']:.3f}).",
        "",
        "| hot spot | case | remaining life, years: 5 % | median | 95 % | "
        f"first year with an annual index below {summary['target_annual_index']:g} |",
        "|---|---|---|---|---|---|",
    ]
    for spot in worst:
        for case in cases:
            r = next(r for r in rows if r[:2] == (case, spot))
            year = first[case, spot]
            lines.append(
                f"| {spot}: {name(spot)} | {case} | {r[2]:.0f} | {r[4]:.0f} | {r[6]:.0f} | {year or 'none'} |"
            )
    lines += [
        "",
        "| hot spot | X_dyn, median | CoV | measurement | tolerance | set to set | model form | prior |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for k, of in enumerate(factors["of"]):
        number = of.split(":")[0].removeprefix("hot spot ")
        if factors["quantity"][k] == "stress range" and int(number) in worst:
            parts = " | ".join(
                f"{factors[f'cov_{p}'][k]:.3f}"
                for p in ("measurement", "tolerance", "set_to_set", "model_form", "prior")
            )
            lines.append(f"| {number} | {factors['bias'][k]:.3f} | {factors['cov'][k]:.3f} | {parts} |")
    lines += ["", "| quantity | X, median | CoV |", "|---|---|---|"]
    for k, of in enumerate(factors["of"]):
        if factors["quantity"][k] != "stress range" and of in ("FA1", "SS1", "T1", "FA2", "SS2"):
            lines.append(f"| {factors['quantity'][k]} of {of} | {factors['bias'][k]:.3f} | {factors['cov'][k]:.3f} |")
    lines += [
        "",
        f"| one more measurement | CoV of X_dyn at hot spot {worst[0]}, now and then | first year below the target, "
        "now and then |",
        "|---|---|---|",
    ]
    for k, what in enumerate(next_["measure"]):
        if next_["hot_spot"][k] == worst[0]:
            years = [next_[f"first_year_below_target_{w}"][k] or "none" for w in ("now", "then")]
            lines.append(f"| {what} | {next_['cov_now'][k]:.4f}, {next_['cov_then'][k]:.4f} | {years[0]}, {years[1]} |")
    ratio = {
        key: np.array(v)
        for key, v in read_table(folder / "fatigue.csv").items()
        if key in ("draw", "hot_spot", "ratio_m5")
    }
    drawn = ratio["draw"] > 0
    mean = np.array([ratio["ratio_m5"][drawn & (ratio["hot_spot"] == s)].mean() for s in spots["hot_spot"][::8]])
    lines += [
        "",
        f"Over every eighth hot spot (crowns) DEL_5 updated over design lies between {mean.min():.2f} and "
        f"{mean.max():.2f}, "
        f"median {np.median(mean):.2f}.",
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--draws", type=int, default=100)
    a = parser.parse_args()
    folder = a.out / "export"
    if not (folder / "manifest.json").exists():
        probupdate.export(a.run, folder, draws=a.draws, fatigue=HERE / "fatigue.toml")
    text = page(folder)
    (a.out / "RESULTS.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
