"""The size of a motion, to which the lengths and tolerances of a family are relative.

Angles have a scale of their own, the radian. Where a system has none, a family told in millimetres is followed by the
same steps as one told in metres, and a small orbit by the same number of them as a large one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

LEAST = 1e-3
"""Share of a motion's distance from the origin that its extent counts as at least: it is known to round-off of that."""


def length(angles: Sequence[bool], states: np.ndarray) -> float:
    """What coordinates are measured in: rad and m where there are angles, else the largest extent of a motion."""
    return 1.0 if any(angles) else max(float(np.ptp(_places(states), axis=0).max()), 1e-300)


def extents(states: np.ndarray) -> np.ndarray:
    """The scale (2n) of every component of a motion (k x 2n): the largest extent of coordinates, and of rates."""
    halves = np.split(states, 2, axis=1)
    sizes = [max(float(np.ptp(one, axis=0).max()), LEAST * float(np.abs(one).max()), 1e-300) for one in halves]
    return np.repeat(sizes, states.shape[1] // 2)


def span(angles: Sequence[bool], weights: np.ndarray, states: np.ndarray) -> float:
    """What the steps along a family are relative to, in its metric: one radian, or else the motion's extent."""
    return 1.0 if any(angles) else extent(weights, states)


def extent(weights: np.ndarray, states: np.ndarray) -> float:
    """How far the configurations of a motion (k x 2n) are apart in a family's metric."""
    places = _places(states)
    return max(float(np.sqrt(weights[: places.shape[1]] @ np.ptp(places, axis=0) ** 2)), 1e-300)


def _places(states: np.ndarray) -> np.ndarray:
    return states[:, : states.shape[1] // 2]
