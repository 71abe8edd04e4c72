"""Processes of our own: nothing of the current folder on their path, gone when their parent is.

A spawned Python starts as `python -c`, which puts the current folder first on the path: a struct.py there would be run
in place of the library's own, before any line of ours.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from orbitfinder._runtime import PROCESSORS, guard, interrupt, limit

NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that BLAS libraries read when they are loaded"""
LAST_WORDS = 5.0
"""Seconds that processes get to end by themselves"""


@dataclass(eq=False)
class Hand:
    """A process of ours and our end of the pipe to it."""

    process: BaseProcess
    pipe: Connection

    def tell(self, message: Any) -> None:
        """Send a message; that the process has died is seen when its answer is read."""
        with contextlib.suppress(OSError):
            self.pipe.send(message)

    def answer(self) -> Any:
        """What it sends back; None when it has died."""
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            return None


def ready(hands: Iterable[Hand]) -> list[Hand]:
    """Those that have answered or died, after waiting for any of them."""
    asked = list(hands)
    pipes = wait([hand.pipe for hand in asked])
    return [hand for hand in asked if hand.pipe in pipes]


@contextlib.contextmanager
def children_see(variables: Mapping[str, str]) -> Iterator[None]:
    """Processes started in the block have these environment variables, for as long as they live."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def hired(work: Callable[..., None], *arguments: Any) -> Hand:
    """A spawned process that does `work(pipe, *arguments)`.

    The process leaves Ctrl-C to us, has its BLAS on a single thread, and ends within seconds of us however we end.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_begin, args=(theirs, work, *arguments), daemon=True)
    with children_see(dict.fromkeys((*NAMES, PROCESSORS, "PYTHONSAFEPATH"), "1")):  # nor the current folder on its path
        resource_tracker.ensure_running()  # its start lets Ctrl-C through again, so it comes before that is held back
        try:
            with interrupt.held_back():
                process.start()
        except KeyboardInterrupt:
            process.kill()
            raise
    theirs.close()
    return Hand(process, ours)


def dismissed(hands: Iterable[Hand]) -> None:
    """End processes and see them go, however often Ctrl-C is pressed meanwhile."""
    gone = list(hands)
    with interrupt.held_back():
        for hand in gone:
            hand.process.terminate()
        until = time.monotonic() + LAST_WORDS
        for hand in gone:
            hand.process.join(max(0.0, until - time.monotonic()))
            if hand.process.is_alive():
                hand.process.kill()
                hand.process.join()
            hand.pipe.close()


def alone(module: str, function: str, argument: Any, seconds: float, memory: int) -> Any:
    """function(argument), both JSON, in a process and a folder of its own; None where that takes more (s, bytes).

    The process runs no line of the caller's script, as a spawned process does: what calls this needs no main guard.
    """
    with tempfile.TemporaryDirectory() as folder:
        asked, answer = Path(folder, "asked.json"), Path(folder, "answer.json")
        asked.write_text(json.dumps([sys.path, module, function, argument, memory]), encoding="utf-8")
        line = "import json, sys; asked = json.load(open('asked.json', encoding='utf-8')); sys.path[:] = asked[0]; " \
               "from orbitfinder._runtime.processes import answered; answered(*asked[1:])"  # fmt: skip
        with contextlib.suppress(subprocess.TimeoutExpired):
            subprocess.run(
                [sys.executable, "-I", "-c", line], cwd=folder, timeout=min(seconds, max(limit.left(), 0.0)),
                env={**os.environ, **dict.fromkeys(NAMES, "1")}, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, check=False,
            )  # fmt: skip
        limit.check()
        return json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else None


def answered(module: str, function: str, argument: Any, memory: int) -> None:
    """What the process of `alone` does."""
    work = getattr(importlib.import_module(module), function)
    with contextlib.suppress(ImportError, ValueError, OSError):  # not on Windows, not below what is in use
        import resource  # noqa: PLC0415

        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    text = json.dumps(work(argument))
    Path("written.json").write_text(text, encoding="utf-8")
    Path("written.json").rename("answer.json")  # whole or not at all


def _begin(pipe: Connection, work: Callable[..., None], *arguments: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with guard.guarded(says=False):
        work(pipe, *arguments)


def _end_with_parent() -> None:
    """CasADi lets other threads run while it computes, so this thread sees the parent go at once."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    while os.getppid() == parent.pid and not wait([parent.sentinel], timeout=1.0):
        pass
    with contextlib.suppress(OSError):
        os.kill(os.getpid(), signal.SIGTERM)  # finish a file that is being written
    time.sleep(LAST_WORDS)
    os._exit(128 + signal.SIGTERM)


def trim() -> None:
    """Give freed memory back to the system where the C library (glibc's) keeps it in pieces: 2 MB a thousand starts."""
    with contextlib.suppress(OSError, TypeError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
