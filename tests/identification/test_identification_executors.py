"""Identification on every executor gives the same bytes; lost workers, killed shards and two hosts lose nothing."""

import importlib.util
import json
import logging
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest
from test_identification_resume import (  # noqa: F401  fixtures among them
    N_BLOCK,
    SETTINGS,
    hour,
    rough,
    run,
    same_results,
    stored,
    undisturbed,
)

from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError, ProbupdateError
from probupdate.identification.identify import SSISettings, identify_shard
from probupdate.runtime import executors
from probupdate.runtime.executors import Executor, Shard, dask_cluster, executor, iterate_completed, processes

needs_dask = pytest.mark.skipif(importlib.util.find_spec("distributed") is None,
                                reason="the extra `dask` is not installed")
# what distributed itself warns of is not this package's
of_dask = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning",
                                     "ignore::pytest.PytestUnraisableExceptionWarning")


def square(value: int) -> tuple[int, int]:
    return value, value * value


def where(value: int) -> tuple[int, int]:
    return value, os.getpid()


def slow_once(folder: str, number: int) -> int:
    """Says that it began, and waits until it is let go or for a while."""
    path = Path(folder) / f"{number}.{os.getpid()}"
    path.write_text("")
    deadline = time.monotonic() + 20
    while not (Path(folder) / "go").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    return number


def fatal(value: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return value


def test_processes_are_kept_for_the_next_tasks():
    with processes(2) as runs:
        first = dict(iterate_completed(where, [(k,) for k in range(8)], jobs=runs, least=1))
        # too few for processes of their own, but these are there already
        second = dict(iterate_completed(where, [(k,) for k in range(4)], jobs=runs))
    assert os.getpid() not in {*first.values(), *second.values()}
    assert set(second.values()) <= set(first.values()) and sorted(first) == list(range(8))
    assert dict(iterate_completed(where, [(1,)], jobs=2)) == {1: os.getpid()}


def test_a_process_that_ends_by_itself_is_told_and_the_executor_works_on():
    with processes(2) as runs:
        with pytest.raises(ProbupdateError, match="ended by itself"):
            list(runs.as_completed(fatal, [(k,) for k in range(3)], least=1))
        assert dict(runs.as_completed(square, [(3,), (4,)], least=1)) == {3: 9, 4: 16}


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "1/0", "a/b", "1/2/3", "-1/2"])
def test_a_shard_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="shard: .* write 1/8 for the first of eight"):
        Shard.parse(text)


def test_shards_are_a_partition():
    items = list(range(11))
    for way in (Shard.share, Shard.chunk):
        shares = [way(Shard.parse(f"{k}/4"), items) for k in range(1, 5)]
        assert sorted(sum(shares, [])) == items and max(map(len, shares)) - min(map(len, shares)) <= 1


SHARD = ("""
import json, socket, sys
given = json.loads(sys.argv[1])
socket.gethostname = lambda: given["host"]
from probupdate.campaign.reading import read_campaign
from probupdate.identification.identify import SSISettings, identify_shard
from probupdate.runtime.executors import Shard
from pathlib import Path
import time
def gently(what, done, total):
    # so that there is a moment to kill it in
    time.sleep(given["pause"])
print(identify_shard(read_campaign(given["campaign"]), Shard.parse(given["shard"]), """
        """settings=SSISettings(**given["settings"]),
                     store=given["store"], progress=gently).summary)
""")


def shard_process(campaign, store, shard: str, host: str, pause: float = 0.0) -> subprocess.Popen:
    given = {"campaign": str(campaign), "settings": SETTINGS, "store": str(store), "shard": shard, "host": host,
             "pause": pause}
    return subprocess.Popen([sys.executable, "-c", SHARD, json.dumps(given)], stdout=subprocess.PIPE, text=True,
                            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})


def said(shards) -> list[str]:
    texts = [one.communicate(timeout=120)[0] for one in shards]
    assert all(one.returncode == 0 for one in shards)
    return texts


def test_two_hosts_shards_on_one_folder_killed_and_resumed(hour, rough, undisturbed, tmp_path):  # noqa: F811
    """Two processes with host names of their own, each with half of the blocks; both killed on the way; started again
    with the same commands; then standard deviations; then modes. Every file is written once, with the bytes of one
    undisturbed run in one process."""
    out, store = tmp_path / "modes.json", tmp_path / "modes.json.blocks"
    shards = [shard_process(hour, store, f"{k}/2", f"host-{k}", 0.3) for k in (1, 2)]
    deadline = time.monotonic() + 60
    while len(list(store.glob("*.poles.npz"))) < 5 and time.monotonic() < deadline:
        time.sleep(0.02)
    for one in shards:
        one.kill()
        one.communicate()
    left = stored(out)
    assert 5 <= len(left) < N_BLOCK
    first = said([shard_process(hour, store, f"{k}/2", f"host-{k}") for k in (1, 2)])
    identified = [int(text.split(": ")[1].split()[0]) for text in first]
    assert sum(identified) == N_BLOCK - len(left)
    poles = stored(out)
    assert {name: poles[name] for name in left} == left
    # whichever shard came last may have found all blocks there, and begun with standard deviations
    settings = SSISettings(**SETTINGS)
    again = [identify_shard(read_campaign(hour), Shard(k, 2), settings=settings, store=store) for k in (1, 2)]
    assert all(one.identified == 0 and one.left == 0 for one in again) and again[1].left_std == 0
    there = stored(out)
    assert {name for name in there if name.endswith(".poles.npz")} == {name for name in poles if "poles" in name}
    reports = []
    run(hour, rough, out, progress=lambda *a: reports.append(a))
    assert reports[0] == ("identifying blocks", N_BLOCK, N_BLOCK)
    assert same_results(out, undisturbed)
    final = stored(out)
    # a later round chooses another pole in some blocks; the shards did all others
    assert sum(final[name] != there[name] for name in there) <= 2 and set(there) == set(final)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two workers of one thread each, in processes of their own."""
    distributed = pytest.importorskip("distributed")
    # what tests define is importable there too
    here = os.pathsep.join([str(Path(__file__).parent),
                            *(p for p in os.environ.get("PYTHONPATH", "").split(os.pathsep) if p)])
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = here
    try:
        with executors.limit_threads_of_workers(), distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0",
                local_directory=str(tmp_path_factory.mktemp("dask"))) as found:
            yield found
    finally:
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before


@needs_dask
@of_dask
def test_identification_has_the_same_bytes_on_processes_and_on_a_dask_cluster(
    hour, rough, undisturbed, tmp_path, cluster, monkeypatch  # noqa: F811
):
    monkeypatch.setattr(executors, "LEAST_TASKS", 8)
    (tmp_path / "dask").mkdir()
    with executor(1, cluster.scheduler_address) as runs:
        run(hour, rough, tmp_path / "dask" / "modes.json", jobs=runs)
    assert same_results(tmp_path / "dask" / "modes.json", undisturbed)
    (tmp_path / "two").mkdir()
    run(hour, rough, tmp_path / "two" / "modes.json", jobs=2)
    assert same_results(tmp_path / "two" / "modes.json", undisturbed)


@needs_dask
@of_dask
def test_a_dask_worker_killed_loses_no_task_and_repeats_none_that_came_back(tmp_path, cluster):
    """kill -9 of a worker that is at a task: this one begins again elsewhere; every result comes once."""
    tasks = [(str(tmp_path), k) for k in range(8)]
    results = []
    with dask_cluster(cluster.scheduler_address) as runs:
        found = runs.as_completed(slow_once, tasks)
        import threading

        thread = threading.Thread(target=lambda: results.extend(found))
        thread.start()
        deadline = time.monotonic() + 30
        while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < deadline:
            time.sleep(0.02)
        begun = sorted(p.name for p in tmp_path.iterdir())
        victim = begun[0].split(".")
        os.kill(int(victim[1]), signal.SIGKILL)
        # another worker, or the same started again, takes it up
        while len(list(tmp_path.glob(f"{victim[0]}.*"))) < 2 and time.monotonic() < deadline:
            (tmp_path / "go").touch()
            time.sleep(0.02)
        thread.join(60)
    assert sorted(results) == list(range(8))
    starts = [p.name.split(".")[0] for p in tmp_path.iterdir() if p.name != "go"]
    assert {k: starts.count(k) for k in set(starts)} == {str(k): 1 + (str(k) == victim[0]) for k in range(8)}


@needs_dask
@of_dask
def test_mistakes_of_a_scheduler_are_named(cluster, monkeypatch):
    with pytest.raises(InputError, match="scheduler: 'nowhere' is not an address; write it as tcp"):
        dask_cluster("nowhere")
    monkeypatch.setattr(executors, "ANSWER_S", 0.2)
    with pytest.raises(InputError, match=r"scheduler: nothing answers at tcp://127\.0\.0\.1:9"):
        dask_cluster("tcp://127.0.0.1:9")
    monkeypatch.setattr(executors, "ANSWER_S", 10)
    monkeypatch.setattr(executors, "__version__", "0.0.0")
    with (dask_cluster(cluster.scheduler_address) as runs,
          pytest.raises(InputError, match=r"a worker has version .*, this is 0\.0\.0; install one version everywhere")):
        list(runs.as_completed(square, [(1,)]))


@needs_dask
@of_dask
def test_a_lost_scheduler_is_no_traceback_of_the_client_s(cluster):
    """The error says it in one line; what others have set of its logger is theirs again afterwards."""
    client = logging.getLogger("distributed.client")
    before = client.level
    with dask_cluster(cluster.scheduler_address):
        assert not client.isEnabledFor(logging.ERROR)
    assert client.level == before and client.isEnabledFor(logging.ERROR)


@needs_dask
@of_dask
def test_a_scheduler_without_a_worker_is_said_and_ended(monkeypatch):
    """In silence it waited forever."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "SAID_S", 1)
    monkeypatch.setattr(executors, "NO_WORKER_S", 3)
    with (distributed.LocalCluster(n_workers=0, dashboard_address=":0", processes=True) as empty,
          dask_cluster(empty.scheduler_address) as runs):
        # tasks that share something are sent another way
        for run in (lambda: list(runs.as_completed(square, [(1,)])), lambda: runs.in_order(square, [(1,), (2,)])):
            with (pytest.warns(UserWarning, match=f"{empty.scheduler_address} has no worker: waiting up to 3 s"),
                  pytest.raises(InputError, match="had no worker for 3 s; finished blocks and chains are kept; start")):
                run()


def test_without_dask_its_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"needs the package distributed, .* pip install probupdate\[dask\]"):
        dask_cluster("tcp://127.0.0.1:8786")


def test_an_executor_of_ones_own_is_used_as_it_is():
    class Counting(Executor):
        count = 0

        def as_completed(self, function, tasks, *, least=None):
            for task in tasks:
                self.count += 1
                yield function(*task)

    mine = Counting()
    assert dict(iterate_completed(square, [(2,), (5,)], jobs=mine)) == {2: 4, 5: 25} and mine.count == 2


def announcing(text: str) -> None:
    warnings.warn(text, FutureWarning, stacklevel=1)


def test_processes_warn_of_what_the_first_one_does():
    """Another package's announcement, silenced in the first one, was printed by the one beside it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message="an announcement", category=FutureWarning)
        tasks = (announcing, "an announcement"), (announcing, "a warning")
        with executors.background_process(*tasks) as (silenced, heard):
            assert silenced.result() is None
            with pytest.raises(FutureWarning, match="a warning"):
                heard.result()
