"""The method of collocation: a cycle on a mesh that fits it, finer and finer until two meshes agree; for stiff systems.

Each interval of the mesh is a segment of the loop (`integrate.collocation`), whose equations are solved whole, sparse and
pivoted. It starts from a lap of a simulation (`guesses.settled`); its certificate is the explicit DOP853 of any orbit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.collocation import Collocation, along, collocated, curvatures
from orbitfinder.integrate.equations import invariant_gradients
from orbitfinder.integrate.march import March
from orbitfinder.loops.condensed import pivoted
from orbitfinder.loops.ipopt import Callback, Progress, SolveSettings
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.problem import Guess, Problem, at_forcing_period, loop_of
from orbitfinder.loops.scales import Measures
from orbitfinder.loops.symmetry import recognise, symplectic
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import Settings, Solver, full
from orbitfinder.orbits.floquet import Floquet, complement, generated, judged
from orbitfinder.orbits.guesses.settled import cycle, lap
from orbitfinder.orbits.measure import provenance, recorded
from orbitfinder.orbits.product import merged, product
from orbitfinder.records.orbit import Orbit

COARSEST, FINEST = 50, 3200
"""Intervals of the first mesh, and of the last that is tried"""
FINER = 2
"""Times as many intervals of the next mesh"""
LONGEST = 0.1
"""Share of the mean density of a mesh that it has everywhere"""
AGREED, SETTLED = 3e-13, 1e-10
"""Relative difference of the periods of two meshes that is as good as none, and one that is small: what then no longer
shrinks is round-off"""
NEWTON = Settings(floor=1e-12, round_off=1e-8, converged=1e-8, most_evaluations=40, longest=0.3, halving=True,
                  patience=12)  # fmt: skip
"""Of the rows and steps in extents of the motion"""
EVEN = 512
"""Intervals at which a symmetry is looked for"""
STIFF = 2e4
"""Fastest decay on the way times the period from which on explicit steps are limited by stability, not by accuracy"""
QUIET = 1e-3
"""What a rate of decay counts beside a pace where it is chosen where t = 0 lies: both make the certificate's gap"""


@dataclass(frozen=True)
class Meshed:
    """An orbit on a mesh of so many intervals: its unknowns, stages (N x m x d), ends and transitions, the integral."""

    w: Unknowns
    stages: np.ndarray
    ends: np.ndarray
    transitions: np.ndarray
    action: float


def refused(problem: Problem) -> str:
    """Why collocation cannot be the method for a problem, or nothing."""
    if problem.control is not None or not problem.model.smooth:
        return "it has controls or impacts"
    if problem.constraints or problem.bounds or problem.phase_condition or problem.objective != "nearest":
        return "it has constraints, bounds or an objective"
    if problem.boundary.maps or problem.relative:
        return "its symmetry makes it a part of a period"
    if problem.model.constraint is not None:
        return "its model has constraints"
    if problem.count().freedom:
        return f"its pins leave {problem.count().freedom} to choose"
    return ""


def settles(problem: Problem) -> bool:
    """Whether a motion of a problem may settle on its orbit, so that a simulation is a start."""
    model = problem.model
    return not refused(problem) and model.rates is not None and not model.invariants and not model.conservative


def stiff(problem: Problem) -> str:
    """Why a problem is stiff, or nothing: what decays, measured along a lap of its guess or of a simulation."""
    if not settles(problem):
        return ""
    try:
        with np.errstate(all="ignore"):
            guess = lap(problem.model, problem.guess)
            decays = stiffness(collocated_equations(problem), guess)
    except (ConvergenceError, IntegrationError, np.linalg.LinAlgError):
        return ""
    return f"stiff: what decays fastest does so {decays:.2g} times in a period" if decays > STIFF else ""


def found(problem: Problem, settings: SolveSettings, report: Callback | None, began: float) -> tuple[Orbit, Model]:
    """The orbit of a smooth system, by collocation."""
    problem = at_forcing_period(problem)
    equations = collocated_equations(problem)
    guess = lap(problem.model, problem.guess)
    if settles(problem):
        guess = cycle(problem.model, problem.guess, stiffness(equations, guess) > STIFF)
    free = np.array([{**problem.guess.free, **{pin.name: pin.value for pin in problem.pin}}.get(name, value)
                     for name, value in zip(equations.free, equations.numbers, strict=True)])  # fmt: skip
    told = (lambda event: None) if report is None else report
    solved = refined(problem, equations, partial(begun, equations, guess, free), told)
    values = dict(zip(equations.free, map(float, solved[-1].w.free), strict=True))
    model = with_parameters(problem.model, values)
    orbit = measured(replace(problem, model=model), equations, solved[-1])
    bar = abs(solved[-1].w.period - solved[-2].w.period) + 4 * np.spacing(orbit.period) * len(orbit.samples) ** 0.5
    said = provenance(problem, settings, began) | {
        "method": "collocation", "intervals": len(solved[-1].w.nodes), "period_error": float(bar),
        "stiffness": stiffness(equations, guess),
    }  # fmt: skip
    return replace(orbit, provenance=said | ({"free": values} if values else {})), model


def collocated_equations(problem: Problem) -> Equations:
    """The equations of a problem, integrated by collocation."""
    usual = Equations(problem.model, problem.boundary, problem.free, action=True)
    assert isinstance(usual.march, March)
    return Equations(problem.model, problem.boundary, problem.free, True, given=collocated(usual.march))


def begun(equations: Equations, guess: Guess, free: np.ndarray, count: int) -> Meshed:
    """A guess's trajectory on a first mesh, which shares out its steps, its way and its time."""
    assert guess.times is not None and guess.states is not None
    times, states = np.asarray(guess.times, float) / guess.period, np.asarray(guess.states, float)
    way = np.append(0.0, np.cumsum(np.abs(np.diff(states, axis=0) / nonzero(np.ptp(states, axis=0))).max(axis=1)))
    work = np.linspace(0.0, 1.0, len(times)) + way / way[-1] + times
    mesh = np.interp(np.linspace(0.0, work[-1], count + 1), work, times)
    mesh[-1] = 1.0
    points = _march(equations).tableau.points
    inside = (mesh[:-1, None] + np.diff(mesh)[:, None] * points).ravel()
    nodes, between = (np.array([np.interp(at, times, column) for column in states.T]).T for at in (mesh[:-1], inside))
    stages = between.reshape(len(nodes), points.size, -1) - nodes[:, None]
    size = nodes.shape[1]
    w = equations.unknowns(nodes, guess.period, mesh, free)
    return Meshed(w, stages, nodes[:0], np.zeros((0, size, size)), 0.0)


def refined(
    problem: Problem, equations: Equations, start: Callable[[int], Meshed], report: Callable[[Progress], None]
) -> list[Meshed]:
    """The orbit on finer and finer meshes until two periods agree. Raises `ConvergenceError` where none do."""
    solved, count, failed, change = list[Meshed](), FINER * COARSEST, "", np.inf
    while count <= FINEST:
        limit.check()
        try:
            now = start(count) if not solved else solved[-1]
            for _ in range(2):  # the mesh of an orbit that is known, and that of the better one
                now = closed(problem, equations, regridded(equations, now, count) if now.ends.size else now)
        except (ConvergenceError, IntegrationError) as error:
            failed, count = str(error), FINER * count
            continue
        solved.append(now)
        before, change = change, abs(now.w.period / solved[-2].w.period - 1) if len(solved) > 1 else np.inf
        report(Progress(f"collocation, {count} intervals", len(solved) - 1, min(change, 1.0), now.w.period, 0.0))
        if change <= AGREED or (change <= SETTLED and change > 0.5 * before):
            return solved
        count *= FINER
    if change <= SETTLED:
        return solved
    raise ConvergenceError(f"collocation on up to {FINEST} intervals found no orbit: {failed or 'meshes do not agree'}")


def regridded(equations: Equations, known: Meshed, count: int) -> Meshed:
    """An orbit interpolated on a mesh of so many intervals that spreads the next derivative evenly."""
    rule, w = _march(equations).tableau, known.w
    units = nonzero(np.ptp(w.nodes, axis=0))
    density = curvatures(rule, w.nodes, known.stages, w.mesh, units) ** (1.0 / (rule.points.size + 1))
    steps = np.diff(w.mesh)
    density = np.maximum(density, LONGEST * float(density @ steps))
    work = np.append(0.0, np.cumsum(density * steps))
    mesh = np.interp(np.linspace(0.0, work[-1], count + 1), work, w.mesh)
    inside = (mesh[:-1, None] + np.diff(mesh)[:, None] * rule.points).ravel()
    nodes, between = (along(rule, w.nodes, known.stages, w.mesh, at) for at in (mesh[:-1], inside))
    stages = between.reshape(count, rule.points.size, -1) - nodes[:, None]
    return replace(known, w=replace(w, nodes=nodes, mesh=mesh), stages=stages)


def closed(problem: Problem, equations: Equations, start: Meshed) -> Meshed:
    """The orbit on the mesh of a start, by Newton's method. Raises `ConvergenceError`, `IntegrationError`."""
    march, w = _march(equations), start.w
    march.begin(w.nodes, start.stages, w.mesh, w.tail)
    last = w.nodes[-1] + start.stages[-1].T @ march.tableau.end
    loop = loop_of(problem, equations, w, last, problem.pin)
    units = nonzero(np.ptp(w.nodes, axis=0))
    free = np.where(w.free != 0.0, np.abs(w.free), 1.0)
    measures = Measures.of(loop, w, w.joined(units, w.period, 1.0 / w.period, free))

    def linearised(w: Unknowns) -> tuple[np.ndarray, Solver]:
        try:
            path = equations.varied(w)
        except IntegrationError:
            return np.full(1, np.inf), np.negative
        return loop.rows(w, path.ends) / measures.rows, pivoted(measures.linearised(loop.linearised(w, path)))

    try:
        solved = full(w, linearised, NEWTON, lambda w, step: w.moved(step * measures.columns))
    except np.linalg.LinAlgError:
        raise ConvergenceError("the equations are singular there") from None
    if not solved.converged:
        raise ConvergenceError(f"Newton's method stalled at a residual of {solved.size:.2g}; start nearer")
    w = solved.w.moved(solved.solver(solved.rows) * measures.columns) if solved.size > NEWTON.floor else solved.w
    path = equations.varied(w)
    stages = march.stages(w.nodes, w.mesh, w.tail)
    return Meshed(w, stages, path.ends, path.transitions, path.integral)


def measured(problem: Problem, equations: Equations, known: Meshed) -> Orbit:
    """The Orbit (without certificate) on its mesh, begun where its certificate sees best."""
    model = problem.model
    known = known if model.forced or problem.pin else _turned(equations, known)
    w, rule = known.w, _march(equations).tableau
    even = along(rule, w.nodes, known.stages, w.mesh, np.linspace(0.0, 1.0, EVEN + 1))
    states = np.vstack([w.nodes, known.ends[-1:]])
    return recorded(
        problem, w.period, known.ends[-1], w.nodes[:1], w.mesh * w.period, states, w.unfolding, known.action,
        multipliers(model, equations, known), recognise(np.linspace(0.0, w.period, EVEN + 1), even, model),
    )  # fmt: skip


def _turned(equations: Equations, known: Meshed) -> Meshed:
    """The same orbit begun where neither its pace nor what decays makes much of errors."""
    w, march = known.w, _march(equations)
    units = nonzero(np.ptp(w.nodes, axis=0))
    paces = np.linalg.norm(march.rates(w.nodes, w.tail) / units, axis=1) * w.period
    decays = march.decays(w.nodes, w.tail, w.mesh[:-1] * w.period) * w.period
    k = int(np.argmin(paces + QUIET * decays / nonzero(paces)))
    mesh = np.append(w.mesh[k:-1] - w.mesh[k], 1.0 - w.mesh[k] + w.mesh[: k + 1])
    turned = replace(w, nodes=np.roll(w.nodes, -k, axis=0), mesh=mesh)
    rest = (np.roll(part, -k, axis=0) for part in (known.stages, known.ends, known.transitions))
    return Meshed(turned, *rest, known.action)


def multipliers(model: Model, equations: Equations, known: Meshed) -> Floquet:
    """The non-trivial multipliers, of the transitions one after another that are never multiplied out."""
    w, march = known.w, _march(equations)
    units = nonzero(np.ptp(w.nodes, axis=0))
    matrices, places = merged(known.transitions * units / units[:, None])
    nodes = np.vstack([w.nodes, w.nodes[:1]])[places]
    flows = [] if model.forced else [march.rates(nodes, w.tail)]
    directions = np.stack([*flows, *np.array([generated(model, x) for x in nodes]).swapaxes(0, 1)], axis=1)
    gradients = np.array([invariant_gradients(model)(x).full() for x in nodes])
    bases = complement(gradients * units, directions / units)
    factors = bases[1:].swapaxes(1, 2) @ matrices @ bases[:-1]
    return judged(product(factors).values if factors.size else np.zeros(0), symplectic(model))


def stiffness(equations: Equations, guess: Guess) -> float:
    """The fastest decay along a guess's trajectory, times its period."""
    assert guess.times is not None and guess.states is not None
    tail = equations.unknowns(np.asarray(guess.states)[:1], guess.period, np.zeros(2)).tail
    return float(_march(equations).decays(np.asarray(guess.states), tail, np.asarray(guess.times)).max() * guess.period)


def _march(equations: Equations) -> Collocation:
    assert isinstance(equations.march, Collocation)
    return equations.march
