"""Rigid parts inferred from where sensors are, and gains that break them.

Sensors at one height, at one place, or in one cross-section of something long may be fixed to one rigid body: six
motions explain what they all see, whatever their directions. Whether they are is asked of the data: only if one change
of gain, of one channel or of channels with something in common, leaves next to nothing unexplained is the part taken as
rigid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.campaign.sensor_findings import SIGMA, SensorFinding
from probupdate.evidence.directions import choose_explanations
from probupdate.evidence.gains import ALIKE, Explanation, explanations, outside_share
from probupdate.modal.modes import Sensor

# gap between parts: this share of the extent along the axis, or of the distances across it
GAP_SHARE, GAP_ACROSS = 0.02, 0.1
# a part is rigid if six motions leave less than this share of what its sensors see
RIGID_SHARE = 0.006


@dataclass(frozen=True, eq=False, kw_only=True)
class WrongGain:
    """gain: as recorded over what the rigid part says, std its standard deviation; members (indices) of the channels;
    alternatives: groups that explain it as well, with their gains; share: unexplained before and after."""

    members: tuple[int, ...]
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


def name_levels(sensors: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """The same with levels named by the sensors' heights: those without a gap between them are one. The names that a
    campaign gives them group channels in reports, and may stand for a whole tower."""
    of: dict[int, str] = {}
    for members in rigid_candidates(sensors, axes=(2,), alone=True) if sensors else ():
        height = float(np.mean([sensors[i].position_m[2] for i in members]))
        of |= dict.fromkeys(members, f"{height:.6g} m")
    return tuple(replace(s, level=of[i]) for i, s in enumerate(sensors))


def groups_at_one_place(sensors: Sequence[Sensor], members: Sequence[int]) -> list[tuple[int, ...]]:
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


def natural_groups(sensors: Sequence[Sensor], members: Sequence[int]) -> list[tuple[int, ...]]:
    """Channels that may share a logger or a unit: every one alone, those at one place, those of one quantity or
    unit."""
    groups = [*((i,) for i in members), *groups_at_one_place(sensors, members)]
    for key in ("quantity", "unit"):
        values = dict.fromkeys(getattr(sensors[i], key, "") for i in members)
        groups += [tuple(i for i in members if getattr(sensors[i], key, "") == v) for v in values]
    return smaller_parts(groups, len(members))


def smaller_parts(groups: Sequence[tuple[int, ...]], n: int) -> list[tuple[int, ...]]:
    """Each once, and of two that are all of n channels together the smaller, which nothing distinguishes from the other
    by the inverse."""
    return [g for g in dict.fromkeys(groups) if 0 < len(g) < n and not any(
        len(h) < len(g) and len(h) + len(g) == n and not set(h) & set(g) for h in groups)]


def wrong_gains(
    samples: np.ndarray, sensors: Sequence[Sensor], groups: Sequence[tuple[int, ...]], *, most: int = 3
) -> tuple[list[WrongGain], float]:
    """What breaks one rigid part, and the share that stays unexplained (1 where nothing is redundant).

    samples (n_sample, n_channel): shapes, or square roots of covariances, in one quantity; each sample has one vote.
    Gains are named one after the other by their evidence beside sound ones and motions of their own
    (`evidence.gains`), if the part is rigid with them. Of a group and all others by the inverse, which nothing
    distinguishes, the smaller is taken.
    """
    taken, share, first = explain_motion(samples, rigid_motions(sensors), groups, most=most)
    if not taken or share > RIGID_SHARE:
        return [], first
    n = len(sensors)
    return [WrongGain(members=one.members, gain=one.gain, std=one.std, share=(first, share), alternatives=tuple(
        (t.members, t.gain) for t in others if _independent([*(t.members for t, _ in taken), t.members], n)))
        for one, others in taken], share


def explain_motion(
    samples: np.ndarray, motion: np.ndarray, groups: Sequence[tuple[int, ...]],
    pairs: Sequence[tuple[int, int]] = (), *, most: int = 3,
) -> tuple[list[tuple[Explanation, list[Explanation]]], float, float]:
    """Gains of groups and exchanges of pairs one after the other, each with what explains it as well; and the share of
    samples (n_sample, n_channel) outside motion (n_channel, r) with them and before, 1 where nothing is redundant."""
    samples, n = samples[np.linalg.norm(samples, axis=1) > 0], len(motion)
    if not len(samples) or np.any(np.all(samples == 0, axis=0)) or np.linalg.matrix_rank(motion, tol=1e-6) >= n:
        return [], 1.0, 1.0
    taken: list[tuple[Explanation, list[Explanation]]] = []
    while len(taken) < most:
        before = [t.members for t, _ in taken]
        left = [g for g in groups if _independent([*before, g], n)]
        tried = explanations(_correct_samples(samples, [t for t, _ in taken]), motion, left, pairs)
        named = choose_explanations([t.log for t in tried], [t.kind in ("gain", "exchange") for t in tried])
        choice = [tried[k] for k in named]
        if not choice:
            break
        taken.append((choice[0], choice[1:]))
        # each gain is estimated again beside the others
        for k, (one, others) in enumerate(taken):
            beside = [t for t, _ in taken if t is not one]
            if one.kind == "gain" and beside:
                again = explanations(_correct_samples(samples, beside), motion, [one.members])
                taken[k] = max((t for t in again if t.kind == "gain"), key=lambda t: t.log), others
    return taken, outside_share(_correct_samples(samples, [t for t, _ in taken]), motion), outside_share(samples,
                                                                                                         motion)


def _correct_samples(samples: np.ndarray, gains: Sequence[Explanation]) -> np.ndarray:
    result = np.array(samples)
    for one in gains:
        members = list(one.members)
        result[:, members] = result[:, members[::-1]] if one.kind == "exchange" else result[:, members] / one.gain
    return result


def _independent(groups: Sequence[tuple[int, ...]], n_channel: int) -> bool:
    """Whether no group's gain is made by those of the others."""
    chosen = np.array([[i in g for i in range(n_channel)] for g in groups], float)
    return int(np.linalg.matrix_rank(chosen)) == len(groups)


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
            several = len(channels) > 1
            check = "their logger and its unit" if several else "its scale, sign and unit"
            found.append(gain_finding(one, own, "common gain" if several else "gain", "",
                                      f"check {check}, or those of the others"))
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


def gain_finding(
    one: WrongGain, sensors: Sequence[Sensor], name: str, wrong: str, advice: str, more: tuple[str, ...] = ()
) -> SensorFinding:
    """What is `wrong` besides the size, and what to do; `more` alternatives."""
    def words(members: Sequence[int]) -> str:
        return ", ".join(sensors[i].channel for i in members)

    channel, others = words(one.members), words([i for i in range(len(sensors)) if i not in one.members])
    alternatives = (*(words(r) for r, _ in one.alternatives), *more)
    return SensorFinding(
        name=name, channel=channel, size=one.gain, std=one.std, alternatives=alternatives,
        message=f"suspect: {channel} read{'s' if len(one.members) == 1 else ''} {one.gain:.3f} +- {one.std:.2g} times "
        f"what {others} say of the rigid part that they share{wrong}"
        + (f"; it may be {' or '.join(alternatives)} instead" if alternatives else "") + f": {advice}")
