"""Shooting segments of a ConstrainedModel: ends by IDAS on the native DAE, derivatives by variations.

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
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.integrate.cvodes import Flow, IntegratorSettings, custom_jacobian, remembered
from orbitfinder.integrate.idas import DaeSettings, algebraic_unit
from orbitfinder.mechanics.constrained import ConstrainedModel
from orbitfinder.mechanics.model import Invariant, Model

SEGMENT_SETTINGS = DaeSettings(relative_tolerance=1e-12, absolute_tolerance=1e-12, max_steps=50_000)
"""IDAS in a segment: enough for Newton's method, the last digits come from the polish"""


@dataclass(frozen=True)
class DaeFlow(Flow):
    """A Flow whose `end` integrates the native DAE by IDAS; `field` and `derivatives` are its reduced form.

    Measured on half a second of a four-bar: IDAS forward sensitivities 0.38 s, the variational equations
    of the reduced form by CVODES 0.08 s, and the two agree to 1.5e-10.
    """

    dae_settings: DaeSettings = field(default_factory=lambda: SEGMENT_SETTINGS)

    @cached_property
    def native(self) -> ca.Function:
        """IDAS on the DAE, `native(t0, x0, duration, s, free)` -> x(t0 + duration), with CasADi's own derivatives."""
        names, inputs = self._inputs()
        return ca.Function("dae_end", inputs, [self._integrated(inputs)], names, ["xf"])

    @cached_property
    def end(self) -> ca.Function:
        """The same integrator with the variational equations as its Jacobian."""
        names, inputs = self._inputs()
        jacobian = custom_jacobian(self.field, self.derivatives, inputs, names, self.model.forced)
        options = {"custom_jacobian": jacobian, "never_inline": True, "jac_penalty": 0}
        return ca.Function("flow_end", inputs, [self._integrated(inputs)], names, ["xf"], options)

    def _integrated(self, inputs: list[ca.MX]) -> ca.MX:
        t0, x0, duration, s, free = inputs
        solver = ca.integrator("segment", "idas", self._dae(), 0.0, 1.0, self.dae_settings.options())
        native, n = _native(self.model), self.model.degrees_of_freedom
        z0 = native.algebraic(t0, x0[:n], x0[n:], self.model.parameters(self.free, free))
        slope, unit = duration * self.field(t0, x0, s, free), algebraic_unit(z0)
        p = ca.vertcat(t0, duration, s, free, x0, slope, unit)
        deviation = solver(x0=ca.MX(x0.numel(), 1), z0=z0 / unit, p=p)["xf"]
        return x0 + slope + deviation

    def _dae(self) -> dict[str, ca.SX]:
        """The DAE on [0, 1] as CasADi's integrators take it; p = (t0, duration, s, free, x(0), x'(0), unit).

        Its state is the deviation x - x(0) - clock x'(0), which starts with derivative 0: IDAS takes x' for 0
        at the start and fails its first error test where that is wrong.
        """
        native, n = _native(self.model), self.model.degrees_of_freedom
        clock, t0, duration = ca.SX.sym("clock"), ca.SX.sym("t0"), ca.SX.sym("duration")
        s, free = ca.SX.sym("s", len(self.unfolded)), ca.SX.sym("free", len(self.free))
        y, z = ca.SX.sym("y", 2 * n), ca.SX.sym("z", n + native.constraints)
        base, slope, unit = ca.SX.sym("base", 2 * n), ca.SX.sym("slope", 2 * n), ca.SX.sym("unit")
        x = base + clock * slope + y
        parameters = self.model.parameters(self.free, free)
        acceleration = unit * z[:n]
        for k, invariant in enumerate(self.unfolded):
            acceleration += s[k] * invariant.unfolding(x[:n], x[n:], parameters)
        return {
            "t": clock, "x": y, "z": z, "p": ca.vertcat(t0, duration, s, free, base, slope, unit),
            "ode": duration * ca.vertcat(x[n:], acceleration) - slope,
            "alg": native.residual(t0 + clock * duration, x, unit * z, parameters),
        }  # fmt: skip


def _native(model: Model) -> ConstrainedModel:
    if model.native is None:
        raise InputError("model: has no constraints; build it with linkage(...) or constrained(...), then reduced()")
    return model.native  # type: ignore[no-any-return]


def build_dae_flow(
    model: Model,
    free: Sequence[str] = (),
    unfolded: Sequence[Invariant] = (),
    settings: IntegratorSettings | None = None,
) -> DaeFlow:
    """Flow of the reduced form of a ConstrainedModel, its ends by IDAS. Raises `InputError` without Baumgarte terms."""
    stabilisation = _native(model).baumgarte
    if min(stabilisation.alpha, stabilisation.beta) <= 0:
        raise InputError(
            "baumgarte: shooting on a DAE needs alpha > 0 and beta > 0 (without them closure and consistency are "
            f"over-determined), got alpha = {stabilisation.alpha:g}, beta = {stabilisation.beta:g}; 10 and 10 do"
        )
    found = remembered(DaeFlow, model, free, unfolded, settings)
    assert isinstance(found, DaeFlow)
    return found


def forward_sensitivities(flow: DaeFlow, state: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """End state (2n) and dx(end)/dx(start) by IDAS's own forward sensitivities: the check on `transition`."""
    x0, size = ca.MX.sym("x0", np.size(state)), np.size(state)
    free = ca.DM(flow.model.parameter_values[[flow.model.parameter_index(name) for name in flow.free]])
    end = flow.native(0.0, x0, duration, ca.DM.zeros(len(flow.unfolded)), free)
    columns = ca.jtimes(end, x0, ca.DM.eye(size))
    found = ca.Function("sensitivities", [x0], [end, columns])(state)
    return found[0].full().ravel(), found[1].full()
