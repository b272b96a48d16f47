"""A model that answers each question once: sets of one turbine ask the same of the same model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from probupdate.model.interface import ManySolutions, ModalSolution, Model
from probupdate.updating.problem import Problem


class SolvedOnce:
    """`model` with all its answers kept for as long as this lives."""

    def __init__(self, model: Model):
        self._model, self._known = model, {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._model, name)

    def solve(
        self, theta: np.ndarray, n_mode: int, *, derivatives: bool = False, clusters: tuple[tuple[int, ...], ...] = ()
    ) -> ModalSolution:
        key = theta.tobytes(), n_mode, derivatives, clusters
        if key not in self._known:
            self._known[key] = self._model.solve(theta, n_mode, derivatives=derivatives, clusters=clusters)
        return self._known[key]

    def solve_many(self, theta: np.ndarray, n_mode: int) -> ManySolutions:
        key = theta.tobytes(), n_mode
        if key not in self._known:
            self._known[key] = self._model.solve_many(theta, n_mode)
        return self._known[key]


def solved_once(problems: Sequence[Problem]) -> list[Problem]:
    """The same problems; those of one model share its answers."""
    known: dict[int, SolvedOnce] = {}
    return [p.with_model(known.setdefault(id(p.model), SolvedOnce(p.model))) for p in problems]
