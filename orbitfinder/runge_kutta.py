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

from orbitfinder.compiled import compiled, interpreted_seconds
from orbitfinder.errors import IntegrationError


@lru_cache(maxsize=32)
def marcher(field: ca.Function, steps: int) -> ca.Function:
    """`march((t, x), (h, s, free))` -> (t, x) after 1..steps steps, of a field f(t, x, s, free)."""
    return _step(field, ca.SX.sym if field.is_a("SXFunction") else ca.MX.sym).mapaccum("march", steps)


@lru_cache(maxsize=64)
def _step(field: ca.Function, symbol: Any) -> ca.Function:
    """One step of (t, x) with parameters (h, s, free)."""
    size, rest = field.size1_in(1), field.size1_in(2) + field.size1_in(3)
    z, p = symbol("z", size + 1), symbol("p", 1 + rest)
    h, s, free = p[0], p[1 : 1 + field.size1_in(2)], p[1 + field.size1_in(2) :]
    stages: list[Any] = []
    for shift, row in zip(DOP853.C, DOP853.A, strict=True):
        stages.append(field(z[0] + float(shift) * h, z[1:] + h * _combined(row, stages), s, free))
    after = ca.vertcat(z[0] + h, z[1:] + h * _combined(DOP853.B, stages))
    return ca.Function("step", [z, p], [after])


def _combined(weights: np.ndarray, stages: list[Any]) -> Any:
    return sum(float(w) * k for w, k in zip(weights, stages, strict=False) if w != 0.0)


def march(
    field: ca.Function, state: np.ndarray, duration: float, steps: int, tail: np.ndarray, start: float = 0.0
) -> np.ndarray:
    """States (steps + 1 x 2n) at equal times from `state`; `tail` holds the field's s and free.

    Raises `IntegrationError` when a state is not finite.
    """
    count = steps
    while count % 2 == 0 and count > LONGEST:  # so that every doubling is marched by the same function
        count //= 2
    walk = compiled(marcher(field, count), effort=interpreted_seconds(field, EVALUATIONS))
    parameters = np.tile(np.concatenate([[duration / steps], tail])[:, None], (1, count))
    paths = [np.concatenate([[start], state])[:, None]]
    for _ in range(steps // count):
        paths.append(walk(paths[-1][:, -1], parameters).full())
    path = np.hstack(paths)
    if not np.all(np.isfinite(path)):
        raise IntegrationError("the state is not finite", time=start, state=np.asarray(state))
    return np.asarray(path[1:].T)


LONGEST = 64
"""Steps that one function makes at most, where the number of steps is even often enough"""
EVALUATIONS = 100_000
"""About how often one search for an orbit evaluates the equations of motion in marches."""
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


@lru_cache(maxsize=64)
def variational_field(field: ca.Function) -> ca.Function:
    """f and its variations as one field of y = (x, vec[Phi | dx/ds | dx/dfree]), columns of length 2n.

    Phi' = (df/dx) Phi and w_k' = (df/dx) w_k + df/ds_k, with df/dx formed once: on the triple pendulum 849
    operations instead of the 2117 of one directional derivative per column.
    """
    if not field.is_a("SXFunction"):
        return _matrix_variations(field)
    t, x, s, free = (ca.SX.sym(name, field.size1_in(k)) for k, name in enumerate(("t", "x", "s", "free")))
    size, extra = x.numel(), s.numel() + free.numel()
    rate = field(t, x, s, free)
    slopes, forcing = ca.jacobian(rate, x), ca.jacobian(rate, ca.vertcat(s, free))
    inputs = [t, x, s, free]
    if size > WIDE:
        return _with_columns(ca.Function("slopes", inputs, ca.cse([rate, slopes, forcing]), NOT_INLINED), size, extra)
    columns = ca.SX.sym("columns", size, size + extra)
    found = ca.cse([rate, slopes @ columns + ca.horzcat(ca.SX(size, size), forcing)])
    whole = ca.vertcat(x, ca.vec(columns))
    return ca.Function("variations", [t, whole, s, free], [ca.vertcat(found[0], ca.vec(found[1]))], NOT_INLINED)


NOT_INLINED = {"never_inline": True}
"""Called twelve times in a step: as one C function it compiles 6 times faster and runs no slower"""
WIDE = 16
"""State size beyond which the product with the columns is left a matrix product"""
SHORT = 500
"""Operations up to which a field is written out in each stage: 1.2 times faster on three and four links"""


def _matrix_variations(field: ca.Function) -> ca.Function:
    """The same for a field of matrix expressions."""
    t, x, s, free = (ca.MX.sym(name, field.size1_in(k)) for k, name in enumerate(("t", "x", "s", "free")))
    rate = field(t, x, s, free)
    outputs = [rate, ca.jacobian(rate, x), ca.jacobian(rate, ca.vertcat(s, free))]
    return _with_columns(ca.Function("slopes", [t, x, s, free], outputs), x.numel(), s.numel() + free.numel())


def _with_columns(slopes: ca.Function, size: int, extra: int) -> ca.Function:
    t, s, free = ca.MX.sym("t"), ca.MX.sym("s", slopes.size1_in(2)), ca.MX.sym("free", slopes.size1_in(3))
    whole = ca.MX.sym("whole", size * (1 + size + extra))
    columns = ca.reshape(whole[size:], size, size + extra)
    rate, matrix, forcing = slopes(t, whole[:size], s, free)
    moving = ca.densify(matrix) @ columns + ca.horzcat(ca.MX(size, size), forcing)
    return ca.Function("variations", [t, whole, s, free], [ca.vertcat(rate, ca.vec(moving))], NOT_INLINED)


@lru_cache(maxsize=64)
def block(field: ca.Function, steps: int, lanes: int) -> ca.Function:
    """`block(z, p)` -> z after that many steps, for `lanes` columns z = (t, y) and p = (h, s, free) at once."""
    size, rest = field.size1_in(1), field.size1_in(2) + field.size1_in(3)
    scalar = field.is_a("SXFunction") and field.n_instructions() <= SHORT
    if field.is_a("SXFunction") and not scalar:
        field = ca.Function("rates", field.sx_in(), field.call(field.sx_in()), NOT_INLINED)
    z, p = ca.MX.sym("z", size + 1), ca.MX.sym("p", 1 + rest)
    folded = _step(field, ca.SX.sym if scalar else ca.MX.sym).fold(steps)
    whole = ca.Function("block", [z, p], [folded(z, ca.repmat(p, 1, steps))])
    return whole if lanes == 1 else whole.map(lanes)
