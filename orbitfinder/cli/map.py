"""The command `map`: a plane of two parameters coloured by what the orbits at its places are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import orbitfinder as of
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.console import Report, display, time_left
from orbitfinder.cli.jobs import folder_of
from orbitfinder.cli.options import FILES, finish, next_step, option, text, trusted, usual
from orbitfinder.cli.search import SPEAK_EVERY
from orbitfinder.cli.sweep import parameter
from orbitfinder.errors import InputError
from orbitfinder.records.registry import answer


@click.command("map")
@click.argument("file", type=FILES, metavar="FILE")
@option("parameter given", "A physical parameter and its values; given twice, the first is across, the second up.",
        multiple=True, required=True, metavar="NAME=FROM:TO:COUNT")  # fmt: skip
@option("by", "What is coloured.", "stability", ("stability", "multiplier", "amplitude", "period"))
@option("sample", "How many orbits are certified.", 40, (0, 1_000_000))
@option("seed", "Chooses which.", 0, (0, 2**63 - 1))
@option("workers", "Processes side by side.", 2, (1, 256))
@option("scheduler", "Dask scheduler, such as tcp://head:8786, instead of processes.", metavar="ADDRESS")
@usual("Folder for DIR/<name>/map.json.", "maps", figures="Draw it.", compiled=True)
def map_(file: Path, given: tuple[str, ...], out: Path, figures: bool, trust: bool, **how: Any) -> None:
    """Map a plane of two parameters of a problem FILE: at each place an orbit of a family, and its stability.

    Every pixel's orbit is continued from its neighbour's; where there is none it is blank, with the reason counted. A
    run that was killed goes on where it stopped when the same command is given again. Exit code 0: all of the sample
    are certified.

    \b
    Examples:
      orbitfinder map problems/maps/driven-pendulum.toml --parameter frequency=4:9:60 --parameter torque=0.5:1.5:60
    """
    from orbitfinder.problemfile.read import load_problem_file

    values = dict(parameter(word) for word in given)
    if len(values) != 2:
        raise InputError(f"--parameter: {len(values)} different names; give two, the first across, the second up")
    loaded = load_problem_file(file, trust)
    folder = folder_of(out, loaded.wanted.name)
    with kept(folder / "map.json", of.save_map), display(
        f"{loaded.wanted.name}: {' over '.join(reversed(values))}", SPEAK_EVERY, refresh=0.25
    ) as shown:  # fmt: skip
        left = time_left()

        def report(done: int, pixels: int) -> None:
            shown.show(Report(f"{done} of {pixels} pixels{left(done, pixels)}"))

        made = of.map_plane(
            loaded.wanted, values, limit=None, progress=report, out=out, folder=trusted(file, trust), **how
        )
    written = [of.save_map(made, folder / "map.json")]
    written += answer("plot", written[0])(made, folder, loaded.model) if figures else []
    text(f"{written[0]}: {made.counts}")
    next_step("verify", written[0])
    document = {"name": made.name, "parameters": made.parameters, "counts": made.counts, "failures": made.failures,
                "written": written}  # fmt: skip
    finish("map", document, not made.failures)
