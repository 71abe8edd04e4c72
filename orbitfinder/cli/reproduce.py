"""The command `reproduce`: the whole MATLAB report again."""

from __future__ import annotations

import time
from pathlib import Path

import click

from orbitfinder.cli.options import compile_option, finish, json_option, out_option, text


@click.command()
@out_option("Folder for the page and figures.", default="results/report", show_default=True)
@click.option("--fresh", is_flag=True, help="Compute every part again, also those already finished.")
@compile_option
@json_option
def reproduce(out: Path, fresh: bool) -> None:
    """Reproduce the whole MATLAB report: figures, orbits, animations and a page beside it.

    Can be interrupted and run again: finished parts are kept. Takes a minute or two.

    \b
    Examples:
      orbitfinder reproduce
      orbitfinder reproduce --out /tmp/report --fresh
    """
    from orbitfinder.cli.console import display
    from orbitfinder.cli.jobs import check_writable
    from orbitfinder.reproduce.runner import reproduce as run_report

    check_writable(out)
    began = time.monotonic()
    with display() as shown:
        numbers = run_report(
            out, fresh, lambda what, done, of: shown.say(f"[{done}/{of}] {what} ({time.monotonic() - began:.0f} s)")
        )
    orbits = numbers["orbits"]
    certified = sum(one["certified"] for one in orbits.values())
    text(f"{out / 'README.md'}: {certified} of {len(orbits)} orbits certified")
    passed = certified == len(orbits)
    finish("reproduce", {"passed": passed, "page": str(out / "README.md"), "orbits": orbits}, passed)
