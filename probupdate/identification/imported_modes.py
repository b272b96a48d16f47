"""Poles that other programs identified, followed over their blocks as the campaign's own are: `physical` finds the
modes that they come back at, `tracking` which pole stands for each in each block."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.pole_tables import BlockOfPoles, PoleTables
from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification.classification import ClassifierSettings, PoleStack
from probupdate.identification.naming import NamedModes, name_modes
from probupdate.identification.physical import (
    PersistenceSettings,
    PhysicalModes,
    block_candidates,
    even_blocks,
    gather_candidates,
    physical_modes,
)
from probupdate.identification.selection import column_scatter, shape_scatter
from probupdate.identification.tracking import Choice, JudgedPoles, track
from probupdate.io.files import write_table
from probupdate.io.result_table import plural
from probupdate.modal.modes import ModalData, ModalSet, unit_largest, write_modes

ONE_BLOCK = ("one block, and no standard deviations are given: none are made up; state the frequencies' CoVs where it "
             "is compared (--frequency-cov)")
# of modes that stand in one block only, or in none
LEFT_OUT = "left out"
FEWEST_FOR_SHAPES = 5


@dataclass(frozen=True, eq=False, kw_only=True)
class ImportedModes:
    """data: a modal set a block; poles: every complete pole with what became of it (block, order, frequency_hz,
    damping_ratio, criterion, mode); notes: what was dropped and where standard deviations come from."""

    data: ModalData
    poles: pd.DataFrame
    notes: tuple[str, ...]
    files: tuple[Path, ...] = ()

    def to_frame(self) -> pd.DataFrame:
        """A row a set and mode."""
        return self.data.to_frame()

    def write(self, out: str | Path) -> ImportedModes:
        """modes.json and modes.poles.csv beside it."""
        out = Path(out)
        table = out.with_name(f"{out.stem}.poles.csv")
        write_modes(self.data, out)
        write_table(table, self.poles)
        return replace(self, files=(out, table))

    @property
    def summary(self) -> str:
        return "\n".join([*(f"wrote {path}" for path in self.files), *(f"  {note}" for note in self.notes)])


def modes_of_poles(tables: PoleTables) -> ImportedModes:
    """A modal set a block. Standard deviations are the table's own, else the scatter over the blocks that have the mode
    (of shapes from five blocks on), else NaN. Raises InputError where nothing comes back, or the length of several
    blocks is not stated, from which follows how far a frequency may scatter."""
    settings = ClassifierSettings()
    if len(tables.blocks) > 1 and not np.isfinite(tables.block_minutes):
        raise InputError(str(tables.source), "does not say how long the record behind a block is",
                         "write block_minutes in poles.toml, or name the campaign (--sensors)")
    physical = _physical(tables, settings)
    judged = [_judge_poles(block, physical, settings) for block in tables.blocks]
    choices = track(judged, settings).choices
    sets = [_modal_set(block, choice, tables) for block, choice in zip(tables.blocks, choices, strict=True)]
    named = name_modes(sets, physical, None, None, None, settings=settings, highest_hz=np.inf, every=False)
    poles = _pole_table(tables.blocks, choices, named)
    filled, said = _with_scatter(named, physical)
    data = ModalData(channels=tables.channels, sets=filled, labels=named.labels, records=named.records)
    return ImportedModes(data=data, poles=poles, notes=(
        *_count_notes(tables, poles, data), *physical.notes, *named.notes, *said))


def _stack(block: BlockOfPoles) -> PoleStack:
    # a pole without damping is as good as any
    damping = np.where(np.isfinite(block.damping_ratio), block.damping_ratio, rules.LEAST_DAMPING)
    return PoleStack(order=block.order, frequency_hz=block.frequency_hz, damping_ratio=damping, shape=block.shape)


def _physical(tables: PoleTables, settings: ClassifierSettings) -> PhysicalModes:
    persistence = PersistenceSettings()
    chosen = even_blocks([""] * len(tables.blocks))
    parts = [block_candidates(_stack(tables.blocks[k]), number, settings, persistence)
             for number, k in enumerate(chosen) if len(tables.blocks[k].order)]
    # of one block nothing is asked that its length decides
    minutes = tables.block_minutes if np.isfinite(tables.block_minutes) else 1.0
    return physical_modes(gather_candidates(parts), n_block=len(chosen), settings=persistence,
                          block_seconds=60 * minutes,
                          where=str(tables.source))


def _judge_poles(block: BlockOfPoles, physical: PhysicalModes, settings: ClassifierSettings) -> JudgedPoles:
    stack = _stack(block)
    like = rules.comparison(stack, physical.modes)
    return JudgedPoles(id=block.id, poles=stack, comparison=like, bands=np.zeros((0, 2)), reference=physical.modes,
                       verdict=rules.block_criteria(stack, like, physical.modes, settings))


def _modal_set(block: BlockOfPoles, choice: Choice, tables: PoleTables) -> ModalSet:
    there, taken = choice.pole >= 0, np.maximum(choice.pole, 0)

    def pick(values: np.ndarray) -> np.ndarray:
        return np.where(there, values[taken], np.nan) if len(values) else np.full(len(taken), np.nan)

    shape = np.full((len(tables.channels), len(taken)), np.nan + 0j)
    shape[:, there] = unit_largest(block.shape[:, choice.pole[there]])
    environment = {"block_minutes": tables.block_minutes} if np.isfinite(tables.block_minutes) else {}
    return ModalSet(
        id=block.id, frequency_hz=pick(block.frequency_hz), damping_ratio=pick(block.damping_ratio), shape=shape,
        frequency_std_hz=pick(block.frequency_std_hz), damping_ratio_std=pick(block.damping_ratio_std),
        shape_std=np.full(shape.shape, np.nan), environment=environment)


def _with_scatter(named: NamedModes, physical: PhysicalModes) -> tuple[tuple[ModalSet, ...], tuple[str, ...]]:
    """The sets with the scatter over the blocks where they came without standard deviations, and what to say of it."""
    sets = named.sets
    frequency = np.array([s.frequency_hz for s in sets])
    given = np.isfinite([s.frequency_std_hz for s in sets]).any(axis=0)
    if len(sets) == 1:
        return tuple(sets), () if given.all() else (ONE_BLOCK,)
    place = {old: new for new, old in enumerate(named.columns)}
    pairs = [(place[i], place[j]) for i, j in physical.modes.pairs if i in place and j in place]
    spread = np.array([column_scatter(np.array([getattr(s, key) for s in sets]))
                       for key in ("frequency_hz", "damping_ratio")])
    of_shapes = shape_scatter(sets, pairs, FEWEST_FOR_SHAPES)
    filled = []
    for s in sets:
        own = [np.where(np.isfinite(std) | ~s.measured, std, spread[k])
               for k, std in enumerate((s.frequency_std_hz, s.damping_ratio_std))]
        filled.append(replace(s, frequency_std_hz=own[0],
                              damping_ratio_std=np.where(np.isfinite(s.damping_ratio), own[1], np.nan),
                              shape_std=np.where(np.isfinite(s.shape), of_shapes, np.nan)))
    lines = []
    if given.any():
        lines.append("standard deviations of frequencies and damping where the table has them: its own, as they are")
    if not given.all():
        lines.append(f"standard deviations of frequencies: the scatter over the blocks, "
                     f"{_range_text(named, frequency, spread)}; what changes between blocks, as temperature, is in it")
    without = [label for label, std in zip(named.labels, of_shapes.T, strict=True) if not np.isfinite(std).any()]
    if without:
        lines.append(f"no standard deviations of the shapes of {', '.join(without)}: in fewer than {FEWEST_FOR_SHAPES} "
                     "blocks, or alike to the last digit")
    return tuple(filled), tuple(lines)


def _range_text(named: NamedModes, frequency: np.ndarray, spread: np.ndarray) -> str:
    return ", ".join(
        f"{label} {std:.3g} Hz ({int(np.isfinite(own).sum())})" if np.isfinite(std) else f"{label} none"
        for label, own, std in zip(named.labels, frequency.T, spread[0], strict=True))


def _pole_table(blocks: Sequence[BlockOfPoles], choices: Sequence[Choice], named: NamedModes) -> pd.DataFrame:
    parts = []
    for block, choice in zip(blocks, choices, strict=True):
        mode = np.full(len(block.order), "", object)
        criterion = choice.criterion.copy()
        for j, pole in enumerate(choice.pole):
            if pole >= 0:
                mode[pole] = named.names[j]
                criterion[pole] = rules.KEPT if named.names[j] else LEFT_OUT
        parts.append(pd.DataFrame({"block": block.id, "order": block.order, "frequency_hz": block.frequency_hz,
                                   "damping_ratio": block.damping_ratio, "criterion": criterion, "mode": mode}))
    return pd.concat(parts, ignore_index=True)


def _count_notes(tables: PoleTables, poles: pd.DataFrame, data: ModalData) -> list[str]:
    count = Counter(poles["criterion"])
    lines = [f"{plural(len(tables.blocks), 'block')}, {len(poles) + sum(tables.incomplete.values())} poles: "
             f"{count.pop(rules.KEPT, 0)} stand for {plural(data.n_mode, 'mode')}"]
    words = rules.POLE_WORDS | {LEFT_OUT: "stands for a mode that too few blocks have"}
    lines += [f"dropped {n}: {reason}" for reason, n in tables.incomplete.items()]
    lines += [f"dropped {n} ({name}): each {words[name]}" for name, n in count.most_common()]
    return lines
