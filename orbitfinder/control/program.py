"""A controlled motion of least cost as a nonlinear program: the rows of its Loop, its tasks, its cost.

The unknowns are v = (w, c, z): those of the loop, the coefficients of the controls, and with direct collocation the
states at the collocation points. How an interval is integrated is all that its two methods differ in:

    shooting       steps of the eighth-order Runge-Kutta method, written out
    collocation    x' - f = 0 at Legendre points, of order 10

Both carry the integrals of the cost and of what tasks ask on average. Derivatives of first and second order are exact.
Programs that differ in their guesses alone are derived once: guesses enter as numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from threading import get_ident
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import diags, identity
from scipy.sparse.linalg import splu

from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.integrate.rk8 import one_step
from orbitfinder.loops.conditions import clock, pinned
from orbitfinder.loops.control import Basis, Control, Task, stated
from orbitfinder.loops.ipopt import minimised, minimiser
from orbitfinder.loops.loop import Equations, Loop, Unknowns
from orbitfinder.loops.problem import Problem, boundary_constants, guessed_nodes
from orbitfinder.loops.scales import floored
from orbitfinder.loops.symmetry import Symmetry
from orbitfinder.mechanics.hybrid import freed, share
from orbitfinder.mechanics.model import Model, vector_field
from orbitfinder.mechanics.newton import Settings, stepped

POINTS = 5
"""Legendre points of an element: of order 10"""
AGREEMENT = 1e-13
"""Steps of half the length must lead to the same states, relative to the motion"""
COLLOCATED = 1e-11
"""The same of collocation, whose rows IPOPT leaves at about this"""
MOST_STEPS, CLEARER, EDGE = 32, 4, 1e-6
"""Steps of an interval; so many times as many are tried where nothing is found; what is this near to a bound is at it,
relative to its range"""
_arrangements: Kept[Arrangement] = Kept(32)
IPOPT = {
    "max_iter": 1000, "constr_viol_tol": 1e-11, "dual_inf_tol": 1e-6, "compl_inf_tol": 1e-9,
    "mu_target": 0.0, "mu_strategy": "adaptive",
}  # fmt: skip
CORRECTED = Settings(floor=0.0, round_off=0.0, converged=np.inf, most_evaluations=2)
"""Newton steps after IPOPT, whatever they leave"""


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
    varied: tuple[str, ...] = ()
    """of the control's numbers those that are unknowns: they follow the freed parameters wherever those are given"""
    cycles: int = 0
    """periods of the forcing in one of the motion"""
    derived: Kept[Any] = field(init=False, default_factory=lambda: Kept(8))
    """What programs have derived of it"""

    def numbers(self, free: Any) -> dict[str, Any]:
        """The control's numbers, unknown ones from the end of `free`."""
        return {**self.control.numbers, **{name: free[len(self.free) + k] for k, name in enumerate(self.varied)}}

    def stated(self, text: str, x: Any, p: Any, where: str, free: Any, period: Any = None) -> Any:
        """An expression of cost or tasks. Raises `InputError`."""
        return stated(text, self.model, x, p, where, period, self.numbers(free))

    def task(self, task: Task, x: Any, p: Any, free: Any, period: Any = None) -> Any:
        """The expression of a task; `InputError` for a constant, which no motion changes."""
        value = self.stated(task.expression, x, p, "task.expression", free, period)
        if isinstance(value, float) or value.is_constant():
            raise InputError(f"task.expression: {task.expression!r} is the same for every motion; name a state or a "
                             "control in it, or leave the task out")  # fmt: skip
        return value

    @property
    def size(self) -> int:
        """d, the length of a state."""
        return len(self.model.state_names)

    @property
    def means(self) -> tuple[Task, ...]:
        """The tasks on average."""
        return tuple(task for task in self.control.tasks if task.at == "mean")

    @property
    def moments(self) -> tuple[tuple[int, Task], ...]:
        """The tasks at a phase, with the segment that begins there. Raises `InputError`."""
        return tuple((self._segment(task), task) for task in self.control.tasks if not isinstance(task.at, str))

    @property
    def always(self) -> tuple[Task, ...]:
        """What holds everywhere: tasks, and limits that bounds on coefficients do not keep."""
        own = tuple(task for task in self.control.tasks if task.at == "always")
        return own if self.bounded else own + self.limits

    @property
    def limits(self) -> tuple[Task, ...]:
        """The model's limits of controls as tasks."""
        return tuple(
            Task(name, lowest=None if np.isinf(low) else low, highest=None if np.isinf(high) else high)
            for name, (low, high) in self.model.limits.items() if np.isfinite(low) or np.isfinite(high)
        )  # fmt: skip

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
        return self.model if self.model.smooth else self.model.arcs[arc][0].model

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
        moment, x, s = symbol("share"), symbol("x", self.size), symbol("s", self.unfolding)
        given = symbol("given", 2 + count * basis.local + len(self.free) + len(self.varied))
        local, free = given[2 : 2 + count * basis.local], given[2 + count * basis.local :]
        weights = ca.vertcat(*basis.values(moment, given[0] + moment * given[1]))
        u = [ca.dot(weights, local[i * basis.local : (i + 1) * basis.local]) for i in range(count)]
        names = (*self.free, *self.model.controls)
        physical = ca.vertcat(free[: len(self.free), :], *u)
        p = model.parameters(names, physical)
        unfolded = () if basis.arcs else self.symmetry.unfolded(model)
        rate = vector_field(model, names, unfolded)(self.time(given[0] + moment * given[1]), x, s, physical)
        rates = [self.stated(self.control.cost, x, p, "control.cost", free)]
        rates += [self.task(task, x, p, free) for task in self.means]
        return [moment, x, s, given], rate, p, rates

    def time(self, phase: Any) -> Any:
        """The time (s) of the forcing at a phase of the motion."""
        return phase * self.cycles * self.model.driving_period if self.cycles else 0.0

    @property
    def tail(self) -> int:
        """How many freed parameters and unknown numbers there are."""
        return len(self.free) + len(self.varied)

    @property
    def unfolding(self) -> int:
        """How many parameters unfold the loop."""
        return 0 if self.basis.arcs else len(self.symmetry.unfolded(self.model))

    def stepped(self, arc: int) -> ca.Function:
        """(x, h, s, given) -> states after each step of an interval of h s (d x steps), integrals, no rows."""
        inputs, rate, _, rates = self.driven(arc, self.mode(arc).symbol)
        count, symbol = len(rates), type(inputs[0]).sym
        moment, x, s, given = inputs
        h, whole = symbol("h"), symbol("whole", self.size + count)
        field = ca.Function("f", [moment, x, s, given], [rate, ca.vertcat(*rates)])
        rate, more = field(moment, whole[: self.size], s, given)
        moving = ca.Function("moving", [moment, whole, s, ca.vertcat(given, h)], [h * ca.vertcat(rate, more)])
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
        inputs, rate, _, rates = self.driven(arc, self.mode(arc).symbol)
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
                speed, more = field((k + tau) / self.steps, points[:, j], s, given)
                rows.append(both @ slopes[:, j] - h / self.steps * speed)
                integrals += float(weights[j]) * h / self.steps * more
            now = both @ ends
            states.append(now)
        return ca.Function("collocated", [x, h, s, given, z], [ca.horzcat(*states), integrals, ca.vertcat(*rows)])

    def watched(self, arc: int, tasks: Sequence[Task]) -> ca.Function:
        """(share, x, s, given, period) -> expressions of tasks (k) at a place of the motion."""
        inputs, _, p, _ = self.driven(arc, self.mode(arc).symbol)
        first = 2 + len(self.model.controls) * self.basis.local  # of what is given of a segment
        x, free, period = inputs[1], inputs[3][first:], type(inputs[1]).sym("period")
        rows = [self.task(task, x, p, free, period) for task in tasks]
        return ca.Function("watched", [*inputs, period], [ca.densify(type(inputs[1])(ca.vertcat(*rows)))])

    def final(self) -> ca.Function:
        """(x(0), free, period) -> the cost that is no integral."""
        x, free, period = ca.MX.sym("x", self.size), ca.MX.sym("free", self.tail), ca.MX.sym("period")
        p, text = self.model.parameters(self.free, free), self.control.final or "0"
        return ca.Function("final", [x, free, period], [self.stated(text, x, p, "control.final", free, period)])


def mirror_of(model: Model, symmetry: Symmetry) -> np.ndarray:
    """What a symmetry makes of a state (d x d)."""
    first, last = symmetry.rows(model.degrees_of_freedom)
    return -np.linalg.solve(last, first)


def signs_of(model: Model, symmetry: Symmetry) -> tuple[int, ...]:
    """Of each control, whether a symmetry keeps (1) or reverses (-1) it; () without one. Raises `InputError`."""
    if not symmetry.maps:
        return ()
    if model.forced:
        raise InputError("symmetry: controlled motions of forced systems have none; use symmetry = 'none'")
    if symmetry.reverses or symmetry.fraction != 0.5:
        raise InputError("symmetry: controlled motions repeat mirrored after half a period (reflection), or have none")
    mirror = mirror_of(model, symmetry)
    field, random = vector_field(model, model.controls), np.random.default_rng(0)
    signs = []
    for k, name in enumerate(model.controls):
        x, u = 0.3 * random.normal(size=len(model.state_names)), np.zeros(len(model.controls))
        u[k] = 1.0 + random.random()

        def at(state: np.ndarray, control: np.ndarray) -> np.ndarray:
            return np.asarray(field(0.0, state, ca.DM(0, 1), control).full().ravel())

        wanted = mirror @ at(x, u)
        kept = [sign for sign in (1, -1) if np.allclose(at(mirror @ x, sign * u), wanted, rtol=1e-9, atol=1e-9)]
        if not kept:
            raise InputError(f"symmetry: the control {name} breaks it; use symmetry = 'none'")
        signs.append(kept[0])
    return tuple(signs)


def arranged(
    model: Model, symmetry: Symmetry, free: tuple[str, ...], control: Control, steps: int, varied: tuple[str, ...] = (),
    cycles: int = 0,
) -> Arrangement:  # fmt: skip
    """The arrangement of a controlled motion, the same for a thread that asks again. Raises `InputError`."""
    control = replace(control, guess={})
    key = Same(model), symmetry, free, repr(control), steps, varied, cycles, get_ident()
    return _arrangements(key, lambda: _arranged(model, symmetry, free, control, steps, varied, cycles))


def _arranged(
    model: Model, symmetry: Symmetry, free: tuple[str, ...], control: Control, steps: int, varied: tuple[str, ...],
    cycles: int,
) -> Arrangement:  # fmt: skip
    if model.forcing_period is not None:
        by = ca.MX.sym("by", len(names := (*free, *model.controls)))
        for k in ca.jacobian(ca.MX(model.forcing_period(model.parameters(names, by))), by).sparsity().get_col():
            raise InputError(f"{names[k]}: the forcing's period depends on it; neither free it nor control it")
    arcs = len(model.cycle)
    signs = signs_of(model, symmetry)
    count = control.intervals * max(arcs, 1)
    if arcs and control.shape == "fourier":
        raise InputError("control.shape: fourier is for smooth systems; use cubic, linear or zero-order on arcs")
    if signs and control.intervals % 2:
        raise InputError(f"control.intervals: must be even with this symmetry, got {control.intervals}")
    part = count // 2 if signs else count
    basis = Basis(control.shape, part, control.harmonics, arcs, 0.5 if signs else 1.0, signs)
    return Arrangement(model, control, symmetry, basis, freed(model, free), steps, varied, cycles)


@lru_cache(maxsize=32)
def _built(arrangement: Arrangement, arc: int, method: str) -> ca.Function:
    return arrangement.stepped(arc) if method == "shooting" else arrangement.collocated(arc)


@dataclass(frozen=True)
class Optimum:
    """A solved program: the loop's unknowns, coefficients of all controls (m x whole), IPOPT's iterations."""

    unknowns: Unknowns
    coefficients: np.ndarray
    iterations: int
    points: np.ndarray
    normals: np.ndarray
    """of the hyperplanes that fixed the phase"""


class Program:
    """The nonlinear program of a controlled motion at a given number of steps an interval.

    `varied` are numbers of the control that are unknowns too, the last of v.
    """

    def __init__(self, problem: Problem, control: Control, steps: int, varied: tuple[str, ...] = ()) -> None:
        self.problem, self.control = problem, control
        form = problem.model, problem.boundary, problem.free
        self.parts = parts = arranged(*form, control, steps, varied, problem.forcing_cycles)
        self.equations: Equations = parts.derived("equations", lambda: Equations(*form))
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
            nodes = self._simulated(guess.start, guess.period, coefficients, numbers)
        return Unknowns(nodes, float(guess.period), np.zeros(parts.unfolding), numbers, self.mesh), coefficients

    def _simulated(self, x: np.ndarray, period: float, coefficients: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Nodes along the motion from a state, or that state everywhere where it runs away."""
        parts, nodes = self.parts, []
        size, start = max(1.0, float(np.abs(x).max())), x
        for k in range(parts.basis.intervals):
            nodes.append(x)
            h = float(parts.duration(k, period, ca.DM(free)))
            given = self.given(k, coefficients.T, free)
            x = _built(parts, parts.arc(k), "shooting")(x, h, np.zeros(parts.unfolding), given, [])[0].full()[:, -1]
            if parts.basis.arcs and (k + 1) % parts.basis.each == 0:
                x = self.equations.links.after(parts.arc(k), x, free)
            if not np.all(np.isfinite(x)) or np.abs(x).max() > 1e3 * size:  # no guess
                return np.tile(start, (parts.basis.intervals, 1))
        return np.array(nodes)

    def given(self, segment: int, coefficients: Any, free: Any) -> Any:
        """(phase, length in phase, local coefficients, free) of a segment; coefficients (whole x m)."""
        phases, picked = self.parts.basis.phases(segment), [int(k) for k in self.parts.basis.picked(segment)]
        columns = range(len(self.parts.model.controls))
        if isinstance(coefficients, np.ndarray):
            return np.concatenate([phases, *(coefficients[picked, i] for i in columns), free])
        return ca.vertcat(*phases, *(coefficients[i][picked] for i in columns), free)

    @property
    def points(self) -> int:
        """Numbers in z for a segment."""
        return self.parts.size * POINTS * self.parts.steps if self.control.method == "collocation" else 0

    def solved(self, start: tuple[Unknowns, np.ndarray], tolerance: float) -> Optimum:
        """The optimum that IPOPT finds from a start. Raises `ConvergenceError`."""
        guess, coefficients = start
        stated = stated_program(self, guess)
        begin = np.concatenate([self.vector(guess, coefficients), _first_points(guess, self.parts, self.points > 0)])
        expressed, options = stated.expressed, IPOPT | {"tol": tolerance}
        program = {"x": expressed.v, "f": expressed.cost, "g": expressed.rows, "p": expressed.p}
        solver = self.parts.derived(
            ("solver", tolerance, Same(expressed)), lambda: minimiser("controlled", program, options, {})
        )
        answer, stats, _ = minimised(
            solver, x0=begin, lbx=stated.lower, ubx=stated.upper, lbg=stated.low, ubg=stated.high,
            p=stated.normals.ravel(),
        )  # fmt: skip
        if not stats["success"]:
            raise _failed(stats, self)
        return self.solution(guess, answer, stated.normals, int(stats["iter_count"]))

    def closed(self, solution: Optimum) -> Optimum:
        """A solution to the last digits of its equations, by Newton's least steps, far below IPOPT's tolerance."""
        w = solution.unknowns
        stated = stated_program(self, w)
        v = self.vector(w, solution.coefficients)
        low, high = stated.lower[: v.size], stated.upper[: v.size]
        # IPOPT stays inside of bounds, by more than round-off of those that cost little
        near = np.where(np.isfinite(high - low), EDGE * (high - low), -1.0)
        v = np.where(v - low <= near, low, np.where(high - v <= near, high, v))
        at = _closed(self.parts, stated, v)
        return self.solution(w, at, solution.normals, solution.iterations)

    def vector(self, w: Unknowns, coefficients: np.ndarray) -> np.ndarray:
        """v without collocation points."""
        each = (
            np.linalg.lstsq(shape, row, rcond=None)[0] for shape, row in zip(self.shapes, coefficients, strict=True)
        )
        return np.concatenate([w.vector, *each])

    def names(self, like: Unknowns) -> list[str]:
        """What the unknowns v are called in words, "" of states and what unfolds."""
        parts = self.parts
        loop = ["" for _ in like.nodes.ravel()] + ["period"] + ["" for _ in like.unfolding] + list(parts.free)
        each = zip(parts.model.controls, self.shapes, strict=True)
        controls = [
            f"{name} at phase {k / parts.basis.whole:.6g}" for name, shape in each for k in range(shape.shape[1])
        ]
        return loop + controls + ["a number" for _ in parts.varied]

    def solution(self, like: Unknowns, v: np.ndarray, normals: np.ndarray, iterations: int = 0) -> Optimum:
        """The solution that v stands for."""
        cut = like.vector.size
        sizes = cut + np.cumsum([0, *(shape.shape[1] for shape in self.shapes)])
        values = [shape @ v[sizes[k] : sizes[k + 1]] for k, shape in enumerate(self.shapes)]
        return Optimum(like.at(v[:cut]), np.array(values), iterations, v[sizes[-1] :], normals)

    def loop(self, guess: Unknowns) -> Loop:
        """The loop: closed, at the pins, its phase fixed where nothing else fixes it."""
        problem, equations = self.problem, self.equations
        pins = (pinned(equations, pin.name, pin.value) for pin in problem.pin)
        conditions = (*clock(equations, self.parts.cycles), *pins)
        loop = Loop(equations, boundary_constants(problem, guess.nodes), conditions)
        normals = equations.phases(guess)
        timed = not (problem.boundary.reverses or problem.model.forced or problem.model.hybrid)
        held = self.control.shape != "fourier" and "period" in [pin.name for pin in problem.pin]  # has its instants
        fixed = held or any(pin.name in problem.model.state_names for pin in problem.pin) or bool(self.parts.moments)
        if timed and fixed:
            normals = normals[1:]
        return Loop(loop.equations, loop.constant, loop.conditions, normals, guess.nodes[0])

    def error(self, solution: Optimum) -> float:
        """How far the ends of the segments are from those by shooting in steps half as long, relative to the motion."""
        problem, parts = self.problem, self.parts
        form = problem.model, problem.boundary, problem.free
        finer = arranged(*form, self.control, 2 * parts.steps, parts.varied, parts.cycles)
        w, worst = solution.unknowns, 0.0
        size = floored(np.abs(w.nodes).max(axis=0))
        points = np.split(solution.points, len(w.nodes))
        for k, node in enumerate(w.nodes):
            h = float(self.parts.duration(k, w.period, ca.DM(w.free)))
            given = self.given(k, solution.coefficients.T, w.free)
            arc = self.parts.arc(k)
            own = _built(self.parts, arc, self.control.method)(node, h, w.unfolding, given, points[k])[0].full()[:, -1]
            fine = _built(finer, arc, "shooting")(node, h, w.unfolding, given, [])[0].full()[:, -1]
            worst = max(worst, float((np.abs(fine - own) / size).max()))
        return worst


def optimum(problem: Problem, control: Control, tolerance: float) -> tuple[Program, Optimum]:
    """The controlled motion of a problem, with as many steps as its states no longer depend on, closed to round-off.

    It starts at the guess; where shooting does not get there, collocation may. The last digits of a collocated motion
    are those of shooting under its control. Raises `ConvergenceError`.
    """
    steps = -(-16 * control.harmonics // control.intervals) if control.shape == "fourier" else 1  # of the highest 16
    order, enough = (8, AGREEMENT) if control.method == "shooting" else (2 * POINTS, COLLOCATED)
    program = Program(problem, control, steps)
    start = program.guessed()
    steps = program.parts.steps
    rough = CLEARER * steps
    while True:
        try:
            solution = program.solved(start, tolerance)
        except ConvergenceError:
            if steps >= rough:
                if control.method == "shooting":
                    with suppress(ConvergenceError):  # its steps do not run away
                        return optimum(problem, replace(control, method="collocation"), tolerance)
                raise
            steps = rough  # in steps that lose the motion costs have no lower bound
            program = Program(problem, control, steps)
            start = program.guessed()
            continue
        if (error := program.error(solution)) <= enough or steps >= MOST_STEPS:
            break
        steps = finer(steps, error, enough, order)
        program, start = Program(problem, control, steps), (solution.unknowns, solution.coefficients)
    if control.method == "shooting":
        return program, program.closed(solution)
    shot = Program(problem, replace(control, method="shooting"), steps)
    solution = replace(solution, points=np.zeros(0))
    while (error := shot.error(solution)) > AGREEMENT and shot.parts.steps < MOST_STEPS:
        shot = Program(problem, shot.control, finer(shot.parts.steps, error, AGREEMENT, 8))
    return Program(problem, control, shot.parts.steps), shot.closed(solution)


def finer(steps: int, error: float, enough: float, order: int) -> int:
    """Steps that bring an error down to what is enough."""
    return min(MOST_STEPS, max(steps + 1, int(np.ceil(steps * (3 * error / enough) ** (1 / order)))))


def _bounds(program: Program, guess: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest of the loop's unknowns."""
    problem, low, high = program.problem, 0.05, 10.0  # factors, where no bounds say otherwise
    times = problem.bounds.get("period", (low * guess.period, high * guess.period))
    lowest, highest = np.full(guess.free.size, -np.inf), np.full(guess.free.size, np.inf)
    for k, name in enumerate(program.parts.free):
        value = float(guess.free[k])
        usual = (low * value, high * value) if value > 0 else (-np.inf, np.inf)
        lowest[k], highest[k] = problem.bounds.get(name, usual)
    nodes = np.full(guess.nodes[0].size, np.inf)
    return guess.joined(-nodes, times[0], -np.inf, lowest), guess.joined(nodes, times[1], np.inf, highest)


def coefficient_bounds(program: Program) -> tuple[np.ndarray, np.ndarray]:
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


@dataclass(frozen=True, eq=False)
class Expressed:
    """The program in symbols: v, cost, rows; p, the normals that fix the phase, one after another."""

    v: ca.MX
    cost: ca.MX
    rows: ca.MX
    p: ca.MX
    tasks: np.ndarray
    """of each row the number of the task that it belongs to; -1 of the loop's, -2 of limits kept by rows"""
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True)
class Statement:
    """The program as `expressed` with ranges of its rows and of v, and the phase's normals."""

    expressed: Expressed
    low: np.ndarray
    high: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    normals: np.ndarray

    @property
    def rows(self) -> ca.MX:
        """The rows at these normals."""
        known = self.expressed
        return ca.substitute(known.rows, known.p, self.normals.ravel()) if self.normals.size else known.rows


class _ProgramSymbols:
    """The unknowns of a program as symbols, the free coefficients of each control, collocation points and numbers among
    them, and what is known of each segment: what is `given` there and how long it lasts."""

    def __init__(self, program: Program, guess: Unknowns) -> None:
        parts, segments = program.parts, range(program.parts.basis.intervals)
        self.parts, self.method = parts, program.control.method
        self.nodes, self.tail = guess.symbols()
        self.period, self.unfolding, free = self.tail
        self.controls = [ca.MX.sym(f"c{k}", shape.shape[1]) for k, shape in enumerate(program.shapes)]
        self.points = [ca.MX.sym("z", program.points) for _ in segments]
        self.numbers = ca.MX.sym("numbers", len(parts.varied))
        self.free = ca.vertcat(free, self.numbers)
        whole = [ca.sparsify(ca.DM(shape)) @ c for shape, c in zip(program.shapes, self.controls, strict=True)]
        self.given = [program.given(k, whole, self.free) for k in segments]
        self.durations = [parts.duration(k, self.period, free) for k in segments]

    def integrated(self) -> tuple[list[ca.MX], ca.MX, ca.MX]:
        """States after each step of each segment, the integrals over the horizon, the rows of collocation points."""
        paths, integrals, rows = list[ca.MX](), ca.MX(0), [ca.MX(0, 1)]
        basis = self.parts.basis
        for first in range(0, basis.intervals, basis.each):
            own = slice(first, first + basis.each)
            nodes, durations, given, points = (
                ca.horzcat(*group[own]) for group in (self.nodes, self.durations, self.given, self.points)
            )
            mapped = _built(self.parts, self.parts.arc(first), self.method).map(basis.each)
            path, more, obeyed = mapped(nodes, durations, ca.repmat(self.unfolding, 1, basis.each), given, points)
            paths += ca.horzsplit(path, self.parts.steps)
            integrals = integrals + ca.sum2(more)
            rows.append(ca.vec(obeyed))
        return paths, integrals, ca.vertcat(*rows)

    def tasks(self, paths: list[ca.MX], integrals: ca.MX) -> Iterator[tuple[ca.MX, Task]]:
        """The expressions of all tasks: at phases, on average, and of what holds always at the nodes and after each
        step."""
        parts = self.parts
        for k, task in parts.moments:
            watched = parts.watched(parts.arc(k), (task,))
            yield watched(0.0, self.nodes[k], self.unfolding, self.given[k], self.period), task
        for k, task in enumerate(parts.means):
            yield integrals[1 + k] / self.period / parts.symmetry.fraction, task
        for number, task in enumerate(parts.always):
            rows = []
            for k, (node, path) in enumerate(zip(self.nodes, paths, strict=True)):
                watched = _watched(parts, parts.arc(k), number)
                rows += [watched(j / parts.steps, x, self.unfolding, self.given[k], self.period)
                         for j, x in enumerate([node, *ca.horzsplit(path)])]  # fmt: skip
            yield ca.vertcat(*rows), task


def stated_program(program: Program, guess: Unknowns) -> Statement:
    """The program in symbols, its phase that of a guess. Raises `InputError`."""
    loop, known = program.loop(guess), program.parts.derived
    pins = tuple((pin.name, pin.value) for pin in program.problem.pin)
    expressed: Expressed = known(("expressed", pins, len(loop.normals)), lambda: _expressed(program, guess, loop))
    low, high = expressed.low.copy(), expressed.high.copy()
    phases, inner = len(loop.normals), guess.nodes.size - guess.nodes[0].size
    aimed = loop.equations.aimed(loop.constant)
    for end in (low, high):
        end[:phases] = loop.normals @ loop.reference if phases else 0.0
        end[phases + inner :][: aimed.size] = aimed
    points, numbers = program.points * program.parts.basis.intervals, len(program.parts.varied)
    ends = zip(_bounds(program, guess), coefficient_bounds(program), (-np.inf, np.inf), strict=True)
    lower, upper = (np.concatenate([*own, np.full(points + numbers, free)]) for *own, free in ends)
    return Statement(expressed, low, high, lower, upper, loop.normals)


def _expressed(program: Program, guess: Unknowns, loop: Loop) -> Expressed:
    symbols, control, size = _ProgramSymbols(program, guess), program.control, program.parts.size
    p, none = ca.MX.sym("p", loop.normals.size), np.zeros((0, size))
    paths, integrals, obeyed = symbols.integrated()
    plain = replace(loop, constant=0.0 * loop.constant, normals=none)
    closing = plain.stated(symbols.nodes, symbols.period, symbols.tail[2], [path[:, -1] for path in paths])
    phases = ca.reshape(p, size, len(loop.normals)).T @ symbols.nodes[0]
    tasks = list(symbols.tasks(paths, integrals))
    of_loop = [(row, 0.0, 0.0) for row in (phases, closing, obeyed)]
    rows = [*of_loop, *((row, task.low, task.high) for row, task in tasks)]
    whose = [-1, -1, -1, *(control.tasks.index(task) if task in control.tasks else -2 for _, task in tasks)]
    cost = integrals[0] / program.parts.symmetry.fraction / (symbols.period if control.average else 1.0)
    cost += program.parts.final()(symbols.nodes[0], symbols.free, symbols.period)
    counts, (_, *ends) = [row.numel() for row, _, _ in rows], zip(*rows, strict=True)
    low, high, labels = (np.repeat(values, counts) for values in (*ends, whose))
    v = ca.vertcat(*symbols.nodes, *symbols.tail, *symbols.controls, *symbols.points, symbols.numbers)
    return Expressed(
        v, cost, ca.vertcat(*(row for row, _, _ in rows)), p, labels, low.astype(float), high.astype(float)
    )


@lru_cache(maxsize=32)
def _watched(parts: Arrangement, arc: int, number: int) -> ca.Function:
    return parts.watched(arc, parts.always[number : number + 1])


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


def _closed(parts: Arrangement, stated: Statement, at: np.ndarray) -> np.ndarray:
    equal, expressed = stated.low == stated.high, stated.expressed
    chosen = np.flatnonzero(equal).tolist()

    def derived() -> ca.Function:
        equations = expressed.rows[chosen]
        slopes = ca.jacobian(equations, expressed.v)
        return ca.Function("equations", [expressed.v, expressed.p], [equations, slopes])

    function = parts.derived(("equations", Same(expressed)), derived)

    def correction(at: np.ndarray) -> np.ndarray:
        left, slope = function(at, stated.normals.ravel())
        matrix = slope.sparse().tocsr()
        sizes = nonzero(np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel()))
        matrix, left = diags(1.0 / sizes) @ matrix, (left.full().ravel() - stated.low[equal]) / sizes
        square = (matrix @ matrix.T + 1e-13 * identity(len(chosen))).tocsc()  # rows that say the same stay apart
        return -np.asarray(matrix.T @ splu(square).solve(left))

    return stepped(at, correction, CORRECTED).w


def _failed(stats: Any, program: Program) -> ConvergenceError:
    """What IPOPT's failure says, with a remedy."""
    status = str(stats["return_status"])
    why = {
        "Infeasible_Problem_Detected": "no motion does what is asked near this guess; ask for less (limits, tasks), or "
        "start nearer",
        "Maximum_Iterations_Exceeded": f"not converged after {IPOPT['max_iter']} iterations; start nearer, or give "
        "more intervals",
        "Not_Enough_Degrees_Of_Freedom": "more equations than unknowns: leave out a pin or a task, or free a parameter",
    }.get(status, f"IPOPT stopped ({status}); start nearer, give bounds, or another number of intervals")
    return ConvergenceError(f"no controlled motion found: {why} ({program.control.method}, "
                            f"{program.parts.basis.intervals} intervals)")  # fmt: skip
