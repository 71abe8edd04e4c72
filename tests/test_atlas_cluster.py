"""Dask: a real scheduler with two worker processes on loopback, one of them killed mid-run."""

import os
import signal

import pytest
from test_atlas_search import ENERGY, PERIODS, content

from orbitfinder.atlas import search, workers
from orbitfinder.atlas.search import Limits, Search
from orbitfinder.atlas.starts import Target, context_of
from orbitfinder.atlas.store import Atlas
from orbitfinder.atlas.workers import Request
from orbitfinder.errors import InputError, OrbitfinderError
from orbitfinder.mechanisms.chain import chain

distributed = pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.needs("cluster"),
    pytest.mark.filterwarnings("default"),
    pytest.mark.filterwarnings("ignore:unclosed"),
]
STARTS = 40


@pytest.fixture(scope="module")
def loopback():
    """A scheduler and two worker processes, which their nannies start again when they die."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as running:
        yield running.scheduler_address


@pytest.mark.slow
def test_a_cluster_with_a_killed_worker_finds_the_same(loopback, tmp_path):
    """The starts of the dead worker are given to the other one; orbits and starts are those of one process."""
    system = chain(3)
    search.search(system, ENERGY, PERIODS, tmp_path / "calm.sqlite", starts=STARTS, workers=0)
    task = Request(dict(system.system), Target(ENERGY, PERIODS), 0)
    with distributed.Client(loopback, set_as_default=False) as client:
        pids = client.run(os.getpid)
    crew, killed = workers.Cluster(task, loopback), []

    def progress(tally):
        if tally.done == 6 and not killed:
            killed.append(next(iter(pids.values())))
            os.kill(killed[0], signal.SIGKILL)

    with Atlas(tmp_path / "killed.sqlite", write=True, model=system) as atlas:
        one = context_of(system, Target(ENERGY, PERIODS))
        tally = Search(atlas, task, one, Limits(starts=STARTS), progress).run(crew)
    crew.close()
    assert killed and tally.done == STARTS
    assert content(tmp_path / "killed.sqlite") == content(tmp_path / "calm.sqlite")


@pytest.mark.slow
def test_by_the_front_door(loopback, tmp_path):
    """`scheduler=` gives what the workers of this machine give; nothing is left on the scheduler."""
    system = chain(3)
    search.search(system, ENERGY, PERIODS, tmp_path / "near.sqlite", starts=12, workers=0)
    search.search(system, ENERGY, PERIODS, tmp_path / "far.sqlite", starts=12, scheduler=loopback)
    assert content(tmp_path / "far.sqlite") == content(tmp_path / "near.sqlite")


def test_an_address_where_nothing_listens(tmp_path):
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        with pytest.raises(InputError, match=rf"^scheduler: no Dask scheduler answers at '{address}'"):
            search.search(chain(3), ENERGY, PERIODS, tmp_path / "a.sqlite", starts=1, scheduler=address)
    assert not (tmp_path / "a.sqlite").exists()


@pytest.mark.slow
def test_a_cluster_without_workers(tmp_path):
    with distributed.LocalCluster(n_workers=0, dashboard_address=None, host="127.0.0.1") as empty:
        crew = workers.Cluster(Request({}, Target(ENERGY, PERIODS), 0), empty.scheduler_address, waiting=0.5)
        crew._scheduler._looked = -1e9
        with pytest.raises(OrbitfinderError, match=r"no workers for 0.5 s; start some"):
            for _ in range(20):
                crew._scheduler._looked = -1e9
                crew.results(0.2)
        crew.close()


@pytest.mark.slow
def test_a_worker_that_cannot_build_the_system(loopback):
    crew = workers.Cluster(Request({"kind": "nonsense"}, Target(ENERGY, PERIODS), 0), loopback)
    from orbitfinder.atlas.workers import Job

    crew.submit([Job(0)])
    with pytest.raises(OrbitfinderError, match=r"the worker .* cannot read the problem: .*nonsense"):
        while not crew.results(5.0):
            pass
    crew.close()


def test_without_dask(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(InputError, match=r"^scheduler: needs Dask; pip install 'orbitfinder\[cluster\]'"):
        search.search(chain(3), ENERGY, PERIODS, tmp_path / "a.sqlite", starts=1, scheduler="tcp://127.0.0.1:9")
