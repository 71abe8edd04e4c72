"""What the studio's processes compute: simulate, pull, find, follow, branch, show, turn, cut, search."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.atlas.choose import solve
from orbitfinder.atlas.search import SearchStatistics, search
from orbitfinder.continuation.follow import Pace, reached
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.families.branches import branches
from orbitfinder.families.equilibria import follow_equilibria
from orbitfinder.families.equilibrium import Equilibrium
from orbitfinder.families.folder import follow_family
from orbitfinder.families.members import whole
from orbitfinder.families.point import FamilySettings
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms.pose import pulled, thrown
from orbitfinder.orbits.course import simulated_course
from orbitfinder.orbits.guesses.returns import CloseReturn, close_returns, returns_of_arcs
from orbitfinder.orbits.refine import Refiner
from orbitfinder.orbits.simulate import SAMPLES_PER_SECOND, simulate
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import Batch, Event, Family, FamilyPoint, read_journal
from orbitfinder.records.orbit import Orbit, save_orbit, system_at
from orbitfinder.records.reading import Entries, Table
from orbitfinder.records.registry import load_orbit
from orbitfinder.site.motion import Simulator, jumping, packed
from orbitfinder.structures.section import Section
from orbitfinder.structures.sections import crossings, section
from orbitfinder.studio.films import around, film, pose, view

Say = Callable[[Any], None]
Film = Entries

LEAST_SAMPLES, MOST_SAMPLES = 400, 3000
BEFORE, SEEDS, CROSSINGS = 0.999, 24, 60
"""Share of the time until a motion can be continued no longer that is shown; motions of a section, and how often each
crosses it"""
PUSHED, ALIKE, STILL, STRETCHES = 0.02, 0.01, 1e-4, 60
"""Shares: how far from an unstable equilibrium a motion begins, what two stretches of one that has settled differ by in
its extent, and the extent, in the size of the state, of one that rests; the most that a motion is given to settle"""
SPEAK_EVERY = 0.25
"""s between two reports of a search"""


@dataclass(frozen=True)
class Simulated:
    """A motion on the stage, its energy (J, None where there is none), what became of it, its close returns.

    The nearest returns are often long and belong to no orbit: they are ordered by distance times period^3.
    """

    film: Film
    view: Mapping[str, list[float]]
    energy: float | None
    change: float
    returns: tuple[CloseReturn, ...]
    events: tuple[tuple[str, int], ...] = ()
    """of a hybrid system: which, and how often"""
    stopped: str = ""
    """why it goes on no longer"""


@dataclass(frozen=True)
class FilmedOrbit:
    """An orbit with its film and, where it is certified, its file."""

    orbit: Orbit
    film: Film | None
    file: Path | None


@dataclass(frozen=True)
class FilmedStep:
    """What a step along the family of a name adds, each orbit with its film."""

    family: str
    batch: Batch
    films: tuple[Film | None, ...]


@dataclass(frozen=True)
class Cut:
    """A Poincare section and where an orbit crosses it (k x 2, in its axes)."""

    section: Section
    crossings: np.ndarray


@dataclass(frozen=True)
class Settled:
    """What a motion comes to: a stretch of it (k x d), from where it goes on, whether it is `still`; the equilibrium
    near the last one (None where there is none), and the sizes (d) that the state has had."""

    path: np.ndarray
    state: list[float]
    still: bool
    rest: Equilibrium | None
    sizes: np.ndarray


def promise(near: CloseReturn) -> float:
    """The less, the more promising: distance times period^3."""
    return near.distance * near.period**3


def _simulated_arcs(model: Model, state: np.ndarray, duration: float) -> Simulated:
    """The motion of a hybrid system, arc by arc, as far as it can be continued, over a duration (s)."""
    try:
        path, broken = simulated_course(model, state, duration)
        stopped = f"after {path.period:.4g} {broken} holds no longer" if broken else ""
    except IntegrationError as error:
        if not error.time:
            raise
        stopped, path = error.reason, simulated_course(model, state, BEFORE * error.time)[0]
    level = np.sum(path.energies, axis=0)
    energy = float(level[0]) if np.isfinite(level[0]) else None
    change = 0.0 if energy is None else float(np.nanmax(np.abs(level - energy)))
    count = int(np.clip(path.period * SAMPLES_PER_SECOND, LEAST_SAMPLES, MOST_SAMPLES))
    shown, events = packed(jumping(model, path, count)), Counter(name for _, name in path.events)
    near = sorted(returns_of_arcs(model, path)[:12], key=promise)
    return Simulated(shown, around(shown), energy, change, tuple(near), tuple(events.items()), stopped)


class Tasks:
    """The tasks of one process, which keeps what the next one may use again; `say` tells how a task gets on."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self._simulator = Simulator()
        self._refiner: tuple[Any, Refiner] | None = None

    def model(self, system: Table) -> Model:
        """The Model of a description, built once. Raises `InputError`."""
        known = self._simulator.model(system)
        return build_model(system) if known is None else known[0]

    def simulated(self, system: Table, state: list[float], duration: float) -> Simulated:
        """The motion from a state (d) over a duration (s) and where it nearly closes."""
        model = self.model(system)
        if not model.smooth:
            return _simulated_arcs(model, np.asarray(state, float), duration)
        count = int(np.clip(duration * SAMPLES_PER_SECOND, LEAST_SAMPLES, MOST_SAMPLES))
        run = simulate(model, np.asarray(state, float), duration, count)
        energy = float(run.energy[0]) if np.isfinite(run.energy[0]) else None
        returns = list[CloseReturn]()
        if np.ptp(run.states, axis=0).max() > 0:
            returns = close_returns(run.times, run.states, model.angles, 12)
            returns.sort(key=promise)
        shown = film(model, run.times, run.states)
        change = run.change if energy is not None else np.nan
        return Simulated(shown, view(model, run.states), energy, change, tuple(returns))

    def settled(
        self, system: Table, state: list[float], name: str, duration: float, near: list[float],
        sizes: np.ndarray,
    ) -> Settled:  # fmt: skip
        """What the motion from a state (d) comes to, stretch (s) by stretch, and the equilibrium `near` the last one.

        The parameter of a name is what was changed. From an unstable equilibrium the motion is pushed away.
        """
        model, start, rest = self.model(system), np.asarray(state, float), None
        with contextlib.suppress(ConvergenceError):
            rest = follow_equilibria(model, near, name, points=1).points[0]
        sizes = np.maximum(sizes, np.abs(start))
        sizes = np.where(sizes > 0.0, sizes, sizes.max() or 1.0)
        if rest is not None and rest.stability == "unstable" and np.abs((start - rest.state) / sizes).max() < PUSHED:
            start = rest.state + PUSHED * sizes * np.cos(1.0 + np.arange(start.size))  # along no component alone
        before = np.full((2, start.size), np.inf)
        for _ in range(STRETCHES):
            path = simulate(model, start, duration, 3 * LEAST_SAMPLES).states
            start, box = path[-1], np.array([path.min(axis=0), path.max(axis=0)])
            extent = nonzero(np.ptp(box, axis=0))
            still = bool((extent / sizes).max() < STILL)
            if still or (np.abs(box - before) / extent).max() < ALIKE:
                break
            before = box
        return Settled(path, [*map(float, start)], still, rest, np.maximum(sizes, np.abs(path).max(axis=0)))

    def later(self, system: Table, state: list[float], duration: float) -> list[float]:
        """The state (d) that a motion has come to after a time (s)."""
        model = self.model(system)
        if duration <= 0:
            return list(state)
        if not model.smooth:  # it is taken hold of where it was in the mode that it begins in
            path, first = simulated_course(model, np.asarray(state, float), duration)[0], model.hybrid.first.model
            return [*map(float, next(piece for piece in path.pieces[::-1] if piece.model is first).states[-1])]
        run = simulate(model, np.asarray(state, float), duration, 2)
        return [*map(float, run.states[-1])]

    def pulled(self, system: Table, state: list[float], point: int, place: list[float]) -> tuple[list[float], Film]:
        """The state at rest, and its picture, when a point is pulled to a place (down, right, m)."""
        model = self.model(system)
        pulled_to = pulled(model, np.asarray(state, float), point, np.asarray(place, float))
        return [*map(float, pulled_to)], pose(model, pulled_to)

    def posed(self, system: Table, state: list[float]) -> Film:
        """The picture of a state that stands still."""
        return pose(self.model(system), np.asarray(state, float))

    def thrown(self, system: Table, state: list[float], point: int, velocity: list[float]) -> list[float]:
        """The state when a point is let go of with a velocity (down, right, m/s)."""
        after = thrown(self.model(system), np.asarray(state, float), point, np.asarray(velocity, float))
        return [*map(float, after)]

    def cut(self, system: Table, energy: float | None, orbit: Orbit | None) -> Cut:
        """The Poincare section at an energy (J, None where none is conserved), and where an orbit crosses it."""
        model = self.model(system)
        made = section(model, energy if model.conservative else None, seeds=SEEDS, returns=CROSSINGS)
        points = np.zeros((0, 2))
        if orbit is not None:
            with contextlib.suppress(InputError):  # it does not cross this plane
                points = crossings(model, made, orbit)
        return Cut(made, points)

    def searched(
        self, system: Table, energy: float | None, periods: tuple[float, float], budget: float, atlas: Path
    ) -> int:
        """Search for orbits for a time (s) and keep them in an atlas: what `orbitfinder search` does; its starts."""
        last = [0.0]

        def report(_: float, at: SearchStatistics) -> None:
            if time.monotonic() - last[0] > SPEAK_EVERY:
                last[0] = time.monotonic()
                self._say(at)

        searched = search(self.model(system), energy, periods, atlas, budget=budget, workers=0, progress=report)
        return sum(at.made for _, at in searched.tallies)

    def found(self, file: Path, out: Path) -> FilmedOrbit:
        """The orbit of a problem file, in OUT/NAME/orbit.json where it is certified: what `orbitfinder run` does."""
        orbit = solve(load_problem(file), progress=lambda at: self._say(
            f"{at.stage} {at.iteration}: defect {at.defect:.1e}, period {at.period:.6g}"
        ))  # fmt: skip
        kept = orbit.certificate is not None and orbit.certificate.passed
        saved = save_orbit(orbit, out / orbit.name / "orbit.json") if kept else None
        return FilmedOrbit(orbit, self._film(orbit), saved)

    def opened(self, file: Path) -> FilmedOrbit:
        """The orbit of an orbit.json, or of ATLAS#K."""
        orbit = load_orbit(file)
        return FilmedOrbit(orbit, self._film(orbit), file)

    def followed(self, file: Path, parameter: str, points: int, name: str, out: Path) -> Family:
        """The family through the orbit of a file: what `orbitfinder continue` does."""
        settings = FamilySettings(points=points)
        report = self._stepped(out / name)
        return follow_family(load_orbit(file), parameter, settings=settings, out=out, name=name, progress=report)

    def branched(self, file: Path, event: int, points: int, out: Path) -> list[Family]:
        """The families that leave that of a file at an event: what `orbitfinder continue --switch` does."""
        settings = FamilySettings(points=points, directions="away")
        leaving = branches(file, event, settings)
        self._say(f"{len(leaving)} found at event {event}")
        return [
            follow_family(new, settings=settings, out=out, name=new.name, progress=self._stepped(out / new.name))
            for new in leaving
        ]

    def shown(self, system: Table, member: FamilyPoint | Event) -> Film | None:
        """The motion of a point or an event of a family."""
        motion = self._simulator.member(system, member)
        return None if motion is None else packed(motion)

    def own(self, point: FamilyPoint) -> Orbit:
        """A point of a family as an Orbit of its own."""
        return whole(point, self.model(point.system))

    def turned(self, orbit: Orbit, name: str, value: float) -> FilmedOrbit:
        """The orbit at another value of a physical parameter, followed warm; its energy stays where it is conserved.

        Steps that Newton's method does not survive are halved. Raises `ConvergenceError` where the orbit ends.
        """
        model = self.model(orbit.system)
        last = model.value(name)
        refiner, known = self._warm(orbit, model, name), list[tuple[Any, Any]]([(last, orbit)])

        def refined(at: float) -> tuple[Any, int]:
            values, before = {name: at, "energy": orbit.energy}, known[-1][1]
            pins = tuple(replace(pin, value=values.get(pin.name, pin.value)) for pin in refiner.problem.pin)
            return refiner.refine(Guess(before.state, before.period), pins), 0

        try:
            halved = Pace(first=1.0, shortest=2.0**-5, longest=1.0, growth=1.0)  # shares of the way
            turned = refiner.orbit(reached(known, value, refined, halved))
        except ConvergenceError as error:
            raise ConvergenceError(f"{name} = {value:.6g}: the orbit was lost on the way ({error})") from error
        return FilmedOrbit(turned, self._film(turned), None)

    def _warm(self, orbit: Orbit, model: Model, name: str) -> Refiner:
        """The Refiner of an orbit in a parameter; the last one stays warm, whatever that parameter's value is."""
        plain = with_parameters(model, {name: 1.0}).parameter_values.tolist()
        key = (name, plain, orbit.symmetry, orbit.winding, round(orbit.energy, 9))
        if self._refiner is None or self._refiner[0] != key:
            value = model.value(name)
            pins = (*((Pin("energy", orbit.energy),) if model.conservative else ()), Pin(name, value))
            problem = Problem(
                model, Guess(orbit.state, orbit.period), pins, winding=orbit.winding, free=(name,), name=orbit.name,
                relative=tuple(orbit.shift), tolerance=orbit.tolerance,
            )  # fmt: skip
            self._refiner = key, Refiner(problem)
        return self._refiner[1]

    def _stepped(self, folder: Path) -> Callable[[Batch], None]:
        """A report of each step of the family in a folder."""
        system: Entries = {}

        def report(batch: Batch) -> None:
            if not system and (journal := read_journal(folder)) is not None:
                system.update(journal.header["system"])
            films = tuple(self.shown(system_at(system, point.free), point) for point in batch.points)
            self._say(FilmedStep(folder.name, batch, films))

        return report

    def _film(self, orbit: Orbit) -> Film | None:
        motion = self._simulator.of(orbit)
        return None if motion is None else packed(motion)
