"""What a diagnosis works with, made ready once: blocks, catalogue, time profiles, what is updated, and effects with
sizes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probupdate.diagnosis.blocks import KNOWN_SHARE, Blocks, gather, of_model, with_derived
from probupdate.diagnosis.mode_numbers import numbers_of_modes, stated_covariance_columns
from probupdate.diagnosis.noise import Mixing, agrees, factor_covariance, mixing_of
from probupdate.diagnosis.predictor import ModalPredictor, build_predictor, expected_frequencies, unit_scores
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.small_model import SmallModel
from probupdate.diagnosis.time_profiles import DAY_STD, TimeProfile, make_time_profiles, weather_profiles
from probupdate.effects.catalogue import Effect
from probupdate.errors import InputError
from probupdate.modal.channel_mistakes import ComputedModes, channel_mistake
from probupdate.modal.frequency_pairs import common_factor_words, refuse_another_unit
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array

# references are computed at every angle that differs by this, signatures for every one that differs by BIN_DEG: what
# rotor and nacelle do to the torsion's small components at the tower turns with the heading, many times the noise
ANGLE_DEG, BIN_DEG = 1.0, 2.0
# columns in whose own unit an effect's prior scale is given
TEMPERATURE = "air_temperature_c"
NATURAL = ("water_level_m", TEMPERATURE, "thrust_share")
# residuals of a model of beams that nothing listed explains: ln f, its cross term in a pair, share of a shape's
# largest component, phase in rad
DISCREPANCY_LOG, DISCREPANCY_CROSS, DISCREPANCY_SHAPE, DISCREPANCY_PHASE = 3e-3, 2e-3, 1e-2, 1e-2

# units of frequency in which modes may be given by mistake, over hertz: rad/s, its inverse, and one of N/m and kg
# beside one of kN/m and t; by how much one of them must pair better with the model's than hertz, and how well, as a
# share of the most there is (right ones stand at 1.4 to 2.0 of 2, wrong ones 0.3 and more below)
UNITS = (1.0, 2 * np.pi, 1 / (2 * np.pi), 1000**0.5, 1000**-0.5)
OTHER_UNIT_BY, UNIT_FITS = 0.25, 0.9
# scatter of ln f of the initial parameters over measured below which all are off by one factor, if that is twice as
# much: a quarter of every stiffness
COMMON_FACTOR = 0.06


@dataclass(frozen=True, eq=False, kw_only=True)
class IncludedEffect:
    """An effect taken into the reference with its time profile and size."""

    effect: Effect
    time_profile: TimeProfile
    size: float

    @property
    def scale(self) -> float:
        """What the effect's prior scale is divided by along this time profile: a prior scale is per unit of a column
        that means something by itself (metres of water, degrees, share of the thrust), else over the column's whole
        range."""
        return per_range(self.time_profile)

    @property
    def prior_scale(self) -> float:
        return self.effect.prior_scale / self.scale

    @property
    def prior_std(self) -> float:
        """Of the normal density about zero whose logarithm has the slope of the size's prior where the size is: a
        Cauchy density of scale `prior_scale`, as gains of ten happen and a normal prior would draw them back by a
        fifth."""
        return float(np.sqrt(0.5 * (self.prior_scale**2 + self.size**2)))

    @property
    def log_prior_ratio(self) -> float:
        """ln of the size's prior density over that of the normal one that stands for it in the linear equations."""
        ratio, variance = self.size / self.prior_scale, self.prior_std**2
        cauchy = -np.log(np.pi * self.prior_scale) - np.log1p(ratio**2)
        return float(cauchy + 0.5 * np.log(2 * np.pi * variance) + 0.5 * self.size**2 / variance)

    @property
    def bounds(self) -> tuple[float, float]:
        """Sizes with which the effect stays within its bounds wherever the time profile goes, on either side of a
        covariate's mean."""
        if self.time_profile.kind != "covariate":
            return self.effect.lower, self.effect.upper
        reach = float(np.max(np.abs(self.time_profile.value)))
        return -max(-self.effect.lower, self.effect.upper) / reach, max(-self.effect.lower, self.effect.upper) / reach

    def with_start_size(self, size: float) -> IncludedEffect:
        """To begin a fit with: of this size, but well within its bounds."""
        within = size if self.effect.discrete else np.clip(size, *np.multiply(0.6, self.bounds))
        return replace(self, size=float(within))

    @property
    def exact(self) -> bool:
        """Whether the reference holds it as it is; else through its signature."""
        return self.time_profile.kind in ("constant", "step")


def per_range(time_profile: TimeProfile) -> float:
    if time_profile.kind != "covariate" or time_profile.column in NATURAL:
        return 1.0
    return float(np.ptp(time_profile.value))


@dataclass(frozen=True, eq=False, kw_only=True)
class DiagnosisProblem:
    """What a diagnosis works with: model field, blocks, catalogue, the updated parameters among the model's,
    model-discrepancy standard deviations of model form per group (n_response,), so many times the usual ones as they
    were stated to be; `unrecorded`: what an unrecorded
    temperature does, as (number of its row, time profile, standard deviation of its size)."""

    predictor: ModalPredictor
    blocks: Blocks
    effects: tuple[Effect, ...]
    updated: tuple[int, ...]
    prior: Parameters
    time_profiles: tuple[TimeProfile, ...]
    which: np.ndarray
    discrepancy_std: tuple[np.ndarray, ...]
    discrepancy_scale: float = 1.0
    unrecorded: tuple[tuple[int, TimeProfile, float], ...] = ()

    @cached_property
    def angles(self) -> np.ndarray:
        return frozen_array(np.round(self.blocks.angle_deg / ANGLE_DEG) * ANGLE_DEG)

    @cached_property
    def bins(self) -> tuple[np.ndarray, np.ndarray]:
        """Centre angle of each bin, and each block's bin."""
        key = np.round(self.blocks.angle_deg / BIN_DEG).astype(int) % round(360 / BIN_DEG)
        found, place = np.unique(key, return_inverse=True)
        return frozen_array(found * BIN_DEG), frozen_array(place, int)

    @cached_property
    def prior_shares(self) -> np.ndarray:
        """(n_candidate,) that sum to one, but for crosstalks, which were not in the catalogue."""
        names = [self.time_profiles[c].name for _, c in self.which]
        odds = np.array([self.effects[j].prior_odds(name) for (j, _), name in zip(self.which, names, strict=True)])
        steps = max(sum(c.kind == "step" for c in self.time_profiles), 1)
        odds = odds / np.where([name == "step" for name in names], steps, 1)
        return frozen_array(odds / odds.sum())

    @cached_property
    def _predictors(self) -> dict[bytes, ModalPredictor]:
        return {}

    def predictor_at_state(
        self, included: Sequence[IncludedEffect], values: Sequence[float] | np.ndarray
    ) -> ModalPredictor:
        """The predictor in the state that the effects among `included` make where their time profiles have these
        values."""
        there = np.ones(len(self.blocks), bool)
        for n, value in zip(included, values, strict=True):
            there &= n.time_profile.value == value
        if there.all() or not there.any():
            return self.predictor
        key = there.tobytes()
        if key not in self._predictors:
            self._predictors[key] = self.predictor.of_state(self.blocks, there)
        return self._predictors[key]

    @cached_property
    def measured(self) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Per group the measured modes' numbers (n_block, n_response), zero where nothing is stated, and which blocks
        show (n_block,)."""
        numbers, used = [], []
        for q, group in enumerate(self.blocks.groups):
            rows, members = np.flatnonzero(self.blocks.present[:, q]), list(group)
            y = np.zeros((len(self.blocks), self.discrepancy_std[q].size))
            seen = np.array(self.blocks.present[:, q])
            if len(rows):
                y[rows], seen[rows] = numbers_of_modes(
                    self.blocks.frequency_hz[rows][:, members], self.blocks.shape[rows][:, :, members],
                    self.predictor.axes[q])
            numbers.append(frozen_array(y))
            used.append(frozen_array(seen, bool))
        return tuple(numbers), tuple(used)

    @cached_property
    def stated(self) -> tuple[np.ndarray | None, ...]:
        """Per group the mean over blocks of what the identification says its numbers' covariance is, None without."""
        blocks = self.blocks
        known = [(k, d) for k, d in enumerate(blocks.factors) if d is not None]
        if len(known) < len(blocks) / 2:
            return tuple(None for _ in blocks.groups)
        of_group: list[list[np.ndarray]] = [[] for _ in blocks.groups]
        for k, d in known:
            ln_frequency, shape = d.read()
            for q in np.flatnonzero(blocks.present[k]):
                members = list(blocks.groups[q])
                columns = stated_covariance_columns(blocks.frequency_hz[k, members], blocks.shape[k][:, members],
                                                    ln_frequency[members], shape[:, members], self.predictor.axes[q])
                if columns is not None:
                    of_group[q].append(columns / blocks.relative_std[k, q])
        result = []
        for q, (group, rows) in enumerate(zip(blocks.groups, of_group, strict=True)):
            if blocks.few:
                total = np.concatenate(rows) if rows else np.zeros((0, self.discrepancy_std[q].size))
                result.append(total.T @ total / len(rows) if rows else None)
                continue
            if len(rows) < len(blocks) / 3:
                result.append(None)
                continue
            # each block's standard deviations come from few parts of it
            covariance = factor_covariance(np.concatenate(rows)) * sum(map(len, rows)) / len(rows)
            numbers = self.measured[0][q][self.measured[1][q]]
            n_log = 1 if len(group) == 1 else 3
            result.append(covariance if not blocks.std_alone or agrees(covariance, numbers, n_log) else None)
        return tuple(result)

    @cached_property
    def mixing(self) -> Mixing | None:
        """How identified shapes mix with those of other modes; None where joint covariances say it, and of few blocks
        or frequencies alone."""
        if self.blocks.few or not self.blocks.channels or not self.blocks.std_alone:
            return None
        frequency = [np.exp(np.mean(log)) for log in self.predictor.log_frequency]
        return mixing_of(self.predictor.axes, np.array(frequency))

    @property
    def notes(self) -> list[str]:
        """Of the blocks, and of modes of which sets scatter otherwise than the standard deviations stated say."""
        blocks, stating = self.blocks, np.array([d is not None for d in self.blocks.factors])
        if blocks.few or not blocks.std_alone or stating.mean() < 0.5:
            return [*blocks.notes]
        names = [blocks.group_name(q) for q, pattern in enumerate(self.stated)
                 if pattern is None and np.sum(stating & blocks.present[:, q]) >= len(blocks) / 3]
        otherwise = [f"modes {', '.join(names)}: the scatter of the sets does not match the stated standard "
                     "deviations, by more than a common factor; the scatter is used"] if names else []
        return [*blocks.notes, *otherwise]

    def select_blocks(self, chosen: np.ndarray) -> DiagnosisProblem:
        """The problem of only the blocks numbered `chosen`."""
        def thin(profile: TimeProfile) -> TimeProfile:
            return replace(profile, value=frozen_array(profile.value[chosen]))

        return replace(self, blocks=self.blocks.select_blocks(chosen),
                       time_profiles=tuple(map(thin, self.time_profiles)),
                       unrecorded=tuple((j, thin(profile), std) for j, profile, std in self.unrecorded))

    @property
    def effects_with_tolerance(self) -> tuple[int, ...]:
        """Effects with a tolerance, each a nuisance of its own; updated parameters already are one."""
        own = {self.predictor.parameters.names[k] for k in self.updated}
        return tuple(j for j, e in enumerate(self.effects) if e.tolerance > 0 and e.parameter not in own)


def diagnosis_problem(
    prepared: Prepared, data: ModalData, unmatched: Collection[str] = ()
) -> tuple[DiagnosisProblem, np.ndarray]:
    """The problem of a diagnosis and the parameters it starts from. `unmatched`: modes that are none of the model's,
    each a group of its own, which the model must be given something for."""
    theta = np.array(prepared.small.parameters.initial)
    data, joined_modes = of_model(data, unmatched)
    measured = gather(data)
    expected = expected_frequencies(prepared.small, measured, theta, unmatched)
    found = np.array([expected.get(label, np.nan) for label in measured.labels])
    ratios = np.nanmedian(measured.frequency_hz, axis=0) / found
    if measured.channels:
        refuse_another_unit("modes", ratios[np.isfinite(ratios)])
    # few sensors show higher modes of like shape, which frequencies in another unit pair with one by one
    scores = unit_scores(prepared.small, measured, theta, unmatched, UNITS)
    if scores.max() > max(scores[0] + OTHER_UNIT_BY, UNIT_FITS * (2 if measured.channels else 1)):
        refuse_another_unit("modes", [UNITS[int(np.argmax(scores))]])
    blocks = gather(data, expected_hz=expected, alone=tuple(unmatched), resting_deg=prepared.resting_deg)
    predictor = build_predictor(prepared.small, blocks, theta, unmatched)
    _refuse_another_order(data, blocks.channels, prepared.small, theta)
    effects = prepared.effects_on(blocks.channels, float(np.nanmax(np.nanmedian(blocks.frequency_hz, axis=0))))
    with_columns, columns = with_derived(blocks), _columns(effects)
    time_profiles = make_time_profiles(with_columns, columns)
    unrecorded = _unrecorded_effects(with_columns, effects)
    notes = [*joined_modes, *blocks.notes, *blocks.rarely_whole(), *with_columns.sparse_column_notes(columns)]
    if unrecorded:
        notes.append(f"too few sets state {TEMPERATURE}: changes of stiffness that {DAY_STD:g} degC (std, "
                     "within a day and between days) would cause count as normal; with that column they are tested")
    if prepared.small.turns and not blocks.headings_known:
        notes.append("no set states the nacelle's heading (nacelle_angle_deg): taken as in the model; where it "
                     "differed, its effect on the modes is put down to other causes")
    scale = 1.0 if prepared.discrepancy is None else prepared.discrepancy / DISCREPANCY_LOG
    if prepared.discrepancy is not None:
        notes.append(f"model discrepancy as stated: {100 * prepared.discrepancy:.2g} % of a "
                     f"frequency, {100 * scale * DISCREPANCY_SHAPE:.2g} % of a shape's largest component "
                     f"({100 * DISCREPANCY_LOG:.2g} % and {100 * DISCREPANCY_SHAPE:.2g} % are usual)")
    if factor := common_factor_words(-np.log(ratios), COMMON_FACTOR):
        notes.append(f"before any parameter is updated {factor}")
    blocks = replace(blocks, notes=tuple(notes))
    which = _candidates(effects, time_profiles)
    n_channel = len(blocks.channels)
    discrepancy_std = tuple(scale * _discrepancy_std(len(g), n_channel) for g in blocks.groups)
    return DiagnosisProblem(
        predictor=predictor,
        blocks=blocks,
        effects=effects,
        updated=prepared.updated,
        prior=prepared.prior,
        time_profiles=time_profiles,
        which=which,
        discrepancy_std=discrepancy_std,
        discrepancy_scale=scale,
        unrecorded=unrecorded,
    ), theta


def _refuse_another_order(
    data: ModalData, channels: Sequence[str], small: SmallModel, theta: np.ndarray
) -> None:
    """Raises InputError where the shapes of a set are the model's with the channels in another order, which no search
    for a change of the structure or of one sensor finds its way out of."""
    most = max(data.sets, key=lambda s: int(np.sum(s.measured))).of_channels([data.channels.index(c) for c in channels])
    local = small.evaluate(theta)
    modes = local.solve(0.0, local.n_search)
    rows = [small.channels.index(channel) for channel in channels]
    found = channel_mistake(most, channels, [ComputedModes(
        shape=local.shapes(modes, local.n_search)[rows], frequency_hz=modes.frequency_hz[: local.n_search])])
    if found is not None and found.whole_order:
        raise InputError(f"set {most.id}", f"its modes are not this model's: {found.sentence}", found.remedy)


def _unrecorded_effects(blocks: Blocks, effects: Sequence[Effect]) -> tuple[tuple[int, TimeProfile, float], ...]:
    """What warms and cools the structure where the sets do not say how warm it was."""
    if np.isfinite(blocks.numbers(TEMPERATURE)).mean() >= KNOWN_SHARE:
        return ()
    return tuple((j, profile, std * e.prior_scale) for j, e in enumerate(effects) if e.time_profiles == (TEMPERATURE,)
                 for profile, std in weather_profiles(blocks.hours))


def _columns(effects: Sequence[Effect]) -> tuple[str, ...]:
    known = ("constant", "step", "ramp")
    return tuple(dict.fromkeys(c for e in effects for c in e.time_profiles if c not in known))


def _candidates(effects: Sequence[Effect], time_profiles: Sequence[TimeProfile]) -> np.ndarray:
    return np.array([(j, c) for j, e in enumerate(effects) for c, time_profile in enumerate(time_profiles)
                     if time_profile.name in e.time_profiles])


def _discrepancy_std(k: int, n_channel: int) -> np.ndarray:
    logs = [DISCREPANCY_LOG] if k == 1 else [DISCREPANCY_LOG, DISCREPANCY_LOG, DISCREPANCY_CROSS]
    return np.array([*logs, *[DISCREPANCY_SHAPE] * (k * n_channel), *[DISCREPANCY_PHASE] * (k * n_channel)])


def local_std(prior: Parameters, number: int, value: float) -> float:
    """The prior's standard deviation at `value`: of a lognormal in proportion to it."""
    p = prior.items[number]
    return p.log_std * value if p.prior == "lognormal" else p.std


def prior_shift(problem: DiagnosisProblem, theta: np.ndarray) -> np.ndarray:
    """How far the prior's centre lies from theta, to first order there (n_updated,)."""
    shift = []
    for p, k in zip(problem.prior, problem.updated, strict=True):
        shift.append(theta[k] * np.log(p.initial / theta[k]) if p.prior == "lognormal" else p.initial - theta[k])
    return np.array(shift)
