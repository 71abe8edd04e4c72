"""The kinds of [system] that files of other programs are: in a problem file their name, in records their equations."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import KINDS, SystemKind
from orbitfinder.mechanics.model import Model
from orbitfinder.problemfile.sbml import from_sbml, sbml_document
from orbitfinder.problemfile.xpp import from_xpp, xpp_document
from orbitfinder.records.reading import Entries, Table, file_beside


def _built(system: Table, _: Path | None) -> Model:
    raise InputError(f"file: {system.get('file')!r} is read with its problem file, and a record has its equations")


def _with_content(read: Callable[..., Any], system: Table, folder: Path) -> Entries:
    """The equations that a file beside a problem file holds, with other values of its parameters."""
    path = file_beside(folder, system["file"], "file")
    document = read(path, system.get("period"), system.get("time"))
    made: Entries = document["system"] | ({"units": document["units"]} if "units" in document else {})
    for name, value in system.get("parameters", {}).items():
        if name not in made["parameters"]:
            raise InputError(f"parameters: unknown {name!r}; {path.name} has {', '.join(made['parameters']) or 'none'}")
        made["parameters"][name] = value
    return made


for name, takes, read in (("xpp", from_xpp, xpp_document), ("sbml", from_sbml, sbml_document)):
    KINDS[name] = SystemKind(_built, lambda system: "system of equations", takes=takes,
                             with_content=partial(_with_content, read))  # fmt: skip
