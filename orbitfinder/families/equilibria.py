"""Following equilibria: folds, branch points and Hopf points on the way, each solved for and certified."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import locks
from orbitfinder._runtime.keeping import STOPPED, finished
from orbitfinder._runtime.notebook import brief
from orbitfinder.continuation.follow import (
    Direction,
    Goals,
    KeptPoint,
    Pace,
    Test,
    Tests,
    follow,
    in_turn,
    rise,
    towards,
)
from orbitfinder.continuation.problem import Point, plane, solved
from orbitfinder.continuation.tests import Entries, Roots
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError
from orbitfinder.families.equilibrium import Equilibria, Equilibrium, RestEvent
from orbitfinder.families.rest_problem import (
    CRITICAL,
    RESIDUAL,
    ROUND_OFF,
    AtRest,
    Judge,
    Stacked,
    error_bars,
    first_lyapunov,
    paired,
    regular,
    singular,
    solve_square,
    spectrum,
    squared,
)
from orbitfinder.families.rest_starts import first_equilibrium, refuse_moving
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.integrate.jets import at_rest
from orbitfinder.mechanics.kind import build_model, check_reachable, with_parameters
from orbitfinder.mechanics.model import Model, check_state
from orbitfinder.records.family import End, Reading

PACE = Pace(first=0.01, shortest=1e-9, longest=0.05, points=400, bend=0.95, quick=4, slow=7, located=1e-6, closed=True)
"""Lengths are in the sizes of the state and of the parameter; events are solved for from where they are located"""
PERFECT, APART, ALIKE = 100.0, 1e-4, 1e-9
"""How many error bars of 0 the imperfection of a branch point is; events nearer to each other on the curve than this,
and alike to their error bars, are the same; a fold so much nearer to where a root is 0 than a branch point is that"""
LEAVING = (0.01, 0.002, 0.0004, 0.05)
"""How far from a branch point other equilibria are looked for; the first that succeeds is taken"""


@dataclass(frozen=True)
class RestBranch:
    """The other equilibria at a branch point: of which curve and event, the Model there, its state, the direction over
    (x, p), what is followed in, a name, how large components are on the curve, and its title."""

    __repr__ = brief("name", "parameter")

    equilibria: str
    number: int
    model: Model
    state: np.ndarray
    direction: np.ndarray
    parameter: str
    name: str
    largest: np.ndarray
    title: str = ""


def rest_branch(equilibria: Equilibria, number: int, model: Model | None = None) -> RestBranch:
    """The other equilibria at a branch point of this number."""
    event, name = equilibria.events[number], equilibria.parameter
    there = with_parameters(model or build_model(equilibria.system), {name: event.parameter})
    largest = np.abs([point.state for point in equilibria.points]).max(axis=0)
    state, called = (
        np.where(np.abs(event.state) <= event.error * largest, 0.0, event.state),
        f"{equilibria.name}-{number}",
    )
    return RestBranch(equilibria.name, number, there, state, event.direction, name, called, largest, equilibria.title)


@one_thread()
def follow_equilibria(
    model: Model | RestBranch, state: Sequence[float] | np.ndarray | None = None, parameter: str | None = None,
    until: float | None = None, *, at: Sequence[float] = (), points: int = PACE.points, pace: Pace = PACE,
    name: str | None = None, out: str | Path | None = None, progress: Callable[[Equilibrium], None] | None = None,
    title: str = "",
) -> Equilibria:  # fmt: skip
    """The equilibria f(x, p) = 0 of an autonomous system along a parameter, with folds, branch points, Hopf points.

    Args:
        model: the system, at the parameter's first value; or what `of.switch_branch` gives at a branch point.
        state: near an equilibrium, or where a simulation to rest begins; none of a branch.
        parameter: a physical parameter; none of a branch.
        until: its value to stop at; without one, and of a branch, both ways are gone.
        at: values at which points are computed exactly.
        points: the most in each direction.
        pace: lengths of steps.
        name: a word for files; "equilibria", or the branch's, without one.
        out: a folder: OUT/<name>/equilibria.jsonl keeps every point as it comes, and what was asked before goes on
            from there.
        progress: called with each point.
        title: what pictures are headed with.

    Returns:
        Equilibria.

    Raises:
        InputError: for a system that cannot rest, or a parameter that it has not.
        ConvergenceError: where no equilibrium is found near the state.

    Examples:
        >>> found = of.follow_equilibria(of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", until=2.4)
        >>> [(event.kind, event.criticality, round(event.parameter, 12)) for event in found.events]
        [('hopf', 'supercritical', 2.0)]
    """
    branch = model if isinstance(model, RestBranch) else None
    if isinstance(model, RestBranch):
        state, parameter, model = model.state, model.parameter, model.model
    if state is None or parameter is None:
        missing = "state" if state is None else "parameter"
        raise InputError(f"{missing}: missing; give follow_equilibria(model, state, parameter), or a branch alone")
    refuse_moving(model, parameter)
    state = check_state(model, state)
    start = model.value(parameter)
    check_goals(model, parameter, start, until, at, points)
    span, label = None if until is None else until - start, name or (branch.name if branch else "equilibria")
    judge = Judge(model, (parameter,))
    if branch is None:
        problem, rest = first_equilibrium(model, state, parameter, span)
    else:
        reach = None if span is None else np.array([span])
        problem = regular(at_rest(model, (parameter,), state), state, np.array([start]), reach)
        rest = np.concatenate([state, np.zeros(problem.jets.extra)])
        problem = problem.seen(rest, np.array([start]), branch.largest)
    leaving = branch.direction if branch else None
    request = {"system": dict(model.system), "state": state, "parameter": parameter, "way": 0, "until":
               until is not None, "direction": leaving}  # fmt: skip
    title, goals = title or (branch.title if branch else ""), Goals(parameter, until, tuple(map(float, at)))
    first = RestDirection(goals, 1.0, request, judge, problem, rest, leaving)
    both = until is None or leaving is not None
    return gone(first, both, (label, title), replace(pace, points=points), out, progress)


def gone(
    first: RestDirection, both: bool, called: tuple[str, str], pace: Pace, out: str | Path | None,
    progress: Callable[[Equilibrium], None] | None, curve: Mapping[str, Any] | None = None,
) -> Equilibria:  # fmt: skip
    """What lies in a direction, and in the other where both are wanted, each kept in a journal of OUT/<name>; it is
    `called` by name and title."""
    path, begun = None if out is None else Path(out) / called[0] / "equilibria.jsonl", list[RestDirection]()
    ways = [replace(first, sign=sign, request={**first.request, "way": k}) for k, sign in enumerate((1.0, -1.0))]
    record = partial(_record, called, curve or {}, begun)
    with locks.alone_in(path and path.parent):
        for way, file in in_turn(ways[: 1 + both], path):
            begun.append(way)
            for kept in follow(way, pace, file):
                finished(record)
                if progress:
                    progress(kept.record)
    return record()


def check_goals(
    model: Model, parameter: str, start: float, until: float | None, at: Sequence[float], points: int
) -> None:  # fmt: skip
    """`InputError` for goals that are none."""
    check_reachable(model, parameter, {"until": () if until is None else (until,), "at": at})
    if points < 1:
        raise InputError(f"points: must be at least 1, got {points}")
    if until == start:
        raise InputError(f"until: {until!r} is where {parameter} begins; give another value")


@dataclass(eq=False)
class RestDirection(Direction):
    """A direction along equilibria, from an equilibrium or beside a branch point, where the others go in `leaving`."""

    judge: Judge
    problem: AtRest
    rest: np.ndarray
    leaving: np.ndarray | None

    def begin(self) -> Point:
        """The first point, its tangent this way."""
        name = self.goals.name
        w = Stacked(np.append(self.rest, self.problem.jets.model.values_of([name])))
        if self.leaving is not None:
            return self._beside(w, self.leaving)
        point = solved(self.problem, w, lambda there: self.problem.aim(there, name, w.vector[-1]))
        return replace(point, tangent=point.tangent * self.sign * towards(point, name, self.goals.until))

    def _beside(self, w: Stacked, direction: np.ndarray) -> Point:
        """The first point of a branch, so far from where it leaves."""
        d = self.problem.jets.size
        along = np.concatenate([direction[:d], np.zeros(self.problem.jets.extra), direction[d:]]) * self.sign
        along = along / np.sqrt(float(along @ (self.problem.metric(w) * along)))
        for length in LEAVING:
            guess = w.moved(length * along)
            try:
                point = solved(self.problem, guess, plane(self.problem, guess, along))
            except UNSOLVED:
                continue
            outwards = float(np.sum(self.problem.metric(w) * point.tangent * (point.w.vector - w.vector)))
            return replace(point, tangent=point.tangent * np.sign(outwards), arclength=length)
        raise ConvergenceError(f"no other equilibria were found beside the branch point at {self.goals.name} = "
                               f"{w.vector[-1]:.9g}")  # fmt: skip

    def leads(self, first: Point) -> bool:
        """Whether a journal's first point leads this way."""
        name, until = self.goals.name, self.goals.until
        return self.leaving is not None or until is None or towards(first, name, until) > 0

    def tests(self) -> Tests:
        """What vanishes at events."""
        tests: dict[str, Test | Entries] = {"fold": lambda point: rise(point, self.goals.name)}
        return tests | {"branch_point": Entries.ROOTS} | ({} if self.paired else {"hopf": Entries.SUMS})

    @cached_property
    def paired(self) -> bool:
        """Whether eigenvalues come in pairs +-lambda."""
        values = self.problem.jets.model.values_of(self.judge.parameters)
        return paired(self.problem, Stacked(np.append(self.rest, values)))

    def spectrum(self, point: Point) -> Roots:
        """What crosses at events."""
        return squared(_roots(point)) if self.paired else _roots(point)

    def record(self, point: Point) -> Equilibrium:
        """Certified."""
        z, p, _ = point.problem.parts(point.w)
        return self.judge.record(point.problem, z, p, point.arclength * self.sign, _roots(point))

    def write(self, point: Point, record: Equilibrium) -> Mapping[str, Any]:  # noqa: ARG002 - made again when read
        """Both in plain numbers."""
        critical = point.critical and [point.critical.real, point.critical.imag]
        return point.entry | {"sizes": point.problem.sizes, "pace": point.problem.pace, "critical": critical}

    def read(self, entry: Mapping[str, Any]) -> tuple[Point, Equilibrium]:
        """Both from what was written."""
        w, tangent = np.array(entry["w"], float), np.array(entry["tangent"], float)
        sizes, count = np.array(entry["sizes"], float), self.rest.size
        if not w.shape == tangent.shape == sizes.shape == (count + 1,):
            raise ValueError("a point of another size")
        problem = replace(self.problem, z_sizes=sizes[:count], p_sizes=sizes[count:], pace=float(entry["pace"]))
        problem = problem.at(Stacked(w), tangent)[0]
        critical = complex(*entry["critical"]) if entry.get("critical") else None
        lengths = float(entry["arclength"]), float(entry["step"])
        point = Point(problem, Stacked(w), tangent, *lengths, critical=critical)
        return point, self.record(point)

    def special(self, kept: KeptPoint, index: int) -> RestEvent | None:
        """What is singular near a located point, solved for; None where it is nothing."""
        problem, length, critical = kept.point.problem, kept.point.arclength, kept.point.critical
        z, p, _ = problem.parts(kept.point.w)
        solutions = []
        for form in ("hopf",) if kept.role == "hopf" else ("fold", "branch_point"):
            try:
                extended, guess = singular(problem, z, p, form, critical)
                w = solve_square(extended, guess)
                bars = error_bars(extended, w)
            except (ConvergenceError, np.linalg.LinAlgError):
                continue
            there, value, more = extended.parts(w)
            if form == "branch_point" and abs(more[0]) > PERFECT * max(bars[extended.count], ROUND_OFF):
                continue  # two curves that pass each other; rows are solved to round-off, also where all terms are 0
            gaps = np.append((there - z) / problem.z_sizes, (value - p) / problem.p_sizes)
            solutions.append((float(np.abs(gaps).max() + bars[-1] / problem.p_sizes[0]), form, extended, w, bars))
        if not solutions:
            return None
        away, form, extended, w, bars = min(
            solutions, key=lambda each: each[0] * 1.01 + ALIKE if each[1] == "fold" else each[0]
        )
        if away > 1e-3:
            return None  # another one
        d, w = problem.jets.size, Stacked(np.where(np.abs(w.vector) <= bars, 0.0, w.vector))  # 0 to its error bar
        z, p, _ = extended.parts(w)
        found = self.judge.record(problem, z, p, length * self.sign, spectrum(problem, Stacked(np.append(z, p))))
        sides = [other.point for other in self.points if other.point.arclength < length][-1:]
        sides += [other.point for other in self.points if other.point.arclength > length][:1]
        secant = sides[-1].w.vector - sides[0].w.vector if len(sides) > 1 else kept.point.tangent
        name, claimed, known = _told(form, extended, w, bars, secant)
        flow = self.judge.flow(z[:d], float(p[0]), problem.z_sizes[:d], problem.pace, claimed)
        check = Reading(flow, CRITICAL, bool(flow <= CRITICAL and found.residual <= RESIDUAL))
        return RestEvent(
            name, index, found.arclength, float(p[0]), float(bars[-1]), found.state, found.eigenvalues, check,
            critical=claimed, **known,
        )  # fmt: skip


def _roots(point: Point) -> Roots:
    """Those of a point, remembered with it."""
    if "roots" not in point.w.known:
        point.w.known["roots"] = spectrum(point.problem, point.w, point.tangent)
    roots: Roots = point.w.known["roots"]
    return roots


def _told(
    role: str, extended: AtRest, w: Stacked, bars: np.ndarray, tangent: np.ndarray
) -> tuple[str, complex, dict[str, Any]]:
    """The kind of an event, its critical eigenvalue (1/s), what else is known of it."""
    z, p, more = extended.parts(w)
    if role != "hopf":
        crossing = role == "branch_point"
        return role, 0.0 + 0.0j, {"direction": _other(extended, z, p, tangent)} if crossing else {}
    kappa = float(more[-1])
    rate = float(np.sqrt(abs(kappa)) * extended.pace)
    if kappa <= 0:
        return "neutral_saddle", complex(rate), {}
    return "hopf", 1j * rate, _turning(extended, z, p, bars, rate, kappa)


def _turning(
    extended: AtRest, z: np.ndarray, p: np.ndarray, bars: np.ndarray, omega: float, kappa: float
) -> dict[str, Any]:
    """Frequency, period, first Lyapunov coefficient with their error bars, and the criticality."""
    share = float(bars[3 * extended.count]) / (2 * kappa)
    coefficient, error, side, q = first_lyapunov(extended, z, p, omega, bars[: z.size])
    period = 2 * np.pi / omega
    return {
        "frequency": omega, "period": period, "period_error": period * (share + 1e-15), "lyapunov": coefficient,
        "lyapunov_error": error, "direction": np.concatenate([q.real, q.imag]),
        "criticality": side,
    }  # fmt: skip


def _other(problem: AtRest, z: np.ndarray, p: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """The direction u over (x, p) of the other curve: of those in the kernel of the slopes with psi G''(u, u) = 0, psi
    in that of their transpose, the farther from a chord of the curve itself."""
    left, _, rows = np.linalg.svd(np.hstack(problem.scaled(z, p)[1:]))
    sizes = np.append(problem.z_sizes, problem.p_sizes)
    share = rows[-2:] @ (tangent / sizes)
    both = np.array([share, [-share[1], share[0]]]) @ rows[-2:] / np.linalg.norm(share)

    def bent(along: np.ndarray) -> Any:
        ends = [np.split(sign * 1e-4 * along * sizes, [z.size]) for sign in (-1.0, 1.0)]
        before, after = (left[:, -1] @ np.hstack(problem.scaled(z + dz, p + dp)[1:]) for dz, dp in ends)
        return (after - before) @ both.T

    (own, mixed), (_, across) = map(bent, both)
    lean = across / (mixed + np.copysign(np.sqrt(max(mixed**2 - own * across, 0.0)), mixed) or 1.0)
    other, d = (both[1] - lean * both[0]) / np.hypot(1.0, lean) * sizes, problem.jets.size
    return np.append(other[:d], other[z.size :])


def _record(called: tuple[str, str], curve: Mapping[str, Any], runs: list[RestDirection]) -> Equilibria:
    points: list[Equilibrium] = []
    events = []
    for run in reversed(runs):
        own = [kept.record for kept in run.points]
        both = bool(points and own) and points[-1].arclength == own[0].arclength  # begin with the same point
        points = own[::-1] if run.sign < 0 else [*points[: len(points) - both], *own]
    lengths = [point.arclength for point in points]
    for run in runs:
        for kept in run.events:
            index = max(int(np.searchsorted(lengths, kept.point.arclength * run.sign)) - 1, 0)
            events += [event] if (event := run.special(kept, index)) else []
    ends, judge = tuple(run.end or End(STOPPED, "stopped") for run in reversed(runs)), runs[0].judge
    system, parameter = dict(judge.model.system), judge.parameters[0]
    name, title = called
    return Equilibria(name, system, parameter, tuple(points), tuple(_apart(events)), ends, curve, title)


def _apart(events: list[RestEvent]) -> list[RestEvent]:
    """Each once, also where several tests vanish."""
    kept = dict[str, list[RestEvent]]()
    for event in events:
        alike = kept.setdefault(event.kind, [])
        if not any(
            abs(event.arclength - other.arclength) < APART
            and abs(event.parameter - other.parameter) <= 10 * (event.error + other.error)
            and abs(event.critical - other.critical) <= 1e-6 * abs(other.critical) for other in alike
        ):  # fmt: skip
            alike.append(event)
    return sorted(chain.from_iterable(kept.values()), key=attrgetter("arclength"))
