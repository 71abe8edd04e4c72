"""The potential that a motion in a plane moves in, for the page to draw lines of equal energy from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from orbitfinder.mechanics.model import Model, energies, positions
from orbitfinder.site.motion import base64_of

CELLS, REACH = 60, 1.5
"""Cells of the grid each way, and how far it goes from the middle of the picture, in its larger side"""
MANY, FOCUS = 152, 2.0
"""Cells of a grid for motions of many sizes, and the sinh to which their places are stretched: fine in the middle"""


def landscape(
    model: Model | None, frame: Mapping[str, Sequence[float]] | None, many: bool = False
) -> dict[str, Any] | None:
    """Values of the potential energy on a grid about a `frame` (centre and spans: down, right), and levels to draw.

    `many`: of all motions of a family, large and small, and so finer in the middle.
    None of what is no point in a plane whose energy at rest depends on where it is alone.
    """
    layout = None if frame is None or model is None else _layout(model)
    if frame is None or model is None or layout is None:
        return None
    origin, steps = layout
    half = REACH * max(max(frame["spans"]), 1e-12)
    share = np.sinh(FOCUS * np.linspace(-1, 1, MANY + 1)) / np.sinh(FOCUS) if many else np.linspace(-1, 1, CELLS + 1)
    down, right = (middle + half * share for middle in frame["centre"])
    places = np.stack(np.meshgrid(down, right, indexing="ij"), axis=-1).reshape(-1, 2)
    rest = np.hstack([np.linalg.solve(steps, (places - origin).T).T, np.zeros_like(places)])
    values = np.sum(energies(model, rest), axis=0)
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    values = np.where(np.isfinite(values), values, known.max())
    return {
        "down": [float(f"{x:.7g}") for x in down], "right": [float(f"{x:.7g}") for x in right],
        "levels": np.quantile(known, (0.01, 0.03, 0.07, 0.14, 0.25, 0.4)).tolist(),
        "data": base64_of(values),
    }  # fmt: skip


def _layout(model: Model) -> tuple[np.ndarray, np.ndarray] | None:
    """Where (down, right) the coordinates 0 are drawn and what a step in each adds; None where that is not all."""
    mechanical = model.rates is None and model.smooth and model.conservative and not model.forced
    if not mechanical or model.points is None or model.strokes or model.degrees_of_freedom != 2 or any(model.angles):
        return None
    q = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    points = positions(model, np.hstack([q, np.zeros_like(q)]))
    (at, first, second, both), single = points[:, :, 0], points.shape[2] == 1
    steps = np.column_stack([first - at, second - at])
    straight = np.allclose(both - at, steps.sum(axis=1)) and abs(np.linalg.det(steps)) > 1e-12
    return (at, steps) if single and straight else None
