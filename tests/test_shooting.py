"""The shooting program: its derivatives, its regularity, the Hessian handed to IPOPT."""

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from conftest import PRINTED, dop853, printed_problem, reference

from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.ipopt import SolveSettings, hessian
from orbitfinder.loops.polish import polish, residual
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.shooting import Shooting, transcribe
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.shoot import at_section, initial_nodes
from orbitfinder.systems import FUNCTIONS


def shoot(problem: Problem) -> Shooting:
    """The program of a problem started from its simulated guess."""
    flow = build_flow(problem.model, problem.free, problem.boundary.unfolded(problem.model))
    return transcribe(problem, initial_nodes(problem, flow, SolveSettings()), flow)


def independent_residual(shooting: Shooting, w: np.ndarray) -> np.ndarray:
    """All rows with every segment integrated by SciPy's DOP853."""
    found = shooting.at(w)
    duration = found.period * shooting.problem.boundary.fraction / len(found.nodes)
    ends = [
        dop853(shooting.flow, node, [k * duration, (k + 1) * duration], found.unfolding, found.free)[-1]
        for k, node in enumerate(found.nodes)
    ]
    return shooting.rows(w, np.stack(ends).T).full().ravel()


FREED = ((), ("length2",), ("gravity", "mass1"))


@pytest.mark.parametrize(
    ("symmetry", "free"),
    [
        pytest.param(name, free, marks=[pytest.mark.slow] * (free != () and (name, free) != ("none", FREED[2])))
        for name in SYMMETRIES for free in FREED
    ],
)  # fmt: skip
def test_the_jacobian_agrees_with_finite_differences(symmetry, free):
    """Away from any solution, every entry of dg/dw equals the difference of DOP853 residuals to 1e-7."""
    model = chain(2, [1.0, 0.8])
    third = "theta1dot" if symmetry == "reversal" else "theta1"
    pins = dict(list({"energy": -15.0, "period": 1.9, third: 0.5}.items())[: 1 + len(free)])
    guess = Guess([0.6, -0.2, 0.3, 0.5], 1.7)
    shooting = shoot(Problem(model, guess, pin=pin(**pins), symmetry=symmetry, free=free, segments=2))
    random = np.random.default_rng(0)
    w = shooting.start + 0.05 * random.normal(size=shooting.start.size)
    found = shooting.jacobian(w).full()
    assert found.shape == (shooting.start.size,) * 2
    h = 2e-3
    for k, step in enumerate(h * np.eye(w.size)):
        near = independent_residual(shooting, w + step) - independent_residual(shooting, w - step)
        far = independent_residual(shooting, w + 2 * step) - independent_residual(shooting, w - 2 * step)
        np.testing.assert_allclose(found[:, k], (8 * near - far) / (12 * h), atol=1e-7)


def test_the_jacobian_without_gravity_agrees_with_finite_differences():
    """Two unfoldings and two phase conditions have the right derivatives as well."""
    problem = Problem(
        chain(2, gravity=0.0), Guess([0.4, -0.2, 1.0, 0.5], 1.7), pin=pin(angular_momentum=1.0), segments=1
    )
    shooting = shoot(problem)
    w = shooting.start + 0.05 * np.random.default_rng(1).normal(size=shooting.start.size)
    h = 2e-3
    columns = []
    for step in h * np.eye(w.size):
        near = independent_residual(shooting, w + step) - independent_residual(shooting, w - step)
        far = independent_residual(shooting, w + 2 * step) - independent_residual(shooting, w - 2 * step)
        columns.append((8 * near - far) / (12 * h))
    np.testing.assert_allclose(shooting.jacobian(w).full(), np.stack(columns, axis=1), atol=1e-7)


def test_the_residual_of_the_polish_is_that_of_dop853():
    """The polish's own eighth-order march and DOP853 give the same rows to 1e-12."""
    shooting = shoot(printed_problem("quadruple-1", 0.01))
    w = shooting.start
    np.testing.assert_allclose(residual(shooting, shooting.at(w)), independent_residual(shooting, w), atol=1e-12)


@pytest.fixture(scope="module")
def solved() -> tuple[Shooting, np.ndarray]:
    """The program of a normal mode of the triple pendulum and its solution w."""
    one = reference("normal_modes.json")["triple-mode-2-E6"]
    model = chain(3)
    problem = Problem(model, Guess(one["state"], one["period"]), pin=pin(energy=one["energy"]), segments=3)
    shooting = shoot(problem)
    return shooting, polish(shooting, shooting.start)


def test_newtons_method_converges_quadratically(solved):
    """On the square unfolded system the error of plain Newton squares at every step, from 1e-3 to round-off."""
    shooting, exact = solved
    w = exact + 1e-3 * np.random.default_rng(3).normal(size=exact.size)
    errors = [np.abs(w - exact).max()]
    while errors[-1] > 1e-11 and len(errors) < 8:
        w = w - np.linalg.solve(shooting.jacobian(w).full(), residual(shooting, shooting.at(w)))
        errors.append(np.abs(w - exact).max())
    assert errors[-1] <= 1e-11
    assert len(errors) <= 5
    # constants of order 100 are allowed; linear convergence would break this at the second step
    assert all(after <= max(200 * before**2, 1e-11) for before, after in pairwise(errors))


def test_the_system_is_regular_only_with_the_unfolding(solved):
    """Closure rows in (nodes, T) are dependent, by energy; the column of s makes them independent."""
    shooting, exact = solved
    matrix = shooting.jacobian(exact).full()
    assert matrix.shape[0] == matrix.shape[1]
    assert np.linalg.cond(matrix) < 1e6
    rows = shooting.guess.nodes.size

    def rank(columns: int) -> int:
        sizes = np.linalg.svd(matrix[:rows, :columns], compute_uv=False)
        return int(np.sum(sizes > 1e-8 * sizes[0]))

    assert rank(rows + 1) == rows - 1
    assert rank(rows + 2) == rows


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_every_symmetric_formulation_is_regular_at_a_symmetric_orbit(symmetry):
    """At a normal mode the square Jacobian of each formulation is well conditioned and the residual vanishes."""
    one = reference("normal_modes.json")["triple-mode-1-E1"]
    guess = Guess(one["state"], one["period"])
    problem = Problem(chain(3), guess, pin=pin(energy=one["energy"]), symmetry=symmetry, segments=2)
    shooting = shoot(at_section(problem, build_flow(chain(3))))
    w = polish(shooting, shooting.start)
    assert np.abs(residual(shooting, shooting.at(w))).max() <= 1e-13
    assert shooting.at(w).period == pytest.approx(one["period"], abs=1e-12)
    assert np.linalg.cond(shooting.jacobian(w).full()) < 1e6


def test_the_decision_vector_is_taken_apart_as_it_was_joined():
    """at() and vector() are inverse to each other."""
    problem = Problem(chain(2), Guess([0.1, 0.2, 0.0, 0.0], 2.0), segments=3, free=("length1", "mass2"))
    shooting = shoot(problem)
    assert shooting.start.size == 12 + 1 + 1 + 2
    w = np.arange(16.0)
    np.testing.assert_array_equal(shooting.vector(shooting.at(w)), w)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_the_program_states_the_rows_of_its_loop_and_their_derivatives(symmetry):
    """Away from any solution CasADi's rows are the loop's, and CVODES' Jacobian that of the eighth-order march."""
    pins = {"energy": -15.0, "period": 1.9, "theta1dot" if symmetry == "reversal" else "theta1": 0.5}
    guess = Guess([0.6, -0.2, 0.3, 0.5], 1.7)
    shooting = shoot(
        Problem(chain(2), guess, pin=pin(**pins), symmetry=symmetry, free=("gravity", "mass1"), segments=2)
    )
    random = np.random.default_rng(0)
    w = shooting.start + 0.05 * random.normal(size=shooting.start.size)
    found, ends = shooting.at(w), random.normal(size=(2, 4))
    np.testing.assert_allclose(shooting.rows(w, ends.T).full().ravel(), shooting.loop.rows(found, ends), atol=1e-14)
    path = shooting.loop.equations.varied(replace(found, mesh=uniform(shooting.problem.boundary.fraction, 2, 200)))
    matrix = shooting.loop.linearised(found, path).matrix()
    np.testing.assert_allclose(shooting.jacobian(w).full(), matrix, atol=1e-9 * np.abs(matrix).max())


def test_the_program_of_a_forced_system_states_the_rows_of_its_loop():
    """The period that the forcing prescribes is a row of both, and there is no phase condition."""
    shooting = shoot(Problem(FUNCTIONS["forced_duffing"](), Guess([1.0, 0.0], 6.0), segments=2))
    w, ends = shooting.start + 0.1, np.array([[0.3, 0.4], [0.5, 0.6]])
    rows = shooting.rows(w, ends.T).full().ravel()
    np.testing.assert_allclose(rows, shooting.loop.rows(shooting.at(w), ends) / shooting.units, atol=1e-14)
    assert rows.size == 5 and rows[-1] != 0


def test_the_start_lies_strictly_within_its_bounds_and_the_period_is_kept_from_zero():
    """Bounds enclose the guess, are finite, and exclude T <= 0."""
    shooting = shoot(printed_problem("triple-1"))
    assert np.all(shooting.lower < shooting.start) and np.all(shooting.start < shooting.upper)
    assert np.all(np.isfinite([shooting.lower, shooting.upper]))
    assert shooting.at(shooting.lower).period > 0.1 * PRINTED["triple-1"].guessed_period


@pytest.mark.parametrize("square", [True, False])
def test_the_hessian_is_an_upper_triangle_with_casadis_signature(square):
    """hess_lag takes (x, p, lam_f, lam_g), returns an upper triangle, and is what CasADi expects of that name."""
    model = chain(2)
    state = [0.3, -0.2, 0.5, 0.1]
    shooting = shoot(Problem(model, Guess(state, 2.0), pin=pin(energy=energy(model, state)) if square else ()))
    given = hessian(shooting)
    sizes = (shooting.start.size, 0, 1, shooting.constraints.numel())
    assert tuple(given.numel_in(k) for k in range(given.n_in())) == sizes
    assert given.n_out() == 1 and given.sparsity_out(0).is_triu()
    expected = ca.Function("objective", [shooting.variables], [ca.hessian(shooting.objective, shooting.variables)[0]])
    value = given(shooting.start, ca.DM(0, 1), 2.5, ca.DM.ones(sizes[3])).full()
    if square:
        np.testing.assert_allclose(value, 1e-8 * np.eye(sizes[0]))
    else:
        np.testing.assert_allclose(value, 2.5 * expected(shooting.start).full(), atol=1e-7)
        assert np.diag(value).min() > 0
