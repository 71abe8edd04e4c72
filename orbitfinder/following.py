"""The command `continue`: a family of orbits from an orbit or a problem, with live progress."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orbitfinder import interrupt
from orbitfinder.compileoption import compile_option
from orbitfinder.errors import InputError

if TYPE_CHECKING:
    from orbitfinder.families.points import Batch
    from orbitfinder.periodic.orbit import Orbit
    from orbitfinder.periodic.problem import Problem

FILES = click.Path(path_type=Path)


def numbers(text: str) -> tuple[float, ...]:
    """Values of a comma-separated list; `InputError` names the one that is no number."""
    found = []
    for word in filter(None, (part.strip() for part in text.split(","))):
        try:
            found.append(float(word))
        except ValueError as error:
            raise InputError(f"--at: {word!r} is not a number; give values separated by commas") from error
    return tuple(found)


def origin_of(file: Path, trust: bool) -> Orbit | Problem:
    """The Orbit of an orbit.json, or the Problem of any other file."""
    from orbitfinder.periodic.orbit import load_orbit
    from orbitfinder.problemfile import load_problem
    from orbitfinder.schema import check_name

    if file.suffix != ".json":
        return load_problem(file, trust)
    orbit = load_orbit(file)
    check_name(orbit.name)
    return orbit


@click.command(name="continue")
@click.argument("file", type=FILES, metavar="FILE|ORBIT.json")
@click.option("--parameter", default="energy", show_default=True, help="energy, period or a physical parameter.")
@click.option("--until", type=float, default=None, help="Stop when the parameter reaches this value.")
@click.option("--at", default="", metavar="V,V,...", help="Compute points exactly at these values of the parameter.")
@click.option("--points", default=300, show_default=True, type=click.IntRange(1, 1_000_000), help="Points each way.")
@click.option("--out", default="families", show_default=True, type=FILES, help="Folder for DIR/<name>/family.json.")
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw the family.")
@compile_option
@click.option("--trust", is_flag=True, help="Execute Python problem files; only for files you have read.")
def follow(
    file: Path, parameter: str, until: float | None, at: str, points: int, out: Path, figures: bool, trust: bool
) -> None:
    """Follow the family of orbits through an ORBIT.json or the orbit of a problem FILE.

    Both ways along the family unless --until or --at say where to go. Folds, branch points, period
    doublings, resonances, collisions and stability changes are located. A run that was killed goes on
    where it stopped when the same command is given again.

    \b
    Examples:
      orbitfinder continue problems/families/triple-mode-2.toml --until -3
      orbitfinder continue orbits/triple-1/orbit.json --at -38,-37,-36 --out families
    """
    from orbitfinder.console import display
    from orbitfinder.families.command import continue_command
    from orbitfinder.runner import check_writable
    from orbitfinder.show.family_plot import save_family_figures

    origin, values = origin_of(file, trust), numbers(at)
    check_writable(out / origin.name)
    began, seen = time.monotonic(), [0]
    with display() as shown:

        def report(batch: Batch) -> None:
            interrupt.check()
            seen[0] += len(batch.points)
            for event in batch.events:
                shown.say(f"{event.kind} {event.detail}".rstrip() + f" at {parameter} {event.parameter:.9g}")
            if batch.points and seen[0] % 10 < len(batch.points):
                shown.say(progress_line(batch, parameter, seen[0], time.monotonic() - began))
            if batch.end:
                shown.say(f"end: {batch.end.reason}")

        family = continue_command(origin, parameter, until, values, points, out, report)
    folder = out / family.name
    written = save_family_figures(family, folder) if figures else []
    click.echo(f"{folder / 'family.json'}: {len(family.points)} certified orbits, {len(family.events)} events")
    for end in family.ends:
        click.echo(f"  ended: {end.kind} ({end.reason})")
    if written:
        click.echo(f"  and {len(written)} figures")


def progress_line(batch: Batch, parameter: str, count: int, elapsed: float) -> str:
    """One step as one line."""
    point = batch.points[-1]
    return (
        f"{count} points, {parameter} {point.value:.6g}, period {point.period:.6g} s, step {point.step:.2g}, "
        f"{point.stability}, {elapsed:.1f} s elapsed"
    )
