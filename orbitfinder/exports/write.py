"""Orbits written for other programs, the plainest in CSV; the other formats stand in files of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orbitfinder._runtime.arguments import check
from orbitfinder._runtime.rooms import loaded
from orbitfinder.errors import InputError
from orbitfinder.exports.formats import FORMATS, TABLES
from orbitfinder.exports.source import samples_of, source_of
from orbitfinder.exports.tables import refuse_another
from orbitfinder.loops.control import controls_at
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.records.orbit import Orbit, refuse_controlled
from orbitfinder.records.reading import write_atomically


def csv_text(state_names: Sequence[str], times: np.ndarray, states: np.ndarray) -> str:
    """A header line, then t (s) and the states; digits that round-trip, as `[guess] csv = ...` reads them back."""
    rows = np.column_stack([times, states]).tolist()
    return "\n".join([",".join(["t", *state_names]), *(",".join(map(repr, row)) for row in rows)]) + "\n"


def csv_file(orbit: Orbit, model: Model) -> dict[str, str]:
    """NAME.csv: the samples of an orbit of any system, and the controls of a controlled orbit."""
    times, states = samples_of(orbit, model)
    if orbit.control is None:
        return {f"{orbit.name}.csv": csv_text(model.state_names, times, states)}
    rows = np.hstack([states, controls_at(orbit.control, orbit.period, times)])
    return {f"{orbit.name}.csv": csv_text([*model.state_names, *orbit.control["names"]], times, rows)}


def export_orbit(orbit: Orbit, to: str, folder: str | Path, model: Model | None = None) -> list[Path]:
    """Write an orbit for another program.

    Args:
        orbit: what to write.
        to: csv | auto | julia | c, or what else is in `exports.formats.FORMATS`.
        folder: where.
        model: needed only for systems that no file describes.

    Returns:
        The paths.

    Raises:
        InputError: for an unknown program and equations that it has no words for.

    Examples:
        >>> [path.name for path in of.export_orbit(orbit, "csv", ".")]
        ['fast-swing.csv']
    """
    if to not in FORMATS:
        what = f"{to} files hold tables, and {orbit.name} is an orbit" if to in TABLES else f"unknown format {to!r}"
        raise InputError(f"to: {what}; use one of {', '.join(FORMATS)}")
    acts = FORMATS[to].controlled if orbit.control is not None else ""
    write, any_motion = loaded(acts or FORMATS[to].files), FORMATS[to].any_motion or bool(acts)
    if not any_motion:
        refuse_controlled(orbit, "to")
    model = model or build_model(orbit.system)
    if not model.smooth and not any_motion:
        raise InputError(f"to: {to} files know no events, and this system is hybrid; use csv")
    files = write(orbit, model) if any_motion else write(source_of(orbit, model))
    check(f"Format {to!r}, files", "Mapping[str, str]", files, "; return the text of each file by its name")
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        refuse_another(target / name, text.encode())
        write_atomically(target / name, text.encode())
    return [target / name for name in files]
