"""Deviations from a periodic orbit across its flow, how they grow, and what controls do to them.

With x in units S of the orbit, dy = (x - x*) / S, y' = g and n = g / |g|, deviations along n are a matter of phase.
What is orthogonal to n at a node, under constraints in their tangent space, has a basis E (d x m); from node to node

    z = E^T dy,    z_1 = E_1^T Phi E_0 z_0,    m = d - 1        (2n - 1: what changes the energy is across the flow)

The Hamiltonian system of a regulator of weights P Q P and R, P = 1 - n n^T, in all d components keeps l.g = 0, so that
the same bases reduce it. Followed by the clock, all deviations count: P = 1, m = d.

An impact is one more piece, E+^T J E-: J = DR (1 - f- grad g / (grad g . f-)) makes deviations right after it, at
whatever time, from those at the time of the orbit's own. After it the controller, or its clock, begins anew.

Source: J. Hauser, C. C. Chung, Converse Lyapunov functions for exponentially stable periodic orbits, Systems & Control
Letters 23 (1994) 27-34; A. Shiriaev, L. Freidovich, S. Gusev, IEEE Trans. Automatic Control 55 (2010) 893-906.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from orbitfinder.control.riccati import Scattering, whole
from orbitfinder.integrate.march import March, uniform
from orbitfinder.loops.scales import control_sizes
from orbitfinder.mechanics.constrained import constraint_rows, tangent_basis
from orbitfinder.mechanics.hybrid import saltation
from orbitfinder.mechanics.model import Model, vector_field
from orbitfinder.orbits.floquet import complement

EFFORT = 0.3
"""Seconds of interpreted marching in one design, for `compiled`"""
STEPS = 2
"""Runge-Kutta steps from node to node"""


@dataclass(frozen=True)
class Reference:
    """The orbit that is to be held: states (N + 1 x d) at equal times over the period (s), and their units (d).

    `names` are the parameters that act, at the values of their own along the orbit.
    """

    model: Model
    names: tuple[str, ...]
    period: float
    states: np.ndarray
    units: np.ndarray
    clock: bool

    @property
    def inputs(self) -> np.ndarray:
        """u* (m)."""
        return np.asarray(self.model.parameters().full().ravel()[[self.model.parameter_index(n) for n in self.names]])

    @cached_property
    def jump(self) -> np.ndarray | None:
        """J (d x d, in units) of the event that ends the period."""
        if self.model.smooth:
            return None
        mode, transition = self.model.arcs[0]
        made = saltation(mode.model, transition, None)(self.states[-1], self.model.parameter_values).full()
        return np.asarray(made * self.units / self.units[:, None])

    @cached_property
    def bases(self) -> np.ndarray:
        """E (N + 1 x d x m), the last one the first, or where an event ends the period its own."""
        rates = self.slopes[0][:, : 0 if self.clock else 1, :]
        if self.model.constraint is None:
            bases = [complement(np.zeros((0, self.units.size)), rate) for rate in rates]
            return np.array(bases if self.jump is not None else [*bases, bases[0]])
        bases, level = [], constraint_rows(self.model)
        for state, rate in zip(self.states[:-1], rates, strict=True):
            tangent = tangent_basis(level(state).full() * self.units)
            bases.append(tangent @ complement(np.zeros((0, tangent.shape[1])), rate @ tangent))
        return np.array([*bases, bases[0]])

    @cached_property
    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """g (N x 1 x d) and dg/du (N x d x m) along the orbit; where an event ends it, N + 1 of them."""
        n, d, m = len(self.states) - (self.jump is None), self.units.size, len(self.names)
        times = np.linspace(0.0, self.period, len(self.states))[:n]
        slopes = _slopes(self).map(n)(times[None], self.states[:n].T, np.tile(self.inputs[:, None], (1, n)))
        return slopes[0].full().T[:, None, :], slopes[2].full().reshape(d, n, m).transpose(1, 0, 2)

    @cached_property
    def control_units(self) -> np.ndarray:
        """Of each control (m) what moves the state by its extents in a radian of the period, rms over it."""
        return control_sizes(np.sqrt((self.slopes[1] ** 2).sum(axis=1).mean(axis=0)), self.period)

    @cached_property
    def _march(self) -> March:
        """Of (x, vec Z), Z (2d x 2d) the state-transition matrix of (dy, l); free: vec Q, vec R^-1."""
        size, count = self.units.size, len(self.names)
        t, s, whole = ca.MX.sym("t"), ca.MX.sym("s", 0), ca.MX.sym("whole", size + 4 * size**2)
        free = ca.MX.sym("free", size**2 + count**2)
        weight, ease = ca.reshape(free[: size**2], size, size), ca.reshape(free[size**2 :], count, count)
        rate, by_state, by_control, across = _slopes(self)(t, whole[:size], ca.DM(self.inputs))
        above = ca.horzcat(by_state, -by_control @ ease @ by_control.T)
        below = ca.horzcat(-across @ weight @ across, -by_state.T)
        moved = ca.vertcat(above, below) @ ca.reshape(whole[size:], 2 * size, 2 * size)
        field = ca.vertcat(rate * ca.DM(self.units), ca.vec(moved))
        function = ca.Function("hamiltonian", [t, whole, s, free], [field], {"never_inline": True})
        return March(function, self.model.forced, effort=EFFORT)

    def pieces(self, weight: np.ndarray, ease: np.ndarray) -> list[Scattering]:
        """The regulator's scattering from node to node by Q (d x d) and R^-1 (m x m), all in units.

        Without Q those of the motion itself: its transition and what controls reach, the Gramian.
        """
        d, count = self.units.size, len(self.states) - 1
        scaled = self.control_units[:, None] * ease * self.control_units
        tail = np.concatenate([[self.period], weight.ravel(), scaled.ravel()])
        starts = np.hstack([self.states[:-1], np.tile(np.eye(2 * d).ravel(), (count, 1))])
        ends = self._march.ends(starts, uniform(1.0, count, STEPS), tail)
        blocks = ends[:, d:].reshape(count, 2, d, 2, d).transpose(3, 1, 0, 4, 2)  # CasADi's matrices are by columns
        parts = self.bases[1:].transpose(0, 2, 1) @ blocks @ self.bases[:-1]
        pieces = [Scattering.of(parts[:, :, k]) for k in range(count)]
        if self.jump is not None:
            still = np.zeros((self.bases.shape[2],) * 2)
            pieces.append(Scattering(self.bases[0].T @ self.jump @ self.bases[-1], still, still))
        return pieces

    def reach(self, names: Sequence[str] | None = None) -> Scattering:
        """Over the period: the monodromy of deviations (m x m) and the Gramian of the controls of these names."""
        acting = [float(names is None or name in names) for name in self.names]
        return whole(self.pieces(np.zeros((self.units.size,) * 2), np.diag(acting)))


def lasting(period: Scattering) -> tuple[np.ndarray, np.ndarray]:
    """Multipliers of deviations that do not decay by themselves, and the left eigenvectors (columns) that see them.

    Of all deviations where every one decays.
    """
    multipliers, seen = np.linalg.eig(period.transition.T)
    chosen = np.abs(multipliers) >= 1.0 - 1e-6  # it does not decay by itself
    chosen |= not chosen.any()
    return multipliers[chosen], seen[:, chosen] / np.linalg.norm(seen[:, chosen], axis=0)


def authority(period: Scattering, duration: float) -> tuple[float, complex]:
    """How far controls of rms 1 move in a period (s) the lasting deviation that they move least; and its multiplier.

    0 where that is as little as round-off.
    """
    multipliers, seen = lasting(period)
    moved = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", seen.conj(), period.reach, seen).real, 0.0) * duration)
    least = int(np.argmin(moved))
    most = np.sqrt(np.linalg.norm(period.reach, 2) * duration)
    return float(moved[least] * (moved[least] > 1e-6 * most)), complex(multipliers[least])


def _slopes(reference: Reference) -> ca.Function:
    """(t, x, u) -> g, dg/dy and dg/du in units, and P."""
    model, size = reference.model, reference.units.size
    symbol = model.symbol
    t, x, u = symbol("t"), symbol("x", size), symbol("u", len(reference.names))
    rate = vector_field(model, reference.names)(t, x, type(x)(0, 1), u)
    units = ca.DM(reference.units)
    across = type(x)(ca.DM.eye(size))
    if not reference.clock:
        across -= (rate / units) @ (rate / units).T / ca.sumsqr(rate / units)
    by_state = ca.jacobian(rate, x) * (1 / units @ units.T)
    by_control = ca.jacobian(rate, u) / ca.repmat(units, 1, u.numel())
    return ca.Function("slopes", [t, x, u], [*map(ca.densify, (rate / units, by_state, by_control, across))])
