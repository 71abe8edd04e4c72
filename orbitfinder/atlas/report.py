"""What searches found, read from the atlas: yield of each strategy, failures by reason, how many may remain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder.atlas.estimate import Stratum, chao1, mirrored, remarks, stratum, total
from orbitfinder.atlas.store import RESTORE, Atlas
from orbitfinder.records.reading import json_document, read_as


@dataclass(frozen=True)
class Yield:
    """What one strategy made: starts, hits (orbits met), new ones, and processor seconds."""

    strategy: str
    starts: int
    hits: int
    new: int
    seconds: float


@dataclass(frozen=True)
class Summary:
    """Some searches of an atlas, or all of them, in numbers.

    `strata` are the orbits met, by energy and symmetry; `stalled` counts starts that stalled near degenerate orbits;
    `mirrors` are symmetries of the system that nobody declared.
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
    mirrors: tuple[str, ...] = ()

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
        begun = sum(one.starts for one in self.yields if one.strategy == "mirror")
        return (*remarks(self.strata, self.stalled), *(mirrored(one, begun) for one in self.mirrors))

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
    methods = atlas.select([str], f"SELECT method FROM searches WHERE {where.replace('search ', 'id ')}", values)
    yields = tuple(Yield(name, starts, hits, new, seconds) for name, starts, hits, new, seconds in counted)
    return Summary(
        orbits=len(atlas),
        starts=sum(one.starts for one in yields),
        hits=sum(one.hits for one in yields),
        new=sum(one.new for one in yields),
        seconds=float(sum(one.seconds for one in yields)),
        yields=yields,
        failures=dict(failed),
        strata=stratified(atlas, where, values),
        mirrors=tuple(sorted({one for (method,) in methods for one in _mirrors(method, str(atlas.path))})),
    )


def _mirrors(method: str, where: str) -> tuple[str, ...]:
    """The undeclared mirrors that a search started from."""
    known = read_as(dict[str, Any], json_document(method.encode(), f"{where}: method", RESTORE), where, RESTORE)
    return read_as(tuple[str, ...], known.get("mirrors", []), where, RESTORE)  # type: ignore[no-any-return]


def stratified(atlas: Atlas, where: str, values: Sequence[int]) -> tuple[Stratum, ...]:
    """The orbits that some starts met, by energy and symmetry; those without symmetry even where none was met."""
    joined = f"starts JOIN searches ON searches.id = starts.search WHERE {where}"
    made: dict[float, dict[str, int]] = {}
    for energy, strategy, count in atlas.select(
        [float, str, int],
        f"SELECT searches.energy, strategy, count(*) FROM {joined} GROUP BY searches.energy, strategy",
        values,
    ):
        made.setdefault(energy, {})[strategy] = count
    met: dict[tuple[float, str], list[int]] = {(energy, "none"): [] for energy in made}
    for energy, symmetry, count in atlas.select(
        [float, str, int],
        "SELECT searches.energy, symmetry, count(*) FROM orbits JOIN starts ON starts.orbit = orbits.id "
        f"JOIN searches ON searches.id = starts.search WHERE {where} GROUP BY searches.energy, orbits.id",
        values,
    ):
        met.setdefault((energy, symmetry), []).append(count)
    return tuple(stratum(*key, np.array(counts, int), made[key[0]]) for key, counts in sorted(met.items()))


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
        distinct.append(sum(len(one) for one in met.values()))
        estimates.append(sum(chao1(np.array(list(one.values()), int))[0] for one in met.values()))
    return np.cumsum([seconds for *_, seconds in rows]), np.array(distinct, int), np.array(estimates)
