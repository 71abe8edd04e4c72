"""From a start to a certified Orbit or to the reason why not: cheap solve, polish, minimal period, certificate."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from orbitfinder._runtime import __version__
from orbitfinder.atlas.abreast import Course, Marched, abreast, alone, done
from orbitfinder.atlas.signature import LOOP_SAMPLES, Numbers, Signature, among, resampled, signature_of
from orbitfinder.atlas.solver import Closing, Stalled, orbit_in_valley, polished, scaled_loop
from orbitfinder.atlas.starts import Context, SearchStart, proposed, strategy_of
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.families.follow import follow
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.run import Run, first_point
from orbitfinder.families.start import begin
from orbitfinder.integrate.march import rounded, uniform
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.problem import Guess, Problem, clocked, elsewhere, segments_for
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import certified, return_distances
from orbitfinder.orbits.measure import around, composed, sampled_action, sampled_period, whole_unknowns
from orbitfinder.records.orbit import VERSION, Orbit, orbit_from_document
from orbitfinder.records.reading import Entries, Table

Found = tuple[SearchStart, Signature, Callable[[], Course[tuple[Orbit, Model]]]]
"""A start, what the motion that it led to is recognised by, and what makes an Orbit of that"""
CONTINUATION = "continuation"
"""The strategy that starts from a known orbit of another energy and follows its family to this one."""
FAMILY = FamilySettings(points=40, first_step=0.1, longest_step=0.6, events=False, certify=False, longest_period=4.0)
"""A family is left when it takes longer than this to reach the energy, or slows down too much."""


@dataclass(frozen=True)
class Job:
    """One start to be made: its number, whether known orbits count as suspects, an orbit to continue from."""

    number: int
    certain: bool = False
    source: Table | None = None
    tries: int = field(default=1, compare=False)


@dataclass(frozen=True)
class Attempt:
    """How a start ended: with an orbit; with a signature alone, when it seemed to be known; or with a reason.

    `seconds` is processor time.
    """

    index: int
    strategy: str
    signature: Signature | None = None
    orbit: Orbit | None = None
    reason: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class ClosedLoop:
    """A converged loop before it is measured: w over the horizon, nodes and mesh of a period, its action, times and
    states."""

    context: Context
    problem: Problem
    w: Unknowns
    nodes: np.ndarray
    mesh: np.ndarray
    action: float
    times: np.ndarray
    states: np.ndarray

    @property
    def numbers(self) -> Numbers:
        """Energy, period and |action|, which images of a loop share."""
        return (self.problem.pin[0].value if self.problem.pin else 0.0), self.w.period, abs(self.action)

    @property
    def signature(self) -> Signature:
        """What it is recognised by."""
        angles = tuple(map(bool, self.problem.model.angular))
        return Signature(*self.numbers, resampled(self.times, self.states, len(angles)), angles)


def attempts(context: Context, seed: int, jobs: Sequence[Job], known: ArrayLike) -> list[Attempt]:
    """Starts from their numbers to their orbits and certificates, side by side; what each leads to does not depend on
    the others.

    Where an orbit with the same numbers (energy, period, |action|) is among the `known` (k x 3), only the signature is
    made, but for a job that is `certain`: whoever asked is to judge whether it is that orbit. Those that seem to have
    led to the same orbit are certified once.
    """
    began, made, numbers = time.process_time(), list[Attempt](), list(np.reshape(known, (-1, 3)))
    courses = abreast([course(context, seed, job) for job in jobs])
    seen, wanted = list(numbers), dict[int, Course[tuple[Orbit, Model]]]()  # that nobody seems to know yet
    for k, (job, outcome) in enumerate(zip(jobs, courses, strict=True)):
        if not isinstance(outcome, Exception) and (job.certain or not among(seen, outcome[1].numbers)):
            wanted[k] = outcome[2]()
            seen.append(np.array(outcome[1].numbers))
    orbits = dict(zip(wanted, abreast(list(wanted.values())), strict=True))
    shared = (time.process_time() - began) / max(1, len(jobs))
    for k, (job, outcome) in enumerate(zip(jobs, courses, strict=True)):
        began = time.process_time()
        name = strategy_of(context, job.number) if job.source is None else CONTINUATION
        try:
            if isinstance(outcome, Exception):
                raise outcome
            trial = judged(context, seed, outcome, None if job.certain else numbers, orbits.get(k))
        except IntegrationError:
            trial = Attempt(job.number, name, reason="integration failed")
        except ConvergenceError as error:
            trial = Attempt(job.number, name, reason=str(error))
        except (RuntimeError, ValueError, ArithmeticError) as error:
            trial = Attempt(job.number, name, reason=f"error: {type(error).__name__}")
        if trial.orbit is not None and trial.signature is not None:
            numbers.append(np.array(trial.signature.numbers))
        made.append(replace(trial, seconds=shared + time.process_time() - began))
    return made


def continuation(context: Context, index: int, source: Table) -> SearchStart:
    """The start at the first orbit of the source's family that has the energy wanted.

    `ConvergenceError` when the family ends before.
    """
    try:
        start = begin(orbit_from_document(source), FAMILY)
    except InputError as error:
        raise ConvergenceError("family cannot be followed") from error
    origin = first_point(start, FAMILY, None)
    towards = 1 if context.target.energy > origin.value else -1
    for batch in follow(Run(start.curve, FAMILY, towards, origin, until=context.target.energy)):
        for point in batch.points:
            if point.role == "end":
                return SearchStart(index, CONTINUATION, NONE.name, point.state, point.period)
    raise ConvergenceError("family ends before the energy")


def course(context: Context, seed: int, job: Job) -> Course[Found]:
    """What a start leads to; `ConvergenceError` or `IntegrationError` when that is nowhere."""
    if job.source is None:
        start = yield from proposed(context, seed, job.number)
    else:
        start = continuation(context, job.number, job.source)
    if context.controlled is not None and start.problem is not None:
        steered = context.controlled.orbit(start.problem)
        return start, signature_of(*steered), lambda: done(steered)
    if context.section is not None:
        orbit = context.section.orbit(start.state, start.period, start.course)
        model = context.section.model_of(orbit)
        return start, signature_of(orbit, model), lambda: done((orbit, model))
    loop = yield from minimal(context, (yield from converged(context, start)))
    return start, loop.signature, lambda: measured(context, loop)


def judged(
    context: Context, seed: int, outcome: Found, known: ArrayLike | None,
    made: tuple[Orbit, Model] | Exception | None = None,
) -> Attempt:  # fmt: skip
    """The attempt with the signature of what a start led to, and unless that seems to be known its Orbit, certified;
    `made` is that Orbit with its Model where it has been measured."""
    start, signature, make = outcome
    if known is not None and among(known, signature.numbers):
        return Attempt(start.index, start.strategy, signature)
    if isinstance(made, Exception):
        raise made
    orbit, model = made or alone(make())
    name = f"e{context.target.energy:g}-s{seed}-n{start.index}".replace("+", "")  # unique, and good for a folder
    said = origin(seed, start) | {"invariants": [invariant.name for invariant in model.invariants]}
    said = {**orbit.provenance, **said} if orbit.control else said
    orbit = certified(replace(orbit, provenance=said, name=name), model)
    if orbit.certificate is not None and not orbit.certificate.passed:
        failed = ", ".join(orbit.certificate.failures)
        return Attempt(start.index, start.strategy, signature, reason=f"not certified: {failed}")
    return Attempt(start.index, start.strategy, signature, orbit)


def converged(context: Context, start: SearchStart) -> Course[ClosedLoop]:
    """The loop that a start leads to, over its period."""
    equations = context.equations[start.symmetry]
    w, end = yield from begun(context, equations, start.state, start.period)
    winding = None if equations.symmetry.maps else turns(context, w.nodes, end)
    problem = elsewhere(context.problems[start.symmetry], Guess(start.state, start.period), winding)
    return (yield from solved(context, problem, w))


def begun(
    context: Context, equations: Equations, state: np.ndarray, period: float
) -> Course[tuple[Unknowns, np.ndarray]]:
    """The unknowns of the motion from a state, in as many segments as it needs, and its end."""
    fraction = equations.symmetry.fraction

    def whole(count: int) -> Unknowns:
        mesh = uniform(fraction, count, rounded(period * fraction / count / context.step))
        return equations.unknowns(np.asarray(state, float)[None], period, mesh)

    how, w = context.settings, whole(1)
    (grown,) = yield Marched(equations, w, "transitions")
    units = clocked(context.model, period * fraction / np.pi, w.nodes[0])
    count = segments_for(grown, units, how.growth_per_segment, how.segments)
    w = whole(count)
    states = yield Marched(equations, w, "states")
    return replace(w, nodes=states[: -1 : w.steps // count]), states[-1]


def turns(context: Context, nodes: np.ndarray, end: np.ndarray) -> tuple[int, ...]:
    """Whole turns of each coordinate over the guess, to the nearest."""
    n = context.model.degrees_of_freedom
    whole = np.round((end - nodes[0])[:n] / (2 * np.pi))
    return tuple(map(int, np.where(context.model.angular, whole, 0)))


def solved(context: Context, problem: Problem, w: Unknowns) -> Course[ClosedLoop]:
    """The polished loop near w."""
    low, high = context.target.periods
    how = context.settings
    periods = low / how.period_margin, high * how.period_margin
    equations = context.equations[problem.symmetry]
    loop = scaled_loop(problem, equations, context.step, w, periods, context.units, context.clock)
    try:
        closed = yield from polished(loop, *(yield Closing(loop, w)))
    except Stalled as stall:
        closed = yield from polished(loop, *(yield from orbit_in_valley(loop, stall.w)))
    if context.clock * np.abs(closed.unfolding).max(initial=0.0) > how.largest_unfolding:
        raise ConvergenceError("unfolding does not vanish")
    closed = replace(closed, nodes=centred(context, problem, closed.nodes))
    plain = context.equations[NONE.name]
    nodes = closed.nodes
    if problem.boundary.maps:
        ends = yield Marched(context.equations[problem.symmetry], closed)
        nodes = around(problem, nodes, ends[-1])
    whole = whole_unknowns(plain.march, closed, nodes)
    nodes, times, states = sampled_period(problem, whole, (yield Marched(plain, whole, "states")))
    if (np.ptp(states, axis=0) / context.units).max() < how.smallest:
        raise ConvergenceError("equilibrium")
    every, longest = 1, min(closed.period / LOOP_SAMPLES, context.step / (2 * loop.settings.finer))
    while (times.size - 1) % (4 * every) == 0 and 2 * every * times[1] <= longest:
        every *= 2  # the mesh is as fine as closing asks for, which nobody else needs
    sampled = sampled_action(context.model, times, states, plain.march.arcs[0], every)
    return ClosedLoop(context, problem, closed, nodes, whole.mesh, *sampled)


def measured(context: Context, loop: ClosedLoop) -> Course[tuple[Orbit, Model]]:
    """The Orbit of a loop, by the compiled march, and its Model."""
    plain, whole = context.equations[NONE.name], (loop.nodes, loop.times, loop.states)
    unfolding = np.zeros(plain.march.unfolding)
    w = Unknowns(loop.nodes, loop.w.period, unfolding, loop.w.free, loop.mesh)
    transitions = yield Marched(plain, w, "transitions")
    (end,) = yield Marched(plain, replace(w, nodes=w.nodes[:1]))
    units = tuple(context.units)
    return composed(loop.problem, loop.w, whole, loop.action, transitions, end, units), context.model


def centred(context: Context, problem: Problem, nodes: np.ndarray) -> np.ndarray:
    """Nodes with the first one's angles in (-pi, pi], where whole turns may be taken off."""
    n = context.model.degrees_of_freedom
    if problem.boundary.forward is not None:
        return nodes
    whole = np.ceil((nodes[0, :n] - np.pi) / (2 * np.pi)) * context.model.angular
    return nodes - 2 * np.pi * np.concatenate([whole, np.zeros(nodes.shape[1] - n)])


def minimal(context: Context, loop: ClosedLoop) -> Course[ClosedLoop]:
    """The same loop over its minimal period; `ConvergenceError` when that is not in the range wanted."""
    low, high = context.target.periods
    if not low <= loop.w.period <= 2 * high:  # a multiple cover that is too long may have a period in range
        raise ConvergenceError("period outside the range")
    whole = np.append(loop.problem.turns, loop.problem.forcing_cycles)
    covers = np.arange(2, context.settings.largest_cover + 1)
    covers = covers[~np.any(whole % covers[:, None], axis=1)]
    near = []
    if len(covers):
        states = loop.states / context.sizes
        near = [
            far < context.settings.cover for far in return_distances(loop.times, states, context.model.angular, covers)
        ]
    if any(near):
        loop = yield from uncovered(context, loop, int(covers[near].max()))
    if not low <= loop.w.period <= high:
        raise ConvergenceError("period outside the range")
    return loop


def uncovered(context: Context, loop: ClosedLoop, cover: int) -> Course[ClosedLoop]:
    """The loop solved again over a `cover`-th of its period."""
    period, state = loop.w.period / cover, loop.states[0]
    if period < context.target.periods[0]:
        raise ConvergenceError("period outside the range")
    winding = tuple(int(k) // cover for k in loop.problem.turns)
    problem = elsewhere(context.problems[NONE.name], Guess(state, period), winding)
    w, _ = yield from begun(context, context.equations[NONE.name], state, period)
    return (yield from solved(context, problem, w))


def origin(seed: int, start: SearchStart) -> Entries:
    """Provenance of an orbit that a start led to: enough to come to it again."""
    course = {"course": list(start.course)} if start.course else {}
    return {
        "orbitfinder": __version__,
        "orbit_format": VERSION,
        "numpy": np.__version__,
        "seed": seed,
        "index": start.index,
        "strategy": start.strategy,
        "symmetry_imposed": start.symmetry,
        "start": {"state": start.state.tolist(), "period": start.period} | course,
    }
