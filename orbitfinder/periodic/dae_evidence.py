"""What the second integrator says of an orbit under constraints: other coordinates, no stabilisation.

The finder works on a ConstrainedModel's own balances with Baumgarte terms; this integrates constrained
Hamilton's equations derived from the energies, in the link angles where there are any
(`mechanics.holonomic`), by DOP853 at its tightest, and reads the multipliers on the tangent space.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbitfinder.dae_flow import DaeSettings, simulate_dae
from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.mechanics.constrained import ConstrainedModel
from orbitfinder.mechanics.holonomic import Holonomic, HolonomicEquations, holonomic, holonomic_equations
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.periodic.certify import SAMPLES, Evidence, gap
from orbitfinder.periodic.floquet import analyse, reduce_monodromy
from orbitfinder.periodic.tangent import tangent_basis
from orbitfinder.reference import STEPS_PER_PERIOD, TIGHTEST, ReferenceSettings, VectorField, integrate, vector_field


def gather_constrained(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, settings: ReferenceSettings = TIGHTEST
) -> Evidence:
    """`Evidence` of a state (2n) and a period of the reduced form of a ConstrainedModel; states in its coordinates."""
    native = native_of(model)
    if native.forces is not None:
        raise InputError("certify: systems under constraints are certified when they are conservative, and this is not")
    system = holonomic(native)
    equations = holonomic_equations(system)
    k = system.size
    chosen = np.asarray(state, float)[system.chosen]
    start = np.concatenate([chosen[:k], equations.momentum(chosen[:k], chosen[k:]).full().ravel()])
    times = np.linspace(0.0, period, SAMPLES + 1)
    extended = np.concatenate([start, np.eye(2 * k).ravel("F"), [0.0]])
    path = integrate(vector_field(equations.variational), extended, times[[0, -1]], settings)
    field = vector_field(equations.field)
    momenta = integrate(field, start, times, settings, period / STEPS_PER_PERIOD)
    states = _in_own_coordinates(system, equations, momenta)
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    span = float(np.ptp(potential)) + float(kinetic.max())
    reduced = _on_the_manifold(equations, field, start, path[-1, 2 * k : -1].reshape(2 * k, 2 * k, order="F"))
    return Evidence(
        times=times,
        states=states,
        closure=gap(np.asarray(state, float), states[-1], turns),
        action=float(path[-1, -1]),
        drift=float(np.abs(total - total[0]).max()) / max(span, 1e-300),
        energy=float(total[0]),
        floquet=analyse(reduced[0], conservative=model.conservative),
        trivial=reduced[1],
        symplectic=reduced[2],
    )


def native_of(model: Model) -> ConstrainedModel:
    """The ConstrainedModel behind a Model, with that Model's parameter values."""
    if model.native is None:
        raise InputError("model: has no constraints; build it with linkage(...) or constrained(...), then reduced()")
    return replace(model.native, parameter_values=model.parameter_values)


def _in_own_coordinates(system: Holonomic, equations: HolonomicEquations, momenta: np.ndarray) -> np.ndarray:
    rates = equations.velocity.map(len(momenta))(momenta.T).full()
    places = momenta.T[: system.size]
    return np.asarray(system.lift.map(len(momenta))(places, rates).full().T)


def _on_the_manifold(
    equations: HolonomicEquations, field: VectorField, start: np.ndarray, monodromy: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Reduced monodromy, relative defect of its trivial part and of its symplecticity, on the tangent space.

    With B an orthonormal basis of the tangent space at the start: A = B^T Phi B keeps the flow's direction
    and the energy's gradient, and A^T W A = W for the restricted symplectic form W = B^T J B.
    """
    import casadi as ca

    k = start.size // 2
    basis = tangent_basis(equations.tangent(start).full())
    y = ca.MX.sym("y", start.size)
    gradient = ca.Function("gradient", [y], [ca.gradient(equations.energy(y), y)])(start).full().ravel() @ basis
    flow = field(0.0, start) @ basis
    inner = basis.T @ monodromy @ basis
    scale = max(1.0, float(np.abs(inner).max()))
    form = basis.T @ np.block([[np.zeros((k, k)), np.eye(k)], [-np.eye(k), np.zeros((k, k))]]) @ basis
    defects = [
        np.abs(inner @ flow - flow).max() / max(float(np.abs(flow).max()), 1e-300),
        np.abs(gradient @ inner - gradient).max() / max(float(np.abs(gradient).max()), 1e-300),
    ]
    symplectic = float(np.abs(inner.T @ form @ inner - form).max()) / scale**2
    return reduce_monodromy(inner, gradient[None, :], flow[None, :]), float(max(defects)) / scale, symplectic


def constraint_defect(model: Model, state: np.ndarray) -> float:
    """Largest |phi| and |J v| of a state (2n)."""
    native, n = native_of(model), model.degrees_of_freedom
    phi = native.constraint(state[:n], native.parameter_values).full()
    rate = native.constraint_rate(state[:n], state[n:], native.parameter_values).full()
    return float(max(np.abs(phi).max(), np.abs(rate).max()))


def native_closure(model: Model, state: np.ndarray, period: float, turns: np.ndarray) -> float:
    """Gap round the loop by IDAS on the native DAE; infinite where it cannot integrate."""
    settings = DaeSettings(relative_tolerance=1e-13, absolute_tolerance=1e-13)
    try:
        motion = simulate_dae(native_of(model), state, period, 2, settings)
    except (IntegrationError, InputError):
        return float("inf")
    return gap(motion.states[0], motion.states[-1], turns)
