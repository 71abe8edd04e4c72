"""State-transition matrices whose own derivatives are integrated with them.

    Phi' = A Phi,    (dPhi/da)' = A dPhi/da + (dA/dx dx/da + dA/da) Phi

for every initial value and parameter a, all under CVODES' error control: CasADi's derivatives of
an integrator can be silently wrong (casadi issue 4383).
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from orbitfinder.integrate.cvodes import Flow

NAMES = ["t0", "x0", "duration", "s", "free"]


def transition_function(flow: Flow) -> ca.Function:
    """Phi(t0, x0, duration, s, free) (2n x 2n) with a Jacobian in all of its arguments.

    The system has m + m K + m^2 K unknowns for m = 2n and K = m + unfoldings + freed parameters (two
    links: 104), so this is for a handful of degrees of freedom.
    """
    sizes = [1, flow.field.size1_in(1), 1, flow.field.size1_in(2), flow.field.size1_in(3)]
    inputs = [ca.MX.sym(name, size) for name, size in zip(NAMES, sizes, strict=True)]
    t0, state, duration, s, free = inputs
    size, count = sizes[1], sizes[1] + sizes[3] + sizes[4]
    end, columns, second = _integrated(flow, inputs, count)
    matrix, slope = columns[:, :size], _slope(flow)
    last = slope(t0 + duration, end, s, free) @ matrix
    later = ca.MX(size**2, 1)
    if flow.model.forced:
        first = ca.vec(matrix @ slope(t0, state, s, free)) + second[:, :size] @ flow.field(t0, state, s, free)
        later = ca.vec(last) - first
    blocks = [later, second[:, :size], ca.vec(last), second[:, size : size + sizes[3]], second[:, size + sizes[3] :]]
    known = ca.MX.sym("out_matrix", size, size)
    outputs = [f"jac_matrix_{name}" for name in NAMES]
    jacobian = ca.Function("jac_transition", [*inputs, known], blocks, [*NAMES, "out_matrix"], outputs)
    options = {"custom_jacobian": jacobian, "never_inline": True, "jac_penalty": 0}
    plain = flow.derivatives(*inputs)[1][:, :size]
    return ca.Function("transition", inputs, [plain], NAMES, ["matrix"], options)


def _slope(flow: Flow) -> ca.Function:
    """A(t, x, s, free) = df/dx."""
    arguments = _symbols(flow)
    return ca.Function("slope", arguments, [ca.densify(ca.jacobian(flow.field(*arguments), arguments[1]))])


def _symbols(flow: Flow) -> list[Any]:
    symbol: Any = ca.SX.sym if flow.field.is_a("SXFunction") else ca.MX.sym
    return [symbol(f"a{k}", flow.field.size1_in(k)) for k in range(4)]


def _rates(flow: Flow, count: int) -> ca.Function:
    """(t, x, s, free, C, D) -> rates of x (m), C = dx/da (m x K) and D = dvec(Phi)/da (m^2 x K)."""
    t, x, s, free = _symbols(flow)
    size, extra, symbol = x.numel(), s.numel() + free.numel(), type(x).sym
    columns, second = symbol("columns", size, count), symbol("second", size**2, count)
    matrix = symbol("matrix", size, size)
    rate = flow.field(t, x, s, free)
    first = ca.jtimes(rate, x, columns)
    if extra:
        given = ca.horzcat(ca.jacobian(rate, s), ca.jacobian(rate, free))
        first += ca.horzcat(type(x)(size, size), given)
    turned = ca.vec(ca.jtimes(rate, x, matrix))
    slopes = ca.jtimes(turned, x, columns) + ca.jtimes(turned, ca.vec(matrix), second)
    if extra:
        slopes += ca.horzcat(type(x)(size**2, size), ca.jacobian(turned, s), ca.jacobian(turned, free))
    inner = ca.Function("inner", [t, x, s, free, columns, second, matrix], [rate, first, slopes])
    again = [*_symbols(flow), symbol("columns", size, count), symbol("second", size**2, count)]
    return ca.Function("rates", again, inner(*again, again[4][:, :size]))


def _integrated(flow: Flow, inputs: list[ca.MX], count: int) -> tuple[ca.MX, ca.MX, ca.MX]:
    """x, dx/da and dvec(Phi)/da at the end of a segment."""
    size = inputs[1].numel()
    _, x, s, free = _symbols(flow)
    symbol = type(x).sym
    clock, t0, span = symbol("clock"), symbol("t0"), symbol("span")
    lengths = [size, size * count, size**2 * count]
    whole = symbol("whole", sum(lengths))
    parts = ca.vertsplit(whole, [0, lengths[0], lengths[0] + lengths[1], sum(lengths)])
    moved = _rates(flow, count)(
        t0 + clock * span, parts[0], s, free, ca.reshape(parts[1], size, count), ca.reshape(parts[2], size**2, count)
    )
    packed = ca.vertcat(t0, span, s, free)
    ode = span * ca.vertcat(*[ca.vec(part) for part in moved])
    solver = ca.integrator(
        "second_order", "cvodes", {"t": clock, "x": whole, "p": packed, "ode": ode}, 0, 1, flow.settings.options()
    )
    unit = ca.vec(ca.horzcat(ca.MX.eye(size), ca.MX.zeros(size, count - size)))
    start = ca.vertcat(inputs[1], ca.densify(unit), ca.MX.zeros(lengths[2]))
    end = solver(x0=start, p=ca.vertcat(inputs[0], inputs[2], *inputs[3:]))["xf"]
    found = ca.vertsplit(end, [0, lengths[0], lengths[0] + lengths[1], sum(lengths)])
    return found[0], ca.reshape(found[1], size, count), ca.reshape(found[2], size**2, count)
