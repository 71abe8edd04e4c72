"""CasADi's scalar instructions as C over vectors: one register for each number, a lane for each place.

The numbers are those of CasADi's own code but for sin and cos, which are good to 1.5 ulp (see `kernel.c`).
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

BINARY = {
    ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}",
    ca.OP_LT: "truth({} < {})", ca.OP_LE: "truth({} <= {})", ca.OP_EQ: "truth({} == {})", ca.OP_NE: "truth({} != {})",
    ca.OP_AND: "truth(({} != 0.0) & ({} != 0.0))", ca.OP_OR: "truth(({} != 0.0) | ({} != 0.0))",
    ca.OP_IF_ELSE_ZERO: "kept({} != 0.0, {})", ca.OP_POW: "v_pow({}, {})", ca.OP_CONSTPOW: "v_pow({}, {})",
    ca.OP_FMOD: "v_fmod({}, {})", ca.OP_COPYSIGN: "v_copysign({}, {})", ca.OP_FMIN: "v_fmin({}, {})",
    ca.OP_FMAX: "v_fmax({}, {})", ca.OP_ATAN2: "v_atan2({}, {})", ca.OP_HYPOT: "v_hypot({}, {})",
    ca.OP_REMAINDER: "v_remainder({}, {})",
}  # fmt: skip
UNARY = {
    ca.OP_ASSIGN: "{0}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}", ca.OP_INV: "1.0 / {0}",
    ca.OP_NOT: "truth({0} == 0.0)", ca.OP_FABS: "absolute({0})",
    **{getattr(ca, f"OP_{name.upper()}"): f"v_{name}({{0}})" for name in (
        "sqrt", "sin", "cos", "exp", "log", "tan", "asin", "acos", "atan", "floor", "ceil", "erf", "sinh", "cosh",
        "tanh", "asinh", "acosh", "atanh", "sign", "log1p", "expm1",
    )},
}  # fmt: skip


class Unknown(Exception):
    """An operation that lanes do not have; the message names it."""


def emitted(function: ca.Function, name: str) -> str:
    """`static void NAME(const V *a0, ..., V *r0, ...)` of an SX function, all of every vector. Raises `Unknown`."""
    if not function.is_a("SXFunction"):
        raise Unknown(f"{function.name()} is no expression of scalars")
    arguments = [f"const V *a{k}" for k in range(function.n_in())] + [f"V *r{k}" for k in range(function.n_out())]
    lines = [f"static void {name}({', '.join(arguments)}) {{"]
    lines.append("  V " + ", ".join(f"w{k}" for k in range(max(1, function.sz_w()))) + ";")
    inside, outside = ([find(k).find() for k in range(count)] for find, count in (
        (function.sparsity_in, function.n_in()), (function.sparsity_out, function.n_out())))  # fmt: skip
    for k, places in enumerate(outside):
        empty = sorted(set(range(function.numel_out(k))) - set(places))
        lines += [f"  r{k}[{place}] = all(0.0);" for place in empty]
    for k in range(function.n_instructions()):
        lines.append("  " + _instruction(function, k, inside, outside))
    return "\n".join([*lines, "}", ""])


def _instruction(function: ca.Function, k: int, inside: list[list[int]], outside: list[list[int]]) -> str:
    """A statement; `inside` and `outside` are where the numbers stand that inputs and outputs have."""
    code, given, made = (of(k) for of in (function.instruction_id, function.instruction_input,
                                          function.instruction_output))  # fmt: skip
    if code == ca.OP_CONST:
        return f"w{made[0]} = all({_number(function.instruction_constant(k))});"
    if code == ca.OP_INPUT:
        return f"w{made[0]} = a{given[0]}[{inside[given[0]][given[1]]}];"
    if code == ca.OP_OUTPUT:
        return f"r{made[0]}[{outside[made[0]][made[1]]}] = w{given[0]};"
    form = UNARY.get(code) or BINARY.get(code)
    if form is None:
        names = [one for one in dir(ca) if one.startswith("OP_") and getattr(ca, one) == code]
        raise Unknown(f"{function.name()} has {', '.join(names) or code}")
    return f"w{made[0]} = {form.format(*(f'w{one}' for one in given))};"


def _number(value: float) -> str:
    """A constant, to the last bit."""
    if value != value:
        return "NAN"
    if value in (float("inf"), -float("inf")):
        return "INFINITY" if value > 0 else "-INFINITY"
    return float(value).hex()


def stepped(size: int) -> str:
    """The step of `march.c`: `rates(t, y, s, free, result)` at Dormand and Prince's twelve stages."""
    return "\n".join(["static void step(V *z, const V *p) {", *_stages(size), "  z[0] += h;", "}", ""])


def erring(size: int, state: int) -> str:
    """The same with the estimate of its error in the first components (see `rk8.one_step`), `flow` their field."""
    last = len(DOP853.C)
    lines = ["static void erring(V *z, const V *p, V *e) {", *_stages(size), f"  V after[{state}];", "  z[0] += h;"]
    lines.append("  flow(z, z + 1, p + 1, p + 1 + UNFOLDING, after);")
    lines.append(f"  for (int i = 0; i < {state}; i++) {{")
    for name, weights in (("fifth", DOP853.E5), ("third", DOP853.E3)):
        terms = _combined(weights[:last])[3:] + f" + h * ({_number(float(weights[last]))} * after[i])"
        lines.append(f"    V {name} = {terms};")
    lines.append("    e[i] = fifth * fifth / v_sqrt(fifth * fifth + 0.01 * third * third + 1e-300);")
    return "\n".join([*lines, "  }", "}", ""])


def _stages(size: int) -> list[str]:
    lines = [f"  V h = p[0], y[{size}], k[{len(DOP853.C)}][{size}], t;"]
    for stage, (shift, row) in enumerate(zip(DOP853.C, DOP853.A, strict=True)):
        lines.append(f"  t = z[0] + {_number(shift)} * h;" if shift else "  t = z[0];")
        lines.append(f"  for (int i = 0; i < {size}; i++) y[i] = z[1 + i]{_combined(row[:stage])};")
        lines.append(f"  rates(&t, y, p + 1, p + 1 + UNFOLDING, k[{stage}]);")
    return [*lines, f"  for (int i = 0; i < {size}; i++) z[1 + i] += {_combined(DOP853.B)[3:]};"]


def _combined(weights: np.ndarray) -> str:
    terms = [f"{_number(float(one))} * k[{k}][i]" for k, one in enumerate(weights) if one != 0.0]
    return f" + h * ({' + '.join(terms)})" if terms else ""
