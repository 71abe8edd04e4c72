"""AUTO-07p along a family: the same equations, the same first orbit, the same range of energy.

AUTO gets the C code that CasADi writes for the field and its derivatives (JAC = 1) and the unfolding as its free
parameter next to the period. Its steps are its own (IADS = 1); DS = DSMAX is sought, on the coarsest mesh and outside
the clock, such that it covers the range in as many points as asked for, because neighbouring orbits are cheaper than
distant ones. ISP = 1, ILP = 0: multipliers of every point and nothing located; ISP = 2, ILP = 1: special points
located too.
"""

from __future__ import annotations

import os
import resource
import subprocess
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np

from orbitfinder.families.start import Start, full_samples
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.integrate.rk8 import step_of, variational_field
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.model import energy, vector_field
from orbitfinder.orbits.evidence import ClosureCheck

AUTO = Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p"))
EVERY = 4
"""One of so many of AUTO's points is judged."""
STEPS = 800
"""Runge-Kutta steps of a period for the multipliers of AUTO's orbits"""
SEARCH = 8
"""Tries for DSMAX"""
EQUATIONS = """
#include "auto_f2c.h"
#include "field.c"
static int func(integer ndim, const doublereal *u, const integer *icp, const doublereal *par, integer ijac,
                doublereal *f, doublereal *dfdu, doublereal *dfdp) {{
  static double w[{work}]; static casadi_int iw[{integers}];
  const double *arg[{arguments}]; double *res[{results}];
  arg[0] = u; arg[1] = par; res[0] = f;
  if (ijac == 0) return field(arg, res, iw, w, 0);
  res[1] = dfdu; res[2] = dfdp;
  return slopes(arg, res, iw, w, 0);
}}
static int stpnt(integer ndim, doublereal t, doublereal *u, doublereal *par) {{ par[0] = 0.0; return 0; }}
static int bcnd() {{ return 0; }}
static int icnd() {{ return 0; }}
static int fopt() {{ return 0; }}
static int pvls(integer ndim, const doublereal *u, doublereal *par) {{ /* fort.8 has ten digits only */
  static FILE *stream = NULL;
  if (!stream) stream = fopen("points.txt", "w");
  for (integer i = 0; i < ndim; i++) fprintf(stream, "%.17g ", u[i]);
  fprintf(stream, "%.17g\\n", par[10]);
  fflush(stream);
  return 0;
}}
"""
CONSTANTS = """
dat = 'orbit'
unames = {{}}
parnames = {{1: 's', 11: 'PERIOD'}}
NDIM = {size}
IPS = 2
IRS = 0
ILP = {folds}
ICP = [11, 1]
NTST = {intervals}
NCOL = {order}
IAD = 3
ISP = {special}
ISW = 1
IPLT = 0
NBC = 0
NINT = 0
NMX = {points}
NPR = 5
MXBF = 0
IID = 0
ITMX = 8
ITNW = 7
NWTN = 3
JAC = 1
EPSL = 1e-12
EPSU = 1e-12
EPSS = 1e-8
DS = {step}
DSMIN = 1e-7
DSMAX = {longest}
IADS = 1
NPAR = 36
THL = {{11: 0.0}}
THU = {{}}
"""


@dataclass(frozen=True)
class Clock:
    """Wall time, or processor time of this process or of its children."""

    cpu: bool

    def __call__(self, children: bool = False) -> float:
        """Seconds."""
        if not self.cpu:
            return time.perf_counter()
        used = resource.getrusage(resource.RUSAGE_CHILDREN if children else resource.RUSAGE_SELF)
        return used.ru_utime + used.ru_stime


@dataclass(frozen=True)
class Run:
    """One method on one family: s a point, points, worst closure over its scale, energies covered (J)."""

    seconds: float
    points: int
    closure: float
    energies: tuple[float, float]
    detail: str = ""


@dataclass(frozen=True)
class Asked:
    """A run of AUTO: NMX, (NTST, NCOL), DS, number of threads (0: its own choice), whether events are located."""

    points: int
    mesh: tuple[int, int]
    step: float
    threads: int = 1
    events: bool = False


class AutoFamily:
    """The compiled AUTO program of one family in a folder of its own."""

    def __init__(self, folder: Path, start: Start, clock: Clock) -> None:
        self.folder, self.start, self.clock = folder, start, clock
        self.model = start.curve.equations.model
        self.first = energy(self.model, start.solution.place.nodes[0])
        prepare(folder, start)

    def go(self, asked: Asked) -> float:
        """One run; its seconds by the clock."""
        constants = CONSTANTS.format(
            size=2 * self.model.degrees_of_freedom, intervals=asked.mesh[0], order=asked.mesh[1], points=asked.points,
            step=asked.step, longest=abs(asked.step), folds=int(asked.events), special=1 + asked.events,
        )  # fmt: skip
        (self.folder / "c.orbit").write_text(constants)
        limited = os.environ | ({"OMP_NUM_THREADS": str(asked.threads)} if asked.threads else {})
        began = self.clock(children=True)
        with (self.folder / "c.orbit").open() as stream:
            subprocess.run(["./orbit.exe"], cwd=self.folder, stdin=stream, check=True, capture_output=True, env=limited)
        return self.clock(children=True) - began

    def energies(self) -> np.ndarray:
        """Of every point of the last run."""
        return np.array([energy(self.model, state) for state, _ in solutions(self.folder / "points.txt")])

    def stepping(self, mesh: tuple[int, int], points: int, last: float) -> Asked:
        """Steps with which AUTO goes from the first orbit to the energy `last` in about so many points."""
        step = 0.05
        self.go(Asked(3, mesh, step))
        if self.energies()[-1] < self.first:
            step = -step
        best = Asked(points, mesh, step)  # its energies in the table say so, should it not get there
        away = np.inf
        for _ in range(SEARCH):
            self.go(Asked(3 * points, mesh, step))
            beyond = np.flatnonzero(self.energies() >= last)
            needed = int(beyond[0]) + 1 if beyond.size else 4 * points
            if abs(needed - points) < away:
                best, away = Asked(min(needed, 3 * points), mesh, step), abs(needed - points)
            if away <= 0.05 * points:
                break
            step *= float(np.clip(needed / points, 0.3, 3.0))
        return best

    def judged(self, seconds: float, detail: str) -> Run:
        """The last run, its closures by an independent integration."""
        check, n = ClosureCheck(self.model), self.model.degrees_of_freedom
        energies = self.energies()
        closures = [
            check(state, period, np.zeros(n), 1e-15) / growth(self.start, state, period)
            for state, period in solutions(self.folder / "points.txt")[1::EVERY]
        ]
        computed = sum(1 for row in (self.folder / "fort.7").read_text().splitlines() if row.split()[0] != "0")
        return Run(seconds / computed, computed, max(closures), (energies[0], energies[-1]), detail)


def auto_runs(
    folder: Path,
    start: Start,
    asked: tuple[int, float],
    meshes: Sequence[tuple[int, int]],
    closure: float,
    repeats: Iterable[int],
    clock: Clock,
) -> dict[str, Run]:
    """AUTO on its coarsest mesh ("coarse"), on the first that closes as asked for ("auto"), and there with events.

    `asked` is (points, last energy).
    """
    program = AutoFamily(folder, start, clock)
    steps, found = program.stepping(meshes[0], *asked), {}
    for mesh in meshes:
        found["auto"] = best_of(program, replace(steps, mesh=mesh), repeats)
        found.setdefault("coarse", found["auto"])
        if found["auto"].closure <= closure:
            break
    found["auto events"] = best_of(program, replace(steps, mesh=mesh, events=True), repeats)
    return found


def best_of(program: AutoFamily, asked: Asked, repeats: Iterable[int]) -> Run:
    """With one thread and with AUTO's own number of them, whichever is faster."""
    timed = []
    for threads in (1,) if program.clock.cpu else (1, 0):
        timed.append((min(program.go(replace(asked, threads=threads)) for _ in repeats), threads))
    seconds, threads = min(timed)
    named = f"{asked.mesh[0]} x {asked.mesh[1]}, {'one thread' if threads else 'its threads'}"
    return program.judged(seconds, named)


def prepare(folder: Path, start: Start) -> None:
    """Equations and the first orbit, compiled and linked as AUTO's own makefile does."""
    model = start.curve.equations.model
    field = vector_field(model, (), NONE.unfolded(model))
    x, s = ca.SX.sym("x", field.size1_in(1)), ca.SX.sym("s")
    rate = field(0.0, x, s, ca.SX(0, 1))
    slopes = [rate, ca.densify(ca.jacobian(rate, x)), ca.densify(ca.jacobian(rate, s))]
    functions = ca.Function("field", [x, s], [ca.densify(rate)]), ca.Function("slopes", [x, s], ca.cse(slopes))
    generator = ca.CodeGenerator("field.c")
    for one in functions:
        generator.add(one)
    generator.generate(f"{folder}{os.sep}")
    sizes = {"work": 1 + max(one.sz_w() for one in functions), "integers": 1 + max(one.sz_iw() for one in functions),
             "arguments": 2 + max(one.sz_arg() for one in functions),
             "results": 3 + max(one.sz_res() for one in functions)}  # fmt: skip
    (folder / "orbit.c").write_text(EQUATIONS.format(**sizes))
    times, states = full_samples(start.curve, start.solution)
    rows = "\n".join(" ".join(f"{value:.17e}" for value in (t, *row)) for t, row in zip(times, states, strict=True))
    (folder / "orbit.dat").write_text(rows + "\n")
    build = ["gcc", "-O3", "-march=native", "-c", "orbit.c", "-o", "orbit.o"]
    objects = sorted(str(path) for path in (AUTO / "lib").glob("*.o"))
    link = ["gfortran", "-O3", "-std=legacy", "-fopenmp", "orbit.o", "-o", "orbit.exe", *objects, f"-L{AUTO / 'lib'}"]
    for command in (build, [*link, "-lauto_c"]):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)


def solutions(path: Path) -> list[tuple[np.ndarray, float]]:
    """(state at t = 0, period) of every point, as the user's PVLS wrote them: AUTO calls it twice for each."""
    rows = np.atleast_2d(np.loadtxt(path))
    fresh = np.append(True, np.any(rows[1:] != rows[:-1], axis=1))
    return [(row[:-1], float(row[-1])) for row in rows[fresh]]


def block(field: ca.Function, steps: int) -> ca.Function:
    """`block(z, p)` -> z = (t, y) after that many steps, with p = (h, s, free)."""
    step = step_of(field)
    z, p = ca.MX.sym("z", step.size1_in(0)), ca.MX.sym("p", step.size1_in(1))
    return ca.Function("block", [z, p], [step.fold(steps)(z, ca.repmat(p, 1, steps))])


def growth(start: Start, state: np.ndarray, period: float) -> float:
    """max(1, largest multiplier) of an orbit of AUTO's, from its own monodromy matrix."""
    varied, size = variational_field(build_flow(start.curve.equations.model).field), state.size
    begun = np.concatenate([[0.0], state, np.eye(size).ravel()])
    ended = block(varied, STEPS)(begun, [period / STEPS]).full().ravel()
    multipliers = np.linalg.eigvals(ended[1 + size :].reshape(size, size))
    return max(1.0, float(np.abs(multipliers).max()))
