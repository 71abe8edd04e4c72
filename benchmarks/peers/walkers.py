"""Walking machines in plain NumPy and SciPy, from their authors' equations: nothing of orbitfinder's is used.

The compass gait's impact comes from angular momentum, of everything about the new stance foot and of the new swing leg
about the hip, summed mass by mass, not from impulses as in `orbitfinder.impact`. Multipliers are those of differences
of the step, period doublings the slopes at which one of them is -1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, least_squares

LONGEST = 10.0
"""s, of a step"""


@dataclass(frozen=True)
class Walker:
    """x' = rate(x), the foot strikes where strike(x) = 0, `late` enough to count; x+ = after(x)."""

    rate: Callable[[np.ndarray], np.ndarray]
    strike: Callable[[np.ndarray], float]
    late: Callable[[np.ndarray], bool]
    after: Callable[[np.ndarray], np.ndarray]
    rising: bool

    def step(self, x: np.ndarray, tolerance: float = 1e-13) -> tuple[np.ndarray, float]:
        """The state after the next strike and its time."""

        def strike(_: float, x: np.ndarray) -> float:
            return self.strike(x)

        def done(_: float, x: np.ndarray) -> float:
            return self.strike(x) if self.late(x) else -1.0 if self.rising else 1.0

        strike.direction = done.direction = 1.0 if self.rising else -1.0  # type: ignore[attr-defined]
        done.terminal = True  # type: ignore[attr-defined]
        path = solve_ivp(
            lambda _, x: self.rate(x), (0.0, LONGEST), x, method="DOP853", rtol=tolerance, atol=tolerance,
            events=(strike, done),
        )  # fmt: skip
        for moment, state in zip(path.t_events[0], path.y_events[0], strict=True):
            if self.late(state):
                return self.after(state), float(moment)
        raise ValueError("the foot does not strike")

    def orbit(self, x: np.ndarray, steps: int = 1) -> tuple[np.ndarray, float]:
        """The state after a strike that comes back after so many steps, and their time."""
        found = least_squares(lambda y: self.steps(y, steps)[0] - y, x, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        return found.x, self.steps(found.x, steps)[1]

    def steps(self, x: np.ndarray, count: int) -> tuple[np.ndarray, float]:
        """The state after so many strikes, and the time of the last."""
        total = 0.0
        for _ in range(count):
            x, time = self.step(x)
            total += time
        return x, total

    def multipliers(self, x: np.ndarray, steps: int = 1, width: float = 2e-4) -> np.ndarray:
        """Eigenvalues of the return map, the largest first, by differences of order six."""
        columns = []
        for unit in np.eye(x.size):
            ends = {k: self.steps(x + k * width * unit, steps)[0] for k in (-3, -2, -1, 1, 2, 3)}
            columns.append((45 * (ends[1] - ends[-1]) - 9 * (ends[2] - ends[-2]) + ends[3] - ends[-3]) / (60 * width))
        values = np.linalg.eigvals(np.array(columns).T)
        return values[np.argsort(-np.abs(values))]


def simplest(slope: float) -> Walker:
    """M. Garcia et al., "The simplest walking model" (1998), equations 1 to 4."""

    def rate(x: np.ndarray) -> np.ndarray:
        theta, phi, omega, spin = x
        fall = np.sin(theta - slope)
        swing = fall + np.sin(phi) * (omega**2 - np.cos(theta - slope))
        return np.array([omega, spin, fall, swing])

    def after(x: np.ndarray) -> np.ndarray:
        theta, omega = x[0], x[2]
        turn = np.cos(2 * theta)
        return np.array([-theta, -2 * theta, turn * omega, turn * (1 - turn) * omega])

    return Walker(rate, lambda x: x[1] - 2 * x[0], lambda x: x[0] < -1e-3, after, True)


def compass(slope: float, a: float = 0.5, b: float = 0.5, mass: float = 5.0, hip: float = 10.0) -> Walker:
    """A. Goswami et al., INRIA report 2996 (1996): stance and swing angles and rates, g = 9.81."""
    g, length = 9.81, a + b
    stands, couples, swings = mass * a**2 + (hip + mass) * length**2, mass * length * b, mass * b**2

    def rate(x: np.ndarray) -> np.ndarray:
        s, n, u, w = x
        between, across = np.cos(s - n), np.sin(s - n)
        matrix = np.array([[stands, -couples * between], [-couples * between, swings]])
        pull = (mass * a + hip * length + mass * length) * g * np.sin(s)
        forces = np.array([couples * across * w**2 + pull, -couples * across * u**2 - mass * b * g * np.sin(n)])
        return np.concatenate([[u, w], np.linalg.solve(matrix, forces)])

    def along(angle: float) -> np.ndarray:
        return np.array([-np.sin(angle), np.cos(angle)])

    def moving(angle: float) -> np.ndarray:
        return np.array([-np.cos(angle), -np.sin(angle)])

    def cross(place: np.ndarray, speed: np.ndarray) -> float:
        return float(place[0] * speed[1] - place[1] * speed[0])

    def momenta(legs: tuple[float, float], rates: tuple[float, float], struck: bool) -> np.ndarray:
        """About the contact of the leg `legs[0]` after the strike, and of the leg `legs[1]` about the hip.

        `struck`: rates after the strike, when the contact is at rest; else before, when the other foot is.
        """
        (new, old), (spin_new, spin_old) = legs, rates
        hub = length * along(new)
        hub_speed = length * moving(new) * spin_new if struck else length * moving(old) * spin_old
        ahead, behind = hub - b * along(new), hub - b * along(old)
        ahead_speed = hub_speed - b * moving(new) * spin_new
        behind_speed = hub_speed - b * moving(old) * spin_old
        whole = hip * cross(hub, hub_speed) + mass * (cross(ahead, ahead_speed) + cross(behind, behind_speed))
        return np.array([whole, mass * cross(behind - hub, behind_speed)])

    def after(x: np.ndarray) -> np.ndarray:
        legs = (x[1], x[0])
        before = momenta(legs, (x[3], x[2]), False)
        columns = np.array([momenta(legs, unit, True) for unit in ((1.0, 0.0), (0.0, 1.0))]).T
        return np.concatenate([legs, np.linalg.solve(columns, before)])

    return Walker(rate, lambda x: x[0] + x[1] + 2 * slope, lambda x: x[1] - x[0] > 1e-3, after, False)


def doubling(
    walker: Callable[[float], Walker], x: np.ndarray, between: tuple[float, float], steps: int = 1
) -> tuple[float, np.ndarray]:
    """The slope at which a multiplier of a gait is -1, and the state there."""
    state = x

    def beyond(slope: float) -> float:
        nonlocal state
        state = walker(slope).orbit(state, steps)[0]
        return float(np.prod(walker(slope).multipliers(state, steps)[:2] + 1).real)

    found = float(brentq(beyond, *between, xtol=1e-13))
    return found, state
