"""From paths to what they hold: orbits, families and atlases, checked, in a reproducible order; what is certified."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import __version__
from orbitfinder.atlas.store import Atlas, Filter
from orbitfinder.errors import FAILURES, InputError, plural
from orbitfinder.families.equilibrium import EQUILIBRIA, Equilibria
from orbitfinder.families.members import whole
from orbitfinder.families.plane import ParameterMap
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import certify
from orbitfinder.records.certificate import Check, refused
from orbitfinder.records.family import Family
from orbitfinder.records.orbit import (
    Orbit,
    level,
    orbit_from_document,
    orbit_to_document,
    read_document,
    unconserved,
)
from orbitfinder.records.reading import Table
from orbitfinder.records.registry import DATABASES, answer, kind_of, load, load_orbit, member, taken
from orbitfinder.show.scene import evenly
from orbitfinder.structures.manifold import Connection, Manifold
from orbitfinder.structures.section import Section
from orbitfinder.structures.torus import Tori

MOST_ITEMS = 500
"""Orbits of an atlas that are shown, evenly chosen in order of energy."""
EMPTY = "holds no orbit; search into the atlas first, or give another file"
Laid = Manifold | Connection | Tori


@dataclass(frozen=True)
class OrbitFile:
    """An orbit, its document, and that compactly as text."""

    orbit: Orbit
    document: Table
    text: str

    @property
    def dense(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Times and samples, where they are kept."""
        return (self.orbit.times, self.orbit.samples) if self.orbit.times.size else None


@dataclass(frozen=True)
class AtlasFile:
    """An atlas: how many orbits are wanted, and those to be shown in order of energy, each with its K of FILE#K."""

    name: str
    total: int
    orbits: tuple[tuple[int, OrbitFile], ...]
    file: str = ""
    """its file's name, for commands"""
    held: int = 0
    """orbits in the file, where not all are wanted"""

    def counted(self, noun: str) -> str:
        """`8 orbits`, or `3 of 8 orbits` where not all are wanted."""
        return f"{self.total} of {plural(self.held, noun)}" if self.held > self.total else plural(self.total, noun)


@dataclass
class Gathered:
    """Everything that the paths hold."""

    orbits: list[OrbitFile] = field(default_factory=list)
    families: list[Family] = field(default_factory=list)
    atlases: list[AtlasFile] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    equilibria: list[Equilibria] = field(default_factory=list)
    maps: list[ParameterMap] = field(default_factory=list)
    laid: list[Laid] = field(default_factory=list)
    """what is drawn in sections of its system"""
    trusted: list[Path] = field(default_factory=list)
    """folders that Python modules may be imported from"""

    def model(self, system: Table) -> Model:
        """The Model of a system, its module imported from the trusted folder that has it. Raises `InputError`."""
        held = [folder for folder in self.trusted if (folder / f"{system.get('module')}.py").is_file()]
        return build_model(system, next(iter(held or self.trusted), None))


def gather(paths: Sequence[Path], chosen: Filter | None = None, trust: bool = False) -> Gathered:
    """Read orbits, families, equilibria, maps, atlas exports and databases, FILE#K for one orbit, or folders of files.

    Of a folder all orbits, families, equilibria, maps and *.sqlite below it are taken, in alphabetical order; what
    `run` wrote as rejected.json is left out. Of atlas databases only the orbits that pass `chosen` are taken. With
    `trust` Python modules that systems were made with are imported from beside their files.
    Raises `InputError`.
    """
    gathered, seen = Gathered(), set()
    for path in paths:
        files = _below(path) if path.is_dir() else [path]
        for file in files:
            if (place := file.resolve()) not in seen:
                seen.add(place)
                gathered.trusted += [place.parent] if trust else []
                if (joined := taken("page", file)) in vars(gathered):
                    vars(gathered)[joined].append(load(file))
                else:
                    answer("page", file)(gathered, file, chosen or Filter())
    for record in gathered.laid:
        if all(dict(record.system) != dict(section.system) for section in gathered.sections):
            raise InputError(f"{record.name}: is drawn in the page of a section of its system, and none is given; give "
                             "the section.json that `orbitfinder section` made too")  # fmt: skip
    kept: dict[object, OrbitFile] = {}  # of copies of a record the one that carries a proof
    for orbit in gathered.orbits:
        key = (orbit.document["name"], orbit.document.get("record") or id(orbit))
        if key not in kept or ("proof" in orbit.document and "proof" not in kept[key].document):
            kept[key] = orbit
    gathered.orbits = list(kept.values())
    return gathered


def _below(folder: Path) -> list[Path]:
    files = sorted(file for file in folder.rglob("*") if file.is_file() and _holds_results(file))
    if not files:
        raise InputError(
            f"{folder}: no orbit.json, family.json or atlas (*.sqlite) below this folder; run `orbitfinder run`, "
            "`continue` or `search` first, or name the files"
        )
    return files


def _holds_results(file: Path) -> bool:
    """Whether a file below a folder is meant: by its name, or as a single orbit or family under another name."""
    if file.name in ("orbit.json", "family.json", "section.json") or file.suffix in DATABASES:
        return True
    single = file.suffix == ".json" and not file.name.startswith("rejected")
    return single and kind_of(file) in ("orbit", "family", EQUILIBRIA, "map")


def add_orbit(gathered: Gathered, file: Path, _: Filter) -> None:
    """An orbit.json, or FILE#K."""
    orbit = load_orbit(file)
    if member(file)[1] is None:
        document = read_document(file)
    else:
        orbit = whole(orbit, gathered.model(orbit.system))
        document = orbit_to_document(orbit)
    gathered.orbits.append(_checked(orbit, document, str(file)))


def add_export(gathered: Gathered, file: Path, chosen: Filter) -> None:
    """The JSON export of an atlas."""
    if chosen != Filter():
        raise InputError(f"{file}: an export, of which nothing is chosen again; give the database (*.sqlite)")
    gathered.atlases.append(_listed(load(file), file))


def add_optima(gathered: Gathered, file: Path, _: Filter) -> None:
    """Optima, as orbits beside each other."""
    gathered.atlases.append(_listed([orbit_to_document(orbit) for orbit in load(file)], file))


def _orbit(document: Any, where: str) -> OrbitFile:
    """One orbit document, checked by building an Orbit from it."""
    return _checked(orbit_from_document(document, where), document, where)


def _checked(orbit: Orbit, document: Table, where: str) -> OrbitFile:
    size = orbit.state.size
    if orbit.state.ndim != 1 or not size or (size % 2 and len(orbit.winding) != size):
        raise InputError(f"{where}: state: {plural(size, 'number')}; coordinates and then as many velocities")
    numbers = [orbit.period, *orbit.state, *([] if unconserved(orbit) else [orbit.energy])]
    if not np.all(np.isfinite(numbers)) or orbit.period <= 0:
        raise InputError(f"{where}: period, energy or state is not finite or not positive; run the problem again")
    try:
        return OrbitFile(orbit, document, json.dumps(document, separators=(",", ":"), allow_nan=False))
    except ValueError as error:
        raise InputError(f"{where}: holds a number that is not finite; run the problem again") from error


def _listed(entries: Sequence[Any], file: Path) -> AtlasFile:
    """The atlas of a list of orbit documents."""
    if not entries:
        raise InputError(f"{file}: {EMPTY}")
    orbits = [_orbit(entry, f"{file}[{k}]") for k, entry in enumerate(entries)]
    places = [_order(file.document["energy"], file.document["period"]) for file in orbits]
    ordered = [(k, orbits[k]) for k in sorted(range(len(orbits)), key=places.__getitem__)]
    return AtlasFile(file.stem, len(orbits), tuple(ordered[k] for k in evenly(len(orbits), MOST_ITEMS)), file.name)


def _order(energy: float | None, period: float) -> tuple[float, float]:
    """Energy, its last digits (those of a search at one energy) left out, then period."""
    return float(f"{level(energy):.9g}"), float(period)


def add_atlas(gathered: Gathered, file: Path, wanted: Filter) -> None:
    """The orbits of a database that are wanted. Raises `InputError`."""
    if not file.is_file():
        raise InputError(f"{file}: no such file; check the path")
    with Atlas(file) as atlas:
        held = len(atlas)
        rows = sorted(atlas.rows(wanted), key=lambda row: _order(row.energy, row.period))
        if not rows:
            none = f"none of its {plural(held, 'orbit')} is chosen; ask for less" if held else EMPTY
            raise InputError(f"{file}: {none}")
        chosen = [rows[k].id for k in evenly(len(rows), MOST_ITEMS)]
        orbits = tuple((number, _orbit(atlas.document(number), f"{file}: orbit {number}")) for number in chosen)
    gathered.atlases.append(AtlasFile(file.stem, len(rows), orbits, file.name, held))


@dataclass(frozen=True)
class Verdict:
    """The checks of an orbit, recomputed here or, where `unchecked` says why not, as its file has them."""

    checks: tuple[Check, ...]
    unchecked: str = ""

    @property
    def certified(self) -> bool | None:
        """True or False by what was recomputed; None where nothing was."""
        return None if self.unchecked else all(check.passed for check in self.checks)

    @property
    def words(self) -> str:
        """Whose word it is."""
        if not self.unchecked:
            return f"Recomputed from the numbers of the file when this page was made, by orbitfinder {__version__}."
        if not self.checks:
            return f"The file carries no certificate, and none was computed here: {self.unchecked}."
        return f"As the file has it; not checked here: {self.unchecked}."

    @property
    def failures(self) -> str:
        """Names of the checks that failed."""
        return ", ".join(check.name.replace("_", " ") for check in self.checks if not check.passed)


def judged(orbit: Orbit, model_of: Callable[[Table], Model] = build_model) -> Verdict:
    """The certificate of an orbit, recomputed as `orbitfinder verify` does."""
    try:
        model = model_of(orbit.system)
    except FAILURES as error:
        return recorded(orbit, str(error))
    if (orbit.state.shape, len(orbit.winding)) != ((len(model.state_names),), model.degrees_of_freedom):
        return Verdict((refused("record", "state or winding does not belong to the system", 0.0),))
    try:
        return Verdict(certify(orbit, model).checks)
    except FAILURES as error:
        return Verdict((refused("record", error, 0.0),))


def recorded(orbit: Orbit, why: str) -> Verdict:
    """What the file says."""
    checks = () if orbit.certificate is None else orbit.certificate.checks
    return Verdict(checks, " ".join(why.split()).rstrip("."))
