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

from orbitfinder.mechanics.chain_lagrange import ChainLagrange, chain_lagrange
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.periodic.evidence import SAMPLES, Evidence, gap
from orbitfinder.periodic.floquet import analyse, reduce_monodromy
from orbitfinder.reference import SECOND, STEPS_PER_PERIOD, TIGHTEST, ReferenceSettings, integrate

LONGEST_PHASE = 0.15
"""Radians of the fastest linear mode in a step: at 20 links the rates close to 2e-13, with 800 steps a period to
8e-13."""
REFLECTED = 1e-9
"""rad and rad/s: x(T/2) is this near to -x(0) where half a period stands for the whole"""


def gather_chain(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, settings: ReferenceSettings = TIGHTEST
) -> Evidence:
    """`Evidence` of a state (2n) and a period of a long chain.

    The motion is integrated at `settings`, its variations (2n columns) at the second tolerance, which
    keeps eight digits of the multipliers and saves half the steps. Where the motion found here is at -x(0)
    after half a period, the equations take the second half from the first: Phi(T) = Phi(T/2)^2.
    """
    closed = chain_lagrange(model)
    times = np.linspace(0.0, period, SAMPLES + 1)
    longest = min(period / STEPS_PER_PERIOD, LONGEST_PHASE / float(np.sqrt(max(closed.squared[-1], 1e-300))))
    states = integrate(closed.field, state, times, settings, longest)
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    span = float(np.ptp(potential)) + float(kinetic.max())
    reflected = np.abs(states[SAMPLES // 2] + states[0]).max() <= REFLECTED
    monodromy = _transition(closed, state, period / 2 if reflected else period)
    monodromy = monodromy @ monodromy if reflected else monodromy
    flow, turned = _canonical_directions(closed, model, state)
    directions = np.vstack([flow, *turned])
    n = turns.size
    gradients = np.hstack([-directions[:, n:], directions[:, :n]])
    reduced = reduce_monodromy(monodromy, gradients, directions)
    scale = max(1.0, float(np.abs(monodromy).max()))
    unit = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return Evidence(
        times=times,
        states=states,
        closure=gap(states[0], states[-1], turns),
        action=float(trapezoid(2.0 * kinetic, times)),
        drift=float(np.abs(total - total[0]).max()) / max(span, 1e-3 * float(np.abs(potential).max()), 1e-300),
        energy=float(total[0]),
        trivial=max(_off(directions @ monodromy.T, directions), _off(gradients @ monodromy, gradients)) / scale,
        symplectic=float(np.abs(monodromy.T @ unit @ monodromy - unit).max()) / scale**2,
        floquet=analyse(reduced),
        formulation="Lagrange's equations in closed form",
    )


def _off(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.abs(found - wanted).max() / max(np.abs(wanted).max(), 1e-300))


def _transition(closed: ChainLagrange, state: np.ndarray, duration: float) -> np.ndarray:
    """Phi(duration) in the canonical coordinates of `momentum_frame` (2n x 2n), started from the linear modes' shapes.

    The frames at the two ends differ; at -x it is that at x, since every entry is even in (q, v) together.
    """
    modes = np.kron(np.eye(2), closed.modes)
    extended = np.concatenate([state, modes.ravel("F")])
    end = integrate(closed.variational, extended, np.array([0.0, duration]), SECOND)[-1]
    columns = end[state.size :].reshape(modes.shape, order="F")
    after, before = closed.momentum_frame(end[: state.size]), closed.momentum_frame(state)
    return np.asarray(np.linalg.solve((before @ modes).T, (after @ columns).T).T)


def _canonical_directions(
    closed: ChainLagrange, model: Model, state: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """The flow and, without gravity, the rotation of the whole chain as canonical vectors (2n each)."""
    frame = closed.momentum_frame(state)
    n = state.size // 2
    turned = [frame @ np.concatenate([np.ones(n), np.zeros(n)]) for one in model.invariants if one.generator]
    return frame @ closed.field(0.0, state), turned
