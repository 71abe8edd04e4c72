"""Prove that a recorded orbit exists: from orbit to verdict, box, period, multipliers.

docs/proof.md states and proves the theorem; this module checks its hypotheses in turn.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError, plural
from orbitfinder.loops.symmetry import ALONE, NONE, Symmetry, named
from orbitfinder.mechanics.kind import build_model, system_kind
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import Vector, Versioned, arb, decimal, magnitude, midpoints, precision, radius, why_not
from orbitfinder.proof.closures import AJAR, closable, closing, comes_back
from orbitfinder.proof.enclosure import TaylorSettings
from orbitfinder.proof.field import Programs, make_field, programs
from orbitfinder.proof.formulation import Approach, Formulation, approach
from orbitfinder.proof.gaits import begun, course
from orbitfinder.proof.invariance import has_symmetry, turns_leave, usable_symmetry
from orbitfinder.proof.krawczyk import Krawczyk, TheoremEquations, krawczyk, solve
from orbitfinder.proof.trajectory import (
    Stability,
    Trajectory,
    horizon,
    minimal_period,
    monodromy,
    moves,
    positive_mass,
    reduced,
    stability,
    trajectory,
)
from orbitfinder.records.codec import Codec
from orbitfinder.records.orbit import Orbit, refuse_controlled
from orbitfinder.records.reading import Entries, Table
from orbitfinder.records.registry import load

STATEMENT = 1
"""version of the theorem in docs/proof.md that a record refers to"""
RADII = (1e-11, 1e-13, 1e-15)
"""of the boxes that are tried; the smaller ones are for very unstable orbits"""
SHARPENINGS = 2
"""further rounds when the first leaves the multipliers open, and again when it leaves a recorded ball unproved"""
CENTRE = 1e-19
"""Newton's last correction before the box is set"""
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Proof(Shown, Versioned):
    """What was proved of one orbit, or why nothing was.

    `radius` of the box X of unknowns about `nodes` (N x d balls, K(X)) in which exactly one orbit of
    this symmetry and energy exists; `contraction` bounds the norm of 1 - C DF(X); `period` (s) and
    `state` (d, the first node) are enclosures of that orbit; `distance` bounds how far the recorded
    state is from it and `period_distance` (s) the recorded period from the enclosed one.
    """

    __repr__ = brief("proved", "reason", "symmetry", "radius", "contraction")

    proved: bool
    reason: str
    symmetry: str
    settings: TaylorSettings
    wall_time: float
    segments: int = 0
    steps: int = 0
    radius: float = np.nan
    tightness: float = np.nan
    contraction: float = np.nan
    energy: Any = None
    period: Any = None
    phase: float = 0.0
    nodes: list[Vector] = field(default_factory=list)
    unfolding: Any = None
    distance: float = np.nan
    period_distance: float = np.nan
    minimal: bool = False
    divisors: int = 0
    stability: Stability | None = None

    @property
    def state(self) -> Vector:
        """The first node (d balls)."""
        return self.nodes[0]

    @property
    def words(self) -> list[tuple[str, str]]:
        """What is proved, line by line."""
        assert self.stability is not None
        what = "orbit" if self.symmetry == "none" else f"{self.symmetry} orbit"
        there = "" if self.energy is None else " of this energy"
        taken = f"{plural(self.segments, 'segment')}, {plural(self.steps, 'step')}"
        return [
            ("box", f"exactly one {what}{there} within {self.radius:.2g} of the nodes"),
            ("period", f"{self.period.str(20)} s, minimal"),
            ("distance", f"record within {self.distance:.1g} of the orbit, period within {self.period_distance:.1g} s"),
            (
                "contraction",
                f"{self.contraction:.2g} ({taken}, order {self.settings.order}, {self.settings.bits} bits)",
            ),
            ("stability", f"{self.stability.verdict}: {self.stability.reason}"),
            *(("multiplier", mu.str(12)) for mu in self.stability.multipliers),
        ]


class NotProved(Exception):
    """A hypothesis of the theorem that could not be checked; its message is the reason."""


UNPROVED = NotProved, IntegrationError, ConvergenceError, ZeroDivisionError
"""What ends an attempt at a proof"""


def silent(line: str) -> None:
    """Progress that nobody asked for."""


@dataclass(frozen=True)
class Options(TaylorSettings):
    """What to prove and how: the integrator's settings, the symmetry to use (that of the record if None), segments.

    `phase` says which of two symmetric instants is the first node (see `Approach`); `nearness` is the largest distance
    allowed between the record and the proved orbit (rad, rad/s, s).
    """

    symmetry: str | None = None
    segments: int | None = None
    phase: float | None = None
    nearness: float = 1e-9
    begun: tuple[np.ndarray, float] | None = None
    """nodes (N x d) and period (s) to begin with, where they are known and no section is asked for"""


def checked(options: Options) -> Options:
    """The same options, or `InputError` naming the one that is out of range."""
    for name, value, low, high in (
        ("order", options.order, 10, 120), ("bits", options.bits, 64, 2000),
        ("segments", 1 if options.segments is None else options.segments, 1, 100),
    ):  # fmt: skip
        if not low <= value <= high:
            raise InputError(f"{name}: must be from {low} to {high}, got {value}; the default is fine for most orbits")
    if not 1e-40 <= options.tolerance < 1e-6:
        raise InputError(f"tolerance: must be from 1e-40 to 1e-6, got {options.tolerance}; the default is 1e-17")
    return options


def chosen_options(asked: Table, **usual: float) -> Options:
    """Those that are asked for by their names, or else the usual. Raises `InputError`."""
    known = vars(Options())
    return checked(
        Options(**usual | {name: asked[name] for name in asked if name in known and asked[name] is not None})
    )


def refuse(asked: Table, why: str, *taken: str) -> None:
    """`InputError` for an option that is asked for and not taken."""
    for name, value in asked.items():
        if value is not None and name not in taken:
            raise InputError(f"--{name}: {why}, leave it out")


@dataclass(frozen=True)
class Proving:
    """How records are proved as is asked.

    Args:
        prove: (record, model, progress) -> the proof.
        document: (proof) -> its entries in the answer.
        codec: of the proof's own file.
        alone: why more files, or without `file` other kinds beside, are refused.
        read: (path) -> the record.
        file: the name of the proof's file, if it is not made of that of the record's.
        part: of the record that is proved.
        named: whether progress says which record it is about.
        check: (path) -> None; refuses to write over what is there.
    """

    prove: Callable[[Any, Model, Progress], Any]
    document: Callable[[Any], Entries]
    codec: Codec[Any] | None = None
    alone: str = ""
    read: Callable[[Path], Any] = load
    file: str = ""
    part: str = ""
    named: bool = True
    check: Callable[[Path], None] | None = None


def prove(
    orbit: Orbit, model: Model | None = None, options: Options | None = None, progress: Progress | None = None
) -> Proof:
    """The proof that an orbit exists, or the reason why there is none. Needs the extra `[proof]`.

    In a box of radius 1e-11 there is exactly one periodic orbit of that energy and symmetry: Krawczyk's operator over
    integrals enclosed by Taylor models. Its minimal period and multipliers are enclosed too.

    Args:
        orbit: what is to be proved.
        model: needed only for systems that no file describes.
        options: symmetry, segments, precision.
        progress: called with what is being done.

    Returns:
        A Proof: `proved`, `reason`, enclosures of `period` and `state`, what follows about stability.

    Raises:
        InputError: for a system whose equations cannot be enclosed.

    Examples:
        >>> proof = of.prove(orbit)
        >>> proof.proved, proof.symmetry
        (True, 'brake+reflection')

    See Also:
        `of.certify` needs no interval arithmetic.
    """
    return proved_until(lambda proof: True, orbit, model, options or Options(), progress)


def proved_until(
    enough: Callable[[Proof], bool], orbit: Orbit, model: Model | None, options: Options, progress: Progress | None
) -> Proof:
    """The proof, its enclosures made smaller until they are `enough`, `SHARPENINGS` times at most."""
    began, say = time.perf_counter(), progress or silent
    model = model or provable_model(orbit)
    if not model.smooth:
        if options.symmetry not in (None, "none"):
            raise InputError(
                f"symmetry: orbits with events are proved without any, not {options.symmetry!r}; leave it out"
            )
        return _until_proved(lambda: _prove_gait(orbit, model, options, say, enough), ALONE.name, options, began)
    codes = programs(model, True)
    with precision(options.bits):
        symmetry = chosen_symmetry(orbit, model, codes, options.symmetry)
    return _until_proved(
        lambda: _prove(orbit, model, codes, symmetry, options, say, enough), symmetry.name, options, began
    )  # fmt: skip


def _until_proved(proved: Callable[[], Proof], symmetry: str, options: Options, began: float) -> Proof:
    """A proof, or the reason why there is none."""
    with precision(options.bits):
        try:
            proof = proved()
        except UNPROVED as error:
            proof = Proof(False, why_not(error), symmetry, options, 0.0)
        return replace(proof, wall_time=time.perf_counter() - began)


def chosen_symmetry(orbit: Orbit, model: Model, codes: Programs, asked: str | None) -> Symmetry:
    """The symmetry that is asked for, or else what the equations provably have of the recorded one."""
    if codes.clock is not None:
        if asked not in (None, "none"):
            raise InputError(f"symmetry: orbits of driven systems are proved without any, got {asked!r}; leave it out")
        return ALONE if model.rates is not None else NONE
    if codes.closure is not None:
        asked = closable(orbit, model, codes, asked)
        return usable_symmetry(codes.rates, codes.energy, named(asked, model), model.degrees_of_freedom)
    if asked is not None:
        return named(asked, model)
    return usable_symmetry(codes.rates, codes.energy, named(orbit.symmetry, model), model.degrees_of_freedom)


def provable_model(orbit: Any, trusted: Path | None = None) -> Model:
    """The Model of an orbit, or of another record."""
    refuse_controlled(orbit, "prove")
    return provable_system(orbit.system, trusted)


def provable_system(system: Mapping[str, Any], trusted: Path | None = None) -> Model:
    """The Model of a system; of a chain in the formulation with the fewest operations."""
    quick = {"formulation": "recursive"} if system_kind(system).pendulum else {}
    return build_model({**system, **quick}, trusted)


def _prove(
    orbit: Orbit, model: Model, codes: Programs, symmetry: Symmetry, options: Options, say: Progress,
    enough: Callable[[Proof], bool],
) -> Proof:  # fmt: skip
    given = options.segments, options.phase, frequency(model, codes), options.begun
    start = closing(model, codes, approach(model, orbit, symmetry, *given))
    check_graph(codes, start.formulation, model)
    equations = make_equations(model, codes, start, level(orbit, codes))
    centre, rounds = solve(equations, unknowns_at(start), options, 1e-10)  # what is left of it is far less
    pieces = plural(start.formulation.segments, "segment")
    say(f"Newton settled in {plural(rounds, 'iteration')}; integrating {pieces} of a box")
    contracted = enclosed(lambda box: krawczyk(equations, box, options), centre, say)
    path, contraction, rounds = horizon(equations, contracted.image, contracted.arcs), contracted.contraction, 0
    contested = False
    coarse = replace(options, tolerance=max(options.tolerance, 1e-13), share=0.9)  # for the multipliers
    while True:
        if verdict(path).verdict != "open" or rounds > SHARPENINGS:
            try:
                proof = Proof(
                    True, "", symmetry.name, options, 0.0, steps=sum(len(arc[3]) for arc in contracted.arcs),
                    radius=radius(contracted.box), contraction=contraction, energy=equations.energy,
                    **conclusions(orbit, model, codes, path, start, options),
                )  # fmt: skip
                if rounds > 2 * SHARPENINGS or enough(proof):
                    return proof
                contested = True
            except NotProved:
                if rounds > SHARPENINGS:
                    raise
        say(f"multipliers or recorded balls open in a box of radius {radius(path.box):.1g}; once more in a smaller one")
        with precision(options.bits + 32 * rounds):
            path = trajectory(equations, path.box, finer(options, rounds) if rounds else coarse)
            if rounds and contested:
                contraction = min(contraction, krawczyk(equations, contracted.box, finer(options, rounds)).contraction)
        rounds += 1


def finer(options: Options, rounds: int) -> Options:
    """The integrator's settings in a further round."""
    return replace(options, order=options.order + 6 * rounds, tolerance=options.tolerance * 1e-6**rounds)


def _prove_gait(orbit: Orbit, model: Model, options: Options, say: Progress, enough: Callable[[Proof], bool]) -> Proof:
    """The proof of an orbit with events."""
    arcs = course(model)
    centre = arcs.solved(begun(orbit, arcs), options, CENTRE)
    say(f"Newton settled; integrating {plural(len(arcs.arcs), 'arc')} of a box")
    contracted = enclosed(lambda box: arcs.krawczyk(box, options)[0], centre, say)
    box, rounds = contracted.image, 0
    while True:
        with precision(options.bits + 32 * rounds):
            again, passed = arcs.krawczyk(box, finer(options, rounds))
            box = [x.intersection(y) for x, y in zip(box, again.image, strict=True)]
            parts = arcs.parts(box)
            if fault := arcs.fault(passed):
                raise NotProved(fault)
            if fewer := arcs.shorter(parts):
                raise NotProved(
                    f"an orbit closes after this period, but it could do so after {plural(fewer, 'arc')} too"
                )
            period = sum((part[-1] for part in parts), arb(0))
            distance = magnitude([x - float(y) for x, y in zip(parts[0][:-1], orbit.state, strict=True)])
            apart = magnitude([period - float(orbit.period)])
            check_near(distance, apart, options)
            proof = Proof(
                True, "", ALONE.name, options, 0.0, segments=len(parts), steps=sum(len(each.steps) for each in passed),
                radius=radius(contracted.box), contraction=contracted.contraction, tightness=radius(box), period=period,
                nodes=[part[:-1] for part in parts], distance=distance, period_distance=apart, minimal=True,
                divisors=len(parts), stability=arcs.verdict(passed),
            )  # fmt: skip
        assert proof.stability is not None
        if rounds >= 2 * SHARPENINGS or (
            enough(proof) and (proof.stability.verdict != "open" or rounds >= SHARPENINGS)
        ):
            return proof
        rounds += 1


def check_near(distance: float, apart: float, options: Options) -> None:
    """`NotProved` where an orbit is not that of the record."""
    if not max(distance, apart) <= options.nearness:
        raise NotProved(
            f"an orbit exists, but not within {options.nearness:g} of the record: "
            f"its state is up to {distance:.3g} away, its period up to {apart:.3g} s"
        )


def frequency(model: Model, codes: Programs) -> Any:
    """The frequency of what drives a system (rad/s) as a ball, None where nothing does."""
    return None if codes.clock is None else make_field(model, codes).frequency


def level(orbit: Orbit, codes: Programs) -> Any:
    """The recorded energy as a ball, None where none is conserved."""
    return None if codes.energy is None else decimal(orbit.energy)


def unknowns_at(start: Approach) -> Vector:
    """The approach's floats as exact unknowns."""
    return [arb(x) for x in start.formulation.unknowns_of(start.nodes, start.duration)]


def make_equations(model: Model, codes: Programs, start: Approach, energy: Any) -> TheoremEquations:
    """The theorem's equations; the section is normal to the flow at the first node."""
    sections = []
    if start.formulation.sectioned:
        sections = [(start.nodes[0].tolist(), start.flow.tolist())]
    return TheoremEquations(make_field(model, codes), start.formulation, energy, sections)


def check_graph(codes: Programs, form: Formulation, model: Model) -> None:
    """`NotProved` unless the symmetry used (and turns of angles, where they occur) follow from the graphs."""
    if not form.square:
        raise NotProved(f"{form.symmetry.name} does not fix the orbit in the state space of this system; use none")
    if not has_symmetry(codes.rates, codes.energy, form.symmetry, form.size):
        raise NotProved(f"the equations' {form.symmetry.name} symmetry could not be read off their graph; use none")
    shifts = {i: 2 * k for i, k in enumerate(form.turns) if k} | form.shifts
    turned = [*model.angles, *[False] * (form.dimension - len(model.angles))]
    if not all(turned[i] for i in shifts):
        raise NotProved("what is no angle would not come back but be elsewhere by a multiple of pi")
    odd = [] if form.symmetry.reverses else [i for i, k in shifts.items() if k % 2]  # about k pi time turns back
    if odd and form.symmetry.forward is None:
        raise NotProved("angles would come back but for half a turn")
    if shifts and not all(turns_leave(code, turned, odd) for code in codes.all):
        what, remedy = ("half", "; use none") if odd else ("whole", "")
        raise NotProved(f"the equations' invariance under {what} turns could not be read off their graph{remedy}")


def enclosed(operator: Callable[[Vector], Krawczyk], centre: Vector, say: Progress) -> Krawczyk:
    """K on the largest box on which it contracts."""
    reasons = []
    for size in RADII:
        try:
            contracted = operator([x + arb(0, size) for x in centre])
        except IntegrationError as error:
            reasons.append(f"radius {size:g}: {error}")
            continue
        verdict = "inside" if contracted.proved else "not inside"
        say(f"box of radius {size:g}: contraction {contracted.contraction:.2g}, {verdict}")
        if contracted.proved:
            return contracted
        reasons.append(f"radius {size:g}: contraction {contracted.contraction:.3g}")
    raise NotProved("the interval Newton operator maps no box into itself (" + "; ".join(reasons) + ")")


def certain(operator: Callable[[Vector], Krawczyk], box: Vector) -> tuple[Krawczyk, Krawczyk, Vector]:
    """K on a box and on its image, and where the zero is. Raises `NotProved` unless the box is mapped into itself."""
    first = operator(box)
    if not first.proved:
        raise NotProved("the interval Newton operator does not map the box into itself")
    again = operator(first.image)
    return first, again, [x.intersection(y) for x, y in zip(first.image, again.image, strict=True)]


def verdict(path: Trajectory) -> Stability:
    """The stability of an enclosed orbit."""
    form, matrix = path.formulation, monodromy(path)
    if form.drive is not None:
        return stability(matrix, path.field.symplectic)
    return stability(reduced(path, matrix), form.conserved)


def check_motion(path: Trajectory, model: Model, state: str, along: str) -> None:
    """`NotProved` where a state could be an equilibrium, time could go back, or what unfolds the energy need not push
    along the motion."""
    if not path.period > 0:
        raise NotProved("the period could be none, or negative")
    if not moves(path):
        raise NotProved(f"{state} could be an equilibrium")
    if path.formulation.unfolded and not path.box[-2].contains(0):
        raise NotProved("what unfolds the energy is not 0, so that the system does not conserve it")
    if path.formulation.unfolded and not model.hamiltonian and not positive_mass(path):
        raise NotProved(f"the mass matrix could not be shown to be positive definite along {along}")


def conclusions(
    orbit: Orbit, model: Model, codes: Programs, path: Trajectory, start: Approach, options: Options
) -> dict[str, Any]:
    """What follows from the zero: that it is an orbit, the recorded one, its period and multipliers."""
    form = start.formulation
    check_motion(path, model, "the state", "the orbit")
    if not comes_back(path):
        raise NotProved(AJAR)
    turned = [*model.angles, *[False] * (form.components - len(model.angles))]
    angles = turned if all(turns_leave(code, [*turned, False]) for code in codes.all) else []
    distance, apart, phase = gaps(orbit, path, start, angles)
    check_near(distance, apart, options)
    minimal, divisors, reason = minimal_period(path, model.angles)
    if not minimal:
        raise NotProved(f"an orbit closes after this period, but it could be a multiple of the minimal one: {reason}")
    return {
        "segments": form.segments, "period": path.period, "phase": phase,
        "tightness": radius(path.box),
        "nodes": [node[: form.components] for node in form.nodes(path.box)],
        "unfolding": path.box[-2] if form.unfolded else None,
        "distance": distance, "period_distance": apart, "minimal": minimal, "divisors": divisors,
        "stability": verdict(path),
    }  # fmt: skip


def gaps(orbit: Orbit, path: Trajectory, start: Approach, angles: Sequence[bool]) -> tuple[float, float, float]:
    """Upper bounds of the distances of the recorded state (rad, rad/s) and period (s) from the proved ones, and phase.

    The recorded state is compared with the orbit's (`angles`, which the equations are shown to have, modulo whole
    turns) at the phase at which it was recorded, corrected along the flow.
    """
    recorded, turn = [arb(float(x)) for x in orbit.state], 2 * arb.pi()
    d = path.formulation.components
    turning = [*angles, *([False] * (d - len(angles)))]

    def difference(phase: Fraction) -> Vector:
        raw = [a - b for a, b in zip(path.state(phase % 1), recorded, strict=path.formulation.drive is None)]
        whole = [round(float((x / turn).mid())) if angle else 0 for x, angle in zip(raw, turning, strict=True)]
        return [x - k * turn for x, k in zip(raw, whole, strict=True)]

    if start.phase is None:
        phase = min((Fraction(k, LOOKS) for k in range(LOOKS)), key=lambda k: magnitude(midpoints(difference(k))))
    else:
        phase = Fraction(start.phase)
    for _ in range(5 if path.formulation.drive is None else 0):  # a drive's phase is what it is
        apart = np.array([float(x.mid()) for x in difference(phase)])
        here = path.state(phase % 1)
        flow = np.array([float(x.mid()) for x in path.field.rates([*here, arb(0), arb(1)])[:d]])
        phase -= Fraction(nearest(apart, flow) / float(path.period.mid()))
    return magnitude(difference(phase)), magnitude([path.period - arb(float(orbit.period))]), float(phase % 1)


def nearest(apart: np.ndarray, flow: np.ndarray) -> float:
    """The time t at which the largest component of |apart - t flow| is least: there two of them are equal."""
    a, f = (np.subtract.outer(x, x).ravel() for x in (np.r_[apart, -apart], np.r_[flow, -flow]))
    times = np.append(a[f != 0] / f[f != 0], 0.0)
    return float(times[np.abs(apart - np.outer(times, flow)).max(axis=1).argmin()])


# --------------------------------------------------------------------------------------------------
# Many digits of an orbit: Newton at high precision, and the interval Newton theorem round the result.


GUARD, LOOKS = 8, 400
"""digits carried beyond those asked for; places of an orbit at which a recorded state is looked for"""


@dataclass(frozen=True)
class RefinedOrbit:
    """An orbit to many digits: its period (s) and first node (d) as balls.

    `enclosed` is True when exactly one orbit lies in the balls, False when they are only Newton's limit.
    `phase` is the fraction of the period by which the recorded state comes after the first node.
    """

    digits: int
    enclosed: bool
    reason: str
    symmetry: str
    energy: Any
    period: Any
    state: Vector
    phase: Fraction
    settings: TaylorSettings
    wall_time: float


def settings_for(digits: int, order: int | None = None, bits: int | None = None) -> TaylorSettings:
    """Order, precision and tolerance that reach so many digits.

    The order that costs least grows as -ln(tolerance) / 2: A. Jorba, M. Zou, Experimental
    Mathematics 14 (2005) 99-117, section 3.
    """
    if not 1 <= digits <= 250:
        raise InputError(f"digits: must be from 1 to 250, got {digits}; 50 are plenty for most purposes")
    wanted = digits + GUARD
    least = math.ceil(wanted * math.log2(10)) + 40
    if bits is not None and bits < least:
        raise InputError(f"bits: {digits} digits need at least {least}, got {bits}; leave it out")
    if order is not None and not 4 <= order <= 2000:
        raise InputError(f"order: must be from 4 to 2000, got {order}; leave it out")
    return TaylorSettings(order or max(20, math.ceil(wanted * math.log(10) / 2)), bits or least, 10.0**-wanted)


def refine(
    orbit: Orbit, settings: TaylorSettings, digits: int, model: Model | None = None,
    symmetry: str | None = None, enclose: bool = True, progress: Progress | None = None,
) -> RefinedOrbit:  # fmt: skip
    """An orbit refined at its recorded energy, read as the decimal that it is written as."""
    began, say = time.perf_counter(), progress or silent
    with precision(settings.bits):
        model = model or provable_model(orbit)
        codes = programs(model, True)
        chosen = chosen_symmetry(orbit, model, codes, symmetry)
        start = closing(model, codes, approach(model, orbit, chosen, None, frequency=frequency(model, codes)))
        equations = make_equations(model, codes, start, level(orbit, codes))
        rough = solve(equations, unknowns_at(start), TaylorSettings(), 1e-20)[0]
        centre, rounds = solve(equations, rough, settings, 10.0 ** -(digits + GUARD // 2))
        say(f"Newton settled in {plural(rounds, 'iteration')} at {settings.bits} bits, order {settings.order}")
        image, reason = centre, "not asked for"
        if enclose:
            try:
                check_graph(codes, start.formulation, model)
                box = [x + arb(0, 10.0 ** -max(digits - GUARD, 8)) for x in centre]
                again = krawczyk(equations, box, settings)
                image, reason = (again.image, "") if again.proved else (centre, f"contraction {again.contraction:.3g}")
                if again.proved:
                    path = horizon(equations, image, again.arcs)
                    check_motion(path, model, "the state", "the orbit")
                    reason = "" if comes_back(path) else AJAR
            except (IntegrationError, NotProved, ZeroDivisionError) as error:
                reason = why_not(error)
        if enclose and not reason and radius(image) > 10.0**-digits:
            reason = f"the enclosure is only good to {radius(image):.1g}"
        form = start.formulation
        node = form.nodes(image)[0]
        return RefinedOrbit(
            digits, enclose and not reason, reason, chosen.name, equations.energy,
            node[-1] * form.segments * form.parts, node[: form.components],
            Fraction(start.phase or 0), settings, time.perf_counter() - began,
        )  # fmt: skip
