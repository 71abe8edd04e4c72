"""Orbits of hybrid systems: the guess simulated to begin with, and the evidence of an independent simulation.

Found by Newton's method on the Loop, in which an arc's duration is an unknown and its guard a row; certified by the
automaton itself, which watches all guards and does not know where an arc should end.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import UNSOLVED, ConvergenceError
from orbitfinder.integrate.automaton import Arc, Automaton, arcs_along
from orbitfinder.integrate.dop853 import SECOND, TIGHTEST, ReferenceSettings, Trace
from orbitfinder.integrate.equations import invariant_gradients
from orbitfinder.integrate.field import rates_of, scaled
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.continued import Solution
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.newton import Refined
from orbitfinder.loops.problem import Guess, Problem, guessed_nodes
from orbitfinder.loops.symmetry import NONE, RECOGNITION, symmetries_of, turned
from orbitfinder.mechanics.hybrid import Hybrid, Transition, saltation, share
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model, energies, energy, wrapped
from orbitfinder.mechanics.scales import extents_of, snapped
from orbitfinder.orbits.between import Rates, risen, unresolved
from orbitfinder.orbits.closure import closes, gap, shift, shift_along
from orbitfinder.orbits.evidence import CHECKED, ClosureCheck, Recomputed, StatesAt, Tour, in_extents, varied_end
from orbitfinder.orbits.floquet import AREA, analyse, generated
from orbitfinder.orbits.measure import recorded
from orbitfinder.records.orbit import Orbit

LOOKS = 24
"""Looks at rates and guards between two samples of an arc"""
PIECES = 4
"""Pieces of an arc whose variations are integrated one by one"""
PATIENCE = 20.0
"""Periods of the guess after which its simulation is given up"""
STEPS = 16
"""Steps of the simulation in a period, at least: where nothing moves but a clock, there would be one"""
TRIED = 24
"""States of an arc at which the equations are compared a turn further"""
ROUGH = ReferenceSettings(relative_tolerance=1e-10, absolute_tolerance=1e-12)
"""Tolerances of the simulation of a guess"""


def cycle_from(
    model: Model, state: np.ndarray, settings: ReferenceSettings = TIGHTEST, longest: float = np.inf, parts: int = 1,
    trajectory: tuple[np.ndarray, np.ndarray] | None = None,
) -> list[Arc]:  # fmt: skip
    """One cycle of a hybrid Model, or the first of so many equal parts of it: that of a trajectory (times and states),
    else simulated from a state, for `longest` s at most.

    Raises `ConvergenceError` where its events are not the cycle's.
    """
    hybrid: Hybrid = model.hybrid
    automaton = Automaton.about(model, state, longest / PATIENCE, settings, longest / (PATIENCE * STEPS))
    cycle = hybrid.cycle[: len(hybrid.part(parts))]
    if trajectory is None:
        found = list(automaton.arcs(state, hybrid.arcs[0][0].name, longest, len(cycle), hybrid.cycle[-1]))
    else:
        found = arcs_along(model, *trajectory)[: len(cycle)]
    events = tuple(arc.ended_by for arc in found)
    if events != cycle:
        named = ", ".join(one or "no event" for one in events or [None]) + _crossed(automaton, found)
        raise ConvergenceError(
            f"the motion from the guess goes through {named} where the cycle asks for {', '.join(cycle)}; start "
            "nearer, or ask for the cycle that it goes through"
        )
    return found


def _crossed(automaton: Automaton, arcs: Sequence[Arc]) -> str:
    """Which guards are beyond 0 already where the last arc begins that no event ends, in words."""
    if not arcs or arcs[-1].ended_by is not None:
        return ""
    arc = arcs[-1]
    leaving = automaton.hybrid.leaving(arc.mode)
    heights = {one.name: one.direction * float(automaton.value(one.guard, arc.states[0])[0]) for one in leaving}
    beyond = [name for name, height in heights.items() if not height <= 0]
    return f" (in mode {arc.mode} the guard of {', '.join(beyond)} is crossed from the start, or no number)" * bool(
        beyond
    )


def first_unknowns(equations: Equations, guess: Guess, segments: int, steps: int) -> Unknowns:
    """The unknowns of a guess, `segments` and `steps` of each in every arc."""
    model, parts = with_parameters(equations.model, guess.free), equations.symmetry.parts
    arcs = cycle_from(model, guess.start, ROUGH, PATIENCE * guess.period, parts, guess.trajectory)
    durations = np.array([arc.duration for arc in arcs])
    period = parts * float(durations.sum())
    along = (Guess(arc.states[0], arc.duration, arc.times - arc.times[0], arc.states) for arc in arcs)
    nodes = [guessed_nodes(one, np.arange(segments) / segments) for one in along]
    free = model.values_of(equations.free)
    last = free.size - (len(arcs) - 1)
    free[last:] = durations[:-1] / period
    mesh = uniform(equations.symmetry.fraction, len(arcs) * segments, steps)
    return equations.unknowns(np.vstack(nodes), period, mesh, free)


def carried(equations: Equations, like: Unknowns, guess: Guess) -> Unknowns:
    """The unknowns of a guess whose arcs last as long, in shares of its period, as those of unknowns nearby, or as it
    says; its states are the nodes, where it has as many."""
    free, steps, x = like.free.copy(), like.steps, guess.start
    for name, value in guess.free.items():
        free[equations.free.index(name)] = value
    w, nodes = replace(like, period=float(guess.period), free=free), []
    if guess.times is None and guess.states is not None and np.shape(guess.states) == like.nodes.shape:
        return replace(w, nodes=np.asarray(guess.states, float))
    ends = equations.links.ends(len(like.nodes))
    for k in range(len(like.nodes)):
        nodes.append(x)
        if k == len(like.nodes) - 1:
            break
        arc = k // (len(like.nodes) // equations.links.count)
        x = equations.march.arcs[arc].ends(x[None], like.mesh[k * steps : (k + 1) * steps + 1], w.tail)[0]
        x = equations.links.after(arc, x, free) if k in ends else x
    return replace(w, nodes=np.array(nodes))


@dataclass(frozen=True)
class HybridEvidence(Recomputed):
    """What the simulated automaton says of a state: its arcs, how long they take, what must hold.

    Times and states are those of all arcs, those of events twice, before and after; `transversal` is the least rate at
    which a guard is crossed, relative; `decided` the least |allowed| at a crossing; `varied` the steps of DOP853 along
    the pieces of each arc, of the motion and one of its variations.
    """

    arcs: tuple[Arc, ...]
    period: float
    drift: float
    balance: float
    transversal: float
    decided: float
    varied: list[list[Trace]]


def motion_of(arcs: Sequence[Arc]) -> tuple[np.ndarray, np.ndarray]:
    """Times (k) and states (k x d) of arcs, those of events twice, before and after."""
    return np.concatenate([arc.times for arc in arcs]), np.vstack([arc.states for arc in arcs])


def gather_hybrid(model: Model, state: np.ndarray, period: float, turns: np.ndarray) -> HybridEvidence:
    """The evidence of a state at the beginning of the cycle, of which the period is told.

    Raises `ConvergenceError`, `IntegrationError`.
    """
    arcs = cycle_from(model, state, longest=PATIENCE * period)
    period, end = float(arcs[-1].times[-1]), arcs[-1].after
    times, states = motion_of(arcs)
    units = extents_of(model, states, period)
    automaton = Automaton.about(model, state, period)
    variations, action, varied = _variations(automaton, arcs)
    pieces = in_extents(variations, units)
    rate = automaton.field(arcs[0].mode)(0.0, np.asarray(state, float)) / units
    slopes, ended = (invariant_gradients(model)(x).full().reshape(-1, units.size) * units for x in (state, end))
    found = closes((end - state - shift(turns, units.size)) / units, pieces, states / units, rate * period, slopes)
    directions = np.vstack([rate, generated(model, state) / units])
    identity, motion = np.eye(units.size), (times, states)
    loop = Tour(found, pieces, slopes, directions, False, units, identity, motion=motion, ended=ended)
    drift, balance = _energies(model, arcs)
    # multipliers come in reciprocal pairs only where the resets keep areas too
    reduced = loop.map()
    area = abs(float(np.linalg.det(reduced))) if reduced.size else 1.0
    return HybridEvidence(
        times=times,
        states=states,
        extents=units,
        tour=loop,
        closure=gap(state, end, turns),
        action=action,
        energy=energy(model, state),
        floquet=analyse(reduced, conservative=bool(len(loop.gradients)) and abs(area - 1.0) < AREA),
        arcs=tuple(arcs),
        period=period,
        drift=drift,
        balance=balance,
        transversal=min(abs(arc.slope) for arc in arcs),
        decided=min(arc.decided for arc in arcs),
        varied=varied,
    )


def repeats(model: Model, name: str, evidence: HybridEvidence, turns: np.ndarray) -> bool:
    """Whether the state after half of the events, and half of the period, is the image of the first by a symmetry."""
    forward, count = symmetries_of(model).get(name, NONE).forward, len(evidence.arcs)
    if forward is None or name != forward.name or count % 2:
        return False
    start, half, n = evidence.arcs[0].states[0], evidence.arcs[count // 2 - 1], model.degrees_of_freedom
    moved = shift(np.where(forward.keeps(n), turns / 2, 0.0), start.size)
    away = wrapped(half.after - forward.matrix(n) @ start - moved, model.angular) / evidence.extents
    return bool(max(np.abs(away).max(), abs(half.times[-1] / evidence.period - 0.5)) <= RECOGNITION)


def hybrid_tour(model: Model, state: np.ndarray, period: float, turns: np.ndarray) -> Tour:
    """The `Tour` of a hybrid orbit, as its automaton is simulated. Raises `ConvergenceError`, `IntegrationError`."""
    found = gather_hybrid(model, state, period, turns)
    return replace(found.tour, pieces=[found.tour.inner()], conservative=found.floquet.indices.size > 0)


def retraced(equations: Equations, found: Solution) -> Solution:
    """A hybrid orbit whose states at its mesh are those of the automaton's integrator, over durations that are told."""
    w, links = found.place, equations.links
    model = with_parameters(equations.model, dict(zip(equations.free, map(float, w.free), strict=True)))
    automaton, arcs, states, ends = Automaton(model), links.count, [], found.march.ends.copy()
    steps, x, last = (w.mesh.size - 1) // arcs, w.nodes[0], links.ends(len(w.nodes))
    units = snapped(nonzero(np.ptp(found.march.states, axis=0)))
    for k, ((mode, one), lasts) in enumerate(zip(model.arcs, links.shares(w.free), strict=True)):
        times = (w.mesh[k * steps : (k + 1) * steps + 1] * arcs - k) * lasts * w.period
        path = automaton.path(mode.name, x, times, CHECKED, units)
        states.append(path[:-1])
        ends[last[k]], x = path[-1], automaton.value(one.reset, path[-1])
    return replace(found, march=replace(found.march, states=np.vstack([*states, x[None]]), ends=ends))


def hybrid_orbit(problem: Problem, refined: Refined) -> Orbit:
    """The Orbit (without certificate) of a refined one."""
    model, turns, along = problem.model, np.asarray(refined.turns, int), {}
    if problem.relative:
        end = cycle_from(model, refined.state, longest=PATIENCE * refined.period)[-1].after
        along = shift_along(model, problem.relative, refined.state, end, turns)
    found = gather_hybrid(model, refined.state, refined.period, turned(model, turns, along))
    return recorded(
        replace(problem, winding=tuple(map(int, turns))), refined.period, found.arcs[-1].after,
        refined.state[None], found.times, found.states, refined.unfolding, found.action, found.floquet,
        problem.symmetry,
    )  # fmt: skip


def second_gap(model: Model, state: np.ndarray, period: float, turns: np.ndarray, units: np.ndarray) -> float:
    """The gap in `units` of the automaton simulated at a second tolerance; infinite where it takes another way."""
    try:
        arcs = cycle_from(model, state, SECOND, PATIENCE * period)
    except UNSOLVED:
        return np.inf
    return gap(state, arcs[-1].after, turns, units)


def _variations(automaton: Automaton, arcs: Sequence[Arc]) -> tuple[list[np.ndarray], float, list[list[Trace]]]:
    """State-transition matrices of pieces of all arcs, the last of each through its event; the action; and the steps
    along the pieces of each arc, of the motion and one of its variations."""
    found, action, units = [], 0.0, automaton.units
    varied = [list[Trace]() for _ in arcs]
    modes = [automaton.hybrid.mode(one.mode).model for one in arcs]
    for k, arc in enumerate(arcs):
        field, x, size = automaton.varied(arc.mode), arc.states[0], arc.states.shape[1]
        edges, unit = np.linspace(0.0, arc.duration, PIECES + 1), np.eye(size).ravel()
        rates = [
            field(0.0, np.concatenate([one, unit, [0.0]]))[-1] for one in arc.states[:: max(1, len(arc.states) // 4)]
        ]
        work = float(snapped(np.abs(rates).max() * arc.duration))
        for begin, finish in pairwise(edges):
            x, piece, done = varied_end(field, x, np.array([begin, finish]), units, work, TIGHTEST, varied[k])
            found.append(piece)
            action += done
        event = automaton.hybrid.transition(str(arc.ended_by))
        jump = saltation(modes[k], event, modes[(k + 1) % len(modes)])
        found[-1] = jump(arc.states[-1], automaton.model.parameter_values).full() @ found[-1]
    return found, action, varied


def _energies(model: Model, arcs: Sequence[Arc]) -> tuple[float, float]:
    """The largest drift of the energy in an arc without forces, and the largest error of the energy lost in an impact,
    both relative to the energy exchanged."""
    drift = balance = 0.0
    modes = {mode.name: mode.model for mode, _ in model.arcs}
    exchanged = nonzero(max(float(energies(modes[arc.mode], arc.states)[0].max()) for arc in arcs))
    for arc in arcs:
        own = modes[arc.mode]
        if own.forces is not None or own.rates is not None:
            continue
        kinetic, potential = energies(own, arc.states)
        values = kinetic + potential
        drift = max(drift, float(np.abs(values - values[0]).max()) / exchanged)
        if arc.lost is not None:
            target = modes[model.hybrid.transition(str(arc.ended_by)).target]
            lost = kinetic[-1] - energies(target, arc.after[None])[0][0]
            balance = max(balance, abs(float(lost) - arc.lost) / exchanged)
    return drift, balance


def unseen(model: Model, evidence: HybridEvidence) -> tuple[float, float, str]:
    """What features narrower than a step change along the arcs, in extents, the widest gap between two looks, and the
    guard, "" if there is none, that is crossed where the simulation saw nothing."""
    automaton, units = Automaton(model), evidence.extents
    changed, widest, crossed = 0.0, 0.0, ""
    for arc, varied in zip(evidence.arcs, evidence.varied, strict=True):
        rates = rates_of(scaled(automaton.field(arc.mode), units))[0]
        moments, kept = np.unique(arc.times - arc.times[0], return_index=True)
        trace = Trace(moments, arc.states[kept] / units, rates, True)
        found, width, _ = unresolved(trace, varied)
        changed, widest = changed + found, max(widest, width)
        for one in automaton.hybrid.leaving(arc.mode):

            def height(rows: np.ndarray, one: Transition = one) -> np.ndarray:
                return one.direction * model.along(one.guard, (rows * units).T).ravel()

            def climb(rows: np.ndarray, one: Transition = one, rates: Rates = rates) -> np.ndarray:
                slopes = model.along(one.slope, (rows * units).T).reshape(rows.shape)
                return np.asarray(one.direction * (slopes * rates(np.zeros(len(rows)), rows) * units).sum(axis=1))

            beyond = risen(trace, height, climb, LOOKS)
            if len(beyond) and (one.allowed is None or np.any(model.along(one.allowed, (beyond * units).T) > 0)):
                crossed = one.name
    return changed, widest, crossed


def turned_further(model: Model, arcs: Sequence[Arc], turn: np.ndarray) -> float:
    """The largest relative difference of rates, guards and resets along a motion at states a `turn` (d) further."""
    automaton, unit = Automaton(model), np.eye(turn.size)
    each = [((arc.mode, ""), arc.states[:: max(1, len(arc.states) // TRIED)]) for arc in arcs]
    return max(automaton.unlike(mode, mode, rows, unit, turn) for mode, rows in each)


def paths(model: Model, arcs: Sequence[Arc]) -> Iterator[tuple[float, float, StatesAt]]:
    """When each arc begins, how long it lasts (s), its states at times since."""
    automaton = Automaton.about(model, arcs[0].states[0], float(arcs[-1].times[-1]))
    for arc in arcs:
        yield float(arc.times[0]), arc.duration, partial(automaton.path, arc.mode, arc.states[0])


class HybridCheck(ClosureCheck):
    """The closure of a family's hybrid orbits: DOP853 over each arc for the time that it takes, its guard, its reset.

    What the automaton asks besides, that no guard is crossed earlier, is asked of the family's own mesh.
    """

    def __init__(self, model: Model) -> None:
        self._model, self._at, self._automaton = model, {}, Automaton(model)

    def __call__(
        self,
        state: np.ndarray,
        period: float,
        turns: np.ndarray,
        allowed: float = 0.0,
        free: Mapping[str, float] | None = None,
        units: np.ndarray | float = 1.0,
    ) -> float:
        """The largest gap round the loop in `units` (d), or miss of a guard in periods."""
        del allowed
        self._set(free)
        parts, measures = self._automaton.hybrid, self._measures(units)
        found, x, shares = 0.0, np.asarray(state, float), shares_of(self._automaton.model)
        for (mode, one), lasts in zip(parts.arcs, shares, strict=True):
            x = self._automaton.path(mode.name, x, np.array([0.0, lasts * period]), CHECKED, measures)[-1]
            rate = self._automaton.rate(one, x)
            miss = float(self._automaton.value(one.guard, x)[0])
            found = max(found, abs(miss / (rate * period)) if rate else np.inf)
            if rate:  # at the guard, so that errors grow no more than those of the machine do
                x = x - self._automaton.field(mode.name)(0.0, x) * (miss / rate)
            x = self._automaton.value(one.reset, x)
        return max(found, gap(np.asarray(state, float), x, turns, units))

    def ends(
        self,
        nodes: np.ndarray,
        durations: np.ndarray,
        free: Mapping[str, float] | None = None,
        units: np.ndarray | float = 1.0,
    ) -> np.ndarray:
        """Where each piece of an orbit ends (N x d), through the event that it ends with if it does."""
        self._set(free)
        arcs, measures = self._automaton.hybrid.arcs, self._measures(units)
        each, found = len(nodes) // len(arcs), []
        for k, (node, duration) in enumerate(zip(nodes, durations, strict=True)):
            mode, one = arcs[k // each]
            lasts = duration * shares_of(self._automaton.model)[k // each] * len(arcs)
            x = self._automaton.path(mode.name, node, np.array([0.0, lasts]), CHECKED, measures)[-1]
            found.append(x if (k + 1) % each else self._automaton.value(one.reset, x))
        return np.stack(found)

    def _measures(self, units: np.ndarray | float) -> np.ndarray:
        """What states (d) are integrated in."""
        return snapped(np.broadcast_to(units, len(self._model.state_names)))

    def _set(self, free: Mapping[str, float] | None) -> None:
        if self._at != dict(free or {}):
            self._at = dict(free or {})
            self._automaton = Automaton(with_parameters(self._model, self._at))


def closure_check(model: Model, stiff: bool) -> ClosureCheck:
    """What a family's orbits are checked with, of a model that may be hybrid."""
    return ClosureCheck(model, stiff=stiff) if model.smooth else HybridCheck(model)


def shares_of(model: Model) -> np.ndarray:
    """The shares of the period that a hybrid Model's arcs take, by its parameters."""
    return np.array([float(share(model, k, model.parameter_values)) for k in range(len(model.cycle))])


def held(arcs: Sequence[Arc]) -> Iterator[tuple[str, float]]:
    """What must not be negative: in modes along the motion, and impulses at events, each with its least value."""
    least: dict[str, float] = {}
    for arc in arcs:
        pairs = [*arc.margins, (f"impulse of {arc.ended_by}", arc.impulse)]
        for name, value in pairs:
            if value is not None:
                least[name] = min(least.get(name, np.inf), float(value))
    yield from least.items()
