"""Finding orbits, against the report, the reference data, closed forms and each other."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import PRINTED, TWIN_PERIOD, pendulum_period, printed_problem, reference
from scipy.special import ellipk

from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.ipopt import Progress, SolveSettings
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.shoot import initial_nodes
from orbitfinder.problemfile.read import load_problem

PROBLEMS = Path(__file__).parents[1] / "problems"
MODES = reference("normal_modes.json")
REPORT = reference("report_orbits.json")


def mode_problem(name: str, factor: float = 1.01, **changes) -> Problem:
    """A normal mode of the reference file, started from its state times `factor`."""
    one = MODES[name]
    guess = Guess(factor * np.asarray(one["state"]), one["period"])
    return Problem(chain(one["links"]), guess, **{"pin": pin(energy=one["energy"]), "name": name, **changes})


def same_multipliers(found, wanted, tolerance: float) -> None:
    """Each wanted multiplier ([re, im]) is matched by another one of those found."""
    left = list(found)
    for re, im in wanted:
        nearest_one = min(left, key=lambda mu: abs(mu - complex(re, im)))
        left.remove(nearest_one)
        assert abs(nearest_one - complex(re, im)) <= tolerance * max(1.0, abs(complex(re, im)))
    assert not left


@pytest.mark.parametrize("name", PRINTED)
def test_the_report_orbits_are_found_from_their_printed_digits(report_orbits, name):
    """Period to 1e-10 and closure to 1e-12, certified, with the printed last component as period guess."""
    orbit = report_orbits[name]
    assert orbit.period == pytest.approx(PRINTED[name].period, abs=1e-10)
    assert orbit.closure <= 1e-12
    assert orbit.certificate.failures == ()
    assert next(check.value for check in orbit.certificate.checks if check.name == "closure") <= 1e-12


@pytest.mark.parametrize("name", PRINTED)
def test_the_report_orbits_are_those_of_the_reference(report_orbits, name):
    """Energy, period, multipliers and verdict agree with an independent Taylor integration."""
    orbit, wanted = report_orbits[name], REPORT[name]
    assert orbit.energy == pytest.approx(wanted["energy"], abs=1e-12)
    assert orbit.period == pytest.approx(wanted["period"], abs=1e-12)
    assert orbit.stability == wanted["stability"]
    same_multipliers(orbit.floquet_multipliers, wanted["floquet_multipliers"], 1e-8)
    # near the printed state, which itself closes only to 8.5e-4 for triple 2 and to 6e-6 or better for the others
    np.testing.assert_allclose(orbit.state, PRINTED[name].state, atol=2e-2 if name == "triple-2" else 1e-4)


@pytest.mark.parametrize("name", PRINTED)
def test_the_multipliers_come_in_pairs_without_the_trivial_one(report_orbits, name):
    """2n - 2 multipliers, reciprocal to 1e-8, none within 1e-6 of 1 (the reference has none there either)."""
    orbit = report_orbits[name]
    assert orbit.floquet_multipliers.size == 2 * PRINTED[name].links - 2
    assert orbit.pair_defect <= 1e-8
    assert np.abs(orbit.floquet_multipliers - 1).min() > 1e-6


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
@pytest.mark.parametrize("name", PRINTED)
def test_one_per_cent_of_error_leads_to_the_same_orbit(report_orbits, name, seed):
    """Every component and the period off by up to 1 %: the same period, or that of triple 2's twin, certified."""
    orbit = find_orbit(printed_problem(name, 0.01, seed))
    assert orbit.certificate.failures == ()
    assert orbit.closure <= 1e-12
    periods = [PRINTED[name].period] + ([TWIN_PERIOD] if name == "triple-2" else [])
    assert min(abs(orbit.period - period) for period in periods) <= 1e-10
    if orbit.period == pytest.approx(PRINTED[name].period, abs=1e-9):
        assert orbit.action == pytest.approx(report_orbits[name].action, rel=1e-10)


@pytest.mark.parametrize("amplitude", [0.1, 1.0, 2.0, 3.0])
def test_the_single_pendulum_has_the_period_of_the_elliptic_integral(amplitude):
    """Period to 1e-12 relative of 4 K(sin^2(a/2)) / w0, from a guess 2 % off, pinned by energy."""
    exact = pendulum_period(amplitude)
    guess = Guess([amplitude, 0.0], 1.02 * exact)
    orbit = find_orbit(Problem(chain(1), guess, pin=pin(energy=-4.9 * np.cos(amplitude))))
    assert orbit.period == pytest.approx(exact, rel=1e-12)
    assert orbit.certificate.failures == ()
    assert orbit.symmetry == "brake+reflection" and orbit.floquet_multipliers.size == 0


@pytest.mark.parametrize("symmetry", ["brake", "reflection", "brake+reflection"])
def test_the_symmetric_formulations_have_the_exact_period_too(symmetry):
    """Half and quarter periods of the single pendulum at 2 rad give the elliptic integral as well."""
    exact, level = pendulum_period(2.0), -4.9 * np.cos(2.0)
    state = [0.0, np.sqrt(6 * (level + 4.9))] if symmetry == "reflection" else [2.0, 0.0]
    orbit = find_orbit(Problem(chain(1), Guess(state, 1.02 * exact), pin=pin(energy=level), symmetry=symmetry))
    assert orbit.period == pytest.approx(exact, rel=1e-12)
    assert orbit.certificate.failures == ()


@pytest.mark.parametrize("turns", [1, -1])
def test_a_running_pendulum_has_its_exact_period(turns):
    """Over the top at 8 J: T = 4 K(m) / sqrt(2 (E + mgd) / I), m = 2 mgd / (E + mgd), in either direction."""
    lift = 8.0 + 4.9
    exact = 4 * ellipk(2 * 4.9 / lift) / np.sqrt(6 * lift)
    guess = Guess([0.0, turns * np.sqrt(6 * lift)], 1.02 * exact)
    orbit = find_orbit(Problem(chain(1), guess, pin=pin(energy=8.0), winding=(turns,)))
    assert orbit.period == pytest.approx(exact, rel=1e-12)
    assert orbit.winding == (turns,)
    assert orbit.certificate.failures == ()


@pytest.mark.parametrize("winding", [(-1,), None])
def test_a_running_pendulum_in_half_its_period(winding):
    """Reversal: from hanging to upright and on; turns are given or the guess's; the start is moved there."""
    lift = 8.0 + 4.9
    exact = 4 * ellipk(2 * 4.9 / lift) / np.sqrt(6 * lift)
    guess = Guess([0.7, -np.sqrt(6 * (8.0 + 4.9 * np.cos(0.7)))], 1.02 * exact)
    orbit = find_orbit(Problem(chain(1), guess, pin=pin(energy=8.0), symmetry="reversal", winding=winding))
    assert orbit.period == pytest.approx(exact, rel=1e-12)
    assert orbit.winding == (-1,) and orbit.symmetry == "reversal"
    assert orbit.state[0] % np.pi == pytest.approx(0.0, abs=1e-12)
    assert orbit.certificate.failures == ()


def test_the_second_report_orbit_in_half_its_period():
    """triple-2 with its symmetry imposed: the period of the general formulation to 1e-10, its multipliers to 1e-9."""
    imposed = load_problem(PROBLEMS / "examples" / "triple-reversal.toml")
    orbit, general = find_orbit(imposed), find_orbit(replace(imposed, symmetry="none"))
    assert orbit.certificate.failures == () and orbit.symmetry == general.symmetry == "reversal"
    assert orbit.period == pytest.approx(general.period, abs=1e-10)
    same_multipliers(orbit.floquet_multipliers, [(mu.real, mu.imag) for mu in general.floquet_multipliers], 1e-9)
    assert np.abs(orbit.state[:3]).max() < 1e-12
    assert len(initial_nodes(imposed, build_flow(chain(3)), SolveSettings())) < len(general.nodes)


def test_a_trajectory_as_the_guess_of_an_odd_motion():
    """Of a recorded motion the instant is taken at which it passes the hanging position."""
    lift = 8.0 + 4.9
    exact = 4 * ellipk(2 * 4.9 / lift) / np.sqrt(6 * lift)
    state = [0.7, np.sqrt(6 * (8.0 + 4.9 * np.cos(0.7)))]
    whole = find_orbit(Problem(chain(1), Guess(state, exact), pin=pin(energy=8.0)))
    guess = Guess(whole.state, whole.period, whole.times, whole.samples)
    orbit = find_orbit(Problem(chain(1), guess, pin=pin(energy=8.0), symmetry="reversal"))
    assert orbit.period == pytest.approx(exact, rel=1e-12) and orbit.winding == (1,)


def test_an_odd_motion_of_a_linkage_is_refused():
    """In redundant coordinates q -> -q moves the joints."""
    problem = load_problem(PROBLEMS / "linkages" / "five-bar-slow-mode.toml")
    with pytest.raises(InputError, match="'reversal' cannot be imposed in redundant coordinates"):
        replace(problem, symmetry="reversal")


def test_an_odd_motion_of_a_system_with_a_second_invariant():
    """A free double pendulum (no gravity): where it starts fixes its turning too, so nothing is unfolded."""
    free = chain(2, gravity=0.0)
    guess = Guess([0.0, 0.0, 0.0, 3.0], 2.2)
    orbit = find_orbit(Problem(free, guess, pin=pin(energy=1.5), symmetry="reversal"))
    assert orbit.certificate.failures == () and orbit.winding == (0, 1) and orbit.symmetry == "reversal"
    general = find_orbit(Problem(free, Guess(orbit.state, 1.001 * orbit.period), pin=pin(energy=1.5), winding=(0, 1)))
    assert general.period == pytest.approx(orbit.period, abs=1e-10)


FEW = ["triple-mode-1-E0.1", "triple-mode-2-E6", "triple-mode-3-E20", "quadruple-mode-2-E1", "quadruple-mode-4-E20"]
UNSTABLE = ["triple-mode-2-E20", "quadruple-mode-2-E20"]
"""Multipliers of 1e3 and 4e4: one per cent off is outside the basin of the full formulation."""
ALL = [pytest.param(name, marks=() if name in FEW else pytest.mark.slow) for name in MODES]


@pytest.mark.parametrize("name", ALL)
def test_the_normal_modes_of_the_reference_are_found(name):
    """From a state 1 % off at the reference's energy: its period to 1e-11, its verdict and its multipliers."""
    orbit, wanted = find_orbit(mode_problem(name, 1.0 if name in UNSTABLE else 1.01)), MODES[name]
    assert orbit.certificate.failures == ()
    assert orbit.period == pytest.approx(wanted["period"], abs=1e-11)
    assert orbit.energy == pytest.approx(wanted["energy"], abs=1e-11)
    assert orbit.stability == wanted["stability"]
    same_multipliers(orbit.floquet_multipliers, wanted["floquet_multipliers"], 1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODES)
def test_the_quarter_period_finds_every_normal_mode(name):
    """By brake and reflection symmetry all modes are found from 1 % off, the most unstable ones included."""
    orbit, wanted = find_orbit(mode_problem(name, symmetry="brake+reflection")), MODES[name]
    assert orbit.certificate.failures == ()
    assert orbit.period == pytest.approx(wanted["period"], abs=1e-11)
    assert orbit.stability == wanted["stability"]


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_a_swing_about_the_upright_position_is_found_in_every_formulation(symmetry):
    """With gravity reversed the pendulum swings about pi; symmetric rows are shifted there, the period is the same."""
    exact, level = pendulum_period(1.0), -4.9 * np.cos(1.0)
    state = [np.pi, np.sqrt(6 * (level + 4.9))] if symmetry == "reflection" else [np.pi + 1.0, 0.0]
    problem = Problem(chain(1, gravity=-9.8), Guess(state, 1.02 * exact), pin=pin(energy=level), symmetry=symmetry)
    orbit = find_orbit(problem)
    assert orbit.period == pytest.approx(exact, rel=1e-12)
    assert orbit.certificate.failures == () and orbit.symmetry == "brake+reflection"
    assert np.mean([orbit.samples[:, 0].min(), orbit.samples[:, 0].max()]) == pytest.approx(np.pi, abs=1e-3)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_the_formulations_agree(symmetry):
    """One normal mode in all four formulations: the same period, action, multipliers, and whole-period nodes."""
    orbit = find_orbit(mode_problem("triple-mode-2-E6", symmetry=symmetry))
    wanted = MODES["triple-mode-2-E6"]
    assert orbit.certificate.failures == ()
    assert orbit.symmetry == "brake+reflection"
    assert orbit.period == pytest.approx(wanted["period"], abs=1e-12)
    same_multipliers(orbit.floquet_multipliers, wanted["floquet_multipliers"], 1e-7)
    flow, count = build_flow(chain(3)), len(orbit.nodes)
    problem = Problem(chain(3), Guess(orbit.state, orbit.period), segments=count)
    np.testing.assert_allclose(orbit.nodes, initial_nodes(problem, flow, SolveSettings()), atol=1e-8)


def test_the_lagrange_formulation_finds_the_same_orbit(report_orbits):
    """Equations derived by Lagrange instead of the recursion: the same period, action and closure."""
    problem = printed_problem("triple-1")
    orbit = find_orbit(replace(problem, model=chain(3, formulation="lagrange")))
    assert orbit.system["formulation"] == "lagrange"
    assert orbit.period == pytest.approx(report_orbits["triple-1"].period, abs=1e-12)
    assert orbit.action == pytest.approx(report_orbits["triple-1"].action, rel=1e-11)
    assert orbit.certificate.failures == ()


def test_twice_round_is_reduced_to_the_minimal_period():
    """A guess of twice the period ends as an orbit of the minimal one, certified as such."""
    one = MODES["triple-mode-1-E6"]
    problem = mode_problem("triple-mode-1-E6", 1.001)
    orbit = find_orbit(replace(problem, guess=Guess(problem.guess.state, 2 * one["period"])))
    assert orbit.period == pytest.approx(one["period"], abs=1e-11)
    assert orbit.certificate.failures == ()
    same_multipliers(orbit.floquet_multipliers, one["floquet_multipliers"], 1e-7)


def test_three_times_round_a_running_orbit_is_reduced_with_its_winding():
    """A running pendulum three times over the top is reduced to one turn."""
    lift = 8.0 + 4.9
    exact = 4 * ellipk(2 * 4.9 / lift) / np.sqrt(6 * lift)
    problem = Problem(chain(1), Guess([0.0, np.sqrt(6 * lift)], 3 * exact), pin=pin(energy=8.0), winding=(3,))
    orbit = find_orbit(problem)
    assert orbit.winding == (1,)
    assert orbit.period == pytest.approx(exact, rel=1e-12)


def distance(orbit, nodes: np.ndarray, period: float) -> float:
    """Squared distance from the guess in the solver's words: angles in rad, rates by the guess's clock, period."""
    n, clock = nodes.shape[1] // 2, period / (2 * np.pi)
    off = orbit.nodes - nodes
    spread = np.sum(off[:, :n] ** 2) + clock**2 * np.sum(off[:, n:] ** 2)
    return float(spread / len(nodes) + (orbit.period / period - 1) ** 2)


def test_without_a_pin_the_orbit_is_the_nearest_one():
    """No neighbour in the family, 1 % up or down in energy, is nearer to the guess than what no pin finds."""
    one = MODES["triple-mode-1-E1"]
    guess = Guess(1.05 * np.asarray(one["state"]), 1.02 * one["period"])
    problem = Problem(chain(3), guess, pin=(), segments=8)
    orbit = find_orbit(problem)
    assert orbit.certificate.failures == ()
    nodes = initial_nodes(problem, build_flow(problem.model), SolveSettings())
    found = distance(orbit, nodes, guess.period)
    hanging = -44.1
    for factor in (0.99, 1.01):
        level = hanging + factor * (orbit.energy - hanging)
        neighbour = find_orbit(replace(problem, pin=pin(energy=level)))
        assert distance(neighbour, nodes, guess.period) > found


def test_the_nearest_orbit_to_an_orbit_is_itself(report_orbits):
    """Started on an orbit without a pin, the search stays there."""
    orbit = report_orbits["quadruple-2"]
    again = find_orbit(Problem(chain(4), Guess(orbit.state, orbit.period)))
    np.testing.assert_allclose(again.state, orbit.state, atol=1e-8)
    assert again.period == pytest.approx(orbit.period, abs=1e-8)


def test_a_freed_length_reaches_a_prescribed_period():
    """Pinned at T = 3 s with length3 free: the period exactly, the new length in the orbit's own description."""
    problem = mode_problem("triple-mode-1-E0.1", 3.0, pin=pin(period=3.0), free=("length3",))
    orbit = find_orbit(problem)
    assert orbit.period == pytest.approx(3.0, abs=1e-14)
    assert orbit.system["length"][:2] == [1.0, 1.0] and orbit.system["length"][2] > 1.05
    assert orbit.certificate.failures == ()
    assert certify(replace(orbit, certificate=None)).passed  # rebuilt from the description alone
    assert problem.model.system["length"] == [1.0, 1.0, 1.0]


def test_a_freed_length_under_two_pins_has_both():
    """Energy above hanging and period prescribed together, with the length that makes both possible."""
    one = MODES["triple-mode-1-E0.1"]
    problem = mode_problem(
        "triple-mode-1-E0.1", 2.0, pin=pin(period=one["period"] * 1.01, theta1=0.1), free=("length2",)
    )
    orbit = find_orbit(problem)
    assert orbit.period == pytest.approx(1.01 * one["period"], abs=1e-13)
    assert orbit.state[0] == pytest.approx(0.1, abs=1e-13)
    assert orbit.certificate.failures == ()


@pytest.mark.parametrize("name", ["theta1", "theta2dot"])
def test_a_state_component_can_be_pinned(name, report_orbits):
    """A pinned angle or rate is met exactly, and the orbit has the rest of its family's numbers."""
    orbit = report_orbits["quadruple-1"]
    model = chain(4)
    k = model.state_index(name)
    again = find_orbit(Problem(model, Guess(orbit.state, orbit.period), pin=pin(**{name: 1.01 * orbit.state[k]})))
    assert again.state[k] == pytest.approx(1.01 * orbit.state[k], abs=1e-13)
    assert again.certificate.failures == ()


def test_a_damped_driven_oscillator_has_its_linear_response():
    """x'' + 0.1 x' + x = cos 2t settles to the textbook's amplitude and phase, with multipliers e^(lambda T)."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    symbols = Symbols(q, v, time=t, forcing_period=np.pi)
    model = lagrange(0.5 * v**2, 0.5 * q**2, symbols, forces=ca.cos(2 * t) - 0.1 * v)
    orbit = find_orbit(Problem(model, Guess([0.5, 0.5], 3.0)), SolveSettings(with_certificate=False))
    response = 1 / (1 - 4 + 0.2j)
    np.testing.assert_allclose(orbit.state, [response.real, -2 * response.imag], atol=1e-12)
    assert orbit.period == pytest.approx(np.pi, abs=1e-14)
    rate = complex(-0.05, np.sqrt(1 - 0.05**2))
    same_multipliers(orbit.floquet_multipliers, [[(m := np.exp(rate * np.pi)).real, m.imag], [m.real, -m.imag]], 1e-9)
    assert orbit.stability == "asymptotically stable"
    assert certify(orbit, model).failures == ()


def test_the_van_der_pol_oscillator_has_its_known_period():
    """mu = 1: the limit cycle's period 6.6632868593231 (M. Urabe; Andersen and Geer 1982), isolated, no pin."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(0.5 * v**2, 0.5 * q**2, Symbols(q, v), forces=(1 - q**2) * v)
    orbit = find_orbit(Problem(model, Guess([2.0, 0.0], 6.5)))
    assert orbit.period == pytest.approx(6.6632868593231, abs=1e-11)
    assert orbit.certificate.failures == ()
    assert orbit.stability == "asymptotically stable" and orbit.floquet_multipliers.size == 1


def test_an_unsolvable_search_says_why(capfd):
    """Too few iterations: ConvergenceError, one sentence with defect, segment, period and advice; silent."""
    with pytest.raises(ConvergenceError) as caught:
        find_orbit(printed_problem("triple-2", 0.01, 1), SolveSettings(max_iterations=1))
    message = str(caught.value)
    for said in ("no orbit found", "largest defect", "segment", "period", "; try"):
        assert said in message
    assert len(message.splitlines()) == 1
    assert capfd.readouterr() == ("", "")


def test_a_period_that_no_swing_has_never_certifies():
    """No swinging pendulum has a period below 2 pi / w0: the search fails, or what it finds is not certified."""
    problem = Problem(chain(1), Guess([1.0, 0.0], 1.2), pin=pin(period=1.2))
    try:
        orbit = find_orbit(problem)
    except ConvergenceError as error:
        assert "no orbit found" in str(error)
    else:
        assert "not_equilibrium" in orbit.certificate.failures


def test_progress_is_reported():
    """The callback gets every iteration and the end, with shrinking defects and growing time."""
    events: list[Progress] = []
    orbit = find_orbit(printed_problem("quadruple-1", 0.01), progress=events.append)
    shooting = [event for event in events if event.stage == "shooting"]
    assert len(shooting) >= 2 and [event.iteration for event in shooting] == list(range(len(shooting)))
    assert shooting[-1].defect < 1e-8 < shooting[0].defect
    assert events[-1].stage == "certificate"
    assert events[-1].period == orbit.period and events[-1].defect == orbit.closure
    elapsed = [event.elapsed for event in events]
    assert elapsed == sorted(elapsed) and elapsed[-1] > 0


def test_a_search_prints_nothing(capfd):
    """A successful search leaves both streams empty."""
    find_orbit(printed_problem("quadruple-2"))
    assert capfd.readouterr() == ("", "")


def test_the_orbit_carries_its_provenance_and_a_whole_period(report_orbits):
    """Versions, tolerances, guess and pin are recorded; samples begin at the state and end one period later."""
    orbit = report_orbits["triple-1"]
    assert orbit.provenance["casadi"] == ca.__version__
    assert orbit.provenance["guess"]["state"] == list(PRINTED["triple-1"].state)
    assert orbit.provenance["pin"] == {"energy": energy(chain(3), PRINTED["triple-1"].state)}
    np.testing.assert_array_equal(orbit.samples[0], orbit.state)
    np.testing.assert_allclose(orbit.samples[-1], orbit.state, atol=1e-10)
    assert (orbit.times[0], orbit.times[-1]) == (0.0, orbit.period)
    assert len(orbit.times) == len(orbit.samples) >= 200


def test_no_certificate_is_made_when_none_is_wanted():
    """with_certificate=False returns the orbit alone."""
    orbit = find_orbit(printed_problem("quadruple-2"), SolveSettings(with_certificate=False))
    assert orbit.certificate is None
    assert certify(orbit).passed
