"""Vector fields f(t, y) of CasADi functions on NumPy's memory: one state at a time, many in a call, or along DOP853.

Interpreted until that has taken as long as a compiler would; then CasADi's own C of the field and `dop853.c` are one
library, which shares nothing with the finder's. Its numbers are the interpreter's and SciPy's to the last bit (asked of
every problem that is shipped), so that nothing depends on when, where or whether a compiler runs. What has C of its own
says so by a `CompiledField`.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Self

import casadi as ca
import numpy as np
from scipy.integrate import DOP853, ode

from orbitfinder._runtime import limit
from orbitfinder._runtime.caches import Kept, Same
from orbitfinder.integrate.compiled import (
    attempted,
    begin,
    casadi_code,
    expected_seconds,
    library,
    mode,
    surroundings,
)
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.integrate.held import Shared

VectorField = Callable[[float, np.ndarray], np.ndarray]
TOGETHER, MANY = (64, 1024), 640
"""States whose rates are evaluated in one call of the interpreter, where some are wanted and where more than so many"""
LOOKED_FOR = 0.03
"""s of interpreted work after which a library is looked for: to write the C that names it takes as long"""
REMEMBERED = 64
"""Functions of which is known what they took"""
AT_A_TIME = 256
"""Steps between two looks at the limit of time"""
DONE, WAITING, STIFF, NO_MEMORY = 1, 0, -4, -5
"""What `dop853.c` answers, besides SciPy's codes"""
SPOT_CHECKED, PATIENT = 7, 300
"""Integrations between two whose ends are compared with the interpreter's: an orbit's certificate has eighteen.
Times as many steps as any other integration that of a stiff field may take, whose steps are at the limit of stability:
some microseconds each"""
AGREEMENT = 1e-12
"""Relative difference between compiled and interpreted rates beyond which a library is not believed"""
THIRD = (0.244094488188976377952755905512, 0.733846688281611857341361741547, 0.0220588235294117647058823529412)
"""bhh1 to bhh3 of dop853.f, whose error estimate of third order is the sum of B k less these times k1, k9 and k12"""


class _Standing(ctypes.Structure):
    """The struct of that name in `dop853.c`."""

    _fields_ = [
        *((name, ctypes.c_ssize_t) for name in ("size", "left", "accepted")),
        *((name, ctypes.c_void_p) for name in ("units", "freed", "y", "k")),
        *((name, ctypes.c_double) for name in ("t", "end", "h", "longest", "relative", "absolute")),
        *((name, ctypes.c_ssize_t) for name in ("begun", "rejected", "stiff", "calm", "patient")),
    ]  # fmt: skip


@dataclass(frozen=True)
class Steps:
    """What an integration came to: DOP853's `code`, the time and the state (n) where it ended, and the accepted steps
    from the start on, their moments (k) and states (k x n), where they were asked for."""

    code: int
    time: float
    state: np.ndarray
    moments: np.ndarray
    states: np.ndarray


class Library:
    """A field with its integrator, as compiled."""

    def __init__(self, path: Path) -> None:
        library = Shared(path)
        self._dop853, self._rates = library["dop853"], library["rates"]
        self._stepped, self._strayed = library["stepped"], library["strayed"]
        self._dop853.argtypes = [ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_void_p, ctypes.c_void_p]
        self._rates.argtypes = [*[ctypes.c_ssize_t] * 2, *[ctypes.c_void_p] * 5]
        self._stepped.argtypes = [*[ctypes.c_ssize_t] * 2, *[ctypes.c_void_p] * 6]
        self._strayed.argtypes = [*[ctypes.c_ssize_t] * 3, *[ctypes.c_void_p] * 8]

    def rates(self, times: np.ndarray, states: np.ndarray, units: Any, free: Any) -> np.ndarray:
        """Rates (k x n) at times (k) and states (k x n) in `units`."""
        found = np.empty(states.shape)
        _called(self._rates, states.shape, times, states, units, free, found)
        return found

    def stepped(self, times: np.ndarray, states: np.ndarray, spans: np.ndarray, units: Any, free: Any) -> np.ndarray:
        """Where a step of DOP853 leads from states (k x n) at times (k) by spans (k)."""
        reached = np.empty(states.shape)
        _called(self._stepped, states.shape, times, states, spans, units, free, reached)
        return reached

    def strayed(
        self, times: np.ndarray, states: np.ndarray, slopes: np.ndarray, step: np.ndarray, moments: np.ndarray,
        units: Any, free: Any,
    ) -> np.ndarray:  # fmt: skip
        """How far rates at moments (m), each within a `step`, are off the curve through states and slopes (k x n)."""
        off, step = np.empty(len(moments)), np.ascontiguousarray(step, np.intp)
        _called(self._strayed, (len(moments), *states.shape), times, states, slopes, step, moments, units, free, off)
        return off

    def integrated(
        self, span: tuple[float, float], start: np.ndarray, units: Any, free: Any, tolerances: tuple[float, float],
        longest: float, most: int, noted: bool, patient: bool = False,
    ) -> Steps:  # fmt: skip
        """The steps of DOP853 from a start (n) in `units` over a span, at `most` so many; relative and absolute
        `tolerances`. One that is `patient` goes on where the field is stiff."""
        y, k = np.array(start, float), np.empty(12 * start.size)
        at = _Standing(
            size=y.size, left=most, units=_place(units), freed=_place(free), y=y.ctypes.data, k=k.ctypes.data,
            t=span[0], end=span[1], longest=longest, relative=tolerances[0], absolute=tolerances[1], patient=patient,
        )  # fmt: skip
        moments, states, code = [np.array(span[:noted])], [y.copy()[None][:noted]], WAITING
        while code == WAITING:
            limit.check()
            some, before = (np.empty(AT_A_TIME), np.empty((AT_A_TIME, y.size))), at.accepted
            places = [each.ctypes.data for each in some] if noted else [None, None]
            code = self._dop853(ctypes.byref(at), AT_A_TIME, *places)
            if noted:
                kept = slice(0, at.accepted - before)
                moments.append(some[0][kept])
                states.append(some[1][kept])
        if code == NO_MEMORY:
            raise MemoryError(f"no memory for steps of {y.size} numbers")
        return Steps(code, at.t, y, np.concatenate(moments), np.concatenate(states))


def _called(function: Callable[..., int], sizes: Sequence[int], *arrays: np.ndarray | None) -> None:
    """A function of sizes and arrays, the last of which it fills."""
    limit.check()
    rows = [None if array is None else np.ascontiguousarray(array) for array in arrays]
    if function(*sizes, *map(_place, rows)):
        raise MemoryError(f"no memory for rates of {sizes[-1]} numbers")


def _place(values: np.ndarray | None) -> int | None:
    return None if values is None else values.ctypes.data


class Work:
    """What a field of this name has taken interpreted (s), and its library once that pays for one."""

    def __init__(self, name: str, code: Callable[[], str], spent: float = 0.0) -> None:
        self._name, self._code = name, code
        self.spent, self._next, self.stiff = spent, LOOKED_FOR, False
        self._unasked = 0
        self._library: Library | None = None

    @contextmanager
    def interpreted(self) -> Iterator[None]:
        """Time that is spent on it."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.spent += time.perf_counter() - began

    def asked(self) -> bool:
        """Whether the library is to be compared with the interpreter: the first time, and once in so many."""
        self._unasked -= 1
        if self._unasked >= 0:
            return False
        self._unasked = SPOT_CHECKED
        return True

    def begin(self) -> None:
        """Have a compiler begin with the library, which will be asked for."""
        begin(self._code, self.spent)

    def doubted(self) -> None:
        """Never again by the library, which does not say what the interpreter says."""
        self._library, self._next = None, np.inf

    def library(self) -> Library | None:
        """The library, looked for and made when so much was spent on the function."""
        chosen = mode()
        if chosen == "off":
            return None
        if self._library is None and (self.spent >= self._next or (chosen == "on" and self._next < np.inf)):
            self._next = np.inf
            self._library = attempted(self._name, self._found)
        return self._library

    def _found(self) -> Library:
        code = self._code()
        expected = expected_seconds(len(code))
        if self.spent < expected and mode() == "auto":
            self._next = expected
        return library(code, lambda path, new: Library(path), self.spent)


class _FunctionWork(Work):
    """The same of a CasADi function."""

    def __init__(self, function: ca.Function) -> None:
        self.dense = function
        if not function.sparsity_out(0).is_dense():
            self.dense = ca.Function("dense", (a := function.mx_in()), [ca.densify(function(*a))])
        super().__init__(self.dense.name(), lambda: _code(self.dense))


_works = Kept[_FunctionWork](REMEMBERED)


def _work(function: ca.Function) -> _FunctionWork:
    return _works((Same(function), *surroundings()), lambda: _FunctionWork(function))


def expect(function: ca.Function | Bound, effort: float | None, stiff: bool = False) -> Work:
    """So many seconds of work with a field are to come, None for more than compiling it takes; of one that is `stiff`
    at the limit of stability."""
    work = _work(function.function if isinstance(function, Bound) else function)
    work.spent = max(work.spent, np.inf if effort is None else effort)
    work.stiff = work.stiff or stiff
    return work


def _code(function: ca.Function) -> str:
    """A field of (t, y) or (t, y, free) in CasADi's C, and DOP853 about it."""
    name = function.name()
    # under another name, for it may be that of a function in `dop853.c`
    code = "\n".join([f"#define {name} evaluated", casadi_code(function), f"#undef {name}"])
    return with_dop853(code, f"{name}_work", function.n_in() > 2)


def with_dop853(code: str, work: str = "evaluated_work", freed: bool = False) -> str:
    """C of a field, which is `evaluated` there with as much `work` as this function says, and DOP853 about it."""
    facts = {"FIELD": "evaluated", "FIELD_work": work, "FREED": int(freed), **_rules()}
    lines = [f"#define {fact} {value}" for fact, value in facts.items()]
    tables = {"A": DOP853.A, "B": DOP853.B, "WITHIN": DOP853.C, "FIFTH": DOP853.E5, "THIRD": np.array(THIRD)}
    lines += [as_table(constant, table) for constant, table in tables.items()]
    own = (files("orbitfinder.integrate") / "dop853.c").read_text(encoding="utf-8")
    return "\n".join([code, *lines, own])


def as_table(name: str, table: np.ndarray) -> str:
    """Numbers, in a row or several, in C."""
    sizes = "".join(f"[{size}]" for size in table.shape)
    rows = ["{" + ", ".join(float(x).hex() for x in row) + "}" for row in np.atleast_2d(table)]
    whole = rows[0] if table.ndim == 1 else "{" + ", ".join(rows) + "}"
    return f"static const double {name}{sizes} = {whole};"


@lru_cache(maxsize=1)
def _rules() -> dict[str, str]:
    """Where SciPy since 1.17 is not dop853.f (see `dop853.c`): asked of it by how often it evaluates a pendulum."""
    asked = []

    def pendulum(t: float, y: np.ndarray) -> np.ndarray:
        asked.append(t)
        return np.array([y[1], -np.sin(y[0])])

    solver = ode(pendulum).set_integrator("dop853", rtol=1e-6, atol=1e-6).set_initial_value([1.0, 0.3])
    solver.integrate(10.0)
    fresh = len(asked) > 225  # 262 since 1.17, 191 before
    return {"REFUSED": "most_cut" if fresh else "fmin", "ROUND_OFF": "2.220446049250313e-16" if fresh else "2.3e-16"}


@dataclass(frozen=True, eq=False)
class Bound:
    """A CasADi function whose last argument, the values (k) of parameters, is given."""

    function: ca.Function
    values: np.ndarray

    def __call__(self, *arguments: Any) -> Any:
        """What it is of the others."""
        return self.function(*arguments, self.values)

    def numel_in(self, k: int) -> int:
        """Numbers in one of its arguments."""
        return int(self.function.numel_in(k))


class CompiledField:
    """f(t, y u) / u of a field f in units u (n, or none), by a library when that is made.

    `free` is read whenever f is. The same object must not be called by two threads at once.
    """

    together = True
    """whether rates of many states come from one call"""
    agreement = AGREEMENT
    """relative difference between compiled and other rates beyond which a library is not believed"""

    def __init__(self, work: Work, free: np.ndarray | None = None, units: np.ndarray | None = None) -> None:
        self._work, self.free, self._units = work, free, units
        self._scaled: tuple[bytes, Self] | None = None

    @property
    def rate(self) -> VectorField:
        """The same without a look-up of it and without a library, for what calls it often."""
        raise NotImplementedError

    def within(self, units: np.ndarray) -> Self:
        """The same in units (n)."""
        raise NotImplementedError

    def __call__(self, t: float, y: np.ndarray) -> np.ndarray:
        """The rate (n) at a time and a state (n)."""
        return self.rate(t, y)

    @property
    def stiff(self) -> bool:
        """Whether it has been integrated at the limit of stability."""
        return self._work.stiff

    def begin(self) -> None:
        """Have a compiler begin with what it is compiled to."""
        self._work.begin()

    def library(self) -> Library | None:
        """What it is compiled to, if it is."""
        return self._work.library()

    def scaled(self, units: np.ndarray) -> Self:
        """The same in units (n), as long as they are those of the last time."""
        assert self._units is None
        units = np.ascontiguousarray(units, float)
        if self._scaled is None or self._scaled[0] != units.tobytes():
            self._scaled = units.tobytes(), self.within(units.copy())
        return self._scaled[1]

    def many(self, times: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Rates (k x n) at times (k) and states (k x n)."""
        fast = self.library()
        if fast is not None:
            return fast.rates(times, states, self._units, self.free)
        with self._work.interpreted():
            return self._many(times, states)

    def stepped(self, times: np.ndarray, states: np.ndarray, spans: np.ndarray) -> np.ndarray | None:
        """Where a step of DOP853 leads from states (k x n) at times (k) by spans (k); None without a library."""
        fast = self.library()
        return None if fast is None else fast.stepped(times, states, spans, self._units, self.free)

    def strayed(
        self, times: np.ndarray, states: np.ndarray, slopes: np.ndarray, step: np.ndarray, moments: np.ndarray
    ) -> np.ndarray | None:
        """What `Library.strayed` says; None without a library."""
        fast = self.library()
        return None if fast is None else fast.strayed(times, states, slopes, step, moments, self._units, self.free)

    def _many(self, times: np.ndarray, states: np.ndarray) -> np.ndarray:
        return np.array([self.rate(t, y) for t, y in zip(times, states, strict=True)])

    def integrated(
        self, span: tuple[float, float], start: np.ndarray, tolerances: tuple[float, float], longest: float,
        most: int, noted: bool, interpreted: Callable[[], Steps],
    ) -> Steps:  # fmt: skip
        """The steps of DOP853 from a start (n) over a span, `interpreted` where there is no library.

        A field that is too stiff for it is integrated at the limit of stability, by a library alone.
        """
        fast, given, steps = self.library(), (tolerances, longest, most, noted), None
        if fast is not None:
            steps = (self._patient(fast, span, start, *given) if self._work.stiff else
                     fast.integrated(span, start, self._units, self.free, *given))  # fmt: skip
            if self._work.asked() and not self._agrees(
                fast, np.array([span[0], steps.time]), np.array([start, steps.state])
            ):
                self._work.doubted()
                steps = None
        if steps is None:
            with self._work.interpreted():
                steps = interpreted()
        if steps.code != STIFF:
            return steps
        self._work.spent, self._work.stiff = np.inf, True
        fast = self.library()
        return steps if fast is None else self._patient(fast, span, start, *given)

    def _patient(self, fast: Library, span: tuple[float, float], *given: Any) -> Steps:
        start, tolerances, longest, most, noted = given
        most *= PATIENT
        return fast.integrated(span, start, self._units, self.free, tolerances, longest, most, noted, True)

    def _agrees(self, fast: Library, times: np.ndarray, states: np.ndarray) -> bool:
        """Whether the library's rates are the interpreter's."""
        rows = fast.rates(times, states, self._units, self.free)
        own = CompiledField._many(self, times, states)
        known = np.isfinite(sizes := np.abs(own).max(axis=1))
        return bool(np.all(np.abs(rows - own).max(axis=1)[known] <= self.agreement * sizes[known]))


class CasadiField(CompiledField):
    """The same of a CasADi function f of (t, x), or of (t, x, free)."""

    def __init__(self, function: ca.Function, free: np.ndarray | None = None, units: np.ndarray | None = None) -> None:
        self._function, self.dense = function, (work := _work(function)).dense
        super().__init__(work, free, units)
        self._mapped: dict[int, Buffered] = {}

    @cached_property
    def rate(self) -> VectorField:
        """The same without a look-up of it, for what calls it often."""
        dense, size, units = self.dense, self._function.size1_in(1), self._units
        time, state, rate = np.zeros(1), np.zeros(size), np.zeros(self._function.size1_out(0))
        buffer, evaluate = dense.buffer()
        buffer.set_arg(0, time.data)
        buffer.set_arg(1, state.data)
        if self.free is not None:
            buffer.set_arg(2, self.free.data)
        buffer.set_res(0, rate.data)

        def call(t: float, y: np.ndarray) -> np.ndarray:
            time[0] = t
            state[:] = y
            evaluate()
            return rate.copy()

        def measured(t: float, y: np.ndarray) -> np.ndarray:
            time[0] = t
            np.multiply(y, units, state)  # type: ignore[arg-type]
            evaluate()
            return np.asarray(rate / units)

        found: Any = call if units is None else measured
        found.evaluated = dense, buffer  # or both are freed under the evaluation
        evaluating: VectorField = found
        return evaluating

    def within(self, units: np.ndarray) -> CasadiField:
        """The same in units (n)."""
        return CasadiField(self._function, self.free, units)

    def _many(self, times: np.ndarray, states: np.ndarray) -> np.ndarray:
        if len(times) == 1:
            return self.rate(times[0], states[0])[None]
        size = TOGETHER[len(times) > MANY]
        dense = self.dense
        if size not in self._mapped:
            self._mapped[size] = Buffered(dense.map(size))
        given = [] if self.free is None else [self.free]
        rates = np.empty((len(times), dense.size1_out(0)))
        for k in range(0, len(times), size):
            block = slice(k, k + size)
            clock, some = times[block, None], states[block]
            if self._units is not None:
                some = some * self._units
            if len(some) < size:  # the last block is filled with the last state
                clock, some = (
                    np.concatenate([rows, np.repeat(rows[-1:], size - len(some), 0)]) for rows in (clock, some)
                )
            rates[block] = self._mapped[size](clock, some, *given)[0][: len(times) - k]
        return rates if self._units is None else rates / self._units


def vector_field(function: ca.Function | Bound, free: np.ndarray | None = None) -> CasadiField:
    """The `CasadiField` of a CasADi function of (t, y), or of (t, y, free)."""
    if isinstance(function, Bound):
        return CasadiField(function.function, np.ascontiguousarray(function.values, float))
    return CasadiField(function, free)


def scaled(field: VectorField, units: np.ndarray) -> VectorField:
    """The field of y / units, so that one tolerance is right for components of all sizes."""
    if isinstance(field, CompiledField):
        return field.scaled(units)

    def call(t: float, y: np.ndarray) -> np.ndarray:
        return np.asarray(field(t, y * units) / units)

    rates, together = rates_of(field)
    call.many = lambda times, states: rates(times, states * units) / units  # type: ignore[attr-defined]
    call.together = together  # type: ignore[attr-defined]
    return call


def rates_of(field: VectorField) -> tuple[Callable[[np.ndarray, np.ndarray], np.ndarray], bool]:
    """Rates of rows of states, and whether they come from one call."""
    if (many := getattr(field, "many", None)) is not None:
        return many, getattr(field, "together", True)
    return lambda times, states: np.stack([field(float(t), y) for t, y in zip(times, states, strict=True)]), False
