"""The command `stabilise`: a controller that holds a motion on an orbit, what it can stand, and its programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import orbitfinder as of
from orbitfinder._runtime.keeping import finished, kept
from orbitfinder.cli.console import note
from orbitfinder.cli.jobs import folder_of, orbit_and_model
from orbitfinder.cli.options import FILES, FINITE, NUMBERS, SYSTEM_TRUST, finish, option, text, usual


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K")
@option("motors", "Joints of a chain or linkage with a motor, from 1; default: the one that is best.", "", NUMBERS,
        metavar="K,K,...")  # fmt: skip
@option("actuator named", "A parameter that acts; may be repeated.", multiple=True, metavar="NAME")
@option("effort", "What controls cost beside deviations, R.", 1.0, FINITE)
@option("saturation", "Greatest magnitude of each control.", kind=FINITE)
@option("clock", "Keep time too, and not only to the orbit.", kind=bool)
@option("sizes", "Disturbances to try, in extents of the orbit.", "0.01,0.03,0.1,0.3", NUMBERS, metavar="V,V,...")
@option("disturbances", "Of each size.", 50, (0, 100_000))
@option("periods", "Periods of each simulation.", 100, (1,))
@option("rate", "Samples a period.", 200, (8,))
@option("noise", "Standard deviation of what is measured, in extents of the orbit.", 0.0, FINITE)
@option("seed", "Of the disturbances and the noise.", 0, (0,))
@option("animate", "Draw a disturbed motion recovering, DIR/<name>/recovery.gif.", kind=bool)
@usual("Folder for DIR/<name>/controller.json and programs.", "controllers", compiled=True, trust=SYSTEM_TRUST)
def stabilise(
    file: Path, motors: tuple[float, ...], named: tuple[str, ...], effort: float, saturation: float | None, clock: bool,
    animate: bool, out: Path, trust: bool, **trial: Any,
) -> None:  # fmt: skip
    """Design feedback that holds a motion on an ORBIT, and measure what disturbances it brings back.

    Which joints can do it is printed, and refused with the reason where they cannot. Writes the controller with its
    certificate (the multipliers of the nonlinear closed loop) and basin, its gains as CSV, and itself in C and Python.
    A walker's step may end with an impact: the law then begins anew after it, and kicks are simulated too.
    A trial that was killed goes on where it stopped when the same command is given again, or with more --periods.
    Exit code 0: stabilised; 1: not.

    \b
    Examples:
      orbitfinder stabilise orbits/triple-1/orbit.json --motors 1
      orbitfinder stabilise orbits/triple-1/orbit.json --saturation 5 --noise 0.001 --animate
    """
    from orbitfinder.mechanics.kind import build_model, system_kind
    from orbitfinder.records.codec import entries_of

    orbit, model = orbit_and_model(file, trust, pictured=True)
    folder = folder_of(out, orbit.name, f"{file}: name")
    chosen = [*(f"torque{joint:g}" for joint in motors), *named] or None
    made = of.stabilise(orbit, chosen, R=effort, limits=saturation, clock=clock or None, model=model)
    own = None if system_kind(orbit.system).described else model
    _print_design(made)
    with kept(folder / "controller.json", of.save_controller):
        designed = made
        finished(lambda: designed)
        if made.stabilised and trial["disturbances"]:
            note(f"{orbit.name}: {len(trial['sizes']) * trial['disturbances']} motions of {trial['periods']} periods")
            made = of.basin(made, model=own, out=out, **trial)
            assert made.basin is not None
            names = "".join(f"{f'peak {name}':>16}{f'rms {name}':>16}" for name in made.actuators)
            near, periods = made.basin.near, made.basin.periods
            text(f"  returned: within {near:.2g} of the disturbance in the last of {periods} periods")
            text(f"  {'size':>8}{'returned':>12}{names}")
            for row in made.basin.rows:
                efforts = "".join(f"{a:>16.4g}{b:>16.4g}" for a, b in zip(row.peak, row.rms, strict=True))
                text(f"  {row.size:>8g}{f'{row.returned}/{row.count}':>12}{efforts}")
        written = [of.save_controller(made, folder / "controller.json")]
    if made.stabilised:
        written += of.export_controller(made, folder, own)
        if animate:
            own = own or build_model(made.system)
            run = of.recovery(made, max(trial["sizes"]), 6, noise=trial["noise"], seed=trial["seed"], model=own)
            title = f"{made.name}, {max(trial['sizes']):g} off, held by {', '.join(made.actuators)}"
            clip = of.simulation_clip(run.times, of.positions(own, run.states), title)
            written.append(of.save_animation(clip, folder / "recovery.gif"))
    for path in written:
        text(str(path))
    document = {name: entry for name, entry in entries_of(made).items() if name not in ("states", "inputs", "gains")}
    finish("stabilise", document | {"written": written}, made.stabilised)


def _print_design(made: of.Controller) -> None:
    for name, power in sorted(made.authority.items(), key=lambda entry: -entry[1]):
        verdict = f"{power:.3g}" if power > 0 else "none: it cannot hold this orbit"
        text(f"  {name:<12} authority {verdict}{'  (acts)' if name in made.actuators else ''}")
    spectra = {"without control": made.open_loop, "with control": made.multipliers}
    for name, multipliers in spectra.items():
        text(f"  multipliers {name}: {', '.join(f'{size:.6g}' for size in map(abs, multipliers))} (moduli)")
    failed = made.certificate.failures if made.certificate else ["unchecked"]
    verdict = "stabilised" if made.stabilised else f"NOT stabilised ({', '.join(failed)})"
    text(f"{made.name}: {verdict} by {', '.join(made.actuators)}")
