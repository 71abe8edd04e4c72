"""What a family is made of: points, events, ends; plain frozen numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbitfinder._runtime import notebook as display
from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import ConvergenceError
from orbitfinder.families.closure import ClosureCheck
from orbitfinder.families.scale import extents
from orbitfinder.families.stability import Spectrum, spectrum
from orbitfinder.loops.continued import Curve, Place, Solution
from orbitfinder.loops.graded import invariants_at
from orbitfinder.orbits.closure import carried

CLOSURE = 1e-11
"""Largest independent closure of an accepted point, relative to the motion, times what errors grow by."""
PIECEWISE = 1e3
"""Growth of errors beyond which an orbit is checked piece by piece as well."""


@dataclass(frozen=True)
class FamilySettings:
    """How a family is followed. Lengths are arclengths in rad, without angles in extents of the motion."""

    parameter: str = "energy"
    """energy | period | a state component | a physical parameter (then `hold` is kept)"""
    hold: str = "energy"
    """what stays fixed while a physical parameter varies: energy | period"""
    points: int = 300
    """accepted points in each direction"""
    directions: str = "both"
    """both | forward (parameter increasing at the start) | backward | away (from where a branch was born)"""
    first_step: float = 0.02
    longest_step: float = 0.15
    shortest_step: float = 1e-7
    sharpest_turn: float = 0.3
    """rad between successive tangents; a sharper turn repeats the step at half its length"""
    longest_stretch: float = 0.06
    """relative change of the period within one step: near a saddle events come with every so many seconds"""
    narrowest: float = 0.02
    """avoided crossings of two families are followed by steps no shorter than this, and else stepped over and named"""
    longest_period: float = 12.0
    """in units of the shortest period met: beyond it a slow orbit counts as homoclinic"""
    resonances: int = 6
    """period-q resonances are looked for up to this q"""
    events: bool = True
    certify: bool = True


@dataclass(frozen=True)
class FamilyPoint:
    """One periodic orbit of a family, complete: what an Orbit says, and where it is on the family.

    `closure` is by the independent integrator and relative to the extent of the motion, `scale`
    what its allowed value 1e-11 is multiplied by: the largest multiplier, or what errors grow by until the
    end of the part that is integrated. Where that is more than
    1e-8, one turn says little, and the orbit is checked piece by piece as well: `defect` is the largest
    gap, as relative, between where the same integrator leaves one of the shooting nodes and the next
    node, of which 1e-11 times the growth over a piece is allowed; elsewhere it is the closure itself.
    `indices` are the stability indices in the order that follows each curve along the family, of the
    map whose power `root` is the monodromy. `tangent` is d(x(0), T, free)/d(arclength); `nodes` and
    `mesh` rebuild the shooting unknowns. `role`: step | at | end.
    """

    __repr__ = brief("index", "value", "period", "energy", "closure", "stability", "role")

    index: int
    arclength: float
    value: float
    state: np.ndarray
    period: float
    energy: float
    action: float
    closure: float
    scale: float
    floquet_multipliers: np.ndarray
    pair_defect: float
    stability: str
    krein: tuple[int, ...]
    symmetry: str
    indices: np.ndarray
    root: int
    unfolding: np.ndarray
    free: Mapping[str, float]
    nodes: np.ndarray
    mesh: np.ndarray
    tangent: np.ndarray
    step: float
    role: str = "step"
    wall_time: float = 0.0
    defect: float = 0.0
    certified: bool = False
    """whether it has every check of a certificate and not only those of its closure"""


@dataclass(frozen=True)
class Event:
    """Something that happens between two points, located on the family.

    `kind`: fold | branch_point | period_doubling | torus | resonance | collision | stability_change. `detail`
    says what exactly (of what the fold is, q of the resonance, what changed); `multiplier` is the
    critical multiplier of the root map, `order` the number of periods after which the branch closes.
    """

    __repr__ = brief("kind", "detail", "parameter", "period", "index")

    kind: str
    index: int
    arclength: float
    parameter: float
    state: np.ndarray
    period: float
    energy: float
    detail: str = ""
    order: int = 1
    multiplier: complex = 1.0 + 0.0j
    nodes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    mesh: np.ndarray = field(default_factory=lambda: np.zeros(0))
    tangent: np.ndarray = field(default_factory=lambda: np.zeros(0))
    symmetry: str = "none"
    free: Mapping[str, float] = field(default_factory=dict)
    certified: bool = False


@dataclass(frozen=True)
class End:
    """Why a family stopped in one direction: a short name and the sentence."""

    kind: str
    reason: str


@dataclass(frozen=True)
class Batch:
    """Everything one step adds; written to the journal as one line, so that it is kept or lost as a whole."""

    __repr__ = brief("direction", "points", "events", "end")

    direction: int
    points: tuple[FamilyPoint, ...] = ()
    events: tuple[Event, ...] = ()
    end: End | None = None


@dataclass(frozen=True)
class Family:
    """Orbits joined by arclength, ordered along the curve, with events and the reason of each end.

    `curve` is what rebuilds the equations (see `store.curve_of`), `source` what the family was started from.
    """

    __repr__ = brief("name", "parameter", "points", "events", "ends")

    name: str
    system: Mapping[str, Any]
    parameter: str
    points: tuple[FamilyPoint, ...]
    events: tuple[Event, ...]
    ends: tuple[End, ...]
    curve: Mapping[str, Any] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)

    def values(self, name: str) -> np.ndarray:
        """One number of every point as an array, in order along the family."""
        return np.asarray([getattr(point, name) for point in self.points])

    @property
    def counts(self) -> str:
        """How many orbits are closed and how many of them certified, in words."""
        sure = [sum(one.certified for one in some) for some in (self.points, self.events)]
        return (
            f"{len(self.points)} closed orbits, {sure[0]} of them certified; "
            f"{len(self.events)} events, {sure[1]} of them at certified orbits"
        )

    def _repr_html_(self) -> str | None:
        """How a notebook shows it."""
        return display.html(self)


Check = ClosureCheck


def parameter_value(curve: Curve, place: Place, name: str) -> float:
    """The number that the family's parameter has at a place."""
    p = curve.propagator
    if name in p.free:
        return float(place.free[p.free.index(name)])
    if name == "period":
        return place.period
    if name == "energy":
        return float(invariants_at(p, place.nodes[0], place.free)[0][-1])
    return float(place.nodes[0][p.model.state_index(name)])


def make_point(
    curve: Curve,
    found: Solution,
    along: np.ndarray,
    parameter: str,
    check: Check | None,
    about: Spectrum | None = None,
    **where: Any,
) -> tuple[FamilyPoint, Spectrum]:
    """The FamilyPoint of a corrected place; `where` gives index, arclength, step, role, indices.

    Raises `ConvergenceError` when the independent closure is above what double precision can hold.
    """
    p, place = curve.propagator, found.place
    about = about or spectrum(curve, found)
    units = extents(found.march.states)
    parts = [matrix[:, : p.size] * units / units[:, None] for matrix in found.march.sensitivities]
    grown = max(float(np.abs(about.floquet.multipliers).max(initial=1.0)), carried(parts, np.ones(p.size))[1])
    allowed = CLOSURE * grown
    free = dict(zip(p.free, map(float, place.free), strict=True))
    closure = 0.0 if check is None else check(place.nodes[0], place.period, winding(curve), allowed, free, units)
    if not closure <= allowed:
        raise ConvergenceError(f"the orbit closes only to {closure:.2g} where errors grow {grown:.3g} times")
    defect = closure
    if check is not None and grown > PIECEWISE:
        defect, growth = piecewise_defect(curve, found, check, free)
        if not defect <= CLOSURE * growth:
            raise ConvergenceError(f"the pieces of the orbit fit only to {defect:.2g} with growth {growth:.3g}")
    where.setdefault("indices", about.indices)
    point = FamilyPoint(
        value=parameter_value(curve, place, parameter),
        state=place.nodes[0],
        period=place.period,
        energy=parameter_value(curve, place, "energy"),
        action=found.march.action / p.symmetry.fraction,
        closure=closure,
        defect=defect,
        scale=grown,
        floquet_multipliers=about.floquet.multipliers,
        pair_defect=about.floquet.pair_defect,
        stability=about.floquet.stability,
        krein=about.krein,
        symmetry=p.symmetry.name,
        root=about.root,
        unfolding=place.unfolding,
        free=free,
        nodes=place.nodes,
        mesh=place.mesh,
        tangent=along,
        **where,
    )
    return point, about


def piecewise_defect(curve: Curve, found: Solution, check: Check, free: Mapping[str, float]) -> tuple[float, float]:
    """The largest gap between the pieces of an orbit, the boundary's included, and the largest growth.

    Both relative to the motion; the growth of a piece is the 2-norm of its state-transition matrix.
    """
    place, size, units = found.place, curve.propagator.size, extents(found.march.states)
    across = np.maximum(np.abs(curve.first) * units, np.abs(curve.last) * units).max(axis=1)
    durations = np.diff(place.edges) * place.period
    ends = check.ends(place.nodes, durations, free)
    boundary = curve.first @ place.nodes[0] + curve.last @ ends[-1] - curve.constant
    gaps = np.concatenate([((ends[:-1] - place.nodes[1:]) / units).ravel(), boundary / across])
    growth = max(np.linalg.norm(matrix[:, :size] * units / units[:, None], 2) for matrix in found.march.sensitivities)
    return float(np.abs(gaps).max()), max(1.0, float(growth))


def winding(curve: Curve) -> np.ndarray:
    """Whole turns of each coordinate in one period (n); zero for orbits that swing back."""
    n = curve.propagator.size // 2
    if curve.propagator.symmetry.name == "reversal":
        return np.asarray(np.round((curve.constant[n:] - curve.constant[:n]) / np.pi))
    if curve.propagator.symmetry.name != "none":
        return np.zeros(n)
    return np.asarray(np.round(curve.constant[:n] / (2 * np.pi)))


def place_of(point: FamilyPoint) -> Place:
    """The shooting unknowns that a stored point stands for."""
    return Place(point.nodes, point.period, point.unfolding, np.array(list(point.free.values())), point.mesh)
