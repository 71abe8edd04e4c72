"""Multiple shooting: a Problem as a nonlinear program over the unknowns of its loop, in graphs of CasADi."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.integrate.cvodes import Flow, IntegratorSettings, build_flow, end_state, transition_function
from orbitfinder.integrate.march import March, uniform
from orbitfinder.loops.conditions import Variables, constrained_brake_rows, variables_of
from orbitfinder.loops.loop import Equations, Loop, Unknowns
from orbitfinder.loops.problem import Problem, loop_of
from orbitfinder.mechanics import scales
from orbitfinder.mechanics.constrained import allowed_velocities
from orbitfinder.mechanics.hybrid import freed, saltation, share
from orbitfinder.mechanics.model import Model


@dataclass(frozen=True)
class ShootingRanges:
    """How far the unknowns of the nonlinear program may go from the guess."""

    period_range: float = 5.0
    """The period may change by this factor either way; keeps it away from 0, where every state closes."""
    unfolding_range: float = 10.0
    """Bound on |s| in 1/s; a fictitious damping of this size has left the problem."""
    rate_range: float = 100.0
    """Bound on rates, in units of the largest rate of the guess."""
    angle_range: float = 30.0
    """Bound on how far a coordinate may move from the guess, in units of max(1, its largest value)."""
    far: float = 30.0
    """Units of the guess that take the place of the 1 there, where they are not 1"""
    resolved: float = 1e-10
    """IPOPT is asked for no more digits of a row than its round-off leaves."""


RANGES = ShootingRanges()


@dataclass(frozen=True)
class Shooting:
    """The nonlinear program: min f(w) subject to g(w) = 0, low <= h(w) <= high and bounds.

    w is the vector of the loop's unknowns in their `units`; `start` is where it starts. `rows(w, ends)` is g when the
    segments end at `ends` (2n x N): those of the `loop`, then the user's; `constraints(w)` is g by CVODES and
    `jacobian(w)` its derivative by the variational equations; `lost` is what of each row may be round-off of a pin's
    terms; `inequalities` is h.
    `objective` is 1/2 sum weight (w - guess)^2, whose Hessian is diagonal, or the problem's own;
    `residuals` is r where that is |r|^2 / 2, else empty.
    """

    problem: Problem
    flow: Flow
    loop: Loop
    guess: Unknowns
    units: np.ndarray
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    weights: np.ndarray
    variables: ca.MX
    objective: ca.MX
    rows: ca.Function
    lost: np.ndarray
    constraints: ca.MX
    jacobian: ca.Function
    inequalities: ca.MX
    low: np.ndarray
    high: np.ndarray
    residuals: ca.MX

    @property
    def square(self) -> bool:
        """True when the equations leave nothing to choose."""
        return self.problem.count(len(self.guess.nodes)).freedom == 0

    def at(self, w: np.ndarray) -> Unknowns:
        """The unknowns in the model's own units."""
        return self.guess.at(np.asarray(w) * self.units)

    def vector(self, unknowns: Unknowns) -> np.ndarray:
        """w of unknowns."""
        return np.asarray(unknowns.vector / self.units)


def transcribe(problem: Problem, nodes: np.ndarray | Unknowns, flow: Flow | None = None) -> Shooting:
    """The multiple-shooting program of a Problem started from node states (N x 2n), or from unknowns of arcs.

    The rows of its loop (see `loops.loop`) and of its constraints, in {2n N node states, T, s per invariant, freed
    parameters}: square and regular at an orbit (Muñoz-Almaraz et al., Physica D 181 (2003) 1-38).
    """
    problem.check_count()
    flow = flow or flow_of(problem)
    equations = Equations(problem.model, problem.boundary, problem.free, given=March(flow.field, problem.model.forced))
    if isinstance(nodes, np.ndarray):
        guess = equations.unknowns(nodes, problem.guess.period, uniform(problem.boundary.fraction, len(nodes), 1))
        far = far_end(problem, nodes, flow)
    else:
        guess, far = nodes, equations.links.passed(nodes, equations.ends(nodes))[0][-1]
    units, own, phases = _units(problem.model, flow, guess)
    even = bool(np.all(units == 1.0))
    loop = loop_of(problem, equations, guess, far, problem.pin, phases)
    scaled = guess.symbols()
    w, given = ca.vertcat(*scaled[0], *scaled[1]), ca.MX.sym("ends", equations.size, len(guess.nodes))
    start = guess.vector / units
    parts, tail = scaled if even else _times(scaled, units)
    known = _variables(loop, flow, parts, tail, given)
    equalities = _rows(loop, problem, known, tail, far)
    lost, hidden = np.zeros(equalities.numel()), loop.lost(guess)  # the user's constraints come after the loop's rows
    lost[: hidden.size] = hidden
    if not even:
        by_ends = ca.jacobian(equalities, given) @ ca.diag(ca.DM(units[: guess.nodes.size]))
        slopes = ca.Function("slopes", [w, given], [ca.horzcat(ca.jacobian(equalities, w), by_ends)])
        sizes = np.abs(slopes(start, np.roll(guess.nodes, -1, axis=0).T).full()).max(axis=1)
        sizes = np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)
    else:
        sizes = np.ones(lost.size)
        steepest = np.abs(loop.slopes(guess, loop.conditions)).max(axis=1)  # of a large mass by over 256
        last = hidden.size - len(equations.links.transitions)
        sizes[last - len(loop.conditions) : last] = scales.snapped(steepest, scales.WIDE)
    sizes = np.maximum(sizes, lost / RANGES.resolved)
    rows = ca.Function("rows", [w, given], [equalities if np.all(sizes == 1.0) else equalities / ca.DM(sizes)])
    limits, low, high = _inequalities(problem, known)
    aims = ca.Function("aims", [w, given], [*_objective(problem, known), limits])
    if beat := problem.model.forcing_period:  # no step may leave it
        tail = [problem.forcing_cycles * beat(problem.model.parameters(equations.free, tail[-1])), *tail[1:]]
    ends = ca.horzcat(*(part.end(*given) for part, given in spans(equations, flow, parts, tail)))
    constraints = rows(w, ends)
    lower, upper = (bound.vector / units for bound in _bounds(problem, even, guess, guess.at(units)))
    weights = _weights(problem, guess.at(guess.vector / own)) * (units / own) ** 2
    value, residuals, inequalities = aims(w, ends)
    if problem.objective == "nearest":
        value = 0.5 * ca.dot(ca.DM(weights), (w - start) ** 2)
    return Shooting(
        problem, flow, loop, guess, units, np.clip(start, lower, upper), lower, upper, weights, w, value, rows,
        lost / sizes, constraints, ca.Function("jacobian", [w], [ca.jacobian(constraints, w)]), inequalities, low, high,
        residuals,
    )  # fmt: skip


def flow_of(problem: Problem, settings: IntegratorSettings | None = None) -> Flow:
    """The flow of a Problem's model, or of each arc of its cycle, in the units of its guess's motion."""
    symmetry, units, model = problem.boundary, units_of(problem), problem.model
    arcs = [model] if model.smooth else [mode.model for mode, _ in model.hybrid.part(symmetry.parts)]
    free = freed(model, problem.free, symmetry.parts)
    first, *later = (build_flow(arc, free, symmetry.unfolded(arc), settings, units) for arc in arcs)
    return replace(first, later=tuple(later)) if later else first


def units_of(problem: Problem) -> tuple[float, ...]:
    """What the state (d) of a Problem is measured in: what its guess's motion is integrated in; () when all 1."""
    guess = problem.guess
    states = np.asarray(guess.state, float)[None] if guess.states is None else np.asarray(guess.states)
    return scales.units_of(problem.model, states, guess.period, scales.base_of(problem.model))


def _units(model: Model, flow: Flow, guess: Unknowns) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Units of every entry of w, units of the distance to the guess, and those (d) of phase conditions.

    Nodes and period are in the flow's units, freed parameters in their own sizes. Of a motion that shows its sizes w is
    in these themselves and phases are in powers of 256.
    """
    turn, sizes = guess.period / (2 * np.pi), np.where(guess.free == 0, 1.0, np.abs(guess.free))
    own, base = np.ones(guess.vector.size), scales.base_of(model)
    if flow.units:
        clock = float(scales.snapped(turn, base))
        own = guess.joined(np.asarray(flow.units), clock, 1.0 / clock, sizes)
    if base == scales.COARSE:
        return own, own, np.asarray(flow.units) if flow.units else None
    exact, phases = (scales.units_of(model, guess.nodes, guess.period, each) for each in (0.0, scales.COARSE))
    return guess.joined(np.asarray(exact), turn, 1.0 / turn, sizes), own, np.asarray(phases) if phases else None


def _times(parts: tuple[list[ca.MX], list[ca.MX]], units: np.ndarray) -> tuple[list[ca.MX], list[ca.MX]]:
    """The parts of w in the model's units."""
    nodes, tail = parts
    ends = np.cumsum([0, *(part.numel() for part in [*nodes, *tail])])
    scaled = [part * ca.DM(units[ends[k] : ends[k + 1]]) for k, part in enumerate([*nodes, *tail])]
    return scaled[: len(nodes)], scaled[len(nodes) :]


def spans(equations: Equations, flow: Flow, nodes: Sequence[Any], tail: Sequence[Any]) -> list[tuple[Flow, list[Any]]]:
    """The flow of each segment with what it is given: when and where it begins, how long it lasts, s and free."""
    (period, s, free), model, arcs = tail, equations.model, (flow, *flow.later)
    p, parts, each = model.parameters(equations.free, free), equations.symmetry.parts, len(nodes) // len(arcs)
    lasts = [period * (share(model, arc, p, parts) / each) for arc in range(len(arcs))]
    return [(arcs[k // each], [k * lasts[k // each], x, lasts[k // each], s, free]) for k, x in enumerate(nodes)]


def _variables(loop: Loop, flow: Flow, parts: list[ca.MX], tail: list[ca.MX], ends: ca.MX) -> Variables:
    """The unknowns by name, for whatever the user asks of them."""
    equations, (period, _, free), reached = loop.equations, tail, tuple(ca.horzsplit(ends))
    model, p = equations.model, equations.model.parameters(equations.free, free)

    def transitions() -> list[ca.MX]:
        functions = [transition_function(part) for part in (flow, *flow.later)]
        each = len(parts) // len(functions)
        given = (inputs for _, inputs in spans(equations, flow, parts, tail))
        matrices = [functions[k // each](*inputs) for k, inputs in enumerate(given)]
        arcs = model.arcs
        for arc, k in enumerate(equations.links.ends(len(parts))):
            (mode, transition), (after, _) = arcs[arc], arcs[(arc + 1) % len(arcs)]
            matrices[k] = saltation(mode.model, transition, after.model)(reached[k], p) @ matrices[k]
        return matrices

    return variables_of(equations, parts, period, free, reached, transitions)


def _objective(problem: Problem, known: Variables) -> tuple[ca.MX, ca.MX]:
    """f and, where f = |r|^2 / 2, r. Raises `InputError` when the objective is not an expression of the unknowns."""
    if not callable(problem.objective):
        return ca.MX(0), ca.MX(0, 1)
    value = ca.vec(ca.MX(problem.objective(known)))
    return (value, ca.MX(0, 1)) if value.numel() == 1 else (0.5 * ca.dot(value, value), value)


def _inequalities(problem: Problem, known: Variables) -> tuple[ca.MX, np.ndarray, np.ndarray]:
    """h with its limits: constraints with room, and bounds on what is not an unknown itself."""
    rows, low, high = [ca.MX(0, 1)], [], []
    for name, (smallest, largest) in problem.bounds.items():
        if name != "period" and name not in problem.free:
            rows.append(known[name])
            low.append(smallest)
            high.append(largest)
    for constraint in problem.constraints:
        if not constraint.equation:
            rows.append(constraint.value(known))
            low += [constraint.lower] * constraint.rows
            high += [constraint.upper] * constraint.rows
    return ca.vertcat(*rows), np.asarray(low, float), np.asarray(high, float)


def _rows(loop: Loop, problem: Problem, known: Variables, tail: list[ca.MX], far: np.ndarray | None) -> ca.MX:
    """All rows of g: the loop's, the user's phase condition in place of time's, equations."""
    model, start, end = problem.model, known.nodes[0], known.ends[-1]
    if problem.phase_condition is not None:  # the first normal belongs to time
        loop = replace(loop, normals=loop.normals[1:])
    rows = loop.stated(known.nodes, known.period, tail[-1], known.ends)
    closed = start.numel() * len(known.nodes)
    closing = rows[closed - start.numel() : closed]
    if model.constraint is not None and far is not None:
        closing = constrained_brake_rows(model, start, end, known.parameters, allowed_velocities(model, far))
    own = [] if problem.phase_condition is None else [ca.MX(problem.phase_condition(known))]
    equations = [each.value(known) - each.lower for each in problem.constraints if each.equation]
    return ca.vertcat(rows[: closed - start.numel()], closing, *own, rows[closed:], *equations)


def far_end(problem: Problem, nodes: np.ndarray, flow: Flow) -> np.ndarray | None:
    """The guess's state at the end of the horizon, where the boundary rows need it: the other instant of symmetry."""
    symmetry, n = problem.boundary, problem.model.degrees_of_freedom
    if not symmetry.reverses or (problem.model.constraint is None and not np.any(symmetry.rows(n)[1][:, :n])):
        return None  # no row holds coordinates there
    duration = problem.guess.period * problem.boundary.fraction / len(nodes)
    return end_state(flow, nodes[-1], duration, (len(nodes) - 1) * duration)


def _bounds(problem: Problem, even: bool, guess: Unknowns, units: Unknowns) -> tuple[Unknowns, Unknowns]:
    """Lowest and highest unknowns."""
    n = problem.model.degrees_of_freedom
    least = np.ones(n) if even else RANGES.far * units.nodes[0, :n]
    coordinates = np.maximum(least, np.abs(guess.nodes[:, :n]).max(axis=0))
    rates = np.resize(least, guess.nodes[0].size - n)
    pace = max(float((np.abs(guess.nodes[:, n:]) / rates).max(initial=0.0)), 2 * np.pi / problem.guess.period)
    reach = np.concatenate([RANGES.angle_range * coordinates, RANGES.rate_range * pace * rates])
    unfolding = RANGES.unfolding_range * units.unfolding
    spread = 0.95 * np.abs(guess.free) + (guess.free == 0)
    times = problem.bounds.get("period", (guess.period / RANGES.period_range, guess.period * RANGES.period_range))
    if problem.model.forced:  # a bound would push it
        times = -np.inf, np.inf
    free = freed(problem.model, problem.free, problem.boundary.parts)
    ends = zip(free, guess.free - spread, guess.free + 10 * spread, strict=True)
    ranges = np.array([problem.bounds.get(name, (low, high)) for name, low, high in ends]).reshape(-1, 2).T
    return (
        replace(guess, nodes=guess.nodes - reach, period=times[0], unfolding=-unfolding, free=ranges[0]),
        replace(guess, nodes=guess.nodes + reach, period=times[1], unfolding=unfolding, free=ranges[1]),
    )


def _weights(problem: Problem, start: Unknowns) -> np.ndarray:
    """Weights of the distance to the guess: 1 for angles in rad, or for each unit; rates and periods comparable."""
    size, n, clock = start.nodes.shape[1], problem.model.degrees_of_freedom, start.period / (2 * np.pi)
    node = np.concatenate([np.ones(n), np.full(size - n, clock**2)]) / len(start.nodes)
    relative = 1.0 / np.where(start.free == 0, 1e-6, start.free) ** 2
    return start.joined(node, (1.0 / start.period) ** 2, 0.0, relative)
