"""CasADi's scalar instructions as C over vectors: one register for each number, a lane for each segment.

The numbers are those of CasADi's own code but for sin and cos, which are good to 1.5 ulp (see `kernel.c`).
"""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from orbitfinder.integrate.compiled import Unavailable
from orbitfinder.integrate.lanes.factors import SparseSlopes

BINARY = {
    ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}",
    ca.OP_LT: "truth({} < {})", ca.OP_LE: "truth({} <= {})", ca.OP_EQ: "truth({} == {})", ca.OP_NE: "truth({} != {})",
    ca.OP_AND: "truth(({} != 0.0) & ({} != 0.0))", ca.OP_OR: "truth(({} != 0.0) | ({} != 0.0))",
    ca.OP_IF_ELSE_ZERO: "kept({} != 0.0, {})", ca.OP_CONSTPOW: "v_pow({}, {})",
    **{getattr(ca, f"OP_{name.upper()}"): f"v_{name}({{}}, {{}})" for name in (
        "pow", "fmod", "remainder", "copysign", "fmin", "fmax", "atan2", "hypot",
    )},
}  # fmt: skip
UNARY = {
    ca.OP_ASSIGN: "{0}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}", ca.OP_INV: "1.0 / {0}",
    ca.OP_NOT: "truth({0} == 0.0)", ca.OP_FABS: "absolute({0})",
    **{getattr(ca, f"OP_{name.upper()}"): f"v_{name}({{0}})" for name in (
        "sqrt", "sin", "cos", "exp", "log", "tan", "asin", "acos", "atan", "floor", "ceil", "erf", "sinh", "cosh",
        "tanh", "asinh", "acosh", "atanh", "sign", "log1p", "expm1",
    )},
}  # fmt: skip
MOST_NUMBERS = 3000
"""That a function may hold at once: 64 bytes each of a thread's stack, which may have 512 KB"""


class Unknown(Unavailable):
    """What lanes do not have; the message names it."""


def scalars(function: ca.Function) -> ca.Function:
    """The function as an expression of scalars. Raises `Unknown` for splines, solvers, callbacks and the like."""
    if function.is_a("SXFunction"):
        return function
    try:
        return function.expand()
    except RuntimeError as error:
        raise Unknown(f"{function.name()} is no expression of scalars: {str(error).strip().splitlines()[-1]}") from None


def emitted(function: ca.Function, name: str, inverses: bool = False) -> str:
    """`static void NAME(const V *a0, ..., V *r0, ...)` of a function of scalars. Raises `Unknown`.

    The first output is written whole, of the others the nonzeros, one after another as CasADi keeps them. With
    `inverses` quotients by the same number are products, good to 1.5 ulp, in a sixteenth of the time.
    """
    if function.sz_w() > MOST_NUMBERS:
        raise Unknown(f"{function.name()} holds {function.sz_w()} numbers at once")
    arguments = [f"const V *a{k}" for k in range(function.n_in())] + [f"V *r{k}" for k in range(function.n_out())]
    lines = [f"static __attribute__((noinline)) void {name}({', '.join(arguments)}) {{"]
    lines.append("  V " + ", ".join(f"w{k}" for k in range(max(1, function.sz_w()))) + ";")
    places = function.sparsity_out(0).find()
    lines += [f"  r0[{place}] = all(0.0);" for place in sorted(set(range(function.numel_out(0))) - set(places))]
    own = _inverses(function) if inverses else {}
    lines += [f"  {own.get(k) or _instruction(function, k, places)}" for k in range(function.n_instructions())]
    return "\n".join([*lines, "}", ""])


def _inverses(function: ca.Function) -> dict[int, str]:
    """The instructions that divide by what others divide by too, as products with its inverse."""
    written, quotients = dict[int, int](), defaultdict[int, list[int]](list)
    for k in range(function.n_instructions()):
        if function.instruction_id(k) == ca.OP_DIV:
            quotients[written[function.instruction_input(k)[1]]].append(k)
        if function.instruction_id(k) != ca.OP_OUTPUT:
            written[function.instruction_output(k)[0]] = k
    own = dict[int, str]()
    for divisor, numbers in quotients.items():
        for k in numbers if len(numbers) > 1 else ():
            above, below = function.instruction_input(k)
            first = f"const V i{divisor} = 1.0 / w{below}; " if k == numbers[0] else ""
            own[k] = f"{first}w{function.instruction_output(k)[0]} = w{above} * i{divisor};"
    return own


def _instruction(function: ca.Function, k: int, places: list[int]) -> str:
    code, given, made = (of(k) for of in (function.instruction_id, function.instruction_input,
                                          function.instruction_output))  # fmt: skip
    if code == ca.OP_CONST:
        return f"w{made[0]} = all({_number(function.instruction_constant(k))});"
    if code == ca.OP_INPUT:
        return f"w{made[0]} = a{given[0]}[{given[1]}];"
    if code == ca.OP_OUTPUT:
        return f"r{made[0]}[{made[1] if made[0] else places[made[1]]}] = w{given[0]};"
    form = UNARY.get(code) or BINARY.get(code)
    if form is None:
        names = [name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code]
        raise Unknown(f"{function.name()} has {', '.join(names) or code}")
    return f"w{made[0]} = {form.format(*(f'w{number}' for number in given))};"


def _number(value: float) -> str:
    """A constant, to the last bit."""
    if value != value:
        return "NAN"
    if value in (np.inf, -np.inf):
        return "INFINITY" if value > 0 else "-INFINITY"
    return float(value).hex()


def field_code(given: ca.Function | SparseSlopes, inverses: bool = False) -> str:
    """What `march.c` needs of y' = f(t, y, s, free), alone or with df/dx; `inverses` as in `emitted`."""
    field = scalars(given) if isinstance(given, ca.Function) else given.function
    state, unfolding, free = (field.size1_in(k) for k in (1, 2, 3))
    sizes = {"STATE": state, "OWN": state, "UNFOLDING": unfolding, "FREE": free}
    numbers = "const V *s, const V *freed"
    if isinstance(given, ca.Function):
        called = "rates(&t, y, s, freed, k[{}]);"
        return _heads(sizes) + emitted(field, "rates", inverses) + _stages("states", "V", numbers, "OWN", called)
    sizes |= {"OWN": field.numel_out(0), "COLUMNS": state + unfolding + free, "SLOPES": max(1, len(given.columns))}
    sizes |= {"INNER": given.inner, "PLACED": given.placed}
    tables = "".join(f"static const int {name}[] = {{{', '.join(map(str, values))}}};\n"
                     for name, values in (("BEGIN", given.begins), ("COLUMN", given.columns)))  # fmt: skip
    more = "V (*slope)[SLOPES], V (*forcing)[FORCING]"
    called = "rates(&t, y, s, freed, k[{0}], slope[{0}], forcing[{0}]);"
    return "".join([
        _heads(sizes), tables, emitted(field, "rates", inverses),
        _stages("states", "V", f"{numbers}, {more}", "OWN", called),
        _stages("columns", "W", f"{more}, int first", "MOVING", "product(k[{0}], slope[{0}], forcing[{0}], y, first);",
                bool(given.placed)),
    ])  # fmt: skip


def _heads(sizes: dict[str, int]) -> str:
    return "".join(f"#define {name} {value}\n" for name, value in sizes.items())


def _stages(name: str, kind: str, arguments: str, size: str, called: str, placed: bool = False) -> str:
    """`NAME(z, h, t0, ...)`: Dormand and Prince's twelve stages k of y' = f(t, y) from z, each made by `called`.

    Numbers are of the `kind` V or W. y is advanced in z; with `error` a thirteenth stage estimates what a step of it
    is wrong by (SciPy's norm). Where y is `placed` it is `size` positions and their velocities, and k are the rates of
    these alone: the same method in Nyström's form.
    """
    given = ", ".join(f"{kind} {each}" for each in ("*z", "h", "t0", "*y", f"(*k)[{size}]", "*error"))

    def every(to: str, form: str, *rows: np.ndarray) -> str:
        """Numbers `to` as a form has them of z and of sums of rates by rows of weights."""
        loop, each = f"  for (int i = 0; i < {size}; i++)", [_combined(row) for row in rows]
        if not placed:
            return f"{loop} {to}[i] = {form.format('[i]', *each)};"
        places, rates = zip(*(_of_second_order(row, f"z[i + {size}]") for row in rows), strict=True)
        at, rate = form.format("[i]", *places), form.format(f"[i + {size}]", *rates)
        return f"{loop} {{ const {kind} at = {at}; {to}[i + {size}] = {rate}; {to}[i] = at; }}"

    lines = [f"static void {name}({given}, {arguments}) {{", f"  {kind} t;"]
    for stage, (shift, row) in enumerate(zip(DOP853.C, DOP853.A, strict=True)):
        lines.append(f"  t = t0{f' + {_number(shift)} * h' if shift else ''};")
        lines.append(every("y", "z{}{}", row[:stage]))
        lines.append(f"  {called.format(stage)}")
    lines.append(every("z", "z{}{}", DOP853.B))
    lines += ["  if (!error) return;", "  t = t0 + h;", every("y", "z{}{}", DOP853.B[:0]), f"  {called.format(12)}"]
    lines.append(every("error", f"estimate_{kind}(0.0{{1}}, 0.0{{2}})", DOP853.E5, DOP853.E3))
    return "\n".join([*lines, "}", ""])


def _of_second_order(row: np.ndarray, velocity: str) -> tuple[str, str]:
    """What positions and velocities gain by such a row of weights of rates, which the velocities have.

    That of positions weighs what that row's velocities gained again: exactly, but for the table's own round-off.
    """
    table = np.column_stack([np.ones(13), [*DOP853.A, DOP853.B]])[: len(row)]
    exact = np.vectorize(Fraction, otypes=[object])
    terms = exact(row)[:, None] * exact(table)
    whole, size = terms.sum(axis=0, initial=Fraction()), np.abs(terms).sum(axis=0, initial=Fraction())
    weights = np.where(np.abs(whole) > 1e-14 * size, whole, 0).astype(float)
    drifted = f" + h * {_number(weights[0])} * {velocity}" if weights[0] else ""
    return drifted + _terms("h * h", weights[1:]), _terms("h", row)


def _terms(by: str, weights: np.ndarray) -> str:
    """Products of rates with numbers that are the same for all."""
    return "".join(f" + {by} * {_number(float(w))} * k[{k}][i]" for k, w in enumerate(weights) if w != 0.0)


def _combined(weights: np.ndarray) -> str:
    terms = [f"{_number(float(weight))} * k[{k}][i]" for k, weight in enumerate(weights) if weight != 0.0]
    return f" + h * ({' + '.join(terms)})" if terms else ""
