"""What a command reads and what it writes, companions included: no result takes the place of what it is made from."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from probupdate.errors import InputError
from probupdate.io.files import read_toml

# what stands beside a file of modes, by the end of its name
MODES_BESIDE = (".deviations.h5", ".poles.csv")
# what the verbs write beside --out, by the end of its name after the stem
WRITTEN_BESIDE = {
    "identify": (*MODES_BESIDE, ".setups.csv"), "select": (".deviations.h5", ".selection.csv", ".selection.cov.csv"),
    "check": (".channels.csv",), "convert": (".poles.csv",), "diagnose": (".model.toml", ".model.npz"),
}
CAMPAIGN_FILES = ("campaign.toml", "scada.csv", "convert.toml", "truth.toml")


def refuse_overwriting(verb: str, out: str, given: Iterable[str]) -> None:
    """Raises InputError where a file that the verb would write to or beside `out` is, or belongs to, one of `given`."""
    if verb == "sample" and Path(out).suffix.lower() in (".json", ".csv", ".toml", ".html"):
        # another step's result, as a slip makes it
        raise InputError(out, "is no name for a posterior, which is a NetCDF file", "give one that ends in .nc")
    read = {path for text in given for path in companion_files(Path(text))}
    folders = [Path(text).resolve() for text in given if _is(Path(text), "is_dir")]
    for target in partial_output(verb, Path(out)):
        place = _resolve(target)
        if place in read or (verb == "report" and _is(target, "is_file")
                             and target.suffix.lower() not in (".html", ".htm")
                             and any(place.is_relative_to(f) for f in folders)):
            which = "" if target == Path(out) else f" (with {target.name} beside it)"
            raise InputError(out + which, "is read by this step and would be written over", "name another file")
        for folder in folders:
            if place.is_relative_to(folder / "acceleration"):
                raise InputError(out, f"lies among the records of {folder.name}", "name a file elsewhere")


def partial_output(verb: str, out: Path) -> Iterator[Path]:
    yield out
    for ending in WRITTEN_BESIDE.get(verb, ()):
        yield out.with_name(f"{out.stem}{ending}")
    if verb == "select" and out.name == "nine.json":
        yield from (out.with_name("selection.csv"), out.with_name("selection.cov.csv"))


def companion_files(path: Path) -> Iterator[Path]:
    """A given path and what is read with it, as they are on the disk."""
    if not _is(path, "exists"):
        return
    yield _resolve(path)
    if path.is_dir():
        yield from (_resolve(path / name) for name in CAMPAIGN_FILES)
        return
    yield from (_resolve(path.with_name(f"{path.stem}{ending}")) for ending in MODES_BESIDE if path.suffix == ".json")
    if path.suffix in (".npz", ".toml"):
        yield from (_resolve(path.with_name(name))
                    for name in ("parameters.toml", f"{path.stem}.npz", f"{path.stem}.toml"))
    if path.suffix == ".toml":
        try:
            content = read_toml(path)
        except InputError:
            # the step that reads it says so
            return
        for key in ("matrices", "subdyn"):
            named = content.get(key)
            name = named.get("file") if isinstance(named, dict) else None
            if isinstance(name, str) and "\0" not in name:
                yield _resolve(path.parent / name)


def _resolve(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return path.absolute()


def _is(path: Path, question: str) -> bool:
    try:
        return getattr(path, question)()
    except (OSError, ValueError):
        return False


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Within, no other process may be in a block of the same folder, which is made: raises InputError where one is. The
    lock goes with the process, however it ends."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "writer.lock"
    descriptor = _lock_folder(folder, path)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(descriptor)


def _lock_folder(folder: Path, path: Path) -> int:
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # one that has just ended may have removed the file between the two calls
            if path.exists() and path.stat().st_ino == os.fstat(descriptor).st_ino:
                return descriptor
        except BlockingIOError:
            os.close(descriptor)
            raise InputError(str(folder), "another run is writing into it",
                             "wait until it ends (the same command goes on from there), "
                             "or give another --out") from None
        os.close(descriptor)
