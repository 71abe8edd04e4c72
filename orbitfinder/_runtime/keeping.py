"""What is finished of something long: written as it comes, and once more where the work is stopped.

A command opens `kept(file, save)` around the work, which says `finished(lambda: what there is)` after each result.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from orbitfinder._runtime import interrupt, limit
from orbitfinder.errors import LimitError

SHARE = 0.05
"""Of the time that passes, at most, goes into writing what comes"""
STOPPED = "stopped"
"""Why it ends; and the end of its file's name where a file of an earlier run, which stays, has the name itself"""


class Keeper:
    """One thing in the making, its file, how that is written, and how long it took last."""

    def __init__(self, target: Path, write: Callable[[Any, Path], object]) -> None:
        self.write, self.fresh = write, not target.exists()
        self.target = target if self.fresh else target.with_name(f"{target.stem}-{STOPPED}{target.suffix}")
        self.part: Callable[[], Any] | None = None
        self.next, self.written = 0.0, False

    def flush(self) -> None:
        """Write what is finished and not written yet, whatever signals come and deadlines pass meanwhile."""
        with interrupt.held_back(), limit.lifted():
            began = time.monotonic()
            if self.part is not None and (made := self.part()) is not None:
                self.write(made, self.target)
                self.written = True
            self.part = None
            self.next = time.monotonic() + (time.monotonic() - began) / SHARE

    @property
    def sentence(self) -> str:
        """What is kept, in words."""
        return f"what is finished is kept in {self.target}" if self.written else "nothing was finished yet"


open_now: list[Keeper] = []
"""Those whose work is under way, the innermost last"""
last: list[str] = []
"""What was kept of work that was stopped, in words"""


@contextlib.contextmanager
def kept(target: Path, write: Callable[[Any, Path], object]) -> Iterator[None]:
    """Inside the block what `finished` is given is written by `write`, of which a stopped block leaves the last.

    A `LimitError` says what is kept where. A file of an earlier run is not written over before all is there.
    """
    keeper = Keeper(target, write)
    open_now.append(keeper)
    try:
        yield
    except BaseException as error:
        keeper.flush()
        last.append(keeper.sentence)
        if isinstance(error, LimitError):
            raise LimitError(f"{error}; {keeper.sentence}") from error
        raise
    finally:
        open_now.remove(keeper)


def finished(part: Callable[[], Any]) -> None:
    """What there is by now of what is in the making, None for nothing, for the innermost `kept`; made to be written."""
    if open_now:
        keeper = open_now[-1]
        keeper.part = part
        if keeper.fresh and time.monotonic() >= keeper.next:
            keeper.flush()
