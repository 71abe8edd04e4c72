"""Families of driven motions of large systems by harmonic balance: as many orders as what is left between asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbitfinder.continuation.follow import (
    CurveJournal,
    Goals,
    KeptPoint,
    Pace,
    SolutionCurve,
    follow,
    point_limit,
    rise,
    towards,
)
from orbitfinder.continuation.problem import Point, solved
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.balance_problem import Balanced, Basis, Equations, Pattern, Series
from orbitfinder.families.hill import Exponents, Hill
from orbitfinder.families.point import FamilySettings
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.mechanics.newton import Settings, Solver, full
from orbitfinder.mechanics.scales import parameter_sizes
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.guesses.linear import linear_response
from orbitfinder.orbits.measure import action
from orbitfinder.records.family import CLOSURE, METHODS, End, Event, Family, FamilyPoint, Reading
from orbitfinder.records.orbit import system_at

FIRST, LEFT, HIGHEST = 5, 1e-12, 400
"""The highest order at first; what may be left of the equations between the times that they are balanced at, in the sizes
of their terms; the highest order that is tried"""
NODES, SAMPLES = 8, 256
"""States that a record keeps, and times that its action is summed over"""
NEWTON = Settings(floor=1e-9, round_off=1e-9, converged=1e-9, most_evaluations=40, halving=True)
"""From a guess"""
ZERO = 1e-5
"""An exponent of a fold is none to this"""


def balanced_family(
    problem: Problem, settings: FamilySettings, until: float | None, at: Sequence[float], name: str,
    progress: Callable[[FamilyPoint], None] | None = None,
) -> Family:  # fmt: skip
    """The family of a driven motion in a parameter. Raises `InputError` and `ConvergenceError`."""
    with one_thread():
        way = _Way(problem, settings, until)
        runs = [_Run(way, sign, until, tuple(at)) for sign in (0.0,) if until is not None] or [
            _Run(way, sign, None, tuple(at)) for sign in (1.0, -1.0)
        ]
        for run in runs:
            run.walk(progress)
        return _assembled(way, runs, name)


class _Way:
    """What is followed: the equations, where they start, records of their points."""

    def __init__(self, problem: Problem, settings: FamilySettings, until: float | None) -> None:
        model, parameter = problem.model, settings.parameter
        if refused := refusal(problem):
            raise InputError(f"method: balance is not for this problem, {refused}; leave method out")
        self.model, self.parameter, self.settings = model, parameter, settings
        self.start = float(model.parameter_values[model.parameter_index(parameter)])
        self.cycles = problem.forcing_cycles
        self.equations = Equations(model, parameter, self.cycles)
        self.check = ClosureCheck(model, stiff=True) if settings.certify else None
        self.hills = dict[int, Hill]()
        self.first = self._begun(problem, until)

    def _begun(self, problem: Problem, until: float | None) -> tuple[Balanced, Point]:
        model, start = self.model, np.array([self.start])
        size = float(parameter_sizes(model, (self.parameter,), start)[0])
        size = max(size, 0.0 if until is None else abs(until - self.start))
        n, guess = self.equations.size, problem.guess
        if guess.trajectory is None:
            guess = linear_response(model)
        assert guess.times is not None and guess.states is not None
        top = FIRST
        while True:
            basis = Basis(tuple(range(1, top + 1, 2)) if self.equations.odd else tuple(range(top + 1)))
            problem_ = Balanced(Pattern(self.equations, basis), np.ones(n), size, np.ones(n))
            motion = np.array([np.interp(basis.times, 2 * np.pi * guess.times / guess.period, q)
                               for q in np.asarray(guess.states, float).T[:n]])  # fmt: skip
            w = Series(np.append((motion @ basis.back.T).ravel(), self.start))
            problem_ = problem_.measured(w)
            try:
                return self.refined(problem_, self._near(problem_, w), None)
            except ConvergenceError:
                if (top := 2 * top + 1) > 4 * FIRST + 3:
                    raise

    def _near(self, problem: Balanced, w: Series) -> Series:
        """A guess brought near by whole Newton steps at its parameter, halved where they leave more."""
        row = problem.aim(w, self.parameter, self.start)[1][None]

        def linearised(w: Series) -> tuple[np.ndarray, Solver]:
            rows, linear = problem.linearise(w)
            return np.append(rows, 0.0), linear.closed(row)

        return full(w, linearised, NEWTON, lambda w, step: w.moved(step)).w

    def refined(self, problem: Balanced, w: Series, tangent: np.ndarray | None) -> tuple[Balanced, Point]:
        """The motion at the parameter's value on as many orders as it takes."""
        value = float(w.vector[-1])
        while True:
            point = solved(problem, w, lambda w: problem.aim(w, self.parameter, value))  # noqa: B023 - of this round
            problem = problem.measured(point.w)
            if self.enough(problem, point.w):
                break
            problem, w, tangent = problem.finer(point.w, tangent)
        point = replace(point, problem=problem)
        sharp = point.sharp
        sign = 1.0 if tangent is None else np.sign(sharp.inner(tangent)) or 1.0
        return problem, replace(sharp, tangent=sign * sharp.tangent)

    def enough(self, problem: Balanced, w: Series) -> bool:
        """Whether the orders of a problem are. Raises `ConvergenceError` where none that are tried would be."""
        left = problem.left(w)
        if not left <= LEFT and max(problem.basis.orders) > HIGHEST:
            raise ConvergenceError(f"{max(problem.basis.orders)} harmonics leave {left:.2g} of the equations between "
                                   "their times; make what has corners smoother")  # fmt: skip
        return left <= LEFT

    def exponents(self, problem: Balanced, w: Series) -> Exponents:
        """Those of a point, remembered with it."""
        if "exponents" not in w.known:
            w.known["exponents"] = self.hill(problem).exponents(problem, w)
        return w.known["exponents"]  # type: ignore[no-any-return]

    def hill(self, problem: Balanced) -> Hill:
        """What finds exponents on the orders of a problem."""
        return self.hills.setdefault(problem.basis.count, Hill(problem))

    def states(self, problem: Balanced, w: Series, times: np.ndarray) -> np.ndarray:
        """States (s x 2n, or d) at times in rad."""
        motion = problem.basis.motion(problem.coefficients(w), times)
        pace = self.equations.pace(float(w.vector[-1]))
        return np.vstack(motion[:1] if self.model.rates is not None else [motion[0], pace * motion[1]]).T

    def point(self, problem: Balanced, w: Series, **where: Any) -> FamilyPoint:
        """The record of a motion. Raises `ConvergenceError` where it does not close by an independent integrator."""
        value = float(w.vector[-1])
        free, about = {self.parameter: value}, self.exponents(problem, w)
        model = with_parameters(self.model, free)
        period = 2 * np.pi / self.equations.pace(value)
        mesh = np.linspace(0.0, 1.0, SAMPLES + 1)
        states = self.states(problem, w, 2 * np.pi * mesh)
        grown = max(1.0, float(np.abs(about.multipliers).max(initial=1.0)))
        closure = 0.0
        if self.check is not None:
            units = np.maximum(np.ptp(states, axis=0), 1e-3 * np.ptp(states, axis=0).max())
            closure = self.check(states[0], period, np.zeros(self.equations.size), CLOSURE * grown, free, units)
        nodes = states[:-1 : SAMPLES // NODES]
        return FamilyPoint(
            name="", system=system_at(self.model.system, free), winding=(), shift={}, nodes=nodes[:1],
            times=np.zeros(0), samples=np.zeros((0, states.shape[1])), tolerance=CLOSURE, value=value, state=states[0],
            period=period, energy=energy(model, states[0]), action=action(model, mesh * period, states),
            closure=closure, scale=grown, floquet_multipliers=about.multipliers, pair_defect=0.0,
            multiplier_method=METHODS[-1], stability=about.stability, krein=(), root=1, indices=np.zeros(0, complex),
            symmetry="none", unfolding=(), free=free, shooting_nodes=nodes, mesh=mesh, tangent=np.zeros(0), **where,
        )  # fmt: skip


class _Run:
    """One direction from the first point: a curve for each set of orders, joined."""

    def __init__(self, way: _Way, sign: float, until: float | None, at: tuple[float, ...]) -> None:
        self.way, self.goals = way, Goals(way.parameter, until, at)
        first = way.first[1]
        side = sign or towards(first, way.parameter, until)
        if sign:
            side *= np.sign(rise(first, way.parameter)) or 1.0
        self.begin, self.side = replace(first, tangent=side * first.tangent, step=way.settings.first_step), sign or 1.0
        self.points, self.events, self.end = list[KeptPoint](), list[KeptPoint](), End("stopped", "stopped")

    def walk(self, progress: Callable[[FamilyPoint], None] | None) -> None:
        """Until it ends; where orders no longer do, again from the point before with more."""
        s = self.way.settings
        tests = {"fold": lambda point: rise(point, self.way.parameter)} if s.events else {}
        while True:
            curve, count = SolutionCurve(), len(self.points)
            pace = Pace(
                first=self.begin.step, shortest=s.shortest_step, longest=s.longest_step, quick=4, slow=8,
                points=s.points - max(0, count - 1), bend=float(np.cos(s.sharpest_turn)),
            )  # fmt: skip
            short = self._walked(curve, follow(curve, CurveJournal(self), lambda: self.begin, self.goals, pace, tests), progress)
            if short is None:
                self.end = curve.end or point_limit(s.points)
                return
            before = self.points[-1].point
            finer, w, tangent = before.problem.finer(before.w, before.tangent)
            _, point = self.way.refined(finer, w, tangent)
            self.begin = replace(point, arclength=before.arclength, step=before.step)

    def _walked(
        self, curve: SolutionCurve, points: Iterator[KeptPoint], progress: Callable[[FamilyPoint], None] | None
    ) -> Point | None:
        """What a curve adds, and the point at which its orders are too few."""
        again = bool(self.points)
        for kept in points:
            if not self.way.enough(kept.point.problem, kept.point.w):
                return kept.point
            if again:  # the point that it begins with is known
                again = False
                continue
            self.points.append(kept)
            last = self.points[-2].point.arclength if len(self.points) > 1 else -1.0
            self.events += [event for event in curve.events if last < event.point.arclength <= kept.point.arclength]
            if progress:
                progress(self.record_of(kept, len(self.points) - 1))
        return None

    def record(self, point: Point) -> None:
        """Made when it is asked for."""

    def write(self, point: Point, record: Any) -> dict[str, Any]:  # noqa: ARG002 - of `Keeping`
        """Nothing is kept on disk."""
        return {}

    def read(self, entry: Any) -> tuple[Point, Any]:  # noqa: ARG002 - of `Keeping`
        """Nothing is kept on disk."""
        raise NotImplementedError

    def record_of(self, kept: KeptPoint, index: int) -> FamilyPoint:
        """The orbit of a point."""
        point = kept.point
        return self.way.point(
            point.problem, point.w, index=index, arclength=self.side * point.arclength, step=point.step, role=kept.role
        )

    def event_of(self, kept: KeptPoint) -> Event:
        """A fold, checked by the exponent that is 0 there."""
        point, way = kept.point, self.way
        value, critical = float(point.w.vector[-1]), way.hill(point.problem).nearest(point.problem, point.w)
        state = way.states(point.problem, point.w, np.zeros(1))[0]
        model = with_parameters(way.model, {way.parameter: value})
        off = float(abs(critical))
        return Event(
            "fold", 0, self.side * point.arclength, value, state, 2 * np.pi / way.equations.pace(value),
            energy(model, state), way.parameter, multiplier=complex(np.exp(2 * np.pi * critical)),
            free={way.parameter: value}, check=Reading(off, ZERO, off <= ZERO),
        )  # fmt: skip


def _assembled(way: _Way, runs: Sequence[_Run], name: str) -> Family:
    points, events, ends = list[FamilyPoint](), list[Event](), list[End]()
    for run in reversed(runs):
        own = [run.record_of(kept, k) for k, kept in enumerate(run.points)]
        points = own[::-1] if run.side < 0 else [*points[: len(points) - (len(runs) > 1)], *own]
        events += [run.event_of(kept) for kept in run.events]
        ends.append(run.end)
    points = [replace(point, index=k) for k, point in enumerate(points)]
    lengths = [point.arclength for point in points]
    events = sorted(
        (replace(event, index=max(int(np.searchsorted(lengths, event.arclength)) - 1, 0)) for event in events),
        key=lambda event: event.arclength,
    )
    return Family(name, dict(way.model.system), way.parameter, tuple(points), tuple(events), tuple(ends),
                  source={"kind": "balance"})  # fmt: skip


def refusal(problem: Problem) -> str:
    """Why harmonic balance cannot be the method for a problem, or nothing."""
    model: Model = problem.model
    if not model.forced:
        return "nothing drives it"
    if not model.smooth or model.constraint is not None or not model.scalar or problem.control is not None:
        return "it has impacts, constraints or controls"
    if problem.turns.any() or problem.relative:
        return "it goes round"
    return ""


