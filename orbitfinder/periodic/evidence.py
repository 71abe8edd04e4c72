"""The evidence of a certificate: a state and a period integrated and measured by other means.

The finder integrates accelerations with CVODES; here it is Hamilton's equations, derived from the
energies alone, with DOP853 at its tightest, and no unfolding term.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from orbitfinder.mechanics.model import Model, energies
from orbitfinder.periodic.floquet import Floquet, analyse, reduce_monodromy
from orbitfinder.periodic.hamilton import hamilton
from orbitfinder.reference import STEPS_PER_PERIOD, TIGHTEST, ReferenceSettings, integrate, vector_field

SAMPLES = 512
"""Intervals at which the certifying integration is inspected."""
FEWEST_LINKS = 11
"""Chains from this length on are long: Hamilton's equations as one graph take seconds to derive, later minutes."""


@dataclass(frozen=True)
class Evidence:
    """What the second integrator on the second formulation says of a state and a period."""

    times: np.ndarray
    states: np.ndarray
    closure: float
    action: float
    drift: float
    energy: float
    trivial: float
    symplectic: float
    floquet: Floquet
    formulation: str = "Hamilton's equations"


def gather(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, settings: ReferenceSettings = TIGHTEST
) -> Evidence:
    """Integrate Hamilton's equations with their variations once round and measure (see `Evidence`)."""
    if model.native is not None:
        from orbitfinder.periodic.dae_evidence import gather_constrained

        return gather_constrained(model, state, period, turns, settings)
    if is_long(model):
        from orbitfinder.periodic.chain_evidence import gather_chain

        return gather_chain(model, state, period, turns, settings)
    n = model.degrees_of_freedom
    equations = hamilton(model)
    values = model.parameter_values
    start = np.concatenate([state[:n], equations.momentum(state[:n], state[n:]).full().ravel()])
    times = np.linspace(0.0, period, SAMPLES + 1)
    extended = np.concatenate([start, np.eye(2 * n).ravel("F"), [0.0]])
    path = integrate(vector_field(equations.variational), extended, times[[0, -1]], settings)
    field = vector_field(equations.field)
    momenta = integrate(field, start, times, settings, period / STEPS_PER_PERIOD)
    states = _velocities(momenta, field, n)
    monodromy = path[-1, 2 * n : -1].reshape(2 * n, 2 * n, order="F")
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    gradients, directions = _invariant_frame(model, start, field)
    reduced = reduce_monodromy(monodromy, gradients, directions)
    floquet = analyse(reduced, conservative=model.conservative)
    scale = max(1.0, float(np.abs(monodromy).max()))
    span = float(np.ptp(potential)) + float(kinetic.max())
    return Evidence(
        times=times,
        states=states,
        closure=gap(states[0], states[-1], turns),
        action=float(path[-1, -1]),
        drift=float(np.abs(total - total[0]).max()) / max(span, 1e-3 * float(np.abs(potential).max()), 1e-300),
        energy=float(model.kinetic(state[:n], state[n:], values)) + float(model.potential(state[:n], values)),
        trivial=_trivial_defect(monodromy, gradients, directions) / scale,
        symplectic=_symplectic_defect(monodromy) / scale**2 if model.forces is None else 0.0,
        floquet=floquet,
    )


def is_long(model: Model) -> bool:
    """True for chains that are certified on Lagrange's equations in closed form (see `chain_evidence`)."""
    plain = model.forces is None and model.gyroscopic is None and not model.forced
    return plain and model.system.get("kind") == "chain" and model.degrees_of_freedom >= FEWEST_LINKS


def _velocities(momenta: np.ndarray, field: object, n: int) -> np.ndarray:
    """States (q, v) from canonical states; dH/dp, the first half of the field, is the velocity."""
    rates = np.stack([field(0.0, row)[:n] for row in momenta])  # type: ignore[operator]
    return np.hstack([momenta[:, :n], rates])


def gap(start: np.ndarray, end: np.ndarray, turns: np.ndarray) -> float:
    """Largest component of x(T) - x(0) - 2 pi k."""
    shift = np.concatenate([2 * np.pi * turns, np.zeros(start.size - turns.size)])
    return float(np.abs(end - start - shift).max())


def _invariant_frame(model: Model, start: np.ndarray, field: object) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the invariants and the symmetry directions (flow, unless forced, first) at a canonical state.

    Each gradient comes from the direction that it generates without forces: X = J grad I, so
    grad I = -J X.
    """
    n = model.degrees_of_freedom
    flow = field(0.0, start)  # type: ignore[operator]
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


def _trivial_defect(monodromy: np.ndarray, gradients: np.ndarray, directions: np.ndarray) -> float:
    """How far Phi f = f and grad I Phi = grad I are from true, relative."""
    def relative(found: np.ndarray, wanted: np.ndarray) -> float:
        return float(np.abs(found - wanted).max() / max(np.abs(wanted).max(), 1e-300)) if wanted.size else 0.0

    return max(relative(directions @ monodromy.T, directions), relative(gradients @ monodromy, gradients))


def _symplectic_defect(monodromy: np.ndarray) -> float:
    n = monodromy.shape[0] // 2
    unit = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return float(np.abs(monodromy.T @ unit @ monodromy - unit).max())
