"""The certificate's evidence for a long chain: Lagrange's equations in closed form, dense and in NumPy.

Hamilton's equations of any Model go through an inverse mass matrix in one CasADi graph, and their
momenta (1300 kg m^2/s at 100 links, which the velocities depend on through the inverse of a matrix of
condition 5e4) lose digits: the first mode of 100 links at 1 rad closes to 1.2e-10 in them and to 9e-13
here. The closed form keeps the velocities, follows from the energies alone, and shares neither code nor
formulation with the recursion that found the orbit. Only the monodromy is taken to canonical
coordinates, at its two ends.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import trapezoid

from orbitfinder.integrate.dop853 import SECOND, STEPS_PER_PERIOD, TIGHTEST, ReferenceSettings
from orbitfinder.mechanics.chain_lagrange import ChainLagrange, chain_lagrange
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.orbits.evidence import SAMPLES, Motion, evenly, integrate_in, units_of

LONGEST_PHASE = 0.15
"""Radians of the fastest linear mode in a step: at 20 links the rates close to 2e-13, with 800 steps a period to
8e-13."""
REFLECTED = 1e-9
"""x(T/2) is this near to -x(0), in extents of the motion, where half a period stands for the whole"""
PIECES_OF_HALF = 4
"""State-transition matrices in what is integrated: each start costs a few short steps with all columns"""


def chain_motion(
    model: Model,
    state: np.ndarray,
    period: float,
    turns: np.ndarray,
    moments: np.ndarray,
    settings: ReferenceSettings = TIGHTEST,
) -> Motion:
    """The `Motion` of a state (2n) of a long chain, its canonical coordinates those of the linear modes.

    The motion is integrated at `settings`, its variations (2n columns) at the second tolerance, which
    keeps eight digits of the multipliers and saves half the steps. Where the motion found here is at -x(0)
    after half a period, the equations take the second half from the first: Phi(T) = Phi(T/2)^2.
    """
    closed, n = chain_lagrange(model), turns.size
    masses = np.diag(closed.coupling)
    units = units_of(closed.field, state, masses, period) / np.concatenate([np.ones(n), masses])
    longest = min(period / STEPS_PER_PERIOD, LONGEST_PHASE / float(np.sqrt(max(closed.squared[-1], 1e-300))))
    states = integrate_in(units, closed.field, state, moments, settings, longest)
    even = states[np.searchsorted(moments, evenly(period))]
    reflected = np.abs((even[SAMPLES // 2] + state) / units).max() <= REFLECTED
    pieces = _transitions(closed, state, period / 2 if reflected else period, units)
    flow, turned = _canonical_directions(closed, model, state)
    directions = np.vstack([flow, *turned])
    return Motion(
        moments, states, closed.canonical(states), [*pieces, *pieces] if reflected else pieces,
        float(trapezoid(2.0 * energies(model, even)[0], evenly(period))), flow,
        np.hstack([-directions[:, n:], directions[:, :n]]), directions, np.ones(n),
        closed.modes.T @ closed.coupling @ turns, "Lagrange's equations in closed form",
    )  # fmt: skip


def _transitions(closed: ChainLagrange, state: np.ndarray, duration: float, units: np.ndarray) -> list[np.ndarray]:
    """Phi of equal pieces (2n x 2n) in the canonical coordinates of `momentum_frame`, from the linear modes' shapes.

    The frames at the two ends of a piece differ; at -x it is that at x, since every entry is even in (q, v) together.
    """
    modes, found, now = np.kron(np.eye(2), closed.modes), [], state
    measures = np.concatenate([units, np.ones(modes.size)])
    for k in range(PIECES_OF_HALF):
        extended = np.concatenate([now, modes.ravel("F")])
        span = duration * np.array([k, k + 1]) / PIECES_OF_HALF
        end = integrate_in(measures, closed.variational, extended, span, SECOND)[-1]
        columns = end[state.size :].reshape(modes.shape, order="F")
        before, now = now, end[: state.size]
        after = closed.momentum_frame(now) @ columns
        found.append(np.linalg.solve((closed.momentum_frame(before) @ modes).T, after.T).T)
    return found


def _canonical_directions(
    closed: ChainLagrange, model: Model, state: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """The flow and, without gravity, the rotation of the whole chain as canonical vectors (2n each)."""
    frame = closed.momentum_frame(state)
    n = state.size // 2
    turned = [frame @ np.concatenate([np.ones(n), np.zeros(n)]) for one in model.invariants if one.generator]
    return frame @ closed.field(0.0, state), turned
