"""Where searches start: a function of (seed, index) alone, so that any worker can make any start.

Every strategy proposes a state on the energy shell, simulates it over the longest period wanted and
takes one of the times at which the boundary condition of its symmetry comes nearest to holding.
Close returns as starting points: D. P. Lathrop, E. J. Kostelich, Physical Review A 40 (1989) 4028-4031.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.optimize import brentq

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.atlas.abreast import Course, Marched, alone
from orbitfinder.atlas.controlled import Controlled, problem_of
from orbitfinder.atlas.regions import Attractor, Level, Region
from orbitfinder.atlas.sections import TURNS as TURNED
from orbitfinder.atlas.sections import EventSection
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.integrate.equations import prepare
from orbitfinder.integrate.march import rounded, uniform
from orbitfinder.loops.conditions import Pin, pin
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import (
    ALONE,
    BRAKE,
    NONE,
    QUARTER,
    REFLECTION,
    REVERSAL,
    SYMMETRIES,
    Involution,
    Symmetry,
    declared,
    involutions,
    off_centre,
    with_mirrors,
)
from orbitfinder.mechanics.model import Model, wrapped
from orbitfinder.mechanics.scales import alike, given_or, snapped
from orbitfinder.orbits.guesses.modes import normal_modes, resting_place

CYCLES = 3
"""Cycles of a hybrid system that an orbit goes through at most unless told otherwise."""
METHOD = 3
"""Raised whenever the same number of a start would lead elsewhere than before; part of what a search is."""
DECLARED = "declared-"
"""In front of the name of a reversal that the system has or declares: such starts begin in its fixed set, look for the
next return to it, and solve half a period."""


@dataclass(frozen=True)
class SearchSettings:
    """How starts are proposed, and how what they lead to is judged; another value needs another `METHOD`."""

    samples_per_period: int = 400
    """of the simulation over the longest period"""
    choices: int = 4
    """nearest returns from which the period is drawn"""
    recurrence_span: float = 3.0
    """longest periods that a recurrence start simulates"""
    recurrence_beginnings: int = 40
    """moments in each longest period from which returns are looked for"""
    attempts: int = 200
    """at a position below the energy"""
    spans: int = 16
    """the step is calibrated on this fraction of the longest period"""
    calibration_states: int = 24
    step_error: float = 1e-7
    """of the median motion over such a span"""
    most_halvings: int = 12
    growth_per_segment: float = 10.0
    segments: tuple[int, int] = (2, 16)
    """fewest and most"""
    period_margin: float = 1.15
    """factor by which the cheap stage lets the period leave the range before it holds it"""
    largest_unfolding: float = 1e-8
    smallest: float = 1e-3
    """motions of less than this extent (rad or lengths of the energy shell) are equilibria"""
    largest_cover: int = 30
    cover: float = 1e-5
    """a return at T/k nearer than this, relative to the motion's extent, means that the loop was run k times"""


@dataclass(frozen=True)
class Target:
    """What a search looks for: energy in J, 0 where none is conserved, and the range of minimal periods in s.

    Of a hybrid system besides how many cycles an orbit goes through at most, and where: ranges of the state's
    components right after the event that ends the cycle.
    """

    energy: float
    periods: tuple[float, float]
    section: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    cycles: int = CYCLES
    problem: Mapping[str, Any] = field(default_factory=dict)
    """of controlled motions what is asked of them, as plain values"""


@dataclass(frozen=True)
class Context:
    """Everything about a model that starts share.

    Equations by the symmetry imposed (only those that the model has), the step (s) of the
    cheap stage, the equilibrium and the normal modes about it, the strategies that take turns, the lengths (n) of the
    energy shell.
    """

    model: Model
    target: Target
    equilibrium: np.ndarray
    shapes: np.ndarray
    strategies: tuple[str, ...]
    lengths: np.ndarray
    equations: Mapping[str, Equations] = field(default_factory=dict)
    problems: Mapping[str, Problem] = field(default_factory=dict)
    """one each, whose guess is to be another"""
    step: float = 0.0
    declared: Mapping[str, Involution] = field(default_factory=dict)
    """the system's own reversals, by strategy; of a first-order system all that it may have, forwards too"""
    region: Region | None = None
    """where the states of a first-order system are drawn from"""
    section: EventSection | None = None
    """where those of a hybrid one are, and its orbits found"""
    controlled: Controlled | None = None
    """where controlled motions start, and what they lead to"""
    settings: SearchSettings = SearchSettings()

    @property
    def units(self) -> np.ndarray:
        """What states (2n) are measured in: lengths, and lengths over a power of 256 near the longest period / 2 pi."""
        return (
            self.lengths if self.model.rates is not None else np.concatenate([self.lengths, self.lengths / self.clock])
        )

    @property
    def sizes(self) -> np.ndarray:
        """Lengths of a state's components (2n), rates in lengths a second."""
        return self.lengths if self.model.rates is not None else np.tile(self.lengths, 2)

    @property
    def pins(self) -> tuple[Pin, ...]:
        """What orbits are pinned by: the energy, where there is one."""
        return pin(energy=self.target.energy) if self.model.conservative else ()

    @property
    def beat(self) -> float:
        """The period of the forcing in s, 0 where there is none."""
        period = self.model.forcing_period
        return 0.0 if period is None else float(period(self.model.parameter_values))

    @property
    def cycles(self) -> np.ndarray:
        """How many of them may be in a period wanted."""
        low, high = (round(period / self.beat, 9) for period in self.target.periods)
        return np.arange(max(1, int(np.ceil(low))), int(np.floor(high)) + 1)

    @property
    def clock(self) -> float:
        """That power of 256, in s."""
        return float(snapped(self.target.periods[1] / (2 * np.pi)))


@dataclass(frozen=True)
class SearchStart:
    """One start: its number, strategy, the symmetry imposed, state (2n) and period (s), of a hybrid system the events
    that its motion goes through."""

    index: int
    strategy: str
    symmetry: str
    state: np.ndarray
    period: float
    course: tuple[str, ...] = ()
    problem: Problem | None = None
    """of a controlled motion, with its guess"""


def context_of(model: Model, target: Target) -> Context:
    """The shared part of a search. Raises `InputError` for systems and energies that cannot be searched."""
    if target.problem:
        check_periods(target)
        made = Controlled.of(problem_of(model, target.problem), target.periods)
        size = model.degrees_of_freedom
        place, none = np.zeros(size), np.zeros((size, 0))
        return Context(model, target, place, none, made.strategies, made.extents[:size], controlled=made)
    check(model, target)
    if not model.smooth:
        section = EventSection.of(model, target.section, target.cycles, target.periods, target.energy)
        place = section.drawn(np.random.default_rng(0))
        return Context(model, target, place, np.zeros((place.size, 0)), TURNED, section.lengths, section=section)
    if model.forced:
        return _forced(model, target)
    if model.rates is not None:
        return _alone(model, target)
    model = with_mirrors(model)
    place = resting_place(model, target.energy)
    prepare(model)
    lengths = shell_lengths(model, place, target.energy)
    origin = np.append(np.where(lengths == 1.0, 0.0, lengths), np.zeros(lengths.size))
    own = {
        f"{DECLARED}{reversal.name}": reversal for reversal in declared(model)
        if reversal.sense < 0 and Symmetry((reversal,)).held_by(model, origin)
    }  # fmt: skip
    known = [name for name, symmetry in SYMMETRIES.items() if symmetry.held_by(model, origin)]
    imposed = {"none"} | {symmetry for symmetry, _ in STRATEGIES.values()}
    chosen = {name: SYMMETRIES[name] for name in known if name in imposed}
    chosen |= {reversal.name: Symmetry((reversal,)) for reversal in own.values()}
    half, declares = len(TURNS) // 2, (*own, *(own if len(own) == 1 else ()))
    turns = (*TURNS[:half], *declares, *TURNS[half:], *declares)
    turns = tuple(name for name in turns if name in own or possible(name, known))
    return _ready(
        Context(model, target, place, normal_modes(model, place)[1], turns, lengths, declared=own), chosen, origin
    )


def _ready(context: Context, chosen: Mapping[str, Symmetry], place: np.ndarray) -> Context:
    """With equations by the symmetries that are imposed, and the step of the cheap stage."""
    model = context.model
    equations = {name: Equations(model, symmetry, alone=True) for name, symmetry in chosen.items()}
    guess = Guess(place, context.target.periods[1])
    problems = {name: Problem(model, guess, pin=context.pins, symmetry=name) for name in equations}
    ready = replace(context, equations=equations, problems=problems)
    return replace(ready, step=calibrated(ready))


def _alone(model: Model, target: Target) -> Context:
    """The shared part of a search of a first-order system."""
    region = Level.of(model, target.energy) if model.invariants else Attractor.of(model, target.periods[1])
    prepare(model)
    place = region.drawn(np.random.default_rng(0))
    held = [mirror for mirror in involutions(model) if Symmetry((mirror,), True).held_by(model, place)]
    own = {f"{DECLARED}{mirror.name}": mirror for mirror in held}
    chosen = {NONE.name: ALONE} | {mirror.name: Symmetry((mirror,), True) for mirror in own.values()}
    turns = ("recurrence", *own, "random", "recurrence", *own)
    shapes, lengths = np.zeros((place.size, 0)), region.lengths
    return _ready(Context(model, target, place, shapes, turns, lengths, declared=own, region=region), chosen, place)


def _forced(model: Model, target: Target) -> Context:
    """The shared part of a search of a forced system, whose periods are multiples of the forcing's."""
    region = Attractor.of(model, target.periods[1])
    prepare(model)
    place = region.drawn(np.random.default_rng(0))
    shapes = np.zeros((model.degrees_of_freedom, 0))
    context = Context(model, target, place, shapes, ("recurrence", "random"), region.lengths, region=region)
    if not context.cycles.size:
        low, high = target.periods
        raise InputError(
            f"search.period: no multiple of the forcing's period, {context.beat:.6g} s, is from {low:g} to {high:g} s; "
            "widen it"
        )
    return _ready(context, {NONE.name: NONE if model.rates is None else ALONE}, place)


def shell_lengths(model: Model, place: np.ndarray, energy: float) -> np.ndarray:
    """What coordinates (n) are measured in at an energy: rad, and lengths given or in which V(q) comes to E from rest.

    These are powers of 2, 1 where they are within a factor of 16 of it or V never comes to E.
    """
    sizes = np.ones(place.size)
    reaches = 2.0 ** np.arange(-100, 100)  # distances from the equilibrium at which the energy shell is looked for
    for k, unit in enumerate(np.eye(place.size)):
        if model.angular[k]:
            continue
        trials = (place + sign * size * unit for size in reaches for sign in (-1, 1))
        above = (float(model.potential(q, model.parameter_values)) > energy for q in trials)
        first = next((i for i, higher in enumerate(above) if higher), None)
        size = 1.0 if first is None else reaches[first // 2]
        sizes[k] = alike(size)
    return given_or(model, sizes)


def possible(name: str, known: Sequence[str]) -> bool:
    """True when the model has the symmetries that a strategy relies on."""
    return (name if name == REVERSAL.name else STRATEGIES[name][0]) in known


def calibrated(context: Context) -> float:
    """The step (s) with which the median motion on the energy shell is right to `step_error` per span."""
    how, random, march = context.settings, np.random.default_rng(0), context.equations[NONE.name].march
    states = np.array([_random_state(context, random) for _ in range(how.calibration_states)])
    span, steps = context.target.periods[1] / how.spans, 4
    tail = np.append(span, np.zeros(march.unfolding))

    def marched(count: int) -> np.ndarray:
        ends = []
        for state in states:
            try:
                ends.append(march.ends(state[None], uniform(1.0, 1, count), tail)[0])
            except IntegrationError:
                ends.append(np.full(state.size, np.inf))
        return np.asarray(ends)

    coarse = marched(steps)
    for _ in range(how.most_halvings):
        fine = marched(2 * steps)
        with np.errstate(invalid="ignore"):
            size = np.maximum(1.0, np.abs(fine / context.units).max(axis=1))
            error = np.abs((fine - coarse) / context.units).max(axis=1) / size
        if float(np.median(np.nan_to_num(error, nan=np.inf))) < how.step_error:
            return span / steps
        steps, coarse = 2 * steps, fine
    raise InputError(
        f"search.period: motions of {span:.3g} s at this energy need more than {steps} steps; ask for shorter periods"
    )


def check(model: Model, target: Target) -> None:
    """`InputError` when a model has no energy shells, or when the target makes no sense."""
    check_periods(target)
    if not np.isfinite(target.energy):
        raise InputError(f"energy: must be finite, got {target.energy}; give a number in J")
    if not model.smooth:
        return
    if target.section:
        raise InputError("search.section: is of hybrid systems, this one has no events; leave it out")
    if model.constraint is not None:
        raise InputError(
            "search: works in minimal coordinates, not on systems under constraints; give minimal_linkage(...) from "
            "Python, or use find with a guess"
        )
    names = [invariant.name for invariant in model.invariants]
    alone = model.rates is not None and not names
    if (model.forced and names) or not (model.forced or alone or (model.conservative and len(names) == 1)):
        raise InputError(
            f"search: works on energy shells of systems that conserve the energy and nothing else, on forced systems "
            f"and attractors; this one conserves {', '.join(names) or 'nothing'}; use find with a guess instead"
        )


def check_periods(target: Target) -> None:
    """`InputError` for what is no range of periods."""
    low, high = target.periods
    if not (np.isfinite(high) and 0 < low < high):
        raise InputError(f"search.period: must be two increasing positive numbers, got {low:g}, {high:g}; in s")


def make_start(context: Context, seed: int, index: int) -> SearchStart:
    """The start with this number; `ConvergenceError` when its strategy proposes none."""
    return alone(proposed(context, seed, index))


def proposed(context: Context, seed: int, index: int) -> Course[SearchStart]:
    """The same as a course."""
    name = strategy_of(context, index)
    random = np.random.default_rng([seed, index])
    if context.controlled is not None:
        problem = context.controlled.drawn(name, random)
        state, period = np.asarray(problem.guess.state), problem.guess.period
        return SearchStart(index, name, problem.symmetry, state, period, problem=problem)
    if context.section is not None:
        returned = context.section.returns(name, random)
        return SearchStart(index, name, NONE.name, returned.state, returned.period, returned.course)
    if name in context.declared:
        mirror = context.declared[name]
        state = _fixed(context, mirror, random) if mirror.sense < 0 else _random_state(context, random)
        return SearchStart(index, name, mirror.name, state, (yield from _return_time(context, name, state, random)))
    symmetry, propose = STRATEGIES[name]
    state = propose(context, random)
    if context.model.forced:
        state, period = yield from _strobed(context, name, state, random)
        return SearchStart(index, name, NONE.name, state, period)
    if name == "recurrence":
        state, period = yield from _recurrence(context, state, random)
    else:
        known = name if name == REVERSAL.name else symmetry
        period = yield from _return_time(context, known, state, random)
    return SearchStart(index, name, symmetry, state, period)


def strategy_of(context: Context, index: int) -> str:
    """Strategies take turns."""
    return context.strategies[index % len(context.strategies)]


def random_position(context: Context, random: np.random.Generator, most: float = 1.0) -> np.ndarray:
    """Coordinates (n) with V < E, angles uniform within `most` of a half turn of the equilibrium."""
    reach = np.where(context.model.angular, np.pi, 2.0 * context.lengths)
    for attempt in range(context.settings.attempts):
        shrink = most * (1.0 - 0.9 * attempt / context.settings.attempts)
        q = context.equilibrium + shrink * reach * random.uniform(-1, 1, reach.size)
        if potential(context, q) < context.target.energy:
            return q
    raise ConvergenceError("no position below the energy")


def potential(context: Context, q: np.ndarray) -> float:
    """V(q) in J."""
    march = context.equations[NONE.name].march.arcs[0]
    return float(march.at(context.model.potential, q, context.model.parameter_values)[0][0, 0])


def on_shell(context: Context, q: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The state (2n) at q with velocity along `direction` and the target's energy."""
    at = context.equations[NONE.name].march.arcs[0].at
    kinetic = float(at(context.model.kinetic, q, direction, context.model.parameter_values)[0][0, 0])
    size = np.sqrt((context.target.energy - potential(context, q)) / nonzero(kinetic))
    return np.concatenate([q, size * direction])


def at_rest(context: Context, q: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The state of rest where the ray from q (V < E) along `direction` first meets V = E."""
    unit = np.linalg.norm(direction / context.lengths)
    lengths = np.linspace(0.0, 2 * np.pi, 64) / unit
    march, given = context.equations[NONE.name].march.arcs[0], context.model.parameter_values[None]
    levels = march.along(context.model.potential, q + lengths[:, None] * direction, given).ravel()
    beyond = lengths[levels > context.target.energy]
    if not beyond.size:
        raise ConvergenceError("the ray does not meet the energy")
    above = float(beyond[0])
    root = brentq(
        lambda length: potential(context, q + length * direction) - context.target.energy,
        above - lengths[1], above, xtol=1e-14 * np.linalg.norm(direction) / unit,
    )  # fmt: skip
    return np.concatenate([q + root * direction, np.zeros(q.size)])


def _random_state(context: Context, random: np.random.Generator) -> np.ndarray:
    if context.region is not None:
        return context.region.drawn(random)
    q = random_position(context, random)
    return on_shell(context, q, context.lengths * random.normal(size=q.size))


def _random_rest(context: Context, random: np.random.Generator) -> np.ndarray:
    q = random_position(context, random, 0.7)
    return at_rest(context, q, context.lengths * random.normal(size=q.size))


def _mode_rest(context: Context, random: np.random.Generator) -> np.ndarray:
    """Rest on the energy shell along a combination of one to three normal modes."""
    n = context.shapes.shape[1]
    weights = np.where(random.uniform(size=n) < 0.6, random.normal(size=n), 0.0)
    if not weights.any():
        weights[random.integers(n)] = 1.0
    return at_rest(context, context.equilibrium, context.shapes @ weights)


def _centre(context: Context, random: np.random.Generator) -> np.ndarray:
    """Passing through the equilibrium configuration, where many reflection-symmetric orbits go through."""
    return on_shell(context, context.equilibrium, context.lengths * random.normal(size=context.equilibrium.size))


def _crossing(context: Context, random: np.random.Generator) -> np.ndarray:
    """Passing a configuration that the reflection keeps: every angle 0 or a half turn, as the energy allows."""
    n, angles = context.model.degrees_of_freedom, context.model.angular
    for _ in range(context.settings.attempts):
        q = np.where(angles, np.pi * random.integers(0, 2, n), 0.0) * (random.uniform() < 0.5)
        if potential(context, q) < context.target.energy:
            return on_shell(context, q, context.lengths * random.normal(size=n))
    return on_shell(context, context.equilibrium, context.lengths * random.normal(size=n))


def _fixed(context: Context, reversal: Involution, random: np.random.Generator) -> np.ndarray:
    """In the fixed set of a reversal: some coordinates at 0 (or a half turn), the others at rest."""
    if context.region is not None:
        return context.region.fixed(reversal, random)
    angles = context.model.angular
    signs = np.broadcast_to(reversal.signs, angles.size)
    for _ in range(context.settings.attempts):
        q = np.where(signs < 0, np.pi * angles * random.integers(0, 2, signs.size), random_position(context, random))
        if potential(context, q) < context.target.energy:
            return on_shell(context, q, context.lengths * np.where(signs < 0, random.normal(size=signs.size), 0.0))
    raise ConvergenceError("no position below the energy")


STRATEGIES: Mapping[str, tuple[str, Callable[[Context, np.random.Generator], np.ndarray]]] = {
    BRAKE.name: (BRAKE.name, _random_rest),
    "normal-modes": (QUARTER.name, _mode_rest),
    "random": (NONE.name, _random_state),
    "rest-symmetric": (QUARTER.name, _random_rest),
    REFLECTION.name: (REFLECTION.name, _random_state),
    "brake-modes": (BRAKE.name, _mode_rest),
    "recurrence": (NONE.name, _random_state),
    "centre": (REFLECTION.name, _centre),
    REVERSAL.name: (NONE.name, _crossing),
}
"""Name -> (symmetry imposed, proposal of a state on the energy shell)."""
TURNS = (
    "recurrence", BRAKE.name, "brake-modes", "recurrence", BRAKE.name, "rest-symmetric", "recurrence", BRAKE.name,
    REFLECTION.name, "random", "normal-modes", "recurrence", BRAKE.name, "brake-modes", "recurrence", BRAKE.name,
    "rest-symmetric", "recurrence", BRAKE.name, REFLECTION.name, "centre", "recurrence", BRAKE.name, "brake-modes",
    "recurrence", BRAKE.name, "rest-symmetric", "recurrence", BRAKE.name, REFLECTION.name, "random", REVERSAL.name,
)  # fmt: skip
"""Strategies in the order of their turns; those that led to few new orbits a second have fewer."""


def boundary_gap(context: Context, symmetry: str, states: np.ndarray) -> np.ndarray:
    """How far each of states (k x 2n) is from ending the horizon that began at the first of them."""
    n, angular, states = context.model.degrees_of_freedom, context.model.angular, states / context.sizes
    if context.region is not None:
        mirror = context.declared.get(symmetry)
        if mirror is not None and mirror.sense < 0:
            return np.asarray(np.abs(off_centre(mirror, states, angular)).max(axis=1))
        begin = states[0] if mirror is None else mirror.matrix(states.shape[1]) @ states[0]
        return np.asarray(np.abs(wrapped(states - begin, angular)).max(axis=1))
    rate = nonzero(np.sqrt(np.mean(states[:, n:] ** 2)))
    if symmetry == REVERSAL.name or symmetry in context.declared:
        known = (context.declared[symmetry],) if symmetry in context.declared else REVERSAL.maps
        scaled = states / np.repeat([1.0, rate], n)
        each = (np.abs(off_centre(mirror, scaled, angular)).max(axis=1) for mirror in known)
        return min(each, key=lambda gap: float(gap[0]))
    imposed = SYMMETRIES[symmetry]
    first, last = imposed.rows(n)
    gaps, units = states @ last.T, np.abs(last) @ np.concatenate([np.ones(n), np.full(n, rate)])
    if not imposed.reverses:
        gaps = wrapped(gaps + first @ states[0], angular)
    return np.asarray((np.abs(gaps) / np.where(units > 0, units, 1.0)).max(axis=1))


def simulated(context: Context, state: np.ndarray, duration: float) -> Course[tuple[np.ndarray, np.ndarray]]:
    """Times and states of a loose simulation."""
    samples = context.settings.samples_per_period * duration / context.target.periods[1]
    count = rounded(max(samples, duration / context.step))
    equations, mesh = context.equations["none"], uniform(1.0, 1, count)
    states = yield Marched(equations, equations.unknowns(state[None], duration, mesh), "states")
    return duration * mesh, states


def _return_time(context: Context, symmetry: str, state: np.ndarray, random: np.random.Generator) -> Course[float]:
    """A period at which the boundary condition nearly holds, drawn from the nearest few."""
    half = symmetry == REVERSAL.name or symmetry in context.declared
    fraction = 0.5 if half else SYMMETRIES[symmetry].fraction
    low, high = context.target.periods
    times, states = yield from simulated(context, state, fraction * high)
    gaps = boundary_gap(context, symmetry, states)
    minima = np.flatnonzero((gaps[1:-1] <= gaps[:-2]) & (gaps[1:-1] <= gaps[2:])) + 1
    minima = minima[times[minima] >= fraction * low]
    if not minima.size:
        raise ConvergenceError("no return in the range of periods")
    best = minima[np.argsort(gaps[minima])][: context.settings.choices]
    return float(times[random.choice(best)] / fraction)


def _recurrence(context: Context, state: np.ndarray, random: np.random.Generator) -> Course[tuple[np.ndarray, float]]:
    """The state and period of one of the closest returns of a longer simulation to itself."""
    low, high = context.target.periods
    times, states = yield from simulated(context, state, context.settings.recurrence_span * high)
    step, window = float(times[1]), int(np.ceil(high / times[1]))
    apart = max(1, window // context.settings.recurrence_beginnings)
    windows = sliding_window_view(np.asfortranarray(states), window, axis=0)[: len(times) - window : apart]
    gaps = return_gaps(context, windows)
    at, length = np.nonzero((gaps[:, 1:-1] <= gaps[:, :-2]) & (gaps[:, 1:-1] <= gaps[:, 2:]))
    length += 1
    kept = length >= np.ceil(low / step)
    at, length = at[kept], length[kept]
    if not at.size:
        raise ConvergenceError("no return in the range of periods")
    best = np.lexsort((length, at, gaps[at, length]))[: context.settings.choices]
    chosen = best[random.integers(len(best))]
    return states[at[chosen] * apart], float(length[chosen] * step)


def _strobed(
    context: Context, name: str, state: np.ndarray, random: np.random.Generator
) -> Course[tuple[np.ndarray, float]]:
    """A state and a number of the forcing's periods: of one of the closest returns of a simulation, or any."""
    cycles, beat, how = context.cycles, context.beat, context.settings
    if name != "recurrence":
        return state, float(beat * random.choice(cycles))
    count, each = int(how.recurrence_span * cycles[-1]), rounded(beat / context.step)
    equations = context.equations[NONE.name]
    w = equations.unknowns(state[None], count * beat, uniform(1.0, 1, count * each))
    strobed = (yield Marched(equations, w, "states"))[::each]
    at, length = (np.concatenate(part) for part in zip(
        *((np.arange(count + 1 - k), np.full(count + 1 - k, k)) for k in cycles), strict=True
    ))  # fmt: skip
    gaps = np.abs(wrapped(strobed[at + length] - strobed[at], context.model.angular) / context.units).max(axis=1)
    chosen = random.choice(np.argsort(gaps, kind="stable")[: how.choices])
    return strobed[at[chosen]], float(beat * length[chosen])


def return_gaps(context: Context, windows: np.ndarray) -> np.ndarray:
    """How far the states of each window (k x d x w) are from its first one (k x w), whatever symmetry they have."""
    n, angular, gaps = context.model.degrees_of_freedom, context.model.angular, np.zeros(windows.shape[::2])
    squares = np.einsum("kdw,kdw->kd", windows[:, n:], windows[:, n:]) @ context.sizes[n:] ** -2.0
    rates = np.sqrt(nonzero(squares / (n * windows.shape[2])))[:, None]
    for k, (part, size) in enumerate(zip(windows.swapaxes(0, 1), context.sizes, strict=True)):
        moved = part - part[:, :1]
        moved /= size if k < n else size * rates
        if k < n and angular[k]:
            moved -= 2 * np.pi * np.rint(moved / (2 * np.pi))
        np.maximum(gaps, np.abs(moved), out=gaps)
    return gaps
