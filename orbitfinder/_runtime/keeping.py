"""What is finished of something long: written as it comes, and once more where the work is stopped.

A command opens `kept(file, save)` around the work, which says `finished(lambda: what there is)` after each result.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from contextvars import Context
from pathlib import Path
from typing import Any

from orbitfinder._runtime import interrupt
from orbitfinder.errors import LimitError

STOPPED = "stopped"
"""Why it ends; and the end of its file's name where a file of an earlier run, which stays, has the name itself"""


class Keeper:
    """One thing in the making, its file, and what is kept of it, in words."""

    def __init__(self, target: Path, write: Callable[[Any, Path], object]) -> None:
        self.fresh, self.write, self.sentence, self.next = not target.exists(), write, "nothing was finished yet", 0.0
        self.target = target if self.fresh else target.with_name(f"{target.stem}-{STOPPED}{target.suffix}")
        self.part: Callable[[], Any] = lambda: None

    def flush(self) -> None:
        """Write what is finished and not written yet, whatever signals come and deadlines pass meanwhile."""
        began = time.monotonic()
        with interrupt.held_back():
            if (made := Context().run(self.part)) is not None:
                self.write(made, self.target)
                self.sentence = f"what is finished is kept in {self.target}"
            self.part = lambda: None
        self.next = time.monotonic() + (time.monotonic() - began) / 0.05  # the share of time that writing may take


under_way: list[Keeper] = []
"""The innermost last"""
last: list[str] = []
"""What was kept of work that was stopped, in words"""


@contextlib.contextmanager
def kept(target: Path, write: Callable[[Any, Path], object]) -> Iterator[None]:
    """Inside the block what `finished` is given is written by `write`; a `LimitError` says where it is."""
    under_way.append(keeper := Keeper(target, write))
    try:
        yield
    except BaseException as error:
        keeper.flush()
        last.append(keeper.sentence)
        if isinstance(error, LimitError):
            raise LimitError(f"{error}; {keeper.sentence}") from error
        raise
    finally:
        under_way.remove(keeper)


def finished(part: Callable[[], Any]) -> None:
    """What there is by now of what is in the making, None for nothing, for the innermost `kept`; made to be written."""
    if under_way:
        under_way[-1].part = part
        if under_way[-1].fresh and time.monotonic() >= under_way[-1].next:
            under_way[-1].flush()
