"""The command `search`: fill an atlas with the periodic orbits of a system."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import orbitfinder as of
from orbitfinder._runtime import interrupt
from orbitfinder.cli.console import SPEAK_EVERY, Report, display
from orbitfinder.cli.options import FILES, finish, next_step, option, text, trusted, usual, workers_option
from orbitfinder.cli.sweep import parameter
from orbitfinder.errors import InputError, plural

if TYPE_CHECKING:
    from orbitfinder.atlas.report import Summary
    from orbitfinder.atlas.search import SearchStatistics
    from orbitfinder.problemfile.read import ProblemFile

REASONS_SHOWN = 8
MISSING = "search: missing; add a [search] table with period = [shortest, longest]"


def seconds(text: str) -> float:
    """A duration such as 60s, 10m, 1.5h or a plain number of seconds."""
    match = re.fullmatch(r"\s*([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(s|m|min|h)?\s*", text)
    units = {None: 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
    try:
        return float(match[1]) * units[match[2]] if match else math.nan
    except ValueError:
        return math.nan


def _budget(_: click.Context, __: click.Parameter, text: str | None) -> float | None:
    value = None if text is None else seconds(text)
    if value is not None and not value > 0:
        raise InputError(f"--budget: {text!r} is not a time; give seconds, such as 60s, 10m or 2h")
    return value


@click.command()
@click.argument("file", type=FILES, metavar="FILE")
@option("atlas book", "Where the orbits are kept.", kind=FILES, required=True, metavar="FILE.sqlite")
@option("budget", "Stop after this time, such as 60s, 10m; default 60s.", callback=_budget, metavar="TIME")
@option("starts", "Stop when this many starts have been made in all.", kind=(0,))
@option("seed", "Chooses the starts.", 0, (0, 2**63 - 1))
@workers_option(2, "Processes; 0: no other.", 0)
@option(
    "parameter given",
    "A physical parameter and its values, or NAME=V,V,...; of several every combination is searched.",
    multiple=True, metavar="NAME=FROM:TO:COUNT",
)  # fmt: skip
@option("shard", "Make every N-th start only, from the K-th; auto: by the Slurm array that runs it.", metavar="K/N")
@usual(compiled=True, trust="Import the Python function of the system; only for files you have read.")
def search(
    file: Path, book: Path, budget: float | None, starts: int | None, trust: bool, given: tuple[str, ...], **how: Any
) -> None:
    """Search for all periodic orbits of the system of a problem FILE, at its energies and periods.

    Every orbit found is certified and, when it is new, written to the atlas. The starts depend on the
    seed alone, not on the number of workers. The same command goes on where it was stopped, or killed. Of a problem
    with [control] the optima near many guesses are looked for. Exit code 1: an energy cannot be reached at some
    parameters; what can be is searched.
    Shards know nothing of each other: give each an atlas of its own, and join them by `atlas merge`.

    \b
    Examples:
      orbitfinder search problems/search/triple.toml --budget 60s --atlas triple.sqlite
      orbitfinder search problems/search/triple.toml --starts 2000 --workers 4 --atlas triple.sqlite
      orbitfinder search problems/search/triple.toml --starts 2000 --shard 3/8 --atlas triple-3.sqlite
      orbitfinder search problems/search/duffing.toml --parameter damping=0.05:0.2:4 --atlas duffing.sqlite
    """
    lasts, folder = "" if budget is None else f" {budget:g} s,", trusted(file, trust)
    parameters = dict(map(parameter, given))
    if len(parameters) < len(given):
        raise InputError("--parameter: the same name twice; give each once")
    with display(f"{file}: searching,{lasts} seed {how['seed']}, into {book}", SPEAK_EVERY, refresh=0.25) as shown:
        from orbitfinder.problemfile.read import load_problem_file, read_toml

        if file.suffix != ".py" and "search" not in read_toml(file):  # before the modes of a long chain are computed
            raise InputError(f"{file}: {MISSING}")
        loaded = load_problem_file(file, trust)
        energies, periods = wanted(loaded)
        wished = loaded.wanted if steered(loaded) else loaded.model
        conserved = isinstance(wished, of.Model) and bool(wished.invariants)

        def report(energy: float, tally: SearchStatistics) -> None:
            interrupt.check()
            shown.show(progress(energy, tally, conserved))

        result = of.search(wished, energies, periods, book, starts=starts, budget=budget, folder=folder,
                          progress=report, parameters=parameters, **how, **sections(loaded))  # fmt: skip
    for energy, values, why in result.refused:
        text(f"{level(energy, conserved, values)}: not searched: {why}")
    for energy, tally in result.tallies:
        where = level(energy, conserved, tally.parameters)
        text(
            f"{where}: {plural(tally.done, 'start')} in {tally.elapsed:.1f} s, {plural(tally.new, 'new orbit')}, "
            f"{plural(tally.duplicates, 'time')} a known one, {sum(tally.failures.values())} failed"
        )
    print_summary(result.summary)
    text(f"{result.atlas}: {plural(result.summary.orbits, 'distinct certified orbit')}")
    next_step("atlas list", result.atlas)
    runs = [
        {
            "energy": energy, "parameters": dict(tally.parameters), "starts": tally.done,
            "first_start": tally.begun_at, "hits": tally.hits, "new": tally.new, "duplicates": tally.duplicates,
            "failures": dict(tally.failures), "seconds": tally.elapsed,
        }
        for energy, tally in result.tallies
    ]  # fmt: skip
    refused = [{"energy": energy, "parameters": dict(values), "reason": why} for energy, values, why in result.refused]
    document = {"atlas": str(result.atlas), "runs": runs, "refused": refused, "summary": result.summary.document()}
    finish("search", document, not refused)


def level(energy: float, conserved: bool, parameters: Mapping[str, float]) -> str:
    """An energy and parameters in words."""
    from orbitfinder.atlas.store import as_words, parameters_in_words

    return (f"{energy:g} J" if conserved else "any energy") + parameters_in_words(as_words(parameters), ", ")


def wanted(loaded: ProblemFile) -> tuple[list[float] | None, tuple[float, float]]:
    """Energies (J; None of a system that conserves none) and range of periods (s) that a problem file asks for."""
    table = loaded.document.get("search", {})
    if loaded.search is None:
        raise InputError(f"{loaded.path}: {MISSING}")
    if steered(loaded):
        return table.get("energy"), loaded.search
    energy = table.get("energy", (loaded.document.get("find", {}).get("pin") or {}).get("energy"))
    general = loaded.model.rates is not None or loaded.model.forced or not loaded.model.smooth
    if energy is None and general and not loaded.model.invariants:
        return None, loaded.search
    if energy is None:
        raise InputError(f"{loaded.path}: search.energy: missing; give the energy in J, or find.pin.energy")
    return [float(value) for value in (energy if isinstance(energy, list) else [energy])], loaded.search


def steered(loaded: ProblemFile) -> bool:
    """Whether a problem file is about controlled motions."""
    return loaded.problem is not None and loaded.problem.control is not None


def sections(loaded: ProblemFile) -> dict[str, Any]:
    """Where a problem file starts the search of a hybrid system."""
    return {key: value for key, value in loaded.document.get("search", {}).items() if key in ("section", "cycles")}


def progress(energy: float, tally: SearchStatistics, conserved: bool = True) -> Report:
    """How far a search has come."""
    made, failed, left = tally.made, sum(tally.failures.values()), tally.left
    where = level(energy, conserved, tally.parameters)
    rate, remaining = f"{tally.done / max(tally.elapsed, 1e-9):.1f}", "" if left is None else f"{left:.0f} s"
    line = (
        f"{where}: {plural(made, 'start')}, {plural(tally.hits, 'hit')}, {tally.new} new, "
        f"{tally.duplicates} known, {failed} failed, {plural(tally.orbits, 'orbit')} in the atlas, {rate} starts/s"
    ) + (remaining and f", {remaining} left")
    rows = [
        ("energy", where), ("starts", f"{made}"),
        ("hits", f"{tally.hits}"), ("new orbits", f"{tally.new}"),
        ("known orbits", f"{tally.duplicates}"), ("orbits in the atlas", f"{tally.orbits}"),
        ("starts a second", rate), ("time left", remaining),
        *((f"failed: {reason}", str(count)) for reason, count in tally.failures.most_common(REASONS_SHOWN)),
    ]  # fmt: skip
    return Report(line, rows)


def print_summary(summary: Summary) -> None:
    """Yield by strategy, failures by reason, and how many orbits may remain."""
    text(f"  {'strategy':<16}{'starts':>8}{'hits':>8}{'new':>8}{'cpu s':>9}{'new/cpu s':>11}")
    for row in summary.yields:
        rate = row.new / row.seconds if row.seconds else 0.0
        text(f"  {row.strategy:<16}{row.starts:>8}{row.hits:>8}{row.new:>8}{row.seconds:>9.1f}{rate:>11.2f}")
    failures = list(summary.failures.items())
    for reason, count in failures[:REASONS_SHOWN]:
        text(f"  failed {count:>6}: {reason}")
    if rest := sum(count for _, count in failures[REASONS_SHOWN:]):
        text(f"  failed {rest:>6}: other reasons")
    for met in summary.strata:
        text(
            f"  {plural(met.orbits, 'orbit')} of symmetry {met.symmetry}{met.at}, {met.once} met once; "
            f"at least about {met.least:.0f}, sought by {plural(met.starts, 'start')}"
        )
    for sentence in summary.remarks:
        text(f"  {sentence}")
