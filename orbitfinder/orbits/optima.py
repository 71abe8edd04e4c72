"""Families of optima: controlled motions of least cost along a number that they depend on, round turning points.

The curve is that of the conditions of an optimum (`loops.stationary`), followed by arclength: predictor along the
tangent, corrector by Newton's method normal to it. Between points it is looked at where a constraint becomes active or
is let go (the curve has a corner there), where it turns back, and where the cost is least along it. Every point that
is kept is certified as any controlled orbit: from its record, by other means.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from orbitfinder._runtime.keeping import STOPPED, finished
from orbitfinder.errors import ConvergenceError, InputError, closest
from orbitfinder.loops.control import Control, Task
from orbitfinder.loops.controlled import AGREEMENT, MOST_STEPS, Program, Solution, coefficient_bounds, optimum
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.stationary import VIOLATED, Point, Stationary, Varying, moved
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.orbits.certify import certified
from orbitfinder.orbits.control import IPOPT_TOLERANCE, recorded
from orbitfinder.records.optima import Change, Optima
from orbitfinder.records.orbit import Orbit

FIRST, LONGEST, SHORTEST = 0.02, 0.3, 1e-5
"""Steps along the curve, in root mean squares of the unknowns' sizes"""
GROWTH, BEND = 1.6, 0.9
"""A step that is right grows by this; the cosine of a bend between tangents that is too sharp for one step"""
LOCATED, LOOKS = 1e-11, 60
"""A change is located to this share of a step, in as many looks at most"""
TOGETHER = 1e-6
"""Constraints change together where their margins are this near"""
UNBOUNDED = 1e7
"""Multipliers that grow by this end a family: where what is asked ceases to be possible"""
COSTLESS = 1e-12
"""A cost is none at this share of the largest met"""
MOST_POINTS = 200
TOLD = ("fold", "active", "inactive")
"""What may change the number of directions that lower the cost, without other optima branching off"""

Report = Callable[[float, Orbit], None]


def follow_optima(
    problem: Problem, parameter: str, values: Sequence[float] = (), settings: SolveSettings | None = None, *,
    until: float | None = None, points: int = MOST_POINTS, progress: Report | None = None,
) -> Optima:  # fmt: skip
    """The certified optima of a controlled problem along a number, round turning points.

    Turning points, changes of the active set and extremes of the cost are located.

    Args:
        problem: with a control.
        parameter: a pin, a physical parameter, one of the control's `numbers` (a weight), "task K" (what the K-th
            task asks for, from 1) or "limit NAME" (how far a control may go).
        values: at which optima are found, one after the other, from the first.
        settings: how each is solved.
        until: every step on the way there from where the problem stands.
        points: the most with `until`.
        progress: called with each optimum.

    Returns:
        Optima.

    Raises:
        InputError: for a parameter that the problem has not.
        ConvergenceError: where the first optimum fails.

    Examples:
        >>> of.follow_optima(pumped, "period", [1.7, 1.65]).costs.round(4)
        array([0.0479, 0.2101])
    """
    if problem.control is None:
        raise InputError("problem: has no control; give Problem(..., control=of.Control(...)), or follow_family()")
    targets = [float(one) for one in (*values, *(() if until is None else (until,)))]
    if not targets or not np.all(np.isfinite(targets)):
        raise InputError(f"values: {list(values)}; give finite values of {parameter}, or until")
    if points < 1:
        raise InputError(f"points: must be at least 1, got {points}")
    own = value_of(problem, parameter)
    start = problem if own == (first := targets[0] if values else own) else set_to(problem, parameter, first)
    return _Walk(start, parameter, settings or SolveSettings(), until is not None, points, progress).along(targets)


def value_of(problem: Problem, parameter: str) -> float:
    """Where a problem stands in a number. Raises `InputError`."""
    control, model = problem.control, problem.model
    assert control is not None
    pins = {one.name: one.value for one in problem.pin}
    if parameter in pins:
        return pins[parameter]
    if parameter in control.numbers:
        return float(control.numbers[parameter])
    kind, _, name = parameter.partition(" ")
    if kind == "limit" and name in model.limits:
        low, high = model.limits[name]
        return high if np.isfinite(high) else low
    if kind == "task" and name.isascii() and name.isdigit() and 1 <= int(name) <= len(control.tasks):
        one = control.tasks[int(name) - 1]
        return next(float(x) for x in (one.equals, one.highest, one.lowest) if x is not None)
    if parameter in model.parameter_names and parameter not in (*problem.free, *model.controls):
        return float(model.parameter_values[model.parameter_index(parameter)])
    known = [*pins, *control.numbers, *(f"task {k + 1}" for k in range(len(control.tasks))),
             *(f"limit {name}" for name in model.limits), *model.parameter_names]  # fmt: skip
    raise InputError(
        f"parameter: {parameter!r} is no pin and no physical parameter{closest(parameter, known)}; of this problem "
        f"there are {', '.join(known[:12])}"
    )


def set_to(problem: Problem, parameter: str, value: float) -> Problem:
    """The problem with a number at another value. Raises `InputError`."""
    value_of(problem, parameter)
    control, model, name = problem.control, problem.model, parameter.partition(" ")[2]
    assert control is not None
    if parameter in {one.name for one in problem.pin}:
        pins = tuple(replace(one, value=value) if one.name == parameter else one for one in problem.pin)
        period = value if parameter == "period" else problem.guess.period
        return replace(problem, pin=pins, guess=replace(problem.guess, period=period))
    if parameter in control.numbers:
        return replace(problem, control=replace(control, numbers={**control.numbers, parameter: value}))
    if parameter.startswith("limit "):
        limits = {**model.limits, name: _range(*model.limits[name], value)}
        system = {**model.system, "limits": {one: list(pair) for one, pair in limits.items()}}
        return replace(problem, model=replace(model, limits=limits, system=system))
    if parameter.startswith("task "):
        tasks = list(control.tasks)
        tasks[int(name) - 1] = _asking(tasks[int(name) - 1], value)
        return replace(problem, control=replace(control, tasks=tuple(tasks)))
    return replace(problem, model=with_parameters(model, {parameter: value}))


def _range(low: float, high: float, value: float) -> tuple[float, float]:
    """A range whose highest, without one its lowest, has a value; the lowest follows where it is the opposite."""
    if not np.isfinite(high):
        return value, high
    if value <= (-value if low == -high else low):
        raise InputError(f"parameter: a range cannot end at {value:g}, where it begins; give a greater value")
    return (-value if low == -high else low), value


def _asking(one: Task, value: float) -> Task:
    """A task that asks for another value."""
    if one.equals is not None:
        return replace(one, equals=value)
    low, high = _range(one.low, one.high, value)
    return replace(one, lowest=low if np.isfinite(low) else None, highest=high if np.isfinite(high) else None)


def _varying(problem: Problem, parameter: str, program: Program) -> Varying:
    """What theta is to the program."""
    control, value = problem.control, value_of(problem, parameter)
    assert control is not None
    pins = [one.name for one in problem.pin]
    if parameter in pins:
        return Varying(value, pin=pins.index(parameter))
    if parameter.startswith("task "):
        number = int(parameter.removeprefix("task ")) - 1
        ranges = [(one.low, one.high) for one in (control.tasks[number], _asking(control.tasks[number], value + 1.0))]
        below, above = _slopes(*ranges)
        return Varying(value, task=number, slopes=(float(below), float(above)))
    if parameter.startswith("limit "):
        other = set_to(problem, parameter, value + 1.0)
        ends = [coefficient_bounds(one) for one in (program, Program(other, program.control, 1))]
        pairs = [np.array(list(one.model.limits.values())).T for one in (problem, other)]
        return Varying(value, coefficients=_slopes(*ends), limits=_slopes(*pairs))
    return Varying(value, unknown=parameter)


def _slopes(now: Any, then: Any) -> np.ndarray:
    """How fast ends of ranges go: -1, 0 or 1; they are known where the number is one greater."""
    here, there = np.array(now, float), np.array(then, float)
    both = np.isfinite(here)
    return np.where(both, np.round(np.where(both, there, 0.0) - np.where(both, here, 0.0)), 0.0)


class _Walk:
    """One family of optima, as it grows."""

    def __init__(
        self, problem: Problem, parameter: str, settings: SolveSettings, every: bool, most: int,
        progress: Report | None,
    ) -> None:  # fmt: skip
        assert problem.control is not None
        self.problem, self.parameter, self.settings, self.every = problem, parameter, settings, every
        self.most, self.progress = most, progress
        self.control: Control = replace(problem.control, method="shooting")
        self.orbits: list[Orbit] = []
        self.values: list[float] = []
        self.descents: list[int] = []
        self.changes: list[Change] = []
        self.length, self.largest, self.end, self.taken = FIRST, 0.0, "", 0
        self.renewed = np.inf
        program, solution = optimum(problem, problem.control, IPOPT_TOLERANCE)
        self._state(problem, replace(solution, points=np.zeros(0)), program.parts.steps)

    def _state(self, problem: Problem, solution: Solution, steps: int) -> None:
        """The equations at a problem and its solution, with its phase, and the point of the curve there."""
        self.steps, w = steps, solution.unknowns
        unknown = self.parameter not in {one.name for one in problem.pin} and " " not in self.parameter
        number = self.parameter in self.control.numbers
        if unknown and not number:
            at, value = len(problem.free), value_of(problem, self.parameter)
            solution = replace(solution, unknowns=replace(w, free=np.insert(w.free, at, value)))
            asked = replace(problem, free=(*problem.free, self.parameter))
        else:
            asked = problem
        assert problem.control is not None
        control = replace(problem.control, method="shooting")
        program = Program(asked, control, steps, (self.parameter,) if number else ())
        self.system = Stationary(program, solution, _varying(problem, self.parameter, program))
        self.point = self.system.started()
        self.strongest = float(np.abs(self.point.y).max(initial=0.0))

    @property
    def value(self) -> float:
        """The number, where the curve has come to."""
        return self.system.theta(self.point)

    def along(self, targets: Sequence[float]) -> Optima:
        """The family to targets, one after the other."""
        self.largest = abs(self.system.cost(self.point))
        if self.every:
            self._keep()
        for k, target in enumerate(targets):
            every = self.every and k == len(targets) - 1
            if not self._to(target, every):
                break
        if self.every or not self.orbits:
            self._keep()
        return self._optima(self.end or f"{self.parameter} reached {targets[-1]:g}")

    def _optima(self, end: str) -> Optima:
        """What there is of the family."""
        last = len(self.orbits) - 1
        changes = tuple(replace(one, index=min(one.index, last)) for one in self.changes)
        return Optima(self.problem.name, self.parameter, tuple(self.orbits), np.array(self.values),
                      tuple(self.descents), changes, end)  # fmt: skip

    def _plain(self, point: Point) -> tuple[Problem, Solution]:
        """The problem at a point, without theta among its unknowns, and its solution."""
        problem, solution = set_to(self.problem, self.parameter, self.system.theta(point)), self.system.solution(point)
        w = solution.unknowns
        if self.system.program.parts.free != (*problem.free, *self._shares()):
            solution = replace(solution, unknowns=replace(w, free=np.delete(w.free, len(problem.free))))
        return problem, solution

    def _shares(self) -> tuple[str, ...]:
        arcs = self.system.program.parts.basis.arcs
        return tuple(f"share_{k + 1}" for k in range(arcs - 1))

    def _keep(self) -> None:
        """The point as a certified orbit, on as many steps as its states no longer depend on."""
        if self.values and self.values[-1] == self.value:
            return
        began = time.perf_counter()
        problem, solution = self._plain(self.point)
        assert problem.control is not None
        control = replace(problem.control, method="shooting")
        program = Program(problem, control, self.steps)
        while (error := program.error(solution)) > AGREEMENT and self.steps < MOST_STEPS:
            finer = min(MOST_STEPS, max(self.steps + 1, int(np.ceil(self.steps * (3 * error / AGREEMENT) ** 0.125))))
            self._state(problem, solution, finer)
            problem, solution = self._plain(self.point)
            program = Program(problem, control, self.steps)
        index, descents = len(self.orbits), self.system.descents(self.point)
        named = replace(problem, name=f"{self.problem.name}-{index}", expected={})
        orbit, model = recorded(named, program, solution, self.settings, began)
        if descents:
            said = f"stationary, no least: to second order the cost falls in {descents} of the directions left"
            orbit = replace(orbit, provenance={**orbit.provenance, "optimum": said})
        told = any(
            one.index in (index - 1, index) for one in self.changes if one.kind in ("fold", "active", "inactive")
        )
        if self.every and self.descents and self.descents[-1] != descents and not told:
            self._changed("branch", f"before it: the cost falls in {descents} directions, not {self.descents[-1]}")
        orbit = certified(orbit, model)
        self.orbits.append(orbit)
        self.values.append(self.value)
        self.descents.append(descents)
        self.largest = max(self.largest, abs(self.system.cost(self.point)))
        finished(lambda: self._optima(STOPPED))
        if self.progress:
            self.progress(self.value, self.orbits[-1])

    def _to(self, target: float, every: bool) -> bool:
        """Along the curve until the number is the target; whether it came there."""
        sense = np.zeros(self.point.z.size)
        sense[self.system.place] = np.sign(target - self.value) or 1.0
        if abs(target - self.value) > 1e-14 * self.system.span:
            tangent, change = self.system.tangent(self.point, sense)
            self._sides(tangent)
            while True:
                if self.taken >= self.most or len(self.orbits) >= self.most:
                    self.end = f"{self.most} points"
                    return False
                self.taken += 1
                try:
                    arrived, tangent, change = self._step(target, tangent, change)
                except ConvergenceError as error:
                    if abs(self.value - self.renewed) <= TOGETHER * self.system.span:
                        self.end = f"no step leads on from {self.parameter} {self.value:.9g}: {error}"
                        return False
                    tangent, change = self._renewed(tangent, change)
                    continue
                if arrived:
                    break
                if every:
                    tangent, change = self._kept(tangent, change)
        if abs(self.system.cost(self.point)) <= COSTLESS * self.largest:
            self._extreme()
        self._keep()
        return True

    def _renewed(self, tangent: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The tangent, where equations can be stated anew at the point: with its phase, in its sizes."""
        before, point = self.system, self.point
        try:
            self._state(*self._plain(point), self.steps)
            tangent, change = self.system.tangent(self.point, tangent * before.sizes / self.system.sizes)
        except ConvergenceError:
            self.system, self.point = before, point
        self.renewed, self.length = self.value, FIRST
        return tangent, change

    def _kept(self, tangent: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The point kept; the tangent, again where the equations were stated anew for it."""
        before = self.system
        self._keep()
        if self.system is before:
            return tangent, change
        return self.system.tangent(self.point, tangent * before.sizes / self.system.sizes)

    def _sides(self, tangent: np.ndarray) -> None:
        """Which way number and cost go."""
        self.onward = float(np.sign(tangent[self.system.place])) or 1.0
        self.rising = float(np.sign(self.system.slope(self.point, tangent)))

    def _step(self, target: float, tangent: np.ndarray, change: np.ndarray) -> tuple[bool, np.ndarray, np.ndarray]:
        """A step to the first of: its end, a change, the target. Whether it is the target, and the tangent there."""
        system, begin = self.system, self.point
        length, new, ahead = self._ahead(tangent, change)
        if np.abs(new.y).max(initial=0.0) > UNBOUNDED * max(self.strongest, 1.0):
            raise ConvergenceError("multipliers grow without bound: beyond, no motion does what is asked")
        margins, sides = system.margins(new)
        wrong = np.flatnonzero(margins < -VIOLATED)
        side = np.sign(target - system.theta(begin))
        watches: dict[str, Callable[[Point, np.ndarray], float]] = {
            "target": lambda at, _: side * (target - system.theta(at)) / system.span,
            "fold": lambda _, along: self.onward * along[system.place],
            "cost": lambda at, along: self.rising * system.slope(at, along),
        }
        if wrong.size:
            watches["constraint"] = lambda at, _: float(system.margins(at)[0][wrong].min())
        found = []
        for kind, watch in watches.items():
            if watch(new, ahead[0]) < 0 or (kind == "target" and watch(new, ahead[0]) == 0):
                found.append((self._located(watch, begin, (tangent, change), length, new, ahead[0]), kind))
        if not found:
            self.point = new
            self.length = min(LONGEST, length * GROWTH)
            return False, *ahead
        share, kind = min(found)
        folds = [one for one, what in found if what == "fold"]
        if kind == "cost" and folds and folds[0] - share <= TOGETHER * length:
            share, kind = folds[0], "fold"  # where a family turns back its cost does
        self.point = new if share >= length else self._at(begin, tangent, change, share)
        if kind == "target":
            unit = np.zeros(begin.z.size)
            unit[system.place] = 1.0
            z = self.point.z.copy()
            z[system.place] = target / system.span
            self.point = system.corrected(z, self.point, unit)
            return True, tangent, change
        if kind == "constraint":
            return False, *self._turned([(int(k), int(sides[k])) for k in wrong], tangent)
        along = system.tangent(self.point, tangent)
        if kind == "fold":
            self._changed("fold", f"{self.parameter} turns back")
            self.onward, self.rising = -self.onward, -self.rising
        else:
            self._extreme()
            self.rising = -self.rising
        return False, *along

    def _ahead(self, tangent: np.ndarray, change: np.ndarray) -> tuple[float, Point, tuple[np.ndarray, np.ndarray]]:
        """A step that can be corrected and bends little: its length, its end, the tangent there."""
        length, why = self.length, ConvergenceError("it bends too sharply")
        while length > SHORTEST * FIRST:
            try:
                new = self._at(self.point, tangent, change, length)
                ahead = self.system.tangent(new, tangent)
                if float(ahead[0] @ tangent) >= BEND:
                    return length, new, ahead
            except ConvergenceError as error:
                why = error
            length /= 2
        raise why

    def _at(self, begin: Point, tangent: np.ndarray, change: np.ndarray, length: float) -> Point:
        near = moved(begin, tangent, change, length)
        return self.system.corrected(near.z, near, tangent)

    def _located(
        self, watch: Callable[[Point, np.ndarray], float], begin: Point, step: tuple[np.ndarray, np.ndarray],
        length: float, new: Point, ahead: np.ndarray,
    ) -> float:  # fmt: skip
        """Where along a step something becomes negative."""
        if watch(begin, step[0]) <= 0:
            return 0.0
        if watch(new, ahead) == 0:
            return length

        def value(share: float) -> float:
            if share in (0.0, length):
                return watch(begin, step[0]) if share == 0.0 else watch(new, ahead)
            at = self._at(begin, *step, share)
            return watch(at, self.system.tangent(at, step[0])[0])

        return float(brentq(value, 0.0, length, xtol=LOCATED * length, maxiter=LOOKS, disp=False))

    def _turned(self, wrong: list[tuple[int, int]], tangent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The curve beyond a corner, where the active set changes: its tangent there."""
        system, at = self.system, self.point
        margins = system.margins(at)[0]
        changed = [(k, side) for k, side in wrong if margins[k] <= TOGETHER]
        gone = [k for k, _ in changed if k in at.active]
        active = {k: side for k, side in at.active.items() if k not in gone}
        active = system.independent(at, active | {k: side for k, side in changed if k not in gone})
        y = np.zeros(at.y.size)
        y[list(active)] = at.y[list(active)]
        self.point = Point(at.z, y, active)
        along, change = system.tangent(self.point, tangent)
        trial = moved(self.point, along, change, TOGETHER)
        told = [k for k, _ in changed]
        rates = system.margins(trial)[0][told] - system.margins(self.point)[0][told]
        if float(np.sum(np.sign(rates))) < 0:
            along, change, rates = -along, -change, -rates
        if np.any(rates < -TOGETHER * np.abs(rates).max()):
            where = f"{system.name(*changed[0])} and {len(changed) - 1} more"
            raise ConvergenceError(f"the constraints met there leave no way on, which is where motions end ({where})")
        words = [system.name(k, side) for k, side in changed]
        detail = "; ".join(words[:3]) + (f" and {len(words) - 3} more" if len(words) > 3 else "")
        self._changed("inactive" if gone else "active", detail)
        if along[system.place] * self.onward < 0:
            self._changed("fold", f"{self.parameter} turns back where the active constraints change")
        self._sides(along)
        self.length = min(self.length, FIRST)
        return along, change

    def _extreme(self) -> None:
        cost = abs(self.system.cost(self.point))
        if cost <= COSTLESS * self.largest:
            self._changed("costless", "no control is needed: the mechanism does it alone")
        else:
            self._changed("least" if self.rising < 0 else "largest", "of the cost along the family")

    def _changed(self, kind: str, detail: str) -> None:
        last = self.changes[-1] if self.changes else None
        if last is not None and last.kind == kind and abs(last.value - self.value) <= TOGETHER * self.system.span:
            return
        period = self.system.solution(self.point).unknowns.period
        self.changes.append(Change(kind, len(self.orbits), self.value, self.system.cost(self.point), period, detail))
