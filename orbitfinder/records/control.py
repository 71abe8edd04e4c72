"""The `control` entry of an orbit.json: how controls vary along a motion, what was asked of it and what it costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbitfinder.records.reading import Table, typed

DEGREES = {"zero-order": 0, "linear": 1, "cubic": 3}
"""Of the splines that controls may be"""
SHAPES = (*DEGREES, "fourier")
MOST = {"intervals": 2000, "harmonics": 200, "arcs": 1000, "points": 1000}


@dataclass(frozen=True)
class _ControlEntry:
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
    tasks: tuple[Table, ...]
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
    control = typed(_ControlEntry, value, "control")
    for name, most in MOST.items():
        least = int(name in ("intervals", "points"))
        if not least <= getattr(control, name) <= most:
            raise ValueError(f"control.{name}: {getattr(control, name)}, not from {least} to {most}")
    if control.shape not in SHAPES or not control.names or not all(map(str.isidentifier, control.names)):
        raise ValueError(f"control.shape or names: {control.shape[:40]!r}, {ascii(control.names)[:60]}")
    wanted = {"coefficients": (len(control.names), _whole(control)), "costate": (size,),
              "normals": (len(control.normals), size) if len(control.normals) else (0,)}  # fmt: skip
    for name, shape in wanted.items():
        given = getattr(control, name)
        if given.shape != shape or np.abs(given).max(initial=0.0) > 1e100:
            raise ValueError(f"control.{name}: {given.shape} numbers where {shape} belong, up to 1e+100")
    shares = list(control.shares.values())
    if len(shares) != max(control.arcs - 1, 0) or not all(0 < share < 1 for share in (*shares, sum(shares) or 0.5)):
        raise ValueError(f"control.shares: {shares[:9]}, no shares of {control.arcs} arcs")


def _whole(control: _ControlEntry) -> int:
    """Coefficients of a control over the period."""
    if control.shape == "fourier":
        return 1 + 2 * control.harmonics
    return control.arcs * (control.intervals + DEGREES[control.shape]) or control.intervals
