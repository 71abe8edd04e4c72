"""The hybrid orbits of problems/hybrid computed a second time, without the package: SciPy's solve_ivp with events and
Newton's method on the return map by differences.

Equations are written out here again: legs as point masses on massless links, M from Jacobians; impacts as one linear
system of M and the contact Jacobian. `python benchmarks/hybrid_gaits.py [NAME...]` prints states and periods.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

Vector = np.ndarray
TIGHT = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
LONGEST = 60.0


@dataclass(frozen=True)
class Piece:
    """x' = field(x) until guard(x) crosses 0 in its direction after `least` s, and what follows."""

    field: Callable[[Vector], Any]
    guard: Callable[[Vector], float]
    direction: int
    reset: Callable[[Vector], Any]
    counts: Callable[[Vector], bool] = lambda x: True


def arc(piece: Piece, x: Vector) -> tuple[Vector, float]:
    """The state after the event of a piece, and how long it took."""
    spent = 0.0
    while spent < LONGEST:
        moment = 1e-6  # off the guard that the piece may begin on
        x = solve_ivp(lambda t, y: piece.field(y), (0, moment), x, **TIGHT).y[:, -1]

        def event(t: float, y: Vector) -> float:
            return piece.guard(y)

        event.terminal, event.direction = True, piece.direction  # type: ignore[attr-defined]
        found = solve_ivp(lambda t, y: piece.field(y), (0, LONGEST), x, events=event, **TIGHT)
        spent += moment + found.t[-1]
        x = found.y[:, -1]
        if found.status == 1 and piece.counts(x):
            return np.asarray(piece.reset(x), float), spent
    raise RuntimeError("no event")


def cycle(pieces: Sequence[Piece], x: Vector) -> tuple[Vector, float]:
    """The state after all pieces, and how long they took."""
    spent = 0.0
    for piece in pieces:
        x, duration = arc(piece, x)
        spent += duration
    return x, spent


def fixed_point(pieces: Sequence[Piece], lift: Callable[[Vector], Any], z: Sequence[float]) -> tuple[Vector, float]:
    """The periodic state lift(z) and its period; `lift` puts the numbers sought on the section."""

    def miss(z: Vector) -> Vector:
        x = np.asarray(lift(z), float)
        gaps = cycle(pieces, x)[0] - x
        return np.asarray(np.linalg.lstsq(derivative(lift, z), gaps, rcond=None)[0])

    found, _, _, message = fsolve(miss, z, xtol=1e-13, epsfcn=1e-14, full_output=True)
    x = np.asarray(lift(found), float)
    end, period = cycle(pieces, x)
    if np.abs(end - x).max() > 1e-8:
        raise RuntimeError(f"did not close: {np.abs(end - x).max():.1e}, {message}")
    return x, period


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


def compass(slope: float, hip: float, times: int = 1) -> tuple[list[Piece], Callable[[Vector], Any]]:
    a = b = 0.5
    masses = [(5.0, (a, 0.0)), (hip, (a + b, 0.0)), (5.0, (a + b, -b))]
    after = struck(masses, (1.0, -1.0))

    def reset(x: Vector) -> list[float]:
        rates = after(x)
        return [x[1], x[0], rates[1], rates[0]]

    step = Piece(swing(masses, 9.81), lambda x: x[0] + x[1] + 2 * slope, -1, reset, lambda x: x[1] > x[0])
    return [step] * times, lambda z: [z[0], -z[0] - 2 * slope, z[1], z[2]]


def kneed(slope: float = 0.0504) -> tuple[list[Piece], Callable[[Vector], Any]]:
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
    return pieces, lambda z: [z[0], -z[0] - 2 * slope, -z[0] - 2 * slope, z[1], z[2], z[2]]


def five_links(slope: float = 0.0504) -> tuple[list[Piece], Callable[[Vector], Any]]:
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
    return pieces, lambda z: [z[0], swung - z[0], swung - z[0], -slope, z[1], z[2], z[2], (z[1] + z[2]) / 2]


# -- the others --------------------------------------------------------------------------------------------------------


def simplest(slope: float, times: int = 1) -> tuple[list[Piece], Callable[[Vector], Any]]:
    def field(x: Vector) -> list[float]:
        theta, phi, rate, swinging = x
        tilt = theta - slope
        return [rate, swinging, np.sin(tilt), np.sin(tilt) + rate**2 * np.sin(phi) - np.cos(tilt) * np.sin(phi)]

    def reset(x: Vector) -> list[float]:
        turn = np.cos(2 * x[0])
        return [-x[0], -2 * x[0], turn * x[2], turn * (1 - turn) * x[2]]

    step = Piece(field, lambda x: x[1] - 2 * x[0], 1, reset, lambda x: x[0] < 0)
    return [step] * times, lambda z: [z[0], 2 * z[0], z[1], (1 - np.cos(2 * z[0])) * z[1]]


def wheel(slope: float = 0.08, spokes: int = 8) -> tuple[list[Piece], Callable[[Vector], Any]]:
    half = np.pi / spokes
    step = Piece(
        lambda x: [x[1], 9.81 * np.sin(x[0])], lambda x: x[0] - slope - half, 1,
        lambda x: [x[0] - 2 * half, np.cos(2 * half) * x[1]],
    )  # fmt: skip
    return [step], lambda z: [slope - half, z[0]]


def runner(attack: float, stiffness: float, energy: float) -> tuple[list[Piece], Callable[[Vector], Any]]:
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
    return pieces, lambda z: [0.0, z[0], np.sqrt(2 * (energy / 80.0 - 9.81 * z[0])), 0.0]


def walker(attack: float, stiffness: float, energy: float) -> tuple[list[Piece], Callable[[Vector], Any]]:
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
    return pieces, lift


def oscillator(
    damping: float, frequency: float, force: float, stop: float, e: float
) -> tuple[list[Piece], Callable[[Vector], Any]]:
    """x, v, phase; the period is a whole number of the forcing's, the phase is left to turn."""
    free = Piece(
        lambda x: [x[1], force * np.cos(x[2]) - damping * x[1] - x[0], frequency], lambda x: x[0] - stop, 1,
        lambda x: [stop, -e * x[1], np.angle(np.exp(1j * x[2]))],
    )  # fmt: skip
    return [free], lambda z: [stop, z[0], z[1]]


def ball(amplitude: float = 0.012) -> tuple[list[Piece], Callable[[Vector], Any]]:
    turn = 2 * np.pi

    def reset(x: Vector) -> list[float]:
        speed = 1.8 * amplitude * turn * np.cos(x[2]) - 0.8 * x[1]
        return [x[0], speed, np.angle(np.exp(1j * x[2]))]

    air = Piece(lambda x: [x[1], -1.0, turn], lambda x: x[0] - amplitude * np.sin(x[2]), -1, reset)
    return [air], lambda z: [amplitude * np.sin(z[1]), z[0], z[1]]


def hitting(wall: float, energy: float) -> tuple[list[Piece], Callable[[Vector], Any]]:
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

    return [Piece(field, lambda x: np.sin(x[0]) + np.sin(x[1]) - wall, 1, reset)], lift


def again(name: str) -> tuple[Vector, float]:
    """The state and the period of the orbit of problems/hybrid/NAME.toml."""
    degrees = np.pi / 180
    found: dict[str, Callable[[], tuple[Any, Sequence[float]]]] = {
        "rimless-wheel": lambda: (wheel(), [1.1]),
        "simplest-walker-long": lambda: (simplest(0.009), [0.2, -0.2]),
        "simplest-walker-short": lambda: (simplest(0.009), [0.19394, -0.20387]),
        "simplest-walker-period-2": lambda: (simplest(0.017, 2), [0.2535, -0.2452]),
        "simplest-walker-period-4": lambda: (simplest(0.018, 4), [0.2598, -0.2505]),
        "compass-gait": lambda: (compass(3 * degrees, 10.0), [0.2187, -1.092, -0.377]),
        "compass-gait-without-hip": lambda: (compass(0.03, 0.0), [0.08, -0.03, 2.3]),
        "kneed-walker": lambda: (kneed(), [0.1882, -1.11, -0.057]),
        "five-link-walker": lambda: (five_links(), [0.2237, -1.093, -0.281]),
        "slip-runner-stable": lambda: (runner(0.384, 20000.0, 1784.8), [0.94]),
        "slip-runner-unstable": lambda: (runner(0.35, 20000.0, 1800.48), [0.9405]),
        "slip-walker": lambda: (walker(0.3665, 14000.0, 816.0), [-0.156, 0.514, 0.433]),
        "bouncing-ball": lambda: (ball(), [0.5, 0.74]),
        "impact-oscillator-near-grazing": lambda: (oscillator(0.1, 2.8, 1.0, 0.13, 0.8), [-0.0296, 3.088]),
        "wall-pendulum": lambda: (hitting(0.2, -28.0), [0.0925]),
    }
    (pieces, lift), guess = found[name]()
    state, period = fixed_point(pieces, lift, guess)
    return state[[0, 1, 2, 4, 5, 6]] if name == "five-link-walker" else state, period


NAMES = (
    "rimless-wheel", "simplest-walker-long", "simplest-walker-short", "simplest-walker-period-2",
    "simplest-walker-period-4", "compass-gait", "compass-gait-without-hip", "kneed-walker", "five-link-walker",
    "slip-runner-stable", "slip-runner-unstable", "slip-walker", "bouncing-ball",
    "impact-oscillator-near-grazing", "wall-pendulum",
)  # fmt: skip


if __name__ == "__main__":
    for one in sys.argv[1:] or NAMES:
        state, period = again(one)
        print(f"{one}: period {period!r}, state {state.tolist()}")
