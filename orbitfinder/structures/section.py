"""Poincare sections as plain numbers, and their files: section.json with the numbers beside it in section.npz.

What tells chaos from order is the mean exponential growth of nearby orbits (MEGNO) of the returns: where a deviation
has grown to d_k after k of them,

    Y_n = 2/n sum_k k ln(d_k / d_(k-1)),    <Y>_n = 1/n sum_k Y_k,

which goes to 2 on a torus, d_k ~ k, to less where less than that, and to sigma n / 2 where d_k ~ exp(sigma k).
Source: P. Cincotta, C. Simo, "Simple tools to study global dynamics in non-axisymmetric galactic potentials - I",
Astronomy and Astrophysics Supplement Series 147 (2000) 205-228, section 4, with returns for time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.records.codec import Codec, Dense, Filed, Unknown, check_axes, check_shapes

CLEAR, FEWEST = 2.0, 20
"""How much nearer a law comes than the other before it is said to hold; returns of which anything is said"""
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
    the motions began, `growth` (k) is the logarithm of what a deviation on the plane has grown by until then, infinite
    where that is not known. Files before 0.3 have one number a motion there, of which nothing is made. `title` is what
    pictures are headed with.
    """

    __repr__ = brief("name", "plane", "energy", "returns")
    _sparse = ("title",)

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
    title: str = ""

    @property
    def returns(self) -> int:
        """How many crossings there are in all."""
        return len(self.states)

    @property
    def told(self) -> bool:
        """Whether growths are known."""
        return self.growth.shape == self.times.shape and bool(np.isfinite(self.growth).any())

    @cached_property
    def kinds(self) -> np.ndarray:
        """What each motion (m) is: "regular", "chaotic", or "undecided" where the indicator does not say.

        Of <Y> over the second half of the returns, taken as 2 where it is less: chaotic where a line through 0 comes
        nearer than 2 by a factor of `CLEAR`, regular where else a constant comes nearer than the line by as much.
        """
        kinds = np.full(len(self.starts), "undecided")
        for k in range(len(kinds)) if self.told else ():
            mean = self.megno(k)
            n = np.arange(1, mean.size + 1)[(half := mean.size // 2) :]
            if mean.size < FEWEST or not np.isfinite(mean).all():
                continue
            above = np.maximum(mean[half:], 2.0)
            line = above - n * (above @ n) / (n @ n)
            torus, flat, line = (float(np.sqrt(np.mean(off**2))) for off in (above - 2.0, above - above.mean(), line))
            if torus > CLEAR * line or line > CLEAR * flat:
                kinds[k] = "chaotic" if torus > CLEAR * line else "regular"
        return kinds

    def megno(self, motion: int) -> np.ndarray:
        """<Y> of a motion after each of its returns."""
        steps = np.diff(self.growth[self.seeds == motion], prepend=0.0)
        n = np.arange(1, steps.size + 1)
        return np.cumsum(2 / n * np.cumsum(n * steps)) / n

    @property
    def regular(self) -> np.ndarray:
        """Which motions (m) are said to be regular."""
        return np.asarray(self.kinds == "regular")

    @property
    def points(self) -> np.ndarray:
        """The crossings in the axes (k x 2)."""
        return self.states[:, [self.state_names.index(name) for name in self.axes]]

    def _check(self) -> None:
        check_axes(self)
        count, motions, d = self.times.size, len(np.atleast_1d(self.starts)), len(self.state_names)
        check_shapes(self, states=(count, d), times=(count,), seeds=(count,), starts=(motions, d),
                     growth=(count,) if self.growth.shape == (count,) else (motions,))  # fmt: skip
        if not motions or self.seeds.dtype.kind != "i" or not np.isin(self.seeds, np.arange(motions)).all():
            raise ValueError(f"seeds: expected numbers of {motions} motions, counted from 0")


CODEC = Codec(Section, "section", "`orbitfinder section`", "make the section again")


def save_section(section: Section, path: str | Path) -> Path:
    """Write section.json and, beside it, section.npz; returns the JSON's path."""
    return CODEC.save(section, path)


def load_section(path: str | Path) -> Section:
    """The Section of a section.json and its section.npz. Raises `InputError`."""
    return CODEC.load(path)
