"""How unstable an orbit is, as a number that can be minimised.

For a conservative system the measure is the largest stability index |mu + 1/mu|, 2 and below while
every multiplier is on the unit circle and growing with the spectral radius beyond; for others the
spectral radius itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.loops.freedom import Variables
from orbitfinder.mechanics.model import Model
from orbitfinder.records.orbit import Orbit

REAL = 1e-7
"""A stability index with a smaller imaginary part, relative, is taken for real."""
TIE = 1e-6
"""Spectral radii that differ by less, relative, are equal; all elliptic orbits have 1."""


def instability(model: Model) -> Callable[[Variables], ca.MX]:
    """The objective: a quarter of the largest squared stability index, or the squared spectral radius.

    With a single pair of non-trivial multipliers the index is the trace of Phi(T) minus the trivial
    ones; with more it comes from the eigenvalues, whose derivative is y^H dPhi x / y^H x for left and right
    eigenvectors y and x (Golub, Van Loan, Matrix Computations, section 7.2.2). Raises `InputError` when
    there are no non-trivial multipliers.
    """
    trivial = trivial_count(model)
    others = 2 * model.degrees_of_freedom - trivial
    if others < 1:
        raise InputError("objective: this system has no non-trivial Floquet multipliers; min_instability has no sense")
    if model.conservative and others == 2:
        return lambda variables: (0.5 * (ca.trace(variables.monodromy) - trivial)) ** 2
    largest = _Largest(2 * model.degrees_of_freedom, trivial, model.conservative)
    return lambda variables: largest(variables.monodromy)


def trivial_count(model: Model) -> int:
    """How many multipliers are 1 on every orbit: two for each invariant, or one for the flow."""
    return 2 * len(model.invariants) if model.invariants else int(not model.forced)


def rank(orbit: Orbit) -> tuple[float, float]:
    """What orbits are ordered by: the spectral radius in steps of 1e-6, then the largest |mu + 1/mu|."""
    multipliers = np.asarray(orbit.floquet_multipliers, complex)
    if not multipliers.size:
        return 1.0, 0.0
    radius = float(np.abs(multipliers).max())
    return float(np.round(radius / TIE) * TIE), float(np.abs(multipliers + 1 / multipliers).max())


def measured(monodromy: np.ndarray, trivial: int, conservative: bool) -> tuple[float, np.ndarray]:
    """The measure of a monodromy (m x m) and its derivative in each entry (m x m)."""
    from scipy.linalg import eig

    values, left, right = eig(monodromy, left=True, right=True)
    kept = np.argsort(-np.abs(values - 1.0))[: values.size - trivial]
    sizes = [_size(complex(values[k]), conservative) for k in kept]
    k = int(kept[int(np.argmax(sizes))])
    mu = complex(values[k])
    slope = np.outer(left[:, k].conj(), right[:, k]) / (left[:, k].conj() @ right[:, k])
    radius = abs(mu)
    growth = (mu.conjugate() * slope).real / radius
    if not conservative:
        return radius**2, 2 * radius * growth
    index = mu + 1 / mu
    if _real(index):
        return 0.25 * index.real**2, 0.5 * index.real * ((1 - 1 / mu**2) * slope).real
    return max(sizes), 0.5 * (radius + 1 / radius) * (1 - 1 / radius**2) * growth


def _real(index: complex) -> bool:
    return abs(index.imag) <= REAL * max(1.0, abs(index))


def _size(mu: complex, conservative: bool) -> float:
    """The measure of one multiplier: a quarter of (mu + 1/mu)^2 where that is real, of (r + 1/r)^2 elsewhere."""
    radius = abs(mu)
    if not conservative:
        return radius**2
    index = mu + 1 / mu
    return float(0.25 * index.real**2 if _real(index) else 0.25 * (radius + 1 / radius) ** 2)


class _Largest(ca.Callback):  # type: ignore[misc]
    """`measured` as a CasADi function that brings its Jacobian."""

    def __init__(self, size: int, trivial: int, conservative: bool) -> None:
        ca.Callback.__init__(self)
        self.size, self.trivial, self.kept = size, trivial, conservative
        self.slope: ca.Callback | None = None
        self.construct("largest", {"enable_fd": False})

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.size, self.size)

    def eval(self, arguments: Sequence[ca.DM]) -> list[float]:
        return [measured(arguments[0].full(), self.trivial, self.kept)[0]]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inputs: list[str], outputs: list[str], options: dict[str, object]) -> ca.Function:
        self.slope = _Slope(name, self, inputs, outputs, options)
        return self.slope


class _Slope(ca.Callback):  # type: ignore[misc]
    """The Jacobian of `_Largest`, a row of m^2."""

    def __init__(
        self, name: str, of: _Largest, inputs: list[str], outputs: list[str], options: dict[str, object]
    ) -> None:
        ca.Callback.__init__(self)
        self.of, self.names = of, (inputs, outputs)
        self.construct(name, options)

    def get_n_in(self) -> int:
        return 2

    def get_name_in(self, i: int) -> str:
        return self.names[0][i]

    def get_name_out(self, i: int) -> str:
        return self.names[1][i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.of.size, self.of.size) if i == 0 else ca.Sparsity.dense(1, 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(1, self.of.size**2)

    def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
        slope = measured(arguments[0].full(), self.of.trivial, self.of.kept)[1]
        return [ca.DM(slope.ravel("F")).T]
