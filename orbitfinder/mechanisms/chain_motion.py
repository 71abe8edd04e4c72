"""The motion of a long chain for its certificate: Lagrange's equations in closed form.

Their momenta (1300 kg m^2/s at 100 links, which the velocities depend on through the inverse of a matrix of condition
5e4) lose digits: the first mode of 100 links at 1 rad closes to 1.2e-10 in Hamilton's equations and to 9e-13 here. Only
the monodromy is taken to canonical coordinates, at its two ends.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import trapezoid

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.integrate.dop853 import STEPS_PER_PERIOD, ReferenceSettings, Trace, integrate_in
from orbitfinder.integrate.field import CompiledField, VectorField
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.mechanisms.chain_lagrange import ChainLagrange, chain_lagrange, is_long
from orbitfinder.orbits.evidence import SAMPLES, Motion, canonical_frame, drifting, evenly, units_of

PIECES_OF_HALF = 4
"""State-transition matrices in half a period, where each start costs a few short steps with all columns; even"""
VARIED = ReferenceSettings(relative_tolerance=1e-11, absolute_tolerance=1e-12)
"""Of variations: nearly eight digits of the multipliers, of which six are asked"""
LONGEST_PHASE = 0.15
"""Radians of the fastest linear mode in a step: at 20 links the rates close to 2e-13, with 800 steps a period to
8e-13."""
REFLECTED = 1e-9
"""x(T/2) is this near to -x(0), in extents of the motion, where half a period stands for the whole"""


def motion_of(model: Model) -> Callable[..., Motion] | None:
    """`chain_motion` where a Model is a long chain."""
    return chain_motion if model.constraint is None and is_long(model) else None


def field_of(model: Model) -> VectorField | None:
    """x' = (v, a) of a Model that is a long chain."""
    return chain_lagrange(model).rates if motion_of(model) else None


def works_of(model: Model) -> tuple[CompiledField, ...]:
    """What a compiler may begin with of a long chain's certificate: its field, and that of its variations."""
    closed = chain_lagrange(model) if motion_of(model) else None
    return (closed.rates, closed.varied_rates) if closed else ()


def chain_motion(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, moments: np.ndarray, settings: ReferenceSettings
) -> Motion:
    """The `Motion` of a state (2n) of a long chain, its canonical coordinates those of the linear modes.

    The motion is integrated at `settings`, its variations (2n columns) at tolerances of their own. Where the motion
    is at -x(0) after half a period, the equations take the second half from the first: Phi(T) = Phi(T/2)^2.
    Where it also begins at rest, x(T/2 - t) = (-q, v)(t) is a motion run backwards, and they take the half from a
    quarter.
    """
    closed, n = chain_lagrange(model), turns.size
    masses = np.diag(closed.coupling)
    units = units_of(closed.rates, state, masses, period) / np.concatenate([np.ones(n), masses])
    longest = min(period / STEPS_PER_PERIOD, LONGEST_PHASE / float(np.sqrt(nonzero(closed.squared[-1]))))
    states = integrate_in(units, closed.rates, state, moments, settings, longest, traces := list[Trace]())
    even = states[np.searchsorted(moments, evenly(period))]
    reflected = np.abs((even[SAMPLES // 2] + state) / units).max() <= REFLECTED
    still = reflected and np.abs(state[n:] / units[n:]).max() <= REFLECTED
    count = PIECES_OF_HALF // 2 if still else PIECES_OF_HALF
    pieces = _chain_pieces(closed, state, period / (4 if still else 2 if reflected else 1), units, count)
    if still:
        back = np.repeat([-1.0, 1.0], n)
        pieces += [back[:, None] * np.linalg.inv(piece) * back for piece in reversed(pieces)]
    lift = closed.momentum_frame(state)
    flow = lift @ closed.field(0.0, state)
    return Motion(
        moments, states, closed.canonical(states), [*pieces, *pieces] if reflected else pieces,
        float(trapezoid(2.0 * energies(model, even)[0], evenly(period))), flow,
        *canonical_frame(model, state, flow, lift), np.ones(n), closed.modes.T @ closed.coupling @ turns,
        drifting(traces[0], turns, units), "Lagrange's equations in closed form",
    )  # fmt: skip


def _chain_pieces(
    closed: ChainLagrange, state: np.ndarray, duration: float, units: np.ndarray, count: int
) -> list[np.ndarray]:
    """Phi of equal pieces (2n x 2n) in the canonical coordinates of `momentum_frame`, from the linear modes' shapes.

    The frames at the two ends of a piece differ; at -x it is that at x, since every entry is even in (q, v) together.
    """
    modes, pieces, now = np.kron(np.eye(2), closed.modes), list[np.ndarray](), state
    measures = np.concatenate([units, np.ones(closed.width * state.size)])
    for span in duration * np.column_stack([np.arange(count), np.arange(1, count + 1)]) / count:

        def march(columns: np.ndarray, start: np.ndarray = now, span: np.ndarray = span) -> np.ndarray:
            extended = np.concatenate([start, columns])
            return np.asarray(integrate_in(measures, closed.varied_rates, extended, span, VARIED)[-1])

        after, columns = closed.varied(modes, march)
        pieces.append(closed.carried(now, after, columns))
        now = after
    return pieces
