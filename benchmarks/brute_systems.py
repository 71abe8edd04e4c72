"""The equations of `benchmarks/brute_force.py`: plain NumPy, complex, from their sources and not from orbitfinder.

Six are shipped with orbitfinder as problem files, seven are not and swing by themselves (two of them are systems of
the library); all but the triple pendulum are dissipative.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.brute_force import System

sin, cos, exp, tanh, cosh = np.sin, np.cos, np.exp, np.tanh, np.cosh


def hodgkin_huxley(_: Any, x: np.ndarray, current: Any, s: Any) -> np.ndarray:
    """A. L. Hodgkin, A. F. Huxley, Journal of Physiology 117 (1952) 500-544; mV, ms, rest at -65 mV."""
    v, m, h, n = x

    def ramp(u: Any) -> Any:
        return u / (1 - exp(-u))

    return np.array([
        current - 120 * m**3 * h * (v - 50) - 36 * n**4 * (v + 77) - 0.3 * (v + 54.387),
        ramp((v + 40) / 10) * (1 - m) - 4 * exp(-(v + 65) / 18) * m,
        0.07 * exp(-(v + 65) / 20) * (1 - h) - h / (1 + exp(-(v + 35) / 10)),
        0.1 * ramp((v + 55) / 10) * (1 - n) - 0.125 * exp(-(v + 65) / 80) * n,
    ])  # fmt: skip


def lorenz(_: Any, x: np.ndarray, rho: Any, s: Any) -> np.ndarray:
    """E. N. Lorenz, Journal of the Atmospheric Sciences 20 (1963) 130-141; sigma 10, beta 8/3."""
    return np.array([10.0 * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]])


def duffing(t: Any, x: np.ndarray, frequency: Any, s: Any) -> np.ndarray:
    """x'' + 0.1 x' + x + x^3 = 0.3 cos(w t)."""
    return np.array([x[1], 0.3 * cos(frequency * t) - 0.1 * x[1] - x[0] - x[0] ** 3])


def driven_pendulum(t: Any, x: np.ndarray, torque: Any, s: Any) -> np.ndarray:
    """J. R. Taylor, Classical Mechanics, chapter 12: w0 = 3 pi, 2 b = w0 / 2, the torque in m g l, once a second."""
    w = 3 * np.pi
    return np.array([x[1], w**2 * (torque * cos(2 * np.pi * t) - sin(x[0])) - w / 2 * x[1]])


def coupled_pendula(_: Any, x: np.ndarray, torque: Any, s: Any) -> np.ndarray:
    """D. G. Aronson, E. J. Doedel, H. G. Othmer, Physica D 25 (1987) 20-104; damping 0.1, coupling 0.175."""
    a, b, u, v = x
    return np.array([u, v, torque - 0.1 * u - sin(a) + 0.175 * (b - a), torque - 0.1 * v - sin(b) + 0.175 * (a - b)])


def triple(_: Any, x: np.ndarray, energy: Any, s: Any) -> np.ndarray:
    """Three uniform rods of 1 m and 1 kg, g = 9.8 m/s^2, angles from the downward vertical; s v is the unfolding."""
    q, v = x[:3], x[3:]
    difference = q[:, None] - q[None]
    weights = COUPLED.reshape(3, 3, *[1] * (x.ndim - 1))
    mass = weights * cos(difference)
    bias = np.sum(weights * sin(difference) * v[None] ** 2, axis=1)
    bias = bias + 9.8 * np.array([2.5, 1.5, 0.5]).reshape(3, *[1] * (x.ndim - 1)) * sin(q)
    solved = np.linalg.solve(np.moveaxis(mass, (0, 1), (-2, -1)), -np.moveaxis(bias, 0, -1)[..., None])
    return np.concatenate([v, np.moveaxis(solved[..., 0], -1, 0) + s * v])


COUPLED = np.array([[2 + 1 / 3, 1.5, 0.5], [1.5, 1 + 1 / 3, 0.5], [0.5, 0.5, 1 / 3]])


def triple_energy(x: np.ndarray) -> Any:
    """Zero at the joint."""
    q, v = x[:3], x[3:]
    mass = COUPLED.reshape(3, 3, *[1] * (x.ndim - 1)) * cos(q[:, None] - q[None])
    potential = -9.8 * (2.5 * cos(q[0]) + 1.5 * cos(q[1]) + 0.5 * cos(q[2]))
    return np.einsum("i...,ij...,j...->...", v, mass, v) / 2 + potential


def oscillator(_: Any, x: np.ndarray, mu: Any, s: Any) -> np.ndarray:
    """x'' = -w^2 x + (mu - x^2) x' in SI units, w = 100 1/s."""
    return np.array([x[1], -1e4 * x[0] + (mu - x[0] ** 2) * x[1]])


def morris_lecar(_: Any, x: np.ndarray, current: Any, s: Any) -> np.ndarray:
    """C. Morris, H. Lecar, Biophysical Journal 35 (1981) 193-213, the set with two Hopf points; mV, ms."""
    v, w = x
    opened, wanted = (1 + tanh((v + 1.2) / 18)) / 2, (1 + tanh((v - 2) / 30)) / 2
    membrane = current - 2 * (v + 60) - 4.4 * opened * (v - 120) - 8 * w * (v + 84)
    return np.array([membrane / 20, 0.04 * (wanted - w) * cosh((v - 2) / 60)])


def bonhoeffer(_: Any, x: np.ndarray, a: Any, s: Any) -> np.ndarray:
    """FitzHugh's equations as AUTO's demo fhn has them, b = 0.8, c = 3."""
    return np.array([3 * (x[0] - x[0] ** 3 / 3 + x[1]), -(x[0] - a + 0.8 * x[1]) / 3])


def circuit(_: Any, x: np.ndarray, nu: Any, s: Any) -> np.ndarray:
    """E. Freire's electronic oscillator, AUTO's demo tor: be 0.5, ga -0.6, r 0.6, a3 0.328578, b3 0.933578."""
    u, v, w = x
    cube = 0.933578 * (v - u) ** 3
    return np.array([(-(0.5 + nu) * u + 0.5 * v - 0.328578 * u**3 + cube) / 0.6, 0.5 * u + 0.1 * v - w - cube, v])


def rossler(_: Any, x: np.ndarray, c: Any, s: Any) -> np.ndarray:
    """O. E. Rossler, Physics Letters A 57 (1976) 397-398; a = b = 0.2."""
    return np.array([-x[1] - x[2], x[0] + 0.2 * x[1], 0.2 + x[2] * (x[0] - c)])


def brusselator(_: Any, x: np.ndarray, rate: Any, s: Any) -> np.ndarray:
    """I. Prigogine, R. Lefever, Journal of Chemical Physics 48 (1968) 1695-1700; its Hopf point is at 2 exactly."""
    made = x[0] ** 2 * x[1]
    return np.array([1.0 - (rate + 1) * x[0] + made, rate * x[0] - made])


SPREAD = np.linalg.inv(np.eye(5) * 10 / 12 + (np.eye(5, k=1) + np.eye(5, k=-1)) / 12)
SECOND = SPREAD @ (np.eye(5, k=1) + np.eye(5, k=-1) - 2 * np.eye(5)) * 36
ENDS = SPREAD @ np.array([1.0, 0.0, 0.0, 0.0, 1.0])


def diffusing(_: Any, x: np.ndarray, length: Any, s: Any) -> np.ndarray:
    """The Brusselator along a tube, AUTO's demo brf: A 2, B 5.45, five inner points, compact fourth order."""
    u, v, a, b = x[:5], x[5:], 2.0, 5.45
    shape = (5, *[1] * (x.ndim - 1))
    ends = ENDS.reshape(shape)
    # at the ends u = A and v = B / A, where the reaction's rates vanish
    parts = [
        diffusion / length**2 * (np.tensordot(SECOND, w, 1) + 36 * edge * ends) + rate
        for diffusion, w, edge, rate in (
            (0.008, u, a, u**2 * v - (b + 1) * u + a), (0.004, v, b / a, b * u - u**2 * v),
        )
    ]  # fmt: skip
    return np.concatenate(parts)


def swing() -> tuple[tuple[float, ...], float]:
    """The second linear mode of the triple pendulum at 0.1 rad, in its rest position, and its period."""
    stiffness = 9.8 * np.diag([2.5, 1.5, 0.5])
    squares, modes = np.linalg.eig(np.linalg.solve(COUPLED, stiffness))
    chosen = np.argsort(squares.real)[1]
    mode = modes[:, chosen].real
    return (*(0.1 * mode / np.abs(mode).max()), 0.0, 0.0, 0.0), float(2 * np.pi / np.sqrt(squares[chosen].real))


def small_circuit() -> tuple[tuple[float, ...], float]:
    """A swing of 0.1 about the rest of the circuit near its Hopf point, and its period."""
    values, vectors = np.linalg.eig([[-(0.5 - 0.59) / 0.6, 0.5 / 0.6, 0.0], [0.5, 0.1, -1.0], [0.0, 1.0, 0.0]])
    k = int(np.argmax(values.imag))
    swing = vectors[:, k] / vectors[0, k]
    return tuple(map(float, 0.1 * swing.real)), float(2 * np.pi / values[k].imag)


SHIPPED = (
    System("hodgkin-huxley", hodgkin_huxley, (0.0, 0.592, 0.3, 0.481), 14.6, 10.0, (5.0, 160.0), "current", pieces=32,
           simulate=200.0),
    System("lorenz-doubling", lorenz, (-47.1114, -18.5885, 328.3983), 0.4601, 250.0, (215.0, 260.0), "rho", (-1,),
           simulate=20.0),
    System("duffing-resonance", duffing, (0.5, 0.0), 2 * np.pi / 0.8, 0.8, (0.7, 2.5), "frequency", (1,),
           forcing=lambda w: 2 * np.pi / w),
    System("driven-pendulum", driven_pendulum, (-0.3, 17.0), 1.0, 0.9, (0.8, 1.3), "torque", (1,),
           forcing=lambda p: 1.0 + 0 * p, stride=0.01),
    System("coupled-pendula", coupled_pendula, (0.0, 0.0, 3.32, 3.32), 2.1, 0.3, (0.17, 0.4), "torque", (-1,),
           winding=(2 * np.pi, 2 * np.pi, 0.0, 0.0)),
    System("triple-mode-2", triple, *swing(), -44.0, (-44.1, 0.0), "energy", (1,), energy=triple_energy, twist=-1.0,
           parts=2),
)  # fmt: skip
OWN = (
    System("oscillator in SI", oscillator, (1.4, 0.0), 2 * np.pi / 100, 0.5, (-0.5, 5.0), "mu", simulate=60.0),
    System("Morris-Lecar", morris_lecar, (0.0, 0.1), 60.0, 150.0, (50.0, 250.0), "current", pieces=32, simulate=2000.0),
    System("FitzHugh, AUTO's fhn", bonhoeffer, (1.0, 0.0), 11.0, 0.0, (-0.1, 0.6), "a", (1,), pieces=32,
           simulate=100.0),
    System("circuit, AUTO's tor", circuit, small_circuit()[0], small_circuit()[1], -0.59, (-0.75, -0.5), "nu", pin=0),
    System("Rossler", rossler, (-3.0, 3.0, 0.1), 5.8, 2.5, (1.0, 8.0), "c", simulate=500.0),
    System("Brusselator along a tube, AUTO's brf", diffusing, (2.2,) * 5 + (2.6,) * 5, 3.5, 1.0, (0.55, 2.0), "L",
           pieces=20, simulate=300.0),
    System("Brusselator", brusselator, (1.0, 2.0), 7.2, 3.0, (1.5, 5.0), "rate", simulate=200.0),
)  # fmt: skip
