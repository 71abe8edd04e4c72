"""The first cycle of a Hopf point in every unit and place; branches and families that leave their equations' domain."""

import importlib
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import verified

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import DomainError, InputError
from orbitfinder.families.rest_problem import regular
from orbitfinder.families.start import begin
from orbitfinder.integrate.jets import at_rest
from orbitfinder.loops.scales import sizes
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.records.ends import end_fault, stuck
from orbitfinder.records.family import CLOSURE, End

DATA, SETTINGS = Path(__file__).parent / "data", of.FamilySettings(parameter="mu", directions="away", longest_step=0.25)
NORMAL = {"x": "mu*{x} - 3*{y} - {x}*({x}^2 + {y}^2)", "y": "3*{x} + mu*{y} - {y}*({x}^2 + {y}^2)"}


def normal_form(size, place):
    """mu = r^2, of a radius of `size` r about (place, place), period 2 pi / 3."""
    at = {name: f"(({name} - {place!r})/{size!r})" for name in "xy"}
    rates = {name: f"({text.format(**at)})*{size!r}" for name, text in NORMAL.items()}
    return of.equations(rates=rates, parameters={"mu": -0.5})


def first_cycle(model, state, until=1.0, parameter="mu"):
    """The start of the family at the first Hopf point."""
    rest = of.follow_equilibria(model, state, parameter, until=until)
    number = next(k for k, event in enumerate(rest.events) if event.kind == "hopf")
    return of.switch_branch(rest, number, settings=replace(SETTINGS, parameter=parameter), model=model)


@pytest.mark.parametrize(("size", "place"), [(1.0, 0.0), (1e-3, 0.0), (1e-6, 0.0), (1e6, 0.0), (1e-3, 5.0), (1e6, 1.0)])
def test_a_first_cycle_has_the_size_of_the_normal_form(size, place):
    """mu = r^2 is the growth of 1e-3 in a radian wherever the equilibrium is and whatever its unit; 2 % of the state
    before, mu = 4e-16 where the unit is 1e6."""
    start = first_cycle(normal_form(size, place), [place, place]).start
    found = start.solution.place
    assert found.free[0] == pytest.approx(3e-3, rel=1e-6) and found.period == pytest.approx(2 * np.pi / 3, rel=1e-9)
    radius = np.hypot(*(found.nodes[0] - place)) / size
    assert radius**2 == pytest.approx(found.free[0], rel=1e-6)


def test_a_first_cycle_about_zeros_beside_ones():
    """x'' about x0 = 1, z = 0: near 0 the amplitude is 2 sqrt(mu); mu was 2.4e-10 there, below all round-off."""
    loaded = load_problem_file(DATA / "oscillator-offset.toml", False)
    found = first_cycle(loaded.model, loaded.start).start.solution
    (mu,) = found.place.free
    assert mu == pytest.approx(2e-3, rel=0.01)
    assert np.ptp(found.march.states[:, 0]) == pytest.approx(4 * np.sqrt(mu), rel=1e-3)


@pytest.mark.slow
def test_the_family_of_the_offset_oscillator(tmp_path):
    """At mu = 1 T = 0.1025121, x from -1.00862 to 3.00862; it was one orbit, "the orbits shrink to the equilibrium"."""
    options = ["--parameter", "mu", "--until", "1", "--no-figures", "--out", str(tmp_path)]
    answer = CliRunner().invoke(cli, ["diagram", str(DATA / "oscillator-offset.toml"), *options])
    assert answer.exit_code == 0 and "could not be located" not in answer.output
    family = of.load_family(tmp_path / "oscillator-offset" / "equilibria-0" / "family.json")
    last = family.points[-1]
    model = with_parameters(load_problem_file(DATA / "oscillator-offset.toml", False).model, {"mu": 1.0})
    x = of.find_orbit(of.Problem(model, of.Guess(last.state, last.period))).samples[:, 0]
    assert last.value == 1.0 and last.period == pytest.approx(0.1025121, rel=1e-6)
    assert [x.min(), x.max()] == pytest.approx([-1.00862, 3.00862], abs=1e-4)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e6])
def test_a_degenerate_first_cycle_is_where_its_rates_bend(unit):
    """l1 = 0 and mu = r^4: no normal form of the third order says how large, the rates do."""
    q = f"(x^2 + y^2)^2/{unit!r}^4"
    rates = {"x": f"mu*x - y - x*{q}", "y": f"x + mu*y - y*{q}"}
    found = first_cycle(of.equations(rates=rates, parameters={"mu": -0.37}), [0.0, 0.0], 0.5).start.solution.place
    radius = np.hypot(*found.nodes[0]) / unit
    assert 1e-7 < found.free[0] < 0.1 and radius**4 == pytest.approx(found.free[0], rel=1e-6)


def test_a_first_cycle_knows_what_follows_it_to_second_order():
    """z follows 1e6 (x^2 + y^2), 0 in the eigenvector: by shooting and collocation none was found."""
    rates = {"x": "mu*x - y - x*z/1e6", "y": "x + mu*y - y*z/1e6", "z": "-z + 1e6*(x^2 + y^2)"}
    found = first_cycle(of.equations(rates=rates, parameters={"mu": -0.37}), [0.0] * 3, 0.5).start.solution.place
    assert found.free[0] == pytest.approx(1e-3, rel=1e-6) and found.nodes[0][2] == pytest.approx(1e3, rel=1e-6)


def test_what_does_not_move_is_measured_in_itself():
    """The round-off of a component that stays is no size: steps along that family were 1e-7 long."""
    turn, model = np.linspace(0, 2 * np.pi, 100), normal_form(1.0, 0.0)
    noise = 7.0 + 1e-15 * np.random.default_rng(0).uniform(-1, 1, turn.size)
    assert sizes(model, np.ones(2), np.column_stack([np.cos(turn), noise]), 1.0) == pytest.approx(
        [0.5**0.5, 7], rel=1e-3
    )


def test_a_vertical_family_has_a_parameter_of_its_own_size():
    """A pendulum's damping stays 0: it was measured in what the corrector's round-off changed it by, some 1e-17."""
    model = of.equations(rates={"x": "y", "y": "-sin(x) - p*y"}, parameters={"p": -0.37})
    start = first_cycle(model, [0.0, 0.0], 0.5, "p").start
    assert abs(start.solution.place.free[0]) < 1e-12 and start.curve.scales.free[0] > 1e-3


@pytest.mark.slow
def test_a_vertical_family_is_followed_to_its_end():
    """The pendulum's own swings, to the separatrix; it ended after one, which "closes only to 2.3e-11"."""
    model = of.equations(rates={"x": "y", "y": "-sin(x) - p*y"}, parameters={"p": -0.37})
    settings = replace(SETTINGS, parameter="p", events=False)
    family = of.follow_family(first_cycle(model, [0.0, 0.0], 0.5, "p"), settings=settings, model=model, points=200)
    assert family.ends[-1].kind == "heteroclinic" and max(abs(point.value) for point in family.points) < 1e-12


def test_a_first_orbit_that_does_not_close_gets_a_finer_mesh(monkeypatch):
    """As every later one: a family failed at its start that was followed to there from its other end."""

    def coarse(curve, place, several):
        return place.on(np.interp(np.linspace(0, 1, 25), np.linspace(0, 1, place.mesh.size), place.mesh))

    monkeypatch.setattr("orbitfinder.families.start.fitted", coarse)
    monkeypatch.setattr("orbitfinder.families.start.settled", lambda curve, solution, whole: solution)
    problem = of.Problem(of.systems.van_der_pol(), of.Guess([2.0, 0.0], 6.66))
    settings = of.FamilySettings("damping", directions="forward", points=1, events=False)
    start = begin(problem, settings)
    assert start.solution.place.mesh.size == 25
    point = of.follow_family(start, settings=settings).points[0]
    assert point.closure <= CLOSURE * point.scale and point.mesh.size > 25


def test_a_family_of_one_orbit_does_not_shrink():
    """Whatever stops a family at its first orbit, it was not seen to become smaller; and that is a failure."""
    branch, model = first_cycle(normal_form(1e-6, 1.0), [1.0, 1.0]), normal_form(1e-6, 1.0)
    refused = replace(SETTINGS, sharpest_turn=1e-9, shortest_step=SETTINGS.first_step)
    family = of.follow_family(branch, settings=refused, model=model)
    assert len(family.points) == 1 and family.ends[-1].kind == "step underflow"
    assert stuck(family) == family.ends[-1].reason
    for kind, count, failed in (("step underflow", 1, True), ("step underflow", 4, False), ("target", 1, False)):
        other = SimpleNamespace(points=family.points * count, ends=(End(kind, "stopped"),))
        assert stuck(other) == ("stopped" if failed else "")


def test_a_branch_is_measured_where_it_is(tmp_path):
    """A predator's two equilibria cross at K = 0.5; sizes were asked at K = 0, where rates divide by it."""
    loaded = load_problem_file(DATA / "transcritical-capacity.toml", False)
    model = with_parameters(loaded.model, {"K": 0.2})
    rest = of.follow_equilibria(model, loaded.start, "K", until=2.0)
    other = of.follow_equilibria(of.switch_branch(rest, 0, model=model), until=2.0)
    assert rest.events[0].parameter == pytest.approx(0.5, abs=1e-12) and other.points[-1].value == 2.0
    assert all(point.certified for point in other.points)
    with pytest.raises(DomainError, match="the rate of N, or a slope of it, is not a finite number"):
        regular(at_rest(model, ("K",), np.ones(2)), np.ones(2), np.zeros(1))


@pytest.mark.parametrize(
    ("rate", "first", "state", "until", "edge"),
    [
        ("p - sqrt(x)", 1.0, 1.0, -1.0, 0.0), ("sqrt(1 - p^2) - x", 0.0, 1.0, 2.0, 1.0),
        ("asin(p) - x", 0.0, 0.0, 2.0, 1.0), ("p - x*log(x)", -0.2, 0.0787, 0.5, 0.0),
        ("p - x^1.5", 1.0, 1.0, -1.0, 0.0),
    ],
)  # fmt: skip
def test_a_branch_ends_where_its_equations_do(rate, first, state, until, edge):
    """In a sentence, near the edge, and all of it is certified; "leave the numbers" was a failed step."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = of.equations(rates={"x": rate}, parameters={"p": first})
        rest = of.follow_equilibria(model, [state], "p", until=until)
    (end,) = rest.ends[-1:]
    assert end.kind == "singularity" and end.reason.startswith("the branch leaves the domain of its equations at p = ")
    assert "the rate of x" in end.reason and rest.points[-1].value == pytest.approx(edge, abs=1e-3)
    assert verified(rest, model).passed and end_fault(end, ()) == ""
    assert end_fault(replace(end, kind="step underflow"), ())


@pytest.mark.slow
def test_a_family_ends_where_its_equations_do():
    """Its cycles grow to x = 1/2, where a root begins to be taken of negative numbers."""
    more = "1e-3*sqrt(0.5 - x) - 1e-3*sqrt(0.5)"
    rates = {"x": f"mu*x - y - x*(x^2 + y^2) + {more}", "y": "x + mu*y - y*(x^2 + y^2)"}
    model = of.equations(rates=rates, parameters={"mu": -0.5})
    family = of.follow_family(first_cycle(model, [0.0, 0.0]), settings=replace(SETTINGS, events=False), model=model,
                              points=80)  # fmt: skip
    end = family.ends[-1]
    assert end.kind == "singularity" and "beyond [ 0.49" in end.reason and "not defined" in end.reason
    assert family.points[-1].value == pytest.approx(0.2505, abs=1e-3)


@pytest.mark.slow
def test_a_diagram_whose_family_is_one_orbit_failed(monkeypatch):
    """It was followed, and the command ended with 0."""
    family_diagram = importlib.import_module("orbitfinder.families.diagram")  # where the package has the function
    end, follow = End("step underflow", "step below 1e-07: stopped"), family_diagram.follow_family

    def short(*given, **options):
        family = follow(*given, **options | {"points": 1})
        return replace(family, points=family.points[:1], ends=(end,))

    monkeypatch.setattr(family_diagram, "follow_family", short)
    (fork,) = of.diagram(normal_form(1.0, 0.0), [0.0, 0.0], "mu", 1.0, depth=1).branchings
    assert fork.became == "failed" and fork.words.endswith(end.reason) and fork.leads == ("equilibria-0/family.json",)


def test_no_warning_of_numpy_reaches_a_user(monkeypatch):
    """Whatever a command computes: what is not finite is judged where it is used."""
    known = []

    def read(*_):
        known.append(np.geterr())
        raise InputError("file: of the test")

    monkeypatch.setattr("orbitfinder.problemfile.read.load_problem_file", read)
    answer = CliRunner().invoke(
        cli, ["diagram", str(DATA / "oscillator-offset.toml"), "--parameter", "mu", "--until", "1"]
    )
    assert answer.exit_code == 2 and set(known[0].values()) == {"ignore"}
