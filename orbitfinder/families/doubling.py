"""To which side the orbit of twice the period is born at a period doubling: the cubic coefficient of its normal form.

With x -> P(x) the return map, A its derivative, A q = -q, p A = -p, p.q = 1, B and C its second and third derivatives,

    c = p.C(q, q, q) / 6 + p.B(q, (1 - A)^-1 B(q, q)) / 2,

and on the centre manifold xi -> -xi + c xi^3. Positive: supercritical, the doubled orbit is stable where the simple one
is not; 0: degenerate (generalised flip). The derivatives are differences of marches of the state.
Source: Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (2004), sections 5.4 and 9.4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.loops.continued import Curve, Solution
from orbitfinder.loops.loop import Unknowns
from orbitfinder.orbits.closure import shift
from orbitfinder.orbits.floquet import complement

STEP = 4e-3
"""Step of the differences, in the metric: of the third ones the round-off is some 1e-7 and the error too"""


def bending(curve: Curve, solution: Solution) -> float:
    """The coefficient c of a doubling, q of unit length in the curve's units; of one orbit found once."""
    if "bending" not in solution.kept:
        solution.kept["bending"] = _bending(curve, solution)
    return float(solution.kept["bending"])


def _bending(curve: Curve, solution: Solution) -> float:
    returned = _Return.of(curve, solution)
    matrix = returned.slopes(solution)
    values, vectors = np.linalg.eig(matrix)
    q = vectors[:, np.argmin(np.abs(values + 1.0))].real
    values, vectors = np.linalg.eig(matrix.T)
    p = vectors[:, np.argmin(np.abs(values + 1.0))].real
    q = q / np.linalg.norm(q)
    p, h = p / (p @ q), STEP
    n3, n2, n1, here, p1, p2, p3 = returned(np.outer(np.arange(-3, 4), h * q))
    second = (-p2 + 16 * p1 - 30 * here + 16 * n1 - n2) / (12 * h**2)
    third = (-p3 + 8 * p2 - 13 * p1 + 13 * n1 - 8 * n2 + n3) / (8 * h**3)
    r = np.linalg.solve(np.eye(len(matrix)) - matrix, second)
    e = r / nonzero(float(np.linalg.norm(r)))
    both = returned(h * np.array([q + e, -q - e, q - e, e - q]))
    mixed = (both[0] + both[1] - both[2] - both[3]) * float(np.linalg.norm(r)) / (4 * h**2)
    return float(p @ third) / 6 + float(p @ mixed) / 2


@dataclass(frozen=True)
class _Return:
    """The return map of an orbit on the section through x(0) normal to the flow, or after a period of the forcing.

    It goes over displacements from x(0) in a basis of the section (columns, in the curve's units).
    """

    curve: Curve
    start: Unknowns
    basis: np.ndarray
    flow: np.ndarray

    @classmethod
    def of(cls, curve: Curve, solution: Solution) -> _Return:
        """That of an orbit, over its whole mesh as one segment."""
        w, size = solution.place, curve.equations.size
        flow = np.zeros(size) if curve.equations.model.forced else curve.equations.march.rates(w.nodes[:1], w.tail)[0]
        flow = flow * w.period / curve.units
        directions = flow[None] if flow.any() else np.zeros((0, size))
        return cls(curve, replace(w, nodes=w.nodes[:1]), complement(np.zeros((0, size)), directions), flow)

    def __call__(self, displacements: np.ndarray) -> np.ndarray:
        """Where displacements (k x r) come back."""
        units, march, start, count = self.curve.units, self.curve.equations.march, self.start, len(displacements)
        tours = np.append((np.arange(count)[:, None] + start.mesh[:-1]).ravel(), float(count))
        ends = march.ends(start.nodes[0] + (displacements @ self.basis.T) * units, tours, start.tail)
        off = self._off(ends)
        # Newton steps to the section, each some digits more than the last
        for _ in range(6 if self.flow.any() else 0):
            rates = march.rates(ends, start.tail) * start.period / units
            shares = -(off @ self.flow) / (rates @ self.flow)
            # how near to the section is on it, in periods
            if np.abs(shares).max() < 1e-15:
                break
            ends = march.ends(ends, np.append(0.0, np.cumsum(shares)), start.tail)
            off = self._off(ends)
        return np.asarray(off @ self.basis)

    def _off(self, ends: np.ndarray) -> np.ndarray:
        """How far ends (k x d) are from x(0), whole turns aside, in the curve's units."""
        return np.asarray((ends - self.start.nodes[0] - shift(self.curve.turns, ends.shape[1])) / self.curve.units)

    def slopes(self, solution: Solution) -> np.ndarray:
        """Its derivative A at the orbit."""
        matrix, units = np.eye(self.curve.equations.size), self.curve.units
        for transition in solution.march.transitions:
            matrix = transition @ matrix
        matrix = matrix * units / units[:, None]
        if self.flow.any():  # what is not on the section is taken back along the flow
            matrix = matrix - np.outer(self.flow, self.flow @ matrix) / (self.flow @ self.flow)
        return np.asarray(self.basis.T @ matrix @ self.basis)
