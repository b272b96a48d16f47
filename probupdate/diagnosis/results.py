"""What a diagnosis says: verdict, findings, detection limits; and diagnosis.json."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

VERDICTS = ("named", "ambiguous", "unexplained", "none")


@dataclass(frozen=True, kw_only=True)
class Alternative:
    cause: str
    location: str
    posterior_probability: float


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One effect: cause, place, size with deviation in `unit`, course along the record, score z against what is normal,
    probability among its rivals, what would split it from them."""

    kind: str
    cause: str
    location: str
    size: float
    size_std: float
    unit: str
    course: str
    course_start: str
    z: float
    posterior_probability: float
    alternatives: tuple[Alternative, ...]
    check: str
    gain: dict = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The least size of a candidate that would be found in nine of ten records like this one; `share_left` of its
    fingerprint that what is normal leaves; z as found."""

    kind: str
    cause: str
    location: str
    course: str
    limit: float
    unit: str
    share_left: float
    z: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis:
    """The whole answer. `cluster`: when ambiguous, the candidates that cannot be told apart. `threshold` of |z|."""

    verdict: str
    p_value: float
    findings: tuple[Finding, ...]
    limits: tuple[Limit, ...]
    threshold: float
    adequacy_p: float
    notes: tuple[str, ...]
    parameters: tuple[dict, ...]
    extended_model: str | None = None
    splits: tuple[str, ...] = ()
    details: dict = field(default_factory=dict)

    @property
    def summary(self) -> str:
        lines = [f"verdict: {self.verdict} (p = {self.p_value:.2g})"]
        for f in self.findings:
            lines.append(f"  {f.cause}, {f.location}: {f.size:.3g} +- {f.size_std:.2g} {f.unit} ({f.course}), "
                         f"z = {f.z:.1f}, probability {f.posterior_probability:.2f}")  # fmt: skip
            if f.alternatives:
                lines.append("    or " + "; ".join(f"{a.cause}, {a.location} ({a.posterior_probability:.2f})"
                                                   for a in f.alternatives[:4]))  # fmt: skip
        lines += [f"  {s}" for s in self.splits]
        if self.verdict == "none":
            best = sorted((x for x in self.limits if x.course == "constant" and np.isfinite(x.limit)),
                          key=lambda x: -x.share_left)[:5]  # fmt: skip
            lines += [f"  {x.cause}, {x.location}: above {abs(x.limit):.2g} {x.unit} is excluded, less is not"
                      for x in best]  # fmt: skip
        return "\n".join(lines)

    def content(self) -> dict:
        """As in diagnosis.json."""
        return {
            "verdict": self.verdict,
            "p_value": _plain(self.p_value),
            "findings": [
                {
                    "kind": f.kind, "cause": f.cause, "location": f.location, "size": _plain(f.size),
                    "size_std": _plain(f.size_std), "unit": f.unit,
                    "posterior_probability": _plain(f.posterior_probability),
                    "alternatives": [{"cause": a.cause, "location": a.location,
                                      "posterior_probability": _plain(a.posterior_probability)}
                                     for a in f.alternatives],
                    "gain": {k: _plain(v) for k, v in f.gain.items()}, "course": f.course, "since": f.course_start,
                    "z": _plain(f.z), "check": f.check,
                }
                for f in self.findings
            ],
            "extended_model": self.extended_model,
            "threshold": _plain(self.threshold),
            "adequacy_p": _plain(self.adequacy_p),
            "splits": list(self.splits),
            "limits": [
                {"kind": x.kind, "cause": x.cause, "location": x.location, "course": x.course, "limit": _plain(x.limit),
                 "unit": x.unit, "share_left": _plain(x.share_left), "z": _plain(x.z)}
                for x in self.limits
            ],
            "parameters": [{k: _plain(v) for k, v in p.items()} for p in self.parameters],
            "notes": list(self.notes),
            "details": self.details,
        }  # fmt: skip

    def write(self, out: str | Path) -> list[Path]:
        out = Path(out)
        out.parent.mkdir(parents=True, exist_ok=True)
        # a line a table, not a line a number
        text = json.dumps(self.content(), indent=1, allow_nan=False)
        text = re.sub(r"\[[^\[\]{}\"]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text)
        out.write_text(text, encoding="utf-8")
        return [out]


def _plain(value):
    if isinstance(value, int | float | np.number):
        return float(value) if np.isfinite(value) else None
    return value
