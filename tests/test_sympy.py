"""Systems derived by SymPy's mechanics against our own derivations."""

from __future__ import annotations

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import InputError

sympy = pytest.importorskip("sympy")
pytestmark = pytest.mark.needs("robot")
from sympy.physics.mechanics import (  # noqa: E402
    KanesMethod,
    LagrangesMethod,
    Particle,
    Point,
    ReferenceFrame,
    RigidBody,
    dynamicsymbols,
    inertia,
)

THETA = dynamicsymbols("theta1:3")
RATES = [one.diff() for one in THETA]
SPEEDS = dynamicsymbols("omega1:3")
M, L, G, C, TAU = sympy.symbols("mass length gravity damping torque")
VALUES = {M: 1.0, L: 1.0, G: 9.8, C: 0.0, TAU: 0.0}


def rods(rates):
    """Two uniform rods, x down, y right, absolute angles."""
    frame, pivot = ReferenceFrame("N"), Point("O")
    pivot.set_vel(frame, 0)
    bodies, frames, end = [], [], pivot
    for k, (angle, rate) in enumerate(zip(THETA, rates, strict=True)):
        turned = frame.orientnew(f"B{k}", "Axis", [angle, frame.z])
        turned.set_ang_vel(frame, rate * frame.z)
        centre = end.locatenew(f"C{k}", L / 2 * turned.x)
        centre.v2pt_theory(end, frame, turned)
        body = RigidBody(f"R{k}", centre, turned, M, (inertia(turned, 0, 0, M * L**2 / 12), centre))
        body.potential_energy = -M * G * centre.pos_from(pivot).dot(frame.x)
        bodies.append(body)
        frames.append(turned)
        end = end.locatenew(f"P{k}", L * turned.x)
        end.v2pt_theory(bodies[-1].masscenter, frame, turned)
    return frame, bodies, frames


def agrees(model, other, size=2):
    random = np.random.default_rng(0)
    for _ in range(4):
        q, v = random.uniform(-1, 1, (2, size))
        ours = model.acceleration(0.0, q, v, model.parameter_values).full().ravel()
        wanted = other.acceleration(0.0, q, v, other.parameter_values).full().ravel()
        assert ours == pytest.approx(wanted, rel=1e-12)
        assert of.energy(model, [*q, *v]) == pytest.approx(of.energy(other, [*q, *v]), rel=1e-12)


def test_lagranges_method_is_our_chain():
    frame, bodies, _ = rods(RATES)
    level = sum(one.kinetic_energy(frame) - one.potential_energy for one in bodies)
    model = of.from_sympy(LagrangesMethod(level, THETA), {M: 1.0, L: 1.0, G: 9.8})
    assert model.state_names == ("theta1", "theta2", "theta1dot", "theta2dot")
    assert model.parameter_names == ("mass", "length", "gravity") and model.conservative
    agrees(model, of.chain(2))
    orbit = of.find_orbit(of.Problem(model, of.guesses.normal_mode(model, 1, 0.3)))
    assert orbit.certificate.passed


def test_kanes_method_is_our_chain_with_gravity_as_loads():
    frame, bodies, _ = rods(SPEEDS)
    kane = KanesMethod(frame, q_ind=THETA, u_ind=SPEEDS, kd_eqs=[u - r for u, r in zip(SPEEDS, RATES, strict=True)])
    kane.kanes_equations(bodies, [(one.masscenter, M * G * frame.x) for one in bodies])
    model = of.from_sympy(kane, {M: 1.0, L: 1.0, G: 9.8})
    assert model.conservative  # what the loads do is what the potential says
    agrees(model, of.chain(2))
    with pytest.raises(InputError, match="values: no number for 'gravity'; give one for each constant"):
        of.from_sympy(kane, {M: 1.0, L: 1.0})


def test_damping_and_a_motor_are_forces():
    frame, bodies, frames = rods(RATES)
    level = sum(one.kinetic_energy(frame) - one.potential_energy for one in bodies)
    loads = [(frames[0], (TAU - C * RATES[0]) * frame.z)]
    model = of.from_sympy(LagrangesMethod(level, THETA, forcelist=loads, frame=frame), VALUES, controls=[TAU])
    free = of.from_sympy(LagrangesMethod(level, THETA, forcelist=[(frames[0], TAU * frame.z)], frame=frame), VALUES,
                         controls=[TAU])  # fmt: skip
    assert free.conservative and not model.conservative  # a motor at rest takes no energy; a damper does
    assert model.controls == ("torque",) and model.parameter_names[-2:] == ("damping", "torque")
    q, v, p = np.array([0.3, -0.4]), np.array([1.0, 2.0]), model.parameter_values.copy()
    p[-2:] = 0.5, 2.0
    chain = of.chain(2, motors=[1])
    numbers = chain.parameter_values.copy()
    numbers[chain.parameter_index("torque1")] = 2.0 - 0.5 * v[0]
    pushed = [model.acceleration(0.0, q, v, one) for one in (p, model.parameter_values)]
    wanted = [chain.acceleration(0.0, q, v, one) for one in (numbers, chain.parameter_values)]
    assert (pushed[0] - pushed[1]).full() == pytest.approx((wanted[0] - wanted[1]).full(), rel=1e-12)
    assert np.abs((pushed[0] - pushed[1]).full()).max() > 1


def test_what_is_refused():
    frame, bodies, _ = rods(RATES)
    level = sum(one.kinetic_energy(frame) - one.potential_energy for one in bodies)
    with pytest.raises(InputError, match="method: int; give a sympy LagrangesMethod or KanesMethod"):
        of.from_sympy(3, {})
    with pytest.raises(InputError, match="method: has constraints, which are not read from SymPy"):
        of.from_sympy(LagrangesMethod(level, THETA, hol_coneqs=[THETA[0] - THETA[1]]), VALUES)
    for values, said in (
        (3, "values: must be numbers by symbol, got 3"),
        ({**VALUES, M: "a"}, "values.mass: must be a finite number, got 'a'"),
        ({**VALUES, M: float("nan")}, "values.mass: must be a finite number, got nan"),
    ):
        with pytest.raises(InputError, match=said):
            of.from_sympy(LagrangesMethod(level, THETA), values)
    beat = sympy.cos(2 * dynamicsymbols._t)
    loads = [(bodies[0].masscenter, beat * frame.y)]
    for driven in (LagrangesMethod(level + beat * THETA[0], THETA),
                   LagrangesMethod(level, THETA, forcelist=loads, frame=frame)):  # fmt: skip
        with pytest.raises(InputError, match="forcing_period: the equations depend on time; give the period"):
            of.from_sympy(driven, VALUES)
    frame, bodies, _ = rods(SPEEDS)
    kinematics = [SPEEDS[0] - RATES[0], SPEEDS[1] - RATES[1] + RATES[0]]
    kane = KanesMethod(frame, q_ind=THETA, u_ind=SPEEDS, kd_eqs=kinematics)
    kane.kanes_equations(bodies, [])
    with pytest.raises(InputError, match="and not omega2.*; give Kane's method the coordinates' rates as speeds"):
        of.from_sympy(kane, VALUES)
    kane = KanesMethod(frame, q_ind=THETA, u_ind=SPEEDS, kd_eqs=[u - r for u, r in zip(SPEEDS, RATES, strict=True)])
    kane.kanes_equations([bodies[0], Particle("p", bodies[1].masscenter, M)], [])
    kane._bodylist = bodies
    with pytest.raises(InputError, match="method: its mass matrix differs from that of its energies by"):
        of.from_sympy(kane, VALUES)
