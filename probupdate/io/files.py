"""Every file that is written, and every one that is opened for reading: whole or not at all, and nothing that waits.

Written: under a temporary name in the same folder (host, process and a random token in it), to the disk, then renamed;
a killed run, a full disk or a second writer leaves the old file or a new one, never a part. Read: regular files only,
of a bounded size, JSON and TOML of bounded depth and with numbers that the program can hold.
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import functools
import hashlib
import itertools
import json
import math
import os
import re
import secrets
import shutil
import socket
import stat
import time
import tomllib
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO

from probupdate.errors import InputError, ProbupdateError, parsing

if TYPE_CHECKING:
    # a command is ready before numpy is loaded, which reads once how many threads it may have
    import numpy as np

DEEPEST = 64
LARGEST_TEXT = 512 * 2**20
LARGEST_TOML = 8 * 2**20
# arrays of one archive, unpacked
LARGEST_ARCHIVE = 1 * 2**30
PART = ".part"
# what another computer left behind is removed when nobody can be writing it any more
OLD_S = 7 * 86400.0
INT64 = 2**63
# names of a folder among which one like a missing file's is looked for
MOST_NAMES = 1000
# of a table that is written
ROWS_AT_ONCE = 2000
# a cell that a spreadsheet would take for a formula; numbers may begin with a sign
FORMULA = re.compile(r"\s*[=@]|\s*[+\-](?![\d.]|inf|nan)|[\t\r]", re.IGNORECASE)


# strings and comments of TOML, and what stands between its keys and values
TOML_STRING = re.compile("|".join((
    r'"""(?:[^\\"]|\\.|"(?!""))*"""', r"\'\'\'(?:[^']|'(?!''))*\'\'\'", r'"(?:[^"\\\n]|\\.)*"', r"'[^'\n]*'",
    r"#[^\n]*",
)), re.DOTALL)
# what a terminal obeys or a table breaks at; only longer text may run over lines
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029]")
LINE_END = re.compile(r"[\t\n]")
NAMES = ("name", "names", "label", "labels", "id", "ids", "unit", "channel", "channels", "level", "turbine", "turbines",
         "parameter", "part", "kind", "model", "files")
TOML_SIGN = re.compile(r"[=,\[\]{}\n]")


# Writing ------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """The temporary path to write to; it takes the place of `path` where the block ends without an error.

    Raises OSError with the file's name where the disk is full or nothing may be written, InputError where `path` is a
    link or no file. Folders above are made.
    """
    path = Path(path)
    _refuse_target(path)
    with errors_named(path):
        part = _temporary_path(path)
    try:
        with errors_named(path):
            yield part
            _sync_folder(part)
            if path.exists():
                with contextlib.suppress(OSError):
                    shutil.copymode(path, part)
            os.replace(part, path)
            _sync_folder(path.parent)
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def _temporary_path(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_remains(path.parent.absolute())
    # a name may have 255 bytes
    short = os.fsdecode(os.fsencode(path.name)[:120])
    return path.with_name(f"{short}.{host_name()}.{os.getpid()}.{secrets.token_hex(4)}{PART}")


@contextlib.contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """The temporary folder to write into; it takes the place of `path`, which is absent or empty, where the block ends
    without an error. Errors name what would have been at `path`."""
    path = Path(path).absolute()
    refuse_filled(path)
    with errors_named(path):
        part = _temporary_path(path)
        part.mkdir()
    try:
        yield part
        with errors_named(path):
            os.replace(part, path)
            _sync_folder(path.parent)
    except InputError as error:
        raise InputError(error.where.replace(str(part), str(path)), error.problem, error.remedy) from None
    except OSError as error:
        name = str(error.filename or path).replace(str(part), str(path))
        raise OSError(error.errno, error.strerror, name) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def refuse_filled(folder: Path) -> None:
    """Raises InputError where nothing can be at `whole_folder`'s place, before the work is done."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(str(folder), "holds something already", "name a new folder")
    if folder.is_mount():
        raise InputError(str(folder), "is where a file system is mounted, and cannot be replaced as a whole",
                         "name a folder in it")


@contextlib.contextmanager
def whole_stream(path: str | Path) -> Iterator[BinaryIO]:
    """`whole`, as an unbuffered stream to write to and read from."""
    with written_whole(path) as part, part.open("w+b", buffering=0) as stream:
        yield stream


def write_bytes(path: str | Path, content: bytes) -> Path:
    with written_whole(path) as part:
        part.write_bytes(content)
    return Path(path)


def write_text(path: str | Path, text: str) -> Path:
    return write_bytes(path, text.encode("utf-8"))


def write_json(path: str | Path, content: object) -> Path:
    """JSON without NaN or infinity, indented by one."""
    return write_text(path, json.dumps(content, indent=1, allow_nan=False))


def write_json_rows(
    path: str | Path, before: Mapping[str, object], key: str, rows: Iterable[object], after: Mapping[str, object]
) -> Path:
    """`write_json` of {**before, key: [*rows], **after}, byte for byte, with one row in memory at a time."""
    with written_whole(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        stream.write("{")
        for name, value in before.items():
            stream.write(f"\n {json.dumps(name)}: {_indent_json(value, 1)},")
        stream.write(f"\n {json.dumps(key)}: [")
        count = 0
        for row in rows:
            stream.write(f"{',' if count else ''}\n  {_indent_json(row, 2)}")
            count += 1
        stream.write("\n ]" if count else "]")
        for name, value in after.items():
            stream.write(f",\n {json.dumps(name)}: {_indent_json(value, 1)}")
        stream.write("\n}")
    return Path(path)


def _indent_json(value: object, depth: int) -> str:
    # no text of JSON has a line break of its own
    return json.dumps(value, indent=1, allow_nan=False).replace("\n", "\n" + " " * depth)


def write_arrays(path: str | Path, arrays: Mapping[str, Any]) -> Path:
    """An .npz file of arrays."""
    import numpy as np

    with written_whole(path) as part, part.open("wb") as stream:
        np.savez(stream, **arrays)
    return Path(path)


def write_table(path: str | Path, frame: Any, float_format: str | None = "%.6g") -> Path:
    """A pandas frame as CSV, times in UTC; an apostrophe before text that a spreadsheet would take for a formula."""
    with written_whole(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        # a piece at a time: a year's poles are many rows
        for first in range(0, max(len(frame), 1), ROWS_AT_ONCE):
            safe = frame.iloc[first : first + ROWS_AT_ONCE].copy()
            for column in safe:
                if safe[column].dtype.kind == "M":
                    safe[column] = safe[column].dt.strftime("%Y-%m-%dT%H:%M:%SZ")
                elif safe[column].dtype.kind not in "biufcm":
                    safe[column] = safe[column].map(_escape_formula)
            safe.columns = [_escape_formula(c) for c in safe.columns]
            safe.to_csv(stream, index=False, header=not first, float_format=float_format, lineterminator="\n")
    return Path(path)


def _escape_formula(cell: Any) -> Any:
    return f"'{cell}" if isinstance(cell, str) and FORMULA.match(cell) else cell


def is_empty_folder(folder: str | Path) -> bool:
    """Whether a folder is absent, or has no file: what a run leaves that ended before it wrote one, empty folders and
    temporary files, is nothing."""
    return all(here.is_dir() or here.name.endswith(PART) for here in Path(folder).rglob("*"))


def remove_stale(folder: str | Path) -> None:
    """Remove temporary files and folders in a folder whose writer is gone: of this computer and dead, or a week old."""
    for part in Path(folder).glob(f"*{PART}"):
        with contextlib.suppress(OSError):
            if _is_stale(part):
                shutil.rmtree(part) if part.is_dir() and not part.is_symlink() else part.unlink()


def _is_stale(part: Path) -> bool:
    found = re.fullmatch(r".*\.([^.]+)\.(\d{1,10})\.[0-9a-f]{8}", part.name.removesuffix(PART), re.DOTALL)
    if found and found[1] == host_name():
        return not _is_alive(int(found[2]))
    return time.time() - part.lstat().st_mtime > OLD_S


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    try:
        # Linux: one that has ended and that nobody has asked about yet still has its number
        state = Path(f"/proc/{process}/stat").read_text(encoding="ascii", errors="replace")
        return state.rpartition(")")[2].split()[0] != "Z"
    except (OSError, IndexError):
        return True


@functools.cache
def _remove_remains(folder: Path) -> None:
    """Once a folder and process: an earlier run's remains."""
    remove_stale(folder)


@functools.cache
def host_name() -> str:
    """This machine as a part of a file name."""
    return re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname())[:32] or "host"


def _refuse_target(path: Path) -> None:
    try:
        mode = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:
        raise InputError(_path_words(path), f"is not a name of a file ({_reason(error)})",
                         "name another file") from None
    if stat.S_ISLNK(mode):
        raise InputError(str(path), "is a link, and what it leads to is not written over", "name the file itself")
    if not stat.S_ISREG(mode):
        raise InputError(str(path), f"is {_kind(mode)}, not a file", "name a file")


def _sync_folder(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        # some network folders cannot be asked that
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):
            raise
    finally:
        os.close(handle)


@contextlib.contextmanager
def errors_named(path: Path) -> Iterator[None]:
    """Errors of the machine name the file that is meant; of HDF5 too, which hides their number in its words."""
    try:
        yield
    except ProbupdateError:
        raise
    except OSError as error:
        number = error.errno or _hidden_number(error)
        if number is None:
            raise ProbupdateError(f"{path}: cannot be written ({_reason(error)})") from error
        raise OSError(number, os.strerror(number), str(path)) from error
    except (RuntimeError, ValueError) as error:
        number = _hidden_number(error)
        if number is None:
            raise
        raise OSError(number, os.strerror(number), str(path)) from error


def _hidden_number(error: BaseException | None) -> int | None:
    while error is not None:
        found = re.search(r"errno = (\d+)", str(error))
        if found:
            return int(found[1])
        error = error.__context__
    return None


# Reading ------------------------------------------------------------------------------------------------------------


def input_file(path: str | Path, remedy: str = "check the path", *, largest: int | None = None) -> Path:
    """The path, if a regular file lies there that may be opened without waiting. Raises InputError otherwise."""
    path = Path(path)
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(_path_words(path), "no such file", remedy + _similar_name(path)) from None
    except (OSError, ValueError) as error:
        raise InputError(_path_words(path), f"cannot be read ({_reason(error)})", remedy) from None
    if not stat.S_ISREG(found.st_mode):
        raise InputError(_path_words(path), f"is {_kind(found.st_mode)}, not a file", remedy)
    if largest is not None and found.st_size > largest:
        raise InputError(_path_words(path), f"has {found.st_size / 2**20:.0f} MB, more than the "
                         f"{largest / 2**20:.0f} MB that such a file may have", remedy)
    return path


def _similar_name(path: Path) -> str:
    """'; did you mean ...?' where the folder has one name that is nearly the missing one."""
    try:
        names = [entry.name for entry in itertools.islice(os.scandir(path.parent), MOST_NAMES)]
    except (OSError, ValueError):
        return ""
    close = difflib.get_close_matches(path.name, names, n=1, cutoff=0.75)
    return f"; did you mean '{path.with_name(close[0])}'?" if close else ""


def input_folder(path: str | Path, problem: str = "is not a directory", remedy: str = "check the path") -> Path:
    path = Path(path)
    try:
        good = stat.S_ISDIR(path.stat().st_mode)
    except (FileNotFoundError, NotADirectoryError):
        good = False
    except (OSError, ValueError) as error:
        raise InputError(_path_words(path), f"cannot be read ({_reason(error)})", remedy) from None
    if not good:
        raise InputError(_path_words(path), problem, remedy + ("" if path.exists() else _similar_name(path)))
    return path


def path_inside(path: Path, folder: Path) -> Path:
    """The path, refused where a link leads it out of the folder that it belongs to."""
    try:
        good = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):
        good = False
    if not good:
        raise InputError(_path_words(path), f"leads out of {folder} by a link", "copy the file there")
    return path


def resolve_path(name: str, folder: Path, where: str, *, root: Path | None = None,
                 remedy: str = "put it beside") -> Path:
    """The path that a file in `folder` names, relative to it: in the folder `root` (that folder where None) or below.
    Raises InputError at `where` for a name that is none, or that leads out. Backslashes are those of Windows."""
    try:
        path = (folder.resolve() / name.replace("\\", "/")).resolve()
        # asked here, as a name may be too long for the file system
        path.is_file()
        good = path.is_relative_to(folder.resolve() if root is None else root.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(where, f"'{name:.80}' is not a name of a file ({_reason(error)})", remedy) from None
    if not good:
        raise InputError(where, f"'{name:.200}' leaves the folder {(root or folder).name or root or folder}", remedy)
    return path


def present(path: Path) -> bool:
    """Whether something has that name, even a link to nothing."""
    return os.path.lexists(path)


def sha256(path: str | Path) -> str:
    """Of a file's bytes, as `sha256sum` prints it."""
    with input_file(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_bytes(path: str | Path, remedy: str = "check the path", *, largest: int = LARGEST_TEXT) -> bytes:
    path = input_file(path, remedy, largest=largest)
    try:
        with path.open("rb") as stream:
            return stream.read(largest + 1)
    except OSError as error:
        raise InputError(_path_words(path), f"cannot be read ({_reason(error)})", remedy) from None


def read_text(path: str | Path, remedy: str = "save it as UTF-8", *, largest: int = LARGEST_TEXT) -> str:
    try:
        return read_bytes(path, remedy, largest=largest).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(_path_words(Path(path)), f"is not a UTF-8 text ({error})", "save it as UTF-8") from None


def read_own_text(path: str | Path, remedy: str) -> str:
    """A text that ends with a line's end, as every one that the program writes. Raises InputError for one cut off."""
    text = read_text(path, remedy)
    if not text.endswith("\n"):
        raise InputError(str(path), f"ends within a line ('...{text[-20:]}'): it was cut off", remedy)
    return text


def read_json(path: str | Path, remedy: str = "correct the file at that place", *, absent: str = "check the path",
              nan: bool = False) -> Any:
    """The content of a JSON file: at most DEEPEST levels, integers of 64 bit, no infinite number, no key twice; NaN
    only where `nan` says that the caller looks for it."""
    path = input_file(path, absent, largest=LARGEST_TEXT)
    with _format(path, "JSON", remedy):
        text = read_bytes(path, absent).decode("utf-8-sig")
        if not text.strip():
            raise ValueError("it is empty")
        content = json.loads(text, parse_constant=_constant if not nan else None, object_pairs_hook=_table,
                             parse_int=_integer if re.search(r"\d{19}", text) else None,
                             parse_float=_float if re.search(r"\d{300}|[eE]\+?0*[1-9]\d\d", text) else None)
        _refuse_deep(content)
        if re.search(r"\\[bfnrtu]|[\x7f-\x9f\u2028\u2029]", text):
            _refuse_control(path, content, remedy)
        if re.search(r"\\u[dD][89a-fA-F]", text):
            json.dumps(content, ensure_ascii=False).encode("utf-8")
    return content


def read_json_table(path: str | Path, remedy: str, *, absent: str = "check the path", nan: bool = False) -> dict:
    """A JSON file whose outermost value is a table."""
    content = read_json(path, remedy, absent=absent, nan=nan)
    if not isinstance(content, dict):
        raise InputError(str(path), "is not a JSON table", remedy)
    return content


def read_toml(
    path: str | Path, remedy: str = "correct the file at that place", *, absent: str = "check the path"
) -> dict:
    """The content of a TOML file: at most DEEPEST levels, integers of 64 bit, no number that overflows."""
    path = input_file(path, absent, largest=LARGEST_TOML)
    with _format(path, "TOML", remedy):
        text = read_bytes(path, absent, largest=LARGEST_TOML).decode("utf-8-sig")
        _refuse_deep_toml(text)
        content = tomllib.loads(text, parse_float=_float)
        _refuse_deep(content, integers=True)
        _refuse_control(path, content, remedy)
    return content


def archive_arrays(path: str | Path, problem: str, remedy: str,
                   *, largest: int = LARGEST_ARCHIVE) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name, as `archive` opens it."""
    with archive(path, problem, remedy, largest=largest) as opened:
        return {key: opened[key] for key in opened.files}


# how binary files begin that may stand where text is asked for
BINARY_HEADS = {b"\x89HDF": "HDF5 or netCDF (such as posterior.nc)", b"PK": "a ZIP archive (such as .npz or .xlsx)",
                b"CDF": "netCDF", b"\x93NUMPY": "a NumPy array (.npy)", b"\x1f\x8b": "compressed by gzip"}
# archives that were found good, as they were then: a block is opened a dozen times, and heads are most of its time
_sound: set[int] = set()
MOST_KNOWN = 100_000


@contextlib.contextmanager
def archive(
    path: str | Path, problem: str, remedy: str, *, largest: int = LARGEST_ARCHIVE,
    check: Callable[[Path, Any], None] | None = None,
) -> Iterator[Any]:
    """An .npz file, each array read as it is asked for: no objects, none larger than its member, together at most
    `largest` bytes. check: called with the arrays as long as the file has not been found good. What is wrong inside
    the block is wrong with the file."""
    import numpy as np

    path = input_file(path, remedy)
    # opened here: numpy leaves the file open where it turns out to be no archive
    with parsing(str(path), problem, remedy), path.open("rb") as stream:
        now = os.fstat(stream.fileno())
        state = hash((now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns, now.st_ctime_ns, largest, check))
        known = state in _sound
        if not known:
            # numpy takes whatever is not an archive for a pickle and advises to load it as one
            if not zipfile.is_zipfile(stream):
                raise InputError(str(path), f"{problem} (no .npz archive)", remedy)
            _refuse_bomb(path, stream, remedy, largest)
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as opened:
            if not known:
                if check is not None:
                    check(path, opened)
                if len(_sound) > MOST_KNOWN:
                    _sound.clear()
                _sound.add(state)
            yield opened


def _refuse_bomb(path: Path, stream: IO[bytes], remedy: str, largest: int) -> None:
    """The sizes that heads declare, before anything of that size is asked for."""
    import numpy as np

    with zipfile.ZipFile(stream) as zipped:
        members = zipped.infolist()
        names = [m.filename for m in members]
        if len(set(names)) < len(names):
            raise InputError(str(path), "holds an array twice", remedy)
        total = sum(m.file_size for m in members)
        if total > largest:
            raise InputError(str(path), f"holds {total / 2**20:.0f} MB unpacked, more than {largest / 2**20:.0f} MB",
                             "give large matrices as CSR parts, or in single precision")
        for member in members:
            if not member.filename.endswith(".npy"):
                continue
            with zipped.open(member) as opened:
                version = np.lib.format.read_magic(opened)
                head = np.lib.format.read_array_header_1_0 if version == (1, 0) else (
                    np.lib.format.read_array_header_2_0)
                shape, _, dtype = head(opened)
                size = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
                if dtype.hasobject or size != member.file_size - opened.tell():
                    raise InputError(f"{path}, {member.filename}", "holds objects, or another number of values than "
                                     "its header states", remedy)


@contextlib.contextmanager
def _format(path: Path, kind: str, remedy: str) -> Iterator[None]:
    try:
        yield
    except RecursionError:
        raise InputError(str(path), f"not {kind} (nested deeper than {DEEPEST} levels)", remedy) from None
    except UnicodeDecodeError:
        with path.open("rb") as stream:
            head = stream.read(8)
        other = next((name for magic, name in BINARY_HEADS.items() if head.startswith(magic)), None)
        if other is not None:
            raise InputError(str(path), f"is {other}, where {kind} is asked for", "check the order of the files and "
                             f"the option before it, and give the {kind} file") from None
        raise InputError(str(path), f"not {kind} (no text in UTF-8)", remedy) from None
    except ValueError as error:
        raise InputError(str(path), f"not {kind} ({error})", remedy) from None


def _refuse_deep(content: object, *, integers: bool = False) -> None:
    level: list = [content]
    for _ in range(DEEPEST + 1):
        nested = []
        for holder in level:
            values = holder.values() if isinstance(holder, dict) else holder if isinstance(holder, list) else ()
            nested += [v for v in values if isinstance(v, dict | list)]
            if integers and any(type(v) is int and not -INT64 <= v < INT64 for v in values):
                raise ValueError("an integer beyond 64 bit")
        if not nested:
            return
        level = nested
    raise ValueError(f"nested deeper than {DEEPEST} levels")


def _refuse_control(path: Path, content: object, remedy: str) -> None:
    """Control characters in text, and ends of lines in names."""
    left: list[tuple[str, object]] = [("", content)]
    while left:
        key, value = left.pop()
        if isinstance(value, dict):
            left += [("name", k) for k in value] + list(value.items())
        elif isinstance(value, list):
            left += [(key, v) for v in value]
        elif isinstance(value, str) and (found := CONTROL.search(value) or (
                LINE_END.search(value) if key in NAMES else None)):
            raise InputError(f"{path}, {key or 'a text'}", f"{value!r:.60} holds the control character {found[0]!a}",
                             remedy)


def _refuse_deep_toml(text: str) -> None:
    """Dotted keys, before the parser, which takes their number squared, and brackets, which it follows by calling
    itself. Between strings and signs a key is one piece."""
    for piece in TOML_SIGN.split(TOML_STRING.sub("s", text)):
        if piece.count(".") > DEEPEST:
            raise ValueError(f"nested deeper than {DEEPEST} levels")


def _integer(text: str) -> int:
    # Python itself refuses some thousand digits, in quadratic time below that
    if len(text) > 20 or not -INT64 <= int(text) < INT64:
        raise ValueError(f"integer {text[:24]}{'...' if len(text) > 24 else ''} is beyond 64 bit")
    return int(text)


def _float(text: str) -> float:
    value = float(text)
    if math.isinf(value) and "inf" not in text:
        raise ValueError(f"number {text[:24]} overflows")
    return value


def _constant(text: str) -> float:
    raise ValueError(f"{text} is not valid JSON")


def _table(pairs: list[tuple[str, Any]]) -> dict:
    table = dict(pairs)
    if len(table) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise ValueError(f"key '{twice[:60]}' stands twice in a table")
    return table


def _kind(mode: int) -> str:
    kinds: tuple[tuple[Callable[[int], bool], str], ...] = (
        (stat.S_ISDIR, "a directory"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"),
        (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISLNK, "a link"))
    return next((text for test, text in kinds if test(mode)), "something else")


def _reason(error: BaseException) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _path_words(path: Path) -> str:
    return str(path).replace("\0", "\\0")
