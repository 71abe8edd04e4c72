"""Searches of controlled motions: many starts, certified optima, duplicates, resuming, shards, and every verb after."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.atlas.controlled import Controlled, problem_of, statement
from orbitfinder.atlas.export import exported
from orbitfinder.atlas.signature import signature_of
from orbitfinder.cli.group import cli
from orbitfinder.control import program
from orbitfinder.errors import InputError
from orbitfinder.exports.source import samples_of
from orbitfinder.families.members import whole
from orbitfinder.mechanics.kind import build_model
from orbitfinder.problemfile.write import orbit_text
from orbitfinder.site.motion import Simulator

ROOT = Path(__file__).parents[1]
STIFFNESS, DAMPING, PERIOD, TILT = 1.0, 0.2, 5.0, 0.5
FILE = f"""
name = "wells"
[system]
kind = "python"
function = "driven_oscillator"
arguments = {{ stiffness = {STIFFNESS}, damping = {DAMPING} }}
[guess]
state = [1.2, 0.0]
period = {PERIOD}
[find]
pin = {{ xdot = 0.0, period = {PERIOD} }}
[control]
cost = "force**2"
average = true
final = "0.25 * x**4 - 1.5 * x**2 + tilt * x"
numbers = {{ tilt = {TILT} }}
shape = "fourier"
harmonics = 1
intervals = 8
[search]
period = [4.0, 6.0]
"""


def optima() -> tuple[np.ndarray, np.ndarray]:
    """x(0) and cost of both least optima: x = c + X cos(w t) under a constant and a harmonic force costs
    (k c)^2 + |k - w^2 + i d w|^2 X^2 / 2, which is h s^2 at the best c and X of a sum s = x(0)."""
    w = 2 * np.pi / PERIOD
    stiff = abs(STIFFNESS - w**2 + 1j * DAMPING * w) ** 2
    h = 1 / (1 / STIFFNESS**2 + 2 / stiff)
    s = np.sort(np.roots([1.0, 0.0, 2 * h - 3.0, TILT]).real)[[0, 2]]
    return s, h * s**2 + 0.25 * s**4 - 1.5 * s**2 + TILT * s


def moved(s: float, times: np.ndarray) -> np.ndarray:
    """x of the optimum with x(0) = s."""
    w = 2 * np.pi / PERIOD
    stiff = abs(STIFFNESS - w**2 + 1j * DAMPING * w) ** 2
    constant = s / (1 + 2 * STIFFNESS**2 / stiff)
    return np.asarray(constant + (s - constant) * np.cos(w * times))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("wells")
    (made / "wells.toml").write_text(FILE)
    return made


@pytest.fixture(scope="module")
def problem(folder: Path) -> of.Problem:
    return of.load_problem(folder / "wells.toml")


@pytest.fixture(scope="module")
def book(folder: Path, problem: of.Problem) -> Path:
    """Of four starts, every other one by each of two shards."""
    parts = [folder / f"part-{k}.sqlite" for k in (1, 2)]
    for k, part in enumerate(parts, 1):
        of.search(problem, None, (4.0, 6.0), part, starts=4, workers=0, shard=(k, 2))
    of.merge_atlases(parts, folder / "wells.sqlite")
    return folder / "wells.sqlite"


def test_many_starts_lead_to_both_optima_of_the_closed_form(book: Path) -> None:
    with of.Atlas(book) as atlas:
        orbits = sorted((atlas.orbit(row.id) for row in atlas.rows()), key=lambda orbit: orbit.state[0])
        costs = [row.cost for row in atlas.rows(order="cost")]
        assert {row.energy for row in atlas.rows()} == {0.0}  # which a control changes
        starts = atlas.select([str, str], "SELECT strategy, outcome FROM starts ORDER BY number")
    s, cost = optima()
    np.testing.assert_allclose([orbit.state[0] for orbit in orbits], s, rtol=1e-6)
    np.testing.assert_allclose(costs, np.sort(cost), rtol=1e-9)
    assert all(orbit.certificate and orbit.certificate.passed for orbit in orbits)
    assert [strategy for strategy, _ in starts] == ["loop", "push", "loop", "near"]
    assert [outcome for _, outcome in starts].count("duplicate") == 2


def test_a_program_is_derived_once_and_leads_wherever_a_fresh_one_does(
    problem: of.Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, true = list[str](), program.minimiser
    monkeypatch.setattr(program, "minimiser", lambda *given: made.append(given[0]) or true(*given))
    controlled = Controlled.of(problem, (4.0, 6.0))
    drawn = [controlled.drawn("loop", np.random.default_rng(seed)) for seed in (1, 2)]
    controlled.orbit(drawn[0])
    made.clear()
    after, _ = controlled.orbit(drawn[1])
    assert not made
    program._arrangements.clear()
    fresh, _ = controlled.orbit(drawn[1])
    assert made and fresh.control == after.control
    assert np.array_equal(fresh.nodes, after.nodes) and fresh.period == after.period


def test_it_goes_on_where_it_stopped(book: Path, problem: of.Problem) -> None:
    again = of.search(problem, None, (4.0, 6.0), book, starts=5, workers=0)
    tally = again.tallies[0][1]
    assert (tally.done, tally.duplicates, again.summary.starts, again.summary.orbits) == (1, 1, 5, 2)
    assert "loop of three harmonics" in again.summary.remarks[-1]
    assert problem.control is not None
    other = replace(problem, control=replace(problem.control, cost="2 * force**2"))
    assert of.search(other, None, (4.0, 6.0), book, starts=0, workers=0).summary.starts == 0  # another search


def test_a_known_orbit_is_known_and_one_of_a_file_is_added(book: Path, folder: Path, problem: of.Problem) -> None:
    orbit = of.find_orbit(problem)
    with of.Atlas(folder / "added.sqlite", problem.model.system, write=True) as atlas:
        assert [atlas.add(orbit), atlas.add(orbit)] == [(1, True), (1, False)]
        with of.Atlas(book) as searched:
            assert sum(atlas.add(searched.orbit(k))[1] for k in (1, 2)) == 1


def test_what_is_drawn_and_exported_of_it_moves_under_its_control(book: Path) -> None:
    with of.Atlas(book) as atlas:
        document, orbit = atlas.document(1), atlas.orbit(1)
        table = list(csv.DictReader(io.StringIO(exported(atlas, "csv", None).decode())))
    assert not orbit.samples.size
    assert float(table[0]["cost"]) == orbit.control["cost"]
    model, filmed = build_model(orbit.system), Simulator(build_model).orbit(document)
    assert filmed is not None and Simulator(build_model).neighbour(document, filmed) is None
    drawn = whole(orbit, model)
    piece, loop = filmed.course.pieces[0], signature_of(orbit, model).loop
    looped = np.arange(len(loop)) * orbit.period / len(loop), loop
    for times, states in (samples_of(orbit, model), (drawn.times, drawn.samples), (piece.times, piece.states), looped):
        np.testing.assert_allclose(states[:, 0], moved(orbit.state[0], times), atol=1e-8)


def test_the_command_searches_a_problem_file_and_every_verb_meets_the_atlas(folder: Path, book: Path) -> None:
    def run(*words: object) -> str:
        done = CliRunner().invoke(cli, [*map(str, words)])
        assert done.exit_code == 0, done.output
        return done.output

    more = folder / "more.sqlite"
    told = json.loads(run("search", folder / "wells.toml", "--atlas", more, "--starts", 1, "--workers", 0, "--json"))
    assert told["summary"]["orbits"] == 1 and told["runs"][0]["hits"] == 1
    _, cost = optima()
    assert str(cost.min())[:8] in run("atlas", "list", book)
    assert "of force**2" in run("atlas", "show", book, 1)
    assert "without symmetry were sought by" in (report := run("atlas", "report", book)) and " J" not in report
    run("verify", f"{book}#1")
    run("page", book, "-o", folder / "page")
    pages = [*(folder / "page").rglob("*.html")]
    assert pages and "Energy, not conserved" in "".join(page.read_text() for page in pages)


def test_the_problem_file_of_an_orbit_asks_for_it_again(book: Path, folder: Path, problem: of.Problem) -> None:
    with of.Atlas(book) as atlas:
        document = atlas.document(2)
    (folder / "again.toml").write_text(orbit_text(document) or "")
    again = of.load_problem(folder / "again.toml")
    assert again.control is not None and replace(again.control, guess={}) == replace(problem.control, guess={})
    assert of.find_orbit(again).control["cost"] == pytest.approx(document["control"]["cost"], rel=1e-10)


def test_a_statement_travels_whole(problem: of.Problem) -> None:
    assert problem.control is not None
    control = replace(problem.control, tasks=(of.Task("x", lowest=-3.0),))
    problem = replace(problem, control=control, bounds={"x": (-3.0, 3.0)}, tolerance=1e-9)
    asked = json.loads(json.dumps(statement(problem)))
    again = problem_of(build_model(problem.model.system), asked)
    assert statement(again) == asked
    assert again.control == problem.control and again.pin == problem.pin
    assert (again.bounds, again.tolerance) == (problem.bounds, problem.tolerance)


@pytest.mark.parametrize(
    ("change", "periods", "words"),
    [
        ({}, (1.0, 2.0), "pinned at 5 s; widen"),
        ({"free": ("damping",)}, (4.0, 6.0), "frees no parameter"),
        ({"pin": (), "control": of.Control("force**2", intervals=8)}, (4.0, 6.0), "pin a component of the state"),
        ({"control": None}, (4.0, 6.0), "has no control"),
    ],
)
def test_what_cannot_be_searched_is_said(
    problem: of.Problem, tmp_path: Path, change: dict, periods: tuple[float, float], words: str
) -> None:
    wrong = replace(problem, **change)
    with pytest.raises(InputError, match=words):
        of.search(wrong, None, periods, tmp_path / "a.sqlite", starts=1, workers=0)


@pytest.mark.slow
def test_a_gait_is_searched_for_and_an_arc_that_lasts_no_time_is_none(tmp_path: Path) -> None:
    """Two of three starts come to the same hop; the other to a stance that lasts no time."""
    hopper = of.load_problem(ROOT / "problems" / "control" / "hopping-monopod.toml")
    found = of.search(hopper, None, (0.584, 0.9125), tmp_path / "hops.sqlite", starts=3, workers=2)
    assert found.summary.failures == {"an arc lasts no time": 1} and found.summary.hits == 2
    with of.Atlas(tmp_path / "hops.sqlite") as atlas:
        (row,) = atlas.rows()
        assert row.signature == "liftoff touchdown" and row.cost == pytest.approx(of.find_orbit(hopper).control["cost"])


def test_an_energy_is_not_searched_for(problem: of.Problem, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="controlled motions conserve none"):
        of.search(problem, -1.0, (4.0, 6.0), tmp_path / "a.sqlite", starts=1, workers=0)
