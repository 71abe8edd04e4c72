"""Switching to the families that leave another one at a branch point, a period doubling or a resonance.

At a critical multiplier exp(2 pi i k / q) of an orbit of period T there are orbits of period q T near it.
Where the orbit is symmetric they are looked for among symmetric ones first: in the formulation of a
symmetry the shooting Jacobian of the q-fold orbit has a kernel of dimension two, the old family's tangent
and the new family's, whereas without one a whole circle of directions is critical (A. Vanderbauwhede,
Subharmonic branching in reversible systems, SIAM J. Math. Anal. 21 (1990) 954-979).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError
from orbitfinder.families.birth import cycle_start, mode_start
from orbitfinder.families.codimension_two import Critical
from orbitfinder.families.entries import SWITCHABLE
from orbitfinder.families.equilibria import rest_branch
from orbitfinder.families.equilibrium import EQUILIBRIA, Equilibria, RestEvent, load_equilibria
from orbitfinder.families.motion import full_samples
from orbitfinder.families.point import FamilySettings, parameter_value, shift_at, unknowns_of
from orbitfinder.families.run import parameter_slopes
from orbitfinder.families.stability import spectrum
from orbitfinder.families.start import (
    Start,
    begin,
    by_series,
    corrected,
    curve_at,
    curve_of,
    reformulated,
    return_gaps,
    symmetry_of,
    unknown_parameters,
)
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.continued import CRITICAL, Curve, Solution, advanced, at_place, correct, plane, scaled, tangent
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.mesh import fitted
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import Symmetry, called, involutions, momenta_of, named, turned
from orbitfinder.mechanics.hybrid import repeated
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.records.family import Event, Family, load_family
from orbitfinder.records.orbit import SHARE
from orbitfinder.records.reading import Entries, finite
from orbitfinder.records.registry import held

CHOICE = 'give the number of an event, "start" or "end"'
DISTANCES = (0.02, 0.005, 0.00125, 0.05, 0.1)
"""How far from the old family, in sizes of its orbit, the new one is looked for; the first that succeeds is taken.
Families of high resonances may leave along each other, and are told apart only near."""
CLOSER, OUTSIDE = 3, 1e-6
"""How often it is looked for four times nearer where more or fewer multipliers are by this much outside the unit circle
there: between the two an event of the new family would be missed."""
DIFFERENCE, OFF = 1e-4, 0.1
"""Arclength of the differences by which the old family's own direction is told; how far, relative, off its tangent."""
MIRRORED = 1e-7
"""Energies and periods of mirror images agree to this share of their distance from the old orbit's."""


@dataclass(frozen=True)
class Cover:
    """The orbit of an event, q times round, in one formulation, with the directions that leave it."""

    event: Event
    curve: Curve
    place: Unknowns
    directions: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Leaving:
    """A new family's start, so far from its cover in a direction (w)."""

    cover: Cover
    direction: np.ndarray
    length: float
    start: Start

    def nearer(self, length: float) -> Leaving | None:
        """The same family at another distance, or None where it was not met there."""
        start = self.start if length == self.length else _at(self.cover, self.direction, length)
        return None if start is None else replace(self, start=start, length=length)


def switch(curve: Curve, event: Event, settings: FamilySettings) -> list[Start]:
    """Starts of the families that leave at an event, each directed away from it, duplicates removed; none where no
    branch is met.

    `curve` is the one that the event is on.
    """
    leavings: list[Leaving] = []
    for kept, share in (*curve.equations.symmetry.narrower(), (replace(curve.equations.symmetry, maps=()), 0.0)):
        symmetry = called(kept, curve.equations.model)
        if not symmetry.maps and leavings:
            break
        if len(symmetry.maps) > 1 and event.order % 2 == 0:  # half of an even number of turns is no half turn
            continue
        cover = _cover(curve, event, symmetry, share, settings)
        if leavings and len(cover.directions) > 2:  # a circle, on which only the symmetric ones are isolated
            continue
        for direction in cover.directions:
            leaving = _leaving(cover, direction)
            if leaving is not None and not _known(leaving, leavings):
                leavings.append(leaving)
    return [one.start for one in leavings]


def _known(leaving: Leaving, leavings: list[Leaving]) -> bool:
    """Whether a branch was found before: by its own symmetry, where it has more than was asked for, or as it is."""
    own = leaving.start.curve.equations.symmetry.name
    known = {other.start.curve.equations.symmetry.name for other in leavings}
    if own != leaving.cover.curve.equations.symmetry.name and own in known:
        return True
    return any(_same(leaving, other) for other in leavings)


def _cover(curve: Curve, event: Event, symmetry: Symmetry, share: float, settings: FamilySettings) -> Cover:
    """The q-fold orbit in a formulation and the kernel of its Jacobian without the family's own tangent."""
    model, symmetry = curve.equations.model, replace(symmetry, relative=curve.equations.symmetry.relative)
    free, held = unknown_parameters(model, settings, momenta_of(symmetry, model))
    place = _repeated(curve, event, symmetry, share)
    equations = replace(curve.equations, model=repeated(model, event.order), symmetry=symmetry, free=free)
    again = curve.equations.links.repeated(place.free, event.order)
    place = replace(place, unfolding=np.zeros(equations.march.unfolding), free=again)
    there = curve_at(equations, place, held, np.array(curve.turns) * event.order)
    if not equations.links:
        there = replace(there, weights=curve.weights.copy())
    place = fitted(there, place)
    kernel, weights = _kernel(there, at_place(there, place)), np.sqrt(there.scales.metric(place))
    vectors, own = kernel * weights, _moved_along(curve, event, place, share) * weights
    along = np.linalg.lstsq(vectors.T, own, rcond=None)[0]
    own, others = along @ vectors, np.linalg.svd(np.atleast_2d(along))[2][1:]
    others -= np.outer(others @ vectors @ own, along) / (own @ own)  # a plane across one of them misses the old family
    across = others @ kernel
    return Cover(event, there, place, tuple(_round(across, event.order)))


def _kernel(curve: Curve, solution: Solution) -> np.ndarray:
    """The kernel (k x w) of a family's Jacobian: its tangent, and what else vanishes with it."""
    matrix, units = scaled(curve, solution)
    _, sizes, rows = np.linalg.svd(matrix)
    sizes = np.concatenate([sizes, np.zeros(len(rows) - len(sizes))])
    # the largest kernel possible: tangent, and two directions of a circle
    return np.asarray(units * rows[-3:][sizes[-3:] < CRITICAL * sizes[-4]])


def _along(curve: Curve, base: Unknowns, head: np.ndarray) -> np.ndarray:
    """The old family's direction over w, of unit length: the vector of the kernel with this `head`."""
    kernel, sizes = _kernel(curve, at_place(curve, base)), base.head_of(np.sqrt(curve.scales.metric(base)))
    heads = np.array([base.head_of(vector) for vector in kernel])
    share = np.linalg.lstsq((heads * sizes).T, head * sizes, rcond=None)[0]
    whole = share @ kernel
    return np.asarray(whole / np.sqrt(curve.scales.metric(base) @ whole**2))


def _moved_along(curve: Curve, event: Event, place: Unknowns, share: float) -> np.ndarray:
    """How the unknowns of a cover, which begins at a share of the period, move along the old family, by differences."""
    base = unknowns_of(curve, event)
    whole, ends, moved = _along(curve, base, event.tangent), [], []
    moments = (share + place.edges[:-1] * event.order) % 1.0
    for sign in (-1.0, 1.0):
        length = sign * DIFFERENCE
        shifted = correct(curve, advanced(base, whole, length), plane(curve, base, whole, length), base)
        moved.append(base.displacement(shifted.place))
        times, states = full_samples(curve, shifted)
        ends.append(np.array([np.interp(moments * shifted.place.period, times, column) for column in states.T]).T)
    if moved[0] is not None and moved[1] is not None:
        off = (moved[1] - moved[0]) / (2 * DIFFERENCE) - whole
        if curve.scales.metric(base) @ off**2 > OFF**2:  # the family that crosses was met
            raise ConvergenceError(f"the direction of the family at its {event.kind} cannot be told")
    nodes = (ends[1] - ends[0]) / (2 * DIFFERENCE)
    head, size = base.head_of(whole), curve.equations.size
    moving = curve.equations.links.repeated(head[size + 1 :], event.order, 0.0)
    tail = [head[size] * event.order, *np.zeros(place.unfolding.size), *moving]
    return np.concatenate([nodes.ravel(), tail])


def _round(across: np.ndarray, order: int) -> Iterator[np.ndarray]:
    """Both signs of one direction, or phases round the circle of two."""
    if len(across) == 1:
        yield from (across[0], -across[0])
    elif len(across) == 2:
        for angle in 2 * np.pi * np.arange(2 * order) / (2 * order):
            yield np.cos(angle) * across[0] + np.sin(angle) * across[1]


def _repeated(curve: Curve, event: Event, symmetry: Symmetry, share: float) -> Unknowns:
    """Nodes and mesh of the event's orbit, `order` times round, over the horizon of a formulation."""
    base, fraction = at_place(curve, unknowns_of(curve, event)), symmetry.fraction
    n = curve.equations.model.degrees_of_freedom
    each = (base.place.mesh.size - 1) // len(event.shooting_nodes)
    mesh, states = curve.equations.symmetry.whole(base.place.mesh, base.march.states, curve.constant)
    count = mesh.size - 1
    first = int(np.argmin(np.abs(mesh - share)))
    laps, index = np.divmod(first + np.arange(round(fraction * event.order * count) + 1), count)
    times = (laps + mesh[index] - mesh[first]) / event.order
    turns = turned(curve.equations.model, np.array(curve.turns), shift_at(curve, base.place))
    turn = np.concatenate([2 * np.pi * turns, np.zeros(curve.equations.size - n)])
    nodes = (states[index] + laps[:, None] * turn)[:-1:each]
    nodes[0, n:][symmetry.held(n)[n:]] = 0.0
    return Unknowns(nodes, event.period * event.order, np.zeros(0), base.place.free, times)


def _leaving(cover: Cover, direction: np.ndarray) -> Leaving | None:
    """The new family in one direction, or None when what is found is the old one or nothing."""
    curve, place = cover.curve, cover.place
    moved = ((direction[: place.nodes.size].reshape(place.nodes.shape) / curve.scales.states) ** 2).sum(axis=1)
    direction = direction / np.sqrt(moved.max())  # the start may be where the two families part least
    known = ((length, _at(cover, direction, length)) for length in DISTANCES)
    length, start = next((pair for pair in known if pair[1] is not None), (0.0, None))
    if start is None:
        return None
    for _ in range(CLOSER):
        nearer = _at(cover, direction, length / 4)
        if nearer is None or _grown(nearer) == _grown(start):
            break
        start, length = nearer, length / 4
    found = start.solution.place  # directed away from the orbit that it is born on
    whole = tangent(start.curve, start.solution, start.direction)
    same = np.array_equal(found.edges, place.edges)
    away = found.vector - place.vector if same else found.spread(found.head - place.head)
    if not np.sum(start.curve.scales.metric(found) * away * whole) >= 0:
        start = replace(start, direction=-start.direction)
    return Leaving(cover, direction, length, symmetric(start))


def _at(cover: Cover, direction: np.ndarray, length: float) -> Start | None:
    """The new family so far from the old one in a direction, or None."""
    curve, place, order = cover.curve, cover.place, cover.event.order
    aim = plane(curve, place, direction, length * float(curve.scales.metric(place) @ direction**2))
    try:
        start = corrected(curve, advanced(place, direction, length), aim, place, reach=2 * length)
    except UNSOLVED:
        return None
    # largest fictitious damping, per period, with which a motion is still an orbit
    if start.solution.place.period * np.abs(start.solution.place.unfolding).max(initial=0.0) > 1e-8:
        return None
    if shares := [k for k in range(2, order + 1) if order % k == 0]:  # of the period, after which it may close already
        states = full_samples(start.curve, start.solution)[1]
        gaps = [return_gaps(start.curve, states, k) / start.curve.scales.states for k in shares]
        return None if np.min(np.max(gaps, axis=1)) < 0.05 * length else start
    return start


def _grown(start: Start | None) -> int:
    """How many multipliers are outside the unit circle, the same until something happens on the way from the birth."""
    multipliers = spectrum(start.curve, start.solution).floquet.multipliers if start is not None else np.zeros(0)
    return int(np.count_nonzero(np.abs(multipliers) > 1.0 + OUTSIDE))


def symmetric(start: Start) -> Start:
    """The same start in the formulation of the symmetry that its orbit has, going the same way."""
    if not start.curve.equations.plain:
        return start
    try:
        other = reformulated(start, named(symmetry_of(start.curve, start.solution), start.curve.equations.model))
    except UNSOLVED:
        return start
    slopes = [list(parameter_slopes(s.curve, s.solution.place, s.direction).values()) for s in (start, other)]
    count = 2 + len(start.curve.equations.free)
    same = np.dot(slopes[0][:count], slopes[1][:count]) >= 0
    return other if same else replace(other, direction=-other.direction)


def _same(leaving: Leaving, other: Leaving) -> bool:
    """Whether two are one branch: the same curve in the space of states, or a mirror image of it."""
    length, event, cover = min(leaving.length, other.length), leaving.cover.event, leaving.cover
    leaving, other = leaving.nearer(length) or leaving, other.nearer(length) or other
    a, b = (_moved(each.start, event) for each in (leaving, other))
    sizes = np.abs([np.nan_to_num(event.energy), event.period * event.order, *_freed(event)])
    # share of an event's energy, period and parameters that differences of theirs are not known to
    if np.all(np.abs(a - b) <= MIRRORED * np.maximum(np.abs(a), np.abs(b)) + 1e-13 * sizes):
        return True
    scale = cover.curve.scales.states
    mine, theirs = (full_samples(each.start.curve, each.start.solution)[1] / scale for each in (leaving, other))
    old = full_samples(cover.curve, at_place(cover.curve, cover.place))[1] / scale
    model, size = cover.curve.equations.model, _apart(mine, old)
    images = [theirs, *(theirs @ each.matrix(model.degrees_of_freedom).T for each in involutions(model))]
    feet = [_foot(image, old) for image in images]  # told apart at the same distance from the old orbit
    images = [foot + size / _apart(image, old) * (image - foot) for image, foot in zip(images, feet, strict=True)]
    # orbits nearer to each other than this share of their distance from the old one are one branch
    return min(_apart(mine, image) for image in images) < 0.25 * size


def _apart(points: np.ndarray, curve: np.ndarray) -> float:
    """The largest distance of points (k x 2n) from the polygon through others."""
    return float(np.linalg.norm(points - _foot(points, curve), axis=1).max())


def _foot(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """The nearest points (k x 2n) of the polygon through others."""
    nearest = cKDTree(curve).query(points)[1]
    closest: np.ndarray = curve[nearest].copy()
    for shift in (-1, 0):
        low = np.clip(nearest + shift, 0, len(curve) - 2)
        along = curve[low + 1] - curve[low]
        share = np.sum((points - curve[low]) * along, axis=1) / nonzero(np.sum(along**2, axis=1))
        foot = curve[low] + np.clip(share, 0.0, 1.0)[:, None] * along
        nearer = np.linalg.norm(points - foot, axis=1) < np.linalg.norm(points - closest, axis=1)
        closest[nearer] = foot[nearer]
    return closest


def _freed(event: Event) -> np.ndarray:
    """The values of the freed physical parameters at an event."""
    return np.array([value for name, value in event.free.items() if not name.startswith(SHARE)])


def _moved(start: Start, event: Event) -> np.ndarray:
    """How far energy, period and freed parameters are from the event's."""
    place = start.solution.place
    energy = np.nan_to_num(parameter_value(start.curve, place, "energy") - event.energy)
    old = _freed(event)
    return np.array([energy, place.period - event.period * event.order, *(place.free[: old.size] - old)])


@dataclass(frozen=True)
class Branch:
    """The start of a family that leaves another one: which family, which of its events, which of the branches there.

    Or of the curve of that event in two parameters: no branch, 0.
    """

    __repr__ = brief("name", "event")

    start: Start
    family: str
    event: Event
    number: int | str
    branch: int
    name: str
    title: str = ""

    def described(self) -> Entries:
        """The same in plain numbers."""
        test, event = self.start.curve.test, self.event
        branch = {} if test else {"branch": self.branch}
        curve = {"kind": "curve", "parameters": list(test.parameters)} if isinstance(test, Critical) else {}
        return {
            "family": self.family, "event": self.number, **branch, "kind_of_event": event.kind, "order": event.order,
            "energy": finite(event.energy), "period": event.period, **curve,
        }  # fmt: skip


@one_thread()
def switch_branch(
    family: Family | Equilibria | str | Path,
    event: int | str | Event | RestEvent,
    branch: int = 1,
    *,
    settings: FamilySettings | None = None,
    model: Model | None = None,
) -> Any:
    """A branch that leaves a family at an event, the family that it joins, or the cycles that are born at a Hopf point
    of equilibria: `of.follow_family` follows it; at a branch point of theirs, for `of.follow_equilibria`, the others.

    Args:
        family: a Family or Equilibria, or the file of one.
        event: one of its events, or its number in order along the family, from 0; "start" or "end" for the family that
            is joined at that end, or a normal mode about the first or last equilibrium of a system with an energy.
        branch: which of those that leave there, from 1; of modes the slowest is 1.
        settings: how it will be followed.
        model: needed only for a system that no file describes.

    Returns:
        A Branch, an origin for `of.follow_family`, or a RestBranch for `of.follow_equilibria`.

    Raises:
        InputError: for an event that nothing leaves from (those that something does are named), and where there are
            fewer branches.
        ConvergenceError: when no branch was found.

    Examples:
        >>> near = of.Guess([0.0, 0.3, 0.0, 0.1], 6.5)
        >>> line = of.find_orbit(of.Problem(of.systems.henon_heiles(), near, pin=of.pin(energy=0.16), name="line"))
        >>> longer = of.follow_family(line, until=0.163, settings=of.FamilySettings(directions="forward", resonances=3))
        >>> longer.events[0].kind, round(longer.events[0].parameter, 9)
        ('branch_point', 0.161551515)
        >>> branch = of.switch_branch(longer, 0)
        >>> of.follow_family(branch, points=3).points[-1].symmetry
        'none'
    """
    if isinstance(event, str) and event not in ("start", "end"):
        raise InputError(f"event: families are joined at the start or the end, got {event!r}; or give its number")
    if isinstance(family, Equilibria) or (not isinstance(family, Family) and held(family)[0] == EQUILIBRIA):
        rest = family if isinstance(family, Equilibria) else load_equilibria(family)
        return _beside_rest(rest, event, branch, settings or FamilySettings(), model)
    if isinstance(event, RestEvent):
        raise InputError(f"event: a {event.kind} of equilibria; give the equilibria that it is of")
    if isinstance(event, str):
        return _joined(family if isinstance(family, Family) else load_family(family), event, settings, model)
    leaving = branches(family, event, settings, model)
    if not 1 <= branch <= len(leaving):
        at = leaving[0].number
        raise InputError(f"branch: {branch} asked for, {len(leaving)} found at event {at}; give 1 to {len(leaving)}")
    return leaving[branch - 1]


def _beside_rest(
    rest: Equilibria, event: int | str | Event | RestEvent, mode: int, settings: FamilySettings, model: Model | None
) -> Any:
    """What leaves equilibria at an event: cycles, or other equilibria; at the first or the last, a normal mode."""
    if isinstance(event, str):
        start, birth = mode_start(rest, event, mode, settings, model)
        return Branch(start, rest.name, birth, event, mode, f"{rest.name}-{event}-{mode}", rest.title)
    number = next((k for k, one in enumerate(rest.events) if one is event or k == event), event)
    known = rest_leaving(rest)
    if not isinstance(number, int) or number not in known:
        choice = f"choose one of {counted(list(known))}" if known else "there is none at which something does"
        raise InputError(f"event: nothing leaves these equilibria at event {number}; {choice}")
    return known[number](rest, number, settings, model)


def _cycles(rest: Equilibria, number: int, settings: FamilySettings, model: Model | None) -> Branch:
    start, birth = cycle_start(rest, number, settings, model)
    return Branch(start, rest.name, birth, number, 1, f"{rest.name}-{number}", rest.title)


def rest_leaving(rest: Equilibria) -> dict[int, Callable[..., Any]]:
    """What leaves equilibria at each of their events at which something does."""
    kinds = {"hopf": _cycles, "branch_point": lambda rest, number, _, model: rest_branch(rest, number, model)}
    return {k: kinds[event.kind] for k, event in enumerate(rest.events) if event.kind in kinds}


def _joined(family: Family, which: str, settings: FamilySettings | None, model: Model | None) -> Branch:
    """The start of the family that another one joins at its start or end, at the orbit recorded there."""
    ends = dict(zip(("start", "end"), family.ends, strict=False))
    if len(family.ends) == 1 and (known := family.ends[0]).parameter is not None:
        first, last = (abs(family.points[k].value - known.parameter) for k in (0, -1))
        ends = {"start" if first < last else "end": known}
    joins = {side: (end, end.joined) for side, end in ends.items() if end.joined}
    if which not in joins:
        told = f"its {' and its '.join(joins)}" if joins else "neither side"
        raise InputError(f"event: {family.name} joins another family at {told}, got {which!r}; {CHOICE}")
    end, orbit = joins[which]
    state, period, energy = np.asarray(orbit["state"], float), float(orbit["period"]), orbit.get("energy")
    there = with_parameters(model or build_model(family.system), orbit["free"])
    pins = (Pin("energy", energy),) if there.conservative and energy is not None else ()
    problem = Problem(there, Guess(state, period), pins, winding=tuple(orbit["winding"]), symmetry=orbit["symmetry"])
    start = begin(problem, replace(settings or FamilySettings(), parameter=family.parameter), orbit["symmetry"])
    place = start.solution.place
    event = Event(
        end.kind, -1, np.nan, float(end.parameter or np.nan), state, place.period, np.nan if energy is None else energy
    )
    return Branch(start, family.name, event, which, 1, f"{family.name}-{which}", family.source.get("title", ""))


def branches(
    family: Family | str | Path, event: int | Event, settings: FamilySettings | None = None, model: Model | None = None
) -> list[Branch]:
    """Every branch that leaves a family at its event, or that with this number, named <family>-<event>-<branch>.

    `model` is the family's where no file describes it. Raises `InputError` (also for events that nothing
    leaves from, with a list of those that something does) and `ConvergenceError` when no branch was found.
    """
    family, event, where = opened(family, event)
    known = [k for k, candidate in enumerate(family.events) if candidate.kind in SWITCHABLE]
    if event not in known:
        choice = f"choose one of {counted(known)}" if known else "this family has none from which one does"
        raise InputError(f"event: no branch leaves at event {event}; {choice}")
    chosen = with_nodes(family.events[event], where, "switch from it")
    settings = replace(settings or FamilySettings(), parameter=family.parameter)
    curve = curve_of(family.curve, model or build_model(family.system), settings)
    starts = switch(curve, chosen, settings)
    if not starts:
        raise ConvergenceError(f"{family.name}: no branch was found at event {event} ({described(family, event)})")
    starts = [replace(start, curve=replace(start.curve, watch=curve.watch)) for start in starts]
    return [
        Branch(start, family.name, chosen, event, k, f"{family.name}-{event}-{k}", family.source.get("title", ""))
        for k, start in enumerate(starts, 1)
    ]


def unled(family: Family) -> str:
    """Why nothing can be followed from the events of a family: a curve in two parameters or in series alone, or ""."""
    if "test" in family.curve:
        return "a curve in two parameters"
    return f"{family.curve['method']} of many coordinates" if by_series(family.curve) else ""


def left_at(family: Family) -> list[int]:
    """The numbers of the events at which others leave that `switch_branch` knows."""
    return [] if unled(family) else [k for k, event in enumerate(family.events) if event.kind in SWITCHABLE]


def opened(family: Family | str | Path, event: int | Event) -> tuple[Family, int, str]:
    """A family or that of a file, the number of an event of it (-1 of another), and what to call it in messages."""
    where = family.name if isinstance(family, Family) else str(family)
    family = family if isinstance(family, Family) else load_family(family)
    if isinstance(event, Event):
        event = next((k for k, candidate in enumerate(family.events) if candidate is event), -1)
    if not family.curve:
        raise InputError(f"{where}: curve: missing, an older orbitfinder wrote this file; continue the family again")
    return family, event, where


def with_nodes(event: Event, where: str, purpose: str) -> Event:
    """The same event. `InputError` where its orbit is known by its state only."""
    if not event.shooting_nodes.size:
        raise InputError(f"{where}: family.npz is not beside it; continue the family again to {purpose}")
    return event


def counted(numbers: Sequence[int]) -> str:
    """Rising whole numbers in short: 0, 2 to 5, 9."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)


def described(family: Family, number: int) -> str:
    """An event in a few words."""
    event = family.events[number]
    detail = f" {event.detail}" if event.detail else ""
    return f"{number}: {event.kind}{detail} at {family.parameter} {event.parameter:.6g}"
