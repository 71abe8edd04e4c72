"""The command `run`: find and certify the orbit of each problem file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orbitfinder.cli.options import FILES, compile_option, finish, json_option, out_option, text, trust_option

if TYPE_CHECKING:
    from orbitfinder.cli.jobs import Outcome


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="FILE...")
@out_option("Folder for DIR/<name>/orbit.json.", default="orbits", show_default=True)
@click.option("--jobs", default=1, show_default=True, type=click.IntRange(1, 256), help="Processes side by side.")
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw the certified orbits.")
@compile_option
@trust_option()
@json_option
def run(files: tuple[Path, ...], out: Path, jobs: int, figures: bool, limit: float | None, trust: bool) -> None:
    """Find and certify the orbit of each problem FILE.

    Writes DIR/<name>/orbit.json, orbit.npz and figures. A result that fails its certificate is
    written as rejected.json and named as such. Exit code 0: all certified; 1: some were not.

    \b
    Examples:
      orbitfinder run problems/report/triple-1.toml
      orbitfinder run problems/examples/*.toml --jobs 2 --out orbits --no-figures
    """
    from orbitfinder.cli.console import display
    from orbitfinder.cli.jobs import prepare, run_jobs

    todo = prepare(files, out, figures, trust, limit)
    outcomes = []
    with display() as shown:
        for outcome in run_jobs(todo, jobs, shown):
            outcomes.append(outcome)
            shown.say(f"{outcome.name}: {outcome.message}, {outcome.wall_time:.1f} s")
    for outcome in outcomes:
        _print_outcome(outcome)
    passed = all(outcome.passed for outcome in outcomes)
    finish("run", {"passed": passed, "results": [outcome.document() for outcome in outcomes]}, passed)


def _print_outcome(outcome: Outcome) -> None:
    if outcome.period is None:
        text(f"{outcome.name}: {outcome.status}: {outcome.message}")
        return
    text(
        f"{outcome.name}: {outcome.status}, period {outcome.period!r} s, energy {outcome.energy!r} J, "
        f"closure {outcome.closure:.1e}, {outcome.stability}, symmetry {outcome.symmetry}"
        + "".join(f", {name} = {value!r}" for name, value in outcome.chosen.items())
    )
    if outcome.failures:
        text(f"  failed checks: {', '.join(outcome.failures)}")
    text(f"  {outcome.written[0]}" + (f" and {len(outcome.written) - 1} figures" * (len(outcome.written) > 1)))
