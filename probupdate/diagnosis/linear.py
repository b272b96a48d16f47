"""The test of every effect at once, with all that is normal marginalised.

A block's residuals are  y_b = G_b c + eps + sum_j a_j h_jb s_jb + sum_k h_kb D_kb d_k + e_b :  c what is normally
uncertain (parameters with their prior, tolerances), eps what no model form explains (an offset of each response), s_jb
the signature of effect j where the nacelle looked, h_jb its time profile, D_kb the model error of the signature of an
effect k that was taken in, e_b noise. Under "nothing is wrong" all a are zero and y is Gaussian, so that for each
candidate u = X^T V^-1 y has variance v = X^T V^-1 X and z = u / sqrt(v) is standard normal; a = u / v is its size and 1
/ sqrt(v) that one's standard deviation. V is never formed: it is the noise plus what a few hundred unknowns add
(Woodbury). """

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probupdate.diagnosis.arrow import ArrowFactor
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.errors import ConvergenceError

# draws are made in chunks of so many numbers; they are scored, and cross terms of candidates with the unknowns made, in
# chunks of so many: of all at once these are as large as all else together
CHUNK, SUMMED = 4_000_000, 500_000
# blocks that a group must have on either side of a step to show it
FEWEST_BEYOND = 3

# numbers of unknowns or of candidates
Rows = Sequence[int] | np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Design:
    """What does not depend on the data.

    bin_of (n_block,): number of the nacelle angle each block is counted to. nuisance per group (n_bin, n_response,
    n_nuisance) with nuisance_std (n_nuisance,); model discrepancy per group (n_response,) standard deviations of the
    offsets; effect per group (n_bin, n_response, n_effect). Candidates are pairs (effect, time profile): which
    (n_candidate, 2). `included`: effects already found, as (effect, its time profile, standard deviation of its size);
    their sizes are unknowns like c; the last `n_scatter` of them are no effects found but what such an effect does
    along other time profiles, and what follows a column that nobody recorded.
    `model_errors`: time profiles of effects already found, each with the standard deviations per group (n_bin,
    n_response) of their signature times size, all of which are multiplied by `error_scale`. `turns` per group (n_bin,
    3, 3): what sensors that show a pair's plane turned make of its tensor's offset; None where none does."""

    bin_of: np.ndarray
    nuisance: tuple[np.ndarray, ...]
    nuisance_std: np.ndarray
    discrepancy_std: tuple[np.ndarray, ...]
    effect: tuple[np.ndarray, ...]
    time_profiles: tuple[TimeProfile, ...]
    which: np.ndarray
    noise: Noise
    included: tuple[tuple[int, TimeProfile, float], ...] = ()
    model_errors: tuple[tuple[TimeProfile, tuple[np.ndarray, ...]], ...] = ()
    error_scale: float = 1.0
    n_scatter: int = 0
    turns: tuple[np.ndarray | None, ...] | None = None

    @property
    def sizes(self) -> slice:
        """Numbers of the unknowns that are sizes of effects found."""
        return slice(self.nuisance_std.size, self.n_common - self.n_scatter)

    @property
    def n_bin(self) -> int:
        return self.nuisance[0].shape[0]

    @cached_property
    def _profile_values(self) -> tuple[np.ndarray, ...]:
        """Per group (n_profile + 1 + n_named + n_model_error, n_block): candidates' time profiles centred over the
        group's blocks, so that no offset of the model is taken for a change; then one, included effects and their model
        errors as they are."""
        values = np.array([c.value for c in self.time_profiles])
        known = np.array([np.ones(len(self.bin_of)), *(time_profile.value for _, time_profile, _ in self.included),
                          *(time_profile.value for time_profile, _ in self.model_errors)])
        result = []
        for weight in self.noise.weight:
            centred = values - (values @ weight / max(weight.sum(), 1e-300))[:, None]
            centred = np.where([[c.kind == "constant"] for c in self.time_profiles], values, centred)
            # one or two blocks of a group beyond a step, one of them gone wrong, are no step of that group
            beyond = (values * (weight > 0)).sum(axis=1)
            least = 1 if self.noise.stated else FEWEST_BEYOND
            few = np.minimum(beyond, np.count_nonzero(weight) - beyond) < least
            centred[few & [c.kind == "step" for c in self.time_profiles]] = 0.0
            result.append(np.concatenate([centred, known]))
        return tuple(result)

    @cached_property
    def _blocks_in_bins(self) -> list[np.ndarray]:
        return [np.flatnonzero(self.bin_of == g) for g in range(self.n_bin)]

    @cached_property
    def _times(self) -> tuple[np.ndarray, ...]:
        """Per group (n_bin, n_row, n_row): weighted products of time profiles, summed over a bin's blocks."""
        return tuple(np.array([(h[:, own] * w[own]) @ h[:, own].T for own in self._blocks_in_bins])
                     for h, w in zip(self._profile_values, self.noise.weight, strict=True))

    @cached_property
    def _offsets(self) -> list[slice]:
        start = self.n_common
        slices = []
        for discrepancy_std in self.discrepancy_std:
            slices.append(slice(start, start + discrepancy_std.size))
            start += discrepancy_std.size
        return slices

    @property
    def n_common(self) -> int:
        """Unknowns that all groups share: c and the sizes of included effects."""
        return self.nuisance_std.size + len(self.included)

    def fitted_unknowns(self, n_own: int) -> list[int]:
        """Numbers of the unknowns that a fit chooses: the first n_own parameters and the sizes of included effects."""
        return [*range(n_own), *range(self.sizes.start, self.sizes.stop)]

    @property
    def n_unknown(self) -> int:
        return self.n_common + (1 + len(self.model_errors)) * sum(f.size for f in self.discrepancy_std)

    @cached_property
    def prior_std(self) -> np.ndarray:
        error_scales = [np.full(f.size, self.error_scale) for _ in self.model_errors for f in self.discrepancy_std]
        return np.concatenate([self.nuisance_std, [std for _, _, std in self.included], *self.discrepancy_std,
                               *error_scales])

    @cached_property
    def _unknowns_by_profile(self) -> tuple[list[tuple[int, slice, np.ndarray]], ...]:
        """Per group the unknowns that it sees, those of one kind together: the time profile that they follow, the n
        numbers that they have and what one of each makes (n_bin, n_response, n); (n_bin, n_response) where each
        response has its own."""
        n_c, n_profile = self.nuisance_std.size, len(self.time_profiles)
        total = sum(f.size for f in self.discrepancy_std)
        result = []
        for q, rows in enumerate(self._offsets):
            own = [(n_profile, slice(0, n_c), self.nuisance[q])]
            own += [(n_profile + 1 + start, slice(n_c + start, n_c + end),
                     self.effect[q][:, :, [effect for effect, _, _ in self.included[start:end]]])
                    for start, end in self._runs_of_one_profile]
            own += [(n_profile, slice(rows.start + part.start, rows.start + part.stop), made)
                    for part, made in self.offset_responses(q)]
            own += [(n_profile + 1 + len(self.included) + k,
                     slice(rows.start + (k + 1) * total, rows.stop + (k + 1) * total), spread[q])
                    for k, (_, spread) in enumerate(self.model_errors)]
            result.append(own)
        return tuple(result)

    @cached_property
    def _runs_of_one_profile(self) -> list[tuple[int, int]]:
        """Where those of the included effects begin and end that follow one another along the same time profile."""
        keys = [time_profile.value.tobytes() for _, time_profile, _ in self.included]
        starts = [k for k, key in enumerate(keys) if not k or key != keys[k - 1]]
        return list(zip(starts, [*starts[1:], len(keys)], strict=True)) if keys else []

    def offset_responses(self, q: int) -> list[tuple[slice, np.ndarray]]:
        """Which of a group's offsets make what (n_bin, n_response, n); (n_bin, n_response) where each makes itself."""
        m = self.discrepancy_std[q].size
        itself, turned = np.ones((self.n_bin, m)), None if self.turns is None else self.turns[q]
        if turned is None:
            return [(slice(0, m), itself)]
        n = turned.shape[2]
        itself[:, :n] = 0.0
        return [(slice(0, m), itself), (slice(0, n), np.pad(turned, ((0, 0), (0, m - n), (0, 0))))]

    @cached_property
    def unknowns_information(self) -> np.ndarray:
        """U^T R^-1 U (n_unknown, n_unknown) of the unknowns, from the data alone."""
        information = np.zeros((self.n_unknown, self.n_unknown))
        for q, sorted_unknowns in enumerate(self._unknowns_by_profile):
            seen = np.flatnonzero(np.bincount(self.bin_of, self.noise.weight[q], self.n_bin))
            precision = self.noise.precision[q]
            parts = [(row, number, made[seen], precision if made.ndim == 2 else precision @ made[seen])
                     for row, number, made in sorted_unknowns]
            for k, (row, number, *made) in enumerate(parts):
                for other, its, *there in parts[: k + 1]:
                    total = _product(*made, *there, self._times[q][seen, row, other])
                    information[number, its] += total
                    if its is not number:
                        information[its, number] += total.T
        return information

    def with_error_scale(self, error_scale: float) -> Design:
        """The design with another `error_scale`; what does not depend on it is not worked out again."""
        other = replace(self, error_scale=error_scale)
        for name in ("_times", "_unknowns_by_profile", "unknowns_information"):
            vars(other)[name] = getattr(self, name)
        return other

    def with_candidates(self, time_profiles: Sequence[TimeProfile], which: np.ndarray) -> Design:
        """The design with other candidates; what the unknowns alone make is not worked out again."""
        other = replace(self, time_profiles=tuple(time_profiles), which=which)
        for name in ("unknowns_information", "_factor"):
            vars(other)[name] = getattr(self, name)
        return other

    def select_blocks(self, chosen: np.ndarray) -> Design:
        """The design of only the blocks numbered `chosen`."""
        def thin(profile: TimeProfile) -> TimeProfile:
            return replace(profile, value=profile.value[chosen])

        return replace(self, bin_of=self.bin_of[chosen], noise=self.noise.select_blocks(chosen),
                       time_profiles=tuple(map(thin, self.time_profiles)),
                       included=tuple((effect, thin(profile), std) for effect, profile, std in self.included),
                       model_errors=tuple((thin(profile), spread) for profile, spread in self.model_errors))

    def without_signatures(self) -> Design:
        """The design without signatures, and without what it was asked for."""
        return replace(self, nuisance=(), effect=(), model_errors=())

    @cached_property
    def _factor(self) -> ArrowFactor:
        """Cholesky factor of the unknowns' information with their prior's, each unknown in its prior's standard
        deviations, as these are many powers of ten apart."""
        return self._factor_without(())

    @cached_property
    def _factors(self) -> dict[tuple[int, ...], ArrowFactor]:
        return {}

    def _factor_held(self, held: tuple[int, ...]) -> ArrowFactor:
        """The same with the unknowns `held`, of those that all groups share, left out; the last one asked for is
        kept."""
        if not held:
            return self._factor
        if held not in self._factors:
            self._factors.clear()
            self._factors[held] = self._factor_without(held)
        return self._factors[held]

    def _factor_without(self, held: tuple[int, ...]) -> ArrowFactor:
        total = sum(f.size for f in self.discrepancy_std)
        groups = [np.concatenate([np.arange(own.start, own.stop) + k * total
                                  for k in range(1 + len(self.model_errors))]) for own in self._offsets]
        try:
            # where two modes nearly meet, what distinguishes them has no bound: sums are then rounded by more than a
            # prior's one
            return ArrowFactor.factorise(
                self.unknowns_information, groups, np.setdiff1d(np.arange(self.n_common), held), self.prior_std,
                self.n_unknown * np.finfo(float).eps)
        except np.linalg.LinAlgError:
            raise ConvergenceError(
                "the information matrix of the unknowns is singular: the fit moved to where modes cannot be "
                "distinguished",
                np.empty(0),
            ) from None

    def _solve(self, right: np.ndarray) -> np.ndarray:
        """Covariance of the unknowns given the data times right (n_unknown, ...)."""
        std = self.prior_std.reshape(-1, *[1] * (right.ndim - 1))
        return std * self._factor.solve(std * right)

    def _cross_terms(self, rows: np.ndarray) -> np.ndarray:
        """Cross terms B (n_row, n_unknown) of these candidates with the unknowns."""
        (effects, effect), (profiles, time_profile) = (np.unique(part, return_inverse=True)
                                                       for part in self.which[rows].T)
        B = np.zeros((len(rows), self.n_unknown))
        for q, sorted_unknowns in enumerate(self._unknowns_by_profile):
            weighted = self.noise.precision[q] @ self.effect[q][:, :, effects]
            for row, number, made in sorted_unknowns:
                turned = weighted.transpose(0, 2, 1)
                shared = turned * made[:, None] if made.ndim == 2 else turned @ made
                # of all pairs for one kind of unknowns at a time: few effects follow all time profiles
                cross = np.tensordot(self._times[q][:, profiles, row], shared, (0, 0))
                B[:, number] += cross[time_profile, effect]
        return B

    def _chunks(self, rows: np.ndarray) -> list[np.ndarray]:
        """Places in `rows` of candidates whose cross terms are made at once, those of one effect side by side."""
        n_chunk = max(1, min(len(rows), -(-len(rows) * self.n_unknown // SUMMED)))
        return np.array_split(np.argsort(self.which[rows, 0], kind="stable"), n_chunk)

    @cached_property
    def _informations(self) -> tuple[np.ndarray, np.ndarray]:
        """Per candidate its information before and after the unknowns have taken their part (n_candidate,)."""
        effect, time_profile = self.which.T
        raw = self._time_information[effect, time_profile, time_profile]
        taken, everything = np.zeros(len(raw)), np.arange(len(raw))
        for chunk in self._chunks(everything):
            # B C B^T with C = (L L^T)^-1 is the square of L^-1 B^T
            crossed = self._cross_terms(chunk)
            crossed *= self.prior_std
            half = self._factor.half_solve(crossed.T)
            taken[chunk] = np.einsum("uc,uc->c", half, half)
        return raw, np.maximum(raw - taken, 0.0)

    @property
    def information(self) -> np.ndarray:
        """v (n_candidate,): one over the square of each candidate's standard deviation."""
        return self._informations[1]

    @property
    def own_information(self) -> np.ndarray:
        """(n_candidate,) each candidate's information before the unknowns have taken their part."""
        return self._informations[0]

    @cached_property
    def share_left(self) -> np.ndarray:
        """(n_candidate,) how much of each signature's length remains once all that is normal has taken its part."""
        raw = self.own_information
        return np.sqrt(np.where(raw > 0, self.information / np.where(raw > 0, raw, 1.0), 0.0))

    def _sums(self, residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Per group (..., n_row, n_bin, n_response) of residuals (..., n_block, n_response), weighted and along the
        time profiles of what is known, the rows behind the candidates'."""
        return [np.stack([(h[len(self.time_profiles):, own] * w[own]) @ y[..., own, :] for own in self._blocks_in_bins],
                         axis=-2) for h, w, y in zip(self._profile_values, self.noise.weight, residuals, strict=True)]

    def scores(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """u (..., n_candidate) of residuals per group (..., n_block, n_response), zero where not measured."""
        return self.raw_scores(residuals, self.unknowns(residuals))

    def raw_scores(self, residuals: Sequence[np.ndarray], unknowns: np.ndarray) -> np.ndarray:
        """X^T R^-1 (y - U c) (..., n_candidate) of residuals y and unknowns c (..., n_unknown), R the noise alone.

        Each block with every effect's signature first, then along all time profiles: of half a month in a sixth of the
        operations that sums along time profiles in every bin take. """
        order = np.argsort(self.bin_of, kind="stable")
        ends = np.searchsorted(self.bin_of[order], np.arange(self.n_bin + 1))
        n_profile, n_effect = len(self.time_profiles), self.effect[0].shape[2]
        raw = np.zeros((n_profile, *residuals[0].shape[:-2], n_effect))
        for q, (y, made) in enumerate(zip(residuals, self.expected_residuals(unknowns), strict=True)):
            left = np.moveaxis(((y - made) * self.noise.weight[q][:, None]) @ self.noise.precision[q], -2, 0)[order]
            seen = np.empty((*left.shape[:-1], n_effect))
            for g in range(self.n_bin):
                own = slice(ends[g], ends[g + 1])
                seen[own] = (left[own].reshape(-1, left.shape[-1]) @ self.effect[q][g]).reshape(seen[own].shape)
            raw += np.tensordot(self._profile_values[q][:n_profile, order], seen, (1, 0))
        effect, time_profile = self.which.T
        return np.moveaxis(raw[time_profile, ..., effect], 0, -1)

    def _right(self, known: list[np.ndarray]) -> np.ndarray:
        """U^T R^-1 y (..., n_unknown), U what the unknowns make; `known` the `_sums` behind the candidates'."""
        right = np.zeros((*known[0].shape[:-3], self.n_unknown))
        for q, sorted_unknowns in enumerate(self._unknowns_by_profile):
            weighted = known[q] @ self.noise.precision[q]
            for row, number, made in sorted_unknowns:
                own = weighted[..., row - len(self.time_profiles), :, :]
                right[..., number] += (np.sum(own * made, axis=-2) if made.ndim == 2 else
                                       own.reshape(*own.shape[:-2], -1) @ made.reshape(-1, made.shape[-1]))
        return right

    def unknowns(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """Most probable c, sizes, offsets and model-error scales (..., n_unknown) when nothing else is wrong."""
        return self._solve(self.unknowns_scores(residuals).T).T

    def unknowns_scores(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """U^T R^-1 y (..., n_unknown) of residuals per group (..., n_block, n_response)."""
        return self._right(self._sums(residuals))

    def misfit(self, residuals: Sequence[np.ndarray], held: Sequence[int]) -> float:
        """y^T V^-1 y with the unknowns `held` at zero, all others marginalised."""
        return float(self.misfits([y[None] for y in residuals], held)[0])

    def misfits(self, residuals: Sequence[np.ndarray], held: Sequence[int]) -> np.ndarray:
        """`misfit` (n,) of residuals (n, n_block, n_response) per group."""
        right = self.unknowns_scores(residuals)
        half = self._factor_held(tuple(held)).half_solve((self.prior_std * right).T)
        # searching for the order of so small products costs more than they do
        total = sum(np.sum((y @ P) * y, axis=2) @ w for w, y, P in
                    zip(self.noise.weight, residuals, self.noise.precision, strict=True))
        return total - np.sum(half**2, axis=0)

    @cached_property
    def log_volume(self) -> float:
        """ln of the unknowns' posterior volume over that of their prior."""
        return -self._factor.log_diagonal

    @cached_property
    def log_noise(self) -> float:
        """ln of the noise's density at its centre, but for powers of 2 pi."""
        total = 0.0
        for covariance, weight in zip(self.noise.covariance, self.noise.weight, strict=True):
            used = weight[weight > 0]
            total += len(used) * np.linalg.slogdet(covariance)[1] - len(covariance) * np.sum(np.log(used))
        return float(-0.5 * total)

    def unknowns_cov(self, rows: Rows) -> np.ndarray:
        """Covariance (n, n) of the unknowns numbered `rows`, given the data."""
        rows = np.asarray(rows, int)
        return self._solve(np.eye(self.n_unknown)[:, rows])[rows]

    def expected_residuals(self, unknowns: np.ndarray) -> list[np.ndarray]:
        """Residuals per group (..., n_block, n_response) that unknowns (..., n_unknown) make."""
        result = []
        for h, discrepancy_std, sorted_unknowns in zip(
            self._profile_values, self.discrepancy_std, self._unknowns_by_profile, strict=True
        ):
            y = np.zeros((*unknowns.shape[:-1], len(self.bin_of), discrepancy_std.size))
            for row, number, made in sorted_unknowns:
                own = unknowns[..., number]
                here = (own[..., None, :] * made if made.ndim == 2 else
                        (own @ made.reshape(-1, made.shape[-1]).T).reshape(*own.shape[:-1], *made.shape[:2]))
                y += h[row][:, None] * here[..., self.bin_of, :]
            result.append(y)
        return result

    def scatter(
        self, residuals: Sequence[np.ndarray], time_profile: int, effects: Rows, weights: np.ndarray
    ) -> np.ndarray:
        """(n_direction,) by how much blocks scatter more along directions than the noise says, as standard deviations:
        sums of these effects' signatures with `weights` (n_effect, n_direction) that follow one time profile. Each
        block's own residual counts in place of the noise's variance, less what fits the direction (HC3, MacKinnon &
        White 1985), so that a few blocks gone wrong are no step. One where noise is taken as stated: so few blocks say
        nothing of their own scatter."""
        if self.noise.stated:
            return np.ones(weights.shape[1])
        own, known = np.zeros((2, len(self.bin_of), weights.shape[1]))
        for q, (y, normal) in enumerate(zip(residuals, self.expected_residuals(self.unknowns(residuals)), strict=True)):
            follows, weight = self._profile_values[q][time_profile], self.noise.weight[q]
            for g in range(self.n_bin):
                blocks = np.flatnonzero((self.bin_of == g) & (weight > 0))
                made = self.effect[q][g][:, effects] @ weights
                seen = self.noise.precision[q] @ made
                own[blocks] += (follows * weight)[blocks, None] * ((y - normal)[blocks] @ seen)
                known[blocks] += (follows**2 * weight)[blocks, None] * np.sum(made * seen, axis=0)
        total = np.maximum(known.sum(axis=0), 1e-300)
        apart = (own - own.sum(axis=0) / total * known) / np.maximum(1 - known / total, 1e-3)
        return np.sqrt(np.sum(apart**2, axis=0) / total)

    def overlap(self, rows: Rows, others: Rows) -> np.ndarray:
        """X^T V^-1 X (n_row, n_other) between candidates, V with all that is normal."""
        rows, others = np.asarray(rows, int), np.asarray(others, int)
        (effect, time_profile), (effect2, time_profile2) = self.which[rows].T, self.which[others].T
        if len(np.unique([*effect, *effect2])) == 1:
            information = self._time_information[effect[0]][np.ix_(time_profile, time_profile2)]
            return information - self._absorption(rows, others)
        (mine, effect), (their, effect2) = (np.unique(one, return_inverse=True) for one in (effect, effect2))
        at_times, of_effects = np.ix_(time_profile, time_profile2), np.ix_(effect, effect2)
        total = np.zeros((len(rows), len(others)))
        for E, precision, times in zip(self.effect, self.noise.precision, self._times, strict=True):
            alone = E[:, :, mine].transpose(0, 2, 1) @ (precision @ E[:, :, their])
            for between, time in zip(alone, times, strict=True):
                total += time[at_times] * between[of_effects]
        return total - self._absorption(rows, others)

    def _absorption(self, rows: np.ndarray, others: np.ndarray) -> np.ndarray:
        """What the unknowns take of X^T R^-1 X (n_row, n_other) between candidates."""
        if len(rows) < len(others):
            return self._absorption(others, rows).T
        crossed = self._cross_terms(others)
        solved = self._solve(crossed.T)
        if np.array_equal(rows, others):
            return crossed @ solved
        result = np.empty((len(rows), len(others)))
        for chunk in self._chunks(rows):
            result[chunk] = self._cross_terms(rows[chunk]) @ solved
        return result

    @cached_property
    def _time_information(self) -> np.ndarray:
        """(n_effect, n_profile, n_profile) X^T R^-1 X of each effect between its time profiles, R the noise alone."""
        n_profile = len(self.time_profiles)
        total = np.zeros((self.effect[0].shape[2], n_profile, n_profile))
        for E, precision, times in zip(self.effect, self.noise.precision, self._times, strict=True):
            alone = np.einsum("gme,gme->eg", precision @ E, E)
            total += np.tensordot(alone, times[:, :n_profile, :n_profile], 1)
        return total

    def score_correlation(self, rows: Rows) -> np.ndarray:
        """Correlation (n, n) of the z of candidates `rows`: how alike their signatures are, time profiles included,
        after all that is normal has taken its part."""
        size = np.sqrt(np.maximum(self.information[np.asarray(rows, int)], 1e-300))
        return np.clip(self.overlap(rows, rows) / np.outer(size, size), -1.0, 1.0)

    def simulate(self, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
        """Residuals per group (n_block, n_response) of one record with nothing wrong, zero where not measured."""
        expected = self.expected_residuals(rng.standard_normal(self.n_unknown) * self.prior_std)
        result = []
        for y, covariance, weight in zip(expected, self.noise.covariance, self.noise.weight, strict=True):
            noise = rng.standard_normal(y.shape) @ np.linalg.cholesky(covariance).T
            scale = np.where(weight > 0, 1 / np.sqrt(np.maximum(weight, 1e-12)), 0.0)
            result.append(np.where(weight[:, None] > 0, y + noise * scale[:, None], 0.0))
        return tuple(result)

    @cached_property
    def _drawn(self) -> dict[tuple[int, int], np.ndarray]:
        return {}

    def keep_draws(self, seed: int, n: int) -> np.ndarray:
        """`draw` by this seed, the last one kept."""
        if (seed, n) not in self._drawn:
            self._drawn.clear()
            self._drawn[seed, n] = self.draw(np.random.default_rng([seed, 21]), n)
        return self._drawn[seed, n]

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """u (n, n_candidate) of n records with nothing wrong: unknowns, noise and its scale drawn again."""
        roots = [np.linalg.cholesky(c) for c in self.noise.covariance]
        n_block = len(self.bin_of)
        total = n_block * sum(f.size for f in self.discrepancy_std)
        chunk = max(1, min(n, CHUNK // total))
        # each block with every effect: many more numbers than the record has
        at_once = max(1, SUMMED // (n_block * self.effect[0].shape[2]))
        scales = self.noise.scales(rng, n)
        result = np.empty((n, len(self.which)))
        for start in range(0, n, chunk):
            size = min(chunk, n - start)
            residuals = []
            parts = [slice(first, min(first + at_once, size)) for first in range(0, size, at_once)]
            for q, root in enumerate(roots):
                noise = np.empty((size, n_block, root.shape[0]))
                scale = np.where(self.noise.weight[q] > 0, 1 / np.sqrt(np.maximum(self.noise.weight[q], 1e-12)), 0)
                for part in parts:
                    noise[part] = rng.standard_normal(noise[part].shape) @ root.T
                    noise[part] *= scale[None, :, None]
                    if scales:
                        noise[part] *= scales[q][start : start + size][part, None, :]
                residuals.append(noise)
            unknown = rng.standard_normal((size, self.n_unknown)) * self.prior_std
            for part in parts:
                own = [y[part] for y in residuals]
                right = self.unknowns_scores(own) + unknown[part] @ self.unknowns_information
                result[start : start + size][part] = self.raw_scores(own, self._solve(right.T).T - unknown[part])
        result.setflags(write=False)
        return result


def _product(
    made: np.ndarray, turned: np.ndarray, there: np.ndarray, turned_there: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """sum_g weight_g made_g^T P there_g (n, m) of what two kinds of unknowns make in each bin, P the precision
    (n_response, n_response); `turned`: P times that, or P itself where what has two axes stands for a diagonal."""
    if made.ndim == 2 and there.ndim == 2:
        return turned * ((weight[:, None] * made).T @ there)
    if made.ndim == 2:
        return np.einsum("gm,gmn->mn", weight[:, None] * made, turned_there)
    if there.ndim == 2:
        return _product(there, turned_there, made, turned, weight).T
    left = (weight[:, None, None] * made).reshape(-1, made.shape[2])
    return left.T @ turned_there.reshape(-1, there.shape[2])
