"""Integrate a Model under constraints natively, as an index-1 DAE, with IDAS; ends of segments with derivatives.

    x' = (v, a + sum_k s_k u_k),    0 = (M a + h - J^T lambda, J a + Jdot v + 2 alpha J v + beta^2 phi),

z = (a, lambda) algebraic. The unfolding s_k u_k (u = v for the energy: the force s M v along the motion)
does no work on the constraints where J v = 0. With Baumgarte terms the flow contracts onto the
constraint manifold, so that the closure equations contain phi = 0 and phidot = 0 and {closure, phase,
pin} in {x, T, s} is square and regular; without them it is singular (compare S. Sternberg, S. Gros, B.
Houska, M. Diehl, "Approximate robust optimal control of periodic systems with invariants and
high-index differential algebraic systems", IFAC ROCOND 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.cvodes import (
    Flow,
    IntegratorSettings,
    integration_error,
    remembered,
    sundials,
)
from orbitfinder.mechanics.constrained import RANK_TOLERANCE
from orbitfinder.mechanics.model import Invariant, Model, constraint_of, energies

CONSISTENCY_TOLERANCE = 1e-6
"""largest |phi| and |J v| of a state that is accepted as lying on the constraints"""
ALGEBRAIC_ROOM = 1e6
"""Accelerations and forces are sought to this multiple of the absolute tolerance, in units of their largest.

Their linear system gives them to round-off times its condition, 1e4 and more in a linkage of centimetres. Newton's
method, asked for 5e-15, then converges or not as the rounding falls, and IDAS halves its step until nothing is left
(14 of 50 releases of four-bars of 60, 180, 120 mm). x has its own test, so that it loses nothing."""


@dataclass(frozen=True)
class DaeSettings(IntegratorSettings):
    """Tolerances of IDAS; the one place where they are defaulted."""

    relative_tolerance: float = 5e-15
    absolute_tolerance: float = 5e-15
    """both near the floor: on the triple pendulum IDAS still works at 3e-15 and fails at 2e-15"""
    max_steps: int = 1_000_000
    """internal steps between two output times after which the integration is given up"""

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


SEGMENT_SETTINGS = DaeSettings(relative_tolerance=1e-12, absolute_tolerance=1e-12, max_steps=50_000)
"""IDAS in a segment: enough for Newton's method, the last digits come from the polish"""


@dataclass(frozen=True)
class DaeTrajectory:
    """A DAE's motion at k times: `states` (k x 2n), `algebraic` = (a, lambda) (k x n+m), drifts.

    `constraint_drift` and `rate_drift` are max |phi| and max |J v| at each time, `energy` T + V in J.
    The algebraic variables are recomputed from the states by their linear system.
    """

    __repr__ = brief("times", "states")

    model: Model
    settings: DaeSettings
    times: np.ndarray
    states: np.ndarray
    algebraic: np.ndarray
    constraint_drift: np.ndarray
    rate_drift: np.ndarray
    energy: np.ndarray

    @property
    def forces(self) -> np.ndarray:
        """Constraint forces lambda (k x m), named by `model.constraint.force_names`."""
        return self.algebraic[:, self.model.degrees_of_freedom :]


def simulate_dae(
    model: Model,
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
    try:
        with sundials(start, 0.0, 1.0):  # its time is in s already, because the DAE is not scaled to [0, 1]
            z0 = algebraic(model, start[None, :], np.zeros(1))[0]
            n = model.degrees_of_freedom
            # without x' at the start IDAS takes it for 0 and fails its first error test
            options = {**settings.options(), "init_xdot": [*start[n:], *z0[:n]]}
            unit = algebraic_unit(z0)
            solver = ca.integrator("dae", "idas", dae(model), 0.0, list(times), options)
            plain = ca.vertcat(0.0, 1.0, ca.DM.zeros(4 * n), unit)  # x itself and not a deviation, in seconds
            states = solver(x0=start, z0=z0 / unit, p=plain)["xf"].full().T
        if not np.all(np.isfinite(states)):
            raise integration_error("the state is not finite", start, 0.0, 1.0)
    except IntegrationError as error:
        tightest = min(settings.relative_tolerance, settings.absolute_tolerance)
        if tightest >= 1e-12:
            raise
        reason = f"{error.reason} (or the tolerance {tightest:g} is below what round-off allows here: try 1e-12)"
        raise IntegrationError(reason, time=error.time, state=error.state) from None
    return trajectory(model, times, states, settings)


def dae(model: Model, free: Sequence[str] = (), unfolded: Sequence[Invariant] = ()) -> dict[str, ca.SX]:
    """The DAE as CasADi's integrators take it, z = (a, lambda) / unit; p = (t0, duration, s, free, base, slope, unit).

    Its state is the deviation x - base - clock slope. With x(0) and x'(0) there it starts with derivative 0: IDAS
    takes x' for 0 at the start and fails its first error test where that is wrong.
    """
    constraint, n = constraint_of(model), model.degrees_of_freedom
    clock, t0, duration = ca.SX.sym("clock"), ca.SX.sym("t0"), ca.SX.sym("duration")
    s, chosen = ca.SX.sym("s", len(unfolded)), ca.SX.sym("free", len(free))
    y, z = ca.SX.sym("y", 2 * n), ca.SX.sym("z", n + len(constraint.force_names))
    base, slope, unit = ca.SX.sym("base", 2 * n), ca.SX.sym("slope", 2 * n), ca.SX.sym("unit")
    x, parameters = base + clock * slope + y, model.parameters(free, chosen)
    acceleration = unit * z[:n]
    for k, invariant in enumerate(unfolded):
        acceleration += s[k] * invariant.unfolding(x[:n], x[n:], parameters)
    return {
        "t": clock, "x": y, "z": z, "p": ca.vertcat(t0, duration, s, chosen, base, slope, unit),
        "ode": duration * ca.vertcat(x[n:], acceleration) - slope,
        "alg": constraint.residual(t0 + clock * duration, x, unit * z, parameters),
    }  # fmt: skip


def algebraic_unit(z0: Any) -> Any:
    """The unit in which IDAS sees z = (a, lambda), numbers or an MX, so that its tolerance leaves `ALGEBRAIC_ROOM`."""
    largest = ca.norm_inf(z0)
    return ALGEBRAIC_ROOM * ca.if_else(largest > 0, largest, 1.0)


def trajectory(model: Model, times: np.ndarray, states: np.ndarray, settings: DaeSettings) -> DaeTrajectory:
    """A DaeTrajectory around states (k x 2n), everything else recomputed from them."""
    constraint, (q, v) = constraint_of(model), np.split(states.T, 2)
    phi, rate = model.along(constraint.phi, q), model.along(constraint.rate, q, v)
    return DaeTrajectory(
        model, settings, times, states, algebraic(model, states, times),
        np.abs(phi).max(axis=0), np.abs(rate).max(axis=0), np.sum(energies(model, states), axis=0),
    )  # fmt: skip


def algebraic(model: Model, states: np.ndarray, times: np.ndarray | None = None) -> np.ndarray:
    """(a, lambda) (k x n+m) at states (k x 2n) by the linear system of the DAE, in m/s^2, rad/s^2, N."""
    rows = np.atleast_2d(np.asarray(states, float))
    clock = np.zeros(len(rows)) if times is None else np.asarray(times, float)
    return model.along(constraint_of(model).algebraic, clock[None, :], *np.split(rows.T, 2)).T


def check_consistent(model: Model, state: np.ndarray) -> np.ndarray:
    """The state (2n) as floats, or `InputError`: wrong size, off the constraints, or J rank-deficient."""
    constraint, n, p = constraint_of(model), model.degrees_of_freedom, model.parameter_values
    x = np.asarray(state, float)
    if x.shape != (2 * n,) or not np.all(np.isfinite(x)):
        raise InputError(f"state: need {2 * n} finite numbers ({n} coordinates, then velocities), got {state!r}")
    phi = np.abs(constraint.phi(x[:n], p).full()).max()
    rate = np.abs(constraint.rate(x[:n], x[n:], p).full()).max()
    if max(phi, rate) > CONSISTENCY_TOLERANCE:
        raise InputError(
            f"state: off the constraints, |phi| = {phi:.3g}, |J v| = {rate:.3g} (at most {CONSISTENCY_TOLERANCE:g}); "
            "compute it with maximal_states or linkage_state, or solve the constraints first"
        )
    values = np.linalg.svd(constraint.jacobian(x[:n], p).full(), compute_uv=False)
    if values[-1] < RANK_TOLERANCE * values[0]:
        raise InputError(
            f"state: the constraints are dependent here (singular values of J from {values[0]:.3g} to "
            f"{values[-1]:.3g}), so forces are not determined; start away from this change-point configuration"
        )
    return x


@dataclass(frozen=True)
class DaeFlow(Flow):
    """A Flow whose `end` integrates the native DAE by IDAS; `field` and `derivatives` are the Model's own.

    Measured on half a second of a four-bar: IDAS forward sensitivities 0.38 s, the variational equations
    of the eliminated form by CVODES 0.08 s, and the two agree to 1.5e-10.
    """

    dae_settings: DaeSettings = SEGMENT_SETTINGS

    def integrated(self, inputs: list[ca.MX]) -> ca.MX:
        """IDAS on the DAE."""
        t0, x0, duration, s, free = inputs
        model, n = self.model, self.model.degrees_of_freedom
        problem = dae(model, self.free, self.unfolded)
        solver = ca.integrator("segment", "idas", problem, 0.0, 1.0, self.dae_settings.options())
        z0 = constraint_of(model).algebraic(t0, x0[:n], x0[n:], model.parameters(self.free, free))
        slope, unit = duration * self.field(t0, x0, s, free), algebraic_unit(z0)
        p = ca.vertcat(t0, duration, s, free, x0, slope, unit)
        deviation = solver(x0=ca.MX(x0.numel(), 1), z0=z0 / unit, p=p)["xf"]
        return x0 + slope + deviation


def build_dae_flow(
    model: Model,
    free: Sequence[str] = (),
    unfolded: Sequence[Invariant] = (),
    settings: IntegratorSettings | None = None,
) -> Flow:
    """Flow of a Model under constraints, its ends by IDAS. Raises `InputError` without Baumgarte terms."""
    stabilisation = constraint_of(model).baumgarte
    if min(stabilisation.alpha, stabilisation.beta) <= 0:
        raise InputError(
            "baumgarte: shooting on a DAE needs alpha > 0 and beta > 0 (without them closure and consistency are "
            f"over-determined), got alpha = {stabilisation.alpha:g}, beta = {stabilisation.beta:g}; 10 and 10 do"
        )
    return remembered(DaeFlow, model, free, unfolded, settings)
