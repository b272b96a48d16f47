"""Where the error of a model comes from, and how much of it is the same in two states of a structure.

delta = sum_k t_k E_k z_k, z_k ~ N(0, 1): shares of frequencies, components of shapes, local errors that couple two
modes (`mixing`), each with a scale t_k, and what is stated. All but the last are linear or quadratic in the modes. With
q_i = K^(1/2) phi_i / omega_i, orthonormal, an error of stiffness that is independent from place to place is
K^(1/2) X K^(1/2), X symmetric with independent entries: phi_i^T dK phi_j / (omega_i omega_j) = q_i^T X q_j. In another
state modes are turned, T = Q_a^T Q_b, and the same X gives

    cov(q_i^T X q_j, q_k^T X q_l) ~ (T_ik T_jl + T_il T_jk) / 2

so that the errors of two frequencies correlate by T_ik^2 and components at one channel by T_ik. What is stated is the
same number in all states. Without turn (T = 1) the states have one error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import linalg

from probupdate.modal.modes import mac, pair_by_mac
from probupdate.model.interface import Model
from probupdate.runtime.arrays import frozen_array

# kinds of columns: those with a scale, in the order of `Problem.scales`, and those without
FREQUENCY, SHAPE, MIXING, FREQUENCY_FORM, SHAPE_FORM, SOURCE = KINDS = (
    "frequency", "shape", "mixing", "frequency's form", "shape's form", "source")
N_SCALE = 3
# of numbers in a file, as rounding turns modes to second order only; eigenvalues of a Gram matrix, over the largest,
# that are none
DIGITS, NONE = 5, 1e-10
ARRAYS = ("first", "second", "effect", "modes", "seen")


@dataclass(frozen=True, eq=False, kw_only=True)
class ErrorStates:
    """Covariance (n, n) of the errors of several states, the last one's own, for each of three scales of one, and of
    what has none: (4, n, n)."""

    parts: np.ndarray

    def covariance(self, scales: Sequence[float]) -> np.ndarray:
        """At the scales of frequencies, shapes and mixing."""
        return np.tensordot(np.array([*np.square(scales), 1.0]), self.parts, 1)


@dataclass(frozen=True, eq=False, kw_only=True)
class ErrorOrigins:
    """Of one state, delta = effect z in the units of `LearntError`, a column one z.

    kind, label (n_column,): of each z, and the channel of a shape's or the source's name; first, second (n_mode,
    n_column): the modes it couples, in coordinates of the computed ones, of a frequency or component one mode twice;
    effect (n_response, n_column); modes (n_dof, n_mode): mass-normalised, without rows where the model has no matrices;
    seen (n_channel, n_mode): the same at the channels.
    """

    kind: tuple[str, ...]
    label: tuple[str, ...]
    channels: tuple[str, ...]
    first: np.ndarray
    second: np.ndarray
    effect: np.ndarray
    modes: np.ndarray
    seen: np.ndarray

    def to_table(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self) | {k: [[float(f"{x:.{DIGITS}g}") for x in row] for row in getattr(self, k).tolist()]
                               for k in ARRAYS}

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> ErrorOrigins:
        """Raises KeyError, TypeError or ValueError where a part lacks or does not fit."""
        texts = {k: tuple(str(x) for x in table[k]) for k in ("kind", "label", "channels")}
        n_mode, n = len(table["first"]), len(texts["kind"])
        columns = {"first": n, "second": n, "effect": n, "modes": n_mode, "seen": n_mode}
        arrays = {k: np.array(table[k], float).reshape(-1, columns[k]) for k in ARRAYS}
        if len(texts["label"]) != n or len(arrays["second"]) != n_mode or len(arrays["seen"]) != len(texts["channels"]):
            raise ValueError("origins of the model's error do not fit one another")
        if not set(texts["kind"]) <= set(KINDS) or not all(np.all(np.isfinite(a)) for a in arrays.values()):
            raise ValueError("origins of the model's error hold an unknown kind, or what is not a number")
        every: dict[str, Any] = texts | {k: frozen_array(a) for k, a in arrays.items()}
        return cls(**every)


def join_states(states: Sequence[ErrorOrigins], model: Model, theta: np.ndarray) -> ErrorStates:
    """Of several states; turns of their modes by the model's stiffness at theta (n_param,)."""
    full = model.stiffness_and_modes(theta, 1)
    stiffness: Any = np.zeros((0, 0)) if full is None else full[0]
    at_dofs = [_orthonormal(one.modes, stiffness) if full is not None and len(one.modes) == stiffness.shape[0] else None
               for one in states]
    n = [len(one.effect) for one in states]
    edges = np.concatenate([[0], np.cumsum(n)])
    parts = np.zeros((N_SCALE + 1, edges[-1], edges[-1]))
    for a, one in enumerate(states):
        for b, other in enumerate(states[: a + 1]):
            two = at_dofs[a], at_dofs[b]
            if a == b:
                turn = np.eye(one.modes.shape[1])
            elif two[0] is not None and two[1] is not None:
                turn = two[0].T @ (stiffness @ two[1])
            else:
                turn = _turn_seen(one, other)
            found = _common_parts(one, other, turn)
            rows, columns = slice(*edges[a : a + 2]), slice(*edges[b : b + 2])
            parts[:, rows, columns], parts[:, columns, rows] = found, found.transpose(0, 2, 1)
    return ErrorStates(parts=parts)


def _orthonormal(modes: np.ndarray, stiffness: Any) -> np.ndarray:
    """The nearest to modes (n_dof, n_mode) whose product with the stiffness is one."""
    size = np.sqrt(np.maximum(np.sum(modes * (stiffness @ modes), axis=0), np.finfo(float).tiny))
    unit = modes / size
    value, vectors = linalg.eigh(unit.T @ (stiffness @ unit))
    return unit @ (vectors / np.sqrt(np.maximum(value, NONE * value[-1]))) @ vectors.T


def _turn_seen(one: ErrorOrigins, other: ErrorOrigins) -> np.ndarray:
    """Where full modes cannot be compared: cosines of like modes over the channels of both."""
    common = [c for c in one.channels if c in other.channels]
    a, b = (s.seen[[s.channels.index(c) for c in common]] for s in (one, other))
    turn = np.zeros((a.shape[1], b.shape[1]))
    if not common:
        np.fill_diagonal(turn, 1.0)
        return turn
    # of equal ones in their order
    for i, j in pair_by_mac(mac(a, b) + np.sqrt(np.finfo(float).eps) * np.eye(*turn.shape)):
        turn[i, j] = a[:, i] @ b[:, j] / (np.linalg.norm(a[:, i]) * np.linalg.norm(b[:, j]))
    return turn


def _common_parts(one: ErrorOrigins, other: ErrorOrigins, turn: np.ndarray) -> np.ndarray:
    """(4, n_response, n_response) of both, by kind of scale."""
    linear = one.first.T @ turn @ other.first
    crossed = (linear * (one.second.T @ turn @ other.second)
               + (one.first.T @ turn @ other.second) * (one.second.T @ turn @ other.first))
    quadratic = crossed / np.sqrt(np.outer(_square(one), _square(other)))
    same_label = np.array(one.label)[:, None] == np.array(other.label)
    parts = np.zeros((N_SCALE + 1, len(one.effect), len(other.effect)))
    for number, kind in enumerate(KINDS):
        rows, columns = (np.flatnonzero(np.array(s.kind, str) == kind) for s in (one, other))
        block = np.ix_(rows, columns)
        like = (same_label * 1.0 if kind == SOURCE else linear * same_label if kind in (SHAPE, SHAPE_FORM)
                else quadratic)[block]
        parts[min(number, N_SCALE)] += one.effect[:, rows] @ like @ other.effect[:, columns].T
    return parts


def _square(one: ErrorOrigins) -> np.ndarray:
    """Twice the squared size (n_column,) of the product of both modes; one where there are none."""
    own, across = np.sum(one.first**2, axis=0) * np.sum(one.second**2, axis=0), np.sum(one.first * one.second, axis=0)
    return np.where(own > 0, own + across**2, 1.0)
