"""The commands `map` and `bifurcation`: a plane of two parameters coloured by what its orbits are, and what motions
settle to along one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import orbitfinder as of
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.console import counted
from orbitfinder.cli.jobs import folder_of
from orbitfinder.cli.options import FILES, finish, next_step, option, text, trusted, usual, workers_option
from orbitfinder.cli.section import DIRECTIONS
from orbitfinder.cli.sweep import parameter, shard_option, sharded
from orbitfinder.errors import InputError
from orbitfinder.records.registry import answer


@click.command("map")
@click.argument("file", type=FILES, metavar="FILE")
@option("parameter given", "A physical parameter and its values; given twice, the first is across, the second up.",
        multiple=True, required=True, metavar="NAME=FROM:TO:COUNT")  # fmt: skip
@option("by", "What is coloured.", "stability", ("stability", "multiplier", "amplitude", "period"))
@option("sample", "How many orbits are certified.", 40, (0, 1_000_000))
@option("seed", "Chooses which.", 0, (0, 2**63 - 1))
@workers_option(2)
@shard_option("Fill the K-th of N runs of rows only")
@usual("Folder for DIR/<name>/map.json.", "maps", figures="Draw it.", compiled=True)
def map_(
    file: Path, given: tuple[str, ...], out: Path, figures: bool, trust: bool, shard: str | None, **how: Any
) -> None:  # fmt: skip
    """Map a plane of two parameters of a problem FILE: at each place an orbit of a family, and its stability.

    Every pixel's orbit is continued from its neighbour's; where there is none it is blank, with the reason counted. A
    run that was killed goes on where it stopped when the same command is given again; without --shard, what shards in
    DIR have done is taken from there. Exit code 0: all of the sample are certified.

    \b
    Examples:
      orbitfinder map problems/maps/driven-pendulum.toml --parameter frequency=4:9:60 --parameter torque=0.5:1.5:60
    """
    from orbitfinder.problemfile.read import load_problem_file

    values = dict(parameter(word) for word in given)
    if len(values) != 2:
        raise InputError(f"--parameter: {len(values)} different names; give two, the first across, the second up")
    rows = [*values][1]
    loaded = load_problem_file(file, trust)
    shards = [] if shard else sorted(out.glob(f"*-of-*/{loaded.wanted.name}/map.jsonl"))
    mine, out = sharded({rows: values[rows]}, shard, out, least=2)
    values |= mine
    folder = folder_of(out, loaded.wanted.name)
    title = f"{loaded.wanted.name}: {' over '.join(reversed(values))}"
    with kept(folder / "map.json", of.save_map), counted(title, "pixels") as report:
        made = of.map_plane(
            loaded.wanted,
            values,
            limit=None,
            progress=report,
            out=out,
            folder=trusted(file, trust),
            shards=shards,
            **how,
        )
    written = [of.save_map(made, folder / "map.json")]
    written += answer("plot", written[0])(made, folder, loaded.model) if figures else []
    text(f"{written[0]}: {made.counts}")
    next_step("verify", written[0])
    document = {"name": made.name, "parameters": made.parameters, "counts": made.counts, "failures": made.failures,
                "written": written}  # fmt: skip
    finish("map", document, not made.failures)


@click.command()
@click.argument("file", type=FILES, metavar="FILE")
@option("parameter given", "The physical parameter and its values; or NAME=V,V,...", required=True,
        metavar="NAME=FROM:TO:COUNT")  # fmt: skip
@option("coordinate", "What is drawn, and of which maxima are taken.  [default: the first]", metavar="NAME")
@option("plane", "Take crossings of a plane instead of maxima.", metavar="NAME=VALUE")
@option("direction", "Of the crossings.", "growing", tuple(DIRECTIONS))
@option("transient", "Returns dropped at each value.", 200, (0, 1_000_000))
@option("samples", "Returns kept at each value.", 100, (4, 1_000_000))
@option("sweep", "Begin each value where that before it ended: upwards, downwards, both ways.", "none",
        ("none", "up", "down", "both"))  # fmt: skip
@option("starts", "Motions at each value, the first from the file's state.", 1, (1, 10_000))
@option("seed", "Draws the other starts.", 0, (0, 2**63 - 1))
@option("with families", "A family of the same system and parameter, drawn through the samples.", multiple=True,
        kind=FILES, metavar="FAMILY.json")  # fmt: skip
@workers_option()
@shard_option("Visit the K-th of N runs of values only")
@usual("Folder for DIR/<name>/bifurcation.json.", "bifurcations", figures="Draw it.", compiled=True)
def bifurcation(
    file: Path, given: str, families: tuple[Path, ...], direction: str, shard: str | None, out: Path, figures: bool,
    trust: bool, **how: Any,
) -> None:  # fmt: skip
    """Draw what the motions of a problem FILE settle to along a parameter, by brute force: Poincare samples.

    Forced systems are looked at once a period of their forcing, hybrid ones after their own events, others at the
    maxima of a coordinate. A run that was killed goes on where it stopped when the same command is given again, also
    with more values; what shards in DIR have done is taken from there.

    \b
    Examples:
      orbitfinder bifurcation problems/maps/pendulum-cascade.toml --parameter torque=1.03:1.09:240
    """
    from orbitfinder.problemfile.read import load_problem_file

    loaded = load_problem_file(file, trust)
    if loaded.start is None:
        raise InputError(f"{file}: guess: missing; give the state where motions begin, [guess] or [simulate] state")
    if shard is not None and how["sweep"] != "none":
        raise InputError("--shard: with --sweep each value needs the one before it; leave one of them out")
    shards = [] if shard else sorted(out.glob(f"*-of-*/{loaded.name}/bifurcation.jsonl"))
    values, out = sharded(dict([parameter(given)]), shard, out)
    lines = [of.load_family(family) for family in families]
    folder = folder_of(out, loaded.name)
    with kept(folder / "bifurcation.json", of.sections.save_bifurcation), counted(
        f"{loaded.name}: {', '.join(values)} by brute force", "motions"
    ) as report:  # fmt: skip
        made = of.bifurcation(
            loaded.problem or loaded.model, values, state=loaded.start, direction=DIRECTIONS[direction],
            progress=report, out=out, name=loaded.name, folder=trusted(file, trust), shards=shards, **how,
        )  # fmt: skip
    written = [of.sections.save_bifurcation(made, folder / "bifurcation.json")]
    if figures:
        picture = folder / "bifurcation.png"
        written.append(of.sections.draw_bifurcation(made, picture, families=lines, model=loaded.model))
    text(f"{written[0]}: {made.counts}")
    next_step("verify", written[0])
    document = {"name": made.name, "parameter": made.parameter, "plane": made.plane, "counts": made.counts,
                "values": made.values, "repeats": made.repeats, "written": written}  # fmt: skip
    finish("bifurcation", document, bool(made.full.all()))
