"""Objectives, bounds and constraints: the optimum is the one that a scan of the family shows."""

import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import ConvergenceError, CountError, InputError
from orbitfinder.integrate.cvodes import build_flow, transition_function
from orbitfinder.loops.conditions import Constraint
from orbitfinder.loops.ipopt import SolveSettings, hessian
from orbitfinder.loops.shooting import transcribe
from orbitfinder.loops.symmetry import NONE, SYMMETRIES
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.objectives import instability, instability_of, rank
from orbitfinder.orbits.shoot import initial_nodes

FAST = SolveSettings(with_certificate=False)
DOUBLE = of.chain(2)


def fast_mode(amplitude=0.8, **more):
    return of.Problem(DOUBLE, of.guesses.normal_mode(DOUBLE, 2, amplitude), **more)


def index_of(orbit):
    """The largest |mu + 1/mu|."""
    return rank(orbit)[1]


@pytest.mark.parametrize("links", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_derivatives_of_the_transition_matrix(links):
    """Second-order variational equations against central differences, in every argument."""
    model = of.chain(links)
    function = transition_function(build_flow(model, ("length2",), NONE.unfolded(model)))
    start = [0.0, np.r_[np.linspace(0.5, 1, links), np.linspace(-1, 1, links)], 0.5, [0.1], [1.1]]
    base = [np.atleast_1d(np.asarray(one, float)) for one in start]
    found = function.jacobian()(*base, np.zeros((2 * links, 2 * links)))
    for k in range(1, 5):
        for j in range(base[k].size):
            ends = []
            for step in (1e-5, -1e-5):
                moved = [one.copy() for one in base]
                moved[k][j] += step
                ends.append(function(*moved).full().ravel("F"))
            numeric = (ends[0] - ends[1]) / 2e-5
            assert found[k].full()[:, j] == pytest.approx(numeric, abs=1e-6 * max(1.0, np.abs(numeric).max()))


def test_derivative_in_the_starting_time():
    """Forced equations change with t0; autonomous ones do not."""
    model = of.systems.FUNCTIONS["forced_duffing"]()
    function = transition_function(build_flow(model))
    point = [0.3, np.array([0.5, -0.2]), 0.8, np.zeros(0), np.zeros(0)]
    slope = function.jacobian()(*point, np.zeros((2, 2)))[0].full().ravel()
    ends = [function(0.3 + step, *point[1:]).full().ravel("F") for step in (1e-5, -1e-5)]
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-5, abs=1e-7)
    assert np.abs(slope).max() > 1e-3


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_monodromy_over_a_part_of_the_period(symmetry):
    """Variables.monodromy is Phi(T) whatever part of the period is integrated: its trace is that of the orbit."""
    problem = fast_mode(0.5, pin=of.pin(energy=-18.0), symmetry=symmetry)
    orbit = find_orbit(problem, FAST)
    flow = build_flow(DOUBLE, (), problem.boundary.unfolded(DOUBLE))
    guess = of.Guess(orbit.state, orbit.period)
    placed = of.Problem(DOUBLE, guess, symmetry=symmetry, objective=lambda v: ca.trace(v.monodromy))
    nodes = initial_nodes(placed, flow, FAST)
    shooting = transcribe(placed, nodes, flow)
    trace = float(ca.Function("trace", [shooting.variables], [shooting.objective])(shooting.start))
    assert trace - 2 == pytest.approx(orbit.floquet_multipliers.sum().real, abs=1e-6)


@pytest.mark.parametrize("conservative", [True, False])
def test_measure_of_instability_has_its_derivative(conservative):
    """Left and right eigenvectors against differences, for a generic matrix."""
    random = np.random.default_rng(3)
    matrix = np.eye(6) + 0.6 * random.normal(size=(6, 6))
    trivial = 2 if conservative else 1
    value, slope = instability_of(matrix, trivial, conservative)
    for i, j in ((0, 0), (2, 5), (4, 1)):
        step = np.zeros((6, 6))
        step[i, j] = 1e-6
        ends = [instability_of(matrix + s * step, trivial, conservative)[0] for s in (1, -1)]
        assert slope[i, j] == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-5, abs=1e-8)
    assert value > 0


def test_a_complex_quadruple_is_measured_by_its_radius():
    """Eigenvalues r e^(+-i phi) and their reciprocals count as r + 1/r, not as the smaller |mu + 1/mu|."""
    r, phi = 1.5, 1.2
    block = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
    matrix = np.zeros((6, 6))
    matrix[:2, :2], matrix[2:4, 2:4], matrix[4:, 4:] = r * block, block / r, np.eye(2)
    assert instability_of(matrix, 2, True)[0] == pytest.approx(0.25 * (r + 1 / r) ** 2)
    matrix = np.diag([3.0, 1 / 3, 0.9, 1 / 0.9, 1.0, 1.0])
    assert instability_of(matrix, 2, True)[0] == pytest.approx(0.25 * (3 + 1 / 3) ** 2)


@pytest.mark.slow
def test_min_instability_is_the_minimum_of_the_family():
    """The fast mode's index falls to 0 between -14 and -13 J (scan) and that is where the objective stops."""
    orbit = find_orbit(fast_mode(0.9, symmetry="brake", objective="min_instability", bounds={"energy": (-17.0, -10.0)}))
    assert orbit.certificate.passed
    assert index_of(orbit) < 1e-6
    for step in (-0.4, 0.4):
        beside = find_orbit(fast_mode(pin=of.pin(energy=orbit.energy + step), symmetry="brake"), FAST)
        assert index_of(beside) > 0.2


@pytest.mark.slow
def test_min_instability_with_two_pairs():
    """Triple pendulum: the largest of two indices, by eigenvectors, against a scan of the slow mode's family."""
    model = of.chain(3)
    guess = of.guesses.normal_mode(model, 1, 0.5)
    kept = {"symmetry": "brake+reflection"}
    low, high = -42.0, -38.0
    orbit = find_orbit(of.Problem(model, guess, objective="min_instability", bounds={"energy": (low, high)}, **kept))
    assert orbit.certificate.passed and low - 1e-6 <= orbit.energy <= high + 1e-6
    scanned = [
        find_orbit(of.Problem(model, guess, pin=of.pin(energy=energy), **kept), FAST)
        for energy in np.linspace(low, high, 9)
    ]
    largest = [np.abs(one.floquet_multipliers + 1 / one.floquet_multipliers).max() for one in scanned]
    assert np.abs(orbit.floquet_multipliers + 1 / orbit.floquet_multipliers).max() <= min(largest) + 1e-6


@pytest.mark.slow
def test_min_instability_at_a_kink():
    """Two opposite indices: the larger is least where both are equal, and larger for lengths on either side."""
    model = of.chain(3)
    kept = {"pin": of.pin(energy=-38.0), "symmetry": "brake"}
    wanted = {"free": ("length3",), "objective": "min_instability", "bounds": {"length3": (0.7, 1.4)}}
    orbit = find_orbit(of.Problem(model, of.guesses.normal_mode(model, 2, 0.6), **kept, **wanted))
    indices = np.sort((orbit.floquet_multipliers + 1 / orbit.floquet_multipliers).real)
    assert orbit.certificate.passed and indices[0] == pytest.approx(-indices[-1], abs=1e-8)
    length = orbit.provenance["free"]["length3"]
    for other in (length - 2e-3, length + 2e-3):
        near = of.Guess(orbit.state, orbit.period)
        beside = find_orbit(of.Problem(of.chain(3, length=[1.0, 1.0, other]), near, **kept), FAST)
        assert np.abs(beside.floquet_multipliers + 1 / beside.floquet_multipliers).max() > indices[-1] + 1e-6


@pytest.mark.parametrize("symmetry", [pytest.param("none", marks=pytest.mark.slow), "brake+reflection"])
def test_max_amplitude_is_the_maximum_of_the_family(symmetry):
    """The lower link swings widest between -9.5 and -8.5 J; t = 0 is at that peak."""
    wanted = {"objective": "max_amplitude", "coordinate": "theta2", "bounds": {"energy": (-12.0, -6.0)}}
    orbit = find_orbit(fast_mode(0.9, symmetry=symmetry, **wanted))
    assert orbit.certificate.passed
    widest = np.abs(orbit.samples[:, 1]).max()
    assert abs(orbit.state[1]) == pytest.approx(widest, rel=1e-9)
    assert -9.5 < orbit.energy < -8.5
    for energy in (orbit.energy - 0.3, orbit.energy + 0.3):
        beside = find_orbit(fast_mode(0.9, pin=of.pin(energy=energy), symmetry="brake+reflection"), FAST)
        assert np.abs(beside.samples[:, 1]).max() < widest - 1e-5


def test_min_peak_rate_stops_at_the_bound_of_the_period():
    """The peak rate grows with the period along the slow mode, so the smallest period allowed wins, to the digit."""
    guess = of.guesses.normal_mode(DOUBLE, 1, 1.1)
    wanted = {"objective": "min_peak_rate", "coordinate": "theta2", "bounds": {"period": (2.45, 2.6)}}
    orbit = find_orbit(of.Problem(DOUBLE, guess, **wanted))
    assert orbit.certificate.passed and orbit.period == 2.45
    peak = np.abs(orbit.samples[:, 3]).max()
    assert abs(orbit.state[3]) == pytest.approx(peak, rel=1e-9)
    longer = find_orbit(of.Problem(DOUBLE, guess, pin=of.pin(period=2.47)), FAST)
    assert np.abs(longer.samples[:, 3]).max() > peak + 0.1


@pytest.mark.slow
def test_min_peak_rate_with_a_freed_length():
    """At -17 J the lower link of 0.60005 m turns most gently; lengths beside it are worse."""
    guess = of.guesses.normal_mode(DOUBLE, 1, 0.4)
    wanted = {"objective": "min_peak_rate", "coordinate": "theta2", "bounds": {"length2": (0.5, 2.0)}}
    orbit = find_orbit(of.Problem(DOUBLE, guess, pin=of.pin(energy=-17.0), free=("length2",), **wanted))
    assert orbit.certificate.passed
    best, length = np.abs(orbit.samples[:, 3]).max(), orbit.provenance["free"]["length2"]
    assert length == pytest.approx(0.60005358, abs=1e-7)
    for other in (length - 0.01, length + 0.01):
        pinned = of.Constraint(lambda v, other=other: v["length2"] - other, name="length")
        near = of.Guess(orbit.state, orbit.period)
        beside = of.Problem(DOUBLE, near, pin=of.pin(energy=-17.0), free=("length2",), constraints=(pinned,))
        assert np.abs(find_orbit(beside, FAST).samples[:, 3]).max() > best + 1e-3


@pytest.mark.slow
def test_the_largest_amplitude_of_the_van_der_pol_oscillator():
    """2.0234 near mu = 3.3, the one maximum of the amplitude over the damping, against solutions beside it."""
    model = of.systems.FUNCTIONS["van_der_pol"]()
    problem = of.Problem(
        model, of.Guess([2.0, 0.0], 6.6), free=("damping",), objective="max_amplitude", bounds={"damping": (0.5, 10.0)}
    )
    orbit = find_orbit(problem)
    damping = orbit.provenance["free"]["damping"]
    assert orbit.certificate.passed and abs(orbit.state[0]) == pytest.approx(2.02342, abs=1e-5)
    for other in (0.9 * damping, 1.1 * damping):
        near = of.Guess(orbit.state, orbit.period, orbit.times, orbit.samples)
        beside = find_orbit(of.Problem(of.systems.FUNCTIONS["van_der_pol"](other), near), FAST)
        assert np.abs(beside.samples[:, 0]).max() < abs(orbit.state[0]) - 1e-6


def test_a_turning_coordinate_has_no_amplitude():
    """Running orbits: said before the search goes on."""
    running = of.Guess([0.0, 7.0], 1.2)
    with pytest.raises(InputError, match="theta1 turns over and over"):
        find_orbit(of.Problem(of.chain(1), running, winding=(1,), objective="max_amplitude", bounds={"energy": (2, 9)}))


def test_a_vector_is_least_squares_with_a_gauss_newton_hessian():
    """|r|^2 / 2: the same orbit as the scalar objective, and the Hessian handed to IPOPT is J^T J."""
    guess = of.guesses.normal_mode(DOUBLE, 1, 0.5)

    def distances(v):
        return ca.vertcat(v["theta1"] - 0.6, 3 * (v["period"] - 2.39))

    squares = find_orbit(of.Problem(DOUBLE, guess, objective=distances), FAST)
    scalar = find_orbit(of.Problem(DOUBLE, guess, objective=lambda v: 0.5 * ca.sumsqr(distances(v))), FAST)
    assert squares.energy == pytest.approx(scalar.energy, abs=1e-4)
    shooting = transcribe(of.Problem(DOUBLE, guess, objective=distances), np.tile(guess.state, (2, 1)))
    matrix = hessian(shooting)(shooting.start, [], 2.0, np.zeros(shooting.constraints.numel())).full()
    assert matrix[0, 0] == pytest.approx(2.0, rel=1e-6) and matrix[8, 8] == pytest.approx(18.0, rel=1e-6)


def test_an_equation_on_the_monodromy_counts_and_holds():
    """The orbit of the fast mode whose multipliers are at +-i: a quarter turn, trace Phi(T) = 2."""
    quarter = of.Constraint(lambda v: ca.trace(v.monodromy) - 2, name="quarter turn")
    problem = fast_mode(0.6, symmetry="brake", constraints=(quarter,))
    assert problem.count().equations["constraints"] == 1 and problem.count().freedom == 0
    orbit = find_orbit(problem)
    assert orbit.certificate.passed and index_of(orbit) < 1e-7
    assert orbit.energy == pytest.approx(-13.596216904, abs=1e-6)


def test_inequalities_and_bounds_hold_without_being_counted():
    """The nearest orbit has -19.02 J, but one above -18.5 J is asked for: the bound is where it stops."""
    room = of.Constraint(lambda v: v["energy"], -18.5, np.inf, name="not below")
    for more in ({"bounds": {"energy": (-18.5, -17.0)}}, {"constraints": (room,)}):
        problem = fast_mode(0.8, **more)
        assert problem.count().freedom == 1
        orbit = find_orbit(problem)
        assert orbit.certificate.passed and orbit.energy == pytest.approx(-18.5, abs=1e-7)


def test_variables_by_name():
    """States, quantities, parameters and accelerations are what their names say."""
    guess = of.guesses.normal_mode(DOUBLE, 1, 0.5)
    seen = {}

    def look(v):
        seen.update({name: v[name] for name in ("theta2", "theta1dot", "period", "energy", "mass1", "length2")})
        seen.update(acceleration=v.acceleration, end=v.ends[-1], free=v.free["length2"])
        return v["period"]

    shooting = transcribe(of.Problem(DOUBLE, guess, free=("length2",), objective=look), guess.state[None, :])
    assert set(seen) >= {"theta2", "energy"}
    with pytest.raises(InputError, match="variables: unknown quantity 'theta9', did you mean 'theta"):
        transcribe(of.Problem(DOUBLE, guess, objective=lambda v: v["theta9"]), guess.state[None, :])
    assert shooting.guess.free.size == 1


BAD = {
    "objective": ({"objective": "min_instabilty"}, "unknown 'min_instabilty', did you mean 'min_instability'"),
    "coordinate-alone": ({"coordinate": "theta1"}, "goes with the objectives max_amplitude and min_peak_rate"),
    "coordinate": ({"objective": "max_amplitude", "coordinate": "theta3"}, "unknown 'theta3'; this system has theta1"),
    "brake-rate": ({"objective": "min_peak_rate", "symmetry": "brake"}, "freedom to choose t = 0.*'brake' does not"),
    "bounds-unknown": ({"bounds": {"enrgy": (0, 1)}}, "bounds: unknown quantity 'enrgy', did you mean 'energy'"),
    "bounds-order": ({"bounds": {"energy": (1, 0)}}, "bounds: energy must be .smallest, largest."),
    "bounds-three": ({"bounds": {"energy": (1, 2, 3)}}, r"bounds: expected names with two numbers, \[smallest"),
    "bounds-period": ({"bounds": {"period": (-1.0, 2.0)}}, "bounds: period must be positive"),
    "bounds-fixed": ({"bounds": {"length2": (0.5, 2.0)}}, "length2 is not free to change; add it to free"),
    "bounds-pinned": ({"bounds": {"energy": (-19, -3)}, "pin": of.pin(energy=-18)}, "energy is pinned already"),
    "constraint-order": ({"constraints": (Constraint(lambda v: v.period, 2, 1),)}, "2 <= expression <= 1"),
}


@pytest.mark.parametrize("case", BAD, ids=str)
def test_messages(case):
    """Every contradiction is named before anything is computed."""
    more, message = BAD[case]
    with pytest.raises(InputError, match=message):
        fast_mode(**more)


def test_nothing_left_to_choose():
    """An objective without freedom is refused, and a choice among orbits is sent to where it is made."""
    with pytest.raises(CountError, match="nothing is left to choose.*free a physical parameter"):
        find_orbit(fast_mode(pin=of.pin(energy=-17.0), objective="max_amplitude"))
    choice = fast_mode(pin=of.pin(energy=-17.0), objective="min_instability", bounds={"period": (1.0, 2.0)})
    with pytest.raises(CountError, match="least_unstable"):
        find_orbit(choice)


def test_a_constraint_of_the_wrong_length():
    """Announced and found rows are compared when the expression is known."""
    wrong = Constraint(lambda v: v.start, name="whole state")
    with pytest.raises(InputError, match="whole state has 4 rows, announced 1"):
        find_orbit(fast_mode(constraints=(wrong,), free=("length2", "mass1")))


def test_forced_motions_have_no_peak_to_choose():
    """The forcing decides what t = 0 is, and the period."""
    model = of.systems.FUNCTIONS["forced_duffing"]()
    guess = of.Guess([0.5, 0.0], 5.0)
    with pytest.raises(InputError, match="forcing"):
        of.Problem(model, guess, objective="max_amplitude", free=(model.parameter_names[0],))
    with pytest.raises(InputError, match="forcing prescribes the period"):
        of.Problem(model, guess, bounds={"period": (1.0, 9.0)})


def test_a_pendulum_alone_has_nothing_to_be_unstable():
    with pytest.raises(InputError, match="no non-trivial Floquet multipliers"):
        instability(of.chain(1))


def test_a_peak_away_from_rest_is_said():
    """Slow mode at large amplitude: the lower link is not farthest out at rest."""
    guess = of.guesses.normal_mode(DOUBLE, 1, 0.8)
    wanted = {"objective": "max_amplitude", "coordinate": "theta2", "bounds": {"energy": (-19.0, -14.0)}}
    with pytest.raises(ConvergenceError, match="theta2 is largest away from rest.*use symmetry none"):
        find_orbit(of.Problem(DOUBLE, guess, symmetry="brake", **wanted))


@pytest.mark.slow
def test_a_kink_is_where_the_objective_stops():
    """|energy + 18| has its least value at a kink, which no quasi-Newton method settles on: said with the place."""
    problem = fast_mode(0.5, symmetry="brake+reflection", objective=lambda v: ca.fabs(v["energy"] + 18.0) ** 0.5)
    with pytest.raises(ConvergenceError, match=r"cannot be followed beyond the orbit of period 1\.11.*kink"):
        find_orbit(problem)


def test_an_orbit_outside_the_period_asked_for_is_no_answer():
    """The loop run twice closes as well; its minimal period is what counts."""
    once = of.guesses.normal_mode(DOUBLE, 1, 0.3)
    twice = of.Guess(once.state, 2 * once.period)
    with pytest.raises(ConvergenceError, match="several times.*outside bounds.period"):
        find_orbit(of.Problem(DOUBLE, twice, bounds={"period": (4.0, 6.0)}))


def test_the_documented_example():
    """docs/problem-file.md: two freed lengths, a brake orbit of 1.5 s, as near as possible to what is wished."""
    text = (Path(__file__).parents[1] / "docs" / "problem-file.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    names = {}
    exec(compile(code, "problem-file.md", "exec"), names)
    orbit = names["orbit"]
    assert orbit.certificate.passed and orbit.period == 1.5
    found = orbit.provenance["free"]
    assert 1.8 - 1e-7 <= found["length2"] + found["length3"] <= 2.2 + 1e-7


def test_the_freed_length_by_other_means():
    """problems/examples/triple-length-for-2s: rest after 1 s by DOP853 on equations written out by hand."""
    from scipy.integrate import solve_ivp
    from scipy.optimize import root

    i, j = np.indices((3, 3))
    coupling = np.where(i == j, 1 / 3, 0.5) + 2 - np.maximum(i, j)

    def rates(_, state, lengths):
        q, v = state[:3], state[3:]
        sizes, gap = coupling * np.outer(lengths, lengths), q[:, None] - q
        force = (sizes * np.sin(gap)) @ v**2 + 9.8 * np.array([2.5, 1.5, 0.5]) * lengths * np.sin(q)
        return np.r_[v, np.linalg.solve(sizes * np.cos(gap), -force)]

    def speeds(unknown):
        start = [unknown[0], unknown[1], 1.0, 0.0, 0.0, 0.0]
        lengths = np.array([1.0, 1.0, unknown[2]])
        path = solve_ivp(rates, (0.0, 1.0), start, "DOP853", args=(lengths,), rtol=1e-12, atol=1e-12)
        return path.y[3:, -1]

    found = root(speeds, [-0.65, 0.35, 0.8], tol=1e-12)
    problem = of.load_problem(Path(__file__).parents[1] / "problems" / "examples" / "triple-length-for-2s.toml")
    assert found.success and found.x[2] == pytest.approx(problem.expected["length3"][0], abs=1e-9)
