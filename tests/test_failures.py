"""When a search fails, the message says what happened, where, and what to try."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.failure import explain, worst_defects
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.shooting import transcribe
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.systems import FUNCTIONS


@pytest.fixture(scope="module")
def shooting():
    """A double pendulum in three segments with a freed length."""
    model, state = chain(2), np.array([0.3, 0.2, 0.0, 0.0])
    problem = Problem(model, Guess(state, 2.4), pin=pin(energy=-18.0), free=("length2",))
    return transcribe(problem, np.tile(state, (3, 1)) + 0.1 * np.arange(3)[:, None])


def changed(shooting, period=2.4, unfolding=0.0, free=1.0, nodes=None):
    nodes = shooting.guess.nodes if nodes is None else nodes
    unknowns = replace(
        shooting.guess, nodes=nodes, period=period, free=np.array([free]), unfolding=np.array([unfolding])
    )
    return shooting.vector(unknowns)


def said(shooting, w, status="Infeasible"):
    error = explain(shooting, w, status, "")
    assert isinstance(error, ConvergenceError)
    return str(error)


def test_the_worst_defect_is_placed(shooting):
    """Segment, time, size, period, guess and unfolding are in the sentence."""
    w = changed(shooting)
    defects = worst_defects(shooting, w)
    assert defects.shape == (3,) and defects.max() > 1e-2
    text = said(shooting, w)
    assert f"largest defect {defects.max():.3g} at the end of segment {defects.argmax()}" in text
    assert "period 2.4 s (guess 2.4 s), unfolding 0" in text and "Infeasible" in text


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        (dict(period=0.481), "the period collapsed towards 0, where every state closes; raise guess.period"),
        (dict(period=11.9), "the period ran away upwards, as near a separatrix; lower guess.period"),
        (dict(free=0.0501), r"length2 ran to the end of its range"),
        (dict(nodes=np.zeros((3, 4))), "the search fell on an equilibrium; pin a larger energy"),
    ],
)
def test_what_happened_and_what_to_try(shooting, changes, remedy):
    """Collapse, run-away, a parameter at its bound, an equilibrium: each is recognised."""
    assert remedy in said(shooting, changed(shooting, **changes))


def test_a_pin_far_from_the_guess_is_noticed():
    """The guess hangs almost still and the pin asks for much more energy: both numbers are quoted."""
    model, state = chain(2), np.array([0.1, 0.1, 0.0, 0.0])
    problem = Problem(model, Guess(state, 2.4), pin=pin(energy=5.0))
    shooting = transcribe(problem, np.tile(state, (2, 1)) + 0.1 * np.arange(2)[:, None])
    assert "and the pin asks for 5 J" in said(shooting, shooting.start)


def test_a_pin_below_rest_is_named_as_such():
    """Of a chain it is refused at once; of what somebody wrote the way down from the guess says it."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(v**2 / 2, -9.8 * ca.cos(q - 0.4), Symbols(q, v))
    problem = Problem(model, Guess([1.0, 0.0], 2.0), pin=pin(energy=-15.0))
    shooting = transcribe(problem, np.array([[1.0, 0.0], [-0.2, 0.1]]))
    assert "asks for -15 J and at rest the system has -9.8 J near the guess; pin more" in said(shooting, shooting.start)


def test_an_unfolding_that_does_not_vanish_is_explained():
    """A loop that closes only with fictitious damping: the sentence says that no orbit is there."""
    from orbitfinder.loops.failure import advice

    problem = Problem(chain(1), Guess([1.0, 0.0], 2.0), pin=pin(theta1=1.0))
    shooting = transcribe(problem, np.array([[1.0, 0.0], [-1.0, 0.0]]))
    w = shooting.vector(replace(shooting.guess, period=2.0, unfolding=np.array([0.01])))
    assert "closes only with the fictitious damping" in advice(shooting, w, np.full(2, 1e-9))


def test_a_segment_that_cannot_be_integrated_is_named():
    """A particle falling into a singularity in the second segment: segment, time and state."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(v**2 / 2, -1 / q**2, Symbols(q, v))
    problem = Problem(model, Guess([1.0, 0.5], 2.0), pin=pin(energy=-1.0))
    shooting = transcribe(problem, np.array([[5.0, 0.0], [0.1, 0.0]]))
    error = explain(shooting, shooting.start, "Invalid_Number_Detected", "")
    assert isinstance(error, IntegrationError) and error.segment == 1
    assert "segment 1" in str(error) and "state at its start" in str(error)


def test_a_search_that_ends_at_rest_is_refused():
    """A guess next to the hanging equilibrium of a damped pendulum converges to it, and that is no orbit."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(v**2 / 2, -ca.cos(q), Symbols(q, v), forces=-0.5 * v, angles=[True])
    with pytest.raises(ConvergenceError, match="equilibrium.*start further from rest"):
        find_orbit(Problem(model, Guess([0.3, 0.0], 6.0)))


def test_a_pushed_system_that_stays_at_rest_is_refused():
    """The shaken pendulum upright at its pivot does not move: found, and refused, as an equilibrium."""
    model = FUNCTIONS["vibrated_pendulum"]()
    with pytest.raises(ConvergenceError, match="fell on an equilibrium"):
        find_orbit(Problem(model, Guess([np.pi + 0.01, 0.0], 2 * np.pi / 60)))


def test_a_real_search_that_fails_says_what_to_try():
    """Few iterations from a poor guess: one sentence with status, defect and advice."""
    model = chain(3)
    problem = Problem(model, Guess([2.5, -1.0, 2.0, 3.0, -4.0, 5.0], 1.0), pin=pin(energy=-30.0))
    with pytest.raises((ConvergenceError, IntegrationError)) as caught:
        find_orbit(problem, SolveSettings(max_iterations=3))
    text = str(caught.value)
    assert "\n" not in text and ("; " in text or "segment" in text)
