"""Cheap first: damped Newton (Levenberg-Marquardt) on loosely integrated multiple shooting.

The equations are built once and used for every start with other numbers; nothing is transcribed, so a hopeless start
costs a few integrations. Source of the damping: K. Levenberg, Quarterly of Applied Mathematics 2 (1944) 164-168;
D. Marquardt, SIAM Journal 11 (1963) 431-441.

Beside a nearly degenerate orbit it is one equation in one unknown, followed along the valley where the others hold.
There the Jacobian J has one singular value that is far smaller than the rest (a nearly resonant torus, a fold or
a pitchfork close by): the residual F is small along a curve, damped steps creep and chord steps do not contract.
With its singular vectors u, v the bordered equations

    F(x) = mu u,  v.(x - x0) = h

are regular; mu(h) is followed from h = 0 until its sign changes, and there its zero is an orbit. Source: reduction
of Lyapunov and Schmidt by bordered systems, W. Govaerts, Numerical Methods for Bifurcations of Dynamical
Equilibria, SIAM 2000, chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orbitfinder._runtime.sizes import size_of
from orbitfinder.continuation.follow import zero
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import rounded, uniform
from orbitfinder.loops.loop import Equations, Loop, Unknowns
from orbitfinder.loops.problem import Problem, loop_of
from orbitfinder.loops.scales import Measures
from orbitfinder.mechanics.newton import Settings, Solver, chord, full, largest

POLISH = Settings(floor=1e-13, round_off=1e-13, converged=1e-10, most_evaluations=8)
REGULAR = Settings(floor=0.0, converged=0.0, round_off=0.0, most_evaluations=6, patience=0, progress=1.0)


@dataclass(frozen=True)
class ClosingSettings:
    """How a start is brought to an orbit; residuals and steps are scaled."""

    finer: int = 3
    """the polish begins with steps shorter than the cheap stage's by this factor"""
    squared_above: float = 1e-6
    """damping above which the normal equations are accurate enough"""
    patience: int = 6
    """evaluations in which the residual must have halved, or it creeps"""
    near: float = 1e-2
    """residual below which a path is near an orbit"""
    narrow: float = 3e-2
    """a Jacobian is nearly singular in one direction when its last singular value is this much below the one before"""
    converged: float = 1e-6
    """residual at which the polish takes over"""
    most_evaluations: int = 40
    hopeless: tuple[tuple[int, float], ...] = ((12, 1.0), (24, 0.3))
    """(evaluations, residual): given up when it is still larger after so many"""
    largest_step: float = 1.0
    """about a radian"""
    largest_rate: float = 100.0
    """bound on rates, in units of the guess's root mean square; a step beyond it is not taken"""
    largest_unfolding: float = 100.0
    """bound on |s| times the clock (s); values of 10 have been seen to come back, this has left the problem"""
    polish: Settings = POLISH
    longest: float = 0.3
    shortest: float = 1e-3
    """of the steps along the valley"""
    regular: Settings = REGULAR
    """how the regular equations are solved: given up where what is left of them grows"""
    most_trials: int = 60
    slack: float = 1e-3
    """the regular equations hold when they are smaller than |mu| by this"""
    round_off: float = 3e-13
    """residual that counts as none"""

    def creeping(self, norms: list[float]) -> bool:
        """True when the last residuals are small and have not halved in a while; asked anew after as long again."""
        near = norms[-1] < self.near and len(norms) > self.patience and len(norms) % self.patience == 0
        return near and norms[-1] > norms[-1 - self.patience] / 2

    def singular(self, jacobian: np.ndarray) -> bool:
        """True when a Jacobian is nearly singular in one direction alone."""
        values = np.linalg.svd(jacobian, compute_uv=False)
        return bool(values[-1] < self.narrow * values[-2])

    def step(self, jacobian: np.ndarray, residual: np.ndarray, damping: float) -> np.ndarray:
        """The Levenberg-Marquardt step, no longer than `largest_step` in any component."""
        try:
            if damping > self.squared_above:
                matrix = jacobian.T @ jacobian
                matrix[np.diag_indices_from(matrix)] += damping
                step = -np.linalg.solve(matrix, jacobian.T @ residual)
            else:
                step = np.linalg.lstsq(jacobian, -residual, rcond=1e-13)[0]
        except np.linalg.LinAlgError as error:
            raise ConvergenceError("singular equations") from error
        return np.asarray(step * min(1.0, self.largest_step / size_of(step)))


class Stalled(ConvergenceError):
    """Newton's method came near an orbit that is nearly degenerate, and no nearer; `w` is where it ended."""

    def __init__(self, w: Unknowns) -> None:
        super().__init__("stalled near a degenerate orbit")
        self.w = w


@dataclass(frozen=True)
class ScaledLoop:
    """The loop of one start, the longest step of its marches (s), what all is measured in."""

    loop: Loop
    step: float
    measures: Measures
    periods: tuple[float, float]
    units: tuple[float, ...] = ()
    settings: ClosingSettings = ClosingSettings()

    def at(self, w: Unknowns) -> Unknowns:
        """w on the mesh that the step asks for."""
        count, fraction = len(w.nodes), self.loop.equations.symmetry.fraction
        steps = rounded(w.period * fraction / count / self.step)
        return w if w.mesh.size == steps * count + 1 else replace(w, mesh=uniform(fraction, count, steps))


def scaled_loop(
    problem: Problem,
    equations: Equations,
    step: float,
    w: Unknowns,
    periods: tuple[float, float],
    units: np.ndarray,
    clock: float,
) -> ScaledLoop:
    """The loop of one start, scales and references from its guess, from the `units` of states (2n) and a `clock` (s).

    A first-order system's states (d) are scaled by their units alone.
    """
    n, loop = problem.model.degrees_of_freedom, loop_of(problem, equations, w, None, problem.pin)
    if problem.model.rates is not None:
        measures = Measures.of(loop, w, w.joined(units, problem.guess.period, 1.0 / clock, np.zeros(0)))
        return ScaledLoop(loop, step, measures, periods, tuple(units))
    rate = max(float(np.sqrt(np.mean((w.nodes[:, n:] / units[:n]) ** 2))), 2 * np.pi / problem.guess.period)
    node = np.concatenate([units[:n], rate * units[:n]])
    measures = Measures.of(loop, w, w.joined(node, problem.guess.period, 1.0 / clock, np.zeros(0)))
    first, phases, _ = np.split(measures.rows, [measures.rows.size - len(loop.normals) - 1, measures.rows.size - 1])
    phases = np.full(phases.size, rate) if np.all(units == 1.0) else phases
    rows = np.concatenate([first, phases, [_span(problem, w.nodes[0, :n], node[n:])]])
    return ScaledLoop(loop, step, replace(measures, rows=rows), periods, tuple(units))


def _span(problem: Problem, q: np.ndarray, v: np.ndarray) -> float:
    """What an energy is measured in (J): how far it is above the potential at q, which may be hardly at all."""
    model, level = problem.model, problem.pin[0].value
    lowest = float(model.potential(q, model.parameter_values))
    moving = 2.0 * float(model.kinetic(q, v, model.parameter_values))
    return max(abs(level - lowest), 0.1 * abs(level), 1e-3 * min(1.0, moving))


def linearised(scaled: ScaledLoop, w: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """ScaledLoop residual and Jacobian by the variational equations."""
    w = scaled.at(w)
    path = scaled.loop.equations.varied(w)
    jacobian = scaled.loop.linearised(w, path).matrix()
    return scaled.loop.rows(w, path.ends) / scaled.measures.rows, scaled.measures.matrix(jacobian)


def moved(scaled: ScaledLoop, w: Unknowns, step: np.ndarray) -> Unknowns:
    """The unknowns after a scaled step, the period kept in range."""
    after = w.moved(step * scaled.measures.columns)
    return replace(after, period=float(np.clip(after.period, *scaled.periods)))


def bounded(scaled: ScaledLoop, w: Unknowns) -> Unknowns:
    """The unknowns, if rates and unfolding are within bounds; `IntegrationError` otherwise."""
    n = 0 if scaled.loop.equations.model.rates is not None else w.nodes.shape[1] // 2
    sizes = w.at(scaled.measures.columns)
    fast = float(np.abs(w.nodes[:, n:] / sizes.nodes[:, n:]).max()) > scaled.settings.largest_rate
    if fast or float(np.abs(w.unfolding / sizes.unfolding).max(initial=0.0)) > scaled.settings.largest_unfolding:
        raise IntegrationError("out of bounds", time=0.0, state=w.nodes[0])
    return w


def solve(scaled: ScaledLoop, w: Unknowns) -> tuple[Unknowns, np.ndarray]:
    """Unknowns with a small scaled residual and the Jacobian there; `ConvergenceError` says why there is none."""
    damping, how = 1e-2, scaled.settings
    residual, jacobian = linearised(scaled, w)
    norm = float(np.abs(residual).max())
    norms: list[float] = []
    for evaluation in range(1, how.most_evaluations + 1):
        if norm < how.converged:
            return w, jacobian
        if any(evaluation > after and norm > most for after, most in how.hopeless):
            raise ConvergenceError("hopeless start")
        norms.append(norm)
        if how.creeping(norms) and how.singular(jacobian):
            raise Stalled(w)
        step = how.step(jacobian, residual, damping)
        try:
            trial = bounded(scaled, moved(scaled, w, step))
            rows, slopes = linearised(scaled, trial)
        except IntegrationError:
            damping = max(10 * damping, 1e-3)
            continue
        if float(np.linalg.norm(rows)) < float(np.linalg.norm(residual)):
            w, residual, jacobian = trial, rows, slopes
            norm, damping = float(np.abs(residual).max()), damping / 10 if damping > 1e-9 else 0.0
        else:
            damping = max(5 * damping, 1e-4)
    raise ConvergenceError("iteration limit")


def polished(scaled: ScaledLoop, w: Unknowns, jacobian: np.ndarray) -> Unknowns:
    """w to round-off, by chord steps with an accurate residual, on the mesh that it needs; `Stalled` above 1e-10."""
    equations, measures = scaled.loop.equations, scaled.measures

    def rows(w: Unknowns, ends: np.ndarray) -> np.ndarray:
        return np.asarray(scaled.loop.rows(w, ends) / measures.rows)

    def solver(jacobian: np.ndarray) -> Solver:
        inverse = np.linalg.pinv(jacobian, rcond=1e-13)
        return lambda rows: -(inverse @ rows) * measures.columns

    def renewed(w: Unknowns) -> Solver:
        return solver(measures.matrix(scaled.loop.linearised(w, equations.varied(w)).matrix()))

    w = replace(scaled, step=scaled.step / scaled.settings.finer).at(w)
    ends, mesh = equations.march.refined_ends(w.nodes, w.mesh, w.tail, scaled.units)
    w = replace(w, mesh=mesh)
    functions = (lambda w: rows(w, equations.ends(w)), renewed)
    solved = chord(w, rows(w, ends), solver(jacobian), functions, scaled.settings.polish, Unknowns.moved)
    if not solved.converged:
        raise Stalled(solved.w)
    return solved.w


@dataclass(frozen=True)
class ValleyPoint:
    """A point of the valley: w, scaled residual F and Jacobian there, u and v, and mu = u.F."""

    w: Unknowns
    residual: np.ndarray
    jacobian: np.ndarray
    left: np.ndarray
    right: np.ndarray

    @property
    def mu(self) -> float:
        """What is left of the residual in the one equation that is not regular."""
        return float(self.left @ self.residual)


def orbit_in_valley(scaled: ScaledLoop, w: Unknowns) -> tuple[Unknowns, np.ndarray]:
    """The unknowns of an orbit in the valley that w lies in, and the Jacobian there; `Stalled` when there is none."""
    fine = replace(scaled, step=fine_step(scaled, w))
    try:
        here = corrected(fine, turned(ValleyPoint(w, *linearised(fine, w), np.zeros(0), np.zeros(0))), 0.0)
        if abs(here.mu) > scaled.settings.round_off:
            here = crossed(fine, *bracket(fine, turned(here)))
    except (IntegrationError, np.linalg.LinAlgError) as error:
        raise Stalled(w) from error
    return here.w, here.jacobian


def fine_step(scaled: ScaledLoop, w: Unknowns) -> float:
    """The longest step (s) with which half of it agrees; the polish that follows needs no better Jacobian."""
    w = scaled.at(w)
    mesh = scaled.loop.equations.march.refined_ends(w.nodes, w.mesh, w.tail, scaled.units)[1]
    return 2 * w.period * float(mesh[-1]) / (mesh.size - 1)


def turned(at: ValleyPoint) -> ValleyPoint:
    """The point with the singular vectors of its own Jacobian, in the senses of those that it came with."""
    left, _, right = np.linalg.svd(at.jacobian)
    u, v = left[:, -1], right[-1]
    if at.left.size:
        u, v = u * (np.sign(u @ at.left) or 1.0), v * (np.sign(v @ at.right) or 1.0)
    return replace(at, left=u, right=v)


def corrected(scaled: ScaledLoop, at: ValleyPoint, length: float) -> ValleyPoint:
    """Where the regular equations hold at h = `length` from a point, by Newton's method; `Stalled` if nowhere."""
    how = scaled.settings

    def onward(point: ValleyPoint, step: np.ndarray) -> ValleyPoint:
        w = bounded(scaled, moved(scaled, point.w, step))
        return ValleyPoint(w, *linearised(scaled, w), at.left, at.right)

    def regular(point: ValleyPoint) -> tuple[np.ndarray, Solver]:
        rest = point.residual - point.mu * at.left

        def step(_: np.ndarray) -> np.ndarray:
            bordered = np.block([[point.jacobian, -at.left[:, None]], [at.right[None], np.zeros((1, 1))]])
            return np.asarray(np.linalg.solve(bordered, np.append(-rest, 0.0))[:-1])

        hold = largest(rest) < max(how.slack * abs(point.mu), how.round_off)
        return np.zeros(0) if hold else rest, step

    solved = full(onward(at, length * at.right), regular, how.regular, onward)
    if not solved.converged:
        raise Stalled(at.w)
    return solved.w


def bracket(scaled: ScaledLoop, at: ValleyPoint) -> tuple[ValleyPoint, ValleyPoint, float]:
    """Two successive points between which mu changes its sign, and h from the first to the second."""
    how = scaled.settings
    length = -how.longest * (np.sign(at.mu * (at.left @ at.jacobian @ at.right)) or 1.0)  # the way on which |mu| falls
    for _ in range(how.most_trials):
        try:
            there = corrected(scaled, at, length)
        except (Stalled, IntegrationError):
            length /= 2
            if abs(length) < how.shortest:
                break
            continue
        if there.mu * at.mu <= 0:
            return at, there, length
        at, length = turned(there), float(np.clip(1.5 * length, -how.longest, how.longest))
    raise Stalled(at.w)


def crossed(scaled: ScaledLoop, first: ValleyPoint, second: ValleyPoint, length: float) -> ValleyPoint:
    """The zero of mu between two points, `length` apart."""
    met = {0.0: first, length: second}

    def mu(share: float) -> float:
        if share not in met:
            met[share] = corrected(scaled, first, share)
        value = met[share].mu
        return 0.0 if abs(value) < scaled.settings.round_off else value

    root = zero(mu, 0.0, length, 1e-13)
    return met.get(root) or corrected(scaled, first, root)
