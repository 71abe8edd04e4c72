"""The `control` entry of an orbit.json: how controls vary along a motion, what was asked of it and what it costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbitfinder.records.reading import typed

DEGREES = {"zero-order": 0, "linear": 1, "cubic": 3}
"""Of the splines that controls may be"""
SHAPES = (*DEGREES, "fourier")
LARGEST = 1e100
MOST = {"intervals": 2000, "harmonics": 200, "arcs": 1000, "points": 1000}


@dataclass(frozen=True)
class _Entry:
    """What `orbits.control` writes, entry by entry."""

    names: tuple[str, ...]
    shape: str
    intervals: int
    harmonics: int
    coefficients: np.ndarray
    limits: Mapping[str, tuple[float, float]]
    cost_of: str
    average: bool
    final: str
    tasks: tuple[Mapping[str, Any], ...]
    points: int
    method: str
    free: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]]
    pins: tuple[str, ...]
    normals: np.ndarray
    shares: Mapping[str, float]
    cost: float
    multipliers: Mapping[str, float]
    costate: np.ndarray
    arcs: int = 0
    numbers: Mapping[str, float] = field(default_factory=dict)


def check_control(value: Any, size: int) -> None:
    """`ValueError` about what is wrong in the entry of an orbit whose state has `size` numbers."""
    found = typed(_Entry, value, "control")
    for name, most in MOST.items():
        least = int(name in ("intervals", "points"))
        if not least <= getattr(found, name) <= most:
            raise ValueError(f"control.{name}: {getattr(found, name)}, not from {least} to {most}")
    if found.shape not in SHAPES or not found.names or not all(one.isidentifier() for one in found.names):
        raise ValueError(f"control.shape or names: {found.shape[:40]!r}, {ascii(found.names)[:60]}")
    wanted = {"coefficients": (len(found.names), _whole(found)), "costate": (size,),
              "normals": (len(found.normals), size) if len(found.normals) else (0,)}  # fmt: skip
    for name, shape in wanted.items():
        given = getattr(found, name)
        if given.shape != shape or np.abs(given).max(initial=0.0) > LARGEST:
            raise ValueError(f"control.{name}: {given.shape} numbers where {shape} belong, up to {LARGEST:g}")
    shares = list(found.shares.values())
    if len(shares) != max(found.arcs - 1, 0) or not all(0 < one < 1 for one in (*shares, sum(shares) or 0.5)):
        raise ValueError(f"control.shares: {shares[:9]}, no shares of {found.arcs} arcs")


def _whole(found: _Entry) -> int:
    """Coefficients of one control over the period."""
    if found.shape == "fourier":
        return 1 + 2 * found.harmonics
    return found.arcs * (found.intervals + DEGREES[found.shape]) or found.intervals
