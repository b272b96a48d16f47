"""The update of every measured set with the same start, weights and pairing: the scatter of Table 7.

Where the scatter is identification noise alone, the covariance of the maxima is P - P W_Theta P, not P: a parameter
the data do not inform hardly scatters at all. Its resolution R_jj stands beside every CoV for that reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from probupdate.errors import ConvergenceError, ProbupdateError
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.interface import Model
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.executors import Executor, iterate_completed
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.identifiability import cov_of
from probupdate.updating.laplace import Laplace, maximum_a_posteriori
from probupdate.updating.problem import Problem, Weights, build_problem
from probupdate.updating.tikhonov import update


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
    parameters: Parameters

    @property
    def cov(self) -> np.ndarray:
        """CoV of the maxima over the sets (n_param,); NaN of what may be zero (`cov_of`)."""
        mean, std = np.mean(self.theta_map, axis=0), np.std(self.theta_map, axis=0, ddof=1)
        return np.array([cov_of(float(m), float(s), p) for m, s, p in zip(mean, std, self.parameters, strict=True)])

    @property
    def total_std(self) -> np.ndarray:
        """Standard deviation by the law of total variance: mean variance within sets plus variance of their maxima.
        Where the scatter is noise it counts that noise twice: an upper figure, not the parameter's variation."""
        return np.sqrt(np.mean(self.variance, axis=0) + np.var(self.theta_map, axis=0, ddof=1))


def update_sets(
    model: Model,
    data: ModalData,
    *,
    weights: Weights,
    clusters: list[tuple[int, ...]],
    iterations: int,
    start: np.ndarray | None = None,
    model_at: Callable[[ModalSet], Model] | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> SetScatter:
    """Update every set of the data from `start`, as `iterate_sets`, with the model in that set's conditions where
    `model_at` gives it. Sets that cannot be updated are named, not dropped in silence. jobs: processes, or an executor,
    to which models are sent; the numbers are the same on any."""
    what, tasks, found = "update of every set", [], {}
    for number, modal_set in enumerate(data.sets):
        try:
            own = model if model_at is None else model_at(modal_set)
        except ProbupdateError as error:
            found[number] = f"set {modal_set.id}: {error}"
            continue
        alone = replace(data, sets=(modal_set,), reference_set=None)
        tasks.append((number, own, alone, weights, clusters, iterations, start))
    progress(what, len(found), len(data.sets))
    for number, one in iterate_completed(_update_set, tasks, jobs=jobs, least=1):
        found[number] = one
        progress(what, len(found), len(data.sets))
    ordered = [found[number] for number in range(len(data.sets))]
    failed = [one for one in ordered if isinstance(one, str)]
    updated = [one for one in ordered if not isinstance(one, str)]
    kept = [(id, laplace, theta) for id, laplace, theta, _ in updated]
    derived = {name: [more[name] for _, _, _, more in updated] for name in getattr(model, "derived", {})}
    n_param = len(model.parameters)

    def stack(rows) -> np.ndarray:
        return frozen_array(np.array(rows).reshape(-1, n_param))

    return SetScatter(
        ids=tuple(id for id, _, _ in kept), theta_map=stack([x.theta for _, x, _ in kept]),
        theta_step=stack([s for _, _, s in kept]), iterations=iterations,
        variance=stack([np.diag(x.covariance) for _, x, _ in kept]),
        resolution=stack([x.resolution for _, x, _ in kept]),
        derived={name: frozen_array(values) for name, values in derived.items()}, failed=tuple(failed),
        parameters=model.parameters,
    )


def _update_set(
    number: int, model: Model, data: ModalData, weights: Weights, clusters: list[tuple[int, ...]], iterations: int,
    start: np.ndarray | None,
) -> tuple[int, str | tuple[str, Laplace, np.ndarray, dict[str, float]]]:
    """Of the only set of `data`: id, maximum, Eq. 7 as printed and derived parameters, or why there are none."""
    failed: list[str] = []
    for problem, laplace in iterate_sets(model, data, weights=weights, clusters=clusters, failed=failed, start=start):
        try:
            printed = update(problem, penalty="step", max_iteration=iterations)
        except ProbupdateError as error:
            return number, f"set {problem.set_id}: {error}"
        derived = {name: float(compute(laplace.theta)) for name, compute in getattr(model, "derived", {}).items()}
        return number, (problem.set_id, laplace, printed.theta[-1], derived)
    return number, failed[0]


def iterate_sets(
    model: Model,
    data: ModalData,
    *,
    weights: Weights,
    clusters: list[tuple[int, ...]],
    failed: list[str],
    start: np.ndarray | None = None,
    model_at: Callable[[ModalSet], Model] | None = None,
    progress: Progress = silent,
) -> Iterator[tuple[Problem, Laplace]]:
    """The problem and the posterior's maximum of every set; a sentence in `failed` for each that has none. It is looked
    for from `start` (n_param,), the maximum of all sets together: where there are several, sets that end some in one
    and some in another would scatter for no change. None: from the anchored update."""
    for done, modal_set in enumerate(data.sets):
        progress("update of every set", done, len(data.sets))
        try:
            own = model if model_at is None else model_at(modal_set)
            problem = build_problem(own, data, set_id=modal_set.id, weights=weights, clusters=clusters)
            laplace = _maximum_of_set(problem, start)
        except ProbupdateError as error:
            failed.append(f"set {modal_set.id}: {error}")
            continue
        yield problem, laplace
    progress("update of every set", len(data.sets), len(data.sets))


def _maximum_of_set(problem: Problem, start: np.ndarray | None) -> Laplace:
    if start is not None:
        try:
            return maximum_a_posteriori(problem, [start])
        except ConvergenceError:
            # a set unlike the others has its maximum elsewhere
            pass
    return maximum_a_posteriori(problem, [update(problem, penalty="prior").theta[-1]])
