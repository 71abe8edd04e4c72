"""Systems whose return map is a planted matrix M(s), whatever it is: what families meet on them is known beforehand."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

import orbitfinder as of
from orbitfinder.integrate.compiled import compiling
from orbitfinder.records.family import Family

Map = Callable[..., ca.MX | np.ndarray]
"""M(s), of a number or of CasADi's symbol; of further parameters, M(s, ...)"""


def diagonal(*entries: ca.MX | float) -> ca.MX:
    """A diagonal matrix, symbols among its entries."""
    return ca.diag(ca.vertcat(*entries))


def wound_back(family: Map, size: int, **more: float) -> of.Problem:
    """A clock that is set back after each unit of time, and z = 0 beside it, which M(s) then multiplies.

    The parameter is 1 where s = 0, so that lengths along the family are those of s.
    """
    names = [f"z{k}" for k in range(size)]
    run = of.ode(lambda t, x, p: [1.0 + 0 * p.s, *[0.0] * size], ["clock", *names], {"s": 1.0, **more})

    def reset(x, p):
        z = ca.vertcat(*(x[name] for name in names))
        return [0.0, *ca.vertsplit(family(p.s - 1.0, *(p[name] for name in more)) @ z)]

    back = of.Transition("back", "run", "run", lambda x, p: 1.0 - x.clock, reset)
    return of.Problem(of.hybrid({"run": run}, [back], ["back"]), of.Guess(np.zeros(1 + size), 1.0), name="planted")


def bouncing(family: Map, degrees: int, low: float = 0.0, **more: float) -> of.Problem:
    """A ball that bounces once a second and keeps its energy, and (q, p) = 0 beside it, which a bounce multiplies by
    the symplectic M(s); the parameter is 1 where s = low."""
    names = [[f"{letter}{k}" for k in range(degrees)] for letter in "qp"]
    air = of.hamiltonian(
        lambda x, c: x.v**2 / 2 + 9.8 * x.h + 0 * c.s, ["h", *names[0]], ["v", *names[1]], {"s": 1.0} | more
    )

    def reset(x, c):
        z = ca.vertcat(*(x[name] for each in names for name in each))
        after = ca.vertsplit(family(c.s - 1.0 + low, *(c[name] for name in more)) @ z)
        return [x.h, *after[:degrees], -x.v, *after[degrees:]]

    bounce = of.Transition("bounce", "air", "air", lambda x, c: x.h, reset)
    model = of.hybrid({"air": air}, [bounce], ["bounce"], conserved=["energy"])
    state = np.zeros(2 + 2 * degrees)
    state[1 + degrees] = 4.9
    return of.Problem(model, of.Guess(state, 1.0), of.pin(energy=12.005), name="planted")


def planted(problem: of.Problem, length: float, step: float | None = None, resonances: int = 6) -> Family:
    """The family of a planted system over a length of s, in one step unless it is said how long steps are."""
    settings = of.FamilySettings(directions="forward", certify=False, first_step=step or length,
                                 longest_step=step or length, resonances=resonances)  # fmt: skip
    with compiling("off"):
        return of.follow_family(problem, "s", until=1.0 + length, settings=settings)


def symplectic(matrix: np.ndarray | ca.MX, sign: float = -1.0) -> ca.MX:
    """[[A, B], [B^-1 (A^2 - 1), A^T]] with A (2 x 2), B = diag(1, sign): its indices are 2 eig A.

    A B is symmetric: indices of A that meet have opposite signatures where the sign is -1, and collide.
    """
    b, one = np.diag([1.0, sign]), np.eye(2)
    return ca.blockcat([[matrix, b], [b @ (matrix @ matrix - one), matrix.T]])


def halved(quadratic: Map, degrees: int, low: float = 0.0) -> of.Problem:
    """A circle with period 2 pi that is its own mirror image after half of it, beside it z = (q, p) = 0 with the energy
    z^T S(s) z / (2 pi): its half map is -exp(J S(s)). The parameter is 1 where s = low."""
    names = [[f"{letter}{k}" for k in range(degrees)] for letter in "qp"]

    def energy(x, c):
        z = ca.vertcat(*(x[name] for each in names for name in each))
        return (x.x**2 + x.v**2) / 2 + ca.bilin(quadratic(c.s - 1.0 + low), z, z) / (2 * np.pi)

    model = of.hamiltonian(energy, ["x", *names[0]], ["v", *names[1]], {"s": 1.0})
    guess = of.Guess([1.0, *np.zeros(1 + 2 * degrees)], 2 * np.pi)
    return of.Problem(model, guess, of.pin(energy=0.5), symmetry="reflection", name="planted")
