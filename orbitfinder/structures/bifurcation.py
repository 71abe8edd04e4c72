"""Brute-force bifurcation diagrams: what motions settle to at many values of a parameter, as Poincare samples.

At each value motions are integrated, what they do at first is dropped, and their next returns are kept: of a forced
system its states once a period of the forcing, of a hybrid system those after the event that ends its cycle, of any
other the maxima of a coordinate or the crossings of a plane. Values lie beside each other in one run, as the
parameter is a component of the state that rests; with `sweep` each begins where the one before it has ended, so that
what is bistable shows both.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import tasks
from orbitfinder._runtime.cluster import home, scheduler_at
from orbitfinder._runtime.keeping import finished
from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import FAILURES, ConvergenceError, InputError, closest, plural, shortened
from orbitfinder.integrate.dop853 import SECOND, integrate_in
from orbitfinder.integrate.equations import accelerations
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.integrate.field import vector_field
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.controls import check_constant
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model, wrapped
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.simulate import checked_state, simulate
from orbitfinder.records.certificate import Certificate, at_most, equal
from orbitfinder.records.codec import Codec, Dense, check_shapes, plain
from orbitfinder.records.family import Family
from orbitfinder.records.journal import Checkpoints, checkpoints, header_of, packed, read_lines, unpacked
from orbitfinder.records.orbit import system_at
from orbitfinder.records.table import Tabled, Tables
from orbitfinder.structures.crossings import SEEN, Crossings, Passing, Plane, along_parameter
from orbitfinder.structures.sections import Surface, after_events, named_surface, surface

SWEEPS, MAXIMA, STROBE = ("none", "up", "down", "both"), "maxima of ", "once a period of the forcing"
SETTLED, APART, RETURNED, CHECKED, BETWEEN = 1e-6, 1e-3, 1e-7, 8, 65
"""Returns that agree to this, in extents of all samples, repeat; parts of what repeats are farther apart than this, or
a slow approach would be a doubling, and components are taken to move by at least this share of their size; how far the
next return may be by another integrator; motions that are verified; moments of a return that are looked at"""
FEWEST, MOST, LOST = 32, 256, 300.0
"""Motions that are a task, at least and at most; one that does not return in so much of the system's time is lost"""
Progress = Callable[[int, int], None]
"""Told how many motions are done by now, and how many there are"""


@dataclass(frozen=True)
class Bifurcation(Tabled):
    """What motions settle to at k values of a parameter: n samples in all.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        parameter: which.
        coordinate: what is drawn.
        plane: when samples are taken, in words.
        state_names: the d components.
        sweep: whether values go on from each other: none, up, down, both.
        transient: returns dropped at each value.
        count: returns kept, at most, of each motion.
        values: of the parameter (k, increasing).
        starts: where motions begin (r x d).
        states: the samples (n x d), motion by motion in the order of time.
        times: since the start of their motion (n, s).
        owners: n x 2, the number of the value and of the motion there: of r, or of 2 r, the first r upwards.
        repeats: k x r (or 2 r), after how many returns a motion repeats; 0 where it does not: chaos, or not settled.
        title: what pictures are headed with; the name where it is empty.

    Examples:
        >>> made.counts
        '3 values, 3 motions: 3 repeat after 1 return'
        >>> made.samples(0).shape
        (20,)
    """

    __repr__ = brief("name", "parameter", "plane", "counts")
    _entries = ("name", "counts", ...)
    _sparse = ("title",)

    name: str
    system: Mapping[str, Any]
    parameter: str
    coordinate: str
    plane: str
    state_names: tuple[str, ...]
    sweep: str
    transient: int
    count: int
    values: Dense
    starts: Dense
    states: Dense
    times: Dense
    owners: Dense
    repeats: Dense
    title: str = ""

    @property
    def counts(self) -> str:
        """How many motions repeat after how many returns, and how many do not."""
        kinds, numbers = np.unique(self.repeats[self.full], return_counts=True)
        told = [f"{m} repeat after {plural(int(n), 'return')}" for n, m in zip(kinds, numbers, strict=True) if n]
        told += [f"{m} do not repeat" for n, m in zip(kinds, numbers, strict=True) if not n]
        if left := int((~self.full).sum()):
            told.append(f"{left} left or were not tried")
        return f"{self.values.size} values, {plural(self.repeats.size, 'motion')}: {', '.join(told)}"

    @property
    def full(self) -> np.ndarray:
        """Which motions (k x r) have all their returns."""
        taken = np.zeros(self.repeats.shape, int)
        np.add.at(taken, tuple(self.owners.T), 1)
        return np.asarray(taken == self.count)

    @property
    def heights(self) -> np.ndarray:
        """The coordinate that is drawn at every sample (n)."""
        return self.states[:, self.state_names.index(self.coordinate)]

    def own_tables(self) -> Tables:
        """A row a sample: the parameter, the motion's number there, time, state, after how many returns it repeats."""
        value, motion = self.owners.T
        states = dict(zip(self.state_names, self.states.T, strict=True))
        return {"points": {self.parameter: self.values[value], "motion": motion, "time": self.times, **states,
                           "repeats": self.repeats[value, motion]}}  # fmt: skip

    def samples(self, value: int, motion: int = 0) -> np.ndarray:
        """The coordinate at the samples of a motion at a value, both by number."""
        return np.asarray(self.heights[(self.owners == (value, motion)).all(axis=1)])

    def _check(self) -> None:
        n, d, motions = self.times.size, len(self.state_names), self.starts.size // max(1, len(self.state_names))
        runs = motions * (1 + (self.sweep == "both"))
        check_shapes(self, states=(n, d), times=(n,), owners=(n, 2), values=(self.values.size,),
                     repeats=(self.values.size, runs), starts=(motions, d))  # fmt: skip
        if self.coordinate not in self.state_names or self.sweep not in SWEEPS or not self.values.size or not runs:
            raise ValueError(f"coordinate, sweep: {self.coordinate!r}, {self.sweep!r} are not of this record")
        if not all(np.issubdtype(getattr(self, name).dtype, np.integer) for name in ("owners", "repeats")):
            raise ValueError("owners, repeats: expected whole numbers")
        if n and (self.owners.min() < 0 or np.any(self.owners.max(axis=0) >= self.repeats.shape)):
            raise ValueError("owners: expected numbers of values and motions")
        if not 0 <= self.repeats.min() <= self.repeats.max() <= max(0, self.count // 2):
            raise ValueError(f"repeats: expected whole numbers up to half of the count, {self.count // 2}")


CODEC = Codec(Bifurcation, "bifurcation", "`orbitfinder bifurcation`", "make the diagram again")


def save_bifurcation(made: Bifurcation, path: str | Path) -> Path:
    """Write bifurcation.json and, beside it, bifurcation.npz; returns the JSON's path."""
    return CODEC.save(made, path)


def load_bifurcation(path: str | Path) -> Bifurcation:
    """The Bifurcation of a bifurcation.json and its bifurcation.npz. Raises `InputError`."""
    return CODEC.load(path)


@dataclass(frozen=True)
class Sampler:
    """What returns of motions at many values of a parameter are: of which `coordinate` the maxima, or the crossings of
    what `cut` is."""

    model: Model
    parameter: str
    coordinate: int
    cut: Surface
    words: str

    @cached_property
    def _motions(self) -> Crossings:
        field, restored = along_parameter(self.model, self.parameter, self.coordinate)
        units, (own,) = self.cut.units, np.abs(self.model.values_of([self.parameter]))
        slope = [] if restored is None else [units[self.coordinate] / self.cut.clock]
        return Crossings(field, np.concatenate([units, [own or 1.0], slope]), restored=restored)

    def clock(self, value: float) -> float:
        """The forcing's period (s) at a value."""
        numbers = self.model.parameter_values.copy()
        numbers[self.model.parameter_index(self.parameter)] = value
        return float(self.model.forcing_period(numbers))  # type: ignore[misc]

    def passing(self, values: np.ndarray, starts: np.ndarray, count: int) -> Passing:
        """The next returns of motions at values (k) from states (k x d)."""
        model, d = self.model, len(self.model.state_names)
        if not model.smooth:
            each = [after_events(with_parameters(model, {self.parameter: value}), start[None], count)
                    for value, start in zip(values.tolist(), starts, strict=True)]  # fmt: skip
            return Passing(
                *(np.concatenate([getattr(passing, name) for passing in each]) for name in ("times", "states"))
            )
        whole, restored = np.column_stack([starts, values]), self._motions.restored
        if restored is not None:
            whole = restored(np.column_stack([whole, values]).T).full().T
        plane, longest = self.cut.plane, LOST * self.cut.clock
        if model.forced:
            plane, longest = Plane(-1, 0.0, 0, 1.0), 2.0
        elif self.words.startswith(MAXIMA):
            plane = Plane(d + 1, 0.0, -1)
        made = self._motions.passing(plane, whole, count, longest=longest, tolerance=SEEN)
        unit = np.array([self.clock(value) for value in values])[:, None] if model.forced else 1.0
        return Passing(made.times * unit, made.states[..., :d])


def sampler_of(model: Model, parameter: str, coordinate: str, words: str) -> Sampler:
    """What a record's words mean."""
    driven = model.forced or words.startswith(MAXIMA)
    cut = surface(model) if driven else named_surface(model, words)
    return Sampler(model, parameter, model.state_index(coordinate), cut, words)


@lru_cache(maxsize=2)
def _prepared(text: str) -> Sampler:
    known = json.loads(text)
    return sampler_of(build_model(known["system"], home(known["folder"])), *known["sampler"])


@one_thread()
def sampled(
    sampler: Sampler | str, values: np.ndarray, starts: np.ndarray, transient: int, count: int
) -> np.ndarray:  # fmt: skip
    """Rows (number of the motion, time, state) of what motions at values (k) from states (k x d) do afterwards."""
    chosen = _prepared(sampler) if isinstance(sampler, str) else sampler
    made = chosen.passing(values, starts, transient + count)
    times, states = made.times[:, transient:], made.states[:, transient:]
    which = np.broadcast_to(np.arange(len(values))[:, None], times.shape)
    known = np.isfinite(times)
    return np.column_stack([which[known], times[known], wrapped(states[known], chosen.model.angular)])


def bifurcation(
    system: Model | Problem, values: Mapping[str, Sequence[float]] | None = None, *,
    state: Sequence[float] | np.ndarray | None = None, coordinate: str | None = None, plane: str | None = None,
    direction: int = 1, transient: int = 200, samples: int = 100, sweep: str = "none",
    starts: int | Sequence[Sequence[float]] = 1, seed: int = 0, workers: int = 1, scheduler: str | None = None,
    folder: str | Path | None = None, progress: Progress | None = None, name: str = "", out: str | Path | None = None,
    shards: Sequence[str | Path] = (), **named: Sequence[float],
) -> Bifurcation:  # fmt: skip
    """What the motions of a system settle to at many values of a parameter: a brute-force bifurcation diagram.

    A forced system is looked at once a period of its forcing, a hybrid system after the event that ends its cycle, any
    other where a coordinate is largest, or where it crosses a plane.

    Args:
        system: a Model, or a Problem.
        values: as the keyword, as a mapping.
        state: where the first motion begins (d); the guess's of a Problem if None.
        coordinate: what is drawn, and of which maxima are taken; the first if None.
        plane: a component and a number ("y=0") whose crossings are taken instead.
        direction: how it is crossed: 1 growing, -1 falling, 0 both.
        transient: returns that are dropped at each value.
        samples: returns that are kept.
        sweep: none: motions begin at the starts at every value; up, down, both: where those at the value before end.
        starts: how many motions, the others drawn about the first; or the states (r x d) where they begin.
        seed: of those that are drawn.
        workers: processes that share the motions.
        scheduler: address of a Dask cluster that does them instead.
        folder: of a trusted module that makes the system.
        progress: called with how many motions are done, and how many there are.
        name: a word for files.
        out: a folder: OUT/<name>/bifurcation.jsonl keeps what is done; also with more values it goes on from there.
        shards: journals of the same request at other values, which are taken from there; of others nothing is.
        **named: values of a physical parameter.

    Returns:
        A Bifurcation: `states` and `owners`, `repeats`, `counts`.

    Raises:
        InputError: for unknown names, and systems that conserve their energy, whose motions settle to nothing.

    Examples:
        >>> pendulum = of.systems.forced_pendulum(torque=0.5, damping=0.5)
        >>> made = of.bifurcation(pendulum, torque=[0.4, 0.5], state=[0.1, 0.0], samples=20)
        >>> made.counts
        '2 values, 2 motions: 2 repeat after 1 return'

    See Also:
        `of.sections.draw_bifurcation` draws it, with families; `of.diagram` follows what there is, stable or not.
    """
    problem = system if isinstance(system, Problem) else None
    model: Model = system if problem is None else problem.model  # type: ignore[assignment]
    parameter, axis = _axis(model, {**(values or {}), **named})
    sampler = _chosen(model, parameter, coordinate, plane, direction)
    for what, number, least in (("transient", transient, 0), ("samples", samples, 4)):
        if not least <= number <= 1_000_000:
            raise InputError(f"{what}: must be between {least} and 1000000, got {number}")
    if sweep not in SWEEPS:
        raise InputError(f"sweep: {sweep!r} is none of {', '.join(SWEEPS)}; choose among these")
    begun = _starts(sampler, problem.guess.state if problem and state is None else state, starts, seed)
    name = name or (problem.name if problem else str(model.system.get("function", "bifurcation")))
    made = Bifurcation(
        name, dict(model.system), parameter, model.state_names[sampler.coordinate], sampler.words, model.state_names,
        sweep, transient, samples, axis, begun, np.zeros((0, begun.shape[1])),
        np.zeros(0), np.zeros((0, 2), int), np.zeros((axis.size, len(begun) * (1 + (sweep == "both"))), int),
        problem.title if problem else "",
    )  # fmt: skip
    alike = "system parameter plane sweep transient count starts" + " values" * (sweep != "none")
    asked = plain({"bifurcation": {field: getattr(made, field) for field in alike.split()}})
    path = None if out is None else Path(out) / name / "bifurcation.jsonl"
    with (checkpoints(path, asked, _reader(made)) as journal, scheduler_at(scheduler, "bifurcation", folder) as far,
          tasks.crew(sampled, workers, "bifurcation", far) as answers):  # fmt: skip
        study = _Motions(made, [*journal.known, *_joined(shards, asked, made)], journal)
        given: Sampler | str = sampler
        if workers > 1 or far is not None:
            build_model(made.system, None if folder is None else Path(folder))  # or nobody else can
            trusted = far.luggage.folder if far else None if folder is None else str(folder)
            given = json.dumps(plain({"system": made.system, "folder": trusted, "sampler": [
                parameter, made.coordinate, made.plane]}))  # fmt: skip
        for done in study.rounds(given, answers, 4 if far else workers):
            finished(lambda: study.record(model))
            if progress:
                progress(done, made.repeats.size)
    return study.record(model)


def _axis(model: Model, given: Mapping[str, Sequence[float]]) -> tuple[str, np.ndarray]:
    """The parameter and its values, increasing. Raises `InputError`."""
    known = ", ".join(model.parameter_names[:20]) or "this system has none"
    if len(given) != 1:
        raise InputError(f"parameter: give the values of a single parameter, got {len(given)}; choose among {known}")
    ((name, numbers),) = given.items()
    if name not in model.parameter_names:
        raise InputError(f"parameter: unknown {name!r}{closest(name, model.parameter_names)}; choose among {known}")
    check_constant(model, [name])
    try:
        axis = np.unique(np.array([float(number) for number in numbers]))
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: must be a list of numbers, got {shortened(numbers)}") from error
    if not axis.size or not np.isfinite(axis).all():
        raise InputError(f"{name}: must be finite numbers, got {shortened(numbers)}")
    model.check_clock(name, axis)
    return name, axis


def _chosen(
    model: Model, parameter: str, coordinate: str | None, plane: str | None, direction: int
) -> Sampler:  # fmt: skip
    """What is sampled. Raises `InputError`."""
    if not model.dissipative:
        raise InputError("system: it conserves its energy, so that its motions settle to nothing; `section` shows them")
    names = model.state_names
    if coordinate is not None and coordinate not in names:
        raise InputError(f"coordinate: unknown {coordinate!r}{closest(coordinate, names)}; one of {', '.join(names)}")
    chosen = names.index(coordinate) if coordinate else 0
    cut = surface(model, plane, None, direction)
    words = STROBE if model.forced else cut.name if plane or not model.smooth else MAXIMA + names[chosen]
    return Sampler(model, parameter, chosen, cut, words)


def _starts(
    sampler: Sampler, state: Sequence[float] | np.ndarray | None, given: int | Sequence[Sequence[float]], seed: int
) -> np.ndarray:  # fmt: skip
    """Where motions begin (r x d). Raises `InputError`."""
    model = sampler.model
    if not isinstance(given, int | np.integer):
        return np.array([checked_state(model, state) for state in np.atleast_2d(np.asarray(given, float))])
    if not 1 <= given <= 10_000:
        raise InputError(f"starts: must be between 1 and 10000, or states, got {given}")
    if state is None:
        raise InputError("state: missing; give where the first motion begins")
    first = checked_state(model, state)
    drawn = np.random.default_rng(seed).uniform(-1, 1, (int(given) - 1, first.size))
    return np.vstack([first, first + drawn * np.maximum(np.abs(first), sampler.cut.units)])


Lane = tuple[float, int]
"""The value of a motion and its number there"""


def _reader(made: Bifurcation) -> Callable[[Mapping[str, Any]], dict[Lane, np.ndarray]]:
    """What reads a line of a journal: times and states of motions. Raises `ValueError`."""

    def read(line: Mapping[str, Any]) -> dict[Lane, np.ndarray]:
        rows = unpacked(line["samples"], 2 + len(made.state_names))
        lanes = unpacked(line["motions"], 2)
        return {(float(value), int(motion)): rows[rows[:, 0] == k, 1:] for k, (value, motion) in enumerate(lanes)}

    return read


def _joined(
    shards: Sequence[str | Path], asked: Mapping[str, Any], made: Bifurcation
) -> Iterator[dict[Lane, np.ndarray]]:  # fmt: skip
    """The lines of other journals, of those of the same request."""
    for path in map(Path, shards):
        lines, _ = read_lines(path, path.name) or ([], True)
        yield from map(_reader(made), lines[1:] if lines[:1] == [header_of(asked)] else ())


class _Motions:
    """The motions of a diagram, those that are `known` with their times and states."""

    def __init__(
        self, made: Bifurcation, given: Sequence[dict[Lane, np.ndarray]], journal: Checkpoints[dict[Lane, np.ndarray]]
    ) -> None:  # fmt: skip
        self.made, self.journal, self.known = made, journal, dict[Lane, np.ndarray]()
        for lanes in given:
            self.known |= lanes

    def rounds(self, sampler: Sampler | str, answers: tasks.Answers, hands: int) -> Iterator[int]:
        """How many motions are done, after each task."""
        made, done = self.made, 0
        for lanes in self._lanes():
            left = [lane for lane in lanes if lane not in self.known]
            done += len(lanes) - len(left)
            size = min(max(-(-len(left) // hands), FEWEST), MOST)
            parts = [left[k : k + size] for k in range(0, len(left), size)]
            requests = [(sampler, np.array([value for value, _ in part]), np.array([*map(self._start, part)]),
                         made.transient, made.count) for part in parts]  # fmt: skip
            for number, rows in answers(requests):
                line = {"motions": packed(np.array(parts[number], float)), "samples": packed(rows)}
                self.journal.add(line)
                self.known |= _reader(made)(line)
                done += len(parts[number])
                yield done

    def _lanes(self) -> Iterator[list[Lane]]:
        """Motions that do not depend on each other, round after round."""
        made, axis = self.made, self.made.values.tolist()
        runs = made.repeats.shape[1]
        if made.sweep == "none":
            yield [(value, run) for value in axis for run in range(runs)]
            return
        for k in range(len(axis)):
            yield [(axis[k] if self._upwards(run) else axis[-1 - k], run) for run in range(runs)]

    def _upwards(self, run: int) -> bool:
        return self.made.sweep == "up" or (self.made.sweep == "both" and run < len(self.made.starts))

    def _start(self, lane: Lane) -> np.ndarray:
        """Where a motion begins: at a start, or where that at the value before has ended, unless it was lost."""
        made, (value, run) = self.made, lane
        before = int(np.searchsorted(made.values, value)) - (1 if self._upwards(run) else -1)
        if made.sweep != "none" and 0 <= before < made.values.size:
            rows = self.known[float(made.values[before]), run]
            if len(rows) == made.count:
                return rows[-1, 1:]
        return np.asarray(made.starts[run % len(made.starts)])

    def record(self, model: Model) -> Bifurcation:
        """The diagram by now."""
        made, (k, runs) = self.made, self.made.repeats.shape
        lanes = [(i, j) for i in range(k) for j in range(runs)]
        parts = [self.known.get((float(made.values[i]), j), np.zeros((0, 1 + made.states.shape[1]))) for i, j in lanes]
        rows = np.vstack(parts)
        owners = np.repeat(np.array(lanes), [len(part) for part in parts], axis=0)
        made = replace(made, times=rows[:, 0], states=rows[:, 1:], owners=owners)
        return replace(made, repeats=repeats_of(made, model))


def repeats_of(made: Bifurcation, model: Model) -> np.ndarray:
    """After how many returns each motion (k x r) repeats, over the latter half of its samples; 0 where it does not."""
    repeats = np.zeros(made.repeats.shape, int)
    if not made.full.any():
        return repeats
    units = _units(made, model)
    for lane, states in _motions(made).items():
        late = states[len(states) // 2 :]
        gaps = [np.abs(wrapped(late[n:] - late[:-n], model.angular) / units).max()
                for n in range(1, len(late) // 2 + 1)]  # fmt: skip
        n = 1 + int(np.argmax(np.array(gaps) <= SETTLED))
        sure = gaps[n - 1] <= SETTLED and all(gaps[m - 1] > APART for m in range(1, n) if n % m == 0)
        repeats[lane] = n if sure else 0
    return repeats


def _motions(made: Bifurcation) -> dict[tuple[int, int], np.ndarray]:
    """The states (count x d) of all motions that have all their returns, by their numbers."""
    whole = made.full[tuple(made.owners.T)]
    states = made.states[whole].reshape(-1, made.count, len(made.state_names))
    lanes = made.owners[whole][:: made.count]
    return {(int(i), int(j)): each for (i, j), each in zip(lanes, states, strict=True)}


def _units(made: Bifurcation, model: Model) -> np.ndarray:
    """Extents (d) of all samples, with the mean time between them; components may stay, which are held on a plane."""
    same = (np.diff(made.owners, axis=0) == 0).all(axis=1)
    moved = extents_of(model, made.states, float(np.diff(made.times)[same].mean()))
    return np.asarray(np.maximum(moved, APART * np.abs(made.states).max(axis=0)))


def family_samples(made: Bifurcation, family: Family, model: Model | None = None) -> np.ndarray:
    """What the orbits of a family are in a diagram: the coordinate at the samples of each of its members (m x s),
    growing, nan behind them. Raises `InputError` for a family of something else."""
    model, own = model or build_model(made.system), {made.parameter: 0.0}
    alike = plain(system_at(family.system, own)) == plain(system_at(made.system, own))
    if family.parameters != (made.parameter,) or not alike:
        raise InputError(f"families: {family.name} is followed in {', '.join(family.parameters)} of "
                         f"{'this' if alike else 'another'} system; give one of this in {made.parameter}")  # fmt: skip
    sampler, count = sampler_of(model, made.parameter, made.coordinate, made.plane), 8
    members, values = family.members, family.places[:, 0]
    starts, periods = np.array([member.state for member in members]), np.array([member.period for member in members])
    while True:
        passing = sampler.passing(values, starts, count)
        within = passing.times <= periods[:, None] * (1 + SETTLED)
        if not within[:, -1].any() or count > made.count:
            break
        count *= 4
    states = wrapped(passing.states, model.angular)[..., model.state_names.index(made.coordinate)]
    heights = np.sort(np.where(within, states, np.nan), axis=1)
    return heights[:, : max(1, int(within.sum(axis=1).max()))]


@one_thread()
def verified(made: Bifurcation, model: Model) -> Certificate:
    """From the record alone: what repeats; of motions drawn by lot a few returns by DOP853, with none on the way; and
    of those that repeat the certified orbit, which is not unstable and as near as they have settled."""
    if not (motions := _motions(made)):
        return Certificate((equal("motions", 0.0, float(made.repeats.size), "have all their returns"),))
    units = _units(made, model)
    wrong = int((repeats_of(made, model) != made.repeats).sum())
    checks = [equal("repeats", wrong, 0.0, "motions that do not repeat as said")]
    lanes = [[*motions][k] for k in sorted(np.random.default_rng(0).permutation(len(motions))[:CHECKED])]
    off, gaps, failed = [0.0], [0.0], list[str]()
    for lane in lanes:
        at = with_parameters(model, {made.parameter: float(made.values[lane[0]])})
        times = made.times[(made.owners == lane).all(axis=1)]
        sampler = sampler_of(at, made.parameter, made.coordinate, made.plane)
        if model.smooth:
            pairs = [slice(k, k + 2) for k in range(0, made.count - 1, made.count // 3)]
            off += [_missed(sampler, motions[lane][pair], times[pair], units) for pair in pairs]
        if (n := int(made.repeats[lane])) and (
            model.smooth or n == 1
        ):  # a machine's cycle has as many events as it says
            try:
                gaps.append(_unsettled(at, motions[lane][-1], times[-1] - times[-1 - n], units))
            except FAILURES as error:
                failed.append(str(error))
    if model.smooth:
        note = f"of {len(lanes)} motions by another integrator, in extents"
        checks.append(at_most("returns", max(off), RETURNED, note))
    checks.append(
        equal("orbits", len(failed), 0.0, f"of {len(gaps) - 1 + len(failed)} that repeat, none certified and stable")
    )
    checks.append(at_most("settled", max(gaps), SETTLED, "from the certified orbit, times 1 - its largest multiplier"))
    return Certificate(tuple(checks))


def _missed(sampler: Sampler, states: np.ndarray, times: np.ndarray, units: np.ndarray) -> float:
    """How far a return (2 x d) is from where DOP853 leads (in units); infinite where it meets another on the way."""
    model, i = sampler.model, sampler.coordinate
    field, moments = vector_field(accelerations(model)), np.linspace(times[0], times[1], BETWEEN)
    path = integrate_in(units, field, states[0], moments, SECOND)
    off = float(np.abs(wrapped(path[-1] - states[1], model.angular) / units).max())
    if model.forced:
        return max(off, abs(float(times[1] - times[0]) / sampler.cut.plane.cycle - 1.0))
    plane = Plane(0, 0.0, -1) if sampler.words.startswith(MAXIMA) else sampler.cut.plane
    watched = field.many(moments, path)[:, i] if sampler.words.startswith(MAXIMA) else path[:, plane.component]
    steps, gap = np.diff(plane.cell(watched[1:-1])), plane.off(watched[0], plane.nearest(watched[0]))
    met = np.any((steps != 0) & (steps * plane.direction >= 0))
    return np.inf if met else max(off, abs(float(gap)) / nonzero(float(np.ptp(watched))))


def _unsettled(model: Model, state: np.ndarray, period: float, units: np.ndarray) -> float:
    """How far a state is from the certified orbit that it repeats on (in units), times 1 - the largest multiplier.

    Raises `ConvergenceError` where there is none, or none that motions settle to.
    """
    end = simulate(model, state, period, 2).states[-1]
    turns = np.round((end - state)[: model.degrees_of_freedom] / (2 * np.pi)).astype(int) * model.angular
    orbit = find_orbit(Problem(model, Guess(state, period), winding=tuple(map(int, turns))))
    if not orbit.certificate or not orbit.certificate.passed or orbit.stability == "unstable":
        raise ConvergenceError("no certified orbit that is not unstable")
    largest = float(np.abs(orbit.floquet_multipliers).max(initial=0.0))
    gap = float(np.abs(wrapped(orbit.state - state, model.angular) / units).max())
    return max(gap, abs(orbit.period / period - 1.0)) * abs(1.0 - largest)
