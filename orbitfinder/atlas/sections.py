"""Where searches of hybrid systems start: on the section right after the event that ends their cycle.

A motion from there is simulated for some cycles; where it is after one of them and after up to `cycles` more is the
start of an orbit through the events between. On the section a time is no unknown: close returns there are those of a
map, whose fixed points Newton's method finds arc by arc.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from orbitfinder._runtime.sizes import LEAST
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError, closest
from orbitfinder.integrate.automaton import Automaton
from orbitfinder.integrate.dop853 import ReferenceSettings
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.newton import Refined
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.hybrid import section_of, with_cycle
from orbitfinder.mechanics.model import Model, wrapped
from orbitfinder.mechanics.newton import Settings, closed, equilibrium
from orbitfinder.orbits.refine import Refiner
from orbitfinder.records.orbit import Orbit

TURNS = ("recurrence", "random", "recurrence", "random", "settled")
"""Strategies in the order of their turns"""
WALKED = {"random": 0, "recurrence": 10, "settled": 60}
"""Cycles that a start of each strategy goes through before those of its orbit"""
DRAWN = 40
"""States that are drawn for one on the section, and on which the section is measured"""
DRAWING = Settings(floor=0.0, round_off=0.0, converged=np.inf, most_evaluations=12, cutoff=1e-10)
ONTO = Settings(floor=1e-12, round_off=1e-12, converged=1e-12, most_evaluations=12, cutoff=1e-10)
"""Of steps near to a state that is wanted, and then onto the section, whose equations are relative"""


@dataclass(frozen=True)
class Pass:
    """A state (d) on the section, its time (s), and the events from the one before it to it."""

    time: float
    state: np.ndarray
    events: tuple[str, ...] = ()


@dataclass(frozen=True)
class Return:
    """A motion from one pass, the `begin`-th, to a later one: the state, the time (s), all events, how near it comes
    back."""

    state: np.ndarray
    period: float
    course: tuple[str, ...]
    cycles: int
    begin: int
    gap: float


@dataclass(frozen=True, eq=False)
class EventSection:
    """States right after the last transition of a hybrid Model's cycle, components (d) between `low` and `high` where
    these are finite; orbits of at most `cycles` passes, of periods (s), at the value `level` of what is conserved."""

    model: Model
    low: np.ndarray
    high: np.ndarray
    cycles: int
    periods: tuple[float, float]
    level: float
    lengths: np.ndarray
    _refiners: dict[tuple[str, ...], Refiner] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, model: Model, ranges: Mapping[str, tuple[float, float]], cycles: int, periods: tuple[float, float],
        level: float,
    ) -> EventSection:  # fmt: skip
        """The section of a model. Raises `InputError` for ranges that say nothing, or that no event leads into."""
        _check(model, ranges, cycles)
        ends = np.full((2, len(model.state_names)), np.nan)
        for name, pair in ranges.items():
            ends[:, model.state_index(name)] = pair
        section = cls(model, ends[0], ends[1], cycles, periods, level, np.ones(len(model.state_names)))
        random = np.random.default_rng(0)
        try:
            states = np.array([section.drawn(random) for _ in range(DRAWN)])
        except ConvergenceError as error:
            raise InputError(
                f"search.section: no state after {model.cycle[-1]!r} is found with components in these ranges"
                + (f" and {model.invariants[0].name} = {level:.9g}" if model.invariants else "")
                + "; widen them"
            ) from error
        return replace(section, lengths=np.where(np.ptp(states, axis=0) > 0, np.ptp(states, axis=0), 1.0))

    @property
    def pins(self) -> tuple[Pin, ...]:
        """What its orbits are pinned by."""
        return tuple(Pin(invariant.name, self.level) for invariant in self.model.invariants)

    @cached_property
    def _automaton(self) -> Automaton:
        return Automaton(self.model, ReferenceSettings(1e-6, 1e-8))

    @cached_property
    def _after(self) -> Buffered:
        return Buffered(section_of(self.model, self.model.arcs[-1][1]))

    def drawn(self, random: np.random.Generator) -> np.ndarray:
        """A state that the reset makes. Raises `ConvergenceError`."""
        last = self.model.arcs[-1][1]
        for _ in range(DRAWN):
            wanted = random.uniform(np.nan_to_num(self.low), np.nan_to_num(self.high))
            before = self._met(wanted, random)
            if before is None or self._automaton.rate(last, before) * last.direction <= 0:
                continue
            if last.allowed is not None and self._automaton.value(last.allowed, before)[0] <= 0:
                continue
            after = self._automaton.value(last.reset, before)
            if np.all((after >= self.low) & (after <= self.high) | np.isnan(self.low)):
                return after
        raise ConvergenceError("no state on the section")

    def _met(self, wanted: np.ndarray, random: np.random.Generator) -> np.ndarray | None:
        """A state before the event from which the reset makes nearly the one wanted (d), its guard and what is
        conserved met to round-off; None where there is none near."""
        asked, p = ~np.isnan(self.low), self.model.parameter_values
        width = np.where(asked, np.nan_to_num(self.high - self.low), 1.0)
        x = wanted + np.where(asked, 0.0, random.normal(size=width.size))
        level = np.append(0.0, np.full(len(self.model.invariants), self.level))

        def phi(x: np.ndarray, near: bool) -> tuple[np.ndarray, np.ndarray]:
            after, held, by, slopes = (part.T for part in self._after(x, p))
            sizes = np.maximum(np.abs(slopes * width).max(axis=1), LEAST if near else np.abs(level))
            miss, slopes = (held.ravel() - level) / sizes, slopes / sizes[:, None]
            if not near:
                return miss, slopes
            away, rows = (after.ravel() - wanted) / width, by / width[:, None]
            return np.append(away[asked], miss), np.vstack([rows[asked], slopes])

        with np.errstate(all="ignore"):  # near what is wanted, then onto the section the shortest way
            x = equilibrium(lambda x: phi(x, True), x, width, DRAWING).w
            solution = closed(lambda x: phi(x, False), x, units=width, size=1.0, settings=ONTO)
        return solution.w if solution.converged else None

    def passes(self, state: np.ndarray, count: int) -> Iterator[Pass]:
        """The state and what follows it on the section, `count` passes at most, as far as the motion goes."""
        hybrid = self.model.hybrid
        by, mode, x, t = hybrid.cycle[-1], hybrid.first.name, state, 0.0
        yield Pass(t, x)
        for _ in range(count):
            events = list[str]()
            while not (events and by == hybrid.cycle[-1] and mode == hybrid.first.name):
                try:
                    arc = next(self._automaton.arcs(x, mode, self.periods[1], 1, by))
                except IntegrationError:
                    return
                if arc.ended_by is None or len(events) >= 8 * len(hybrid.cycle):
                    return
                by, x, t = arc.ended_by, arc.after, t + arc.duration
                mode = hybrid.transition(by).target
                events.append(by)
            yield Pass(t, x, tuple(events))

    def returns(self, strategy: str, random: np.random.Generator) -> Return:
        """A return near which an orbit is looked for. Raises `ConvergenceError`."""
        count, others = int(random.integers(self.cycles)) + 1, list[Return]()
        for _ in range(12):  # most may fall
            walked = list(self.passes(self.drawn(random), WALKED[strategy] + self.cycles))
            returns = self._nearest(walked, max(0, len(walked) - 4 - self.cycles) if strategy == "settled" else 0)
            if strategy == "random":
                returns = [back for back in returns if back.begin == 0]
            if returns and strategy == "settled":
                return returns[0]
            if best := [back for back in returns if back.cycles == count][:4]:
                return best[random.integers(len(best))]
            others += returns[:1]
        if others:
            return others[random.integers(len(others))]
        raise ConvergenceError("no return in the range of periods")

    def _nearest(self, walked: list[Pass], first: int) -> list[Return]:
        """Returns in the range of periods, the nearest first, but for those that are as near after fewer cycles."""
        returns, (low, high) = list[Return](), self.periods
        for begin in range(first, len(walked) - 1):
            each = [self._between(walked[begin : begin + count + 1], begin)
                    for count in range(1, min(self.cycles, len(walked) - 1 - begin) + 1)]  # fmt: skip
            for back in each:
                shorter = [other.gap for other in each[: back.cycles - 1] if back.cycles % other.cycles == 0]
                if low <= back.period <= high and back.gap < min(shorter, default=np.inf):
                    returns.append(back)
        return sorted(returns, key=lambda back: back.gap)

    def _between(self, walked: list[Pass], begin: int) -> Return:
        first, last = walked[0], walked[-1]
        course = tuple(name for passing in walked[1:] for name in passing.events)
        gap = np.abs(wrapped(last.state - first.state, self.model.angular) / self.lengths)
        near = float(gap[~np.isnan(self.low)].max())
        return Return(first.state, last.time - first.time, course, len(walked) - 1, begin, near)

    def orbit(self, state: np.ndarray, period: float, course: tuple[str, ...]) -> Orbit:
        """The orbit near a guess, over its minimal cycle, without certificate. Raises `ConvergenceError`."""
        refined = self._refined(state, period, course)
        for count, nodes in self._parts(course, refined):
            whole = np.vstack([nodes, nodes[:1]])
            steps = [np.abs(wrapped(after - before, self.model.angular)).max() for before, after in pairwise(whole)]
            if max(steps) < 1e-6 * max(1.0, float(np.abs(nodes).max())):  # nearer returns are the same
                course = course[: len(course) // count]
                refined = self._refined(refined.state, refined.period / count, course)
                break
        low, high = self.periods
        if not low <= refined.period <= high:
            raise ConvergenceError("period outside the range")
        try:
            orbit, _ = self._refiners[course].measured(refined)
        except ConvergenceError as error:
            raise ConvergenceError("simulated from there, it takes another course") from error
        return replace(orbit, system={**orbit.system, "cycle": list(course)})

    def model_of(self, orbit: Orbit) -> Model:
        """The Model whose cycle is that of an orbit found."""
        return self._refiners[tuple(orbit.system["cycle"])].problem.model

    def _parts(self, course: tuple[str, ...], refined: Refined) -> Iterator[tuple[int, np.ndarray]]:
        """How often a course may repeat itself, most often first, and the states (k x d) where it would."""
        for count in range(len(course), 1, -1):
            size, over = divmod(len(course), count)
            if not over and course == course[:size] * count:
                yield count, refined.nodes[:: len(refined.nodes) // count]

    def _refined(self, state: np.ndarray, period: float, course: tuple[str, ...]) -> Refined:
        guess = Guess(state, period)
        if course not in self._refiners:
            problem = Problem(with_cycle(self.model, course), guess, pin=self.pins)
            self._refiners[course] = Refiner(problem)
        try:
            return self._refiners[course].refine(guess, simulated=True)
        except ConvergenceError as error:
            raise ConvergenceError("Newton's method does not converge") from error


def _check(model: Model, ranges: Mapping[str, tuple[float, float]], cycles: int) -> None:
    """`InputError` for what a section cannot be made of."""
    if not model.cycle:
        raise InputError(
            "search: give the system a cycle; its last event is where orbits are looked for, and their own courses may "
            "be others"
        )
    if len(model.invariants) > 1:
        several = ", ".join(invariant.name for invariant in model.invariants)
        raise InputError(f"search: of machines that conserve one quantity at most, this one {several}; use find")
    names, last = model.state_names, str(model.cycle[-1])
    if not ranges:
        raise InputError(
            f"search.section: missing; give ranges of what the state is right after {last!r}, such as "
            f"{{ {names[-1]} = [-1.0, 1.0] }}, of {', '.join(names)}"
        )
    for name, pair in ranges.items():
        if name not in names:
            raise InputError(f"search.section: unknown {name!r}{closest(name, names)}; use {', '.join(names)}")
        if not (np.all(np.isfinite(pair)) and pair[0] < pair[1]):
            raise InputError(f"search.section.{name}: must be [smallest, largest], finite, got {list(pair)}")
    if not 1 <= cycles <= 64:
        raise InputError(f"search.cycles: must be between 1 and 64, got {cycles}; give how many cycles an orbit has")
