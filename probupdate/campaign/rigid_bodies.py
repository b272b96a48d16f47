"""Rigid parts inferred from where sensors are, and gains that break them.

Sensors at one height, at one place, or in one cross-section of something long may be fixed to one rigid body: six
motions explain what they all see, whatever their directions. Whether they are is asked of the data: only if one change
of gain, of one channel or of channels with something in common, leaves next to nothing unexplained is the part taken as
rigid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.campaign.sensor_findings import ALIKE, SIGMA, SensorFinding, std_left_out
from probupdate.modal.modes import Sensor

# gap between parts: this share of the extent along the axis, or of the distances across it
GAP_SHARE, GAP_ACROSS = 0.02, 0.1
# a part is rigid if six motions leave less than this share of what its sensors see
RIGID_SHARE = 0.006
# another change explains the records as well if it leaves less than this many times as much
DISTINCT = 1.5
# a change is taken if it leaves less than this share of what was unexplained; in the end the part must be rigid
LEAST_MENDED = 0.8
# directions in which sensors see less than this of a motion give no information on it
LEAST_SEEN = 1e-3


@dataclass(frozen=True, kw_only=True)
class Group:
    """Channels (indices) that may be wrong together, with what they have in common in `words`."""

    members: tuple[int, ...]
    words: str


@dataclass(frozen=True, eq=False, kw_only=True)
class WrongGain:
    """gain: as recorded over what the rigid part says, std its standard deviation; members (indices) of the channels;
    alternatives: groups that explain it as well, with their gains; share: unexplained before and after."""

    members: tuple[int, ...]
    words: str
    gain: float
    std: float
    alternatives: tuple[tuple[tuple[int, ...], float], ...]
    share: tuple[float, float]


def rigid_candidates(
    sensors: Sequence[Sensor], axes: Sequence[int] | None = None, *, alone: bool = False
) -> list[tuple[int, ...]]:
    """Sets of sensors that may be fixed to one rigid body, by their positions: those between gaps along the vertical,
    and along a horizontal axis of something more than twice as long as wide and high (or `axes`). Largest first, each
    set once, `alone`: single sensors too."""
    position = np.array([s.position_m for s in sensors], float)
    extent = np.ptp(position, axis=0)
    axes = axes or [2] + [k for k in (0, 1) if extent[k] > 2 * max(extent[j] for j in range(3) if j != k)]
    found: dict[tuple[int, ...], None] = {}
    for axis in axes:
        across = float(np.linalg.norm(np.delete(extent, axis)))
        gap = max(GAP_SHARE * extent[axis], min(GAP_ACROSS * across, 0.1 * extent[axis]), 1e-6)
        order = np.argsort(position[:, axis], kind="stable")
        ends = np.flatnonzero(np.diff(position[order, axis]) > gap) + 1
        for part in np.split(order, ends):
            if len(part) > 1 or alone:
                found[tuple(sorted(int(i) for i in part))] = None
    return sorted(found, key=len, reverse=True)


def levelled(sensors: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """The same with levels named by the sensors' heights: those without a gap between them are one. The names that a
    campaign gives them group channels in reports, and may stand for a whole tower."""
    of: dict[int, str] = {}
    for members in rigid_candidates(sensors, axes=(2,), alone=True) if sensors else ():
        height = float(np.mean([sensors[i].position_m[2] for i in members]))
        of |= dict.fromkeys(members, f"{height:.6g} m")
    return tuple(replace(s, level=of[i]) for i, s in enumerate(sensors))


def same_place(sensors: Sequence[Sensor], members: Sequence[int]) -> list[tuple[int, ...]]:
    """Of `members` those that sit at one place, two or more."""
    extent = max(float(np.linalg.norm(np.ptp([s.position_m for s in sensors], axis=0))), 1e-9)
    left, found = list(members), []
    while left:
        here = [i for i in left if np.linalg.norm(sensors[i].position_m - sensors[left[0]].position_m) < 1e-3 * extent]
        left = [i for i in left if i not in here]
        found += [tuple(here)] if len(here) > 1 else []
    return found


def rigid_motions(sensors: Sequence[Sensor]) -> np.ndarray:
    """(n_channel, 6) what sensors see of a rigid body's three displacements and three rotations."""
    position = np.array([s.position_m for s in sensors], float)
    direction = np.array([s.direction for s in sensors], float)
    arm = position - position.mean(axis=0)
    size = max(float(np.sqrt(np.mean(np.sum(arm**2, axis=1)))), 1e-9)
    return np.hstack([direction, np.cross(arm / size, direction)])


def natural_groups(sensors: Sequence[Sensor], members: Sequence[int]) -> list[Group]:
    """Channels that may share a logger or a unit: every one alone, those at one place, those of one quantity or
    unit."""
    groups = [Group(members=(i,), words="") for i in members]
    groups += [Group(members=g, words="at one place") for g in same_place(sensors, members)]
    for key in ("quantity", "unit"):
        values = dict.fromkeys(getattr(sensors[i], key, "") for i in members)
        if len(values) > 1:
            groups += [Group(members=tuple(i for i in members if getattr(sensors[i], key, "") == v), words=f"{key} {v}")
                       for v in values]
    unique = {g.members: g for g in reversed(groups) if len(g.members) < len(members)}
    return [g for g in groups if unique.get(g.members) is g]


def wrong_gains(
    samples: np.ndarray, sensors: Sequence[Sensor], groups: Sequence[Group], *, most: int = 3
) -> tuple[list[WrongGain], float]:
    """What breaks one rigid part, and the share that stays unexplained (1 where nothing is redundant).

    samples (n_sample, n_channel) real or complex: shapes, or square roots of covariances, in one quantity; each sample
    has one vote. A group's gain is that which leaves least beyond the six motions, its standard deviation that over
    samples left out in turn, the gains of sound sensors (1 %) and the part's own flexibility (the root of what stays
    unexplained) added in squares. It is reported beyond four standard deviations, if the part is rigid with it. Of a
    group and all others by the inverse, which nothing distinguishes, the smaller is taken; alternatives are groups that
    leave about as little.
    """
    samples = np.asarray(samples)
    size = np.linalg.norm(samples, axis=1)
    samples = samples[size > 0] / size[size > 0, None]
    motion = rigid_motions(sensors)
    scale = np.sqrt(np.mean(np.abs(samples) ** 2, axis=0)) if len(samples) else np.zeros(len(sensors))
    if not len(samples) or np.any(scale == 0):
        return [], 1.0
    beyond = beyond_motions(motion)
    if np.trace(beyond) < 0.5:
        return [], 1.0
    first = _share(beyond, samples)
    taken, share = _taken(beyond, samples, groups, most)
    if not taken or share > RIGID_SHARE:
        return [], first
    found = []
    for (group, close), gain, spread in zip(taken, *_gains_and_errors(beyond, samples, taken), strict=True):
        std = float(np.sqrt(spread**2 + gain**2 * (ALIKE**2 + share)))
        if abs(gain - 1) < SIGMA * std:
            continue
        complement = set(range(len(sensors))) - set(group.members)
        # what the changes taken make together is no alternative to one of them
        alternatives = tuple((t[1].members, float(t[2])) for t in close if set(t[1].members) != complement
                             and _independent([*(g for g, _ in taken), t[1]], len(sensors)))
        found.append(WrongGain(members=group.members, words=group.words, gain=float(gain), std=std,
                               alternatives=alternatives, share=(first, share)))
    return found, share


# a group that is taken to have a wrong gain, and those that explain it about as well: share left, group, gain
_Taken = tuple[Group, list[tuple[float, Group, float]]]


def _taken(beyond: np.ndarray, samples: np.ndarray, groups: Sequence[Group], most: int) -> tuple[list[_Taken], float]:
    """Up to `most` groups, one after the other, each the one that leaves least; and the share left with all of them."""
    n_channel = samples.shape[1]
    share, factor = _share(beyond, samples), np.ones(n_channel)
    taken: list[_Taken] = []
    while len(taken) < most and share > RIGID_SHARE / 100:
        now = samples / factor
        tried = []
        for group in groups:
            if not _independent([*(g for g, _ in taken), group], n_channel):
                continue
            gain = _best_gain(beyond, now, group.members)
            if gain is None or abs(gain) < 1e-3:
                continue
            changed = np.array(factor)
            changed[list(group.members)] *= gain
            tried.append((_share(beyond, samples / changed), group, gain))
        if not tried:
            break
        # of about equal ones the fewest channels
        least = min(t[0] for t in tried)
        close = [t for t in tried if t[0] <= DISTINCT * least]
        left, group, _ = min(close, key=lambda t: (len(t[1].members), t[0]))
        if left > LEAST_MENDED * share:
            break
        taken.append((group, [t for t in close if t[1] is not group]))
        factor = np.ones(n_channel)
        for (one, _), value in zip(taken, _together(beyond, samples, [g for g, _ in taken]), strict=True):
            factor[list(one.members)] *= value
        share = _share(beyond, samples / factor)
    return taken, share


def _gains_and_errors(beyond: np.ndarray, samples: np.ndarray, taken: Sequence[_Taken]):
    """Gains of the groups taken, together, and their standard deviations over samples left out in turn (n_taken,)."""
    groups, n = [g for g, _ in taken], len(samples)
    gains = _together(beyond, samples, groups)
    every = np.array([_together(beyond, np.delete(samples, k, axis=0), groups) for k in range(n)])
    return gains, std_left_out(every) if n > 2 else np.abs(gains)


def _independent(groups: Sequence[Group], n_channel: int) -> bool:
    """Whether no group's gain is made by those of the others."""
    chosen = np.array([[i in g.members for i in range(n_channel)] for g in groups], float)
    return int(np.linalg.matrix_rank(chosen)) == len(groups)


def _together(beyond: np.ndarray, samples: np.ndarray, groups: Sequence[Group]) -> np.ndarray:
    """(n_group,) gains that together leave least, each found anew beside the others until they settle."""
    gains = np.ones(len(groups))
    for _ in range(30):
        before = gains.copy()
        for k, group in enumerate(groups):
            factor = np.ones(len(beyond))
            for j, other in enumerate(groups):
                if j != k:
                    factor[list(other.members)] *= gains[j]
            gains[k] = _best_gain(beyond, samples / factor, group.members) or 1.0
        if np.allclose(gains, before, rtol=1e-6):
            break
    return gains


def beyond_motions(motion: np.ndarray) -> np.ndarray:
    """(n, n) projector on what none of the motions (n, 6) makes."""
    left, value, _ = np.linalg.svd(motion, full_matrices=False)
    left = left[:, value > LEAST_SEEN * value[0]]
    return np.eye(len(motion)) - left @ left.T


def _share(beyond: np.ndarray, samples: np.ndarray) -> float:
    """Unexplained share, each sample of one size."""
    rest = np.sum(np.abs(samples @ beyond) ** 2, axis=1)
    return float(np.mean(rest / np.maximum(np.sum(np.abs(samples) ** 2, axis=1), 1e-300)))


def _best_gain(beyond: np.ndarray, samples: np.ndarray, members: Sequence[int]) -> float | None:
    """By what the members must be divided to leave least: a quadratic's minimum; None where nothing redundant sees
    them."""
    rows = list(members)
    others = [i for i in range(len(beyond)) if i not in rows]
    own = np.einsum("si,ij,sj->", samples[:, rows].conj(), beyond[np.ix_(rows, rows)], samples[:, rows]).real
    cross = np.einsum("si,ij,sj->", samples[:, rows].conj(), beyond[np.ix_(rows, others)], samples[:, others]).real
    if own < 1e-9 * np.sum(np.abs(samples[:, rows]) ** 2) or cross == 0:
        return None
    return float(-own / cross)


def words_of(members: Sequence[int], names: Mapping[int, str] | Sequence[str]) -> str:
    return ", ".join(names[i] for i in members)


# One campaign -------------------------------------------------------------------------------------------------------


def campaign_gains(
    density: np.ndarray, sensors: Sequence[Sensor], mentioned: Sequence[str]
) -> tuple[list[SensorFinding], str | None]:
    """Gains of channels and of loggers (channels at one place, of one quantity or unit) by the rigid parts of one
    campaign, and a sentence on these parts; density (n_part, n_line, n, n): cross-spectra of accelerations in a few
    parts of the campaign. Channels that a sentence of `mentioned` names are not judged again: a part with one of them
    is left to it."""
    found: list[SensorFinding] = []
    rigid, covered = [], set()
    for members in rigid_candidates(sensors):
        own = [sensors[i] for i in members]
        samples = motions(density[:, :, members][:, :, :, members])
        wrong, share = wrong_gains(samples, own, natural_groups(own, range(len(own))))
        if share > RIGID_SHARE:
            continue
        rigid.append((own, share))
        if any(s.channel in sentence for s in own for sentence in mentioned):
            continue
        for one in wrong:
            channels = {own[i].channel for i in one.members}
            if channels & covered:
                continue
            covered |= channels
            found.append(_campaign_finding(one, own))
    words = "; ".join(f"{', '.join(s.channel for s in own)} (gains from "
                      f"{100 * SIGMA * np.hypot(ALIKE, np.sqrt(share)):.0f} % show)" for own, share in rigid)
    return found, f"rigid by position and record: {words}" if words else None


def motions(density: np.ndarray) -> np.ndarray:
    """(n_sample, n) real shapes in which sensors move, line by line: principal vectors of the cross-spectra that hold a
    fifth of the power or more, each as a sample of one size."""
    found = []
    for part in np.real(density).reshape(-1, *density.shape[2:]):
        value, vector = np.linalg.eigh(part)
        if value[-1] > 0:
            found += [vector[:, k] for k in np.flatnonzero(value > 0.2 * value.sum())]
    return np.array(found).reshape(-1, density.shape[-1])


def _campaign_finding(one: WrongGain, sensors: Sequence[Sensor]) -> SensorFinding:
    names = [s.channel for s in sensors]
    channel = words_of(one.members, names)
    alternatives = tuple(words_of(r, names) for r, _ in one.alternatives)
    several = len(one.members) > 1
    others = words_of([i for i in range(len(names)) if i not in one.members], names)
    return SensorFinding(
        name="common gain" if several else "gain", channel=channel, size=one.gain, std=one.std,
                         alternatives=alternatives,
        message=f"suspect: {channel} read{'' if several else 's'} {one.gain:.3f} +- {one.std:.2g} times what {others} "
        "say of the rigid part that they share"
        + (f"; it may be {' or '.join(alternatives)} instead" if alternatives else "")
        + f": check {'their logger and its unit' if several else 'its scale, sign and unit'}, or those of the others")
