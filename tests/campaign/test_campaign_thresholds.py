"""Thresholds of the checks of records: numbers in modules' constants and in comparisons are counted, and become no
more."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2] / "probupdate"
CHECKS = [*(ROOT / "campaign" / f"{name}.py" for name in (
    "mounting", "rigid_bodies", "gain_steps", "between_setups", "clocks", "sensor_findings", "sensor_lines")),
    ROOT / "modal" / "channel_mistakes.py", *sorted((ROOT / "evidence").glob("*.py"))]
MOST = 138


def thresholds(source: str) -> int:
    """Numbers in constants of a module and in comparisons; 0, 1, 2 and -1 in comparisons are counts and signs."""
    tree = ast.parse(source)
    constant = [n for node in tree.body if isinstance(node, ast.Assign) for n in ast.walk(node.value)]
    compared = [n for node in ast.walk(tree) if isinstance(node, ast.Compare) for n in ast.walk(node)
                if isinstance(n, ast.Constant) and n.value not in (0, 1, 2)]
    return sum(isinstance(n, ast.Constant) and isinstance(n.value, int | float) and not isinstance(n.value, bool)
               for n in (*constant, *compared))


def test_thresholds_are_counted_in_constants_and_comparisons():
    assert thresholds("A, B = 0.5, 3\nC = 'x'\ndef f(x):\n    return x > 0.25 * len(x) and x == 1\n") == 3


def test_checks_of_records_gain_no_thresholds():
    found = {path.name: thresholds(path.read_text(encoding="utf-8")) for path in CHECKS}
    assert sum(found.values()) <= MOST, found
