"""Locks between processes: a file that one holds at a time and that the kernel lets go of when its holder dies."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

from orbitfinder.errors import InputError

LOCK = ".lock"
PATIENCE = 0.02
"""s between two looks at a lock that another process holds"""


@contextlib.contextmanager
def held(path: Path, timeout: float = 0.0) -> Iterator[bool]:
    """True inside the block when this process alone has the lock file, False when `timeout` s did not do.

    The file is made if need be, never followed elsewhere nor emptied, and removed again. Where files cannot be locked
    (some network file systems, Windows) everybody holds it. Raises `OSError` where no file can be made.
    """
    try:
        import fcntl  # noqa: PLC0415 - not on Windows
    except ImportError:
        yield True
        return
    until = time.monotonic() + timeout
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            ours = True
        except BlockingIOError:
            ours = False
        except OSError:
            ours = True  # locking is not supported here
        if not ours and time.monotonic() > until:
            break
        if ours and _is(path, handle):  # and not one that its last holder has removed meanwhile
            break
        os.close(handle)
        time.sleep(0.0 if ours else PATIENCE)
    try:
        yield ours
    finally:
        if ours:
            with contextlib.suppress(OSError):
                path.unlink()
        os.close(handle)


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """A folder (made if need be) to this process alone; `InputError` when another one has it."""
    folder.mkdir(parents=True, exist_ok=True)
    with held(folder / LOCK) as alone:
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
