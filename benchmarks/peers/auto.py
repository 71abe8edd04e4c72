"""AUTO-07p: orthogonal collocation, one Newton correction at fixed energy.

The boundary-value form (IPS = 4): periodicity, a phase condition and the energy, free are the period, the fictitious
damping (the unfolding that AUTO's users give conservative systems) and a dummy parameter along which AUTO takes its
step, so that the correction is Newton's at fixed energy. NTST = 100, NCOL = 7, analytic derivatives (JAC = 1), one
thread (two are slower here), EPSL = EPSU = 1e-8: tighter ones change nothing but the time. The result is written
with all digits, because AUTO's own file has eleven. The clock is AUTO's own "Total Time".
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

import orbitfinder as of
from orbitfinder.exports.source import FORTRAN, fortran_number, straight_line
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.integrate.rk8 import march
from peers.program import AUTO as HOME
from peers.task import Answer, Task, Unavailable

INTERVALS = (100, 50, 25)
"""NTST of the row that is compared, and coarser meshes, of which the coarsest that still closes is shown too."""
FUNCTIONS = """subroutine FUNC(NDIM, U, ICP, PAR, IJAC, F, DFDU, DFDP)
  implicit none
  integer, intent(in) :: NDIM, ICP(*), IJAC
  double precision, intent(in) :: U(NDIM), PAR(*)
  double precision, intent(out) :: F(NDIM)
  double precision, intent(inout) :: DFDU(NDIM, NDIM), DFDP(NDIM, *)
  double precision :: w({work}), J({size} * {size}), K({size} * 11)
  if (IJAC == 0) then
{rate}
    return
  end if
{rate_slopes}
  DFDU = reshape(J, (/NDIM, NDIM/))
  if (IJAC /= 1) DFDP(:, 1:11) = reshape(K, (/NDIM, 11/))
end subroutine FUNC

subroutine BCND(NDIM, PAR, ICP, NBC, U0, U1, FB, IJAC, DBC)
  implicit none
  integer, intent(in) :: NDIM, ICP(*), NBC, IJAC
  double precision, intent(in) :: PAR(*), U0(NDIM), U1(NDIM)
  double precision, intent(out) :: FB(NBC)
  double precision, intent(inout) :: DBC(NBC, *)
  double precision :: w({work}), J(({size} + 2) * 2 * {size})
  if (IJAC == 0) then
{rows}
    return
  end if
{rows_slopes}
  DBC(:, 1:2 * NDIM) = reshape(J, (/NBC, 2 * NDIM/))
  if (IJAC /= 1) DBC(:, 2 * NDIM + 1:2 * NDIM + 11) = 0d0
end subroutine BCND

subroutine STPNT(NDIM, U, PAR, T)
  implicit none
  integer, intent(in) :: NDIM
  double precision, intent(inout) :: U(NDIM), PAR(*)
  double precision, intent(in) :: T
  PAR(1) = 0d0
  PAR(3) = 0d0
  PAR(11) = {period}
end subroutine STPNT

subroutine PVLS(NDIM, U, PAR)
  implicit none
  integer, intent(in) :: NDIM
  double precision, intent(in) :: U(NDIM)
  double precision, intent(inout) :: PAR(*)
  double precision, external :: GETP
  integer :: i
  open(77, file='found.txt')
  do i = 1, {size}
    write(77, '(ES25.17)') GETP('BV0', i, U)
  end do
  write(77, '(ES25.17)') PAR(11)
  close(77)
end subroutine PVLS

subroutine ICND
end subroutine ICND

subroutine FOPT
end subroutine FOPT
"""
CONSTANTS = """NDIM = {size}, IPS = 4, IRS = 0, ILP = 0
ICP = [3, 11, 1]
NTST = {intervals}, NCOL = 7, IAD = 0, ISP = 0, ISW = 1, IPLT = 0, NBC = {rows}, NINT = 0
NMX = 2, NPR = 2, MXBF = 0, IID = 2, ITMX = 8, ITNW = 7, NWTN = 3, JAC = 1
EPSL = 1e-8, EPSU = 1e-8, EPSS = 1e-6
DS = 0.001, DSMIN = 1e-06, DSMAX = 0.001, IADS = 0
NPAR = 36, THL = {{}}, THU = {{}}
dat = 'guess'
"""


class Auto:
    """The compiled AUTO program of one task, in a temporary folder."""

    def __init__(self, task: Task, intervals: int = INTERVALS[0]) -> None:
        objects = sorted((HOME / "lib").glob("*.o"))
        if not objects or shutil.which("gfortran") is None:
            raise Unavailable("AUTO-07p or gfortran is not installed")
        self._held = tempfile.TemporaryDirectory(prefix="auto-")
        self.folder, self.task = Path(self._held.name), task
        self._write(intervals)
        command = ["gfortran", "-O2", "-fopenmp", "equations.f90", *map(str, objects), "-o", "refine"]
        subprocess.run(command, cwd=self.folder, check=True, capture_output=True)

    def close(self) -> None:
        """Remove the folder."""
        self._held.cleanup()

    def refine(self) -> Answer:
        """Run it once; the state at t = 0 and the period with all digits."""
        done = subprocess.run(
            [str(self.folder / "refine")], cwd=self.folder, capture_output=True, text=True, timeout=120,
            env={**os.environ, "OMP_NUM_THREADS": "1"}, check=False,
        )  # fmt: skip
        times = [float(line.split()[-1]) for line in done.stdout.splitlines() if "Total Time" in line]
        numbers = np.loadtxt(self.folder / "found.txt")
        if not times or "MX" in done.stdout.split():
            raise Unavailable(f"AUTO did not converge on {self.task.name}")
        return Answer(times[-1], numbers[:-1], float(numbers[-1]))

    def _write(self, intervals: int) -> None:
        task, size = self.task, self.task.state.size
        rate, rate_slopes, rows, rows_slopes = equations(task)
        parts = {
            "rate": straight_line(rate, FORTRAN, ["U", "PAR"], ["F"]),
            "rate_slopes": straight_line(rate_slopes, FORTRAN, ["U", "PAR"], ["F", "J", "K"]),
            "rows": straight_line(rows, FORTRAN, ["U0", "U1"], ["FB"]),
            "rows_slopes": straight_line(rows_slopes, FORTRAN, ["U0", "U1"], ["FB", "J"]),
        }
        text = {name: "\n".join(f"  {line}" for line in lines) for name, (lines, _) in parts.items()}
        work = max(extent for _, extent in parts.values())
        source = FUNCTIONS.format(size=size, work=work, period=fortran_number(task.period), **text)
        (self.folder / "equations.f90").write_text(source)
        (self.folder / "fort.2").write_text(CONSTANTS.format(size=size, rows=size + 2, intervals=intervals))
        field = build_flow(of.chain(task.links)).field
        path = march(field, task.state, task.period, 2000, np.zeros(0))
        table = np.column_stack([np.linspace(0.0, task.period, len(path)), path])
        (self.folder / "guess.dat").write_text("".join(" ".join(map(repr, map(float, row))) + "\n" for row in table))


def equations(task: Task) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
    """T f(x, s) and the boundary rows, each plain and with derivatives, as scalar functions."""
    model, n, size = of.chain(task.links), task.links, task.state.size
    unfolded = build_flow(model, (), [one for one in model.invariants if one.generator is None]).field
    x, par, first, last = (ca.SX.sym(name, k) for name, k in (("x", size), ("par", 11), ("u0", size), ("u1", size)))
    rate = par[10] * unfolded(0, x, par[0], ca.SX(0, 1))
    slopes = [ca.vec(ca.densify(ca.jacobian(rate, one))) for one in (x, par)]
    direction = unfolded(0, task.state, 0, ca.DM(0, 1)).full().ravel()
    p = model.parameter_values
    energy = model.kinetic(first[:n], first[n:], p) + model.potential(first[:n], p) - task.energy
    rows = ca.vertcat(last - first, ca.dot(direction / np.linalg.norm(direction), first - task.state), energy)
    ends = ca.vec(ca.densify(ca.jacobian(rows, ca.vertcat(first, last))))
    return (
        ca.Function("rate", [x, par], [rate]),
        ca.Function("rate_slopes", [x, par], ca.cse([rate, *slopes])),
        ca.Function("rows", [first, last], [rows]),
        ca.Function("rows_slopes", [first, last], [rows, ends]),
    )
