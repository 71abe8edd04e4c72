"""The command `diagram`: equilibria, cycles, doublings and branches along a parameter as one tree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import orbitfinder as of
from orbitfinder.cli.console import display, time_left
from orbitfinder.cli.equilibria import side
from orbitfinder.cli.jobs import folder_of
from orbitfinder.cli.options import FILES, FINITE, finish, next_step, option, text, trusted, usual, workers_option
from orbitfinder.errors import InputError, plural
from orbitfinder.records.registry import answer


@click.command()
@click.argument("file", type=FILES)
@option("parameter", "The physical parameter to follow in.", required=True)
@option("from first", "One bound, where it begins.  [default: its value in the file]", kind=FINITE)
@option("until", "Its other bound.", kind=FINITE, required=True)
@option("depth", "0: equilibria; 1: what is born on them; 2: what is born on that; and so on.", 2, (0, 20))
@option("points", "The most of each curve, each way.", 400, (1, 100_000))
@option("across coordinate", "The coordinate that is drawn, or norm.  [default: the first]", metavar="COORDINATE")
@option("box", "Where equilibria are looked for at both bounds, from where to where, such as V=-80:40; those on no "
        "curve yet begin others.", multiple=True, metavar="NAME=LOW:HIGH")  # fmt: skip
@option("method", "Of cycles.  [default: shooting, and collocation where that cannot carry a curve on]",
        kind=("shooting", "collocation"))  # fmt: skip
@option("name", "Name of the diagram; the file's when left out.")
@workers_option()
@usual("Folder for DIR/<name>/diagram.json.", "diagrams", figures="Draw it.")
def diagram(
    file: Path, parameter: str, first: float | None, until: float, name: str | None, out: Path, figures: bool,
    trust: bool, box: tuple[str, ...], **chosen: Any,
) -> None:  # fmt: skip
    """The whole bifurcation diagram of the system of a problem FILE in one picture: equilibria, other equilibria at
    branch points, the cycles born at every Hopf point, their doublings and branches, to a depth.

    Everything is followed between --from and --until, nothing twice. A run that was
    killed goes on where it stopped when the same command is given again. Exit code 0: nothing failed, and nothing was
    left for want of time or --points; what is deeper than --depth is listed.

    \b
    Examples:
      orbitfinder diagram problems/gallery/brusselator.toml --parameter rate --until 1.5
    """
    from orbitfinder.families.diagram import happened, leaving
    from orbitfinder.mechanics.kind import with_parameters
    from orbitfinder.problemfile.read import load_problem_file

    loaded = load_problem_file(file, trust)
    if loaded.start is None and not box:
        raise InputError(f"{file}: guess: missing; give the state near an equilibrium, [guess] or [simulate] state")
    model = loaded.model if first is None else with_parameters(loaded.model, {parameter: first})
    folder = folder_of(out, name or loaded.name)
    with display(f"{folder.name}: diagram of {file}") as shown:
        left, counted = time_left(), [0, 1]  # curves that are made, and those that are known to be

        def report(curve: Any) -> None:
            record, deeper = curve.record, curve.depth < chosen["depth"]
            counted[:] = counted[0] + 1, counted[1] + len(leaving(record)) * deeper
            what = f"{plural(len(record.points), 'point')}, {plural(len(record.events), 'event')}"
            rest = left(*counted).replace(",", "; of the diagram", 1)
            shown.say(f"{curve.file}: {what}; ended: {record.ends[-1].reason}{rest}")

        made = of.diagram(model, loaded.start, parameter, until, box=dict(map(side, box)) or None, name=folder.name,
                          title=loaded.title, out=out, progress=report, folder=trusted(file, trust),
                          **chosen)  # fmt: skip
    written = [folder / "diagram.json"]
    written += answer("plot", written[0])(made, folder, model) if figures else []
    text(f"{written[0]}: {made.counts}")
    for curve in made.curves:
        for line in happened(made, curve):
            text(f"  {curve.file} {line}")
    for line in (*made.unknown, *made.remarks):
        text(f"  {line}")
    next_step("verify", written[0])
    fine = all(branching.became in ("followed", "joined", "depth") for branching in made.branchings)
    document = {"name": made.name, "parameter": parameter, "between": made.between, "curves": made.curves,
                "branchings": made.branchings, "undone": made.undone, "remarks": made.remarks,
                "written": written}  # fmt: skip
    finish("diagram", document, fine and not made.unknown and not any(" stops: " in line for line in made.undone))
