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
from orbitfinder.proof.series import Recurrence

Series = list[Any]


def tails(series: Sequence[Any], rest: Any, span: Any) -> list[Any]:
    """[T_p, ..., T_1, T_0] with T_p = rest, T_j = u_j + [0, h] T_{j+1}: sum_{k>=j} u_k t^{k-j} on the step.

    `series` are the p coefficients; T_0 is the range of the whole function. Works on matrices too.
    """
    found = [rest]
    for coefficient in reversed(series):
        found.append(coefficient + found[-1] * span)
    return found


def remainders(code: Recurrence, values: Sequence[Series], order: int, span: Any, inputs: Sequence[Any]) -> list[Any]:
    """The ball r of every value of a program over a step `span` = [0, h], p = `order`.

    `inputs` are those of `code.variables`.
    """
    model = _Model(values, order, span)
    for (value, _, _), ball in zip(code.variables, inputs, strict=True):
        model.rest[value] = ball
    for name, target, a, b, constant in code.operations:
        RULES[name](model, target, a, b, constant)
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

    def beyond(self, value: int, derivative: int) -> Any:
        """The orders from p - 1 of (polynomial of value) (d/dt polynomial of derivative), t^{p-1} taken out."""
        return sum(map(mul, self.series(value), self.slope_tails(derivative)), arb(0))


def _add(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    m.rest[w] = m.rest[u] + m.rest[v]


def _sub(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    m.rest[w] = m.rest[u] - m.rest[v]


def _neg(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    m.rest[w] = -m.rest[u]


def _scale(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    m.rest[w] = c * m.rest[u]


def _shift(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    m.rest[w] = m.rest[u]


def _mul(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    """r_w = sum_{i<p} u_i T_{p-i}(v) + r_u v."""
    m.rest[w] = sum(map(mul, [*m.series(u), m.rest[u]], m.tails(v)), arb(0))


def _square(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    _mul(m, w, u, u, c)


def _divide(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    """From v (W + t^p r_w) = u with W the polynomial: r_w = (r_u - sum_{i>=1} v_i T_{p-i}(W) - r_v W) / v."""
    product = sum(map(mul, [*m.series(v)[1:], m.rest[v]], m.tails(w, whole=False)[1:]), arb(0))
    m.rest[w] = (m.rest[u] - product) / m.tails(v)[-1]


def _quotient(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    """The same for a constant over u."""
    product = sum(map(mul, [*m.series(u)[1:], m.rest[u]], m.tails(w, whole=False)[1:]), arb(0))
    m.rest[w] = -product / m.tails(u)[-1]


def _sincos(m: _Model, s: int, u: int, c: int, _: Any) -> None:
    """Z = C + i S (polynomials) has Z' = i U' Z + t^{p-1} D, so |exp(iU) - Z| <= t^p max|D| / p."""
    defect = abs(m.beyond(c, u)) + abs(m.beyond(s, u))
    bound = arb(0, (defect / m.order).upper())
    span = m.range(u)
    m.rest[s] = bound + m.rest[u] * span.cos()
    m.rest[c] = bound - m.rest[u] * span.sin()


def _hull(x: Any) -> Any:
    return x.union(arb(0))


def _exp(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    """W = e^U (1 + g) with g' = -t^{p-1} D e^-U, D the tail of U' W."""
    span = m.range(u)
    growth = _hull(m.beyond(w, u) * (-span).exp()) / m.order
    m.rest[w] = span.exp() * (growth + m.rest[u])


def _log(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    """(log U - W)' = t^{p-1} D / U, D minus the tail of U W'... of which log(U + t^p r_u) differs by r_u / U."""
    span = m.range(u)
    m.rest[w] = (m.rest[u] - _hull(m.beyond(u, w)) / m.order) / span if span > 0 else arb("nan")


def _power(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    """W = U^c (1 + g) with g' = t^{p-1} D / U^{c+1}, D the tail of W' U - c W U'."""
    span = m.range(u)
    if not span > 0:
        m.rest[w] = arb("nan")
        return
    defect = m.beyond(u, w) - c * m.beyond(w, u)
    growth = _hull(defect / span ** (c + 1)) / m.order
    m.rest[w] = -(span**c) * growth + c * span ** (c - 1) * m.rest[u]


def _sqrt(m: _Model, w: int, u: int, v: int, c: Any) -> None:
    _power(m, w, u, v, arb(1) / 2)


RULES: dict[str, Callable[..., None]] = {
    "add": _add, "sub": _sub, "neg": _neg, "scale": _scale, "shift": _shift, "mul": _mul, "sq": _square,
    "div": _divide, "quotient": _quotient, "sincos": _sincos, "exp": _exp, "log": _log, "power": _power,
    "sqrt": _sqrt,
}  # fmt: skip
