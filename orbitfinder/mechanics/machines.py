"""Built-in hybrid machines, for problem files with kind = "python" and for Python: each function returns a Model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.hybrid import At, Mode, Transition, hybrid, impact
from orbitfinder.mechanics.library import BUILT_IN, Ingredients, ingredients, whole_number
from orbitfinder.mechanics.model import Model

SCUFFING = "the swing foot passes the ground in mid-stance, as it does without knees; it is let through"


def _described(function: str, **arguments: Any) -> dict[str, Any]:
    return {"kind": "python", "module": BUILT_IN, "function": function, "arguments": arguments}


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

    def strike(at: At) -> ca.SX:
        turn = ca.cos(2 * at["theta"])
        after = turn * at["thetadot"]
        return ca.vertcat(-at["theta"], -2 * at["theta"], after, (1 - turn) * after)

    strikes = Transition(
        "strike", "stance", "stance", guard=lambda at: at["phi"] - 2 * at["theta"], reset=strike, direction=1,
        allowed=lambda at: -at["theta"], ignored=SCUFFING,
        lost=lambda at: (ca.sin(2 * at["theta"]) * at["thetadot"]) ** 2 / 2,
    )  # fmt: skip
    push = {"stance force": lambda at: ca.cos(at["theta"] - at["slope"]) - at["thetadot"] ** 2}
    return hybrid(
        [Mode("stance", model, push)], [strikes], ["strike"], system=_described("simplest_walker", slope=slope)
    )


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
    positive = {"a": a, "b": b, "mass": mass, "gravity": gravity}
    if not hip_mass >= 0:
        raise InputError(f"system.arguments.hip_mass: must not be negative, got {hip_mass!r}; check the value")
    signed = {"slope": slope, "hip_mass": hip_mass}
    fixed, floating = ingredients(2, positive, signed), ingredients(4, positive, signed)

    def bodies(made: Ingredients, foot: ca.SX, legs: ca.SX) -> tuple[list[tuple[Any, ca.SX]], ca.SX, ca.SX]:
        """Masses with their places (x forward, y up), the hip and the swing foot."""
        length = made["a"] + made["b"]
        along = [ca.vertcat(-ca.sin(angle), ca.cos(angle)) for angle in (legs[0], legs[1])]
        hip = foot + length * along[0]
        places = [foot + made["a"] * along[0], hip, hip - made["b"] * along[1]]
        return (
            list(zip((made["mass"], made["hip_mass"], made["mass"]), places, strict=True)),
            hip,
            hip - length * along[1],
        )

    def moving(made: Ingredients, foot: ca.SX, legs: ca.SX, **parts: Any) -> Model:
        masses = bodies(made, foot, legs)[0]
        kinetic = sum((m * ca.sumsqr(ca.jtimes(place, made.q, made.v)) / 2 for m, place in masses), ca.SX(0))
        potential = sum((m * made["gravity"] * place[1] for m, place in masses), ca.SX(0))
        return made.model("compass_gait", kinetic, potential, **parts)

    origin, names = ca.SX.zeros(2), ["stance", "swing"]
    masses, hip, tip = bodies(fixed, origin, fixed.q)
    drawn = ca.horzcat(origin, _downwards(hip), _downwards(tip))
    model = moving(fixed, origin, fixed.q, names=names, angles=[True, True], points=drawn)
    lifted = moving(
        floating, floating.q[:2], floating.q[2:], names=["x", "y", *names], angles=[False, False, True, True]
    )
    foot = ca.Function("foot", [floating.q, floating.parameters], [bodies(floating, floating.q[:2], floating.q[2:])[2]])
    momentum = ca.jtimes(sum((m * place for m, place in masses), ca.SX.zeros(2)), fixed.q, fixed.v)
    rates = ca.jtimes(momentum, fixed.q, fixed.v) + ca.jacobian(momentum, fixed.v) @ model.acceleration(
        0, fixed.q, fixed.v, fixed.parameters
    )
    weight = sum((m for m, _ in masses), ca.SX(0)) * fixed["gravity"]
    ground = ca.Function("ground_force", [fixed.q, fixed.v, fixed.parameters], [rates + ca.vertcat(0, weight)])

    def contact(at: At) -> Any:
        """The swing foot's height along the slope's normal, and its place along the slope."""
        place = foot(at.q, at.p)
        return ca.vertcat(ca.dot(_normal(at), place), ca.dot(_downhill(at), place))

    struck = impact(lifted, contact)

    def whole(at: At) -> At:
        """The same state with the stance foot's place and velocity, which are 0."""
        return At(lifted, ca.vertcat(0, 0, at.q, 0, 0, at.v), at.p)

    def after(at: At) -> Any:
        found = struck.after(whole(at))
        return ca.vertcat(found[3], found[2], found[7], found[6])

    strikes = Transition(
        "strike", "step", "step", guard=lambda at: at["stance"] + at["swing"] + 2 * at["slope"], reset=after,
        allowed=lambda at: at["swing"] - at["stance"], ignored=SCUFFING,
        impulse=lambda at: struck.impulse(whole(at)), lost=lambda at: struck.lost(whole(at)),
    )  # fmt: skip
    force = {"ground force": lambda at: ca.dot(_normal(at), ground(at.q, at.v, at.p))}
    arguments = {"slope": slope, "a": a, "b": b, "mass": mass, "hip_mass": hip_mass, "gravity": gravity}
    return hybrid([Mode("step", model, force)], [strikes], ["strike"], system=_described("compass_gait", **arguments))


def _downwards(place: ca.SX) -> ca.SX:
    """(x down, y right) of (x right, y up)."""
    return ca.vertcat(-place[1], place[0])


def _normal(at: At) -> Any:
    return ca.vertcat(ca.sin(at["slope"]), ca.cos(at["slope"]))


def _downhill(at: At) -> Any:
    return ca.vertcat(ca.cos(at["slope"]), -ca.sin(at["slope"]))


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
        "strike", "spoke", "spoke", guard=lambda at: at["theta"] - at["slope"] - half, direction=1,
        reset=lambda at: ca.vertcat(at["theta"] - 2 * half, turn * at["thetadot"]),
        lost=lambda at: (1 - turn**2) * (at["length"] * at["thetadot"]) ** 2 / 2,
    )  # fmt: skip
    force = {"spoke force": lambda at: at["gravity"] * ca.cos(at["theta"]) - at["length"] * at["thetadot"] ** 2}
    system = _described("rimless_wheel", spokes=spokes, slope=slope, length=length, gravity=gravity)
    return hybrid([Mode("spoke", model, force)], [strikes], ["strike"], system=system)


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
            guard=lambda at: at["y"] - at["length"] * ca.cos(at["attack"]),
            reset=lambda at: at.state(x=-at["length"] * ca.sin(at["attack"])),
        ),
        Transition("liftoff", "stance", "flight", guard=lambda at: ca.norm_2(at.q) - at["length"], direction=1),
        Transition("apex", "flight", "flight", guard=lambda at: at["ydot"], reset=lambda at: at.state(x=0)),
    ]
    holds = {"height": lambda at: at["y"]}
    system = _described("slip_runner", mass=mass, stiffness=stiffness, length=length, attack=attack, gravity=gravity)
    return hybrid(
        [Mode("flight", flight, holds), Mode("stance", stance, holds)], transitions,
        ["touchdown", "liftoff", "apex"], conserved=["energy"], system=system,
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
        Transition("liftoff", "ground", "flight", guard=lambda at: at["y"], direction=1),
        Transition("touchdown", "flight", "ground", guard=lambda at: at["y"]),
    ]
    modes = [Mode("ground", ground), Mode("flight", flight, {"height": lambda at: at["y"]})]
    system = _described("vertical_hopper", mass=mass, stiffness=stiffness, gravity=gravity)
    return hybrid(modes, transitions, ["liftoff", "touchdown"], conserved=["energy"], system=system)


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
        "bounce", "rocking", "rocking", guard=lambda at: at["phi"], reset=lambda at: at.state(phidot=-at["phidot"])
    )
    holds = {"gap": lambda at: at["phi"]}
    system = _described("rocking_block", angle=angle, stiffness=stiffness)
    return hybrid([Mode("rocking", model, holds)], [bounce], ["bounce"], conserved=["energy"], system=system)


MACHINES: dict[str, Callable[..., Model]] = {
    one.__name__: one
    for one in (compass_gait, rimless_wheel, rocking_block, simplest_walker, slip_runner, vertical_hopper)
}
