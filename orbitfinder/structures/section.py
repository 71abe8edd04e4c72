"""Poincare sections as plain numbers, and their files: section.json with the numbers beside it in section.npz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.records.codec import Codec, Dense, Filed, Unknown

PARTED = 50.0
"""Growth of a small distance in a return, at most, where it grows as the number of returns"""
LARGEST = float(np.finfo(float).max)
"""Stands in files, whose numbers are finite, for a growth that is not known"""
Growth = Annotated[
    np.ndarray,
    Filed(
        lambda growth: np.minimum(growth, LARGEST), lambda entry, where: np.where(entry < LARGEST, entry, np.inf),
        dense=True, endless=True,
    ),
]  # fmt: skip


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
    energy: Unknown
    states: Dense
    times: Dense
    seeds: Dense
    starts: Dense
    growth: Growth

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

    def _check(self) -> None:
        if not set(self.axes) <= set(self.state_names):
            raise ValueError(f"axes: expected two of the components, got {', '.join(self.axes)}")
        count, motions, d = self.times.size, self.growth.size, len(self.state_names)
        shapes = {"states": (count, d), "times": (count,), "seeds": (count,), "starts": (motions, d),
                  "growth": (motions,)}  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name}: shape {getattr(self, name).shape} where {shape} belongs")
        if not motions or self.seeds.dtype.kind != "i" or not np.isin(self.seeds, np.arange(motions)).all():
            raise ValueError(f"seeds: expected numbers of {motions} motions, counted from 0")


CODEC = Codec(Section, "section", "`orbitfinder section`", "make the section again")


def save_section(section: Section, path: str | Path) -> Path:
    """Write section.json and, beside it, section.npz; returns the JSON's path."""
    return CODEC.save(section, path)


def load_section(path: str | Path) -> Section:
    """The Section of a section.json and its section.npz. Raises `InputError`."""
    return CODEC.load(path)
