"""The method of shooting: close the loop with IPOPT, polish, reduce the period, measure.

Before that a problem is looked at: do its invariants hold, how often do its angles turn.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from orbitfinder._runtime import interrupt
from orbitfinder._runtime.sizes import EPSILON
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError, IntegrationError, OrbitfinderError
from orbitfinder.integrate.cvodes import Flow, end_state, transition
from orbitfinder.integrate.dop853 import SECOND, integrate_in
from orbitfinder.integrate.equations import accelerations, invariant_gradients
from orbitfinder.integrate.field import vector_field
from orbitfinder.integrate.idas import build_dae_flow
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.ipopt import Callback, SolveSettings
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.polish import polish, segment, tail_of
from orbitfinder.loops.problem import (
    Guess,
    Problem,
    at_forcing_period,
    boundary_constants,
    clocked,
    guessed_nodes,
    segments_for,
    whole_turns,
    without_choice,
)
from orbitfinder.loops.shooting import Shooting, far_end, flow_of, transcribe, units_of
from orbitfinder.loops.symmetry import NONE, off_centre, symmetries_of, with_mirrors
from orbitfinder.mechanics.kind import system_kind, with_parameters
from orbitfinder.mechanics.model import Model, between
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.certify import certified
from orbitfinder.orbits.closure import gap
from orbitfinder.orbits.evidence import MOST
from orbitfinder.orbits.guesses.balance import balanced_guess
from orbitfinder.orbits.guesses.settled import cycles
from orbitfinder.orbits.hybrid import STEPS, first_unknowns
from orbitfinder.orbits.measure import dense, measure, provenance, shift_of
from orbitfinder.orbits.objectives import chosen
from orbitfinder.orbits.reduction import steady
from orbitfinder.orbits.refine import Refiner, uneven
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import Entries

DRIFT = 1e-7
"""An invariant that changes by more than this along the guess's motion, relative to its size, is none."""
KEPT = 1e-11
"""... unless its rate of change is this small a share of the terms that cancel in it."""
SECTION = 1e-3
"""Coordinates this near to where an odd motion starts are left to the solver."""


def check_invariants(problem: Problem) -> None:
    """`InputError` naming a declared invariant that drifts along the guess's motion, and its drift.

    The motion is integrated by DOP853 for the guess's period, from the guess pushed off any
    equilibrium; the drift is compared with 1e-7 of the invariant's size, or of its variation
    between neighbouring states.
    """
    model = problem.model
    if not model.invariants or model.constraint is not None or system_kind(model.system).described:
        return  # this library has derived them
    n, values = model.degrees_of_freedom, model.parameter_values
    field = vector_field(accelerations(model))
    units = np.asarray(units_of(problem) or np.ones(len(model.state_names)))
    start = np.asarray(problem.guess.state, float) + 0.01 * units * np.random.default_rng(0).normal(size=units.size)
    try:
        states = integrate_in(units, field, start, np.linspace(0.0, problem.guess.period, 9), SECOND)
    except IntegrationError:
        return  # the search itself will say where the motion cannot be integrated
    for one, kept in zip(model.invariants, _kept(model, states), strict=True):
        found = np.array([float(one.value(state[:n], state[n:], values)) for state in states])
        nearby = float(one.value(1.01 * start[:n], 1.01 * start[n:], values))
        drift, size = float(np.abs(found - found[0]).max()), max(abs(found[0]), abs(nearby - found[0]))
        if drift > DRIFT * size and not kept:  # past a singularity the integration drifts as well
            raise InputError(
                f"invariants: {one.name!r} is not conserved, it drifts by {drift:.3g} from {found[0]:.6g} within "
                f"{problem.guess.period:.4g} s along the guess's motion; leave it out of invariants=, or look for a "
                "force that changes it"
            )


def _kept(model: Model, states: np.ndarray) -> np.ndarray:
    """Which invariants the equations keep at states (k x 2n): dI/dt = grad I . x' is round-off of its terms."""
    gradients, rates = invariant_gradients(model), accelerations(model)
    terms = np.stack([gradients(state).full() * rates(0.0, state).full().ravel() for state in states])
    return np.asarray(np.all(np.abs(terms.sum(axis=2)) <= KEPT * np.abs(terms).sum(axis=2), axis=0))


def at_section(problem: Problem, flow: Flow) -> Problem:
    """The Problem with its guess moved along its motion to where its symmetry holds coordinates at the start.

    That is the instant at which every such angle is nearest to a multiple of pi and every other coordinate to 0.
    """
    guess, model, n = problem.guess, problem.model, problem.model.degrees_of_freedom
    if not np.any(problem.boundary.held(n)[:n]) or model.forced:
        return problem
    try:
        states = guess.states if guess.states is not None else segment(
            flow, np.asarray(guess.state, float), (0.0, guess.period), tail_of(flow)
        )  # fmt: skip
    except IntegrationError:
        return problem  # the search itself will say where
    clock = clocked(model, guess.period / (2 * np.pi))
    away = np.abs(off_centre(problem.boundary.maps[0], np.asarray(states, float) * clock, model.angles)).max(axis=1)
    best = int(away.argmin())
    if away[0] <= max(2 * away[best], SECTION) and guess.states is None:
        return problem
    return replace(problem, guess=Guess(np.asarray(states[best], float), guess.period))


def winding_of(problem: Problem, flow: Flow, nodes: np.ndarray) -> tuple[int, ...] | None:
    """Whole turns of each angle over the guess's motion, or None when it does not come near a whole number."""
    model, guess = problem.model, problem.guess
    n = model.degrees_of_freedom
    if not np.any(problem.boundary.may_turn(n)) or not any(model.angles):
        return None
    if problem.boundary.maps:
        constant = boundary_constants(problem, nodes, far_end(problem, nodes, flow))
        return tuple(int(k) for k in problem.boundary.turns(constant))
    if guess.states is not None:
        end = np.asarray(guess.states[-1], float)
    else:
        duration = guess.period / len(nodes)
        try:
            end = end_state(flow, nodes[-1], duration, guess.period - duration)
        except IntegrationError:
            return None
    turns = whole_turns(model, nodes[0], end, problem.boundary.relative)
    return None if turns is None else tuple(int(k) for k in turns)


NEAR_BOUND = 1e-6
"""A quantity this near to the end of its range, relative, is held there by it."""

DEPENDENT = 1e-6
"""Unfoldings whose forces along the orbit agree to this, relative, cannot be told apart."""


def found(problem: Problem, settings: SolveSettings, report: Callback | None, began: float) -> tuple[Orbit, Model]:
    """The orbit of a smooth system, by multiple shooting."""
    check_invariants(problem)
    problem = at_forcing_period(problem)
    if problem.model.constraint is None:
        flow = flow_of(problem, settings.integrator)
    else:
        unfolded = problem.boundary.unfolded(problem.model)
        flow = build_dae_flow(problem.model, problem.free, unfolded, settings.integrator)
    problem = at_section(problem, flow)
    if _square(problem) and uneven(problem, flow):
        return _unevenly(problem, flow, settings, report, began)
    said: Entries = {}
    try:
        refined, w = _shot(problem, flow, settings, report)
    except (ConvergenceError, IntegrationError) as error:
        refined, w = _shot_again(problem, flow, settings, report, error)
        settles, balances = "a simulation that settles", "harmonic balance along the family of the guess's linear mode"
        said = {"start": settles if problem.model.forced else balances}
    unknowns = refined.at(w)
    unfolding = acting(refined.flow, unknowns.nodes, unknowns.unfolding)
    orbit = measure(refined.problem, refined.flow, unknowns.nodes, unknowns.period, unfolding)
    _within(problem, orbit)
    _periodic(problem, orbit)
    said |= provenance(problem, settings, began) | _choice(problem, refined.problem.model)
    if flow.units:
        said["scales"] = dict(zip(problem.model.state_names, flow.units, strict=True))
    return replace(orbit, provenance=said), refined.problem.model


def _square(problem: Problem) -> bool:
    """Whether Newton's method may take a problem, once it has its place in the family."""
    chosen = problem.constraints or problem.phase_condition or problem.bounds or problem.objective != "nearest"
    plain = problem.model.constraint is None and not (chosen or problem.guess.free)
    return plain and not (problem.free and problem.count().freedom)


def _unevenly(
    problem: Problem, flow: Flow, settings: SolveSettings, report: Callback | None, began: float
) -> tuple[Orbit, Model]:
    """An orbit past close encounters or along bursts, by Newton's method on a mesh that fits its motion.

    It starts from the guess, at the guess's own energy, over half a period first where a mirror leaves the guess as it
    is; where that fails, from where IPOPT ends.
    """
    pins = problem.pin if not problem.count().freedom else natural_pin(problem, problem.guess.start)
    square, tried, blind = replace(problem, pin=pins), list[str](), True
    for name in [*_mirrors(problem), problem.symmetry]:
        said = f"Newton's method on a mesh that fits the guess's motion, symmetry {name}"
        try:
            orbit, model = _refined(replace(square, symmetry=name))
            break
        except UNSOLVED as error:
            tried.append(f"{said}: {error}")
            blind &= isinstance(error, IntegrationError)  # nothing can be said of a motion but where it ends
    else:
        said = "; ".join(["IPOPT, and Newton's method from there", *tried])
        try:
            nodes = initial_nodes(problem, flow, settings)
            if problem.winding is None:
                problem = replace(problem, winding=winding_of(problem, flow, nodes))
            shooting, w = chosen(problem, nodes, flow, settings, report)
        except UNSOLVED as error:
            if blind and isinstance(error, IntegrationError):
                raise
            raise ConvergenceError("; ".join([*tried, f"IPOPT: {error}"])) from error
        near = shooting.at(w)
        along = Guess(near.nodes[0], near.period, near.period * near.edges, np.vstack([near.nodes, near.nodes[:1]]))
        orbit, model = _refined(replace(_settled(shooting.problem, near), guess=along, segments=None))
    _within(problem, orbit)
    _periodic(problem, orbit)
    told = provenance(problem, settings, began) | _choice(problem, model) | {"start": said}
    return replace(orbit, provenance=told), model


def _mirrors(problem: Problem) -> list[str]:
    """Names of the symmetries that run time backwards and leave the guess's state as it is, where none is asked for."""
    model, state = problem.model, problem.guess.start
    if problem.symmetry != NONE.name or model.forced or problem.relative:
        return []
    n, known = model.degrees_of_freedom, symmetries_of(with_mirrors(model)).items()
    backward = {
        name: symmetry.maps[0].matrix(n) for name, symmetry in known if symmetry.reverses and len(symmetry.maps) == 1
    }
    small = EPSILON * np.abs(state).max()
    return [name for name, matrix in backward.items() if np.abs(matrix @ state - state).max() <= small]


def _refined(problem: Problem) -> tuple[Orbit, Model]:
    refiner = Refiner(problem)
    return refiner.measured(refiner.refine())


CLOSELY = {"closure", "distance", "second_closure", "trivial_multipliers", "floquet_multipliers", "pair_defect"}
"""What a certificate refuses of an orbit that has not been closed well enough, or whose multipliers have not"""


def closer(problem: Problem, orbit: Orbit, model: Model) -> Orbit:
    """A refused orbit closed and measured again, in long double where that can be had, if that is certified."""
    assert orbit.certificate is not None
    alone = model.smooth and model.constraint is None and len(model.state_names) <= MOST
    if not alone or not set(orbit.certificate.failures) <= CLOSELY or not _square(problem):
        return orbit
    guess = Guess(orbit.state, orbit.period)
    pins = problem.pin if not problem.count().freedom else natural_pin(problem, orbit.state)
    with suppress(*UNSOLVED):
        again, model = Refiner(replace(problem, guess=guess, pin=pins, winding=orbit.winding)).closely()
        again = certified(replace(again, provenance=orbit.provenance), model)
        if again.certificate and again.certificate.passed:
            return again
    return orbit


def found_hybrid(
    problem: Problem, settings: SolveSettings, report: Callback | None, began: float
) -> tuple[Orbit, Model]:
    """The orbit of a hybrid system, by Newton's method from its guess; what there is to choose IPOPT has chosen."""
    settled = problem
    if problem.count().freedom or problem.bounds or problem.constraints or problem.objective != "nearest":
        equations = Equations(problem.model, problem.boundary, problem.free)
        first = first_unknowns(equations, problem.guess, problem.segments or 1, STEPS)
        shooting, w = chosen(problem, first, flow_of(problem, settings.integrator), settings, report)
        settled = replace(_settled(problem, shooting.at(w)), segments=problem.segments)
    orbit, model = _refined(settled)
    _within(problem, orbit)
    return replace(orbit, provenance=provenance(problem, settings, began) | _choice(problem, model)), model


def acting(flow: Flow, nodes: np.ndarray, unfolding: np.ndarray) -> np.ndarray:
    """The smallest s with the same fictitious forces sum_k s_k u_k(q, v) at all nodes.

    On a relative equilibrium (a conical pendulum) the velocity is the direction of a symmetry, so that the energy's
    unfolding and the momentum's are one, and Newton's method leaves any amount of one against the other.
    """
    n, p = flow.model.degrees_of_freedom, flow.model.parameter_values
    if len(unfolding) < 2:
        return unfolding
    columns = [[one.unfolding(x[:n], x[n:], p).full().ravel() for x in nodes] for one in flow.unfolded]
    forces = np.asarray(columns).reshape(len(unfolding), -1).T
    sizes = np.linalg.norm(forces, axis=0)
    sizes[sizes == 0] = 1.0
    scaled = forces / sizes
    return np.asarray(np.linalg.pinv(scaled, rcond=DEPENDENT) @ (scaled @ (sizes * unfolding)) / sizes)


def _shot(
    problem: Problem, flow: Flow, settings: SolveSettings, report: Callback | None
) -> tuple[Shooting, np.ndarray]:
    """The polished loop over its minimal period."""
    nodes = initial_nodes(problem, flow, settings)
    if problem.winding is None:
        problem = replace(problem, winding=winding_of(problem, flow, nodes))
    return _minimal(*_polished(*chosen(problem, nodes, flow, settings, report)), settings)


def _shot_again(
    problem: Problem, flow: Flow, settings: SolveSettings, report: Callback | None, error: OrbitfinderError
) -> tuple[Shooting, np.ndarray]:
    """The same from a better guess, where there is one; raises the first error where there is none."""
    interrupt.check()  # CasADi makes a failed search of Ctrl-C
    try:
        model, near = problem.model, problem.guess
        settles = model.forced and model.constraint is None and near.trajectory is None
        guess = next(cycles(model, near, near, stiff=True), None) if settles else balanced_guess(problem)
        if guess is None:
            raise error
        return _shot(replace(problem, guess=guess), flow, settings, report)
    except (ConvergenceError, IntegrationError):
        raise error from None


def _within(problem: Problem, orbit: Orbit) -> None:
    """`ConvergenceError` when the minimal period is no longer in the range asked for."""
    low, high = problem.bounds.get("period", (0.0, np.inf))
    if not low * (1 - NEAR_BOUND) <= orbit.period <= high * (1 + NEAR_BOUND):
        raise ConvergenceError(
            f"no orbit found: the search went round an orbit of period {orbit.period:.6g} s several times, which is "
            f"outside bounds.period [{low:g}, {high:g}]; start nearer to an orbit of that period"
        )


def _periodic(problem: Problem, orbit: Orbit) -> None:
    """`ConvergenceError` for a relative equilibrium, which comes back up to a shift after any time at all."""
    rates = steady(problem.model, orbit.state, orbit.period) if problem.relative and not problem.free else {}
    if rates:
        moving = ", ".join(f"{name} = {rate:.9g}" for name, rate in rates.items())
        raise ConvergenceError(
            f"no orbit found: the search fell on a relative equilibrium, whose steady rates are {moving} a second, so "
            "that it has no period of its own; start farther from it, or leave relative out and give its winding"
        )


def _choice(problem: Problem, model: Model) -> Entries:
    """What was left to choose and what came of it, for the provenance."""
    found = {name: float(model.parameter_values[model.parameter_index(name)]) for name in problem.free}
    said: Entries = {"free": found} if found else {}
    if problem.objective != "nearest":
        said["objective"] = problem.objective if isinstance(problem.objective, str) else "callable"
    if problem.bounds:
        said["bounds"] = {name: [float(end) for end in ends] for name, ends in problem.bounds.items()}
    return said


def initial_nodes(problem: Problem, flow: Flow, settings: SolveSettings) -> np.ndarray:
    """Node states (N x 2n) of the guess: sampled from its trajectory, else simulated from its state."""
    guess, horizon, count = problem.guess, problem.boundary.fraction * problem.guess.period, problem.segments
    nodes = [np.asarray(guess.state, float)]
    if not count:  # as many as keep each state-transition matrix below `growth_per_segment`
        fewest = int(np.ceil(settings.fewest_segments * problem.boundary.fraction))
        units = clocked(problem.model, guess.period / (2 * np.pi), nodes[0])
        matrix = transition(flow, nodes[0], horizon)[1]
        count = segments_for(matrix, units, settings.growth_per_segment, (fewest, settings.most_segments))
    if guess.times is not None and guess.states is not None:
        return guessed_nodes(guess, np.arange(count) * problem.boundary.fraction / count)
    for k in range(1, count):
        try:
            nodes.append(end_state(flow, nodes[-1], horizon / count, (k - 1) * horizon / count))
        except IntegrationError as error:
            raise IntegrationError(error.reason, segment=k - 1, time=error.time, state=nodes[-1]) from None
    return np.asarray(nodes)


def _polished(shooting: Shooting, w: np.ndarray) -> tuple[Shooting, np.ndarray]:
    """Newton on the high-order residual; freed parameters are then written into the model.

    A problem with an objective is first made square by holding its place in the family.
    """
    problem, square = shooting.problem, shooting.square
    if square:
        w = polish(shooting, w)
    if square and not problem.free and not problem.constraints:
        return shooting, w
    found = shooting.at(w)
    held = transcribe(_settled(problem, found), found.nodes, None if problem.free else shooting.flow)
    return held, polish(held, held.vector(replace(held.guess, unfolding=found.unfolding)))


def _settled(problem: Problem, found: Unknowns) -> Problem:
    """The Problem at what was chosen: freed parameters are its model's, and pins hold its place in the family."""
    nodes, period = found.nodes, found.period
    values = {name: _snapped(problem, name, float(one)) for name, one in zip(problem.free, found.free, strict=False)}
    model = with_parameters(problem.model, values)
    settled = without_choice(replace(problem, model=model, guess=Guess(nodes[0], period), segments=len(nodes)))
    if model.invariants:
        natural = natural_pin(settled, nodes[0])
        kept = tuple(one for one in problem.pin if one.name not in problem.free)
        given = kept[: len(natural)] if len(kept) >= len(natural) else ()
        settled = replace(settled, pin=given or _held(problem, natural, period))
    return settled


def _snapped(problem: Problem, name: str, value: float) -> float:
    """A value, or the end of its range that an inequality holds it at."""
    ends = problem.bounds.get(name, ())
    for end in ends:
        if abs(value - end) <= NEAR_BOUND * max(np.ptp(np.asarray(ends)[np.isfinite(ends)]), abs(end)):
            return float(end)
    return value


def _held(problem: Problem, natural: tuple[Pin, ...], period: float) -> tuple[Pin, ...]:
    """The pin at which an orbit is polished: the range's end where one holds it, else its own energy."""
    held = _snapped(problem, "period", period)
    if held in problem.bounds.get("period", ()):
        return (Pin("period", held), *natural[1:])
    return tuple(Pin(one.name, _snapped(problem, one.name, one.value)) for one in natural)


def natural_pin(problem: Problem, state: np.ndarray) -> tuple[Pin, ...]:
    """The pins that hold an orbit where it is in its family: its energy, the momenta of what it is relative in, and of
    general first-order systems every invariant that no symmetry belongs to; nothing where none is conserved.
    """
    n = problem.model.degrees_of_freedom
    values, kept = problem.model.parameter_values, {one.momentum for one in problem.shifts}
    alone = [one for one in problem.model.invariants if one.generator is None] or problem.model.invariants[:1]
    held = [one for one in problem.model.invariants if one in alone or one.name in kept]
    return tuple(Pin(one.name, float(one.value(state[:n], state[n:], values))) for one in held)


def _minimal(shooting: Shooting, w: np.ndarray, settings: SolveSettings) -> tuple[Shooting, np.ndarray]:
    """The same orbit over its minimal period, when the solver went round it several times."""
    problem, found = shooting.problem, shooting.at(w)
    if problem.boundary.maps:
        return shooting, w
    cover = cover_of(shooting, w)
    if cover == 1:
        return shooting, w
    period, state = found.period / cover, found.nodes[0]
    count = max(1, len(found.nodes) // cover)
    turns = tuple(int(k) for k in problem.turns // cover)
    pins = natural_pin(problem, state)
    shorter = replace(problem, guess=Guess(state, period), pin=pins, segments=count, winding=turns)
    shot = transcribe(shorter, initial_nodes(shorter, shooting.flow, settings), shooting.flow)
    return shot, polish(shot, shot.start)


def cover_of(shooting: Shooting, w: np.ndarray, most: int = 30, tolerance: float = 1e-5) -> int:
    """The largest k <= `most` for which x(T/k) = x(0), the winding divided by k."""
    problem, period = shooting.problem, shooting.at(w).period
    times, states = dense(shooting.flow, shooting.at(w).nodes, period)
    n = problem.model.degrees_of_freedom
    units = extents_of(problem.model, states, period)
    covers = [k for k in range(most, 1, -1) if not (np.any(problem.turns % k) or problem.forcing_cycles % k)]
    shift = shift_of(problem, states[0], states[-1])[1]
    for cover, reached in zip(covers, between(times, states, n, period / np.array(covers, float)), strict=True):
        if gap(states[0], reached, shift / cover, units) < tolerance:
            return cover
    return 1
