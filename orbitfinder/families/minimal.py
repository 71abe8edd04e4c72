"""Families of linkages: the same motion in minimal coordinates, where the shooting of `families` applies.

A native linkage has 6 states a bar and a damped constraint, a minimal one 2 (n - 2) states and none; the
angles of two bars follow from the others as long as these two are never in line (a dead point). A family
keeps the choice of independent bars in its `system`, and `bar_states` gives back the angles of all bars.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import ReferenceSettings, integrate, vector_field
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.linkage import bar_angles, linkage_state, minimal_linkage
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.mechanics.model import vector_field as equations

LEAST_SINE = 0.05
"""|sin| of the angle between the two dependent bars below which they count as being in line."""
SAMPLES = 200
ROUGH = ReferenceSettings(relative_tolerance=1e-8, absolute_tolerance=1e-8, max_evaluations=20_000)
"""For a look at where a motion goes; one that takes longer is at a dead point."""


def minimal_problem(problem: Problem) -> Problem:
    """A linkage's Problem in the angles of n - 2 bars; any other Problem as it is.

    Of all choices of bars the one whose dependent pair stays furthest from being in line over the guess's
    motion is taken. Raises `InputError` when every choice passes a dead point, or where there is none.
    """
    native = problem.model
    if native.constraint is None:
        return problem
    if native.system.get("kind") != "linkage":
        raise InputError(
            "system: families of constrained systems are followed for linkages only; describe this one in minimal "
            "coordinates (lagrange)"
        )
    theta, rates = _bars(np.asarray(problem.guess.state, float))
    chosen = _best(native, theta, rates, float(problem.guess.period))
    if chosen is None:
        raise InputError(
            "system: whichever two bars are taken as dependent, they come into line on the way (a dead point), so "
            "that no choice of minimal coordinates covers this motion and its family cannot be followed"
        )
    model, picked = chosen
    state = np.concatenate([theta[picked], rates[picked]])
    turns = None if problem.winding is None else tuple(problem.turns[3 * k + 2] for k in picked)
    pins = tuple(one for one in problem.pin if one.name in ("energy", "period"))
    pins = pins or (Pin("energy", energy(model, state)),)
    guess = Guess(state, problem.guess.period)
    return replace(problem, model=model, guess=guess, winding=turns, symmetry="none", pin=pins)


def _bars(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles and rates of the bars in a native state (x, y, theta of every bar, then their rates)."""
    q, v = np.split(state, 2)
    return q[2::3], v[2::3]


def _best(native: Model, theta: np.ndarray, rates: np.ndarray, period: float) -> tuple[Model, list[int]] | None:
    """The minimal model (with its independent bars) that stays furthest from a dead point over a period."""
    found: list[tuple[float, Model, list[int]]] = []
    for i, j in combinations(range(theta.size), 2):
        sine = float(np.sin(theta[j] - theta[i]))
        if abs(sine) < LEAST_SINE or (found and abs(sine) <= found[-1][0]):
            continue
        picked = [k for k in range(theta.size) if k not in (i, j)]
        independent, branch = [k + 1 for k in picked], 1 if sine > 0 else -1
        model = minimal_linkage(native, independent, branch)
        start, field = np.concatenate([theta[picked], rates[picked]]), vector_field(_autonomous(model))
        try:
            states = integrate(field, start, np.linspace(0.0, period, SAMPLES), ROUGH)
        except IntegrationError:  # singular at a dead point
            continue
        angles = bar_angles(native, independent, branch).map(len(states))(states[:, : len(picked)].T).full()
        margin = float((branch * np.sin(angles[j] - angles[i])).min())
        if margin > LEAST_SINE and (not found or margin > found[-1][0]):
            found.append((margin, model, picked))
    return found[-1][1:] if found else None


def _autonomous(model: Model) -> Any:
    """The equations of motion as a function of time and state alone."""
    field = equations(model, (), ())
    t, x, s, free = field.mx_in()
    return type(field)("autonomous", [t, x], [field(t, x, s, free)])


def bar_states(system: Mapping[str, Any], states: np.ndarray, free: Mapping[str, float] | None = None) -> np.ndarray:
    """States (k x 2 bars) of all bars, angles then rates, from minimal ones (k x 2 (bars - 2)) of a family's system.

    `free` are the values that a point has of freed parameters.
    """
    native = _native(system, free)
    theta = bar_angles(native, system["independent"], system["branch"])
    n = len(system["independent"])
    slope = theta.jacobian()
    rows = []
    for state in np.atleast_2d(states):
        u, rates = state[:n], state[n:]
        there = theta(u).full().ravel()
        rows.append(np.concatenate([there, slope(u, there).full() @ rates]))
    return np.asarray(rows)


def dead_point(system: Mapping[str, Any], states: np.ndarray, free: Mapping[str, float] | None = None) -> str:
    """Which two bars, dependent on the others, come into line along a motion (k minimal states); else empty."""
    if "independent" not in system:
        return ""
    states = states[np.all(np.isfinite(states), axis=1)]
    bars = len(system["independent"]) + 2
    i, j = (k for k in range(bars) if k + 1 not in system["independent"])
    theta = bar_states(system, states, free)[:, :bars]
    sine = float(np.abs(np.sin(theta[:, j] - theta[:, i])).min())
    return f"bars {i + 1} and {j + 1} come into line (a dead point)" if sine < LEAST_SINE else ""


def native_state(system: Mapping[str, Any], state: np.ndarray, free: Mapping[str, float] | None = None) -> np.ndarray:
    """The state of the linkage as a native DAE (6 a bar) that a minimal state of a family stands for."""
    angles, rates = np.split(bar_states(system, state, free)[0], 2)
    return linkage_state(_native(system, free), angles, rates)


def _native(system: Mapping[str, Any], free: Mapping[str, float] | None = None) -> Model:
    if "independent" not in system:
        raise InputError("system: not a linkage in minimal coordinates; give the system of a linkage's family")
    found = build_model({key: value for key, value in system.items() if key not in ("independent", "branch")})
    names, values = found.parameter_names, dict(free or {})
    numbers = [values.get(name, value) for name, value in zip(names, found.parameter_values, strict=True)]
    return replace(found, parameter_values=np.array(numbers, float))
