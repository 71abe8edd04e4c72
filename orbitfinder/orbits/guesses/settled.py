"""Where a motion settles: a simulation by BDF until it comes back to itself, for starts of stiff systems."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from orbitfinder._runtime import limit
from orbitfinder._runtime.quiet import captured
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.follow import zero
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.equations import acceleration_slopes, accelerations
from orbitfinder.integrate.field import rates_of, vector_field
from orbitfinder.integrate.march import divided
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.model import Model, wrapped

RELATIVE, ABSOLUTE = 1e-10, 1e-12
"""Tolerances of the simulation, the second in extents of the motion"""
BACK, NEAR = 1e-3, 0.1
"""A motion has come back when it is this near, in extents, to where it was; a guess that comes as near is a cycle"""
STILL, BETWEEN = 1e-4, 6
"""Share of what a motion has moved at most that is none; samples of a lap in each step of its simulation"""
LAPS, LONGEST = 12, 2.0
"""Guessed periods after which what has not come back does not, and how long a period may be"""


@dataclass(frozen=True)
class Settling:
    """A simulated motion: its steps (k), the states there (k x d), and states at any times between."""

    times: np.ndarray
    states: np.ndarray
    at: Callable[[np.ndarray], np.ndarray]


def simulated(model: Model, state: np.ndarray, duration: float, units: np.ndarray | None = None) -> Settling:
    """The motion from a state (d) for a time, by BDF where it is stiff (LSODA), measured in `units` (d).

    Raises `IntegrationError` where it cannot be integrated.
    """
    field, slopes = vector_field(accelerations(model)), acceleration_slopes(model)
    size = np.where(state != 0.0, np.abs(state), np.abs(state).max(initial=0.0) or 1.0) if units is None else units

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        limit.check()
        return field(t, x * size) / size

    with np.errstate(all="ignore"), captured():  # without the slopes, a stiff field is taken for none
        solution = solve_ivp(
            rate, (0.0, duration), state / size, method="LSODA", rtol=RELATIVE, atol=ABSOLUTE, dense_output=True,
            jac=lambda t, x: np.asarray(slopes(t, x * size)) * size / size[:, None],
        )  # fmt: skip
    if not solution.success or not np.isfinite(solution.y).all():
        raise IntegrationError("the motion cannot be simulated", time=float(solution.t[-1]), state=state)
    return Settling(solution.t, solution.y.T * size, lambda times: solution.sol(times).T * size)


def cycles(model: Model, guess: Guess, own: Guess, stiff: bool) -> Iterator[Guess]:
    """Guesses whose trajectories are a lap of a cycle: its `own` (see `lap`) where that is given, or comes near its
    start and is not stiff, so that its jumps are where they belong, and then what it settles on.

    Raises `ConvergenceError` where it settles on nothing that comes back after about the guess's period.
    """
    if guess.trajectory is not None or (not stiff and _apart(model, own) <= NEAR):
        yield own
    if guess.trajectory is not None:
        return
    if model.forced:
        laps = LAPS * guess.period
        yield _between(simulated(model, guess.start, laps + guess.period), laps, guess.period)
    else:
        yield _settled(model, guess)


def _settled(model: Model, guess: Guess) -> Guess:
    state, units, most, away = guess.start, None, np.zeros(len(model.state_names)), np.inf
    for _ in range(LAPS):
        course = simulated(model, state, (1.0 + 2 * LONGEST) * guess.period, units)
        moved, state = np.ptp(course.states, axis=0), course.states[-1]
        units, most = nonzero(moved), np.maximum(most, moved)
        if np.all(moved <= STILL * most):
            raise ConvergenceError(
                "the motion from guess.state comes to rest; give a state near a cycle and its period"
            )
        back = _lap(model, course, units, course.times[-1] - (0.5 + LONGEST) * guess.period, guess.period)
        if back is not None and back[1] <= BACK:
            return back[0]
        away = min(away, np.inf if back is None else back[1])
    raise ConvergenceError(
        f"the motion from guess.state does not come back after about guess.period = {guess.period:g} (to {away:.2g} of "
        f"its extent at best, in {LAPS * (1 + 2 * LONGEST):g} periods); give a state near the cycle and its period"
    )


def _apart(model: Model, guess: Guess) -> float:
    """How far a guess's trajectory is from coming back, in its extents, whole turns aside."""
    states = np.asarray(guess.states)
    moved = wrapped((states[-1] - states[0])[None], model.angles)[0]
    return float(np.abs(moved / nonzero(np.ptp(states, axis=0))).max())


def _between(course: Settling, begin: float, lasts: float) -> Guess:
    """The part of a simulation from a time on, sampled closely."""
    inside = course.times[(course.times > begin) & (course.times < begin + lasts)] - begin
    steps = divided(np.concatenate([[0.0], inside, [lasts]]), BETWEEN)
    states = course.at(begin + steps)
    return Guess(states[0], float(lasts), steps, states)


def lap(model: Model, guess: Guess) -> Guess:
    """A guess with a trajectory for its period: its own, or its motion. Raises `IntegrationError`."""
    if guess.trajectory is not None:
        return guess
    return _between(simulated(model, guess.start, guess.period), 0.0, guess.period)


def paces(model: Model, times: np.ndarray, states: np.ndarray, units: np.ndarray) -> np.ndarray:
    """How fast a motion (k x d) is, in `units` (d) a unit of time."""
    rates = rates_of(vector_field(accelerations(model)))[0](times, states)
    return np.asarray(np.linalg.norm(rates / units, axis=1))


def _lap(
    model: Model, course: Settling, units: np.ndarray, earliest: float, period: float
) -> tuple[Guess, float] | None:
    """The lap that begins after a time where the motion is slow, and by how much it does not close, in `units`.

    Of all returns through the plane there, normal to the motion, the first as near as any but for a tenth.
    """
    own = np.flatnonzero((course.times >= earliest) & (course.times <= course.times[-1] - LONGEST * period))
    if not own.size:
        own = np.array([0])
    fast = paces(model, course.times[own], course.states[own], units)
    begin = own[int(np.argmin(np.abs(np.log(nonzero(fast) * period))))]
    start, now = course.states[begin], course.times[begin]
    normal = rates_of(vector_field(accelerations(model)))[0](np.array([now]), start[None])[0] / units**2
    times = np.linspace(now, course.times[-1], 20001)[1:]
    times = np.unique(np.concatenate([times, course.times[course.times > now]]))
    heights = (course.at(times) - start) @ normal
    crossed = np.flatnonzero((heights[:-1] < 0) & (heights[1:] >= 0))
    if not crossed.size:
        return None
    moments = np.array([
        zero(lambda t: float((course.at(np.array([t]))[0] - start) @ normal), times[k], times[k + 1], 1e-15 * period)
        for k in crossed
    ])  # fmt: skip
    apart = np.abs((course.at(moments) - start) / units).max(axis=1)
    least = apart.min()
    first = int(np.argmax(apart <= max(2 * least, BACK / 10)))
    return _between(course, float(now), float(moments[first] - now)), float(apart[first])
