"""What can be followed: F(w) = 0 with one equation fewer than unknowns, whatever it describes.

A problem says its rows, what they change by, and what lengths along its solutions are measured in:

    <a, b> = sum_k m_k a_k b_k,    m the problem's metric over w

Where a symmetry moves solutions among themselves its phases are fixed, to those of the guess. One aim more closes it:
a plane across the tangent, or a quantity that has a value. Unknowns may have any units, of which the metric makes
lengths; rows are compared with 1. A continuation problem has, for unknowns w with their numbers `vector` and
`moved(step)`,

    settings                  of the corrector; `converged` is the largest row of a solution
    rows(w)                   F(w); raises `IntegrationError` or `ConvergenceError` where there is none
    linearise(w)              F(w) and its `Linear` derivatives, by one march where there is one
    phases(w)                 directions (k x w) that are kept across the symmetries at w
    metric(w)                 m over w, 0 for given entries
    value(w, name)            a quantity by name, which may be followed in or asked for
    aim(w, name, value)       how far a quantity is from a value, and the row of its derivatives over w
    at(w, tangent)            itself with the mesh and the scales of an accepted w, and w and its tangent there
    carried(w, onto)          w on the mesh of another
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any, Protocol

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.mechanics.newton import Solver, chord


class Linear(Protocol):
    """The derivatives of a problem's rows at some w."""

    def closed(self, rows: np.ndarray) -> Solver:
        """The step -A^-1 rows over w, A the derivatives with phases and an aim (k x w) as the last rows.

        Raises `ConvergenceError` where all is singular.
        """


@dataclass(eq=False)  # not frozen, which makes it in three times the time
class Point:
    """A solution, its tangent (over w, of length 1), its arclength, the next step's, the corrector's iterations.

    `critical` is the root that crosses where a point is an event of a spectrum.
    """

    problem: Any
    w: Any
    tangent: np.ndarray
    arclength: float = 0.0
    step: float = 0.0
    iterations: int = 0
    critical: complex | None = None

    def value(self, name: str) -> float:
        """A quantity by name."""
        return float(self.problem.value(self.w, name))

    @property
    def entry(self) -> dict[str, Any]:
        """The numbers of a solution that a journal keeps."""
        return {"w": self.w.vector, "tangent": self.tangent, "arclength": self.arclength, "step": self.step}

    @cached_property
    def sharp(self) -> Point:
        """The same with its tangent by the derivatives there, where the corrector's are those of a place nearby."""
        metric = self.problem.metric(self.w)
        rows = np.concatenate([self.problem.phases(self.w), (metric * self.tangent)[None]])
        known, linear = self.problem.linearise(self.w)
        tangent = _tangent(linear.closed(rows), known.size + len(rows), metric)
        return Point(self.problem, self.w, tangent, self.arclength, self.step, self.iterations)

    def inner(self, tangent: np.ndarray) -> float:
        """<tangent, another>, in this one's metric."""
        return float((self.problem.metric(self.w) * self.tangent) @ tangent)


Aim = Callable[[Any], tuple[float, np.ndarray]]


def plane(problem: Any, guess: Any, direction: np.ndarray) -> Aim:
    """The plane through a guess across a direction (over w)."""
    metric = problem.metric(guess)
    row, origin = metric * direction, guess.vector
    row /= sqrt(float(direction @ row))
    return lambda w: (float(row @ (w.vector - origin)), row)


def solved(problem: Any, guess: Any, aim: Aim) -> Point:
    """The solution near a guess that an aim picks, with the tangent there, along which the aim grows.

    Raises `ConvergenceError` or `IntegrationError`.
    """
    phases, origin = problem.phases(guess), guess.vector

    def closed(w: Any, rows: np.ndarray) -> np.ndarray:
        whole = np.empty(rows.size + len(phases) + 1)
        whole[: rows.size], whole[-1] = rows, aim(w)[0]
        if len(phases):
            whole[rows.size : -1] = phases @ (w.vector - origin)
        return whole

    def solver(w: Any, linear: Linear) -> Solver:
        return linear.closed(np.concatenate([phases, aim(w)[1][None]]))

    rows, linear = problem.linearise(guess)
    functions = (lambda w: closed(w, problem.rows(w)), lambda w: solver(w, problem.linearise(w)[1]))
    start = closed(guess, rows), solver(guess, linear)
    root = chord(guess, *start, functions, problem.settings, lambda w, step: w.moved(step), fresh=True)
    if not root.converged:
        raise ConvergenceError(f"the corrector stalled at rows of {root.size:.2g} after {root.count} steps")
    tangent = _tangent(root.solver, root.rows.size, problem.metric(root.w))
    return Point(problem, root.w, tangent, iterations=root.count)


def _tangent(solver: Solver, rows: int, metric: np.ndarray) -> np.ndarray:
    """The tangent of length 1 along which the last of so many rows grows."""
    last = np.zeros(rows)
    last[-1] = -1.0
    tangent = solver(last)
    return tangent / sqrt(float(tangent @ (metric * tangent)))
