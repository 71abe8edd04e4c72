"""Toy conditions, known to this file alone: what they name is pinned, followed, kept, refused, verified and shown."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import pendulum_period

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.loops import conditions
from orbitfinder.loops.conditions import Quantity, pinned
from orbitfinder.loops.loop import Equations, Loop
from orbitfinder.loops.symmetry import NONE


def kinetic(variables, _):
    n = variables.model.degrees_of_freedom
    return variables.model.kinetic(variables.start[:n], variables.start[n:], variables.parameters)


def refused(problem, pin):
    if problem.boundary.reverses:
        return f"kinetic_energy is 0 where a {problem.boundary.name} orbit starts; pin the energy"
    return "" if pin.value > 0 else f"kinetic_energy must be positive, got {pin.value:g}; give a number in J"


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    start = Quantity(lambda model: ["kinetic_energy"], kinetic, refused=refused)
    both = Quantity(lambda model: ["swing"], lambda v, _: v["energy"] * v["period"], followed=True, held=True)
    monkeypatch.setitem(conditions.QUANTITIES, "the kinetic energy at t = 0", start)
    monkeypatch.setitem(conditions.QUANTITIES, "the energy times the period", both)


@pytest.fixture
def problem():
    """A pendulum that hangs at t = 0 with 1.4 J: it swings by an angle a, 4.9 (1 - cos a) = 1.4."""
    return of.Problem(of.chain(1), of.Guess([0.0, 3.0], 1.8), pin=of.pin(kinetic_energy=1.4), name="toy")


EXACT = pendulum_period(float(np.arccos(1 - 1.4 / 4.9)))
FILE = """
name = "toy"
[system]
kind = "chain"
links = 1
[guess]
state = [0.0, 3.0]
period = 1.8
[find]
pin = PIN
"""


def run(*words, code=0):
    result = CliRunner().invoke(cli, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return result.stdout or result.stderr


def test_it_is_pinned_refined_and_swept(problem):
    assert problem.count().freedom == 0
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and abs(orbit.period - EXACT) < 1e-12
    refiner = of.Refiner(problem)
    for asked in (1.4, 1.6):
        refined = refiner.refine(None, of.pin(kinetic_energy=asked))
        assert abs(refined.state[1] ** 2 / 6 - asked) < 1e-13 and refiner.orbit(refined).certificate.passed
    swept = of.sweep(replace(problem, guess=of.Guess([0.2, 2.8], 1.7)), kinetic_energy=[1.2, 1.3])
    assert [row.orbit.state[1] ** 2 / 6 for row in swept.rows] == pytest.approx([1.2, 1.3], abs=1e-12)
    asked_for = of.Constraint(lambda v: v["kinetic_energy"] - 1.4)
    again = of.find_orbit(replace(problem, pin=(), constraints=(asked_for,)))
    assert abs(again.period - EXACT) < 1e-9


def test_a_problem_file_is_run_verified_and_shown(tmp_path):
    (tmp_path / "toy.toml").write_text(FILE.replace("PIN", "{ kinetic_energy = 1.4 }"))
    run("run", tmp_path / "toy.toml", "--out", tmp_path)
    (file,) = tmp_path.rglob("orbit.json")
    assert abs(of.load_orbit(file).period - EXACT) < 1e-12
    assert "pass" in run("verify", file).lower() and "pin kinetic energy 1.4" in run("show", file)
    for pin, why in (
        ("{ kinetic_energi = 1.4 }", "did you mean 'kinetic_energy'"),
        ("{ kinetic_energy = -1.4 }", "pin: kinetic_energy must be positive, got -1.4"),
        ("{ kinetic_energy = 1.4 }\nsymmetry = 'brake'", "pin: kinetic_energy is 0 where a brake"),
    ):
        (tmp_path / "toy.toml").write_text(FILE.replace("PIN", pin))
        assert why in " ".join(run("run", tmp_path / "toy.toml", "--out", tmp_path, code=2).split())


def test_a_family_follows_it_keeps_it_or_says_why_not(problem, tmp_path):
    with pytest.raises(InputError, match="parameter: kinetic_energy is not the same wherever on an orbit t = 0 is"):
        of.follow_family(problem, "kinetic_energy")
    few = of.FamilySettings(points=3, events=False)
    family = of.follow_family(problem, "swing", settings=few)
    assert all(abs(point.value - point.energy * point.period) < 1e-12 for point in family.points)
    assert len({round(point.value, 6) for point in family.points}) == len(family.points) > 4
    with pytest.raises(InputError, match="hold: must be energy or period or swing, got 'kinetic_energy'"):
        of.follow_family(problem, "length1", settings=replace(few, hold="kinetic_energy"))
    kept = replace(few, hold="swing")
    family = of.follow_family(problem, "length1", settings=kept, out=tmp_path)
    assert (
        np.ptp([point.energy * point.period for point in family.points])
        < 1e-12
        < 1e-3
        < np.ptp([point.value for point in family.points])
    )
    (file,) = tmp_path.rglob("family.json")
    assert json.loads(file.read_text())["curve"]["pins"].keys() == {"swing"}
    more = of.follow_family(problem, "length1", settings=replace(kept, points=4), out=tmp_path)  # from the journal
    assert len(more.points) > len(family.points) and "pass" in run("verify", file).lower()
    assert np.ptp([point.energy * point.period for point in more.points]) < 1e-12


def test_its_slope_is_that_of_its_value(problem):
    equations = Equations(problem.model, NONE, ("length1",))
    w = equations.unknowns(np.array([[0.1, 2.0], [0.3, 1.0]]), 1.7, np.linspace(0, 1, 9))
    for name in ("kinetic_energy", "swing", "theta1dot", "energy", "period", "length1"):
        condition = pinned(equations, name, 0.5)
        loop, slope = Loop(equations, np.zeros(2), (condition,)), condition.slope(equations, w)
        each = [condition.at(equations, w.moved(step)) - condition.at(equations, w.moved(-step))
                for step in 1e-5 * np.eye(w.vector.size)]  # fmt: skip
        assert np.array(each) / 2e-5 == pytest.approx(slope, abs=1e-8) and loop.size(w) == 5


def test_a_text_is_no_list_of_names(problem, monkeypatch):
    """Or its letters would be names, and parts of it pins."""
    monkeypatch.setitem(conditions.QUANTITIES, "text", Quantity(lambda model: "coordinate_sum", kinetic))
    with pytest.raises(TypeError, match="Quantity.names: returned the text 'coordinate_sum'; return a list of names"):
        of.find_orbit(replace(problem, pin=of.pin(nate_s=0.8)))
