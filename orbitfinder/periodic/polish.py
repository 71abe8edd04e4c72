"""The last digits: Newton steps on fixed-step eighth-order marches of all segments at once.

CVODES asked for 1e-13 closes an orbit only to about 1e-11. The Jacobian comes from a coarse march, which is
more than good enough for a Newton step on a residual that is right to round-off.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.flow import Flow
from orbitfinder.periodic.marches import Marches, Path
from orbitfinder.periodic.marches import tail_of as tail_of
from orbitfinder.periodic.shooting import Shooting
from orbitfinder.runge_kutta import AGREEMENT, EVALUATIONS, MOST_DOUBLINGS, refined_march

MOST_STEPS = 6
STEPS_PER_PERIOD = 400
"""Runge-Kutta steps in a period at least, doubled in segments that need more"""


def least_steps(segments: int) -> int:
    """Half the fewest steps of a segment when a period has this many (the refined march doubles it)."""
    return max(8, -(-STEPS_PER_PERIOD // (2 * segments)))


def segment(
    flow: Flow, state: np.ndarray, span: tuple[float, float], tail: np.ndarray, least: int = STEPS_PER_PERIOD // 16
) -> np.ndarray:
    """States (k + 1 x 2n) at equal times from span[0] to span[1], as many steps as that needs."""
    return refined_march(flow.field, state, span[1] - span[0], least, tail, span[0])


def residual(shooting: Shooting, w: np.ndarray) -> np.ndarray:
    """All rows of g(w) with the segments integrated to round-off."""
    layout, problem = shooting.layout, shooting.problem
    period, unfolding, free = layout.tail(w)
    duration = period * problem.boundary.fraction / layout.segments
    tail = tail_of(shooting.flow, unfolding, free)
    least = least_steps(round(layout.segments / problem.boundary.fraction))
    spans = [(k * duration, (k + 1) * duration) for k in range(layout.segments)]
    ends = [
        segment(shooting.flow, node, span, tail, least)[-1]
        for node, span in zip(layout.nodes(w), spans, strict=True)
    ]
    return np.asarray(shooting.rows(w, np.asarray(ends).T).full().ravel())


class _Marched:
    """Residual and Jacobian of a Shooting by marches whose steps are halved until the ends agree, once."""

    def __init__(self, shooting: Shooting, start: np.ndarray) -> None:
        layout, fraction = shooting.layout, shooting.problem.boundary.fraction
        steps = least_steps(round(layout.segments / fraction))
        self.shooting, self.blocks = shooting, 1
        self.marches = Marches(shooting.problem, shooting.flow, layout.segments, steps, EVALUATIONS)
        path = self._path(start)
        coarse = self.marches.ends(path, 1)
        for _ in range(MOST_DOUBLINGS):
            self.blocks *= 2
            fine = self.marches.ends(path, self.blocks)
            if np.abs(fine - coarse).max() <= AGREEMENT * max(1.0, float(np.abs(fine).max())):
                break
            coarse = fine

    def _path(self, w: np.ndarray) -> Path:
        layout = self.shooting.layout
        return Path(layout.nodes(w), np.asarray(w[layout.size * layout.segments :]))

    def residual(self, w: np.ndarray) -> np.ndarray:
        """g(w)."""
        ends = self.marches.ends(self._path(w), self.blocks)
        return np.asarray(self.shooting.rows(w, ends.T).full().ravel())

    def jacobian(self, w: np.ndarray) -> np.ndarray:
        """dg/dw, by one coarse march of the variational equations."""
        ends, system = self.marches.linearised(self._path(w))
        count, size = ends.shape
        moved = np.zeros((count * size, w.size))
        for k in range(count):
            here = slice(k * size, (k + 1) * size)
            moved[here, here], moved[here, count * size :] = system.transitions[k], system.columns[k]
        direct, through = (one.full() for one in _row_slopes(self.shooting)(w, ends.T))
        return np.asarray(direct + through @ moved)


def _row_slopes(shooting: Shooting) -> ca.Function:
    """Derivatives of rows(w, ends) by w and by the ends, segment after segment."""
    w, ends = ca.MX.sym("w", shooting.layout.total), ca.MX.sym("ends", shooting.layout.size, shooting.layout.segments)
    rows = shooting.rows(w, ends)
    return ca.Function("row_slopes", [w, ends], [ca.jacobian(rows, w), ca.jacobian(rows, ends)])


def polish(shooting: Shooting, start: np.ndarray) -> np.ndarray:
    """w after Newton steps with the accurate residual, until it stops shrinking.

    The system is square except for brake orbits of conservative systems at rest, so the step is the
    least-squares one. Raises `ConvergenceError` when the residual grows instead.
    """
    marched = _Marched(shooting, start)
    w, best = start, marched.residual(start)
    jacobian = marched.jacobian(w)
    for _ in range(MOST_STEPS):
        # not pinv: OpenBLAS gives it threads, which on a busy machine cost 100 ms where lstsq takes 0.2
        trial = w + np.linalg.lstsq(jacobian, -best, rcond=None)[0]
        rows = marched.residual(trial)
        if not np.abs(rows).max() < np.abs(best).max():
            break
        w, best = trial, rows
        if np.abs(best).max() < 1e-15:
            break
    if not np.abs(best).max() < 1e-8:
        raise ConvergenceError(
            f"the polish stalled at a residual of {np.abs(best).max():.2g}; the orbit is too unstable for "
            "this many segments, use more"
        )
    return w
