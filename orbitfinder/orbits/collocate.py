"""The method of collocation, for stiff systems: a cycle on meshes that fit it, finer until two of them agree.

Each interval of a mesh is a segment of the loop (`integrate.collocation`), whose equations are solved whole, sparse
and pivoted. It starts from a lap of a simulation (`guesses.settled`); its certificate is any orbit's explicit DOP853.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import UNSOLVED, ConvergenceError, IntegrationError
from orbitfinder.integrate.collocation import Collocation
from orbitfinder.integrate.equations import invariant_gradients
from orbitfinder.integrate.march import March, uniform
from orbitfinder.loops.condensed import pivoted
from orbitfinder.loops.ipopt import Callback, Progress, SolveSettings
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.mesh import regridded
from orbitfinder.loops.problem import Guess, Problem, at_forcing_period, loop_of
from orbitfinder.loops.scales import Measures
from orbitfinder.loops.symmetry import recognise, symplectic
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import Settings, Solver, full
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.floquet import Floquet, complement, generated, judged
from orbitfinder.orbits.guesses.settled import cycles, lap
from orbitfinder.orbits.measure import provenance, recorded
from orbitfinder.orbits.method import Method
from orbitfinder.orbits.product import merged, product
from orbitfinder.records.orbit import Orbit

COARSEST, QUICK, FINEST = 50, 400, 3200
"""Half the intervals of the first mesh, those of the last that is tried of a motion that nearly closes, and of any"""
FINER, EVEN = 2, 512
"""Times as many intervals of the next mesh; intervals at which a symmetry is looked for"""
AGREED, SETTLED = 3e-13, 1e-10
"""Relative difference of the periods of two meshes that is as good as none, and one that is small: what then no longer
shrinks is round-off"""
NEWTON = Settings(floor=1e-12, round_off=1e-8, converged=1e-8, most_evaluations=40, longest=0.3, halving=True,
                  patience=12)  # fmt: skip
"""Of the rows and steps in extents of the motion"""
STIFF, QUIET, EXPLICIT = 2e4, 1e-3, 1e-9
"""Fastest decay on the way times the period from which on explicit steps are limited by stability, not by accuracy.
What a rate of decay counts beside a pace where it is chosen where t = 0 lies: both make the certificate's gap. Error of
explicit steps that a lap is known from, in extents of the motion"""


def by(
    march: type[Collocation], suits: Callable[[Problem], str] = lambda problem: "",
    rescues: Callable[[Problem], bool] = lambda problem: False,
) -> Method:  # fmt: skip
    """The method of a kind of collocation: what it suits unasked, and what it is tried for where another failed."""
    return Method(suits, partial(found, march), refused, rescues, march, partial(begun, march))


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
            decays = stiffness(_equations(Collocation, problem), guess)
    except (ConvergenceError, IntegrationError, np.linalg.LinAlgError):
        return ""
    return f"stiff: what decays fastest does so {decays:.2g} times in a period" if decays > STIFF else ""


def found(
    march: type[Collocation], problem: Problem, settings: SolveSettings, report: Callback | None, began: float
) -> tuple[Orbit, Model]:
    """The orbit of a smooth system, by collocation."""
    problem = at_forcing_period(problem)
    equations = _equations(march, problem)
    solved = _on_meshes(problem, equations, report)
    w = solved[-1]
    values = dict(zip(equations.free, map(float, w.free), strict=True))
    model = with_parameters(problem.model, values)
    orbit = measured(replace(problem, model=model), equations, w)
    bar = abs(w.period - solved[-2].period) + float(np.spacing(w.period)) * len(w.nodes) ** 0.5
    said = provenance(problem, settings, began) | {
        "method": march.name, "intervals": len(w.nodes), "period_error": float(bar),
        "decays": float(_march(equations).decays(w.nodes, w.tail, w.mesh[:-1] * w.period).max() * w.period),
    }  # fmt: skip
    return replace(orbit, provenance=said | ({"free": values} if values else {})), model


def begun(march: type[Collocation], problem: Problem, free: tuple[str, ...]) -> tuple[Equations, Unknowns]:
    """The equations of a family by collocation, and the orbit of a problem in their unknowns."""
    fixed = _equations(march, problem)
    w = _on_meshes(problem, fixed, alone=True)[-1]
    w = w if problem.model.forced else _turned(fixed, w)
    equations = Equations.of(problem.model, problem.boundary, free, march)
    place, own = equations.unknowns(w.nodes, w.period, w.mesh), _march(equations)
    own.begin(place.nodes, _march(fixed).stages(w.nodes, w.mesh, w.tail), place.mesh, place.tail)
    return equations, regridded(own, place)


def _equations(march: type[Collocation], problem: Problem) -> Equations:
    return Equations(problem.model, problem.boundary, tuple(problem.free), action=True, by=march)


def _on_meshes(
    problem: Problem, equations: Equations, report: Callback | None = None, alone: bool = False
) -> list[Unknowns]:
    """The orbit of a problem on finer and finer meshes until two periods agree, the coarser first; or `alone` on the
    first from which a family's own mesh can be told.

    Raises `ConvergenceError` where none do.
    """
    guess = _lap(problem, equations) if alone else lap(problem.model, problem.guess)
    if not settles(problem):
        return _refined(problem, equations, guess, FINEST, report, alone)
    failed = ConvergenceError("the guess leads nowhere; give a state near the cycle and its period")
    for near in cycles(problem.model, problem.guess, guess, stiffness(equations, guess) > STIFF):
        own = problem.guess.trajectory is None and np.array_equal(near.state, problem.guess.start)
        try:
            return _refined(problem, equations, near, min(QUICK, FINEST) if own else FINEST, report, alone)
        except ConvergenceError as error:
            failed = error
    raise failed


def _lap(problem: Problem, equations: Equations) -> Guess:
    """A guess with a trajectory for its period: by explicit steps where they are short enough, else by `lap`."""
    guess, march = problem.guess, _march(equations)
    if guess.trajectory is None:
        w = equations.unknowns(guess.start[None], guess.period, uniform(1.0, 1, EVEN))
        with contextlib.suppress(IntegrationError), np.errstate(all="ignore"):
            states = March.states(march, w.nodes, w.mesh, w.tail)
            units, some = extents_of(problem.model, states, guess.period), np.arange(0, EVEN, 4)
            if march.step_errors(states, w.mesh, w.tail, units, some).max() <= EXPLICIT:
                return Guess(states[0], guess.period, w.mesh * guess.period, states)
    return lap(problem.model, guess)


def _refined(
    problem: Problem, equations: Equations, guess: Guess, finest: int, report: Callback | None, alone: bool
) -> list[Unknowns]:
    """The same from a lap."""
    march, solved, failed, change = _march(equations), list[Unknowns](), "", np.inf
    count = COARSEST if alone else FINER * COARSEST
    while count <= finest:
        limit.check()
        try:
            now = regridded(march, solved[-1], count) if solved else _begun(problem, equations, guess, count)
            now = closed(problem, equations, now)
            if alone and march.wanted(now.nodes, now.mesh, now.tail) < 2 * count:
                return [now]
            for _ in range(2):  # the mesh of an orbit that is known, and that of the better one
                now = closed(problem, equations, regridded(march, now, count))
        except UNSOLVED as error:
            failed, count = str(error), FINER * count
            continue
        solved.append(now)
        before, change = change, abs(now.period / solved[-2].period - 1) if len(solved) > 1 else np.inf
        if report:
            report(Progress(f"{equations.by.name}, {count} intervals", len(solved), min(change, 1.0), now.period, 0.0))
        if change <= AGREED or (change <= SETTLED and change > 0.5 * before):
            return solved
        count *= FINER
    if change <= SETTLED:
        return solved
    name, why = equations.by.name, failed or "meshes do not agree"
    raise ConvergenceError(f"{name} on up to {finest} intervals found no orbit: {why}")


def _begun(problem: Problem, equations: Equations, guess: Guess, count: int) -> Unknowns:
    """A guess's trajectory on a first mesh, which shares out its steps, its way and its time."""
    times, states = np.asarray(guess.times, float) / guess.period, np.asarray(guess.states, float)
    way = np.append(
        0.0, np.cumsum(np.abs(np.diff(states, axis=0) / extents_of(problem.model, states, guess.period)).max(axis=1))
    )
    work = np.linspace(0.0, 1.0, len(times)) + way / way[-1] + times
    mesh = np.interp(np.linspace(0.0, work[-1], count + 1), work, times)
    mesh[-1] = 1.0
    march = _march(equations)
    inside = (mesh[:-1, None] + np.diff(mesh)[:, None] * march.tableau.points).ravel()
    nodes, between = (np.array([np.interp(at, times, column) for column in states.T]).T for at in (mesh[:-1], inside))
    known = {**problem.guess.free, **{pin.name: pin.value for pin in problem.pin}}
    numbers = zip(equations.free, equations.numbers, strict=True)
    w = equations.unknowns(nodes, guess.period, mesh, np.array([known.get(name, value) for name, value in numbers]))
    march.begin(nodes, between.reshape(count, march.tableau.points.size, -1) - nodes[:, None], mesh, w.tail)
    return w


def closed(problem: Problem, equations: Equations, w: Unknowns) -> Unknowns:
    """The orbit on the mesh of a first guess, by Newton's method. Raises `ConvergenceError`, `IntegrationError`."""
    units = extents_of(problem.model, w.nodes, w.period)
    loop = loop_of(problem, equations, w, equations.ends(w)[-1], problem.pin, units)
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
    return solved.w.moved(solved.solver(solved.rows) * measures.columns)


def measured(problem: Problem, equations: Equations, w: Unknowns) -> Orbit:
    """The Orbit (without certificate) on its mesh, begun where its certificate sees best."""
    model, march = problem.model, _march(equations)
    w = w if model.forced or problem.pin else _turned(equations, w)
    path, places = equations.varied(w, states=True), np.linspace(0.0, 1.0, EVEN + 1)
    even = march.sampled(w.nodes, w.mesh, w.tail, places)
    return recorded(
        problem, w.period, path.ends[-1], w.nodes[:1], w.mesh * w.period, path.states, w.unfolding, path.integral,
        _multipliers(model, equations, w, path.transitions), recognise(places * w.period, even, model),
    )  # fmt: skip


def _turned(equations: Equations, w: Unknowns) -> Unknowns:
    """The same orbit begun where neither its pace nor what decays makes much of errors."""
    march = _march(equations)
    units = extents_of(equations.model, w.nodes, w.period)
    paces = np.linalg.norm(march.rates(w.nodes, w.tail) / units, axis=1) * w.period
    decays = march.decays(w.nodes, w.tail, w.mesh[:-1] * w.period) * w.period
    k = int(np.argmin(paces + QUIET * decays / nonzero(paces)))
    mesh = np.append(w.mesh[k:-1] - w.mesh[k], 1.0 - w.mesh[k] + w.mesh[: k + 1])
    later = replace(w, nodes=np.roll(w.nodes, -k, axis=0), mesh=mesh)
    march.begin(later.nodes, np.roll(march.stages(w.nodes, w.mesh, w.tail), -k, axis=0), mesh, w.tail)
    return later


def _multipliers(model: Model, equations: Equations, w: Unknowns, transitions: np.ndarray) -> Floquet:
    """The non-trivial multipliers, of the transitions one after another that are never multiplied out."""
    units = extents_of(model, w.nodes, w.period)
    matrices, places = merged(transitions * units / units[:, None])
    nodes = np.vstack([w.nodes, w.nodes[:1]])[places]
    directions = np.array([generated(model, x) for x in nodes])
    if not model.forced:
        directions = np.concatenate([_march(equations).rates(nodes, w.tail)[:, None], directions], axis=1)
    gradients = np.array([invariant_gradients(model)(x).full() for x in nodes])
    bases = complement(gradients * units, directions / units)
    factors = bases[1:].swapaxes(1, 2) @ matrices @ bases[:-1]
    return judged(product(factors).values if factors.size else np.zeros(0), symplectic(model))


def stiffness(equations: Equations, guess: Guess) -> float:
    """The fastest decay along a guess's trajectory, times its period."""
    assert guess.trajectory is not None
    times, states = guess.trajectory
    tail = equations.unknowns(states[:1], guess.period, np.zeros(2)).tail
    return float(_march(equations).decays(states, tail, times).max() * guess.period)


def _march(equations: Equations) -> Collocation:
    assert isinstance(equations.march, Collocation)
    return equations.march
