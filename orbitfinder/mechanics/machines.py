"""Built-in hybrid machines, for problem files with kind = "python" and for Python: each function returns a Model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.first_order import Named
from orbitfinder.mechanics.hybrid import Mode, Transition, changed, hybrid, impact
from orbitfinder.mechanics.library import Ingredients, ingredients, whole_number
from orbitfinder.mechanics.model import Model

SCUFFING = "the swing foot passes the ground in mid-stance, as it does without knees; it is let through"


def _swinging(made: Ingredients, name: str, rates: ca.SX, names: list[str]) -> Model:
    """Angles of unit masses moved by given accelerations."""
    return made.model(name, ca.sumsqr(made.v) / 2, ca.SX(0), forces=rates, names=names, angles=[True] * len(names))


def simplest_walker(slope: float = 0.009) -> Model:
    """Two massless legs with a heavy hip and feet of vanishing mass on a slope (rad); g = l = 1.

    theta'' = sin(theta - slope), phi'' = theta'' + theta'^2 sin(phi) - cos(theta - slope) sin(phi); theta is the stance
    leg's angle from the slope's normal, phi the angle between the legs. The foot strikes where phi = 2 theta < 0.
    Source: M. Garcia, A. Chatterjee, A. Ruina, M. Coleman, "The simplest walking model", ASME Journal of Biomechanical
    Engineering 120 (1998) 281-288.
    """
    made = ingredients(2, signed={"slope": slope})
    (theta, phi), rate = (made.q[0], made.q[1]), made.v[0]
    tilt = theta - made["slope"]
    stance = ca.sin(tilt)
    swing = stance + rate**2 * ca.sin(phi) - ca.cos(tilt) * ca.sin(phi)
    model = _swinging(made, "simplest_walker", ca.vertcat(stance, swing), ["theta", "phi"])

    def strike(x: Named, _: Named) -> ca.SX:
        turn = ca.cos(2 * x.theta)
        after = turn * x.thetadot
        return ca.vertcat(-x.theta, -2 * x.theta, after, (1 - turn) * after)

    strikes = Transition(
        "strike", "stance", "stance", guard=lambda x, p: x.phi - 2 * x.theta, reset=strike, direction=1,
        allowed=lambda x, p: -x.theta, ignored=SCUFFING,
        lost=lambda x, p: (ca.sin(2 * x.theta) * x.thetadot) ** 2 / 2,
    )  # fmt: skip
    push = {"stance force": lambda x, p: ca.cos(x.theta - p.slope) - x.thetadot**2}
    return hybrid([Mode("stance", model, push)], [strikes], ["strike"], system=model.system)


class _Compass:
    """Two straight legs and a hip, with the stance foot held (2 coordinates) or free (4), and what is drawn of them."""

    def __init__(self, made: Ingredients) -> None:
        self.made, count = made, made.q.numel()
        foot, legs = (ca.SX.zeros(2), made.q) if count == 2 else (made.q[:2], made.q[2:])
        length = made["a"] + made["b"]
        along = [ca.vertcat(-ca.sin(legs[k]), ca.cos(legs[k])) for k in (0, 1)]
        self.hip = foot + length * along[0]
        self.tip = self.hip - length * along[1]
        places = [foot + made["a"] * along[0], self.hip, self.hip - made["b"] * along[1]]
        self.masses = list(zip((made["mass"], made["hip_mass"], made["mass"]), places, strict=True))

    def model(self, **parts: Any) -> Model:
        """Its equations of motion."""
        made = self.made
        kinetic = sum((m * ca.sumsqr(ca.jtimes(place, made.q, made.v)) / 2 for m, place in self.masses), ca.SX(0))
        potential = sum((m * made["gravity"] * place[1] for m, place in self.masses), ca.SX(0))
        return made.model("compass_gait", kinetic, potential, **parts)

    def ground_force(self, model: Model) -> ca.Function:
        """The force on the stance foot (forward, up): what accelerates the masses, and their weight."""
        made = self.made
        momentum = ca.jtimes(sum((m * place for m, place in self.masses), ca.SX.zeros(2)), made.q, made.v)
        rates = ca.jtimes(momentum, made.q, made.v) + ca.jacobian(momentum, made.v) @ model.acceleration(
            0, made.q, made.v, made.parameters
        )
        weight = sum((m for m, _ in self.masses), ca.SX(0)) * made["gravity"]
        return ca.Function("force", [ca.vertcat(made.q, made.v), made.parameters], [rates + ca.vertcat(0, weight)])


def compass_gait(
    slope: float = 0.0524,
    a: float = 0.5,
    b: float = 0.5,
    mass: float = 5.0,
    hip_mass: float = 10.0,
    gravity: float = 9.81,
) -> Model:
    """Two straight legs (mass at a from the foot, b from the hip, m) and a hip, walking down a slope (rad).

    `stance` and `swing` are the legs' angles from the vertical; the swing foot strikes without slip or bounce where
    stance + swing = -2 slope, and the legs change their names.
    Source: A. Goswami, B. Thuilot, B. Espiau, INRIA research report 2996 (1996).
    """
    if not hip_mass >= 0:
        raise InputError(f"system.arguments.hip_mass: must not be negative, got {hip_mass!r}; check the value")
    numbers = {"a": a, "b": b, "mass": mass, "gravity": gravity}, {"slope": slope, "hip_mass": hip_mass}
    fixed, floating = (_Compass(ingredients(count, *numbers)) for count in (2, 4))
    names, drawn = ["stance", "swing"], ca.horzcat(ca.SX.zeros(2), _downwards(fixed.hip), _downwards(fixed.tip))
    model = fixed.model(names=names, angles=[True, True], points=drawn)
    lifted = floating.model(names=["x", "y", *names], angles=[False, False, True, True])
    foot = ca.Function("foot", [floating.made.q, floating.made.parameters], [floating.tip])
    ground = fixed.ground_force(model)

    def contact(x: Named, p: Named) -> list[Any]:
        """The swing foot's height along the slope's normal, and its place along the slope."""
        place = foot(ca.vertcat(*x[:4]), ca.vertcat(*p))
        return [ca.dot(_normal(p), place), ca.dot(_downhill(p), place)]

    struck = impact(lifted, contact)

    def whole(x: Named) -> Named:
        """The same state with the stance foot's place and velocity, which are 0."""
        return Named.of(lifted.state_names, ca.vertcat(0, 0, *x[:2], 0, 0, *x[2:]))

    def after(x: Named, p: Named) -> Any:
        found = struck.after(whole(x), p)
        return ca.vertcat(found[3], found[2], found[7], found[6])

    strikes = Transition(
        "strike", "step", "step", guard=lambda x, p: x.stance + x.swing + 2 * p.slope, reset=after,
        allowed=lambda x, p: x.swing - x.stance, ignored=SCUFFING,
        impulse=lambda x, p: struck.impulse(whole(x), p), lost=lambda x, p: struck.lost(whole(x), p),
    )  # fmt: skip
    force = {"ground force": lambda x, p: ca.dot(_normal(p), ground(ca.vertcat(*x), ca.vertcat(*p)))}
    return hybrid([Mode("step", model, force)], [strikes], ["strike"], system=model.system)


def _downwards(place: ca.SX) -> ca.SX:
    """(x down, y right) of (x right, y up)."""
    return ca.vertcat(-place[1], place[0])


def _normal(p: Named) -> Any:
    return ca.vertcat(ca.sin(p.slope), ca.cos(p.slope))


def _downhill(p: Named) -> Any:
    return ca.vertcat(ca.cos(p.slope), -ca.sin(p.slope))


def rimless_wheel(spokes: int = 8, slope: float = 0.08, length: float = 1.0, gravity: float = 9.81) -> Model:
    """A wheel of massless spokes around a heavy hub, rolling down a slope (rad) from spoke to spoke.

    theta is the stance spoke's angle from the vertical, downhill positive: theta'' = g / l sin(theta). The next spoke
    strikes at theta = slope + pi / n, and theta'+ = cos(2 pi / n) theta'-.
    Source: T. McGeer, "Passive dynamic walking", Int. J. Robotics Research 9 (1990) 62-82.
    """
    count = whole_number("spokes", spokes, 1000)
    if count < 3:
        raise InputError(f"system.arguments.spokes: must be at least 3, got {spokes}; a wheel needs them")
    made = ingredients(1, {"length": length, "gravity": gravity}, {"slope": slope})
    arm, half = made["length"], np.pi / count
    ends = [ca.vertcat(arm * ca.cos(made.q + 2 * half * k), arm * ca.sin(made.q + 2 * half * k)) for k in range(count)]
    hub = ca.vertcat(-arm * ca.cos(made.q), arm * ca.sin(made.q))
    rays = [hub + change * one for one in ends for change in (1, 0)]
    model = made.model(
        "rimless_wheel", (arm * made.v) ** 2 / 2, made["gravity"] * arm * ca.cos(made.q), names=["theta"],
        angles=[True], points=ca.horzcat(ca.SX.zeros(2), hub, *rays), fixed={"spokes": spokes},
    )  # fmt: skip
    turn = float(np.cos(2 * half))
    strikes = Transition(
        "strike", "spoke", "spoke", guard=lambda x, p: x.theta - p.slope - half, direction=1,
        reset=lambda x, p: ca.vertcat(x.theta - 2 * half, turn * x.thetadot),
        lost=lambda x, p: (1 - turn**2) * (p.length * x.thetadot) ** 2 / 2,
    )  # fmt: skip
    force = {"spoke force": lambda x, p: p.gravity * ca.cos(x.theta) - p.length * x.thetadot**2}
    return hybrid([Mode("spoke", model, force)], [strikes], ["strike"], system=model.system)


def slip_runner(
    mass: float = 80.0, stiffness: float = 20000.0, length: float = 1.0, attack: float = 0.3, gravity: float = 9.81
) -> Model:
    """The spring-loaded inverted pendulum running: a point mass that lands on a massless spring leg.

    The leg is held at the angle `attack` (rad) ahead of the vertical in flight. x is measured from the apex in flight,
    from the foot in stance; y is the height. The cycle begins at the apex.
    Source: R. Blickhan, "The spring-mass model for running and hopping", J. Biomechanics 22 (1989) 1217-1227.
    """
    positive = {"mass": mass, "stiffness": stiffness, "length": length, "gravity": gravity}
    made = ingredients(2, positive, {"attack": attack})
    kinetic, weight = made["mass"] * ca.sumsqr(made.v) / 2, made["mass"] * made["gravity"] * made.q[1]
    leg = ca.norm_2(made.q)
    spring = made["stiffness"] * (made["length"] - leg) ** 2 / 2
    names, mass_at = ["x", "y"], _downwards(made.q)
    foot = made.q + made["length"] * ca.vertcat(ca.sin(made["attack"]), -ca.cos(made["attack"]))
    flight = made.model(
        "slip_runner", kinetic, weight, names=names, points=ca.horzcat(_downwards(foot), mass_at), centres=mass_at
    )
    stance = made.model(
        "slip_runner", kinetic, weight + spring, names=names, points=ca.horzcat(ca.SX.zeros(2), mass_at),
        centres=mass_at,
    )  # fmt: skip
    transitions = [
        Transition(
            "touchdown",
            "flight",
            "stance",
            guard=lambda x, p: x.y - p.length * ca.cos(p.attack),
            reset=lambda x, p: changed(x, x=-p.length * ca.sin(p.attack)),
        ),
        Transition(
            "liftoff", "stance", "flight", guard=lambda x, p: ca.norm_2(ca.vertcat(*x[:2])) - p.length, direction=1
        ),
        Transition("apex", "flight", "flight", guard=lambda x, p: x.ydot, reset=lambda x, p: changed(x, x=0)),
    ]
    holds = {"height": lambda x, p: x.y}
    return hybrid(
        [Mode("flight", flight, holds), Mode("stance", stance, holds)], transitions,
        ["touchdown", "liftoff", "apex"], conserved=["energy"], system=flight.system,
    )  # fmt: skip


def vertical_hopper(mass: float = 1.0, stiffness: float = 100.0, gravity: float = 9.81) -> Model:
    """A mass on a massless spring that hops upright: y'' = -g in the air, -g - k/m y on the ground (y < 0).

    Its period is T = 2 v / g + (2 / w) (pi - atan(w v / g)), w^2 = k / m, v the speed of touchdown.
    """
    made = ingredients(1, {"mass": mass, "stiffness": stiffness, "gravity": gravity})
    kinetic, weight = made["mass"] * made.v**2 / 2, made["mass"] * made["gravity"] * made.q
    drawn = ca.horzcat(ca.SX.zeros(2), ca.vertcat(-made.q, 0))
    flight = made.model("vertical_hopper", kinetic, weight, names=["y"], points=drawn)
    ground = made.model(
        "vertical_hopper", kinetic, weight + made["stiffness"] * made.q**2 / 2, names=["y"], points=drawn
    )
    transitions = [
        Transition("liftoff", "ground", "flight", guard=lambda x, p: x.y, direction=1),
        Transition("touchdown", "flight", "ground", guard=lambda x, p: x.y),
    ]
    modes = [Mode("ground", ground), Mode("flight", flight, {"height": lambda x, p: x.y})]
    return hybrid(modes, transitions, ["liftoff", "touchdown"], conserved=["energy"], system=flight.system)


def rocking_block(angle: float = 0.3, stiffness: float = 0.75) -> Model:
    """A slender block that rocks on one corner and bounces elastically: phi'' = -stiffness sin(angle - phi), phi > 0.

    `angle` (rad) is that between its diagonal and its side, `stiffness` 3 g / (4 R) (1/s^2), R half the diagonal.
    Source: G. Housner, "The behavior of inverted pendulum structures during earthquakes", Bulletin of the
    Seismological Society of America 53 (1963) 403-417.
    """
    made = ingredients(1, {"angle": angle, "stiffness": stiffness})
    model = made.model(
        "rocking_block", made.v**2 / 2, made["stiffness"] * (ca.cos(made["angle"] - made.q)), names=["phi"],
        points=ca.horzcat(ca.SX.zeros(2), ca.vertcat(-ca.cos(made["angle"] - made.q), ca.sin(made.q - made["angle"]))),
    )  # fmt: skip
    bounce = Transition(
        "bounce", "rocking", "rocking", guard=lambda x, p: x.phi, reset=lambda x, p: changed(x, phidot=-x.phidot)
    )
    holds = {"gap": lambda x, p: x.phi}
    return hybrid([Mode("rocking", model, holds)], [bounce], ["bounce"], conserved=["energy"], system=model.system)


def bouncing_ball(
    amplitude: float = 0.012, frequency: float = 2 * np.pi, gravity: float = 1.0, restitution: float = 0.8
) -> Model:
    """A ball on a table at amplitude sin(frequency t): height y, speed v, and the table's phase, an angle.

    At an impact v+ = (1 + e) u - e v-, u the table's speed. The cycle is one bounce, of a period of the table.
    Source: J. Guckenheimer, P. Holmes, Nonlinear Oscillations (1983), section 2.4.
    """
    positive = {"frequency": frequency, "gravity": gravity}
    made = ingredients(1, positive, {"amplitude": amplitude, "restitution": restitution})
    model = made.first_order(
        "bouncing_ball", lambda _, x, p: [x.v, -p.gravity, p.frequency], ("y", "v", "phase"), angles=("phase",)
    )

    def table(x: Named, p: Named) -> Any:
        return p.amplitude * ca.sin(x.phase)

    def bounced(x: Named, p: Named) -> Any:
        speed = p.amplitude * p.frequency * ca.cos(x.phase)
        return changed(x, v=(1 + p.restitution) * speed - p.restitution * x.v)

    bounce = Transition("bounce", "air", "air", guard=lambda x, p: x.y - table(x, p), reset=bounced)
    holds = {"gap": lambda x, p: x.y - table(x, p)}
    return hybrid([Mode("air", model, holds)], [bounce], ["bounce"], system=model.system)


def impact_oscillator(
    damping: float = 0.1, frequency: float = 2.0, force: float = 1.0, stop: float = 0.0, restitution: float = 0.8
) -> Model:
    """x'' + damping x' + x = force cos(phase), phase' = frequency, with a stop at x = stop: v+ = -restitution v-.

    The cycle is one impact; the phase turns once or, with `winding`, more often between two.
    Source: S. W. Shaw, P. J. Holmes, "A periodically forced piecewise linear oscillator", Journal of Sound and
    Vibration 90 (1983) 129-155.
    """
    signed = {"damping": damping, "force": force, "stop": stop, "restitution": restitution}
    made = ingredients(1, {"frequency": frequency}, signed)

    def field(_: Any, x: Named, p: Named) -> list[Any]:
        return [x.v, p.force * ca.cos(x.phase) - p.damping * x.v - x.x, p.frequency]

    model = made.first_order("impact_oscillator", field, ("x", "v", "phase"), angles=("phase",))
    hit = Transition(
        "hit", "free", "free", guard=lambda x, p: x.x - p.stop, direction=1,
        reset=lambda x, p: changed(x, x=p.stop, v=-p.restitution * x.v),
    )  # fmt: skip
    holds = {"gap": lambda x, p: p.stop - x.x}
    return hybrid([Mode("free", model, holds)], [hit], ["hit"], system=model.system)


MACHINES: dict[str, Callable[..., Model]] = {
    one.__name__: one
    for one in (
        bouncing_ball, compass_gait, impact_oscillator, rimless_wheel, rocking_block, simplest_walker, slip_runner,
        vertical_hopper,
    )
}  # fmt: skip
