"""AUTO-07p along curves of bifurcations in two parameters: folds of Duffing's oscillator, doublings of two pendula.

The first run goes from our orbit to the event by AUTO's own means, the second, of which the time is told, frees the
second parameter (ISW = 2), its events located. The drive of the oscillator is a limit cycle of two states more (AUTO's
demo `frc`); the pendula, AUTO's demo `pen`, run round, which AUTO sees from its first orbit.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import KroghInterpolator

from peers.program import Program
from peers.task import Unavailable

PROGRAM = """
int func(integer ndim, const doublereal *u, const integer *icp, const doublereal *par, integer ijac,
         doublereal *f, doublereal *dfdu, doublereal *dfdp) {{
{equations}
  return 0;
}}
int stpnt(integer ndim, doublereal t, doublereal *u, doublereal *par) {{
  par[0] = {first}; par[1] = {second}; return 0;
}}
"""
DUFFING = """
  const double x = u[0], v = u[1], c = u[2], s = u[3], w = par[0], F = par[1], r = 1 - c * c - s * s;
  f[0] = v;
  f[1] = F * c - 0.1 * v - x - x * x * x;
  f[2] = r * c - w * s;
  f[3] = r * s + w * c;
  if (ijac == 0) return 0;
  const double by[16] = {0, -1 - 3 * x * x, 0, 0,  1, -0.1, 0, 0,
                         0, F, r - 2 * c * c, w - 2 * c * s,  0, 0, -w - 2 * c * s, r - 2 * s * s};
  for (int i = 0; i < 16; i++) dfdu[i] = by[i];
  if (ijac == 1) return 0;
  for (int i = 0; i < 8; i++) dfdp[i] = 0;
  dfdp[2] = -s; dfdp[3] = c; dfdp[5] = c;
"""
PENDULA = """
  const double I = par[0], eps = par[1], gamma = 0.175;
  f[0] = u[2]; f[2] = I - eps * u[2] - sin(u[0]) + gamma * (u[1] - u[0]);
  f[1] = u[3]; f[3] = I - eps * u[3] - sin(u[1]) + gamma * (u[0] - u[1]);
  if (ijac == 0) return 0;
  const double by[16] = {0, 0, -cos(u[0]) - gamma, gamma,  0, 0, gamma, -cos(u[1]) - gamma,
                         1, 0, -eps, 0,  0, 1, 0, -eps};
  for (int i = 0; i < 16; i++) dfdu[i] = by[i];
  if (ijac == 1) return 0;
  for (int i = 0; i < 8; i++) dfdp[i] = 0;
  dfdp[2] = dfdp[3] = 1; dfdp[6] = -u[2]; dfdp[7] = -u[3];
"""
CLOSER: dict[str, Any] = {"IID": 2, "ITMX": 20, "ITNW": 9, "EPSL": 1e-11, "EPSU": 1e-11, "EPSS": 1e-9, "DSMIN": 1e-9}
"""AUTO's constants where they are not the usual ones"""
APART = 1e-4
"""Points nearer than this to each other are one for an interpolation."""
TYPES = {"fold": 5, "period_doubling": 7}
"""AUTO's numbers of the events, as in fort.7"""
PLAIN = {0, 4, 9}
"""... of points that are none: ordinary, asked for, ends that did not converge"""


@dataclass(frozen=True)
class Locus:
    """A curve: (first, second parameter, period, states) of every point, and how many special ones it located."""

    points: np.ndarray
    special: int

    def at(self, second: float) -> float:
        """The first parameter where the second has a value, between the five points nearest to it.

        AUTO ends within some 1e-5 of what it was asked for.
        """
        chosen: list[np.ndarray] = []
        for row in self.points[np.argsort(np.abs(self.points[:, 1] - second))]:
            if all(abs(row[1] - one[1]) > APART for one in chosen):
                chosen.append(row)
        first, other = np.array(chosen[:5])[:, :2].T
        return float(KroghInterpolator(other, first)(second))


class AutoLocus:
    """AUTO's program of one system; `orbit` is (t, x ...) over a period at the parameters `start`."""

    def __init__(self, folder: Path, equations: str, orbit: np.ndarray, start: tuple[float, float]) -> None:
        first, second = (repr(float(one)) for one in start)
        self.folder = folder
        self.program = Program(folder, PROGRAM.format(equations=equations, first=first, second=second), orbit)

    def reach(self, kind: str, mesh: tuple[int, int], step: float) -> int:
        """The first run, to the first event of a kind, and the short one from there that AUTO makes a start of.

        The label of the start, which is left in fort.3.
        """
        stop = [f"{'LP' if kind == 'fold' else 'PD'}1"]
        self.program.run(mesh, ICP=[1, 11], ILP=1, ISP=2, NMX=300, DS=step, DSMAX=2 * abs(step), STOP=stop, **CLOSER)
        labels = [label for type_, label in self._labels() if type_ == TYPES[kind]]
        if not labels:
            raise Unavailable(f"AUTO-07p: no {kind} met")
        self.follow(labels[0], mesh, abs(step), 1e3)
        return max(label for _, label in self._labels())

    def _labels(self) -> list[tuple[int, int]]:
        """Type and label of every solution of the last run, whose file the next one begins from."""
        shutil.copy(self.folder / "fort.8", self.folder / "fort.3")
        return [(abs(int(row[2])) % 10, int(row[3])) for row in self.program.table() if int(row[3])]

    def follow(self, label: int, mesh: tuple[int, int], step: float, last: float) -> tuple[float, Locus]:
        """The second run until the second parameter has a value: seconds a point, and the curve."""
        seconds, rows = self.program.run(
            mesh, dat=None, IRS=label, ICP=[1, 11, 2], ILP=1, ISP=2, ISW=2, NMX=1000, DS=step, DSMAX=10 * abs(step),
            UZSTOP={2: last}, **CLOSER,
        )  # fmt: skip
        special = sum(abs(int(row[2])) % 10 not in PLAIN for row in self.program.table())
        return seconds, Locus(rows[:, [-2, -1, -3, 0, 1, 2, 3]], special)
