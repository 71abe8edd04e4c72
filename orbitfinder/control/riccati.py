"""The periodic Riccati equation of a linear-quadratic regulator, solved without a step that could lose digits.

    -P' = A^T P + P A - P B R^-1 B^T P + Q,    P(T) = P(0),    u = -R^-1 B^T P x

Over a piece of the period its Hamiltonian system x' = A x - B R^-1 B^T l, l' = -Q x - A^T l is kept as a scattering

    x1 = Phi x0 - G l1,    l0 = H x0 + Phi^T l1        (G, H symmetric and not negative),

of which two join to a third without any growing matrix, and a period joined with itself again and again (doubling)
converges quadratically: Phi -> 0, H -> P(0). The Hamiltonian's own monodromy has multipliers in pairs mu, 1 / mu, of
which double precision keeps no small one beside a large one.

Source: B. D. O. Anderson, Second-order convergent algorithms for the steady-state Riccati equation, Int. J. Control 28
(1978) 295-306; R. Redheffer, On a certain linear fractional transformation, J. Math. Phys. 39 (1960) 269-286.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from orbitfinder.errors import ConvergenceError


@dataclass(frozen=True)
class Scattering:
    """Phi, G and H (m x m each) of a piece of the period."""

    transition: np.ndarray
    reach: np.ndarray
    cost: np.ndarray

    @staticmethod
    def of(blocks: np.ndarray) -> Scattering:
        """That of the state-transition matrix of (x, l) over the piece, in blocks (2 x 2 x m x m)."""
        (first, second), (third, fourth) = blocks
        back = np.linalg.inv(fourth)
        return Scattering(first - second @ back @ third, _even(-second @ back), _even(-back @ third))

    def then(self, after: Scattering) -> Scattering:
        """The piece and the one after it as one."""
        inner = np.eye(len(self.reach)) + self.reach @ after.cost
        onward, reached = np.linalg.solve(inner, self.transition), np.linalg.solve(inner, self.reach)
        return Scattering(
            after.transition @ onward,
            _even(after.reach + after.transition @ reached @ after.transition.T),
            _even(self.cost + self.transition.T @ after.cost @ onward),
        )

    def before(self, solution: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """P where the piece begins from P where it ends, and the closed loop's state-transition matrix over it."""
        closed = np.linalg.solve(np.eye(len(solution)) + self.reach @ solution, self.transition)
        return _even(self.cost + self.transition.T @ solution @ closed), closed


@dataclass(frozen=True)
class Regulator:
    """P (N + 1 x m x m) where pieces begin, the last at the end of the period, and the closed loop over each piece."""

    solutions: np.ndarray
    transitions: np.ndarray

    @property
    def monodromy(self) -> np.ndarray:
        """The closed loop's state-transition matrix (m x m) over the period."""
        return reduce(lambda before, after: after @ before, self.transitions)


def periodic(pieces: Sequence[Scattering]) -> Regulator:
    """The stabilising periodic solution for the pieces of a period, in their order.

    Raises `ConvergenceError` where there is none: what does not decay is out of the controls' reach or costs nothing.
    """
    last = _doubled(whole(pieces))
    solutions, transitions = [last], list[np.ndarray]()
    for piece in reversed(pieces):
        solution, closed = piece.before(solutions[-1])
        solutions.append(solution)
        transitions.append(closed)
    return Regulator(np.array(solutions[::-1]), np.array(transitions[::-1]))


def whole(pieces: Sequence[Scattering]) -> Scattering:
    """All pieces as one."""
    return reduce(Scattering.then, pieces)


@np.errstate(over="ignore", invalid="ignore")  # what is not finite is raised
def _doubled(period: Scattering) -> np.ndarray:
    """P(0) of infinitely many periods one after another."""
    for _ in range(60):
        twice = period.then(period)
        change, size = float(np.abs(twice.cost - period.cost).max()), float(np.abs(twice.cost).max())
        if not np.isfinite(size):
            break
        if change <= 1e-15 * size and np.abs(twice.transition).max() < 1.0:
            return twice.cost
        period = twice
    raise ConvergenceError(
        "the periodic Riccati equation has no stabilising solution: a deviation that does not decay by itself is out "
        "of the actuators' reach, or Q gives it no weight; choose other actuators, or a positive definite Q"
    )


def _even(matrix: np.ndarray) -> np.ndarray:
    return np.asarray((matrix + matrix.T) / 2)
