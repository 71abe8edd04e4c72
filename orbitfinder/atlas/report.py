"""What searches found, read from the atlas: yield of each strategy, failures by reason, how many may remain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from orbitfinder.atlas.store import Atlas
from orbitfinder.atlas.tables import explained


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

    `estimate` is Chao's lower bound of how many orbits these starts can find in all, with its standard error.
    """

    orbits: int
    starts: int
    hits: int
    new: int
    seconds: float
    yields: tuple[Yield, ...]
    failures: Mapping[str, int]
    estimate: tuple[float, float]

    def document(self) -> dict[str, Any]:
        """The same for `--json`."""
        return asdict(self) | {"estimate": {"total": self.estimate[0], "standard_error": self.estimate[1]}}


def summarise(atlas: Atlas, searches: Sequence[int] | None = None) -> Summary:
    """The summary of some searches by their ids, of all of them by default."""
    where, values = "1", list(searches or [])
    if searches is not None:
        where = f"search IN ({', '.join('?' * len(values))})"
    with explained(atlas.path):
        execute = atlas.connection.execute
        counted = execute(
            "SELECT strategy, count(*), sum(outcome != 'failed'), sum(outcome = 'new'), sum(seconds) "
            f"FROM starts WHERE {where} GROUP BY strategy ORDER BY 4 DESC, 1",
            values,
        ).fetchall()
        failed = execute(
            f"SELECT reason, count(*) FROM starts WHERE outcome = 'failed' AND {where} GROUP BY reason "
            "ORDER BY 2 DESC, 1",
            values,
        ).fetchall()
        met = execute(
            f"SELECT count(*) FROM starts WHERE orbit IS NOT NULL AND {where} GROUP BY orbit", values
        ).fetchall()
    yields = tuple(Yield(name, starts, hits, new, seconds) for name, starts, hits, new, seconds in counted)
    return Summary(
        orbits=len(atlas),
        starts=sum(one.starts for one in yields),
        hits=sum(one.hits for one in yields),
        new=sum(one.new for one in yields),
        seconds=float(sum(one.seconds for one in yields)),
        yields=yields,
        failures=dict(failed),
        estimate=chao1(np.array([count for (count,) in met], int)),
    )


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


def discovery(atlas: Atlas, search: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Processor seconds, distinct orbits and Chao's estimate after each start of a search."""
    with explained(atlas.path):
        rows = atlas.connection.execute(
            "SELECT orbit, seconds FROM starts WHERE search = ? ORDER BY number", [search]
        ).fetchall()
    met: dict[int, int] = {}
    distinct, estimates = [], []
    for orbit, _ in rows:
        if orbit is not None:
            met[orbit] = met.get(orbit, 0) + 1
        distinct.append(len(met))
        estimates.append(chao1(np.array(list(met.values()), int))[0])
    return np.cumsum([seconds for _, seconds in rows]), np.array(distinct, int), np.array(estimates)
