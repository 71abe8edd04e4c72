"""Systems of several coordinates: swinging spring, carts, and particles in a plane."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from orbitfinder.mechanics.lagrange import lagrange
from orbitfinder.mechanics.library.ingredients import ingredients, whole
from orbitfinder.mechanics.model import Model

MOST_CARTS = 200


def spring_pendulum(length: float = 1.0, mass: float = 1.0, stiffness: float = 29.4, gravity: float = 9.8) -> Model:
    """The swinging spring: a mass on a massless spring of natural length `length` (m) in a vertical plane.

    Coordinates x (down) and y (right) of the mass, in m. At stiffness = 3 m g / l the bounce is
    twice as fast as the swing and each feeds the other: P. Lynch, "Resonant motions of the
    three-dimensional elastic pendulum", Int. J. Non-Linear Mechanics 37 (2002) 345-367.
    """
    made = ingredients(2, {"length": length, "mass": mass, "stiffness": stiffness}, {"gravity": gravity})
    q, v = made.q, made.v
    stretch = ca.norm_2(q) - made["length"]
    potential = made["stiffness"] * stretch**2 / 2 - made["mass"] * made["gravity"] * q[0]
    return lagrange(
        made["mass"] * ca.sumsqr(v) / 2,
        potential,
        made.symbols(),
        names=["x", "y"],
        points=ca.horzcat(ca.SX.zeros(2), q),
        centres=q,
        system=made.described("spring_pendulum"),
    )


def pendulum_on_cart(
    cart: float = 1.0, mass: float = 1.0, length: float = 1.0, gravity: float = 9.8, stiffness: float = 0.0
) -> Model:
    """A point mass on a rod of `length` (m) that hangs from a cart (mass `cart`, kg) on a level track.

    Coordinates y (the cart, m, to the right) and theta (the rod, rad). `stiffness` (N/m) ties the
    cart to its place; without it the horizontal momentum is conserved as well as the energy.
    """
    tied = {} if stiffness == 0 else {"stiffness": stiffness}
    made = ingredients(2, {"cart": cart, "mass": mass, "length": length, **tied}, {"gravity": gravity})
    q, v, arm = made.q, made.v, made["length"]
    bob = ca.vertcat(arm * ca.cos(q[1]), q[0] + arm * ca.sin(q[1]))
    kinetic = made["cart"] * v[0] ** 2 / 2 + made["mass"] * ca.sumsqr(ca.jtimes(bob, q, v)) / 2
    potential = -made["mass"] * made["gravity"] * bob[0]
    if tied:
        potential += made["stiffness"] * q[0] ** 2 / 2
    return lagrange(
        kinetic,
        potential,
        made.symbols(),
        names=["y", "theta"],
        angles=[False, True],
        points=ca.horzcat(ca.vertcat(0, q[0]), bob),
        system=made.described("pendulum_on_cart"),
    )


def cart_chain(
    carts: int = 3, mass: float = 1.0, stiffness: float = 1.0, cubic: float = 0.0, quadratic: float = 0.0
) -> Model:
    """`carts` equal carts on a track between two walls, joined by equal springs.

    Each spring has energy stiffness s^2 / 2 + quadratic s^3 / 3 + cubic s^4 / 4 in its stretch s:
    with `cubic` the beta-chain of E. Fermi, J. Pasta, S. Ulam, Los Alamos report LA-1940 (1955).
    """
    count = whole("carts", carts, MOST_CARTS)
    made = ingredients(count, {"mass": mass, "stiffness": stiffness}, {"cubic": cubic, "quadratic": quadratic})
    q = made.q
    stretch = ca.vertcat(q, 0) - ca.vertcat(0, q)
    potential = ca.sum1(
        made["stiffness"] * stretch**2 / 2 + made["quadratic"] * stretch**3 / 3 + made["cubic"] * stretch**4 / 4
    )
    places = ca.vertcat(0, q, 0) + ca.SX(range(count + 2))
    return lagrange(
        made["mass"] * ca.sumsqr(made.v) / 2,
        potential,
        made.symbols(),
        names=[f"y{i + 1}" for i in range(count)],
        points=ca.horzcat(ca.SX.zeros(count + 2), places).T,
        system=made.described("cart_chain", carts=count),
    )


def henon_heiles(coupling: float = 1.0) -> Model:
    """H = (px^2 + py^2 + x^2 + y^2) / 2 + coupling (x^2 y - y^3 / 3); with coupling 1 it escapes at 1/6.

    Source: M. Henon, C. Heiles, Astronomical Journal 69 (1964) 73-79.
    """
    made = ingredients(2, signed={"coupling": coupling})
    x, y = made.q[0], made.q[1]
    potential = ca.sumsqr(made.q) / 2 + made["coupling"] * (x**2 * y - y**3 / 3)
    return lagrange(
        ca.sumsqr(made.v) / 2,
        potential,
        made.symbols(),
        names=["x", "y"],
        points=ca.vertcat(-y, x),
        centres=ca.vertcat(-y, x),
        system=made.described("henon_heiles"),
    )


def restricted_three_body(ratio: float = 0.012277471) -> Model:
    """A light body near two heavy ones (masses 1 - ratio and ratio) on circles, in their rotating frame.

    T = ((x' - y)^2 + (y' + x)^2) / 2, V = -(1 - ratio) / r1 - ratio / r2, heavy bodies at (-ratio, 0)
    and (1 - ratio, 0): the kinetic energy has terms linear in the rates, and what is conserved is the
    Jacobi integral. Orbits may have the symmetry "mirror": x(-t) = x(t), y(-t) = -y(t).
    Source: V. Szebehely, Theory of Orbits (1967), section 1.5; units there.
    """
    made = ingredients(2, {"ratio": ratio})
    (x, y), (u, w), small = (made.q[0], made.q[1]), (made.v[0], made.v[1]), made["ratio"]
    kinetic = ((u - y) ** 2 + (w + x) ** 2) / 2
    potential = -(1 - small) / ca.sqrt((x + small) ** 2 + y**2) - small / ca.sqrt((x - 1 + small) ** 2 + y**2)
    model = lagrange(
        kinetic,
        potential,
        made.symbols(),
        names=["x", "y"],
        points=ca.vertcat(-y, x),
        system=made.described("restricted_three_body"),
    )
    return replace(model, symmetries=(("mirror", -1, (1, -1)),))


def planar_oscillator(stiffness_x: float = 1.0, stiffness_y: float = 2.0, quartic: float = 1.0) -> Model:
    """Unit mass in V = (a x^2 + b y^2) / 2 + quartic x^2 y^2: two springs coupled at fourth order."""
    made = ingredients(2, {"stiffness_x": stiffness_x, "stiffness_y": stiffness_y}, {"quartic": quartic})
    x, y = made.q[0], made.q[1]
    potential = (made["stiffness_x"] * x**2 + made["stiffness_y"] * y**2) / 2 + made["quartic"] * (x * y) ** 2
    return lagrange(
        ca.sumsqr(made.v) / 2,
        potential,
        made.symbols(),
        names=["x", "y"],
        points=ca.vertcat(-y, x),
        system=made.described("planar_oscillator"),
    )
