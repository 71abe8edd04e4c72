"""To which side what is born at a period doubling or at a torus is born: coefficients of their normal forms.

With x -> P(x) the return map, A its derivative, B and C its second and third ones, at a doubling A q = -q, p A = -p,
p.q = 1 and on the centre manifold xi -> -xi + c xi^3; at a torus A q = e^(i t) q, p* A = e^(i t) p*, p*.q = |q| = 1 and
z -> e^(i t) z (1 + d |z|^2), Re d = a,

    c = p.C(q, q, q) / 6 + p.B(q, (1 - A)^-1 B(q, q)) / 2,
    a = Re e^(-i t) p*.[C(q, q, q*) + 2 B(q, (1 - A)^-1 B(q, q*)) + B(q*, (e^(2 i t) - A)^-1 B(q, q))] / 2.

c > 0 or a < 0: supercritical, what is born is stable where the orbit is not; 0: degenerate (generalised flip,
Chenciner). The derivatives are differences of marches of the state. Source: Yu. A. Kuznetsov, Elements of
Applied Bifurcation Theory (2004), sections 5.4, 8.4, 9.4 and 9.5.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import IntegrationError
from orbitfinder.loops.continued import Curve, Solution
from orbitfinder.loops.loop import Unknowns
from orbitfinder.orbits.closure import shift
from orbitfinder.orbits.floquet import complement

STEP = 4e-3
"""Step of the differences, in the metric: of the third ones the round-off is some 1e-7 and the error too"""
FINER, AGREED = (1.0, 0.25, 0.0625), 0.2
"""Shares of it that are compared, and the share of itself to which a coefficient must be the same by two of them"""


def bending(curve: Curve, solution: Solution) -> float:
    """The coefficient c of a doubling, q of unit length in the curve's units; of one orbit found once."""
    if "bending" not in solution.kept:
        solution.kept["bending"] = coefficient(curve, solution, -1.0)
    return float(solution.kept["bending"])


def born(curve: Curve, solution: Solution, multiplier: complex) -> str:
    """On which side what leaves with a multiplier, -1 or e^(i t), is born: supercritical, subcritical or not told."""
    p = curve.equations
    if not p.plain or p.model.conservative or p.symmetry.fraction != 1.0 or curve.test:
        return ""
    sign, known = 1.0 if multiplier.imag == 0.0 else -1.0, []
    for share in FINER:
        with suppress(IntegrationError, np.linalg.LinAlgError):  # what is so far beside an orbit may not come back
            known.append(sign * coefficient(curve, solution, multiplier, STEP * share))
    for first, other in pairwise(known):
        if abs(first - other) < AGREED * min(abs(first), abs(other)):
            return "supercritical" if first > 0 else "subcritical"
    return ""


def coefficient(curve: Curve, solution: Solution, multiplier: complex, step: float = STEP) -> float:
    """c, or a, of the eigenvalue of the return map that is nearest to a multiplier."""
    returned = _Return.of(curve, solution)
    matrix = returned.slopes(solution)
    mu, q = _nearest(matrix, multiplier)
    p = _nearest(matrix.T, multiplier)[1]
    if not np.imag(multiplier):
        q, p, mu = q.real / np.linalg.norm(q.real), p.real, complex(-1.0)
    p, unit = p / (p @ q), np.eye(len(matrix))
    second, third = _Differences(returned, step).forms()
    mean = np.linalg.solve(unit - matrix, second(q, q.conj()).real)
    if not np.imag(multiplier):
        return float((p @ third(q)).real / 6 + (p @ second(q, mean)).real / 2)
    mu = mu / abs(mu)
    double = np.linalg.solve(mu**2 * unit - matrix, second(q, q))
    return float((p @ (third(q) + 2 * second(q, mean) + second(q.conj(), double)) / mu).real / 2)


def _nearest(matrix: np.ndarray, multiplier: complex) -> tuple[complex, np.ndarray]:
    """The eigenvalue nearest to a multiplier and its vector, of length 1."""
    values, vectors = np.linalg.eig(matrix)
    k = int(np.argmin(np.abs(values - multiplier)))
    return complex(values[k]), vectors[:, k]


Form = Callable[..., np.ndarray]


@dataclass(frozen=True)
class _Differences:
    """Derivatives of a return map along directions, by central differences of this step."""

    returned: _Return
    step: float

    def along(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """B(v, v) and C(v, v, v) of a real v."""
        h, size = self.step, nonzero(float(np.linalg.norm(v)))
        n3, n2, n1, here, p1, p2, p3 = self.returned(np.outer(np.arange(-3, 4), h * v / size))
        second = (-p2 + 16 * p1 - 30 * here + 16 * n1 - n2) / (12 * h**2)
        return second * size**2, (-p3 + 8 * p2 - 13 * p1 + 13 * n1 - 8 * n2 + n3) / (8 * h**3) * size**3

    def mixed(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """B(u, v) of real u and v."""
        sizes = [nonzero(float(np.linalg.norm(each))) for each in (u, v)]
        a, b = u / sizes[0], v / sizes[1]
        both = self.returned(self.step * np.array([a + b, -a - b, a - b, b - a]))
        return np.asarray((both[0] + both[1] - both[2] - both[3]) * sizes[0] * sizes[1] / (4 * self.step**2))

    def forms(self) -> tuple[Form, Form]:
        """B of two complex vectors, and C(q, q, q*)."""

        def second(u: np.ndarray, v: np.ndarray) -> np.ndarray:
            parts = [(i * j, a, b) for i, a in ((1, u.real), (1j, u.imag)) for j, b in ((1, v.real), (1j, v.imag))]
            return np.asarray(sum(factor * (self.along(a)[0] if a is b or np.array_equal(a, b) else self.mixed(a, b))
                                  for factor, a, b in parts if a.any() and b.any()))  # fmt: skip

        def third(q: np.ndarray) -> np.ndarray:
            a, b = q.real, q.imag
            if not b.any():
                return self.along(a)[1]
            (alone, other), (more, less) = ([self.along(v)[1] for v in pair] for pair in ((a, b), (a + b, a - b)))
            return np.asarray(alone + (more + less - 2 * alone) / 6 + 1j * (other + (more - less - 2 * other) / 6))

        return second, third


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
        w = solution.place
        flows = curve.equations.march.arcs[0].flows(w.nodes[:1], w.tail)[0] * w.period / curve.units
        flow, directions = flows.sum(axis=0), flows[flows.any(axis=1)]
        return cls(curve, replace(w, nodes=w.nodes[:1]), complement(directions[:0], directions), flow)

    def __call__(self, displacements: np.ndarray) -> np.ndarray:
        """Where displacements (k x r) come back."""
        units, march, start, count = self.curve.units, self.curve.equations.march, self.start, len(displacements)
        tours = np.append((np.arange(count)[:, None] + start.mesh[:-1]).ravel(), float(count))
        ends = march.ends(start.nodes[0] + (displacements @ self.basis.T) * units, tours, start.tail)
        off = self._off(ends)
        # Newton steps to the section, each some digits more than the last
        for _ in range(6 if self.flow.any() else 0):
            rates = march.rates(ends, start.tail) * start.period / units
            with np.errstate(all="ignore"):
                shares = -(off @ self.flow) / (rates @ self.flow)
            if not np.isfinite(shares).all():
                raise IntegrationError("what is displaced leaves the numbers")
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
