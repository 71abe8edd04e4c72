"""Integrate a ConstrainedModel natively, as an index-1 DAE, with IDAS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.limit import alarm
from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.quiet import captured
from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.cvodes import check_tolerances, integration_error
from orbitfinder.mechanics.constrained import CONSISTENCY_TOLERANCE, RANK_TOLERANCE, ConstrainedModel

ALGEBRAIC_ROOM = 1e6
"""Accelerations and forces are sought to this multiple of the absolute tolerance, in units of their largest.

Their linear system gives them to round-off times its condition, 1e4 and more in a linkage of centimetres. Newton's
method, asked for 5e-15, then converges or not as the rounding falls, and IDAS halves its step until nothing is left
(14 of 50 releases of four-bars of 60, 180, 120 mm). x has its own test, so that it loses nothing."""


@dataclass(frozen=True)
class DaeSettings:
    """Tolerances of IDAS; the one place where they are defaulted."""

    relative_tolerance: float = 5e-15
    absolute_tolerance: float = 5e-15
    """both near the floor: on the triple pendulum IDAS still works at 3e-15 and fails at 2e-15"""
    max_steps: int = 1_000_000
    """internal steps between two output times after which the integration is given up"""

    def __post_init__(self) -> None:
        check_fields(self)
        check_tolerances(self.relative_tolerance, self.absolute_tolerance, self.max_steps)

    def options(self) -> dict[str, Any]:
        """The same in CasADi's words.

        z0 is consistent already, so IDAS need not look for it. z enters linearly and is solved for in
        every step, so it stays out of the error test; with it there IDAS fails at 1e-13 already,
        because z is known only to round-off times its condition.
        """
        return {
            "reltol": self.relative_tolerance,
            "abstol": self.absolute_tolerance,
            "max_num_steps": self.max_steps,
            "suppress_algebraic": True,
            "calc_ic": False,
        }


@dataclass(frozen=True)
class DaeTrajectory:
    """A DAE's motion at k times: `states` (k x 2n), `algebraic` = (a, lambda) (k x n+m), drifts.

    `constraint_drift` and `rate_drift` are max |phi| and max |J v| at each time, `energy` T + V in J.
    The algebraic variables are recomputed from the states by their linear system.
    """

    __repr__ = brief("times", "states")

    model: ConstrainedModel
    settings: DaeSettings
    times: np.ndarray
    states: np.ndarray
    algebraic: np.ndarray
    constraint_drift: np.ndarray
    rate_drift: np.ndarray
    energy: np.ndarray

    @property
    def forces(self) -> np.ndarray:
        """Constraint forces lambda (k x m), named by `model.force_names`."""
        return self.algebraic[:, self.model.coordinates :]


def simulate_dae(
    model: ConstrainedModel,
    state: np.ndarray,
    duration: float,
    count: int = 501,
    settings: DaeSettings | None = None,
) -> DaeTrajectory:
    """Motion from `state` (2n) over `duration` s, at `count` equal times, by IDAS on the native DAE.

    x' = (v, a), 0 = residual(t, x, (a, lambda)). Raises `InputError` for a state off the constraints
    or at a singular configuration, `IntegrationError` when IDAS gives up.
    """
    settings = settings or DaeSettings()
    start = check_consistent(model, state)
    if not (np.isfinite(duration) and duration > 0) or count < 2:
        raise InputError(f"duration, count: need duration > 0 and count >= 2, got {duration!r} and {count!r}")
    times = np.linspace(0.0, duration, count)
    error: Exception | None = None
    with captured() as output, alarm():
        try:
            z0 = algebraic(model, start[None, :], np.zeros(1))[0]
            n = model.coordinates
            # without x' at the start IDAS takes it for 0 and fails its first error test
            options = {**settings.options(), "init_xdot": [*start[n:], *z0[:n]]}
            unit = algebraic_unit(z0)
            solver = ca.integrator("dae", "idas", dae(model), 0.0, list(times), options)
            states = solver(x0=start, z0=z0 / unit, p=ca.vertcat(model.parameter_values, unit))["xf"].full().T
        except RuntimeError as failure:
            error = failure
    if error is not None:
        raise dae_error(f"{output.text}\n{error}", start, settings)
    if not np.all(np.isfinite(states)):
        raise dae_error("the state is not finite", start, settings)
    return trajectory(model, times, states, settings)


def dae_error(text: str, start: np.ndarray, settings: DaeSettings) -> IntegrationError:
    """One typed error; SUNDIALS' time is in s already, because the DAE is not scaled to [0, 1]."""
    found = integration_error(text, start, 0.0, 1.0)
    tightest = min(settings.relative_tolerance, settings.absolute_tolerance)
    if tightest >= 1e-12:
        return found
    reason = f"{found.reason} (or the tolerance {tightest:g} is below what round-off allows here: try 1e-12)"
    return IntegrationError(reason, time=found.time, state=found.state)


def dae(model: ConstrainedModel) -> dict[str, Any]:
    """The DAE as CasADi's integrators take it: t, x = (q, v), z = (a, lambda) / unit, (p, unit), ode, alg."""
    n = model.coordinates
    t, x, p = ca.SX.sym("t"), ca.SX.sym("x", 2 * n), ca.SX.sym("p", model.parameter_values.size)
    z, unit = ca.SX.sym("z", n + model.constraints), ca.SX.sym("unit")
    ode = ca.vertcat(x[n:], unit * z[:n])
    return {"t": t, "x": x, "z": z, "p": ca.vertcat(p, unit), "ode": ode, "alg": model.residual(t, x, unit * z, p)}


def algebraic_unit(z0: Any) -> Any:
    """The unit in which IDAS sees z = (a, lambda), numbers or an MX, so that its tolerance leaves `ALGEBRAIC_ROOM`."""
    largest = ca.norm_inf(z0)
    return ALGEBRAIC_ROOM * ca.if_else(largest > 0, largest, 1.0)


def trajectory(model: ConstrainedModel, times: np.ndarray, states: np.ndarray, settings: DaeSettings) -> DaeTrajectory:
    """A DaeTrajectory around states (k x 2n), everything else recomputed from them."""
    n, count = model.coordinates, len(states)
    q, v = states.T[:n], states.T[n:]
    p = np.tile(model.parameter_values[:, None], (1, count))
    phi = model.constraint.map(count)(q, p).full()
    rate = model.constraint_rate.map(count)(q, v, p).full()
    energy = model.kinetic.map(count)(q, v, p).full() + model.potential.map(count)(q, p).full()
    return DaeTrajectory(
        model, settings, times, states, algebraic(model, states, times),
        np.abs(phi).max(axis=0), np.abs(rate).max(axis=0), energy.ravel(),
    )  # fmt: skip


def algebraic(model: ConstrainedModel, states: np.ndarray, times: np.ndarray | None = None) -> np.ndarray:
    """(a, lambda) (k x n+m) at states (k x 2n) by the linear system of the DAE, in m/s^2, rad/s^2, N."""
    rows = np.atleast_2d(np.asarray(states, float))
    count, n = len(rows), model.coordinates
    clock = np.zeros(count) if times is None else np.asarray(times, float)
    p = np.tile(model.parameter_values[:, None], (1, count))
    return np.asarray(model.algebraic.map(count)(clock[None, :], rows.T[:n], rows.T[n:], p).full().T)


def check_consistent(model: ConstrainedModel, state: np.ndarray) -> np.ndarray:
    """The state (2n) as floats, or `InputError`: wrong size, off the constraints, or J rank-deficient."""
    x, n, p = np.asarray(state, float), model.coordinates, model.parameter_values
    if x.shape != (2 * n,) or not np.all(np.isfinite(x)):
        raise InputError(f"state: need {2 * n} finite numbers ({n} coordinates, then velocities), got {state!r}")
    phi = np.abs(model.constraint(x[:n], p).full()).max()
    rate = np.abs(model.constraint_rate(x[:n], x[n:], p).full()).max()
    if max(phi, rate) > CONSISTENCY_TOLERANCE:
        raise InputError(
            f"state: off the constraints, |phi| = {phi:.3g}, |J v| = {rate:.3g} (at most {CONSISTENCY_TOLERANCE:g}); "
            "compute it with maximal_states or linkage_state, or solve the constraints first"
        )
    values = np.linalg.svd(model.constraint_jacobian(x[:n], p).full(), compute_uv=False)
    if values[-1] < RANK_TOLERANCE * values[0]:
        raise InputError(
            f"state: the constraints are dependent here (singular values of J from {values[0]:.3g} to "
            f"{values[-1]:.3g}), so forces are not determined; start away from this change-point configuration"
        )
    return x
