"""A run whose posterior goes on to a lifetime: of which state of the structure its draws are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from probupdate.diagnosis.results import read_diagnosis
from probupdate.diagnosis.wording import finding_words, structural_changes
from probupdate.io.files import resolve_path
from probupdate.modal.modes import read_modes
from probupdate.reporting.run_files import refuse_unfinished, run_places

if TYPE_CHECKING:
    from probupdate.updating.posterior_file import Posterior

# what `diagnose` states as --out of the `sample` of the state after
OF_STATE_AFTER = "diagnosis.posterior.nc"


@dataclass(frozen=True, eq=False, kw_only=True)
class FinishedRun:
    """places: what lies where; diagnosis: content of diagnosis.json, None without one; changes: of the structure, in
    words, within the sets that the draws are of; since: when the last change before these sets began, None where none
    is known; included: whether the draws are of the mean of blocks in which all findings act."""

    places: Mapping[str, Path]
    posterior: Posterior
    diagnosis: Mapping | None
    changes: tuple[str, ...]
    since: pd.Timestamp | None
    included: bool

    @property
    def notes(self) -> tuple[str, ...]:
        """Which posterior it is, where a run has two."""
        if self.places["posterior.nc"].name != OF_STATE_AFTER:
            return ()
        return (f"posterior of the state after the change: {OF_STATE_AFTER}, {self.posterior.sets}",)


def finished_run(folder: Path, given: Mapping[str, Path]) -> FinishedRun:
    """Of a run directory with a model and a posterior; given: model and parameters that lie elsewhere. Where no
    posterior.nc is there, or the structure changed within its sets, the draws are those of the state after, with the
    model that holds the findings, if they were sampled as `diagnose` states. Raises InputError without a posterior."""
    from probupdate.updating.posterior_file import read_posterior

    places = run_places(folder, given)
    content = read_diagnosis(places["diagnosis.json"]) if "diagnosis.json" in places else None
    mean = _sets_of_mean(folder, content)
    after = folder / OF_STATE_AFTER
    own = read_posterior(places["posterior.nc"]) if "posterior.nc" in places else None
    if content is not None and after.is_file() and (own is None or _changes_within(content, own, mean)):
        extended = content.get("extended_model")
        places |= {"posterior.nc": after}
        if extended and "model" not in given and (folder / extended).is_file():
            places["model"] = folder / extended
        own = read_posterior(after)
    refuse_unfinished(folder, places)
    within = [] if content is None else _changes_within(content, own, mean)
    before = [_time(f.get("since")) for f in structural_changes(content or {})
              if f not in within and f["time_profile"] == "step"]
    return FinishedRun(
        places=places, posterior=own, diagnosis=content, changes=tuple(finding_words(f, content) for f in within),
        since=max((t for t in before if t is not None), default=None), included=own.record.get("set_id") in mean)


def _sets_of_mean(folder: Path, content: Mapping | None) -> set[str]:
    """Of the diagnosis's mean of the blocks in which its findings act."""
    name = (((content or {}).get("extension") or {}).get("files") or {}).get("mean")
    path = None if not name else resolve_path(str(name), folder, f"{folder / 'diagnosis.json'}, extension")
    return set() if path is None or not path.is_file() else {s.id for s in read_modes(path).sets}


def _changes_within(content: Mapping, posterior: Posterior, mean: set[str]) -> Sequence[Mapping]:
    """Findings with which the structure changed, but for those that had begun when the draws' first set was measured:
    what grows is within them."""
    first = posterior.first_set

    def had_begun(finding: Mapping) -> bool:
        begun, start = _time(finding.get("since")), _time(first)
        return first in mean or (begun is not None and start is not None and start >= begun)

    return [f for f in structural_changes(content) if f["time_profile"] != "step" or not had_begun(f)]


def _time(text: object) -> pd.Timestamp | None:
    """None of what is no time, such as a set's number."""
    found = pd.to_datetime(str(text), utc=True, errors="coerce", format="ISO8601")
    return None if found is pd.NaT else found
