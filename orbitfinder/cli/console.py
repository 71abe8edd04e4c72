"""What a person watches while a command computes: a live table on a terminal, plain lines elsewhere.

The finder captures descriptors 1 and 2 while C++ code runs, so everything here goes to a
duplicate of descriptor 2 taken before that.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from orbitfinder._runtime import interrupt, limit, streams

if TYPE_CHECKING:
    from rich.console import RenderableType


SPEAK_EVERY = 5.0
"""Seconds between two lines of progress where there is no terminal."""


@dataclass(frozen=True)
class Report:
    """How far a command has come: a line, and rows of cells for the table on a terminal."""

    line: str
    rows: Sequence[Sequence[str]] = ()
    last: Sequence[str] = ()
    """lines below the table: what happened last"""


@dataclass
class Display:
    """Where a command reports to: `show(progress)` in place of what was shown before, `say(line)` to stay."""

    show: Callable[[Report], None]
    say: Callable[[str], None]
    live: bool = False


def note(line: str) -> None:
    """A line on standard error; Ctrl-C is answered here at the latest."""
    interrupt.check()
    click.echo(line, err=True)


@contextlib.contextmanager
def display(begins: str, every: float = 0.0, refresh: float = 0.0) -> Iterator[Display]:
    """A Display on the terminal behind descriptor 2, live when it is there; it says at once what begins.

    Of what is shown there is no more than a line every so many seconds, or a frame of the live table.
    """
    with streams.aside() as stream:
        if not stream.isatty() or os.environ.get("TERM") == "dumb":
            stream.write(begins + "\n")
            yield Display(paced(lambda progress: stream.write(progress.line + "\n"), every),
                          lambda line: _said(stream.write, line + "\n"))  # fmt: skip
            return
        from rich.console import Console
        from rich.live import Live

        console = Console(file=stream, markup=False, highlight=False)
        quiet: Any = {"auto_refresh": False, "redirect_stdout": False, "redirect_stderr": False}
        with Live(_panel(Report(begins)), console=console, transient=True, **quiet) as live:
            live.refresh()

            def say(line: str) -> None:
                live.update("", refresh=True)
                _said(lambda text: live.console.print(text), line)

            yield Display(paced(lambda progress: live.update(_panel(progress), refresh=True), refresh), say, live=True)


def time_left(*before: float) -> Callable[[float, float], str]:
    """What is to be said of the time that is left when so much of so much is done, from now on; nothing at first,
    unless it is known how much was done `before`."""
    began, first = time.monotonic(), list(before)

    def said(done: float, total: float) -> str:
        first[:] = first or [done]  # what an earlier run has done took no time now
        fresh = done - first[0]
        if fresh <= 0 or done >= total:
            return ""
        return f", {min((time.monotonic() - began) / fresh * (total - done), max(limit.left(), 0.0)):.0f} s left"

    return said


def way_left(most: int, until: float | None, *before: float) -> Callable[..., str]:
    """The same of steps with their values, at most so many or until a value is reached."""
    left, values = time_left(*before), list[float]()

    def said(*latest: float) -> str:
        values.extend(latest)
        if until is None:
            return left(len(values), most)
        return left(abs(values[-1] - values[0]), abs(until - values[0]))

    return said


@contextlib.contextmanager
def counted(title: str, what: str) -> Iterator[Callable[[int, int], None]]:
    """What shows how many of something are done, and the time left."""
    with display(title, SPEAK_EVERY, refresh=0.25) as shown:
        left = time_left()
        yield lambda done, whole: shown.show(Report(f"{done} of {whole} {what}{left(done, whole)}"))


def _said(write: Callable[[str], object], line: str) -> None:
    interrupt.check()  # CasADi makes a failed search of Ctrl-C
    write(line)


def paced(show: Callable[[Report], object], every: float) -> Callable[[Report], None]:
    """Call `show` no more often than every so many seconds, for the first time after a second."""
    last = [time.monotonic() - every + min(every, 1.0)]

    def call(progress: Report) -> None:
        if time.monotonic() - last[0] >= every:
            last[0] = time.monotonic()
            show(progress)

    return call


def _panel(progress: Report) -> RenderableType:
    """The rows of a progress as a table, or its line where it has none, and below it what happened last."""
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    if not progress.rows:
        return Text(progress.line, style="dim")
    table = Table(box=None, pad_edge=False, show_header=False)
    for k in range(max(map(len, progress.rows))):
        table.add_column(justify="right" if k and not progress.last else "left", no_wrap=True)
    for row in progress.rows:
        table.add_row(*row)
    if not progress.last:
        return table
    last = (Text(line, style="cyan", no_wrap=True, overflow="ellipsis") for line in progress.last)
    return Panel(Group(table, "", *last), title=progress.line, title_align="left", expand=False)
