"""Same orbit or another? A signature for the look-up and a phase-aligned distance as the judge.

Energy, minimal period and action do not depend on where on the loop an orbit starts, on reflection
(q, v) -> (-q, -v) or on time reversal (q, v, t) -> (q, -v, -t); orbits that agree in them are then
laid over each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.loops.symmetry import USUAL
from orbitfinder.mechanics.hybrid import as_recorded
from orbitfinder.mechanics.model import Model, between, wrapped
from orbitfinder.mechanics.scales import alone
from orbitfinder.orbits.certify import shown
from orbitfinder.orbits.course import course, sampled
from orbitfinder.orbits.measure import dense
from orbitfinder.records.orbit import Orbit, level, unconserved

Numbers = tuple[float, float, float]
"""Energy (J), minimal period (s) and |action| (J s) of an orbit: what its images share."""
LOOP_SAMPLES = 512
"""States that a signature keeps of its loop."""
ARC_SAMPLES = 16
"""States that it keeps of each arc of a hybrid orbit."""
AGREEMENT, DISTANCE = 1e-7, 5e-3
"""By less than this energy, period and action of an orbit met twice differ, relative, and its loops, phases aligned,
relative to the motion's extent; interpolated rates err by 1e-3."""
LEAST = 1e-3
"""Share of how far angles move, a radian for each length, that other coordinates count as at least, and vice versa."""


@dataclass(frozen=True)
class Signature:
    """What an orbit is recognised by: energy (J, 0 where none is conserved), minimal period (s), |action| (J s), loop.

    `loop` holds `LOOP_SAMPLES` states (k x d) at equal times over the period, without the closing
    one; `angles` says which coordinates (n, of a first-order system d) count modulo 2 pi. Of a hybrid orbit it holds
    `ARC_SAMPLES` at equal times in each of its `arcs`, from after one event to before the next.
    """

    energy: float
    period: float
    action: float
    loop: np.ndarray
    angles: tuple[bool, ...]
    arcs: int = 0
    parameters: str = ""
    """those that are not the system's own, as an atlas keeps them"""

    @property
    def numbers(self) -> Numbers:
        """Energy, period and |action|."""
        return self.energy, self.period, self.action

    @property
    def bins(self) -> tuple[int, int]:
        """Quantised period and action: the key of the look-up, with its neighbours."""
        return quantised(self.period), quantised(self.action)


def turning_points(signature: Signature) -> tuple[int, ...]:
    """How often each coordinate (n) of a smooth orbit turns back in a period, of a first-order system each component.

    The numbers are the same for every image of a loop: signs of the rates at `LOOP_SAMPLES` times, round the loop.
    """
    n, loop = len(signature.angles), signature.loop
    rates = loop[:, n:]
    if not rates.size:
        rates = wrapped(np.roll(loop, -1, axis=0) - loop, signature.angles)
        scale = np.abs(rates).max(axis=0)
    else:
        scale = _extents(loop, signature.angles)[n:]
    moving = [rate[np.abs(rate) > 1e-6 * unit] for rate, unit in zip(rates.T, scale, strict=True)]
    return tuple(int(np.sum(np.sign(rate) != np.sign(np.roll(rate, 1)))) for rate in moving)


def in_words(orbit: Orbit, signature: Signature) -> str:
    """The symbolic signature of an orbit: turning points of its coordinates, and whole turns where there are any, such
    as `2 4` or `0 2 turns 1 0`; of a hybrid orbit its events, begun where that comes first in the alphabet.
    """
    if signature.arcs:
        events = list(orbit.system["cycle"])
        return " ".join(min(events[k:] + events[:k] for k in range(len(events))))
    told = " ".join(map(str, turning_points(signature)))
    whole = max(orbit.winding, tuple(-k for k in orbit.winding))
    return told + (f" turns {' '.join(map(str, whole))}" if any(whole) else "")


def quantised(value: float) -> int:
    """The bin of a number; d asinh(x) = dx / sqrt(1 + x^2), so that `agree` is never wider than one bin.

    Bins are wider than `AGREEMENT`.
    """
    return int(np.floor(np.arcsinh(value) / 1e-6))


def neighbours(bins: tuple[int, int]) -> tuple[list[int], list[int]]:
    """The bins of period and of action in which an orbit that agrees with one of these bins can be."""
    period, action = bins
    return [period - 1, period, period + 1], [action - 1, action, action + 1]


def signature_of(orbit: Orbit, model: Model) -> Signature:
    """The signature of an orbit over its minimal period; integrated again when it carries no samples."""
    given = shown(orbit, model)
    if not model.smooth:
        model = as_recorded(model, orbit.system)
        pieces = course(model, *(given or sampled(model, orbit.state, orbit.period))).pieces
        moments, n = np.linspace(0.0, 1.0, ARC_SAMPLES), model.degrees_of_freedom
        loop = [between(each.times, each.states, n, each.times[0] + moments * np.ptp(each.times)) for each in pieces]
        return Signature(
            energy=orbit.energy if model.invariants and orbit.control is None else 0.0,
            period=orbit.period,
            action=abs(orbit.action),
            loop=np.vstack(loop),
            angles=tuple(map(bool, model.angular)),
            arcs=len(pieces),
        )
    times, samples = given or dense(build_flow(model, (), model.invariants), orbit.nodes, orbit.period)
    return Signature(
        energy=0.0 if model.forced or orbit.control else level(orbit.energy) if unconserved(orbit) else orbit.energy,
        period=orbit.period,
        action=abs(orbit.action),
        loop=resampled(times, samples, model.degrees_of_freedom),
        angles=tuple(map(bool, model.angular)),
    )


def resampled(times: np.ndarray, states: np.ndarray, n: int) -> np.ndarray:
    """`LOOP_SAMPLES` states at equal times of a period whose states at other equal times are given, its end too."""
    return between(times, states, n, np.arange(LOOP_SAMPLES) * float(times[-1]) / LOOP_SAMPLES)


def same_orbit(first: Signature, second: Signature) -> bool:
    """True when two signatures belong to one orbit up to phase, reflection and time reversal."""
    same = first.parameters == second.parameters
    return same and agree(first, second) and any(gap < DISTANCE for gap in _gaps(first, second))


def agree(first: Signature, second: Signature) -> bool:
    """Energy, period and action agree to `AGREEMENT`."""
    return among(first.numbers, second.numbers)


def among(known: ArrayLike, numbers: Numbers) -> bool:
    """Whether energy, period and |action| agree to `AGREEMENT` with those of a known orbit (k x 3)."""
    known = np.reshape(known, (-1, 3))
    scale = np.maximum(np.abs(known), np.abs(numbers))
    scale[:, 0] = np.maximum(scale[:, 0], scale[:, 2] / scale[:, 1])  # mean of twice the kinetic energy: V has no zero
    return bool(np.any(np.all(np.abs(known - numbers) <= AGREEMENT * scale, axis=1)))


def distance(first: Signature, second: Signature) -> float:
    """Largest gap between two loops at equal times, phases aligned, at its least over the images of the second.

    Relative to the extents of coordinates and rates; angles modulo 2 pi.
    """
    return min(_gaps(first, second), default=np.inf)


def _gaps(first: Signature, second: Signature) -> Iterator[float]:
    """The same for each image and phase that may be the one, the likely ones first."""
    if first.loop.shape != second.loop.shape:
        return
    n = len(first.angles)
    scale = _extents(first.loop, first.angles)
    if first.arcs:
        for k in range(first.arcs):
            image = np.roll(second.loop, ARC_SAMPLES * k, axis=0)
            yield float(np.abs(wrapped(image - first.loop, first.angles) / scale).max())
    else:
        yield from _aligned(first, list(images(second.loop, n)), scale)


def images(loop: np.ndarray, n: int) -> Iterator[np.ndarray]:
    """The loop, its reflection, its time reversal and both (k x 2n each); of a first-order system the loop alone."""
    yield loop
    for mirror in USUAL if n < loop.shape[1] else ():
        image = loop @ mirror.matrix(n).T
        yield image if mirror.sense > 0 else np.roll(image[::-1], 1, axis=0)


def _extents(loop: np.ndarray, angles: Sequence[bool]) -> np.ndarray:
    """One scale (2n) for angles, at most pi, one for other coordinates, and likewise for rates; of a first-order state
    each component's own.

    What hardly moves beside the others is measured in `LEAST` of what they move, a radian for each of their lengths or
    the other way round, and its rate by the clock of what does.
    """
    n, turning = len(angles), np.asarray(angles, bool)
    if n == loop.shape[1]:
        return alone(np.ptp(loop, axis=0), turning)
    sizes = np.concatenate([np.ptp(loop[:, :n], axis=0), np.abs(loop[:, n:]).max(axis=0)])
    lengths = float(np.abs(loop[:, :n])[:, ~turning].max(initial=0.0))
    bent, stretched = (float(sizes[:n][group].max(initial=0.0)) for group in (turning, ~turning))
    beside = LEAST * min(stretched / nonzero(lengths), 1.0), LEAST * lengths * min(bent, 1.0)
    for group, least in ((turning, beside[0]), (~turning, beside[1])):
        for half, floor in ((sizes[:n], least), (sizes[n:], 0.0)):
            half[group] = nonzero(max(float(half[group].max(initial=0.0)), floor))
    clock = float(np.max(sizes[n:] / sizes[:n]))
    sizes[n:] = np.maximum(sizes[n:], LEAST * clock * sizes[:n])
    return np.concatenate([np.where(turning, np.minimum(sizes[:n], np.pi), sizes[:n]), sizes[n:]])


def _aligned(first: Signature, loops: Sequence[np.ndarray], scale: np.ndarray) -> Iterator[float]:
    """The gaps of images at the phases where they pass the first state of the other loop, the nearest pass first.

    The phase is looked for among the samples, then between them by Gauss-Newton steps on the gap to that
    state, and the shifted image is compared with the whole loop.
    """
    count, n = len(first.loop), len(first.angles)
    gaps = np.abs(wrapped(np.array(loops) - first.loop[0], first.angles) / scale).max(axis=2)
    nearest, grid = np.argsort(gaps, axis=1)[:, :3], np.arange(count) * first.period / count
    paths = [lru_cache(maxsize=1)(partial(_path, image, first.period, n, first.angles)) for image in loops]
    for which, rank in np.argwhere(nearest >= 0)[np.argsort(np.take_along_axis(gaps, nearest, axis=1), axis=None)]:
        path, moment, apart = paths[which](), float(grid[nearest[which, rank]]), first.period / count / 4
        for _ in range(4):
            before, here, after = path(np.array([moment - apart, moment, moment + apart]))
            chord = wrapped(after - before, first.angles) / scale / 2
            gap = wrapped(first.loop[0] - here, first.angles) / scale
            step = float(chord @ gap / nonzero(chord @ chord))
            moment += apart * float(np.clip(step, -4.0, 4.0))
        moved = path(grid + moment)
        yield float(np.abs(wrapped(moved - first.loop, first.angles) / scale).max())


def _path(loop: np.ndarray, period: float, n: int, angles: Sequence[bool]) -> Callable[[np.ndarray], np.ndarray]:
    """States (k x 2n) of a closed loop at any times (k), by Hermite splines through its unwrapped coordinates."""
    closed = np.vstack([loop, loop[:1]])
    steps = wrapped(np.diff(closed, axis=0), angles)
    whole = closed[0] + np.vstack([np.zeros((1, loop.shape[1])), np.cumsum(steps, axis=0)])
    times = np.linspace(0.0, period, len(whole))
    if n == loop.shape[1]:
        through = CubicSpline(times, whole)
        return lambda moments: np.asarray(through(moments % period))
    return lambda moments: between(times, whole, n, moments % period)
