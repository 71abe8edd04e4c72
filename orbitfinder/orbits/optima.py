"""Families of optima: controlled motions of least cost, one after another along a pin or a physical parameter."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from orbitfinder.errors import ConvergenceError, InputError, closest
from orbitfinder.loops.controlled import Program, Solution, optimum
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.orbits.certify import certified
from orbitfinder.orbits.control import IPOPT_TOLERANCE, recorded
from orbitfinder.records.orbit import Orbit

HALVINGS = 6
"""Times that a step along a family of optima is halved"""


def follow_optima(
    problem: Problem, parameter: str, values: Sequence[float], settings: SolveSettings | None = None
) -> tuple[Orbit, ...]:
    """The certified optima of a controlled problem at values of a pin or physical parameter, each from the one before.

    A step that fails is halved, six times at most; the family then ends, with what it has: an optimum that turns back
    in the parameter is not followed round its turn. Raises `InputError`, and `ConvergenceError` where the first fails.
    """
    if problem.control is None:
        raise InputError("problem: has no control; give Problem(..., control=of.Control(...)), or follow_family()")
    settings, found = settings or SolveSettings(), list[Orbit]()
    near: tuple[Program, Solution] | None = None
    at = None
    for value in map(float, values):
        while at is None or at != value:
            near, at = _next(problem, parameter, at, value, near)
            if near is None:
                return tuple(found)
        assert near is not None
        began = time.perf_counter()
        orbit, model = recorded(_set(problem, parameter, value), *near, settings, began)
        found.append(certified(orbit, model))
    return tuple(found)


def _next(
    problem: Problem, parameter: str, at: float | None, value: float, near: tuple[Program, Solution] | None
) -> tuple[tuple[Program, Solution] | None, float]:
    """The optimum at a value, or as far towards it from `at` as IPOPT comes; None where it does not move."""
    share = 1.0
    for _ in range(HALVINGS):
        aim = value if at is None or share == 1.0 else at + share * (value - at)
        asked = _set(problem, parameter, aim)
        assert asked.control is not None
        try:
            return optimum(asked, asked.control, IPOPT_TOLERANCE, near), aim
        except ConvergenceError:
            if near is None:
                raise
            share /= 2
    return None, value


def _set(problem: Problem, parameter: str, value: float) -> Problem:
    """The problem with a pin or a physical parameter at another value. Raises `InputError`."""
    pins = tuple(replace(one, value=value) if one.name == parameter else one for one in problem.pin)
    if parameter in {one.name for one in problem.pin}:
        period = value if parameter == "period" else problem.guess.period
        return replace(problem, pin=pins, guess=replace(problem.guess, period=period))
    if parameter not in problem.model.parameter_names or parameter in (*problem.free, *problem.model.controls):
        known = [*(one.name for one in problem.pin), *problem.model.parameter_names]
        raise InputError(f"parameter: {parameter!r} is no pin and no physical parameter{closest(parameter, known)}")
    return replace(problem, model=with_parameters(problem.model, {parameter: value}))
