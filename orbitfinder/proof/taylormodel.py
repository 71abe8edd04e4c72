"""A program on Taylor models in time: what the orders above p amount to over a whole step.

A function on [0, h] is held as   u(t) = sum_{k<p} u_k t^k + t^p r,   r in a ball for every t of the step.
The coefficients are those of `series`; here the balls r are found, operation by operation. Since time
stays a variable, an enclosure over a step loses little by dependency, where a box of all states would.

Source for the arithmetic: K. Makino, M. Berz, "Taylor models and other validated functional inclusion
methods", International Journal of Pure and Applied Mathematics 4 (2003) 379-456. The rules below write
t^p as a factor of the remainder and bound tails of products by Horner's rule on [0, h].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import mul
from typing import Any

from orbitfinder.proof.balls import arb
from orbitfinder.proof.series import WHOLE, Recurrence, operands

Series = list[Any]


def tails(series: Sequence[Any], rest: Any, span: Any) -> list[Any]:
    """[T_p, ..., T_1, T_0] with T_p = rest, T_j = u_j + [0, h] T_{j+1}: sum_{k>=j} u_k t^{k-j} on the step.

    `series` are the p coefficients; T_0 is the range of the whole function. Works on matrices too.
    """
    bounds = [rest]
    for coefficient in reversed(series):
        bounds.append(coefficient + bounds[-1] * span)
    return bounds


def remainders(code: Recurrence, values: Sequence[Series], order: int, span: Any, inputs: Sequence[Any]) -> list[Any]:
    """The ball r of every value of a program over a step `span` = [0, h], p = `order`.

    `inputs` are those of `code.variables`.
    """
    model = _Model(values, order, span)
    for (value, _, _), ball in zip(code.variables, inputs, strict=True):
        model.rest[value] = ball
    for name, target, a, b, constant in code.operations:
        if name in ("add", "sub", "neg"):  # of which the remainder is that of their operands' remainders
            model.rest[target] = WHOLE[name](*operands(model.rest, a, b, constant))
        elif name == "sincos":
            model.rest[target], model.rest[b] = _sincos(model, target, a, b)
        else:
            model.rest[target] = RULES[name](model, target, a, b, constant)
    return model.rest


class _Model:
    """Remainders found so far, and tails that several operations need."""

    def __init__(self, values: Sequence[Series], order: int, span: Any) -> None:
        self.values, self.order, self.span = values, order, span
        self.rest: list[Any] = [arb(0)] * len(values)
        self.known: dict[tuple[int, bool], list[Any]] = {}
        self.slopes: dict[int, list[Any]] = {}

    def series(self, value: int) -> Series:
        """Its p coefficients."""
        return self.values[value][: self.order]

    def tails(self, value: int, whole: bool = True) -> list[Any]:
        """Tails of a value, of its polynomial alone unless `whole`."""
        key = (value, whole)
        if key not in self.known:
            self.known[key] = tails(self.series(value), self.rest[value] if whole else arb(0), self.span)
        return self.known[key]

    def slope_tails(self, value: int) -> list[Any]:
        """Tails of the derivative of a value's polynomial (p - 1 coefficients)."""
        if value not in self.slopes:
            derivative = [k * u for k, u in enumerate(self.series(value))][1:]
            self.slopes[value] = tails(derivative, arb(0), self.span)
        return self.slopes[value]

    def range(self, value: int) -> Any:
        """Hull of the ranges of a value and of its polynomial."""
        return self.tails(value)[-1].union(self.tails(value, whole=False)[-1])

    def behind(self, value: int, divisor: int) -> Any:
        """The orders from p of (divisor) (polynomial of value) without the divisor's constant, t^p taken out."""
        return sum(
            map(mul, [*self.series(divisor)[1:], self.rest[divisor]], self.tails(value, whole=False)[1:]), arb(0)
        )

    def beyond(self, value: int, derivative: int) -> Any:
        """The orders from p - 1 of (polynomial of value) (d/dt polynomial of derivative), t^{p-1} taken out."""
        return sum(map(mul, self.series(value), self.slope_tails(derivative)), arb(0))


def _product(m: _Model, _w: int, u: int, v: int, _c: None) -> Any:
    """r_w = sum_{i<p} u_i T_{p-i}(v) + r_u v."""
    return sum(map(mul, [*m.series(u), m.rest[u]], m.tails(v)), arb(0))


def _divide(m: _Model, w: int, u: int, v: int, _c: None) -> Any:
    """From v (W + t^p r_w) = u with W the polynomial: r_w = (r_u - sum_{i>=1} v_i T_{p-i}(W) - r_v W) / v."""
    return (m.rest[u] - m.behind(w, v)) / m.tails(v)[-1]


def _quotient(m: _Model, w: int, u: int, *_: Any) -> Any:
    """The same for a constant over u."""
    return -m.behind(w, u) / m.tails(u)[-1]


def _sincos(m: _Model, s: int, u: int, c: int) -> tuple[Any, Any]:
    """Z = C + i S (polynomials) has Z' = i U' Z + t^{p-1} D, so |exp(iU) - Z| <= t^p max|D| / p."""
    defect = abs(m.beyond(c, u)) + abs(m.beyond(s, u))
    bound = arb(0, (defect / m.order).upper())
    span = m.range(u)
    return bound + m.rest[u] * span.cos(), bound - m.rest[u] * span.sin()


def _hull(x: Any) -> Any:
    return x.union(arb(0))


def _exp(m: _Model, w: int, u: int, *_: Any) -> Any:
    """W = e^U (1 + g) with g' = -t^{p-1} D e^-U, D the tail of U' W."""
    span = m.range(u)
    growth = _hull(m.beyond(w, u) * (-span).exp()) / m.order
    return span.exp() * (growth + m.rest[u])


def _log(m: _Model, w: int, u: int, *_: Any) -> Any:
    """(log U - W)' = t^{p-1} D / U, D minus the tail of U W'... of which log(U + t^p r_u) differs by r_u / U."""
    span = m.range(u)
    return (m.rest[u] - _hull(m.beyond(u, w)) / m.order) / span if span > 0 else arb("nan")


def _power(m: _Model, w: int, u: int, _v: int, c: Any) -> Any:
    """W = U^c (1 + g) with g' = t^{p-1} D / U^{c+1}, D the tail of W' U - c W U'."""
    span = m.range(u)
    if not span > 0:
        return arb("nan")
    defect = m.beyond(u, w) - c * m.beyond(w, u)
    growth = _hull(defect / span ** (c + 1)) / m.order
    return -(span**c) * growth + c * span ** (c - 1) * m.rest[u]


RULES: dict[str, Callable[..., Any]] = {
    "scale": lambda m, w, u, v, c: c * m.rest[u], "shift": lambda m, w, u, v, c: m.rest[u],
    "mul": _product,
    "sq": lambda m, w, u, v, c: _product(m, w, u, u, c),
    "div": _divide, "quotient": _quotient, "exp": _exp, "log": _log, "power": _power,
    "sqrt": lambda m, w, u, v, c: _power(m, w, u, v, arb(1) / 2),
}  # fmt: skip
