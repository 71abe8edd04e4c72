"""Starting points for linkages that need no search: equilibria, linear normal modes, a return of the motion.

With L(theta, mu) = V(theta) + mu.phi(theta): an equilibrium has grad L = 0 and phi = 0, and its small
motions are those of Z^T (d2L/dtheta2) Z u = w^2 Z^T M Z u, Z a basis of the null space of J.
Source: J. Nocedal, S. J. Wright, Numerical Optimization, section 18.1 (the reduced Hessian).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.integrate.idas import simulate_dae
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.constrained import tangent_basis
from orbitfinder.mechanics.holonomic import holonomic
from orbitfinder.mechanics.linkage import assemble, check_regular, dimensions, linkage_state
from orbitfinder.mechanics.model import Model

STARTS = 24
"""Assemblies, drawn with a fixed seed, from which the lowest equilibrium is looked for."""
NEWTON_STEPS = 60
NEAR_RETURN = 0.1
"""A motion has come back when it is this near its start, relative to its extent."""


def linkage_equilibrium(model: Model, guess: Sequence[float] | np.ndarray | None = None) -> np.ndarray:
    """Link angles (n, rad) of an equilibrium: the stationary point near `guess`, or the lowest one found.

    Without a guess the potential is minimised on the constraint from some two dozen assemblies. Raises
    `InputError` when Newton's method finds none.
    """
    if guess is not None:
        return _stationary(model, np.asarray(guess, float))
    lengths, ground = dimensions(model)
    random = np.random.default_rng(0)
    down = holonomic(model).potential
    found = []
    for _ in range(STARTS):
        start = np.arctan2(ground[1], ground[0]) + random.uniform(-np.pi, np.pi, lengths.size)
        try:
            theta = _stationary(model, _descended(model, assemble(model, {}, guess=start)))
        except InputError:
            continue
        found.append((float(down(theta)), theta))
    if not found:
        raise InputError("linkage: no equilibrium found; give angles near one as guess=")
    theta = min(found, key=lambda entry: entry[0])[1]
    return np.asarray((theta + np.pi) % (2 * np.pi) - np.pi)


def linkage_modes(
    model: Model, equilibrium: Sequence[float] | np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Squared angular frequencies (n - 2, rad^2/s^2, slowest first) and shapes (n x n-2) in the link angles."""
    from scipy.linalg import eigh

    theta = linkage_equilibrium(model) if equilibrium is None else np.asarray(equilibrium, float)
    _, jacobian, hessian, _, mass = _terms(model, theta)
    basis = tangent_basis(jacobian)
    squared, shapes = eigh(basis.T @ hessian @ basis, basis.T @ mass @ basis)
    return np.asarray(squared), np.asarray(basis @ shapes)


def linkage_mode(
    model: Model, mode: int, amplitude: float, equilibrium: Sequence[float] | np.ndarray | None = None
) -> Guess:
    """Guess on a linear normal mode, at rest at its turning point: `mode` from 1, largest angle `amplitude` (rad)."""
    theta = linkage_equilibrium(model) if equilibrium is None else np.asarray(equilibrium, float)
    squared, shapes = linkage_modes(model, theta)
    if isinstance(mode, bool) or not 1 <= mode <= squared.size:
        raise InputError(
            f"guess.mode: must be between 1 and {squared.size}, got {mode}; this linkage has {squared.size} modes"
        )
    if not (np.isfinite(amplitude) and amplitude != 0):
        raise InputError(f"guess.amplitude: must be finite and not 0, got {amplitude}; give an angle in rad")
    if squared[mode - 1] <= 0:
        raise InputError(f"guess.mode: mode {mode} does not oscillate (squared frequency {squared[mode - 1]:.3g})")
    shape = shapes[:, mode - 1]
    moved = theta + amplitude * shape / shape[np.abs(shape).argmax()]
    state = linkage_state(model, assemble(model, {}, guess=moved))
    return Guess(state, 2 * np.pi / float(np.sqrt(squared[mode - 1])))


def first_return(model: Model, state: np.ndarray, longest: float = 20.0) -> float:
    """Time (s) at which the motion from a state (2n) is first back near its start, angles modulo 2 pi.

    Of a linkage of one degree of freedom that is its period, to the sampling. Raises `InputError` when it
    does not come back.
    """
    count = int(200 * longest) + 1
    motion = simulate_dae(model, state, longest, count)
    n, turning = model.degrees_of_freedom, np.asarray(model.angles)
    away = motion.states - motion.states[0]
    away[:, :n] = np.where(turning, (away[:, :n] + np.pi) % (2 * np.pi) - np.pi, away[:, :n])
    clock = np.ptp(motion.states[:, n:]) or 1.0
    distance = np.maximum(np.abs(away[:, :n]).max(axis=1), np.abs(away[:, n:]).max(axis=1) / clock)
    near = NEAR_RETURN * float(distance.max())
    left = int(np.argmax(distance > near))
    lowest = (distance[1:-1] < near) & (distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])
    back = [k for k in np.flatnonzero(lowest) + 1 if k > left]
    if not left or not back:
        raise InputError(f"guess.period: the motion does not come back within {longest:g} s; give a period")
    return float(motion.times[back[0]])


def _terms(model: Model, theta: np.ndarray) -> tuple[np.ndarray, ...]:
    """(grad L, phi), J, d2L/dtheta2 and mu of least |grad L|, and M, at link angles."""
    system = holonomic(model)
    if theta.shape != (system.size,):
        raise InputError(f"equilibrium: shape {theta.shape} for {system.size} bars; give the angle of each, in rad")
    q, v, mu = ca.SX.sym("q", system.size), ca.SX.sym("v", system.size), ca.SX.sym("mu", 2)
    phi = system.constraint(q)
    first = ca.Function("first", [q], [ca.gradient(system.potential(q), q), ca.jacobian(phi, q), phi])
    second = ca.Function("second", [q, mu], [ca.hessian(system.potential(q) + ca.dot(mu, phi), q)[0]])
    mass = ca.Function("mass", [q], [ca.hessian(system.kinetic(q, v), v)[0]])
    slope, jacobian, gap = (part.full() for part in first(theta))
    forces = np.linalg.lstsq(jacobian.T, -slope, rcond=None)[0]
    residual = np.vstack([slope + jacobian.T @ forces, gap]).ravel()
    return residual, jacobian, second(theta, forces).full(), forces.ravel(), mass(theta).full()


def _stationary(model: Model, start: np.ndarray) -> np.ndarray:
    """Newton's method on grad L = 0, phi = 0."""
    theta = start.copy()
    for _ in range(NEWTON_STEPS):
        residual, jacobian, hessian, _, _ = _terms(model, theta)
        corner = np.zeros((len(jacobian), len(jacobian)))
        step = np.linalg.lstsq(np.block([[hessian, jacobian.T], [jacobian, corner]]), -residual, rcond=None)[0]
        step = step[: theta.size]
        theta = theta + step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-300))
        if np.abs(step).max() < 1e-13:
            check_regular(dimensions(model)[0], theta)
            return theta
    raise InputError(f"linkage: no equilibrium found near {np.array2string(start, precision=4)}; give other angles")


def _descended(model: Model, start: np.ndarray) -> np.ndarray:
    """Near a minimum of the potential on the constraint, by SLSQP."""
    from scipy.optimize import minimize

    system = holonomic(model)
    q = ca.SX.sym("q", system.size)
    slope = ca.Function("slope", [q], [ca.gradient(system.potential(q), q)])
    turning = ca.Function("turning", [q], [ca.jacobian(system.constraint(q), q)])
    closure = {
        "type": "eq", "fun": lambda x: system.constraint(x).full().ravel(), "jac": lambda x: turning(x).full()
    }  # fmt: skip
    result = minimize(
        lambda x: float(system.potential(x)), start, jac=lambda x: slope(x).full().ravel(), method="SLSQP",
        constraints=[closure], options={"ftol": 1e-10, "maxiter": 200},
    )  # fmt: skip
    return np.asarray(result.x)
