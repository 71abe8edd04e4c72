"""Newton's method, for whatever is F(w) = 0: whole steps, chord steps, halved and damped ones, with one stop rule.

Any w will do that a step moves; what its rows and steps are measured in is the caller's, so that they compare with 1.
An iteration ends where what is left is below `floor`, or below `round_off` and no longer contracts, and has
succeeded where it is below `converged`. The file knows no loop and no model; it lies on this floor as the lowest that
solves anything: mechanisms are closed here. Source: J. Nocedal, S. Wright, Numerical Optimization (2006), chapter 11.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, nan
from typing import Any, Generic, TypeVar, cast

import numpy as np
from scipy.linalg.lapack import dgelsd, dgelsd_lwork
from scipy.optimize import minimize

from orbitfinder._runtime import limit

W = TypeVar("W")
Solver = Callable[[np.ndarray], np.ndarray]
"""Rows -> the step that would remove them"""


@dataclass(frozen=True)
class Settings:
    """When an iteration ends, and how far its steps go."""

    floor: float = 1e-13
    """what may be left of equations that are solved"""
    round_off: float = 1e-9
    """what is left below this and no longer contracts is round-off"""
    converged: float = 1e-9
    """more that is left at the end is a failure"""
    contraction: float = 0.1
    """a step that leaves a larger share no longer contracts; a chord's asks for a new Jacobian"""
    most_evaluations: int = 50
    longest: float = np.inf
    """entry of a step that is taken: longer ones are shortened"""
    farthest: float = np.inf
    """more that is left leads nowhere"""
    patience: int = 1000
    """evaluations one after another that leave more than the share `progress` of the least so far"""
    progress: float = 0.5
    shortest: float = 1e-5
    """share of a damped step below which it leads nowhere"""
    halving: bool = False
    """a step that leaves as much or more, or no numbers, is taken back and halved"""
    cutoff: float = 1e-12
    """singular values below this share of the largest are taken for 0"""

    def ended(self, left: float, before: float) -> bool:
        """Whether so much left, after so much before, ends the iteration: the stop rule."""
        return left <= self.floor or (left <= self.round_off and left > self.contraction * before)


@dataclass(frozen=True)
class Solved(Generic[W]):
    """What an iteration ended with: w, its rows and their size, the solver there, the evaluations it took."""

    w: W
    settings: Settings
    rows: np.ndarray = field(default_factory=lambda: np.zeros(0))
    size: float = np.inf
    solver: Solver = np.negative
    count: int = 0

    @property
    def converged(self) -> bool:
        """Whether what is left is as little as was asked for."""
        return self.size <= self.settings.converged


def largest(rows: np.ndarray) -> float:
    """The largest of some rows, which an iteration is judged by; nan where they are."""
    return float(np.abs(rows).max(initial=0.0))


def least_squares(slopes: np.ndarray, cutoff: float = Settings.cutoff) -> Solver:
    """What gives for rows the shortest x that leaves least of slopes x - rows, by LAPACK itself.

    NumPy's way to it takes as long again. Raises `LinAlgError` where the singular values do not converge.
    """
    count, size = slopes.shape
    work, whole, _ = dgelsd_lwork(count, size, 1)

    def solve(rows: np.ndarray) -> np.ndarray:
        right = np.zeros(max(count, size))
        right[:count] = rows
        answer, _, _, fault = dgelsd(slopes, right, int(work), whole, cutoff, overwrite_b=True)
        if fault:
            raise np.linalg.LinAlgError("the singular values do not converge")
        return np.asarray(answer[:size])

    return solve


def least_norm(slopes: np.ndarray, rows: np.ndarray, cutoff: float = Settings.cutoff) -> np.ndarray:
    """The shortest step that removes rows, or leaves least of them; nan where they are no numbers."""
    if not isfinite(float(rows.sum()) + float(slopes.sum())):
        return np.full(slopes.shape[1], np.nan)  # LAPACK may never return from them
    return least_squares(slopes, cutoff)(-rows)


def full(
    w: W,
    linearised: Callable[[W], tuple[np.ndarray, Solver]],
    settings: Settings = Settings(),
    moved: Callable[[Any, np.ndarray], Any] = np.add,
    measure: Callable[[np.ndarray], float] = largest,
    final: bool = False,
) -> Solved[W]:
    """Whole steps, each with the derivatives where it begins: `linearised(w)` gives the rows and what solves for them.

    Rows that are not finite end it. The answer is the best w, or the `final`.
    """
    course = stepping(w, settings, moved, measure, final)
    try:
        at = next(course)
        while True:
            at = course.send(linearised(at))
    except StopIteration as end:
        return cast(Solved[W], end.value)


def stepping(
    w: W, settings: Settings, moved: Callable[[Any, np.ndarray], Any] = np.add,
    measure: Callable[[np.ndarray], float] = largest, final: bool = False,
) -> Generator[W, tuple[np.ndarray, Solver], Solved[W]]:  # fmt: skip
    """The same as a course that yields w and is sent its rows and what solves for them."""
    best, last, idle, share = Solved(w, settings), np.inf, 0, 1.0
    for count in range(1, settings.most_evaluations + 1):
        limit.check()
        rows, solver = yield w
        size = measure(rows)
        idle = idle + 1 if size > settings.progress * best.size else 0
        if size < best.size or final:
            best, share = Solved(w, settings, rows, size, solver, count), 1.0
        elif settings.halving and best.count:
            share, size = share / 2, best.size
        spent = idle > settings.patience or count == settings.most_evaluations
        if settings.ended(size, last) or spent or not size < settings.farthest:
            break
        if share == 1.0:
            begin, step, last = w, solver(rows), size
            length = largest(step)
            step = step if length <= settings.longest else step * (settings.longest / length)
        w = moved(begin, step if share == 1.0 else share * step)
    return best


def stepped(
    w: W,
    step: Callable[[W], np.ndarray],
    settings: Settings = Settings(),
    moved: Callable[[Any, np.ndarray], Any] = np.add,
    measure: Callable[[np.ndarray], float] = largest,
) -> Solved[W]:
    """The same for equations without a size of their own: judged by the steps, the last of which is taken too."""
    solved = full(w, lambda w: (step(w), np.positive), settings, moved, measure, True)
    return replace(solved, w=moved(solved.w, solved.rows)) if solved.converged else solved


def chord(
    w: W,
    rows: np.ndarray,
    solver: Solver,
    functions: tuple[Callable[[W], np.ndarray], Callable[[W], Solver]],
    settings: Settings,
    moved: Callable[[Any, np.ndarray], Any],
    fresh: bool = False,
) -> Solved[W]:
    """Steps with a fixed Jacobian, renewed where it no longer contracts.

    `functions` give the rows and the solver of any w; `fresh` says that this solver is that of w.
    """
    course = chording(w, rows, solver, settings, moved, fresh)
    try:
        renewed, at = next(course)
        while True:
            renewed, at = course.send(functions[renewed](at))
    except StopIteration as end:
        return cast(Solved[W], end.value)


def chording(
    w: W, rows: np.ndarray, solver: Solver, settings: Settings, moved: Callable[[Any, np.ndarray], Any],
    fresh: bool = False,
) -> Generator[tuple[bool, W], Any, Solved[W]]:  # fmt: skip
    """The same as a course that yields (False, w) for the rows of w, (True, w) for its solver, and is sent these."""
    size, count = largest(rows), 0
    while count < settings.most_evaluations and size > settings.floor:
        trial, before, count = moved(w, solver(rows)), size, count + 1
        found = yield False, trial
        left = largest(found)
        slow = left > settings.contraction * before
        if left < before:
            w, rows, size, fresh = trial, found, left, False
        elif fresh:
            break  # nothing else leads on from here
        if settings.ended(size, before):
            break
        if slow:
            solver, fresh = (yield True, w), True
    return Solved(w, settings, rows, size, solver, count)


def natural(
    w: W,
    linearised: Callable[[W], tuple[np.ndarray, Solver]],
    rows_of: Callable[[W], np.ndarray],
    settings: Settings,
    moved: Callable[[Any, np.ndarray], Any],
    units: np.ndarray,
) -> Solved[W]:
    """Damped steps that are judged by what they leave to correct, in `units`, by the Jacobian where they began.

    That sees how far a solution is, where rows are large a short way from it and small along valleys.

    Source: P. Deuflhard, Newton Methods for Nonlinear Problems (2004), section 3.3 (NLEQ-ERR).
    """
    share, count = 1.0, 0
    while True:
        rows, solver = linearised(w)
        step = solver(rows)
        length = float(np.linalg.norm(step / units))
        here = Solved(w, settings, rows, length, solver, count)
        if not isfinite(length) or length <= settings.converged or count > settings.most_evaluations:
            return here
        while True:
            limit.check()
            count, trial = count + 1, moved(w, share * step)
            after = solver(rest := rows_of(trial))
            left = float(np.linalg.norm(after / units))
            if left <= settings.converged or (share == 1.0 and settings.ended(left, length)):
                return Solved(trial, settings, rest, left, solver, count)
            bent = float(np.linalg.norm((after - (1 - share) * step) / units))
            best = 0.5 * share**2 * length / bent if bent else 1.0
            if left <= (1 - share / 4) * length:
                break
            share = min(max(best, share / 10), share / 2) if isfinite(best) else share / 10
            if share < settings.shortest:
                return here
        w, share = trial, min(1.0, best)


CLOSING = Settings(floor=0.0, round_off=1e-13, converged=1e-11, most_evaluations=80, longest=0.4)
"""How a mechanism is closed: gaps relative to its size, steps in rad or shares of that"""


def closed(
    phi: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    q: np.ndarray,
    loose: Sequence[int] | None = None,
    units: np.ndarray | float = 1.0,
    size: float = 0.0,
    settings: Settings = CLOSING,
) -> Solved[np.ndarray]:
    """Coordinates near q (n) at which phi = 0: the shortest steps in their units, of the `loose` ones (default: all).

    `phi(q)` gives gaps and their slopes; gaps are measured in the largest slope, at least in `size`.
    """
    measures = np.zeros(q.size)
    measures[range(q.size) if loose is None else loose] = 1.0
    measures *= units

    def linearised(q: np.ndarray) -> tuple[np.ndarray, Solver]:
        nonlocal size
        gaps, slopes = phi(q)
        slopes = slopes * measures
        steep = largest(slopes)
        size = max(size, steep) if isfinite(steep) else nan
        return gaps / size, lambda _: least_squares(slopes, settings.cutoff)(-gaps)

    return full(q, linearised, settings, lambda q, step: q + measures * step)


RESTING = Settings(floor=1e-14, round_off=1e-12, converged=1e-12, most_evaluations=60)
"""How an equilibrium is found: steps in units of its coordinates"""


def equilibrium(
    linearised: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    x: np.ndarray,
    units: np.ndarray | float = 1.0,
    settings: Settings = RESTING,
) -> Solved[np.ndarray]:
    """A zero of f near x (n): `linearised(x)` gives f and its slopes, of which the first n columns are by x."""

    def step(x: np.ndarray) -> np.ndarray:
        rows, slopes = linearised(x)
        columns = np.hstack([slopes[:, : x.size] * units, slopes[:, x.size :]])
        return least_norm(columns, rows, settings.cutoff)[: x.size]

    return stepped(x, step, settings, lambda x, step: x + units * step)


def descended(value: Callable[[np.ndarray], float], q: np.ndarray, **how: Any) -> tuple[np.ndarray, float, float]:
    """Where the way down from q (n) ends, the value there, the largest slope left; `how` is for SciPy's minimize."""
    result = minimize(value, q, **how)
    return np.asarray(result.x), float(result.fun), largest(result.jac)
