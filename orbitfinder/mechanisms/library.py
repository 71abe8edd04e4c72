"""Built-in systems, for problem files with kind = "python" and for Python: each function returns a Model.

Only what is listed in `FUNCTIONS` can be named in a problem file without --trust.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import brentq

from orbitfinder.errors import InputError
from orbitfinder.mechanics.first_order import Named, hamiltonian, ode
from orbitfinder.mechanics.kind import BUILT_IN
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.model import Model, altered, finite_number


@dataclass(frozen=True)
class Ingredients:
    """Symbols of a system: coordinates q, velocities v, time t and parameters by name with their values."""

    q: ca.SX
    v: ca.SX
    t: ca.SX
    values: Mapping[str, float]
    parameters: ca.SX
    controls: tuple[str, ...] = ()
    """parameters that are no arguments of the function: what varies in time, 0 without"""

    def __getattr__(self, name: str) -> Any:
        """The symbol of a parameter."""
        return self.parameters[list(self.values).index(name)]

    def model(self, function: str, kinetic: ca.SX, potential: ca.SX, *, fixed: Any = None, **parts: Any) -> Model:
        """The Model of these energies, described so that a file can have it rebuilt.

        `fixed` are arguments that are no parameters, `parts` those of `lagrange`; a frequency is the forcing's.
        """
        names, values = tuple(self.values), tuple(self.values.values())
        clock = 2 * np.pi / self.frequency if "frequency" in self.values else None
        symbols = Symbols(self.q, self.v, self.parameters, names, values, self.t, clock)
        system = self._described(function, fixed)
        return lagrange(kinetic, potential, symbols, system=system, **parts)

    def first_order(self, function: str, field: Any, states: Sequence[str], **parts: Any) -> Model:
        """The Model of x' = field(t, x, p), described likewise; `parts` are those of `ode`."""
        return ode(field, states, self.values, system=self._described(function), **parts)

    def canonical(
        self, function: str, energy: Any, coordinates: Sequence[str], momenta: Sequence[str], **parts: Any
    ) -> Model:
        """The Model of Hamilton's equations of energy(x, p), described likewise; `parts` are those of `hamiltonian`."""
        return hamiltonian(energy, coordinates, momenta, self.values, system=self._described(function), **parts)

    def _described(self, function: str, fixed: Any = None) -> dict[str, Any]:
        arguments = {**(fixed or {}), **{k: value for k, value in self.values.items() if k not in self.controls}}
        return {"kind": "python", "module": BUILT_IN, "function": function, "arguments": arguments}


def ingredients(
    count: int, given: Mapping[str, Any], positive: Sequence[str] = (), controls: tuple[str, ...] = ()
) -> Ingredients:
    """Symbols for `count` coordinates and the parameters given, the positive ones first; `InputError` for a number that
    cannot be meant. A function whose arguments are all parameters gives its `locals()`."""
    values = {}
    for name in dict.fromkeys([*positive, *given]):
        values[name] = finite_number(f"system.arguments.{name}", value := given[name])
        if name in positive and value <= 0:
            raise InputError(f"system.arguments.{name}: must be positive, got {value!r}; check the sign and the unit")
    values |= dict.fromkeys(controls, 0.0)
    return Ingredients(
        ca.SX.sym("q", count), ca.SX.sym("v", count), ca.SX.sym("t"), values, ca.SX.sym("p", len(values)), controls
    )


def whole_number(name: str, value: int, most: int) -> int:
    """A count between 1 and `most`, or `InputError`."""
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
        raise InputError(f"system.arguments.{name}: must be a whole number from 1 to {most}, got {value!r}")
    return value


SPRUNG = (("ground", (0,)), ("spring", (0, 1)), ("rod", (1,)))
TIED = (("ground", (0,)), ("spring", (0, 1)), ("slider", (1,)))
"""What is drawn: a mass on a spring that hangs, one on a track"""


def duffing(stiffness: float = 1.0, cubic: float = 1.0) -> Model:
    """x'' + stiffness x + cubic x^3 = 0: a spring that hardens (cubic > 0) or softens, mass 1.

    With stiffness < 0 < cubic it is the double well. Its period is an elliptic integral (Nayfeh,
    Mook, Nonlinear Oscillations, 1979, section 2.3).
    """
    made = ingredients(1, locals())
    q, v = made.q, made.v
    potential = made.stiffness * q**2 / 2 + made.cubic * q**4 / 4
    return made.model("duffing", v**2 / 2, potential, names=["x"], points=_slider(made), strokes=TIED)


def double_well(depth: float = 0.25, distance: float = 1.0) -> Model:
    """Unit mass in V = depth ((x / distance)^2 - 1)^2: minima at +-distance, barrier `depth` J at 0."""
    made = ingredients(1, locals(), ("depth", "distance"))
    potential = made.depth * ((made.q / made.distance) ** 2 - 1) ** 2
    return made.model("double_well", made.v**2 / 2, potential, names=["x"], points=_slider(made), strokes=TIED)


def van_der_pol(damping: float = 1.0) -> Model:
    """x'' - damping (1 - x^2) x' + x = 0: one attracting limit cycle, no first integral.

    Source: B. van der Pol, Philosophical Magazine 2 (1926) 978-992.
    """
    made = ingredients(1, locals())
    q, v = made.q, made.v
    return made.model(
        "van_der_pol",
        v**2 / 2,
        q**2 / 2,
        forces=made.damping * (1 - q**2) * v,
        names=["x"],
        points=_slider(made),
        strokes=TIED,
    )


def forced_duffing(
    stiffness: float = 1.0, cubic: float = 1.0, damping: float = 0.1, force: float = 0.3, frequency: float = 1.2
) -> Model:
    """x'' + damping x' + stiffness x + cubic x^3 = force cos(frequency t), frequency in rad/s.

    Source: J. Guckenheimer, P. Holmes, Nonlinear Oscillations, Dynamical Systems, and Bifurcations
    of Vector Fields (1983), section 2.2.
    """
    made = ingredients(1, locals(), ("frequency",))
    q, v = made.q, made.v
    potential = made.stiffness * q**2 / 2 + made.cubic * q**4 / 4
    push = made.force * ca.cos(made.frequency * made.t) - made.damping * v
    return made.model(
        "forced_duffing", v**2 / 2, potential, forces=push, names=["x"], points=_slider(made), strokes=TIED
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
    made = ingredients(1, locals(), ("length", "mass", "frequency"))
    q, v, arm = made.q, made.v, made.length
    kinetic, potential = made.mass * (arm * v) ** 2 / 2, -made.mass * made.gravity * arm * ca.cos(q)
    drive = made.torque * ca.cos(made.frequency * made.t) - made.damping * v
    return made.model(
        "forced_pendulum", kinetic, potential, forces=drive, names=["theta"], angles=[True], points=_rod(made)
    )


def coupled_pendula(damping: float = 0.1, torque: float = 0.2, coupling: float = 0.175) -> Model:
    """theta_i'' + damping theta_i' + sin(theta_i) = torque + coupling (theta_j - theta_i): two pendula, or junctions.

    Driven hard enough they run round together. Source: D. G. Aronson, E. J. Doedel, H. G. Othmer, Physica D 25 (1987)
    20-104; the demo `pen` of AUTO, where damping is eps, torque I and coupling gamma.
    """
    made = ingredients(2, locals())
    q, v = made.q, made.v
    potential = -ca.sum1(ca.cos(q)) + made.coupling * (q[0] - q[1]) ** 2 / 2
    push = made.torque - made.damping * v
    return made.model("coupled_pendula", ca.sumsqr(v) / 2, potential, forces=push, angles=[True, True])


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
    made = ingredients(1, locals(), ("length", "frequency"))
    q, v, arm = made.q, made.v, made.length
    pivot = made.amplitude * ca.cos(made.frequency * made.t)
    place = ca.vertcat(pivot + arm * ca.cos(q), arm * ca.sin(q))
    velocity = ca.jtimes(place, q, v) + ca.jacobian(place, made.t)
    return made.model(
        "vibrated_pendulum", ca.sumsqr(velocity) / 2, -made.gravity * place[0], forces=-made.damping * v,
        names=["theta"], angles=[True], points=_rod(made),
    )  # fmt: skip


def rotating_hoop(radius: float = 1.0, mass: float = 1.0, gravity: float = 9.8, spin: float = 4.0) -> Model:
    """A bead on a vertical hoop that turns at `spin` rad/s: T = m r^2 (theta'^2 + spin^2 sin^2 theta) / 2.

    What is conserved is the Jacobi integral, not the energy (Goldstein, Classical Mechanics,
    section 2.7). Above spin = sqrt(g / r) the bottom is unstable.
    """
    made = ingredients(1, locals(), ("radius", "mass"))
    q, v, r = made.q, made.v, made.radius
    kinetic = made.mass * r**2 * (v**2 + (made.spin * ca.sin(q)) ** 2) / 2
    weight = -made.mass * made.gravity * r * ca.cos(q)
    return made.model(
        "rotating_hoop", kinetic, weight, names=["theta"], angles=[True], points=r * ca.horzcat(ca.SX.zeros(2),
        ca.vertcat(ca.cos(q), ca.sin(q))), strokes=(("disc", (0, 1)), ("rod", (1,))),
    )  # fmt: skip


def _slider(made: Ingredients) -> ca.SX:
    return ca.horzcat(ca.SX.zeros(2), ca.vertcat(0, made.q))


def _rod(made: Ingredients) -> ca.SX:
    return made.length * ca.horzcat(ca.SX.zeros(2), ca.vertcat(ca.cos(made.q), ca.sin(made.q)))


def spring_pendulum(length: float = 1.0, mass: float = 1.0, stiffness: float = 29.4, gravity: float = 9.8) -> Model:
    """The swinging spring: a mass on a massless spring of natural length `length` (m) in a vertical plane.

    Coordinates x (down) and y (right) of the mass, in m. At stiffness = 3 m g / l the bounce is
    twice as fast as the swing and each feeds the other: P. Lynch, "Resonant motions of the
    three-dimensional elastic pendulum", Int. J. Non-Linear Mechanics 37 (2002) 345-367.
    """
    made = ingredients(2, locals(), ("length", "mass", "stiffness"))
    q, v = made.q, made.v
    stretch = ca.norm_2(q) - made.length
    potential = made.stiffness * stretch**2 / 2 - made.mass * made.gravity * q[0]
    return made.model(
        "spring_pendulum", made.mass * ca.sumsqr(v) / 2, potential, names=["x", "y"],
        points=ca.horzcat(ca.SX.zeros(2), q), centres=q, strokes=SPRUNG,
    )  # fmt: skip


def spherical_pendulum(length: float = 1.0, mass: float = 1.0, gravity: float = 9.8) -> Model:
    """A point mass on a rod of `length` (m) that swings any way: theta from the downward vertical, phi about it (rad).

    Nothing depends on phi, so that the momentum about the vertical is conserved: orbits are relative in it, or turn
    whole times. Period and turn of a swing are elliptic integrals (E. T. Whittaker, Analytical Dynamics, section 55).
    """
    made = ingredients(2, locals(), ("length", "mass"))
    (theta, phi), (u, w), arm = (made.q[0], made.q[1]), (made.v[0], made.v[1]), made.length
    kinetic = made.mass * arm**2 * (u**2 + (ca.sin(theta) * w) ** 2) / 2
    bob = arm * ca.vertcat(ca.cos(theta), ca.sin(theta) * ca.cos(phi), ca.sin(theta) * ca.sin(phi))
    return made.model(
        "spherical_pendulum", kinetic, -made.mass * made.gravity * bob[0], names=["theta", "phi"],
        angles=[True, True], points=ca.horzcat(ca.SX.zeros(3), bob), centres=bob[:2],
        strokes=(("ground", (0,)), ("rod", (0, 1))),
    )  # fmt: skip


def swinging_spring(length: float = 1.0, mass: float = 1.0, stiffness: float = 29.4, gravity: float = 9.8) -> Model:
    """A mass on a massless spring of natural length `length` (m) that swings any way, in cylinder coordinates.

    z (m, down), r (m, from the vertical axis) and phi (rad, about it); the momentum about the axis is conserved, and
    keeps r from 0. In its vertical plane it is `spring_pendulum`, where P. Lynch is quoted.
    """
    made = ingredients(3, locals(), ("length", "mass", "stiffness"))
    (z, r, phi), v = (made.q[0], made.q[1], made.q[2]), made.v
    stretch = ca.sqrt(z**2 + r**2) - made.length
    bob = ca.vertcat(z, r * ca.cos(phi), r * ca.sin(phi))
    return made.model(
        "swinging_spring", made.mass * (v[0] ** 2 + v[1] ** 2 + (r * v[2]) ** 2) / 2,
        made.stiffness * stretch**2 / 2 - made.mass * made.gravity * z, names=["z", "r", "phi"],
        angles=[False, False, True], points=ca.horzcat(ca.SX.zeros(3), bob), centres=bob[:2], strokes=SPRUNG,
    )  # fmt: skip


def turning_three_bodies(mass1: float = 1.0, mass2: float = 1.0, mass3: float = 1.0, gravitation: float = 1.0) -> Model:
    """Three point masses that attract each other in a plane, in a frame that turns with two of them.

    r and phi: distance and direction of the second from the first (m, rad), which never meet; u and w: the third from
    the centre of mass of these two, along their line and across it; the centre of mass of all is at rest. Nothing
    depends on phi, whose momentum is the angular momentum, so that orbits are periodic up to a rotation.
    Source: E. T. Whittaker, Analytical Dynamics, chapter 13.
    """
    made = ingredients(4, locals(), tuple(locals()))
    (r, phi, u, w), v = ca.vertsplit(made.q), made.v
    m1, m2, m3 = (getattr(made, f"mass{k}") for k in (1, 2, 3))
    pair = m1 + m2
    first, second = -m2 / pair * r, m1 / pair * r
    kinetic = m1 * m2 / pair * (v[0] ** 2 + (r * v[1]) ** 2) / 2
    kinetic += m3 * pair / (pair + m3) * ((v[2] - v[1] * w) ** 2 + (v[3] + v[1] * u) ** 2) / 2
    near, far = (ca.sqrt((u - place) ** 2 + w**2) for place in (first, second))
    turn = ca.vertcat(ca.horzcat(ca.cos(phi), -ca.sin(phi)), ca.horzcat(ca.sin(phi), ca.cos(phi)))
    places = turn @ ca.horzcat(ca.vertcat(first, 0), ca.vertcat(second, 0), ca.vertcat(u, w))
    places -= ca.repmat(places @ ca.vertcat(m1, m2, m3) / (pair + m3), 1, 3)
    pull = m1 * m2 / r + m1 * m3 / near + m2 * m3 / far
    return made.model(
        "turning_three_bodies", kinetic, -made.gravitation * pull,
        names=["r", "phi", "u", "w"], angles=[False, True, False, False], points=places, centres=places,
        strokes=tuple(("rod", (k,)) for k in range(3)),
    )  # fmt: skip


def pendulum_on_cart(
    cart: float = 1.0, mass: float = 1.0, length: float = 1.0, gravity: float = 9.8, stiffness: float = 0.0
) -> Model:
    """A point mass on a rod of `length` (m) that hangs from a cart (mass `cart`, kg) on a level track.

    Coordinates y (the cart, m, to the right) and theta (the rod, rad). `stiffness` (N/m) ties the
    cart to its place; without it the horizontal momentum is conserved as well as the energy.
    """
    tied = {} if stiffness == 0 else {"stiffness": stiffness}
    given = {"cart": cart, "mass": mass, "length": length, **tied}
    made = ingredients(2, {**given, "gravity": gravity}, tuple(given))
    kinetic, potential, places = hanging(made)
    if tied:
        potential += made.stiffness * made.q[0] ** 2 / 2
    return made.model(
        "pendulum_on_cart", kinetic, potential, names=["y", "theta"], angles=[False, True],
        points=places, strokes=(("slider", (0,)), ("rod", (0, 1))),
    )  # fmt: skip


def hanging(made: Ingredients) -> tuple[ca.SX, ca.SX, ca.SX]:
    """T and V of a point mass on a rod that hangs from a cart on a level track, and the places of both (2 x 2)."""
    q, v, arm = made.q, made.v, made.length
    bob = ca.vertcat(arm * ca.cos(q[1]), q[0] + arm * ca.sin(q[1]))
    kinetic = made.cart * v[0] ** 2 / 2 + made.mass * ca.sumsqr(ca.jtimes(bob, q, v)) / 2
    return kinetic, -made.mass * made.gravity * bob[0], ca.horzcat(ca.vertcat(0, q[0]), bob)


def cart_chain(
    carts: int = 3, mass: float = 1.0, stiffness: float = 1.0, cubic: float = 0.0, quadratic: float = 0.0
) -> Model:
    """`carts` equal carts on a track between two walls, joined by equal springs.

    Each spring has energy stiffness s^2 / 2 + quadratic s^3 / 3 + cubic s^4 / 4 in its stretch s:
    with `cubic` the beta-chain of E. Fermi, J. Pasta, S. Ulam, Los Alamos report LA-1940 (1955).
    """
    count = whole_number("carts", carts, 200)
    made = ingredients(
        count, {"mass": mass, "stiffness": stiffness, "cubic": cubic, "quadratic": quadratic}, ("mass", "stiffness")
    )
    q = made.q
    stretch = ca.vertcat(q, 0) - ca.vertcat(0, q)
    potential = ca.sum1(made.stiffness * stretch**2 / 2 + made.quadratic * stretch**3 / 3 + made.cubic * stretch**4 / 4)
    places = ca.vertcat(0, q, 0) + 3 * ca.SX(range(count + 2))  # seen apart also where they swing by a length and more
    return made.model(
        "cart_chain", made.mass * ca.sumsqr(made.v) / 2, potential, names=[f"y{i + 1}" for i in range(count)],
        points=ca.horzcat(ca.SX.zeros(count + 2), places).T, fixed={"carts": count},
        strokes=(*(("spring", (k, k + 1)) for k in range(count + 1)), ("ground", (0,)), ("ground", (count + 1,)),
                 *(("slider", (k + 1,)) for k in range(count))),
    )  # fmt: skip


def henon_heiles(coupling: float = 1.0) -> Model:
    """H = (px^2 + py^2 + x^2 + y^2) / 2 + coupling (x^2 y - y^3 / 3); with coupling 1 it escapes at 1/6.

    Source: M. Henon, C. Heiles, Astronomical Journal 69 (1964) 73-79.
    """
    made = ingredients(2, locals())
    x, y = made.q[0], made.q[1]
    potential = ca.sumsqr(made.q) / 2 + made.coupling * (x**2 * y - y**3 / 3)
    return made.model(
        "henon_heiles", ca.sumsqr(made.v) / 2, potential, names=["x", "y"], points=ca.vertcat(-y, x),
        centres=ca.vertcat(-y, x),
    )  # fmt: skip


def restricted_three_body(ratio: float = 0.012277471, spatial: bool = False) -> Model:
    """A light body near two heavy ones (masses 1 - ratio and ratio) on circles, in their rotating frame.

    T = ((x' - y)^2 + (y' + x)^2 + z'^2) / 2, V = -(1 - ratio) / r1 - ratio / r2, heavy bodies at (-ratio, 0, 0)
    and (1 - ratio, 0, 0): the kinetic energy has terms linear in the rates, and what is conserved is the Jacobi
    integral, -C / 2; C is `jacobi` in pins, families and tables. Without `spatial` z is left out. Orbits may have the
    symmetries "mirror": x(-t) = x(t), y(-t) = -y(t), z(-t) = z(t); in space also "axis", with z(-t) = -z(t), and
    "plane": z(t + T/2) = -z(t).
    Landmarks are the heavy bodies and the libration points. Source: V. Szebehely, Theory of Orbits (1967), sections
    1.5 and 4; units there.
    """
    if not isinstance(spatial, bool):
        raise InputError(f"system.arguments.spatial: must be true or false, got {spatial!r}; leave it out in the plane")
    made = ingredients(2 + spatial, {"ratio": ratio}, ("ratio",))
    (x, y), (u, w), small = (made.q[0], made.q[1]), (made.v[0], made.v[1]), made.ratio
    aside = ca.sumsqr(made.q[1:])
    kinetic = ((u - y) ** 2 + (w + x) ** 2 + (made.v[2] ** 2 if spatial else 0)) / 2
    potential = -(1 - small) / ca.sqrt((x + small) ** 2 + aside) - small / ca.sqrt((x - 1 + small) ** 2 + aside)
    model = made.model(
        "restricted_three_body", kinetic, potential, names=["x", "y", "z"][: 2 + spatial],
        points=ca.vertcat(-made.q[2], x, -y) if spatial else ca.vertcat(-y, x),  # z upwards
        fixed={"spatial": True} if spatial else None,
    )  # fmt: skip
    own = (("mirror", -1, (1, -1, 1)), ("axis", -1, (1, -1, -1)), ("plane", 1, (1, 1, -1)))
    places = {name: (*place, 0.0)[: 2 + spatial] for name, place in _bodies_and_libration_points(float(ratio)).items()}
    return altered(model, symmetries=own if spatial else (("mirror", -1, (1, -1)),), landmarks=places)


def _bodies_and_libration_points(ratio: float) -> dict[str, tuple[float, float]]:
    """Where the heavy bodies of `restricted_three_body` and the five places of rest are (x, y)."""
    heavy, near = (-ratio, 0.0), (1 - ratio, 0.0)
    if not ratio < 1:
        return {}

    def pull(x: float) -> float:
        first, other = x + ratio, x - 1 + ratio
        return x - (1 - ratio) * first / abs(first) ** 3 - ratio * other / abs(other) ** 3

    ends = ((heavy[0], near[0]), (near[0], 3.0), (-3.0, heavy[0]))
    collinear = [brentq(pull, low + 1e-9, high - 1e-9, xtol=1e-16, rtol=1e-15) for low, high in ends]
    libration = {f"L{k}": (float(x), 0.0) for k, x in enumerate(collinear, 1)}
    libration |= {f"L{k}": (0.5 - ratio, sign * 0.75**0.5) for k, sign in ((4, 1), (5, -1))}
    return {"primary": heavy, "secondary": near, **libration}


def three_bodies(mass1: float = 1.0, mass2: float = 1.0, mass3: float = 1.0) -> Model:
    """Three bodies that attract each other in a plane, G = 1, about their common centre of mass.

    Jacobi coordinates r = x2 - x1 and R = x3 - (m1 x1 + m2 x2) / (m1 + m2); energy and angular momentum are
    conserved. With equal masses the figure eight of A. Chenciner, R. Montgomery, Annals of Mathematics 152 (2000)
    881-901 is one of its orbits.
    """
    return _attracting(ingredients(4, locals(), tuple(locals())), "three_bodies", ("rx", "ry", "Rx", "Ry"), 3)


def n_bodies(count: int = 3, dimension: int = 2, gravitation: float = 1.0, **masses: float) -> Model:
    """`count` bodies of masses mass1, mass2, ... (1 unless given) that attract each other in a plane or in space.

    x_i'' = sum_j G m_j (x_j - x_i) / |x_j - x_i|^3 about their common centre of mass, in Jacobi coordinates: s1 is x2
    from x1, s2 is x3 from the centre of mass of these, and so on. Energy and angular momentum are conserved.
    `of.bodies` takes positions and velocities. Source: A. E. Roy, Orbital Motion, chapter 5.
    """
    number, size = whole_number("count", count, 12), whole_number("dimension", dimension, 3)
    given = {f"mass{k + 1}": 1.0 for k in range(number)}
    if size == 1 or number == 1 or (odd := sorted(masses.keys() - given.keys())):
        wrong = f"{odd[0]}: has no body" if number > 1 < size else "dimension and count: must be 2 or more"
        raise InputError(f"system.arguments.{wrong}; {number} bodies have the masses {', '.join(given)}")
    made = ingredients((number - 1) * size, {**given, **masses, "gravitation": gravitation}, (*given, "gravitation"))
    names = [f"s{k + 1}{axis}" for k in range(number - 1) for axis in "xyz"[:size]]
    return _attracting(made, "n_bodies", names, number, {"count": number, "dimension": size})


def _attracting(made: Ingredients, function: str, names: Sequence[str], count: int, fixed: Any = None) -> Model:
    """Point masses mass1, ... in Jacobi coordinates; those drawn are at rest with their centre of mass."""
    size = len(names) // (count - 1)
    masses = [getattr(made, f"mass{k + 1}") for k in range(count)]
    total, kinetic, pull, places = masses[0], ca.SX(0), ca.SX(0), [ca.SX.zeros(size)]  # from the centre so far
    for k, mass in enumerate(masses[1:]):
        here = slice(k * size, (k + 1) * size)
        kinetic += mass * total / (total + mass) * ca.sumsqr(made.v[here])
        for other, place in reversed([*zip(masses[: k + 1], places, strict=True)]):
            pull += other * mass / ca.norm_2(made.q[here] - place)
        places = [place - mass / (total + mass) * made.q[here] for place in places]
        places.append(total / (total + mass) * made.q[here])
        total += mass
    down = ca.horzcat(*(ca.vertcat(-x[1], x[0], *ca.vertsplit(x[2:])) for x in places))
    pull *= made.gravitation if "gravitation" in made.values else 1
    return made.model(
        function, kinetic / 2, -pull, names=names, points=down, fixed=fixed,
        strokes=tuple(("rod", (k,)) for k in range(count)),
    )  # fmt: skip


def bodies(
    masses: Sequence[float], positions: np.ndarray, velocities: np.ndarray, gravitation: float = 1.0
) -> tuple[Model, np.ndarray]:
    """Bodies that attract each other, from the positions and velocities that a paper prints.

    Args:
        masses: of the n bodies.
        positions: n x 2 or n x 3, about whichever centre.
        velocities: likewise; those of the centre of mass are left out.
        gravitation: G, 1 in most papers.

    Returns:
        The Model `systems.n_bodies` and its state, for `of.Guess(state, period)`.

    Raises:
        InputError: naming what does not have two or three numbers for each mass.

    Examples:
        >>> places, rates = [[-1, 0], [1, 0], [0, 0]], [[0.3471, 0.5327], [0.3471, 0.5327], [-0.6942, -1.0654]]
        >>> eight, state = of.bodies([1, 1, 1], places, rates)
        >>> round(of.find_orbit(of.Problem(eight, of.Guess(state, 6.3244))).period, 2)
        6.32
    """
    weights, *given = (np.asarray(each, float) for each in (masses, positions, velocities))
    for name, each in zip(("positions", "velocities"), given, strict=True):
        if each.ndim != 2 or len(each) != weights.size or each.shape[1] not in (2, 3) or each.shape != given[0].shape:
            raise InputError(
                f"{name}: shape {each.shape} for {weights.size} masses; give two or three numbers for each mass"
            )
    names = {f"mass{k + 1}": float(mass) for k, mass in enumerate(weights)}
    model = n_bodies(weights.size, given[0].shape[1], gravitation, **names)
    centres = [np.cumsum(weights[:, None] * each, axis=0) / np.cumsum(weights)[:, None] for each in given]
    return model, np.concatenate([each[1:] - own[:-1] for each, own in zip(given, centres, strict=True)]).ravel()


def planar_oscillator(stiffness_x: float = 1.0, stiffness_y: float = 2.0, quartic: float = 1.0) -> Model:
    """Unit mass in V = (a x^2 + b y^2) / 2 + quartic x^2 y^2: two springs coupled at fourth order."""
    made = ingredients(2, locals(), ("stiffness_x", "stiffness_y"))
    x, y = made.q[0], made.q[1]
    potential = (made.stiffness_x * x**2 + made.stiffness_y * y**2) / 2 + made.quartic * (x * y) ** 2
    return made.model("planar_oscillator", ca.sumsqr(made.v) / 2, potential, names=["x", "y"], points=ca.vertcat(-y, x))


def restricted_three_body_canonical(ratio: float = 0.012150585609624) -> Model:
    """The spatial restricted three-body problem in Hamilton's form, rotating frame, units as `restricted_three_body`.

    H = (px^2 + py^2 + pz^2) / 2 + y px - x py - (1 - ratio) / r1 - ratio / r2 with px = x' - y, py = y' + x, pz = z'.
    Orbits may have the symmetries "mirror": x(-t) = x(t), y(-t) = -y(t), z(-t) = z(t), "axis", with z(-t) = -z(t)
    instead, and "plane": z(t + T/2) = -z(t). Earth and Moon: ratio 0.01215. Source: V. Szebehely, Theory of Orbits
    (1967), sections 1.5 and 10.1.
    """

    def energy(x: Named, c: Named) -> Any:
        plane = x.y**2 + x.z**2
        first, second = ca.sqrt((x.x + c.ratio) ** 2 + plane), ca.sqrt((x.x - 1 + c.ratio) ** 2 + plane)
        kinetic = (x.px**2 + x.py**2 + x.pz**2) / 2 + x.y * x.px - x.x * x.py
        return kinetic - (1 - c.ratio) / first - c.ratio / second

    mirror = {"y": -1, "px": -1, "pz": -1}
    axis, plane = {"y": -1, "px": -1, "z": -1}, {"z": -1, "pz": -1}
    model = ingredients(3, {"ratio": ratio}, ("ratio",)).canonical(
        "restricted_three_body_canonical", energy, ("x", "y", "z"), ("px", "py", "pz"),
        symmetries={"mirror": (-1, mirror), "axis": (-1, axis), "plane": (1, plane)},
    )  # fmt: skip
    places = _bodies_and_libration_points(float(ratio)).items()
    return altered(model, landmarks={name: (x, y, 0.0, -y, x, 0.0) for name, (x, y) in places})


def lorenz(sigma: float = 10.0, rho: float = 28.0, beta: float = 8 / 3) -> Model:
    """x' = sigma (y - x), y' = x (rho - z) - y, z' = x y - beta z: convection in a ring, chaotic at these values.

    Orbits may have the symmetry "turn": half a period later (x, y, z) is (-x, -y, z).
    Source: E. N. Lorenz, Journal of the Atmospheric Sciences 20 (1963) 130-141.
    """
    return ingredients(1, locals()).first_order(
        "lorenz", lambda _, x, p: [p.sigma * (x.y - x.x), x.x * (p.rho - x.z) - x.y, x.x * x.y - p.beta * x.z],
        ("x", "y", "z"), symmetries={"turn": (1, {"x": -1, "y": -1})},
    )  # fmt: skip


def rossler(a: float = 0.2, b: float = 0.2, c: float = 5.7) -> Model:
    """x' = -y - z, y' = x + a y, z' = b + z (x - c). Source: O. E. Rössler, Physics Letters A 57 (1976) 397-398."""
    return ingredients(1, locals()).first_order(
        "rossler", lambda _, x, p: [-x.y - x.z, x.x + p.a * x.y, p.b + x.z * (x.x - p.c)], ("x", "y", "z")
    )


def brusselator(feed: float = 1.0, rate: float = 3.0) -> Model:
    """u' = feed - (rate + 1) u + u^2 v, v' = rate u - u^2 v: a chemical clock where rate > 1 + feed^2.

    Source: I. Prigogine, R. Lefever, Journal of Chemical Physics 48 (1968) 1695-1700.
    """
    made = ingredients(1, locals(), ("feed", "rate"))

    def field(_: Any, x: Named, p: Named) -> Any:
        made = x.u**2 * x.v
        return [p.feed - (p.rate + 1) * x.u + made, p.rate * x.u - made]

    return made.first_order("brusselator", field, ("u", "v"))


def fitzhugh_nagumo(current: float = 0.5, a: float = 0.7, b: float = 0.8, rate: float = 0.08) -> Model:
    """v' = v - v^3 / 3 - w + current, w' = rate (v + a - b w): the simplest nerve that fires.

    Source: R. FitzHugh, Biophysical Journal 1 (1961) 445-466.
    """
    return ingredients(1, locals(), ("rate",)).first_order(
        "fitzhugh_nagumo",
        lambda _, x, p: [x.v - x.v**3 / 3 - x.w + p.current, p.rate * (x.v + p.a - p.b * x.w)],
        ("v", "w"),
    )


def hodgkin_huxley(current: float = 10.0) -> Model:
    """The nerve of the squid: voltage V in mV and gates m, h, n, time in ms, current in uA/cm^2; rest at -65 mV.

    C V' = current - 120 m^3 h (V - 50) - 36 n^4 (V + 77) - 0.3 (V + 54.387), C = 1 uF/cm^2, and m' = alpha (1 - m) -
    beta m for each gate. Source: A. L. Hodgkin, A. F. Huxley, Journal of Physiology 117 (1952) 500-544, with the
    voltage as it is measured today.
    """

    def ramp(u: Any) -> Any:
        """u / (1 - exp(-u)), 1 at 0."""
        return u / 2 + ca.if_else(u == 0, 1.0, u / 2 / ca.tanh(u / 2))

    def field(_: Any, x: Named, p: Named) -> Any:
        volts, m, h, n = x
        currents = 120 * m**3 * h * (volts - 50) + 36 * n**4 * (volts + 77) + 0.3 * (volts + 54.387)
        rates = (
            (ramp((volts + 40) / 10), 4 * ca.exp(-(volts + 65) / 18)),
            (0.07 * ca.exp(-(volts + 65) / 20), 1 / (1 + ca.exp(-(volts + 35) / 10))),
            (0.1 * ramp((volts + 55) / 10), 0.125 * ca.exp(-(volts + 65) / 80)),
        )
        gates = [alpha * (1 - gate) - beta * gate for gate, (alpha, beta) in zip((m, h, n), rates, strict=True)]
        return [p.current - currents, *gates]

    return ingredients(1, {"current": current}).first_order("hodgkin_huxley", field, ("V", "m", "h", "n"))


__all__ = [
    "brusselator", "cart_chain", "coupled_pendula", "double_well", "duffing", "fitzhugh_nagumo", "forced_duffing",
    "forced_pendulum", "henon_heiles", "hodgkin_huxley", "lorenz", "n_bodies", "pendulum_on_cart", "planar_oscillator",
    "restricted_three_body", "restricted_three_body_canonical", "rossler", "rotating_hoop", "spherical_pendulum",
    "spring_pendulum", "swinging_spring", "three_bodies", "turning_three_bodies", "van_der_pol", "vibrated_pendulum",
]  # fmt: skip
FUNCTIONS: dict[str, Callable[..., Model]] = {name: globals()[name] for name in __all__}
