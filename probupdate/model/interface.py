"""What every model offers, whatever it is made of: the one interface the estimators know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import sparse

from probupdate.model.parameters import Parameters


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalSolution:
    """Modes of a model at one parameter vector, ascending in frequency.

    frequency_hz (n_mode,); shape (n_channel, n_mode) at the model's channels, real, scaled to unit modal mass.
    With derivatives: frequency_derivative (n_mode, n_param) and shape_derivative (n_channel, n_mode, n_param).
    For modes that were named together in `clusters` the shape derivative leaves out their rotation into each
    other (it is unbounded as their eigenvalues meet, and no response that is aligned in their plane needs it);
    frequency_derivative stays the one of the single eigenvalue.
    """

    theta: np.ndarray
    frequency_hz: np.ndarray
    shape: np.ndarray
    frequency_derivative: np.ndarray | None = None
    shape_derivative: np.ndarray | None = None

    @property
    def both_derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """frequency_derivative and shape_derivative. Raises ValueError where the model was solved without."""
        if self.frequency_derivative is None or self.shape_derivative is None:
            raise ValueError("modes were computed without derivatives: ask solve for them (derivatives=True)")
        return self.frequency_derivative, self.shape_derivative


@dataclass(frozen=True, eq=False, kw_only=True)
class ManySolutions:
    """Modes at many parameter vectors: frequency_hz (n, n_mode), shape (n, n_channel, n_mode), not in a fixed sign.

    `fallback` (n,) bool: rows that a reduced model could not answer within its bound and the full model did.
    """

    frequency_hz: np.ndarray
    shape: np.ndarray
    fallback: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Wireframe:
    """A picture of the structure: node_m (n_node, 3), line (n_line, 2) node numbers, line_group (n_line,) names,
    displacement (n_node, 3, n_mode) or None."""

    node_m: np.ndarray
    line: np.ndarray
    line_group: tuple[str, ...]
    displacement: np.ndarray | None = None


class Model(Protocol):
    """theta -> modes. `theta` (n_param,) follows `parameters`; nothing is kept between calls."""

    # read, never set: frozen models have them as fields
    @property
    def name(self) -> str: ...

    @property
    def parameters(self) -> Parameters: ...

    @property
    def channels(self) -> tuple[str, ...]: ...

    @property
    def n_available(self) -> int:
        """How many modes can be asked of it."""
        ...

    def solve(
        self,
        theta: np.ndarray,
        n_mode: int,
        *,
        derivatives: bool = False,
        clusters: tuple[tuple[int, ...], ...] = (),
    ) -> ModalSolution: ...

    def solve_many(self, theta: np.ndarray, n_mode: int) -> ManySolutions:
        """theta (n, n_param)."""
        ...

    def stiffness_and_modes(self, theta: np.ndarray, n_mode: int) -> tuple[sparse.csc_array, np.ndarray] | None:
        """K (n_dof, n_dof) and its mass-normalised modes (n_dof, n_mode); None where the model has no matrices."""
        ...

    def wireframe(self, theta: np.ndarray, n_mode: int = 0) -> Wireframe | None:
        """None where the model has no geometry."""
        ...

    def fingerprint(self) -> str:
        """A hash of all that determines the answers: resuming a chain with another one is refused."""
        ...
