"""Rows of tests/validation_rows.md out of the tests themselves: what is checked against what, the tolerance that was
asserted, the worst that the last run found.

A test takes the fixture `validation`, says what it checks and asserts through it (an error below, a value above or
within, a count of hits, equality); `pytest --validation FILE` writes
what was measured, and `python tests/validation.py FILE` puts it into the rows that name these tests, with a mark; a
test without a row gets one behind those of its file, or of its folder. All other rows are kept by hand; the site shows
them all.
"""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

PAGE = Path(__file__).with_name("validation_rows.md")
MARK = "†"


@dataclass
class Quantity:
    """What a test asserts of one quantity, and the worst of what it found. kind: 'below' limit[0], 'above' limit[0],
    'between' limit[0] and limit[1], 'count' of limit[0] at least of limit[1], 'equal'."""

    kind: str
    limit: list[float]
    worst: list[float]

    def __post_init__(self):
        # numbers of numpy do not travel between the processes of a run
        self.limit, self.worst = ([x.item() if isinstance(x, np.generic) else x for x in some]
                                  for some in (self.limit, self.worst))

    def with_another(self, other: Quantity) -> Quantity:
        """The worst of both: the largest error, the smallest value, the widest range; counts are added up."""
        assert self.kind == other.kind, f"{self.kind} and {other.kind} of one quantity"
        if self.kind == "count":
            return Quantity("count", [a + b for a, b in zip(self.limit, other.limit, strict=True)],
                            [self.worst[0] + other.worst[0]])
        assert self.limit == other.limit, f"two tolerances, {self.limit} and {other.limit}"
        choose = {"below": (max,), "above": (min,), "between": (min, max), "equal": ()}[self.kind]
        return Quantity(self.kind, self.limit, [c(a, b) for c, a, b in zip(choose, self.worst, other.worst,
                                                                           strict=True)])

    def texts(self, unit: str) -> tuple[str, str]:
        """What was asked, what was found."""
        if self.kind == "count":
            return f"{self.limit[0]} of {self.limit[1]} at least", f"{self.worst[0]} of {self.limit[1]}"
        limit, worst = [[number(x) for x in some] for some in (self.limit, self.worst)]
        return {
            "below": lambda: (f"{limit[0]}{unit}", f"{worst[0]}{unit}"),
            "above": lambda: (f"at least {limit[0]}", worst[0]),
            "between": lambda: (f"{limit[0]} to {limit[1]}{unit}",
                                f"{' to '.join(dict.fromkeys(worst))}{unit}"),
            "equal": lambda: ("equal", "equal"),
        }[self.kind]()


@dataclass
class Row:
    """One row: `quantities` by name, "" where there is one; errors and ranges in `unit`."""

    what: str
    reference: str
    why: str = ""
    unit: str = ""
    quantities: dict[str, Quantity] = field(default_factory=dict)

    def _keep(self, of: str, found: Quantity, holds: bool, said: str, case: object = "") -> None:
        before = self.quantities.get(of)
        try:
            self.quantities[of] = found if before is None else before.with_another(found)
        except AssertionError as error:
            raise AssertionError(f"{self.what}, {of or 'one quantity'}: {error}") from None
        assert holds, f"{self.what}{', ' if of else ''}{of}: {said}{'; ' if case != '' else ''}{case}"

    def error(self, error: object, below: float, of: str = "", case: object = "") -> None:
        """Assert that no |error| reaches `below`. `of`: which quantity, where a test has several; `case`: what a
        failure shows besides."""
        worst = float(np.max(np.abs(error)))
        self._keep(of, Quantity("below", [below], [worst]), worst < below, f"{worst:.3g} is not below {below:.3g}",
                   case)

    def least(self, value: object, above: float, of: str = "") -> None:
        """Assert that every value (a MAC, a p-value) is above."""
        worst = float(np.min(value))
        self._keep(of, Quantity("above", [above], [worst]), worst > above, f"{worst:.3g} is not above {above:.3g}")

    def between(self, value: object, low: float, high: float, of: str = "") -> None:
        """Assert that all values lie in a range, such as a statistic's."""
        ends = [float(np.min(value)), float(np.max(value))]
        self._keep(of, Quantity("between", [low, high], ends), low < ends[0] and ends[1] < high,
                   f"{ends[0]:.3g} to {ends[1]:.3g} is not within {low:.3g} to {high:.3g}")

    def count(self, right: int, total: int, least: int, of: str = "", case: object = "") -> None:
        """Assert that so many of all are right; parametrised cases are added up."""
        self._keep(of, Quantity("count", [least, total], [int(right)]), right >= least,
                   f"{right} of {total} are fewer than {least}", case)

    def equal(self, found: object, expected: object, of: str = "", case: object = "") -> None:
        """Assert that both are the same, to the last bit."""
        same = np.array_equal(found, expected) if isinstance(found, np.ndarray) else bool(found == expected)
        # numbers by the thousand say nothing; a cause and its place do
        said = "not equal" if isinstance(found, np.ndarray) else f"{found!r} is not {expected!r}"
        self._keep(of, Quantity("equal", [], []), same, said, case)

    def cells(self, test: str) -> list[str]:
        """The five cells of the page."""
        kinds = {q.kind for q in self.quantities.values()}
        # one kind, one unit: said once, at the end
        unit, end = (f" {self.unit}", "") if self.unit and kinds != {"below"} else (
            "", f" {self.unit}" if self.unit else "")
        asked = {of: q.texts(unit) for of, q in self.quantities.items()}
        limits = list(dict.fromkeys(text for text, _ in asked.values()))
        several = len(limits) > 1
        tolerance = ", ".join(f"{text}{f' ({of})' if of else ''}" for of, (text, _) in asked.items()) if several else (
            limits[0])
        worst = ", ".join(text for _, text in asked.values()) if kinds != {"equal"} else "equal"
        why = f": {self.why}" if self.why else ""
        return [self.what, self.reference, f"{tolerance}{end}{why}", f"{worst}{end} {MARK}", f"`{test}`"]


def row_of(words: dict) -> Row:
    """A row as a run wrote it."""
    return Row(**{**words, "quantities": {of: Quantity(**q) for of, q in words["quantities"].items()}})


def number(value: float) -> str:
    """Two digits, a power of ten below a thousandth: 1e-4, 9.7e-4, 0.0089; of what is nearly one, two digits of what is
    missing: 0.99987."""
    if 0.9 < value < 1:
        return f"{value:.{1 - math.floor(math.log10(1 - value))}f}".rstrip("0")
    text = f"{value:.1e}".replace(".0e", "e") if 0 < abs(value) < 1e-3 else f"{value:.2g}"
    return re.sub(r"e([+-])0*(\d)", lambda m: f"e{'-' if m[1] == '-' else ''}{m[2]}", text)


def merged(rows: list[dict]) -> Row:
    """Of one test's parametrisations, the worst of each quantity."""
    first = row_of(rows[0])
    for one in rows[1:]:
        other = row_of(one)
        assert (other.what, other.reference, other.unit) == (first.what, first.reference, first.unit), other.what
        for of, found in other.quantities.items():
            kept = first.quantities.get(of)
            first.quantities[of] = found if kept is None else kept.with_another(found)
    return first


def written(page: str, measured: dict[str, list[dict]]) -> str:
    """The page with the rows of these tests as they were measured; raises ValueError for a test of several rows, and
    for one of a folder that has none yet."""
    lines = page.split("\n")
    for test, rows in measured.items():
        at = [k for k, line in enumerate(lines) if line.startswith("| ") and line.rstrip(" |").endswith(f"| `{test}`")]
        row = f"| {' | '.join(merged(rows).cells(test))} |"
        if len(at) == 1:
            lines[at[0]] = row
            continue
        file = test.split("::")[0]
        near = next((found for start in (f"`{file}::", f"`{file.rpartition('/')[0]}/") if (
            found := [k for k, line in enumerate(lines) if line.startswith("| ") and start in line])), None)
        if at or near is None:
            raise ValueError(f"{test}: {len(at)} rows end with it; give it one, in its section")
        lines.insert(near[-1] + 1, row)
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
    sys.stdout.write(f"{len(found)} rows of {PAGE.name} are as measured\n")
