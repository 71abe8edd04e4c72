"""From a start to a certified Orbit or to the reason why not: cheap solve, polish, minimal period, certificate."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np

from orbitfinder.atlas.signature import Signature, resampled
from orbitfinder.atlas.solver import QuickSettings, Stalled, polished, scaled, shot, solve
from orbitfinder.atlas.starts import Bench, Start, make_start, strategy_of
from orbitfinder.atlas.valley import orbit_in_valley
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import rounded, uniform
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.problem import Guess, Problem, segments_needed
from orbitfinder.orbits.certify import certified, return_distances
from orbitfinder.orbits.floquet import analyse, reduce_monodromy
from orbitfinder.orbits.measure import action, frame, full_period, recorded
from orbitfinder.records.orbit import Orbit

Numbers = tuple[float, float, float]
LARGEST_COVER = 30
LARGEST_UNFOLDING = 1e-8
SAMPLES = 256
"""Steps over a period at least, for the loop, its action and its minimal period."""
COVER = 1e-5
"""A return at T/k nearer than this, relative to the motion's extent, means that the loop was run k times."""
PERIOD_MARGIN = 1.15
"""The cheap stage lets the period leave the range by this factor before it holds it."""
SMALLEST = 1e-3
"""Motions of less than this extent (rad or m) are equilibria."""


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
class Found:
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
        return self.problem.pin[0].value, self.w.period, abs(self.action)


def attempt(
    one: Bench,
    seed: int,
    index: int,
    known: Callable[[Numbers], bool] | None = None,
    settings: QuickSettings | None = None,
) -> Attempt:
    """One start from its number to its orbit and certificate.

    Where `known` says that an orbit with these numbers (energy, period, |action|) is there already, only
    the signature is made: whoever asked is to judge whether it is that orbit.
    """
    settings, name = settings or QuickSettings(), strategy_of(one, index)
    with reasons(index, name) as ended:
        start = make_start(one, seed, index)
        ended.append(finished(one, seed, start, known, settings))
    return ended[-1]


@contextlib.contextmanager
def reasons(index: int, name: str) -> Iterator[list[Attempt]]:
    """A list of attempts; what is raised in the block on purpose becomes the last of them."""
    ended: list[Attempt] = []
    try:
        yield ended
    except ConvergenceError as error:
        ended.append(Attempt(index, name, reason=str(error)))
    except IntegrationError:
        ended.append(Attempt(index, name, reason="integration failed"))


def finished(
    one: Bench, seed: int, start: Start, known: Callable[[Numbers], bool] | None, settings: QuickSettings
) -> Attempt:
    """The attempt that a start becomes; raises what `reasons` catches."""
    loop = minimal(one, converged(one, start, settings), settings)
    signature = loop_signature(one, loop)
    if known is not None and known(loop.numbers):
        return Attempt(start.index, start.strategy, signature)
    orbit = replace(measured(one, loop), provenance=origin(seed, start), name=name_of(one, seed, start))
    orbit = certified(orbit, one.model)
    if orbit.certificate is not None and not orbit.certificate.passed:
        failed = ", ".join(orbit.certificate.failures)
        return Attempt(start.index, start.strategy, reason=f"not certified: {failed}")
    return Attempt(start.index, start.strategy, signature, orbit)


def name_of(one: Bench, seed: int, start: Start) -> str:
    """A name that is unique in an atlas, and good for a folder: energy, seed, number of the start."""
    return f"e{one.target.energy:g}-s{seed}-n{start.index}".replace("+", "")


def loop_signature(one: Bench, loop: Found) -> Signature:
    """The signature of a loop that is not measured yet."""
    energy, period, action = loop.numbers
    angles = tuple(map(bool, one.model.angular))
    return Signature(energy, period, action, resampled(loop.times, loop.states), angles)


def converged(one: Bench, start: Start, settings: QuickSettings) -> Found:
    """The loop that a start leads to, over the period found."""
    guess = Guess(start.state, start.period)
    problem = Problem(one.model, guess, pin=pin(energy=one.target.energy), symmetry=start.symmetry)
    equations = one.equations[start.symmetry]
    w, end = begun(one, equations, start.state, start.period, settings)
    if not problem.boundary.maps:
        problem = replace(problem, winding=turns(one, w.nodes, end))
    return solved(one, problem, w, settings)


def begun(
    one: Bench, equations: Equations, state: np.ndarray, period: float, settings: QuickSettings
) -> tuple[Unknowns, np.ndarray]:
    """The unknowns of the motion from a state, in as many segments as it needs, and its end."""
    horizon, between = period * equations.symmetry.fraction, (settings.fewest_segments, settings.most_segments)
    mesh = uniform(equations.symmetry.fraction, 1, rounded(horizon / one.step))
    alone = equations.unknowns(np.asarray(state, float)[None], period, mesh)
    count = segments_needed(equations, alone, horizon / np.pi, settings.growth_per_segment, between)
    return shot(equations, one.step, state, period, count)


def turns(one: Bench, nodes: np.ndarray, end: np.ndarray) -> tuple[int, ...]:
    """Whole turns of each coordinate over the guess, to the nearest."""
    n = one.model.degrees_of_freedom
    whole = np.round((end - nodes[0])[:n] / (2 * np.pi))
    return tuple(int(k) for k in np.where(one.model.angular, whole, 0))


def solved(one: Bench, problem: Problem, w: Unknowns, settings: QuickSettings) -> Found:
    """The polished loop near w."""
    low, high = one.target.periods
    periods = low / PERIOD_MARGIN, high * PERIOD_MARGIN
    loop = scaled(problem, one.equations[problem.symmetry], one.step, w, periods)
    try:
        found = polished(loop, *solve(loop, w, settings), settings)
    except Stalled as stall:
        found = polished(loop, *orbit_in_valley(loop, stall.w, settings), settings)
    if np.abs(found.unfolding).max(initial=0.0) > LARGEST_UNFOLDING:
        raise ConvergenceError("unfolding does not vanish")
    found = replace(found, nodes=centred(one, problem, found.nodes))
    nodes, times, states = whole_period(one, problem, found)
    if np.ptp(states, axis=0).max() < SMALLEST:
        raise ConvergenceError("equilibrium")
    return Found(problem, found, nodes, times, states, action(one.model, times, states))


def whole_period(one: Bench, problem: Problem, w: Unknowns) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of one period from those of a part of it; equal times over it and the states there, to round-off."""
    nodes = full_period(problem, one.flows[problem.symmetry], w.nodes, w.period)
    march, steps = one.equations["none"].march, max(w.steps, rounded(SAMPLES / len(nodes)))
    tail = np.append(w.period, np.zeros(march.unfolding))
    states = march.states(nodes, uniform(1.0, len(nodes), steps), tail)
    states[::steps] = [*nodes, states[-1]]  # the node, not the end of the segment before it
    shift = np.concatenate([2 * np.pi * problem.turns, np.zeros(problem.model.degrees_of_freedom)])
    states[-1] = nodes[0] + shift
    return nodes, np.linspace(0.0, w.period, len(states)), states


def measured(one: Bench, loop: Found) -> Orbit:
    """The Orbit of a loop, as `periodic.measure` makes it, by the compiled march."""
    problem, march = loop.problem, one.equations["none"].march
    period, mesh = loop.w.period, loop.times / loop.times[-1]
    tail, monodromy = np.append(period, np.zeros(march.unfolding)), np.eye(2 * one.model.degrees_of_freedom)
    for matrix in march.varied(loop.nodes, mesh, tail).transitions:
        monodromy = matrix @ monodromy
    gradients, directions = frame(one.model, loop.nodes[0])
    floquet = analyse(reduce_monodromy(monodromy, gradients, directions), conservative=True)
    end = march.ends(loop.nodes[:1], mesh, tail)[0]
    return recorded(
        problem, period, end, loop.nodes, loop.times, loop.states, loop.w.unfolding, loop.action, floquet
    )  # fmt: skip


def centred(one: Bench, problem: Problem, nodes: np.ndarray) -> np.ndarray:
    """Nodes with the first one's angles in (-pi, pi], where whole turns may be taken off."""
    n = one.model.degrees_of_freedom
    if problem.boundary.forward is not None:
        return nodes
    whole = np.ceil((nodes[0, :n] - np.pi) / (2 * np.pi)) * one.model.angular
    return nodes - 2 * np.pi * np.concatenate([whole, np.zeros(n)])


def minimal(one: Bench, loop: Found, settings: QuickSettings) -> Found:
    """The same loop over its minimal period; `ConvergenceError` when that is not in the range wanted."""
    low, high = one.target.periods
    if not low <= loop.w.period <= 2 * high:  # a multiple cover that is too long may have a period in range
        raise ConvergenceError("period outside the range")
    covers = [k for k in range(2, LARGEST_COVER + 1) if not np.any(loop.problem.turns % k)]
    near: list[bool] = []
    if covers:
        near = [far < COVER for far in return_distances(loop.times, loop.states, one.model.angular, covers)]
    if any(near):
        loop = uncovered(one, loop, max(compress(covers, near)), settings)
    if not low <= loop.w.period <= high:
        raise ConvergenceError("period outside the range")
    return loop


def uncovered(one: Bench, loop: Found, cover: int, settings: QuickSettings) -> Found:
    """The loop solved again over a `cover`-th of its period."""
    period, state = loop.w.period / cover, loop.states[0]
    if period < one.target.periods[0]:
        raise ConvergenceError("period outside the range")
    winding = tuple(int(k) // cover for k in loop.problem.turns)
    problem = Problem(one.model, Guess(state, period), pin=pin(energy=one.target.energy), winding=winding)
    w, _ = begun(one, one.equations["none"], state, period, settings)
    return solved(one, problem, w, settings)


def origin(seed: int, start: Start) -> dict[str, Any]:
    """Provenance of an orbit found from a start: enough to find it again."""
    from orbitfinder._runtime import __version__
    from orbitfinder.records.orbit import VERSION

    return {
        "orbitfinder": __version__,
        "orbit_format": VERSION,
        "numpy": np.__version__,
        "seed": seed,
        "index": start.index,
        "strategy": start.strategy,
        "symmetry_imposed": start.symmetry,
        "start": {"state": [float(x) for x in start.state], "period": start.period},
    }
