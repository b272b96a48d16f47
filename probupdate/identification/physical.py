"""Physical modes of a campaign: poles that come back over model orders and blocks, clustered without any model.

In a block, poles of all orders are gathered by average linkage in frequency and shape (`scipy.cluster.hierarchy`;
Magalhaes, Cunha & Caetano 2009, Online automatic identification of the modal parameters of a long span arch bridge).
Over the campaign, what was gathered is clustered by density (Ester, Kriegel, Sander & Xu 1996, DBSCAN): a mode is a
place in frequency and shape that many blocks have something at, each counted by its share of the model orders. So a
mode at few orders of every block is found as well as one at all orders of a few; the number of modes is not given. The
shapes of a close pair turn in their plane with noise and with the nacelle, a chain that density follows: what such a
cluster spans is the plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from probupdate.errors import InputError
from probupdate.identification.classification import (
    STEADY,
    ClassifierSettings,
    PoleStack,
    frequency_bound,
    is_within,
)
from probupdate.identification.reference import ReferenceModes, heading_of_motion, shapes_along_axes
from probupdate.identification.settings import CONSTANTS
from probupdate.modal.modes import Sensor, mac, rotate_to_real, subspace_mac
from probupdate.runtime.arrays import frozen_array

# one mode at several orders of a block: frequency within 1 % and MAC of 0.9, or a sum of shares of both
TWIN_FREQUENCY, TWIN_MAC = CONSTANTS.twin_frequency, CONSTANTS.twin_mac
NEAR_FREQUENCY, NEAR_MAC = CONSTANTS.near_frequency, CONSTANTS.near_mac
LARGEST_SPREAD = CONSTANTS.largest_spread
LARGEST_JUMP = CONSTANTS.largest_jump
# damping ratio of a line: welded steel without soil, water or cladding has five times as much
OF_A_LINE = 2e-4
# MAC from which two directions of so few channels are one: by chance in one of 15 to 40
ALIKE_OF_FEW = {1: 1.1, 2: 0.99, 3: 0.95}
SAME_MODE, DOUBLE = CONSTANTS.same_mode, CONSTANTS.double
PLANE_SHARE, IN_PLANE = CONSTANTS.plane_share, CONSTANTS.in_plane
APART_MAC = CONSTANTS.apart_mac
CLOSE = CONSTANTS.close
FOLLOWS, BY_CHANCE = CONSTANTS.follows, CONSTANTS.by_chance
WAVE_WIDTH, WAVE_DAMPING = CONSTANTS.wave_width, CONSTANTS.wave_damping
CORE = CONSTANTS.core
# blocks that are clustered at most; more are taken evenly over the campaign, state by state
MOST_BLOCKS = 720


@dataclass(frozen=True, kw_only=True)
class PersistenceSettings:
    """When a cluster is a mode: its blocks' shares of model orders sum up to `weight` + `share` times the blocks, of
    all blocks or of those of one turbine state that has at least `least_blocks`. One block alone asks 0.7 of its
    orders; of a day's 48, eleven blocks at half of the orders each do, or twice as many at a quarter. least_share: of a
    block's orders that count at all."""

    weight: float = 0.60
    share: float = 0.10
    least_share: float = 0.12
    least_blocks: int = 12

    def __post_init__(self):
        for name in ("weight", "share", "least_share"):
            if not 0 < getattr(self, name) <= 1:
                raise InputError(name, f"{getattr(self, name)} is not in (0, 1]", "give a share")

    def needed_blocks(self, n_block: int) -> float:
        return self.weight + self.share * n_block


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidates:
    """What comes back over the orders of a block, or of many: block (n,) its number, ln_frequency, damping (n,), shape
    (n_channel, n) of unit length, share (n,) of the block's orders."""

    block: np.ndarray
    ln_frequency: np.ndarray
    damping: np.ndarray
    shape: np.ndarray
    share: np.ndarray

    def select(self, rows: np.ndarray) -> Candidates:
        return Candidates(block=self.block[rows], ln_frequency=self.ln_frequency[rows], damping=self.damping[rows],
                          shape=self.shape[:, rows], share=self.share[rows])


def block_candidates(
    poles: PoleStack, number: int, classifier: ClassifierSettings, settings: PersistenceSettings
) -> Candidates:
    """One block's poles of all orders, gathered by average linkage; the distance is 1 for 1 % of frequency, or for a
    MAC of 0.9."""
    good = (poles.damping_ratio > classifier.damping[0]) & (poles.damping_ratio < classifier.damping[1])
    good &= np.sum(np.abs(poles.shape) ** 2, axis=0) > 0
    ln_frequency, damping = np.log(poles.frequency_hz[good]), poles.damping_ratio[good]
    shape, order = poles.shape[:, good], poles.order[good]
    shape = shape / np.linalg.norm(shape, axis=0)
    if len(order) > 1:
        distance = np.abs(ln_frequency[:, None] - ln_frequency) / TWIN_FREQUENCY
        distance += (1 - np.abs(shape.conj().T @ shape) ** 2).clip(min=0) / (1 - TWIN_MAC)
        np.fill_diagonal(distance, 0)
        label = fcluster(linkage(squareform(distance, checks=False), "average"), 1.0, "distance")
    else:
        label = np.ones(len(order), int)
    n_order, found = max(len(poles.orders), 1), []
    for one in np.unique(label):
        mine = np.flatnonzero(label == one)
        share = len(set(order[mine])) / n_order
        if share < settings.least_share:
            continue
        middle = np.median(ln_frequency[mine])
        inner = mine[np.argmin(np.abs(ln_frequency[mine] - middle))] if len(mine) < 3 else None
        direction = shape[:, inner] if inner is not None else leading_direction(shape[:, mine])
        found.append((middle, np.median(damping[mine]), direction, share))
    found = _pairs_whole(_without_doubles(found), ln_frequency, shape, order, n_order)
    n = len(found)
    return Candidates(
        block=np.full(n, number), ln_frequency=np.array([f[0] for f in found]), damping=np.array([f[1] for f in found]),
        shape=np.array([f[2] for f in found], complex).reshape(n, len(poles.shape)).T,
        share=np.array([f[3] for f in found]),
    )


def _without_doubles(found: list[tuple]) -> list[tuple]:
    """Without poles of noise that have a strong mode's direction, or lie in a pair's plane, beside it: at half of its
    orders or fewer. The second bending of a turbine had nine of them a block, over a fifth of its frequency. Asked only
    where there are channels enough that a direction is no chance."""
    kept: list[tuple] = []
    for one in sorted(found, key=lambda x: -x[3]):
        strong = [x[2] for x in kept if x[3] >= 2 * one[3] and abs(x[0] - one[0]) <= DOUBLE][:2]
        if not strong or len(one[2]) < len(strong) + 3 \
                or subspace_mac(one[2], np.column_stack(strong))[0] < IN_PLANE:
            kept.append(one)
    return kept


def _pairs_whole(
    found: list[tuple], ln_frequency: np.ndarray, shape: np.ndarray, order: np.ndarray, n_order: int
) -> list[tuple]:
    """The two of a close pair turn in their plane from order to order, so that each direction has a part of the orders
    only: two candidates of one plane have the share of the orders at which two poles lie in it, side by side, and
    others in the plane are parts of them."""
    left, result = sorted(found, key=lambda x: -x[3]), []
    while left:
        first, *left = left
        near = [x for x in left if abs(x[0] - first[0]) <= CLOSE and abs(np.vdot(x[2], first[2])) ** 2 < APART_MAC]
        mate = near[0] if near and len(first[2]) >= 4 else None
        if mate is None:
            result.append(first)
            continue
        plane = np.column_stack([first[2], mate[2]])
        middle = 0.5 * (first[0] + mate[0])
        inside = np.flatnonzero(np.abs(ln_frequency - middle) <= CLOSE)
        basis = np.linalg.qr(plane)[0]
        inside = inside[np.sum(np.abs(basis.conj().T @ shape[:, inside]) ** 2, axis=0) >= IN_PLANE]
        two = 0
        for one in np.unique(order[inside]):
            here = shape[:, inside[order[inside] == one]]
            two += here.shape[1] > 1 and np.min(np.abs(here.conj().T @ here)) ** 2 < APART_MAC
        share = two / n_order
        if share <= mate[3]:
            result.append(first)
            continue
        result += [(*first[:3], max(first[3], share)), (*mate[:3], share)]
        left = [x for x in left if x is not mate
                and (abs(x[0] - middle) > CLOSE or np.sum(np.abs(basis.conj().T @ x[2]) ** 2) < IN_PLANE)]
    return result


def gather_candidates(parts: Sequence[Candidates]) -> Candidates:
    return Candidates(
        block=np.concatenate([p.block for p in parts]), share=np.concatenate([p.share for p in parts]),
        ln_frequency=np.concatenate([p.ln_frequency for p in parts]),
        damping=np.concatenate([p.damping for p in parts]),
        shape=np.concatenate([p.shape for p in parts], axis=1))


def leading_direction(shape: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """(n_channel,) unit vector nearest to all columns; their signs and phases do not matter."""
    return _directions(shape, weight)[0][:, 0]


def _directions(shape: np.ndarray, weight: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n_channel, n), strongest first, and their shares (n,) of the squared columns."""
    scaled = shape if weight is None else shape * np.sqrt(weight)
    value, vector = np.linalg.eigh(scaled @ scaled.conj().T)
    return vector[:, ::-1], value[::-1].clip(min=0) / max(value.sum(), 1e-300)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Cluster:
    """rows: its candidates; basis (n_channel, 1 or 2) real or complex directions; weight: sum of shares."""

    rows: np.ndarray
    basis: np.ndarray
    ln_frequency: float
    damping: float
    weight: float

    @property
    def plane(self) -> bool:
        return self.basis.shape[1] > 1


def _clusters(c: Candidates, core: float) -> list[np.ndarray]:
    """Rows of each density cluster: candidates with neighbours of at least the summed share `core`, connected; others
    go with their heaviest neighbour of that kind, or nowhere."""
    n = len(c.block)
    if n == 0:
        return []
    rising = np.argsort(c.ln_frequency, kind="stable")
    f, shape, share = c.ln_frequency[rising], c.shape[:, rising].astype(np.complex64), c.share[rising]
    end = np.searchsorted(f, f + NEAR_FREQUENCY, side="right")
    # millions of pairs
    pairs = []
    for k in range(0, n, 256):
        rows, last = np.arange(k, min(k + 256, n)), end[min(k + 256, n) - 1]
        alike = np.abs(shape[:, rows].conj().T @ shape[:, k:last]) ** 2 >= NEAR_MAC
        columns = np.arange(k, last)
        alike &= (columns > rows[:, None]) & (columns < end[rows][:, None])
        i, j = np.nonzero(alike)
        pairs.append(np.array([rows[i], columns[j]], np.int32))
    i, j = np.hstack(pairs)
    del pairs
    density = share + np.bincount(i, share[j], n) + np.bincount(j, share[i], n)
    dense = density >= core
    both = dense[i] & dense[j]
    graph = sparse.coo_matrix((np.ones(both.sum(), bool), (i[both], j[both])), shape=(n, n))
    label = np.where(dense, sparse.csgraph.connected_components(graph, directed=False)[1], -1)
    best = np.full(n, -1.0)
    for a, b in ((i, j), (j, i)):
        edge = ~dense[a] & dense[b]
        for x, y in zip(a[edge], b[edge], strict=True):
            if density[y] > best[x]:
                best[x], label[x] = density[y], label[y]
    return [rising[np.flatnonzero(label == one)] for one in np.unique(label[label >= 0])]


def _split_cluster(c: Candidates, rows: np.ndarray) -> list[np.ndarray]:
    """A cluster as it is, or in two where its blocks have two poles at once of one direction, which few channels do not
    distinguish: two modes that poles between them, of orders too low for both, have joined."""
    inside = c.select(rows)
    share = _directions(inside.shape, inside.share)[1]
    if len(inside.shape) > 2 and share[1] >= PLANE_SHARE:
        return [rows]
    pairs, blocks = [], np.unique(inside.block)
    for k in blocks:
        strong = np.flatnonzero((inside.block == k) & (inside.share >= 0.25))
        places = np.sort(inside.ln_frequency[strong[np.argsort(-inside.share[strong], kind="stable")[:2]]])
        if len(places) == 2 and places[1] - places[0] > TWIN_FREQUENCY:
            pairs.append(places)
    if len(pairs) < max(2, 0.3 * len(blocks)):
        return [rows]
    low, high = np.median(pairs, axis=0)
    if high - low <= TWIN_FREQUENCY:
        return [rows]
    below = inside.ln_frequency < 0.5 * (low + high)
    return [*_split_cluster(c, rows[below]), *_split_cluster(c, rows[~below])]


@dataclass(frozen=True, eq=False, kw_only=True)
class PhysicalModes:
    """modes: the persistent ones, '1', '2', ... ascending in frequency, pairs as planes, with their ranges; notes: what
    was left out, or is uncertain, and why. weight (n_mode,): summed shares of the orders over the blocks that were
    clustered; damping_ratio (n_mode,): median; rows: of each mode its candidates."""

    modes: ReferenceModes
    weight: np.ndarray
    damping_ratio: np.ndarray
    notes: tuple[str, ...]
    rows: tuple[np.ndarray, ...] = ()

    def select(self, chosen: Sequence[int]) -> PhysicalModes:
        """The modes numbered `chosen`, renumbered."""
        chosen = [int(k) for k in chosen]
        return replace(self, modes=self.modes.select(chosen, number=True), weight=frozen_array(self.weight[chosen]),
                       damping_ratio=frozen_array(self.damping_ratio[chosen]), rows=tuple(self.rows[k] for k in chosen))


def physical_modes(
    candidates: Candidates, *, n_block: int, settings: PersistenceSettings | None = None,
    state: Sequence[str] | None = None, bands: Sequence[np.ndarray] | None = None,
    wave_hz: Sequence[float] | None = None, angle_deg: Sequence[float] | None = None, sensors: tuple[Sensor, ...] = (),
    block_seconds: float = 1800.0, highest_hz: float = np.inf, where: str = "campaign",
) -> PhysicalModes:
    """Modes out of what comes back in `n_block` blocks.

    state: the turbine's in each block, so that a mode of one state is found too; bands: (n_harmonic, 2) Hz that
    multiples of the rotor's speed swept in each: what moves with them is left out; where they pass in nearly every
    block a line is indistinguishable from a mode, which is said. wave_hz: the waves' peak in each block, NaN where it
    was not measured; what lies there, damped as a sea is, is left out. angle_deg: where the nacelle looked,
    counter-clockwise from x; a pair of horizontal motions is then taken to turn with it. highest_hz: the end of the
    band that the record's rate passes. Raises InputError where nothing comes back.
    """
    settings = settings or PersistenceSettings()
    notes: list[str] = []
    state = list(state) if state is not None else [""] * n_block
    bands = list(bands) if bands is not None else [np.zeros((0, 2))] * n_block
    if len(candidates.block) == 0:
        raise _no_modes_error(where, n_block)
    persistence = _Persistence.from_settings(settings, state, n_block, block_seconds)
    swept, always = _rotor_swept(candidates, bands)
    found = persistence.clusters(candidates, np.flatnonzero(~swept | always))
    lines: list[_Cluster] = []
    for cluster in sorted(persistence.clusters(candidates, np.flatnonzero(swept & ~always)),
                          key=lambda x: x.ln_frequency):
        if not any(abs(cluster.ln_frequency - one.ln_frequency) <= SAME_MODE for one in (*found, *lines)):
            lines.append(cluster)
    notes += [f"{np.exp(one.ln_frequency):.3f} Hz moves with the rotor's speed and is not a mode: left out"
              for one in lines]
    notes += [f"{np.exp(one.ln_frequency):.3f} Hz lies where multiples of the rotor's speed pass in nearly every "
              "block: it may be its line" for one in sorted(found, key=lambda x: x.ln_frequency)
              if swept[one.rows].mean() > FOLLOWS]
    found = _structural_clusters(candidates, found, wave_hz, highest_hz, notes)
    angle = np.array(angle_deg, float) if angle_deg is not None else None
    groups, doubles = _group_clusters(candidates, found, block_seconds,
                                      turns=angle is not None and bool(np.isfinite(angle).any()))
    notes += [f"{np.exp(one.ln_frequency):.3f} Hz has the shape of {np.exp(twin.ln_frequency):.3f} Hz and appears in "
              "few of its blocks or model orders: a duplicate of that mode, that mode after a change, or one of its "
              "own that these channels see alike (`probupdate explore` picks it); left out"
              for one, twin in doubles]
    if not groups:
        raise _no_modes_error(where, n_block)
    for hz, damping in sorted((np.exp(group[0].ln_frequency), group[0].damping) for group in groups):
        # what lasts longer than a block has a damping of chance, on either side of none
        if damping < max(OF_A_LINE, 1 / (2 * np.pi * hz * block_seconds)):
            notes.append(f"{hz:.3f} Hz has a damping of {100 * damping:.2g} %, as no structure has or as blocks of "
                         f"{block_seconds:.4g} s do not tell from none: perhaps a machine's line, also one folded from "
                         "above half the sampling rate; look at it as a mode with care")
    return _build_modes(candidates, groups, angle, sensors, tuple(notes))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Persistence:
    """What a cluster must show to be a mode: state (n_block,) of the turbine, blocks of each state that has enough of
    them, and the least weight `core` of a place where one may lie."""

    settings: PersistenceSettings
    state: list[str]
    count: dict[str, int]
    core: float
    n_block: int
    block_seconds: float

    @classmethod
    def from_settings(
        cls, settings: PersistenceSettings, state: list[str], n_block: int, block_seconds: float
    ) -> _Persistence:
        count = {name: state.count(name) for name in set(state) - {"mixed", "unknown", ""}}
        count = {name: n for name, n in count.items() if n >= settings.least_blocks}
        core = CORE * min(settings.needed_blocks(n) for n in [n_block, *count.values()])
        return cls(settings=settings, state=state, count=count, core=core, n_block=n_block, block_seconds=block_seconds)

    def clusters(self, candidates: Candidates, rows: np.ndarray) -> list[_Cluster]:
        """Of these candidates the clusters that come back often enough, over all blocks or over those of one state, and
        stay where they are."""
        found = []
        clusters = _clusters(candidates.select(rows), self.core)
        for mine in [part for one in clusters for part in _split_cluster(candidates.select(rows), one)]:
            inside = candidates.select(rows[mine])
            weight = _block_weight(inside, self.n_block)
            if (self.is_persistent(weight) and np.count_nonzero(weight) >= min(2, self.n_block - 1)
                    and _is_steady(inside, self.block_seconds)):
                found.append(_cluster(candidates, rows[mine], float(weight.sum())))
        return found

    def is_persistent(self, weight: np.ndarray) -> bool:
        return bool(weight.sum() >= self.settings.needed_blocks(self.n_block)) or any(
            weight[[one == name for one in self.state]].sum() >= self.settings.needed_blocks(n)
            for name, n in self.count.items())


def _structural_clusters(
    c: Candidates, clusters: list[_Cluster], wave_hz: Sequence[float] | None, highest_hz: float, notes: list[str]
) -> list[_Cluster]:
    """Without the waves' own, and what lies above the band that the rate passes; both are noted."""
    waves = [one for one in clusters if _is_of_waves(c, one, wave_hz)]
    notes += [f"{np.exp(one.ln_frequency):.3f} Hz lies at the waves' peak of its blocks, with a damping of "
              f"{100 * one.damping:.1f} %: taken for waves, left out" for one in waves]
    above = [one for one in clusters if np.exp(one.ln_frequency) > highest_hz]
    notes += [f"{np.exp(one.ln_frequency):.4g} Hz lies above the {highest_hz:.4g} Hz that the analysis rate resolves: "
              "left out; use a higher --rate" for one in above]
    return [one for one in clusters if all(one is not x for x in (*waves, *above))]


def _no_modes_error(where: str, n_block: int) -> InputError:
    return InputError(f"{where}, modes", f"no pole is stable over the model orders and the {n_block} blocks",
                      "give another order, or a sampling rate that covers the modes")


def _block_weight(inside: Candidates, n_block: int) -> np.ndarray:
    """(n_block,) share of the orders that have the cluster; parts of one mode in one block add up to 1 at most."""
    return np.minimum(np.bincount(inside.block, inside.share, n_block), 1.0)


def _cluster(c: Candidates, rows: np.ndarray, weight: float) -> _Cluster:
    basis, share = _directions(c.shape[:, rows], c.share[rows])
    dimension = 2 if len(share) > 1 and len(c.shape) > 2 and share[1] >= PLANE_SHARE else 1
    return _Cluster(rows=rows, basis=basis[:, :dimension], ln_frequency=float(np.median(c.ln_frequency[rows])),
                    damping=float(np.median(c.damping[rows])), weight=weight)


def _is_steady(inside: Candidates, block_seconds: float) -> bool:
    """Whether a cluster's frequency is one of a structure, which neither wanders far nor jumps from block to block, as
    a wave's period does; asked of five blocks or more. What a record can show at best is the Cramer-Rao bound."""
    if np.ptp(np.quantile(inside.ln_frequency, [0.1, 0.9])) > LARGEST_SPREAD:
        return False
    blocks = np.unique(inside.block)
    if len(blocks) < 5 or len(inside.shape) < 3:
        return True
    # of one direction: the two of a pair have each their own frequency
    best = [mine[np.argmax(inside.share[mine])] for mine in (np.flatnonzero(inside.block == k) for k in blocks)]
    steps = []
    for a, b in pairwise(best):
        alike = mac(inside.shape[:, [a]], inside.shape[:, inside.block == inside.block[b]])[0]
        if alike.max() >= NEAR_MAC:
            mate = np.flatnonzero(inside.block == inside.block[b])[np.argmax(alike)]
            steps.append(inside.ln_frequency[mate] - inside.ln_frequency[a])
    return stays(np.array(steps), np.exp(np.median(inside.ln_frequency)), np.median(inside.damping), block_seconds)


def stays(steps: np.ndarray, frequency_hz: float, damping: float, block_seconds: float) -> bool:
    """Whether steps of ln f from one block to the next are those of a mode; so few that nothing is known are."""
    if len(steps) < 4:
        return True
    scatter = 1.4826 * np.median(np.abs(steps)) / np.sqrt(2)
    return bool(scatter <= max(LARGEST_JUMP, STEADY * frequency_bound(damping, frequency_hz, block_seconds)))


def _is_of_waves(c: Candidates, cluster: _Cluster, wave_hz: Sequence[float] | None) -> bool:
    if wave_hz is None or cluster.damping < WAVE_DAMPING:
        return False
    peak = np.array(wave_hz, float)[c.block[cluster.rows]]
    there = np.isfinite(peak) & (peak > 0)
    away = np.abs(c.ln_frequency[cluster.rows][there] - np.log(peak[there]))
    return bool(there.any() and np.mean(away <= WAVE_WIDTH) >= FOLLOWS)


def _rotor_swept(c: Candidates, bands: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(n,) bool: candidates where multiples of the rotor's speed were in their block; and those whose frequency these
    sweep in nearly every block, so that being there says nothing."""
    swept = np.array([bool(is_within(np.exp(x)[None], bands[k])[0]) if len(bands[k]) else False
                      for x, k in zip(c.ln_frequency, c.block, strict=True)])
    known = [b for b in bands if len(b)]
    if not known:
        return swept, swept
    chance = np.mean([is_within(np.exp(c.ln_frequency), b) for b in known], axis=0)
    return swept, chance > BY_CHANCE


def _is_in_plane(a: _Cluster, plane: np.ndarray) -> bool:
    return bool(subspace_mac(a.basis, plane).min() >= IN_PLANE)


def _group_clusters(
    c: Candidates, clusters: list[_Cluster], block_seconds: float, turns: bool
) -> tuple[list[list[_Cluster]], list[tuple[_Cluster, _Cluster]]]:
    """Clusters of one mode or one pair together, heaviest first: a mode that moved, a plane's directions; and those
    that are doubles of a heavier one, with that one.

    What has the direction of a heavier one, or lies in its plane, and half its weight at most is its double, from noise
    or from waves; so has what does not keep its distance to it from block to block, as a mode does, however often it
    comes back, and that is asked of two and three channels too, whose directions alone say little. What shares hardly a
    block with a heavier one is the same mode before or after a change; further off, in a run of blocks that the heavier
    one is not in, it is kept, for `joined_modes` to say. turns: where a nacelle looks is known.
    """
    groups: list[list[_Cluster]] = []
    doubles: list[tuple[_Cluster, _Cluster]] = []
    for one in sorted(_with_planes(c, clusters, turns), key=lambda x: -x.weight):
        home, twin = None, None
        for group in groups:
            first = group[0]
            away = min(abs(one.ln_frequency - other.ln_frequency) for other in group)
            if away <= DOUBLE and _strays(c, one, first, block_seconds):
                twin = first
                break
            known = len(one.basis) >= one.basis.shape[1] + first.basis.shape[1] + 2
            if away > DOUBLE or not known or not _is_in_plane(one if first.plane else first, first.basis if first.plane
                                                              else one.basis):
                continue
            if away <= SAME_MODE and (first.plane or one.plane or _are_apart_in_time(c, one, first)):
                home = group
                break
            if one.weight < 0.5 * first.weight and not one.plane and not _takes_its_place(c, first, one):
                twin = first
                break
        if home is not None:
            home.append(one)
        elif twin is not None:
            doubles.append((one, twin))
        else:
            groups.append([one])
    return groups, doubles


def _strays(c: Candidates, one: _Cluster, heavy: _Cluster, block_seconds: float) -> bool:
    """Whether a cluster has the direction of a heavier one and lies here and there beside it: its distance in ln f
    scatters over their common blocks by more than four times what a record of two modes shows at best (the Cramer-Rao
    bound). Temperature moves both, and drops out."""
    alike = ALIKE_OF_FEW.get(len(one.basis), IN_PLANE)
    if one.plane or heavy.plane or mac(one.basis, heavy.basis)[0, 0] < alike:
        return False
    own, other = ({int(c.block[k]): c.ln_frequency[k] for k in x.rows[np.argsort(c.share[x.rows], kind="stable")]}
                  for x in (one, heavy))
    away = np.array([own[k] - other[k] for k in sorted(own.keys() & other.keys())])
    bound = np.hypot(*(frequency_bound(x.damping, np.exp(x.ln_frequency), block_seconds) for x in (one, heavy)))
    # from block to block: a mode that moves slowly, or once, stays one
    return len(away) > 1 and bool(1.4826 * np.median(np.abs(np.diff(away))) > np.sqrt(2) * STEADY * bound)


def _with_planes(c: Candidates, clusters: list[_Cluster], turns: bool) -> list[_Cluster]:
    """Three or more single directions of one plane close by, never three at once, as of a pair at a few headings of
    the nacelle, as one cluster with that plane; or, where a nacelle turns, two of one frequency and different times."""
    left = sorted(clusters, key=lambda x: -x.weight)
    result = [one for one in left if one.plane]
    left = [one for one in left if not one.plane]
    while left:
        first, *others = left
        near = [x for x in others if abs(x.ln_frequency - first.ln_frequency) <= SAME_MODE]
        members = [first]
        for mate in near:
            if mac(first.basis, mate.basis)[0, 0] >= 0.5 or len(first.basis) < 4:
                continue
            plane = np.column_stack([first.basis, mate.basis])
            inside = [x for x in near if x is mate or (
                _is_in_plane(x, plane) and _are_apart_in_time(c, x, first, mate))]
            # or of one mode that turned with the nacelle, at two headings
            turned = (turns and abs(mate.ln_frequency - first.ln_frequency) <= TWIN_FREQUENCY
                      and _are_apart_in_time(c, mate, first))
            if len(inside) >= 2 or turned:
                members += inside
                break
        if len(members) > 1:
            rows = np.concatenate([one.rows for one in members])
            joined = _cluster(c, rows, sum(one.weight for one in members))
            result.append(replace(joined, basis=_directions(c.shape[:, rows], c.share[rows])[0][:, :2]))
        else:
            result.append(first)
        left = [one for one in left if all(one is not x for x in members)]
    return result


def _are_apart_in_time(c: Candidates, light: _Cluster, *heavy: _Cluster) -> bool:
    """Whether few of a cluster's blocks have all of the heavier ones too."""
    blocks = [set(c.block[one.rows].tolist()) for one in (light, *heavy)]
    return len(set.intersection(*blocks)) <= 0.2 * len(blocks[0])


def _takes_its_place(c: Candidates, heavy: _Cluster, light: _Cluster) -> bool:
    """Whether it comes in some blocks on end in which the heavier one hardly is."""
    blocks, others = np.unique(c.block[light.rows]), np.unique(c.block[heavy.rows])
    between = (others >= blocks[0]) & (others <= blocks[-1])
    return len(blocks) > 1 and bool(between.sum() <= 0.2 * len(blocks))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Mode:
    """One mode to be: its candidates, a real direction (n_channel,) and the mate's number in a pair, -1 for none."""

    rows: np.ndarray
    shape: np.ndarray
    mate: int = -1
    turns: bool = False


def _build_modes(
    c: Candidates, groups: list[list[_Cluster]], angle: np.ndarray | None, sensors: tuple[Sensor, ...],
    notes: tuple[str, ...],
) -> PhysicalModes:
    modes: list[_Mode] = []
    for group in groups:
        rows = np.concatenate([one.rows for one in group])
        plane = next((one for one in group if one.plane), None)
        if plane is None:
            direction = leading_direction(c.shape[:, rows], c.share[rows])
            modes.append(_Mode(rows=rows, shape=_real_shape(direction[:, None])[:, 0]))
            continue
        basis = _real_shape(_directions(c.shape[:, rows], c.share[rows])[0][:, :2])
        turns = angle is not None and bool(np.isfinite(angle[c.block[rows]]).any())
        axes = shapes_along_axes(basis, sensors) if turns else None
        shapes, parts = (_resolve_by_nacelle(c, rows, axes, angle) if axes is not None
                         else _resolve_by_frequency(c, rows, basis))
        n = len(modes)
        modes += [_Mode(rows=parts[k], shape=shapes[:, k], mate=n + 1 - k, turns=axes is not None) for k in range(2)]
    return _number_modes(c, modes, notes)


def modes_from_groups(c: Candidates, groups: Sequence[np.ndarray], notes: tuple[str, ...]) -> PhysicalModes:
    """Modes of which it is stated which candidates (rows) each consists of, such as poles that were picked by hand."""
    return _number_modes(c, [_Mode(rows=rows, shape=_real_shape(leading_direction(c.shape[:, rows])[:, None])[:, 0])
                             for rows in groups], notes)


def _real_shape(shape: np.ndarray) -> np.ndarray:
    real = np.real(rotate_to_real(shape))
    return real / np.linalg.norm(real, axis=0)


def _resolve_by_nacelle(c, rows, axes, angle) -> tuple[np.ndarray, list[np.ndarray]]:
    """A pair named by direction: fore-aft where the nacelle looked, side-side across; shapes for a nacelle along x."""
    way = heading_of_motion(c.shape[:, rows], axes)
    turn = np.nan_to_num(np.radians(angle[c.block[rows]]))
    fore = np.abs(np.cos(way - turn)) >= np.abs(np.sin(way - turn))
    parts = [rows[fore], rows[~fore]]
    return axes, [part if len(part) else rows for part in parts]


def _resolve_by_frequency(c: Candidates, rows: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """A pair whose directions are fixed: the lower and the higher pole of blocks that have both show them."""
    lower, higher = [], []
    for k in np.unique(c.block[rows]):
        here = rows[c.block[rows] == k]
        if len(here) < 2:
            continue
        two = sorted(here[np.argsort(-c.share[here], kind="stable")[:2]], key=lambda x: c.ln_frequency[x])
        if mac(c.shape[:, [two[0]]], c.shape[:, [two[1]]])[0, 0] < 0.5:
            lower.append(two[0])
            higher.append(two[1])
    shapes = basis
    if lower:
        own = _real_shape(np.column_stack([leading_direction(c.shape[:, part]) for part in (lower, higher)]))
        shapes = basis if mac(own[:, :1], own[:, 1:])[0, 0] > 0.8 else own
    alike = mac(c.shape[:, rows], shapes)
    first = alike[:, 0] >= alike[:, 1]
    parts = [rows[first], rows[~first]]
    return shapes, [part if len(part) else rows for part in parts]


def _number_modes(c: Candidates, modes: list[_Mode], notes: tuple[str, ...]) -> PhysicalModes:
    middle = np.array([np.median(c.ln_frequency[m.rows]) for m in modes])
    damping = np.array([np.median(c.damping[m.rows]) for m in modes])
    rising = np.argsort(middle, kind="stable")
    place = {int(old): new for new, old in enumerate(rising)}
    mates = [(place[k], place[m.mate]) for k, m in enumerate(modes) if m.mate >= 0]
    pairs = {(min(pair), max(pair)) for pair in mates}
    turning = tuple((place[k], place[m.mate]) for k, m in enumerate(modes) if m.turns and m.mate > k)
    frequency = np.exp(middle[rising])
    shape = np.column_stack([modes[k].shape for k in rising])
    pairs |= _close_singles(frequency, damping[rising], {i for pair in pairs for i in pair}, len(shape))
    edges = np.array([np.quantile(c.ln_frequency[modes[k].rows], [0.02, 0.98]) for k in rising])
    for i, j in pairs:
        edges[[i, j]] = min(edges[i, 0], edges[j, 0]), max(edges[i, 1], edges[j, 1])
    reference = ReferenceModes(
        labels=tuple(str(k + 1) for k in range(len(modes))), frequency_hz=frequency,
        shape=shape / np.abs(shape).max(axis=0), pairs=tuple(sorted(pairs)), turning=turning, range_hz=np.exp(edges))
    weight = np.array([np.sum(c.share[modes[k].rows]) for k in rising])
    return PhysicalModes(modes=reference, weight=frozen_array(weight), damping_ratio=frozen_array(damping[rising]),
                         notes=notes, rows=tuple(modes[k].rows for k in rising))


def _close_singles(frequency, damping, taken: set[int], n_channel: int) -> set[tuple[int, int]]:
    """Neighbours so close that records turn them in their plane, closest first, each mode in one pair; two channels
    have no plane that says anything."""
    if n_channel < 3:
        return set()
    gap, pairs = np.diff(np.log(frequency)), set()
    for k in np.argsort(gap):
        if gap[k] <= max(CLOSE, damping[k] + damping[k + 1]) and not {k, k + 1} & taken:
            pairs.add((int(k), int(k) + 1))
            taken |= {int(k), int(k) + 1}
    return pairs


def even_blocks(state: Sequence[str], most: int = MOST_BLOCKS) -> list[int]:
    """Numbers of at most about `most` blocks, ascending, evenly over the campaign and each state by its share, but of
    every state at least 48 where it has them."""
    if len(state) <= most:
        return list(range(len(state)))
    chosen: list[int] = []
    for name in dict.fromkeys(state):
        mine = [k for k, one in enumerate(state) if one == name]
        count = min(len(mine), max(48, round(most * len(mine) / len(state))))
        chosen += [mine[int(i)] for i in np.linspace(0, len(mine) - 1, count)]
    return sorted(set(chosen))


