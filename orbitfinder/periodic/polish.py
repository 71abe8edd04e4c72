"""The last digits: Newton steps whose residual comes from DOP853, whose Jacobian from CVODES.

CVODES asked for 1e-13 closes an orbit only to about 1e-11; its state-transition matrix is more
than good enough for a Newton step on a residual that is right to round-off.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.flow import Flow
from orbitfinder.periodic.shooting import Shooting
from orbitfinder.quiet import captured
from orbitfinder.reference import STEPS_PER_PERIOD, integrate, vector_field

MOST_STEPS = 6


def path(
    flow: Flow, state: np.ndarray, times: np.ndarray, period: float, tail: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """States (k x 2n) at increasing times by DOP853 on the flow's own field.

    `period` sets the longest step, `tail` the unfolding and freed parameters (0 and the model's own).
    """
    t, x = ca.MX.sym("t"), ca.MX.sym("x", state.size)
    known = flow.model.parameters()[[flow.model.parameter_index(name) for name in flow.free]]
    s, free = (ca.DM.zeros(len(flow.unfolded)), known) if tail is None else (ca.DM(tail[0]), ca.DM(tail[1]))
    field = ca.Function("polish_field", [t, x], [flow.field(t, x, s, free)])
    return integrate(vector_field(field), state, times, longest_step=period / STEPS_PER_PERIOD)


def residual(shooting: Shooting, w: np.ndarray) -> np.ndarray:
    """All rows of g(w) with the segments integrated by DOP853."""
    layout, problem = shooting.layout, shooting.problem
    period, unfolding, free = layout.tail(w)
    duration = period * problem.boundary.fraction / layout.segments
    ends = [
        path(shooting.flow, node, np.array([k, k + 1]) * duration, period, (unfolding, free))[-1]
        for k, node in enumerate(layout.nodes(w))
    ]
    return np.asarray(shooting.rows(w, np.asarray(ends).T).full().ravel())


def polish(shooting: Shooting, start: np.ndarray) -> np.ndarray:
    """w after Newton steps with the accurate residual, until it stops shrinking.

    The system is square except for brake orbits of conservative systems at rest, so the step is the
    least-squares one. Raises `ConvergenceError` when the residual grows instead.
    """
    w, best = start, residual(shooting, start)
    with captured():
        jacobian = shooting.jacobian(w).full()
    for _ in range(MOST_STEPS):
        step = np.linalg.lstsq(jacobian, -best, rcond=None)[0]
        trial = w + step
        rows = residual(shooting, trial)
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
