"""One validated step: the Taylor polynomial of the flow and of its derivatives, with proven remainders.

Picard's operator on functions x(t) = sum_{k<=p} x_k t^k + t^{p+1} eta(t), |t| in [0, h]: the field along such
a function is a Taylor model whose coefficients below p are those of x' and whose remainder r gives
eta_new = tau r / (p + 1). When eta_new lies inside eta, the operator maps a closed convex set of
continuous functions into itself, so by Schauder's theorem it holds the solution (and all of it: the
field is Lipschitz there). High-order enclosures of this kind: N. S. Nedialkov, K. R. Jackson,
J. D. Pryce, Reliable Computing 7 (2001) 449-465; in Taylor models: Makino and Berz (see `taylormodel`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import mul
from typing import Any, Self, TypeVar

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.sizes import LEAST, nonzero
from orbitfinder.errors import IntegrationError
from orbitfinder.proof.balls import (
    Vector,
    arb,
    arb_mat,
    arb_poly,
    block,
    column,
    exact,
    floats,
    identity,
    inside,
    magnitude,
    midpoints,
    radii,
    radius,
    up_to,
)
from orbitfinder.proof.field import Field, Jet, rate_series, slope_series, transition_series
from orbitfinder.proof.series import listed, outputs, whole_series
from orbitfinder.proof.taylormodel import Beyond, tails

GRID = 2.0**-40
"""Steps are whole multiples of this part of a segment, so that their sums are exact"""
GUESSES = 5
"""Remainders that are tried before a step is made shorter"""


@dataclass(frozen=True)
class TaylorSettings:
    """How the validated integrator works.

    `order` of the Taylor polynomial, Arb's `bits`, `tolerance` on the remainder of one step (rad,
    rad/s) and the shortest step that is tried, as a part of the segment; derivatives go to a `share` of the order.
    """

    order: int = 22
    bits: int = 106
    tolerance: float = 1e-17
    shortest: float = 1e-8
    share: float = 0.85

    @property
    def varied(self) -> int:
        """The order of the derivatives' series."""
        return round(self.share * self.order)


@dataclass(frozen=True)
class Tube:
    """The tube of a validated step of length h (part of a segment) from `begin`.

    Every solution from the starting box is sum_k series_k t^k + remainder t^{p+1} for 0 <= t <= h
    (d components); `constants` are s and tau.
    """

    begin: float
    h: float
    series: list[Vector]
    remainder: Vector
    constants: Vector

    def at(self, time: Any) -> Vector:
        """(q, v) (d balls) at a time, or over a ball of times, after the beginning of the step."""
        return valued(self.series, self.remainder, time)

    @property
    def reach(self) -> Vector:
        """Extended states z (d + 2) over the whole step."""
        return self.at(up_to(arb(self.h))) + self.constants


def valued(series: list[Vector], remainder: Vector, time: Any) -> Vector:
    """Polynomials with remainder at a time or over a ball of times."""
    power = time ** len(series[0])
    return [horner(polynomial, time) + rest * power for polynomial, rest in zip(series, remainder, strict=True)]


def horner(series: Sequence[Any], time: Any) -> Any:
    """The value of a polynomial (of balls or of matrices)."""
    total = series[-1]
    for coefficient in reversed(series[:-1]):
        total = total * time + coefficient
    return total


def find_step(field: Field, jet: Jet, begin: float, trial: float, settings: TaylorSettings) -> tuple[Tube, float]:
    """A step of a jet of solutions whose remainder is within tolerance, and the length to try next."""
    largest = nonzero(magnitude([series[-1] for series in jet.states]))
    h = min(_rounded(min(trial, (settings.tolerance / largest) ** (1.0 / settings.order))), 1.0 - begin)
    while h >= settings.shortest or (h > 0 and begin + h == 1.0):
        rest = state_remainder(field, jet, arb(h), settings.order)
        if rest is None:
            h = _rounded(0.6 * h)
            continue
        error = radius(rest) * h ** (settings.order + 1)
        ratio = 0.9 * (settings.tolerance / nonzero(error)) ** (1.0 / (settings.order + 1))
        if error <= settings.tolerance:
            return Tube(begin, h, jet.states, rest, list(jet.z[-2:])), h * min(max(ratio, 1.0), 1.5)
        h = _rounded(h * min(max(ratio, 0.3), 0.9))
    raise IntegrationError(
        "no validated step is short enough; raise the order or the precision, or use more segments",
        time=begin * float(jet.tau.mid()),
    )


def _rounded(h: float) -> float:
    return float(int(min(h, 1.0) / GRID) * GRID)


def state_remainder(field: Field, jet: Jet, h: Any, order: int) -> Vector | None:
    """eta (d) of a step of length h, or None when Picard's operator maps no trial into itself."""
    n, span, factor = field.size, up_to(h), jet.tau / (order + 1)
    beyond = Beyond(jet.code, [arb_poly(series[:order]) for series in jet.values], order, span)
    trial = [arb(0)] * field.dimension
    for _ in range(GUESSES):
        own = [series[order] + span * eta for series, eta in zip(jet.states, trial, strict=True)]
        rest = beyond.remainders([x for (x,) in jet.arguments(jet.code, [[x] for x in own], arb(0), [])])
        accelerations = outputs(jet.code, rest)[0]
        image = [factor * x for x in own[n:]] + [factor * accelerations.get(i, arb(0)) for i in range(n)]
        if not all(x.is_finite() for x in image):
            return None
        if inside(trial, image):
            return image
        trial = _widened(image)
    return None


def transition_remainder(
    field: Field, jet: Jet, step: Tube, values: Sequence[Any], blocks: Sequence[Any], tau: Any,
    products: Mapping[int, Any] | None = None,
) -> Any | None:  # fmt: skip
    """The remainder H (d+1 x d+2) of the derivatives of (q, v, s) over a step, None where no trial holds its image.

    `values` are the polynomials (below p) of the Jacobian's program, `blocks` the derivatives' coefficients 0..p.
    """
    order, n, d, span, code = len(blocks) - 1, field.size, field.dimension, up_to(arb(step.h)), field.varied
    tail = [horner([*series[order:], rest], span) for series, rest in zip(jet.states, step.remainder, strict=True)]
    given = [x for (x,) in jet.arguments(code, [[x] for x in tail], arb(0), [])]
    rates, beyond = outputs(code, Beyond(code, values, order, span, products).remainders(given))
    slopes = slope_series(n, d, {k: listed(x, order - 1) for k, x in outputs(code, values)[1].items()}, order)
    slopes += slope_series(n, d, {k: [x] for k, x in beyond.items()}, 1)
    width, factor, forcing = d + 2, tau / (order + 1), [*tail[n:], *(rates.get(i, arb(0)) for i in range(n))]

    def image(trial: Any) -> Vector:
        """The rows of (q, v) of Picard's image."""
        own = blocks[order] + trial * span
        lower = sum(map(mul, slopes, tails(blocks[:order], own, span)), arb_mat(n, width))
        rows = [factor * x for x in own.entries()[n * width : d * width]] + [factor * x for x in lower.entries()]
        for i, x in enumerate(forcing):
            rows[i * width + width - 1] += x / (order + 1)
        return rows

    trial = arb_mat(d + 1, width)
    for _ in range(GUESSES + 3):
        rows = image(trial)
        if inside(trial.entries()[:-width], rows):
            return trial
        trial = arb_mat(d + 1, width, _widened(rows) + [arb(0)] * width)
    return None


def _widened(balls: Vector) -> Vector:
    """The next trial for a remainder after one whose image was not inside it."""
    return [arb(x.mid(), 1.5 * arb(x.rad()) + abs(x).upper() * 2.0**-10 + LEAST) for x in balls]


# --------------------------------------------------------------------------------------------------
# The validated flow of a box and its derivatives, with wrapping kept small by rotating frames.
# The set of solutions is held as   centre + frame r + V (z0 - centre0):   a point with the errors made
# since the start in a frame that turns with the flow (QR, R. Lohner, "Enclosing the solutions of
# ordinary initial and boundary value problems", Computerarithmetic, 1987), and the derivatives V of
# the flow over the whole box, themselves held as   Vm + frame R.


@dataclass(frozen=True)
class Cloud:
    """Every solution from a box at one time.

    `centre` (d + 2, exact) with `spread` (d) in `frame` (d square) encloses the solution from the
    box's centre; `middle` + `turned` `rest` encloses the derivatives (d x d+2) with respect to the
    initial z at every point of the box; `start` (d + 2) is the box about its centre, `pull` (d x d+2) the
    mean rates of the derivatives over the last step, by which those over the next one are guessed.
    """

    centre: Vector
    frame: Any
    spread: Any
    middle: Any
    turned: Any
    rest: Any
    start: Any
    pull: Any

    @property
    def point(self) -> Vector:
        """Enclosure (d) of the solution from the centre of the initial box."""
        return [c + e for c, e in zip(self.centre, (self.frame * self.spread).entries(), strict=False)]

    @property
    def derivatives(self) -> Any:
        """Enclosure (d x d+2) of d(q, v)/dz0 over the box."""
        return self.middle + self.turned * self.rest

    @property
    def slopes(self) -> Any:
        """The same as a matrix of balls."""
        return self.derivatives

    @property
    def hull(self) -> Vector:
        """Enclosure (d + 2) of all solutions: the mean value theorem from the centre."""
        size, moved = self.frame.nrows(), (self.slopes * self.start).entries()
        constants = [c + d for c, d in zip(self.centre[size:], self.start.entries()[size:], strict=True)]
        return [x + d for x, d in zip(self.point, moved, strict=True)] + constants

    def advanced(self, field: Field, begin: float, trial: float, settings: TaylorSettings) -> tuple[Self, Tube, float]:
        """The same after one validated step, the step, and the length to try next."""
        jet, size = field.solution(self.centre, settings.order), self.frame.nrows()
        while True:
            step, following = find_step(field, self.whole(jet), begin, trial, settings)
            if (swept := self.swept(field, jet, step, settings)) is not None:
                break
            trial = 0.5 * step.h
            if trial < settings.shortest:
                time = begin * float(self.whole(jet).tau.mid())
                raise IntegrationError("the derivatives over a step could not be enclosed; raise the order", time=time)
        step, flow, pull = swept
        centre, error = self.parted(valued(jet.states, step.remainder, arb(step.h)))
        (middle, off), matrix = self.image(flow), self.matrix(flow)
        stretched, carried = matrix * self.frame, matrix * self.turned
        frame, turned = (
            orthogonal(stretched, radii(self.spread).ravel()),
            orthogonal(carried, radii(self.rest).max(axis=1)),
        )
        back, home = frame.inv(), turned.inv()
        after = replace(
            self, centre=centre + self.centre[size:], frame=frame,
            spread=(back * stretched) * self.spread + back * error, middle=middle, turned=turned,
            rest=(home * carried) * self.rest + home * off, pull=pull,
        )  # fmt: skip
        return after, step, following

    def swept(self, field: Field, jet: Jet, step: Tube, settings: TaylorSettings) -> tuple[Tube, Any, Any] | None:
        """The step of all solutions from that of the centre's; V(h) = dz(h)/dz over the box, and W on the way to it.
        None where the step is too long for that.

        With V(t) = 1 + t W(t) the derivatives of solutions between the two, another leaves the centre's by
        V(t) (z - centre). Where all that go no faster than `near` have W (z - centre) inside it, none goes faster.
        """
        d = field.dimension
        about = (self.frame * self.spread + self.slopes * self.start).entries() + self.start.entries()[d:]
        box = column([x.union(0) for x in about])
        near = _widened((self.pull * box).entries())
        first, constants = box.entries()[:d], [c + x for c, x in zip(jet.z[d:], box.entries()[d:], strict=True)]
        for _ in range(GUESSES):
            over = [[a + x, b + y, *c] for (a, b, *c), x, y in zip(jet.states, first, near, strict=True)]
            try:
                flow = self.flow(field, jet, step, over, constants, settings.varied)
            except (ValueError, ZeroDivisionError):  # Arb's of a quotient
                return None
            if flow is None:
                return None
            moved = (flow[1] * box).entries()
            if inside(near, moved):
                return replace(step, series=[self.ranged(x) for x in over], constants=self.ranged(constants)), *flow
            near = _widened(moved)
        return None

    def ranged(self, values: Vector) -> Vector:
        """Balls that hold every value of each."""
        return values

    def whole(self, jet: Jet) -> Jet:
        """The jet, its coefficients in balls."""
        return jet

    def flow(
        self, field: Field, jet: Jet, step: Tube, states: Sequence[Vector], constants: Vector, order: int
    ) -> tuple[Any, Any] | None:
        """V(h) = dz(h)/dz (d+1 x d+2, with the row of s) along all solutions in `states` with such s and tau, and W
        (d x d+2) for 0 <= t <= h, by the same argument for the variational equations to an `order` of their own."""
        n, d, code, (unfolding, tau) = field.size, field.dimension, field.varied, constants
        values, products = whole_series(code, order - 1, jet.arguments(code, states, unfolding, []))
        rates, slopes = (
            {k: listed(x, order - 1) for k, x in result.items()} for result in outputs(code, values)
        )  # fmt: skip
        blocks = transition_series(n, tau, rate_series(n, states, rates, order), slope_series(n, d, slopes, order))
        rest = transition_remainder(field, jet, step, values, blocks, tau, products)
        if rest is None:
            return None
        series = [*blocks, rest]
        return horner(series, arb(step.h)), block(horner(series[1:], up_to(arb(step.h))), d, 0, d + 2)

    def parted(self, image: Vector) -> tuple[Vector, Any]:
        """A new centre near an image of the old one, and what the image is off it."""
        centre = midpoints(image)
        return centre, column([x - c for x, c in zip(image, centre, strict=True)])

    def matrix(self, flow: Any) -> Any:
        """d(q, v)/d(q, v) of a step."""
        return block(flow, self.frame.nrows(), 0, self.frame.nrows())

    def image(self, flow: Any) -> tuple[Any, Any]:
        """V after a step, A V + A_c with A = d(q, v)/d(q, v) and A_c = d(q, v)/d(s, tau): its middle and the rest."""
        size = self.frame.nrows()
        image = self.matrix(flow) * self.middle + block(flow, size, size, size + 2) * exact(np.eye(2, size + 2, size))
        return image.mid(), image - image.mid()


def cloud(box: Sequence[Any], point: Sequence[Any] | None = None) -> Cloud:
    """The Cloud of a box z (d + 2 balls) at the start, about a point of it (balls; its centre if absent)."""
    size = len(box) - 2
    about = list(point) if point is not None else midpoints(box)
    centre = midpoints(about)
    return Cloud(
        centre=centre,
        frame=identity(size),
        spread=column([x - c for x, c in zip(about[:size], centre[:size], strict=True)]),
        middle=exact(np.eye(size, size + 2)),
        turned=identity(size),
        rest=arb_mat(size, size + 2),
        start=column([x - c for x, c in zip(box, about, strict=True)]),
        pull=arb_mat(size, size + 2),
    )


def orthogonal(matrix: Any, weights: np.ndarray) -> Any:
    """A nearly orthogonal frame whose first axis follows the column with the largest weighted length."""
    columns = floats(matrix) * np.maximum(weights, weights.max(initial=0.0) * 1e-12 + LEAST)
    scale = np.abs(columns).max(initial=0.0)
    if not np.isfinite(scale) or scale == 0.0:
        return identity(matrix.nrows())
    order = np.argsort(-np.linalg.norm(columns / scale, axis=0), kind="stable")
    return exact(np.linalg.qr(columns[:, order] / scale)[0])


Moving = TypeVar("Moving", bound=Cloud)


def integrate(field: Field, start: Moving, settings: TaylorSettings, trial: float = 1.0) -> tuple[Moving, list[Tube]]:
    """The Cloud one segment (unit time, tau seconds) later, and the steps on the way."""
    here, begin, steps = start, 0.0, []
    while begin < 1.0:
        limit.check()
        here, step, trial = here.advanced(field, begin, trial, settings)
        steps.append(step)
        begin += step.h
    return here, steps
