"""A program of AUTO-07p: equations in C, compiled and linked as AUTO's own makefile does, run with one thread.

EPSL = EPSU = 1e-12, derivatives given (JAC = 1), AUTO's own steps (IADS = 1) up to DSMAX. Orbits are written with all
digits by the user's PVLS, because fort.8 has ten only.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from turns import processor_time

from peers.task import Unavailable

AUTO = Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p"))
LIMIT = 300.0
"""s after which a run is ended"""
DIGITS = 1e-10
"""... of a number in fort.7"""
FUNCTIONS = """
int bcnd() { return 0; }
int icnd() { return 0; }
int fopt() { return 0; }
int pvls(integer ndim, const doublereal *u, doublereal *par) {
  static FILE *stream = NULL;
  if (!stream) stream = fopen("points.txt", "w");
  for (integer i = 0; i < ndim; i++) fprintf(stream, "%.17g ", u[i]);
  fprintf(stream, "%.17g %.17g %.17g\\n", par[10], par[0], par[1]);
  fflush(stream);
  return 0;
}
"""
USUAL: dict[str, Any] = {
    "dat": "'orbit'", "unames": "{}", "parnames": "{11: 'PERIOD'}", "IPS": 2, "IRS": 0, "ILP": 0, "IAD": 3, "ISP": 1,
    "ISW": 1, "IPLT": 0, "NBC": 0, "NINT": 0, "NPR": 100000, "MXBF": 0, "IID": 0, "ITMX": 8, "ITNW": 7, "NWTN": 3,
    "JAC": 1, "EPSL": 1e-12, "EPSU": 1e-12, "EPSS": 1e-10, "DSMIN": 1e-7, "IADS": 1, "NPAR": 36, "THL": "{11: 0.0}",
    "THU": "{}",
}  # fmt: skip
"""AUTO's constants where a run does not say otherwise"""


def needed() -> None:
    """`SystemExit` where AUTO-07p is not installed."""
    if shutil.which("gfortran") is None or not (AUTO / "lib").is_dir():
        raise SystemExit(f"AUTO-07p is needed in {AUTO} (Debian: auto-07p, gfortran); set AUTO_DIR")


class Program:
    """The compiled program of one system of `size` states in a folder of its own.

    `equations` are C functions func and stpnt, `orbit` the first orbit, rows of (t, states).
    """

    def __init__(self, folder: Path, equations: str, orbit: np.ndarray) -> None:
        self.folder, self.size = folder, orbit.shape[1] - 1
        head = '#include "auto_f2c.h"\n#include <math.h>\n#include <stdio.h>\n'
        (folder / "orbit.c").write_text(head + equations + FUNCTIONS)
        (folder / "orbit.dat").write_text("\n".join(" ".join(f"{one:.17e}" for one in row) for row in orbit) + "\n")
        objects = sorted(str(path) for path in (AUTO / "lib").glob("*.o"))
        build = ["gcc", "-O3", "-march=native", "-c", "orbit.c", "-o", "orbit.o"]
        link = ["gfortran", "-O3", "-std=legacy", "-fopenmp", "orbit.o", "-o", "orbit.exe", *objects]
        for command in (build, [*link, f"-L{AUTO / 'lib'}", "-lauto_c", "-lm"]):
            subprocess.run(command, cwd=folder, check=True, capture_output=True)

    def run(self, mesh: tuple[int, int], **constants: Any) -> tuple[float, np.ndarray]:
        """Seconds a point on a mesh of NTST x NCOL, and (states, period, PAR(1), PAR(2)) of its points, a row each.

        Raises `Unavailable`, with AUTO's last words, where it fails.
        """
        given = USUAL | {"NDIM": self.size, "NTST": mesh[0], "NCOL": mesh[1]} | constants
        lines = [f"{name} = {value}\n" for name, value in given.items() if value is not None]
        (self.folder / "c.orbit").write_text("".join(lines))
        points = self.folder / "points.txt"
        points.unlink(missing_ok=True)
        began = processor_time(children=True)
        with (self.folder / "c.orbit").open() as stream:
            try:
                done = subprocess.run(["./orbit.exe"], cwd=self.folder, stdin=stream, capture_output=True, text=True,
                                      env=os.environ | {"OMP_NUM_THREADS": "1"}, timeout=LIMIT)  # fmt: skip
            except subprocess.TimeoutExpired:
                raise Unavailable(f"AUTO-07p: not finished after {LIMIT:g} s") from None
        seconds = processor_time(children=True) - began
        if done.returncode or not points.exists():
            words = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
            raise Unavailable(f"AUTO-07p: exit code {done.returncode}, {words[-1].strip()[:120]}")
        rows = self._accepted(np.atleast_2d(np.loadtxt(points)), {11: self.size}.get(given["ICP"][0], self.size + 1))
        return seconds / len(rows), rows

    def table(self) -> list[list[str]]:
        """The points of the last run as its fort.7 has them, in words: branch, point, type, label, parameter ..."""
        rows = [row.split() for row in (self.folder / "fort.7").read_text().splitlines()]
        return [row for row in rows if row[0] != "0"]

    def _accepted(self, rows: np.ndarray, column: int) -> np.ndarray:
        """Those that fort.7 has, to its eleven digits: PVLS is called twice for each, and while events are located."""
        kept, k = [], 0
        for words in self.table():
            near = np.abs(rows[k:, column] - float(words[4])) <= DIGITS * abs(float(words[4]))
            if near.any():
                first = int(np.argmax(near))
                k += first + int(np.argmin(np.append(near[first:], False)))
                kept.append(rows[k - 1])
        return np.array(kept)
