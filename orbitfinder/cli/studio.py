"""The command `studio`: the page on which a mechanism is dragged to an orbit, and the orbit to its families."""

from __future__ import annotations

from pathlib import Path

import click

from orbitfinder.cli.jobs import check_writable
from orbitfinder.cli.options import FILES, compile_option, out_option


@click.command()
@click.argument("file", type=FILES, required=False, metavar="[FILE]")
@out_option("Folder that Save writes to.", default="studio", show_default=True)
@click.option("--port", type=click.IntRange(1, 65535), default=None, help="Port; default: the first free one.")
@click.option("--browser/--no-browser", default=True, show_default=True, help="Open the page in a browser.")
@compile_option
def studio(file: Path | None, out: Path, port: int | None, browser: bool) -> None:
    """Drag, find, follow and save orbits on a page of this computer.

    FILE is a problem file, an orbit.json, a family.json, an atlas, or one orbit of these, FILE#K.

    Without a FILE it shows a double pendulum. Needs the extra `studio`. The page is served to this computer alone, at
    an address that is printed and known to nobody else; Ctrl-C ends it.

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
