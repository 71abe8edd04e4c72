"""The command `stabilise`: a controller that holds a motion on an orbit, what it can stand, and its programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orbitfinder._runtime.keeping import finished, kept
from orbitfinder.cli.console import note
from orbitfinder.cli.jobs import check_writable, orbit_and_model
from orbitfinder.cli.options import (
    FILES,
    FINITE,
    SYSTEM_TRUST,
    compile_option,
    finish,
    json_option,
    out_option,
    text,
    trust_option,
)
from orbitfinder.errors import InputError

if TYPE_CHECKING:
    from orbitfinder.mechanics.model import Model
    from orbitfinder.records.controller import Controller


def _numbers(_: click.Context, parameter: click.Parameter, given: str) -> list[float]:
    """Numbers between commas. Raises `InputError`."""
    try:
        return [float(word) for word in given.split(",") if word.strip()]
    except ValueError as error:
        raise InputError(f"{parameter.opts[-1]}: {given[:60]!r} are no numbers; give V,V,...") from error


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K")
@click.option("--motors", default="", callback=_numbers, metavar="K,K,...",
              help="Joints of a chain or linkage with a motor, from 1; default: the one that is best.")  # fmt: skip
@click.option("--actuator", "named", multiple=True, metavar="NAME", help="A parameter that acts; may be repeated.")
@click.option("--effort", type=FINITE, default=1.0, show_default=True, help="What controls cost beside deviations, R.")
@click.option("--saturation", type=FINITE, default=None, help="Greatest magnitude of each control.")
@click.option("--clock", is_flag=True, help="Keep time too, and not only to the orbit.")
@click.option("--sizes", default="0.01,0.03,0.1,0.3", show_default=True, callback=_numbers, metavar="V,V,...",
              help="Disturbances to try, in extents of the orbit.")  # fmt: skip
@click.option("--disturbances", type=click.IntRange(0, 100_000), default=50, show_default=True, help="Of each size.")
@click.option("--periods", type=click.IntRange(1), default=100, show_default=True, help="Periods of each simulation.")
@click.option("--rate", type=click.IntRange(8), default=200, show_default=True, help="Samples a period.")
@click.option("--noise", type=FINITE, default=0.0, show_default=True,
              help="Standard deviation of what is measured, in extents of the orbit.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the disturbances and the noise.")
@click.option("--animate", is_flag=True, help="Draw a disturbed motion recovering, DIR/<name>/recovery.gif.")
@out_option("Folder for DIR/<name>/controller.json and programs.", default="controllers", show_default=True)
@compile_option
@trust_option(SYSTEM_TRUST)
@json_option
def stabilise(
    file: Path, motors: list[float], named: tuple[str, ...], effort: float, saturation: float | None, clock: bool,
    sizes: list[float], disturbances: int, periods: int, rate: int, noise: float, seed: int, animate: bool, out: Path,
    trust: bool,
) -> None:  # fmt: skip
    """Design feedback that holds a motion on an ORBIT, and measure what disturbances it brings back.

    Which joints can do it is printed, and refused with the reason where they cannot. Writes the controller with its
    certificate (the multipliers of the nonlinear closed loop) and basin, its gains as CSV, and itself in C and Python.
    A trial that was killed goes on where it stopped when the same command is given again, or with more --periods.
    Exit code 0: stabilised; 1: not.

    \b
    Examples:
      orbitfinder stabilise orbits/triple-1/orbit.json --motors 1
      orbitfinder stabilise orbits/triple-1/orbit.json --saturation 5 --noise 0.001 --animate
    """
    from orbitfinder.exports.controller import export_controller
    from orbitfinder.mechanics.catalogue import REBUILDABLE
    from orbitfinder.orbits.basin import basin
    from orbitfinder.orbits.feedback import stabilise as stabilised
    from orbitfinder.problemfile.read import checked_name
    from orbitfinder.records.codec import entries_of
    from orbitfinder.records.controller import save_controller

    orbit, model = orbit_and_model(file, trust, pictured=True)
    checked_name(orbit.name, f"{file}: name")
    folder = out / orbit.name
    check_writable(folder)
    chosen = [*(f"torque{one:g}" for one in motors), *named] or None
    made = stabilised(orbit, chosen, R=effort, limits=saturation, clock=clock or None, model=model)
    own = None if orbit.system.get("kind") in REBUILDABLE else model
    _print_design(made)
    with kept(folder / "controller.json", save_controller):
        designed = made
        finished(lambda: designed)
        if made.stabilised and disturbances:
            note(f"{orbit.name}: {len(sizes) * disturbances} motions of {periods} periods")
            made = basin(made, sizes, disturbances, periods, noise=noise, rate=rate, seed=seed, model=own, out=out)
            _print_basin(made)
        written = [save_controller(made, folder / "controller.json")]
    if made.stabilised:
        written += export_controller(made, folder, own)
        if animate:
            written.append(_animated(made, own, max(sizes), noise, seed, folder / "recovery.gif"))
    for one in written:
        text(str(one))
    document = {name: entry for name, entry in entries_of(made).items() if name not in ("states", "inputs", "gains")}
    finish("stabilise", document | {"written": [str(one) for one in written]}, made.stabilised)


def _print_design(made: Controller) -> None:
    for name, power in sorted(made.authority.items(), key=lambda one: -one[1]):
        verdict = f"{power:.3g}" if power > 0 else "none: it cannot hold this orbit"
        text(f"  {name:<12} authority {verdict}{'  (acts)' if name in made.actuators else ''}")
    spectra = {"without control": made.open_loop, "with control": made.multipliers}
    for name, found in spectra.items():
        text(f"  multipliers {name}: " + ", ".join(f"{abs(one):.6g}" for one in found) + " (moduli)")
    verdict = "stabilised" if made.stabilised else f"NOT stabilised ({', '.join(_failed(made))})"
    text(f"{made.name}: {verdict} by {', '.join(made.actuators)}")


def _failed(made: Controller) -> list[str]:
    return [one.name for one in made.certificate.checks if not one.passed] if made.certificate else ["unchecked"]


def _print_basin(made: Controller) -> None:
    assert made.basin is not None
    names = "".join(f"{f'peak {name}':>16}{f'rms {name}':>16}" for name in made.actuators)
    text(f"  returned: within {made.basin.near:.2g} of the disturbance in the last of {made.basin.periods} periods")
    text(f"  {'size':>8}{'returned':>12}{names}")
    for row in made.basin.rows:
        efforts = "".join(f"{a:>16.4g}{b:>16.4g}" for a, b in zip(row.peak, row.rms, strict=True))
        text(f"  {row.size:>8g}{f'{row.returned}/{row.count}':>12}{efforts}")


def _animated(made: Controller, model: Model | None, size: float, noise: float, seed: int, target: Path) -> Path:
    """A picture that moves of a disturbed motion recovering."""
    from orbitfinder.mechanics.catalogue import build_model
    from orbitfinder.mechanics.model import positions
    from orbitfinder.orbits.basin import recovery
    from orbitfinder.show.animate import save_animation, simulation_clip

    model = model or build_model(made.system)
    run = recovery(made, size, 6, noise=noise, seed=seed, model=model)
    title = f"{made.name}, {size:g} off, held by {', '.join(made.actuators)}"
    return save_animation(simulation_clip(run.times, positions(model, run.states), title), target)
