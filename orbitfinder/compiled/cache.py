"""Libraries on disk by the hash of what they were made from: found, checked, published, evicted.

An entry is one file, KEY-DIGEST.so: KEY is the hash of code, compiler, flags and CasADi version, DIGEST that of the
file's own bytes. So an entry appears whole or not at all (os.replace), and a truncated or altered one is recognised
before the loader sees it, because loading it could end the process.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

LIMIT = 256 * 1024 * 1024
"""Bytes of libraries kept; the least recently used go first"""
STALE = 3600.0
"""s after which an unfinished file of a process that died is removed"""
PATIENCE = 0.02
"""s between two looks at a lock that another process holds"""


def folder() -> Path:
    """Where libraries are kept: $ORBITFINDER_CACHE/compiled, else the platform's place for caches."""
    chosen = os.environ.get("ORBITFINDER_CACHE", "").strip()
    if chosen:
        return Path(chosen).expanduser() / "compiled"
    if sys.platform == "darwin":
        root = Path("~/Library/Caches").expanduser()
    elif sys.platform == "win32":
        root = Path(os.environ.get("LOCALAPPDATA") or "~/AppData/Local").expanduser()
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return root / "orbitfinder" / "compiled"


def key_of(*parts: str) -> str:
    """The name of what these parts determine: 32 hexadecimal digits of SHA-256."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def digest(content: bytes) -> str:
    """32 hexadecimal digits of the SHA-256 of a file's bytes."""
    return hashlib.sha256(content).hexdigest()[:32]


def find(place: Path, key: str) -> Path | None:
    """A sound entry for this key, marked as used now; damaged ones are removed, foreign ones ignored."""
    for path in sorted(place.glob(f"{key}-*.so")):
        try:
            if not _own(path):
                continue
            if digest(path.read_bytes()) != path.stem.partition("-")[2]:
                path.unlink()
                continue
        except OSError:
            continue
        with contextlib.suppress(OSError):
            os.utime(path)
        return path
    return None


def _own(path: Path) -> bool:
    """Loading a library executes it, so it must be ours (or root's) and nobody else may write it."""
    if not hasattr(os, "getuid"):
        return True
    about = path.stat()
    return about.st_uid in (os.getuid(), 0) and not about.st_mode & 0o022


def publish(made: Path, place: Path, key: str) -> Path:
    """Give a finished library its name, in one step, and make room."""
    path = place / f"{key}-{digest(made.read_bytes())}.so"
    os.replace(made, path)
    evict(place, keep=path)
    return path


def evict(place: Path, keep: Path | None = None, limit: int | None = None) -> None:
    """Remove the least recently used libraries beyond the limit, and what dead processes left unfinished."""
    entries, allowed = [], LIMIT if limit is None else limit
    for path in place.iterdir():
        with contextlib.suppress(OSError):
            about = path.stat()
            if path.name.startswith("making-"):
                if time.time() - about.st_mtime > STALE:
                    _remove(path)
            elif path.suffix == ".so":
                entries.append((about.st_mtime, about.st_size, path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= allowed:
            break
        if path != keep:
            with contextlib.suppress(OSError):
                path.unlink()
                total -= size


def _remove(path: Path) -> None:
    for inner in path.iterdir() if path.is_dir() else ():
        inner.unlink()
    path.rmdir() if path.is_dir() else path.unlink()


@contextlib.contextmanager
def locked(place: Path, key: str, timeout: float) -> Iterator[bool]:
    """One process at a time per key (256 lock files in all): True when held, False when `timeout` s did not do.

    The kernel lets go of the lock when its holder dies. Where files cannot be locked (some network file systems,
    Windows) everybody holds it: the work may then be done twice, and publishing stays atomic.
    """
    try:
        import fcntl
    except ImportError:
        yield True
        return
    with open(place / f"lock-{key[:2]}", "w", encoding="ascii") as handle:
        held, until = False, time.monotonic() + timeout
        while not held:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                held = True
            except BlockingIOError:
                if time.monotonic() > until:
                    break
                time.sleep(PATIENCE)
            except OSError:
                held = True  # locking is not supported here
        yield held
