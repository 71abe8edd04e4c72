"""Orbits written for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from orbitfinder.errors import InputError
from orbitfinder.exports.auto import auto_files
from orbitfinder.exports.julia import julia_file
from orbitfinder.exports.plain_c import c_file
from orbitfinder.exports.source import Source, source_of
from orbitfinder.exports.table import csv_text
from orbitfinder.mechanics.model import Model
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import write_atomically

FORMATS: dict[str, Callable[[Source], dict[str, str]]] = {
    "csv": lambda source: {
        f"{source.orbit.name}.csv": csv_text(source.model.state_names, source.times, source.samples)
    },
    "auto": auto_files,
    "julia": lambda source: {f"{source.identifier}.jl": julia_file(source)},
    "c": lambda source: {f"{source.identifier}.c": c_file(source)},
}


def export_orbit(orbit: Orbit, to: str, folder: str | Path, model: Model | None = None) -> list[Path]:
    """Write an orbit for `to` (csv | auto | julia | c) into a folder; returns the paths.

    `model` is needed only for systems that no file describes. Raises `InputError`.
    """
    if to not in FORMATS:
        raise InputError(f"--to: unknown format {to!r}; use one of {', '.join(FORMATS)}")
    files = FORMATS[to](source_of(orbit, model))
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_atomically(target / name, text.encode())
    return [target / name for name in files]
