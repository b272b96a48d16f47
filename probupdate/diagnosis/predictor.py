"""What the model expects of every group of modes at any nacelle angle, and how that changes with every effect."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from scipy import sparse

from probupdate.diagnosis.blocks import Blocks
from probupdate.diagnosis.mode_numbers import (
    INDEPENDENCE,
    Reference,
    directions_in,
    independence,
    n_response,
    signature,
)
from probupdate.diagnosis.small_model import LocalModel, Slopes, SmallModel, SmallModes
from probupdate.effects.catalogue import Effect
from probupdate.errors import InputError
from probupdate.modal.frequency_pairs import pair_in_order
from probupdate.modal.matching import assign
from probupdate.modal.modes import modes_of_plane
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array

# a computed mode this near (in ln f) to a group's, of which no measured one is left, turns with it by chance: what a
# few per cent of any stiffness does to their shapes has no bound
MATE = 0.02
# standard deviation in rad of a turn of which nothing is known
FREE_TURN = 10.0
# a mode that moves the sensors less than this share of what another does is seen by none of them
UNSEEN = 1e-3
# least share of a measured shape that lies in the plane of the computed mode it is paired with (and of its equals)
LOOKS_LIKE = 0.5
# a computed mode's frequency this far off (in ln f) counts little less for a pairing than a shape without score
# correlation
CLOSENESS = 0.2
# modes of a state are others than over the whole record where shape and closeness count less by this together
ANOTHER_STATE = 0.1
# share of blocks in which a pair's shapes are independent where they are apart for other reasons than noise: of
# directions by chance it is half
REPRODUCED = 0.9
# shapes of a pair nearer to each other than this are one
LEAST_APART = 0.01
# what shape and closeness of a mode that the model lacks count in a pairing where nothing is there that has it
AFTER_ALL_OTHERS = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalPredictor:
    """rows of the model's channels that were measured; groups with their measured planes (n_channel, k) and ln f;
    axes (n_channel, k) of each group, shapes of the measured plane along the model's, from which measured and expected
    ones are known. `lacked`: numbers of groups that the model by itself has nothing for. `seen`: the sensors' effects
    with their sizes behind which modes are paired. `state`: the blocks whose planes and ln f these are, one byte each,
    none of all, and those effects."""

    small: SmallModel
    rows: np.ndarray
    planes: tuple[np.ndarray, ...]
    log_frequency: tuple[np.ndarray, ...]
    axes: tuple[np.ndarray, ...]
    lacked: frozenset[int] = frozenset()
    seen: tuple[tuple[Effect, float], ...] = ()
    state: bytes = b""
    known: dict[tuple, list] = field(default_factory=dict, repr=False)

    @property
    def parameters(self):
        return self.small.parameters

    def of_state(self, blocks: Blocks, chosen: np.ndarray) -> ModalPredictor:
        """With planes and frequencies of the `chosen` blocks (n_block,) alone, where modes are others there than over
        the whole record: the mean of two states is like neither, and which computed mode is which measured one is asked
        of what was measured in the state that is computed."""
        planes, logs, others = [], [], False
        for q, (plane, log) in enumerate(zip(self.planes, self.log_frequency, strict=True)):
            there = np.flatnonzero(blocks.present[:, q] & chosen)
            if len(there):
                own, its = _measured_plane(blocks, blocks.groups[q], there)
                alike = float(np.sum((own.T @ plane) ** 2)) / plane.shape[1] if len(plane) else 1.0
                others |= alike + _nearness(its.mean() - log.mean()) < 2.0 - ANOTHER_STATE
                plane, log = own, its
            planes.append(plane)
            logs.append(log)
        if not others:
            return self
        return replace(self, planes=tuple(planes), log_frequency=tuple(logs), state=chosen.tobytes())

    def matched_as_measured(self, local: LocalModel, effects: Sequence[tuple[Effect, float]]) -> ModalPredictor:
        """Paired with modes as sensors with these effects and sizes show them, where that makes other pairs: with two
        channels exchanged, or one ten times too large, a measured shape may be more like that of another mode."""
        marks = "|".join(f"{e.key} {size!r}" for e, size in effects)
        if self._pairs_at_rest(local, marks, effects) == self._pairs_at_rest(local, "", self.seen):
            return self
        return replace(self, seen=tuple(effects), state=self.state + marks.encode())

    def _pairs_at_rest(
        self, local: LocalModel, marks: str, seen: Sequence[tuple[Effect, float]]
    ) -> list[tuple[int, ...]]:
        """`_pairs` with the nacelle as in the model, kept: a step of a fit asks again what its trial asked."""
        planes, pairs = local.paired.get((self.state, marks), (None, []))
        if planes is not self.planes:
            pairs = self._pairs(*self._search_modes(local, local.resting_modes), local.has_tuned_mass, seen)
            local.paired[self.state, marks] = self.planes, pairs
        return pairs

    def group_members(self, local: LocalModel, modes: SmallModes) -> tuple[np.ndarray, list[tuple[int, ...]]]:
        """shapes at the measured channels (n_channel, n_search) and the computed modes of every group, ascending, with
        their mates."""
        shape, groups = self._pair_modes(local, modes)
        return shape, self._add_neighbours(groups, np.log(modes.frequency_hz[: shape.shape[1]]))

    def _pair_modes(self, local: LocalModel, modes: SmallModes) -> tuple[np.ndarray, list[tuple[int, ...]]]:
        shape, log = self._search_modes(local, modes)
        return shape, self._pairs(shape, log, local.has_tuned_mass, self.seen)

    def _pairs(
        self, shape: np.ndarray, log: np.ndarray, has_tuned_mass: bool, seen: Sequence[tuple[Effect, float]]
    ) -> list[tuple[int, ...]]:
        """The computed modes of every group, ascending, of those with these shapes and ln f as sensors with the effects
        `seen` show them."""
        if not len(shape):
            return [(int(i),) for i in pair_in_order(self._centres, log)]
        shown, shift = _observed_shapes(shape, np.exp(log), seen) if seen else (shape, 0.0)
        score = self._scores(shown, log + shift, has_tuned_mass)
        chosen = assign(score)
        taken = set(chosen.tolist())
        groups = []
        for plane, start, size in zip(self.planes, *self._places, strict=True):
            end = start + size
            own = tuple(sorted(int(i) for i in chosen[start:end]))
            if len(own) == 2:
                own = modes_of_plane(plane, shown, score[start], own, taken)
                taken = taken - set(chosen[start:end].tolist()) | set(own)
            groups.append(own)
        return groups

    @cached_property
    def _centres(self) -> np.ndarray:
        """(n_group,) mean ln f of each group."""
        return np.array([expected.mean() for expected in self.log_frequency])

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """(n_group,) where each group's modes begin among all, and how many it has."""
        sizes = np.array([plane.shape[1] for plane in self.planes])
        return np.cumsum(sizes) - sizes, sizes

    def _search_modes(self, local: LocalModel, modes: SmallModes) -> tuple[np.ndarray, np.ndarray]:
        """Shapes at the measured channels (n_channel, n_search) and ln f (n_search,) of the modes that are looked
        through."""
        count = min(modes.n_search or local.n_search, modes.frequency_hz.size)
        return local.shapes(modes, count)[self.rows], np.log(modes.frequency_hz[:count])

    def _scores(self, shape: np.ndarray, log: np.ndarray, has_tuned_mass: bool) -> np.ndarray:
        """(n_measured, n_search) share of a computed shape in the measured plane and closeness of frequencies, 2 at
        most, which a pairing is by; -1 of modes that no sensor sees."""
        seen, (starts, sizes) = _is_seen(shape), self._places
        within = np.add.reduceat(np.abs(np.hstack(self.planes).T @ shape) ** 2, starts, axis=0)
        share = within / np.where(seen, _squares(shape), 1.0)
        score = np.where(seen, share + _nearness(log - self._centres[:, None]), -1.0)
        if not has_tuned_mass:
            # without what has it, a mode that the model lacks takes none that another one is
            score[list(self.lacked)] *= AFTER_ALL_OTHERS
        return np.repeat(score, sizes, axis=0)

    @staticmethod
    def _add_neighbours(groups: list[tuple[int, ...]], log: np.ndarray) -> list[tuple[int, ...]]:
        """Each group's computed modes with those next to them that no group has: which direction of their common plane
        was measured is not known from the model."""
        taken, near = {i for group in groups for i in group}, np.abs(log[:, None] - log) < MATE
        result = []
        for group in groups:
            mates = [i for i in np.flatnonzero(near[list(group)].any(axis=0)).tolist() if i not in taken]
            taken.update(mates)
            result.append(tuple(sorted((*group, *mates))))
        return result

    def references(self, local: LocalModel, angle_deg: float) -> tuple[Reference, ...]:
        """Expected modes of every group."""
        modes = local.solve(angle_deg, local.n_search)
        shape, groups = self.group_members(local, modes)
        return tuple(
            self._reference(modes, shape, members, axes)[0] for members, axes in zip(groups, self.axes, strict=True)
        )

    @staticmethod
    def _reference(modes, shape, members, axes) -> tuple[Reference, np.ndarray]:
        """With `turn` (n_member, k): the directions of the members' plane that are nearest to the axes."""
        own = shape[:, list(members)]
        turn = own.T @ axes
        if turn.size == 1:
            turn = np.where(turn < 0, -1.0, 1.0)
        else:
            left, _, right = np.linalg.svd(turn, full_matrices=False)
            turn = left @ right
        log = np.log(modes.frequency_hz[list(members)])
        return Reference(tensor=turn.T @ np.diag(log) @ turn, shape=own @ turn), turn

    def unknown_turns(
        self, local: LocalModel, angle_deg: float, seen: Sequence[tuple[Effect, float]] = ()
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Per group what its numbers do where it turns towards computed modes nearby that no measured one was paired
        with: (n_response, n) for a turn of one radian, and the standard deviation (n,) of the turn. Of mates any turn
        is as probable, as a tolerance of any stiffness makes it; beyond them it fades out to twice as far."""
        modes = local.solve(angle_deg, local.n_search)
        shape, groups = self.group_members(local, modes)
        log, taken = np.log(modes.frequency_hz[: shape.shape[1]]), {i for group in groups for i in group}
        result = []
        for members, axes in zip(groups, self.axes, strict=True):
            reference, turn = self._reference(modes, shape, members, axes)
            k, n_channel = reference.tensor.shape[0], shape.shape[0]
            away = {i: float(np.min(np.abs(log[list(members)] - log[i]))) for i in range(len(log)) if i not in taken}
            near = [i for i, gap in away.items() if gap < 2 * MATE]
            beyond = np.linalg.svd(turn)[0][:, k:]
            others = np.hstack([shape[:, list(members)] @ beyond, shape[:, near]])
            std = np.array([FREE_TURN] * beyond.shape[1] + [0.5 * (2 * MATE / max(away[i], MATE) - 1) for i in near])
            if not others.size or not n_channel:
                result.append((np.zeros((n_response(k, n_channel), 0)), np.zeros(0)))
                continue
            change = np.zeros((n_channel, k, k * len(std)))
            for j in range(k):
                change[:, j, j * len(std) : (j + 1) * len(std)] = others
            made = signature(observe([reference], seen)[0], np.zeros((k, k, k * len(std))),
                             _observed_change(reference, change, seen), axes)
            result.append((made, np.tile(std, k)))
        return result

    def slopes(
        self, local: LocalModel, angles_deg: Sequence[float] | np.ndarray, slopes: Slopes
    ) -> list[list[Sloped]]:
        """At every angle for every group its reference, and the change of the tensor (k, k, n_param) and of the shapes
        (n_channel, k, n_param) in the group's axes with each parameter of `slopes` (see LocalModel.slopes)."""
        places, own_shapes = [], []
        for angle in angles_deg:
            modes = local.modes_at(angle)
            shape, groups = self.group_members(local, modes)
            places.append((angle, modes, groups))
            own_shapes.append(shape)
        result = []
        for (_, modes, groups), shape, changes in zip(places, own_shapes, local.derivatives(slopes, places),
                                                      strict=True):
            here = []
            for members, axes, (coupling, d_shape) in zip(groups, self.axes, changes, strict=True):
                reference, turn = self._reference(modes, shape, members, axes)
                value = (2 * np.pi * modes.frequency_hz[list(members)]) ** 2
                gap = value[:, None] - value[None, :]
                near = np.abs(gap) < 1e-9 * value[:, None]
                log = 0.5 * np.log(value)
                divided = np.where(
                    near, 0.5 / value[:, None], (log[:, None] - log[None, :]) / np.where(near, 1.0, gap)
                )
                here.append((reference, np.einsum("ia,ijp,jb->abp", turn, coupling * divided[:, :, None], turn),
                             np.einsum("cjp,jk->ckp", d_shape[self.rows], turn)))
            result.append(here)
        return result


def observe(references: Sequence[Reference], effects: Sequence[tuple[Effect, float]]) -> list[Reference]:
    """The references as sensors with these effects and sizes see them, each where it stands on the way of a signal."""
    if not effects:
        return list(references)
    shape, shift = _observed_shapes(*_side_by_side(references), effects)
    return [Reference(tensor=r.tensor + (r.members[1] * shift[own]) @ r.members[1].T,
                      shape=shape[:, own] @ r.members[1].T)
            for r, own in zip(references, _columns(references), strict=True)]


def _side_by_side(references: Sequence[Reference]) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (n_channel, n) of all references' modes, and the frequency of each (n,)."""
    return (np.concatenate([r.shape @ r.members[1] for r in references], axis=1),
            np.concatenate([r.members[0] for r in references]))


def _columns(references: Sequence[Reference]) -> list[slice]:
    ends = np.cumsum([0, *(r.shape.shape[1] for r in references)])
    return [slice(*pair) for pair in pairwise(ends)]


def _observed_shapes(
    shape: np.ndarray, frequency_hz: np.ndarray, effects: Sequence[tuple[Effect, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (n_channel, n) behind all effects, and what they add to ln f (n,)."""
    shift = np.zeros(len(frequency_hz))
    for effect, size in sorted(effects, key=lambda e: e[0].stage):
        shape, more = effect.sensed(shape, frequency_hz, size)
        shift = shift + more
    return shape, shift


# of one group at one angle: the plain reference, and the changes of its tensor (k, k, n_param) and of its shapes
# (n_channel, k, n_param) with the parameters
Sloped = tuple[Reference, np.ndarray, np.ndarray]


def effect_signatures(
    effects: Sequence[Effect], names: tuple[str, ...], places: Sequence[tuple[Sloped, np.ndarray]],
    seen: Sequence[tuple[Effect, float]] = (), of_nominal: np.ndarray | None = None,
) -> list[np.ndarray]:
    """At each place - a group at one angle, with the axes (n_channel, k) it is estimated from - the change per unit
    size of every effect (n_response, n_effect), where the sensors have the effects `seen` already, with their sizes: of
    these the size changes, any other is one more. `names`: the parameters of the slopes; `of_nominal` of these the
    `shares_of_nominal`, one where not given."""
    of_sensors = np.array([effect.observe is not None for effect in effects], bool)
    others = [effect for effect in effects if effect.observe is None]
    amounts = _increments(tuple(others), names)
    if of_nominal is not None:
        amounts = np.where([bool(e.parts) for e in others], of_nominal[:, None] * amounts, amounts)
    # an effect moves a parameter or a few
    amounts = sparse.csr_array(amounts.T)
    plain = [reference for (reference, _, _), _ in places]
    d_shape, d_log = _sensor_changes([e for e in effects if e.observe is not None], plain, seen)
    own, there = _columns(plain), observe(plain, seen)
    of_group: dict[int, list[int]] = {}
    for number, (_, axes) in enumerate(places):
        of_group.setdefault(id(axes), []).append(number)
    result = [np.empty(0)] * len(places)
    for numbers in of_group.values():
        sloped, axes = [places[i][0] for i in numbers], places[numbers[0]][1]
        reference = Reference(tensor=np.array([there[i].tensor for i in numbers]),
                              shape=np.array([there[i].shape for i in numbers]))
        # of real numbers by themselves in half of the time
        moved = signature(reference, _sum_changes(np.array([tensor for _, tensor, _ in sloped]), amounts),
                          _sum_changes(np.array([_observed_change(*one[::2], seen) for one in sloped]), amounts), axes)
        made = np.empty((*moved.shape[:2], len(effects)))
        made[:, :, ~of_sensors] = moved
        if of_sensors.any():
            turn = np.array([plain[i].members[1] for i in numbers])
            of_log, of_shape = (np.array([d[own[i]] for i in numbers]) for d in (d_log, np.swapaxes(d_shape, 0, 1)))
            made[:, :, of_sensors] = signature(reference, np.einsum("gai,gip,gbi->gabp", turn, of_log, turn),
                                               np.einsum("gicp,gki->gckp", of_shape, turn), axes)
        for i, one in zip(numbers, made, strict=True):
            result[i] = one
    return result


def _sum_changes(change: np.ndarray, amounts: sparse.csr_array) -> np.ndarray:
    """(..., n_effect) of changes (..., n_param) and the parameters' amounts in each effect (n_effect, n_param)."""
    *lead, n_param = change.shape
    return (amounts @ change.reshape(int(np.prod(lead)), n_param).T).T.reshape(*lead, amounts.shape[0])


def _sensor_changes(
    effects: Sequence[Effect], references: Sequence[Reference], seen: Sequence[tuple[Effect, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Change per unit size of each effect of sensors: of the shapes of all references' modes side by side
    (n_channel, n, n_effect) and of their ln f (n, n_effect)."""
    shape, frequency = _side_by_side(references)
    d_shape, d_log = np.empty((*shape.shape, len(effects)), complex), np.empty((len(frequency), len(effects)))
    for j, effect in enumerate(effects):
        h, there = effect.step_of_size, any(e is effect for e, _ in seen)
        # a gain on top of a gain of ten does ten times what a larger one does
        (up, more), (down, less) = (
            _observed_shapes(shape, frequency,
                     [(e, size + d * (e is effect)) for e, size in seen] if there else [*seen, (effect, d)])
            for d in (h, -h)
        )
        d_shape[:, :, j], d_log[:, j] = (up - down) / (2 * h), (more - less) / (2 * h)
    return d_shape, d_log


def _observed_change(reference: Reference, shape: np.ndarray, seen: Sequence[tuple[Effect, float]]) -> np.ndarray:
    """Changes of shape (n_channel, k, n) as sensors with these effects see them; all observations are linear."""
    if not seen:
        return shape
    frequency, turn = reference.members
    of_members = np.einsum("ckn,ki->cin", shape, turn)
    flat = of_members.reshape(shape.shape[0], -1)
    changed = _observed_shapes(flat, np.repeat(frequency, shape.shape[2]), seen)[0].reshape(of_members.shape)
    return np.einsum("cin,ki->ckn", changed, turn)


def shares_of_nominal(parameters: Parameters, theta: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """What of their initial values these parameters are at theta (n,), one where that is zero. What a group of them
    changes by is this share of what it states: nothing is left of members that are lost, whatever each had."""
    rows = [parameters.index(name) for name in names]
    initial = parameters.initial[rows]
    return np.divide(theta[rows], initial, out=np.ones(len(rows)), where=initial != 0)


@lru_cache(maxsize=8)
def _increments(effects: tuple[Effect, ...], names: tuple[str, ...]) -> np.ndarray:
    """How much of each parameter a unit of each effect is (n_param, n_effect). Raises InputError for a parameter that
    the model does not have."""
    column = {name: k for k, name in enumerate(names)}
    amounts = np.zeros((len(names), len(effects)))
    for j, effect in enumerate(effects):
        for name, amount in effect.increments if effect.observe is None else ():
            if name not in column:
                raise InputError(f"effect {effect.name}", f"names a parameter '{name}' that the model lacks",
                                 f"correct `parts`; there are {', '.join(names)}")
            amounts[column[name], j] += amount
    return amounts


def build_predictor(
    small: SmallModel, blocks: Blocks, theta: np.ndarray, unmatched: Collection[str] = ()
) -> ModalPredictor:
    """Pair the measured groups with the model's modes at theta, those `unmatched` after all others; raises InputError
    for channels it does not have."""
    lacked = frozenset(q for q in range(len(blocks.groups)) if blocks.group_name(q) in unmatched)
    start = replace(_without_axes(small, blocks, blocks.groups), lacked=lacked)
    local = small.evaluate(theta)
    shape, groups = start.group_members(local, local.solve())
    axes = tuple(_align_alike_pairs(blocks, group, _align_in_plane(plane, shape[:, list(members)]))
                 for group, plane, members in zip(blocks.groups, start.planes, groups, strict=True))
    return replace(start, axes=axes, known={})


def expected_frequencies(
    small: SmallModel, blocks: Blocks, theta: np.ndarray, unmatched: Collection[str] = ()
) -> dict[str, float]:
    """Where the model at theta has each measured mode, in Hz by label, each paired by itself: NaN where it looks like
    none of the model's, not there where the sensors see no mode that is left. Those `unmatched` are not paired and are
    where they were measured. Raises as `build_predictor`."""
    of_model = [j for j, name in enumerate(blocks.labels) if name not in unmatched]
    start = _without_axes(small, blocks, [(j,) for j in of_model])
    modes = small.evaluate(theta).solve()
    shape, members = start._pair_modes(small.evaluate(theta), modes)
    found, seen = {name: float(np.nanmedian(hz)) for name, hz in zip(blocks.labels, blocks.frequency_hz.T, strict=True)
                   if name in unmatched}, _is_seen(shape)
    for name, plane, (i,) in zip((blocks.labels[j] for j in of_model), start.planes, members, strict=True):
        if not seen[i]:
            continue
        if not len(shape):
            found[name] = float(modes.frequency_hz[i])
            continue
        # equal modes have no shapes but their plane's
        near = np.abs(np.log(modes.frequency_hz[: shape.shape[1]] / modes.frequency_hz[i])) < MATE
        basis = np.linalg.qr(shape[:, near])[0]
        alike = np.sum((basis.T @ plane) ** 2) > LOOKS_LIKE
        found[name] = float(modes.frequency_hz[i]) if alike else np.nan
    return found


def unit_scores(
    small: SmallModel, blocks: Blocks, theta: np.ndarray, unmatched: Collection[str], factors: Sequence[float]
) -> np.ndarray:
    """(n_factor,) how well the model's modes pair with those measured, 2 at most, of frequencies alone 1, if these are
    given in a unit of which a hertz is so many."""
    start = _without_axes(small, blocks, [(j,) for j, name in enumerate(blocks.labels) if name not in unmatched])
    local = small.evaluate(theta)
    shape, log = start._search_modes(local, local.solve())
    found = []
    for factor in factors:
        if not blocks.channels:
            there = log + np.log(factor)
            found.append(_nearness(start._centres - there[pair_in_order(start._centres, there)]).mean())
            continue
        score = start._scores(shape, log + np.log(factor), has_tuned_mass=False)
        found.append(score[np.arange(len(score)), assign(score)].mean())
    return np.array(found)


def _is_seen(shape: np.ndarray) -> np.ndarray:
    """(n_mode,) bool: modes of unit modal mass whose shapes (n_channel, n_mode) are not across all sensors."""
    size = np.linalg.norm(shape, axis=0)
    if not len(shape):
        return np.ones(shape.shape[1], bool)
    return size > UNSEEN * np.max(size, initial=0.0)


def _squares(shape: np.ndarray) -> np.ndarray:
    """(n,) sum of squares of each column, possibly complex."""
    return np.sum(np.abs(shape) ** 2, axis=0)


def _without_axes(small: SmallModel, blocks: Blocks, groups: Sequence[tuple[int, ...]]) -> ModalPredictor:
    missing = [c for c in blocks.channels if c not in small.channels]
    if missing:
        close = difflib.get_close_matches(missing[0].lower(), [c.lower() for c in small.channels], n=1)
        meant = f"; did you mean {next(c for c in small.channels if c.lower() == close[0])}?" if close else ""
        raise InputError(f"channel {missing[0]}", f"is in the measured modes but not in the model{meant}",
                         f"name the channels as the model does: {', '.join(small.channels[:12])}"
                         f"{', ...' * (len(small.channels) > 12)}")
    rows, measured = np.array([small.channels.index(c) for c in blocks.channels], int), sum(map(len, groups))
    if measured > small.n_search:
        raise InputError("modes", f"holds {measured} modes where {small.n_search} of the model {small.name} are known",
                         "leave out the highest modes, or give matrices of more degrees of freedom")
    planes, logs = [], []
    for group in groups:
        together = np.flatnonzero(blocks.have(group))
        if not len(together):
            raise InputError("modes", f"{' and '.join(blocks.labels[j] for j in group)} are close and in no set "
                             "together, so that there is nothing to compare", "list each mode at the same place of "
                             "every set, null where it was not found, or leave out one of the two")
        plane, log = _measured_plane(blocks, group, together)
        planes.append(plane)
        logs.append(log)
    return ModalPredictor(small=small, rows=rows, planes=tuple(planes), log_frequency=tuple(logs), axes=())


def _measured_plane(blocks: Blocks, group: Sequence[int], there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The plane (n_channel, k) and ln f (k,) of a group's modes over the blocks numbered `there`."""
    members = list(group)
    log = np.median(np.log(blocks.frequency_hz[there][:, members]), axis=0)
    if not blocks.channels:
        return np.zeros((0, len(members))), log
    basis = np.linalg.qr(blocks.shape[there][:, :, members])[0]
    projector = np.einsum("nck,ndk->cd", basis, basis.conj()).real
    return np.ascontiguousarray(np.linalg.eigh(projector)[1][:, -len(members):]), log


def _align_alike_pairs(blocks: Blocks, group: Sequence[int], axes: np.ndarray) -> np.ndarray:
    """Axes (n_channel, k) in which a pair's shapes are apart that are alike and yet not one shape but for noise, as
    where one channel is ten times too large: in others hardly a block would say anything. A few sets show no noise."""
    members = list(group)
    there = np.flatnonzero(blocks.have(members))
    if not axes.size or len(members) == 1 or blocks.few:
        return axes
    own = directions_in(axes, blocks.shape[there][:, :, members])
    if np.mean(independence(own) >= INDEPENDENCE) >= REPRODUCED:
        return axes
    # of all blocks alike: the geometric mean of what makes the directions of each orthonormal
    value, turn = np.linalg.eigh(own @ own.transpose(0, 2, 1))
    value, turn = np.linalg.eigh(np.mean((turn * np.log(np.maximum(value, LEAST_APART**2))[:, None, :])
                                         @ turn.transpose(0, 2, 1), axis=0))
    along = axes @ (turn * np.exp(0.5 * value)) @ turn.T
    seen = directions_in(along, blocks.shape[there][:, :, members])
    if np.mean(independence(seen) >= INDEPENDENCE) < REPRODUCED:
        return axes
    return frozen_array(along / np.max(np.abs(along)))


def _nearness(apart: np.ndarray) -> np.ndarray:
    """What so much between two ln f counts for a pairing, one where there is nothing."""
    return np.exp(-0.5 * (apart / CLOSENESS) ** 2)


def _align_in_plane(plane: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Shapes (n_channel, k) of an orthonormal plane along these, as far as it allows, largest component 1 or -1; of
    more modes than the plane has directions none is its own. Eigenvectors come with either sign, by how they are
    rounded, and draws of the noise would differ with it: the first component of more than half the largest is
    positive."""
    if not plane.size:
        return frozen_array(plane)
    turned = plane
    if shape.shape[1] == plane.shape[1]:
        left, _, right = np.linalg.svd(plane.T @ (shape / np.linalg.norm(shape, axis=0)))
        turned = plane @ (left @ right)
    turned = turned / np.max(np.abs(turned), axis=0)
    first = np.argmax(np.abs(turned) > 0.5, axis=0)
    return frozen_array(turned * np.sign(turned[first, np.arange(turned.shape[1])]))
