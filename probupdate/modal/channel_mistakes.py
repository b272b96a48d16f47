"""Which one exchange of two channels, one reversed channel, or other order of all would make measured shapes a
model's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import gammaln

from probupdate.evidence.directions import choose_explanations, log_evidence
from probupdate.modal.matching import assign, close_clusters
from probupdate.modal.sets import ModalSet
from probupdate.modal.shape_criteria import mac, rotate_to_real, subspace_mac

# probabilities before, of a reversed channel, of an exchange and of another order among all, of a channel that moves by
# something of its own (its place, a motion that the model lacks): over that of channels as they should be
REVERSED, EXCHANGED, REORDERED, OWN_MOTION = 0.2, 0.1, 0.01, 0.01
# a model's errors are alike in its modes: each counts for so much of one by itself
INDEPENDENT = 0.7
# turns in which order and signs of the modes are found
TURNS = 3
# more candidates than so many are no explanation
MOST_CANDIDATES = 3
# a mode is none of the model's whose frequency is so many times its own, or so little of it, beside what all are off by
# together (a unit, a stiffness of all): four times the stiffness
FARTHEST = 2.0
# every pair of so many channels is tried; of more, pairs of those whose components are farthest from the model's
MOST_CHANNELS = 48


@dataclass(frozen=True, eq=False, kw_only=True)
class ComputedModes:
    """A model's modes: shapes (n_channel, n_mode) at the measured channels, frequencies (n_mode,) in Hz."""

    shape: np.ndarray
    frequency_hz: np.ndarray


@dataclass(frozen=True, kw_only=True)
class ChannelMistake:
    """A change of the measured channels with which shapes are the model's: candidates, one or two names each (a
    reversed channel, or two exchanged), the best first, others explain as much, or all names in the order in which
    they fit; mac_before, mac_after: means over the modes."""

    candidates: tuple[tuple[str, ...], ...]
    mac_before: float
    mac_after: float

    @property
    def whole_order(self) -> bool:
        """Whether it is the order of all channels."""
        return len(self.candidates[0]) > 2

    @property
    def sentence(self) -> str:
        first, *others = (_mistake_text(c) for c in self.candidates)
        also = f" (or {' or '.join(others)}, which explains as much)" if others else ""
        return (f"{first}{also} would explain it: the mean MAC of the modes would be {self.mac_after:.2f} instead of "
                f"{self.mac_before:.2f}")

    @property
    def remedy(self) -> str:
        if self.whole_order:
            return "check the order of `channels`, and correct it"
        if len(self.candidates[0]) == 1:
            return (f"check its sign at {self.candidates[0][0]}; if it is reversed, say so where the model reads it "
                    "(direction of its [[sensor]] in model.toml; channel_sign, or its row of channel_row times -1, in "
                    "a model of matrices), or give it the "
                    "factor -1 in convert.toml, convert into a new folder and identify again")
        return (f"check which cable is whose at {' and '.join(self.candidates[0])}; if they are exchanged, exchange "
                "the two names in `channels` of the modes' file, and in convert.toml, [columns], for other records")


def _mistake_text(channels: tuple[str, ...]) -> str:
    if len(channels) == 1:
        return f"channel {channels[0]} with the opposite sign"
    return f"channels {' and '.join(channels)} exchanged" if len(channels) == 2 else (
        f"the channels in another order ({', '.join(channels)})")


def channel_mistake(
    modal_set: ModalSet, channels: Sequence[str], computed: Sequence[ComputedModes]
) -> ChannelMistake | None:
    """computed: modes of one model at one or more parameters. A change
    is named where it, or few that explain as much, is as good as certain beside channels as they should be and beside
    one that moves by something of its own, whatever the model's error (`evidence.directions`); else None."""
    shape, clusters, frequency = _real_shapes(modal_set)
    if shape.shape[1] < 2 or len(channels) < 3:
        return None
    best: tuple[float, ChannelMistake] | None = None
    for modes in computed:
        tried = _changes(shape, clusters, tuple(channels), _comparable(modes, frequency))
        choice = choose_explanations([t.log for t in tried], [t.channels != () for t in tried])
        if not choice or len(choice) > MOST_CANDIDATES:
            continue
        first = tried[choice[0]]
        if best is None or first.log > best[0]:
            best = first.log, ChannelMistake(candidates=tuple(tried[k].channels for k in choice),
                                             mac_before=tried[0].mac, mac_after=first.mac)
    return best and best[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Comparable:
    """Shapes of a model (n_channel, n_mode), and ln of their frequencies over the measured ones (n, n_mode)."""

    shape: np.ndarray
    ratio: np.ndarray


def _comparable(modes: ComputedModes, frequency_hz: np.ndarray) -> _Comparable:
    ratio = np.log(np.maximum(modes.frequency_hz, 1e-300) / frequency_hz[:, None])
    return _Comparable(shape=modes.shape, ratio=ratio)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Change:
    """log: ln probability up to a constant; mac: mean over the modes; order (n_channel,) of the rows; channels: their
    names, none where nothing is named."""

    log: float
    mac: float
    order: np.ndarray
    channels: tuple[str, ...] = ()


def _changes(shape, clusters, channels: tuple[str, ...], model: _Comparable) -> list[_Change]:
    """Every change, the first: none."""
    as_is = np.arange(len(channels))

    def judge(changed: np.ndarray, odds: float, names=(), order=as_is, own: int | None = None) -> _Change:
        log, mean = _evidence(changed[order], clusters, model, own)
        return _Change(log=log + np.log(odds), mac=mean, order=order, channels=names)

    n, pairs = len(channels), list(combinations(_channels_tried(shape, clusters, model), 2))
    found = [judge(shape, 1.0)]
    for i in as_is:
        found += [judge(_reverse_channel(shape, i), REVERSED / n, (channels[i],)), judge(shape, OWN_MOTION / n, own=i)]
    found += [judge(shape, EXCHANGED / len(pairs), (channels[i], channels[j]), _exchange_channels(as_is, i, j))
              for i, j in pairs]

    def ordered(order: np.ndarray) -> _Change:
        names = tuple(channels[k] for k in np.argsort(order))
        return judge(shape, REORDERED * np.exp(-gammaln(n + 1)), names, order)

    # an order is found where none beside it, with two more exchanged, explains as much
    orders, best, last = {}, ordered(_order(shape, model.shape)), None
    while best.log > found[0].log and best is not last:
        last = best
        orders |= {c.channels: c for c in (best, *(ordered(_exchange_channels(best.order, i, j)) for i, j in pairs))}
        best = max(orders.values(), key=lambda c: c.log)
    # one exchange is no other order
    return found + [c for c in orders.values() if np.sum(c.order != as_is) > 2]


def _evidence(shape, clusters, model, own: int | None = None) -> tuple[float, float]:
    """ln evidence that every mode is one of the model's own, channel `own` aside, and the mean MAC."""
    rank = np.array([len(next(c for c in clusters if j in c)) for j in range(shape.shape[1])])
    n, part = np.sum(np.isfinite(shape), axis=0), np.ones(len(rank))
    if own is not None:
        part -= np.nan_to_num(shape[own]) ** 2 / np.nansum(shape**2, axis=0)
        rank = rank + np.isfinite(shape[own])
        shape = shape.copy()
        shape[own] = np.nan
    _, value = _best_pairing(shape, clusters, model)
    log = log_evidence(part * (1 - value), n, rank, count=INDEPENDENT)
    return float(log), float(np.mean(value))


def shape_agreement(modal_set: ModalSet, computed: ComputedModes) -> float:
    """Mean MAC of the set's modes, each with one of the computed ones of its own; NaN where none has three
    components."""
    shape, clusters, frequency = _real_shapes(modal_set)
    if not shape.shape[1]:
        return float("nan")
    return float(np.mean(_best_pairing(shape, clusters, _comparable(computed, frequency))[1]))


def signed_comac(modal_set: ModalSet, computed: ComputedModes) -> np.ndarray:
    """How each channel (n_channel,) moves with the computed shapes over all modes: the cosine of
    its measured and its computed components, -1 of a reversed channel; its square is the coordinate MAC (Lieven &
    Ewins 1988). Each mode counts alike, a close pair is fitted within its plane. NaN where nothing moves."""
    shape, clusters, frequency = _real_shapes(modal_set)
    column, _ = _best_pairing(shape, clusters, _comparable(computed, frequency))
    computed = computed.shape
    dot, own, other = (np.zeros(len(shape)) for _ in range(3))
    for members in clusters:
        columns = [column[j] for j in members if column[j] < computed.shape[1]]
        there = np.all(np.isfinite(shape[:, members]), axis=1)
        if len(columns) < len(members) or there.sum() <= len(members):
            continue
        a = shape[there][:, members] / np.linalg.norm(shape[there][:, members], axis=0)
        b = computed[there][:, columns] @ np.linalg.lstsq(computed[there][:, columns], a, rcond=None)[0]
        dot[there] += np.sum(a * b, axis=1)
        own[there] += np.sum(a**2, axis=1)
        other[there] += np.sum(b**2, axis=1)
    scale = np.sqrt(own * other)
    return np.divide(dot, scale, out=np.full(len(shape), np.nan), where=scale > 0)


def _real_shapes(modal_set: ModalSet) -> tuple[np.ndarray, list[list[int]], np.ndarray]:
    """Real shapes (n_channel, n) of the modes that have three components and move, which of them are close, and their
    frequencies (n,) in Hz."""
    shape = np.real(rotate_to_real(modal_set.shape))
    used = [j for j in range(shape.shape[1]) if modal_set.measured[j] and np.isfinite(shape[:, j]).sum() > 2
            and np.nanmax(np.abs(shape[:, j])) > 0]
    clusters = [[used.index(j) for j in c if j in used] for c in close_clusters(modal_set.frequency_hz)]
    return shape[:, used], [c for c in clusters if c], np.asarray(modal_set.frequency_hz)[used]


def _order(shape: np.ndarray, model: np.ndarray) -> np.ndarray:
    """(n_channel,) all channels in the order in which each moves most as its name does in the model, the modes paired
    as they stand in both: where shapes are a model's by nothing but their order, the lowest modes are the lowest."""
    n = min(shape.shape[1], model.shape[1])
    unit = [np.nan_to_num(a[:, :n]) / np.maximum(np.linalg.norm(np.nan_to_num(a[:, :n]), axis=0), 1e-300)
            for a in (shape, model)]
    order = assign(np.abs(unit[1]) @ np.abs(unit[0]).T)
    for _ in range(TURNS):
        sign = np.sign(np.sum(unit[0][order] * unit[1], axis=0))
        order = assign((unit[1] * sign) @ unit[0].T)
    return order


def _exchange_channels(order: np.ndarray, i: int, j: int) -> np.ndarray:
    changed = order.copy()
    changed[[i, j]] = order[[j, i]]
    return changed


def _reverse_channel(shape: np.ndarray, channel: int) -> np.ndarray:
    changed = shape.copy()
    changed[channel] *= -1
    return changed


def _best_pairing(shape, clusters, model: _Comparable) -> tuple[np.ndarray, np.ndarray]:
    """Of each measured mode (n,) the column of the model's, n_mode or more where it has none, and their MAC."""
    n, n_mode = shape.shape[1], model.shape.shape[1]
    criterion = np.zeros((n, max(n, n_mode)))
    for members in clusters:
        own = shape[:, members]
        criterion[members, :n_mode] = mac(own, model.shape) if len(members) == 1 else subspace_mac(model.shape, own)
    criterion = np.nan_to_num(criterion)
    paired = assign(criterion)
    own = paired < n_mode
    together = np.median(model.ratio[own, paired[own]]) if own.any() else 0.0
    criterion[:, :n_mode][np.abs(model.ratio - together) > np.log(FARTHEST)] = 0.0
    column = assign(criterion)
    return column, criterion[np.arange(n), column]


def _channels_tried(shape, clusters, model) -> list[int]:
    """Channels whose exchange is tried."""
    if len(shape) <= MOST_CHANNELS:
        return list(range(len(shape)))
    column, _ = _best_pairing(shape, clusters, model)
    away = np.zeros(len(shape))
    for j, i in enumerate(column):
        if i < model.shape.shape[1]:
            a, b = np.nan_to_num(shape[:, j]), model.shape[:, i]
            scaled = b * (a @ b) / max(b @ b, 1e-300)
            away += (a - scaled) ** 2 / max(a @ a, 1e-300)
    return sorted(np.argsort(-away)[:MOST_CHANNELS])
