"""The one updating problem both estimators solve: responses Lambda, their weights, the parameters and their prior.

Responses are frequencies and shapes of the matched modes (Eq. 4), see `responses`. A measured cluster is represented by
an orthonormal basis of its plane, scaled so that its largest row is 1; a single mode by its shape with largest
component 1; a shape that counts as one MAC by an orthonormal basis.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, special

from probupdate.errors import InputError, ProbupdateError
from probupdate.modal.matching import Matching, channel_rows, nearest_free, with_stated_gravity
from probupdate.modal.modes import ModalData
from probupdate.model.interface import ModalSolution, Model
from probupdate.model.uncertainty import ErrorSource, ResponseError, marginal_root
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.baseline import Rows, Unknowns, join_baselines
from probupdate.updating.error_origins import error_origins
from probupdate.updating.error_states import (
    FREQUENCY,
    FREQUENCY_FORM,
    MIXING,
    SHAPE,
    SHAPE_FORM,
    SOURCE,
    ErrorOrigins,
    ErrorStates,
    join_states,
)
from probupdate.updating.images import Images
from probupdate.updating.mixing import mix_modes
from probupdate.updating.pairing import paired_modes
from probupdate.updating.responses import ResponseGroup, Weights, joint_root, paper_weights, response_group
from probupdate.updating.set_matching import SEARCH, match_set

__all__ = ["Prediction", "Problem", "Weights", "build_problem", "paper_weights"]

# frequencies this near, as a share, are equal: derivatives of their shapes are rounding's
EQUAL = 1e-7
# of a response's stated standard deviation: the least that is left where its discrepancy counts elsewhere
LEAST_NOISE = 1e-3
# step of central differences, in standard deviations of the prior
STEP = 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """Of n parameter vectors: response (n, n_response); computed (n, n_used) the model's modes taken for the measured
    ones; frequency_hz (n, n_used); mac (n, n_used), for members of a cluster that of its worst direction; fallback
    (n,) bool: answered by the full model because a reduced one does not cover it."""

    response: np.ndarray
    computed: np.ndarray
    frequency_hz: np.ndarray
    mac: np.ndarray
    fallback: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Measured responses Lambda_S, their covariance, and the model that predicts them; see `build_problem`.

    The covariance W_Lambda^-1 holds identification, model discrepancy and, where `error` states them, the sources of
    the model's error (`model_error`), which also have a mean: all estimators see the same Gaussian likelihood.
    """

    model: Model
    set_id: str
    mode_labels: tuple[str, ...]
    matching: Matching
    groups: tuple[ResponseGroup, ...]
    weights: Weights
    error: ResponseError | None = None
    # what local errors of stiffness of one do to shapes by mixing two of the model's modes (n_response, n_pair), None
    # where that is not asked
    mixing: np.ndarray | None = None
    mixed_pairs: tuple[tuple[int, int], ...] = ()
    # what the model misses of frequencies, shapes and by mixing instead of the weights' numbers, and whether what it
    # misses by its form (`Weights.least_frequency_cov`, `least_shape_std`) counts
    scales: tuple[float, float, float] | None = None
    form: bool = True
    # with a baseline: the errors of all states, what it says of them, the part of it in which parameters occur, which
    # are responses behind the measured ones, the problem without it, and its nodes
    states: ErrorStates | None = None
    known: Rows | None = None
    tied: Rows | None = None
    bare: Problem | None = None
    given: tuple[tuple[float, Problem], ...] = ()
    # by exchanges of parameters: the posterior is that about the first, times their number
    images: Images | None = None

    @property
    def parameters(self):
        return self.model.parameters

    def inside(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param): within the bounds, and where the first of the images is nearest."""
        within = self.parameters.inside(theta)
        return within if self.images is None else within & (self.images.nearest(theta) == 0)

    @cached_property
    def measured(self) -> np.ndarray:
        """Lambda_S (n_response,): frequencies by group, then shape components by group, mode and channel."""
        parts = [g.frequency_response for g in self.groups] + [g.shape_response for g in self.groups]
        return frozen_array(np.concatenate([*parts, *([] if self.tied is None else [self.tied.value])]))

    @cached_property
    def n_tied(self) -> int:
        """Rows of a baseline behind the measured responses."""
        return 0 if self.tied is None else len(self.tied.value)

    @cached_property
    def _tied_slope(self) -> np.ndarray:
        """(n_tied, n_param)."""
        slope = np.zeros((self.n_tied, len(self.parameters)))
        if self.tied is not None:
            slope[:, [self.parameters.index(name) for name in self.tied.parameters]] = self.tied.slope
        return slope

    @cached_property
    def std(self) -> np.ndarray:
        """sigma of each response (n_response,) without the model's error, but for a MAC, one datum, whose expectation
        holds it."""
        std = self._stated_std
        if self.scales is not None or not self.form:
            own, least = self.own_variance
            std = np.sqrt(np.maximum(own + self.discrepancy_std**2, least))
        if self.error is not None:
            for rows in self._mac_rows:
                std[rows] = np.sqrt(std[rows] ** 2 + np.sum(self.error.factor[rows] ** 2))
        return frozen_array(std)

    @cached_property
    def _mac_rows(self) -> tuple[slice, ...]:
        """The responses of each shape that counts as one MAC."""
        found, start = [], self.n_frequency
        for g in self.groups:
            if g.shapes == "mac":
                found.append(slice(start, start + g.shape_response.size))
            start += g.shape_response.size
        return tuple(found)

    @property
    def _stated_std(self) -> np.ndarray:
        parts = [g.frequency_response_std for g in self.groups] + [g.shape_response_std for g in self.groups]
        return np.concatenate([*parts, np.ones(self.n_tied)])

    @cached_property
    def _stated_discrepancy(self) -> np.ndarray:
        parts = [g.discrepancy_std for g in self.groups]
        return np.concatenate([*(p[0] for p in parts), *(p[1] for p in parts), np.zeros(self.n_tied)])

    @cached_property
    def own_variance(self) -> tuple[np.ndarray, np.ndarray]:
        """Of each response (n_response,) what is no discrepancy of the model, and the least that is left with it."""
        stated = self._stated_std**2
        return stated - self._stated_discrepancy**2, LEAST_NOISE**2 * stated

    @cached_property
    def unit_discrepancy(self) -> np.ndarray:
        """What a discrepancy of one, of a frequency or of the largest component, does to each response (n_response,).
        """
        parts = [g.unit_discrepancy for g in self.groups]
        return frozen_array(np.concatenate([*(p[0] for p in parts), *(p[1] for p in parts), np.zeros(self.n_tied)]))

    def by_kind(self, scales: Sequence[float]) -> np.ndarray:
        """Of frequencies and of shapes -> (n_response,)."""
        n = self.n_frequency
        return np.repeat(np.asarray(scales[:2], float), [n, self.measured.size - n])

    @cached_property
    def mixing_factor(self) -> np.ndarray:
        """M (n_response, n_pair) with M M^T the covariance of what mixing of modes does to shapes; no columns where the
        weights hold none of it."""
        size = self.weights.mixing if self.scales is None else self.scales[2]
        if self.mixing is None or not size:
            return np.zeros((self.measured.size, 0))
        return frozen_array(size * self.mixing)

    @cached_property
    def form_std(self) -> np.ndarray:
        """Of each response (n_response,) what the model misses by its form, beside `discrepancies`."""
        learnt = (self.by_kind(self.weights.discrepancies) * self.unit_discrepancy) ** 2
        return frozen_array(np.sqrt(np.maximum(self._stated_discrepancy**2 - learnt, 0.0)))

    @cached_property
    def discrepancy_std(self) -> np.ndarray:
        """The part of each response's standard deviation (n_response,) that is the model's discrepancy."""
        if self.scales is None and self.form:
            return frozen_array(self._stated_discrepancy)
        scales = self.weights.discrepancies if self.scales is None else self.scales
        form = self.form_std if self.form else 0.0
        return frozen_array(np.hypot(self.by_kind(scales) * self.unit_discrepancy, form))

    @cached_property
    def whole_std(self) -> np.ndarray:
        """sigma of each response (n_response,) with what mixing of modes does to it, or a baseline leaves of its error.
        """
        learnt = self.factor[:, len(self.error_sources) :]
        return frozen_array(np.sqrt(self.std**2 + np.sum(self.mixing_factor**2, axis=1) + np.sum(learnt**2, axis=1)))

    @property
    def frequency_std_hz(self) -> np.ndarray:
        """`whole_std` of the frequencies used (n_used,), in Hz."""
        std = self.whole_std[: self.n_frequency]
        return std * np.exp(self.measured[: self.n_frequency]) if self.weights.frequencies == "log" else std

    @cached_property
    def noise_root(self) -> np.ndarray:
        """R (n_effective or n_response, n_response) with R^T R the inverse covariance of identification and model
        discrepancy alone."""
        return frozen_array(self._noise[0])

    @cached_property
    def _noise(self) -> tuple[np.ndarray, float]:
        """`noise_root`, and what mixing adds to ln det of the covariance."""
        root, mixing = self.unmixed_root, self.mixing_factor
        return (root, 0.0) if not mixing.shape[1] else marginal_root(root, mixing)

    @property
    def unmixed_root(self) -> np.ndarray:
        """`noise_root` without what mixing does to shapes."""
        if not self.weights.covariance:
            return np.diag(1 / self.std)
        least, weights = self.weights.least_std, self.weights
        if self.scales is not None or not self.form:
            form = (weights.least_frequency_cov, weights.least_shape_std) if self.form else (0.0, 0.0)
            scales = weights.discrepancies if self.scales is None else self.scales
            wanted = np.hypot(form, scales[:2])
            frequency, shape = np.maximum(wanted, LEAST_NOISE * np.array(least))
            least = float(frequency), float(shape)
        return linalg.block_diag(joint_root(self.groups, least), np.eye(self.n_tied))

    @cached_property
    def factor(self) -> np.ndarray:
        """B (n_response, n_source) of the model's error in W_Lambda^-1 = C + B B^T; no columns where none is stated."""
        if self.error is None:
            return np.zeros((self.measured.size, 0))
        factor = np.array(self.error.factor)
        for rows in self._mac_rows:
            factor[rows] = 0.0
        return frozen_array(factor)

    @cached_property
    def _marginal(self) -> tuple[np.ndarray, float]:
        root, log_det = marginal_root(self.noise_root, self.factor)
        return frozen_array(root), log_det

    @property
    def error_sources(self) -> tuple[ErrorSource, ...]:
        """The model's sources of error, in the order of `factor`'s columns; none where none is stated."""
        return () if self.error is None else self.error.sources

    @property
    def root(self) -> np.ndarray | None:
        """R (n_effective, n_response) with W_Lambda = R^T R; None where responses are independent."""
        if self.error is None:
            return self.noise_root if self.weights.covariance or self.mixing_factor.shape[1] else None
        return self._marginal[0]

    @cached_property
    def mean(self) -> np.ndarray:
        """m (n_response,): what the model is expected to miss of every response; part of `predict`."""
        return np.zeros(self.measured.size) if self.error is None else self.error.mean

    def whiten(self, residual: np.ndarray) -> np.ndarray:
        """W_Lambda^(1/2) residual: (..., n_response) -> (..., n_response), or (..., n_effective) of a covariance."""
        return residual / self.std if self.root is None else residual @ self.root.T

    @cached_property
    def n_frequency(self) -> int:
        return sum(g.frequency_hz.size for g in self.groups)

    @property
    def n_effective(self) -> int:
        """Responses less the numbers fitted to align shapes: the expected chi-square of a true model at truth."""
        return sum(g.n_effective for g in self.groups) + self.n_tied

    @property
    def used(self) -> tuple[int, ...]:
        """Modes of the data, in the order of the responses' frequencies."""
        return self.matching.measured

    def predict_many(self, theta: np.ndarray) -> Prediction:
        """Lambda_M(theta) for theta (n, n_param) inside the bounds."""
        theta = np.atleast_2d(np.asarray(theta, float))
        solved = self.model.solve_many(theta, self.matching.n_mode)
        computed, criterion = self._assign(solved.frequency_hz, solved.shape)
        frequency, parts = np.empty(computed.shape), []
        mac, start = np.empty(computed.shape), 0
        members = self._add_neighbours(computed, solved.frequency_hz, solved.shape)
        for group, columns in zip(self.groups, members, strict=True):
            k = group.size
            own = np.take_along_axis(solved.frequency_hz, columns, axis=1)
            shape = np.take_along_axis(solved.shape[:, group.rows], columns[:, None, :], axis=2)
            frequency[:, start : start + k], shape = group.combine_modes(own, shape)
            if group.shapes != "none":
                parts.append(group.align(shape).transpose(0, 2, 1).reshape(len(theta), -1))
            if k == 1 and not group.n_mates:
                mac[:, start] = np.take_along_axis(criterion[:, start], columns, axis=1)[:, 0]
            else:
                q, _ = np.linalg.qr(shape)
                mac[:, start : start + k] = (
                    np.linalg.svd(group.plane.T @ q, compute_uv=False)[:, -1:] ** 2
                )
            start += k
        response = np.log(frequency) if self.weights.frequencies == "log" else frequency
        return Prediction(
            response=np.concatenate([response, *parts, theta @ self._tied_slope.T], axis=1) + self.mean,
            computed=computed,
            frequency_hz=frequency, mac=mac, fallback=solved.fallback,
        )

    def _assign(self, frequency_hz: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """frequency_hz (n, n_mode), shape (n, n_channel, n_mode) -> computed (n, n_used) and the criterion (n, n_used,
        n_mode)."""
        if all(group.rows.size <= 1 for group in self.groups):
            # one sensor or none: no shape says which mode is which, their order does
            return (np.tile(np.array(self.matching.computed), (len(shape), 1)),
                    np.ones((len(shape), self.n_frequency, shape.shape[2])))
        return paired_modes(self.groups, frequency_hz, shape, self.matching.least_motion)

    def _add_neighbours(self, computed: np.ndarray, frequency_hz: np.ndarray, shape: np.ndarray) -> list[np.ndarray]:
        """The computed modes of each group, (n, size + n_mates): those assigned to it, (n, n_used) of all, and of one
        of a pair its mate. frequency_hz (n, n_mode), shape (n, n_channel, n_mode)."""
        taken, found, start = computed, [], 0
        for group, plane in zip(self.groups, self._pair_planes, strict=True):
            own = computed[:, start : start + group.size]
            if group.n_mates:
                mate = nearest_free(frequency_hz, shape[:, group.rows], taken, own[:, 0], plane)
                taken, own = np.column_stack([taken, mate]), np.column_stack([own, mate])
            found.append(own)
            start += group.size
        return found

    @cached_property
    def _pair_planes(self) -> tuple[np.ndarray | None, ...]:
        """The plane (n, 2) of the computed pair at the initial parameters, of a mode that was measured alone of it."""
        if not any(group.mates for group in self.matching.groups):
            return (None,) * len(self.groups)
        shape = self.model.solve(self.parameters.initial, self.matching.n_mode).shape
        return tuple(np.linalg.qr(shape[group.rows][:, [*own.computed, *own.mates]])[0] if own.mates else None
                     for group, own in zip(self.groups, self.matching.groups, strict=True))

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Lambda_M(theta) (n_response,), with what the model is expected to miss."""
        return self.predict_many(theta).response[0]

    def sensitivity(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lambda_M (n_response,) and S (n_response, n_param), Eq. 5, exact, through the alignment of shapes."""
        clusters = self._clusters(self.model.solve(theta, self.matching.n_mode))
        solution = self.model.solve(theta, self.matching.n_mode, derivatives=True, clusters=self._rotations(clusters))
        response, slope = self._response_slope(solution, clusters)
        # how equal modes turn into each other has no derivative, what is compared of one of them has
        of_equal = [g.n_mates > 0 and np.ptp(solution.frequency_hz[list(c)]) < EQUAL * solution.frequency_hz[c[0]]
                    for g, c in zip(self.groups, clusters, strict=True) for _ in range(g.size)]
        if any(of_equal):
            rows = np.flatnonzero(of_equal)
            slope[rows] = self._central_differences(theta, rows)
        return (np.concatenate([response, self._tied_slope @ theta]) + self.mean,
                np.vstack([slope, self._tied_slope]))

    def _central_differences(self, theta: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Central differences of some responses (n_row, n_param), within the bounds."""
        step = np.diag(STEP * self.parameters.std)
        up, down = (np.clip(theta + s, self.parameters.lower, self.parameters.upper) for s in (step, -step))
        change = self.predict_many(up).response - self.predict_many(down).response
        return (change[:, rows] / np.diag(up - down)[:, None]).T

    def _clusters(self, solution: ModalSolution) -> tuple[tuple[int, ...], ...]:
        """The computed modes of each group."""
        computed, _ = self._assign(solution.frequency_hz[None], solution.shape[None])
        members = self._add_neighbours(computed, solution.frequency_hz[None], solution.shape[None])
        return tuple(tuple(int(i) for i in own[0]) for own in members)

    def _rotations(self, clusters: tuple[tuple[int, ...], ...]) -> tuple[tuple[int, ...], ...]:
        """Those whose rotation into each other no response needs: one of a pair alone needs it."""
        return tuple(c for c, group in zip(clusters, self.groups, strict=True) if group.size > 1)

    def _response_slope(self, solution: ModalSolution, clusters) -> tuple[np.ndarray, np.ndarray]:
        """Responses (n_response,) and their derivatives (n_response, n) with respect to whatever the solution's are."""
        frequency_slope, shape_slope = solution.both_derivatives
        response, slope, shapes = [], [], []
        for group, columns in zip(self.groups, clusters, strict=True):
            members = list(columns)
            own = solution.frequency_hz[members], solution.shape[group.rows][:, members]
            frequency, shape = group.combine_modes(own[0][None], own[1][None])
            change = group.combined_derivative(*own, frequency_slope[members], shape_slope[group.rows][:, members])
            response.append(frequency[0])
            slope.append(change[0])
            shapes.append((shape, change[1]))
        if self.weights.frequencies == "log":
            slope = [change / f[:, None] for change, f in zip(slope, response, strict=True)]
            response = [np.log(f) for f in response]
        for group, (shape, change) in zip(self.groups, shapes, strict=True):
            if group.shapes == "none":
                continue
            response.append(group.align(shape)[0].T.ravel())
            slope.append(group.aligned_derivative(shape[0], change).transpose(1, 0, 2).reshape(-1, change.shape[2]))
        return np.concatenate(response), np.concatenate(slope)

    def with_error(self, theta: np.ndarray) -> Problem:
        """The same problem with its model's sources of error marginalised, their effect taken at theta (n_param,)."""
        unknown = getattr(self.model, "uncertainty", None)
        if unknown is None or not unknown.sources:
            return self
        n_mode = self.matching.n_mode
        clusters = self._clusters(self.model.solve(theta, n_mode))
        # modes above the measured ones are not asked for their derivatives
        n_mode = min(n_mode, max(max(c) for c in clusters) + 1)
        solution = unknown.changes(theta, n_mode, self._rotations(clusters))
        _, slope = self._response_slope(solution, clusters)
        return replace(self, error=ResponseError.from_slopes(unknown.sources, slope, theta))

    def with_mixing(self, theta: np.ndarray) -> Problem:
        """The same problem with what local errors of the model's stiffness do to its shapes about theta (n_param,); of
        shapes that count as one MAC, or not, there is nothing to correlate."""
        if self.weights.shapes in ("none", "mac"):
            return self
        clusters = self._clusters(self.model.solve(theta, self.matching.n_mode))
        solution = self.model.solve(theta, min(self.matching.n_mode + SEARCH, self.model.n_available))
        pairs, turned = mix_modes(solution, clusters)
        _, slope = self._response_slope(turned, clusters)
        return replace(self, mixing=frozen_array(slope) if pairs else None, mixed_pairs=pairs)

    def noise_alone(self, new: tuple[float, float] | None = None, *, alone: bool = False) -> Problem:
        """The same problem with the covariance of what is new in each set, its mean kept: identification, and `new` of
        the discrepancies of frequencies and of shapes (None: what the weights state as new). What sets have in common
        is marginalised over all of them together; of a set `alone` no discrepancy but mixing is."""
        if new is None:
            new = self.weights.part(1 - self.weights.shared)
        if self.weights.shapes == "mac" and not alone:
            # one datum, no Gaussian residual that sets could share
            new = (new[0], self.weights.discrepancies[1])
        error = self.error
        if error is not None:
            factor = np.zeros_like(error.factor)
            for rows in self._mac_rows:
                factor[rows] = error.factor[rows]
            error = replace(error, factor=factor)
        return replace(self, error=error, scales=(*new, 0.0), form=alone or not self.form_is_shared)

    @cached_property
    def unknowns(self) -> Unknowns:
        """The error of each response by name, frequencies as shares of themselves."""
        if self.bare is not None:
            return self.bare.unknowns
        names, n = [(FREQUENCY, self.mode_labels[j]) for j in self.used], self.n_frequency
        for matched, g in zip(self.matching.groups, self.groups, strict=True):
            if g.shapes != "none":
                modes = "+".join(self.mode_labels[j] for j in matched.measured)
                names += [(SHAPE, modes, str(k + 1), self.model.channels[c]) for k in range(g.size) for c in g.rows]
        measured = np.concatenate([*(g.frequency_hz for g in self.groups), self.measured[n:]])
        unit = np.where(np.arange(len(names)) < n, self.unit_discrepancy, 1.0)
        return Unknowns(names=tuple(names), measured=measured, unit=unit, data=self.parts()["measured modes"],
                        tolerances=self.weights.tolerances)

    @cached_property
    def aligned(self) -> np.ndarray:
        """What is seen (n_response, n_response) of errors of the responses where shapes are aligned."""
        return linalg.block_diag(np.eye(self.n_frequency), *(g.alignment_residual for g in self.groups))

    @property
    def error_covariance(self) -> np.ndarray:
        """D (n_response, n_response) of all that the model misses, as far as it is seen; with a baseline of all states,
        this one last."""
        if self.states is not None:
            scales = (*self.weights.discrepancies, self.weights.mixing) if self.scales is None else self.scales
            return self.states.covariance(scales)
        missed = replace(self, form=self.form and self.form_is_shared).discrepancy_std
        factor = self.aligned @ np.column_stack([np.diag(missed), self.mixing_factor, self.factor])
        return factor @ factor.T

    def error_origins(self, theta: np.ndarray) -> ErrorOrigins:
        """What the error of the responses is made of, the modes those at theta (n_param,)."""
        n_mode, n = min(self.matching.n_mode + SEARCH, self.model.n_available), self.n_frequency
        full = self.model.stiffness_and_modes(theta, n_mode)
        clusters = self._clusters(self.model.solve(theta, self.matching.n_mode))
        missed, form = (self.aligned * x for x in (
            self.unit_discrepancy, self.form_std if self.form and self.form_is_shared else 0.0))
        effects = {FREQUENCY: missed[:, :n], SHAPE: missed[:, n:], FREQUENCY_FORM: form[:, :n], SHAPE_FORM: form[:, n:],
                   MIXING: self.aligned @ (missed[:, :0] if self.mixing is None else self.mixing),
                   SOURCE: self.aligned @ self.factor}
        return error_origins(
            self.model.solve(theta, n_mode), list(zip(self.groups, clusters, strict=True)), self.mixed_pairs,
            {kind: effect / self.unknowns.unit[:, None] for kind, effect in effects.items()},
            channels=self.model.channels, sources=[source.name for source in self.error_sources],
            modes=np.zeros((0, n_mode)) if full is None else full[1])

    @property
    def without_error(self) -> Problem:
        """The same problem with the noise of identification alone."""
        return replace(self, error=None, mixing=None, mixed_pairs=(), scales=(0.0, 0.0, 0.0), bare=None, given=(),
                       tied=None, form=self.form and not self.form_is_shared)

    def with_baseline(self) -> Problem:
        """The same problem with what other states said of its model's error (`Weights.baseline`)."""
        if not self.weights.baseline:
            return self
        if not np.any(self.error_covariance):
            raise InputError("baseline", "is of a model's error, and this run states that there is none",
                             "leave --discrepancy out, or give --discrepancy auto")
        known = join_baselines(self.weights.baseline, self.unknowns, self.weights.common)
        at = self.parameters.initial if self.weights.at is None else np.array(self.weights.at)
        own = self.error_origins(at)
        states = join_states([
            *(state for one in self.weights.baseline for state in one.origins),
            replace(own, effect=own.effect * self.unknowns.unit[:, None])], self.model, at)
        bare, (_, free) = replace(self, states=states), known.split()
        nodes = [(log_weight, replace(bare, scales=tuple(scales))) for *scales, log_weight in self.weights.scales]
        given = tuple((log_weight + free.log_evidence(node.error_covariance), node.with_known(known))
                      for log_weight, node in nodes)
        return replace(bare.with_known(known), given=given)

    def with_known(self, known: Rows) -> Problem:
        """With the errors of all states as their posterior given these rows, those in which parameters occur as
        responses."""
        tied, free = known.split()
        mean, covariance = free.posterior(self.error_covariance)
        value, vectors = np.linalg.eigh(covariance)
        seen = np.vstack([np.eye(len(mean))[-self.measured.size :], tied.matrix])
        error = ResponseError(sources=(), factor=frozen_array(seen @ (vectors * np.sqrt(np.maximum(value, 0.0)))),
                              mean=frozen_array(seen @ mean + np.concatenate([self.mean, np.zeros(len(tied.value))])),
                              theta=self.parameters.initial)
        return replace(self.without_error, error=error, known=known, tied=tied, bare=self)

    @property
    def form_is_shared(self) -> bool:
        """Whether `form_std` is an error of the model, the same in all sets, not of what was stated of a measurement.
        """
        return self.weights.tolerances or self.weights.covariance

    def misfit(self, response: np.ndarray) -> np.ndarray:
        """(Lambda_S - Lambda_M)^T W_Lambda (Lambda_S - Lambda_M), first term of Eq. 6; response (..., n_response)."""
        return np.sum(self.whiten(self.measured - response) ** 2, axis=-1)

    @cached_property
    def log_constant(self) -> float:
        """ln of the Gaussian density of the responses where the misfit is zero; a MAC is one datum."""
        added = 0.0 if self.error is None else -0.5 * self._marginal[1]
        added -= 0.5 * self._noise[1]
        if self.weights.covariance:
            root = self.unmixed_root
            return float(0.5 * np.linalg.slogdet(root @ root.T)[1] - 0.5 * len(root) * np.log(2 * np.pi)) + added
        each = self.kept_shares if self.weights.shapes == "mac" else np.ones(self.std.size)
        return added - float(each @ (np.log(self.std) + 0.5 * np.log(2 * np.pi)))

    @cached_property
    def kept_shares(self) -> np.ndarray:
        """How much of each response (n_response,) is left when shapes are aligned."""
        parts = [np.full(g.shape_response.size, (g.n_effective - g.size) / max(g.shape_response.size, 1))
                 for g in self.groups]
        return frozen_array(np.concatenate([np.ones(self.n_frequency), *parts, np.ones(self.n_tied)]))

    @cached_property
    def taken_by_alignment(self) -> float:
        """What `log_constant` lacks where standard deviations are compared: aligning shapes takes part of their
        residuals, so that their standard deviations count by what is left."""
        if self.weights.covariance or self.weights.shapes == "mac":
            return 0.0
        return float((1 - self.kept_shares) @ (np.log(self.std) + 0.5 * np.log(2 * np.pi)))

    @cached_property
    def nodes(self) -> tuple[tuple[float, Problem], ...]:
        """The problem at each of the discrepancy's scales with ln of its weight; itself where none is learnt."""
        if self.scales is not None or not self.weights.scales:
            return self.given or ((0.0, self),)
        found = []
        for *scales, log_weight in self.weights.scales:
            node = replace(self, scales=tuple(scales))
            found.append((log_weight + node.taken_by_alignment - self.taken_by_alignment, node))
        return tuple(found)

    @cached_property
    def _roots(self) -> tuple[np.ndarray, np.ndarray]:
        """ln of weight and constant (n_node,), and 1 / variance (n_node, n_response) or W^(1/2) of each node, stacked.
        """
        constant = np.array([weight + node.log_constant for weight, node in self.nodes])
        roots = [root for _, node in self.nodes if (root := node.root) is not None]
        if not roots:
            return constant, np.array([1 / node.std**2 for _, node in self.nodes])
        return constant, np.concatenate(roots)

    @cached_property
    def _shifts(self) -> np.ndarray | float:
        """Over its noise, by how much what each node expects of the error differs from `mean`: (n_node, n_effective).
        """
        return np.array([node.whiten(node.mean - self.mean) for _, node in self.given]) if self.given else 0.0

    def log_density(self, response: np.ndarray) -> np.ndarray:
        """ln p(Lambda_S) (n,) where the model answers `response` (n, n_response): Gaussian, averaged over the
        discrepancy's scales where these are learnt."""
        constant, roots = self._roots
        residual = self.measured - response
        if self.root is None:
            misfit = residual**2 @ roots.T
        else:
            white = (residual @ roots.T).reshape(len(residual), len(constant), -1)
            misfit = np.sum((white - self._shifts) ** 2, axis=2)
        return special.logsumexp(constant - 0.5 * misfit, axis=1)

    def log_likelihood(self, theta: np.ndarray) -> np.ndarray:
        """ln p(Lambda_S | theta) (n,), see `log_density`."""
        return self.log_density(self.predict_many(theta).response)

    def log_posterior(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ln p(theta | Lambda_S) + const, and which rows fell back to a full model, both (n,); -inf out of bounds, and
        where bounds allow what has no modes, such as a negative stiffness."""
        theta = np.atleast_2d(np.asarray(theta, float))
        value = self.parameters.log_density(theta)
        if self.images is not None:
            value = np.where(self.inside(theta), value + self.images.log_number, -np.inf)
        fallback = np.zeros(len(theta), bool)
        inside = np.isfinite(value)
        if not inside.any():
            return value, fallback
        try:
            predicted = self.predict_many(theta[inside])
        except (ProbupdateError, np.linalg.LinAlgError):
            if len(theta) == 1:
                return np.array([-np.inf]), fallback
            rows = [self.log_posterior(row) for row in theta]
            return np.concatenate([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
        value[inside] += self.log_density(predicted.response)
        fallback[inside] = predicted.fallback
        return value, fallback

    def with_model(self, model: Model) -> Problem:
        """The same problem answered by another model of the same modes, such as a reduced one."""
        return replace(self, model=model)

    def parts(self) -> dict[str, str]:
        """A hash of each part of the problem, by what a user would have changed."""
        weights = [self.std] if self.root is None else [self.std, self.root, self.mean]
        return {
            "model": self.model.fingerprint(),
            "prior": _hash(repr((tuple(self.parameters), None if self.parameters.correlation is None
                                 else self.parameters.correlation.tolist()))),
            "measured modes": _hash(self.measured, *(g.rows.astype(np.int64) for g in self.groups), self.set_id),
            "weights": _hash(*weights, self.weights.frequencies, self.weights.shapes, repr(self.weights.scales),
                             *(() if self.known is None else (self.known.matrix, self.known.value, self.known.slope))),
            "pairing": _hash(repr((self.matching.measured, self.matching.pairs, self.matching.n_mode,
                                   *(g.measured for g in self.matching.groups if g.mates)))),
        }

    def fingerprint(self) -> str:
        """A hash of model, prior, data and weights: two chains with the same one sample the same posterior."""
        return _hash(*(text for pair in self.parts().items() for text in pair))


def _hash(*parts: str | np.ndarray) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
        digest.update(b"|")
    return digest.hexdigest()


def build_problem(
    model: Model,
    data: ModalData,
    *,
    set_id: str | None = None,
    weights: Weights | None = None,
    clusters: list[tuple[int, ...]] | None = None,
) -> Problem:
    """Match the set's modes with the model's at the initial parameters and collect its responses.

    `weights` default to the standard deviations in the file. `clusters` fixes which modes are compared as planes, so
    that many sets are treated alike. Raises InputError where a standard deviation is missing or no mode can be matched.
    """
    if not len(model.parameters):
        raise InputError(model.name, "has no parameters to update", "list at least one [[parameter]] in its TOML")
    model = with_stated_gravity(model, data.felt)
    modal_set = data.set(set_id)
    weights = weights or Weights()
    rows = channel_rows(model, data.channels)
    if clusters is None and weights.shapes == "components":
        clusters = [(j,) for j in range(data.n_mode)]
    matching = match_set(model, data, modal_set, clusters=clusters, planes=weights.shapes != "components")
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    groups = tuple(response_group(modal_set, list(g.measured), rows, weights, labels, len(g.mates))
                   for g in matching.groups)
    problem = Problem(
        model=model, set_id=modal_set.id, mode_labels=labels, matching=matching, groups=groups, weights=weights
    )
    at = model.parameters.initial if weights.at is None else np.array(weights.at)
    if weights.mixing:
        problem = problem.with_mixing(at)
    if weights.tolerances:
        problem = problem.with_error(at)
    return problem.with_baseline()
