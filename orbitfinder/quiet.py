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
from collections.abc import Iterator
from dataclasses import dataclass, field

_depth = 0


@dataclass
class Captured:
    """The text printed inside `captured()`; complete once the block has ended."""

    text: str = ""
    parts: list[str] = field(default_factory=list)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(ValueError, OSError, AttributeError):
            stream.flush()


@contextlib.contextmanager
def captured() -> Iterator[Captured]:
    """Send everything printed inside the block to the yielded object instead of the terminal.

    Nested blocks are free: the outermost one holds the text. Process-wide, not for threads.
    """
    global _depth
    result = Captured()
    if _depth:
        yield result
        return
    _flush()
    python_level = io.StringIO()
    with tempfile.TemporaryFile() as sink:
        saved = [os.dup(1), os.dup(2)]
        _depth += 1
        try:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
            with contextlib.redirect_stdout(python_level), contextlib.redirect_stderr(python_level):
                yield result
        finally:
            _depth -= 1
            for descriptor, original in zip((1, 2), saved, strict=True):
                os.dup2(original, descriptor)
                os.close(original)
            sink.seek(0)
            result.text = python_level.getvalue() + sink.read().decode(errors="replace")
