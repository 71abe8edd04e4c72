"""The certificate's formulations: a motion and its variations by equations that did not find it.

The finder integrates accelerations with CVODES (under constraints: a model's own balances with Baumgarte terms);
here it is DOP853 at its tightest, without unfolding or stabilisation, on equations that follow from the energies:

- Hamilton's equations, derived by automatic differentiation;
- the same under constraints, in the link angles where there are any (`mechanics.holonomic`);
- for long chains Lagrange's equations in closed form, dense and in NumPy. Their momenta (1300 kg m^2/s at 100 links,
  which the velocities depend on through the inverse of a matrix of condition 5e4) lose digits: the first mode of 100
  links at 1 rad closes to 1.2e-10 in Hamilton's equations and to 9e-13 here. Only the monodromy is taken to canonical
  coordinates, at its two ends.

Lengths, momenta and the time are measured in extents of the motion, so that the answer does not depend on the units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import trapezoid

from orbitfinder.errors import InputError
from orbitfinder.integrate.dop853 import (
    SECOND,
    STEPS_PER_PERIOD,
    ReferenceSettings,
    VectorField,
    integrate_in,
    vector_field,
)
from orbitfinder.integrate.equations import constrained_hamilton, hamilton
from orbitfinder.mechanics.chain_lagrange import ChainLagrange, chain_lagrange
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.orbits.closure import extents, masses_of
from orbitfinder.orbits.floquet import generated

SAMPLES = 512
"""Intervals at which the certifying integration is inspected."""
PIECES, PIECES_OF_HALF = 16, 4
"""State-transition matrices in a period, where an error may be made that is carried to the end; in half a long
chain's, where each start costs a few short steps with all columns"""
VARIED = ReferenceSettings(relative_tolerance=1e-13, absolute_tolerance=1e-14)
"""For the state-transition matrices: of orbits with multipliers of 5e5, 1e-12 leaves the trivial ones wrong by 2e-8"""
ROUGH = ReferenceSettings(relative_tolerance=1e-10, absolute_tolerance=1e-13)
"""For the extents of the motion, before there are any."""
LONGEST_PHASE = 0.15
"""Radians of the fastest linear mode in a step: at 20 links the rates close to 2e-13, with 800 steps a period to
8e-13."""
REFLECTED = 1e-9
"""x(T/2) is this near to -x(0), in extents of the motion, where half a period stands for the whole"""


@dataclass(frozen=True)
class Motion:
    """What a formulation finds: a motion in coordinates y = (q, p) (m numbers) and its state-transition matrices.

    `states` (k x 2n) are those of the model at `times`, `path` (k x m) the same in y, `masses` (m / 2) the
    diagonal of its mass matrix, `constraints` (r x m) the gradients of what y is held to, `rate` y' at the start.
    """

    times: np.ndarray
    states: np.ndarray
    path: np.ndarray
    transitions: Sequence[np.ndarray]
    action: float
    rate: np.ndarray
    gradients: np.ndarray
    directions: np.ndarray
    masses: np.ndarray
    turns: np.ndarray
    formulation: str = "Hamilton's equations"
    constraints: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


class Hamiltonian:
    """Hamilton's equations of a Model in y = (q, p) (m numbers), q its own coordinates."""

    def __init__(self, model: Model) -> None:
        self.model, self.equations = model, hamilton(model)
        self.field = vector_field(self.equations.field)

    def variations(self) -> VectorField:
        """z' for z = (y, vec Y, action)."""
        return vector_field(self.equations.variational)

    def start(self, state: np.ndarray) -> np.ndarray:
        """(q, momentum)."""
        q, v = np.split(state, 2)
        return np.concatenate([q, self.equations.momentum(q, v).full().ravel()])

    def states(self, path: np.ndarray) -> np.ndarray:
        """(q, v); dH/dp, the first half of the field, is the velocity."""
        n = path.shape[1] // 2
        rates = self.field.many(np.zeros(len(path)), path)  # type: ignore[attr-defined]
        return np.hstack([path[:, :n], rates[:, :n]])

    def masses(self, state: np.ndarray) -> np.ndarray:
        """The diagonal (n) of the mass matrix."""
        return masses_of(self.model.kinetic, state, self.model)

    def turned(self, turns: np.ndarray) -> np.ndarray:
        """The same."""
        return turns

    def frame(self, state: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gradients of the invariants, symmetry directions (the flow first) and gradients of the constraints at y."""
        model, flow = self.model, self.field(0.0, start)
        free = None if model.forces is None else hamilton(replace(model, forces=None)).field(0.0, start).full().ravel()
        lift = self.equations.lift(*np.split(state, 2)).full()
        return *canonical_frame(model, state, flow, lift, free), np.zeros((0, start.size))


class Constrained:
    """The same of a Model under constraints, in as few coordinates as it offers."""

    def __init__(self, model: Model) -> None:
        if model.forces is not None:
            raise InputError(
                "certify: systems under constraints are certified when they are conservative, and this is not"
            )
        self.system, self.equations = constrained_hamilton(model)
        self.field = vector_field(self.equations.field)

    def variations(self) -> VectorField:
        """z' for z = (y, vec Y, action)."""
        return vector_field(self.equations.variational)

    def start(self, state: np.ndarray) -> np.ndarray:
        """(q, momentum) in the system's own coordinates."""
        q, v = np.split(state[self.system.chosen], 2)
        return np.concatenate([q, self.equations.momentum(q, v).full().ravel()])

    def states(self, path: np.ndarray) -> np.ndarray:
        """States of the model."""
        rates = self.equations.velocity.map(len(path))(path.T).full()
        return np.asarray(self.system.lift.map(len(path))(path.T[: self.system.size], rates).full().T)

    def masses(self, state: np.ndarray) -> np.ndarray:
        """The diagonal (m / 2) of the mass matrix."""
        return masses_of(self.system.kinetic, state[self.system.chosen])

    def turned(self, turns: np.ndarray) -> np.ndarray:
        """Those of the coordinates chosen."""
        return np.asarray(turns[self.system.chosen[: self.system.size]])

    def frame(self, _: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The energy's gradient, the flow, and what the motion is held to."""
        gradient = self.equations.gradient(start).full().reshape(1, -1)
        return gradient, self.field(0.0, start)[None, :], self.equations.tangent(start).full()


def canonical_frame(
    model: Model, state: np.ndarray, flow: np.ndarray, lift: np.ndarray, free: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the invariants and the symmetry directions (flow, unless forced, first) in canonical coordinates.

    `lift` (2n x 2n) takes directions there from (q, v), `flow` is there already and `free` the flow without forces.
    Each gradient comes from the direction that it generates without forces: X = J grad I, so grad I = -J X.
    """
    turns = generated(model, state) @ lift.T
    conserved = np.vstack([*([flow if free is None else free] if model.conservative else []), turns])
    n = model.degrees_of_freedom
    directions = np.vstack([*([] if model.forced else [flow]), turns])
    return np.hstack([-conserved[:, n:], conserved[:, :n]]), directions


def canonical_motion(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, moments: np.ndarray, settings: ReferenceSettings
) -> Motion:
    """The `Motion` of a state (2n) at `moments` (from 0 to the period) by Hamilton's equations."""
    equations = Hamiltonian(model) if model.constraint is None else Constrained(model)
    start, masses = equations.start(state), equations.masses(state)
    units = units_of(equations.field, start, masses, period)
    path = integrate_in(units, equations.field, start, moments, settings, period / STEPS_PER_PERIOD)
    transitions, action = _pieces(equations.variations(), start, units, period)
    gradients, directions, constraints = equations.frame(state, start)
    return Motion(
        moments, equations.states(path), path, transitions, action, equations.field(0.0, start), gradients, directions,
        masses, equations.turned(turns), constraints=constraints,
    )  # fmt: skip


def units_of(field: VectorField, start: np.ndarray, masses: np.ndarray, period: float) -> np.ndarray:
    """Extents (m) of the motion in y = (q, p) from a start, by a quick integration.

    That one is measured in a first guess of them, |y| + T |y'| + T^2 |y''| at the start.
    """
    rate, nudge = field(0.0, start), 1e-4 * period
    turned = np.abs(field(nudge, start + nudge * rate) - rate) * (period / nudge)
    first = np.abs(start) + period * np.abs(rate) + period * np.where(np.isfinite(turned), turned, 0.0)
    if not np.all(np.isfinite(first) & (first < 1e100)):
        return np.ones(start.size)
    units = in_momenta(first, masses, period)
    path = integrate_in(units, field, start, np.linspace(0.0, period, 65), ROUGH)
    return in_momenta(np.ptp(path, axis=0), masses, period)


def in_momenta(moved: np.ndarray, masses: np.ndarray, period: float) -> np.ndarray:
    """`extents` in (q, p) of what moved so far in (q, p)."""
    places, momenta = np.split(moved, 2)
    lengths, speeds = extents(places, momenta / np.maximum(masses, 1e-300), masses, period)
    return np.concatenate([lengths, np.where(masses > 0, masses, 1.0) * speeds])


def _pieces(
    variational: VectorField, start: np.ndarray, units: np.ndarray, period: float
) -> tuple[list[np.ndarray], float]:
    """State-transition matrices (m x m) of equal pieces of a period, and the action."""
    size, now, action = start.size, start, 0.0
    matrix = (units[:, None] / units[None, :]).ravel("F")
    work = float(units[: size // 2] @ units[size // 2 :]) or 1.0
    measures, pieces = np.concatenate([units, matrix, [work]]), []
    for k in range(PIECES):
        extended = np.concatenate([now, np.eye(size).ravel(), [0.0]])
        span = period * np.array([k, k + 1]) / PIECES
        end = integrate_in(measures, variational, extended, span, VARIED)[-1]
        pieces.append(end[size:-1].reshape(size, size, order="F"))
        now, action = end[:size], action + float(end[-1])
    return pieces, action


def evenly(period: float) -> np.ndarray:
    """The times (SAMPLES + 1) at which a motion is inspected."""
    return np.linspace(0.0, period, SAMPLES + 1)


def chain_motion(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, moments: np.ndarray, settings: ReferenceSettings
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
    pieces = _chain_pieces(closed, state, period / 2 if reflected else period, units)
    lift = closed.momentum_frame(state)
    flow = lift @ closed.field(0.0, state)
    return Motion(
        moments, states, closed.canonical(states), [*pieces, *pieces] if reflected else pieces,
        float(trapezoid(2.0 * energies(model, even)[0], evenly(period))), flow,
        *canonical_frame(model, state, flow, lift), np.ones(n), closed.modes.T @ closed.coupling @ turns,
        "Lagrange's equations in closed form",
    )  # fmt: skip


def _chain_pieces(closed: ChainLagrange, state: np.ndarray, duration: float, units: np.ndarray) -> list[np.ndarray]:
    """Phi of equal pieces (2n x 2n) in the canonical coordinates of `momentum_frame`, from the linear modes' shapes.

    The frames at the two ends of a piece differ; at -x it is that at x, since every entry is even in (q, v) together.
    """
    modes, found, now = np.kron(np.eye(2), closed.modes), [], state
    measures = np.concatenate([units, np.ones(modes.size)])
    for k in range(PIECES_OF_HALF):
        extended = np.concatenate([now, modes.ravel("F")])
        span = duration * np.array([k, k + 1]) / PIECES_OF_HALF
        end = integrate_in(measures, closed.variational, extended, span, SECOND)[-1]
        before, now = now, end[: state.size]
        found.append(closed.carried(before, now, end[state.size :].reshape(modes.shape, order="F")))
    return found
