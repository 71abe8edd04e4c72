"""What the second integrator says of an orbit under constraints: other coordinates, no stabilisation.

The finder works on the Model's own balances with Baumgarte terms; this integrates constrained
Hamilton's equations derived from the energies, in the link angles where there are any
(`mechanics.holonomic`), by DOP853 at its tightest, and reads the multipliers on the tangent space.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import STEPS_PER_PERIOD, TIGHTEST, ReferenceSettings, vector_field
from orbitfinder.integrate.idas import DaeSettings, simulate_dae
from orbitfinder.mechanics.holonomic import Holonomic, HolonomicEquations, holonomic, holonomic_equations
from orbitfinder.mechanics.model import Model, constraint_of
from orbitfinder.orbits.evidence import Motion, integrate_in, masses_of, pieces_of, relative_gap, units_of


def constrained_motion(
    model: Model,
    state: np.ndarray,
    period: float,
    turns: np.ndarray,
    moments: np.ndarray,
    settings: ReferenceSettings = TIGHTEST,
) -> Motion:
    """The `Motion` of a state (2n) of a Model under constraints; states in its own coordinates."""
    if model.forces is not None:
        raise InputError("certify: systems under constraints are certified when they are conservative, and this is not")
    system = holonomic(model)
    equations = holonomic_equations(system)
    k = system.size
    chosen = np.asarray(state, float)[system.chosen]
    start = np.concatenate([chosen[:k], equations.momentum(chosen[:k], chosen[k:]).full().ravel()])
    field, masses = vector_field(equations.field), masses_of(system.kinetic, chosen)
    units = units_of(field, start, masses, period)
    path = integrate_in(units, field, start, moments, settings, period / STEPS_PER_PERIOD)
    transitions, action = pieces_of(vector_field(equations.variational), start, units, period)
    y = ca.MX.sym("y", start.size)
    gradient = ca.Function("gradient", [y], [ca.gradient(equations.energy(y), y)])(start).full().ravel()
    rate = field(0.0, start)
    return Motion(
        moments, _in_own_coordinates(system, equations, path), path, transitions, action, rate, gradient[None, :],
        rate[None, :], masses, turns[system.chosen[:k]], constraints=equations.tangent(start).full(),
    )  # fmt: skip


def _in_own_coordinates(system: Holonomic, equations: HolonomicEquations, momenta: np.ndarray) -> np.ndarray:
    rates = equations.velocity.map(len(momenta))(momenta.T).full()
    places = momenta.T[: system.size]
    return np.asarray(system.lift.map(len(momenta))(places, rates).full().T)


def constraint_defect(model: Model, state: np.ndarray, units: np.ndarray) -> float:
    """Largest |phi| and |J v| of a state (2n), relative to its lengths and to the rates' extents, `units` (2n)."""
    constraint, n, p = constraint_of(model), model.degrees_of_freedom, model.parameter_values
    q, v = state[:n], state[n:]
    phi, rate = constraint.phi(q, p).full(), constraint.rate(q, v, p).full()
    length = float(np.abs(q[~np.asarray(model.angles)]).max(initial=0.0)) or 1.0
    slopes = np.abs(constraint.jacobian(q, p).full()).max()
    return max(float(np.abs(phi).max()) / length, float(np.abs(rate).max()) / (slopes * units[n:].max()))


def native_closure(model: Model, state: np.ndarray, period: float, turns: np.ndarray, units: np.ndarray) -> float:
    """Gap round the loop in `units` (2n) by IDAS on the native DAE; infinite where it cannot integrate."""
    settings = DaeSettings(relative_tolerance=1e-13, absolute_tolerance=1e-13)
    try:
        motion = simulate_dae(model, state, period, 2, settings)
    except (IntegrationError, InputError):
        return float("inf")
    return relative_gap(motion.states[0], motion.states[-1], turns, units)
