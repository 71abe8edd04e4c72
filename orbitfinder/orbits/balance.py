"""The method of harmonic balance, for driven motions of many coordinates: as many orders as the motion asks for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import Any, cast

import numpy as np

from orbitfinder.continuation.problem import Point, solved
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.integrate.residual import Residual
from orbitfinder.loops.ipopt import Callback, Progress, SolveSettings
from orbitfinder.loops.problem import Guess, Problem, at_forcing_period
from orbitfinder.loops.symmetry import symplectic
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import Settings, Solver, full
from orbitfinder.mechanics.scales import parameter_sizes
from orbitfinder.orbits.floquet import Floquet, judged
from orbitfinder.orbits.guesses.linear import linear_response
from orbitfinder.orbits.guesses.settled import lap
from orbitfinder.orbits.harmonics import Balanced, Coefficients, Fourier, Pattern, orders
from orbitfinder.orbits.hill import exponents
from orbitfinder.orbits.implicit import SMALL
from orbitfinder.orbits.measure import action, provenance, recorded
from orbitfinder.records.orbit import Orbit

FIRST, SHARES = (5, 11), (1.0, 0.5, -1.0, 1.5, -1.5, 0.25)
"""Highest orders that a guess is tried with; sizes of the linear response, in phase or not"""
NAME, SAMPLES = "balance", 256
"""Of the method. Equal times that a motion is recorded and its action summed at, at least"""


def refused(problem: Problem) -> str:
    """Why harmonic balance cannot be the method for a problem, or nothing."""
    model = problem.model
    if not model.forced:
        return "nothing drives it"
    if not model.smooth or model.constraint is not None or not model.scalar or problem.control is not None:
        return "it has impacts, constraints or controls"
    if problem.turns.any() or problem.relative or problem.boundary.maps:
        return "it goes round, or its symmetry makes it a part of a period"
    if problem.free or problem.constraints or problem.bounds or problem.objective != "nearest" or model.invariants:
        return "it has invariants, freed parameters, constraints, bounds or an objective"
    return ""


def begun(problem: Problem, parameter: str, until: float | None = None) -> Point:
    """The motion of a problem in harmonics with a parameter ("": none) free, on as many orders as it takes.

    Raises `ConvergenceError`.
    """
    equations, guess = Residual(problem.model, parameter, problem.forcing_cycles), problem.guess
    n, start = equations.size, equations.start
    size = float(parameter_sizes(problem.model, (parameter,), np.array([start]))[0]) if parameter else 1.0
    size = max(size, 0.0 if until is None else abs(until - start))
    failed = ConvergenceError("no guess leads to a motion; give a trajectory near it")
    for top, (times, states) in product(FIRST, _trajectories(problem.model, guess, n)):
        basis = Fourier(orders(top, equations.odd))
        balanced = Balanced(Pattern(equations, basis), np.ones(n), size, np.ones(n))
        motion = np.array([np.interp(basis.times, 2 * np.pi * times / times[-1], q) for q in states.T[:n]])
        w = Coefficients(np.append((motion @ basis.back.T).ravel(), start))
        balanced = balanced.measured(w)
        try:
            return _settled(balanced, _near(balanced, w), start)
        except ConvergenceError as error:
            failed = error
    raise failed


def _trajectories(model: Model, guess: Guess, n: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Times and states of what a motion may be near: the guess's own, and the linear response, of several sizes."""
    if guess.trajectory is not None:
        yield guess.trajectory
    elif n <= SMALL and np.any(guess.state):
        with suppress(ConvergenceError, IntegrationError):
            yield cast(Any, lap(model, guess).trajectory)
    with suppress(InputError):
        times, states = cast(Any, linear_response(model).trajectory)
        yield from ((times, share * states) for share in SHARES)


def _near(balanced: Balanced, w: Coefficients) -> Coefficients:
    """A guess brought near by whole Newton steps at its parameter, halved where they leave more."""
    row = balanced.aim(w, "", balanced.equations.start)[1][None]

    def linearised(w: Coefficients) -> tuple[np.ndarray, Solver]:
        rows, linear = balanced.linearise(w)
        return np.append(rows, 0.0), linear.closed(row)

    settings = Settings(floor=1e-9, round_off=1e-9, converged=1e-9, most_evaluations=40, halving=True)
    near = full(w, linearised, settings, lambda w, step: w.moved(step))
    if not near.converged:
        raise ConvergenceError(f"harmonic balance stalls at rows of {near.size:.2g}; give a trajectory near the motion")
    return near.w


def _settled(balanced: Balanced, w: Coefficients, value: float) -> Point:
    """The motion at a value of the parameter, its tangent along what the parameter moves."""
    while True:
        point = solved(balanced, w, lambda w: balanced.aim(w, "", value))  # noqa: B023 - of this round
        renewed = balanced.measured(point.w)
        if renewed.enough(point.w):
            return Point(renewed, point.w, point.tangent).sharp
        balanced, w, _ = renewed.finer(point.w, point.tangent)


def states_of(point: Point, shares: np.ndarray) -> np.ndarray:
    """States (s x 2n, or d) at shares of the period."""
    balanced, equations = point.problem, point.problem.equations
    motion = balanced.basis.motion(balanced.coefficients(point.w), 2 * np.pi * shares)
    pace = equations.pace(float(point.w.vector[-1]))
    return np.vstack(motion[:1] if equations.model.rates is not None else [motion[0], pace * motion[1]]).T


def balanced(problem: Problem, settings: SolveSettings, report: Callback | None, began: float) -> tuple[Orbit, Model]:
    """The orbit of a driven system, by harmonic balance."""
    problem = at_forcing_period(problem)
    point = begun(problem, "")
    model, period, highest = problem.model, problem.guess.period, max(point.problem.basis.orders)
    if report:
        report(Progress(f"harmonic balance to order {highest}", 0, 0.0, period, 0.0))
    shares = np.linspace(0.0, 1.0, samples_of(point) + 1)
    states, about = states_of(point, shares), exponents(point.problem, point.w)
    floquet = Floquet(about.multipliers, 0.0, np.zeros(0), about.stability)
    if point.problem.equations.size <= SMALL:
        floquet = judged(about.multipliers, symplectic(model))
    times = shares * period
    orbit = recorded(problem, period, states[0], states[:1], times, states, np.zeros(0), action(model, times, states),
                     floquet)  # fmt: skip
    said = provenance(problem, settings, began) | {"method": NAME, "orders": list(point.problem.basis.orders)}
    said |= {"undecided": about.why} if about.why else {}
    return replace(orbit, provenance=said), model


def samples_of(point: Point) -> int:
    """Equal times over a period at which its highest order is known well."""
    return max(SAMPLES, 1 << int(np.ceil(np.log2(4 * (max(point.problem.basis.orders) + 1)))))
