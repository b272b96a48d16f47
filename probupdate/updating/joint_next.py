"""What to measure next, and at which turbine: expected information by the linear-Gaussian system.

In a linear system what a measurement is expected to say does not depend on its outcome: half the logarithm of the ratio
of variances before and after (Lindley 1956), in bits: about what all turbines share, and about that turbine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probupdate.updating.joint_inference import JointEstimate
from probupdate.updating.joint_system import OWN, FarmSystem

# a direct survey of a parameter states its normal score to this
SURVEY = 0.1
CAMPAIGN, FIRST = "as many sets again", "a first campaign"


@dataclass(frozen=True, kw_only=True)
class NextMeasurement:
    """turbine: '' for one without sensors so far; farm_bits: about common parameters and means, turbine_bits: about
    all parameters of that turbine."""

    turbine: str
    measurement: str
    farm_bits: float
    turbine_bits: float


def next_measurements(estimate: JointEstimate, turbines: tuple[str, ...]) -> list[NextMeasurement]:
    """As many sets again, or a survey of one parameter, at each turbine; a first campaign at another one, with sensors
    as at the one where that says the most. The most informative about what all share first."""
    system, tau, std = estimate.system, estimate.tau, estimate.common_std
    joint = system.conditional(tau, std)
    n_z = system.n_z
    z_cov = joint.solve(np.eye(len(joint.mean))[:, :n_z])[:n_z]
    _, covariance, across, _ = system.of_turbines(tau, joint)
    found, first = [], None
    for i, name in enumerate(turbines):
        given_z = covariance[i] - across[i] @ np.linalg.solve(z_cov, across[i].T)
        for k, parameter in enumerate(estimate.roles.names):
            noise = SURVEY**2
            # what is common is surveyed once, wherever that is
            if estimate.roles.role(parameter) == OWN or estimate.roles.role(parameter) == "varying" or i == 0:
                found.append(NextMeasurement(
                    turbine=name, measurement=f"a survey of {parameter}",
                    farm_bits=_bits(covariance[i, k, k] + noise, max(given_z[k, k], 0.0) + noise),
                    turbine_bits=_bits(covariance[i, k, k] + noise, noise)))
        again = _repeat_sets(estimate, i, again=True)
        after = again.conditional(tau, std)
        more = again.of_turbines(tau, after)[1]
        found.append(NextMeasurement(turbine=name, measurement=CAMPAIGN, farm_bits=_gain(z_cov, after, n_z),
                                     turbine_bits=_log_ratio(covariance[i], more[i])))
        new = _repeat_sets(estimate, i, again=False)
        after = new.conditional(tau, std)
        one = NextMeasurement(
            turbine="", measurement=f"{FIRST}, sensors as at {name}", farm_bits=_gain(z_cov, after, n_z),
            turbine_bits=_log_ratio(_without_sensors(system, tau, z_cov), new.of_turbines(tau, after)[1][-1]))
        if first is None or one.farm_bits > first.farm_bits:
            first = one
    return sorted([*found, *([first] if first else [])], key=lambda row: -row.farm_bits)


def _without_sensors(system: FarmSystem, tau: np.ndarray, z_cov: np.ndarray) -> np.ndarray:
    """Covariance of d of a turbine that was not measured."""
    layout, spread = system.layout, np.array(z_cov)
    spread[layout.varying, layout.varying] += tau**2
    return layout.shared @ spread @ layout.shared.T + layout.own @ layout.own.T


def _repeat_sets(estimate: JointEstimate, i: int, *, again: bool) -> FarmSystem:
    """With the sets of turbine i twice, or once more at another turbine."""
    inner, system = estimate.inners[i], estimate.system
    twice = replace(inner, products=2 * inner.products, constant=2 * inner.constant) if again else inner
    one = FarmSystem.assemble([twice], system.layout, estimate.error.kind, estimate.error.form)
    one = one.rotate_errors(estimate.turn, system.kind, system.form)
    names = ("products", "constant", "own_rows", "own_root", "wide")
    parts = {}
    for name in names:
        before, more = getattr(system, name), getattr(one, name)
        if again and name != "wide":
            before = np.array(before)
            before[i] = more[0]
        parts[name] = before if again else np.concatenate([before, more])
    return FarmSystem(layout=system.layout, kind=system.kind, form=system.form, **parts)


def _bits(before: float, after: float) -> float:
    return float(0.5 * np.log2(before / after))


def _gain(z_cov: np.ndarray, after, n_z: int) -> float:
    return _log_ratio(z_cov, after.solve(np.eye(len(after.mean))[:, :n_z])[:n_z])


def _log_ratio(before: np.ndarray, after: np.ndarray) -> float:
    return float(0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1]) / np.log(2))
