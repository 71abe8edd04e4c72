"""Starting points that need no search: the linear normal modes of an equilibrium."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.errors import InputError
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.model import Model


def normal_modes(
    model: Model, equilibrium: Sequence[float] | np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Squared angular frequencies (n, rad^2/s^2, slowest first) and shapes (n x n, one per column).

    K u = w^2 M u with M = d2T/dv2 and K = d2V/dq2 at the equilibrium (default: q = 0, hanging).
    Source: Goldstein, Classical Mechanics, section 6.2.
    """
    from scipy.linalg import eigh

    n = model.degrees_of_freedom
    q, v, values = ca.MX.sym("q", n), ca.MX.sym("v", n), ca.DM(model.parameter_values)
    slope, momentum = ca.gradient(model.potential(q, values), q), ca.gradient(model.kinetic(q, v, values), v)
    place = np.zeros(n) if equilibrium is None else np.asarray(equilibrium, float)
    if place.shape != (n,):
        raise InputError(f"equilibrium: shape {place.shape} for {n} coordinates; give one number each, without rates")
    # column by column: CasADi's Hessians of 2000 links take minutes. Momenta are linear in the rates
    column = ca.Function("at_rest", [q, v], [momentum, ca.jtimes(slope, q, v), slope])
    columns = []
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
    if chosen <= 1e-12 * float(np.abs(squared).max(initial=0.0)):
        raise InputError(
            f"guess.mode: mode {mode} does not oscillate (squared frequency {chosen:.3g}); "
            "give a state and a period, or use gravity so that the system hangs"
        )
    shape = shapes[:, mode - 1]
    largest = shape[np.abs(shape).argmax()]
    place = np.zeros(n) if equilibrium is None else np.asarray(equilibrium, float)
    return Guess(np.concatenate([place + amplitude * shape / largest, np.zeros(n)]), 2 * np.pi / np.sqrt(chosen))
