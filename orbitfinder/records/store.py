"""From a path to the orbits that it holds: FILE, or FILE#K for one orbit of a family or of an atlas."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError
from orbitfinder.records.family import load_family
from orbitfinder.records.optima import load_optima
from orbitfinder.records.orbit import AGAIN, Orbit, orbit_in, read_orbit
from orbitfinder.records.reading import file_head, json_file

DATABASES = (".sqlite", ".sqlite3", ".db")
KINDS = "orbit|family|tori|optima|section|manifold|connection|controller"
OURS = re.compile(rb'\s*(?:(\[)|\{[^\[{]*?"format"\s*:\s*"orbitfinder/(' + KINDS.encode() + rb')")')
HEAD = 400
"""Bytes of a file in which its format is said"""


def kind_of(file: Path) -> str:
    """What a file holds, by its name and its first bytes: one of `KINDS`, export (of an atlas), atlas, or nothing."""
    if file.suffix in DATABASES:
        return "atlas"
    found = OURS.match(file_head(file, HEAD))
    return "" if found is None else "export" if found[1] else found[2].decode()


def member(path: str | Path) -> tuple[Path, int | None]:
    """The file and the number in FILE#K; no number where there is none, or where a file has that very name."""
    name, mark, number = Path(path).name.rpartition("#")
    if not mark or Path(path).exists():
        return Path(path), None
    if not (number.isascii() and number.isdigit()):
        raise InputError(f"{path}: #{number}: not a whole number from 0; give FILE#K, such as {name}#0")
    return Path(path).with_name(name), int(number)


def _chosen(members: Sequence[Any], number: int, path: str | Path) -> Any:
    """The member with a number, counted from 0, or `InputError`."""
    if number < len(members):
        return members[number]
    raise InputError(f"{path}: #{number}: no such orbit in the file; give a number from 0 to {len(members) - 1}")


def load_orbit(path: str | Path) -> Orbit:
    """An Orbit of an orbit.json, a family.json#K or an atlas export #K; `atlas.store.load_orbit` reads atlases too."""
    file, number = member(path)
    if number is None and file.suffix in DATABASES and file.is_file():
        raise InputError(f"{path}: an atlas database; give one orbit of it by its id: {path}#1")
    if number is None:
        return read_orbit(file)
    kind = kind_of(file)
    if kind in ("family", "optima"):
        several = load_family(file) if kind == "family" else load_optima(file)
        point: Orbit = _chosen(several.points, number, path)
        return point
    if kind == "export":
        return orbit_in(_chosen(json_file(file, "atlas export", AGAIN), number, path), str(path))
    if kind == "atlas":
        raise InputError(f"{path}: an atlas database; give its orbit: load_orbit({str(path)!r})")
    raise InputError(f"{path}: #{number}: not a family or an atlas, of which orbits have numbers; leave #{number} out")
