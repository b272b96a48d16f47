"""The demonstration's folder that a benchmark is given, with what the demonstration wrote."""

from __future__ import annotations

import argparse
from pathlib import Path

import probupdate


def asked(words: str | None) -> argparse.Namespace:
    """run and repeat of the command line, `words` its help; the demonstration is run where its folder is not whole."""
    parser = argparse.ArgumentParser(description=words, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--repeat", type=int, default=1)
    a = parser.parse_args()
    if not (a.run / "report.html").exists():
        probupdate.demo(a.run, jobs=2)
    return a
