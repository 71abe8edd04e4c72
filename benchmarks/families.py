"""Cost of a family's points: orbitfinder, compiled and interpreted, against AUTO-07p on the same equations.

AUTO gets the C code that CasADi writes for the field and its derivatives (JAC = 1), the unfolding as its
free parameter next to the period and the same first orbit; its time is that of the whole run divided by
the points. orbitfinder's is that of `follow` without the deferred certificate, multipliers included, first
without and then with the location of events. AUTO gets twice the points and longer steps than usual, to
cover nearly the same energies, without which its orbits are the easier ones. Closures of both are judged by
one integration: DOP853 at its tightest on Hamilton's equations, divided by max(1, largest multiplier).

    python benchmarks/families.py             writes results/benchmarks/families.md
    python benchmarks/families.py --quick     three families, 20 points
    python benchmarks/families.py --cpu       processor time on one thread for both, for a busy machine
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from orbitfinder.compiled import compiling
from orbitfinder.families.closure import closure_check
from orbitfinder.families.continuation import follow
from orbitfinder.families.normal_modes import mode_problem
from orbitfinder.families.points import FamilyPoint, FamilySettings
from orbitfinder.families.start import Start, begin, full_samples
from orbitfinder.families.walk import Walk, first_point
from orbitfinder.flow import vector_field
from orbitfinder.mechanics.chain import chain
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.periodic.conditions import SYMMETRIES, unfolded_invariants

ROOT = Path(__file__).parents[1]
AUTO = Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p"))
POINTS = 40
REPEATS = 2
MESHES = ((50, 4), (100, 4), (200, 4), (100, 7))
"""(NTST, NCOL) that AUTO is tried with; the cheapest one whose closures are as asked for is its time."""
CLOSURE = 1e-11
EVERY = 4
"""One of so many of AUTO's points is judged."""
SYMMETRIC_WANTED, GENERAL_WANTED, INTERPRETED_WANTED = 1.0, 1.5, 5.0


@dataclass(frozen=True)
class Case:
    """A family: links, linear mode, amplitude of the first orbit (rad) and the formulation it is followed in."""

    links: int
    mode: int
    amplitude: float
    symmetry: str

    @property
    def name(self) -> str:
        """In words."""
        return f"{('', '', 'double', 'triple', 'quadruple')[self.links]} mode {self.mode}, {self.symmetry}"


CASES = (
    *(Case(3, mode, 0.3, "brake+reflection") for mode in (1, 2, 3)),
    *(Case(4, mode, 0.3, "brake+reflection") for mode in (1, 2, 3, 4)),
    Case(3, 2, 0.3, "brake"),
    *(Case(3, mode, 0.3, "none") for mode in (1, 2, 3)),
    *(Case(4, mode, 0.3, "none") for mode in (2, 3, 4)),
)


@dataclass(frozen=True)
class Run:
    """One method on one family: s a point, points, worst closure over its scale, energies covered (J)."""

    seconds: float
    points: int
    closure: float
    energies: tuple[float, float]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--cpu", action="store_true")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    chosen = parser.parse_args()
    if shutil.which("gfortran") is None or not (AUTO / "lib").is_dir():
        sys.exit(f"AUTO-07p is needed in {AUTO} (Debian: auto-07p, gfortran); set AUTO_DIR")
    cases, points = (CASES, POINTS) if not chosen.quick else ((CASES[1], CASES[4], CASES[-4]), 20)
    rows = []
    for case in cases:
        rows.append(measured(case, points, Clock(chosen.cpu)))
        print(line(*rows[-1]), flush=True)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "families.md").write_text(page(rows, chosen.cpu), encoding="utf-8")


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


def measured(case: Case, points: int, clock: Clock) -> tuple[Case, dict[str, Run]]:
    """Every method on one family."""
    model = chain(case.links)
    found: dict[str, Run] = {}
    with compiling("off"):
        start = begin(mode_problem(model, case.mode, case.amplitude), symmetry=case.symmetry)
        found["interpreted"] = ours(start, points, clock, events=False)
    with compiling("on"):
        start = begin(mode_problem(model, case.mode, case.amplitude), symmetry=case.symmetry)
        found["compiled"] = ours(start, points, clock, events=False)
        found["events"] = ours(start, points, clock, events=True)
    for mesh in MESHES:
        found["auto"] = auto(start, 2 * points, mesh, clock)  # its steps are shorter
        found.setdefault("coarse", found["auto"])
        if found["auto"].closure <= CLOSURE:
            break
    return case, found


def ours(start: Start, points: int, clock: Clock, events: bool) -> Run:
    """orbitfinder without the independent check, which is made after the clock has stopped."""
    settings = FamilySettings(events=events, certify=False, points=points)
    origin = first_point(start, settings, None)
    walk = Walk(start.curve, settings, 1, origin)
    next(iter(follow(walk)))  # functions of the first mesh are built here
    taken = []
    for _ in range(REPEATS):
        began = clock()
        found = [point for batch in follow(walk) for point in batch.points]
        taken.append(clock() - began)
    seconds = min(taken)
    closures = judged(start.curve.propagator.model, found)
    return Run(seconds / len(found), len(found), closures, (found[0].energy, found[-1].energy))


def judged(model: Model, points: Iterable[FamilyPoint]) -> float:
    """Worst closure over max(1, largest multiplier)."""
    check, turns = closure_check(model), np.zeros(model.degrees_of_freedom)
    return max(check(point.state, point.period, turns, 1e-15) / point.scale for point in points)


# ---- AUTO ------------------------------------------------------------------------------------------

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
ILP = 1
ICP = [11, 1]
NTST = {intervals}
NCOL = {order}
IAD = 3
ISP = 2
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
DSMAX = 0.5
IADS = 1
NPAR = 36
THL = {{11: 0.0}}
THU = {{}}
"""


def auto(start: Start, points: int, mesh: tuple[int, int], clock: Clock) -> Run:
    """AUTO's own run from the same first orbit, in the direction in which the energy grows."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder, start)
        began = energy(start.curve.propagator.model, start.found.place.nodes[0])
        tried = auto_run(folder, start, (11, MESHES[0], 0.01), 1, clock)
        step = 0.01 if tried.energies[1] > began else -0.01
        return auto_run(folder, start, (points, mesh, 5 * step), REPEATS, clock)


def auto_run(folder: Path, start: Start, asked: tuple[int, tuple[int, int], float], repeats: int, clock: Clock) -> Run:
    """Runs with (points, (NTST, NCOL), first step)."""
    model, (points, (intervals, order), step) = start.curve.propagator.model, asked
    size = 2 * model.degrees_of_freedom
    constants = CONSTANTS.format(size=size, intervals=intervals, order=order, points=points, step=step)
    (folder / "c.orbit").write_text(constants)
    threads = os.environ | ({"OMP_NUM_THREADS": "1"} if clock.cpu else {})
    taken = []
    for _ in range(repeats):
        began = clock(children=True)
        with (folder / "c.orbit").open() as stream:
            subprocess.run(["./orbit.exe"], cwd=folder, stdin=stream, check=True, capture_output=True, env=threads)
        taken.append(clock(children=True) - began)
    computed = sum(1 for row in (folder / "fort.7").read_text().splitlines() if row.split()[0] != "0")
    closures, energies = [], []
    check, n = closure_check(model), model.degrees_of_freedom
    for state, period in solutions(folder / "points.txt")[1::EVERY]:
        closures.append(check(state, period, np.zeros(n), 1e-15) / growth(start, state, period))
        energies.append(energy(model, state))
    return Run(min(taken) / computed, computed, max(closures), (energies[0], energies[-1]))


def prepare(folder: Path, start: Start) -> None:
    """Equations and the first orbit, compiled and linked as AUTO's own makefile does."""
    model = start.curve.propagator.model
    field = vector_field(model, (), unfolded_invariants(model, SYMMETRIES["none"]))
    x, s = ca.SX.sym("x", field.size1_in(1)), ca.SX.sym("s")
    rate = field(0.0, x, s, ca.SX(0, 1))
    slopes = [rate, ca.densify(ca.jacobian(rate, x)), ca.densify(ca.jacobian(rate, s))]
    functions = ca.Function("field", [x, s], [ca.densify(rate)]), ca.Function("slopes", [x, s], slopes)
    generator = ca.CodeGenerator("field.c")
    for one in functions:
        generator.add(one)
    generator.generate(f"{folder}{os.sep}")
    sizes = {"work": 1 + max(one.sz_w() for one in functions), "integers": 1 + max(one.sz_iw() for one in functions),
             "arguments": 2 + max(one.sz_arg() for one in functions),
             "results": 3 + max(one.sz_res() for one in functions)}  # fmt: skip
    (folder / "orbit.c").write_text(EQUATIONS.format(**sizes))
    times, states = full_samples(start.curve, start.found)
    rows = "\n".join(" ".join(f"{value:.17e}" for value in (t, *row)) for t, row in zip(times, states, strict=True))
    (folder / "orbit.dat").write_text(rows + "\n")
    build = ["gcc", "-O2", "-c", "orbit.c", "-o", "orbit.o"]
    objects = sorted(str(path) for path in (AUTO / "lib").glob("*.o"))
    link = ["gfortran", "-O2", "-std=legacy", "-fopenmp", "orbit.o", "-o", "orbit.exe", *objects, f"-L{AUTO / 'lib'}"]
    for command in (build, [*link, "-lauto_c"]):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)


def solutions(path: Path) -> list[tuple[np.ndarray, float]]:
    """(state at t = 0, period) of every point, as the user's PVLS wrote them."""
    rows = np.atleast_2d(np.loadtxt(path))
    return [(row[:-1], float(row[-1])) for row in rows]


def growth(start: Start, state: np.ndarray, period: float) -> float:
    """max(1, largest multiplier) of an orbit of AUTO's, from its own monodromy matrix by finite differences."""
    from orbitfinder.flow import build_flow, transition

    monodromy = transition(build_flow(start.curve.propagator.model), state, period)[1]
    return max(1.0, float(np.abs(np.linalg.eigvals(monodromy)).max()))


# ---- the page --------------------------------------------------------------------------------------


def line(case: Case, found: dict[str, Run]) -> str:
    """One row of the table."""
    compiled, other = found["compiled"], found["auto"]
    wanted = GENERAL_WANTED if case.symmetry == "none" else SYMMETRIC_WANTED
    met = "yes" if compiled.seconds <= wanted * other.seconds and compiled.closure <= CLOSURE else "no"
    numbers = [f"{1e3 * found[key].seconds:.1f}" for key in ("interpreted", "compiled", "events", "auto", "coarse")]
    ratios = [f"{compiled.seconds / other.seconds:.2f}", f"{found['interpreted'].seconds / compiled.seconds:.1f}"]
    closures = [f"{found[key].closure:.0e}" for key in ("compiled", "auto", "coarse")]
    spans = [f"{run.energies[0]:.1f} to {run.energies[1]:.1f}" for run in (compiled, other)]
    return "| " + " | ".join([case.name, *numbers, *ratios, *closures, *spans, met]) + " |"


HEADER = (
    "family", "interpreted", "compiled", "with events", "AUTO", "AUTO coarse", "compiled / AUTO",
    "interpreted / compiled", "closure", "AUTO's", "AUTO's coarse", "energies (J)", "AUTO's energies (J)", "met",
)  # fmt: skip


def page(rows: list[tuple[Case, dict[str, Run]]], cpu: bool) -> str:
    """The report of a run."""
    worst = max(found["interpreted"].seconds / found["compiled"].seconds for _, found in rows)
    meshes = ", ".join(map(str, MESHES))
    return f"""# Cost of a point on a family

Written by `python benchmarks/families.py{" --cpu" if cpu else ""}`; {"processor" if cpu else "wall"} times in ms a
point, the least of {REPEATS} runs, multipliers included. Closures are the worst of all points, divided by max(1,
largest multiplier). Wanted: compiled at most {SYMMETRIC_WANTED} times AUTO where a symmetry is used, at most
{GENERAL_WANTED} times in the general formulation, interpreted at most {INTERPRETED_WANTED:g} times compiled (worst
measured {worst:.1f}), closures at most {CLOSURE:g}.

| {" | ".join(HEADER)} |
{"|---" * len(HEADER)}|
{chr(10).join(line(*row) for row in rows)}

AUTO with (NTST, NCOL) of {meshes}: the first that closes as asked, or else the last; "coarse" is the first of them.
ISP = 2, EPSL = EPSU = 1e-12, {"one thread" if cpu else "its own number of threads"}.
{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, CasADi {ca.__version__}.
"""


if __name__ == "__main__":
    main()
