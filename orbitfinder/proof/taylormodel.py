"""A program on Taylor models in time: what the orders above p amount to over a whole step.

A function on [0, h] is held as   u(t) = sum_{k<p} u_k t^k + t^p r,   r in a ball for every t of the step.
The coefficients are those of `series`; here the balls r are found, operation by operation. Since time
stays a variable, an enclosure over a step loses little by dependency, where a box of all states would.

Source for the arithmetic: K. Makino, M. Berz, "Taylor models and other validated functional inclusion
methods", International Journal of Pure and Applied Mathematics 4 (2003) 379-456. The rules below write
t^p as a factor of the remainder and bound tails of products on [0, h].
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

from orbitfinder.proof.balls import arb
from orbitfinder.proof.series import WHOLE, Recurrence, operands


def tails(series: Sequence[Any], rest: Any, span: Any) -> list[Any]:
    """[T_p, ..., T_1, T_0] with T_p = rest, T_j = u_j + [0, h] T_{j+1}: sum_{k>=j} u_k t^{k-j} on the step.

    `series` are the p coefficients (balls or matrices); T_0 is the range of the whole function.
    """
    bounds = [rest]
    for coefficient in reversed(series):
        bounds.append(coefficient + bounds[-1] * span)
    return bounds


class Beyond:
    """What a program's values amount to beyond order p on a step `span` = [0, h].

    `values` are their polynomials below p; what follows from those alone is found once for all remainders. `products`
    are those that are known in full.
    """

    def __init__(
        self, code: Recurrence, values: Sequence[Any], order: int, span: Any, products: Mapping[int, Any] | None = None
    ) -> None:
        self.code, self.values, self.order, self.span = code, values, order, span
        self.products, self.power = products or {}, span**order
        self.rest: list[Any] = []
        self._known: dict[Hashable, Any] = {}

    def remainders(self, inputs: Sequence[Any]) -> list[Any]:
        """The ball r of every value for those (`inputs`) of `code.variables`."""
        rest = self.rest = [arb(0)] * self.code.size
        for (value, _, _), ball in zip(self.code.variables, inputs, strict=True):
            rest[value] = ball
        for name, target, a, b, constant in self.code.operations:
            if name in ("add", "sub", "neg"):  # of which the remainder is that of their operands' remainders
                rest[target] = WHOLE[name](*operands(rest, a, b, constant))
            elif name == "sincos":
                # Z = C + i S (polynomials) has Z' = i U' Z + t^{p-1} D, so |exp(iU) - Z| <= t^p max|D| / p
                defect, span = abs(self.steep(b, a)) + abs(self.steep(target, a)), self.range(a)
                bound = arb(0, (defect / self.order).upper())
                rest[target], rest[b] = bound + rest[a] * span.cos(), bound - rest[a] * span.sin()
            else:
                rest[target] = RULES[name](self, target, a, b, constant)
        return rest

    def polynomial(self, value: int) -> Any:
        """The range of a value's polynomial."""
        if value not in self._known:
            self._known[value] = self.values[value](self.span)
        return self._known[value]

    def whole(self, value: int) -> Any:
        """The range of a value."""
        return self.polynomial(value) + self.rest[value] * self.power

    def range(self, value: int) -> Any:
        """Hull of the ranges of a value and of its polynomial."""
        return self.whole(value).union(self.polynomial(value))

    def product(self, u: int, v: int, target: int = -1) -> Any:
        """The orders from p of the product of two polynomials, t^p taken out."""
        if (u, v) not in self._known:
            full = self.products[target] if target in self.products else self.values[u] * self.values[v]
            self._known[u, v] = full.right_shift(self.order)(self.span)
        return self._known[u, v]

    def steep(self, value: int, derivative: int) -> Any:
        """The orders from p - 1 of (polynomial of value) (d/dt polynomial of derivative), t^{p-1} taken out."""
        key = ("steep", value, derivative)
        if key not in self._known:
            full = self.values[value] * self.values[derivative].derivative()
            self._known[key] = full.right_shift(self.order - 1)(self.span)
        return self._known[key]


def _product(m: Beyond, w: int, u: int, v: int, _c: None) -> Any:
    """(U + t^p r_u) (V + t^p r_v)."""
    return m.product(u, v, w) + m.rest[u] * m.whole(v) + m.rest[v] * m.polynomial(u)


def _divide(m: Beyond, w: int, u: int, v: int, _c: None) -> Any:
    """From v (W + t^p r_w) = u with W the polynomial: r_w = (r_u - sum_{i>=1} v_i T_{p-i}(W) - r_v W) / v."""
    return (m.rest[u] - m.product(v, w) - m.rest[v] * m.polynomial(w)) / m.whole(v)


def _quotient(m: Beyond, w: int, u: int, *_: Any) -> Any:
    """The same for a constant over u."""
    return -(m.product(u, w) + m.rest[u] * m.polynomial(w)) / m.whole(u)


def _hull(x: Any) -> Any:
    return x.union(arb(0))


def _exp(m: Beyond, w: int, u: int, *_: Any) -> Any:
    """W = e^U (1 + g) with g' = -t^{p-1} D e^-U, D the tail of U' W; of r_u, e^ is taken elsewhere than of g."""
    span = m.range(u)
    whole, growth = span.exp(), _hull(m.steep(w, u) * (-span).exp()) / m.order
    return whole * growth + whole * m.rest[u]


def _log(m: Beyond, w: int, u: int, *_: Any) -> Any:
    """(log U - W)' = t^{p-1} D / U, D minus the tail of U W'... of which log(U + t^p r_u) differs by r_u / U."""
    span = m.range(u)
    return m.rest[u] / span - _hull(m.steep(u, w)) / m.order / span if span > 0 else arb("nan")


def _power(m: Beyond, w: int, u: int, _v: int, c: Any) -> Any:
    """W = U^c (1 + g) with g' = t^{p-1} D / U^{c+1}, D the tail of W' U - c W U'."""
    span = m.range(u)
    if not span > 0:
        return arb("nan")
    defect = m.steep(u, w) - c * m.steep(w, u)
    growth = _hull(defect / span ** (c + 1)) / m.order
    return -(span**c) * growth + c * span ** (c - 1) * m.rest[u]


RULES: dict[str, Callable[..., Any]] = {
    "scale": lambda m, w, u, v, c: c * m.rest[u], "shift": lambda m, w, u, v, c: m.rest[u],
    "mul": _product,
    "sq": lambda m, w, u, v, c: _product(m, w, u, u, c),
    "div": _divide, "quotient": _quotient, "exp": _exp, "log": _log, "power": _power,
    "sqrt": lambda m, w, u, v, c: _power(m, w, u, v, arb(1) / 2),
}  # fmt: skip
