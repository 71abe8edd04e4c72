"""The command `sweep`: the orbit of a problem file at many values of its parameters, as a table and as orbits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

import orbitfinder as of
from orbitfinder._runtime.keeping import kept
from orbitfinder._runtime.limit import limited
from orbitfinder.cli.console import display, time_left
from orbitfinder.cli.jobs import folder_of
from orbitfinder.cli.options import FILES, Decorator, finish, option, text, trusted, usual, workers_option
from orbitfinder.errors import InputError
from orbitfinder.records.reading import Table

if TYPE_CHECKING:
    from orbitfinder.orbits.sweep import Row, Sweep


def shard_option(what: str) -> Decorator:
    """The option --shard of commands whose values are shared out in runs."""
    return option("shard", f"{what}, into DIR/K-of-N; auto: by the Slurm array.", metavar="K/N")


def sharded(
    values: dict[str, list[float]], shard: str | None, out: Path, least: int = 1
) -> tuple[dict[str, list[float]], Path]:  # fmt: skip
    """The values of a shard and the folder for them; all without one. Raises `InputError` for less than `least`."""
    from orbitfinder.atlas.shard import shard_from

    if (part := shard_from(shard)) is None:
        return values, out
    mine = {name: [*np.array_split(each, part.parts)[part.first]] for name, each in values.items()}
    if any(len(each) // part.parts < least for each in values.values()):
        raise InputError(f"--shard: {shard}: more shards than {'values' if least == 1 else 'pairs of values'}; "
                         "give a smaller N")  # fmt: skip
    return mine, out / f"{part.part}-of-{part.parts}"


@click.command()
@click.argument("file", type=FILES, metavar="FILE")
@option(
    "parameter given",
    "A physical parameter, or what the problem pins, and its values; or NAME=V,V,...; several change together.",
    multiple=True, required=True, metavar="NAME=FROM:TO:COUNT",
)  # fmt: skip
@workers_option()
@shard_option("Visit the K-th of N runs of values only")
@option("orbits/--no-orbits", "Write each orbit too, DIR/<name>/K/.", True)
@usual("Folder for DIR/<name>/sweep.csv, sweep.json and orbits.", "sweeps", compiled=True)
def sweep(
    file: Path, given: tuple[str, ...], out: Path, orbits: bool, limit: float | None, trust: bool, shard: str | None,
    **how: Any,
) -> None:  # fmt: skip
    """Find the orbit of a problem FILE at each value of a parameter, starting from the one at the value before.

    Writes a table with a line a value: certified with its numbers, or the reason why not. A run that was killed goes
    on where it stopped when the same command is given again, or with more values. Exit code 0: all certified.

    \b
    Examples:
      orbitfinder sweep problems/gallery/spring-pendulum-swing.toml --parameter stiffness=26:34:100
      orbitfinder sweep problems/examples/double-mode-2.toml --parameter energy=-19,-18.5,-18 --no-orbits
    """
    values = dict(parameter(word) for word in given)
    if len(values) < len(given):
        raise InputError("--parameter: the same name twice; give each once")
    with limited(limit):
        from orbitfinder.exports.tables import table_bytes
        from orbitfinder.orbits.sweep import CODEC, SweepRecord
        from orbitfinder.problemfile.read import load_problem_file
        from orbitfinder.records.reading import finite, write_atomically

        def save(swept: Sweep, path: Path) -> list[Path]:
            """The table and, in the folder that goes with it, the orbits; all of the files."""
            home = path.parent if path.stem == "sweep" else path.with_suffix("")
            files = [of.save_orbit(orbit, home / orbit.name / "orbit.json") for orbit in swept.orbits if orbits]
            write_atomically(path.with_suffix(".csv"), table_bytes(swept.tables()["points"], "csv"))
            record = SweepRecord(problem.name, problem.model.system, tuple(values), tuple(finite(swept.records)))
            return [path.with_suffix(".csv"), CODEC.save(record, path), *files]

        values, out = sharded(values, shard, out)
        problem = load_problem_file(file, trust).wanted
        folder = folder_of(out, problem.name)
        with kept(folder / "sweep.json", save), display(f"{problem.name}: {', '.join(values)} by turns") as shown:
            left = time_left()

            def report(row: Row, done: int, total: int) -> None:
                place = placed(row, problem.model.system, 6)
                shown.say(f"{done} of {total}: {place}, {said(row, problem.model.system)}{left(done, total)}")

            made = of.sweep(problem, values, limit=None, progress=report, out=out, folder=trusted(file, trust), **how)
    written = save(made, folder / "sweep.json")
    for row in made.rows:
        if not row.certified:
            text(f"{placed(row, problem.model.system, 9)}: {row.reason}")
    text(f"{written[0]}: {made.certified} of {len(made.rows)} certified, {made.seconds:.1f} s")
    document = {"name": problem.name, "rows": made.records, "written": written}
    finish("sweep", document, made.certified == len(made.rows))


def placed(row: Row, system: Table, digits: int) -> str:
    """The values of a row in words."""
    from orbitfinder.mechanics.scales import measured

    told = {"period": "time"}
    return ", ".join(f"{k} = {measured(x, told.get(k, k), system, digits)}" for k, x in row.values.items())


def said(row: Row, system: Table) -> str:
    """What became of a value, in a few words."""
    from orbitfinder.mechanics.scales import lasting

    if row.orbit is None or not row.certified:
        return row.reason
    return f"period {lasting(row.orbit.period, system, 9)}, {row.orbit.stability}"


def parameter(given: str) -> tuple[str, list[float]]:
    """The name and values of NAME=FROM:TO:COUNT or NAME=V,V,... Raises `InputError`."""
    name, equals, numbers = given.partition("=")
    try:
        if numbers.count(":") == 2:
            first, last, count = numbers.split(":")
            if not 1 <= int(count) <= 1_000_000:
                raise ValueError(f"{count} values, give 1 to 1000000")
            return name.strip(), np.linspace(float(first), float(last), int(count)).tolist()
        if not equals:
            raise ValueError("no =")
        return name.strip(), [*map(float, numbers.split(","))]
    except ValueError as error:
        raise InputError(
            f"--parameter: {given[:60]!r} names no values ({error}); give NAME=FROM:TO:COUNT or NAME=V,V,..."
        ) from error
