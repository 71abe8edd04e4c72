"""Marches of many segments in one call of compiled code, which holds no lock of Python's.

    kernel(field, count, effort).marched(starts, steps)

Without a compiler, or for a field that is no expression of scalars, there is none.
"""

from __future__ import annotations

import ctypes
import os
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.quiet import captured
from orbitfinder.integrate.compiled import LIMITS, Unavailable, library, mode
from orbitfinder.integrate.lanes.emit import Unknown, emitted, stepped
from orbitfinder.integrate.rk8 import step_of

FEW = 2
"""So many segments are marched one at a time, by code of one lane: a register of eight costs three times that"""
REMEMBERED = 32
SHORT = 1e-2
"""Of a step that is compared with the interpreter's"""
_kernels = Kept["Kernel | None"](REMEMBERED)


class Kernel:
    """Marches of one field of y (N) with tail (P - 1), as compiled."""

    def __init__(self, path: Path, size: int) -> None:
        self.rows = 1 + size
        self._march = ctypes.CDLL(str(path)).march
        self._march.argtypes = [*[ctypes.c_ssize_t] * 2, *[ctypes.c_void_p] * 4, ctypes.c_ssize_t]
        self._march.restype = None

    def marched(self, starts: np.ndarray, parameters: np.ndarray, kept: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """The ends (k x 1 + N) of segments that `starts` (k x 1 + N) begin, and of every step the first `kept` of it.

        `parameters` (M x P) are (h, tail) of the steps, segment after segment; rows are (t, y).
        """
        limit.check()
        starts, parameters = np.ascontiguousarray(starts), np.ascontiguousarray(parameters)
        ends, path = np.empty(starts.shape), np.empty((len(parameters), kept))
        given = (one.ctypes.data for one in (starts, parameters, ends, path))
        self._march(len(starts), len(parameters) // len(starts), *given, kept)
        return ends, path


def kernel(field: ca.Function, count: int, effort: float | None) -> Kernel | None:
    """The kernel of a field f(t, y, s, free) for marches of so many segments; None where there is none."""
    if mode() == "off":
        return None
    key = (Same(field), count > FEW, mode(), os.environ.get("CC"), os.environ.get("ORBITFINDER_CACHE"))
    return _kernels(key, lambda: _made(field, count > FEW, effort))


def _made(field: ca.Function, wide: bool, effort: float | None) -> Kernel | None:
    try:
        with captured():
            return library(_code(field, wide), lambda path, new: _opened(path, field, new), effort)
    except (Unknown, Unavailable, OSError, RuntimeError):
        return None


def _code(field: ca.Function, wide: bool) -> str:
    sizes = {
        "SIZE": field.size1_out(0), "UNFOLDING": field.size1_in(2), "TAIL": field.size1_in(2) + field.size1_in(3),
    } | ({} if wide else {"LANES": 1})  # fmt: skip
    heads = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
    return "".join([heads, source("kernel.c"), source("march.c"), emitted(field, "rates"), stepped(field.size1_out(0))])


@lru_cache(maxsize=8)
def source(name: str) -> str:
    """The C of a file beside this one."""
    return (files("orbitfinder.integrate.lanes") / name).read_text(encoding="utf-8")


def _opened(path: Path, field: ca.Function, new: bool) -> Kernel:
    """A library loaded and, when new, compared with the interpreter."""
    try:
        found = Kernel(path, field.size1_out(0))
    except (OSError, AttributeError) as error:
        path.unlink(missing_ok=True)
        raise Unavailable(f"the library cannot be loaded: {error}") from None
    if new and not _agrees(found, field):
        path.unlink(missing_ok=True)
        raise Unavailable("the compiled march disagrees with the interpreted field")
    return found


def _agrees(found: Kernel, field: ca.Function) -> bool:
    """Whether a step ends where the interpreter says, from a place in each lane."""
    random, step = np.random.default_rng(0), step_of(field)
    starts, numbers = (random.uniform(0.1, 0.9, (5, step.size1_in(k))) for k in (0, 1))
    numbers[:, 0] *= SHORT  # a long one makes much of round-off
    ends, known = found.marched(starts, numbers)[0], step.map(5)(starts.T, numbers.T).full().T
    size = np.abs(known[np.isfinite(known)]).max(initial=1.0)
    return bool(np.allclose(ends, known, rtol=LIMITS.agreement, atol=LIMITS.agreement * size, equal_nan=True))
