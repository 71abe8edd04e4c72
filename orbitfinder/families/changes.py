"""Where families of hybrid orbits end: a guard is grazed, events change their order, what must hold does no longer.

The equations of a hybrid loop know the cycle's own events only, and go on smoothly where the motion would take another
way. How far an orbit is from that is told by margins, each positive while the orbit goes through its cycle; where the
first becomes 0 is found like any event, along the arclength.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from orbitfinder._runtime.sizes import size_of
from orbitfinder.continuation.follow import zero
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.passages import located
from orbitfinder.families.run import Interval, Sample
from orbitfinder.integrate.dop853 import integrate_in
from orbitfinder.loops.continued import Curve, Solution, crossed
from orbitfinder.loops.mesh import arc_mesh, arc_states
from orbitfinder.mechanics.hybrid import Hybrid
from orbitfinder.orbits.evidence import CHECKED
from orbitfinder.records.family import Event

LOOKS = 48
"""Places of an arc at which guards are looked at, at least"""
LEAST = 1e-9
"""A margin below this in size is 0: what is held at an impact starts and ends there"""
CLOSE = 1e-2
"""A peak this near to 0 is integrated to, and not read from a cubic"""
FIRST = {"share": 0, "rate": 1, "allowed": 1, "guard": 1}
"""Which of margins that are lost together is to blame: beside an arc that vanishes the others jump or go like a square
root, and what must hold is lost because of a guard"""
ABSENT = 1.0
"""The margin of what is nowhere near"""


@dataclass(frozen=True)
class Margin:
    """How far an orbit is from another way: `value` relative to the range of what is watched, `what` in words."""

    kind: str
    name: str
    value: float
    what: str


Margins = dict[tuple[int, str, str], Margin]
"""By arc, name and which"""


def broken(curve: Curve, solution: Solution) -> Margin | None:
    """The margin that an orbit has lost most of, if any: then it does not go through its cycle."""
    lost = [margin for margin in margins(curve, solution).values() if margin.value < -LEAST]
    return min(lost, key=lambda margin: margin.value, default=None)


def checked_cycle(curve: Curve, solution: Solution) -> Solution:
    """The same orbit. Raises `ConvergenceError` where it does not go through its cycle."""
    lost = broken(curve, solution) if curve.equations.links else None
    if lost is not None:
        raise ConvergenceError(f"the cycle of events changes: {lost.what}")
    return solution


def first_lost(interval: Interval) -> tuple[Sample, Margin] | None:
    """The first orbit of an interval at which a margin is 0, with that margin, where one is lost at its end."""
    ahead = margins(interval.curve, interval.last.solution)
    lost = {key: margin for key, margin in ahead.items() if margin.value < -LEAST}
    zeros = [(located(interval, partial(_value, interval.curve, key), 0.0, interval.length), key) for key in lost]
    if not zeros:
        return None
    # share of a step within which what must hold is lost because of a guard
    nearest = min(sample.distance for sample, _ in zeros) + 1e-6 * interval.length
    first = [(sample, key) for sample, key in zeros if sample.distance <= nearest]
    sample, key = min(first, key=lambda pair: FIRST.get(pair[1][2], len(FIRST)))
    if crossed(interval.curve, sample.solution):  # the rows there tell neither family's tangent
        sample = replace(sample, whole=interval.heading(sample.distance))
    return sample, lost[key]


def _value(curve: Curve, key: tuple[int, str, str], sample: Sample) -> float:
    margin = margins(curve, sample.solution).get(key)
    return ABSENT if margin is None else margin.value


def margins(curve: Curve, solution: Solution) -> Margins:
    """Every margin of a hybrid orbit."""
    hybrid: Hybrid = curve.equations.model.hybrid
    shares, known = curve.equations.links.shares(solution.place.free), Margins()
    for k, (mode, ends) in enumerate(hybrid.arcs):
        arc = _Arc(curve, solution, k)
        vanishing = f"mode {mode.name} before {ends.name} lasts no time"
        known[k, ends.name, "share"] = Margin("cycle_change", ends.name, float(shares[k]), vanishing)
        for event in hybrid.leaving(mode.name):
            watched = arc.watched(event.guard, event.direction)
            reached = [(value, "grazing") for value in watched.peaks(event.allowed)]
            if event is ends:
                rate = float(watched.rates[-1] / watched.range)
                known[k, event.name, "rate"] = Margin("grazing", event.name, rate, f"{event.name} is only just reached")
                if event.allowed is not None:
                    counts = arc.watched(event.allowed, 1)
                    value = float(counts.heights[-1] / counts.range)
                    ignored = f"{event.name} is ignored"
                    known[k, event.name, "allowed"] = Margin("cycle_change", event.name, value, ignored)
            elif watched.below and (event.allowed is None or arc.watched(event.allowed, 1).heights[-1] > 0):
                reached.append((-float(watched.heights[-1] / watched.range), "cycle_change"))
            if reached:
                value, kind = min(reached)
                what = f"{event.name} comes before {ends.name} in mode {mode.name}"
                known[k, event.name, "guard"] = Margin(kind, event.name, value, what)
        for name, held in mode.holds.items():
            watched = arc.watched(held, -1)
            ends_at = {f"holds {j}": -float(watched.heights[j] / watched.range) for j in (0, -1)}
            for which, value in {"holds": min(watched.peaks(), default=ABSENT), **ends_at}.items():
                known[k, name, which] = Margin("holds", name, value, f"{name} becomes negative in mode {mode.name}")
        if ends.impulse is not None:
            watched = arc.watched(ends.impulse, 1)
            value = float(watched.heights[-1] / watched.range)
            known[k, ends.name, "impulse"] = Margin("holds", ends.name, value, f"{ends.name} would pull")
    return known


def margins_called(curve: Curve, solution: Solution, event: Event) -> Margins:
    """The margins of a hybrid orbit that may be an event's."""
    known = margins(curve, solution)
    return {key: margin for key, margin in known.items() if (margin.kind, margin.name) == (event.kind, event.detail)}


def nearest_margin(curve: Curve, solution: Solution, event: Event) -> tuple[int, str, str]:
    """Which margin is 0 at an event. Raises `InputError` where it cannot be told."""
    known = margins_called(curve, solution, event)
    if not known:
        raise InputError(f"event: what is grazed there ({event.detail}) cannot be told; continue the family again")
    return min(known, key=lambda key: abs(known[key].value))


class _Arc:
    """States (k x d) and rates along an arc of an orbit, at equal shares of it where its mesh is coarser."""

    def __init__(self, curve: Curve, solution: Solution, k: int) -> None:
        place, arcs = solution.place, curve.equations.links.count
        self.curve, self.march, self.place = curve, curve.equations.march.arcs[k], place
        self.mesh = arc_mesh(place, arcs, k) * place.period / arcs
        self.known = arc_states(solution, arcs, k)
        slopes = self.march.rates(self.known, place.tail)
        self.times, self.states, self.slopes = self.mesh, self.known, slopes
        if self.mesh.size <= LOOKS:
            self.times = np.linspace(self.mesh[0], self.mesh[-1], LOOKS + 1)
            self.states = CubicHermiteSpline(self.mesh, self.known, slopes)(self.times)
            self.states[[0, -1]] = self.known[[0, -1]]
            self.slopes = self.march.rates(self.states, place.tail)

    def watched(self, function: Any, direction: int) -> _Watched:
        """A function of the mode along the arc."""
        values, by_state = self.curve.equations.watched(function, self.states, self.place.free)
        return _Watched(self, function, direction, direction * values, direction * (by_state * self.slopes).sum(axis=1))

    def at(self, moment: float) -> np.ndarray:
        """The state (d) at a moment, integrated from the mesh."""
        j = max(0, int(np.searchsorted(self.mesh, moment, side="right")) - 1)

        def field(_: float, x: np.ndarray) -> np.ndarray:
            return np.asarray(self.march.rates(x[None], self.place.tail)[0])

        span = np.array([self.mesh[j], moment])
        return np.asarray(integrate_in(self.curve.units, field, self.known[j], span, CHECKED)[-1])


@dataclass(frozen=True)
class _Watched:
    """The heights of a function along an arc, above 0 once it is crossed, and their rates."""

    arc: _Arc
    function: Any
    direction: int
    heights: np.ndarray
    rates: np.ndarray

    @property
    def range(self) -> float:
        """The largest height in size."""
        return size_of(self.heights)

    @property
    def below(self) -> bool:
        """Whether it is uncrossed anywhere: else it began the arc, which goes on through it."""
        return bool(self.heights.min() < -LEAST * self.range)

    def peaks(self, allowed: Any | None = None) -> Iterator[float]:
        """The margin of each highest place inside the arc; where crossings are ignored, of what ignores them."""
        for i in np.flatnonzero((self.rates[:-1] > 0) & (self.rates[1:] < 0)):
            top, moment = self._peak(int(i))
            if top >= 0:
                below = np.flatnonzero(self.heights[:i] < -LEAST * self.range)
                if not below.size:
                    continue  # the event that begins the arc, which it goes on through
                moment = float(self.arc.times[below[-1]])
            if allowed is None:
                yield -top / self.range
                continue
            counts = float(self._read(allowed, moment)[0])
            if top >= 0:
                yield -top / self.range if counts > 0 else -counts
            elif counts > 0:
                yield -top / self.range

    def _peak(self, i: int) -> tuple[float, float]:
        """The height and the moment of the highest place between two looks."""
        times, ends = self.arc.times[i : i + 2], slice(i, i + 2)
        cubic = CubicHermiteSpline(times, self.heights[ends], self.rates[ends])
        moment = zero(cubic.derivative(), times[0], times[1], 1e-12 * (times[1] - times[0]))
        top = float(cubic(moment))
        if abs(top) > CLOSE * self.range:
            return top, moment
        climbs = [self._climb(float(time)) for time in times]
        if climbs[0] > 0 > climbs[1]:
            moment = zero(self._climb, times[0], times[1], 1e-10 * (times[1] - times[0]))
        return self.direction * float(self._read(self.function, moment)[0]), moment

    def _climb(self, moment: float) -> float:
        _, climb = self._read(self.function, moment)
        return self.direction * climb

    def _read(self, function: Any, moment: float) -> tuple[float, float]:
        """A function and its rate at a moment."""
        x = self.arc.at(moment)
        values, by_state = self.arc.curve.equations.watched(function, x[None], self.arc.place.free)
        return float(values[0]), float(by_state[0] @ self.arc.march.rates(x[None], self.arc.place.tail)[0])
