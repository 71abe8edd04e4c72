"""CasADi functions as compiled C, cached on disk; the interpreter where that is not possible or not worth it.

    fast = compiled(function)                 # same signature, same numbers to round-off
    with compiling("off"): ...                # or ORBITFINDER_COMPILE=on|off|auto

A compiled function has no derivatives: use it where only its values are wanted, such as inside an integrator that is
given its variational equations. Nothing here raises or prints: what cannot be compiled stays interpreted, and
`statistics()` says why.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.quiet import captured
from orbitfinder.errors import InputError
from orbitfinder.integrate.compiled import cache
from orbitfinder.integrate.compiled.compiler import (
    STARTING,
    Compiler,
    CompilerError,
    expected_seconds,
    find_compiler,
    flags,
    make_library,
)

MODES = ("on", "off", "auto")
LONGEST_AUTO = 30.0
"""s of compiling beyond which "auto" leaves a function interpreted, whatever the work"""
LARGEST = 16 * 1024 * 1024
"""Bytes of C beyond which nothing is compiled: gcc needs about 1 KB of memory per byte"""
REMEMBERED = 32
"""Functions, the latest used, with what became of them: 0.1 MB each of a triple pendulum"""
AGREEMENT = 1e-6
"""Relative difference from the interpreter, at one point, beyond which a new library is thrown away"""


@dataclass(frozen=True)
class Statistics:
    """What this process did: libraries made, loaded from the cache, functions left interpreted, and the last reason."""

    made: int = 0
    loaded: int = 0
    left: int = 0
    reason: str = ""


class Unavailable(Exception):
    """The function stays interpreted; the message says why."""


_chosen: list[str] = []
_statistics = Statistics()
_known, _libraries = Kept[ca.Function](REMEMBERED), Kept[ca.Function](REMEMBERED)


def mode() -> str:
    """on, off or auto: the innermost `compiling`, else `set_mode`, else $ORBITFINDER_COMPILE, else auto."""
    if _chosen:
        return _chosen[-1]
    value = os.environ.get("ORBITFINDER_COMPILE", "").strip().lower()
    return _checked(value, "ORBITFINDER_COMPILE") if value else "auto"


def _checked(value: str, field: str = "compile") -> str:
    if value not in MODES:
        raise InputError(f"{field}: unknown mode {value!r}; use on, off or auto (the default)")
    return value


def set_mode(value: str) -> None:
    """Compile always ("on"), never ("off"), or where the work pays for it ("auto"), in this process."""
    _chosen[:1] = [_checked(value)]


@contextlib.contextmanager
def compiling(value: str) -> Iterator[None]:
    """The mode inside a `with` block."""
    before = list(_chosen)
    _chosen.append(_checked(value))
    try:
        yield
    finally:
        _chosen[:] = before


def statistics() -> Statistics:
    """What has been compiled, loaded and left so far in this process."""
    return _statistics


def available() -> tuple[bool, str]:
    """Whether a C compiler runs, and its first line of `--version` or the reason why not."""
    try:
        return True, find_compiler().identity.splitlines()[0]
    except CompilerError as error:
        return False, str(error)


def compiled(function: ca.Function, *, effort: float | None = None) -> ca.Function:
    """The function as compiled C with the same signature, or the function itself.

    `effort` is about how many seconds of interpreted work are to come; in mode "auto" a function that is not in the
    cache is compiled only if that is longer than compiling takes. None: the caller knows that it is.
    """
    if mode() == "off":
        return function
    paying = mode() == "on" or effort is None
    if not paying and effort < STARTING:  # type: ignore[operator]
        return function
    surroundings = (os.environ.get("CC"), os.environ.get("ORBITFINDER_CACHE"))
    return _known((Same(function), mode(), *surroundings, paying or effort), lambda: _tried(function, effort))


def _tried(function: ca.Function, effort: float | None) -> ca.Function:
    try:
        with captured():
            return _library(function, effort)
    except (Unavailable, CompilerError, OSError, RuntimeError) as error:
        _count(left=1, reason=f"{function.name()}: {error}")
        return function


def interpreted_seconds(function: ca.Function, calls: float) -> float:
    """About how long so many calls take interpreted: 3 ns per operation, measured on three to ten links."""
    return 3e-9 * calls * float(function.n_instructions())


def with_derivatives(function: ca.Function, *, effort: float | None = None) -> ca.Function:
    """`compiled(function)` whose Jacobian is the interpreted one: CVODES and IDAS will not be built without one."""
    fast = compiled(function, effort=effort)
    if fast is function:
        return function
    inputs = function.mx_in()
    options = {"custom_jacobian": function.jacobian(), "never_inline": True, "jac_penalty": 0}
    return ca.Function(function.name(), inputs, fast.call(inputs), function.name_in(), function.name_out(), options)


def _library(function: ca.Function, effort: float | None) -> ca.Function:
    """The compiled function, from this process, from the disk or made now."""
    code = _code(function)
    compiler = find_compiler()
    key = cache.key_of(code, compiler.identity, " ".join(flags(len(code), compiler.tuning)), ca.__version__)
    return _libraries(key, lambda: _fetched(function, effort, code, compiler, key))


def _fetched(function: ca.Function, effort: float | None, code: str, compiler: Compiler, key: str) -> ca.Function:
    """The compiled function from the disk or made now."""
    place = cache.usable()
    found = _loaded(cache.find(place, key), function)
    if found is None:
        _worth_it(len(code), effort)
        with cache.locked(place, key, expected_seconds(len(code)) * 10 + 10) as held:
            found = _loaded(cache.find(place, key), function)  # another process may have made it meanwhile
            if found is None:
                if not held:
                    raise Unavailable("another process is compiling the same")
                found = _made(cache.publish(make_library(compiler, code, place), place, key), function)
    return found


def _code(function: ca.Function) -> str:
    """The function in C; `RuntimeError` for what CasADi cannot generate (CVODES, IDAS, IPOPT, Python callbacks)."""
    generator = ca.CodeGenerator("code.c")
    generator.add(function)
    code = str(generator.dump())
    refused = re.search(r"#error (.*)|#include (?!<math\.h>)(.*)", code)
    if refused:
        raise Unavailable(refused.group(1) or f"its code needs {refused.group(2)}")
    if len(code) > LARGEST:
        raise Unavailable(f"{len(code) / 2**20:.0f} MB of C")
    return code


def _worth_it(size: int, effort: float | None) -> None:
    expected = expected_seconds(size)
    if mode() == "on":
        return
    if expected > LONGEST_AUTO:
        raise Unavailable(f"compiling would take about {expected:.0f} s")
    if effort is not None and effort < expected:
        raise Unavailable(f"{effort:.2g} s of work, compiling would take about {expected:.2g} s")


def _loaded(path: Any, function: ca.Function) -> ca.Function | None:
    """A library from the disk, None where there is none that fits; what does not is removed."""
    if path is None:
        return None
    try:
        found = ca.external(function.name(), str(path))
    except RuntimeError:
        found = None
    if found is None or not _fits(found, function):
        path.unlink(missing_ok=True)
        return None
    _count(loaded=1)
    return found


def _made(path: Any, function: ca.Function) -> ca.Function:
    """A library made just now, compared with the interpreter at one point."""
    try:
        found = ca.external(function.name(), str(path))
    except RuntimeError as error:
        path.unlink(missing_ok=True)
        raise Unavailable(f"the library cannot be loaded: {error}") from None
    if not (_fits(found, function) and _agrees(found, function)):
        path.unlink(missing_ok=True)
        raise Unavailable("the compiled function disagrees with the interpreted one")
    _count(made=1)
    return found


def _fits(found: ca.Function, function: ca.Function) -> bool:
    same_in = all(found.sparsity_in(k) == function.sparsity_in(k) for k in range(function.n_in()))
    return (
        (found.n_in(), found.n_out()) == (function.n_in(), function.n_out())
        and same_in
        and all(found.sparsity_out(k) == function.sparsity_out(k) for k in range(function.n_out()))
    )


def _agrees(found: ca.Function, function: ca.Function) -> bool:
    random = np.random.default_rng(0)
    point = []
    for k in range(function.n_in()):
        pattern = function.sparsity_in(k)
        point.append(ca.DM(pattern, random.uniform(0.1, 0.9, pattern.nnz())))
    for one, two in zip(found.call(point), function.call(point), strict=True):
        a, b = one.full(), two.full()
        size = np.abs(b[np.isfinite(b)]).max(initial=1.0)
        if not np.allclose(a, b, rtol=AGREEMENT, atol=AGREEMENT * size, equal_nan=True):
            return False
    return True


def _count(made: int = 0, loaded: int = 0, left: int = 0, reason: str = "") -> None:
    global _statistics
    now = _statistics
    _statistics = replace(
        now, made=now.made + made, loaded=now.loaded + loaded, left=now.left + left, reason=reason or now.reason
    )
