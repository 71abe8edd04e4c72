"""Warm refinement: everything that depends on the equations alone is built once, guesses are then cheap.

    refiner = Refiner(problem)                # equations, variations, compiled where possible
    refined = refiner.refine(guess)           # milliseconds

Multiple shooting by Newton's method on a fixed-step eighth-order integrator. The first iterations take end states and
their derivatives from one coarse march of x and Phi; the last ones are chord steps whose residual comes from finer
marches of x alone, doubled until twice as many steps say the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.compiled import compiled
from orbitfinder.errors import ConvergenceError, CountError, InputError, IntegrationError
from orbitfinder.flow import build_flow
from orbitfinder.periodic.conditions import Pin, boundary_rows, quantity, unfolded_invariants
from orbitfinder.periodic.elimination import Linearised, Solver, eliminated
from orbitfinder.periodic.polish import tail_of
from orbitfinder.periodic.preparation import WINDING_MARGIN, at_forcing_period
from orbitfinder.periodic.problem import Guess, Problem
from orbitfinder.periodic.shooting import boundary_shift, phase_directions
from orbitfinder.runge_kutta import block, variational_field


@dataclass(frozen=True)
class WarmSettings:
    """How fine the marches are, and when enough is enough."""

    steps_per_period: int = 100
    """of the coarse march, which starts the iteration and whose Phi serves to its end"""
    growth_per_segment: float = 1e3
    """segments are added until no state-transition matrix of the first guess is larger than this"""
    most_segments: int = 40
    handover: float = 1e-4
    """residual at which the coarse march has done its work"""
    contraction: float = 0.1
    """a chord step that reduces the residual by less asks for a new Jacobian"""
    rough: float = 1e-10
    """residual to which the march that is still to be confirmed is driven"""
    agreement: float = 1e-12
    """two step sizes must agree to this; the finer is then some 2^8 times better than that"""
    most_evaluations: int = 30
    most_doublings: int = 7
    converged: float = 1e-8
    """a larger residual at the end is a failure"""


@dataclass(frozen=True)
class Refined:
    """A refined orbit: state (2n), period (s), nodes (N x 2n), unfolding, freed parameters, turns, residual.

    `residual` is the largest row of the shooting equations, `steps` the Runge-Kutta steps per segment of the march
    that says so, `marches` and `jacobians` what it took.
    """

    state: np.ndarray
    period: float
    nodes: np.ndarray
    unfolding: np.ndarray
    free: np.ndarray
    turns: np.ndarray
    residual: float
    steps: int
    marches: int
    jacobians: int


@dataclass(frozen=True)
class _Path:
    """Nodes (N x 2n) and tail (period, unfolding, freed parameters)."""

    nodes: np.ndarray
    tail: np.ndarray

    def moved(self, step: tuple[np.ndarray, np.ndarray], factor: float = 1.0) -> _Path:
        return _Path(self.nodes + factor * step[0], self.tail + factor * step[1])


@dataclass(frozen=True)
class _Conditions:
    """What one guess fixes: phase reference and directions (2n x k), displacement (n), pins."""

    reference: np.ndarray
    directions: np.ndarray
    shift: np.ndarray
    pins: np.ndarray


class Refiner:
    """Refines guesses of one Problem, as many as you like, at its pins or at others of the same names.

    Building it derives and, with a C compiler, compiles (a second, once; later runs load the library). It needs a
    Problem as square as `Problem.count()` wants it, with pins and no objective. Raises `CountError`, `InputError`.
    """

    def __init__(self, problem: Problem, settings: WarmSettings | None = None) -> None:
        _check(problem)
        self.settings = settings or WarmSettings()
        self.problem = problem = at_forcing_period(problem)
        unfolded = unfolded_invariants(problem.model, problem.boundary)
        self.flow = build_flow(problem.model, problem.free, unfolded)
        field, fraction = self.flow.field, problem.boundary.fraction
        varied = variational_field(field)
        self._known, self._marches, self._jacobians = tail_of(self.flow), 0, 0
        self.segments = problem.segments or self._needed(varied)
        self._steps = max(4, int(np.ceil(self.settings.steps_per_period * fraction / self.segments)))
        self._march = compiled(block(field, self._steps, self.segments))
        self._first = compiled(block(field, self._steps, 1))
        self._vary = compiled(block(varied, self._steps, self.segments))
        self._rates = field.map(self.segments)
        self._closing = _closing(problem)

    def refine(self, guess: Guess | None = None, pin: Sequence[Pin] | None = None) -> Refined:
        """The orbit near a guess (default: the problem's) at the pins (default: the problem's).

        Raises `ConvergenceError` when Newton's method does not converge from there (find_orbit reaches farther),
        `IntegrationError` when the motion cannot be integrated.
        """
        self._marches = self._jacobians = 0
        path = self._start(guess or self.problem.guess)
        conditions, path, solver = self._approach(path, _values(self.problem, pin))
        path, rows, blocks = self._finish(path, conditions, solver)
        residual = max(float(np.abs(part).max(initial=0.0)) for part in rows)
        if not residual < self.settings.converged:
            raise ConvergenceError(
                f"warm refinement stalled at a residual of {residual:.2g}; the orbit is too unstable for "
                f"{self.segments} segments, give the problem more"
            )
        extra = len(self.flow.unfolded)
        turns = conditions.shift / (2 * np.pi) if self.problem.symmetry == "none" else np.zeros(conditions.shift.size)
        return Refined(
            path.nodes[0], float(path.tail[0]), path.nodes, path.tail[1 : 1 + extra], path.tail[1 + extra :],
            np.round(turns).astype(int), residual, self._steps * blocks, self._marches, self._jacobians,
        )  # fmt: skip

    # ---- the iteration -----------------------------------------------------------------------------

    def _approach(self, path: _Path, pins: np.ndarray) -> tuple[_Conditions, _Path, Solver]:
        """Newton with damping on the coarse march until the residual is small."""
        conditions: _Conditions | None = None
        before, step, factor, best = path, (path.nodes, path.tail), 1.0, np.inf
        for _ in range(self.settings.most_evaluations):
            try:
                ends, system = self._linearised(path)
                conditions = conditions or self._conditions(path, ends, pins)
                rows = self._rows(path, ends, conditions)
                size = float(np.sqrt(sum(np.sum(part**2) for part in rows)))
            except IntegrationError:
                if conditions is None:
                    raise
                size = np.inf
            if size < best:
                solver = eliminated(self._completed(system, path, ends, conditions))
                before, best, factor = path, size, 1.0
                step = solver(*rows)
                if size < self.settings.handover:
                    return conditions, path.moved(step), solver
            else:
                factor /= 2
            path = before.moved(step, factor)
        raise ConvergenceError(
            f"warm refinement does not converge from this guess (residual {best:.2g}); find_orbit reaches farther"
        )

    def _finish(
        self, path: _Path, conditions: _Conditions, solver: Solver
    ) -> tuple[_Path, tuple[np.ndarray, np.ndarray], int]:
        """Chord steps on ever finer marches until twice as many steps confirm the residual, then to round-off."""
        blocks = 2
        for _ in range(self.settings.most_doublings):
            path, rows, solver = self._chord(path, conditions, solver, blocks, self.settings.rough)
            finer = self._rows(path, self._ends(path, 2 * blocks), conditions)
            change = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(rows, finer, strict=True))
            blocks *= 2
            if change <= self.settings.agreement * max(1.0, float(np.abs(path.nodes).max())):
                break
        path, rows, _ = self._chord(path, conditions, solver, blocks, 0.0)
        return path, rows, blocks

    def _chord(
        self, path: _Path, conditions: _Conditions, solver: Solver, blocks: int, target: float
    ) -> tuple[_Path, tuple[np.ndarray, np.ndarray], Solver]:
        """Steps with a fixed Jacobian, renewed where it no longer contracts, down to `target` or round-off."""
        def evaluated(one: _Path) -> tuple[tuple[np.ndarray, np.ndarray], float]:
            rows = self._rows(one, self._ends(one, blocks), conditions)
            return rows, max(float(np.abs(part).max(initial=0.0)) for part in rows)

        rows, size = evaluated(path)
        for _ in range(self.settings.most_evaluations):
            if size <= target:
                break
            trial = path.moved(solver(*rows))
            found, reached = evaluated(trial)
            slow = reached > self.settings.contraction * size
            if reached < size:
                path, rows, size = trial, found, reached
            if slow and size < 1e3 * self.settings.agreement:
                break  # round-off
            if slow:
                ends, system = self._linearised(path)
                solver = eliminated(self._completed(system, path, ends, conditions))
        return path, rows, solver

    # ---- marches -----------------------------------------------------------------------------------

    def _parameters(self, path: _Path, steps: int) -> np.ndarray:
        """h, unfolding and freed parameters of each lane."""
        span = path.tail[0] * self.problem.boundary.fraction / self.segments
        return np.tile(np.concatenate([[span / steps], path.tail[1:]])[:, None], (1, self.segments))

    def _clock(self, path: _Path) -> np.ndarray:
        return path.tail[0] * self.problem.boundary.fraction / self.segments * np.arange(self.segments)

    def _ends(self, path: _Path, blocks: int) -> np.ndarray:
        """End states (N x 2n) by so many blocks of steps."""
        z: Any = np.vstack([self._clock(path), path.nodes.T])
        p = ca.DM(self._parameters(path, self._steps * blocks))
        self._marches += 1
        for _ in range(blocks):
            z = self._march(z, p)
        return _finite(z.full()[1:].T, path)

    def _linearised(self, path: _Path) -> tuple[np.ndarray, Linearised]:
        """End states (N x 2n) and their derivatives by the coarse march; the closing rows are still missing."""
        count, size = path.nodes.shape
        extra = path.tail.size - 1
        unit = np.eye(size, size + extra).ravel("F")
        z = np.vstack([self._clock(path), path.nodes.T, np.tile(unit[:, None], (1, count))])
        found = _finite(self._vary(z, self._parameters(path, self._steps)).full().T, path)
        self._jacobians += 1
        clock, ends = found[:, :1].T, found[:, 1 : 1 + size]
        matrices = found[:, 1 + size :].reshape(count, size + extra, size).transpose(0, 2, 1)
        share = self.problem.boundary.fraction / count
        tail = np.tile(path.tail[1:, None], (1, count))
        s, free = tail[: len(self.flow.unfolded)], tail[len(self.flow.unfolded) :]
        late = self._rates(clock, ends.T, s, free).full().T
        slopes = late * share
        if self.problem.model.forced:
            early = self._rates(z[:1], path.nodes.T, s, free).full().T
            delayed = late - np.einsum("kij,kj->ki", matrices[:, :, :size], early)
            slopes = slopes + delayed * (share * np.arange(count))[:, None]
        columns = np.concatenate([slopes[:, :, None], matrices[:, :, size:]], axis=2)
        none = np.zeros((0, size))
        return ends, Linearised(matrices[:, :, :size], columns, none, none, none)

    def _needed(self, varied: ca.Function) -> int:
        """Segments that keep every state-transition matrix of the guess small."""
        guess, fraction = self.problem.guess, self.problem.boundary.fraction
        state = np.asarray(guess.state, float)
        size, steps = state.size, self.settings.steps_per_period
        unit = np.eye(size, size + self._known.size).ravel("F")
        p = np.concatenate([[guess.period * fraction / steps], self._known])
        found = block(varied, steps, 1)(np.concatenate([[0.0], state, unit]), p).full().ravel()
        clock = np.concatenate([np.ones(size // 2), np.full(size // 2, guess.period / (2 * np.pi))])
        matrix = found[1 + size : 1 + size + size**2].reshape(size, size, order="F")
        if not np.all(np.isfinite(matrix)):
            return self.settings.most_segments
        growth = max(float(np.linalg.norm(matrix * clock[:, None] / clock[None, :], 2)), 2.0)
        return min(int(np.ceil(np.log(growth) / np.log(self.settings.growth_per_segment))), self.settings.most_segments)

    # ---- conditions --------------------------------------------------------------------------------

    def _start(self, guess: Guess) -> _Path:
        """Nodes of a guess: sampled from its trajectory, else simulated from its state."""
        state, period = np.asarray(guess.state, float), float(guess.period)
        if state.shape != (len(self.problem.model.state_names),) or not np.all(np.isfinite(state)):
            raise InputError(f"guess.state: need {len(self.problem.model.state_names)} finite numbers, got {state!r}")
        if not (np.isfinite(period) and period > 0):
            raise InputError(f"guess.period: must be positive and finite, got {period}; give a period in s")
        tail = np.concatenate([[period], self._known])
        span = period * self.problem.boundary.fraction / self.segments
        if guess.times is not None and guess.states is not None:
            moments = span * np.arange(self.segments)
            return _Path(np.stack([np.interp(moments, guess.times, row) for row in guess.states.T], axis=1), tail)
        p, nodes = np.concatenate([[span / self._steps], self._known]), [state]
        for k in range(1, self.segments):
            nodes.append(self._first(np.concatenate([[(k - 1) * span], nodes[-1]]), p).full().ravel()[1:])
        return _Path(np.asarray(nodes), tail)

    def _conditions(self, path: _Path, ends: np.ndarray, pins: np.ndarray) -> _Conditions:
        """Phase conditions and displacement as the guess and its end have them."""
        problem, state, n = self.problem, path.nodes[0], self.problem.model.degrees_of_freedom
        if problem.symmetry == "none" and problem.winding is None:
            turned = np.where(problem.model.angles, (ends[-1] - state)[:n] / (2 * np.pi), 0.0)
            whole = np.round(turned)
            shift = 2 * np.pi * whole * bool(np.all(np.abs(turned - whole) <= WINDING_MARGIN))
        else:
            shift = boundary_shift(problem, path.nodes, ends[-1])
        directions = np.asarray(phase_directions(problem, state)).reshape(-1, 2 * n).T
        return _Conditions(state, directions, shift, pins)

    def _rows(self, path: _Path, ends: np.ndarray, conditions: _Conditions) -> tuple[np.ndarray, np.ndarray]:
        """Defects (N-1 x 2n) between the segments and the closing rows."""
        closing = self._closing(*_arguments(path, ends, conditions, len(self.flow.unfolded)))[0]
        return ends[:-1] - path.nodes[1:], closing.full().ravel()

    def _completed(self, system: Linearised, path: _Path, ends: np.ndarray, conditions: _Conditions) -> Linearised:
        """The linearisation with the derivatives of its closing rows."""
        extra = len(self.flow.unfolded)
        _, first, last, tail = self._closing(*_arguments(path, ends, conditions, extra))
        whole = np.insert(tail.full(), [1] * extra, 0.0, axis=1)  # no closing row contains the unfolding
        return Linearised(system.transitions, system.columns, first.full(), last.full(), whole)


def _arguments(path: _Path, ends: np.ndarray, conditions: _Conditions, extra: int) -> tuple[np.ndarray, ...]:
    tail = np.concatenate([path.tail[:1], path.tail[1 + extra :]])
    return (
        path.nodes[0], ends[-1], tail, conditions.shift, conditions.directions, conditions.reference, conditions.pins
    )  # fmt: skip


def _closing(problem: Problem) -> ca.Function:
    """Boundary, phase, forcing and pin rows as a function of (first, last, (T, free), shift, directions, reference,
    pins), with their derivatives by the first three."""
    model, n = problem.model, problem.model.degrees_of_freedom
    first, last = ca.MX.sym("first", 2 * n), ca.MX.sym("last", 2 * n)
    tail, shift = ca.MX.sym("tail", 1 + len(problem.free)), ca.MX.sym("shift", n)
    count = len(phase_directions(problem, np.asarray(problem.guess.state, float)))
    directions, reference = ca.MX.sym("directions", 2 * n, count), ca.MX.sym("reference", 2 * n)
    pins, parameters = ca.MX.sym("pins", len(problem.pin)), model.parameters(problem.free, tail[1:])
    rows = [boundary_rows(problem.boundary, first, last, shift), directions.T @ (first - reference)]  # type: ignore[arg-type]
    if model.forcing_period is not None:
        rows.append(tail[0] - problem.forcing_cycles * model.forcing_period(parameters))
    rows += [quantity(model, one.name, first, tail[0], parameters) - pins[k] for k, one in enumerate(problem.pin)]
    whole = ca.vertcat(*rows)
    inputs = [first, last, tail, shift, directions, reference, pins]
    slopes = [ca.densify(ca.jacobian(whole, one)) for one in (first, last, tail)]
    return ca.Function("closing", inputs, [whole, *slopes])


def _values(problem: Problem, pin: Sequence[Pin] | None) -> np.ndarray:
    """Values of the pins in the problem's order."""
    known = {one.name: one.value for one in problem.pin}
    given = {one.name: one.value for one in (problem.pin if pin is None else pin)}
    if known.keys() != given.keys():
        raise InputError(
            f"pin: this refiner was built for pins of {', '.join(known) or 'nothing'}, got "
            f"{', '.join(given) or 'nothing'}; build another one"
        )
    return np.array([given[name] for name in known], float)


def _finite(numbers: np.ndarray, path: _Path) -> np.ndarray:
    if np.all(np.isfinite(numbers)):
        return numbers
    segment = int(np.argmin(np.all(np.isfinite(numbers), axis=1)))
    raise IntegrationError("the state is not finite", segment=segment, time=0.0, state=path.nodes[segment])


def _check(problem: Problem) -> None:
    """Only square systems of pins can be refined by Newton's method alone."""
    problem.check_count()
    others = {"constraints": problem.constraints, "phase_condition": problem.phase_condition, "bounds": problem.bounds}
    for name, value in others.items():
        if value:
            raise InputError(f"{name}: warm refinement knows pins only; use find_orbit")
    count = problem.count()
    if count.freedom:
        raise CountError(f"pin: {count} leave {count.freedom} to choose; warm refinement needs as many pins")
