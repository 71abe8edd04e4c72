"""Invariant tori as plain numbers, and their file (format "orbitfinder/tori")."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import shortened
from orbitfinder.records.certificate import Certified, certified
from orbitfinder.records.codec import Codec, Unknown
from orbitfinder.records.table import Tabled, Tables, entries, known_levels, placed


@dataclass(frozen=True)
class Torus(Shown):
    """One quasi-periodic motion: a closed curve X(theta) that the flow over T turns by 2 pi `rotation`.

    `frequencies` are those of the returns and of the turning (rad/s).

    Args:
        curve: states at equal angles (N x d, N odd).
        period: T in s.
        rotation: turns a return.
        energy: J, nan without any.
        tail: size of the highest harmonics relative to the curve's.
        strip: width of the strip of complex angles in which the series converges (0: the torus breaks down).
        free: physical parameters that were solved for with it.
        certificate: its checks.

    Examples:
        >>> torus = tori.tori[-1]
        >>> torus.curve.shape[1], round(torus.rotation, 9)
        (4, 0.197056417)
    """

    __repr__ = brief("period", "rotation", "energy", "frequencies", "certificate")
    _entries = (..., "energy", "certificate")

    curve: np.ndarray
    period: float
    rotation: float
    energy: Unknown
    tail: float
    strip: float
    free: Mapping[str, float] = field(default_factory=dict)
    certificate: Certified = None

    @property
    def frequencies(self) -> tuple[float, float]:
        """Angular frequencies (rad/s): of the returns, and of the turning."""
        first = 2 * np.pi / self.period
        return first, first * self.rotation

    def _check(self) -> None:
        if self.curve.ndim != 2 or len(self.curve) % 2 == 0 or not np.abs(self.curve).max(initial=0.0) < 1e100:
            raise ValueError(f"curve: expected an odd number of states, got numbers of shape {self.curve.shape}")
        if not self.period > 0:
            raise ValueError(f"period: expected more than 0, got {self.period:g}")


@dataclass(frozen=True)
class Tori(Tabled):
    """A family of tori of a system.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        parameter: what changes along it.
        held: what is the same for all, by name.
        tori: in order.
        end: why it ends.
        title: what pictures are headed with; the name where it is empty.

    Examples:
        >>> tori.parameter, list(tori.held)
        ('rotation', ['energy'])
    """

    __repr__ = brief("name", "parameter", "held", "tori", "end")
    _entries = (..., "end", "tori")
    _sparse = ("title",)

    name: str
    system: Mapping[str, Any]
    parameter: str
    held: Mapping[str, float]
    tori: tuple[Torus, ...]
    end: str = ""
    title: str = ""

    def own_tables(self) -> Tables:
        """Its table, and why it ends."""
        tori = self.tori
        held = {name: [value] * len(tori) for name, value in self.held.items()}
        free = {name: [torus.free.get(name, np.nan) for torus in tori] for name in tori[0].free}
        frequencies = np.array([torus.frequencies for torus in tori])
        numbers = entries(tori, "rotation", "tail", "strip") | {"certified": [*map(certified, tori)]}
        return {
            "points": placed(free, held | known_levels(tori) | {
                "frequency_1": frequencies[:, 0], "frequency_2": frequencies[:, 1], **numbers}),
            "ends": {"reason": [self.end]},
        }  # fmt: skip

    def _check(self) -> None:
        if len({torus.curve.shape[1] for torus in self.tori}) != 1:
            raise ValueError("tori: expected one at least, all of one number of coordinates")
        if unknown := {self.parameter, *self.held} - {"rotation", "energy", "period", *self.tori[0].free}:
            raise ValueError(f"parameter, held: {shortened(min(unknown))!r} is not a number of these tori")


CODEC = Codec(Tori, "tori", "`orbitfinder torus`", "compute the tori again")


def save_tori(found: Tori, path: str | Path) -> Path:
    """Write a tori.json.

    Args:
        found: the tori.
        path: where.

    Returns:
        The path.

    Raises:
        InputError: where it cannot be written.

    Examples:
        >>> of.save_tori(tori, "tori.json").name
        'tori.json'
    """
    return CODEC.save(found, path)


def load_tori(path: str | Path) -> Tori:
    """Read a tori.json.

    Args:
        path: of the file.

    Returns:
        Tori.

    Raises:
        InputError: on anything unreadable.

    Examples:
        >>> _ = of.save_tori(tori, "tori.json")
        >>> len(of.load_tori("tori.json").tori)
        2
    """
    return CODEC.load(path)
