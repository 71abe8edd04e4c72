"""The command `search`: fill an atlas with the periodic orbits of a system."""

from __future__ import annotations

import contextlib
import math
import os
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orbitfinder._runtime import interrupt, streams
from orbitfinder.cli.options import FILES, compile_option, json_option, print_json, trust_option
from orbitfinder.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from orbitfinder.atlas.api import Found
    from orbitfinder.atlas.report import Summary
    from orbitfinder.atlas.search import Limits, Tally
    from orbitfinder.problemfile.read import ProblemFile

SPEAK_EVERY = 5.0
"""Seconds between two lines of progress where there is no terminal."""
REFRESH_EVERY = 0.25
REASONS_SHOWN = 8
MISSING = "search: missing; add a [search] table with period = [shortest, longest]"
UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


def seconds(text: str) -> float:
    """A duration such as 60s, 10m, 1.5h or a plain number of seconds."""
    found = re.fullmatch(r"\s*([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(s|m|min|h)?\s*", text)
    try:
        return float(found[1]) * UNITS[found[2] or ""] if found else math.nan
    except ValueError:
        return math.nan


def _budget(_: click.Context, __: click.Parameter, text: str | None) -> float | None:
    if text is None:
        return None
    value = seconds(text)
    if not value > 0:
        raise InputError(f"--budget: {text!r} is not a time; give seconds, such as 60s, 10m or 2h")
    return value


@click.command(name="search")
@click.argument("file", type=FILES, metavar="FILE")
@click.option("--atlas", "book", required=True, type=FILES, metavar="FILE.sqlite", help="Where the orbits are kept.")
@click.option("--budget", callback=_budget, metavar="TIME", help="Stop after this time, such as 60s, 10m; default 60s.")
@click.option("--starts", type=click.IntRange(0), help="Stop when this many starts have been made in all.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0, 2**63 - 1), help="Chooses the starts.")
@click.option("--workers", default=2, show_default=True, type=click.IntRange(0, 256), help="Processes; 0: no other.")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, such as tcp://head:8786, instead of processes.")
@trust_option("Import the Python function of the system; only for files you have read.")
@compile_option
@json_option
def search(file: Path, book: Path, scheduler: str | None, trust: bool, as_json: bool, **options: Any) -> None:
    """Search for all periodic orbits of the system of a problem FILE, at its energies and periods.

    Every orbit found is certified and, when it is new, written to the atlas. The starts depend on the
    seed alone, not on the number of workers. The same command goes on where it was stopped, or killed.

    \b
    Examples:
      orbitfinder search problems/search/triple.toml --budget 60s --atlas triple.sqlite
      orbitfinder search problems/search/triple.toml --starts 2000 --workers 4 --atlas triple.sqlite
    """
    from orbitfinder.atlas.api import DEFAULT_BUDGET
    from orbitfinder.atlas.api import search as run
    from orbitfinder.atlas.search import Limits
    from orbitfinder.problemfile.read import load_problem_file, read_toml

    if file.suffix != ".py" and "search" not in read_toml(file):  # before the modes of a long chain are computed
        raise InputError(f"{file}: {MISSING}")
    loaded = load_problem_file(file, trust)
    energies, periods = wanted(loaded)
    starts, budget = options["starts"], options["budget"]
    budget = DEFAULT_BUDGET if starts is None and budget is None else budget
    limits = Limits(starts, None if budget is None else budget / len(energies))
    with watched(limits) as report:
        found = run(
            loaded.model, energies, periods, book, starts=starts, budget=budget, seed=options["seed"],
            workers=options["workers"], scheduler=scheduler, folder=file.parent.resolve() if trust else None,
            progress=report,
        )  # fmt: skip
    if as_json:
        print_json({"format": "orbitfinder/search"} | found_document(found))
    else:
        _print_found(found)


def wanted(loaded: ProblemFile) -> tuple[list[float], tuple[float, float]]:
    """Energies (J) and range of periods (s) that a problem file asks for."""
    table = loaded.document.get("search", {})
    if loaded.search is None:
        raise InputError(f"{loaded.path}: {MISSING}")
    energy = table.get("energy", (loaded.document.get("find", {}).get("pin") or {}).get("energy"))
    if energy is None:
        raise InputError(f"{loaded.path}: search.energy: missing; give the energy in J, or find.pin.energy")
    return [float(one) for one in (energy if isinstance(energy, list) else [energy])], loaded.search


@contextlib.contextmanager
def watched(limits: Limits) -> Iterator[Callable[[float, Tally], None]]:
    """A callback that shows a tally: a table that changes on a terminal, a line now and then elsewhere."""
    with streams.aside() as stream:
        if not stream.isatty() or os.environ.get("TERM") == "dumb":
            yield paced(lambda energy, tally: stream.write(line(energy, tally, limits) + "\n"), SPEAK_EVERY)
            return
        from rich.console import Console
        from rich.live import Live

        console = Console(file=stream, markup=False, highlight=False)
        quiet: Any = {"auto_refresh": False, "redirect_stdout": False, "redirect_stderr": False}
        with Live(console=console, transient=True, **quiet) as live:
            yield paced(lambda energy, tally: live.update(table(energy, tally, limits), refresh=True), REFRESH_EVERY)


def paced(show: Callable[[float, Tally], object], every: float) -> Callable[[float, Tally], None]:
    """Call `show` no more often than every so many seconds."""
    last = [time.monotonic() - every + 1.0]

    def call(energy: float, tally: Tally) -> None:
        interrupt.check()
        if time.monotonic() - last[0] >= every:
            last[0] = time.monotonic()
            show(energy, tally)

    return call


def line(energy: float, tally: Tally, limits: Limits) -> str:
    """A tally as one line."""
    left = tally.left(limits)
    return (
        f"{energy:g} J: {tally.begun_at + tally.done} starts, {tally.hits} hits, {tally.new} new, "
        f"{tally.duplicates} known, {sum(tally.failures.values())} failed, {tally.orbits} orbits in the atlas, "
        f"{tally.done / max(tally.elapsed, 1e-9):.1f} starts/s" + ("" if left is None else f", {left:.0f} s left")
    )


def table(energy: float, tally: Tally, limits: Limits) -> Table:
    """A tally as a table."""
    from rich.table import Table

    left = tally.left(limits)
    shown = Table(box=None, pad_edge=False, show_header=False)
    shown.add_column()
    shown.add_column(justify="right")
    entries = [
        ("energy", f"{energy:g} J"), ("starts", f"{tally.begun_at + tally.done}"), ("hits", f"{tally.hits}"),
        ("new orbits", f"{tally.new}"), ("known orbits", f"{tally.duplicates}"),
        ("orbits in the atlas", f"{tally.orbits}"),
        ("starts a second", f"{tally.done / max(tally.elapsed, 1e-9):.1f}"),
        ("time left", "" if left is None else f"{left:.0f} s"),
        *((f"failed: {reason}", str(count)) for reason, count in tally.failures.most_common(REASONS_SHOWN)),
    ]  # fmt: skip
    for name, value in entries:
        shown.add_row(name, value)
    return shown


def found_document(found: Found) -> dict[str, Any]:
    """A finished search for `--json`."""
    runs = [
        {
            "energy": energy, "starts": tally.done, "first_start": tally.begun_at, "hits": tally.hits,
            "new": tally.new, "duplicates": tally.duplicates, "failures": dict(tally.failures),
            "seconds": tally.elapsed,
        }
        for energy, tally in found.tallies
    ]  # fmt: skip
    return {"atlas": str(found.atlas), "runs": runs, "summary": found.summary.document()}


def _print_found(found: Found) -> None:
    for energy, tally in found.tallies:
        click.echo(
            f"{energy:g} J: {tally.done} starts in {tally.elapsed:.1f} s, {tally.new} new orbits, "
            f"{tally.duplicates} times a known one, {sum(tally.failures.values())} failed"
        )
    click.echo(f"{found.atlas}: {found.summary.orbits} distinct certified orbits")
    print_summary(found.summary)


def print_summary(summary: Summary) -> None:
    """Yield by strategy, failures by reason, and how many orbits may remain."""
    click.echo(f"  {'strategy':<16}{'starts':>8}{'hits':>8}{'new':>8}{'cpu s':>9}{'new/cpu s':>11}")
    for one in summary.yields:
        rate = one.new / one.seconds if one.seconds else 0.0
        click.echo(f"  {one.strategy:<16}{one.starts:>8}{one.hits:>8}{one.new:>8}{one.seconds:>9.1f}{rate:>11.2f}")
    failures = list(summary.failures.items())
    for reason, count in failures[:REASONS_SHOWN]:
        click.echo(f"  failed {count:>6}: {reason}")
    if rest := sum(count for _, count in failures[REASONS_SHOWN:]):
        click.echo(f"  failed {rest:>6}: other reasons")
    for met in summary.strata:
        click.echo(
            f"  {met.orbits} orbits of symmetry {met.symmetry} at {met.energy:g} J, {met.once} met once; "
            f"at least about {met.least:.0f}, sought by {met.starts} starts"
        )
    for sentence in summary.remarks:
        click.echo(f"  {sentence}")
