"""What vanishes along a curve of bifurcations in two parameters.

It is read off the reduced map of an orbit (see `stability.reduced_map`), by numbers that are smooth where multipliers
meet: products over all of them, the product of a pair, the squared distance of two stability indices.
Source: Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (2004), chapters 9 and 10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.changes import margins
from orbitfinder.families.registry import FOLLOWED, Followed
from orbitfinder.families.stability import Spectrum, keeps_pairs, reduced_maps
from orbitfinder.loops.continued import Curve, Solution
from orbitfinder.orbits.floquet import reciprocal_pairs

REAL = 1e-9
"""A product of two multipliers is real when its imaginary part is below this, relative to its size."""


@dataclass(frozen=True)
class Critical:
    """The test function of a curve of bifurcations; `parameters` are the two that vary.

    `multiplier` is the critical one of the root map. `margin` names what is grazed: arc, event and which.
    """

    _sparse = ("margin",)

    kind: str
    parameters: tuple[str, str]
    detail: str = ""
    order: int = 1
    multiplier: complex = 1.0 + 0.0j
    margin: tuple[int, str, str] | None = None

    def _check(self) -> None:
        if self.kind not in FOLLOWED:
            raise ValueError(f"kind: no curve leads along a {self.kind}")
        if (self.margin is None) != (self.followed.margin is None):
            raise ValueError(f"margin: does not go with a {self.kind}")

    @property
    def followed(self) -> Followed:
        """What the kind says of its curves."""
        followed: Followed = FOLLOWED[self.kind]
        return followed

    def __call__(self, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
        """The test at orbits (k). Raises `ConvergenceError` where it has no value."""
        return self.followed.vanishes(self, curve, orbits)

    def level(self, conservative: bool) -> float:
        """The value that a stability index, or a multiplier, has along the curve."""
        return float((2.0 if conservative else 1.0) * self.multiplier.real)

    def roots(self, about: Spectrum) -> tuple[np.ndarray, float]:
        """Indices (conservative) or multipliers of an orbit, and the value that one of them has along the curve."""
        return about.indices if about.conservative else about.root_multipliers, self.level(about.conservative)


def at_level(test: Critical, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """A root has the value that it has along the curve."""
    roots, conservative = _roots(curve, orbits)
    return _levelled(roots, test.level(conservative))


def pair_at_circle(_: Critical, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """The product of a pair is 1."""
    return np.array([torus_pair(multipliers)[0] - 1.0 for multipliers in _multipliers(curve, orbits)])


def neutral(curve: Curve, orbit: Solution) -> str:
    """Of a pair of product 1 that is real that it is no torus's."""
    real = abs(torus_pair(_multipliers(curve, [orbit])[0])[1]) >= 2.0
    return "two real multipliers of product 1, a neutral saddle and no torus" if real else ""


def indices_meet(_: Critical, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """Two stability indices are one."""
    return np.array([discriminant(roots) for roots in _roots(curve, orbits)[0]])


def grazed(test: Critical, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """The margin of the curve."""
    assert test.margin is not None
    known = [margins(curve, orbit).get(test.margin) for orbit in orbits]
    if None in known:
        raise ConvergenceError(f"what is grazed is no longer near {test.margin[1]}; take a smaller step")
    return np.array([margin.value for margin in known if margin])


def _multipliers(curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """Those of each orbit's root map (k x r)."""
    return np.linalg.eigvals(reduced_maps(curve, orbits)[0]).astype(complex)


def _roots(curve: Curve, orbits: Sequence[Solution]) -> tuple[np.ndarray, bool]:
    """Stability indices (k x ...) where multipliers of all orbits come in pairs, as is said, else multipliers."""
    reduced = reduced_maps(curve, orbits)[0]
    roots, conservative = np.linalg.eigvals(reduced).astype(complex), keeps_pairs(curve, reduced)
    if conservative:
        pairs = [(own, *reciprocal_pairs(own)) for own in roots]
        roots = np.array([own[first] + own[second] for own, first, second in pairs])
    return roots, conservative


def levelled(roots: np.ndarray, level: float) -> float:
    """prod (level - r_i) over roots, each by its size, which is 0 where one of them is there."""
    return float(_levelled(roots, level))


def _levelled(roots: np.ndarray, level: float) -> np.ndarray:
    """The same of several (k x r)."""
    return np.asarray(np.prod((level - roots) / _sizes(roots), axis=-1).real)


def doubled(roots: np.ndarray, level: float) -> float:
    """The derivative of that product by the level, which is 0 too where two of the roots are there."""
    sizes = _sizes(roots)
    parts = (level - roots) / sizes
    return float(sum(np.prod(np.delete(parts, k)) / sizes[k] for k in range(roots.size)).real)


def _sizes(roots: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(1.0 + np.abs(roots) ** 2))


def torus_pair(roots: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Product and sum of the two multipliers whose product is real and nearest to 1, and the others.

    They are those of a torus, or of a neutral saddle.
    """
    real = [pair for pair in combinations(range(roots.size), 2)
            if abs((one := np.prod(roots[list(pair)])).imag) <= REAL * (1 + abs(one))]  # fmt: skip
    if not real:
        raise ConvergenceError("no two multipliers are left that could leave the unit circle together")
    i, j = min(real, key=lambda pair: abs(roots[pair[0]] * roots[pair[1]] - 1.0))
    return float((roots[i] * roots[j]).real), float((roots[i] + roots[j]).real), np.delete(roots, [i, j])


def discriminant(indices: np.ndarray) -> float:
    """(kappa_i - kappa_j)^2 of the two nearest stability indices."""
    first, other = nearest_pair(indices)
    return float(((first - other) ** 2).real)


def nearest_pair(indices: np.ndarray) -> tuple[complex, complex]:
    """The two stability indices that are nearest to each other."""
    if indices.size < 2:
        raise ConvergenceError("no two stability indices are left that could meet")
    return min(combinations(map(complex, indices), 2), key=lambda pair: abs(pair[0] - pair[1]))
