"""Bordered chains of blocks, factorised in compiled code (see `bordered.c`)."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.integrate.compiled import attempted, library, mode, surroundings
from orbitfinder.integrate.held import Shared
from orbitfinder.integrate.lanes.kernel import source


class _System(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_ssize_t) for name in "ndmk"),
        *((name, ctypes.c_void_p) for name in ("transitions", "columns", "first", "last", "tail", "units", "wide")),
    ]  # fmt: skip


class Bordered:
    """The LU factors of rows Phi_k x_k - x_{k+1} + C_k y (k < N - 1, of d each) and F x + L (Phi_{N-1} x_{N-1} +
    C_{N-1} y) + G y (d + m of them).

    Phi (N x d x d), C (N x d x m), F (d + m x N d), L (d + m x d), G (d + m x m), and what the unknowns are measured in
    (N d + m). Raises `LinAlgError` where they are singular.
    """

    def __init__(
        self, opened: tuple[Any, Any], transitions: np.ndarray, columns: np.ndarray, first: np.ndarray,
        last: np.ndarray, tail: np.ndarray, units: np.ndarray,
    ) -> None:  # fmt: skip
        (n, d, m), wide = columns.shape, np.flatnonzero(np.any(first[:, columns.shape[1] :], axis=1))
        given = (
            *(np.ascontiguousarray(each, float) for each in (transitions, columns, first, last, tail, units)),
            wide,
        )
        whole = d + wide.size
        left, width, rows = 2 * whole + m, 3 * whole + m, whole + m
        self._opened, self._given, self._shape = opened, given, (n * d + m, n * whole + m)
        self._raw = _System(n, d, m, wide.size, *(each.ctypes.data for each in given))
        self._chain, self._memory = (
            np.empty(10, np.intp),
            np.zeros((n - 1) * whole * rows + rows * (rows + whole) + whole),
        )
        self._kept = np.empty((n - 2) * 2 * whole * width + left * left + rows)
        self._order, self._work = np.empty((n - 2) * whole + left, np.intp), np.empty(max(whole * width, left))
        limit.check()
        places = (each.ctypes.data for each in (self._memory, self._chain, self._kept, self._order, self._work))
        if not opened[0](ctypes.byref(self._raw), *places):
            raise np.linalg.LinAlgError("singular matrix")

    def step(self, rows: np.ndarray) -> np.ndarray:
        """-matrix^-1 rows (N d + m)."""
        right, (count, more) = np.ascontiguousarray(rows, float), self._shape
        step, full = np.empty(count), np.empty(more)
        arrays = (self._chain, self._kept, self._order, right, step, full, self._work)
        self._opened[1](ctypes.byref(self._raw), *(each.ctypes.data for each in arrays))
        return step


def chains() -> tuple[Any, Any] | None:
    """What factorises them; None without a compiler."""
    return None if mode() == "off" else _made(mode(), *surroundings())


@lru_cache(maxsize=8)
def _made(*_: str | None) -> tuple[Any, Any] | None:
    code = source("pivots.c") + source("bordered.c")
    return attempted("bordered", lambda: library(code, lambda path, new: _opened(path), None))


def _opened(path: Path) -> tuple[Any, Any]:
    """What factorises, and what makes a step of the factors."""
    opened = Shared(path)
    prepare, step = opened["prepared"], opened["stepped"]
    prepare.argtypes, step.argtypes, step.restype = [ctypes.c_void_p] * 6, [ctypes.c_void_p] * 8, None
    return prepare, step
