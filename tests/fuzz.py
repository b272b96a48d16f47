"""Own inputs, mutated with a seed: a value, a key, a row or an array becomes another one, and a command reads the file.

`fuzz(folder, seed, numbers)` yields what was neither done nor refused in one line. Bytes that a disk spoils are
`damage`.
"""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

sys.path.append(str(Path(__file__).resolve().parent / "commands"))
from command_cases import PLACES, modes_table, write_building, write_campaign

from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.updating.update_file import read_update

# what stands in place of a value, as JSON and as TOML
JSON_VALUES = ("null", "true", "-1", "0", "1e400", "-1e308", "1e12", "NaN", "Infinity", '""', '"text"', '"\\u0000"',
               "[]", "{}", "[null]", '[["a"]]', "[1, 2, 3, 4, 5, 6, 7]", '{"a": 1}', '"2026-13-45T99:00Z"',
               '"../../x"', "1.5")
TOML_VALUES = ("true", "-1", "0", "1e308", "-1e308", "nan", "inf", '""', '"text"', "[]", "{}", '["a"]', "[1.0, 2.0]",
               "1979-05-27T07:32:00Z", "1e-300", "[[1.0]]", "{ a = 1 }", "9223372036854775807", '"../x"', "1.5")
CELLS = ("", "text", "nan", "inf", "-1e308", "1e400", "9" * 30, "2026-13-45", "0x10", '"', "-0.0", "1,5", "\u00b0")


@dataclass(frozen=True)
class Case:
    """A command, the one of its files that is mutated, and a folder that is removed before, as what is there is kept.
    """

    arguments: tuple[str, ...]
    file: Path
    fresh: Path | None = None

    def run(self) -> int | str | None:
        if self.fresh is not None:
            shutil.rmtree(self.fresh, ignore_errors=True)
        try:
            if self.arguments[0] == "read":
                read_update(self.file)
                return 0
            return main(list(self.arguments))
        except SystemExit as end:
            return end.code
        except InputError as error:
            print(error, file=sys.stderr)
            return 2


def json_text(text: str, rng: np.random.Generator) -> str:
    """Another value, or none, for one key or entry anywhere in the file."""
    content, mark = json.loads(text), "\u2603"
    places: list[tuple] = []

    def walk(node):
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(content)
    node, key = places[rng.integers(len(places))]
    if rng.random() < 0.25:
        del node[key]
        return json.dumps(content)
    if isinstance(node, dict) and rng.random() < 0.2:
        node[f"{key}x"] = node.pop(key)
        return json.dumps(content)
    node[key] = mark
    return json.dumps(content, ensure_ascii=False).replace(f'"{mark}"', JSON_VALUES[rng.integers(len(JSON_VALUES))])


def toml_text(text: str, rng: np.random.Generator) -> str:
    """Another value in a line, or the line gone, twice, or with another key."""
    lines = text.splitlines()
    stated = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    k = stated[rng.integers(len(stated))]
    chance, (key, equals, _) = rng.random(), lines[k].partition("=")
    if chance < 0.15 or not equals:
        del lines[k]
    elif chance < 0.25:
        lines.insert(k, lines[k])
    elif chance < 0.35:
        lines[k] = f"{key.strip()}x = 1"
    else:
        lines[k] = f"{key}= {TOML_VALUES[rng.integers(len(TOML_VALUES))]}"
    return "\n".join(lines) + "\n"


def csv_text(text: str, rng: np.random.Generator) -> str:
    """Another cell, or a row gone, twice, or shorter."""
    rows = [line.split(",") for line in text.splitlines()]
    k = int(rng.integers(len(rows)))
    chance = rng.random()
    if chance < 0.1:
        del rows[k]
    elif chance < 0.2:
        rows.insert(k, rows[k])
    elif chance < 0.3:
        del rows[k][-1]
    else:
        rows[k][int(rng.integers(len(rows[k])))] = CELLS[rng.integers(len(CELLS))]
    return "\n".join(",".join(row) for row in rows) + "\n"


def array(value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Another array in place of one: of other numbers, shape or kind."""
    value = np.array(value)
    number = value.dtype.kind in "fiu"

    def somewhere(x: float) -> np.ndarray:
        changed = value.astype(float)
        if changed.size:
            changed.flat[int(rng.integers(changed.size))] = x
        return changed

    kinds: list[Callable[[], np.ndarray]] = [
        lambda: np.zeros(0), lambda: value[..., :-1] if value.ndim else np.zeros(3), lambda: value[None],
        lambda: np.array("text"), lambda: np.full(value.shape, "x"), lambda: np.zeros(value.shape),
        lambda: np.zeros(value.shape, complex), lambda: np.zeros(value.shape, bool)]
    if number:
        kinds += [lambda: somewhere(np.nan), lambda: somewhere(np.inf), lambda: somewhere(-1e308), lambda: -value,
                  lambda: 1e150 * value.astype(float), lambda: value.T, lambda: somewhere(1e30),
                  lambda: np.full(value.shape, np.nan), lambda: value.astype(np.int8)]
    with np.errstate(all="ignore"):
        return kinds[rng.integers(len(kinds))]()


def npz(path: Path, rng: np.random.Generator) -> None:
    with np.load(path) as held:
        content = dict(held)
    key = list(content)[rng.integers(len(content))]
    if rng.random() < 0.15:
        del content[key]
    else:
        content[key] = array(content[key], rng)
    np.savez(path, **content)


def hdf5(path: Path, rng: np.random.Generator) -> None:
    with h5py.File(path, "r+") as file:
        data, attributes = file["data"][()], dict(file["data"].attrs)
        if rng.random() < 0.5:
            data = array(data, rng)
        else:
            key = list(attributes)[rng.integers(len(attributes))]
            attributes[key] = ("text", -1.0, np.nan, 0, "2026-13-45T00:00Z", np.zeros(3), 1e300)[rng.integers(7)]
        del file["data"]
        held = file.create_dataset("data", data=np.char.encode(data) if data.dtype.kind == "U" else data)
        for key, value in attributes.items():
            held.attrs[key] = value


def parquet(path: Path, rng: np.random.Generator) -> None:
    import pyarrow
    from pyarrow import parquet as files

    table = files.read_table(path)
    head = dict(table.schema.metadata)
    if rng.random() < 0.4:
        key = list(head)[rng.integers(len(head))]
        head[key] = (b"", b"text", b"-1", b"nan", b"\xff", b"1e300")[rng.integers(6)]
        table = table.replace_schema_metadata(head)
    else:
        k = int(rng.integers(table.num_columns))
        made = array(table.column(k).to_numpy(), rng)
        made = np.resize(made.real if made.dtype.kind == "c" else made, table.num_rows)
        table = table.set_column(k, table.column_names[k], pyarrow.array(made))
    files.write_table(table, path)


BY_ENDING: dict[str, Callable] = {".json": json_text, ".toml": toml_text, ".csv": csv_text, ".npz": npz, ".h5": hdf5,
                                  ".parquet": parquet}


def mutate(path: Path, rng: np.random.Generator) -> None:
    change = BY_ENDING[path.suffix]
    if path.suffix in (".npz", ".h5", ".parquet"):
        change(path, rng)
    else:
        path.write_text(change(path.read_text(encoding="utf-8"), rng), encoding="utf-8")


def wrong(case: Case) -> str:
    """What a command did beside ending with 0, or with 2 and one line; '' where it did so."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            code = case.run()
        except Exception:
            return traceback.format_exc(limit=-4)
    lines = [line for line in err.getvalue().splitlines() if not line.startswith("  ")]
    raw = [w for w in said if w.category is not UserWarning and "ArviZ" not in str(w.message)]
    if raw:
        return f"raw warning: {raw[0].filename}:{raw[0].lineno}: {raw[0].message}"
    # 1 with one line: numbers that are allowed and of which no estimate settles
    if code not in (0, 1, 2) or (code and len(lines) != 1):
        return f"exit {code}, {len(lines)} lines: {err.getvalue()[:300]}"
    return ""


def cases(folder: Path) -> list[Case]:
    """Small inputs of every kind in `folder`, each with a command that reads it."""
    import pyarrow
    from pyarrow import parquet as files

    paths = write_building(folder)
    campaign = write_campaign(folder / "campaign", blocks=1)
    times = [f"2026-06-01T{h:02d}:{m:02d}:00Z" for h in range(2) for m in range(0, 60, 10)]
    (campaign / "scada.csv").write_text("time,wind_speed_mps,rotor_speed_rpm,pitch_deg,power_kw\n" + "".join(
        f"{time},7.{k},0.2,85.0,-10\n" for k, time in enumerate(times)))
    (folder / "criteria.toml").write_text("pitch_range_deg = 2.0\nyaw_rate_degps = 1.0\n")
    second = folder / "parquet"
    (second / "acceleration").mkdir(parents=True)
    shutil.copy(campaign / "campaign.toml", second)
    rng = np.random.default_rng(0)
    files.write_table(pyarrow.table({c: 0.01 * rng.standard_normal(6000) for c in PLACES}).replace_schema_metadata(
        {"start": "2026-06-01T00:00:00Z", "sampling_rate_hz": "10.0"}), second / "acceleration" / "one.parquet")
    many = folder / "many.json"
    table = modes_table(14)
    for k, one in enumerate(table["sets"]):
        one["id"] = f"2026-06-01T{k:02d}:00Z"
    many.write_text(json.dumps(table))
    raw, target = folder / "raw", folder / "converted"
    raw.mkdir()
    target.mkdir()
    shutil.copy(campaign / "campaign.toml", target)
    np.savez(raw / "one.npz", data=0.01 * rng.standard_normal((6000, 3)))
    (target / "convert.toml").write_text('files = "*.npz"\nstart = "2026-06-01T00:00:00Z"\n'
                                         "[columns]\n" + "".join(f'"{c}" = {k + 1}\n' for k, c in enumerate(PLACES)))
    modes, check = ("modes", paths["model"]), ("check", str(campaign))
    convert, acceleration = ("convert", str(raw), str(target)), target / "acceleration"
    update = ("update", "--model", paths["model"], "--modes", paths["modes"], "--set", "2026-06-01T00:00Z", "--shapes",
              "mac", "--weights", "paper", "--iterations", "3", "--out", str(folder / "update.json"))
    select = ("select", str(many), "--preset", "structure", "--criteria", str(folder / "criteria.toml"), "--out",
              str(folder / "nine.json"))
    main(list(update))
    return [Case(update, Path(paths["modes"])), Case(("read", "update.json"), folder / "update.json"),
            Case(modes, Path(paths["model"])),
            Case(modes, Path(paths["parameters"])), Case(check, campaign / "campaign.toml"),
            Case(check, campaign / "scada.csv"), Case(check, next((campaign / "acceleration").glob("*.h5"))),
            Case(("check", str(second)), second / "acceleration" / "one.parquet"),
            Case(select, folder / "criteria.toml"), Case(select, many),
            Case(("regress", str(many), "--out", str(folder / "regression.csv")), many),
            Case(convert, target / "convert.toml", acceleration), Case(convert, raw / "one.npz", acceleration)]


def fuzz(folder: Path, seed: int, numbers: Iterable[int]) -> Iterator[tuple[Case, int, str]]:
    """The case, the number of the mutation and what went wrong, of the mutations of these numbers."""
    every = cases(folder)
    for k in numbers:
        case, rng = every[k % len(every)], np.random.default_rng([seed, k])
        whole = case.file.read_bytes()
        try:
            for _ in range(1 + (rng.random() < 0.3)):
                with contextlib.suppress(ValueError, KeyError, IndexError):
                    mutate(case.file, rng)
            if said := wrong(case):
                yield case, k, said
        finally:
            case.file.write_bytes(whole)
