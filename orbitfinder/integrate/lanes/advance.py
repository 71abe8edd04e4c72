"""Blocks of points of a family in one call of compiled code (see `advance.c`)."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.caches import Kept, Same
from orbitfinder.integrate.compiled import LIMITS, attempted, library, mode, surroundings, worth_it
from orbitfinder.integrate.held import Shared
from orbitfinder.integrate.lanes.emit import emitted, scalars
from orbitfinder.integrate.lanes.kernel import LEVEL, march_code, source, varied_forms

SIZES = ("segments", "steps", "closing", "phase", "images", "forced", "first_order")
ARRAYS = ("mesh", "first", "last", "aimed", "maps", "lengths", "angular", "values", "units")
NUMBERS = (
    "ready", "floor", "contraction", "stall", "iterations", "sharpest", "stretch", "longest", "prediction",
    "stale", "allowed", "spare", "sampled", "steepest", "least_share", "still", "unfelt", "stepped",
)  # fmt: skip


class _Frame(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_ssize_t) for name in SIZES), *((name, ctypes.c_void_p) for name in ARRAYS),
        *((name, ctypes.c_double) for name in NUMBERS),
    ]  # fmt: skip


class Frame:
    """What does not change from point to point: sizes, arrays and numbers by the names of `advance.c`."""

    def __init__(self, **given: Any) -> None:
        self._kept = {name: np.ascontiguousarray(given[name], float) for name in ARRAYS}
        arrays = {name: value.ctypes.data for name, value in self._kept.items()}
        self.raw = _Frame(**{name: given[name] for name in (*SIZES, *NUMBERS)}, **arrays)


class Advance:
    """The blocks of one field, as compiled."""

    def __init__(self, path: Path) -> None:
        self._advance = Shared(path)["advance"]
        self._advance.argtypes = [ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
        self._advance.restype = ctypes.c_ssize_t

    def __call__(self, frame: Frame, standing: list[np.ndarray], passage: list[np.ndarray], known: bool = False) -> int:
        """The points made after the first row of `standing`, whose arrays have a row more than those of `passage`.

        Of `known` ones w, tangent and where they are marched are in the arrays already.
        """
        limit.check()
        pointers = ((ctypes.c_void_p * len(rows))(*(row.ctypes.data for row in rows)) for rows in (standing, passage))
        count: int = self._advance(ctypes.byref(frame.raw), len(passage[0]), known, *pointers)
        return count


_advances = Kept["Advance | None"](LIMITS.remembered)


def advance_of(
    field: ca.Function, integrand: ca.Function | None, conditions: ca.Function, effort: float | None
) -> Advance | None:
    """The blocks of a field f(t, x, s, free) with its variations; `conditions(x, T, free)` gives values and slopes.

    None without a compiler, and of what is no expression of scalars.
    """

    def made() -> Advance:
        sizes = {"D": field.size1_in(1), "CONDITIONS": conditions.size1_out(0)}
        heads = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
        bodies = march_code(varied_forms(field, integrand)[0]), emitted(scalars(field), "flow")
        code = "".join(
            [heads, *bodies, emitted(scalars(conditions), "conditions"), *map(source, ("pivots.c", "advance.c"))]
        )
        worth_it(len(code), effort)
        return library(code, lambda path, new: Advance(path), None, LEVEL)

    if mode() == "off":
        return None
    key = (Same(field), Same(integrand), Same(conditions), mode(), effort, *surroundings())
    return _advances(key, lambda: attempted(field.name(), made))
