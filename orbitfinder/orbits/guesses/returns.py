"""Guesses out of motion that somebody already has: close returns of a trajectory, and sums of normal modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.errors import InputError, plural
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.integrate.idas import simulate_dae
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.kind import system_kind
from orbitfinder.mechanics.model import Model, wrapped
from orbitfinder.orbits.course import Course
from orbitfinder.orbits.guesses.modes import normal_mode, normal_modes

MOST_SAMPLES = 3000
"""Samples of a trajectory that are compared with each other, in all pairs."""
ROUND_OFF = 8 * EPSILON
"""Differences of samples are known to this share of the samples"""


@dataclass(frozen=True)
class ReturnSettings:
    """What counts as a return."""

    away: float = 0.25
    """A return counts when the motion went at least this far away in between, relative to its extent."""
    same_period: float = 0.02
    """Of returns whose periods differ by less than this, relative, only the closest is kept."""
    most_modes_periods: int = 12
    near_return: float = 0.1
    """A motion has come back when it is this near its start, relative to its extent."""


RETURNS = ReturnSettings()


@dataclass(frozen=True)
class CloseReturn(Shown):
    """x(t + period) came within `distance` (relative to the motion's extent) of x(t) = state, t = `time`."""

    __repr__ = brief("time", "period", "distance")

    state: np.ndarray
    period: float
    distance: float
    time: float
    guess: Guess


def close_returns(
    times: np.ndarray, states: np.ndarray, angles: Sequence[bool] = (), count: int = 10, longest: float | None = None
) -> list[CloseReturn]:
    """The closest returns of a trajectory (k times, k x 2n states) to itself, best first, one for each period.

    Distances |x(t + T) - x(t)| are taken component by component relative to the trajectory's extent,
    angles modulo 2 pi, and searched for local minima over t and T up to `longest` (default: half the
    trajectory). Close returns as starting points: D. P. Lathrop, E. J. Kostelich, Physical Review A
    40 (1989) 4028-4031. Raises `InputError` for fewer than 20 samples.
    """
    times, states = np.asarray(times, float), np.asarray(states, float)
    if times.size < 20 or states.shape[0] != times.size:
        raise InputError(
            f"trajectory: {plural(times.size, 'time')} for {plural(states.shape[0], 'state')}; give at least 20 of both"
        )
    grid = np.linspace(times[0], times[-1], min(max(times.size, 400), MOST_SAMPLES))
    times, states = grid, np.stack([np.interp(grid, times, column) for column in states.T], axis=1)
    step, wrapping = float(times[1] - times[0]), np.zeros(states.shape[1], bool)
    wrapping[: len(angles)] = angles
    extent = nonzero(np.ptp(states, axis=0))
    extent = np.where(wrapping, np.minimum(extent, np.pi), extent)
    span = times[-1] - times[0]
    lags = np.arange(1, int(min(longest or span / 2, span / 2) / step) + 1)
    starts = len(times) - lags[-1]
    apart = (wrapped(states[lag : lag + starts] - states[:starts], wrapping) for lag in lags)
    table = np.stack([np.abs(each / extent).max(axis=1) for each in apart])
    returns: list[CloseReturn] = []
    inner = table[1:-1]  # entries that are not above their neighbours in the row's direction
    rows, columns = np.nonzero((inner <= table[:-2]) & (inner <= table[2:]))
    rows += 1
    rounded = ROUND_OFF * float((np.abs(states).max(axis=0) / extent).max())  # of equals the shortest is first
    for k in np.argsort(np.maximum(table[rows, columns], rounded), kind="stable"):
        row, column = int(rows[k]), int(columns[k])
        if table[: row + 1, column].max() < max(RETURNS.away, 3 * table[row, column]):
            continue
        period = lags[row] * step
        lap = slice(column, column + round(period / float(times[1] - times[0])) + 1)
        guess = Guess(states[column], period, times[lap] - times[column], states[lap])
        back = CloseReturn(states[column], period, float(table[row, column]), float(times[column] - times[0]), guess)
        if all(abs(back.period / other.period - 1) > RETURNS.same_period for other in returns):
            returns.append(back)
        if len(returns) == count:
            break
    return returns


def recurrences(
    model: Model, state: Sequence[float] | np.ndarray, duration: float, count: int = 10, longest: float | None = None
) -> list[CloseReturn]:
    """Close returns of the motion from `state` over `duration` (s), simulated by CVODES."""
    if not (np.isfinite(duration) and duration > 0):
        raise InputError(f"guess.duration: must be positive and finite, got {duration}; give a time in s")
    start = np.asarray(state, float)
    if start.shape != (len(model.state_names),):
        raise InputError(f"guess.state: {plural(start.size, 'number')}; give {len(model.state_names)}")
    states = sample(build_flow(model), start, float(duration), MOST_SAMPLES)
    times = np.linspace(0.0, duration, len(states))
    returns = close_returns(times, states, model.angles, count, longest)
    if model.forcing_period is None:
        return returns
    # from the next whole period of the forcing, where t = 0 belongs
    clock, beat = model.driving_period, []
    for back in returns:
        period, moment = max(1, round(back.period / clock)) * clock, float(np.ceil(back.time / clock) * clock)
        state = np.array([np.interp(moment, times, column) for column in states.T])
        beat.append(CloseReturn(state, period, back.distance, moment, Guess(state, period)))
    return beat


def first_return(model: Model, state: np.ndarray, longest: float | None = None) -> float:
    """Time (s) at which the motion from a state (2n) is first back near its start, angles modulo 2 pi.

    Of a linkage of one degree of freedom that is its period, to the sampling. Without a `longest` time (s) it is looked
    for in 20 s, of a mechanism in 400 times of its own pace. Raises `InputError` when it does not come back.
    """
    pace = _pace(model)
    longest = 400.0 / pace if longest is None else longest
    for share in (1 / 16, 1 / 4, 1.0):
        back = _returned(model, state, share * longest, 10 * pace)
        if back is not None:
            return back
    raise InputError(f"guess.period: the motion does not come back within {longest:g} s; give a period")


def _pace(model: Model) -> float:
    """How fast a mechanism goes, in 1/s: what stabilises its loops, without loops its fastest small oscillation."""
    if not system_kind(model.system).drawn:
        return 20.0
    if model.constraint is not None:
        return float(model.system["baumgarte"][0])
    fastest = float(normal_modes(model)[0].max())
    if fastest <= 0:
        raise InputError("guess.period: missing, and nothing holds this mechanism near a pose; give a period in s")
    return float(np.sqrt(fastest))


def _returned(model: Model, state: np.ndarray, longest: float, often: float) -> float | None:
    """The first return within a time (s), looked for so many times a second."""
    count = int(often * longest) + 1
    if model.constraint is None:
        times, states = np.linspace(0.0, longest, count), sample(build_flow(model), state, longest, count)
    else:
        motion = simulate_dae(model, state, longest, count)
        times, states = motion.times, motion.states
    n, away = model.degrees_of_freedom, wrapped(states - states[0], model.angles)
    units = _units(model, states[:, :n])
    rates = away[:, n:] / units
    clock = np.ptp(states[:, n:] / units) or 1.0
    gone = np.abs(away[:, :n] / units).max(axis=1)
    distance = np.maximum(gone / (gone.max() or 1.0), np.abs(rates).max(axis=1) / clock)
    near = RETURNS.near_return * float(distance.max())
    left = int(np.argmax(distance > near))
    lowest = (distance[1:-1] < near) & (distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])
    back = [k for k in np.flatnonzero(lowest) + 1 if k > left]
    return float(times[back[0]]) if left and back else None


def returns_of_arcs(model: Model, path: Course) -> list[CloseReturn]:
    """The close returns of a hybrid motion, best first: from the start of an arc to that after as many events as the
    cycle has, or any number where it says none; distances relative to the motion's extent, angles modulo 2 pi."""
    extent = nonzero(np.ptp(np.vstack([piece.states for piece in path.pieces]), axis=0))
    cycle, first = model.hybrid.cycle, model.hybrid.first.model
    begun = [(k, float(piece.times[0]), wrapped(piece.states[0], model.angles)) for k, piece in enumerate(path.pieces)
             if k and piece.model is first and (not cycle or path.pieces[k - 1].event == cycle[-1])]  # fmt: skip
    returns = [
        CloseReturn(x, late - t, float((np.abs(wrapped(back - x, model.angles)) / extent).max()), t, Guess(x, late - t))
        for j, t, x in begun for k, late, back in begun if k > j and (not cycle or k - j == len(cycle))
    ]  # fmt: skip
    return sorted(returns, key=lambda near: near.distance)


def _units(model: Model, places: np.ndarray) -> np.ndarray:
    """What coordinates (n) are measured in beside angles: slides in what they move while the angles move a radian."""
    turning, extents = model.angular, np.ptp(places, axis=0)
    if turning.all() or not turning.any():
        return np.ones(extents.size)
    slide = float(extents[~turning].max()) / (float(extents[turning].max()) or 1.0)
    return np.where(turning, 1.0, slide or 1.0)


def normal_mode_sum(
    model: Model,
    modes: Sequence[int],
    amplitudes: Sequence[float],
    equilibrium: Sequence[float] | np.ndarray | None = None,
) -> Guess:
    """Guess from several linear normal modes together, all at their turning points (amplitudes may be negative).

    The period is the multiple k <= 12 of the first mode's after which the others are nearest to
    their starts, sum a_j^2 (1 - cos(w_j T)) at its least.
    """
    if len(modes) != len(amplitudes) or not modes:
        raise InputError(
            f"guess.amplitude: {plural(len(amplitudes), 'number')} for {plural(len(modes), 'mode')}; give one per mode"
        )
    parts = [normal_mode(model, mode, abs(a), equilibrium) for mode, a in zip(modes, amplitudes, strict=True)]
    n = model.degrees_of_freedom
    place = np.zeros(2 * n)
    place[:n] = 0.0 if equilibrium is None else np.asarray(equilibrium, float)
    state = place + sum(np.sign(a) * (part.state - place) for a, part in zip(amplitudes, parts, strict=True))
    frequencies = np.sqrt(normal_modes(model, equilibrium)[0][[mode - 1 for mode in modes]])
    periods = parts[0].period * np.arange(1, RETURNS.most_modes_periods + 1)
    mismatch = (1 - np.cos(np.outer(periods, frequencies))) @ np.square(amplitudes)
    # a longer period has to earn its length
    best = int(np.argmin(mismatch * np.arange(1, RETURNS.most_modes_periods + 1) + 1e-12 * periods))
    return Guess(state, float(periods[best]))
