"""The update of every measured set with the same start, weights and pairing: the scatter of Table 7.

Where the scatter is identification noise alone, the covariance of the maxima is P - P W_Theta P, not P: a parameter
the data do not inform hardly scatters at all. Its resolution R_jj stands beside every CoV for that reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from probupdate.errors import ProbupdateError
from probupdate.estimators.laplace import Laplace, maximum_a_posteriori
from probupdate.estimators.tikhonov import update
from probupdate.model import Model
from probupdate.modes import ModalData, ModalSet, frozen_array
from probupdate.problem import Problem, Weights, build_problem
from probupdate.progress import Progress, silent


@dataclass(frozen=True, eq=False, kw_only=True)
class SetScatter:
    """theta_map, theta_step (n_set, n_param): the maximum of the posterior, and Eq. 7 as printed after `iterations`;
    variance, resolution (n_set, n_param) of the Laplace approximation; derived: name -> (n_set,) at the maxima.
    `failed`: a sentence for each set that gave no update."""

    ids: tuple[str, ...]
    theta_map: np.ndarray
    theta_step: np.ndarray
    iterations: int
    variance: np.ndarray
    resolution: np.ndarray
    derived: dict[str, np.ndarray]
    failed: tuple[str, ...]

    @property
    def cov(self) -> np.ndarray:
        """CoV of the maxima over the sets (n_param,), relative to |mean|."""
        return np.std(self.theta_map, axis=0, ddof=1) / np.abs(np.mean(self.theta_map, axis=0))

    @property
    def total_std(self) -> np.ndarray:
        """Deviation by the law of total variance: mean variance within sets plus variance of their maxima. Where the
        scatter is noise it counts that noise twice: an upper figure, not the parameter's variation."""
        return np.sqrt(np.mean(self.variance, axis=0) + np.var(self.theta_map, axis=0, ddof=1))


def update_sets(
    model: Model,
    data: ModalData,
    *,
    weights: Weights,
    clusters: list[tuple[int, ...]],
    iterations: int,
    model_at: Callable[[ModalSet], Model] | None = None,
    progress: Progress = silent,
) -> SetScatter:
    """Update every set of the data from the initial parameters, with the model in that set's surroundings where
    `model_at` gives it. Sets that cannot be updated are named, not dropped in silence."""
    kept, failed = [], []
    derived: dict[str, list[float]] = {name: [] for name in getattr(model, "derived", {})}
    found = each_set(model, data, weights=weights, clusters=clusters, model_at=model_at, failed=failed,
                     progress=progress)  # fmt: skip
    for problem, laplace in found:
        try:
            printed = update(problem, penalty="step", max_iteration=iterations)
        except ProbupdateError as error:
            failed.append(f"set {problem.set_id}: {error}")
            continue
        kept.append((problem.set_id, laplace, printed.theta[-1]))
        for name, compute in getattr(model, "derived", {}).items():
            derived[name].append(float(compute(laplace.theta)))
    n_param = len(model.parameters)

    def stack(rows) -> np.ndarray:
        return frozen_array(np.array(rows).reshape(-1, n_param))

    return SetScatter(
        ids=tuple(id for id, _, _ in kept), theta_map=stack([x.theta for _, x, _ in kept]),
        theta_step=stack([s for _, _, s in kept]), iterations=iterations,
        variance=stack([np.diag(x.covariance) for _, x, _ in kept]),
        resolution=stack([x.resolution for _, x, _ in kept]),
        derived={name: frozen_array(values) for name, values in derived.items()}, failed=tuple(failed),
    )


def each_set(
    model: Model,
    data: ModalData,
    *,
    weights: Weights,
    clusters: list[tuple[int, ...]],
    failed: list[str],
    model_at: Callable[[ModalSet], Model] | None = None,
    progress: Progress = silent,
) -> Iterator[tuple[Problem, Laplace]]:
    """The problem and the posterior's maximum of every set, from the initial parameters; a sentence in `failed` for
    each that has none."""
    for done, modal_set in enumerate(data.sets):
        progress("update of every set", done, len(data.sets))
        try:
            own = model if model_at is None else model_at(modal_set)
            problem = build_problem(own, data, set_id=modal_set.id, weights=weights, clusters=clusters)
            anchored = update(problem, penalty="prior")
            laplace = maximum_a_posteriori(problem, [anchored.theta[-1]])
        except ProbupdateError as error:
            failed.append(f"set {modal_set.id}: {error}")
            continue
        yield problem, laplace
    progress("update of every set", len(data.sets), len(data.sets))
