"""AUTO-07p along the resonance curve of Duffing's oscillator: the same first orbit, the same range of frequency.

The drive is a limit cycle of two states more (AUTO's own demo `frc`), because its periodic orbits are of autonomous
systems; events are located (ISP = 2, ILP = 1). DS = DSMAX is sought, outside the clock, such that the curve is covered
in about as many points as asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from peers.program import Program

SEARCH = 8
"""Tries for DSMAX"""
EQUATIONS = """
int func(integer ndim, const doublereal *u, const integer *icp, const doublereal *par, integer ijac,
         doublereal *f, doublereal *dfdu, doublereal *dfdp) {{
  const double x = u[0], v = u[1], c = u[2], s = u[3], w = par[0], r = 1 - c * c - s * s;
  f[0] = v;
  f[1] = {force} * c - {damping} * v - {stiffness} * x - {cubic} * x * x * x;
  f[2] = r * c - w * s;
  f[3] = r * s + w * c;
  if (ijac == 0) return 0;
  const double by[16] = {{0, -{stiffness} - 3 * {cubic} * x * x, 0, 0,  1, -{damping}, 0, 0,
                         0, {force}, r - 2 * c * c, w - 2 * c * s,  0, 0, -w - 2 * c * s, r - 2 * s * s}};
  for (int i = 0; i < 16; i++) dfdu[i] = by[i];
  if (ijac == 1) return 0;
  dfdp[0] = dfdp[1] = 0; dfdp[2] = -s; dfdp[3] = c;
  return 0;
}}
int stpnt(integer ndim, doublereal t, doublereal *u, doublereal *par) {{ par[0] = {frequency}; return 0; }}
"""


@dataclass(frozen=True)
class Curve:
    """A resonance curve: (x, v, phase of the drive, period, frequency) of every point."""

    points: np.ndarray

    @property
    def folds(self) -> np.ndarray:
        """The frequencies at which it turns, as located among its points."""
        w = self.points[:, 4]
        return np.array([b for a, b, c in zip(w, w[1:], w[2:], strict=False) if (b - a) * (c - b) < 0])


class AutoForced:
    """AUTO's program of one oscillator; `orbit` is (t, x, v) over the first period."""

    def __init__(self, folder: Path, numbers: Mapping[str, float], orbit: np.ndarray, last: float) -> None:
        equations = EQUATIONS.format(**{name: repr(float(one)) for name, one in numbers.items()})
        drive, self.last = numbers["frequency"] * orbit[:, 0], last
        self.program = Program(folder, equations, np.column_stack([orbit, np.cos(drive), np.sin(drive)]))

    def go(self, mesh: tuple[int, int], points: int, step: float) -> tuple[float, Curve]:
        """One run: seconds a point, and what it found."""
        seconds, rows = self.program.run(
            mesh, ICP=[1, 11], ILP=1, ISP=2, NMX=points, DS=step, DSMAX=step, UZSTOP={1: self.last}
        )
        phase = np.arctan2(rows[:, 3], rows[:, 2])
        return seconds, Curve(np.column_stack([rows[:, :2], phase, rows[:, 4:6]]))

    def stepping(self, mesh: tuple[int, int], points: int) -> tuple[int, float]:
        """NMX and the step with which AUTO covers the curve in about so many points."""
        step, best, away = 0.1, 0.1, np.inf
        for _ in range(SEARCH):
            met = len(self.go(mesh, 4 * points, step)[1].points)
            if abs(met - points) < away:
                best, away = step, abs(met - points)
            if away <= 0.03 * points:
                break
            step *= met / points
        return 4 * points, best
