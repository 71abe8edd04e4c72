"""Ctrl-C and SIGTERM that cannot get lost: CasADi and import locks swallow KeyboardInterrupt, a note of it stays."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
seen: list[int] = []
"""The signals since `watch()` was entered."""
busy: list[bool] = []
"""Not empty while something is done that must not end half-done"""


def _note(number: int, _: FrameType | None) -> None:
    seen.append(number)
    raise KeyboardInterrupt


@contextlib.contextmanager
def watch() -> Iterator[None]:
    """Inside the block every Ctrl-C and SIGTERM is noted in `seen` and raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is _note:
        yield
        return
    seen.clear()
    with _handled(_note), unheard():
        yield


@contextlib.contextmanager
def unheard() -> Iterator[None]:
    """What a signal raised where nothing can be raised (a destructor, the callback of a weak reference) is not printed.

    Whoever raised it has noted it, and looks at the note.
    """
    before = sys.unraisablehook

    def hook(lost: Any) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt | SystemExit):
            before(lost)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


@contextlib.contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in SIGNALS}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old or signal.SIG_DFL)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """A block that `guard` lets come to its end."""
    busy.append(True)
    try:
        yield
    finally:
        busy.pop()


def ours(number: int) -> bool:
    """Whether a signal is answered here, and neither held back nor taken over by others."""
    return signal.getsignal(number) is _note


def check() -> None:
    """Raise KeyboardInterrupt again if it was swallowed."""
    if seen:
        raise KeyboardInterrupt


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait for the end of the block; processes started in it never see a Ctrl-C.

    The mask is for those processes, which inherit it; in this process it is not enough, because
    other threads may take the signal.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    waiting = []
    with _handled(lambda number, _: waiting.append(number)), undisturbed():
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    for number in waiting:
        signal.raise_signal(number)
