"""Families of mechanisms with loops: the same motion in minimal coordinates, where the shooting of `families` applies.

A native DAE has all coordinates and a damped constraint, the minimal form as many coordinates as degrees of freedom and
none; the others follow from these as long as no loop is at a dead point of them. A family keeps the choice of
independent coordinates in its `system`, and `native_state` gives back the state of the DAE.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.idas import SEGMENT_SETTINGS, simulate_dae
from orbitfinder.loops.conditions import Pin, quantities
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.constrained import Loops
from orbitfinder.mechanics.kind import build_model, loops_of
from orbitfinder.mechanics.model import Model, altered, constraint_of, energy, wrapped


def minimal_problem(problem: Problem) -> Problem:
    """The Problem of a linkage or mechanism with loops in minimal coordinates; any other Problem as it is.

    They are those that say best, all along the guess's motion, how the others move. Its energy or period are held, no
    symmetry is asked for yet. Raises `InputError` when every choice passes a dead point, or where there is none.
    """
    native, n = problem.model, problem.model.degrees_of_freedom
    if native.constraint is None:
        return problem
    loops = loops_of(native.system)
    if loops.minimal is None:
        raise InputError(
            "system: families of constrained systems are followed for linkages and mechanisms only; describe this one "
            "as a mechanism, or in minimal coordinates (lagrange)"
        )
    state = problem.guess.start
    picked, places = _best(native, loops, state, float(problem.guess.period))
    middle = (places[:, picked].max(axis=0) + places[:, picked].min(axis=0)) / 2
    near = places[np.abs(wrapped(places[:, picked] - middle, native.angular[picked])).max(axis=1).argmin()]
    model = loops.minimal(native, picked, near)
    state = np.concatenate([state[:n][picked], state[n:][picked]])
    pins = tuple(pin for pin in problem.pin if pin.name in quantities(model))
    if model.conservative:
        pins = pins or (Pin("energy", energy(model, state)),)
    turns = None if problem.winding is None else tuple(problem.turns[k] for k in picked)
    guess = Guess(state, problem.guess.period)
    return replace(problem, model=model, guess=guess, winding=turns, symmetry="none", pin=pins)


def _best(native: Model, loops: Loops, state: np.ndarray, period: float) -> tuple[list[int], np.ndarray]:
    """The coordinates that stay furthest from a dead point over a period, and all coordinates (k x n) on the way."""
    n = native.degrees_of_freedom
    freedom = n - len(constraint_of(native).force_names)
    try:
        places = simulate_dae(native, state, period, 200, SEGMENT_SETTINGS).states[:, :n]
        margins = loops.margins(native, places)
        least = {chosen: float(margins(list(chosen)).min()) for chosen in combinations(loops.choice(native), freedom)}
        chosen = max(least, key=lambda choice: least[choice])
        if least[chosen] >= 1:
            return list(chosen), places
    except IntegrationError:  # singular where bars come into line
        pass
    raise InputError(
        "system: whichever coordinates are taken as independent, a loop comes to a dead point of them on the way "
        "(bars in line), so that no choice of minimal coordinates covers this motion and its family cannot be followed"
    )


def dead_point(model: Model, states: np.ndarray, free: Mapping[str, float] | None = None) -> str:
    """What no longer says, somewhere along a motion (k states) of a minimal form, how the others follow; else empty.

    `free` are the values that a point has of freed parameters.
    """
    if "independent" not in model.system:
        return ""
    native, loops, everywhere = _native(model.system, free)
    u = states[np.all(np.isfinite(states), axis=1), : model.degrees_of_freedom]
    places = everywhere.map(len(u))(u.T, 0 * u.T)[0].full().T
    chosen = [native.state_names.index(name) for name in model.coordinates]
    margins = loops.margins(native, places)(chosen)
    worst = int(margins.argmin())
    return loops.dead(native, places[worst], chosen) if margins[worst] < 1 else ""


def native_state(system: Mapping[str, Any], state: np.ndarray, free: Mapping[str, float] | None = None) -> np.ndarray:
    """The state (2n) of the native DAE that a minimal state of a family stands for; `free` as for `dead_point`."""
    return np.concatenate([part.full().ravel() for part in _native(system, free)[2](*np.split(state, 2))])


def _native(system: Mapping[str, Any], free: Mapping[str, float] | None) -> tuple[Model, Loops, Any]:
    """The native DAE of a family's system, and (u, udot) -> all coordinates (n) and their rates."""
    loops = loops_of(system)
    if "independent" not in system:
        raise InputError("system: not a linkage in minimal coordinates; give the system of a linkage's family")
    whole = build_model({key: value for key, value in system.items() if key not in ("independent", "branch")})
    names, values = whole.parameter_names, dict(free or {})
    numbers = [values.get(name, value) for name, value in zip(names, whole.parameter_values, strict=True)]
    native = altered(whole, parameter_values=np.array(numbers, float))
    return native, loops, loops.everywhere(native, system)
