"""What a certificate would otherwise take on trust: that the system is what its description says.

A period declared for the forcing, the absence of time, angles that turn and invariants are tried on the
equations themselves, at seeded states about the motion.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orbitfinder.mechanics.model import Invariant, Model
from orbitfinder.records.orbit import Check

TRIED = 12
"""States about the motion at which the equations are compared."""
EXACT = 1e-10
"""Relative difference of the accelerations between two moments that should be alike."""
DRIFT = 1e-9
"""Drift of an invariant along the motion, relative to how much it varies about it."""
ROUNDED = 64 * float(np.finfo(float).eps)
"""Relative error of an invariant's value."""
LATER = 7
"""Periods of the forcing after which the equations are compared again, at most."""


def premises(model: Model, times: np.ndarray, states: np.ndarray, units: np.ndarray, turns: np.ndarray) -> list[Check]:
    """Checks of what a Model declares, along a motion (k x 2n at `times`) with extents `units` (2n)."""
    near = _Nearby(model, times, states, units)
    return [near.time_dependence(), *near.windings(turns), *near.invariants()]


class _Nearby:
    """Seeded moments and states about a motion, and the accelerations there in extents."""

    def __init__(self, model: Model, times: np.ndarray, states: np.ndarray, units: np.ndarray) -> None:
        random = np.random.default_rng(0)
        self.model, self.period = model, float(times[-1])
        self.along, self.units = states, units
        self.rows = states[random.integers(0, len(states), TRIED)]
        if model.constraint is None:  # off the constraints a motion has no meaning
            self.rows = self.rows + 0.1 * units * random.normal(size=self.rows.shape)
        self.moments = np.append(0.0, random.uniform(0.0, self.period, TRIED - 1))
        self.ahead = random.integers(1, LATER + 1, TRIED)
        self.here = self._accelerations(self.moments, self.rows)

    def _accelerations(self, moments: np.ndarray, rows: np.ndarray) -> np.ndarray:
        n, values = self.model.degrees_of_freedom, self.model.parameter_values
        found = [self.model.acceleration(t, x[:n], x[n:], values).full() for t, x in zip(moments, rows, strict=True)]
        return np.asarray(found).reshape(len(rows), n) * self.period / self.units[n:]

    def _differ(self, there: np.ndarray) -> float:
        """Largest relative difference from the accelerations here, where both are finite."""
        known = np.isfinite(self.here) & np.isfinite(there)
        size = max(1.0, float(np.abs(self.here[known]).max(initial=0.0)))
        return float(np.abs(there - self.here)[known].max(initial=0.0)) / size

    def time_dependence(self) -> Check:
        """The equations one and a few periods of the forcing later; without a forcing, at any time."""
        clock = self.model.forcing_period
        wait = self.period if clock is None else float(clock(self.model.parameter_values))
        by = np.random.default_rng(1).uniform(0.1, 1.0, TRIED) * wait if clock is None else wait * self.ahead
        found = max(self._differ(self._accelerations(self.moments + step, self.rows)) for step in (by, wait))
        note = "equations of motion at other times" if clock is None else "equations of motion forcing periods later"
        return _at_most("time_dependence", found, EXACT, note)

    def windings(self, turns: np.ndarray) -> Iterator[Check]:
        """A coordinate that turns is an angle, and the equations are the same a turn later."""
        for k in np.flatnonzero(turns):
            name = self.model.state_names[k]
            if not self.model.angles or not self.model.angles[k]:
                yield Check("winding", float(abs(turns[k])), 0.0, False, f"{name} turns and is not an angle")
                continue
            turned = self.rows.copy()
            turned[:, k] += 2 * np.pi
            there = self._accelerations(self.moments, turned)
            yield _at_most("winding", self._differ(there), EXACT, f"equations of motion with {name} a turn further")

    def invariants(self) -> Iterator[Check]:
        """Each declared invariant is constant along the motion."""
        for one in self.model.invariants:
            values = self._values(one, self.along[:: max(1, len(self.along) // 64)])
            varied = self._values(one, self.along[:1] + self.units * (self.rows - self.rows.mean(axis=0) + 1e-3))
            size = max(float(np.abs(varied - values[0]).max()), 1e-300)
            lost = ROUNDED * float(max(np.abs(values).max(), np.abs(varied).max()))
            drift = max(float(np.ptp(values)) - lost, 0.0) / size
            yield _at_most(f"invariant_{one.name}", drift, DRIFT, "drift along the motion beyond round-off")

    def _values(self, one: Invariant, states: np.ndarray) -> np.ndarray:
        n, p = self.model.degrees_of_freedom, self.model.parameter_values
        return np.array([float(one.value(x[:n], x[n:], p)) for x in states])


def _at_most(name: str, value: float, tolerance: float, note: str) -> Check:
    return Check(name, float(value), tolerance, bool(value <= tolerance), note)
