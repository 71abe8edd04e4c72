"""The commands `atlas ...`: look into a catalogue of orbits, take things out, draw it."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

import orbitfinder as of
from orbitfinder.cli.jobs import check_writable
from orbitfinder.cli.options import (
    FILES,
    finish,
    json_option,
    on_terminal,
    option,
    out_option,
    print_json,
    text,
    trusted,
    usual,
    wants_json,
)
from orbitfinder.cli.search import level, print_summary
from orbitfinder.errors import InputError, plural
from orbitfinder.records.reading import Entries, write_atomically

BOOK = click.argument("book", type=FILES, metavar="FILE.sqlite")
TRUST = "Import the Python function of the system, from beside the atlas or installed, for the names of its state."


def interval(_: click.Context, parameter: click.Parameter, text: str | None) -> tuple[float, float] | None:
    """What `low,high` says; either may be left out."""
    if text is None:
        return None
    try:
        low, high = (float(word) if word.strip() else None for word in text.split(","))
    except ValueError as error:
        raise InputError(f"--{parameter.name}: {text!r} is no range; give low,high, either may be left out") from error
    return -math.inf if low is None else low, math.inf if high is None else high


def filters(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that choose orbits of an atlas."""
    for add in (
        option("symmetry", "Only this symmetry, such as brake; may be repeated.", multiple=True),
        option("stability", "Only elliptic, unstable or marginal; may be repeated.", multiple=True),
        option("energy", "Range of energies in J.", callback=interval, metavar="LOW,HIGH"),
        option("period", "Range of periods in s.", callback=interval, metavar="LOW,HIGH"),
    ):
        command = add(command)
    return command


def chosen(options: Entries) -> of.Filter:
    """The filter that those options make."""
    return of.Filter(**{name: options[name] for name in ("period", "energy", "stability", "symmetry")})


@click.group(name="atlas")
def atlas() -> None:
    """Look into an atlas of orbits: list, show, report, export, plot; merge several.

    \b
    Example:
      orbitfinder atlas list triple.sqlite --stability elliptic
    """


@atlas.command(name="list")
@BOOK
@filters
@option("order", "Columns to sort by; DESC reverses.", "energy, period")
@json_option
def list_orbits(book: Path, order: str, **options: Any) -> None:
    """List the orbits of an atlas, one a line.

    \b
    Examples:
      orbitfinder atlas list triple.sqlite --stability elliptic
      orbitfinder atlas list triple.sqlite --period ,3 --order "instability"
    """
    with of.Atlas(book) as opened:
        from orbitfinder.atlas.store import parameters_in_words
        from orbitfinder.mechanics.scales import worded

        rows, system = opened.rows(chosen(options), order), opened.system
    wide = not on_terminal() or shutil.get_terminal_size().columns > 103  # from there on the whole table fits
    energy, period, acts = (worded(name, system) for name in ("energy (J)", "period (s)", "action (J s)"))
    action, closure = (f" {acts:>13}", f" {'closure':>9}") if wide else ("", "")
    head = f"{'id':>6} {energy:>12} {period:>14}{action}  {'symmetry':<18}{'stability':<11}"
    costly = any(row.cost is not None for row in rows)
    text(f"{head}{'largest |mu|':>12}{closure}" + f" {'cost':>13}" * costly)
    for row in rows:
        action, closure = (f" {row.action:>13.6f}", f" {row.closure:>9.1e}") if wide else ("", "")
        text(
            f"{row.id:>6} {row.energy:>12.6g} {row.period:>14.9f}{action}  {row.symmetry:<18}"
            f"{row.stability:<11}{row.instability:>12.4g}{closure}"
            f"{'' if row.cost is None else f' {row.cost:>13.9g}'}"
            f"{parameters_in_words(row.parameters, '  ')}"
        )
    text(plural(len(rows), "orbit"))
    finish("atlas-list", {"orbits": rows})


@atlas.command()
@BOOK
@click.argument("number", type=int, metavar="ID")
@usual(trust=TRUST)
def show(book: Path, number: int, trust: bool) -> None:
    """Show one orbit by its id; with --json its orbit.json document.

    \b
    Example:
      orbitfinder atlas show triple.sqlite 12 --json > orbit.json && orbitfinder verify orbit.json
    """
    from orbitfinder.atlas.store import named_state, proved
    from orbitfinder.mechanics.scales import worded

    with of.Atlas(book, trusted=trusted(book, trust)) as opened:
        document = opened.document(number)
        names = None if wants_json() else opened.model.state_names
        row = opened.row(number)
    if names is None:
        print_json(document)
        return
    text(f"orbit {number} of {book}")
    for key, unit in (("period", "s"), ("energy", "J"), ("action", "J s"), ("closure", ""), ("symmetry", ""),
                      ("stability", "")):  # fmt: skip
        value = document[key]
        line = f"{f'{value:.12g}' if isinstance(value, float) else value} {unit}".rstrip()
        text(f"  {key:<22}{worded(line, document['system'])}")
    for name, value in named_state(document, names).items():
        text(f"  {name:<22}{value:.12g}")
    if row.cost is not None:
        text(f"  {'cost':<22}{row.cost:.12g}, of {document['control']['cost_of']}")
    text(f"  {'signature':<22}{row.signature}")
    claim = proved(document)
    said = f"{claim}, as recorded; orbitfinder verify --proof {book}#{number} does it again" if claim else "none"
    text(f"  {'proof':<22}{said}")
    multipliers = ", ".join(f"{complex(*mu):.6g}" for mu in document["floquet_multipliers"])
    text(f"  {'floquet multipliers':<22}{multipliers}")
    if "cycle" in document["system"]:
        text(f"  {'events':<22}{', '.join(document['system']['cycle'])}")
    source = dict(document.get("provenance") or {})
    text(f"  {'found by':<22}{source.get('strategy')}, seed {source.get('seed')}, start {source.get('index')}")


@atlas.command()
@BOOK
@json_option
def report(book: Path) -> None:
    """Yield of each strategy, failures by reason and an estimate of what remains, over all searches.

    \b
    Example:
      orbitfinder atlas report triple.sqlite
    """
    from orbitfinder.atlas.report import summarise

    with of.Atlas(book) as opened:
        summary = summarise(opened)
    text(f"{book}: {plural(summary.orbits, 'distinct certified orbit')} of {plural(summary.starts, 'start')}")
    print_summary(summary)
    finish("atlas-report", summary.document())


@atlas.command()
@BOOK
@option("to form", "What to write.", "json", ("json", "csv", "parquet"))
@filters
@usual("File to write; standard output when left out.", trust=TRUST, json=False)
def export(book: Path, form: str, out: Path | None, trust: bool, **options: Any) -> None:
    """Write orbits as a JSON list of orbit documents, or as a table in CSV or Parquet.

    Parquet needs the extra `parquet` (pyarrow) and -o.

    \b
    Examples:
      orbitfinder atlas export triple.sqlite --to csv -o triple.csv
      orbitfinder atlas export triple.sqlite --stability elliptic > elliptic.json
    """
    from orbitfinder.atlas.export import exported

    if out is None and form == "parquet":
        raise InputError("--out: missing; a Parquet file is not text, name it with -o FILE.parquet")
    with of.Atlas(book, trusted=trusted(book, trust)) as opened:
        data = exported(opened, form, chosen(options))
    if out is None:
        click.echo(data, nl=False)
        return
    try:
        write_atomically(out, data)
    except OSError as error:
        raise InputError(f"--out: cannot write {out} ({error}); choose another place") from error
    click.echo(f"{out}: written")


@atlas.command()
@BOOK
@filters
@out_option("Folder for the figures; this one by default.", default=Path())
def plot(book: Path, out: Path, **options: Any) -> None:
    """Draw energy against period with stability, the histogram of instability and the discovery curve.

    \b
    Example:
      orbitfinder atlas plot triple.sqlite -o figures
    """
    from orbitfinder.show.plot import save_atlas_figures

    check_writable(out)
    with of.Atlas(book) as opened:
        written = save_atlas_figures(opened, out, chosen(options))
    for path in written:
        click.echo(str(path))


@atlas.command()
@click.argument("books", type=FILES, nargs=-1, required=True, metavar="FILE.sqlite...")
@option("atlas out", "Where all of them go.", kind=FILES, required=True, metavar="OUT.sqlite")
@option("union", "Also of searches that have nothing in common but the system.", kind=bool)
@usual(trust=TRUST)
def merge(books: tuple[Path, ...], out: Path, union: bool, trust: bool) -> None:
    """Put several atlases of one system, such as the shards of a search, into one.

    OUT keeps what it held before. The order of the atlases does not matter, nor how often one is merged; what
    comes out is what one search would have made.

    \b
    Example:
      orbitfinder atlas merge triple-*.sqlite --atlas triple.sqlite
    """
    merged = of.merge_atlases(list(books), out, union=union, trusted=trusted(books[0], trust))
    text(f"{out}: {plural(merged.orbits, 'distinct certified orbit')} of {plural(merged.starts, 'start')}")
    with of.Atlas(out, trusted=trusted(books[0], trust)) as opened:
        conserved = opened.conserved
    for search in merged.searches:
        lost = f", {search.missing} between them are missing (the same search makes them)" if search.missing else ""
        shell = level(search.energy, conserved, {})
        text(f"  {shell}, seed {search.seed}: {plural(search.starts, 'start')}{lost}")
    finish("atlas-merge", merged.document())
