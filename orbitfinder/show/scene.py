"""What moves, for everything that draws it: positions frame by frame, what is drawn through them, the ground, jumps.

Mechanisms are drawn with rods, springs, sliders, discs and the ground, as lines through their points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import field as entry

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.mechanics.model import Model, positions
from orbitfinder.orbits.course import Course

Strokes = Sequence[tuple[str, tuple[int, ...]]]
Outline = Callable[[np.ndarray, float], np.ndarray]
COILS, WIDTH = 8, 0.018
"""Coils of a spring; half the width of springs, sliders and pivots over the extent of the picture"""
CIRCLE = np.array([function(np.linspace(0.0, 2 * np.pi, 40)) for function in (np.cos, np.sin)])


def _line(at: np.ndarray, half: float) -> np.ndarray:
    """A line through points (2 x k); a mass in one point as a circle."""
    return at if at.shape[1] > 1 else at + half * CIRCLE


def _disc(at: np.ndarray, _: float) -> np.ndarray:
    return np.asarray(at[:, :1] + np.linalg.norm(at[:, 1] - at[:, 0]) * CIRCLE)


def _slider(at: np.ndarray, half: float) -> np.ndarray:
    return np.asarray(at + half * np.array([[-1, -1, 1, 1, -1], [-1.6, 1.6, 1.6, -1.6, -1.6]]))


def _pivot(at: np.ndarray, half: float) -> np.ndarray:
    return np.asarray(at + half * np.array([[0, 1.5, 1.5, 0], [0, -1, 1, 0]]))


def _spring(at: np.ndarray, half: float) -> np.ndarray:
    """A zigzag between two points with a straight piece at either end."""
    begin, along = at[:, 0], at[:, 1] - at[:, 0]
    length = nonzero(float(np.linalg.norm(along)))
    across = np.array([-along[1], along[0]]) * (half / length)
    places = np.concatenate([[0.0], np.linspace(0.15, 0.85, 2 * COILS + 1), [1.0]])
    sides = np.concatenate([[0.0, 0.0], np.resize([1.0, -1.0], 2 * COILS - 1), [0.0, 0.0]])
    return np.asarray(begin[:, None] + along[:, None] * places + across[:, None] * sides)


@dataclass(frozen=True)
class Brush:
    """How a kind of stroke is drawn: its line through points (2 x k) by half the width of what is wide (m).

    `thick` in widths of a rod; `filled` or a line; `rigid` where its points keep their distances, `centred` where the
    first is the centre and the second on the rim; `pinned` where pins mark its points.
    """

    outline: Outline
    thick: float = 0.5
    filled: bool = False
    rigid: bool = False
    centred: bool = False
    pinned: bool = False


BRUSHES = {
    "rod": Brush(_line, 1.0, rigid=True, pinned=True),
    "spring": Brush(_spring),
    "disc": Brush(_disc, rigid=True, centred=True),
    "slider": Brush(_slider, filled=True),
    "ground": Brush(_pivot, filled=True),
}
"""Of every kind of stroke"""


def outlines(points: np.ndarray, strokes: Strokes, size: float) -> list[tuple[str, np.ndarray]]:
    """The lines (2 x k each, with their kinds) of one configuration (2 x m); without strokes one line through all.

    `size` is the extent of the picture (m).
    """
    if not strokes:
        return [("rod", points)]
    return [(kind, BRUSHES[kind].outline(points[:, list(chosen)], WIDTH * size)) for kind, chosen in strokes]


def tip(points: np.ndarray) -> int:
    """Which point of positions (k x 2 x m, nan between arcs) is the tip, whose path is drawn: the last that moves."""
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    seen = (high.max(axis=1) - low.min(axis=1)).max()
    moving = np.flatnonzero((high - low).max(axis=0) > 1e-9 * seen)  # the rest stands still
    return int(moving[-1]) if moving.size else -1


def evenly(count: int, most: int) -> list[int]:
    """At most `most` of the indices below `count`, both ends among them."""
    return [int(k) for k in np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))] if count else []


def equal_times(period: float, count: int) -> np.ndarray:
    """Times (s) over a period, the end left out."""
    return np.linspace(0.0, period, count, endpoint=False)


def box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (down, right) of positions (k x 2 x m)."""
    return points.min(axis=(0, 2)), points.max(axis=(0, 2))


def extent(points: np.ndarray) -> float:
    """The larger side of a box about positions (k x 2 x m)."""
    low, high = box(points)
    return max(float((high - low).max()), 1e-9)


@dataclass(frozen=True)
class Scene:
    """What moves: `points` (frames x 2 x m; x down and y right, m) at equal times.

    Args:
        points: positions, the end of the period left out.
        strokes: what is drawn through which points; () is one line through all.
        ground: (frames x 2 x g, or one frame for all) what the machine stands on or hits.
        cuts: frames right after a jump, before which paths are broken.
        period: s that all frames last.
        loops: whether the first frame follows the last.
        drawn: what the points are, "mechanism", or "plane" where the system declares none.
    """

    points: np.ndarray
    strokes: Strokes = entry(default=(), kw_only=True)
    ground: np.ndarray | None = entry(default=None, kw_only=True)
    cuts: tuple[int, ...] = entry(default=(), kw_only=True)
    period: float = entry(default=1.0, kw_only=True)
    loops: bool = entry(default=True, kw_only=True)
    drawn: str = entry(default="mechanism", kw_only=True)


def cuts_of(course: Course, moments: np.ndarray) -> tuple[int, ...]:
    """The frames at moments (s, ascending) right after the events of a course, in every period that they are in."""
    rounds = range(int(np.floor(moments[-1] / course.period)) + 1)
    ends = [moment + (k - 1e-9) * course.period for k in rounds for moment, _ in course.events]  # less round-off
    return tuple(int(k) for k in np.searchsorted(moments, ends))


def places(model: Model, states: np.ndarray) -> np.ndarray:
    """What of states (k x d) is drawn (k x 2 x j; down, right): the points of a mechanism, or one in the plane of the
    first two coordinates, or of one and its rate."""
    if model.points is not None:
        return positions(model, states)
    second = states[:, 1 % states.shape[1]]
    return np.stack([-second, states[:, 0]], axis=1)[:, :, None]


def positions_at(model: Model, course: Course, moments: np.ndarray) -> np.ndarray:
    """The same (k x 2 x j) at moments of a course, where its pieces have led."""
    return places(model, course.states(moments)) if model.points is None else course.positions(moments)
