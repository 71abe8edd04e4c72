"""Stability of one orbit of a family from its shooting blocks, and matching along the family."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import pairwise
from math import gcd

import numpy as np
from scipy.optimize import linear_sum_assignment

from orbitfinder._runtime.sizes import EPSILON, LEAST, nonzero
from orbitfinder.errors import ConvergenceError
from orbitfinder.integrate.march import QUANTUM
from orbitfinder.loops.continued import Curve, Solution
from orbitfinder.loops.loop import Unknowns
from orbitfinder.orbits.floquet import AREA, Floquet, complement, generated, judged, symplectic_unit, verdict
from orbitfinder.orbits.product import STRETCHED, Product, lost, merged, product
from orbitfinder.records.family import METHODS

ACCURACY, LARGEST = 1e-14, 1e290
"""Relative error of a state-transition matrix of a few steps at least; what multipliers of canards count as that are
beyond the range of numbers"""

STILL = 1e-12
"""A driven motion that extends no farther than this, in the family's metric, is at rest."""


@dataclass(frozen=True)
class Spectrum:
    """Multipliers of the whole period, and what the orbit's reflection refines them to.

    `root` is 2 where the orbit is its own mirror image after half a period, else 1: the multipliers
    are then squares of those of the half map x(0) -> -x(T/2), whose `indices` nu + 1/nu (complex, one
    a reciprocal pair) are what bifurcations are read from. `krein` is +1 or -1 for each multiplier on
    the unit circle off the real axis, 0 for the others. `turns` says for each index which of its two
    root multipliers has Krein sign +1: +1 the upper, -1 the lower, 0 where it is not on the circle.
    `values` and `vectors` (columns) are the root map's, `chain` is that map factor by factor where multiplied out
    it has lost multipliers.
    """

    floquet: Floquet
    root: int
    indices: np.ndarray
    turns: np.ndarray
    krein: tuple[int, ...]
    reduced: np.ndarray
    values: np.ndarray
    vectors: np.ndarray
    conservative: bool = True
    form: np.ndarray | None = None
    chain: RootFactors | None = None

    @property
    def method(self) -> str:
        """How the multipliers were found, one of `records.family.METHODS`."""
        return METHODS[self.chain is not None]

    @cached_property
    def root_multipliers(self) -> np.ndarray:
        """The non-trivial multipliers of the root map, not to be written to."""
        return self.values.astype(complex) if self.chain is None else self.chain.product.values

    @cached_property
    def ranked(self) -> np.ndarray:
        """The same, the largest modulus first."""
        return self.root_multipliers[np.argsort(-np.abs(self.root_multipliers), kind="stable")]

    @cached_property
    def growths(self) -> np.ndarray:
        """The logarithms of their moduli."""
        return np.asarray(np.log(nonzero(np.abs(self.ranked))))

    @cached_property
    def root_errors(self) -> np.ndarray:
        """Estimated relative error of each of the `values`: what errors of the matrices make of it, to first order.

        Their size is measured, by how far they are from symplectic; that of the orbit is not in it.
        """
        if self.chain is not None:
            return self.chain.product.errors(np.full(len(self.chain.product.upper), max(self.chain.missed, ACCURACY)))
        missed = 0.0 if self.form is None else asymplectic(self.reduced, self.form, self.form)
        try:
            left = np.abs(np.linalg.inv(self.vectors)).sum(axis=1)
        except np.linalg.LinAlgError:  # as of several multipliers that resets have made 0
            return np.ones(self.values.size)
        with np.errstate(over="ignore"):
            sizes = nonzero(np.abs(self.values))
            return np.asarray(max(missed, ACCURACY) * np.linalg.norm(self.reduced) * left / sizes)

    @property
    def errors(self) -> np.ndarray:
        """Estimated relative error of each multiplier; 1 where nothing is known of it, as of one that is 0."""
        if not self.values.size:
            return np.zeros(0)
        order = np.abs(self.values**self.root - self.floquet.multipliers[:, None]).argmin(axis=1)
        steps = self.chain.discretised if self.chain else 0.0
        return np.asarray(np.minimum(self.root * (self.root_errors + steps)[order], 1.0))

    @property
    def stability(self) -> str:
        """The verdict, "marginal" where those errors decide."""
        return self.floquet.stability if self.conservative else verdict(self.floquet.multipliers, self.errors)

    @cached_property
    def blur(self) -> float:
        """What is uncertain in every stability index: round-off in the largest multiplier, relative of a chain."""
        if self.chain is not None:
            return float(self.root_errors.max(initial=0.0))
        return float(EPSILON * np.abs(self.floquet.multipliers).max(initial=1.0))


@dataclass(frozen=True)
class RootFactors:
    """The root map of an orbit factor by factor, reduced; `missed` is how far its factors are from symplectic, `whole`
    their product on `basis` (columns), and the monodromy its power `root`. `discretised` is the relative error (d) of
    eigenvalues by steps that were chosen for the orbit itself."""

    product: Product
    missed: float
    whole: np.ndarray
    basis: np.ndarray
    root: int
    discretised: np.ndarray


def spectrum(curve: Curve, solution: Solution) -> Spectrum:
    """Reduced multipliers of a corrected orbit, composed from its segments and its symmetry."""
    p, place = curve.equations, solution.place
    chain = _chain(curve, solution) if p.gridded and not p.links else None
    if chain is not None:
        _flows(curve, [solution])
        reduced, basis, root = chain.whole, chain.basis, chain.root
    else:
        maps, bases, root = reduced_maps(curve, [solution])
        reduced, basis = maps[0], bases[0]
    conservative = keeps_pairs(curve, reduced)
    if chain is None:
        values, vectors = np.linalg.eig(reduced)
        transited = solution.march.transitions * curve.units / curve.units[:, None]
        if not p.links and lost(np.abs(values) ** root, transited):
            chain = _chain(curve, solution)
    if chain is not None:
        values, vectors = chain.product.values, np.zeros((0, 0))
        values = np.where(np.abs(values) < LARGEST, values, LARGEST)  # beyond the range of numbers
    floquet = judged(values**root, conservative)
    indices = judged(values, conservative).indices
    krein: tuple[int, ...] = ()
    turns, form = np.zeros(indices.size, int), None
    if indices.size:
        form = _form(curve, place.nodes[0], place, basis)
        upper = np.exp(1j * np.arccos(np.clip(indices.real / 2, -1.0, 1.0)))
        if chain is not None and any(map(_turning, [*floquet.multipliers, *upper])):
            vectors = chain.product.vectors
        alone = root == 1 or chain is not None
        both = (values**root, vectors) if alone else np.linalg.eig(np.linalg.matrix_power(reduced, root))
        krein = _krein(form, *both, floquet.multipliers)
        on_circle = (np.abs(indices.imag) < 1e-7) & (np.abs(indices.real) < 2.0)
        turns = np.where(on_circle, _krein(form, values, vectors, upper), 0)
    return Spectrum(floquet, root, indices, turns, krein, reduced, values, vectors, conservative, form, chain)


def reduced_maps(curve: Curve, solutions: Sequence[Solution]) -> tuple[np.ndarray, np.ndarray, int]:
    """The root maps of orbits without the trivial multipliers (k x r x r), their bases (k x d x r), the maps' root."""
    p, places, flows = curve.equations, [solution.place for solution in solutions], _flows(curve, solutions)
    slopes = [p.quantities_at(place)[1] if p.energy else np.zeros((0, p.size)) for place in places]
    bases, units = _bases(curve, [place.nodes[0] for place in places], flows, slopes), curve.units
    with np.errstate(over="ignore", invalid="ignore"):
        each = np.array([p.links.saltated(solution.place, solution.march, p.march) for solution in solutions])
        matrices = reduce(lambda before, after: after @ before, each.swapaxes(0, 1))
        root_maps, root = p.symmetry.root(matrices, lambda other: _inverses(curve, solutions, matrices) @ other, p.size)
        reduced = bases.swapaxes(1, 2) @ (root_maps * units / units[:, None]) @ bases
    if p.gridded:  # they are told factor by factor
        reduced = np.clip(np.nan_to_num(reduced), -LARGEST, LARGEST)
    if not np.all(np.isfinite(reduced)):
        raise ConvergenceError("the multipliers overflow, as where a guard is grazed; take a smaller step")
    return reduced, bases, root


def keeps_pairs(curve: Curve, reduced: np.ndarray) -> bool:
    """Whether multipliers of reduced maps (... x r x r) come in reciprocal pairs; resets need not keep areas."""
    areas = np.abs(np.linalg.det(reduced)) if curve.equations.links and reduced.size else 1.0
    return bool(curve.equations.symplectic and np.all(np.abs(areas - 1.0) < AREA))


def _chain(curve: Curve, solution: Solution) -> RootFactors:
    """The root map of an orbit in factors of a few steps each, every one on the level sets of the invariants modulo the
    symmetry directions where it begins and ends.
    """
    p, w, units = curve.equations, solution.place, curve.units
    states, matrices = solution.march.states[:: w.steps], solution.march.transitions * units / units[:, None]
    if w.steps > 1 and not np.linalg.cond(matrices).max() <= STRETCHED:
        states = p.march.states(w.nodes, w.mesh, w.tail)[:: gcd(w.steps, QUANTUM)]
        matrices = p.march.varied(states[:-1], w.mesh, w.tail).transitions * units / units[:, None]
    matrices, places = merged(matrices)
    states, last, symmetry = states[places], len(matrices), p.symmetry
    there = list(range(1, last + 1))
    if symmetry.reverses:  # out, turned, back, turned
        stops = [0, *there, *reversed(there), 0, 0]
    else:  # a whole period ends where it began, a part is taken there by the symmetry
        stops = [0, *there, 0] if symmetry.forward is not None else [0, *there[:-1], 0]
    factors, root = symmetry.root(
        list(matrices),
        lambda other: other + list(np.linalg.inv(matrices[::-1])),
        p.size,
        made=lambda matrix: [matrix * units / units[:, None]],
        times=lambda after, before: before + after,
    )
    none = np.zeros((0, p.size))
    slopes = [p.march.at(p.quantities, x, w.free)[1] if p.energy else none for x in states]
    bases = _bases(curve, states, p.march.arcs[0].flows(states, w.tail), slopes)
    reduced = [bases[b].T @ factor @ bases[a] for factor, (a, b) in zip(factors, pairwise(stops), strict=True)]
    missed = 0.0
    if p.symplectic:
        forms = [_form(curve, x, w, basis) for x, basis in zip(states, bases, strict=True)]
        missed = max(
            asymplectic(factor, forms[a], forms[b])
            for factor, (a, b) in zip(reduced, pairwise(stops[: last + 1]), strict=False)
        )
    with np.errstate(over="ignore", invalid="ignore"):
        whole = np.nan_to_num(reduce(lambda before, after: after @ before, reduced))
    found = product(reduced)
    # the error (d) with which factors of so many steps each are known
    grown, steps = np.log(np.abs(np.diagonal(found.upper, axis1=1, axis2=2)) + LEAST), np.diff(places)
    steps = (steps if len(steps) == len(grown) else np.full(len(grown), steps.max()))[:, None]
    off = (steps * p.march.arcs[0].growth_errors(grown / steps)).sum(axis=0)
    return RootFactors(found, missed, np.clip(whole, -LARGEST, LARGEST), bases[0], root, off)


def asymplectic(matrix: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Least relative error of a matrix A that should take a form W to W': |A^T W' A - W| / 2 |W' A| |A|."""
    if not matrix.size:
        return 0.0
    moved = after @ matrix
    return float(np.linalg.norm(matrix.T @ moved - before) / (2 * np.linalg.norm(moved) * np.linalg.norm(matrix)))


def _form(curve: Curve, x: np.ndarray, w: Unknowns, basis: np.ndarray) -> np.ndarray:
    """The symplectic form at a state (d) on a basis (columns, in the curve's units)."""
    places, momenta = np.split((curve.equations.momentum_slopes(x, w.free) * curve.units) @ basis, 2)
    half = places.T @ momenta
    return np.asarray(half - half.T)


def _inverses(curve: Curve, solutions: Sequence[Solution], matrices: np.ndarray) -> np.ndarray:
    """A^-1 by symplecticity, C A^-1 C'^-1 = -J (C' A C^-1)^T J in canonical coordinates; as it is without."""
    if not curve.equations.symplectic:
        return np.linalg.inv(matrices)
    places = [(each.place.nodes[0], each.march.ends[-1], each.place.free) for each in solutions]
    before = np.array([curve.equations.momentum_slopes(start, free) for start, _, free in places])
    after = np.array([curve.equations.momentum_slopes(end, free) for _, end, free in places])
    canonical = after @ matrices @ np.linalg.inv(before)
    unit = symplectic_unit(matrices.shape[1] // 2)
    return np.linalg.solve(before, -unit @ canonical.swapaxes(1, 2) @ unit @ after)


def _bases(curve: Curve, states: Sequence[np.ndarray], flows: np.ndarray, slopes: Sequence[np.ndarray]) -> np.ndarray:
    """Bases (k x d x r, columns), in the curve's units, of what is neither along the flows (k x ... x d) at states (k
    of d) nor along another symmetry, nor changes an invariant, whose `slopes` (k of ... x d) are given.
    """
    p = curve.equations
    others = np.array([generated(p.model, x) for x in states]) if p.model.invariants else flows[:, :0]
    gradients = np.array([slope[: p.energy] for slope in slopes])
    return complement(gradients * curve.units, np.concatenate([flows, others], axis=1) / curve.units)


def _flows(curve: Curve, solutions: Sequence[Solution]) -> np.ndarray:
    """The flow (k x ... x d) at x(0) of each. Raises `ConvergenceError` unless all of the orbits move."""
    p, places = curve.equations, [solution.place for solution in solutions]
    flows = p.march.arcs[0].flows(np.array([w.nodes[0] for w in places]), np.array([w.tail for w in places]))
    still = ~flows.any(axis=(1, 2))
    if not flows.size:  # what is driven may stand still at that moment, or be carried through one
        moved = np.ptp([solution.march.states for solution in solutions], axis=1)
        still = np.all(moved * np.sqrt(curve.weights[: p.size]) <= STILL, axis=1)
    if np.any(still):
        raise ConvergenceError("the corrector found an equilibrium and no orbit")
    return flows


def _krein(form: np.ndarray, values: np.ndarray, vectors: np.ndarray, wanted: np.ndarray) -> tuple[int, ...]:
    """Sign of i u^* J u for each eigenvector u of a map with these eigenvalues, 0 off the unit circle.

    Source: V. A. Yakubovich, V. M. Starzhinskii, Linear Differential Equations with Periodic
    Coefficients (1975), chapter III.
    """
    signs = []
    for mu in wanted:
        if not _turning(mu):
            signs.append(0)
            continue
        vector = vectors[:, np.argmin(np.abs(values - mu))]
        signs.append(int(np.sign((1j * vector.conj() @ form @ vector).real)))
    return tuple(signs)


def _turning(mu: complex) -> bool:
    """Whether a multiplier is on the unit circle, off the real axis."""
    return bool(abs(abs(mu) - 1.0) < 1e-6 and abs(mu.imag) > 1e-6)


def matching(expected: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The order in which `values` continue what is `expected` (complex arrays), so that curves do not swap.

    The assignment of least total distance; of equal ones, and moving together makes them equal, the one that keeps
    the order.
    """
    if expected.shape != values.shape or values.size < 2:
        return np.arange(values.size)
    gaps = np.abs(_squeezed(expected)[:, None] - _squeezed(values)[None, :])
    # weight of the squared distance in the matching, which decides between equal sums of distances
    return np.asarray(linear_sum_assignment(gaps + 1e-3 * gaps**2)[1])


def _squeezed(indices: np.ndarray) -> np.ndarray:
    """Large indices on a logarithmic scale, so that none of them dominates the matching."""
    size = np.abs(indices)
    bounded = np.maximum(size, 4.0)
    return indices * np.where(size > 4.0, (4.0 + np.log(bounded / 4.0)) / bounded, 1.0)
