"""What looks like a slip without being one: sentences that go with a search, as warnings, and stop nothing."""

from __future__ import annotations

import warnings

import numpy as np

from orbitfinder.errors import Hint
from orbitfinder.loops.problem import Problem
from orbitfinder.records.orbit import Orbit

NEAR_ONE = 1e-3
"""A multiplier this near to +1 may be one of an invariant: a double one is known to the root of its matrix's error."""


def say(text: str) -> None:
    """Give a hint as a warning of the caller's caller."""
    if text:
        warnings.warn(text, Hint, stacklevel=5)


def of_degrees(problem: Problem) -> str:
    """A sentence where an angle of the guess is of several turns and winds nowhere, as 60 degrees taken for rad."""
    guess, model = problem.guess, problem.model
    if guess.states is not None:
        return ""
    angles = np.where(model.angles or False, np.asarray(guess.state, float)[: model.degrees_of_freedom], 0.0)
    worst = int(np.abs(angles).argmax())
    if abs(angles[worst]) <= 2 * np.pi:
        return ""
    value = angles[worst]
    return (
        f"guess.state: {model.state_names[worst]} = {value:.6g} rad is {abs(value) / (2 * np.pi):.3g} turns; angles "
        f"are in rad, and {value:.6g} degrees are {np.radians(value):.6g} rad"
    )


def of_invariants(problem: Problem, orbit: Orbit) -> str:
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
