"""The exported joint distribution and FORM beside OpenTURNS."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from probupdate.lifetime.conditions import Uncertainty
from probupdate.lifetime.draws import joint_of, read_joint, to_openturns
from probupdate.lifetime.reliability import DamageCurve, reliability

ot = pytest.importorskip("openturns", reason="openturns is not installed (pip install probupdate[openturns])")
READERS = Path(__file__).resolve().parents[1] / "readers" / "reader_cases.py"


def drawn():
    rng = np.random.default_rng(3)
    z = rng.standard_normal((4000, 3)) @ np.linalg.cholesky([[1, 0.6, -0.3], [0.6, 1, 0], [-0.3, 0, 1]]).T
    return joint_of(("a", "b", "c"), np.column_stack([np.exp(0.3 * z[:, 0]), z[:, 1], np.maximum(z[:, 2], -1.0)]))


def test_its_marginals_and_correlation_are_ours(validation):
    row = validation(what="joint.json as a distribution of OpenTURNS: quantiles; rank correlations of 20 000 draws",
                     reference="OpenTURNS 1.27, where installed", why="its interpolation; four standard errors")
    joint = drawn()
    other = to_openturns(joint)
    assert list(other.getDescription()) == ["a", "b", "c"]
    for k in range(3):
        for level in (0.001, 0.05, 0.5, 0.77, 0.999):
            own = np.interp(level, joint.level, joint.quantile[:, k])
            row.error(other.getMarginal(k).computeQuantile(level)[0] - own, 2e-6, "quantiles")
    ot.RandomGenerator.SetSeed(1)
    sample = np.array(other.getSample(20_000))
    # four standard errors of a rank correlation
    row.error(stats.spearmanr(sample).statistic - joint.rank_correlation, 0.03, "rank correlations")


def test_the_written_file_is_the_same_distribution(tmp_path):
    sys.path.append(str(READERS.parent))
    spec = importlib.util.spec_from_file_location("reader_cases_of_joint", READERS)
    cases = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(cases)
    (path,), _ = cases.joint(tmp_path)
    words = json.loads(path.read_text())
    other = to_openturns(read_joint(path))
    assert list(other.getDescription()) == words["parameters"] == ["a", "b"]
    for k in range(2):
        found = [other.getMarginal(k).computeQuantile(level)[0] for level in (0.1, 0.5, 0.9)]
        assert found == pytest.approx(np.interp((0.1, 0.5, 0.9), words["level"], words["quantile"][k]), abs=2e-6)
    ot.RandomGenerator.SetSeed(1)
    # four standard errors
    rank = stats.spearmanr(np.array(other.getSample(20_000))).statistic
    assert rank == pytest.approx(words["rank_correlation"][0][1], abs=0.03)


def test_form_is_openturns(validation):
    row = validation(what="FORM, two slopes, five variables: cumulative reliability index",
                     reference="OpenTURNS 1.27, where installed", why="both optimisers' ends")
    # a curve with two slopes: ln damage is no line
    at = np.arange(-2.5, 2.525, 0.05)
    log_damage = np.log(np.exp(3 * at - 5) + np.exp(5 * at - 5.5))[:, None]
    curve = DamageCurve(at=at, log_damage=log_damage)
    stated = {"median": 1.0, "cov": 0.1}
    u = Uncertainty.model_validate(
        {"x_load": stated, "x_scf": stated, "miner": {"median": 1.0, "cov": 0.3}, "log10_a_std": 0.2}
    )
    own = reliability(curve, np.array([0.02]), np.array([0.05]), u, years=20, target=3.3)
    s, r = np.sqrt(np.log(1.01)), np.sqrt(np.log(1.09))

    def limit(x):
        # resistance, log10 N, load, stress factor, X_dyn, each of its own
        b = x[2] + x[3] + x[4]
        return [x[0] + np.log(10) * x[1] - np.log(20) - float(curve.value(np.array([[b]]))[0][0, 0])]

    inputs = ot.JointDistribution(
        [ot.Normal(0, r), ot.Normal(0, 0.2), ot.Normal(0, s), ot.Normal(0, s), ot.Normal(0.02, 0.05)]
    )
    function = ot.PythonFunction(5, 1, limit)
    event = ot.ThresholdEvent(ot.CompositeRandomVector(function, ot.RandomVector(inputs)), ot.Less(), 0.0)
    solver = ot.Cobyla()
    solver.setMaximumCallsNumber(10_000)
    solver.setMaximumAbsoluteError(1e-8)
    for setter in ("setMaximumConstraintError", "setMaximumRelativeError", "setMaximumResidualError"):
        getattr(solver, setter)(1e-8)
    try:
        form = ot.FORM(solver, event, inputs.getMean())
    except TypeError:
        solver.setStartingPoint(inputs.getMean())
        form = ot.FORM(solver, event)
    form.run()
    row.error(own.cumulative[0, -1] - form.getResult().getHasoferReliabilityIndex(), 1e-4)
