"""Capture what CasADi, IPOPT and SUNDIALS print, at the level of file descriptors.

C and C++ code writes to descriptors 1 and 2 directly, so redirecting `sys.stdout` is not enough;
CasADi's Python layer writes through `sys.stdout`, so redirecting the descriptors is not either.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

from orbitfinder._runtime import streams

_one_at_a_time = threading.RLock()
_under_way: list[bool] = []


@dataclass
class Captured:
    """The text printed inside `captured()`; complete once the block has ended."""

    text: str = ""
    parts: list[str] = field(default_factory=list)


class _Stream(io.TextIOBase):
    """Keeps what its own thread prints together, and what others print for the stream that it stands in for."""

    def __init__(self, kept: list[str]) -> None:
        self._kept, self._thread, self.foreign = kept, threading.get_ident(), list[str]()

    def writable(self) -> bool:
        """Yes."""
        return True

    def write(self, text: str) -> int:
        """Keep a text."""
        (self._kept if threading.get_ident() == self._thread else self.foreign).append(text)
        return len(text)


@contextlib.contextmanager
def captured() -> Iterator[Captured]:
    """Send everything printed inside the block to the yielded object instead of the terminal.

    Nested blocks are free: the outermost holds the text. The descriptors belong to the process, so threads take
    turns; what others print meanwhile through sys.stdout and sys.stderr appears after the block.
    """
    with _one_at_a_time:
        if _under_way:
            yield Captured()
            return
        _under_way.append(True)
        try:
            with _redirected() as result:
                yield result
        finally:
            _under_way.clear()


@contextlib.contextmanager
def _redirected() -> Iterator[Captured]:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(ValueError, OSError, AttributeError):
            stream.flush()
    result = Captured()
    streams.opened()
    stdout, stderr = _Stream(result.parts), _Stream(result.parts)
    with tempfile.TemporaryFile() as sink:
        saved = [os.dup(1), os.dup(2)]
        try:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
            with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
                yield result
        finally:
            for descriptor, original in zip((1, 2), saved, strict=True):
                os.dup2(original, descriptor)
                os.close(original)
            sink.seek(0)
            result.text = "".join(result.parts) + sink.read().decode(errors="replace")
            for own, stream in ((stdout, sys.stdout), (stderr, sys.stderr)):
                if own.foreign and stream is not None:
                    stream.write("".join(own.foreign))
