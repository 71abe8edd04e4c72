"""The commands `run`, `simulate` and `reproduce`: what problem files, and the report, ask for."""

from __future__ import annotations

import time
from pathlib import Path

import click

import orbitfinder as of
from orbitfinder.cli.console import display
from orbitfinder.cli.jobs import Outcome, check_writable, folder_of, prepare, run_jobs
from orbitfinder.cli.options import FILES, finish, next_step, option, text, usual
from orbitfinder.errors import InputError, plural
from orbitfinder.records.reading import write_atomically


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="FILE...")
@option("jobs", "Processes side by side.", 1, (1, 256))
@option("method", "shooting, collocation (stiff) or balance (driven).  [default: by a measured stiffness]",
        metavar="METHOD")  # fmt: skip
@usual("Folder for DIR/<name>/orbit.json.", "orbits", figures="Draw the certified orbits.", compiled=True)
def run(
    files: tuple[Path, ...], out: Path, jobs: int, method: str | None, figures: bool, limit: float | None, trust: bool
) -> None:
    """Find and certify the orbit of each problem FILE.

    Writes DIR/<name>/orbit.json, orbit.npz and figures. A result that fails its certificate is
    written as rejected.json and named as such. Exit code 0: all certified; 1: some were not.

    \b
    Examples:
      orbitfinder run problems/report/triple-1.toml
      orbitfinder run problems/examples/*.toml --jobs 2 --out orbits --no-figures
    """
    outcomes = []
    with display(f"{files[0].stem}: reading {plural(len(files), 'file')}") as shown:
        todo = prepare(files, out, figures, trust, limit, method)
        for outcome in run_jobs(todo, jobs, shown):
            outcomes.append(outcome)
            count = f"[{len(outcomes)}/{len(todo)}] " if len(todo) > 1 else ""
            shown.say(f"{count}{outcome.name}: {outcome.status}, {outcome.wall_time:.1f} s")
    width = max(len(outcome.name) for outcome in outcomes) + 1
    for outcome in outcomes:
        _print_outcome(outcome, width)
    passed = all(outcome.passed for outcome in outcomes)
    if len(outcomes) > 1:
        text(f"{sum(outcome.passed for outcome in outcomes)} of {plural(len(outcomes), 'orbit')} certified")
    if passed:
        next_step("continue", outcomes[0].written[0])
    finish("run", {"passed": passed, "results": outcomes}, passed)


def _print_outcome(outcome: Outcome, width: int) -> None:
    """A line that is aligned with the others', 12 digits; --json has all of them."""
    name = f"{outcome.name}:".ljust(width)
    if outcome.period is None:
        text(f"{name} {outcome.status}: {outcome.message}")
        return
    levels = {"period": (outcome.period, "time"), "energy": (outcome.energy, "energy")}
    told = [f"{key} {x:.12g} {outcome.units[unit]}" for key, (x, unit) in levels.items() if x is not None]
    text(
        f"{name} {outcome.status}, {', '.join(map(str.rstrip, told))}, "
        + f"closure {outcome.closure:.1e}, {outcome.stability}, symmetry {outcome.symmetry}"
        + "".join(f", {key} = {value:.12g}" for key, value in outcome.chosen.items())
        + (f", {outcome.moved:.1e} from the catalogue" if outcome.moved is not None else "")
    )
    if outcome.reduction:
        text(f"  {outcome.reduction}")
    if outcome.failures:
        text(f"  failed checks: {', '.join(outcome.failures)}{'; ' * bool(outcome.remedy)}{outcome.remedy}")
    text(
        f"  {outcome.written[0]}" + (f" and {plural(len(outcome.written) - 1, 'figure')}" * (len(outcome.written) > 1))
    )


@click.command()
@click.argument("file", type=FILES)
@option("duration", "Time in s; default: [simulate] duration or 10.", kind=float)
@usual("Write DIR/<name>/simulation.csv.")
def simulate(file: Path, duration: float | None, out: Path | None, trust: bool) -> None:
    """Simulate the system of a problem FILE from its state and report what becomes of the energy.

    \b
    Examples:
      orbitfinder simulate problems/report/triple-1.toml --duration 20
      orbitfinder simulate problems/examples/double.toml --out runs
    """
    from orbitfinder.exports.write import csv_text
    from orbitfinder.mechanics.scales import worded
    from orbitfinder.problemfile.read import load_problem_file

    loaded = load_problem_file(file, trust)
    if out is not None:
        folder_of(out, loaded.name)
    if loaded.start is None:
        raise InputError(f"{file}: simulate.state: missing; give it, or a [guess] to start from")
    result = of.simulate(loaded.model, loaded.start, loaded.duration if duration is None else duration)
    document = {"name": loaded.name} | result.document()
    kind, more = ("drift", "") if result.conserved else ("change", ", which this system does not conserve")
    system = loaded.model.system
    text(worded(f"{loaded.name}: {result.times[-1]:g} s simulated", system))
    if document["energy"] is not None:
        text(worded(f"  {'energy':<22}{document['energy']:.12g} J", system))
        text(worded(f"  {f'energy {kind}':<22}{document[f'energy_{kind}']:.2e} J{more}", system))
        text(f"  {'relative to exchanged':<22}{document[f'relative_energy_{kind}']:.2e}")
    for moment, event in result.events[:20]:
        text(worded(f"  {event:<22}at {moment:.12g} s", system))
    if more_events := result.events[20:]:
        text(f"  {'':<22}and {plural(len(more_events), 'more event')}")
    text(f"  {'end state':<22}" + ", ".join(f"{name} = {x:.9g}" for name, x in document["end"].items()))
    if out is not None:
        written = out / loaded.name / "simulation.csv"
        write_atomically(written, csv_text(result.state_names, result.times, result.states).encode())
        document["written"] = written
        text(f"  {written}")
    finish("simulation", document)


@click.command()
@option("fresh", "Compute every part again, also those already finished.", kind=bool)
@usual("Folder for the page and figures.", "results/report", compiled=True, trust="")
def reproduce(out: Path, fresh: bool) -> None:
    """Reproduce the whole MATLAB report: figures, orbits, animations and a page beside it.

    Can be interrupted and run again: finished parts are kept. Takes a minute or two.

    \b
    Examples:
      orbitfinder reproduce
      orbitfinder reproduce --out /tmp/report --fresh
    """
    from orbitfinder.reproduce.runner import reproduce as run_report

    check_writable(out)
    began = time.monotonic()
    with display("the report: 7 parts, finished ones are kept") as shown:
        numbers = run_report(
            out, fresh, lambda what, done, of: shown.say(f"[{done}/{of}] {what} ({time.monotonic() - began:.0f} s)")
        )
    orbits = numbers["orbits"]
    certified = sum(orbit["certified"] for orbit in orbits.values())
    text(f"{out / 'README.md'}: {certified} of {plural(len(orbits), 'orbit')} certified")
    passed = certified == len(orbits)
    finish("reproduce", {"passed": passed, "page": str(out / "README.md"), "orbits": orbits}, passed)
