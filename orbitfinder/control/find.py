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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import lsq_linear

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.control.program import Program, Solution, arranged, optimum
from orbitfinder.errors import InputError
from orbitfinder.integrate.dop853 import (
    SECOND,
    TIGHTEST,
    ReferenceSettings,
    Trace,
    VectorField,
    integrate,
    rates_of,
    vector_field,
)
from orbitfinder.loops.control import Basis, Control, Task
from orbitfinder.loops.ipopt import Callback, SolveSettings
from orbitfinder.loops.problem import Problem
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

SAMPLES = 12
"""Looks at the motion in each step of an interval"""
ACTIVE = 1e-7
"""A limit is active where it is met to this, relative to the range of what it limits"""
VARIED = ReferenceSettings(relative_tolerance=1e-12, absolute_tolerance=1e-13)
SMALL = 1e-9
"""A control is small when it accelerates less than this share of what the motion does"""
IPOPT_TOLERANCE = 1e-10
NEAR = 1e-9
"""A guard is at 0 to this, relative to its range along an arc"""


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
    problem: Problem, program: Program, solution: Solution, settings: SolveSettings, began: float
) -> tuple[Orbit, Model]:
    """The Orbit of a solved program, and its Model."""
    control, w = program.control, solution.unknowns
    assert problem.control is not None
    values = dict(zip(program.parts.free, map(float, w.free), strict=True))
    model = with_parameters(problem.model, values)
    entry = _entry(problem, program, solution, values)
    entry |= {"numbers": dict(problem.control.numbers)} if problem.control.numbers else {}
    turns = np.asarray(problem.turns, int)
    found = gather_controlled(model, w.nodes[0], w.period, turns, entry, problem.symmetry, problem.relative)
    fit = found.fit
    entry |= {"cost": fit.cost, "multipliers": dict(fit.multipliers), "costate": [float(x) for x in fit.costate]}
    said = provenance(problem, settings, began)
    said |= {"method": control.method, "iterations": solution.iterations, "steps": program.parts.steps,
             "optimum": "local: that nothing else costs less is not shown"}  # fmt: skip
    said |= {"free": {name: values[name] for name in problem.free}} if problem.free else {}
    orbit = Orbit(
        name=problem.name, title=problem.title, source=problem.source, system=model.system, state=w.nodes[0].copy(),
        period=float(w.period), energy=found.energy, action=found.action, closure=found.closure,
        symmetry=problem.boundary.name, winding=tuple(int(k) for k in turns),
        floquet_multipliers=found.floquet.multipliers, pair_defect=0.0, stability=found.floquet.stability,
        unfolding=tuple(float(one) for one in w.unfolding), nodes=found.nodes, times=found.times, samples=found.states,
        tolerance=problem.tolerance, expected=problem.expected, provenance=said, shift=found.shift, control=entry,
    )  # fmt: skip
    return orbit, model


def _entry(problem: Problem, program: Program, solution: Solution, values: Mapping[str, float]) -> dict[str, Any]:
    """The `control` entry of orbit.json: what was asked and the control that was found."""
    control = program.control
    return {
        "names": list(program.parts.model.controls),
        "arcs": program.parts.basis.arcs, "shape": control.shape, "intervals": control.intervals,
        "harmonics": control.harmonics,
        "coefficients": [[float(x) for x in row] for row in solution.coefficients],
        "limits": {name: list(pair) for name, pair in program.parts.model.limits.items()},
        "cost_of": control.cost, "average": control.average, "final": control.final,
        "tasks": [{name: value for name, value in vars(one).items() if value is not None} for one in control.tasks],
        "points": program.parts.steps, "method": control.method,
        "free": list(problem.free), "bounds": {name: list(pair) for name, pair in problem.bounds.items()},
        "pins": [one.name for one in problem.pin],
        "normals": [[float(x) for x in row] for row in solution.normals],
        "shares": {name: value for name, value in values.items() if name.startswith(SHARE)},
    }  # fmt: skip


def _held_at(values: Mapping[str, float], bounds: Mapping[str, Any]) -> dict[str, int]:
    """Which of the freed numbers stand at the low (-1) or high (1) end of their range."""
    found = {}
    for name, value in values.items():
        low, high = map(float, bounds.get(name, (-np.inf, np.inf)))
        room = ACTIVE * (high - low) if np.isfinite(high - low) else 0.0
        if value - low <= room or high - value <= room:
            found[name] = -1 if value - low <= room else 1
    return found


class _Motion:
    """The motion that a record states and its costate, integrated by DOP853.

    `parts` is the arrangement over the horizon, `whole` the basis over the period; `pinned` are components of the state
    at t = 0, `period_free` says whether the period was free; `held` are freed parameters (and "period") at an end of
    their range, -1 or 1. Raises `InputError` for what is no record.
    """

    def __init__(
        self, model: Model, entry: Mapping[str, Any], symmetry: str, relative: tuple[str, ...], period: float
    ) -> None:
        try:
            control = Control(
                entry["cost_of"], entry["shape"], int(entry["intervals"]), int(entry["harmonics"]),
                bool(entry["average"]), str(entry["final"]), tuple(Task(**one) for one in entry["tasks"]),
                entry["method"], numbers=dict(entry.get("numbers", {})),
            )  # fmt: skip
            names, self.coefficients = tuple(entry["names"]), np.array(entry["coefficients"], float)
            limits = {name: tuple(pair) for name, pair in entry["limits"].items()}
            model = with_parameters(actuated(altered(model, controls=names, limits=limits)), entry["shares"])
            boundary = related(named(symmetry, model), model, relative)
            self.parts = arranged(model, boundary, tuple(entry["free"]), control, int(entry["points"]))
            self.pinned = [model.state_names.index(name) for name in entry["pins"] if name in model.state_names]
            self.normals = np.array(entry["normals"], float).reshape(-1, len(model.state_names))
            self.free = np.array([model.parameter_values[model.parameter_index(one)] for one in self.parts.free])
            free = {name: float(model.parameter_values[model.parameter_index(name)]) for name in entry["free"]}
            self.held = _held_at(free | {"period": period}, entry["bounds"])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"control: malformed entry ({error}); run the problem again") from error
        self.model, self.period, self.period_free = model, period, "period" not in entry["pins"]
        found, wanted = self.coefficients.shape, (len(names), self.parts.basis.whole)
        if found != wanted or not np.all(np.isfinite(self.coefficients)):
            raise InputError(f"control.coefficients: {found} numbers; {wanted[0]} x {wanted[1]} are needed")
        basis = self.parts.basis
        self.whole = basis if not basis.signs else Basis(basis.shape, 2 * basis.intervals, basis.harmonics)
        arcs = range(max(basis.arcs, 1))
        self.numbers = [self.given(0, 0.0) for _ in arcs]
        self.forward = [vector_field(self._forward(k), self.numbers[k]) for k in arcs]
        self.backward = [vector_field(self._backward(k), self.numbers[k]) for k in arcs]
        self.pointwise = [self._pointwise(k) for k in arcs]
        self.count = 1 + len(self.parts.means)

    def given(self, segment: int, *h: float) -> np.ndarray:
        """(phase, its length, local coefficients, free, h if it is there) of a segment of the whole period."""
        local = self.coefficients[:, self.whole.picked(segment)]
        return np.concatenate([self._phases(segment), *local, self.free, h])

    def _phases(self, segment: int) -> tuple[float, float]:
        """The phase at which a segment begins, and its length."""
        count = self.whole.intervals
        return (0.0, 0.0) if self.whole.arcs else (segment / count, 1.0 / count)

    def at(self, fields: Sequence[VectorField], segment: int) -> VectorField:
        """That of the arcs' fields which is a segment's, with its numbers, until another one is asked for."""
        arc = self.parts.arc(segment)
        self.numbers[arc][:] = self.given(segment, self.duration(segment))
        return fields[arc]

    def duration(self, segment: int) -> float:
        """How long (s) a segment of the whole period lasts."""
        own = segment if self.whole.arcs else min(segment, self.parts.basis.intervals - 1)
        return float(self.parts.duration(own, self.period, ca.DM(self.free)))

    def _symbols(self, arc: int) -> tuple[list[Any], Any, Any, Any, Any]:
        inputs, rate, p, rates = self.parts.driven(arc, ca.SX.sym)
        moment, x, s, given = inputs
        rate, rates = (ca.substitute(one, s, ca.SX.zeros(s.numel())) for one in (rate, ca.vertcat(*rates)))
        return [moment, x, given], rate, rates, p, ca.SX.sym("h")

    def _forward(self, arc: int) -> ca.Function:
        """(share, (x, integrals, action), (given, h)) -> their rates by the share."""
        (moment, x, given), rate, rates, p, h = self._symbols(arc)
        more = ca.SX.sym("more", rates.numel() + 1)
        action = self.parts.mode(arc).action_rate(0.0, x, p)
        found = h * ca.vertcat(rate, rates, action)
        return ca.Function("forward", [moment, ca.vertcat(x, more), ca.vertcat(given, h)], [ca.densify(found)])

    def _backward(self, arc: int) -> ca.Function:
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

    def _pointwise(self, arc: int) -> ca.Function:
        """(x, u, free) -> what `instant` says."""
        model, parts = self.parts.mode(arc), self.parts
        x, u, free = (ca.SX.sym("x", parts.size), ca.SX.sym("u", len(parts.model.controls)),
                      ca.SX.sym("free", len(parts.free)))  # fmt: skip
        p = model.parameters((*parts.free, *parts.model.controls), ca.vertcat(free, u))
        rate = model.rate(0.0, x, p)
        cost = parts.stated(parts.control.cost, x, p, "control.cost", free)
        costs = ca.vertcat(cost, *(parts.stated(one.expression, x, p, "task.expression", free) for one in parts.means))
        outputs = (rate, costs, ca.jacobian(rate, u), ca.jacobian(costs, u))
        return ca.Function("pointwise", [x, u, free], [ca.densify(one) for one in outputs])

    def instant(self, segment: int, x: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
        """f, L and the tasks' integrands, df/du and the derivatives of these by u, at a state and controls."""
        return [one.full() for one in self.pointwise[self.parts.arc(segment)](x, u, self.free)]

    def control(self, segment: int, shares: np.ndarray) -> np.ndarray:
        """Controls (k x m) at shares of a segment of the whole period."""
        begins, length = self._phases(segment)
        weights = [[float(w) for w in self.whole.values(share, begins + share * length)] for share in shares]
        return np.asarray(np.array(weights) @ self.coefficients[:, self.whole.picked(segment)].T)

    def path(
        self, state: np.ndarray, settings: ReferenceSettings, shares: np.ndarray, traces: list[Trace] | None = None
    ) -> list[np.ndarray]:
        """(x, integrals, action) at shares of each segment, those of the first from the state; events at their ends."""
        d, found, more = self.parts.size, [], np.zeros(self.count + 1)
        now = np.asarray(state, float)
        for k in range(self.whole.intervals):
            begin = np.concatenate([now, more])
            found.append(integrate(self.at(self.forward, k), begin, shares, settings, 0.25, traces))
            now, more = found[-1][-1, :d], found[-1][-1, d:]
            now = self.reset(k, now)
        return found

    def reset(self, segment: int, x: np.ndarray) -> np.ndarray:
        """The state after the event that a segment ends with, if it does."""
        one = self.event(segment)
        return x if one is None else np.asarray(one.reset(x, self.parts.model.parameter_values).full().ravel())

    def event(self, segment: int) -> Any:
        """The transition that a segment ends with, or None."""
        if not self.whole.arcs or (segment + 1) % self.whole.each:
            return None
        return self.parts.model.hybrid.arcs[self.parts.arc(segment)][1]


def gather_controlled(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, entry: Mapping[str, Any], symmetry: str,
    relative: tuple[str, ...] = (), shown: tuple[np.ndarray, np.ndarray] | None = None,
) -> ControlledEvidence:  # fmt: skip
    """The evidence of a recorded control, and of times and states that are `shown`. Raises `InputError`,
    `IntegrationError`."""
    level, motion = energy(model, state), _Motion(model, entry, symmetry, relative, period)
    model, d = motion.model, motion.parts.size
    shares = np.linspace(0.0, 1.0, SAMPLES * motion.parts.steps + 1)
    pieces = motion.path(state, TIGHTEST, shares, traces := list[Trace]())
    second = motion.path(state, SECOND, np.array([0.0, 1.0]))
    last = len(pieces) - 1
    end, other = motion.reset(last, pieces[-1][-1, :d]), motion.reset(last, second[-1][-1, :d])
    states = np.vstack([piece[:, :d] for piece in pieces])
    units = extents_of(model, states, period)
    shifted = shift_along(model, relative, np.asarray(state, float), end, turns)
    whole = turned(model, turns, shifted)
    missed = (end - state - shift(whole, d)) / units
    fit, none = Fit(motion, pieces, units), np.zeros((0, d))
    scaled = in_extents(fit.transitions, units)
    found = closes(missed, scaled, states / units, _reach(motion, pieces, scaled, units))
    loop = Tour(found, scaled, none, none, False, units, np.eye(d))
    times, kept = _sampled(motion, pieces, shares)
    return ControlledEvidence(
        times=times, states=kept, extents=units, tour=loop, closure=gap(state, end, whole),
        action=float(pieces[-1][-1, -1]), energy=level, floquet=analyse(loop.map(), conservative=False),
        nodes=np.vstack([piece[:1, :d] for piece in pieces]),
        second=gap(state, other, whole, units), fit=fit, events=tuple(_events(motion, pieces)),
        shift=shifted, symmetry=_off_symmetry(motion, pieces, units), held=tuple(_held(motion, pieces)),
        off=0.0 if shown is None else off_motion(_paths(motion, pieces), *shown, units, period, thinned=True),
        unseen=_unseen(motion, traces, units),
    )  # fmt: skip


def _unseen(motion: _Motion, traces: list[Trace], units: np.ndarray) -> tuple[float, float]:
    """What features narrower than a step change along the segments, in extents, and the widest gap between two looks,
    in extents and segments."""
    changed, widest, looks = 0.0, 0.0, max(LOOKS, MOST_LOOKS // sum(len(one.moments) for one in traces))
    for k, trace in enumerate(traces):
        many, rest = rates_of(motion.at(motion.forward, k))[0], trace.states.shape[1] - units.size

        def rates(moments: np.ndarray, rows: np.ndarray, many: Rates = many, rest: int = rest) -> np.ndarray:
            rest_of = np.zeros((len(rows), rest))
            return np.asarray(many(moments, np.hstack([rows * units, rest_of]))[:, : units.size] / units)

        found, width, _ = overlooked(Trace(trace.moments, trace.states[:, : units.size] / units, rates, True), looks)
        changed, widest = changed + found, max(widest, width)
    return changed, widest


def _sampled(motion: _Motion, pieces: list[np.ndarray], shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of a picture: instants where segments meet once, those of events twice."""
    times, states = [], []
    for k, (began, h, _) in enumerate(_paths(motion, pieces)):
        chosen = slice(0, None if k == len(pieces) - 1 or motion.event(k) is not None else -1)
        times.append(began + h * shares[chosen])
        states.append(pieces[k][chosen, : motion.parts.size])
    found = np.concatenate(times)
    found[-1] = motion.period
    return found, np.vstack(states)


def _paths(motion: _Motion, pieces: list[np.ndarray]) -> Iterator[tuple[float, float, StatesAt]]:
    """When each segment begins, how long it lasts (s), its states at times since."""
    lasts = [motion.duration(k) for k in range(len(pieces))]
    for k, (begin, h) in enumerate(zip(np.cumsum([0.0, *lasts]), lasts, strict=False)):
        yield begin, h, partial(_path, motion, k, pieces[k][0])


def _path(motion: _Motion, k: int, start: np.ndarray, since: np.ndarray) -> np.ndarray:
    """States of a segment at times (s) since its start."""
    field = motion.at(motion.forward, k)
    return integrate(field, start, since / motion.duration(k), TIGHTEST, 0.25)[:, : motion.parts.size]


def _events(motion: _Motion, pieces: list[np.ndarray]) -> Any:
    """(name, miss of the guard in periods, how early another crossing comes) of each event of a hybrid motion."""
    d, arc_began = motion.parts.size, 0
    for k, piece in enumerate(pieces):
        one, p = motion.event(k), motion.parts.model.parameter_values
        if one is None:
            continue
        rows = np.vstack([part[:, :d] for part in pieces[arc_began : k + 1]])
        guard = np.array([float(one.guard(x, p)) for x in rows])
        rate = (guard[-1] - guard[-2]) * (len(piece) - 1) / motion.duration(k)
        allowed = np.array([1.0 if one.allowed is None else float(one.allowed(x, p)) for x in rows])
        away = -guard[:-1] * one.direction > NEAR * float(np.ptp(guard))  # at its beginning an arc is at its guard
        crossed = away & (guard[1:] * one.direction >= 0) & (allowed[1:] > 0)
        early = float(np.sum(crossed[: -len(piece) // 2]))
        miss = abs(guard[-1] / (rate * motion.period)) if rate * one.direction > 0 and allowed[-1] > 0 else np.inf
        yield one.name, miss, early
        arc_began = k + 1


def _reach(motion: _Motion, pieces: list[np.ndarray], transitions: list[np.ndarray], units: np.ndarray) -> np.ndarray:
    """What small changes of the controls do to the end of the motion (d x k), each the share of its natural size.

    That is what accelerates as much as the motion does: the true optimum is near in its control as well as its state.
    """
    columns, carried = [], np.eye(units.size)
    for k in reversed(range(len(pieces))):
        carried = carried @ transitions[k]
        x, u = pieces[k][0, : units.size], motion.control(k, np.array([0.0]))[0]
        by_u = motion.instant(k, x, u)[2] / units[:, None]
        strength = np.abs(by_u).max(axis=0)
        columns.append(carried @ by_u[:, strength > 0] / strength[strength > 0] / len(pieces))
    return np.hstack(columns)


def _held(motion: _Motion, pieces: list[np.ndarray]) -> Any:
    """What must not become negative along the arcs of a hybrid motion, and impulses, each with its least value."""
    model, d = motion.parts.model, motion.parts.size
    if model.hybrid is None:
        return
    least: dict[str, float] = {}
    for k, piece in enumerate(pieces):
        mode, _ = model.hybrid.arcs[motion.parts.arc(k)]
        driven, own = motion.control(k, np.linspace(0.0, 1.0, len(piece))), model.parameter_values.copy()
        for x, u in zip(piece[:, :d], driven, strict=True):
            own[[model.parameter_index(name) for name in model.controls]] = u
            for name, one in (mode.holds or {}).items():
                least[name] = min(least.get(name, np.inf), float(one(x, own)))
        if (event := motion.event(k)) is not None and event.impulse is not None:
            name = f"impulse of {event.name}"
            least[name] = min(least.get(name, np.inf), float(event.impulse(piece[-1, :d], model.parameter_values)))
    yield from least.items()


def _off_symmetry(motion: _Motion, pieces: list[np.ndarray], units: np.ndarray) -> float:
    """How far the second half of a symmetric motion is from the mirrored first, in extents, whole turns apart."""
    parts = motion.parts
    if not parts.basis.signs:
        return 0.0
    first, last = parts.symmetry.rows(parts.model.degrees_of_freedom)
    nodes = np.vstack([piece[0, : parts.size] for piece in pieces])
    half = len(nodes) // 2
    apart = nodes[half:] + nodes[:half] @ np.linalg.solve(last, first).T
    return float(np.abs(wrapped(apart, parts.model.angular) / units).max())


class Fit:
    """The multipliers that meet the conditions of an optimum best, and what they leave.

    `left` of the conditions, relative to the cost, at `worst`; `violations` by name how far tasks and limits are
    violated, relative; `phase` what fixing the phase costs, relative; `costate` at t = 0; `pointwise` the largest |H_u|
    relative to its terms, `drift` how far H is from constant, relative; `size` of a cost that is not small.
    """

    def __init__(self, motion: _Motion, pieces: list[np.ndarray], units: np.ndarray) -> None:
        self.motion, self.parts, self.pieces, self.units = motion, motion.parts, pieces, units
        self.violations: dict[str, float] = {}
        self.transitions: list[np.ndarray] = []
        self.first, self.last = motion.parts.symmetry.boundary(motion.parts.model.degrees_of_freedom)
        parts, events = self.parts, [motion.event(k) for k in range(self.parts.basis.intervals)]
        self.tasks = (*parts.always, *(one for _, one in parts.moments))
        self.active: list[tuple[int, int, int, int]] = []
        self.bounded, sides = self._bounded(), self._sides()
        asked = [*(f"task {one.expression} at {one.at}" for _, one in parts.moments),
                 *(f"mean {one.expression}" for one in parts.means)]  # fmt: skip
        signs = [
            *((f"closing {k}", 0) for k in range(len(self.first))),
            *((f"pin {parts.model.state_names[k]}", 0) for k in self.motion.pinned),
            *((f"phase {k}", 0) for k in range(len(self.motion.normals))),
            *zip(asked, sides, strict=True),
            *((f"event {event.name} {k}", 0) for k, event in enumerate(events) if event is not None),
        ]
        self.first_active = len(signs)
        signs += [(f"limit {parts.always[task].expression} {k}.{j}", side) for k, j, task, side in self.active]
        signs += [(f"bound {parts.model.controls[i]} {j}", side) for i, j, side in self.bounded]
        signs += [(f"held {name}", side) for name, side in self.motion.held.items()]
        self.names, self.signs = [name for name, _ in signs], np.array([sign for _, sign in signs], int)
        self._assemble()

    def _watched(self, arc: int) -> ca.Function:
        """(share, x, given, period) -> d/dx, d/dgiven, d/dperiod of tasks."""
        function = self.parts.watched(arc, self.tasks)
        share, x, period = ca.SX.sym("share"), ca.SX.sym("x", self.parts.size), ca.SX.sym("period")
        given = ca.SX.sym("given", function.size1_in(3))
        value = function(share, x, ca.SX.zeros(function.size1_in(2)), given, period)
        rows = [ca.densify(ca.jacobian(value, by)) for by in (x, given, period)]
        return ca.Function("tasks", [share, x, given, period], rows)

    def _values(self, tasks: Sequence[Task]) -> np.ndarray:
        """Expressions of tasks (segments x looks x k) along the motion."""
        shares, found = np.linspace(0.0, 1.0, SAMPLES * self.parts.steps + 1), []
        functions = [self.parts.watched(arc, tasks) for arc in range(max(self.parts.basis.arcs, 1))]
        for segment, piece in enumerate(self.pieces):
            function, x = functions[self.parts.arc(segment)], piece[:, : self.parts.size].T
            given = np.zeros(function.size1_in(2)), self.motion.given(segment), self.motion.period
            found.append(function(shares[None], x, *given).full().T)
        return np.array(found)

    def _violated(self, name: str, value: np.ndarray, one: Task, size: float = 0.0) -> None:
        bounds = [abs(bound) for bound in (one.low, one.high) if np.isfinite(bound)]
        size = nonzero(max(*bounds, size, float(np.ptp(value))))
        worst = float(np.maximum(one.low - value, value - one.high).max()) / size
        self.violations[name] = max(self.violations.get(name, 0.0), worst)

    def _sides(self) -> list[int]:
        """At which end of its range (-1, 1, 0 between) each task at a phase or on average is, how far all are violated.

        Where what holds always holds just so is `active`: (segment, step, task, side).
        """
        parts, found = self.parts, list[int]()
        driven = np.vstack([self.motion.control(k, np.linspace(0.0, 1.0, SAMPLES + 1))
                            for k in range(self.motion.whole.intervals)])  # fmt: skip
        for one in parts.limits:
            own = driven[:, parts.model.controls.index(one.expression)]
            self._violated(f"{one.expression} within limits", own, one)
        if not (self.tasks or parts.means):
            return found
        values = self._values((*self.tasks, *parts.means))
        nodes = values[: parts.basis.intervals, 0]
        for k, one in enumerate(parts.always):
            self._violated(f"{one.expression} always", values[:, :, k], one)
            size, steps = nonzero(float(np.ptp(values[:, :, k]))), values[: len(nodes), ::SAMPLES, k]
            self.active += [(segment, j, k, side) for segment, j in np.ndindex(steps.shape)
                            if (side := _side_of(one, float(steps[segment, j]), size))]  # fmt: skip
        instants = [(f"{one.expression} at {one.at:g}", one, nodes[at, len(parts.always) + k])
                    for k, (at, one) in enumerate(parts.moments)]  # fmt: skip
        means = [(f"mean {one.expression}", one, self._integral(1 + k) / self.motion.period)
                 for k, one in enumerate(parts.means)]  # fmt: skip
        for k, (name, one, value) in enumerate([*instants, *means], len(parts.always)):
            size = nonzero(float(np.ptp(nodes[:, k])))
            self._violated(name, np.array([value]), one, size)
            found.append(_side_of(one, value, size))
        return found

    def _integral(self, number: int) -> float:
        """An integral over the whole period."""
        return float(self.pieces[-1][-1, self.parts.size + number])

    def _bounded(self) -> list[tuple[int, int, int]]:
        """(control, free coefficient, side) of coefficients at a limit."""
        if not self.parts.bounded:
            return []
        found = []
        for i, name in enumerate(self.parts.model.controls):
            if name not in self.parts.model.limits:
                continue
            low, high = self.parts.model.limits[name]
            size = high - low if np.isfinite(high - low) else max(abs(x) for x in (low, high) if np.isfinite(x))
            shape = self.parts.basis.free(i)
            for j, value in enumerate(np.linalg.lstsq(shape, self.motion.coefficients[i], rcond=None)[0]):
                reach = shape[:, j] * value
                if np.any(reach[shape[:, j] != 0] - low <= ACTIVE * size):
                    found.append((i, j, -1 if value - low <= ACTIVE * size else 1))
                elif np.any(high - reach[shape[:, j] != 0] <= ACTIVE * size):
                    found.append((i, j, 1 if high - value <= ACTIVE * size else -1))
        return found

    def _assemble(self) -> None:
        """The conditions as rows, linear in the unknown multipliers; solved and judged."""
        parts, motion, ny = self.parts, self.motion, len(self.names)
        self.place = {name: k for k, name in enumerate(self.names)}
        per = motion.period * parts.symmetry.fraction
        self.weights = np.zeros((motion.count, ny + 1))
        self.weights[0, -1] = 1.0 / (per if parts.control.average else parts.symmetry.fraction)
        for k, one in enumerate(parts.means):
            self.weights[1 + k, self.place[f"mean {one.expression}"]] = 1.0 / per
        costate = np.zeros((parts.size, ny + 1))
        costate[:, : len(self.last)] = self.last.T
        self.by_c = np.zeros((len(parts.model.controls) * parts.basis.whole, ny + 1))
        self.by_period, self.by_free = np.zeros(ny + 1), np.zeros((len(parts.free), ny + 1))
        self.costates: list[np.ndarray] = []
        arcs = range(max(parts.basis.arcs, 1)) if self.active or parts.moments else ()
        self.watched = [self._watched(arc) for arc in arcs]
        transitions: list[np.ndarray] = []
        for segment in reversed(range(parts.basis.intervals)):
            if (event := motion.event(segment)) is not None:
                costate = self._through(event, segment, costate)
            transition, costate = self._along(segment, costate)
            transitions.append(transition)
            self.costates.append(costate.copy())
            for row, (where, one) in enumerate(parts.moments, len(parts.always)):
                if where == segment:
                    self._pushed(costate, self.place[f"task {one.expression} at {one.at}"], (segment, 0), row)
        self.costates.reverse()
        self._monodromies(transitions[::-1])
        self._solve(costate)

    def _along(self, segment: int, costate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state-transition matrix of a segment, and the costate where it begins; gradients are added up."""
        parts, motion, d = self.parts, self.motion, self.parts.size
        h, total, picked = motion.duration(segment), np.eye(d), self._picked(segment)
        for j in reversed(range(parts.steps + 1)):
            for number, (where, step, task, _) in enumerate(self.active):
                if (where, step) == (segment, j):
                    self._pushed(costate, self.first_active + number, (segment, j), task)
            if j == 0:
                break
            piece = self._back(segment, j)
            grown = [one[:, :d] @ costate + one[:, d:] @ self.weights for one in piece]
            costate, by_c, by_free, by_h = grown
            np.add.at(self.by_c, picked, by_c)
            self.by_free += by_free
            self.by_period += by_h[0] * h / motion.period
            self._by_shares(by_h[0], parts.arc(segment))
            total = total @ piece[0][:, :d].T
        return total, costate

    def _picked(self, segment: int) -> np.ndarray:
        """Where the coefficients of a segment are among those of all controls."""
        basis = self.parts.basis
        return np.concatenate([i * basis.whole + basis.picked(segment) for i in range(len(self.parts.model.controls))])

    def _pushed(self, costate: np.ndarray, column: int, at: tuple[int, int], row: int) -> None:
        """The jump of a costate, and the gradients, of a task at an instant (segment, step)."""
        segment, j = at
        x, given = self.pieces[segment][j * SAMPLES, : self.parts.size], self.motion.given(segment)
        slopes = self.watched[self.parts.arc(segment)](j / self.parts.steps, x, given, self.motion.period)
        by_x, by_given, by_period = (one.full()[row] for one in slopes)
        last = by_given.size - len(self.parts.free)
        costate[:, column] += by_x
        np.add.at(self.by_c[:, column], self._picked(segment), by_given[2:last])
        self.by_free[:, column] += by_given[last:]
        self.by_period[column] += by_period[0]

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

    def _slopes(self, event: Any, segment: int) -> tuple[np.ndarray, ...]:
        """Derivatives of the reset by state and freed parameters, and those of the guard, where a segment ends."""
        state, free = ca.MX.sym("x", self.parts.size), ca.MX.sym("free", len(self.parts.free))
        p = self.parts.model.parameters(self.parts.free, free)
        values = event.reset(state, p), event.guard(state, p)
        rows = [ca.densify(ca.jacobian(value, by)) for value in values for by in (state, free)]
        x = self.pieces[segment][-1, : self.parts.size]
        return tuple(one.full() for one in ca.Function("event", [state, free], rows)(x, self.motion.free))

    def _through(self, event: Any, segment: int, costate: np.ndarray) -> np.ndarray:
        """The costate before an event from that after it."""
        by_x, by_p, guard_x, guard_p = self._slopes(event, segment)
        column = self.place[f"event {event.name} {segment}"]
        self.by_free += by_p.T @ costate
        before = by_x.T @ costate
        before[:, column] += guard_x.ravel()
        self.by_free[:, column] += guard_p.ravel()
        return np.asarray(before)

    def _back(self, segment: int, j: int) -> list[np.ndarray]:
        """Costates (d x r), gradients by local coefficients, freed parameters and h over step j of a segment."""
        d, r = self.parts.size, self.parts.size + self.motion.count
        counts = [d, len(self.parts.model.controls) * self.parts.basis.local, len(self.parts.free), 1]
        start = np.zeros(d + sum(counts) * r)
        start[:d] = self.pieces[segment][j * SAMPLES, :d]
        start[d : d + d * r] = np.eye(d, r).ravel("F")
        span = 1.0 - np.array([j, j - 1]) / self.parts.steps
        end = integrate(self.motion.at(self.motion.backward, segment), start, span, VARIED)[-1]
        parts = np.split(end[d:], r * np.cumsum(counts)[:-1])
        return [part.reshape(-1, r, order="F") for part in parts]

    def _monodromies(self, transitions: list[np.ndarray]) -> None:
        """State-transition matrices of all segments, of events with their own time eliminated, over the period."""
        parts, motion = self.parts, self.motion
        for segment, one in enumerate(transitions):
            if (event := motion.event(segment)) is not None:
                one = self._saltated(event, segment) @ one
            self.transitions.append(one)
        if parts.basis.signs:
            first, last = parts.symmetry.rows(parts.model.degrees_of_freedom)
            mirror = -np.linalg.solve(last, first)
            self.transitions += [mirror @ one @ np.linalg.inv(mirror) for one in transitions]

    def _saltated(self, event: Any, segment: int) -> np.ndarray:
        """DR (1 - f grad g / (grad g . f)): the clock of the control begins again with each arc."""
        x, (by_x, _, slope, _) = self.pieces[segment][-1, : self.parts.size], self._slopes(event, segment)
        u = self.motion.control(segment, np.array([1.0]))[0]
        rate = self.motion.instant(segment, x, u)[0]
        return np.asarray(by_x @ (np.eye(x.size) - rate @ slope / (slope @ rate).item()))

    def _solve(self, costate: np.ndarray) -> None:
        """The rows of all conditions, in units of cost."""
        place, by_free = self.place, self.by_free
        parts, motion, basis = self.parts, self.motion, self.parts.basis
        integral = self._integral(0)
        final, by_x, by_p, by_t = self._final(self.pieces[0][0, : parts.size])
        self.cost = integral / (motion.period if parts.control.average else 1.0) + final
        start, period_row = costate.copy(), self.by_period.copy()
        start[:, : len(self.first)] += self.first.T
        for k in motion.pinned:
            start[k, place[f"pin {parts.model.state_names[k]}"]] += 1.0
        for k, row in enumerate(motion.normals):
            start[:, place[f"phase {k}"]] += row
        start[:, -1] += by_x
        by_free[:, -1] += by_p
        period_row[-1] += by_t - (integral / motion.period**2 if parts.control.average else 0.0)
        for k, one in enumerate(parts.means):
            period_row[place[f"mean {one.expression}"]] -= self._integral(1 + k) / motion.period**2
        rows = [("costate closes", start * self.units[:, None])]
        for i, name in enumerate(parts.model.controls):
            own = basis.free(i).T @ self.by_c[i * basis.whole : (i + 1) * basis.whole]
            for control, j, _ in self.bounded:
                if control == i:
                    own[j, place[f"bound {name} {j}"]] += 1.0
            rows.append((f"control {name}", own * max(float(np.abs(motion.coefficients[i]).max()), SMALL)))
        if motion.period_free:
            if "period" in motion.held:
                period_row[place["held period"]] += 1.0
            rows.append(("period", period_row[None] * motion.period))
        for k, name in enumerate(parts.free):
            row = by_free[k] * nonzero(abs(motion.free[k]))
            if name in motion.held:
                row[place[f"held {name}"]] += 1.0
            rows.append((name, row[None]))
        self._judge(np.vstack([row for _, row in rows]), [name for name, row in rows for _ in row], integral)

    def _final(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, float]:
        function = self.parts.final()
        state, free, period = ca.MX.sym("x", x.size), ca.MX.sym("free", len(self.parts.free)), ca.MX.sym("period")
        value = function(state, free, period)
        whole = ca.Function("final", [state, free, period],
                            [value, *(ca.densify(ca.gradient(value, by)) for by in (state, free, period))])  # fmt: skip
        found = [one.full().ravel() for one in whole(x, self.motion.free, self.motion.period)]
        return float(found[0][0]), found[1], found[2], float(found[3][0])

    def _reference(self) -> float:
        """A cost that is small: what controls cost that accelerate `SMALL` of what the motion does."""
        found = 0.0
        for piece in self.pieces[: self.parts.basis.intervals]:
            x, u = piece[0, : self.parts.size], np.zeros(len(self.parts.model.controls))
            _, idle, by_u, _ = self.motion.instant(0, x, u)
            strong = np.abs(by_u / self.units[:, None]).max(axis=0)
            large = 2 * np.pi / self.motion.period / nonzero(strong)
            costs = self.motion.instant(0, x, np.where(strong > 0, large, 0.0))[1]
            found = max(found, abs(float(costs[0, 0] - idle[0, 0])))
        return found * SMALL * (1.0 if self.parts.control.average else self.motion.period)

    def _judge(self, rows: np.ndarray, labels: list[str], integral: float) -> None:
        matrix, right = rows[:, :-1], -rows[:, -1]
        mean = abs(integral) / (self.motion.period if self.parts.control.average else 1.0)
        size = nonzero(max(abs(self.cost), mean, self._reference()))
        self.size = size
        widths = nonzero(np.abs(matrix).max(axis=0, initial=0.0))
        y = np.linalg.lstsq(matrix / widths, right, rcond=1e-13)[0]
        signs = self.signs
        wrong = (signs != 0) & (y * signs < -1e-9 * size)
        if np.any(wrong):
            low, high = np.where(signs > 0, 0.0, -np.inf), np.where(signs < 0, 0.0, np.inf)
            y = lsq_linear(matrix / widths, right, (low, high), method="bvls", tol=1e-14).x
        left = np.abs(matrix / widths @ y - right) / size
        worst = int(left.argmax())
        self.left, self.worst = float(left[worst]), labels[worst]
        y = y / widths
        self.y = np.append(y, 1.0)
        self.multipliers = {name: float(value) for name, value in zip(self.names, y, strict=True)
                            if not name.startswith("closing")}  # fmt: skip
        phases = [abs(value) for name, value in self.multipliers.items() if name.startswith("phase")]
        self.phase = max(phases, default=0.0) * float(self.units.max()) / size
        self._hamiltonian()

    def _hamiltonian(self) -> None:
        """The costate at t = 0, |H_u| and the drift of H at the nodes, relative to their terms."""
        motion, parts = self.motion, self.parts
        weights = np.zeros(motion.count)
        weights[0] = 1.0 / (motion.period if parts.control.average else 1.0)
        for k, one in enumerate(parts.means):
            weights[1 + k] = self.multipliers[f"mean {one.expression}"] / motion.period
        fraction = parts.symmetry.fraction
        levels, slopes, terms, pieces = [], [], [], []
        for segment, matrix in enumerate(self.costates):
            costate = fraction * (matrix @ self.y)
            u = motion.control(segment, np.array([0.0]))[0]
            x = self.pieces[segment][0, : parts.size]
            rate, costs, by_u, cost_by_u = motion.instant(segment, x, u)
            levels.append(float(weights @ costs.ravel() + costate @ rate.ravel()))
            pieces.append(abs(float(weights @ costs.ravel())) + float(np.abs(costate * rate.ravel()).sum()))
            slopes.append(np.abs(weights @ cost_by_u + costate @ by_u).max(initial=0.0))
            terms.append(np.abs(costate @ by_u).max(initial=0.0))
        self.costate = fraction * (self.costates[0] @ self.y)
        self.pointwise = float(max(slopes) / nonzero(max(terms)))
        arcs = np.array_split(np.array(levels), max(parts.basis.arcs, 1))
        self.drift = float(max(np.ptp(one) for one in arcs) / nonzero(max(pieces)))


def _side_of(one: Task, value: float, size: float) -> int:
    """-1 or 1 where a value stands at an end of its range, 0 elsewhere; equations have no sign."""
    if one.equals is not None:
        return 0
    if abs(value - one.low) <= ACTIVE * size:
        return -1
    return 1 if abs(value - one.high) <= ACTIVE * size else 0
