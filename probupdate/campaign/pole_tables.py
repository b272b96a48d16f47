"""Modes and poles that other programs identified, block by block: text tables, arrays (results of pyOMA2, variables of
MATLAB), universal files. poles.toml says what their columns are and in which units.

A pole is one row of a table, or one entry of arrays frequency (n_pole,) or (n_pole, n_order) with shapes of that size
and one more axis, of channels. Where a file says something else than poles.toml it is refused. No objects are read.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd

from probupdate.campaign.last_line import refuse_unfinished
from probupdate.campaign.mat_v5 import refuse_damaged
from probupdate.campaign.reading import CampaignHead, suggest
from probupdate.campaign.uff_file import read_uff_modes
from probupdate.errors import InputError, parsing
from probupdate.io.files import archive_arrays, input_file, read_toml
from probupdate.io.schema import Length, Range, table_as
from probupdate.runtime.arrays import frozen_array

LARGEST = 512 * 2**20
# names of pyOMA2's results, of all orders and of picked modes; its frequencies are in Hz, its damping a ratio
PYOMA = (("Fn_poles", "Xi_poles", "Phi_poles"), ("Fn", "Xi", "Phi"))
COMPLEX, POLAR = "real and imaginary", "amplitude and phase"
# a damping ratio is below 1; half of a structure's poles lie between these
HIGH_RATIO, LOW_RATIO = 0.2, 3e-4
IN_BRACKETS = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]\s*$")
UNIT_WORDS = {"hz": "Hz", "rad/s": "rad/s", "rad s-1": "rad/s", "%": "%", "percent": "%", "-": "ratio", "1": "ratio",
              "ratio": "ratio"}
Text = Annotated[str, Length(1)]


@dataclass(frozen=True, kw_only=True)
class PoleDescription:
    """poles.toml. files: pattern below the folder of the sources, a block each unless `block` names a column; order,
    frequency, damping, frequency_std, damping_std: columns of tables, variables of arrays, standard deviations in the
    units of what they belong to; shape: variable of the shapes, modes_in: how a
    square one lies; channels: channel -> column, two columns as
    `components` says, or row of the shapes from 1. block_minutes: length of the records behind a block."""

    files: Text = "*"
    block: Text | None = None
    order: Text | None = None
    frequency: Text | None = None
    damping: Text | None = None
    frequency_std: Text | None = None
    damping_std: Text | None = None
    frequency_unit: Literal["Hz", "rad/s"] | None = None
    damping_unit: Literal["ratio", "%"] | None = None
    shape: Text | None = None
    modes_in: Literal["columns", "rows"] | None = None
    components: Literal["real and imaginary", "amplitude and phase"] | None = None
    phase_unit: Literal["deg", "rad"] | None = None
    channels: Mapping[str, Text | Annotated[int, Range(1)] | tuple[Text, Text]] = field(default_factory=dict)
    block_minutes: Annotated[float, Range(0, 1e6, above=True)] | None = None
    separator: Text = ","
    decimal: Text = "."
    encoding: Text = "utf-8"
    skip_rows: Annotated[int, Range(0, 1e9)] = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockOfPoles:
    """order, frequency_hz, damping_ratio (NaN where not given) and their standard deviations (n_pole,), NaN where not
    given; shape (n_channel, n_pole) complex."""

    id: str
    order: np.ndarray
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    frequency_std_hz: np.ndarray
    damping_ratio_std: np.ndarray
    shape: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class PoleTables:
    """Blocks in the order of time where their names are times, else of numbers, else of the files; incomplete: how many
    poles were not usable, by reason; block_minutes: NaN where nothing states it."""

    source: Path
    channels: tuple[str, ...]
    blocks: tuple[BlockOfPoles, ...]
    block_minutes: float
    incomplete: Mapping[str, int]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Raw:
    """What one file gives of one block, before units: vectors (n_pole,), shape (n_channel, n_pole)."""

    block: str
    order: np.ndarray
    frequency: np.ndarray
    damping: np.ndarray
    frequency_std: np.ndarray
    damping_std: np.ndarray
    shape: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class _Source:
    """A file to read, and what is known of it: channels () where the file itself names them."""

    path: Path
    described: PoleDescription
    said: Path | None
    head: CampaignHead | None

    @property
    def toml(self) -> str:
        return str(self.said or "poles.toml")

    @property
    def known(self) -> tuple[str, ...]:
        """The campaign's channels, where one is given."""
        return self.head.channels if self.head is not None else ()

    def missing(self, key: str, example: str) -> InputError:
        return InputError(f"{self.path}, {key}", f"{'poles.toml does not name it' if self.said else 'is not known'}",
                          f"write {key} = {example} in poles.toml (--description)")


def read_pole_tables(
    source: str | Path, *, description: str | Path | None = None, head: CampaignHead | None = None
) -> PoleTables:
    """Poles of a file, or of the files of a folder, a block each, as poles.toml (`description`) says; head: of the
    campaign whose channels they are. Raises InputError naming the file where something lacks or contradicts it."""
    source = Path(source)
    described, said = PoleDescription(), None
    if description is not None:
        said = Path(description)
        described = table_as(PoleDescription, read_toml(said), str(said))
    paths = _files(source, described, said)
    channels: tuple[str, ...] | None = None
    raw: list[_Raw] = []
    for path in paths:
        own, some = _reader(path)(_Source(path=path, described=described, said=said, head=head))
        if channels is not None and own != channels:
            raise InputError(str(path), f"has the channels {', '.join(own[:6])}, {paths[0].name} has "
                             f"{', '.join(channels[:6])}", "name them for all files: [channels], or --sensors CAMPAIGN")
        channels = own
        raw += some
    assert channels is not None, "there is a file"
    if not channels:
        raise InputError(str(source), "names no channel: poles are followed by their shapes",
                         "add [channels]; frequencies alone go into a modes.json by hand, with \"channels\": [], as "
                         "docs/formats/modes.md has it")
    _refuse_twice(source, [r.block for r in raw])
    incomplete: Counter[str] = Counter()
    blocks = [_block(r, described, incomplete) for r in raw]
    if not any(len(b.order) for b in blocks):
        raise InputError(str(source), "holds no complete pole", "see that frequencies and shapes are numbers")
    _refuse_units(str(source), blocks, described, head)
    minutes = described.block_minutes or (head.block_minutes if head is not None else np.nan)
    return PoleTables(source=source, channels=channels, blocks=tuple(_order_by_time(blocks)),
                      block_minutes=float(minutes),
                      incomplete=incomplete)


def _files(source: Path, described: PoleDescription, said: Path | None) -> list[Path]:
    if not source.is_dir():
        return [input_file(source, "give a file of modes, or a folder of them", largest=LARGEST)]
    pattern = PurePosixPath(described.files)
    if pattern.is_absolute() or ".." in pattern.parts:
        raise InputError(f"{said}, files", f"'{described.files}' leaves the folder", "give a pattern below it")
    found = sorted(p for p in source.glob(described.files) if not p.is_dir() and p.suffix.lower() in READERS)
    if not found:
        raise InputError(str(source), f"holds no file {', '.join(READERS)} that matches '{described.files}'",
                         "correct files in poles.toml")
    inside = source.resolve()
    for path in found:
        if not path.resolve().is_relative_to(inside):
            raise InputError(str(path), "leads out of the folder of the sources", "copy the file there")
    return [input_file(path, "take it away", largest=LARGEST) for path in found]


def _reader(path: Path) -> Callable[[_Source], tuple[tuple[str, ...], list[_Raw]]]:
    if path.suffix.lower() not in READERS:
        raise InputError(str(path), f"'{path.suffix}' is no known table of modes", f"use {', '.join(READERS)}")
    return READERS[path.suffix.lower()]


def _refuse_twice(source: Path, names: Sequence[str]) -> None:
    twice = next((name for name, n in Counter(names).items() if n > 1), None)
    if twice is not None:
        raise InputError(str(source), f"two blocks are called '{twice}'", "name each block once")


def _block(r: _Raw, described: PoleDescription, incomplete: Counter[str]) -> BlockOfPoles:
    hz = r.frequency / (2 * np.pi) if described.frequency_unit == "rad/s" else r.frequency
    std = r.frequency_std / (2 * np.pi) if described.frequency_unit == "rad/s" else r.frequency_std
    share = 0.01 if described.damping_unit == "%" else 1.0
    kept = np.ones(len(hz), bool)
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.sum(np.abs(r.shape) ** 2, axis=0)
    for reason, bad in (("without a frequency", ~np.isfinite(hz)), ("with a frequency not above zero", ~(hz > 0)),
                        ("with a component of the shape missing", ~np.isfinite(size)),
                        ("with a shape of zeros", size == 0)):
        if count := int(np.sum(bad & kept)):
            incomplete[reason] += count
        kept &= ~bad
    return BlockOfPoles(
        id=r.block, order=frozen_array(r.order[kept], int), frequency_hz=frozen_array(hz[kept]),
        damping_ratio=frozen_array(share * r.damping[kept]), frequency_std_hz=frozen_array(std[kept]),
        damping_ratio_std=frozen_array(share * r.damping_std[kept]), shape=frozen_array(r.shape[:, kept], complex))


def _refuse_units(where: str, blocks: Sequence[BlockOfPoles], described: PoleDescription,
                  head: CampaignHead | None) -> None:
    """Numbers that are none of what their unit says."""
    damping = np.concatenate([b.damping_ratio for b in blocks])
    damping = damping[np.isfinite(damping)]
    if len(damping) and described.damping_unit != "%" and (
            np.abs(damping).max() > 1 or np.median(np.abs(damping)) > HIGH_RATIO):
        raise InputError(f"{where}, damping", f"the median damping ratio is {np.median(np.abs(damping)):.3g}, "
                         f"the largest {np.abs(damping).max():.3g}, of critical damping", 'write damping_unit = "%" '
                         "where it is in per cent")
    if len(damping) and described.damping_unit == "%" and 0 < np.median(np.abs(damping)) < LOW_RATIO:
        raise InputError(f"{where}, damping", f"the median damping ratio, "
                         f"{100 * np.median(np.abs(damping)):.2g} %, is too low for a structure",
                         'write damping_unit = "ratio" where it is a share of critical')
    highest = max(b.frequency_hz.max(initial=0.0) for b in blocks)
    if head is not None and highest > head.sampling_rate_hz / 2 * (1 + 1e-6):
        raise InputError(f"{where}, frequency", f"goes up to {highest:.4g} Hz, above half the campaign's rate of "
                         f"{head.sampling_rate_hz:g} Hz", 'write frequency_unit = "rad/s" where it is circular, or '
                         "name the campaign that was measured")


def _order_by_time(blocks: Sequence[BlockOfPoles]) -> list[BlockOfPoles]:
    names = [b.id for b in blocks]
    for kind in (lambda name: pd.to_datetime(name, utc=True, format="ISO8601").value, float):
        try:
            place = [kind(name) for name in names]
        except (ValueError, OverflowError):
            continue
        return [blocks[k] for k in np.argsort(place, kind="stable")]
    return list(blocks)


# Tables -------------------------------------------------------------------------------------------------------------


def _read_text(s: _Source) -> tuple[tuple[str, ...], list[_Raw]]:
    d, path = s.described, s.path
    with parsing(str(path), "is not a table", "check separator, decimal, skip_rows and encoding in poles.toml"):
        refuse_unfinished(path, d.encoding, d.separator, d.decimal)
        table = pd.read_csv(path, sep=d.separator, decimal=d.decimal, skiprows=d.skip_rows, encoding=d.encoding,
                            skipinitialspace=True, engine="python" if len(d.separator) > 1 else "c")
        table.columns = [str(c).strip() for c in table.columns]
    known = tuple(table.columns)

    def numbers(key: str, column: str | None) -> np.ndarray:
        if column is None:
            return np.full(len(table), np.nan)
        if column not in known:
            raise InputError(f"{path}, {key}", f"there is no column '{column}'", suggest(column, known))
        values = pd.to_numeric(table[column], errors="coerce")
        odd = np.flatnonzero(values.isna() & table[column].notna())
        if odd.size:
            raise InputError(f"{path}, {column}, row {odd[0] + 1}", f"'{table[column].iloc[odd[0]]!s:.40}' is no "
                             "number", "check decimal and separator in poles.toml")
        return values.to_numpy(float)

    for key in ("frequency", "damping"):
        if getattr(d, key) is not None and getattr(d, f"{key}_unit") is None:
            raise s.missing(f"{key}_unit", '"Hz"' if key == "frequency" else '"%" or "ratio"')
    if d.frequency is None:
        raise s.missing("frequency", f'"{known[0] if known else "f"}"')
    _refuse_other_unit(s, known)
    wanted = dict(d.channels) or {c: c for c in s.known}
    columns = {key: numbers(key, getattr(d, key)) for key in (
        "order", "frequency", "damping", "frequency_std", "damping_std")}
    shape = np.array([_component(s, channel, column, numbers) for channel, column in wanted.items()],
                     complex).reshape(len(wanted), len(table))
    columns["order"] = np.nan_to_num(columns["order"])
    if d.block is None:
        names = np.full(len(table), path.stem, object)
    elif d.block in known:
        if table[d.block].isna().any():
            raise InputError(f"{path}, {d.block}, row {int(np.argmax(table[d.block].isna())) + 1}", "names no block",
                             "write its block, or take the row out")
        names = table[d.block].astype(str).to_numpy(object)
    else:
        raise InputError(f"{path}, block", f"there is no column '{d.block}'", suggest(d.block, known))
    rows = {name: np.flatnonzero(names == name) for name in dict.fromkeys(names)}
    return tuple(wanted), [_Raw(block=str(name), shape=shape[:, mine],
                                **{key: value[mine] for key, value in columns.items()}) for name, mine in rows.items()]


def _component(s: _Source, channel: str, column: object, numbers: Callable[[str, str], np.ndarray]) -> np.ndarray:
    """(n_pole,) a channel's components of one or two columns."""
    where, kind = f"channels, {channel}", s.described.components
    if isinstance(column, int):
        raise InputError(f"{s.toml}, {where}", f"{column} is the row of an array; a table has columns",
                         "give the column's name, or two of them")
    if isinstance(column, str):
        return numbers(where, column).astype(complex)
    if kind is None:
        raise s.missing("components", f'"{COMPLEX}" or "{POLAR}"')
    first, second = (numbers(where, str(name)) for name in column)
    if kind == COMPLEX:
        return first + 1j * second
    if s.described.phase_unit is None:
        raise s.missing("phase_unit", '"deg" or "rad"')
    return first * np.exp(1j * (np.radians(second) if s.described.phase_unit == "deg" else second))


def _refuse_other_unit(s: _Source, known: Sequence[str]) -> None:
    """A unit in brackets at the end of a column's name is the file's own word."""
    for key, unit in (("frequency", s.described.frequency_unit), ("damping", s.described.damping_unit)):
        column = getattr(s.described, key)
        found = IN_BRACKETS.search(column) if column in known else None
        own = UNIT_WORDS.get(found[1].lower()) if found else None
        if own is not None and own != unit:
            raise InputError(f"{s.path}, {column}", f"states {own}, poles.toml says {key}_unit = \"{unit}\"",
                             "correct the one that is wrong")


# Arrays -------------------------------------------------------------------------------------------------------------


def _read_npz(s: _Source) -> tuple[tuple[str, ...], list[_Raw]]:
    return _read_arrays(s, archive_arrays(s.path, "is not an archive of arrays",
                        "save it by numpy.savez, without objects"))


def _read_mat(s: _Source) -> tuple[tuple[str, ...], list[_Raw]]:
    """MATLAB v5 (save -v7): numeric variables, fields of structures as 's.f'."""
    from scipy.io import loadmat

    if refuse_damaged(s.path) > LARGEST:
        raise InputError(str(s.path), "is too large to be read whole", "save the modes alone")
    with parsing(str(s.path), "cannot be read as .mat of version 5 to 7", "save it in MATLAB with -v7"):
        found: dict[str, np.ndarray] = {}
        for name, value in loadmat(s.path, simplify_cells=True).items():
            _flatten_value(name, value, found)
    return _read_arrays(s, found)


def _flatten_value(name: str, value: Any, found: dict[str, np.ndarray], depth: int = 0) -> None:
    if isinstance(value, dict) and depth < 8:
        for key, inner in value.items():
            _flatten_value(f"{name}.{key}", inner, found, depth + 1)
    elif isinstance(value, np.ndarray | int | float | complex) and np.asarray(value).dtype.kind in "iufc":
        found[name] = np.atleast_1d(np.asarray(value))


def _read_arrays(s: _Source, arrays: Mapping[str, np.ndarray]) -> tuple[tuple[str, ...], list[_Raw]]:
    d, where = s.described, str(s.path)
    names = None if d.frequency is not None else next((one for one in PYOMA if one[0] in arrays), None)
    if names is None:
        for key in ("frequency", "shape", "frequency_unit"):
            if getattr(d, key) is None:
                raise s.missing(key, '"..."' if key != "frequency_unit" else '"Hz"')
        if d.damping is not None and d.damping_unit is None:
            raise s.missing("damping_unit", '"%" or "ratio"')
        names = d.frequency, d.damping, d.shape
        stds = d.frequency_std, d.damping_std
    else:
        stds = tuple(f"{name}_std" if f"{name}_std" in arrays else None for name in names[:2])

    def array(key: str, name: str | None) -> np.ndarray | None:
        if name is None or (key == "damping" and d.damping is None and name not in arrays):
            return None
        if name not in arrays:
            raise InputError(f"{where}, {key}", f"there is no array '{name}'", suggest(name, tuple(arrays)[:40]))
        if arrays[name].dtype.kind not in ("iufc" if key == "shape" else "iuf"):
            raise InputError(f"{where}, {name}", f"is of the kind {arrays[name].dtype}", "save plain numbers")
        return arrays[name]

    frequency, shape = array("frequency", names[0]), array("shape", names[2])
    assert frequency is not None and shape is not None, "both are named"
    channels, rows = _rows(s, shape, frequency)
    grid = frequency.reshape(frequency.shape[0], -1) if frequency.ndim <= 2 else None
    if grid is None or not grid.size:
        raise InputError(f"{where}, {names[0]}", f"has the shape {frequency.shape}",
                         "give (n_pole,) or (n_pole, n_order)")
    order = np.broadcast_to(np.arange(grid.shape[1]), grid.shape).ravel()
    vectors = {}
    for key, name in zip(("damping", "frequency_std", "damping_std"), (names[1], *stds), strict=True):
        value = array(key, name)
        if value is not None and value.shape != frequency.shape:
            raise InputError(f"{where}, {name}", f"is {value.shape}, {names[0]} is {frequency.shape}",
                             "save both alike")
        vectors[key] = np.full(grid.size, np.nan) if value is None else value.astype(float).ravel()
    # an entry without a number is not a pole of that order
    value = grid.astype(float).ravel()
    there = ~np.isnan(value)
    return channels, [_Raw(block=s.path.stem, order=order[there], frequency=value[there],
                           shape=rows.astype(complex)[:, there], **{k: v[there] for k, v in vectors.items()})]


def _rows(s: _Source, shape: np.ndarray, frequency: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Channels and their components (n_channel, n_pole n_order), the axis of channels found by its size; pyOMA2's
    picked modes are columns."""
    named = dict(s.described.channels) or {c: k for k, c in enumerate(s.known, 1)}
    if not named:
        raise InputError(str(s.path), "does not name its channels", "add [channels] to poles.toml, a row number each, "
                         "or name the campaign (--sensors)")
    first, last = shape.shape[1:] == frequency.shape, shape.shape[:-1] == frequency.shape
    if not first and not last:
        raise InputError(f"{s.path}, shapes", f"are {shape.shape} for frequencies {frequency.shape}",
                         "save shapes with one more axis, of channels")
    if first and last and s.described.shape is not None:
        if s.described.modes_in is None:
            raise s.missing("modes_in", '"columns" or "rows" (of shapes as many as channels)')
        first = s.described.modes_in == "columns"
    table = (shape if first else np.moveaxis(shape, -1, 0)).reshape(shape.shape[0] if first else shape.shape[-1], -1)
    wrong = next((c for c, k in named.items() if not isinstance(k, int) or k > len(table)), None)
    if wrong is not None or (not s.described.channels and len(named) != len(table)):
        raise InputError(f"{s.toml if s.described.channels else s.path}, channels",
                         f"shapes have {len(table)} rows, " + (f"{wrong} is row {named[wrong]!r}" if wrong is not None
                                                               else f"the campaign has {len(named)} channels"),
                         "give each channel its row, from 1, in [channels]")
    return tuple(named), table[[int(str(k)) - 1 for k in named.values()]]


# Universal files ----------------------------------------------------------------------------------------------------


def _read_uff(s: _Source) -> tuple[tuple[str, ...], list[_Raw]]:
    """Modes of datasets 55, a block each load case."""
    for key in ("channels", "frequency", "damping", "shape"):
        if getattr(s.described, key):
            raise InputError(f"{s.toml}, {key}", "a universal file states it itself", "take it out; channels are found "
                             "by --sensors CAMPAIGN")
    data = read_uff_modes(s.path, s.head.sensors if s.head is not None else None)
    nothing, many = np.full(data.n_mode, np.nan), len(data.sets) > 1

    def name(own: str) -> str:
        # a load case's number is not a name
        return own if not own.isdigit() else f"{s.path.stem} {own}" if many else s.path.stem

    return data.channels, [_Raw(block=name(one.id), order=np.zeros(int(one.measured.sum())),
                                frequency=one.frequency_hz[one.measured], damping=one.damping_ratio[one.measured],
                                frequency_std=nothing[one.measured], damping_std=nothing[one.measured],
                                shape=one.shape[:, one.measured]) for one in data.sets]


READERS: dict[str, Callable[[_Source], tuple[tuple[str, ...], list[_Raw]]]] = {
    ".csv": _read_text, ".txt": _read_text, ".tsv": _read_text, ".npz": _read_npz, ".mat": _read_mat,
    ".uff": _read_uff, ".unv": _read_uff}
