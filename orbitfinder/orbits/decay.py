"""How fast small motions beside a large driven one die away at least, by an energy: no exponent has to be known.

With M u'' + C u' + K u = 0 beside a periodic motion, M steady, S and N the symmetric and the other part of K, D and G
those of C, D0 the mean of D, and a rate a,

    V = u' . M u' + u . (S + a D0) u + 2 a u . M u' = x . P x,     dV/dtau = -2 x . Q x,     x = (u, u'),
    Q = [[a S - S' / 2, (a (D - D0 + G) - N) / 2], [its transpose, D - a M]].

Where Q > r P always and P > 0 at some time, V falls as e^(-2 r tau) or faster, so no exponent has a real part above -r.
Q - r P is positive where its factors without pivoting have positive pivots. Between N equal times a trigonometric
polynomial of degree m without a mean is at most 1 / cos(pi m / N) times what it is at them (so is x . (Q - r P) x of
any x): the mean, plus and minus so many times what varies, is what has to be positive. Sources: H. Ehlich, K. Zeller,
Math. Z. 86 (1964) 41-44; A. Lyapunov's second method, J. LaSalle, S. Lefschetz, Stability by Liapunov's Direct Method
(1961).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import ArpackError, eigsh, splu

from orbitfinder.orbits.harmonics import Balanced, Coefficients

SHARES, RATE = (0.1, 0.9), 0.5
"""Of what the mean matrices decay by, tried by turns; a, in what damps a mass at least"""
SAME, MOST, CLOSE = 1e-9, 0.4, 1e-3
"""Share of the largest harmonic that is none, and of a transpose's difference; degrees that times tell, in those;
relative error of rates that are tried"""


class Beside:
    """The mean matrices, and entries (k x s, by i and j) that vary about them."""

    def __init__(self, problem: Balanced, w: Coefficients) -> None:
        equations, moving = problem.equations, problem.sampled(w)[1]
        self.n, self.count, self.varies = equations.size, moving.shape[1], equations.varying
        fixed, mean = equations.fixed(problem.values(w)), moving.mean(axis=1)
        self.stiffness, self.damping, self.mass = (
            self.matrix(kind, mean) + self.matrix(kind, fixed, equations.steady) for kind in range(3)
        )
        harmonics = np.fft.rfft(moving - mean[:, None], axis=1)
        worth = np.abs(harmonics).max(axis=0, initial=0.0)
        self.degree = int(np.flatnonzero(worth > SAME * worth.max(initial=0.0)).max(initial=0))
        turn = np.arange(worth.size) * (1 if 0 in problem.basis.orders else 2)
        self.moving, self.slopes = moving - mean[:, None], np.fft.irfft(1j * turn * harmonics, self.count, axis=1)

    def matrix(self, kind: int, entries: np.ndarray, table: np.ndarray | None = None) -> sparse.csc_matrix:
        """Of entries (k) by the coordinates (0), their rates (1) or accelerations (2)."""
        table = self.varies if table is None else table
        own = table[:, 2] == kind
        return sparse.csc_matrix((entries[own], (table[own, 0], table[own, 1])), shape=(self.n, self.n))

    @property
    def shifting(self) -> bool:
        """Whether its masses change with the motion."""
        return bool(np.any(self.varies[:, 2] == 2))

    @property
    def refused(self) -> str:
        """Why an energy cannot tell, or nothing."""
        if self.shifting:
            return "its masses change with the motion"
        if self.degree > MOST * self.count:
            return "its stiffness changes faster than the times of its orders tell"
        turned = self.matrix(0, self.moving @ np.random.default_rng(0).normal(size=self.count))
        if abs(turned - turned.T).max() > SAME * abs(turned).max():
            return "its forces have no potential"
        return ""

    def mean(self, a: float) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
        """Q and P."""
        k, c, m = self.stiffness, self.damping, self.mass
        s, d = (k + k.T) / 2, (c + c.T) / 2
        across = (a * (c - d) - (k - s)) / 2
        across.eliminate_zeros()
        q = sparse.bmat([[a * s, across], [across.T, d - a * m]], format="csc")
        return q, sparse.bmat([[s + a * d, a * m], [a * m, m]], format="csc")

    @property
    def first(self) -> sparse.csc_matrix:
        """How P is off its mean at time 0."""
        nothing = sparse.csc_matrix((self.n, self.n))
        return sparse.block_diag([self.matrix(0, self.moving[:, 0]), nothing], format="csc")

    def varying(self, a: float, r: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of Q - r P, rows and columns (k) and entries (k x s)."""
        stiff, n = self.varies[:, 2] == 0, self.n
        (i, j), (k, m) = self.varies[stiff, :2].T, self.varies[~stiff, :2].T
        x, y, z = self.moving[stiff], self.slopes[stiff], self.moving[~stiff]
        rows, columns = np.concatenate([i, n + k, n + m, k, n + m]), np.concatenate([j, n + m, n + k, n + m, k])
        return rows, columns, np.concatenate([(a - r) * x - y / 2, z / 2, z / 2, a * z / 2, a * z / 2])

    def positive(self, mean: sparse.csc_matrix, a: float, r: float) -> bool:
        """Whether Q - r P is, at all times, of its mean."""
        rows, columns, entries = self.varying(a, r)
        size, widest = 2 * self.n, 1.0 / np.cos(np.pi * self.degree / self.count)
        still = mean.tocoo()
        places, slots = np.unique(
            np.append(still.col, columns) * size + np.append(still.row, rows), return_inverse=True
        )
        indices = (places % size).astype(np.int32)
        starts = np.searchsorted(places, np.arange(size + 1) * size).astype(np.int32)
        fixed = np.bincount(slots[: still.nnz], still.data, places.size)
        for values in entries.T if self.degree else entries.T[:1]:
            moved = widest * np.bincount(slots[still.nnz :], values, places.size)
            if not all(definite(sparse.csc_matrix((fixed + sign * moved, indices, starts), shape=(size, size)))
                       for sign in (1.0, -1.0)):  # fmt: skip
                return False
        return True


def definite(matrix: sparse.csc_matrix) -> bool:
    """Whether a symmetric sparse matrix is positive: its pivots are, in an order that is kept."""
    try:
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return False
    return bool(np.array_equal(factors.perm_r, factors.perm_c) and np.all(factors.U.diagonal() > 0))


@dataclass(frozen=True)
class Decay:
    """A rate r > 0 (in units of omega) that the real part of no exponent is above the negative of, and P at time 0; or
    0 and `why` there is none."""

    rate: float
    why: str = ""
    energy: Any = None

    def distance(self, gap: np.ndarray, units: np.ndarray) -> float:
        """What the true orbit is off a state (u, u') at most that comes back with a gap (2n), in units (2n), to first
        order: sqrt(V) of Phi d is at most e^(-2 pi r) of d's, so that of (1 - Phi)^-1 gap is known."""
        measures = sparse.diags(units**-2.0, format="csc")
        least = extreme(self.energy, measures, "least")
        return float(np.sqrt(gap @ (self.energy @ gap) / least) / -np.expm1(-2 * np.pi * self.rate))


def decay(problem: Balanced, w: Coefficients) -> Decay:
    """How fast small motions beside a motion die away by an energy."""
    beside = Beside(problem, w)
    if why := beside.refused:
        return Decay(0.0, why)
    try:
        even = (beside.damping + beside.damping.T) / 2
        if not definite(even):
            return Decay(0.0, "some of it is not damped")
        a = RATE * extreme(even, beside.mass, "least")
        q, p = beside.mean(a)
        whole = extreme(q, p, "least") if definite(q) and definite(p + beside.first) else 0.0
    except (ArpackError, RuntimeError):
        return Decay(0.0, "some of it is not damped")
    rate = 0.0
    for share in SHARES if whole > 0 else ():
        if not beside.positive(q - share * whole * p, a, share * whole):
            break
        rate = share * whole
    if rate > 0:
        return Decay(rate, energy=p + beside.first)
    return Decay(0.0, "an energy does not bound what its stiffness does as it changes")


def extreme(matrix: sparse.csc_matrix, other: sparse.csc_matrix, end: str) -> float:
    """The least or the largest (by size) eigenvalue of two symmetric matrices, the second positive. Raises
    `RuntimeError`."""
    start = np.random.default_rng(0).normal(size=matrix.shape[0])
    sigma = 0.0 if end == "least" else None
    return float(abs(eigsh(matrix, 1, other, sigma=sigma, v0=start, tol=CLOSE, return_eigenvectors=False)[0]))
