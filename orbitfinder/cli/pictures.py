"""The commands `plot` and `animate`: pictures of orbits."""

from __future__ import annotations

from pathlib import Path

import click

from orbitfinder.cli.options import SYSTEM_TRUST, orbit_files, out_option, trust_option
from orbitfinder.errors import InputError


@click.command()
@orbit_files
@out_option("Folder for the figures; default: beside each file.")
@trust_option(SYSTEM_TRUST)
def plot(files: tuple[Path, ...], out: Path | None, trust: bool) -> None:
    """Draw the figures of each ORBIT.json: histories, phase portraits, configurations, energy.

    FILE#K is point K of a family.json, counted from 0, or orbit K of an atlas.

    \b
    Example:
      orbitfinder plot orbits/triple-1/orbit.json -o figures
    """
    from orbitfinder.cli.jobs import check_writable, named_orbits
    from orbitfinder.show.plot import save_figures

    orbits = named_orbits(files, trust)
    for file, orbit, model in orbits:
        beside = file.parent if file.exists() else file.parent / orbit.name
        folder = beside if out is None else (out if len(orbits) == 1 else out / orbit.name)
        check_writable(folder)
        for written in save_figures(orbit, folder, model):
            click.echo(str(written))


@click.command()
@orbit_files
@out_option("A .gif or .mp4 file (one orbit), or a folder; default: beside each file.")
@trust_option(SYSTEM_TRUST)
def animate(files: tuple[Path, ...], out: Path | None, trust: bool) -> None:
    """Animate each ORBIT.json in real time over whole periods, as a GIF (or MP4 with the extra `mp4`).

    FILE#K is point K of a family.json, counted from 0, or orbit K of an atlas.

    \b
    Examples:
      orbitfinder animate orbits/triple-1/orbit.json
      orbitfinder animate orbits/triple-1/orbit.json -o triple-1.mp4
    """
    from orbitfinder.cli.jobs import check_writable, named_orbits
    from orbitfinder.show.animate import check_suffix, orbit_clip, save_animation

    single = out if out is not None and out.suffix and not out.is_dir() else None
    if single is not None:
        check_suffix(single)
        if len(files) > 1:
            raise InputError(f"--out: {out} is one file for {len(files)} orbits; name a folder")
    for file, orbit, model in named_orbits(files, trust):
        target = single or (out or file.parent) / f"{orbit.name}.gif"
        check_writable(target.parent)
        click.echo(str(save_animation(orbit_clip(orbit, model), target)))
