"""Connections of orbits proved: transversal intersections of an unstable and a stable manifold.

About an orbit's point x* on a plane the local unstable manifold of the return map P is a curve with a slope that is
known: with DP in [a b; c d] in a basis (w, v) over |xi| <= r, |eta| <= r / 16, on the orbit's energy, and

    |c| + |d| L < L (|a| - |b| L),    |a| - |b| L > 1,    L r <= r / 16,

the manifold is a graph eta = h(xi) over |xi| <= r with |h'| <= L. The stable manifold is that of the motion backwards.
From a place xi on the former to xi' on the latter the flow is followed in segments; Krawczyk's operator acts on

    phi_t1(X_u(xi)) = x_1,   phi_t1(x_k) = x_k+1,   ...,   phi_t2(x_N-1) = X_s(xi'),   x_m on the record's plane.

A regular zero is a transversal intersection: docs/proof.md. Sources: P. Zgliczynski, J. Differential Equations 246
(2009) 1774-1819 (cone conditions); D. Wilczak, P. Zgliczynski, Commun. Math. Phys. 234 (2003) 37-75.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import eq
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.errors import InputError, plural
from orbitfinder.integrate.dop853 import SECOND
from orbitfinder.integrate.dop853 import integrate as integrated
from orbitfinder.integrate.equations import accelerations
from orbitfinder.integrate.field import vector_field
from orbitfinder.loops.symmetry import ALONE, NONE
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import (
    Vector,
    Versioned,
    arb,
    arb_mat,
    block,
    column,
    decimal,
    exact,
    floats,
    inside,
    midpoints,
    precision,
    radius,
    why_not,
)
from orbitfinder.proof.enclosure import TaylorSettings, Tube, cloud, integrate
from orbitfinder.proof.field import Field, make_field, programs
from orbitfinder.proof.formulation import Formulation
from orbitfinder.proof.krawczyk import (
    Krawczyk,
    TheoremEquations,
    approximate_inverse,
    contracted,
    corrected,
    flow,
    krawczyk,
    solve,
)
from orbitfinder.proof.record import (
    DIGITS,
    MARGIN,
    Same,
    bounding,
    contradictions,
    done_again,
    enclosure,
    holds,
    in_digits,
    timed,
)
from orbitfinder.proof.theorem import (
    CENTRE,
    UNPROVED,
    NotProved,
    Options,
    Progress,
    Proving,
    check_graph,
    check_motion,
    checked,
    chosen_options,
    enclosed,
    provable_system,
    refuse,
    silent,
)
from orbitfinder.proof.trajectory import (
    Trajectory,
    differs,
    monodromy,
    positive_definite,
    reduced,
    stability,
    trajectory,
)
from orbitfinder.records.codec import Codec, Unknown, plain
from orbitfinder.records.reading import Table

THIN, START, GROWTH, NEAR = 2.0**-4, 1e-10, 30.0, 1e-8
"""The box across a local manifold, of its length; how far from its orbit a motion begins, in the orbit's extents (the
slope is of that order); growth in a segment; how far the recorded crossing may be from the proved, in these extents"""


# --------------------------------------------------------------------------------------------------
# The record.


@dataclass(frozen=True)
class ProvedEnd:
    """An orbit that a connection leaves or comes to, and its local manifold, all by exact floats.

    `centre` are the unknowns of the orbit's equations, `anchor` (d) a point of the plane; `radius` that of the box;
    `frame` are rows: along the manifold, across it, and of systems with an energy across its surface; `reach` is the
    manifold's half length along the first, `slope` the bound L. `lap` (s) is the time of a return, negative of a stable
    manifold, and its `slack` (s). Balls: `period`, `multipliers`.
    """

    segments: int
    turns: tuple[int, ...]
    anchor: tuple[float, ...]
    centre: tuple[float, ...]
    radius: float
    frame: tuple[tuple[float, ...], ...] = ()
    reach: float = 0.0
    slope: float = 0.0
    lap: float = 0.0
    slack: float = 0.0
    period: Table = field(default_factory=dict)
    multipliers: tuple[tuple[Table, ...], ...] = ()


@dataclass(frozen=True)
class ConnectionRecord(Versioned):
    """A connection-proof.json: a single motion within `radius` of `centre` (exact floats) from an orbit to another.

    `component` is that of the plane, at `level`; `before` and `after` are the segments up to the crossing there and
    from it; `turns` those of the angles at the end. Balls are {"value": decimal, "radius": float}: `energy` as read,
    `state` (d) at the crossing, `places` on both local manifolds, in extents, `durations` before and after (s).
    """

    _entries = (..., "wall_time", "versions")

    name: str
    homoclinic: bool
    system: Table
    state_names: tuple[str, ...]
    component: int
    level: float
    energy: Unknown
    before: int
    after: int
    turns: tuple[int, ...]
    origin: ProvedEnd
    goal: ProvedEnd
    centre: tuple[float, ...] = ()
    radius: float = 0.0
    order: int = TaylorSettings.order
    bits: int = TaylorSettings.bits
    tolerance: float = TaylorSettings.tolerance
    proved: bool = False
    reason: str = ""
    contraction: float = np.nan
    state: tuple[Table, ...] = ()
    places: tuple[Table, ...] = ()
    durations: tuple[Table, ...] = ()
    wall_time: float = 0.0

    @property
    def settings(self) -> TaylorSettings:
        """The integrator's."""
        return TaylorSettings(self.order, self.bits, self.tolerance)

    @property
    def kind(self) -> str:
        """homoclinic or heteroclinic."""
        return "homoclinic" if self.homoclinic else "heteroclinic"

    @property
    def words(self) -> list[tuple[str, str]]:
        """What is proved, line by line."""
        what = "the unstable and the stable manifold of an orbit meet transversally"
        if not self.homoclinic:
            what = "the unstable manifold of an orbit and the stable manifold of another meet transversally"
        rows = [(self.kind, what)]
        named = enumerate(zip(self.state_names, self.state, strict=True))
        rows += [(name, in_digits(ball)) for k, (name, ball) in named if k != self.component]
        ends = {"orbit": self.origin} if self.homoclinic else {"from": self.origin, "to": self.goal}
        rows += [(name, f"period {in_digits(end.period)} s, multiplier {in_digits(end.multipliers[0][0])}")
                 for name, end in ends.items()]  # fmt: skip
        segments = plural(self.before + self.after, "segment")
        return [
            *rows,
            ("box", f"a single motion within {self.radius:.2g} of the nodes"),
            ("contraction", f"{self.contraction:.2g} ({segments}, order {self.order}, {self.bits} bits)"),
        ]


CODEC = Codec(ConnectionRecord, "connection-proof", "`orbitfinder prove CONNECTION.json`", "prove the connection again",
              sealed=True)  # fmt: skip


# --------------------------------------------------------------------------------------------------
# The theorem.


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


def _sum(parts: Sequence[tuple[Any, Sequence[Any]]]) -> Vector:
    """A combination of vectors."""
    return [sum((weight * vector[i] for weight, vector in parts), arb(0)) for i in range(len(parts[0][1]))]


@dataclass(frozen=True)
class LocalManifold:
    """The curve X(xi) = x* + xi w + h(xi) v + e u in a plane at an energy, |h'| <= `slope` over |xi| <= `reach`.

    `point` is x* (d balls), `frame` w, v and, where an energy is conserved, u; `gradient` of the energy over the box.
    """

    point: Vector
    frame: Sequence[Vector]
    gradient: Vector | None
    reach: float
    slope: float = 0.0

    @cached_property
    def directions(self) -> list[Vector]:
        """What w and v are between two states of the box at the same energy, u taken along."""
        if self.gradient is None:
            return list(self.frame[:2])
        across = _dot(self.gradient, self.frame[2])
        leans = [-_dot(self.gradient, vector) / across for vector in self.frame[:2]]
        return [_sum([(arb(1), vector), (lean, self.frame[2])])
                for lean, vector in zip(leans, self.frame, strict=False)]  # fmt: skip

    def at(self, xi: Any) -> Vector:
        """X (d) at a place."""
        moved = _sum([(xi, self.directions[0]), (xi * arb(0, self.slope), self.directions[1])])
        return [x + dx for x, dx in zip(self.point, moved, strict=True)]

    def tangent(self) -> Vector:
        """X' (d) anywhere."""
        return _sum([(arb(1), self.directions[0]), (arb(0, self.slope), self.directions[1])])

    def box(self) -> Vector:
        """The box (d) over which the return map is looked at."""
        widths = [arb(0, self.reach), *[arb(0, self.reach * THIN)] * (len(self.frame) - 1)]
        moved = _sum(list(zip(widths, self.frame, strict=True)))
        return [x + dx for x, dx in zip(self.point, moved, strict=True)]


def shaped(law: Field, end: ProvedEnd, path: Trajectory, component: int) -> LocalManifold:
    """The local manifold of an enclosed orbit, its box, not yet its slope. Raises `NotProved`."""
    d = path.formulation.dimension
    frame = [list(map(arb, row)) for row in end.frame]
    if any(row[component] != 0 for row in end.frame):
        raise NotProved("frame: not in the plane")
    shape = LocalManifold(path.first[:d], frame, None, end.reach)
    if not path.formulation.conserved:
        return shape
    shape = replace(shape, gradient=law.energy([*shape.box(), arb(0), arb(1)])[1])
    assert shape.gradient is not None
    across = _dot(shape.gradient, frame[2])
    leans = [abs(_dot(shape.gradient, vector) / across) for vector in frame[:2]]
    if across.contains(0) or not leans[0] * end.reach + leans[1] * end.reach * THIN < end.reach * THIN:
        raise NotProved("the states of the orbit's energy near it could not be shown to be a surface over its plane")
    return shape


def return_slopes(
    law: Field, shape: LocalManifold, end: ProvedEnd, path: Trajectory, component: int, settings: TaylorSettings
) -> Any:  # fmt: skip
    """DP (2 x 2) over the box in the basis (w, v), of the return after a lap. Raises `NotProved`."""
    d, sense = path.formulation.dimension, math.copysign(1.0, end.lap)
    early = 2 * sense * arb(end.slack)  # most of the lap takes an exact time
    lap, rest = arb(end.lap) - early, early + arb(0, end.slack)
    if not (lap + rest).contains_interior(sense * path.period):
        raise NotProved("the orbit's own return could be at another time")
    near, _ = integrate(law, cloud([*shape.box(), arb(0), lap], [*midpoints(shape.point), arb(0), lap]), settings)
    states = near.hull[:d]
    centre = midpoints(states)
    passed, _ = integrate(law, cloud([*states, arb(0), rest], [*centre, arb(0), early]), settings)
    moved, rates = passed.derivatives.tolist(), law.rates([*passed.hull[:d], arb(0), arb(1)])
    own, turn = moved[component], 2 * sense * arb.pi() * ([*end.turns, *[0] * d][component])
    rate = rates[component]
    gap = passed.point[component] - shape.point[component] - turn
    gap += _dot(own[:d], [x - c for x, c in zip(states, centre, strict=True)])
    if rate.contains(0) or not inside([rest - early], [-gap / rate]):
        raise NotProved("the return to the plane could not be enclosed; the motion may touch it")
    back = arb_mat(
        [[line[j] - speed * own[j] / rate for j in range(d)] for line, speed in zip(moved, rates, strict=False)]
    )
    start = arb_mat(d, 2, [vector[i] for i in range(d) for vector in shape.directions])
    images = back * (block(near.derivatives, d, 0, d) * start)
    across = midpoints(law.rates(path.first)[:d])
    basis = arb_mat(d, d, [vector[i] for i in range(d) for vector in (*shape.frame, across)])
    try:
        return arb_mat(basis.solve(images).tolist()[:2])
    except ZeroDivisionError as error:
        raise NotProved("frame: its vectors and the motion's direction are no basis") from error


def cone(slopes: Any) -> float:
    """A bound L for which the cone condition should hold."""
    a, _, c, d = (abs(x) for x in slopes.entries())
    gain = float(a.lower()) - float(d.upper())
    return math.nextafter(2 * float(c.upper()) / gain, math.inf) if gain > 0 else math.inf


def check_cone(slopes: Any, shape: LocalManifold) -> None:
    """`NotProved` unless the cone of the shape's slope is mapped into itself and stretched."""
    a, b, c, d = (abs(x) for x in slopes.entries())
    bound = arb(shape.slope)
    if not (0 < shape.slope <= THIN and c + d * bound < bound * (a - b * bound) and a - b * bound > 1):
        raise NotProved("the local manifold could not be enclosed: no cone is mapped into itself and stretched")


@dataclass(frozen=True)
class ConnectingEquations:
    """F(u) = 0 of the places on both manifolds, the nodes between them, s where an energy is conserved, and the
    segments' durations before and after the crossing of the plane."""

    field: Field
    origin: LocalManifold
    goal: LocalManifold
    before: int
    after: int
    component: int
    level: float
    turns: Sequence[int]

    @property
    def dimension(self) -> int:
        """d, components of the state."""
        return self.field.dimension

    @property
    def segments(self) -> int:
        """N, of the whole motion."""
        return self.before + self.after

    @property
    def unfolded(self) -> bool:
        """Whether s is an unknown."""
        return self.origin.gradient is not None

    @property
    def unknowns(self) -> int:
        """Number of unknowns, and of equations."""
        return self.dimension * self.segments + 1

    def parts(self, unknowns: Vector) -> list[Vector]:
        """x_1 .. x_N-1 (d each)."""
        d = self.dimension
        return [unknowns[1 + d * k : 1 + d * (k + 1)] for k in range(self.segments - 1)]

    def last(self, unknowns: Vector) -> Any:
        """The place on the goal's manifold."""
        return unknowns[1 + self.dimension * (self.segments - 1)]

    def nodes(self, unknowns: Vector) -> list[Vector]:
        """The extended states z (d + 2) at the nodes."""
        s = unknowns[-3] if self.unfolded else arb(0)
        states = [self.origin.at(unknowns[0]), *self.parts(unknowns)]
        return [[*x, s, unknowns[-2 if k < self.before else -1]] for k, x in enumerate(states)]

    def residual(self, unknowns: Vector, ends: Sequence[Vector]) -> Vector:
        """F from the segments' ends (d each)."""
        rows, parts = list[Any](), self.parts(unknowns)
        whole = [2 * arb.pi() * k for k in self.turns] + [arb(0)] * (self.dimension - len(self.turns))
        aims = [*parts, [x + k for x, k in zip(self.goal.at(self.last(unknowns)), whole, strict=True)]]
        for end, aim in zip(ends, aims, strict=True):
            rows += [a - b for a, b in zip(end, aim, strict=True)]
        return [*rows, parts[self.before - 1][self.component] - self.level]

    def jacobian(self, derivatives: Sequence[Any]) -> Any:
        """DF from the segments' derivatives (d x d+2 each)."""
        d, count = self.dimension, self.unknowns
        rows = [[arb(0)] * count for _ in range(count)]
        first, last = self.origin.tangent(), self.goal.tangent()
        for k, matrix in enumerate(derivatives):
            for i, line in enumerate(matrix.tolist()):
                row = rows[d * k + i]
                if k:
                    row[1 + d * (k - 1) : 1 + d * k] = line[:d]
                else:
                    row[0] = _dot(line[:d], first)
                row[-2 if k < self.before else -1] = line[d + 1]
                if self.unfolded:
                    row[-3] = line[d]
                if k < self.segments - 1:
                    row[1 + d * k + i] = arb(-1)
                else:
                    row[1 + d * k] = -last[i]
        rows[-1][1 + d * (self.before - 1) + self.component] = arb(1)
        return arb_mat(rows)

    def solved(self, start: Vector, settings: TaylorSettings, target: float) -> Vector:
        """Unknowns whose last correction is below a target. Raises `ConvergenceError`."""
        law = TheoremEquations(self.field, Formulation(ALONE, self.dimension, 1, (), (), False), None)

        def step(here: Vector) -> Any:
            passed = [flow(law, node, settings, vary=True) for node in self.nodes(here)]
            values = midpoints(self.residual(here, [end for end, _ in passed]))
            return exact(approximate_inverse(floats(self.jacobian([matrix for _, matrix in passed])))) * column(values)

        return corrected(step, start, target, "connection")

    def around(self, centre: Sequence[float], size: float) -> Vector:
        """The box of a half width about a centre; places stay on the parts of both manifolds that are enclosed."""
        box, last = [arb(c, size) for c in centre], 1 + self.dimension * (self.segments - 1)
        for k, shape in ((0, self.origin), (last, self.goal)):
            box[k] = arb(centre[k], min(size, shape.reach / 4))
        return box

    def krawczyk(self, box: Vector, settings: TaylorSettings) -> tuple[Krawczyk, list[list[Tube]]]:
        """The operator over a box, and the steps of each segment from it. Raises `NotProved` where a manifold ends."""
        centre = midpoints(box)
        for place, shape in ((box[0], self.origin), (self.last(box), self.goal)):
            if place.contains(0) or not abs(place) <= shape.reach:
                raise NotProved("a place could be the orbit's own, or beyond the part of the manifold that is enclosed")
        passed = [integrate(self.field, cloud(node, point), settings)
                  for node, point in zip(self.nodes(box), self.nodes(centre), strict=True)]  # fmt: skip
        values = self.residual(centre, [end.point for end, _ in passed])
        image, contraction = contracted(values, self.jacobian([end.derivatives for end, _ in passed]), box)
        return Krawczyk(image, box, contraction, inside(box, image), []), [steps for _, steps in passed]


@dataclass
class _ConnectionProof:
    """A connection being proved: what its record states, and the ends that are enclosed."""

    about: ConnectionRecord
    model: Model
    say: Progress

    def __post_init__(self) -> None:
        model = self.model
        self.codes = programs(model)
        if self.codes.clock is not None or not model.smooth:
            raise InputError(
                "system: connections of autonomous smooth systems are proved, and this is driven or has events"
            )
        self.field = make_field(model, self.codes)
        self.symmetry = ALONE if model.rates is not None else NONE
        self.conserved = bool(model.invariants)
        self.paths, self.shapes = dict[Any, Trajectory](), dict[Any, tuple[LocalManifold, list[Any]]]()
        d = self.field.dimension
        if d != 3 + int(self.conserved):
            raise InputError(
                f"system: its states have {d} components; connections are proved in 3, or in 4 with an energy"
            )

    def check_sizes(self) -> None:
        """`InputError` unless what the record holds is as long as the system asks for."""
        about, d, rows = self.about, self.field.dimension, 2 + int(self.conserved)
        angles, known = len(self.model.angles), {"centre": len(about.centre) == d * (about.before + about.after) + 1}
        known["component"], known["turns"] = (
            0 <= about.component < d and tuple(about.state_names) == tuple(self.model.state_names),
            len(about.turns) == angles,
        )
        for name, end in (("origin", about.origin), ("goal", about.goal)):
            wide = (len(end.anchor), len(end.turns), np.shape(end.frame), len(end.centre))
            known[name] = wide == (d, angles, (rows, d), self.orbit(end).formulation.unknowns)
        if wrong := [name for name, fits in known.items() if not fits]:
            raise InputError(f"{wrong[0]}: does not fit the system; {CODEC.again}")

    @cached_property
    def energy(self) -> Any:
        """The level as a ball, None where nothing is conserved."""
        return decimal(self.about.energy) if self.conserved else None

    def orbit(self, end: ProvedEnd) -> TheoremEquations:
        """The equations of an end's orbit, in the plane."""
        n = self.model.degrees_of_freedom
        constants = [2 * k for k in end.turns] + [0] * (len(self.model.state_names) - len(end.turns))
        form = Formulation(self.symmetry, n, end.segments, tuple(constants), tuple(end.turns), self.conserved)
        normal = [float(i == self.about.component) for i in range(form.dimension)]
        return TheoremEquations(self.field, form, self.energy, [(list(end.anchor), normal)])

    def enclosed_orbit(self, end: ProvedEnd) -> Trajectory:
        """An end's orbit from its record, enclosed once. Raises `NotProved`."""
        key = self.about.energy, end.segments, end.turns, end.anchor, end.centre, end.radius
        if key in self.paths:
            return self.paths[key]
        equations, settings = self.orbit(end), self.about.settings
        first = krawczyk(equations, [arb(c, end.radius) for c in end.centre], settings)
        if not first.proved:
            raise NotProved("an orbit's box is not mapped into itself")
        path = trajectory(equations, first.image, settings)
        check_motion(path, self.model, "an orbit", "an orbit")
        self.paths[key] = path
        return path

    def check_push(self, steps: Sequence[Sequence[Tube]]) -> None:
        """`NotProved` unless what unfolds the energy changes it the same way all along a motion."""
        if not self.conserved or self.model.hamiltonian:
            return
        if not all(positive_definite(self.field.mass(step.reach)) for part in steps for step in part):
            raise NotProved("the mass matrix could not be shown to be positive definite along the motion")

    def manifold(self, end: ProvedEnd, path: Trajectory) -> tuple[LocalManifold, list[Any]]:
        """An end's local manifold, enclosed once, and the multipliers of its orbit. Raises `NotProved`."""
        key = end.anchor, end.centre, end.frame, end.reach, end.slope, end.lap, end.slack
        if key in self.shapes:
            return self.shapes[key]
        shape = shaped(self.field, end, path, self.about.component)
        slopes = return_slopes(self.field, shape, end, path, self.about.component, self.about.settings)
        shape = replace(shape, slope=end.slope)
        check_cone(slopes, shape)
        multipliers = stability(reduced(path, monodromy(path)), self.conserved).multipliers
        sizes = [abs(mu) for mu in multipliers]
        if not (len(sizes) == 2 and sizes[0] > 1 and sizes[1] < 1):
            raise NotProved("an orbit's multipliers could not be shown to be off the unit circle on either side")
        self.shapes[key] = shape, multipliers
        return shape, multipliers

    def concluded(self, margin: float = MARGIN, digits: int = DIGITS) -> ConnectionRecord:
        """What the record says of its box, proved. Raises `NotProved`."""
        about, settings = self.about, self.about.settings
        path, other = self.enclosed_orbit(about.origin), self.enclosed_orbit(about.goal)
        same = path is other
        if not same and not apart(path, other, self.model.angles):
            raise NotProved("that the two orbits are different ones could not be shown")
        if not (about.origin.lap > 0 > about.goal.lap):
            raise NotProved("lap: that of the goal must go back in time")
        (origin, rising), (goal, falling) = self.manifold(about.origin, path), self.manifold(about.goal, other)
        forms = [self.orbit(end).formulation for end in (about.origin, about.goal)]
        for form in (*forms, replace(forms[0], turns=about.turns)):
            check_graph(self.codes, form, self.model)
        equations = self.equations(origin, goal)
        first, _ = equations.krawczyk(equations.around(about.centre, about.radius), settings)
        if not first.proved:
            raise NotProved("the interval Newton operator does not map the box into itself")
        again, steps = equations.krawczyk(first.image, settings)
        self.check_push(steps)
        box = [x.intersection(y) for x, y in zip(first.image, again.image, strict=True)]
        if self.field.rates([*equations.parts(box)[about.before - 1], arb(0), arb(1)])[about.component].contains(0):
            raise NotProved("the motion could touch the plane")
        places = box[0], equations.last(box)
        if not all(tau > 0 for tau in box[-2:]):
            raise NotProved("the motion could last no time")

        def wide(ball: Any) -> Table:
            return enclosure(ball, digits, margin)

        def known(end: ProvedEnd, path: Trajectory, multipliers: list[Any]) -> ProvedEnd:
            pairs = tuple((wide(mu.real), wide(mu.imag)) for mu in multipliers)
            return replace(end, period=wide(path.period), multipliers=pairs)

        return replace(
            about, proved=True, homoclinic=same, contraction=first.contraction,
            origin=known(about.origin, path, rising), goal=known(about.goal, other, falling),
            state=tuple(map(wide, equations.parts(box)[about.before - 1])), places=tuple(map(wide, places)),
            durations=tuple(wide(tau * n) for tau, n in zip(box[-2:], (about.before, about.after), strict=True)),
        )  # fmt: skip

    def equations(self, origin: LocalManifold, goal: LocalManifold) -> ConnectingEquations:
        """The equations of the motion between two manifolds."""
        about = self.about
        return ConnectingEquations(
            self.field, origin, goal, about.before, about.after, about.component, about.level, about.turns
        )  # fmt: skip

    # ----------------------------------------------------------------------------------------------
    # How a record is made: floats, which prove nothing.

    def begun(self, end: Any, state: np.ndarray, sense: int, inner: bool) -> tuple[ProvedEnd, float, int]:
        """An end of a record, the place on its manifold where the motion begins, and how many laps nearer to the orbit
        that is than the recorded state, which is inner if it may not be the first."""
        settings, point = self.about.settings, np.asarray(end.point, float)
        growth = max(abs(end.multiplier), 1 / abs(end.multiplier))
        count = 2 + int(math.log(growth) / math.log(GROWTH))
        nodes = self.flowed(point, np.linspace(0.0, end.period, count + 1))
        made = ProvedEnd(count, self.wound(nodes[-1] - point), tuple(point.tolist()), (), 0.0)
        equations = self.orbit(made)
        start = list(map(arb, equations.formulation.unknowns_of(nodes[:-1], end.period / count)))
        centre = list(map(arb, map(float, solve(equations, start, settings, CENTRE)[0])))
        box = enclosed(lambda box: krawczyk(equations, box, settings), centre, self.say)
        made = replace(made, centre=tuple(map(float, centre)), radius=radius(box.box))
        path = self.enclosed_orbit(made)
        period, frame = float(path.period.mid()), self.frame(path, sense, np.asarray(end.extents, float))
        rate = [float(x.mid()) for x in self.field.rates(path.first)[: len(point)]]
        off = state - point
        off[: len(made.turns)] -= 2 * np.pi * np.array(self.wound(off))
        place = float(np.linalg.solve(np.array([*frame, rate]).T, off)[0])
        laps = max(int(inner), math.ceil(math.log(abs(place) / START) / math.log(growth)))
        place *= (end.multiplier if sense < 0 else 1 / end.multiplier) ** laps
        made = replace(made, lap=sense * period, frame=frame, reach=2 * abs(place))
        shape = shaped(self.field, made, path, self.about.component)
        matrix = floats(monodromy(path))
        swept = np.abs(np.array(frame) @ (matrix if sense > 0 else np.linalg.inv(matrix))[self.about.component])
        later = float(swept @ [1.0, *[THIN] * (len(frame) - 1)]) / abs(rate[self.about.component])
        made = replace(made, slack=made.reach * (4 * later + 1e-3 * growth * period))
        slopes = return_slopes(self.field, shape, made, path, self.about.component, settings)
        return replace(made, slope=cone(slopes)), place, laps

    def check_recorded(self, connection: Any, proof: ConnectionRecord) -> None:
        """`NotProved` where what is proved is not what was recorded."""
        away = np.array([float(ball["value"]) for ball in proof.state]) - connection.states[connection.chosen]
        away[: len(self.model.angles)] -= 2 * np.pi * np.array(self.wound(away))
        off = float(np.abs(away / connection.origin.extents).max())
        if not off <= NEAR:
            raise NotProved(
                f"a connection exists, but its crossing is {off:.2g} of the orbit's extents from the record's"
            )

    def flowed(self, state: np.ndarray, times: np.ndarray) -> np.ndarray:
        """States at times, in floats."""
        return integrated(vector_field(accelerations(self.model)), state, times, SECOND)

    def wound(self, difference: np.ndarray) -> tuple[int, ...]:
        """The whole turns in a difference of states."""
        angles = np.asarray(self.model.angles)
        turns = np.round(difference[: len(angles)] / (2 * np.pi))
        return tuple(int(k) if angle else 0 for k, angle in zip(turns, angles, strict=True))

    def frame(self, path: Trajectory, sense: int, extents: np.ndarray) -> tuple[tuple[float, ...], ...]:
        """Along the manifold, across it, across the energy: in the plane, of length 1 in the orbit's extents."""
        d, c = path.formulation.dimension, self.about.component
        matrix, rate = floats(monodromy(path)), np.array([float(x.mid()) for x in self.field.rates(path.first)[:d]])
        matrix = matrix if sense > 0 else np.linalg.inv(matrix)
        back = matrix - np.outer(rate, matrix[c]) / rate[c]
        normals = [np.eye(d)[c]]
        if self.conserved:
            slope = np.array([float(x.mid()) for x in self.field.energy(path.first)[1]])
            normals.append(np.where(np.arange(d) == c, 0.0, slope))
        plane = np.linalg.svd(np.array(normals))[2][len(normals) :]
        values, vectors = np.linalg.eig(plane @ back @ plane.T)
        if np.abs(values.imag).max() > 0:
            raise NotProved("an orbit's multipliers are complex; it has no curves of this kind in the plane")
        rows = [*(plane.T @ vectors.real[:, np.argsort(-np.abs(values))]).T, *normals[1:]]
        rows = [np.where(np.arange(d) == c, 0.0, row) for row in rows]
        return tuple(tuple((row / np.abs(row / extents).max()).tolist()) for row in rows)

    def solved(self, connection: Any) -> None:
        """The record's ends, centre and box from a connection. Raises `NotProved`, `ConvergenceError`."""
        chosen, last, settings = connection.chosen, len(connection.states) - 1, self.about.settings
        origin, here, before = self.begun(connection.origin, connection.states[0], 1, chosen == 0)
        goal, there, after = self.begun(connection.goal, connection.states[-1], -1, chosen == last)
        if np.array_equal(connection.origin.point, connection.goal.point):
            goal = replace(goal, segments=origin.segments, centre=origin.centre, radius=origin.radius)
        self.about = replace(self.about, origin=origin, goal=goal)
        shapes = [self.manifold(end, self.enclosed_orbit(end))[0] for end in (origin, goal)]
        starts = [
            np.array([float(x.mid()) for x in shape.at(arb(xi))])
            for shape, xi in zip(shapes, (here, there), strict=True)
        ]
        (first, second), end = self.pieces(connection, starts, before, after)
        rates = [math.log(max(abs(each.multiplier), 1 / abs(each.multiplier))) / each.period
                 for each in (connection.origin, connection.goal)]  # fmt: skip
        totals = [sum(duration for _, duration in part) for part in (first, second)]
        counts = [1 + int(total * max(rates) / math.log(GROWTH)) for total in totals]
        self.about = replace(
            self.about, before=counts[0], after=counts[1], turns=self.wound(end - starts[1]),
            level=float(second[0][0][self.about.component]),
        )  # fmt: skip
        nodes = [*self.sampled(first, counts[0]), *self.sampled(second, counts[1])]
        times = [total / count for total, count in zip(totals, counts, strict=True)]
        start = [here, *np.ravel(nodes[1:]), there, *([0.0] if self.conserved else []), *times]
        equations = self.equations(*shapes)
        centre = list(map(float, equations.solved(list(map(arb, map(float, start))), settings, CENTRE)))
        self.say(f"Newton settled; integrating {equations.segments} segments of a box")
        box = enclosed(
            lambda box: equations.krawczyk(equations.around(centre, radius(box)), settings)[0],
            list(map(arb, centre)),
            self.say,
        )
        self.about = replace(self.about, centre=tuple(centre), radius=radius(box.box))

    def pieces(
        self, connection: Any, starts: Sequence[np.ndarray], before: int, after: int
    ) -> tuple[list[list[tuple[np.ndarray, float]]], np.ndarray]:
        """States with how long each is followed, up to the crossing and from it, angles going on; the last state."""
        origin, goal, chosen = connection.origin, connection.goal, connection.chosen
        recorded = list(zip(connection.states, connection.durations, strict=False))
        away, left = starts[0] - origin.point, starts[1] - goal.point
        first = [(origin.point + away * origin.multiplier**k, origin.period) for k in range(before)]
        last = [(goal.point + left / goal.multiplier ** (k + 1), goal.period) for k in reversed(range(after))]
        here, parts = starts[0], list[list[tuple[np.ndarray, float]]]()
        for part in ([*first, *recorded[:chosen]], [*recorded[chosen:], *last]):
            parts.append([])
            for state, duration in part:
                lifted = state.copy()
                lifted[: len(self.model.angles)] += 2 * np.pi * np.array(self.wound(here - state))
                parts[-1].append((lifted, duration))
                here = self.flowed(lifted, np.array([0.0, duration]))[-1]
        return parts, here

    def sampled(self, part: Sequence[tuple[np.ndarray, float]], count: int) -> list[np.ndarray]:
        """States at so many equal times from the beginning of pieces."""
        begins, nodes = np.cumsum([0.0, *(duration for _, duration in part)]), list[np.ndarray]()
        for moment in np.linspace(0.0, begins[-1], count + 1)[:-1]:
            k = min(int(np.searchsorted(begins, moment, side="right")) - 1, len(part) - 1)
            since = moment - begins[k]
            nodes.append(self.flowed(part[k][0], np.array([0.0, since]))[-1] if since > 0 else part[k][0])
        return nodes


def apart(path: Trajectory, other: Trajectory, angles: Sequence[bool]) -> bool:
    """True when the second orbit's point is not on the first, angles modulo whole turns."""
    d = path.formulation.dimension
    turning = [*angles, *[False] * (d - len(angles))]
    return all(
        any(differs(a - b, turns) for a, b, turns in zip(step.reach[:d], other.first[:d], turning, strict=True))
        for steps in path.steps for step in steps
    )  # fmt: skip


def prove_connection(
    connection: Any, model: Model | None = None, options: Options | None = None, progress: Progress | None = None
) -> ConnectionRecord:
    """The proof that a connection exists, or the reason why there is none. Needs the extra `[proof]`.

    In a box about the recorded motion exactly 1 leaves the orbit on its unstable manifold and comes to the other's
    stable manifold, and these are transversal within the energy: Krawczyk's operator on the flow between local
    manifolds that cone conditions enclose.

    Args:
        connection: what is to be proved.
        model: needed only for systems that no file describes.
        options: precision of the integrator.
        progress: called with what is being done.

    Returns:
        ConnectionRecord: `proved`, `reason`, enclosures of the crossing, both orbits' periods and multipliers.

    Raises:
        InputError: for driven systems, events, and states of more than 3 components (4 with an energy).

    Examples:
        >>> proof = of.sections.prove_connection(homoclinic[0])
        >>> proof.proved, proof.kind
        (True, 'homoclinic')
    """
    began, options = time.perf_counter(), options or Options()
    if connection.component < 0:
        raise InputError("plane: this connection is of a driven system; those of autonomous systems are proved")
    level = float(connection.states[connection.chosen][connection.component])
    blank = ProvedEnd(1, (), (), (), 0.0)
    about = ConnectionRecord(
        connection.name, True, connection.system, tuple(connection.state_names), connection.component, level,
        connection.energy, 1, 1, (), blank, blank,
        order=options.order, bits=options.bits, tolerance=options.tolerance,
    )  # fmt: skip
    with precision(options.bits):
        run = _ConnectionProof(about, model or provable_system(connection.system), progress or silent)
        try:
            run.solved(connection)
            proof = run.concluded()
            run.check_recorded(connection, proof)
        except UNPROVED as error:
            proof = replace(run.about, reason=why_not(error))
    return timed(proof, began)


def proving(asked: Table) -> Proving:
    """How connections are proved as is asked. Raises `InputError`."""
    refuse(asked, "is for orbits and families", "order", "bits", "tolerance")
    options = chosen_options(asked)
    return Proving(
        lambda connection, model, say: prove_connection(connection, model, options, say), CODEC.document, CODEC,
        "FILE: connections and others together; prove them by a command each",
    )  # fmt: skip


def read_connection_proof(path: Path) -> ConnectionRecord:
    """A connection-proof.json. Raises `InputError`."""
    record = CODEC.load(path)
    ends = (record.origin, record.goal)
    checked(Options(record.order, record.bits, record.tolerance, segments=max(end.segments for end in ends)))
    counts = (record.before, record.after, *(end.segments for end in ends))
    numbers = [record.level, *record.centre, record.radius]
    for end in ends:
        numbers += [
            *end.anchor,
            *end.centre,
            *(x for row in end.frame for x in row),
            end.radius,
            end.reach,
            end.slope,
            end.lap,
            end.slack,
        ]
    positive = (*counts, record.radius, *(x for end in ends for x in (end.radius, end.reach, end.slope, end.slack)))
    even = all(len(row) == len(end.anchor) for end in ends for row in end.frame)
    if not (even and np.all(np.isfinite(numbers)) and min(positive) > 0 and max(counts) <= 10_000):
        raise InputError(
            f"{path}: centre, radius, origin or goal: no usable numbers in anchor, frame, ...; {CODEC.again}"
        )
    return record


def replayed_connection(
    record: ConnectionRecord, model: Model | None = None, progress: Progress | None = None
) -> ConnectionRecord:
    """A recorded proof done again from its centres, balls without a margin. Raises `InputError`."""
    with precision(record.bits):
        run = _ConnectionProof(record, model or provable_system(record.system), progress or silent)
        run.check_sizes()
        return done_again(record, lambda: run.concluded(1.0, 2 * DIGITS))


def unproved_claims(record: ConnectionRecord, fresh: ConnectionRecord) -> list[str]:
    """Every claim of a recorded proof that the proof done again does not bear out."""
    if not fresh.proved:
        return [fresh.reason]
    compared: dict[str, Same] = {"proved": eq, "homoclinic": eq, "contraction": bounding}
    compared |= dict.fromkeys(("state", "places", "durations"), holds)
    of_ends = dict.fromkeys(("origin.period", "origin.multipliers", "goal.period", "goal.multipliers"), holds)
    old, new = (
        entries | {name: entries[name.partition(".")[0]][name.partition(".")[2]] for name in of_ends}
        for entries in (plain(record), plain(fresh))
    )
    return list(contradictions(old, new, compared | of_ends).values())


def replay(path: Path, trusted: Path | None, progress: Progress) -> tuple[ConnectionRecord, list[str], str]:
    """The proof in a connection-proof.json done again (see `Kind.replay`)."""
    record = read_connection_proof(path)
    fresh = replayed_connection(record, provable_system(record.system, trusted), progress)
    return fresh, unproved_claims(record, fresh), fresh.kind
