"""Maps of a plane of two parameters as plain numbers, and their files: map.json with its numbers in map.npz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder.orbits.floquet import STABILITIES
from orbitfinder.records.codec import Codec, Dense, check_shapes
from orbitfinder.records.family import check_curve, on_mesh
from orbitfinder.records.table import Tabled, Tables, placed

COLOURED, BLANK = ("stability", "multiplier", "amplitude", "period"), (
    "", "no orbit beside it was reached", "Newton's method does not converge, as beyond a fold or an end",
    "the motion cannot be integrated", "Newton's method leads to another orbit", "nothing moves there",
    "stopped before it was tried",
)  # fmt: skip
"""What a map may be coloured by; why a pixel has no orbit, by the numbers in `blank`, of which 0 has an orbit"""
UNTRIED, DIVERGED, ENDLESS, ELSEWHERE, RESTING, STOPPED = range(1, len(BLANK))


@dataclass(frozen=True)
class ParameterMap(Tabled):
    """An orbit at each of R x C places in a plane of two parameters, all of a family.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        parameters: across (C `columns`, increasing) and up (R `rows`).
        by: what is coloured: stability, multiplier, amplitude, period.
        coordinates: the names of the n coordinates.
        curve: what the equations of the orbits are rebuilt from.
        seed: of the sample that is certified.
        failures: how many orbits of the sample fail each check, by its name; nothing where all pass.
        columns: values of the parameter across.
        rows: of that up.
        mesh: where the orbits are integrated, in periods.
        nodes: of each orbit (R x C x N x d), 0 where there is none, as everything that follows.
        periods: R x C, s.
        unfolding: R x C x m, of orbits that keep something.
        blank: R x C numbers, 0 where there is an orbit, else of the reason why not in `families.plane.BLANK`.
        multipliers: the largest of each (R x C x 2: re, im).
        verdicts: R x C numbers of what is said of their stability in `orbits.floquet.STABILITIES`.
        amplitudes: R x C x n, half of what each coordinate moves.
        sample: k x 3, row, column and whether it is certified.
        title: what pictures are headed with; the name where it is empty.

    Examples:
        >>> plane.counts
        '6 of 6 pixels have an orbit, 6 asymptotically stable; certified 2 of 2 sampled (33 %)'
        >>> plane.stable.shape, float(plane.values("period").max().round(9))
        ((2, 3), 3.141592654)
    """

    __repr__ = brief("name", "parameters", "counts")
    _entries = ("name", "counts", ...)

    name: str
    system: Mapping[str, Any]
    parameters: tuple[str, str]
    by: str
    coordinates: tuple[str, ...]
    curve: Mapping[str, Any]
    seed: int
    failures: Mapping[str, int]
    columns: Dense
    rows: Dense
    mesh: Dense
    nodes: Dense
    periods: Dense
    unfolding: Dense
    blank: Dense
    multipliers: Dense
    verdicts: Dense
    amplitudes: Dense
    sample: Dense
    title: str = ""
    """of the problem, above its picture"""

    @property
    def known(self) -> np.ndarray:
        """Where there is an orbit (R x C)."""
        return np.asarray(self.blank == 0)

    @property
    def stable(self) -> np.ndarray:
        """Where there is an orbit that is not unstable (R x C)."""
        return np.asarray(self.known & (self.verdicts != STABILITIES.index("unstable")))

    def values(self, by: str) -> np.ndarray:
        """A number of each orbit (R x C), nan where there is none: `multiplier` is the largest modulus, `period` in s,
        `amplitude` that of the coordinate that moves most, `stability` 1 or 0."""
        numbers = {
            "stability": self.stable, "multiplier": np.hypot(*self.multipliers.transpose(2, 0, 1)),
            "amplitude": self.amplitudes[..., self.moving], "period": self.periods,
        }  # fmt: skip
        return np.where(self.known, numbers[by], np.nan)

    def own_tables(self) -> Tables:
        """Its table, a row a pixel; `certified` of those of the sample, "" of the others."""
        row, column = (each.ravel() for each in np.indices(self.blank.shape))
        sure = np.full(self.blank.shape, "", object)
        sure[self.sample[:, 0], self.sample[:, 1]] = np.where(self.sample[:, 2], "True", "False")
        words = np.where(self.known, np.array(STABILITIES)[self.verdicts], "")
        amplitudes = np.where(self.known[..., None], self.amplitudes, np.nan)
        across, up = self.parameters
        return {"points": placed({across: self.columns[column], up: self.rows[row]}, {
            "row": row, "column": column, "period": self.values("period").ravel(),
            **{f"amplitude_{name}": amplitudes[..., k].ravel() for k, name in enumerate(self.coordinates)},
            "largest_multiplier": self.values("multiplier").ravel(), "stability": words.ravel(),
            "certified": sure.ravel().astype(str), "blank": np.array(BLANK)[self.blank].ravel(),
        })}  # fmt: skip

    @property
    def moving(self) -> int:
        """The number of the coordinate that moves most anywhere."""
        return int(self.amplitudes.reshape(-1, len(self.coordinates)).max(axis=0).argmax())

    @property
    def counts(self) -> str:
        """How many orbits there are, of which stability, why others are not, and which fraction is certified."""
        known, sure = int(self.known.sum()), int(self.sample[:, 2].sum())
        told = [f"{known} of {self.blank.size} pixels have an orbit"]
        for k, word in enumerate(STABILITIES):
            if count := int((self.known & (self.verdicts == k)).sum()):
                told.append(f"{count} {word}")
        blank = [f"{count} blank: {BLANK[k]}" for k in range(1, len(BLANK)) if (count := int((self.blank == k).sum()))]
        share = f"({100 * len(self.sample) / max(known, 1):.2g} %)"
        return "; ".join([", ".join(told), *blank, f"certified {sure} of {len(self.sample)} sampled {share}"])

    def _check(self) -> None:
        shape, n = (self.rows.size, self.columns.size), len(self.coordinates)
        wanted = {
            "blank": shape, "verdicts": shape, "periods": shape, "multipliers": (*shape, 2), "amplitudes": (*shape, n),
            "nodes": (*shape, *self.nodes.shape[2:4]), "unfolding": (*shape, *self.unfolding.shape[2:3]),
            "sample": (*self.sample.shape[:1], 3), "columns": shape[1:], "rows": shape[:1],
        }  # fmt: skip
        check_shapes(self, **wanted)
        check_curve(self.curve)
        rising = [axis.size and np.all(np.diff(axis) > 0) for axis in (self.rows, self.columns)]
        if not all(rising) or self.nodes.ndim < 4 or not on_mesh(self.nodes.shape[2] or 1, self.mesh):
            raise ValueError(
                "columns, rows, nodes, mesh: expected increasing values of the parameters, and orbits there"
            )
        if not np.all(self.periods[self.known] > 0):
            raise ValueError("periods: expected positive numbers where there are orbits")
        if self.by not in COLOURED:
            raise ValueError(f"by: {self.by!r} is none of {', '.join(COLOURED)}")
        for name, most in {"blank": len(BLANK), "verdicts": len(STABILITIES)}.items():
            if (
                not np.issubdtype(getattr(self, name).dtype, np.integer)
                or not np.isin(getattr(self, name), np.arange(most)).all()
            ):
                raise ValueError(f"{name}: expected whole numbers from 0 to {most - 1}")
        rows, columns = (self.sample[:, k] for k in (0, 1))
        whole = np.issubdtype(self.sample.dtype, np.integer) or not self.sample.size
        if not whole or not (np.isin(rows, np.arange(shape[0])) & np.isin(columns, np.arange(shape[1]))).all():
            raise ValueError("sample: expected whole numbers, rows and columns of the map")


CODEC = Codec(ParameterMap, "map", "`orbitfinder map`", "make the map again")


def save_map(plane: ParameterMap, path: str | Path) -> Path:
    """Write a map.json and, beside it, map.npz.

    Args:
        plane: the map.
        path: where.

    Returns:
        The path.

    Raises:
        InputError: where it cannot be written.

    Examples:
        >>> of.save_map(plane, "map.json").name
        'map.json'
    """
    return CODEC.save(plane, path)


def load_map(path: str | Path) -> ParameterMap:
    """Read a map.json and its map.npz.

    Args:
        path: of the file.

    Returns:
        A ParameterMap.

    Raises:
        InputError: on anything unreadable.

    Examples:
        >>> _ = of.save_map(plane, "map.json")
        >>> of.load_map("map.json").parameters
        ('damping', 'torque')
    """
    return CODEC.load(path)
