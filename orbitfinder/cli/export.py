"""The commands `export`, `plot`, `animate` and `page`: orbits for other programs and for the eye."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from orbitfinder._runtime import interrupt
from orbitfinder.cli.atlas import chosen, filters
from orbitfinder.cli.console import Report, display
from orbitfinder.cli.jobs import check_writable, named_orbits
from orbitfinder.cli.options import FILES, FINITE, NUMBERS, SYSTEM_TRUST, option, orbit_files, out_option, text, usual
from orbitfinder.errors import InputError, plural
from orbitfinder.exports.formats import FORMATS, TABLES
from orbitfinder.records.registry import answer


@click.command()
@orbit_files
@option("to", "What to write.", kind=tuple(dict.fromkeys((*FORMATS, *TABLES))), required=True)
@usual("Folder for the files; default: beside each record.", trust=SYSTEM_TRUST, json=False)
def export(files: tuple[Path, ...], to: str, out: Path | None, trust: bool) -> None:
    """Write each ORBIT.json for another program, or what has many points as a table.

    csv: times and states, as `csv` in [guess] reads them. auto: NAME.f90, c.NAME and NAME.dat for AUTO-07p
    (then: @r NAME). julia: NAME.jl for BifurcationKit.jl. c: the right-hand side in plain C;
    of a controlled orbit its controls in time, in C and Python.
    Of a controller.json csv are its gains, c itself in C and Python. Families, equilibria, diagrams, sweeps,
    optima, tori and maps are tables, csv, parquet or json: NAME.csv a row a point, NAME-events.csv and NAME-ends.csv
    what happens. Beside a record these stand where it does; what another record has left is not written over.
    FILE#K is point K of a family.json, counted from 0, or orbit K of an atlas.

    \b
    Examples:
      orbitfinder export orbits/triple-1/orbit.json --to csv
      orbitfinder export orbits/triple-1/orbit.json --to auto -o auto
      orbitfinder export families/triple-mode-2/family.json --to csv
    """
    for file, record, model in named_orbits(files, trust, verb="export", out=out):
        folder = file.parent if out is None else out
        check_writable(folder)
        for written in answer("export", file)(record, to, folder, model):
            click.echo(str(written))


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="ORBIT.json|FAMILY.json|FILE#K...")
@option("together", "Draw families in one picture, families.png.", kind=bool)
@option("level", "Draw the logarithm of the energy's distance from this one.", kind=FINITE, metavar="J")
@option("across", "Draw families over this: energy, period, frequency, arclength, a parameter, what is watched, "
        "or amplitude_C, min_C, max_C of a coordinate C.")  # fmt: skip
@option("up", "What goes up, likewise.  [default: frequency]")
@option("xlim", "The window across, LOW,HIGH.", kind=NUMBERS)
@option("beside", "A b.NAME of AUTO-07p whose branches to draw beside families.", kind=FILES, metavar="b.NAME")
@option("style", "A Matplotlib style sheet, or its name, over the figures' own.", metavar="FILE")
@usual("Folder for the figures; default: beside each file.", trust=SYSTEM_TRUST, json=False)
def plot(files: tuple[Path, ...], out: Path | None, together: bool, level: float | None, style: str | None,
         trust: bool, **axes: Any) -> None:  # fmt: skip
    """Draw the figures of each ORBIT.json: histories, phase portraits, configurations, energy.

    FILE#K is point K of a family.json, counted from 0, or orbit K of an atlas. Of a whole FAMILY.json the figures
    are those that `continue` draws: frequency and energy, multipliers, a gallery of its orbits. Tori, optima, sections,
    manifolds, connections, controllers and atlases have figures of their own.

    \b
    Examples:
      orbitfinder plot orbits/triple-1/orbit.json -o figures
      orbitfinder plot families/triple-mode-2/family.json
      orbitfinder plot families/*/family.json --together -o figures
      orbitfinder plot families/duffing/family.json --across frequency --up amplitude_x --xlim 1.2,1.9
      orbitfinder plot families/duffing/family.json --up max_x --beside auto/b.duffing
    """
    from orbitfinder.show.plot import save_chosen, save_frequency_energy
    from orbitfinder.show.style import styled

    click.get_current_context().with_resource(styled(style))
    drawn = named_orbits(files, trust, verb="plot", out=None if together else out)
    if any(axes.values()):
        folder = files[0].parent if out is None else out
        check_writable(folder)
        families, model = [record for _, record, _ in drawn], drawn[0][2]
        click.echo(str(save_chosen(families, folder / "chosen.png", model=model, **axes)))
        return
    if together or level is not None:
        families = [record for _, record, _ in drawn]
        folder = files[0].parent if out is None else out
        check_writable(folder)
        click.echo(str(save_frequency_energy(families, folder / "families.png", level)))
        return
    for file, record, model in drawn:
        beside = file.parent if file.exists() else file.parent / record.name
        folder = beside if out is None else (out if len(drawn) == 1 else out / record.name)
        check_writable(folder)
        for written in answer("plot", file)(record, folder, model):
            click.echo(str(written))


@click.command()
@orbit_files
@option("size pixels", "Pixels on a side.  [default: 360, .mp4 1080]", kind=(64, 4320))
@option("fps rate", "Frames a second.  [default: 25, .mp4 60]", kind=(1, 240))
@option("periods", "Periods shown.  [default: few that loop in real time]", kind=(1, 1000))
@option("slow", "How many times slower than real time.  [default: 1]", kind=click.FloatRange(0.01, 1000.0))
@option("dark", "Light on dark.", kind=bool)
@usual("A .gif or .mp4 file (one orbit), or a folder; default: beside each file.", trust=SYSTEM_TRUST, json=False)
def animate(files: tuple[Path, ...], out: Path | None, trust: bool, **chosen: Any) -> None:
    """Animate each ORBIT.json over whole periods, as a GIF (or MP4 with the extra `mp4`).

    FILE#K is point K of a family.json, counted from 0, or orbit K of an atlas.

    \b
    Examples:
      orbitfinder animate orbits/triple-1/orbit.json
      orbitfinder animate orbits/triple-1/orbit.json -o triple-1.mp4 --slow 4 --dark
    """
    from orbitfinder.show.animate import check_suffix, save_animation, settings_for

    single = out if out is not None and out.suffix and not out.is_dir() else None
    if single is not None:
        check_suffix(single)
        if len(files) > 1:
            raise InputError(f"--out: {out} is one file for {plural(len(files), 'orbit')}; name a folder")
    for file, record, model in named_orbits(files, trust, verb="animate", out=out):
        target = single or (out or file.parent) / f"{record.name}.gif"
        check_writable(target.parent)
        settings = settings_for(target, **chosen)
        click.echo(str(save_animation(answer("animate", file)(record, model, settings), target, settings)))


SPEAK_EVERY = 2.0
"""s between two lines about a site that is being made"""


@click.command()
@click.argument("paths", nargs=-1, required=True, type=FILES, metavar="PATH...")
@out_option("Folder for the site; of it a former page is replaced.", required=True)
@option("title", "Heading of the gallery.", "Periodic orbits")
@option("atlas-pages", "Orbits of each atlas, evenly chosen in energy, that get a card and a page of their own.", 60,
        (0, 10_000))  # fmt: skip
@option("verify/--no-verify", "Recompute the certificate of every orbit that gets a page, or say that it is the file's "
        "word.", True)  # fmt: skip
@filters
@usual(trust=SYSTEM_TRUST, json=False)
def page(
    paths: tuple[Path, ...], out: Path, title: str, atlas_pages: int, verify: bool, trust: bool, **options: Any
) -> None:
    """Make a static site from any mixture of orbits, families, equilibria, maps and atlases.

    PATH is an orbit.json, a family.json, an equilibria.json, a map.json, an atlas (database or JSON export), an
    optima.json, a section.json and what lies in it (manifolds, connections, tori), or a folder that holds such files;
    FILE#K is one point of a family (from 0) or orbit of an atlas. --stability, --symmetry, --energy and --period choose
    orbits of atlas databases. The site opens from disk: no network, no server.

    \b
    Examples:
      orbitfinder page orbits -o site
      orbitfinder page orbits families atlas.sqlite -o site --title "Triple pendulum"
      orbitfinder page triple.sqlite --stability elliptic -o site
    """
    with display(f"{out}: reading {plural(len(paths), 'path')}", SPEAK_EVERY) as shown:
        from orbitfinder.site.build import SiteSettings, build_site
        from orbitfinder.site.gather import gather
        from orbitfinder.site.text import size
        from orbitfinder.site.writing import check_target, write_site

        def report(line: str) -> None:
            interrupt.check()
            shown.show(Report(f"{out}: {line}"))

        check_target(out)
        site, summary = build_site(
            gather(paths, chosen(options), trust), SiteSettings(title, atlas_pages, verify), report
        )
        write_site(site.files, out)
    counts = {
        "orbit": summary.orbits,
        "family": summary.families,
        "atlas": summary.atlases,
        "section": summary.sections,
        "equilibrium curve": summary.equilibria,
        "map": summary.maps,
    }
    parts = [plural(count, name) for name, count in counts.items() if count]
    text(f"{out / 'index.html'}: {', '.join(parts)}, {size(summary.size)}")
