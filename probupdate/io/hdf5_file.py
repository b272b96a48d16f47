"""HDF5 and NetCDF files opened only after another process has looked through them: what hangs or ends the library ends
there. Refused: links to other files, numbers that lie in other files, more declared than there is."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import selectors
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from probupdate.errors import InputError, parsing
from probupdate.io import hdf5_probe
from probupdate.io.files import input_file, whole_stream
from probupdate.runtime.signals import hold_back_signals

# processor time of so many objects of a file, each looked at in a millisecond; large packed chunks are unpacked,
# 20 MB a second at worst. By the clock a busy machine takes longer
SECONDS = 3
BYTES_A_SECOND = 2e7
PATIENCE = 4
MEMORY = 2 * 2**30
# files found good, as they were then
_KNOWN_SIZE = 20_000


class _Patient:
    """A file that HDF5 writes through. On a full disk the library fails once more when it closes the file, with a trace
    on the screen, and may end the process: here a write that fails is kept in `failed`, and those after it are not
    done."""

    def __init__(self, stream: Any):
        self._stream = stream
        self.failed: OSError | None = None

    def write(self, content: Any) -> int:
        size = len(content)
        try:
            while self.failed is None and len(content):
                content = content[self._stream.write(content) :]
        except OSError as error:
            self.failed = error
        return size

    def truncate(self, size: int | None = None) -> int:
        try:
            return self._stream.truncate(size)
        except OSError as error:
            self.failed = self.failed or error
            return 0 if size is None else size

    def read(self, size: int = -1) -> bytes:
        return self._stream.read(size)

    def readinto(self, buffer: Any) -> int:
        return self._stream.readinto(buffer)

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def flush(self) -> None:
        # unbuffered
        pass


@contextlib.contextmanager
def new_hdf5(path: str | Path) -> Iterator[Any]:
    """An h5py.File to fill; it is at `path` where the block ends without an error. Raises OSError on a full disk. A
    signal that ends the run is answered after the block."""
    import h5py

    with hold_back_signals(), whole_stream(path) as unbuffered:
        stream = _Patient(unbuffered)
        try:
            with h5py.File(stream, "w") as file:
                yield file
        except Exception:
            # of a stream that failed HDF5 reports its own state; what happened is raised below
            if stream.failed is None:
                raise
        if stream.failed is not None:
            raise stream.failed


@contextlib.contextmanager
def open_hdf5(path: str | Path, problem: str, remedy: str, *, whole: bool = False) -> Iterator[Any]:
    """An h5py.File to read from, looked through before; whatever is wrong within the block is wrong with the file.

    whole: files that are read as a whole, of at most 1 GiB.
    """
    import h5py

    path = refuse_unsafe(path, problem, remedy, whole=whole)
    with parsing(str(path), problem, remedy), h5py.File(path, "r") as file:
        hdf5_probe.keep_little(file)
        yield file


def refuse_unsafe(path: str | Path, problem: str, remedy: str, *, whole: bool = False) -> Path:
    """The path of an HDF5 file that may be opened; raises InputError otherwise."""
    path = input_file(path, remedy)
    found = path.stat()
    key = (str(path.absolute()), found.st_size, found.st_mtime_ns, found.st_ino, whole)
    if key in _probe.known:
        return path
    wrong = _probe.ask(path.absolute(), whole)
    if wrong:
        raise InputError(str(path), f"{problem} ({wrong})", remedy)
    if len(_probe.known) > _KNOWN_SIZE:
        _probe.known.clear()
    _probe.known.add(key)
    return path


def refuse_outside(where: str, dataset: Any, remedy: str) -> None:
    """Once more where the samples are read, perhaps later and in another process: they must lie in the file itself."""
    wrong = hdf5_probe.external_storage_words(dataset)
    if wrong:
        raise InputError(where, wrong, remedy)


class _Probe:
    """One child for all files of a process, started when first asked and again when it was ended."""

    def __init__(self) -> None:
        self.known: set[tuple] = set()
        self._child: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._lock = threading.Lock()

    def ask(self, path: Path, whole: bool) -> str | None:
        with self._lock:
            child = self._start_probe()
            seconds = SECONDS + int(path.stat().st_size / BYTES_A_SECOND)
            try:
                line = json.dumps({"path": str(path), "whole": whole, "seconds": seconds}) + "\n"
                asked, answered = _pipes(child)
                asked.write(line.encode())
                asked.flush()
                answer = _line(answered, float(PATIENCE * seconds + 3))
            except (OSError, ValueError):
                answer = b""
            if answer.endswith(b"\n"):
                return json.loads(answer)["problem"]
            self.close()
            if answer == b"?":
                return f"the HDF5 library is not done with it after {seconds} s: it is damaged"
            return "the HDF5 library ends on it, or does not come to an end: it is damaged"

    def _start_probe(self) -> subprocess.Popen:
        if self._owner != os.getpid():
            # after a fork the child is another process's
            self._child = None
        if self._child is None or self._child.poll() is not None:
            self.close()
            program = str(Path(hdf5_probe.__file__))
            quiet = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
            self._child = subprocess.Popen(
                [sys.executable, "-P", program, str(MEMORY)], stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=quiet, start_new_session=True, bufsize=0)
            self._owner = os.getpid()
        return self._child

    def close(self) -> None:
        child, self._child = self._child, None
        if child is None or self._owner != os.getpid():
            return
        child.kill()
        child.wait()
        for stream in _pipes(child):
            with contextlib.suppress(OSError):
                stream.close()


def _pipes(child: subprocess.Popen[bytes]) -> tuple[IO[bytes], IO[bytes]]:
    """The child's input and output."""
    assert child.stdin is not None and child.stdout is not None, "started with both as pipes"
    return child.stdin, child.stdout


def _line(stream: IO[bytes], seconds: float) -> bytes:
    """A line of a child's output; without its end where it ended, b"?" where so long nothing came."""
    end, got = time.monotonic() + seconds, b""
    with selectors.DefaultSelector() as waiting:
        waiting.register(stream, selectors.EVENT_READ)
        while not got.endswith(b"\n"):
            left = end - time.monotonic()
            if left <= 0 or not waiting.select(left):
                return b"?"
            piece = os.read(stream.fileno(), 65536)
            if not piece:
                break
            got += piece
            end = time.monotonic() + seconds
    return got


_probe = _Probe()
atexit.register(_probe.close)
