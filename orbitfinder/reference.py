"""The second integrator: SciPy's DOP853 at its tightest, on any CasADi vector field.

It shares nothing with CVODES: another method (explicit Runge-Kutta of order 8 after Hairer,
Norsett and Wanner, Solving Ordinary Differential Equations I, section II.10), another code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from orbitfinder.errors import IntegrationError

VectorField = Callable[[float, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class ReferenceSettings:
    """Tolerances of DOP853: SciPy refuses a relative tolerance below 100 machine epsilons."""

    relative_tolerance: float = 2.3e-14
    absolute_tolerance: float = 1e-15
    max_evaluations: int = 1_000_000


STEPS_PER_PERIOD = 800
"""A period in at least this many steps: on triple 2 the closure falls from 5e-13 (400) to 1e-13."""

TIGHTEST = ReferenceSettings()
SECOND = ReferenceSettings(relative_tolerance=1e-12, absolute_tolerance=1e-13)


def vector_field(function: ca.Function) -> VectorField:
    """A NumPy callable f(t, y) around a CasADi function of (t, y), without per-call conversions."""
    size = function.size1_in(1)
    time, state, rate = np.zeros(1), np.zeros(size), np.zeros(function.size1_out(0))
    dense = ca.Function("dense", (a := function.mx_in()), [ca.densify(function(*a))])
    buffer, evaluate = dense.buffer()
    buffer.set_arg(0, memoryview(time))
    buffer.set_arg(1, memoryview(state))
    buffer.set_res(0, memoryview(rate))

    def call(t: float, y: np.ndarray) -> np.ndarray:
        time[0] = t
        state[:] = y
        evaluate()
        return rate.copy()

    call.keep = (dense, buffer)  # type: ignore[attr-defined]  # or both are freed under the evaluation
    return call


@np.errstate(over="ignore", invalid="ignore")  # SciPy's step control squares; what is not finite is raised
def integrate(
    field: VectorField,
    state: np.ndarray,
    times: np.ndarray,
    settings: ReferenceSettings = TIGHTEST,
    longest_step: float = np.inf,
) -> np.ndarray:
    """States (k x n) at increasing `times` (k, the first is the start), by DOP853.

    `longest_step` (s) buys digits that SciPy's smallest relative tolerance does not give.

    Raises `IntegrationError` when the step size underflows or the state is not finite.
    """
    from scipy.integrate import DOP853

    times = np.asarray(times, float)
    found = [np.asarray(state, float)]
    if not np.all(np.isfinite(found[0])):
        raise IntegrationError("the start is not finite", time=float(times[0]), state=found[0])
    if times[-1] == times[0]:
        return np.repeat(found, times.size, axis=0)
    if not np.all(np.abs(field(float(times[0]), found[0])) < 1e100):  # also where the state is NaN
        raise IntegrationError("the equations of motion overflow there", time=float(times[0]), state=np.asarray(state))
    solver = DOP853(
        field, times[0], found[0], times[-1],
        rtol=settings.relative_tolerance, atol=settings.absolute_tolerance,
        max_step=longest_step,
    )  # fmt: skip
    wanted = 1
    while solver.status == "running":
        message = solver.step()
        if solver.status == "failed" or solver.nfev > settings.max_evaluations:
            raise IntegrationError(
                message or "too many evaluations", time=float(solver.t), state=np.asarray(state)
            )
        reached = int(np.searchsorted(times, solver.t, side="right"))
        if reached > wanted:
            interior = times[wanted:reached]
            if interior.size == 1 and interior[0] == solver.t:
                found.append(solver.y.copy())
            else:
                found.extend(solver.dense_output()(interior).T)
            wanted = reached
    found[-1] = solver.y.copy()  # the end exactly, not through the interpolant
    states = np.asarray(found)
    if not np.all(np.isfinite(states)):
        raise IntegrationError("the state is not finite", time=float(times[-1]), state=np.asarray(state))
    return states
