"""Cheap first: damped Newton (Levenberg-Marquardt) on loosely integrated multiple shooting, in NumPy.

The step of the fixed-step march is the only graph, built once and used for every start with other
numbers; nothing is transcribed, so a hopeless start costs a few integrations. Rows and unknowns are
those of `periodic.shooting`: defects, boundary, phase, energy in nodes, period and unfolding.
Source of the damping: K. Levenberg, Quarterly of Applied Mathematics 2 (1944) 164-168; D. Marquardt,
SIAM Journal 11 (1963) 431-441.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.batch import March, derivatives, rates, refined_ends, rounded, states_along
from orbitfinder.integrate.batch import ends as ends_of
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.shooting import boundary_constants, phase_directions

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
    """Newton's method came near an orbit that is nearly degenerate, and no nearer; `path` is where it stands."""

    def __init__(self, path: Path) -> None:
        super().__init__("stalled near a degenerate orbit")
        self.path = path


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
class Path:
    """Where the iteration is: nodes (N x 2n), period (s), unfolding."""

    nodes: np.ndarray
    period: float
    unfolding: np.ndarray


@dataclass(frozen=True)
class System:
    """The fixed part of one start's equations: problem, march and its step (s), scales, phase reference, boundary."""

    problem: Problem
    march: March
    step: float
    columns: np.ndarray
    rows: np.ndarray
    reference: np.ndarray
    phases: np.ndarray
    constant: np.ndarray
    periods: tuple[float, float]


def segments_needed(march: March, step: float, state: np.ndarray, horizon: float, settings: QuickSettings) -> int:
    """As many segments as keep each state-transition matrix small."""
    none = np.zeros(march.unfolded)
    matrix = derivatives(march, state[None], horizon, rounded(horizon / step), none)[1][0, :, : state.size]
    n = state.size // 2
    clock = np.concatenate([np.ones(n), np.full(n, horizon / np.pi)])
    growth = float(np.linalg.norm(matrix * clock[:, None] / clock[None, :], 2))
    needed = int(np.ceil(np.log(max(growth, 2.0)) / np.log(settings.growth_per_segment)))
    return min(max(needed, settings.fewest_segments), settings.most_segments)


def shot(march: March, step: float, state: np.ndarray, horizon: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (count x 2n) of the motion from a state, and its end (2n)."""
    steps = rounded(horizon / count / step)
    states = states_along(march, np.asarray(state, float), horizon, steps * count, np.zeros(march.unfolded))
    return states[:-1:steps], states[-1]


def system(problem: Problem, motion: tuple[March, float], nodes: np.ndarray, periods: tuple[float, float]) -> System:
    """Scales and references of one start, taken from its guess."""
    n, count = problem.model.degrees_of_freedom, len(nodes)
    rate = max(float(np.sqrt(np.mean(nodes[:, n:] ** 2))), 2 * np.pi / problem.guess.period)
    node = np.concatenate([np.ones(n), np.full(n, rate)])
    phases = np.asarray(phase_directions(problem, nodes[0])).reshape(-1, 2 * n)
    lowest = float(problem.model.potential(nodes[0, :n], problem.model.parameter_values))
    span = max(abs(problem.pin[0].value - lowest), 0.1 * abs(problem.pin[0].value), 1e-3)
    first, last = problem.boundary.rows(n)
    boundary = (np.maximum(np.abs(first), np.abs(last)) * node).max(axis=1)
    return System(
        problem, *motion,
        columns=np.concatenate([np.tile(node, count), [problem.guess.period], np.ones(motion[0].unfolded)]),
        rows=np.concatenate([np.tile(node, count - 1), boundary, np.full(len(phases), rate), [span]]),
        reference=nodes[0].copy(), phases=phases, constant=boundary_constants(problem, nodes), periods=periods,
    )  # fmt: skip


def energy_row(one: System, state: np.ndarray) -> tuple[float, np.ndarray]:
    """Energy minus its pin, and the gradient (2n)."""
    total, gradient = one.march.energy(state)
    return float(total) - one.problem.pin[0].value, gradient.full().ravel()


def rows(one: System, path: Path, ends: np.ndarray) -> np.ndarray:
    """Unscaled residual for given end states (N x 2n)."""
    first, last = one.problem.boundary.rows(ends.shape[1] // 2)
    closing = first @ path.nodes[0] + last @ ends[-1] - one.constant
    energy, _ = energy_row(one, path.nodes[0])
    return np.concatenate(
        [(ends[:-1] - path.nodes[1:]).ravel(), closing, one.phases @ (path.nodes[0] - one.reference), [energy]]
    )


def linearised(one: System, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Scaled residual and Jacobian of a path by the variational equations."""
    count, size = path.nodes.shape
    span = one.problem.boundary.fraction / count
    duration = path.period * span
    ends, slopes = derivatives(one.march, path.nodes, duration, rounded(duration / one.step), path.unfolding)
    speed = rates(one.march, ends, path.unfolding) * span
    columns = np.concatenate([slopes[:, :, :size], speed[:, :, None], slopes[:, :, size:]], axis=2)
    first, last = one.problem.boundary.rows(size // 2)
    columns[-1] = last @ columns[-1]
    jacobian = np.zeros((one.rows.size, one.columns.size))
    for k in range(count):
        block = slice(k * size, (k + 1) * size)
        jacobian[block, block] = columns[k, :, :size]
        if k < count - 1:
            jacobian[block, (k + 1) * size : (k + 2) * size] = -np.eye(size)
    jacobian[: count * size, count * size :] = columns[:, :, size:].reshape(count * size, -1)
    jacobian[(count - 1) * size : count * size, :size] += first
    jacobian[count * size : -1, :size] = one.phases
    jacobian[-1, :size] = energy_row(one, path.nodes[0])[1]
    return rows(one, path, ends) / one.rows, jacobian * one.columns / one.rows[:, None]


def moved(one: System, path: Path, step: np.ndarray) -> Path:
    """The path after a scaled step, its period kept in range."""
    count, size = path.nodes.shape
    change = step * one.columns
    period = float(np.clip(path.period + change[count * size], *one.periods))
    nodes = path.nodes + change[: count * size].reshape(count, size)
    return Path(nodes, period, path.unfolding + change[count * size + 1 :])


def bounded(one: System, path: Path, settings: QuickSettings) -> Path:
    """The path, if its rates and unfolding are within bounds; `IntegrationError` otherwise."""
    n = path.nodes.shape[1] // 2
    fast = float(np.abs(path.nodes[:, n:]).max()) > settings.largest_rate * one.columns[n]
    if fast or float(np.abs(path.unfolding).max(initial=0.0)) > settings.largest_unfolding:
        raise IntegrationError("out of bounds", time=0.0, state=path.nodes[0])
    return path


def solve(one: System, start: Path, settings: QuickSettings) -> tuple[Path, np.ndarray]:
    """A path with a small scaled residual and the Jacobian there; `ConvergenceError` says why there is none."""
    path, damping = start, 1e-2
    residual, jacobian = linearised(one, path)
    norm = float(np.abs(residual).max())
    norms: list[float] = []
    for evaluation in range(1, settings.most_evaluations + 1):
        if norm < settings.converged:
            return path, jacobian
        if any(evaluation > after and norm > most for after, most in settings.hopeless):
            raise ConvergenceError("hopeless start")
        norms.append(norm)
        if creeping(norms) and narrow(jacobian):
            raise Stalled(path)
        step = damped_step(jacobian, residual, damping, settings.largest_step)
        try:
            trial = bounded(one, moved(one, path, step), settings)
            found, slopes = linearised(one, trial)
        except IntegrationError:
            damping = max(10 * damping, 1e-3)
            continue
        if float(np.linalg.norm(found)) < float(np.linalg.norm(residual)):
            path, residual, jacobian = trial, found, slopes
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


def polished(one: System, path: Path, jacobian: np.ndarray, settings: QuickSettings) -> tuple[Path, int]:
    """The path to round-off, by chord Newton steps with an accurate residual, and the steps that a segment needs."""
    inverse = np.linalg.pinv(jacobian, rcond=1e-13)
    duration = path.period * one.problem.boundary.fraction / len(path.nodes)
    ends, steps = refined_ends(one.march, path.nodes, duration, rounded(FINER * duration / one.step), path.unfolding)
    residual = rows(one, path, ends) / one.rows
    best = float(np.abs(residual).max())
    for _ in range(settings.polish_steps):
        trial = moved(one, path, -inverse @ residual)
        found = accurate(one, trial, steps)
        size = float(np.abs(found).max())
        if not size < best:
            break
        path, residual, best = trial, found, size
        if best < settings.polished:
            break
    if not best < 1e-10:
        raise Stalled(path)
    return path, steps


def accurate(one: System, path: Path, steps: int) -> np.ndarray:
    """Scaled residual with segments integrated in so many steps."""
    duration = path.period * one.problem.boundary.fraction / len(path.nodes)
    return rows(one, path, ends_of(one.march, path.nodes, duration, steps, path.unfolding)) / one.rows
