"""The evidence of a certificate: what another integrator on another formulation says of a state and a period.

One `gather` for every kind of system; what differs between them is in `formulations`. Everything is measured in the
extents of the motion, so that no unit matters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import SECOND, TIGHTEST, ReferenceSettings, integrate, integrate_in, vector_field
from orbitfinder.integrate.equations import accelerations
from orbitfinder.integrate.idas import DaeSettings, simulate_dae
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.mechanics.chain_lagrange import is_long
from orbitfinder.mechanics.constrained import tangent_basis
from orbitfinder.mechanics.model import Model, constraint_of, energies
from orbitfinder.orbits.closure import Closure, closes, extents_of, gap, shift
from orbitfinder.orbits.floquet import Floquet, analyse, reduce_monodromy, symplectic_unit
from orbitfinder.orbits.formulations import (
    Hamiltonian,
    Motion,
    canonical_motion,
    chain_motion,
    evenly,
    in_momenta,
)

CHECKED = replace(TIGHTEST, max_evaluations=100_000)
"""Ten times what a tame period needs at the finest of `LONGEST_STEPS`."""
PIECE_STEPS = 40
"""A piece between two nodes is integrated in at least so many steps."""
LONGEST_STEPS = (np.inf, 1 / 400, 1 / 1600)
"""Longest steps of the check, in periods, each tried only when the one before says that the orbit does not close."""


@dataclass(frozen=True)
class Evidence:
    """What the second integrator on the second formulation says of a state and a period.

    `times` are equally spaced; `closes` measures the gap in extents, `closure` in the model's units (its largest
    component); `exchanged` is the energy (J) that `drift` is relative to, `extents` (2n) those of the motion,
    `growth` the largest |S^-1 Phi(t, s) S| of all s < t, and `reached` the states at
    further moments that were asked for.
    """

    times: np.ndarray
    states: np.ndarray
    closes: Closure
    closure: float
    action: float
    drift: float
    energy: float
    exchanged: float
    extents: np.ndarray
    growth: float
    trivial: float
    symplectic: float
    floquet: Floquet
    reached: np.ndarray
    formulation: str = "Hamilton's equations"


def gather(
    model: Model,
    state: np.ndarray,
    period: float,
    turns: np.ndarray,
    moments: np.ndarray | None = None,
    settings: ReferenceSettings = TIGHTEST,
) -> Evidence:
    """The `Evidence` of a state (2n) and a period (s), the motion's states at further `moments` with it."""
    wanted = np.zeros(0) if moments is None else np.asarray(moments, float)
    found = chain_motion if model.constraint is None and is_long(model) else canonical_motion
    motion = found(model, state, period, turns, np.unique(np.append(evenly(period), wanted)), settings)
    return _measured(model, motion, state, period, turns, wanted)


def _measured(
    model: Model, motion: Motion, state: np.ndarray, period: float, turns: np.ndarray, moments: np.ndarray
) -> Evidence:
    """The `Evidence` of a motion: everything in its own extents, multipliers on the tangent space."""
    at = np.searchsorted(motion.times, evenly(period))
    path, states = motion.path[at], motion.states[at]
    units = in_momenta(np.ptp(path, axis=0), motion.masses, period)
    sizes = np.maximum(np.abs(path).max(axis=0) / units, 1.0)
    pieces = [piece * units[None, :] / units[:, None] for piece in motion.transitions]
    gradients, directions = motion.gradients * units, motion.directions / units
    missed = (path[-1] - path[0] - shift(motion.turns, units.size)) / units
    found = closes(missed, pieces, sizes, None if model.forced else motion.rate * period / units)
    monodromy, growth = _products(pieces)
    basis = tangent_basis(motion.constraints * units) if motion.constraints.size else np.eye(units.size)
    inner, gradients, directions = basis.T @ monodromy @ basis, gradients @ basis, directions @ basis
    scale = max(1.0, float(np.abs(inner).max()))
    form = basis.T @ (units[:, None] * symplectic_unit(units.size // 2) * units) @ basis
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    exchanged = max(float(np.ptp(potential)) + float(kinetic.max()), 1e-3 * float(np.abs(potential).max()), 1e-300)
    return Evidence(
        times=motion.times[at],
        states=states,
        closes=found,
        closure=gap(np.asarray(state, float), states[-1], turns),
        action=motion.action,
        drift=float(np.abs(total - total[0]).max()) / exchanged,
        energy=float(total[0]),
        exchanged=exchanged,
        extents=extents_of(model, states, period),
        growth=growth,
        trivial=max(_off(directions @ inner.T, directions), _off(gradients @ inner, gradients)) / scale,
        symplectic=float(np.abs(inner.T @ form @ inner - form).max()) / (scale**2 * float(np.abs(form).max())),
        floquet=analyse(reduce_monodromy(inner, gradients, directions), conservative=model.conservative),
        reached=motion.states[np.searchsorted(motion.times, moments)],
        formulation=motion.formulation,
    )


def _products(pieces: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Phi(T, 0) and the largest norm of Phi(t, s) between the ends of any two pieces."""
    largest, whole = 1.0, np.eye(len(pieces[0]))
    for begin in reversed(range(len(pieces))):
        whole = np.eye(len(pieces[0]))
        for piece in pieces[begin:]:
            whole = piece @ whole
            largest = max(largest, float(np.linalg.norm(whole)))
    return whole, largest


def _off(found: np.ndarray, wanted: np.ndarray) -> float:
    """How far rows are from what they should be, relative."""
    return float(np.abs(found - wanted).max() / max(np.abs(wanted).max(), 1e-300)) if wanted.size else 0.0


def second_closure(model: Model, state: np.ndarray, period: float, turns: np.ndarray, units: np.ndarray) -> float:
    """Closure in `units` (2n) of the accelerations themselves at a second tolerance: other equations, other steps."""
    field = vector_field(accelerations(model))
    ends = integrate_in(units, field, state, np.array([0.0, period]), SECOND)
    return gap(ends[0], ends[-1], turns, units)


def native_closure(model: Model, state: np.ndarray, period: float, turns: np.ndarray, units: np.ndarray) -> float:
    """Closure in `units` (2n) by IDAS on the native DAE; infinite where it cannot integrate."""
    settings = DaeSettings(relative_tolerance=1e-13, absolute_tolerance=1e-13)
    try:
        motion = simulate_dae(model, state, period, 2, settings)
    except (IntegrationError, InputError):
        return float("inf")
    return gap(motion.states[0], motion.states[-1], turns, units)


def constraint_defect(model: Model, state: np.ndarray, units: np.ndarray) -> float:
    """Largest |phi| and |J v| of a state (2n), relative to its lengths and to the rates' extents, `units` (2n)."""
    constraint, n, p = constraint_of(model), model.degrees_of_freedom, model.parameter_values
    q, v = state[:n], state[n:]
    phi, rate = constraint.phi(q, p).full(), constraint.rate(q, v, p).full()
    length = float(np.abs(q[~model.angular]).max(initial=0.0)) or 1.0
    slopes = np.abs(constraint.jacobian(q, p).full()).max()
    return max(float(np.abs(phi).max()) / length, float(np.abs(rate).max()) / (slopes * units[n:].max()))


class ClosureCheck:
    """The closure of orbits by independent means, at the model's parameters or at freed ones.

    Hamilton's equations, derived from the energies alone, by SciPy's adaptive DOP853 at its tightest.
    """

    def __init__(self, model: Model) -> None:
        self._model, self._at, self._equations = model, dict[str, float](), Hamiltonian(model)

    def __call__(
        self,
        state: np.ndarray,
        period: float,
        turns: np.ndarray,
        allowed: float = 0.0,
        free: Mapping[str, float] | None = None,
        units: np.ndarray | float = 1.0,
    ) -> float:
        """The largest gap round the loop of an orbit, in `units` (2n); `allowed` is what will be asked of it."""
        found = np.inf
        for longest in LONGEST_STEPS:
            found = gap(state, self._end(state, period, longest, free), turns, units)
            if found <= 0.5 * allowed:
                break
        return found

    def ends(self, nodes: np.ndarray, durations: np.ndarray, free: Mapping[str, float] | None = None) -> np.ndarray:
        """Where each piece of an orbit ends (N x 2n) that begins at a node (N x 2n) and lasts so long (s)."""
        pieces = zip(nodes, durations, strict=True)
        return np.stack([self._end(node, duration, 1 / PIECE_STEPS, free) for node, duration in pieces])

    def _end(self, state: np.ndarray, duration: float, longest: float, free: Mapping[str, float] | None) -> np.ndarray:
        """(q, v) after a time, by steps no longer than a share of it."""
        if self._at != dict(free or {}):
            self._at = dict(free or {})
            self._equations = Hamiltonian(with_parameters(self._model, self._at))
        start, span = self._equations.start(state), np.array([0.0, duration])
        path = integrate(self._equations.field, start, span, CHECKED, longest * duration)
        return self._equations.states(path[-1:])[0]
