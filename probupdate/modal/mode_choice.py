"""Poles that were picked as modes, and poles that were rejected, by hand: the small file that a page of `explore` saves
and `identify` takes. It carries what it was made of, so that it is never taken for other records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from probupdate.errors import InputError, of_file, parsing
from probupdate.io.files import read_json_table
from probupdate.io.result_table import plural
from probupdate.io.schema import Length, Range, refuse_unknown, table_as

T = TypeVar("T")
FORMAT = 1
# poles of one choice, and blocks that it may be of; hands make fewer
MOST_POLES, MOST_BLOCKS, LONGEST_REASON = 10_000, 1000, 200
# rejected poles that are listed in words
MOST_SAID = 20
REMEDY = "save it from a page of `probupdate explore` (docs/howto/identify.md)"


@dataclass(frozen=True, kw_only=True)
class ChosenPole:
    """A pole of a block by its model order and its number among that order's poles, and what it was when it was chosen:
    a rejected one with the reason."""

    block: Annotated[str, Length(1)]
    order: Annotated[int, Range(1, 10_000)]
    index: Annotated[int, Range(0, 10_000)]
    frequency_hz: Annotated[float, Range(0, 1e8, above=True)]
    damping_ratio: Annotated[float, Range(-1, 1)]
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class ChoiceBlock:
    """A block that poles were chosen in: hash of its stored poles, and the records that it was made of, in words."""

    id: Annotated[str, Length(1)]
    poles_hash: Annotated[str, Length(1)]
    records: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ChoiceSettings:
    """The settings of identification that the poles depend on (`BlockSettings`)."""

    order: Annotated[int, Range(2, 10_000)]
    block_rows: Annotated[int, Range(2, 10_000)]
    target_rate_hz: Annotated[float, Range(0, 1e6, above=True)]
    spread: Annotated[int, Range(0, 10_000)]
    sub_records: Annotated[int, Range(0, 10_000)]
    harmonics: Literal["keep", "remove"]


@dataclass(frozen=True, kw_only=True)
class ModeChoice:
    """channels: of the records; picked: the modes; rejected: what is none, and why."""

    channels: tuple[str, ...]
    settings: ChoiceSettings
    blocks: tuple[ChoiceBlock, ...]
    picked: tuple[ChosenPole, ...]
    rejected: tuple[ChosenPole, ...] = ()
    format: int = FORMAT

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was picked and rejected, and why."""
        blocks = len({p.block for p in self.picked})
        first = (f"modes as picked by hand: {plural(len(self.picked), 'pole')} in {plural(blocks, 'block')}, "
                 f"{len(self.rejected)} rejected")
        said = [f"rejected by hand in block {p.block}: {p.frequency_hz:.4g} Hz at order {p.order}"
                + (f", {p.reason}" if p.reason else "") for p in self.rejected]
        more = [f"and {len(said) - MOST_SAID} more"] if len(said) > MOST_SAID else []
        return first, *said[:MOST_SAID], *more


def read_choice(path: str | Path) -> ModeChoice:
    """A choice as a page of `explore` saves it."""
    path = Path(path)
    with of_file(path), parsing(str(path), "is not a choice of modes", REMEDY):
        return choice_of(read_json_table(path, REMEDY, absent="check the path, or save it from a page of `probupdate "
                                         "explore`"), str(path))


def choice_of(table: Mapping[str, Any], where: str) -> ModeChoice:
    """The table of a choice, here or in modes.json, with every value within its bounds."""
    if "picked" not in table:
        raise InputError(where, "is not a choice of modes: it has no 'picked'", REMEDY)
    refuse_unknown(table, [f.name for f in fields(ModeChoice)], where)
    known = table.get("format")
    if known != FORMAT or isinstance(known, bool):
        raise InputError(where, f"has the format {known!r:.40}, not {FORMAT}", REMEDY)
    channels = table.get("channels")
    if not isinstance(channels, list) or not all(isinstance(c, str) for c in channels):
        raise InputError(f"{where}, channels", "is not a list of names", REMEDY)
    choice = ModeChoice(
        channels=tuple(channels), settings=table_as(ChoiceSettings, table.get("settings"), f"{where}, settings"),
        blocks=_rows(ChoiceBlock, table, "blocks", MOST_BLOCKS, where),
        picked=_rows(ChosenPole, table, "picked", MOST_POLES, where),
        rejected=_rows(ChosenPole, table, "rejected", MOST_POLES, where))
    _refuse_contradictions(choice, where)
    return choice


def _rows(kind: type[T], table: Mapping, key: str, most: int, where: str) -> tuple[T, ...]:
    rows = table.get(key)
    if not isinstance(rows, list) or len(rows) > most:
        problem = f"has {len(rows)} entries, {most} at most are read" if isinstance(rows, list) else "is not a list"
        raise InputError(f"{where}, {key}", problem, REMEDY)
    return tuple(table_as(kind, row, f"{where}, {key} {number}") for number, row in enumerate(rows, start=1))


def _refuse_contradictions(choice: ModeChoice, where: str) -> None:
    ids = [block.id for block in choice.blocks]
    if len(set(ids)) < len(ids):
        raise InputError(f"{where}, blocks", "lists a block twice", REMEDY)
    if not choice.picked:
        raise InputError(f"{where}, picked", "is empty: no pole was picked as a mode",
                         "pick one pole of each mode in the page, then save the choice")
    seen: set[tuple[str, int, int]] = set()
    for key, poles in (("picked", choice.picked), ("rejected", choice.rejected)):
        for number, pole in enumerate(poles, start=1):
            place = (pole.block, pole.order, pole.index)
            if pole.block not in ids:
                raise InputError(f"{where}, {key} {number}", f"is of block {pole.block:.40}, which is not among the "
                                 "blocks", REMEDY)
            if place in seen:
                raise InputError(f"{where}, {key} {number}", f"the pole at {pole.frequency_hz:.4g} Hz of order "
                                 f"{pole.order} stands twice", "keep it as picked or as rejected, once")
            if len(pole.reason) > LONGEST_REASON:
                raise InputError(f"{where}, {key} {number}, reason", f"has {len(pole.reason)} letters",
                                 f"shorten it to {LONGEST_REASON}")
            seen.add(place)
