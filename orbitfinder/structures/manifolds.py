"""Stable and unstable manifolds of an orbit: as curves on a section, and as tubes in the state space.

At the orbit's point x* on a section the manifold is tangent to the eigendirection u of the monodromy. It begins there
on

    x(s) = x* + s u, moved onto the values of the invariants,       s from d / |mu| to d (one fundamental domain),

which is off the manifold by e(s) = c s^2. The k-th return of x(s / |mu|^k) has forgotten its own error (returns
contract what is off the manifold), so that

    e(d) = |component off u of F(x(d / mu)) - x(d)|

is measured, at d and at d / 2, and d chosen for it. The curves of all returns are images of that domain; points are
added where neighbours are far apart or the curve turns. A stable manifold is the unstable one of the motion backwards
in time.

Sources: D. Hobson, "An efficient method for computing invariant manifolds of planar maps", J. Comput. Phys. 104
(1993) 14-22; W. Koon, M. Lo, J. Marsden, S. Ross, "Heteroclinic connections between periodic orbits and resonance
transitions in celestial mechanics", Chaos 10 (2000) 427-469.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import ConvergenceError, InputError, plural
from orbitfinder.integrate.equations import invariant_gradients
from orbitfinder.integrate.rk8 import variational_field
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, vector_field, wrapped
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.floquet import complement, generated
from orbitfinder.records.orbit import Orbit
from orbitfinder.structures.crossings import FINE, SEEN, Crossings, Passing, Plane
from orbitfinder.structures.manifold import WHICH, Manifold, reach
from orbitfinder.structures.sections import Surface, levels_at, nodes_of, pierced, surface


@dataclass(frozen=True)
class ManifoldSettings:
    """How a manifold is grown."""

    accuracy: float = 1e-9
    """error of the displaced points off the manifold, in extents of the orbit: the displacement is chosen for it"""
    spacing: float = 0.01
    """largest distance of neighbouring points, relative to the extent of all of them"""
    turning: float = 0.25
    """largest angle (rad) between neighbouring chords that are longer than a tenth of that"""
    points: int = 4000
    """most points of one curve"""
    first: int = 33
    """points of a fundamental domain to begin with"""
    halvings: int = 8
    """how often the distance between two of these is halved at most, towards a place where the curve is torn"""


@dataclass(frozen=True)
class Local:
    """The local manifold of an orbit on a section: its point, direction (of length 1 in extents), multiplier.

    `laps` returns of the section make one of the orbit (twice round where the multiplier is negative).
    """

    __repr__ = brief("multiplier", "laps")

    orbit: Orbit
    surface: Surface
    sense: int
    point: np.ndarray
    direction: np.ndarray
    multiplier: float
    laps: int
    extents: np.ndarray

    @property
    def growth(self) -> float:
        """By how much a displacement grows in `laps` returns."""
        lap = max(abs(self.multiplier), 1 / abs(self.multiplier))
        return float(lap if self.multiplier > 0 else lap**2)

    @cached_property
    def varied(self) -> Crossings:
        """What integrates motions with their variations, (x, vec Phi)."""
        return varied_motions(self.surface, self.extents)

    def states(self, places: np.ndarray) -> np.ndarray:
        """x(s) (k x d) on the plane at the held invariants."""
        return self.surface.held(self.point + np.asarray(places)[:, None] * self.direction)

    def returned(self, states: np.ndarray, count: int, tolerance: float = FINE) -> Passing:
        """The next crossings along the manifold."""
        longest = 20.0 * self.orbit.period  # or it has left
        motions, plane = self.surface.motions, self.surface.plane
        return motions.passing(plane, states, count, longest=longest, sense=self.sense, tolerance=tolerance)

    def error(self, place: float) -> float:
        """How far x(s) is off the manifold, in extents: against the return of x(s / growth)."""
        before = self.states(np.array([place / self.growth]))
        gap = self.returned(before, self.laps).states[:, -1] - self.states(np.array([place]))
        scaled, u = wrapped(gap, self.surface.model.angular) / self.extents, self.direction / self.extents
        away = float(np.linalg.norm(scaled - np.outer(scaled @ u, u) / (u @ u)))  # from the direction
        return float(away / (1.0 - self.growth**-3.0))

    def displacement(self, accuracy: float) -> tuple[float, float, float]:
        """d with an error of about the accuracy, its error, and that at d / 2. Raises `ConvergenceError`."""
        place = 1e-3  # in extents of the orbit
        for _ in range(12):
            error = self.error(place)
            if error <= accuracy * 1.5:
                break
            place *= max(0.5 * min(1.0, (accuracy / error) ** 0.5) * 1.9, 0.05) if np.isfinite(error) else 0.1
        half = self.error(place / 2)
        order = np.log2(nonzero(error) / nonzero(half))
        if not (error <= 1e-12 or order >= 1.5) or not np.isfinite(error):  # round-off, or that of a manifold
            raise ConvergenceError(
                f"displacement: {error:.2g} off the manifold at {place:.2g} and {half:.2g} at half of it, not of "
                "second order: its return loses too many digits to begin on; take one of the same family farther from "
                "where its period has no bound (continue it), or an orbit with smaller multipliers"
            )
        return place, error, half


def varied_motions(cut: Surface, units: np.ndarray) -> Crossings:
    """What integrates motions of a section's Model with their variations, measured in `units` (d)."""
    measures = np.concatenate([units, (units[:, None] / units[None, :]).ravel("F")])
    return Crossings(variational_field(vector_field(cut.model)), measures)


def local_manifold(orbit: Orbit, cut: Surface, which: str, number: int = 0, point: np.ndarray | None = None) -> Local:
    """The local manifold of an orbit at its first crossing of a section, or at the one nearest to `point`.

    `number` counts the multipliers outside (unstable) or inside the unit circle from the strongest. Raises
    `InputError`.
    """
    if which not in WHICH:
        raise InputError(f"which: must be unstable or stable, got {which!r}")
    model, sense = cut.model, WHICH[which]
    crossed = pierced(cut, orbit)
    units = extents_of(model, orbit.samples if len(orbit.samples) > 2 else crossed.states, orbit.period)
    nearest = 0 if point is None else int(np.linalg.norm((crossed.states - point) / units, axis=1).argmin())
    start, begin = crossed.states[nearest], float(crossed.moments[nearest])
    rate = vector_field(model)(0.0, start, [], []).full().ravel()
    monodromy = _monodromy(cut, orbit, begin, start, sense, units)
    multiplier, direction = _eigenpair(model, start, rate, monodromy, which, number)
    if cut.plane.component >= 0:
        direction = direction - rate * direction[cut.plane.component] / rate[cut.plane.component]
        direction[cut.plane.component] = 0.0
    direction = direction / float(np.linalg.norm(direction / units))
    across = direction[list(cut.axes)] / units[list(cut.axes)]
    direction *= 1.0 if across[int(np.abs(across).argmax())] > 0 else -1.0
    laps = len(crossed.moments) * (1 if multiplier > 0 else 2)
    return Local(orbit, cut, sense, start, direction, float(multiplier), laps, units)


def _monodromy(
    cut: Surface, orbit: Orbit, begin: float, start: np.ndarray, sense: int, units: np.ndarray
) -> np.ndarray:
    """Phi over a period (`sense` -1: backwards) from a crossing (d) at a moment, from node to node of the orbit."""
    size, period, nodes = start.size, orbit.period, nodes_of(cut, orbit)
    since = (sense * (np.arange(len(nodes)) * period / len(nodes) - begin)) % period
    order = [k for k in np.argsort(since) if 1e-9 * period < since[k] < (1 - 1e-9) * period]
    cuts = np.concatenate([[0.0], since[order], [period]])
    motions, total = varied_motions(cut, units), np.eye(size)
    for k, state in enumerate([start, *nodes[order]]):
        moment = begin + sense * cuts[k]
        clock = Plane(-1, sense * moment + cuts[k + 1] - cuts[k], 0)
        extended = np.concatenate([state, np.eye(size).ravel()])[None]
        end = motions.passing(clock, extended, 1, longest=2 * period, sense=sense, times=moment).states[0, 0]
        total = end[size:].reshape(size, size, order="F") @ total
    return total


def _eigenpair(
    model: Model, state: np.ndarray, rate: np.ndarray, monodromy: np.ndarray, which: str, number: int
) -> tuple[float, np.ndarray]:
    """A real multiplier that grows in the sense of the monodromy and its eigendirection (d). Raises `InputError`."""
    from_symmetries = generated(model, state)
    gradients = np.zeros((0, state.size))
    if model.invariants:
        gradients = invariant_gradients(model)(state).full()
    directions = np.vstack([*([] if model.forced else [rate]), from_symmetries]).reshape(-1, state.size)
    basis = complement(gradients, directions) if len(gradients) + len(directions) else np.eye(state.size)
    values, vectors = np.linalg.eig(basis.T @ monodromy @ basis)
    order = np.argsort(-np.abs(values))
    growing = [k for k in order if abs(values[k]) > 1 + 1e-3]  # what is nearer to 1 has no manifold
    shown = ", ".join(f"{z.real:.6g}" + (f"{z.imag:+.6g}i" if z.imag else "") for z in values[order])
    if not growing:
        raise InputError(
            f"which: the orbit has no {which} manifold, no multiplier is off the unit circle that way ({shown}); "
            "motions about it stay on tori, see `orbitfinder section`"
        )
    if number >= len(growing):
        raise InputError(f"number: the orbit has {plural(len(growing), 'multiplier')} that grow; count them from 0")
    chosen = growing[number]
    if abs(values[chosen].imag) > 1e-6 * abs(values[chosen]):  # or it is real
        raise InputError(
            f"which: the multiplier {values[chosen]:.6g} is complex, its manifold winds about the orbit and has no "
            "single direction; give another orbit, or number= of a real multiplier"
        )
    mu, w = float(values[chosen].real), basis @ vectors[:, chosen].real
    # Phi w = mu w + directions a, so that w + directions a / (mu - 1) is the eigenvector
    if len(directions):
        a = np.linalg.lstsq(directions.T, monodromy @ w - mu * w, rcond=None)[0]
        w = w + directions.T @ a / (mu - 1.0)
    return mu if which == "unstable" else 1.0 / mu, w


def manifold(
    orbit: Orbit,
    which: str = "unstable",
    *,
    plane: str | None = None,
    axes: Sequence[str] | None = None,
    direction: int = 1,
    returns: int = 2,
    side: int = 0,
    number: int = 0,
    tube: float | None = None,
    settings: ManifoldSettings | None = None,
    model: Model | None = None,
) -> Manifold:
    """The unstable or the stable manifold of an orbit, as curves on a section or as a tube.

    Args:
        orbit: an unstable one.
        which: unstable | stable.
        plane: a component and a number ("y=0"); the plane through the orbit's first state if None.
        axes: the two components that are drawn, as in `of.section`.
        direction: how the plane is crossed: 1 growing, -1 falling.
        returns: fundamental domains that are grown beyond the orbit's own size.
        side: of the orbit: 1 or -1; 0 both.
        number: counts the multipliers from the strongest, from 0.
        tube: s of motion: a tube in place of curves on a section.
        settings: how finely it is grown.
        model: needed only for systems that no file describes.

    Returns:
        A Manifold: its curves, the multiplier, the measured error of the displacement.

    Raises:
        InputError: for an orbit without such a multiplier and a plane that it does not cross.
        ConvergenceError: where the displacement's error cannot be met.

    Examples:
        >>> leaving = of.manifold(saddle, "unstable", plane="theta1=0", returns=1)
        >>> round(leaving.multiplier, 2)
        2809.62

    See Also:
        `of.connect` finds where two manifolds meet.
    """
    chosen = settings or ManifoldSettings()
    if side not in (-1, 0, 1):
        raise InputError(f"side: must be 1, -1 or 0 (both), got {side}")
    if not 0 <= returns <= 1000:
        raise InputError(f"returns: must be between 0 and 1000, got {returns}")
    if tube is not None and not (np.isfinite(tube) and tube > 0):
        raise InputError(f"tube: must be positive and finite, got {tube}; give a time in s")
    cut = surface_of(orbit, model, plane, axes, direction)
    base = local_manifold(orbit, cut, which, number)
    place, error, half = base.displacement(chosen.accuracy)
    sides = (1, -1) if side == 0 else (side,)
    if tube is not None:
        parts = _tube(base, place, tube, sides, chosen)
    else:
        parts = [part for way in sides for part in grown(base, way * place, returns, chosen)]
    return recorded(base, "curves" if tube is None else "tube", (place, error, half), parts)


def surface_of(
    orbit: Orbit, model: Model | None, plane: str | None, axes: Sequence[str] | None, direction: int
) -> Surface:
    """The section of an orbit's system at its own invariants. Raises `InputError` where it has no manifolds."""
    model = model or build_model(orbit.system)
    if not model.smooth:
        raise InputError("orbit: manifolds of hybrid systems are not grown; give the orbit of a smooth system")
    if model.constraint is not None:
        raise InputError(
            "orbit: manifolds under constraints are not grown; take of.linkages.minimal_linkage of a linkage"
        )
    if orbit.shift:
        raise InputError("orbit: it comes back only up to a shift, and is no orbit on a section; give one that closes")
    return surface(model, plane, axes, direction, levels=levels_at(model, orbit.state), state=orbit.state)


Part = tuple[np.ndarray, np.ndarray, int, np.ndarray]
"""States (k x d), their places (k), the return (of a tube -1) and times (k)"""


def recorded(base: Local, kind: str, measured: tuple[float, float, float], parts: Sequence[Part]) -> Manifold:
    """The Manifold of its parts."""
    cut, names = base.surface, base.surface.model.state_names
    if not parts:
        raise ConvergenceError(f"manifold: no point of it comes back to {cut.name}")
    states = np.vstack([part[0] for part in parts])
    return Manifold(
        base.orbit.name, dict(cut.model.system), names, "unstable" if base.sense > 0 else "stable", kind, cut.name,
        cut.axis_names, base.orbit.energy, base.multiplier, *measured, base.point,
        base.direction, states,
        np.concatenate([np.full(len(part[0]), k) for k, part in enumerate(parts)]),
        np.concatenate([part[1] for part in parts]),
        np.concatenate([np.full(len(part[0]), part[2]) for part in parts]),
        np.concatenate([part[3] for part in parts]), base.orbit.title,
    )  # fmt: skip


def grown(base: Local, place: float, returns: int, chosen: ManifoldSettings) -> list[Part]:
    """The fundamental domain that ends at a place, and its images until the displacement is as large as the orbit and
    `returns` more, with points where they are wanted."""
    away = int(np.ceil(-np.log(abs(place)) / np.log(base.growth)))
    table, images = _Table(base, place), (away + returns) * base.laps
    table.add(np.linspace(0.0, 1.0, chosen.first))
    for image in range(images + 1):
        _filled(table, image, chosen)
        if image < images:
            table.extend()
    return [part for image in range(images + 1) for part in table.parts(image, chosen)]


class _Table:
    """Points of a fundamental domain (by their share of it) with their returns so far."""

    def __init__(self, base: Local, place: float) -> None:
        self.base, self.place = base, place
        self.shares, self.states = np.zeros(0), np.zeros((0, 1, base.point.size))
        self.times = np.zeros((0, 1))

    def places(self, shares: np.ndarray) -> np.ndarray:
        """Displacements of shares of the domain."""
        return self.place * self.base.growth ** (shares - 1.0)

    def add(self, shares: np.ndarray) -> None:
        """More points, in their order."""
        start, images = self.base.states(self.places(shares)), self.states.shape[1] - 1
        passing = self.base.returned(start, images, SEEN)
        states = np.concatenate([start[:, None], passing.states], axis=1)
        times = np.concatenate([np.zeros((len(start), 1)), passing.times], axis=1)
        order = np.argsort(np.concatenate([self.shares, shares]), kind="stable")
        self.shares = np.concatenate([self.shares, shares])[order]
        self.states = np.concatenate([self.states, states])[order]
        self.times = np.concatenate([self.times, times])[order]

    def extend(self) -> None:
        """One more return of all points."""
        passing = self.base.returned(self.states[:, -1], 1, SEEN)
        self.states = np.concatenate([self.states, passing.states], axis=1)
        self.times = np.concatenate([self.times, self.times[:, -1:] + passing.times], axis=1)

    @cached_property
    def angular(self) -> np.ndarray:
        """Which components turn."""
        return self.base.surface.model.angular

    def scale(self) -> np.ndarray:
        """Extents of what has been seen on the axes (2), but for the few points that are far out, beside collisions."""
        count = self.states.shape[1]
        chart = self.base.surface.chart(self.states.reshape(-1, self.states.shape[2]))
        own = self.base.extents[list(self.base.surface.axes)]
        low, high = reach(chart, np.repeat(np.gradient(self.shares), count))
        return np.asarray(np.maximum(high - low, own))

    def gaps(self, image: int) -> np.ndarray:
        """Chords (k - 1 x 2) between neighbours in units of the scale; nan where one of them has left."""
        steps = np.diff(self.states[:, image], axis=0)
        return np.asarray(wrapped(steps, self.angular)[:, list(self.base.surface.axes)] / self.scale())

    def parts(self, image: int, chosen: ManifoldSettings) -> list[Part]:
        """The unbroken curves of a return."""
        lengths = np.linalg.norm(self.gaps(image), axis=1)
        known = np.asarray(np.isfinite(self.states[:, image]).all(axis=1))
        torn = np.logical_not(lengths <= 2 * chosen.spacing)
        curves = []
        for run in np.split(np.arange(self.shares.size), np.flatnonzero(torn) + 1):
            run = run[known[run]]
            if run.size > 1:
                places = self.places(self.shares[run])
                curves.append((self.states[run, image], places, image, self.times[run, image]))
        return curves


def _filled(table: _Table, image: int, chosen: ManifoldSettings) -> None:
    """Points are added to a domain until one of its returns is a smooth curve."""
    closest = 2.0**-chosen.halvings / (chosen.first - 1)
    while table.shares.size < chosen.points:
        chords = table.gaps(image)
        lengths = np.linalg.norm(chords, axis=1)
        with np.errstate(all="ignore"):
            cosines = (chords[1:] * chords[:-1]).sum(axis=1) / (lengths[1:] * lengths[:-1])
        bent = np.arccos(np.clip(cosines, -1.0, 1.0)) > chosen.turning
        sharp = np.zeros(lengths.size, bool)
        sharp[1:] |= bent
        sharp[:-1] |= bent
        wanted = (lengths > chosen.spacing) | (sharp & (lengths > 0.05 * chosen.spacing))
        known = np.asarray(np.isfinite(table.states[:, image]).all(axis=1))
        wanted |= known[1:] != known[:-1]  # up to where the motion first leaves
        spans = np.diff(table.shares)
        wanted &= spans > closest
        if not wanted.any():
            return
        middles = (table.shares[:-1] + 0.5 * spans)[wanted]
        table.add(middles[: max(1, chosen.points - table.shares.size)])


def _tube(base: Local, place: float, duration: float, sides: Sequence[int], chosen: ManifoldSettings) -> list[Part]:
    """Motions (a curve each) that leave the orbit all around it, more of them where they part."""
    count = 201
    phases, moments = np.linspace(0.0, 1.0, 49), np.linspace(0.0, duration, count)
    parts = []
    for side in sides:
        known, paths = np.zeros(0), np.zeros((0, count, base.point.size))
        wanted = phases
        while wanted.size and known.size < chosen.points // 10:
            start = _around(base, side * place, wanted)
            more = base.surface.motions.along(start, moments, sense=base.sense)
            order = np.argsort(np.concatenate([known, wanted]), kind="stable")
            known, paths = np.concatenate([known, wanted])[order], np.concatenate([paths, more])[order]
            extent = np.maximum(np.nanmax(paths, axis=(0, 1)) - np.nanmin(paths, axis=(0, 1)), base.extents)
            apart = np.abs(np.diff(paths, axis=0) / extent).max(axis=(1, 2))
            far = (apart > 10 * chosen.spacing) & (np.diff(known) > 1e-5)
            wanted = (0.5 * (known[1:] + known[:-1]))[far]
        for path in paths:
            good = np.isfinite(path).all(axis=1)
            parts.append((path[good], np.full(int(good.sum()), side * place), -1, base.sense * moments[good]))
    return parts


def _around(base: Local, place: float, phases: np.ndarray) -> np.ndarray:
    """States (k x d) displaced by a place along the manifold's direction all around the orbit."""
    size, period = base.point.size, base.orbit.period
    begin = np.concatenate([base.point, np.eye(size).ravel()])[None]
    order = np.argsort(phases)
    moments = np.concatenate([[0.0], period * np.maximum(phases[order], 1e-12)])
    path = base.varied.along(begin, np.maximum.accumulate(moments), tolerance=FINE, sense=base.sense)[0, 1:]
    matrices = path[:, size:].reshape(len(phases), size, size).transpose(0, 2, 1)
    slope = np.log(abs(base.multiplier)) * base.sense
    moved = (matrices @ base.direction) * np.exp(-slope * phases[order])[:, None]
    states = np.empty((len(phases), size))
    states[order] = path[:, :size] + place * moved
    return states
