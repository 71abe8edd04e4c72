"""Switching to the families that leave another one at a branch point, a period doubling or a resonance.

At a critical multiplier exp(2 pi i k / q) of an orbit of period T there are orbits of period q T near it.
Where the orbit is symmetric they are looked for among symmetric ones first: in the formulation of a
symmetry the shooting Jacobian of the q-fold orbit has a kernel of dimension two, the old family's tangent
and the new family's, whereas without one a whole circle of directions is critical (A. Vanderbauwhede,
Subharmonic branching in reversible systems, SIAM J. Math. Anal. 21 (1990) 954-979).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.families.events import parameter_slopes
from orbitfinder.families.points import Event, FamilySettings, parameter_value
from orbitfinder.families.propagate import build_propagator
from orbitfinder.families.start import FIRST_STEPS, Start, corrected, curve_at, full_samples, unknown_parameters
from orbitfinder.families.system import Aim, Curve, Place, advanced, at_place, correct, head_of
from orbitfinder.periodic.conditions import SYMMETRIES

SWITCHABLE = ("branch_point", "period_doubling", "resonance")
DISTANCES = (0.02, 0.05, 0.1)
"""How far from the old family, in its metric, the new one is looked for; the first that succeeds is taken."""
CRITICAL = 1e-3
"""A singular value below this, relative to the next larger ones, belongs to the kernel."""
NARROWER = {
    "brake+reflection": (("brake", 0.0), ("reversal", 0.25), ("reflection", 0.0)),
    "brake": (("brake", 0.0), ("brake", 0.5)),
    "reversal": (("reversal", 0.0), ("reversal", 0.5)),
    "reflection": (("reflection", 0.0),),
    "none": (),
}
"""Formulations that a branch of each symmetry may have, with the share of the period where it starts."""


@dataclass(frozen=True)
class Crossing:
    """The orbit of an event, q times round, in one formulation, with the directions that leave it."""

    curve: Curve
    place: Place
    directions: tuple[np.ndarray, ...]


def switch(curve: Curve, event: Event, settings: FamilySettings | None = None) -> list[Start]:
    """Starts of the families that leave at an event, each directed away from it, duplicates removed.

    `curve` is the one that the event was found on. Raises `InputError` for other kinds of events; an
    empty list says that no branch was found.
    """
    if event.kind not in SWITCHABLE:
        raise InputError(f"event: cannot switch at a {event.kind}; choose one of {', '.join(SWITCHABLE)}")
    settings = settings or FamilySettings()
    found: list[Start] = []
    for symmetry, share in (*NARROWER[curve.propagator.symmetry.name], ("none", 0.0)):
        if symmetry == "none" and found:
            break
        crossing = _crossing(curve, event, symmetry, share, settings)
        for direction in crossing.directions:
            start = _branch(crossing, event, direction)
            if start is not None and not any(_same(start, other, event) for other in found):
                found.append(start)
    return found


def _crossing(curve: Curve, event: Event, symmetry: str, share: float, settings: FamilySettings) -> Crossing:
    """The q-fold orbit in a formulation and the kernel of its Jacobian without the family's own tangent."""
    free, held = unknown_parameters(curve.propagator.model, settings)
    place = _repeated(curve, event, symmetry, share)
    propagator = build_propagator(curve.propagator.model, symmetry, free)
    place = replace(place, unfolding=np.zeros(propagator.unfolding))
    there = replace(curve_at(propagator, place, held, _turns(curve, event)), weights=curve.weights.copy())
    found = at_place(there, place)
    _, sizes, rows = np.linalg.svd(found.jacobian)
    sizes = np.concatenate([sizes, np.zeros(len(rows) - len(sizes))])
    # the largest kernel possible: tangent, and two directions of a circle
    kernel = rows[-3:][sizes[-3:] < CRITICAL * sizes[-4]]
    heads = np.stack([head_of(row, place) * np.sqrt(there.weights) for row in kernel])
    size = there.propagator.size
    moved = np.concatenate([np.zeros(size), event.tangent[size : size + 1] * event.order, event.tangent[size + 1 :]])
    own = _own(there, place, heads, moved, curve, event, share)
    _, _, mixed = np.linalg.svd(np.atleast_2d(np.linalg.lstsq(heads.T, own, rcond=None)[0]))
    across = mixed[1:] @ kernel
    return Crossing(there, place, tuple(_round(across, event.order)))


def _own(
    there: Curve, place: Place, heads: np.ndarray, moved: np.ndarray, curve: Curve, event: Event, share: float
) -> np.ndarray:
    """The old family's tangent (weighted head) at the start of this formulation, by differencing its orbits."""
    step = 1e-4
    normal = curve.weights * event.tangent
    base = _place_of(curve, event)
    own = moved.copy()
    ends = []
    for sign in (-1.0, 1.0):
        shifted = correct(curve, base, Aim(float(normal @ base.head) + sign * step, normal), base)
        moment = share * shifted.place.period
        times, states = full_samples(curve, shifted)
        ends.append(np.array([np.interp(moment, times, column) for column in states.T]))
    own[: there.propagator.size] = (ends[1] - ends[0]) / (2 * step)
    return np.asarray(own * np.sqrt(there.weights))


def _round(across: np.ndarray, order: int) -> Iterator[np.ndarray]:
    """Both signs of one direction, or phases round the circle of two."""
    if len(across) == 1:
        yield from (across[0], -across[0])
    elif len(across) == 2:
        for angle in 2 * np.pi * np.arange(2 * order) / (2 * order):
            yield np.cos(angle) * across[0] + np.sin(angle) * across[1]


def _place_of(curve: Curve, event: Event) -> Place:
    free = np.array(list(event.free.values()))
    return Place(event.nodes, event.period, np.zeros(curve.propagator.unfolding), free, event.mesh)


def _turns(curve: Curve, event: Event) -> np.ndarray:
    n = curve.propagator.size // 2
    alone = np.round(curve.constant[:n] / (2 * np.pi)) if curve.propagator.symmetry.name == "none" else np.zeros(n)
    return np.asarray(alone * event.order)


def _repeated(curve: Curve, event: Event, symmetry: str, share: float) -> Place:
    """Nodes and mesh of the event's orbit, `order` times round, over the horizon of a formulation."""
    base, fraction = at_place(curve, _place_of(curve, event)), SYMMETRIES[symmetry].fraction
    here = curve.propagator.symmetry.fraction
    n, period = curve.propagator.size // 2, event.period * event.order
    _, states = full_samples(curve, base)
    count = len(states) - 1
    each = max(1, round(len(event.nodes) / here / 2)) if len(event.nodes) > 1 else 1
    parts = max(1, int(np.ceil(each * event.order * fraction)))
    first = round(share * count)
    chosen = first + np.round(np.arange(parts) * fraction * event.order * count / parts).astype(int)
    laps = chosen // count
    turn = np.concatenate([2 * np.pi * _turns(curve, event) / event.order, np.zeros(n)])
    nodes = states[chosen % count] + laps[:, None] * turn
    if "brake" in symmetry:
        nodes[0, n:] = 0.0
    times = np.round(np.arange(parts) * fraction * event.order * count / parts) / (event.order * count)
    edges = np.append(times, fraction)
    steps = max(24, int(FIRST_STEPS * event.order * fraction / parts))
    pieces = [np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(edges)]
    return Place(nodes, period, np.zeros(0), base.place.free, np.concatenate([[0.0], *pieces]))


def _branch(crossing: Crossing, event: Event, direction: np.ndarray) -> Start | None:
    """The new family in one direction, or None when what is found is the old one or nothing."""
    curve, place = crossing.curve, crossing.place
    head = head_of(direction, place)
    direction = direction / np.sqrt(curve.weights @ head**2)
    normal = curve.weights * head_of(direction, place)
    for length in DISTANCES:
        aim = Aim(float(normal @ place.head) + length, normal)
        try:
            start = corrected(curve, advanced(place, direction, length), aim, place, reach=2 * length)
        except (ConvergenceError, IntegrationError):
            continue
        if event.order > 1 and _is_cover(start, event.order, length):
            continue
        if np.abs(start.found.place.unfolding).max(initial=0.0) > 1e-9:
            continue
        return replace(start, direction=_outwards(start, event))
    return None


def _is_cover(start: Start, order: int, length: float) -> bool:
    """Whether the orbit closes already after a part of its period."""
    _, states = full_samples(start.curve, start.found)
    count = len(states) - 1
    parts = [k for k in range(2, order + 1) if order % k == 0]
    scale = np.sqrt(start.curve.weights[: states.shape[1]])
    returns = [np.abs((_mid(states, count / k) - states[0]) * scale).max() for k in parts]
    return bool(min(returns) < 0.05 * length)


def _mid(states: np.ndarray, place: float) -> np.ndarray:
    low = int(place)
    return np.asarray(states[low] + (place - low) * (states[min(low + 1, len(states) - 1)] - states[low]))


def _outwards(start: Start, event: Event) -> np.ndarray:
    """The direction in which energy (or else the period) moves away from the event's."""
    slopes = parameter_slopes(start.curve, start.found.place, start.direction)
    moved = _moved(start, event)
    name = max(("energy", "period"), key=lambda key: abs(moved[key] * slopes[key]))
    return start.direction if moved[name] * slopes[name] >= 0 else -start.direction


def _moved(start: Start, event: Event) -> dict[str, float]:
    place = start.found.place
    energy = parameter_value(start.curve, place, "energy")
    return {"energy": energy - event.energy, "period": place.period - event.period * event.order}


def _same(one: Start, other: Start, event: Event) -> bool:
    """Whether two starts are mirror images: equal displacement from the event to leading order."""
    if one.curve.propagator.symmetry.name != other.curve.propagator.symmetry.name:
        return False
    a, b = (np.array(list(_moved(start, event).values())) for start in (one, other))
    return bool(np.all(np.abs(a - b) <= 0.1 * np.maximum(np.abs(a), np.abs(b)) + 1e-12))
