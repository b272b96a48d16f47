"""A baseline from a run's directory, its update.json or its posterior.nc."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from probupdate.errors import InputError
from probupdate.updating.baseline import LearntError
from probupdate.updating.posterior_file import Posterior, read_posterior
from probupdate.updating.update_file import UpdateRecord, read_update

# a run's directory, its file, or what that holds
Baseline = str | Path | UpdateRecord | Posterior
# of a directory, the first that is there
FILES = ("posterior.nc", "update.json")


def read_baseline(run: Baseline) -> LearntError:
    """Raises InputError where a run holds no model's error."""
    where = f"baseline {run}" if isinstance(run, str | Path) else "baseline"
    if isinstance(run, str | Path):
        path = Path(run)
        if path.is_dir():
            there = [path / name for name in FILES if (path / name).is_file()]
            if not there:
                raise InputError(where, f"has no {' or '.join(FILES)}",
                                 "give the directory of a run, or one of its files")
            path = there[0]
        found = read_update(path) if path.suffix == ".json" else read_posterior(path)
    elif isinstance(run, UpdateRecord | Posterior):
        path, found = None, run
    else:
        raise InputError(where, f"a {type(run).__name__} is not a run",
                         "give its directory, update.json or posterior.nc")
    if found.model_error is None:
        raise InputError(where, "holds no error of its model: none was stated there, shapes were compared as MACs, or "
                         "an earlier version wrote it",
                         "run update or sample of that state again, with --discrepancy auto")
    return replace(found.model_error, source="" if path is None else str(path))
