"""The model with the included effects, fitted to the blocks: the design there, and the best values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, optimize

from probupdate.diagnosis.expected import local_at, residuals_at, signatures_at
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.mode_numbers import tensor_turn
from probupdate.diagnosis.noise import Noise, estimate_noise
from probupdate.diagnosis.predictor import observe
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect, local_std, prior_shift
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import Delay, Effect, FrequencyResponse, Gain
from probupdate.runtime.arrays import frozen_array

# a fit has settled when no parameter moves by more, in posterior standard deviations
SETTLED, MOST_STEPS = 0.1, 40
# steps after which the noise is kept
WARM = 3
# a change of -2 ln posterior that does not matter, and the share of it that the linear equations may still promise at
# the least value: signatures are derivatives of the expected modes alone, and where much is left over the residuals
# from them change a little otherwise
FLAT, FLAT_SHARE = 0.1, 0.03
# a step is no longer than so many prior standard deviations, unless it leads on along the last one
LONGEST, HALVINGS = 1.0, 6
# a step that leads back by this share of its length, and is this much of the last one at least, goes to and fro; by how
# much more of the next steps is taken where it does not, and by how much longer one may be that leads on
BACK, BACK_AS_FAR, RECOVERS = 0.5, 0.7, 1.25
# steps that may go uphill
MOST_LEAPS = 8
# signatures of tolerances and effects are computed again every so many steps on the way, those of the updated
# parameters after every step longer than this, in posterior standard deviations
REFRESH, FAR = 6, 1.0
# angles of a nacelle at which it is asked how far modes may turn towards others that were not measured
MOST_ANGLES = 8
# relative error of an effect's signature, response by response: between this model and the virtual turbine, whose
# elements, mesh, soil and joints follow other theories, half of 66 effects at their true size left less than 8 % of
# their length, nine of ten less than 13 % (studies/blind/signatures.py)
MODEL_ERROR_SCALE = 0.1
# what a sensor's law makes of a shape is as well known as the shape
SENSOR_ERROR_SCALE = 0.01
# of what an effect does along a column, what it may do along a parabola at the column's end, and along another column
# that it may follow: a root, an exponential and a square of the column have 0.25 to 0.5
DRIVER_SHARE = 0.3
# prior standard deviation of the scatter of a block's effect about what its column says: the root mean square of half
# an hour of a mode of 1 % damping at 0.3 Hz is known to a tenth
COLUMN_SCATTER = 0.15
# a structure's modes have hardly more damping
MOST_DAMPING = 0.02


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """theta (n_param of the extended model,), included effects with their sizes, residuals per group (n_block,
    n_response) from what they predict (zero where not measured), and the design there. `steps` of the iteration,
    `last_step` in posterior standard deviations, infinite where it stopped without having settled. `short` (n_named,):
    how much farther the linear equations would take each size where the fit itself led no farther down, else zero."""

    theta: np.ndarray
    included: tuple[IncludedEffect, ...]
    residuals: tuple[np.ndarray, ...]
    centred: tuple[np.ndarray, ...]
    design: Design
    steps: int
    last_step: float
    short: np.ndarray

    @property
    def settled(self) -> bool:
        return bool(np.isfinite(self.last_step))


def design_at(
    problem: DiagnosisProblem,
    theta: np.ndarray,
    included: Sequence[IncludedEffect],
    noise: Noise,
) -> Design:
    """Signatures at theta and the included effects, a bin of blocks for each angle before and after each step: an error
    of a few per cent that changes sign with the step looks like the step, which is known better than that."""
    return _design(problem, theta, included, noise, range(len(problem.effects)), None)


def design_without_candidates(
    problem: DiagnosisProblem,
    theta: np.ndarray,
    included: Sequence[IncludedEffect],
    noise: Noise,
    before: Design | None = None,
) -> Design:
    """`design_at` for all but scores: of the catalogue it has the tolerances and the effects that are included. With
    the design of a point nearby (`before`), only the signatures of the updated parameters are computed again."""
    scattering = (j for j, _, _ in _scatter(problem, included))
    needed = sorted({_number(problem, n) for n in included}.union(scattering))
    return _design(problem, theta, included, noise, needed, before)


def _design(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect], noise: Noise,
    catalogue: Sequence[int], before: Design | None,
) -> Design:
    """With the signatures of the effects of these numbers, candidates where they are all there are."""
    exact = [n for n in included if n.exact]
    levels = np.column_stack([*(n.time_profile.value for n in exact), problem.bins[1]])
    bins, bin_of = np.unique(levels, axis=0, return_inverse=True)
    bin_of = bin_of.ravel()
    known = None if before is None else (before, before.bin_of[np.unique(bin_of, return_index=True)[1]])
    nuisance, effect = _nuisance_and_effects(problem, theta, exact, bins, catalogue, known)
    prior = [local_std(problem.prior, i, theta[k]) for i, k in enumerate(problem.updated)]
    column = {j: k for k, j in enumerate(catalogue)}
    scatter = [(column[j], profile, std) for j, profile, std in _scatter(problem, included)]
    # whole arrays of their own: products of parts of larger ones differ in the last digit from those of copies, which
    # other processes have
    nuisance, effect = (tuple(map(np.ascontiguousarray, parts)) for parts in (nuisance, effect))
    return Design(
        bin_of=bin_of,
        nuisance=nuisance,
        nuisance_std=np.array([*prior, *(problem.effects[j].tolerance for j in problem.effects_with_tolerance)]),
        discrepancy_std=problem.discrepancy_std,
        effect=effect,
        time_profiles=problem.time_profiles,
        which=problem.which if len(catalogue) == len(problem.effects) else np.zeros((0, 2), int),
        noise=noise,
        included=(*((column[_number(problem, n)], n.time_profile, n.prior_std)
                    for n in included if not n.effect.discrete), *scatter),
        n_scatter=len(scatter),
        turns=_turns(problem, theta, exact, bins),
        model_errors=effect_model_errors(problem, included, [[e[:, :, column[_number(problem, n)]] for e in effect]
                                                       for n in included]),
    )


def _nuisance_and_effects(
    problem: DiagnosisProblem, theta: np.ndarray, exact: Sequence[IncludedEffect], bins: np.ndarray,
    catalogue: Sequence[int], known: tuple[Design, np.ndarray] | None,
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Per group the signatures (n_bin, n_response, n) of updated parameters and tolerances, and of the effects with
    these numbers. `known`: a design of a point nearby and its bin for each of these, from which all but the updated
    parameters' are taken."""
    names = problem.predictor.parameters.names
    own = [Effect(kind="structural", cause="parameter", location=names[k], unit="", tolerance=0.0, prior_scale=1.0,
                  parameter=names[k]) for k in problem.updated]
    n_own, left = len(own), _share_left(problem, exact, bins)
    if known is not None:
        before, same = known
        chosen = tuple(names[k] for k in problem.updated)
        prints = [left * p for p in _signatures_of_bins(problem, theta, exact, bins, own, chosen)]
        columns = list(catalogue if len(before.which) else range(len(catalogue)))
        return (tuple(np.concatenate([p, old[same][:, :, n_own:]], axis=2)
                      for p, old in zip(prints, before.nuisance, strict=True)),
                tuple(e[same][:, :, columns] for e in before.effect))
    if len(catalogue) == len(problem.effects):
        prints = _signatures_of_bins(problem, theta, exact, bins, [*own, *problem.effects], names)
        nuisance, shown = [*range(n_own), *(n_own + j for j in problem.effects_with_tolerance)], slice(n_own, None)
    else:
        rows = [*own, *(problem.effects[j] for j in (*problem.effects_with_tolerance, *catalogue))]
        moved = {name for e in rows for name, _ in e.increments}
        prints = _signatures_of_bins(problem, theta, exact, bins, rows, tuple(n for n in names if n in moved))
        n_nuisance = n_own + len(problem.effects_with_tolerance)
        nuisance, shown = [*range(n_nuisance)], slice(n_nuisance, None)
    for p in prints:
        p[:, :, :n_own] *= left
    return tuple(p[:, :, nuisance] for p in prints), tuple(p[:, :, shown] for p in prints)


def _share_left(problem: DiagnosisProblem, exact: Sequence[IncludedEffect], bins: np.ndarray) -> np.ndarray:
    """What in each bin a unit of each updated parameter still is (n_bin, 1, n_updated), where groups of them have lost
    a share of what they have."""
    names, initial = problem.predictor.parameters.names, problem.prior.initial
    column = {names[k]: i for i, k in enumerate(problem.updated) if initial[i]}
    left = np.ones((len(bins), 1, len(problem.updated)))
    for j, n in enumerate(exact):
        for name, amount in n.effect.parts:
            if name in column:
                left[:, 0, column[name]] += n.size * bins[:, j] * amount / initial[column[name]]
    return left


def design_with_more(problem: DiagnosisProblem, fitted: Fit, first: int) -> Design:
    """The design of a fit with the signatures of the problem's effects from number `first` on, which it does not have,
    and the problem's candidates."""
    exact, more = [n for n in fitted.included if n.exact], problem.effects[first:]
    bins = np.unique(np.column_stack([*(n.time_profile.value for n in exact), problem.bins[1]]), axis=0)
    names = tuple(name for effect in more for name, _ in effect.increments)
    prints = _signatures_of_bins(problem, fitted.theta, exact, bins, more, names)
    effect = tuple(np.concatenate(both, axis=2) for both in zip(fitted.design.effect, prints, strict=True))
    return replace(fitted.design, effect=effect, time_profiles=problem.time_profiles, which=problem.which)


def _scatter(
    problem: DiagnosisProblem, included: Sequence[IncludedEffect]
) -> tuple[tuple[int, TimeProfile, float], ...]:
    """What is like included effects, or like one that follows what was not recorded, and no effect of its own, as
    (number of its row, time profile, standard deviation)."""
    return (
        *problem.unrecorded,
        *_decays(problem, included),
        *((_number(problem, n), profile, DRIVER_SHARE * abs(n.size))
          for n in included for profile in driver_profiles(problem, n)),
    )


def driver_profiles(problem: DiagnosisProblem, included: IncludedEffect) -> tuple[TimeProfile, ...]:
    """What an effect along a ramp or a column may follow besides, less its own time profile: the column stands for what
    drives the effect, whose law is not known to be a straight line (a parabola), and which another column that the
    effect may follow shows in part: soil softens with its own strains, of which the vibration's amplitude and the
    waves' height are two accounts."""
    own = included.time_profile
    v = own.value - np.mean(own.value)
    if included.exact or not np.any(v):
        return ()
    others = [c.value * np.std(v) / np.std(c.value) for c in problem.time_profiles if c.kind == "covariate"
              and c.name in included.effect.time_profiles and c.name != own.name and np.ptp(c.value) > 0]
    straight = np.linalg.qr(np.column_stack([np.ones(len(v)), v]))[0]
    return tuple(replace(own, value=frozen_array(value - straight @ (straight.T @ value)))
                 for value in (v**2 / np.max(np.abs(v)), *others))


def _decays(
    problem: DiagnosisProblem, included: Sequence[IncludedEffect]
) -> tuple[tuple[int, TimeProfile, float], ...]:
    """What a late clock does to the decay of modes: identification has a mode's motion t later as exp(lambda t) times
    what it is, of which the catalogue's phase is the part without damping. Its channels look too small by the damping
    times the phase, as by a gain, which is no other effect."""
    blocks = problem.blocks
    if not any(isinstance(n.effect.observe, Delay) for n in included):
        return ()
    gains = {frozenset(e.observe.rows): j for j, e in enumerate(problem.effects) if isinstance(e.observe, Gain)}
    fastest = float(np.nanmax(np.nanmedian(blocks.frequency_hz, axis=0)))
    return tuple((gains[frozenset(n.effect.observe.rows)], n.time_profile,
                  MOST_DAMPING * 2e-3 * np.pi * fastest * abs(n.size))
                 for n in included
                 if isinstance(n.effect.observe, Delay) and frozenset(n.effect.observe.rows) in gains)


def _signatures_of_bins(
    problem: DiagnosisProblem, theta: np.ndarray, exact: Sequence[IncludedEffect], bins: np.ndarray,
    catalogue: Sequence[Effect], chosen: tuple[str, ...],
) -> list[np.ndarray]:
    """Per group (n_bin, n_response, n_effect): signatures of the `catalogue`, which moves the parameters `chosen`, in
    every bin: a row of `bins` holds what the time profiles of the `exact` effects are there, then the angle's
    number."""
    centres, _ = problem.bins
    states, state_of = np.unique(bins[:, :-1], axis=0, return_inverse=True)
    prints = [
        np.empty((len(bins), len(discrepancy_std), len(catalogue))) for discrepancy_std in problem.discrepancy_std
    ]
    for number, state in enumerate(states):
        there = np.flatnonzero(state_of.ravel() == number)
        predictor, local, seen = local_at(problem, theta, exact, state)
        angles = centres[bins[there, -1].astype(int)]
        at = signatures_at(predictor, local, catalogue, chosen, angles, seen, theta)
        for whole, part in zip(prints, at, strict=True):
            whole[there] = part
    return prints


def _turns(
    problem: DiagnosisProblem, theta: np.ndarray, exact: Sequence[IncludedEffect], bins: np.ndarray
) -> tuple[np.ndarray | None, ...] | None:
    """Per pair (n_bin, 3, 3) what the sensors of each bin make of an offset of its tensor, beside what they make where
    nothing is wrong with them: where one shows the pair's plane turned, what the model leaves out turns with it. At
    one heading, as what an effect turns hardly hangs on it."""
    if not any(n.effect.observe is not None for n in exact):
        return None
    centres, _ = problem.bins
    states, state_of = np.unique(bins[:, :-1], axis=0, return_inverse=True)
    turns = [np.tile(np.eye(3), (len(bins), 1, 1)) if len(g) > 1 else None for g in problem.blocks.groups]
    for number, state in enumerate(states):
        there = np.flatnonzero(state_of.ravel() == number)
        predictor, local, seen = local_at(problem, theta, exact, state)
        if not seen:
            continue
        plain = predictor.references(local, float(centres[int(bins[there[0], -1])]))
        for turn, axes, before, after in zip(turns, predictor.axes, plain, observe(plain, seen), strict=True):
            if turn is not None:
                turn[there] = tensor_turn(after.shape, axes) @ tensor_turn(before.shape, axes).T
    return tuple(turns)


def effect_model_errors(
    problem: DiagnosisProblem, included: Sequence[IncludedEffect], signatures: Sequence[Sequence[np.ndarray]]
) -> tuple[tuple[TimeProfile, tuple[np.ndarray, ...]], ...]:
    """Per time profile and group the standard deviations (n_bin, n_response) of the model errors of the included
    effects of these signatures, per effect and group (n_bin, n_response): those along one time profile are one error,
    as they are independent."""
    profiles: dict[bytes, TimeProfile] = {}
    variances: dict[bytes, list[np.ndarray]] = {}
    for n, effect in zip(included, signatures, strict=True):
        # a factor that every mode has of its own follows no theory that could be in error
        if isinstance(n.effect.observe, FrequencyResponse):
            continue
        key, scale = n.time_profile.value.tobytes(), error_scale(n.effect)
        own = [_model_error_std(problem, q, scale * n.size * e) ** 2 for q, e in enumerate(effect)]
        profiles.setdefault(key, n.time_profile)
        variances[key] = own if key not in variances else [a + b for a, b in zip(variances[key], own, strict=True)]
    return tuple((profiles[key], tuple(map(np.sqrt, own))) for key, own in variances.items())


def error_scale(effect: Effect) -> float:
    """What is not known of an effect's signature, as a share of it."""
    return SENSOR_ERROR_SCALE if effect.kind == "measurement" else MODEL_ERROR_SCALE


def _model_error_std(problem: DiagnosisProblem, group: int, amount: np.ndarray) -> np.ndarray:
    """Standard deviations (n_bin, n_response) of a signature whose error has the size `amount`: half of the variance
    where it is, half spread over the responses of its kind (logarithms of frequencies, real parts and phases of each
    shape)."""
    k, n_channel = len(problem.blocks.groups[group]), len(problem.blocks.channels)
    n_log = 1 if k == 1 else 3
    parts = [slice(0, n_log)]
    parts += [slice(start, start + n_channel) for start in range(n_log, amount.shape[1], max(n_channel, 1))]
    result = np.empty_like(amount)
    for part in parts:
        own = amount[:, part] ** 2
        result[:, part] = np.sqrt(0.5 * own + 0.5 * own.mean(axis=1, keepdims=True))
    return np.maximum(result, 1e-9)


def centred_residuals(
    problem: DiagnosisProblem, design: Design, theta: np.ndarray, included: Sequence[IncludedEffect], residuals
) -> tuple[np.ndarray, ...]:
    """Residuals less what the prior's centre would make: of mean zero when nothing is wrong."""
    made = design.expected_residuals(_prior_centre(problem, design, theta, included))
    return tuple(np.where(w[:, None] > 0, y - m, 0.0) for y, m, w in
                 zip(residuals, made, design.noise.weight, strict=True))


def _prior_centre(
    problem: DiagnosisProblem, design: Design, theta: np.ndarray, included: Sequence[IncludedEffect]
) -> np.ndarray:
    """Where the unknowns' prior is centred, as residuals from theta and the sizes."""
    unknowns = np.zeros(design.n_unknown)
    unknowns[: len(problem.updated)] = prior_shift(problem, theta)
    # sizes have their prior about zero: what they make is taken back to there
    unknowns[design.sizes] = [-n.size for n in included if not n.effect.discrete]
    return unknowns


def _remaining_residuals(
    problem: DiagnosisProblem, design: Design, theta: np.ndarray, included: Sequence[IncludedEffect], residuals
):
    """Residuals less what the unknowns make of them at their most probable. Tolerances of rotor and nacelle turn with
    the heading: they differ from block to block, and in the torsion's small components at the tower many times more
    than the noise does, which differences of blocks would else be taken for."""
    solved = design.unknowns(centred_residuals(problem, design, theta, included, residuals))
    made = design.expected_residuals(_prior_centre(problem, design, theta, included) + solved)
    return tuple(y - m for y, m in zip(residuals, made, strict=True))


def fit(problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect] = ()) -> Fit:
    """`fitted_without_candidates`, with scores of the whole catalogue at hand."""
    return with_candidates(problem, fitted_without_candidates(problem, theta, included))


def with_candidates(problem: DiagnosisProblem, fitted: Fit) -> Fit:
    """The fit with the design that scores the problem's candidates."""
    return replace(fitted, design=design_at(problem, fitted.theta, fitted.included, fitted.design.noise))


def fitted_without_candidates(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect] = (), *, base: Fit | None = None
) -> Fit:
    """Gauss-Newton to the most probable parameters and sizes, with all tolerances and model form marginalised. `base`:
    a fit of the same record without one of the effects, whose noise is kept.

    Where it does not settle the fit says so (`settled`), as one that has not converged looks like an effect. Raises
    ConvergenceError where the model has no modes.
    """
    theta, included, n_own = np.array(theta, float), tuple(included), len(problem.updated)
    here = residuals_at(problem, theta, included)
    if base is None:
        noise = turning_freely(problem, noise_of(problem, here), theta, included)
        design = design_without_candidates(problem, theta, included, noise)
    else:
        noise = base.design.noise
        design = design_without_candidates(problem, theta, included, noise, base.design)
    fresh, renewed, leaps, step = base is None, base is not None, 0, np.inf
    relaxed, reach, way = 1.0, LONGEST, np.zeros(0)
    for number in range(MOST_STEPS):
        ended = step < SETTLED
        # far from where the fit ends the noise is not what it is there
        if (ended and not renewed) or (base is None and 0 < number < WARM):
            left = _remaining_residuals(problem, design, theta, included, here)
            noise = with_column_scatter(design, noise_of(problem, left), included, left)
            noise = turning_freely(problem, noise, theta, included)
            renewed = renewed or ended
        if number:
            # what has settled with the signatures of another point need not have with those of its own
            fresh = ended or number % REFRESH == (0 if base is None else REFRESH - 1)
            if fresh or step > FAR:
                design = design_without_candidates(problem, theta, included, noise, None if fresh else design)
            else:
                design = replace(design, noise=noise)
        residuals = kept_columns(here, noise)
        centred = centred_residuals(problem, design, theta, included, residuals)
        newton = _newton(problem, design, theta, included, centred)
        before = design.misfit(residuals, design.fitted_unknowns(n_own)) + penalty(problem, theta, included, included)
        # what the linear equations promise
        promised = before - design.misfit(centred, []) - newton.beyond
        relaxed, reach, way = _relax_step(relaxed, reach, way, newton.share(LONGEST) * newton.way)
        share = relaxed * newton.share(reach)
        trial = None if promised < FLAT else _step_downhill(problem, design, theta, included, newton, before, share)
        if trial is not None:
            # a step that had to be shortened is not a small one
            step = _length(problem, design, theta, included, trial) / trial.share
            # on only as far as it led down
            reach = max(LONGEST, trial.share * newton.longest)
        elif promised <= max(1.0, FLAT_SHARE * before):
            # the least value along this line
            step = 0.0
        elif leaps == MOST_LEAPS:
            return _unsettled_fit(problem, theta, included, noise, here, number)
        else:
            # noise and signatures are others farther on: over the hill, as the equations say
            leaps += 1
            trial = _trial(problem, design, theta, included, newton, newton.share(LONGEST))
            step = _length(problem, design, theta, included, trial)
        if step < SETTLED and fresh and renewed:
            short = np.abs(newton.change) if trial is None and promised > 1.0 else np.zeros(len(included))
            return Fit(theta=theta, included=included, residuals=residuals, centred=centred, design=design,
                       steps=number, last_step=step, short=short)
        if trial is not None:
            theta, included, here = trial.theta, trial.included, trial.there
    return _unsettled_fit(problem, theta, included, noise, here, MOST_STEPS)


def first_steps(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect], noise: Noise, count: int
) -> tuple[np.ndarray, tuple[IncludedEffect, ...], float]:
    """Parameters, effects and -2 ln posterior where so many steps of a fit with this noise lead. Raises
    ConvergenceError where the model has no modes."""
    included, here = tuple(included), residuals_at(problem, theta, included)
    misfit = np.inf
    for _ in range(count):
        design = design_without_candidates(problem, theta, included, noise)
        residuals, centred = centre_about(problem, design, theta, included, here)
        newton = _newton(problem, design, theta, included, centred)
        misfit = (design.misfit(residuals, design.fitted_unknowns(len(problem.updated)))
                  + penalty(problem, theta, included, included))
        trial = _step_downhill(problem, design, theta, included, newton, misfit, newton.share(LONGEST))
        if trial is None:
            break
        theta, included, here, misfit = trial.theta, trial.included, trial.there, trial.misfit
    return theta, included, misfit


@dataclass(frozen=True, eq=False, kw_only=True)
class _Newton:
    """A Gauss-Newton step: `move` of the updated parameters in their prior's standard deviations `scale` (n_updated,),
    `change` of the sizes (n_named,), all of it in prior standard deviations (`way`), and by how much -2 ln posterior
    would be lower beyond the bounds (`beyond`)."""

    move: np.ndarray
    scale: np.ndarray
    change: np.ndarray
    way: np.ndarray
    beyond: float

    @property
    def longest(self) -> float:
        return float(np.max(np.abs(self.way), initial=1e-12))

    def share(self, reach: float) -> float:
        """Of the step, what is no longer than `reach`."""
        return min(1.0, reach / self.longest)


def _relax_step(share: float, reach: float, before: np.ndarray, way: np.ndarray) -> tuple[float, float, np.ndarray]:
    """The share of the next step that is taken, how long it may be, and the `way` itself, after one along `before`
    (empty for the first). Half as much where it leads back: of two points each may be better as seen from the other, as
    what is not known of an effect grows with its size. Farther where whole steps lead on."""
    if not len(before):
        return share, reach, way
    last, length = float(np.linalg.norm(before)), float(np.linalg.norm(way))
    along = before @ way / max(last * length, 1e-300)
    back = length > BACK_AS_FAR * last and along < -BACK
    farther = share == 1.0 and along > BACK
    return min(1.0, share * (0.5 if back else RECOVERS)), reach * RECOVERS if farther else LONGEST, way


def _newton(
    problem: DiagnosisProblem, design: Design, theta: np.ndarray, included: tuple[IncludedEffect, ...],
    centred: Sequence[np.ndarray],
) -> _Newton:
    """The step to where the linear equations have the most probable parameters and sizes within their bounds."""
    solved, n_own, updated = design.unknowns(centred), len(problem.updated), list(problem.updated)
    free, change = _free_effects(included), np.zeros(len(included))
    size, ends = np.array([included[k].size for k in free]), [included[k].bounds for k in free]
    step = np.concatenate([prior_shift(problem, theta) + solved[:n_own], solved[design.sizes] - size])
    here = np.concatenate([theta[updated], size])
    lower = np.concatenate([problem.prior.lower, [low for low, _ in ends]]) - here
    upper = np.concatenate([problem.prior.upper, [high for _, high in ends]]) - here
    beyond = 0.0
    if np.any((step < lower) | (step > upper)):
        step, beyond = _maximise_within_bounds(step, design.unknowns_cov(design.fitted_unknowns(n_own)), lower, upper)
    scale = np.array([local_std(problem.prior, i, theta[k]) for i, k in enumerate(updated)])
    move, change[free] = step[:n_own] / scale, step[n_own:]
    sizes = [d / n.prior_std for d, n in zip(change, included, strict=True)]
    return _Newton(move=move, scale=scale, change=change, way=np.array([*move, *sizes]), beyond=beyond)


def _maximise_within_bounds(
    step: np.ndarray, covariance: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, float]:
    """The most probable point between bounds under a normal density about `step`, and its squared distance from there:
    a step that is cut off at one parameter's bound leaves the others where they belong only together with it."""
    std = np.sqrt(np.diag(covariance))
    root = linalg.cholesky(covariance / np.outer(std, std), lower=True)
    white = linalg.solve_triangular(root, np.diag(1 / std), lower=True)
    found = optimize.lsq_linear(white, white @ step, (lower, upper), method="bvls")
    return np.clip(found.x, lower, upper), float(2 * found.cost)


def _free_effects(included: Sequence[IncludedEffect]) -> list[int]:
    """Numbers of the effects whose sizes are unknowns."""
    return [k for k, n in enumerate(included) if not n.effect.discrete]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Trial:
    """Where a share of a step leads, residuals there, and -2 ln posterior with the design it was made with."""

    theta: np.ndarray
    included: tuple[IncludedEffect, ...]
    there: tuple[np.ndarray, ...]
    misfit: float
    share: float


def _step_downhill(
    problem: DiagnosisProblem, design: Design, theta: np.ndarray, included: tuple[IncludedEffect, ...],
    newton: _Newton, before: float, most: float,
) -> _Trial | None:
    """The longest of the halvings of the share `most` of a step that lowers -2 ln posterior from `before`; None where
    none does."""
    for share in most * 0.5 ** np.arange(HALVINGS):
        trial = _trial(problem, design, theta, included, newton, share)
        if trial.misfit < before:
            return trial
    return None


def _trial(
    problem: DiagnosisProblem, design: Design, theta: np.ndarray, included: tuple[IncludedEffect, ...],
    newton: _Newton, share: float,
) -> _Trial:
    moved_theta, moved = _step(problem, theta, included, share * newton.move * newton.scale, share * newton.change)
    there = residuals_at(problem, moved_theta, moved)
    held = design.fitted_unknowns(len(problem.updated))
    misfit = design.misfit(kept_columns(there, design.noise), held) + penalty(problem, moved_theta, moved, included)
    return _Trial(theta=moved_theta, included=moved, there=there, misfit=misfit, share=share)


def _length(
    problem: DiagnosisProblem, design: Design, theta: np.ndarray, included: tuple[IncludedEffect, ...], trial: _Trial
) -> float:
    """By how many posterior standard deviations a trial moves what it moves most."""
    updated = list(problem.updated)
    count = sum(int(np.count_nonzero(w)) * y.shape[1] for w, y in zip(design.noise.weight, trial.there, strict=True))
    # what is left beyond the noise makes the posterior wider
    known = np.sqrt(np.diag(design.unknowns_cov(design.fitted_unknowns(len(updated)))) * max(1.0, trial.misfit / count))
    moved = np.abs(trial.theta[updated] - theta[updated])
    grown = [abs(trial.included[k].size - included[k].size) for k in _free_effects(included)]
    return float(np.max(np.concatenate([moved, grown]) / known, initial=0.0))


def _unsettled_fit(
    problem: DiagnosisProblem, theta: np.ndarray, included: tuple[IncludedEffect, ...], noise: Noise,
    here: Sequence[np.ndarray], number: int,
) -> Fit:
    """The fit where it stopped without having settled."""
    design = design_without_candidates(problem, theta, included, noise)
    residuals, centred = centre_about(problem, design, theta, included, here)
    return Fit(theta=theta, included=included, residuals=residuals, design=design, steps=number, last_step=np.inf,
               short=np.zeros(len(included)), centred=centred)


def centre_about(
    problem: DiagnosisProblem, design: Design, theta: np.ndarray, included: Sequence[IncludedEffect], residuals
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Residuals from theta and the included effects as far as they count, and less what the prior's centre makes."""
    residuals = kept_columns(residuals, design.noise)
    return residuals, centred_residuals(problem, design, theta, included, residuals)


def linearise(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect], noise: Noise,
    residuals: Sequence[np.ndarray],
) -> tuple[Design, tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """The design at theta and the included effects, with residuals from there as far as they count and less what the
    prior's centre makes."""
    design = design_at(problem, theta, included, noise)
    return design, *centre_about(problem, design, theta, included, residuals)


def noise_of(problem: DiagnosisProblem, residuals: Sequence[np.ndarray]) -> Noise:
    """From what residuals leave, with the pattern that the identification states."""
    blocks = problem.blocks
    sizes = tuple(len(g) for g in blocks.groups)
    return estimate_noise(tuple(residuals), problem.measured[1], sizes, blocks.relative_std, blocks.states(),
                          problem.stated, blocks.few, blocks.std_alone, problem.mixing)


def turning_freely(
    problem: DiagnosisProblem, noise: Noise, theta: np.ndarray, included: Sequence[IncludedEffect]
) -> Noise:
    """The noise where modes turn towards mates that were not measured, in the states that the included effects make:
    how far is not known from the model, whichever block it is, so that what lies along such a turn counts the less the
    nearer the mate is."""
    exact = [n for n in included if n.exact]
    states = np.unique(np.column_stack([np.zeros(len(problem.blocks)), *(n.time_profile.value for n in exact)]), axis=0)
    angles = problem.bins[0]
    angles = angles[:: max(1, len(angles) // MOST_ANGLES)]
    turns: list[list[np.ndarray]] = [[] for _ in noise.precision]
    for state in states:
        predictor, local, seen = local_at(problem, theta, exact, state[1:])
        for angle in angles:
            for found, (made, std) in zip(turns, predictor.unknown_turns(local, angle, seen), strict=True):
                found.append(made * std)
    return noise.with_free([np.hstack(found) for found in turns])


def with_column_scatter(
    design: Design, noise: Noise, included: Sequence[IncludedEffect], left: Sequence[np.ndarray]
) -> Noise:
    """The noise where a column shows what drives an included effect but for a scatter of its own, which moves blocks
    along the effect's signature: by which share of the effect is estimated from what is `left` of them."""
    free = [n for n in included if not n.effect.discrete]
    covariance = [np.array(C) for C in noise.covariance]
    for (effect, profile, _), n in zip(design.included, free, strict=False):
        if n.time_profile.kind != "covariate":
            continue
        amount = n.size * profile.value
        made = [amount[:, None] * e[design.bin_of, :, effect] for e in design.effect]
        turned = [w[:, None] * (s @ P) for s, P, w in zip(made, noise.precision, noise.weight, strict=True)]
        known = np.sum([np.sum(t * s, axis=1) for t, s in zip(turned, made, strict=True)], axis=0)
        seen = np.sum([np.sum(t * y, axis=1) for t, y in zip(turned, left, strict=True)], axis=0)
        share = _scatter_share(seen, known)
        for C, s, w in zip(covariance, made, noise.weight, strict=True):
            if np.any(w > 0):
                C += share**2 * (s.T * w) @ s / np.count_nonzero(w > 0)
    return replace(noise, covariance=tuple(map(frozen_array, covariance)),
                   precision=tuple(frozen_array(np.linalg.inv(C)) for C in covariance), free=())


def _scatter_share(seen: np.ndarray, known: np.ndarray) -> float:
    """Most probable standard deviation t of factors 1 + t N(0, 1) on effects of information `known` (n,), whose scores
    about them are `seen` (n,): of variance known + t^2 known^2."""
    seen, known = seen[known > 0], known[known > 0]
    if not len(known):
        return 0.0

    def misfit(share: float) -> float:
        variance = known * (1 + share**2 * known)
        return float(np.sum(seen**2 / variance + np.log(variance)) + (share / COLUMN_SCATTER) ** 2)

    return float(optimize.minimize_scalar(misfit, bounds=(0.0, 5 * COLUMN_SCATTER), method="bounded").x)


def kept_columns(residuals, noise: Noise):
    return tuple(np.where(w[:, None] > 0, y, 0.0) for y, w in zip(residuals, noise.weight, strict=True))


def penalty(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect], about: Sequence[IncludedEffect]
) -> float:
    """-2 ln prior of parameters and sizes, but for constants; of sizes by the normal densities that stand for their
    prior where the effects are `about`: it lies above the prior's own everywhere else, so that a step which lowers it
    lowers that one too (Hunter & Lange 2004)."""
    total = sum((n.size / at.prior_std) ** 2 for n, at in zip(included, about, strict=True) if not n.effect.discrete)
    for p, k in zip(problem.prior, problem.updated, strict=True):
        normal = p.prior != "lognormal"
        total += ((theta[k] - p.initial) / p.std if normal else np.log(theta[k] / p.initial) / p.log_std) ** 2
    return float(total)


def _step(
    problem: DiagnosisProblem,
    theta: np.ndarray,
    included: Sequence[IncludedEffect],
    move: np.ndarray,
    change: np.ndarray,
) -> tuple[np.ndarray, tuple[IncludedEffect, ...]]:
    """theta and sizes after a step, within their bounds."""
    fresh, updated = theta.copy(), list(problem.updated)
    fresh[updated] = np.clip(theta[updated] + move, problem.prior.lower, problem.prior.upper)
    return fresh, tuple(
        n if n.effect.discrete else replace(n, size=float(np.clip(n.size + d, *n.bounds)))
        for n, d in zip(included, change, strict=True)
    )


def _number(problem: DiagnosisProblem, included: IncludedEffect) -> int:
    return next(j for j, e in enumerate(problem.effects) if e is included.effect)
