"""The command `equilibria`: states of rest along a parameter."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, cast

import click

import orbitfinder as of
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.console import Display, display
from orbitfinder.cli.jobs import folder_of
from orbitfinder.cli.options import FILES, FINITE, finish, next_step, option, text, usual
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.records.registry import answer


@click.command()
@click.argument("file", type=FILES)
@option("parameter", "The physical parameter to follow in.", required=True)
@option("until", "Its value to stop at; without one both ways are gone.", kind=FINITE)
@option("at", "A value at which an equilibrium is computed exactly; may be given again.", kind=FINITE, multiple=True)
@option("points", "The most in each direction.", 400, (1, 100_000))
@option("box", "From where to where of each component equilibria are looked for, such as V=-80:40; each curve through "
        "one is followed.", multiple=True, metavar="NAME=LOW:HIGH")  # fmt: skip
@option("name", "Name of the curve; the file's when left out.")
@usual("Folder for DIR/<name>/equilibria.json.", "equilibria")
def equilibria(
    file: Path, parameter: str, until: float | None, at: tuple[float, ...], points: int, box: tuple[str, ...],
    name: str | None, out: Path, trust: bool,
) -> None:  # fmt: skip
    """Follow the equilibria of the system of a problem FILE, with folds, branch points and Hopf points.

    From the equilibrium near the state of its [guess] or [simulate], or where a simulation from there comes to rest;
    or from all that are met in a box (--box), which proves no completeness, the second curve as NAME-2. Each is
    certified by differences of the rates, each event by the flow. Exit code 0: all certified, each change of
    stability explained, and --until reached. A run that was killed goes on where it stopped when the same command is
    given again.

    \b
    Examples:
      orbitfinder equilibria problems/gallery/brusselator.toml --parameter rate --until 1.5
      orbitfinder equilibria wells.toml --parameter tilt --until 1 --box x=-2:2
    """
    from orbitfinder.problemfile.read import load_problem_file

    loaded = load_problem_file(file, trust)
    if loaded.start is None and not box:
        raise InputError(f"{file}: guess: missing; give the state near an equilibrium, [guess] or [simulate] state")
    name = name or loaded.name
    with display(f"{name}: equilibria of {file}") as shown:
        if box:
            results = list(
                _from_a_box((loaded.model, loaded.title), box, parameter, until, at, points, out, name, shown)
            )
            document, whole = {"results": [told for told, _ in results]}, all(good for _, good in results)
        else:
            origin = loaded.model, loaded.start, loaded.title
            _, document, whole = followed_rest(origin, parameter, until, at, points, out, name, shown)
    finish("equilibria", document, whole)


def _from_a_box(
    system: tuple[of.Model, str], box: tuple[str, ...], parameter: str, until: float | None, at: tuple[float, ...],
    points: int, out: Path, name: str, shown: Display,
) -> Iterator[tuple[dict[str, Any], bool]]:  # fmt: skip
    """Follow every curve through equilibria in a box, what is told of each and whether it is whole."""
    import numpy as np

    model, title = system
    there = of.find_equilibria(model, dict(map(side, box)), parameter)
    if not there:
        raise ConvergenceError("no equilibrium was met in the box; give a larger one")
    begun, passed, curves = there[0].value, list[Any](), 0
    size = np.abs([rest.state for rest in there]).max(axis=0)
    met = "1 equilibrium was" if len(there) == 1 else f"{len(there)} equilibria were"
    text(f"{met} met in the box at {parameter} = {begun:.9g}, which proves no completeness")
    for rest in there:
        if any((np.abs(rest.state - other) <= 1e-6 * size).all() for other in passed):
            continue
        curves += 1
        label = name if curves == 1 else f"{name}-{curves}"
        origin = model, rest.state, title
        curve, told, whole = followed_rest(origin, parameter, until, (*at, begun), points, out, label, shown)
        passed += [point.state for point in curve.points if point.value == begun]
        yield told, whole


def side(given: str) -> tuple[str, tuple[float, float]]:
    """NAME=LOW:HIGH. `InputError` for anything else."""
    name, _, sides = given.partition("=")
    with contextlib.suppress(ValueError):
        low, high = map(float, sides.split(":"))
        return name.strip(), (low, high)
    raise InputError(f"--box: {given!r} is not NAME=LOW:HIGH; give a component and two numbers, such as V=-80:40")


def followed_rest(
    origin: Any, parameter: str | None, until: float | None, at: tuple[float, ...], points: int, out: Path,
    name: str | None, shown: Display, figures: bool = False,
) -> tuple[of.Equilibria, dict[str, Any], bool]:  # fmt: skip
    """Follow equilibria from (model, state, title) or a branch of them, or a curve of them in two parameters, write and
    tell them: what `--json` says of them, and whether all is certified and they arrived."""
    if isinstance(origin, partial):
        follow, name, parameter = origin, origin.keywords["name"], origin.args[2][0]
    else:
        *given, title = origin if isinstance(origin, tuple) else (origin, None, origin.title)
        parameter = parameter or origin.parameter
        follow = partial(cast(Any, of.follow_equilibria), *given, parameter, title=title)
    folder = folder_of(out, name or origin.name)
    with kept(folder / "equilibria.json", of.save_equilibria):
        curve = follow(
            until=until, at=at, points=points, name=folder.name, out=out,
            progress=lambda rest: shown.say(f"{parameter} {rest.value:.9g}, {rest.kind or rest.stability}"),
        )  # fmt: skip
        written = [of.save_equilibria(curve, folder / "equilibria.json")]
    written += answer("plot", written[0])(curve, folder, None) if figures and curve.curve else []
    sure = sum(point.certified for point in curve.points)
    true = sum(event.check is not None and event.check.passed for event in curve.events)
    from orbitfinder.mechanics.scales import lasting, measured

    text(f"{written[0]}: {len(curve.points)} equilibria, {sure} certified; {curve.ends[-1].reason}")
    for line in curve.unknown:
        text(f"  {line}")
    for k, event in enumerate(curve.events):
        place = measured(event.parameter, parameter, curve.system, 12)
        line = f"  {k} {event.words} at {parameter} = {place} +- {event.error:.1g}"
        if curve.curve:
            second = curve.parameters[1]
            place = measured(event.values[1], second, curve.system, 12)
            line += f", {second} = {place} +- {event.errors[1]:.1g}"
            numbers = [f"{name} = {value:.6g}" for name, value in event.normal_form.items()]
            line += f"; normal form: {', '.join(numbers)}" if numbers else ""
        if event.period > 0:
            line += f", period {lasting(event.period, curve.system)}, l1 = {event.lyapunov:.6g}"
        text(line)
    if leaving := [k for k, event in enumerate(curve.events) if event.direction.size]:
        next_step("continue", written[0], "--switch", leaving[0])
    document = {"name": folder.name, "parameter": parameter, "points": len(curve.points), "certified": sure,
                "events": curve.events, "unknown": curve.unknown, "ends": curve.ends, "written": written}  # fmt: skip
    arrived = until is None or until in (curve.points[0].value, curve.points[-1].value)
    whole = sure == len(curve.points) and true == len(curve.events) and not curve.unknown
    return curve, document, arrived and whole
