"""AUTO-07p along the resonance curve of Duffing's oscillator: the same first orbit, the same range of frequency.

The drive is a limit cycle of two states more (AUTO's own demo `frc`), because its periodic orbits are of autonomous
systems; derivatives are given (JAC = 1). DS = DSMAX is sought, outside the clock, such that the curve is covered in
about as many points as asked for.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from peers.auto_family import AUTO, Asked, Clock

SEARCH = 8
"""Tries for DSMAX"""
EQUATIONS = """
#include "auto_f2c.h"
#include <stdio.h>
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
int bcnd() {{ return 0; }}
int icnd() {{ return 0; }}
int fopt() {{ return 0; }}
int pvls(integer ndim, const doublereal *u, doublereal *par) {{ /* fort.8 has ten digits only */
  static FILE *stream = NULL;
  if (!stream) stream = fopen("points.txt", "w");
  for (integer i = 0; i < ndim; i++) fprintf(stream, "%.17g ", u[i]);
  fprintf(stream, "%.17g %.17g\\n", par[10], par[0]);
  fflush(stream);
  return 0;
}}
"""
CONSTANTS = """
dat = 'orbit'
unames = {{}}
parnames = {{1: 'w', 11: 'PERIOD'}}
NDIM = 4
IPS = 2
IRS = 0
ILP = {folds}
ICP = [1, 11]
NTST = {intervals}
NCOL = {order}
IAD = 3
ISP = {special}
ISW = 1
IPLT = 0
NBC = 0
NINT = 0
NMX = {points}
NPR = 100000
MXBF = 0
IID = 0
ITMX = 8
ITNW = 7
NWTN = 3
JAC = 1
EPSL = 1e-12
EPSU = 1e-12
EPSS = 1e-10
DS = {step}
DSMIN = 1e-7
DSMAX = {step}
IADS = 1
NPAR = 36
THL = {{11: 0.0}}
THU = {{}}
UZSTOP = {{1: {last}}}
"""


@dataclass(frozen=True)
class Curve:
    """A resonance curve: s a point, (x, v, phase of the drive, period, frequency) of every point."""

    seconds: float
    points: np.ndarray

    @property
    def folds(self) -> np.ndarray:
        """The frequencies at which it turns, as located among its points."""
        w = self.points[:, 4]
        return np.array([b for a, b, c in zip(w, w[1:], w[2:], strict=False) if (b - a) * (c - b) < 0])


class AutoForced:
    """The compiled AUTO program of one oscillator in its own folder; `orbit` is (t, x, v) over the first period."""

    def __init__(
        self, folder: Path, numbers: Mapping[str, float], orbit: np.ndarray, last: float, clock: Clock
    ) -> None:
        self.folder, self.last, self.clock = folder, last, clock
        (folder / "duffing.c").write_text(EQUATIONS.format(**{name: repr(float(one)) for name, one in numbers.items()}))
        drive = numbers["frequency"] * orbit[:, 0]
        table = np.column_stack([orbit, np.cos(drive), np.sin(drive)])
        (folder / "orbit.dat").write_text("\n".join(" ".join(f"{one:.17e}" for one in row) for row in table) + "\n")
        build = ["gcc", "-O3", "-march=native", "-c", "duffing.c", "-o", "duffing.o"]
        objects = sorted(str(path) for path in (AUTO / "lib").glob("*.o"))
        link = ["gfortran", "-O3", "-std=legacy", "-fopenmp", "duffing.o", "-o", "duffing.exe", *objects]
        for command in (build, [*link, f"-L{AUTO / 'lib'}", "-lauto_c"]):
            subprocess.run(command, cwd=folder, check=True, capture_output=True)

    def go(self, asked: Asked) -> Curve:
        """One run."""
        constants = CONSTANTS.format(
            intervals=asked.mesh[0], order=asked.mesh[1], points=asked.points, step=asked.step,
            folds=int(asked.events), special=1 + asked.events, last=self.last,
        )  # fmt: skip
        (self.folder / "c.orbit").write_text(constants)
        limited = os.environ | ({"OMP_NUM_THREADS": str(asked.threads)} if asked.threads else {})
        began = self.clock(children=True)
        with (self.folder / "c.orbit").open() as stream:
            subprocess.run(
                ["./duffing.exe"], cwd=self.folder, stdin=stream, check=True, capture_output=True, env=limited
            )
        seconds = self.clock(children=True) - began
        rows = np.atleast_2d(np.loadtxt(self.folder / "points.txt"))
        rows = rows[np.append(True, np.any(rows[1:] != rows[:-1], axis=1))]
        points = np.column_stack([rows[:, :2], np.arctan2(rows[:, 3], rows[:, 2]), rows[:, 4:]])
        return Curve(seconds / len(points), points)

    def stepping(self, mesh: tuple[int, int], points: int) -> Asked:
        """Steps with which AUTO covers the curve in about so many points."""
        step, best, away = 0.1, Asked(4 * points, mesh, 0.1), np.inf
        for _ in range(SEARCH):
            asked = Asked(4 * points, mesh, step)
            found = len(self.go(asked).points)
            if abs(found - points) < away:
                best, away = asked, abs(found - points)
            if away <= 0.03 * points:
                break
            step *= found / points
        return best

    def best(self, asked: Asked, repeats: int) -> Curve:
        """With one thread and, by the wall clock, with AUTO's own number of them, whichever is faster."""
        threads = (1,) if self.clock.cpu else (1, 0)
        runs = [self.go(replace(asked, threads=count)) for count in threads for _ in range(repeats)]
        return min(runs, key=lambda one: one.seconds)
