"""How well a loop closes: its gap against what round-off can do, and how far the true orbit is.

Everything is measured in the extents of the motion, so that no unit matters. An error made at a time t is
carried to the end by the state-transition matrix Phi(T, t); with S the extents and R the sizes of the
state's components, round-off can make a gap of eps A,

    A = max over t of |S^-1 Phi(T, t) R|,

which sees the shear that the multipliers do not. The distance to the true orbit is the smallest correction
(d, d tau) of state and period, in extents and periods, that closes the gap g and what round-off may hide of it,

    (|u . g| + 3 eps max over t of |u . Phi(T, t) R|) / (s - e)    along every left singular vector u

of (Phi - 1, f T), of singular value s known to e, but for the gradients of invariants and of constraints, along which
nothing could close a gap. No other direction is free: a multiplier near 1 makes the distance large, or infinite.
Beside a saddle a state nearer than round-off has any period: what the period is off that of the orbit with the same
invariants, beyond what round-off hides, is `late`, and is allowed no more than the distance.

The error bar of the period is the largest d tau of such a correction across the flow, at the values that are kept,
with the gap and what round-off may add to it of any signs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.integrate.extended import ROUND_OFF as LONG
from orbitfinder.loops.symmetry import shifts_of
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.floquet import complement

LARGEST_SCALE = 1e6
"""Tolerances grow with A up to this factor; beyond, closure would mean nothing."""
REACHES = 1e-3
"""Round-offs that one of another component makes in a component which it is said to drive"""
MATRIX, STILL, SHAKEN = 1e-13, 1e-9, 3.0
"""Relative error of a state-transition matrix, as it is integrated. A component that moves less than this share of its
size loses what it does to the round-off of all steps; that of some 400 of others comes to so many eps"""
TAKEN = 10.0
"""Round-offs of the state that a period takes up: 1 to 5 beside a pendulum's saddle"""
ROUND_OFF = 30.0
"""Gaps of true orbits are 0.1 to 30 times eps A (benchmarks/closure_rule.py)."""


@dataclass(frozen=True)
class Closure:
    """The largest component of the gap in extents of the motion, A, the distance to the true orbit, gap and A of the
    `worst` part of the state that nothing else drives, which may be the whole, the distance `across` the direction
    that is determined least, for an orbit that a further condition fixes, the relative error of the period, and what it
    is `late` in any case."""

    gap: float
    amplification: float
    distance: float
    worst: tuple[float, float]
    across: float
    period_error: float = 0.0
    late: float = 0.0


def closes(
    gap: np.ndarray, transitions: Sequence[np.ndarray], states: np.ndarray, rate: np.ndarray | None,
    kept: np.ndarray | None = None, basis: np.ndarray | None = None, precise: float = EPSILON,
    monodromy: np.ndarray | None = None,
) -> Closure:  # fmt: skip
    """The `Closure` of a loop from its gap (m), the state-transition matrices of its pieces, its states (k x m), and
    f T (m) or None, or whatever else may be corrected (m x k).

    All in extents of the motion; `rate` is None where the period is prescribed. Components that nothing else drives
    close by themselves, to their own A. With the gradients (k x m) of what is `kept` the period's error is told.
    `basis` (m x r) spans what constraints leave, the integration is `precise` to this, and so is the `monodromy` where
    the product of the pieces is not.
    """
    sizes = np.maximum(np.abs(states).max(axis=0), 1.0)  # of the components, R
    whole = carried(transitions, sizes)
    widest = float(np.abs(gap).max())
    parts = [(widest, whole[1])]
    for own in _closed(transitions, sizes):
        inner = [one[np.ix_(own, own)] for one in transitions]
        parts.append((float(np.abs(gap[own]).max()), carried(inner, sizes[own])[1]))
    worst = max(parts, key=lambda part: part[0] / min(part[1], LARGEST_SCALE))
    unit = np.eye(gap.size)
    stays = (np.reshape(transitions, (-1, *unit.shape)) == unit).all(axis=(0, 2)) & (states == states[0]).all(axis=0)
    free, basis = unit[stays & (gap == 0)], unit if basis is None else basis
    frame = basis @ complement(free @ basis, (free if kept is None else kept) @ basis)
    off, across = distance(frame.T @ gap, (-frame.T, frame.T), transitions, states, rate, precise, monodromy)
    late = (0.0, 0.0)
    if kept is not None and rate is not None:
        late = _late(
            gap, _carrying(transitions, sizes.size, monodromy), sizes, whole[1], np.vstack([rate, kept]), basis
        )
    return Closure(widest, whole[1], off, worst, across, *late)


def _carrying(transitions: Sequence[np.ndarray], size: int, monodromy: np.ndarray | None) -> list[np.ndarray]:
    """What carries an error from the end, and from where each piece begins, to the end."""
    later = list(accumulate(reversed(transitions), np.matmul, initial=np.eye(size)))
    return later if monodromy is None else [*later[:-1], monodromy]


def _late(
    gap: np.ndarray, later: Sequence[np.ndarray], sizes: np.ndarray, grown: float, rows: np.ndarray, basis: np.ndarray
) -> tuple[float, float]:
    """By what share of it the period of the true orbit may be another, infinite where none is isolated, and is, beyond
    what round-off of the state hides; `rows` (k x m) are f T and the gradients of what is kept."""
    rate, rows = basis.T @ rows[0], rows @ basis
    rows = grown * rows / nonzero(np.linalg.norm(rows, axis=1, keepdims=True))  # so that their shares cost little
    bordered = np.vstack([
        np.column_stack([basis.T @ later[-1] @ basis - np.eye(rate.size), rate]),
        np.column_stack([rows, np.zeros(len(rows))]),
    ])  # fmt: skip
    row = np.linalg.pinv(bordered.astype(float))[-1, : rate.size] if np.isfinite(bordered).all() else 0 * rate
    if not row @ rate > 0.5:  # which is 1
        return np.inf, 0.0
    row = basis @ row
    hidden = TAKEN * EPSILON * max(np.linalg.norm(row @ after * sizes) for after in later)
    return float(np.abs(row) @ (np.abs(gap) + ROUND_OFF * EPSILON * grown)), float(np.abs(row @ gap) - hidden)


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
    later = np.empty((len(pieces) + 1, sizes.size, sizes.size), pieces.dtype)
    later[-1], largest = np.eye(sizes.size), float(sizes.max())
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(pieces) - 1, -1, -1):
            np.matmul(later[k + 1], pieces[k], out=later[k])
        later = later.astype(float)
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


def regrown(transitions: Sequence[np.ndarray]) -> float:
    """What an error grows to in Phi that is made on the way, max over t of |Phi(T, t)| |Phi(t, 0)|."""
    size = len(transitions[0])
    sooner = accumulate(transitions, lambda done, piece: piece @ done, initial=np.eye(size))
    ways = zip(sooner, reversed(_carrying(transitions, size, None)), strict=True)
    return max(float(np.linalg.norm(before) * np.linalg.norm(after)) for before, after in ways)


def distance(
    gap: np.ndarray, rows: tuple[np.ndarray, np.ndarray], transitions: Sequence[np.ndarray], states: np.ndarray,
    late: np.ndarray | None, precise: float = EPSILON, monodromy: np.ndarray | None = None,
) -> tuple[float, float]:  # fmt: skip
    """Norm of the smallest (d, d tau) that makes up for a gap (r) in what `rows` (r x m each) ask of both ends of a
    motion, of which the period changes the last by `late` (m); infinite where any could. And the same across the
    direction that is determined least.

    What rates alone say of a component that hardly moves is in its gap, and known to the round-off of rates. An
    integration that is more `precise` than the start adds nothing to what that is known to.
    """
    (first, last), size = rows, np.abs(states).max(axis=0)
    later = _carrying(transitions, size.size, monodromy)
    grown = carried(transitions, np.ones(size.size))[1]
    columns = np.column_stack([first + last @ later[-1], *([] if late is None else [last @ late])])
    if not (np.isfinite(grown) and np.isfinite(columns).all() and np.isfinite(gap).all()):
        return np.inf, np.inf
    left, singular, right = np.linalg.svd(columns.astype(float), full_matrices=False)
    size = np.where(still(states), np.abs(later[-1] - np.eye(size.size)) @ size / SHAKEN, size)
    hidden = np.max([np.linalg.norm(left.T @ last @ after * size, axis=1) for after in later], axis=0)
    along = np.abs(left.T @ gap)  # of which the error of the columns tilts so much from the others
    excused = min(ROUND_OFF * LARGEST_SCALE, grown * float(np.hypot.reduce(along / nonzero(singular))))
    begun = np.linalg.norm(left.T @ columns[:, : size.size] * size, axis=1)
    rounded = SHAKEN * (precise * hidden + (EPSILON - precise) * begun)
    beyond = np.maximum(along - precise * excused, 0.0) + rounded
    lost = np.full(singular.shape, MATRIX * grown)
    if precise < EPSILON:  # columns are in long double, of which the singular vectors leave little beside the diagonal
        within = left.T @ columns @ right.T
        singular, beside = np.abs(np.diag(within)), within - np.diag(np.diag(within))
        tilted = (beside**2 + beside.T**2) / nonzero(np.abs(singular[:, None] - singular))
        rounded = LONG * np.linalg.norm(columns) + EPSILON * np.linalg.norm(columns[:, size.size :])
        lost = tilted.sum(axis=1) + rounded + (LONG if monodromy is None else precise) * regrown(transitions)
    known = singular - lost
    steps = np.where(known > 0, beyond / nonzero(known), np.inf).astype(float)
    return float(np.linalg.norm(steps)), float(np.linalg.norm(np.sort(steps)[:-1]))


def still(states: np.ndarray) -> np.ndarray:
    """Which components (m) of a motion (k x m) move so little that its steps may lose what they do."""
    return np.asarray(np.ptp(states, axis=0) < STILL * np.abs(states).max(axis=0))


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
