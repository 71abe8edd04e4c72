"""Harmonic balance by collocation for motions that start at rest and pass q = 0 after a quarter period.

Such a motion is a series of odd cosines, q(t) = sum_j c_j cos((2 j + 1) w t), j = 0 .. N - 1. Asking for
q'' = a(q, q') at the N times w t_k = (2 k + 1) pi / (4 N) and for one pin makes N n + 1 equations in
(c, w). Nothing is integrated: a mode that is faster than the last harmonic is slaved to the slow
ones, where shooting would follow hundreds of its oscillations. The family of the linear mode that a guess
resembles most is followed up to the pin; shooting starts from there. Source: Z. Yan, H. Dai, Q. Wang,
S. N. Atluri, "Harmonic Balance Methods: A Review and Recent Developments", CMES 137 (2023)
1419-1459 (the time-domain form, whose aliased solutions shooting must sort out afterwards).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, LinAlgWarning, solve

from orbitfinder.continuation.follow import Known, Pace, reached
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.integrate.equations import linearised
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.conditions import Pin, pinned
from orbitfinder.loops.loop import Equations, Loop
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import QUARTER
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.mechanics.newton import Settings, stepped
from orbitfinder.orbits.guesses.modes import normal_modes

Accelerations = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""(q, v) -> a (n), da/dq, da/dv (n x n each)"""
Stepper = Callable[["Series", "PinRow"], np.ndarray]
"""Newton's step of coefficients and frequency (N n + 1); raises `LinAlgError` where there is none"""
PinRow = Callable[[np.ndarray, float], tuple[float, np.ndarray, float]]
"""(q(0), T) -> residual of the pin and its derivatives in q(0) (n) and in T, for a start at rest"""

NEWTON = Settings(floor=1e-9, converged=1e-9, most_evaluations=8, farthest=np.pi)
"""Of steps, rad (or m) and rad/s"""
TAIL = 1e-3
"""Harmonics are doubled until the last quarter of them is below this, rad (or m)"""
FINE_TAIL = 1e-5
MOST_UNKNOWNS = 3200
"""N n stays below this: a dense matrix has its square of entries, 82 MB"""
FEWEST = 6
LARGEST_CORRECTION = 0.2
"""A step is halved where Newton moves a coefficient further than this from the prediction"""
SMALLEST_STEP, FIRST_STEP, LARGEST_STEP = 1e-3, 0.1, 0.5
QUICK = 4
"""Newton iterations up to which the next step is larger"""
GROWTHS = (1.7, 1.4, 1.2)
"""Growths of the steps along the family, tried in turn: a resonance that stops one is stepped over by another."""


@dataclass(frozen=True)
class Series:
    """Odd cosine coefficients (N x n, rad or m) and the frequency w (rad/s)."""

    coefficients: np.ndarray
    frequency: float

    @property
    def period(self) -> float:
        """T = 2 pi / w in s."""
        return 2 * np.pi / self.frequency

    @property
    def start(self) -> np.ndarray:
        """q(0) (n), where the motion is at rest."""
        return np.asarray(self.coefficients.sum(axis=0))

    @property
    def nodal(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What takes the coefficients to q, q' and q'' at the nodes (N x N each)."""
        orders, w = 2 * np.arange(len(self.coefficients)) + 1, self.frequency
        angles = np.outer(orders, orders) * np.pi / (4 * orders.size)
        cosines = np.cos(angles)
        return cosines, -w * (orders * np.sin(angles)), -(w**2) * (cosines * orders**2)

    @property
    def tail(self) -> float:
        """Largest coefficient in the last quarter of the harmonics."""
        count = len(self.coefficients)
        return float(np.abs(self.coefficients[count - max(1, count // 4) :]).max())

    def padded(self, count: int) -> Series:
        """The same motion with `count` harmonics."""
        more = np.zeros((count - len(self.coefficients), self.coefficients.shape[1]))
        return Series(np.vstack([self.coefficients, more]), self.frequency)

    def moved(self, step: np.ndarray) -> Series:
        """The same after a step of the coefficients and of the frequency."""
        shape = self.coefficients.shape
        return Series(self.coefficients + step[:-1].reshape(shape), self.frequency + float(step[-1]))

    def towards(self, other: Series, factor: float) -> Series:
        """The point at `factor` on the straight line through this (0) and another (1)."""
        count = max(len(self.coefficients), len(other.coefficients))
        mine, its = self.padded(count), other.padded(count)
        return Series(
            mine.coefficients + factor * (its.coefficients - mine.coefficients),
            mine.frequency + factor * (its.frequency - mine.frequency),
        )


def correct(series: Series, newton: Stepper, pin: PinRow, settings: Settings = NEWTON) -> tuple[Series, int] | None:
    """Newton's method from a prediction: the solution and its iterations, or None where it does not converge."""

    def step(series: Series) -> np.ndarray:
        try:
            moved = newton(series, pin) if series.frequency > 0 else None
        except (LinAlgError, LinAlgWarning):
            moved = None
        return np.full(series.coefficients.size + 1, np.nan) if moved is None else moved

    solved = stepped(series, step, settings, Series.moved)
    return (solved.w, solved.count) if solved.converged else None


def dense(accelerations: Accelerations) -> Stepper:
    """Newton's steps by the matrix of all rows q'' - a(q, q') at the nodes and the pin's."""

    def step(series: Series, pin: PinRow) -> np.ndarray:
        matrix, rows = _system(series, accelerations, pin)
        if not (np.all(np.isfinite(rows)) and np.all(np.isfinite(matrix))):
            raise LinAlgError("rows that are no numbers")
        return np.asarray(solve(matrix.T, -rows, overwrite_a=True, check_finite=False, transposed=True))

    return step


def _system(series: Series, accelerations: Accelerations, pin: PinRow) -> tuple[np.ndarray, np.ndarray]:
    """The Newton matrix (N n + 1 square) and the residuals q'' - a(q, q') at the nodes, then the pin's."""
    count, n = series.coefficients.shape
    place, rate, bend = series.nodal
    q, v, curved = (part @ series.coefficients for part in series.nodal)
    matrix, rows = np.zeros((count * n + 1, count * n + 1)), np.zeros(count * n + 1)
    blocks = matrix[:-1, :-1].reshape(count, n, count, n)
    diagonal = np.arange(n)
    for k in range(count):
        a, by_place, by_rate = accelerations(q[k], v[k])
        rows[k * n : (k + 1) * n] = curved[k] - a
        for j in range(count):
            block = blocks[k, :, j, :]
            block[...] = -rate[k, j] * by_rate - place[k, j] * by_place
            block[diagonal, diagonal] += bend[k, j]
        matrix[k * n : (k + 1) * n, -1] = (2 * curved[k] - by_rate @ v[k]) / series.frequency
    rows[-1], by_start, by_period = pin(series.start, series.period)
    matrix[-1, :-1] = np.tile(by_start, count)
    matrix[-1, -1] = -by_period * series.period / series.frequency
    return matrix, rows


def resolved(series: Series, newton: Stepper, pin: PinRow, tail: float) -> tuple[Series, int] | None:
    """The solution with as many harmonics as its tail asks for (or the memory allows); iterations of the first."""
    solved = correct(series, newton, pin)
    first = None if solved is None else solved[1]
    most = max(FEWEST, MOST_UNKNOWNS // series.coefficients.shape[1])
    while solved is not None and solved[0].tail > tail and len(solved[0].coefficients) < most:
        solved = correct(solved[0].padded(min(2 * len(solved[0].coefficients), most)), newton, pin)
    return None if solved is None or first is None else (solved[0], first)


def follow(
    start: Series,
    newton: Stepper,
    pin: Callable[[float], PinRow],
    report: Callable[[float, Series], None],
    growth: float,
) -> Series | None:
    """The solution at the full pin, pin(1), from a small one predicted at pin(FIRST_STEP); None where it is lost.

    Steps in the fraction of the pin grow by `growth` while Newton is quick and are halved where it is slow or
    goes far from its prediction, the secant through the last two solutions. Internal resonances on
    the way, where the family is a gap of exponentially small width, are stepped over.
    """
    known = [(0.0, start.padded(max(FEWEST, len(start.coefficients))))]

    def corrected(fraction: float) -> tuple[Series, int]:
        guess = _predicted(known, fraction)
        solved = resolved(guess, newton, pin(fraction), TAIL)
        if solved is None or not near(guess, solved[0]):
            raise ConvergenceError("the family is lost")
        report(fraction, solved[0])
        return solved

    try:
        pace = Pace(FIRST_STEP, SMALLEST_STEP, LARGEST_STEP, quick=QUICK, growth=growth)
        series = reached(known, 1.0, corrected, pace)
        fine = resolved(series, newton, pin(1.0), FINE_TAIL)
        return series if fine is None else fine[0]
    except ConvergenceError:
        return None


def near(guess: Series, series: Series) -> bool:
    """True when no coefficient is further than LARGEST_CORRECTION from its prediction."""
    count = len(series.coefficients)
    return bool(np.abs(series.coefficients - guess.padded(count).coefficients).max() < LARGEST_CORRECTION)


def _predicted(known: Known[Series], fraction: float) -> Series:
    """On the secant through the last two; where one of them is rest, at the frequency of the other."""
    (first, before), (second, other) = known[0], known[-1]
    if not first:
        return replace(other, coefficients=other.coefficients * (fraction / (second or FIRST_STEP)))
    return before.towards(other, (fraction - first) / (second - first))


def balanced_guess(problem: Problem) -> Guess | None:
    """Rest state and period near the orbit; None for a problem of another kind or a family that is lost on the way."""
    if not suits(problem):
        return None
    try:
        squared, shapes = normal_modes(problem.model)
    except InputError:  # q = 0 is no equilibrium
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        series = along_family(
            problem, squared, shapes, dense(linearised(problem.model)), pins(Equations(problem.model, QUARTER))
        )
    return None if series is None else Guess(np.append(series.start, np.zeros(series.start.size)), series.period)


def suits(problem: Problem) -> bool:
    """True for brake and reflection symmetric motions of a conservative model from a guess at rest, with one pin."""
    model, n = problem.model, problem.model.degrees_of_freedom
    plain = model.conservative and not model.forced and model.constraint is None and model.gyroscopic is None
    return (
        plain
        and model.forces is None
        and only_pinned(problem)
        and problem.pin[0].name in ("energy", "period", *model.state_names[:n])
        and not np.any(problem.guess.start[n:])
        and bool(np.any(problem.guess.start[:n]))
    )


def only_pinned(problem: Problem) -> bool:
    """True where a brake and reflection symmetric motion near a state is asked for by one pin and nothing else."""
    chosen = problem.free or problem.bounds or problem.constraints or problem.objective != "nearest"
    symmetric = problem.boundary == QUARTER and problem.phase_condition is None
    named = [pin.name in ("energy", "period", *problem.model.state_names) for pin in problem.pin]
    return symmetric and not chosen and problem.guess.states is None and named == [True]


def pins(equations: Equations) -> Callable[[Pin], PinRow]:
    """A pin's residual at rest and its derivatives in q(0), T, as a NumPy function for each pin."""
    n, mesh = equations.model.degrees_of_freedom, uniform(QUARTER.fraction, 1, 1)

    def made(pin: Pin) -> PinRow:
        conditions = (pinned(equations, pin.name, pin.value),)
        loop = Loop(equations, np.zeros(equations.size), conditions)

        def row(place: np.ndarray, period: float) -> tuple[float, np.ndarray, float]:
            w = equations.unknowns(np.append(place, np.zeros(n))[None], period, mesh)
            slopes = loop.slopes(w, conditions)[0]
            return float(loop.values(w, conditions)[0]), slopes[:n], float(slopes[2 * n])

        return row

    return made


def along_family(
    problem: Problem,
    squared: np.ndarray,
    shapes: np.ndarray,
    newton: Stepper,
    pinned: Callable[[Pin], PinRow],
    report: Callable[[float, Series], None] = lambda *_: None,
) -> Series | None:
    """The orbit that a problem pins in the family of the linear mode nearest to its guess, None where it is lost.

    On the way the pin has its value at rest plus the fraction (squared for the energy) of the rest of it. The period
    tells nothing near the linear mode, so the guess's largest coordinate takes its place.
    """
    model, pin, start = problem.model, problem.pin[0], problem.guess.start[: len(shapes)]
    linear = _linear(model, pin, start, squared, shapes)
    followed, rest, power = pin, 0.0, 1
    if pin.name == "period":
        largest = int(np.abs(start).argmax())
        followed = Pin(model.state_names[largest], float(start[largest]))
    if pin.name == "energy":
        rest, power = energy(model, np.zeros(2 * start.size)), 2

    def at(fraction: float) -> PinRow:
        return pinned(replace(followed, value=rest + fraction**power * (followed.value - rest)))

    if linear is None:
        return None
    for growth in GROWTHS:
        series = follow(linear, newton, at, report, growth)
        if series is not None and pin.name == "period":
            again = resolved(series, newton, pinned(pin), FINE_TAIL)
            series = None if again is None else again[0]
        if series is not None:
            return series
    return None


def _linear(model: Model, pin: Pin, start: np.ndarray, squared: np.ndarray, shapes: np.ndarray) -> Series | None:
    """The linear mode that moves most in the guess, at the first step of the way; None where it does not oscillate."""
    shares = np.linalg.solve(shapes, start)
    mode = int(np.abs(shares * np.abs(shapes).max(axis=0)).argmax())
    if not squared[mode] > 0:
        return None
    shape = shapes[:, mode] * shares[mode]
    index = model.state_index(pin.name) if pin.name in model.state_names else None
    factor = pin.value / shape[index] if index is not None and shape[index] else 1.0
    return Series(FIRST_STEP * factor * shape[None, :], float(np.sqrt(squared[mode])))
