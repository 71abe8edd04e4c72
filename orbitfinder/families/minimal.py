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
from orbitfinder.integrate.idas import SEGMENT_SETTINGS, simulate_dae
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.linkage import bar_angles, linkage_state, minimal_linkage
from orbitfinder.mechanics.mechanism import (
    all_coordinates,
    coordinate_units,
    joint_of,
    mechanism_state,
    minimal_mechanism,
)
from orbitfinder.mechanics.model import Model, constraint_of, energy, wrapped
from orbitfinder.mechanics.model import vector_field as equations

LEAST_SINE = 0.05
"""|sin| of the angle between the two dependent bars below which they count as being in line."""
LEAST_SHARE = 5e-3
"""Least over largest singular value of the closures' slopes below which a mechanism is at a dead point."""
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
    if native.system.get("kind") == "mechanism":
        return _minimal_mechanism(problem)
    if native.system.get("kind") != "linkage":
        raise InputError(
            "system: families of constrained systems are followed for linkages and mechanisms only; describe this one "
            "as a mechanism, or in minimal coordinates (lagrange)"
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
    return _described(problem, model, state, turns)


def _described(problem: Problem, model: Model, state: np.ndarray, turns: tuple[int, ...] | None) -> Problem:
    """A Problem in minimal coordinates: its energy or period are held, no symmetry is asked for yet."""
    pins = tuple(one for one in problem.pin if one.name in ("energy", "period") or one.name in model.state_names)
    if model.conservative:
        pins = pins or (Pin("energy", energy(model, state)),)
    guess = Guess(state, problem.guess.period)
    return replace(problem, model=model, guess=guess, winding=turns, symmetry="none", pin=pins)


def _minimal_mechanism(problem: Problem) -> Problem:
    """A mechanism's Problem in those coordinates that say best, all along the guess's motion, how the others move."""
    native, n = problem.model, problem.model.degrees_of_freedom
    state = np.asarray(problem.guess.state, float)
    states = simulate_dae(native, state, problem.guess.period, SAMPLES, SEGMENT_SETTINGS).states
    slopes = _slopes(native, states[:, :n])
    freedom = n - slopes.shape[1]
    margins = {chosen: _margin(slopes, chosen) for chosen in combinations(range(n), freedom)}
    chosen = max(margins, key=lambda one: margins[one])
    if margins[chosen] < LEAST_SHARE:
        raise InputError(
            "system: whichever coordinates are taken as independent, a loop comes to a dead point of them on the way, "
            "so that no choice of minimal coordinates covers this motion and its family cannot be followed"
        )
    picked = list(chosen)
    middle = (states[:, picked].max(axis=0) + states[:, picked].min(axis=0)) / 2
    near = states[np.abs(wrapped(states[:, picked] - middle, native.angular[picked])).max(axis=1).argmin(), :n]
    model = minimal_mechanism(native, [native.state_names[k] for k in picked], near)
    turns = None if problem.winding is None else tuple(problem.turns[k] for k in picked)
    return _described(problem, model, np.concatenate([state[:n][picked], state[n:][picked]]), turns)


def _slopes(native: Model, places: np.ndarray) -> np.ndarray:
    """J at configurations (k x n), columns in units of their own (k x m x n)."""
    rows = native.along(constraint_of(native).jacobian, places.T)
    return np.asarray(rows.reshape(rows.shape[0], len(places), -1).transpose(1, 0, 2) * coordinate_units(native))


def _margin(slopes: np.ndarray, chosen: tuple[int, ...]) -> float:
    """How well the other coordinates follow from the chosen ones: the least singular value over the largest."""
    rest = [k for k in range(slopes.shape[2]) if k not in chosen]
    values = np.linalg.svd(slopes[:, :, rest], compute_uv=False)
    return float((values[:, -1] / values[:, 0]).min())


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
    if system["kind"] == "mechanism":
        return _mechanism_dead_point(_native(system, free), system, states)
    bars = len(system["independent"]) + 2
    i, j = (k for k in range(bars) if k + 1 not in system["independent"])
    theta = bar_states(system, states, free)[:, :bars]
    sine = float(np.abs(np.sin(theta[:, j] - theta[:, i])).min())
    return f"bars {i + 1} and {j + 1} come into line (a dead point)" if sine < LEAST_SINE else ""


def _mechanism_dead_point(native: Model, system: Mapping[str, Any], states: np.ndarray) -> str:
    u, names = states[:, : len(system["independent"])], native.state_names
    slopes = _slopes(native, all_coordinates(native, system).map(len(u))(u.T).full().T)
    picked = [k for k in range(slopes.shape[2]) if names[k] in system["independent"]]
    rest = [k for k in range(slopes.shape[2]) if k not in picked]
    values = np.linalg.svd(slopes[:, :, rest], compute_uv=False)
    worst = int((values[:, -1] / values[:, 0]).argmin())
    if values[worst, -1] > LEAST_SHARE * values[worst, 0]:
        return ""
    row = int(np.abs(np.linalg.svd(slopes[worst][:, rest])[0][:, -1]).argmax())
    return (
        f"{joint_of(native, row)} no longer says how {', '.join(names[k] for k in rest)} follow from "
        f"{', '.join(system['independent'])} (a dead point)"
    )


def native_state(system: Mapping[str, Any], state: np.ndarray, free: Mapping[str, float] | None = None) -> np.ndarray:
    """The state of the linkage as a native DAE (6 a bar) that a minimal state of a family stands for."""
    if system.get("kind") == "mechanism":
        native, n = _native(system, free), len(system["independent"])
        place = all_coordinates(native, system)(state[:n]).full().ravel()
        return mechanism_state(native, rates=dict(zip((f"{one}dot" for one in system["independent"]), state[n:],
                                                      strict=True)), near=place)  # fmt: skip
    angles, rates = np.split(bar_states(system, state, free)[0], 2)
    return linkage_state(_native(system, free), angles, rates)


def _native(system: Mapping[str, Any], free: Mapping[str, float] | None = None) -> Model:
    if "independent" not in system:
        raise InputError("system: not a linkage in minimal coordinates; give the system of a linkage's family")
    found = build_model({key: value for key, value in system.items() if key not in ("independent", "branch")})
    names, values = found.parameter_names, dict(free or {})
    numbers = [values.get(name, value) for name, value in zip(names, found.parameter_values, strict=True)]
    return replace(found, parameter_values=np.array(numbers, float))
