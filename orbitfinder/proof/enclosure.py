"""One validated step: a box that holds the solution over the whole step, and the Taylor remainder there.

High-order enclosure: if, for the coefficients x_k(X) over the starting box X,

    X + sum_{k=1..p} x_k(X) [0, h]^k + x_{p+1}(E) [0, h]^{p+1}  lies inside  E,

every solution from X exists on [0, h], stays in E, and differs from its Taylor polynomial by an
element of x_{p+1}(E) t^{p+1}. Source: N. S. Nedialkov, K. R. Jackson, J. D. Pryce, "An effective
high-order interval method for validating existence and uniqueness of the solution of an IVP for an
ODE", Reliable Computing 7 (2001) 449-465.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from orbitfinder.errors import IntegrationError
from orbitfinder.proof.balls import Vector, arb, arb_mat, identity, inside, magnitude, up_to, widened
from orbitfinder.proof.field import Field

GRID = 2.0**-40
"""Steps are whole multiples of this part of a segment, so that their sums are exact"""
INFLATION = 2.0**-16
"""by which a trial box is larger than the polynomial's range, relative to its radius"""


@dataclass(frozen=True)
class Settings:
    """How the validated integrator works.

    `order` of the Taylor polynomial, Arb's `bits`, `tolerance` on the remainder of one step (rad,
    rad/s) and the shortest step that is tried, as a part of the segment.
    """

    order: int = 20
    bits: int = 106
    tolerance: float = 1e-18
    shortest: float = 1e-8


@dataclass(frozen=True)
class Step:
    """A validated step of length h (part of a segment) from `begin`.

    `series` (2n lists of p + 1 balls) holds the polynomials of all solutions from the starting box,
    `remainder` (2n) x_{p+1}(E), `rough` (2n + 2) the box E of all states on the way.
    """

    begin: float
    h: float
    series: list[Vector]
    remainder: Vector
    rough: Vector

    def at(self, time: Any) -> Vector:
        """(q, v) (2n balls) at a time, or over a ball of times, after the beginning of the step."""
        power = time ** len(self.series[0])
        return [horner(one, time) + rest * power for one, rest in zip(self.series, self.remainder, strict=True)]


def horner(series: Sequence[Any], time: Any) -> Any:
    """The value of a polynomial."""
    total = series[-1]
    for coefficient in reversed(series[:-1]):
        total = total * time + coefficient
    return total


def find_step(
    field: Field, hull: Vector, series: list[Vector], begin: float, trial: float, settings: Settings
) -> tuple[Step, float]:
    """A step from `hull` whose remainder is within tolerance, and the length to try next."""
    largest = max(magnitude([one[-1] for one in series]), 1e-300)
    h = min(_rounded(min(trial, (settings.tolerance / largest) ** (1.0 / settings.order))), 1.0 - begin)
    while h >= settings.shortest or (h > 0 and begin + h == 1.0):
        found = rough_enclosure(field, hull, series, h, settings)
        if found is None:
            h = _rounded(0.6 * h)
            continue
        rough, remainder = found
        error = magnitude(remainder) * h ** (settings.order + 1)
        ratio = 0.9 * (settings.tolerance / max(error, 1e-300)) ** (1.0 / (settings.order + 1))
        if error <= settings.tolerance:
            return Step(begin, h, series, remainder, rough), h * min(max(ratio, 1.0), 1.5)
        h = _rounded(h * min(max(ratio, 0.3), 0.9))
    raise IntegrationError(
        "no validated step is short enough; raise the order or the precision, or prove a smaller box", time=begin
    )


def _rounded(h: float) -> float:
    return float(int(min(h, 1.0) / GRID) * GRID)


def rough_enclosure(
    field: Field, hull: Vector, series: list[Vector], h: float, settings: Settings
) -> tuple[Vector, Vector] | None:
    """The box E and x_{p+1}(E), or None when this step is too long to be validated."""
    span = up_to(arb(h))
    reach = [horner(one, span) for one in series]
    box = [widened(x, arb(x.rad()) * INFLATION + settings.tolerance) for x in reach]
    rough = box + hull[len(box) :]
    remainder = [one[-1] for one in field.states(rough, settings.order + 1)]
    power = span ** (settings.order + 1)
    inner = [x + r * power for x, r in zip(reach, remainder, strict=True)]
    return (rough, remainder) if inside(box, inner) else None


def transition_over(
    field: Field, step: Step, series: Sequence[Any], settings: Settings
) -> tuple[Any, Any]:
    """dz(h)/dz over the starting box: of the Taylor polynomial, and of the flow itself.

    The flow's is the polynomial's plus V_{p+1}(E) W h^{p+1}, where W holds dz(t)/dz on [0, h]: it
    does when  sum_k V_k(X) [0, h]^k + V_{p+1}(E) [0, h]^{p+1} W  lies inside W.
    """
    order, h = settings.order, arb(step.h)
    last = field.variations(step.rough, order + 1)[1][order + 1]
    span = up_to(h)
    reach, slope = _polynomial(series, span), last * span ** (order + 1)
    first = slope * reach
    spread = [2 * abs(x).upper() + arb(y.rad()) * INFLATION + settings.tolerance
              for x, y in zip(first.entries(), reach.entries(), strict=True)]  # fmt: skip
    size = identity(reach.nrows())
    over = arb_mat(size.nrows(), size.ncols(), [widened(x, r) for x, r in zip(reach.entries(), spread, strict=True)])
    if not inside(over.entries(), (reach + slope * over).entries()):
        raise IntegrationError("the derivatives over a step could not be enclosed; raise the order", time=step.begin)
    exact = _polynomial(series, h)
    return exact, exact + last * over * h ** (order + 1)


def _polynomial(series: Sequence[Any], time: Any) -> Any:
    total = series[-1]
    for coefficient in reversed(series[:-1]):
        total = total * time + coefficient
    return total
