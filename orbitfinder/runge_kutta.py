"""Fixed-step eighth-order Runge-Kutta inside the CasADi graph: accurate, and one call for a segment.

Coefficients of Dormand and Prince as given by Hairer, Norsett and Wanner (Solving Ordinary
Differential Equations I, section II.10) and tabulated in SciPy's DOP853. On a uniform mesh there is
no step control to pay for, so the polish costs a few milliseconds in the interpreter.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from orbitfinder.errors import IntegrationError


@lru_cache(maxsize=32)
def marcher(field: ca.Function, steps: int) -> ca.Function:
    """`march((t, x), (h, s, free))` -> (t, x) after 1..steps steps, of a field f(t, x, s, free)."""
    size, rest = field.size1_in(1), field.size1_in(2) + field.size1_in(3)
    symbol: Any = ca.SX.sym if field.is_a("SXFunction") else ca.MX.sym
    z, p = symbol("z", size + 1), symbol("p", 1 + rest)
    h, s, free = p[0], p[1 : 1 + field.size1_in(2)], p[1 + field.size1_in(2) :]
    stages: list[Any] = []
    for shift, row in zip(DOP853.C, DOP853.A, strict=True):
        stages.append(field(z[0] + float(shift) * h, z[1:] + h * _combined(row, stages), s, free))
    after = ca.vertcat(z[0] + h, z[1:] + h * _combined(DOP853.B, stages))
    return ca.Function("step", [z, p], [after]).mapaccum("march", steps)


def _combined(weights: np.ndarray, stages: list[Any]) -> Any:
    return sum(float(w) * k for w, k in zip(weights, stages, strict=False) if w != 0.0)


def march(
    field: ca.Function, state: np.ndarray, duration: float, steps: int, tail: np.ndarray, start: float = 0.0
) -> np.ndarray:
    """States (steps + 1 x 2n) at equal times from `state`; `tail` holds the field's s and free.

    Raises `IntegrationError` when a state is not finite.
    """
    parameters = np.concatenate([[duration / steps], tail])
    path = marcher(field, steps)(np.concatenate([[start], state]), np.tile(parameters[:, None], (1, steps))).full()
    if not np.all(np.isfinite(path)):
        raise IntegrationError("the state is not finite", time=start, state=np.asarray(state))
    return np.vstack([state, path[1:].T])


AGREEMENT = 1e-12
"""Two step sizes must agree to this; the finer result is then some 2^8 times better than that"""
MOST_DOUBLINGS = 7


def refined_march(
    field: ca.Function, state: np.ndarray, duration: float, least: int, tail: np.ndarray, start: float = 0.0
) -> np.ndarray:
    """States (k + 1 x 2n) with k = 2 least, 4 least, ...: the first whose end k / 2 steps confirm."""
    steps = least
    coarse = march(field, state, duration, steps, tail, start)
    for _ in range(MOST_DOUBLINGS):
        steps *= 2
        fine = march(field, state, duration, steps, tail, start)
        if np.abs(fine[-1] - coarse[-1]).max() <= AGREEMENT * max(1.0, float(np.abs(fine[-1]).max())):
            break
        coarse = fine
    return fine
