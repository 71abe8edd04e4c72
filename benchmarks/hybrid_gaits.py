"""Hybrid machines in plain NumPy and SciPy, from their authors' equations: nothing of the package is used.

`solve_ivp` with events between resets, roots of the return map by `fsolve` or `least_squares`, multipliers by
differences of it. Legs are point masses on massless links, M from Jacobians. The kneed walker's impacts are one linear
system of M and the contact Jacobian; the compass gait's comes from angular momentum, of everything about the new stance
foot and of the new swing leg about the hip, mass by mass. `python benchmarks/hybrid_gaits.py [NAME...]` prints states
and periods of the orbits of problems/hybrid.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve, least_squares

Vector = np.ndarray
TIGHT = 1e-13
LONGEST = 60.0
"""s, of an arc"""
MOST = 6
"""Crossings of a guard in an arc, of which the last counts"""


@dataclass(frozen=True)
class Piece:
    """x' = field(x) until guard(x) crosses 0 in its direction where that `counts`, and what follows."""

    field: Callable[[Vector], Any]
    guard: Callable[[Vector], float]
    direction: int
    reset: Callable[[Vector], Any]
    counts: Callable[[Vector], bool] = lambda x: True

    def arc(self, x: Vector, tolerance: float = TIGHT) -> tuple[Vector, float]:
        """The state after the event, and how long it took."""

        def cross(_: float, x: Vector) -> float:
            return self.guard(x)

        def done(_: float, x: Vector) -> float:
            return self.guard(x) if self.counts(x) else -float(self.direction)

        cross.direction = done.direction = float(self.direction)  # type: ignore[attr-defined]
        for known in range(MOST):  # `done` ends too early where a crossing begins to count beyond the guard
            cross.terminal, done.terminal = known and known + 1, True  # type: ignore[attr-defined]
            path = solve_ivp(
                lambda _, x: self.field(x), (0.0, LONGEST), x, method="DOP853", rtol=tolerance, atol=tolerance,
                events=(cross, done) if not known else cross,
            )  # fmt: skip
            for moment, state in zip(path.t_events[0], path.y_events[0], strict=True):
                if self.counts(state):
                    return np.asarray(self.reset(state), float), float(moment)
        raise ValueError("no event ends the arc")


@dataclass(frozen=True)
class Machine:
    """The pieces of one cycle; `lift` puts the numbers that make up a point of the section on it."""

    pieces: Sequence[Piece]
    lift: Callable[[Vector], Any] = lambda z: z

    def step(self, x: Vector) -> tuple[Vector, float]:
        """The state after a cycle and its time."""
        total = 0.0
        for piece in self.pieces:
            x, time = piece.arc(x)
            total += time
        return x, total

    def steps(self, x: Vector, count: int) -> tuple[Vector, float]:
        """The state after so many cycles, and the time of the last event."""
        total = 0.0
        for _ in range(count):
            x, time = self.step(x)
            total += time
        return x, total

    def orbit(self, x: Vector, steps: int = 1) -> tuple[Vector, float]:
        """The state that comes back after so many cycles, and their time."""
        found = least_squares(lambda y: self.steps(y, steps)[0] - y, x, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        return found.x, self.steps(found.x, steps)[1]

    def closed(self, z: Sequence[float], steps: int = 1) -> tuple[Vector, float]:
        """The same from numbers on the section, for states that are not all free."""

        def miss(z: Vector) -> Vector:
            x = np.asarray(self.lift(z), float)
            gaps = self.steps(x, steps)[0] - x
            return np.asarray(np.linalg.lstsq(derivative(self.lift, z), gaps, rcond=None)[0])

        found, _, _, message = fsolve(miss, z, xtol=1e-13, epsfcn=1e-14, full_output=True)
        x = np.asarray(self.lift(found), float)
        end, period = self.steps(x, steps)
        if np.abs(end - x).max() > 1e-8:
            raise RuntimeError(f"did not close: {np.abs(end - x).max():.1e}, {message}")
        return x, period

    def multipliers(self, x: Vector, steps: int = 1, width: float = 2e-4) -> Vector:
        """Eigenvalues of the return map, the largest first, by differences of order six."""
        columns = []
        for unit in np.eye(x.size):
            ends = {k: self.steps(x + k * width * unit, steps)[0] for k in (-3, -2, -1, 1, 2, 3)}
            columns.append((45 * (ends[1] - ends[-1]) - 9 * (ends[2] - ends[-2]) + ends[3] - ends[-3]) / (60 * width))
        values = np.linalg.eigvals(np.array(columns).T)
        return values[np.argsort(-np.abs(values))]


def doubling(
    machine: Callable[[float], Machine], x: Vector, between: tuple[float, float], steps: int = 1
) -> tuple[float, Vector]:
    """The slope at which a multiplier of a gait is -1, and the state there."""
    state = x

    def beyond(slope: float) -> float:
        nonlocal state
        state = machine(slope).orbit(state, steps)[0]
        return float(np.prod(machine(slope).multipliers(state, steps)[:2] + 1).real)

    found = float(brentq(beyond, *between, xtol=1e-13))
    return found, state


def derivative(lift: Callable[[Vector], Any], z: Vector) -> Vector:
    """d lift / d z by differences."""
    steps = [(np.asarray(lift(z + 1e-6 * e)) - np.asarray(lift(z - 1e-6 * e))) / 2e-6 for e in np.eye(len(z))]
    return np.array(steps).T


# -- legs of point masses: place = foot + sum_i c_i (-sin q_i, cos q_i), angles from the vertical ----------------------


def jacobian(c: Vector, q: Vector) -> Vector:
    """Of sum_i c_i (-sin q_i, cos q_i)."""
    return np.array([-c * np.cos(q), -c * np.sin(q)])


def swing(masses: Sequence[tuple[float, Sequence[float]]], gravity: float, held: Any = None) -> Callable[[Vector], Any]:
    """The field of masses at coefficients c of the angles, with angles in the rows `held` kept in line."""
    count = len(masses[0][1])

    def field(x: Vector) -> Vector:
        q, v = x[:count], x[count:]
        mass, force = np.zeros((count, count)), np.zeros(count)
        for m, given in masses:
            c = np.array(given)
            j = jacobian(c, q)
            mass += m * j.T @ j
            centripetal = np.array([c @ (np.sin(q) * v**2), -c @ (np.cos(q) * v**2)])
            force += m * j.T @ (np.array([0, -gravity]) - centripetal)
        if held is not None:
            row = np.atleast_2d(held)
            mass = np.block([[mass, row.T], [row, np.zeros((len(row),) * 2)]])
            force = np.append(force, np.zeros(len(row)))
        return np.concatenate([v, np.linalg.solve(mass, force)[:count]])

    return field


def struck(masses: Sequence[tuple[float, Sequence[float]]], tip: Sequence[float], held: Any = None) -> Any:
    """Rates after the tip hits the ground and stays, the former foot free: momentum and contact in one system."""
    count = len(tip)

    def after(x: Vector) -> Vector:
        q, v = x[:count], np.concatenate([[0, 0], x[count:]])
        mass = np.zeros((count + 2, count + 2))
        for m, given in masses:
            j = np.hstack([np.eye(2), jacobian(np.array(given), q)])
            mass += m * j.T @ j
        rows = np.hstack([np.eye(2), jacobian(np.array(tip), q)])
        if held is not None:
            rows = np.vstack([rows, np.hstack([np.zeros((len(np.atleast_2d(held)), 2)), np.atleast_2d(held)])])
        k = len(rows)
        whole = np.block([[mass, rows.T], [rows, np.zeros((k, k))]])
        return np.linalg.solve(whole, np.concatenate([mass @ v, np.zeros(k)]))[2 : count + 2]

    return after


def compass(slope: float, a: float = 0.5, b: float = 0.5, mass: float = 5.0, hip: float = 10.0) -> Machine:
    """A. Goswami et al., INRIA report 2996 (1996): stance and swing angles and rates, g = 9.81."""
    g, length = 9.81, a + b
    stands, couples, swings = mass * a**2 + (hip + mass) * length**2, mass * length * b, mass * b**2

    def rate(x: Vector) -> Vector:
        s, n, u, w = x
        between, across = np.cos(s - n), np.sin(s - n)
        matrix = np.array([[stands, -couples * between], [-couples * between, swings]])
        pull = (mass * a + hip * length + mass * length) * g * np.sin(s)
        forces = np.array([couples * across * w**2 + pull, -couples * across * u**2 - mass * b * g * np.sin(n)])
        return np.concatenate([[u, w], np.linalg.solve(matrix, forces)])

    def along(angle: float) -> Vector:
        return np.array([-np.sin(angle), np.cos(angle)])

    def moving(angle: float) -> Vector:
        return np.array([-np.cos(angle), -np.sin(angle)])

    def cross(place: Vector, speed: Vector) -> float:
        return float(place[0] * speed[1] - place[1] * speed[0])

    def momenta(legs: tuple[float, float], rates: tuple[float, float], struck: bool) -> Vector:
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

    def after(x: Vector) -> Vector:
        legs = (x[1], x[0])
        before = momenta(legs, (x[3], x[2]), False)
        columns = np.array([momenta(legs, unit, True) for unit in ((1.0, 0.0), (0.0, 1.0))]).T
        return np.concatenate([legs, np.linalg.solve(columns, before)])

    step = Piece(rate, lambda x: x[0] + x[1] + 2 * slope, -1, after, lambda x: x[1] - x[0] > 1e-3)
    return Machine([step], lambda z: [z[0], -z[0] - 2 * slope, z[1], z[2]])


def kneed(slope: float = 0.0504) -> Machine:
    a1, b1, a2, b2 = 0.375, 0.125, 0.175, 0.325
    masses = [
        (0.05, (a1, 0, 0)), (0.5, (a1 + b1 + a2, 0, 0)), (0.5, (1, 0, 0)), (0.5, (1, -b2, 0)),
        (0.05, (1, -(a2 + b2), -b1)),
    ]  # fmt: skip
    line = (0.0, 1.0, -1.0)
    after = struck(masses, (1.0, -0.5, -0.5), line)

    def straighten(x: Vector) -> Vector:
        q, v = x[:3], x[3:]
        mass = sum(m * jacobian(np.array(c), q).T @ jacobian(np.array(c), q) for m, c in masses)
        row = np.array([line])
        whole = np.block([[mass, row.T], [row, np.zeros((1, 1))]])
        rates = np.linalg.solve(whole, np.append(mass @ v, 0.0))[:3]
        return np.concatenate([[q[0], q[1], q[1]], rates])

    def reset(x: Vector) -> list[float]:
        rates = after(x)
        return [x[1], x[0], x[0], rates[1], rates[0], rates[0]]

    def height(x: Vector) -> float:
        tip = np.array([-np.sin(x[0]) + 0.5 * np.sin(x[1]) + 0.5 * np.sin(x[2]),
                        np.cos(x[0]) - 0.5 * np.cos(x[1]) - 0.5 * np.cos(x[2])])  # fmt: skip
        return float(tip @ [np.sin(slope), np.cos(slope)])

    pieces = [
        Piece(swing(masses, 9.81), lambda x: x[1] - x[2], -1, straighten),
        Piece(swing(masses, 9.81, line), height, -1, reset),
    ]
    return Machine(pieces, lambda z: [z[0], -z[0] - 2 * slope, -z[0] - 2 * slope, z[1], z[2], z[2]])


def five_links(slope: float = 0.0504) -> Machine:
    """The kneed walker with a torso as a fourth angle, which a row of constraints keeps between the thighs."""
    a1, b1, a2, b2 = 0.375, 0.125, 0.175, 0.325
    masses = [
        (0.05, (a1, 0, 0, 0)), (0.5, (a1 + b1 + a2, 0, 0, 0)), (0.5, (1, 0, 0, 0)), (0.5, (1, -b2, 0, 0)),
        (0.05, (1, -(a2 + b2), -b1, 0)), (0.2, (1, 0, 0, 0.25)),
    ]  # fmt: skip
    middle, line = (-0.5, -0.5, 0.0, 1.0), (0.0, 1.0, -1.0, 0.0)
    tip = (1.0, -0.5, -0.5, 0.0)
    after = struck(masses, tip, (middle, line))

    def straighten(x: Vector) -> Vector:
        q, v = x[:4], x[4:]
        mass = sum(m * jacobian(np.array(c), q).T @ jacobian(np.array(c), q) for m, c in masses)
        rows = np.array([middle, line])
        whole = np.block([[mass, rows.T], [rows, np.zeros((2, 2))]])
        rates = np.linalg.solve(whole, np.append(mass @ v, np.zeros(2)))[:4]
        return np.concatenate([[q[0], q[1], q[1], (q[0] + q[1]) / 2], rates])

    def reset(x: Vector) -> list[float]:
        rates = after(x)
        return [x[1], x[0], x[0], (x[0] + x[1]) / 2, rates[1], rates[0], rates[0], (rates[0] + rates[1]) / 2]

    def height(x: Vector) -> float:
        c = np.array(tip)
        return float(np.array([-c @ np.sin(x[:4]), c @ np.cos(x[:4])]) @ [np.sin(slope), np.cos(slope)])

    pieces = [
        Piece(swing(masses, 9.81, middle), lambda x: x[1] - x[2], -1, straighten),
        Piece(swing(masses, 9.81, (middle, line)), height, -1, reset),
    ]
    swung = -2 * slope
    return Machine(pieces, lambda z: [z[0], swung - z[0], swung - z[0], -slope, z[1], z[2], z[2], (z[1] + z[2]) / 2])


# -- the others --------------------------------------------------------------------------------------------------------


def simplest(slope: float) -> Machine:
    """M. Garcia et al., "The simplest walking model" (1998), equations 1 to 4."""

    def rate(x: Vector) -> Vector:
        theta, phi, omega, spin = x
        fall = np.sin(theta - slope)
        swing = fall + np.sin(phi) * (omega**2 - np.cos(theta - slope))
        return np.array([omega, spin, fall, swing])

    def after(x: Vector) -> Vector:
        theta, omega = x[0], x[2]
        turn = np.cos(2 * theta)
        return np.array([-theta, -2 * theta, turn * omega, turn * (1 - turn) * omega])

    step = Piece(rate, lambda x: x[1] - 2 * x[0], 1, after, lambda x: x[0] < -1e-3)
    return Machine([step], lambda z: [z[0], 2 * z[0], z[1], (1 - np.cos(2 * z[0])) * z[1]])


def wheel(slope: float = 0.08, spokes: int = 8) -> Machine:
    half = np.pi / spokes
    step = Piece(
        lambda x: [x[1], 9.81 * np.sin(x[0])], lambda x: x[0] - slope - half, 1,
        lambda x: [x[0] - 2 * half, np.cos(2 * half) * x[1]],
    )  # fmt: skip
    return Machine([step], lambda z: [slope - half, z[0]])


def runner(attack: float, stiffness: float, energy: float) -> Machine:
    def flight(x: Vector) -> list[float]:
        return [x[2], x[3], 0.0, -9.81]

    def stance(x: Vector) -> list[float]:
        leg = np.hypot(x[0], x[1])
        push = stiffness / 80.0 * (1.0 / leg - 1.0)
        return [x[2], x[3], push * x[0], push * x[1] - 9.81]

    pieces = [
        Piece(flight, lambda x: x[1] - np.cos(attack), -1, lambda x: [-np.sin(attack), *x[1:]]),
        Piece(stance, lambda x: np.hypot(x[0], x[1]) - 1.0, 1, lambda x: x),
        Piece(flight, lambda x: x[3], -1, lambda x: [0.0, *x[1:]]),
    ]
    return Machine(pieces, lambda z: [0.0, z[0], np.sqrt(2 * (energy / 80.0 - 9.81 * z[0])), 0.0])


def walker(attack: float, stiffness: float, energy: float) -> Machine:
    """State: place from the front foot, rates, the distance of the foot behind."""

    def push(x: float, y: float) -> Vector:
        leg = np.hypot(x, y)
        return stiffness / 80.0 * (1.0 / leg - 1.0) * np.array([x, y])

    def single(x: Vector) -> list[float]:
        one = push(x[0], x[1])
        return [x[2], x[3], one[0], one[1] - 9.81, 0.0]

    def double(x: Vector) -> list[float]:
        one = push(x[0], x[1]) + push(x[0] + x[4], x[1])
        return [x[2], x[3], one[0], one[1] - 9.81, 0.0]

    def landed(x: Vector) -> list[float]:
        step = x[0] + np.sin(attack)
        return [x[0] - step, x[1], x[2], x[3], step]

    def lift(z: Vector) -> list[float]:
        x, step, vy = z[:3]
        y = np.sqrt(1.0 - (x + step) ** 2)
        spring = stiffness / 2 * (1 - np.hypot(x, y)) ** 2
        return [x, y, np.sqrt(2 / 80.0 * (energy - spring - 80.0 * 9.81 * y) - vy**2), vy, step]

    pieces = [
        Piece(single, lambda x: x[1] - np.cos(attack), -1, landed),
        Piece(double, lambda x: np.hypot(x[0] + x[4], x[1]) - 1.0, 1, lambda x: x),
    ]
    return Machine(pieces, lift)


def oscillator(damping: float, frequency: float, force: float, stop: float, e: float) -> Machine:
    """x, v, phase; the period is a whole number of the forcing's, the phase is left to turn."""
    free = Piece(
        lambda x: [x[1], force * np.cos(x[2]) - damping * x[1] - x[0], frequency], lambda x: x[0] - stop, 1,
        lambda x: [stop, -e * x[1], np.angle(np.exp(1j * x[2]))],
    )  # fmt: skip
    return Machine([free], lambda z: [stop, z[0], z[1]])


def ball(amplitude: float = 0.012) -> Machine:
    turn = 2 * np.pi

    def reset(x: Vector) -> list[float]:
        speed = 1.8 * amplitude * turn * np.cos(x[2]) - 0.8 * x[1]
        return [x[0], speed, np.angle(np.exp(1j * x[2]))]

    air = Piece(lambda x: [x[1], -1.0, turn], lambda x: x[0] - amplitude * np.sin(x[2]), -1, reset)
    return Machine([air], lambda z: [amplitude * np.sin(z[1]), z[0], z[1]])


def hitting(wall: float, energy: float) -> Machine:
    """A double pendulum of unit masses and lengths; angles from the downward vertical."""

    def mass(q: Vector) -> Vector:
        mixed = np.cos(q[0] - q[1])
        return np.array([[2.0, mixed], [mixed, 1.0]])

    def field(x: Vector) -> Vector:
        q, v = x[:2], x[2:]
        twist = np.sin(q[0] - q[1])
        force = [-twist * v[1] ** 2 - 2 * 9.81 * np.sin(q[0]), twist * v[0] ** 2 - 9.81 * np.sin(q[1])]
        return np.concatenate([v, np.linalg.solve(mass(q), force)])

    def reset(x: Vector) -> Vector:
        row = np.cos(x[:2])
        way = np.linalg.solve(mass(x[:2]), row)
        return np.concatenate([x[:2], x[2:] - 2 * (row @ x[2:]) / (row @ way) * way])

    def lift(z: Vector) -> Vector:
        """Reversible: the rates after the hit are those along M^-1 J^T."""
        q = np.array([z[0], np.arcsin(wall - np.sin(z[0]))])
        way = -np.linalg.solve(mass(q), np.cos(q))
        left = energy + 2 * 9.81 * np.cos(q[0]) + 9.81 * np.cos(q[1])
        return np.concatenate([q, way * np.sqrt(2 * left / (way @ mass(q) @ way))])

    return Machine([Piece(field, lambda x: np.sin(x[0]) + np.sin(x[1]) - wall, 1, reset)], lift)


def again(name: str) -> tuple[Vector, float]:
    """The state and the period of the orbit of problems/hybrid/NAME.toml."""
    degrees = np.pi / 180
    times = {"simplest-walker-period-2": 2, "simplest-walker-period-4": 4}
    found: dict[str, Callable[[], tuple[Machine, Sequence[float]]]] = {
        "rimless-wheel": lambda: (wheel(), [1.1]),
        "simplest-walker-long": lambda: (simplest(0.009), [0.2, -0.2]),
        "simplest-walker-short": lambda: (simplest(0.009), [0.19394, -0.20387]),
        "simplest-walker-period-2": lambda: (simplest(0.017), [0.2535, -0.2452]),
        "simplest-walker-period-4": lambda: (simplest(0.018), [0.2598, -0.2505]),
        "compass-gait": lambda: (compass(3 * degrees), [0.2187, -1.092, -0.377]),
        "compass-gait-without-hip": lambda: (compass(0.03, hip=0.0), [0.08, -0.03, 2.3]),
        "kneed-walker": lambda: (kneed(), [0.1882, -1.11, -0.057]),
        "five-link-walker": lambda: (five_links(), [0.2237, -1.093, -0.281]),
        "slip-runner-stable": lambda: (runner(0.384, 20000.0, 1784.8), [0.94]),
        "slip-runner-unstable": lambda: (runner(0.35, 20000.0, 1800.48), [0.9405]),
        "slip-walker": lambda: (walker(0.3665, 14000.0, 816.0), [-0.156, 0.514, 0.433]),
        "bouncing-ball": lambda: (ball(), [0.5, 0.74]),
        "impact-oscillator-near-grazing": lambda: (oscillator(0.1, 2.8, 1.0, 0.13, 0.8), [-0.0296, 3.088]),
        "wall-pendulum": lambda: (hitting(0.2, -28.0), [0.0925]),
    }
    machine, guess = found[name]()
    state, period = machine.closed(guess, times.get(name, 1))
    return state[[0, 1, 2, 4, 5, 6]] if name == "five-link-walker" else state, period


NAMES = (
    "rimless-wheel", "simplest-walker-long", "simplest-walker-short", "simplest-walker-period-2",
    "simplest-walker-period-4", "compass-gait", "compass-gait-without-hip", "kneed-walker", "five-link-walker",
    "slip-runner-stable", "slip-runner-unstable", "slip-walker", "bouncing-ball",
    "impact-oscillator-near-grazing", "wall-pendulum",
)  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="; ".join(NAMES))
    for one in parser.parse_args().names or NAMES:
        state, period = again(one)
        print(f"{one}: period {period!r}, state {state.tolist()}")
