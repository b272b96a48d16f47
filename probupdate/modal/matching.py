"""Which computed mode is which measured mode: by shape, not by order; close modes by the plane they span."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.frequency_pairs import pair_in_order, refuse_another_unit
from probupdate.modal.labels import label_across
from probupdate.modal.sets import ModalSet
from probupdate.modal.shape_criteria import (
    assign,
    criteria_within_plane,
    mac,
    rotate_to_real,
    share_within,
    subspace_mac,
)
from probupdate.model.interface import ModalSolution, Model
from probupdate.runtime.arrays import frozen_array

# measured modes whose frequencies differ by less than this share of their mean are compared as a plane: within it the
# single shapes turn into each other with the noise
PAIR_GAP = 0.10
# of a pair of which one was measured: farther apart, a local error turns a shape by less than frequencies tell, and the
# frequency of a combination would be wrong by more (`mixing` states the turn)
HALF_GAP = 0.05
# shapes of close modes whose least direction is less than this of the largest span no plane
NO_PLANE = 1e-3
# below this criterion a computed mode is not taken for a measured one
MIN_MAC = 0.50
# a pairing stands where every other one is worse by at least this MAC for each mode that would change its partner
CLEAR = 0.15
# modes that move the measured channels less than this share of what a paired mode does are no alternative to it
SEEN = 0.05
# a computed mode of which a measured shape has at least this MAC may be what that shape has turned towards
TURNED = 0.05
# an alternative farther in frequency than the paired mode by this much more (in ln f) is none, however alike its shape
APART = 0.3
# of two pairings that are about as alike one stands where the frequencies make it so many times as probable, by the
# prior's covariance of ln f and an independent error of the model's own, and where they are no farther off than chi2
# allows by so many of its standard deviations
ODDS, MODEL_ERROR, IMPROBABLE = 1000.0, 0.02, 4.0
# where fewer than half of the measured modes have this MAC with any computed one, the set is taken for another
# structure's, or its channels for swapped
OWN_MAC = 0.60
OR_NULL = ", or leave one out: list the other modes' labels behind the file of --modes"
# measured shapes this much alike are one shape within what shapes are measured to
SAME = 0.95
# computed modes beyond the highest matched one that every evaluation carries: the highest measured mode may trade its
# place with the next one and is followed; a note is made where draws use the last
SPARE = 1


@dataclass(frozen=True, eq=False, kw_only=True)
class ModeGroup:
    """Measured modes that are compared together: one, or the two (or more) of a close cluster, ascending in f.

    mates: of one that was measured alone of a close pair, the computed mode beside its own; it is compared with the
    combination of the two that is nearest, as it turns within their plane.
    """

    measured: tuple[int, ...]
    computed: tuple[int, ...]
    mates: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Matching:
    """groups: every mode that is used. criterion (n_measured, n_computed) holds MAC, or for members of a cluster the
    MAC of the computed shape with its best match in the measured plane, and of one of a close pair measured alone that
    with the best combination of both computed ones; rows of NaN for modes not measured.
    `left_out`: a sentence for each mode of the data that is not used. n_mode: computed modes an evaluation needs.
    absent: measured modes of a pair of which the model has the other one alone. uncertain: of modes left out as either
    of two computed ones may be theirs, what is to be said. least_motion: over the measured channels, for unit modal
    mass: a computed mode that moves them less is none of the measured ones."""

    groups: tuple[ModeGroup, ...]
    criterion: np.ndarray
    left_out: tuple[str, ...]
    n_mode: int
    absent: tuple[int, ...] = ()
    uncertain: InputError | None = None
    least_motion: float = 0.0

    @property
    def measured(self) -> tuple[int, ...]:
        """Used modes of the data, by group."""
        return tuple(j for group in self.groups for j in group.measured)

    @property
    def computed(self) -> tuple[int, ...]:
        return tuple(i for group in self.groups for i in group.computed)

    @property
    def pairs(self) -> tuple[tuple[int, ...], ...]:
        """Measured modes compared as planes."""
        return tuple(group.measured for group in self.groups if len(group.measured) > 1)


def channel_rows(model: Model, channels: tuple[str, ...]) -> np.ndarray:
    """Row of each measured channel in the model's shapes; raises InputError for one the model does not have."""
    row = {name: k for k, name in enumerate(model.channels)}
    missing = [name for name in channels if name not in row]
    if missing:
        raise InputError(f"channel {missing[0]}", "is in the measured modes but not in the model"
                         f"{'' if model.name == 'model' else f' {model.name}'} ({len(missing)} of {len(channels)} "
                         "missing)", "name the model's channels as the data's, or load the model with the campaign's "
                         "sensors")
    return np.array([row[name] for name in channels], int)


def with_stated_gravity(model: Model, felt: Mapping[str, bool]) -> Model:
    """The model with what is stated of its channels: whether their readings hold gravity. A model that knows nothing of
    it gives what its author says its shapes are."""
    state = getattr(model, "with_gravity", None)
    return model if state is None or not felt else state(felt)


def close_clusters(frequency_hz: np.ndarray, gap: float = PAIR_GAP) -> list[tuple[int, ...]]:
    """Runs of measured modes, ascending in frequency, whose neighbours differ by less than `gap` of their mean."""
    order = [int(j) for j in np.argsort(frequency_hz) if np.isfinite(frequency_hz[j])]
    clusters: list[list[int]] = []
    for j in order:
        if clusters:
            below = frequency_hz[clusters[-1][-1]]
            if frequency_hz[j] - below < gap * 0.5 * (frequency_hz[j] + below):
                clusters[-1].append(j)
                continue
        clusters.append([j])
    return [tuple(c) for c in clusters]


def match(
    modal_set: ModalSet,
    solution: ModalSolution,
    rows: np.ndarray,
    *,
    labels: tuple[str, ...] = (),
    clusters: list[tuple[int, ...]] | None = None,
    min_mac: float = MIN_MAC,
    refuse: bool = True,
    planes: bool = True,
    prior_cov: Callable[[], np.ndarray] | None = None,
) -> Matching:
    """Pair measured with computed modes one to one by the largest sum of criteria.

    `solution` holds more modes than were measured; `rows` its rows for the measured channels. `clusters` fixes which
    measured modes are compared as planes (default: by frequency, `close_clusters`); where only one of a close pair was
    measured, its computed mode has a mate, unless `planes` is False. `prior_cov`: gives the covariance (n_computed,
    n_computed) of ln f by the prior; where shapes leave two pairings, the one that is ODDS times as probable by it
    stands, and where neither is, the modes that differ are left out. Raises InputError where a shape is
    zero, where no mode can be used, where the set is not this model's, where frequencies are in another unit, where
    more than half of the modes have two computed ones to choose from, and where close modes have one shape. `refuse`
    False: all but the first two are no error, for a picture of a poor model.
    """
    modal_set.refuse_zero_shapes(modal_set.where)
    name = labels or tuple(f"mode {j + 1}" for j in range(modal_set.frequency_hz.size))
    clusters = close_clusters(modal_set.frequency_hz) if clusters is None else clusters
    measured = np.real(rotate_to_real(modal_set.shape))
    computed = solution.shape[rows]
    components = np.isfinite(measured).sum(axis=0)
    if np.all(components[modal_set.measured] <= 1) and modal_set.measured.any():
        return _match_by_frequency(modal_set, solution.frequency_hz)
    used, left_out = _usable_modes(modal_set, measured, name, clusters)
    # given clusters may come from another set, whose pair had its frequencies the other way round
    present = [[j for j in c if j in used] for c in clusters]
    halves = {p[0] for p, c in zip(present, clusters, strict=True) if len(p) == 1 < len(c)}
    clusters = [tuple(sorted(c, key=lambda j: modal_set.frequency_hz[j])) for c in present if c]
    if refuse:
        _refuse_equal_shapes(modal_set.where, clusters, measured, name)
    visible = np.linalg.norm(computed, axis=0)
    clusters, used, absent = _present(clusters, used, measured, computed, min_mac)
    left_out += [f"{name[j]} in {modal_set.where}: the model has no mode for the measured {name[j]}; the other of "
                 "its pair is compared alone" for j in absent]
    criterion = _criteria(measured, computed, clusters)
    partner = _partners(criterion, used)
    if refuse and len(partner) > 1:
        refuse_another_unit(modal_set.where, [modal_set.frequency_hz[j] / solution.frequency_hz[i]
                                                    for j, i in partner.items() if criterion[j, i] >= OWN_MAC])
    partner = _nearer(partner, criterion, modal_set.frequency_hz, solution.frequency_hz, visible)
    together = _pair_criteria(measured, computed, clusters)
    partner = _pair_partners(partner, together, modal_set.frequency_hz, solution.frequency_hz)
    unmeasured = [name[k] for k in np.flatnonzero(~modal_set.measured)]
    known = halves, {j for j in partner if label_across(name[j]) in unmeasured}
    compared = _Comparison(where=modal_set.where, name=name, measured_hz=modal_set.frequency_hz, measured=measured,
                           computed_hz=solution.frequency_hz, computed=computed, criterion=criterion, clusters=clusters,
                           together=together, known=known, planes=planes, min_mac=min_mac)
    chosen = _choose_pairing(compared, partner, len(used), prior_cov, refuse=refuse)
    partner, criterion, groups = chosen.partner, chosen.criterion, chosen.groups
    left_out += chosen.left_out
    if refuse and partner:
        _refuse_another_structure(modal_set.where, criterion, partner, name)
    if not groups:
        raise InputError(
            modal_set.where, f"none of its modes can be used ({'; '.join(left_out)})",
            "check channel names, signs and units of the shapes, or identify these modes",
        )
    highest = max(i for group in groups for i in (*group.computed, *group.mates))
    return Matching(
        groups=tuple(groups), criterion=frozen_array(criterion), left_out=tuple(left_out),
        n_mode=min(highest + 1 + SPARE, computed.shape[1]), absent=tuple(absent),
        uncertain=chosen.uncertain, least_motion=_least_motion(measured, computed, groups),
    )


def _least_motion(measured: np.ndarray, computed: np.ndarray, groups: Sequence[ModeGroup]) -> float:
    own = np.isfinite(measured[:, [j for group in groups for j in group.measured]]).any(axis=1)
    paired = [i for group in groups for i in (*group.computed, *group.mates)]
    return SEEN * float(np.linalg.norm(computed[own][:, paired], axis=0).min())


def _present(
    clusters: Sequence[tuple[int, ...]], used: Sequence[int], measured: np.ndarray, computed: np.ndarray,
    min_mac: float,
) -> tuple[list[tuple[int, ...]], list[int], list[int]]:
    """Clusters and modes without the absent ones, and these: measured modes of a pair whose plane the computed ones do
    not span, where the model has the other one. Programs drop one of a symmetric pair, or have motion one way alone;
    with neither alike all of the pair is left out."""
    found: list[int] = []
    partner = _partners(_criteria(measured, computed, clusters), used)
    for cluster in clusters:
        known = np.all(np.isfinite(measured[:, list(cluster)]), axis=1)
        if len(cluster) != 2 or known.sum() < 3:
            continue
        plane, _ = np.linalg.qr(measured[known][:, list(cluster)])
        own = [partner[j] for j in cluster if j in partner]
        computed_plane, _ = np.linalg.qr(computed[known][:, own])
        if len(own) == 2 and np.linalg.svd(plane.T @ computed_plane, compute_uv=False)[-1] ** 2 >= min_mac:
            continue
        single = np.nan_to_num(mac(measured[:, list(cluster)], computed)).max(axis=1)
        kept = int(np.argmax(single))
        if single[kept] >= OWN_MAC and single[1 - kept] < min_mac:
            found.append(cluster[1 - kept])
    rest = [tuple(j for j in c if j not in found) for c in clusters]
    return [c for c in rest if c], [j for j in used if j not in found], found


def _usable_modes(
    modal_set: ModalSet, measured: np.ndarray, name: Sequence[str], clusters: Sequence[tuple[int, ...]]
) -> tuple[list[int], list[str]]:
    """Modes that can be compared, and what to say of those that cannot. measured (n_channel, n_mode), real shapes. A
    mode that the sets' common clusters do not have takes no computed one from those that they do."""
    used: list[int] = []
    left_out: list[str] = []
    for j in range(modal_set.frequency_hz.size):
        if not modal_set.measured[j]:
            left_out.append(f"{name[j]} was not identified in {modal_set.where}")
        elif np.isfinite(measured[:, j]).sum() < 2:
            left_out.append(f"{name[j]} has fewer than two measured shape components in {modal_set.where}")
        elif any(j in c for c in clusters):
            used.append(j)
    return used, left_out


def _criteria(measured: np.ndarray, computed: np.ndarray, clusters: Sequence[tuple[int, ...]]) -> np.ndarray:
    """MAC of every measured mode (rows) with every computed one; of modes in one cluster that of the plane they span.
    NaN for modes in no cluster."""
    criterion = np.full((measured.shape[1], computed.shape[1]), np.nan)
    for cluster in clusters:
        members = list(cluster)
        alone = len(members) == 1
        criterion[members] = (mac(measured[:, members], computed) if alone else
                              subspace_mac(computed, measured[:, members]))
    return criterion


def _partners(criterion: np.ndarray, used: Sequence[int]) -> dict[int, int]:
    """measured mode -> computed mode by the largest sum of criteria, for as many as the model has modes."""
    if not used:
        return {}
    n_computed = criterion.shape[1]
    # of a model with fewer modes than were measured, the columns beyond its own stand for no partner
    beyond = np.full((len(used), max(0, len(used) - n_computed)), np.nan)
    pairs = assign(np.hstack([criterion[list(used)], beyond]))
    return {j: int(i) for j, i in zip(used, pairs, strict=True) if i < n_computed}


def _pair_criteria(
    measured: np.ndarray, computed: np.ndarray, clusters: Sequence[tuple[int, ...]]
) -> dict[tuple[int, ...], np.ndarray]:
    """`criteria_within_plane` of each pair's plane, of what channels have both."""
    result = {}
    for cluster in clusters:
        known = np.all(np.isfinite(measured[:, list(cluster)]), axis=1)
        if len(cluster) == 2 and known.sum() > 2:
            plane, _ = np.linalg.qr(measured[known][:, list(cluster)])
            result[cluster] = criteria_within_plane(plane, computed[known])
    return result


def _pair_partners(
    partner: Mapping[int, int], together: Mapping[tuple[int, ...], np.ndarray], measured_hz: np.ndarray,
    computed_hz: np.ndarray,
) -> dict[int, int]:
    """The partners (measured -> computed mode), of a pair whose two look alike, as a bending and a torsion in which the
    sensors show that bending, the nearest two in frequency of those that span its plane."""
    result = dict(partner)
    for (a, b), value in ((pair, value) for pair, value in together.items() if partner.keys() >= set(pair)):
        free = [i for i in range(len(computed_hz)) if i not in result.values() or i in (result[a], result[b])]
        best = float(np.max(value[np.ix_(free, free)]))
        if value[result[a], result[b]] > best - 2 * CLEAR:
            continue
        off = np.abs(np.log(measured_hz[[a, b]][:, None] / computed_hz))
        result[a], result[b] = min(((i, k) for i, k in permutations(free, 2) if value[i, k] > best - 2 * CLEAR),
                                   key=lambda pair: off[0, pair[0]] + off[1, pair[1]])
    return result


def _clusters_above_least_mac(
    x: _Comparison, partner: dict[int, int], mates: dict[int, int], criterion: np.ndarray
) -> tuple[list[ModeGroup], list[str]]:
    """Clusters whose members all have a partner with at least `min_mac`, and what to say of the others."""
    groups: list[ModeGroup] = []
    left_out: list[str] = []
    name, where, min_mac = x.name, x.where, x.min_mac
    for cluster in x.clusters:
        names, alone = " and ".join(name[j] for j in cluster), [name[j] for j in cluster if j not in partner]
        if alone:
            left_out.append(f"{names} in {where}: the model has {criterion.shape[1]} modes, "
                            f"and others resemble them better than {' and '.join(alone)}")
            continue
        # a computed member may be the better half of a plane: the worst of the members decides
        if not all(criterion[j, partner[j]] >= min_mac for j in cluster):
            worst = min(cluster, key=lambda j: criterion[j, partner[j]])
            best = criterion[worst, partner[worst]]
            reason = f"best MAC left {best:.2f}, {min_mac:.2f} wanted" if np.isfinite(best) else \
                "too few channels to compare shapes by"
            if x.measured_hz[worst] > x.computed_hz[-1]:
                reason += (f"; it is at {x.measured_hz[worst]:.4g} Hz, and the highest computed mode, number "
                           f"{len(x.computed_hz)}, at {x.computed_hz[-1]:.4g} Hz")
            left_out.append(f"{names} in {where}: no computed mode resembles {name[worst]} ({reason})")
            continue
        groups.append(ModeGroup(measured=cluster, computed=tuple(sorted(int(partner[j]) for j in cluster)),
                                mates=tuple(mates[j] for j in cluster if j in mates)))
    return groups, left_out


def _match_by_frequency(modal_set: ModalSet, computed_hz: np.ndarray) -> Matching:
    """One sensor or none: a shape of one component is like any other, so that modes are paired by frequency, in its
    order."""
    used = [int(j) for j in np.argsort(modal_set.frequency_hz) if modal_set.measured[j]]
    if len(used) > len(computed_hz):
        raise InputError(modal_set.where,
                         f"has {len(used)} modes measured at one sensor at most, the model only {len(computed_hz)}",
                         "measure with more sensors, so that shapes say which mode is which")
    column = pair_in_order(np.log(modal_set.frequency_hz[used]), np.log(computed_hz))
    criterion = np.full((modal_set.frequency_hz.size, len(computed_hz)), np.nan)
    criterion[used, column] = 1.0
    return Matching(
        groups=tuple(ModeGroup(measured=(j,), computed=(int(i),)) for j, i in zip(used, column, strict=True)),
        criterion=frozen_array(criterion),
        left_out=("the shapes of all modes, which have one component at most: modes are paired by frequency alone",),
        n_mode=min(int(column.max()) + 1 + SPARE, len(computed_hz)),
    )


def _nearer(partner, criterion, measured_hz, computed_hz, visible) -> dict[int, int]:
    """The partners (measured -> computed mode), a free mode instead of one that is about as alike and much farther off
    in frequency, or hardly moves the channels beside it: on few levels a mode of thrice the frequency may have the
    shape by a hundredth better, and a torsion that the sensors do not see that of the bending in it."""
    away = np.abs(np.log(computed_hz[None, :] / measured_hz[:, None]))
    result = dict(partner)
    for j, i in partner.items():
        free = [k for k in range(len(computed_hz)) if k not in result.values() and visible[k] >= SEEN * visible[i]
                and criterion[j, k] > criterion[j, i] - CLEAR
                and away[j, k] < away[j, i] + (APART if visible[i] < SEEN * visible[k] else -APART)]
        if free:
            result[j] = min(free, key=lambda k: away[j, k])
    return result


def _mates(
    clusters: Sequence[tuple[int, ...]], partner: dict[int, int], known: tuple[set[int], set[int]],
    measured: np.ndarray, computed: np.ndarray, frequency_hz: np.ndarray,
) -> dict[int, int]:
    """measured mode -> the computed mode that is nearest to its own in frequency and no other measured mode's, of modes
    that are one of a close pair: by other sets (the first of `known`), or close in the model, and by labels (the
    second) or turned in the computed pair's plane."""
    (halves, labelled), found = known, {}
    for cluster in clusters:
        j = cluster[0]
        if len(cluster) > 1 or j not in partner:
            continue
        i, other = partner[j], {*partner.values(), *found.values()}
        k = int(nearest_free(frequency_hz[None], computed[None], np.array([[*other - {i}]], int),
                             np.array([i]))[0])
        if k == i or share_within(computed[:, k], computed[:, [i]]) >= SAME:
            continue
        close = abs(frequency_hz[k] - frequency_hz[i]) < HALF_GAP * 0.5 * (frequency_hz[k] + frequency_hz[i])
        turned = j in labelled or share_within(measured[:, j], computed[:, [k]]) >= TURNED
        if j in halves or close and turned:
            found[j] = k
    return found


def nearest_free(
    frequency_hz: np.ndarray, shape: np.ndarray, taken: np.ndarray, own: np.ndarray, plane: np.ndarray | None = None
) -> np.ndarray:
    """Of each of n solutions the mode nearest in frequency to mode `own` (n,) that is not among `taken` (n, n_taken)
    and moves the channels, (n,): `own` itself where there is none. frequency_hz (n, n_mode), shape (n, n_channel,
    n_mode). `plane` (n_channel, 2), orthonormal: its shape is to lie in it too, as another mode may come nearer."""
    row, visible = np.arange(len(own)), np.linalg.norm(shape, axis=1)
    away = np.abs(frequency_hz / frequency_hz[row, own][:, None] - 1)
    if plane is not None:
        within = np.linalg.norm(np.einsum("cp,ncm->npm", plane, shape), axis=1) / np.maximum(visible, 1e-300)
        # a pair's distance counts as much as a shape out of the plane
        away = 1 - within**2 + away / PAIR_GAP
    away[visible < SEEN * visible[row, own][:, None]] = np.inf
    away[row[:, None], np.column_stack([taken, own])] = np.inf
    nearest = np.argmin(away, axis=1)
    return np.where(np.isfinite(away[row, nearest]), nearest, own)


def _halves_note(where: str, mates, partner, name, frequency_hz) -> list[str]:
    found = []
    for j, k in mates.items():
        low, high = sorted((partner[j], k))
        found.append(f"the other mode of {name[j]}'s close pair (computed modes {low + 1} and {high + 1} at "
                     f"{frequency_hz[low]:.4g} and {frequency_hz[high]:.4g} Hz), not measured in {where}; "
                     f"{name[j]} is compared with the nearest combination of the two")
    return found


def _refuse_equal_shapes(
    where: str, clusters: Sequence[tuple[int, ...]], measured: np.ndarray, name: Sequence[str]
) -> None:
    """The second direction of a plane that is none would be rounding's, and so would be what it is paired with."""
    for cluster in clusters:
        shape = measured[:, list(cluster)]
        known = shape[np.all(np.isfinite(shape), axis=1)]
        if len(cluster) < 2 or len(known) < len(cluster):
            continue
        largest = np.max(np.abs(known), axis=0)
        singular = np.linalg.svd(known / np.where(largest > 0, largest, 1.0), compute_uv=False)
        if np.all(largest > 0) and singular[-1] < NO_PLANE * singular[0]:
            raise InputError(f"{where}, {' and '.join(name[j] for j in cluster)}",
                             "their shapes are the same: they span no plane",
                             "check that the modes are two different ones")


def _refuse_another_structure(where, criterion, partner, name) -> None:
    # NaN: too few channels to judge
    best = {j: criterion[j, i] for j, i in partner.items() if np.isfinite(criterion[j, i])}
    alike = sum(value >= OWN_MAC for value in best.values())
    if alike < 0.5 * len(best):
        listed = ", ".join(f"{name[j]} {value:.2f}" for j, value in best.items())
        raise InputError(
            where,
            f"its modes are not this model's: the best MACs are {listed}, and half of them should reach {OWN_MAC:.2f}",
            "check the order, names and signs of the channels, and that the model is of this structure",
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Comparison:
    """Measured and computed modes (n_channel, n_mode) beside one another, and how the measured ones are taken;
    `together` (n_computed, n_computed) of each measured pair how well each two computed modes span it."""

    where: str
    name: Sequence[str]
    measured_hz: np.ndarray
    measured: np.ndarray
    computed_hz: np.ndarray
    computed: np.ndarray
    criterion: np.ndarray
    clusters: Sequence[tuple[int, ...]]
    together: Mapping[tuple[int, ...], np.ndarray]
    known: tuple[set[int], set[int]]
    planes: bool
    min_mac: float


@dataclass(frozen=True, eq=False, kw_only=True)
class _Grouping:
    """The groups that partners (measured -> computed mode) make, and their criteria."""

    partner: dict[int, int]
    criterion: np.ndarray
    groups: tuple[ModeGroup, ...]
    left_out: tuple[str, ...]
    uncertain: InputError | None = None

    @property
    def places(self) -> list[slice]:
        """Of each group among the rows of all."""
        ends = np.cumsum([len(group.measured) for group in self.groups])
        return [slice(end - len(group.measured), end) for group, end in zip(self.groups, ends, strict=True)]

    @property
    def rows(self) -> list[int]:
        return [j for group in self.groups for j in group.measured]


def _group_partners(x: _Comparison, partner: dict[int, int]) -> _Grouping:
    mates = _mates(x.clusters, partner, x.known, x.measured, x.computed, x.computed_hz) if x.planes else {}
    criterion = np.array(x.criterion)
    for j, k in mates.items():
        criterion[j, [partner[j], k]] = share_within(x.measured[:, j], x.computed[:, [partner[j], k]])
    groups, unlike = _clusters_above_least_mac(x, partner, mates, criterion)
    halves = _halves_note(x.where, mates, partner, x.name, x.computed_hz)
    return _Grouping(partner=partner, criterion=criterion, groups=tuple(groups), left_out=(*halves, *unlike))


def _choose_pairing(x: _Comparison, partner: dict[int, int], n_used: int, prior_cov, *, refuse: bool) -> _Grouping:
    """The most probable pairing; unless it is for a picture, without what is uncertain or improbable in it."""
    found, others = _pair_groups(x, partner, n_used, prior_cov)
    if not refuse:
        return found
    return _drop_unreachable(x, _keep_certain(x, found, others, n_used) if others else found, n_used, prior_cov)


def _pair_groups(
    x: _Comparison, partner: dict[int, int], n_used: int, prior_cov
) -> tuple[_Grouping, list[tuple[ModeGroup, np.ndarray]]]:
    """The pairing by shapes, or one about as alike that the frequencies make ODDS times as probable, group by group;
    and others (`_alternatives`) where neither is, or what is chosen is improbable itself. The prior, which takes
    derivatives, is asked where shapes leave two."""
    cov = None
    # each step changes a group for the better
    for _ in range(2 * len(x.name)):
        found = _group_partners(x, partner)
        others = _alternatives(x, found) if len(found.rows) >= 0.5 * n_used else []
        if not others or prior_cov is None:
            break
        cov = prior_cov() if cov is None else cov
        (own, probable), *density = [_log_density(x, found, column, cov) for column in
                                     ([found.partner[j] for j in found.rows], *(column for _, column in others))]
        best = int(np.argmax([value for value, _ in density]))
        if density[best][0] > own + np.log(ODDS):
            partner = partner | dict(zip(found.rows, map(int, others[best][1]), strict=True))
            continue
        others = [other for other, (value, _) in zip(others, density, strict=True)
                  if not (probable and own > value + np.log(ODDS))]
        break
    return found, others


def _keep_certain(x: _Comparison, found: _Grouping, others: Sequence[tuple[ModeGroup, np.ndarray]],
             n_used: int) -> _Grouping:
    """Without the groups that another choice pairs differently. Raises InputError where more than half of the modes are
    such, or one alone is left: too little to know the structure by."""
    column = np.array([found.partner[j] for j in found.rows], int)
    same = [all(set(other[here]) == set(column[here]) for _, other in others) for here in found.places]
    rest = tuple(group for group, stays in zip(found.groups, same, strict=True) if stays)
    error = _ambiguous_pairing_error(x, found, *others[0])
    if sum(len(group.measured) for group in rest) < max(2.0, 0.5 * n_used):
        raise error
    names = " and ".join(x.name[j] for j in sorted({*found.rows}.difference(*(group.measured for group in rest))))
    return replace(found, groups=rest, uncertain=error,
                   left_out=(*found.left_out, f"{names} in {x.where}: {error.problem}; "
                               f"{error.remedy.removesuffix(OR_NULL)}"))


def _drop_unreachable(x: _Comparison, found: _Grouping, n_used: int,
                  prior_cov: Callable[[], np.ndarray] | None) -> _Grouping:
    """Without groups that the prior cannot bring where they were measured: a mode that the model shows to the sensors
    only once it is unsymmetric, as a platform's heave, has another mode's shape there. Where these are most, it is the
    prior that is no good, and all stay."""
    order = [i for group in found.groups for i in group.computed]
    off = np.log(x.measured_hz[found.rows] / x.computed_hz[order])
    away = np.abs(off - np.median(off)) if len(off) else off
    if prior_cov is None or not np.any(away > APART):
        return found
    share = np.abs(off) / np.sqrt(np.diag(prior_cov())[order] + MODEL_ERROR**2)
    beyond = (away > APART) & (share > IMPROBABLE)
    rest = tuple(g for g, here in zip(found.groups, found.places, strict=True) if not np.any(beyond[here]))
    if not np.any(beyond) or sum(len(group.measured) for group in rest) < max(2.0, 0.5 * n_used):
        return found
    said = [f"{x.name[j]} in {x.where}: the computed mode of like shape is at {x.computed_hz[i]:.4g} Hz, "
            f"{z:.0f} prior standard deviations from the measured {x.measured_hz[j]:.4g} Hz"
            for j, i, z, out in zip(found.rows, order, share, beyond, strict=True) if out]
    return replace(found, groups=rest, left_out=(*found.left_out, *said))


def _log_density(x: _Comparison, found: _Grouping, column: Sequence[int], cov: np.ndarray) -> tuple[float, bool]:
    """Of the measured ln f by the prior, paired in each group in their order; and whether they are probable at all: a
    prior by which they are not is none to judge by."""
    order = np.concatenate([np.sort(np.asarray(column)[place]) for place in found.places])
    off = np.log(x.measured_hz[found.rows] / x.computed_hz[order])
    spread = np.linalg.cholesky(cov[np.ix_(order, order)] + MODEL_ERROR**2 * np.eye(len(order)))
    chi2, n = float(np.sum(np.linalg.solve(spread, off) ** 2)), len(order)
    return -0.5 * chi2 - float(np.sum(np.log(np.diag(spread)))), chi2 <= n + IMPROBABLE * np.sqrt(2 * n)


def _is_far_off(x: _Comparison, found: _Grouping) -> np.ndarray:
    """(n_measured, n_computed) of bool: another mode's by its frequency, beside the one that a measured mode is paired
    with; of modes compared as a plane the nearest counts."""
    off = np.abs(np.log(x.measured_hz[:, None] / x.computed_hz))
    far = np.zeros(off.shape, bool)
    for group in found.groups:
        away = np.min(off[list(group.measured)], axis=0)
        for j in group.measured:
            far[j] = away > away[found.partner[j]] + APART
            far[j, found.partner[j]] = False
    return far


def _alternatives(x: _Comparison, found: _Grouping) -> list[tuple[ModeGroup, np.ndarray]]:
    """Groups that another choice pairs with other computed modes for less than CLEAR a mode in summed MACs, each with
    the computed mode of every row of that choice."""
    rows, places, visible = found.rows, found.places, np.linalg.norm(x.computed, axis=0)
    score = np.nan_to_num(np.where(_is_far_off(x, found), -1.0, found.criterion)[rows], nan=-1.0)
    column = np.array([found.partner[j] for j in rows], int)
    best = _assignment_sum(x, found, score, column)
    result = []
    for group, here in zip(found.groups, places, strict=True):
        for i in group.computed:
            # a mate instead of its own is no other choice
            blocked = [i, *group.mates]
            # a mode that hardly moves the channels has a shape there by chance
            trial = np.where(visible < SEEN * visible[i], -1.0, score)
            trial[:, column] = score[:, column]
            trial[here, blocked] = -1.0
            # the others as they please, and as they are
            alone = np.full(trial.shape, -1.0)
            alone[np.arange(len(rows)), column] = score[np.arange(len(rows)), column]
            alone[here] = trial[here]
            alone[here, np.delete(column, here)] = -1.0
            for choice in (trial, alone):
                other = _linked_changes(here, column, _with_planes(x, found, choice, assign(choice)), places)
                # which member of a group has which of its modes is no difference
                changed = max(1, sum(len(set(other[g]) - set(column[g])) for g in places))
                loss = (best - _assignment_sum(x, found, choice, other)) / changed
                if loss < CLEAR and set(other[here]) - set(group.computed):
                    result.append((group, other))
    return result


def _linked_changes(here: slice, column: np.ndarray, other: np.ndarray, places: Sequence[slice]) -> np.ndarray:
    """`other` for the rows `here` and all that passed-on modes link with them; a change elsewhere is no price
    of theirs."""
    linked, modes = [here], {*column[here], *other[here]}
    while more := [p for p in places if p not in linked and modes & {*column[p], *other[p]}]:
        linked += more
        modes.update(*(column[p] for p in more), *(other[p] for p in more))
    rows = np.concatenate([np.arange(len(column))[p] for p in linked])
    return np.where(np.isin(np.arange(len(column)), rows), other, column)


def _assignment_sum(x: _Comparison, found: _Grouping, score: np.ndarray, column: np.ndarray) -> float:
    """Sum of criteria of the rows with these computed modes, of pairs together."""
    total = 0.0
    for group, here in zip(found.groups, found.places, strict=True):
        own = score[np.arange(here.start, here.stop), column[here]]
        pair = x.together.get(group.measured)
        total += float(own.sum() if pair is None or own.min() < 0 else pair[tuple(column[here])])
    return total


def _with_planes(x: _Comparison, found: _Grouping, choice: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The computed mode of every row, of pairs the two free ones that are best together."""
    result = np.array(column)
    for group, here in zip(found.groups, found.places, strict=True):
        pair = x.together.get(group.measured)
        free = [i for i in range(choice.shape[1]) if np.all(choice[here, i] >= 0) and i not in np.delete(result, here)]
        if pair is not None and len(free) > 1:
            result[here] = max(permutations(free, 2), key=lambda two: pair[two])
    return result


def _ambiguous_pairing_error(x: _Comparison, found: _Grouping, group: ModeGroup, other: np.ndarray) -> InputError:
    """Of a group that two choices pair differently, as found and with the computed mode `other` of every row."""
    where, name, measured, frequency_hz = x.where, x.name, x.measured, x.computed_hz
    score = np.nan_to_num(found.criterion[found.rows], nan=0.0)
    column = np.array([found.partner[j] for j in found.rows], int)
    choices = column, other
    differ = [(g, p) for g, p in zip(found.groups, found.places, strict=True) if set(other[p]) != set(column[p])]
    names = [" and ".join(name[m] for m in one.measured) for one, _ in differ]
    own = " and ".join(name[m] for m in group.measured)

    def choice_words(choice, here) -> str:
        return " and ".join(f"mode {choice[r] + 1} at {frequency_hz[choice[r]]:.4g} Hz with MAC "
                            f"{max(score[r, choice[r]], 0.0):.2f}" for r in range(here.start, here.stop))

    remedy = f"measure where their shapes differ, narrow the prior if more is known{OR_NULL}"
    chosen = frequency_hz[[c for _, here in differ for c in column[here]]]
    if len(differ) > 1 and len(chosen) == len(differ) and np.ptp(chosen) < PAIR_GAP * np.mean(chosen):
        # a close pair that is compared mode by mode
        remedy = f"compare close modes as planes (--shapes plane), {remedy}"
    if len(differ) == 1:
        alone = len(group.measured) == 1
        found = (" and " if alone else ", or ").join(choice_words(choice, differ[0][1]) for choice in choices)
        return InputError(f"{where}, {own}", f"two computed modes match it about as well, {found}", remedy)
    found = ", or ".join(
        "; ".join(f"{n} as {choice_words(choice, here)}" for n, (_, here) in zip(names, differ, strict=True))
        for choice in choices)
    rows = [m for one, _ in differ for m in one.measured]
    known = np.all(np.isfinite(measured[:, rows]), axis=1)
    alike = mac(measured[known][:, rows], measured[known][:, rows]) - np.eye(len(rows))
    if alike.max() >= SAME:
        a, b = (name[rows[k]] for k in np.unravel_index(np.argmax(alike), alike.shape))
        return InputError(f"{where}, {a} and {b}", f"their measured shapes are the same (MAC {alike.max():.2f}), "
                          f"so that two pairings match about as well: {found}", "check that they are two different "
                          f"modes, or {remedy}")
    return InputError(f"{where}, {own}", f"two pairings with the model match about as well: {found}", remedy)
