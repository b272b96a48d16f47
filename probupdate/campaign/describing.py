"""campaign.toml and convert.toml to fill in, from what files of other programs say of their channels."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from probupdate.campaign.last_line import last_lines
from probupdate.campaign.logger_channels import OWN_TIME, LoggerChannel
from probupdate.campaign.reading import BLANK
from probupdate.campaign.sources import ABSCISSA, READERS, kind_of
from probupdate.campaign.stated import UNITS, ChannelStatement, heading_rate, parse_unit, unit_in, without_unit
from probupdate.campaign.table_layout import TableLayout, first_lines, is_number, row_cells, table_layout
from probupdate.campaign.table_sources import parquet_layout
from probupdate.campaign.uff_file import read_uff_records
from probupdate.campaign.universal import Translation
from probupdate.errors import InputError
from probupdate.io.files import input_file, write_text
from probupdate.io.result_table import plural

TABULAR = ("table", "parquet")
# files of a channel each that are looked at
MOST_FILES = 200
# Unix times of this century by their unit
SINCE_1970 = {unit: (9.5e8 * n, 4.2e9 * n) for unit, n in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9))}
# a date in three numbers and a time of day
STAMP = re.compile(r"(?P<first>\d{1,4})(?P<by>[./-])\d{1,2}(?P=by)(?P<last>\d{1,4})(?P<gap>[ T]+)\d{1,2}:\d\d:\d\d"
                   r"(?:(?P<sign>[.,:])\d{1,9})?(?P<half> ?[AaPp][Mm])?")


@dataclass(frozen=True, eq=False, kw_only=True)
class _FileChannel:
    """A channel as its file calls it: column of convert.toml, rate and start where the file has them."""

    column: str | int
    stated: ChannelStatement
    rate_hz: float | None
    start: str | None


def describe_records(raw: str | Path, out: str | Path) -> Translation:
    """Write campaign.toml (`out`) and convert.toml beside it: channels, units, rate and start from the files, "?" where
    they say nothing. Raises InputError where one is there already, or the files name no channels."""
    raw, out = Path(raw), Path(out)
    beside = out.with_name("convert.toml")
    for path in (out, beside):
        if path.exists():
            raise InputError(str(path), "already exists", "name another --out, or move it away")
    paths = _files(raw)
    kind = kind_of(paths[0])
    seen = _channels(kind, paths)
    if not seen:
        raise InputError(str(paths[0]), "holds no channel of numbers", "see what its program exports")
    rates = sorted({f"{s.rate_hz:.7g}" for s in seen if s.rate_hz}, key=float)
    write_text(out, _campaign_text(raw, seen, rates))
    write_text(beside, _convert_text(kind, paths, seen, rates))
    at = f"{' and '.join(rates)} Hz" if rates else "an unknown rate"
    note = (f"{plural(len(seen), 'channel')} at {at}; fill in every \"{BLANK}\": "
            f"`probupdate check {out.parent}` names those that are left")
    return Translation(files=(out, beside), notes=(note, *_other_columns(kind, paths)))


def _other_columns(kind: str, paths: Sequence[Path]) -> list[str]:
    """What to say of tables that have other columns than the first, as those of a second logger."""
    if kind not in TABULAR:
        return []
    first, *others = [(path, _layout_of(path).names) for path in paths]
    different = [(path, names) for path, names in others if set(names or ()) != set(first[1] or ())]
    if not different:
        return []
    path, names = different[0]
    own = [without_unit(n) for n in names or () if n not in (first[1] or ())]
    return [f"{len(different)} of {len(paths)} files have other columns than {first[0].name} ({path.name}: "
            f"{', '.join(own[:4])}{', ...' if len(own) > 4 else ''}), which are not described: of another "
            "logger? Describe each one's folder, and put both into one convert.toml by a table [[logger]] for each"]


def _files(raw: Path) -> list[Path]:
    if not raw.is_dir():
        return [input_file(raw, "give a file of records, or their folder")]
    found, kinds = [], Counter()
    for path in sorted(p for p in raw.rglob("*") if p.is_file()):
        try:
            kind = kind_of(path)
        except InputError:
            continue
        kinds[kind] += 1
        found.append((kind, path))
    if not found:
        raise InputError(str(raw), "holds no file of a known kind", "see the formats of `probupdate convert --help`")
    usual = kinds.most_common(1)[0][0]
    return [path for kind, path in found if kind == usual][:MOST_FILES]


def _channels(kind: str, paths: Sequence[Path]) -> list[_FileChannel]:
    first = paths[0]
    channels = READERS[kind].channels
    if channels is not None:
        with channels(paths) as (found, utc):
            seen = [_logger_channel(c, found, utc) for c in found]
        # a channel of a WAV file has no name but its number
        return [_FileChannel(column=k, stated=s.stated, rate_hz=s.rate_hz, start=s.start) if kind == "wav" else s
                for k, s in enumerate(seen, 1)]
    if kind in TABULAR:
        return _table_channels(paths, _layout_of(first))
    if kind == "uff":
        records = read_uff_records(first)
        return [_FileChannel(column=name or place, stated=stated, rate_hz=records.rate_hz, start=None)
                for name, place, stated in zip(records.names, records.places, records.stated, strict=True)]
    raise InputError(str(first), f"a file of this kind ({kind}) does not say what its columns are",
                     "write campaign.toml and convert.toml by hand, as docs/formats/convert.md has them")


def _layout_of(path: Path) -> TableLayout:
    found = parquet_layout(path) if kind_of(path) == "parquet" else table_layout(path)
    if found is None:
        raise InputError(str(path), "has no rows of numbers with a separator between them",
                         "write campaign.toml and convert.toml by hand, as docs/formats/convert.md has them")
    return found


def _time_column(found: TableLayout) -> str | int:
    """The column of times: one that is not a number, or the first."""
    at = next((k for k, cell in enumerate(found.rows[0]) if not is_number(cell, found.decimal)), 0)
    return found.names[at] if found.names else at + 1


def _table_channels(paths: Sequence[Path], found: TableLayout) -> list[_FileChannel]:
    time, columns = _time_column(found), found.names or range(1, len(found.rows[0]) + 1)
    step = _step_s(_time_cells(found, found.rows), _time_formats(paths, found)[:1])
    rate = 1 / step if step else heading_rate(first_lines(paths[0], found.encoding)[0][: found.skip_rows])
    seen = []
    for k, column in enumerate(columns):
        # a second column of times is not a channel
        if column == time or not is_number(found.rows[0][k], found.decimal):
            continue
        name = without_unit(column) if isinstance(column, str) else column
        unit = found.units[k] if found.units else unit_in(str(column))
        seen.append(_FileChannel(column=name, stated=ChannelStatement(unit=unit or None), rate_hz=rate, start=None))
    return seen


def _time_cells(found: TableLayout, rows: Iterable[Sequence[str]]) -> list[str]:
    time = _time_column(found)
    at = found.names.index(time) if found.names else int(time) - 1
    return [row[at] for row in rows if len(row) == len(found.rows[0])]


def _moments(cells: Sequence[str], form: str) -> pd.Series | None:
    try:
        return pd.to_datetime(pd.Series(list(cells)), format=form, utc=True)
    except ValueError:
        return None


def _time_formats(paths: Sequence[Path], found: TableLayout) -> list[str]:
    """strptime's codes by which all stamps can be read, of the first rows and of each file's ends; none where they are
    ISO 8601 or numbers. Several where no day is beyond 12."""
    cells = _time_cells(found, found.rows)
    parts = STAMP.fullmatch(cells[0])
    if parts is None or _moments(cells, "ISO8601") is not None:
        return []
    for path in paths:
        ends = [*first_lines(path, found.encoding)[0][found.skip_rows + 1:], *last_lines(path, found.encoding)[0][:-1]]
        rows = (row_cells(line, found.separator) for line in (*ends[:1], *ends[-1:]))
        cells += [c for c in _time_cells(found, rows) if STAMP.fullmatch(c)]
    clock = "%I:%M:%S" if parts["half"] else "%H:%M:%S"
    clock += (parts["sign"] + "%f" if parts["sign"] else "") + (f"{parts['half'][:-2]}%p" if parts["half"] else "")
    year = "%Y" if 4 in (len(parts["first"]), len(parts["last"])) else "%y"
    orders = (("%d", "%m", year), ("%m", "%d", year), (year, "%m", "%d"))
    forms = [parts["by"].join(order) + parts["gap"] + clock for order in orders]
    return [form for form in forms if _moments(cells, form) is not None]


def _step_s(cells: Sequence[str], forms: Sequence[str]) -> float | None:
    """Seconds from row to row; None where the times are neither ISO 8601 nor of one of the forms."""
    time = next((t for form in ("ISO8601", *forms) if (t := _moments(cells, form)) is not None), None)
    if unit := _unix_unit(cells[0]):
        time = pd.to_datetime(pd.Series(cells).astype(float), unit=unit)
    if time is None:
        return None
    step = (time.iloc[-1] - time.iloc[0]).total_seconds() / max(len(time) - 1, 1)
    return step if step > 0 else None


def _unix_unit(cell: str) -> str:
    """The unit in which a number is a Unix time of this century, '' where in none."""
    value = float(cell) if is_number(cell, ".") and cell else 0.0
    return next((unit for unit, (first, last) in SINCE_1970.items() if first < value < last), "")


def _format_line(paths: Sequence[Path], found: TableLayout) -> list[str]:
    cells, forms = _time_cells(found, found.rows), _time_formats(paths, found)
    if not forms and _moments(cells, "ISO8601") is not None:
        return []
    if len(forms) == 1:
        return [f"time_format = {json.dumps(forms[0])}"]
    choice = " or ".join(map(json.dumps, forms)) or 'strptime\'s codes, such as "%d.%m.%Y %H:%M:%S.%f"'
    return [f'time_format = "{BLANK}"  # of "{cells[0]}": {choice}']


def _table_text(paths: Sequence[Path], found: TableLayout) -> list[str]:
    time = json.dumps(_time_column(found), ensure_ascii=False)
    first = found.rows[0][0 if not found.names else found.names.index(json.loads(time))]
    numeric = is_number(first, found.decimal)
    lines = [f"time = {time}"]
    if unit := _unix_unit(first):
        lines += [f'time_unit = "{unit}"  # since 1970', 'zone = "UTC"']
    elif numeric:
        lines += [f'time_unit = "{BLANK}"  # s, ms, us, ns, day, matlab or excel; of s, start = "..." too']
    else:
        lines += [*_format_line(paths, found),
                  f'zone = "{BLANK}"  # of times that do not state theirs, such as "UTC" or "Europe/Berlin"']
    if found.separator:
        lines += [f"separator = {json.dumps(found.separator)}", f"decimal = {json.dumps(found.decimal)}"]
    lines += [] if found.encoding == "utf-8" else [f'encoding = "{found.encoding}"']
    lines += [f"skip_rows = {found.skip_rows}"] if found.skip_rows else []
    lines += [] if found.names else ["header = false"]
    return lines + ([f"units_row = {found.units_row}"] if found.units_row else [])


def _logger_channel(channel: LoggerChannel, others: Sequence[LoggerChannel], utc: bool) -> _FileChannel:
    one = channel.segments[0]
    start, rate = one.start_ns, one.rate_hz
    if one.moments is not None and len(one.moments) > 1:
        start = int(one.moments[0])
        rate = 1e9 * (len(one.moments) - 1) / max(float(one.moments[-1] - one.moments[0]), 1.0)
    short = channel.names[-1]
    column = short if sum(short in c.names for c in others) == 1 else channel.name
    text = None if start is None else pd.Timestamp(start, tz="UTC" if utc else None).isoformat()
    return _FileChannel(column=column, stated=channel.stated, rate_hz=rate, start=text)


def _campaign_text(raw: Path, seen: Sequence[_FileChannel], rates: Sequence[str]) -> str:
    rate = f"{float(rates[0])}" if len(rates) == 1 else json.dumps(BLANK)
    unequal = f"  # the files have {', '.join(rates)} Hz" if len(rates) > 1 else ""
    lines = [f'# From what the files of {raw.name} say. Fill in every "{BLANK}"; `probupdate check` names those left.',
             f"name = {json.dumps(raw.stem)}", f"sampling_rate_hz = {rate}{unequal}",
             f'block_minutes = "{BLANK}"  # such as 30']
    for s in seen:
        unit = parse_unit(s.stated.unit) if s.stated.unit else None
        quantity = s.stated.quantity or (unit[0] if unit else None)
        own = next((u for u, size in UNITS.get(quantity or "", {}).items()
                    if unit and abs(size / unit[1] - 1) < 1e-9), None)
        says = "; ".join(filter(None, [s.stated.unit and f"unit {s.stated.unit}", s.stated.quantity,
                                       s.rate_hz and f"{s.rate_hz:.7g} Hz", s.start and f"starts {s.start}"]))
        lines += ["[[sensor]]", f"channel = {json.dumps(_name(s), ensure_ascii=False)}" + (
            f"  # the file says: {' '.join(says.split())}" if says else ""),
            f'level = "{BLANK}"', f'position_m = "{BLANK}"  # [x, y, z] in m, model axes, z = 0 at mean sea level',
            f'direction = "{BLANK}"  # unit vector, model axes, such as [1.0, 0.0, 0.0]',
            f'quantity = "{quantity if quantity in UNITS else BLANK}"', f'unit = "{own or BLANK}"']
    return "\n".join(lines) + "\n"


def _name(s: _FileChannel) -> str:
    return s.column if isinstance(s.column, str) else f"channel {s.column}"


def _convert_text(kind: str, paths: Sequence[Path], seen: Sequence[_FileChannel], rates: Sequence[str]) -> str:
    suffixes = {p.suffix for p in paths}
    lines = [f"files = {json.dumps(f'*{suffixes.pop()}' if len(suffixes) == 1 else '*')}"]
    if kind in TABULAR:
        lines += _table_text(paths, _layout_of(paths[0]))
    elif kind == "uff":
        lines += [f'time = "{ABSCISSA}"', 'time_unit = "s"', f'start = "{BLANK}"']
    elif all(s.start for s in seen):
        lines += [f'time = "{OWN_TIME}"']
    else:
        lines += [f'start = "{BLANK}"  # the files do not state it; such as 2026-01-01T00:00:00Z, or start_pattern']
    if READERS[kind].joined and len(paths) > 1:
        lines += [f"join_pattern = \"{BLANK}\"  # what is the same in the names of files of one time, such as "
                  "'^(\\d+)'; or take it out"]
    if len(rates) > 1:
        lines += ["# decimate = true  # the rates are unequal: faster channels to sampling_rate_hz, with zero phase"]
    lines += ["[columns]"]
    lines += [f"{json.dumps(_name(s), ensure_ascii=False)} = {json.dumps(s.column, ensure_ascii=False)}" for s in seen]
    return "\n".join(lines) + "\n"
