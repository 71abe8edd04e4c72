"""A program on truncated power series with ball coefficients, one order after the other.

The recurrences are those of automatic differentiation in Taylor mode: products by the Cauchy sum,
quotients, sines and powers from the differential equations that they satisfy. Source: W. Tucker,
Validated Numerics (2011), chapter 4; A. Griewank, A. Walther, Evaluating Derivatives (2008), table 13.2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from operator import add, mul, neg, sub, truediv
from typing import Any

from orbitfinder.proof.balls import arb, arb_poly, arb_series, truncated
from orbitfinder.proof.program import Ring, ScalarProgram

BALLS = Ring(
    arb,
    {
        "add": add, "sub": sub, "mul": mul, "div": truediv, "neg": neg, "pow": pow,
        "sq": lambda a: a * a, "sin": lambda a: a.sin(), "cos": lambda a: a.cos(),
        "sqrt": lambda a: a.sqrt(), "exp": lambda a: a.exp(), "log": lambda a: a.log(),
    },
)  # fmt: skip
WHOLE: dict[str, Callable[..., Any]] = BALLS.functions | {
    "scale": mul, "shift": add, "quotient": lambda u, c: c / u,
    "power": lambda u, c: (u.log() * c).exp(), "div": lambda a, b: a / b if a.length() or not b.length() else a,
}  # fmt: skip
"""The operations of a recurrence on whole series (but for sincos, which has two results)

A quotient without terms stays so: python-flint before 0.9 raises AttributeError there.
"""
POLYNOMIAL = {"add", "sub", "neg", "scale", "shift"}
"""Those that leave polynomials what they are"""
Operation = tuple[str, int, int, int, Any]
"""kind, target, operand, second operand (or -1), constant (or None)"""


@dataclass(frozen=True)
class Recurrence:
    """A program with its parameters filled in: what depends on them alone is folded into balls.

    `variables` are (value, argument, entry) of what is left, `fixed` the values that are constant,
    `operations` act on series. `outputs` as in `ScalarProgram`.
    """

    size: int
    fixed: dict[int, Any]
    variables: tuple[tuple[int, int, int], ...]
    operations: tuple[Operation, ...]
    outputs: tuple[dict[int, int], ...]


def recurrence(code: ScalarProgram, constants: Mapping[int, Sequence[Any]]) -> Recurrence:
    """The recurrence of a program, some of whose arguments are constant balls."""
    fold = _Fold(code, constants)
    for name, target, a, b in code.operations:
        fold.operation(name, target, a, b)
    results = tuple({entry: fold.place(value) for entry, value in result.items()} for result in code.outputs)
    wanted = {value for result in results for value in result.values()}
    kept = []
    for operation in reversed(fold.operations):
        targets = {operation[1], operation[3]} if operation[0] == "sincos" else {operation[1]}
        if targets & wanted:
            kept.append(operation)
            wanted |= {operation[2]} | ({operation[3]} if operation[0] != "sincos" else set())
    return Recurrence(fold.size, fold.fixed, tuple(fold.variables), tuple(reversed(kept)), results)


class _Fold:
    """A program being specialised: constants evaluated, trivial operations removed, sines paired with cosines."""

    def __init__(self, code: ScalarProgram, constants: Mapping[int, Sequence[Any]]) -> None:
        self.size = code.size
        self.fixed = {value: arb(number) for value, number in code.constants}
        self.alias: dict[int, int] = {}
        self.pairs: dict[int, tuple[int, int]] = {}
        self.operations: list[Operation] = []
        self.variables = []
        for value, argument, entry in code.inputs:
            if argument in constants:
                self.fixed[value] = constants[argument][entry]
            else:
                self.variables.append((value, argument, entry))

    def place(self, value: int) -> int:
        """Where a value is found after simplification."""
        return self.alias.get(value, value)

    def operation(self, name: str, target: int, a: int, b: int) -> None:
        """One operation of the program."""
        a, b = self.place(a), self.place(b) if b >= 0 else b
        operands = [value for value in (a, b) if value >= 0]
        if all(value in self.fixed for value in operands):
            self.fixed[target] = BALLS.functions[name](*(self.fixed[value] for value in operands))
        elif name in ("sin", "cos"):
            if a not in self.pairs:
                self.pairs[a] = (self.size, self.size + 1)
                self.size += 2
                self._emit("sincos", self.pairs[a][0], a, self.pairs[a][1], None)
            self.alias[target] = self.pairs[a][0 if name == "sin" else 1]
        elif b >= 0 and (a in self.fixed or b in self.fixed):
            self._mixed(name, target, a, b)
        elif name == "pow":  # a^b = exp(b log a)
            log, self.size = self.size, self.size + 2
            self._emit("log", log, a, -1, None)
            self._emit("mul", log + 1, log, b, None)
            self._emit("exp", target, log + 1, -1, None)
        else:
            self._emit(name, target, a, b, None)

    def _emit(self, name: str, target: int, a: int, b: int, constant: Any) -> None:
        self.operations.append((name, target, a, b, constant))

    def _mixed(self, name: str, target: int, a: int, b: int) -> None:
        """An operation between a constant and a series."""
        constant, series, first = (self.fixed[a], b, True) if a in self.fixed else (self.fixed[b], a, False)
        if name == "pow":
            if first:
                self._emit("exp", target, self._scaled(series, constant.log()), -1, None)
            else:
                self._power(target, series, constant)
        elif name in ("add", "sub"):
            if name == "sub" and first:
                series = self._scaled(series, arb(-1))
            constant = constant if name == "add" or first else -constant
            if constant.is_exact() and constant == 0:
                self.alias[target] = self.place(series)
            else:
                self._emit("shift", target, series, -1, constant)
        elif name == "div" and first:
            self._emit("quotient", target, series, -1, constant)
        else:
            self.alias[target] = self._scaled(series, constant if name == "mul" else 1 / constant, target)

    def _scaled(self, series: int, factor: Any, target: int | None = None) -> int:
        """The value of a series times a constant."""
        if factor.is_exact() and factor == 1:
            return series
        if target is None:
            target, self.size = self.size, self.size + 1
        if factor.is_exact() and factor == 0:
            self.fixed[target] = arb(0)
        elif factor.is_exact() and factor == -1:
            self._emit("neg", target, series, -1, None)
        else:
            self._emit("scale", target, series, -1, factor)
        return target

    def _power(self, target: int, series: int, exponent: Any) -> None:
        """Small whole powers as products, which need no u_0 != 0; others by their differential equation."""
        whole = int(float(exponent.mid())) if exponent.is_exact() and exponent.is_integer() else 0
        if not 2 <= whole <= 16:
            self._emit("power", target, series, -1, exponent)
            return
        result = series
        for k in range(whole - 1):
            place = target if k == whole - 2 else self.size
            self.size += place == self.size
            self._emit("mul", place, result, series, None)
            result = place


def coefficients(
    code: Recurrence, order: int, variables: Callable[[int, list[list[Any]]], Sequence[Any]]
) -> list[list[Any]]:
    """Series of every value of the program, coefficients 0..order.

    `variables(k, outputs)` gives the coefficients of order k of `code.variables`, from the outputs of
    order below k that it finds in the first result's series.
    """
    values: list[list[Any]] = [[] for _ in range(code.size)]
    for value, ball in code.fixed.items():
        values[value] = [ball] + [arb(0)] * order
    steps: list[tuple[Callable[..., None], tuple[Any, ...]]] = [
        (KINDS[name], (values[target], values[a], [], values[b] if b >= 0 else None, constant))
        for name, target, a, b, constant in code.operations
    ]
    inputs = [values[value] for value, _, _ in code.variables]
    first = [values[value] for _, value in sorted(code.outputs[0].items())]
    for k in range(order + 1):
        for series, number in zip(inputs, variables(k, first), strict=True):
            series.append(number)
        for kind, operands in steps:
            kind(k, *operands)
    return values


def whole_series(code: Recurrence, order: int, variables: Sequence[Sequence[Any]]) -> tuple[list[Any], dict[int, Any]]:
    """The same as `coefficients` as Arb's polynomials, the series of `code.variables` known beforehand, and faster;
    and the products with all their terms, those beyond the order too.

    Arb multiplies whole series several times faster than Python does their terms.
    """
    values, products, length = [arb_poly([])] * code.size, dict[int, Any](), order + 1
    for value, ball in code.fixed.items():
        values[value] = arb_poly([ball])
    for (value, _, _), series in zip(code.variables, variables, strict=True):
        values[value] = arb_poly(list(series[:length]))
    with truncated(length):
        for name, target, a, b, constant in code.operations:
            if name in ("mul", "sq"):
                products[target] = values[a] * values[b if b >= 0 else a]
                values[target] = products[target].truncate(length)
            elif name in POLYNOMIAL:
                values[target] = WHOLE[name](*operands(values, a, b, constant))
            elif name == "sincos":
                values[target], values[b] = (arb_poly(each.coeffs()) for each in arb_series(values[a]).sin_cos())
            else:
                given = [arb_series(values[each]) for each in (a, b) if each >= 0]
                made = WHOLE[name](*given, *([] if constant is None else [constant]))
                values[target] = arb_poly(made.coeffs())
    return values, products


def listed(polynomial: Any, order: int) -> list[Any]:
    """The coefficients 0..order of a polynomial."""
    series = polynomial.coeffs()
    return list(series + [arb(0)] * (order + 1 - len(series)))


def operands(values: Sequence[Any], a: int, b: int, constant: Any) -> list[Any]:
    """What an operation acts on: one value or two, or one and a constant."""
    return [values[a], *([values[b]] if b >= 0 else []), *([] if constant is None else [constant])]


def outputs(code: Recurrence, values: Sequence[Any]) -> list[dict[int, Any]]:
    """What belongs to the program's results among something given for each value."""
    return [{entry: values[value] for entry, value in result.items()} for result in code.outputs]


Series = list[Any]
"""What follows appends coefficient k of w = u op v (or op a constant c); `slope` keeps k u_k or k w_k in between."""


def _square(k: int, w: Series, u: Series, *_: Any) -> None:
    """w_k = 2 sum_{j < k/2} u_j u_{k-j} (+ u_{k/2}^2 for even k)."""
    if k == 0:
        w.append(u[0] * u[0])  # not u_0 ** 2, which Arb makes NaN of a wide ball about 0
        return
    half = 2 * sum(map(mul, islice(u, (k + 1) // 2), reversed(u)))
    w.append(half if k % 2 else half + u[k // 2] * u[k // 2])


def _divide(k: int, w: Series, u: Series, _slope: Series, v: Series, _c: Any) -> None:
    """v w = u: w_k = (u_k - sum_{j=1..k} v_j w_{k-j}) / v_0."""
    w.append((u[k] - sum(map(mul, islice(v, 1, None), reversed(w)))) / v[0])


def _quotient(k: int, w: Series, u: Series, _slope: Series, _v: None, c: Any) -> None:
    """u w = c."""
    w.append(c / u[0] if k == 0 else -sum(map(mul, islice(u, 1, None), reversed(w))) / u[0])


def _sincos(k: int, s: Series, u: Series, slope: Series, c: Series, _: None) -> None:
    """s' = c u', c' = -s u': k s_k = sum_{j=1..k} j u_j c_{k-j}."""
    if k == 0:
        sine, cosine = u[0].sin_cos()
    else:
        slope.append(k * u[k])
        sine, cosine = sum(map(mul, slope, reversed(c))) / k, -sum(map(mul, slope, reversed(s))) / k
    s.append(sine)
    c.append(cosine)


def _exp(k: int, w: Series, u: Series, slope: Series, *_: Any) -> None:
    """w' = u' w."""
    if k == 0:
        w.append(u[0].exp())
        return
    slope.append(k * u[k])
    w.append(sum(map(mul, slope, reversed(w))) / k)


def _log(k: int, w: Series, u: Series, slope: Series, *_: Any) -> None:
    """u w' = u': k u_0 w_k = k u_k - sum_{j=1..k-1} j w_j u_{k-j}."""
    if k == 0:
        w.append(u[0].log())
        return
    term = (k * u[k] - sum(map(mul, slope, reversed(u[1:k])))) / (k * u[0])
    slope.append(k * term)
    w.append(term)


def _power(k: int, w: Series, u: Series, _slope: Series, _v: None, c: Any) -> None:
    """u w' = c w u': k u_0 w_k = sum_{j=1..k} (c j - (k - j)) u_j w_{k-j}."""
    if k == 0:
        w.append(u[0] ** c)
        return
    total = sum((c * j - (k - j)) * u[j] * w[k - j] for j in range(1, k + 1))
    w.append(total / (k * u[0]))


def _sqrt(k: int, w: Series, u: Series, *_: Any) -> None:
    """w^2 = u: 2 w_0 w_k = u_k - sum_{j=1..k-1} w_j w_{k-j}."""
    if k == 0:
        w.append(u[0].sqrt())
        return
    w.append((u[k] - sum(map(mul, w[1:], reversed(w[1:])))) / (2 * w[0]))


KINDS: dict[str, Callable[..., None]] = {
    "add": lambda k, w, u, slope, v, c: w.append(u[k] + v[k]),
    "sub": lambda k, w, u, slope, v, c: w.append(u[k] - v[k]),
    "neg": lambda k, w, u, slope, v, c: w.append(-u[k]),
    "scale": lambda k, w, u, slope, v, c: w.append(c * u[k]),
    "shift": lambda k, w, u, slope, v, c: w.append(u[k] if k else u[k] + c),
    "mul": lambda k, w, u, slope, v, c: w.append(sum(map(mul, u, reversed(v)))),
    "sq": _square, "div": _divide, "quotient": _quotient, "sincos": _sincos, "exp": _exp, "log": _log,
    "power": _power, "sqrt": _sqrt,
}  # fmt: skip
