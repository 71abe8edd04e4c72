"""The commands `phase` and `phase-plane`: what kicks do to a cycle, and the plane of two states."""

from __future__ import annotations

from pathlib import Path

import click

import orbitfinder as of
from orbitfinder.cli.jobs import explained, folder_of, named_orbits, orbit_and_model
from orbitfinder.cli.options import FILES, SYSTEM_TRUST, finish, option, picked, text, usual
from orbitfinder.cli.section import MODULES, limits
from orbitfinder.records.certificate import certified
from orbitfinder.records.reading import parted


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json|FILE#K")
@option("name", "Name of the curve; the orbit's when left out.")
@usual("Folder for DIR/<name>/phase.json and phase.png.", "phases", figures="Draw it.", trust=SYSTEM_TRUST)
def phase(file: Path, name: str | None, out: Path, figures: bool, trust: bool) -> None:
    """Phase response of a cycle: by how much a small kick at each phase advances it, a time a unit of each component.

    By the adjoint of the linearised motion, certified by finite kicks. Exit code 0: certified.

    \b
    Examples:
      orbitfinder phase orbits/brusselator/orbit.json
    """
    from orbitfinder.show.phase import save_phase_figure

    orbit, model = orbit_and_model(file, trust)
    folder = folder_of(out, name or orbit.name)
    curve = of.phase_response(orbit, model, name=folder.name)
    written = [curve.save(folder / "phase.json"), *(save_phase_figure(curve, folder, model) if figures else [])]
    verdict = "certified" if certified(curve) else f"not certified: {explained(curve.certificate)}"
    text(f"{written[0]}: {len(curve.times)} phases of {curve.period:.12g}, {curve.stability}, {verdict}")
    row = picked([curve], "name period stability normalisation certificate")[0]
    finish("phase", {**row, "written": written}, certified(curve))


@click.command("phase-plane")
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="FILE|ORBIT.json|FILE#K...")
@option("range ranges", "Of a state; default: around the orbits.", multiple=True, metavar="NAME=LOW:HIGH")
@usual("Folder for DIR/<name>/phase-plane.png.", "phases", trust=MODULES, json=False)
def phase_plane(files: tuple[Path, ...], ranges: tuple[str, ...], out: Path, trust: bool) -> None:
    """Draw the plane of two states: nullclines, directions, equilibria and orbits, for the first FILE's parameters.

    \b
    Examples:
      orbitfinder phase-plane orbits/brusselator/orbit.json
      orbitfinder phase-plane problems/gallery/brusselator.toml --range u=0:5 --range v=0:5
    """
    from orbitfinder.problemfile.read import load_problem_file
    from orbitfinder.show.style import save_all

    asked = [file for file in files if parted(file)[0].suffix in (".toml", ".py")]
    problems = [load_problem_file(file, trust) for file in asked]
    drawn = named_orbits([file for file in files if file not in asked], trust)
    name, model = (problems[0].name, problems[0].model) if problems else (drawn[0][1].name, drawn[0][2])
    title = problems[0].title if problems else drawn[0][1].title
    orbits, given = [orbit for _, orbit, _ in drawn], limits(ranges)
    figure = of.phase_plane(model, given, orbits=orbits, title=title or name)  # type: ignore[arg-type]
    text(str(*save_all({"phase-plane": figure}, folder_of(out, name))))
