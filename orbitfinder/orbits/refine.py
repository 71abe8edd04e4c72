"""Warm refinement: everything that depends on the equations alone is built once, guesses are then cheap.

    refiner = Refiner(problem)                # equations, variations, compiled where possible
    refined = refiner.refine(guess)           # milliseconds

Multiple shooting by Newton's method on a fixed-step eighth-order integrator. The first iterations take end states and
their derivatives from one coarse march of x and Phi; the last ones are chord steps whose residual comes from finer
marches of x alone, doubled until twice as many steps say the same.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfinder._runtime.arguments import checked
from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.loops.closing import check_square, closing, pin_values
from orbitfinder.loops.condensed import Linearised, Solver, eliminated
from orbitfinder.loops.conditions import Pin, unfolded_invariants
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.segments import Marches, Path, segments_needed
from orbitfinder.loops.shooting import boundary_shift, phase_directions
from orbitfinder.orbits.certify import certified
from orbitfinder.orbits.measure import measure
from orbitfinder.orbits.prepare import WINDING_MARGIN, at_forcing_period
from orbitfinder.records.orbit import Orbit

Rows = tuple[np.ndarray, np.ndarray]
"""Defects (N-1 x 2n) and closing rows."""

STANDSTILL = 1e-6
"""Largest rate at the start times the period, below which the motion is none."""


@dataclass(frozen=True)
class WarmSettings:
    """How fine the marches are, and when enough is enough."""

    steps_per_period: int = 100
    """of the coarse march, which starts the iteration and whose Phi serves to its end"""
    growth_per_segment: float = 100.0
    """segments are added until no state-transition matrix of the first guess is larger than this"""
    most_segments: int = 40
    largest_change: float = 0.2
    """of the period in one step, relative: a longer step leads to a multiple of the orbit, or to another"""
    handover: float = 1e-4
    """residual at which the coarse march has done its work"""
    contraction: float = 0.1
    """a chord step that reduces the residual by less asks for a new Jacobian"""
    rough: float = 1e-10
    """residual to which the march that is still to be confirmed is driven"""
    agreement: float = 4e-12
    """two step sizes must agree to this, times the states; the finer is then some 2^8 times better than that"""
    floor: float = 1e-15
    """residual, times the states and the largest entry of Phi (at least 10), below which all is round-off"""
    most_evaluations: int = 30
    most_doublings: int = 7
    converged: float = 1e-8
    """a larger residual at the end is a failure"""


@dataclass(frozen=True)
class Refined:
    """A refined orbit: state (2n), period (s), nodes (N x 2n), unfolding, freed parameters, turns (n), residual.

    `residual` is the largest row of the shooting equations by a march of `steps` Runge-Kutta steps per segment;
    `marches` and `jacobians` are what it took.
    """

    __repr__ = brief("state", "period")

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
class Conditions:
    """What one guess fixes: phase reference and directions (2n x k), displacement (n, or 2n), pins."""

    reference: np.ndarray
    directions: np.ndarray
    shift: np.ndarray
    pins: np.ndarray


class Refiner:
    """Refines guesses of one Problem, as many as you like, at its pins or at other values of them.

    Building it derives and, with a C compiler, compiles (about a second, once; later runs load the library). It needs
    a Problem that its pins make square. Raises `CountError`, `InputError`.
    """

    __repr__ = brief("problem", "segments")

    @checked
    def __init__(self, problem: Problem, settings: WarmSettings | None = None) -> None:
        check_square(problem)
        self._alone = threading.Lock()  # the marches have one work space
        self.settings = chosen = settings or WarmSettings()
        self.problem = problem = at_forcing_period(problem)
        self.flow = build_flow(problem.model, problem.free, unfolded_invariants(problem.model, problem.boundary))
        whole = max(4, int(np.ceil(chosen.steps_per_period * problem.boundary.fraction)))
        self.segments = problem.segments or segments_needed(
            problem, self.flow, whole, chosen.growth_per_segment, chosen.most_segments
        )
        self.marches = Marches(problem, self.flow, self.segments, max(4, -(-whole // self.segments)))
        self._closing, self._slopes = closing(problem)

    def refine(self, guess: Guess | None = None, pin: Sequence[Pin] | None = None) -> Refined:
        """The orbit near a guess (default: the problem's) at the pins (default: the problem's).

        Raises `ConvergenceError` when Newton's method does not converge from there (find_orbit reaches farther),
        `IntegrationError` when the motion cannot be integrated. Threads that share a Refiner take turns.
        """
        with self._alone:
            return self._refined(guess, pin)

    def _refined(self, guess: Guess | None, pin: Sequence[Pin] | None) -> Refined:
        self.marches.states = self.marches.derivatives = 0
        path = self.marches.start(_checked(guess or self.problem.guess, len(self.problem.model.state_names)))
        conditions, path, solver = self._approach(path, pin_values(self.problem, pin))
        path, rows, blocks = self._finish(path, conditions, solver)
        if not _largest(rows) < self.settings.converged:
            raise ConvergenceError(
                f"warm refinement stalled at a residual of {_largest(rows):.2g}; the orbit is too unstable for "
                f"{self.segments} segments, give the problem more"
            )
        if self.marches.standstill(path) < STANDSTILL:
            raise ConvergenceError("warm refinement ended at an equilibrium; start farther from it, or pin the energy")
        extra = len(self.flow.unfolded)
        turns = _turns(self.problem, conditions.shift)
        return Refined(
            path.nodes[0], float(path.tail[0]), path.nodes, path.tail[1 : 1 + extra], path.tail[1 + extra :],
            turns, _largest(rows), self.marches.steps * blocks, self.marches.states,
            self.marches.derivatives,
        )  # fmt: skip

    def orbit(self, refined: Refined, with_certificate: bool = True) -> Orbit:
        """The Orbit of a refined one, measured and certified (tenths of a second). No freed parameters."""
        if refined.free.size:
            raise InputError("free: an Orbit carries no freed parameters; put their values into the model")
        turns = tuple(int(k) for k in refined.turns)
        problem = replace(self.problem, guess=Guess(refined.state, refined.period), winding=turns)
        orbit = measure(problem, self.flow, refined.nodes, refined.period, refined.unfolding)
        if not with_certificate:
            return orbit
        return certified(orbit, problem.model)

    # ---- the iteration -----------------------------------------------------------------------------

    def _approach(self, path: Path, pins: np.ndarray) -> tuple[Conditions, Path, Solver]:
        """Newton with damping on the coarse march until the residual is small."""
        conditions: Conditions | None = None
        before, step, factor, best = path, (path.nodes, path.tail), 1.0, np.inf
        for _ in range(self.settings.most_evaluations):
            try:
                ends, system = self.marches.linearised(path)
                conditions = conditions or self._conditions(path, ends, pins)
                rows = self._rows(path, ends, conditions)
                size = float(np.sqrt(sum(np.sum(part**2) for part in rows)))
            except IntegrationError:
                if conditions is None:
                    raise
                size = np.inf
            if conditions is not None and size < best:
                solver = eliminated(self._completed(system, path, ends, conditions))
                before, best, step = path, size, solver(*rows)
                factor = 1.0 / max(1.0, abs(step[1][0]) / (self.settings.largest_change * path.tail[0]))
                if size < self.settings.handover and factor == 1.0:
                    return conditions, path.moved(step), solver
            else:
                factor /= 2
            path = before.moved(step, factor)
        raise ConvergenceError(
            f"warm refinement does not converge from this guess (residual {best:.2g}); find_orbit reaches farther"
        )

    def _finish(self, path: Path, conditions: Conditions, solver: Solver) -> tuple[Path, Rows, int]:
        """Chord steps on ever finer marches until twice as many steps confirm the residual, then to round-off."""
        blocks, scale = 1, max(1.0, float(np.abs(path.nodes).max()))
        rows = self._rows(path, self.marches.ends(path, blocks), conditions)
        for _ in range(self.settings.most_doublings):
            path, rows, solver = self._chord(path, rows, conditions, solver, blocks, self.settings.rough)
            finer = self._rows(path, self.marches.ends(path, 2 * blocks), conditions)
            change = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(rows, finer, strict=True))
            blocks, rows = 2 * blocks, finer
            if change <= self.settings.agreement * scale:
                break
        floor = self.settings.floor * scale * max(10.0, self.marches.growth)
        path, rows, _ = self._chord(path, rows, conditions, solver, blocks, floor)
        return path, rows, blocks

    def _chord(
        self, path: Path, rows: Rows, conditions: Conditions, solver: Solver, blocks: int, target: float
    ) -> tuple[Path, Rows, Solver]:
        """Steps with a fixed Jacobian, renewed where it no longer contracts, down to `target` or round-off."""
        size = _largest(rows)
        for _ in range(self.settings.most_evaluations):
            if size <= target:
                break
            trial = path.moved(solver(*rows))
            found = self._rows(trial, self.marches.ends(trial, blocks), conditions)
            slow = _largest(found) > self.settings.contraction * size
            if _largest(found) < size:
                path, rows, size = trial, found, _largest(found)
            if slow and size < 1e3 * self.settings.agreement:
                break  # round-off
            if slow:
                ends, system = self.marches.linearised(path, blocks)
                solver = eliminated(self._completed(system, path, ends, conditions))
        return path, rows, solver

    # ---- conditions --------------------------------------------------------------------------------

    def _conditions(self, path: Path, ends: np.ndarray, pins: np.ndarray) -> Conditions:
        """Phase conditions and displacement as the guess and its end have them."""
        problem, state, n = self.problem, path.nodes[0], self.problem.model.degrees_of_freedom
        if problem.symmetry == "none" and problem.winding is None:
            turned = np.where(problem.model.angles, (ends[-1] - state)[:n] / (2 * np.pi), 0.0)
            whole = np.round(turned)
            shift = 2 * np.pi * whole * bool(np.all(np.abs(turned - whole) <= WINDING_MARGIN))
        else:
            shift = boundary_shift(problem, path.nodes, ends[-1])
        directions = np.asarray(phase_directions(problem, state)).reshape(-1, 2 * n).T
        return Conditions(state, directions, shift, pins)

    def _rows(self, path: Path, ends: np.ndarray, conditions: Conditions) -> Rows:
        """Defects between the segments and closing rows."""
        found = self._closing(*self._arguments(path, ends, conditions)).full().ravel()
        return ends[:-1] - path.nodes[1:], found

    def _completed(self, system: Linearised, path: Path, ends: np.ndarray, conditions: Conditions) -> Linearised:
        """The linearisation with the derivatives of its closing rows, none of which contains the unfolding."""
        first, last, tail = (one.full() for one in self._slopes(*self._arguments(path, ends, conditions)))
        whole = np.insert(tail, [1] * len(self.flow.unfolded), 0.0, axis=1)
        return replace(system, first=first, last=last, tail=whole)

    def _arguments(self, path: Path, ends: np.ndarray, conditions: Conditions) -> tuple[np.ndarray, ...]:
        tail = np.concatenate([path.tail[:1], path.tail[1 + len(self.flow.unfolded) :]])
        fixed = (conditions.shift, conditions.directions, conditions.reference, conditions.pins)
        return path.nodes[0], ends[-1], tail, *fixed


def _largest(rows: Rows) -> float:
    return max(float(np.abs(part).max(initial=0.0)) for part in rows)


def _turns(problem: Problem, shift: np.ndarray) -> np.ndarray:
    """Whole turns of each coordinate in one period (n) that a displacement stands for."""
    n = problem.model.degrees_of_freedom
    if problem.symmetry == "reversal":
        shift = 2 * (shift[n:] - shift[:n])
    return np.round(shift / (2 * np.pi) * (problem.symmetry in ("none", "reversal"))).astype(int)


def _checked(guess: Guess, size: int) -> Guess:
    state = np.asarray(guess.state, float)
    if state.shape != (size,) or not np.all(np.isfinite(state)):
        raise InputError(f"guess.state: need {size} finite numbers, got {state.tolist()}")
    if not (np.isfinite(guess.period) and guess.period > 0):
        raise InputError(f"guess.period: must be positive and finite, got {guess.period}; give a period in s")
    return guess
