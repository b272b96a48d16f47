"""The test of every effect at once, with all that is normal marginalised.

A block's departures are  y_b = G_b c + eps + sum_j a_j h_jb s_jb + e_b :  c what is normally uncertain (parameters
with their prior, tolerances, differences of model form), eps what no model form explains (an offset of each
response), s_jb the fingerprint of effect j where the nacelle looked, h_jb its course, e_b noise. Under "nothing is
wrong" all a are zero and y is Gaussian, so that for each candidate u = X^T V^-1 y has variance v = X^T V^-1 X and
z = u / sqrt(v) is standard normal; a = u / v is its size and 1 / sqrt(v) that one's deviation. V is never formed: it is
the noise plus what a few hundred unknowns add (Woodbury).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from probupdate.diagnosis.courses import Course
from probupdate.diagnosis.noise import Noise
from probupdate.modes import frozen_array

# draws are made in portions of so many numbers
PORTION = 4_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Design:
    """What does not depend on the data.

    bin_of (n_block,): number of the nacelle angle each block is counted to. nuisance per group (n_bin, n_response,
    n_nuisance) with nuisance_std (n_nuisance,); floor per group (n_response,) deviations of the offsets; effect per
    group (n_bin, n_response, n_effect). Candidates are pairs (effect, course): which (n_candidate, 2). `named`: effects
    already found, as (effect, its course, deviation of its size); their sizes are unknowns like c.
    """

    bin_of: np.ndarray
    nuisance: tuple[np.ndarray, ...]
    nuisance_std: np.ndarray
    floor: tuple[np.ndarray, ...]
    effect: tuple[np.ndarray, ...]
    courses: tuple[Course, ...]
    which: np.ndarray
    noise: Noise
    named: tuple[tuple[int, Course, float], ...] = ()

    @property
    def n_bin(self) -> int:
        return self.nuisance[0].shape[0]

    @cached_property
    def _course_values(self) -> tuple[np.ndarray, ...]:
        """Per group (n_course + n_named, n_block): candidates' courses centred over the group's blocks, so that no
        offset of the model is taken for a change; named ones as they are."""
        values = np.array([c.value for c in self.courses])
        known = np.array([course.value for _, course, _ in self.named]).reshape(-1, len(self.bin_of))
        result = []
        for weight in self.noise.weight:
            centred = values - (values @ weight / weight.sum())[:, None]
            centred = np.where([[c.kind == "constant"] for c in self.courses], values, centred)
            result.append(np.concatenate([centred, known]))
        return tuple(result)

    @cached_property
    def _aggregators(self) -> tuple[np.ndarray, ...]:
        """Per group (n_course + n_named, n_bin, n_block): weights that sum blocks up."""
        onehot = (self.bin_of[None, :] == np.arange(self.n_bin)[:, None]).astype(float)
        return tuple(
            h[:, None, :] * onehot[None] * w
            for h, w in zip(self._course_values, self.noise.weight, strict=True)
        )

    @cached_property
    def _offsets(self) -> list[slice]:
        start = self.n_common
        slices = []
        for floor in self.floor:
            slices.append(slice(start, start + floor.size))
            start += floor.size
        return slices

    @property
    def n_common(self) -> int:
        """Unknowns that all groups share: c and the sizes of named effects."""
        return self.nuisance_std.size + len(self.named)

    @property
    def n_unknown(self) -> int:
        return self.n_common + sum(f.size for f in self.floor)

    @cached_property
    def prior_std(self) -> np.ndarray:
        return np.concatenate([self.nuisance_std, [std for _, _, std in self.named], *self.floor])

    @cached_property
    def _system(self):
        """Cholesky factor of the unknowns' information; per candidate its cross terms B (n_candidate, n_unknown) and
        own information (n_candidate,)."""
        n_c, n_all = self.nuisance_std.size, self.n_common
        n_effect, n_course = self.effect[0].shape[2], len(self.courses)
        known = [effect for effect, _, _ in self.named]
        information = np.zeros((self.n_unknown, self.n_unknown))
        cross = np.zeros((n_course, n_effect, self.n_unknown))
        own = np.zeros((n_course, n_effect))
        for q, rows in enumerate(self._offsets):
            precision, weight, h = self.noise.precision[q], self.noise.weight[q], self._course_values[q]
            counts = np.bincount(self.bin_of, weight, self.n_bin)
            first = self._aggregators[q].sum(axis=2)
            for g in np.flatnonzero(counts):
                there = self.bin_of == g
                time = (h[:, there] * weight[there]) @ h[:, there].T
                G, E = self.nuisance[q][g], self.effect[q][g]
                PG, PE = precision @ G, precision @ E
                EPG, EPE = E.T @ PG, E.T @ PE
                information[:n_c, :n_c] += counts[g] * G.T @ PG
                information[rows, :n_c] += counts[g] * PG
                cross[:, :, :n_c] += first[:n_course, g, None, None] * EPG
                cross[:, :, rows] += first[:n_course, g, None, None] * PE.T
                own += np.diag(time)[:n_course, None] * np.diag(EPE)
                for k, effect in enumerate(known):
                    a = n_c + k
                    information[a, :n_c] += first[n_course + k, g] * EPG[effect]
                    information[rows, a] += first[n_course + k, g] * PE[:, effect]
                    information[a, n_c:n_all] += time[n_course + k, n_course:] * EPE[effect, known]
                    cross[:, :, a] += time[:n_course, n_course + k, None] * EPE[:, effect]
            information[rows, rows] += counts.sum() * precision
        information[:n_c, n_c:n_all] = information[n_c:n_all, :n_c].T
        information[:n_all, n_all:] = information[n_all:, :n_all].T
        effect, course = self.which.T
        information[np.diag_indices_from(information)] += self.prior_std**-2.0
        factor = linalg.cho_factor(information, lower=True)
        B = cross[course, effect]
        solved = linalg.cho_solve(factor, B.T).T
        raw = own[course, effect]
        v = raw - np.sum(B * solved, axis=1)
        return factor, B, solved, raw, np.maximum(v, 0.0)

    @property
    def information(self) -> np.ndarray:
        """v (n_candidate,): one over the square of each candidate's deviation."""
        return self._system[4]

    @cached_property
    def share_left(self) -> np.ndarray:
        """(n_candidate,) how much of each fingerprint's length remains once all that is normal has taken its part."""
        raw = self._system[3]
        return np.sqrt(np.where(raw > 0, self.information / np.where(raw > 0, raw, 1.0), 0.0))

    def _sums(self, departures: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Per group (..., n_course, n_bin, n_response) of departures (..., n_block, n_response)."""
        return [np.tensordot(A, y, axes=(2, -2)) if y.ndim == 2
                else np.moveaxis(np.tensordot(A, y, axes=(2, 1)), 2, 0)
                for A, y in zip(self._aggregators, departures, strict=True)]  # fmt: skip

    def scores(self, departures: Sequence[np.ndarray]) -> np.ndarray:
        """u (..., n_candidate) of departures per group (..., n_block, n_response), zero where not measured."""
        raw, right = self._project(self._sums(departures))
        return raw - right @ self._system[2].T

    def _project(self, sums: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """X^T R^-1 y (..., n_candidate) and G^T R^-1 y (..., n_unknown)."""
        n_c, n_course = self.nuisance_std.size, len(self.courses)
        lead = sums[0].shape[:-3]
        raw = np.zeros((*lead, n_course, self.effect[0].shape[2]))
        right = np.zeros((*lead, self.n_unknown))
        for q, rows in enumerate(self._offsets):
            weighted = sums[q] @ self.noise.precision[q]
            raw += np.einsum("...cgm,gme->...ce", weighted[..., :n_course, :, :], self.effect[q], optimize=True)
            constant = weighted[..., 0, :, :]
            right[..., :n_c] += np.einsum("...gm,gmk->...k", constant, self.nuisance[q], optimize=True)
            for k, (effect, _, _) in enumerate(self.named):
                right[..., n_c + k] += np.einsum(
                    "...gm,gm->...", weighted[..., n_course + k, :, :], self.effect[q][:, :, effect])
            right[..., rows] += constant.sum(axis=-2)
        effect, course = self.which.T
        return raw[..., course, effect], right

    def unknowns(self, departures: Sequence[np.ndarray]) -> np.ndarray:
        """Most probable c and offsets (n_unknown,) when nothing is wrong."""
        _, right = self._project(self._sums(departures))
        return linalg.cho_solve(self._system[0], right)

    def misfit(self, departures: Sequence[np.ndarray], held: Sequence[int]) -> float:
        """y^T V^-1 y with the unknowns `held` at zero, all others marginalised."""
        _, right = self._project(self._sums(departures))
        free = np.setdiff1d(np.arange(self.n_unknown), np.asarray(held, int))
        lower = np.tril(self._system[0][0])
        information = lower @ lower.T
        solved = np.linalg.solve(information[np.ix_(free, free)], right[free])
        total = sum(float(np.einsum("n,nm,mk,nk->", w, y, P, y, optimize=True)) for w, y, P in
                    zip(self.noise.weight, departures, self.noise.precision, strict=True))  # fmt: skip
        return total - float(right[free] @ solved)

    def unknowns_cov(self, rows: Sequence[int]) -> np.ndarray:
        """Covariance (n, n) of the unknowns numbered `rows`, given the data."""
        rows = np.asarray(rows, int)
        return linalg.cho_solve(self._system[0], np.eye(self.n_unknown)[:, rows])[rows]

    def expected(self, unknowns: np.ndarray) -> list[np.ndarray]:
        """Departures per group (n_block, n_response) that unknowns (n_unknown,) make."""
        n_c = self.nuisance_std.size
        result = []
        for q, rows in enumerate(self._offsets):
            y = (self.nuisance[q] @ unknowns[:n_c])[self.bin_of] + unknowns[rows]
            for k, (effect, course, _) in enumerate(self.named):
                y += unknowns[n_c + k] * course.value[:, None] * self.effect[q][self.bin_of, :, effect]
            result.append(y)
        return result

    def overlap(self, rows: Sequence[int], others: Sequence[int]) -> np.ndarray:
        """X^T V^-1 X (n_row, n_other) between candidates, V with all that is normal."""
        rows, others = np.asarray(rows, int), np.asarray(others, int)
        _, B, solved, _, _ = self._system
        (effect, course), (effect2, course2) = self.which[rows].T, self.which[others].T
        total = np.zeros((len(rows), len(others)))
        for q in range(len(self.floor)):
            weight, h = self.noise.weight[q], self._course_values[q]
            precision = self.noise.precision[q]
            for g in range(self.n_bin):
                there = self.bin_of == g
                if not np.any(weight[there]):
                    continue
                E = self.effect[q][g]
                time = (h[:, there] * weight[there]) @ h[:, there].T
                total += time[np.ix_(course, course2)] * (E[:, effect].T @ (precision @ E[:, effect2]))
        return total - B[rows] @ solved[others].T

    def likeness(self, rows: Sequence[int]) -> np.ndarray:
        """Correlation (n, n) of the z of candidates `rows`: how alike their fingerprints are, courses included, after
        all that is normal has taken its part."""
        size = np.sqrt(np.maximum(self.information[np.asarray(rows, int)], 1e-300))
        return np.clip(self.overlap(rows, rows) / np.outer(size, size), -1.0, 1.0)

    def simulate(self, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
        """Departures per group (n_block, n_response) of one record with nothing wrong, zero where not measured."""
        expected = self.expected(rng.standard_normal(self.n_unknown) * self.prior_std)
        result = []
        for y, covariance, weight in zip(expected, self.noise.covariance, self.noise.weight, strict=True):
            noise = rng.standard_normal(y.shape) @ np.linalg.cholesky(covariance).T
            scale = np.where(weight > 0, 1 / np.sqrt(np.maximum(weight, 1e-12)), 0.0)
            result.append(np.where(weight[:, None] > 0, y + noise * scale[:, None], 0.0))
        return tuple(result)

    def draw(self, rng: np.random.Generator, n: int, memory: Sequence[float] | None = None) -> np.ndarray:
        """u (n, n_candidate) of n records with nothing wrong: unknowns and noise drawn anew.

        memory: per group, the correlation of successive blocks' noise.
        """
        factor, B, solved, _, _ = self._system
        roots = [np.linalg.cholesky(c) for c in self.noise.covariance]
        n_block = len(self.bin_of)
        total = n_block * sum(f.size for f in self.floor)
        portion = max(1, min(n, PORTION // total))
        result = []
        lower = np.tril(factor[0])
        information = lower @ lower.T - np.diag(self.prior_std**-2.0)
        for start in range(0, n, portion):
            size = min(portion, n - start)
            departures = []
            for q, root in enumerate(roots):
                white = rng.standard_normal((size, n_block, root.shape[0]))
                if memory is not None and memory[q] > 0:
                    white = _remembering(white, memory[q])
                scale = np.where(self.noise.weight[q] > 0, 1 / np.sqrt(np.maximum(self.noise.weight[q], 1e-12)), 0)
                departures.append(white @ root.T * scale[None, :, None])
            raw, right = self._project(self._sums(departures))
            unknown = rng.standard_normal((size, self.n_unknown)) * self.prior_std
            result.append(raw + unknown @ B.T - (right + unknown @ information) @ solved.T)
        return frozen_array(np.concatenate(result))


def _remembering(white: np.ndarray, rho: float) -> np.ndarray:
    """A first-order autoregression of unit variance along the second axis."""
    from scipy.signal import lfilter

    start = white[:, :1]
    rest = np.sqrt(1 - rho**2) * white[:, 1:]
    series = np.concatenate([start, rest], axis=1)
    return lfilter([1.0], [1.0, -rho], series, axis=1)
