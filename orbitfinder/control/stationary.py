"""The conditions of an optimum (Karush, Kuhn, Tucker) as equations along a number that the program depends on.

The unknowns are z = (v, theta), v those of the program, and the multipliers y of the constraints that are met just so
(the active set):

    d/dv (f + y.C) = 0,    C(z) = b(theta)

one equation fewer than unknowns: a curve, regular where it turns back in theta. Second derivatives are exact. Theta is
among v (a freed parameter, a number of the control), or what constraints ask for (a pin, a task, a limit). Where the
curve turns back, an eigenvalue of the Hessian in the directions that the constraints leave changes its sign:
`Stationary.descents` counts the negative ones, without which an optimum is no least.

Source: J. Nocedal, S. Wright, Numerical Optimization (2006), chapters 12, 16; J. Guddat, F. Guerra Vazquez, H. Jongen,
Parametric Optimization: Singularities, Pathfollowing and Jumps (1990).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.linalg import qr
from scipy.optimize import lsq_linear
from scipy.sparse import bmat, csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu

from orbitfinder._runtime.sizes import nonzero, size_of
from orbitfinder.control.program import Optimum, Program, stated_program
from orbitfinder.errors import ConvergenceError
from orbitfinder.loops.scales import control_sizes, floored
from orbitfinder.mechanics.model import vector_field
from orbitfinder.mechanics.newton import Settings, largest, stepped

VIOLATED = 1e-8
"""A constraint is violated, a multiplier has the wrong sign, beyond this"""
NEWTON = Settings(
    floor=1e-9, round_off=1e-7, converged=1e-7, contraction=0.5, most_evaluations=10, farthest=1e3
)  # fmt: skip
"""Of steps, relative to the unknowns"""


@dataclass(frozen=True, eq=False)
class Varying:
    """What theta is, `value` where the program is stated: the freed parameter or number of the control named `unknown`,
    the value of the pin with number `pin`, or how fast with theta ranges begin and end: of the task with number `task`
    (`slopes`), of coefficients (2 x k), of `limits` that rows keep (2 x k)."""

    value: float
    unknown: str = ""
    pin: int | None = None
    task: int | None = None
    slopes: tuple[float, float] = (0.0, 0.0)
    coefficients: np.ndarray | None = None
    limits: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Extremal:
    """A point of the curve: z in units of its sizes, multipliers of all constraints (0 of inactive ones), the active
    set {constraint: -1 at its lowest, 0 equation, 1 at its highest}."""

    z: np.ndarray
    y: np.ndarray
    active: dict[int, int]


class Stationary:
    """The conditions of an optimum of one program along theta."""

    def __init__(self, program: Program, solution: Optimum, varying: Varying) -> None:
        w = solution.unknowns
        self.program, self.varying, self.like = program, varying, w
        self.statement = stated = stated_program(program, w)
        v, cost, self.tasks = stated.expressed.v, stated.expressed.cost, stated.expressed.tasks
        n, own = v.numel(), program.vector(w, solution.coefficients)
        self.names = program.names(w)
        asked = np.isfinite(stated.lower) | np.isfinite(
            stated.upper
        )  # limits of controls, bounds that the problem states
        asked[: w.vector.size] = [name in program.problem.bounds for name in self.names[: w.vector.size]]
        self.boxed = np.flatnonzero(asked[:n])
        extra = not varying.unknown
        self.place = n if extra else n - 1 if program.parts.varied else (
            w.vector.size - w.free.size + program.parts.free.index(varying.unknown))  # fmt: skip
        rows = ca.vertcat(stated.rows, v[self.boxed.tolist()])
        y, z = ca.MX.sym("y", rows.numel()), ca.vertcat(v, ca.MX.sym("theta", int(extra)))
        self._first = ca.Function("first", [z], [cost, ca.gradient(cost, z), rows, ca.jacobian(rows, z)])
        self._second = ca.Function("second", [z, y], [ca.hessian(cost + ca.dot(y, rows), z)[0]])
        self.low, self.high = (np.concatenate([part, more[self.boxed]])
                               for part, more in ((stated.low, stated.lower), (stated.high, stated.upper)))  # fmt: skip
        self.drift = self._drift(w.vector.size)
        begin = np.append(own, varying.value) if extra or program.parts.varied else own
        self.sizes = self._sizes(solution, begin)
        f, slope, _, jacobian = self._first(begin)
        self.unit = nonzero(max(float(np.abs(slope.full().ravel() * self.sizes).max()), abs(float(f))))
        scaled = self._columns(jacobian)
        self.heights = nonzero(np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel()))
        self.begin, self.others = begin / self.sizes, np.delete(np.arange(begin.size), self.place)

    def _drift(self, first: int) -> np.ndarray:
        """How fast lowest and highest (2 x m) of all constraints go with theta."""
        varying, tasks, problem = self.varying, self.tasks, self.program.problem
        drift = np.zeros((2, self.low.size))
        if varying.pin is not None:
            guards = len(problem.model.cycle)
            drift[:, int(np.sum(tasks == -1)) - guards - len(problem.pin) + varying.pin] = 1.0
        if varying.task is not None:
            drift[:, : tasks.size][:, tasks == varying.task] = np.array(varying.slopes)[:, None]
        if varying.coefficients is not None:
            of_controls = self.boxed >= first
            drift[:, tasks.size :][:, of_controls] = varying.coefficients[:, self.boxed[of_controls] - first]
        if varying.limits is not None and np.any(tasks == -2):
            each = int(np.sum(tasks == -2)) // varying.limits.shape[1]
            drift[:, : tasks.size][:, tasks == -2] = np.repeat(varying.limits, each, axis=1)
        return drift

    def _sizes(self, solution: Optimum, begin: np.ndarray) -> np.ndarray:
        """Of each of z what is large, so that the norm of z is its root mean square."""
        w, program = solution.unknowns, self.program
        model, count = program.parts.mode(0), len(w.nodes)
        extents = floored(np.ptp(w.nodes, axis=0))
        names = program.parts.model.controls
        by_u = ca.MX.sym("u", len(names))
        rate = vector_field(model, names)(0.0, w.nodes[0], ca.DM(0, 1), by_u)
        ease = np.abs(ca.Function("ease", [by_u], [ca.jacobian(rate, by_u)])(0.0).full())
        natural = control_sizes((ease / extents[:, None]).max(axis=0), w.period, 1e3)
        sizes = [w.joined(extents * np.sqrt(count), w.period, 1.0, nonzero(np.abs(w.free)))]
        for k, row in enumerate(solution.coefficients):
            own = max(float(np.abs(row).max()), 1e-3 * float(natural[k]))
            sizes.append(np.full(program.shapes[k].shape[1], own * np.sqrt(program.shapes[k].shape[1])))
        units = np.concatenate([*sizes, [abs(self.varying.value) or 1.0]])[: begin.size]
        return np.asarray(units)

    @property
    def span(self) -> float:
        """The size of theta."""
        return float(self.sizes[self.place])

    def theta(self, point: Extremal) -> float:
        """The value of theta."""
        return float(point.z[self.place] * self.span)

    def _columns(self, jacobian: ca.DM) -> csr_matrix:
        """Derivatives of constraints by z, in its sizes; ranges that go with theta are on this side."""
        return csr_matrix(csr_matrix(jacobian.sparse()) @ diags(self.sizes))

    def values(self, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, csr_matrix]:
        """Cost and its gradient by z; constraints and their derivatives by z, each in units of its first gradient."""
        f, slope, rows, jacobian = self._first(z * self.sizes)
        gradient = slope.full().ravel() * self.sizes / self.unit
        return float(f), gradient, rows.full().ravel(), csr_matrix(diags(1.0 / self.heights) @ self._columns(jacobian))

    def ends(self, z: np.ndarray) -> np.ndarray:
        """Lowest and highest (2 x m) of the constraints at theta."""
        return np.asarray(
            np.array([self.low, self.high]) + self.drift * (z[self.place] * self.span - self.varying.value)
        )

    def cost(self, point: Extremal) -> float:
        """The cost there."""
        return self.values(point.z)[0]

    def _system(
        self, z: np.ndarray, y: np.ndarray, active: dict[int, int]
    ) -> tuple[np.ndarray, csr_matrix, np.ndarray]:
        """The equations (by v, then constraints), their derivatives by (z, y), and the gradient of the cost."""
        chosen = np.array(list(active), int)
        sides = np.array([active[k] for k in chosen], int)
        _, gradient, rows, jacobian = self.values(z)
        ends = self.ends(z)[(sides > 0).astype(int), chosen]
        a = jacobian[chosen].tolil()
        a[:, self.place] = a[:, [self.place]] - (
            self.drift[(sides > 0).astype(int), chosen] * self.span / self.heights[chosen])[:, None]  # fmt: skip
        a = csr_matrix(a)
        whole = np.zeros(self.low.size)
        whole[chosen] = y[chosen] / self.heights[chosen] * self.unit
        scale = diags(self.sizes)
        hessian = csr_matrix(scale @ csr_matrix(self._second(z * self.sizes, whole).sparse()) @ scale / self.unit)
        left = gradient + jacobian[chosen].T @ y[chosen]
        residual = np.concatenate([left[self.others], (rows[chosen] - ends) / self.heights[chosen]])
        matrix = bmat([[hessian[self.others], jacobian[chosen].T.tocsr()[self.others]], [a, None]])
        return residual, csr_matrix(matrix), gradient

    def corrected(
        self, z: np.ndarray, near: Extremal, row: np.ndarray, active: dict[int, int] | None = None
    ) -> Extremal:
        """The point of the curve on the hyperplane through z normal to `row`. Raises `ConvergenceError`."""
        active = near.active if active is None else active
        aim, chosen, size = float(row @ z), np.array(list(active), int), z.size

        def point(w: np.ndarray) -> Extremal:
            y = np.zeros(near.y.size)
            y[chosen] = w[size:]
            return Extremal(w[:size], y, active)

        def step(w: np.ndarray) -> np.ndarray:
            at = point(w)
            residual, matrix, _ = self._system(at.z, at.y, active)
            return self._bordered(matrix, row, np.append(-residual, aim - row @ at.z))

        start = np.append(z, near.y[chosen])
        solution = stepped(start, step, NEWTON, measure=lambda step: largest(step[:size]))
        if not solution.converged:
            raise ConvergenceError("Newton's method does not converge")
        return point(solution.w)

    @staticmethod
    def _bordered(matrix: csr_matrix, row: np.ndarray, right: np.ndarray) -> np.ndarray:
        border = np.concatenate([row, np.zeros(matrix.shape[1] - row.size)])
        try:
            solution = splu(csc_matrix(bmat([[matrix], [csr_matrix(border)]]))).solve(right)
        except RuntimeError as error:
            raise ConvergenceError("the equations are singular") from error
        if not np.all(np.isfinite(solution)):
            raise ConvergenceError("the equations are singular")
        return np.asarray(solution)

    def tangent(self, point: Extremal, like: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The direction of the curve (dz, dy) with |dz| = 1, on the side of `like`. Raises `ConvergenceError`."""
        _, matrix, _ = self._system(point.z, point.y, point.active)
        right = np.zeros(matrix.shape[0] + 1)
        right[-1] = 1.0
        tangent = self._bordered(matrix, like, right)
        tangent = self._bordered(matrix, tangent[: like.size] / np.linalg.norm(tangent[: like.size]), right)
        tangent /= np.linalg.norm(tangent[: like.size])
        if tangent[: like.size] @ like < 0:
            tangent = -tangent
        whole = np.zeros(point.y.size)
        whole[list(point.active)] = tangent[like.size :]
        return tangent[: like.size], whole

    def slope(self, point: Extremal, tangent: np.ndarray) -> float:
        """d cost / d arclength, in its unit."""
        return float(self.values(point.z)[1] @ tangent)

    def margins(self, point: Extremal) -> tuple[np.ndarray, np.ndarray]:
        """Of each constraint how far it is from becoming active or, if it is active, from being let go; and its side.

        Multipliers are relative to the largest; equations have infinite margins.
        """
        rows, (low, high) = self.values(point.z)[2], self.ends(point.z)
        below, above = (rows - low) / self.heights, (high - rows) / self.heights
        margins, sides = np.minimum(below, above), np.where(below < above, -1, 1)
        margins[self.low == self.high] = np.inf
        size = size_of(point.y)
        for k, side in point.active.items():
            margins[k], sides[k] = (np.inf, 0) if side == 0 else (side * point.y[k] / size, side)
        return margins, sides

    def independent(self, point: Extremal, wanted: dict[int, int]) -> dict[int, int]:
        """Those of constraints whose gradients, theta left out, say something new: equations first, in order."""
        jacobian = self.values(point.z)[3]
        kept: dict[int, int] = {}
        basis = np.zeros((self.others.size, 0))
        for equations in (True, False):
            names = [k for k, side in wanted.items() if (side == 0) == equations]
            if not names:
                continue
            columns = jacobian[names].toarray()[:, self.others].T
            columns /= nonzero(np.linalg.norm(columns, axis=0))
            left = columns - basis @ (basis.T @ columns)
            left -= basis @ (basis.T @ left)
            q, r, order = qr(left, mode="economic", pivoting=True)
            rank = int(np.sum(np.abs(np.diag(r)) > 1e-8))  # gradients that differ by less say the same
            basis = np.hstack([basis, q[:, :rank]])
            kept |= {names[int(k)]: wanted[names[int(k)]] for k in sorted(order[:rank])}
        return kept

    def started(self) -> Extremal:
        """The point of the curve at the program's optimum, with its active set. Raises `ConvergenceError`."""
        z = self.begin
        bare = Extremal(z, np.zeros(self.low.size), {})
        margins, sides = self.margins(bare)
        equations = {int(k): 0 for k in np.flatnonzero(self.low == self.high)}
        met = {int(k): int(sides[k]) for k in np.flatnonzero(margins < 1e-6)}
        active = self._signed(bare, self.independent(bare, equations | met))
        unit = np.zeros(z.size)
        unit[self.place] = 1.0
        for _ in range(20):
            point = self.corrected(z, Extremal(z, self._fitted(bare, active), active), unit)
            margins, sides = self.margins(point)
            wrong = np.flatnonzero(margins < -VIOLATED).tolist()
            if not wrong:
                return point
            active = {k: side for k, side in active.items() if k not in wrong}
            active |= {k: int(sides[k]) for k in wrong if k not in point.active}
            active, z = self.independent(point, active), point.z
        raise ConvergenceError("the constraints that are met are not clear")

    def _fitted(self, point: Extremal, active: dict[int, int]) -> np.ndarray:
        """Multipliers that meet the conditions best."""
        y = np.zeros(self.low.size)
        y[list(active)] = np.linalg.lstsq(*self._gradients(point, active), rcond=1e-12)[0]
        return y

    def _gradients(self, point: Extremal, active: dict[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Those of active constraints (columns), and what they have to add up to, theta left out."""
        _, gradient, _, jacobian = self.values(point.z)
        return jacobian[list(active)].toarray()[:, self.others].T, -gradient[self.others]

    def _signed(self, point: Extremal, active: dict[int, int]) -> dict[int, int]:
        """Active constraints without those whose multipliers, of the right signs, are 0."""
        sides = np.array(list(active.values()))
        y = self._fitted(point, active)[list(active)]
        if np.all(y * sides > VIOLATED * size_of(y), where=sides != 0):
            return active
        low, high = np.where(sides > 0, 0.0, -np.inf), np.where(sides < 0, 0.0, np.inf)
        y = lsq_linear(*self._gradients(point, active), (low, high), method="bvls").x
        kept = (sides == 0) | (y * sides > VIOLATED * size_of(y))
        return {k: side for (k, side), stays in zip(active.items(), kept, strict=True) if stays}

    def descents(self, point: Extremal) -> int:
        """In how many directions that keep to the active constraints the cost falls to second order; 0 of a least."""
        chosen = np.array(list(point.active), int)
        _, matrix, _ = self._system(point.z, point.y, point.active)
        count = self.others.size
        hessian, a = matrix[:count][:, self.others].toarray(), matrix[count:][:, self.others].toarray()
        space = qr(a.T, mode="full")[0][:, chosen.size :]
        values = np.linalg.eigvalsh(space.T @ hessian @ space)
        return int(np.sum(values < -1e-9 * size_of(values)))

    def solution(self, point: Extremal) -> Optimum:
        """The point as a solution of the program, theta left out where it is no freed parameter of the problem."""
        solution = self.program.solution(self.like, point.z * self.sizes, self.statement.normals)
        return replace(solution, points=np.zeros(0))

    def name(self, constraint: int, side: int) -> str:
        """What a constraint is, where along the period, in words."""
        parts, count = self.program.parts, self.tasks.size
        end = {-1: "at its lowest", 1: "at its highest"}.get(side, "")
        if constraint >= count:
            return f"{self.names[int(self.boxed[constraint - count])]} {end}"
        tasks = self.tasks
        if tasks[constraint] == -1:
            return f"equation {constraint}"
        number = int(tasks[constraint])
        first = int(np.flatnonzero(tasks == number)[0])
        if number == -2:
            return f"a limit of {', '.join(parts.model.controls)} {end}"
        task = parts.control.tasks[number]
        if task.at != "always":
            return f"{task.expression} {end}"
        segment, step = divmod(constraint - first, parts.steps + 1)
        phase = parts.basis.fraction * (segment + step / parts.steps) / parts.basis.intervals
        return f"{task.expression} {end} at phase {phase:.6g}"


def moved(point: Extremal, step: np.ndarray, multipliers: np.ndarray, length: float) -> Extremal:
    """The point that a tangent leads to."""
    return replace(point, z=point.z + length * step, y=point.y + length * multipliers)
