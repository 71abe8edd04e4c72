"""The command `torus`: invariant tori around an elliptic orbit, one or a family."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orbitfinder._runtime import interrupt
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.console import display
from orbitfinder.cli.options import FILES, FINITE, compile_option, finish, json_option, out_option, text, trust_option
from orbitfinder.errors import InputError
from orbitfinder.records.orbit import certificate_to_document
from orbitfinder.records.registry import held, load, load_orbit
from orbitfinder.records.torus import Tori, Torus, save_tori

if TYPE_CHECKING:
    from orbitfinder.mechanics.model import Model
    from orbitfinder.records.orbit import Orbit


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K|TORI.json#K")
@click.option("--until", type=FINITE, default=None, help="Stop at this rotation number, energy or parameter.")
@click.option("--hold", type=click.Choice(("energy", "rotation")), default=None, help="What stays.  [default: energy]")
@click.option("--parameter", default=None, help="Of a system without energy: the physical parameter to follow in.")
@click.option("--mode", type=click.IntRange(1), default=1, show_default=True, help="Which pair of multipliers.")
@click.option("--points", type=click.IntRange(1, 10_000), default=100, show_default=True, help="Tori at most.")
@click.option("--states", type=click.IntRange(17, 1001), default=151, show_default=True, help="Of a curve, at most.")
@click.option("--name", default=None, help="Name of the family; the orbit's and -tori when left out.")
@out_option("Folder for DIR/<name>/tori.json and figures.", default="tori", show_default=True)
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw the tori.")
@compile_option
@trust_option()
@json_option
def torus(
    file: Path, until: float | None, hold: str | None, parameter: str | None, mode: int, points: int, states: int,
    name: str | None, out: Path, figures: bool, trust: bool,
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
    from orbitfinder.cli.jobs import check_writable
    from orbitfinder.families.tori import TorusSettings, follow_tori, torus_value
    from orbitfinder.problemfile.read import checked_name
    from orbitfinder.show.tori import save_torus_figures

    origin, model, label = _origin(file, trust)
    label = name or label
    checked_name(label)
    folder = out / label
    check_writable(folder)
    with display(f"{label}: tori from {file}") as shown:

        def report(one: Torus) -> None:
            interrupt.check()
            shown.say(f"rotation {one.rotation:.9g}, energy {one.energy:.9g}, {len(one.curve)} states")

        with kept(folder / "tori.json", save_tori):
            found = follow_tori(
                origin, until=until, hold=hold, parameter=parameter, mode=mode, model=model, progress=report,
                name=label, settings=TorusSettings(points=points, most_states=states), out=out,
            )  # fmt: skip
            written = [save_tori(found, folder / "tori.json")]
    written += save_torus_figures(found, folder, model) if figures else []
    reached = until is None or abs(torus_value(found.tori[-1], found.parameter) - until) <= 1e-9 * max(1.0, abs(until))
    for one in found.tori[-1:]:
        text(f"T = {one.period:.12g} s, {one.rotation:.12g} turns a return, energy {one.energy:.12g}")
        text("angular frequencies {:.12g} and {:.12g} rad/s".format(*one.frequencies))
    failed = [k for k, one in enumerate(found.tori) if one.certificate is None or not one.certificate.passed]
    text(f"{written[0]}: {len(found.tori)} tori, {len(found.tori) - len(failed)} certified; {found.end}")
    rows = [
        {"period": one.period, "rotation": one.rotation, "energy": one.energy, "strip": one.strip, **one.free,
         "certificate": certificate_to_document(one.certificate)}
        for one in found.tori
    ]  # fmt: skip
    document = {"name": label, "tori": rows, "end": found.end, "written": [str(one) for one in written]}
    finish("torus", document, reached and not failed)


def _origin(file: Path, trust: bool) -> tuple[Orbit | Torus, Model, str]:
    """What the tori begin with, its Model, and a name for them."""
    from orbitfinder.cli.jobs import orbit_and_model

    record, model = orbit_and_model(file, trust, read=load if held(file)[0] == "tori" else load_orbit)
    if not isinstance(record, Tori):
        return record, model, f"{record.name}-tori"
    if len(record.tori) > 1:
        raise InputError(f"file: {file} holds {len(record.tori)} tori; give one of them, {file}#{len(record.tori) - 1}")
    return record.tori[0], model, f"{record.name}-on"
