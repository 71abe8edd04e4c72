"""Symmetric modes of large amplitude: a start by harmonic balance where the linear mode is too far off."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from orbitfinder.errors import ConvergenceError
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.model import altered, energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits import shoot as solve
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.guesses.balance import balanced_guess, suits
from orbitfinder.orbits.guesses.modes import normal_mode


def mode(links: int, number: int, amplitude: float) -> Problem:
    """A linear mode asked for at its largest angle."""
    model = chain(links)
    guess = normal_mode(model, number, amplitude)
    largest = int(np.abs(guess.state[:links]).argmax())
    named = {model.state_names[largest]: float(guess.state[largest])}
    return Problem(model, guess, pin(**named), symmetry="brake+reflection")


def test_a_mode_that_ipopt_misses_is_found_along_its_family(monkeypatch):
    """The slow mode of two links at 1.5 rad: IPOPT fails from the linear mode, the orbit is certified nevertheless."""
    problem = mode(2, 1, 1.5)
    orbit = find_orbit(problem)
    assert orbit.certificate.passed and orbit.symmetry == "brake+reflection"
    assert orbit.state[problem.model.state_index(problem.pin[0].name)] == pytest.approx(problem.pin[0].value, abs=1e-12)
    assert "harmonic balance" in orbit.provenance["start"]
    assert orbit.provenance["guess"]["period"] == problem.guess.period
    monkeypatch.setattr(solve, "balanced_guess", lambda _: None)
    with pytest.raises(ConvergenceError, match="no orbit found"):
        find_orbit(problem)


@pytest.mark.slow
def test_ten_links_at_one_radian():
    """IPOPT alone fails after 50 s."""
    orbit = find_orbit(mode(10, 1, 1.0))
    assert orbit.certificate.passed and orbit.period == pytest.approx(5.513143, abs=1e-6)


def test_a_family_that_is_lost_leaves_the_first_failure():
    """The third of four modes at 1 rad is not reached; what is said is what IPOPT ran into from the user's guess."""
    problem = mode(4, 3, 1.0)
    assert balanced_guess(problem) is None
    with pytest.raises(ConvergenceError, match="Maximum_Iterations_Exceeded") as caught:
        find_orbit(problem, SolveSettings(max_iterations=10))
    assert f"(guess {problem.guess.period:.6g} s)" in str(caught.value)


@pytest.mark.parametrize("failing", [ConvergenceError("second")])
def test_a_start_that_does_not_help_leaves_the_first_failure(monkeypatch, failing):
    """Both searches fail: the first one's message is raised."""
    tried = []

    def shot(problem, *_):
        tried.append(problem.guess)
        raise failing if len(tried) == 2 else ConvergenceError("first")

    monkeypatch.setattr(solve, "_shot", shot)
    with pytest.raises(ConvergenceError, match="first"):
        find_orbit(mode(2, 1, 0.5))
    assert len(tried) == 2


@pytest.mark.parametrize("name", ["theta1", "energy", "period"])
def test_the_start_is_at_rest_and_meets_the_pin(name):
    """From the linear mode of three links, whatever is pinned; half a period later it is at its mirror image."""
    problem = mode(3, 2, 0.7)
    wanted = {"theta1": 0.4, "energy": energy(problem.model, problem.guess.state), "period": problem.guess.period * 1.1}
    problem = replace(problem, pin=pin(**{name: wanted[name]}))
    found = balanced_guess(problem)
    values = {"theta1": found.state[0], "energy": energy(problem.model, found.state), "period": found.period}
    assert values[name] == pytest.approx(wanted[name], rel=1e-6)
    assert not found.state[3:].any()
    orbit = find_orbit(replace(problem, guess=found))
    np.testing.assert_allclose(orbit.state, found.state, atol=1e-3)


def test_other_problems_have_no_such_start():
    """Another symmetry, a moving guess, no pin or one on a rate, something left free or chosen, a damped system."""
    problem = mode(2, 1, 0.5)
    assert suits(problem)
    n, t, q, v = 2, ca.SX.sym("t"), ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    p = ca.SX.sym("p", problem.model.parameter_values.size)
    moving, resting = Guess(np.array([0.1, 0.2, 0.3, 0.0]), 2.0), Guess(np.zeros(2 * n), 2.0)
    for changed in (
        {"symmetry": "none"}, {"guess": moving}, {"guess": resting}, {"pin": ()}, {"pin": pin(theta1dot=0.0)},
        {"pin": pin(theta1=0.5, theta2=0.4)}, {"free": ("length1",)}, {"objective": "min_instability"},
        {"bounds": {"period": (1.0, 3.0)}},
        {"model": altered(problem.model, forces=ca.Function("f", [t, q, v, p], [-v]))},
    ):  # fmt: skip
        other = replace(problem, **changed)
        assert not suits(other) and balanced_guess(other) is None


def test_a_system_that_does_not_rest_at_zero_has_no_such_start():
    """Upside down gravity makes q = 0 a saddle; a constant force makes it no equilibrium."""
    problem = mode(2, 1, 0.5)
    assert balanced_guess(replace(problem, model=chain(2, gravity=-9.8))) is None
    q, p = ca.SX.sym("q", 2), ca.SX.sym("p", problem.model.parameter_values.size)
    tilted = ca.Function("V", [q, p], [problem.model.potential(q, p) + ca.sum1(q)])
    assert balanced_guess(replace(problem, model=altered(problem.model, potential=tilted))) is None
