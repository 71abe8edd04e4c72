"""What a person watches while orbits are found: a live table on a terminal, plain lines elsewhere.

The finder captures descriptors 1 and 2 while C++ code runs, so everything here goes to a
duplicate of descriptor 2 taken before that.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TextIO

from orbitfinder._runtime import streams

if TYPE_CHECKING:
    from rich.table import Table

    from orbitfinder.orbits.find import Progress


@dataclass
class Display:
    """A place to report to: `event(name, progress)` while solving, `say(line)` in between."""

    event: Callable[[str, Progress], None]
    say: Callable[[str], None]


@contextlib.contextmanager
def display() -> Iterator[Display]:
    """A Display on the terminal behind descriptor 2, live when it is one."""
    with streams.aside() as stream:
        if stream.isatty() and os.environ.get("TERM") != "dumb":
            with _live(stream) as shown:
                yield shown
        else:
            yield _plain(stream)


def _plain(stream: TextIO) -> Display:
    def say(line: str) -> None:
        stream.write(line + "\n")

    return Display(lambda name, progress: say(described(name, progress)), say)


def described(name: str, progress: Progress) -> str:
    """One event as one line."""
    return (
        f"{name}: {progress.stage} {progress.iteration}, defect {progress.defect:.2e}, "
        f"period {progress.period:.9g} s, {progress.elapsed:.1f} s elapsed"
    )


@dataclass
class _Rows:
    latest: dict[str, Any] = field(default_factory=dict)

    def __rich__(self) -> Table:
        from rich.table import Table

        table = Table(box=None, pad_edge=False, show_header=bool(self.latest))
        for heading in ("problem", "stage", "iteration", "defect", "period (s)", "elapsed (s)"):
            table.add_column(heading, justify="left" if heading in ("problem", "stage") else "right")
        for name, event in self.latest.items():
            table.add_row(
                name, event.stage, str(event.iteration), f"{event.defect:.2e}",
                f"{event.period:.9g}", f"{event.elapsed:.1f}",
            )  # fmt: skip
        return table


@contextlib.contextmanager
def _live(stream: TextIO) -> Iterator[Display]:
    from rich.console import Console
    from rich.live import Live

    console = Console(file=stream, markup=False, highlight=False)
    rows = _Rows()
    quiet: Any = {"auto_refresh": False, "redirect_stdout": False, "redirect_stderr": False}
    with Live(rows, console=console, transient=True, **quiet) as live:

        def event(name: str, progress: Progress) -> None:
            rows.latest = {name: progress}
            live.refresh()

        def say(line: str) -> None:
            rows.latest = {}
            live.console.print(line, soft_wrap=True)

        yield Display(event, say)
