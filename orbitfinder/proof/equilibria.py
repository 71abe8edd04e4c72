"""Equilibria, their folds and their Hopf points proved by Krawczyk's operator, which needs no flow here.

With f the rates, J = f_x, p the parameter and c numbers that fix the length of vectors, the equations are

    equilibrium     f = 0                                                    in x
    fold            f = 0,  J a = 0,  c.a = 1                                in x, a, p
    hopf            f = 0,  J a = -kappa b,  J b = a,  c.a = 1,  c.b = 0     in x, a, b, kappa, p

A zero in whose box DF is regular is alone there. For a fold that is all: the kernel is simple, the curve turns,
and quadratically. A Hopf point has omega^2 = kappa and q = a + i omega b; what else Hopf's theorem asks for is enclosed
too: the other eigenvalues off the axis, d Re lambda / dp and the first Lyapunov coefficient not 0. Sources: G. Moore,
A. Spence, SIAM J. Numer. Anal. 17 (1980) 567-576; A. Griewank, G. Reddien, IMA J. Numer. Anal. 3 (1983) 295-303; Yu.
Kuznetsov, Elements of Applied Bifurcation Theory (2004), sections 3.4 and 5.4.
"""

from __future__ import annotations

import operator
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property, partial
from math import log10
from pathlib import Path
from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError, plural
from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.families.rest_problem import state_sizes
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import parameter_sizes
from orbitfinder.proof.balls import (
    Vector,
    Versioned,
    acb,
    acb_mat,
    arb,
    arb_mat,
    decimal,
    dense,
    eigenvalues,
    exact,
    floats,
    identity,
    inside,
    magnitude,
    midpoints,
    precision,
    radius,
    why_not,
)
from orbitfinder.proof.field import NUMERICAL, sloped
from orbitfinder.proof.krawczyk import approximate_inverse, contracted
from orbitfinder.proof.program import Ring, ScalarProgram, derived
from orbitfinder.proof.record import DIGITS, MARGIN, at_least, bounding, enclosure, holds, holds_each, timed
from orbitfinder.proof.series import BALLS
from orbitfinder.proof.theorem import NotProved, Options, Progress, Proving, provable_system, refuse, silent
from orbitfinder.proof.trajectory import positive_definite
from orbitfinder.records.codec import Codec, entries_of
from orbitfinder.records.reading import Entries, Table

BITS, NEWTON, SHARPER, LEAST = 160, 12, 20, 1e-30
"""Precision; Newton's steps to a centre; how often the operator is applied to its own image; recorded balls are wider
than this share of what they are measured in, which another start's round-off stays below"""
BOXES, COMPLEX = np.logspace(-2, -14, 13), Ring(acb, BALLS.functions)
"""Half widths of the boxes that are tried, in the sizes of the unknowns; complex balls"""


@dataclass(frozen=True)
class ProvedRest(Shown):
    """What was proved of an equilibrium, a fold or a Hopf point, or why nothing was. Balls are {"value", "radius"}.

    Args:
        event: fold | hopf, of a point "".
        index: of the point or the event in the equilibria.
        proved: whether all was.
        reason: why not.
        radius: of the box that holds it alone, in the sizes of the unknowns.
        contraction: a bound of the norm of 1 - C DF over it.
        value: of the parameter.
        state: x (d).
        eigenvalues: (re, im) of each, of J.
        stability: asymptotically stable | unstable | stable (by its energy) | open, of equilibria.
        vector: c (d), the numbers that fix the length of a.
        known: of a Hopf point its frequency (rad/s), crossing d Re lambda / dp and lyapunov.
        criticality: supercritical | subcritical.
    """

    __repr__ = brief("event", "index", "proved", "reason", "radius")
    _sparse = ("reason", "vector", "known", "criticality")

    event: str
    index: int
    proved: bool = False
    reason: str = ""
    radius: float = 0.0
    contraction: float = 0.0
    value: Table | None = None
    state: tuple[Table, ...] = ()
    eigenvalues: tuple[tuple[Table, ...], ...] = ()
    stability: str = ""
    vector: tuple[float, ...] = ()
    known: Table | None = None
    criticality: str = ""

    @property
    def place(self) -> str:
        """What it is, and its number, for messages."""
        return f"{self.event or 'equilibrium'} {self.index}"


@dataclass(frozen=True)
class ProvedEquilibria(Shown, Versioned):
    """An equilibria-proof.json: what was proved of the points and the events of an equilibria.json.

    Args:
        name: of the equilibria.
        system: plain description that rebuilds the model.
        parameter: that they were followed in.
        events: the kinds of all of its events, which say what `index` is of a fold and a Hopf point.
        parts: of each point, then of each fold and Hopf point.
        wall_time: s.
    """

    __repr__ = brief("name", "parameter", "proved")
    _entries = (..., "wall_time", "versions", "parts")

    name: str
    system: Table
    parameter: str
    events: tuple[str, ...] = ()
    parts: tuple[ProvedRest, ...] = ()
    wall_time: float = 0.0

    @property
    def proved(self) -> bool:
        """Whether everything was."""
        return bool(self.parts) and all(part.proved for part in self.parts)

    @property
    def kept(self) -> bool:
        """Whether anything was."""
        return any(part.proved for part in self.parts)

    @property
    def lines(self) -> list[str]:
        """How many points are proved, and what of each event."""
        points = [part for part in self.parts if not part.event]
        verdicts = Counter(part.stability for part in points if part.proved)
        said = ": " * bool(verdicts) + ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
        lines = [f"{verdicts.total()} of {plural(len(points), 'point')} proved in {self.wall_time:.1f} s{said}"]
        for part in self.parts:
            if not part.proved:
                lines.append(f"  {part.place}: not proved: {part.reason}")
            elif part.event and part.value:
                known = {self.parameter: part.value} | dict(part.known or {})
                numbers = ", ".join(f"{name} {_shown(ball)}" for name, ball in known.items())
                said = f"{part.criticality} proved".strip()
                lines.append(f"  {part.place}: {said}, alone within {part.radius:.0e} of its sizes; {numbers}")
        return lines


def _shown(ball: Table) -> str:
    """A recorded ball with its digits."""
    value, within = float(ball["value"]), float(ball["radius"])
    places = 18 if not within else max(min(18, int(log10(abs(value) / within)) if value else 1), 1)
    return f"{Decimal(ball['value']):.{places}g} +/- {within:.0e}"


CODEC = Codec(ProvedEquilibria, "equilibria-proof", "`orbitfinder prove`", "prove it again", sealed=True)
read_proof = CODEC.load


class _Rest:
    """Everything about the rest of a model that is evaluated on balls, as programs in its states and parameters."""

    def __init__(self, model: Model, parameter: str) -> None:
        if not model.smooth or model.forced or model.constraint is not None:
            raise InputError("system: equilibria are proved of smooth autonomous systems without constraints only")
        if not model.scalar:
            raise InputError(NUMERICAL)
        self.model, self.size, self.at = model, len(model.state_names), model.parameter_index(parameter)
        d, p = self.size, ca.SX.sym("p", len(model.parameter_values))
        x, a, b, c, u, v, z, y = (ca.SX.sym(name, d) for name in "xabcuvzy")
        kappa, value, rate = ca.SX.sym("kappa"), p[self.at], ca.densify(model.rate(0.0, x, p))

        self.rate, self.symbols = rate, (p, value, x, a, b, c, u, v, z, y, kappa)
        self.zeros = dict[str, ScalarProgram]()

    def _form(self, inputs: Sequence[ca.SX], results: Callable[[ca.SX], Sequence[ca.SX]]) -> ScalarProgram:
        return derived("rest", [*inputs, self.symbols[0]], self.rate, results)

    def zero(self, event: str) -> ScalarProgram:
        """The rows of a theorem in x, a, b, kappa, c, and their derivatives by its unknowns."""
        if event not in self.zeros:
            _, value, x, a, b, c, *_, kappa = self.symbols

            def rows(f: ca.SX) -> ca.SX:
                turned, unit = (partial(ca.jtimes, f, x), ca.dot(c, a) - 1.0)
                parts = {
                    "": [f], "fold": [f, turned(a), unit],
                    "hopf": [f, turned(a) + kappa * b, turned(b) - a, unit, ca.dot(c, b)],
                }  # fmt: skip
                return ca.densify(ca.vertcat(*parts[event]))

            unknowns = {"": x, "fold": ca.vertcat(x, a, value), "hopf": ca.vertcat(x, a, b, kappa, value)}[event]
            self.zeros[event] = self._form([x, a, b, kappa, c], sloped(unknowns, rows))
        return self.zeros[event]

    @cached_property
    def first(self) -> ScalarProgram:
        """J and f_p."""
        _, value, x, *_ = self.symbols
        return self._form([x], lambda f: [ca.jacobian(f, x), ca.jacobian(f, value)])

    @cached_property
    def forms(self) -> dict[str, ScalarProgram]:
        """B(u, v), C(u, v, z) and the change of J u along (y, 1) in state and parameter."""
        _, value, x, _, _, _, u, v, z, y, _ = self.symbols
        both, away = ca.vertcat(x, value), ca.vertcat(y, 1.0)

        def bent(f: ca.SX) -> ca.SX:
            return ca.jtimes(ca.jtimes(f, x, u), x, v)

        made = {
            "second": bent, "third": lambda f: ca.jtimes(bent(f), x, z),
            "moving": lambda f: ca.jtimes(ca.jtimes(f, x, u), both, away),
        }  # fmt: skip
        return {name: self._form([x, u, v, z, y], lambda f, of=of: [ca.densify(of(f))]) for name, of in made.items()}  # type: ignore[misc]

    @cached_property
    def energy(self) -> ScalarProgram | None:
        """The second derivatives of an energy that is conserved as the model is made."""
        model, (p, _, x, *_) = self.model, self.symbols
        if not (model.canonical and model.conservative):
            return None
        n = model.degrees_of_freedom if model.rates is None else self.size
        energy = next(each for each in model.invariants if each.generator is None).value(x[:n], x[n:], p)
        return derived("bend", [x, p], energy, lambda exact: [ca.hessian(exact, x)[0]])

    def parameters(self, value: Any) -> Vector:
        """All of them as the decimals that they are written as, but for that."""
        every = [decimal(float(number)) for number in self.model.parameter_values]
        every[self.at] = value
        return every

    def slopes(self, x: Vector, p: Vector) -> tuple[Any, Vector]:
        """J and f_p."""
        jacobian, by_value = self.first.run([x, p], BALLS)
        d = self.size
        return dense(jacobian, d, d), [by_value.get(i, arb(0)) for i in range(d)]

    def complex(self, form: str, x: Vector, p: Vector, *given: Any) -> list[Any]:
        """A form (d) of complex vectors u, v, z, y."""
        zero = [acb(0)] * self.size
        vectors = [list(vector.entries()) for vector in given] + [zero] * (4 - len(given))
        entries = self.forms[form].run([list(map(acb, x)), *vectors, list(map(acb, p))], COMPLEX)[0]
        return [entries.get(i, acb(0)) for i in range(self.size)]


@dataclass(frozen=True)
class Slopes:
    """J and f_p at an equilibrium, in balls."""

    jacobian: Any
    by_value: Vector

    @cached_property
    def eigenvalues(self) -> tuple[list[Any], bool]:
        """Balls that hold all of them, and whether each holds a single eigenvalue."""
        return eigenvalues(self.jacobian)


Wide = Callable[..., Entries]
"""How a ball is recorded"""


@dataclass(frozen=True)
class _Claim:
    """What is to be proved: an event or "", its number, about which state and value of the parameter; of events c (d;
    chosen where it is not known), of Hopf points the frequency."""

    event: str
    index: int
    state: np.ndarray
    value: float
    c: tuple[float, ...] = ()
    frequency: float = np.nan


class _Near(NamedTuple):
    """The sizes of a state (d) and of the parameter (1), and the slopes (d x d) there."""

    sizes: np.ndarray
    size: np.ndarray
    slopes: np.ndarray


@dataclass(frozen=True)
class _RestTheorem:
    """The theorem about a point: rows and unknowns, the sizes of these, where Newton's steps begin, what follows."""

    rest: _Rest
    stated: _Claim
    sizes: np.ndarray
    start: np.ndarray
    c: np.ndarray

    @classmethod
    def about(cls, rest: _Rest, what: _Claim, near: _Near) -> Self:
        """Of what is stated."""
        return cls(rest, what, near.sizes, what.state, np.zeros(rest.size))

    def parts(self, w: Vector) -> tuple[Vector, Vector, Vector, Any, Any]:
        """x, a, b, kappa, the parameter."""
        none = [arb(0)] * self.rest.size
        return w, none, none, arb(0), decimal(self.stated.value)

    def concluded(self, part: ProvedRest, w: Vector, slopes: Slopes, wide: Wide) -> ProvedRest:  # noqa: ARG002
        """What follows for a point whose zero is proved. Raises `NotProved`."""
        return replace(part, stability=_stability(self.rest, slopes.eigenvalues[0], w, decimal(self.stated.value)))

    def unknowns(self, u: Vector) -> Vector:
        """Those that are so many of their sizes."""
        return [number * float(size) for number, size in zip(u, self.sizes, strict=True)]

    def evaluated(self, u: Vector) -> tuple[Vector, Any]:
        """F and its derivatives by the unknowns in their sizes."""
        x, a, b, kappa, value = self.parts(self.unknowns(u))
        rows, slopes = self.rest.zero(self.stated.event).run(
            [x, a, b, [kappa], self.c.tolist(), self.rest.parameters(value)], BALLS
        )
        matrix = dense(slopes, len(u), len(u)) * exact(np.diag(self.sizes))
        return [rows.get(i, arb(0)) for i in range(len(u))], matrix

    def proved(self) -> tuple[Vector, float, float]:
        """The zero's balls, the radius of the box that holds no other, and the contraction. Raises `NotProved`."""
        here = [arb(float(number)) for number in self.start / self.sizes]
        for _ in range(NEWTON):
            values, slopes = self.evaluated(here)
            step = (exact(approximate_inverse(floats(slopes))) * arb_mat(len(values), 1, midpoints(values))).entries()
            here = midpoints([x - dx for x, dx in zip(here, step, strict=True)])
        if not all(x.is_finite() for x in here):
            raise NotProved("Newton's steps lead nowhere from the record")
        values, best = self.evaluated(here)[0], np.inf
        for size in BOXES:
            box = [x + arb(0, float(size)) for x in here]
            image, contraction = contracted(values, self.evaluated(box)[1], box)
            best = min(best, contraction)
            if inside(box, image):
                for _ in range(SHARPER):  # the same zero, enclosed by the operator's images of its images
                    sharper = contracted(self.evaluated(midpoints(image))[0], self.evaluated(image)[1], image)[0]
                    if radius(sharper) > 0.5 * radius(image):
                        break
                    image = sharper
                return self.unknowns(image), float(size), contraction
        raise NotProved(
            f"the interval Newton operator maps no box into itself; contraction {best:.3g}: it may be singular"
        )


class _FoldTheorem(_RestTheorem):
    """The theorem about a fold: x, a, the parameter."""

    @classmethod
    def about(cls, rest: _Rest, what: _Claim, near: _Near) -> Self:
        """See `_RestTheorem`; a is the kernel's vector."""
        c, (sizes, size, slopes) = np.array(what.c), near
        c = c if c.size else np.linalg.svd(slopes * sizes / sizes[:, None])[2][-1] / sizes
        start = [*what.state, *_along(c, sizes), what.value]
        return cls(rest, what, np.array([*sizes, *sizes, *size]), np.array(start), c)

    def parts(self, w: Vector) -> tuple[Vector, Vector, Vector, Any, Any]:
        """See `_RestTheorem`."""
        d = self.rest.size
        return w[:d], w[d : 2 * d], [arb(0)] * d, arb(0), w[-1]

    def concluded(self, part: ProvedRest, w: Vector, slopes: Slopes, wide: Wide) -> ProvedRest:  # noqa: ARG002
        """See `_RestTheorem`: the zero is all."""
        return replace(part, vector=tuple(self.c.tolist()))


class _HopfTheorem(_RestTheorem):
    """The theorem about a Hopf point: x, a, b, kappa, the parameter."""

    @classmethod
    def about(cls, rest: _Rest, what: _Claim, near: _Near) -> Self:
        """See `_RestTheorem`; a is the longest real part of the vector of i omega, across its imaginary part."""
        c, omega, (sizes, size, slopes) = np.array(what.c), what.frequency, near
        if not c.size:
            values, vectors = np.linalg.eig(slopes * sizes / sizes[:, None])
            q = vectors[:, np.argmin(np.abs(values - 1j * omega))]
            q = q * np.exp(-0.5j * np.angle(np.sum(q**2)))
            c = q.real / np.sum(q.real**2) / sizes
        a = _along(c, sizes)
        start = [*what.state, *a, *np.linalg.solve(slopes, a), omega**2, what.value]
        return cls(rest, what, np.array([*sizes, *sizes, *sizes / omega, omega**2, *size]), np.array(start), c)

    def parts(self, w: Vector) -> tuple[Vector, Vector, Vector, Any, Any]:
        """See `_RestTheorem`."""
        d = self.rest.size
        return w[:d], w[d : 2 * d], w[2 * d : 3 * d], w[-2], w[-1]

    def concluded(self, part: ProvedRest, w: Vector, slopes: Slopes, wide: Wide) -> ProvedRest:
        """See `_RestTheorem`: that the pair is alone on the axis and crosses it, and on which side cycles are born."""
        x, a, b, kappa, value = self.parts(w)
        if not kappa > 0:
            raise NotProved("the two eigenvalues with sum 0 could be real: a neutral saddle")
        values, isolated = slopes.eigenvalues
        others = [number for number in values if not number.real.contains(0)]
        if not isolated or len(others) != self.rest.size - 2:
            raise NotProved("another eigenvalue could be on the imaginary axis")
        omega = kappa.sqrt()
        q = acb_mat([[acb(re, omega * im)] for re, im in zip(a, b, strict=True)])
        crossing, lyapunov = _normal_form(self.rest, x, self.rest.parameters(value), slopes, q, omega, self.c)
        for ball, name in ((crossing, "speed d Re lambda / dp"), (lyapunov, "first Lyapunov coefficient")):
            if ball.contains(0):
                raise NotProved(f"its {name} could be 0: {ball.str(5)}")
        known = {"frequency": wide(omega), "crossing": wide(crossing), "lyapunov": wide(lyapunov)}
        criticality = "supercritical" if lyapunov < 0 else "subcritical"
        return replace(part, vector=tuple(self.c.tolist()), known=known, criticality=criticality)


def _along(c: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """a with c.a = 1, parallel in sizes."""
    return np.asarray(c * sizes**2 / np.sum((c * sizes) ** 2))


_theorems: Mapping[str, type[_RestTheorem]] = {"": _RestTheorem, "fold": _FoldTheorem, "hopf": _HopfTheorem}
"""By the event"""


def prove_equilibria(
    equilibria: Equilibria, model: Model | None = None, progress: Progress | None = None
) -> ProvedEquilibria:
    """The proof that each equilibrium, fold and Hopf point exists, or why there is none. Needs the extra `[proof]`.

    In a box about each there is exactly 1 zero of f = 0, or of f = 0 with the eigenvectors that make it singular;
    eigenvalues, stability, frequency, crossing and first Lyapunov coefficient are enclosed.

    Args:
        equilibria: what is to be proved.
        model: needed only for systems that no file describes.
        progress: called with what is being done.

    Returns:
        ProvedEquilibria: of each point, fold and Hopf point `proved`, `reason`, enclosures.

    Raises:
        InputError: for curves in two parameters, and systems whose equations cannot be enclosed.

    Examples:
        >>> proof = of.prove_equilibria(equilibria)
        >>> proof.proved, proof.parts[-1].criticality
        (True, 'supercritical')
    """
    if equilibria.curve:
        raise InputError("equilibria: curves in two parameters are not proved; give equilibria along a parameter")
    points = [_Claim("", k, point.state, point.value) for k, point in enumerate(equilibria.points)]
    events = [
        _Claim(event.kind, k, event.state, event.parameter, (), event.frequency)
        for k, event in enumerate(equilibria.events) if event.kind in _theorems
    ]  # fmt: skip
    kinds = tuple(event.kind for event in equilibria.events)
    empty = ProvedEquilibria(equilibria.name, equilibria.system, equilibria.parameter, kinds)
    return _concluded(empty, model or provable_system(equilibria.system), [*points, *events], progress, MARGIN, DIGITS)


def proving(asked: Table) -> Proving:
    """How equilibria are proved. Raises `InputError` for options."""
    refuse(asked, "is for orbits and families; equilibria are proved whole")
    return Proving(
        prove_equilibria, lambda proof: {"proved": proof.proved, **entries_of(proof)}, CODEC,
        "FILE: equilibria and others together; prove them by a command each", named=False,
    )  # fmt: skip


def replay(path: Path, trusted: Path | None, progress: Progress) -> tuple[ProvedEquilibria, list[str], str]:
    """The proof in an equilibria-proof.json done again (see `Kind.replay`)."""
    recorded = CODEC.load(path)
    fresh, wrong = replay_equilibria(recorded, provable_system(recorded.system, trusted), progress)
    events = sum(bool(part.event) for part in fresh.parts)
    return fresh, wrong, f"{plural(len(fresh.parts) - events, 'point')}, {plural(events, 'event')}"


def replay_equilibria(
    recorded: ProvedEquilibria, model: Model | None = None, progress: Progress | None = None
) -> tuple[ProvedEquilibria, list[str]]:
    """The proof done again from its record alone, and every recorded claim that it does not prove."""
    compared = {
        **dict.fromkeys(("event", "stability", "criticality", "vector"), operator.eq),
        "radius": at_least,
        "contraction": bounding,
        "value": holds,
        "state": lambda old, new: holds(list(old), list(new)),
        "eigenvalues": lambda old, new: holds_each([*map(list, old)], [*map(list, new)]),
        "known": _named,
    }
    claims = [part for part in recorded.parts if part.proved]
    stated = []
    for part in claims:
        try:
            state, value = [float(ball["value"]) for ball in part.state], float((part.value or {})["value"])
            frequency = float(((part.known or {}).get("frequency") or {"value": "nan"})["value"])
        except (KeyError, TypeError, ValueError):
            state, value, frequency = [], 0.0, 0.0
        stated.append(_Claim(part.event, part.index, np.array(state), value, part.vector, frequency))
    fresh = _concluded(recorded, model or provable_system(recorded.system), stated, progress, 1.0, 2 * DIGITS)
    points = sum(not part.event for part in recorded.parts)
    numbers = [*range(points), *(k for k, kind in enumerate(recorded.events) if kind in _theorems)]
    of_points = None if recorded.events else points  # older files do not say which events there were
    wrong = []
    for old, new in zip(claims, fresh.parts, strict=True):
        faults = [name for name, same in compared.items() if not same(getattr(old, name), getattr(new, name))]
        said = new.reason if not new.proved else f"{', '.join(faults)}: recorded otherwise" if faults else ""
        wrong += [f"{old.place}: {said}"] if said else []
    if [part.index for part in recorded.parts][:of_points] != numbers:
        wrong.append("index: the parts are not numbered as the points and events are")
    return fresh, wrong


def _concluded(
    about: ProvedEquilibria, model: Model, stated: Sequence[_Claim], progress: Progress | None, *written: Any
) -> ProvedEquilibria:
    """What can be proved of each, its balls `written` with a margin and so many digits."""
    began, say, parts = time.perf_counter(), progress or silent, list[ProvedRest]()
    with precision(BITS):
        rest = _Rest(model, about.parameter)
        for what in stated:
            part = ProvedRest(what.event, what.index)
            try:
                part = _part(rest, what, *written)
            except (NotProved, ZeroDivisionError, ValueError) as error:
                part = replace(part, reason=why_not(error))
            parts.append(part)
            if part.event or not part.proved:
                say(f"{part.place}: {'proved' if part.proved else f'not proved: {part.reason}'}")
    return timed(replace(about, parts=tuple(parts)), began)


def _part(rest: _Rest, what: _Claim, margin: float, digits: int) -> ProvedRest:
    """An equilibrium, a fold or a Hopf point, proved. Raises `NotProved`."""
    model, d = rest.model, rest.size
    if what.event not in _theorems or what.state.shape != (d,) or (what.c and len(what.c) != d):
        raise NotProved("the record does not fit its system")
    sizes = state_sizes(model, np.abs(what.state))
    size = parameter_sizes(model, [model.parameter_names[rest.at]], np.array([what.value]))
    given, fixed = [arb(float(number)) for number in what.state], decimal(what.value)
    slopes = floats(rest.slopes(given, rest.parameters(fixed))[0])
    theorem = _theorems[what.event].about(rest, what, _Near(sizes, size, slopes))
    w, box, contraction = theorem.proved()
    x, _, _, _, value = theorem.parts(w)
    apart = [(ball - number) / float(unit) for ball, number, unit in zip(x, given, sizes, strict=True)]
    distance = magnitude([*apart, (value - fixed) / float(size[0])])
    if not distance <= Options.nearness:
        raise NotProved(f"there is such a point, but not within {Options.nearness:g} of the record: up to "
                        f"{distance:.3g} away, in the sizes of the state and the parameter")  # fmt: skip
    linear = Slopes(*rest.slopes(x, rest.parameters(value)))

    def wide(ball: Any, unit: float = 0.0) -> Entries:
        unit = unit or float(abs(ball.mid()))
        return enclosure(ball + arb(0, (margin - 1.0) * LEAST * unit), digits, margin)

    pace = max((float(abs(number).mid()) for number in linear.eigenvalues[0]), default=0.0)
    part = ProvedRest(
        what.event, what.index, True, "", box, contraction, wide(value, float(size[0])),
        tuple(wide(ball, float(unit)) for ball, unit in zip(x, sizes, strict=True)),
        tuple((wide(number.real, pace), wide(number.imag, pace)) for number in linear.eigenvalues[0]),
    )  # fmt: skip
    return theorem.concluded(part, w, linear, wide)


def _stability(rest: _Rest, values: Sequence[Any], x: Vector, value: Any) -> str:
    """By the eigenvalues (Lyapunov's first method), or where these are on the axis by the energy, which is a Lyapunov
    function where its second derivatives are definite."""
    if all(number.real < 0 for number in values):
        return "asymptotically stable"
    if any(number.real > 0 for number in values):
        return "unstable"
    if rest.energy is not None:
        bend = dense(rest.energy.run([x, rest.parameters(value)], BALLS)[0], rest.size, rest.size)
        if positive_definite(bend) or positive_definite(-bend):
            return "stable"
    return "open"


def _normal_form(
    rest: _Rest, x: Vector, p: Vector, slopes: Slopes, q: Any, omega: Any, c: np.ndarray
) -> tuple[Any, Any]:
    """d Re lambda / dp and the first Lyapunov coefficient of a Hopf point, <q, q> = <p, q> = 1.

    The left vector w, (J - i omega)^T w = 0, is that of the bordered equations (J - i omega)^T w + c mu = 0, q0.w = 1
    with q0 near q: times q^T they say that mu = 0, because c.q = 1.
    """
    d, turn, matrix, unit = rest.size, acb(0, omega), acb_mat(slopes.jacobian), acb_mat(identity(rest.size))
    shifted = (matrix - turn * unit).transpose().tolist()
    last = [entry.mid() for entry in q.entries()]
    rows = [[*row, acb(number)] for row, number in zip(shifted, c.tolist(), strict=True)] + [[*last, acb(0)]]
    w = acb_mat(rows).solve(acb_mat(d + 1, 1, [0] * d + [1])).entries()[:d]

    def along(vector: Sequence[Any]) -> Any:
        return sum((left * right for left, right in zip(w, vector, strict=True)), acb(0))

    def solved(of: Any, right: Sequence[Any]) -> Any:
        return of.solve(acb_mat(d, 1, list(right)))

    weight, squared = along(q.entries()), sum((abs(entry) ** 2 for entry in q.entries()), arb(0))
    conjugate = acb_mat(d, 1, [entry.conjugate() for entry in q.entries()])
    zero = acb_mat(d, 1)
    away = solved(matrix, [-acb(number) for number in slopes.by_value])
    crossing = (along(rest.complex("moving", x, p, q, zero, zero, away)) / weight).real
    mean = solved(matrix, rest.complex("second", x, p, q, conjugate))
    double = solved(2 * turn * unit - matrix, rest.complex("second", x, p, q, q))
    cubic = rest.complex("third", x, p, q, q, conjugate)
    straight, swinging = (rest.complex("second", x, p, *pair) for pair in ((q, mean), (conjugate, double)))
    whole = along(cubic) - 2 * along(straight) + along(swinging)
    return crossing, (whole / weight).real / (2 * omega * squared)


def _named(recorded: Table | None, fresh: Table | None) -> bool:
    """Whether every named ball is inside what is recorded."""
    old, new = recorded or {}, fresh or {}
    return old.keys() == new.keys() and all(holds(old[key], new[key]) for key in new)
