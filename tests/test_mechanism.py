"""Mechanisms against quadratures in one coordinate, elliptic integrals, their own minimal form, and bad drawings."""

import json
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq
from scipy.special import ellipk

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families.minimal import dead_point, minimal_problem, native_state
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.lagrange import Symbols, mass_matrix_and_bias
from orbitfinder.mechanics.model import wrapped
from orbitfinder.problemfile.read import load_problem

GALLERY = Path(__file__).parents[1] / "problems" / "mechanisms"
G = 9.81


def steel(length):
    """(mass, inertia) of a flat of 20 mm x 5 mm steel, as the gallery has them."""
    return round(0.785 * length, 7), float(f"{0.785 * length**3 / 12:.6g}")


def revolute(first, second, here=(0.0, 0.0), there=(0.0, 0.0)):
    return {"kind": "revolute", "between": [first, second], "at": [list(here), list(there)]}


def bar(length):
    mass, inertia = steel(length)
    return {"mass": mass, "inertia": inertia, "com": [length / 2, 0.0]}


def four_bar(**more):
    return of.mechanism(
        {"crank": bar(0.06), "coupler": bar(0.18), "rocker": bar(0.12)},
        {
            "A": revolute("ground", "crank"), "D": revolute("ground", "rocker", (0, 0.16)),
            "B": revolute("crank", "coupler", (0.06, 0)), "C": revolute("coupler", "rocker", (0.18, 0), (0.12, 0)),
        },
        gravity=[G, 0], pose={"A": 0.5}, **more,
    )  # fmt: skip


def quadrature(parts, begin, potential=lambda u: 0.0, reach=(0.05, 3.0), count=240):
    """Period of one coordinate u released at rest at `begin`: the integral of sqrt(2 M / (E - V)) by sin phi.

    `parts(u)` are (mass, inertia, x, y, angle) of the bodies, differentiated by a complex step; in long doubles,
    because E - V is a small difference of large numbers near its ends.
    """
    step = np.clongdouble(1e-30j)

    def inertia(u):
        moved = parts(u + step)
        return sum(p[0] * ((p[2].imag * 1e30) ** 2 + (p[3].imag * 1e30) ** 2) + p[1] * (p[4].imag * 1e30) ** 2
                   for p in moved if np.iscomplexobj(p[2]))  # fmt: skip

    def energy(u):
        return sum(-p[0] * G * p[2].real for p in parts(u + 0 * step)) + potential(u + 0 * step)

    begin = np.longdouble(begin)
    level = energy(begin)
    ways = np.sign(energy(begin - 1e-6) - energy(begin + 1e-6))  # downhill
    steps = begin + ways * np.linspace(reach[0], reach[1], 400)
    beyond = next(k for k, u in enumerate(steps) if energy(u) > level)
    low, high = steps[beyond - 1], steps[beyond]
    for _ in range(70):
        end = (low + high) / 2
        low, high = (end, high) if energy(end) < level else (low, end)
    middle, half = (begin + end) / 2, (end - begin) / 2
    pi = np.longdouble("3.14159265358979323846")
    phi = (np.arange(count) + np.longdouble(0.5)) * pi / count - pi / 2
    places = middle + half * np.sin(phi)
    values = [
        abs(half) * np.cos(f) * np.sqrt(inertia(u) / (2 * (level - energy(u))))
        for f, u in zip(phi, places, strict=True)
    ]
    return float(2 * np.sum(values) * pi / count)


def four_bar_parts(crank):
    """Circles cut by hand: the knee, the tip on the other side of the line to the rocker's pivot."""
    knee = 0.06 * np.array([np.cos(crank), np.sin(crank)])
    gap = np.array([0.0, 0.16]) - knee
    distance = np.sqrt(gap[0] ** 2 + gap[1] ** 2)
    along = (distance**2 + 0.18**2 - 0.12**2) / (2 * distance)
    aside = np.sqrt(0.18**2 - along**2)
    tip = knee + along * gap / distance + aside * np.array([gap[1], -gap[0]]) / distance
    coupler, rocker = tip - knee, tip - np.array([0.0, 0.16])
    angle = [np.arctan(one[1] / one[0]) for one in (coupler, rocker)]
    return [
        (*steel(0.06), *(knee / 2), crank), (*steel(0.18), *((knee + tip) / 2), angle[0]),
        (*steel(0.12), *(rocker / 2 + np.array([0.0, 0.16])), angle[1]),
    ]  # fmt: skip


def released(model, known, period=None):
    """The orbit that swings from rest at some coordinates."""
    state = of.linkages.mechanism_state(model, known)
    guess = of.Guess(state, period or of.linkages.first_return(model, state))
    return of.find_orbit(of.Problem(model, guess, of.pin(energy=of.energy(model, state))))


@pytest.mark.parametrize("angle", [-0.5, 0.9, 1.0])
def test_four_bar_is_the_quadrature_of_its_crank_angle(angle):
    """0.9 and 1.0 are where IDAS once halved its step until nothing was left."""
    orbit = released(four_bar(), {"A": angle})
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period == pytest.approx(quadrature(four_bar_parts, angle), rel=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("angle", np.linspace(-0.8, 1.3, 12))
def test_four_bar_over_its_whole_range(angle):
    assert released(four_bar(), {"A": angle}).period == pytest.approx(quadrature(four_bar_parts, angle), rel=1e-11)


def slider_crank_parts(crank):
    pin = 0.05 * np.array([np.cos(crank), np.sin(crank)])
    tilt = np.arcsin((0.01 - pin[1]) / 0.16)
    com = np.array([0.02 * np.cos(crank) - 0.004 * np.sin(crank), 0.02 * np.sin(crank) + 0.004 * np.cos(crank)])
    rod = pin + 0.08 * np.array([np.cos(tilt), np.sin(tilt)])
    return [
        (0.2, 8e-5, *com, crank),
        (0.15, 3e-4, *rod, tilt),
        (0.3, 0.0, pin[0] + 0.16 * np.cos(tilt), 0.01, 0.0 * crank),
    ]


def spring_energy(u):
    return 250.0 * (0.3 - slider_crank_parts(u)[2][2].real - 0.1) ** 2


def quick_return_parts(crank):
    pin = np.array([0.1 + 0.04 * np.cos(crank), 0.04 * np.sin(crank)])
    lever = np.arctan(pin[1] / pin[0])
    return [
        (*steel(0.04), 0.1 + 0.02 * np.cos(crank), 0.02 * np.sin(crank), crank),
        (*steel(0.2), 0.1 * np.cos(lever), 0.1 * np.sin(lever), lever),
    ]


def test_slider_crank_and_quick_return_are_quadratures():
    """A slide, a slot, an offset, a spring; the rest of the gallery's planar mechanisms against their minimal form."""
    model = load_problem(GALLERY / "slider-crank-spring.toml").model
    orbit = released(model, {"A": 0.5})
    assert orbit.certificate.passed
    wanted = quadrature(slider_crank_parts, 0.5, lambda u: spring_energy(u))
    assert orbit.period == pytest.approx(wanted, rel=1e-11)
    quick = released(load_problem(GALLERY / "quick-return.toml").model, {"crank_pin": 0.5})
    assert quick.period == pytest.approx(quadrature(quick_return_parts, 0.5), rel=1e-11)


def both_forms(problem):
    """The orbit of the native DAE, and that of the minimal form through the same state."""
    native = of.find_orbit(problem)
    begin = of.Guess(native.state, native.period)
    pins = of.pin(energy=native.energy) if problem.model.conservative else ()
    small = minimal_problem(of.Problem(problem.model, begin, pins))
    return native, of.find_orbit(small)


def agree(native, small):
    assert native.certificate.passed and small.certificate.passed
    assert small.period == pytest.approx(native.period, rel=1e-11)
    assert small.floquet_multipliers.size == native.floquet_multipliers.size
    assert np.abs(np.sort_complex(small.floquet_multipliers) - np.sort_complex(native.floquet_multipliers)).max(
        initial=0.0
    ) < 1e-7  # fmt: skip
    away = wrapped(native_state(small.system, small.state) - native.state, build_model(native.system).angles)
    assert np.abs(away).max() < 1e-9 * max(1.0, np.abs(native.state).max())


def test_driven_and_damped_mechanism_agrees_with_its_minimal_form():
    """Once refused: what a motor puts in and a bearing takes out, under constraints."""
    native, small = both_forms(load_problem(GALLERY / "driven-slider-crank.toml"))
    agree(native, small)
    assert native.stability == "asymptotically stable" and np.isnan(native.unfolding).sum() == 0


PLANAR = [
    "five-bar-robot", "four-bar-crank-rocker", "slider-crank-spring", "quick-return", "scotch-yoke", "peaucellier",
    "watt-six-bar", "stephenson-six-bar",
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANAR)
def test_both_forms_of_every_planar_mechanism_agree(name):
    agree(*both_forms(load_problem(GALLERY / f"{name}.toml")))


def test_peaucellier_draws_a_straight_line():
    problem = load_problem(GALLERY / "peaucellier.toml")
    model = problem.model
    for angle in (-0.4, 0.0, 0.5):
        state = of.linkages.mechanism_state(model, {"crank": angle})
        tip = of.positions(model, state[None])[0, :, -1]
        assert tip[0] == pytest.approx((0.2**2 - 0.08**2) / (2 * 0.07), rel=1e-12)  # (L^2 - l^2) / (2 r)


def elliptic(a, b, lowest, low, high):
    """Period of u'^2 = b (u - lowest)(u - low)(high - u) between low and high."""
    return 4 * ellipk((high - low) / (high - lowest)) / np.sqrt(b * (high - lowest)) * a


def test_spherical_pendulum_and_gyroscope_are_elliptic_integrals():
    """Goldstein, Classical Mechanics, section 5.7, cosine of the tilt from straight down."""
    orbit = of.find_orbit(load_problem(GALLERY / "spherical-pendulum.toml"))
    _, tilt, turning, rate = orbit.state
    momentum = np.sin(tilt) ** 2 * turning
    level = 0.5 * (rate**2 + momentum * turning) - G * np.cos(tilt)
    roots = np.sort(np.roots([-2 * G, -2 * level, 2 * G, 2 * level - momentum**2]).real)
    assert orbit.certificate.passed
    assert orbit.period == pytest.approx(elliptic(1, 2 * G, *roots), rel=1e-11)
    top = of.find_orbit(load_problem(GALLERY / "gyroscope.toml"))
    _, tilt, _, turning, rate, spin = top.state
    across, along, pull = 4.6e-4 + 0.5 * 0.08**2, 9e-4, 0.5 * G * 0.08
    spun = along * (spin + turning * np.cos(tilt))
    b = (across * np.sin(tilt) ** 2 * turning + spun * np.cos(tilt)) / across
    a, beta = spun / across, 2 * pull / across
    alpha = rate**2 + np.sin(tilt) ** 2 * turning**2 - beta * np.cos(tilt)
    roots = np.sort(np.roots([-beta, -alpha - a**2, beta + 2 * a * b, alpha - b**2]).real)
    assert top.certificate.passed
    assert top.period == pytest.approx(elliptic(1, beta, *roots), rel=1e-11)


def test_furuta_pendulum_is_a_quadrature():
    """Routh's function in the arm's momentum, written out by hand."""
    orbit = of.find_orbit(load_problem(GALLERY / "furuta.toml"))
    m, r, lp, ix, iy, iz = 0.024, 0.085, 0.0645, 1e-7, 3.33e-5, 3.33e-5
    arm = 5.72e-5 + 0.095 * 0.0425**2

    def turned(u):
        return arm + m * (r**2 + (lp * np.sin(u)) ** 2) + ix * np.cos(u) ** 2 + iz * np.sin(u) ** 2

    _, u, w, v = orbit.state
    momentum = turned(u) * w - m * r * lp * np.cos(u) * v
    energy = orbit.energy

    def left(x):
        return energy - momentum**2 / (2 * turned(x)) + m * G * lp * np.cos(x)

    ends = []
    for way in (-1, 1):
        steps = u + way * np.linspace(1e-9, 3.0, 600)
        k = next(k for k, x in enumerate(steps) if left(x) < -1e-12)
        ends.append(brentq(left, steps[k - 1], steps[k], xtol=1e-16, rtol=1e-15))
    middle, half = sum(ends) / 2, (ends[1] - ends[0]) / 2
    phi = (np.arange(200) + 0.5) * np.pi / 200 - np.pi / 2
    x = middle + half * np.sin(phi)
    inertia = m * lp**2 + iy - (m * r * lp * np.cos(x)) ** 2 / turned(x)
    wanted = 2 * np.sum(half * np.cos(phi) * np.sqrt(inertia / (2 * left(x)))) * np.pi / 200
    assert orbit.certificate.passed
    assert orbit.period == pytest.approx(wanted, rel=1e-11)


def chain(count, dimension=3, axes=((0, 0, 1), (0, 1, 0)), **more):
    """A tree that is a chain of bars of 1 m, turning about the axes by turns."""
    zero, far = [0.0] * dimension, [1.0] + [0.0] * (dimension - 1)
    bodies = {
        f"b{k}": {"mass": 1.0 + 0.1 * k, "inertia": [0.01, 0.08, 0.09] if dimension == 3 else 0.08,
                  "com": [0.5, *zero[1:]]} for k in range(count)
    }  # fmt: skip
    joints = {}
    for k in range(count):
        before = f"b{k - 1}" if k else "ground"
        joints[f"j{k}"] = {"kind": "revolute", "between": [before, f"b{k}"], "at": [far if k else zero, zero]}
        if dimension == 3:
            joints[f"j{k}"]["axis"] = list(axes[k % len(axes)])
    return of.mechanism(bodies, joints, dimension=dimension, **more)


def equations(model, place, rate):
    """Mass matrix and bias from the energies alone."""
    n = model.degrees_of_freedom
    q, v, p = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.DM(model.parameter_values)
    found = mass_matrix_and_bias(model.kinetic(q, v, p), model.potential(q, p), q, v)
    matrix, bias = ca.Function("equations", [q, v], list(found))(place, rate)
    return matrix.full(), bias.full().ravel()


def test_recursion_is_lagrange_and_a_chain():
    random = np.random.default_rng(1)
    for model in (chain(5), load_problem(GALLERY / "double-ball-pendulum.toml").model):
        place, rate = random.normal(size=(2, model.degrees_of_freedom))
        matrix, bias = equations(model, place, rate)
        found = model.acceleration(0, place, rate, model.parameter_values).full().ravel()
        assert np.abs(found + np.linalg.solve(matrix, bias)).max() < 1e-11 * np.abs(found).max()
    flat, known = chain(3, 2), of.chain(3, mass=[1.0, 1.1, 1.2], inertia=0.08)
    place, rate = random.normal(size=(2, 3))
    found = flat.acceleration(0, place, rate, flat.parameter_values).full().ravel()
    wanted = known.acceleration(0, np.cumsum(place), np.cumsum(rate), known.parameter_values).full().ravel()
    assert np.cumsum(found) == pytest.approx(wanted, rel=1e-12)


def test_a_tree_costs_what_its_bodies_cost():
    small, large = (chain(count).acceleration.n_instructions() for count in (30, 60))
    assert np.log2(large / small) < 1.1


def test_joints_may_be_told_from_either_body():
    there = {"b": {"mass": 1.0, "inertia": [0.1, 0.2, 0.3], "com": [0.1, 0.2, 0.3]}}
    joint = {"kind": "spherical", "at": [[0.1, 0, 0], [0, 0.2, 0]], "turned": [0.3, -0.2, 0.5]}
    forth = of.mechanism(there, {"s": {**joint, "between": ["ground", "b"]}}, dimension=3)
    back = of.mechanism(there, {"s": {**joint, "between": ["b", "ground"], "at": joint["at"][::-1]}}, dimension=3)
    angles = np.array([0.2, 0.5, -0.4])

    def turn(axis, angle):
        k = np.cross(np.eye(3), np.eye(3)[axis])
        return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k

    roll, pitch, yaw = joint["turned"]
    turned = turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
    whole = turn(0, angles[0]) @ turn(1, angles[1]) @ turn(2, angles[2])
    height = 0.1 + (whole @ turned @ (np.array([0.1, 0.2, 0.3]) - [0, 0.2, 0]))[0]
    assert float(forth.potential(angles, forth.parameter_values)) == pytest.approx(-9.8 * height, rel=1e-13)
    height = ((whole @ turned).T @ (np.array([0.1, 0.2, 0.3]) - [0, 0.2, 0]) + [0.1, 0, 0])[0]
    assert float(back.potential(angles, back.parameter_values)) == pytest.approx(-9.8 * height, rel=1e-13)


BRICK = {"mass": 2.0, "inertia": [0.3, 0.4, 0.5, 0.02, -0.03, 0.01], "com": [0.2, 0.1, -0.15]}
CLOSED = [
    ({"kind": "revolute", "axis": [0, 0, 1]}, [5], 3),
    ({"kind": "prismatic", "axis": [1, 0, 0]}, [0], 3),
    ({"kind": "cylindrical", "axis": [0, 1, 0]}, [1, 4], 3),
    ({"kind": "universal"}, [3, 4], 3),
    ({"kind": "spherical"}, [3, 4, 5], 3),
    ({"kind": "revolute"}, [2], 2),
    ({"kind": "prismatic", "axis": [1, 0]}, [0], 2),
    ({"kind": "slot", "axis": [0, 1]}, [1, 2], 2),
]


@pytest.mark.parametrize(
    ("joint", "free", "dimension"), CLOSED, ids=lambda one: one.get("kind") if isinstance(one, dict) else ""
)
def test_a_joint_that_closes_a_loop_is_the_joint(joint, free, dimension):
    """A body on a joint, and the same body free in space and held by the joint: the same accelerations and freedoms."""
    brick = BRICK if dimension == 3 else {"mass": 2.0, "inertia": 0.5, "com": [0.2, 0.1]}
    fall = [9.0, 2.0, -3.0][:dimension]
    alone = of.mechanism({"b": brick}, {"j": {**joint, "between": ["ground", "b"]}}, dimension=dimension, gravity=fall)
    float_ = {"kind": "free", "between": ["ground", "b"]}
    held = of.mechanism(
        {"b": brick}, {"f": float_, "j": {**joint, "between": ["ground", "b"]}}, dimension=dimension, gravity=fall
    )
    n, count = held.degrees_of_freedom, len(free)
    assert n - len(held.constraint.force_names) == count == alone.degrees_of_freedom
    place, rate = np.zeros(count), np.array([1.1, -0.7, 0.4])[:count]
    whole = np.zeros(n)
    whole[free] = rate
    wanted = np.zeros(n)
    wanted[free] = alone.acceleration(0, place, rate, alone.parameter_values).full().ravel()
    assert np.abs(held.constraint.rate(np.zeros(n), whole, held.parameter_values).full()).max() < 1e-14
    found = held.acceleration(0, np.zeros(n), whole, held.parameter_values).full().ravel()
    assert found == pytest.approx(wanted, abs=1e-12 * np.abs(wanted).max())


def test_a_four_bar_in_space_is_the_one_in_the_plane():
    """Five equations of a pin in space, of which three repeat that all turns in one plane."""
    flat, bodies, joints = four_bar(), {}, {}
    for name, one in flat.system["bodies"].items():
        bodies[name] = {**one, "inertia": [0.01, 0.01, one["inertia"]], "com": [*one["com"], 0.0]}
    for name, one in flat.system["joints"].items():
        joints[name] = {**one, "at": [[*at, 0.0] for at in one["at"]], "axis": [0.0, 0.0, 1.0]}
    given = {"dimension": 3, "gravity": [G, 0, 0], "pose": {"A": 0.5}}
    with pytest.raises(InputError, match="over-constrained.*joint 'C' between 'coupler' and 'rocker'"):
        of.mechanism(bodies, joints, **given)
    model = of.mechanism(bodies, joints, redundant="drop", **given)
    state = of.linkages.mechanism_state(model, {"A": 0.8}, {"Adot": 2.0})
    assert state == pytest.approx(of.linkages.mechanism_state(flat, {"A": 0.8}, {"Adot": 2.0}), abs=1e-13)
    found, wanted = (one.acceleration(0, state[:3], state[3:], one.parameter_values).full() for one in (model, flat))
    assert np.abs(found - wanted).max() < 1e-10 * np.abs(wanted).max()


def test_a_rod_in_space_between_cranks_about_different_axes():
    """RSSR: the native DAE and the minimal form are one motion."""
    crank = {"mass": 0.1, "inertia": [1e-5, 1e-4, 1e-4], "com": [0.05, 0.0, 0.0]}
    model = of.mechanism(
        {"crank": crank, "rocker": {**crank, "mass": 0.3}},
        {"a": {"kind": "revolute", "between": ["ground", "crank"], "axis": [0, 0, 1]},
         "b": {"kind": "revolute", "between": ["ground", "rocker"], "at": [[0, 0.2, 0.1], [0] * 3], "axis": [0, 1, 1]},
         "rod": {"kind": "rod", "between": ["crank", "rocker"], "at": [[0.1, 0, 0], [0.15, 0, 0]], "length": 0.23}},
        dimension=3, gravity=[G, 0, 0], pose={"a": 0.1, "b": 0.1},
    )  # fmt: skip
    native = released(model, {"a": 0.3})
    assert native.certificate.passed, native.certificate.failures
    small = of.linkages.minimal_mechanism(model, ["a"], native.state[:2])
    begin = of.Guess(native.state[[0, 2]], native.period)
    same = of.find_orbit(of.Problem(small, begin, of.pin(energy=native.energy)))
    assert same.period == pytest.approx(native.period, rel=1e-11)


@pytest.mark.slow
def test_a_turning_crank_winds_in_both_forms():
    model = four_bar()
    state = of.linkages.mechanism_state(model, {"A": 0.0}, {"Adot": 40.0})
    problem = of.Problem(
        model, of.Guess(state, of.linkages.first_return(model, state)), of.pin(energy=of.energy(model, state))
    )
    native, small = both_forms(problem)
    assert native.winding == (1, 0, -1) and small.winding == (1,)
    agree(native, small)


def test_the_dead_point_of_a_family_is_named():
    model = load_problem(GALLERY / "slider-crank-spring.toml").model
    small = of.linkages.minimal_mechanism(model, ["S"], of.linkages.mechanism_state(model, {"A": 0.8})[:3])
    far = np.sqrt(0.21**2 - 0.01**2)
    assert dead_point(small, np.array([[0.19, 0.0], [0.195, 0.0]])) == ""
    said = dead_point(small, np.array([[0.19, 0.0], [far - 1e-9, 0.0]]))
    assert said == "joint 'C' between 'rod' and 'piston' no longer says how A, B follow from S (a dead point)"


def test_a_prescribed_joint_moves_as_told():
    """The motion that a force would have to make, found on the whole chain; certificate and search take the forces."""
    whole = chain(3)
    told = chain(3, motions={"drive": {"joint": "j1", "offset": 0.2, "amplitude": 0.3, "phase": 0.1}}, frequency=2.0)
    t, place, rate = 0.7, np.array([0.4, -0.3]), np.array([1.0, -2.0])
    late = 2.0 * t + 0.1
    drive, speed, push = 0.2 + 0.3 * np.cos(late), -0.6 * np.sin(late), -1.2 * np.cos(late)
    matrix, bias = equations(whole, [place[0], drive, place[1]], [rate[0], speed, rate[1]])
    free = [0, 2]
    wanted = np.linalg.solve(matrix[np.ix_(free, free)], -bias[free] - matrix[free, 1] * push)
    found = told.acceleration(t, place, rate, told.parameter_values).full().ravel()
    assert found == pytest.approx(wanted, rel=1e-12)
    steady, rest = equations(told, place, rate)
    forces = told.forces(t, place, rate, told.parameter_values).full().ravel()
    assert steady @ found + rest == pytest.approx(forces, rel=1e-10)
    assert float(told.forcing_period(told.parameter_values)) == pytest.approx(np.pi)


def test_motors_are_controls_and_parameters_are_names():
    model = load_problem(GALLERY / "five-bar-robot.toml").model
    assert model.controls == ("left_motor", "right_motor") and model.limits["left_motor"] == (-0.5, 0.5)
    assert model.conservative and model.actuation is not None
    longer = with_parameters(model, {"left_elbow_1_x": 0.13, "left_spring_stiffness": 0.7})
    state = of.linkages.mechanism_state(longer)
    assert np.abs(longer.constraint.phi(state[:4], longer.parameter_values).full()).max() < 1e-13
    again = build_model(json.loads(json.dumps(longer.system)))
    assert np.array_equal(again.parameter_values, longer.parameter_values)
    shared = of.mechanism(
        {"b": {"mass": 1.0, "inertia": "mass_of_b", "com": ["-length / 2", 0.0]}}, {"j": revolute("ground", "b")},
        parameters={"length": 2.0, "mass_of_b": 0.3},
    )  # fmt: skip
    assert shared.parameter_names[:2] == ("length", "mass_of_b") and "b_com_x" not in shared.parameter_names
    assert float(shared.potential([0.0], shared.parameter_values)) == pytest.approx(9.8)


def test_springs_dampers_and_motors_push_as_they_should():
    """A point on a rod at 1 m: spring, damper, torsion spring and motor against the sum of moments."""
    rod = {"rod": {"mass": 2.0, "inertia": 0.1, "com": [0.5, 0.0]}}
    model = of.mechanism(
        rod, {"j": revolute("ground", "rod")},
        springs={"k": {"between": ["ground", "rod"], "at": [[0, 2], [1, 0]], "stiffness": 30.0, "length": 0.5},
                 "w": {"joint": "j", "stiffness": 4.0, "rest": 0.2}},
        dampers={"c": {"between": ["ground", "rod"], "at": [[0, 2], [1, 0]], "damping": 3.0},
                 "b": {"joint": "j", "damping": 0.7}},
        motors={"m": {"joint": "j", "torque": 1.5}},
    )  # fmt: skip
    angle, rate = 0.6, 1.3
    tip, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    gap = tip - [0, 2]
    length = np.hypot(*gap)
    pull = -30.0 * (length - 0.5) - 3.0 * (gap @ along) * rate / length
    moment = -2 * 9.8 * 0.5 * np.sin(angle) + pull * (gap @ along) / length - 4.0 * (angle - 0.2) - 0.7 * rate + 1.5
    found = float(model.acceleration(0, [angle], [rate], model.parameter_values))
    assert found == pytest.approx(moment / (0.1 + 2 * 0.25), rel=1e-13)
    assert not model.conservative


def test_points_of_bodies_are_contacts_of_impacts():
    """The end of a double pendulum against a wall: the impact of the mechanism is that of the chain."""
    flat, known = chain(2, 2), of.chain(2, mass=[1.0, 1.1], inertia=0.08)
    tip = of.linkages.body_point(flat, "b1", [1.0, 0.0])
    mine = of.impact(flat, lambda x, p: [0.7 - tip(x, p)[1]], 0.5)
    theirs = of.impact(known, lambda x, p: [0.7 - ca.sin(x.theta1) - ca.sin(x.theta2)], 0.5)
    turns, rates = np.array([0.3, 0.4]), np.array([1.0, -0.4])
    place, rate = np.cumsum(turns), np.cumsum(rates)
    after = mine.after([*turns, *rates], flat.parameter_values)
    wanted = theirs.after([*place, *rate], known.parameter_values)
    after, wanted = (np.array(ca.DM(one)).ravel() for one in (after, wanted))
    assert np.cumsum(after[2:]) == pytest.approx(wanted[2:], rel=1e-12)
    with pytest.raises(InputError, match="body: unknown 'b2', did you mean"):
        of.linkages.body_point(flat, "b2", [0.0, 0.0])
    with pytest.raises(InputError, match="without loops"):
        of.linkages.body_point(four_bar(), "crank", [0.0, 0.0])


def test_redundant_rows_are_named_and_may_be_dropped():
    """A parallelogram with a third crank moves, though Kutzbach's count says that it does not."""

    def crank(at):
        return revolute("ground", f"c{at}", (0, at))

    bodies = {f"c{k}": bar(0.1) for k in range(3)} | {"beam": {"mass": 1.0, "inertia": 0.01, "com": [0.0, 1.0]}}
    joints = {f"g{k}": crank(k) for k in range(3)}
    joints |= {f"p{k}": revolute(f"c{k}", "beam", (0.1, 0), (0, k)) for k in range(3)}
    with pytest.raises(InputError, match="over-constrained.*4 equations.*leave 0 degrees of freedom"):
        of.mechanism(bodies, joints)
    model = of.mechanism(bodies, joints, redundant="drop", pose={"g0": 0.3, "g1": 0.3, "g2": 0.3, "p0": -0.3})
    assert model.degrees_of_freedom - len(model.constraint.force_names) == 1
    orbit = released(model, {"g0": 0.3})
    mass, inertia = steel(0.1)
    moved, pulled = 3 * (inertia + mass * 0.05**2) + 0.1**2, 9.8 * (3 * mass * 0.05 + 0.1)
    wanted = 4 * ellipk(np.sin(0.15) ** 2) / np.sqrt(pulled / moved)
    assert orbit.certificate.passed and orbit.period == pytest.approx(wanted, rel=1e-11)


@pytest.mark.slow
def test_a_spherical_linkage_may_be_drawn_with_all_joints_where_its_axes_meet():
    """A hinge may lie anywhere on its axis: drawn at the common point it is the same linkage, in the same motion."""
    ways = {"a": [0.0, 0.0, 1.0], "b": [0.54, 0.17, 0.825], "c": [0.32, 0.83, 0.454], "d": [0.91, 0.19, 0.36]}
    pairs = {"a": ("ground", "crank"), "b": ("crank", "rod"), "c": ("rod", "rocker"), "d": ("rocker", "ground")}
    coms = {"crank": (0.2, 0.05, 0.5), "rod": (0.3, 0.4, 0.4), "rocker": (0.4, 0.3, 0.2)}
    bodies = {name: {"mass": 1.0, "inertia": [0.02, 0.02, 0.02], "com": list(com)} for name, com in coms.items()}
    found = []
    for away in (0.0, 0.3):
        joints = {name: {"kind": "revolute", "between": list(pairs[name]), "axis": way,
                         "at": [[away * one for one in way]] * 2} for name, way in ways.items()}  # fmt: skip
        model = of.mechanism(bodies, joints, gravity=[9.8, 0, 0], dimension=3, redundant="drop")
        assert model.degrees_of_freedom - len(model.constraint.force_names) == 1
        state = of.linkages.mechanism_state(model, {"a": 0.3}, {"adot": 1.2})
        found.append(
            np.concatenate([state, model.acceleration(0, *np.split(state, 2), model.parameter_values).full()[:, 0]])
        )
    assert found[0] == pytest.approx(found[1], rel=1e-10, abs=1e-10)
    orbit = released(of.mechanism(bodies, joints, gravity=[9.8, 0, 0], dimension=3, redundant="drop"), {"a": 0.3})
    assert orbit.certificate.passed


ROD = {"mass": 1.0, "inertia": 0.1, "com": [0.5, 0.0]}
ONE = {"j": revolute("ground", "a")}
BAD = [
    ({"a": {**ROD, "mass": 0.0}}, {"j": revolute("ground", "a")}, {}, "bodies.a.mass: must be positive, got 0.0"),
    ({"a": {"mass": 1.0}}, {"j": revolute("ground", "a")}, {}, "joints.j: coordinate j moves no mass: body 'a'"),
    ({"a": ROD, "b": ROD}, {"j": revolute("ground", "a")}, {}, "bodies.b: hangs in the air.*its joints: none"),
    (
        {"a": ROD, "b": ROD, "c": ROD},
        {"j": revolute("ground", "a"), "k": revolute("ground", "b", (0, 9)), "l": revolute("a", "c", (1, 0)),
         "m": revolute("c", "b", (1, 0), (1, 0))}, {}, "stays open at joint 'm' between 'c' and 'b': .* m are left",
    ),
    (
        {"a": ROD}, {"j": revolute("ground", "a"), "k": revolute("ground", "a", (1, 0), (1, 0))}, {},
        "over-constrained.*take away joint 'k' between 'ground' and 'a'",
    ),
    (
        {"a": ROD, "b": ROD}, {**ONE, "k": revolute("a", "b"), "l": revolute("ground", "b", (0, 1))}, {},
        "joints.k: at the same point of body 'a' as joint 'j'.*a bar of no length",
    ),
    (
        {"a": ROD, "b": ROD, "c": ROD},
        {"j": revolute("ground", "a"), "k": revolute("ground", "c", (2, 0)), "l": revolute("a", "b", (1, 0)),
         "m": revolute("b", "c", (2, 0), (1, 0))}, {}, "pose: singular at .*joint 'm' between 'b' and 'c'.*dead point",
    ),
    (
        {name: {"mass": 1.0, "inertia": [1.0, 1.0, 1.0], "com": [0.1, 0.0, 0.0]} for name in "ab"},
        {name: {"kind": "revolute", "between": pair, "axis": [0, 0, sign]} for name, pair, sign in
         (("j", ["ground", "a"], 1), ("k", ["a", "b"], -2), ("l", ["b", "ground"], 1))}, {"dimension": 3},
        "joints.k: at the same point of body 'a' as joint 'j'.*a bar of no length",
    ),
    ({"a": ROD}, {"j": {"kind": "revolut", "between": ["ground", "a"]}}, {}, "joints.j.kind: unknown 'revolut', did"),
    ({"a": ROD}, {"j": {"kind": "prismatic", "between": ["ground", "a"]}}, {}, "joints.j.axis: must be a finite"),
    ({"a": ROD}, {"j": {"kind": "revolute", "between": ["ground", "x"]}}, {}, "joints.j.between: unknown body 'x'"),
    ({"a": {**ROD, "com": ["0.5*l", 0.0]}}, {"j": revolute("ground", "a")}, {}, "bodies.a.com: '0.5.l' is not"),
    ({"a": {**ROD, "heft": 1.0}}, {"j": revolute("ground", "a")}, {}, "bodies.a.heft: unknown key"),
    ({"a": ROD}, ONE, {"motors": {"m": {"joint": "j", "amplitude": 1.0}}}, "frequency: missing"),
    ({"a": ROD}, ONE, {"motors": {"m": {"joint": "x"}}}, "motors.m.joint: 'x' is no coordinate"),
    ({"a": ROD}, ONE, {"springs": {"k": {"joint": "j", "stiffness": -1.0}}},
     "springs.k.stiffness: must be positive"),
    ({"a": ROD}, ONE, {"gravity": [1.0]}, "gravity: 1 number; give 2"),
    ({"a": ROD}, ONE, {"values": {"a_mas": 1.0}}, "unknown physical parameter 'a_mas', did"),
    ({"a": {"mass": 1.0, "inertia": [1.0, 1.0, 3.0], "com": [0.0] * 3}}, {"j": {"kind": "spherical", "between":
      ["ground", "a"]}}, {"dimension": 3}, "bodies.a.inertia: no body has these principal moments"),
    ({"a": {"mass": 1.0, "inertia": [1.0, 1.0, 1.0], "com": [0.0] * 3}}, {"j": {"kind": "spherical", "axes": "zxz",
      "between": ["ground", "a"]}}, {"dimension": 3}, "joints.j: coordinate j. moves no mass: two of its axes are one"),
]  # fmt: skip


@pytest.mark.parametrize(("bodies", "joints", "more", "said"), BAD, ids=lambda one: one if isinstance(one, str) else "")
def test_bad_drawings_get_a_sentence(bodies, joints, more, said):
    with pytest.raises(InputError, match=said):
        of.mechanism(bodies, joints, **more)


def test_dead_points_and_wrong_requests_are_named():
    model = load_problem(GALLERY / "slider-crank-spring.toml").model
    with pytest.raises(InputError, match="rates: dead point, here S cannot say how A, B move"):
        dead = np.arcsin(0.01 / 0.21)
        there = of.linkages.mechanism_state(model, near=np.array([dead, 0.2, 0.0]))[:3]
        of.linkages.mechanism_state(model, rates={"Sdot": 0.1}, near=there)
    with pytest.raises(
        InputError, match="independent: dead point of S at the pose: joint 'C' between 'rod' and 'piston'"
    ):
        of.linkages.minimal_mechanism(model, ["S"], there)
    with pytest.raises(InputError, match="a: unknown coordinate; this mechanism has A, S, B"):
        of.linkages.mechanism_state(model, {"a": 0.1})
    with pytest.raises(InputError, match="2 given, this mechanism has 1 degree of freedom"):
        of.linkages.mechanism_state(model, {"A": 0.1, "B": 0.1})
    with pytest.raises(InputError, match="need 1 different coordinates of A, S, B"):
        of.linkages.minimal_mechanism(model, ["A", "S"])


def test_constrained_systems_that_are_driven_are_certified():
    """A bead on a hoop under a force that varies, in Cartesian coordinates and in its angle."""
    q, v, t = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("t")
    push, clock = ca.cos(2 * np.pi * t), {"time": t, "forcing_period": 1.0}
    native = of.constrained(
        ca.sumsqr(v) / 2, -G * q[0], ca.sumsqr(q) - 1, of.Symbols(q, v, **clock), forces=ca.vertcat(0, push) - 0.3 * v,
        baumgarte=of.Baumgarte(10, 10),
    )  # fmt: skip
    u, w = ca.SX.sym("u"), ca.SX.sym("w")
    angle = of.lagrange(
        w**2 / 2, -G * ca.cos(u), of.Symbols(u, w, **clock), forces=push * ca.cos(u) - 0.3 * w, angles=[True]
    )
    found = of.find_orbit(of.Problem(native, of.Guess([np.cos(0.03), -np.sin(0.03), 0.0, 0.0], 1.0)))
    wanted = of.find_orbit(of.Problem(angle, of.Guess([-0.03, 0.0], 1.0)))
    assert found.certificate.passed and wanted.certificate.passed
    there, rate = wanted.state
    place = np.array([np.cos(there), np.sin(there)])
    assert found.state == pytest.approx([*place, -rate * place[1], rate * place[0]], abs=1e-11)
    assert np.sort_complex(found.floquet_multipliers) == pytest.approx(
        np.sort_complex(wanted.floquet_multipliers), abs=1e-9
    )


@pytest.mark.slow
def test_a_mechanism_goes_all_the_way_from_its_file(tmp_path):
    """Run, verified from the file alone, drawn, exported, followed with a fold, on a page."""
    runner = CliRunner()

    def done(*words):
        made = runner.invoke(cli, [str(word) for word in words])
        assert made.exit_code == 0, made.output
        return made.output

    done("run", GALLERY / "slider-crank-spring.toml", "-o", tmp_path)
    orbit = tmp_path / "slider-crank-spring" / "orbit.json"
    assert json.loads(orbit.read_text())["system"]["kind"] == "mechanism"
    done("verify", orbit)
    tampered = json.loads(orbit.read_text())
    tampered["system"]["springs"]["k"]["stiffness"] = 501.0
    (tmp_path / "tampered.json").write_text(json.dumps(tampered))
    assert runner.invoke(cli, ["verify", str(tmp_path / "tampered.json")]).exit_code == 1
    done("animate", orbit, "-o", tmp_path / "a.gif")
    done("export", orbit, "--to", "c", "-o", tmp_path)
    done("continue", orbit, "--parameter", "energy", "--points", "3", "-o", tmp_path)
    done("continue", orbit, "--parameter", "C_1_x", "--points", "3", "-o", tmp_path / "length")
    done("page", tmp_path / "slider-crank-spring", "-o", tmp_path / "site")
    assert "strokes" in "".join(path.read_text() for path in (tmp_path / "site" / "data").rglob("*.js"))


def test_a_drawing_in_millimetres_returns_when_the_one_in_metres_does():
    """A slide in mm does not drown the angles when the first return is looked for."""
    lengths = {"crank": 0.05, "rod": 0.15, "bore": 0.012, "com": 0.07}
    found = []
    for unit in (1.0, 1000.0):
        crank, rod, bore, com = (unit * one for one in lengths.values())
        model = of.mechanism(
            {"crank": {"mass": 0.4, "inertia": 2e-4 * unit**2, "com": [crank / 2, 0.0]},
             "rod": {"mass": 0.3, "inertia": 6e-4 * unit**2, "com": [com, 0.0]}, "piston": {"mass": 0.5}},
            {"main": {"kind": "revolute", "between": ["ground", "crank"]},
             "big": {"kind": "revolute", "between": ["crank", "rod"], "at": [[crank, 0.0], [0.0, 0.0]]},
             "small": {"kind": "revolute", "between": ["rod", "piston"], "at": [[rod, 0.0], [0.0, 0.0]]},
             "slide": {"kind": "prismatic", "between": ["ground", "piston"], "at": [[0.0, bore], [0.0, 0.0]],
                       "axis": [1.0, 0.0]}},
            gravity=[9.81 * unit, 0.0], pose={"main": 0.3},
        )  # fmt: skip
        state = of.linkages.mechanism_state(model, {"main": 2.9}, rates={"maindot": 0.0})
        found.append(of.linkages.first_return(model, state))
    assert found[1] == pytest.approx(found[0], rel=1e-2) and found[0] > 0.7  # half of it is another pose


OPEN = """
[system]
kind = "mechanism"
gravity = [{gravity}, 0.0]
bodies = {{ {body} }}
joints = {{ {joint} }}
{more}
[guess]
angles = {{ a = {start} }}
"""


@pytest.mark.parametrize(
    ("parts", "period"),
    [  # T = 4 K(sin^2 15 deg) sqrt(J / m g c) swinging, 2 pi sqrt(m / k) on a slow and minute spring
        (
            {"body": "b = { mass = 2.0, inertia = 0.5, com = [0.5, 0.0] }", "start": np.pi / 6, "gravity": G,
             "joint": "a = { kind = 'revolute', between = ['ground', 'b'] }", "more": ""},
            4 * ellipk(np.sin(np.pi / 12) ** 2) * np.sqrt(1.0 / (2.0 * G * 0.5)),
        ),
        (
            {"joint": "a = { kind = 'prismatic', between = ['ground', 'b'], axis = [0, 1] }",
             "body": "b = { mass = 2e-3 }", "gravity": G, "start": 1e-3,
             "more": "springs = { s = { joint = 'a', stiffness = 3e-8 } }"},
            2 * np.pi * np.sqrt(2e-3 / 3e-8),
        ),
    ],
)  # fmt: skip
def test_without_loops_the_period_of_angles_is_that_of_the_first_return_too(parts, period, tmp_path):
    (tmp_path / "open.toml").write_text(OPEN.format(**parts))
    assert load_problem(tmp_path / "open.toml").guess.period == pytest.approx(period, rel=0.05)
    (tmp_path / "loose.toml").write_text(OPEN.format(**{**parts, "gravity": 0.0, "more": ""}))
    with pytest.raises(InputError, match=r"guess.period: missing, and nothing holds this mechanism near a pose; give"):
        load_problem(tmp_path / "loose.toml")


def test_a_body_is_drawn_as_far_as_its_spring():
    drawing = {"b": {"mass": 1.0, "inertia": 0.1, "com": [0.2, 0.05]}}
    spring = {"s": {"between": ["ground", "b"], "at": [[0.1, 0.6], [0.4, 0.0]], "stiffness": 30.0}}
    model = of.mechanism(drawing, {"a": revolute("ground", "b")}, springs=spring)
    places = of.positions(model, np.zeros((1, 2)))[0].T
    (pulled,) = (places[list(which)[1]] for kind, which in model.strokes if kind == "spring")
    (body,) = (places[list(which)] for kind, which in model.strokes if kind == "rod")
    assert list(pulled) == [0.4, 0.0] and [0.4, 0.0] in body.tolist()


def test_the_last_body_is_drawn_to_its_end():
    """Where a uniform rod ends, not at its centre of mass; no farther than on this side of that."""
    for inertia, end in ((1 / 12, 1.0), (0.1**2 / 3, 0.6), (1e3, 1.0)):
        drawing = {"b": {"mass": 1.0, "inertia": inertia, "com": [0.5, 0.0]}}
        model = of.mechanism(drawing, {"a": revolute("ground", "b")})
        places = of.positions(model, np.zeros((1, 2)))[0].T
        (body,) = (places[list(which)] for kind, which in model.strokes if kind == "rod")
        assert np.ptp(body[:, 0]) == pytest.approx(end, rel=1e-12)


def test_a_scara_in_its_plane_is_a_lagrangian_written_by_hand():
    problem = load_problem(GALLERY / "scara.toml")
    model, q, v = problem.model, ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    turn, elbow, kinetic = v[0] + v[1], 0.425 * v[0], 0.0  # forearm and quill move with the elbow
    for mass, out, inertia in ((8.0, 0.1875, 0.09375), (1.5, 0.375, 0.0002)):
        speed = elbow**2 + (out * turn) ** 2 + 2 * elbow * out * turn * ca.cos(q[1])
        kinetic += mass * speed / 2 + inertia * turn**2 / 2
    kinetic += (12.0 * 0.2125**2 + 0.180625) * v[0] ** 2 / 2
    plane = of.lagrange(kinetic, 200 * q[0] ** 2 + 75 * (q[1] - 0.8) ** 2, Symbols(q, v, ca.SX(0, 1), (), ()))
    random = np.random.default_rng(0)
    for _ in range(3):
        angles, rates = random.normal(size=(2, 2))
        ours = model.acceleration(0.0, [*angles, 0.0], [*rates, 0.0], model.parameter_values).full().ravel()
        wanted = plane.acceleration(0.0, angles, rates, plane.parameter_values).full().ravel()
        assert ours == pytest.approx([*wanted, 0.0], rel=1e-10, abs=1e-9)


def test_files_say_what_is_wrong(tmp_path):
    text = (GALLERY / "slider-crank-spring.toml").read_text()
    for old, new, said in (
        ("mass = 0.3", "weight = 0.3", "system.bodies.piston"),
        ('kind = "prismatic"', 'kind = "prism"', "joints.S.kind: unknown 'prism', did you mean 'prismatic'"),
        ("angles = { A = 0.5 }", "angles = { Q = 0.5 }", "Q: unknown coordinate"),
        ("at = [[0.0, 0.01]", "at = [[0.0, 0.5]", "the loop stays open at joint"),
    ):
        path = tmp_path / "bad.toml"
        path.write_text(text.replace(old, new))
        made = CliRunner().invoke(cli, ["run", str(path), "-o", str(tmp_path)])
        assert made.exit_code == 2 and said in made.output, made.output


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(GALLERY.glob("*.toml")), ids=lambda path: path.stem)
def test_gallery_certifies_and_says_its_period(path):
    problem = load_problem(path)
    assert problem.name == path.stem and problem.title and problem.source and "period" in problem.expected
    assert "Expected period" in path.read_text().split("\nname = ")[0].replace("\n# ", " ")
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed, orbit.certificate.failures


@pytest.mark.slow
def test_a_small_motion_keeps_its_energy_as_far_as_its_closures_hold():
    """Of 2e-14 J that drift, 5e-7 J of motion and 0.2 J in all: bars keep their lengths to round-off, and pull."""
    orbit = of.find_orbit(load_problem(Path(__file__).parent / "data" / "three-rrr.toml"))
    assert orbit.certificate.passed, orbit.certificate.failures


def test_a_disc_in_space_needs_no_inertia():
    """A point mass that is drawn as a disc, stated in Python: a file's reader fills the field in."""
    bob = {"mass": 1.0, "com": [1.0, 0.0, 0.0], "disc": 0.05}
    hook = {"kind": "universal", "between": ["ground", "bob"], "axes": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]}
    made = of.mechanism({"bob": bob}, {"hook": hook}, dimension=3, gravity=[G, 0.0, 0.0], pose={"hook2": 0.5})
    assert made.state_names == ("hook1", "hook2", "hook1dot", "hook2dot")
