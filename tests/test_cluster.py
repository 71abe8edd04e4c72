"""Sweeps and maps on a real Dask cluster: the same as here; what is wrong with a worker is said of it by name."""

import os
import time

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder._runtime import cluster, tasks
from orbitfinder.errors import InputError, OrbitfinderError

OWN = """import orbitfinder as of
def spring(k=1.0, damping=0.2):
    return of.systems.forced_duffing(stiffness=k, damping=damping)
"""


def swing():
    model = of.systems.forced_pendulum(torque=0.9, damping=0.5)
    return of.Problem(model, of.Guess([0.1, 0.0], 3.14159), name="swing")


def test_a_worker_of_another_version_is_refused_by_name():
    """Whatever it would answer: before its work and, where it was there first, before any work."""
    own = cluster.packed(None)
    wrong = cluster.Luggage({**own.versions, "casadi": "3.7.0"})
    assert cluster.performed(own, int, "3") == 3
    with pytest.raises(cluster.WorkerFault, match=r"worker .* has casadi .*here it is casadi 3.7.0.*casadi==3.7.0"):
        cluster.performed(wrong, int, "3")
    with pytest.raises(cluster.WorkerFault, match="the worker .* failed with ValueError: invalid literal"):
        cluster.performed(own, int, "three")


def test_modules_of_a_trusted_folder_go_along(tmp_path):
    """They lie where `home` says, whatever the folder is called there; another content is another folder."""
    (tmp_path / "own.py").write_text(OWN)
    luggage = cluster.packed(tmp_path)
    assert luggage.folder.startswith(cluster.SENT) and cluster.home(str(tmp_path)) == tmp_path
    place = cluster.performed(luggage, cluster.home, luggage.folder)
    assert (place / "own.py").read_text() == OWN and [file.name for file in place.iterdir()] == ["own.py"]
    (tmp_path / "own.py").write_text(OWN + "#")
    assert cluster.packed(tmp_path).folder != luggage.folder


def died_at(number, file):
    """A task whose process dies, at the first of them once."""
    if number == 1 and not os.path.exists(file):
        open(file, "w").close()
        os._exit(3)
    return number**2


def dies(number):
    os._exit(3)


def test_a_process_that_dies_is_replaced_and_says_where(tmp_path):
    with tasks.crew(died_at, 2, "test") as answers:
        assert dict(answers([(k, str(tmp_path / "once")) for k in range(4)])) == {0: 0, 1: 1, 2: 4, 3: 9}
    with tasks.crew(dies, 2, "test") as answers, pytest.raises(OrbitfinderError, match="test: processes die at task 1"):
        list(answers([(0,)]))
    with pytest.raises(InputError, match="workers: must be"), tasks.crew(dies, 0, "test"):
        pass


@pytest.fixture(scope="module")
def loopback():
    import distributed

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as running:
        yield running.scheduler_address


@pytest.mark.slow
@pytest.mark.needs("cluster")
@pytest.mark.filterwarnings("default", "ignore:unclosed")
def test_sweeps_and_maps_on_a_cluster_are_those_of_one_process(loopback, tmp_path):
    """The same bits of a map; a sweep is gone through in other runs: the same orbits. A module goes along."""
    given = {"damping": [0.4, 0.5, 0.6], "torque": np.linspace(0.7, 1.0, 40)}
    here, far = of.map_plane(swing(), given, sample=1), of.map_plane(swing(), given, sample=1, scheduler=loopback)
    assert np.array_equal(here.nodes, far.nodes) and here.known.all()
    (tmp_path / "own.py").write_text(OWN)
    file = tmp_path / "own.toml"
    file.write_text("name = 'own'\n[system]\nkind = 'python'\nmodule = 'own'\nfunction = 'spring'\n[system.arguments]\n"
                    "k = 1.0\ndamping = 0.2\n[guess]\nstate = [0.5, 0.0]\nperiod = 5.0\n")  # fmt: skip
    from orbitfinder.problemfile.read import load_problem_file

    problem = load_problem_file(file, trust=True).wanted
    cycle = 2 * np.pi / problem.model.parameter_values[problem.model.parameter_index("frequency")]
    problem = of.Problem(problem.model, of.Guess([0.5, 0.0], cycle), name="own")
    values = {"damping": list(np.linspace(0.2, 0.4, 20))}
    one = of.sweep(problem, values)
    two = of.sweep(problem, values, scheduler=loopback, folder=tmp_path)
    assert one.certified == two.certified == 20
    assert [row.orbit.state for row in two.rows] == [pytest.approx(row.orbit.state, rel=1e-9) for row in one.rows]


@pytest.mark.slow
@pytest.mark.needs("cluster")
@pytest.mark.filterwarnings("default", "ignore:unclosed")
def test_what_is_wrong_on_a_cluster_is_said(loopback):
    """A worker of another version, a task that fails, a scheduler that is gone."""
    import distributed

    with cluster.scheduler_at(loopback, "test", None) as far:
        far.luggage = cluster.Luggage({**far.luggage.versions, "orbitfinder": "0.1.0"})
        with tasks.crew(int, what="test", scheduler=far) as answers, pytest.raises(
            cluster.WorkerFault, match=r"test: the worker tcp://\S+ has orbitfinder .*then give the same command again"
        ):  # fmt: skip
            list(answers([("1",)]))
    with cluster.scheduler_at(loopback, "test", None) as far, tasks.crew(int, what="test", scheduler=far) as answers:
        assert dict(answers([(str(k),) for k in range(30)])) == {k: k for k in range(30)}
        with pytest.raises(cluster.WorkerFault, match=r"test: the worker tcp://\S+ on .* failed with ValueError"):
            list(answers([("x",)]))
    brief = distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, host="127.0.0.1")
    with brief, cluster.scheduler_at(brief.scheduler_address, "test", None) as far:
        under_way = tasks.from_cluster(far, time.sleep, [(0.0,), (60.0,)])
        assert next(under_way) == (0, None)
        brief.close()
        with pytest.raises(OrbitfinderError, match=r"test: the scheduler at \S+ is gone .*start it and its"):
            next(under_way)
