"""The whole job on the OC4 jacket with tower: measured on a second theory with one effect hidden, then every
command."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import case

from probupdate.cli import main as probupdate
from probupdate.io.subdyn_file import read_subdyn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared/reference/oc4")
    parser.add_argument("--hours", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    a = parser.parse_args()
    model, causes = case.write_models(a.data, a.out)
    file = read_subdyn(model.with_name(case.INPUT))
    places = case.sensors(file)
    theory = case.truth(file)
    case.write_campaign(a.out / "campaign", theory, places, hours=a.hours, seed=a.seed)
    frequency, _ = case.seen(theory, places, 8)
    sys.stdout.write(f"true frequencies {frequency.round(5).tolist()}\n")
    out = {name: str(a.out / name) for name in ("modes.json", "nine.json", "update.json", "posterior.nc",
                                                "compare.json", "diagnosis.json")}
    own = ["--model", str(model)]
    for words in (
        ["modes", str(model), "--count", "8"],
        ["identify", str(a.out / "campaign"), *own, "--rate", "10", "--out", out["modes.json"]],
        ["update", *own, "--modes", out["modes.json"], "--out", out["update.json"]],
        ["sample", *own, "--modes", out["modes.json"], "--out", out["posterior.nc"], "--seed", str(a.seed)],
        ["compare", out["update.json"], out["posterior.nc"], *own, "--out", out["compare.json"]],
        ["diagnose", "--model", str(causes), "--modes", out["modes.json"], "--out", out["diagnosis.json"], "--seed",
         str(a.seed)],
        ["export", str(a.out), "--to", "lifetime", str(a.out / "lifetime"), "--draws", "50", "--seed", str(a.seed),
         "--fatigue", str(Path(__file__).with_name("fatigue.toml"))],
    ):
        start = time.perf_counter()
        code = probupdate(words)
        sys.stdout.write(f"[{words[0]}: {code}, {time.perf_counter() - start:.0f} s]\n")
    found = json.loads(Path(out["diagnosis.json"]).read_text())
    for f in found["findings"]:
        sys.stdout.write(f"{f['cause']} {f['location']} {f['size']:+.3f} +- {f['size_std']:.3f}\n")


if __name__ == "__main__":
    main()
