"""The command `export`: orbits for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from orbitfinder.cli.options import FILES, SYSTEM_TRUST, trust_option
from orbitfinder.errors import InputError


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="ORBIT.json|FILE#K...")
@click.option("--to", required=True, type=click.Choice(["csv", "auto", "julia", "c"]), help="What to write.")
@click.option("-o", "--out", default=None, type=FILES, help="Folder for the files; default: beside each ORBIT.json.")
@trust_option(SYSTEM_TRUST)
def export(files: tuple[Path, ...], to: str, out: Path | None, trust: bool) -> None:
    """Write each ORBIT.json for another program.

    csv: times and states, as `csv` in [guess] reads them. auto: NAME.f90, c.NAME and NAME.dat for AUTO-07p
    (then: @r NAME). julia: NAME.jl for BifurcationKit.jl. c: the right-hand side in plain C.
    FILE#K is point K of a family.json, counted from 0, or orbit K of an atlas.

    \b
    Examples:
      orbitfinder export orbits/triple-1/orbit.json --to csv
      orbitfinder export orbits/triple-1/orbit.json --to auto -o auto
    """
    from orbitfinder.cli.jobs import check_writable, orbit_and_model
    from orbitfinder.exports.write import export_orbit
    from orbitfinder.problemfile.read import checked_name

    seen: dict[str, Path] = {}
    orbits = [(file, *orbit_and_model(file, trust, pictured=True)) for file in files]
    for file, orbit, _ in orbits:
        checked_name(orbit.name, f"{file}: name")
        if out is not None and seen.setdefault(orbit.name, file) != file:
            both = f"{seen[orbit.name]} and {file} are both named {orbit.name!r}"
            raise InputError(f"--out: {both}; export one at a time")
    for file, orbit, model in orbits:
        folder = file.parent if out is None else out
        check_writable(folder)
        for written in export_orbit(orbit, to, folder, model):
            click.echo(str(written))
