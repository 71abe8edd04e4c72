"""The command `torus`: invariant tori around an elliptic orbit, single or a family."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import orbitfinder as of
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.console import display, way_left
from orbitfinder.cli.jobs import folder_of, orbit_and_model
from orbitfinder.cli.options import FILES, FINITE, finish, option, picked, text, usual
from orbitfinder.errors import InputError
from orbitfinder.records.certificate import certificate_to_document, certified
from orbitfinder.records.registry import held, load, load_orbit


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K|TORI.json#K")
@option("until", "Stop at this rotation number, energy or parameter.", kind=FINITE)
@option("hold", "What stays.  [default: energy]", kind=("energy", "rotation"))
@option("parameter", "Of a system without energy: the physical parameter to follow in.")
@option("mode", "Which pair of multipliers.", 1, (1,))
@option("points", "Tori at most.", 100, (1, 10_000))
@option("states most_states", "Of a curve, at most.", 151, (17, 1001))
@option("name", "Name of the family; the orbit's and -tori when left out.")
@usual("Folder for DIR/<name>/tori.json and figures.", "tori", figures="Draw the tori.", compiled=True)
def torus(
    file: Path, until: float | None, name: str | None, points: int, most_states: int, out: Path, figures: bool,
    trust: bool, **how: Any,
) -> None:  # fmt: skip
    """Follow the invariant tori (quasi-periodic motions) around the elliptic orbit of an ORBIT.json.

    At the orbit's energy in the rotation number (turns that a return takes the torus round), until --until or until
    the torus breaks down; from a torus of a TORI.json with --hold rotation in the energy. Each is certified by
    another integrator between the points that it was solved at. Exit code 0: all certified and --until reached. A run
    that was killed goes on where it stopped when the same command is given again, or with other --points or --until.

    \b
    Examples:
      orbitfinder torus orbits/henon-heiles-loop/orbit.json --until 0.2071
      orbitfinder torus tori/henon-heiles-loop-tori/tori.json#4 --hold rotation --until 0.13 --name golden
    """
    from orbitfinder.show.tori import save_torus_figures
    from orbitfinder.structures.tori import torus_value

    origin, model = orbit_and_model(file, trust, read=load if held(file)[0] == "tori" else load_orbit)
    label = f"{origin.name}-tori"
    if isinstance(origin, of.Tori):
        if len(origin.tori) > 1:
            many = len(origin.tori)
            raise InputError(f"file: {file} holds {many} tori; give one of them, {file}#{many - 1}")
        label, origin = f"{origin.name}-on", origin.tori[0]
    folder, left = folder_of(out, name or label), way_left(points, until)
    along = how["parameter"] or ("energy" if how["hold"] == "rotation" else "rotation")
    with display(f"{folder.name}: tori from {file}") as shown, kept(folder / "tori.json", of.save_tori):

        def report(torus: of.Torus) -> None:
            words = f"rotation {torus.rotation:.9g}, energy {torus.energy:.9g}, {len(torus.curve)} states"
            shown.say(words + left(torus_value(torus, along)))

        family = of.follow_tori(
            origin, until=until, model=model, progress=report, name=folder.name, out=out,
            settings=of.TorusSettings(points=points, most_states=most_states), **how,
        )  # fmt: skip
        written = [of.save_tori(family, folder / "tori.json")]
    written += save_torus_figures(family, folder, model) if figures else []
    last, sure = family.tori[-1], sum(map(certified, family.tori))
    arrived = until is None or abs(torus_value(last, family.parameter) - until) <= 1e-9 * max(1.0, abs(until))
    text(f"T = {last.period:.12g} s, {last.rotation:.12g} turns a return, energy {last.energy:.12g}")
    text("angular frequencies {:.12g} and {:.12g} rad/s".format(*last.frequencies))
    text(f"{written[0]}: {len(family.tori)} tori, {sure} certified; {family.end}")
    rows = [
        {**row, **torus.free, "certificate": certificate_to_document(torus.certificate)}
        for row, torus in zip(picked(family.tori, "period rotation energy strip"), family.tori, strict=True)
    ]
    document = {"name": folder.name, "tori": rows, "end": family.end, "written": written}
    finish("torus", document, arrived and sure == len(family.tori))
