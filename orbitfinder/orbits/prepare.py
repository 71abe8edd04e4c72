"""What is found out about a Problem before it is solved: do its invariants hold, how often do angles turn.

And what looks like a slip without being one: hints go with a search, as warnings, and stop nothing.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from orbitfinder.errors import Hint, InputError, IntegrationError
from orbitfinder.integrate.cvodes import Flow, end_state
from orbitfinder.integrate.dop853 import SECOND, integrate_in, vector_field
from orbitfinder.integrate.equations import accelerations
from orbitfinder.loops.polish import segment, tail_of
from orbitfinder.loops.problem import Guess, Problem, boundary_constants, whole_turns
from orbitfinder.loops.shooting import far_end, units_of
from orbitfinder.loops.symmetry import off_centre
from orbitfinder.records.orbit import Orbit

DRIFT = 1e-7
"""An invariant that changes by more than this along the guess's motion, relative to its size, is none."""
SECTION = 1e-3
"""Coordinates this near to where an odd motion starts are left to the solver."""
NEAR_ONE = 1e-3
"""A multiplier this near to +1 may be one of an invariant: a double one is known to the root of its matrix's error."""
DERIVED = ("chain", "linkage")
"""Systems whose invariants this library derives; those of all others are tried on a simulation."""


def check_invariants(problem: Problem) -> None:
    """`InputError` naming a declared invariant that drifts along the guess's motion, and its drift.

    The motion is integrated by DOP853 for the guess's period, from the guess pushed off any
    equilibrium; the drift is compared with 1e-7 of the invariant's size, or of its variation
    between neighbouring states.
    """
    model = problem.model
    if not model.invariants or model.constraint is not None or model.system.get("kind") in DERIVED:
        return
    n, values = model.degrees_of_freedom, model.parameter_values
    field = vector_field(accelerations(model))
    units = np.asarray(units_of(problem) or np.ones(2 * n))
    start = np.asarray(problem.guess.state, float) + 0.01 * units * np.random.default_rng(0).normal(size=2 * n)
    try:
        states = integrate_in(units, field, start, np.linspace(0.0, problem.guess.period, 9), SECOND)
    except IntegrationError:
        return  # the search itself will say where the motion cannot be integrated
    for one in model.invariants:
        found = np.array([float(one.value(state[:n], state[n:], values)) for state in states])
        nearby = float(one.value(1.01 * start[:n], 1.01 * start[n:], values))
        drift, size = float(np.abs(found - found[0]).max()), max(abs(found[0]), abs(nearby - found[0]), 1e-300)
        if drift > DRIFT * size:
            raise InputError(
                f"invariants: {one.name!r} is not conserved, it drifts by {drift:.3g} from {found[0]:.6g} within "
                f"{problem.guess.period:.4g} s along the guess's motion; leave it out of invariants=, or look for a "
                "force that changes it"
            )


def at_forcing_period(problem: Problem) -> Problem:
    """The Problem with its guess's period moved to the multiple of the forcing's that it must have."""
    clock = problem.model.forcing_period
    if clock is None:
        return problem
    period = problem.forcing_cycles * float(clock(problem.model.parameter_values))
    guess = problem.guess
    times = None if guess.times is None else guess.times * (period / guess.period)
    return replace(problem, guess=replace(guess, period=period, times=times))


def at_section(problem: Problem, flow: Flow) -> Problem:
    """The Problem with its guess moved along its motion to where its symmetry holds coordinates at the start.

    That is the instant at which every such angle is nearest to a multiple of pi and every other coordinate to 0.
    """
    guess, model, n = problem.guess, problem.model, problem.model.degrees_of_freedom
    if not np.any(problem.boundary.held(n)[:n]) or model.forced:
        return problem
    try:
        states = guess.states if guess.states is not None else segment(
            flow, np.asarray(guess.state, float), (0.0, guess.period), tail_of(flow)
        )  # fmt: skip
    except IntegrationError:
        return problem  # the search itself will say where
    clock = np.repeat([1.0, guess.period / (2 * np.pi)], n)
    away = np.abs(off_centre(problem.boundary.maps[0], np.asarray(states, float) * clock, model.angles)).max(axis=1)
    best = int(away.argmin())
    if away[0] <= max(2 * away[best], SECTION) and guess.states is None:
        return problem
    return replace(problem, guess=Guess(np.asarray(states[best], float), guess.period))


def winding_of(problem: Problem, flow: Flow, nodes: np.ndarray) -> tuple[int, ...] | None:
    """Whole turns of each angle over the guess's motion, or None when it does not come near a whole number."""
    model, guess = problem.model, problem.guess
    n = model.degrees_of_freedom
    if not np.any(problem.boundary.may_turn(n)) or not any(model.angles):
        return None
    if problem.boundary.maps:
        constant = boundary_constants(problem, nodes, far_end(problem, nodes, flow))
        return tuple(int(k) for k in problem.boundary.turns(constant))
    if guess.states is not None:
        end = np.asarray(guess.states[-1], float)
    else:
        duration = guess.period / len(nodes)
        try:
            end = end_state(flow, nodes[-1], duration, guess.period - duration)
        except IntegrationError:
            return None
    turns = whole_turns(model, nodes[0], end)
    return None if turns is None else tuple(int(k) for k in turns)


def hint(text: str) -> None:
    """Give a hint as a warning of the caller's caller."""
    if text:
        warnings.warn(text, Hint, stacklevel=5)


def degrees_taken_for_radians(problem: Problem) -> str:
    """A sentence where an angle of the guess is of several turns and winds nowhere, as 60 degrees taken for rad."""
    guess, model = problem.guess, problem.model
    if guess.states is not None:
        return ""
    angles = np.where(model.angular, np.asarray(guess.state, float)[: model.degrees_of_freedom], 0.0)
    worst = int(np.abs(angles).argmax())
    if abs(angles[worst]) <= 2 * np.pi:
        return ""
    value = angles[worst]
    return (
        f"guess.state: {model.state_names[worst]} = {value:.6g} rad is {abs(value) / (2 * np.pi):.3g} turns; angles "
        f"are in rad, and {value:.6g} degrees are {np.radians(value):.6g} rad"
    )


def unexplained_multipliers(problem: Problem, orbit: Orbit) -> str:
    """A sentence where an orbit that is rejected has multipliers at +1 that no declared invariant explains."""
    if orbit.certificate is None or orbit.certificate.passed or not problem.model.conservative:
        return ""
    extra = int(np.sum(np.abs(orbit.floquet_multipliers - 1) < NEAR_ONE))
    if extra < 2:
        return ""
    known = ", ".join(one.name for one in problem.model.invariants)
    return (
        f"invariants: {extra} multipliers are at +1 beyond those of the declared ones ({known}); if the system has "
        "another (a rotation that no coordinate shows), give it as of.Invariant in lagrange(..., invariants=...), or "
        "use a coordinate that it turns"
    )
