"""What a diagnosis works with, made ready once: blocks, catalogue, courses, what is updated, and effects with sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probupdate.diagnosis.blocks import Blocks, gather, with_derived
from probupdate.effects.catalogue import Effect
from probupdate.diagnosis.courses import Course, make_courses
from probupdate.diagnosis.departures import numbers_of_modes, stated_columns
from probupdate.diagnosis.field import Field, build_field, expected_frequencies
from probupdate.diagnosis.noise import factored
from probupdate.diagnosis.prepare import Prepared
from probupdate.modes import ModalData, frozen_array
from probupdate.parameters import Parameters

# references are computed at every angle that differs by this, fingerprints for every one that differs by BIN_DEG: what
# rotor and nacelle do to the torsion's small components at the tower turns with the heading, many times the noise
ANGLE_DEG, BIN_DEG = 1.0, 2.0
# columns in whose own unit an effect's slab is given
NATURAL = ("water_level_m", "air_temperature_c", "thrust_share")
# departures of a model of beams that nothing listed explains: ln f, its cross term in a pair, share of a shape's
# largest component, phase in rad
FLOOR_LOG, FLOOR_CROSS, FLOOR_SHAPE, FLOOR_PHASE = 3e-3, 2e-3, 1e-2, 1e-2


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
        """Of the normal density about zero whose logarithm has the slope of the size's prior where the size is: a Cauchy
        density of scale `slab`, as gains of ten happen and a normal prior would draw them back by a fifth."""
        return float(np.sqrt(0.5 * (self.slab**2 + self.size**2)))

    @property
    def log_prior_ratio(self) -> float:
        """ln of the size's prior density over that of the normal one that stands for it in the linear equations."""
        ratio, variance = self.size / self.slab, self.prior_std**2
        cauchy = -np.log(np.pi * self.slab) - np.log1p(ratio**2)
        return float(cauchy + 0.5 * np.log(2 * np.pi * variance) + 0.5 * self.size**2 / variance)

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
    """What a diagnosis works with: model field, blocks, catalogue, the updated parameters among the model's,
    floors of model form per group (n_response,)."""

    field: Field
    blocks: Blocks
    effects: tuple[Effect, ...]
    updated: tuple[int, ...]
    prior: Parameters
    courses: tuple[Course, ...]
    which: np.ndarray
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

    @cached_property
    def measured(self) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Per group the measured modes' numbers (n_block, n_response), zero where nothing is told, and which blocks
        tell (n_block,)."""
        numbers, used = [], []
        for q, group in enumerate(self.blocks.groups):
            rows, members = np.flatnonzero(self.blocks.present[:, q]), list(group)
            y = np.zeros((len(self.blocks), self.floor[q].size))
            tells = np.array(self.blocks.present[:, q])
            if len(rows):
                y[rows], tells[rows] = numbers_of_modes(
                    self.blocks.frequency_hz[rows][:, members], self.blocks.shape[rows][:, :, members],
                    self.field.axes[q])
            numbers.append(frozen_array(y))
            used.append(frozen_array(tells, bool))
        return tuple(numbers), tuple(used)

    @cached_property
    def stated(self) -> tuple[np.ndarray | None, ...]:
        """Per group the mean over blocks of what the identification says its numbers' covariance is, None without."""
        blocks = self.blocks
        known = [k for k, d in enumerate(blocks.deviations) if d is not None]
        if len(known) < len(blocks) / 2:
            return tuple(None for _ in blocks.groups)
        result = []
        for q, (group, axes) in enumerate(zip(blocks.groups, self.field.axes, strict=True)):
            members, rows = list(group), []
            for k in known:
                if not blocks.present[k, q]:
                    continue
                d, weight = blocks.deviations[k], blocks.relative_std[k, q] ** -2.0
                columns = stated_columns(blocks.frequency_hz[k, members], blocks.shape[k][:, members],
                                         d.ln_frequency[members], d.shape[:, members], axes)  # fmt: skip
                if columns is not None:
                    rows.append(np.sqrt(weight) * columns)
            if blocks.few:
                total = np.concatenate(rows) if rows else np.zeros((0, self.floor[q].size))
                result.append(total.T @ total / len(rows) if rows else None)
                continue
            # each block's deviations come from few parts of it
            result.append(factored(np.concatenate(rows)) * sum(map(len, rows)) / len(rows)
                          if len(rows) >= len(blocks) / 3 else None)  # fmt: skip
        return tuple(result)

    @property
    def tolerated(self) -> tuple[int, ...]:
        """Effects with a tolerance, each a nuisance of its own; updated parameters already are one."""
        own = {self.field.parameters.names[k] for k in self.updated}
        return tuple(j for j, e in enumerate(self.effects) if e.tolerance > 0 and e.parameter not in own)


def settle(prepared: Prepared, data: ModalData) -> tuple[Setting, np.ndarray]:
    """The setting of a diagnosis and the parameters it starts from."""
    theta = np.array(prepared.small.parameters.initial)
    blocks = gather(data, expected_hz=expected_frequencies(prepared.small, gather(data), theta))
    field = build_field(prepared.small, blocks, theta)
    effects = prepared.effects_on(blocks.channels)
    told, columns = with_derived(blocks), _columns(effects)
    courses = make_courses(told, columns)
    notes = [*blocks.notes, *told.little_known(columns)]
    if prepared.small.turns and not blocks.headings_told:
        notes.append("no set tells where the nacelle looked (nacelle_angle_deg): taken as in the model; where it "
                     "looked elsewhere, what turning it does to the modes is taken for something else")
    blocks = replace(blocks, notes=tuple(notes))
    which = _candidates(effects, courses)
    n_channel = len(blocks.channels)
    floor = tuple(_floor(len(g), n_channel) for g in blocks.groups)
    return Setting(field=field, blocks=blocks, effects=effects, updated=prepared.updated, prior=prepared.prior,
                   courses=courses, which=which, floor=floor), theta  # fmt: skip


def _columns(effects: Sequence[Effect]) -> tuple[str, ...]:
    known = ("constant", "step", "ramp")
    return tuple(dict.fromkeys(c for e in effects for c in e.courses if c not in known))


def _candidates(effects: Sequence[Effect], courses: Sequence[Course]) -> np.ndarray:
    return np.array([(j, c) for j, e in enumerate(effects) for c, course in enumerate(courses)
                     if course.name in e.courses])  # fmt: skip


def _floor(k: int, n_channel: int) -> np.ndarray:
    logs = [FLOOR_LOG] if k == 1 else [FLOOR_LOG, FLOOR_LOG, FLOOR_CROSS]
    return np.array([*logs, *[FLOOR_SHAPE] * (k * n_channel), *[FLOOR_PHASE] * (k * n_channel)])


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
