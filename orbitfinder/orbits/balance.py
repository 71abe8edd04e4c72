"""The method of harmonic balance, for driven and free motions of many coordinates: as many orders as they ask for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import Any, cast

import numpy as np

from orbitfinder.continuation.problem import Point, solved
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError
from orbitfinder.integrate.residual import Residual
from orbitfinder.loops.conditions import PHASE, Pin
from orbitfinder.loops.ipopt import Callback, Progress, SolveSettings
from orbitfinder.loops.problem import Problem, at_forcing_period
from orbitfinder.mechanics.kind import system_kind, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import Settings, Solver, full
from orbitfinder.mechanics.scales import parameter_sizes
from orbitfinder.orbits.floquet import Floquet
from orbitfinder.orbits.guesses.linear import linear_response
from orbitfinder.orbits.guesses.modes import normal_modes
from orbitfinder.orbits.guesses.settled import lap
from orbitfinder.orbits.harmonics import Balanced, Coefficients, Fourier, Pattern, Phase, orders
from orbitfinder.orbits.hill import exponents
from orbitfinder.orbits.implicit import SMALL, stepped
from orbitfinder.orbits.measure import action, provenance, recorded
from orbitfinder.records.orbit import Orbit

FIRST, SHARES = (5, 11), (1.0, 0.5, -1.0, 1.5, -1.5, 0.25)
"""Highest orders that a guess is tried with; sizes of the linear response, in phase or not"""
NAME, SAMPLES, STIFF = "balance", 256, 1000.0
"""Of the method; equal times that a motion is recorded and its action summed at, at least; radians that the
fastest mode of a free motion may turn by in a period where steps are to follow it"""


def refused(problem: Problem) -> str:
    """Why harmonic balance cannot be the method for a problem, or nothing."""
    model, named = problem.model, [pin.name for pin in problem.pin]
    if not model.forced and not (model.conservative and model.rates is None):
        return "nothing drives it, and it keeps no energy"
    if not model.smooth or model.constraint is not None or not model.scalar or problem.control is not None:
        return "it has impacts, constraints or controls"
    if problem.turns.any() or problem.relative or problem.boundary.maps:
        return "it goes round, or its symmetry makes it a part of a period"
    if problem.constraints or problem.bounds or problem.objective != "nearest":
        return "it has constraints, bounds or an objective"
    if len(model.invariants) > (not model.forced):
        return "it has invariants beside the energy of what nothing drives"
    if model.forced and (len(problem.free), bool(named)) != (len(named), phase_of(problem) is not None):
        both = [", ".join(names) or "nothing" for names in (problem.free, named)]
        return f"it frees {both[0]} and pins {both[1]}, and may do so for the phase of a coordinate alone"
    if problem.free and not model.forced:
        return "it has freed parameters"
    return ""


def suits(problem: Problem) -> str:
    """Why balance is the method unasked, or nothing: a free motion beside which the fastest mode turns too often."""
    model, turned = problem.model, 0.0
    if not (model.forced or system_kind(model.system).pendulum or refused(problem)):
        with suppress(InputError):
            turned = float(np.sqrt(abs(normal_modes(model)[0][-1]))) * problem.guess.period
    return f"the fastest mode turns by {turned:.0f} rad in a period" if turned > STIFF else ""


def phase_of(problem: Problem) -> Phase | None:
    """The phase that a problem prescribes to a driven motion."""
    for k, name in enumerate(problem.model.state_names[: problem.model.degrees_of_freedom]):
        for pin in problem.pin:
            if pin.name == PHASE + name:
                return Phase(k, pin.value)
    return None


def begun(problem: Problem, parameter: str, until: float | None = None) -> Point:
    """The motion of a problem in harmonics with a parameter ("": none) free, on as many orders as it takes; of free
    motions what is pinned, or as wide as the guess.

    Raises `ConvergenceError`.
    """
    model, guess, phase = problem.model, problem.guess, phase_of(problem)
    n, start = model.degrees_of_freedom, guess.start
    if model.forced:
        equations = Residual(model, (*problem.free, parameter), problem.forcing_cycles)
        values, wanted = equations.start, Pin("", equations.start[-1])
        sizes = parameter_sizes(model, equations.names, values) if parameter else np.ones(values.size)
        sizes[-1] = max(sizes[-1], 0.0 if until is None else abs(until - values[-1]))
    else:
        phase = Phase(int(np.abs(start[:n]).argmax()))
        equations, sizes = Residual(model, unfolded=phase.coordinate), np.ones(2)
        values = sizes * [0.0, 2 * np.pi / guess.period]
        wanted = next(iter(problem.pin), Pin(model.state_names[phase.coordinate], start[phase.coordinate]))
    failed = ConvergenceError("no guess leads to a motion; give a trajectory near it")
    for top, (times, states) in product(FIRST, _trajectories(problem, n)):
        basis = Fourier(orders(top, equations.odd))
        balanced = Balanced(Pattern(equations, basis), np.ones(n), sizes, np.ones(n), phase)
        angles, motion = 2 * np.pi * times / times[-1], states.T[:n]
        if not model.forced:  # begins where the coordinate is largest
            angles = angles - angles[np.abs(motion[phase.coordinate]).argmax()] if phase else angles
        motion = np.array([np.interp(basis.times, angles[:-1], q[:-1], period=2 * np.pi) for q in motion])
        w = Coefficients(np.concatenate([(motion @ basis.back.T).ravel(), values]))
        balanced = balanced.measured(w)
        try:
            w = _near(balanced, w, wanted)
            while True:
                point = solved(balanced, w, lambda w: balanced.aim(w, wanted.name, wanted.value))  # noqa: B023
                renewed = balanced.measured(point.w)
                if renewed.enough(point.w):
                    return Point(renewed, point.w, point.tangent).sharp
                balanced, w, _ = renewed.finer(point.w, point.tangent)
        except ConvergenceError as error:
            failed = error
    raise failed


def _trajectories(problem: Problem, n: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Times and states of what a motion may be near: the guess's own, and the linear response, of several sizes."""
    model, guess = problem.model, problem.guess
    if guess.trajectory is not None:
        yield guess.trajectory
    elif n <= SMALL and np.any(guess.state):
        with suppress(*UNSOLVED):
            if suits(problem):  # by steps that no fast mode limits
                _, path = stepped(model, guess.start, guess.period)
                yield np.linspace(0.0, guess.period, len(path)), path
            else:
                yield cast(Any, lap(model, guess).trajectory)
    if not model.forced:
        turn, (place, rate) = np.linspace(0.0, 2 * np.pi, SAMPLES + 1), np.split(guess.start, 2)
        swung = np.outer(np.cos(turn), place) + np.outer(np.sin(turn), rate * guess.period / (2 * np.pi))
        yield turn, swung
        return
    with suppress(InputError):
        times, states = cast(Any, linear_response(model).trajectory)
        yield from ((times, share * states) for share in SHARES)


def _near(balanced: Balanced, w: Coefficients, wanted: Pin) -> Coefficients:
    """A guess brought near by whole Newton steps at what is wanted, halved where they leave more."""

    def linearised(w: Coefficients) -> tuple[np.ndarray, Solver]:
        rows, linear = balanced.linearise(w)
        missed, row = balanced.aim(w, wanted.name, wanted.value)
        return np.append(rows, missed), linear.closed(row[None])

    settings = Settings(floor=1e-9, round_off=1e-9, converged=1e-9, most_evaluations=40, halving=True)
    near = full(w, linearised, settings, lambda w, step: w.moved(step))
    if not near.converged:
        raise ConvergenceError(f"harmonic balance stalls at rows of {near.size:.2g}; give a trajectory near the motion")
    return near.w


def states_of(point: Point, shares: np.ndarray) -> np.ndarray:
    """States (s x 2n, or d) at shares of the period."""
    balanced: Balanced = point.problem
    equations = balanced.equations
    motion = balanced.basis.motion(balanced.coefficients(point.w), 2 * np.pi * shares)
    pace = equations.pace(balanced.values(point.w))
    return np.vstack(motion[:1] if equations.model.rates is not None else [motion[0], pace * motion[1]]).T


def balanced(problem: Problem, settings: SolveSettings, report: Callback | None, began: float) -> tuple[Orbit, Model]:
    """The orbit of a driven or a conservative system, by harmonic balance."""
    problem = at_forcing_period(problem)
    point = begun(problem, "")
    highest, (values, period) = max(point.problem.basis.orders), freed(point)
    model = with_parameters(problem.model, values)
    problem = replace(problem, model=model)
    if report:
        report(Progress(f"harmonic balance to order {highest}", 0, 0.0, period, 0.0))
    shares = np.linspace(0.0, 1.0, samples_of(point) + 1)
    states, about = states_of(point, shares), exponents(point.problem, point.w)
    floquet = about.whole or Floquet(about.multipliers, 0.0, np.zeros(0), about.stability)
    times = shares * period
    orbit = recorded(problem, period, states[0], states[:1], times, states, np.zeros(0), action(model, times, states),
                     floquet)  # fmt: skip
    said = provenance(problem, settings, began) | {"method": NAME, "orders": list(point.problem.basis.orders)}
    said |= {"undecided": about.why} if about.why else {}
    said |= {"free": values} if values else {}
    return replace(orbit, provenance=said), model


def freed(point: Point) -> tuple[dict[str, float], float]:
    """What is free by name, and the period in s."""
    balanced: Balanced = point.problem
    values = balanced.values(point.w)
    named = {name: float(x) for name, x in zip(balanced.equations.names, values, strict=False) if name}
    return named, 2 * np.pi / balanced.equations.pace(values)


def samples_of(point: Point) -> int:
    """Equal times over a period at which its highest order is known well."""
    return max(SAMPLES, 1 << int(np.ceil(np.log2(4 * (max(point.problem.basis.orders) + 1)))))
