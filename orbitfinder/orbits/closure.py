"""How well a loop closes: its gap against what round-off can do, and how far the true orbit is.

Everything is measured in the extents of the motion, so that no unit matters. An error made at a time t is
carried to the end by the state-transition matrix Phi(T, t); with S the extents and R the sizes of the
state's components, round-off can make a gap of eps A,

    A = max over t of |S^-1 Phi(T, t) R|,

which sees the shear that the multipliers do not. The distance to the true orbit is the smallest correction
(d, d tau) of state and period, in extents and periods, that closes the gap g to within round-off,

    |u . (g + (Phi - 1) d + f T d tau)| <= 30 eps A    along every left singular vector u.

The error bar of the period is the largest d tau of such a correction across the flow, at the values that are kept,
with the gap and what round-off may add to it of any signs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.loops.symmetry import shifts_of
from orbitfinder.mechanics.model import Model

EPSILON = float(np.finfo(float).eps)
LARGEST_SCALE = 1e6
"""Tolerances grow with A up to this factor; beyond, closure would mean nothing."""
REACHES = 1e-3
"""Round-offs that one of another component makes in a component which it is said to drive"""
ROUND_OFF = 30.0
"""Gaps of true orbits are 0.1 to 30 times eps A (benchmarks/closure_rule.py)."""


@dataclass(frozen=True)
class Closure:
    """The largest component of the gap in extents of the motion, A, the distance to the true orbit, gap and A of the
    `worst` part of the state that nothing else drives, which may be the whole, and the relative error of the period."""

    gap: float
    amplification: float
    distance: float
    worst: tuple[float, float]
    period_error: float = 0.0


def closes(
    gap: np.ndarray, transitions: Sequence[np.ndarray], states: np.ndarray, rate: np.ndarray | None,
    kept: np.ndarray | None = None,
) -> Closure:  # fmt: skip
    """The `Closure` of a loop from its gap (m), the state-transition matrices of its pieces, its states (k x m), and
    f T (m) or None, or whatever else may be corrected (m x k).

    All in extents of the motion; `rate` is None where the period is prescribed. Components that nothing else drives
    close by themselves, to their own A. With the gradients (k x m) of what is `kept` the period's error is told.
    """
    sizes = np.maximum(np.abs(states).max(axis=0), 1.0)  # of the components, R
    whole = carried(transitions, sizes)
    found = _together(gap, whole, rate)
    parts = [found]
    for own in _closed(transitions, sizes):
        inner = [one[np.ix_(own, own)] for one in transitions]
        parts.append(_together(gap[own], carried(inner, sizes[own]), None if rate is None else rate[own]))
    worst = max(parts, key=lambda one: one.gap / min(one.amplification, LARGEST_SCALE))
    late = 0.0 if kept is None or rate is None else _late(gap, whole, rate, kept)
    return replace(found, distance=max(one.distance for one in parts), worst=worst.worst, period_error=late)


def _late(gap: np.ndarray, carried: tuple[np.ndarray, float], rate: np.ndarray, kept: np.ndarray) -> float:
    """By what share of it the period of the true orbit may be another; infinite where none is isolated."""
    monodromy, grown = carried
    rows = np.vstack([rate, kept]) / nonzero(np.linalg.norm(np.vstack([rate, kept]), axis=1, keepdims=True))
    bordered = np.vstack([
        np.column_stack([monodromy - np.eye(gap.size), rate]), np.column_stack([rows, np.zeros(len(rows))]),
    ])  # fmt: skip
    if not np.isfinite(bordered).all():
        return float("inf")
    row = np.linalg.pinv(bordered)[-1, : gap.size]
    return float(np.abs(row) @ (np.abs(gap) + ROUND_OFF * EPSILON * grown))


def _together(gap: np.ndarray, carried: tuple[np.ndarray, float], rate: np.ndarray | None) -> Closure:
    monodromy, largest = carried
    round_off, widest = ROUND_OFF * EPSILON * min(largest, LARGEST_SCALE), float(np.abs(gap).max())
    return Closure(widest, largest, _distance(gap, monodromy, rate, round_off), (widest, largest))


def _closed(transitions: Sequence[np.ndarray], sizes: np.ndarray) -> list[np.ndarray]:
    """The parts (indices) of a state, each smaller than the whole, on which no other component has an influence."""
    monodromy, reach = np.eye(sizes.size), np.zeros((sizes.size, sizes.size))
    for piece in reversed(transitions):
        monodromy = monodromy @ piece
        reach = np.maximum(reach, np.abs(monodromy * sizes))
    drives = ~(reach <= REACHES) | np.eye(sizes.size, dtype=bool)
    for _ in range(int(np.ceil(np.log2(sizes.size + 1)))):
        drives = drives @ drives
    return [np.flatnonzero(one) for one in np.unique(drives, axis=0) if not one.all()]


def carried(transitions: Sequence[np.ndarray], sizes: np.ndarray) -> tuple[np.ndarray, float]:
    """Phi(T, 0) and A, the largest norm with which an error made where a piece begins comes to the end."""
    pieces = np.reshape(transitions, (-1, sizes.size, sizes.size))
    later = np.empty((len(pieces) + 1, sizes.size, sizes.size))
    later[-1], largest = np.eye(sizes.size), float(sizes.max())
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(pieces) - 1, -1, -1):
            np.matmul(later[k + 1], pieces[k], out=later[k])
        carry = later[:-1] * sizes
        if not np.isfinite(carry).all():
            return later[0], np.inf
        if len(carry):  # Frobenius' norm is no smaller than what is asked for
            bounds = np.sqrt((carry**2).sum(axis=(1, 2)))
            likely = bounds.argmax()
            first = float(np.linalg.norm(carry[likely], 2))
            rest = (bounds * (1 + 1e-12) >= first) & (np.arange(len(carry)) != likely)
            norms = np.linalg.norm(carry[rest], 2, axis=(1, 2))
            largest = float(np.fmax.reduce(norms, initial=max(largest, first)))
    return later[0], largest if np.isfinite(largest) else np.inf


def _distance(gap: np.ndarray, monodromy: np.ndarray, rate: np.ndarray | None, round_off: float) -> float:
    """Norm of the smallest (d, d tau) that leaves no gap beyond round-off; infinite where the gap is not finite."""
    if not (np.all(np.isfinite(gap)) and np.all(np.isfinite(monodromy))):
        return float("inf")
    columns = monodromy - np.eye(gap.size)
    if rate is not None:
        columns = np.column_stack([columns, rate])
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    beyond = np.maximum(np.abs(left.T @ gap) - round_off, 0.0)
    steps = np.divide(beyond, singular, out=np.where(beyond > 0, np.inf, 0.0), where=singular > 0)
    return float(np.linalg.norm(steps))


def shift_along(
    model: Model, names: Iterable[str], start: np.ndarray, end: np.ndarray, turns: np.ndarray
) -> dict[str, float]:
    """How far a motion from `start` to `end` (2n each) goes by name along shifts of a model, beside whole turns (n)."""
    chosen = list(names)
    if not chosen:
        return {}
    known, moved = shifts_of(model), (end - start)[: turns.size] - 2 * np.pi * turns
    directions = np.array([known[name].direction for name in chosen])
    return dict(zip(chosen, map(float, np.linalg.lstsq(directions.T, moved, rcond=None)[0]), strict=True))


def gap(
    start: np.ndarray, end: np.ndarray, turns: np.ndarray | Sequence[int], units: np.ndarray | float = 1.0
) -> float:
    """Largest component of x(T) - x(0) - 2 pi k, in `units`; k of a relative orbit are no whole numbers."""
    return float(np.abs((end - start - shift(turns, start.size)) / units).max())


def shift(turns: np.ndarray | Sequence[int], size: int) -> np.ndarray:
    """2 pi k in the coordinates of a state (d) and 0 in the others."""
    return np.concatenate([2 * np.pi * np.asarray(turns), np.zeros(size - len(turns))])
