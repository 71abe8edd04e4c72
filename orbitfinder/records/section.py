"""Poincare sections as plain numbers, and their files: section.json with the numbers beside it in section.npz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError
from orbitfinder.records.orbit import energy_of
from orbitfinder.records.reading import arrays, finite, json_file, read_as, write_json, write_npz

FORMAT, VERSION = "orbitfinder/section", 1
PARTED = 50.0
"""Growth of a small distance in one return, at most, where it grows as the number of returns"""
LARGEST = float(np.finfo(float).max)
"""Stands in files, whose numbers are finite, for a growth that is not known"""
AGAIN = "make the section again"


@dataclass(frozen=True)
class Section(Shown):
    """Crossings of many motions: `states` (k x d) at `times` (k, s since each began), `seeds` (k) says whose they are.

    `plane` in words, `axes` the components that are drawn, `energy` nan where none is held; `starts` (m x d) are where
    the motions began, `growth` (m) how much neighbours parted (see `orbits.section`), infinite where that is not known.
    """

    __repr__ = brief("name", "plane", "energy", "returns")

    name: str
    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    plane: str
    axes: tuple[str, str]
    energy: float
    states: np.ndarray
    times: np.ndarray
    seeds: np.ndarray
    starts: np.ndarray
    growth: np.ndarray

    @property
    def returns(self) -> int:
        """How many crossings there are in all."""
        return len(self.states)

    @property
    def regular(self) -> np.ndarray:
        """Which motions (m) are regular: neighbours part by no more than `PARTED` in each of their returns."""
        returns = np.bincount(self.seeds, minlength=len(self.starts))
        return np.asarray(self.growth <= PARTED * np.maximum(returns, 1))

    @property
    def points(self) -> np.ndarray:
        """The crossings in the axes (k x 2)."""
        return np.asarray(self.states[:, [self.state_names.index(name) for name in self.axes]])


PLAIN = ("name", "system", "state_names", "plane", "axes", "energy")
ARRAYS = ("states", "times", "seeds", "starts", "growth")


@dataclass(frozen=True)
class _Plain:
    name: str
    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    plane: str
    axes: tuple[str, ...]
    energy: float | None


def save_section(section: Section, path: str | Path) -> Path:
    """Write section.json and, beside it, section.npz; returns the JSON's path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    members = {name: getattr(section, name) for name in ARRAYS}
    write_npz(target.with_suffix(".npz"), members | {"growth": np.minimum(section.growth, LARGEST)})
    document = {"format": FORMAT, "version": VERSION, **{name: getattr(section, name) for name in PLAIN}}
    return write_json(target, finite(document))


def load_section(path: str | Path) -> Section:
    """The Section of a section.json and its section.npz. Raises `InputError`."""
    source = Path(path)
    document = json_file(source, "section", AGAIN)
    if not isinstance(document, Mapping) or document.get("format") != FORMAT:
        raise InputError(f"{source}: not a section; give the section.json that `orbitfinder section` wrote")
    plain = read_as(_Plain, document, str(source), AGAIN)
    found = arrays(source.with_suffix(".npz"), ARRAYS, AGAIN, endless=("growth",))
    if len(plain.axes) != 2 or not set(plain.axes) <= set(plain.state_names):
        raise InputError(f"{source}: axes: expected two of the components; {AGAIN}")
    found["growth"] = np.where(found["growth"] < LARGEST, found["growth"], np.inf)
    count, motions, d = found["times"].size, found["growth"].size, len(plain.state_names)
    shapes = {"states": (count, d), "times": (count,), "seeds": (count,), "starts": (motions, d), "growth": (motions,)}
    for name, shape in shapes.items():
        if found[name].shape != shape:
            raise InputError(f"{source}: {name}: shape {found[name].shape} where {shape} belongs; {AGAIN}")
    if not motions or found["seeds"].dtype.kind != "i" or not np.isin(found["seeds"], np.arange(motions)).all():
        raise InputError(f"{source}: seeds: expected numbers of {motions} motions, counted from 0; {AGAIN}")
    return Section(plain.name, plain.system, plain.state_names, plain.plane, (plain.axes[0], plain.axes[1]),
                   energy_of(plain.energy), **found)  # fmt: skip
