"""The commands `init` and `guess`: problem files to start from, and what a system offers to start a search from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orbitfinder.cli.options import FILES, finish, option, text, usual
from orbitfinder.errors import InputError, plural

if TYPE_CHECKING:
    from orbitfinder.problemfile.proposals import Proposal


@click.command()
@click.argument("file", type=FILES)
@option("duration", "Simulate this long for close returns, in s.", kind=float)
@option("count", "Close returns to show.", 8, (1, 100))
@option("amplitude", "Largest angle of the modes in rad.", 0.1, float)
@option("pick", "Which one --out takes, such as mode-2 or return-1.", metavar="NAME")
@usual("Write a problem file with one of them, the others as comments.")
def guess(
    file: Path, duration: float | None, count: int, amplitude: float, out: Path | None, pick: str | None,
    trust: bool,
) -> None:  # fmt: skip
    """Show what the system of a problem FILE offers to start a search from.

    Its own guess and how far that is from closed, the linear normal modes of the equilibrium, and the close returns of
    its recorded trajectory or of the motion from its state.

    \b
    Examples:
      orbitfinder guess problems/examples/double-mode-2.toml
      orbitfinder guess my-pendulum.toml --duration 60 --out candidate.toml --pick return-2
    """
    from orbitfinder.problemfile.proposals import propose
    from orbitfinder.problemfile.read import checked_name, load_problem_file
    from orbitfinder.problemfile.write import candidate_text, write_new

    if not amplitude > 0:
        raise InputError(f"--amplitude: must be positive, got {amplitude}; give an angle in rad")
    if pick is not None and out is None:
        raise InputError(f"--pick: {pick!r} is for --out; give a file to write")
    loaded = load_problem_file(file, trust)
    proposals = propose(loaded, duration, count, amplitude)
    written = None
    if out is not None:
        chosen = proposals.named(pick)
        if "csv" in chosen.table and out.parent.resolve() != file.parent.resolve():
            raise InputError(f"--out: {chosen.name} reads {chosen.table['csv']!r} beside {file}; write it there")
        written = write_new(candidate_text(loaded, proposals, chosen, checked_name(out.stem, "--out")), out, "--out")
    text(f"{proposals.name}: {plural(len(proposals.guesses), 'starting point')}")
    for proposal in proposals.guesses:
        text(_line(proposal, proposals.system))
        label = "shape" if "shape" in proposal.details else "state"
        numbers, most = proposal.details.get("shape", proposal.state), 8  # are printed; the rest is in --json
        more = f", ... ({len(numbers)} in all)" if len(numbers) > most else ""
        text(f"    {label} [{', '.join(f'{x:.6g}' for x in numbers[:most])}{more}]")
    for note in proposals.notes:
        text(f"  none: {note}")
    if written is not None:
        text(f"{written}: written; next: orbitfinder run {written}")
    finish("guesses", {
        "name": proposals.name, "states": list(proposals.state_names),
        "guesses": [proposal.document() for proposal in proposals.guesses], "notes": list(proposals.notes),
        "written": str(written) if written else None,
    })  # fmt: skip


def _line(proposal: Proposal, system: Mapping[str, Any]) -> str:
    from orbitfinder.mechanics.scales import lasting, measured, units

    level = "" if proposal.energy is None else f"  energy {measured(proposal.energy, 'energy', system)}"
    miss = "" if proposal.miss is None else f"  misses itself by {proposal.miss:.2e}"
    frequency = proposal.details.get("frequency")
    clock = units(system)["time"]
    often = "Hz" if clock == "s" else f"1/{clock}" * bool(clock)
    return (
        f"  {proposal.name:<10} period {lasting(proposal.period, system, 9)}{level}{miss}"
        + (f"  {frequency:.6g} {often}".rstrip() if frequency else "")
        + (f"  from t = {lasting(proposal.details['time'], system, 4)}" if "time" in proposal.details else "")
        + (f"  {plural(proposal.details['samples'], 'sample')}" if "samples" in proposal.details else "")
    )


@click.command()
@click.argument("name")
def init(name: str) -> None:
    """Write NAME.toml, a commented problem file to start from.

    \b
    Example:
      orbitfinder init my-pendulum && orbitfinder run my-pendulum.toml
    """
    from orbitfinder.problemfile.write import write_template

    path = write_template(name.removesuffix(".toml"))
    click.echo(f"{path}: written; next: orbitfinder run {path}")
