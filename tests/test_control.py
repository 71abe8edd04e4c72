"""Controls: parameters that vary in time, and the optimal motions that they make."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.control.find import gather_controlled
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.minimal import native_state
from orbitfinder.loops.control import METHODS, Basis, history
from orbitfinder.mechanics.controls import actuated, with_controls
from orbitfinder.mechanics.expression import expression
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import altered, vector_field
from orbitfinder.mechanisms.linkage import minimal_linkage


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
    least = minimal_linkage(bars, [1])
    small = driven_field(least, np.array([angle, rate]), torques)
    large = driven_field(bars, native_state(least.system, np.array([angle, rate])), torques)
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


def test_controls_of_equations_as_text() -> None:
    """Of rates, a Hamiltonian and a Lagrangian: as of Python functions, rebuilt from their description."""
    values, limits = {"push": 0.0, "k": 1.0}, {"push": [-1.0, 4.0]}
    texts: list[dict[str, Any]] = [
        {"rates": {"q": "v", "v": "push - k*q"}},
        {"hamiltonian": "v^2/2 + k*q^2/2 - push*q", "coordinates": ["q"], "momenta": ["v"]},
        {"kinetic": "qdot^2/2", "potential": "k*q^2/2", "forces": {"q": "push"}, "coordinates": ["q"]},
    ]
    for text in texts:
        model = of.equations(parameters=values, controls=limits, **text)
        again = build_model(model.system)
        assert again.controls == model.controls == ("push",) and again.limits == model.limits == {"push": (-1.0, 4.0)}
        assert driven_field(again, np.array([0.5, 2.0]), np.array([3.0]))[1] == pytest.approx(2.5)
        assert model.conservative == ("rates" not in text) and not actuated(model).conservative
    endless = of.equations(texts[0]["rates"], values, controls={"push": np.inf})
    assert endless.limits == {"push": (-np.inf, np.inf)}


@pytest.mark.slow
def test_a_stirred_tank_as_text() -> None:
    """Two parallel reactions, 40 held values: more than the steady optimum; 0.0929 is what is to be reached."""
    problem = of.load_problem(Path(__file__).parent / "data" / "stirred-tank.toml")
    orbit = of.find_orbit(problem)
    assert orbit.certificate is not None and orbit.certificate.passed and orbit.control is not None
    assert orbit.control["cost"] < -0.0929


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: of.chain(2, motors=[3]), "motors: 3 in"),
        (lambda: of.chain(2, motors=[1, 1]), "give different joints"),
        (lambda: of.chain(2, motors=[1], limits={"torque2": 1.0}), "limits: 'torque2' is no control"),
        (lambda: of.chain(2, motors=[1], limits={"torque1": [2.0, 1.0]}), "must be a positive number or"),
        (lambda: of.chain(2, motors=[1], limits={"torque1": -2.0}), "must be a positive number or"),
        (lambda: with_controls(of.chain(2), ["torque"]), "controls: 'torque' is no physical parameter"),
        (
            lambda: of.equations({"x": "u - x"}, {"u": 1.0}, controls={"w": 2.0}),
            "controls: 'w' is no physical parameter; known are u",
        ),
        (
            lambda: of.equations({"x": "u - x"}, {"u": 1.0}, controls={"u": [2.0, 1.0]}),
            "limits.u: must be a positive number or [lowest, highest], got [2.0, 1.0]",
        ),
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


PICK = (of.Task("x", 0.5, equals=1.0), of.Task("xdot", 0.5, equals=0.0))


def pick(stiffness: float, intervals: int, shape: str = "linear", **parts):  # type: ignore[no-untyped-def]
    """Rest at -1, rest at 1, back after 2 s."""
    return of.Problem(
        of.systems.driven_oscillator(stiffness), of.Guess([-1.0, 0.0], 2.0), of.pin(x=-1.0, xdot=0.0, period=2.0),
        control=of.Control("force**2", shape, intervals, tasks=PICK, **parts),
    )  # fmt: skip


def maintained(shape: str = "fourier", **parts):  # type: ignore[no-untyped-def]
    """A damped oscillator whose mean square is held."""
    return of.Problem(
        of.systems.driven_oscillator(1.0, 0.2), of.Guess([1.0, 0.0], 6.3), name="maintained",
        control=of.Control(
            "force**2", shape, 16, 3, average=True, guess={"force": 0.01},
            tasks=(of.Task("x**2", "mean", equals=0.5),), **parts,
        ),
    )  # fmt: skip


def cost_of(problem: of.Problem) -> float:
    orbit = of.find_orbit(problem)
    assert orbit.control is not None and orbit.certificate is not None and orbit.certificate.passed
    return float(orbit.control["cost"])


REFERENCE = {
    one["id"]: one["values"]
    for one in json.loads((Path(__file__).parent / "data" / "control.json").read_text())["entries"]
}


@pytest.mark.parametrize(("shape", "order"), [pytest.param("zero-order", 2.0, marks=pytest.mark.slow), ("linear", 4.0)])
def test_pick_and_place_converges_to_the_closed_form(shape: str, order: float) -> None:
    exact = float(REFERENCE["pick-place"]["k4_T2"])
    errors = [cost_of(pick(4.0, count, shape)) - exact for count in (20, 40)]
    assert errors[1] > 0
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)
    if shape == "linear":  # where controls of this form hold the optimum it is found to round-off
        assert cost_of(pick(0.0, 10)) == pytest.approx(96.0, rel=1e-11)


@pytest.mark.slow
def test_pick_and_place_to_ten_digits_of_the_continuous_optimum() -> None:
    assert abs(cost_of(pick(4.0, 720)) - float(REFERENCE["pick-place"]["k4_T2"])) < 1e-10


@pytest.mark.slow
def test_the_kept_amplitude_costs_what_parseval_says_and_meets_pontryagin() -> None:
    orbit = of.find_orbit(maintained())
    assert orbit.certificate is not None and orbit.certificate.passed and orbit.control is not None
    omega, value = map(float, REFERENCE["maintain"]["c0p2_k1"].replace("omega", "").split(","))
    assert orbit.control["cost"] == pytest.approx(value, rel=1e-10)
    assert orbit.period == pytest.approx(2 * np.pi / omega, rel=1e-10)
    stationary = next(one for one in orbit.certificate.checks if one.name == "stationarity")
    fit = gather_controlled(
        build_model(orbit.system), orbit.state, orbit.period, np.zeros(1, int), orbit.control, orbit.symmetry
    ).fit
    assert fit.pointwise < 1e-6 and stationary.value == fit.left < 1e-8
    assert f"{fit.pointwise:.2g}" in stationary.note and "not shown" in stationary.note
    assert cost_of(maintained(method="collocation")) == pytest.approx(value, rel=1e-10)


def test_a_costate_or_a_multiplier_that_is_not_its_own_is_rejected() -> None:
    best = of.find_orbit(pick(4.0, 20))
    assert best.control is not None and best.certificate is not None and best.certificate.passed
    name, value = next(iter(best.control["multipliers"].items()))
    far = {name: value + 1e-2 * max(map(abs, best.control["multipliers"].values()))}
    changes: tuple[dict[str, object], ...] = (
        {"costate": [1.01 * one for one in best.control["costate"]]},
        {"costate": []},
        {"multipliers": dict(best.control["multipliers"]) | far},
        {"multipliers": {}},
    )
    for change in changes:
        assert of.certify(replace(best, control=dict(best.control) | change)).failures == ("costate",), change


def test_a_control_one_per_cent_off_is_rejected_by_name() -> None:
    """The same task done by another control that closes as well: only its optimality is missing."""
    best, wrong = (of.find_orbit(replace(pick(4.0, 20), control=replace(pick(4.0, 20).control, cost=cost)))  # type: ignore[type-var]
                   for cost in ("force**2", "force**2 + 0.02 * (force * x)**2"))  # fmt: skip
    assert best.control is not None and wrong.control is not None
    off = np.abs(np.array(wrong.control["coefficients"]) - np.array(best.control["coefficients"])).max()
    assert 1e-3 < off / np.abs(best.control["coefficients"]).max() < 0.02
    claimed = dict(wrong.control) | {"cost_of": "force**2"}
    claimed |= _recomputed(wrong, claimed)
    failures = of.certify(replace(wrong, control=claimed)).failures
    assert failures == ("stationarity",)


@pytest.mark.parametrize("place", [0.33, *(pytest.param(place, marks=pytest.mark.slow) for place in (-0.7123, 0.05))])
def test_a_force_far_narrower_than_a_step_is_found(place: float) -> None:
    """2e-5 of the motion wide, and what it does to it: 7e-3."""

    def moved(kick: float) -> of.Model:
        q, v, force, wide = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("force"), 2e-5
        push = force + kick / (wide * np.sqrt(np.pi)) * ca.exp(-(((q - place) / wide) ** 2)) * v
        symbols = of.Symbols(q, v, force, ("force",), (0.0,))
        return of.lagrange(v**2 / 2, q**2 / 2, symbols, forces=push, names=["x"], controls=["force"])

    control = of.Control("force**2", "linear", 20, tasks=PICK)
    pins = of.pin(x=-1.0, xdot=0.0, period=2.0)
    orbit = of.find_orbit(of.Problem(moved(0.0), of.Guess([-1.0, 0.0], 2.0), pins, control=control))
    assert of.certify(orbit, moved(0.0)).passed
    assert "resolution" in of.certify(orbit, moved(6.8e-3)).failures


def _recomputed(orbit: of.Orbit, entry: dict) -> dict:  # type: ignore[type-arg]
    """Cost, costate and multipliers as a record of this control would truly have them."""
    model = build_model(orbit.system)
    found = gather_controlled(model, orbit.state, orbit.period, np.zeros(1, int), entry, orbit.symmetry).fit
    return {"cost": found.cost, "costate": found.costate, "multipliers": dict(found.multipliers)}


def test_a_limit_that_is_met_has_the_sign_of_a_limit() -> None:
    problem = of.load_problem("problems/control/pendulum-pump.toml")
    orbit = of.find_orbit(replace(problem, control=replace(problem.control, intervals=20)))  # type: ignore[type-var]
    free = of.find_orbit(replace(
        problem, model=of.chain(1, motors=[1], limits={"torque1": 1.2}),
        control=replace(problem.control, intervals=20)))  # type: ignore[type-var]  # fmt: skip
    for one in (orbit, free):
        assert one.certificate is not None and one.certificate.passed, one.certificate
    assert free.control is not None and orbit.control is not None and free.control["cost"] > orbit.control["cost"]
    held = [value for name, value in free.control["multipliers"].items() if name.startswith("bound")]
    assert held and np.abs(free.control["coefficients"]).max() == pytest.approx(1.2, rel=1e-8)
    planted = dict(free.control) | {"limits": {"torque1": [-1.5, 1.5]}}
    assert "stationarity" in of.certify(replace(free, control=planted)).failures


@pytest.mark.slow
def test_what_holds_always_is_kept_and_looked_at_between() -> None:
    """A speed limit that is met for a while, with multipliers of its sign; power between too few points is refused."""
    control = of.Control("force**2", "linear", 20, tasks=(*PICK, of.Task("xdot", lowest=-2.6, highest=2.6)))
    slow = of.find_orbit(replace(pick(4.0, 20), control=control))
    assert slow.certificate is not None and slow.certificate.passed and slow.control is not None
    met = [value for name, value in slow.control["multipliers"].items() if name.startswith("limit xdot")]
    assert len(met) >= 4 and slow.control["cost"] > cost_of(pick(4.0, 20)) + 5
    assert np.abs(slow.samples[:, 1]).max() == pytest.approx(2.6, rel=1e-3)
    power = replace(control, tasks=(*PICK, of.Task("force * xdot", highest=6.0)))
    rough = of.find_orbit(replace(pick(4.0, 20), control=power))
    assert rough.certificate is not None and rough.certificate.failures == ("task: force * xdot always",)


@pytest.mark.slow
def test_a_spring_and_a_period_are_chosen_with_the_motion() -> None:
    free = replace(pick(4.0, 20), free=("stiffness",))
    free = replace(free, control=replace(free.control, final="0.5 * stiffness**2"))  # type: ignore[type-var]
    orbit = of.find_orbit(free)
    assert orbit.certificate is not None and orbit.certificate.passed and orbit.control is not None
    best = orbit.system["arguments"]["stiffness"]
    near = [cost_of(pick(best + by, 20)) + 0.5 * (best + by) ** 2 for by in (-0.01, 0.01)]
    assert min(near) > orbit.control["cost"] and np.diff(near)[0] == pytest.approx(0.0, abs=1e-4)
    timed = of.Problem(free.model, of.Guess([-1.0, 0.0], 2.0), of.pin(x=-1.0, xdot=0.0), bounds={"period": (1.0, 1.9)},
                       control=of.Control("force**2 + 0.5", "linear", 20, tasks=PICK))  # fmt: skip
    held = of.find_orbit(timed)
    assert held.certificate is not None and held.certificate.passed and held.control is not None
    assert held.period == pytest.approx(1.9, rel=1e-7) and held.control["multipliers"]["held period"] > 0
    loose = dict(held.control) | {"bounds": {"period": [1.0, 3.0]}}
    assert "stationarity" in of.certify(replace(held, control=loose)).failures


def test_a_symmetric_motion_is_found_over_half_its_period() -> None:
    whole, half = (of.find_orbit(replace(maintained(), symmetry=one)) for one in ("none", "reflection"))
    assert half.control is not None and whole.control is not None and half.symmetry == "reflection"
    assert half.control["cost"] == pytest.approx(whole.control["cost"], rel=1e-11)
    assert half.certificate is not None and half.certificate.passed


def test_a_controlled_orbit_is_saved_loaded_and_verified(tmp_path: Path) -> None:
    orbit = of.find_orbit(maintained("cubic"))
    path = of.save_orbit(orbit, tmp_path / "orbit.json")
    again = of.load_orbit(path)
    assert again.control == orbit.control and of.certify(again).passed
    document = json.loads(path.read_text())
    document["control"]["coefficients"][0][3] *= 1.01
    path.write_text(json.dumps(document))
    failures = of.certify(of.load_orbit(path)).failures
    assert {"closure", "stationarity", "record"} <= set(failures)
    assert (tmp_path / "controls.png") in of.save_figures(orbit, tmp_path)
    times, values = history(orbit.control, orbit.period)  # type: ignore[arg-type]
    assert times[-1] == pytest.approx(orbit.period) and values[0] == pytest.approx(values[-1], abs=1e-12)
    for refused in (lambda: of.export_orbit(orbit, "julia", tmp_path), lambda: of.prove(orbit)):
        with pytest.raises(InputError, match="is a controlled orbit"):
            refused()


FILES = [path for path in sorted(Path("problems/control").glob("*.toml")) if "[control]" in path.read_text()]
QUICK = {"maintained-oscillator"}


@pytest.mark.parametrize(
    "path", [pytest.param(one, marks=() if one.stem in QUICK else pytest.mark.slow) for one in FILES]
)
def test_shooting_and_collocation_agree_on_every_problem_file(path: Path) -> None:
    problem = of.load_problem(path)
    costs = [cost_of(replace(problem, control=replace(problem.control, method=one))) for one in METHODS]  # type: ignore[type-var]
    assert costs[0] == pytest.approx(costs[1], rel=1e-8)


def test_hybrid_events_are_required_to_be_events() -> None:
    """The hopper's recorded flight is cut short: its guard is missed, and named."""
    orbit = of.find_orbit(of.load_problem("problems/control/hopping-monopod.toml"))
    assert orbit.control is not None
    shares = {name: value * 1.001 for name, value in orbit.control["shares"].items()}
    failures = of.certify(replace(orbit, control=dict(orbit.control) | {"shares": shares})).failures
    assert "event: liftoff" in failures
    model = build_model(orbit.system)
    turned = tuple(replace(each, direction=-each.direction) for each in model.hybrid.transitions)
    other = altered(model, hybrid=replace(model.hybrid, transitions=turned))
    (event, *_) = (check for check in of.certify(orbit, other).checks if check.name.startswith("event: "))
    assert not event.passed and "crossed the other way than its direction says" in event.note


def test_the_order_of_fourier_coefficients_is_what_is_said() -> None:
    """Constant, cos 1, sin 1, cos 2, sin 2 of the phase."""
    basis, phase = Basis("fourier", 8, 2), 0.1
    angle = 2 * np.pi * phase
    wanted = [1.0, np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)]
    assert np.allclose(np.array(basis.values(0.0, phase), float), wanted)
    assert "constant, cos 1, sin 1, cos 2, sin 2" in (of.Control.__doc__ or "")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: of.Problem(of.chain(1), of.Guess([1.0, 0.0], 2.0), control=of.Control("theta1")), "has no controls"),
        (lambda: of.Control("u", "quadratic"), "control.shape: unknown 'quadratic'"),
        (lambda: of.Control("u", method="magic"), "control.method: unknown"),
        (lambda: of.Control("u", intervals=1), "control.intervals: must be from 2"),
        (lambda: of.Control("u", "fourier", 4, 9), "too few for 9 harmonics"),
        (lambda: of.Task("x", 1.5, equals=0.0), "must be a phase from 0 to below 1"),
        (lambda: of.Task("x", "never", equals=0.0), "'always' or 'mean'"),
        (lambda: of.Task("x"), "needs equals, or lowest"),
        (lambda: of.Task("x", lowest=2.0, highest=1.0), "give lowest <= highest"),
        (lambda: of.Task("x", equals=1.0), "cannot equal a number always"),
        (lambda: of.find_orbit(replace(pick(4.0, 10), control=of.Control("forse**2"))), "unknown name 'forse'"),
        (lambda: of.find_orbit(pick(4.0, 7)), "is no boundary of the control's intervals"),
        (lambda: of.find_orbit(shaken(free=("w",))), "w: the forcing's period depends on it; neither free it"),
        (lambda: of.find_orbit(shaken(symmetry="reflection")), "symmetry: controlled motions of forced systems have"),
        (lambda: expression("__import__('os')", {}, "cost"), "is not allowed"),
        (lambda: expression("x.real", {"x": 1.0}, "cost"), "is not allowed"),
        (lambda: expression("x +", {"x": 1.0}, "cost"), "is no expression"),
        (lambda: expression("(lambda: 1)()", {}, "cost"), "is not allowed"),
        (lambda: of.Problem(of.chain(1, motors=[1]), of.Guess([1.0, 0.0], 2.0), control=of.Control("torque1**2"),
                            objective="min_instability"), "objective: is for motions without control"),
    ],
)  # fmt: skip
def test_what_cannot_be_asked_of_a_control_is_said(make, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=re.escape(words)):
        make()


def test_a_task_that_nothing_can_do_says_so() -> None:
    problem = replace(pick(4.0, 10), model=with_controls(of.systems.driven_oscillator(4.0), ["force"], {"force": 0.5}))
    with pytest.raises(ConvergenceError, match="no motion does what is asked"):
        of.find_orbit(problem)


@pytest.mark.slow
def test_a_family_of_optima_ends_at_the_conservative_orbit_that_costs_nothing() -> None:
    """Pick and place as the spring stiffens to where it does it alone, k = (2 pi / T)^2; then without one, slower."""
    resonant = np.pi**2
    family = of.follow_optima(pick(4.0, 20), "stiffness", [4.0, 7.0, resonant])
    costs = [float(one.control["cost"]) for one in family]  # type: ignore[index]
    assert len(family) == 3 and costs[0] > costs[1] > 1.0 and costs[2] < 1e-18
    assert all(one.certificate is not None and one.certificate.passed for one in family), family[2].certificate
    spring = of.find_orbit(of.Problem(of.systems.duffing(float(resonant), 0.0), of.Guess([-1.0, 0.0], 2.0),
                                      of.pin(x=-1.0)))  # fmt: skip
    np.testing.assert_allclose(family[2].state, spring.state, atol=1e-10)
    assert spring.period == pytest.approx(family[2].period, rel=1e-10)
    slower = of.follow_optima(pick(0.0, 10), "period", [2.0, 2.5])
    assert [one.control["cost"] for one in slower] == pytest.approx([768 / 8, 768 / 2.5**3], rel=1e-10)  # type: ignore[index]
    with pytest.raises(InputError, match="is no pin and no physical parameter"):
        of.follow_optima(pick(4.0, 10), "stifness", [4.0])


def shaken(period: str = "2*pi/w", cycles: float = 1.0, clock: bool = False, **more: Any) -> of.Problem:
    """A hardening oscillator pushed by a cosine and by a control, the cosine of the time or of a `clock` that is two
    states."""
    push = "0.4*c" if clock else "0.4*cos(w*t)"
    rates = {"x": "v", "v": f"-x - 0.1*v - 0.3*x^3 + {push} + u"}
    values, limits = {"u": 0.0, "w": 1.3}, {"u": [-0.25, 0.25]}
    start, lasts = [0.0, 1.0], cycles * 2 * np.pi / 1.3
    if clock:
        model = of.equations(rates | {"c": "-w*s", "s": "w*c"}, values, controls=limits)
        start, more = [*start, 1.0, 0.0], more | {"pin": of.pin(period=lasts, c=1.0, s=0.0)}
    else:
        model = of.equations(rates, values, period=period, controls=limits)
    control = of.Control("u^2 - 0.2*v^2", "zero-order", intervals=16, guess={"u": 0.1})
    return of.Problem(model, of.Guess(start, lasts), control=control, **more)


@pytest.mark.slow
def test_a_forced_system_is_controlled_at_the_phases_of_its_forcing() -> None:
    """As with a clock among the states, of which no certificate can be had: its radius is anything."""
    orbit = of.find_orbit(problem := shaken())
    assert orbit.certificate is not None and orbit.certificate.passed and orbit.control is not None
    notes = [check.note for check in orbit.certificate.checks]
    assert not any("H varies" in note for note in notes)  # nothing says that it is constant
    other = of.find_orbit(shaken(clock=True))
    assert other.control is not None and orbit.control["cost"] == pytest.approx(other.control["cost"], rel=1e-9)
    np.testing.assert_allclose(orbit.state, other.state[:2], rtol=0, atol=1e-8)
    by = of.find_orbit(replace(problem, control=replace(problem.control, method="collocation")))
    assert by.control is not None and by.control["cost"] == pytest.approx(orbit.control["cost"], rel=1e-9)
    assert abs(max(orbit.control["coefficients"][0]) - 0.25) < 1e-8  # a limit that is met, by IPOPT from inside
    assert orbit.control["method"] == "shooting"
    # in 8 intervals shooting ran away ("Invalid_Number_Detected")
    coarse = of.find_orbit(replace(problem, control=replace(problem.control, intervals=8)))
    assert coarse.certificate is not None and coarse.certificate.passed


@pytest.mark.slow
@pytest.mark.parametrize(("how", "failed"), [({"period": "4"}, "time_dependence"), ({"cycles": 2.0}, "minimal_period")])
def test_a_period_that_is_not_the_forcings_is_rejected_by_name(how: dict[str, Any], failed: str) -> None:
    certificate = of.find_orbit(shaken(**how)).certificate
    assert certificate is not None and certificate.failures == (failed,)


@pytest.mark.slow
def test_a_false_period_of_what_the_control_alone_brings_in_is_rejected() -> None:
    """Without the control the time is not in these equations."""
    rates = {"x": "v", "v": "-x-0.3*v+u*(1.5+cos(1.3*t))"}
    model = of.equations(rates, {"u": 0.0}, period="4", controls={"u": [-2, 2]})
    task = of.Task("v^2", "mean", equals=0.05)
    control = of.Control("-x + u^2 - 0.05*v^2", "linear", intervals=8, guess={"u": 0.1}, tasks=(task,))
    certificate = of.find_orbit(of.Problem(model, of.Guess([0.5, 0.3], 4.0), control=control)).certificate
    assert certificate is not None and certificate.failures == ("time_dependence",)


@pytest.mark.slow
def test_a_controlled_motion_of_another_period_than_the_forcing_has_is_rejected() -> None:
    orbit = of.find_orbit(shaken())
    assert "forcing_period" in of.certify(replace(orbit, period=orbit.period * (1 + 1e-12), record=None)).failures


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "method", "guess", "product"),
    [("zero-order", "collocation", 0.149, 0.0919), ("zero-order", "shooting", 0.149, 0.0919),
     ("linear", "collocation", 0.149, 0.0919),
     ("zero-order", "shooting", [0.449 if k in (2, 9, 17, 26, 33) else 0.049 for k in range(40)], 0.0919),
     ("linear", "shooting", [0.449 if k * 2 // 3 in (2, 9, 17, 26, 33) else 0.049 for k in range(60)], 0.0948)],
)  # fmt: skip
def test_a_tank_is_better_off_heated_in_pulses(shape, method, guess, product):
    """Two reactions, at rest 0.0844 of the product, no state pinned: held controls have their instants. In steps that
    lose the motion costs have no lower bound, and IPOPT stays 6e-8 inside of a limit. Own multiple shooting has
    0.09277 at most from 25 guesses where the control is linear in 40 intervals, 0.0949 in 60."""

    def field(_, x, p):
        made, lost = 1e4 * x.c1**2 * ca.exp(-1 / x.c3), 400 * x.c1 * ca.exp(-0.55 / x.c3)
        return [1 - made - lost - x.c1, made - x.c2, p.u - x.c3]

    tank = of.ode(field, ("c1", "c2", "c3"), {"u": 0.149}, controls=["u"], limits={"u": [0.049, 0.449]})
    intervals = len(guess) if isinstance(guess, list) else 40
    control = of.Control("-c2", shape, intervals=intervals, average=True, method=method, guess={"u": guess})
    problem = of.Problem(tank, of.Guess([0.1, 0.08, 0.15], 10.0), of.pin(period=10.0), control=control)
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.control["cost"] < -product and not orbit.control["normals"]
