"""Stability of motions that harmonic balance found: the Floquet exponents nearest to the imaginary axis, by Hill's matrix.

A small motion e^(s tau) u(tau) beside a periodic one has A(s) u = 0, A(s) the matrix of harmonic balance with d/dtau + s
for d/dtau; exponents come again with every i, or 2 i among odd orders. About shifts sigma along the axis

    A(sigma + theta) = A + theta B + theta^2 C,      (u, mu u) -> (mu u, -A^-1 (B mu u + C u)),   mu = 1 / theta,

and Arnoldi's method finds the largest mu, one sparse factorisation a shift. Each shift knows all exponents in a disc; what
the discs cover together is the strip 0 <= Re s <= `reach` in which no exponent is missing (0: they leave gaps). Source: B. Bentvelsen, A.
Lazarus, Nonlinear Dyn. 91 (2018) 1349-1370.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import ArpackError, LinearOperator, eigs, splu

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.balance_problem import Balanced, Pattern, Series

SOUGHT, VECTORS, CONVERGED = 2, 14, 1e-4
"""Exponents about a shift, vectors that they are sought in, their relative error"""
SMALL, STEP = 40, 0.3
"""Coordinates up to which all exponents are found, by a march; its steps in units of the fastest motion"""
ALIKE, ROUND_OFF = 1e-7, 1e-8
"""Exponents nearer than this are one. Real parts below it are none"""


@dataclass(frozen=True)
class Exponents:
    """Exponents s (in units of omega) nearest to the axis, the least stable first, and how far to its right no other is."""

    values: np.ndarray
    reach: float

    @property
    def multipliers(self) -> np.ndarray:
        """e^(2 pi s)."""
        return np.asarray(np.exp(2 * np.pi * self.values))

    @property
    def stability(self) -> str:
        """In the words of other orbits."""
        worst = float(self.values.real.max(initial=-np.inf))
        if worst > ROUND_OFF:
            return "unstable"
        return "asymptotically stable" if worst < -ROUND_OFF else "stable"


class Hill:
    """What finds exponents on one set of harmonics; patterns are kept."""

    def __init__(self, problem: Balanced) -> None:
        self.basis, self.equations = problem.basis, problem.equations
        self.spacing = 1.0 if 0 in self.basis.orders else 2.0
        self._patterns = dict[complex, list[Pattern]]()

    def exponents(self, problem: Balanced, w: Series) -> Exponents:
        """Those of a motion. Raises `ConvergenceError` where Arnoldi's method finds none."""
        varying, fixed = problem.sampled(w)[1], self.equations.fixed(float(w.vector[-1]))
        if self.equations.size <= SMALL:
            multipliers = np.linalg.eigvals(self._monodromy(problem, w)).astype(complex)
            with np.errstate(divide="ignore"):
                found = np.log(multipliers) / (2 * np.pi)
            return Exponents(found[np.argsort(-found.real)], np.inf)
        discs = {at: self._about(complex(0.0, at), varying, fixed)
                 for at in (0.0, self.spacing / 4, self.spacing / 2)}  # fmt: skip
        alone: list[complex] = []
        for value in sorted(np.concatenate([values for values, _ in discs.values()]), key=lambda s: -s.real):
            turned = complex(value.real, abs((value.imag + 0.5) % 1.0 - 0.5))
            if not any(abs(turned - other) < ALIKE for other in alone):
                alone.append(turned)
        both = [one for s in alone for one in ((s, s.conjugate()) if s.imag > ALIKE else (complex(s.real),))]
        return Exponents(np.array(both), self._reach(discs))

    def nearest(self, problem: Balanced, w: Series) -> complex:
        """The exponent nearest to 0."""
        values = self._about(0j, problem.sampled(w)[1], self.equations.fixed(float(w.vector[-1])))[0]
        return complex(values[np.argmin(np.abs(values))])

    def _monodromy(self, problem: Balanced, w: Series) -> np.ndarray:
        """Of (u, u') over tau = 0 to 2 pi, by Runge and Kutta's steps of fourth order, many at once."""
        value = float(w.vector[-1])
        first = self._rates(problem, w, np.zeros(1), value)[0]
        fastest = float(np.abs(np.linalg.eigvals(first)).max())
        steps = 1 << int(np.ceil(np.log2(2 * np.pi * fastest / STEP)))
        rates = self._rates(problem, w, np.pi / steps * np.arange(2 * steps), value)
        h, one = 2 * np.pi / steps, np.eye(first.shape[0])
        a, b, c = rates[::2], rates[1::2], np.roll(rates[::2], -1, axis=0)
        k1 = a
        k2 = b @ (one + h / 2 * k1)
        k3 = b @ (one + h / 2 * k2)
        k4 = c @ (one + h * k3)
        maps = one + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        while len(maps) > 1:
            maps = maps[1::2] @ maps[::2]
        return np.asarray(maps[0])

    def _rates(self, problem: Balanced, w: Series, times: np.ndarray, value: float) -> np.ndarray:
        """The matrices (s x d x d) of the linearised equations at times (rad), d/dtau of (u, u')."""
        n, own = self.equations.size, problem.basis
        motion = own.motion(problem.coefficients(w), times)
        varying, fixed = self.equations.over(times, motion, value)[1], self.equations.fixed(value)
        slopes = np.zeros((3, times.size, n, n))
        for (i, j, k), samples in zip(self.equations.varying, varying, strict=True):
            slopes[k, :, i, j] = samples
        for (i, j, k), entry in zip(self.equations.steady, fixed, strict=True):
            slopes[k, :, i, j] = entry
        if not slopes[2].any():  # first order
            return np.asarray(-np.linalg.solve(slopes[1], slopes[0]))
        steady = not np.any(self.equations.varying[:, 2] == 2)
        inverse = np.linalg.inv(slopes[2][:1] if steady else slopes[2])
        below = -(inverse @ np.concatenate([slopes[0], slopes[1]], axis=2))
        above = np.broadcast_to(np.hstack([np.zeros((n, n)), np.eye(n)]), (times.size, n, 2 * n))
        return np.concatenate([above, below], axis=1)

    def _reach(self, discs: dict[float, tuple[np.ndarray, float]]) -> float:
        places, reach = sorted(discs), np.inf
        for a, b in zip(places[:-1], places[1:], strict=True):
            radius, half = min(discs[a][1], discs[b][1]), (b - a) / 2
            reach = min(reach, float(np.sqrt(max(radius**2 - half**2, 0.0))))
        return reach

    def _about(self, shift: complex, varying: np.ndarray, fixed: np.ndarray) -> tuple[np.ndarray, float]:
        """Exponents about a shift, and the radius of the disc in which there are no others."""
        a, b, c = (pattern.matrix(fixed, varying) for pattern in self._at(shift))
        try:
            factors = splu(a)
        except RuntimeError:
            return np.array([shift]), 0.0  # an exponent itself
        size = a.shape[0]
        kind = complex if shift.imag else float

        def applied(both: np.ndarray) -> np.ndarray:
            x, y = both[:size], both[size:]
            return np.concatenate([y, -factors.solve(np.asarray(b @ y + c @ x, kind))])

        start = np.random.default_rng(0).normal(size=2 * size).astype(kind)
        operator = LinearOperator((2 * size, 2 * size), matvec=applied, dtype=kind)
        try:
            found = eigs(operator, SOUGHT, which="LM", v0=start, ncv=min(VECTORS, 2 * size - 1), tol=CONVERGED,
                         return_eigenvectors=False)  # fmt: skip
        except ArpackError as error:
            raise ConvergenceError(f"the exponents about {shift} are not found ({error})") from None
        theta = 1.0 / found
        return shift + theta, float(np.abs(theta).max())

    def _at(self, shift: complex) -> list[Pattern]:
        if shift not in self._patterns:
            one, moved = np.eye(self.basis.count), self.basis.slope + (shift if shift.imag else 0.0) * np.eye(self.basis.count)
            powers = [[one, moved, moved @ moved], [0 * one, one, 2 * moved], [0 * one, 0 * one, one]]
            self._patterns[shift] = [Pattern(self.equations, self.basis, each) for each in powers]
        return self._patterns[shift]
