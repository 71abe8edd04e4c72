"""Warm refinement: everything that depends on the equations alone is built once, guesses are then cheap.

refiner = Refiner(problem)                # equations, variations, compiled where possible
refined = refiner.refine(guess)           # milliseconds
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, lru_cache, partial

import numpy as np

from orbitfinder._runtime.arguments import checked
from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import UNSOLVED, ConvergenceError, CountError, InputError, IntegrationError, plural
from orbitfinder.integrate.cvodes import Flow
from orbitfinder.integrate.march import Varied, divided, rounded, uniform
from orbitfinder.integrate.rk8 import march, step_of
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.continued import make_curve
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.mesh import UNEVEN, fitted, sampled, stepped
from orbitfinder.loops.newton import Newton, NewtonSettings, Refined
from orbitfinder.loops.polish import STEPS_PER_PERIOD, tail_of
from orbitfinder.loops.problem import (
    Guess,
    Problem,
    at_forcing_period,
    check_guessed,
    clocked,
    displacement,
    guessed_nodes,
    loop_of,
    segments_for,
    without_choice,
)
from orbitfinder.loops.scales import Measures
from orbitfinder.loops.shooting import flow_of
from orbitfinder.loops.symmetry import NONE
from orbitfinder.loops.wide import wide
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import Solved, largest
from orbitfinder.mechanics.scales import lengths
from orbitfinder.mechanics.scales import units_of as measured_in
from orbitfinder.orbits import closure
from orbitfinder.orbits.certify import certified
from orbitfinder.orbits.evidence import MOST, in_extents, multiplied
from orbitfinder.orbits.hybrid import carried, first_unknowns, hybrid_orbit
from orbitfinder.orbits.measure import (
    RESOLVED,
    SAMPLES,
    action,
    composed,
    marched,
    sampled_period,
    whole_period,
)
from orbitfinder.records.orbit import Orbit

PART = 0.5
"""Share of a smooth period's steps that a hybrid one starts with: between its events a motion is a part of a swing"""
STANDSTILL = 1e-6
"""Largest rate at the start times the period, below which the motion is none."""

TOGETHER = 8
"""Segments come in multiples of this where so many are marched side by side"""

NEAR = 1e-8
"""Share of the motion by which an integration over the whole period may miss its end"""
ROUGH, FINE, ROUNDS = NewtonSettings(converged=1e-7), NewtonSettings(converged=1e-13), 8
"""How a single segment is closed, on so many meshes at most, and on the last of twice as many steps"""
FEWER, LOST = 2.0**-11, 1e-9
"""Round-off of long double, of that of doubles; share of a state-transition matrix that may be round-off"""
GROWN = 1e8
"""Growth of errors beyond which round-off of double precision is more than what a rough correction may be"""
NODES = 8
"""Nodes of a period in the record of an orbit on a mesh of its own"""

MOST_SAMPLES = 6
"""Times that the samples of a period are doubled, at most, for the action"""


class Refiner(Shown):
    """Refines guesses of one Problem in milliseconds each, at its pins or at other values of them.

    Building it derives and, with a C compiler, compiles (about a second, once; later runs load the library). `refine`
    gives state and period, `orbit` an Orbit with certificate.

    Args:
        problem: one that its pins make square.
        settings: steps, segments, iterations of Newton's method.

    Raises:
        CountError: where the pins do not make it square.
        InputError: for what it cannot refine, such as controls.

    Examples:
        >>> refiner = of.Refiner(problem)
        >>> refined = refiner.refine(guess, of.pin(energy=-17.9))
        >>> round(refined.period, 9), refiner.orbit(refined).certificate.passed
        (1.132560901, True)

    See Also:
        `of.sweep` for many values at once.
    """

    __repr__ = brief("problem", "segments")

    @checked
    def __init__(self, problem: Problem, settings: NewtonSettings | None = None) -> None:
        _check_square(problem)
        self._alone = threading.Lock()  # the marches have one work space
        self.settings = chosen = settings or NewtonSettings()
        self.problem = problem = at_forcing_period(problem)
        hybrid = not problem.model.smooth
        self.flow = None if hybrid else flow_of(problem)
        self.equations = Equations(problem.model, problem.boundary, problem.free)
        self.equations.march.build()
        fraction = problem.boundary.fraction * (PART if hybrid else 1.0)
        self._whole_steps = whole = max(4, int(np.ceil(chosen.steps_per_period * fraction)))
        self._fewest = self.segments = problem.segments or (1 if hybrid else self._segments(whole))
        if not (problem.segments or hybrid) and self.equations.march.arcs[0].together:
            self.segments = -(-self._fewest // TOGETHER) * TOGETHER
        self._uneven = self.flow is not None and uneven(problem, self.flow)
        self._first = self._begun(problem.guess) if hybrid else None

    def refine(self, guess: Guess | None = None, pin: Sequence[Pin] | None = None, simulated: bool = False) -> Refined:
        """The orbit near a guess (default: the problem's) at the pins (default: the problem's). A physical parameter
        that is freed and pinned is changed by its pin. Of a hybrid system the arcs of a guess last as long as those of
        the problem's own where that converges, else, or where `simulated` is asked for, as a simulation says.

        Raises `ConvergenceError` when Newton's method does not converge from there (find_orbit reaches farther),
        `IntegrationError` when the motion cannot be integrated. Threads that share a Refiner take turns.
        """
        with self._alone:
            return self._refined(guess, pin, simulated)

    def _refined(self, guess: Guess | None, pin: Sequence[Pin] | None, simulated: bool) -> Refined:
        pins, given = _pins(self.problem, pin), _checked(guess or self.problem.guess, self.problem, self.equations.free)
        if self._first is None:
            if self._uneven:
                return self._closed(given, pins)
            if self._fewest < self.segments:  # more may lead astray
                with suppress(*UNSOLVED):
                    return self._solved(self._start(given, pins, self.segments), pins)
            return self._solved(self._start(given, pins, self._fewest), pins)
        if given is self.problem.guess:
            return self._solved(self._first, pins)
        if not simulated and given.times is None:
            with suppress(*UNSOLVED):
                return self._solved(carried(self.equations, self._first, given), pins)
        return self._solved(self._begun(given), pins)

    def closely(self) -> tuple[Orbit, Model]:
        """`measured` of the guess itself, closed on a mesh that fits its motion."""
        self._uneven = True
        return self.measured(self.refine())

    def _begun(self, guess: Guess) -> Unknowns:
        """The unknowns of a hybrid motion, simulated from a guess."""
        return first_unknowns(self.equations, guess, self.segments, self._steps(self.segments))

    def _steps(self, segments: int) -> int:
        """Steps in each of so many segments of an arc."""
        return max(4, -(-self._whole_steps // (self.equations.links.count * segments)))

    def _solved(self, w: Unknowns, pins: Sequence[Pin]) -> Refined:
        scales = measured_in(self.problem.model, w.nodes, w.period)
        newton = self._newton(w, path := self.equations.varied(w), pins, self.settings)
        w, residual = newton.solve(w, path)
        if not residual < self.settings.converged:
            raise ConvergenceError(
                f"warm refinement stalled at a residual of {residual:.2g}; the orbit is too unstable for "
                f"{plural(len(w.nodes), 'segment')}, give the problem more"
            )
        return self._checked(w, residual, newton, pins, np.asarray(scales or 1.0))

    def _checked(self, w: Unknowns, residual: float, newton: Newton, pins: Sequence[Pin], units: np.ndarray) -> Refined:
        """What the iteration has come to, unless that is an equilibrium."""
        moved = float((np.abs(w.nodes[0] - w.nodes[-1]) / units).max())
        rates = self.equations.march.rates(w.nodes, w.tail, w.period * w.edges[:-1]) / units
        if moved < STANDSTILL and np.abs(rates).max() * w.period < STANDSTILL:
            raise ConvergenceError("warm refinement ended at an equilibrium; start farther from it, or pin the energy")
        told = {one.name: one.value for one in pins}  # a pinned parameter is that, not one to round-off
        known = [told.get(name, one) for name, one in zip(self.equations.free, w.free, strict=True)]
        turns = self.equations.symmetry.turns(newton.loop.constant)
        return Refined(
            w.nodes[0], w.period, w.nodes, w.unfolding, np.array(known, float), turns, residual, w.steps,
            newton.marches, newton.jacobians + 1, w.mesh if self._uneven else None,
        )  # fmt: skip

    def orbit(self, refined: Refined, with_certificate: bool = True) -> Orbit:
        """The Orbit of a refined one, measured and certified (hundredths of a second); freed parameters, at which it
        was found, become those of its system."""
        orbit, model = self.measured(refined)
        return certified(orbit, model) if with_certificate else orbit

    def measured(self, refined: Refined) -> tuple[Orbit, Model]:
        """The Orbit (without certificate) of a refined one, and its Model."""
        with self._alone:
            return self._measured(refined)

    def _measured(self, refined: Refined) -> tuple[Orbit, Model]:
        values = dict(zip(self.problem.free, refined.free.tolist(), strict=False))
        turns, model = tuple(int(k) for k in refined.turns), with_parameters(self.problem.model, values)
        if self.flow is None:
            return hybrid_orbit(replace(without_choice(self.problem), model=model), refined), model
        guess = Guess(refined.state, refined.period)
        problem = replace(without_choice(self.problem), model=model, guess=guess, winding=turns)
        if refined.mesh is not None:
            return self._measured_unevenly(problem, refined, refined.mesh), model
        mesh = uniform(problem.boundary.fraction, len(refined.nodes), refined.steps)
        w = Unknowns(refined.nodes, refined.period, refined.unfolding, refined.free, mesh)
        flow, march = replace(self.flow, model=model), self._whole.march
        for samples in SAMPLES * 2 ** np.arange(MOST_SAMPLES):
            whole = whole_period(problem, flow, march, w, int(samples))
            times, states = whole[1:]
            found = action(model, times, states)
            if abs(found - action(model, times[::2], states[::2])) <= RESOLVED * abs(found):
                break
        return marched(problem, march, w, whole, found, flow.units), model

    def _measured_unevenly(self, problem: Problem, refined: Refined, mesh: np.ndarray) -> Orbit:
        """The Orbit on the mesh that fits it."""
        part, equations = self.equations, Equations(self.problem.model, NONE, self.problem.free, action=True)
        w = Unknowns(refined.nodes, refined.period, refined.unfolding, refined.free, mesh)
        w = w.on(divided(mesh, 2))  # errors of Phi grow and shrink again by more than those of the state
        states = part.march.states(w.nodes, w.mesh, w.tail)
        mesh, states = part.symmetry.whole(w.mesh, states, displacement(problem, w, states[-1]))
        unfolding = np.zeros(equations.march.unfolding)
        w = Unknowns(states[: -1 : w.steps], w.period, unfolding, w.free, mesh)
        path = through = equations.varied(replace(w, nodes=w.nodes[:1]), states=True)
        end = through.ends[0]
        if (np.abs(end - states[-1]) / nonzero(np.ptp(states, axis=0))).max() > NEAR:
            path = equations.varied(w)
        else:
            states = through.states
        moments = uniform(1.0, NODES, rounded(SAMPLES / NODES))
        samples, integral = sampled(equations.march, w, states, moments), path.integral
        transitions, size = path.transitions, equations.size
        units = nonzero(np.ptp(states, axis=0))
        alone = replace(w, nodes=w.nodes[:1], unfolding=np.zeros(0))
        for quadruple in (False, True):
            by = wide(equations, units, quadruple, abs(integral) or 1.0) if size <= MOST else None
            if by is None:
                break
            with suppress(IntegrationError):
                before, sharp, samples = multiplied(transitions), by.varied(alone), by.along(alone, moments)
                end, integral, transitions = sharp.ends[0], sharp.integral, sharp.transitions
                lost, kept = (largest(in_extents(each, units)[0]) for each in (transitions - before, transitions))
                if lost * FEWER < LOST * kept:
                    break
        equal = Unknowns(samples[: -1 : (moments.size - 1) // NODES], w.period, unfolding, w.free, moments)
        whole = sampled_period(problem, equal, samples)
        assert self.flow is not None
        place = replace(w, unfolding=refined.unfolding)
        return composed(problem, place, whole, integral, transitions, end, self.flow.units)

    @cached_property
    def _mesh(self) -> Callable[[int, int], np.ndarray]:
        """That of so many segments of so many steps, made once."""
        return lru_cache(partial(uniform, self.equations.symmetry.fraction))

    @cached_property
    def _whole(self) -> Equations:
        """The equations over whole periods."""
        plain = not self.problem.boundary.maps
        return self.equations if plain else Equations(self.problem.model, NONE, self.problem.free)

    def _segments(self, steps: int) -> int:
        """As many segments as the guess's motion needs."""
        guess, most = self.problem.guess, self.settings.most_segments
        mesh = uniform(self.problem.boundary.fraction, 1, steps)
        w = self.equations.unknowns(guess.start[None], guess.period, mesh)
        try:
            matrix, clock = self.equations.varied(w).transitions[0], guess.period / (2 * np.pi)
            units = clocked(self.problem.model, clock, w.nodes[0])
            return segments_for(matrix, units, self.settings.growth_per_segment, (1, most))
        except IntegrationError:
            return most

    def _closed(self, guess: Guess, pins: Sequence[Pin]) -> Refined:
        """The orbit near a motion with close encounters, on a mesh that fits it: in a single segment, since between
        encounters errors grow and shrink again and nodes there make equations less linear; in several where errors do
        not shrink."""
        p, model = self.equations, self.problem.model
        w = self._start(guess, pins, 1 if guess.states is None else len(guess.states) - 1)
        units = np.asarray(measured_in(model, w.nodes, w.period) or np.ones(p.size))
        w = stepped(p, w, units)
        if len(w.nodes) == 1:
            first = w
            for _ in range(ROUNDS):  # passages move, and with them where steps are short
                solved = self._newton(w, p.varied(w), pins, ROUGH).near(w)
                w = stepped(p, solved.w, units)
                if solved.converged:
                    break
            else:
                w = first
            w = w.on(divided(w.mesh, 2))
            newton = self._newton(w, p.varied(w), pins, FINE)
            closed = self._sharpened(w, newton, units)
            if closed.converged or largest(closed.rows) < self.settings.converged:
                return self._checked(closed.w, largest(closed.rows), newton, pins, units)
            if not solved.converged:
                steps = replace(w, nodes=p.march.states(w.nodes, w.mesh, w.tail)[:-1])
                grown = closure.carried(
                    in_extents([*p.varied(steps).transitions[..., : units.size]], units), np.ones(units.size)
                )[1]
                lost = f"errors made on the way grow {grown:.1g} times, so double precision has too few digits"
                raise ConvergenceError(
                    "damped Newton steps lead nowhere from this guess (a correction of "
                    f"{closed.size:.2g} of the motion is left); " + (lost if grown > GROWN else "start nearer")
                )
            w = closed.w
        path = p.varied(w, states=True)
        constant = displacement(self.problem, w, path.ends[-1])
        whole = p.symmetry.whole(w.mesh, path.states, constant)[1]
        return self._solved(fitted(make_curve(p, constant, w, (), lengths(model, whole), whole), w), pins)

    def _sharpened(self, w: Unknowns, newton: Newton, units: np.ndarray) -> Solved[Unknowns]:
        """Where Newton's steps lead in double precision and, where it can be had, in long double; and in quadruple
        precision where round-off of long double is still seen: some 2000th of what that of doubles had moved."""
        solved = newton.near(w)
        for quadruple in (False, True):
            by = wide(self.equations, units, quadruple) if w.nodes[0].size <= MOST else None
            if by is None:
                break
            with suppress(IntegrationError):
                better = newton.near(solved.w if solved.converged else w, by)
                moved = largest((better.w.vector - solved.w.vector) / newton.measures.columns)
                if better.converged or not solved.converged:
                    solved = better
                if better.converged and moved * FEWER < newton.settings.converged:
                    break
        return solved

    def _newton(self, w: Unknowns, path: Varied, pins: Sequence[Pin], settings: NewtonSettings) -> Newton:
        loop = loop_of(self.problem, self.equations, w, self.equations.links.passed(w, path.ends)[0][-1], pins)
        scales = measured_in(self.problem.model, w.nodes, w.period)
        return Newton(loop, settings, Measures.rounded(loop, w, scales))

    def _start(self, guess: Guess, pins: Sequence[Pin], segments: int) -> Unknowns:
        """The unknowns of a guess: sampled from its trajectory, else simulated from its state.

        Freed parameters start where they are pinned, else where the guess says, else at the model's own values.
        """
        own = zip(self.problem.free, self.equations.numbers, strict=True)
        known = {**dict(own), **guess.free, **{one.name: one.value for one in pins}}
        free = np.array([known[name] for name in self.problem.free], float)
        state, steps = guess.start, self._steps(segments)
        mesh = self._mesh(segments, steps)
        if guess.trajectory is not None:
            nodes = guessed_nodes(guess, mesh[:-1:steps])
            return self.equations.unknowns(nodes, guess.period, mesh, free)
        w = self.equations.unknowns(state[None], guess.period, mesh, free)
        if segments == 1:
            return w
        each = steps if segments == self._fewest else -(-steps // 2)  # the guess is off by more than longer steps are
        nodes = self.equations.march.states(w.nodes, self._mesh(segments, each), w.tail)[:-1:each]
        return Unknowns(nodes, w.period, w.unfolding, free, mesh)


def uneven(problem: Problem, flow: Flow) -> bool:
    """Whether equal steps, some hundred, lose the motion of a guess: past close encounters, along bursts."""
    horizon, tail = problem.boundary.fraction * problem.guess.period, tail_of(flow)
    steps = max(4, int(np.ceil(STEPS_PER_PERIOD * problem.boundary.fraction)))
    try:
        states = march(flow.field, problem.guess.start, horizon, steps, tail)
    except IntegrationError:
        return True
    clock = np.linspace(0.0, horizon, steps + 1)[:-1]
    given = np.tile(np.concatenate([[horizon / steps], tail])[:, None], (1, steps))
    errors = np.abs(step_of(flow.field, True).map(steps)(np.vstack([clock, states[:-1].T]), given).full()).max(axis=1)
    moved = np.ptp(states, axis=0)
    return not np.all(errors <= UNEVEN * nonzero(np.maximum(moved, 1e-2 * moved.max())))


def _pins(problem: Problem, pin: Sequence[Pin] | None) -> tuple[Pin, ...]:
    """The pins in the problem's order, at other values where they are given."""
    given = {one.name: one for one in (problem.pin if pin is None else pin)}
    known = [one.name for one in problem.pin]
    if set(known) != given.keys():
        raise InputError(
            f"pin: this refiner was built for pins of {', '.join(known) or 'nothing'}, got "
            f"{', '.join(given) or 'nothing'}; build another one"
        )
    return tuple(given[name] for name in known)


def _check_square(problem: Problem) -> None:
    """Only square systems of pins can be refined by Newton's method alone."""
    problem.check_count()
    others = {"constraints": problem.constraints, "phase_condition": problem.phase_condition, "bounds": problem.bounds}
    for name, value in others.items():
        if value:
            raise InputError(f"{name}: warm refinement knows pins only; use find_orbit")
    if problem.model.constraint is not None and problem.boundary.maps:
        raise InputError("symmetry: brake orbits under constraints are not refined warm; use find_orbit")
    count = problem.count()
    if count.freedom:
        raise CountError(f"pin: {count} leave {count.freedom} to choose; warm refinement needs as many pins")


def _checked(guess: Guess, problem: Problem, free: tuple[str, ...]) -> Guess:
    """The guess, whose values are those of parameters that are free, durations of arcs among them."""
    size = len(problem.model.state_names)
    check_guessed(guess, free)
    state = guess.start
    if state.shape != (size,) or not np.all(np.isfinite(state)):
        raise InputError(f"guess.state: need {size} finite numbers, got {state.tolist()}")
    if not (np.isfinite(guess.period) and guess.period > 0):
        raise InputError(f"guess.period: must be positive and finite, got {guess.period}; give a period in s")
    return guess
