"""A diagnosis is the same on every executor: hypotheses, held-out gains and updates know nothing of one another."""

import importlib.util
import json
import re

import numpy as np
import pytest

from probupdate import verbs
from probupdate.diagnosis.prepare import prepare
from probupdate.runtime.executors import SERIAL, dask_cluster, processes

needs_dask = pytest.mark.skipif(importlib.util.find_spec("distributed") is None,
                                reason="the extra `dask` is not installed")
# what distributed itself warns of is not this package's
of_dask = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning",
                                     "ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.fixture(scope="module")
def cluster():
    if importlib.util.find_spec("distributed") is None:
        pytest.skip("the extra `dask` is not installed")
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as one:
        yield one


@pytest.fixture(scope="module")
def two_effects(frame_file, record):
    """A model made ready, and a storey that loosens beside a channel that is wrong: the search has many moves."""
    return prepare(frame_file), record(4, storey=2, factor=0.9, from_block=18, gain=("y4", 1.12))


def files_of(folder, two_effects, jobs) -> dict[str, bytes]:
    """What a diagnosis writes, without the folder's name, which the commands that are said hold, and the checksum of
    both."""
    prepared, data = two_effects
    folder.mkdir()
    found = verbs.diagnose(prepared, data, seed=1, out=folder / "diagnosis.json", jobs=jobs)
    found.write(folder / "diagnosis.json")
    return {path.name: re.sub(rb'"checksum": "[^"]*"', b'"checksum": ""',
                              path.read_bytes().replace(str(folder).encode(), b""))
            for path in folder.iterdir() if path.suffix == ".json"}


@pytest.fixture(scope="module")
def alone(two_effects, tmp_path_factory):
    return files_of(tmp_path_factory.mktemp("alone") / "run", two_effects, SERIAL)


def test_a_diagnosis_in_two_processes_writes_the_same_bytes(alone, two_effects, tmp_path):
    assert {"diagnosis.json", "diagnosis.mean.json"} <= set(alone)
    assert len(json.loads(alone["diagnosis.json"])["findings"]) == 2
    with processes(2) as runs:
        assert files_of(tmp_path / "run", two_effects, runs) == alone


@needs_dask
@of_dask
def test_a_diagnosis_on_a_cluster_writes_the_same_bytes(alone, two_effects, cluster, tmp_path):
    with dask_cluster(cluster.scheduler_address) as runs:
        assert files_of(tmp_path / "run", two_effects, runs) == alone


def scaled(matrix: np.ndarray, offset: float, factor: float) -> float:
    return float(matrix.sum() * factor + offset)


@needs_dask
@of_dask
def test_what_tasks_share_is_theirs_on_every_executor(cluster):
    matrix = np.arange(4_000_000.0)
    wanted = [matrix.sum() * factor + 3.0 for factor in (1.0, 2.0, 5.0)]
    tasks = [(1.0,), (2.0,), (5.0,)]
    with processes(2) as two, dask_cluster(cluster.scheduler_address) as many:
        for runs in (SERIAL, two, many):
            assert runs.in_order(scaled, tasks, shared=(matrix, 3.0)) == wanted
            assert runs.in_order(scaled, [], shared=(matrix, 3.0)) == []
