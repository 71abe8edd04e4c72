"""The commands `section`, `manifold` and `connect`: what lies around orbits, and what leads from one to another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orbitfinder._runtime import interrupt
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.continue_ import numbers, origin_of
from orbitfinder.cli.jobs import check_writable, named_orbits, orbit_and_model
from orbitfinder.cli.options import FILES, FINITE, Decorator, finish, json_option, out_option, text, trust_option
from orbitfinder.errors import InputError, plural
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.registry import held, load, load_orbit

if TYPE_CHECKING:
    from orbitfinder.mechanics.model import Model
    from orbitfinder.records.section import Section
    from orbitfinder.records.torus import Torus

DIRECTIONS = {"growing": 1, "falling": -1, "both": 0}
WITH = {"orbit": "orbits", "manifold": "manifolds", "connection": "connections", "tori": "tori"}
"""What a section is drawn with, by its kind"""
MODULES = "Execute Python problem files and modules; only what you have read."


def plane_options(command: Any) -> Any:
    """The options that say which section: --plane, --axes, --direction."""
    which = click.Choice(list(DIRECTIONS))
    options: tuple[Decorator, ...] = (
        click.option("--plane", default=None, metavar="NAME=VALUE", help="The plane; default: by the system."),
        click.option(
            "--axes", default="", metavar="NAME,NAME", help="The two components to look at (of a tube 2 or 3)."
        ),
        click.option("--direction", type=which, default="growing", show_default=True, help="Of the crossings."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def chosen_plane(plane: str | None, axes: str, direction: str) -> dict[str, Any]:
    """What --plane, --axes and --direction mean to the library."""
    names = tuple(word.strip() for word in axes.split(",") if word.strip())
    return {"plane": plane, "axes": names or None, "direction": DIRECTIONS[direction]}


@click.command()
@click.argument("file", type=FILES, metavar="FILE|ORBIT.json")
@click.option("--energy", type=FINITE, default=None, help="Energy of the motions; default: the orbit's or the guess's.")
@plane_options
@click.option("--seeds", default=40, show_default=True, type=int, help="Motions, begun all over the section.")
@click.option("--returns", default=250, show_default=True, type=int, help="Crossings of each.")
@click.option("--range", "ranges", multiple=True, metavar="NAME=LOW:HIGH", help="Where motions begin on an axis.")
@click.option("--with", "others", multiple=True, type=FILES, metavar="FILE",
              help="An orbit, manifold, connection or tori to draw in the section.")  # fmt: skip
@click.option("--frequencies", type=FINITE, default=None, metavar="SECONDS",
              help="Frequencies of each motion in both halves of this time, and their diffusion.")  # fmt: skip
@out_option("Folder for DIR/<name>/section.json, .npz and .png.", default="sections", show_default=True)
@trust_option(MODULES)
@json_option
def section(
    file: Path, energy: float | None, seeds: int, returns: int, ranges: tuple[str, ...], others: tuple[Path, ...],
    frequencies: float | None, out: Path, trust: bool, **shown: Any,
) -> None:  # fmt: skip
    """Draw the Poincare section of the system of a problem FILE or an ORBIT.json, at one energy where it has one.

    Regular motions are coloured, chaotic ones grey. Forced systems are looked at once a period of their forcing,
    hybrid ones after their own events. A run that was killed goes on where it stopped when the same command is given
    again, or with other --seeds or --returns.

    \b
    Examples:
      orbitfinder section problems/examples/double-mode-2.toml --energy -14 --plane theta1=0
      orbitfinder section orbits/lyapunov/orbit.json --plane y=0 --range x=0.5:0.9 --range xdot=-0.3:0.3
    """
    from orbitfinder.families.branches import Branch
    from orbitfinder.mechanics.catalogue import build_model
    from orbitfinder.orbits.section import section as made
    from orbitfinder.records.section import save_section
    from orbitfinder.show.sections import draw_section

    origin, model = origin_of(file, trust)
    if isinstance(origin, Branch):  # pragma: no cover - origin_of asks for --switch before
        raise InputError(f"{file}: a family; give one point of it, {file}#0")
    together = drawn(others, trust)
    folder = out / origin.name
    check_writable(folder)
    with kept(folder / "section.json", save_section):
        found = made(
            origin,
            energy,
            **chosen_plane(**shown),
            seeds=seeds,
            returns=returns,
            ranges=limits(ranges),
            model=model,
            out=out,
        )
        interrupt.check()
        written = [save_section(found, folder / "section.json")]
    if isinstance(origin, Orbit) and _level(found.energy, origin):
        together["orbits"].insert(0, origin)
    together["tori"] = [one for one in together["tori"] if _level(found.energy, one)]
    model = model or getattr(origin, "model", None)
    written.append(draw_section(found, folder / "section.png", **together, model=model))
    regular, motions = int(found.regular.sum()), len(found.starts)
    level = f" at energy {found.energy:.10g}" if found.energy == found.energy else ""
    counts = f"{plural(found.returns, 'return')} of {plural(motions, 'motion')}"
    text(f"{written[0]}: {counts} to {found.plane}{level}, {regular} regular")
    more = {} if frequencies is None else mapped(found, model or build_model(found.system), frequencies, written)
    finish("section", {
        "name": found.name, "plane": found.plane, "energy": found.energy, "returns": found.returns, "motions": motions,
        "regular": regular, "written": [str(one) for one in written], **more,
    })  # fmt: skip


def mapped(found: Section, model: Model, duration: float, written: list[Path]) -> dict[str, Any]:
    """The frequencies of a section's motions beside it: frequencies.csv and .png."""
    import numpy as np

    from orbitfinder.orbits.frequencies import frequency_map, frequency_table
    from orbitfinder.records.reading import write_atomically
    from orbitfinder.show.frequencies import draw_frequencies

    made, folder = frequency_map(model, found.starts, duration), written[0].parent
    table = folder / "frequencies.csv"
    write_atomically(table, frequency_table(made, model).encode())
    picture = draw_frequencies(made, model, folder / "frequencies.png", axes=found.axes, name=found.name)
    written += [table, picture]
    diffusion = made.diffusion
    text(f"{table}: frequencies of {plural(len(found.starts), 'motion')}, diffusion from "
         f"{np.nanmin(diffusion):.2g} to {np.nanmax(diffusion):.2g}")  # fmt: skip
    return {"frequencies": made.frequencies.tolist(), "diffusion": diffusion.tolist()}


def _level(energy: float, orbit: Orbit | Torus) -> bool:
    """Whether an orbit or a torus has the energy of a section, or there is none."""
    return energy != energy or abs(energy - orbit.energy) <= 1e-9 * abs(energy)


def limits(given: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """The ranges of NAME=LOW:HIGH. Raises `InputError`."""
    found = {}
    for one in given:
        name, equals, words = one.partition("=")
        try:
            found[name.strip()] = tuple(float(word) for word in words.split(":"))
        except ValueError as error:
            raise InputError(f"--range: {one[:60]!r} names no range; give NAME=LOW:HIGH") from error
        if not equals:
            raise InputError(f"--range: {one[:60]!r} names no range; give NAME=LOW:HIGH")
    return found


def drawn(files: tuple[Path, ...], trust: bool) -> dict[str, list[Any]]:
    """Orbits, manifolds, connections and tori of files, by what each says that it is."""
    found: dict[str, list[Any]] = {name: [] for name in WITH.values()}
    for file in files:
        kind = held(file)[0]
        record, _ = orbit_and_model(file, trust, True, load if kind in WITH else load_orbit)
        found[WITH[kind]] += record.tori if kind == "tori" else [record]
    return found


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K")
@click.option("--which", type=click.Choice(("unstable", "stable", "both")), default="both", show_default=True,
              help="Which manifold.")  # fmt: skip
@plane_options
@click.option("--returns", default=2, show_default=True, type=int, help="Returns grown beyond the orbit's own size.")
@click.option("--side", type=click.IntRange(-1, 1), default=0, show_default=True, help="1, -1, or 0 for both.")
@click.option("--number", default=0, show_default=True, type=click.IntRange(0), help="Multiplier, the strongest is 0.")
@click.option("--tube", type=FINITE, default=None, metavar="SECONDS", help="Motions for this time, not curves.")
@out_option("Folder for DIR/<name>/manifold-WHICH.json, .npz, .csv, .png.", default="manifolds", show_default=True)
@trust_option(MODULES)
@json_option
def manifold(file: Path, which: str, out: Path, trust: bool, plane: str | None, axes: str, direction: str,
             **chosen: Any) -> None:  # fmt: skip
    """Grow the stable and unstable manifolds of an ORBIT.json, as curves on a section or as tubes.

    They begin on the eigendirections of its monodromy, displaced by a length whose error is measured and printed.

    \b
    Examples:
      orbitfinder manifold orbits/lyapunov/orbit.json --plane y=0 --axes x,xdot --returns 2
      orbitfinder manifold orbits/lyapunov/orbit.json --tube 8
    """
    from orbitfinder.families.manifolds import manifold as grown
    from orbitfinder.records.manifold import save_manifold
    from orbitfinder.show.sections import draw_manifolds, draw_section

    ((_, orbit, model),) = named_orbits([file], trust)
    folder = out / orbit.name
    check_writable(folder)
    made, written = [], []
    seen = chosen_plane(plane, axes, direction)
    if chosen["tube"] is not None:  # looked at from anywhere
        view, seen["axes"] = seen["axes"], None
    for one in ("unstable", "stable") if which == "both" else (which,):
        made.append(grown(orbit, one, **seen, **chosen, model=model))
        interrupt.check()
        written.append(save_manifold(made[-1], folder / f"manifold-{one}.json"))
        found = made[-1]
        error = f"{found.error:.2g} off the manifold (order {found.order:.2f})"
        text(f"{written[-1]}: multiplier {found.multiplier:.10g}, displaced by {found.displacement:.2g} of the orbit's "
             f"extents, {error}, {plural(len(found.states), 'point')}")  # fmt: skip
    if chosen["tube"] is None:
        picture = draw_section(None, folder / "manifolds.png", orbits=[orbit], manifolds=made, model=model)
    else:
        picture = draw_manifolds(made, folder / "manifolds.png", axes=view, orbits=[orbit], model=model)
    entries = [{"which": one.which, "multiplier": one.multiplier, "displacement": one.displacement, "error": one.error,
                "order": one.order, "points": len(one.states)} for one in made]  # fmt: skip
    finish("manifolds", {"name": orbit.name, "manifolds": entries, "written": [*map(str, written), str(picture)]})


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K")
@click.argument("other", type=FILES, required=False, metavar="[OTHER.json]")
@plane_options
@click.option("--returns", default=1, show_default=True, type=int, help="Returns grown beyond the orbits' own size.")
@click.option("--most", default=8, show_default=True, type=click.IntRange(1, 1000), help="Connections, at most.")
@click.option("--near", default="", metavar="A,B", help="Those nearest to this point of the axes first.")
@click.option("--follow", "known", type=FILES, default=None, metavar="CONNECTION.json",
              help="Find none, but follow this connection of the same orbits to the energies of --at.")  # fmt: skip
@click.option("--at", default="", metavar="V,V,...", help="With --follow: the energies, one after another.")
@click.option("--name", default=None, help="Of the folder; the orbits' or the connection's when left out.")
@out_option("Folder for DIR/<name>/connection-K.json, .npz and .png.", default="connections", show_default=True)
@trust_option(MODULES)
@json_option
def connect(file: Path, other: Path | None, near: str, returns: int, most: int, known: Path | None, at: str,
            name: str | None, out: Path, trust: bool, **shown: Any) -> None:  # fmt: skip
    """Find motions that leave one orbit and come to another of the same energy, or back to it.

    Each is certified by another integrator, with an error of its point. Exit code 0: some found, or all energies of
    --at reached; 1: not. With --follow DIR/<name>/connection.jsonl keeps each as it comes: the same command goes on
    where it was killed, or with more energies.

    \b
    Examples:
      orbitfinder connect orbits/lyapunov/orbit.json --plane y=0 --axes x,xdot --direction falling
      orbitfinder connect orbits/l1/orbit.json orbits/l2/orbit.json --plane y=0 --axes x,xdot
      orbitfinder connect orbits/l1/orbit.json --follow connections/l1/connection-1.json --at -1.519,-1.518
    """
    from orbitfinder.families.connections import connect as connected
    from orbitfinder.families.connections import follow_connection
    from orbitfinder.problemfile.read import checked_name
    from orbitfinder.records.manifold import Connection, load_connection, save_connection
    from orbitfinder.show.sections import draw_section

    ((_, orbit, model),) = named_orbits([file], trust)
    goal: Orbit | None = None if other is None else named_orbits([other], trust)[0][1]
    if (known is None) != (not numbers(at)):
        raise InputError("--at: goes with --follow; give the connection and the energies to follow it to")
    start = None if known is None else load_connection(known)
    label = name or (start.name if start else orbit.name if goal is None else f"{orbit.name}-{goal.name}")
    folder = out / checked_name(label)
    check_writable(folder)
    written = list[Path]()

    def report(one: Connection) -> None:
        interrupt.check()
        written.append(save_connection(one, folder / f"connection-{len(written) + 1}.json"))
        place = ", ".join(f"{name} = {one.state[one.state_names.index(name)]:.12g}" for name in one.axes)
        level = "" if start is None else f" of energy {one.energy:.12g}"
        text(f"{written[-1]}: {one.kind}{level} at {place}, error {one.error:.2g}, angle {one.angle:.3g} rad")

    if start is None:
        point = numbers(near) or None
        found = connected(orbit, goal, **chosen_plane(**shown), returns=returns, most=most, near=point, model=model)
        for one in found:
            report(one)
    else:
        found = follow_connection(start, orbit, numbers(at), goal, model=model, progress=report, name=label, out=out)
    if found:
        orbits = [orbit, *([goal] if goal is not None else [])]
        written.append(draw_section(None, folder / "connections.png", orbits=orbits, connections=found, model=model))
    elif start is None:
        text(f"no connection of {orbit.name} within {plural(returns, 'return')}; grow more, or look at another plane")
    entries = [{"kind": one.kind, "state": one.state.tolist(), "error": one.error, "angle": one.angle} for one in found]
    reached = bool(found) if start is None else len(found) == len(numbers(at))
    finish("connections", {"connections": entries, "written": [str(one) for one in written]}, reached)
