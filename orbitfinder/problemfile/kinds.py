"""The kind of [system] that an XPPAUT file is: in a problem file its name, in records the equations in it."""

from __future__ import annotations

from pathlib import Path

from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import KINDS, SystemKind
from orbitfinder.mechanics.model import Model
from orbitfinder.problemfile.xpp import from_xpp, xpp_document
from orbitfinder.records.reading import Entries, Table, file_beside


def _built(system: Table, _: Path | None) -> Model:
    raise InputError(f"file: {system.get('file')!r} is read with its problem file, and a record has its equations")


def _with_content(system: Table, folder: Path) -> Entries:
    """The equations that an XPPAUT file beside a problem file holds, with other values of its parameters."""
    path = file_beside(folder, system["file"], "file")
    made: Entries = xpp_document(path, system.get("period"), system.get("time"))["system"]
    for name, value in system.get("parameters", {}).items():
        if name not in made["parameters"]:
            raise InputError(f"parameters: unknown {name!r}; {path.name} has {', '.join(made['parameters']) or 'none'}")
        made["parameters"][name] = value
    return made


KINDS["xpp"] = SystemKind(_built, lambda system: "system of equations", takes=from_xpp, with_content=_with_content)
