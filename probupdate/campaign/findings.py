"""What was seen block by block, gathered over the campaign and put into sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from probupdate.campaign import mounting
from probupdate.campaign.blocks import LARGEST_SI
from probupdate.campaign.clocks import LARGEST_DELAY_S
from probupdate.campaign.gain_steps import Piece, gain_steps, parts_of_campaign
from probupdate.campaign.heading import Sway, heading_findings, heading_offset
from probupdate.campaign.mounting import Suspicion
from probupdate.campaign.reading import Campaign
from probupdate.campaign.rigid_bodies import campaign_gains, name_levels
from probupdate.campaign.rotor_lines import RateRatio
from probupdate.campaign.sensor_findings import OR_STRUCTURE, SIGMA, SensorFinding
from probupdate.campaign.spectra import SEGMENT_S
from probupdate.campaign.stated import UNITS
from probupdate.io.result_table import plural
from probupdate.modal.modes import Sensor

# a suspicion counts if this share of the blocks compared has it, or so many of eight blocks in a row
SHARE, IN_A_ROW, ROW = 0.25, 6, 8
# records of one level and direction that move so many times as much as their neighbours (m/s2 given in g: 9.8)
SCALE_FACTOR = 8.0
# factors that a unit taken for another makes
UNIT_FACTORS = {9.80665: "g and m/s2", 1e3: "mg and g, or mm and m", 1e2: "cm and m", 10.0: "cm and mm",
                9806.65: "mg and m/s2", 980.665: "g and cm/s2"}
# steps of a delay between neighbouring blocks that show a drift, and their scatter as a share of them
FEWEST_STEPS, EVEN_STEPS = 3, 0.2
# lost samples that are mentioned, as a share
MISSING = 0.005
# slow wandering of a channel's mean within a block, in its own standard deviations: of anything; of one alone among its
# like
WANDER, WANDER_ALONE = 5.0, 2.0
# clocks that differ by less are not mentioned, whatever the statistics: no mode shape below 3 Hz is hurt by 2 degrees
LEAST_DELAY_S = 0.002
# the true sampling rate by rotor lines is questioned beyond this
RATE_LIMIT = 0.01
# median deviation of the top's horizontal acceleration (m/s2) that a turbine on a slender support may have, idling and
# running, from a breath of wind to a storm: orders of magnitude, wide on purpose. Idling in waves a slender monopile,
# without a rotor's damping, moves like a running one
PLAUSIBLE = {"idling": (2e-4, 1.0), "running": (8e-3, 1.0), "any": (1e-5, 1.0)}
GRAVITY = 9.80665
# gravity as vertical channels may read it, over as they should
GRAVITY_READ = ((1.0, ""), (1 / GRAVITY, "they seem to be in g"), (GRAVITY, "they seem to be in m/s2 already"),
                (1e-3, "they seem to be in km/s2 or a thousandth"), (1e3, "they seem to be in mm/s2"),
                (1e3 / GRAVITY, "they seem to be in mg"))
# zero offsets, calibration and a mounting a few degrees askew leave a mean so near to gravity's, as a share of it
GRAVITY_SPREAD = 0.3


@dataclass(frozen=True, eq=False, kw_only=True)
class ComparedBlock:
    """One block whose channels were compared: its suspicions, delays (n_channel,) with their standard deviations, in s,
    drifts (s per s; zero where a delay was followed without), which of them move with none they could be compared with
    (`clocks.apart`), the frequency of its lowest motion and its cross-spectra in one or several pieces."""

    id: str
    start: pd.Timestamp
    state: str
    suspicions: tuple[Suspicion, ...]
    delay_s: np.ndarray
    delay_std_s: np.ndarray
    drift: np.ndarray
    apart: np.ndarray
    lowest_hz: float = float("nan")
    pieces: tuple[Piece, ...] = ()


def unit_hint(factor: float) -> str:
    """', as <unit> taken for <unit>' where a factor is just that."""
    size = max(abs(factor), 1 / max(abs(factor), 1e-12))
    for known, names in UNIT_FACTORS.items():
        if abs(np.log(size / known)) < 0.08:
            return f", about the factor between {names}"
    return ""


# Single channels ----------------------------------------------------------------------------------------------------


def channel_findings(table: pd.DataFrame, sensors: Sequence[Sensor]) -> list[str]:
    """Sentences on each channel's own samples."""
    found: list[str] = []
    n_block = table["id"].nunique()
    # where all lack a sample no channel is at fault, but the record
    common = float(table.groupby("id")["missing"].min().mean()) if len(sensors) > 1 else 0.0
    if common > MISSING:
        found.append(f"all channels lack {100 * common:.1f} % of their samples: the records do not cover the blocks")
    for sensor in sensors:
        rows = table[table["channel"] == sensor.channel]
        found += _sample_findings(sensor.channel, rows, n_block, common)
    return found + _wandering_means(table, sensors, n_block) + _compare_neighbours(table, sensors)


def _sample_findings(name: str, rows: pd.DataFrame, n_block: int, common: float) -> list[str]:
    found = []
    if rows["flat"].any():
        found.append(f"{name} is flat in {int(rows['flat'].sum())} of {n_block} blocks")
    still = rows[(rows["still_s"] > 0) & ~rows["flat"]]
    if len(still):
        found.append(f"{name} is constant for up to {still['still_s'].max():.1f} s in {len(still)} blocks, from "
                     f"{still['id'].iloc[0]} on")
    if spikes := int(rows["spikes"].sum()):
        found.append(f"{name} has {spikes} spikes that stand alone, in {int((rows['spikes'] > 0).sum())} blocks")
    if impossible := int(rows["impossible"].sum()):
        found_in = plural(int((rows["impossible"] > 0).sum()), "block")
        said = [f"{float(x):.6g}" for x in pd.unique(rows["marker"].dropna())]
        beyond = bool((rows["marker"].isna() & (rows["impossible"] > 0)).any())
        kinds = [*([f"at {' and '.join(said)} (SI), far more often than beside it"] if said else []),
                 *([f"beyond {LARGEST_SI:g} (SI)"] if beyond else [])]
        cause = (f"a number that stands for lost samples: lost = [{', '.join(said)}] in convert.toml, where that made "
                 "the records, says so (in the unit of its files)" if said else "a damaged file")
        found.append(f"{name} has {plural(impossible, 'sample')} {' or '.join(kinds)}, in {found_in}: counted as lost; "
                     f"{cause}")
    if clipped := int(rows["clipped"].sum()):
        found.append(f"{name} stands at its extreme value for {clipped} samples: clipped")
    share = float(rows["missing"].mean())
    if share - common > MISSING:
        found.append(f"{name} lacks {100 * share:.1f} % of its samples: modes are identified from the pairs that were "
                     "measured")
    again, drawn = (float(rows[kind].mean()) for kind in ("repeated", "filled"))
    if again > 0:
        each = 1 / max(1 - again, 1e-9)
        found.append(f"{name} repeats: {100 * again:.2g} % of its samples equal the one before"
                     + (f" (each value stands {each:.3g} times: a converter slower than the table, or a radio that "
                        "sends the last value again)" if again > 0.1 else "")
                     + ": only the first of each counts as measured")
    if drawn > 0:
        found.append(f"{name} was filled: {100 * drawn:.2g} % of its samples lie on straight lines between others: "
                     "they count as lost")
    return found


def _wandering_means(table: pd.DataFrame, sensors: Sequence[Sensor], n_block: int) -> list[str]:
    """Means that drift within blocks, or jump between them, where vibration alone moves no mean."""
    moving = table["vibration"].where(table["vibration"] > 0)
    table = table.assign(ratio=table["wander"] / moving)
    within = table.pivot(index="id", columns="channel", values="ratio")
    wander = table.pivot(index="id", columns="channel", values="wander")
    offset = table.pivot(index="id", columns="channel", values="offset")
    between = (offset.max() - offset.min()) / moving.groupby(table["channel"]).median()
    found = []
    for sensor in sensors:
        like = [s.channel for s in sensors if s is not sensor and abs(s.direction @ sensor.direction) > 0.9
                and s.quantity == sensor.quantity]
        mine = within[sensor.channel]
        others = within[like].median(axis=1) if like else pd.Series(np.nan, index=within.index)
        drifting = (mine > WANDER) | ((mine > WANDER_ALONE) & (others < mine / 4))
        if drifting.any():
            most = wander[sensor.channel][drifting].max()
            found.append(f"{sensor.channel} drifts: its mean wanders by up to {most:.3g} within a block, in "
                         f"{int(drifting.sum())} of {n_block} blocks")
        elif like and between[sensor.channel] > WANDER and between[like].median() < between[sensor.channel] / 4:
            change = offset[sensor.channel].max() - offset[sensor.channel].min()
            found.append(f"{sensor.channel} has a mean that changes by {change:.3g} between blocks, "
                         f"{between[sensor.channel]:.1f} times its vibration")
    return found


def _compare_neighbours(table: pd.DataFrame, sensors: Sequence[Sensor]) -> list[str]:
    """Channels of one level, direction and quantity, by the size of their motion."""
    rms = table.groupby("channel")["rms"].median()
    found, sensors = [], name_levels(sensors)
    for k, sensor in enumerate(sensors):
        like = [s.channel for i, s in enumerate(sensors) if i != k and s.level == sensor.level
                and s.quantity == sensor.quantity and abs(float(s.direction @ sensor.direction)) > 0.9]
        if len(like) >= 2 and rms[sensor.channel] > 0 and rms[like].median() > 0:
            ratio = rms[sensor.channel] / rms[like].median()
            if not 1 / SCALE_FACTOR < ratio < SCALE_FACTOR:
                found.append(f"suspect: {sensor.channel} moves {ratio:.3g} times as much as channels beside it: wrong "
                             f"unit or scale?{unit_hint(ratio).replace(',', ' It is', 1)}")
    return found


# Channels against one another ---------------------------------------------------------------------------------------


def mounting_findings(
    compared: Sequence[ComparedBlock], mentioned: Sequence[str], away: Collection[str] = (),
    cause: Callable[[str], str] = lambda channel: "",
) -> list[str]:
    """Suspicions that return; `mentioned` sentences are not said again, and channels whose clocks ran `away` from the
    others' are not dead for that. cause: words, if any, on why a channel has nothing in common with the others."""
    seen: dict[tuple, list[tuple[int, Suspicion]]] = {}
    for number, block in enumerate(compared):
        for one in block.suspicions:
            apart = [one.channels] if one.kind in (mounting.SWAPPED, mounting.LEVEL_SCALED, mounting.COPIED) else [
                (c,) for c in one.channels]
            for channels in apart:
                seen.setdefault((one.kind, channels), []).append((number, one))
    named: set[str] = set()
    found = []
    for (kind, channels), cases in sorted(seen.items(), key=lambda item: -len(item[1])):
        numbers = [n for n, _ in cases]
        if set(channels) & named or not _returns(numbers, len(compared)):
            continue
        if kind == mounting.DEAD and set(channels) & set(away):
            continue
        named |= set(channels)
        if kind == mounting.DEAD and (why := cause(channels[0])):
            found.append(f"suspect: {channels[0]} has nothing in common with any other channel, yet {why}")
            continue
        sentence = _sentence(kind, channels, [s for _, s in cases])
        if kind == mounting.SCALED and any(m.startswith(f"suspect: {channels[0]} moves") for m in mentioned):
            continue
        where = f"in {len(numbers)} of {len(compared)} blocks compared"
        if len(numbers) < 0.75 * len(compared):
            where += f", from {compared[numbers[0]].id} to {compared[numbers[-1]].id}"
            # not before it, and in each from there on
            if numbers == list(range(numbers[0], len(compared))):
                where += f"; {OR_STRUCTURE}"
        found.append(f"{sentence} ({where})")
    return found


def apart_findings(
    compared: Sequence[ComparedBlock], channels: Sequence[str], mentioned: Sequence[str], away: Collection[str],
    cause: Callable[[str, Sequence[str]], str],
) -> list[str]:
    """Sentences on channels that in enough of the blocks move with none of the others that they could be compared
    with, where `cause`, of a channel and all of them, has words on why; but those `mentioned` or `away`."""
    lone = [name for c, name in enumerate(channels)
            if _returns([k for k, b in enumerate(compared) if b.apart[c]], len(compared))]
    each: dict[str, list[str]] = {}
    for name in lone:
        if name not in away and not any(name in said for said in mentioned) and (why := cause(name, lone)):
            each.setdefault(why, []).append(name)
    return [f"suspect: {', '.join(names)} {'have' if len(names) > 1 else 'has'} nothing in common with the other "
            f"channels of their direction, yet {why}" for why, names in each.items()]


def _returns(numbers: Sequence[int], total: int) -> bool:
    if len(numbers) >= max(2 if total > 1 else 1, SHARE * total):
        return True
    return any(sum(n <= k < n + ROW for k in numbers) >= IN_A_ROW for n in numbers)


def _sentence(kind: str, channels: tuple[str, ...], cases: list[Suspicion]) -> str:
    name, size = ", ".join(channels), float(np.median([c.size for c in cases]))
    alternatives = [c for c, n in Counter(r for one in cases for r in one.ambiguous_with).items() if n > len(cases) / 2]
    alternatives = [r for r in alternatives if r not in channels]
    if kind == mounting.SWAPPED:
        text = f"suspect: {channels[0]} and {channels[1]} look swapped"
    elif kind == mounting.FLIPPED:
        text = f"suspect: {name} looks flipped: it has the opposite sign; turn its direction in campaign.toml once "
        text += "its mounting has been looked at"
    elif kind == mounting.TURNED:
        text = f"suspect: {name} looks turned by about {size:.0f} deg from its stated direction, or is another channel"
    elif kind == mounting.DEAD:
        text = f"suspect: {name} looks dead: it has nothing in common with any other channel, "
        text += "as without a sensor, or with a clock or a sampling rate far from theirs"
    elif kind == mounting.COPIED:
        text = f"suspect: {channels[0]} and {channels[1]} are one signal at every frequency"
        text += ("" if 0.999 < size < 1.001 else f", of {size:.3g} times the size") + ": is one of them a copy?"
    elif kind == mounting.LEVEL_SCALED:
        text = f"suspect: {name} move {size:.3g} times what the levels around them suggest: wrong unit or scale?"
    else:
        lead = float(np.median([c.lead_deg for c in cases]))
        text = f"suspect: {name} reads {size:.3g} times what other channels suggest"
        text += f": wrong unit or scale?{unit_hint(size).replace(',', ' It is', 1)}" if not lead else (
            f" in the lowest motion, {abs(lead):.0f} deg {'ahead' if lead > 0 else 'behind'}, which no scale makes: a "
            f"frequency response of its own ({'high' if lead > 0 else 'low'}-pass)? Look at its filter or leave it out")
    return text + (f"; it may be {', '.join(alternatives)} instead" if alternatives else "")


def sensor_findings(
    campaign: Campaign, compared: Sequence[ComparedBlock], sways: Sequence[Sway], mentioned: Sequence[str]
) -> tuple[list[SensorFinding], list[str]]:
    """What sensors say of one another over the whole campaign: gains that change, gains by rigid parts, the nacelle's
    heading; and what these comparisons can show. Channels that a sentence of `mentioned` names are judged by that."""
    lowest = [b.lowest_hz for b in compared if np.isfinite(b.lowest_hz)]
    if not lowest:
        return [], []
    lowest_hz = float(np.median(lowest))
    pieces = [p for b in compared for p in b.pieces]
    found, use = gain_steps(pieces, campaign.sensors, lowest_hz)
    uses = [use] if use else []
    parts = parts_of_campaign(pieces, lowest_hz)
    if parts is not None:
        density, known = parts
        steady = [*mentioned, *(f.message for f in found)]
        gains, use = campaign_gains(density, [campaign.sensors[k] for k in known], steady)
        found, uses = [*found, *gains], [*uses, *([use] if use else [])]
    if sways or (campaign.scada is not None and "nacelle_heading_deg" in campaign.scada):
        heading, use = heading_findings(heading_offset(sways, campaign.x_axis_heading_deg, lowest_hz))
        found, uses = [*found, *heading], [*uses, *([use] if use else [])]
    return found, uses


# Clocks and rates ---------------------------------------------------------------------------------------------------


def runaway_clocks(compared: Sequence[ComparedBlock], channels: Sequence[str]) -> dict[str, tuple[float, str]]:
    """Channel -> (s a day that its clock loses, the last block in which that was followed), of clocks whose drift over
    the campaign is beyond the range in which delays are sought: by the drifts within blocks, or the steps between
    neighbouring ones, which delays that are lost or found at a wrong period do not spoil."""
    found = {}
    days = np.array([(b.start - compared[0].start) / pd.Timedelta(days=1) for b in compared])
    for c, name in enumerate(channels):
        # not known of channels that a block could not compare
        within = [k for k, b in enumerate(compared) if np.nan_to_num(b.drift[c])]
        if not within:
            continue
        drift = 86400 * float(np.median([compared[k].drift[c] for k in within]))
        if np.std([86400 * compared[k].drift[c] for k in within]) > EVEN_STEPS * abs(drift):
            continue
        # farther off than a segment is long, channels have nothing in common
        near = np.abs(drift * (days - np.median(days[within]))) < SEGMENT_S
        if len(within) >= SHARE * sum(np.isfinite(b.drift[c]) for b, one in zip(compared, near, strict=True) if one):
            found[name] = drift, compared[within[-1]].id
    if len(days) < FEWEST_STEPS + 1:
        return found
    usual = float(np.median(np.diff(days)))
    near = np.diff(days) < 1.5 * usual
    for c, name in enumerate(channels):
        delay = np.array([b.delay_s[c] for b in compared])
        step = np.diff(delay)
        known = np.flatnonzero(np.isfinite(step) & near)
        if len(known) < FEWEST_STEPS:
            continue
        middle = float(np.median(step[known]))
        scatter = 1.4826 * float(np.median(np.abs(step[known] - middle)))
        drift = middle / usual
        if scatter < EVEN_STEPS * abs(middle) and abs(drift) * (np.ptp(days) + usual) > LARGEST_DELAY_S:
            followed = known[np.abs(step[known] - middle) < 0.5 * abs(middle)]
            found[name] = drift, compared[int(followed[-1]) + 1].id
    return found


def clock_findings(compared: Sequence[ComparedBlock], channels: Sequence[str]) -> tuple[list[str], str | None]:
    """Sentences on late channels, and one on what the comparison can resolve (None where nothing was compared)."""
    if not compared:
        return [], None
    delay = np.array([b.delay_s for b in compared])
    if not np.isfinite(delay).any():
        return [], None
    days = np.array([(b.start - compared[0].start) / pd.Timedelta(days=1) for b in compared])
    centre, error, slope = (np.full(len(channels), np.nan) for _ in range(3))
    for c in range(len(channels)):
        known = np.isfinite(delay[:, c])
        if known.sum() < min(2, len(compared)):
            continue
        values = delay[known, c]
        slope[c], scatter = _trend(days[known], values)
        centre[c] = np.median(values)
        theirs = np.median([b.delay_std_s[c] for b, good in zip(compared, known, strict=True) if good])
        error[c] = np.hypot(theirs, scatter / np.sqrt(known.sum()))
    away = runaway_clocks(compared, channels)
    jumps = _clock_jumps(compared, channels, away)
    late = [c for c in range(len(channels)) if abs(centre[c]) > max(LEAST_DELAY_S, SIGMA * error[c])
            and channels[c] not in {*away, *jumps}]
    found = [f"suspect: the clock of {name} {text}" for name, text in jumps.items()]
    found += [f"suspect: the clock of {name} drifts by {1e3 * drift:+.0f} ms a day ({drift / 0.0864:+.4g} ppm) against "
             f"the median channel, as followed until {last}; beyond {LARGEST_DELAY_S:g} s channels are not compared: "
             "resample it to the others' clock, or leave it out" for name, (drift, last) in away.items()]
    while late:
        first = max(late, key=lambda c: abs(centre[c]))
        group = [c for c in late if abs(centre[c] - centre[first]) < max(
            LEAST_DELAY_S, SIGMA * np.hypot(error[c], error[first]))]
        late = [c for c in late if c not in group]
        found.append(_late_clock_words([channels[c] for c in group], *(
            float(np.median(x[group])) for x in (centre, error, slope))))
    if not np.isfinite(error).any():
        return [], None
    followed = [e for c, e in enumerate(error) if np.isfinite(e) and channels[c] not in {*away, *jumps}]
    resolved = 1e3 * max(LEAST_DELAY_S, SIGMA * max(followed, default=0.0))
    apart = [name for name, c in zip(channels, centre, strict=True) if not np.isfinite(c)]
    named = (f" (not {', '.join(apart)}: half of the samples lost, few motions in common, or a phase of its own)"
             if 2 * len(apart) < len(channels) and apart else "")
    return found, (f"clocks of {len(channels) - len(apart)} of {len(channels)} channels compared{named}; differences "
                   f"of {resolved:.1f} ms or more would show")


def _late_clock_words(names: Sequence[str], late_s: float, std_s: float, slope_s: float) -> str:
    """Of channels whose clocks differ from the median channel's alike, by seconds and by seconds a day."""
    text = (f"suspect: the clock of {', '.join(names)} is {1e3 * abs(late_s):.1f} +- {1e3 * std_s:.1f} ms "
            f"{'ahead of' if late_s > 0 else 'behind'} the median channel: what happens is recorded "
            f"{'late' if late_s > 0 else 'early'}")
    if len(names) > 1:
        # of two loggers the one with fewer channels is not the wrong one for that
        text += (f" by them, or {'early' if late_s > 0 else 'late'} by the others: only the difference between loggers "
                 "is known")
    text += ", as behind a low-pass filter too" * (late_s > 0)
    return text + (f", and it changes by {1e3 * slope_s:+.1f} ms a day ({slope_s / 0.0864:+.2f} ppm)" * bool(slope_s))


def phase_findings(
    compared: Sequence[ComparedBlock], channels: Sequence[str], mentioned: Sequence[str], away: Collection[str]
) -> list[str]:
    """Sentences on channels whose phase against the others is no clock's in more than half of the blocks, but those
    that a sentence of `mentioned` names and those whose clocks ran `away`."""
    bent = np.mean([np.isinf(b.delay_std_s) for b in compared], axis=0) > 0.5 if compared else ()
    return [f"suspect: {name} moves with the channels of its direction, yet no clock within {LARGEST_DELAY_S:g} s of "
            "theirs makes its phase against them: a filter or a mount of its own, or a clock farther off; mend it or "
            "leave the channel out" for name, own in zip(channels, bent, strict=bool(compared))
            if own and name not in away and not any(
                name in sentence for sentence in mentioned if sentence.startswith("suspect"))]


def _clock_jumps(
    compared: Sequence[ComparedBlock], channels: Sequence[str], away: Collection[str]
) -> dict[str, str]:
    """Channel -> what is said of it, of those not `away` whose delays jump once rather than follow a line."""
    found = {}
    for c, name in enumerate(channels):
        delay = np.array([b.delay_s[c] for b in compared])
        known = np.flatnonzero(np.isfinite(delay))
        y = delay[known]
        if len(y) < 6 or name in away:
            continue
        line = np.sum((y - np.polyval(np.polyfit(known, y, 1), known)) ** 2)
        step = [len(y[:k]) * np.var(y[:k]) + len(y[k:]) * np.var(y[k:]) for k in range(2, len(y) - 1)]
        at, left = int(np.argmin(step)) + 2, max(min(step), 1e-300)
        apart = float(np.median(y[at:]) - np.median(y[:at]))
        # a place in time is one more that is free
        if len(y) * np.log(max(line, 1e-300) / left) > 2 * np.log(len(y)) and abs(apart) > max(
                LEAST_DELAY_S, 2 * SIGMA * np.sqrt(left / len(y))):
            found[name] = (f"jumps by {1e3 * apart:+.0f} ms against the median channel in {compared[known[at]].id}, as "
                           "one that is set: shift its record on one side, or leave the channel out")
    return found


def _trend(days: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """(slope a day, robust scatter about the line or the median); 0 where no line is significant."""
    scatter = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    if len(values) < 6 or np.ptp(days) <= 0:
        return 0.0, scatter
    near = np.abs(values - np.median(values)) < max(4 * scatter, 1e-4)
    x, y = days[near] - days[near].mean(), values[near]
    if near.sum() < 6 or x @ x <= 0:
        return 0.0, scatter
    slope = float(x @ y / (x @ x))
    rest = float(np.std(y - y.mean() - slope * x))
    if abs(slope) * np.ptp(days) > LEAST_DELAY_S and abs(slope) > 6 * rest / np.sqrt(x @ x):
        return slope, rest
    return 0.0, scatter


def rate_findings(campaign: Campaign, ratio: RateRatio) -> tuple[list[str], str | None]:
    """Sentences on the sampling rate, by the rotor's lines and by the files' own starts."""
    found, rate = [], campaign.sampling_rate_hz
    use = None
    if np.isfinite(ratio.ratio):
        low, high = rate / (ratio.ratio + 2 * ratio.std), rate / (ratio.ratio - 2 * ratio.std)
        if abs(ratio.ratio - 1) > max(RATE_LIMIT, SIGMA * ratio.std):
            found.append(f"suspect: lines of the rotor lie at {ratio.ratio:.3f} +- {ratio.std:.3f} times the frequency "
                         f"that SCADA's rotor speed gives: the true sampling rate would be {low:.4g} to {high:.4g} Hz")
        else:
            use = (f"rotor lines agree with SCADA within {100 * max(abs(ratio.ratio - 1), ratio.std):.1f} %: the "
                   f"sampling rate is {low:.4g} to {high:.4g} Hz ({ratio.rows} rows)")
    ratios = []
    for a, b in zip(campaign.files[:-1], campaign.files[1:], strict=True):
        between = (b.start - a.start).total_seconds()
        if between > 0 and abs(a.n_sample / rate - between) < 0.3 * between:
            ratios.append(a.n_sample / rate / between)
    if len(ratios) >= 3:
        middle, length = float(np.median(ratios)), float(np.median([f.n_sample for f in campaign.files])) / rate
        apart = abs(middle - 1)
        # a clock that is wrong is so by the same in every file, to a second in its start; gaps are not
        alike = np.abs(np.array(ratios) - middle) < min(0.1 * apart, max(0.02 * apart, 1 / length))
        few = 2.5 / np.median([f.n_sample for f in campaign.files])
        # a logger that pauses after each whole block that it records
        held = length / (60 * campaign.block_minutes)
        pauses = middle < 1 and abs(held - round(held)) < few
        if abs(middle - 1) > max(few, 2e-5) and alike.mean() > 0.6 and not pauses:
            found.append(f"suspect: files hold {middle:.5g} times the samples that fit between their starts: the true "
                         f"sampling rate would be {rate * middle:.6g} Hz")
    return found, use


# All channels together ----------------------------------------------------------------------------------------------


def _gravity_findings(
    table: pd.DataFrame, sensors: Sequence[Sensor], mentioned: Sequence[str]
) -> tuple[list[str], str]:
    """Channels whose mean has the sign that gravity does not have along their direction, and a sentence where gravity
    has another size than it should (else ""). Nothing where fewer than half of the vertical channels hold gravity in
    their mean. At rest an accelerometer reads its direction's z times g."""
    felt = [s for s in sensors if abs(s.direction[2]) > 0.3 and s.quantity == "acceleration"]
    offset = table.groupby("channel")["offset"].median()
    read = np.array([offset[s.channel] / s.direction[2] for s in felt])
    upright = np.abs(read[[abs(s.direction[2]) > 0.9 for s in felt]])
    factor, unit = next(((f, u) for f, u in GRAVITY_READ if 2 * np.sum(abs(upright / (f * GRAVITY) - 1) < 0.03)
                         > len(upright)), (0.0, ""))
    if not factor:
        return [], ""
    held = np.abs(np.abs(read) / (factor * GRAVITY) - 1) < GRAVITY_SPREAD
    # where most agree on the other sign their logger counts gravity's pull, and they are right among one another
    sign = -1.0 if np.sum(read[held] < 0) > max(1, np.sum(read[held] > 0)) else 1.0
    found = []
    for s in (s for s, mean, holds in zip(felt, read, held, strict=True) if holds and sign * mean < 0):
        value = offset[s.channel] / UNITS[s.quantity][s.unit]
        if not any(m.startswith(f"suspect: {s.channel} looks flipped") for m in mentioned):
            found.append(f"suspect: {s.channel} looks flipped: its mean is {value:+.3g} {s.unit}, where gravity reads "
                         f"{-value:+.3g} {s.unit} along its direction{' by the other channels' if sign < 0 else ''}; "
                         "turn its direction in campaign.toml once its mounting has been looked at")
    return found, f"suspect: vertical channels read gravity as {factor * GRAVITY:.3g} m/s2; {unit}" if unit else ""


def scale_findings(
    table: pd.DataFrame, states: Mapping[str, str], sensors: Sequence[Sensor], mentioned: Sequence[str]
) -> list[str]:
    """The size of everything: gravity in vertical channels, and the top's acceleration against what turbines have.
    Channels that a sentence of `mentioned` suspects already do not count."""
    found, unit = _gravity_findings(table, sensors, mentioned)
    if unit:
        return [*found, unit]
    across = [s for s in sensors if abs(s.direction[2]) < 0.3 and s.quantity == "acceleration"]
    if not across or not mounting.is_upright(tuple(sensors)):
        return found
    top = max(s.position_m[2] for s in across)
    names = [s.channel for s in across if s.position_m[2] > top - 1e-6
             and not any(s.channel in sentence for sentence in mentioned)]
    rows = table[table["channel"].isin(names) & ~table["flat"]]
    state = rows["id"].map(states)
    for kind, wanted in (("running", ("below rated", "rated")), ("idling", ("idling",)), ("any", None)):
        mine = rows if wanted is None else rows[state.isin(wanted)]
        if not len(mine) or (wanted is not None and top < 40):
            continue
        middle, (low, high) = float(mine["rms"].median()), PLAUSIBLE[kind]
        # of records without a sample nothing moves, which is said elsewhere
        if np.isfinite(middle) and not low < middle < high:
            when = {"running": "while it runs", "idling": "while it idles", "any": "in all blocks"}[kind]
            found.append(f"suspect: the top moves with {middle:.2g} m/s2 (median deviation {when}) where {low:g} to "
                         f"{high:g} is usual: are all channels in the stated unit?")
            break
    return found
