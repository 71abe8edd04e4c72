"""Newton's method for a Loop: halved on a coarse mesh, then chord steps whose residual comes from ever finer ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from typing import Protocol

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import Varied, divided
from orbitfinder.loops.condensed import eliminated
from orbitfinder.loops.loop import Loop, Unknowns, beyond
from orbitfinder.loops.scales import Measures
from orbitfinder.mechanics.newton import Settings, Solved, Solver, chord, full, natural


@dataclass(frozen=True)
class NewtonSettings(Settings):
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
    rough: float = 1e-10
    """residual to which the march that is still to be confirmed is driven"""
    agreement: float = 4e-12
    """two step sizes must agree to this, times the states; the finer is then some 2^8 times better than that"""
    floor: float = 1e-15
    """residual, times the states and the largest entry of Phi (at least 10), below which all is round-off"""
    round_off: float = 4e-9
    converged: float = 1e-8
    most_evaluations: int = 30
    most_doublings: int = 7

    @cached_property
    def approach(self) -> NewtonSettings:
        """Those of the halved steps on the coarse march."""
        return replace(self, floor=self.handover, converged=self.handover, halving=True)


@dataclass(frozen=True)
class Refined(Shown):
    """A refined orbit: state (2n), period (s), nodes (N x 2n), unfolding, freed parameters, turns (n), residual.

    `residual` is the largest row of the shooting equations by a march of `steps` Runge-Kutta steps per segment, on the
    `mesh` where they are not equal; `marches` and `jacobians` are what it took.
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
    mesh: np.ndarray | None = None


class Integrating(Protocol):
    """Whoever integrates all segments of a loop."""

    def varied(self, w: Unknowns) -> Varied:
        """With derivatives."""

    def ends(self, w: Unknowns) -> np.ndarray:
        """Without (N x d)."""


class Newton:
    """One run of the iteration on a loop, as measured; counts its marches of states and of states and derivatives.

    `best` is the smallest norm of the rows on the way to the last digits.
    """

    def __init__(self, loop: Loop, settings: NewtonSettings, measures: Measures) -> None:
        self.loop, self.settings, self.measures = loop, settings, measures
        self.marches, self.jacobians, self.growth, self.best = 0, 0, 1.0, np.inf
        self._lost = np.zeros(0)

    def solve(self, w: Unknowns, path: Varied) -> tuple[Unknowns, float]:
        """w on the mesh that confirms it, and its largest row; `path` is w's first integration.

        Raises `ConvergenceError`.
        """
        self._lost = self.loop.lost(w)
        w, solver = self._approach(w, path)
        return self._finish(w, solver)

    def near(self, w: Unknowns, by: Integrating | None = None) -> Solved[Unknowns]:
        """Where damped steps lead that are judged by their corrections, by whoever integrates (default: the equations
        themselves), and ends better than derivatives. Raises `IntegrationError`."""
        self._lost, march = self.loop.lost(w), by or self.loop.equations

        def linearised(w: Unknowns) -> tuple[np.ndarray, Solver]:
            self.jacobians += 1
            path = march.varied(w)
            return self._measured(w, march.ends(w) if by else path.ends), self._solver(w, path)

        def rows_of(w: Unknowns) -> np.ndarray:
            self.marches += 1
            try:
                return self._measured(w, march.ends(w))
            except IntegrationError:
                return np.full(self.measures.rows.size, np.inf)

        return natural(w, linearised, rows_of, self.settings, Unknowns.moved, self.measures.columns)

    def _approach(self, w: Unknowns, path: Varied | None) -> tuple[Unknowns, Solver]:
        """Halved steps on the coarse march until the residual is small."""
        chosen, paths, solvers = self.settings, [path], []

        def linearised(w: Unknowns) -> tuple[np.ndarray, Solver]:
            path = paths.pop() if paths else self._varied(w)
            rows = self._measured(w, path.ends) if path else np.full(1, np.inf)
            size = _length(rows)
            if path is None or not size < self.best:
                return rows, np.negative
            self.best = size
            solver = self._solver(w, path)

            def shortened(rows: np.ndarray) -> np.ndarray:
                step = solver(rows)
                return step / max(1.0, abs(float(step[w.nodes.size])) / (chosen.largest_change * w.period))

            solvers.append(solver)
            return rows, shortened

        solved = full(w, linearised, chosen.approach, Unknowns.moved, _length)
        if solved.converged:
            return solved.w.moved(solved.solver(solved.rows)), solvers[-1]
        if not solved.rows.size:
            raise ConvergenceError("the motion from this guess gives no finite numbers; start elsewhere")
        beyond = "start nearer" if self.loop.equations.links else "find_orbit reaches farther"
        raise ConvergenceError(
            f"warm refinement does not converge from this guess (residual {self.best:.2g}); {beyond}"
        )

    def _finish(self, w: Unknowns, solver: Solver) -> tuple[Unknowns, float]:
        """Chord steps on ever finer marches until twice as many steps confirm the residual, then to round-off."""
        cut = w.nodes.size
        scale = max(1.0, float(np.abs(w.vector[:cut] / self.measures.columns[:cut]).max()))
        rows = self._rows(w)
        rough = replace(self.settings, floor=self.settings.rough)  # for a march that is still to be confirmed
        for _ in range(self.settings.most_doublings):
            solved = self._chord(w, rows, solver, rough)
            solver, coarse = solved.solver, solved.rows
            w = solved.w.on(divided(solved.w.mesh, 2))
            rows = self._rows(w)
            if np.abs(rows - coarse).max() <= self.settings.agreement * scale:
                break
        floor = self.settings.floor * scale * max(10.0, self.growth)
        solved = self._chord(w, rows, solver, replace(self.settings, floor=floor))
        return solved.w, solved.size

    def _chord(self, w: Unknowns, rows: np.ndarray, solver: Solver, settings: Settings) -> Solved[Unknowns]:
        def renewed(w: Unknowns) -> Solver:
            self.jacobians += 1
            return self._solver(w, self.loop.equations.varied(w))

        return chord(w, rows, solver, (self._rows, renewed), settings, Unknowns.moved)

    def _rows(self, w: Unknowns) -> np.ndarray:
        self.marches += 1
        return self._measured(w, self.loop.equations.ends(w))

    def _measured(self, w: Unknowns, ends: np.ndarray) -> np.ndarray:
        """The rows of w in their units."""
        return np.asarray(beyond(self.loop.rows(w, ends), self._lost) / self.measures.rows)

    def _varied(self, w: Unknowns) -> Varied | None:
        """The integration of w, None where it fails."""
        self.jacobians += 1
        try:
            return self.loop.equations.varied(w)
        except IntegrationError:
            return None

    def _solver(self, w: Unknowns, path: Varied) -> Solver:
        system = self.measures.linearised(self.loop.linearised(w, path))
        self.growth = max(1.0, float(np.abs(system.transitions).max()))
        step = eliminated(system)
        return lambda rows: step(rows) * self.measures.columns


def _length(rows: np.ndarray) -> float:
    """Their norm, infinite where it overflows, of which NumPy's own function takes three times as long."""
    with np.errstate(over="ignore"):  # as of a guess that a march leaves the numbers from
        return sqrt(rows @ rows)
