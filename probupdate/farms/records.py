"""Which records a month has, by their content: a hash of every file, kept beside the month's results and taken again
where a file's times, size or first bytes have changed."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from probupdate.errors import InputError
from probupdate.io.files import PART, read_json_table, write_json

KEPT = "records.json"
FIRST_BYTES = 64 * 2**10
AGAIN = "delete it: the records are read again"


def record_table(acceleration: Path, kept: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, str]]:
    """File below `acceleration` (of a Zarr array each of its own) -> its stamp and the hash of its content, which is
    taken from `kept` where the stamp is the same: a file that was copied or touched is read again, with the same hash.
    """
    found = {}
    for path in sorted(p for p in acceleration.rglob("*") if p.suffix != PART and not p.is_dir()):
        name, stamp = path.relative_to(acceleration).as_posix(), _stamp(path)
        known = kept.get(name, {})
        content = known["content"] if known.get("stamp") == stamp else _content(path)
        found[name] = {"stamp": stamp, "content": content}
    return found


def changed_records(before: Mapping[str, Mapping[str, str]], now: Mapping[str, Mapping[str, str]]) -> set[str]:
    """Records (the first part of a file's path: a Zarr array is one) whose content is another now, or that are gone."""
    return {name.split("/")[0] for name, was in before.items() if name not in now or
            now[name]["content"] != was["content"]}


def read_kept(folder: Path) -> dict[str, dict[str, str]]:
    """The table kept beside a month's results; empty before the first."""
    path = folder / KEPT
    if not path.exists():
        return {}
    found = read_json_table(path, AGAIN)
    if not all(isinstance(v, dict) and set(v) == {"stamp", "content"} for v in found.values()):
        raise InputError(str(path), "is not a table of records", AGAIN)
    return found


def keep(folder: Path, table: Mapping[str, Mapping[str, str]]) -> None:
    write_json(folder / KEPT, table)


def _stamp(path: Path) -> str:
    """Size, times of the last change of the content and of any kind (nobody sets that one back), first bytes."""
    stat = path.stat()
    with path.open("rb") as stream:
        first = hashlib.sha256(stream.read(FIRST_BYTES)).hexdigest()
    return f"{stat.st_size} bytes, {stat.st_mtime_ns}, {stat.st_ctime_ns}, {first}"


def _content(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
