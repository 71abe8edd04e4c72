"""Systems of one coordinate: the textbook oscillators, free, self-excited and forced."""

from __future__ import annotations

import casadi as ca
import numpy as np

from orbitfinder.mechanics.lagrange import lagrange
from orbitfinder.mechanics.library.ingredients import Ingredients, ingredients
from orbitfinder.mechanics.model import Model


def duffing(stiffness: float = 1.0, cubic: float = 1.0) -> Model:
    """x'' + stiffness x + cubic x^3 = 0: a spring that hardens (cubic > 0) or softens, mass 1.

    With stiffness < 0 < cubic it is the double well. Its period is an elliptic integral (Nayfeh,
    Mook, Nonlinear Oscillations, 1979, section 2.3).
    """
    made = ingredients(1, signed={"stiffness": stiffness, "cubic": cubic})
    q, v = made.q, made.v
    potential = made["stiffness"] * q**2 / 2 + made["cubic"] * q**4 / 4
    return lagrange(
        v**2 / 2, potential, made.symbols(), names=["x"], points=_slider(made), system=made.described("duffing")
    )


def double_well(depth: float = 0.25, distance: float = 1.0) -> Model:
    """Unit mass in V = depth ((x / distance)^2 - 1)^2: minima at +-distance, barrier `depth` J at 0."""
    made = ingredients(1, positive={"depth": depth, "distance": distance})
    potential = made["depth"] * ((made.q / made["distance"]) ** 2 - 1) ** 2
    return lagrange(
        made.v**2 / 2,
        potential,
        made.symbols(),
        names=["x"],
        points=_slider(made),
        system=made.described("double_well"),
    )


def van_der_pol(damping: float = 1.0) -> Model:
    """x'' - damping (1 - x^2) x' + x = 0: one attracting limit cycle, no first integral.

    Source: B. van der Pol, Philosophical Magazine 2 (1926) 978-992.
    """
    made = ingredients(1, signed={"damping": damping})
    q, v = made.q, made.v
    return lagrange(
        v**2 / 2,
        q**2 / 2,
        made.symbols(),
        forces=made["damping"] * (1 - q**2) * v,
        names=["x"],
        points=_slider(made),
        system=made.described("van_der_pol"),
    )


def forced_duffing(
    stiffness: float = 1.0, cubic: float = 1.0, damping: float = 0.1, force: float = 0.3, frequency: float = 1.2
) -> Model:
    """x'' + damping x' + stiffness x + cubic x^3 = force cos(frequency t), frequency in rad/s.

    Source: J. Guckenheimer, P. Holmes, Nonlinear Oscillations, Dynamical Systems, and Bifurcations
    of Vector Fields (1983), section 2.2.
    """
    made = ingredients(
        1, {"frequency": frequency}, {"stiffness": stiffness, "cubic": cubic, "damping": damping, "force": force}
    )
    q, v = made.q, made.v
    potential = made["stiffness"] * q**2 / 2 + made["cubic"] * q**4 / 4
    push = made["force"] * ca.cos(made["frequency"] * made.t) - made["damping"] * v
    return lagrange(
        v**2 / 2,
        potential,
        made.symbols(2 * np.pi / made["frequency"]),
        forces=push,
        names=["x"],
        points=_slider(made),
        system=made.described("forced_duffing"),
    )


def forced_pendulum(
    length: float = 1.0,
    mass: float = 1.0,
    gravity: float = 9.8,
    damping: float = 0.5,
    torque: float = 2.0,
    frequency: float = 2.0,
) -> Model:
    """m l^2 theta'' + damping theta' + m g l sin(theta) = torque cos(frequency t), a point mass on a rod."""
    made = ingredients(
        1,
        {"length": length, "mass": mass, "frequency": frequency},
        {"gravity": gravity, "damping": damping, "torque": torque},
    )
    q, v, arm = made.q, made.v, made["length"]
    kinetic, potential = made["mass"] * (arm * v) ** 2 / 2, -made["mass"] * made["gravity"] * arm * ca.cos(q)
    drive = made["torque"] * ca.cos(made["frequency"] * made.t) - made["damping"] * v
    return lagrange(
        kinetic,
        potential,
        made.symbols(2 * np.pi / made["frequency"]),
        forces=drive,
        names=["theta"],
        angles=[True],
        points=_rod(made),
        system=made.described("forced_pendulum"),
    )


def vibrated_pendulum(
    length: float = 1.0,
    gravity: float = 9.8,
    damping: float = 0.1,
    amplitude: float = 0.1,
    frequency: float = 60.0,
) -> Model:
    """A pendulum (unit mass) whose pivot is shaken vertically by amplitude cos(frequency t), in m and rad/s.

    The pivot's motion enters through the kinetic energy. Above frequency x amplitude =
    sqrt(2 g l) the upright position is stable: P. L. Kapitza, Soviet Physics JETP 21 (1951) 588.
    """
    made = ingredients(
        1,
        {"length": length, "frequency": frequency},
        {"gravity": gravity, "damping": damping, "amplitude": amplitude},
    )
    q, v, arm = made.q, made.v, made["length"]
    pivot = made["amplitude"] * ca.cos(made["frequency"] * made.t)
    place = ca.vertcat(pivot + arm * ca.cos(q), arm * ca.sin(q))
    velocity = ca.jtimes(place, q, v) + ca.jacobian(place, made.t)
    return lagrange(
        ca.sumsqr(velocity) / 2,
        -made["gravity"] * place[0],
        made.symbols(2 * np.pi / made["frequency"]),
        forces=-made["damping"] * v,
        names=["theta"],
        angles=[True],
        points=_rod(made),
        system=made.described("vibrated_pendulum"),
    )


def rotating_hoop(radius: float = 1.0, mass: float = 1.0, gravity: float = 9.8, spin: float = 4.0) -> Model:
    """A bead on a vertical hoop that turns at `spin` rad/s: T = m r^2 (theta'^2 + spin^2 sin^2 theta) / 2.

    What is conserved is the Jacobi integral, not the energy (Goldstein, Classical Mechanics,
    section 2.7). Above spin = sqrt(g / r) the bottom is unstable.
    """
    made = ingredients(1, {"radius": radius, "mass": mass}, {"gravity": gravity, "spin": spin})
    q, v, r = made.q, made.v, made["radius"]
    kinetic = made["mass"] * r**2 * (v**2 + (made["spin"] * ca.sin(q)) ** 2) / 2
    weight = -made["mass"] * made["gravity"] * r * ca.cos(q)
    return lagrange(
        kinetic,
        weight,
        made.symbols(),
        names=["theta"],
        angles=[True],
        points=r * ca.horzcat(ca.SX.zeros(2), ca.vertcat(ca.cos(q), ca.sin(q))),
        system=made.described("rotating_hoop"),
    )


def _slider(made: Ingredients) -> ca.SX:
    return ca.horzcat(ca.SX.zeros(2), ca.vertcat(0, made.q))


def _rod(made: Ingredients) -> ca.SX:
    return made["length"] * ca.horzcat(ca.SX.zeros(2), ca.vertcat(ca.cos(made.q), ca.sin(made.q)))
