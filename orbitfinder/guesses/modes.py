"""Starting points that need no search: the linear normal modes of an equilibrium.

To every imaginary pair of eigenvalues i w of an equilibrium of a conservative system, of which no
other is an integer multiple, belongs a family of periodic orbits whose period tends to 2 pi / w and
whose shape to the linear mode (A. M. Lyapunov, 1907; K. R. Meyer, D. C. Offin, Introduction to
Hamiltonian Dynamical Systems and the N-Body Problem (2017), section 9.2). Under constraints the small motions
are those of Z^T (d2L/dtheta2) Z u = w^2 Z^T M Z u, Z a basis of the null space of J (see `equilibria`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.errors import InputError
from orbitfinder.guesses.equilibria import linkage_equilibrium, stationary_terms
from orbitfinder.integrate.equations import at_rest
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import QUARTER
from orbitfinder.mechanics.constrained import tangent_basis
from orbitfinder.mechanics.linkage import assemble, linkage_state
from orbitfinder.mechanics.model import Model

AMPLITUDE = 0.02
"""Largest deviation (rad or m) at which a family is begun, unless said otherwise."""
OSCILLATES = 1e-12
"""Squared frequencies beyond this, relative to the largest, are of modes that oscillate."""


def normal_modes(
    model: Model, equilibrium: Sequence[float] | np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Squared angular frequencies (n, rad^2/s^2, slowest first) and shapes (n x n, one per column).

    K u = w^2 M u with M = d2T/dv2 and K = d2V/dq2 at the equilibrium (default: q = 0, hanging).
    Source: Goldstein, Classical Mechanics, section 6.2.
    """
    from scipy.linalg import eigh

    n = model.degrees_of_freedom
    place = np.zeros(n) if equilibrium is None else np.asarray(equilibrium, float)
    if place.shape != (n,):
        raise InputError(f"equilibrium: shape {place.shape} for {n} coordinates; give one number each, without rates")
    column, columns = at_rest(model), []
    for unit in np.eye(n):
        limit.check()
        columns.append([part.full().ravel() for part in column(place, unit)])
    m, k, force = (np.stack(parts, axis=1) for parts in zip(*columns, strict=True))
    if not all(np.all(np.isfinite(part)) for part in (m, k, force)):
        raise InputError(
            f"guess.mode: the energies have no second derivatives at {place.tolist()}, or not in double precision; "
            "give the coordinates of an equilibrium, or a state and a period"
        )
    if np.abs(force).max() > 1e-9 * max(1.0, float(np.abs(k).max())):
        raise InputError(f"guess.mode: {place.tolist()} is not an equilibrium; give the coordinates of one")
    try:
        squared, shapes = eigh(k, m)
    except np.linalg.LinAlgError as error:
        raise InputError(f"guess.mode: no modes at {place.tolist()} ({error}); give a state and a period") from error
    return np.asarray(squared), np.asarray(shapes)


def normal_mode(
    model: Model, mode: int, amplitude: float, equilibrium: Sequence[float] | np.ndarray | None = None
) -> Guess:
    """Guess on a linear normal mode: `mode` counts from 1, slowest first; largest deviation `amplitude` (rad or m).

    The motion starts at rest at its turning point. Raises `InputError` when there is no such mode
    or when the equilibrium is unstable in it.
    """
    n = model.degrees_of_freedom
    if isinstance(mode, bool) or not 1 <= mode <= n:
        raise InputError(f"guess.mode: must be between 1 and {n}, got {mode}; this system has {n} normal modes")
    if not (np.isfinite(amplitude) and amplitude > 0):
        raise InputError(f"guess.amplitude: must be positive and finite, got {amplitude}; give an angle in rad")
    squared, shapes = normal_modes(model, equilibrium)
    chosen = float(squared[mode - 1])
    if mode - 1 not in oscillating(squared):
        raise InputError(
            f"guess.mode: mode {mode} does not oscillate (squared frequency {chosen:.3g}); "
            "give a state and a period, or use gravity so that the system hangs"
        )
    shape = shapes[:, mode - 1]
    largest = shape[np.abs(shape).argmax()]
    place = np.zeros(n) if equilibrium is None else np.asarray(equilibrium, float)
    return Guess(np.concatenate([place + amplitude * shape / largest, np.zeros(n)]), 2 * np.pi / np.sqrt(chosen))


def oscillating(squared: np.ndarray) -> np.ndarray:
    """Positions of the modes that oscillate among the squared frequencies of all."""
    return np.flatnonzero(squared > OSCILLATES * np.abs(squared).max(initial=0.0))


def mode_problem(
    model: Model,
    mode: int,
    amplitude: float = AMPLITUDE,
    equilibrium: Sequence[float] | np.ndarray | None = None,
    name: str | None = None,
) -> Problem:
    """The Problem that starts the family of a mode, in the quarter-period formulation.

    `mode` counts the oscillating modes of the equilibrium from 1, slowest first. Raises `InputError`.
    """
    found = oscillating(normal_modes(model, equilibrium)[0])
    if isinstance(mode, bool) or not 1 <= mode <= found.size:
        raise InputError(
            f"mode: must be between 1 and {found.size}, got {mode}; this equilibrium has "
            f"{found.size} oscillating modes out of {model.degrees_of_freedom}"
        )
    guess = normal_mode(model, int(found[mode - 1]) + 1, amplitude, equilibrium)
    return Problem(model, guess, symmetry=QUARTER.name, name=name or f"mode-{mode}")


def linkage_modes(
    model: Model, equilibrium: Sequence[float] | np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Squared angular frequencies (n - 2, rad^2/s^2, slowest first) and shapes (n x n-2) in the link angles."""
    from scipy.linalg import eigh

    theta = linkage_equilibrium(model) if equilibrium is None else np.asarray(equilibrium, float)
    _, jacobian, hessian, mass = stationary_terms(model, theta)
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
