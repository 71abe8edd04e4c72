"""Floquet multipliers of a periodic orbit, exactly reduced, and what they say of stability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.integrate.equations import invariant_gradients
from orbitfinder.mechanics.model import Model

ERROR_FACTOR = 30.0
"""A verdict needs its margin to exceed this many times the error bar."""
ERROR_FLOOR = 1e-8
"""No stability index of a double-precision monodromy is trusted below this."""

STABILITIES = ("elliptic", "unstable", "marginal", "asymptotically stable")
"""The verdicts."""

AREA, COMMUTING = 1e-6, 1e-8
"""How near to 1 the product of a hybrid orbit's multipliers is where its resets keep areas, as its modes do; by what
share of it a symmetry changes an invariant that it does not commute with"""


@dataclass(frozen=True)
class Floquet:
    """Non-trivial multipliers (complex, largest first), their pair defect and the verdict.

    `indices` are the stability indices mu + 1/mu, one for each reciprocal pair.
    """

    multipliers: np.ndarray
    pair_defect: float
    indices: np.ndarray
    stability: str


def symplectic_unit(n: int) -> np.ndarray:
    """J (2n x 2n), which takes the gradient of a function of (q, p) to the motion that it generates."""
    zero, one = np.zeros((n, n)), np.eye(n)
    return np.block([[zero, one], [-one, zero]])


def generated(model: Model, state: np.ndarray, commuting: bool = True) -> np.ndarray:
    """The symmetry directions (k x 2n) in (q, v) that a model's invariants generate at a state (2n).

    If only `commuting` ones are wanted, what is left of them along those that leave all these invariants as they are:
    of the rotations of an angular momentum in space that about it, since the other two are off the level set.
    Source: J. Marsden, A. Weinstein, Reports on Mathematical Physics 5 (1974) 121-130.
    """
    q, v = state[: model.degrees_of_freedom], state[model.degrees_of_freedom :]
    turning = [k for k, one in enumerate(model.invariants) if one.generator]
    parts = q, v, model.parameter_values
    rows = [model.invariants[k].generator(*parts).full().ravel() for k in turning]  # type: ignore[misc]
    directions = np.asarray(rows).reshape(-1, state.size)
    if len(turning) < 2 or not commuting:
        return directions
    kept, along = (
        each / nonzero(np.linalg.norm(each, axis=1, keepdims=True))
        for each in (invariant_gradients(model)(state).full()[turning], directions)
    )
    _, changes, ways = np.linalg.svd(kept @ along.T)
    rank = int((changes > COMMUTING).sum())
    return np.asarray(ways[rank:].T @ ways[rank:] @ along) if rank else directions


def reduce_monodromy(monodromy: np.ndarray, gradients: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The monodromy on the level set of the invariants modulo the symmetry directions.

    `monodromy` (2n x 2n), `gradients` (k x 2n) of the invariants and `directions` (k x 2n), the
    flow first, at one point. Phi maps ker(gradients) to itself and each direction to itself, so
    with an orthonormal basis B of the complement of both, B^T Phi B is Phi on the quotient and
    the trivial multipliers (exactly 1, in Jordan blocks) never enter an eigenvalue solver.
    """
    basis = complement(gradients, directions)
    return np.asarray(basis.T @ monodromy @ basis)


def complement(gradients: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The orthonormal basis (columns) of what is orthogonal to the gradients (k x 2n) and the directions (k x 2n).

    Or the bases of several (... x k x 2n each), of as many columns as the least of them has.
    """
    removed = np.concatenate([gradients, directions], axis=-2)
    *several, _, size = removed.shape
    if not removed.size:  # forced: nothing is trivial
        return np.broadcast_to(np.eye(size), (*several, size, size))
    scale = np.linalg.norm(removed, axis=-1, keepdims=True)
    _, singular, rows = np.linalg.svd(removed / nonzero(scale))  # at an equilibrium the flow is 0
    rank = int(np.sum(singular > 1e-10 * singular[..., :1], axis=-1).max())
    return rows[..., rank:, :].swapaxes(-1, -2)


def analyse(reduced: np.ndarray, conservative: bool = True, error: float = 0.0) -> Floquet:
    """Multipliers, pairs and verdict of a reduced monodromy; an `error` as of `judged`.

    Conservative: reciprocal pairs, "elliptic" when every index is real and in (-2, 2), "unstable"
    when one is clearly outside, "marginal" when the error bar decides. Dissipative:
    "asymptotically stable" | "unstable" | "marginal" by the largest |mu|.
    """
    return judged(np.linalg.eigvals(reduced) if reduced.size else np.zeros(0), conservative, error)


def judged(multipliers: np.ndarray, conservative: bool = True, error: float = 0.0) -> Floquet:
    """The same of multipliers in any order. Of a conservative system indices may be off by an error beside what pairs
    tell: where that is infinite, as nothing resolves the fastest, none is "elliptic" but "undecided"."""
    multipliers = multipliers.astype(complex)
    order = np.lexsort((multipliers.imag, -multipliers.real, -np.round(np.abs(multipliers), 9)))
    multipliers = multipliers[order]
    if not conservative:
        return Floquet(multipliers, 0.0, np.zeros(0, complex), verdict(multipliers))
    first, second = reciprocal_pairs(multipliers)
    defects = np.abs(multipliers[first] * multipliers[second] - 1.0)
    defect = float(defects.max(initial=0.0))
    indices = multipliers[first] + multipliers[second]
    return Floquet(multipliers, defect, indices, _conservative_verdict(indices, defects, error))


def reciprocal_pairs(multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices (two arrays) that pair each multiplier with the one nearest to its reciprocal."""
    left = list(range(multipliers.size))
    first, second = [], []
    while len(left) > 1:
        i = left.pop(0)
        j = min(left, key=lambda k: abs(multipliers[i] * multipliers[k] - 1.0))
        left.remove(j)
        first.append(i)
        second.append(j)
    return np.asarray(first, int), np.asarray(second, int)


def _conservative_verdict(indices: np.ndarray, defects: np.ndarray, known: float) -> str:
    """An error e of the matrix makes |mu_1 mu_2 - 1| about |mu_1 + mu_2| e and the index wrong by about e."""
    if np.isinf(known):
        resolved = _conservative_verdict(indices, defects, 0.0)
        return resolved if resolved == "unstable" else "undecided"
    sizes = np.abs(indices)
    error = ERROR_FACTOR * float((defects * np.minimum(sizes, 4.0 / nonzero(sizes))).max(initial=0.0))
    error = max(error, ERROR_FACTOR * known, ERROR_FLOOR)
    out = outside(indices, error)
    if np.any(out > error):
        return "unstable"
    return "marginal" if np.any(out > -error) else "elliptic"


def outside(indices: np.ndarray, error: float = ERROR_FLOOR) -> np.ndarray:
    """How far each index is out of the real numbers from -2 to 2, negative within: off the axis by more than an error,
    or along it."""
    off = np.abs(indices.imag)
    return np.asarray(np.where(off > error, off, np.abs(indices.real) - 2.0))


def verdict(multipliers: np.ndarray, errors: np.ndarray | float = 0.0) -> str:
    """Of a dissipative system: "marginal" where an error bar, relative and of each multiplier, decides."""
    if not multipliers.size:  # nothing is left that could grow or decay
        return "elliptic"
    sizes, bar = np.abs(multipliers), ERROR_FACTOR * np.asarray(errors)
    with np.errstate(divide="ignore"):  # of one that is 0
        unsure = np.abs(np.log(sizes)) <= np.where(sizes > 1.0, bar, np.log1p(bar))
    unsure |= np.abs(sizes - 1.0) < ERROR_FLOOR
    if np.any((sizes > 1.0) & ~unsure):
        return "unstable"
    return "marginal" if np.any(unsure) else "asymptotically stable"
