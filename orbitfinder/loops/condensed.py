"""The linear systems of multiple shooting: condensed to the first node, or whole, dense or sparse.

    dx_{k+1} = Phi_k dx_k + C_k dy + d_k        k = 0 .. N-2, d_k the defect behind segment k
    sum_k F_k dx_k + L (Phi_{N-1} dx_{N-1} + C_{N-1} dy) + G dy = -r

with dy the change of (period, unfolding, freed parameters) and r the closing rows, of which most have an F_0 only.
Rows at the inner ends of segments (guards) come after those. The nodes follow from the first by a unit triangular
system, after which a small one is left. The product of all Phi_k loses the contracting directions where it is very
large; beyond `LARGEST_PRODUCT` the whole matrix is solved instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgecon, dgetrf, dgetrs, dlange, dtrtrs
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from orbitfinder.integrate.lanes.bordered import Bordered, chains
from orbitfinder.mechanics.newton import Solver, least_squares

LARGEST_PRODUCT = 1e8
CUTOFF = 1e-13
"""Singular values below this, relative to the largest, are taken for 0 (brake orbits at rest have one)"""
SMALL, SPARSE = 150, 10
"""Unknowns up to which a dense factorisation is the faster one, and so it is where one number in so many is not 0"""

NO_PLACES = np.zeros(0, int)
Inner = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Segments (g), and the derivatives of a row of each by its node (g x d) and by y (g x m)"""


@lru_cache(maxsize=32)
def _pattern(count: int, size: int, extra: int, wide: bytes) -> tuple[np.ndarray, ...]:
    """Where a sparse matrix is not 0: which entries of closing rows, of those `wide` all; the order of all entries in
    columns, their rows, and where columns begin."""
    total, cut, rows = count * size, (count - 1) * size, len(wide)
    held = np.repeat(np.frombuffer(wide, bool)[:, None], total, axis=1)
    held[:, :size] = held[:, cut:] = True
    block, own = np.arange(cut).reshape(-1, size), np.broadcast_to(np.arange(size), (count - 1, size, size))
    tail = np.indices((cut, extra)).reshape(2, -1), np.indices((rows, extra)).reshape(2, -1)
    places = [
        np.array([np.repeat(block.ravel(), size), (block[:, :1, None] + own).ravel()]),
        np.array([block.ravel(), block.ravel() + size]),
        np.add(np.nonzero(held), [[cut], [0]]),
        *(np.add(part, [[above], [total]]) for part, above in zip(tail, (0, cut), strict=True)),
    ]
    row, column = np.concatenate(places, axis=1).astype(np.int32)
    order = np.lexsort((row, column))
    starts = np.searchsorted(column[order], np.arange(total + extra + 1)).astype(np.int32)
    return held, order, row[order], starts


@dataclass(frozen=True)
class Linearised:
    """Phi_k (N x d x d), C_k (N x d x m), and the closing rows' derivatives F (r x d, by the first node alone,
    or r x N d), L (r x d), G (r x m).

    `inner` are rows (g) of one segment each (its number), by that segment's node (g x d) and by y (g x m). `kept` is
    what was made of Phi_k and C_k and takes long.
    """

    transitions: np.ndarray
    columns: np.ndarray
    first: np.ndarray
    last: np.ndarray
    tail: np.ndarray
    inner: Inner | None = None
    kept: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def matrix(self) -> np.ndarray:
        """The derivatives of all rows by w."""
        (closing, tail), size = self.closed(), self.transitions.shape[1]
        total, cut = closing.shape[1], closing.shape[1] - size
        matrix = np.zeros((cut + len(closing), total + tail.shape[1]))
        for k, transition in enumerate(self.transitions[:-1]):
            rows, after = slice(k * size, (k + 1) * size), (k + 1) * size
            matrix[rows, rows] = transition
            np.fill_diagonal(matrix[rows, after : after + size], -1.0)
        matrix[:cut, total:] = self.columns[:-1].reshape(cut, tail.shape[1])
        matrix[cut:, :total], matrix[cut:, total:] = closing, tail
        return matrix

    def closed(self) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of the closing rows, and of the inner ones after them, by the nodes (r x N d) and by y."""
        (closing, tail), total, size = self._closing(), self.transitions[..., 0].size, self.transitions.shape[1]
        nodes, end = closing[:, :total], closing[:, total:]
        nodes[:, total - size :] += end @ self.transitions[-1]
        return nodes, end @ self.columns[-1] + tail

    def finite(self) -> bool:
        """Whether all numbers are."""
        parts = (self.transitions, self.columns, self.first, self.last, self.tail)
        return all(bool(np.isfinite(part).all()) for part in parts)

    def sparse(self) -> csc_matrix:
        """The same for many segments, of which most of it is 0."""
        (count, size, extra), (rows, nodes) = self.columns.shape, self.first.shape
        total, cut = count * size, (count - 1) * size
        closing = np.zeros((rows, total))
        closing[:, :nodes] = self.first
        closing[:, cut:] += self.last @ self.transitions[-1]
        tail = self.last @ self.columns[-1] + self.tail
        shape = (cut + rows, total + extra)
        held, order, places, starts = _pattern(count, size, extra, np.any(closing[:, size:cut], axis=1).tobytes())
        links = (self.transitions[:-1].ravel(), np.full(cut, -1.0))
        entries = np.concatenate([*links, closing[held], self.columns[:-1].ravel(), tail.ravel()])
        return csc_matrix((entries[order], places, starts), shape=shape)

    def bordered(self, row: np.ndarray) -> Linearised:
        """The same with a row more, over w, after the closing ones."""
        (rows, nodes), total = self.first.shape, self.transitions[..., 0].size
        first = np.zeros((rows + 1, total))
        first[:rows, :nodes], first[rows] = self.first, row[:total]
        last, tail = np.vstack([self.last, np.zeros(self.last.shape[1])]), np.vstack([self.tail, row[total:]])
        return replace(self, first=first, last=last, tail=tail)

    def _closing(self) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of the closing rows, and of the inner ones after them, by x_0 .. x_N and by y."""
        count, size, _ = self.transitions.shape
        rows, nodes = self.first.shape
        places, slopes, by_tail = self.inner or (NO_PLACES, None, None)
        closing, tail = np.zeros((rows + len(places), (count + 1) * size)), self.tail
        closing[:rows, :nodes], closing[:rows, count * size :] = self.first, self.last
        if len(places):
            tail = np.concatenate([tail, by_tail])
            closing.reshape(-1, count + 1, size)[np.arange(len(places)) + rows, places] = slopes
        return closing, tail


def pivoted(system: Linearised, columns: np.ndarray | None = None) -> Solver:
    """Newton's step by the matrix of all segments, pivoted: of so many no product tells anything.

    `columns` are what the unknowns are measured in (over w), else 1. Raises `LinAlgError` where it is singular, or not
    square.
    """
    count, size, extra = system.columns.shape
    if len(system.first) != size + extra or not system.finite():
        raise np.linalg.LinAlgError("not square or not finite")
    if (opened := chains()) is not None and count > 1:
        first = np.zeros((len(system.first), count * size))
        first[:, : system.first.shape[1]] = system.first
        units = np.ones(count * size + extra) if columns is None else columns
        return Bordered(opened, system.transitions, system.columns, first, system.last, system.tail, units).step
    try:
        factors = splu(system.sparse())
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from None
    return lambda rows: -factors.solve(rows)


def eliminated(system: Linearised) -> Solver:
    """Newton's step for any residual at this linearisation."""
    count, size, extra = system.columns.shape
    total, (closing, tail) = count * size, system._closing()
    links, segments = np.eye(total + size), np.arange(count)  # of x_0 and x_{k+1} - Phi_k x_k by x_0 .. x_N
    links.reshape(count + 1, size, count + 1, size)[segments + 1, :, segments] = -system.transitions
    start = np.zeros((total + size, size + extra))
    start[:size, :size], start[size:, size:] = links[:size, :size], system.columns.reshape(total, extra)
    along = _followed(links, start)
    if not np.abs(along[total:, :size]).max() <= LARGEST_PRODUCT:
        whole = _solver(system.matrix())
        return lambda rows: -whole(rows)
    matrix = closing @ along
    matrix[:, size:] += tail
    solved = _solver(matrix)

    def solve(rows: np.ndarray) -> np.ndarray:
        defects = np.zeros(total + size)
        defects[size:total] = rows[: total - size]
        carried = _followed(links, defects)
        change = -solved(rows[total - size :] + closing @ carried)
        return np.concatenate([(carried + along @ change)[:total], change[size:]])

    return solve


def _followed(links: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x_0 .. x_N from x_0 and from what is added behind each segment: unit triangular, Fortran's order its transpose"""
    return np.asarray(dtrtrs(links.T, right, lower=0, trans=1, unitdiag=1)[0])


def _solver(matrix: np.ndarray) -> Solver:
    """A square matrix factorised once; one that is singular to round-off, or not square, by least squares."""
    if matrix.shape[0] == matrix.shape[1]:
        factors, order, fault = dgetrf(matrix)
        if not fault and dgecon(factors, dlange("1", matrix))[0] > CUTOFF:
            return lambda rows: dgetrs(factors, order, rows)[0]
    return least_squares(matrix, CUTOFF)


Jacobian = np.ndarray | Linearised
"""The derivatives of rows by w, whole or in parts"""


def dense(jacobian: Jacobian) -> np.ndarray:
    """The same as a whole."""
    return jacobian.matrix() if isinstance(jacobian, Linearised) else jacobian


def bordered(jacobian: Jacobian, row: np.ndarray) -> Jacobian:
    """The same with a row more, over w, after the others."""
    return jacobian.bordered(row) if isinstance(jacobian, Linearised) else np.vstack([jacobian, row])


def combined(a: Jacobian, share: float, b: Jacobian, other: float) -> Jacobian | None:
    """share a + other b, of no inner rows; None where they are not alike in parts, segments and rows."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return share * a + other * b if a.shape == b.shape else None
    if not (isinstance(a, Linearised) and isinstance(b, Linearised)):
        return None
    if a.columns.shape != b.columns.shape or len(a.first) != len(b.first):
        return None
    first = np.zeros((len(a.first), max(a.first.shape[1], b.first.shape[1])))
    for each, weight in ((a, share), (b, other)):
        first[:, : each.first.shape[1]] += weight * each.first
    transitions, columns = share * a.transitions + other * b.transitions, share * a.columns + other * b.columns
    return Linearised(transitions, columns, first, share * a.last + other * b.last, share * a.tail + other * b.tail)


def factorised(matrix: Jacobian, nodes: tuple[int, ...] = (1, 0)) -> Solver:
    """What multiplies by the inverse of a square matrix. Raises `LinAlgError` where it is singular, or not square.

    The first rows of a whole one may be those of the links between `nodes` (N x d): of many unknowns all nodes are
    then followed from the first, as those in parts are, and what is factorised is d and the last columns wide.
    """
    parts = matrix if isinstance(matrix, Linearised) else _parts(matrix, *nodes) if nodes[0] > 1 else None
    if parts is not None and parts.columns[..., 0].size > SMALL and (solver := along_nodes(parts)):
        return solver
    matrix = dense(matrix)
    if matrix.shape[0] != matrix.shape[1] or not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("not square or not finite")
    if len(matrix) > SMALL and SPARSE * np.count_nonzero(matrix) < matrix.size:
        try:
            sparse = splu(csc_matrix(matrix))
        except RuntimeError as error:
            raise np.linalg.LinAlgError(str(error)) from None
        return lambda right: sparse.solve(right)
    return _pivoted(matrix)


def _pivoted(matrix: np.ndarray) -> Solver:
    """The same by LAPACK, of a matrix that is square and finite."""
    factors, order, fault = dgetrf(matrix)
    if fault:
        raise np.linalg.LinAlgError("singular matrix")
    return lambda right: dgetrs(factors, order, right)[0]


def _parts(matrix: np.ndarray, count: int, size: int) -> Linearised:
    """A whole matrix in parts, what it has of the last segment among the closing rows."""
    total, cut = count * size, (count - 1) * size
    transitions, columns = np.zeros((count, size, size)), np.zeros((count, size, matrix.shape[1] - total))
    for k in range(count - 1):
        transitions[k] = matrix[k * size : (k + 1) * size, k * size : (k + 1) * size]
    columns[:-1] = matrix[:cut, total:].reshape(count - 1, size, -1)
    closing = matrix[cut:]
    return Linearised(transitions, columns, closing[:, :total], np.zeros((len(closing), size)), closing[:, total:])


def along_nodes(system: Linearised) -> Solver | None:
    """The same of a matrix in parts by all nodes from the first; None where segments grow too much, or it is not
    square or not finite."""
    (count, size, extra), links, cut = system.columns.shape, system.transitions[:-1], system.columns[1:, :, 0].size
    if len(system.first) != size + extra or system.inner is not None or not system.finite():
        return None
    along = system.kept.get("along")
    if along is None:
        along = np.zeros((count, size, size + extra))
        np.fill_diagonal(along[0], 1.0)
        for k, link in enumerate(links):
            np.matmul(link, along[k], out=along[k + 1])
            along[k + 1][:, size:] += system.columns[k]
        system.kept["along"] = along
    if not np.abs(along).max() <= LARGEST_PRODUCT:
        return None
    closing, tail = system.closed()
    reduced = np.hstack([np.zeros((len(tail), size)), tail])
    for k, followed in enumerate(along):
        block = closing[:, k * size : (k + 1) * size]
        rows = np.flatnonzero(block.any(axis=1))  # most have something of the first and of the last node alone
        reduced[rows] += block[rows] @ followed
    solved = _pivoted(reduced)

    def solve(right: np.ndarray) -> np.ndarray:
        carried, defects = np.zeros((count, size)), right[:cut].reshape(-1, size)
        for k, link in enumerate(links):
            carried[k + 1] = link @ carried[k] - defects[k]
        head = solved(right[cut:] - closing @ carried.ravel())
        return np.concatenate([(carried + along @ head).ravel(), head[size:]])

    return solve


class Broyden:
    """Full steps of Broyden's method from one Jacobian, its updates kept as the steps themselves.

    Source: C. T. Kelley, Iterative Methods for Linear and Nonlinear Equations (1995), section 7.3, algorithm brsol.
    """

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self._steps: list[np.ndarray] = []

    def step(self, rows: np.ndarray) -> np.ndarray:
        """The step from where the residual is `rows`; the steps before it must have been taken in full."""
        right = -self.solver(rows)
        for step, following in pairwise(self._steps):
            right = right + following * ((step @ right) / (step @ step))
        if self._steps:
            last = self._steps[-1]
            right = right / (1.0 - (last @ right) / (last @ last))
        self._steps.append(right)
        return right
