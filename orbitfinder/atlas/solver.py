"""Cheap first: damped Newton (Levenberg-Marquardt) on loosely integrated multiple shooting.

The equations are built once and used for every start with other numbers; nothing is transcribed, so a hopeless start
costs a few integrations. Source of the damping: K. Levenberg, Quarterly of Applied Mathematics 2 (1944) 164-168;
D. Marquardt, SIAM Journal 11 (1963) 431-441.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import rounded, uniform
from orbitfinder.loops.loop import Equations, Loop, Unknowns
from orbitfinder.loops.problem import Problem, loop_of

FINER = 3
"""The polish begins with steps shorter than the cheap stage's by this factor."""
SQUARED_ABOVE = 1e-6
"""Damping above which the normal equations are accurate enough."""
PATIENCE = 6
"""Evaluations in which the residual must have halved, or it creeps."""
NEAR = 1e-2
"""Scaled residual below which a path is near an orbit."""
NARROW = 3e-2
"""A Jacobian is nearly singular in one direction when its last singular value is this much below the one before."""


class Stalled(ConvergenceError):
    """Newton's method came near an orbit that is nearly degenerate, and no nearer; `w` is where it stands."""

    def __init__(self, w: Unknowns) -> None:
        super().__init__("stalled near a degenerate orbit")
        self.w = w


@dataclass(frozen=True)
class QuickSettings:
    """When the cheap stage is content and when it gives up."""

    converged: float = 1e-6
    """scaled residual at which the polish takes over"""
    most_evaluations: int = 40
    hopeless: tuple[tuple[int, float], ...] = ((12, 1.0), (24, 0.3))
    """(evaluations, scaled residual): given up when it is still larger after so many"""
    largest_step: float = 1.0
    """scaled length of a step, about a radian"""
    largest_rate: float = 100.0
    """bound on rates, in units of the guess's root mean square; a step beyond it is not taken"""
    largest_unfolding: float = 100.0
    """bound on |s| in 1/s; values of 10 have been seen to come back, this has left the problem"""
    growth_per_segment: float = 10.0
    fewest_segments: int = 2
    most_segments: int = 16
    polish_steps: int = 8
    polished: float = 1e-13
    """scaled residual below which the polish stops early"""


@dataclass(frozen=True)
class Scaled:
    """The loop of one start, the longest step of its marches (s), what unknowns and rows are measured in."""

    loop: Loop
    step: float
    columns: np.ndarray
    rows: np.ndarray
    periods: tuple[float, float]

    def at(self, w: Unknowns) -> Unknowns:
        """w on the mesh that the step asks for."""
        count, fraction = len(w.nodes), self.loop.equations.symmetry.fraction
        steps = rounded(w.period * fraction / count / self.step)
        return w if w.mesh.size == steps * count + 1 else replace(w, mesh=uniform(fraction, count, steps))


def shot(
    equations: Equations, step: float, state: np.ndarray, period: float, count: int
) -> tuple[Unknowns, np.ndarray]:
    """The unknowns (of `count` segments) of the motion from a state, and its end (d)."""
    fraction = equations.symmetry.fraction
    mesh = uniform(fraction, count, rounded(period * fraction / count / step))
    w = equations.unknowns(np.asarray(state, float)[None], period, mesh)
    states = equations.march.states(w.nodes, mesh, w.tail)
    return replace(w, nodes=states[: -1 : (mesh.size - 1) // count]), states[-1]


def scaled(problem: Problem, equations: Equations, step: float, w: Unknowns, periods: tuple[float, float]) -> Scaled:
    """The loop of one start, scales and references taken from its guess."""
    n, count = problem.model.degrees_of_freedom, len(w.nodes)
    rate = max(float(np.sqrt(np.mean(w.nodes[:, n:] ** 2))), 2 * np.pi / problem.guess.period)
    node = np.concatenate([np.ones(n), np.full(n, rate)])
    loop = loop_of(problem, equations, w, None, problem.pin)
    lowest = float(problem.model.potential(w.nodes[0, :n], problem.model.parameter_values))
    span = max(abs(problem.pin[0].value - lowest), 0.1 * abs(problem.pin[0].value), 1e-3)
    first, last = problem.boundary.rows(n)
    boundary = (np.maximum(np.abs(first), np.abs(last)) * node).max(axis=1)
    phases = np.full(len(loop.normals), rate)
    return Scaled(
        loop, step,
        columns=w.joined(node, problem.guess.period, 1.0, np.zeros(0)),
        rows=np.concatenate([np.tile(node, count - 1), boundary, phases, [span]]), periods=periods,
    )  # fmt: skip


def linearised(one: Scaled, w: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """Scaled residual and Jacobian by the variational equations."""
    w = one.at(w)
    path = one.loop.equations.varied(w)
    jacobian = one.loop.linearised(w, path).matrix()
    return one.loop.rows(w, path.ends) / one.rows, jacobian * one.columns / one.rows[:, None]


def moved(one: Scaled, w: Unknowns, step: np.ndarray) -> Unknowns:
    """The unknowns after a scaled step, the period kept in range."""
    after = w.moved(step * one.columns)
    return replace(after, period=float(np.clip(after.period, *one.periods)))


def bounded(one: Scaled, w: Unknowns, settings: QuickSettings) -> Unknowns:
    """The unknowns, if rates and unfolding are within bounds; `IntegrationError` otherwise."""
    n = w.nodes.shape[1] // 2
    fast = float(np.abs(w.nodes[:, n:]).max()) > settings.largest_rate * one.columns[n]
    if fast or float(np.abs(w.unfolding).max(initial=0.0)) > settings.largest_unfolding:
        raise IntegrationError("out of bounds", time=0.0, state=w.nodes[0])
    return w


def solve(one: Scaled, w: Unknowns, settings: QuickSettings) -> tuple[Unknowns, np.ndarray]:
    """Unknowns with a small scaled residual and the Jacobian there; `ConvergenceError` says why there is none."""
    damping = 1e-2
    residual, jacobian = linearised(one, w)
    norm = float(np.abs(residual).max())
    norms: list[float] = []
    for evaluation in range(1, settings.most_evaluations + 1):
        if norm < settings.converged:
            return w, jacobian
        if any(evaluation > after and norm > most for after, most in settings.hopeless):
            raise ConvergenceError("hopeless start")
        norms.append(norm)
        if creeping(norms) and narrow(jacobian):
            raise Stalled(w)
        step = damped_step(jacobian, residual, damping, settings.largest_step)
        try:
            trial = bounded(one, moved(one, w, step), settings)
            found, slopes = linearised(one, trial)
        except IntegrationError:
            damping = max(10 * damping, 1e-3)
            continue
        if float(np.linalg.norm(found)) < float(np.linalg.norm(residual)):
            w, residual, jacobian = trial, found, slopes
            norm, damping = float(np.abs(residual).max()), damping / 10 if damping > 1e-9 else 0.0
        else:
            damping = max(5 * damping, 1e-4)
    raise ConvergenceError("iteration limit")


def creeping(norms: list[float]) -> bool:
    """True when the last residuals are small and have not halved in a while; asked anew after as long again."""
    near = norms[-1] < NEAR and len(norms) > PATIENCE and len(norms) % PATIENCE == 0
    return near and norms[-1] > norms[-1 - PATIENCE] / 2


def narrow(jacobian: np.ndarray) -> bool:
    """True when a Jacobian is nearly singular in one direction alone."""
    values = np.linalg.svd(jacobian, compute_uv=False)
    return bool(values[-1] < NARROW * values[-2])


def damped_step(jacobian: np.ndarray, residual: np.ndarray, damping: float, longest: float) -> np.ndarray:
    """The Levenberg-Marquardt step, no longer than `longest` in any component."""
    try:
        if damping > SQUARED_ABOVE:
            matrix = jacobian.T @ jacobian
            matrix[np.diag_indices_from(matrix)] += damping
            step = -np.linalg.solve(matrix, jacobian.T @ residual)
        else:
            step = np.linalg.lstsq(jacobian, -residual, rcond=1e-13)[0]
    except np.linalg.LinAlgError as error:
        raise ConvergenceError("singular equations") from error
    return np.asarray(step * min(1.0, longest / max(float(np.abs(step).max()), 1e-300)))


def polished(one: Scaled, w: Unknowns, jacobian: np.ndarray, settings: QuickSettings) -> Unknowns:
    """w to round-off, by chord Newton steps with an accurate residual, on the mesh that it needs."""
    inverse = np.linalg.pinv(jacobian, rcond=1e-13)
    equations = one.loop.equations
    w = replace(one, step=one.step / FINER).at(w)
    ends, mesh = equations.march.refined_ends(w.nodes, w.mesh, w.tail)
    w = replace(w, mesh=mesh)
    residual = one.loop.rows(w, ends) / one.rows
    best = float(np.abs(residual).max())
    for _ in range(settings.polish_steps):
        trial = moved(one, w, -inverse @ residual)
        found = one.loop.rows(trial, equations.ends(trial)) / one.rows
        size = float(np.abs(found).max())
        if not size < best:
            break
        w, residual, best = trial, found, size
        if best < settings.polished:
            break
    if not best < 1e-10:
        raise Stalled(w)
    return w
