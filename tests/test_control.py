"""Controls: parameters that vary in time, and the optimal motions that they make."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.mechanics.catalogue import build_model, with_parameters
from orbitfinder.mechanics.controls import actuated, with_controls
from orbitfinder.mechanics.linkage import bar_angles, linkage_state, minimal_linkage
from orbitfinder.mechanics.model import vector_field


def driven_field(model: of.Model, state: np.ndarray, torques: np.ndarray) -> np.ndarray:
    """x' at a state and values of the controls."""
    return np.asarray(vector_field(model, free=model.controls)(0.0, state, [], torques).full().ravel())


def test_every_formulation_of_a_chain_has_the_same_motors() -> None:
    state, torques = np.random.default_rng(1).normal(size=6), np.array([1.0, -2.0, 0.5])
    found = [
        driven_field(of.chain(3, motors=[1, 2, 3], formulation=one), state, torques)
        for one in ("recursive", "lagrange", "newton-euler", "dae")
    ]
    assert max(np.abs(each - found[0]).max() for each in found) < 1e-12
    plain = vector_field(of.chain(3))(0.0, state, [], []).full().ravel()
    np.testing.assert_array_equal(driven_field(of.chain(3, motors=[2]), state, np.zeros(1)), plain)


def test_a_motor_s_power_is_torque_times_relative_rate() -> None:
    """dE/dt = sum u_k (v_k - v_k-1): of a chain, and of a four-bar driven at its first and last pivots."""
    model, state = of.chain(3, motors=[1, 3]), np.array([0.3, -0.8, 1.1, 0.7, -1.3, 2.0])
    slope = ca.MX.sym("x", 6)
    energy = model.kinetic(slope[:3], slope[3:], model.parameter_values) + model.potential(
        slope[:3], model.parameter_values
    )
    gradient = ca.Function("gradient", [slope], [ca.gradient(energy, slope)])(state).full().ravel()
    power = gradient @ driven_field(model, state, np.array([1.3, -0.7]))
    assert power == pytest.approx(1.3 * 0.7 - 0.7 * (2.0 + 1.3), rel=1e-12)

    bars = of.linkage([0.4, 1.0, 0.8], ground=[0.0, 1.0], motors=[1, 4])
    angle, rate, torques = 0.3, 0.7, np.array([1.3, -0.7])
    u = ca.SX.sym("u")
    closed = bar_angles(bars, [1])
    rates = ca.Function("rates", [u], [ca.jacobian(closed(u), u)])(angle).full().ravel() * rate
    small = driven_field(minimal_linkage(bars, [1]), np.array([angle, rate]), torques)
    large = driven_field(bars, linkage_state(bars, closed(angle).full().ravel(), rates), torques)
    assert small[1] == pytest.approx(large[9 + 2], rel=1e-11)


def test_a_mechanism_with_motors_at_rest_is_the_mechanism() -> None:
    model = of.chain(2, gravity=0.0, motors=[2])
    assert model.conservative and model.canonical and len(model.invariants) == 2
    assert [one.name for one in actuated(model).invariants] == ["angular_momentum"]
    assert actuated(of.chain(2, gravity=0.0, motors=[1])).invariants == ()
    swing = with_controls(of.systems.spring_pendulum(), ["stiffness"])
    assert swing.conservative and not actuated(swing).conservative


def test_controls_of_first_order_lagrangian_and_constrained_systems() -> None:
    made = of.ode(
        lambda t, x, p: [x.v, -x.q + p.push], ("q", "v"), {"push": 0.0}, controls=["push"], limits={"push": 2}
    )
    assert made.controls == ("push",) and made.limits == {"push": (-2.0, 2.0)}
    q, v, u = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("u")
    symbols = of.Symbols(q, v, u, ("push",), (0.0,))
    model = of.lagrange(v**2 / 2, q**2 / 2, symbols, forces=u - 0 * v, controls=["push"])
    assert model.conservative and not actuated(model).conservative and actuated(model).forces is not None
    damped = of.lagrange(v**2 / 2, q**2 / 2, symbols, forces=u - 0.1 * v, controls=["push"])
    assert not damped.conservative
    full = actuated(damped).forces
    assert full is not None and float(full(0.0, 1.0, 2.0, 3.0)) == pytest.approx(2.8)
    for one in (model, damped):
        assert driven_field(one, np.array([0.5, 2.0]), np.array([3.0]))[1] == pytest.approx(
            2.5 if one is model else 2.3
        )
    xy, vv = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    rod = of.constrained(
        ca.sumsqr(vv) / 2, -9.8 * xy[0], ca.sumsqr(xy) - 1, of.Symbols(xy, vv, u, ("push",), (0.0,)),
        forces=u * ca.vertcat(-xy[1], xy[0]), controls=["push"],
    )  # fmt: skip
    assert rod.conservative and rod.controls == ("push",)
    assert driven_field(rod, np.array([1.0, 0, 0, 0]), np.array([3.0]))[3] == pytest.approx(3.0)


def test_a_hybrid_system_has_the_controls_of_its_modes() -> None:
    def falling(t, x, p):  # type: ignore[no-untyped-def]
        return [x.v, -9.8 + p.thrust]

    ball = of.ode(falling, ("y", "v"), {"thrust": 0.0}, controls=["thrust"], limits={"thrust": (0.0, 3.0)})
    bounce = of.Transition("bounce", "air", "air", guard=lambda x, p: x.y, reset=lambda x, p: ca.vertcat(x.y, -x.v))
    model = of.hybrid({"air": ball}, [bounce], ["bounce"])
    assert model.controls == ("thrust",) and model.limits == {"thrust": (0.0, 3.0)}


def test_a_description_with_motors_is_rebuilt() -> None:
    model = of.chain(2, motors=[2], limits={"torque2": (-1.0, 4.0)})
    again = build_model(model.system)
    assert again.controls == ("torque2",) and again.limits == {"torque2": (-1.0, 4.0)}
    assert build_model(of.linkage([0.4, 1.0, 0.8], ground=[0.0, 1.0], motors=[4]).system).controls == ("torque4",)
    named = {
        "kind": "python",
        "function": "spring_pendulum",
        "controls": ["stiffness"],
        "limits": {"stiffness": [1, 9]},
    }
    made = build_model(named)
    assert made.controls == ("stiffness",) and made.limits == {"stiffness": (1.0, 9.0)}


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: of.chain(2, motors=[3]), "motors: 3 in"),
        (lambda: of.chain(2, motors=[1, 1]), "give different joints"),
        (lambda: of.chain(2, motors=[1], limits={"torque2": 1.0}), "limits: 'torque2' is no control"),
        (lambda: of.chain(2, motors=[1], limits={"torque1": [2.0, 1.0]}), "must be a positive number or"),
        (lambda: of.chain(2, motors=[1], limits={"torque1": -2.0}), "must be a positive number or"),
        (lambda: with_controls(of.chain(2), ["torque"]), "controls: 'torque' is no physical parameter"),
        (lambda: with_controls(of.chain(2), "mass1"), "must be a list of names"),
        (lambda: with_controls(of.chain(2), ["mass1", "mass1"]), "is named twice"),
        (
            lambda: of.Problem(of.chain(2, motors=[1]), of.Guess(np.ones(4), 1.0), free=("torque1",)),
            "torque1: is a con",
        ),
        (lambda: with_parameters(of.chain(2, motors=[1]), {"torque1": 2.0}), "torque1: is a control and varies"),
    ],
)
def test_what_is_no_control_is_refused(make, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=words.replace("[", r"\[").replace("(", r"\(")):
        make()
