"""Marches of many segments in one call of compiled code, which holds no lock of Python's.

    kernel(field, effort).marched(starts, parameters)
    varied_kernel(field, integrand, effort).marched(starts, parameters)       of (x, vec Y, S)

Without a compiler, or for a field that is no expression of scalars, there is none.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.sizes import LEAST
from orbitfinder.integrate.compiled import LIMITS, Unavailable, attempted, begin, library, mode, surroundings, worth_it
from orbitfinder.integrate.held import Shared
from orbitfinder.integrate.lanes.emit import field_code, scalars
from orbitfinder.integrate.lanes.factors import SparseSlopes, sparse_slopes
from orbitfinder.integrate.rk8 import directional_field, step_of, variational_field

REMEMBERED = 32
UNROLLED = 12
"""States up to which df/dx times the columns is written out"""
WIDE = 400
"""Numbers of a state and its variations from which on columns fill the registers, and segments march in turn"""
SHORT = 1e-2
"""Of a step that is compared with the interpreter's"""
LEVEL = "-O2"
"""More takes longer for nothing, as vector types say what is to be vectorised; at -O1 gcc leaves the upper halves of
registers dirty when it calls libm, which makes that 20 times slower"""
Written = tuple[str, ca.Function, bool | None]
"""What a `Kernel` is made of"""
_kernels, _written = Kept["Kernel | None"](REMEMBERED), Kept[Written](REMEMBERED)
Marching = Callable[..., int]
SIGNATURE: list[Any] = [ctypes.c_ssize_t, *[ctypes.c_void_p] * 6, ctypes.c_ssize_t, ctypes.c_void_p]


class Kernel:
    """Marches of y' = f(t, y, s, free) by C `code`, `known` being the same in CasADi. Raises `Unavailable`.

    A single segment is marched by code of one lane, in half the time of a register of eight; its bits are the same.
    With many columns, which fill the registers, so is each, and the state beside them by that of many: `only`.
    """

    def __init__(self, code: str, known: ca.Function, only: bool | None, alone: bool) -> None:
        self._code, self._known, self._only = code, known, only
        alone = alone if only is None else only
        self._libraries = {alone: self._made(alone)}

    def marched(
        self, starts: np.ndarray, parameters: np.ndarray, kept: int = 0, begins: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The ends (k x 1 + N) of segments that `starts` (k x 1 + N) begin, and of every step the first `kept` of it.

        `parameters` (M x P) are (h, s, free) of the steps, segment after segment, which have equally many or `begin`
        (k + 1) at these numbers; rows are (t, y).
        """
        ends, path = np.empty(starts.shape), np.empty((len(parameters), kept))
        self._run(starts, parameters, ends, path, begins=begins)
        return ends, path

    def errors(self, starts: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """About what the step from each of `starts` (k x 1 + N) by its `parameters` (k x P) is wrong by (k x N)."""
        errors = np.empty((len(starts), starts.shape[1] - 1))
        self._run(starts, parameters, np.empty(starts.shape), np.empty((len(starts), 0)), errors)
        return errors

    def rates(self, times: np.ndarray, states: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Rates (k x N) at times (k) and states (k x N), by (s, free) of each (k x P) or of all (1 x P).

        Of what has no variations.
        """
        limit.check()
        found = np.empty(states.shape)
        times, states, given = (np.ascontiguousarray(one, float) for one in (times, states, given))
        places = (one.ctypes.data for one in (times, states, given, found))
        self._library(len(states) == 1)["evaluated"](len(states), len(given) == 1, *places)
        return found

    def _run(
        self, starts: np.ndarray, parameters: np.ndarray, *results: np.ndarray, begins: np.ndarray | None = None
    ) -> None:
        limit.check()
        ends, path, *errors = (array.ctypes.data for array in results)
        starts, parameters, count = np.ascontiguousarray(starts), np.ascontiguousarray(parameters), len(starts)
        if begins is None:
            order = np.arange(count + 1, dtype=np.intp)
            begins = order * (len(parameters) // max(1, count))
        else:
            order = np.argsort(-np.diff(begins), kind="stable")  # the longest first: lanes end together
        given = (array.ctypes.data for array in (begins, order, starts, parameters))
        march = self._library(count == 1)["march"]
        if march(count, *given, ends, path, results[1].shape[1], errors[0] if errors else None):
            raise MemoryError(f"no memory for marches of {starts.shape[1]} numbers")

    def _library(self, alone: bool) -> dict[str, Any]:
        """That of one lane or of many; where it cannot be made the other serves."""
        alone = alone if self._only is None else self._only
        if alone not in self._libraries:
            made = attempted(self._known.name(), lambda: self._made(alone))
            self._libraries[alone] = made or self._libraries[not alone]
        return self._libraries[alone]

    def _made(self, alone: bool) -> dict[str, Any]:
        return library(_of_lanes(self._code, alone), self._opened, None, LEVEL)

    def _opened(self, path: Path, new: bool) -> dict[str, Any]:
        """The functions of a library loaded and, when new, compared with the interpreter."""
        opened = Shared(path)
        functions = {"march": opened["march"]}
        functions["march"].argtypes = SIGNATURE
        with contextlib.suppress(AttributeError):  # of what has variations
            functions["evaluated"] = opened["evaluated"]
            functions["evaluated"].argtypes = [ctypes.c_ssize_t, ctypes.c_int, *[ctypes.c_void_p] * 4]
        if new and not _agrees(functions["march"], self._known):
            raise Unavailable("the compiled march disagrees with the interpreted field")
        return functions


def kernel(
    field: ca.Function, effort: float | None, alone: bool = False, inverses: bool = False, *, ahead: bool = False
) -> Kernel | None:
    """The kernel of a field f(t, y, s, free), None where there is none; `alone`: a single segment comes first;
    `inverses` as `emitted` takes them. `ahead`: none yet, a compiler begins with it beside this process."""
    return _kept(effort, lambda: (field, field), alone, inverses, ahead, Same(field))


def varied_kernel(
    field: ca.Function, integrand: ca.Function | None, effort: float | None, alone: bool = False,
    apart: ca.Function | None = None, inverses: bool = False, *, ahead: bool = False,
) -> Kernel | None:  # fmt: skip
    """That of a field of x with its variations and an integral, as `rk8.variational_field` makes it; `apart` is the
    field as `factors.sparse_slopes` takes it."""
    given = Same(field), Same(integrand)
    return _kept(effort, lambda: varied_forms(field, integrand, apart), alone, inverses, ahead, *given)


def varied_forms(
    field: ca.Function, integrand: ca.Function | None, apart: ca.Function | None = None
) -> tuple[ca.Function | SparseSlopes, ca.Function]:
    """A field with its variations as it is emitted, and as one function."""
    flat = scalars(field)
    if flat.size1_in(1) <= UNROLLED:
        whole = variational_field(flat, integrand)
        return whole, whole
    return sparse_slopes(flat, integrand, apart), directional_field(flat, integrand)


def march_code(emitted: ca.Function | SparseSlopes, inverses: bool = False) -> str:
    """The C of a march of what is emitted."""
    heads = f"#define LEAST {LEAST!r}\n" + "#define ABREAST 2\n" * isinstance(emitted, SparseSlopes)
    return heads + field_code(emitted, inverses).join((source("kernel.c"), source("march.c")))


def _kept(
    effort: float | None, forms: Callable[[], tuple[ca.Function | SparseSlopes, ca.Function]], alone: bool,
    inverses: bool, ahead: bool, *key: Same,
) -> Kernel | None:  # fmt: skip
    """The kernel of what is to be emitted and is known. Whether it is worth compiling does not depend on the cache."""

    def written() -> Written:
        emitted, known = forms()
        code = march_code(emitted, inverses)
        worth_it(len(code), effort)
        size, varied = known.size1_in(1), isinstance(emitted, SparseSlopes)
        large = size >= WIDE if varied else key[1:] == () and size * (1 + size) >= WIDE
        return code, known, varied if large else None

    if mode() == "off":
        return None
    whole, name = (*key, inverses, mode(), effort, *surroundings()), key[0].thing.name()
    if not ahead:
        return _kernels(whole, lambda: attempted(name, lambda: Kernel(*_written(whole, written), alone)))

    def code() -> str:
        text, _, only = _written(whole, written)
        return _of_lanes(text, alone if only is None else only)

    begin(code, effort, LEVEL)
    return None


def _of_lanes(code: str, alone: bool) -> str:
    """The C of a single lane or of many."""
    return "#define LANES 1\n" * alone + code


@lru_cache(maxsize=8)
def source(name: str) -> str:
    """The C of a file beside this one."""
    return (files("orbitfinder.integrate.lanes") / name).read_text(encoding="utf-8")


def _agrees(march: Marching, field: ca.Function) -> bool:
    """Whether a step ends where the interpreter says, from a place in each lane."""
    random, step = np.random.default_rng(0), step_of(field)
    starts, numbers = (random.uniform(0.1, 0.9, (5, step.size1_in(k))) for k in (0, 1))
    numbers[:, 0] *= SHORT  # a long one makes much of round-off
    ends, known = np.empty(starts.shape), step.map(5)(starts.T, numbers.T).full().T
    order = np.arange(6, dtype=np.intp)
    given = (array.ctypes.data for array in (order, order, starts, numbers, ends, ends))
    march(5, *given, 0, None)
    size = np.abs(known[np.isfinite(known)]).max(initial=1.0)
    return bool(np.allclose(ends, known, rtol=LIMITS.agreement, atol=LIMITS.agreement * size, equal_nan=True))
