"""From a Problem that its pins make square to the Loop that Newton's method solves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.loop import Condition, Equations, Loop, Unknowns
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.shooting import boundary_constants
from orbitfinder.mechanics.model import Model

WINDING_MARGIN = 0.25
"""A motion whose angles end farther than this from whole turns (in turns) runs round in none of them."""


def loop_of(problem: Problem, equations: Equations, w: Unknowns, end: np.ndarray | None, pins: Sequence[Pin]) -> Loop:
    """The loop of a Problem at these pins, its phases and displacement as w has them, whose motion ends at `end`."""
    model, period = problem.model, np.eye(equations.size + 1 + w.free.size)[equations.size]
    conditions = [pinned(equations, one.name, one.value) for one in pins]
    if model.forcing_period is not None:
        clock = Condition(0.0, period, len(model.invariants) + 1, -float(problem.forcing_cycles))
        conditions.insert(0, clock)
    return Loop(equations, displacement(problem, w, end), tuple(conditions)).through(w)


def pinned(equations: Equations, name: str, value: float) -> Condition:
    """The condition that a period, an invariant, the energy, a freed parameter or a state at t = 0 has a value."""
    model, size = equations.model, equations.size
    unit = np.eye(size + 1 + len(equations.free))
    names = [one.name for one in model.invariants]
    if name == "period":
        return Condition(value, unit[size])
    if name in (*names, "energy"):
        return Condition(value, quantity=(*names, "energy").index(name))
    if name in equations.free:
        return Condition(value, unit[size + 1 + equations.free.index(name)])
    return Condition(value, unit[model.state_index(name)])


def displacement(problem: Problem, w: Unknowns, end: np.ndarray | None) -> np.ndarray:
    """The constants of the closing rows: the whole turns that the problem states, else those of the motion."""
    model, n = problem.model, problem.model.degrees_of_freedom
    if problem.boundary.maps or problem.winding is not None or end is None:
        return boundary_constants(problem, w.nodes, end)
    turns = whole_turns(model, w.nodes[0], end)
    return np.concatenate([np.zeros(n) if turns is None else 2 * np.pi * turns, np.zeros(n)])


def whole_turns(model: Model, start: np.ndarray, end: np.ndarray) -> np.ndarray | None:
    """Whole turns of each angle (n) between two states, None when they do not come near whole numbers."""
    turned = np.where(model.angles, (end - start)[: model.degrees_of_freedom] / (2 * np.pi), 0.0)
    whole = np.round(turned)
    return whole if np.all(np.abs(turned - whole) <= WINDING_MARGIN) else None


def segments_needed(equations: Equations, w: Unknowns, clock: float, growth: float, between: tuple[int, int]) -> int:
    """As many segments as keep each state-transition matrix below `growth`, by the matrix of w in one segment.

    Rates are measured by `clock` (s). Raises `IntegrationError`.
    """
    return segments_for(equations.varied(w).transitions[0], clock, growth, between)


def segments_for(matrix: np.ndarray, clock: float, growth: float, between: tuple[int, int]) -> int:
    """Segments that share the growth of a state-transition matrix so that none has more than `growth`."""
    n = len(matrix) // 2
    units = np.concatenate([np.ones(n), np.full(n, clock)])
    found = max(float(np.linalg.norm(matrix * units[:, None] / units[None, :], 2)), 2.0)
    return min(max(int(np.ceil(np.log(found) / np.log(growth))), between[0]), between[1])
