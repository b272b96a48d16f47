"""Do posteriors of structures drawn at random hold their truth? From accelerations, by the steps' defaults.

python studies/other_worlds/posterior.py OUT [--family "null, masses"] [--first 1] [--most 12]

It goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from campaigns import write_campaign
from records import draw_record
from scipy import stats

import probupdate
from probupdate.errors import ProbupdateError


def held(family: str, number: int, folder: Path) -> dict:
    """Of each parameter where in its posterior the truth lies, by the draws' quantiles and in standard deviations."""
    record, begun = draw_record(family, number), time.process_time()
    folder = folder / f"{family.replace(', ', '_')}-{number}"
    path = record.world.write(folder / "model")
    data = probupdate.identify(write_campaign(record, folder / "campaign"), path, lowest=record.world.n_mode).data
    update = probupdate.update(path, data).to_frame().set_index("name")
    settings = probupdate.SamplerSettings(seed=number, target_ess=400)
    table = probupdate.sample(path, data, folder / "posterior.nc", settings=settings).to_frame().set_index("name")
    of_map = [abs(update.loc[p, "map"] - table.loc[p, "mean"]) / table.loc[p, "std"] for p in record.truth]
    return {"family": family, "number": number, "kind": record.world.kind,
            "z": {p: float((x - table.loc[p, "mean"]) / table.loc[p, "std"]) for p, x in record.truth.items()},
            "inside": {p: bool(table.loc[p, "q05"] <= x <= table.loc[p, "q95"]) for p, x in record.truth.items()},
            "share_of_prior": {p: float(table.loc[p, "std"] / record.world.std[p]) for p in record.truth},
            "map_from_mean": float(max(of_map)), "cpu_s": round(time.process_time() - begun, 1)}


def tables(lines: list[dict]) -> str:
    failed, lines = [x for x in lines if "failed" in x], [x for x in lines if "failed" not in x]
    if not lines:
        return "".join(f"{x['family']} {x['number']} failed: {x['failed']}\n" for x in failed)
    inside = [x for line in lines for x in line["inside"].values()]
    z = np.array([x for line in lines for x in line["z"].values()])
    told = np.array([x for line in lines for x in line["share_of_prior"].values()]) < 0.7
    low, high = stats.binomtest(sum(inside), len(inside)).proportion_ci()
    rows = [f"records {len(lines)}, parameters {len(inside)}: 90 % intervals hold {np.mean(inside):.1%} "
            f"({low:.0%} to {high:.0%}), z of {np.sqrt(np.mean(z**2)):.2f}",
            f"of {told.sum()} whose standard deviation is below 0.7 of the prior's: "
            f"{np.mean(np.array(inside)[told]):.1%}"]
    for kind in dict.fromkeys(line["kind"] for line in lines):
        own = [x for line in lines if line["kind"] == kind for x in line["inside"].values()]
        rows.append(f"{kind}: {sum(own)} of {len(own)}")
    rows += [f"{x['family']} {x['number']} failed: {x['failed']}" for x in failed]
    return "\n".join(rows) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--family", default="null, masses", choices=("null", "null, masses"))
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--most", type=int, default=12)
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    path = a.out / "posteriors.jsonl"
    lines = [json.loads(x) for x in path.read_text().splitlines()] if path.is_file() else []
    for number in range(a.first, a.first + a.most):
        if all((x["family"], x["number"]) != (a.family, number) for x in lines):
            try:
                lines.append(held(a.family, number, a.out))
            except ProbupdateError as error:
                lines.append({"family": a.family, "number": number, "failed": str(error)})
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(lines[-1]) + "\n")
    sys.stdout.write(tables(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
