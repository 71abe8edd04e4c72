"""Where the orbits of a family shrink to a point: its Hopf point, or the centre of its oscillations, solved for.

With f the rates, J their slopes and p the freed parameter, the unknowns z = (x, p, omega, v) satisfy

    f(x, p) = 0,    (J(x, p) - i omega) v = 0,    c.v = 1,

and what is held along the family, an energy or the period 2 pi / omega, has its value: Newton in scaled units from the
last orbit's mean and period. Source: A. Griewank, G. Reddien, IMA J. Numer. Anal. 3 (1983) 295-303.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.families.point import parameter_value
from orbitfinder.families.run import Sample
from orbitfinder.loops.continued import Curve, Solution, advanced
from orbitfinder.loops.loop import Unknowns
from orbitfinder.mechanics.newton import Settings, equilibrium
from orbitfinder.mechanics.scales import parameter_sizes

NEWTON = Settings(
    floor=1e-11, round_off=1e-11, converged=1e-11, most_evaluations=20, farthest=1e2, cutoff=1e-10
)  # fmt: skip
"""A step below `floor`, in the scaled unknowns, solves the equations, one beyond `farthest` leads away,"""
DIFFERENCE = 1e-5
"""Half of a central difference of slopes, in the units of the unknowns: only rates of convergence depend on it."""
CHECKED = 1e-7
"""and an eigenvalue of J is then this near to i omega, relative to it."""
ROUND_OFF = 8 * EPSILON
"""What each row is known to, relative to the sizes of its terms"""


@dataclass(frozen=True)
class RestPoint:
    """An equilibrium with eigenvalues +-i omega: state (d), value and error bar of the parameter, 2 pi / omega (s).

    `others` are the remaining eigenvalues of J.
    """

    state: np.ndarray
    value: float
    error: float
    period: float
    others: np.ndarray


def can_rest(curve: Curve) -> bool:
    """Whether orbits of a family may shrink to an equilibrium: autonomous, of one arc, not relative, not running."""
    return curve.equations.can_rest and not (curve.test or any(curve.turns))


def deviations(curve: Curve, place: Unknowns, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mean (d) over the period, deviations from it (k x d), and their weights (k), the trapezoids of the mesh."""
    mesh, states = curve.equations.symmetry.whole(place.mesh, states, curve.constant)
    weights, halves = np.zeros(mesh.size), 0.5 * (mesh[1:] - mesh[:-1])
    weights[1:] += halves
    weights[:-1] += halves
    mean = weights @ states
    return mean, states - mean, weights


def predicted(curve: Curve, sample: Sample, length: float) -> tuple[Unknowns, np.ndarray]:
    """The orbit so far ahead along the tangent, and its states at the mesh."""
    guess = advanced(sample.solution.place, sample.whole, length)
    if curve.equations.gridded:  # as the rows have it to first order
        return guess, np.vstack([guess.nodes, guess.nodes[:1] + curve.constant])
    return guess, curve.equations.march.states(guess.nodes, guess.mesh, guess.tail)


def vanishing(curve: Curve, sample: Sample, length: float) -> float:
    """How far ahead along the tangent the deviations d from the mean are 0, told by d' at `length` ahead; inf if never.

    <d', d> / <d, d> falls linearly, through 0 at an equilibrium: behind it are the same orbits, half a period later.
    """
    solution = sample.solution
    _, here, weights = deviations(curve, solution.place, solution.march.states)
    _, there, _ = deviations(curve, *predicted(curve, sample, length))
    units = curve.scales.states  # in their extents what does not move is noise
    share = float(np.sum(weights @ (here / units * (there / units))) / np.sum(weights @ (here / units) ** 2))
    return length / (1.0 - share) if share < 1.0 else np.inf


def rest_of(curve: Curve, solution: Solution, name: str) -> RestPoint | None:
    """The equilibrium that an orbit is an oscillation about, with the family's parameter `name`; None without one."""
    extended = _Extended(curve, solution)
    rest = equilibrium(extended.linearised, extended.start, settings=NEWTON)
    if not rest.converged:
        return None
    z, (_, matrix) = rest.w, extended.linearised(rest.w)
    there, values = extended.at(z), np.linalg.eigvals(extended.flow(z)[1]) / z[extended.count]
    nearest = np.argsort(np.minimum(np.abs(values - 1j), np.abs(values + 1j)))
    if not abs(abs(values[nearest[1]].imag) - 1.0) + abs(values[nearest[1]].real) < CHECKED or not there.period > 0:
        return None
    error = rest.size + np.abs(np.linalg.pinv(matrix)) @ (ROUND_OFF * (np.abs(matrix) @ np.abs(z)))
    bars = error[: extended.count] * extended.sizes
    value, (values_, by_state, by_free) = parameter_value(curve, there, name), curve.equations.quantities_at(there)
    k = curve.equations.energy
    bar = float(np.abs(np.append(by_state[k], by_free[k])) @ bars + ROUND_OFF * abs(values_[k]))
    if name in curve.equations.physical:
        bar = float(bars[there.nodes.shape[1] + curve.equations.physical.index(name)])
    return RestPoint(there.nodes[0], value, bar, float(there.period), values[nearest[2:]] * 2 * np.pi / there.period)


class _Extended:
    """The rows of an equilibrium with a pair +-i omega over z = (x, free) / sizes, omega and v, rates in periods."""

    def __init__(self, curve: Curve, solution: Solution) -> None:
        self.curve, self.place, p = curve, solution.place, curve.equations
        mean, there, _ = deviations(curve, solution.place, solution.march.states)
        units = np.maximum(curve.scales.states, np.ptp(there, axis=0))
        self.sizes = np.concatenate([units, parameter_sizes(p.model, p.free, solution.place.free)])
        self.size, self.count = mean.size, self.sizes.size
        y = np.concatenate([mean, solution.place.free]) / self.sizes
        values, vectors = np.linalg.eig(self.flow(y)[1])
        v = vectors[:, np.argmin(np.abs(values - 1j))]
        self.c = v.conj() / np.linalg.norm(v) ** 2
        self.start = np.concatenate([y, [1.0], v.real, v.imag])
        rest = self.at(self.start)
        held = curve.slopes(rest, curve.conditions) * rest.joined(units, rest.period, 0.0, self.sizes[self.size :])
        self.held = nonzero(np.abs(held).max(axis=1, initial=0.0))

    def at(self, z: np.ndarray) -> Unknowns:
        """The equilibrium as an orbit of one node."""
        head = z[: self.count] * self.sizes
        period = self.place.period / z[self.count] if z.size > self.count else self.place.period
        return replace(self.place, nodes=head[None, : self.size], period=period, free=head[self.size :])

    def flow(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """f and J."""
        there, units, pace = self.at(z), self.sizes[: self.size], self.place.period / (2 * np.pi)
        rates, slopes = self.curve.equations.march.arcs[0].linearised(there.nodes[0], there.tail)
        return rates / units * pace, slopes * units / units[:, None] * pace

    def rows(self, z: np.ndarray) -> np.ndarray:
        """f, J v - i omega v, c.v, and what is held in the units that its slopes have at first."""
        v = self._vector(z)
        rates, slopes = self.flow(z)
        turned = np.append(slopes @ v - 1j * z[self.count] * v, self.c @ v - 1.0)
        return np.concatenate([rates, turned.real, turned.imag, self._kept(z)])

    def _vector(self, z: np.ndarray) -> np.ndarray:
        start, end = self.count + 1, self.count + 1 + self.size
        return z[start:end] + 1j * z[end:]

    def _kept(self, z: np.ndarray) -> np.ndarray:
        if not self.held.size:
            return np.zeros(0)
        return np.asarray(self.curve.values(self.at(z), self.curve.conditions) / self.held)

    def linearised(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """They and their Jacobian, by central differences but in v; nan where omega is not positive."""
        size, count, v = self.size, self.count, self._vector(z)
        if not z[count] > 0.0:
            return np.full(z.size, np.nan), np.eye(z.size)
        steps = DIFFERENCE * np.eye(count + 1, z.size)

        def known(near: np.ndarray) -> np.ndarray:
            rates, slopes = self.flow(near)
            return np.concatenate([rates, slopes @ v, self._kept(near)])

        changes = np.zeros((2 * size + self.held.size, z.size), complex)
        changes[:, : count + 1] = np.array([known(z + one) - known(z - one) for one in steps]).T / (2 * DIFFERENCE)
        rates, turned, kept = np.split(changes, [size, 2 * size])
        turned = np.vstack([turned, np.zeros(z.size)])
        turned[:size, count] -= 1j * v
        by_v = np.vstack([self.flow(z)[1] - 1j * z[count] * np.eye(size), self.c])
        turned[:, count + 1 :] = np.hstack([by_v, 1j * by_v])
        return self.rows(z), np.vstack([rates.real, turned.real, turned.imag, kept.real])
