"""What mechanisms are drawn with: rods, springs, sliders, discs and the ground, as lines through their points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbitfinder._runtime.sizes import nonzero

Strokes = Sequence[tuple[str, tuple[int, ...]]]
COILS, WIDTH, SIDES = 8, 0.018, 40
"""Coils of a spring; half the width of springs, sliders and pivots over the extent of the picture; sides of a disc"""


def outlines(points: np.ndarray, strokes: Strokes, size: float) -> list[tuple[str, np.ndarray]]:
    """The lines (2 x k each, with their kinds) of one configuration (2 x m); without strokes one line through all.

    `size` is the extent of the picture (m).
    """
    if not strokes:
        return [("rod", points)]
    return [(kind, _outline(kind, points[:, list(chosen)], WIDTH * size)) for kind, chosen in strokes]


def _outline(kind: str, at: np.ndarray, half: float) -> np.ndarray:
    if kind == "spring":
        return _spring(at[:, 0], at[:, 1], half)
    if kind == "disc" or (at.shape[1] == 1 and kind == "rod"):  # the latter a mass in one point
        turn = np.linspace(0.0, 2 * np.pi, SIDES)
        radius = np.linalg.norm(at[:, 1] - at[:, 0]) if kind == "disc" else half
        return np.asarray(at[:, :1] + radius * np.array([np.cos(turn), np.sin(turn)]))
    if kind == "slider":
        return np.asarray(at + half * np.array([[-1, -1, 1, 1, -1], [-1.6, 1.6, 1.6, -1.6, -1.6]]))
    if kind == "ground":
        return np.asarray(at + half * np.array([[0, 1.5, 1.5, 0], [0, -1, 1, 0]]))
    return at


def _spring(begin: np.ndarray, end: np.ndarray, half: float) -> np.ndarray:
    """A zigzag between two points with a straight piece at either end."""
    along = end - begin
    length = nonzero(float(np.linalg.norm(along)))
    across = np.array([-along[1], along[0]]) * (half / length)
    places = np.concatenate([[0.0], np.linspace(0.15, 0.85, 2 * COILS + 1), [1.0]])
    sides = np.concatenate([[0.0, 0.0], np.resize([1.0, -1.0], 2 * COILS - 1), [0.0, 0.0]])
    return np.asarray(begin[:, None] + along[:, None] * places + across[:, None] * sides)


STILL = 1e-9
"""Of all that is seen, the share within which a point stands still."""


def tip(points: np.ndarray) -> int:
    """Which point of positions (k x 2 x m, nan between arcs) is the tip, whose path is drawn: the last that moves."""
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    moving = np.flatnonzero((high - low).max(axis=0) > STILL * (high.max(axis=1) - low.min(axis=1)).max())
    return int(moving[-1]) if moving.size else -1


def extent(points: np.ndarray) -> float:
    """The larger side of a box about positions (k x 2 x m)."""
    return max(float((points.max(axis=(0, 2)) - points.min(axis=(0, 2))).max()), 1e-9)
