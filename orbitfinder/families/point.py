"""How a family is followed, and what makes a point of it out of a corrected orbit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.closure import ClosureCheck
from orbitfinder.families.scale import extents
from orbitfinder.families.stability import Spectrum, spectrum
from orbitfinder.loops.continued import Curve, Place, Solution
from orbitfinder.loops.graded import invariants_at
from orbitfinder.orbits.closure import carried
from orbitfinder.records.family import CLOSURE, FamilyPoint, turns
from orbitfinder.records.orbit import system_at

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
    turned = winding(curve)
    closure = 0.0 if check is None else check(place.nodes[0], place.period, np.array(turned), allowed, free, units)
    if not closure <= allowed:
        raise ConvergenceError(f"the orbit closes only to {closure:.2g} where errors grow {grown:.3g} times")
    defect = closure
    if check is not None and grown > PIECEWISE:
        defect, growth = piecewise_defect(curve, found, check, free)
        if not defect <= CLOSURE * growth:
            raise ConvergenceError(f"the pieces of the orbit fit only to {defect:.2g} with growth {growth:.3g}")
    where.setdefault("indices", about.indices)
    point = FamilyPoint(
        name="",
        system=system_at(p.model.system, free),
        winding=turned,
        nodes=place.nodes[:1],
        times=np.zeros(0),
        samples=np.zeros((0, p.size)),
        tolerance=CLOSURE,
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
        unfolding=tuple(float(s) for s in place.unfolding),
        free=free,
        shooting_nodes=place.nodes,
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


def winding(curve: Curve) -> tuple[int, ...]:
    """Whole turns of each coordinate in one period (n); zero for orbits that swing back."""
    return turns(curve.propagator.symmetry.name, curve.constant, curve.propagator.size // 2)


def place_of(point: FamilyPoint) -> Place:
    """The shooting unknowns that a stored point stands for."""
    return Place(
        point.shooting_nodes, point.period, np.array(point.unfolding), np.array(list(point.free.values())), point.mesh
    )
