"""Parameter studies: parameters as pins, guesses of freed ones, warm refinement at other values, sweeps."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.special import ellipk
from test_search_command import run

import orbitfinder as of
from orbitfinder._runtime import limit
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.orbits import sweep as sweeping
from orbitfinder.orbits.refine import Refiner

SPRING = Path(__file__).parents[1] / "problems" / "gallery" / "spring-pendulum-swing.toml"
AMPLITUDE = 0.8


def exact(cubic, stiffness=1.0):
    """The period of x'' + stiffness x + cubic x^3 = 0 released at rest at `AMPLITUDE`."""
    square = stiffness + cubic * AMPLITUDE**2
    return 4 * ellipk(cubic * AMPLITUDE**2 / (2 * square)) / np.sqrt(square)


@pytest.fixture(scope="module")
def duffing():
    return of.Problem(of.systems.duffing(), of.Guess([AMPLITUDE, 0.0], 5.0), of.pin(x=AMPLITUDE), symmetry="brake")


@pytest.fixture(scope="module")
def spring():
    return of.load_problem(SPRING)


def test_a_sweep_is_the_elliptic_integral(duffing):
    """Hardening and softening springs, in any order, each certified; the problem's own value lies between."""
    cubics = [3.0, -0.9, 0.0, 1.0, 10.0, -0.3]
    found = of.sweep(duffing, cubic=cubics)
    assert [row["cubic"] for row in found.records] == cubics and found.certified == 6
    for row, cubic in zip(found.records, cubics, strict=True):
        assert abs(row["period"] / exact(cubic) - 1) < 1e-12
        assert row["reason"] == "" and row["stability"] == "elliptic" and row["x"] == pytest.approx(AMPLITUDE)
    assert found.orbits[1].system["arguments"]["cubic"] == -0.9
    assert all(of.certify(one).passed for one in found.orbits[:2])


def test_parameters_change_together(duffing):
    found = of.sweep(duffing, {"cubic": [0.5, 2.0], "stiffness": [2.0, 0.5]})
    assert [row["period"] for row in found.records] == pytest.approx([exact(0.5, 2.0), exact(2.0, 0.5)], rel=1e-12)


def test_what_is_pinned_can_be_swept(duffing):
    found = of.sweep(duffing, x=[0.2, AMPLITUDE, 1.5])
    assert found.certified == 3 and found.rows[1].orbit.period == pytest.approx(exact(1.0), rel=1e-12)


def test_a_sweep_finds_what_find_orbit_finds(spring):
    """Two ways to the same orbit: the energy is pinned, the guess is the sweep's own."""
    (row,) = of.sweep(spring, stiffness=[31.0]).rows
    model = of.systems.spring_pendulum(stiffness=31.0)
    found = of.find_orbit(of.Problem(model, of.Guess(row.orbit.state, row.orbit.period), of.pin(energy=-11.0)))
    assert row.certified and abs(found.period / row.orbit.period - 1) < 1e-12
    assert row.orbit.system == found.system and row.orbit.name == "spring-pendulum-swing-0001"


def test_values_that_are_not_reached_say_why(duffing):
    """At cubic = -1 / amplitude^2 = -1.5625 the motion starts on the saddle and stays there; below, it runs away."""
    found = of.sweep(duffing, cubic=[0.5, -1.6, -2.0])
    assert [row.certified for row in found.rows] == [True, False, False]
    table = found.tables()["points"]
    assert table["cubic"] == [0.5, -1.6, -2.0] and np.isfinite(table["period"]).tolist() == [True, False, False]
    assert table["stability"][1:] == ["", ""]
    assert found.records[1]["period"] is None and found.rows[1].orbit is None
    assert found.rows[1].reason.startswith("not reached: from cubic = -1.5") and "fold" in found.rows[1].reason
    impossible = of.sweep(of.Problem(of.chain(1), of.Guess([0.5, 0.0], 1.7), of.pin(energy=-4.5)), energy=[-4.0, -5.0])
    assert impossible.rows[0].certified and "pin: energy -5 J cannot be reached" in impossible.rows[1].reason


def test_what_is_no_orbit_is_not_certified(duffing, monkeypatch):
    """Planted: a refinement that is off by 1e-6, and one that leads to another orbit, twice around."""
    right = Refiner.refine

    def off(self, guess=None, pin=None):
        found = right(self, guess, pin)
        return found if guess is None else replace(found, period=found.period * (1 + 1e-6))

    def twice(self, guess=None, pin=None):
        found = right(self, guess, pin)
        return found if guess is None else replace(found, period=2 * found.period)

    monkeypatch.setattr(Refiner, "refine", off)
    (row,) = of.sweep(duffing, cubic=[2.0]).rows
    assert not row.certified and "closure" in row.reason and row.orbit is not None
    assert of.sweep(duffing, cubic=[2.0]).orbits == ()
    monkeypatch.setattr(Refiner, "refine", twice)
    (row,) = of.sweep(duffing, cubic=[2.0]).rows
    assert not row.certified and "leads to another orbit" in row.reason


def test_a_sweep_that_is_cut_off_keeps_its_rows(duffing):
    def late(row, done, total):
        assert total == 4
        if done == 2:
            limit._deadline.get().end = 0.0

    found = of.sweep(duffing, cubic=[1.0, 1.1, 1.2, 1.3], progress=late, limit=3600.0)
    assert [row.certified for row in found.rows] == [True, True, False, False]
    assert found.rows[3].reason == "stopped after 3600 s (limit): 2 of 4 values are done"


@pytest.mark.parametrize("workers", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_no_process_takes_the_name_of_anothers_orbit(duffing, workers):
    """Each numbered its own rows from 1, and the files of half the orbits were written over."""
    cubics = [2.0, 0.1, 1.0, 0.5, -0.3]
    found = of.sweep(duffing, cubic=cubics, workers=workers)
    assert [row.values["cubic"] for row in found.rows] == cubics
    assert [one.name for one in found.orbits] == [f"orbit-{k:04d}" for k in range(1, 6)]
    assert [one.system["arguments"]["cubic"] for one in found.orbits] == cubics


def test_a_swept_orbit_has_a_file_of_its_own(tmp_path, monkeypatch):
    words = ("sweep", SPRING, "--parameter", "stiffness=29,30,31", "--workers", "2", "--out", tmp_path, "--json")
    written = [Path(one) for one in json.loads(run(*words)[0])["written"]]
    assert len(written) == 5 and all(one.is_file() for one in written)
    values = {of.load_orbit(one).system["arguments"]["stiffness"] for one in written if one.name == "orbit.json"}
    assert values == {29.0, 30.0, 31.0}
    monkeypatch.setattr(sweeping.Sweep, "orbits", property(lambda found: (found.rows[0].orbit,) * 2))
    _, err = run(*words, code=1)
    assert "0001" in err and "2 results were written there, each over the one before" in err


def test_processes_find_the_same(duffing):
    cubics = list(np.linspace(-0.5, 2.0, 6))
    alone, shared = of.sweep(duffing, cubic=cubics), of.sweep(duffing, cubic=cubics, workers=2)
    assert shared.certified == 6
    assert [one["period"] for one in shared.records] == pytest.approx(
        [one["period"] for one in alone.records], rel=1e-13
    )


@pytest.mark.slow
def test_processes_know_what_an_orbit_closes_up_to():
    """A swinging spring that turns on by 167 degrees a period: no process finds it without `relative`."""
    problem = of.load_problem("problems/gallery/swinging-spring-turning.toml")
    shared = of.sweep(problem, energy=[-8.1, -8.0], workers=2)
    assert shared.certified == 2, [row.reason for row in shared.rows]
    assert shared.orbits[1].shift["phi"] == pytest.approx(2.9086764287065, rel=1e-11)


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        ({}, "values: missing; name a parameter"),
        ({"cubi": [1.0]}, "cubi: neither a physical parameter .* did you mean 'cubic'"),
        ({"cubic": 3.0}, "cubic: expected a list of numbers"),
        ({"cubic": ["a"]}, "cubic: expected a list of numbers"),
        ({"cubic": []}, "cubic: must be finite numbers, at least one"),
        ({"cubic": [1.0, float("nan")]}, "cubic: must be finite numbers"),
        ({"cubic": [1.0], "stiffness": [1.0, 2.0]}, "values: 1 of cubic, 2 of stiffness"),
        ({"cubic": [1.0], "workers": 0}, "workers: must be between 1 and 256"),
        ({"cubic": [1.0], "limit": -1.0}, "limit: must be a positive number"),
    ],
)
def test_what_cannot_be_swept(duffing, ask, said):
    with pytest.raises(InputError, match=said):
        of.sweep(duffing, **ask)


def test_a_sweep_must_know_what_is_held(duffing):
    with pytest.raises(InputError, match="pin: missing; a sweep needs to know what is held"):
        of.sweep(replace(duffing, pin=()), cubic=[1.0])
    with pytest.raises(InputError, match="stiffness: free, so that the solver chooses it"):
        of.sweep(replace(duffing, pin=of.pin(x=0.8, period=5.0), free=("stiffness",)), stiffness=[1.0])
    with pytest.raises(ConvergenceError):
        of.sweep(
            replace(duffing, guess=of.Guess([0.0, 0.0], 5.0), pin=of.pin(period=3.0), symmetry="none"), cubic=[1.0]
        )


def test_a_freed_parameter_stays_chosen(duffing):
    """Stiffness is what the period asks for, at every value of cubic."""
    problem = replace(duffing, pin=of.pin(x=AMPLITUDE, period=4.0), free=("stiffness",))
    for row in of.sweep(problem, cubic=[0.5, 1.5]).rows:
        arguments = row.orbit.system["arguments"]
        assert row.certified and abs(exact(arguments["cubic"], arguments["stiffness"]) - 4.0) < 1e-11


def test_a_parameter_is_pinned(spring, tmp_path):
    """It is the model's value; freed too, an equation; in a problem file likewise."""
    given, pin = of.Guess(spring.guess.state, 2.0), of.pin(energy=-11.0, stiffness=30.0)
    plain = of.find_orbit(of.Problem(of.systems.spring_pendulum(stiffness=30.0), given, of.pin(energy=-11.0)))
    pinned = of.Problem(spring.model, given, pin)
    assert [one.name for one in pinned.pin] == ["energy"] and pinned.model.system["arguments"]["stiffness"] == 30.0
    freed = of.find_orbit(of.Problem(spring.model, given, pin, free=("stiffness",)))
    assert plain.certificate.passed and freed.certificate.passed
    assert of.find_orbit(pinned).period == plain.period and abs(freed.period - plain.period) < 1e-13
    text = SPRING.read_text().replace("energy = -11.0", "energy = -11.0, stiffness = 30.0").split("[expected]")[0]
    (tmp_path / "a.toml").write_text(text)
    assert of.load_problem(tmp_path / "a.toml").model.system == pinned.model.system
    with pytest.raises(InputError, match="pin: unknown quantity 'stifness', did you mean 'stiffness'"):
        of.Problem(spring.model, given, of.pin(stifness=3.0))


def test_a_freed_parameter_starts_where_the_guess_says(duffing, tmp_path):
    """From the model's own stiffness, 1, the search for a period of 1 s fails."""
    wanted = {"pin": of.pin(x=AMPLITUDE, period=1.0), "free": ("stiffness",)}
    near = of.Guess([AMPLITUDE, 0.0], 1.0, free={"stiffness": 39.0})
    problem = replace(duffing, guess=near, **wanted)
    assert problem.model.parameter_values[0] == 39.0
    found = of.find_orbit(problem)
    assert found.certificate.passed and abs(exact(1.0, found.provenance["free"]["stiffness"]) - 1.0) < 1e-12
    file = tmp_path / "a.toml"
    table = '[system]\nkind = "python"\nfunction = "duffing"\n[guess]\nstate = [0.8, 0.0]\nperiod = 1.0\n'
    table += "free = {{ {} = 39.0 }}\n"
    find = '[find]\npin = { x = 0.8, period = 1.0 }\nfree = ["stiffness"]\nsymmetry = "brake"\n'
    file.write_text(table.format("stiffness") + find)
    assert of.load_problem(file).model.parameter_values[0] == 39.0
    file.write_text(table.format("cubic") + find)
    with pytest.raises(InputError, match="guess.free: 'cubic' is not free"):
        of.load_problem(file)
    with pytest.raises(InputError, match="guess.free: 'cubic' is not free to change"):
        replace(duffing, guess=of.Guess([AMPLITUDE, 0.0], 1.0, free={"cubic": 2.0}), **wanted)
    with pytest.raises(InputError, match="guess.free: stiffness must be finite"):
        replace(duffing, guess=of.Guess([AMPLITUDE, 0.0], 1.0, free={"stiffness": float("inf")}), **wanted)


@pytest.mark.parametrize("symmetry", ["none", "brake"])
def test_a_refiner_at_other_parameters(duffing, symmetry):
    """One that is freed and pinned; the orbit has it in its system and is certified."""
    pin = of.pin(x=AMPLITUDE, cubic=1.0)
    problem = replace(
        duffing, pin=pin, free=("cubic",), symmetry=symmetry, guess=of.Guess([AMPLITUDE, 0.0], exact(1.0))
    )
    refiner = Refiner(problem)
    for cubic in (1.0, 1.2, 1.5):
        orbit = refiner.orbit(refiner.refine(of.Guess([AMPLITUDE, 0.0], exact(1.2)), of.pin(x=AMPLITUDE, cubic=cubic)))
        assert orbit.certificate.passed and abs(orbit.period / exact(cubic) - 1) < 1e-12
        assert orbit.system["arguments"]["cubic"] == cubic
    with pytest.raises(InputError, match="guess.free: 'x' is not free"):
        refiner.refine(of.Guess([AMPLITUDE, 0.0], 5.0, free={"x": 1.0}))


def test_the_command(tmp_path):
    """A table as CSV and JSON, an orbit.json for each value, which verifies."""
    out, _ = run("sweep", SPRING, "--parameter", "stiffness=29:31:3", "--out", tmp_path, "--json")
    found = json.loads(out)
    assert [row["stiffness"] for row in found["rows"]] == [29.0, 30.0, 31.0] and all(
        one["certified"] for one in found["rows"]
    )
    folder = tmp_path / "spring-pendulum-swing"
    lines = (folder / "sweep.csv").read_text().splitlines()
    assert len(lines) == 4 and lines[0].startswith("stiffness,certified,reason,period,energy")
    assert json.loads((folder / "sweep.json").read_text())["rows"] == found["rows"]
    assert "3 of 3 certified" in run("show", folder / "sweep.json")[0]
    run("export", folder / "sweep.json", "--to", "csv", "-o", tmp_path)
    assert (tmp_path / "spring-pendulum-swing.csv").read_text() == (folder / "sweep.csv").read_text()
    damaged = (folder / "sweep.json").read_text().replace('"reason": ""', '"why": ""', 1)
    (tmp_path / "damaged.json").write_text(damaged)
    assert "rows[0]: not the columns" in run("show", tmp_path / "damaged.json", code=2)[1]
    run("verify", folder / "spring-pendulum-swing-0002" / "orbit.json")
    said, _ = run("sweep", SPRING, "--parameter", "energy=-11,-20", "--out", tmp_path / "b", "--no-orbits", code=1)
    assert "energy = -20 J: not reached" in said and "1 of 2 certified" in said


@pytest.mark.parametrize(
    "given", ["stiffness", "stiffness=1:2", "stiffness=1:2:0", "stiffness=a", "stiffness=1:2:x", "="]
)
def test_values_that_are_none(given, tmp_path):
    assert "--parameter: " in run("sweep", SPRING, "--parameter", given, "--out", tmp_path, code=2)[1]


MEMORY = """
import ctypes, gc, sys
import numpy as np
import orbitfinder as of

def resident():
    gc.collect()
    getattr(ctypes.CDLL(None), "malloc_trim", lambda _: 0)(0)  # or 5 MB of its reserve come or go within an orbit
    return int(next(line for line in open("/proc/self/status") if line.startswith("VmRSS")).split()[1]) / 1024

problem = of.load_problem(sys.argv[1])
for turn in range(6):
    before = resident() if turn == 2 else None or (before if turn > 2 else 0.0)
    assert of.sweep(problem, stiffness=np.linspace(26.0 + 1e-3 * turn, 34.0, 100)).certified == 100
print(resident() - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads /proc")
def test_memory_is_flat():
    """Four hundred orbits after the first two hundred; they leaked 0.28 MB each."""
    done = subprocess.run([sys.executable, "-c", MEMORY, str(SPRING)], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 8.0


@pytest.mark.slow
def test_a_dead_process_is_named(duffing, monkeypatch):
    monkeypatch.setattr(sweeping, "_serve", dies)
    with pytest.raises(of.errors.OrbitfinderError, match="sweep: a process died"):
        of.sweep(duffing, cubic=[1.0, 2.0], workers=2)


def dies(pipe, _):
    """A worker that ends at once."""
    pipe.close()


def test_shards_visit_each_value_once(tmp_path):
    """Two of three: runs of neighbouring values, each in a folder of its own; more shards than values are refused."""
    words = ["sweep", str(SPRING), "--parameter", "stiffness=30,30.5,31", "--no-orbits", "--json", "-o", str(tmp_path)]
    visited = []
    for part in ("1/2", "2/2"):
        said = CliRunner().invoke(cli, [*words, "--shard", part])
        assert said.exit_code == 0, said.output
        visited += [row["stiffness"] for row in json.loads(said.stdout)["rows"]]
        assert (tmp_path / part.replace("/", "-of-") / "spring-pendulum-swing" / "sweep.csv").is_file()
    assert visited == [30.0, 30.5, 31.0]
    assert "more shards than values" in CliRunner().invoke(cli, [*words, "--shard", "4/4"]).stderr
