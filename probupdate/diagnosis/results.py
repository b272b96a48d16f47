"""What a diagnosis says: verdict, findings, minimum detectable sizes; and diagnosis.json."""

from __future__ import annotations

import json
import re
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.diagnosis import wording
from probupdate.errors import InputError
from probupdate.io.checksum import checksum_of_table
from probupdate.io.files import read_json_table, write_text
from probupdate.io.result_table import OWN_UNIT, table_of
from probupdate.io.schema import checked_table

if TYPE_CHECKING:
    import pandas as pd

# of diagnosis.json; files without one have the keys of FORMER_KEYS
FORMAT = 2
FORMER_KEYS = {"course": "time_profile", "course_name": "time_profile_name", "limits": "detectable_sizes",
               "limit": "size", "pushed": "prior_shift", "pushed_after": "prior_shift_after"}
VERDICTS = ("named", "ambiguous", "unexplained", "none")


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """What may be meant instead: its words, and the identity (`key`) of its row of the catalogue."""

    cause: str
    location: str
    posterior_probability: float
    key: Hashable = field(default=None, repr=False)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One effect: cause, place, size with standard deviation in `unit`, time profile along the record, score z against
    what is normal, probability among its competing hypotheses with the data and by their prior odds alone, what would
    split it from them; the identity (`key`) of its row of the catalogue."""

    kind: str
    cause: str
    location: str
    size: float
    size_std: float
    unit: str
    time_profile: str
    time_profile_start: str
    z: float
    posterior_probability: float
    alternatives: tuple[Alternative, ...]
    check: str
    prior_probability: float = float("nan")
    gain: dict = field(default_factory=dict, repr=False)
    key: Hashable = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Cause and place in words, as terminal and report have them."""
        return wording.name_of({"cause": self.cause, "location": self.location})


@dataclass(frozen=True, kw_only=True)
class DetectableSize:
    """The least size of a candidate that would be found in nine of ten records like this one; `share_left` of its
    signature that what is normal leaves; z as found; the identity (`key`) of its row of the catalogue."""

    kind: str
    cause: str
    location: str
    time_profile: str
    size: float
    unit: str
    share_left: float
    z: float
    key: Hashable = field(default=None, repr=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis:
    """The whole answer; `threshold` of |z|: of the whole catalogue before any finding is included (without a model of
    the first look, the lower one of frequencies and sensors). `inputs`: "model" and "modes", each name -> SHA-256 of
    the files that it is of. `summary` is for people, `content` for files."""

    verdict: str
    p_value: float
    findings: tuple[Finding, ...]
    detectable_sizes: tuple[DetectableSize, ...] = field(repr=False)
    threshold: float
    adequacy_p: float
    notes: tuple[str, ...]
    parameters: tuple[dict, ...] = field(repr=False)
    extended_model: str | None = None
    extension: dict = field(default_factory=dict, repr=False)
    splits: tuple[str, ...] = ()
    details: dict = field(default_factory=dict, repr=False)
    inputs: Mapping[str, Mapping[str, str]] = field(default_factory=dict, repr=False)

    def to_frame(self) -> pd.DataFrame:
        """A row a finding; size in its `unit`."""
        names = ("kind", "cause", "location", "size", "size_std", "unit", "time_profile", "time_profile_start", "z",
                 "posterior_probability", "prior_probability", "check")
        return table_of([{n: getattr(f, n) for n in names} for f in self.findings], names,
                        units={"size": OWN_UNIT, "size_std": OWN_UNIT})

    @property
    def summary(self) -> str:
        """What the terminal says: verdict, findings with the check of each, what would split them, what was shifted,
        what would not have been seen, what was left out."""
        from probupdate.diagnosis.search import FALSE_ALARM

        content = self.content()
        lines = [f"verdict: {self.verdict}", wording.verdict_words(content)]
        for f in content["findings"]:
            score = [f"score {f['z']:z.1f}"] if f["z"] is not None else []
            said = ", ".join([*score, wording.cause_probability_words(f)])
            lines.append(f"  {wording.finding_words(f, content)}; {said}")
            lines_of = (("or", wording.alternatives_words(f)), ("to confirm", f["check"]),
                        ("on held-out blocks", wording.gain_words(f)))
            lines += [f"    {word}: {text}" for word, text in lines_of if text]
        lines += [f"  to split them: {s}" for s in self.splits]
        lines += [f"  {s}" for s in (wording.nearest_words(content), *wording.free_form_words(content)) if s]
        level = ("odds of ten over nothing" if self.details.get("without_model")
                 else f"{100 * FALSE_ALARM:g} % of false alarms")
        alarms = "" if content["threshold"] is None else f" ({level})"
        lines.append(f"{wording.threshold_words(content)}{alarms}; "
                     f"{wording.adequacy_words(content) or 'the residuals were not tested'}")
        lines += [f"shifted: {s}" for s in wording.prior_shift_words(content)]
        detectable_sizes = wording.best_detectable(content, 5)
        if detectable_sizes:
            count = sum(x["size"] is not None for x in content["detectable_sizes"])
            lines.append(f"seen best, each cause at its best place ({count} minimum detectable sizes in the file and "
                         "the report):")
            lines += [f"  {wording.detectable_words(x, content)}" for x in detectable_sizes]
        lines += [f"note: {note}" for note in self.notes]
        if self.extended_model:
            mean = (self.extension.get("files") or {}).get("mean")
            lines.append(f"the model with what was found, beside diagnosis.json: {self.extended_model}"
                         f"{f', and the modes that belong to it: {mean}' if mean else ''}")
        lines += [f"  {s}" for s in self.extension.get("statements", ())]
        return "\n".join(lines)

    def left_unexplained(self) -> Diagnosis:
        """The same with what was found as what comes nearest, in words: cause, size, time profile, probability."""
        content = self.content()
        nearest = [f"{wording.finding_words(f, content)}, {wording.cause_probability_words(f)}"
                   for f in content["findings"]]
        return replace(self, verdict="unexplained", findings=(), details={**self.details, "nearest": nearest})

    def content(self) -> dict:
        """As in diagnosis.json."""
        row: dict[Hashable, int] = {}
        for x in self.detectable_sizes:
            row.setdefault(x.key or (x.cause, x.location), len(row))
        return {
            "format": FORMAT,
            "verdict": self.verdict,
            "p_value": _plain(self.p_value),
            "findings": [
                {
                    "kind": f.kind, "cause": f.cause, "location": f.location, "size": _plain(f.size),
                    "size_std": _plain(f.size_std), "unit": f.unit,
                    "posterior_probability": _plain(f.posterior_probability),
                    "prior_probability": _plain(f.prior_probability),
                    "alternatives": [{"cause": a.cause, "location": a.location,
                                      "posterior_probability": _plain(a.posterior_probability)}
                                     for a in f.alternatives],
                    "gain": _plain_tree(f.gain), "time_profile": f.time_profile, "since": f.time_profile_start,
                    "z": _plain(f.z), "check": f.check,
                }
                for f in self.findings
            ],
            "extended_model": self.extended_model,
            "extension": _plain_tree(self.extension),
            "threshold": _plain(self.threshold),
            "adequacy_p": _plain(self.adequacy_p),
            "splits": list(self.splits),
            "detectable_sizes": [
                {"row": row[x.key or (x.cause, x.location)], "kind": x.kind, "cause": x.cause, "location": x.location,
                 "time_profile": x.time_profile, "size": _plain(x.size), "unit": x.unit,
                 "share_left": _plain(x.share_left), "z": _plain(x.z)}
                for x in self.detectable_sizes
            ],
            "parameters": [{k: _plain(v) for k, v in p.items()} for p in self.parameters],
            "notes": list(self.notes),
            "details": _plain_tree(self.details),
            "inputs": _plain_tree(self.inputs),
        }

    def write(self, out: str | Path) -> list[Path]:
        out = Path(out)
        # a line a table, not a line a number
        content = self.content()
        text = json.dumps(content | {"checksum": checksum_of_table(content)}, indent=1, allow_nan=False)
        text = re.sub(r"\[[^\[\]{}\"]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text)
        return [write_text(out, text)]


# what a page of a diagnosis cannot do without, and the kinds of what it shows
@dataclass(frozen=True, kw_only=True)
class AlternativeTable:
    cause: str
    location: str
    posterior_probability: float | None


@dataclass(frozen=True, kw_only=True)
class FindingTable:
    kind: str
    cause: str
    location: str
    size: float | None
    size_std: float | None
    unit: str
    posterior_probability: float | None
    alternatives: tuple[AlternativeTable, ...]
    prior_probability: float | None = None
    gain: Mapping[str, object] | None = None
    time_profile: str | None = None
    since: str | None = None
    z: float | None = None
    check: str | None = None


@dataclass(frozen=True, kw_only=True)
class DetectableSizeTable:
    kind: str
    cause: str
    location: str
    time_profile: str
    size: float | None
    unit: str
    share_left: float | None = None
    z: float | None = None
    row: int | None = None


@dataclass(frozen=True, kw_only=True)
class ParameterTable:
    name: str
    unit: str | None = None
    prior: float | None = None
    prior_std: float | None = None
    value: float | None = None
    std: float | None = None
    prior_shift: float | None = None
    value_after: float | None = None
    std_after: float | None = None
    prior_shift_after: float | None = None


@dataclass(frozen=True, kw_only=True)
class DiagnosisTable:
    verdict: str
    p_value: float | None
    findings: tuple[FindingTable, ...]
    detectable_sizes: tuple[DetectableSizeTable, ...]
    parameters: tuple[ParameterTable, ...]
    notes: tuple[str, ...]
    details: Mapping[str, object]
    threshold: float | None = None
    adequacy_p: float | None = None
    splits: tuple[str, ...] = ()
    extended_model: str | None = None
    extension: Mapping[str, object] | None = None
    inputs: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    format: int = FORMAT
    checksum: str | None = None


def _with_present_keys(table: Mapping) -> dict:
    """A table of a file without a format, as the format of today has it."""
    return {FORMER_KEYS.get(k, k): _values_with_present_keys(v) for k, v in table.items()}


def _values_with_present_keys(value):
    if isinstance(value, Mapping):
        return _with_present_keys(value)
    return [_values_with_present_keys(v) for v in value] if isinstance(value, list) else value


def read_diagnosis(path: str | Path) -> dict:
    """The content of diagnosis.json; raises InputError where it is none."""
    path = Path(path)
    again = "write it again with `probupdate diagnose`"
    content = read_json_table(path, again, absent="write it with `probupdate diagnose`")
    if "format" not in content:
        content = _with_present_keys(content)
    elif content["format"] != FORMAT:
        raise InputError(f"{path}, format", f"is {content['format']!r}; {FORMAT} is the newest known",
                         "read it with the version of probupdate that wrote it, or write it again")
    # the findings may be checked by their kinds, not so all that the page draws
    if "checksum" in content and content["checksum"] != checksum_of_table(
            {k: v for k, v in content.items() if k != "checksum"}):
        raise InputError(str(path), "does not hold what was written: it was damaged or changed", again)
    checked_table(DiagnosisTable, content, path, again)
    if content["verdict"] not in VERDICTS:
        raise InputError(f"{path}, verdict", f"'{content['verdict']}' is none of {', '.join(VERDICTS)}", again)
    return content


def _plain(value):
    if isinstance(value, int | float | np.number):
        return float(value) if np.isfinite(value) else None
    return value


def _plain_tree(value):
    """Tables and lists of plain values, as JSON has them."""
    if isinstance(value, Mapping):
        return {str(k): _plain_tree(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain_tree(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    return int(value) if isinstance(value, int | np.integer) else _plain(value)
