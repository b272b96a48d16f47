"""The README's picture: what the demonstration found beside what was hidden in it.

make demo; python studies/discovery/demonstration.py out
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from probupdate.reporting.figures import sizes_found
from probupdate.reporting.style import save_figure
from probupdate.virtual.effects import hidden_words
from probupdate.virtual.turbine_file import read_toml


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="a demonstration's folder")
    out = parser.parse_args().out
    (truth,) = out.rglob("truth.toml")
    hidden = [hidden_words(e) for e in read_toml(truth, "truth file").get("effect", ())]
    findings = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))["findings"]
    save_figure(sizes_found(findings, hidden), Path(__file__).with_name("demonstration.png"))


if __name__ == "__main__":
    main()
