"""Sweeps and maps on a real Dask cluster: the same as here; what is wrong with a worker is said of it by name."""

import json
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder._runtime import cluster, tasks
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError, OrbitfinderError
from orbitfinder.records.registry import load

ROOT = Path(__file__).parents[1]
OWN = """import orbitfinder as of
def spring(frequency=1.2, damping=0.2):
    return of.systems.forced_duffing(frequency=frequency, damping=damping)
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
                    "frequency = 1.2\ndamping = 0.2\n[guess]\nstate = [0.5, 0.0]\nperiod = 5.0\n")  # fmt: skip
    from orbitfinder.problemfile.read import load_problem_file

    problem = load_problem_file(file, trust=True).wanted
    cycle = 2 * np.pi / problem.model.parameter_values[problem.model.parameter_index("frequency")]
    problem = of.Problem(problem.model, of.Guess([0.5, 0.0], cycle), name="own")
    values = {"damping": list(np.linspace(0.2, 0.4, 20))}
    one = of.sweep(problem, values)
    two = of.sweep(problem, values, scheduler=loopback, folder=tmp_path)
    assert one.certified == two.certified == 20
    assert [row.orbit.state for row in two.rows] == [pytest.approx(row.orbit.state, rel=1e-9) for row in one.rows]


def by_command(*words):
    said = CliRunner().invoke(cli, [*map(str, words), "--json"])
    assert said.exit_code == 0, said.output
    return json.loads(said.stdout)


@pytest.mark.slow
@pytest.mark.needs("cluster")
@pytest.mark.filterwarnings("default", "ignore:unclosed")
@pytest.mark.parametrize(
    ("words", "reading"),
    [
        ("bifurcation problems/maps/pendulum-cascade.toml --parameter torque=1.03:1.07:80 --transient 20 --samples 8",
         lambda made: [made.states, made.times, made.owners, made.repeats]),
        ("diagram problems/equations/lorenz.toml --parameter rho --from 0.2 --until 28",
         lambda made: [np.array([one.state for one in curve.record.points]) for curve in made.curves]),
        ("map problems/maps/driven-pendulum.toml --parameter frequency=6:7:8 --parameter torque=0.5:0.8:20 --sample 1",
         lambda made: [made.nodes, made.multipliers]),
    ],
    ids=["bifurcation", "diagram", "map"],
)  # fmt: skip
def test_processes_and_a_cluster_do_what_this_process_does(loopback, tmp_path, words, reading, capfd):
    """By the command: every bit; what a cluster has finished is not done again."""
    command, file, *rest = words.split()
    made = {}
    for k, how in enumerate((["--workers", 1], ["--workers", 2], ["--scheduler", loopback])):
        told = by_command(command, ROOT / file, *rest, "-o", tmp_path / str(k), "--no-figures", *how)
        made[k] = reading(load(told["written"][0]))
    assert len(made[0]) > 1
    for one, two, far in zip(*made.values(), strict=True):
        assert np.array_equal(one, two) and np.array_equal(one, far)
    assert " s left" in capfd.readouterr().err or command != "diagram"
    before = {file: file.read_bytes() for file in (tmp_path / "2").rglob("*.jsonl")}
    told = by_command(command, ROOT / file, *rest, "-o", tmp_path / "2", "--no-figures", "--scheduler", loopback)
    assert before and {file: file.read_bytes() for file in (tmp_path / "2").rglob("*.jsonl")} == before


@pytest.mark.slow
@pytest.mark.needs("cluster", "proof")
@pytest.mark.filterwarnings("default", "ignore:unclosed")
def test_an_atlas_is_proved_on_a_cluster(loopback, tmp_path):
    """Each orbit once, recorded here; what the workers prove is what is proved here, and is not proved again."""
    books = [
        shutil.copy(ROOT / "results" / "atlas" / "lorenz.sqlite", tmp_path / f"{name}.sqlite")
        for name in ("far", "near")
    ]
    told = [by_command("prove", book, "--shard", "1/40", *how)["results"]
            for book, how in zip(books, (["--scheduler", loopback], []), strict=True)]  # fmt: skip
    numbers = [[int(one["file"].rpartition("#")[2]) for one in results] for results in told]
    assert sorted(numbers[0]) == numbers[1] == sorted(set(numbers[0])) and len(numbers[0]) > 0
    far, near = ({one["file"].rpartition("#")[2]: one for one in results} for results in told)
    for number, one in far.items():
        for entry in ("proved", "period", "multipliers"):
            assert one.get(entry) == near[number].get(entry), entry
    with Atlas(books[0]) as atlas:
        assert all(atlas.row(number).proof for number in numbers[0])
    assert by_command("prove", books[0], "--shard", "1/40", "--scheduler", loopback)["results"] == []


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
