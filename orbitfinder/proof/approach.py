"""From a recorded orbit to the theorem's starting point: the symmetric instant, nodes, a section (floats)."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import minimize_scalar

from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import SECOND, integrate, vector_field
from orbitfinder.loops.symmetry import Symmetry, off_centre
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.formulation import Formulation
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


def approach(model: Model, orbit: Orbit, symmetry: Symmetry, segments: int | None) -> Approach:
    """Nodes of the orbit in a formulation, by DOP853 from the recorded state."""
    n, period = model.degrees_of_freedom, orbit.period
    if orbit.state.size != 2 * n or len(orbit.winding) != n:
        raise InputError(f"state: {orbit.state.size} numbers for {n} coordinates; run the problem again")
    if not (np.all(np.isfinite(orbit.state)) and np.isfinite(period) and period > 0):
        raise InputError("state: state or period is not a usable number; run the problem again")
    field = vector_field(_field(model))
    times = np.linspace(0.0, period, SCAN + 1)
    states = integrate(field, orbit.state, times, SECOND)
    angles = np.asarray(model.angles)
    begin = symmetric_instant(field, times, states, symmetry, angles)
    parts, count = symmetry.parts, segments or default_segments(orbit, symmetry)
    grid = begin + np.linspace(0.0, period / parts, count + 1)
    path = integrate(field, orbit.state, np.concatenate([[0.0], grid]) if begin > 0 else grid, SECOND)[-count - 1 :]
    constants = symmetry.constants(angles, path[0], path[-1], orbit.winding) / np.pi
    form = Formulation(symmetry, n, count, tuple(map(round, constants)), tuple(int(k) for k in orbit.winding))
    return Approach(form, path[:-1], period / parts / count, (-begin / period) % 1.0, field(0.0, path[0]))


def _field(model: Model) -> ca.Function:
    n = model.degrees_of_freedom
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2 * n)
    acceleration = model.acceleration(t, x[:n], x[n:], ca.DM(model.parameter_values))
    return ca.Function("plain", [t, x], [ca.vertcat(x[n:], acceleration)])


def default_segments(orbit: Orbit, symmetry: Symmetry) -> int:
    """At least two, and so many that none stretches by much more than 30 times."""
    largest = float(np.abs(orbit.floquet_multipliers).max(initial=1.0))
    return 2 + int(np.log(max(largest, 1.0)) / np.log(30.0) / symmetry.parts)


def symmetric_instant(
    field: object, times: np.ndarray, states: np.ndarray, symmetry: Symmetry, angles: np.ndarray
) -> float:
    """The time (s) at which the horizon may start, a rest (brake) for example; 0 where any instant will do."""
    if not symmetry.reverses:
        return 0.0

    def distance(x: np.ndarray) -> float:
        return float(np.sum(off_centre(symmetry.maps[0], x[None], angles) ** 2))

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
