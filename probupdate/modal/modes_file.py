"""`modes.json`, read and written: channels, modal sets, what an identification says of its modes.

What is not as the format says is refused with the file, the set and the key.
"""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np

from probupdate.errors import InputError, of_file, parsing
from probupdate.io.files import read_json, write_json_rows
from probupdate.io.result_table import plural
from probupdate.io.schema import LARGEST, Length, Range, table_as
from probupdate.modal.conditions import KNOWN_COLUMNS, misspelt
from probupdate.modal.covariance_file import FactorsFile, opened_factors, write_factors
from probupdate.modal.mode_choice import choice_of
from probupdate.modal.sets import CovarianceFactors, ModalData, ModalSet, ModelMode, ModeRecord

# of modes.json: 2 has `mode_records`, one of each mode, and `model_only`; files of format 1, or without, have neither
FORMAT = 2


def _numbers(where: str, value, shape: tuple[int, ...], key: str) -> np.ndarray:
    if value is None:
        return np.full(shape, np.nan)
    if not isinstance(value, list):
        raise InputError(f"{where}, {key}", f"{value!r} is not a list",
                         "use a list of numbers, null where not measured")
    _refuse_no_numbers(where, [x for row in value for x in (row if isinstance(row, list) else [row])], key)
    try:
        array = np.array(
            [[np.nan if x is None else x for x in row] if isinstance(row, list) else (np.nan if row is None else row)
             for row in value], dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{where}, {key}", _table_mistake(value, shape),
                         "use numbers, null where not measured") from None
    # a whole row may be null: a mode that was not measured in this set
    if len(shape) == 2 and array.ndim == 1 and np.all(np.isnan(array)):
        array = np.full(shape, np.nan)
    if np.any(np.isinf(array)):
        raise InputError(f"{where}, {key}", "holds an infinite number", "use null where not measured")
    if np.any(np.abs(array) > LARGEST):
        raise InputError(f"{where}, {key}", f"holds {np.nanmax(np.abs(array)):.3g}, which is not a measurement",
                         "use null where not measured")
    if array.shape != shape:
        raise InputError(f"{where}, {key}", f"has shape {array.shape}",
                         f"give {shape}{', a row for each mode' if len(shape) == 2 else ''}")
    return array


def _table_mistake(value: list, shape: tuple[int, ...]) -> str:
    """Which row of it is none, or of another length."""
    for row, numbers in enumerate(value, start=1):
        if len(shape) == 2 and not (isinstance(numbers, list) and len(numbers) == shape[1]):
            found = plural(len(numbers), "number") if isinstance(numbers, list) else f"{numbers!r:.40}"
            return f"is not a table of numbers: row {row} has {found} for {plural(shape[1], 'channel')}"
    return "is not a table of numbers"


def _refuse_no_numbers(where: str, values: list, key: str) -> None:
    # JSON knows no NaN; it is a failed computation as likely as a mode that was not measured
    if any(isinstance(x, float) and np.isnan(x) for x in values):
        raise InputError(f"{where}, {key}", "holds NaN", "use null where not measured")
    if any(isinstance(x, str | bool) for x in values):
        wrong = next(x for x in values if isinstance(x, str | bool))
        raise InputError(f"{where}, {key}", f"{wrong!r} is not a number", "use numbers, null where not measured")


def _expand_null_rows(value, n: int):
    """Replace a null row of a shape table by a row of nulls."""
    return [[None] * n if row is None else row for row in value] if isinstance(value, list) else value


# numbers of all shapes of a set
LARGEST_SHAPES = 10_000_000
# a damping ratio from which nothing vibrates any more, and the largest that the modes of a whole file may have in the
# middle: structures have 0.002 to 0.1, in per cent the same numbers are 0.2 to 10
NO_VIBRATION, MIDDLE_DAMPING = 1.0, 0.2


def _refuse_per_cent(path: Path, sets: Sequence[ModalSet]) -> None:
    """Damping ratios of which the middle one, or any, is none of a structure."""
    known = np.concatenate([s.damping_ratio[np.isfinite(s.damping_ratio)] for s in sets]) if sets else np.zeros(0)
    if not len(known):
        return
    highest = max(sets, key=lambda s: np.max(np.abs(s.damping_ratio), initial=0, where=np.isfinite(s.damping_ratio)))
    most = float(np.nanmax(np.abs(highest.damping_ratio)))
    if most >= NO_VIBRATION or np.median(known) > MIDDLE_DAMPING:
        raise InputError(f"{path}, set {highest.id}, damping_ratio", f"{most:.4g} (median of the file "
                         f"{np.median(known):.3g}) is not a plausible damping ratio of a structure: are these per "
                         "cent?",
                         "give fractions, 0.01 for 1 %, or null where not measured")


def _refuse_odd(where: str, environment: Mapping) -> None:
    """Conditions are numbers or words; an infinite one is a failed computation, one beyond LARGEST a filler."""
    for key, value in environment.items():
        if not (value is None or isinstance(value, str) or (isinstance(value, int | float) and abs(value) <= LARGEST)):
            raise InputError(f"{where}, {key}", f"{value!r:.60} is neither a word nor a number up to {LARGEST:g}",
                             "correct it or leave it out")


def refuse_no_celsius(where: str, temperature: np.ndarray) -> None:
    """Raises InputError for temperatures of the air (n,), NaN where unknown, of which the middle one is none."""
    known = temperature[np.isfinite(temperature)]
    middle = float(np.median(known)) if len(known) else 0.0
    if abs(middle) > WARMEST_C:
        raise InputError(f"{where}, {AIR}", f"a median of {middle:.4g} is no air temperature in degrees Celsius",
                         "convert it from kelvin or degrees Fahrenheit")


# what is counted or computed with, where it is stated
MEASURED = (*KNOWN_COLUMNS, "nacelle_angle_deg", "block_minutes")


def _refuse_lost(path: Path, sets: Sequence[ModalSet]) -> None:
    """Conditions that nothing would find: words for numbers, and names that are a slip of the pen."""
    for s in sets:
        for key in MEASURED:
            value = s.environment.get(key)
            if isinstance(value, str | bool):
                raise InputError(f"{path}, set {s.id}, environment, {key}", f"{value!r:.60} is not a number",
                                 "write it with a point and without quotes, and null where not measured")
    for names, where in {tuple(s.environment): s.id for s in reversed(sets)}.items():
        for known, given in misspelt(names).items():
            raise InputError(f"{path}, set {where}, environment", f"unknown key '{given}'", f"did you mean '{known}'? "
                             "Rename it, or give it a name that is not so near")


def _refuse_mixed(path: Path, sets: Sequence[ModalSet]) -> None:
    """A condition that is a number in one set and a word in another would count as not measured there."""
    numbers = {key: s.id for s in sets for key, value in s.environment.items() if not isinstance(value, str | None)}
    for s in sets:
        for key, value in s.environment.items():
            if isinstance(value, str) and key in numbers:
                raise InputError(f"{path}, set {s.id}, environment, {key}", f"is the word '{value:.40}', and a number "
                                 f"in set {numbers[key]}", "give numbers, and null where there was no measurement")


# of a structure of a tenth of a millimetre; what lies above is a slip of the pen or of the unit
HIGHEST_HZ = 1e8
# what a quartz oscillator keeps for a while, as a share: no frequency of a record is known better
CLOCK = 1e-7


@dataclass(frozen=True, kw_only=True)
class _Written:
    """modes.json as it is written, but for its sets, which `_read_set` reads one by one."""

    channels: tuple[Annotated[str, Length(1)], ...]
    labels: tuple[str, ...] = ()
    reference_set: str | None = None
    format: Annotated[int, Range(1)] = FORMAT
    mode_records: tuple[Mapping[str, object], ...] | None = None
    model_only: tuple[Mapping[str, object], ...] | None = None
    gravity: object = None
    choice: Mapping[str, object] | None = None


OWN_KEYS = {f.name for f in fields(_Written)}
FILE_KEYS = OWN_KEYS | {"sets", "deviations"}
SET_KEYS = {
    "id", "frequency_hz", "damping_ratio", "frequency_std_hz", "damping_ratio_std", "shape_re", "shape_im", "shape_std",
    "environment",
}
PER_MODE = ("damping_ratio", "frequency_std_hz", "damping_ratio_std", "shape_re", "shape_im", "shape_std")


def _refuse_misspelt(where: str, table: Mapping, known: set[str]) -> None:
    """Other tools may add keys of their own; one that almost is ours is a slip and would be lost without a word."""
    for key in set(table) - known:
        close = difflib.get_close_matches(key, known, n=1, cutoff=0.8)
        if close:
            raise InputError(where, f"unknown key '{key}'", f"did you mean '{close[0]}'?")


# the temperature of the air, and how far from zero degrees Celsius it is in the middle of no record
AIR, WARMEST_C = "air_temperature_c", 60.0
# what a file is by its ending that is given for modal sets and is not valid JSON
NO_MODES = {
    ".npz": "an archive of arrays such as a model's", ".toml": "a TOML file such as a model's or a campaign's",
    ".dat": "a table such as a SubDyn file", ".csv": "a table", ".h5": "an HDF5 file such as a record",
    ".nc": "a NetCDF file such as a posterior", ".uff": "a universal file (probupdate convert --to modes)",
    ".unv": "a universal file (probupdate convert --to modes)",
}


def read_modes(path: str | Path) -> ModalData:
    """Read `modes.json` (interfaces: channels, sets; optional labels, reference_set)."""
    path = Path(path)
    with of_file(path), parsing(str(path), "is not modes.json", "see docs/formats/modes.md"):
        return _read_modes(path)


def _read_modes(path: Path) -> ModalData:
    content = _json_of_modes(path)
    # other tools may add keys of their own
    written = table_as(_Written, {k: v for k, v in content.items() if k in OWN_KEYS}, str(path))
    if written.format > FORMAT:
        raise InputError(str(path), f"has the format {written.format}; {FORMAT} is the newest known",
                         "read it with the version that wrote it, or identify again")
    channels, labels = written.channels, written.labels
    if repeated := [c for c in dict.fromkeys(channels) if channels.count(c) > 1]:
        raise InputError(f"{path}, channels", f"{repeated[0]} is listed twice", "keep one")
    twice = [label for label, n in Counter(labels).items() if label and n > 1]
    if twice:
        raise InputError(f"{path}, labels", f"{twice[0]} stands for {labels.count(twice[0])} modes",
                         "give every mode a name of its own")
    beside = content.get("deviations")
    with nullcontext() if beside is None else opened_factors(path, beside) as factors:
        sets = tuple(_read_modal_set(path, k, raw, len(channels), factors)
                     for k, raw in enumerate(_pop_rows(content.pop("sets"))))
    _refuse_per_cent(path, sets)
    _refuse_lost(path, sets)
    _refuse_mixed(path, sets)
    warm = [s.environment.get(AIR) for s in sets]
    refuse_no_celsius(str(path), np.array([x if isinstance(x, int | float) else np.nan for x in warm], float))
    return ModalData(
        channels=channels,
        sets=sets,
        labels=labels,
        reference_set=written.reference_set,
        records=_records(f"{path}, mode_records", written.mode_records, ModeRecord),
        gravity=_gravity(path, written.gravity, len(channels)),
        model_only=_records(f"{path}, model_only", written.model_only, ModelMode),
        choice=None if written.choice is None else choice_of(written.choice, f"{path}, choice"),
    )


def _gravity(path: Path, value: object, n_channel: int) -> tuple[bool, ...]:
    """One value for all channels, or one for each; () where it is not stated."""
    if value is None:
        return ()
    values = [value] * n_channel if isinstance(value, bool) else value
    if not isinstance(values, list) or len(values) != n_channel or not all(isinstance(v, bool) for v in values):
        raise InputError(f"{path}, gravity", f"{value!r:.60} is neither true or false nor a list of these for "
                         f"{plural(n_channel, 'channel')}",
                         "write false where gravity was taken out of the readings, true where they hold it")
    return tuple(values)


def _json_of_modes(path: Path) -> dict:
    """The file's table, which has channels and sets, no slip of the pen among its keys and a format that is known."""
    absent = "check the path, or run `probupdate identify` first"
    try:
        content = read_json(path, absent=absent, nan=True)
    except InputError:
        kind = NO_MODES.get(path.suffix.lower())
        if kind is None or not path.is_file():
            raise
        raise InputError(str(path), f"is {kind}, not modal sets",
                         "give a modes.json, as `probupdate identify` writes it") from None
    if not isinstance(content, dict):
        raise InputError(str(path), "is not a table",
                         'write {"channels": [...], "sets": [...]} (docs/formats/modes.md)')
    _refuse_misspelt(str(path), content, FILE_KEYS)
    for key in ("channels", "sets"):
        if key not in content or (key == "sets" and not isinstance(content[key], list)):
            raise InputError(f"{path}, {key}", "is not a list" if key in content else "is missing",
                             "give modal sets, as `probupdate identify` writes them (docs/formats/modes.md)")
    return content


def _pop_rows(rows: list) -> Iterator:
    """One after the other, none kept: as Python's numbers they take ten times as much as in arrays."""
    rows.reverse()
    while rows:
        yield rows.pop()


def _read_modal_set(path: Path, number: int, raw: object, n_channel: int, factors: FactorsFile | None) -> ModalSet:
    """One entry of `sets`; factors: of the file beside."""
    if not isinstance(raw, dict):
        raise InputError(f"{path}, set {number}", "is not a table", 'write {"id": ..., "frequency_hz": [...]}')
    where = f"{path}, set {raw.get('id', number)}"
    _refuse_wrong_keys(where, raw, n_channel)
    vector = (len(raw["frequency_hz"]),)

    def shapes(key: str) -> np.ndarray:
        return _numbers(where, _expand_null_rows(raw.get(key), n_channel), (*vector, n_channel), key)

    real, imaginary = shapes("shape_re"), shapes("shape_im")
    frequency = _numbers(where, raw["frequency_hz"], vector, "frequency_hz")
    if np.any(frequency <= 0):
        raise InputError(f"{where}, frequency_hz", "a frequency is not positive", "use null where not measured")
    if np.any(frequency > HIGHEST_HZ):
        raise InputError(f"{where}, frequency_hz", f"{np.nanmax(frequency):.3g} Hz is not a structure's frequency",
                         "give hertz, and null where not measured")
    std = {key: _numbers(where, raw.get(key), vector, key) for key in ("frequency_std_hz", "damping_ratio_std")}
    shape_std = shapes("shape_std")
    for key, value in {**std, "shape_std": shape_std}.items():
        if np.any(value < 0):
            raise InputError(f"{where}, {key}", "a standard deviation is negative", "use null where unknown")
    _refuse_exact(where, frequency, std["frequency_std_hz"])
    set_id = str(raw.get("id", number))
    arrays = None if factors is None else factors.read(set_id)
    found = ModalSet(
        id=set_id,
        frequency_hz=frequency,
        shape=(real + 1j * np.nan_to_num(imaginary)).T,
        damping_ratio=_numbers(where, raw.get("damping_ratio"), vector, "damping_ratio"),
        shape_std=shape_std.T,
        environment=raw.get("environment") or {},
        covariance_factors=None if arrays is None else CovarianceFactors(**arrays),
        **std,
    )
    found.refuse_zero_shapes(f"{where}, shape_re")
    return found if factors is None else factors.keep(found)


def _refuse_exact(where: str, frequency: np.ndarray, std: np.ndarray) -> None:
    """Frequencies that are stated better than a clock keeps time; zero is a placeholder that whoever weighs by it
    refuses or leaves out."""
    exact = (std > 0) & (std < CLOCK * frequency)
    if exact.any():
        k = int(np.argmax(exact))
        raise InputError(f"{where}, frequency_std_hz", f"{std[k]:.2g} Hz of {frequency[k]:.4g} Hz is smaller than the "
                         "accuracy of any record's clock: is this another unit, or a placeholder?",
                         "give hertz, and null where not known")


def _refuse_wrong_keys(where: str, raw: dict, n_channel: int) -> None:
    """Keys of a set that are missing, misspelt, of another kind, or of more modes than there can be."""
    _refuse_misspelt(where, raw, SET_KEYS)
    if not isinstance(raw.get("frequency_hz"), list):
        raise InputError(where, "'frequency_hz' is missing or no list", "give it; null where not measured")
    if n_channel and "shape_re" not in raw:
        raise InputError(where, f"'shape_re' is missing for {n_channel} channels",
                         'give it, null where not measured; of frequencies alone write "channels": []')
    if not isinstance(raw.get("id", ""), str | int) or isinstance(raw.get("id"), bool):
        raise InputError(f"{where}, id", f"{raw['id']!r:.60} is no name", "give text, as the time of the set")
    if not isinstance(raw.get("environment", {}), dict | None):
        raise InputError(f"{where}, environment", "is not a table", 'write {"water_level_m": 0.2}')
    n_mode = len(raw["frequency_hz"])
    _refuse_odd_length(where, raw, n_mode, n_channel)
    if n_mode * n_channel > LARGEST_SHAPES:
        raise InputError(where, f"{n_mode} modes at {n_channel} channels are more than a set can have", "give fewer")
    _refuse_odd(f"{where}, environment", raw.get("environment") or {})


def _refuse_odd_length(where: str, raw: dict, n_mode: int, n_channel: int) -> None:
    """Frequencies of another number of modes than all other lists have; of these one alone is refused as it is read."""
    others = {key: raw[key] for key in PER_MODE if isinstance(raw.get(key), list)}
    numbers = {len(value) for value in others.values()}
    by_channel = numbers == {n_channel} and all(isinstance(row, list) and len(row) == n_mode
                                                for value in others.values() for row in value)
    if len(numbers) == 1 and numbers != {n_mode} and not by_channel:
        raise InputError(f"{where}, frequency_hz",
                         f"has {plural(n_mode, 'mode')}, {', '.join(others)} {numbers.pop()}",
                         "give every mode an entry in each of them, null where not measured")


def _records(where: str, rows: Sequence[Mapping] | None, kind: type) -> tuple:
    """Plain values by the names of the record's fields; null is NaN; keys that are not known are other tools'."""
    known, found = {f.name: f.type for f in fields(kind)}, []
    for number, row in enumerate(rows or (), 1):
        _refuse_misspelt(f"{where} {number}", row, set(known))
        table = {k: np.nan if v is None and known[k] == "float" else v for k, v in row.items() if k in known}
        found.append(table_as(kind, table, f"{where} {number}"))
    return tuple(found)


def _nulls(array: np.ndarray):
    """Nested lists with None for NaN."""
    return [_nulls(row) if np.ndim(row) else (float(row) if np.isfinite(row) else None) for row in array]


def write_modes(data: ModalData, path: str | Path) -> list[Path]:
    """Write `modes.json`, and where a set has covariance factors `<stem>.deviations.h5` before it; `read_modes`
    inverts it. -> these files, modes.json first."""
    content: dict = {"format": FORMAT, "channels": list(data.channels)}
    if data.labels:
        content["labels"] = list(data.labels)
    if data.gravity:
        content["gravity"] = list(data.gravity)
    if data.reference_set is not None:
        content["reference_set"] = data.reference_set
    for key, rows in (("mode_records", data.records), ("model_only", data.model_only)):
        if rows:
            content[key] = [{name: None if isinstance(x, float) and not np.isfinite(x) else x
                             for name, x in asdict(row).items()} for row in rows]
    if data.choice is not None:
        content["choice"] = asdict(data.choice)
    tail = {}
    with_factors = {s.id: s.covariance_factors for s in data.sets if s.covariance_factors is not None}
    if with_factors:
        tail["deviations"] = write_factors(with_factors, Path(path))
    # set by set: a year's numbers as Python's are a gigabyte
    write_json_rows(path, content, "sets", map(_set_table, data.sets), tail)
    return [Path(path), *(Path(path).with_name(name) for name in tail.values())]


def _set_table(s: ModalSet) -> dict:
    return {
        "id": s.id,
        "frequency_hz": _nulls(s.frequency_hz),
        "damping_ratio": _nulls(s.damping_ratio),
        "frequency_std_hz": _nulls(s.frequency_std_hz),
        "damping_ratio_std": _nulls(s.damping_ratio_std),
        "shape_re": _nulls(np.real(s.shape).T),
        "shape_im": _nulls(np.imag(s.shape).T),
        "shape_std": _nulls(s.shape_std.T),
        # a number that was not known comes back from a file as None
        "environment": {k: (v if v is None or isinstance(v, str) or np.isfinite(v) else None)
                        for k, v in s.environment.items()},
    }
