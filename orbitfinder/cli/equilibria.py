"""The command `equilibria`: states of rest along a parameter."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, cast

import click

import orbitfinder as of
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.console import Display, display
from orbitfinder.cli.jobs import folder_of
from orbitfinder.cli.options import FILES, FINITE, finish, next_step, option, text, usual
from orbitfinder.errors import InputError
from orbitfinder.records.registry import answer


@click.command()
@click.argument("file", type=FILES)
@option("parameter", "The physical parameter to follow in.", required=True)
@option("until", "Its value to stop at; without one both ways are gone.", kind=FINITE)
@option("at", "A value at which an equilibrium is computed exactly; may be given again.", kind=FINITE, multiple=True)
@option("points", "The most in each direction.", 400, (1, 100_000))
@option("name", "Name of the curve; the file's when left out.")
@usual("Folder for DIR/<name>/equilibria.json.", "equilibria")
def equilibria(
    file: Path, parameter: str, until: float | None, at: tuple[float, ...], points: int, name: str | None, out: Path,
    trust: bool,
) -> None:  # fmt: skip
    """Follow the equilibria of the system of a problem FILE, with folds, branch points and Hopf points.

    From the equilibrium near the state of its [guess] or [simulate], or where a simulation from there comes to rest.
    Each is certified by differences of the rates, each event by the flow. Exit code 0: all certified and --until
    reached. A run that was killed goes on where it stopped when the same command is given again.

    \b
    Examples:
      orbitfinder equilibria problems/gallery/brusselator.toml --parameter rate --until 1.5
    """
    from orbitfinder.problemfile.read import load_problem_file

    loaded = load_problem_file(file, trust)
    if loaded.start is None:
        raise InputError(f"{file}: guess: missing; give the state near an equilibrium, [guess] or [simulate] state")
    name = name or loaded.name
    with display(f"{name}: equilibria of {file}") as shown:
        followed_rest((loaded.model, loaded.start), parameter, until, at, points, out, name, shown)


def followed_rest(
    origin: Any, parameter: str | None, until: float | None, at: tuple[float, ...], points: int, out: Path,
    name: str | None, shown: Display, figures: bool = False,
) -> None:  # fmt: skip
    """Follow equilibria from (model, state) or a branch of them, or a curve of them in two parameters, write and tell
    them."""
    if isinstance(origin, partial):
        follow, name, parameter = origin, origin.keywords["name"], origin.args[2][0]
    else:
        given = origin if isinstance(origin, tuple) else (origin, None)
        parameter = parameter or origin.parameter
        follow = partial(cast(Any, of.follow_equilibria), *given, parameter)
    folder = folder_of(out, name or origin.name)
    with kept(folder / "equilibria.json", of.save_equilibria):
        found = follow(
            until=until, at=at, points=points, name=folder.name, out=out,
            progress=lambda rest: shown.say(f"{parameter} {rest.value:.9g}, {rest.kind or rest.stability}"),
        )  # fmt: skip
        written = [of.save_equilibria(found, folder / "equilibria.json")]
    written += answer("plot", written[0])(found, folder, None) if figures and found.curve else []
    sure = sum(point.certified for point in found.points)
    true = sum(event.check is not None and event.check.passed for event in found.events)
    text(f"{written[0]}: {len(found.points)} equilibria, {sure} certified; {found.ends[-1].reason}")
    for k, event in enumerate(found.events):
        line = f"  {k} {event.words} at {parameter} = {event.parameter:.12g} +- {event.error:.1g}"
        if found.curve:
            line += f", {found.parameters[1]} = {event.values[1]:.12g} +- {event.errors[1]:.1g}"
            numbers = [f"{name} = {value:.6g}" for name, value in event.normal_form.items()]
            line += f"; normal form: {', '.join(numbers)}" if numbers else ""
        if event.period > 0:
            line += f", period {event.period:.12g}, l1 = {event.lyapunov:.6g}"
        text(line)
    if leaving := [k for k, event in enumerate(found.events) if event.direction.size]:
        next_step("continue", written[0], "--switch", leaving[0])
    document = {"name": folder.name, "parameter": parameter, "points": len(found.points), "certified": sure,
                "events": found.events, "ends": found.ends, "written": written}  # fmt: skip
    arrived = until is None or until in (found.points[0].value, found.points[-1].value)
    finish("equilibria", document, arrived and sure == len(found.points) and true == len(found.events))
