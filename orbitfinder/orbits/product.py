"""Eigenvalues of a product of matrices over any range of sizes, each with the error that its factors' errors make.

Multiplied out, a product of norm 1e12 has lost an eigenvalue of 1e-12. Here the factors are never multiplied: frames
are carried round the product by QR, over and over, until they come back to themselves,

    A_k Q_k = Q_{k+1} T_k,    Q_p = Q_0,    T_k upper triangular,

in blocks of eigenvalues of about one size. An eigenvalue is that of its own diagonal blocks' product, to the round-off
of each factor by itself (the periodic QR algorithm without shifts: A. Bojanczyk, G. Golub, P. Van Dooren, Proc. SPIE
1770 (1992) 31-42).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
from scipy.linalg.lapack import dgeqrf, dgesv, dorgqr

from orbitfinder._runtime.sizes import LEAST

SEPARATED = 30.0
"""Eigenvalues that differ in size by this are told apart by a pass round the product; nearer ones share a block"""
SETTLED = 1e-14
"""Frames that come back to themselves within this are settled"""
NOISE = 1e-6
"""... or, of factors that are ill-conditioned, within this, where so many passes more bring them no nearer"""
PATIENCE, MOST_PASSES, STRETCHED = 4, 40, 1e4
"""... The last: condition of a factor up to which steps are multiplied out"""
SPREAD = 1e8
"""Multipliers farther apart than this are found factor by factor: multiplied out, their matrix has lost eight digits of
the smallest."""


@dataclass(frozen=True)
class Product:
    """A_{p-1} ... A_0 in block triangular form: `frames` Q_k (p x d x d), `upper` T_k, where the blocks begin and end.

    `missed` is by how much the frames do not come back to themselves: a relative error of one factor.
    """

    frames: np.ndarray
    upper: np.ndarray
    cuts: tuple[int, ...]
    missed: float

    @cached_property
    def values(self) -> np.ndarray:
        """The eigenvalues (d complex), block after block, the largest first. Overflown ones are infinite."""
        return np.concatenate([found for found, _ in self._blocks])

    @cached_property
    def _blocks(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """(eigenvalues, eigenvectors) of each diagonal block's product."""
        found = []
        for low, high in pairwise(self.cuts):
            if high - low == 1:
                alone = self.upper[:, low, low]
                with np.errstate(over="ignore", divide="ignore"):
                    value = np.prod(np.sign(alone)) * np.exp(np.log(np.abs(alone)).sum())
                found.append((np.array([value]), np.ones((1, 1), complex)))
                continue
            total, size = np.eye(high - low), 0.0
            for one in self.upper[:, low:high, low:high]:
                total = one @ total
                scale = float(np.abs(total).max())
                total, size = total / scale, size + np.log(scale)
            values, vectors = np.linalg.eig(total)
            order = np.lexsort((values.imag, -values.real, -np.round(np.abs(values), 12)))
            with np.errstate(over="ignore", invalid="ignore"):
                found.append((values[order] * np.exp(size), vectors[:, order].astype(complex)))
        return found

    @property
    def vectors(self) -> np.ndarray:
        """Right eigenvectors (d x d, columns of length 1) of the product, in the order of its values."""
        return np.asarray(self._along[0][0])

    @cached_property
    def _along(self) -> tuple[np.ndarray, np.ndarray]:
        """Right eigenvectors (p x d x d) of the product that begins with each factor, and how that stretches them."""
        count, size, _ = self.upper.shape
        held = np.zeros((size, size), bool)
        for low, high in pairwise(self.cuts):
            held[low:high, low:high] = True
        blocks, free, unit = np.where(held, self.upper, 0.0), np.triu(~held), np.eye(size)
        whole = np.empty((count + 1, size, size))
        whole[-1] = unit  # T_k U_k = U_{k+1} C_k, backwards: the error shrinks by the ratio of sizes in a pass
        for _ in range(MOST_PASSES):
            for k in range(count - 1, -1, -1):
                _, _, solved, singular = dgesv(self.upper[k], whole[k + 1] @ blocks[k])
                if singular:
                    raise np.linalg.LinAlgError("singular matrix")
                whole[k] = np.where(free, solved, unit)
            if np.abs(whole[0] - whole[-1]).max() <= NOISE * np.abs(whole[0]).max():
                break
            whole[-1] = whole[0]
        inner = np.zeros((size, size), complex)
        for (low, high), (_, own) in zip(pairwise(self.cuts), self._blocks, strict=True):
            inner[low:high, low:high] = own
        found, grown = np.empty((count, size, size), complex), np.empty((count, size))
        for k in range(count):
            found[k] = self.frames[k] @ whole[k] @ inner
            inner = blocks[k] @ inner
            grown[k] = np.sqrt((inner.conj() * inner).real.sum(axis=0))
            inner = inner / grown[k]
        lengths = np.linalg.norm(found, axis=1)
        return found / lengths[:, None], grown * np.roll(lengths, -1, axis=0) / lengths

    def errors(self, accuracy: Sequence[float] | np.ndarray) -> np.ndarray:
        """Relative error (d) of each eigenvalue where factor k is known to `accuracy` (p) of its own norm; first order.

        d(mu)/mu = sum_k y_{k+1} dA_k x_k / (y_{k+1} A_k x_k), with x and y right and left eigenvectors on the way; the
        factors' errors know nothing of each other, so that their squares add.
        """
        if self.upper.shape[1] == 1:  # of numbers the relative errors are their own
            return np.array([np.linalg.norm(accuracy) + self.missed])
        right, stretched = self._along
        left = np.linalg.norm(np.linalg.inv(np.roll(right, -1, axis=0)), axis=2)
        each = left * np.linalg.norm(self.upper, 2, axis=(1, 2))[:, None] / stretched
        return np.asarray(np.sqrt(np.asarray(accuracy) ** 2 @ each**2) + self.missed * each.max(axis=0))


def product(factors: Sequence[np.ndarray] | np.ndarray) -> Product:
    """The product A_{p-1} ... A_0 of invertible factors (p x d x d), in the order in which they are applied."""
    size = len(factors[0])
    if size == 1:
        return Product(np.ones((len(factors), 1, 1)), np.array(factors), (0, 1), 0.0)
    above = np.triu(np.ones((size, size), bool))
    frame, best, since = np.linalg.qr(np.vander(np.linspace(0.3, 1.1, size)))[0], np.inf, 0
    for _ in range(MOST_PASSES):
        frames, upper = [frame], []
        for one in factors:
            reflected, scales, *_ = dgeqrf(one @ frame)  # by LAPACK itself: of small ones NumPy takes ten times as long
            frame = dorgqr(reflected, scales)[0]
            frames.append(frame)
            upper.append(np.where(above, reflected, 0.0))
        seam = frames[0].T @ frame
        below = np.array([np.abs(seam[k:, :k]).max() for k in range(1, size)])
        sizes = np.log(np.abs(np.diagonal(upper, axis1=1, axis2=2)) + LEAST).sum(axis=0)
        apart = -np.diff(sizes) > np.log(SEPARATED)
        worst = float(below[apart].max(initial=0.0))
        best, since = (worst, 0) if worst < best else (best, since + 1)
        if worst < SETTLED or (worst < NOISE and since == PATIENCE):
            break
    else:
        worst = float(below[apart & (below < NOISE)].max(initial=0.0))
    upper[-1] = seam @ upper[-1]
    kept = np.flatnonzero(below <= max(worst, SETTLED)) + 1
    return Product(np.array(frames[:-1]), np.array(upper), (0, *map(int, kept), size), worst)


def lost(sizes: np.ndarray, matrices: np.ndarray) -> bool:
    """Whether, multiplied out, matrices (p x d x d) have lost digits of the smallest eigenvalue, these being the sizes,
    to the round-off of the largest, or digits of all to what grows under way and shrinks again, as in a canard."""
    most = SPREAD * max(1.0, float(sizes.max(initial=0.0)))
    if np.sqrt((matrices**2).sum(axis=(1, 2))).prod() <= most:  # nothing on the way is larger
        return bool(sizes.size and sizes.max() > SPREAD * sizes.min())
    ahead = accumulate(matrices, lambda done, piece: piece @ done)
    behind = [*accumulate(matrices[:0:-1], lambda done, piece: done @ piece)][::-1]
    grown = max((np.linalg.norm(a) * np.linalg.norm(b) for a, b in zip(ahead, behind, strict=False)), default=0.0)
    return bool(sizes.size and (sizes.max() > SPREAD * sizes.min() or grown > most))


def merged(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrices (p x d x d) multiplied two by two for as long as none stretches much; and where the products begin and
    end, in numbers of the first ones.
    """
    places, inverses = np.arange(len(matrices) + 1), np.linalg.inv(matrices)
    while len(matrices) > 1:
        pairs, back = matrices[1::2] @ matrices[:-1:2], inverses[:-1:2] @ inverses[1::2]
        sizes = (pairs**2).sum(axis=(1, 2)) * (back**2).sum(axis=(1, 2))
        if sizes.max() > STRETCHED**2:
            break
        alone = slice(len(matrices) // 2 * 2, None)
        matrices, inverses = np.concatenate([pairs, matrices[alone]]), np.concatenate([back, inverses[alone]])
        places = np.append(places[:-1:2], places[-1])
    return matrices, places
