"""Commands that make pictures: `reproduce`, `plot`, `animate`."""

from __future__ import annotations

from pathlib import Path

import click

from orbitfinder._runtime import interrupt
from orbitfinder.cli.options import FILES, SYSTEM_TRUST, compile_option, trust_option
from orbitfinder.errors import InputError


@click.command()
@click.option("--out", default="results/report", show_default=True, type=FILES, help="Folder for the page and figures.")
@click.option("--fresh", is_flag=True, help="Compute every part again, also those already finished.")
@compile_option
def reproduce(out: Path, fresh: bool) -> None:
    """Reproduce the whole MATLAB report: figures, orbits, animations and a page beside it.

    Can be interrupted and run again: finished parts are kept. Takes a minute or two.

    \b
    Examples:
      orbitfinder reproduce
      orbitfinder reproduce --out /tmp/report --fresh
    """
    import time

    from orbitfinder.cli.console import display
    from orbitfinder.cli.jobs import check_writable
    from orbitfinder.reproduce.runner import reproduce as run_report

    check_writable(out)
    began = time.monotonic()
    with display() as shown:

        def say(what: str, done: int, of: int) -> None:
            interrupt.check()
            shown.say(f"[{done}/{of}] {what} ({time.monotonic() - began:.0f} s)")

        numbers = run_report(out, fresh, say)
    orbits = numbers["orbits"].values()
    click.echo(f"{out / 'README.md'}: {sum(one['certified'] for one in orbits)} of {len(orbits)} orbits certified")
    if not all(one["certified"] for one in orbits):
        click.get_current_context().exit(1)


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="ORBIT.json|FILE#K...")
@click.option("-o", "--out", default=None, type=FILES, help="Folder for the figures; default: beside each file.")
@trust_option(SYSTEM_TRUST)
def plot(files: tuple[Path, ...], out: Path | None, trust: bool) -> None:
    """Draw the figures of each ORBIT.json: histories, phase portraits, configurations, energy.

    FILE#K is point K of a family.json, counted from 0, or orbit K of an atlas.

    \b
    Example:
      orbitfinder plot orbits/triple-1/orbit.json -o figures
    """
    from orbitfinder.cli.jobs import check_writable, orbit_and_model
    from orbitfinder.problemfile.read import checked_name
    from orbitfinder.show.plot import save_figures

    orbits = [(file, *orbit_and_model(file, trust, pictured=True)) for file in files]
    for file, orbit, model in orbits:
        name = checked_name(orbit.name, f"{file}: name")
        beside = file.parent if file.exists() else file.parent / name
        folder = beside if out is None else (out if len(orbits) == 1 else out / name)
        check_writable(folder)
        for written in save_figures(orbit, folder, model):
            click.echo(str(written))


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="ORBIT.json|FILE#K...")
@click.option("-o", "--out", default=None, type=FILES, help="A .gif or .mp4 file (one orbit), or a folder.")
@trust_option(SYSTEM_TRUST)
def animate(files: tuple[Path, ...], out: Path | None, trust: bool) -> None:
    """Animate each ORBIT.json in real time over whole periods, as a GIF (or MP4 with the extra `mp4`).

    FILE#K is point K of a family.json, counted from 0, or orbit K of an atlas.

    \b
    Examples:
      orbitfinder animate orbits/triple-1/orbit.json
      orbitfinder animate orbits/triple-1/orbit.json -o triple-1.mp4
    """
    from orbitfinder.cli.jobs import check_writable, orbit_and_model
    from orbitfinder.problemfile.read import checked_name
    from orbitfinder.show.animate import check_suffix, orbit_clip, save_animation

    single = out is not None and bool(out.suffix) and not out.is_dir()
    if single and out is not None:
        check_suffix(out)
    if single and len(files) > 1:
        raise InputError(f"--out: {out} is one file for {len(files)} orbits; name a folder")
    orbits = [(file, *orbit_and_model(file, trust, pictured=True)) for file in files]
    for file, orbit, model in orbits:
        name = checked_name(orbit.name, f"{file}: name")
        if single and out is not None:
            target = out
        else:
            target = (file.parent if out is None else out) / f"{name}.gif"
        check_writable(target.parent)
        click.echo(str(save_animation(orbit_clip(orbit, model), target)))
