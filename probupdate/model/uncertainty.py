"""What is not known of a model, as standard deviations and a mean of its responses.

Measured responses are y = g(theta) + m + B u + delta + eps. The unknowns u are the tolerances of structure, soil,
rotor-nacelle assembly and sensors, each scaled to a standard normal variable; B their effect on the responses, m what
is expected of them (shear that Bernoulli-Euler members leave out makes every frequency lower, never higher); delta the
model discrepancy (`Weights.discrepancy`) and eps the noise of identification. With u and delta marginalised the
likelihood stays Gaussian: mean g(theta) + m, covariance R + B B^T, R that of eps and delta. This is the approximation
error of Kaipio & Somersalo, Statistical and Computational Inverse Problems (2005), with its covariance taken from the
exact derivatives of the modes instead of a sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from probupdate.model.interface import ModalSolution
from probupdate.runtime.arrays import frozen_array

# in the order in which they are reported
GROUPS = ("structure", "soil", "rotor-nacelle assembly", "water and growth", "theory", "sensors")


@dataclass(frozen=True, kw_only=True)
class ErrorSource:
    """One quantity that the model states and nobody knows exactly: `std` and the `mean` it differs by, in `unit`;
    `check` is what would narrow it."""

    name: str
    group: str
    description: str
    unit: str
    std: float
    mean: float = 0.0
    check: str = ""


class ModelUncertainty(Protocol):
    """The sources of a model's error and what they do to its modes."""

    @property
    def sources(self) -> tuple[ErrorSource, ...]: ...

    def changes(self, theta: np.ndarray, n_mode: int, clusters: tuple[tuple[int, ...], ...]) -> ModalSolution:
        """Modes at theta with derivatives with respect to the sources, each per one of its unit."""
        ...

    def with_gravity(self, felt: Mapping[str, bool]) -> ModelUncertainty:
        """Of a model whose channels hold gravity, or not, as stated by their names."""
        ...

    def fingerprint(self) -> str: ...


@dataclass(frozen=True, eq=False, kw_only=True)
class ResponseError:
    """In the responses of one problem: factor (n_response, n_source) = B, one column a source of one standard
    deviation; mean (n_response,) = m; both at the parameters `theta`."""

    sources: tuple[ErrorSource, ...]
    factor: np.ndarray
    mean: np.ndarray
    theta: np.ndarray

    @classmethod
    def from_slopes(cls, sources: Sequence[ErrorSource], slope: np.ndarray, theta: np.ndarray) -> ResponseError:
        """From the responses' derivatives (n_response, n_source) with respect to the sources."""
        std, mean = np.array([s.std for s in sources]), np.array([s.mean for s in sources])
        return cls(sources=tuple(sources), factor=frozen_array(slope * std), mean=frozen_array(slope @ mean),
                   theta=frozen_array(theta))


def marginal_root(root: np.ndarray, factor: np.ndarray) -> tuple[np.ndarray, float]:
    """R (n, n_response) with R^T R the inverse of C + B B^T, from `root` with root^T root = C^-1 and factor B; and
    ln det(C + B B^T) - ln det C.

    With root B = U diag(s) V^T, (I + root B B^T root^T)^(-1/2) = I + U (diag(1 / sqrt(1 + s^2)) - I) U^T.
    """
    u, s, _ = np.linalg.svd(root @ factor, full_matrices=False)
    return root + (u * (1 / np.sqrt(1 + s**2) - 1)) @ (u.T @ root), float(np.sum(np.log1p(s**2)))
