"""Controlled orbits: found as optima of a nonlinear program, judged by a costate that knows nothing of it.

The evidence starts from what is recorded: state, period, control. DOP853 integrates the motion interval by interval,
the cost with it, and backwards the costate with all its gradients,

    lambda' = -(df/dx)^T lambda - dL/dx,    G_j = integral of (dL/du + (df/du)^T lambda) b_j,

linear in what is not known: lambda at the end, and the multipliers of tasks, pins and active limits. They are fitted
to the conditions of an optimum: the costate closes the loop, every G_j vanishes, as does the derivative by the period
and by each freed parameter. What the fit leaves is reported, relative to the cost; multipliers of inequalities must
have their signs. A control held in a form (steps, splines, harmonics) meets G_j = 0, not H_u = 0 at each instant: how
far it is from that is how far it is from the continuous optimum, and reported too.

Source: A. Bryson, Y. Ho, Applied Optimal Control (1975), sections 2.5, 2.7, 3.1-3.8.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from threading import get_ident
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import lsq_linear

from orbitfinder._runtime.caches import Kept
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.control.program import Optimum, Program, arranged, mirror_of, optimum
from orbitfinder.errors import InputError
from orbitfinder.integrate.dop853 import SECOND, TIGHTEST, ReferenceSettings, Trace, integrate
from orbitfinder.integrate.equations import likeness
from orbitfinder.integrate.field import VectorField, rates_of, vector_field
from orbitfinder.loops.control import Basis, Control, Task
from orbitfinder.loops.ipopt import Callback, SolveSettings
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.scales import control_sizes
from orbitfinder.loops.symmetry import named, related, turned
from orbitfinder.mechanics.controls import actuated
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model, altered, energy, wrapped
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.between import LOOKS, MOST_LOOKS, Rates, overlooked
from orbitfinder.orbits.closure import closes, gap, shift, shift_along
from orbitfinder.orbits.evidence import Recomputed, StatesAt, Tour, in_extents, off_motion
from orbitfinder.orbits.floquet import analyse
from orbitfinder.orbits.measure import provenance
from orbitfinder.records.orbit import SHARE, Orbit
from orbitfinder.records.reading import Entries, Table

SAMPLES = 12
"""Looks at the motion in each step of an interval"""
ACTIVE = 1e-7
"""A limit is active where it is met to this, relative to the range of what it limits"""
VARIED = ReferenceSettings(relative_tolerance=1e-12, absolute_tolerance=1e-13)
SMALL = 1e-9
"""A control is small when it accelerates less than this share of what the motion does"""
IPOPT_TOLERANCE = 1e-10
_functions = Kept[ca.Function](64)


@dataclass(frozen=True)
class ControlledEvidence(Recomputed):
    """What DOP853 and the costate say of a controlled motion.

    `nodes` (N x d) are where segments begin, `second` the closure at a second tolerance, `fit` the cost and the
    conditions of an optimum, `symmetry` how far the motion is off it, `held` what must hold with its least value,
    `off` how far states that a record shows are off the motion, in extents, `unseen` what features of the equations
    narrower than a step change, in extents, and down to which width they were looked for.
    """

    nodes: np.ndarray
    second: float
    fit: Fit
    events: tuple[tuple[str, float, float], ...]
    shift: Mapping[str, float]
    symmetry: float
    held: tuple[tuple[str, float], ...]
    off: float
    unseen: tuple[float, float]


def find_controlled(
    problem: Problem, settings: SolveSettings, report: Callback | None, began: float
) -> tuple[Orbit, Model]:
    """The Orbit of least cost near a guess, without certificate, and its Model.

    Raises `ConvergenceError`, `InputError`.
    """
    del report  # IPOPT's steps are those of a program, not of an orbit
    control = problem.control
    assert control is not None
    program, solution = optimum(problem, control, IPOPT_TOLERANCE)
    return recorded(problem, program, solution, settings, began)


def recorded(
    problem: Problem, program: Program, solution: Optimum, settings: SolveSettings, began: float
) -> tuple[Orbit, Model]:
    """The Orbit of a solved program, and its Model."""
    control, w = program.control, solution.unknowns
    assert problem.control is not None
    values = dict(zip(program.parts.free, map(float, w.free), strict=True))
    model = with_parameters(problem.model, values)
    entry = _entry(problem, program, solution, values)
    entry |= {"numbers": dict(problem.control.numbers)} if problem.control.numbers else {}
    turns = np.asarray(problem.turns, int)
    seen = gather_controlled(model, w.nodes[0], w.period, turns, entry, problem.symmetry, problem.relative)
    fit = seen.fit
    entry |= {"cost": fit.cost, "multipliers": dict(fit.multipliers), "costate": fit.costate.tolist()}
    said = provenance(problem, settings, began)
    said |= {"method": control.method, "iterations": solution.iterations, "steps": program.parts.steps,
             "optimum": "local: that nothing else costs less is not shown"}  # fmt: skip
    said |= {"free": {name: values[name] for name in problem.free}} if problem.free else {}
    orbit = Orbit(
        name=problem.name, title=problem.title, source=problem.source, system=model.system, state=w.nodes[0].copy(),
        period=float(w.period), energy=seen.energy, action=seen.action, closure=seen.closure,
        symmetry=problem.boundary.name, winding=tuple(turns.tolist()),
        floquet_multipliers=seen.floquet.multipliers, pair_defect=0.0, stability=seen.floquet.stability,
        unfolding=tuple(w.unfolding.tolist()), nodes=seen.nodes, times=seen.times, samples=seen.states,
        tolerance=problem.tolerance, expected=problem.expected, provenance=said, shift=seen.shift, control=entry,
    )  # fmt: skip
    return orbit, model


def _entry(problem: Problem, program: Program, solution: Optimum, values: Mapping[str, float]) -> Entries:
    """The `control` entry of orbit.json: what was asked and the control that was found."""
    control = program.control
    return {
        "names": list(program.parts.model.controls),
        "arcs": program.parts.basis.arcs, "shape": control.shape, "intervals": control.intervals,
        "harmonics": control.harmonics,
        "coefficients": solution.coefficients.tolist(),
        "limits": {name: list(pair) for name, pair in program.parts.model.limits.items()},
        "cost_of": control.cost, "average": control.average, "final": control.final,
        "tasks": [{name: value for name, value in vars(task).items() if value is not None} for task in control.tasks],
        "points": program.parts.steps, "method": control.method,
        "free": list(problem.free), "bounds": {name: list(pair) for name, pair in problem.bounds.items()},
        "pins": [pin.name for pin in problem.pin],
        "normals": solution.normals.tolist(),
        "shares": {name: value for name, value in values.items() if name.startswith(SHARE)},
    }  # fmt: skip


def _held_at(values: Mapping[str, float], bounds: Table) -> dict[str, int]:
    """Which of the freed numbers stand at the low (-1) or high (1) end of their range."""
    held = {}
    for name, value in values.items():
        low, high = map(float, bounds.get(name, (-np.inf, np.inf)))
        room = ACTIVE * (high - low) if np.isfinite(high - low) else 0.0
        if value - low <= room or high - value <= room:
            held[name] = -1 if value - low <= room else 1
    return held


class _Controlled:
    """The motion that a record states: its equations, and what DOP853 makes of them and of its costate.

    `parts` is the arrangement over the horizon, `whole` the basis over the period; `pinned` are components of the state
    at t = 0, `period_free` says whether the period was free; `held` are freed parameters (and "period") at an end of
    their range, -1 or 1. Raises `InputError` for what is no record.
    """

    def __init__(
        self, model: Model, entry: Table, symmetry: str, relative: tuple[str, ...], state: np.ndarray,
        period: float,
    ) -> None:  # fmt: skip
        try:
            control = Control(
                entry["cost_of"], entry["shape"], int(entry["intervals"]), int(entry["harmonics"]),
                bool(entry["average"]), str(entry["final"]), tuple(Task(**task) for task in entry["tasks"]),
                entry["method"], numbers=dict(entry.get("numbers", {})),
            )  # fmt: skip
            names, self.coefficients = tuple(entry["names"]), np.array(entry["coefficients"], float)
            limits = {name: tuple(pair) for name, pair in entry["limits"].items()}
            if (model.controls, dict(model.limits)) != (names, limits):
                model = altered(model, controls=names, limits=limits)
            model = with_parameters(actuated(model), entry["shares"])
            boundary = related(named(symmetry, model), model, relative)
            form = model, boundary, tuple(entry["free"]), control, int(entry["points"])
            self.parts = arranged(*form, cycles=model.forcing_cycles(period))
            self.pinned = [model.state_names.index(name) for name in entry["pins"] if name in model.state_names]
            self.normals = np.array(entry["normals"], float).reshape(-1, len(model.state_names))
            self.free = np.array([model.value(name) for name in self.parts.free])
            self.held = _held_at({name: model.value(name) for name in entry["free"]} | {"period": period},
                                 entry["bounds"])  # fmt: skip
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"control: malformed entry ({error}); run the problem again") from error
        self.model, self.start, self.period = model, np.asarray(state, float), period
        self.period_free = "period" not in entry["pins"] and not model.forced
        given, wanted = self.coefficients.shape, (len(names), self.parts.basis.whole)
        if given != wanted or not np.all(np.isfinite(self.coefficients)):
            raise InputError(f"control.coefficients: {given} numbers; {wanted[0]} x {wanted[1]} are needed")
        basis = self.parts.basis
        self.whole = basis if not basis.signs else Basis(basis.shape, 2 * basis.intervals, basis.harmonics)
        self.arcs, self.count = range(max(basis.arcs, 1)), 1 + len(self.parts.means)
        self.boundary = self.parts.symmetry.boundary(model.degrees_of_freedom)
        self.shares = np.linspace(0.0, 1.0, SAMPLES * self.parts.steps + 1)
        self.tasks = (*self.parts.always, *(task for _, task in self.parts.moments))
        self._numbers = [self.given(0, 0.0) for _ in self.arcs]
        self._forward = [vector_field(self._derived(self._forwards, k), self._numbers[k]) for k in self.arcs]
        self._backward = [vector_field(self._derived(self._backwards, k), self._numbers[k]) for k in self.arcs]
        self._pointwise = [self._derived(self._instant, k) for k in self.arcs]

    def _derived(self, derive: Callable[[int], ca.Function], arc: int) -> ca.Function:
        """A function of an arc, derived once in a thread for motions that differ in freed parameters alone."""
        parts, mode = self.parts, self.parts.mode(arc)
        names = (*parts.free, *parts.model.controls)
        key = likeness(mode, names), repr(parts.control), parts.basis, parts.symmetry, mode.parameter_names
        return _functions((derive.__name__, arc, parts.cycles, *key, get_ident()), lambda: derive(arc))

    @cached_property
    def _run(self) -> tuple[list[np.ndarray], list[Trace]]:
        traces = list[Trace]()
        return self._path(TIGHTEST, self.shares, traces), traces

    @property
    def pieces(self) -> list[np.ndarray]:
        """(x, integrals, action) at `shares` of each segment, those of the first from the state."""
        return self._run[0]

    @property
    def traces(self) -> list[Trace]:
        """The steps that were taken in each segment."""
        return self._run[1]

    @cached_property
    def states(self) -> np.ndarray:
        """All states (k x d)."""
        return np.vstack([piece[:, : self.parts.size] for piece in self.pieces])

    @cached_property
    def units(self) -> np.ndarray:
        """The extents (d)."""
        return extents_of(self.model, self.states, self.period)

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """The state after the period, and that at a second tolerance."""
        d, second = self.parts.size, self._path(SECOND, np.array([0.0, 1.0]))
        last = len(second) - 1
        return self.reset(last, self.pieces[-1][-1, :d]), self.reset(last, second[-1][-1, :d])

    def integral(self, number: int) -> float:
        """An integral over the whole period: of the cost, then of what tasks ask on average."""
        return float(self.pieces[-1][-1, self.parts.size + number])

    def given(self, segment: int, *h: float) -> np.ndarray:
        """(phase, its length, local coefficients, free, h if it is there) of a segment of the whole period."""
        local = self.coefficients[:, self.whole.picked(segment)]
        return np.concatenate([self.whole.phases(segment), *local, self.free, h])

    def rates(self, segment: int) -> VectorField:
        """The field of the motion in a segment, until another one is asked for."""
        return self._at(self._forward, segment)

    def _at(self, fields: Sequence[VectorField], segment: int) -> VectorField:
        arc = self.parts.arc(segment)
        self._numbers[arc][:] = self.given(segment, self.duration(segment))
        return fields[arc]

    def duration(self, segment: int) -> float:
        """How long (s) a segment of the whole period lasts."""
        own = segment if self.whole.arcs else min(segment, self.parts.basis.intervals - 1)
        return float(self.parts.duration(own, self.period, ca.DM(self.free)))

    def _symbols(self, arc: int) -> tuple[list[Any], Any, Any, Any, Any]:
        (moment, x, s, given), rate, p, rates = self.parts.driven(arc, ca.SX.sym)
        rate, rates = (ca.substitute(value, s, ca.SX.zeros(s.numel())) for value in (rate, ca.vertcat(*rates)))
        return [moment, x, given], rate, rates, p, ca.SX.sym("h")

    def _forwards(self, arc: int) -> ca.Function:
        """(share, (x, integrals, action), (given, h)) -> their rates by the share."""
        (moment, x, given), rate, rates, p, h = self._symbols(arc)
        more = ca.SX.sym("more", rates.numel() + 1)
        whole = h * ca.vertcat(rate, rates, self.parts.mode(arc).action_rate(0.0, x, p))
        return ca.Function("forward", [moment, ca.vertcat(x, more), ca.vertcat(given, h)], [ca.densify(whole)])

    def _backwards(self, arc: int) -> ca.Function:
        """(1 - share, (x, costates, gradients by coefficients, h, free), (given, h)) -> their rates, backwards."""
        (moment, x, given), rate, rates, _, h = self._symbols(arc)
        d, k, last = x.numel(), rates.numel(), given.numel() - len(self.parts.free)
        columns = d + k
        costates = ca.SX.sym("costates", d, columns)
        every = ca.vertcat(costates, ca.horzcat(ca.SX(k, d), ca.SX.eye(k)))  # those of integrals are 1
        grown = [ca.jacobian(ca.vertcat(rate, rates), by).T @ every for by in (x, given[2:last], given[last:])]
        outputs = [-h * rate, *(ca.vec(h * part) for part in grown), ca.vec(ca.vertcat(rate, rates).T @ every)]
        rest = ca.SX.sym("gradients", columns * (given.numel() - 1))
        whole = ca.Function("inner", [moment, x, costates, given, h], [ca.densify(ca.vertcat(*outputs))])
        tau, flat, both = ca.SX.sym("tau"), ca.vertcat(x, ca.vec(costates), rest), ca.vertcat(given, h)
        return ca.Function("backward", [tau, flat, both], [whole(1 - tau, x, costates, given, h)])

    def back(self, segment: int, j: int) -> list[np.ndarray]:
        """Costates (d x r), gradients by local coefficients, freed parameters and h over step j of a segment, where
        the costates of state and integrals behind it are 1."""
        d, r = self.parts.size, self.parts.size + self.count
        counts = [d, len(self.parts.model.controls) * self.parts.basis.local, len(self.parts.free), 1]
        start = np.zeros(d + sum(counts) * r)
        start[:d] = self.pieces[segment][j * SAMPLES, :d]
        start[d : d + d * r] = np.eye(d, r).ravel("F")
        span = 1.0 - np.array([j, j - 1]) / self.parts.steps
        end = integrate(self._at(self._backward, segment), start, span, VARIED)[-1]
        parts = np.split(end[d:], r * np.cumsum(counts)[:-1])
        return [part.reshape(-1, r, order="F") for part in parts]

    def _instant(self, arc: int) -> ca.Function:
        """(t, x, u, free) -> what `instant` says."""
        model, parts, t = self.parts.mode(arc), self.parts, ca.SX.sym("t")
        x, u, free = (ca.SX.sym("x", parts.size), ca.SX.sym("u", len(parts.model.controls)),
                      ca.SX.sym("free", len(parts.free)))  # fmt: skip
        p = model.parameters((*parts.free, *parts.model.controls), ca.vertcat(free, u))
        rate = model.rate(t, x, p)
        costs = ca.vertcat(
            parts.stated(parts.control.cost, x, p, "control.cost", free),
            *(parts.stated(task.expression, x, p, "task.expression", free) for task in parts.means),
        )
        outputs = (rate, costs, ca.jacobian(rate, u), ca.jacobian(costs, u))
        return ca.Function("pointwise", [t, x, u, free], [ca.densify(value) for value in outputs])

    def instant(self, segment: int, x: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
        """f, L and the tasks' integrands, df/du and the derivatives of these by u, at a state and controls and the time
        at which a segment begins."""
        t = self.parts.time(self.whole.phases(segment)[0])
        return [value.full() for value in self._pointwise[self.parts.arc(segment)](t, x, u, self.free)]

    @cached_property
    def instants(self) -> list[list[np.ndarray]]:
        """The same where segments begin."""
        return [self.instant(k, piece[0, : self.parts.size], self.control(k, np.array([0.0]))[0])
                for k, piece in enumerate(self.pieces)]  # fmt: skip

    def control(self, segment: int, shares: np.ndarray) -> np.ndarray:
        """Controls (k x m) at shares of a segment of the whole period."""
        begins, length = self.whole.phases(segment)
        weights = [[float(w) for w in self.whole.values(share, begins + share * length)] for share in shares]
        return np.asarray(np.array(weights) @ self.coefficients[:, self.whole.picked(segment)].T)

    def _path(
        self, settings: ReferenceSettings, shares: np.ndarray, traces: list[Trace] | None = None
    ) -> list[np.ndarray]:
        """(x, integrals, action) at shares of each segment; events at their ends."""
        d, pieces, more, now = self.parts.size, list[np.ndarray](), np.zeros(self.count + 1), self.start
        for k in range(self.whole.intervals):
            pieces.append(integrate(self.rates(k), np.concatenate([now, more]), shares, settings, 0.25, traces))
            now, more = self.reset(k, pieces[-1][-1, :d]), pieces[-1][-1, d:]
        return pieces

    def reset(self, segment: int, x: np.ndarray) -> np.ndarray:
        """The state after the event that a segment ends with, if it does."""
        event = self.event(segment)
        return x if event is None else np.asarray(event.reset(x, self.parts.model.parameter_values).full().ravel())

    def event(self, segment: int) -> Any:
        """The transition that a segment ends with, or None."""
        if not self.whole.arcs or (segment + 1) % self.whole.each:
            return None
        return self.parts.model.arcs[self.parts.arc(segment)][1]

    def paths(self) -> Iterator[tuple[float, float, StatesAt]]:
        """When each segment begins, how long it lasts (s), its states at times since."""
        lasts = [self.duration(k) for k in range(len(self.pieces))]
        for k, (begin, h) in enumerate(zip(np.cumsum([0.0, *lasts]), lasts, strict=False)):
            yield begin, h, partial(self._since, k)

    def _since(self, k: int, since: np.ndarray) -> np.ndarray:
        """States of a segment at times (s) since its start."""
        shares = since / self.duration(k)
        return integrate(self.rates(k), self.pieces[k][0], shares, TIGHTEST, 0.25)[:, : self.parts.size]


def gather_controlled(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, entry: Table, symmetry: str,
    relative: tuple[str, ...] = (), shown: tuple[np.ndarray, np.ndarray] | None = None,
) -> ControlledEvidence:  # fmt: skip
    """The evidence of a recorded control, and of times and states that are `shown`. Raises `InputError`,
    `IntegrationError`."""
    level, motion = energy(model, state), _Controlled(model, entry, symmetry, relative, state, period)
    d, units, (end, other) = motion.parts.size, motion.units, motion.ends()
    shifted = shift_along(motion.model, relative, motion.start, end, turns)
    whole = turned(motion.model, turns, shifted)
    missed = (end - state - shift(whole, d)) / units
    (fit, transitions), none = _fitted(motion), np.zeros((0, d))
    scaled = in_extents(transitions, units)
    closure = closes(missed, scaled, motion.states / units, _reach(motion, scaled))
    loop = Tour(closure, scaled, none, none, False, units, np.eye(d))
    times, states = _sampled(motion)
    return ControlledEvidence(
        times=times, states=states, extents=units, tour=loop, closure=gap(state, end, whole),
        action=float(motion.pieces[-1][-1, -1]), energy=level, floquet=analyse(loop.map(), conservative=False),
        nodes=np.vstack([piece[:1, :d] for piece in motion.pieces]),
        second=gap(state, other, whole, units), fit=fit, events=tuple(_events(motion)),
        shift=shifted, symmetry=_off_symmetry(motion), held=tuple(_held(motion)),
        off=0.0 if shown is None else off_motion(motion.paths(), *shown, units, period, thinned=True),
        unseen=_unseen(motion),
    )  # fmt: skip


def _unseen(motion: _Controlled) -> tuple[float, float]:
    """What features narrower than a step change along the segments, in extents, and the widest gap between two looks,
    in extents and segments."""
    changed, widest, units = 0.0, 0.0, motion.units
    looks = max(LOOKS, MOST_LOOKS // sum(len(trace.moments) for trace in motion.traces))
    for k, trace in enumerate(motion.traces):
        many, rest = rates_of(motion.rates(k))[0], trace.states.shape[1] - units.size

        def rates(moments: np.ndarray, rows: np.ndarray, many: Rates = many, rest: int = rest) -> np.ndarray:
            whole = np.hstack([rows * units, np.zeros((len(rows), rest))])
            return np.asarray(many(moments, whole)[:, : units.size] / units)

        own = Trace(trace.moments, trace.states[:, : units.size] / units, rates, True)
        change, width, _ = overlooked([own], looks)
        changed, widest = changed + change, max(widest, width)
    return changed, widest


def controlled_samples(orbit: Orbit, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of a controlled orbit over its period, by its record alone. Raises `InputError`."""
    assert orbit.control is not None
    return _sampled(_Controlled(model, orbit.control, orbit.symmetry, tuple(orbit.shift), orbit.state, orbit.period))


def _sampled(motion: _Controlled) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of a picture: instants where segments meet once, those of events twice."""
    times, states = [], []
    for k, (began, h, _) in enumerate(motion.paths()):
        chosen = slice(0, None if k == len(motion.pieces) - 1 or motion.event(k) is not None else -1)
        times.append(began + h * motion.shares[chosen])
        states.append(motion.pieces[k][chosen, : motion.parts.size])
    whole = np.concatenate(times)
    whole[-1] = motion.period
    return whole, np.vstack(states)


def _events(motion: _Controlled) -> Iterator[tuple[str, float, float]]:
    """(name, miss of the guard in periods, how early another crossing comes) of each event of a hybrid motion."""
    d, arc_began, p = motion.parts.size, 0, motion.parts.model.parameter_values
    for k, piece in enumerate(motion.pieces):
        if (event := motion.event(k)) is None:
            continue
        rows = np.vstack([part[:, :d] for part in motion.pieces[arc_began : k + 1]])
        guard = np.array([float(event.guard(x, p)) for x in rows])
        rate = (guard[-1] - guard[-2]) * (len(piece) - 1) / motion.duration(k)
        allowed = np.array([1.0 if event.allowed is None else float(event.allowed(x, p)) for x in rows])
        away = -guard[:-1] * event.direction > 1e-9 * float(np.ptp(guard))  # at its beginning an arc is at its guard
        crossed = away & (guard[1:] * event.direction >= 0) & (allowed[1:] > 0)
        early = float(np.sum(crossed[: -len(piece) // 2]))
        miss = abs(guard[-1] / (rate * motion.period)) if rate * event.direction > 0 and allowed[-1] > 0 else np.inf
        yield event.name, miss, early
        arc_began = k + 1


def _reach(motion: _Controlled, transitions: list[np.ndarray]) -> np.ndarray:
    """What small changes of the controls do to the end of the motion (d x k), each the share of its natural size.

    That is what accelerates as much as the motion does: the true optimum is near in its control as well as its state.
    """
    columns, carried, units = [], np.eye(motion.units.size), motion.units
    for k in reversed(range(len(transitions))):
        carried = carried @ transitions[k]
        by_u = motion.instants[k][2] / units[:, None]
        strength = np.abs(by_u).max(axis=0)
        columns.append(carried @ by_u[:, strength > 0] / strength[strength > 0] / len(transitions))
    return np.hstack(columns)


def _held(motion: _Controlled) -> Iterable[tuple[str, float]]:
    """What must not become negative along the arcs of a hybrid motion, and impulses, each with its least value."""
    model, d, least = motion.parts.model, motion.parts.size, dict[str, float]()
    for k, piece in enumerate(motion.pieces if not model.smooth else ()):
        mode, _ = model.arcs[motion.parts.arc(k)]
        driven, own = motion.control(k, np.linspace(0.0, 1.0, len(piece))), model.parameter_values.copy()
        for x, u in zip(piece[:, :d], driven, strict=True):
            own[[model.parameter_index(name) for name in model.controls]] = u
            for name, value in (mode.holds or {}).items():
                least[name] = min(least.get(name, np.inf), float(value(x, own)))
        if (event := motion.event(k)) is not None and event.impulse is not None:
            name = f"impulse of {event.name}"
            least[name] = min(least.get(name, np.inf), float(event.impulse(piece[-1, :d], model.parameter_values)))
    return least.items()


def _off_symmetry(motion: _Controlled) -> float:
    """How far the second half of a symmetric motion is from the mirrored first, in extents, whole turns apart."""
    parts = motion.parts
    if not parts.basis.signs:
        return 0.0
    nodes = np.vstack([piece[0, : parts.size] for piece in motion.pieces])
    half = len(nodes) // 2
    apart = nodes[half:] - nodes[:half] @ mirror_of(parts.model, parts.symmetry).T
    return float(np.abs(wrapped(apart, parts.model.angular) / motion.units).max())


@dataclass(frozen=True)
class Fit:
    """The multipliers that meet the conditions of an optimum best, and what they leave.

    `left` of the conditions, relative to the cost, at `worst`; `violations` by name how far tasks and limits are
    violated, relative; `phase` what fixing the phase costs, relative; `costate` at t = 0; `pointwise` the largest |H_u|
    relative to its terms, `drift` how far H is from constant, relative; `size` of a cost that is not small.
    """

    cost: float
    size: float
    left: float
    worst: str
    violations: Mapping[str, float]
    multipliers: Mapping[str, float]
    phase: float
    costate: np.ndarray
    pointwise: float
    drift: float


def _fitted(motion: _Controlled) -> tuple[Fit, list[np.ndarray]]:
    """The fit of a motion, and the state-transition matrices of its segments over the whole period."""
    met = _Met(motion)
    signs = _signs(motion, met)
    names = [name for name, _ in signs]
    adjoint = _Adjoint(motion, met, names)
    cost, rows = _conditions(motion, met, adjoint)
    mean = abs(motion.integral(0)) / (motion.period if motion.parts.control.average else 1.0)
    size = nonzero(max(abs(cost), mean, _reference(motion)))
    y, left = _multipliers(np.vstack([row for _, row in rows]), np.array([sign for _, sign in signs], int), size)
    worst = int(left.argmax())
    values = {name: float(value) for name, value in zip(names, y, strict=True)}
    costates = [motion.parts.symmetry.fraction * (matrix @ np.append(y, 1.0)) for matrix in adjoint.costates]
    phases = [abs(value) for name, value in values.items() if name.startswith("phase")]
    fit = Fit(
        cost, size, float(left[worst]), [name for name, row in rows for _ in row][worst], met.violations,
        {name: value for name, value in values.items() if not name.startswith("closing")},
        max(phases, default=0.0) * float(motion.units.max()) / size, costates[0],
        *_hamiltonian(motion, values, costates),
    )  # fmt: skip
    transitions, parts = adjoint.transitions, motion.parts
    if parts.basis.signs:  # of a mirrored half too
        mirror = mirror_of(parts.model, parts.symmetry)
        transitions = transitions + [mirror @ transition @ np.linalg.inv(mirror) for transition in transitions]
    return fit, transitions


class _Met:
    """At which ends of their ranges (-1 or 1; 0 between, and of equations) tasks and limits are, how far all are off.

    `sides` of tasks at a phase, then of those on average; `active` (segment, step, task, side) where what holds always
    holds just so; `bounded` (control, free coefficient, side); `violations` by name, relative.
    """

    def __init__(self, motion: _Controlled) -> None:
        parts = motion.parts
        self.violations, self.sides = dict[str, float](), list[int]()
        self.active, self.bounded = list[tuple[int, int, int, int]](), _bounded(motion)
        shares = np.linspace(0.0, 1.0, SAMPLES + 1)
        driven = np.vstack([motion.control(k, shares) for k in range(motion.whole.intervals)])
        for task in parts.limits:
            own = driven[:, parts.model.controls.index(task.expression)]
            self._violated(f"{task.expression} within limits", own, task)
        if not (motion.tasks or parts.means):
            return
        values = _along(motion, (*motion.tasks, *parts.means))
        nodes = values[: parts.basis.intervals, 0]
        for k, task in enumerate(parts.always):
            self._violated(f"{task.expression} always", values[:, :, k], task)
            size, steps = nonzero(float(np.ptp(values[:, :, k]))), values[: len(nodes), ::SAMPLES, k]
            self.active += [(segment, j, k, side) for segment, j in np.ndindex(steps.shape)
                            if (side := _side_of(task, float(steps[segment, j]), size))]  # fmt: skip
        instants = [(f"{task.expression} at {task.at:g}", task, nodes[at, len(parts.always) + k])
                    for k, (at, task) in enumerate(parts.moments)]  # fmt: skip
        means = [(f"mean {task.expression}", task, motion.integral(1 + k) / motion.period)
                 for k, task in enumerate(parts.means)]  # fmt: skip
        for k, (name, task, value) in enumerate([*instants, *means], len(parts.always)):
            size = nonzero(float(np.ptp(nodes[:, k])))
            self._violated(name, np.array([value]), task, size)
            self.sides.append(_side_of(task, value, size))

    def _violated(self, name: str, values: np.ndarray, task: Task, size: float = 0.0) -> None:
        bounds = [abs(bound) for bound in (task.low, task.high) if np.isfinite(bound)]
        size = nonzero(max(*bounds, size, float(np.ptp(values))))
        worst = float(np.maximum(task.low - values, values - task.high).max()) / size
        self.violations[name] = max(self.violations.get(name, 0.0), worst)


def _side_of(task: Task, value: float, size: float) -> int:
    """-1 or 1 where a value stands at an end of its range, 0 elsewhere; equations have no sign."""
    if task.equals is not None:
        return 0
    if abs(value - task.low) <= ACTIVE * size:
        return -1
    return 1 if abs(value - task.high) <= ACTIVE * size else 0


def _along(motion: _Controlled, tasks: Sequence[Task]) -> np.ndarray:
    """Expressions of tasks (segments x looks x k) along a motion."""
    parts, values = motion.parts, []
    functions = [parts.watched(arc, tasks) for arc in motion.arcs]
    for segment, piece in enumerate(motion.pieces):
        function, x = functions[parts.arc(segment)], piece[:, : parts.size].T
        given = np.zeros(function.size1_in(2)), motion.given(segment), motion.period
        values.append(function(motion.shares[None], x, *given).full().T)
    return np.array(values)


def _bounded(motion: _Controlled) -> list[tuple[int, int, int]]:
    """(control, free coefficient, side) of coefficients at a limit."""
    parts, bounded = motion.parts, list[tuple[int, int, int]]()
    for i, name in enumerate(parts.model.controls):
        if not parts.bounded or name not in parts.model.limits:
            continue
        low, high = parts.model.limits[name]
        size = high - low if np.isfinite(high - low) else max(abs(x) for x in (low, high) if np.isfinite(x))
        shape = parts.basis.free(i)
        for j, value in enumerate(np.linalg.lstsq(shape, motion.coefficients[i], rcond=None)[0]):
            reach = (shape[:, j] * value)[shape[:, j] != 0]
            if np.any(reach - low <= ACTIVE * size):
                bounded.append((i, j, -1 if value - low <= ACTIVE * size else 1))
            elif np.any(high - reach <= ACTIVE * size):
                bounded.append((i, j, 1 if high - value <= ACTIVE * size else -1))
    return bounded


def _signs(motion: _Controlled, met: _Met) -> list[tuple[str, int]]:
    """The multipliers by name, each with the sign that it must have, 0 of what may have any."""
    parts, controls = motion.parts, motion.parts.model.controls
    free = [
        *(f"closing {k}" for k in range(len(motion.boundary[0]))),
        *(f"pin {parts.model.state_names[k]}" for k in motion.pinned),
        *(f"phase {k}" for k in range(len(motion.normals))),
    ]
    events = [(motion.event(k), k) for k in range(parts.basis.intervals)]
    return [
        *((name, 0) for name in free),
        *zip(map(_label, (*(task for _, task in parts.moments), *parts.means)), met.sides, strict=True),
        *((f"event {event.name} {k}", 0) for event, k in events if event is not None),
        *((f"limit {parts.always[task].expression} {k}.{j}", side) for k, j, task, side in met.active),
        *((f"bound {controls[i]} {j}", side) for i, j, side in met.bounded),
        *((f"held {name}", side) for name, side in motion.held.items()),
    ]


def _label(task: Task) -> str:
    return f"mean {task.expression}" if task.at == "mean" else f"task {task.expression} at {task.at}"


def _slopes(name: str, inputs: list[Any], value: Any, by: Sequence[Any]) -> ca.Function:
    """The derivatives of a value by some of its inputs."""
    return ca.Function(name, inputs, [ca.densify(ca.jacobian(value, x)) for x in by])


class _Adjoint:
    """The costate and the gradients by coefficients, freed parameters and the period, gathered backwards along a
    motion: a column for each of the multipliers of these names, which are not known, and a last one for what is.

    `costates` (d x columns each) are those where segments begin, `transitions` the state-transition matrices of the
    segments, the time of the events that they end with eliminated.
    """

    def __init__(self, motion: _Controlled, met: _Met, names: Sequence[str]) -> None:
        parts, columns = motion.parts, len(names) + 1
        self.motion, self.parts, self.place = motion, parts, {name: k for k, name in enumerate(names)}
        per = motion.period * parts.symmetry.fraction
        self.weights = np.zeros((motion.count, columns))
        self.weights[0, -1] = 1.0 / (per if parts.control.average else parts.symmetry.fraction)
        for k, task in enumerate(parts.means):
            self.weights[1 + k, self.place[_label(task)]] = 1.0 / per
        self.costate = np.zeros((parts.size, columns))
        self.costate[:, : len(motion.boundary[1])] = motion.boundary[1].T
        self.by_coefficients = np.zeros((len(parts.model.controls) * parts.basis.whole, columns))
        self.by_period, self.by_free = np.zeros(columns), np.zeros((len(parts.free), columns))
        self.costates, self.transitions = list[np.ndarray](), list[np.ndarray]()
        self._tasks = [self._pushes(arc) for arc in motion.arcs] if met.active or parts.moments else []
        for segment in reversed(range(parts.basis.intervals)):
            saltation = self._through(segment)
            transition = self._back(segment, met)
            self.transitions.append(transition if saltation is None else saltation @ transition)
            self.costates.append(self.costate.copy())
            for row, (where, task) in enumerate(parts.moments, len(parts.always)):
                if where == segment:
                    self._pushed(_label(task), segment, 0, row)
        self.costates.reverse()
        self.transitions.reverse()

    def _pushes(self, arc: int) -> ca.Function:
        """(share, x, given, period) -> d/dx, d/dgiven, d/dperiod of tasks."""
        function = self.parts.watched(arc, self.motion.tasks)
        share, x, period = ca.SX.sym("share"), ca.SX.sym("x", self.parts.size), ca.SX.sym("period")
        given = ca.SX.sym("given", function.size1_in(3))
        value = function(share, x, ca.SX.zeros(function.size1_in(2)), given, period)
        return _slopes("tasks", [share, x, given, period], value, (x, given, period))

    def _pushed(self, name: str, segment: int, j: int, row: int) -> None:
        """The jump of the costate, and the gradients, of a task at an instant, step j of a segment."""
        x, given = self.motion.pieces[segment][j * SAMPLES, : self.parts.size], self.motion.given(segment)
        slopes = self._tasks[self.parts.arc(segment)](j / self.parts.steps, x, given, self.motion.period)
        by_x, by_given, by_period = (slope.full()[row] for slope in slopes)
        column, last = self.place[name], by_given.size - len(self.parts.free)
        self.costate[:, column] += by_x
        np.add.at(self.by_coefficients[:, column], self._picked(segment), by_given[2:last])
        self.by_free[:, column] += by_given[last:]
        self.by_period[column] += by_period[0]

    def _picked(self, segment: int) -> np.ndarray:
        """Where the coefficients of a segment are among those of all controls."""
        basis = self.parts.basis
        return np.concatenate([i * basis.whole + basis.picked(segment) for i in range(len(self.parts.model.controls))])

    def _through(self, segment: int) -> np.ndarray | None:
        """The costate before the event that a segment ends with, from that after it; DR (1 - f grad g / (grad g . f)),
        as the clock of the control begins again with each arc."""
        event, motion = self.motion.event(segment), self.motion
        if event is None:
            return None
        state, free = ca.MX.sym("x", self.parts.size), ca.MX.sym("free", len(self.parts.free))
        p, x = self.parts.model.parameters(self.parts.free, free), motion.pieces[segment][-1, : self.parts.size]
        (by_x, by_p), (guard_x, guard_p) = (
            [slope.full() for slope in _slopes("event", [state, free], value, (state, free))(x, motion.free)]
            for value in (event.reset(state, p), event.guard(state, p))
        )
        column = self.place[f"event {event.name} {segment}"]
        self.by_free += by_p.T @ self.costate
        self.costate = by_x.T @ self.costate
        self.costate[:, column] += guard_x.ravel()
        self.by_free[:, column] += guard_p.ravel()
        rate = motion.instant(segment, x, motion.control(segment, np.array([1.0]))[0])[0]
        return np.asarray(by_x @ (np.eye(x.size) - rate @ guard_x / (guard_x @ rate).item()))

    def _back(self, segment: int, met: _Met) -> np.ndarray:
        """To where a segment begins, with its state-transition matrix."""
        parts, motion, d = self.parts, self.motion, self.parts.size
        h, total, picked = motion.duration(segment), np.eye(d), self._picked(segment)
        for j in reversed(range(parts.steps + 1)):
            for where, step, task, _ in met.active:
                if (where, step) == (segment, j):
                    self._pushed(f"limit {parts.always[task].expression} {segment}.{j}", segment, j, task)
            if j == 0:
                return total
            piece = motion.back(segment, j)
            grown = [part[:, :d] @ self.costate + part[:, d:] @ self.weights for part in piece]
            self.costate, by_coefficients, by_free, by_h = grown
            np.add.at(self.by_coefficients, picked, by_coefficients)
            self.by_free += by_free
            self.by_period += by_h[0] * h / motion.period
            self._by_shares(by_h[0], parts.arc(segment))
            total = total @ piece[0][:, :d].T
        return total

    def _by_shares(self, by_h: np.ndarray, arc: int) -> None:
        """Gradients by the durations of arcs."""
        basis = self.parts.basis
        if basis.arcs < 2:
            return
        first = len(self.parts.free) - (basis.arcs - 1)
        slope = self.motion.period / basis.each
        if arc < basis.arcs - 1:
            self.by_free[first + arc] += by_h * slope
        else:
            self.by_free[first:] -= by_h * slope


def _conditions(motion: _Controlled, met: _Met, adjoint: _Adjoint) -> tuple[float, list[tuple[str, np.ndarray]]]:
    """The cost, and the rows of all conditions by name, in units of cost, over the columns of the costate."""
    parts, basis, place = motion.parts, motion.parts.basis, adjoint.place
    integral, average = motion.integral(0), parts.control.average
    final, by_x, by_p, by_t = _final(motion)
    start, by_period, by_free = adjoint.costate.copy(), adjoint.by_period.copy(), adjoint.by_free.copy()
    start[:, : len(motion.boundary[0])] += motion.boundary[0].T
    for k in motion.pinned:
        start[k, place[f"pin {parts.model.state_names[k]}"]] += 1.0
    for k, row in enumerate(motion.normals):
        start[:, place[f"phase {k}"]] += row
    start[:, -1] += by_x
    by_free[:, -1] += by_p
    by_period[-1] += by_t - (integral / motion.period**2 if average else 0.0)
    for k, task in enumerate(parts.means):
        by_period[place[_label(task)]] -= motion.integral(1 + k) / motion.period**2
    rows = [("costate closes", start * motion.units[:, None])]
    for i, name in enumerate(parts.model.controls):
        own = basis.free(i).T @ adjoint.by_coefficients[i * basis.whole : (i + 1) * basis.whole]
        for control, j, _ in met.bounded:
            if control == i:
                own[j, place[f"bound {name} {j}"]] += 1.0
        rows.append((f"control {name}", own * max(float(np.abs(motion.coefficients[i]).max()), SMALL)))
    if motion.period_free:
        if "period" in motion.held:
            by_period[place["held period"]] += 1.0
        rows.append(("period", by_period[None] * motion.period))
    for k, name in enumerate(parts.free):
        row = by_free[k] * nonzero(abs(motion.free[k]))
        if name in motion.held:
            row[place[f"held {name}"]] += 1.0
        rows.append((name, row[None]))
    return integral / (motion.period if average else 1.0) + final, rows


def _final(motion: _Controlled) -> tuple[float, np.ndarray, np.ndarray, float]:
    """The cost that is no integral, and its derivatives by the state, freed parameters and the period."""
    parts = motion.parts
    inputs = [ca.MX.sym("x", parts.size), ca.MX.sym("free", len(parts.free)), ca.MX.sym("period")]
    value = parts.final()(*inputs)
    whole = ca.Function("final", inputs, [value, *(ca.densify(ca.gradient(value, by)) for by in inputs)])
    begin = motion.pieces[0][0, : parts.size]
    value, by_x, by_p, by_t = (number.full().ravel() for number in whole(begin, motion.free, motion.period))
    return float(value[0]), by_x, by_p, float(by_t[0])


def _reference(motion: _Controlled) -> float:
    """A cost that is small: what controls cost that accelerate `SMALL` of what the motion does."""
    parts, largest = motion.parts, 0.0
    for piece in motion.pieces[: parts.basis.intervals]:
        x, u = piece[0, : parts.size], np.zeros(len(parts.model.controls))
        _, idle, by_u, _ = motion.instant(0, x, u)
        strong = np.abs(by_u / motion.units[:, None]).max(axis=0)
        costs = motion.instant(0, x, control_sizes(strong, motion.period, 0.0))[1]
        largest = max(largest, abs(float(costs[0, 0] - idle[0, 0])))
    return largest * SMALL * (1.0 if parts.control.average else motion.period)


def _multipliers(rows: np.ndarray, signs: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """The multipliers, of these signs, that meet rows best, and what is left of each row, relative to a size."""
    matrix, right = rows[:, :-1], -rows[:, -1]
    widths = nonzero(np.abs(matrix).max(axis=0, initial=0.0))
    y = np.linalg.lstsq(matrix / widths, right, rcond=1e-13)[0]
    if np.any((signs != 0) & (y * signs < -1e-9 * size)):
        low, high = np.where(signs > 0, 0.0, -np.inf), np.where(signs < 0, 0.0, np.inf)
        y = lsq_linear(matrix / widths, right, (low, high), method="bvls", tol=1e-14).x
    return y / widths, np.abs(matrix / widths @ y - right) / size


def _hamiltonian(motion: _Controlled, values: Mapping[str, float], costates: list[np.ndarray]) -> tuple[float, float]:
    """|H_u| and the drift of H at the nodes, relative to their terms, by multipliers and costates (d each)."""
    parts, weights = motion.parts, np.zeros(motion.count)
    weights[0] = 1.0 / (motion.period if parts.control.average else 1.0)
    for k, task in enumerate(parts.means):
        weights[1 + k] = values[_label(task)] / motion.period
    levels, slopes, terms, sizes = [], [], [], []
    for costate, (rate, costs, by_u, cost_by_u) in zip(costates, motion.instants, strict=False):
        levels.append(float(weights @ costs.ravel() + costate @ rate.ravel()))
        sizes.append(abs(float(weights @ costs.ravel())) + float(np.abs(costate * rate.ravel()).sum()))
        slopes.append(np.abs(weights @ cost_by_u + costate @ by_u).max(initial=0.0))
        terms.append(np.abs(costate @ by_u).max(initial=0.0))
    arcs = np.array_split(np.array(levels), max(parts.basis.arcs, 1))
    return float(max(slopes) / nonzero(max(terms))), float(max(np.ptp(arc) for arc in arcs) / nonzero(max(sizes)))
