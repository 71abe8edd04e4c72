"""Integration in long double, where round-off of double precision has grown too much: `extended.c` about CasADi's C.

It shares neither method nor precision with CVODES and DOP853. There is none without a C compiler, nor where a long
double is a double (on Windows, on ARM Macs).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.sizes import EPSILON
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.compiled import attempted, casadi_code, library, mode
from orbitfinder.integrate.field import CasadiField
from orbitfinder.integrate.held import Shared

ROUND_OFF = float(np.finfo(np.longdouble).eps)
ALLOWED, FIRST, AT_A_TIME, MOST = 64 * ROUND_OFF, 1 / 64, 64, 100
"""Error of a step, in units; the first step, of the span; steps between two looks at the limit of time, so often"""


class Extended:
    """A CasADi field (t, y) or (t, y, free) compiled in long double."""

    def __init__(self, path: Path) -> None:
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
        units, free = np.ascontiguousarray(units, float), np.zeros(1) if free is None else free
        y = np.asarray(start, np.longdouble) / units
        at = np.array([span[0], first * (span[1] - span[0]), span[1]], np.longdouble)
        for _ in range(MOST):
            limit.check()
            places = (each.ctypes.data for each in (y, at, units, free))
            if self._extrapolated(y.size, *places, ALLOWED, AT_A_TIME):
                raise MemoryError(f"no memory for steps of {y.size} numbers")
            if at[0] == at[2]:
                return np.asarray(y * units)
            if at[0] + at[1] == at[0]:
                break
        raise IntegrationError("the step size becomes too small in long double", time=float(at[0]), state=start)

    def along(self, units: np.ndarray, start: np.ndarray, times: np.ndarray, free: np.ndarray | None) -> np.ndarray:
        """The states (k x n, in doubles) of such a motion at times (k) from its start on."""
        rows = [start]
        for span in pairwise(times):
            rows.append(self.end(units, rows[-1], span, free, 1.0))
        return np.array(rows, float)


def extended(field: CasadiField) -> Extended | None:
    """A field in long double, where that holds more digits than a double and can be compiled."""
    if mode() == "off" or 64 * ROUND_OFF > EPSILON:
        return None
    function = field.dense
    return attempted(function.name(), lambda: library(_code(function), lambda path, new: Extended(path), None))


def in_long_double(field: ca.Function) -> Extended | None:
    """A field of (t, y, s, free) in long double, if that can be had; s and the parameters are its `free`."""
    t, y, *given = field.mx_in()
    ends = np.cumsum([0, *(each.numel() for each in given)]).tolist()
    tail = ca.MX.sym("tail", ends[-1])
    return extended(CasadiField(ca.Function("closing", [t, y, tail], [field(t, y, *ca.vertsplit(tail, ends))])))


def _code(function: ca.Function) -> str:
    name, freed = function.name(), function.numel_in(2) if function.n_in() > 2 else 0
    own = (files("orbitfinder.integrate") / "extended.c").read_text(encoding="utf-8")
    return "\n".join([
        "#include <tgmath.h>", "#define casadi_real long double", casadi_code(function),
        f"#define FIELD {name}", f"#define FIELD_work {name}_work", f"#define FREED {freed}", own,
    ])  # fmt: skip
