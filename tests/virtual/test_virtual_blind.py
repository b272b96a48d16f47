"""The blind study's cases and tables: cases the simulator takes, exact rates, answers judged by cause and place."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from probupdate.virtual.effects import EFFECTS
from probupdate.virtual.truth import parse_truth
from probupdate.virtual.turbine_file import read_turbine, reference_file

FOLDER = Path(__file__).resolve().parents[2] / "studies" / "blind"


def module(name):
    specification = importlib.util.spec_from_file_location(f"blind_{name}", FOLDER / f"{name}.py")
    loaded = importlib.util.module_from_spec(specification)
    sys.modules[f"blind_{name}"] = loaded
    specification.loader.exec_module(loaded)
    return loaded


@pytest.fixture(scope="module")
def cases():
    return module("cases")


@pytest.fixture(scope="module")
def tables():
    return module("tables")


def test_every_case_is_one_the_simulator_takes(cases):
    file = read_turbine(reference_file())
    seen = set()
    for family, n in cases.FAMILIES.items():
        for number in range(n):
            case = cases.make_case(family, number)
            given = parse_truth(case.truth, file)
            assert len(given.effects) == {"null": 0, "month": 0, "pair": 2}.get(family, 1)
            inside = {EFFECTS[e["kind"]].inside for e in given.effects}
            assert inside <= {family != "outside"}
            assert len(case.effects) == (0 if family == "outside" else len(given.effects))
            seen |= {e["cause"] for e in case.effects}
    assert seen == {kind.cause for kind in cases.KINDS}
    assert cases.make_case("single", 17) == cases.make_case("single", 17)
    assert len({cases.make_case("null", k).seed for k in range(200)}) == 200
    # published rates are of these cases: another family must not move them
    assert cases.make_case("null", 0).seed == 1016164991


def test_severities_keep_to_the_stated_limits(cases):
    limits = {"sensor gain | T66-x | constant": 0.1, "sensor gain | T66-x | step": 0.05}
    kind = next(k for k in cases.KINDS if k.cause == "sensor gain")
    rng = np.random.default_rng(3)
    drawn = [cases.draw_effect(rng, kind, limits) for _ in range(400)]
    found = [words for pair in drawn if pair is not None for words in pair[1:]]
    assert len(found) > 8 and {w["location"] for w in found} == {"T66-x"}
    for words in found:
        assert limits[f"sensor gain | T66-x | {words['time_profile']}"] < words["size"] <= kind.high
    below = [cases.draw_effect(rng, kind, limits, below=True) for _ in range(400)]
    sizes = [(pair[1]["size"], pair[1]["time_profile"]) for pair in below if pair and pair[1]["location"] == "T66-x"]
    assert sizes and all(size < 0.7 * limits[f"sensor gain | T66-x | {time_profile}"] for size, time_profile in sizes)


def test_rates_have_exact_intervals(tables):
    # nothing in 59 excludes 5 % at 95 % one-sided: the 90 % interval ends there (0.05 = 1 - q^59)
    assert tables.interval(0, 59, 0.90)[1] == pytest.approx(1 - 0.05 ** (1 / 59), rel=1e-9)
    # Clopper & Pearson 1934: 10 of 10 at 95 %: 0.025^(1/10)
    assert tables.interval(10, 10)[0] == pytest.approx(0.025**0.1, rel=1e-9)
    low, high = tables.interval(7, 20)
    assert low < 0.35 < high


def test_answers_are_judged_by_cause_and_place(tables):
    effect = {"cause": "scour", "also": [], "location": "leg B", "time_profile": "step", "size": 1.0}
    right = {"cause": "scour", "location": "leg B", "alternatives": [], "size": 1.1, "size_std": 0.1}
    elsewhere = {"cause": "scour", "location": "leg C", "alternatives": [["scour", "leg B"]]}
    assert tables.is_named(right, effect) and not tables.is_named(elsewhere, effect)
    assert tables.in_set(elsewhere, effect)
    line = {"family": "single", "effects": [effect], "hidden": [{"kind": "scour"}], "verdict": "named", "cpu_s": 1.0,
            "findings": [right], "limits": {"scour | leg B | step": 0.4}, "id": "single-000"}
    assert tables.above_limit(line, effect)
    text = tables.summary([line, {**line, "verdict": "none", "findings": []}])
    assert "| singles above the stated limit detected | 1 of 2 | 50.0 % |" in text
    assert "scour" in tables.confusion([line])


def test_pairs_are_expected_as_often_as_their_limits_state(tables):
    """A limit is found nine times of ten; at half of it a score about (4.5 + 1.28) / 2 must pass 4.5: 1 - Phi(1.61)."""
    scour = {"cause": "scour", "location": "leg B", "time_profile": "step", "size": 1.0}
    growth = {"cause": "marine growth", "location": "leg C", "time_profile": "ramp", "size": -0.1}
    soft = {"cause": "soil softens with amplitude", "location": "all legs", "time_profile": "own", "size": 0.2}
    line = {"family": "pair", "id": "p", "hidden": [], "verdict": "none", "cpu_s": 1.0, "findings": [],
            "threshold": 4.5, "effects": [scour, growth],
            "limits": {"scour | leg B | step": 1.0, "marine growth | leg C | ramp": 0.2,
                       "soil softens with amplitude | all legs | rms_mps2": 5.0}}
    powers = [tables.stated_power(line, effect) for effect in (scour, growth, soft)]
    assert powers[:2] == pytest.approx([0.9, 0.0537], abs=5e-4) and powers[2] is None
    never = {**line, "limits": {**line["limits"], "scour | leg B | step": np.inf}}
    assert tables.stated_power(never, scour) < 1e-5
    assert "0.1 expected of these: both in the named sets | 0 of 2 |" in tables.summary(
        [line, {**line, "id": "q"}, {**line, "id": "r", "effects": [scour, soft]}])


def test_what_cannot_be_told_apart_is_counted_by_itself(tables):
    """ln(0.95 / 0.05) = 2.944 between two rows is what a name asks for."""
    effect = {"cause": "scour", "location": "leg B", "time_profile": "step", "size": 1.0, "above_stated_limit": True}
    right = {"cause": "scour", "location": "leg B", "alternatives": [], "size": 1.1, "size_std": 0.1}
    wrong = {**right, "cause": "lateral soil stiffness", "alternatives": [["scour", "leg B"]]}
    line = {"family": "single", "hidden": [{"kind": "scour"}], "verdict": "ambiguous", "cpu_s": 1.0}
    lines = [{**line, "id": "a", "effects": [{**effect, "apart": 2.95}], "findings": [right]},
             {**line, "id": "b", "effects": [{**effect, "apart": 2.93}], "findings": [wrong]},
             {**line, "id": "c", "effects": [{**effect, "apart": 0.0}], "findings": []}]
    text = tables.summary(lines)
    assert "| detected singles: right cause and place first | 1 of 3 |" in text
    assert "that can be distinguished from the nearest alternative: right first | 1 of 1 |" in text
    assert "that cannot: right first | 0 of 2 |" in text and "that cannot: in the named set | 1 of 2 |" in text
