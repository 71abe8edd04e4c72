"""A time limit for whatever runs inside a block: a deadline, which integrators and solvers look at.

    with limited(60.0):
        find_orbit(problem)          # `LimitError` after a minute

Python code that repeats something calls `check()`. CasADi's long calls are made inside `alarm()`: CVODES and IPOPT
poll for signals, so an alarm at the deadline ends them. Elsewhere than in the main thread, and on Windows, they are
waited for. In commands `guard` sees to what does neither.
"""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass

from orbitfinder.errors import InputError, LimitError


@dataclass
class Deadline:
    """When to stop (on the monotonic clock), how many seconds that were, and what the work has come to."""

    end: float
    seconds: float
    note: str = ""
    heard: bool = False
    """whether the main thread has been told that it is past"""

    @property
    def sentence(self) -> str:
        """That the work was stopped, and how far it had come."""
        return f"stopped after {self.seconds:g} s (limit)" + (f": {self.note}" if self.note else "")


running: list[Deadline] = []
"""Those of the main thread, for `guard`; the last is the earliest"""


_deadline: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


@contextlib.contextmanager
def limited(seconds: float | None, spent: float = 0.0) -> Iterator[None]:
    """A limit of time for a block: `with of.limited(60.0): ...`.

    Args:
        seconds: s; None is no limit, of nested ones the earliest holds.
        spent: how many of them are gone before the block begins.

    Returns:
        A context manager.

    Raises:
        LimitError: once the block has taken so long.

    Examples:
        >>> with of.limited(60.0):
        ...     orbit = of.find_orbit(problem)
    """
    if seconds is not None and not (seconds > 0 and not math.isnan(seconds)):
        raise InputError(f"limit: must be a positive number of seconds, got {seconds}")
    outer, end = _deadline.get(), math.inf if seconds is None else time.monotonic() + seconds - spent
    if seconds is None or not math.isfinite(end) or (outer is not None and outer.end <= end):
        yield
        return
    made = Deadline(end, seconds)
    token, here = _deadline.set(made), threading.current_thread() is threading.main_thread()
    running.extend([made] * here)
    try:
        yield
    finally:
        running[:] = [deadline for deadline in running if deadline is not made]
        _deadline.reset(token)


def left() -> float:
    """Seconds to the deadline; infinite where there is none, negative after it."""
    deadline = _deadline.get()
    return math.inf if deadline is None else deadline.end - time.monotonic()


def note(text: str) -> None:
    """What to say of the work if it is stopped from now on."""
    deadline = _deadline.get()
    if deadline is not None:
        deadline.note = text


def check() -> None:
    """`LimitError` when the deadline is past."""
    deadline = _deadline.get()
    if deadline is not None and time.monotonic() > deadline.end:
        raise LimitError(deadline.sentence)


@contextlib.contextmanager
def alarm() -> Iterator[None]:
    """A block of a single call of CasADi, which the deadline ends; `LimitError` whatever CasADi makes of that."""
    check()
    here = threading.current_thread() is threading.main_thread()  # where alone there are alarms
    free = here and hasattr(signal, "setitimer") and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0  # nobody else's
    ringing = free and math.isfinite(left())
    done = False  # an alarm that rings here must not leave another running, which would end the process
    before = signal.signal(signal.SIGALRM, lambda *_: None if done else check()) if ringing else None
    try:
        try:
            if ringing:
                again = 0.25  # s later: CasADi takes the first alarm for a failed evaluation and tries on
                signal.setitimer(signal.ITIMER_REAL, max(left(), 1e-3), again)
            yield
        finally:
            done = True
    finally:
        if ringing:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
        check()
