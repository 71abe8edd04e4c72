"""Hybrid systems simulated: DOP853 between events, guards watched on its dense output, events located to round-off.

It shares nothing with the march that finds orbits: there an arc's end is an unknown, here the guard is watched.
Source of the method: L. Shampine, S. Thompson, "Event location for ordinary differential equations", Computers and
Mathematics with Applications 39 (2000) 43-54.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

from orbitfinder._runtime import limit
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.dop853 import SECOND, TIGHTEST, ReferenceSettings, integrate, integrate_in
from orbitfinder.integrate.equations import accelerations, with_variations
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.integrate.field import VectorField, scaled, vector_field
from orbitfinder.mechanics.hybrid import Transition, gradient
from orbitfinder.mechanics.model import Model, wrapped
from orbitfinder.mechanics.scales import units_of


@dataclass(frozen=True)
class AutomatonSettings:
    """How closely guards are watched, and what is one event."""

    looks: int = 8
    """Times at which guards are looked at within a step, at least"""
    most_steps: int = 20_000
    zeno: int = 20
    """Arcs in a row of which each is shorter than the one before, that make a Zeno motion where they end in nothing"""
    nothing: float = 1e-5
    """Share of the whole time that the last arc of a Zeno motion takes at most"""
    near: int = 64
    """Units in the last place of the clock below which a step is a line: its error is their square"""
    together: float = 1e-9
    """Share of an arc within which two events are simultaneous"""
    back: float = 0.5
    """Share of the motion's extents, and of the period, within which a motion is back near its start"""
    round_off: float = 1e-12
    """A guard this small, relative to how it changes along the arc, is 0"""


WATCHED = AutomatonSettings()


DEEPEST, FINE = 8, 1e-4
"""Halvings between two looks until a cubic is this near to a guard's value, relative to its range"""
MOST_EVENTS = 10_000


Height = Callable[[np.ndarray], float]
"""x -> how far a guard is from being crossed, or its rate"""


@dataclass(frozen=True)
class Arc:
    """A smooth piece of a motion: times (k, s) and states (k x d), the last before the event `ended_by` (None: the end
    of the time), x+ `after` it; `slope` the guard's rate there relative to (its range / the arc's duration)."""

    mode: str
    times: np.ndarray
    states: np.ndarray
    ended_by: str | None
    after: np.ndarray
    slope: float = 0.0
    margins: tuple[tuple[str, float], ...] = ()
    """what must hold in the mode, and its least value, relative to its range, along the arc"""
    impulse: float | None = None
    lost: float | None = None
    decided: float = np.inf
    """least |allowed| at a crossing, counted or ignored, relative to its range along the arc"""

    @property
    def duration(self) -> float:
        """s"""
        return float(self.times[-1] - self.times[0])


class Automaton:
    """The simulator of one hybrid Model at its parameters' values, in steps of at most `longest` s.

    States are integrated in `units` (d), () is 1.
    """

    def __init__(
        self, model: Model, settings: ReferenceSettings = TIGHTEST, longest: float = np.inf, units: Sequence[float] = ()
    ) -> None:
        assert not model.smooth
        self.units = np.asarray(units) if len(units) else np.ones(len(model.state_names))
        self.model, self.hybrid, self.settings, self.longest = model, model.hybrid, settings, longest
        self._fields: dict[str, VectorField] = {}
        self._buffered: dict[int, Buffered] = {}
        self._asked: list[tuple[Transition, float]] = []
        self._slopes: dict[int, ca.Function] = {}

    def field(self, mode: str) -> VectorField:
        """dx/dt (t, x) in a mode."""
        if mode not in self._fields:
            self._fields[mode] = vector_field(accelerations(self.hybrid.mode(mode).model))
        return self._fields[mode]

    @classmethod
    def about(
        cls, model: Model, state: np.ndarray, period: float, settings: ReferenceSettings = TIGHTEST,
        longest: float = np.inf,
    ) -> Automaton:  # fmt: skip
        """The one in the units of a motion from a state that takes about this time (s)."""
        units = units_of(model, np.asarray(state, float)[None], period) if np.isfinite(period) else ()
        return cls(model, settings, longest, units)

    def path(
        self, mode: str, x: np.ndarray, times: np.ndarray, settings: ReferenceSettings | None = None,
        units: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """States (k x d) at times (k) from x in a mode, whatever its guards say."""
        chosen, units = settings or self.settings, self.units if units is None else units
        if np.all(units == 1.0):
            return integrate(self.field(mode), x, times, chosen)
        return integrate_in(units, self.field(mode), x, times, chosen)

    def varied(self, mode: str) -> VectorField:
        """The field of (x, vec Y, S) in a mode: the motion, its variations, its action."""
        return vector_field(with_variations(self.hybrid.mode(mode).model))

    def value(self, function: ca.Function, x: np.ndarray) -> np.ndarray:
        """A guard, a reset or a condition at one state."""
        if id(function) not in self._buffered:
            self._buffered[id(function)] = Buffered(function)
        return self._buffered[id(function)](x, self.model.parameter_values)[0].ravel()

    def arcs(
        self, state: np.ndarray, mode: str, duration: float = np.inf, events: int = MOST_EVENTS, by: str = ""
    ) -> Iterator[Arc]:
        """The motion from a state in a mode, arc by arc, for a time (s) or a number of events; `by` what begins it.

        Raises `IntegrationError`, also where events accumulate (Zeno), coincide or never end.
        """
        until, x, t, lengths = duration, np.asarray(state, float), 0.0, list[float]()
        for _ in range(events):
            arc = self._arc(x, t, until, mode, by)
            yield arc
            if arc.ended_by is None:
                return
            lengths.append(arc.duration)
            last, nothing = lengths[-WATCHED.zeno :], WATCHED.nothing * sum(lengths)
            if len(last) == WATCHED.zeno and all(b < a for a, b in pairwise(last)) and last[-1] < nothing:
                raise IntegrationError(
                    f"Zeno: events {arc.ended_by} follow each other ever faster and accumulate at t = "
                    f"{arc.times[-1]:.6g} s; give the model a mode in which contact lasts",
                    time=float(arc.times[-1]), state=arc.after,
                )  # fmt: skip
            by = arc.ended_by
            x, t, mode = arc.after, float(arc.times[-1]), self.hybrid.transition(arc.ended_by).target

    @np.errstate(over="ignore", invalid="ignore")
    def _arc(self, x: np.ndarray, t: float, until: float, mode: str, by: str) -> Arc:
        """One arc: steps until a guard is crossed or the time is over; an arc begun `by` an event lies on its guard."""
        field, leaving, settings, units = self.field(mode), self.hybrid.leaving(mode), self.settings, self.units
        solver = DOP853(
            scaled(field, units), 0.0, x / units, until - t, rtol=settings.relative_tolerance,
            atol=settings.absolute_tolerance, max_step=nonzero(self.longest),
        )  # fmt: skip
        self._asked = []
        guards = [self._watch(each.guard, each.direction, field, x, by in ("", each.name)) for each in leaving]
        holds = {name: self._watch(hold, -1, field, x) for name, hold in self.hybrid.mode(mode).holds.items()}
        times = [np.zeros(1)]
        states = [x[None]]
        for _ in range(WATCHED.most_steps):
            limit.check()
            solver.step()
            if solver.status == "failed" or not np.all(np.isfinite(solver.y)):
                raise IntegrationError("DOP853 fails: the motion is singular there", time=solver.t, state=x)
            dense, looks = self._told(solver.dense_output()), np.linspace(solver.t_old, solver.t, WATCHED.looks)[1:]
            within = dense(looks).T
            within[-1] = solver.y * units
            crossed = self._crossing(guards, leaving, looks, within, dense, field, (solver.t_old, states[-1][-1]))
            if crossed is not None:
                moment, end, which = crossed
                kept = looks < moment
                looks, within = np.append(looks[kept], moment), np.vstack([within[kept], end])
            for hold in holds.values():
                hold.seen(looks, within, dense)
            times.append(looks)
            states.append(within)
            if crossed is None and solver.status != "finished":
                continue
            spent, path = np.concatenate(times), np.vstack(states)
            if len(spent) > 2 and t + spent[-2] == t + spent[-1]:  # the event where a step ended is one moment
                spent, path = np.delete(spent, -2), np.delete(path, -2, axis=0)
            margins = tuple((name, -hold.most / nonzero(hold.range)) for name, hold in holds.items())
            if crossed is None:
                return Arc(mode, t + spent, path, None, path[-1], 0.0, margins)
            return self._ended(mode, leaving[which], t, spent, path, guards[which].range, margins)
        steps = WATCHED.most_steps
        raise IntegrationError(f"no event ends mode {mode} within {steps} steps", time=solver.t, state=solver.y)

    def _told(self, dense: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
        """Dense output (d, or d x k) in the model's own units."""
        return lambda times: np.asarray((dense(times).T * self.units).T)

    def _watch(
        self, function: ca.Function, direction: int, field: VectorField, x: np.ndarray, own: bool = False
    ) -> _Height:
        if id(function) not in self._slopes:
            self._slopes[id(function)] = gradient(function)
        slope = self._slopes[id(function)]

        def height(x: np.ndarray) -> float:
            return direction * float(self.value(function, x)[0])

        def climb(x: np.ndarray) -> float:
            return direction * float(self.value(slope, x) @ field(0.0, x))

        return _Height(height, climb, x, float(np.abs(self.value(slope, x)) @ np.abs(x)), own)

    def _crossing(
        self, guards: Sequence[_Height], leaving: Sequence[Transition], looks: np.ndarray, within: np.ndarray,
        dense: Callable[[float], np.ndarray], field: VectorField, begin: tuple[float, np.ndarray],
    ) -> tuple[float, np.ndarray, int] | None:  # fmt: skip
        """The first crossing that counts among those within a step: moment, state, number of its transition."""
        crossings = []
        for k, transition in enumerate(leaving):
            for before, after in guards[k].seen(looks, within, dense):
                moment = _root(lambda t: guards[k].height(dense(t)), before, after)  # noqa: B023 - of this round
                moment, state = self._polished(transition, field, begin, moment)
                if self._counts(transition, state):
                    crossings.append((moment, state, k))
                    break
        if not crossings:
            return None
        moment, state, which = min(crossings, key=lambda each: each[0])
        for k, transition in enumerate(leaving):
            low, rising = guards[k].height(state), guards[k].climb(state)
            near = rising > 0 and abs(low) <= WATCHED.together * moment * rising
            if k != which and near and self._counts(transition, state):
                both = " and ".join(leaving[j].name for j in sorted((k, which)))
                raise IntegrationError(f"events {both} are simultaneous at t = {moment:.6g} s", time=moment)
        return moment, state, which

    def _counts(self, transition: Transition, x: np.ndarray) -> bool:
        """Whether a crossing is an event."""
        if transition.allowed is None:
            return True
        value = float(self.value(transition.allowed, x)[0])
        self._asked.append((transition, abs(value)))
        return value > 0

    def _polished(
        self, transition: Transition, field: VectorField, begin: tuple[float, np.ndarray], moment: float
    ) -> tuple[float, np.ndarray]:
        """Newton's method on the event's time, with the integrator itself instead of its dense output."""
        start, x = begin
        for _ in range(3):
            if moment - start > WATCHED.near * np.spacing(abs(moment)):
                state = self.path(transition.source, x, np.array([start, moment]))[-1]
            else:  # no integrator takes a step of a few units in the last place of its clock
                state = x + (moment - start) * np.asarray(field(start, x))
            rate = self.rate(transition, state)
            if rate == 0.0:
                break
            step = -float(self.value(transition.guard, state)[0]) / rate
            if abs(step) <= 4 * np.spacing(abs(moment)) or not np.isfinite(step):
                break
            moment = max(moment + step, start)
        return moment, state

    def rate(self, transition: Transition, x: np.ndarray) -> float:
        """The guard's rate of change where its mode ends."""
        return float(self.value(transition.slope, x) @ self.field(transition.source)(0.0, x))

    def unlike(
        self, arc: tuple[str, str], image: tuple[str, str], rows: np.ndarray, matrix: np.ndarray, moved: np.ndarray
    ) -> float:
        """The largest relative difference of what a mode and its event are at images S x + d of states (k x d) from the
        image of what another mode and its event are at them; events that are "" stand for all, and for what holds."""
        here = np.array([self._said(*arc, x, matrix, moved) for x in rows])
        there = np.array([self._said(*image, matrix @ x + moved, np.eye(x.size), 0 * moved) for x in rows])
        off = np.abs(there - here).max(axis=0) / np.maximum(1.0, np.abs(here).max(axis=0))
        return float(off.max()) if np.all(np.isfinite(off)) else np.inf

    def _said(self, mode: str, event: str, x: np.ndarray, matrix: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Rates, guards, resets and conditions at a state; rates and resets taken by S x + d."""
        parts = [matrix @ self.field(mode)(0.0, x)]
        parts += [self.value(hold, x) for hold in self.hybrid.mode(mode).holds.values() if not event]
        for transition in (transition for transition in self.hybrid.leaving(mode) if event in ("", transition.name)):
            parts += [
                matrix @ self.value(transition.reset, x) + moved,
                transition.direction * self.value(transition.guard, x),
            ]
            parts += [
                self.value(each, x)
                for each in (transition.allowed, transition.impulse, transition.lost)
                if each is not None
            ]
        return np.concatenate(parts)

    def _ended(
        self, mode: str, transition: Transition, start: float, times: np.ndarray, states: np.ndarray, span: float,
        margins: tuple[tuple[str, float], ...],
    ) -> Arc:  # fmt: skip
        end = states[-1]
        slope = self.rate(transition, end) * transition.direction
        # how far from their change of mind the answers were on which crossings count
        sizes = {each.name: max(abs(float(self.value(each.allowed, x)[0])) for x in states) for each, _ in self._asked}
        decided = min((value / nonzero(sizes[each.name]) for each, value in self._asked), default=np.inf)
        impulse, lost = (
            None if f is None else float(self.value(f, end)[0]) for f in (transition.impulse, transition.lost)
        )
        return Arc(
            mode, start + times, states, transition.name, self.value(transition.reset, end),
            slope * times[-1] / nonzero(span), margins, impulse, lost, decided,
        )  # fmt: skip


Seen = tuple[float, float, float]
"""Time, height and its rate"""


def _root(rising: Callable[[float], float], before: float, after: float) -> float:
    """Where a function rises through 0; at one of two moments where it does so but for its round-off."""
    ends = rising(before), rising(after)
    if not ends[0] < 0 <= ends[1]:
        return before if ends[0] >= 0 else after
    return float(brentq(rising, before, after, xtol=1e-15 * max(abs(before), abs(after)), rtol=1e-14))


def arcs_along(model: Model, times: np.ndarray, states: np.ndarray) -> list[Arc]:
    """The arcs of a trajectory (k and k x d) over a period that begins right after the event that ends the cycle.

    An event is where a time stands twice; where none does, where the motion simulated from one sample to the next meets
    a guard, the last perhaps a little later. One more arc goes on from there to the next event, where there is one.
    """
    hybrid, automaton = model.hybrid, Automaton.about(model, states[0], float(np.ptp(times)), SECOND)
    mode, clock, path, arcs = hybrid.first.name, [times[0]], [states[0]], list[Arc]()
    spans, twice = np.append(np.diff(times), 0.0), np.flatnonzero(np.diff(times) == 0) + 1
    for own, rows in zip(np.split(times, twice), np.split(states, twice), strict=True) if twice.size else ():
        values = [(automaton.value(transition.guard, rows[-1])[0], transition) for transition in hybrid.leaving(mode)]
        first = min(values, key=lambda each: abs(each[0]) / nonzero(abs(automaton.rate(each[1], rows[-1]))))[1]
        arcs.append(Arc(mode, own, rows, first.name, automaton.value(first.reset, rows[-1])))
        mode = first.target
    if arcs:
        return arcs

    def met(begin: float, until: float, most: int = MOST_EVENTS) -> float:
        """How late after a moment the last event is that the motion from the newest state meets, 0 without one."""
        nonlocal mode, clock, path
        late = 0.0
        for arc in (arc for arc in automaton.arcs(path[-1], mode, until, most) if arc.ended_by is not None):
            late, before = float(arc.times[-1]), arc.states[-1]
            own = np.array([*clock, begin + late])
            arcs.append(Arc(mode, own, np.vstack([*path, before]), arc.ended_by, arc.after))
            mode, clock, path = hybrid.transition(str(arc.ended_by)).target, [begin + late], [arc.after]
        return late

    for moment, span, more, row in zip(times, spans, spans[1:], states[1:], strict=False):
        late = met(moment, span * (1 + WATCHED.together)) if more else met(moment, span * (1 + WATCHED.back), 1)
        if late < span * (1 - WATCHED.together):
            clock, path = [*clock, moment + span], [*path, row]
    if len(path) > 1 or not arcs:
        met(times[-1], float(np.ptp(times)), 1)
    return arcs


def recognised(
    model: Model, state: np.ndarray, period: float, trajectory: tuple[np.ndarray, np.ndarray] | None = None
) -> tuple[str, ...]:
    """The transitions that the motion from a state, or a trajectory (its times and states), goes through until it is
    first back near its start, after about a period.

    Raises `ConvergenceError` where it does not come back to the mode in which it began.
    """
    hybrid = model.hybrid
    arcs, nearest = list[Arc](), (WATCHED.back, 0)
    automaton = Automaton.about(model, state, period, SECOND, period / 16)
    simulated = automaton.arcs(state, hybrid.first.name, (1 + WATCHED.back) * period)
    for arc in simulated if trajectory is None else arcs_along(model, *trajectory):
        if arc.ended_by is None:
            break
        arcs.append(arc)
        extent = nonzero(np.ptp(np.vstack([one.states for one in arcs]), axis=0))
        away = np.abs(wrapped(arc.after - state, model.angular))
        off = max(float((away / extent).max()), abs(float(arc.times[-1]) / period - 1))
        if hybrid.transition(arc.ended_by).target == hybrid.first.name and off < nearest[0]:
            nearest = off, len(arcs)
    names = tuple(str(arc.ended_by) for arc in arcs)
    if not nearest[1]:
        through = ", ".join(names) or "no event"
        raise ConvergenceError(
            f"cycle: the motion from the guess goes through {through} in {(1 + WATCHED.back) * period:.4g} s and is "
            f"not back near its start in mode {hybrid.first.name}; start nearer to an orbit, or give the cycle"
        )
    return names[: nearest[1]]


class _Height:
    """A function along an arc: its height, below 0 before a crossing and above after, and the height's rate.

    Looks are added between those given until a cubic through heights and rates tells what is between them.
    """

    def __init__(self, height: Height, climb: Height, x: np.ndarray, size: float, own: bool) -> None:
        self.height, self.climb, self.own = height, climb, own
        self.last: Seen = 0.0, height(x), climb(x)
        self.range, self.most, self.floor = abs(self.last[1]), self.last[1], WATCHED.round_off * size

    def seen(
        self, looks: np.ndarray, within: np.ndarray, dense: Callable[[float], np.ndarray]
    ) -> list[tuple[float, float]]:
        """The intervals in which the height rises through 0, also for less than the time between two looks.

        An arc that starts on a guard and goes on through it crosses it there, unless that guard began the arc.
        """
        risen = []
        for t, x in zip(map(float, looks), within, strict=True):
            value, rate = self.height(x), self.climb(x)
            self.range = max(self.range, abs(value))
            for a, b in pairwise([self.last, *self._between(self.last, (t, value, rate), dense, DEEPEST)]):
                risen += self._risen(a, b, dense)
            self.last = t, value, rate
        return risen

    def _between(self, a: Seen, b: Seen, dense: Callable[[float], np.ndarray], depth: int) -> list[Seen]:
        """Looks after a, up to b."""
        moment, span = 0.5 * (a[0] + b[0]), b[0] - a[0]
        x = dense(moment)
        seen = moment, self.height(x), self.climb(x)
        self.range = max(self.range, abs(seen[1]))
        off = abs(0.5 * (a[1] + b[1]) + span / 8 * (a[2] - b[2]) - seen[1])
        if depth == 0 or not off > max(FINE * self.range, self.floor):
            return [seen, b]
        return [*self._between(a, seen, dense, depth - 1), *self._between(seen, b, dense, depth - 1)]

    def _risen(self, a: Seen, b: Seen, dense: Callable[[float], np.ndarray]) -> list[tuple[float, float]]:
        (before, low, rising), (after, value, rate) = a, b
        self.most = max(self.most, value)
        on_it = before == 0.0 and abs(low) <= max(WATCHED.round_off * self.range, self.floor)
        if value >= 0 and (not self.own if on_it else low < 0):
            return [(before, after)]
        if rising > 0 > rate:
            peak = _root(lambda moment: -self.climb(dense(moment)), before, after)
            top = self.height(dense(peak))
            self.most = max(self.most, top)
            if value < 0 <= top and low < 0:
                return [(before, peak)]
        return []
