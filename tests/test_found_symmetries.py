"""Symmetries that no coordinate shows are found, and trivial multipliers are split off by their group as it is."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.integrate.equations import invariant_gradients
from orbitfinder.orbits.floquet import generated
from orbitfinder.systems import n_bodies, three_bodies

EIGHT = [[-1.0, 0.0], [1.0, 0.0], [0.0, 0.0]], [[0.347111, 0.532728], [0.347111, 0.532728], [-0.694222, -1.065456]]
"""C. Simo's, as printed by M. Suvakov, V. Dmitrasinovic, Physical Review Letters 110 (2013) 114301; T = 6.324449"""


def found(kinetic, potential, q, v, **options):
    model = of.lagrange(kinetic, potential, of.Symbols(q, v, *options.pop("parameters", ())), **options)
    return [one.name for one in model.invariants]


def bodies_in(dimension, count=3):
    q, v, mass = (
        ca.SX.sym(name, size) for name, size in (("q", dimension * count), ("v", dimension * count), ("m", count))
    )
    places, rates = ca.reshape(q, dimension, count), ca.reshape(v, dimension, count)
    kinetic = ca.dot(mass, ca.sum1(rates**2).T) / 2
    pairs = [(i, j) for i in range(count) for j in range(i)]
    potential = -sum(mass[i] * mass[j] / ca.norm_2(places[:, i] - places[:, j]) for i, j in pairs)
    names = [f"{axis}{k + 1}" for k in range(count) for axis in "xyz"[:dimension]]
    return found(
        kinetic, potential, q, v, names=names, parameters=(mass, [f"m{k}" for k in range(count)], [1.0, 2.0, 3.0])
    )


def test_of_bodies_in_cartesian_coordinates():
    shifts = {f"momentum_{axis}1_{axis}2_{axis}3" for axis in "xyz"}
    assert set(bodies_in(2)) == {"energy", "angular_momentum"} | shifts - {"momentum_z1_z2_z3"}
    turns = {f"angular_momentum_{pair}" for pair in ("x1_y1", "x1_z1", "y1_z1")}
    assert set(bodies_in(3)) == {"energy"} | shifts | turns


def test_what_is_a_symmetry_and_what_is_none():
    q, v, k = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("k", 2)
    unit, well = ca.sumsqr(v) / 2, ca.sumsqr(q) + ca.sumsqr(q) ** 2
    spin = ["energy", "angular_momentum"]
    assert found(unit, well, q, v) == spin
    assert found(unit, well, q, v, angles=[True, False]) == ["energy"]  # an angle is not a length
    assert found(unit + v[0] ** 2, well, q, v) == ["energy"]
    assert found(unit, well + q[0], q, v) == ["energy"]
    stiff = k[0] * q[0] ** 2 + k[1] * q[1] ** 2
    assert found(unit, stiff, q, v, parameters=(k, ["kx", "ky"], [1.0, 1.0])) == ["energy"]  # of these values alone
    gyroscopic = unit + q[0] * v[1] - q[1] * v[0]
    assert found(gyroscopic, well, q, v) == spin
    assert found(unit, well, q, v, forces=-v) == []
    assert found(unit, well, q, v, forces=q * ca.sumsqr(v)) == ["angular_momentum"]  # a central force does not turn
    assert found(unit, (q[0] - q[1]) ** 2, q, v) == ["energy", "momentum_q1_q2"]
    assert found(unit, ca.norm_2(q - ca.DM([1, 2])), q, v) == spin  # about another point


def test_of_many_coordinates_shifts_are_found_and_rotations_are_not_looked_for():
    q, v = ca.SX.sym("q", 14), ca.SX.sym("v", 14)
    loose = ca.sumsqr(ca.diff(q)) + ca.sumsqr(ca.diff(q) ** 2)
    assert found(ca.sumsqr(v) / 2, loose, q, v) == ["energy", "momentum_q1_to_q14"]
    assert found(ca.sumsqr(v) / 2, ca.sumsqr(q), q, v) == ["energy"]
    q, v = ca.SX.sym("q", 101), ca.SX.sym("v", 101)
    assert found(ca.sumsqr(v) / 2, ca.sumsqr(ca.diff(q)), q, v) == ["energy"]


def test_a_momentum_is_kept_by_a_simulation():
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    model = of.lagrange(ca.sumsqr(v) / 2, ca.norm_2(q - ca.DM([1, 2])) ** 3, of.Symbols(q, v))
    states = of.simulate(model, [0.0, 0.3, 1.0, -0.2], 5.0).states
    spin = next(one for one in model.invariants if one.name == "angular_momentum")
    values = [float(spin.value(x[:2], x[2:], [])) for x in states]
    about = (states[:, 0] - 1) * states[:, 3] - (states[:, 1] - 2) * states[:, 2]
    assert np.ptp(values) < 1e-9 and np.abs(np.abs(values) - np.abs(about)).max() < 1e-12


def springs(dimension):
    """Two unit masses on springs that harden, to the origin and to each other."""
    q, v = ca.SX.sym("q", 2 * dimension), ca.SX.sym("v", 2 * dimension)

    def spring(square):
        return square / 2 + square**2 / 8

    first, second = q[:dimension], q[dimension:]
    potential = spring(ca.sumsqr(first)) + spring(ca.sumsqr(second)) + spring(ca.sumsqr(first - second)) / 2
    return of.lagrange(ca.sumsqr(v) / 2, potential, of.Symbols(q, v))


def rosette():
    """The velocity of one mass at (1, 0), the other being opposite, and the period: nine swings in four turns."""

    def field(_, x):
        square = x[:2] @ x[:2]
        return [*x[2:], *(-(1 + square / 2) * x[:2] - (1 + 2 * square) * x[:2])]

    def swing(speed):
        def outermost(_, x):
            return x[:2] @ x[2:]

        outermost.direction = -1.0
        gone = solve_ivp(field, (0, 3), np.array([1.0, 0.0, 0.0, speed]), events=outermost, rtol=1e-12, atol=1e-12)
        late = gone.t_events[0] > 0.1
        return gone.t_events[0][late][0], gone.y_events[0][late][0]

    def off(speed):
        return np.arctan2(*swing(speed)[1][1::-1]) - 8 * np.pi / 9

    speed = brentq(off, 1.2, 2.1, xtol=1e-13)
    return speed, 9 * swing(speed)[0]


def test_rotations_in_space_do_not_commute():
    """Where the angular momentum is not 0 six multipliers are at +1: of twelve six are left, and four of them are those
    of the same motion in the plane."""
    speed, period = rosette()
    flat = of.find_orbit(of.Problem(springs(2), of.Guess([1, 0, -1, 0, 0, speed, 0, -speed], period)))
    frame = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()
    start = np.concatenate([frame @ x for x in ([1, 0, 0], [-1, 0, 0], [0, speed, 0], [0, -speed, 0])])
    tilted = of.find_orbit(of.Problem(springs(3), of.Guess(start, period)))
    assert flat.certificate.passed and tilted.certificate.passed
    assert flat.floquet_multipliers.size == 4 and tilted.floquet_multipliers.size == 6
    gaps = np.abs(tilted.floquet_multipliers[:, None] - flat.floquet_multipliers).min(axis=0)
    assert gaps.max() < 1e-9 and np.abs(np.abs(tilted.floquet_multipliers) - 1).max() < 1e-9


def test_directions_of_symmetries_that_do_not_commute():
    """Those that are left leave all momenta as they are: about the angular momentum alone, all where that is 0."""
    model, random = springs(3), np.random.default_rng(2)
    for rates, count in ((random.normal(size=6), 1), (np.zeros(6), 3)):
        state = np.concatenate([random.normal(size=6), rates])
        some, every = generated(model, state), generated(model, state, commuting=False)
        assert np.linalg.matrix_rank(some, 1e-9) == count and np.linalg.matrix_rank(every, 1e-9) == 3
        spins = invariant_gradients(model)(state).full()[1:]
        assert np.abs(spins @ some.T).max() < 1e-12 and (np.abs(spins @ every.T).max() > 0.1) == (count == 1)
        assert np.linalg.matrix_rank(np.vstack([some, every]), 1e-9) == 3


def test_the_figure_eight_as_text(tmp_path):
    """It was found and refused by its multipliers."""
    gap = "sqrt((x{0} - x{1})^2 + (y{0} - y{1})^2)"
    names = [f"{axis}{k}" for k in (1, 2, 3) for axis in "xy"]
    model = of.equations(
        coordinates=names, kinetic="(" + " + ".join(f"{name}dot^2" for name in names) + ")/2",
        potential=" ".join(f"- 1/{gap.format(*pair)}" for pair in ((1, 2), (1, 3), (2, 3))),
    )  # fmt: skip
    orbit = of.find_orbit(of.Problem(model, of.Guess(np.ravel(EIGHT), 6.324449)))
    assert orbit.certificate.passed and orbit.floquet_multipliers.size == 4 and orbit.stability == "elliptic"
    assert of.certify(of.load_orbit(of.save_orbit(orbit, tmp_path / "orbit.json"))).passed


@pytest.mark.parametrize("dimension", [2, 3])
def test_bodies_from_printed_positions_and_velocities(dimension, tmp_path):
    """In another place and moving, in space turned as well: the same orbit as that of `three_bodies`, but for its size,
    which the nearest orbit has to 1e-8."""
    frame = np.linalg.qr(np.random.default_rng(0).normal(size=(dimension, dimension)))[0][:, :2]
    places, rates = (np.array(each) @ frame.T for each in EIGHT)
    model, state = of.bodies([1.0, 1.0, 1.0], places + 5.0, rates - 2.0)
    orbit = of.find_orbit(of.Problem(model, of.Guess(state, 6.324449)))
    known = of.find_orbit(of.Problem(three_bodies(), of.Guess([2, 0, 0, 0, 0, 0, -1.041333, -1.598184], 6.324449)))
    scaled = [each.period * abs(each.energy) ** 1.5 for each in (orbit, known)]  # Kepler's third law
    assert orbit.certificate.passed and scaled[0] == pytest.approx(scaled[1], rel=1e-11)
    assert np.abs(orbit.floquet_multipliers - known.floquet_multipliers).max() < 1e-6
    assert of.certify(of.load_orbit(of.save_orbit(orbit, tmp_path / "orbit.json"))).passed


def test_bodies_move_as_newton_says():
    """Against accelerations written by hand, masses unequal."""
    random, masses = np.random.default_rng(1), np.array([1.0, 2.5, 0.7, 1.9])
    places, rates = random.normal(size=(2, 4, 3))
    model, state = of.bodies(masses, places, rates, gravitation=0.8)
    apart = places[None] - places[:, None]
    pulls = apart / np.where(np.eye(4), 1, np.linalg.norm(apart, axis=2))[..., None] ** 3
    accelerations = 0.8 * (masses[None, :, None] * pulls).sum(axis=1)
    centres = np.cumsum(masses[:, None] * accelerations, axis=0) / np.cumsum(masses)[:, None]
    gone = model.acceleration(0, state[:9], state[9:], model.parameter_values).full().ravel()
    assert gone == pytest.approx((accelerations[1:] - centres[:-1]).ravel(), rel=1e-11)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: of.bodies([1, 1], *EIGHT), "positions: shape .3, 2. for 2 masses; give two or three numbers"),
        (lambda: of.bodies([1, 1, 1], EIGHT[0], np.ones((3, 3))), "velocities: shape .3, 3. for 3 masses"),
        (lambda: of.bodies([1, 1, -1], *EIGHT), "mass3: must be positive"),
        (lambda: of.bodies(["a"], *EIGHT), "masses: expected a list of numbers"),
        (lambda: of.bodies([1], [[0, 0]], [[0, 0]]), "dimension and count: must be 2 or more"),
        (lambda: n_bodies(2, mass3=1.0), "mass3: has no body; 2 bodies have the masses mass1, mass2"),
        (lambda: n_bodies(2, 1), "dimension and count: must be 2 or more"),
        (lambda: n_bodies(13), "count: must be a whole number from 1 to 12"),
    ],
)
def test_what_is_no_group_of_bodies_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
