"""Built-in machines with motors: what they do without is the mechanism alone, and controls make them do tasks."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms.library import hanging, ingredients
from orbitfinder.mechanisms.machines import compass, hopper


def driven_oscillator(
    stiffness: float = 1.0, damping: float = 0.0, mass: float = 1.0, cubic: float = 0.0
) -> Model:  # fmt: skip
    """mass x'' + damping x' + stiffness x + cubic x^3 = force: a mass on a spring that hardens (cubic > 0) or softens,
    pushed by the control `force` (N)."""
    made = ingredients(1, locals(), ("mass",), controls=("force",))
    push = made.force - made.damping * made.v
    stored = made.stiffness * made.q**2 / 2 + made.cubic * made.q**4 / 4
    return made.model(
        "driven_oscillator", made.mass * made.v**2 / 2, stored, forces=push, names=["x"],
        points=ca.horzcat(ca.SX.zeros(2), ca.vertcat(0, made.q)), controls=["force"],
    )  # fmt: skip


def driven_cart_pole(cart: float = 1.0, mass: float = 0.3, length: float = 0.5, gravity: float = 9.81) -> Model:
    """A point mass on a rod (theta from the downward vertical) on a cart (y, m) that the control `force` (N) pushes."""
    made = ingredients(2, locals(), ("cart", "mass", "length"), controls=("force",))
    kinetic, potential, places = hanging(made)
    return made.model(
        "driven_cart_pole", kinetic, potential, names=["y", "theta"],
        angles=[False, True], forces=ca.vertcat(made.force, 0), points=places,
        controls=["force"],
    )  # fmt: skip


def driven_swing(
    mass: float = 1.0, length: float = 1.0, stiffness: float = 200.0, damping: float = 0.05, gravity: float = 9.81
) -> Model:
    """A swing whose length is worked: a mass at theta (rad) and r (m), held near `length` by a spring (N/m), and the
    control `force` (N) along the rope; `damping` (N m s) brakes the swing. Pumped at twice its frequency it swings on.
    """
    made = ingredients(2, locals(), ("mass", "length", "stiffness"), controls=("force",))
    (theta, r), (turning, stretching) = ca.vertsplit(made.q), ca.vertsplit(made.v)
    kinetic = made.mass * (stretching**2 + (r * turning) ** 2) / 2
    potential = -made.mass * made.gravity * r * ca.cos(theta) + made.stiffness * (r - made.length) ** 2 / 2
    return made.model(
        "driven_swing", kinetic, potential, names=["theta", "r"], angles=[True, False],
        forces=ca.vertcat(-made.damping * turning, made.force),
        points=ca.horzcat(ca.SX.zeros(2), r * ca.vertcat(ca.cos(theta), ca.sin(theta))), controls=["force"],
    )  # fmt: skip


def driven_compass(
    slope: float = 0.0, a: float = 0.5, b: float = 0.5, mass: float = 5.0, hip_mass: float = 10.0, gravity: float = 9.81
) -> Model:
    """The compass gait with a motor at its hip (`hip`, N m, turns the swing leg against the stance leg) and one at the
    stance ankle (`ankle`, against the ground), on level ground unless there is a slope (rad); see `compass_gait`.
    """
    return compass("driven_compass", locals(), ("hip", "ankle"))


def driven_hopper(
    mass: float = 1.0, stiffness: float = 100.0, damping: float = 1.0, gravity: float = 9.81
) -> Model:  # fmt: skip
    """A monopod that hops upright: a mass on a massless leg, on the ground (y < 0) a spring with a damper and the
    control `push` (N) beside it; it leaves the ground and comes back at the leg's length, y = 0.
    """
    made = ingredients(1, locals(), ("mass", "stiffness", "gravity"), controls=("push",))
    return hopper("driven_hopper", made, made.push - made.damping * made.v, controls=["push"])


__all__ = [
    "driven_cart_pole", "driven_compass", "driven_hopper", "driven_oscillator", "driven_swing",
]  # fmt: skip
DRIVEN: dict[str, Callable[..., Model]] = {name: globals()[name] for name in __all__}
"""By name: what problem files may call"""
