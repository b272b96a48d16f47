"""Which stored poles stand for the campaign's modes in each block, and what is kept of them.

A year's poles are gigabytes and stay on the disk: a block is read for its votes, for its choice, and where standard
deviations rule a pole out.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pandas as pd

from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule
from probupdate.errors import ProbupdateError
from probupdate.identification import classification as rules
from probupdate.identification import tracking
from probupdate.identification.block_poles import WITHOUT_ARRAYS, BlockPoles, BlockSettings
from probupdate.identification.block_store import BlockStore
from probupdate.identification.classification import ClassifierSettings, PoleComparison, PoleStack
from probupdate.identification.environment import environment_of, fore_aft_deg
from probupdate.identification.hand_picked import HandPickedModes
from probupdate.identification.order_average import single_pole_key
from probupdate.identification.physical import PhysicalModes
from probupdate.identification.reference import ReferenceModes, turn_reference
from probupdate.identification.tracking import Choice, JudgedPoles, TrackedModes
from probupdate.modal.modes import CovarianceFactors, ModalSet, unit_largest
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress


@dataclass(frozen=True, kw_only=True)
class SSISettings(BlockSettings):
    """`BlockSettings` are what the stored poles depend on; the classifier works on stored poles, of the orders from
    `below` under `order` upwards."""

    classifier: ClassifierSettings = field(default_factory=ClassifierSettings)
    below: int = 8

    @property
    def of_blocks(self) -> BlockSettings:
        return BlockSettings(order=self.order, block_rows=self.block_rows, target_rate_hz=self.target_rate_hz,
                             spread=self.spread, sub_records=self.sub_records, harmonics=self.harmonics)


@dataclass(frozen=True, eq=False, kw_only=True)
class StoredBlock:
    """A stored block without its poles and its spectrum, which stay on the disk; usable: it was not excluded."""

    block: BlockPoles
    environment: dict
    usable: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class JudgedBlock:
    """A block's poles held against the campaign's modes, which are turned to where the nacelle looked; `single` and
    `paper` as the paper has it, against the model as it is (without a model, against the campaign's modes)."""

    poles: JudgedPoles
    single: PoleComparison
    paper: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class ChosenPoles:
    """What is kept of a block's poles: the choice, its criterion of the poles in `rows`; of the poles that stand
    for modes, or of their averages over model orders, frequency_hz, damping_ratio (n_mode,), shape (n_channel,
    n_mode), NaN where none does; kurtosis (n_mode,) of their amplitudes, where it was asked (`steadiness`);
    by_likelihood (n_mode,): those whose values are of `refinement`; keys: (model order, index within its poles) ->
    place in the block's stack; key_of: mode -> key; rows of the table of poles, the mode as its number."""

    choice: Choice
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    kurtosis: np.ndarray
    by_likelihood: np.ndarray
    keys: dict[tuple[int, int], int]
    rows: np.ndarray

    @property
    def key_of(self) -> dict[int, tuple[int, int]]:
        place = {pole: key for key, pole in self.keys.items()}
        return {int(j): place[int(p)] for j, p in enumerate(self.choice.pole) if p >= 0}


@dataclass(frozen=True, eq=False, kw_only=True)
class FollowedModes:
    """Every block, those that can be used, the modes' paths through these, what stands for the modes in each by its
    start, how a block's stored poles are judged once more, and what was picked by hand."""

    found: list[StoredBlock]
    usable: list[StoredBlock]
    tracked: TrackedModes
    picked: dict[pd.Timestamp, ChosenPoles]
    judge: Callable[[StoredBlock], JudgedBlock]
    order: int
    hand: HandPickedModes | None = None


def follow(
    blocks: BlockStore, campaign: Campaign, physical: PhysicalModes, reference: ReferenceModes | None, *,
    settings: SSISettings, rule: StateRule, progress: Progress, hand: HandPickedModes | None = None,
) -> FollowedModes:
    """`hand`: poles that stand for the modes because they were picked, and those that may not."""
    # a year's poles are gigabytes: a block is held against the modes twice, for its votes and for its choice
    judge = partial(_judge_block, blocks, campaign, physical.modes, reference, settings, hand)
    found, votes = [], []
    for number, start in enumerate(blocks.starts):
        progress("classifying modes", number, 2 * len(blocks.starts))
        block = blocks.read(start, spectra=False)
        slim = replace(block, **WITHOUT_ARRAYS)
        one = StoredBlock(block=slim, environment=environment_of(block, campaign, rule), usable=block.poles is not None)
        found.append(one)
        if one.usable:
            votes.append(tracking.votes_of(judge(one, block).poles, settings.classifier))
    usable = [one for one in found if one.usable]
    centre, support = tracking.paths(votes, physical.modes, settings.classifier)
    del votes
    picked = {}
    for number, (one, row) in enumerate(zip(usable, centre, strict=True)):
        progress("classifying modes", len(found) + number, len(found) + len(usable))
        judged = judge(one)
        choice, start = tracking.choose(judged.poles, row, settings.classifier), one.block.start
        if hand is not None:
            choice = hand.choose(start, judged.poles, choice)
        picked[start] = _pick_poles(judged, choice, settings.order, start, hand)
    progress("classifying modes", 2 * len(blocks.starts), 2 * len(blocks.starts))
    tracked = TrackedModes(labels=physical.modes.labels, choices=tuple(stands.choice for stands in picked.values()),
                           centre_hz=frozen_array(centre), support=frozen_array(support))
    return FollowedModes(found=found, usable=usable, tracked=tracked, picked=picked, judge=judge, order=settings.order,
                         hand=hand)


def _judge_block(
    blocks: BlockStore, campaign: Campaign, modes: ReferenceModes, model: ReferenceModes | None, settings: SSISettings,
    hand: HandPickedModes | None, one: StoredBlock, block: BlockPoles | None = None,
) -> JudgedBlock:
    """`block` if it was read already."""
    block = block or blocks.read(one.block.start, spectra=False)
    stack = pole_stack(block, settings)
    here = turn_reference(modes, campaign.sensors, fore_aft_deg(one.environment, campaign))
    like = rules.comparison(stack, here)
    bands = rules.rotor_bands(one.environment, settings.classifier)
    judged = JudgedPoles(
        id=block.id, poles=stack, comparison=like, bands=bands, reference=here,
        verdict=rules.block_criteria(stack, like, here, settings.classifier),
    )
    if hand is not None:
        judged = hand.drop_rejected(one.block.start, judged)
    single = like if model is None else rules.comparison(stack, model, like.stability)
    paper = rules.paper_criteria(stack, single, bands, settings.classifier)
    return JudgedBlock(poles=judged, single=single, paper=paper)


def pole_stack(block: BlockPoles, settings: SSISettings) -> PoleStack:
    own = block.every_order[:1]
    return rules.stack_poles((*own, *(p for p in block.others if p.order >= settings.order - settings.below)))


def _pick_poles(
    judged: JudgedBlock, choice: Choice, chosen_order: int, start: pd.Timestamp, hand: HandPickedModes | None
) -> ChosenPoles:
    """Poles that were picked by hand stand for themselves, not for an average over orders."""
    by_hand = hand is not None and start in hand.picked
    poles, like = judged.poles.poles, judged.poles.comparison
    n_mode = len(choice.pole)
    frequency, damping = np.full(n_mode, np.nan), np.full(n_mode, np.nan)
    shape = np.full((len(poles.shape), n_mode), np.nan + 0j)
    there = np.flatnonzero(choice.pole >= 0)
    taken = choice.pole[there]
    frequency[there], damping[there] = poles.frequency_hz[taken], poles.damping_ratio[taken]
    shape[:, there] = unit_largest(poles.shape[:, taken])
    index = {int(p): int(p - np.argmax(poles.order == poles.order[p])) for p in taken}
    keys = {(int(poles.order[p]), single_pole_key(k) if by_hand else k): p for p, k in index.items()}
    # the number of the mode that a pole stands for, else of the one that it is most like, marked by a minus
    mode = -1 - judged.single.best_mode
    mode[taken] = there
    shown = (poles.order == chosen_order) | np.isin(choice.criterion, (rules.KEPT, rules.REJECTED))
    rows = {
        "frequency_hz": poles.frequency_hz, "damping_ratio": poles.damping_ratio, "mpc": like.mpc,
        "mac": judged.single.best_mac, "mode": mode, "similarity": like.similarity.max(axis=1),
        "stability": like.stability, "criterion": choice.criterion, "paper_criterion": judged.paper,
        "order": poles.order,
    }
    if hand is not None:
        rows["reason"] = hand.reasons(start, poles)
    # of a year's blocks no more than is written, as one array each
    table = np.empty(np.count_nonzero(shown), [(name, value.dtype) for name, value in rows.items()])
    for name, value in rows.items():
        table[name] = value[shown]
    choice = replace(choice, criterion=table["criterion"])
    return ChosenPoles(choice=choice, frequency_hz=frequency, damping_ratio=damping, shape=shape, keys=keys, rows=table,
                       kurtosis=np.full(n_mode, np.nan), by_likelihood=np.zeros(n_mode, bool))


def without_uncertain(
    blocks: BlockStore, first: FollowedModes, settings: ClassifierSettings, jobs: int | Executor, progress: Progress,
) -> dict[pd.Timestamp, ChosenPoles]:
    """What stands again in blocks where a chosen pole's standard deviations are beyond the classifier's limits, by
    start; what was picked by hand stands whatever they are.

    Standard deviations are computed of chosen poles only; each round takes poles away, so that it ends: a round that
    takes none, and one whose standard deviations are not numbers, is an error of the program.
    """
    place = {one.block.start: k for k, one in enumerate(first.usable)}
    by_hand = {} if first.hand is None else {s: first.picked[s] for s in first.hand.picked if s in first.picked}
    blocks.fill_factors(chosen_keys(by_hand), jobs=jobs, progress=progress)
    ruled_out: defaultdict[pd.Timestamp, set[int]] = defaultdict(set)
    todo, again = {start: stands for start, stands in first.picked.items() if start not in by_hand}, {}
    while todo:
        wanted = chosen_keys(todo)
        blocks.fill_factors(wanted, jobs=jobs, progress=progress)
        before, todo = todo, {}
        for start in wanted:
            kept, one = blocks.read_factors(start), first.usable[place[start]]
            mode = {pole: k for k, pole in enumerate(before[start].choice.pole)}
            beyond = set()
            for key, pole in before[start].keys.items():
                row = kept.key.index(key)
                std = [float(np.linalg.norm(f[row])) for f in (
                    kept.poles.factors.ln_frequency, kept.poles.factors.damping_ratio)]
                if not np.all(np.isfinite(std)):
                    raise ProbupdateError(f"block {start:%Y-%m-%dT%H:%M:%SZ}: standard deviations of its poles are not "
                                          "finite; please report it, with the block's record")
                # a pole's may become larger where one beside it, which it was fitted to the spectra with, is gone
                if rules.is_uncertain(before[start].frequency_hz[mode[pole]], before[start].damping_ratio[mode[pole]],
                                      *std, 60 * one.block.minutes, settings):
                    beyond.add(pole)
            if not beyond:
                continue
            if beyond <= ruled_out[start]:
                raise ProbupdateError(f"block {start:%Y-%m-%dT%H:%M:%SZ}: poles with too large standard deviations are "
                                      "chosen again and again; please report it, with the block's record")
            ruled_out[start] |= beyond
            judged = first.judge(one)
            verdict = rules.block_criteria(judged.poles.poles, judged.poles.comparison, judged.poles.reference,
                                           settings, uncertain=sorted(ruled_out[start]))
            poles = replace(judged.poles, verdict=verdict)
            judged = replace(judged, poles=poles if first.hand is None else first.hand.drop_rejected(start, poles))
            choice = tracking.choose(judged.poles, first.tracked.centre_hz[place[start]], settings)
            again[start] = todo[start] = _pick_poles(judged, choice, first.order, start, first.hand)
    return again


def chosen_keys(picked: Mapping[pd.Timestamp, ChosenPoles]) -> dict[pd.Timestamp, tuple[tuple[int, int], ...]]:
    """Start of a block -> keys of the poles that stand for modes in it, of blocks that have any."""
    return {start: tuple(stands.keys) for start, stands in picked.items() if stands.keys}


def covariance_factors_of(blocks: BlockStore, start: pd.Timestamp,
                        keys: Sequence[tuple[int, int] | None]) -> CovarianceFactors:
    """Columns of the modes whose poles are named by `keys`; NaN for one that was not found."""
    kept = blocks.read_factors(start)
    factors = kept.poles.factors
    n_mode, n_column = len(keys), factors.ln_frequency.shape[1]
    ln_frequency, damping = (np.full((n_mode, n_column), np.nan) for _ in range(2))
    shape = np.full((len(factors.shape), n_mode, n_column), np.nan + 0j)
    for mode, key in enumerate(keys):
        if key is not None:
            row = kept.key.index(key)
            ln_frequency[mode], damping[mode] = factors.ln_frequency[row], factors.damping_ratio[row]
            shape[:, mode] = factors.shape[:, row]
    return CovarianceFactors(ln_frequency=ln_frequency, damping_ratio=damping, shape=shape)


def averaged_over_orders(blocks: BlockStore, start: pd.Timestamp, stands: ChosenPoles) -> ChosenPoles:
    """The same with the modes of the stored factors, averages over model orders or of greatest likelihood, in the place
    of the chosen poles."""
    if not stands.keys:
        return stands
    kept = blocks.read_factors(start)
    there = list(stands.key_of)
    row = [kept.key.index(key) for key in stands.key_of.values()]
    frequency, damping, shape, kurtosis = (
        np.array(a) for a in (stands.frequency_hz, stands.damping_ratio, stands.shape, stands.kurtosis))
    frequency[there], damping[there] = kept.poles.frequency_hz[row], kept.poles.damping_ratio[row]
    shape[:, there], kurtosis[there] = kept.poles.shape[:, row], kept.kurtosis[row]
    by_likelihood = np.zeros(len(frequency), bool)
    by_likelihood[there] = kept.by_likelihood[row]
    return replace(stands, frequency_hz=frequency, damping_ratio=damping, shape=shape, kurtosis=kurtosis,
                   by_likelihood=by_likelihood)


def modal_set(one: StoredBlock, stands: ChosenPoles | None, reference: ReferenceModes) -> ModalSet:
    """A column a mode of the campaign, without standard deviations."""
    n_channel, n_mode = reference.shape.shape
    nothing = np.full(n_mode, np.nan)
    return ModalSet(
        id=one.block.id, frequency_hz=nothing if stands is None else stands.frequency_hz,
        damping_ratio=nothing if stands is None else stands.damping_ratio,
        shape=np.full((n_channel, n_mode), np.nan + 0j) if stands is None else stands.shape,
        frequency_std_hz=nothing, shape_std=np.full((n_channel, n_mode), np.nan), environment=one.environment)


def pole_table(
    usable: Sequence[StoredBlock], rows: Sequence[np.ndarray], names: tuple[str, ...],
    model: ReferenceModes | None,
) -> pd.DataFrame:
    """Poles of the chosen order and those that stand for modes, of every block."""
    columns: dict[str, object] = {
        "time": pd.DatetimeIndex([one.block.start for one in usable]).repeat([len(r["order"]) for r in rows])}
    for name in rows[0].dtype.names or ():
        columns[name] = np.concatenate([r[name] for r in rows])
    known = np.array(names if model is None else model.labels, dtype=object)
    stands, mode = np.array(names, dtype=object), np.asarray(columns["mode"])
    columns["mode"] = np.where(mode >= 0, stands[np.maximum(mode, 0)], known[np.maximum(-1 - mode, 0)])
    return pd.DataFrame(columns)
