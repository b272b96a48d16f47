"""Two runs beside each other: two models, two likelihoods, two months."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.diagnosis.results import read_diagnosis
from probupdate.errors import InputError
from probupdate.identification.regression import hours_of_sets, mean_over_time
from probupdate.io.files import write_json, write_table
from probupdate.io.result_table import table_of
from probupdate.modal.modes import ModalData, read_modes
from probupdate.modal.rounding import rounding_std
from probupdate.reporting.run_files import run_places
from probupdate.updating.posterior_file import Posterior, read_posterior

if TYPE_CHECKING:
    import pandas as pd

# a difference in its own standard deviations that is named in the summary
NAMED = 2.0
STATED = {"frequency_hz": "frequency_std_hz", "damping_ratio": "damping_ratio_std"}


@dataclass(frozen=True, kw_only=True)
class RunRow:
    """A number of both runs: kind ('parameter', 'frequency', 'damping ratio'), name, value and standard deviation in
    each (None where a run does not have it), and the difference over the root of both variances."""

    kind: str
    name: str
    unit: str
    first: float | None
    first_std: float | None
    second: float | None
    second_std: float | None
    standardised: float | None


@dataclass(frozen=True, eq=False, kw_only=True)
class RunComparison:
    """rows; verdict of the sampler, weights, ln evidence and diagnosis of each run by name; notes: what must be known
    before the numbers are compared."""

    runs: tuple[str, str]
    rows: tuple[RunRow, ...]
    statements: tuple[tuple[str, str, str], ...]
    notes: tuple[str, ...]

    def to_frame(self) -> pd.DataFrame:
        """A row a number."""
        return table_of(self.rows, tuple(RunRow.__dataclass_fields__), units={
            name: "as `unit` says" for name in ("first", "first_std", "second", "second_std")})

    @property
    def summary(self) -> str:
        apart = [r for r in self.rows if r.standardised is not None and abs(r.standardised) > NAMED]
        both = sum(r.standardised is not None for r in self.rows)
        lines = [f"{self.runs[0]} (first) and {self.runs[1]} (second): {len(apart)} of {both} numbers differ by more "
                 f"than {NAMED:g} standard deviations"]
        lines += [f"  {r.kind} {r.name}: {_value(r.first, r.first_std)} and {_value(r.second, r.second_std)} {r.unit} "
                  f"({r.standardised:+.1f})" for r in sorted(apart, key=lambda r: -abs(r.standardised or 0.0))]
        lines += [f"{what}: {a} (both)" if a == b else f"{what}: {a} | {b}" for what, a, b in self.statements]
        return "\n".join([*lines, *(f"note: {text}" for text in self.notes)])

    def write(self, out: str | Path) -> Path:
        """A CSV of the rows, or JSON of everything, by the ending of the name."""
        out = Path(out)
        if out.suffix.lower() == ".csv":
            return write_table(out, self.to_frame())
        return write_json(out, {
            "format": 1, "runs": list(self.runs), "rows": [dict(r.__dict__) for r in self.rows],
            "statements": [list(s) for s in self.statements], "notes": list(self.notes)})


def _value(value: float | None, std: float | None) -> str:
    return "none" if value is None else f"{value:.4g}" if std is None else f"{value:.4g} ± {std:.2g}"


def compare_runs(first: str | Path, second: str | Path) -> RunComparison:
    """Parameters of both posteriors, mean frequencies and damping ratios of both sets of modes, evidence and diagnosis.
    Raises InputError for a folder that holds neither posterior.nc nor modes.json."""
    folders = Path(first), Path(second)
    places = [run_places(folder) for folder in folders]
    for folder, held in zip(folders, places, strict=True):
        if not {"posterior.nc", "modes.json"} & set(held):
            raise InputError(str(folder), "holds neither posterior.nc nor modes.json",
                             "give directories that `sample` or `identify` wrote into")
    posteriors = [read_posterior(p["posterior.nc"]) if "posterior.nc" in p else None for p in places]
    modes = [read_modes(p["modes.json"]) if "modes.json" in p else None for p in places]
    rows = [*_parameter_rows(*posteriors), *_mode_rows(*modes)]
    verdicts = [read_diagnosis(p["diagnosis.json"]) if "diagnosis.json" in p else None for p in places]
    statements = [
        ("sampler", *("none" if p is None else p.verdict for p in posteriors)),
        ("weights", *("none" if p is None else str(p.record.get("weights", "not stated")) for p in posteriors)),
        ("ln evidence", *(_evidence(p) for p in posteriors)),
        ("diagnosis", *(_verdict_text(d) for d in verdicts)),
        ("modal sets", *("none" if m is None else str(len(m.sets)) for m in modes)),
    ]
    return RunComparison(runs=(str(folders[0]), str(folders[1])), rows=tuple(rows),
                         statements=tuple((w, a, b) for w, a, b in statements), notes=tuple(_notes(*posteriors)))


def _row(kind: str, name: str, unit: str, a, b) -> RunRow:
    """a, b: (value, standard deviation), or None."""
    apart = None
    if a is not None and b is not None:
        spread = float(np.hypot(*(np.nan if std is None else std for _, std in (a, b))))
        apart = float((b[0] - a[0]) / spread) if np.isfinite(spread) and spread > 0 else None
    (x, sx), (y, sy) = (pair or (None, None) for pair in (a, b))
    return RunRow(kind=kind, name=name, unit=unit, first=x, first_std=sx, second=y, second_std=sy, standardised=apart)


def _parameter_rows(a: Posterior | None, b: Posterior | None) -> list[RunRow]:
    def means_and_stds(p: Posterior | None) -> dict[str, tuple[float, float]]:
        if p is None:
            return {}
        return {n: (float(c.mean()), float(c.std(ddof=1))) for n, c in zip(p.names, p.draws.T, strict=True)}

    own = means_and_stds(a), means_and_stds(b)
    return [_row("parameter", name, "its own", own[0].get(name), own[1].get(name))
            for name in dict.fromkeys([*own[0], *own[1]])]


def _mode_rows(a: ModalData | None, b: ModalData | None) -> list[RunRow]:
    rows = []
    for kind, unit, key in (("frequency", "Hz", "frequency_hz"), ("damping ratio", "-", "damping_ratio")):
        own = _means(a, key), _means(b, key)
        rows += [_row(kind, name, unit, own[0].get(name), own[1].get(name))
                 for name in dict.fromkeys([*own[0], *own[1]])]
    return rows


def _means(data: ModalData | None, key: str) -> dict[str, tuple[float, float | None]]:
    """Label -> mean over the sets and its standard deviation from their scatter in time, that of rounding at least; of
    one set what it states, if it does."""
    if data is None or data.labels is None:
        return {}
    found = {}
    every = np.array([getattr(s, key) for s in data.sets], float)
    stated = np.array([getattr(s, STATED[key]) for s in data.sets], float)
    hours, rounding = hours_of_sets(data.sets), rounding_std(every)
    order = np.arange(len(every)) if hours is None else np.argsort(hours, kind="stable")
    time = order if hours is None else hours[order]
    for k, label in enumerate(data.labels):
        values = every[order, k]
        there = np.isfinite(values)
        if there.sum() > 1:
            mean, std = mean_over_time(values[there], time[there])
        elif there.any():
            mean, std = float(values[there][0]), float(stated[order, k][there][0])
        else:
            continue
        found[label] = mean, float(max(std, rounding[k])) if np.isfinite(std) else None
    return found


def _evidence(p: Posterior | None) -> str:
    held = {} if p is None else p.record.get("evidence") or {}
    value, std = (held.get(key) if isinstance(held, dict) else None for key in ("log_evidence", "std"))
    return "not known" if value is None else f"{value:.2f}" + ("" if std is None else f" ± {std:.2g}")


def _verdict_text(diagnosis: dict | None) -> str:
    if diagnosis is None:
        return "not made"
    causes = "; ".join(f"{f['cause']} {f['location']} {f['size']:.3g} ± {f['size_std']:.2g}".strip()
                       for f in diagnosis["findings"])
    return diagnosis["verdict"] + (f" ({causes})" if causes else "")


def _notes(a: Posterior | None, b: Posterior | None) -> list[str]:
    notes = ["differences are over both runs' standard deviations as if they were independent: runs of one record, or "
             "of one model with its error, share much of them, and what lasts longer than a run differs between runs"]
    if a is None or b is None:
        return notes
    if a.names != b.names:
        notes.append("the models have other parameters: equal names may mean other things")
    if a.response_labels != b.response_labels or not np.array_equal(a.measured, b.measured):
        notes.append("ln evidence is of other data in each run, so that the two numbers are not to be compared")
    if not (a.converged and b.converged):
        notes.append("a sampler did not converge: its standard deviations are not to be relied on")
    return notes
