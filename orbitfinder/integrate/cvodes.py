"""Integrate a Model and differentiate the result: CVODES on the variational equations.

The state and its derivatives are one system of ordinary differential equations,

    x' = f(t, x, s),    Phi' = (df/dx) Phi,    w_k' = (df/dx) w_k + df/ds_k,

solved together under one error control (Adams, functional iteration), because the derivatives
that CasADi makes of an integrator can be silently wrong (casadi issue 4383) and are slower. Where a
derivative of Phi is wanted too it is integrated likewise,

    (dPhi/da)' = A dPhi/da + (dA/dx dx/da + dA/da) Phi    for every initial value and parameter a, A = df/dx.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.limit import alarm
from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.quiet import captured
from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.compiled import interpreted_seconds, mode, with_derivatives
from orbitfinder.integrate.rk8 import variational_field
from orbitfinder.mechanics.model import Invariant, Model, check_state, symbol_of, vector_field

EVALUATIONS = 20_000
"""About how often one search for an orbit evaluates the variational equations."""
SMALL = 16
"""State size up to which two flows are remembered, at 2 to 25 MB; beyond it one (10 links 42 MB, 20 links 290)"""


@dataclass(frozen=True)
class IntegratorSettings:
    """Tolerances of CVODES; the one place where they are defaulted."""

    relative_tolerance: float = 1e-13
    absolute_tolerance: float = 1e-13
    max_steps: int = 50_000
    """internal steps in one segment after which the integration is given up"""

    def __post_init__(self) -> None:
        check_fields(self)
        relative, absolute, steps = self.relative_tolerance, self.absolute_tolerance, self.max_steps
        if not (0 < relative < 1 and 0 < absolute < np.inf and steps >= 1):
            raise InputError(
                "relative_tolerance, absolute_tolerance, max_steps: must be positive, the first below 1, got "
                f"{relative}, {absolute} and {steps}; the defaults are near what double precision can do"
            )

    def options(self) -> dict[str, Any]:
        """The same in CasADi's words."""
        return {
            "reltol": self.relative_tolerance,
            "abstol": self.absolute_tolerance,
            "max_num_steps": self.max_steps,
            "linear_multistep_method": "adams",
            "nonlinear_solver_iteration": "functional",
        }


@dataclass(frozen=True)
class Flow:
    """The flow of a Model with unfolding parameters s and freed physical parameters.

    `field(t, x, s, free)` -> f; `end(t0, x0, duration, s, free)` -> x(t0 + duration), which
    carries its own Jacobian; `derivatives(t0, x0, duration, s, free)` -> (x, [Phi | dx/ds | dx/dfree]).
    """

    __repr__ = brief("model", "free", "unfolded")

    model: Model
    settings: IntegratorSettings
    free: tuple[str, ...]
    unfolded: tuple[Invariant, ...]
    field: ca.Function
    units: tuple[float, ...] = ()
    """what CVODES measures the state (2n) in, so that its tolerances fit; () is 1 everywhere"""
    later: tuple[Flow, ...] = ()
    """those of the arcs after the first, of a hybrid orbit"""

    @cached_property
    def derivatives(self) -> ca.Function:
        """The variational integrator; built when first asked for, since it is large for long chains.

        Its right-hand side is compiled where the work to be expected pays for it.
        """
        names, inputs = self.inputs()
        field, units = _in_units(self.field, self.units), self.units
        size, extra, varied = field.size1_in(1), field.size1_in(2) + field.size1_in(3), variational_field(field)
        sizes = ca.DM(units) if units else ca.DM.ones(size)
        varied = with_derivatives(varied, effort=interpreted_seconds(varied, EVALUATIONS))
        start = ca.vertcat(inputs[1] / sizes, ca.vec(ca.MX(ca.DM.eye(size))), ca.MX(ca.DM.zeros(size * extra)))
        end = _solved("variational", varied, ca.MX.sym, self.settings.options(), [inputs[0], start, *inputs[2:]])
        columns = ca.DM(np.outer(sizes.full().ravel(), np.append(1 / sizes.full().ravel(), np.ones(extra))))
        outputs = [sizes * end[:size], columns * ca.reshape(end[size:], size, size + extra)]
        return ca.Function("flow_derivatives", inputs, outputs, names, ["xf", "sensitivity"])

    @cached_property
    def end(self) -> ca.Function:
        """The integrator of the state with the variational equations as its custom Jacobian."""
        names, inputs = self.inputs()
        jacobian = custom_jacobian(self.field, self.derivatives, inputs, names, self.model.forced)
        options = {"custom_jacobian": jacobian, "never_inline": True, "jac_penalty": 0}
        return ca.Function("flow_end", inputs, [self.integrated(inputs)], names, ["xf"], options)

    def integrated(self, inputs: list[ca.MX]) -> ca.MX:
        """The state at the end, with CasADi's own derivatives."""
        field, sizes = _in_units(self.field, self.units), ca.DM(self.units) if self.units else 1.0
        given = [inputs[0], inputs[1] / sizes, *inputs[2:]]
        return sizes * _solved("state", field, symbol_of(field), self.settings.options(), given)

    def inputs(self) -> tuple[list[str], list[ca.MX]]:
        """Names and symbols of what its functions are given."""
        names = ["t0", "x0", "duration", "s", "free"]
        sizes = [1, self.field.size1_in(1), 1, len(self.unfolded), len(self.free)]
        return names, [ca.MX.sym(name, size) for name, size in zip(names, sizes, strict=True)]


def build_flow(
    model: Model,
    free: Sequence[str] = (),
    unfolded: Sequence[Invariant] = (),
    settings: IntegratorSettings | None = None,
    units: tuple[float, ...] = (),
) -> Flow:
    """Flow of a Model; `free` names physical parameters kept variable, `unfolded` the invariants
    whose unfolding acceleration s_k u_k(q, v) is added to the equations of motion.

    The last few are remembered: a second search on the same Model builds no integrator anew.
    """
    if not model.smooth:
        raise InputError("system: it is hybrid, and a flow knows no events; use simulate, which goes through them")
    return remembered(Flow, model, free, unfolded, settings, units)


def remembered(
    kind: type[Flow],
    model: Model,
    free: Sequence[str],
    unfolded: Sequence[Invariant],
    settings: IntegratorSettings | None,
    units: tuple[float, ...] = (),
) -> Flow:
    """The Flow of this kind that was built last from the same things, or a new one."""
    names, invariants, settings = tuple(free), tuple(unfolded), settings or IntegratorSettings()
    conditions = (mode(), os.environ.get("CC"), os.environ.get("ORBITFINDER_CACHE"))  # what decides on compiling
    key = (Same(kind), Same(model), model.parameter_values.tobytes(), names, *map(Same, invariants), settings,
           conditions, units)  # fmt: skip
    return (_small if len(model.state_names) <= SMALL else _large)(
        key, lambda: kind(model, settings, names, invariants, vector_field(model, names, invariants), units)
    )


_small, _large = Kept["Flow"](2), Kept["Flow"](1)


def _solved(
    name: str, field: ca.Function, symbol: Any, options: dict[str, Any], inputs: Sequence[Any], grid: Any = 1
) -> Any:
    """y at the end of a segment, or at each of a grid, of y' = field(t, y, s, free) from `inputs`.

    These are t0, y there, the duration, s and free. Time is scaled to [0, 1] so that the duration is a parameter.
    """
    clock, t0, duration = symbol("clock"), symbol("t0"), symbol("duration")
    y, s, free = (symbol(f"a{k}", field.size1_in(k)) for k in (1, 2, 3))
    rate = duration * field(t0 + clock * duration, y, s, free)
    problem = {"t": clock, "x": y, "p": ca.vertcat(t0, duration, s, free), "ode": rate}
    solver = ca.integrator(name, "cvodes", problem, 0, grid, options)
    return solver(x0=inputs[1], p=ca.vertcat(inputs[0], inputs[2], *inputs[3:]))["xf"]


def _in_units(field: ca.Function, units: tuple[float, ...]) -> ca.Function:
    """The field of x / units."""
    if not units:
        return field
    t, y, s, free = _arguments(field)
    sizes = ca.DM(units)
    return ca.Function("field", [t, y, s, free], [field(t, sizes * y, s, free) / sizes])


def custom_jacobian(
    field: ca.Function, derivatives: ca.Function, inputs: list[ca.MX], names: list[str], forced: bool
) -> ca.Function:
    """Jacobian blocks of `end` from the variational equations.

    Starting later by dt at the same state and duration changes the end by
    (f(t0 + duration, end) - Phi f(t0, start)) dt, which is zero for autonomous equations.
    """
    t0, start, duration, s, free = inputs
    size = field.size1_in(1)
    end, sensitivity = derivatives(*inputs)
    later = ca.MX(size, 1)
    if forced:
        later = field(t0 + duration, end, s, free) - sensitivity[:, :size] @ field(t0, start, s, free)
    blocks = [
        later,
        sensitivity[:, :size],
        field(t0 + duration, end, s, free),
        sensitivity[:, size : size + s.numel()],
        sensitivity[:, size + s.numel() :],
    ]
    outputs = [f"jac_xf_{name}" for name in names]
    ignored = ca.MX.sym("out_xf", size)
    return ca.Function("jac_flow_end", [*inputs, ignored], blocks, [*names, "out_xf"], outputs)


def end_state(flow: Flow, state: np.ndarray, duration: float, start: float = 0.0) -> np.ndarray:
    """x(start + duration) from x(start) = state (2n); duration in s. Raises `IntegrationError`."""
    return np.asarray(_call(flow, flow.end, state, duration, start)[0])


def transition(flow: Flow, state: np.ndarray, duration: float, start: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """End state (2n) and state-transition matrix dx(end)/dx(start) (2n x 2n)."""
    end, sensitivity = _call(flow, flow.derivatives, state, duration, start)
    return np.asarray(end), np.asarray(sensitivity)[:, : end.size]


def _call(flow: Flow, function: ca.Function, state: np.ndarray, duration: float, start: float) -> list[Any]:
    state = check_state(flow.model, state)
    free = flow.model.parameters()[[flow.model.parameter_index(name) for name in flow.free]]
    with sundials(state, start, duration):
        result = function.call([start, state, duration, ca.DM.zeros(len(flow.unfolded)), free])
    numbers = [value.full().ravel() if k == 0 else value.full() for k, value in enumerate(result)]
    if not all(np.all(np.isfinite(number)) for number in numbers):
        raise integration_error("the state is not finite", state, start, duration)
    return numbers


def sample(flow: Flow, state: np.ndarray, duration: float, count: int, start: float = 0.0) -> np.ndarray:
    """States (count x 2n) at `count` equal times from 0 to `duration` inclusive, by CVODES."""
    state = check_state(flow.model, state)
    if count < 2:
        raise InputError(f"count: must be at least 2, the start and the end, got {count}")
    options = dict(flow.settings.options(), max_num_steps=20 * flow.settings.max_steps)
    chosen = flow.model.parameters()[[flow.model.parameter_index(name) for name in flow.free]]
    given, grid = (
        [start, state, duration, ca.DM.zeros(len(flow.unfolded)), ca.vec(chosen)],
        np.linspace(0.0, 1.0, count),
    )
    with sundials(state, start, duration):
        return np.asarray(_solved("samples", flow.field, symbol_of(flow.field), options, given, list(grid)).full().T)


@contextlib.contextmanager
def sundials(state: np.ndarray, start: float, duration: float, segment: int | None = None) -> Iterator[None]:
    """What an integrator prints inside the block is kept back, and its failure becomes one `IntegrationError`."""
    failure: RuntimeError | None = None
    with captured() as output, alarm():
        try:
            yield
        except RuntimeError as error:
            failure = error
    if failure is not None:
        raise integration_error(f"{output.text}\n{failure}", state, start, duration, segment) from None


def integration_error(
    text: str, state: np.ndarray, start: float, duration: float, segment: int | None = None
) -> IntegrationError:
    """One typed error out of what SUNDIALS printed; the time is read from its message if it is there."""
    moment = re.search(r"[Aa]t t = ([-+0-9.eE]+)", text)
    time = start + (float(moment.group(1)) if moment else 0.0) * duration
    causes = {
        r"NaN detected|RHSFUNC": "the equations of motion are not finite there (0 / 0, the root of a negative number, "
        "or a motion that has run off to infinity); write them so that they are smooth along the motion",
        r"mxstep|TOO_MUCH_WORK": f"too many internal steps in {duration:.4g} s; that is too long for one segment, or "
        "the motion too fast: take more segments or a shorter period",
        r"not finite|nan|NaN": "the equations of motion are not finite there",
        r"hmin|ERR_FAILURE|error test failures": "the step size fell to nothing; the motion is singular there",
        r"CONV_FAILURE|convergence test": "the corrector does not converge; the motion is singular there",
        r"too much accuracy|TOO_MUCH_ACC": "the tolerance asked for is below round-off; loosen it",
        r"tout too close|TOO_CLOSE": "the time span is too short to integrate",
        r"ILL_INPUT": f"{duration:.4g} s cannot be told in steps that the motion needs; take a shorter time",
    }
    reason = next((said for pattern, said in causes.items() if re.search(pattern, text)), None)
    last = text.strip().splitlines()[-1][:200] if text.strip() else "no message"
    if flag := re.search(r'returned "(\w+)"', last):
        last = f"SUNDIALS gives up ({flag.group(1)}); start elsewhere, or take a shorter time"
    return IntegrationError(reason or last, segment=segment, time=time, state=np.asarray(state))


def transition_function(flow: Flow) -> ca.Function:
    """Phi(t0, x0, duration, s, free) (2n x 2n) with a Jacobian in all of its arguments.

    The system has m + m K + m^2 K unknowns for m = 2n and K = m + unfoldings + freed parameters (two
    links: 104), so this is for a handful of degrees of freedom.
    """
    names, inputs = flow.inputs()
    t0, state, duration, s, free = inputs
    size, unfolded = state.numel(), s.numel()
    count = size + unfolded + free.numel()
    rates, unit = _second_rates(flow.field, count), ca.vec(ca.horzcat(ca.MX.eye(size), ca.MX.zeros(size, count - size)))
    start = ca.vertcat(state, ca.densify(unit), ca.MX.zeros(size**2 * count))
    reached = _solved("second_order", rates, symbol_of(rates), flow.settings.options(), [t0, start, *inputs[2:]])
    end, columns, second = _parts(reached, size, count)
    arguments = _arguments(flow.field)
    slope = ca.Function("slope", arguments, [ca.densify(ca.jacobian(flow.field(*arguments), arguments[1]))])
    matrix = columns[:, :size]
    last = slope(t0 + duration, end, s, free) @ matrix
    later = ca.MX(size**2, 1)
    if flow.model.forced:
        first = ca.vec(matrix @ slope(t0, state, s, free)) + second[:, :size] @ flow.field(t0, state, s, free)
        later = ca.vec(last) - first
    blocks = [later, second[:, :size], ca.vec(last), second[:, size : size + unfolded], second[:, size + unfolded :]]
    known = ca.MX.sym("out_matrix", size, size)
    outputs = [f"jac_matrix_{name}" for name in names]
    jacobian = ca.Function("jac_transition", [*inputs, known], blocks, [*names, "out_matrix"], outputs)
    options = {"custom_jacobian": jacobian, "never_inline": True, "jac_penalty": 0}
    plain = flow.derivatives(*inputs)[1][:, :size]
    return ca.Function("transition", inputs, [plain], names, ["matrix"], options)


def _arguments(field: ca.Function) -> list[Any]:
    return [symbol_of(field)(f"a{k}", field.size1_in(k)) for k in range(4)]


def _second_rates(field: ca.Function, count: int) -> ca.Function:
    """(t, (x, C, D), s, free) -> rates of x (m), C = dx/da (m x K) and D = dvec(Phi)/da (m^2 x K), a column."""
    t, x, s, free = _arguments(field)
    size, extra, symbol = x.numel(), s.numel() + free.numel(), type(x).sym
    columns, second = symbol("columns", size, count), symbol("second", size**2, count)
    matrix = symbol("matrix", size, size)
    rate = field(t, x, s, free)
    first = ca.jtimes(rate, x, columns)
    if extra:
        given = ca.horzcat(ca.jacobian(rate, s), ca.jacobian(rate, free))
        first += ca.horzcat(type(x)(size, size), given)
    turned = ca.vec(ca.jtimes(rate, x, matrix))
    slopes = ca.jtimes(turned, x, columns) + ca.jtimes(turned, ca.vec(matrix), second)
    if extra:
        slopes += ca.horzcat(type(x)(size**2, size), ca.jacobian(turned, s), ca.jacobian(turned, free))
    inner = ca.Function("inner", [t, x, s, free, columns, second, matrix], [rate, first, slopes])
    whole, (t, _, s, free) = symbol("whole", size * (1 + count + size * count)), _arguments(field)
    parts = _parts(whole, size, count)
    moved = inner(t, parts[0], s, free, *parts[1:], parts[1][:, :size])
    return ca.Function("rates", [t, whole, s, free], [ca.vertcat(*[ca.vec(part) for part in moved])])


def _parts(whole: Any, size: int, count: int) -> tuple[Any, Any, Any]:
    """x, dx/da and dvec(Phi)/da from one column."""
    blocks = ca.vertsplit(whole, [0, size, size * (1 + count), whole.numel()])
    return blocks[0], ca.reshape(blocks[1], size, count), ca.reshape(blocks[2], size**2, count)
