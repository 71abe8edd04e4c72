"""Periodic orbits on the native DAE, against closed forms, quadratures and minimal coordinates."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq
from scipy.special import ellipk

import orbitfinder as of
from orbitfinder.cli.group import cli as main
from orbitfinder.errors import InputError
from orbitfinder.integrate.cvodes import transition
from orbitfinder.integrate.dop853 import integrate
from orbitfinder.integrate.idas import build_dae_flow
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.linkage import minimal_linkage
from orbitfinder.orbits.guesses.modes import linkage_equilibrium, linkage_mode, linkage_modes
from orbitfinder.orbits.guesses.returns import first_return

FILES = Path(__file__).parents[1] / "problems" / "linkages"
FOUR_BAR = {"length": [0.5, 1.2, 1.0], "ground": [0.2, 1.0]}  # a crank-rocker
FIVE_BAR = {"length": [0.6, 0.9, 0.8, 0.5], "ground": [0.1, 1.2]}
SIX_BAR = {"length": [0.5, 0.7, 0.8, 0.6, 0.5], "ground": [0.1, 1.3]}


def cartesian_pendulum(mass=1.3, length=0.7, gravity=9.81, baumgarte=(10, 10)):
    """x^2 + y^2 = l^2, x down."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    kinetic, potential = 0.5 * mass * ca.sumsqr(v), -mass * gravity * q[0]
    return of.constrained(
        kinetic, potential, ca.sumsqr(q) - length**2, of.Symbols(q, v),
        baumgarte=of.Baumgarte(*baumgarte), names=["x", "y"],
    )  # fmt: skip


def effective(model, theta1, branch=1):
    """m and V of 1/2 m thetadot1^2 + V = E at one crank angle, from the maximal model's energies."""
    theta = of.linkages.assemble(model, {"theta1": theta1}, branch=branch)
    state = of.linkages.linkage_state(model, theta, of.linkages.linkage_rates(model, theta, {"theta1dot": 1.0}))
    q, v = np.split(state, 2)
    return 2 * float(model.kinetic(q, v, model.parameter_values)), float(model.potential(q, model.parameter_values))


def rocking_period(model, level, inside, points=200):
    """2 int dtheta sqrt(m / 2 (E - V)) between the turning points, by Gauss-Chebyshev quadrature."""

    def room(angle):
        return level - effective(model, angle)[1]

    grid = np.linspace(0, 2.5, 251)
    ends = []
    for sign in (-1, 1):
        outer = next(step for step in grid if room(inside + sign * step) < 0)
        ends.append(brentq(room, inside, inside + sign * outer, xtol=1e-15, rtol=8.9e-16))
    middle, half = np.mean(ends), np.ptp(ends) / 2
    nodes = np.cos((np.arange(points) + 0.5) * np.pi / points)
    total = 0.0
    for node in nodes:
        mass, potential = effective(model, middle + half * node)
        total += np.sqrt(mass / (2 * (level - potential))) * half * np.sqrt(1 - node**2)
    return 2 * total * np.pi / points


def rotating_period(model, level, points=400):
    """int over one turn of dtheta sqrt(m / 2 (E - V)), by the trapezoidal rule."""
    pairs = np.array([effective(model, angle) for angle in 2 * np.pi * np.arange(points) / points])
    return 2 * np.pi * np.mean(np.sqrt(pairs[:, 0] / (2 * (level - pairs[:, 1]))))


def test_cartesian_pendulum_has_the_period_of_the_elliptic_integral():
    """x^2 + y^2 = l^2 as a native DAE: period to 1e-10, and the same orbit in the angle agrees to 1e-10."""
    model, angle = cartesian_pendulum(), 1.2
    exact = 4 * np.sqrt(0.7 / 9.81) * ellipk(np.sin(angle / 2) ** 2)
    level = -1.3 * 9.81 * 0.7 * np.cos(angle)
    start = [0.7 * np.cos(angle), 0.7 * np.sin(angle), 0, 0]
    orbit = of.find_orbit(of.Problem(model, of.Guess(start, 1.05 * exact), of.pin(energy=level)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period == pytest.approx(exact, rel=1e-12)
    assert orbit.symmetry == "brake" and not orbit.floquet_multipliers.size
    rod = of.chain(1, length=0.7, mass=1.3, inertia=1e-300, com=1.0, gravity=9.81)
    minimal = of.find_orbit(of.Problem(rod, of.Guess(np.array([angle, 0.0]), exact), of.pin(energy=level)))
    assert orbit.period == pytest.approx(minimal.period, abs=1e-10)
    assert np.hypot(*orbit.state[:2]) == pytest.approx(0.7, abs=1e-13)
    assert orbit.action == pytest.approx(minimal.action, abs=1e-10)


def test_whirling_cartesian_pendulum_closes_without_winding():
    """A pendulum that turns over is simply closed in Cartesian coordinates; T = 4 k K(k) / (2 omega0)."""
    model, rate = cartesian_pendulum(), 12.0
    k = 2 * np.sqrt(9.81 / 0.7) / rate
    exact = 2 * k * ellipk(k**2) / np.sqrt(9.81 / 0.7)
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.7, 0, 0, 0.7 * rate], 0.97 * exact), of.pin(ydot=0.7 * rate)))
    assert orbit.certificate.passed and orbit.period == pytest.approx(exact, abs=1e-10)


def test_forward_sensitivities_agree_with_the_reduced_variational_equations():
    """IDAS on the DAE against CVODES on the reduced form: 1e-8, with and without unfolding in the model."""
    model = of.linkage(**FOUR_BAR)
    theta = of.linkages.assemble(model, {"theta1": 0.6})
    problem = of.Problem(model, of.Guess(np.concatenate([theta, np.zeros(3)]), 1.0))
    flow = build_dae_flow(problem.model, (), problem.boundary.unfolded(problem.model))
    x0 = ca.MX.sym("x0", 18)
    names, inputs = flow.inputs()
    plain = ca.Function("plain", inputs, [flow.integrated(inputs)], names, ["xf"])
    found = plain(0.0, x0, 0.3, np.zeros(len(flow.unfolded)), [])
    forward = ca.Function("forward", [x0], [found, ca.jtimes(found, x0, ca.DM.eye(18))])
    end, matrix = (part.full().squeeze() for part in forward(problem.guess.state))
    other, expected = transition(flow, problem.guess.state, 0.3)
    assert np.abs(end - other).max() < 1e-9
    assert np.abs(matrix - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.slow
def test_rocking_four_bar_has_the_period_of_the_quadrature():
    """Every regular motion of one degree of freedom is an orbit; maximal and minimal agree to 1e-9."""
    model = of.linkage(**FOUR_BAR)
    start = of.linkages.linkage_state(model, of.linkages.assemble(model, {"theta1": 0.6}))
    level = energy(model, start)
    orbit = of.find_orbit(of.Problem(model, of.Guess(start, first_return(model, start)), of.pin(energy=level)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.symmetry == "brake" and not orbit.floquet_multipliers.size
    assert orbit.period == pytest.approx(rocking_period(model, level, 0.5), abs=1e-9)
    minimal = minimal_linkage(model, [1])
    small = of.find_orbit(of.Problem(minimal, of.Guess(np.array([0.6, 0.0]), orbit.period), of.pin(energy=level)))
    assert small.certificate.passed and orbit.period == pytest.approx(small.period, abs=1e-9)


@pytest.mark.slow
def test_rotating_four_bar_has_the_period_of_the_quadrature():
    """The crank turns over once in a period: winding found from the motion, period by quadrature to 1e-9."""
    model = of.linkage(**FOUR_BAR)
    theta = of.linkages.assemble(model, {"theta1": 0.6})
    start = of.linkages.linkage_state(model, theta, of.linkages.linkage_rates(model, theta, {"theta1dot": 16.0}))
    level = energy(model, start)
    problem = of.Problem(model, of.Guess(start, first_return(model, start)), of.pin(energy=level))
    orbit = of.find_orbit(replace(problem, tolerance=5e-12))  # the shear amplifies round-off
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.winding == (0, 0, 1, 0, 0, 0, 0, 0, 0)
    assert orbit.period == pytest.approx(rotating_period(model, level), abs=1e-9)


@pytest.mark.parametrize("mode", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_five_bar_modes_agree_in_minimal_coordinates(mode):
    """Period and multipliers of maximal (24 states) and minimal (4) formulations agree to 1e-9; brake orbits."""
    model = of.linkage(**FIVE_BAR)
    guess = linkage_mode(model, mode, 0.3)
    level = energy(model, guess.state)
    orbit = of.find_orbit(of.Problem(model, guess, of.pin(energy=level)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.symmetry == "brake" and orbit.stability == "elliptic" and orbit.floquet_multipliers.size == 2
    theta = of.linkages.minimal_states(model, orbit.state)
    minimal = minimal_linkage(model, [1, 4], 1 if np.sin(theta[2] - theta[1]) > 0 else -1)
    state = np.array([theta[0], theta[3], theta[4], theta[7]])
    small = of.find_orbit(of.Problem(minimal, of.Guess(state, orbit.period), of.pin(energy=level)))
    assert small.certificate.passed and orbit.period == pytest.approx(small.period, abs=1e-9)
    traces = [np.sum(one.floquet_multipliers) for one in (orbit, small)]
    assert abs(traces[0] - traces[1]) < 1e-9
    distance = np.abs(orbit.floquet_multipliers[:, None] - small.floquet_multipliers[None, :]).min(axis=1)
    assert distance.max() < 1e-9


@pytest.mark.slow
def test_five_bar_about_a_saddle_is_unstable():
    """A Lyapunov orbit: one squared frequency is negative at the saddle, the multipliers are real and large."""
    model = of.linkage(**FIVE_BAR)
    saddle = linkage_equilibrium(model, [0.3, 1.8, 2.9, -0.1])
    squared, _ = linkage_modes(model, saddle)
    assert squared[0] < 0 < squared[1]
    guess = linkage_mode(model, 2, 0.1, saddle)
    orbit = of.find_orbit(of.Problem(model, guess, of.pin(energy=energy(model, guess.state))))
    assert orbit.certificate.passed, orbit.certificate.failures
    growth = np.exp(np.sqrt(-squared[0]) * orbit.period)
    assert orbit.stability == "unstable" and orbit.floquet_multipliers[0].real == pytest.approx(growth, rel=0.2)


@pytest.mark.parametrize(
    ("mode", "amplitude", "stability"),
    [
        pytest.param(1, 0.1, "elliptic", marks=pytest.mark.slow),
        pytest.param(2, 0.2, "elliptic", marks=pytest.mark.slow),
        pytest.param(2, 0.4, "unstable", marks=pytest.mark.slow),
    ],
)
def test_six_bar_modes(mode, amplitude, stability):
    """Three degrees of freedom: modes of the hanging equilibrium at growing energy, four multipliers in two pairs."""
    model = of.linkage(**SIX_BAR)
    guess = linkage_mode(model, mode, amplitude)
    level = energy(model, guess.state)
    orbit = of.find_orbit(of.Problem(model, guess, of.pin(energy=level)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.symmetry == "brake" and orbit.floquet_multipliers.size == 4 and orbit.stability == stability


@pytest.mark.slow
def test_linear_modes_are_the_small_orbits():
    """The period tends to 2 pi / omega with the square of the amplitude."""
    model = of.linkage(**FOUR_BAR)
    periods = []
    for amplitude in (0.02, 0.01):
        guess = linkage_mode(model, 1, amplitude)
        level = energy(model, guess.state)
        periods.append(of.find_orbit(of.Problem(model, guess, of.pin(energy=level))).period)
    first, second = (abs(period - guess.period) for period in periods)
    assert first / second == pytest.approx(4.0, rel=0.05)


@pytest.mark.slow
def test_baumgarte_multipliers_never_appear():
    """Another stabilisation, the same multipliers: those across the manifold are left out."""
    model = of.linkage(**FIVE_BAR)
    guess = linkage_mode(model, 1, 0.3)
    found = []
    for stabilisation in ((10.0, 10.0), (4.0, 7.0)):
        other = of.linkage(**FIVE_BAR, baumgarte=stabilisation)
        found.append(of.find_orbit(of.Problem(other, guess, of.pin(energy=-24.0))).floquet_multipliers)
    assert np.abs(found[0] - found[1]).max() < 1e-9


def test_a_tampered_orbit_is_not_certified():
    """A state off the orbit fails closure, one off the constraints fails there too."""
    model = cartesian_pendulum()
    orbit = of.find_orbit(
        of.Problem(model, of.Guess([0.2, np.sqrt(0.45), 0, 0], 1.9), of.pin(energy=-1.3 * 9.81 * 0.2))
    )
    assert of.certify(orbit, model).passed
    assert "closure" in of.certify(replace(orbit, period=orbit.period * (1 + 1e-6)), model).failures
    assert "constraint" in of.certify(replace(orbit, state=orbit.state * (1 + 1e-8)), model).failures


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"baumgarte": (0, 0)}, "baumgarte"),
        ({"state": [0.8, 0, 0, 1]}, "off the constraints"),
    ],
)
def test_bad_input_is_refused(change, words):
    """No stabilisation, and a start off the constraints: one sentence each."""
    model = cartesian_pendulum(baumgarte=change.get("baumgarte", (10, 10)))
    with pytest.raises(InputError, match=words):
        of.find_orbit(of.Problem(model, of.Guess(change.get("state", [0.7, 0, 0, 1]), 1.7)))


LONG = {"six-bar-middle-mode", "six-bar-slow-mode", "five-bar-saddle", "five-bar-fast-mode", "four-bar-drag-link",
        "four-bar-rotating"}  # fmt: skip


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=[pytest.mark.slow] if path.stem in LONG else [], id=path.stem)
        for path in sorted(FILES.glob("*.toml"))
    ],
)
def test_linkage_files_certify_and_verify(path, tmp_path):
    """`run` certifies every file in problems/linkages; `verify` agrees from orbit.json alone."""
    result = CliRunner().invoke(main, ["run", str(path), "--out", str(tmp_path), "--no-figures"])
    assert result.exit_code == 0, result.output
    result = CliRunner().invoke(main, ["verify", str(tmp_path / path.stem / "orbit.json")])
    assert result.exit_code == 0, result.output


def test_linkage_simulates():
    """`simulate` takes a linkage's file."""
    result = CliRunner().invoke(main, ["simulate", str(FILES / "four-bar-rocking.toml"), "--duration", "1", "--json"])
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("system", "guess", "words"),
    [
        ("length = [0.5, 1.2, 0.1]\nground = [0.2, 3.0]", "angles = { theta1 = 0.6 }", "cannot be assembled"),
        ("length = [0.5, 1.2, 1.0]\nground = [0.2, 1.0]", "angles = { theta4 = 0.6 }", "theta4: unknown"),
        ("length = [1.0, 2.0, 1.0]\nground = [0.0, 2.0]", "angles = { theta1 = 1.5707963267948966 }", "change-point"),
        ("length = [0.5, 1.2, 1.0]\nground = [0.2]", "angles = { theta1 = 0.6 }", "ground"),
        ("length = [0.5, 1.2, 1.0]\nground = [0.2, 1.0]", "mode = 2\namplitude = 0.1", "between 1 and 1"),
    ],
)
def test_bad_linkage_files_exit_2(system, guess, words, tmp_path):
    """A linkage that cannot be assembled, or is at a change-point: exit 2 and one sentence."""
    path = tmp_path / "bad.toml"
    path.write_text(f'[system]\nkind = "linkage"\n{system}\n[guess]\n{guess}\n', encoding="utf-8")
    result = CliRunner().invoke(main, ["run", str(path), "--out", str(tmp_path)])
    assert result.exit_code == 2, result.output
    assert words in result.output and "Traceback" not in result.output


@pytest.mark.slow
@pytest.mark.parametrize("name", ["five-bar-fast-mode", "four-bar-rocking"])
def test_a_brake_orbit_under_constraints_on_half_its_period(name):
    """Rest at both ends of T/2, on the tangent space: the orbit that the full formulation finds."""
    problem = of.load_problem(FILES / f"{name}.toml")
    half = of.find_orbit(replace(problem, symmetry="brake"))
    assert half.certificate.passed, half.certificate.failures
    assert half.symmetry == "brake" and np.abs(half.state[half.state.size // 2 :]).max() < 1e-12
    whole = of.find_orbit(problem)
    assert half.period == pytest.approx(whole.period, rel=1e-10)
    assert half.energy == pytest.approx(whole.energy, rel=1e-12)
    sizes = [np.sort(np.abs(one.floquet_multipliers)) for one in (half, whole)]
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-6)


def test_a_brake_orbit_of_the_cartesian_pendulum():
    """Its period against the elliptic integral, from a state that is 2 % off and not at rest."""
    model = of.chain_dae(1, baumgarte=of.Baumgarte(10.0, 10.0))
    state = of.linkages.maximal_states(model, np.array([1.2, 0.1]))
    problem = of.Problem(model, of.Guess(state, 1.8), of.pin(energy=-4.9 * np.cos(1.2)))
    orbit = of.find_orbit(replace(problem, symmetry="brake"))
    exact = 4 * np.sqrt(1 / 3 / 4.9) * ellipk(np.sin(0.6) ** 2)
    assert orbit.certificate.passed and orbit.period == pytest.approx(exact, rel=1e-11)
    assert of.certify(orbit).passed, "from its record alone"


def test_a_reflection_is_refused_in_redundant_coordinates():
    """x -> -x is no symmetry of joint positions; the message says what is possible."""
    model = of.chain_dae(1, baumgarte=of.Baumgarte(10.0, 10.0))
    problem = of.Problem(model, of.Guess([1.0, 0.0], 1.7))
    with pytest.raises(InputError, match="redundant coordinates.*use symmetry = 'brake' or 'none'"):
        replace(problem, symmetry="reflection")


SMALL = of.linkage([0.06, 0.18, 0.12], [0.3, 0.9, 0.6], (0.0, 0.16))
"""A four-bar of 60, 180 and 120 mm: accelerations of hundreds of rad/s^2 beside coordinates of centimetres."""


def released(angle):
    return of.linkages.linkage_state(SMALL, of.linkages.assemble(SMALL, {"theta1": angle}, branch=1))


def test_a_small_linkage_moves_from_wherever_it_is_released():
    """IDAS is not asked for forces to more digits than their linear system has: 6 of these 19 once stopped at t = 0."""
    minimal = minimal_linkage(SMALL, [1], 1)
    p = minimal.parameter_values
    for angle in np.linspace(0.3, 1.2, 19):
        end = of.linkages.simulate_dae(SMALL, released(angle), 0.3, 2).states[-1]
        expected = integrate(
            lambda t, x: np.array([x[1], float(minimal.acceleration(t, x[0], x[1], p))]), [angle, 0.0], [0.0, 0.3]
        )[-1]
        np.testing.assert_allclose(end[[2, 11]], expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.3, 0.9, 1.0, 1.2])
def test_periods_of_a_small_linkage_are_those_of_the_quadrature(angle):
    state = released(angle)
    level = energy(SMALL, state)
    orbit = of.find_orbit(of.Problem(SMALL, of.Guess(state, first_return(SMALL, state)), of.pin(energy=level)))
    assert orbit.certificate.passed
    assert orbit.period == pytest.approx(rocking_period(SMALL, level, -0.06), rel=1e-10)


SLIDER_CRANK = """
import casadi as ca
import orbitfinder as of

def make(crank=0.05, rod=0.2):
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    pin = crank * ca.vertcat(ca.cos(q[0]), ca.sin(q[0]))
    end = pin + rod * ca.vertcat(ca.cos(q[1]), ca.sin(q[1]))
    middle = (pin + end) / 2
    kinetic = (2e-4 * v[0]**2 + 0.3 * ca.sumsqr(ca.jtimes(middle, q, v)) + 1e-3 * v[1]**2 + 0.4 * v[2]**2) / 2
    potential = 250 * (q[2] - 0.24) ** 2 - 0.3 * 9.81 * middle[1]
    return of.constrained(kinetic, potential, end - ca.vertcat(q[2], 0.01), of.Symbols(q, v),
                          baumgarte=of.Baumgarte(10, 10), names=["crank", "rod", "x"], angles=[True, True, False],
                          points=ca.horzcat(ca.SX(2, 1), pin, end))
"""


@pytest.mark.slow
def test_a_constrained_system_of_a_users_own_module_goes_through_every_command(tmp_path, monkeypatch):
    """It is run, verified, drawn, animated and exported; its family is refused with the way out."""
    (tmp_path / "slider.py").write_text(SLIDER_CRANK)
    rod = np.arcsin((0.01 - 0.05 * np.sin(0.4)) / 0.2)
    state = [0.4, float(rod), float(0.05 * np.cos(0.4) + 0.2 * np.cos(rod)), 0.0, 0.0, 0.0]
    system = '[system]\nkind = "python"\nmodule = "slider"\nfunction = "make"\n'
    (tmp_path / "crank.toml").write_text(f'name = "crank"\n{system}[guess]\nstate = {state}\nperiod = 0.2568\n')
    monkeypatch.chdir(tmp_path)
    orbit = "orbits/crank/orbit.json"
    for words in ("run crank.toml --out orbits", f"verify {orbit}", f"plot {orbit}", f"animate {orbit}",
                  f"export {orbit} --to julia"):  # fmt: skip
        done = CliRunner().invoke(main, [*words.split(), "--trust"])
        assert done.exit_code == 0, done.output
    refused = CliRunner().invoke(main, ["continue", orbit, "--trust"])
    assert refused.exit_code == 2 and "minimal coordinates (lagrange)" in refused.stderr
