"""The reliability diagram of the blind study: which candidates count as right, and what calibrated ones come to."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

STUDY = Path(__file__).resolve().parents[2] / "studies" / "blind"
BRACE, OTHER = ("brace stiffness lost", "face AB, bay 2"), ("brace stiffness lost", "face AB, bay 3")


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(STUDY))
    try:
        spec = importlib.util.spec_from_file_location("blind_reliability", STUDY / "reliability.py")
        module = importlib.util.module_from_spec(spec)
        # a dataclass looks its module up
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(STUDY))
    return module


def finding(first, probability, *rest):
    return {"cause": first[0], "location": first[1], "probability": probability,
            "alternatives": [list(name) for name, _ in rest],
            "probabilities": [p for _, p in rest]}


def line(hidden, *findings, verdict="ambiguous", kinds=None):
    effects = [{"cause": cause, "location": where} for cause, where in hidden]
    return {"id": "x", "verdict": verdict, "effects": effects, "hidden": kinds or effects, "findings": list(findings)}


def test_the_first_and_its_alternatives_are_judged_by_cause_and_place(study):
    chance = ("chance alone", "")
    values, without = study.stated([line([BRACE], finding(OTHER, 0.7, (BRACE, 0.25), (chance, 0.05)))])
    assert [(v.probability, v.right, v.first) for v in values] == [(0.7, False, True), (0.25, True, False),
                                                                  (0.05, False, False)]
    assert without == 0


def test_chance_is_right_where_nothing_of_a_finding_was_hidden(study):
    chance = ("chance alone", "")
    one = finding(OTHER, 0.9, (chance, 0.1))
    nothing, _ = study.stated([line([], one)])
    beside, _ = study.stated([line([BRACE], finding(BRACE, 1.0), one)])
    assert [v.right for v in nothing] == [False, True]
    assert [v.right for v in beside] == [True, False, True]
    # what no row describes is there, and no chance
    unnamed, _ = study.stated([line([], one, kinds=[{"kind": "cable"}])])
    assert [v.right for v in unnamed] == [False, False]


def test_lines_of_older_runs_and_other_verdicts_are_left_out(study):
    old = {"cause": BRACE[0], "location": BRACE[1], "alternatives": []}
    values, without = study.stated([line([BRACE], old), line([BRACE], finding(BRACE, 0.5), verdict="unexplained"),
                                    {"id": "y", "failed": "no"}])
    assert values == [] and without == 1


def test_lines_of_the_oc4_jacket_state_probabilities_with_their_alternatives(study):
    row = {"id": "z", "verdict": "named", "hidden": [{"cause": "parameter", "location": "soil"}],
           "findings": [{"cause": "parameter", "location": "soil", "probability": 0.97,
                         "alternatives": [["chance alone", "", 0.03]]}]}
    assert [(v.probability, v.right) for v in study.stated([row])[0]] == [(0.97, True), (0.03, False)]


@pytest.mark.parametrize(("truth", "held"), [(lambda p: p, True), (lambda p: p**3, False)])
def test_calibrated_probabilities_lie_on_the_diagonal_and_others_do_not(study, truth, held, validation):
    row = validation(what="reliability diagram of 4000 made probabilities: intervals that hold the mean, Brier's "
                          "score less its expectation, where calibrated; intervals that do not, the same, where not",
                     reference="the diagonal", why="95 % binomial intervals")
    rng = np.random.default_rng(4)
    p = rng.uniform(0, 1, 4000)
    values = [study.Stated(float(x), bool(rng.random() < truth(x)), True, "x") for x in p]
    rows = study.bins(values)
    assert sum(r[2] for r in rows) == len(values)
    # seven intervals of 95 %: two outside have a probability of 0.04
    inside = sum(low <= mean <= high for mean, _, _, low, high in rows)
    score, expected = study.brier(values)
    if held:
        row.count(inside, len(rows), len(rows) - 1, "calibrated")
        row.error(score - expected, 0.01, "its Brier's score")
    else:
        row.count(len(rows) - inside, len(rows), 2, "not calibrated")
        row.least(abs(score - expected), 0.01, "its Brier's score, not calibrated")


def test_the_script_draws(tmp_path):
    path = tmp_path / "cases.jsonl"
    path.write_text(json.dumps(line([BRACE], finding(BRACE, 0.98, (OTHER, 0.02)), verdict="named")) + "\n")
    words = [sys.executable, str(STUDY / "reliability.py"), str(path), "--figure", str(tmp_path / "r.png")]
    ran = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "r.png").stat().st_size > 5000 and "| 0.980 | 1 | 1 |" in ran.stdout
