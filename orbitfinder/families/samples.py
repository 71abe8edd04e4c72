"""What is read at one orbit between two points of a family, and the stretch between them as a curve to read from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.scale import span
from orbitfinder.families.stability import Spectrum, matching, spectrum
from orbitfinder.loops.continued import Curve, Solution, advanced, bend, correct, tangent
from orbitfinder.loops.loop import Condition, Unknowns

REAL = 1e-7
"""An index counts as real when its imaginary part is below this, relative to its size."""


@dataclass(frozen=True)
class Probe:
    """A corrected orbit between two points: distance from the first, tangent (over w), indices, their turns."""

    distance: float
    found: Solution
    whole: np.ndarray
    about: Spectrum
    indices: np.ndarray
    turns: np.ndarray
    slopes: dict[str, float]


@dataclass(frozen=True)
class Interval:
    """The stretch of a family between two corrected places on the same mesh.

    `seen` keeps every orbit that was computed inside it, by distance.
    """

    curve: Curve
    first: Probe
    last: Probe
    curvature: np.ndarray
    twist: np.ndarray
    seen: dict[float, Probe] = field(default_factory=dict, compare=False, repr=False)
    unit: float = 1.0
    """what arclengths are relative to (see `scale.span`)"""

    @property
    def length(self) -> float:
        """Arclength (measured along the first tangent)."""
        return self.last.distance

    @property
    def share(self) -> float:
        """The length relative to the motion."""
        return self.length / self.unit

    def probe(self, distance: float) -> Probe:
        """The orbit at a distance (along the first tangent) into the interval, corrected once."""
        if distance in (0.0, self.length):
            return self.last if distance else self.first
        if distance not in self.seen:
            self.seen[distance] = self.probed(distance)
        return self.seen[distance]

    def known(self) -> list[Probe]:
        """Every orbit that was computed, in order along the interval."""
        return [self.first, *(self.seen[distance] for distance in sorted(self.seen)), self.last]

    def probed(self, distance: float) -> Probe:
        """The same, computed."""
        first, curve = self.first, self.curve
        normal = curve.weights * first.found.place.head_of(first.whole)
        aim = Condition(float(normal @ first.found.place.head) + distance, normal)
        reach = max(0.5 * self.length, 1e-6 * self.unit)
        found = correct(curve, self.guess(distance), aim, first.found.place, reach, self.slope(distance))
        whole = tangent(curve, found, first.found.place.head_of(first.whole))
        probe = make_probe(curve, distance, found, whole, self.indices(distance))
        if probe.indices.shape != first.indices.shape:
            raise ConvergenceError("the orbit is a relative equilibrium, whose flow is one of its symmetries")
        return probe

    def guess(self, distance: float) -> Unknowns:
        """The cubic through both ends with both tangents."""
        bent = self.curvature + (distance - self.length) * self.twist
        return advanced(self.first.found.place, self.first.whole, distance, bent)

    def slope(self, distance: float) -> np.ndarray | None:
        """The Jacobian between those of the ends."""
        share, (a, b) = distance / self.length, (self.first.found.jacobian, self.last.found.jacobian)
        return np.asarray((1 - share) * a + share * b) if a.shape == b.shape else None

    def indices(self, distance: float) -> np.ndarray:
        """Indices between those of the ends."""
        share = distance / self.length
        return np.asarray((1 - share) * self.first.indices + share * self.last.indices)


def parameter_slopes(curve: Curve, place: Unknowns, head: np.ndarray) -> dict[str, float]:
    """d/ds of energy, period and every freed parameter along a direction over the head."""
    p, size = curve.equations, curve.equations.size
    _, slope, free = p.quantities_at(place.nodes[0], place.free)
    energy = float(slope[-1] @ head[:size] + free[-1] @ head[size + 1 :])
    slopes = {"energy": energy, "period": float(head[size])}
    slopes |= {name: float(head[size + 1 + k]) for k, name in enumerate(p.free)}
    return slopes | {name: float(head[k]) for k, name in enumerate(p.model.state_names)}


def make_probe(curve: Curve, distance: float, found: Solution, whole: np.ndarray, expected: np.ndarray) -> Probe:
    """Everything that the tests read, at one corrected place."""
    about = spectrum(curve, found)
    slopes = parameter_slopes(curve, found.place, found.place.head_of(whole))
    order = matching(expected, about.indices)
    return Probe(distance, found, whole, about, about.indices[order], about.turns[order], slopes)


def make_interval(curve: Curve, first: Probe, last: Probe) -> Interval:
    """The interval between two probes on one mesh.

    With w(d) = w0 + d t + d^2 c + d^2 (d - D) e, w(D) fixes c and the last tangent, taken per unit of d, fixes e.
    """
    curvature = bend(curve, first.found.place, first.whole, last.found.place)
    twist, length = np.zeros_like(curvature), last.distance
    along = float((curve.weights * first.found.place.head_of(first.whole)) @ last.found.place.head_of(last.whole))
    if last.whole.shape == first.whole.shape and along > 0.5:
        twist = (last.whole / along - first.whole - 2 * length * curvature) / length**2
    unit = span(curve.equations.model.angles, curve.weights, first.found.march.states)
    return Interval(curve, first, last, curvature, twist, unit=unit)


def is_real(value: complex) -> bool:
    """Whether an index counts as real."""
    return abs(value.imag) <= REAL * max(1.0, abs(value))


def real_indices(probe: Probe) -> np.ndarray:
    """Which indices count as real."""
    return np.array([is_real(one) for one in probe.indices], bool)
