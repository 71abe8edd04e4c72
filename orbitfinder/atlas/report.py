"""What searches found, read from the atlas: yield of each strategy, failures by reason, how many may remain.

A start that imposes a symmetry meets only orbits that have it, so orbits are counted apart by energy and symmetry:
over such strata the lower bound of Chao adds up, and it is never less than that of all counts in one heap. It is a
bound in expectation and silent on orbits that starts rarely meet. What can be said of those: K starts miss an orbit
that each meets with probability p with probability (1 - p)^K, which is above 5 % for p < 3 / K (the rule of three:
J. A. Hanley, A. Lippman-Hand, JAMA 249 (1983) 1743-1745).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder.atlas.solver import GAVE_UP
from orbitfinder.atlas.starts import DECLARED, STRATEGIES
from orbitfinder.atlas.store import Atlas, parameters_in_words
from orbitfinder.errors import InputError, plural


@dataclass(frozen=True)
class Yield:
    """What one strategy made: starts, hits (orbits met), new ones, and processor seconds."""

    strategy: str
    starts: int
    hits: int
    new: int
    seconds: float


@dataclass(frozen=True)
class Stratum:
    """Orbits of an energy (J), a symmetry and a set of parameters: how many were met, `once` and in all, by how many
    starts.

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
    parameters: str = ""
    conserved: bool = True
    """whether the system conserves the energy, which is 0 without it"""

    @property
    def at(self) -> str:
        """Energy and parameters in words, "" of a system without either."""
        words = [f"{self.energy:g} J"] * self.conserved + [parameters_in_words(self.parameters)] * bool(self.parameters)
        return f" at {', '.join(words)}" if words else ""


@dataclass(frozen=True)
class Summary:
    """Some searches of an atlas, or all of them, in numbers.

    `strata` are the orbits met, by energy and symmetry; `stalled` counts starts that stalled near degenerate orbits,
    `beyond` says what no start looks for.
    """

    __repr__ = brief("orbits", "starts")

    orbits: int
    starts: int
    hits: int
    new: int
    seconds: float
    yields: tuple[Yield, ...]
    failures: Mapping[str, int]
    strata: tuple[Stratum, ...]
    beyond: str = ""

    @property
    def estimate(self) -> tuple[float, float]:
        """Chao's lower bound of how many orbits these starts can find in all, and its standard error."""
        return total(self.strata)

    @property
    def stalled(self) -> int:
        """Starts that came near a degenerate orbit and reached none."""
        return sum(count for reason, count in self.failures.items() if "stalled" in reason)

    @property
    def remarks(self) -> tuple[str, ...]:
        """The estimate and what it does not cover, a sentence each."""
        lost = sum(self.failures.get(reason, 0) for reason in GAVE_UP)
        gone = f"starts that gave up on their way: {lost} of {self.starts}; what only such come near is in no estimate"
        beyond = [f"in no estimate: {self.beyond}"] if self.beyond else []
        return (*remarks(self.strata, self.stalled), *beyond, *([gone] if lost else []))

    def document(self) -> dict[str, Any]:
        """The same for `--json`; no standard error where nothing was met only once: there is nothing to judge by."""
        least, error = self.estimate
        judged = {"total": least, "standard_error": error or None, "remarks": self.remarks}
        return asdict(self) | {"stalled": self.stalled, "estimate": judged}


def summarise(atlas: Atlas, searches: Sequence[int] | None = None) -> Summary:
    """The summary of some searches by their ids, of all of them by default."""
    where, values = "1", list(searches or [])
    if searches is not None:
        where = f"search IN ({', '.join('?' * len(values))})"
    counted = atlas.select(
        [str, int, int, int, float],
        "SELECT strategy, count(*), sum(outcome != 'failed'), sum(outcome = 'new'), sum(seconds) "
        f"FROM starts WHERE {where} GROUP BY strategy ORDER BY 4 DESC, 1",
        values,
    )
    failed = atlas.select(
        [str, int],
        f"SELECT reason, count(*) FROM starts WHERE outcome = 'failed' AND {where} GROUP BY reason ORDER BY 2 DESC, 1",
        values,
    )
    yields = tuple(Yield(*row) for row in counted)
    return Summary(
        orbits=len(atlas),
        starts=sum(strategy.starts for strategy in yields),
        hits=sum(strategy.hits for strategy in yields),
        new=sum(strategy.new for strategy in yields),
        seconds=float(sum(strategy.seconds for strategy in yields)),
        yields=yields,
        failures=dict(failed),
        strata=stratified(atlas, where, values),
        beyond=_beyond(atlas),
    )


def _beyond(atlas: Atlas) -> str:
    """What starts of an atlas's system never lead to; "" where the system cannot be made."""
    try:
        model = atlas.model
    except InputError:
        return ""
    if atlas.controlled:
        return "optima that no loop of three harmonics as large as the guess's motion leads to"
    attracted = "orbits away from what motions from random states settle on"
    if not model.smooth:
        return "orbits of more cycles than were asked for, and those that do not begin in the section"
    if model.forced:
        return f"{attracted}, and periods that are no multiples of the forcing's"
    if model.rates is None:
        return "parts of the energy shell without positions within half a turn and two of its lengths of the rest"
    return "parts of the level set that no ray from an equilibrium meets" if model.invariants else attracted


def stratified(atlas: Atlas, where: str, values: Sequence[int]) -> tuple[Stratum, ...]:
    """The orbits that some starts met, by energy and symmetry; those without symmetry even where none was met."""
    joined = f"starts JOIN searches ON searches.id = starts.search WHERE {where}"
    at, made = "coalesce(json_extract(searches.method, '$.parameters'), '')", dict[tuple[float, str], dict[str, int]]()
    for energy, words, strategy, count in atlas.select(
        [float, str, str, int],
        f"SELECT searches.energy, {at}, strategy, count(*) FROM {joined} GROUP BY searches.energy, {at}, strategy",
        values,
    ):
        made.setdefault((energy, words), {})[strategy] = count
    met: dict[tuple[float, str, str], list[int]] = {(energy, words, "none"): [] for energy, words in made}
    for energy, words, symmetry, count in atlas.select(
        [float, str, str, int],
        f"SELECT searches.energy, {at}, symmetry, count(*) FROM orbits JOIN starts ON starts.orbit = orbits.id "
        f"JOIN searches ON searches.id = starts.search WHERE {where} GROUP BY searches.energy, {at}, orbits.id",
        values,
    ):
        met.setdefault((energy, words, symmetry), []).append(count)
    conserved = atlas.conserved
    return tuple(
        replace(
            stratum(energy, symmetry, np.array(counts, int), made[energy, words]),
            parameters=words,
            conserved=conserved,
        )
        for (energy, words, symmetry), counts in sorted(met.items())
    )


def discovery(atlas: Atlas, search: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Processor seconds, distinct orbits and Chao's estimate after each start of a search."""
    rows = atlas.select(
        [int | None, str | None, float],
        "SELECT orbit, symmetry, seconds FROM starts LEFT JOIN orbits ON orbits.id = starts.orbit "
        "WHERE search = ? ORDER BY number",
        [search],
    )
    met: dict[str, Counter[int]] = {}
    distinct, estimates = [], []
    for orbit, symmetry, _ in rows:
        if orbit is not None:
            met.setdefault(symmetry or "", Counter())[orbit] += 1
        distinct.append(sum(len(orbits) for orbits in met.values()))
        estimates.append(sum(chao1(np.array(list(orbits.values()), int))[0] for orbits in met.values()))
    return np.cumsum([seconds for *_, seconds in rows]), np.array(distinct, int), np.array(estimates)


def stratum(energy: float, symmetry: str, counts: np.ndarray, made: Mapping[str, int]) -> Stratum:
    """The stratum in which orbits were met so often (k), after so many starts of each strategy at its energy."""
    hits, once = int(counts.sum()), int(np.sum(counts == 1))
    least, error = chao1(counts)
    able = sum(starts for strategy, starts in made.items() if reaches(strategy, symmetry))
    # I. J. Good, Biometrika 40 (1953) 237-264
    return Stratum(energy, symmetry, len(counts), once, hits, able, least, error, 1 - once / hits if hits else None)


def reaches(strategy: str, symmetry: str) -> bool:
    """True when starts of a strategy can end in an orbit of a symmetry: when it has all that they impose."""
    named = strategy.removeprefix(DECLARED) if strategy.startswith(DECLARED) else "none"
    imposed = STRATEGIES[strategy][0] if strategy in STRATEGIES else named
    return imposed == "none" or set(imposed.split("+")) <= set(symmetry.split("+"))


def total(strata: Sequence[Stratum]) -> tuple[float, float]:
    """The sum of the lower bounds, and its standard error."""
    return sum(each.least for each in strata), float(np.hypot.reduce([0.0, *(each.standard_error for each in strata)]))


def remarks(strata: Sequence[Stratum], stalled: int) -> tuple[str, ...]:
    """The estimate and what it does not cover, a sentence each."""
    least, error = total(strata)
    doubt = f" +- {error:.0f}" if error >= 0.5 else ""
    told = plural(round(least), "orbit") if not doubt else f"{least:.0f}{doubt} orbits"
    sentences = [f"at least about {told} in all (Chao1 by energy and symmetry, a lower bound)"]
    if stalled:
        sentences.append(f"starts that stalled near degenerate orbits: {stalled}; what lies there may be missing")
    if once := sum(each.once for each in strata):
        sentences.append(f"orbits met only once: {once}; more like them are likely")
    sentences += [unseen(each) for each in sorted(strata, key=lambda each: each.starts)[:1]]
    return tuple(sentences)


def unseen(where: Stratum) -> str:
    """What may be missing in a stratum."""
    kind = "without symmetry" if where.symmetry == "none" else f"of symmetry {where.symmetry}"
    sought = f"orbits {kind}{where.at} were sought by {plural(where.starts, 'start')}"
    if where.starts < 6:
        return f"{sought}: too few to say how many there are"
    return f"{sought} only: what fewer than 1 in {where.starts // 3} of these would meet may be missing"


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
