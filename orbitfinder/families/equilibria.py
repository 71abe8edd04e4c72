"""Following equilibria: folds, branch points and Hopf points on the way, each solved for and certified."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from orbitfinder._runtime import locks
from orbitfinder._runtime.keeping import STOPPED, finished
from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.follow import CurveJournal, Goals, KeptPoint, Pace, SolutionCurve, follow, rise, towards
from orbitfinder.continuation.problem import Point, plane, solved
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError, closest
from orbitfinder.families.equilibrium import Equilibria, Equilibrium, RestEvent
from orbitfinder.families.rest_problem import (
    AtRest,
    Stacked,
    eigenvalues,
    error_bars,
    lyapunov,
    regular,
    singular,
    solve_square,
    state_sizes,
    without_noise,
)
from orbitfinder.integrate.dop853 import SECOND, integrate_in
from orbitfinder.integrate.equations import with_variations
from orbitfinder.integrate.field import vector_field
from orbitfinder.integrate.jets import at_rest
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model, check_state
from orbitfinder.mechanics.newton import Settings, equilibrium
from orbitfinder.records.certificate import Certificate, at_most, equal
from orbitfinder.records.family import End, Reading

PACE = Pace(first=0.01, shortest=1e-9, longest=0.05, points=400, bend=0.95, quick=4, slow=7)
"""Lengths are in the sizes of the state and of the parameter"""
NEUTRAL = 1e-9
"""Eigenvalues whose real parts are this share of the largest are on the imaginary axis"""
RESIDUAL, SLOPES, CRITICAL = 1e-12, 1e-7, 1e-8
"""What may be left of the rates, of the eigenvalues by differences and of a critical one by the flow, in the pace of
the equilibrium and its sizes"""
LEAVING, NOISE = (0.01, 0.002, 0.0004, 0.05), 1e-14
"""How far from a branch point other equilibria are looked for, the first that succeeds; components so small are 0"""
DIFFERENCE = 2e-3
"""Half of the widest of the differences that check slopes, in the sizes of the state"""
FARTHEST = 1e3
"""How long a simulation to rest takes, in the times in which the state at its start would change by itself"""


@dataclass(frozen=True)
class RestBranch:
    """The other equilibria at a branch point: of which curve and event, the Model there, its state, the direction over
    (x, p), what is followed in, a name, and how large components are on the curve."""

    __repr__ = brief("name", "parameter")

    equilibria: str
    number: int
    model: Model
    state: np.ndarray
    direction: np.ndarray
    parameter: str
    name: str
    largest: np.ndarray


def rest_branch(equilibria: Equilibria, number: int, model: Model | None = None) -> RestBranch:
    """The other equilibria at a branch point of this number."""
    event, name = equilibria.events[number], equilibria.parameter
    there = with_parameters(model or build_model(equilibria.system), {name: event.parameter})
    largest = np.abs([point.state for point in equilibria.points]).max(axis=0)
    state, called = (
        np.where(np.abs(event.state) <= event.error * largest, 0.0, event.state),
        f"{equilibria.name}-{number}",
    )
    return RestBranch(equilibria.name, number, there, state, event.direction, name, called, largest)


def follow_equilibria(
    model: Model | RestBranch, state: Sequence[float] | np.ndarray | None = None, parameter: str | None = None,
    until: float | None = None, *, at: Sequence[float] = (), points: int = PACE.points, pace: Pace = PACE,
    name: str | None = None, out: str | Path | None = None, progress: Callable[[Equilibrium], None] | None = None,
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
    _refused(model, parameter)
    state = check_state(model, state)
    start = float(model.parameter_values[model.parameter_index(parameter)])
    _check_goals(parameter, start, until, at, points)
    span, label = None if until is None else until - start, name or (branch.name if branch else "equilibria")
    if branch is None:
        problem, rest = first_equilibrium(model, state, parameter, span)
        ways = [_Way(problem, rest, parameter, until, 1.0)]
        ways += [_Way(problem, rest, parameter, None, -1.0)] if until is None else []
    else:
        reach = None if span is None else np.array([span])
        problem = regular(at_rest(model, (parameter,), state), state, np.array([start]), reach).seen(branch.largest)
        rest = np.concatenate([state, np.zeros(problem.jets.extra)])
        ways = [_Way(problem, rest, parameter, until, sign, branch.direction) for sign in (1.0, -1.0)]
    path = None if out is None else Path(out) / label
    runs: list[tuple[SolutionCurve, _Way]] = []
    record = partial(_record, label, model, parameter, runs)

    with contextlib.nullcontext() if path is None else locks.alone_in(path):
        for k, way in enumerate(ways):
            curve = SolutionCurve()
            runs.append((curve, way))
            request = {"system": dict(model.system), "state": state, "parameter": parameter, "way": k, "until":
                       until is not None, "direction": None if branch is None else branch.direction}  # fmt: skip
            journal = CurveJournal(way, path and path / f"equilibria{k or ''}.jsonl", request, way.leads)
            goals = Goals(parameter, until, tuple(float(value) for value in at))
            for kept in follow(curve, journal, way.begin, goals, replace(pace, points=points), way.tests()):
                finished(record)
                if progress:
                    progress(kept.record)
    return record()


def _check_goals(parameter: str, start: float, until: float | None, at: Sequence[float], points: int) -> None:
    """`InputError` for goals that are none."""
    for label, value in (("until", until), *(("at", value) for value in at)):
        if value is not None and not np.isfinite(value):
            raise InputError(f"{label}: must be a finite value of {parameter}, got {value}")
    if points < 1:
        raise InputError(f"points: must be at least 1, got {points}")
    if until == start:
        raise InputError(f"until: {until!r} is where {parameter} begins; give another value")


def _refused(model: Model, parameter: str) -> None:
    """`InputError` for a system that cannot rest."""
    what = "depends on time" if model.forced else "jumps" if not model.smooth else ""
    if what:
        raise InputError(f"model: {what}, so that it has no equilibria; give an autonomous, smooth system, or continue "
                         "its orbits")  # fmt: skip
    if parameter not in model.parameter_names:
        known = model.parameter_names
        raise InputError(f"parameter: unknown {parameter!r}{closest(parameter, known)}; this system has "
                         f"{', '.join(known[:20]) or 'none'}")  # fmt: skip


def first_equilibrium(
    model: Model, state: np.ndarray, parameter: str, span: float | None = None
) -> tuple[AtRest, np.ndarray]:
    """The problem about the equilibrium near a state, or where a simulation from there comes to rest, and its z.

    Raises `ConvergenceError`.
    """
    for simulated in (False, True):
        start = _rested(model, state) if simulated else state
        jets = at_rest(model, (parameter,), start)
        value = np.array([model.parameter_values[model.parameter_index(parameter)]])
        problem = regular(jets, start, value, None if span is None else np.array([span])).seen(state)
        z = _newton(problem, start, value)
        if z is not None:
            z = np.where(np.abs(z) <= NOISE * problem.z_sizes, 0.0, without_noise(problem, z, value))
            jets = at_rest(model, (parameter,), z[: jets.size])
            problem = regular(jets, z[: jets.size], value, None if span is None else np.array([span]))
            return problem if z.any() else problem.seen(state), z  # where all is 0, the start alone has sizes
    raise ConvergenceError("no equilibrium: Newton's method finds none near the state, and a simulation from there "
                           "does not come to rest; give a state nearer to one")  # fmt: skip


def _newton(problem: AtRest, state: np.ndarray, value: np.ndarray) -> np.ndarray | None:
    """z at rest near a state; None where whole steps do not lead to it."""
    z = np.concatenate([state, np.zeros(problem.jets.extra)])

    def linearised(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        try:
            rows, slopes, _ = problem.scaled(z, value)
        except (ConvergenceError, IntegrationError):
            return np.full(z.size, np.nan), np.eye(z.size)
        return rows, slopes / problem.z_sizes

    settings = Settings(floor=1e-14, round_off=1e-9, converged=1e-9, most_evaluations=40, farthest=1e3)
    root = equilibrium(linearised, z, problem.z_sizes, settings)
    left = float(np.abs(linearised(root.w)[0]).max())  # steps are 0 where slopes are, too
    return root.w if root.converged and left <= settings.converged else None


def _rested(model: Model, state: np.ndarray) -> np.ndarray:
    """Where a motion is after a long time, by BDF; the state itself where it cannot be integrated."""
    values = model.parameter_values

    def rates(_: float, x: np.ndarray) -> np.ndarray:
        return np.asarray(model.rate(0.0, x, values).full().ravel())

    pace = float(np.abs(rates(0.0, state) / nonzero(np.abs(state))).max()) or 1.0
    with np.errstate(all="ignore"), contextlib.suppress(ValueError, ArithmeticError):
        least = 1e-9 * float(np.abs(state).max())
        found = solve_ivp(rates, (0.0, FARTHEST / pace), state, method="BDF", rtol=1e-6, atol=least)
        return np.asarray(found.y[:, -1]) if np.isfinite(found.y[:, -1]).all() else state
    return state


@dataclass(frozen=True, eq=False)
class _Way:
    """One direction along the equilibria from the first: how its points begin, are tested, recorded and kept."""

    problem: AtRest
    rest: np.ndarray
    parameter: str
    until: float | None
    sign: float
    direction: np.ndarray | None = None

    def begin(self) -> Point:
        """The first point."""
        if self.direction is not None:
            return self._beside(self.direction)
        model = self.problem.jets.model
        start = float(model.parameter_values[model.parameter_index(self.parameter)])
        w = Stacked(np.append(self.rest, start))
        point = solved(self.problem, w, lambda w: self.problem.aim(w, self.parameter, start))
        return replace(point, tangent=point.tangent * self.sign * towards(point, self.parameter, self.until))

    def _beside(self, direction: np.ndarray) -> Point:
        """The first point of a branch, so far from where it leaves."""
        model, d = self.problem.jets.model, self.problem.jets.size
        w = Stacked(np.append(self.rest, model.parameter_values[model.parameter_index(self.parameter)]))
        along = np.concatenate([direction[:d], np.zeros(self.problem.jets.extra), direction[d:]]) * self.sign
        along = along / np.sqrt(float(along @ (self.problem.metric(w) * along)))
        for length in LEAVING:
            guess = w.moved(length * along)
            try:
                point = solved(self.problem, guess, plane(self.problem, guess, along))
            except (ConvergenceError, IntegrationError):
                continue
            outwards = float(np.sum(self.problem.metric(w) * point.tangent * (point.w.vector - w.vector)))
            return replace(point, tangent=point.tangent * np.sign(outwards), arclength=length)
        raise ConvergenceError(f"no other equilibria were found beside the branch point at {self.parameter} = "
                               f"{w.vector[-1]:.9g}")  # fmt: skip

    def leads(self, point: Point) -> bool:
        """Whether a journal's first point leads there."""
        return self.direction is not None or self.until is None or towards(point, self.parameter, self.until) > 0

    def tests(self) -> Mapping[str, Callable[[Point], float]]:
        """What vanishes at events."""
        tests: dict[str, Callable[[Point], float]] = {
            "fold": lambda point: rise(point, self.parameter), "branch_point": _border,
        }  # fmt: skip
        if not self.problem.jets.model.conservative:
            tests["hopf"] = _pair
        return tests

    def record(self, point: Point) -> Equilibrium:
        """Certified."""
        z, p, _ = point.problem.parts(point.w)
        return _recorded(point.problem, z, p, point.arclength * self.sign, self.parameter, _eigenvalues(point))

    def write(self, point: Point, record: Equilibrium) -> Mapping[str, Any]:  # noqa: ARG002 - made again when read
        """Both in plain numbers."""
        return {"w": point.w.vector, "tangent": point.tangent, "arclength": point.arclength, "step": point.step,
                "sizes": point.problem.z_sizes}  # fmt: skip

    def read(self, entry: Mapping[str, Any]) -> tuple[Point, Equilibrium]:
        """Both from what was written."""
        w, tangent = np.array(entry["w"], float), np.array(entry["tangent"], float)
        if w.shape != tangent.shape or w.size != self.rest.size + 1:
            raise ValueError("a point of another size")
        problem = replace(self.problem, z_sizes=np.array(entry["sizes"], float))
        problem = problem.at(Stacked(w), tangent)[0]
        point = Point(problem, Stacked(w), tangent, float(entry["arclength"]), float(entry["step"]))
        return point, self.record(point)


def _border(point: Point) -> float:
    """The determinant of the equations and their tangent, 0 where two curves cross: its sign, a root of its size."""
    problem = point.problem
    matrix = problem.linearise(point.w)[1].matrix
    row = problem.metric(point.w) * point.tangent * problem.sizes
    sign, size = np.linalg.slogdet(np.vstack([matrix, row]))
    return float(sign * np.exp(size / len(matrix)))


def _eigenvalues(point: Point) -> np.ndarray:
    """Those of a point, remembered with it."""
    if "eigenvalues" not in point.w.known:
        z, p, _ = point.problem.parts(point.w)
        point.w.known["eigenvalues"] = eigenvalues(point.problem, z, p)
    return np.asarray(point.w.known["eigenvalues"])


def _pair(point: Point) -> float:
    """The product of all sums of two eigenvalues: its sign, and the least of them in size."""
    values = _eigenvalues(point) / point.problem.pace
    i, j = np.triu_indices(values.size, 1)
    sums = values[i] + values[j]
    return float(np.prod(np.sign(np.prod(sums / nonzero(np.abs(sums))).real)) * np.abs(sums).min(initial=1.0))


def _recorded(
    problem: AtRest, z: np.ndarray, p: np.ndarray, arclength: float, parameter: str, values: np.ndarray
) -> Equilibrium:
    d, model, noise = problem.jets.size, problem.jets.model, NOISE * problem.z_sizes
    z, values = np.where(np.abs(z) <= noise, 0.0, z), values[np.lexsort((-values.imag, -values.real))]
    value = float(p[problem.jets.free.index(parameter)])
    residual, slopes = by_differences(model, z[:d], {parameter: value}, problem.z_sizes[:d], problem.pace, values)
    return Equilibrium(
        z[:d], value, values, stability(values, problem.pace), arclength, residual,
        bool(residual <= RESIDUAL and slopes <= SLOPES),
    )  # fmt: skip


def stability(values: np.ndarray, pace: float) -> str:
    """The verdict on eigenvalues: stable | unstable | neutral."""
    least = NEUTRAL * max(pace, float(np.abs(values).max(initial=0.0)))
    largest = float(values.real.max(initial=-np.inf))
    return "unstable" if largest > least else "stable" if largest < -least else "neutral"


def by_differences(
    model: Model, state: np.ndarray, values: Mapping[str, float], sizes: np.ndarray, pace: float, claimed: np.ndarray
) -> tuple[float, float]:
    """By the rates alone: the largest in sizes and pace, and how far the claimed eigenvalues are from those of their
    differences of the sixth order, as the least singular value of A - lambda relative to the pace."""
    numbers = model.parameter_values.copy()
    for name, value in values.items():
        numbers[model.parameter_index(name)] = value
    steps = DIFFERENCE * np.array([-3, -2, -1, 1, 2, 3]) / 3.0
    columns = state[:, None] + np.concatenate([np.zeros((state.size, 1)), *(h * np.diag(sizes) for h in steps)], axis=1)
    rates = np.asarray(model.rate(0.0, columns, numbers).full()) / sizes[:, None] / pace
    weights = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0 / (DIFFERENCE / 3.0)
    slopes = sum(w * block for w, block in zip(weights, np.split(rates[:, 1:], 6, axis=1), strict=True))
    shifted, left = slopes - (claimed / pace)[:, None, None] * np.eye(state.size), float(np.abs(rates[:, 0]).max())
    if not np.isfinite(shifted).all():
        return left, np.inf
    return left, float(np.linalg.svd(shifted, compute_uv=False)[:, -1].max(initial=0.0))


def by_the_flow(model: Model, state: np.ndarray, sizes: np.ndarray, pace: float, claimed: complex) -> float:
    """How far an eigenvalue is from one of the flow, DOP853's of the variations over 1 / pace: the least singular value
    of Phi - exp(lambda t)."""
    d = state.size
    start = np.concatenate([state, np.eye(d).ravel(), [0.0]])
    units = np.concatenate([sizes, np.outer(sizes, 1.0 / sizes).T.ravel(), [1.0]])
    end = integrate_in(units, vector_field(with_variations(model)), start, np.array([0.0, 1.0 / pace]), SECOND)[-1]
    phi = end[d:-1].reshape(d, d).T * sizes / sizes[:, None]
    return float(np.linalg.svd(phi - np.exp(claimed / pace) * np.eye(d), compute_uv=False)[-1])


def _event(kept: KeptPoint, way: _Way, index: int) -> RestEvent | None:
    """What is singular near a located point, solved for; None where it is nothing."""
    problem = kept.point.problem
    z, p, _ = problem.parts(kept.point.w)
    try:
        extended, guess = singular(problem, z, p, kept.role)
        w = solve_square(extended, guess)
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
    bars, count, d = error_bars(extended, w), extended.count, problem.jets.size
    w = Stacked(np.where(np.abs(w.vector) <= bars, 0.0, w.vector))  # what is 0 to its error bar
    z, p, more = extended.parts(w)
    if np.abs((z - kept.point.w.vector[:count]) / problem.z_sizes).max() > 1e-3:
        return None  # another one
    model = with_parameters(problem.jets.model, {way.parameter: float(p[0])})
    values = eigenvalues(problem, z, p)
    found = _recorded(problem, z, p, kept.point.arclength * way.sign, way.parameter, values)
    there = _Singular(extended, z, p, more, bars, kept.point.tangent)
    name, claimed, known = TOLD[kept.role](there)
    value = by_the_flow(model, z[:d], problem.z_sizes[:d], problem.pace, claimed)
    check = Reading(value, CRITICAL, bool(value <= CRITICAL and found.residual <= RESIDUAL))
    return RestEvent(
        name, index, found.arclength, float(p[0]), float(bars[-1]), found.state, found.eigenvalues, check,
        critical=claimed, **known,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Singular:
    """A singular equilibrium as it is solved for: z, parameters, what is between them, error bars, tangent there."""

    extended: AtRest
    z: np.ndarray
    p: np.ndarray
    more: np.ndarray
    bars: np.ndarray
    tangent: np.ndarray


Told = tuple[str, complex, dict[str, Any]]
"""The kind of an event, its critical eigenvalue (1/s), what else is known of it"""


def _fold(_: _Singular) -> Told:
    return "fold", 0.0 + 0.0j, {}


def _crossing(there: _Singular) -> Told:
    problem = replace(there.extended, form="regular")
    return "branch_point", 0.0 + 0.0j, {"direction": _other(problem, there.z, there.p, there.tangent)}


def _opposite(there: _Singular) -> Told:
    kappa = float(there.more[-1])
    rate = float(np.sqrt(abs(kappa)) * there.extended.pace)
    if kappa <= 0:
        return "neutral_saddle", complex(rate), {}
    return "hopf", 1j * rate, _turning(there.extended, there.z, there.p, there.bars, rate, kappa)


TOLD = {"fold": _fold, "branch_point": _crossing, "hopf": _opposite}
"""By what vanishes: what is there"""


def _turning(
    extended: AtRest, z: np.ndarray, p: np.ndarray, bars: np.ndarray, omega: float, kappa: float
) -> dict[str, Any]:
    """Frequency, period, first Lyapunov coefficient with their error bars, and the criticality."""
    share = float(bars[3 * extended.count]) / (2 * kappa)
    coefficient, q = lyapunov(extended, z, p, omega)
    random = np.random.default_rng(0)
    moved = [
        lyapunov(extended, z + 1e6 * bars[: z.size] * random.uniform(-1, 1, z.size), p, omega)[0] for _ in range(4)
    ]
    error = float(np.abs(np.array(moved) - coefficient).max()) * 1e-5 + 1e-13 * abs(coefficient)
    sure = abs(coefficient) > 10 * error
    period = 2 * np.pi / omega
    return {
        "frequency": omega, "period": period, "period_error": period * (share + 1e-15), "lyapunov": coefficient,
        "lyapunov_error": error, "direction": np.concatenate([q.real, q.imag]),
        "criticality": ("supercritical" if coefficient < 0 else "subcritical") if sure else "",
    }  # fmt: skip


def _other(problem: AtRest, z: np.ndarray, p: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """The direction u over (x, p) of the other curve: of those in the kernel of the slopes with psi G''(u, u) = 0, psi
    in that of their transpose, the farther from a chord of the curve itself."""
    left, _, rows = np.linalg.svd(np.hstack(problem.scaled(z, p)[1:]))
    share = rows[-2:] @ (tangent / problem.sizes)
    both = np.array([share, [-share[1], share[0]]]) @ rows[-2:] / np.linalg.norm(share)

    def bent(along: np.ndarray) -> Any:
        ends = [np.split(sign * 1e-4 * along * problem.sizes, [z.size]) for sign in (-1.0, 1.0)]
        before, after = (left[:, -1] @ np.hstack(problem.scaled(z + dz, p + dp)[1:]) for dz, dp in ends)
        return (after - before) @ both.T

    (own, mixed), (_, across) = map(bent, both)
    lean = across / (mixed + np.copysign(np.sqrt(max(mixed**2 - own * across, 0.0)), mixed) or 1.0)
    other, d = (both[1] - lean * both[0]) / np.hypot(1.0, lean) * problem.sizes, problem.jets.size
    return np.asarray(np.append(other[:d], other[z.size :]))


def _record(name: str, model: Model, parameter: str, runs: list[tuple[SolutionCurve, _Way]]) -> Equilibria:
    points: list[Equilibrium] = []
    ends: list[End] = []
    events: list[RestEvent] = []
    for curve, way in reversed(runs):
        own = [kept.record for kept in curve.points]
        twice = bool(points) and way.direction is None  # the first of both ways
        points = own[::-1] if way.sign < 0 else [*points[: len(points) - twice], *own]
        ends.append(curve.end or End(STOPPED, "stopped"))
    lengths = np.array([point.arclength for point in points])
    for curve, way in runs:
        for kept in curve.events:
            index = int(np.searchsorted(lengths, kept.point.arclength * way.sign)) - 1
            sides = [other.point for other in curve.points if other.point.arclength < kept.point.arclength][-1:]
            sides += [other.point for other in curve.points if other.point.arclength > kept.point.arclength][:1]
            secant = sides[-1].w.vector - sides[0].w.vector if len(sides) > 1 else kept.point.tangent
            event = _event(replace(kept, point=replace(kept.point, tangent=secant)), way, max(index, 0))
            if event is not None:
                events.append(event)
    events.sort(key=lambda event: event.arclength)
    return Equilibria(name, dict(model.system), parameter, tuple(points), tuple(_apart(events)), tuple(ends))


def _apart(events: list[RestEvent]) -> list[RestEvent]:
    """Without folds that are branch points: of a branch that turns where it crosses another."""
    groups: dict[str, list[RestEvent]] = {"branch_point": [], "fold": []}
    for event in events:
        groups.setdefault(event.kind, []).append(event)

    def crossed(fold: RestEvent) -> bool:
        return any(
            abs(fold.parameter - other.parameter) <= 10 * (fold.error + other.error)
            or abs(fold.arclength - other.arclength) < 1e-6
            for other in groups["branch_point"]
        )

    groups["fold"] = [fold for fold in groups["fold"] if not crossed(fold)]
    return sorted((event for group in groups.values() for event in group), key=lambda event: event.arclength)


def verified(equilibria: Equilibria, model: Model | None = None) -> Certificate:
    """Every equilibrium from its record alone: rates, eigenvalues from their differences, critical ones by the flow."""
    model = model or build_model(equilibria.system)
    worst, wrong, everywhere = [0.0, 0.0, 0.0], 0, np.array([point.state for point in equilibria.points])
    sizes = state_sizes(model, np.abs(everywhere).max(axis=0))
    every: tuple[Equilibrium | RestEvent, ...] = (*equilibria.points, *equilibria.events)
    for point in every:
        value = point.value if isinstance(point, Equilibrium) else point.parameter
        state, size = point.state, float(np.abs(point.eigenvalues).max(initial=0.0)) or 1.0
        residual, slopes = by_differences(model, state, {equilibria.parameter: value}, sizes, size, point.eigenvalues)
        worst[:2] = max(worst[0], residual), max(worst[1], slopes)
        if isinstance(point, Equilibrium):
            wrong += point.stability != stability(point.eigenvalues, size)
            continue
        there = with_parameters(model, {equilibria.parameter: value})
        wrong += not point.consistent
        worst[2] = max(worst[2], by_the_flow(there, state, sizes, size, point.critical))
    return Certificate((
        at_most("rates", worst[0], RESIDUAL, "largest rate, in the sizes and the pace of its equilibrium"),
        at_most("eigenvalues", worst[1], SLOPES, "from differences of the rates"),
        at_most("critical eigenvalues", worst[2], CRITICAL, "at the events, by the flow of the variations"),
        equal("verdicts", float(wrong), 0.0, "on stability and events, which eigenvalues do not bear out"),
    ))  # fmt: skip
