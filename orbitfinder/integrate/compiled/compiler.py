"""Find the C compiler, say exactly which one it is, and make a shared library of generated code.

Never -ffast-math. `-ffp-contract=off` forbids the fused multiply-add that compilers otherwise form where the
processor has one, so that compiled code rounds as the interpreter does. `-march=native -O3` puts sums over long
vectors into wide registers, which halves the time of a march and changes no bit of it; what the compiler takes
"native" to mean is part of its identity, so that a cache in a shared home serves every processor its own library.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import shlex
import shutil
import signal
import subprocess
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

ALWAYS = ("-std=c99", "-fPIC", "-shared", "-ffp-contract=off")
NATIVE = "-march=native"
SMALL = 256 * 1024
"""Bytes of C up to which -O3 is worth its time: on 560 KB even -O2 takes 2.7 s against 2.1 s by -O1 for nothing"""
SECONDS_PER_BYTE = 6e-6
"""Time to compile, measured with gcc 12: 40 KB 0.3 s, 61 KB 0.4 s, 116 KB 0.7 s"""
STARTING = 0.05
"""s to start a compiler and a linker"""
TIMEOUT = 300.0
"""s after which a compilation is given up"""


class CompilerError(Exception):
    """No library was made; the message says why. Never reaches the user."""


@dataclass(frozen=True)
class Compiler:
    """A command (with arguments, where $CC has some), what it says of itself, and its flags for this processor."""

    command: tuple[str, ...]
    identity: str
    tuning: tuple[str, ...] = ()


def find_compiler() -> Compiler:
    """The compiler of $CC, else the first of cc, gcc, clang. Raises `CompilerError` when none runs."""
    chosen = os.environ.get("CC", "").strip()
    candidates = [tuple(shlex.split(chosen))] if chosen else [("cc",), ("gcc",), ("clang",)]
    reasons = []
    for command in candidates:
        path = shutil.which(command[0])
        if path is None:
            reasons.append(f"{command[0]} is not on the path")
            continue
        try:
            return Compiler((path, *command[1:]), *_described(path, command[1:], os.stat(path).st_mtime_ns))
        except (CompilerError, OSError) as error:
            reasons.append(f"{command[0]}: {error}")
    raise CompilerError("no C compiler: " + "; ".join(reasons))


@lru_cache(maxsize=8)
def _described(path: str, arguments: tuple[str, ...], changed: int) -> tuple[str, tuple[str, ...]]:
    """Identity and tuning: what `--version` prints, the machine, and a digest of all that "native" defines here.

    `changed` keeps a replaced compiler from being taken for the old.
    """
    said = _run([path, *arguments, "--version"], 10.0)
    identity = f"{said.strip()}\n{platform.system()} {platform.machine()} {' '.join(arguments)}"
    try:
        defined = _run([path, *arguments, NATIVE, "-dM", "-E", "-x", "c", os.devnull], 10.0)
    except CompilerError:
        return identity, ()
    return f"{identity} {hashlib.sha256(defined.encode()).hexdigest()[:16]}", (NATIVE,)


def flags(size: int, tuning: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Flags for `size` bytes of C."""
    return ("-O3" if size <= SMALL else "-O1", *ALWAYS, *tuning)


def expected_seconds(size: int) -> float:
    """About how long that many bytes of C take to compile."""
    return STARTING + SECONDS_PER_BYTE * size


def make_library(compiler: Compiler, code: str, folder: Path) -> Path:
    """A shared library in `folder`, under a temporary name. Raises `CompilerError`, leaving nothing behind."""
    work = Path(tempfile.mkdtemp(prefix="making-", dir=folder))
    try:
        source, made = work / "code.c", work / "code.so"
        source.write_text(code, encoding="utf-8")
        _run([*compiler.command, *flags(len(code), compiler.tuning), str(source), "-o", str(made), "-lm"], TIMEOUT)
        if not made.is_file():
            raise CompilerError("the compiler reported success and wrote nothing")
        handle, name = tempfile.mkstemp(prefix="making-", suffix=".so", dir=folder)
        os.close(handle)
        os.replace(made, name)
        os.chmod(name, 0o700)
        return Path(name)
    except OSError as error:
        raise CompilerError(f"cannot write: {error}") from None
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _run(command: list[str], timeout: float) -> str:
    """Standard output of a command; `CompilerError` when it fails, cannot start or takes too long."""
    try:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True, text=True, errors="replace",
        )  # fmt: skip
    except OSError as error:
        raise CompilerError(f"cannot start: {error}") from None
    try:
        output, _ = process.communicate(timeout=timeout)
    except BaseException as error:
        _kill(process)
        if isinstance(error, subprocess.TimeoutExpired):
            raise CompilerError(f"took longer than {timeout:g} s") from None
        raise
    if process.returncode != 0:
        raise CompilerError(f"exit code {process.returncode}: {output.strip()[:500]}")
    return output


def _kill(process: subprocess.Popen[str]) -> None:
    """End a compiler with everything it started: the driver's children do the work."""
    with contextlib.suppress(OSError, AttributeError):
        os.killpg(process.pid, signal.SIGKILL)
    with contextlib.suppress(OSError):
        process.kill()
    process.communicate()
