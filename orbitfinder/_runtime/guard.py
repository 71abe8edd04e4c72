"""Who watches that a command stops when it is told to: by a signal, or by its limit of time.

CasADi's symbolic work, a factorisation of many digits or somebody's library may be in a long call, in which Python
looks neither at signals nor at deadlines. A thread does: it raises `LimitError` in the main thread at the deadline,
and where that thread has not ended the work a second later, or a second after Ctrl-C, it ends the process.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from typing import TextIO

from orbitfinder._runtime import interrupt, keeping, limit, streams

GRACE, PATIENCE = 1.0, 30.0
"""s that the main thread gets to end its work, and, where it is at something that must not end half-done, at most"""


@contextlib.contextmanager
def guarded(says: bool = True) -> Iterator[None]:
    """Inside the block, in the main thread of a process of ours, deadlines and signals hold whatever it is doing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours, theirs = socket.socketpair()
    theirs.setblocking(False)
    before = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
    alarm = signal.signal(signal.SIGALRM, _ring) if hasattr(signal, "SIGALRM") else None
    out = [streams.aside(1), streams.aside(2)] if says else []
    threading.Thread(target=_watch, args=(ours, out), daemon=True).start()
    try:
        yield
    finally:
        if alarm is not None:
            signal.signal(signal.SIGALRM, alarm)
        signal.set_wakeup_fd(before)
        theirs.close()


def _ring(*_: object) -> None:
    """`LimitError` at the deadline, not where that would leave something half-done."""
    if limit.running and not interrupt.busy:
        limit.running[-1].heard = limit.left() < 0
        limit.check()


def _watch(ours: socket.socket, out: list[TextIO]) -> None:
    """Until the block ends: what signals come, and whether the deadline is past."""
    signals, told, busy = list[int](), 0.0, 0.0
    with ours:
        while True:
            numbers = ours.recv(64) if (ready := bool(select.select([ours], [], [], 0.2)[0])) else b""
            if ready and not numbers:
                return
            now, past = time.monotonic(), limit.running[-1] if limit.running else None
            busy = now if interrupt.busy else busy
            mine = [number for number in numbers if number in interrupt.SIGNALS and interrupt.ours(number)]
            signals, told = signals + mine, now if mine and not signals else told
            if past and now > past.end and not past.heard and hasattr(signal, "pthread_kill"):
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGALRM)
            if signals and now > min(max(told, busy) + GRACE, told + PATIENCE):
                _leave(128 + signals[0], "Interrupted: ", out)
            if past and now > min(max(past.end, busy) + GRACE, past.end + PATIENCE):
                _leave(1, f"Error: {past.sentence}; ", out)


def _leave(code: int, why: str, out: list[TextIO]) -> None:
    """End the process and its children, what is finished kept."""
    for keeper in keeping.under_way[-1:]:
        with contextlib.suppress(Exception):  # the main thread may be at it; the file on the disk is whole
            keeper.flush()
        why += keeper.sentence
    why = why.rstrip(": ;")
    for stream in out[1:]:
        stream.write(f"{why}\n")
        if code == 1 and "--json" in sys.argv:
            out[0].write(json.dumps({"format": "orbitfinder/error", "error": why.removeprefix("Error: ")}) + "\n")
            out[0].flush()
    for child in multiprocessing.active_children():
        child.kill()
    os._exit(code)
