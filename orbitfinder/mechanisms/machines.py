"""Built-in hybrid machines, for problem files with kind = "python" and for Python: each function returns a Model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.factorise import LinearBalances, eliminated
from orbitfinder.mechanics.first_order import Named
from orbitfinder.mechanics.hybrid import Expression, Mode, Transition, changed, hybrid, impact
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms.library import Ingredients, ingredients, whole_number

SCUFFING = "the swing foot passes the ground in mid-stance, as it does without knees; it is let through"


REACH = 10.0
"""Half the length (m) of the straight ground that is drawn; pictures cut it off"""


def _machine(
    modes: Sequence[Mode], transitions: Sequence[Transition], ground: Expression, conserved: Sequence[str] = ()
) -> Model:
    """A machine that goes through its transitions one after the other, on its ground."""
    cycle, system = [transition.name for transition in transitions], modes[0].model.system
    return hybrid(modes, transitions, cycle, conserved=conserved, system=system, ground=ground)


def _along(angle: Any) -> ca.SX:
    """(x right, y up) of a unit leg that leans back by an angle from the vertical."""
    return ca.vertcat(-ca.sin(angle), ca.cos(angle))


def _slope(x: Named, p: Named) -> Any:
    """The ground of walkers: a slope through the stance foot."""
    del x
    return ca.horzcat(*(_downwards(reach * _downhill(p)) for reach in (-REACH, REACH)))


def _wall(name: str) -> Any:
    """An upright wall at the distance that a parameter gives."""
    return lambda x, p: ca.vertcat(ca.SX([[-REACH, REACH]]), ca.horzcat(p[name], p[name]))


def level_ground(x: Named, p: Named) -> Any:
    """Level ground through the origin."""
    del x, p
    return ca.SX([[0.0, 0.0], [-REACH, REACH]])


def simplest_walker(slope: float = 0.009) -> Model:
    """Two massless legs with a heavy hip and feet of vanishing mass on a slope (rad); g = l = 1.

    theta'' = sin(theta - slope), phi'' = theta'' + theta'^2 sin(phi) - cos(theta - slope) sin(phi); theta is the stance
    leg's angle from the slope's normal, phi the angle between the legs. The foot strikes where phi = 2 theta < 0.
    Source: M. Garcia, A. Chatterjee, A. Ruina, M. Coleman, "The simplest walking model", ASME Journal of Biomechanical
    Engineering 120 (1998) 281-288.
    """
    made = ingredients(2, locals())
    (theta, phi), rate = (made.q[0], made.q[1]), made.v[0]
    tilt = theta - made.slope
    stance = ca.sin(tilt)
    swing = stance + rate**2 * ca.sin(phi) - ca.cos(tilt) * ca.sin(phi)
    hip = _along(tilt)
    drawn = ca.horzcat(ca.SX.zeros(2), _downwards(hip), _downwards(hip - _along(tilt - phi)))
    model = made.model(
        "simplest_walker", ca.sumsqr(made.v) / 2, ca.SX(0), forces=ca.vertcat(stance, swing),
        names=["theta", "phi"], angles=[True, True], points=drawn,
    )  # fmt: skip

    def strike(x: Named, _: Named) -> ca.SX:
        turn = ca.cos(2 * x.theta)
        after = turn * x.thetadot
        return ca.vertcat(-x.theta, -2 * x.theta, after, (1 - turn) * after)

    strikes = Transition(
        "strike", "stance", "stance", guard=lambda x, p: x.phi - 2 * x.theta, reset=strike, direction=1,
        allowed=lambda x, p: -x.theta, ignored=SCUFFING,
        lost=lambda x, p: (ca.sin(2 * x.theta) * x.thetadot) ** 2 / 2,
        advance=lambda x, p: _downwards(-2 * ca.sin(x.theta) * _downhill(p)),
    )  # fmt: skip
    push = {"stance force": lambda x, p: ca.cos(x.theta - p.slope) - x.thetadot**2}
    return _machine([Mode("stance", model, push)], [strikes], _slope)


class _Legs:
    """Point masses on legs with the stance foot held, or free where coordinates for its place come first."""

    def __init__(self, function: str, made: Ingredients, angles: int) -> None:
        self.function, self.made, held = function, made, made.q.numel() == angles
        self.foot, self.legs = (ca.SX.zeros(2), made.q) if held else (made.q[:2], made.q[2:])
        self.along = [_along(self.legs[k]) for k in range(angles)]
        self.masses: list[tuple[Any, ca.SX]] = []
        self.tip = self.foot

    def model(self, **parts: Any) -> Model:
        """Its equations of motion."""
        made = self.made
        kinetic = sum((m * ca.sumsqr(ca.jtimes(place, made.q, made.v)) / 2 for m, place in self.masses), ca.SX(0))
        potential = sum((m * made.gravity * place[1] for m, place in self.masses), ca.SX(0))
        return made.model(self.function, kinetic, potential, **parts)

    def ground_force(self, model: Model) -> dict[str, Expression]:
        """That on the stance foot along the slope's normal: what accelerates the masses, and their weight."""
        made = self.made
        momentum = ca.jtimes(sum((m * place for m, place in self.masses), ca.SX.zeros(2)), made.q, made.v)
        rates = ca.jtimes(momentum, made.q, made.v) + ca.jacobian(momentum, made.v) @ model.acceleration(
            0, made.q, made.v, made.parameters
        )
        weight = sum((m for m, _ in self.masses), ca.SX(0)) * made.gravity
        force = ca.Function("force", [ca.vertcat(made.q, made.v), made.parameters], [rates + ca.vertcat(0, weight)])
        return {"ground force": lambda x, p: ca.dot(_normal(p), force(ca.vertcat(*x), ca.vertcat(*p)))}

    def swing_foot(self) -> ca.Function:
        """(q, p) -> where the swing foot is (right, up)."""
        return ca.Function("foot", [self.made.q, self.made.parameters], [self.tip])


class _Compass(_Legs):
    """Two straight legs and a hip."""

    def __init__(self, made: Ingredients, function: str = "compass_gait") -> None:
        super().__init__(function, made, 2)
        self.hip = self.foot + (made.a + made.b) * self.along[0]
        self.tip = self.hip - (made.a + made.b) * self.along[1]
        places = [self.foot + made.a * self.along[0], self.hip, self.hip - made.b * self.along[1]]
        self.masses = list(zip((made.mass, made.hip_mass, made.mass), places, strict=True))


class _Kneed(_Legs):
    """A straight stance leg, a hip, a swing leg with a knee, and perhaps a torso half-way between the thighs."""

    def __init__(self, function: str, made: Ingredients) -> None:
        super().__init__(function, made, 3)
        shank, thigh = made.a1 + made.b1, made.a2 + made.b2
        self.hip = self.foot + (shank + thigh) * self.along[0]
        self.knee = self.hip - thigh * self.along[1]
        self.tip = self.knee - shank * self.along[2]
        heavy, light = made.thigh_mass, made.shank_mass
        self.masses = [
            (light, self.foot + made.a1 * self.along[0]), (heavy, self.foot + (shank + made.a2) * self.along[0]),
            (made.hip_mass, self.hip), (heavy, self.hip - made.b2 * self.along[1]),
            (light, self.knee - made.b1 * self.along[2]),
        ]  # fmt: skip
        self.corners = [self.foot, self.hip, self.knee, self.tip]
        if function == "five_link_walker":
            head = self.hip + made.torso * _along((self.legs[0] + self.legs[1]) / 2)
            self.masses.append((made.torso_mass, head))
            self.corners[2:2] = [head, self.hip]


def _struck(lifted: Model, foot: ca.Function, order: Sequence[int], *held: str) -> dict[str, Any]:
    """Reset, impulse and loss of a swing foot's impact without slip or bounce, coordinates `held` equal.

    The `lifted` walker has the stance foot's place and velocity in its state too; `order` picks from that the walker's
    own state after the legs have changed their names.
    """
    count = lifted.degrees_of_freedom

    def contact(x: Named, p: Named) -> list[Any]:
        place = foot(ca.vertcat(*x[:count]), ca.vertcat(*p))
        return [ca.dot(_normal(p), place), ca.dot(_downhill(p), place), *(x[held[0]] - x[name] for name in held[1:])]

    def whole(x: Named) -> Named:
        return Named.of(lifted.state_names, ca.vertcat(0, 0, *x[: count - 2], 0, 0, *x[count - 2 :]))

    struck = impact(lifted, contact)
    return {
        "reset": lambda x, p: struck.after(whole(x), p)[order],
        "impulse": lambda x, p: struck.impulse(whole(x), p),
        "lost": lambda x, p: struck.lost(whole(x), p),
    }


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
    return compass("compass_gait", locals())


def compass(function: str, given: Mapping[str, float], controls: tuple[str, ...] = ()) -> Model:
    """The compass gait of a function's name and arguments, of which `controls` are the torques of hip and ankle."""
    _check_weightless(given, "hip_mass")
    positive = ("a", "b", "mass", "gravity")
    fixed, floating = (_Compass(ingredients(count, given, positive, controls), function) for count in (2, 4))
    torques = {"controls": controls}
    if controls:
        hip, ankle = (getattr(fixed.made, name) for name in controls)
        torques["forces"] = ca.vertcat(ankle - hip, hip)
    names, drawn = ["stance", "swing"], ca.horzcat(ca.SX.zeros(2), _downwards(fixed.hip), _downwards(fixed.tip))
    model = fixed.model(names=names, angles=[True, True], points=drawn, **torques)
    lifted = floating.model(names=["x", "y", *names], angles=[False, False, True, True])
    foot, force = fixed.swing_foot(), fixed.ground_force(model)
    strikes = Transition(
        "strike", "step", "step", guard=lambda x, p: x.stance + x.swing + 2 * p.slope,
        allowed=lambda x, p: x.swing - x.stance, ignored=SCUFFING,
        advance=lambda x, p: _downwards(foot(ca.vertcat(*x[:2]), ca.vertcat(*p))),
        **_struck(lifted, floating.swing_foot(), [3, 2, 7, 6]),
    )  # fmt: skip
    return _machine([Mode("step", model, force)], [strikes], _slope)


def kneed_walker(
    slope: float = 0.0504,
    a1: float = 0.375,
    b1: float = 0.125,
    a2: float = 0.175,
    b2: float = 0.325,
    thigh_mass: float = 0.5,
    shank_mass: float = 0.05,
    hip_mass: float = 0.5,
    gravity: float = 9.81,
) -> Model:
    """A walker with knees on a slope (rad): the swing leg's knee is `free` until it straightens, then `locked`.

    The stance leg is straight. Masses: of the shank at a1 from the foot, b1 from the knee (m), of the thigh at a2 from
    the knee, b2 from the hip. Angles from the vertical. The knee stops without bounce and locks; so does the foot at
    the strike, after which the legs change their names and the knee behind is free.
    Source: V. F. Hsu Chen, Passive dynamic walking with knees: a point foot model, MIT (2007).
    """
    return _on_knees("kneed_walker", locals())


def five_link_walker(
    slope: float = 0.0504,
    torso: float = 0.25,
    torso_mass: float = 0.2,
    a1: float = 0.375,
    b1: float = 0.125,
    a2: float = 0.175,
    b2: float = 0.325,
    thigh_mass: float = 0.5,
    shank_mass: float = 0.05,
    hip_mass: float = 0.5,
    gravity: float = 9.81,
) -> Model:
    """Two thighs, two shanks and a torso on a slope (rad): the kneed walker with a mass at `torso` (m) above the hip.

    A gear in the hip keeps the torso in the middle between the thighs, so that it needs no motor to stay upright.
    Source: M. Wisse, D. Hobbelen, A. Schwab, "Adding an upper body to passive dynamic walking robots by means of a
    bisecting hip mechanism", IEEE Transactions on Robotics 23 (2007) 112-123.
    """
    _check_weightless(locals(), "torso_mass")
    return _on_knees("five_link_walker", locals())


def _check_weightless(given: Mapping[str, float], name: str) -> None:
    """`InputError` for a mass below 0."""
    if not given[name] >= 0:
        raise InputError(f"system.arguments.{name}: must not be negative, got {given[name]!r}; check the value")


def _on_knees(function: str, given: Mapping[str, float]) -> Model:
    """A walker whose swing leg has a knee that locks, of a function's name and arguments."""
    positive = [name for name in given if name not in ("slope", "torso_mass")]
    fixed, floating = (_Kneed(function, ingredients(count, given, positive)) for count in (3, 5))
    names = ["stance", "thigh", "shank"]
    drawn = {"names": names, "angles": [True] * 3, "points": ca.horzcat(*map(_downwards, fixed.corners))}
    free = fixed.model(**drawn)
    locked = fixed.model(**drawn, forces=_locking(free, fixed.made))
    lifted = floating.model(names=["x", "y", *names], angles=[False] * 2 + [True] * 3)
    straight, foot = impact(free, lambda x, p: x.thigh - x.shank), fixed.swing_foot()

    def height(x: Named, p: Named) -> Any:
        return ca.dot(_normal(p), foot(ca.vertcat(*x[:3]), ca.vertcat(*p)))

    transitions = [
        Transition(
            "knee", "free", "locked", guard=straight.gap, reset=straight.after, impulse=straight.impulse,
            lost=straight.lost,
        ),
        Transition(
            "strike", "locked", "free", guard=height,
            advance=lambda x, p: _downwards(foot(ca.vertcat(*x[:3]), ca.vertcat(*p))),
            **_struck(lifted, floating.swing_foot(), [3, 2, 2, 8, 7, 7], "thigh", "shank"),
        ),
    ]  # fmt: skip
    modes = [
        Mode("free", free, fixed.ground_force(free) | {"knee": lambda x, p: x.thigh - x.shank}),
        Mode("locked", locked, fixed.ground_force(locked) | {"foot": height}),
    ]
    return _machine(modes, transitions, _slope)


def _locking(free: Model, made: Ingredients) -> ca.SX:
    """The forces of a lock that keeps thigh and shank in line: M a = M a_free + J^T L with J a = 0."""
    given = [made.q, made.v, made.parameters]
    mass = ca.hessian(free.kinetic(*given), made.v)[0]
    line = ca.SX([[0.0, 1.0, -1.0]])
    balances = LinearBalances(mass, -mass @ free.acceleration(0, *given), line.T, line, ca.SX(0))
    return line.T @ eliminated(balances, given, True)(*given)[3]


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
    made = ingredients(1, {"length": length, "gravity": gravity, "slope": slope}, ("length", "gravity"))
    arm, half = made.length, np.pi / count
    ends = [ca.vertcat(arm * ca.cos(made.q + 2 * half * k), -arm * ca.sin(made.q + 2 * half * k)) for k in range(count)]
    hub = ca.vertcat(-arm * ca.cos(made.q), arm * ca.sin(made.q))
    rays = [hub + change * end for end in ends for change in (1, 0)]
    model = made.model(
        "rimless_wheel", (arm * made.v) ** 2 / 2, made.gravity * arm * ca.cos(made.q), names=["theta"],
        angles=[True], points=ca.horzcat(ca.SX.zeros(2), hub, *rays), fixed={"spokes": spokes},
    )  # fmt: skip
    turn = float(np.cos(2 * half))
    strikes = Transition(
        "strike", "spoke", "spoke", guard=lambda x, p: x.theta - p.slope - half, direction=1,
        reset=lambda x, p: ca.vertcat(x.theta - 2 * half, turn * x.thetadot),
        lost=lambda x, p: (1 - turn**2) * (p.length * x.thetadot) ** 2 / 2,
        advance=lambda x, p: _downwards(2 * p.length * np.sin(half) * _downhill(p)),
    )  # fmt: skip
    force = {"spoke force": lambda x, p: p.gravity * ca.cos(x.theta) - p.length * x.thetadot**2}
    return _machine([Mode("spoke", model, force)], [strikes], _slope)


def slip_runner(
    mass: float = 80.0, stiffness: float = 20000.0, length: float = 1.0, attack: float = 0.3, gravity: float = 9.81
) -> Model:
    """The spring-loaded inverted pendulum running: a point mass that lands on a massless spring leg.

    The leg is held at the angle `attack` (rad) ahead of the vertical in flight. x is measured from the apex in flight,
    from the foot in stance; y is the height. The cycle begins at the apex.
    Source: R. Blickhan, "The spring-mass model for running and hopping", J. Biomechanics 22 (1989) 1217-1227.
    """
    made = ingredients(2, locals(), ("mass", "stiffness", "length", "gravity"))
    kinetic, weight = made.mass * ca.sumsqr(made.v) / 2, made.mass * made.gravity * made.q[1]
    leg = ca.norm_2(made.q)
    spring = made.stiffness * (made.length - leg) ** 2 / 2
    names, mass_at = ["x", "y"], _downwards(made.q)
    foot = made.q + made.length * ca.vertcat(ca.sin(made.attack), -ca.cos(made.attack))
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
            advance=lambda x, p: ca.vertcat(0, x.x + p.length * ca.sin(p.attack)),
        ),
        Transition(
            "liftoff", "stance", "flight", guard=lambda x, p: ca.norm_2(ca.vertcat(*x[:2])) - p.length, direction=1
        ),
        Transition(
            "apex",
            "flight",
            "flight",
            guard=lambda x, p: x.ydot,
            reset=lambda x, p: changed(x, x=0),
            advance=lambda x, p: ca.vertcat(0, x.x),
        ),
    ]
    holds = {"height": lambda x, p: x.y}
    modes = [Mode("flight", flight, holds), Mode("stance", stance, holds)]
    return _machine(modes, transitions, level_ground, ["energy"])


def slip_walker(
    mass: float = 80.0, stiffness: float = 14000.0, length: float = 1.0, attack: float = 0.3665, gravity: float = 9.81
) -> Model:
    """The spring-loaded inverted pendulum walking: a point mass on one or two massless spring legs.

    The leg in the air is held at the angle `attack` (rad) ahead of the vertical. x is measured from the foot that came
    down last, the other one is `step` behind it. The cycle begins when only one leg is left on the ground.
    Source: H. Geyer, A. Seyfarth, R. Blickhan, "Compliant leg behaviour explains basic dynamics of walking and
    running", Proc. R. Soc. B 273 (2006) 2861-2867.
    """
    made = ingredients(1, locals(), ("mass", "stiffness", "length", "gravity"))

    def legs(x: Named, double: bool) -> list[Any]:
        """(right, up) of the mass from the feet on the ground."""
        return [ca.vertcat(x.x, x.y), ca.vertcat(x.x + x.step, x.y)][: 1 + double]

    def mode(name: str, double: bool) -> Mode:
        def energy(x: Named, p: Named) -> Any:
            springs = sum((p.length - ca.norm_2(leg)) ** 2 for leg in legs(x, double))
            return p.mass * (x.vx**2 + x.vy**2) / 2 + p.mass * p.gravity * x.y + p.stiffness * springs / 2

        def field(_: Any, x: Named, p: Named) -> list[Any]:
            pushes = [p.stiffness / p.mass * (p.length / ca.norm_2(leg) - 1) * leg for leg in legs(x, double)]
            rates = sum(pushes, ca.SX.zeros(2))
            return [x.vx, x.vy, rates[0], rates[1] - p.gravity, 0]

        def feet(x: Named, p: Named) -> Any:
            ahead = x.x + p.length * ca.sin(p.attack), x.y - p.length * ca.cos(p.attack)
            behind = (-x.step, 0) if double else ahead
            return ca.horzcat(ca.SX.zeros(2), ca.vertcat(-x.y, x.x), ca.vertcat(-behind[1], behind[0]))

        model = made.first_order(
            "slip_walker", field, ("x", "y", "vx", "vy", "step"), invariants={"energy": energy}, points=feet
        )
        pairs = zip(("leg", "leg behind"), range(1 + double), strict=False)
        return Mode(name, model, {
            f"{leg} pushes": lambda x, p, k=k: p.length - ca.norm_2(legs(x, double)[k]) for leg, k in pairs
        })  # fmt: skip

    def landed(x: Named, p: Named) -> Any:
        step = x.x + p.length * ca.sin(p.attack)
        return changed(x, x=x.x - step, step=step)

    single, double = mode("single", False), mode("double", True)
    transitions = [
        Transition(
            "touchdown", "single", "double", guard=lambda x, p: x.y - p.length * ca.cos(p.attack), reset=landed,
            advance=lambda x, p: ca.vertcat(0, x.x + p.length * ca.sin(p.attack)),
        ),
        Transition(
            "liftoff", "double", "single", guard=lambda x, p: ca.norm_2(legs(x, True)[1]) - p.length, direction=1
        ),
    ]  # fmt: skip
    return _machine([single, double], transitions, level_ground, ["energy"])


def vertical_hopper(mass: float = 1.0, stiffness: float = 100.0, gravity: float = 9.81) -> Model:
    """A mass on a massless spring that hops upright: y'' = -g in the air, -g - k/m y on the ground (y < 0).

    Its period is T = 2 v / g + (2 / w) (pi - atan(w v / g)), w^2 = k / m, v the speed of touchdown.
    """
    return hopper("vertical_hopper", ingredients(1, locals(), ("mass", "stiffness", "gravity")))


def hopper(function: str, made: Ingredients, forces: ca.SX | None = None, **parts: Any) -> Model:
    """The hopper of a function's name, on whose leg `forces` act while it is on the ground."""
    kinetic, weight = made.mass * made.v**2 / 2, made.mass * made.gravity * made.q
    foot, mass_at = ca.vertcat(-made.q, 0), ca.vertcat(-1 - made.q, 0)  # of a leg that is drawn 1 m long
    flight = made.model(function, kinetic, weight, names=["y"], points=ca.horzcat(foot, mass_at), **parts)
    ground = made.model(
        function, kinetic, weight + made.stiffness * made.q**2 / 2, names=["y"], forces=forces,
        points=ca.horzcat(ca.SX.zeros(2), mass_at), **parts,
    )  # fmt: skip
    transitions = [
        Transition("liftoff", "ground", "flight", guard=lambda x, p: x.y, direction=1),
        Transition("touchdown", "flight", "ground", guard=lambda x, p: x.y),
    ]
    modes = [Mode("ground", ground), Mode("flight", flight, {"height": lambda x, p: x.y})]
    return _machine(modes, transitions, level_ground, ["energy"] if forces is None else ())


def rocking_block(angle: float = 0.3, stiffness: float = 0.75) -> Model:
    """A slender block that rocks on one corner and bounces elastically: phi'' = -stiffness sin(angle - phi), phi > 0.

    `angle` (rad) is that between its diagonal and its side, `stiffness` 3 g / (4 R) (1/s^2), R half the diagonal.
    Source: G. Housner, "The behavior of inverted pendulum structures during earthquakes", Bulletin of the
    Seismological Society of America 53 (1963) 403-417.
    """
    made = ingredients(1, locals(), ("angle", "stiffness"))
    side = 2 * ca.sin(made.angle) * ca.vertcat(ca.cos(made.q), -ca.sin(made.q))  # (right, up), the diagonal is 2 m
    up = 2 * ca.cos(made.angle) * ca.vertcat(ca.sin(made.q), ca.cos(made.q))
    corners = [_downwards(place) for place in (0 * up, up, up - side, -side, 0 * up)]
    model = made.model(
        "rocking_block", made.v**2 / 2, made.stiffness * (ca.cos(made.angle - made.q)), names=["phi"],
        angles=[True], points=ca.horzcat(*corners),
    )  # fmt: skip
    bounce = Transition(
        "bounce", "rocking", "rocking", guard=lambda x, p: x.phi, reset=lambda x, p: changed(x, phidot=-x.phidot)
    )
    holds = {"gap": lambda x, p: x.phi}
    return _machine([Mode("rocking", model, holds)], [bounce], level_ground, ["energy"])


def gravity_wedge(angle: float = 0.6, gravity: float = 1.0) -> Model:
    """A unit point mass that bounces elastically in a symmetric wedge, whose walls lean by `angle` (rad).

    x is measured from the middle, y up from the corner. The parabola that meets both walls at right angles has the
    period T = 4 sin(a) / g sqrt(2 E / (1 + 2 cos(a)^2)).
    Source: H. Lehtihet, B. Miller, "Numerical study of a billiard in a gravitational field", Physica D 21 (1986)
    93-104.
    """
    made = ingredients(2, locals(), ("angle", "gravity"))
    model = made.model(
        "gravity_wedge", ca.sumsqr(made.v) / 2, made.gravity * made.q[1], names=["x", "y"],
        points=_downwards(made.q),
    )  # fmt: skip

    def distance(side: int) -> Expression:
        return lambda x, p: x.y * ca.sin(p.angle) - side * x.x * ca.cos(p.angle)

    gaps = {"right": distance(1), "left": distance(-1)}
    bounces = [
        Transition(name, "air", "air", guard=gap, reset=impact(model, gap, 1.0).after) for name, gap in gaps.items()
    ]

    def walls(x: Named, p: Named) -> Any:
        del x
        across = REACH * ca.tan(p.angle)
        return ca.horzcat(ca.vertcat(-REACH, -across), ca.SX.zeros(2), ca.vertcat(-REACH, across))

    holds = {f"distance from the {name} wall": gap for name, gap in gaps.items()}
    return _machine([Mode("air", model, holds)], bounces, walls, ["energy"])


def wall_pendulum(
    wall: float = 0.2,
    length1: float = 1.0,
    length2: float = 1.0,
    mass1: float = 1.0,
    mass2: float = 1.0,
    gravity: float = 9.81,
) -> Model:
    """A double pendulum of point masses, the lower of which hits an upright wall (m to the right) elastically.

    Angles from the downward vertical; M (v+ - v-) = J^T P, J v+ = -J v-.
    """
    made = ingredients(2, locals(), ("length1", "length2", "mass1", "mass2", "gravity"))
    places = [made.length1 * ca.vertcat(ca.cos(made.q[0]), ca.sin(made.q[0]))]
    places.append(places[0] + made.length2 * ca.vertcat(ca.cos(made.q[1]), ca.sin(made.q[1])))
    masses = list(zip((made.mass1, made.mass2), places, strict=True))
    kinetic = sum((m * ca.sumsqr(ca.jtimes(place, made.q, made.v)) / 2 for m, place in masses), ca.SX(0))
    potential = sum((-m * made.gravity * place[0] for m, place in masses), ca.SX(0))
    model = made.model(
        "wall_pendulum", kinetic, potential, names=["theta1", "theta2"], angles=[True, True],
        points=ca.horzcat(ca.SX.zeros(2), *places),
    )  # fmt: skip

    def elbow(x: Named, p: Named) -> Any:
        return p.wall - p.length1 * ca.sin(x.theta1)

    def gap(x: Named, p: Named) -> Any:
        return elbow(x, p) - p.length2 * ca.sin(x.theta2)

    struck = impact(model, gap, 1.0)
    hit = Transition(
        "hit", "free", "free", guard=struck.gap, reset=struck.after, impulse=struck.impulse, lost=struck.lost
    )
    holds = {"gap": gap, "gap of the elbow": elbow}
    return _machine([Mode("free", model, holds)], [hit], _wall("wall"), ["energy"])


def bouncing_ball(
    amplitude: float = 0.012, frequency: float = 2 * np.pi, gravity: float = 1.0, restitution: float = 0.8
) -> Model:
    """A ball on a table at amplitude sin(frequency t): height y, speed v, and the table's phase, an angle.

    At an impact v+ = (1 + e) u - e v-, u the table's speed. The cycle is one bounce, of a period of the table.
    Source: J. Guckenheimer, P. Holmes, Nonlinear Oscillations (1983), section 2.4.
    """
    made = ingredients(1, locals(), ("frequency", "gravity"))
    model = made.first_order(
        "bouncing_ball", lambda _, x, p: [x.v, -p.gravity, p.frequency], ("y", "v", "phase"), angles=("phase",),
        points=lambda x, p: ca.vertcat(-x.y, 0),
    )  # fmt: skip

    def table(x: Named, p: Named) -> Any:
        return p.amplitude * ca.sin(x.phase)

    def bounced(x: Named, p: Named) -> Any:
        speed = p.amplitude * p.frequency * ca.cos(x.phase)
        return changed(x, v=(1 + p.restitution) * speed - p.restitution * x.v)

    holds = {"gap": lambda x, p: x.y - table(x, p)}
    bounce = Transition("bounce", "air", "air", guard=holds["gap"], reset=bounced)
    return _machine(
        [Mode("air", model, holds)], [bounce],
        lambda x, p: ca.vertcat(ca.horzcat(-table(x, p), -table(x, p)), ca.SX([[-REACH, REACH]])),
    )  # fmt: skip


def impact_oscillator(
    damping: float = 0.1, frequency: float = 2.0, force: float = 1.0, stop: float = 0.0, restitution: float = 0.8
) -> Model:
    """x'' + damping x' + x = force cos(phase), phase' = frequency, with a stop at x = stop: v+ = -restitution v-.

    The cycle is one impact; the phase turns once or, with `winding`, more often between two.
    Source: S. W. Shaw, P. J. Holmes, "A periodically forced piecewise linear oscillator", Journal of Sound and
    Vibration 90 (1983) 129-155.
    """
    made = ingredients(1, locals(), ("frequency",))
    model = made.first_order(
        "impact_oscillator",
        lambda _, x, p: [x.v, p.force * ca.cos(x.phase) - p.damping * x.v - x.x, p.frequency],
        ("x", "v", "phase"),
        angles=("phase",),
        points=lambda x, p: ca.vertcat(0, x.x),
    )
    hit = Transition(
        "hit", "free", "free", guard=lambda x, p: x.x - p.stop, direction=1,
        reset=lambda x, p: changed(x, x=p.stop, v=-p.restitution * x.v),
    )  # fmt: skip
    holds = {"gap": lambda x, p: p.stop - x.x}
    return _machine([Mode("free", model, holds)], [hit], _wall("stop"))


__all__ = [
    "bouncing_ball", "compass_gait", "five_link_walker", "gravity_wedge", "impact_oscillator", "kneed_walker",
    "rimless_wheel", "rocking_block", "simplest_walker", "slip_runner", "slip_walker", "vertical_hopper",
    "wall_pendulum",
]  # fmt: skip
MACHINES: dict[str, Callable[..., Model]] = {name: globals()[name] for name in __all__}
