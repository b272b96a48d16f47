"""Modes of interest without a model: poles that come back over model orders and blocks, named by number."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from probupdate.errors import InputError
from probupdate.identification.block_poles import BlockPoles
from probupdate.identification.classification import ClassifierSettings, within
from probupdate.identification.reference import ReferenceModes
from probupdate.modes import frozen_array, mac, rotate_to_real, subspace_mac

# one mode at several orders of a block: frequency within 1 %, MAC of 0.9
TWIN_FREQUENCY, TWIN_MAC = 0.01, 0.90
# one mode in several blocks: it may drift by 4 %, and of a close pair turn in its plane: any direction there has a MAC
# of at least 0.5 with one of two perpendicular ones
SAME_FREQUENCY, SAME_MAC = 0.04, 0.50
# two modes closer than this are told by their plane, and a third that lies in it is one of them turned
CLOSE, IN_PLANE = 0.05, 0.90
# what comes back is a line of the rotor if so large a share of its members lies where multiples of the rotor's speed
# were in those blocks, and its own frequency lies there in at most so large a share of all blocks
FOLLOWS, BY_CHANCE = 0.9, 0.7


@dataclass(frozen=True, kw_only=True)
class UnlabelledSettings:
    """least_orders: share of a block's model orders that must have a mode; least_blocks: share of the blocks; most:
    at most so many modes, those found in most blocks."""

    least_orders: float = 0.5
    least_blocks: float = 0.25
    most: int = 12

    def __post_init__(self):
        for name in ("least_orders", "least_blocks"):
            if not 0 < getattr(self, name) <= 1:
                raise InputError(name, f"{getattr(self, name)} is not in (0, 1]", "give a share")
        if self.most < 1:
            raise InputError("most", f"{self.most} modes are none", "give 1 or more")


@dataclass(frozen=True, eq=False, kw_only=True)
class _Cluster:
    frequency_hz: list[float]
    shape: list[np.ndarray]
    block: list[int]
    in_band: list[bool]

    @property
    def centre_hz(self) -> float:
        return float(np.median(self.frequency_hz))

    @property
    def direction(self) -> np.ndarray:
        """(n_channel,) leading direction of the members' shapes: signs and phases of members do not matter."""
        return np.linalg.svd(np.column_stack(self.shape), full_matrices=False)[0][:, 0]


def unlabelled_modes(
    blocks: Iterable[BlockPoles], *, classifier: ClassifierSettings, settings: UnlabelledSettings | None = None,
    bands_of: Callable[[BlockPoles], np.ndarray] | None = None,
) -> tuple[ReferenceModes, tuple[str, ...]]:
    """Modes '1', '2', ... ascending in frequency, from blocks in the order of time; close ones stand as pairs. And what
    is to be said of the rotor's lines among them.

    bands_of: (n_harmonic, 2) Hz that multiples of the rotor's speed swept in a block. What moves with them is left out;
    where the rotor hardly changes its speed a line cannot be told from a mode, and this is said. Raises InputError
    where nothing comes back.
    """
    settings = settings or UnlabelledSettings()
    clusters: list[_Cluster] = []
    swept: list[np.ndarray] = []
    for block in blocks:
        if block.poles is None:
            continue
        bands = np.zeros((0, 2)) if bands_of is None else bands_of(block)
        for frequency, shape in block_modes(block, classifier, settings.least_orders):
            _join(clusters, frequency, shape, len(swept), bool(within(np.array([frequency]), bands)[0]))
        swept.append(bands)
    used = len(swept)
    clusters, said = _without_lines(clusters, swept, max(settings.least_blocks * used, 1))
    kept = sorted((c for c in clusters if len(set(c.block)) >= max(settings.least_blocks * used, 1)),
                  key=lambda c: -len(c.block))  # fmt: skip
    kept = sorted(_without_turned(kept)[: settings.most], key=lambda c: c.centre_hz)
    if not kept:
        raise InputError("modes without a model", f"no pole comes back in {100 * settings.least_blocks:g} % of "
                         f"{used} blocks", "give a model, other orders, or a rate that holds the modes")
    frequency = np.array([c.centre_hz for c in kept])
    shape = rotate_to_real(np.column_stack([c.direction for c in kept])).real
    return _numbered(frequency, shape / np.abs(shape).max(axis=0)), said


def _numbered(frequency: np.ndarray, shape: np.ndarray) -> ReferenceModes:
    return ReferenceModes(labels=tuple(str(k + 1) for k in range(len(frequency))), frequency_hz=frozen_array(frequency),
                          shape=frozen_array(shape), pairs=_pairs(frequency))  # fmt: skip


def only(modes: ReferenceModes, chosen: np.ndarray) -> ReferenceModes:
    """The modes numbered `chosen`, numbered anew."""
    return _numbered(modes.frequency_hz[chosen], modes.shape[:, chosen])


def _without_lines(
    clusters: list[_Cluster], swept: list[np.ndarray], least: float
) -> tuple[list[_Cluster], tuple[str, ...]]:
    """Clusters that do not move with the rotor, and sentences on those that do, or may."""
    kept, lines, doubted = [], [], []
    known = [bands for bands in swept if len(bands)]
    for cluster in clusters:
        told = [inside for inside, block in zip(cluster.in_band, cluster.block, strict=True) if len(swept[block])]
        if not told or np.mean(told) < FOLLOWS:
            kept.append(cluster)
            continue
        centre = np.array([cluster.centre_hz])
        chance = np.mean([within(centre, bands)[0] for bands in known])
        often = len(set(cluster.block)) >= least
        if chance <= BY_CHANCE:
            lines += [cluster] if often else []
        else:
            kept.append(cluster)
            doubted += [cluster] if often else []
    said = []
    for found, words in ((lines, "moves with the rotor's speed and is no mode: left out"),
                         (doubted, "lies at a multiple of the rotor's speed, which hardly varies: it may be its line")):
        said += [f"{cluster.centre_hz:.3f} Hz {words}" for cluster in sorted(found, key=lambda c: c.centre_hz)]
    return kept, tuple(said)


def block_modes(
    block: BlockPoles, classifier: ClassifierSettings, least_orders: float
) -> list[tuple[float, np.ndarray]]:
    """Frequency and shape (n_channel,) of what comes back in a block at enough orders, most often first."""
    every = (block.poles, *block.others)
    order = np.repeat([p.order for p in every], [len(p.frequency_hz) for p in every])
    frequency = np.concatenate([p.frequency_hz for p in every])
    damping = np.concatenate([p.damping_ratio for p in every])
    shape = np.concatenate([p.shape for p in every], axis=1)
    left = (damping > classifier.damping[0]) & (damping < classifier.damping[1])
    alike = (mac(shape, shape) >= TWIN_MAC) & (np.abs(np.log(frequency / frequency[:, None])) <= TWIN_FREQUENCY)
    found = []
    while left.any():
        twins = alike & left
        count = np.array([len(set(order[row])) if left[k] else 0 for k, row in enumerate(twins)])
        best = int(np.argmax(count))
        if count[best] < least_orders * len(every):
            break
        members = np.flatnonzero(twins[best])
        middle = members[np.argmin(np.abs(frequency[members] - np.median(frequency[members])))]
        found.append((float(np.median(frequency[members])), shape[:, middle] / np.linalg.norm(shape[:, middle])))
        left &= ~twins[best]
    return found


def _join(clusters: list[_Cluster], frequency: float, shape: np.ndarray, block: int, in_band: bool) -> None:
    """To the most similar cluster that has none of this block yet, or to a new one."""
    best, similar = None, SAME_MAC
    for cluster in clusters:
        if block in cluster.block[-3:] or abs(np.log(frequency / cluster.frequency_hz[-1])) > SAME_FREQUENCY:
            continue
        value = float(mac(shape, cluster.shape[-1])[0, 0])
        if value >= similar:
            best, similar = cluster, value
    if best is None:
        best = _Cluster(frequency_hz=[], shape=[], block=[], in_band=[])
        clusters.append(best)
    best.frequency_hz.append(frequency)
    best.shape.append(shape)
    best.block.append(block)
    best.in_band.append(in_band)


def _without_turned(clusters: list[_Cluster]) -> list[_Cluster]:
    """Clusters, most frequent first, without those that lie in the space of more frequent ones close by."""
    kept: list[_Cluster] = []
    for cluster in clusters:
        near = [c.direction for c in kept if abs(np.log(c.centre_hz / cluster.centre_hz)) <= CLOSE]
        if near and subspace_mac(cluster.direction, np.column_stack(near))[0] >= IN_PLANE:
            continue
        kept.append(cluster)
    return kept


def _pairs(frequency_hz: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Neighbours closer than CLOSE, closest first, each mode in one pair."""
    gap = np.diff(np.log(frequency_hz))
    pairs: list[tuple[int, int]] = []
    for k in np.argsort(gap):
        if gap[k] <= CLOSE and not {k, k + 1} & {i for pair in pairs for i in pair}:
            pairs.append((int(k), int(k) + 1))
    return tuple(sorted(pairs))
