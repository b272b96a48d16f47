"""Setups of one structure against one another: references whose gain differs between them, or is wrong in all.

References stay where they are, so what they read of a mode goes in one proportion in every setup: a setup in which the
proportion differs has another gain. And what setups saw one after the other makes one shape through the references:
rovers and references on one rigid part, wherever it is (`rigid_bodies`), say what is wrong in all setups alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from probupdate.campaign.blocks import block_files, read_block
from probupdate.campaign.mounting import LOWEST_HZ
from probupdate.campaign.reading import Campaign
from probupdate.campaign.rigid_bodies import (
    WrongGain,
    gain_finding,
    natural_groups,
    rigid_candidates,
    rigid_motions,
    smaller_parts,
    wrong_gains,
)
from probupdate.campaign.sensor_findings import SIGMA, SensorFinding, std_left_out
from probupdate.campaign.spectra import SEGMENT_S, mean_products, segment_lines, to_acceleration
from probupdate.errors import InputError
from probupdate.evidence.directions import choose_explanations
from probupdate.evidence.gains import Explanation, explanations
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
# a channel counts in a peak, and a peak in a rigid part, if its part is this large beside the largest
SEEN = 0.1
# a peak of one mode: the references' principal motion explains this share of all channels' power in it
ONE_MODE = 0.8
# bytes kept of all setups' spectra
MOST_BYTES = 128 * 2**20
# a peak is an average over segments: its direction counts as two of one drawn once
COUNT = 2.0


@dataclass(frozen=True, eq=False, kw_only=True)
class SetupShapes:
    """What one setup saw at every peak: shape (n_peak, n_channel) real, of all channels on the references' common part,
    std the same shape. NaN where a channel was not whole."""

    name: str
    sensors: tuple[Sensor, ...]
    shape: np.ndarray
    std: np.ndarray

    def indices(self, channels: Sequence[str]) -> list[int]:
        own = [s.channel for s in self.sensors]
        return [own.index(c) for c in channels]

    def divide_gains(self, gains: Mapping[str, float]) -> SetupShapes:
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
        return "\n".join([*(f"found: {f.message}" for f in self.findings), *(f"note: {u}" for u in self.uses)])


def compare_setups(
    campaigns: Sequence[Campaign], names: Sequence[str], *, progress: Progress = silent
) -> SetupComparison:
    """References of several setups against one another and against the rovers; see the module's head. For every channel
    those that have it are compared, by all that they share. Raises InputError where no two share one."""
    channels = dict.fromkeys(channel for campaign in campaigns for channel in campaign.channels)
    holders = [tuple(k for k, one in enumerate(campaigns) if channel in one.channels) for channel in channels]
    groups = sorted({group for group in holders if len(group) > 1}, key=lambda group: (-len(group), group))
    if not groups:
        raise InputError("setups", "have no channel in common",
                         "name the references alike in every campaign.toml")
    found = [_compare_group([campaigns[k] for k in group], [names[k] for k in group], progress) for group in groups]
    findings = {f.message: f for one in found for f in one.findings}
    uses = dict.fromkeys(text if len(group) == len(campaigns) else f"{' and '.join(names[k] for k in group)}: {text}"
                         for group, one in zip(groups, found, strict=True) for text in one.uses)
    return SetupComparison(references=tuple(dict.fromkeys(r for one in found for r in one.references)),
                           peaks_hz=np.unique(np.concatenate([one.peaks_hz for one in found])),
                           findings=tuple(findings.values()), uses=tuple(uses))


def _compare_group(campaigns: Sequence[Campaign], names: Sequence[str], progress: Progress) -> SetupComparison:
    """By the references that all of these have.

    A gain is reported beyond four standard deviations, in which are its scatter over segments, peaks and setups and 1 %
    by which sound sensors differ. With two references a difference may be of either by the inverse: rigid parts decide
    where rovers of several setups share one, else both are said. A gain common to all references in all setups is found
    where references and rovers share a rigid part.
    """
    references = _common_channels(campaigns)
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
    found, notes_of = _judge_references(shapes, references)
    frequency = parts[kept[0]].frequency_hz[peaks]
    uses = (*notes, f"references {', '.join(references)} of {len(kept)} setups compared at {len(peaks)} peaks from "
            f"{frequency[0]:.3g} to {frequency[-1]:.3g} Hz", *notes_of)
    return SetupComparison(references=references, peaks_hz=frequency, findings=tuple(found), uses=uses)


def _common_channels(campaigns: Sequence[Campaign]) -> tuple[str, ...]:
    return tuple(c for c in campaigns[0].channels if all(c in other.channels for other in campaigns))


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
        one = _regress_on_references(whole, rows)
        left = [_regress_on_references(whole - part.density[g, band].sum(axis=0), rows) for g in range(n_group)]
        left = [x if x @ one >= 0 else -x for x in left]
        if _explained_share(whole, rows) < ONE_MODE:
            one = np.full(len(one), np.nan)
        values.append(one)
        errors.append(std_left_out(np.array(left)))
    return SetupShapes(name=name, sensors=campaign.sensors, shape=np.array(values), std=np.array(errors))


def _regress_on_references(density: np.ndarray, rows: Sequence[int]) -> np.ndarray:
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


def _judge_references(
    shapes: list[SetupShapes], references: Sequence[str]
) -> tuple[list[SensorFinding], list[str]]:
    gains: list[dict[str, float]] = [{} for _ in shapes]
    found: list[SensorFinding] = []
    for group in _setups_of_equal_gain(_references_of_other_gain(shapes, references)):
        for c in group:
            gains[c.setup][c.channel] = c.gain
        channel, where = group[0].channel, ", ".join(shapes[c.setup].name for c in group)
        # what is none in one of these setups is none in the others
        alternatives = tuple(a for a in group[0].alternatives if all(a in c.alternatives for c in group))
        size, std = float(np.mean([c.gain for c in group])), float(np.sqrt(np.mean([c.std**2 for c in group])))
        other = f"; it may be {', '.join(alternatives)} by {1 / size:.3g} times instead" if alternatives else ""
        found.append(SensorFinding(
            name="reference", channel=channel, size=size, std=std, since=where, alternatives=alternatives,
            message=f"suspect: reference {channel} reads {size:.3g} +- {std:.2g} times in {where} what it reads in "
            f"the other setups{other}: {_advice(size)} of these setups"))
    alone = "one reference alone" if len(references) == 1 else "two setups, of which neither is the measure"
    notes = [f"{alone}: gains that differ between setups are found by rigid parts only"] * (
        len(references) == 1 or len(shapes) == 2)
    if 2 * sum(map(bool, gains)) >= len(shapes):
        notes.append("references go in different proportions in half of the setups or more")
    constant, more_notes = _constant([s.divide_gains(g) for s, g in zip(shapes, gains, strict=True)], references)
    return [*found, *constant], [*notes, *more_notes]


def _advice(size: float) -> str:
    return ("correct its direction and unit in campaign.toml" if size < 0 else "correct its unit in campaign.toml")


@dataclass(frozen=True, kw_only=True)
class _Differs:
    """In setup number `setup` a reference reads `gain` times what it does elsewhere; or the alternatives the inverse.
    """

    setup: int
    channel: str
    gain: float
    std: float
    alternatives: tuple[str, ...]

    def for_channel(self, channel: str) -> _Differs:
        if channel == self.channel:
            return self
        return replace(self, channel=channel, gain=1 / self.gain, std=self.std / self.gain**2, alternatives=(
            self.channel, *(c for c in self.alternatives if c != channel)))


def _setups_of_equal_gain(cases: list[_Differs]) -> list[list[_Differs]]:
    """Setups in which one reference has one gain, the reference that may explain most of them first."""
    left, groups = list(cases), []
    while left:
        names = [n for c in left for n in (c.channel, *c.alternatives)]
        channel = max(dict.fromkeys(names), key=names.count)
        own = [c.for_channel(channel) for c in left if channel in (c.channel, *c.alternatives)]
        near = [c for c in own if abs(c.gain - own[0].gain) <= SIGMA * np.hypot(c.std, own[0].std)]
        left = [c for c in left if c.setup not in [n.setup for n in near]]
        groups.append(near)
    return groups


def _references_of_other_gain(shapes: Sequence[SetupShapes], references: Sequence[str]) -> list[_Differs]:
    """References whose gain in a setup is not that of most setups: one after the other, in the setup where it is most
    probable. Of two that explain as much the one whose correction makes rigid parts rigid, if they show it."""
    found: list[_Differs] = []
    gains: list[dict[str, float]] = [{} for _ in shapes]
    while len(shapes) > 2:
        now = [s.divide_gains(g) for s, g in zip(shapes, gains, strict=True)]
        # of all references but one, as a shape has no size
        open_to = [[i for i, c in enumerate(references) if c not in g and len(g) < len(references) - 1] for g in gains]
        tried = [_explanations_by_others(now, k, references, free) for k, free in enumerate(open_to)]
        named = [choose_explanations([t.log for t in own], [t.kind == "gain" for t in own]) if own else []
                 for own in tried]
        if not any(named):
            break
        setup = max((k for k, choice in enumerate(named) if choice),
                    key=lambda k: tried[k][named[k][0]].log - tried[k][0].log)
        options = [tried[setup][k] for k in named[setup]]
        logs = [t.log + _log_rigid(shapes, references, setup, {references[t.members[0]]: t.gain}, gains)
                for t in options] if len(options) > 1 else [0.0]
        first, *others = (options[k] for k in choose_explanations(logs, [True] * len(options)))
        channel, gain = references[first.members[0]], float(first.gain)
        gains[setup][channel] = gain
        found.append(_Differs(setup=setup, channel=channel, gain=gain, std=float(first.std), alternatives=tuple(
            references[t.members[0]] for t in others)))
    return sorted(found, key=lambda c: c.setup)


def _explanations_by_others(
    shapes: Sequence[SetupShapes], setup: int, references: Sequence[str], free: Sequence[int]
) -> list[Explanation]:
    """What explains a setup's references beside the others' median shape of every peak, by those that are `free`."""
    rows = [s.indices(references) for s in shapes]
    value = np.array([s.shape[:, r] for s, r in zip(shapes, rows, strict=True)])
    error = np.array([s.std[:, r] for s, r in zip(shapes, rows, strict=True)])
    size = np.linalg.norm(value, axis=2)
    value, noise = value / size[:, :, None], np.sqrt(np.mean(error**2, axis=2)) / size
    others = np.arange(len(shapes)) != setup
    usable = np.isfinite(size[setup]) & (np.isfinite(size[others]).sum(axis=0) > len(shapes) / 2)
    if not usable.any() or not free:
        return []
    value, noise = value[:, usable], noise[:, usable]
    mean = _median_shape(value[others])
    spread = np.sqrt(noise[setup] ** 2 + np.nanmedian(noise[others], axis=0) ** 2)
    return explanations(value[setup], mean[:, :, None], [(i,) for i in free], count=COUNT, noise=spread)


def _log_rigid(
    shapes: Sequence[SetupShapes], references: Sequence[str], setup: int, change: Mapping[str, float],
    gains: Sequence[Mapping],
) -> float:
    """ln evidence that the rigid parts with rovers of a setup are rigid, its references divided by `change`; parts of
    all setups as they are known by now."""
    now = [s.divide_gains(g) for s, g in zip(shapes, gains, strict=True)]
    now[setup] = shapes[setup].divide_gains({**gains[setup], **change})
    total = 0.0
    for samples, sensors, owner in _parts(now, references):
        # a reference may be wrong in all setups alike: rovers only
        rovers = [i for i, o in enumerate(owner) if o >= 0]
        motion = rigid_motions([sensors[i] for i in rovers]) if rovers else np.zeros((0, 6))
        if setup in owner and len({owner[i] for i in rovers}) > 1 and np.linalg.matrix_rank(motion) < len(rovers):
            total += explanations(samples[:, rovers], motion, [])[0].log
    return total


def _median_shape(each: np.ndarray) -> np.ndarray:
    """(n_peak, n) median of shapes (n_setup, n_peak, n) of any size and sign, NaN where a setup has none."""
    mean = each[np.argmax(np.isfinite(each).all(axis=2), axis=0), np.arange(each.shape[1])]
    for _ in range(3):
        factor = _factors(each, mean)
        mean = np.nanmedian(each * factor[:, :, None], axis=0)
    return mean


def _factors(each: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """(n_setup, n_peak) by what shapes are multiplied to be as large as the mean shape (n_peak, n)."""
    return np.sum(each * mean, axis=2) / np.maximum(np.sum(each**2, axis=2), 1e-300)


def _parts(shapes: Sequence[SetupShapes], references: Sequence[str]):
    """(samples (n_peak, n), sensors, owner) of every part that may be rigid: references (owner -1), and rovers (owner:
    setup), all scaled to the references' mean shape."""
    rows = [s.indices(references) for s in shapes]
    # peaks that are one mode in all setups
    clean = np.all([np.isfinite(s.shape).all(axis=1) for s in shapes], axis=0)
    if clean.sum() < 3:
        return
    shapes = [replace(s, shape=s.shape[clean], std=s.std[clean]) for s in shapes]
    at = np.array([s.shape[:, r] for s, r in zip(shapes, rows, strict=True)])
    mean = _median_shape(at)
    factor = _factors(at, mean)
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
        groups += [tuple(i for i, o in enumerate(owner) if o == k) for k in setups]
        groups = smaller_parts(groups, len(sensors))
        wrong, share = wrong_gains(samples, sensors, groups)
        if share < 0.5 or wrong:
            judged |= {s.channel for s, o in zip(sensors, owner, strict=True) if o < 0 and len(setups) > 1}
        for one in wrong:
            finding = _setup_finding(one, sensors, owner, references)
            found.setdefault(finding.channel, finding)
    missing = [c for c in references if c not in judged]
    notes = [f"a gain of {', '.join(missing)} that is wrong in all setups alike, or common in one to all that a mode "
             "moves, cannot be found: no rover shares a rigid part with it"] if missing else []
    return list(found.values()), notes


def _setup_finding(one: WrongGain, sensors: Sequence[Sensor], owner, references: Sequence[str]) -> SensorFinding:
    owners = {owner[i] for i in one.members}
    alone = len(owners) == 1 and -1 not in owners and sum(o in owners for o in owner) == len(one.members)
    wrong = "scale and direction are" if one.gain < 0 and abs(abs(one.gain) - 1) > SIGMA * one.std else (
        "direction is" if one.gain < 0 else "scale is")
    return gain_finding(
        one, sensors, "reference" if all(sensors[i].channel in references for i in one.members) else "gain",
        f": the stated {wrong} wrong", f"{_advice(one.gain)}, or that of the others",
        (f"all references of that setup by {1 / one.gain:.3g}",) if alone else ())
