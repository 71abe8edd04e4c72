"""Integration in long double and in quadruple precision, where round-off of double precision has grown too much:
`extended.c` about CasADi's C.

It shares neither method nor precision with CVODES and DOP853. There is none without a C compiler, nor where a long
double is a double (on Windows, on ARM Macs). Quadruple precision is `twofold.hpp` where C++ can be compiled, three to
four times as fast as _Float128, and needs glibc in either case.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from contextlib import suppress
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.quiet import captured
from orbitfinder._runtime.sizes import EPSILON
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.compiled import Unavailable, attempted, casadi_code, library, mode
from orbitfinder.integrate.field import CasadiField
from orbitfinder.integrate.held import Shared

ROUND_OFF = float(np.finfo(np.longdouble).eps)
ALLOWED, QUADRUPLE, FIRST, AT_A_TIME, MOST = 64 * ROUND_OFF, 1e-26, 1 / 64, 64, 1000
"""Errors of a step, in units; the first step, of the span; steps between two looks at the limit of time, so often"""
BULIRSCH = 2, 4, 6, 8, 12, 16, 24, 32, 48, 64
"""Parts of a step, by which round-off is made no more than ten times as much"""


class Extended:
    """A CasADi field (t, y) or (t, y, free) compiled in long double, or in quadruple precision."""

    def __init__(self, path: Path, allowed: float) -> None:
        self._allowed = allowed
        self._extrapolated = Shared(path)["extrapolated"]
        self._extrapolated.argtypes = [
            ctypes.c_ssize_t, *[ctypes.c_void_p] * 4, ctypes.c_double, ctypes.c_ssize_t
        ]  # fmt: skip

    def end(
        self, units: np.ndarray, start: np.ndarray, span: Sequence[float] | np.ndarray, free: np.ndarray | None,
        first: float = FIRST,
    ) -> np.ndarray:  # fmt: skip
        """Where a motion ends, in long double, that begins at a start (n) over a span, of which the `first` step takes
        a share; components in `units`.

        Raises `IntegrationError` where its steps become too short.
        """
        return np.asarray(self._end(units, start, span, free, first)[0])

    def _end(
        self, units: np.ndarray, start: np.ndarray, span: Sequence[float] | np.ndarray, free: np.ndarray | None,
        first: float,
    ) -> np.ndarray:  # fmt: skip
        """`end` of a start (n, or 2 x n of a sum), as a sum (2 x n) that keeps all digits."""
        units, free = np.ascontiguousarray(units, float), np.zeros(1) if free is None else free
        y = np.zeros((2, units.size), np.longdouble)
        y[: np.ndim(start)] = start
        at = np.array([span[0], first * (span[1] - span[0]), span[1]], np.longdouble)
        for _ in range(MOST):
            limit.check()
            places = (each.ctypes.data for each in (y, at, units, free))
            if self._extrapolated(units.size, *places, self._allowed, AT_A_TIME):
                raise MemoryError(f"no memory for steps of {units.size} numbers")
            if at[0] == at[2]:
                return y
            if at[0] + at[1] == at[0]:
                break
        raise IntegrationError("the step size becomes too small in long double", time=float(at[0]), state=start)

    def along(
        self, units: np.ndarray, start: np.ndarray, times: np.ndarray, free: np.ndarray | None, first: float = 1.0
    ) -> np.ndarray:  # fmt: skip
        """The states of such a motion at times (k) from its start on, as sums (k x 2 x n)."""
        rows = [np.array([start, 0 * start] if np.ndim(start) == 1 else start, np.longdouble)]
        for span in pairwise(times):
            rows.append(self._end(units, rows[-1], span, free, first))
        return np.array(rows)


def extended(field: CasadiField, quadruple: bool = False) -> Extended | None:
    """A field in long double or quadruple precision, where that holds more digits than a double and can be compiled."""
    if mode() == "off" or 64 * ROUND_OFF > EPSILON:
        return None
    function, allowed = field.dense, QUADRUPLE if quadruple else ALLOWED

    def made(real: str, level: str = "") -> Extended:
        code = _code(function, real, range(2, 26, 2) if quadruple else BULIRSCH)
        return library(code, lambda path, new: Extended(path, allowed), None, level)

    if quadruple:
        with suppress(Unavailable, OSError, RuntimeError), captured():
            return made("Twofold", "-xc++ -std=gnu++17")
    return attempted(function.name(), lambda: made("_Float128" if quadruple else "long double"))


def _code(function: ca.Function, real: str, parts: Sequence[int]) -> str:
    """Text in C, of numbers that are the sum of two doubles in C++."""
    name, freed = function.name(), function.numel_in(2) if function.n_in() > 2 else 0
    own = (files("orbitfinder.integrate") / "extended.c").read_text(encoding="utf-8")
    above, below = f"#include <tgmath.h>\n#define casadi_real {real}", ""
    if real == "Twofold":
        header = (files("orbitfinder.integrate") / "twofold.hpp").read_text(encoding="utf-8")
        above, below = f'{header}\nextern "C" {{', "}"
    return "\n".join([
        "#define __STDC_WANT_IEC_60559_TYPES_EXT__", above, casadi_code(function),
        f"#define FIELD {name}", f"#define FIELD_work {name}_work", f"#define FREED {freed}",
        f"#define ROWS {len(parts)}", f"#define SEQUENCE {', '.join(map(str, parts))}", own, below,
    ])  # fmt: skip
