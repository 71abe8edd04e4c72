"""Families by harmonic balance: what is followed are coefficients, what is recorded are orbits as any other method's.

Up to `SMALL` coordinates that are not stiff, the equations of shooting stand beside those of balance: an orbit's nodes
are the series' states, and multipliers, closure, events with their checks and error bars are read as of any family, by
a march. Of more coordinates multipliers are Hill's, as few as it takes, or all of a free motion (`orbits.hill`);
closure is by implicit steps, and folds and changes of stability are located in harmonics.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import interrupt, locks
from orbitfinder._runtime.sizes import EPSILON
from orbitfinder.continuation.follow import (
    Direction,
    Goals,
    KeptPoint,
    Pace,
    Tests,
    advanced,
    follow,
    in_turn,
    rise,
    towards,
)
from orbitfinder.continuation.problem import Point
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError, IntegrationError
from orbitfinder.families.entries import KINDS
from orbitfinder.families.events import event_at, find_events
from orbitfinder.families.folder import directions
from orbitfinder.families.members import batch_certified, certified, series
from orbitfinder.families.point import FamilySettings, make_point
from orbitfinder.families.run import Sample, ahead, make_interval, make_sample
from orbitfinder.families.stability import matching
from orbitfinder.families.start import curve_at, entry_of
from orbitfinder.families.verified import checked, verdicts
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.conditions import followed as followable
from orbitfinder.loops.continued import Curve, at_place, tangent
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.problem import Problem, at_forcing_period
from orbitfinder.loops.symmetry import NONE
from orbitfinder.loops.watch import Number, Watch, numbers, watches
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.mechanics.scales import extents, extents_of, masses_of
from orbitfinder.orbits.balance import NAME, begun, freed, refused, samples_of, states_of, suits
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.closure import LARGEST_SCALE
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.floquet import outside
from orbitfinder.orbits.harmonics import Balanced
from orbitfinder.orbits.hill import Exponents, exponents, finer_indices, proved
from orbitfinder.orbits.implicit import SMALL, ImplicitCheck, gathered
from orbitfinder.orbits.measure import action
from orbitfinder.records.certificate import Check, at_most, skipped
from orbitfinder.records.certificate import refused as unsound
from orbitfinder.records.codec import plain
from orbitfinder.records.ends import end_fault, end_kind
from orbitfinder.records.family import (
    BECOMES,
    CLOSURE,
    Batch,
    End,
    Event,
    Family,
    FamilyPoint,
    Reading,
    restored,
    reverted,
    save_family,
    situated,
)
from orbitfinder.records.family import (
    METHODS as MULTIPLIERS,
)
from orbitfinder.records.orbit import system_at

NODES, STEPS, TENTH = 16, 256, 10
"""States at equal times that shooting stands on, and its steps of a period at least; the verdict on every
so many points is made again, and those where it changes"""
ZERO, AGAIN, SAMPLED, ROUNDED, VANISHED, TURNED, ASIDE, ROUNDS = 1e-6, 1e-5, 64, 1e-12, 1e-2, 1e-4, 0.05, 10
"""An exponent that is 0 at an event is as near to it, what is verified of it again as this; states that units are taken
from; relative error of a number; share of the first free motion that comes to rest, of a rise that is none; share of a
step beside an event from which slopes are told; round-offs that a parameter is off by"""


def followed(
    problem: Problem, settings: FamilySettings, goals: tuple[float | None, Sequence[float], bool], name: str,
    folder: Path | None, asked: tuple[Mapping[str, Any], Mapping[str, Any]], watch: Mapping[str, str | Number],
    progress: Callable[[Batch], None] | None,
) -> Family:  # fmt: skip
    """The family of a driven motion in a parameter, or of free motions, each direction kept in a journal of the folder.

    `goals` are its end, values to be met, and whether there are others, of which it knows none; `asked` the request
    that a journal answers and what the family was started from. Raises `InputError` and `ConvergenceError`.
    """
    problem, parameter, (until, at, others) = at_forcing_period(problem), settings.parameter, goals
    if why := refused(problem):
        raise InputError(f"method: balance is not for this problem, {why}; leave method out")
    if others or settings.beside:
        raise InputError("stop, between, beside: not by balance; give until, or leave method out")
    if problem.model.forced:
        problem.model.parameter_index(parameter)
    elif parameter not in followable(problem.model):
        raise InputError(f"parameter: free motions by balance are followed in {', '.join(followable(problem.model))}, "
                         f"got {parameter!r}")  # fmt: skip
    if parameter in problem.free:
        raise InputError(f"parameter: {parameter} is free for the phase already; follow in another")
    first = begun(problem, parameter, until)
    few = first.problem.equations.size <= SMALL and not problem.free and not suits(problem)
    own = (_Marched if few and exponents(first.problem, first.w).whole else _Large)(
        problem, settings, name, watches(watch, problem.model), first
    )
    start, wanted = first.value(parameter), tuple(map(float, at))
    ways = directions(start, settings, (until, wanted))
    runs = [
        _BalanceDirection(
            Goals(parameter, goal, wanted), float(sign),
            {**asked[0], "method": NAME, "way": [float(sign), goal is None]}, own, first,
        )
        for sign, goal, _ in ways
    ]  # fmt: skip
    if not runs:
        raise InputError(f"until, at: {parameter} begins at {start!r} and none of these lies beyond; give other values")
    with locks.alone_in(folder):
        for run, path in in_turn(runs, folder and folder / "balance.jsonl"):
            run.walk(path, progress)
        family = _assembled(own, runs, asked[1])
        if folder is not None:
            save_family(family, folder)
    return family


class _Marched:
    """Orbits of few coordinates, on the equations of shooting."""

    undecided: tuple[str, ...] = ()

    def __init__(
        self, problem: Problem, settings: FamilySettings, name: str, watch: Mapping[str, Watch], first: Point
    ) -> None:
        self.problem, self.settings, self.name = problem, settings, name
        equations = Equations.of(problem.model, NONE, (settings.parameter,) if problem.model.forced else ())
        self._equations, self._mesh = equations, uniform(1.0, NODES, STEPS // NODES)
        place = self._place(first)
        self.curve: Curve = replace(curve_at(equations, place), watch=watch)
        self.check = ClosureCheck(problem.model) if settings.certify else None
        self._samples = dict[int, Sample]()
        sample = self.sample(first)
        self.curve = self.curve.measured(sample.solution)
        self._samples.clear()
        self.entry = entry_of(self.curve) | {"method": NAME}

    def tests(self) -> Tests:
        return {}

    def _place(self, point: Point) -> Any:
        shares = self._mesh[:: STEPS // NODES][:-1]
        values, period = freed(point)
        return self._equations.unknowns(states_of(point, shares), period, self._mesh, np.array([*values.values()]))

    def sample(self, point: Point, expected: np.ndarray | None = None) -> Sample:
        """The orbit of a point with its tangent and multipliers."""
        if id(point) not in self._samples:
            solution = at_place(self.curve, self._place(point))
            moved = replace(point, w=point.w.moved(1e-6 * point.tangent))
            along = (self._place(moved).vector - solution.place.vector) / 1e-6
            whole = tangent(self.curve, solution, along)
            nothing = np.zeros(0, complex) if expected is None else expected
            self._samples = {
                **dict([*self._samples.items()][-1:]),
                id(point): make_sample(self.curve, 0.0, solution, whole, nothing),
            }
        return self._samples[id(point)]

    def point(self, point: Point, **where: Any) -> FamilyPoint:
        sample = self.sample(point)
        return make_point(self.curve, sample.solution, sample.head, self.settings.parameter, self.check,
                          about=sample.about, **where)  # fmt: skip

    def events(self, before: KeptPoint, after: KeptPoint, seen: Sequence[KeptPoint]) -> list[Event]:  # noqa: ARG002
        if not self.settings.events:
            return []
        curve, first = self.curve, self.sample(before.point)
        last = self.sample(after.point, first.indices)
        length, step = ahead(curve, first, last.solution), after.point.arclength - before.point.arclength
        interval = make_interval(curve, first, replace(last, distance=length))
        if not curve.equations.model.forced:  # from here on in its own scales, of whatever size it is
            self.curve = curve.measured(last.solution)
            self._samples.clear()
        name = self.settings.parameter
        located = tuple(event_at(curve, *each, name) for each in find_events(interval, self.settings))
        batch = checked(curve, Batch(1, events=located), length, name)
        self.undecided += batch.undecided
        batch = batch_certified(curve, batch) if self.settings.certify else batch
        return [
            replace(event, arclength=before.point.arclength + event.arclength * step / length) for event in batch.events
        ]

    def certified(self, point: FamilyPoint) -> FamilyPoint:
        return certified(self.curve, point)


class _Large:
    """Orbits of many coordinates, or stiff ones, by their series alone."""

    undecided: tuple[str, ...] = ()

    def __init__(
        self, problem: Problem, settings: FamilySettings, name: str, watch: Mapping[str, Watch], first: Point
    ) -> None:
        self.problem, self.settings, self.name, self.watch = problem, settings, name, watch
        self.model, self.parameter = problem.model, settings.parameter
        if problem.model.rates is not None:
            raise InputError("method: balance is for at most 40 coordinates of a first-order system, or stiff ones of "
                             "mechanics; describe it by masses, or leave method out")  # fmt: skip
        names = first.problem.equations.names
        self.check = ImplicitCheck(self.model, names, problem.forcing_cycles) if settings.certify else None
        self.grown, steady = 1.0, not np.any(first.problem.equations.varying[:, 2] == 2)
        self.masses = masses_of(self.model.kinetic, states_of(first, np.zeros(1))[0], self.model) if steady else None
        self._first = np.zeros(0), False
        if settings.certify and not proved(first.problem, first.w):  # what errors grow by hardly changes
            self.grown = LARGEST_SCALE
            record = self.point(first, index=0, arclength=0.0, step=0.0)
            certificate = certify(record, with_parameters(self.model, record.free))
            self.grown, self._first = certificate.scale, (record.state, certificate.passed)
        still = [0] * self.model.degrees_of_freedom
        self.entry: dict[str, Any] = {"method": NAME, "winding": still}
        self.entry |= {"cycles": problem.forcing_cycles} if problem.model.forced else {}

    def tests(self) -> Tests:
        if not self.settings.events:
            return {}
        return {"fold": partial(rise, name=self.parameter), "change": changing, "real": partial(changing, real=True)}

    def point(self, point: Point, **where: Any) -> FamilyPoint:
        about, (free, period) = exponents(point.problem, point.w), freed(point)
        model, value = with_parameters(self.model, free), point.value(self.parameter)
        (mesh, states, every), (closes, closure) = sampled(point), self._closes(point)
        if not closes:
            raise ConvergenceError(f"the orbit closes only to {closure:.2g} where errors grow {self.grown:.3g} times")
        nodes, shares = states[:-1:every], mesh[::every]
        none = np.zeros(0)
        return FamilyPoint(
            name="", system=system_at(self.model.system, free), winding=(0,) * model.degrees_of_freedom, shift={},
            nodes=states[:1], times=none, samples=np.zeros((0, states.shape[1])), tolerance=CLOSURE, value=value,
            state=states[0], period=period, energy=energy(model, states[0]),
            action=action(model, mesh * period, states), closure=closure, defect=closure, scale=self.grown,
            floquet_multipliers=about.multipliers, pair_defect=about.whole.pair_defect if about.whole else 0.0,
            multiplier_method=MULTIPLIERS[0 if about.whole else -1], stability=about.stability, krein=(),
            root=about.root, indices=about.indices, symmetry=NONE.name,
            unfolding=(), free=free, shooting_nodes=nodes, mesh=shares, tangent=heading(point),
            watch=numbers(self.watch, mesh * period, states, model.named_parameters), **where,
        )  # fmt: skip

    def _closes(self, point: Point) -> tuple[bool, float]:
        """Whether a motion closes as well as errors let it, and its gap in extents."""
        if self.check is None:
            return True, 0.0
        (free, period), states = freed(point), states_of(point, np.linspace(0.0, 1.0, 65))
        if self.masses is None:
            units = extents_of(self.model, states, period)
        else:
            units = extents(np.ptp(states, axis=0), self.masses, period, self.model.angular)
        closure = self.check(states[0], period, free, units, CLOSURE * self.grown)
        return closure <= CLOSURE * self.grown, closure

    def events(self, before: KeptPoint, after: KeptPoint, seen: Sequence[KeptPoint]) -> list[Event]:
        located = [event for kept in seen if (event := self._event(kept, before.point, after.point)) is not None]
        words = [before.record.stability]
        for first, last in pairwise(event.arclength for event in located):
            there = advanced(before.point, 0.5 * (first + last) - before.point.arclength)
            words.append(exponents(there.problem, there.w).stability)
        words.append(after.record.stability)
        for event, pair in zip(tuple(located), pairwise(words), strict=False):
            if pair.count("unstable") == 1:
                located.append(replace(event, kind="stability_change", detail=BECOMES[pair[1] == "unstable"]))
        if not located and words.count("unstable") == 1:
            logging.getLogger(__name__).warning(
                "stability changes between %s %.12g and %.12g, and no event is located there", self.parameter,
                before.record.value, after.record.value)  # fmt: skip
        return located

    def _event(self, kept: KeptPoint, before: Point, after: Point) -> Event | None:
        """A located event with its check: the exponent that is on the axis there."""
        point = kept.point
        balanced, value, (free, period) = point.problem, point.value(self.parameter), freed(point)
        about = exponents(balanced, point.w)
        if not about.values.size or (not balanced.equations.names and about.whole is None):
            return None
        turns = KINDS[kept.role].extremal if kept.role in KINDS else False
        critical = about.values[np.argmin(np.abs(about.values if turns else about.values.real))]
        turned = abs((critical.imag + 0.5) % 1.0 - 0.5)
        other = "branch_point" if turned < ZERO else "period_doubling" if turned > 0.5 - ZERO else "torus"
        real, off = kept.role == "real", abs(critical) if turns else abs(critical.real)
        known = abs(changing(after, real) - changing(before, real))
        step = abs(after.value(self.parameter) - before.value(self.parameter))
        free_motion = not balanced.equations.names
        rises = [abs(rise(each, self.parameter)) for each in (point, before, after)]
        if (free_motion or real) and not turns and rises[0] < TURNED * max(rises[1:]):
            return None  # at a fold, which is an event of its own
        if free_motion:
            other, critical, off = meeting(about, turns)
        if off > ZERO:
            return None
        if free_motion:
            edge = 2.0 * np.cos(2 * np.pi * critical.imag / about.root)
            error = self._lost(point) if turns else self._known(point, before, after, edge)
        else:
            error = balanced.known(point.w) if turns else step * (off + 0.01 * ZERO) / max(known, ZERO)
        nodes = states_of(point, np.linspace(0.0, 1.0, nodes_of(point) + 1))[:-1]
        state, detail = nodes[0], self.parameter if turns else ""
        certain = bool(self.check and self._closes(point)[0])
        return Event(
            kept.role if turns else other, 0, point.arclength, value, state, period,
            energy(with_parameters(self.model, free), state), detail, free=free, tangent=heading(point),
            multiplier=complex(np.exp(2 * np.pi * critical)), shooting_nodes=nodes,
            mesh=np.linspace(0.0, 1.0, len(nodes) + 1), certified=certain,
            check=Reading(float(off), ZERO, bool(off <= ZERO), parameter_error=float(error)),
        )  # fmt: skip

    def _lost(self, point: Point) -> float:
        """What the next orders and round-off make of the parameter of a motion."""
        left = max(point.problem.left(point.w)[0], EPSILON)
        return float(ROUNDS * left * abs(point.value(self.parameter)))

    def _known(self, point: Point, before: Point, after: Point, edge: float) -> float:
        """What the parameter of an event of free motions is known to where an index is at an `edge`: what indices are
        off by twice as many steps, and by round-off, over the slope beside it, and what is lost of a motion."""
        balanced, value = point.problem, point.value(self.parameter)
        meets = abs(abs(edge) - 2.0) > ZERO  # another: both are off by roots of what squares of their gap are
        length, slope, order = after.arclength - before.arclength, 0.0, 1 + meets
        share = (point.arclength - before.arclength) / length
        for there in (max(share - ASIDE, 0.0), min(share + ASIDE, 1.0)):
            with suppress(*UNSOLVED):
                beside = advanced(before, there * length)
                slope = max(slope, max(changing(beside), 0.0) ** order / abs(beside.value(self.parameter) - value))
        again = finer_indices(balanced, point.w)
        first, second = again[np.argsort(np.abs(again - edge))[:2]]
        off = abs(first - second) / 2 if meets else abs(first - np.copysign(2.0, edge))
        whole = exponents(balanced, point.w).whole
        off = 2 * off**order + (whole.pair_defect if whole else 0.0) ** order
        return float(self._lost(point) + off / slope) if slope else abs(after.value(self.parameter) - value)

    def certified(self, point: FamilyPoint) -> FamilyPoint:
        known, passed = self._first
        if not np.array_equal(point.state, known):
            passed = certify(point, with_parameters(self.model, point.free)).passed
        return replace(point, certified=passed)


def nodes_of(point: Point) -> int:
    """States at equal times, a power of two of them, that tell a series."""
    return 2 << int(np.ceil(np.log2(max(point.problem.basis.orders) + 1)))


def sampled(point: Point) -> tuple[np.ndarray, np.ndarray, int]:
    """Shares of a period, the states there, and every which of them tells a series."""
    mesh = np.linspace(0.0, 1.0, samples_of(point) + 1)
    return mesh, states_of(point, mesh), (mesh.size - 1) // nodes_of(point)


def heading(point: Point) -> np.ndarray:
    """d(x(0), T, what is free) / d(arclength)."""
    balanced: Balanced = point.problem
    w, start = point.w, np.zeros(1)
    motion = [part[:, 0] for part in balanced.basis.motion(balanced.coefficients(w), start)]
    along, change = np.split(point.tangent, [balanced.pattern.whole])
    moved = [part[:, 0] for part in balanced.basis.motion(along.reshape(len(motion[0]), -1), start)]
    values = balanced.values(w)
    pace, faster = balanced.equations.pace(values), float(balanced.equations.rise(values) @ change)
    free = change if balanced.equations.names else change[:0]
    return np.concatenate([moved[0], pace * moved[1] + faster * motion[1], [-2 * np.pi * faster / pace**2], free])


def reverified(family: Family, model: Model) -> Iterator[tuple[str, Check]]:
    """Every event and end of a family of many coordinates, and verdicts on stability, each made again by implicit
    steps."""
    words = np.array([point.stability for point in family.points])
    turns, every = np.flatnonzero(words[1:] != words[:-1]), np.arange(words.size)
    chosen = np.unique(np.concatenate([every[::TENTH], every[-1:], turns, turns + 1])).tolist()

    def again(point: FamilyPoint) -> str:
        made = certify(point, with_parameters(model, point.free)).checks
        return next((point.stability if each.passed else each.note for each in made if each.name == "stability"), "")

    yield from verdicts(family, again, chosen)
    name, cycles = family.parameter, int(family.curve.get("cycles", 1))
    check = ImplicitCheck(model, tuple(family.points[0].free), cycles)
    values = family.values("value")
    for k, event in enumerate(family.events):
        interrupt.check()
        yield f"event {k}, {name} {event.parameter:.12g}", _again(family, check, event)
    for k, end in enumerate(family.ends):
        yield f"end {k}", _end_again(end, values[[0, -1]], float(np.abs(values).max()))


def _end_again(end: End, values: np.ndarray, size: float) -> Check:
    """What is asked for is met at the first or the last point; of other ends nothing is solved for."""
    if fault := end_fault(end, ()):
        return unsound(end.kind, fault, np.nan)
    if not end_kind(end.kind).asked:
        return skipped(end.kind, "nothing was solved for")
    try:
        wanted = float(end.reason.rpartition("=")[2])
    except ValueError as error:
        return unsound(end.kind, f"reason: {error}", np.nan)
    return at_most(end.kind, float(np.abs(values - wanted).min()), ROUNDED * size, end.reason)


def _again(family: Family, check: ImplicitCheck, event: Event) -> Check:
    """An event's orbit closes, and what it claims: at a fold the family's direction comes back as it was, along which
    the parameter rests; elsewhere a multiplier of its own is recomputed on the unit circle."""
    try:
        model = with_parameters(check.model, event.free)
        mu, beside = event.multiplier, (each for each in family.events if each.arclength == event.arclength)
        turns = model.forced and abs(mu - 1.0) <= AGAIN and any(KINDS[each.kind].extremal for each in beside)
        seen = None if turns else gathered(model, event.state, event.period)[0]
        states = series(event.shooting_nodes, SAMPLED)
        units = extents_of(model, states, event.period)
        allowed = CLOSURE * family.points[0].scale
        closure = check(event.state, event.period, event.free, units, allowed)
        if not closure <= allowed:
            raise ConvergenceError(f"its orbit closes only to {closure:.2g}")
        if model.forced and abs(event.period / check.period(event.free) - 1.0) > ROUNDED:
            raise ConvergenceError(f"its period is not that of the drive at {family.parameter} {event.parameter:.12g}")
        if seen is None:
            off = check.kept(event.state, event.period, event.free, units, event.tangent[: units.size])
        elif model.forced:
            off = float(np.abs(seen.floquet.multipliers - mu).min()) + abs(abs(mu) - 1.0)
        else:  # where it may meet its reciprocal their sum is known, of two pairs that meet the product of both gaps
            first, second = np.sort(np.abs(seen.floquet.indices - mu - 1.0 / mu))[:2]
            off = float(first if abs(mu.imag) <= AGAIN else first * second) + abs(abs(mu) - 1.0)
    except (ConvergenceError, IntegrationError, IndexError, ValueError) as error:
        return unsound(event.kind, error, np.nan)
    return at_most(event.kind, off, AGAIN, event.detail)


def meeting(about: Exponents, turns: bool) -> tuple[str, complex, float]:
    """What kind of event of free motions there is, at a fold or not, its exponent, and how far the index at 2 or -2, or
    half the gap of the two that meet, squared, is off."""
    indices, root = about.indices, about.root
    edge = indices[np.argmin(np.abs(indices - 2.0)) if turns else np.argmax(outside(indices))]
    kind, off = "branch_point" if edge.real > 0 or root == 2 else "period_doubling", abs(abs(edge) - 2.0)
    if off > ZERO and not turns:
        gaps = np.abs(indices[:, None] - indices) + np.diag(np.full(indices.size, np.inf))
        kind, off = "collision", 0.25 * float(gaps.min()) ** 2
        edge = indices[np.argmin(gaps.min(axis=0))]
    turn = root * np.arccos(np.clip(edge.real / 2, -1.0, 1.0))
    return kind, complex(0.0, turn / (2 * np.pi)), float(off)


def changing(point: Point, real: bool = False) -> float:
    """The largest real part of what exponents may cross the axis elsewhere than at a fold, or of those that are `real`
    where all are known; of free motions how far an index is outside of those that are stable."""
    about = exponents(point.problem, point.w)
    if about.whole is not None and not point.problem.equations.names:
        return -1.0 if real else float(outside(about.indices).max(initial=-2.0))
    turned, known = np.abs(about.values.imag) > 1e-7, np.isfinite(about.rest)
    others = about.values[~turned if real and about.whole is not None else turned & (not real)].real
    return float(others.max(initial=about.rest if known and not real else -1.0))


@dataclass(eq=False)
class _BalanceDirection(Direction):
    """A direction from the first point, and the events on the way."""

    own: _Marched | _Large
    first: Point
    located: list[Event] = field(default_factory=list)

    def begin(self) -> Point:
        s = self.own.settings
        side = self.sign * towards(self.first, s.parameter, None)
        return replace(self.first, tangent=side * self.first.tangent, step=s.first_step)

    def tests(self) -> Tests:
        return self.own.tests()

    def walk(self, path: Path | None, progress: Callable[[Batch], None] | None) -> None:
        """Until it ends."""
        s, before = self.own.settings, None
        pace = Pace(first=s.first_step, shortest=s.shortest_step, longest=s.longest_step, quick=6, slow=12,
                    points=s.points, bend=float(np.cos(s.sharpest_turn)), closed=True)  # fmt: skip
        for k, kept in enumerate(follow(self, pace, path)):
            events = list[Event]()
            if before:
                seen = [e for e in self.events if before.point.arclength < e.point.arclength <= kept.point.arclength]
                try:
                    events = self.own.events(before, kept, seen)
                except UNSOLVED as error:  # costs these events, not the family
                    said = (f"between {s.parameter} = {before.record.value:.12g} and {kept.record.value:.12g} events "
                            f"are unknown: {error}")  # fmt: skip
                    logging.getLogger(__name__).warning(said)
                    self.own.undecided += (said,)
                before.point.w.known.clear()  # factors of matrices, megabytes each
            events = [replace(event, arclength=self.sign * event.arclength) for event in events]
            self.located += events
            if progress:
                progress(Batch(int(self.sign), (self._placed(kept),), tuple(events)))
            free, sizes = not self.first.problem.equations.names, (self.first.problem.sizes, kept.point.problem.sizes)
            if free and sizes[1].max() < VANISHED * sizes[0].max():
                self.points, self.end = self.points[: k + 1], End("equilibrium", "the motion comes to rest")
                return
            before = kept

    def _placed(self, kept: KeptPoint) -> FamilyPoint:
        record: FamilyPoint = kept.record
        return replace(record, arclength=self.sign * kept.point.arclength, role=kept.role)

    def placed(self) -> list[FamilyPoint]:
        """The points in the order of their arclength."""
        own = [self._placed(kept) for kept in self.points]
        return own[::-1] if self.sign < 0 else own

    def record(self, point: Point) -> FamilyPoint:
        return self.own.point(point, index=0, arclength=point.arclength, step=point.step)

    def write(self, point: Point, record: FamilyPoint) -> Mapping[str, Any]:
        """Both in plain numbers, but for the states that the series tells."""
        if isinstance(self.own, _Large):
            record = replace(record, shooting_nodes=record.state[None])
        return point.entry | {"orders": list(point.problem.basis.orders), "orbit": plain(record)}

    def read(self, entry: Mapping[str, Any]) -> tuple[Point, FamilyPoint]:
        """Both from what was written."""
        problem, w = self.first.problem.on(tuple(entry["orders"]), np.array(entry["w"], float))
        point = Point(problem, w, np.array(entry["tangent"], float), float(entry["arclength"]), float(entry["step"]))
        record: FamilyPoint = restored(FamilyPoint, entry["orbit"])
        if isinstance(self.own, _Large):
            _, states, every = sampled(point)
            record = replace(record, shooting_nodes=states[:-1:every])
        record = situated(record, 0, "", self.own.problem.model.system, self.own.entry)
        return point, record


def _assembled(own: _Marched | _Large, runs: Sequence[_BalanceDirection], source: Mapping[str, Any]) -> Family:
    walked = [run for run in reversed(runs) if run.points]
    points = list[FamilyPoint]()
    for run in walked:
        some = run.placed()
        points += some[bool(points) :] if run.sign > 0 else some
    if own.settings.certify:
        points = [
            own.certified(point) if point.role != "step" or k in (0, len(points) - 1) else point
            for k, point in enumerate(points)
        ]
    for before, after in pairwise(range(len(points))) if isinstance(own, _Large) else ():
        indices = points[after].indices
        points[after] = replace(points[after], indices=indices[matching(points[before].indices, indices)])
    system, entry = dict(own.problem.model.system), own.entry
    points = [situated(point, k, own.name, system, entry) for k, point in enumerate(points)]
    lengths = [point.arclength for point in points]
    events = sorted((reverted(event) for run in walked for event in run.located), key=attrgetter("arclength"))
    events = [replace(event, index=int(np.searchsorted(lengths, event.arclength)) - 1) for event in events]
    return Family(own.name, system, own.settings.parameter, tuple(points), tuple(events),
                  tuple(run.end for run in walked if run.end), entry, source, own.undecided)  # fmt: skip
