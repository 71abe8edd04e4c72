"""`sweep(problem, k=values)`: an orbit for each value of a parameter, certified or with the reason why not.

The problem's own orbit is found once. From there the values are visited outwards, each from the orbit before it, moved
on along the line through the two last ones; where Newton's method does not converge, or leads elsewhere, the step is
halved. Nothing is found anew: what is not reached lies beyond a fold or where the orbit ends.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import limit as limited
from orbitfinder._runtime import processes, tasks
from orbitfinder._runtime.cluster import Scheduler, home, scheduler_at
from orbitfinder._runtime.keeping import finished
from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.follow import Known, reached
from orbitfinder.errors import (
    FAILURES,
    ConvergenceError,
    InputError,
    LimitError,
    OrbitfinderError,
    closest,
    shortened,
)
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.conditions import Pin, check_pin, is_parameter
from orbitfinder.loops.newton import Refined
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.hybrid import freed
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import alone, proportions
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.refine import Refiner
from orbitfinder.records.codec import Codec, plain
from orbitfinder.records.journal import Checkpoints, checkpoints, packed, unpacked
from orbitfinder.records.orbit import SHARE, Orbit, orbit_from_document, orbit_to_document
from orbitfinder.records.reading import Entries, Table, typed
from orbitfinder.records.table import Tabled, Tables

LIMIT, ELSEWHERE = 3600.0, 0.1
"""Seconds after which a sweep stops unless told otherwise; a period or state farther than this from what was expected,
relative to the motion, is another orbit's."""
NUMBERS = ("period", "energy", "action", "symmetry", "stability", "closure")
ASKED = ("guess", "pin", "symmetry", "winding", "segments", "tolerance", "free", "relative", "name", "title", "source")
"""Of a problem beside its system: what decides which orbits are found, and what they are called"""


@dataclass(frozen=True)
class Row(Shown):
    """One value of a sweep: the parameters, the orbit there where one was reached, and what is wrong with it."""

    __repr__ = brief("values", "certified", "reason")

    values: Mapping[str, float]
    orbit: Orbit | None = None
    reason: str = ""

    @property
    def certified(self) -> bool:
        """True for an orbit with its certificate."""
        return self.orbit is not None and not self.reason

    def record(self, names: Sequence[str]) -> Entries:
        """The row as plain values by name, None where there is no orbit; `names` are those of the state."""
        numbers = dict.fromkeys((*NUMBERS, "instability", *names))
        if self.orbit is not None:
            numbers = {name: getattr(self.orbit, name) for name in NUMBERS}
            numbers["instability"] = float(np.abs(self.orbit.floquet_multipliers).max(initial=1.0))
            numbers |= {name: float(x) for name, x in zip(names, self.orbit.state, strict=True)}
        return {**self.values, "certified": self.certified, "reason": self.reason, **numbers}


@dataclass(frozen=True)
class Sweep(Tabled):
    """The rows of a sweep in the order of their values, and as a `table()`."""

    __repr__ = brief("parameters", "certified", "seconds")

    parameters: tuple[str, ...]
    rows: tuple[Row, ...]
    state_names: tuple[str, ...]
    seconds: float

    @property
    def records(self) -> list[dict[str, Any]]:
        """A dict a row: parameters, whether certified, the reason why not, numbers, instability, the state."""
        return [row.record(self.state_names) for row in self.rows]

    def own_tables(self) -> Tables:
        """Its table, with nothing where there is no orbit."""
        return _tables(self.records)

    @property
    def certified(self) -> int:
        """How many rows have a certified orbit."""
        return sum(row.certified for row in self.rows)

    @property
    def orbits(self) -> tuple[Orbit, ...]:
        """The certified orbits."""
        return tuple(row.orbit for row in self.rows if row.orbit is not None and not row.reason)


@dataclass(frozen=True)
class SweepRecord(Tabled):
    """What the file of a sweep holds: `records`, a row a value, null where there is no orbit."""

    __repr__ = brief("name", "parameters", "counts")

    name: str
    system: Table
    parameters: tuple[str, ...]
    rows: tuple[Entries, ...]

    @property
    def counts(self) -> str:
        """How many values have a certified orbit."""
        return f"{sum(row['certified'] for row in self.rows)} of {len(self.rows)} certified"

    def own_tables(self) -> Tables:
        """As those of a `Sweep`."""
        return _tables(self.rows)

    def _check(self) -> None:
        wanted = {*self.parameters, "certified", "reason", *NUMBERS}
        for k, row in enumerate(self.rows):
            if rows := [name for name, value in row.items() if isinstance(value, (list, dict))]:
                raise ValueError(f"rows[{k}].{rows[0]}: expected a number, a word or null, got a list or table")
            if row.keys() != self.rows[0].keys() or not row.keys() >= wanted or not isinstance(row["certified"], bool):
                raise ValueError(f"rows[{k}]: not the columns of a sweep")
        if not self.rows:
            raise ValueError("rows: there are none")


CODEC = Codec(SweepRecord, "sweep", "`orbitfinder sweep`", "sweep again")
load_sweep = CODEC.load


def _tables(rows: Sequence[Table]) -> Tables:
    told = [{name: missing(name) if value is None else value for name, value in row.items()} for row in rows]
    return {"points": {name: [row[name] for row in told] for name in told[0]}}


def missing(name: str) -> Any:
    """What stands in a table where there is no orbit."""
    return "" if name in ("symmetry", "stability") else np.nan


Progress = Callable[[Row, int, int], None]
"""Told of each row, how many there are by now and how many there will be."""


def sweep(
    problem: Problem, values: Mapping[str, Sequence[float]] | None = None, *, workers: int = 1,
    scheduler: str | None = None, limit: float | None = LIMIT, folder: str | Path | None = None,
    progress: Progress | None = None, out: str | Path | None = None, **named: Sequence[float],
) -> Sweep:  # fmt: skip
    """The orbits of a Problem at other values of its parameters, each certified or with its reason.

    The problem's pins must leave nothing to choose.

    Args:
        problem: solved first at its own values.
        values: as the keywords, as a mapping.
        workers: processes that share the values.
        scheduler: address of a Dask cluster that shares them instead.
        limit: s after which what is missing is left out with that reason.
        folder: of a trusted module that makes the system.
        progress: called with what is being done.
        out: a folder: OUT/<name>/sweep.jsonl keeps every row as it comes, and what was asked before goes on from
            there, also with more values.
        **named: values of a physical parameter (`stiffness=numpy.linspace(20, 40, 100)`), or of `energy` or `period`
            where the problem pins it; several of equal lengths change together.

    Returns:
        A Sweep: `rows` with the Orbit or the reason of each value, `orbits`, tables.

    Raises:
        InputError: for unknown names and unequal lengths.
        CountError: where the pins leave something to choose.
        ConvergenceError: when there is no orbit at the problem's own values.

    Examples:
        >>> swept = of.sweep(problem, gravity=[9.8, 9.9, 10.0])
        >>> [round(row.orbit.period, 6) for row in swept.rows]
        [1.119341, 1.137461, 1.154433]

    See Also:
        `of.follow_family` goes round folds, which a sweep does not.
    """
    began, table = time.monotonic(), _table(problem, {**(values or {}), **named})
    if not 1 <= workers <= 256:
        raise InputError(f"workers: must be between 1 and 256, got {workers}")
    visited = {}
    path = None if out is None else Path(out) / problem.name / "sweep.jsonl"
    asked = {"system": dict(problem.model.system), **{name: getattr(problem, name) for name in ASKED}}
    free = freed(
        problem.model, tuple({*problem.free, *table} & {*problem.model.parameter_names}), problem.boundary.parts
    )
    sizes = (len(table),), (len(problem.model.state_names),), (len(free),)
    with (
        checkpoints(path, plain({"values": list(table), "problem": asked}), partial(_read, sizes=sizes)) as journal,
        scheduler_at(scheduler, "sweep", folder) as far,
    ):
        study = _Study(problem, tuple(table), np.array(list(table.values())).T, journal)
        try:
            with limited.limited(limit):
                alone = workers == 1 and far is None
                rows = study.rows() if alone else _shared(study, min(workers, len(study.values)), folder, far)
                for k, visit, fresh in rows:
                    visited[k] = visit.row
                    if fresh and path is not None:
                        journal.add(visit.entry())
                    finished(lambda: study.swept(visited, time.monotonic() - began))
                    limited.note(f"{len(visited)} of {len(study.values)} values are done")
                    if progress:
                        progress(visit.row, len(visited), len(study.values))
        except LimitError as error:
            visited |= {k: Row(study.named(k), None, str(error)) for k in range(len(study.values)) if k not in visited}
    return study.swept(visited, time.monotonic() - began)


def _table(problem: Problem, given: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """The values of each parameter, of equal lengths. Raises `InputError`."""
    if not given:
        raise InputError("values: missing; name a parameter and its values, such as sweep(problem, stiffness=[20, 30])")
    table = {}
    pinned = [pin.name for pin in problem.pin]
    physical = [name for name in problem.model.parameter_names if not name.startswith(SHARE)]
    for name, numbers in given.items():
        known = [*pinned, *physical]
        if name not in pinned and (name not in physical or not is_parameter(problem.model, name)):
            raise InputError(
                f"{name}: neither a physical parameter of this system nor pinned by the problem"
                f"{closest(name, known)}; use one of {', '.join(known)}"
            )
        if name in problem.free and name not in pinned:
            raise InputError(f"{name}: free, so that the solver chooses it; leave it out of free to give its values")
        try:
            table[name] = [float(number) for number in numbers]
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: must be a list of numbers, got {shortened(numbers)}") from error
        if not table[name] or not np.all(np.isfinite(table[name])):
            raise InputError(f"{name}: must be finite numbers, at least one, got {shortened(numbers)}")
        problem.model.check_clock(name, table[name])
    if len({len(numbers) for numbers in table.values()}) > 1:
        sizes = ", ".join(f"{len(numbers)} of {name}" for name, numbers in table.items())
        raise InputError(f"values: {sizes}; parameters that change together need equally many")
    return table


Origin = tuple[np.ndarray, float, Mapping[str, float], tuple[int, ...]]
"""A problem's own orbit: state, period, what is free, winding"""
Reached = tuple[np.ndarray, Refined]
"""Values (p), and the orbit there"""


@dataclass(frozen=True)
class _Visit:
    """A row, the values of the row before it, and the last orbits of the way when it was left."""

    row: Row
    after: tuple[float, ...] | None
    way: tuple[Reached, ...]

    def entry(self) -> Entries:
        """The line of the journal."""
        line, orbit = {entry.name: getattr(self, entry.name) for entry in fields(self)}, self.row.orbit
        line["row"] = {"values": self.row.values, "reason": self.row.reason}
        if orbit is not None:
            line["orbit"] = orbit_to_document(orbit)
            line["samples"] = packed(np.column_stack([orbit.times, orbit.samples]))
        return dict(plain(line))


def _read(entry: Table, sizes: tuple[tuple[int], ...]) -> Origin | _Visit:
    """What a line of the journal stands for, `sizes` of the values, a state and what is free. Raises `ValueError`."""
    kind: Any = Origin if "origin" in entry else _Visit
    line: Origin | _Visit = typed(kind, entry.get("origin", entry), "")
    if isinstance(line, tuple):
        return line
    for values, place in line.way:
        if (values.shape, place.nodes.shape[1:], place.free.shape) != sizes or not place.period > 0:
            raise ValueError("way: no orbits of this problem")
    if "orbit" not in entry:
        return line
    orbit = orbit_from_document(entry["orbit"], "orbit")
    samples = unpacked(entry["samples"], 1 + orbit.state.size)
    orbit = replace(orbit, times=samples[:, 0], samples=samples[:, 1:], record=None)
    return replace(line, row=replace(line.row, orbit=orbit))


class _Study:
    """A problem whose parameters `names` go through `values` (k x p), walked outwards from its own orbit.

    `numbers` (k) are those of the values in the whole sweep, by which rows and orbits go. What the journal knows is not
    solved again; where nothing was reached it is tried again from another value than before.
    """

    def __init__(
        self, problem: Problem, names: tuple[str, ...], values: np.ndarray, journal: Checkpoints[Origin | _Visit],
        numbers: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        self.problem, self.names, self.values, self.journal = problem, names, values, journal
        self.numbers = np.arange(len(values)) if numbers is None else numbers
        self.origin = next((line for line in journal.known if isinstance(line, tuple)), None)
        visits = [line for line in journal.known if isinstance(line, _Visit)]
        self.known = {tuple(line.row.values.get(name) for name in names): line for line in visits}
        model, pinned = problem.model, {pin.name: pin.value for pin in problem.pin}
        own = {name: model.value(name) for name in names if name not in pinned}
        self.own = np.array([pinned.get(name, own.get(name)) for name in names], float)
        self._free = (*problem.free, *(name for name in own if name not in problem.free))
        self._pin = (*problem.pin, *(Pin(name, value) for name, value in own.items()))
        self._way: Known[Refined] = []

    def swept(self, visited: Mapping[int, Row], seconds: float) -> Sweep:
        """Rows by number as a Sweep."""
        rows = tuple(visited[k] for k in sorted(visited))
        return Sweep(self.names, rows, self.problem.model.state_names, seconds)

    def named(self, k: int) -> dict[str, float]:
        """The k-th values by name."""
        return dict(zip(self.names, map(float, self.values[k]), strict=True))

    @cached_property
    def base(self) -> Problem:
        """The problem at its own orbit, everything that is swept freed and pinned."""
        wanted = replace(self.problem, free=self._free, pin=self._pin, expected={})  # those are of its own values
        wanted.check_count()
        if wanted.count().freedom:
            raise InputError("pin: missing; a sweep needs to know what is held, pin the energy, the period or a state")
        if self.origin is None:
            orbit = find_orbit(replace(self.problem, expected={}))
            self.origin = orbit.state, orbit.period, orbit.provenance.get("free", {}), orbit.winding
            self.journal.add(plain({"origin": self.origin}))
        state, period, free, winding = self.origin
        return replace(wanted, guess=Guess(state, period, free=free), winding=winding)

    @cached_property
    def refiner(self) -> Refiner:
        """Everything that is built once."""
        return Refiner(self.base)

    def rows(self) -> Iterator[tuple[int, _Visit, bool]]:
        """Visits by number and whether each is new, those of values below the problem's own after those above."""
        scale = np.abs(self.values - self.own).max(axis=0)
        along = ((self.values - self.own) / nonzero(scale)).sum(axis=1)
        order = np.argsort(along, kind="stable")
        for side in (order[along[order] >= 0], order[along[order] < 0][::-1]):
            self._way, after = [], None
            for k in side:
                values = tuple(map(float, self.values[k]))
                visit = self.known.get(values)
                fresh = visit is None or not (visit.row.certified or visit.after == after)
                if visit is None or fresh:
                    assert self.refiner  # whatever is wrong with the problem is no value's fault
                    visit = _Visit(self._row(int(k)), after, tuple(self._way))
                self._way, after = list(visit.way), values
                number, row = int(self.numbers[k]), visit.row
                if row.orbit is not None:  # of another sweep it may have another name
                    row = replace(row, orbit=replace(row.orbit, name=f"{self.problem.name}-{number + 1:04d}"))
                yield number, replace(visit, row=row), fresh

    def _row(self, k: int) -> Row:
        limited.check()
        try:
            orbit = self.refiner.orbit(self._reached(self.values[k]))
        except FAILURES as error:
            return Row(self.named(k), None, str(error))
        failed = ", ".join(orbit.certificate.failures) if orbit.certificate else "no certificate"
        return Row(self.named(k), orbit, failed and f"not certified: {failed}")

    def _reached(self, target: np.ndarray) -> Refined:
        """The orbit at a value, by steps from the one before it."""
        way = self._way
        if not way:
            way.append((self.own, self._at(self.own, None)))
        try:
            here, last = way[-1]
            return (
                last
                if np.array_equal(here, target)
                else reached(way, target, lambda values: (self._at(values, self._predicted(values)), 0))
            )
        except ConvergenceError as error:
            place = ", ".join(f"{name} = {x:.6g}" for name, x in zip(self.names, way[-1][0], strict=True))
            raise ConvergenceError(
                f"not reached: from {place} on, {error}; a fold or the end of the orbit lies between, which continue "
                "shows"
            ) from error

    def _predicted(self, goal: np.ndarray) -> Guess:
        """The nodes and the period on the line through the two last orbits."""
        (past, before), (place, here) = self._way[0], self._way[-1]
        nodes, period, free = here.nodes, here.period, here.free
        if len(self._way) > 1 and before.nodes.shape == nodes.shape:
            share = float(np.linalg.norm(goal - place) / nonzero(float(np.linalg.norm(place - past))))
            share *= 1.0 if (goal - place) @ (place - past) > 0 else -1.0
            if abs(share) <= 2.0:
                nodes = nodes + share * (nodes - before.nodes)
                period, free = period + share * (period - before.period), free + share * (free - before.free)
        lasts = period * self.base.boundary.fraction / len(nodes)  # of arcs that is not known, their nodes are all
        times = None if self.refiner.equations.links else np.arange(len(nodes)) * lasts
        return Guess(nodes[0], period, times, nodes, dict(zip(self.refiner.equations.free, free, strict=True)))

    def _at(self, values: np.ndarray, guess: Guess | None) -> Refined:
        """The orbit at values near a guess; `ConvergenceError` for another one."""
        pins = {pin.name: pin.value for pin in self._pin} | dict(zip(self.names, map(float, values), strict=True))
        asked = [Pin(name, value) for name, value in pins.items()]
        for pin in asked:
            check_pin(self.base, pin)
        refined = self.refiner.refine(guess, asked)
        if guess is None or guess.states is None:
            return refined
        away = _away(self.base.model, guess.states, refined.nodes, guess.period)
        if max(away, abs(refined.period / guess.period - 1)) > ELSEWHERE:
            raise ConvergenceError("Newton's method leads to another orbit")
        return refined


def _away(model: Model, expected: np.ndarray, nodes: np.ndarray, period: float) -> float:
    """How far nodes (N x d) are from those expected, coordinates by their size, rates by that of either in a period."""
    moved, size = np.abs(nodes - expected).max(axis=0), np.abs(expected).max(axis=0)
    if model.rates is not None:
        return float((moved / alone(size, model.angular)).max())
    units = np.tile(proportions(model, expected[0]), 2)
    (moved, rushed), (places, rates) = np.split(moved / units, 2), np.split(size / units, 2)
    speed = nonzero(max(rates.max(), places.max() * 2 * np.pi / period))
    return float(max(moved.max() / nonzero(places.max()), rushed.max() / speed))


def _shared(
    study: _Study, workers: int, folder: str | Path | None, far: Scheduler | None
) -> Iterator[tuple[int, _Visit, bool]]:
    """The rows by spawned processes, each with a run of neighbouring values, or by a cluster in runs of a few; nothing
    for a run that is known."""
    order, hands, left = np.argsort(study.values[:, 0], kind="stable"), [], []
    for part in np.array_split(order, -(-len(order) // RUN) if far else workers):
        values = study.values[part]
        known = [study.known[key] for key in map(tuple, values.tolist()) if key in study.known]
        if len(known) < len(part):
            left.append((values, known, part))
        else:
            yield from _Study(study.problem, study.names, values, study.journal, part).rows()
    if left:
        system = dict(study.base.model.system), None if folder is None else str(folder)
        build_model(system[0], home(system[1]))  # or nobody else can
        if far is not None:
            there, told = (system[0], far.luggage.folder), _described(study)
            each = [((there, told, study.names, values, [study.origin, *known], part, limited.left()),)
                    for values, known, part in left]  # fmt: skip
            with tasks.crew(_ran, what="sweep", scheduler=far) as answers:
                for _, visits in answers(each):
                    yield from visits
            return
    try:
        for values, known, part in left:
            wanted = (system, _described(study), study.names, values, [study.origin, *known], part, limited.left())
            hands.append(processes.hired(_serve, wanted))
        while hands:
            for hand in processes.ready(hands):
                answer = hand.answer()
                if isinstance(answer, tuple):
                    yield answer
                    continue
                hands.remove(hand)
                processes.dismissed([hand])
                if isinstance(answer, BaseException):
                    raise answer
                if answer != DONE:
                    raise OrbitfinderError("sweep: a process died; run it again with workers=1 to see where")
    finally:
        processes.dismissed(hands)


DONE, RUN = "done", 8
"""What a process says last; values that are a task of a cluster"""


def _described(study: _Study) -> Entries:
    """What a process needs besides the system: the problem at its own orbit, as plain values."""
    base, problem = study.base, study.problem
    asked = {name: getattr(problem, name) for name in ASKED}
    return {**asked, "guess": Guess(base.guess.state, base.guess.period), "winding": base.winding}


def _ran(wanted: tuple[Any, ...]) -> list[tuple[int, _Visit, bool]]:
    """A run of values by a cluster's worker."""
    return [*_running(wanted)]


def _running(wanted: tuple[Any, ...]) -> Iterator[tuple[int, _Visit, bool]]:
    system, described, names, values, known, part, left = wanted
    with one_thread(), limited.limited(left if np.isfinite(left) else None):
        problem = Problem(build_model(system[0], home(system[1])), **described)
        yield from _Study(problem, names, values, Checkpoints(None, known), part).rows()


def _serve(pipe: Connection, wanted: tuple[Any, ...]) -> None:
    """The life of a worker: its rows, a message each, then `DONE` or what went wrong."""
    try:
        for answer in _running(wanted):
            pipe.send(answer)
        pipe.send(DONE)
    except OrbitfinderError as error:
        pipe.send(error)
