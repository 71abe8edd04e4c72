"""Fixed-step eighth-order Runge-Kutta inside the CasADi graph: accurate, and one call for a segment.

Coefficients of Dormand and Prince as given by Hairer, Norsett and Wanner (Solving Ordinary
Differential Equations I, section II.10) and tabulated in SciPy's DOP853. On a uniform mesh there is
no step control to pay for, so the polish costs a few milliseconds in the interpreter.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from functools import lru_cache
from typing import Any, TypeVar, cast

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from orbitfinder._runtime import limit
from orbitfinder._runtime.sizes import LEAST
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.compiled import compiled, interpreted_seconds
from orbitfinder.mechanics.model import symbol_of


@lru_cache(maxsize=16)
def marcher(field: ca.Function, steps: int) -> ca.Function:
    """`march((t, x), (h, s, free))` -> (t, x) after 1..steps steps, of a field f(t, x, s, free)."""
    return one_step(field, symbol_of(field)).mapaccum("march", steps)


@lru_cache(maxsize=16)
def one_step(field: ca.Function, symbol: Any, error: bool = False) -> ca.Function:
    """One step of z = (t, x) with p = (h, s, free), or the estimate of its error in x (SciPy's norm, per component)."""
    size, rest = field.size1_in(1), field.size1_in(2) + field.size1_in(3)
    z, p = symbol("z", size + 1), symbol("p", 1 + rest)
    h, s, free = p[0], p[1 : 1 + field.size1_in(2)], p[1 + field.size1_in(2) :]
    stages: list[Any] = []
    for shift, row in zip(DOP853.C, DOP853.A, strict=True):
        stages.append(field(z[0] + float(shift) * h, z[1:] + h * _combined(row, stages), s, free))
    after = ca.vertcat(z[0] + h, z[1:] + h * _combined(DOP853.B, stages))
    if not error:
        return ca.Function("step", [z, p], [after])
    stages.append(field(after[0], after[1:], s, free))
    fifth, third = h * _combined(DOP853.E5, stages), h * _combined(DOP853.E3, stages)
    return ca.Function("error", [z, p], [fifth**2 / ca.sqrt(fifth**2 + 0.01 * third**2 + LEAST)])


def _combined(weights: np.ndarray, stages: list[Any]) -> Any:
    return sum(float(w) * k for w, k in zip(weights, stages, strict=False) if w != 0.0)


def march(
    field: ca.Function, state: np.ndarray, duration: float, steps: int, tail: np.ndarray, start: float = 0.0
) -> np.ndarray:
    """States (steps + 1 x 2n) at equal times from `state`; `tail` holds the field's s and free.

    Raises `IntegrationError` when a state is not finite.
    """
    limit.check()
    count = steps
    while count % 2 == 0 and count > LONGEST:  # so that every doubling is marched by the same function
        count //= 2
    several = compiled(marcher(field, count), effort=interpreted_seconds(field, EVALUATIONS))
    parameters = np.tile(np.concatenate([[duration / steps], tail])[:, None], (1, count))
    paths = [np.concatenate([[start], state])[:, None]]
    for _ in range(steps // count):
        paths.append(several(paths[-1][:, -1], parameters).full())
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
T = TypeVar("T")


def agree(coarse: np.ndarray, fine: np.ndarray, units: tuple[float, ...] = ()) -> bool:
    """True when two step sizes lead to one state (2n), or to the same of several."""
    sizes = np.asarray(units) if units else 1.0
    return bool(np.abs((fine - coarse) / sizes).max() <= AGREEMENT * max(1.0, float(np.abs(fine / sizes).max())))


def refined_march(
    field: ca.Function,
    state: np.ndarray,
    duration: float,
    least: int,
    tail: np.ndarray,
    start: float = 0.0,
    units: tuple[float, ...] = (),
) -> np.ndarray:
    """States (k + 1 x 2n) with k = 2 least, 4 least, ...: the first that k / 2 steps confirm, all along.

    They agree in `units` (2n), or where there are none relative to the state.
    """
    return refined(
        lambda steps: march(field, state, duration, steps, tail, start),
        least,
        lambda coarse, fine: agree(coarse, fine[::2], units),  # what contracts forgets by the end how wrong it was
    )


def refined(path: Callable[[int], T], steps: int, agreed: Callable[[T, T], bool]) -> T:
    """What a path is by 2, 4, ... times so many steps: the first that half its steps confirm, or the last.

    Steps by which it leaves the numbers are too long; `IntegrationError` where the shortest are.
    """
    course = refining(steps, agreed)
    steps = next(course)
    while True:
        try:
            outcome: T | IntegrationError = path(steps)
        except IntegrationError as error:
            outcome = error
        try:
            steps = course.send(outcome)
        except StopIteration as end:
            return cast(T, end.value)


def refining(steps: int, agreed: Callable[[T, T], bool]) -> Generator[int, T | IntegrationError, T]:
    """The same as a course that yields numbers of steps and is sent paths, or why there is none."""
    coarse: T | None = None
    for finest in (*(False,) * MOST_DOUBLINGS, True):
        fine = yield steps
        if isinstance(fine, IntegrationError):
            if finest:
                raise fine
        else:
            if finest or (coarse is not None and agreed(coarse, fine)):
                return fine
            coarse = fine
        steps *= 2
    raise AssertionError


@lru_cache(maxsize=16)
def slopes_of(field: ca.Function, quadrature: ca.Function | None = None) -> ca.Function:
    """f, df/dx, [df/ds | df/dfree] and `quadrature`, if any, as a function of (t, x, s, free), or more."""
    symbol: Any = symbol_of(field)
    inputs = [symbol(field.name_in(k), field.size1_in(k)) for k in range(field.n_in())]
    x, s, free = inputs[1:4]
    rate = field(*inputs)
    added = type(x)(0, 1) if quadrature is None else quadrature(*inputs)
    outputs = [rate, ca.jacobian(rate, x), ca.jacobian(rate, ca.vertcat(s, free)), added]
    return ca.Function("slopes", inputs, ca.cse(outputs) if field.is_a("SXFunction") else outputs)


@lru_cache(maxsize=16)
def variational_field(field: ca.Function, quadrature: ca.Function | None = None, products: bool = False) -> ca.Function:
    """f and its variations as one field of y = (x, vec[Phi | dx/ds | dx/dfree], S), columns of length 2n.

    Phi' = (df/dx) Phi and w_k' = (df/dx) w_k + df/ds_k, with df/dx formed once: on the triple pendulum 849
    operations instead of the 2117 of one directional derivative per column. S' = quadrature(t, x, s, free), where
    there is one. With `products` (df/dx) Phi is a matrix product, which interpreted takes three quarters of the time
    and compiled twice as long.
    """
    size, extra = field.size1_in(1), field.size1_in(2) + field.size1_in(3)
    slopes = slopes_of(field, quadrature)
    if not field.is_a("SXFunction") or size > WIDE or products:
        return _with_columns(slopes, size, extra)
    t, x, *given = inputs = slopes.sx_in()
    rate, matrix, forcing, added = slopes.call(inputs)
    columns = ca.SX.sym("columns", size, size + extra)
    rates = ca.cse([rate, matrix @ columns + ca.horzcat(ca.SX(size, size), forcing), added])
    whole = ca.vertcat(x, ca.vec(columns), ca.SX.sym("S", added.numel()))
    rates[1] = ca.vec(rates[1])
    return ca.Function("variations", [t, whole, *given], [ca.vertcat(*rates)], NOT_INLINED)


NOT_INLINED = {"never_inline": True}
"""Called twelve times in a step: as one C function it compiles 6 times faster and runs no slower"""
WIDE = 16
"""State size beyond which the product with the columns is left a matrix product"""
SHORT = 500
"""Operations up to which a field is written out in each stage: 1.2 times faster on three and four links"""


def _with_columns(slopes: ca.Function, size: int, extra: int) -> ca.Function:
    t, *given = (ca.MX.sym(slopes.name_in(k), slopes.size1_in(k)) for k in range(slopes.n_in()) if k != 1)
    end = size * (1 + size + extra)
    whole = ca.MX.sym("whole", end + slopes.size1_out(3))
    columns = ca.reshape(whole[size:end], size, size + extra)
    rate, matrix, forcing, added = slopes(t, whole[:size], *given)
    if size <= WIDE:
        matrix = ca.densify(matrix)
    moving = ca.densify(matrix @ columns + ca.horzcat(ca.MX(size, size), forcing))
    return ca.Function("variations", [t, whole, *given], [ca.vertcat(rate, ca.vec(moving), added)], NOT_INLINED)


def directional_field(field: ca.Function, quadrature: ca.Function | None = None) -> ca.Function:
    """`variational_field` by a directional derivative for each column: where df/dx is dense it takes long to derive."""
    size, sizes = field.size1_in(1), [field.size1_in(k) for k in range(4)]
    columns, inputs = size + sizes[2] + sizes[3], [ca.MX.sym(name, n) for name, n in zip("txsp", sizes, strict=True)]
    end = size * (1 + columns)
    whole = ca.MX.sym("whole", end + (0 if quadrature is None else quadrature.numel_out(0)))
    inputs[1] = whole[:size]
    rate, unit = field(*inputs), ca.DM.eye(columns)
    seeds = [ca.MX(1, columns), ca.reshape(whole[size:end], size, columns), unit[size : size + sizes[2], :],
             unit[size + sizes[2] :, :]]  # fmt: skip
    given = [ca.repmat(part, 1, columns) for part in (*inputs, rate)]
    moving = field.forward(1).map(columns)(*given, *seeds)
    added = ca.MX(0, 1) if quadrature is None else quadrature(*inputs)
    return ca.Function("variations", [inputs[0], whole, *inputs[2:]], [ca.vertcat(rate, ca.vec(moving), added)],
                       NOT_INLINED)  # fmt: skip


def step_of(field: ca.Function, error: bool = False) -> ca.Function:
    """`one_step` as it compiles best: a short field is written out in each stage, a long one called."""
    if not field.is_a("SXFunction"):
        return one_step(field, ca.MX.sym, error)
    if field.n_instructions() <= SHORT:
        return one_step(field, ca.SX.sym, error)
    inputs = field.sx_in()
    return one_step(ca.Function("rates", inputs, field.call(inputs), NOT_INLINED), ca.MX.sym, error)
