"""CasADi functions as compiled C, cached on disk; the interpreter where that is not possible or not worth it.

    fast = compiled(function)                 # same signature, same numbers to round-off
    with compiling("off"): ...                # or ORBITFINDER_COMPILE=on|off|auto

A compiled function has no derivatives: use it where only its values are wanted, such as inside an integrator that is
given its variational equations. Nothing here raises or prints: what cannot be compiled stays interpreted, and
`statistics()` says why.

Never -ffast-math. `-ffp-contract=off` forbids the fused multiply-add that compilers otherwise form where the
processor has one, so that compiled code rounds as the interpreter does; `-fno-tree-slp-vectorize` too, for gcc makes
one of a difference and a sum that stand side by side (vfmsubadd) whatever it is told of contraction. `-march=native
-O3` puts sums over long
vectors into wide registers, which halves the time of a march and changes no bit of it; what the compiler takes
"native" to mean is part of its identity, so that a cache in a shared home serves every processor its own library.

An entry of the cache is one file, KEY-DIGEST.so: KEY is the hash of code without its numbers (see `held.py`), compiler,
flags and CasADi version, DIGEST that of the file's own bytes. So an entry appears whole or not at all (os.replace), and
a truncated or altered one is recognised before the loader sees it, because loading it could end the process.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import platform
import re
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import casadi as ca
import numpy as np
import platformdirs

from orbitfinder._runtime import locks
from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.quiet import captured
from orbitfinder.errors import InputError
from orbitfinder.integrate.held import apart, holding

MODES = ("on", "off", "auto")


@dataclass(frozen=True)
class CompileLimits:
    """What compiling may take, and what of it is kept."""

    longest_auto: float = 30.0
    """s of compiling beyond which "auto" leaves a function interpreted, whatever the work"""
    largest: int = 16 * 1024 * 1024
    """Bytes of C beyond which nothing is compiled: gcc needs about 1 KB of memory per byte"""
    remembered: int = 32
    """Functions, the latest used, with what became of them: 0.1 MB each of a triple pendulum"""
    agreement: float = 1e-6
    """Relative difference from the interpreter, at one point, beyond which a new library is thrown away"""
    small: int = 256 * 1024
    """Bytes of C up to which -O3 is worth its time: on 560 KB even -O2 takes 2.7 s against 2.1 s by -O1 for nothing"""
    seconds_per_byte: float = 6e-6
    """Time to compile, measured with gcc 12: 40 KB 0.3 s, 61 KB 0.4 s, 116 KB 0.7 s"""
    starting: float = 0.05
    """s to start a compiler and a linker"""
    limit: int = 256 * 1024 * 1024
    """Bytes of libraries kept; the least recently used go first"""
    stale: float = 3600.0
    """s after which an unfinished file of a process that died is removed"""


LIMITS = CompileLimits()


ALWAYS = (
    "-std=c99",
    *(() if sys.platform == "win32" else ("-fPIC",)),
    "-shared",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-tree-slp-vectorize",
)
NATIVE = "-march=native"
ZIG = (sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=undefined")
"""The clang of the extra `compiler`, which by itself adds checks that end the process"""
TIMEOUT = 300.0
"""s after which a compilation is given up"""


class Unavailable(Exception):
    """The function stays interpreted; the message says why. Never reaches the user."""


@dataclass(frozen=True)
class Statistics:
    """What this process did: libraries made, loaded from the cache, functions left interpreted, and the last reason."""

    made: int = 0
    loaded: int = 0
    left: int = 0
    reason: str = ""


_chosen: list[str] = []
_statistics = Statistics()
T = TypeVar("T")
Begun = tuple[subprocess.Popen[str], Path]
"""A compiler at work and the folder that it writes to"""
_begun: dict[tuple[Path, str], Begun] = {}
_known, _libraries = Kept[ca.Function](LIMITS.remembered), Kept[Any](LIMITS.remembered)


def mode() -> str:
    """on, off or auto: the innermost `compiling`, else `set_mode`, else $ORBITFINDER_COMPILE, else auto."""
    if _chosen:
        return _chosen[-1]
    value = os.environ.get("ORBITFINDER_COMPILE", "").strip().lower()
    return _checked(value, "ORBITFINDER_COMPILE") if value else "auto"


def _checked(value: str, field: str = "compile") -> str:
    if value not in MODES:
        raise InputError(f"{field}: unknown mode {value!r}; use on, off or auto (the default)")
    return value


def surroundings() -> tuple[str | None, ...]:
    """What chooses the compiler and the place of the cache: by these what is remembered is told apart."""
    return os.environ.get("CC"), os.environ.get("ORBITFINDER_CACHE")


def set_mode(value: str) -> None:
    """Compile always ("on"), never ("off"), or where the work pays for it ("auto"), in this process."""
    _chosen[:1] = [_checked(value)]


@contextlib.contextmanager
def compiling(value: str) -> Iterator[None]:
    """The mode inside a `with` block."""
    before = list(_chosen)
    _chosen.append(_checked(value))
    try:
        yield
    finally:
        _chosen[:] = before


def statistics() -> Statistics:
    """What has been compiled, loaded and left so far in this process."""
    return _statistics


def _count(made: int = 0, loaded: int = 0, left: int = 0, reason: str = "") -> None:
    global _statistics
    now = _statistics
    _statistics = replace(
        now, made=now.made + made, loaded=now.loaded + loaded, left=now.left + left, reason=reason or now.reason
    )


def available() -> tuple[bool, str]:
    """Whether a C compiler runs, and its first line of `--version` or the reason why not."""
    try:
        return True, find_compiler().identity.splitlines()[0]
    except Unavailable as error:
        return False, str(error)


def compiled(function: ca.Function, *, effort: float | None = None) -> ca.Function:
    """The function as compiled C with the same signature, or the function itself.

    `effort` is about how many seconds of interpreted work are to come; in mode "auto" a function that is not in the
    cache is compiled only if that is longer than compiling takes. None: the caller knows that it is.
    """
    if mode() == "off" or function.class_name() == "External":
        return function
    if mode() != "on" and effort is not None and effort < LIMITS.starting:
        return function
    key = (Same(function), mode(), *surroundings(), mode() == "on" or effort is None or effort)
    return _known(key, lambda: _tried(function, effort))


def _tried(function: ca.Function, effort: float | None) -> ca.Function:
    fast = attempted(
        function.name(),
        lambda: library(casadi_code(function), lambda path, new: _opened(path, function, new), effort),
    )
    return function if fast is None else fast


def attempted(name: str, make: Callable[[], T]) -> T | None:
    """What is made of the function of that name; None, counted among those left, where it cannot be compiled."""
    try:
        with captured():
            return make()
    except (Unavailable, OSError, RuntimeError) as error:
        _count(left=1, reason=f"{name}: {error}")
        return None


def interpreted_seconds(function: ca.Function, calls: float) -> float:
    """About how long so many calls take interpreted: 3 ns per operation, measured on three to ten links."""
    return 3e-9 * calls * float(function.n_instructions())


def with_derivatives(function: ca.Function, *, effort: float | None = None) -> ca.Function:
    """`compiled(function)` whose Jacobian is the interpreted one: CVODES and IDAS will not be built without one."""
    fast = compiled(function, effort=effort)
    if fast is function:
        return function
    inputs = function.mx_in()
    options = {"custom_jacobian": function.jacobian(), "never_inline": True, "jac_penalty": 0}
    return ca.Function(function.name(), inputs, fast.call(inputs), function.name_in(), function.name_out(), options)


def library(code: str, opened: Callable[[Path, bool], T], effort: float | None, level: str = "") -> T:
    """What `opened(path, new)` makes of C as a shared library, from this process, from the disk or made now.

    A file that it cannot load, or of which it raises `Unavailable`, is removed; `level` of optimisation, "" for what
    suits the length. Raises `Unavailable` and `OSError`.
    """
    compiler, (code, numbers) = _leveled(level), apart(code)
    key = _key(code, compiler)

    def holds(path: Path, new: bool) -> T:
        try:
            with holding(path, numbers) as own:
                try:
                    return opened(own, new)
                except (OSError, AttributeError) as error:
                    raise Unavailable(f"the library cannot be loaded: {error}") from None
        except (ValueError, Unavailable) as error:
            path.unlink(missing_ok=True)  # of which a copy may have been opened
            raise Unavailable(str(error)) from None

    entry: T = _libraries((key, numbers.tobytes()), lambda: _fetched(code, holds, effort, compiler, key))
    return entry


def _key(code: str, compiler: Compiler) -> str:
    return key_of(code, compiler.identity, " ".join(flags(len(code), compiler.tuning)), ca.__version__)


def _leveled(level: str) -> Compiler:
    """The compiler, with a level of optimisation or other flags."""
    compiler = find_compiler()
    return replace(compiler, tuning=(*compiler.tuning, *level.split()))


def begin(make_code: Callable[[], str], effort: float | None, level: str = "") -> None:
    """Have a compiler begin beside this process with what `library` is asked for soon, if there is one."""
    if mode() == "off":
        return
    with captured(), contextlib.suppress(Unavailable, OSError, RuntimeError):
        (code, _), compiler, place = apart(make_code()), _leveled(level), usable()
        key = _key(code, compiler)
        worth_it(len(code), effort)
        if (place, key) not in _begun and find_entry(place, key) is None:
            begun = _compiling(compiler, code, place)
            if _begun.setdefault((place, key), begun) is not begun:  # a thread was faster
                _ended(*begun)


@atexit.register
def _abandoned() -> None:
    """End compilers that nobody waited for, and remove what they have written."""
    while _begun:
        _ended(*_begun.popitem()[1])


def _ended(process: subprocess.Popen[str], work: Path) -> None:
    """End a compiler that nobody waits for, and remove what it has written."""
    _kill(process)
    shutil.rmtree(work, ignore_errors=True)


def _fetched(code: str, opened: Callable[[Path, bool], T], effort: float | None, compiler: Compiler, key: str) -> T:
    """The same from the disk or made now."""
    place = usable()
    entry = _loaded(find_entry(place, key), opened)
    if entry is None:
        worth_it(len(code), effort)
        # one process at a time per key (256 locks in all); where files cannot be locked the work may be done twice
        with locks.held(place / f"lock-{key[:2]}", expected_seconds(len(code)) * 10 + 10) as held:
            entry = _loaded(find_entry(place, key), opened)  # another process may have made it meanwhile
            if entry is None:
                if not held:
                    raise Unavailable("another process is compiling the same")
                made = make_library(compiler, code, place, _begun.pop((place, key), None))
                entry = opened(publish(made, place, key), True)
                _count(made=1)
    if begun := _begun.pop((place, key), None):  # another process was faster
        _ended(*begun)
    return entry


def casadi_code(function: ca.Function) -> str:
    """The function in C; `RuntimeError` for what CasADi cannot generate (CVODES, IDAS, IPOPT, Python callbacks).

    Code that calls another library is refused: nothing links the two, and before CasADi 3.8.1 what calls a library by
    its own name calls itself without end.
    """
    generator = ca.CodeGenerator("code.c")
    generator.add(function)
    code = str(generator.dump())
    refused = re.search(r"#error (.*)|#include (?!<math\.h>)(.*)|/\* (External functions) \*/", code)
    if refused:
        raise Unavailable(refused.group(1) or f"its code needs {refused.group(2) or 'another library'}")
    if len(code) > LIMITS.largest:
        raise Unavailable(f"{len(code) / 2**20:.0f} MB of C")
    return code


def worth_it(size: int, effort: float | None) -> None:
    """Raises `Unavailable` where so many bytes of C take longer to compile than `effort` (s) of work would."""
    expected = expected_seconds(size)
    if mode() == "on":
        return
    if expected > LIMITS.longest_auto:
        raise Unavailable(f"compiling would take about {expected:.0f} s")
    if effort is not None and effort < expected:
        raise Unavailable(f"{effort:.2g} s of work, compiling would take about {expected:.2g} s")


def _loaded(path: Path | None, opened: Callable[[Path, bool], T]) -> T | None:
    """A library of the cache; None where there is none that fits."""
    if path is None:
        return None
    try:
        entry = opened(path, False)
    except Unavailable:
        return None
    _count(loaded=1)
    return entry


def _opened(path: Path, function: ca.Function, new: bool) -> ca.Function:
    """A library loaded and, when new, compared with the interpreter at one point."""
    try:
        library = ca.external(function.name(), str(path))
    except RuntimeError as error:
        raise Unavailable(f"the library cannot be loaded: {error}") from None
    if _signature(library) != _signature(function) or (new and not _agrees(library, function)):
        raise Unavailable("the compiled function disagrees with the interpreted one")
    return library


def _signature(function: ca.Function) -> tuple[list[ca.Sparsity], list[ca.Sparsity]]:
    return (
        [function.sparsity_in(k) for k in range(function.n_in())],
        [function.sparsity_out(k) for k in range(function.n_out())],
    )


def _agrees(library: ca.Function, function: ca.Function) -> bool:
    random = np.random.default_rng(0)
    point = [ca.DM(pattern, random.uniform(0.1, 0.9, pattern.nnz())) for pattern in _signature(function)[0]]
    for ours, two in zip(library.call(point), function.call(point), strict=True):
        a, b = ours.full(), two.full()
        size = np.abs(b[np.isfinite(b)]).max(initial=1.0)
        if not np.allclose(a, b, rtol=LIMITS.agreement, atol=LIMITS.agreement * size, equal_nan=True):
            return False
    return True


@dataclass(frozen=True)
class Compiler:
    """A command (with arguments, where $CC has some), what it says of itself, and its flags for this processor."""

    command: tuple[str, ...]
    identity: str
    tuning: tuple[str, ...] = ()


def find_compiler() -> Compiler:
    """The compiler of $CC, else the first of cc, gcc, clang and ZIG. Raises `Unavailable` when none runs."""
    chosen = os.environ.get("CC", "").strip()
    candidates: list[tuple[str, ...]] = [("cc",), ("gcc",), ("clang",)]
    try:
        candidates = [tuple(shlex.split(chosen))] if chosen else candidates
    except ValueError as error:
        raise Unavailable(f"CC: {chosen!r} is not a command ({error}); quote it as a shell does, or unset CC") from None
    if not chosen and find_spec(ZIG[2]):
        candidates.append(ZIG)
    reasons = []
    for command in candidates:
        path = shutil.which(command[0])
        if path is None:
            reasons.append(f"{command[0]} is not on the path")
            continue
        try:
            return Compiler((path, *command[1:]), *_described(path, command[1:], os.stat(path).st_mtime_ns))
        except (Unavailable, OSError) as error:
            reasons.append(f"{command[0]}: {error}")
    raise Unavailable("no C compiler: " + "; ".join(reasons))


@lru_cache(maxsize=8)
def _described(path: str, arguments: tuple[str, ...], _changed: int) -> tuple[str, tuple[str, ...]]:
    """Identity and tuning: what `--version` prints, the machine, and a digest of all that "native" defines here.

    `_changed` keeps a replaced compiler from being taken for the old.
    """
    said = _run([path, *arguments, "--version"], 10.0)
    identity = f"{said.strip()}\n{platform.system()} {platform.machine()} {' '.join(arguments)}"
    try:
        defined = _run([path, *arguments, NATIVE, "-dM", "-E", "-x", "c", os.devnull], 10.0)
    except Unavailable:
        return identity, ()
    return f"{identity} {hashlib.sha256(defined.encode()).hexdigest()[:16]}", (NATIVE,)


def flags(size: int, tuning: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Flags for `size` bytes of C."""
    return ("-O3" if size <= LIMITS.small else "-O1", *ALWAYS, *tuning)


def expected_seconds(size: int) -> float:
    """About how long that many bytes of C take to compile."""
    return LIMITS.starting + LIMITS.seconds_per_byte * size


def _compiling(compiler: Compiler, code: str, folder: Path) -> Begun:
    """A compiler at work in a folder of its own within `folder`. Raises `Unavailable`, leaving nothing behind."""
    work = Path(tempfile.mkdtemp(prefix="making-", dir=folder))
    try:
        source, made = work / "code.c", work / "code.so"
        source.write_text(code, encoding="utf-8")
        options = flags(len(code), compiler.tuning)
        return _process([*compiler.command, *options, str(source), "-o", str(made), "-lm"]), work
    except BaseException as error:
        shutil.rmtree(work, ignore_errors=True)
        if isinstance(error, OSError):
            raise Unavailable(f"cannot write: {error}") from None
        raise


def make_library(compiler: Compiler, code: str, folder: Path, begun: Begun | None = None) -> Path:
    """A shared library in `folder`, under a temporary name. Raises `Unavailable`, leaving nothing behind."""
    process, work = begun or _compiling(compiler, code, folder)
    try:
        _output(process, TIMEOUT)
        made = work / "code.so"
        if not made.is_file():
            raise Unavailable("the compiler reported success and wrote nothing")
        handle, name = tempfile.mkstemp(prefix="making-", suffix=".so", dir=folder)
        os.close(handle)
        os.replace(made, name)
        os.chmod(name, 0o700)
        return Path(name)
    except OSError as error:
        raise Unavailable(f"cannot write: {error}") from None
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _run(command: list[str], timeout: float) -> str:
    """Standard output of a command; `Unavailable` when it fails, cannot start or takes too long."""
    return _output(_process(command), timeout)


def _process(command: list[str]) -> subprocess.Popen[str]:
    try:
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True, text=True, errors="replace",
        )  # fmt: skip
    except OSError as error:
        raise Unavailable(f"cannot start: {error}") from None


def _output(process: subprocess.Popen[str], timeout: float) -> str:
    try:
        output, _ = process.communicate(timeout=timeout)
    except BaseException as error:
        _kill(process)
        if isinstance(error, subprocess.TimeoutExpired):
            raise Unavailable(f"took longer than {timeout:g} s") from None
        raise
    if process.returncode != 0:
        raise Unavailable(f"exit code {process.returncode}: {output.strip()[:500]}")
    return output


def _kill(process: subprocess.Popen[str]) -> None:
    """End a compiler with everything it started: the driver's children do the work."""
    with contextlib.suppress(OSError, AttributeError):
        os.killpg(process.pid, signal.SIGKILL)
    with contextlib.suppress(OSError):
        process.kill()
    process.communicate()


def folder() -> Path:
    """Where libraries are kept: $ORBITFINDER_CACHE/compiled, else the platform's place for caches.

    Raises `OSError` when that is in the home of somebody who has none.
    """
    chosen = os.environ.get("ORBITFINDER_CACHE", "").strip()
    root = Path(chosen) if chosen else platformdirs.user_cache_path("orbitfinder", appauthor=False)
    try:
        if os.environ.get("HOME") == "":
            raise RuntimeError("HOME is empty.")
        return root.expanduser() / "compiled"
    except RuntimeError as error:
        raise OSError(f"{error} Set ORBITFINDER_CACHE to a folder of your own.") from None


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
    import grp  # noqa: PLC0415  Windows has it not
    import pwd  # noqa: PLC0415

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


def find_entry(place: Path, key: str) -> Path | None:
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
    entries, allowed = [], LIMITS.limit if limit is None else limit
    with os.scandir(place) as files:  # a third of the time that paths take
        for file in files:
            with contextlib.suppress(OSError):
                about = file.stat()
                if file.name.startswith("making-"):
                    if time.time() - about.st_mtime > LIMITS.stale:
                        shutil.rmtree(file) if file.is_dir() else os.unlink(file)
                elif file.name.endswith(".so"):
                    entries.append((about.st_mtime, about.st_size, file.name))
    total = sum(size for _, size, _ in entries)
    for _, size, name in sorted(entries):
        if total <= allowed:
            break
        if keep is None or name != keep.name:
            with contextlib.suppress(OSError):
                (place / name).unlink()
                total -= size
