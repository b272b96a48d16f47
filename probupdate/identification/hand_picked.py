"""Poles that were picked as modes by hand, and those that were rejected, found again among stored poles.

They take the place of what `physical` finds: the picked poles are the modes, with their own values in the blocks that
they were picked in, and are followed through the other blocks as modes are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.reading import Campaign
from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification.block_poles import BlockPoles, BlockSettings, find_same_pole
from probupdate.identification.block_store import BlockStore, start_of, store_head
from probupdate.identification.classification import PoleStack
from probupdate.identification.order_average import TWIN_FREQUENCY, TWIN_MAC
from probupdate.identification.physical import SAME_MODE, Candidates, PhysicalModes, modes_from_groups
from probupdate.identification.tracking import Choice, JudgedPoles
from probupdate.modal.mode_choice import ChosenPole, ModeChoice, read_choice
from probupdate.modal.modes import mac, pair_by_mac
from probupdate.runtime.arrays import frozen_array

ELSEWHERE = "open these records in `probupdate explore` and choose again"
# MAC from which picks of two blocks, near in frequency, are one mode
ONE_MODE = 0.8


@dataclass(frozen=True, eq=False, kw_only=True)
class HandPickedModes:
    """physical: the modes that were picked; picked: start of a block -> mode -> (model order, index) of its pole;
    rejected: start -> (model order, index) -> reason."""

    physical: PhysicalModes
    picked: Mapping[pd.Timestamp, Mapping[int, tuple[int, int]]]
    rejected: Mapping[pd.Timestamp, Mapping[tuple[int, int], str]]

    def reasons(self, start: pd.Timestamp, stack: PoleStack) -> np.ndarray:
        """(n_pole,) why a block's poles are rejected, the twins at other orders with each; '' where they are not."""
        found = np.full(len(stack.order), "", dtype=object)
        for key, reason in self.rejected.get(start, {}).items():
            place = _place(stack, key)
            near = np.abs(np.log(stack.frequency_hz / stack.frequency_hz[place])) <= TWIN_FREQUENCY
            found[near & (mac(stack.shape[:, [place]], stack.shape)[0] >= TWIN_MAC)] = reason
        for key in self.picked.get(start, {}).values():
            found[_place(stack, key)] = ""
        return found

    def drop_rejected(self, start: pd.Timestamp, poles: JudgedPoles) -> JudgedPoles:
        """The same without the block's rejected poles."""
        return replace(poles, verdict=np.where(self.reasons(start, poles.poles) == "", poles.verdict, rules.REJECTED))

    def choose(self, start: pd.Timestamp, poles: JudgedPoles, tracked: Choice) -> Choice:
        """What stands for the modes in a block: the picked poles and none but these, where any were picked there."""
        picked = self.picked.get(start)
        if picked is None:
            return tracked
        criterion, pole = np.array(tracked.criterion, dtype=object), np.full(len(tracked.pole), -1)
        criterion[criterion == rules.KEPT] = rules.OTHER_ORDER
        for mode, key in picked.items():
            pole[mode] = _place(poles.poles, key)
        criterion[pole[pole >= 0]] = rules.KEPT
        apart = [1 - mac(poles.poles.shape[:, [pole[g[0]]]], poles.poles.shape[:, [pole[g[1]]]])[0, 0]
                 if len(g) > 1 and min(pole[list(g)]) >= 0 else np.nan for g in poles.reference.groups]
        return replace(tracked, criterion=criterion, pole=frozen_array(pole, int), independence=frozen_array(apart))


def _place(stack: PoleStack, key: tuple[int, int]) -> int:
    return int(np.argmax(stack.order == key[0])) + key[1]


def opened_choice(choice: str | Path | ModeChoice) -> tuple[ModeChoice, str]:
    """A choice, or that of a file, and what to call it."""
    return (choice, "choice") if isinstance(choice, ModeChoice) else (read_choice(choice), str(choice))


def refuse_other_records(choice: ModeChoice, blocks: BlockStore, campaign: Campaign, settings: BlockSettings,
                         where: str) -> None:
    """Raises InputError where the choice was made on other channels, blocks or records than the campaign's."""
    here = store_head(campaign, settings)["channels"]
    if list(choice.channels) != here:
        first = next((f"{a} there, {b} here" for a, b in zip(choice.channels, here, strict=False) if a != b),
                     f"{len(choice.channels)} there, {len(here)} here")
        raise InputError(where, f"was made on other channels than those of {campaign.path}: {first}", ELSEWHERE)
    for block in choice.blocks:
        start = start_of(block.id)
        if start is None or start not in blocks.starts:
            raise InputError(where, f"was made on other records: {campaign.path} has no block {block.id:.40}",
                             ELSEWHERE)
        now = blocks.origin(start)
        gone = [text for text in block.records if text not in now] or [text for text in now
                                                                       if text not in block.records]
        if gone:
            raise InputError(where, f"was made on other records: block {block.id} was made of "
                             f"{'; '.join(block.records) or 'none'}, and in {campaign.path} is of "
                             f"{'; '.join(now) or 'none'}", ELSEWHERE)


def hand_picked(choice: ModeChoice, blocks: BlockStore, where: str) -> HandPickedModes:
    """The poles of a choice among those that are stored. Raises InputError where one is not there."""
    found: dict[pd.Timestamp, dict[tuple[int, int], ChosenPole]] = {}
    rejected: dict[pd.Timestamp, dict[tuple[int, int], str]] = {}
    stored, notes = {}, []
    for block in choice.blocks:
        start = start_of(block.id)
        # `refuse_other_records` was asked before
        assert start is not None
        stored[start] = one = blocks.read(start)
        exact = blocks.hash_of(start) == block.poles_hash
        keys = [_key(one, pole, exact, where) for pole in (*choice.picked, *choice.rejected) if pole.block == block.id]
        own = [p for p in choice.picked if p.block == block.id]
        if own:
            found[start] = dict(zip(keys, own, strict=False))
        others = [p for p in choice.rejected if p.block == block.id]
        rejected[start] = {key: p.reason or "no reason given"
                           for key, p in zip(keys[len(own):], others, strict=True)}
        if not exact:
            notes.append(f"block {block.id}: its poles differ by rounding from those that the choice was made on")
    physical, picked = _modes(found, stored, (*choice.sentences, *notes), where)
    return HandPickedModes(physical=physical, picked=picked, rejected=rejected)


def _key(block: BlockPoles, pole: ChosenPole, exact: bool, where: str) -> tuple[int, int]:
    """Order and index of a chosen pole; found again by its values where the stored ones differ by rounding."""
    poles = next((p for p in block.every_order if p.order == pole.order), None)
    if poles is None or not len(poles.frequency_hz):
        raise InputError(where, f"chose a pole of order {pole.order}, which block {pole.block:.40} has not", ELSEWHERE)
    near = find_same_pole(poles, pole.frequency_hz, pole.damping_ratio)
    if near is None or (exact and near != pole.index):
        raise InputError(where, f"block {pole.block:.40} has no pole at {pole.frequency_hz:.6g} Hz with a damping "
                         f"ratio of {pole.damping_ratio:.4g} as number {pole.index} of order {pole.order}", ELSEWHERE)
    return pole.order, near


def _modes(
    found: Mapping[pd.Timestamp, Mapping[tuple[int, int], ChosenPole]], stored: Mapping[pd.Timestamp, BlockPoles],
    notes: tuple[str, ...], where: str,
) -> tuple[PhysicalModes, dict[pd.Timestamp, dict[int, tuple[int, int]]]]:
    """The picks as modes, one of another block the same mode where it is near and alike; and the picks by mode."""
    places = [(start, key) for start, keys in found.items() for key in keys]
    poles = {(start, p.order): p for start, one in stored.items() for p in one.every_order}
    values = [(poles[start, order], index) for start, (order, index) in places]
    shape = np.column_stack([p.shape[:, k] / np.linalg.norm(p.shape[:, k]) for p, k in values])
    c = Candidates(block=np.array([list(found).index(start) for start, _ in places]),
                   ln_frequency=np.log([p.frequency_hz[k] for p, k in values]),
                   damping=np.array([p.damping_ratio[k] for p, k in values]), shape=shape, share=np.ones(len(places)))
    groups: list[list[int]] = []
    for block in range(len(found)):
        mine = np.flatnonzero(c.block == block)
        _refuse_twins([(places[k][1][0], c.ln_frequency[k], shape[:, [k]]) for k in mine], where)
        first = [group[0] for group in groups]
        alike = mac(shape[:, mine], shape[:, first]) if first else np.zeros((len(mine), 0))
        alike[np.abs(c.ln_frequency[mine][:, None] - c.ln_frequency[first]) > SAME_MODE] = 0
        mate = {i: j for i, j in pair_by_mac(alike) if alike[i, j] >= ONE_MODE} if first else {}
        for i, row in enumerate(mine):
            if i in mate:
                groups[mate[i]].append(int(row))
            else:
                groups.append([int(row)])
    physical = modes_from_groups(c, [np.array(group) for group in groups], notes)
    picked: dict[pd.Timestamp, dict[int, tuple[int, int]]] = {start: {} for start in found}
    for mode, rows in enumerate(physical.rows):
        for row in rows:
            start, key = places[int(row)]
            picked[start][mode] = key
    return physical, picked


def _refuse_twins(picks: list[tuple[int, float, np.ndarray]], where: str) -> None:
    """Raises InputError for two picks (order, ln f, shape) of a block that are one mode at two orders."""
    for (order, place, one), (other, there, two) in combinations(picks, 2):
        if order != other and abs(place - there) <= TWIN_FREQUENCY and mac(one, two)[0, 0] >= TWIN_MAC:
            raise InputError(where, f"picks {np.exp(place):.4g} Hz at order {order} and {np.exp(there):.4g} Hz at "
                             f"order {other}, which are one mode", "keep one of them; pick a close pair at one order")
