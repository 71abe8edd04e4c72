"""The last digits: Newton steps with an eighth-order residual and the Jacobian of CVODES.

CVODES asked for 1e-13 closes an orbit only to about 1e-11; its state-transition matrix is more
than good enough for a Newton step on a residual that is right to round-off.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import casadi as ca
import numpy as np

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.cvodes import Flow, sundials
from orbitfinder.integrate.rk8 import MOST_DOUBLINGS, agree, march, refined_march
from orbitfinder.loops.loop import Unknowns, beyond
from orbitfinder.loops.shooting import Shooting
from orbitfinder.mechanics.newton import Settings, Solver, chord

POLISH = Settings(floor=1e-15, round_off=4e-9, converged=1e-8, most_evaluations=30)
"""Of the rows as they are: no step makes 1e-15 smaller, a polish that stalls above 1e-8 has failed"""
STEPS_PER_PERIOD = 400
"""Runge-Kutta steps in a period at least, doubled in segments that need more"""
PIECE = 8
"""Runge-Kutta steps in a piece of a graded march, checked by twice as many"""
MOST_PIECES = 2000


def tail_of(flow: Flow, unfolding: np.ndarray | None = None, free: np.ndarray | None = None) -> np.ndarray:
    """The last arguments of the flow's field: unfolding (0) and freed parameters (the model's own)."""
    known = flow.model.values_of(flow.free)
    return np.concatenate([np.zeros(len(flow.unfolded)) if unfolding is None else unfolding,
                           known if free is None else free])  # fmt: skip


def least_steps(segments: int) -> int:
    """Half the fewest steps of a segment when a period has this many (the refined march doubles it)."""
    return max(8, -(-STEPS_PER_PERIOD // (2 * segments)))


def segment(
    flow: Flow, state: np.ndarray, span: tuple[float, float], tail: np.ndarray, least: int = STEPS_PER_PERIOD // 16
) -> np.ndarray:
    """States (k + 1 x 2n) at equal times from span[0] to span[1], as many steps as that needs."""
    return refined_march(flow.field, state, span[1] - span[0], least, tail, span[0], flow.units)


def end_of(flow: Flow, state: np.ndarray, span: tuple[float, float], tail: np.ndarray, least: int) -> np.ndarray:
    """The state at span[1]: at the end of equal steps, or of graded ones where no number of equal steps will do.

    Past a body at a hundredth of the distances, 3200 equal steps in a segment are right to 1e-8 only.
    """
    path, enough = path_of(flow, state, span, tail, least)
    graded = None if enough else graded_end(flow.field, state, span, tail, flow.units)
    return path[-1] if graded is None else graded


def path_of(
    flow: Flow, state: np.ndarray, span: tuple[float, float], tail: np.ndarray, least: int
) -> tuple[np.ndarray, bool]:
    """States at equal times over a span, and whether that many equal steps are enough for them."""
    path = segment(flow, state, span, tail, least)
    return path, len(path) - 1 < least << MOST_DOUBLINGS


def graded_path(flow: Flow, state: np.ndarray, times: np.ndarray, tail: np.ndarray) -> np.ndarray | None:
    """States at times, the first one given, by graded marches from each to the next; None where one takes too many."""
    states = [np.asarray(state, float)]
    for span in pairwise(times):
        end = graded_end(flow.field, states[-1], (float(span[0]), float(span[1])), tail, flow.units)
        if end is None:
            return None
        states.append(end)
    return np.stack(states)


def graded_end(
    field: ca.Function, state: np.ndarray, span: tuple[float, float], tail: np.ndarray, units: tuple[float, ...] = ()
) -> np.ndarray | None:
    """The state at span[1] by pieces as long as 8 and 16 steps agree on; None when it takes too many of them."""
    now, length = span[0], span[1] - span[0]
    for _ in range(MOST_PIECES):
        last = length >= span[1] - now
        length = min(length, span[1] - now)
        try:
            coarse, fine = (march(field, state, length, count, tail, now)[-1] for count in (PIECE, 2 * PIECE))
            agreed = agree(coarse, fine, units)
        except IntegrationError:  # they leave the numbers
            agreed = False
        if not agreed:
            length /= 2
        elif last:
            return np.asarray(fine)
        else:
            state, now, length = fine, now + length, 2 * length
    return None


def residual(shooting: Shooting, w: Unknowns) -> np.ndarray:
    """All rows of g with the segments integrated to round-off, without what may be round-off of their own terms."""
    tail = tail_of(shooting.flow, w.unfolding, w.free)
    least = least_steps(round(len(w.nodes) / shooting.problem.boundary.fraction))
    spans = pairwise(w.period * w.edges)
    ends = [end_of(shooting.flow, node, span, tail, least) for node, span in zip(w.nodes, spans, strict=True)]
    rows = shooting.rows(shooting.vector(w), np.asarray(ends).T).full().ravel()
    return beyond(np.asarray(rows), shooting.lost)


def solver_at(shooting: Shooting, w: Unknowns) -> Solver:
    """The step by the variational equations, which CVODES integrates; its failure becomes an `IntegrationError`.

    The system is square except for brake orbits of conservative systems at rest, so it is the least-squares one.
    """
    with sundials(w.nodes[0], 0.0, w.period / len(w.nodes)):
        jacobian = shooting.jacobian(shooting.vector(w)).full()
    return lambda rows: -shooting.units * np.linalg.lstsq(jacobian, rows, rcond=None)[0]


def polish(shooting: Shooting, start: np.ndarray) -> np.ndarray:
    """w after Newton steps with the accurate residual, until it stops shrinking.

    Raises `ConvergenceError` when the residual grows instead.
    """
    functions = partial(residual, shooting), partial(solver_at, shooting)
    w = shooting.at(start)
    polished = chord(w, functions[0](w), functions[1](w), functions, POLISH, Unknowns.moved, fresh=True)
    if not polished.converged:
        raise ConvergenceError(
            f"the polish stalled at a residual of {polished.size:.2g}; the orbit is too unstable for "
            "this many segments, use more"
        )
    return shooting.vector(polished.w)
