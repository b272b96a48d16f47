"""`export --fatigue`: every file is there, read back, and holds what its parts say; factors add up to the one model."""

import json

import numpy as np
import pytest
from tests.lifetime.test_stress import CONDITIONS, UPDATED, _toml
from tests.small_turbine import small_turbine

from probupdate import verbs
from probupdate.effects.tolerances import TurbineUncertainty
from probupdate.errors import InputError
from probupdate.estimators.laplace import maximum_a_posteriori
from probupdate.estimators.posterior_file import Posterior
from probupdate.lifetime import fatigue_files
from probupdate.lifetime.export import export_lifetime, read_table
from probupdate.lifetime.factors import gains, joint_covariance, total
from probupdate.lifetime.fatigue_files import FatigueInput
from probupdate.modes import ModalData, ModalSet
from probupdate.problem import Weights, build_problem
from probupdate.structure.load import load_model

HIGH = 4


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A small turbine's file, a posterior about it, conditions and the one model's problem of five of its modes."""
    folder = tmp_path_factory.mktemp("fatigue")
    raw = small_turbine()
    for p in raw["parameter"]:
        p["update"] = p["name"] in UPDATED[:3]
    (folder / "model.toml").write_text(_nested(raw))
    (folder / "fatigue.toml").write_text(_toml(CONDITIONS))
    model = load_model(folder / "model.toml")
    solution = model.solve(model.parameters.initial * 1.02, HIGH)
    f, shape = solution.frequency_hz, solution.shape / np.abs(solution.shape).max(axis=0)
    one = ModalSet(id="a", frequency_hz=f, damping_ratio=np.full(HIGH, 0.01), shape=shape, frequency_std_hz=0.002 * f,
                   shape_std=np.full(shape.shape, 0.02), environment={})  # fmt: skip
    data = ModalData(channels=model.channels, sets=(one, one, one), labels=tuple(f"M{k}" for k in range(HIGH)))
    known = verbs.replace(model, uncertainty=TurbineUncertainty.of(folder / "model.toml", model, None, 0.0))
    problem = build_problem(known, data, weights=Weights()).with_error(model.parameters.initial)
    laplace = maximum_a_posteriori(problem, [model.parameters.initial])
    return folder, model, problem, laplace


def _nested(raw) -> str:
    from tests.structure.test_description import toml_text  # noqa: F401

    raise NotImplementedError


def posterior(model) -> Posterior:
    rng = np.random.default_rng(3)
    theta = model.parameters.initial * np.exp(0.03 * rng.standard_normal((4, 200, len(model.parameters))))
    n = len(model.parameters)
    return Posterior(
        names=model.parameters.names, theta=theta, log_likelihood=np.zeros((4, 200)), log_posterior=np.zeros((4, 200)),
        prior=theta[0, :10], response_labels=("f",), measured=np.ones(1), std=np.ones(1), predicted=np.ones((2, 1)),
        frequency_hz=np.ones((2, 1)), mode_labels=("FA1",), r_hat=np.ones(n), ess=np.full(n, 400.0), converged=True,
        verdict="made up", fingerprint="none",
    )  # fmt: skip
