"""Where motions cross a plane: many at once, each with steps of its own, crossings located to round-off.

A plane is x_i = c, of an angle c + 2 pi k; a forced system is looked at once a period of its forcing, where t = k P.
The steps are those of `rk8` with its estimate of their error. In a step that crosses, Newton's method on the step's
length finds the crossing with the step itself, so that it is as good as the motion; a step whose cubic touches the
plane and turns back is shortened to that turn, so that no pair of crossings is stepped over. Backwards in time steps
are negative.

Source: M. Henon, "On the numerical computation of Poincare maps", Physica D 5 (1982) 412-414; step control: E. Hairer,
S. Norsett, G. Wanner, Solving Ordinary Differential Equations I (1993), section II.4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.parallel import STAGES, Lanes
from orbitfinder.integrate.rk8 import one_step, step_of
from orbitfinder.mechanics.model import Model, vector_field
from orbitfinder.records.journal import fill

FINE, SEEN = 2e-14, 1e-10
"""Relative tolerances of one step: of what is refined, and of what is drawn"""


@dataclass(frozen=True)
class StepSettings:
    """How long the steps of many motions are."""

    effort: float = 3.0
    """Seconds of interpreted stepping that a section takes, for `compiled`"""
    on_it: float = 1e-11
    """A start this near to the plane, in units of its motion, is on it"""
    shortest: float = 1e-13
    """Steps shorter than this share of the longest mean that a motion ends in a singularity"""
    touching: float = 0.02
    """A cubic turns back at the plane where it comes as near as this, relative to how far it came and goes"""
    short: int = 500
    """Operations of a field up to which a step and its error are one expression"""
    every: int = 4
    """Crossings of each motion, on average, between two lines of a track"""


STEPS = StepSettings()


@dataclass(frozen=True)
class Plane:
    """x_i = `level` of component i, crossed with x_i growing (`direction` 1), falling (-1) or both ways (0).

    `cycle` is 2 pi for an angle, the forcing's period for a component -1, which is time; 0 without repetition.
    """

    component: int
    level: float = 0.0
    direction: int = 1
    cycle: float = 0.0

    def cell(self, values: np.ndarray) -> np.ndarray:
        """Which of the plane's repetitions lies below values of its component."""
        return np.floor((values - self.level) / self.cycle) if self.cycle else np.where(values >= self.level, 0.0, -1.0)

    def off(self, values: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Values relative to the repetition of a number."""
        return values - self.level - (self.cycle * cell if self.cycle else 0.0)

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """The number of the repetition nearest to values."""
        return np.round((values - self.level) / self.cycle) if self.cycle else np.zeros(values.shape)

    def start(self, values: np.ndarray, rates: np.ndarray, unit: float) -> np.ndarray:
        """The cells that motions go into, some of which start on the plane."""
        nearest = self.nearest(values)
        there = np.abs(self.off(values, nearest)) <= STEPS.on_it * unit
        return np.where(there, np.where(rates > 0, nearest, nearest - 1), self.cell(values))


@dataclass(frozen=True)
class Passing:
    """Crossings of k motions: times (k x m) and states (k x m x d), nan from where a motion has ended."""

    times: np.ndarray
    states: np.ndarray

    @property
    def complete(self) -> np.ndarray:
        """Which motions (k) have all crossings."""
        return np.asarray(np.isfinite(self.times).all(axis=1))


@dataclass(frozen=True)
class Track:
    """A run of k motions as far as earlier ones have come, line by line, and what keeps a line more.

    A line is where the motions are (k x 6 + 2d) and the crossings since the line before (m x 3 + d). A run goes on
    from it bit for bit, also with more motions and to more crossings.
    """

    known: Sequence[tuple[np.ndarray, np.ndarray]]
    add: Callable[[np.ndarray, np.ndarray], None]


@lru_cache(maxsize=16)
def _stepper(field: ca.Function, restored: ca.Function | None) -> ca.Function:
    """(t, x), (h, s, free) -> (x after, `restored`, error, x' after); one expression of a short field, or calls."""
    short = field.is_a("SXFunction") and field.n_instructions() <= STEPS.short
    z = (ca.SX.sym if short else ca.MX.sym)("z", 1 + field.size1_in(1))
    p = type(z).sym("p", 1 + field.size1_in(2) + field.size1_in(3))
    step, error = (
        (one_step(field, ca.SX.sym), one_step(field, ca.SX.sym, True))
        if short
        else (step_of(field), step_of(field, True))
    )
    after, cut = step(z, p), 1 + field.size1_in(2)
    x = after[1:] if restored is None else restored(after[1:])
    return ca.Function("stepper", [z, p], ca.cse([ca.vertcat(x, error(z, p), field(after[0], x, p[1:cut], p[cut:]))]))


def along_parameter(model: Model, parameter: str, coordinate: int) -> tuple[ca.Function, ca.Function | None]:
    """The field of (x, p, x_i') in which the parameter p rests, and what makes x_i' of the state again; of a forced
    model that of (x, p), with time in periods of its forcing."""
    field, d = vector_field(model, [parameter]), len(model.state_names)
    symbol = model.symbol
    t, y, none = symbol("t"), symbol("y", d + (1 if model.forced else 2)), symbol("none", 0)
    x, p = y[:d], y[d]
    if model.forced:
        unit = model.forcing_period(model.parameters([parameter], p))  # type: ignore[misc]
        return ca.Function("along", [t, y, none, none], [ca.vertcat(unit * field(unit * t, x, none, p), 0)]), None
    rates = field(t, x, none, p)
    slope = rates[coordinate]
    whole = ca.vertcat(rates, 0, ca.jtimes(slope, x, rates))
    restored = ca.Function("restored", [y], [ca.densify(ca.vertcat(x, p, slope))])
    return ca.Function("along", [t, y, none, none], [ca.densify(whole)]), restored


def deviating(field: ca.Function, units: np.ndarray) -> ca.Function:
    """The field of a motion x, a direction u of deviation in `units` (d) and the logarithm s of its growth:
    u' = J u - k u, s' = k = u.J u / u.u."""
    sym = (ca.SX if field.is_a("SXFunction") else ca.MX).sym
    t, x, *rest = (sym(name, field.size1_in(k)) for k, name in enumerate(("t", "x", "e", "p")))
    u, s, rate = sym("u", units.size), sym("s"), field(t, x, *rest)
    turned = ca.jtimes(rate, x, u * units) / units
    growing = ca.dot(u, turned) / ca.dot(u, u)
    return ca.Function("deviating", [t, ca.vertcat(x, u, s), *rest], [ca.vertcat(rate, turned - growing * u, growing)])


class Crossings:
    """The motions of one field f(t, x, s, free), s and free 0, with components measured in `units` (d).

    `restored` is what a state becomes after each step, where some of its components follow from others.
    """

    def __init__(self, field: ca.Function, units: np.ndarray, restored: ca.Function | None = None) -> None:
        size = field.size1_in(2) + field.size1_in(3)
        self.field, self.size, self.units = field, int(field.size1_in(1)), np.asarray(units, float)
        self.tail = np.zeros(size)
        self.restored, self._lanes, self._made = restored, Lanes(), list[Any]()

    def stepped(self, times: np.ndarray, states: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, ...]:
        """States after steps of these lengths from states (k x d) at times (k), errors and rates there (k x d each)."""
        if not self._made:
            self._made.append(compiled(_stepper(self.field, self.restored), effort=STEPS.effort))
        start, parameters = np.empty((len(states), 1 + self.size)), np.empty((len(states), 1 + self.tail.size))
        start[:, 0], start[:, 1:], parameters[:, 0], parameters[:, 1:] = times, states, lengths, self.tail
        values, d = self._lanes.evaluated(self._made[0], STAGES, start, parameters), self.size
        return values[:, :d], values[:, d : 2 * d], values[:, 2 * d :]

    def rates(self, times: np.ndarray, states: np.ndarray) -> np.ndarray:
        """x' (k x d)."""
        return self.stepped(times, states, np.zeros(len(states)))[2]

    def passing(
        self,
        plane: Plane,
        states: np.ndarray,
        count: int,
        *,
        longest: float,
        sense: int = 1,
        tolerance: float = FINE,
        times: np.ndarray | float = 0.0,
        path: Callable[[np.ndarray, np.ndarray, np.ndarray], None] | None = None,
        seen: Callable[[Callable[[], Passing], int], None] | None = None,
        track: Track | None = None,
    ) -> Passing:
        """The next `count` crossings of motions from states (k x d), none of which takes longer than `longest`.

        `sense` -1 goes backwards in time; the plane's direction is that of the motion forwards. Motions that leave, end
        in a singularity or do not come back have nan. `path(which, times, states)` is told every accepted step,
        `seen` after every step how to get the crossings so far, and how many are done. A `track` is gone on from, and
        kept.
        """
        run = _Run(self, plane, np.asarray(states, float), count, (longest, sense, tolerance), times)
        for line in () if track is None else track.known:
            run.restore(*line)
        due = run.crossed.sum() + STEPS.every * len(states)
        while run.alive.any():
            limit.check()
            run.step(path)
            if track is not None and (run.crossed.sum() >= due or not run.alive.any()):
                track.add(*run.line())
                due = run.crossed.sum() + STEPS.every * len(states)
            if seen is not None:
                seen(run.passing, run.done)
        return run.passing()

    def sampled(self, states: np.ndarray, step: float, count: int, *, tolerance: float = SEEN) -> np.ndarray:
        """States (k x count + 1 x d) of motions at so many steps of time, the first included; nan from an end on."""
        clock = Plane(-1, 0.0, 0, step)
        later = self.passing(clock, states, count, longest=1.5 * step, tolerance=tolerance).states
        return np.concatenate([np.asarray(states, float)[:, None], later], axis=1)

    def along(self, states: np.ndarray, moments: np.ndarray, *, tolerance: float = SEEN, sense: int = 1) -> np.ndarray:
        """States (k x m x d) of motions at the same increasing moments, the first of which is 0; nan from an end on."""
        states_at = np.full((len(states), moments.size, self.size), np.nan)
        states_at[:, 0] = now = np.array(states, float)
        for k in range(1, moments.size):
            span = moments[k] - moments[k - 1]
            well = np.isfinite(now).all(axis=1)
            clock = Plane(-1, span, 0, 0.0)
            there = self.passing(clock, now[well], 1, longest=2 * span, sense=sense, tolerance=tolerance).states[:, 0]
            now = np.full_like(now, np.nan)
            now[well] = states_at[well, k] = there
        return states_at


class _Run:
    """One integration of k motions to their crossings, those `noted` not located yet."""

    LASTING = ("times", "lengths", "since", "crossed", "cells", "alive", "states", "rates")
    """What a step needs of the one before it"""

    def __init__(
        self, crossings: Crossings, plane: Plane, states: np.ndarray, count: int, chosen: tuple[float, int, float],
        times: np.ndarray | float,
    ) -> None:  # fmt: skip
        self.of, self.plane, self.count = crossings, plane, count
        self.longest, self.sense, self.tolerance = chosen
        self.states, k = states.copy(), len(states)
        self.times = np.broadcast_to(np.asarray(times, float), k).copy()
        self.rates = crossings.rates(self.times, states)
        pace = np.abs(self.rates / crossings.units).max(axis=1, initial=0.0)
        self.lengths = np.minimum(0.01 / nonzero(pace), 0.01 * self.longest)  # to a hundredth of a unit
        self.since, self.crossed = np.zeros(k), np.zeros(k, int)
        self.noted, self.located, self.kept = list[np.ndarray](), list[np.ndarray](), 0
        own, going = self._watched(self.times, self.states, self.rates)
        i = self.plane.component
        self.cells = plane.start(own, self.sense * going, 0.0 if i < 0 else float(self.of.units[i]))
        self.alive = np.isfinite(states).all(axis=1) & np.isfinite(self.rates).all(axis=1) & (count > 0)

    @property
    def done(self) -> int:
        """Crossings that have been made, or will not be."""
        return int(np.where(self.alive, self.crossed, self.count).sum())

    def _watched(self, times: np.ndarray, states: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The plane's component and its rate forwards in time; time itself counts from where it began."""
        i = self.plane.component
        return (self.sense * times, np.ones(times.size) * self.sense) if i < 0 else (states[:, i], rates[:, i])

    def step(self, path: Callable[[np.ndarray, np.ndarray, np.ndarray], None] | None) -> None:
        """One step of all motions that are left."""
        here = np.flatnonzero(self.alive)
        h, t, x, before = self.lengths[here], self.times[here], self.states[here], self.rates[here]
        after, error, rates = self.of.stepped(t, x, self.sense * h)
        scale = self.tolerance * np.maximum(np.maximum(np.abs(x), np.abs(after)), self.of.units)
        with np.errstate(all="ignore"):
            norm = np.sqrt(np.mean((error / scale) ** 2, axis=1))
            norm = np.where(np.isfinite(norm) & np.isfinite(rates).all(axis=1), norm, np.inf)
            factor = np.clip(0.8 * norm ** (-1 / 8), 0.2, 5.0)  # a share of what the error allows, within these factors
        good = norm <= 1.0
        turn = np.where(good, self._turn(here, h, (t, x, before), (after, rates)), np.nan)
        short = np.isfinite(turn)  # taken again as far as to the turn
        self.lengths[here] = np.where(short, turn, np.minimum(h * factor, self.longest))
        taken = good & ~short
        if path is not None:
            path(here[taken], t[taken] + self.sense * h[taken], after[taken])
        failed = here[~taken & (self.lengths[here] < STEPS.shortest * self.longest)]
        here, h, after, rates = here[taken], h[taken], after[taken], rates[taken]
        own, _ = self._watched(self.times[here] + self.sense * h, after, rates)
        cells, last = self.plane.cell(own), self.cells[here]
        counts = (cells != last) & (self.plane.direction * self.sense * (cells - last) >= 0)
        self.since[here] += h
        if counts.any():  # noted, and located all together at the end
            who = here[counts]
            level = np.maximum(cells, last)[counts]
            begin = self.crossed[who], self.times[who], h[counts], level, self.states[who]
            self.noted.append(np.column_stack([who, *begin]))
            self.crossed[who] += 1
            self.since[who] = 0.0
        self.times[here] += self.sense * h
        self.states[here], self.rates[here], self.cells[here] = after, rates, cells
        self.alive[here[self.since[here] > self.longest]] = False
        self.alive[self.crossed >= self.count] = False
        self.alive[failed] = False

    def _turn(
        self, here: np.ndarray, h: np.ndarray, begin: tuple[np.ndarray, np.ndarray, np.ndarray],
        end: tuple[np.ndarray, np.ndarray],
    ) -> np.ndarray:  # fmt: skip
        """Where within steps that end on the side on which they began a cubic comes to the plane; else nan."""
        turns = np.full(h.size, np.nan)
        if self.plane.component < 0:
            return turns
        (a, slope), (b, last) = self._watched(*begin), self._watched(begin[0], *end)
        if not (turning := slope * last < 0).any():
            return turns
        a, b, h, cells = a[turning], b[turning], h[turning], self.cells[here[turning]]
        slope, last = slope[turning] * h * self.sense, last[turning] * h * self.sense
        c3, c2 = 2 * (a - b) + slope + last, 3 * (b - a) - 2 * slope - last
        peak = np.full(h.size, np.nan)
        with np.errstate(all="ignore"):
            # of slope + 2 c2 s + 3 c3 s^2 = 0, in the form that loses no digits
            root = np.sqrt(np.maximum(c2**2 - 3 * c3 * slope, 0.0))
            q = -(c2 + np.where(c2 >= 0, root, -root))
            for s in (q / (3 * c3), slope / q):
                height = a + s * (slope + s * (c2 + s * c3))
                other = (self.plane.cell(height) != cells) & (s > 1e-3) & (s < 1 - 1e-3)
                room = STEPS.touching * (np.abs(height - a) + np.abs(height - b))
                away = np.minimum(*(np.abs(self.plane.off(height, cells + k)) for k in (0.0, 1.0)))
                other |= (away < room) & (s > 0.05) & (s < 0.95)
                peak = np.where(other & (self.plane.cell(b) == cells), s * h, peak)
        turns[turning] = peak
        return turns

    def line(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the motions are, and the crossings since the last line."""
        self._locate()
        fresh, self.kept = self.located[self.kept :], len(self.located)
        alive = self.alive | (self.crossed >= self.count)  # which may go on to more crossings
        parts = (alive if name == "alive" else getattr(self, name) for name in self.LASTING)
        return np.column_stack(list(parts)), np.vstack([np.zeros((0, 3 + self.of.size)), *fresh])

    def restore(self, motions: np.ndarray, crossings: np.ndarray) -> None:
        """Go on from a line, maybe of more or fewer motions and crossings."""
        fill([getattr(self, name) for name in self.LASTING], motions)
        self.alive &= self.crossed < self.count
        wanted = (crossings[:, :2] >= 0) & (crossings[:, :2] < [len(self.states), self.count])
        self.located.append(crossings[wanted.all(axis=1)])
        self.kept = len(self.located)

    def passing(self) -> Passing:
        """The crossings so far."""
        self._locate()
        times = np.full((len(self.states), self.count), np.nan)
        states = np.full((*times.shape, self.of.size), np.nan)
        for rows in self.located:
            who, which = rows[:, :2].astype(int).T
            times[who, which], states[who, which] = rows[:, 2], rows[:, 3:]
        return Passing(times, states)

    def _locate(self) -> None:
        """Times and states on the plane of what is noted: Newton's method, within the step, on the step's length."""
        if not self.noted:
            return
        rows, sense, plane, i = np.vstack(self.noted), self.sense, self.plane, self.plane.component
        (t, h, level), x = rows[:, 2:5].T, rows[:, 5:]
        low, high, s, there = np.zeros(h.size), h.copy(), h * 0.5, x.copy()
        below = plane.off(self._watched(t, x, x)[0], level)
        room = 8 * EPSILON * (h + (np.abs(t) if i < 0 else 0.0))  # time is known to its own round-off
        k = np.arange(h.size)  # those that are not there yet: what each comes to depends on no other
        for _ in range(50):
            there[k], _, rates = self.of.stepped(t[k], x[k], sense * s[k])
            own, going = self._watched(t[k] + sense * s[k], there[k], rates)
            off = plane.off(own, level[k])
            same = off * below[k] > 0
            low[k], high[k] = np.where(same, s[k], low[k]), np.where(same, high[k], s[k])
            with np.errstate(all="ignore"):
                trial = s[k] - off / (going * sense)
            trial = np.where((trial >= low[k]) & (trial <= high[k]), trial, 0.5 * (low[k] + high[k]))
            far = np.abs(trial - s[k]) > room[k]
            k = k[far]
            if not k.size:
                break
            s[k] = trial[far]
        if i >= 0 and not plane.cycle:
            there[:, i] = plane.level
        self.located.append(np.column_stack([rows[:, :2], t + sense * s, there]))
        self.noted.clear()
