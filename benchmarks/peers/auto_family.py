"""AUTO-07p along a family: the same equations, the same first orbit, the same range of energy.

AUTO gets the C code that CasADi writes for the field and its derivatives and the unfolding as its free parameter next
to the period. DS = DSMAX is sought, on the coarsest mesh and outside the clock, such that it covers the range in as
many points as asked for, because neighbouring orbits are cheaper than distant ones. ISP = 1, ILP = 0: multipliers of
every point and nothing located; ISP = 2, ILP = 1: special points located too.
"""

from __future__ import annotations

import os
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
from peers.program import Program

EVERY = 4
"""One of so many of AUTO's points is judged."""
STEPS = 800
"""Runge-Kutta steps of a period for the multipliers of AUTO's orbits"""
SEARCH = 8
"""Tries for DSMAX"""
EQUATIONS = """
#include "field.c"
int func(integer ndim, const doublereal *u, const integer *icp, const doublereal *par, integer ijac,
         doublereal *f, doublereal *dfdu, doublereal *dfdp) {{
  static double w[{work}]; static casadi_int iw[{integers}];
  const double *arg[{arguments}]; double *res[{results}];
  arg[0] = u; arg[1] = par; res[0] = f;
  if (ijac == 0) return field(arg, res, iw, w, 0);
  res[1] = dfdu; res[2] = dfdp;
  return slopes(arg, res, iw, w, 0);
}}
int stpnt(integer ndim, doublereal t, doublereal *u, doublereal *par) {{ {start} return 0; }}
"""


@dataclass(frozen=True)
class Asked:
    """A run of AUTO: NMX, (NTST, NCOL), DS, whether events are located."""

    points: int
    mesh: tuple[int, int]
    step: float
    events: bool = False


class AutoFamily:
    """AUTO's program of one family."""

    def __init__(self, folder: Path, start: Start) -> None:
        self.start, self.model = start, start.curve.equations.model
        self.first = energy(self.model, start.solution.place.nodes[0])
        times, states = full_samples(start.curve, start.solution)
        self.program = Program(folder, equations(folder, start), np.column_stack([times, states]))

    def go(self, asked: Asked) -> tuple[float, np.ndarray]:
        """One run: seconds a point, and (states, period) of every point."""
        seconds, rows = self.program.run(
            asked.mesh, ICP=[11, 1], ILP=int(asked.events), ISP=1 + asked.events, NMX=asked.points, DS=asked.step,
            DSMAX=abs(asked.step), EPSS=1e-8,
        )  # fmt: skip
        return seconds, rows[:, :-2]

    def energies(self, rows: np.ndarray) -> np.ndarray:
        """Of every point."""
        return np.array([energy(self.model, row[:-1]) for row in rows])

    def stepping(self, mesh: tuple[int, int], points: int, last: float) -> Asked:
        """Steps with which AUTO goes from the first orbit to the energy `last` in about so many points."""
        step = 0.05
        if self.energies(self.go(Asked(3, mesh, step))[1])[-1] < self.first:
            step = -step
        best = Asked(points, mesh, step)  # its energies in the table say so, should it not get there
        away = np.inf
        for _ in range(SEARCH):
            beyond = np.flatnonzero(self.energies(self.go(Asked(3 * points, mesh, step))[1]) >= last)
            needed = int(beyond[0]) + 1 if beyond.size else 4 * points
            if abs(needed - points) < away:
                best, away = Asked(min(needed, 3 * points), mesh, step), abs(needed - points)
            if away <= 0.05 * points:
                break
            step *= float(np.clip(needed / points, 0.3, 3.0))
        return best

    def closure(self, rows: np.ndarray) -> float:
        """The worst of one point in `EVERY`, by an independent integration, over max(1, largest multiplier)."""
        check, n = ClosureCheck(self.model), self.model.degrees_of_freedom
        return max(
            check(row[:-1], row[-1], np.zeros(n), 1e-15) / growth(self.start, row[:-1], row[-1])
            for row in rows[1::EVERY]
        )

    def finest(self, steps: Asked, meshes: tuple[tuple[int, int], ...], closure: float) -> Asked:
        """The same steps on the first mesh that closes as asked for, or else on the last."""
        for mesh in meshes:
            asked = replace(steps, mesh=mesh)
            if self.closure(self.go(asked)[1]) <= closure:
                break
        return asked


def equations(folder: Path, start: Start) -> str:
    """C code of the field and its derivatives as AUTO calls it, the unfolding its parameter."""
    model = start.curve.equations.model
    field = vector_field(model, (), NONE.unfolded(model))
    x, s = ca.SX.sym("x", field.size1_in(1)), ca.SX.sym("s")
    return written(folder, x, s, field(0.0, x, s, ca.SX(0, 1)), "par[0] = 0.0;")


def written(folder: Path, x: ca.SX, par: ca.SX, rate: ca.SX, start: str) -> str:
    """C code of rates and their derivatives by x and PAR(1), begun as `start` says; what CasADi writes is beside it."""
    slopes = [rate, ca.densify(ca.jacobian(rate, x)), ca.densify(ca.jacobian(rate, par))]
    functions = ca.Function("field", [x, par], [ca.densify(rate)]), ca.Function("slopes", [x, par], ca.cse(slopes))
    generator = ca.CodeGenerator("field.c")
    for one in functions:
        generator.add(one)
    generator.generate(f"{folder}{os.sep}")
    return EQUATIONS.format(
        work=1 + max(one.sz_w() for one in functions), integers=1 + max(one.sz_iw() for one in functions),
        arguments=2 + max(one.sz_arg() for one in functions), results=3 + max(one.sz_res() for one in functions),
        start=start,
    )  # fmt: skip


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
