"""Independent tasks in several processes, few of them waiting at a time; results are yielded as they come."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for_any

import numpy as np

from probupdate.errors import InputError, ProbupdateError

# what a worker must not start: several threads of linear algebra for each of several processes
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# starting a process, with all that it imports, costs seconds, the time of so many blocks: fewer are not shared out
LEAST_TASKS = 40


def _ended() -> ProbupdateError:
    return ProbupdateError("a process ended by itself (out of memory, killed, or a script without `if __name__ == "
                           "'__main__'`); what was finished is kept: run again, or with one job")


@contextmanager
def beside(function: Callable, *arguments) -> Iterator[Callable[[], object]]:
    """`function(*arguments)` in a process of its own while the block runs; what is yielded waits for its result. An
    error in the block ends that process. `function` must be importable by name."""
    others = {child.pid for child in multiprocessing.active_children()}
    with one_thread_each(), ProcessPoolExecutor(1, multiprocessing.get_context("spawn"),
                                                initializer=_end_with_parent) as pool:  # fmt: skip
        future = pool.submit(function, *arguments)

        def result() -> object:
            try:
                return future.result()
            except BrokenProcessPool:
                raise _ended() from None

        try:
            yield result
        except BaseException:
            for child in multiprocessing.active_children():
                if child.pid not in others:
                    child.terminate()
            raise


def completed(
    function: Callable, tasks: Sequence[tuple], *, jobs: int = 1, least: int | None = None
) -> Iterator[object]:
    """function(*task) of every task, in the order in which they end; at most one process for `least` tasks, and none
    but this one where that leaves one. `function` must be importable by name, as the processes are spawned."""
    if isinstance(jobs, bool) or not isinstance(jobs, int | np.integer) or jobs < 1:
        raise InputError("jobs", f"{jobs!r} is no number of processes", "give 1 or more")
    jobs = min(jobs, len(tasks) // max(LEAST_TASKS if least is None else least, 1))
    if jobs <= 1:
        yield from (function(*task) for task in tasks)
        return
    context = multiprocessing.get_context("spawn")
    others = {child.pid for child in multiprocessing.active_children()}
    running: set[Future] = set()
    with one_thread_each(), ProcessPoolExecutor(jobs, context, initializer=_end_with_parent) as pool:
        try:
            for task in tasks:
                if len(running) >= 3 * jobs:
                    ended, running = wait(running, return_when=FIRST_COMPLETED)
                    yield from (future.result() for future in ended)
                running.add(pool.submit(function, *task))
            while running:
                ended, running = wait(running, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in ended)
        except BrokenProcessPool:
            raise _ended() from None
        except KeyboardInterrupt:
            # nobody waits for what they are at: it is done again by the next run
            for child in multiprocessing.active_children():
                if child.pid not in others:
                    child.terminate()
            raise
        finally:
            for future in running:
                future.cancel()


@contextmanager
def one_thread_each() -> Iterator[None]:
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


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever: nothing else tells it. Ctrl-C goes to all of a
    terminal's processes: the parent answers it and ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait_for_any([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
