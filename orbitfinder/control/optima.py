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
from collections import ChainMap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.keeping import STOPPED, finished
from orbitfinder.continuation.follow import LOCATED, Pace, point_limit, walked, zero
from orbitfinder.control.find import IPOPT_TOLERANCE, recorded
from orbitfinder.control.optimum import Change, Optima
from orbitfinder.control.program import AGREEMENT, MOST_STEPS, Optimum, Program, coefficient_bounds, finer, optimum
from orbitfinder.control.stationary import VIOLATED, Extremal, Stationary, Varying, moved
from orbitfinder.errors import ConvergenceError, InputError, closest
from orbitfinder.loops.control import Task
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.kind import check_reachable, with_parameters
from orbitfinder.mechanics.model import altered
from orbitfinder.orbits.certify import certified
from orbitfinder.records.codec import plain
from orbitfinder.records.family import End
from orbitfinder.records.journal import Checkpoints, checkpoints
from orbitfinder.records.orbit import Orbit, orbit_from_document, orbit_to_document
from orbitfinder.records.reading import Table, typed

PACE = Pace(first=0.02, shortest=2e-7, longest=0.3, points=200, bend=0.9, growth=1.6)
TOGETHER = 1e-6
"""Constraints change together where their margins are this near"""
COSTLESS = 1e-12
"""A cost is none at this share of the largest met"""

Report = Callable[[float, Orbit], None]
Watch = Callable[[Extremal, np.ndarray], float]
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
    targets = [float(value) for value in (*values, *(() if until is None else (until,)))]
    if not targets or not np.all(np.isfinite(targets)):
        raise InputError(f"values: {list(values)}; give finite values of {parameter}, or until")
    check_reachable(problem.model, parameter, {"values": values, "until": () if until is None else (until,)})
    if points < 1:
        raise InputError(f"points: must be at least 1, got {points}")
    own, label = value_of(problem, parameter), name or problem.name
    start = problem if own == (first := targets[0] if values else own) else set_to(problem, parameter, first)
    stated = {part.name: getattr(start, part.name) for part in fields(start) if part.name != "model"}
    chosen, walking = settings or SolveSettings(), replace(pace, points=points)
    request = {
        "problem": {**stated, "system": dict(start.model.system)}, "parameter": parameter,
        "values": None if until is None else targets[:-1], "settings": replace(chosen, limit=None),
        "pace": replace(walking, points=0),
    }  # fmt: skip
    path = None if out is None else Path(out) / label / "optima.jsonl"
    with checkpoints(path, plain(request), lambda entries: typed(_Stand, entries, "")) as journal:
        walk = _OptimaWalk(start, parameter, targets, until is not None, chosen, walking, progress, label, journal)
        return walk.along()


def _numbers(problem: Problem) -> ChainMap[str, float]:
    """What a family may be followed in, by name, and where a problem stands."""
    control, model = problem.control, problem.model
    assert control is not None
    asked = {f"task {k}": next(x for x in (task.equals, task.highest, task.lowest) if x is not None)
             for k, task in enumerate(control.tasks, 1)}  # fmt: skip
    limits = {f"limit {name}": high if np.isfinite(high) else low for name, (low, high) in model.limits.items()}
    physical = model.named_parameters
    for name in {*problem.free, *model.controls} & physical.keys():
        del physical[name]
    return ChainMap({pin.name: pin.value for pin in problem.pin}, dict(control.numbers), asked, limits, physical)


def value_of(problem: Problem, parameter: str) -> float:
    """Where a problem stands in a number. Raises `InputError`."""
    numbers = _numbers(problem)
    if parameter in numbers:
        return float(numbers[parameter])
    known = [name for names in numbers.maps for name in names]
    raise InputError(
        f"parameter: {parameter!r} is no pin and no physical parameter{closest(parameter, known)}; of this problem "
        f"there are {', '.join(known[:12])}"
    )


def set_to(problem: Problem, parameter: str, value: float) -> Problem:
    """The problem with a number at another value. Raises `InputError`."""
    value_of(problem, parameter)
    control, model, name = problem.control, problem.model, parameter.partition(" ")[2]
    assert control is not None
    if parameter in {pin.name for pin in problem.pin}:
        pins = tuple(replace(pin, value=value) if pin.name == parameter else pin for pin in problem.pin)
        period = value if parameter == "period" else problem.guess.period
        return replace(problem, pin=pins, guess=replace(problem.guess, period=period))
    if parameter in control.numbers:
        return replace(problem, control=replace(control, numbers={**control.numbers, parameter: value}))
    if parameter.startswith("limit "):
        limits = {**model.limits, name: _range(*model.limits[name], value)}
        system = {**model.system, "limits": {control: list(pair) for control, pair in limits.items()}}
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


def _asking(task: Task, value: float) -> Task:
    """A task that asks for another value."""
    if task.equals is not None:
        return replace(task, equals=value)
    low, high = _range(task.low, task.high, value)
    return replace(task, lowest=low if np.isfinite(low) else None, highest=high if np.isfinite(high) else None)


def _varying(problem: Problem, parameter: str, program: Program) -> Varying:
    """What theta is to the program."""
    control, value = problem.control, value_of(problem, parameter)
    assert control is not None
    pins = [pin.name for pin in problem.pin]
    if parameter in pins:
        return Varying(value, pin=pins.index(parameter))
    if parameter.startswith("task "):
        number = int(parameter.removeprefix("task ")) - 1
        task = control.tasks[number]
        below, above = _slopes(*((at.low, at.high) for at in (task, _asking(task, value + 1.0))))
        return Varying(value, task=number, slopes=(float(below), float(above)))
    if parameter.startswith("limit "):
        other = set_to(problem, parameter, value + 1.0)
        ends = [coefficient_bounds(at) for at in (program, Program(other, program.control, 1))]
        pairs = [np.array(list(at.model.limits.values())).T for at in (problem, other)]
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
class _Stand:
    """Where a walk stands and all that decides how it goes on: a line of the journal.

    Its equations were stated at the value `stated` with a solution, in so many steps; `strongest` were the multipliers
    there. `leg` counts the targets that it has come to, `taken` its steps; the next has this `length`. `largest` is the
    largest cost met, `renewed` the value at which equations were stated anew for want of a step, `onward` and `rising`
    are the ways in which number and cost go along the tangent, which a walk has that is on the way to a target.

    It comes after the line with number `after`, on the way to `target`, at `value`; `orbit` is the optimum kept there.
    """

    stated: float
    solution: Optimum
    steps: int
    point: Extremal
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
    orbit: Table | None = None
    descents: int = 0


@dataclass(frozen=True)
class _Step:
    """What the walk does next: whether the optimum there is kept, and the end where there is one."""

    keep: bool
    end: End | None = None


@dataclass(frozen=True)
class _Ending:
    """What an end is to the walk: a target `reached`, from where it goes on to the next, or as many points as asked."""

    reached: bool = False
    full: bool = False


def _ending(end: End | None) -> _Ending:
    endings = {"target": _Ending(reached=True), "point limit": _Ending(full=True)}
    return endings.get("" if end is None else end.kind, _Ending())


@dataclass(eq=False)
class _OptimaWalk:
    """A family of optima, as it grows: the walk to its targets, one after the other; `every` step of the last kept."""

    problem: Problem
    parameter: str
    targets: Sequence[float]
    every: bool
    settings: SolveSettings
    pace: Pace
    progress: Report | None
    name: str
    journal: Checkpoints[_Stand]
    kept: list[tuple[_Stand, Orbit]] = field(default_factory=list)
    last: int = -1
    lines: int = 0
    stand: _Stand = field(init=False)

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
            nowhere = Extremal(np.zeros(0), np.zeros(0), {})
            self._begin(_Stand(value, solution, program.parts.steps, nowhere, self.pace.first))
            self.stand = replace(self.stand, largest=abs(self.system.cost(self.stand.point)))
            self._add(_Step(self.every))
        while self.stand.leg < len(self.targets) and (self.stand.end is None or _ending(self.stand.end).reached):
            for step in walked(self, self.pace.points):
                self._add(step)
        end = self.stand.end
        assert end is not None
        return self._optima(f"{self.pace.points} points" if _ending(end).full else end.reason)

    def _holds(self, line: _Stand) -> bool:
        """Whether a line that comes after the one where the walk stands is what it would do now."""
        if line.after < 0 or self.stand.leg == len(self.targets):
            return line.after < 0
        stand, ending, target = self.stand, _ending(line.end), self.targets[self.stand.leg]
        full = stand.taken >= self.pace.points or len(self.kept) >= self.pace.points
        if (full and line.taken > stand.taken) or (ending.full and not full):
            return False
        passed = (target - stand.value) * (target - line.value) <= 0
        turned = stand.tangent is None and (target - stand.value) * (line.target - stand.value) < 0
        return line.target == target or not (ending.reached or passed or turned)

    def _add(self, step: _Step) -> None:
        """A step as a line of the journal, with the optimum where it leads to if that is kept."""
        target = self.targets[self.stand.leg]
        if step.end is not None:
            reached = _ending(step.end).reached
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

    def _take(self, number: int, line: _Stand, orbit: Orbit | None) -> None:
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
        changes = tuple(replace(change, index=min(change.index, last)) for change in self.stand.changes)
        lines, orbits = zip(*self.kept, strict=True) if self.kept else ((), ())
        values, descents = np.array([line.value for line in lines]), tuple(line.descents for line in lines)
        return Optima(self.name, self.parameter, orbits, values, descents, changes, end)

    @cached_property
    def system(self) -> Stationary:
        """The equations, as they were stated last."""
        stand, name = self.stand, self.parameter
        problem, solution, w = set_to(self.problem, name, stand.stated), stand.solution, stand.solution.unknowns
        assert problem.control is not None
        whole, number = problem, name in problem.control.numbers
        if not number and " " not in name and name not in {pin.name for pin in problem.pin}:
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

    def _plain(self) -> tuple[Problem, Optimum]:
        """The problem where the walk stands, without theta among its unknowns, and its solution."""
        problem, solution = set_to(self.problem, self.parameter, self.value), self.system.solution(self.stand.point)
        w = solution.unknowns
        if self.system.program.problem.free != problem.free:
            solution = replace(solution, unknowns=replace(w, free=np.delete(w.free, len(problem.free))))
        return problem, solution

    def _begin(self, stand: _Stand) -> None:
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
        told = any(change.index in (index - 1, index) and change.kind in ("fold", "active", "inactive")
                   for change in self.stand.changes)  # fmt: skip
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
        if abs(target - self.value) <= 1e-14 * self.system.span:
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
        return _Step(_ending(end).reached or self.every or not self.kept, end)

    def _met(self, length: float, new: Extremal, ahead: Tangent) -> _Step:
        """On to the end of a step, or to the first of what lies before."""
        system, stand, target = self.system, self.stand, self.targets[self.stand.leg]
        if np.abs(new.y).max(initial=0.0) > 1e7 * max(stand.strongest, 1.0):
            raise ConvergenceError("multipliers grow without bound: beyond, no motion does what is asked")
        margins, sides = system.margins(new)
        wrong = {int(k): int(sides[k]) for k in np.flatnonzero(margins < -VIOLATED)}
        side = np.sign(target - self.value)
        events: dict[str, tuple[Watch, Callable[[], None]]] = {
            "target": (lambda at, _: side * (target - system.theta(at)) / system.span, self._reach),
            "fold": (lambda _, along: stand.onward * along[system.place], self._fold),
            "cost": (lambda at, along: stand.rising * system.slope(at, along), self._past),
            "constraint": (lambda at, _: float(system.margins(at)[0][list(wrong)].min(initial=np.inf)),
                           partial(self._turn, wrong)),
        }  # fmt: skip
        shares = {}
        for name, (watch, _) in events.items():
            if (last := watch(new, ahead[0])) < 0 or (name == "target" and last == 0):
                shares[name] = self._located(watch, length, last)
        if not shares:
            self.stand = replace(stand, point=new, tangent=ahead, length=self.pace.next(length, 0))
            return _Step(self.every and stand.leg == len(self.targets) - 1)
        first = min(shares, key=lambda name: (shares[name], name))
        if first == "cost" and shares.get("fold", np.inf) - shares[first] <= TOGETHER * length:
            first = "fold"  # where a family turns back its cost does
        self.stand = replace(stand, point=new if shares[first] >= length else self._at(shares[first]))
        events[first][1]()
        if first == "target":
            return self.ended(End("target", f"{self.parameter} reached {target:g}"))
        return _Step(self.every and stand.leg == len(self.targets) - 1)

    def _reach(self) -> None:
        """To the target itself."""
        system, point, target = self.system, self.stand.point, self.targets[self.stand.leg]
        unit, z = np.zeros(point.z.size), point.z.copy()
        unit[system.place], z[system.place] = 1.0, target / system.span
        self.stand = replace(self.stand, point=system.corrected(z, point, unit))

    def _fold(self) -> None:
        """Round a turning point."""
        tangent = self.system.tangent(self.stand.point, self.tangent[0])
        self._changed("fold", f"{self.parameter} turns back")
        self.stand = replace(self.stand, tangent=tangent, onward=-self.stand.onward, rising=-self.stand.rising)

    def _past(self) -> None:
        """Past an extreme of the cost."""
        tangent = self.system.tangent(self.stand.point, self.tangent[0])
        self._extreme()
        self.stand = replace(self.stand, tangent=tangent, rising=-self.stand.rising)

    def _at(self, length: float) -> Extremal:
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

    def _turn(self, wrong: dict[int, int]) -> None:
        """Along the curve beyond a corner, where the active set changes. Raises `ConvergenceError`."""
        system, at = self.system, self.stand.point
        margins = system.margins(at)[0]
        changed = {k: side for k, side in wrong.items() if margins[k] <= TOGETHER}
        gone = [k for k in changed if k in at.active]
        active = {k: side for k, side in at.active.items() if k not in gone}
        active = system.independent(at, active | {k: side for k, side in changed.items() if k not in gone})
        y = np.zeros(at.y.size)
        y[list(active)] = at.y[list(active)]
        point = Extremal(at.z, y, active)
        self.stand = replace(self.stand, point=point)
        along, change = system.tangent(point, self.tangent[0])
        trial = moved(point, along, change, TOGETHER)
        rates = system.margins(trial)[0][list(changed)] - system.margins(point)[0][list(changed)]
        if float(np.sum(np.sign(rates))) < 0:
            along, change, rates = -along, -change, -rates
        words = [system.name(k, side) for k, side in changed.items()]
        if np.any(rates < -TOGETHER * np.abs(rates).max()):
            where = f"{words[0]} and {len(changed) - 1} more"
            raise ConvergenceError(f"the constraints met there leave no way on, which is where motions end ({where})")
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
        last = {change.kind: change.value for change in changes[-1:]}.get(kind, np.inf)
        if abs(last - self.value) <= TOGETHER * self.system.span:
            return
        period = self.system.solution(point).unknowns.period
        new = Change(kind, len(self.kept), self.value, self.system.cost(point), period, detail)
        self.stand = replace(self.stand, changes=(*changes, new))
