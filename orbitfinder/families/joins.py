"""Where a family joins one of more symmetry or of a shorter period: seen coming, and solved for on the family joined.

What the joined family keeps, a map S after a part of the period, makes d(t) = S x(t) - x(t + T/k) of an orbit beside
it. Along the branch d passes 0 where a multiplier of the joined family's root map is a root of 1: that orbit is found
in that family's own formulation, whose equations are regular there, whichever side it is come from.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import gcd

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.families.branches import symmetric
from orbitfinder.families.codimension_two import Critical
from orbitfinder.families.motion import interpolated
from orbitfinder.families.point import freed, parameter_value
from orbitfinder.families.rest import predicted
from orbitfinder.families.run import Sample, Walked, parameter_slopes
from orbitfinder.families.stability import spectrum
from orbitfinder.families.start import Start, corrected, curve_at, reformulated, symmetry_of
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import Curve, Solution, advanced, correct, plane, tangent
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.symmetry import Involution, called, involutions, named
from orbitfinder.mechanics.model import wrapped
from orbitfinder.mechanics.scales import lasting, measured
from orbitfinder.records.family import End
from orbitfinder.records.reading import finite

EVEN = (2, 4, 6)
"""So many times shorter may be the period of a family about which another one is its own mirror image: behind one of an
odd share, such as a third, it goes on as another branch."""
SAMPLED = 480
"""Samples over a period, divisible by every `parts`"""
BESIDE = (1e-4, 0.5)
"""d relative to the motion: above what cubics between the steps are off, and beside another family."""
MOST_SECANT = 16
FIRST, FARTHEST, SOLVED, STALLED = 1e-3, 1.0, 1e-12, 1e-6
"""Arclengths along the joined family: of the first difference, how far the join may be, of the last step, and of one
after which steps that become no shorter are round-off"""
KNOWN = 1e-13
"""What multipliers of order one, and parameters, are known to."""


@dataclass(frozen=True)
class Invariance:
    """What a joined family keeps: it repeats after 1/`parts` of the period, by `involution` in its image."""

    parts: int
    involution: Involution | None = None

    @property
    def covers(self) -> int:
        """How many times shorter the joined period is."""
        return self.parts if self.involution is None else 1

    def gaps(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """d of samples (k+1 x d) over a period."""
        later = (len(states) - 1) // self.parts % (len(states) - 1)
        here = states[: len(states) - 1 - later]
        image = here if self.involution is None else here @ self.involution.matrix(angles.size).T
        return wrapped(image - states[later : later + len(here)], angles)

    def joined(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """The samples over the joined period that those of an orbit beside it become by the mean over their images."""
        count = len(states) - 1
        if self.involution is not None:
            later = np.roll(states[:-1], -(count // self.parts), axis=0)
            image = states[:-1] + wrapped(later @ self.involution.matrix(angles.size).T - states[:-1], angles) / 2
            return np.vstack([image, image[:1] + states[-1] - states[0]])
        drift = np.linspace(0.0, 1.0, count + 1)[:, None] * (states[-1] - states[0])
        image = (states - drift)[:-1].reshape(self.parts, count // self.parts, -1).mean(axis=0)
        return np.asarray(np.vstack([image, image[:1]]) + drift[: len(image) + 1])


@dataclass(frozen=True)
class Join:
    """The orbit at which a family is joined, on that family's curve, and the error bar of the parameter."""

    curve: Curve
    solution: Solution
    value: float
    error: float
    kept: Invariance
    regular: Solution


def joinable(curve: Curve) -> list[Invariance]:
    """What families that this one is its own mirror image about may keep."""
    p = curve.equations
    if not p.plain or curve.test:
        return []
    parts = [Invariance(k) for k in EVEN if not any(turn % k for turn in curve.turns) and not curve.cycles % k]
    if p.symmetry.forward is not None:
        return parts
    forward = [involution for involution in involutions(p.model) if involution.sense > 0]
    return parts + [Invariance(count, involution) for involution in forward for count in (1, 2)]


def sampled(curve: Curve, solution: Solution) -> np.ndarray:
    """States at equal times over the whole period of an orbit."""
    if "samples" not in solution.kept:
        solution.kept["samples"] = _sampled(curve, solution.place, solution.march.states)
    samples: np.ndarray = solution.kept["samples"]
    return samples


def about_mean(curve: Curve, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Samples less their mean (k x d), and the sums of the squares (d) of what is left."""
    if "about_mean" not in solution.kept:
        states = sampled(curve, solution)[:-1]
        away = states - states.mean(axis=0)
        solution.kept["about_mean"] = away, np.einsum("kd,kd->d", away, away)
    known: tuple[np.ndarray, np.ndarray] = solution.kept["about_mean"]
    return known


def _sampled(curve: Curve, place: Unknowns, states: np.ndarray) -> np.ndarray:
    """The same of states at the mesh."""
    p = curve.equations
    mesh, states = p.symmetry.whole(place.mesh, states, curve.constant)
    slopes = p.march.rates(states, place.tail, mesh * place.period) * place.period
    return interpolated(mesh, states, slopes, np.linspace(0.0, 1.0, SAMPLED + 1))


def _beside(curve: Curve, solution: Solution) -> list[tuple[Invariance, np.ndarray, float]]:
    """What an orbit nearly keeps, d, and its size relative to the motion's."""
    if "beside" not in solution.kept:
        states, angles = sampled(curve, solution), curve.equations.model.angular
        away = nonzero(float((about_mean(curve, solution)[1] / curve.units**2).mean()) / SAMPLED)
        gaps = [(kept, kept.gaps(states, angles) / curve.units) for kept in joinable(curve)]
        solution.kept["beside"] = [
            (kept, gap, float(np.sqrt(np.vdot(gap, gap) / gap.size / away))) for kept, gap in gaps
        ]
    beside: list[tuple[Invariance, np.ndarray, float]] = solution.kept["beside"]
    return beside


def _held(curve: Curve, kept: Invariance, states: np.ndarray) -> bool:
    """Whether the equations keep it, and not only a motion: asked at states of an orbit beside."""
    p = curve.equations
    if kept.involution is None:
        return True
    symmetry = called(replace(p.symmetry, maps=(kept.involution,)), p.model)
    cycles = max(curve.cycles // kept.covers, 1)
    return all(symmetry.held_by(p.model, states[k], cycles) for k in (0, SAMPLED // 5, SAMPLED // 2))


def approaching(curve: Curve, sample: Sample, length: float) -> Iterator[tuple[Invariance, float, float]]:
    """The families that might be joined: what they keep, how far ahead, and how far the orbit is beside them."""
    here = sampled(curve, sample.solution)
    near = [
        one for one in _beside(curve, sample.solution) if BESIDE[0] < one[2] < BESIDE[1] and _held(curve, one[0], here)
    ]
    if not near:
        return
    place, path = predicted(curve, sample, length)
    states = _sampled(curve, place, path)
    for kept, gaps, size in near:
        later = kept.gaps(states, curve.equations.model.angular) / curve.units
        share = float((later * gaps).sum() / (gaps**2).sum())
        if share < 1.0:
            yield kept, length / (1.0 - share), size


def passed(curve: Curve, before: Solution, after: Solution) -> bool:
    """Whether a family was joined between two orbits: the second one keeps what the first did not, or is its image."""
    first = sampled(curve, before)
    for (kept, here, size), (_, there, left) in zip(_beside(curve, before), _beside(curve, after), strict=True):
        turned = BESIDE[0] < min(size, left) and max(size, left) < BESIDE[1]
        if turned:
            turned = bool(np.vdot(here, there) < -0.5 * np.linalg.norm(here) * np.linalg.norm(there))
        # share of the lower bound that d is below where it is only what cubics are off
        if (turned or (size > BESIDE[0] and left < 0.2 * BESIDE[0])) and _held(curve, kept, first):
            return True
    return False


def solved(curve: Curve, solution: Solution, name: str, kept: Invariance, symmetry: str = "") -> Join | None:
    """The orbit at which a family beside an orbit, that keeps so much, is joined; `name` is the parameter.

    One that keeps another `symmetry`, which reverses time, is begun as that orbit in its formulation.
    """
    try:
        if symmetry:
            here = Start(curve, solution, solution.place.head)
            start: Start | None = reformulated(here, named(symmetry, curve.equations.model))
        else:
            start = _beside_join(curve, solution, kept)
        return None if start is None else _critical(symmetric(start), name, kept)
    except (ConvergenceError, IntegrationError, InputError, np.linalg.LinAlgError):
        return None


def _beside_join(curve: Curve, solution: Solution, kept: Invariance) -> Start | None:
    """The orbit of the joined family at the parameter's value of one beside it, begun as the mean over its images."""
    p, place = curve.equations, solution.place
    symmetry = p.symmetry
    if kept.involution is not None and kept.parts == 2:
        symmetry = called(replace(symmetry, maps=(kept.involution,)), p.model)
    states = kept.joined(sampled(curve, solution), p.model.angular)
    if not symmetry.held_by(p.model, states[0], max(curve.cycles // kept.covers, 1)):
        return None
    equations = Equations.of(p.model, symmetry, p.free, p.by)
    part = round((len(states) - 1) * symmetry.fraction)
    count = next(k for k in (8, 6, 5, 4, 3, 2, 1) if part % k == 0)
    # Runge-Kutta steps in a segment of the first guess of the joined orbit
    mesh = uniform(symmetry.fraction, count, 20)
    fresh = equations.unknowns(states[: part : part // count], place.period / kept.covers, mesh, place.free)
    held = {condition.name: condition.value for condition in curve.kept}
    if "period" in held:
        held["period"] /= kept.covers
    there = curve_at(equations, fresh, tuple(held), np.array(curve.turns) // kept.covers, held)
    return corrected(there, fresh, pinned(equations, p.parameter, parameter_value(curve, place, p.parameter)))


def _critical(start: Start, name: str, kept: Invariance) -> Join | None:
    """Along the joined family to where the multiplier with which the branch leaves is a root of 1, by secants."""
    curve, base = start.curve, start.solution
    about, whole = spectrum(curve, base), tangent(curve, base, start.direction)
    order = about.root * kept.covers
    roots = [np.exp(2j * np.pi * j / order) for j in range(order) if gcd(j, kept.covers) == 1]
    critical = min(roots, key=lambda root: np.abs(about.values - root).min(initial=np.inf))
    # a multiplier of the joined family is this near to the critical one beside the join
    if not np.abs(about.values - critical).min(initial=np.inf) < 0.5:
        return None
    test, place = Critical("branch_point", (name, name), multiplier=complex(critical)), base.place

    def at(distance: float) -> tuple[Solution, float]:
        guess, aim = advanced(place, whole, distance), plane(curve, place, whole, distance)
        solution = correct(curve, guess, aim, place, reach=1.0 + abs(distance))
        return solution, float(test(curve, [solution])[0])

    (known, low), here, last, moved = (base, float(test(curve, [base])[0])), FIRST, 0.0, np.inf
    for _ in range(MOST_SECANT):
        known, value = at(here)
        slope = (value - low) / (here - last)
        step = -value / slope if slope else np.nan
        if not abs(here + step) < FARTHEST:
            return None
        if abs(step) < SOLVED or moved < min(STALLED, 2 * abs(step)):
            break
        last, low, here, moved = here, value, here + step, abs(step)
    else:
        return None
    rate = parameter_slopes(curve, known.place, known.place.head_of(tangent(curve, known, whole)))[name]
    value = parameter_value(curve, known.place, name)
    error = abs(rate) * (abs(step) + max(about.blur, KNOWN) / abs(slope)) + KNOWN * abs(value)
    return Join(curve, known, value, error, kept, base)


def agrees(join: Join, before: Walked, away: float, name: str) -> bool:
    """Whether a step may come to a join: parameter and period are as near to its own as they change on the way."""
    slopes = before.sample.slopes
    left = [join.value - before.point.value, join.solution.place.period * join.kept.covers - before.point.period]
    allowed = [3 * away * abs(slopes[quantity]) for quantity in (name, "period")]
    least = [join.error + 1e-9 * abs(join.value), 1e-9 * before.point.period]
    # largest error bar of a join, relative to the parameter
    told = join.error < 1e-6 * max(abs(join.value), abs(before.point.value))
    return told and all(abs(off) <= most + floor for off, most, floor in zip(left, allowed, least, strict=True))


def end_of(join: Join, more: str = "") -> End:
    """The end of a family at a join, with the family that is joined."""
    curve, place = join.curve, join.solution.place
    symmetry = symmetry_of(curve, join.solution)
    alone = join.kept.involution is not None and join.kept.parts == 1
    what = "that is its own mirror image" if alone else f"of symmetry {symmetry}"
    what = what if join.kept.covers == 1 else f"of period T/{join.kept.covers}"
    system, names = curve.equations.model.system, curve.equations.physical or ("energy",)
    where = ", ".join(f"{name} {measured(parameter_value(curve, place, name), name, system, 12)}" for name in names)
    period = place.period * join.kept.covers
    orbit = join.regular.place if alone else place  # at the join itself both families meet in one formulation
    joined = {
        "state": orbit.nodes[0].tolist(), "period": float(orbit.period), "symmetry": curve.equations.symmetry.name,
        "winding": list(curve.turns), "free": freed(curve, orbit),
        "energy": finite(parameter_value(curve, orbit, "energy")),
    }  # fmt: skip
    reason = f"joins a family {what} at {where}, period {lasting(period, system)}{more}"
    return End("merged", reason, join.value, float(period), float(join.error), joined)
