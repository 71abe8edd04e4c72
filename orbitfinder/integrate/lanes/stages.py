"""Changes of the stages of collocation in one call of compiled code (see `stages.c`)."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.sizes import LEAST
from orbitfinder.integrate.compiled import LIMITS, attempted, library, mode, surroundings, worth_it
from orbitfinder.integrate.held import Shared
from orbitfinder.integrate.lanes.emit import emitted, scalars
from orbitfinder.integrate.lanes.kernel import LEVEL, source

_stagings = Kept["Staging | None"](LIMITS.remembered)


class Staging:
    """What is collocated with so many points a step, as compiled."""

    def __init__(self, path: Path, numbers: int) -> None:
        opened = Shared(path)
        self._changed, self._valued, self._numbers = opened["changed"], opened["valued"], numbers
        self._changed.argtypes = [ctypes.c_ssize_t, *[ctypes.c_void_p] * 8]
        self._valued.argtypes = [ctypes.c_ssize_t, *[ctypes.c_void_p] * 4]
        self._valued.restype = None

    def valued(self, times: np.ndarray, states: np.ndarray, tails: np.ndarray) -> np.ndarray:
        """The function (k x numbers) at times (k), states (k x d) and (T, s, free) (k x m)."""
        limit.check()
        values = np.empty((len(states), self._numbers))
        given = [np.ascontiguousarray(each, float) for each in (times, states, tails)]
        self._valued(len(states), *(each.ctypes.data for each in (*given, values)))
        return values

    def changed(
        self, nodes: np.ndarray, begins: np.ndarray, steps: np.ndarray, tails: np.ndarray, rule: np.ndarray,
        z: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Changes of stages z (P x m x d) with their derivatives (P x m d x 1 + d + ...), and the integrals (P).

        All are nan where there are none.
        """
        limit.check()
        count, size = len(nodes), nodes.shape[1]
        changes, integrals = np.empty((count, z[0].size, 1 + size + tails.shape[1])), np.empty(count)
        given = [np.ascontiguousarray(each, float) for each in (nodes, begins, steps, tails, rule, z)]
        if self._changed(count, *(each.ctypes.data for each in (*given, changes, integrals))):
            changes.fill(np.nan)
        return changes, integrals


def staging(linear: ca.Function, points: int, forced: bool, added: bool, effort: float | None) -> Staging | None:
    """That of a function (t, x, s, free) as `Collocation` has it; None without a compiler, and of what is no expression
    of scalars."""

    def made() -> Staging:
        (d, unfolding, free), numbers = (linear.size1_in(k) for k in (1, 2, 3)), linear.size1_out(0)
        sizes = {"D": d, "UNFOLDING": unfolding, "FREE": free, "STATE": d, "COLUMNS": d, "POINTS": points,
                 "NUMBERS": numbers, "FORCED": int(forced), "ADDED": int(added), "LEAST": repr(LEAST)}  # fmt: skip
        heads = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
        code = "".join([heads, source("kernel.c"), emitted(scalars(linear), "collocated"), source("stages.c")])
        worth_it(len(code), effort)
        return library(code, lambda path, new: Staging(path, numbers), None, LEVEL)

    if mode() == "off":
        return None
    key: tuple[Any, ...] = (Same(linear), points, forced, mode(), effort, *surroundings())
    return _stagings(key, lambda: attempted(linear.name(), made))
