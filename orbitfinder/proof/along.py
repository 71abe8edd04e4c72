"""Numbers that vary with the energy over a piece of a family: polynomials with ball coefficients, and the flow on them.

A function of e on [-1, 1] is enclosed by balls c_0..c_D when for each e some numbers of these balls have
f(e) = sum_k c_k e^k. Sums and products of such polynomials are enclosed by those of the balls; what is beyond degree D
goes into c_0's radius. What is nearly a polynomial in e therefore stays as narrow as it is, where a ball that holds it
for every e at once loses all correlation. Source: K. Makino, M. Berz, Int. J. Pure Appl. Math. 4 (2003) 379-456.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from orbitfinder.proof.balls import (
    Vector,
    arb,
    arb_mat,
    arb_poly,
    arb_series,
    block,
    column,
    exact,
    identity,
    truncated,
    up_to,
)
from orbitfinder.proof.enclosure import Cloud, Tube, horner, transition_remainder
from orbitfinder.proof.field import Field, Jet, rate_series
from orbitfinder.proof.series import coefficients, outputs

DEGREE = 8
"""D, the highest power of e that is carried"""


class Along:
    """A function of e on [-1, 1], enclosed by a polynomial with ball coefficients."""

    __slots__ = ("_inverse", "_short", "whole")

    def __init__(self, whole: Any) -> None:
        self.whole = whole
        self._short: Any = None
        self._inverse: Any = None

    @property
    def short(self) -> Any:
        """The polynomial of degree D, the rest in its constant's radius."""
        if self._short is None:
            self._short = self.whole
            if self.whole.length() > DEGREE + 1:
                rest = self.whole.right_shift(DEGREE + 1)(arb(0, 1))
                self._short = self.whole.truncate(DEGREE + 1) + arb(0, abs(rest).upper())
        return self._short

    @property
    def range(self) -> Any:
        """A ball that holds every value."""
        return self.short(arb(0, 1))

    @property
    def thin(self) -> Along:
        """The polynomial of the balls' centres."""
        return Along(arb_poly([x.mid() for x in self.short.coeffs()]))

    def __add__(self, other: Any) -> Along:
        return Along(self.whole + (other.whole if isinstance(other, Along) else other))

    def __sub__(self, other: Any) -> Along:
        return Along(self.whole - (other.whole if isinstance(other, Along) else other))

    def __rsub__(self, other: Any) -> Along:
        return Along(other - self.whole)

    def __neg__(self) -> Along:
        return Along(-self.whole)

    def __mul__(self, other: Any) -> Along:
        return Along(self.short * (other.short if isinstance(other, Along) else other))

    def __truediv__(self, other: Any) -> Along:
        quotient: Along = self * (other.inverse if isinstance(other, Along) else 1 / arb(other))
        return quotient

    def __rtruediv__(self, other: Any) -> Along:
        quotient: Along = self.inverse * other
        return quotient

    def __pow__(self, power: Any) -> Along:
        return self.applied(lambda x: x**power)

    __radd__, __rmul__ = __add__, __mul__

    @property
    def inverse(self) -> Along:
        """1 / this."""
        if self._inverse is None:
            self._inverse = self.applied(lambda x: 1 / x)
        inverse: Along = self._inverse
        return inverse

    def sin_cos(self) -> tuple[Along, Along]:
        """Sine and cosine."""
        return self.sin(), self.cos()

    def sin(self) -> Along:
        """The sine."""
        return self.applied(lambda x: x.sin())

    def cos(self) -> Along:
        """The cosine."""
        return self.applied(lambda x: x.cos())

    def exp(self) -> Along:
        """The exponential function."""
        return self.applied(lambda x: x.exp())

    def log(self) -> Along:
        """The logarithm."""
        return self.applied(lambda x: x.log())

    def sqrt(self) -> Along:
        """The square root."""
        return self.applied(lambda x: x.sqrt())

    def applied(self, function: Callable[[Any], Any]) -> Along:
        """f(c + h) = sum_{k<=m} f_k(c) h^k + f_{m+1}(xi) h^{m+1}, f_k = f^(k) / k!, m = D + 1, xi in c + h."""
        centre, order = self.short[0].mid(), DEGREE + 2
        change = self - centre
        most = abs(change.range).upper()
        try:
            with truncated(order + 1):
                near, far = (function(arb_series([x, 1])).coeffs() for x in (centre, centre + arb(0, most)))
        except ValueError as error:  # Arb's of a quotient
            raise ZeroDivisionError(str(error)) from error
        near += [arb(0)] * (order - len(near))
        total = change * 0 + (far[order] if len(far) > order else arb(0)) * arb(0, (most**order).upper())
        power: Any = arb(1)
        for term in near[:order]:
            total, power = total + power * term, change * power
        return Along(total.whole)


def ranges(values: Sequence[Any]) -> Vector:
    """Balls that hold every value of each."""
    return [x.range if isinstance(x, Along) else arb(x) for x in values]


def ranged(matrix: np.ndarray) -> Any:
    """The matrix of balls of a matrix of functions."""
    rows, columns = matrix.shape
    return arb_mat(rows, columns, ranges(matrix.ravel().tolist()))


def along(values: Sequence[Any]) -> list[Along]:
    """Balls and functions, all as functions."""
    return [x if isinstance(x, Along) else Along(arb_poly([x])) for x in values]


def table(matrix: Any) -> np.ndarray:
    """A matrix of balls as one of objects."""
    objects = np.empty((matrix.nrows(), matrix.ncols()), dtype=object)
    objects.ravel()[:] = matrix.entries()
    return objects


def thinned(matrix: np.ndarray) -> np.ndarray:
    """The thin functions of a matrix of functions."""
    thin = np.empty(matrix.shape, dtype=object)
    thin.ravel()[:] = [x.thin for x in along(matrix.ravel().tolist())]
    return thin


# --------------------------------------------------------------------------------------------------
# The flow. As in `enclosure`, with a centre and derivatives that are functions of e; errors are boxes for every e.


@dataclass(frozen=True)
class Bundle(Cloud):
    """A Cloud for each e about a point z(e): `centre` and `middle` are thin functions of e."""

    @cached_property
    def derivatives(self) -> np.ndarray:
        """Enclosure (d x d+2) of d(q, v)/dz0 over the box."""
        return np.asarray(self.middle + table(self.turned * self.rest))

    @property
    def slopes(self) -> Any:
        """The same as a matrix of balls, for every e."""
        return ranged(self.derivatives)

    @property
    def hull(self) -> list[Any]:
        """Enclosure (d + 2) of all solutions, by the mean value theorem from z(e)."""
        return along(super().hull)

    def ranged(self, values: Vector) -> Vector:
        """Balls that hold every value of each."""
        return ranges(values)

    def whole(self, jet: Jet) -> Jet:
        """The jet with balls that hold its coefficients for every e."""
        other = copy(jet)
        other.z, other.tau, other.unfolding = ranges(jet.z), *ranges([jet.tau, jet.unfolding])
        other.states = [ranges(series) for series in jet.states]
        other.values = [ranges(series) for series in jet.values]
        return other

    def flow(
        self, field: Field, jet: Jet, step: Tube, states: Sequence[Vector], constants: Vector, order: int
    ) -> tuple[Any, Any] | None:
        """d(q, v)(h)/dz for each e (d x d+2), and W on the way for every e."""
        n, d, code, (unfolding, tau) = field.size, field.dimension, field.varied, constants
        known = jet.arguments(code, states, unfolding, [arb(0)] * order)
        values, zero = coefficients(code, order - 1, lambda k, _: [series[k] for series in known]), [arb(0)] * order
        first, slopes = outputs(code, values)
        rates, lines = rate_series(n, states, first, order), np.empty((order, n, d + 1), dtype=object)
        for i, j in np.ndindex(n, d + 1):
            lines[:, i, j] = slopes.get(i + n * j, zero)
        blocks = [table(block(identity(d + 2), d + 1, 0, d + 2))]
        last = np.full((1, d + 2), arb(0), dtype=object)
        for k in range(order):
            lower = sum(lines[j] @ blocks[k - j] for j in range(k + 1))
            rows = np.vstack([blocks[k][n:d], lower]) * (tau / (k + 1))
            rows[:, -1] += np.array([series[k] / (k + 1) for series in rates], dtype=object)
            blocks.append(np.vstack([rows, last]))
        flat, over = [arb_poly(ranges(series[:order])) for series in values], [ranged(matrix) for matrix in blocks]
        rest = transition_remainder(field, self.whole(jet), step, flat, over, *ranges([tau]))
        if rest is None:
            return None
        total = table(block(rest, d, 0, d + 2))
        for matrix in reversed(blocks):
            total = total * arb(step.h) + matrix[:d]
        return np.asarray(total), block(horner([*over[1:], rest], up_to(arb(step.h))), d, 0, d + 2)

    def parted(self, image: Vector) -> tuple[Vector, Any]:
        """A new centre near an image of the old one, and what the image is off it for every e."""
        centre = [x.thin for x in along(image)]
        return centre, column(ranges([x - c for x, c in zip(image, centre, strict=True)]))

    def matrix(self, flow: np.ndarray) -> Any:
        """d(q, v)/d(q, v) of a step for every e."""
        return ranged(flow[:, : self.frame.nrows()])

    def image(self, flow: np.ndarray) -> tuple[np.ndarray, Any]:
        """V after a step: its middle and the rest."""
        size = self.frame.nrows()
        image = flow[:, :size] @ self.middle
        image[:, size:] += flow[:, size:]
        middle = thinned(image)
        return middle, ranged(image - middle)


def bundle(centre: Sequence[Any], start: Vector) -> Bundle:
    """The Bundle of a box about z(e) (d + 2) at the start."""
    size = len(centre) - 2
    whole = along(centre)
    thin = [x.thin for x in whole]
    spread = column(ranges([x - y for x, y in zip(whole[:size], thin[:size], strict=True)]))
    middle = np.empty((size, size + 2), dtype=object)
    middle.ravel()[:] = along(exact(np.eye(size, size + 2)).entries())
    about, turned, rest = thin[:size] + whole[size:], identity(size), arb_mat(size, size + 2)
    return Bundle(about, identity(size), spread, middle, turned, rest, column(start), arb_mat(size, size + 2))
