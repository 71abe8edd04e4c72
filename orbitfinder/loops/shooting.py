"""Multiple shooting: a Problem as a nonlinear program over the unknowns of its loop, in graphs of CasADi."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from orbitfinder.integrate.cvodes import Flow, build_flow, end_state, transition_function
from orbitfinder.loops.conditions import Variables, boundary_rows, constrained_brake_rows, pin_row
from orbitfinder.loops.loop import Layout
from orbitfinder.loops.problem import Problem, boundary_constants
from orbitfinder.mechanics import scales
from orbitfinder.mechanics.constrained import allowed_velocities

PERIOD_RANGE = 5.0
"""The period may change by this factor either way; keeps it away from 0, where every state closes."""
UNFOLDING_RANGE = 10.0
"""Bound on |s| in 1/s; a fictitious damping of this size has left the problem."""
RATE_RANGE = 100.0
"""Bound on rates, in units of the largest rate of the guess."""
ANGLE_RANGE = 30.0
"""Bound on how far a coordinate may move from the guess, in units of max(1, its largest value)."""
FAR = 30.0
"""Units of the guess that take the place of the 1 there, where they are not 1"""


@dataclass(frozen=True)
class Shooting:
    """The nonlinear program: min f(w) subject to g(w) = 0, low <= h(w) <= high and bounds.

    `ends(w)` are the segments' end states (2n x N), `rows(w, ends)` is g, `constraints(w)` is
    rows(w, ends(w)) and `jacobian(w)` its derivative by the variational equations; `inequalities` is h.
    `objective` is 1/2 sum weight (w - guess)^2, whose Hessian is diagonal, or the problem's own;
    `residuals` is r where that is |r|^2 / 2, else empty.
    """

    problem: Problem
    flow: Flow
    layout: Layout
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    weights: np.ndarray
    variables: ca.MX
    objective: ca.MX
    rows: ca.Function
    constraints: ca.MX
    jacobian: ca.Function
    inequalities: ca.MX
    low: np.ndarray
    high: np.ndarray
    residuals: ca.MX

    @property
    def square(self) -> bool:
        """True when the equations leave nothing to choose."""
        return self.problem.count(self.layout.segments).freedom == 0


def transcribe(problem: Problem, nodes: np.ndarray, flow: Flow | None = None) -> Shooting:
    """The multiple-shooting program of a Problem started from node states (N x 2n).

    2n N rows of continuity and boundary, one phase condition per continuous symmetry and one row
    per pin or equation, in {2n N node states, T, s per invariant, freed parameters}: square and regular
    at an orbit (Muñoz-Almaraz et al., Physica D 181 (2003) 1-38).
    """
    problem.check_count()
    unfolded = problem.boundary.unfolded(problem.model)
    flow = flow or build_flow(problem.model, problem.free, unfolded, units=units_of(problem))
    size = len(problem.model.state_names)
    layout = Layout(size, len(nodes), len(unfolded), len(problem.free), _unit_of_each(problem, flow, len(nodes)))
    free = np.array([problem.model.parameter_values[problem.model.parameter_index(f)] for f in problem.free])
    start = layout.join(nodes, problem.guess.period, free)
    scaled = [*(ca.MX.sym("node", size) for _ in range(layout.segments)), ca.MX.sym("period"),
              ca.MX.sym("unfolding", layout.unfolding), ca.MX.sym("free", layout.free)]  # fmt: skip
    w = ca.vertcat(*scaled)
    physical = _times(scaled, layout.units)
    parts, tail = physical[: layout.segments], physical[layout.segments :]
    given = ca.MX.sym("ends", size, layout.segments)
    far = far_end(problem, nodes, flow)
    constant = boundary_constants(problem, nodes, far)
    known = _variables(problem, flow, parts, tail, given)
    equations = _rows(problem, (nodes[0], constant, far), known)
    rows = ca.Function("rows", [w, given], [_measured(equations, (w, given), start, layout)])
    limits, low, high = _inequalities(problem, known)
    aims = ca.Function("aims", [w, given], [*_objective(problem, known), limits])
    ends = _ends(problem, flow, parts, tail)
    constraints = rows(w, ends)
    lower, upper = _bounds(problem, layout, start)
    weights = _weights(problem, layout, start)
    value, residuals, inequalities = aims(w, ends)
    if problem.objective == "nearest":
        value = 0.5 * ca.dot(ca.DM(weights), (w - start) ** 2)
    return Shooting(
        problem, flow, layout, np.clip(start, lower, upper), lower, upper, weights, w, value, rows, constraints,
        ca.Function("jacobian", [w], [ca.jacobian(constraints, w)]), inequalities, low, high, residuals,
    )  # fmt: skip


def units_of(problem: Problem) -> tuple[float, ...]:
    """What the state (2n) of a Problem is measured in: what its guess's motion is integrated in; () when all 1."""
    guess = problem.guess
    states = np.asarray(guess.state, float)[None] if guess.states is None else np.asarray(guess.states)
    return scales.units_of(problem.model, states, guess.period)


def _unit_of_each(problem: Problem, flow: Flow, segments: int) -> tuple[float, ...]:
    """Units of every entry of w: the flow's for nodes and period, 1 / period, the freed parameters' own sizes."""
    if not flow.units:
        return ()
    n, model = len(flow.units) // 2, problem.model
    clock = flow.units[0] / flow.units[n]
    free = [abs(float(model.parameter_values[model.parameter_index(name)])) or 1.0 for name in problem.free]
    return (*flow.units * segments, clock, *[1.0 / clock] * len(flow.unfolded), *free)


def _times(parts: list[ca.MX], units: tuple[float, ...]) -> list[ca.MX]:
    """The parts of w in the model's units."""
    if not units:
        return parts
    ends = np.cumsum([0, *(part.numel() for part in parts)])
    return [part * ca.DM(units[ends[k] : ends[k + 1]]) for k, part in enumerate(parts)]


def _measured(rows: ca.MX, inputs: tuple[ca.MX, ca.MX], start: np.ndarray, layout: Layout) -> ca.MX:
    """Rows in units of what a unit of the unknowns changes in them at the start; as they are where units are 1."""
    if not layout.units:
        return rows
    w, ends = inputs
    sizes = ca.DM(np.tile(np.asarray(layout.units[: layout.size]), layout.segments))
    both = ca.horzcat(ca.jacobian(rows, w), ca.jacobian(rows, ends) @ ca.diag(sizes))
    slopes = ca.Function("slopes", [w, ends], [both])
    nodes = layout.nodes(start)
    size = np.abs(slopes(start, np.roll(nodes, -1, axis=0).T).full()).max(axis=1)
    return rows / ca.DM(np.where(np.isfinite(size) & (size > 0), size, 1.0))


def _variables(problem: Problem, flow: Flow, parts: list[ca.MX], tail: list[ca.MX], ends: ca.MX) -> Variables:
    """The unknowns by name, for whatever the user asks of them."""
    period, s, free = tail
    duration = period * (problem.boundary.fraction / len(parts))

    def transitions() -> list[ca.MX]:
        function = transition_function(flow)
        return [function(k * duration, node, duration, s, free) for k, node in enumerate(parts)]

    return Variables(
        problem.model, problem.boundary, tuple(parts), tuple(ca.horzsplit(ends)), period,
        {name: free[k] for k, name in enumerate(problem.free)}, problem.model.parameters(problem.free, free),
        transitions,
    )  # fmt: skip


def _objective(problem: Problem, known: Variables) -> tuple[ca.MX, ca.MX]:
    """f and, where f = |r|^2 / 2, r. Raises `InputError` when the objective is not an expression of the unknowns."""
    if not callable(problem.objective):
        return ca.MX(0), ca.MX(0, 1)
    found = ca.vec(ca.MX(problem.objective(known)))
    return (found, ca.MX(0, 1)) if found.numel() == 1 else (0.5 * ca.dot(found, found), found)


def _inequalities(problem: Problem, known: Variables) -> tuple[ca.MX, np.ndarray, np.ndarray]:
    """h with its limits: constraints with room, and bounds on what is not an unknown itself."""
    rows: list[ca.MX] = [ca.MX(0, 1)]
    low: list[float] = []
    high: list[float] = []
    for name, (smallest, largest) in problem.bounds.items():
        if name != "period" and name not in problem.free:
            rows.append(known[name])
            low, high = [*low, smallest], [*high, largest]
    for one in problem.constraints:
        if not one.equation:
            rows.append(one.value(known))
            low, high = [*low, *[one.lower] * one.rows], [*high, *[one.upper] * one.rows]
    return ca.vertcat(*rows), np.asarray(low, float), np.asarray(high, float)


def _ends(problem: Problem, flow: Flow, parts: list[ca.MX], tail: list[ca.MX]) -> ca.MX:
    """End states of all segments, joined (2n x N)."""
    period, s, free = tail
    duration = period * (problem.boundary.fraction / len(parts))
    return ca.horzcat(*[flow.end(k * duration, node, duration, s, free) for k, node in enumerate(parts)])


def _rows(problem: Problem, guess: tuple[np.ndarray, np.ndarray, np.ndarray | None], known: Variables) -> ca.MX:
    """All rows of g: continuity, boundary, phase conditions, pins, equations; `guess`: state, constants, far end."""
    state, constant, far = guess
    model, parts, ends = problem.model, known.nodes, known.ends
    rows = [end - node for end, node in zip(ends, parts[1:], strict=False)]
    if model.constraint is not None and far is not None:
        basis = allowed_velocities(model, far)
        rows.append(constrained_brake_rows(model, parts[0], ends[-1], known.parameters, basis))
    else:
        rows.append(boundary_rows(problem.boundary, parts[0], ends[-1], constant))
    directions = phase_directions(problem, state)
    if problem.phase_condition is not None:
        rows.append(ca.MX(problem.phase_condition(known)))
        directions = directions[1:]  # the first one belongs to time
    rows += [ca.dot(ca.DM(direction), parts[0] - ca.DM(state)) for direction in directions]
    if model.forcing_period is not None:
        rows.append(known.period - problem.forcing_cycles * model.forcing_period(known.parameters))
    rows += [pin_row(model, one, parts[0], known.period, known.parameters) for one in problem.pin]
    rows += [one.value(known) - one.lower for one in problem.constraints if one.equation]
    return ca.vertcat(*rows)


def far_end(problem: Problem, nodes: np.ndarray, flow: Flow) -> np.ndarray | None:
    """The guess's state at the end of the horizon, where the boundary rows need it: the other instant of symmetry."""
    constrained = problem.model.constraint is not None and problem.boundary.reverses
    if not problem.boundary.asks_where(problem.model.degrees_of_freedom) and not constrained:
        return None
    duration = problem.guess.period * problem.boundary.fraction / len(nodes)
    return end_state(flow, nodes[-1], duration, (len(nodes) - 1) * duration)


def phase_directions(problem: Problem, state: np.ndarray) -> list[np.ndarray]:
    """Unit normals (2n) of the hyperplanes through the guess that fix time and other symmetries."""
    model, symmetry = problem.model, problem.boundary
    n = model.degrees_of_freedom
    q, v, p = state[:n], state[n:], model.parameter_values
    found = []
    if not symmetry.reverses and not model.forced:
        acceleration = model.acceleration(0.0, q, v, p).full().ravel()
        found.append(np.concatenate([v, acceleration]))
    found += [one(q, v, p).full().ravel() for one in symmetry.generators(model)]
    return [direction / max(float(np.linalg.norm(direction)), 1e-300) for direction in found]


def _scales(problem: Problem, start: np.ndarray, layout: Layout) -> tuple[np.ndarray, float]:
    nodes = layout.nodes(start)
    n = layout.size // 2
    least = FAR * np.asarray(layout.units[:n]) if layout.units else 1.0
    coordinates = np.maximum(least, np.abs(nodes[:, :n]).max(axis=0))
    rate = max(float(np.abs(nodes[:, n:]).max()), 2 * np.pi / problem.guess.period * float(np.max(least)))
    return coordinates, rate


def _bounds(problem: Problem, layout: Layout, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest w."""
    coordinates, rate = _scales(problem, start, layout)
    centre, (_, _, free) = layout.nodes(start), layout.tail(start)
    reach = np.concatenate([ANGLE_RANGE * coordinates, np.full(layout.size // 2, RATE_RANGE * rate)])
    unfolding = np.full(layout.unfolding, UNFOLDING_RANGE / layout.clock)
    spread = 0.95 * np.abs(free) + (free == 0)
    period = problem.guess.period
    times = problem.bounds.get("period", (period / PERIOD_RANGE, period * PERIOD_RANGE))
    ends = zip(problem.free, free - spread, free + 10 * spread, strict=True)
    ranges = np.array([problem.bounds.get(name, (low, high)) for name, low, high in ends]).reshape(-1, 2).T
    return (
        layout.join(centre - reach, times[0], ranges[0], -unfolding),
        layout.join(centre + reach, times[1], ranges[1], unfolding),
    )


def _weights(problem: Problem, layout: Layout, start: np.ndarray) -> np.ndarray:
    """Weights of the distance to the guess: 1 for angles in rad, or for each unit; rates and periods comparable."""
    n, plain = layout.size // 2, replace(layout, units=())
    clock = problem.guess.period / (2 * np.pi) / layout.clock
    node = np.concatenate([np.ones(n), np.full(n, clock**2)]) / layout.segments
    relative = 1.0 / scales.parameter_sizes(problem.model, problem.free, plain.tail(start)[2], 1e-6) ** 2
    return plain.join(np.tile(node, layout.segments), (layout.clock / problem.guess.period) ** 2, relative)
