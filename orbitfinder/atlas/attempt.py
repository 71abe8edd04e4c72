"""From a start to a certified Orbit or to the reason why not: cheap solve, polish, minimal period, certificate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orbitfinder._runtime import __version__
from orbitfinder.atlas.signature import Numbers, Signature, among, resampled, signature_of
from orbitfinder.atlas.solver import Stalled, orbit_in_valley, polished, scaled_loop, solve
from orbitfinder.atlas.starts import Context, SearchStart, make_start, strategy_of
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.families.follow import follow
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.run import Run, first_point
from orbitfinder.families.start import begin
from orbitfinder.integrate.march import rounded, uniform
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.problem import Guess, Problem, segments_needed
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import certified, return_distances
from orbitfinder.orbits.measure import action, marched, whole_period
from orbitfinder.records.orbit import VERSION, Orbit, orbit_from_document

CONTINUATION = "continuation"
"""The strategy that starts from a known orbit of another energy and follows its family to this one."""
FAMILY = FamilySettings(points=40, first_step=0.1, longest_step=0.6, events=False, certify=False, longest_period=4.0)
"""A family is left when it takes longer than this to reach the energy, or slows down too much."""


@dataclass(frozen=True)
class Attempt:
    """How one start ended: with an orbit; with a signature alone, when it seemed to be known; or with a reason.

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
    """A converged loop before it is measured: w over the horizon, nodes and states of one period, its action."""

    problem: Problem
    w: Unknowns
    nodes: np.ndarray
    times: np.ndarray
    states: np.ndarray
    action: float

    @property
    def numbers(self) -> Numbers:
        """Energy, period and |action|, which images of a loop share."""
        return (self.problem.pin[0].value if self.problem.pin else 0.0), self.w.period, abs(self.action)

    @property
    def signature(self) -> Signature:
        """What it is recognised by."""
        angles = tuple(map(bool, self.problem.model.angular))
        return Signature(*self.numbers, resampled(self.times, self.states, len(angles)), angles)


def attempt(
    context: Context,
    seed: int,
    index: int,
    known: ArrayLike | None = None,
    source: Mapping[str, Any] | None = None,
) -> Attempt:
    """One start from its number to its orbit and certificate; with a `source` from the orbit of that document.

    Where an orbit with the same numbers (energy, period, |action|) is among the `known` (k x 3), only the
    signature is made: whoever asked is to judge whether it is that orbit.
    """
    try:
        start = make_start(context, seed, index) if source is None else continuation(context, index, source)
        return finished(context, seed, start, known)
    except (ConvergenceError, IntegrationError) as error:
        reason = str(error) if isinstance(error, ConvergenceError) else "integration failed"
        return Attempt(index, strategy_of(context, index) if source is None else CONTINUATION, reason=reason)


def continuation(context: Context, index: int, source: Mapping[str, Any]) -> SearchStart:
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


def finished(context: Context, seed: int, start: SearchStart, known: ArrayLike | None) -> Attempt:
    """The attempt that a start becomes; `ConvergenceError` or `IntegrationError` when it leads nowhere."""
    if context.section is not None:
        orbit = context.section.orbit(start.state, start.period, start.course)
        model = context.section.model_of(orbit)
        return judged(context, seed, start, signature_of(orbit, model), known, lambda: (orbit, model))
    loop = minimal(context, converged(context, start))
    return judged(context, seed, start, loop.signature, known, lambda: (measured(context, loop), context.model))


def judged(
    context: Context, seed: int, start: SearchStart, signature: Signature, known: ArrayLike | None,
    made: Callable[[], tuple[Orbit, Model]],
) -> Attempt:  # fmt: skip
    """The attempt with the signature of what was found, and unless that seems to be known its Orbit, certified."""
    if known is not None and among(known, signature.numbers):
        return Attempt(start.index, start.strategy, signature)
    orbit, model = made()
    name = f"e{context.target.energy:g}-s{seed}-n{start.index}".replace("+", "")  # unique, and good for a folder
    said = origin(seed, start) | {"invariants": [invariant.name for invariant in model.invariants]}
    orbit = certified(replace(orbit, provenance=said, name=name), model)
    if orbit.certificate is not None and not orbit.certificate.passed:
        failed = ", ".join(orbit.certificate.failures)
        return Attempt(start.index, start.strategy, reason=f"not certified: {failed}")
    return Attempt(start.index, start.strategy, signature, orbit)


def converged(context: Context, start: SearchStart) -> ClosedLoop:
    """The loop that a start leads to, over the period found."""
    guess = Guess(start.state, start.period)
    problem = Problem(context.model, guess, pin=context.pins, symmetry=start.symmetry)
    equations = context.equations[start.symmetry]
    w, end = begun(context, equations, start.state, start.period)
    if not problem.boundary.maps:
        problem = replace(problem, winding=turns(context, w.nodes, end))
    return solved(context, problem, w)


def begun(context: Context, equations: Equations, state: np.ndarray, period: float) -> tuple[Unknowns, np.ndarray]:
    """The unknowns of the motion from a state, in as many segments as it needs, and its end."""
    fraction = equations.symmetry.fraction

    def alone(count: int) -> Unknowns:
        mesh = uniform(fraction, count, rounded(period * fraction / count / context.step))
        return equations.unknowns(np.asarray(state, float)[None], period, mesh)

    how, clock = context.settings, period * fraction / np.pi
    count = segments_needed(equations, alone(1), clock, how.growth_per_segment, how.segments)
    w = alone(count)
    states = equations.march.states(w.nodes, w.mesh, w.tail)
    return replace(w, nodes=states[: -1 : w.steps // count]), states[-1]


def turns(context: Context, nodes: np.ndarray, end: np.ndarray) -> tuple[int, ...]:
    """Whole turns of each coordinate over the guess, to the nearest."""
    n = context.model.degrees_of_freedom
    whole = np.round((end - nodes[0])[:n] / (2 * np.pi))
    return tuple(int(k) for k in np.where(context.model.angular, whole, 0))


def solved(context: Context, problem: Problem, w: Unknowns) -> ClosedLoop:
    """The polished loop near w."""
    low, high = context.target.periods
    how = context.settings
    periods = low / how.period_margin, high * how.period_margin
    equations = context.equations[problem.symmetry]
    loop = scaled_loop(problem, equations, context.step, w, periods, context.units, context.clock)
    try:
        closed = polished(loop, *solve(loop, w))
    except Stalled as stall:
        closed = polished(loop, *orbit_in_valley(loop, stall.w))
    if context.clock * np.abs(closed.unfolding).max(initial=0.0) > how.largest_unfolding:
        raise ConvergenceError("unfolding does not vanish")
    closed = replace(closed, nodes=centred(context, problem, closed.nodes))
    march = context.equations[NONE.name].march
    nodes, times, states = whole_period(problem, context.flows[problem.symmetry], march, closed)
    if (np.ptp(states, axis=0) / context.units).max() < how.smallest:
        raise ConvergenceError("equilibrium")
    return ClosedLoop(problem, closed, nodes, times, states, action(context.model, times, states))


def measured(context: Context, loop: ClosedLoop) -> Orbit:
    """The Orbit of a loop, by the compiled march."""
    march = context.equations[NONE.name].march
    whole = loop.nodes, loop.times, loop.states
    return marched(loop.problem, march, loop.w, whole, loop.action, tuple(context.units))


def centred(context: Context, problem: Problem, nodes: np.ndarray) -> np.ndarray:
    """Nodes with the first one's angles in (-pi, pi], where whole turns may be taken off."""
    n = context.model.degrees_of_freedom
    if problem.boundary.forward is not None:
        return nodes
    whole = np.ceil((nodes[0, :n] - np.pi) / (2 * np.pi)) * context.model.angular
    return nodes - 2 * np.pi * np.concatenate([whole, np.zeros(nodes.shape[1] - n)])


def minimal(context: Context, loop: ClosedLoop) -> ClosedLoop:
    """The same loop over its minimal period; `ConvergenceError` when that is not in the range wanted."""
    low, high = context.target.periods
    if not low <= loop.w.period <= 2 * high:  # a multiple cover that is too long may have a period in range
        raise ConvergenceError("period outside the range")
    covers = [k for k in range(2, context.settings.largest_cover + 1) if not np.any(loop.problem.turns % k)]
    near: list[bool] = []
    if covers:
        states = loop.states / context.sizes
        near = [
            far < context.settings.cover for far in return_distances(loop.times, states, context.model.angular, covers)
        ]
    if any(near):
        loop = uncovered(context, loop, max(compress(covers, near)))
    if not low <= loop.w.period <= high:
        raise ConvergenceError("period outside the range")
    return loop


def uncovered(context: Context, loop: ClosedLoop, cover: int) -> ClosedLoop:
    """The loop solved again over a `cover`-th of its period."""
    period, state = loop.w.period / cover, loop.states[0]
    if period < context.target.periods[0]:
        raise ConvergenceError("period outside the range")
    winding = tuple(int(k) // cover for k in loop.problem.turns)
    problem = Problem(context.model, Guess(state, period), pin=context.pins, winding=winding)
    w, _ = begun(context, context.equations[NONE.name], state, period)
    return solved(context, problem, w)


def origin(seed: int, start: SearchStart) -> dict[str, Any]:
    """Provenance of an orbit found from a start: enough to find it again."""
    course = {"course": list(start.course)} if start.course else {}
    return {
        "orbitfinder": __version__,
        "orbit_format": VERSION,
        "numpy": np.__version__,
        "seed": seed,
        "index": start.index,
        "strategy": start.strategy,
        "symmetry_imposed": start.symmetry,
        "start": {"state": [float(x) for x in start.state], "period": start.period} | course,
    }
