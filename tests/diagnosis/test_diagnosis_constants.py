"""How many numbers the diagnosis stands on: each is a prior, a tolerance with a source or an error rate, and none more
is taken up without one that goes."""

import ast
from pathlib import Path

import pytest

from probupdate import diagnosis

# as counted on 2026-11-30; wanted are 80 of both together
MOST_NAMED, MOST_COMPARED = 306, 53
# what says that there is none, one or two of something, and no more
COUNTS = {0, 1, 2, -1, 0.5}


def numbers_of(source: str) -> tuple[int, int]:
    """Numbers in constants of a module, and numbers that are compared with, but for those that count."""
    tree = ast.parse(source)
    named = sum(len(literals(node.value)) for node in tree.body
                if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
                and all(isinstance(n, ast.Name) and n.id.isupper() for t in targets(node) for n in names(t)))
    compared = sum(1 for node in ast.walk(tree) if isinstance(node, ast.Compare)
                   for side in (node.left, *node.comparators) for value in literals(side) if value not in COUNTS)
    return named, compared


def targets(node):
    return node.targets if isinstance(node, ast.Assign) else [node.target]


def names(target):
    return target.elts if isinstance(target, ast.Tuple) else [target]


def literals(tree) -> list[float]:
    return [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, int | float)
            and not isinstance(n.value, bool)]


@pytest.mark.parametrize("source, expected", [
    ("A, B = 0.3, (1.0, 2.0)\nWORDS = 'none'\n", (3, 0)), ("def f(x):\n    return x > 0.1 and len(x) == 2\n", (0, 1)),
    ("lower = 3.0\n", (0, 0)),
])
def test_numbers_are_counted(source, expected):
    assert numbers_of(source) == expected


def test_the_diagnosis_takes_up_no_more_numbers():
    counted = [numbers_of(p.read_text(encoding="utf-8")) for p in sorted(Path(diagnosis.__path__[0]).rglob("*.py"))]
    named, compared = map(sum, zip(*counted, strict=True))
    assert named <= MOST_NAMED, f"{named} numbers in constants"
    assert compared <= MOST_COMPARED, f"{compared} numbers in comparisons"
