"""How a family is followed, and what makes a point of it out of a corrected orbit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.motion import watched
from orbitfinder.families.stability import LARGEST, Spectrum, spectrum
from orbitfinder.loops.conditions import measured
from orbitfinder.loops.continued import CORRECTOR, Curve, Solution
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.symmetry import shifting, turned
from orbitfinder.mechanics.scales import alone, shared
from orbitfinder.orbits.closure import carried
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.records.family import AGAIN, CLOSURE, UNKNOWN, Event, FamilyPoint
from orbitfinder.records.orbit import system_at

LEAST = 1e-3
"""Share of a motion's distance from the origin that its extent counts as at least: it is known to round-off of that."""


@dataclass(frozen=True)
class FamilySettings:
    """How a family is followed. Lengths are arclengths in sizes of the motion (see `loops.scales`).

    Args:
        parameter: energy | period | a state component | a physical parameter (then `hold` is kept).
        hold: what stays fixed while a physical parameter varies: energy | period.
        beside: of systems without an energy, a second physical parameter that varies so that the period stays fixed.
        points: accepted points in each direction.
        directions: both | forward (parameter increasing at the start) | backward | away (from where a branch was
            born).
        first_step: arclength of the first step.
        longest_step: along a curve of bifurcations three times as long.
        shortest_step: below it a family ends.
        sharpest_turn: rad between successive tangents; a sharper turn repeats the step at half its length.
        longest_stretch: relative change of the period within one step: near a saddle events come with every so many
            seconds.
        narrowest: where two families avoid each other across a gap that is narrower than this, the other one is gone on
            along; an event says which.
        longest_period: in units of the shortest period met: beyond it a slow orbit counts as homoclinic.
        resonances: period-q resonances are looked for up to this q.
        events: whether bifurcations are looked for.
        certify: whether each point's closure is checked by the second integrator.
        method: shooting | collocation | balance; None: how its orbit was found.

    Examples:
        >>> coarse = of.FamilySettings(longest_step=0.5, events=False, directions="forward")
        >>> of.follow_family(orbit, until=-17.0, settings=coarse).ends[-1].kind
        'target'
    """

    parameter: str = "energy"
    hold: str = "energy"
    beside: str = ""
    points: int = 300
    directions: str = "both"
    first_step: float = 0.02
    longest_step: float = 0.5
    shortest_step: float = 1e-7
    sharpest_turn: float = 0.3
    longest_stretch: float = 0.06
    narrowest: float = 0.1
    longest_period: float = 12.0
    resonances: int = 6
    events: bool = True
    certify: bool = True
    method: str | None = None


def parameter_value(curve: Curve, place: Unknowns, name: str) -> float:
    """The number that the family's parameter has at a place."""
    return measured(curve.equations, place, name)


def make_point(
    curve: Curve,
    solution: Solution,
    along: np.ndarray,
    parameter: str,
    check: ClosureCheck | None,
    about: Spectrum | None = None,
    **where: Any,
) -> FamilyPoint:
    """The FamilyPoint of a corrected place; `where` gives index, arclength, step, role, indices.

    Raises `ConvergenceError` when the independent closure is above what double precision can hold.
    """
    p, place = curve.equations, solution.place
    about = about or spectrum(curve, solution)
    units = extents(curve, solution.march.states)
    grown = growth(curve, solution, about, units)
    allowed = CLOSURE * grown
    free, shift = freed(curve, place), shift_at(curve, place)
    turns = turned(p.model, np.array(curve.turns), shift)
    # growth of errors beyond which an orbit is checked piece by piece as well, and then alone
    defect = 0.0 if check is None or grown <= 1e3 else checked_pieces(curve, solution, check, free)
    alone = check is None or (p.gridded and grown > UNKNOWN)
    closure = defect if alone or check is None else check(place.nodes[0], place.period, turns, allowed, free, units)
    if not closure <= allowed:
        raise ConvergenceError(f"the orbit closes only to {closure:.2g} where errors grow {grown:.3g} times")
    defect = defect or closure
    where.setdefault("indices", about.indices)
    return FamilyPoint(
        name="",
        system=system_at(p.model.system, free),
        winding=curve.turns,
        shift=shift,
        nodes=place.nodes[:1],
        times=np.zeros(0),
        samples=np.zeros((0, p.size)),
        tolerance=CLOSURE,
        value=parameter_value(curve, place, parameter),
        state=place.nodes[0],
        period=place.period,
        energy=parameter_value(curve, place, "energy"),
        action=action_at(curve, solution) / p.symmetry.fraction,
        closure=closure,
        defect=defect,
        scale=grown,
        floquet_multipliers=about.floquet.multipliers,
        pair_defect=about.floquet.pair_defect,
        multiplier_errors=about.errors,
        multiplier_method=about.method,
        stability=about.stability,
        krein=about.krein,
        symmetry=p.symmetry.name,
        root=about.root,
        unfolding=tuple(float(s) for s in place.unfolding),
        free=free,
        shooting_nodes=place.nodes,
        mesh=place.mesh,
        tangent=along,
        watch=watched(curve, solution),
        **where,
    )


def growth(curve: Curve, solution: Solution, about: Spectrum, units: np.ndarray) -> float:
    """How many times an error in `units` (d) grows until the end of an orbit, at most."""
    p = curve.equations
    parts = p.links.saltated(solution.place, solution.march, p.march) * units / units[:, None]
    largest = float(np.abs(about.floquet.multipliers).max(initial=1.0))
    return min(max(largest, carried(parts, np.ones(units.size))[1]), LARGEST)


def action_at(curve: Curve, solution: Solution) -> float:
    """The action over the horizon (J s) of the place after Newton's last step, which may have changed the energy: by
    dE, and so the action by T dE. What lies within segments may have moved too."""
    w = solution.place
    if solution.stepped < CORRECTOR.unmoved and not solution.march.change:
        return solution.march.integral
    return curve.equations.march.integral(w.nodes, w.mesh, w.tail)


def checked_pieces(curve: Curve, solution: Solution, check: ClosureCheck, free: Mapping[str, float]) -> float:
    """The largest gap between the pieces of an orbit, the boundary's included, relative to the motion.

    Raises `ConvergenceError` when they do not fit to what errors grow by over a piece, the 2-norm of its
    state-transition matrix.
    """
    place, units = solution.place, extents(curve, solution.march.states)
    first, last = curve.equations.boundary
    across = np.maximum(np.abs(first) * units, np.abs(last) * units).max(axis=1)
    durations = np.diff(place.edges) * place.period
    ends = check.ends(place.nodes, durations, free, units)
    boundary = first @ place.nodes[0] + last @ ends[-1] - curve.equations.aimed(curve.constant)
    gaps = np.concatenate([((ends[:-1] - place.nodes[1:]) / units).ravel(), boundary / across])
    growth = max(1.0, *(float(np.linalg.norm(a * units / units[:, None], 2)) for a in solution.march.transitions))
    defect = float(np.abs(gaps).max())
    if not defect <= CLOSURE * growth:
        raise ConvergenceError(f"the pieces of the orbit fit only to {defect:.2g} with growth {growth:.3g}")
    return defect


def shift_at(curve: Curve, place: Unknowns) -> dict[str, float]:
    """How far a relative orbit of a family shifts in a period, by name."""
    symmetry = curve.equations.symmetry
    known = shifting(symmetry, curve.equations.model)
    if not known:
        return {}
    end = curve.equations.ends(place)[-1]
    amounts = symmetry.shifts(symmetry.settled(curve.constant, place.nodes[0], end))
    return {name: float(amounts[symmetry.relative.index(translation.direction)]) for name, translation in known.items()}


def unknowns_of(curve: Curve, member: FamilyPoint | Event) -> Unknowns:
    """The shooting unknowns that a stored point or event stands for."""
    free = np.array(list(member.free.values()))
    if free.size != curve.equations.march.free:
        raise InputError(f"free: {free.size} numbers where {curve.equations.march.free} belong; {AGAIN}")
    w = curve.equations.unknowns(member.shooting_nodes, member.period, member.mesh, free)
    if not isinstance(member, FamilyPoint):
        return w
    if len(member.unfolding) != curve.equations.march.unfolding:
        raise InputError(f"points[{member.index}].unfolding: {len(member.unfolding)} numbers where "
                         f"{curve.equations.march.unfolding} belong; {AGAIN}")  # fmt: skip
    return replace(w, unfolding=np.array(member.unfolding))


def freed(curve: Curve, place: Unknowns) -> dict[str, float]:
    """The values of the freed parameters by name."""
    return dict(zip(curve.equations.free, map(float, place.free), strict=True))


def extents(curve: Curve, states: np.ndarray) -> np.ndarray:
    """The scale (2n) of every component of a motion (k x 2n): the largest extent of coordinates, and of rates."""
    angular, moved, least = curve.equations.model.angular, np.ptp(states, axis=0), LEAST * np.abs(states).max(axis=0)
    if angular.size == moved.size:
        return np.asarray(np.maximum(alone(moved / curve.shares, angular) * curve.shares, least))
    shares = np.tile(curve.shares, 2)
    return np.asarray(shared(np.maximum(moved, least) / shares, angular) * shares)
