"""Locks between processes: a file that a process holds alone and that the kernel lets go of when it dies."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from orbitfinder.errors import InputError

if sys.platform == "win32":
    import msvcrt

    def _take(handle: int) -> None:
        """The lock, or `BlockingIOError`."""
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError from error
else:
    import fcntl

    def _take(handle: int) -> None:
        """The lock, or `BlockingIOError`."""
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
PATIENCE = 0.02
"""s between two looks at a lock that another process holds"""


@contextlib.contextmanager
def held(path: Path, timeout: float = 0.0) -> Iterator[bool]:
    """True inside the block when this process alone has the lock file, False when `timeout` s did not do.

    The file is made if need be, never followed elsewhere nor emptied, and removed again. Where files cannot be locked
    (some network file systems) everybody holds it. Raises `OSError` where no file can be made.
    """
    until = time.monotonic() + timeout
    while True:
        handle = os.open(path, FLAGS, 0o600)
        try:
            _take(handle)
            ours = True
        except BlockingIOError:
            ours = False
        except OSError:
            ours = True  # locking is not supported here
        if not ours and time.monotonic() > until:
            break
        if ours and (sys.platform == "win32" or _is(path, handle)):  # and not a file that its last holder has removed
            break
        os.close(handle)
        time.sleep(0.0 if ours else PATIENCE)
    try:
        yield ours
    finally:
        if sys.platform == "win32":  # where an open file cannot be removed, by us or by those who wait for it
            os.close(handle)
        if ours:
            with contextlib.suppress(OSError):
                path.unlink()
        if sys.platform != "win32":
            os.close(handle)


@contextlib.contextmanager
def alone_in(folder: Path | None) -> Iterator[None]:
    """A folder (made if need be; None: none) to this process alone; `InputError` when another process has it."""
    if folder is None:
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    with held(folder / ".lock") as alone:
        if not alone:
            raise InputError(
                f"{folder}: another process is writing there; wait for it to end, or choose another folder"
            )
        yield


def _is(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(handle))
    except OSError:
        return False
