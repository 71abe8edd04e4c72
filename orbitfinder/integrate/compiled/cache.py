"""Libraries on disk by the hash of what they were made from: found, checked, published, evicted.

An entry is one file, KEY-DIGEST.so: KEY is the hash of code, compiler, flags and CasADi version, DIGEST that of the
file's own bytes. So an entry appears whole or not at all (os.replace), and a truncated or altered one is recognised
before the loader sees it, because loading it could end the process.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import sys
import time
from pathlib import Path

from orbitfinder._runtime import locks

LIMIT = 256 * 1024 * 1024
"""Bytes of libraries kept; the least recently used go first"""
STALE = 3600.0
"""s after which an unfinished file of a process that died is removed"""


def folder() -> Path:
    """Where libraries are kept: $ORBITFINDER_CACHE/compiled, else the platform's place for caches.

    Raises `OSError` when that is in the home of somebody who has none.
    """
    try:
        return _chosen()
    except RuntimeError as error:
        raise OSError(f"{error} Set ORBITFINDER_CACHE to a folder of your own.") from None


def _chosen() -> Path:
    if os.environ.get("HOME") == "":
        raise RuntimeError("HOME is empty.")
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


def usable() -> Path:
    """The folder for libraries, made if need be and without links. Raises `OSError` when it must not be used.

    Loading a library executes it, so nobody but its user (and root) may be able to put one there, or another folder in
    its place.
    """
    place = folder()
    for part in (*reversed(place.parents), place):
        if not part.is_dir():
            part.mkdir(mode=0o700, exist_ok=True)  # whatever the umask
    place = place.resolve()
    fault = exposed(place)
    if fault:
        raise PermissionError(f"{fault}, so libraries there could be another's")
    return place


def exposed(place: Path) -> str:
    """Why others could change what a path without links leads to, empty when only its user and root can.

    Every folder on the way must be ours or root's, and writable by nobody else; in a sticky one (/tmp) others cannot
    replace what is ours. Once this holds it goes on holding, so no race is left between looking and loading.
    """
    if not hasattr(os, "getuid"):
        return ""
    for part in (place, *place.parents):
        about = part.lstat()
        if not stat.S_ISDIR(about.st_mode) or about.st_uid not in (os.getuid(), 0):
            return f"{part} is not a folder of yours"
        if _writable_by_others(about) and not (about.st_mode & stat.S_ISVTX and part != place):
            return f"{part} may be written by others (chmod go-w)"
    return ""


def _writable_by_others(about: os.stat_result) -> bool:
    """Group members count as others, but for those of a group that has its user's name and no other member."""
    if about.st_mode & stat.S_IWOTH or not about.st_mode & stat.S_IWGRP:
        return bool(about.st_mode & stat.S_IWOTH)
    import grp
    import pwd

    try:
        group, user = grp.getgrgid(about.st_gid), pwd.getpwuid(os.getuid())
    except KeyError:
        return True
    return (group.gr_name, set(group.gr_mem) - {user.pw_name}) != (user.pw_name, set())


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
            content = _read(path)
            if content is None:
                continue
            if digest(content) != path.stem.partition("-")[2]:
                path.unlink()
                continue
        except OSError:
            continue
        with contextlib.suppress(OSError):
            os.utime(path)
        return path
    return None


def _read(path: Path) -> bytes | None:
    """What a file holds; None where it is a link, no file, another's, or may be written by others."""
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
    with open(handle, "rb") as stream:
        about = os.fstat(handle)
        mine = not hasattr(os, "getuid") or (about.st_uid in (os.getuid(), 0) and not about.st_mode & 0o022)
        return stream.read() if mine and stat.S_ISREG(about.st_mode) else None


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


def locked(place: Path, key: str, timeout: float) -> contextlib.AbstractContextManager[bool]:
    """One process at a time per key (256 locks in all): True when held, False when `timeout` s did not do.

    Where files cannot be locked the work may be done twice, and publishing stays atomic.
    """
    return locks.held(place / f"lock-{key[:2]}", timeout)
