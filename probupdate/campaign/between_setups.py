"""Setups of one structure against one another: references whose gain differs between them, or is wrong in all.

References stay where they are, so what they read of a mode goes in one proportion in every setup: a setup in which the
proportion differs has another gain. And what setups saw one after the other makes one shape through the references:
rovers and references on one rigid part, wherever it is (`rigid_bodies`), say what is wrong in all setups alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from probupdate.campaign.blocks import block_files, read_block
from probupdate.campaign.mounting import LOWEST_HZ
from probupdate.campaign.reading import Campaign
from probupdate.campaign.rigid_bodies import Group, WrongGain, natural_groups, rigid_candidates, words_of, wrong_gains
from probupdate.campaign.sensor_findings import ALIKE, SIGMA, SensorFinding, std_left_out
from probupdate.campaign.spectra import SEGMENT_S, mean_products, segment_lines, to_acceleration
from probupdate.errors import InputError
from probupdate.io.result_table import OWN_UNIT, table_of
from probupdate.modal.modes import Sensor
from probupdate.runtime.progress import Progress, silent

if TYPE_CHECKING:
    import pandas as pd

# groups of segments, of which one after the other is left out for standard deviations
GROUPS = 10
FEWEST_SEGMENTS = 10
# blocks of a setup that are read, evenly spread
MOST_BLOCKS = 24
# a peak stands this far (natural logarithm of power, mean over channels and setups) above what surrounds it
PEAK, NEIGHBOURS, MOST_PEAKS = 1.0, 12, 12
# a reference's part of a peak counts if it is this large beside the largest and known so well
SEEN, KNOWN = 0.1, 0.2
# a peak of one mode: the references' principal motion explains this share of all channels' power in it
ONE_MODE = 0.8
# bytes kept of all setups' spectra
MOST_BYTES = 128 * 2**20
# natural logarithm of a likelihood by which one of two explanations is taken
DECIDED = 5.0


@dataclass(frozen=True, eq=False, kw_only=True)
class SetupShapes:
    """What one setup saw at every peak: shape (n_peak, n_channel) real, of all channels on the references' common part,
    std the same shape. NaN where a channel was not whole."""

    name: str
    sensors: tuple[Sensor, ...]
    shape: np.ndarray
    std: np.ndarray

    def of(self, channels: Sequence[str]) -> list[int]:
        own = [s.channel for s in self.sensors]
        return [own.index(c) for c in channels]

    def divided(self, gains: Mapping[str, float]) -> SetupShapes:
        """The same with channels' gains taken back."""
        factor = np.array([gains.get(s.channel, 1.0) for s in self.sensors])
        return replace(self, shape=self.shape / factor, std=self.std / np.abs(factor))


@dataclass(frozen=True, eq=False, kw_only=True)
class SetupComparison:
    """findings: references and rovers with a wrong gain; uses: what was compared and what cannot be judged."""

    references: tuple[str, ...]
    peaks_hz: np.ndarray
    findings: tuple[SensorFinding, ...]
    uses: tuple[str, ...]

    def to_frame(self) -> pd.DataFrame:
        """A row a finding."""
        return table_of(self.findings, [f.name for f in fields(SensorFinding)],
                        units={"size": OWN_UNIT, "size_std": OWN_UNIT})

    @property
    def summary(self) -> str:
        return "\n".join([*(f"found: {f.message}" for f in self.findings), *(f"can do: {u}" for u in self.uses)])


def compare_setups(
    campaigns: Sequence[Campaign], names: Sequence[str], *, progress: Progress = silent
) -> SetupComparison:
    """References of several setups against one another and against the rovers; see the module's head.

    A gain is reported beyond four standard deviations, in which are its scatter over segments, peaks and setups and 1 %
    by which sound sensors differ. With two references a difference may be of either by the inverse: rigid parts decide
    where rovers of several setups share one, else both are said. A gain common to all references in all setups is found
    where references and rovers share a rigid part. Raises InputError without common channels.
    """
    references = _references(campaigns)
    parts = []
    for number, campaign in enumerate(campaigns):
        progress("comparing setups", number, len(campaigns))
        parts.append(_spectra(campaign, MOST_BYTES // len(campaigns)))
    progress("comparing setups", len(campaigns), len(campaigns))
    kept = [k for k, p in enumerate(parts) if p is not None]
    unread = [names[k] for k, p in enumerate(parts) if p is None]
    notes = [f"{', '.join(unread)} not compared with other setups: too few whole samples"] if unread else []
    if len(kept) < 2:
        return SetupComparison(references=references, peaks_hz=np.zeros(0), findings=(), uses=tuple(notes))
    length = min(len(parts[k].frequency_hz) for k in kept)
    peaks = _peaks([parts[k] for k in kept], length)
    if not len(peaks):
        return SetupComparison(references=references, peaks_hz=np.zeros(0), findings=(), uses=(
            *notes, "references of setups cannot be compared: no peak is common to them"))
    shapes = [_shapes(names[k], campaigns[k], parts[k], peaks, references) for k in kept]
    found, notes_of = _judged(shapes, references)
    frequency = parts[kept[0]].frequency_hz[peaks]
    uses = (*notes, f"references {', '.join(references)} of {len(kept)} setups compared at {len(peaks)} peaks from "
            f"{frequency[0]:.3g} to {frequency[-1]:.3g} Hz", *notes_of)
    return SetupComparison(references=references, peaks_hz=frequency, findings=tuple(found), uses=uses)


def _references(campaigns: Sequence[Campaign]) -> tuple[str, ...]:
    common = [c for c in campaigns[0].channels if all(c in other.channels for other in campaigns)]
    if not common:
        raise InputError("setups", "have no channel in common", "name the references alike in every campaign.toml")
    return tuple(common)


# Shapes of setups ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class _Spectra:
    """density (n_group, n_line, n, n): cross-spectra of accelerations in groups of segments."""

    frequency_hz: np.ndarray
    density: np.ndarray


def _spectra(campaign: Campaign, most_bytes: int) -> _Spectra | None:
    rate = campaign.sampling_rate_hz
    segment_s = min(SEGMENT_S, 60 * campaign.block_minutes / FEWEST_SEGMENTS)
    length = 2 * round(segment_s * rate / 2)
    if length < 32:
        return None
    files = list(block_files(campaign).items())
    chosen = np.unique(np.round(np.linspace(0, len(files) - 1, min(MOST_BLOCKS, len(files)))).astype(int))
    frequency = fft.rfftfreq(length, 1 / rate)
    kept = np.flatnonzero((frequency >= max(LOWEST_HZ, 1.5 * frequency[1])) & (frequency <= 0.4 * rate))
    kept = kept[: max(most_bytes // (8 * GROUPS * len(campaign.sensors) ** 2), 64)]
    factor = to_acceleration(campaign.sensors, frequency[kept])
    segments = []
    for k in chosen:
        start, touching = files[k]
        data = read_block(campaign, start, touching).data
        segments += [lines * factor for lines in segment_lines(data, length, kept, moving=True)]
    if len(segments) < FEWEST_SEGMENTS:
        return None
    parts = np.array_split(np.arange(len(segments)), min(GROUPS, len(segments)))
    density = [mean_products([segments[k] for k in part]).astype(np.complex64) for part in parts]
    return _Spectra(frequency_hz=frequency[kept], density=np.array(density))


def _peaks(parts: Sequence[_Spectra], length: int) -> np.ndarray:
    """Lines at which all channels of all setups have, on average, a peak."""
    level = np.zeros(length)
    for part in parts:
        power = np.einsum("gfii->fi", part.density[:, :length]).real
        level += np.log(np.maximum(power, 1e-300)).mean(axis=1) / len(parts)
    found = []
    for k in range(2, length - 2):
        around = level[max(k - NEIGHBOURS, 0): k + NEIGHBOURS + 1]
        if level[k] == level[k - 2: k + 3].max() and level[k] > np.median(around) + PEAK:
            found.append(k)
    found = sorted(found, key=lambda k: -(level[k] - np.median(level[max(k - NEIGHBOURS, 0): k + NEIGHBOURS + 1])))
    return np.array(sorted(found[:MOST_PEAKS]), int)


def _shapes(
    name: str, campaign: Campaign, part: _Spectra, peaks: np.ndarray, references: Sequence[str]
) -> SetupShapes:
    """All channels on the references' principal motion at every peak; standard deviations by leaving out groups of
    segments."""
    rows = [campaign.channels.index(c) for c in references]
    n_group = len(part.density)
    total = part.density.sum(axis=0)
    values, errors = [], []
    for k in peaks:
        band = slice(max(k - 1, 0), k + 2)
        whole = total[band].sum(axis=0)
        one = _on_references(whole, rows)
        left = [_on_references(whole - part.density[g, band].sum(axis=0), rows) for g in range(n_group)]
        left = [x if x @ one >= 0 else -x for x in left]
        if _explained_share(whole, rows) < ONE_MODE:
            one = np.full(len(one), np.nan)
        values.append(one)
        errors.append(std_left_out(np.array(left)))
    return SetupShapes(name=name, sensors=campaign.sensors, shape=np.array(values), std=np.array(errors))


def _on_references(density: np.ndarray, rows: Sequence[int]) -> np.ndarray:
    """(n_channel,) regression on the references' first principal component, of unit size at the references; normal
    modes are real."""
    together, own = _with_references(density, rows)
    shape = np.real(together) / own
    return shape / np.linalg.norm(shape[rows])


def _with_references(density: np.ndarray, rows: Sequence[int]) -> tuple[np.ndarray, float]:
    """Cross-spectra (n_channel,) of the references' first principal component with all channels, and its power."""
    # density[i, j] is the mean of conj(x_i) x_j
    value, vector = np.linalg.eigh(np.real(density[np.ix_(rows, rows)]))
    return vector[:, -1] @ density[rows], float(value[-1])


def _explained_share(density: np.ndarray, rows: Sequence[int]) -> float:
    """Share of all channels' power, each in its own size, that the references' principal motion explains."""
    together, own = _with_references(density, rows)
    power = np.real(density.diagonal())
    large = power > SEEN**2 * power.max()
    return float(np.sum((np.abs(together) ** 2 / own)[large]) / power[large].sum())


# Judged -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class _Differs:
    """In setup number `setup` reference `first` reads `gain` times what it does elsewhere beside `second`."""

    setup: int
    first: str
    second: str
    gain: float
    std: float


def _judged(
    shapes: list[SetupShapes], references: Sequence[str]
) -> tuple[list[SensorFinding], list[str]]:
    found: list[SensorFinding] = []
    notes: list[str] = []
    differs, split = _differing(shapes, references)
    notes += split
    if len(references) == 1:
        notes.append("one reference alone: gains that differ between setups are found by rigid parts only")
    gains: list[dict[str, float]] = [{} for _ in shapes]
    single: dict[tuple[str, tuple[str, ...]], list[tuple[int, float, float]]] = {}
    # a setup's references with the fewest changes that explain its pairs
    for k in dict.fromkeys(d.setup for d in differs):
        chosen = _explained(shapes, references, gains, [d for d in differs if d.setup == k])
        for channel, gain, std, alternatives in chosen:
            single.setdefault((channel, alternatives), []).append((k, gain, std))
            if not alternatives:
                gains[k][channel] = gain
        if any(r for *_, r in chosen):
            gains[k] |= {channel: gain for channel, gain, _, _ in chosen}
    for (channel, alternatives), cases in single.items():
        for group in _alike(cases):
            where = ", ".join(shapes[k].name for k, _, _ in group)
            size = float(np.mean([g for _, g, _ in group]))
            std = float(np.sqrt(np.mean([s**2 for _, _, s in group]) / len(group) + (ALIKE * size) ** 2))
            other = f"; it may be {', '.join(alternatives)} by {1 / size:.3g} times instead" if alternatives else ""
            found.append(SensorFinding(
                name="reference", channel=channel, size=size, std=std, since=where, alternatives=alternatives,
                message=f"suspect: reference {channel} reads {size:.3g} +- {std:.2g} times in {where} what it reads in "
                f"the other setups{other}: {_advice(size)} of these setups"))
    shapes = [s.divided(g) for s, g in zip(shapes, gains, strict=True)]
    constant, more_notes = _constant(shapes, references)
    return [*found, *constant], [*notes, *more_notes]


def _advice(size: float) -> str:
    return ("mend its direction and unit in campaign.toml" if size < 0 else "mend its unit in campaign.toml")


def _alike(cases: list[tuple[int, float, float]]) -> list[list[tuple[int, float, float]]]:
    """Setups with one gain together."""
    left, groups = list(cases), []
    while left:
        near = [c for c in left if abs(c[1] - left[0][1]) <= SIGMA * np.hypot(c[2], left[0][2])]
        left = [c for c in left if c not in near]
        groups.append(near)
    return groups


def _differing(shapes: Sequence[SetupShapes], references: Sequence[str]) -> tuple[list[_Differs], list[str]]:
    """Pairs of references whose proportion in a setup is not that of most setups."""
    found, notes = [], []
    rows = [s.of(references) for s in shapes]
    value = np.array([s.shape[:, r] for s, r in zip(shapes, rows, strict=True)])
    error = np.array([s.std[:, r] for s, r in zip(shapes, rows, strict=True)])
    with np.errstate(invalid="ignore"):
        seen = (np.abs(value) > SEEN * np.abs(value).max(axis=2, keepdims=True)) & (error < KNOWN * np.abs(value))
    for i, j in combinations(range(len(references)), 2):
        both = seen[:, :, i] & seen[:, :, j]
        usable = both.sum(axis=0) > len(shapes) / 2
        if len(shapes) < 3 or not usable.any():
            continue
        ratio = np.where(both, value[:, :, i] / np.where(both, value[:, :, j], 1.0), np.nan)[:, usable]
        std = np.where(both, np.hypot(error[:, :, i] / np.abs(value[:, :, i]), error[:, :, j] / np.abs(value[:, :, j])),
                       np.nan)[:, usable]
        sign = np.sign(np.nanmedian(np.sign(ratio), axis=0))
        size = np.exp(np.nanmedian(np.log(np.abs(ratio)), axis=0))
        relative = ratio / np.where(sign == 0, 1.0, sign) / size
        log = np.log(np.abs(relative))
        # what the shape itself changes between setups, peak by peak
        own = 1.4826 * np.nanmedian(np.abs(log), axis=0)
        weight = np.where(np.isfinite(log), 1 / (std**2 + own**2 + ALIKE**2), 0.0)
        off = []
        for k in range(len(shapes)):
            if not weight[k].any():
                continue
            mean = float(np.nansum(weight[k] * log[k]) / weight[k].sum())
            positive = float(weight[k][relative[k] > 0].sum() / weight[k].sum())
            n = int((weight[k] > 0).sum())
            rest = np.sqrt(float(np.nansum(weight[k] * (log[k] - mean) ** 2)) / max(n - 1, 1))
            spread = float(np.hypot(max(rest, 1.0) / np.sqrt(weight[k].sum()), ALIKE))
            gain = np.exp(mean) * (1 if positive > 0.5 else -1)
            # peaks that disagree about the sign give none
            if (gain > 0 and abs(mean) > SIGMA * spread) or positive < 0.1:
                off.append(_Differs(setup=k, first=references[i], second=references[j], gain=float(gain),
                                    std=float(abs(gain) * spread)))
        if len(off) * 2 >= len(shapes):
            notes.append(f"{references[i]} and {references[j]} go in different proportions in half of the setups or "
                         "more")
        found += off
    return found, notes


def _explained(
    shapes: Sequence[SetupShapes], references: Sequence[str], gains: Sequence[Mapping], differs: Sequence[_Differs]
) -> list[tuple[str, float, float, tuple[str, ...]]]:
    """(channel, gain, std, alternatives) of one setup: the reference that is in most of the pairs that differ, and so
    on; of a pair alone the one whose correction makes rigid parts rigid, if they show it."""
    left, chosen = list(differs), []
    while left:
        count = {c: [d for d in left if c in (d.first, d.second)] for c in references}
        most = max(len(v) for v in count.values())
        best = [c for c in references if len(count[c]) == most]
        if most == 1 and len(references) > 2:
            # the others' pairs agree: a difference that one pair alone has is none of a gain
            return chosen
        options = []
        for channel in best:
            sizes = [(d.gain, d.std) if d.first == channel else (1 / d.gain, d.std / d.gain**2) for d in count[channel]]
            gain = float(np.median([g for g, _ in sizes]))
            options.append((channel, gain, float(np.median([s for _, s in sizes]))))
        if len(options) > 1:
            scores = [_misfit(shapes, references, left[0].setup, {c: g}, gains) for c, g, _ in options]
            order = np.argsort([s[0] for s in scores])
            options = [options[k] for k in order]
            decided = scores[order[1]][0] - scores[order[0]][0] > DECIDED
        else:
            decided = True
        channel, gain, std = options[0]
        chosen.append((channel, gain, std, () if decided else tuple(c for c, _, _ in options[1:])))
        left = [d for d in left if channel not in (d.first, d.second)]
    return chosen


def _misfit(
    shapes: Sequence[SetupShapes], references: Sequence[str], setup: int, change: Mapping[str, float],
    gains: Sequence[Mapping],
) -> tuple[float, int]:
    """-ln of the likelihood that the rigid parts with rovers of a setup are rigid, its references divided by `change`;
    an unknown size of errors is marginalised. Parts of all setups as they are known by now."""
    now = [s.divided(g) for s, g in zip(shapes, gains, strict=True)]
    now[setup] = shapes[setup].divided(change)
    total, number = 0.0, 0
    for samples, sensors, owner in _parts(now, references):
        # a reference may be wrong in all setups alike: rovers only
        rovers = [i for i, o in enumerate(owner) if o >= 0]
        if setup not in owner or len({owner[i] for i in rovers}) < 2:
            continue
        _, share = wrong_gains(samples[:, rovers], [sensors[i] for i in rovers], ())
        if share < 1:
            count = len(samples) * max(len(sensors) - 6, 1) / 2
            total += 0.5 * count * np.log(max(share, 1e-6))
            number += 1
    return total, number


def _parts(shapes: Sequence[SetupShapes], references: Sequence[str]):
    """(samples (n_peak, n), sensors, owner) of every part that may be rigid: references (owner -1), and rovers (owner:
    setup), all scaled to the references' mean shape."""
    rows = [s.of(references) for s in shapes]
    # peaks that are one mode in all setups
    clean = np.all([np.isfinite(s.shape).all(axis=1) for s in shapes], axis=0)
    if clean.sum() < 3:
        return
    shapes = [replace(s, shape=s.shape[clean], std=s.std[clean]) for s in shapes]
    at = np.array([s.shape[:, r] for s, r in zip(shapes, rows, strict=True)])
    mean = at[0]
    for _ in range(3):
        factor = np.einsum("kpr,pr->kp", at, mean) / np.maximum(np.einsum("kpr,kpr->kp", at, at), 1e-300)
        mean = np.median(at * factor[:, :, None], axis=0)
    factor = np.einsum("kpr,pr->kp", at, mean) / np.maximum(np.einsum("kpr,kpr->kp", at, at), 1e-300)
    sensors = [shapes[0].sensors[i] for i in rows[0]]
    owner = [-1] * len(sensors)
    columns = [mean]
    for k, (s, r) in enumerate(zip(shapes, rows, strict=True)):
        own = [i for i in range(len(s.sensors)) if i not in r]
        sensors += [s.sensors[i] for i in own]
        owner += [k] * len(own)
        columns.append(s.shape[:, own] * factor[k][:, None])
    every = np.hstack(columns)
    for members in rigid_candidates(sensors):
        samples = every[:, members]
        # a peak in which the part hardly moves is noise there
        moves = np.linalg.norm(samples, axis=1) > SEEN * np.linalg.norm(every, axis=1) * np.sqrt(
            len(members) / every.shape[1])
        if moves.sum() > 2:
            yield samples[moves], [sensors[i] for i in members], [owner[i] for i in members]


def _constant(
    shapes: Sequence[SetupShapes], references: Sequence[str]
) -> tuple[list[SensorFinding], list[str]]:
    """Gains that are wrong as long as the channels were there, by the rigid parts of all setups together."""
    found: dict[str, SensorFinding] = {}
    judged: set[str] = set()
    for samples, sensors, owner in _parts(shapes, references):
        groups = natural_groups(sensors, range(len(sensors)))
        setups = dict.fromkeys(owner)
        groups += [Group(members=tuple(i for i, o in enumerate(owner) if o == k),
                         words="references" if k < 0 else f"rovers of {shapes[k].name}") for k in setups]
        groups = list({g.members: g for g in groups if 0 < len(g.members) < len(sensors)}.values())
        wrong, share = wrong_gains(samples, sensors, groups)
        if share < 0.5 or wrong:
            judged |= {s.channel for s, o in zip(sensors, owner, strict=True) if o < 0 and len(setups) > 1}
        for one in wrong:
            finding = _finding(one, sensors, owner, references)
            found.setdefault(finding.channel, finding)
    missing = [c for c in references if c not in judged]
    notes = [f"a gain of {', '.join(missing)} that is wrong in all setups alike cannot be found: no rover shares a "
             "rigid part with it"] if missing else []
    return list(found.values()), notes


def _finding(one: WrongGain, sensors: Sequence[Sensor], owner, references: Sequence[str]) -> SensorFinding:
    names = [s.channel for s in sensors]
    channel = words_of(one.members, names)
    others = words_of([i for i in range(len(names)) if i not in one.members], names)
    alternatives = tuple(words_of(r, names) for r, _ in one.alternatives)
    owners = {owner[i] for i in one.members}
    alone = len(owners) == 1 and -1 not in owners and sum(o in owners for o in owner) == len(one.members)
    if alone:
        alternatives = (*alternatives, f"all references of that setup by {1 / one.gain:.3g}")
    reference = all(names[i] in references for i in one.members)
    wrong = "scale and direction are" if one.gain < 0 and abs(abs(one.gain) - 1) > SIGMA * one.std else (
        "direction is" if one.gain < 0 else "scale is")
    return SensorFinding(
        name="reference" if reference else "gain", channel=channel, size=one.gain, std=one.std,
                         alternatives=alternatives,
        message=f"suspect: {channel} read{'s' if len(one.members) == 1 else ''} {one.gain:.3f} +- {one.std:.2g} times "
        f"what {others} say of the rigid part that they share: the stated {wrong} wrong"
        + (f"; it may be {' or '.join(alternatives)} instead" if alternatives else "")
        + f": {_advice(one.gain)}, or that of the others")
