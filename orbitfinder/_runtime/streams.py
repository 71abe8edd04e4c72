"""What shells leave a command with: streams closed, full or without a reader, and a current folder of anybody's."""

from __future__ import annotations

import io
import os
import sys
from typing import Any, TextIO


def opened() -> None:
    """Descriptors 0, 1 and 2 lead somewhere, or the next file to be opened would be taken for these."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest that is free


class _Lenient(io.FileIO):
    """A file of which some errors are forgiven: what could not be written is dropped."""

    def __init__(self, descriptor: int, forgiven: type[OSError], closefd: bool = False) -> None:
        super().__init__(descriptor, "w", closefd=closefd)
        self._forgiven = forgiven

    def write(self, data: Any) -> int:
        """Write, or drop."""
        try:
            return super().write(data)
        except self._forgiven:
            return memoryview(data).nbytes


def _text(raw: io.FileIO, encoding: str, errors: str, line_buffering: bool) -> TextIO:
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding, errors, line_buffering=line_buffering)


def sound() -> None:
    """Give this process, at its start, streams that can be written to.

    A reader of standard output that went away (`| head -1`) wants no more, which changes no result; of
    standard error nothing can be said anyway.
    """
    opened()
    for name, descriptor, forgiven in (("stdout", 1, BrokenPipeError), ("stderr", 2, OSError)):
        old, raw = getattr(sys, name), _Lenient(descriptor, forgiven)
        encoding, errors = (old.encoding, old.errors) if old else ("utf-8", "backslashreplace")
        setattr(sys, name, _text(raw, encoding, errors, name == "stderr" or raw.isatty()))


def aside(descriptor: int = 2) -> TextIO:
    """A stream to where standard error (or output, 1) leads now, however that is captured later."""
    return _text(_Lenient(os.dup(descriptor), OSError, closefd=True), "utf-8", "replace", True)


def abandoned() -> None:
    """Let go of what could not be written to standard output, or Python complains of it once more at the end."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)


def leave_current_folder_out() -> None:
    """Take nothing that lies in the current folder for a part of the program: for commands, at their start.

    `python -m` puts that folder first on the path. What this module imports is loaded before, so it is next to nothing.
    """
    home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    try:
        here = os.getcwd()
    except OSError:  # the folder is gone, and all that was in it
        return
    if sys.path and sys.path[0] in ("", here) and here != home:
        del sys.path[0]
