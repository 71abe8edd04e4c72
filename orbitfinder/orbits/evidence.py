"""The evidence of a certificate: a state and a period integrated and measured by other means.

The finder integrates accelerations with CVODES; here it is Hamilton's equations, derived from the
energies alone, with DOP853 at its tightest, and no unfolding term. Lengths, momenta and the time are
measured in extents of the motion, so that the answer does not depend on the units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from orbitfinder.integrate.dop853 import (
    STEPS_PER_PERIOD,
    TIGHTEST,
    ReferenceSettings,
    VectorField,
    integrate,
    scaled,
    vector_field,
)
from orbitfinder.mechanics.constrained import tangent_basis
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.orbits.closure import Closure, closes, extents
from orbitfinder.orbits.floquet import Floquet, analyse, reduce_monodromy
from orbitfinder.orbits.hamilton import hamilton

SAMPLES = 512
"""Intervals at which the certifying integration is inspected."""
PIECES = 16
"""State-transition matrices in a period: where an error may be made that is carried to the end"""
FEWEST_LINKS = 11
"""Chains from this length on are long: Hamilton's equations as one graph take seconds to derive, later minutes."""
VARIED = ReferenceSettings(relative_tolerance=1e-13, absolute_tolerance=1e-14)
"""For the state-transition matrices: of orbits with multipliers of 5e5, 1e-12 leaves the trivial ones wrong by 2e-8"""
ROUGH = ReferenceSettings(relative_tolerance=1e-10, absolute_tolerance=1e-13)
"""For the extents of the motion, before there are any."""


@dataclass(frozen=True)
class Motion:
    """What a formulation finds: a motion in coordinates y = (q, p) (m numbers) and its state-transition matrices.

    `states` (k x 2n) are those of the model at `times`, `path` (k x m) the same in y, `masses` (m / 2) the
    diagonal of its mass matrix, `constraints` (r x m) the gradients of what y is held to, `rate` y' at the start.
    """

    times: np.ndarray
    states: np.ndarray
    path: np.ndarray
    transitions: Sequence[np.ndarray]
    action: float
    rate: np.ndarray
    gradients: np.ndarray
    directions: np.ndarray
    masses: np.ndarray
    turns: np.ndarray
    formulation: str = "Hamilton's equations"
    constraints: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class Evidence:
    """What the second integrator on the second formulation says of a state and a period.

    `times` are equally spaced; `closes` measures the gap in extents, `closure` in the model's units (its largest
    component); `exchanged` is the energy (J) that `drift` is relative to, `extents` (2n) those of the motion,
    `growth` the largest |S^-1 Phi(t, s) S| of all s < t, and `reached` the states at
    further moments that were asked for.
    """

    times: np.ndarray
    states: np.ndarray
    closes: Closure
    closure: float
    action: float
    drift: float
    energy: float
    exchanged: float
    extents: np.ndarray
    growth: float
    trivial: float
    symplectic: float
    floquet: Floquet
    reached: np.ndarray
    formulation: str = "Hamilton's equations"


def evenly(period: float) -> np.ndarray:
    """The times (SAMPLES + 1) at which a motion is inspected."""
    return np.linspace(0.0, period, SAMPLES + 1)


def measured(
    model: Model, motion: Motion, state: np.ndarray, period: float, turns: np.ndarray, moments: np.ndarray
) -> Evidence:
    """The `Evidence` of a motion: everything in its own extents, multipliers on the tangent space."""
    at = np.searchsorted(motion.times, evenly(period))
    path, states = motion.path[at], motion.states[at]
    units = _in_momenta(np.ptp(path, axis=0), motion.masses, period)
    sizes = np.maximum(np.abs(path).max(axis=0) / units, 1.0)
    pieces = [piece * units[None, :] / units[:, None] for piece in motion.transitions]
    gradients, directions = motion.gradients * units, motion.directions / units
    gap_there = (path[-1] - path[0] - _shift(motion.turns, units.size)) / units
    found = closes(gap_there, pieces, sizes, None if model.forced else motion.rate * period / units)
    monodromy, growth = _products(pieces)
    basis = tangent_basis(motion.constraints * units) if motion.constraints.size else np.eye(units.size)
    inner, gradients, directions = basis.T @ monodromy @ basis, gradients @ basis, directions @ basis
    scale = max(1.0, float(np.abs(inner).max()))
    form = basis.T @ _symplectic_unit(units) @ basis
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    exchanged = max(float(np.ptp(potential)) + float(kinetic.max()), 1e-3 * float(np.abs(potential).max()), 1e-300)
    return Evidence(
        times=motion.times[at],
        states=states,
        closes=found,
        closure=gap(np.asarray(state, float), states[-1], turns),
        action=motion.action,
        drift=float(np.abs(total - total[0]).max()) / exchanged,
        energy=float(total[0]),
        exchanged=exchanged,
        extents=extents_of(model, states, period),
        growth=growth,
        trivial=max(_off(directions @ inner.T, directions), _off(gradients @ inner, gradients)) / scale,
        symplectic=float(np.abs(inner.T @ form @ inner - form).max()) / (scale**2 * float(np.abs(form).max())),
        floquet=analyse(reduce_monodromy(inner, gradients, directions), conservative=model.conservative),
        reached=motion.states[np.searchsorted(motion.times, moments)],
        formulation=motion.formulation,
    )


def _products(pieces: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Phi(T, 0) and the largest norm of Phi(t, s) between the ends of any two pieces."""
    largest, whole = 1.0, np.eye(len(pieces[0]))
    for begin in reversed(range(len(pieces))):
        whole = np.eye(len(pieces[0]))
        for piece in pieces[begin:]:
            whole = piece @ whole
            largest = max(largest, float(np.linalg.norm(whole)))
    return whole, largest


def extents_of(model: Model, states: np.ndarray, period: float) -> np.ndarray:
    """Extents (2n) of a motion of a Model (k x 2n) over its period."""
    moved, rushed = np.split(np.ptp(states, axis=0), 2)
    return np.concatenate(extents(moved, rushed, masses_of(model.kinetic, states[0], model), period))


def masses_of(kinetic: ca.Function, state: np.ndarray, model: Model | None = None) -> np.ndarray:
    """Diagonal (n) of the mass matrix at a state (2n): twice the kinetic energy of each unit velocity."""
    n = state.size // 2
    given = [] if model is None else [model.parameter_values]
    return np.array([2.0 * float(kinetic(state[:n], unit, *given)) for unit in np.eye(n)])


def _shift(turns: np.ndarray, size: int) -> np.ndarray:
    return np.concatenate([2 * np.pi * turns, np.zeros(size - turns.size)])


def _symplectic_unit(units: np.ndarray) -> np.ndarray:
    """S J S for the extents S of (q, p)."""
    half = units.size // 2
    areas = np.diag(units[:half] * units[half:])
    return np.block([[np.zeros((half, half)), areas], [-areas, np.zeros((half, half))]])


def _off(found: np.ndarray, wanted: np.ndarray) -> float:
    """How far rows are from what they should be, relative."""
    return float(np.abs(found - wanted).max() / max(np.abs(wanted).max(), 1e-300)) if wanted.size else 0.0


def hamiltonian_motion(
    model: Model,
    state: np.ndarray,
    period: float,
    turns: np.ndarray,
    moments: np.ndarray,
    settings: ReferenceSettings = TIGHTEST,
) -> Motion:
    """The `Motion` of a state (2n) at `moments` (from 0 to the period) by Hamilton's equations."""
    n = model.degrees_of_freedom
    equations = hamilton(model)
    start = np.concatenate([state[:n], equations.momentum(state[:n], state[n:]).full().ravel()])
    field = vector_field(equations.field)
    masses = masses_of(model.kinetic, state, model)
    units = units_of(field, start, masses, period)
    path = integrate_in(units, field, start, moments, settings, period / STEPS_PER_PERIOD)
    transitions, action = pieces_of(vector_field(equations.variational), start, units, period)
    gradients, directions = _invariant_frame(model, start, field)
    return Motion(
        moments, _velocities(path, field, n), path, transitions, action, field(0.0, start), gradients, directions,
        masses, turns,
    )  # fmt: skip


def units_of(field: VectorField, start: np.ndarray, masses: np.ndarray, period: float) -> np.ndarray:
    """Extents (m) of the motion in y = (q, p) from a start, by a quick integration.

    That one is measured in a first guess of them, |y| + T |y'| + T^2 |y''| at the start.
    """
    rate, nudge = field(0.0, start), 1e-4 * period
    turned = np.abs(field(nudge, start + nudge * rate) - rate) * (period / nudge)
    first = np.abs(start) + period * np.abs(rate) + period * np.where(np.isfinite(turned), turned, 0.0)
    if not np.all(np.isfinite(first) & (first < 1e100)):
        return np.ones(start.size)
    units = _in_momenta(first, masses, period)
    path = integrate_in(units, field, start, np.linspace(0.0, period, 65), ROUGH)
    return _in_momenta(np.ptp(path, axis=0), masses, period)


def _in_momenta(moved: np.ndarray, masses: np.ndarray, period: float) -> np.ndarray:
    """`extents` in (q, p) of what moved so far in (q, p)."""
    places, momenta = np.split(moved, 2)
    lengths, speeds = extents(places, momenta / np.maximum(masses, 1e-300), masses, period)
    return np.concatenate([lengths, np.where(masses > 0, masses, 1.0) * speeds])


def integrate_in(
    units: np.ndarray,
    field: VectorField,
    start: np.ndarray,
    times: np.ndarray,
    settings: ReferenceSettings = TIGHTEST,
    longest_step: float = np.inf,
) -> np.ndarray:
    """`integrate` with the components measured in `units`; states in their own."""
    return integrate(scaled(field, units), start / units, times, settings, longest_step) * units


def pieces_of(
    variational: VectorField, start: np.ndarray, units: np.ndarray, period: float
) -> tuple[list[np.ndarray], float]:
    """State-transition matrices (m x m) of equal pieces of a period, and the action."""
    size, now, action = start.size, start, 0.0
    matrix = (units[:, None] / units[None, :]).ravel("F")
    work = float(units[: size // 2] @ units[size // 2 :]) or 1.0
    measures, pieces = np.concatenate([units, matrix, [work]]), []
    for k in range(PIECES):
        extended = np.concatenate([now, np.eye(size).ravel(), [0.0]])
        span = period * np.array([k, k + 1]) / PIECES
        end = integrate_in(measures, variational, extended, span, VARIED)[-1]
        pieces.append(end[size:-1].reshape(size, size, order="F"))
        now, action = end[:size], action + float(end[-1])
    return pieces, action


def is_long(model: Model) -> bool:
    """True for chains that are certified on Lagrange's equations in closed form (see `chain_evidence`)."""
    plain = model.forces is None and model.gyroscopic is None and not model.forced
    return plain and model.system.get("kind") == "chain" and model.degrees_of_freedom >= FEWEST_LINKS


def _velocities(momenta: np.ndarray, field: VectorField, n: int) -> np.ndarray:
    """States (q, v) from canonical states; dH/dp, the first half of the field, is the velocity."""
    rates = field.many(np.zeros(len(momenta)), momenta)  # type: ignore[attr-defined]
    return np.hstack([momenta[:, :n], rates[:, :n]])


def gap(start: np.ndarray, end: np.ndarray, turns: np.ndarray) -> float:
    """Largest component of x(T) - x(0) - 2 pi k."""
    return float(np.abs(end - start - _shift(turns, start.size)).max())


def relative_gap(start: np.ndarray, end: np.ndarray, turns: np.ndarray, units: np.ndarray) -> float:
    """The same with each component in its unit."""
    return float(np.abs((end - start - _shift(turns, start.size)) / units).max())


def _invariant_frame(model: Model, start: np.ndarray, field: VectorField) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the invariants and the symmetry directions (flow, unless forced, first) at a canonical state.

    Each gradient comes from the direction that it generates without forces: X = J grad I, so
    grad I = -J X.
    """
    n = model.degrees_of_freedom
    flow = field(0.0, start)
    turns = []
    for one in model.invariants:
        if one.generator is not None:
            turn = one.generator(start[:n], flow[:n], model.parameter_values).full().ravel()
            turns.append(np.concatenate([turn[:n], _momentum_change(model, start[:n], flow[:n], turn)]))
    directions = np.asarray([*([] if model.forced else [flow]), *turns]).reshape(-1, 2 * n)
    free = flow if model.forces is None else hamilton(replace(model, forces=None)).field(0.0, start).full().ravel()
    conserved = np.asarray([*([free] if model.conservative else []), *turns]).reshape(-1, 2 * n)
    return np.hstack([-conserved[:, n:], conserved[:, :n]]), directions


def _momentum_change(model: Model, q: np.ndarray, v: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """d(momentum) along a direction (2n) of (q, v): zero for translations, not for rotations."""
    n = q.size
    x = ca.MX.sym("x", 2 * n)
    change = ca.jtimes(hamilton(model).momentum(x[:n], x[n:]), x, ca.DM(turn))
    return np.asarray(ca.Function("change", [x], [change])(np.concatenate([q, v])).full().ravel())
