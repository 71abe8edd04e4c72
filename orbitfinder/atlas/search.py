"""`search(...)`: from a model, energies and a range of periods to orbits in an atlas.

Starts are handed out in order, their results judged and written in order, by this process alone. The order makes
the result independent of the number of workers and of when they answer, and makes the recorded starts a prefix of
all starts, from which a search that was killed goes on.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.cluster import listening
from orbitfinder._runtime.notebook import brief
from orbitfinder.atlas.attempt import CONTINUATION, Attempt, Job
from orbitfinder.atlas.controlled import statement
from orbitfinder.atlas.report import Summary, summarise
from orbitfinder.atlas.shard import WHOLE, Shard, shard_from
from orbitfinder.atlas.starts import CYCLES, METHOD, Context, Target, context_of, strategy_of
from orbitfinder.atlas.store import Atlas, as_words, check_range
from orbitfinder.atlas.tables import explained, transaction
from orbitfinder.atlas.workers import Cluster, Inline, LocalWorkers, Pool, Request, Workers
from orbitfinder.errors import InputError, closest
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model

TOGETHER, FIRST, TURN = 512, 16, 8.0
"""Starts that are made side by side at most, and before it is known how long they take; seconds of processor time that
those should take at most, and never more than are left, so that a search ends when it is asked to."""
AHEAD = TOGETHER
"""Starts for each place among the workers that may be under way or unjudged: bounds the memory, and with fewer than are
made side by side others would wait for who has these."""
MOST_SOURCES = 80
"""Known orbits that a search at another energy continues from."""
DEFAULT_BUDGET = 60.0
"""Seconds of a search that is given no limit."""


@dataclass(frozen=True)
class Limits:
    """When a search ends: at this many starts in all, after this many seconds of now, or at either.

    Of the starts, `shard` are those that are made here.
    """

    starts: int | None = None
    budget: float | None = None
    shard: Shard | None = None


@dataclass
class SearchStatistics:
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
    before: int = 0
    """how many starts were in the atlas before it"""
    ended: float | None = None
    limits: Limits = Limits()
    parameters: Mapping[str, float] = field(default_factory=dict)
    """those of the grid at which it searched"""

    @property
    def made(self) -> int:
        """Starts that are in the atlas by now."""
        return self.before + self.done

    @property
    def elapsed(self) -> float:
        """Seconds since it began, or that it took."""
        return (time.monotonic() if self.ended is None else self.ended) - self.began

    @property
    def left(self) -> float | None:
        """Seconds that are left, as far as one can tell."""
        limits = self.limits
        seconds = [] if limits.budget is None else [max(0.0, limits.budget - self.elapsed)]
        if limits.starts is not None and self.done:
            seconds.append(max(0, (limits.shard or WHOLE).count(limits.starts) - self.made) * self.elapsed / self.done)
        return min(seconds) if seconds else None


def register(
    atlas: Atlas, request: Request, context: Context, alone: bool = False, parameters: Mapping[str, float] | None = None
) -> int:
    """The id of this search in its atlas.

    A search is its energy, range of periods, seed, method and `parameters`; whoever asks for the same goes on with it.
    One that is `alone` continues from no orbits of other energies: what other shards know of those is unknown here.
    """
    how = {"method": METHOD, "strategies": context.strategies}
    if context.section is not None:
        target = request.target
        how |= {"cycle": context.model.cycle, "cycles": target.cycles, "section": dict(target.section)}
    how |= {"control": dict(request.target.problem)} if request.target.problem else {}
    how |= {"parameters": dict(parameters)} if parameters else {}
    method = json.dumps(how, sort_keys=True)
    key = [request.target.energy, *request.target.periods, request.seed, method]
    with explained(atlas.path), transaction(atlas.connection):
        atlas.connection.execute(
            "INSERT OR IGNORE INTO searches (energy, shortest, longest, seed, method, sources) "
            "SELECT ?, ?, ?, ?, ?, coalesce(max(id), 0) * ? FROM orbits",
            [*key, 0 if alone else 1],
        )
        row = atlas.connection.execute(
            "SELECT id FROM searches WHERE energy = ? AND shortest = ? AND longest = ? AND seed = ? AND method = ?", key
        )
        return int(row.fetchone()[0])


def unmade(atlas: Atlas, search: int, shard: Shard) -> Iterator[int]:
    """The numbers of a shard's starts that are not in the atlas yet, without end; merged shards may leave gaps."""
    mine = "FROM starts WHERE search = ? AND number % ? = ?"
    values = [search, shard.parts, shard.first]
    ((made, last),) = atlas.select([int, int], f"SELECT count(*), coalesce(max(number), -1) {mine}", values)
    gaps = range(shard.first, last, shard.parts)
    if made > len(gaps):
        gaps = range(0)
    known = {number for (number,) in atlas.select([int], f"SELECT number {mine}", values)} if gaps else set()
    ahead = shard.first if last < 0 else last + shard.parts
    return itertools.chain((number for number in gaps if number not in known), itertools.count(ahead, shard.parts))


def sources(atlas: Atlas, search: int, parameters: str = "") -> list[int]:
    """Orbits of other energies that the atlas held when the search was first asked for, nearest energy first."""
    rows = atlas.select(
        [int],
        "SELECT orbits.id FROM orbits, searches WHERE searches.id = ? AND orbits.id <= searches.sources "
        "AND orbits.parameters = ? "
        "AND abs(orbits.energy - searches.energy) > 1e-6 * max(abs(searches.energy), abs(action) / orbits.period) "
        "ORDER BY abs(orbits.energy - searches.energy), orbits.id LIMIT ?",
        [search, parameters, MOST_SOURCES],
    )
    return [number for (number,) in rows]


class Search:
    """One run of a search; `run` is all that one calls."""

    def __init__(
        self, atlas: Atlas, request: Request, context: Context, limits: Limits,
        progress: Callable[[SearchStatistics], None] | None = None, parameters: Mapping[str, float] | None = None,
    ) -> None:  # fmt: skip
        self._atlas, self._context, self._limits, self._progress = atlas, context, limits, progress
        self._parameters = as_words(parameters or {})
        self.id = register(atlas, request, context, limits.shard is not None, parameters)
        self._sources = sources(atlas, self.id, self._parameters)
        self._numbers = unmade(atlas, self.id, limits.shard or WHOLE)
        self._next = next(self._numbers)
        self._unjudged: deque[int] = deque()
        self._under_way, self._latest = 0, deque[float](maxlen=64)
        self._answers: dict[int, Attempt] = {}
        made = atlas.select([int], "SELECT count(*) FROM starts WHERE search = ?", [self.id])[0][0]
        self.statistics = SearchStatistics(
            orbits=len(atlas), begun_at=self._next, before=made, limits=limits, parameters=parameters or {}
        )

    def run(self, workers: Workers) -> SearchStatistics:
        """Hand out, judge and write until a limit is reached; starts under way are waited for."""
        for row in self._atlas.rows():
            if row.parameters == self._parameters:
                workers.learn((row.energy, row.period, abs(row.action)))
        while self._hand_out(workers) or self._under_way:
            limit.check()
            for job, attempt in workers.results(0.2):  # s between two looks at the clock
                self._under_way -= 1
                self._answers[job.number] = attempt
            while self._unjudged and self._unjudged[0] in self._answers:
                if not self._judged(workers, self._answers.pop(self._unjudged[0])):
                    break
                self._unjudged.popleft()
        self.statistics.ended = time.monotonic()
        return self.statistics

    def _wanted(self) -> bool:
        """True while more starts are to be handed out."""
        late = self._limits.budget is not None and self.statistics.elapsed >= self._limits.budget
        return not late and (self._limits.starts is None or self._next < self._limits.starts)

    def _hand_out(self, workers: Workers) -> bool:
        """Give starts to idle workers; True while more are wanted."""
        while self._wanted():
            room, size = workers.room, self._size
            if not (room > 0 and len(self._unjudged) < AHEAD * (self._under_way // size + room)):
                return True
            left = size if self._limits.starts is None else -(-(self._limits.starts - self._next) // room)
            jobs = list[Job]()
            while len(jobs) < min(size, left) and self._wanted():
                jobs.append(self._job(self._next))
                self._unjudged.append(self._next)
                self._next = next(self._numbers)
            self._submit(workers, jobs)
        return False

    @property
    def _size(self) -> int:
        """How many starts are made side by side, by the time that the latest have taken."""
        latest, budget = self._latest, self._limits.budget
        turn = TURN if budget is None else min(TURN, budget - self.statistics.elapsed)
        first = FIRST if self._context.controlled is None else 1
        return int(np.clip(turn * len(latest) / (sum(latest) + 1e-3), 1, TOGETHER)) if latest else first

    def _submit(self, workers: Workers, jobs: Sequence[Job]) -> None:
        workers.submit(jobs)
        self._under_way += len(jobs)

    def _job(self, number: int, certain: bool = False) -> Job:
        """Numbers below the count of sources continue from them; the others follow their strategy."""
        source = self._atlas.document(self._sources[number]) if number < len(self._sources) else None
        return Job(number, certain, source)

    def _judged(self, workers: Workers, attempt: Attempt) -> bool:
        """Write what became of a start; False when it must be done again, all the way to its certificate."""
        if not attempt.strategy:  # its worker died
            name = CONTINUATION if attempt.index < len(self._sources) else strategy_of(self._context, attempt.index)
            attempt = replace(attempt, strategy=name)
        if attempt.signature is not None:
            attempt = replace(attempt, signature=replace(attempt.signature, parameters=self._parameters))
        if attempt.orbit is not None:  # whose name is good for a folder
            given = (f"-{name}{value:.9g}" for name, value in self.statistics.parameters.items())
            attempt = replace(attempt, orbit=replace(attempt.orbit, name="".join([attempt.orbit.name, *given])))
        outcome, number = record(self._atlas, self.id, attempt)
        if outcome == "uncertain":
            self._submit(workers, [self._job(attempt.index, certain=True)])
            return False
        if outcome == "new":
            assert attempt.signature is not None and number is not None
            self._atlas.remember(number, attempt.signature)
            workers.learn(attempt.signature.numbers)
        statistics = self.statistics
        statistics.done += 1
        self._latest.append(attempt.seconds)
        statistics.hits += outcome in ("new", "duplicate")
        statistics.new += outcome == "new"
        statistics.duplicates += outcome == "duplicate"
        statistics.orbits += outcome == "new"
        if outcome == "failed":
            statistics.failures[attempt.reason] += 1
        limit.note(f"{statistics.done} starts of this run are in the atlas; the same search goes on from there")
        if self._progress:
            self._progress(statistics)
        return True


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
            outcome = "duplicate"
            if number is None and not attempt.reason:
                if attempt.orbit is None:
                    return "uncertain", None
                outcome, number = "new", atlas.insert(attempt.orbit, attempt.signature)
            elif number is None:
                outcome = "failed"
        execute(
            "INSERT INTO starts VALUES (?, ?, ?, ?, ?, ?, ?)",
            [search, attempt.index, attempt.strategy, outcome, attempt.reason, number, attempt.seconds],
        )
        return outcome, number


@dataclass(frozen=True)
class Found:
    """What one run of a search did: its statistics by energy (J), at each set of parameters, and the summary of these
    searches from the atlas; `refused` are energies with parameters where nothing can be searched, and why."""

    __repr__ = brief("atlas", "summary")

    atlas: Path
    tallies: tuple[tuple[float, SearchStatistics], ...]
    summary: Summary
    refused: tuple[tuple[float, Mapping[str, float], str], ...] = ()


def search(
    model: Model | Problem,
    energies: float | Sequence[float] | None,
    periods: tuple[float, float],
    atlas: str | Path,
    *,
    starts: int | None = None,
    budget: float | None = None,
    seed: int = 0,
    workers: int = 2,
    scheduler: str | None = None,
    executor: Executor | None = None,
    shard: str | tuple[int, int] | None = None,
    folder: str | Path | None = None,
    progress: Callable[[float, SearchStatistics], None] | None = None,
    section: Mapping[str, Sequence[float]] | None = None,
    cycles: int = CYCLES,
    parameters: Mapping[str, float | Sequence[float]] | None = None,
) -> Found:
    """Search for periodic orbits of a Model and keep the distinct certified ones in an atlas file.

    Ends at `starts` starts for each energy or after `budget` seconds (60 when neither is given), shared among the
    energies, and among all sets of `parameters`. The result depends on the seed, not on the workers. A search that was
    stopped, however, goes on when the same is asked again.

    Args:
        model: the system; of controlled motions a Problem with a control, whose optima are looked for.
        energies: J; None of a system that conserves nothing.
        periods: range of minimal periods, s.
        atlas: the SQLite file.
        starts: for each energy.
        budget: s.
        seed: of the starts.
        workers: 0 is this process, n are n spawned ones.
        scheduler: address of a Dask cluster.
        executor: any executor of concurrent.futures.
        shard: (k, n), or "k/n", makes every n-th start only, from the k-th, each shard in an atlas of its own for
            `of.merge_atlases`; "auto" takes k and n from the Slurm array that runs it.
        folder: of a trusted module that makes the system.
        progress: called with each energy and what was done at it.
        section: of a hybrid system, ranges of components right after the event that ends its cycle, by name: where
            starts begin.
        cycles: of a hybrid system, orbits of at most so many cycles are looked for.
        parameters: values of physical parameters by name; every combination is searched, at every energy.

    Returns:
        `summary` of these searches, `tallies` by energy and parameters, `atlas`; `refused` where others were searched.

    Raises:
        InputError: for energies none of which can be reached and settings that contradict each other.

    Examples:
        >>> found = of.search(pendulum, -18.0, (0.9, 2.5), "double.sqlite", starts=6, workers=0)
        >>> with of.Atlas("double.sqlite") as atlas:
        ...     [round(row.period, 6) for row in atlas.rows()]
        [1.119341, 2.368714]

    See Also:
        `of.Atlas` to look into the file; `of.least_unstable` for one orbit only.
    """
    part, asked = shard_from(shard), statement(model) if isinstance(model, Problem) else {}
    model = model.model if isinstance(model, Problem) else model
    shells = levels(model, energies, bool(asked))
    if not shells:
        raise InputError("energy: missing; give at least one, in J")
    if starts is not None and starts < 0:
        raise InputError(f"starts: must not be negative, got {starts}; give a number of starts")
    if budget is not None and not 0 < budget < np.inf:
        raise InputError(f"budget: must be positive and finite, got {budget}; give it in s")
    if not 0 <= seed < 2**63:
        raise InputError(f"seed: must be between 0 and 2^63 - 1, got {seed}; give a whole number")
    if not 0 <= workers <= 256:
        raise InputError(f"workers: must be between 0 and 256, got {workers}; 0 searches in this process")
    budget = DEFAULT_BUDGET if starts is None and budget is None else budget
    points = list(itertools.product(shells, grid(model, parameters or {})))
    points = points if part is None else sorted(points, key=lambda point: (point[0], as_words(point[1])))
    limits = Limits(starts, None if budget is None else budget / len(points), part)
    for name, pair in (section or {}).items():
        check_range(f"search.section.{name}", pair)
    where = {name: (float(pair[0]), float(pair[1])) for name, pair in (section or {}).items()}
    tallies, ids, refused = [], [], list[tuple[float, Mapping[str, float], InputError]]()
    listening(scheduler if executor is None else None)  # before an atlas is made
    with Atlas(atlas, write=True, model=model) as book:
        for energy, values in points:
            target = Target(energy, (float(periods[0]), float(periods[1])), where, int(cycles), asked)
            try:
                there = with_parameters(model, values)
                context = context_of(there, target)
            except InputError as error:  # of this energy and these parameters; others may do
                refused.append((energy, values, error))
                if len(refused) == len(points):
                    raise refused[0][2] from None
                continue
            request = Request(dict(there.system), target, int(seed), None if folder is None else str(folder))
            told = None if progress is None else partial(progress, energy)
            run = Search(book, request, context, limits, told, values)
            with contextlib.closing(employed(context, request, workers, scheduler, executor)) as crew:
                tallies.append((energy, run.run(crew)))
            ids.append(run.id)
        why = tuple((energy, values, str(error)) for energy, values, error in refused)
        return Found(Path(atlas), tuple(tallies), summarise(book, ids), why)


def levels(model: Model, energies: float | Sequence[float] | None, controlled: bool = False) -> tuple[float, ...]:
    """The energies (J) to search at, 0 alone where none is conserved. Raises `InputError`."""
    if controlled and energies is not None:
        raise InputError("energy: controlled motions conserve none; leave it out, or pin it in the problem")
    if model.invariants or energies is not None:
        if not model.invariants and (model.rates is not None or model.forced or not model.smooth):
            raise InputError("energy: this system conserves none; leave it out")
        given = [] if energies is None else energies
        return tuple(float(level) for level in (given if isinstance(given, Sequence) else [given]))
    return (0.0,)


def grid(model: Model, parameters: Mapping[str, float | Sequence[float]]) -> list[dict[str, float]]:
    """Every combination of the values of physical parameters. Raises `InputError`."""
    each = {name: np.atleast_1d(np.asarray(values, float)) for name, values in parameters.items()}
    for name, values in each.items():
        if name not in model.parameter_names:
            meant = closest(name, model.parameter_names)
            known = ", ".join(model.parameter_names) or "none"
            raise InputError(f"parameters: unknown {name!r}{meant}; this system has {known}")
        if values.ndim != 1 or not values.size or len(set(values)) < values.size or not np.isfinite(values).all():
            raise InputError(f"parameters.{name}: must be different finite numbers, got {values.tolist()}; give a list")
    return [dict(zip(each, map(float, point), strict=True)) for point in itertools.product(*each.values())]


def employed(
    context: Context, request: Request, workers: int, scheduler: str | None, executor: Executor | None = None
) -> Workers:
    """Whoever is to do the starts."""
    if scheduler is not None and executor is not None:
        raise InputError("executor: goes without scheduler; give one of the two")
    if scheduler is None and executor is None and workers == 0:
        return Inline(context, request)
    model = context.model
    try:
        built = build_model(request.system, None if request.folder is None else Path(request.folder))
    except InputError as error:
        raise InputError(f"workers: other processes cannot rebuild this system ({error}); use workers=0") from error
    same = built.parameter_values.shape == model.parameter_values.shape and np.allclose(
        built.parameter_values, model.parameter_values, rtol=1e-15
    )
    if built.state_names != model.state_names or not same:
        raise InputError("workers: the description of this system makes another one elsewhere; use workers=0")
    if executor is not None:
        return Pool(request, executor, workers)
    return LocalWorkers(request, workers) if scheduler is None else Cluster(request, scheduler)
