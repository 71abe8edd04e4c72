"""AUTO-07p along curves of bifurcations in two parameters: folds of Duffing's oscillator, doublings of two pendula.

The first run goes from our orbit to the event by AUTO's own means, the second, of which the time is told, frees the
second parameter (ISW = 2). Derivatives are given (JAC = 1). The drive of the oscillator is a limit cycle of two states
more (AUTO's demo `frc`); the pendula, AUTO's demo `pen`, run round, which AUTO sees from its first orbit.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import KroghInterpolator

from peers.auto_family import AUTO, Clock

PROGRAM = """
#include "auto_f2c.h"
#include <math.h>
#include <stdio.h>
int func(integer ndim, const doublereal *u, const integer *icp, const doublereal *par, integer ijac,
         doublereal *f, doublereal *dfdu, doublereal *dfdp) {{
{equations}
  return 0;
}}
int stpnt(integer ndim, doublereal t, doublereal *u, doublereal *par) {{
  par[0] = {first}; par[1] = {second}; return 0;
}}
int bcnd() {{ return 0; }}
int icnd() {{ return 0; }}
int fopt() {{ return 0; }}
int pvls(integer ndim, const doublereal *u, doublereal *par) {{ /* fort.8 has ten digits only */
  static FILE *stream = NULL;
  if (!stream) stream = fopen("points.txt", "w");
  fprintf(stream, "%.17g %.17g %.17g\\n", par[0], par[1], par[10]);
  fflush(stream);
  return 0;
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
CONSTANTS = """
{dat}
unames = {{}}
parnames = {{11: 'PERIOD'}}
NDIM = 4
IPS = 2
IRS = {label}
ILP = {folds}
ICP = {free}
NTST = {intervals}
NCOL = {order}
IAD = 3
ISP = {special}
ISW = {switch}
IPLT = 0
NBC = 0
NINT = 0
NMX = {points}
NPR = 100000
MXBF = 0
IID = 2
ITMX = 20
ITNW = 9
NWTN = 3
JAC = 1
EPSL = 1e-11
EPSU = 1e-11
EPSS = 1e-9
DS = {step}
DSMIN = 1e-9
DSMAX = {longest}
IADS = 1
NPAR = 36
THL = {{11: 0.0}}
THU = {{}}
"""
APART = 1e-4
"""Points nearer than this to each other are one for an interpolation."""
TYPES = {"fold": 5, "period_doubling": 7}
"""AUTO's numbers of the events, as in fort.7"""


@dataclass(frozen=True)
class Locus:
    """What AUTO found: s a point, and (first, second parameter, period) of every point."""

    seconds: float
    points: np.ndarray

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
    """The compiled AUTO program of one system; `orbit` is (t, x ...) over a period at the parameters `start`."""

    def __init__(self, folder: Path, equations: str, orbit: np.ndarray, start: tuple[float, float], clock: Clock):
        self.folder, self.clock = folder, clock
        first, second = (repr(float(one)) for one in start)
        (folder / "curve.c").write_text(PROGRAM.format(equations=equations, first=first, second=second))
        (folder / "orbit.dat").write_text("\n".join(" ".join(f"{one:.17e}" for one in row) for row in orbit) + "\n")
        build = ["gcc", "-O3", "-march=native", "-c", "curve.c", "-o", "curve.o"]
        objects = sorted(str(path) for path in (AUTO / "lib").glob("*.o"))
        link = ["gfortran", "-O3", "-std=legacy", "-fopenmp", "curve.o", "-o", "curve.exe", *objects]
        for command in (build, [*link, f"-L{AUTO / 'lib'}", "-lauto_c", "-lm"]):
            subprocess.run(command, cwd=folder, check=True, capture_output=True)

    def reach(self, kind: str, mesh: tuple[int, int], step: float) -> int:
        """The first run, to the first event of a kind, and the short one from there that AUTO makes a start of.

        The label of the start, which is left in fort.3.
        """
        asked = {"dat": "dat = 'orbit'", "label": 0, "folds": 1, "free": "[1, 11]", "special": 2, "switch": 1,
                 "points": 300, "step": step, "longest": 2 * abs(step)}  # fmt: skip
        self._go(asked, mesh, f"STOP = ['{'LP' if kind == 'fold' else 'PD'}1']")
        label = next(label for kind_there, label in self._labels() if kind_there == TYPES[kind])
        self.follow(label, mesh, abs(step), (1e3,))
        return max(label for _, label in self._labels())

    def _labels(self) -> list[tuple[int, int]]:
        """Type and label of every solution of the last run, whose file the next one begins from."""
        shutil.copy(self.folder / "fort.8", self.folder / "fort.3")
        rows = [row.split() for row in (self.folder / "fort.7").read_text().splitlines()]
        return [(abs(int(row[2])) % 10, int(row[3])) for row in rows if row[0] != "0" and int(row[3])]

    def follow(self, label: int, mesh: tuple[int, int], step: float, values: tuple[float, ...]) -> Locus:
        """The second run until the second parameter has the last of these values, exact at each of them."""
        asked = {"dat": "", "label": label, "folds": 0, "free": "[1, 11, 2]", "special": 0, "switch": 2,
                 "points": 1000, "step": step, "longest": 10 * abs(step)}  # fmt: skip
        more = f"UZR = {{2: {list(values[:-1])}}}\n" if values[:-1] else ""
        seconds = self._go(asked, mesh, f"{more}UZSTOP = {{2: {values[-1]}}}")
        rows = np.atleast_2d(np.loadtxt(self.folder / "points.txt"))
        rows = rows[np.append(True, np.any(rows[1:] != rows[:-1], axis=1))]
        return Locus(seconds / len(rows), rows)

    def _go(self, asked: dict[str, object], mesh: tuple[int, int], more: str) -> float:
        text = CONSTANTS.format(**asked, intervals=mesh[0], order=mesh[1]) + more + "\n"
        (self.folder / "c.curve").write_text(text)
        limited = os.environ | {"OMP_NUM_THREADS": "1"}
        began = self.clock(children=True)
        with (self.folder / "c.curve").open() as stream:
            subprocess.run(["./curve.exe"], cwd=self.folder, stdin=stream, check=True, capture_output=True, env=limited)
        return self.clock(children=True) - began
