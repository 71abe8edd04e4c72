"""The command `simulate`: the motion of a problem file's system, and what becomes of its energy."""

from __future__ import annotations

import math
from pathlib import Path

import click

from orbitfinder.cli.options import FILES, finish, json_option, out_option, text, trust_option
from orbitfinder.errors import InputError


@click.command()
@click.argument("file", type=FILES)
@click.option("--duration", type=float, default=None, help="Time in s; default: [simulate] duration or 10.")
@out_option("Write DIR/<name>/simulation.csv.")
@trust_option()
@json_option
def simulate(file: Path, duration: float | None, out: Path | None, trust: bool) -> None:
    """Simulate the system of a problem FILE from its state and report what becomes of the energy.

    \b
    Examples:
      orbitfinder simulate problems/report/triple-1.toml --duration 20
      orbitfinder simulate problems/examples/double.toml --out runs
    """
    from orbitfinder.cli.jobs import check_writable
    from orbitfinder.exports.write import csv_text
    from orbitfinder.orbits.simulate import simulate as simulated
    from orbitfinder.problemfile.read import load_problem_file
    from orbitfinder.records.reading import write_atomically

    loaded = load_problem_file(file, trust)
    if out is not None:
        check_writable(out)
        check_writable(out / loaded.name)
    span = loaded.duration if duration is None else duration
    if not (math.isfinite(span) and span > 0):
        raise InputError(f"--duration: must be positive and finite, got {span}; give a time in s")
    if loaded.start is None:
        raise InputError(f"{file}: simulate.state: missing; give it, or a [guess] to start from")
    result = simulated(loaded.model, loaded.start, span)
    document = {"name": loaded.name} | result.document()
    kind, more = ("drift", "") if result.conserved else ("change", ", which this system does not conserve")
    text(f"{loaded.name}: {result.times[-1]:g} s simulated")
    text(f"  {'energy':<22}{document['energy']:.12g} J")
    text(f"  {f'energy {kind}':<22}{document[f'energy_{kind}']:.2e} J{more}")
    text(f"  {'relative to exchanged':<22}{document[f'relative_energy_{kind}']:.2e}")
    text(f"  {'end state':<22}" + ", ".join(f"{name} = {x:.9g}" for name, x in document["end"].items()))
    if out is not None:
        written = out / loaded.name / "simulation.csv"
        write_atomically(written, csv_text(result.state_names, result.times, result.states).encode())
        document["written"] = str(written)
        text(f"  {written}")
    finish("simulation", document)
