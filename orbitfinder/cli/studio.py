"""The command `studio`: the page on which a mechanism is dragged to an orbit, and the orbit to its families."""

from __future__ import annotations

from pathlib import Path

import click

from orbitfinder.cli.jobs import check_writable
from orbitfinder.cli.options import FILES, option, usual


@click.command()
@click.argument("file", type=FILES, required=False, metavar="[FILE]")
@option("port", "Port; default: the first free one.", kind=(1, 65535))
@option("browser/--no-browser", "Open the page in a browser.", True)
@usual("Folder that Save writes to.", "studio", compiled=True, trust="", json=False)
def studio(file: Path | None, out: Path, port: int | None, browser: bool) -> None:
    """Drag, find, follow and save orbits on a page of this computer.

    FILE is a problem file, an orbit.json, a family.json, an atlas, or one orbit of these, FILE#K.

    Without a FILE it shows a double pendulum. Needs the extra `studio`. The page is served to this computer alone, at
    an address that is printed and known to nobody else; Ctrl-C ends it.

    Results are written at once to OUT/sessions/NAME-K, with which the next studio of that NAME and OUT begins.

    \b
    Examples:
      orbitfinder studio
      orbitfinder studio problems/examples/triple-mode-2-strong.toml
      orbitfinder studio orbits/triple-1/orbit.json --no-browser
      orbitfinder studio problems/linkages/four-bar-rocking.toml
    """
    from orbitfinder.studio.serve import serve

    check_writable(out)
    serve(file, out, port, browser, lambda address: click.echo(f"orbitfinder studio: {address}"))
