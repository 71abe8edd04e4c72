"""Warm refinement: the orbits that find_orbit finds, in every formulation, compiled and interpreted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import PRINTED, dop853, pendulum_period, printed_problem

import orbitfinder as of
from orbitfinder.errors import ConvergenceError, CountError, InputError, IntegrationError
from orbitfinder.integrate.compiled import available, compiling
from orbitfinder.integrate.march import uniform
from orbitfinder.loops import condensed as elimination
from orbitfinder.loops.condensed import Linearised, eliminated
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.newton import NewtonSettings
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.refine import Refined, Refiner

PROBLEMS = Path(__file__).parents[1] / "problems"


@pytest.fixture(autouse=True)
def interpreted():
    """No compiler needed, except where a test asks for one."""
    with compiling("off"):
        yield


def closure(refiner: Refiner, found: Refined) -> float:
    """Largest gap round the loop by the independent integrator; for whole periods only."""
    end = dop853(refiner.flow, found.state, [0.0, found.period], np.zeros(found.unfolding.size), found.free)[-1]
    shift = np.concatenate([2 * np.pi * found.turns, np.zeros(found.turns.size)])
    return float(np.abs(end - found.state - shift).max())


@pytest.mark.parametrize("name", PRINTED)
def test_report_orbits_from_the_printed_digits(name):
    """Period to round-off, closure at most 1e-13 by DOP853, the unfolding back at 0."""
    refiner = Refiner(printed_problem(name))
    found = refiner.refine()
    assert abs(found.period - PRINTED[name].period) < 1e-13
    assert closure(refiner, found) < 1e-13 and found.residual < 1e-13
    assert np.abs(found.unfolding).max() < 1e-13
    assert energy(refiner.problem.model, found.state) == pytest.approx(refiner.problem.pin[0].value, abs=1e-13)


@pytest.mark.skipif(not available()[0], reason="no C compiler")
def test_compiled_and_interpreted_agree(tmp_path, monkeypatch):
    monkeypatch.setenv("ORBITFINDER_CACHE", str(tmp_path))
    problem = replace(printed_problem("triple-2"), segments=8)
    plain = Refiner(problem).refine()
    with compiling("on"):
        fast = Refiner(problem)
        found = fast.refine()
    march = fast.equations.march
    assert all(march._kernels[varied] is not None for varied in (False, True))
    # Both close to round-off, by kernels that differ from processor to processor. What that leaves of a difference is
    # the closures through the inverse of (monodromy - 1), whose least factor is 2 - 2 cos(angle) = 0.0335 of the
    # multipliers 0.983 +- 0.182i.
    width = (closure(fast, found) + closure(Refiner(problem), plain)) / 0.0335
    assert width < 1e-11
    np.testing.assert_allclose(found.state, plain.state, rtol=0, atol=width)
    assert abs(found.period - plain.period) < width


@pytest.mark.parametrize("seed", range(3))
def test_guesses_one_refiner(seed):
    """The same refiner takes guess after guess, and other energies."""
    refiner = Refiner(printed_problem("triple-1"))
    guess = printed_problem("triple-1", noise=2e-3, seed=seed).guess
    found = refiner.refine(guess)
    assert abs(found.period - PRINTED["triple-1"].period) < 1e-12
    level = refiner.problem.pin[0].value + 0.05
    other = refiner.refine(Guess(found.state, found.period), of.pin(energy=level))
    assert energy(refiner.problem.model, other.state) == pytest.approx(level, abs=1e-12)
    assert closure(refiner, other) < 1e-13


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@pytest.mark.parametrize("segments", [1, 3])
def test_every_formulation_has_the_exact_period(symmetry, segments):
    """The single pendulum at 2 rad, by the elliptic integral."""
    exact, level = pendulum_period(2.0), -4.9 * np.cos(2.0)
    state = [0.0, np.sqrt(6 * (level + 4.9))] if symmetry in ("reflection", "reversal") else [2.0, 0.0]
    problem = Problem(chain(1), Guess(state, 1.02 * exact), pin=pin(energy=level), symmetry=symmetry, segments=segments)
    found = Refiner(problem).refine()
    assert abs(found.period - exact) < 1e-13 and found.nodes.shape == (segments, 2)


@pytest.mark.parametrize("symmetry", ["none", "reversal"])
def test_running_orbit_and_its_turns(symmetry):
    """Whole turns are taken from the guess's motion where the problem does not say."""
    speed = np.sqrt(6 * (8.0 + 4.9))
    refiner = Refiner(Problem(chain(1), Guess([0.0, speed], 0.86), pin=pin(energy=8.0), symmetry=symmetry))
    found = refiner.refine()
    assert found.turns.tolist() == [1] and closure(refiner, found) < 1e-13


@pytest.mark.parametrize("name", ["gallery/van-der-pol", "gallery/forced-duffing-lower", "gallery/henon-heiles-loop"])
@pytest.mark.parametrize("segments", [1, 4])
def test_isolated_driven_and_foreign_systems(name, segments):
    problem = of.load_problem(PROBLEMS / f"{name}.toml")
    value, tolerance = problem.expected["period"]
    refiner = Refiner(replace(problem, segments=segments))
    assert abs(refiner.refine().period - value) < tolerance


def test_two_invariants():
    """Without gravity angular momentum is conserved too: two unfoldings, a second phase condition, one pin."""
    model = chain(2, gravity=0.0)
    guess = Guess([-0.28, 0.44, -0.79, 2.41], 2.65)
    refiner = Refiner(Problem(model, guess, pin=pin(period=2.65), winding=(0, 1)))
    found = refiner.refine()
    assert found.unfolding.shape == (2,) and np.abs(found.unfolding).max() < 1e-14
    assert closure(refiner, found) < 1e-12 and found.turns.tolist() == [0, 1]


def test_freed_parameter_reaches_a_prescribed_period():
    free = Problem(chain(1), Guess([1.0, 0.0], 1.8), pin=pin(theta1=1.0, period=2.0), free=("length1",))
    found = Refiner(free).refine()
    assert found.period == pytest.approx(2.0, abs=1e-14)
    assert found.free.shape == (1,) and closure(Refiner(free), found) < 1e-13
    orbit = Refiner(free).orbit(found)
    assert orbit.certificate.passed and orbit.system["length"] == [found.free[0]]


def test_unstable_orbit_gets_more_segments():
    """A multiplier of some 1e5: the coarse march is far off and the Jacobian is renewed at a finer one."""
    problem = of.load_problem(PROBLEMS / "examples" / "triple-mode-2-strong.toml")
    refiner = Refiner(problem)
    assert refiner.segments > 1
    assert abs(refiner.refine().period - problem.expected["period"][0]) < problem.expected["period"][1]


@pytest.mark.skipif(not available()[0], reason="no C compiler")
def test_segments_side_by_side_lose_no_reach():
    """Where eight segments lead astray, the fewest that the motion needs are tried."""
    problem = of.load_problem(PROBLEMS / "examples" / "triple-mode-2-strong.toml")
    fewest = Refiner(problem)
    with compiling("on"):
        refiner = Refiner(problem)
    assert (fewest.segments, refiner.segments) == (2, 8)
    with pytest.raises(ConvergenceError, match="for 8 segments"):
        Refiner(replace(problem, segments=8)).refine()
    found = refiner.refine()
    assert len(found.nodes) == 2 and found.period == pytest.approx(problem.expected["period"][0], abs=1e-12)


def test_elimination_of_a_singular_system_is_by_least_squares():
    """A direction that no row sees is not moved along, although round-off makes no pivot 0."""
    random = np.random.default_rng(3)
    blind = random.normal(size=(6, 4)) @ (np.eye(4) - np.full((4, 4), 0.25))
    system = Linearised(np.eye(4)[None], np.zeros((1, 4, 2)), blind, np.zeros((6, 4)), random.normal(size=(6, 2)))
    exact = random.normal(size=6)
    exact[:4] -= exact[:4].mean()
    step = eliminated(system)(system.matrix() @ exact)
    np.testing.assert_allclose(step, -exact, atol=1e-9)


def test_orbit_is_certified():
    refiner = Refiner(printed_problem("quadruple-2"))
    found = refiner.refine()
    orbit = refiner.orbit(found)
    assert orbit.certificate is not None and orbit.certificate.passed and orbit.closure < 1e-13
    assert orbit.period == found.period and refiner.orbit(found, with_certificate=False).certificate is None


def test_guess_with_a_trajectory():
    """Nodes are sampled from it."""
    plain = Refiner(printed_problem("triple-1"))
    found = plain.refine()
    times = np.linspace(0, found.period, 201)
    states = dop853(plain.flow, found.state, times, [0.0])
    problem = Problem(
        plain.problem.model, Guess(found.state, found.period, times, states), plain.problem.pin, segments=5
    )
    assert abs(Refiner(problem).refine().period - found.period) < 1e-13


# ---- derivatives and the linear system -------------------------------------------------------------


@pytest.mark.parametrize("name", ["gallery/forced-duffing-lower", "report/triple-1"])
def test_derivatives_of_the_march(name):
    """Ends by nodes, period (the clock of a driven system included) and unfolding, against central differences."""
    problem = of.load_problem(PROBLEMS / f"{name}.toml")
    equations = Equations(problem.model, problem.boundary)
    march, mesh = equations.march, uniform(problem.boundary.fraction, 3, 40)
    tail = equations.unknowns(np.zeros((3, equations.size)), problem.guess.period, mesh).tail
    nodes = march.states(np.asarray(problem.guess.state)[None], mesh, tail)[:-1:40]
    system = march.varied(nodes, mesh, tail)
    for k in range(tail.size):
        step = np.zeros(tail.size)
        step[k] = 1e-5
        ends = [march.ends(nodes, mesh, tail + sign * step) for sign in (1, -1)]
        np.testing.assert_allclose(system.columns[:, :, k], (ends[0] - ends[1]) / 2e-5, atol=2e-7)
    for k in range(nodes.shape[1]):
        step = np.zeros_like(nodes)
        step[:, k] = 1e-5
        ends = [march.ends(nodes + sign * step, mesh, tail) for sign in (1, -1)]
        np.testing.assert_allclose(system.transitions[:, :, k], (ends[0] - ends[1]) / 2e-5, atol=2e-7)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_elimination_solves_the_whole_system(count, monkeypatch):
    """Condensed and whole, the step satisfies every equation."""
    random = np.random.default_rng(count)
    system = Linearised(
        random.normal(size=(count, 4, 4)), random.normal(size=(count, 4, 2)),
        random.normal(size=(6, 4)), random.normal(size=(6, 4)), random.normal(size=(6, 2)),
    )  # fmt: skip
    defects, rows = random.normal(size=(count - 1, 4)), random.normal(size=6)
    whole = np.concatenate([defects.ravel(), rows])
    steps = [eliminated(system)(whole)]
    monkeypatch.setattr(elimination, "LARGEST_PRODUCT", 0.0)
    steps.append(eliminated(system)(whole))
    for step in steps:
        nodes, tail = step[: 4 * count].reshape(count, 4), step[4 * count :]
        np.testing.assert_allclose(system.matrix() @ step, -whole, atol=1e-10)
        ends = np.einsum("kij,kj->ki", system.transitions, nodes) + system.columns @ tail
        np.testing.assert_allclose(ends[:-1] - nodes[1:], -defects, atol=1e-10)
        np.testing.assert_allclose(
            system.first @ nodes[0] + system.last @ ends[-1] + system.tail @ tail, -rows, atol=1e-10
        )
    np.testing.assert_allclose(steps[0], steps[1], atol=1e-9)


# ---- what it refuses -------------------------------------------------------------------------------


def test_without_a_pin_it_says_what_is_missing():
    with pytest.raises(CountError, match=r"leave 1 to choose; warm refinement needs as many pins"):
        Refiner(Problem(chain(1), Guess([1.0, 0.0], 1.8)))


def test_bounds_are_for_find_orbit():
    problem = Problem(chain(1), Guess([1.0, 0.0], 1.8), pin=pin(theta1=1.0), bounds={"period": (1.0, 2.0)})
    with pytest.raises(InputError, match="bounds: warm refinement knows pins only; use find_orbit"):
        Refiner(problem)


def test_other_pins_need_another_refiner():
    refiner = Refiner(Problem(chain(1), Guess([1.0, 0.0], 1.8), pin=pin(theta1=1.0)))
    with pytest.raises(InputError, match="pin: this refiner was built for pins of theta1, got energy"):
        refiner.refine(pin=pin(energy=-1.0))


@pytest.mark.parametrize(
    ("state", "period", "said"),
    [
        ([1.0], 1.8, "guess.state: need 2 finite numbers"),
        ([1.0, np.nan], 1.8, "guess.state: need 2 finite numbers"),
        ([1.0, 0.0], -1.0, "guess.period: must be positive and finite, got -1.0"),
        ([1.0, 0.0], np.inf, "guess.period: must be positive and finite, got inf"),
    ],
)
def test_bad_guesses(state, period, said):
    refiner = Refiner(Problem(chain(1), Guess([1.0, 0.0], 1.8), pin=pin(theta1=1.0)))
    with pytest.raises(InputError, match=said):
        refiner.refine(Guess(state, period))


def test_hopeless_guess():
    """No swing of this pendulum has so short a period."""
    refiner = Refiner(Problem(chain(1), Guess([1.0, 0.0], 0.3), pin=pin(period=0.3)))
    with pytest.raises(ConvergenceError, match=r"does not converge from this guess|ended at an equilibrium"):
        refiner.refine()


def test_equilibrium_is_no_orbit():
    refiner = Refiner(Problem(chain(1), Guess([1e-9, 0.0], 1.5), pin=pin(period=1.5)))
    with pytest.raises(ConvergenceError, match="ended at an equilibrium"):
        refiner.refine()


def test_motion_that_cannot_be_integrated():
    refiner = Refiner(printed_problem("triple-1"))
    with pytest.raises(IntegrationError, match=r"segment 0.*the state is not finite"):
        refiner.refine(Guess(1e9 * np.ones(6), 1.6))


def test_stalled():
    """Settings that allow no accuracy are named as such."""
    refiner = Refiner(printed_problem("triple-1"), NewtonSettings(converged=1e-20))
    with pytest.raises(ConvergenceError, match="stalled at a residual of"):
        refiner.refine()
