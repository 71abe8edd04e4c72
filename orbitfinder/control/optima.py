"""Families of optima: controlled motions of least cost along a number that they depend on, round turning points.

The curve is that of the conditions of an optimum (`loops.stationary`), followed by arclength: predictor along the
tangent, corrector by Newton's method normal to it. Between points it is looked at where a constraint becomes active or
is let go (the curve has a corner there), where it turns back, and where the cost is least along it. Every point that
is kept is certified as any controlled orbit: from its record, by other means.

Every step is a line of a journal that says which other one it comes after: what is asked for later, farther or
elsewhere, goes on from the last line that it shares.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.keeping import STOPPED, finished
from orbitfinder.continuation.follow import LOCATED, Pace, point_limit, walked, zero
from orbitfinder.control.find import IPOPT_TOLERANCE, recorded
from orbitfinder.control.optimum import Change, Optima
from orbitfinder.control.program import AGREEMENT, MOST_STEPS, Program, Solution, coefficient_bounds, finer, optimum
from orbitfinder.control.stationary import VIOLATED, Point, Stationary, Varying, moved
from orbitfinder.errors import ConvergenceError, InputError, closest
from orbitfinder.loops.control import Task
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import altered
from orbitfinder.orbits.certify import certified
from orbitfinder.records.codec import plain
from orbitfinder.records.family import End
from orbitfinder.records.journal import Checkpoints, checkpoints
from orbitfinder.records.orbit import Orbit, orbit_from_document, orbit_to_document
from orbitfinder.records.reading import typed

PACE = Pace(first=0.02, shortest=2e-7, longest=0.3, points=200, bend=0.9, growth=1.6)
HERE = 1e-14
"""A target is reached where the number is as near, in its size"""
TOGETHER = 1e-6
"""Constraints change together where their margins are this near"""
UNBOUNDED = 1e7
"""Multipliers that grow by this end a family: where what is asked ceases to be possible"""
COSTLESS = 1e-12
"""A cost is none at this share of the largest met"""
TOLD = ("fold", "active", "inactive")
"""What may change the number of directions that lower the cost, without other optima branching off"""

Report = Callable[[float, Orbit], None]
Watch = Callable[[Point, np.ndarray], float]
"""What becomes negative, of a point and the tangent there"""


def follow_optima(
    problem: Problem, parameter: str, values: Sequence[float] = (), settings: SolveSettings | None = None, *,
    until: float | None = None, points: int = PACE.points, pace: Pace = PACE, progress: Report | None = None,
    name: str = "", out: str | Path | None = None,
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
        pace: lengths of steps, in root mean squares of the unknowns' sizes (an `orbitfinder.continuation.follow.Pace`).
        progress: called with each optimum.
        name: a word for files; the problem's without one.
        out: a folder: OUT/<name>/optima.jsonl keeps every step as it comes, and what was asked before goes on from
            there; optima that it has come without samples.

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
    own, label = value_of(problem, parameter), name or problem.name
    start = problem if own == (first := targets[0] if values else own) else set_to(problem, parameter, first)
    stated = {one.name: getattr(start, one.name) for one in fields(start) if one.name != "model"}
    chosen, walking = settings or SolveSettings(), replace(pace, points=points)
    request = {
        "problem": {**stated, "system": dict(start.model.system)}, "parameter": parameter,
        "values": None if until is None else targets[:-1], "settings": replace(chosen, limit=None),
        "pace": replace(walking, points=0),
    }  # fmt: skip
    path = None if out is None else Path(out) / label / "optima.jsonl"
    with checkpoints(path, plain(request), lambda entries: typed(_Line, entries, "")) as journal:
        walk = _Walk(start, parameter, targets, until is not None, chosen, walking, progress, label, journal)
        return walk.along()


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
        return replace(problem, model=altered(model, limits=limits, system=system))
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


Tangent = tuple[np.ndarray, np.ndarray]
"""By z, and by the multipliers"""


@dataclass(frozen=True, eq=False)
class _Line:
    """Where a walk stands and all that decides how it goes on: a line of the journal.

    Its equations were stated at the value `stated` with a solution, in so many steps; `strongest` were the multipliers
    there. `leg` counts the targets that it has come to, `taken` its steps; the next has this `length`. `largest` is the
    largest cost met, `renewed` the value at which equations were stated anew for want of a step, `onward` and `rising`
    are the ways in which number and cost go along the tangent, which a walk has that is on the way to a target.

    It comes after the line with number `after`, on the way to `target`, at `value`; `orbit` is the optimum kept there.
    """

    stated: float
    solution: Solution
    steps: int
    point: Point
    length: float
    strongest: float = 0.0
    largest: float = 0.0
    leg: int = 0
    taken: int = 0
    renewed: float | None = None
    tangent: Tangent | None = None
    onward: float = 1.0
    rising: float = 0.0
    changes: tuple[Change, ...] = ()
    after: int = -1
    target: float = 0.0
    value: float = 0.0
    end: End | None = None
    orbit: Mapping[str, Any] | None = None
    descents: int = 0


@dataclass(frozen=True)
class _Step:
    """What the walk does next: whether the optimum there is kept, and the end where there is one."""

    keep: bool
    end: End | None = None


@dataclass(eq=False)
class _Walk:
    """A family of optima, as it grows: the walk to its targets, one after the other; `every` step of the last kept."""

    problem: Problem
    parameter: str
    targets: Sequence[float]
    every: bool
    settings: SolveSettings
    pace: Pace
    progress: Report | None
    name: str
    journal: Checkpoints[_Line]
    kept: list[tuple[_Line, Orbit]] = field(default_factory=list)
    last: int = -1
    lines: int = 0
    stand: _Line = field(init=False)

    def along(self) -> Optima:
        """The family: what the journal knows of it, and what comes then."""
        known = self.journal.known
        self.lines = len(known)
        while following := [k for k, line in enumerate(known) if line.after == self.last and self._holds(line)]:
            line = known[following[0]]
            orbit = None if line.orbit is None else orbit_from_document(line.orbit, str(self.journal.path))
            self._take(following[0], line, orbit)
        if self.last < 0:
            assert self.problem.control is not None
            program, solution = optimum(self.problem, self.problem.control, IPOPT_TOLERANCE)
            value, solution = value_of(self.problem, self.parameter), replace(solution, points=np.zeros(0))
            nowhere = Point(np.zeros(0), np.zeros(0), {})
            self._begin(_Line(value, solution, program.parts.steps, nowhere, self.pace.first))
            self.stand = replace(self.stand, largest=abs(self.system.cost(self.stand.point)))
            self._add(_Step(self.every))
        while self.stand.leg < len(self.targets) and (self.stand.end is None or self.stand.end.kind == "target"):
            for step in walked(self, self.pace.points):
                self._add(step)
        end = self.stand.end
        assert end is not None
        return self._optima(f"{self.pace.points} points" if end.kind == "point limit" else end.reason)

    def _holds(self, line: _Line) -> bool:
        """Whether a line that comes after the one where the walk stands is what it would do now."""
        if line.after < 0 or self.stand.leg == len(self.targets):
            return line.after < 0
        stand, kind, target = self.stand, "" if line.end is None else line.end.kind, self.targets[self.stand.leg]
        full = stand.taken >= self.pace.points or len(self.kept) >= self.pace.points
        if (full and line.taken > stand.taken) or (kind == "point limit" and not full):
            return False
        passed = (target - stand.value) * (target - line.value) <= 0
        turned = stand.tangent is None and (target - stand.value) * (line.target - stand.value) < 0
        return line.target == target or not (kind == "target" or passed or turned)

    def _add(self, step: _Step) -> None:
        """A step as a line of the journal, with the optimum where it leads to if that is kept."""
        target = self.targets[self.stand.leg]
        if step.end is not None:
            reached = step.end.kind == "target"
            if reached and abs(self.system.cost(self.stand.point)) <= COSTLESS * self.stand.largest:
                self._extreme()
            self.stand = replace(self.stand, tangent=None, leg=self.stand.leg + reached)
        keep = step.keep and not (self.kept and self.kept[-1][0].value == self.value)
        orbit, descents = self._optimum() if keep else (None, 0)
        line = replace(
            self.stand, after=self.last, target=target, value=self.value, end=step.end, descents=descents,
            orbit=None if orbit is None else orbit_to_document(orbit),
        )  # fmt: skip
        self.journal.add(plain(line))
        self._take(self.lines, line, orbit)
        self.lines += 1

    def _take(self, number: int, line: _Line, orbit: Orbit | None) -> None:
        """On to where a line leads, a new one or one that the journal knows."""
        self.last, self.stand = number, line
        if orbit is not None:
            self.kept.append((line, orbit))
            finished(lambda: self._optima(STOPPED))
            if self.progress:
                self.progress(line.value, orbit)

    def _optima(self, end: str) -> Optima:
        """What there is of the family."""
        last = len(self.kept) - 1
        changes = tuple(replace(one, index=min(one.index, last)) for one in self.stand.changes)
        lines, orbits = zip(*self.kept, strict=True) if self.kept else ((), ())
        values, descents = np.array([one.value for one in lines]), tuple(one.descents for one in lines)
        return Optima(self.name, self.parameter, orbits, values, descents, changes, end)

    @cached_property
    def system(self) -> Stationary:
        """The equations, as they were stated last."""
        stand, name = self.stand, self.parameter
        problem, solution, w = set_to(self.problem, name, stand.stated), stand.solution, stand.solution.unknowns
        assert problem.control is not None
        whole, number = problem, name in problem.control.numbers
        if not number and " " not in name and name not in {one.name for one in problem.pin}:
            free = np.insert(w.free, len(problem.free), stand.stated)
            solution = replace(solution, unknowns=replace(w, free=free))
            whole = replace(problem, free=(*problem.free, name))
        program = Program(whole, replace(problem.control, method="shooting"), stand.steps, (name,) if number else ())
        return Stationary(program, solution, _varying(problem, name, program))

    @property
    def value(self) -> float:
        """The number, where the curve has come to."""
        return self.system.theta(self.stand.point)

    @property
    def tangent(self) -> Tangent:
        """The tangent where it stands."""
        assert self.stand.tangent is not None
        return self.stand.tangent

    def _plain(self) -> tuple[Problem, Solution]:
        """The problem where the walk stands, without theta among its unknowns, and its solution."""
        problem, solution = set_to(self.problem, self.parameter, self.value), self.system.solution(self.stand.point)
        w = solution.unknowns
        if self.system.program.problem.free != problem.free:
            solution = replace(solution, unknowns=replace(w, free=np.delete(w.free, len(problem.free))))
        return problem, solution

    def _begin(self, stand: _Line) -> None:
        """Stand where the equations lead that are stated as it says."""
        self.stand = stand
        vars(self).pop("system", None)
        point = self.system.started()
        self.stand = replace(stand, point=point, strongest=float(np.abs(point.y).max(initial=0.0)))

    def _renew(self, steps: int) -> None:
        """The equations stated anew where the walk stands: with the phase and in the sizes there, in so many steps."""
        tangent, sizes = self.stand.tangent, self.system.sizes
        self._begin(replace(self.stand, stated=self.value, solution=self._plain()[1], steps=steps))
        if tangent is not None:
            tangent = self.system.tangent(self.stand.point, tangent[0] * sizes / self.system.sizes)
            self.stand = replace(self.stand, tangent=tangent)

    def _optimum(self) -> tuple[Orbit, int]:
        """A certified orbit where the walk stands, on as many steps as its states no longer depend on; descents."""
        began = time.perf_counter()
        while True:
            (problem, solution), steps = self._plain(), self.stand.steps
            assert problem.control is not None
            program = Program(problem, replace(problem.control, method="shooting"), steps)
            if (error := program.error(solution)) <= AGREEMENT or steps >= MOST_STEPS:
                break
            self._renew(finer(steps, error, AGREEMENT, 8))
        index, descents = len(self.kept), self.system.descents(self.stand.point)
        named = replace(problem, name=f"{self.problem.name}-{index}", expected={})
        orbit, model = recorded(named, program, solution, self.settings, began)
        if descents:
            said = f"stationary, no least: to second order the cost falls in {descents} of the directions left"
            orbit = replace(orbit, provenance={**orbit.provenance, "optimum": said})
        told = any(one.index in (index - 1, index) and one.kind in TOLD for one in self.stand.changes)
        if self.every and self.kept and (last := self.kept[-1][0].descents) != descents and not told:
            self._changed("branch", f"before it: the cost falls in {descents} directions, not {last}")
        orbit = certified(orbit, model)
        largest = max(self.stand.largest, abs(self.system.cost(self.stand.point)))
        self.stand = replace(self.stand, largest=largest)
        return orbit, descents

    def _head(self, tangent: Tangent) -> None:
        """On along a tangent."""
        onward = float(np.sign(tangent[0][self.system.place])) or 1.0
        rising = float(np.sign(self.system.slope(self.stand.point, tangent[0])))
        self.stand = replace(self.stand, tangent=tangent, onward=onward, rising=rising)

    def taken(self) -> int:
        return self.stand.taken

    def approach(self) -> tuple[float, End | None]:
        stand, target = self.stand, self.targets[self.stand.leg]
        if abs(target - self.value) <= HERE * self.system.span:
            return 0.0, End("target", f"{self.parameter} reached {target:g}")
        if len(self.kept) >= self.pace.points:
            return 0.0, point_limit(self.pace.points)
        if stand.tangent is None:
            sense = np.zeros(stand.point.z.size)
            sense[self.system.place] = np.sign(target - self.value)
            self._head(self.system.tangent(stand.point, sense))
        self.stand = replace(self.stand, taken=stand.taken + 1)
        return stand.length, None

    def shortest(self) -> float:
        return self.pace.shortest

    def advance(self, length: float) -> _Step:
        """By one step of this length, or to the first of what lies before its end: a change, the target."""
        new = self._at(length)
        tangent = self.system.tangent(new, self.tangent[0])
        if float(tangent[0] @ self.tangent[0]) < self.pace.bend:
            raise ConvergenceError("it bends too sharply")
        try:
            return self._met(length, new, tangent)
        except ConvergenceError as error:  # not for its length
            return self.failed(str(error))

    def failed(self, reason: str) -> _Step:
        """On with equations stated anew, with the phase and in the sizes of the point; where they are that, the end."""
        renewed, before, stand = self.stand.renewed, self.system, self.stand
        if renewed is not None and abs(self.value - renewed) <= TOGETHER * before.span:
            said = f"no step leads on from {self.parameter} {self.value:.9g}: {reason}"
            return self.ended(End("step underflow", said))
        try:
            self._renew(stand.steps)
        except ConvergenceError:
            self.system, self.stand = before, stand
        self.stand = replace(self.stand, renewed=self.value, length=self.pace.first)
        return _Step(False)

    def ended(self, end: End) -> _Step:
        return _Step(end.kind == "target" or self.every or not self.kept, end)

    def _met(self, length: float, new: Point, ahead: Tangent) -> _Step:
        """On to the end of a step, or to the first of what lies before."""
        system, stand, target = self.system, self.stand, self.targets[self.stand.leg]
        if np.abs(new.y).max(initial=0.0) > UNBOUNDED * max(stand.strongest, 1.0):
            raise ConvergenceError("multipliers grow without bound: beyond, no motion does what is asked")
        margins, sides = system.margins(new)
        wrong = np.flatnonzero(margins < -VIOLATED)
        side = np.sign(target - self.value)
        watches: dict[str, Watch] = {
            "target": lambda at, _: side * (target - system.theta(at)) / system.span,
            "fold": lambda _, along: stand.onward * along[system.place],
            "cost": lambda at, along: stand.rising * system.slope(at, along),
        }
        if wrong.size:
            watches["constraint"] = lambda at, _: float(system.margins(at)[0][wrong].min())
        found = []
        for kind, watch in watches.items():
            if (last := watch(new, ahead[0])) < 0 or (kind == "target" and last == 0):
                found.append((self._located(watch, length, last), kind))
        step = _Step(self.every and stand.leg == len(self.targets) - 1)
        if not found:
            self.stand = replace(stand, point=new, tangent=ahead, length=self.pace.next(length, 0))
            return step
        share, kind = min(found)
        folds = [one for one, what in found if what == "fold"]
        if kind == "cost" and folds and folds[0] - share <= TOGETHER * length:
            share, kind = folds[0], "fold"  # where a family turns back its cost does
        self.stand = replace(stand, point=new if share >= length else self._at(share))
        if kind == "target":
            unit, z = np.zeros(new.z.size), self.stand.point.z.copy()
            unit[system.place], z[system.place] = 1.0, target / system.span
            self.stand = replace(stand, point=system.corrected(z, self.stand.point, unit))
            return self.ended(End("target", f"{self.parameter} reached {target:g}"))
        if kind == "constraint":
            self._turn([(int(k), int(sides[k])) for k in wrong])
            return step
        tangent, onward = system.tangent(self.stand.point, self.tangent[0]), stand.onward
        if kind == "fold":
            self._changed("fold", f"{self.parameter} turns back")
            onward = -onward
        else:
            self._extreme()
        self.stand = replace(self.stand, tangent=tangent, onward=onward, rising=-stand.rising)
        return step

    def _at(self, length: float) -> Point:
        """The point of the curve in the plane across the tangent at a length. Raises `ConvergenceError`."""
        near = moved(self.stand.point, *self.tangent, length)
        return self.system.corrected(near.z, near, self.tangent[0])

    def _located(self, watch: Watch, length: float, last: float) -> float:
        """Where along a step something becomes negative that is `last` at its end."""
        ends = {0.0: watch(self.stand.point, self.tangent[0]), length: last}

        def value(share: float) -> float:
            if share in ends:
                return ends[share]
            at = self._at(share)
            return watch(at, self.system.tangent(at, self.tangent[0])[0])

        if ends[0.0] <= 0 or last == 0:
            return 0.0 if ends[0.0] <= 0 else length
        return zero(value, 0.0, length, LOCATED * length)

    def _turn(self, wrong: list[tuple[int, int]]) -> None:
        """Along the curve beyond a corner, where the active set changes. Raises `ConvergenceError`."""
        system, at = self.system, self.stand.point
        margins = system.margins(at)[0]
        changed = [(k, side) for k, side in wrong if margins[k] <= TOGETHER]
        gone = [k for k, _ in changed if k in at.active]
        active = {k: side for k, side in at.active.items() if k not in gone}
        active = system.independent(at, active | {k: side for k, side in changed if k not in gone})
        y = np.zeros(at.y.size)
        y[list(active)] = at.y[list(active)]
        point = Point(at.z, y, active)
        self.stand = replace(self.stand, point=point)
        along, change = system.tangent(point, self.tangent[0])
        trial = moved(point, along, change, TOGETHER)
        told = [k for k, _ in changed]
        rates = system.margins(trial)[0][told] - system.margins(point)[0][told]
        if float(np.sum(np.sign(rates))) < 0:
            along, change, rates = -along, -change, -rates
        if np.any(rates < -TOGETHER * np.abs(rates).max()):
            where = f"{system.name(*changed[0])} and {len(changed) - 1} more"
            raise ConvergenceError(f"the constraints met there leave no way on, which is where motions end ({where})")
        words = [system.name(k, side) for k, side in changed]
        detail = "; ".join(words[:3]) + (f" and {len(words) - 3} more" if len(words) > 3 else "")
        self._changed("inactive" if gone else "active", detail)
        if along[system.place] * self.stand.onward < 0:
            self._changed("fold", f"{self.parameter} turns back where the active constraints change")
        self._head((along, change))
        self.stand = replace(self.stand, length=min(self.stand.length, self.pace.first))

    def _extreme(self) -> None:
        stand = self.stand
        if abs(self.system.cost(stand.point)) <= COSTLESS * stand.largest:
            self._changed("costless", "no control is needed: the mechanism does it alone")
        else:
            self._changed("least" if stand.rising < 0 else "largest", "of the cost along the family")

    def _changed(self, kind: str, detail: str) -> None:
        point, changes = self.stand.point, self.stand.changes
        if changes and changes[-1].kind == kind and abs(changes[-1].value - self.value) <= TOGETHER * self.system.span:
            return
        period = self.system.solution(point).unknowns.period
        new = Change(kind, len(self.kept), self.value, self.system.cost(point), period, detail)
        self.stand = replace(self.stand, changes=(*changes, new))
