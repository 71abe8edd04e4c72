"""The command `export`: orbits for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from orbitfinder.cli.options import SYSTEM_TRUST, orbit_files, out_option, trust_option
from orbitfinder.errors import InputError


@click.command()
@orbit_files
@click.option("--to", required=True, type=click.Choice(["csv", "auto", "julia", "c"]), help="What to write.")
@out_option("Folder for the files; default: beside each ORBIT.json.")
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
    from orbitfinder.cli.jobs import check_writable, named_orbits
    from orbitfinder.exports.write import export_orbit

    seen: dict[str, Path] = {}
    orbits = named_orbits(files, trust)
    for file, orbit, _ in orbits:
        if out is not None and seen.setdefault(orbit.name, file) != file:
            both = f"{seen[orbit.name]} and {file} are both named {orbit.name!r}"
            raise InputError(f"--out: {both}; export one at a time")
    for file, orbit, model in orbits:
        folder = file.parent if out is None else out
        check_writable(folder)
        for written in export_orbit(orbit, to, folder, model):
            click.echo(str(written))
