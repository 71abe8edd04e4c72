"""Configurations that a hand pulls a mechanism into: one of its points as near to a place as the joints allow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orbitfinder._runtime.sizes import LEAST, nonzero, size_of
from orbitfinder.errors import InputError
from orbitfinder.mechanics.constrained import allowed_velocities
from orbitfinder.mechanics.model import Model, positions, vector_field
from orbitfinder.mechanics.scales import surroundings
from orbitfinder.mechanisms.closing import LoopClosure

DAMPING, SOFTER, HARDER, HARDEST = 1e-4, 5.0, 8.0, 1e4
"""Of steps, relative to how far the point goes with its coordinates: at first, less after one that helps, more after
one that does not, and where there is none"""
SMALL = 1e-6
NEAR = 1e-10
"""A place is reached to this, and steps end that gain less, relative to the distance"""


def pulled(model: Model, state: np.ndarray, point: int, place: np.ndarray) -> np.ndarray:
    """The state (2n) at rest near another one whose `point` is as near to a place (down, right, m; in space to the eye
    too) as can be; of a hybrid system no farther beyond its guards than it was, and with the states that move no point
    as they were.

    Damped least squares in the velocities that the closures allow: min |p(q) - place| by small motions. Source: C. W.
    Wampler, IEEE Transactions on Systems, Man, and Cybernetics 16 (1986) 93-101. Raises `InputError`.
    """
    q, n = np.array(state[: model.degrees_of_freedom], float), model.degrees_of_freedom
    units, there = surroundings(model, q)[0], _seen(model, q[None], len(place))[0]
    missed, past, most = place - there[_checked(there, point)], _beyond(model), 0.0
    most = max(most, past(q))
    damping, closure = DAMPING, None if model.constraint is None else LoopClosure.of(model, units)
    for _ in range(40):
        away = float(np.linalg.norm(missed))
        slopes, ways = _slopes(model, q, units, len(place))
        reach, damping = slopes[point] @ slopes[point].T, max(damping / SOFTER, NEAR)
        while damping < HARDEST:
            damped = reach + (damping * np.trace(reach) + LEAST) * np.eye(len(place))
            step = ways @ (slopes[point].T @ np.linalg.solve(damped, missed))
            step *= units * min(1.0, 0.2 / size_of(step))  # a hand takes no mechanism through itself
            trial = q + step if closure is None else closure.near(q + step)
            left = place - _seen(model, trial[None], len(place))[0, point]
            if np.linalg.norm(left) < away * (1 - NEAR) and past(trial) <= most:
                break
            damping *= HARDER
        else:
            break
        q, missed = trial, left
        if np.linalg.norm(missed) <= NEAR * max(away, float(np.abs(place).max())):
            break
    return np.concatenate([q, np.zeros(len(model.state_names) - n)])


def _beyond(model: Model) -> Callable[[np.ndarray], float]:
    """How far configurations (n) are beyond what ends the mode that a hybrid motion begins in, or must hold in it; 0 of
    a smooth system. Guards that may be crossed unnoticed do not count."""
    if model.smooth:
        return lambda q: 0.0
    first, rest = model.hybrid.first, len(model.state_names) - model.degrees_of_freedom
    signed = [(each.direction, each.guard) for each in model.hybrid.leaving(first.name) if each.allowed is None]
    signed += [(-1, hold) for hold in first.holds.values()]

    def past(q: np.ndarray) -> float:
        x = np.append(q, np.zeros(rest))
        return max((sign * float(guard(x, model.parameter_values)) for sign, guard in signed), default=0.0)

    return past


def thrown(model: Model, state: np.ndarray, point: int, velocity: np.ndarray) -> np.ndarray:
    """The state (2n) in the configuration of another one, with the least rates that give a point a velocity (m/s).

    Near a dead point, where the point hardly follows its coordinates, nothing moves faster than five times that. Of a
    first-order system those states change that move no point, by least squares.
    """
    if model.rates is not None:
        return _with_velocity(model, np.asarray(state, float), point, velocity)
    q = np.array(state[: model.degrees_of_freedom], float)
    units = surroundings(model, q)[0]
    slopes, ways = _slopes(model, q, units, len(velocity))
    moved = np.linalg.pinv(slopes[_checked(slopes, point)], rcond=1e-3) @ velocity
    speed = float(np.linalg.norm(slopes @ moved, axis=1).max())
    slower = min(1.0, 5.0 * float(np.linalg.norm(velocity)) / nonzero(speed))
    return np.concatenate([q, slower * units * (ways @ moved)])


def _with_velocity(model: Model, state: np.ndarray, point: int, velocity: np.ndarray) -> np.ndarray:
    """The state (d) of a first-order system with the least change of what moves no point that gives a velocity."""
    field, units = vector_field(model), surroundings(model, state)[0]
    slopes, none = _slopes(model, state, units, len(velocity))[0], np.zeros(0)
    still = np.abs(slopes).max(axis=(0, 1)) <= SMALL * nonzero(np.abs(slopes).max())

    def speed(x: np.ndarray) -> np.ndarray:
        rates = field(0.0, x, none, none).full().ravel() / units
        return np.asarray(_slopes(model, x, units, len(velocity))[0][_checked(slopes, point)] @ rates)

    moves = np.diag(units)[still]
    turns = np.transpose([(speed(state + move) - speed(state - move)) / 2 for move in moves])
    share = np.linalg.pinv(turns, rcond=1e-3) @ (velocity - speed(state)) if moves.size else np.zeros(0)
    return np.asarray(state + share @ moves)


def movable(model: Model, state: np.ndarray) -> list[int]:
    """The points of a Model that its coordinates move; none of a system that draws none."""
    if model.points is None:
        return []
    q = np.array(state[: model.degrees_of_freedom], float)
    sizes = np.abs(_slopes(model, q, surroundings(model, q)[0])[0]).max(axis=(1, 2))
    return np.flatnonzero(sizes > SMALL * sizes.max()).tolist()


def _checked(points: np.ndarray, point: int) -> int:
    """The number of a point. Raises `InputError`."""
    if not 0 <= point < len(points):
        raise InputError(f"point: {point} is none; this system draws points 0 to {len(points) - 1}")
    return point


def _seen(model: Model, q: np.ndarray, dims: int) -> np.ndarray:
    """Where all points are at configurations (k x n): (k x m x 2 or 3), nan where a loop cannot be closed."""
    with np.errstate(all="ignore"):
        rest = np.zeros((len(q), len(model.state_names) - model.degrees_of_freedom))
        places = positions(model, np.hstack([q, rest]), "points" if dims == 2 else "space")
    return places.transpose(0, 2, 1)


def _slopes(model: Model, q: np.ndarray, units: np.ndarray, dims: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """d points/d(what can move) (m x 2 or 3 x f) by central differences, and a basis (n x f) of what can, in units."""
    moves = SMALL * np.diag(units)
    apart = _seen(model, q + moves, dims) - _seen(model, q - moves, dims)
    slopes = np.nan_to_num(apart).transpose(1, 2, 0) / (2 * SMALL)
    if model.constraint is None:
        return slopes, np.eye(q.size)
    basis = np.linalg.qr(allowed_velocities(model, q) / units[:, None])[0]
    return slopes @ basis, basis
