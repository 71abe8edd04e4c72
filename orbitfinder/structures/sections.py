"""Poincare sections: where the motions of a Model at one energy cross a plane, and which of them are regular.

A section is a plane of one component of the state (of a forced system: whole periods of its forcing; of a hybrid one:
what comes after the event that begins its cycle), looked at in two other components, its axes. Where an energy is
conserved, motions begin on the plane at that energy: of each point of the axes one more rate is found from it.

Beside each motion x goes the direction of a deviation from it and the logarithm s of how much that has grown,
u' = J u - k u, s' = k = u.J u / u.u, in the system's units: what tells chaos from order (`Section.kinds`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.keeping import finished
from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.sizes import LEAST, nonzero
from orbitfinder.errors import InputError, IntegrationError, closest
from orbitfinder.integrate.automaton import Automaton
from orbitfinder.integrate.dop853 import SECOND
from orbitfinder.integrate.equations import conserved
from orbitfinder.integrate.parallel import Lanes
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, check_states, vector_field, wrapped
from orbitfinder.mechanics.model import energy as energy_of
from orbitfinder.mechanics.scales import surroundings
from orbitfinder.records.codec import plain
from orbitfinder.records.journal import checkpoints, packed, unpacked
from orbitfinder.records.orbit import Orbit
from orbitfinder.structures.crossings import FINE, SEEN, Crossings, Passing, Plane, Track, deviating
from orbitfinder.structures.section import Section

NOWHERE = Track((), lambda *_: None)
"""Keeps nothing"""


@dataclass(frozen=True)
class Surface:
    """A plane in the states of a Model, two axes to look at it, and the values of the invariants held there."""

    __repr__ = brief("plane", "axes")

    model: Model
    plane: Plane
    axes: tuple[int, int]
    levels: Mapping[str, float]

    @property
    def name(self) -> str:
        """The plane in words: y = 0, ydot > 0."""
        plane, names = self.plane, self.model.state_names
        if not self.model.smooth:
            return "events" if not self.model.cycle else f"after {self.model.cycle[-1]}"
        if plane.component < 0:
            return f"t = k P, P = {plane.cycle:.6g}"
        side = {0: "both ways", 1: "growing", -1: "falling"}[plane.direction]
        return f"{names[plane.component]} = {plane.level:.6g}, {side}"

    @property
    def axis_names(self) -> tuple[str, str]:
        """The names of both axes."""
        first, second = (self.model.state_names[k] for k in self.axes)
        return first, second

    @cached_property
    def units(self) -> np.ndarray:
        """What the components of a state (d) are measured in, before there is a motion."""
        model, n = self.model, self.model.degrees_of_freedom
        places, clock = surroundings(model, np.zeros(n))
        return places if model.rates is not None else np.concatenate([places, places / clock])

    @cached_property
    def clock(self) -> float:
        """The system's own time (s)."""
        return surroundings(self.model, np.zeros(self.model.degrees_of_freedom))[1]

    @cached_property
    def motions(self) -> Crossings:
        """What integrates motions to the plane."""
        return Crossings(vector_field(self.model), self.units)

    @cached_property
    def varied(self) -> Crossings:
        """What integrates (x, u, s) to the plane."""
        units = np.append(self.units, np.ones(self.units.size + 1))
        return Crossings(deviating(vector_field(self.model), self.units), units)

    @cached_property
    def _lanes(self) -> Lanes:
        return Lanes()

    def chart(self, states: np.ndarray) -> np.ndarray:
        """The axes' components (... x 2) of states, angles in [-pi, pi)."""
        return wrapped(states, self.model.angular)[..., list(self.axes)]

    def invariants(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the held invariants miss at states (k x m), and their gradients (k x m x d)."""
        names = [invariant.name for invariant in self.model.invariants]
        chosen = [k for k, name in enumerate(names) if name in self.levels]
        size, count = len(self.model.state_names), len(names)
        if not chosen:
            return np.zeros((len(states), 0)), np.zeros((len(states), 0, size))
        both = self._lanes.evaluated(conserved(self.model), 1, states)
        values, slopes = both[:, :count], both[:, count:].reshape(len(states), count, size)
        return values[:, chosen] - [self.levels[names[k]] for k in chosen], slopes[:, chosen]

    def held(self, states: np.ndarray, along: Sequence[int] | None = None) -> np.ndarray:
        """The states nearest to given ones (k x d) on the plane at which the invariants have their values.

        Only the components `along` are changed, by default all but the plane's; nan where there is none near.
        """
        size = states.shape[1]
        moved = [i for i in (range(size) if along is None else along) if i != self.plane.component]
        weights = np.zeros(size)
        weights[moved] = self.units[moved]
        nearest = states.copy()
        if not self.levels:
            return nearest
        with np.errstate(all="ignore"):
            for _ in range(8):
                missed, slopes = self.invariants(nearest)
                rows = np.nan_to_num(slopes * weights, nan=0.0, posinf=0.0, neginf=0.0)
                steps = np.linalg.pinv(rows) @ np.nan_to_num(missed)[:, :, None]
                nearest = nearest - weights * steps[:, :, 0]
            missed, slopes = self.invariants(nearest)
            sizes = np.abs(slopes * nearest[:, None, :]).sum(axis=2) + np.abs(list(self.levels.values())) + LEAST
            # relative to the terms of the invariants
            good = np.isfinite(nearest).all(axis=1) & (np.abs(missed) <= 1e-12 * sizes).all(axis=1)
        return np.where(good[:, None], nearest, np.nan)

    def passing(
        self, states: np.ndarray, count: int, *, sense: int = 1, tolerance: float = SEEN,
        seen: Callable[[Callable[[], Passing], int], None] | None = None, track: Track | None = None,
    ) -> Passing:  # fmt: skip
        """The next crossings of motions that begin at states (k x d)."""
        return self.motions.passing(self.plane, states, count, longest=self.longest, sense=sense, tolerance=tolerance,
                                    seen=seen, track=track)  # fmt: skip

    @property
    def longest(self) -> float:
        """A motion that is not back after this time (s) has left."""
        return max(300.0 * self.clock, 2 * self.plane.cycle if self.plane.component < 0 else 0.0)

    def parted(self, passing: Passing) -> tuple[Passing, np.ndarray]:
        """The crossings of motions without their deviations, and the logarithm of what these have grown by on the
        plane (k x m): without their part along the flow."""
        d, i = self.units.size, self.plane.component
        states, along = passing.states[..., :d], passing.states[..., d : 2 * d]
        if i >= 0:
            rates, there = np.ones(states.shape), np.isfinite(passing.times)
            rates[there] = self.varied.rates(passing.times[there], passing.states[there])[:, :d] / self.units
            along = along - rates * (along[..., i] / rates[..., i])[..., None]
        size = np.linalg.norm(along, axis=-1)
        return replace(passing, states=states), passing.states[..., -1] + np.log(nonzero(size))


def surface(
    model: Model,
    plane: str | None = None,
    axes: Sequence[str] | None = None,
    direction: int = 1,
    *,
    levels: Mapping[str, float] | None = None,
    state: np.ndarray | None = None,
) -> Surface:
    """The section of a Model by a plane such as "y=0", crossed with y growing (`direction` 1), falling (-1) or both
    (0).

    `levels` are values of invariants by name. Without a plane it is the one through `state` (d) that the motion
    crosses fastest, for a forced system whole periods of its forcing. Raises `InputError`.
    """
    if model.constraint is not None:
        raise InputError(
            "plane: systems under constraints have no section; take of.linkages.minimal_linkage of a linkage"
        )
    if direction not in (-1, 0, 1):
        raise InputError(f"direction: must be 1 (growing), -1 (falling) or 0 (both), got {direction}")
    if plane is not None and (model.forced or not model.smooth):
        what = "looked at once a period of its forcing" if model.forced else "looked at after its own events"
        raise InputError(f"plane: {plane!r} given for a system that is {what}; leave the plane out")
    cut = _plane(model, plane, direction, state)
    return Surface(model, cut, _axes(model, cut, axes), dict(levels or {}))


def named_surface(
    model: Model, plane: str, axes: Sequence[str] | None = None, *, state: np.ndarray | None = None
) -> Surface:
    """The section that a record names in words, its `plane`, as `Surface.name` gives them."""
    if model.forced or not model.smooth:
        return surface(model, None, axes)
    where, _, side = plane.partition(",")
    direction = {"growing": 1, "falling": -1}.get(side.strip(), 0)
    return surface(model, where, axes, direction, state=state)


def _plane(model: Model, plane: str | None, direction: int, state: np.ndarray | None) -> Plane:
    """The plane of a text, or the one that fits. Raises `InputError`."""
    if not model.smooth:
        return Plane(-1)
    if model.forced:
        return Plane(-1, 0.0, 0, model.driving_period)
    if plane is None:
        if state is None:
            return Plane(0, 0.0, direction, 2 * np.pi if model.angular[0] else 0.0)
        rates = vector_field(model)(0.0, state, [], []).full().ravel()[: model.degrees_of_freedom]
        i = int(np.argmax(np.abs(rates)))
        turning = 2 * np.pi if model.angular[i] else 0.0
        return Plane(i, float(state[i]), int(np.sign(rates[i])) or 1, turning)
    name, equals, level = (part.strip() for part in plane.partition("="))
    if name not in model.state_names:
        known = ", ".join(model.state_names)
        raise InputError(
            f"plane: unknown component {name!r}{closest(name, model.state_names)}; this system has {known}"
        )
    try:
        value = float(level)
        if not equals or not np.isfinite(value):
            raise ValueError
    except ValueError as error:
        raise InputError(f"plane: {plane!r} is no plane; give a component and a number, such as {name}=0") from error
    i = model.state_names.index(name)
    angle = i < model.degrees_of_freedom and bool(model.angular[i])
    return Plane(i, value, direction, 2 * np.pi if angle else 0.0)


def _axes(model: Model, plane: Plane, axes: Sequence[str] | None) -> tuple[int, int]:
    """The two components to look at: those given, else another coordinate and its rate. Raises `InputError`."""
    names, half = model.state_names, len(model.state_names) // 2
    if axes is None:
        pairs = [pair for pair in model.planes if plane.component not in pair]
        if pairs:
            return pairs[0]
        left = [i for i in range(len(names)) if i != plane.component]
        return (left[0], left[-1]) if half > 1 or len(left) > 1 else (left[0], left[0])
    given = tuple(axes)
    several = len(names) - (plane.component >= 0) > 1
    if len(given) != 2 or (given[0] == given[1] and several):
        raise InputError(
            f"axes: need two different components, got {', '.join(map(str, given))}; one of {', '.join(names)}"
        )
    for name in given:
        if name not in names:
            raise InputError(
                f"axes: unknown component {name!r}{closest(name, names)}; this system has {', '.join(names)}"
            )
        if names.index(name) == plane.component:
            raise InputError(f"axes: {name!r} is the same all over its own plane; choose other components")
    return names.index(given[0]), names.index(given[1])


def levels_at(model: Model, state: np.ndarray) -> dict[str, float]:
    """The values of all invariants at a state (d), by name."""
    n, p = model.degrees_of_freedom, model.parameter_values
    return {invariant.name: float(invariant.value(state[:n], state[n:], p)) for invariant in model.invariants}


def level_of(model: Model, energy: float | None, state: np.ndarray | None) -> dict[str, float]:
    """The value of the energy to hold, by its name: as given, else that of a state. Raises `InputError`."""
    if not model.conservative:
        if energy is not None:
            raise InputError("energy: this system conserves none, its motions have no energy to begin at; leave it out")
        return {}
    name = next(invariant.name for invariant in model.invariants if invariant.generator is None)
    if energy is None and state is None:
        raise InputError("energy: missing; give the energy of the motions, such as 0.12")
    if energy is not None and not np.isfinite(energy):
        raise InputError(f"energy: must be finite, got {energy}; give the energy of the motions")
    return {name: float(energy) if energy is not None else energy_of(model, np.asarray(state, float))}


def section(
    system: Model | Orbit | Problem,
    energy: float | None = None,
    *,
    plane: str | None = None,
    axes: Sequence[str] | None = None,
    direction: int = 1,
    seeds: int = 40,
    returns: int = 250,
    ranges: Mapping[str, Sequence[float]] | None = None,
    model: Model | None = None,
    name: str = "",
    out: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Section:
    """The Poincare section of a system: where motions of one energy cross a plane.

    Motions begin all over what the energy allows, or in `ranges`. A forced system is looked at once a period of its
    forcing, a hybrid one after its own events; neither is given a plane.

    Args:
        system: a Model; an Orbit or a Problem stands for its system and gives the energy where none is given.
        energy: J, where the system has one.
        plane: a component and a number ("y=0").
        axes: the two components that are drawn.
        direction: how the plane is crossed: 1 growing, -1 falling, 0 both.
        seeds: how many motions.
        returns: crossings of each.
        ranges: of the axes {component: (least, greatest)} in which motions begin.
        model: for an orbit of a system that no file describes.
        name: a word for files.
        out: a folder: OUT/<name>/section.jsonl keeps how far the motions have come, and what was asked before goes on
            from there, also with more seeds or returns.
        progress: called with how many returns are done, and of how many.

    Returns:
        A Section: `points`, `regular`, `starts`.

    Raises:
        InputError: for a plane that no motion crosses and an energy that is not reached.

    Examples:
        >>> cut = of.section(orbit, plane="theta1=0", seeds=3, returns=10)
        >>> cut.plane, cut.energy
        ('theta1 = 0, growing', -18.0)

    See Also:
        `of.sections.draw_section`, `of.manifold`, `of.frequency_map`.
    """
    for what, count, most in (("seeds", seeds, 100_000), ("returns", returns, 1_000_000)):
        if not 1 <= count <= most:
            raise InputError(f"{what}: must be between 1 and {most}, got {count}")
    (model, state, own), title = _of(system, model), getattr(system, "title", "")
    levels = {} if not model.smooth else level_of(model, energy, state)
    cut = surface(model, plane, axes, direction, levels=levels)
    starts = _starts(cut, seeds, dict(ranges or {}), state)
    names, chosen = model.state_names, next(iter(levels.values()), np.nan)
    hybrid = not model.smooth

    def made(passing: Passing) -> Section:
        """The crossings so far as a Section."""
        passing, growth = (passing, np.full(passing.times.shape, np.inf)) if hybrid else cut.parted(passing)
        settled = 20 * (not model.conservative and not model.forced and returns > 40)  # left out
        times, states, growth = passing.times[:, settled:], passing.states[:, settled:], growth[:, settled:]
        known = np.isfinite(times)
        which = np.broadcast_to(np.arange(len(starts))[:, None], times.shape)[known]
        return Section(
            name or own, dict(model.system), names, cut.name, cut.axis_names, chosen,
            wrapped(states[known], model.angular), times[known], which, starts, growth[known], title,
        )  # fmt: skip

    def seen(so_far: Callable[[], Passing], done: int) -> None:
        if progress is not None:
            progress(done, len(starts) * returns)
        finished(lambda: made(passing) if np.isfinite((passing := so_far()).times).any() else None)

    path = None if out is None else Path(out) / (name or own) / "section.jsonl"
    request = plain({"system": dict(model.system), "returns of": (plane, axes, direction, levels, ranges or {}, state)})
    size = len(names) if hybrid else 2 * len(names) + 1
    with _track(path, request, 2 if hybrid else 6 + 2 * size, 3 + size) as track:
        if hybrid:
            passing = after_events(model, starts, returns, seen, track)
        else:
            begin = np.hstack([starts, np.full(starts.shape, len(names) ** -0.5), np.zeros((len(starts), 1))])
            passing = cut.varied.passing(cut.plane, begin, returns, longest=cut.longest, tolerance=SEEN, seen=seen,
                                         track=track)  # fmt: skip
        if not np.isfinite(passing.times).any():
            raise InputError(f"plane: no motion comes to {cut.name}; choose another plane, energy or direction")
    return made(passing)


@contextlib.contextmanager
def _track(path: Path | None, request: Mapping[str, Any], motions: int, crossings: int) -> Iterator[Track]:
    """The track in a journal; lines have so many columns."""
    with checkpoints(
        path, request,
        lambda entry: (unpacked(entry["motions"], motions), unpacked(entry["crossings"], crossings)),
    ) as journal:  # fmt: skip
        yield Track(
            journal.known, lambda where, rows: journal.add({"motions": packed(where), "crossings": packed(rows)})
        )


def _of(system: Model | Orbit | Problem, model: Model | None) -> tuple[Model, np.ndarray | None, str]:
    """A Model, a state to start from and a name."""
    if isinstance(system, Model):
        return system, None, str(system.system.get("function", system.system.get("kind", "section")))
    if isinstance(system, Problem):
        return system.model, system.guess.start, system.name
    return model or build_model(system.system), system.state, system.name


def _starts(cut: Surface, seeds: int, ranges: Mapping[str, Sequence[float]], state: np.ndarray | None) -> np.ndarray:
    """States (k x d) on the section that fill a box of its axes evenly, as far as motions are possible there."""
    model, names = cut.model, cut.axis_names
    for name, given in ranges.items():
        if name not in names:
            raise InputError(f"ranges: {name!r} is no axis{closest(name, names)}; the axes are {' and '.join(names)}")
        if len(given) != 2 or not (np.all(np.isfinite(given)) and given[0] < given[1]):
            raise InputError(f"ranges: {name} needs two growing numbers, got {', '.join(map(str, given))}")
    base = np.zeros(len(model.state_names)) if state is None else np.asarray(state, float).copy()
    if model.conservative and model.smooth:
        base[:] = 0.0  # or other coordinates of a motion elsewhere would be taken for those of the plane
    if cut.plane.component >= 0:
        base[cut.plane.component] = cut.plane.level
    box = _box(cut, base, ranges)
    states = np.zeros((0, base.size))
    for k in range(8):
        points = box[0] + (box[1] - box[0]) * _spread(max(seeds, 16) * 2**k)
        states = at_points(cut, base, points)
        states = states[np.isfinite(states).all(axis=1)]
        if len(states) >= seeds:
            return states[:seeds]
    if not len(states):
        raise InputError(
            f"energy: no motion of this energy crosses {cut.name}; choose another plane or energy, or give ranges"
        )
    return states


def _spread(count: int) -> np.ndarray:
    """Points (k x 2) that fill the unit square evenly, the more of them the denser.

    Source: M. Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018): multiples of 1/g and 1/g^2,
    g^3 = g + 1.
    """
    g = 1.32471795724474602596
    return (0.5 + np.arange(1, count + 1)[:, None] / [g, g * g]) % 1.0


def at_points(cut: Surface, base: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The states (k x d) of points (k x 2) of the axes, at the held energy; nan where no motion is possible.

    The rate that is found from the energy is that of the plane's own coordinate, in the direction that is looked at.
    """
    states = np.tile(base, (len(points), 1))
    states[:, list(cut.axes)] = points
    if not cut.levels:
        return states
    i = solved_component(cut)
    unit = cut.units[i]
    values = []
    for x in (-unit, 0.0, unit):  # energies are of the second degree in a rate or momentum; what is not is polished
        states[:, i] = x
        values.append(cut.invariants(states)[0][:, 0])
    low, c, high = values
    a, b = 0.5 * (high + low) - c, 0.5 * (high - low)
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - 4 * a * c)
    best = np.full_like(states, np.nan)
    for sign in (1.0, -1.0):
        with np.errstate(all="ignore"):
            states[:, i] = unit * (-b + sign * root) / (2 * a)
        there = cut.held(states, along=[i])
        good = np.isfinite(there).all(axis=1)
        good[good] = _rising(cut, there[good])
        best = np.where(good[:, None] & ~np.isfinite(best), there, best)
    return best


def _rising(cut: Surface, states: np.ndarray) -> np.ndarray:
    """Which states (k) cross the plane in the direction that is looked at."""
    plane = cut.plane
    if not len(states) or plane.component < 0:
        return np.ones(len(states), bool)
    rates = cut.motions.rates(np.zeros(len(states)), states)[:, plane.component]
    return rates * (plane.direction or 1) > 0


def solved_component(cut: Surface) -> int:
    """The component that is found from the energy: the rate or momentum of the plane's coordinate, or another one."""
    model, i = cut.model, cut.plane.component
    half = len(model.state_names) // 2
    conjugate = [half + i] if 0 <= i < half and (model.rates is None or model.hamiltonian) else []
    rates = range(half, 2 * half) if model.rates is None or model.hamiltonian else range(len(model.state_names))
    left = [j for j in (*conjugate, *rates) if j != i and j not in cut.axes]
    if not left:
        names = ", ".join(model.state_names[j] for j in (i, *cut.axes))
        raise InputError(f"axes: nothing is left to find from the energy beside {names}; choose other axes")
    return int(left[0])


def _box(cut: Surface, base: np.ndarray, ranges: Mapping[str, Sequence[float]]) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest values of the axes: those given, whole turns of angles, else as far as the energy allows."""
    model, names = cut.model, cut.axis_names
    angles = [i < model.degrees_of_freedom and bool(model.angular[i]) for i in cut.axes]
    fixed = {k: ranges[name] for k, name in enumerate(names) if name in ranges}
    fixed |= {k: (-np.pi, np.pi) for k in range(2) if angles[k] and k not in fixed}
    middle = base[list(cut.axes)]
    wide = 0.02 * cut.units[list(cut.axes)]
    low, high = middle - wide, middle + wide
    for k, (least, greatest) in fixed.items():
        low[k], high[k] = least, greatest
    free = [k for k in range(2) if k not in fixed]
    if not free:
        return low, high
    if not cut.levels:
        size = 1.5 * np.maximum(np.abs(middle), cut.units[list(cut.axes)])
        low[free], high[free] = -size[free], size[free]
        return low, high
    along = np.linspace(0.0, 1.0, 40)
    for _ in range(80):  # until no motion is possible on the border
        sides = []
        for k in free:
            for end in (low[k], high[k]):
                side = np.empty((along.size, 2))
                side[:, 1 - k] = low[1 - k] + along * (high - low)[1 - k]
                side[:, k] = end
                sides.append(side)
        if not np.isfinite(at_points(cut, base, np.vstack(sides))).any():
            return low, high
        wide = 1.15 * wide
        low[free], high[free] = (middle - wide)[free], (middle + wide)[free]
    raise InputError(
        f"ranges: missing; motions of this energy are not bounded on {cut.name}, give the range of "
        f"{' and '.join(names[k] for k in free)}"
    )


def after_events(
    model: Model, starts: np.ndarray, returns: int,
    seen: Callable[[Callable[[], Passing], int], None] = lambda *_: None, track: Track = NOWHERE,
) -> Passing:  # fmt: skip
    """The states of a hybrid system after the event that ends its cycle, or any event where it has no cycle.

    A line of the track is a start with the returns that it was asked for.
    """
    hybrid = model.hybrid
    last = hybrid.cycle[-1] if hybrid.cycle else None
    times, states = np.full((len(starts), returns), np.nan), np.full((len(starts), returns, starts.shape[1]), np.nan)
    known = {int(motion[0, 0]): rows for motion, rows in track.known if motion[0, 1] == returns}
    for k, start in enumerate(starts):
        if k not in known:
            after = list[np.ndarray]()
            with contextlib.suppress(IntegrationError):  # it has left: what was seen of it stays
                for arc in Automaton(model, SECOND).arcs(
                    start, hybrid.first.name, events=returns * max(1, len(hybrid.cycle))
                ):
                    if arc.ended_by is not None and last in (None, arc.ended_by) and len(after) < returns:
                        after.append(np.array([k, len(after), arc.times[-1], *arc.after]))
            known[k] = np.vstack([np.zeros((0, 3 + starts.shape[1])), *after])
            track.add(np.array([[k, returns]]), known[k])
        rows = known[k]
        times[k, : len(rows)], states[k, : len(rows)] = rows[:, 2], rows[:, 3:]
        seen(lambda: Passing(times, states), (k + 1) * returns)
    return Passing(times, states)


@dataclass(frozen=True)
class Pierced:
    """Where an orbit crosses a section in one period: moments (m, s since its first state) and states (m x d)."""

    moments: np.ndarray
    states: np.ndarray


def nodes_of(cut: Surface, orbit: Orbit) -> np.ndarray:
    """States (N x d) at equal times over an orbit's period: its nodes where each leads to the next, else its first.

    A motion from one state alone leaves an unstable orbit by its round-off.
    """
    nodes, count = np.asarray(orbit.nodes, float), len(orbit.nodes)
    if nodes.ndim != 2 or nodes.shape[1] != orbit.state.size or not np.array_equal(nodes[:1], orbit.state[None]):
        return orbit.state[None]
    spans = np.arange(count) * (orbit.period / count) if cut.model.forced else np.zeros(count)
    clock = Plane(-1, orbit.period / count, 0)
    ends = [
        cut.motions.passing(replace(clock, level=begin + clock.level), node[None], 1, longest=2 * clock.level,
                              tolerance=FINE, times=begin).states[0, 0]
        for node, begin in zip(nodes, spans, strict=True)
    ]  # fmt: skip
    gaps = wrapped(np.array(ends) - np.roll(nodes, -1, axis=0), cut.model.angular)
    # whether each leads to the next
    return nodes if np.abs(gaps / nonzero(np.abs(nodes).max(axis=0))).max() <= 1e-9 else orbit.state[None]


def check_plane(mine: Any, other: Any) -> None:
    """`InputError` unless two records (sections, manifolds, connections) lie on one plane with the same axes."""
    if (mine.plane.split(",")[0], tuple(mine.axes)) != (other.plane.split(",")[0], tuple(other.axes)):
        raise InputError(
            f"{mine.name}: plane: {mine.plane} with axes {', '.join(mine.axes)}, and {other.name} has {other.plane} "
            f"with {', '.join(other.axes)}; make both with one plane and axes"
        )


def crossings(model: Model, record: Any, orbit: Orbit) -> np.ndarray:
    """Where an orbit crosses the plane of a record in its axes (k x 2). Raises `InputError` where it does not."""
    cut = named_surface(model, record.plane, record.axes, state=orbit.state)
    return cut.chart(pierced(cut, orbit).states)


def pierced(cut: Surface, orbit: Orbit) -> Pierced:
    """Where an orbit crosses a section in one period. Raises `InputError` where it does not."""
    if not cut.model.smooth:
        return Pierced(np.zeros(1), check_states(cut.model, orbit.state[None]))
    nodes, plane, motions = nodes_of(cut, orbit), cut.plane, cut.motions
    span, close = orbit.period / len(nodes), 1e-9 * orbit.period
    begins, count = np.arange(len(nodes)) * span, 8
    while True:
        passing = motions.passing(plane, nodes, count, longest=1.5 * span, tolerance=FINE, times=begins)
        within = np.isfinite(passing.times) & (passing.times <= begins[:, None] + span + close)
        if not within[:, -1].any() or count > 10_000:
            break
        count *= 4
    rates = motions.rates(begins, nodes)
    i = plane.component
    own, going = (begins, np.ones(len(nodes))) if i < 0 else (nodes[:, i], rates[:, i])
    unit = orbit.period if i < 0 else float(cut.units[i])
    there = (plane.start(own, going, unit) != plane.start(own, -going, unit)) & (plane.direction * going >= 0)
    moments = np.concatenate([begins[there], passing.times[within] % orbit.period])
    states = np.vstack([nodes[there], passing.states[within]])
    kept: list[int] = []
    for k in range(len(moments)):  # those of nodes first: what comes to a node comes to it with its round-off
        apart = np.abs((moments[k] - moments[kept] + orbit.period / 2) % orbit.period - orbit.period / 2)
        if not kept or apart.min() > close:
            kept.append(k)
    if not kept:
        raise InputError(f"plane: {orbit.name} does not cross {cut.name}; choose another plane or direction")
    order = sorted(kept, key=lambda k: float(moments[k]))
    return Pierced(moments[order], states[order])
