"""A search: starts handed out in order, their results judged and written in order, by this process alone.

The order makes the result independent of the number of workers and of when they answer, and makes
the recorded starts a prefix of all starts, from which a search that was killed goes on.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from orbitfinder._runtime import limit
from orbitfinder.atlas.attempt import Attempt
from orbitfinder.atlas.continuing import CONTINUATION
from orbitfinder.atlas.job import Order, Task
from orbitfinder.atlas.starts import METHOD, Bench, strategy_of
from orbitfinder.atlas.store import Atlas
from orbitfinder.atlas.tables import explained, transaction
from orbitfinder.atlas.workers import Workers

AHEAD = 32
"""Starts for each place among the workers that may be under way or unjudged: bounds the memory."""
MOST_SOURCES = 80
"""Known orbits that a search at another energy continues from."""
PATIENCE = 0.2
"""Seconds between two looks at the clock."""


@dataclass(frozen=True)
class Limits:
    """When a search ends: at this many starts in all, after this many seconds of now, or at either."""

    starts: int | None = None
    budget: float | None = None


@dataclass
class Tally:
    """What a search has done in this run; `orbits` are those in the atlas."""

    done: int = 0
    hits: int = 0
    new: int = 0
    duplicates: int = 0
    orbits: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    began: float = field(default_factory=time.monotonic)
    begun_at: int = 0
    """number of the first start of this run"""
    ended: float | None = None

    @property
    def elapsed(self) -> float:
        """Seconds since it began, or that it took."""
        return (time.monotonic() if self.ended is None else self.ended) - self.began

    def left(self, limits: Limits) -> float | None:
        """Seconds that are left, as far as one can tell."""
        found = [] if limits.budget is None else [max(0.0, limits.budget - self.elapsed)]
        if limits.starts is not None and self.done:
            found.append(max(0, limits.starts - self.begun_at - self.done) * self.elapsed / self.done)
        return min(found) if found else None


Progress = Callable[[Tally], None]


def register(atlas: Atlas, task: Task, one: Bench) -> tuple[int, int]:
    """The id of this search in its atlas and the number of its next start.

    A search is its energy, range of periods, seed and method; whoever asks for the same goes on with it.
    """
    names = one.model.state_names[: one.model.degrees_of_freedom]
    mirrored = {"mirrors": [mirror.moves(names) for mirror in one.mirrors]} if one.mirrors else {}
    method = json.dumps({"method": METHOD, "strategies": one.strategies} | mirrored)
    key = [task.energy, *task.periods, task.seed, method]
    with explained(atlas.path), transaction(atlas.connection):
        atlas.connection.execute(
            "INSERT OR IGNORE INTO searches (energy, shortest, longest, seed, method, sources) "
            "SELECT ?, ?, ?, ?, ?, coalesce(max(id), 0) FROM orbits",
            key,
        )
        search = atlas.connection.execute(
            "SELECT id FROM searches WHERE energy = ? AND shortest = ? AND longest = ? AND seed = ? AND method = ?", key
        ).fetchone()[0]
        after = atlas.connection.execute("SELECT max(number) FROM starts WHERE search = ?", [search]).fetchone()[0]
    return int(search), 0 if after is None else int(after) + 1


def sources(atlas: Atlas, search: int) -> list[int]:
    """Orbits of other energies that the atlas held when the search was first asked for, nearest energy first."""
    found = atlas.select(
        [int],
        "SELECT orbits.id FROM orbits, searches WHERE searches.id = ? AND orbits.id <= searches.sources "
        "AND abs(orbits.energy - searches.energy) > 1e-6 * max(1.0, abs(searches.energy)) "
        "ORDER BY abs(orbits.energy - searches.energy), orbits.id LIMIT ?",
        [search, MOST_SOURCES],
    )
    return [number for (number,) in found]


class Search:
    """The state of one run of a search; `run` is all that one calls."""

    def __init__(self, atlas: Atlas, task: Task, one: Bench, limits: Limits, progress: Progress | None = None) -> None:
        self._atlas, self._bench, self._limits, self._progress = atlas, one, limits, progress
        self.id, self._head = register(atlas, task, one)
        self._sources = sources(atlas, self.id)
        self._issued = self._head
        self._under_way = 0
        self._answers: dict[int, Attempt] = {}
        self.tally = Tally(orbits=len(atlas), begun_at=self._head)

    def run(self, workers: Workers) -> Tally:
        """Hand out, judge and write until a limit is reached; starts under way are waited for."""
        for row in self._atlas.rows():
            workers.learn((row.energy, row.period, abs(row.action)))
        while self._hand_out(workers) or self._under_way:
            limit.check()
            for order, attempt in workers.results(PATIENCE):
                self._under_way -= 1
                self._answers[order.number] = attempt
            while self._head in self._answers and self._judged(workers, self._answers.pop(self._head)):
                self._head += 1
        self.tally.ended = time.monotonic()
        return self.tally

    def _wanted(self) -> bool:
        """True while more starts are to be handed out."""
        late = self._limits.budget is not None and self.tally.elapsed >= self._limits.budget
        return not late and (self._limits.starts is None or self._issued < self._limits.starts)

    def _hand_out(self, workers: Workers) -> bool:
        """Give starts to idle workers; True while more are wanted."""
        while self._wanted():
            if not (workers.room > 0 and self._issued < self._head + AHEAD * (self._under_way + workers.room)):
                return True
            self._submit(workers, self._order(self._issued))
            self._issued += 1
        return False

    def _submit(self, workers: Workers, order: Order) -> None:
        workers.submit(order)
        self._under_way += 1

    def _order(self, number: int, certain: bool = False) -> Order:
        """Numbers below the count of sources continue from them; the others follow their strategy."""
        source = self._atlas.document(self._sources[number]) if number < len(self._sources) else None
        return Order(number, certain, source)

    def _judged(self, workers: Workers, attempt: Attempt) -> bool:
        """Write what became of a start; False when it must be done again, all the way to its certificate."""
        if not attempt.strategy:  # its worker died
            name = CONTINUATION if attempt.index < len(self._sources) else strategy_of(self._bench, attempt.index)
            attempt = replace(attempt, strategy=name)
        outcome, number = record(self._atlas, self.id, attempt)
        if outcome == "uncertain":
            self._submit(workers, self._order(attempt.index, certain=True))
            return False
        if outcome == "new":
            assert attempt.signature is not None and number is not None
            self._atlas.remember(number, attempt.signature)
            workers.learn((attempt.signature.energy, attempt.signature.period, attempt.signature.action))
        self._count(outcome, attempt)
        return True

    def _count(self, outcome: str, attempt: Attempt) -> None:
        tally = self.tally
        tally.done += 1
        tally.hits += outcome in ("new", "duplicate")
        tally.new += outcome == "new"
        tally.duplicates += outcome == "duplicate"
        tally.orbits += outcome == "new"
        if outcome == "failed":
            tally.failures[attempt.reason] += 1
        limit.note(f"{tally.done} starts of this run are in the atlas; the same search goes on from there")
        if self._progress:
            self._progress(tally)


def record(atlas: Atlas, search: int, attempt: Attempt) -> tuple[str, int | None]:
    """Judge an attempt and write it with its orbit, all in one transaction: (outcome, id of its orbit).

    Outcomes: new, duplicate, failed; `elsewhere` when another writer has recorded this start;
    `uncertain` (nothing written) when an orbit that seemed known is not, and lacks its certificate.
    """
    with explained(atlas.path), transaction(atlas.connection):
        execute = atlas.connection.execute
        if execute("SELECT 1 FROM starts WHERE search = ? AND number = ?", [search, attempt.index]).fetchone():
            return "elsewhere", None
        outcome, number = "failed", None
        if attempt.signature is not None:
            number = atlas.look_up(attempt.signature)
            outcome = "new" if number is None else "duplicate"
            if number is None:
                if attempt.orbit is None:
                    return "uncertain", None
                number = atlas.insert(attempt.orbit, attempt.signature)
        execute(
            "INSERT INTO starts VALUES (?, ?, ?, ?, ?, ?, ?)",
            [search, attempt.index, attempt.strategy, outcome, attempt.reason, number, attempt.seconds],
        )
        return outcome, number
