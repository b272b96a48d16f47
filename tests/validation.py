"""Rows of VALIDATION.md out of the tests themselves: what is checked against what, the tolerance that was asserted, the
worst error of the last run.

A test takes the fixture `validation`, says what it checks and asserts through it; `pytest --validation FILE` writes
what was measured, and `python tests/validation.py FILE` puts it into the rows of VALIDATION.md that name these tests,
with a mark. All other rows are kept by hand.
"""

from __future__ import annotations

import json
import re
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

PAGE = Path(__file__).resolve().parents[1] / "VALIDATION.md"
MARK = "†"


@dataclass
class Row:
    """One row: `quantities` name (or "") -> [tolerance, worst error], both in `unit`."""

    what: str
    reference: str
    why: str = ""
    unit: str = ""
    quantities: dict[str, list[float]] = field(default_factory=dict)

    def error(self, error: object, below: float, of: str = "") -> None:
        """Assert that no |error| reaches `below`, and keep the worst. `of`: which quantity, where a test has
        several."""
        worst = float(np.max(np.abs(error)))
        before = self.quantities.setdefault(of, [below, 0.0])
        assert before[0] == below, f"{self.what}: two tolerances of {of or 'one quantity'}"
        before[1] = max(before[1], worst)
        assert worst < below, f"{self.what}{', ' if of else ''}{of}: {worst:.3g} is not below {below:.3g}"

    def cells(self, test: str) -> list[str]:
        """The five cells of the page."""
        unit = f" {self.unit}" if self.unit else ""
        limits = list(dict.fromkeys(number(below) for below, _ in self.quantities.values()))
        several = len(limits) > 1
        tolerance = ", ".join(f"{number(below)}{f' ({of})' if several and of else ''}" for of, (below, _) in
                              self.quantities.items()) if several else limits[0]
        worst = ", ".join(number(error) for _, error in self.quantities.values())
        why = f": {self.why}" if self.why else ""
        return [self.what, self.reference, f"{tolerance}{unit}{why}", f"{worst}{unit} {MARK}", f"`{test}`"]


def number(value: float) -> str:
    """Two digits, a power of ten below a thousandth: 1e-4, 9.7e-4, 0.0089."""
    text = f"{value:.1e}".replace(".0e", "e") if 0 < abs(value) < 1e-3 else f"{value:.2g}"
    return re.sub(r"e([+-])0*(\d)", lambda m: f"e{'-' if m[1] == '-' else ''}{m[2]}", text)


def merged(rows: list[dict]) -> Row:
    """Of one test's parametrisations, the worst of each quantity."""
    first = Row(**rows[0])
    for one in rows[1:]:
        other = Row(**one)
        assert (other.what, other.reference, other.unit) == (first.what, first.reference, first.unit), other.what
        for of, (below, error) in other.quantities.items():
            kept = first.quantities.setdefault(of, [below, 0.0])
            kept[1] = max(kept[1], error)
    return first


def written(page: str, measured: dict[str, list[dict]]) -> str:
    """The page with the rows of these tests as they were measured; raises ValueError for a test that has no row yet."""
    lines = page.split("\n")
    for test, rows in measured.items():
        at = [k for k, line in enumerate(lines) if line.startswith("| ") and line.rstrip(" |").endswith(f"| `{test}`")]
        if len(at) != 1:
            raise ValueError(f"{test}: {len(at)} rows of VALIDATION.md end with it; give it one, in its section")
        lines[at[0]] = f"| {' | '.join(merged(rows).cells(test))} |"
    return "\n".join(lines)


class Collector:
    """A plugin of pytest: gathers what the tests of a run measured, from all its processes, and writes it at the
    end."""

    def __init__(self, path: Path):
        self.path, self.measured, self.passed = path, {}, set()

    def pytest_runtest_logreport(self, report) -> None:
        if report.when == "call" and report.passed:
            self.passed.add(report.nodeid)
        # what a fixture leaves is in the last of a test's reports
        if report.when == "teardown" and report.nodeid in self.passed:
            for name, row in report.user_properties:
                if name == "validation":
                    self.measured.setdefault(report.nodeid.split("[")[0], []).append(row)

    def pytest_sessionfinish(self) -> None:
        self.path.write_text(json.dumps(dict(sorted(self.measured.items())), indent=1) + "\n", encoding="utf-8")


def properties(rows: list[Row]) -> list[tuple[str, dict]]:
    return [("validation", asdict(row)) for row in rows]


if __name__ == "__main__":
    found = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
    sys.stdout.write(f"{len(found)} rows of VALIDATION.md are as measured\n")
