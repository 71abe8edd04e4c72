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
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.dop853 import TIGHTEST, ReferenceSettings, VectorField, integrate, vector_field
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.mechanics.hybrid import Transition
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import vector_field as field_of

LOOKS = 12
"""Times at which guards are looked at within a step"""
MOST_STEPS = 100_000
MOST_EVENTS = 10_000
ZENO = 20
"""Arcs in a row of which each is shorter than the one before, that make a Zeno motion where they end in nothing"""
NOTHING = 1e-5
"""Share of the whole time that the last arc of a Zeno motion takes at most"""
TOGETHER = 1e-9
"""Share of an arc within which two events are simultaneous"""
ROUND_OFF = 1e-12
"""A guard this small, relative to how it changes along the arc, is 0"""


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

    @property
    def duration(self) -> float:
        """s"""
        return float(self.times[-1] - self.times[0])


class Automaton:
    """The simulator of one hybrid Model at its parameters' values."""

    def __init__(self, model: Model, settings: ReferenceSettings = TIGHTEST) -> None:
        assert model.hybrid is not None
        self.model, self.hybrid, self.settings = model, model.hybrid, settings
        self._fields: dict[str, VectorField] = {}
        self._buffered: dict[int, Buffered] = {}

    def field(self, mode: str) -> VectorField:
        """dx/dt (t, x) in a mode."""
        if mode not in self._fields:
            flow = field_of(self.hybrid.mode(mode).model)
            t, x = ca.MX.sym("t"), ca.MX.sym("x", flow.size1_in(1))
            self._fields[mode] = vector_field(ca.Function("f", [t, x], [flow(t, x, [], [])]))
        return self._fields[mode]

    def varied(self, mode: str) -> VectorField:
        """The field of (x, vec Y, S) in a mode: the motion, its variations, its action."""
        own = self.hybrid.mode(mode).model
        flow, size = field_of(own), len(own.state_names)
        t, y = ca.MX.sym("t"), ca.MX.sym("y", size * (1 + size) + 1)
        x, matrix = y[:size], ca.reshape(y[size:-1], size, size)
        inputs = flow.mx_in()
        both = ca.Function("both", inputs, [flow(*inputs), ca.jacobian(flow(*inputs), inputs[1])])
        rate, slopes = both(t, x, [], [])
        action = own.action_rate(t, x, own.parameter_values)
        return vector_field(ca.Function("varied", [t, y], [ca.vertcat(rate, ca.vec(slopes @ matrix), action)]))

    def saltation(self, arc: Arc, following: str) -> np.ndarray:
        """S = DR + (f+ - DR f-) grad g / (grad g . f-) at the end of an arc."""
        one, x, p = self.hybrid.transition(str(arc.ended_by)), arc.states[-1], self.model.parameter_values
        symbol, numbers = ca.MX.sym("x", x.size), ca.MX.sym("p", p.size)
        rows = [ca.jacobian(value(symbol, numbers), symbol) for value in (one.reset, one.guard)]
        reset, guard = (value.full() for value in ca.Function("slopes", [symbol, numbers], rows)(x, p))
        before, after = self.field(arc.mode)(0.0, x), self.field(following)(0.0, arc.after)
        return np.asarray(reset + np.outer(after - reset @ before, guard) / (guard @ before).item())

    def value(self, function: ca.Function, x: np.ndarray) -> np.ndarray:
        """A guard, a reset or a condition at one state."""
        if id(function) not in self._buffered:
            self._buffered[id(function)] = Buffered(function)
        return self._buffered[id(function)](x, self.model.parameter_values)[0].ravel()

    def arcs(
        self, state: np.ndarray, mode: str, duration: float = np.inf, events: int = MOST_EVENTS, start: float = 0.0
    ) -> Iterator[Arc]:
        """The motion from a state in a mode, arc by arc, for a time (s) or a number of events.

        Raises `IntegrationError`, also where events accumulate (Zeno), coincide or never end.
        """
        until, x, t, lengths, by = start + duration, np.asarray(state, float), start, list[float](), ""
        for _ in range(events):
            arc = self._arc(x, t, until, mode, by)
            yield arc
            if arc.ended_by is None:
                return
            lengths.append(arc.duration)
            self._check_zeno(lengths, arc)
            by = arc.ended_by
            x, t, mode = arc.after, float(arc.times[-1]), self.hybrid.transition(arc.ended_by).target

    def _check_zeno(self, lengths: Sequence[float], arc: Arc) -> None:
        last = lengths[-ZENO:]
        if len(last) == ZENO and all(b < a for a, b in pairwise(last)) and (last[-1] < NOTHING * sum(lengths)):
            raise IntegrationError(
                f"Zeno: events {arc.ended_by} follow each other ever faster and accumulate at t = {arc.times[-1]:.6g} "
                "s; give the model a mode in which contact lasts",
                time=float(arc.times[-1]), state=arc.after,
            )  # fmt: skip

    def _arc(self, x: np.ndarray, t: float, until: float, mode: str, by: str) -> Arc:
        """One arc: steps until a guard is crossed or the time is over; an arc begun `by` an event lies on its guard."""
        field, leaving = self.field(mode), self.hybrid.leaving(mode)
        settings = self.settings
        solver = DOP853(field, 0.0, x, until - t, rtol=settings.relative_tolerance, atol=settings.absolute_tolerance)
        own = [by in ("", one.name) for one in leaving]
        heights = _Heights([self._height(one) for one in leaving], [self._climb(one, field) for one in leaving], own, x)
        times: list[np.ndarray] = [np.zeros(1)]
        states: list[np.ndarray] = [x[None]]
        for _ in range(MOST_STEPS):
            limit.check()
            solver.step()
            if solver.status == "failed" or not np.all(np.isfinite(solver.y)):
                raise IntegrationError("DOP853 fails: the motion is singular there", time=solver.t, state=x)
            dense, looks = solver.dense_output(), np.linspace(solver.t_old, solver.t, LOOKS)[1:]
            within = dense(looks).T
            within[-1] = solver.y
            found = self._crossing(heights, leaving, looks, within, dense, field, (solver.t_old, states[-1][-1]))
            if found is not None:
                moment, end, which = found
                kept = looks < moment
                times += [looks[kept], np.array([moment])]
                states += [within[kept], end[None]]
                spent = np.concatenate(times)
                return self._ended(mode, leaving[which], t, spent, np.vstack(states), heights.ranges[which])
            times.append(looks)
            states.append(within)
            if solver.status == "finished":
                path = np.vstack(states)
                return Arc(mode, t + np.concatenate(times), path, None, path[-1], 0.0, self._margins(mode, path))
        raise IntegrationError(f"no event ends mode {mode} within {MOST_STEPS} steps", time=solver.t, state=solver.y)

    def _height(self, one: Transition) -> Height:
        return lambda x: one.direction * float(self.value(one.guard, x)[0])

    def _climb(self, one: Transition, field: VectorField) -> Height:
        return lambda x: one.direction * self._rate(one, field, 0.0, x)

    def _crossing(
        self, heights: _Heights, leaving: Sequence[Transition], looks: np.ndarray, within: np.ndarray,
        dense: Callable[[float], np.ndarray], field: VectorField, begin: tuple[float, np.ndarray],
    ) -> tuple[float, np.ndarray, int] | None:  # fmt: skip
        """The first crossing that counts among those within a step: moment, state, number of its transition."""
        found: list[tuple[float, np.ndarray, int]] = []
        for k, one in enumerate(leaving):
            for before, after in heights.crossed(k, looks, within, dense):
                moment = self._located(heights.of[k], before, after, dense)
                moment, state = self._polished(one, field, begin, moment)
                if one.allowed is None or float(self.value(one.allowed, state)[0]) > 0:
                    found.append((moment, state, k))
                    break
        if not found:
            return None
        found.sort(key=lambda each: each[0])
        span = found[0][0]
        if len(found) > 1 and found[1][0] - found[0][0] <= TOGETHER * span:
            both = " and ".join(leaving[k].name for _, _, k in found[:2])
            raise IntegrationError(f"events {both} are simultaneous at t = {found[0][0]:.6g} s", time=found[0][0])
        return found[0]

    def _located(self, height: Height, before: float, after: float, dense: Callable[[float], np.ndarray]) -> float:
        ends = height(dense(before)), height(dense(after))
        if not ends[0] < 0 <= ends[1]:
            return before if ends[0] >= 0 else after
        return float(brentq(lambda t: height(dense(t)), before, after, xtol=1e-15, rtol=1e-14))

    def _polished(
        self, one: Transition, field: VectorField, begin: tuple[float, np.ndarray], moment: float
    ) -> tuple[float, np.ndarray]:
        """Newton's method on the event's time, with the integrator itself instead of its dense output."""
        start, x = begin
        for _ in range(3):
            state = integrate(field, x, np.array([start, moment]), self.settings) if moment > start else x[None]
            state = state[-1]
            rate = self._rate(one, field, moment, state)
            if rate == 0.0:
                break
            step = -float(self.value(one.guard, state)[0]) / rate
            if abs(step) <= 4 * np.spacing(abs(moment)) or not np.isfinite(step):
                break
            moment = max(moment + step, start)
        return moment, state

    def rate(self, one: Transition, x: np.ndarray) -> float:
        """The guard's rate of change where its mode ends."""
        return self._rate(one, self.field(one.source), 0.0, x)

    def _rate(self, one: Transition, field: VectorField, t: float, x: np.ndarray) -> float:
        """The guard's rate of change along the motion."""
        return float(self.value(one.slope, x) @ field(t, x))

    def _ended(
        self, mode: str, one: Transition, start: float, times: np.ndarray, states: np.ndarray, span: float
    ) -> Arc:
        end = states[-1]
        slope = self._rate(one, self.field(mode), float(times[-1]), end) * one.direction
        impulse, lost = (None if f is None else float(self.value(f, end)[0]) for f in (one.impulse, one.lost))
        return Arc(
            mode, start + times, states, one.name, self.value(one.reset, end), slope * times[-1] / max(span, 1e-300),
            self._margins(mode, states), impulse, lost,
        )  # fmt: skip

    def _margins(self, mode: str, states: np.ndarray) -> tuple[tuple[str, float], ...]:
        found = []
        for name, function in self.hybrid.mode(mode).holds.items():
            values = np.array([float(self.value(function, x)[0]) for x in states])
            found.append((name, float(values.min() / max(np.abs(values).max(), 1e-300))))
        return tuple(found)


class _Heights:
    """The guards' values in their directions along an arc: below 0 before, above after; and their rates."""

    def __init__(self, of: Sequence[Height], rates: Sequence[Height], own: Sequence[bool], x: np.ndarray) -> None:
        self.of, self.rates = of, rates
        self.last = [(0.0, one(x), rate(x)) for one, rate in zip(of, rates, strict=True)]
        self.ranges = [abs(value) for _, value, _ in self.last]
        self.fresh = [not one for one in own]

    def crossed(
        self, k: int, looks: np.ndarray, within: np.ndarray, dense: Callable[[float], np.ndarray]
    ) -> list[tuple[float, float]]:
        """The intervals in which guard k rises through 0, also for less than the time between two looks.

        An arc that starts on a guard and goes on through it crosses it there, unless that guard began the arc.
        """
        found = []
        for t, x in zip(map(float, looks), within, strict=True):
            value, rate = self.of[k](x), self.rates[k](x)
            before, low, rising = self.last[k]
            self.ranges[k] = max(self.ranges[k], abs(value))
            on_it = abs(low) <= ROUND_OFF * max(self.ranges[k], abs(value)) and before == 0.0
            if value >= 0 and (self.fresh[k] if on_it else low < 0):
                found.append((before, t))
            elif value < 0 and low < 0 and rising > 0 > rate:
                peak = float(brentq(lambda moment: self.rates[k](dense(moment)), before, t))
                if self.of[k](dense(peak)) >= 0:
                    found.append((before, peak))
            self.last[k] = t, value, rate
        return found
