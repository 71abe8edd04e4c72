"""Bordered chains of blocks, factorised in compiled code (see `bordered.c`)."""

from __future__ import annotations

import ctypes
import os
from functools import lru_cache
from pathlib import Path

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.integrate.compiled import Unavailable, attempted, library, mode
from orbitfinder.integrate.lanes.kernel import source


class _Chain(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_ssize_t) for name in "ndm"),
        *((name, ctypes.c_void_p) for name in ("phi", "columns", "first", "last", "tail", "states", "tails")),
    ]  # fmt: skip


class Bordered:
    """The LU factors of rows Phi_k x_k - x_{k+1} + C_k y (N - 1 of d) and A x_0 + B x_{N-1} + G y (d + m).

    Phi (N - 1 x d x d), C (N - 1 x d x m), `first` A and `last` B (d + m x d), `tail` G (d + m x m); unknowns are
    measured in `states` (d) and `tails` (m). Raises `LinAlgError` where they are singular.
    """

    def __init__(self, opened: ctypes.CDLL, **arrays: np.ndarray) -> None:
        self._opened = opened
        self._arrays = {name: np.ascontiguousarray(array, float) for name, array in arrays.items()}
        links, d, m = self._arrays["columns"].shape
        n, left, width = links + 1, 2 * d + m, 3 * d + m
        self._raw = _Chain(n=n, d=d, m=m, **{name: array.ctypes.data for name, array in self._arrays.items()})
        self._kept = np.empty((n - 2) * 2 * d * width + left * left + d + m)
        self._order, self._work = np.empty((n - 2) * d + left, np.intp), np.empty(max(d * width, left))
        limit.check()
        if not opened.factored(ctypes.byref(self._raw), *self._places()):
            raise np.linalg.LinAlgError("singular matrix")

    def _places(self) -> tuple[int, int, int]:
        return self._kept.ctypes.data, self._order.ctypes.data, self._work.ctypes.data

    def solve(self, right: np.ndarray) -> np.ndarray:
        """matrix^-1 right (N d + m)."""
        answer, (kept, order, work) = np.array(right, float), self._places()
        self._opened.solved(ctypes.byref(self._raw), kept, order, answer.ctypes.data, work)
        return answer


def chains() -> ctypes.CDLL | None:
    """What factorises them; None without a compiler."""
    return None if mode() == "off" else _made(mode(), os.environ.get("CC"), os.environ.get("ORBITFINDER_CACHE"))


@lru_cache(maxsize=8)
def _made(*_: str | None) -> ctypes.CDLL | None:
    code = source("pivots.c") + source("bordered.c")
    return attempted("bordered", lambda: library(code, lambda path, new: _opened(path), None))


def _opened(path: Path) -> ctypes.CDLL:
    try:
        opened = ctypes.CDLL(str(path))
        opened.factored.argtypes = [ctypes.c_void_p] * 4
        opened.solved.argtypes = [ctypes.c_void_p] * 5
        opened.solved.restype = None
    except (OSError, AttributeError) as error:
        path.unlink(missing_ok=True)
        raise Unavailable(f"the library cannot be loaded: {error}") from None
    return opened
