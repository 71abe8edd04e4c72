"""Newton's method for a Loop: damped on a coarse mesh, then chord steps whose residual comes from ever finer ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self, TypeVar

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import Varied, divided
from orbitfinder.loops.condensed import Linearised, Solver, eliminated
from orbitfinder.loops.loop import NONE_SUCH, Loop, Unknowns, beyond
from orbitfinder.mechanics.scales import WIDE, snapped


@dataclass(frozen=True)
class NewtonSettings:
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


class Movable(Protocol):
    """Unknowns that a step over them moves."""

    def moved(self, step: np.ndarray) -> Self:
        """Their sum with a step."""


W = TypeVar("W", bound=Movable)

EVEN = WIDE**0.5
"""What changes by less than this is measured in 1."""


@dataclass(frozen=True)
class Units:
    """What a loop is measured in: states (d), the tail (T, s, free), the closing rows, and after those the guards."""

    state: np.ndarray
    tail: np.ndarray
    closing: np.ndarray
    guards: int = 0

    @classmethod
    def of(cls, loop: Loop, w: Unknowns, state: Sequence[float]) -> Units | None:
        """Those of a loop near w whose states are measured in `state` (d), or nowhere in anything but 1 where empty.

        A condition is measured in what a unit of the unknowns changes in it, if that is far from 1.
        """
        if not len(state):
            changes = np.linalg.norm(loop.slopes(w, loop.conditions), axis=1)
            if np.all((changes > 1 / EVEN) & (changes < EVEN)):
                return None
        size, free, known = w.nodes.shape[1], np.where(w.free == 0, 1.0, np.abs(w.free)), np.asarray(state, float)
        node = known if known.size else np.ones(size)
        clock = float(snapped(w.period / (2 * np.pi))) if known.size else 1.0
        columns = w.joined(node, clock, 1.0 / clock, snapped(free))
        rows = loop.row_units(w, columns)[(len(w.nodes) - 1) * size :]
        guards = loop.equations.links.count if loop.equations.links else 0
        closing, named = np.split(rows, [size + len(loop.normals)])
        rows = np.append(
            snapped(closing), snapped(named, 2.0 if guards else WIDE)
        )  # a machine's steps are damped by all
        return cls(node, np.concatenate([[clock], np.full(w.unfolding.size, 1.0 / clock), snapped(free)]), rows, guards)

    def rows(self, segments: int) -> np.ndarray:
        """Those of all rows."""
        return np.concatenate([np.tile(self.state, segments - 1), self.closing])

    def measured(self, system: Linearised) -> Linearised:
        """A linearised loop in these units."""
        state, cut, inner = self.state, self.closing.size - self.guards, system.inner
        closing, guards = self.closing[:cut, None], self.closing[cut:, None]
        if inner is not None:
            inner = inner[0], inner[1] * state / guards, inner[2] * self.tail / guards
        return Linearised(
            system.transitions * state / state[:, None],
            system.columns * self.tail / state[:, None],
            system.first * np.tile(state, system.first.shape[1] // state.size) / closing,
            system.last * state / closing,
            system.tail * self.tail / closing,
            inner,
        )


@dataclass(frozen=True)
class Refined(Shown):
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


class Newton:
    """One run of the iteration on a loop, in its units; counts its marches of states and of states and derivatives.

    `best` is the smallest norm of the rows on the way to the last digits.
    """

    def __init__(self, loop: Loop, settings: NewtonSettings, units: Units | None = None) -> None:
        self.loop, self.settings, self.units = loop, settings, units
        self.marches, self.jacobians, self.growth, self.best = 0, 0, 1.0, np.inf
        self._lost = NONE_SUCH

    def solve(self, w: Unknowns, path: Varied) -> tuple[Unknowns, float]:
        """w on the mesh that confirms it, and its largest row; `path` is w's first integration.

        Raises `ConvergenceError`.
        """
        self._lost = self.loop.lost(w)
        w, solver = self._approach(w, path)
        w, rows = self._finish(w, solver)
        return w, _largest(rows)

    def _approach(self, w: Unknowns, path: Varied | None) -> tuple[Unknowns, Solver]:
        """Damped steps on the coarse march until the residual is small."""
        chosen, before, step, factor = self.settings, w, np.zeros(0), 1.0
        for _ in range(chosen.most_evaluations):
            path = path or self._varied(w)
            rows = self._measured(w, path.ends) if path else np.full(1, np.inf)
            size = float(np.linalg.norm(rows))
            if path is not None and size < self.best:
                solver = self._solver(w, path)
                before, self.best, step = w, size, solver(rows)
                factor = 1.0 / max(1.0, abs(step[w.nodes.size]) / (chosen.largest_change * w.period))
                if size < chosen.handover and factor == 1.0:
                    return w.moved(step), solver
            elif not step.size:
                raise ConvergenceError("the motion from this guess gives no finite numbers; start elsewhere")
            else:
                factor /= 2
            w, path = before.moved(factor * step), None
        beyond = "start nearer" if self.loop.equations.links else "find_orbit reaches farther"
        raise ConvergenceError(
            f"warm refinement does not converge from this guess (residual {self.best:.2g}); {beyond}"
        )

    def _finish(self, w: Unknowns, solver: Solver) -> tuple[Unknowns, np.ndarray]:
        """Chord steps on ever finer marches until twice as many steps confirm the residual, then to round-off."""
        scale = max(1.0, float(np.abs(w.nodes if self.units is None else w.nodes / self.units.state).max()))
        rows = self._rows(w)
        for _ in range(self.settings.most_doublings):
            w, rows, solver = self._chord(w, rows, solver, self.settings.rough)
            w = replace(w, mesh=divided(w.mesh, 2))
            coarse, rows = rows, self._rows(w)
            if np.abs(rows - coarse).max() <= self.settings.agreement * scale:
                break
        floor = self.settings.floor * scale * max(10.0, self.growth)
        w, rows, _ = self._chord(w, rows, solver, floor)
        return w, rows

    def _chord(
        self, w: Unknowns, rows: np.ndarray, solver: Solver, target: float
    ) -> tuple[Unknowns, np.ndarray, Solver]:
        def renewed(w: Unknowns) -> Solver:
            self.jacobians += 1
            return self._solver(w, self.loop.equations.varied(w))

        return chord(w, rows, solver, (self._rows, renewed), target, self.settings)[:3]

    def _rows(self, w: Unknowns) -> np.ndarray:
        self.marches += 1
        return self._measured(w, self.loop.equations.ends(w))

    def _measured(self, w: Unknowns, ends: np.ndarray) -> np.ndarray:
        """The rows of w in their units."""
        rows = beyond(self.loop.rows(w, ends), self._lost)
        return rows if self.units is None else rows / self.units.rows(len(w.nodes))

    def _varied(self, w: Unknowns) -> Varied | None:
        """The integration of w, None where it fails."""
        self.jacobians += 1
        try:
            return self.loop.equations.varied(w)
        except IntegrationError:
            return None

    def _solver(self, w: Unknowns, path: Varied) -> Solver:
        system, units = self.loop.linearised(w, path), self.units
        if units is None:
            self.growth = max(1.0, float(np.abs(path.transitions).max()))
            return eliminated(system)
        system = units.measured(system)
        self.growth = max(1.0, float(np.abs(system.transitions).max()))
        step, columns = eliminated(system), np.concatenate([np.tile(units.state, len(w.nodes)), units.tail])
        return lambda rows: step(rows) * columns


def chord(
    w: W,
    rows: np.ndarray,
    solver: Solver,
    functions: tuple[Callable[[W], np.ndarray], Callable[[W], Solver]],
    target: float,
    settings: NewtonSettings,
    fresh: bool = False,
) -> tuple[W, np.ndarray, Solver, int]:
    """Steps with a fixed Jacobian, renewed where it no longer contracts, down to `target` or round-off; their number.

    `functions` give the rows and the solver of any unknowns; `fresh` says that this solver is that of w.
    """
    rows_of, solver_of = functions
    size, count = _largest(rows), 0
    for _ in range(settings.most_evaluations):
        if size <= target:
            break
        trial, count = w.moved(solver(rows)), count + 1
        found = rows_of(trial)
        smaller, slow = _largest(found) < size, _largest(found) > settings.contraction * size
        if not smaller and fresh:
            break  # nothing else leads on from here
        if smaller:
            w, rows, size, fresh = trial, found, _largest(found), False
        if slow and size < 1e3 * settings.agreement:
            break  # round-off
        if slow:
            solver, fresh = solver_of(w), True
    return w, rows, solver, count


def _largest(rows: np.ndarray) -> float:
    return float(np.abs(rows).max(initial=0.0))
