"""A controlled motion of least cost as a nonlinear program: the rows of its Loop, its tasks, its cost.

The unknowns are v = (w, c, z): those of the loop, the coefficients of the controls, and with direct collocation the
states at the collocation points. How an interval is integrated is all that its two methods differ in:

    shooting       steps of the eighth-order Runge-Kutta method, written out
    collocation    x' - f = 0 at Legendre points, of order 10

Both carry the integrals of the cost and of what tasks ask on average. Derivatives of first and second order are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import diags, identity
from scipy.sparse.linalg import splu

from orbitfinder._runtime import limit
from orbitfinder._runtime.quiet import captured
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.integrate.rk8 import one_step
from orbitfinder.loops.control import Basis, Control, Task, stated
from orbitfinder.loops.loop import Equations, Loop, Unknowns
from orbitfinder.loops.problem import Problem, boundary_constants, guessed_nodes, pinned
from orbitfinder.loops.symmetry import Symmetry
from orbitfinder.mechanics.hybrid import share
from orbitfinder.mechanics.model import Model, vector_field

POINTS = 5
"""Legendre points of an element: of order 10"""
FREE_RANGE = (0.05, 10.0)
"""Period and freed parameters may change by these factors where no bounds say otherwise"""
AGREEMENT = 1e-13
"""Steps of half the length must lead to the same states, relative to the motion"""
MOST_STEPS = 32
RESOLVED = 16
"""Steps in a period of the highest harmonic of a control, to begin with"""
MOST_ITERATIONS = 1000
FARTHEST = 1e3
"""A guess's motion that goes farther than this, relative, is no guess"""
MIRRORED = 1e-9
"""A control's sign under a symmetry is tried to this, relative"""
ALWAYS = "always"
CORRECTIONS, SINGULAR = 2, 1e-13
"""Newton steps after IPOPT; what keeps rows that say the same apart"""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """What a controlled motion is made of: model, control, basis, and how its segments follow each other.

    `free` are the freed parameters of the loop, durations of arcs among them; `steps` is the number of steps (or
    collocation elements) of an interval.
    """

    model: Model
    control: Control
    symmetry: Symmetry
    basis: Basis
    free: tuple[str, ...]
    steps: int

    @property
    def size(self) -> int:
        """d, the length of a state."""
        return len(self.model.state_names)

    @property
    def means(self) -> tuple[Task, ...]:
        """The tasks on average."""
        return tuple(one for one in self.control.tasks if one.at == "mean")

    @property
    def moments(self) -> tuple[tuple[int, Task], ...]:
        """The tasks at a phase, with the segment that begins there. Raises `InputError`."""
        return tuple((self._segment(one), one) for one in self.control.tasks if not isinstance(one.at, str))

    @property
    def always(self) -> tuple[Task, ...]:
        """What holds everywhere: tasks, and limits that bounds on coefficients do not keep."""
        own = tuple(one for one in self.control.tasks if one.at == ALWAYS)
        if self.bounded:
            return own
        return own + tuple(
            Task(name, ALWAYS, lowest=None if np.isinf(low) else low, highest=None if np.isinf(high) else high)
            for name, (low, high) in self.model.limits.items()
        )

    @property
    def bounded(self) -> bool:
        """Whether controls are within their limits when their coefficients are."""
        return self.basis.degree in (0, 1)

    def _segment(self, task: Task) -> int:
        assert not isinstance(task.at, str)
        place = task.at * self.basis.intervals / self.basis.fraction
        nearest = round(place)
        if self.basis.arcs and task.at != 0:
            raise InputError(f"task.at: {task.at:g}: of a hybrid system tasks are at 0, always or on average")
        if nearest >= self.basis.intervals:
            part = self.basis.fraction
            raise InputError(f"task.at: {task.at:g} lies beyond the {part:g} of the period that the symmetry leaves")
        if abs(place - nearest) > 1e-9 * self.basis.intervals:
            raise InputError(
                f"task.at: {task.at:g} is no boundary of the control's intervals; the nearest is "
                f"{nearest * self.basis.fraction / self.basis.intervals:.6g}, or give another number of intervals"
            )
        return nearest

    def arc(self, segment: int) -> int:
        """The arc that a segment belongs to."""
        return segment // self.basis.each if self.basis.arcs else 0

    def mode(self, arc: int) -> Model:
        """The smooth Model of an arc."""
        return self.model if self.model.hybrid is None else self.model.hybrid.arcs[arc][0].model

    def duration(self, segment: int, period: Any, free: Any) -> Any:
        """How long (s) a segment lasts."""
        if not self.basis.arcs:
            return period * (self.symmetry.fraction / self.basis.intervals)
        p = self.model.parameters(self.free, free)
        return period * share(self.model, self.arc(segment), p) / self.basis.each

    def driven(self, arc: int, symbol: Any) -> tuple[list[Any], Any, Any, list[Any]]:
        """(share, x, s, (phase, length of the interval in phase, local coefficients, free)) and x', p, rates there."""
        model, basis = self.mode(arc), self.basis
        count = len(self.model.controls)
        moment, x, s = symbol("share"), symbol("x", self.size), symbol("s", 0 if basis.arcs else self._unfolding)
        given = symbol("given", 2 + count * basis.local + len(self.free))
        local, free = given[2 : 2 + count * basis.local], given[2 + count * basis.local :]
        weights = ca.vertcat(*basis.values(moment, given[0] + moment * given[1]))
        u = [ca.dot(weights, local[i * basis.local : (i + 1) * basis.local]) for i in range(count)]
        names = (*self.free, *self.model.controls)
        p = model.parameters(names, ca.vertcat(free, *u))
        unfolded = () if basis.arcs else self.symmetry.unfolded(model)
        rate = vector_field(model, names, unfolded)(0.0, x, s, ca.vertcat(free, *u))
        rates = [stated(self.control.cost, self.model, x, p, "control.cost")]
        rates += [stated(one.expression, self.model, x, p, "task.expression") for one in self.means]
        return [moment, x, s, given], rate, p, rates

    @property
    def _unfolding(self) -> int:
        return len(self.symmetry.unfolded(self.model))

    def stepped(self, arc: int) -> ca.Function:
        """(x, h, s, given) -> states after each step of an interval of h s (d x steps), integrals, no rows."""
        inputs, rate, _, rates = self.driven(arc, ca.SX.sym if self.mode(arc).scalar else ca.MX.sym)
        count, symbol = len(rates), type(inputs[0]).sym
        moment, x, s, given = inputs
        h, whole = symbol("h"), symbol("whole", self.size + count)
        field = ca.Function("f", [moment, x, s, given], [rate, ca.vertcat(*rates)])
        found, more = field(moment, whole[: self.size], s, given)
        moving = ca.Function("moving", [moment, whole, s, ca.vertcat(given, h)], [h * ca.vertcat(found, more)])
        step = one_step(moving, symbol)
        z, states = ca.vertcat(0.0, x, ca.SX.zeros(count) if symbol is ca.SX.sym else ca.DM.zeros(count)), []
        for _ in range(self.steps):
            z = step(z, ca.vertcat(1.0 / self.steps, s, given, h))
            states.append(z[1 : 1 + self.size])
        nothing = symbol("z", 0)
        return ca.Function("stepped", [x, h, s, given, nothing],
                           [ca.horzcat(*states), z[1 + self.size :], type(x)(0, 1)])  # fmt: skip

    def collocated(self, arc: int) -> ca.Function:
        """The same with the states at collocation points z (d x POINTS x steps) given, and the rows that they obey."""
        inputs, rate, _, rates = self.driven(arc, ca.SX.sym if self.mode(arc).scalar else ca.MX.sym)
        _, x, s, given = inputs
        field = ca.Function("f", inputs, [rate, ca.vertcat(*rates)])
        taus = ca.collocation_points(POINTS, "legendre")
        slopes, ends, weights = ca.collocation_coeff(taus)
        symbol = type(x).sym
        h, z = symbol("h"), symbol("z", self.size * POINTS * self.steps)
        now, integrals, rows, states = x, 0, [], []
        for k in range(self.steps):
            points = ca.reshape(z[self.size * POINTS * k : self.size * POINTS * (k + 1)], self.size, POINTS)
            both = ca.horzcat(now, points)
            for j, tau in enumerate(taus):
                found, more = field((k + tau) / self.steps, points[:, j], s, given)
                rows.append(both @ slopes[:, j] - h / self.steps * found)
                integrals += float(weights[j]) * h / self.steps * more
            now = both @ ends
            states.append(now)
        return ca.Function("collocated", [x, h, s, given, z], [ca.horzcat(*states), integrals, ca.vertcat(*rows)])

    def watched(self, arc: int, tasks: Sequence[Task]) -> ca.Function:
        """(share, x, s, given, period) -> expressions of tasks (k) at a place of the motion."""
        inputs, _, p, _ = self.driven(arc, ca.SX.sym if self.mode(arc).scalar else ca.MX.sym)
        period = type(inputs[1]).sym("period")
        rows = [stated(one.expression, self.model, inputs[1], p, "task.expression", period) for one in tasks]
        return ca.Function("watched", [*inputs, period], [ca.densify(type(inputs[1])(ca.vertcat(*rows)))])

    def final(self) -> ca.Function:
        """(x(0), free, period) -> the cost that is no integral."""
        x, free, period = ca.MX.sym("x", self.size), ca.MX.sym("free", len(self.free)), ca.MX.sym("period")
        p = self.model.parameters(self.free, free)
        text = self.control.final or "0"
        return ca.Function("final", [x, free, period], [stated(text, self.model, x, p, "control.final", period)])


def signs_of(model: Model, symmetry: Symmetry) -> tuple[int, ...]:
    """Of each control, whether a symmetry keeps (1) or reverses (-1) it; () without one. Raises `InputError`."""
    if not symmetry.maps:
        return ()
    if symmetry.reverses or symmetry.fraction != 0.5:
        raise InputError("symmetry: controlled motions repeat mirrored after half a period (reflection), or have none")
    first, last = symmetry.rows(model.degrees_of_freedom)
    mirror = -np.linalg.solve(last, first)
    field, random = vector_field(model, model.controls), np.random.default_rng(0)
    signs = []
    for k, name in enumerate(model.controls):
        x, u = 0.3 * random.normal(size=len(model.state_names)), np.zeros(len(model.controls))
        u[k] = 1.0 + random.random()

        def at(state: np.ndarray, control: np.ndarray) -> np.ndarray:
            return np.asarray(field(0.0, state, ca.DM(0, 1), control).full().ravel())

        wanted = mirror @ at(x, u)
        found = [one for one in (1, -1) if np.allclose(at(mirror @ x, one * u), wanted, rtol=MIRRORED, atol=MIRRORED)]
        if not found:
            raise InputError(f"symmetry: the control {name} breaks it; use symmetry = 'none'")
        signs.append(found[0])
    return tuple(signs)


def arranged(model: Model, symmetry: Symmetry, free: tuple[str, ...], control: Control, steps: int) -> Arrangement:
    """The arrangement of a controlled motion. Raises `InputError`."""
    arcs = 0 if model.hybrid is None else len(model.hybrid.cycle)
    signs = signs_of(model, symmetry)
    count = control.intervals * max(arcs, 1)
    if arcs and control.shape == "fourier":
        raise InputError("control.shape: fourier is for smooth systems; use cubic, linear or zero-order on arcs")
    if signs and control.intervals % 2:
        raise InputError(f"control.intervals: must be even with this symmetry, got {control.intervals}")
    part = count // 2 if signs else count
    basis = Basis(control.shape, part, control.harmonics, arcs, 0.5 if signs else 1.0, signs)
    shares = () if not arcs else tuple(f"share_{k + 1}" for k in range(arcs - 1))
    return Arrangement(model, control, symmetry, basis, (*free, *shares), steps)


@lru_cache(maxsize=32)
def _built(arrangement: Arrangement, arc: int, method: str) -> ca.Function:
    return arrangement.stepped(arc) if method == "shooting" else arrangement.collocated(arc)


@dataclass(frozen=True)
class Solution:
    """A solved program: the loop's unknowns, coefficients of all controls (m x whole), cost, what IPOPT says."""

    unknowns: Unknowns
    coefficients: np.ndarray
    cost: float
    iterations: int
    points: np.ndarray
    normals: np.ndarray
    """of the hyperplanes that fixed the phase"""


class Program:
    """The nonlinear program of a controlled motion at a given number of steps an interval."""

    def __init__(self, problem: Problem, control: Control, steps: int) -> None:
        self.problem, self.control = problem, control
        self.parts = arranged(problem.model, problem.boundary, problem.free, control, steps)
        self.equations = Equations(problem.model, problem.boundary, problem.free)
        assert self.equations.free == self.parts.free
        count = self.parts.basis.intervals
        self.mesh = np.linspace(0.0, 1.0 if self.parts.basis.arcs else problem.boundary.fraction, count + 1)

    @cached_property
    def shapes(self) -> list[np.ndarray]:
        """E of each control."""
        return [self.parts.basis.free(k) for k in range(len(self.parts.model.controls))]

    def guessed(self) -> tuple[Unknowns, np.ndarray]:
        """Where the search starts: the guess's motion under the guessed controls, and those (m x whole)."""
        guess, parts, control = self.problem.guess, self.parts, self.control
        coefficients = np.zeros((len(parts.model.controls), parts.basis.whole))
        for name, given in control.guess.items():
            if name not in parts.model.controls:
                raise InputError(
                    f"control.guess: {name!r} is no control; controls are {', '.join(parts.model.controls)}"
                )
            row, values = coefficients[parts.model.controls.index(name)], np.asarray(given, float)
            if values.ndim > 1 or values.size not in (1, row.size):
                raise InputError(f"control.guess.{name}: {values.size} numbers; give 1 or {row.size}")
            row[:] = values
        numbers = self.equations.numbers
        if guess.states is not None:
            nodes = guessed_nodes(guess, self.mesh[:-1])
        else:
            nodes = self._simulated(np.asarray(guess.state, float), guess.period, coefficients, numbers)
        unfolding = np.zeros(0 if parts.basis.arcs else len(parts.symmetry.unfolded(parts.model)))
        return Unknowns(nodes, float(guess.period), unfolding, numbers, self.mesh), coefficients

    def _simulated(self, x: np.ndarray, period: float, coefficients: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Nodes along the motion from a state, or that state everywhere where it runs away."""
        parts, nodes = self.parts, []
        size = max(1.0, float(np.abs(x).max()))
        unfolding = np.zeros(0 if parts.basis.arcs else len(parts.symmetry.unfolded(parts.model)))
        start = x
        for k in range(parts.basis.intervals):
            nodes.append(x)
            h = float(parts.duration(k, period, ca.DM(free)))
            given = self._given(k, coefficients.T, free)
            x = _built(parts, parts.arc(k), "shooting")(x, h, unfolding, given, [])[0].full()[:, -1]
            if parts.basis.arcs and (k + 1) % parts.basis.each == 0:
                x = self.equations.links.after(parts.arc(k), x, free)
            if not np.all(np.isfinite(x)) or np.abs(x).max() > FARTHEST * size:
                return np.tile(start, (parts.basis.intervals, 1))
        return np.array(nodes)

    def _given(self, segment: int, coefficients: Any, free: Any) -> Any:
        """(phase, length in phase, local coefficients, free) of a segment; coefficients (whole x m)."""
        basis = self.parts.basis
        begins = basis.begins(segment) if not basis.arcs else 0.0
        length = basis.fraction / basis.intervals if not basis.arcs else 0.0
        picked = [int(k) for k in basis.picked(segment)]
        columns = range(len(self.parts.model.controls))
        if isinstance(coefficients, np.ndarray):
            return np.concatenate([[begins, length], *(coefficients[picked, i] for i in columns), free])
        return ca.vertcat(begins, length, *(coefficients[i][picked] for i in columns), free)

    def solved(
        self, start: tuple[Unknowns, np.ndarray], tolerance: float, points: np.ndarray | None = None
    ) -> Solution:
        """The optimum that IPOPT finds from a start. Raises `ConvergenceError`."""
        guess, coefficients = start
        return _solve(self, guess, coefficients, tolerance, points)

    def loop(self, guess: Unknowns) -> Loop:
        """The loop: closed, at the pins, its phase fixed where nothing else fixes it."""
        problem, equations = self.problem, self.equations
        conditions = tuple(pinned(equations, one.name, one.value) for one in problem.pin)
        loop = Loop(equations, boundary_constants(problem, guess.nodes), conditions)
        normals = equations.phases(guess)
        timed = not (problem.boundary.reverses or problem.model.forced or problem.model.hybrid)
        fixed = any(one.name in problem.model.state_names for one in problem.pin) or bool(self.parts.moments)
        if timed and fixed:
            normals = normals[1:]
        return Loop(loop.equations, loop.constant, loop.conditions, normals, guess.nodes[0])

    def refined(self, solution: Solution) -> float:
        """How far states at the ends of the segments move when steps are half as long, relative to the motion."""
        finer = replace(self.parts, steps=2 * self.parts.steps)
        w, worst = solution.unknowns, 0.0
        size = np.maximum(np.abs(w.nodes).max(axis=0), 1e-3 * np.abs(w.nodes).max())
        for k, node in enumerate(w.nodes):
            h = float(self.parts.duration(k, w.period, ca.DM(w.free)))
            given = self._given(k, solution.coefficients.T, w.free)
            ends = [_built(one, one.arc(k), "shooting")(node, h, w.unfolding, given, [])[0].full()[:, -1]
                    for one in (self.parts, finer)]  # fmt: skip
            worst = max(worst, float((np.abs(ends[1] - ends[0]) / np.maximum(size, 1e-300)).max()))
        return worst


def optimum(problem: Problem, control: Control, tolerance: float) -> tuple[Program, Solution]:
    """The controlled motion of a problem, steps halved until its states no longer depend on them."""
    steps = -(-RESOLVED * control.harmonics // control.intervals) if control.shape == "fourier" else 1
    program = Program(problem, control, steps)
    start = program.guessed()
    while True:
        solution = program.solved(start, tolerance)
        if program.refined(solution) <= AGREEMENT or steps >= MOST_STEPS:
            return program, solution
        steps *= 2
        program, start = Program(problem, control, steps), (solution.unknowns, solution.coefficients)


def _bounds(program: Program, guess: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest of the loop's unknowns."""
    problem, low, high = program.problem, FREE_RANGE[0], FREE_RANGE[1]
    times = problem.bounds.get("period", (low * guess.period, high * guess.period))
    lowest, highest = np.full(guess.free.size, -np.inf), np.full(guess.free.size, np.inf)
    for k, name in enumerate(program.parts.free):
        value = float(guess.free[k])
        usual = (low * value, high * value) if value > 0 else (-np.inf, np.inf)
        lowest[k], highest[k] = problem.bounds.get(name, usual)
    nodes = np.full(guess.nodes[0].size, np.inf)
    return guess.joined(-nodes, times[0], -np.inf, lowest), guess.joined(nodes, times[1], np.inf, highest)


def _coefficient_bounds(program: Program) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest of the free coefficients of all controls."""
    parts, low, high = program.parts, [], []
    for k, name in enumerate(parts.model.controls):
        least, most = parts.model.limits.get(name, (-np.inf, np.inf)) if parts.bounded else (-np.inf, np.inf)
        if parts.basis.signs and parts.basis.signs[k] < 0:
            least, most = max(least, -most), min(most, -least)
        size = program.shapes[k].shape[1]
        low.append(np.full(size, least))
        high.append(np.full(size, most))
    return np.concatenate(low), np.concatenate(high)


def _solve(
    program: Program, guess: Unknowns, coefficients: np.ndarray, tolerance: float, points: np.ndarray | None
) -> Solution:
    parts, control = program.parts, program.control
    nodes, tail = guess.symbols()
    period, s, free = tail
    own = [ca.MX.sym(f"c{k}", one.shape[1]) for k, one in enumerate(program.shapes)]
    full = [ca.sparsify(ca.DM(one)) @ c for one, c in zip(program.shapes, own, strict=True)]
    collocation = control.method == "collocation"
    count, size = parts.basis.intervals, parts.size
    z = [ca.MX.sym("z", size * POINTS * parts.steps if collocation else 0) for _ in nodes]
    given = [program._given(k, full, free) for k in range(count)]
    durations = [parts.duration(k, period, free) for k in range(count)]
    paths, integrals, rows = _integrated(parts, control.method, nodes, durations, s, given, z)
    ends = [path[:, -1] for path in paths]
    loop = program.loop(guess)
    known = [loop.stated(nodes, period, free, ends)]
    low, high = [np.zeros(known[0].numel())], [np.zeros(known[0].numel())]
    for (_, one), value in zip(parts.moments, _at_moments(parts, nodes, s, given, period), strict=True):
        known.append(value)
        low.append(np.array([one.low]))
        high.append(np.array([one.high]))
    for one, value in zip(parts.means, ca.vertsplit(integrals[1:]) if parts.means else [], strict=True):
        known.append(value / period / parts.symmetry.fraction)
        low.append(np.array([one.low]))
        high.append(np.array([one.high]))
    if parts.always:
        known.append(_everywhere(parts, nodes, paths, s, given, period))
        places = known[-1].numel() // len(parts.always)
        low.append(np.tile([one.low for one in parts.always], places))
        high.append(np.tile([one.high for one in parts.always], places))
    known.append(rows)
    low.append(np.zeros(rows.numel()))
    high.append(np.zeros(rows.numel()))
    cost = integrals[0] / parts.symmetry.fraction
    if control.average:
        cost = cost / period
    cost += parts.final()(nodes[0], free, period)
    v = ca.vertcat(*nodes, *tail, *own, *z)
    begin = np.concatenate([guess.vector, *(np.linalg.lstsq(one, row, rcond=None)[0]
                                            for one, row in zip(program.shapes, coefficients, strict=True)),
                            _first_points(guess, parts, collocation) if points is None else points])  # fmt: skip
    first, last = _bounds(program, guess)
    c_low, c_high = _coefficient_bounds(program)
    infinite = np.full(sum(one.numel() for one in z), np.inf)
    found, stats = _ipopt(
        {"x": v, "f": cost, "g": ca.vertcat(*known)}, begin, tolerance,
        lbx=np.concatenate([first, c_low, -infinite]), ubx=np.concatenate([last, c_high, infinite]),
        lbg=np.concatenate(low), ubg=np.concatenate(high),
    )  # fmt: skip
    if not stats["success"]:
        raise _failed(stats, program)
    answer = _closed(v, ca.vertcat(*known), np.concatenate(low) == np.concatenate(high), np.concatenate(low),
                     found["x"].full().ravel())  # fmt: skip
    cut = guess.vector.size
    sizes = np.cumsum([0, *(one.shape[1] for one in program.shapes)])
    parts_of = [answer[cut + sizes[k] : cut + sizes[k + 1]] for k in range(len(own))]
    values = np.array([one @ c for one, c in zip(program.shapes, parts_of, strict=True)])
    return Solution(guess.at(answer[:cut]), values.reshape(len(own), parts.basis.whole), float(found["f"]),
                    int(stats["iter_count"]), answer[cut + sizes[-1] :], loop.normals)  # fmt: skip


def _integrated(
    parts: Arrangement, method: str, nodes: list[ca.MX], durations: list[ca.MX], s: ca.MX, given: list[ca.MX],
    z: list[ca.MX],
) -> tuple[list[ca.MX], ca.MX, ca.MX]:  # fmt: skip
    """States after each step of each segment, the integrals over the horizon, the rows of collocation points."""
    paths: list[ca.MX] = []
    integrals, rows = ca.MX(0), [ca.MX(0, 1)]
    count = parts.basis.intervals
    each = parts.basis.each if parts.basis.arcs else count
    for first in range(0, count, each):
        span = range(first, first + each)
        one = _built(parts, parts.arc(first), method)
        mapped = one.map(each)
        columns = ([ca.horzcat(*(group[k] for k in span)) for group in (nodes, durations)], ca.repmat(s, 1, each),
                   [ca.horzcat(*(group[k] for k in span)) for group in (given, z)])  # fmt: skip
        path, more, obeyed = mapped(*columns[0], columns[1], *columns[2])
        paths += ca.horzsplit(path, parts.steps)
        integrals = integrals + ca.sum2(more)
        rows.append(ca.vec(obeyed))
    return paths, integrals, ca.vertcat(*rows)


def _at_moments(parts: Arrangement, nodes: list[ca.MX], s: ca.MX, given: list[ca.MX], period: ca.MX) -> list[ca.MX]:
    return [
        parts.watched(parts.arc(k), (one,))(0.0, nodes[k], s, given[k], period) for k, one in parts.moments
    ]  # fmt: skip


def _everywhere(
    parts: Arrangement, nodes: list[ca.MX], paths: list[ca.MX], s: ca.MX, given: list[ca.MX], period: ca.MX
) -> ca.MX:
    """The expressions of `always` at the nodes and after each step."""
    found = []
    for k, (node, path) in enumerate(zip(nodes, paths, strict=True)):
        function = parts.watched(parts.arc(k), parts.always)
        for j, x in enumerate([node, *ca.horzsplit(path)]):
            found.append(function(j / parts.steps, x, s, given[k], period))
    return ca.vertcat(*found)


def _first_points(guess: Unknowns, parts: Arrangement, collocation: bool) -> np.ndarray:
    """Collocation points begin on the chords from node to node."""
    if not collocation:
        return np.zeros(0)
    shares = (np.arange(parts.steps)[:, None] + np.array(ca.collocation_points(POINTS, "legendre"))).ravel()
    shares = shares / parts.steps
    following = np.roll(guess.nodes, -1, axis=0)
    following[-1] = guess.nodes[-1]
    chords = guess.nodes[:, None, :] + shares[None, :, None] * (following - guess.nodes)[:, None, :]
    return np.asarray(chords).ravel()


def _ipopt(program: dict[str, ca.MX], start: np.ndarray, tolerance: float, **ranges: np.ndarray) -> tuple[Any, Any]:
    options = {
        "print_time": False, "error_on_fail": False,
        "ipopt": {
            "print_level": 0, "sb": "yes", "tol": tolerance, "max_iter": MOST_ITERATIONS, "bound_relax_factor": 0.0,
            "constr_viol_tol": 1e-11, "dual_inf_tol": 1e-6, "compl_inf_tol": 1e-9, "acceptable_iter": 0,
            "mu_target": 0.0, "mu_strategy": "adaptive",
        },
    }  # fmt: skip
    with captured(), limit.alarm():
        solver = ca.nlpsol("controlled", "ipopt", program, options)
        found = solver(x0=start, **ranges)
        stats = solver.stats()
    return found, stats


def _closed(v: ca.MX, rows: ca.MX, equal: np.ndarray, aims: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The nearest v at which the equations hold to round-off: Newton's least steps, far below IPOPT's tolerance."""
    chosen = [int(k) for k in np.flatnonzero(equal)]
    equations = rows[chosen] - ca.DM(aims[equal])
    function = ca.Function("equations", [v], [equations, ca.jacobian(equations, v)])
    for _ in range(CORRECTIONS):
        left, slope = function(at)
        matrix = slope.sparse().tocsr()
        sizes = np.maximum(np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel()), 1e-300)
        matrix, left = diags(1.0 / sizes) @ matrix, left.full().ravel() / sizes
        square = (matrix @ matrix.T + SINGULAR * identity(len(chosen))).tocsc()
        at = at - matrix.T @ splu(square).solve(left)
    return np.asarray(at)


def _failed(stats: Any, program: Program) -> ConvergenceError:
    """What IPOPT's failure says, with a remedy."""
    status = str(stats["return_status"])
    why = {
        "Infeasible_Problem_Detected": "no motion does what is asked near this guess; ask for less (limits, tasks), or "
        "start nearer",
        "Maximum_Iterations_Exceeded": f"not converged after {MOST_ITERATIONS} iterations; start nearer, or give more "
        "intervals",
        "Not_Enough_Degrees_Of_Freedom": "more equations than unknowns: leave out a pin or a task, or free a parameter",
    }.get(status, f"IPOPT stopped ({status}); start nearer, give bounds, or another number of intervals")
    return ConvergenceError(f"no controlled motion found: {why} ({program.control.method}, "
                            f"{program.parts.basis.intervals} intervals)")  # fmt: skip
