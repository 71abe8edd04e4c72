"""The commands `section`, `manifold` and `connect`: what lies around orbits, and what leads from orbit to orbit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import orbitfinder as of
from orbitfinder._runtime import interrupt
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.console import counted
from orbitfinder.cli.continue_ import origin_of
from orbitfinder.cli.jobs import folder_of, named_orbits, orbit_and_model
from orbitfinder.cli.options import FILES, FINITE, NUMBERS, finish, option, picked, text, usual
from orbitfinder.errors import InputError, plural
from orbitfinder.records.reading import Entries
from orbitfinder.records.registry import held, load, load_orbit

if TYPE_CHECKING:
    from orbitfinder.structures.manifold import Connection
    from orbitfinder.structures.section import Section

DIRECTIONS = {"growing": 1, "falling": -1, "both": 0}
WITH = {"orbit": "orbits", "manifold": "manifolds", "connection": "connections", "tori": "tori"}
"""What a section is drawn with, by its kind"""
MODULES = "Execute Python problem files and modules; only what you have read."


def plane_options(command: Any) -> Any:
    """The options that say which section: --plane, --axes, --direction."""
    command = option("direction", "Of the crossings.", "growing", tuple(DIRECTIONS))(command)
    axes = "The two components to look at (of a tube 2 or 3)."
    command = option("axes", axes, "", metavar="NAME,NAME")(command)
    return option("plane", "The plane; default: by the system.", metavar="NAME=VALUE")(command)


def chosen_plane(plane: str | None, axes: str, direction: str) -> Entries:
    """What --plane, --axes and --direction mean to the library."""
    names = tuple(word.strip() for word in axes.split(",") if word.strip())
    return {"plane": plane, "axes": names or None, "direction": DIRECTIONS[direction]}


@click.command()
@click.argument("file", type=FILES, metavar="FILE|ORBIT.json")
@option("energy", "Energy of the motions; default: the orbit's or the guess's.", kind=FINITE)
@plane_options
@option("seeds", "Motions, begun all over the section.", 40)
@option("returns", "Crossings of each.", 250)
@option("range ranges", "Where motions begin on an axis.", multiple=True, metavar="NAME=LOW:HIGH")
@option("with others", "An orbit, manifold, connection or tori to draw in the section.", kind=FILES, multiple=True,
        metavar="FILE")  # fmt: skip
@option("frequencies", "Frequencies of each motion in both halves of this time, and their diffusion.", kind=FINITE,
        metavar="SECONDS")  # fmt: skip
@usual("Folder for DIR/<name>/section.json, .npz and .png.", "sections", trust=MODULES)
def section(
    file: Path, energy: float | None, seeds: int, returns: int, ranges: tuple[str, ...], others: tuple[Path, ...],
    frequencies: float | None, out: Path, trust: bool, **shown: Any,
) -> None:  # fmt: skip
    """Draw the Poincare section of the system of a problem FILE or an ORBIT.json, at one energy where it has one.

    Regular motions are coloured, chaotic ones grey, undecided ones black. Forced systems are looked at once a period
    of their forcing, hybrid ones after their own events. A run that was killed goes on where it stopped when the same
    command is given again, or with other --seeds or --returns.

    \b
    Examples:
      orbitfinder section problems/examples/double-mode-2.toml --energy -14 --plane theta1=0
      orbitfinder section orbits/lyapunov/orbit.json --plane y=0 --range x=0.5:0.9 --range xdot=-0.3:0.3
    """
    from orbitfinder.mechanics.kind import build_model
    from orbitfinder.show.sections import draw_section
    from orbitfinder.structures.section import save_section

    origin: Any
    origin, model = origin_of(file, trust)
    together = drawn(others, trust)
    folder = folder_of(out, origin.name)
    with kept(folder / "section.json", save_section), counted(f"{origin.name}: section", "returns") as report:
        made = of.section(
            origin, energy, **chosen_plane(**shown), seeds=seeds, returns=returns, ranges=limits(ranges), model=model,
            out=out, progress=report,
        )  # fmt: skip
        interrupt.check()
        written = [save_section(made, folder / "section.json")]
    if isinstance(origin, of.Orbit) and _level(made.energy, origin):
        together["orbits"].insert(0, origin)
    together["tori"] = [torus for torus in together["tori"] if _level(made.energy, torus)]
    model = model or getattr(origin, "model", None)
    written.append(draw_section(made, folder / "section.png", **together, model=model))
    motions, kinds = len(made.starts), {kind: int((made.kinds == kind).sum()) for kind in ("regular", "undecided")}
    level = f" at energy {made.energy:.10g}" if made.energy == made.energy else ""
    counts = f"{plural(made.returns, 'return')} of {plural(motions, 'motion')}"
    told = f", {kinds['regular']} regular, {kinds['undecided']} undecided" if made.told else ""
    text(f"{written[0]}: {counts} to {made.plane}{level}{told}")
    more = {} if frequencies is None else mapped(made, model or build_model(made.system), frequencies, written)
    finish("section", {
        "name": made.name, "plane": made.plane, "energy": made.energy, "returns": made.returns, "motions": motions,
        **kinds, "written": written, **more,
    })  # fmt: skip


def mapped(crossed: Section, model: of.Model, duration: float, written: list[Path]) -> Entries:
    """The frequencies of a section's motions beside it: frequencies.csv and .png."""
    import numpy as np

    from orbitfinder.records.reading import write_atomically
    from orbitfinder.show.frequencies import draw_frequencies
    from orbitfinder.structures.frequencies import frequency_table

    made, folder = of.frequency_map(model, crossed.starts, duration), written[0].parent
    table = folder / "frequencies.csv"
    write_atomically(table, frequency_table(made, model).encode())
    picture = draw_frequencies(
        made, model, folder / "frequencies.png", axes=crossed.axes, name=crossed.title or crossed.name
    )
    written += [table, picture]
    diffusion = made.diffusion
    text(f"{table}: frequencies of {plural(len(crossed.starts), 'motion')}, diffusion from "
         f"{np.nanmin(diffusion):.2g} to {np.nanmax(diffusion):.2g}")  # fmt: skip
    return {"frequencies": made.frequencies, "diffusion": diffusion}


def _level(energy: float, orbit: of.Orbit | of.Torus) -> bool:
    """Whether an orbit or a torus has the energy of a section, or there is none."""
    return energy != energy or abs(energy - orbit.energy) <= 1e-9 * abs(energy)


def limits(given: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """The ranges of NAME=LOW:HIGH. Raises `InputError`."""
    ranges = {}
    for text_ in given:
        name, _, words = text_.partition("=")
        try:
            ranges[name.strip()] = tuple(float(word) for word in words.split(":"))
        except ValueError as error:
            raise InputError(f"--range: {text_[:60]!r} names no range; give NAME=LOW:HIGH") from error
    return ranges


def drawn(files: tuple[Path, ...], trust: bool) -> dict[str, list[Any]]:
    """Orbits, manifolds, connections and tori of files, by what each says that it is."""
    records: dict[str, list[Any]] = {name: [] for name in WITH.values()}
    for file in files:
        kind = held(file)[0]
        record, _ = orbit_and_model(file, trust, True, load if kind in WITH else load_orbit)
        records[WITH[kind]] += record.tori if isinstance(record, of.Tori) else [record]
    return records


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K")
@option("which", "Which manifold.", "both", ("unstable", "stable", "both"))
@plane_options
@option("returns", "Returns grown beyond the orbit's own size.", 2)
@option("side", "1, -1, or 0 for both.", 0, (-1, 1))
@option("number", "Multiplier, the strongest is 0.", 0, (0,))
@option("tube", "Motions for this time, not curves.", kind=FINITE, metavar="SECONDS")
@usual("Folder for DIR/<name>/manifold-WHICH.json, .npz, .csv, .png.", "manifolds", trust=MODULES)
def manifold(
    file: Path, which: str, out: Path, trust: bool, plane: str | None, axes: str, direction: str, **chosen: Any
) -> None:
    """Grow the stable and unstable manifolds of an ORBIT.json, as curves on a section or as tubes.

    They begin on the eigendirections of its monodromy, displaced by a length whose error is measured and printed.

    \b
    Examples:
      orbitfinder manifold orbits/lyapunov/orbit.json --plane y=0 --axes x,xdot --returns 2
      orbitfinder manifold orbits/lyapunov/orbit.json --tube 8
    """
    from orbitfinder.show.sections import draw_manifolds, draw_section
    from orbitfinder.structures.manifold import save_manifold

    ((_, orbit, model),) = named_orbits([file], trust)
    folder = folder_of(out, orbit.name)
    made, written = [], list[Path]()
    seen = chosen_plane(plane, axes, direction)
    if chosen["tube"] is not None:  # looked at from anywhere
        view, seen["axes"] = seen["axes"], None
    for branch in ("unstable", "stable") if which == "both" else (which,):
        made.append(grown := of.manifold(orbit, branch, **seen, **chosen, model=model))
        interrupt.check()
        written.append(save_manifold(grown, folder / f"manifold-{branch}.json"))
        error = f"{grown.error:.2g} off the manifold (order {grown.order:.2f})"
        text(f"{written[-1]}: multiplier {grown.multiplier:.10g}, displaced by {grown.displacement:.2g} of the orbit's "
             f"extents, {error}, {plural(len(grown.states), 'point')}")  # fmt: skip
    if chosen["tube"] is None:
        picture = draw_section(None, folder / "manifolds.png", orbits=[orbit], manifolds=made, model=model)
    else:
        picture = draw_manifolds(made, folder / "manifolds.png", axes=view, orbits=[orbit], model=model)
    entries = [row | {"points": len(grown.states)} for row, grown in zip(
        picked(made, "which multiplier displacement error order"), made, strict=True)]  # fmt: skip
    finish("manifolds", {"name": orbit.name, "manifolds": entries, "written": [*written, picture]})


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K")
@click.argument("other", type=FILES, required=False, metavar="[OTHER.json]")
@plane_options
@option("returns", "Returns grown beyond the orbits' own size.", 1)
@option("most", "Connections, at most.", 8, (1, 1000))
@option("near", "Those nearest to this point of the axes first.", "", NUMBERS, metavar="A,B")
@option("follow known", "Find none, but follow this connection of the same orbits to the energies of --at.", kind=FILES,
        metavar="CONNECTION.json")  # fmt: skip
@option("at", "With --follow: the energies, one after another.", "", NUMBERS, metavar="V,V,...")
@option("name", "Of the folder; the orbits' or the connection's when left out.")
@usual("Folder for DIR/<name>/connection-K.json, .npz and .png.", "connections", trust=MODULES)
def connect(
    file: Path, other: Path | None, near: tuple[float, ...], returns: int, most: int, known: Path | None,
    at: tuple[float, ...], name: str | None, out: Path, trust: bool, **shown: Any,
) -> None:  # fmt: skip
    """Find motions that leave one orbit and come to another of the same energy, or back to it.

    Each is certified by another integrator, with an error of its point; files of others in DIR/<name> stay, new ones
    take the numbers after theirs. Exit code 0: some found, or all energies of --at reached; 1: not. With --follow
    DIR/<name>/connection.jsonl keeps each as it comes: the same command goes on where it was killed, or with more
    energies.

    \b
    Examples:
      orbitfinder connect orbits/lyapunov/orbit.json --plane y=0 --axes x,xdot --direction falling
      orbitfinder connect orbits/l1/orbit.json orbits/l2/orbit.json --plane y=0 --axes x,xdot
      orbitfinder connect orbits/l1/orbit.json --follow connections/l1/connection-1.json --at -1.519,-1.518
    """
    from orbitfinder.show.sections import draw_section
    from orbitfinder.structures.connections import follow_connection
    from orbitfinder.structures.manifold import free_file, load_connection, save_connection

    ((_, orbit, model),) = named_orbits([file], trust)
    goal: of.Orbit | None = None if other is None else named_orbits([other], trust)[0][1]
    if (known is None) != (not at):
        raise InputError("--at: goes with --follow; give the connection and the energies to follow it to")
    start = None if known is None else load_connection(known)
    label = name or (start.name if start else orbit.name if goal is None else f"{orbit.name}-{goal.name}")
    folder = folder_of(out, label)
    written = list[Path]()

    def report(met: Connection) -> None:
        interrupt.check()
        written.append(save_connection(met, free_file(folder, met)))
        place = ", ".join(f"{name} = {met.state[met.state_names.index(name)]:.12g}" for name in met.axes)
        level = "" if start is None else f" of energy {met.energy:.12g}"
        text(f"{written[-1]}: {met.kind}{level} at {place}, error {met.error:.2g}, angle {met.angle:.3g} rad")

    if start is None:
        plane = chosen_plane(**shown)
        connections = of.connect(orbit, goal, **plane, returns=returns, most=most, near=near or None, model=model)
        for connection in connections:
            report(connection)
    else:
        connections = follow_connection(start, orbit, at, goal, model=model, progress=report, name=label, out=out)
    if connections:
        ends = [orbit] if goal is None else [orbit, goal]
        picture = folder / "connections.png"
        written.append(draw_section(None, picture, orbits=ends, connections=connections, model=model))
    elif start is None:
        text(f"no connection of {orbit.name} within {plural(returns, 'return')}; grow more, or look at another plane")
    document = {"connections": picked(connections, "kind state error angle"), "written": written}
    finish("connections", document, bool(connections) if start is None else len(connections) == len(at))
