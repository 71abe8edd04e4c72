"""Switching to the families that leave another one at a branch point, a period doubling or a resonance.

At a critical multiplier exp(2 pi i k / q) of an orbit of period T there are orbits of period q T that
leave it along the real part of exp(i phi) u, u the eigenvector of the monodromy: for q <= 2 one
direction, otherwise a circle of them on which a few phases phi are singled out. They are looked for in
the full formulation, at a small distance, orthogonally to the family they leave (E. L. Allgower,
K. Georg, Introduction to Numerical Continuation Methods (2003), section 8.3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.families.events import parameter_slopes
from orbitfinder.families.points import Event, FamilySettings, parameter_value
from orbitfinder.families.propagate import build_propagator, march
from orbitfinder.families.stability import critical_vectors, spectrum
from orbitfinder.families.start import (
    FIRST_STEPS,
    Start,
    corrected,
    curve_at,
    full_samples,
    reformulated,
    symmetry_of,
    unknown_parameters,
)
from orbitfinder.families.system import Aim, Curve, Place, Solution, at_place, head_of
from orbitfinder.mechanics.model import Model
from orbitfinder.periodic.problem import Guess, Problem

SWITCHABLE = ("branch_point", "period_doubling", "resonance")
DISTANCES = (0.02, 0.05, 0.1, 0.2)
"""How far from the old family, in its metric, the new one is looked for; the first that succeeds is taken."""


def switch(curve: Curve, event: Event, settings: FamilySettings | None = None) -> list[Start]:
    """Starts of the families that leave at an event, each directed away from it, duplicates removed.

    `curve` is the one that the event was found on. Raises `InputError` for other kinds of events; an
    empty list says that no branch was found.
    """
    if event.kind not in SWITCHABLE:
        raise InputError(f"event: cannot switch at a {event.kind}; choose one of {', '.join(SWITCHABLE)}")
    settings = settings or FamilySettings()
    place = Place(event.nodes, event.period, np.zeros(curve.propagator.unfolding), np.array(list(event.free.values())), event.mesh)
    base = at_place(curve, place)
    found: list[Start] = []
    for direction in _directions(curve, base, event):
        start = _nearest(curve, base, event, direction, settings)
        if start is not None and not any(_same(start, other) for other in found):
            found.append(start)
    return found


def _directions(curve: Curve, base: Solution, event: Event) -> Iterator[np.ndarray]:
    """Unit directions in state space: both signs of the eigenvector, or phases round its circle."""
    size = curve.propagator.size
    vectors = critical_vectors(spectrum(curve, base), event.multiplier)
    scale = np.sqrt(curve.weights[:size])
    if len(vectors) == 1:
        phases = [1.0 + 0.0j, -1.0 + 0.0j]
    else:
        count = 4 * event.order
        phases = [complex(np.exp(2j * np.pi * k / count)) for k in range(count)]
    for phase in phases:
        direction = phase.real * vectors[0] + (phase.imag * vectors[1] if len(vectors) > 1 else 0.0)
        yield direction / np.linalg.norm(direction * scale)


def _nearest(
    curve: Curve, base: Solution, event: Event, direction: np.ndarray, settings: FamilySettings
) -> Start | None:
    for length in DISTANCES:
        try:
            start = _branch(curve, base, event, direction, length, settings)
        except (ConvergenceError, IntegrationError):
            continue
        if start is not None:
            return start
    return None


def _branch(
    curve: Curve, base: Solution, event: Event, direction: np.ndarray, length: float, settings: FamilySettings
) -> Start | None:
    """The new family at a distance from the old one, or None when what is found is the old one."""
    model, size = curve.propagator.model, curve.propagator.size
    free, held = unknown_parameters(model, settings)
    full, place = _repeated(curve, base, event, free, held)
    along = np.concatenate([event.tangent[:size], [event.order * event.tangent[size]], event.tangent[size + 1 :]])
    away = np.concatenate([direction, np.zeros(along.size - size)])
    away = away - along * np.sum(full.weights * along * away) / np.sum(full.weights * along**2)
    normal = full.weights * away / np.sqrt(np.sum(full.weights * away**2))
    guess = replace(place, nodes=place.nodes + length * _carried(full, place, direction))
    aim = Aim(float(normal @ place.head) + length, normal)
    start = corrected(full, guess, aim, place, reach=3 * length)
    if event.order > 1 and _is_cover(start, event.order, length):
        return None
    symmetry = symmetry_of(full, start.found)
    if symmetry != "none":
        start = reformulated(start, symmetry, free, held)
        if symmetry == curve.propagator.symmetry.name and event.order == 1:
            return None
    return replace(start, direction=_outwards(start, event))


def _repeated(
    curve: Curve, base: Solution, event: Event, free: tuple[str, ...], held: tuple[str, ...]
) -> tuple[Curve, Place]:
    """The orbit of the event, `order` times round, in the full formulation."""
    model, order = curve.propagator.model, event.order
    fraction = curve.propagator.symmetry.fraction
    parts = max(1, round(len(base.place.nodes) / fraction / 2)) if len(base.place.nodes) > 1 else 1
    _, states = full_samples(curve, base)
    turns = np.round((states[-1] - states[0]) / (2 * np.pi)) * np.array([1.0] * model.degrees_of_freedom + [0.0] * model.degrees_of_freedom)
    chosen = (np.arange(parts) * (len(states) - 1) / parts).astype(int)
    nodes = np.vstack([states[chosen] + 2 * np.pi * turns * k for k in range(order)])
    period = event.period * order
    winding = tuple(int(k) for k in turns[: model.degrees_of_freedom] * order)
    problem = Problem(model, Guess(nodes[0], period), winding=winding if any(winding) else None)
    propagator = build_propagator(model, "none", free)
    mesh = np.linspace(0.0, 1.0, len(nodes) * max(24, FIRST_STEPS // parts) + 1)
    place = Place(nodes, period, np.zeros(propagator.unfolding), base.place.free, mesh)
    full = curve_at(problem, propagator, place, held)
    return replace(full, weights=curve.weights.copy()), place


def _carried(curve: Curve, place: Place, direction: np.ndarray) -> np.ndarray:
    """A displacement of x(0) carried along to every node by the linearised flow (N x 2n)."""
    size = curve.propagator.size
    path = march(curve.propagator, place.nodes, place.mesh, place.tail)
    found = [direction]
    for block in path.sensitivities[:-1]:
        found.append(block[:, :size] @ found[-1])
    return np.asarray(found)


def _is_cover(start: Start, order: int, length: float) -> bool:
    """Whether the orbit closes already after a part of its period."""
    _, states = full_samples(start.curve, start.found)
    count = len(states) - 1
    parts = [k for k in range(2, order + 1) if order % k == 0]
    n = states.shape[1] // 2
    returns = [np.abs(states[count // k, :n] - states[0, :n]).max() for k in parts]
    rates = [np.abs(states[count // k, n:] - states[0, n:]).max() for k in parts]
    clock = np.sqrt(start.curve.weights[n])
    return bool(min(max(a, b * clock) for a, b in zip(returns, rates, strict=True)) < 0.05 * length)


def _outwards(start: Start, event: Event) -> np.ndarray:
    """The direction in which energy (or else the period) moves away from the event's."""
    slopes = parameter_slopes(start.curve, start.found.place, start.direction)
    place = start.found.place
    moved = {
        "energy": parameter_value(start.curve, place, "energy") - event.energy,
        "period": place.period - event.period * event.order,
    }
    name = max(moved, key=lambda key: abs(moved[key] * slopes[key]))
    return start.direction if moved[name] * slopes[name] >= 0 else -start.direction


def _same(one: Start, other: Start) -> bool:
    """Whether two starts are one orbit but for phase, reflection or direction of motion."""
    def numbers(start: Start) -> np.ndarray:
        place = start.found.place
        action = start.found.march.action / start.curve.propagator.symmetry.fraction
        return np.array([parameter_value(start.curve, place, "energy"), place.period, action])

    a, b = numbers(one), numbers(other)
    return bool(np.all(np.abs(a - b) < 1e-6 * np.maximum(1.0, np.abs(a))))


__all__ = ["SWITCHABLE", "head_of", "switch"]


def curve_of(model: Model, symmetry: str, free: tuple[str, ...], place: Place) -> Curve:
    """A curve through a stored place in its own formulation."""
    problem = Problem(model, Guess(place.nodes[0], place.period), symmetry=symmetry)
    return curve_at(problem, build_propagator(model, symmetry, free), place, ())
