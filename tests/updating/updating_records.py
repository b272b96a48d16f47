"""An update of three sets of the linear model, and posteriors that fit it, as the files hold them."""

from __future__ import annotations

import numpy as np
from updating_cases import LINEAR_HZ, linear_data, linear_model

from probupdate.model.parameters import Parameter, Parameters
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.runs import deterministic_update
from probupdate.updating.settings import UpdateSettings
from probupdate.updating.update_file import UpdateRecord

# a is known by the data alone, b half, c not at all; b wants beyond its bound
SLOPE = np.array([[0.05, 0.01, 0.0], [0.10, -0.02, 0.0], [0.02, 0.08, 0.0], [0.30, 0.05, 0.0], [-0.20, 0.25, 0.0]])
PARAMETERS = Parameters((
    Parameter(name="a", unit="-", initial=1.0, std=0.8, lower=-9.0, upper=9.0),
    Parameter(name="b", unit="kg", initial=2.0, std=0.35, upper=2.5),
    Parameter(name="c", unit="-", initial=-1.0, std=0.2),
))


def record(change=(0.05, 0.3, 0.0), *, noise_seed=1, n_set=3, iterations=50, parameters=PARAMETERS) -> UpdateRecord:
    """The update of frequencies of the model at initial + change, 1 % standard deviations."""
    noise = np.random.default_rng(noise_seed).standard_normal((n_set, 5)) * 0.002 * LINEAR_HZ
    frequencies = LINEAR_HZ + SLOPE @ np.array(change) + noise
    if n_set > 2:
        frequencies[2, 0] = np.nan
    model = linear_model(parameters, SLOPE)
    return deterministic_update(model, linear_data(frequencies), settings=UpdateSettings(iterations=iterations))


def posterior_of(update: UpdateRecord, draws: np.ndarray, **changes) -> Posterior:
    """draws (n_draw, n_param) as a chain of four walkers."""
    theta = draws[: 4 * (len(draws) // 4)].reshape(4, -1, draws.shape[1])
    values = {
        "names": update.parameters.names, "theta": theta, "log_likelihood": np.zeros(theta.shape[:2]),
        "log_posterior": np.zeros(theta.shape[:2]), "prior": draws[:10], "response_labels": ("f",),
        "measured": np.ones(1), "std": np.ones(1), "predicted": np.ones((3, 1)), "frequency_hz": np.ones((3, 1)),
        "mode_labels": ("one",), "r_hat": np.ones(draws.shape[1]), "ess": np.full(draws.shape[1], 1e3),
        "converged": True, "verdict": "converged", "fingerprint": update.fingerprint,
    }
    return Posterior(**(values | changes))


def gaussian_draws(update: UpdateRecord, *, n=40_000, seed=2) -> np.ndarray:
    """Exact draws of the linear posterior, cut at the bounds by rejection."""
    rng = np.random.default_rng(seed)
    # the uncut Gaussian's mean: where the free gradient would end
    draws = rng.multivariate_normal(update.map_theta, update.map_covariance, n)
    return draws[update.parameters.inside(draws)]
