"""The command `page`: a static site from result files."""

from __future__ import annotations

from pathlib import Path

import click

from orbitfinder.cli.options import FILES, out_option


@click.command()
@click.argument("paths", nargs=-1, required=True, type=FILES, metavar="PATH...")
@out_option("Folder for the site; of it a former page is replaced.", required=True)
@click.option("--title", default="Periodic orbits", show_default=True, help="Heading of the gallery.")
@click.option(
    "--atlas-pages", default=60, show_default=True, type=click.IntRange(0, 10_000),
    help="Orbits of each atlas, evenly chosen in energy, that get a card and a page of their own.",
)  # fmt: skip
@click.option(
    "--verify/--no-verify", default=True, show_default=True,
    help="Recompute the certificate of every orbit that gets a page, or say that it is the file's word.",
)  # fmt: skip
def page(paths: tuple[Path, ...], out: Path, title: str, atlas_pages: int, verify: bool) -> None:
    """Make a static site from any mixture of orbits, families and atlases.

    PATH is an orbit.json, a family.json, an atlas (database or JSON export), or a folder that holds
    such files; FILE#K is one point of a family (from 0) or orbit of an atlas. The site opens from disk: no network,
    no server.

    \b
    Examples:
      orbitfinder page orbits -o site
      orbitfinder page orbits families atlas.sqlite -o site --title "Triple pendulum"
    """
    from orbitfinder.cli.console import note
    from orbitfinder.site.build import Settings, build_site
    from orbitfinder.site.gather import gather
    from orbitfinder.site.text import plural, size
    from orbitfinder.site.writing import check_target, write_site

    check_target(out)

    site, summary = build_site(gather(paths), Settings(title, atlas_pages, verify), note)
    write_site(site.files, out)
    parts = [plural(summary.orbits, "orbit"), plural(summary.families, "family"), plural(summary.atlases, "atlas")]
    click.echo(f"{out / 'index.html'}: {', '.join(parts)}, {size(summary.size)}")
