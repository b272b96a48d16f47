"""A model that is a Python function theta -> (frequencies, shapes)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from probupdate.errors import InputError
from probupdate.modal.modes import mac as modal_assurance
from probupdate.modal.modes import pair_by_mac
from probupdate.model.interface import ManySolutions, ModalSolution, Wireframe
from probupdate.model.parameters import Parameters
from probupdate.model.uncertainty import ModelUncertainty
from probupdate.runtime.arrays import frozen_array


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionModel:
    """Wraps `function(theta (n_param,)) -> (frequency_hz (n_mode,), shape (n_channel, n_mode))`.

    Derivatives are central differences with a step of `step` prior standard deviations, the perturbed modes paired with
    the unperturbed ones by MAC (clusters: turned onto them, which leaves out their rotation). `version` goes into the
    fingerprint, as code cannot be hashed: change it whenever the function's answers change.
    """

    name: str
    parameters: Parameters
    channels: tuple[str, ...]
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    version: str
    step: float = 1e-4
    uncertainty: ModelUncertainty | None = None

    @property
    def n_available(self) -> int:
        """As many as the function gives at the initial parameters."""
        return np.size(self.function(np.array(self.parameters.initial))[0])

    def hold_parameters(self, values: Mapping[str, float]) -> FunctionModel:
        """The same function of the other parameters alone, these held at values of their own."""
        kept = self.parameters.hold_parameters(values)
        whole = np.array([values.get(name, 0.0) for name in self.parameters.names])
        free = np.array([name not in values for name in self.parameters.names])

        def function(theta):
            full = whole.copy()
            full[free] = theta
            return self.function(full)

        return replace(self, parameters=kept, function=function)

    def _evaluate(self, theta, n_mode):
        frequency, shape = self.function(np.array(theta, float))
        frequency, shape = np.asarray(frequency, float), np.asarray(shape, float)
        if frequency.ndim != 1 or shape.shape != (len(self.channels), frequency.size) or frequency.size < n_mode:
            raise InputError(
                self.name, f"the function gave frequencies {frequency.shape} and shapes {shape.shape}",
                f"give at least {n_mode} modes at {len(self.channels)} channels",
            )
        if not (np.all(np.isfinite(frequency)) and np.all(np.isfinite(shape))):
            raise InputError(self.name, "the function gave values that are not finite", f"check it at {list(theta)}")
        order = np.argsort(frequency)[:n_mode]
        return frequency[order], shape[:, order]

    def solve(
        self,
        theta: np.ndarray,
        n_mode: int,
        *,
        derivatives: bool = False,
        clusters: tuple[tuple[int, ...], ...] = (),
    ) -> ModalSolution:
        theta = np.asarray(theta, float)
        frequency, shape = self._evaluate(theta, n_mode)
        result = {"theta": frozen_array(theta), "frequency_hz": frozen_array(frequency), "shape": frozen_array(shape)}
        if derivatives:
            d_frequency = np.empty((n_mode, theta.size))
            d_shape = np.empty((*shape.shape, theta.size))
            for k in range(theta.size):
                h = self.step * self.parameters.std[k]
                # at a bound the model may not exist outside: the difference becomes one-sided there
                up = min(theta[k] + h, self.parameters.upper[k])
                down = max(theta[k] - h, self.parameters.lower[k])
                sides = []
                for value in (up, down):
                    moved = theta.copy()
                    moved[k] = value
                    sides.append(_align_modes(*self._evaluate(moved, n_mode), shape, clusters))
                d_frequency[:, k] = (sides[0][0] - sides[1][0]) / (up - down)
                d_shape[:, :, k] = (sides[0][1] - sides[1][1]) / (up - down)
            result |= {"frequency_derivative": frozen_array(d_frequency), "shape_derivative": frozen_array(d_shape)}
        return ModalSolution(**result)

    def solve_many(self, theta: np.ndarray, n_mode: int) -> ManySolutions:
        rows = [self._evaluate(row, n_mode) for row in np.atleast_2d(theta)]
        return ManySolutions(
            frequency_hz=np.array([f for f, _ in rows]), shape=np.array([s for _, s in rows]),
            fallback=np.zeros(len(rows), bool),
        )

    def stiffness_and_modes(self, theta: np.ndarray, n_mode: int) -> None:
        return None

    def wireframe(self, theta: np.ndarray, n_mode: int = 0) -> Wireframe | None:
        return None

    def fingerprint(self) -> str:
        text = [self.name, self.version, *self.channels, *map(repr, (*self.parameters, *self.parameters.held))]
        if self.parameters.correlation is not None:
            text.append(self.parameters.correlation.tobytes().hex())
        return hashlib.sha256("\n".join(text).encode()).hexdigest()


def _align_modes(frequency, shape, reference, clusters):
    """Modes reordered, signed and (in clusters) turned onto the reference shapes."""
    order = np.arange(shape.shape[1])
    for i, j in pair_by_mac(modal_assurance(reference, shape)):
        order[i] = j
    inside = {j for cluster in clusters for j in cluster}
    frequency, shape = frequency.copy(), shape.copy()
    single = [j for j in range(len(order)) if j not in inside]
    frequency[single], shape[:, single] = frequency[order[single]], shape[:, order[single]]
    shape[:, single] *= np.sign(np.sum(shape[:, single] * reference[:, single], axis=0))
    for cluster in clusters:
        members = list(cluster)
        turn, _ = linalg.orthogonal_procrustes(shape[:, members], reference[:, members])
        shape[:, members] = shape[:, members] @ turn
    return frequency, shape
