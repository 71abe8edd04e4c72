"""The validated flow of a box and its derivatives, with wrapping kept small by rotating frames.

The set of solutions is held as   centre + frame r + V (z0 - centre0):   a point with the errors made
since the start in a frame that turns with the flow (QR, R. Lohner, "Enclosing the solutions of
ordinary initial and boundary value problems", Computerarithmetic, 1987), and the derivatives V of
the flow over the whole box, themselves held as   Vm + frame R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.proof.balls import Vector, arb, arb_mat, block, column, exact, floats, identity, midpoints, radii
from orbitfinder.proof.enclosure import Settings, Step, find_step, transition_over, valued
from orbitfinder.proof.field import Field


@dataclass(frozen=True)
class Cloud:
    """Every solution from a box at one time.

    `centre` (2n + 2, exact) with `spread` (2n) in `frame` (2n square) encloses the solution from the
    box's centre; `middle` + `turned` `rest` encloses the derivatives (2n x 2n+2) with respect to the
    initial z at every point of the box; `start` (2n + 2) is the box about its centre.
    """

    centre: Vector
    frame: Any
    spread: Any
    middle: Any
    turned: Any
    rest: Any
    start: Any

    @property
    def point(self) -> Vector:
        """Enclosure (2n + 2) of the solution from the centre of the initial box."""
        size = self.frame.nrows()
        moved = (self.frame * self.spread).entries()
        return [c + e for c, e in zip(self.centre[:size], moved, strict=True)] + self.centre[size:]

    @property
    def derivatives(self) -> Any:
        """Enclosure (2n x 2n+2) of d(q, v)/dz0 over the box."""
        return self.middle + self.turned * self.rest

    @property
    def hull(self) -> Vector:
        """Enclosure (2n + 2) of all solutions: the mean value theorem from the centre."""
        size = self.frame.nrows()
        moved = (self.derivatives * self.start).entries()
        constants = [c + d for c, d in zip(self.centre[size:], self.start.entries()[size:], strict=True)]
        return [x + d for x, d in zip(self.point[:size], moved, strict=True)] + constants


def cloud(box: Sequence[Any], point: Sequence[Any] | None = None) -> Cloud:
    """The Cloud of a box z (2n + 2 balls) at the start, about a point of it (balls; its centre if absent)."""
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
    )


def advance(field: Field, old: Cloud, begin: float, trial: float, settings: Settings) -> tuple[Cloud, Step, float]:
    """The Cloud after one validated step, the step, and the length to try next."""
    solutions = field.solution(old.hull, settings.order)
    step, following = find_step(field, solutions, begin, trial, settings)
    flow = transition_over(field, step, solutions, settings)
    return moved_derivatives(moved_point(field, old, step, flow, settings), flow), step, following


def moved_point(field: Field, old: Cloud, step: Step, flow: Any, settings: Settings) -> Cloud:
    """The centre and its spread after a step: series at the centre, the flow's derivative on the spread."""
    size = old.frame.nrows()
    image = valued(field.states(old.centre, settings.order), step.remainder, arb(step.h))
    centre = midpoints(image)
    error = column([x - c for x, c in zip(image, centre, strict=True)])
    stretched = block(flow, size, 0, size) * old.frame
    frame = orthogonal(stretched, radii(old.spread).ravel())
    back = frame.inv()
    return replace(
        old,
        centre=centre + old.centre[size:],
        frame=frame,
        spread=(back * stretched) * old.spread + back * error,
    )


def moved_derivatives(old: Cloud, flow: Any) -> Cloud:
    """V after a step: A V + A_c, with A = d(q, v)/d(q, v) and A_c = d(q, v)/d(s, tau) of the step."""
    size = old.frame.nrows()
    along = block(flow, size, 0, size)
    constant = exact(np.eye(2, size + 2, size))
    image = along * old.middle + block(flow, size, size, size + 2) * constant
    middle = image.mid()
    stretched = along * old.turned
    turned = orthogonal(stretched, radii(old.rest).max(axis=1))
    back = turned.inv()
    return replace(old, middle=middle, turned=turned, rest=(back * stretched) * old.rest + back * (image - middle))


def orthogonal(matrix: Any, weights: np.ndarray) -> Any:
    """A nearly orthogonal frame whose first axis follows the column with the largest weighted length."""
    columns = floats(matrix) * np.maximum(weights, weights.max(initial=0.0) * 1e-12 + 1e-300)
    scale = np.abs(columns).max(initial=0.0)
    if not np.isfinite(scale) or scale == 0.0:
        return identity(matrix.nrows())
    order = np.argsort(-np.linalg.norm(columns / scale, axis=0), kind="stable")
    return exact(np.linalg.qr(columns[:, order] / scale)[0])


def integrate(field: Field, start: Cloud, settings: Settings, trial: float = 1.0) -> tuple[Cloud, list[Step]]:
    """The Cloud one segment (unit time, tau seconds) later, and the steps on the way."""
    here, begin, steps = start, 0.0, []
    while begin < 1.0:
        limit.check()
        here, step, trial = advance(field, here, begin, trial, settings)
        steps.append(step)
        begin += step.h
    return here, steps
