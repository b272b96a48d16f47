"""The model with what has been named so far, fitted to the blocks: departures, fingerprints there, and the best values.

Steps and constants enter the reference as they are, so that strong effects are no matter of first order; ramps and
covariates enter through their fingerprint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.diagnosis.blocks import Blocks
from probupdate.diagnosis.catalogue import Effect
from probupdate.diagnosis.courses import Course
from probupdate.diagnosis.departures import Reference, departure, log_scales, n_response
from probupdate.diagnosis.field import Field, effect_fingerprints, observed
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import Noise, estimate_noise, factored
from probupdate.diagnosis.small_model import LocalModel
from probupdate.parameters import Parameters

# references are computed at every angle that differs by this; fingerprints at every NODE_DEG, and between these by
# straight lines for every one that differs by BIN_DEG: what rotor and nacelle do to the torsion's small components at
# the tower turns with the heading, and is many times the noise
ANGLE_DEG, BIN_DEG, NODE_DEG = 1.0, 2.0, 10.0
# a fit has settled when no parameter moves by more, in posterior deviations
SETTLED, MOST_STEPS = 0.1, 40
# steps after which the noise is kept
WARM = 3
# a change of -2 ln posterior that does not matter, and the share of it that the linear equations may still promise at
# the least value: fingerprints are derivatives of the expected modes alone, and where much is left over the departures
# from them change a little otherwise
FLAT, FLAT_SHARE = 0.1, 0.03
# a step is no longer than so many prior deviations at once
LONGEST, HALVINGS = 1.0, 6
# steps that may go uphill
MOST_LEAPS = 8
# fingerprints of tolerances and effects are computed anew every so many steps on the way, those of the updated
# parameters after every step longer than this, in posterior deviations
REFRESH, FAR = 6, 1.0
# columns in whose own unit an effect's slab is given
NATURAL = ("water_level_m", "air_temperature_c", "thrust_share")
# relative error of an effect's fingerprint, response by response: between this model and the virtual turbine, whose
# elements, mesh, soil and joints follow other theories, half of 66 effects at their true size left less than 8 % of
# their length, nine of ten less than 13 % (studies/blind/fingerprints.py)
FINGERPRINT = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class Named:
    """An effect taken into the reference with its course and size."""

    effect: Effect
    course: Course
    size: float

    @property
    def scale(self) -> float:
        """What the effect's slab is divided by along this course: a slab is per unit of a column that means something
        by itself (metres of water, degrees, share of the thrust), else over the column's whole range."""
        return per_range(self.course)

    @property
    def slab(self) -> float:
        return self.effect.slab / self.scale

    @property
    def prior_std(self) -> float:
        """Of the normal prior that stands for the size's own: normal of deviation `slab` within it, beyond it as one
        over the size. A normal one would draw a gain wrong by a factor of two a fifth back."""
        return max(self.slab, abs(self.size))

    @property
    def bounds(self) -> tuple[float, float]:
        """Sizes with which the effect stays within its bounds wherever the course goes, on either side of a covariate's
        mean."""
        if self.course.kind != "covariate":
            return self.effect.lower, self.effect.upper
        reach = float(np.max(np.abs(self.course.value)))
        return -max(-self.effect.lower, self.effect.upper) / reach, max(-self.effect.lower, self.effect.upper) / reach

    @property
    def exact(self) -> bool:
        """Whether the reference holds it as it is; else through its fingerprint."""
        return self.course.kind in ("constant", "step")


def per_range(course: Course) -> float:
    if course.kind != "covariate" or course.column in NATURAL:
        return 1.0
    return float(np.ptp(course.value))


@dataclass(frozen=True, eq=False, kw_only=True)
class Setting:
    """What a diagnosis works with: model field, blocks, catalogue, the updated parameters among the model's, columns
    of model form per group (n_response, n_form) with deviation one, floors per group (n_response,)."""

    field: Field
    blocks: Blocks
    effects: tuple[Effect, ...]
    updated: tuple[int, ...]
    prior: Parameters
    courses: tuple[Course, ...]
    which: np.ndarray
    form: tuple[np.ndarray, ...]
    floor: tuple[np.ndarray, ...]

    @property
    def angles(self) -> np.ndarray:
        return np.round(self.blocks.angle_deg / ANGLE_DEG) * ANGLE_DEG

    @property
    def bins(self) -> tuple[np.ndarray, np.ndarray]:
        """Centre angle of each bin, and each block's bin."""
        key = np.round(self.blocks.angle_deg / BIN_DEG).astype(int) % round(360 / BIN_DEG)
        found, place = np.unique(key, return_inverse=True)
        return found * BIN_DEG, place

    @property
    def tolerated(self) -> tuple[int, ...]:
        """Effects with a tolerance, each a nuisance of its own; updated parameters already are one."""
        own = {self.field.parameters.names[k] for k in self.updated}
        return tuple(j for j, e in enumerate(self.effects) if e.tolerance > 0 and e.parameter not in own)


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """theta (n_param of the extended model,), named effects with their sizes, departures per group (n_block,
    n_response) from what they predict (zero where not measured), and the design there. `steps` of the iteration,
    `last_step` in posterior deviations, infinite where it stopped without having settled. `short` (n_named,): how much
    farther the linear equations would take each size where the fit itself led no farther down, else zero."""

    theta: np.ndarray
    named: tuple[Named, ...]
    departures: tuple[np.ndarray, ...]
    centred: tuple[np.ndarray, ...]
    design: Design
    steps: int
    last_step: float
    short: np.ndarray

    @property
    def settled(self) -> bool:
        return bool(np.isfinite(self.last_step))


def departures_at(
    setting: Setting, theta: np.ndarray, named: Sequence[Named], plain: PlainReferences | None = None
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Per group departures (n_block, n_response) and which blocks tell (n_block,). `plain`: what the model was asked
    for before, kept between calls."""
    blocks = setting.blocks
    n_channel = len(blocks.channels)
    result = [np.zeros((len(blocks), n_response(len(g), n_channel))) for g in blocks.groups]
    used = [np.array(blocks.present[:, q]) for q in range(len(blocks.groups))]
    expected = _expected(setting, theta, named, plain or PlainReferences(setting.field))
    for q, (group, reference) in enumerate(zip(blocks.groups, expected, strict=True)):
        rows, members = np.flatnonzero(blocks.present[:, q]), list(group)
        if len(rows):
            y, independent = departure(
                blocks.frequency_hz[rows][:, members], blocks.shape[rows][:, :, members], _of_blocks(reference, rows))
            result[q][rows] = np.where(independent[:, None], y, 0.0)
            used[q][rows] &= independent
    return tuple(result), tuple(used)


def log_scale(
    setting: Setting, theta: np.ndarray, named: Sequence[Named], noise: Noise, plain: PlainReferences | None = None
) -> float:
    """ln of how much larger departures are than changes of the measured shapes, over all that counts: what a density of
    departures is multiplied by to be one of the measured shapes. A shape that is expected wrongly is projected to a
    shorter one, and its scatter with it, which by itself would look like a better fit."""
    blocks, total = setting.blocks, 0.0
    expected = _expected(setting, theta, named, plain or PlainReferences(setting.field))
    for group, reference, weight in zip(blocks.groups, expected, noise.weight, strict=True):
        rows = np.flatnonzero(weight > 0)
        scale = log_scales(blocks.shape[rows][:, :, list(group)], _of_blocks(reference, rows))
        total += 2 * len(blocks.channels) * float(scale.sum())
    return total


class PlainReferences:
    """Expected modes of every group by parameters and angle, before sensors see them, each computed once."""

    def __init__(self, field: Field):
        self._field, self._local, self._known = field, {}, {}

    def __call__(self, theta: np.ndarray, angle_deg: float) -> tuple[Reference, ...]:
        state = theta.tobytes()
        if (state, angle_deg) not in self._known:
            if state not in self._local:
                self._local[state] = self._field.small.at(theta)
            self._known[state, angle_deg] = self._field.references(self._local[state], angle_deg)
        return self._known[state, angle_deg]


def _expected(
    setting: Setting, theta: np.ndarray, named: Sequence[Named], plain: PlainReferences
) -> list[Reference]:
    """What each group's modes are in every block, as the sensors see them."""
    exact = [n for n in named if n.exact]
    levels = np.column_stack([*(n.course.value for n in exact), setting.angles])
    found, place = np.unique(levels, axis=0, return_inverse=True)
    place = place.ravel()
    seen_there = []
    for level in found:
        moved, seen = _state(setting.field, theta, exact, level[:-1])
        seen_there.append([observed(r, seen) for r in plain(moved, level[-1])])
    return [Reference(tensor=np.array([r[q].tensor for r in seen_there])[place],
                      shape=np.array([r[q].shape for r in seen_there])[place])
            for q in range(len(setting.blocks.groups))]  # fmt: skip


def _of_blocks(reference: Reference, rows: np.ndarray) -> Reference:
    return Reference(tensor=reference.tensor[rows], shape=reference.shape[rows])


def local_at(
    field: Field, theta: np.ndarray, named: Sequence[Named], values: Sequence[float]
) -> tuple[LocalModel, list[tuple[Effect, float]]]:
    """The model with the named effects where their courses have these values, and what the sensors then do."""
    moved, seen = _state(field, theta, named, values)
    return field.small.at(moved), seen


def _state(field: Field, theta: np.ndarray, named: Sequence[Named], values: Sequence[float]):
    """Parameters with the named effects where their courses have these values, and what the sensors then do."""
    moved = np.array(theta)
    names = field.parameters.names
    seen = []
    for n, value in zip(named, values, strict=True):
        for name, amount in n.effect.increments:
            moved[names.index(name)] += n.size * value * amount
        if n.effect.observe is not None and value:
            seen.append((n.effect, n.size * value))
    return np.clip(moved, field.parameters.lower, field.parameters.upper), seen


def design_at(
    setting: Setting, theta: np.ndarray, named: Sequence[Named], noise: Noise, before: Design | None = None
) -> Design:
    """Fingerprints at theta and the named effects, a bin of blocks for each angle before and after each step: an error
    of a few per cent that changes sign with the step looks like the step, which is known better than that.
    With the design of a point nearby (`before`), only those of the updated parameters are computed anew."""
    field = setting.field
    names = field.parameters.names
    centres, angle_of = setting.bins
    exact = [n for n in named if n.exact]
    levels = np.column_stack([*(n.course.value for n in exact), angle_of])
    bins, bin_of = np.unique(levels, axis=0, return_inverse=True)
    bin_of = bin_of.ravel()
    own = [Effect(kind="structural", cause="parameter", location=names[k], unit="", tolerance=0.0, slab=1.0,
                  parameter=names[k]) for k in setting.updated]  # fmt: skip
    catalogue = own if before is not None else [*own, *setting.effects]
    columns = list(setting.updated) if before is not None else list(range(len(names)))
    chosen = tuple(names[k] for k in columns)
    states, state_of = np.unique(bins[:, :-1], axis=0, return_inverse=True)
    prints = [np.empty((len(bins), len(floor), len(catalogue))) for floor in setting.floor]
    for number, state in enumerate(states):
        there = np.flatnonzero(state_of.ravel() == number)
        local, seen = local_at(field, theta, exact, state)
        at = fingerprints_at(field, local, catalogue, chosen, centres[bins[there, -1].astype(int)], seen)
        for whole, part in zip(prints, at, strict=True):
            whole[there] = part
    n_own = len(own)
    if before is not None:
        same = before.bin_of[np.unique(bin_of, return_index=True)[1]]
        nuisance = tuple(np.concatenate([p, old[same][:, :, n_own:]], axis=2)
                         for p, old in zip(prints, before.nuisance, strict=True))  # fmt: skip
        effect = tuple(e[same] for e in before.effect)
    else:
        tolerated = [n_own + j for j in setting.tolerated]
        nuisance = tuple(
            np.concatenate([p[:, :, :n_own], p[:, :, tolerated],
                            np.broadcast_to(form, (len(bins), *form.shape))], axis=2)
            for p, form in zip(prints, setting.form, strict=True)
        )  # fmt: skip
        effect = tuple(p[:, :, n_own:] for p in prints)
    prior = [local_std(setting.prior, i, theta[k]) for i, k in enumerate(setting.updated)]
    std = np.concatenate([prior, [setting.effects[j].tolerance for j in setting.tolerated],
                          np.ones(setting.form[0].shape[1])])  # fmt: skip
    return Design(
        bin_of=bin_of, nuisance=nuisance, nuisance_std=std, floor=setting.floor, effect=effect,
        courses=setting.courses, which=setting.which, noise=noise,
        named=tuple((_number(setting, n), n.course, n.prior_std) for n in named if not n.effect.discrete),
        doubted=tuple((n.course, tuple(_doubt(setting, q, FINGERPRINT * n.size * e[:, :, _number(setting, n)])
                                       for q, e in enumerate(effect))) for n in named),
    )  # fmt: skip


def fingerprints_at(
    field: Field, local: LocalModel, effects: Sequence[Effect], names: tuple[str, ...], angles_deg: np.ndarray,
    seen: Sequence[tuple[Effect, float]] = (),
) -> list[np.ndarray]:
    """Per group (n_angle, n_response, n_effect): fingerprints at nodes of NODE_DEG, straight lines between them.
    `names`: the parameters that the effects move."""
    place = np.asarray(angles_deg) / NODE_DEG
    before = np.floor(place).astype(int)
    share = place - before
    n_node = round(360 / NODE_DEG)
    needed = np.unique(np.concatenate([before, before[share > 0] + 1]) % n_node)
    slopes = local.slopes([field.parameters.names.index(name) for name in names])
    table: list[dict[int, np.ndarray]] = [{} for _ in field.axes]
    for node, found in zip(needed, field.slopes(local, needed * NODE_DEG, slopes), strict=True):
        for rows, (reference, tensor, shape) in zip(table, found, strict=True):
            rows[node] = effect_fingerprints(effects, names, reference, tensor, shape, seen)
    result = []
    for rows in table:
        low = np.array([rows[k % n_node] for k in before])
        high = np.array([rows[(k + (s > 0)) % n_node] for k, s in zip(before, share, strict=True)])
        result.append(low + share[:, None, None] * (high - low))
    return result


def _doubt(setting: Setting, group: int, amount: np.ndarray) -> np.ndarray:
    """Deviations (n_bin, n_response) of a fingerprint whose error has the size `amount`: half of the variance where it
    is, half spread over the responses of its kind (logarithms of frequencies, real parts and phases of each shape)."""
    k, n_channel = len(setting.blocks.groups[group]), len(setting.blocks.channels)
    n_log = 1 if k == 1 else 3
    parts = [slice(0, n_log)]
    parts += [slice(start, start + n_channel) for start in range(n_log, amount.shape[1], n_channel)]
    result = np.empty_like(amount)
    for part in parts:
        own = amount[:, part] ** 2
        result[:, part] = np.sqrt(0.5 * own + 0.5 * own.mean(axis=1, keepdims=True))
    return np.maximum(result, 1e-9)


def local_std(prior: Parameters, number: int, value: float) -> float:
    """The prior's deviation at `value`: of a lognormal in proportion to it."""
    p = prior.items[number]
    return p.std if p.prior == "normal" else p.log_std * value


def prior_shift(setting: Setting, theta: np.ndarray) -> np.ndarray:
    """How far the prior's centre lies from theta, to first order there (n_updated,)."""
    shift = []
    for p, k in zip(setting.prior, setting.updated, strict=True):
        shift.append(p.initial - theta[k] if p.prior == "normal" else theta[k] * np.log(p.initial / theta[k]))
    return np.array(shift)


def centred_departures(
    setting: Setting, design: Design, theta: np.ndarray, named: Sequence[Named], departures
) -> tuple[np.ndarray, ...]:
    """Departures less what the prior's centre would make: of mean zero when nothing is wrong."""
    made = design.expected(_prior_centre(setting, design, theta, named))
    return tuple(np.where(w[:, None] > 0, y - m, 0.0) for y, m, w in
                 zip(departures, made, design.noise.weight, strict=True))  # fmt: skip


def _prior_centre(setting: Setting, design: Design, theta: np.ndarray, named: Sequence[Named]) -> np.ndarray:
    """Where the unknowns' prior is centred, as departures from theta and the sizes."""
    unknowns = np.zeros(design.n_unknown)
    unknowns[: len(setting.updated)] = prior_shift(setting, theta)
    # sizes have their prior about zero: what they make is taken back to there
    unknowns[design.nuisance_std.size : design.n_common] = [-n.size for n in named if not n.effect.discrete]
    return unknowns


def _left(setting: Setting, design: Design, theta: np.ndarray, named: Sequence[Named], departures):
    """Departures less what the unknowns make of them at their most probable. Tolerances of rotor and nacelle turn with
    the heading: they differ from block to block, and in the torsion's small components at the tower many times more
    than the noise does, which differences of blocks would else be taken for."""
    solved = design.unknowns(centred_departures(setting, design, theta, named, departures))
    made = design.expected(_prior_centre(setting, design, theta, named) + solved)
    return tuple(y - m for y, m in zip(departures, made, strict=True))


def fit(
    setting: Setting, theta: np.ndarray, named: Sequence[Named] = (), *, base: Fit | None = None
) -> Fit:
    """Gauss-Newton to the most probable parameters and sizes, with all tolerances and model form marginalised. `base`:
    a fit of the same record without one of the effects, whose noise is kept.

    Where it does not settle the fit says so (`settled`), as one that has not converged looks like an effect. Raises
    ConvergenceError where the model has no modes.
    """
    theta, named = np.array(theta, float), tuple(named)
    updated = list(setting.updated)
    step, noise, design, stated = np.inf, None, None, None
    if base is not None:
        noise, design = base.design.noise, base.design
    departures, used = all_departures(setting, theta, named)
    renewed, leaps, stalled = base is not None, 0, False
    for number in range(MOST_STEPS):
        # far from where the fit ends the noise is not what it is there
        again = not renewed and step < SETTLED
        if (number < WARM and base is None) or again:
            left = departures if design is None else _left(setting, design, theta, named, departures)
            if number == 0 or again:
                stated = stated_covariance(setting, theta, named)
            noise = noise_of(setting, stated, left, used)
        if again:
            renewed, step = True, np.inf
        settled = step < SETTLED
        anew = settled or number % REFRESH == (0 if base is None else REFRESH - 1)
        if anew or step > FAR:
            design = design_at(setting, theta, named, noise, None if anew else design)
        else:
            design = replace(design, noise=noise)
        departures = kept(departures, noise)
        centred = centred_departures(setting, design, theta, named, departures)
        solved = design.unknowns(centred)
        n_own, n_all = len(updated), design.nuisance_std.size
        free = [k for k, n in enumerate(named) if not n.effect.discrete]
        if settled:
            short = np.zeros(len(named))
            if stalled:
                short[free] = np.abs(solved[n_all : design.n_common] - [named[k].size for k in free])
            return Fit(theta=theta, named=named, departures=departures, centred=centred, design=design, steps=number,
                       last_step=step, short=short)  # fmt: skip
        scale = np.array([local_std(setting.prior, i, theta[k]) for i, k in enumerate(updated)])
        move = (prior_shift(setting, theta) + solved[:n_own]) / scale
        change = np.zeros(len(named))
        change[free] = solved[n_all : design.n_common] - np.array([named[k].size for k in free])
        held = design.held(n_own)
        before = design.misfit(departures, held) + penalty(setting, theta, named)
        # what the linear equations promise
        promised = before - design.misfit(centred, [])
        if promised < FLAT:
            step = 0.0
            continue
        relative = [d / n.prior_std for d, n in zip(change, named, strict=True)]
        longest = float(np.max(np.abs(np.concatenate([move, relative])), initial=0.0))
        told = sum(int(np.count_nonzero(w)) * y.shape[1] for w, y in zip(noise.weight, departures, strict=True))
        whole = min(1.0, LONGEST / max(longest, 1e-12))
        for share in whole * 0.5 ** np.arange(HALVINGS):
            trial = _trial(setting, design, theta, named, share * move * scale, share * change, held)
            if trial.misfit < before:
                break
        else:
            if promised <= max(1.0, FLAT_SHARE * before):
                # the least value along this line
                step, stalled = 0.0, promised > 1.0
                continue
            if leaps == MOST_LEAPS:
                return _ended(setting, theta, named, noise, departures, number)
            # noise and fingerprints are others farther on: over the hill, as the equations say
            leaps, share = leaps + 1, whole
            trial = _trial(setting, design, theta, named, share * move * scale, share * change, held)
        stalled = False
        # what is left beyond the noise makes the posterior wider
        known = np.sqrt(np.diag(design.unknowns_cov(held)) * max(1.0, trial.misfit / told))
        moved = np.abs(trial.theta[updated] - theta[updated])
        grown = [abs(trial.named[k].size - named[k].size) for k in free]
        # a step that had to be shortened is not a small one
        step = float(np.max(np.concatenate([moved, grown]) / known, initial=0.0)) * whole / share
        theta, named, departures, used = trial.theta, trial.named, trial.departures, trial.used
    return _ended(setting, theta, named, noise, departures, MOST_STEPS)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Trial:
    """Where a step leads: departures there, which blocks tell, and -2 ln posterior with the design it was made with."""

    theta: np.ndarray
    named: tuple[Named, ...]
    departures: tuple[np.ndarray, ...]
    used: tuple[np.ndarray, ...]
    misfit: float


def _trial(setting: Setting, design: Design, theta, named, move: np.ndarray, change: np.ndarray, held) -> _Trial:
    theta, named = _moved(setting, theta, named, move, change)
    departures, used = all_departures(setting, theta, named)
    misfit = design.misfit(kept(departures, design.noise), held) + penalty(setting, theta, named)
    return _Trial(theta=theta, named=named, departures=departures, used=used, misfit=misfit)


def _ended(setting: Setting, theta: np.ndarray, named: tuple[Named, ...], noise: Noise, departures, number: int) -> Fit:
    """The fit where it stopped without having settled."""
    design, departures, centred = linearised(setting, theta, named, noise, departures)
    return Fit(theta=theta, named=named, departures=departures, design=design, steps=number, last_step=np.inf,
               short=np.zeros(len(named)), centred=centred)  # fmt: skip


def linearised(
    setting: Setting, theta: np.ndarray, named: Sequence[Named], noise: Noise, departures: Sequence[np.ndarray]
) -> tuple[Design, tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """The design at theta and the named effects, with departures from there as far as they count and less what the
    prior's centre makes."""
    design, departures = design_at(setting, theta, named, noise), kept(departures, noise)
    return design, departures, centred_departures(setting, design, theta, named, departures)


def stated_covariance(
    setting: Setting, theta: np.ndarray, named: Sequence[Named] = ()
) -> list[np.ndarray | None]:
    """Per group the mean over blocks of what the identification says its responses' covariance is, None without;
    named effects at their mean."""
    blocks = setting.blocks
    known = [k for k, d in enumerate(blocks.deviations) if d is not None]
    if len(known) < len(blocks) / 2:
        return [None] * len(blocks.groups)
    exact = [n for n in named if n.exact]
    local, seen = local_at(setting.field, theta, exact, [float(np.mean(n.course.value)) for n in exact])
    centres, bin_of = setting.bins
    references = [[observed(r, seen) for r in setting.field.references(local, angle)] for angle in centres]
    result = []
    for q, group in enumerate(blocks.groups):
        members, rows, number = list(group), [], 0
        for k in known:
            d, weight = blocks.deviations[k], blocks.relative_std[k, q] ** -2.0
            ln_f, shape = d.ln_frequency[members], d.shape[:, members]
            if not blocks.present[k, q] or not (np.all(np.isfinite(ln_f)) and np.all(np.isfinite(shape))):
                continue
            sizes = np.max(np.abs(shape), axis=(0, 1))
            h = 1e-4 / max(float(np.max(np.abs(ln_f))), float(np.max(sizes)), 1e-12)
            sides = [
                departure(blocks.frequency_hz[k, members] * np.exp(s * h * ln_f.T),
                          blocks.shape[k][:, members] + s * h * shape.transpose(2, 0, 1), references[bin_of[k]][q])
                for s in (1, -1)
            ]  # fmt: skip
            if sides[0][1].all() and sides[1][1].all():
                columns = (sides[0][0] - sides[1][0]) / (2 * h)
                rows.append(np.sqrt(weight) * columns)
                number += 1
        # each block's deviations come from few parts of it
        told = factored(np.concatenate(rows)) * sum(map(len, rows)) / number if number >= len(blocks) / 3 else None
        result.append(told)
    return result


class DeparturesBeside:
    """Departures at one theta with other effects and sizes in the reference than those of `named`, whose ramps and
    covariates are taken off as they are there; what the model is asked for is kept between calls."""

    def __init__(self, setting: Setting, theta: np.ndarray, named: Sequence[Named]):
        self.plain = PlainReferences(setting.field)
        self._setting, self._theta = setting, theta
        nothing = [np.zeros((len(setting.blocks), floor.size)) for floor in setting.floor]
        self._along = _without_linear(setting, theta, named, nothing)

    def __call__(self, named: Sequence[Named]) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        departures, used = departures_at(self._setting, self._theta, named, self.plain)
        return tuple(y + a for y, a in zip(departures, self._along, strict=True)), used


def all_departures(setting: Setting, theta: np.ndarray, named: Sequence[Named]):
    """`departures_at` less what ramps and covariates make."""
    return DeparturesBeside(setting, theta, named)(named)


def noise_of(setting: Setting, stated, departures: Sequence[np.ndarray], used: Sequence[np.ndarray]) -> Noise:
    """From departures of which blocks tell, with the pattern that the identification states."""
    blocks = setting.blocks
    sizes = tuple(len(g) for g in blocks.groups)
    return estimate_noise(tuple(departures), tuple(used), sizes, blocks.relative_std, blocks.states(), stated)


def kept(departures, noise: Noise):
    return tuple(np.where(w[:, None] > 0, y, 0.0) for y, w in zip(departures, noise.weight, strict=True))


def penalty(setting: Setting, theta: np.ndarray, named: Sequence[Named]) -> float:
    """-2 ln prior of parameters and sizes, but for constants and the width of what stands for a size's prior."""
    total = sum((n.size / n.prior_std) ** 2 for n in named if not n.effect.discrete)
    for p, k in zip(setting.prior, setting.updated, strict=True):
        normal = p.prior == "normal"
        total += ((theta[k] - p.initial) / p.std if normal else np.log(theta[k] / p.initial) / p.log_std) ** 2
    return float(total)


def _moved(setting: Setting, theta: np.ndarray, named: Sequence[Named], move: np.ndarray, change: np.ndarray):
    """theta and sizes after a step, within their bounds."""
    fresh, updated = theta.copy(), list(setting.updated)
    fresh[updated] = np.clip(theta[updated] + move, setting.prior.lower, setting.prior.upper)
    return fresh, tuple(
        n if n.effect.discrete else replace(n, size=float(np.clip(n.size + d, *n.bounds)))
        for n, d in zip(named, change, strict=True)
    )


def _number(setting: Setting, named: Named) -> int:
    return next(j for j, e in enumerate(setting.effects) if e is named.effect)


def _without_linear(setting, theta, named, departures):
    """Takes off what ramps and covariates make, by the fingerprints at theta without them."""
    linear = [n for n in named if not n.exact]
    if not linear:
        return departures
    result = [np.array(y) for y in departures]
    centres, bin_of = setting.bins
    names = tuple(dict.fromkeys(name for n in linear for name, _ in n.effect.increments))
    local = setting.field.small.at(theta)
    for made, y in zip(fingerprints_at(setting.field, local, [n.effect for n in linear], names, centres), result,
                       strict=True):  # fmt: skip
        for k, n in enumerate(linear):
            y -= n.size * n.course.value[:, None] * made[bin_of][:, :, k]
    return tuple(result)
