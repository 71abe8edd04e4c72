"""How many orbits there are at least, and what the starts of a search could not see.

A start that imposes a symmetry meets only orbits that have it, so orbits are counted apart by energy and symmetry:
over such strata the lower bound of Chao adds up, and it is never less than that of all counts in one heap. It is a
bound in expectation and silent on orbits that starts rarely meet. What can be said of those: K starts miss an orbit
that each meets with probability p with probability (1 - p)^K, which is above 5 % for p < 3 / K (the rule of three:
J. A. Hanley, A. Lippman-Hand, JAMA 249 (1983) 1743-1745).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfinder.atlas.starts import STRATEGIES


@dataclass(frozen=True)
class Stratum:
    """Orbits of one energy (J) and symmetry: how many were met, `once` and in all, and by how many starts.

    `starts` counts those that can meet such an orbit, `least` is Chao's lower bound with its standard error, and
    `coverage` the part of further hits that would be known orbits (Good and Turing), None without hits.
    """

    energy: float
    symmetry: str
    orbits: int
    once: int
    hits: int
    starts: int
    least: float
    standard_error: float
    coverage: float | None


def stratum(energy: float, symmetry: str, counts: np.ndarray, made: Mapping[str, int]) -> Stratum:
    """The stratum in which orbits were met so often (k), after so many starts of each strategy at its energy."""
    hits, once = int(counts.sum()), int(np.sum(counts == 1))
    least, error = chao1(counts)
    able = sum(starts for strategy, starts in made.items() if reaches(strategy, symmetry))
    # I. J. Good, Biometrika 40 (1953) 237-264
    return Stratum(energy, symmetry, len(counts), once, hits, able, least, error, 1 - once / hits if hits else None)


def reaches(strategy: str, symmetry: str) -> bool:
    """True when starts of a strategy can end in an orbit of a symmetry: when it has all that they impose."""
    imposed = STRATEGIES[strategy][0] if strategy in STRATEGIES else "none"
    return imposed == "none" or set(imposed.split("+")) <= set(symmetry.split("+"))


def total(strata: Sequence[Stratum]) -> tuple[float, float]:
    """The sum of the lower bounds, and its standard error."""
    return sum(one.least for one in strata), float(np.hypot.reduce([0.0, *(one.standard_error for one in strata)]))


def remarks(strata: Sequence[Stratum], stalled: int) -> tuple[str, ...]:
    """The estimate and what it does not cover, a sentence each."""
    least, error = total(strata)
    doubt = f" +- {error:.0f}" if error >= 0.5 else ""
    found = [f"at least about {least:.0f}{doubt} orbits in all (Chao1 by energy and symmetry, a lower bound)"]
    if stalled:
        found.append(f"starts that stalled near degenerate orbits: {stalled}; what lies there may be missing")
    if once := sum(one.once for one in strata):
        found.append(f"orbits met only once: {once}; more like them are likely")
    found += [unseen(one) for one in sorted(strata, key=lambda one: one.starts)[:1]]
    return tuple(found)


def unseen(one: Stratum) -> str:
    """What may be missing in a stratum."""
    kind = "without symmetry" if one.symmetry == "none" else f"of symmetry {one.symmetry}"
    sought = f"orbits {kind} at {one.energy:g} J were sought by {one.starts} starts"
    if one.starts < 6:
        return f"{sought}: too few to say how many there are"
    return f"{sought} only: what fewer than 1 in {one.starts // 3} of these would meet may be missing"


def mirrored(mirror: str, begun: int) -> str:
    """What the starts know of a mirror that is no coordinate symmetry with a name."""
    return f"the system's mirror {mirror} was imposed by no start, and images under it count apart; {begun} began on it"


def chao1(counts: np.ndarray) -> tuple[float, float]:
    """Estimate (a lower bound) of the number of kinds and its standard error, from how often each was met.

    S + (m - 1)/m f1 (f1 - 1) / (2 (f2 + 1)) with f1 kinds met once, f2 met twice, m meetings in all;
    bias-corrected form and its variance: A. Chao, Biometrics 43 (1987) 783-791; R. K. Colwell,
    EstimateS user's guide, equations 2 and 6.
    """
    seen, meetings = int(np.sum(counts > 0)), int(counts.sum())
    once, twice = int(np.sum(counts == 1)), int(np.sum(counts == 2))
    if not meetings:
        return 0.0, 0.0
    share = (meetings - 1) / meetings
    more = share * once * (once - 1) / (2 * (twice + 1))
    variance = (
        more
        + share**2 * once * (2 * once - 1) ** 2 / (4 * (twice + 1) ** 2)
        + share**2 * once**2 * twice * (once - 1) ** 2 / (4 * (twice + 1) ** 4)
    )
    return seen + more, float(np.sqrt(variance))
