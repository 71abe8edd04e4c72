"""From a recorded orbit to the theorem's starting point: the symmetric instant, nodes, a section (floats)."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import minimize_scalar

from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import SECOND, integrate, vector_field
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.formulation import PARTS, Formulation
from orbitfinder.records.orbit import Orbit

SCAN = 2000
"""Instants of a period at which a symmetric one is looked for"""


@dataclass(frozen=True)
class Approach:
    """Where the proof starts: the formulation, float nodes (N x 2n), a segment's duration (s), and the
    fraction of the period by which the recorded state comes after the first node.
    """

    formulation: Formulation
    nodes: np.ndarray
    duration: float
    phase: float
    flow: np.ndarray
    """the field (2n) at the first node"""


def approach(model: Model, orbit: Orbit, symmetry: str, segments: int | None) -> Approach:
    """Nodes of the orbit in a formulation, by DOP853 from the recorded state."""
    if symmetry not in PARTS:
        raise InputError(f"symmetry: unknown {symmetry!r}; use one of {', '.join(PARTS)}")
    n, period = model.degrees_of_freedom, orbit.period
    if orbit.state.size != 2 * n or len(orbit.winding) != n:
        raise InputError(f"state: {orbit.state.size} numbers for {n} coordinates; run the problem again")
    if not (np.all(np.isfinite(orbit.state)) and np.isfinite(period) and period > 0):
        raise InputError("state: state or period is not a usable number; run the problem again")
    field = vector_field(_field(model))
    times = np.linspace(0.0, period, SCAN + 1)
    states = integrate(field, orbit.state, times, SECOND)
    begin = symmetric_instant(field, times, states, symmetry, np.asarray(model.angles))
    parts, count = PARTS[symmetry], segments or default_segments(orbit, symmetry)
    grid = begin + np.linspace(0.0, period / parts, count + 1)
    path = integrate(field, orbit.state, np.concatenate([[0.0], grid]) if begin > 0 else grid, SECOND)[-count - 1 :]
    start, target = _multiples(path, symmetry, np.asarray(model.angles), orbit.winding)
    form = Formulation(symmetry, n, count, start, target, tuple(int(k) for k in orbit.winding))
    return Approach(form, path[:-1], period / parts / count, (-begin / period) % 1.0, field(0.0, path[0]))


def _field(model: Model) -> ca.Function:
    n = model.degrees_of_freedom
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2 * n)
    acceleration = model.acceleration(t, x[:n], x[n:], ca.DM(model.parameter_values))
    return ca.Function("plain", [t, x], [ca.vertcat(x[n:], acceleration)])


def default_segments(orbit: Orbit, symmetry: str) -> int:
    """At least two, and so many that none stretches by much more than 30 times."""
    largest = float(np.abs(orbit.floquet_multipliers).max(initial=1.0))
    return 2 + int(np.log(max(largest, 1.0)) / np.log(30.0) / PARTS[symmetry])


def symmetric_instant(field: object, times: np.ndarray, states: np.ndarray, symmetry: str, angles: np.ndarray) -> float:
    """The time (s) of a rest (brake), or of q = k pi (reversal); 0 where any instant will do."""
    if symmetry in ("none", "reflection"):
        return 0.0
    n = angles.size

    def distance(x: np.ndarray) -> float:
        if symmetry == "reversal":
            folded = np.where(angles, (x[:n] + np.pi / 2) % np.pi - np.pi / 2, x[:n])
            return float(np.sum(folded**2))
        return float(np.sum(x[n:] ** 2))

    best = int(np.argmin([distance(x) for x in states[:-1]]))
    first = max(best - 1, 0)

    def at(time: float) -> float:
        if time <= times[first]:
            return distance(states[first])
        return distance(integrate(field, states[first], np.array([times[first], time]), SECOND)[-1])  # type: ignore[arg-type]

    try:
        found = minimize_scalar(
            at, bounds=(times[first], times[best + 1]), method="bounded", options={"xatol": 1e-9 * times[-1]}
        )
    except IntegrationError:
        return float(times[best])
    return float(found.x) if found.fun < distance(states[best]) else float(times[best])


def _multiples(
    path: np.ndarray, symmetry: str, angles: np.ndarray, winding: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Multiples of pi held at the start, and those in the conditions at the end."""
    n = angles.size
    zero = (0,) * n

    def nearest(x: np.ndarray) -> tuple[int, ...]:
        return tuple(round(a / np.pi) if angle else 0 for a, angle in zip(x[:n], angles, strict=True))

    if symmetry == "none":
        return zero, tuple(2 * int(k) for k in winding)
    if symmetry == "reflection":
        return zero, tuple(2 * round(k / 2) for k in nearest(path[-1] + path[0]))
    if symmetry == "brake":
        return zero, zero
    if symmetry == "reversal":
        start = nearest(path[0])
        return start, tuple(k + int(w) for k, w in zip(start, winding, strict=True))
    return zero, nearest(path[-1])
