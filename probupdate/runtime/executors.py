"""Where independent tasks run: in this process, in several, or on a Dask cluster; results are yielded as they come.

Tasks know nothing of one another and run linear algebra in one thread each, so that their results are the same wherever
they run.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import re
import signal
import threading
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from multiprocessing.connection import wait as wait_for_any
from typing import Any, TypeVar, final

import numpy as np

from probupdate import __version__
from probupdate.errors import InputError, ProbupdateError

# what a worker must not start: several threads of linear algebra for each of several processes
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# starting a process, with all that it imports, costs seconds, the time of so many blocks: fewer are not shared out
LEAST_TASKS = 40
# tasks that wait at a worker beside the one that it runs
WAITING = 2
# how long a scheduler is given to answer, how long it may have no worker before that is said, and at all, s
ANSWER_S, SAID_S, NO_WORKER_S = 10, 10, 900
# of any command; what it says of itself when interrupted is its own
KEPT = "finished blocks and chains are kept"
# of what a client of a Dask cluster says on the screen by itself
CLIENT_LOGGERS = ("distributed.client", "distributed.batched", "distributed.comm.tcp", "distributed.core")
# how often is looked whether a task came back, s
LOOKS_S = 0.02
START_WORKERS = ("start them in this environment with `OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 dask worker ADDRESS "
                 "--nworkers N --nthreads 1`")


T = TypeVar("T")


@dataclass(frozen=True)
class Shard:
    """The `number`th (from 1) of `count` shares of a job, each run by itself, as jobs of an array are."""

    number: int
    count: int

    def __post_init__(self):
        if not (isinstance(self.number, int) and isinstance(self.count, int) and 1 <= self.number <= self.count):
            raise InputError("shard", f"{self} is no share I/N", "write 1/8 for the first of eight, 8/8 for the last")

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Of '3/8'. Raises InputError for other texts."""
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found:
            raise InputError("shard", f"'{text}' is no share I/N", "write 1/8 for the first of eight, 8/8 for the last")
        return cls(int(found[1]), int(found[2]))

    def share(self, items: Sequence[T]) -> list[T]:
        """Every count-th item, so that no share has all that is slow."""
        return list(items[self.number - 1 :: self.count])

    def chunk(self, items: Sequence[T]) -> list[T]:
        """Neighbours, where these have something in common that is made once."""
        return list(items[(self.number - 1) * len(items) // self.count : self.number * len(items) // self.count])

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


class Executor(ABC):
    """Runs tasks; what it has started ends with its `with` block. `processes`, `dask_cluster` and `SERIAL` are there.
    """

    def __enter__(self) -> Executor:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(at_once=kind is not None and not issubclass(kind, Exception))

    @abstractmethod
    def as_completed(
        self, function: Callable[..., T], tasks: Sequence[tuple], *, least: int | None = None,
        lost: Callable[[tuple], T] | None = None,
    ) -> Iterator[T]:
        """function(*task) of every task, in the order in which they end. `function` must be importable by name.
        least: tasks that are worth a process of their own. lost: of a task that ends the process it runs in, also
        alone, the result is lost(task), and the others go on; without, that is an error."""

    def in_order(
        self, function: Callable[..., T], tasks: Sequence[tuple], *, shared: tuple = (), least: int = 1,
        ended: Callable[[int], None] = lambda count: None,
    ) -> list[T]:
        """function(*shared, *task) of every task, in their order. least: tasks that are worth a process of their own;
        one alone is not. What is shared may be large; what is one object in a task and in what is shared is one in the
        process it runs in. ended: called with the number of tasks that have ended."""
        runs = self if len(tasks) > 1 else SERIAL
        found: dict[int, T] = {}
        for number, result in runs._numbered_tasks(function, tasks, shared, least):
            found[number] = result
            ended(len(found))
        return [found[number] for number in range(len(tasks))]

    def _numbered_tasks(
        self, function: Callable[..., T], tasks: Sequence[tuple], shared: tuple, least: int
    ) -> Iterator[tuple[int, T]]:
        numbered = [(number, function, shared, task) for number, task in enumerate(tasks)]
        return self.as_completed(_run_numbered, numbered, least=least)

    def prepare(self, count: int, *modules: str) -> None:  # noqa: B027
        """Start up to `count` processes and import `modules` there while the caller makes its tasks ready."""

    def close(self, *, at_once: bool = False) -> None:  # noqa: B027
        """at_once: what is running is given up; the next run does it again."""


def iterate_completed(
    function: Callable[..., T], tasks: Sequence[tuple], *, jobs: int | Executor = 1, least: int | None = None
) -> Iterator[T]:
    """function(*task) of every task, in the order in which they end, on an executor or in up to `jobs` processes."""
    with executor(jobs) as runs:
        yield from runs.as_completed(function, tasks, least=least)


@contextmanager
def executor(jobs: int | Executor = 1, scheduler: str | None = None) -> Iterator[Executor]:
    """An executor for a `with` block: one that is given stays open, any other ends with the block. scheduler: address
    of a Dask cluster, such as 'tcp://10.0.0.1:8786'. Raises InputError where there is none, or `jobs` is not a
    number."""
    if isinstance(jobs, Executor):
        yield jobs
        return
    if isinstance(jobs, bool) or not isinstance(jobs, int | np.integer) or jobs < 1:
        raise InputError("jobs", f"{jobs!r} is not a number of processes", "give 1 or more")
    with processes(int(jobs)) if scheduler is None else dask_cluster(scheduler) as runs:
        yield runs


def processes(jobs: int) -> Executor:
    """Up to `jobs` processes of this machine, started when there is work for them and kept for the next tasks."""
    return SERIAL if jobs == 1 else _Processes(jobs)


def dask_cluster(address: str) -> Executor:
    """The workers of a Dask scheduler. They must see the files under the same paths and have this version installed;
    a task whose worker has gone is given to another. Needs the extra `dask`."""
    return _DaskCluster(address)


def _run_numbered(number: int, function: Callable[..., T], shared: tuple, task: tuple) -> tuple[int, T]:
    return number, function(*shared, *task)


@final
class _Serial(Executor):
    def as_completed(self, function, tasks, *, least=None, lost=None):
        yield from (function(*task) for task in tasks)


SERIAL: Executor = _Serial()


@final
class _Processes(Executor):
    def __init__(self, jobs: int):
        self._jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        self._size = 0
        self._others: set[int | None] = set()

    def as_completed(self, function, tasks, *, least=None, lost=None):
        size = self._size or min(self._jobs, len(tasks) // max(LEAST_TASKS if least is None else least, 1))
        if size <= 1 and lost is None:
            yield from SERIAL.as_completed(function, tasks)
            return
        left = list(enumerate(tasks))
        while left:
            # which of the tasks that were running ended the processes nobody knows: each is tried alone
            ended: set[int] = set()
            try:
                for number, result in self._share_tasks(function, left, max(size, 1)):
                    ended.add(number)
                    yield result
            except BrokenProcessPool:
                self.close()
                if lost is None:
                    raise _worker_ended() from None
            left = [item for item in left if item[0] not in ended]
            suspects, left = left[: (1 + WAITING) * max(size, 1)], left[(1 + WAITING) * max(size, 1) :]
            for _, task in suspects:
                yield _run_alone(function, task, lost)

    def prepare(self, count, *modules):
        pool = self._pool or self._start(self._jobs)
        with limit_threads_of_workers():
            for _ in range(min(count, self._size)):
                pool.submit(_import_all, modules)

    def _share_tasks(
        self, function: Callable, tasks: list[tuple[int, tuple]], size: int
    ) -> Iterator[tuple[int, object]]:
        """(number, result) as they come, tasks begun in their order."""
        pool = self._pool or self._start(size)
        running: dict[Future, int] = {}
        waiting = iter(tasks)
        try:
            while True:
                for number, task in islice(waiting, (1 + WAITING) * self._size - len(running)):
                    with limit_threads_of_workers():
                        running[pool.submit(function, *task)] = number
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        except KeyboardInterrupt:
            # nobody waits for what they are at
            self.close(at_once=True)
            raise
        finally:
            for future in running:
                future.cancel()

    def _start(self, size: int) -> ProcessPoolExecutor:
        self._others = {child.pid for child in multiprocessing.active_children()}
        self._size = size
        self._pool = _processes(size)
        return self._pool

    def close(self, *, at_once: bool = False) -> None:
        pool, self._pool, self._size = self._pool, None, 0
        if pool is None:
            return
        if at_once:
            _terminate_all_but(self._others)
        pool.shutdown(wait=True, cancel_futures=True)


@final
class _DaskCluster(Executor):
    def __init__(self, address: str):
        distributed = _import_distributed()
        if not re.fullmatch(r"(?:[a-z]+://)?[\w.\-\[\]:]+:\d{1,5}/?", address):
            raise InputError("scheduler", f"'{address}' is not an address", "write it as tcp://10.0.0.1:8786")
        self._address = address
        self._levels = {name: logging.getLogger(name).level for name in CLIENT_LOGGERS}
        try:
            self._client = distributed.Client(address, timeout=ANSWER_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError("scheduler", f"nothing answers at {address} ({type(error).__name__})",
                             "start one with `dask scheduler` and give its address") from None
        # a lost scheduler is said in one line here, by them in a traceback each
        for name in self._levels:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)

    def as_completed(self, function, tasks, *, least=None, lost=None):
        distributed = _import_distributed()
        waiting = iter(tasks)
        given: dict[str, tuple] = {}
        running = distributed.as_completed(loop=self._client.loop)
        try:
            self._submit(running, function, waiting, self._room(), given)
            while not running.is_empty():
                self._wait(running.has_ready)
                future = next(running)
                task = given.pop(future.key)
                yield self._result(future, task, lost)
                # what came back is dropped at the worker; as many follow as have room
                future.release()
                self._submit(running, function, waiting, self._room() - running.count(), given)
        finally:
            left = list(running.futures)
            if left:
                self._client.cancel(left)

    def _wait(self, ready: Callable[[], bool]) -> None:
        """Until a task has come back, or a worker is there. A cluster without a worker is said after a while, and ended
        after a longer one."""
        looked, idle, said = time.monotonic(), 0.0, False
        while not ready():
            time.sleep(LOOKS_S)
            now = time.monotonic()
            if now - looked < 1.0:
                continue
            idle = 0.0 if self._workers() else idle + now - looked
            looked = now
            if idle > SAID_S and not said:
                said = True
                warnings.warn(f"the scheduler at {self._address} has no worker: waiting up to {NO_WORKER_S} s for one; "
                              f"{START_WORKERS.replace('ADDRESS', self._address)}", stacklevel=2)
            if idle > NO_WORKER_S:
                raise self._no_worker_error()

    def _no_worker_error(self) -> InputError:
        return InputError("scheduler", f"{self._address} had no worker for {NO_WORKER_S} s; {KEPT}",
                          START_WORKERS.replace("ADDRESS", self._address))

    def _numbered_tasks(self, function, tasks, shared, least) -> Iterator[Any]:
        # a worker keeps once what every task's message would hold; each, as what one alone holds ends with it
        self._wait(lambda: self._workers() > 0)
        try:
            held = self._client.scatter([_Bundle(shared, tasks)], hash=False, broadcast=True, timeout=NO_WORKER_S)[0]
        except TimeoutError:
            raise self._no_worker_error() from None
        return self.as_completed(_run_bundled, [(number, function, held) for number in range(len(tasks))])

    def _workers(self) -> int:
        try:
            return len(self._client.scheduler_info(n_workers=-1)["workers"])
        except (OSError, TimeoutError, ValueError):
            # while it is started again
            return 0

    def _room(self) -> int:
        return (1 + WAITING) * max(self._workers(), 1)

    def _submit(
        self, running: Any, function: Callable, waiting: Iterator[tuple], count: int, given: dict[str, tuple]
    ) -> None:
        for task in islice(waiting, max(count, 0)):
            future = self._client.submit(_run_at_worker, __version__, function, task, pure=False)
            given[future.key] = task
            running.add(future)

    def _result(self, future: Any, task: tuple, lost: Callable[[tuple], object] | None) -> object:
        distributed = _import_distributed()
        try:
            return future.result()
        except distributed.KilledWorker as error:
            if lost is not None:
                return lost(task)
            raise ProbupdateError("a task ended every worker that it was given to, the last at "
                                  f"{error.last_worker.address} (out of memory?); {KEPT}: run again, with more "
                                  "memory a worker") from None
        except distributed.CancelledError:
            raise ProbupdateError("the Dask scheduler has gone, or every worker that held what tasks share; "
                                  f"{KEPT}: start them and run again") from None

    def close(self, *, at_once: bool = False) -> None:
        try:
            self._client.close(timeout=ANSWER_S)
        finally:
            for name, level in self._levels.items():
                logging.getLogger(name).setLevel(level)


@dataclass(frozen=True, eq=False)
class _Bundle:
    """Tasks and what they share as one object: of a tuple distributed sends each element by itself, and what was one
    object in two of them is no more."""

    shared: tuple
    tasks: Sequence[tuple]


def _run_bundled(number: int, function: Callable[..., T], held: _Bundle) -> tuple[int, T]:
    return number, function(*held.shared, *held.tasks[number])


def _import_distributed() -> Any:
    try:
        import distributed  # pyright: ignore[reportMissingImports]  (an extra of its own)
    except ImportError:
        raise InputError("scheduler", "a Dask cluster needs the package distributed, which is not installed",
                         "install it: pip install probupdate[dask]") from None
    return distributed


def _run_at_worker(version: str, function: Callable, task: tuple) -> object:
    """A task at a Dask worker, which may have joined late: refused where its numbers might differ by rounding."""
    threads = _import_distributed().get_worker().state.nthreads
    if version != __version__:
        raise InputError("scheduler", f"a worker has version {__version__} of probupdate, this is {version}",
                         "install one version everywhere")
    if threads != 1 or any(os.environ.get(name) != "1" for name in ONE_THREAD[:2]):
        raise InputError("scheduler", "a worker runs several threads, so that its numbers differ in the last digits",
                         START_WORKERS)
    return function(*task)


def _run_alone(function: Callable, task: tuple, lost: Callable[[tuple], object] | None) -> object:
    with limit_threads_of_workers(), _processes(1) as pool:
        try:
            return pool.submit(function, *task).result()
        except BrokenProcessPool:
            if lost is None:
                raise _worker_ended() from None
            return lost(task)


def _worker_ended() -> ProbupdateError:
    return ProbupdateError("a process ended by itself (out of memory, killed, or a script without `if __name__ == "
                           f"'__main__'`); {KEPT}: run again, or with one job")


def _import_all(modules: tuple[str, ...]) -> None:
    for name in modules:
        import_module(name)


def _terminate_all_but(others: set[int | None]) -> None:
    for child in multiprocessing.active_children():
        if child.pid not in others:
            child.terminate()


@contextmanager
def background_process(*tasks: tuple) -> Iterator[list[Future]]:
    """The tasks (function, *arguments) one after the other in a process of their own while the block runs; yields their
    futures. An error in the block ends that process. Functions must be importable by name."""
    others = {child.pid for child in multiprocessing.active_children()}
    with limit_threads_of_workers(), _processes(1) as pool:
        futures = [pool.submit(*task) for task in tasks]
        try:
            yield futures
        except BaseException as error:
            for future in futures:
                future.cancel()
            _terminate_all_but(others)
            if isinstance(error, BrokenProcessPool):
                raise _worker_ended() from None
            raise


@contextmanager
def limit_threads_of_workers() -> Iterator[None]:
    """Processes started within run linear algebra in one thread; this process's environment is put back after."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _processes(size: int) -> ProcessPoolExecutor:
    """Workers that end with this process, and warn of what it does."""
    return ProcessPoolExecutor(size, multiprocessing.get_context("spawn"), initializer=_begin,
                               initargs=(list(warnings.filters),))


def _begin(filters: list[tuple]) -> None:
    warnings.resetwarnings()
    for action, message, category, module, line in filters:
        wording, place = (getattr(text, "pattern", text) or "" for text in (message, module))
        warnings.filterwarnings(action, wording, category, place, line, append=True)
    _end_with_parent()


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work forever: nothing else ends it. Ctrl-C goes to all of a
    terminal's processes: the parent answers it and ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait_for_any([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
