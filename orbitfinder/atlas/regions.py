"""Where searches of first-order and of forced systems start: on a level set of what is conserved, or on what attracts
motions.

Neither has a kinetic energy that velocities could be drawn from. A level set I = E is met by rays from equilibria, and
within the fixed set of a reversal by such rays; an attractor is what is left of motions from random states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.integrate.dop853 import ReferenceSettings, integrate
from orbitfinder.integrate.equations import accelerations
from orbitfinder.integrate.field import vector_field
from orbitfinder.loops.symmetry import Involution
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.mechanics.scales import alike, given_or, snapped
from orbitfinder.orbits.guesses.modes import first_order_modes

LOOSE = ReferenceSettings(relative_tolerance=1e-8, absolute_tolerance=1e-10)


@dataclass(frozen=True)
class RegionSettings:
    """How level sets and attractors are looked for."""

    drawn: int = 48
    """states from which equilibria, and later attractors, are looked for"""
    reaches: tuple[float, ...] = tuple(2.0**k for k in range(-20, 21))
    """distances along a ray, in lengths"""
    rays: int = 60
    """cast before a start is given up"""
    spans: float = 6.0
    """motions settle for half of so many of the longest periods"""
    settled: int = 8
    """motions on attractors that are kept"""
    samples: int = 400
    """of each half"""
    grown: float = 4.0
    """what gets this much larger in the second half runs away"""
    still: float = 1e-6
    """what moves less than this, relative to where it is, is at rest"""
    loose: ReferenceSettings = LOOSE


SETTINGS = RegionSettings()


@dataclass(frozen=True)
class Level:
    """I(x) = `level`, met by rays from `places` (k x d), from places `inside` (I < level) where there are any."""

    model: Model
    level: float
    places: np.ndarray
    lengths: np.ndarray
    inside: bool

    @classmethod
    def of(cls, model: Model, level: float) -> Level:
        """The level set of a model's integral; `InputError` where no ray meets it."""
        places = equilibria(model)
        inner = np.array([energy(model, place) < level for place in places])
        places = places[inner] if np.any(inner) else places
        region = cls(model, level, places, np.ones(places.shape[1]), bool(np.any(inner)))
        met = []
        for place in places:
            for unit in np.eye(place.size):
                crossings = [region.crossing(place, sign * unit) for sign in (1.0, -1.0)]
                sizes = [np.abs(x - place).max() for x in crossings if x is not None]
                met.append(min(sizes, default=np.nan))
        if np.all(np.isnan(met)):
            raise InputError(f"energy: no state of energy {level:.9g} is found about equilibria; give another energy")
        sizes = np.nanmin(np.reshape(np.append(met, np.full(place.size, 1e300)), (-1, place.size)), axis=0)
        return replace(region, lengths=given_or(model, alike(np.where(sizes < 1e300, sizes, 1.0))))

    def drawn(self, random: np.random.Generator) -> np.ndarray:
        """Where a ray in a random direction, from near one of the places, first meets the level."""
        return self._cast(random, np.ones(self.lengths.size))

    def fixed(self, reversal: Involution, random: np.random.Generator) -> np.ndarray:
        """The same within the fixed set."""
        return self._cast(random, np.broadcast_to(reversal.signs, self.lengths.size))

    def _cast(self, random: np.random.Generator, signs: np.ndarray) -> np.ndarray:
        angles = self.model.angular
        for _ in range(SETTINGS.rays):
            shifted = random.normal(size=signs.size) * random.uniform() ** 3 * (random.uniform() < 0.5)
            place = self.places[random.integers(len(self.places))] + self.lengths * shifted
            place = np.where(signs < 0, np.pi * angles * random.integers(0, 2, signs.size), place)
            if self.inside and not energy(self.model, place) < self.level:
                continue
            met = self.crossing(place, self.lengths * np.where(signs < 0, 0.0, random.normal(size=signs.size)))
            if met is not None:
                return met
        raise ConvergenceError("no ray meets the energy")

    def crossing(self, place: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
        """The first state along a ray at which the integral has its level, None where there is none."""

        def excess(length: float) -> float:
            return energy(self.model, place + length * direction) - self.level

        last, before = 0.0, excess(0.0)
        for length in SETTINGS.reaches:
            here = excess(length)
            if not np.isfinite(here):
                return None
            if np.isfinite(before) and (here > 0) != (before > 0):
                return np.asarray(place + brentq(excess, last, length, xtol=1e-15 * length, rtol=1e-15) * direction)
            last, before = float(length), here
        return None


@dataclass(frozen=True)
class Attractor:
    """`states` (k x d) on what attracts motions, and near them."""

    angles: np.ndarray
    states: np.ndarray
    lengths: np.ndarray
    """of coordinates (n), of a first-order system of all components"""
    units: np.ndarray
    """of states (d)"""

    @classmethod
    def of(cls, model: Model, longest: float) -> Attractor:
        """What is left of motions from random states after some of the longest periods (s). Raises `InputError`."""
        clock = float(snapped(longest / (2 * np.pi)))
        field, times = (
            vector_field(accelerations(model)),
            np.linspace(0.0, SETTINGS.spans * longest, 2 * SETTINGS.samples),
        )
        kept = []
        for start in random_states(model, clock):
            try:
                before, path = np.split(integrate(field, start, times, SETTINGS.loose), 2)
            except IntegrationError:
                continue
            moved = np.ptp(path, axis=0)
            bounded = np.abs(path).max() < SETTINGS.grown * np.abs(before).max()
            if bounded and np.any(moved > SETTINGS.still * np.maximum(np.abs(path).max(axis=0), SETTINGS.still)):
                kept.append(path)
            if len(kept) == SETTINGS.settled:
                break
        if not kept:
            raise InputError(
                "search: no motion from a random state stays bounded and goes on; give scales= to the system, or find "
                "its orbits from a guess"
            )
        sizes = np.max([np.ptp(path, axis=0) for path in kept], axis=0) / 4
        lengths = given_or(model, alike(sizes[: model.degrees_of_freedom]))
        return cls(model.angular, np.vstack(kept), lengths, _with_rates(model, lengths, clock))

    def drawn(self, random: np.random.Generator) -> np.ndarray:
        """A state on an attractor, half of them moved away from it."""
        away = 0.2 * (random.uniform() < 0.5) * self.units * random.normal(size=self.units.size)
        return np.asarray(self.states[random.integers(len(self.states))] + away)

    def fixed(self, reversal: Involution, random: np.random.Generator) -> np.ndarray:
        """Such a state, put into the fixed set."""
        x, signs = self.drawn(random), np.broadcast_to(reversal.signs, self.lengths.size)
        return np.where(signs < 0, np.pi * self.angles * random.integers(0, 2, signs.size), x)


Region = Level | Attractor
"""Where states (d) are drawn from"""


def _with_rates(model: Model, lengths: np.ndarray, clock: float) -> np.ndarray:
    """What states (d) are measured in: lengths (n), of a mechanical system's rates lengths in a `clock` (s)."""
    return lengths if model.rates is not None else np.concatenate([lengths, lengths / clock])


def random_states(model: Model, clock: float = 1.0) -> list[np.ndarray]:
    """Seeded states (d) about 0, near and far, in the lengths given."""
    random, given = np.random.default_rng(0), _with_rates(model, given_or(model, 1.0), clock)
    far = (1.0, 4.0, 16.0, 0.25)
    return [given * far[k % len(far)] * random.normal(size=given.size) for k in range(SETTINGS.drawn)]


def equilibria(model: Model) -> np.ndarray:
    """Equilibria (k x d) that Newton's method finds from random states, else the states themselves."""
    drawn, places = random_states(model), list[np.ndarray]()
    for start in (np.zeros(drawn[0].size), *drawn):
        try:
            with np.errstate(all="ignore"):
                place = first_order_modes(model, start)[0]
        except (InputError, ValueError, np.linalg.LinAlgError):
            continue
        if np.isfinite(energy(model, place)) and not any(
            np.abs(place - known).max() < SETTINGS.still for known in places
        ):
            places.append(place)
    return np.array(places or [state for state in drawn if np.isfinite(energy(model, state))])
