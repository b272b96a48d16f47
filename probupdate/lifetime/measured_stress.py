"""Stresses at hot spots of the blocks of a campaign: loads estimated from the readings, at a posterior's parameters.

Of every block the damage-equivalent ranges and the damage of each hot spot follow from the moments of its stress
spectrum, expectation plus what the sensors do not resolve; of the worst ones the history is counted by rainflow as a
second route. What the posterior leaves open is carried by draws: the same blocks at other parameters, with the loads
learnt again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import gammaln

from probupdate.campaign.blocks import Block, block_files, block_id, read_block
from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule, block_conditions
from probupdate.errors import InputError
from probupdate.identification.environment import fore_aft_deg
from probupdate.io.result_table import plural
from probupdate.lifetime.conditions import Conditions, read_conditions, thrust_spectra
from probupdate.lifetime.damping import StateDamping
from probupdate.lifetime.details import Detail, HotSpot, thickness_effects, weights
from probupdate.lifetime.fatigue import SLOPES, fatigue_model_of
from probupdate.lifetime.gauges import GaugeCheck, GaugeFiles, Gauges, gauge_comparison, read_gauges
from probupdate.lifetime.load_estimate import (
    INTEGRATED,
    LoadedStructure,
    Smoother,
    loaded_structure,
    smoother,
    used_lines,
    wind_cases,
)
from probupdate.lifetime.modal_stress import paired_moments
from probupdate.lifetime.spectral import ORDERS, RECORD_S, counted_share, rainflow, ranges
from probupdate.lifetime.stress import Case, StressModel
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.load import resting_angle_deg

# nacelle headings are taken to the nearest of these steps: thrust and waves across the wind are unknowns too
HEADING_STEP_DEG = 30.0
# ends of a block that fade, each as a share of it: what leaks from them is below 1e-4 of a resonance's amplitude there
FADE = 0.05
# modes with a force of their own
MODAL = 10
# blocks at which draws are evaluated, spread over the record; blocks of which the cross spectra are a mean
DRAWN_BLOCKS, LEARNT_BLOCKS = 6, 24
# of so many pairs of heading and state, those with most blocks
DRAWN_GROUPS = 4
# a channel with more samples lost than this is left out of a block; fewer are taken as zero, a thousandth of its power
LOST = 1e-3
# variance of a spot's stress that the sensors must resolve: the rest then adds at most 5 % to its ranges
OBSERVABLE = 0.9
RESAMPLED = 400
# on stress ranges, for the power with which damage grows
FACTOR = 1.02
IDLING = "idling"
NO_GAUGE = "no gauge recorded a whole block of the campaign"
GAUGE_TIMES = "give times in UTC, as the campaign's records have them"
# cosine of eight degrees, as rounded directions may differ
SAME_DIRECTION = 0.99


@dataclass(frozen=True, kw_only=True)
class StressSettings:
    """n_draw: draws of the posterior that carry its uncertainty; n_worst: hot spots whose history is written and
    counted; seed of both; since: when the state of the structure began that the draws are of, None for all blocks."""

    n_draw: int = 8
    n_worst: int = 6
    seed: int = 1
    since: pd.Timestamp | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockStress:
    """Of one block: equivalent_mpa (2, n_spot) constant ranges that at one cycle a second do the same damage, for m = 3
    and 5; damage_per_hour, exponent, resolved (n_spot,): Miner's sum, the power of a factor on all ranges with which it
    grows, and the share of the stress' variance that the readings resolve; n_channel: whole channels."""

    id: str
    state: str
    conditions: Mapping[str, float | str]
    heading_deg: float
    equivalent_mpa: np.ndarray
    damage_per_hour: np.ndarray
    exponent: np.ndarray
    resolved: np.ndarray
    n_channel: int


@dataclass(frozen=True, eq=False, kw_only=True)
class History:
    """Nominal hot-spot stress of a block in MPa: time_s (n_sample,), stress_mpa (n_sample, n_worst), and the damage
    of its ten-minute pieces by rainflow over that of the same history by its spectrum (n_worst,)."""

    id: str
    time_s: np.ndarray
    stress_mpa: np.ndarray
    rainflow_over_spectrum: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredStress:
    """blocks; the spots with their details; worst (n_worst,) spots; draw_ratio (n_draw, n_spot): damage at each draw
    over that at the posterior's mean; stated_per_hour: of each state the damage (n_spot,) by the loads of
    fatigue.toml; gauges: strain gauges beside the estimate, where some were given."""

    blocks: tuple[BlockStress, ...]
    details: tuple[Detail, ...]
    spots: tuple[HotSpot, ...]
    conditions: Conditions
    worst: np.ndarray
    draw_ratio: np.ndarray
    stated_per_hour: Mapping[str, np.ndarray]
    histories: tuple[History, ...]
    left_out: tuple[str, ...]
    seed: int
    gauges: GaugeCheck | None = None

    @cached_property
    def resolved(self) -> np.ndarray:
        """(n_spot,) share of the variance that the readings resolve, weighted by damage over the blocks."""
        weight = np.array([b.damage_per_hour for b in self.blocks]) + 1e-300
        return np.sum(weight * np.array([b.resolved for b in self.blocks]), axis=0) / np.sum(weight, axis=0)

    @cached_property
    def observable(self) -> np.ndarray:
        """(n_spot,) whether it is at least OBSERVABLE."""
        return self.resolved >= OBSERVABLE

    def per_year(self) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
        """Damage of a year (n_spot,) and its 5, 50 and 95 % quantiles (3, n_spot), each state's mean by its share of
        fatigue.toml, and the shares of the year that were measured, state by state. The quantiles carry the blocks'
        scatter, the posterior, and the uncertainty of stresses (x_scf) that fatigue.toml states; the mean is at the
        median of x_scf."""
        shares = {s.name: s.share for s in self.conditions.state}
        by_state = {name: np.array([b.damage_per_hour for b in self.blocks if b.state == name]) for name in shares}
        measured = {name: shares[name] for name, own in by_state.items() if len(own)}
        hours = 24 * 365.25
        mean = hours * sum(share * by_state[name].mean(axis=0) for name, share in measured.items())
        rng = np.random.default_rng(self.seed)
        weight = np.array([b.damage_per_hour for b in self.blocks]) + 1e-300
        power = np.sum(weight * np.array([b.exponent for b in self.blocks]), axis=0) / np.sum(weight, axis=0)
        stated = self.conditions.uncertainty.x_scf
        mean = mean * stated.median**power
        spread = np.sqrt(np.log1p(stated.cov**2))
        drawn = []
        for _ in range(RESAMPLED):
            total = np.zeros(len(self.spots))
            for name, share in measured.items():
                own = by_state[name]
                total += share * own[rng.integers(len(own), size=len(own))].mean(axis=0)
            factor = stated.median * np.exp(spread * rng.standard_normal())
            drawn.append(hours * total * self.draw_ratio[rng.integers(len(self.draw_ratio))] * factor**power)
        return mean, np.quantile(drawn, (0.05, 0.5, 0.95), axis=0), measured


@dataclass(frozen=True, eq=False, kw_only=True)
class _PlannedBlock:
    """A usable block: where it lies, and under which heading and stated loads it is looked at."""

    start: pd.Timestamp
    files: tuple
    conditions: Mapping[str, float | str]
    heading_deg: float
    state: int


def measured_stresses(
    campaign: Campaign, model: Path, fatigue: Path, draws: np.ndarray, damping: StateDamping, *,
    names: Sequence[str] = (), without: Sequence[str] = (), settings: StressSettings | None = None,
    gauges: GaugeFiles | None = None, progress: Progress = silent,
) -> MeasuredStress:
    """Of all blocks of a campaign that are whole. model: its TOML; draws (n, n_param) of its posterior, of
    parameters of these names where they are given; damping: measured ratios; without: channels not to be used.

    Raises InputError where no channel of the campaign is one of the model's, one measures along another direction
    there, or no block is whole."""
    settings = settings or StressSettings()
    conditions = read_conditions(fatigue)
    spectra = thrust_spectra(conditions, fatigue)
    every = _plan(campaign, conditions, resting_angle_deg(model))
    planned = [p for p in every if settings.since is None or p.start >= settings.since]
    earlier = _earlier_notes(len(every) - len(planned), settings)
    if earlier and not planned:
        raise InputError(str(campaign.path), f"has no other blocks than {earlier[0]}", "give records of that state")
    work = _Work(campaign, model, conditions, spectra, draws, names, damping, tuple(without), settings)
    gauges = gauges or GaugeFiles()
    known, work.joined = (None if path is None else read_gauges(path, len(work.spots))
                          for path in (gauges.held_out, gauges.joined))
    groups: dict[tuple[float, int], list[_PlannedBlock]] = {}
    for one in planned:
        groups.setdefault((one.heading_deg, one.state), []).append(one)
    found, ratios, stated, beside = [], [], {}, []
    done, largest = 0, sorted(groups, key=lambda key: (-len(groups[key]), key))[:DRAWN_GROUPS]
    for (heading, state), own in sorted(groups.items()):
        group = work.group(heading, state, own)
        for one in own:
            progress("stresses", done, len(planned))
            found.append(group.block(one))
            beside.append(None if known is None else group.check_gauges(one, known))
            done += 1
        if (heading, state) in largest:
            ratios.append(group.draw_ratio(own))
        if conditions.state[state].name not in stated:
            stated[conditions.state[state].name] = group.stated_per_hour()
    progress("stresses", len(planned), len(planned))
    blocks = tuple(sorted((b for b in found if b is not None), key=lambda b: b.id))
    if not blocks:
        raise InputError(str(campaign.path), "no block is whole with a channel of the model in it",
                         "see `probupdate check` for what its records lack")
    if gauges.joined is not None and not work.with_strain:
        raise InputError(str(gauges.joined), NO_GAUGE, GAUGE_TIMES)
    damage = np.array([b.damage_per_hour for b in blocks])
    worst = _worst_of_each_side(work.spots, damage.mean(axis=0), settings.n_worst)
    top = blocks[int(np.argmax(np.max(damage[:, worst] / damage.mean(axis=0)[worst], axis=1)))].id
    histories = work.histories([p for p in planned if work.block_id_of(p) == top], worst)
    counted = [r for r in ratios if r is not None]
    return MeasuredStress(
        blocks=blocks, details=work.details, spots=work.spots, conditions=conditions, worst=frozen_array(worst, int),
        draw_ratio=np.mean(counted, axis=0) if counted else np.ones((1, len(work.spots))), stated_per_hour=stated,
        histories=tuple(histories), left_out=(*earlier, *work.notes(planned)), seed=settings.seed,
        gauges=None if gauges.held_out is None else _join_gauge_rows(beside, gauges.held_out))


def _join_gauge_rows(beside: Sequence[GaugeCheck | None], path: str | Path) -> GaugeCheck:
    """All blocks' rows by time, with the first block's histories."""
    some = sorted((one for one in beside if one is not None), key=lambda one: one.block)
    if not some:
        raise InputError(str(path), NO_GAUGE, GAUGE_TIMES)
    return replace(some[0], rows=tuple(row for one in some for row in one.rows))


def _refuse_turned(campaign: Campaign, stated: Mapping[str, np.ndarray], channels: Sequence[str]) -> None:
    """Raises InputError for a channel that the model has along another direction than the campaign."""
    for sensor in campaign.sensors:
        if sensor.channel not in channels or sensor.channel not in stated:
            continue
        own, models = (np.asarray(d, float) for d in (sensor.direction, stated[sensor.channel]))
        if own @ models < SAME_DIRECTION:
            raise InputError(f"{campaign.path}: channel {sensor.channel}", f"measures along {own.round(3).tolist()}, "
                             f"in the model along {models.round(3).tolist()}",
                             "state the sensor's direction alike in both")


def _plan(campaign: Campaign, conditions: Conditions, resting_deg: float) -> list[_PlannedBlock]:
    """resting_deg: where the nacelle looks in the model's file, from which headings of stresses count."""
    rule = StateRule(rated_power_kw=campaign.rated_power_kw)
    found = []
    for start, files in block_files(campaign).items():
        known = block_conditions(campaign.scada, start, campaign.block_minutes, rule)
        # a nacelle that no column tells of looks where it does in the file
        angle = fore_aft_deg(known, campaign) - resting_deg if known.get("nacelle_heading_deg") is not None else 0.0
        heading = HEADING_STEP_DEG * round(angle / HEADING_STEP_DEG) % 360
        found.append(_PlannedBlock(start=start, files=files, conditions=known, heading_deg=heading,
                                   state=_nearest_state(conditions, known)))
    return found


def _earlier_notes(earlier: int, settings: StressSettings) -> tuple[str, ...]:
    return (f"{plural(earlier, 'block')} before {settings.since:%Y-%m-%dT%H:%MZ}, when the structure changed: the "
            "draws are of the state after",) if earlier else ()


def _nearest_state(conditions: Conditions, known: Mapping[str, float | str]) -> int:
    """Number of the state of fatigue.toml that a block is most like: of its operation, where it is known, and of the
    nearest wind."""
    wind, state = known.get("wind_speed_mps"), known.get("state")
    alike = [k for k, s in enumerate(conditions.state)
             if state in (None, "unknown", "mixed") or s.operating != (state == IDLING)]
    alike = alike or list(range(len(conditions.state)))
    if wind is None:
        return alike[0]
    return min(alike, key=lambda k: abs(conditions.state[k].wind_mps - float(wind)))


def _state_notes(planned: Sequence[_PlannedBlock], conditions: Conditions) -> Iterator[str]:
    """Of blocks whose state of fatigue.toml is not the turbine's."""
    def names(blocks: Sequence[_PlannedBlock]) -> str:
        return ", ".join(dict.fromkeys(f"'{conditions.state[p.state].name}'" for p in blocks))

    if windless := [p for p in planned if p.conditions.get("wind_speed_mps") is None]:
        yield (f"no wind speed is known of {plural(len(windless), 'block')}: the first state of fatigue.toml, "
               f"{names(windless)}, is taken for it, with its share of the year; give the wind in scada.csv")
    for idles, word in ((True, "idling"), (False, "operating")):
        other = [p for p in planned if p.conditions.get("state") not in (None, "unknown", "mixed")
                 and (p.conditions["state"] == IDLING) == idles == conditions.state[p.state].operating]
        if other:
            yield (f"fatigue.toml has no {word} state: {plural(len(other), f'{word} block')} count as {names(other)}; "
                   "state one")


def _worst_of_each_side(spots: Sequence[HotSpot], damage: np.ndarray, n: int) -> np.ndarray:
    """(n,) spots of most damage, one of each side of a detail."""
    seen: dict[tuple[int, str], int] = {}
    for k in np.argsort(-damage):
        seen.setdefault((spots[k].detail, spots[k].side), int(k))
    return np.array(list(seen.values())[:n])


class _Work:
    """What all blocks share: stress models by heading, and the lines of a block."""

    def __init__(self, campaign, model, conditions, spectra, draws, names, damping, without, settings):
        self.campaign, self.conditions, self.damping, self.settings = campaign, conditions, damping, settings
        self._model, self._spectra = model, spectra
        # what campaign.toml states of gravity in the readings
        self._felt = {s.channel: bool(s.gravity) for s in campaign.sensors}
        rng = np.random.default_rng(settings.seed)
        self.draws = draws[rng.choice(len(draws), size=min(settings.n_draw, len(draws)), replace=False)]
        self.mean = draws.mean(axis=0)
        self._headings: dict[float, StressModel] = {}
        # gauges that take part, and whether any recorded a block
        self.joined: Gauges | None = None
        self.with_strain = False
        first = self.model_at(0.0)
        if names and tuple(names) != tuple(first.parameters.names):
            raise InputError(str(model), f"has the parameters {', '.join(first.parameters.names)}, the posterior "
                             f"{', '.join(names)}", "sample again with this model")
        n = round(campaign.block_minutes * 60 * campaign.sampling_rate_hz)
        self.number, self.frequency_hz = used_lines(n, campaign.sampling_rate_hz)
        if len(self.frequency_hz) < 6:
            raise InputError(str(campaign.path), f"blocks of {campaign.block_minutes:g} minutes hold no slow stress",
                             "give block_minutes of ten and more in campaign.toml")
        ramp = 0.5 * (1 - np.cos(np.pi * (np.arange(round(FADE * n)) + 0.5) / round(FADE * n)))
        self.window = np.concatenate([ramp, np.ones(n - 2 * len(ramp)), ramp[::-1]])
        self.to_density = np.sqrt(2 / (campaign.sampling_rate_hz * np.sum(self.window**2)))
        known = {s.channel: s for s in campaign.sensors}
        self.channels = tuple(c for c in first.model.channels if c in known and c not in without)
        if not self.channels:
            raise InputError(str(campaign.path), f"none of its channels ({', '.join(known)}) is one of the model's "
                             f"({', '.join(first.model.channels)})", "name the sensors alike in both files")
        _refuse_turned(campaign, {s.channel: s.direction for s in first.sensors}, self.channels)
        self.unused = tuple(c for c in known if c not in self.channels)
        self.columns = np.array([campaign.channels.index(c) for c in self.channels])
        self.rows = np.array([first.model.channels.index(c) for c in self.channels])
        self.order = np.zeros(len(first.model.channels), int)
        self.order[self.rows] = [INTEGRATED[known[c].quantity] for c in self.channels]

    def model_at(self, heading_deg: float) -> StressModel:
        """Reduced to what wind and waves from both ways make of it, about the draws."""
        if heading_deg not in self._headings:
            one = self.conditions.direction[0].model_copy(update={"heading_deg": heading_deg, "share": 1.0})
            made = fatigue_model_of(self._model, self.conditions.model_copy(update={"direction": (one,)}),
                                    spectra=self._spectra)
            self.details, self.spots = made.details, made.spots
            stress = made.models[0]
            stress = replace(stress, model=stress.model.with_gravity(self._felt))
            self._headings[heading_deg] = stress.reduce(
                [self.mean, *self.draws[: max(1, len(self.draws) // 2)]], both_ways=True)
        return self._headings[heading_deg]

    def group(self, heading_deg: float, state: int, planned: Sequence[_PlannedBlock]) -> _Group:
        return _Group(self, heading_deg, state, planned)

    def block_id_of(self, planned: _PlannedBlock) -> str:
        return block_id(planned.start, self.campaign.block_minutes)

    def read(self, planned: _PlannedBlock) -> tuple[Block, np.ndarray, np.ndarray]:
        """A block, the numbers (of `channels`) that are whole in it, and their lines (n_line, n) as densities."""
        block = read_block(self.campaign, planned.start, planned.files)
        whole = np.flatnonzero(1 - block.measured[self.columns] <= LOST)
        if block.excluded or not whole.size:
            return block, np.array([], int), np.zeros((len(self.number), 0))
        data = block.data[:, self.columns[whole]]
        data = np.where(np.isnan(data), 0.0, data - np.nanmean(data, axis=0))
        if self.joined is not None:
            strain = self.joined.at_times(planned.start, np.arange(len(data)) / block.sampling_rate_hz)
            there = np.flatnonzero(np.isfinite(strain).all(axis=0))
            self.with_strain |= there.size > 0
            data, whole = np.hstack([data, strain[:, there]]), np.append(whole, len(self.channels) + there)
        lines = np.fft.rfft(data * self.window[:, None], axis=0)[self.number]
        return block, whole, lines * self.to_density

    def loads(self, heading_deg: float, state: int) -> tuple[Case, Case]:
        return wind_cases(self.model_at(heading_deg), state, self.frequency_hz)

    def loaded_structure(self, heading_deg: float, theta: np.ndarray, loads: tuple[Case, Case]) -> LoadedStructure:
        found = loaded_structure(self.model_at(heading_deg), theta, self.damping, loads, self.frequency_hz, self.order,
                                 MODAL)
        if self.joined is None:
            return found
        at, w = weights(self.spots)
        spots, step = self.joined.spots, np.median(np.diff(self.joined.time_s))
        return found.with_gauges(at[spots], w[spots], float(1 / step))

    def channel_rows(self, whole: np.ndarray) -> np.ndarray:
        """Numbers, in the model with its gauges, of channels that are whole."""
        gauges = len(self.order) + np.arange(0 if self.joined is None else len(self.joined.spots))
        return np.append(self.rows, gauges)[whole]

    def histories(self, planned: Sequence[_PlannedBlock], worst: np.ndarray) -> list[History]:
        found = []
        for one in planned:
            group = self.group(one.heading_deg, one.state, [one])
            if (history := group.history(one, worst)) is not None:
                found.append(history)
        return found

    def notes(self, planned: Sequence[_PlannedBlock]) -> list[str]:
        """What was not used, and what the numbers are not."""
        found = [
            "cycles slower than ten minutes are not counted, nor waves shorter than those of fatigue.toml",
            "intervals carry the posterior, the scatter of blocks and x_scf of fatigue.toml; what else the model "
            "misses of a stress is to be stated there",
        ]
        if self.joined is not None:
            found.append("strain gauges take part in the estimate: hot spots "
                         f"{', '.join(str(k + 1) for k in self.joined.spots)}")
        if self.unused:
            found.append(f"channels not used: {', '.join(self.unused)}")
        found += _state_notes(planned, self.conditions)
        if all("nacelle_heading_deg" not in p.conditions for p in planned):
            found.append("no nacelle heading is recorded: rotor and nacelle are taken to look where they do in "
                         "the model's file")
        return found


class _Group:
    """Blocks of one heading under one state's loads."""

    def __init__(self, work: _Work, heading_deg: float, state: int, planned: Sequence[_PlannedBlock]):
        self.work, self.heading_deg, self.state = work, heading_deg, state
        self.cross: dict[tuple[int, ...], np.ndarray] = {}
        count: dict[tuple[int, ...], int] = {}
        # each block is read once, but where there are more than loads are learnt of
        self._kept: dict[pd.Timestamp, tuple[Block, np.ndarray, np.ndarray]] = {}
        for one in _spread(planned, LEARNT_BLOCKS):
            self._kept[one.start] = _, whole, lines = work.read(one)
            key = tuple(whole.tolist())
            if key:
                own = lines[:, :, None] * np.conj(lines[:, None, :])
                self.cross[key] = self.cross.get(key, 0.0) + own
                count[key] = count.get(key, 0) + 1
        self.cross = {key: own / count[key] for key, own in self.cross.items()}
        self.loads = work.loads(heading_deg, state)
        self.of = work.loaded_structure(heading_deg, work.mean, self.loads)
        self._smoothers: dict[tuple[int, ...], tuple[Smoother, np.ndarray]] = {}

    def _smoother(self, whole: np.ndarray, lines: np.ndarray) -> tuple[Smoother, np.ndarray]:
        """With what is unresolved of the moments (14, n_detail, 3, 3); learnt of all blocks with these channels whole,
        else of the block itself."""
        key = tuple(whole.tolist())
        if key not in self._smoothers:
            one = smoother(self.of, self._cross(key, lines), self.work.channel_rows(whole))
            self._smoothers[key] = one, _unresolved_moments(one, len(self.work.details))
        return self._smoothers[key]

    def _cross(self, key: tuple[int, ...], lines: np.ndarray) -> np.ndarray:
        known = self.cross.get(key)
        return lines[:, :, None] * np.conj(lines[:, None, :]) if known is None else known

    def block(self, planned: _PlannedBlock) -> BlockStress | None:
        read, whole, lines = self._kept.pop(planned.start, None) or self.work.read(planned)
        if not whole.size:
            return None
        one, open_moments = self._smoother(whole, lines)
        stress = one.of.stress(one.estimate(lines))
        seen = self._moments_at_spots(record_moments(one.of.frequency_hz, stress))
        total = seen + self._moments_at_spots(open_moments)
        own, resolved = ranges(np.maximum(total, 1e-300)), seen[0] / total[0]
        at, w = weights(self.work.spots)
        by_detail, count = stress.reshape(len(self.work.details), 3, -1), np.empty(len(at))
        for k in range(len(by_detail)):
            power = np.abs(w[at == k].astype(np.float32) @ by_detail[k]) ** 2
            count[at == k] = _line_count(counted_share(one.of.frequency_hz) * power)
        count /= resolved**2
        power = np.log(self._damage(total, FACTOR) / self._damage(total)) / np.log(FACTOR)
        return BlockStress(
            id=read.id, state=self.work.conditions.state[self.state].name, conditions=planned.conditions,
            heading_deg=self.heading_deg, n_channel=len(whole),
            equivalent_mpa=frozen_array([(own.moment(m) / _excess(count, m)) ** (1 / m) for m in SLOPES]),
            damage_per_hour=frozen_array(3600 * self._damage(total) / _excess(count, power)),
            resolved=frozen_array(resolved), exponent=frozen_array(power))

    def _moments_at_spots(self, moments: np.ndarray) -> np.ndarray:
        """(14, n_detail, 3, 3) -> (14, n_spot)."""
        at, w = weights(self.work.spots)
        return np.einsum("ksij,si,sj->ks", moments[:, at], w, w, optimize=True)

    def _damage(self, moments: np.ndarray, factor: float = 1.0) -> np.ndarray:
        """(n_spot,) Miner's sum a second, all ranges times `factor` and the spot's thickness effect."""
        factors = factor * thickness_effects(self.work.spots)
        names = np.array([s.curve for s in self.work.spots])
        found = np.zeros(len(names))
        for name in dict.fromkeys(names.tolist()):
            there = names == name
            law = self.work.conditions.law(name)
            found[there] = ranges(np.maximum(moments[:, there], 1e-300)).damage(law, factors[there])
        return found

    def stated_per_hour(self) -> np.ndarray:
        """(n_spot,) damage by the loads that fatigue.toml states."""
        stress = self.work.model_at(self.heading_deg)
        moments = stress.solve(self.work.mean, self.work.damping).moments[self.state]
        return 3600 * self._damage(self._moments_at_spots(moments))

    def draw_ratio(self, planned: Sequence[_PlannedBlock]) -> np.ndarray | None:
        """(n_draw, n_spot) damage at each draw by what the readings resolve, its loads learnt again, over that at the
        mean; None without a block."""
        blocks = [(w, x) for _, w, x in (self.work.read(p) for p in _spread(planned, DRAWN_BLOCKS)) if w.size]
        if not blocks:
            return None

        def damage(of: LoadedStructure) -> np.ndarray:
            made: dict[tuple[int, ...], Smoother] = {}
            total = np.zeros(len(self.work.spots))
            for whole, lines in blocks:
                key = tuple(whole.tolist())
                if key not in made:
                    made[key] = smoother(of, self._cross(key, lines), self.work.channel_rows(whole))
                seen = made[key].of.stress(made[key].estimate(lines))
                total += self._damage(self._moments_at_spots(record_moments(of.frequency_hz, seen)))
            return total

        middle = damage(self.of)
        return np.array([damage(self.work.loaded_structure(self.heading_deg, theta, self.loads)) / middle
                         for theta in self.work.draws])

    def check_gauges(self, planned: _PlannedBlock, gauges: Gauges) -> GaugeCheck | None:
        """Of one block; None where it is not whole, or no gauge recorded it."""
        own = self.history(planned, gauges.spots)
        if own is None:
            return None
        measured = gauges.at_times(planned.start, own.time_s)
        rows = gauge_comparison(own.id, own.time_s, own.stress_mpa, measured, gauges.spots)
        return GaugeCheck(rows=tuple(rows), block=own.id, spots=gauges.spots, time_s=own.time_s,
                          estimated=own.stress_mpa, measured=measured) if rows else None

    def history(self, planned: _PlannedBlock, worst: np.ndarray) -> History | None:
        read, whole, lines = self.work.read(planned)
        if not whole.size:
            return None
        one, _ = self._smoother(whole, lines)
        at, w = weights(self.work.spots)
        stress = one.of.stress(one.estimate(lines)).reshape(len(self.work.details), 3, -1)
        of_spots = np.einsum("kif,ki->kf", stress[at[worst]], w[worst])
        n, rate = len(read.data), read.sampling_rate_hz
        whole_lines = np.zeros((len(worst), n // 2 + 1), complex)
        whole_lines[:, self.work.number] = of_spots / self.work.to_density
        record = np.fft.irfft(whole_lines, n).T
        # without the ends that fade
        first = round(FADE * n)
        record = record[first : n - first]
        return History(id=read.id, time_s=frozen_array((first + np.arange(len(record))) / rate),
                       stress_mpa=frozen_array(record),
                       rainflow_over_spectrum=frozen_array(self._counted_damage(record, of_spots, worst, rate)))

    def _counted_damage(self, record: np.ndarray, of_spots: np.ndarray, worst: np.ndarray, rate: float) -> np.ndarray:
        f = self.of.frequency_hz
        power = counted_share(f) * np.abs(of_spots) ** 2
        moments, counts = np.array([np.sum(f**k * power, axis=1) for k in ORDERS]) * (f[1] - f[0]), _line_count(power)
        ten = round(RECORD_S * rate)
        found = []
        for j, k in enumerate(worst):
            spot = self.work.spots[k]
            law, effect = self.work.conditions.law(spot.curve), spot.thickness_effect
            own = ranges(moments[:, j])
            by_spectrum, more = (float(own.damage(law, f * effect)) for f in (1.0, FACTOR))
            by_spectrum /= _excess(counts[j], np.log(more / by_spectrum) / np.log(FACTOR))
            pieces = [record[a : a + ten, j] for a in range(0, max(len(record) - ten + 1, 1), ten)]
            counted = 0.0
            for piece in pieces:
                size, count = rainflow(piece)
                counted += float(np.sum(count[size > 0] / law.cycles(effect * size[size > 0]))) / (len(piece) / rate)
            found.append(counted / len(pieces) / by_spectrum)
        return np.array(found)


def _spread(planned: Sequence[_PlannedBlock], n: int) -> list[_PlannedBlock]:
    """n of them, or fewer, evenly over the record."""
    at = np.unique(np.linspace(0, len(planned) - 1, min(n, len(planned))).round().astype(int))
    return [planned[k] for k in at]


def record_moments(f: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """(14, n_detail, 3, 3) of lines (3 n_detail, n_line) of densities' roots: sums over the lines of f^k, of what
    ten-minute records count."""
    return paired_moments(stress, (f[1] - f[0]) * counted_share(f) * f ** np.array(ORDERS)[:, None])


def _line_count(power: np.ndarray) -> np.ndarray:
    """(n,) of how many equal lines the scatter of power would be that of records' lines (n, n_line): these are
    exponentially distributed about their expectation."""
    return np.maximum(2 * power.sum(axis=1) ** 2 / np.sum(power**2, axis=1) - 1, 1)


def _excess(count: np.ndarray, power) -> np.ndarray:
    """By how much damage of this power, expected for a spectrum, is too large where the spectrum is a record's own of
    so many lines: E[(chi^2 / nu)^(power / 2)], nu twice the lines. A cycle that is in a record has its size once."""
    return np.exp(gammaln(count + power / 2) - gammaln(count) - power / 2 * np.log(count))


def _unresolved_moments(one: Smoother, n_detail: int, every: int = 6) -> np.ndarray:
    """(14, n_detail, 3, 3) moments of what the readings do not resolve, by each sixth line."""
    f = one.of.frequency_hz
    lines = np.arange(0, len(f), every)
    step, total = f[1] - f[0], np.zeros((len(ORDERS), n_detail, 3, 3))
    # what a line stands for
    width = np.minimum(every, len(f) - lines) * step * counted_share(f[lines])
    for start in range(0, len(lines), 128):
        own = lines[start : start + 128]
        T = one.of.unit_stress(own)
        n, rows, i = T.shape
        left = np.matmul(T, one.unresolved_covariance(own)).reshape(n, n_detail, 3, i)
        density = np.real(np.matmul(left, np.conj(T.reshape(n, n_detail, 3, i).transpose(0, 1, 3, 2))))
        weight = width[start : start + 128] * f[own] ** np.array(ORDERS)[:, None]
        total += np.einsum("kn,ndij->kdij", weight, density, optimize=True)
    return total
