"""A run directory to the values the page shows. What is not there is named; what is there and broken is an error."""

from __future__ import annotations

from pathlib import Path

from probupdate.errors import InputError
from probupdate.modes import read_modes
from probupdate.progress import Progress
from probupdate.reporting.values import Run

# file or folder of a run -> what the page says when it is not there
PARTS = {
    "campaign": "the campaign (campaign/)",
    "modes.json": "identified modes (modes.json)",
    "modes.poles.csv": "the table of poles (modes.poles.csv)",
    "selection.csv": "the reasons of the selection (selection.csv)",
    "nine.json": "selected sets (nine.json)",
    "update.json": "the update (update.json)",
    "posterior.nc": "the posterior (posterior.nc)",
    "compare.json": "the comparison (compare.json)",
}


def read_run(folder: Path, progress: Progress) -> Run:
    """Everything the directory holds. Raises InputError where it is no directory or holds nothing of a run."""
    if not folder.is_dir():
        raise InputError(str(folder), "is not a directory", "give the directory that the steps wrote into")
    missing = tuple(words for name, words in PARTS.items() if not (folder / name).exists())
    if len(missing) == len(PARTS):
        raise InputError(str(folder), "holds nothing of a run", f"expected some of {', '.join(PARTS)}")
    modes = read_modes(folder / "modes.json") if (folder / "modes.json").exists() else None
    nine = read_modes(folder / "nine.json") if (folder / "nine.json").exists() else None
    return Run(folder=folder, title=folder.resolve().name, missing=missing, provenance=(), modes=modes, nine=nine)
