"""Curves of folds and of Hopf points of equilibria in two parameters, and their points of codimension two.

A curve solves the equations of `rest_problem` with a second parameter free; along it, regularly, vanish

    folds         psi.B(a, a)  cusp              psi.E a  Bogdanov-Takens     lambda_i + lambda_j  fold-Hopf
    Hopf points   l1  generalised (Bautin)       kappa  Bogdanov-Takens       lambda_i  fold-Hopf
                  lambda_i + lambda_j  double Hopf

psi the left null vector, E the mass matrix, B the second derivative, lambda the eigenvalues that are not critical.
Source: Yu. Kuznetsov, Elements of Applied Bifurcation Theory (2004), chapters 8 and 10.
"""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from orbitfinder._runtime.sizes import nonzero, size_of
from orbitfinder.continuation.follow import Goals, KeptPoint, Test, Tests, advanced, towards
from orbitfinder.continuation.problem import Point, solved
from orbitfinder.continuation.tests import Entries, Roots
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.families import equilibria as rest
from orbitfinder.families import rest_problem as equations
from orbitfinder.families.equilibrium import Equilibria, Equilibrium, RestEvent, stability
from orbitfinder.families.rest_problem import AtRest, Judge, Stacked
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.integrate.jets import Jets, at_rest
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.records.certificate import Certificate, Check, at_most, equal
from orbitfinder.records.family import Reading

FORMS, PAIRS = (
    {"fold": "fold", "hopf": "hopf", "neutral_saddle": "hopf"},
    {"hopf": 1, "neutral_saddle": 1, "generalised_hopf": 1, "fold_hopf": 1, "double_hopf": 2},
)
"""The equations of the curve through each kind of event, and how many critical pairs each kind has"""
ZERO, REAL, AGAIN = ("fold", "cusp", "bogdanov_takens", "fold_hopf"), ("neutral_saddle",), {"bogdanov_takens": "fold"}
"""Kinds which have an eigenvalue 0, or a real pair; which are recomputed otherwise"""
NEAR, SLOPE, KNOWN = 10, 1e-4, 1e-6
"""So many points on either side of an event say what it is measured in; half of a central difference along a curve;
special points are located to this share of a step, solved for from there, and known this well at least"""
STILL, SIMPLE = 100 * equations.ROUND_OFF, 1e-9
"""A frequency squared, in the pace, that is not known from 0; <p, q> of a simple eigenvalue is larger"""
VANISHED, SAME = 1e-6, 1e-5
"""What vanishes is this share of what it is elsewhere at most; how well coefficients are recomputed"""
ALLOWED = np.array([equations.RESIDUAL, equations.SLOPES, equations.CRITICAL])
"""Of rates, eigenvalues, critical eigenvalues"""


@dataclass(frozen=True, eq=False)
class _Curve(AtRest):
    """Equations whose parameters are measured in the largest values that were met on the way."""

    def at(self, w: Stacked, tangent: np.ndarray) -> tuple[Self, Stacked, np.ndarray]:
        renewed, w, tangent = super().at(w, tangent)
        grown = replace(renewed, p_sizes=np.maximum(self.p_sizes, np.abs(self.parts(w)[1])))
        return grown, w, tangent / np.sqrt(float(tangent @ (grown.metric(w) * tangent)))


Vanishing = Callable[[AtRest, Stacked], float]
"""What is 0 at a special point, of a solution w"""


def _others(problem: AtRest, w: Stacked, tangent: np.ndarray | None = None) -> Roots:
    """The eigenvalues that are not critical (1/s)."""
    roots, critical = equations.spectrum(problem, w, tangent), [0.0 + 0.0j]
    if problem.form == "hopf":
        root = np.sqrt(complex(-w.vector[3 * problem.count])) * problem.pace
        critical = [-root, root]
    kept = np.arange(roots.values.size)
    for root in critical:
        kept = np.delete(kept, np.argmin(np.abs(roots.values[kept] - root)))
    return roots.chosen(kept)


def _least(numbers: np.ndarray) -> float:
    """The real part of the least in size."""
    return float(min(numbers, key=abs, default=1.0).real)


def _sums(problem: AtRest, w: Stacked) -> float:
    values = _others(problem, w).values / problem.pace
    i, j = np.triu_indices(values.size, 1)
    return _least(values[i] + values[j])


def _left(problem: AtRest, w: Stacked) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """psi of length 1, its sign that of a; a; the matrix [[G_z, psi], [c, 0]]."""
    gz, a = problem.scaled(*problem.parts(w)[:2])[1], w.vector[problem.count : 2 * problem.count]
    psi = np.linalg.svd(gz)[0][:, -1]
    bordered = np.block([[gz, psi[:, None]], [problem.c[None], np.zeros((1, 1))]])
    sign = np.linalg.slogdet(bordered)[0]
    bordered[:-1, -1] *= sign
    return sign * psi, a, bordered


def _quadratic(problem: AtRest, w: Stacked, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.asarray(problem.second(*problem.parts(w)[:2], u)[:, : problem.count] @ v)


def _cusp(problem: AtRest, w: Stacked) -> float:
    psi, a, _ = _left(problem, w)
    return float(psi @ _quadratic(problem, w, a, a))


def _double(problem: AtRest, w: Stacked) -> float:
    if problem.form == "hopf":
        return float(w.vector[3 * problem.count])
    psi, a, _ = _left(problem, w)
    return float(psi @ (problem.mass * a))


def _first(problem: AtRest, w: Stacked) -> float:
    """l1 of a motion in the sizes of the state; 0 of neutral saddles, and where it is infinite."""
    kappa, (z, p, _) = w.vector[3 * problem.count], problem.parts(w)
    with contextlib.suppress(np.linalg.LinAlgError):
        if kappa > STILL:
            return _length(problem, w) ** 2 * equations.lyapunov(problem, z, p, float(np.sqrt(kappa) * problem.pace))[0]
    return 0.0


TESTS: Mapping[str, Mapping[str, Vanishing]] = {
    "fold": {"cusp": _cusp, "bogdanov_takens": _double, "fold_hopf": _sums},
    "hopf": {"bogdanov_takens": _double, "generalised_hopf": _first, "double_hopf": _sums,
             "fold_hopf": lambda problem, w: _least(_others(problem, w).values / problem.pace)},
}  # fmt: skip
"""By the form of the curve: what vanishes at its points of codimension two"""
ENTRIES: Mapping[str, Mapping[str, Test | Entries]] = {
    "fold": {"fold_hopf": Entries.SUMS}, "hopf": {"double_hopf": Entries.SUMS, "fold_hopf": Entries.ROOTS},
}  # fmt: skip
"""Those of them that are entries of the spectrum of what is not critical"""


def _length(problem: AtRest, w: Stacked) -> float:
    """Of the critical vector in the model's units, where in the sizes it is 1."""
    a = w.vector[problem.count : 2 * problem.count]
    return float(np.linalg.norm((a * problem.z_sizes)[: problem.jets.size]) / np.linalg.norm(a))


def _lyapunov(problem: AtRest, w: Stacked) -> dict[str, float]:
    first = _first(problem, w)
    return {"l1": first / _length(problem, w) ** 2} if first else {}


def _vectors(problem: AtRest, w: Stacked) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """psi, a, the bordered matrix, B(a, a), and the length of a in the model's units."""
    psi, a, bordered = _left(problem, w)
    return psi, a, bordered, _quadratic(problem, w, a, a), float(np.linalg.norm(a)) * _length(problem, w)


def _bend(problem: AtRest, w: Stacked) -> dict[str, float]:
    """<p, B(q, q)> / 2; nothing where the eigenvalue 0 is double."""
    psi, a, _, square, size = _vectors(problem, w)
    share = float(psi @ (problem.mass * a))
    return {"a": problem.pace * float(psi @ square) / share / (2 * size)} if abs(share) > SIMPLE else {}


def _cubic(problem: AtRest, w: Stacked) -> dict[str, float]:
    """<p, C(q, q, q) + 3 B(q, h)> / 6, A h = -B(q, q)."""
    psi, a, bordered, square, size = _vectors(problem, w)
    v, h = a * problem.z_sizes, np.linalg.solve(bordered, -np.append(square, 0.0))[:-1]
    third = problem.jets.third(*problem.parts(w)[:2], v, v) @ v / problem.row_sizes
    whole = psi @ (np.append(third, np.zeros(len(problem.phase))) + 3 * _quadratic(problem, w, a, h))
    share = float(psi @ (problem.mass * a))
    return {"c": problem.pace * float(whole) / share / (6 * size**2)} if abs(share) > SIMPLE else {}


def _takens(problem: AtRest, w: Stacked) -> dict[str, float]:
    """a = <p1, B(q0, q0)> / 2 > 0, b = <p0, B(q0, q0)> + <p1, B(q0, q1)>."""
    psi, a, bordered, square, size = _vectors(problem, w)
    b = np.linalg.solve(bordered, np.append(problem.mass * a, 0.0))[:-1]
    psi = psi / (psi @ (problem.mass * b))
    phi = np.linalg.solve(bordered.T, np.append(problem.mass * psi, 0.0))[:-1]
    phi = phi - (phi @ (problem.mass * b)) * psi
    first, size = float(psi @ square), size * float(np.sign(psi @ square))
    mixed = phi @ square + psi @ _quadratic(problem, w, a, b)
    return {"a": problem.pace**2 * first / (2 * size), "b": problem.pace * float(mixed) / size} if first else {}


NORMAL: Mapping[str, Callable[[AtRest, Stacked], dict[str, float]]] = defaultdict(
    lambda: lambda problem, w: {}, hopf=_lyapunov, fold=_bend, cusp=_cubic, bogdanov_takens=_takens,
)  # fmt: skip
"""Coefficients of normal forms with <q, q> = <p, q> = 1 in the model's units"""


def _claims(kind: str, values: np.ndarray) -> list[complex]:
    """The critical eigenvalues of a kind by all that there are, of pairs the first."""
    claims = []
    if kind in ZERO:
        claims, values = [0.0 + 0.0j], np.delete(values, np.argmin(np.abs(values)))
    for _ in range(PAIRS.get(kind, 0)):
        i, j = equations.critical_pair(values)
        claims.append(complex(np.sqrt(-(values[i] * values[j]).real + 0j)))
        values = np.delete(values, [i, j])
    return claims


def _consistent(kind: str, values: np.ndarray) -> bool:
    """Whether critical pairs are imaginary, those of neutral saddles real."""
    claims = _claims(kind, values)
    return all((claim.imag > 0) == (kind not in REAL) for claim in claims[len(claims) - PAIRS.get(kind, 0) :])


def _judged(judge: Judge, least: float, each: Equilibrium | RestEvent, sizes: np.ndarray) -> np.ndarray:
    """Of rates, eigenvalues and critical ones what is left, in a pace that is no less than given."""
    pace, value, claims = _pace(least, each), each.values, list[complex]()
    if value.size:
        claims = _claims(each.kind, each.eigenvalues)
    elif isinstance(each, RestEvent):
        value, claims = np.array([each.parameter]), [each.critical]
    else:
        value = np.array([each.value])
    left = judge.left(each.state, value, sizes, pace, each.eigenvalues)
    flows = [judge.flow(each.state, value, sizes, pace, claim) for claim in claims]
    return np.array([*left, max(flows, default=0.0)])


def _pace(least: float, each: Equilibrium | RestEvent) -> float:
    return max(least, float(np.abs(each.eigenvalues).max(initial=0.0))) or 1.0


@dataclass(eq=False)
class _AlongCurve(rest.RestDirection):
    """A direction along a curve from the event that it is of."""

    tangent: np.ndarray

    def begin(self) -> Point:
        point = Point(self.problem, Stacked(self.rest), self.tangent)
        return replace(point, tangent=self.tangent * self.sign * towards(point, self.goals.name, self.goals.until))

    def tests(self) -> Tests:
        form = self.problem.form
        known: dict[str, Test | Entries] = {role: partial(_value, test) for role, test in TESTS[form].items()}
        known.update(ENTRIES[form])
        alone = equations.paired(self.problem, Stacked(self.rest))
        return {role: test for role, test in known.items() if role == "cusp" or not alone}

    def spectrum(self, point: Point) -> Roots:
        return _others(point.problem, point.w, point.tangent)

    def record(self, point: Point) -> Equilibrium:
        problem, w = point.problem, point.w
        left = equations.SETTINGS.round_off * problem.sizes  # by the corrector
        z, p, more = problem.parts(Stacked(np.where(np.abs(w.vector) <= left, 0.0, w.vector)))
        values, d, others = equations.spectrum(problem, w).values, problem.jets.size, _others(problem, w)
        kind = "neutral_saddle" if problem.form == "hopf" and more[-1] <= 0 else problem.form
        verdict = stability(others.values, others.errors)
        known = Equilibrium(
            z[:d], float(p[0]), values[np.lexsort((-values.imag, -values.real))], verdict, point.arclength * self.sign,
            kind=kind, values=p, normal_form=NORMAL[kind](problem, w),
        )  # fmt: skip
        judged = _judged(self.judge, self.problem.pace, known, problem.z_sizes[:d])
        return replace(known, residual=float(judged[0]), certified=bool((judged <= ALLOWED).all()))

    def write(self, point: Point, record: Equilibrium) -> Mapping[str, Any]:  # noqa: ARG002 - made again when read
        return point.entry | {"sizes": point.problem.p_sizes, "c": point.problem.c}

    def read(self, entry: Mapping[str, Any]) -> tuple[Point, Equilibrium]:
        w, tangent, sizes, c = (np.array(entry[name], float) for name in ("w", "tangent", "sizes", "c"))
        if not w.size == tangent.size == self.rest.size:
            raise ValueError("a point of another size")
        problem = replace(self.problem, p_sizes=sizes, c=c)
        point = Point(problem, Stacked(w), tangent, float(entry["arclength"]), float(entry["step"]))
        return point, self.record(point)

    def special(self, kept: KeptPoint, index: int) -> RestEvent | None:
        """None where a test jumps, too."""
        point, test = kept.point.sharp, TESTS[kept.point.problem.form][kept.role]
        try:
            for _ in range(3):
                point = advanced(point, -test(point.problem, point.w) / _slope(point, test)).sharp
            errors = _errors(point, test)
        except (ConvergenceError, IntegrationError, ArithmeticError, np.linalg.LinAlgError):
            return None
        there, problem = self.record(point), point.problem
        jumps = abs(point.arclength - kept.point.arclength) > SLOPE or not (errors <= KNOWN * problem.p_sizes).all()
        if jumps or not _consistent(kept.role, there.eigenvalues):
            return None
        critical = _claims(kept.role, there.eigenvalues)[-1]
        event = RestEvent(
            kept.role, index, there.arclength, there.value, float(errors[0]), there.state, there.eigenvalues,
            frequency=critical.imag or np.nan, critical=critical, values=there.values, errors=errors,
            normal_form=NORMAL[kept.role](problem, point.w),
        )  # fmt: skip
        judged = _judged(self.judge, self.problem.pace, event, problem.z_sizes[: problem.jets.size])
        return replace(event, check=Reading(float(judged[2]), float(ALLOWED[2]), bool((judged <= ALLOWED).all())))


def _value(test: Vanishing, point: Point) -> float:
    return test(point.problem, point.w)


def _slope(point: Point, test: Vanishing) -> float:
    """What a test changes by along the tangent."""
    ends = [test(point.problem, point.w.moved(side * SLOPE * point.tangent)) for side in (-1.0, 1.0)]
    return (ends[1] - ends[0]) / (2 * SLOPE)


def _errors(point: Point, test: Vanishing) -> np.ndarray:
    """Error bars of both parameters: those across the curve, and along it by what the test is known to."""
    problem, w, tangent, random = point.problem, point.w, point.tangent, np.random.default_rng(0)
    bars, value = equations.error_bars(problem, w, problem.metric(w) * tangent), test(problem, w)
    moved = [test(problem, w.moved(1e5 * bars * random.uniform(-1, 1, bars.size))) - value for _ in range(4)]
    share = (abs(value) + 1e-4 * size_of(np.array(moved))) / abs(_slope(point, test)) + equations.ROUND_OFF
    return np.asarray((bars + np.abs(tangent) * share)[-2:])


@one_thread()
def follow_rest_curve(
    equilibria: Equilibria, event: int | RestEvent, names: tuple[str, str], until: float | None, at: Sequence[float],
    points: int, out: str | Path | None, name: str | None, model: Model, progress: Callable[[Equilibrium], None] | None,
) -> Equilibria:  # fmt: skip
    """The curve of an event of equilibria in two parameters (see `curves.follow_curve`)."""
    number, chosen = _chosen(equilibria, event)
    model = with_parameters(model, {equilibria.parameter: chosen.parameter})
    start = _start(equilibria, chosen, names, until, model)
    rest.check_goals(model, names[0], start.value(names[0]), until, at, points)
    fixed = {} if equilibria.parameter in names else {equilibria.parameter: chosen.parameter}
    form, slowest = start.problem.form, start.problem.pace
    curve = {"test": {"kind": form, "detail": ""}, "form": form, "parameters": names, "pace": slowest, "fixed": fixed}
    judge, label = Judge(model, names), name or f"{equilibria.name}-{number}-{'-'.join(names)}"
    request = {"system": dict(model.system), "start": start.w.vector, "curve": curve, "way": 0, "until":
               until is not None}  # fmt: skip
    goals, pace = Goals(names[0], until, tuple(map(float, at))), replace(rest.PACE, points=points, located=KNOWN)
    first = _AlongCurve(goals, 1.0, request, judge, start.problem, start.w.vector, None, start.tangent)
    return rest.gone(first, until is None, (label, equilibria.title), pace, out, progress, curve)


def _chosen(equilibria: Equilibria, event: int | RestEvent) -> tuple[int, RestEvent]:
    """The event and its number. `InputError` lists those that can be followed."""
    known = [(k, each) for k, each in enumerate(equilibria.events) if each.kind in FORMS]
    if equilibria.curve:
        raise InputError(f"{equilibria.name}: is a curve in two parameters itself; give the equilibria that it was "
                         "started from")  # fmt: skip
    for k, each in known:
        if each is event or k == event:
            return k, each
    listed = "; ".join(f"{k}: {each.words} at {equilibria.parameter} {each.parameter:.6g}" for k, each in known)
    choice = f"choose one of {listed}" if listed else "it has no fold or Hopf point"
    raise InputError(f"event: no curve leads through event {event if isinstance(event, int) else event.kind} of "
                     f"{equilibria.name}; {choice}")  # fmt: skip


def _start(
    equilibria: Equilibria, event: RestEvent, names: tuple[str, str], until: float | None, model: Model
) -> Point:  # fmt: skip
    """The event as the first point of its curve, along which the parameter that is not the equilibria's grows."""
    values = model.values_of(names)
    problem = equations.regular(at_rest(model, names, event.state), event.state, values)
    beside, d = equilibria.points[max(event.index - NEAR, 0) : event.index + NEAR + 2], problem.jets.size
    pace = size_of(np.concatenate([event.eigenvalues, *(point.eigenvalues for point in beside)]))
    z_sizes, met = problem.z_sizes.copy(), max(abs(point.value) for point in beside)
    z_sizes[d:] *= pace / problem.pace
    z_sizes[:d] = equations.state_sizes(model, np.abs([point.state for point in beside]).max(axis=0))
    if model.rates is None:
        z_sizes[d // 2 : d] = z_sizes[: d // 2] * pace
    p_sizes = np.maximum(np.abs(values), [met * (name == equilibria.parameter) for name in names])
    if until is not None:
        p_sizes[0] = max(p_sizes[0], abs(until - values[0]))
    p_sizes = np.array([model.scales.get(name, size) for name, size in zip(names, p_sizes, strict=True)])
    unknown, given = p_sizes == 0.0, {part.name: getattr(problem, part.name) for part in fields(problem)}
    given |= {"z_sizes": z_sizes, "p_sizes": np.where(unknown, 1.0, p_sizes), "pace": pace}
    z = np.concatenate([event.state, np.zeros(problem.jets.extra)])
    extended, guess = equations.singular(_Curve(**given), z, values, FORMS[event.kind])
    held = names[0] if names[0] != equilibria.parameter else names[1]
    value = extended.value(guess, held)
    try:
        point = solved(extended, guess, lambda w: extended.aim(w, held, value))
        lengths = np.sqrt(extended.metric(guess)) * point.tangent  # a parameter at 0 moves as much as the others
        others = np.linalg.norm(lengths * np.append(np.ones(guess.vector.size - 2), ~unknown))
        sized = np.where(unknown, np.abs(point.tangent[-2:]) / nonzero(float(others)), extended.p_sizes)
        extended = replace(extended, p_sizes=np.where(sized > 0.0, sized, 1.0))
        return solved(extended, point.w, lambda w: extended.aim(w, held, value))
    except ConvergenceError as error:
        raise ConvergenceError(f"the {event.words} at {equilibria.parameter} = {event.parameter:.9g} does not move "
                               f"with {' and '.join(names)}: {error}") from error  # fmt: skip


def verified(equilibria: Equilibria, model: Model | None = None) -> Certificate:
    """Every point from its record alone: rates, eigenvalues from their differences, critical ones by the flow, and
    verdicts; along a curve also coefficients, and that special points are such."""
    every: tuple[Equilibrium | RestEvent, ...] = (*equilibria.points, *equilibria.events)
    curve = equilibria.curve
    fixed, least = (curve["fixed"], curve["pace"]) if curve else ({}, 0.0)
    model = with_parameters(model or build_model(equilibria.system), fixed)
    measured = every if curve else equilibria.points
    sizes = equations.state_sizes(model, np.abs([each.state for each in measured]).max(axis=0))
    judge, wrong = Judge(model, equilibria.parameters), 0
    judged = np.max([_judged(judge, least, each, sizes) for each in every], axis=0)
    for each in every:
        if curve:
            wrong += not _consistent(each.kind, each.eigenvalues)
        elif isinstance(each, RestEvent):
            wrong += not each.consistent
        else:
            wrong += not judge.follows(each, sizes, _pace(least, each))
    where, what = ("", "kinds") if curve else ("at the events, ", "stability and events")
    return Certificate((
        at_most("rates", judged[0], ALLOWED[0], "largest rate, in the sizes and the pace of its equilibrium"),
        at_most("eigenvalues", judged[1], ALLOWED[1], "from differences of the rates"),
        at_most("critical eigenvalues", judged[2], ALLOWED[2], f"{where}by the flow of the variations"),
        *(_solved_again(at_rest(model, equilibria.parameters, every[0].state), curve, every, sizes) if curve else ()),
        equal("verdicts", float(wrong), 0.0, f"on {what}, which eigenvalues do not bear out"),
    ))  # fmt: skip


def _solved_again(
    jets: Jets, curve: Mapping[str, Any], every: Sequence[Equilibrium | RestEvent], sizes: np.ndarray
) -> tuple[Check, Check]:  # fmt: skip
    """Special points and coefficients along a curve, at the recorded states."""
    known: list[tuple[Equilibrium | RestEvent, AtRest, Stacked]]
    known = [(each, *_again(jets, curve, each, sizes)) for each in every if each.kind not in REAL]
    off = left = 0.0
    for each, problem, w in known:
        if isinstance(each, RestEvent):
            test: Vanishing = TESTS[problem.form].get(each.kind, lambda problem, w: np.inf)
            alike = [abs(test(there, v)) for point, there, v in known if point.kind in (curve["form"],)]
            usual = 1.0 if each.kind in AGAIN else float(np.median(alike))
            left = max(left, abs(test(problem, w)) / nonzero(usual))
        for name, value in each.normal_form.items():
            mine = NORMAL[each.kind](problem, w).get(name, np.inf)
            off = max(off, abs(abs(mine) - abs(value)) / size_of(np.array([mine, value])))
    return (
        at_most("special points", left, VANISHED, "what vanishes there, relative to its median along the curve"),
        at_most("coefficients", off, SAME, "of normal forms, from those of the equations at the recorded states"),
    )


def _again(
    jets: Jets, curve: Mapping[str, Any], each: Equilibrium | RestEvent, sizes: np.ndarray
) -> tuple[AtRest, Stacked]:  # fmt: skip
    """The singular problem at a recorded state, and what is singular there."""
    problem = equations.regular(jets, each.state, each.values)
    extra = problem.z_sizes[jets.size :] * curve["pace"] / problem.pace
    problem = replace(problem, z_sizes=np.append(sizes, extra), pace=curve["pace"])
    form = AGAIN.get(each.kind, curve["form"])
    return equations.singular(problem, np.append(each.state, np.zeros(jets.extra)), each.values, form)
