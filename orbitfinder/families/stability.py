"""Stability of one orbit of a family from its shooting blocks, and matching along the family."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from orbitfinder.errors import ConvergenceError
from orbitfinder.loops.continued import Curve, Solution
from orbitfinder.orbits.floquet import AREA, Floquet, analyse, complement, generated, reciprocal_pairs, symplectic_unit

UNRESOLVED = 1e7
"""The reciprocal of a multiplier beyond this is taken from it, not from the eigenvalue solver."""

STILL = 1e-12
"""A driven motion that extends no farther than this, in the family's metric, is at rest."""
CONVEX = 1e-3
"""Weight of the squared distance in the matching, which decides between equal sums of distances."""


@dataclass(frozen=True)
class Spectrum:
    """Multipliers of the whole period, and what the orbit's reflection refines them to.

    `root` is 2 where the orbit is its own mirror image after half a period, else 1: the multipliers
    are then squares of those of the half map x(0) -> -x(T/2), whose `indices` nu + 1/nu (complex, one
    a reciprocal pair) are what bifurcations are read from. `krein` is +1 or -1 for each multiplier on
    the unit circle off the real axis, 0 for the others. `turns` says for each index which of its two
    root multipliers has Krein sign +1: +1 the upper, -1 the lower, 0 where it is not on the circle.
    """

    floquet: Floquet
    root: int
    indices: np.ndarray
    turns: np.ndarray
    krein: tuple[int, ...]
    reduced: np.ndarray
    conservative: bool = True


def spectrum(curve: Curve, found: Solution) -> Spectrum:
    """Reduced multipliers of a corrected orbit, composed from its segments and its symmetry."""
    p, place, units = curve.equations, found.place, curve.units
    reduced, basis, root = reduced_map(curve, found)
    conservative = keeps_pairs(curve, reduced)
    whole = np.linalg.matrix_power(reduced, root)
    floquet = _resolved(analyse(whole, conservative)) if conservative else analyse(whole, False)
    indices = analyse(reduced).indices if conservative else floquet.indices
    krein: tuple[int, ...] = ()
    turns = np.zeros(indices.size, int)
    if conservative:
        lift = (p.momentum_slopes(place.nodes[0], place.free) * units) @ basis
        form = np.asarray(lift.T @ symplectic_unit(p.size // 2) @ lift)
        krein = _krein(form, whole, floquet.multipliers)
        upper = np.exp(1j * np.arccos(np.clip(indices.real / 2, -1.0, 1.0)))
        on_circle = (np.abs(indices.imag) < 1e-7) & (np.abs(indices.real) < 2.0)
        turns = np.where(on_circle, _krein(form, reduced, upper), 0)
    return Spectrum(floquet, root, indices, turns, krein, reduced, conservative)


def reduced_map(curve: Curve, found: Solution) -> tuple[np.ndarray, np.ndarray, int]:
    """The root map without the trivial multipliers (r x r), the basis (d x r) that it is in, and the map's root."""
    units, (root_map, root) = curve.units, _root_map(curve, found)
    gradients, directions = _frame(curve, found)
    basis = complement(gradients * units, directions / units)
    reduced = np.asarray(basis.T @ (root_map * units / units[:, None]) @ basis)
    if not np.all(np.isfinite(reduced)):
        raise ConvergenceError("the multipliers overflow, as where a guard is grazed; take a smaller step")
    return reduced, basis, root


def keeps_pairs(curve: Curve, reduced: np.ndarray) -> bool:
    """Whether multipliers come in reciprocal pairs; resets need not keep areas."""
    area = abs(np.linalg.det(reduced)) if curve.equations.links and reduced.size else 1.0
    return bool(curve.equations.symplectic and abs(area - 1.0) < AREA)


def _resolved(floquet: Floquet) -> Floquet:
    """Multipliers too small for the matrix's round-off replaced by the reciprocals of their partners.

    A product of norm 1e12 knows its largest eigenvalue to round-off and one of 1e-12 not at all; the
    pair defect is then that of the pairs which are resolved, and the verdict that of the largest.
    """
    mu = floquet.multipliers.copy()  # the largest first
    largest = float(np.abs(mu).max(initial=1.0))
    if largest < UNRESOLVED:
        return floquet
    told = 1e-3 / (np.finfo(float).eps * largest)
    large = min(int(np.sum(np.abs(mu) > np.clip(told, 1.0, UNRESOLVED))), mu.size // 2)
    middle = slice(large, mu.size - large)
    first, second = reciprocal_pairs(mu[middle])
    defect = float(np.abs(mu[middle][first] * mu[middle][second] - 1.0).max(initial=0.0))
    mu[mu.size - large :] = 1.0 / mu[:large][::-1]
    indices = np.concatenate([mu[:large] + 1.0 / mu[:large], mu[middle][first] + mu[middle][second]])
    return Floquet(mu, defect, indices, "unstable")


def _root_map(curve: Curve, found: Solution) -> tuple[np.ndarray, int]:
    """The matrix of which the monodromy is a power, and that power, from the horizon's matrix by the symmetry."""
    size = curve.equations.size
    matrix = np.eye(size)
    for transition in _transitions(curve, found):
        matrix = transition @ matrix
    return curve.equations.symmetry.root(matrix, lambda other: _inverse(curve, found, matrix) @ other, size)


def _transitions(curve: Curve, found: Solution) -> np.ndarray:
    """The state-transition matrices of all segments, through the events where there are some."""
    p, place = curve.equations, found.place
    if not p.links:
        return found.march.transitions
    arcs = p.links.count
    shares = p.links.shares(place.free) * arcs  # rates are in arcs' own periods
    late = np.vstack([arc.rates(end[None], place.tail) for arc, end in
                      zip(p.march.arcs, found.march.ends[p.links.ends(len(place.nodes))], strict=True)])  # fmt: skip
    starts = place.nodes[:: len(place.nodes) // arcs]
    early = np.vstack([arc.rates(x[None], place.tail) for arc, x in zip(p.march.arcs, starts, strict=True)])
    return p.links.saltated(place, found.march, late / shares[:, None], np.roll(early / shares[:, None], -1, axis=0))


def _inverse(curve: Curve, found: Solution, matrix: np.ndarray) -> np.ndarray:
    """A^-1 by symplecticity, C A^-1 C'^-1 = -J (C' A C^-1)^T J in canonical coordinates; as it is without."""
    if not curve.equations.symplectic:
        return np.linalg.inv(matrix)
    place, end = found.place, found.march.ends[-1]
    before = curve.equations.momentum_slopes(place.nodes[0], place.free)
    after = curve.equations.momentum_slopes(end, place.free)
    canonical = after @ matrix @ np.linalg.inv(before)
    unit = symplectic_unit(len(matrix) // 2)
    return np.asarray(np.linalg.solve(before, -unit @ canonical.T @ unit @ after))


def _frame(curve: Curve, found: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the invariants and symmetry directions, the flow (unless forced) first, at x(0).

    Raises `ConvergenceError`.
    """
    p, place, x = curve.equations, found.place, found.place.nodes[0]
    flow = p.march.rates(x[None], place.tail)[: not p.model.forced]
    moving = np.ptp(found.march.states, axis=0) * np.sqrt(curve.weights[: p.size]) > STILL
    if not np.any(moving if p.model.forced else flow):
        raise ConvergenceError("the corrector found an equilibrium and no orbit")
    return p.quantities_at(place)[1][: p.energy], np.vstack([flow, generated(p.model, x)])


def _krein(form: np.ndarray, whole: np.ndarray, wanted: np.ndarray) -> tuple[int, ...]:
    """Sign of i u^* J u for each eigenvector u of a map, 0 off the unit circle.

    Source: V. A. Yakubovich, V. M. Starzhinskii, Linear Differential Equations with Periodic
    Coefficients (1975), chapter III.
    """
    values, vectors = np.linalg.eig(whole)
    signs = []
    for mu in wanted:
        vector = vectors[:, np.argmin(np.abs(values - mu))]
        value = float((1j * vector.conj() @ form @ vector).real)
        on_circle = abs(abs(mu) - 1.0) < 1e-6 and abs(mu.imag) > 1e-6
        signs.append(int(np.sign(value)) if on_circle else 0)
    return tuple(signs)


def matching(expected: np.ndarray, found: np.ndarray) -> np.ndarray:
    """The order in which `found` continues what is `expected` (complex arrays), so that curves do not swap.

    The assignment of least total distance; of equal ones, and moving together makes them equal, the one that keeps
    the order.
    """
    if expected.shape != found.shape or found.size < 2:
        return np.arange(found.size)
    gaps = np.abs(_squeezed(expected)[:, None] - _squeezed(found)[None, :])
    return np.asarray(linear_sum_assignment(gaps + CONVEX * gaps**2)[1])


def _squeezed(indices: np.ndarray) -> np.ndarray:
    """Large indices on a logarithmic scale, so that none of them dominates the matching."""
    size = np.abs(indices)
    bounded = np.maximum(size, 4.0)
    return np.asarray(indices * np.where(size > 4.0, (4.0 + np.log(bounded / 4.0)) / bounded, 1.0))
