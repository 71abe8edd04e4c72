"""Long chains: harmonic balance and a quarter period against the ordinary search, and their certificate."""

import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import pendulum_period

from orbitfinder.errors import ConvergenceError, InputError, IntegrationError, OrbitfinderError
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.start import begin, fitted
from orbitfinder.integrate.compiled import available, compiling
from orbitfinder.integrate.cvodes import build_flow, transition
from orbitfinder.integrate.march import March, uniform
from orbitfinder.integrate.rk8 import MOST_DOUBLINGS
from orbitfinder.loops.condensed import SMALL, Linearised
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.model import energies, vector_field
from orbitfinder.mechanisms import chain_march, chain_motion
from orbitfinder.mechanisms.chain import chain
from orbitfinder.mechanisms.chain_lagrange import chain_lagrange, is_long
from orbitfinder.mechanisms.chain_march import ClosedChain
from orbitfinder.mechanisms.chain_rows import balancing
from orbitfinder.mechanisms.long_chain import balanced, build_chain, find_long_chain, measured, shot, suits
from orbitfinder.orbits import evidence
from orbitfinder.orbits.certify import certified, certify
from orbitfinder.orbits.evidence import gather
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.guesses import balance as harmonic_balance
from orbitfinder.orbits.guesses.balance import Series, dense
from orbitfinder.orbits.guesses.modes import normal_mode
from orbitfinder.systems import henon_heiles

PROBLEMS = Path(__file__).parents[1] / "problems" / "chains"
UNEQUAL = {"length": np.linspace(0.5, 1.5, 6), "mass": np.linspace(2.0, 0.7, 6), "com": np.linspace(0.3, 0.6, 6)}
BARE = SolveSettings(with_certificate=False)


def mode_problem(links: int, amplitude: float, **pins: float) -> Problem:
    """The first mode of uniform links in the quarter-period formulation, pinned at its tip unless said otherwise."""
    model = chain(links)
    chosen = pin(**(pins or {f"theta{links}": amplitude}))
    return Problem(model, normal_mode(model, 1, amplitude), chosen, symmetry="brake+reflection", name=f"chain-{links}")


def largest_difference(found: np.ndarray, wanted: np.ndarray) -> float:
    """Of two sets of complex numbers, matched one to one."""
    from scipy.optimize import linear_sum_assignment

    distance = np.abs(found[:, None] - wanted[None, :])
    return float(distance[linear_sum_assignment(distance)].max())


@pytest.fixture(scope="module")
def twelve():
    """Twelve links let go with 0.5 rad at the tip, found by the ordinary command of the library."""
    return find_orbit(mode_problem(12, 0.5))


# --- the closed form -------------------------------------------------------------------------------


def test_closed_form_agrees_with_the_recursion():
    """Accelerations and energies of unequal links, at random states."""
    model = chain(6, **UNEQUAL)
    closed, random = chain_lagrange(model), np.random.default_rng(1)
    for x in random.normal(0, 2, (5, 12)):
        wanted = model.acceleration(0, x[:6], x[6:], model.parameter_values).full().ravel()
        assert np.abs(closed.field(0.0, x)[6:] - wanted).max() <= 1e-12 * np.abs(wanted).max()
        kinetic, potential = closed.energies(x)
        rest = float(closed.energies(np.zeros(12))[1][0] - model.potential(np.zeros(6), model.parameter_values))
        assert kinetic[0] == pytest.approx(energies(model, x[None])[0][0], rel=1e-13)
        assert potential[0] - rest == pytest.approx(energies(model, x[None])[1][0], rel=1e-12)


def test_closed_form_variations_agree_with_automatic_differentiation():
    model = chain(6, **UNEQUAL)
    closed, random = chain_lagrange(model), np.random.default_rng(2)
    x, columns = random.normal(0, 1, 12), random.normal(0, 1, (12, 7))
    found = closed.variational(0.0, np.concatenate([x, columns.ravel()]))
    y, p = ca.SX.sym("y", 12), model.parameter_values
    rate = ca.vertcat(y[6:], model.acceleration(0, y[:6], y[6:], p))
    field = ca.Function("field", [y], [rate, ca.jacobian(rate, y)])
    wanted = [part.full() for part in field(x)]
    assert found[:12] == pytest.approx(wanted[0].ravel(), rel=1e-11, abs=1e-11)
    varied = wanted[1] @ columns
    assert np.abs(found[12:].reshape(12, 7) - varied).max() <= 1e-11 * np.abs(varied).max()
    a, by_place, by_rate = closed.linearised(x[:6], x[6:])
    assert a == pytest.approx(found[6:12], rel=1e-12)
    assert np.abs(np.hstack([by_place, by_rate]) - wanted[1][6:]).max() <= 1e-11 * np.abs(wanted[1]).max()


@pytest.mark.skipif(not available()[0], reason="no C compiler")
def test_closed_form_in_c_says_what_numpy_says():
    """Rates and variations of unequal links, in two lanes of columns."""
    closed, random = chain_lagrange(chain(7, length=np.linspace(0.5, 1.5, 7), com=0.3)), np.random.default_rng(6)
    for fast, slow, size in ((closed.rates, closed.field, 14), (closed.varied_rates, closed.variational, 14 * 17)):
        library, states = fast.library(), random.normal(0, 1, (3, size))
        assert library is not None
        wanted = np.array([slow(0.0, state) for state in states])
        found = library.rates(np.zeros(3), states, None, None)
        assert np.abs(found - wanted).max() <= 1e-12 * np.abs(wanted).max()
    branched = closed.coupling.copy()
    branched[2, 4] = branched[4, 2] = 0.5 * branched[2, 4]
    assert replace(closed, coupling=branched).rates.library() is None  # its links do not hang in a row


def test_newtons_steps_link_by_link_are_those_of_the_dense_matrix():
    """Of unequal links, at a series that is no solution."""
    closed, random = chain_lagrange(chain(6, **UNEQUAL)), np.random.default_rng(7)
    row = random.normal(0, 1, 6)
    series = Series(0.3 * random.normal(0, 1, (6, 6)) / 2.0 ** np.arange(6)[:, None], 0.9)

    def pinned(place: np.ndarray, period: float) -> tuple[float, np.ndarray, float]:
        return float(row @ place) + 0.1 * period - 1.0, row, 0.1

    found, wanted = (step(series, pinned) for step in (balancing(closed), dense(closed.linearised)))
    assert np.abs(found - wanted).max() <= 1e-10 * np.abs(wanted).max()


def test_momentum_frame_is_canonical():
    """d(eta, pi)/d(q, v) against finite differences of q = U eta, pi = U^T dT/dv."""
    model = chain(6, **UNEQUAL)
    closed, random = chain_lagrange(model), np.random.default_rng(3)
    x = random.normal(0, 1, 12)

    def canonical(x: np.ndarray) -> np.ndarray:
        places = np.linalg.solve(closed.modes, x[:6])
        return np.concatenate([places, closed.modes.T @ closed.mass_matrix(x[:6]) @ x[6:]])

    step = 1e-6
    wanted = np.column_stack([(canonical(x + step * e) - canonical(x - step * e)) / (2 * step) for e in np.eye(12)])
    assert np.abs(closed.momentum_frame(x) - wanted).max() <= 1e-7 * np.abs(wanted).max()


def test_closed_form_refuses_what_is_no_chain(monkeypatch):
    with pytest.raises(InputError, match="not those of an open planar chain"):
        chain_lagrange(henon_heiles())
    assert chain_lagrange(chain(5, com=0.0)).hanging is not None  # where the last link couples with no other
    monkeypatch.setattr("orbitfinder.mechanisms.chain_lagrange.ROUND_OFF", -1.0)
    with pytest.raises(InputError, match="do not hang in a row"):
        chain_lagrange(chain(3))


# --- the parts -------------------------------------------------------------------------------------


def test_columns_agree_with_the_variational_equations_of_the_flow():
    """Along a motion that does not start at rest."""
    model = chain(12)
    state = np.random.default_rng(4).normal(0, 0.2, 24)
    end, matrix = transition(build_flow(model), state, 0.5)
    known = ClosedChain(model, np.zeros(24, bool))
    found = known.varied(state[None], uniform(0.25, 1, 160), np.array([2.0]))
    assert np.abs(found.transitions[0] - matrix).max() <= 1e-9 * np.abs(matrix).max()
    assert (
        np.abs(known.refined(state, uniform(0.25, 1, 64), np.array([2.0]))[-1] - end).max() <= 1e-11 * np.abs(end).max()
    )


def test_harmonic_balance_converges_spectrally_to_the_pendulum():
    """The period of one link at 1 rad is an elliptic integral; its error falls by decades with each harmonic."""
    closed = chain_lagrange(chain(1))

    def at_one(place: np.ndarray, _: float) -> tuple[float, np.ndarray, float]:
        return float(place[0] - 1.0), np.ones(1), 0.0

    errors = []
    for count in (2, 3, 4, 5):
        first = Series(np.ones((1, 1)), 3.8).padded(count)
        found = harmonic_balance.correct(first, balancing(closed), at_one)
        assert found is not None
        errors.append(abs(found[0].period - pendulum_period(1.0)))
    assert errors[-1] < 1e-8
    assert all(later < earlier / 20 for earlier, later in itertools.pairwise(errors))


def test_harmonic_balance_gives_up_on_nonsense():
    """A frequency of the wrong sign, numbers that are not finite and a singular matrix are no solutions."""
    closed = chain_lagrange(chain(1))

    def nowhere(place: np.ndarray, _: float) -> tuple[float, np.ndarray, float]:
        return float("nan"), np.ones(1), 0.0

    def singular(place: np.ndarray, _: float) -> tuple[float, np.ndarray, float]:
        return 1.0, np.zeros(1), 0.0

    for row, newton in itertools.product((nowhere, singular), (dense(closed.linearised), balancing(closed))):
        assert harmonic_balance.correct(Series(np.ones((1, 1)), 3.8), newton, row) is None


def test_a_quarter_that_does_not_end_where_it_should_does_not_close(twelve):
    """The rest of the period is its images, which are apart by twice what q(T/4) misses."""
    off = measured(build_chain(mode_problem(12, 0.5)), twelve.state[:12], twelve.period * (1 + 1e-6))
    assert twelve.closure < 1e-11 and off.closure > 1e-7


def test_a_closed_form_that_is_not_the_chains_is_noticed(twelve, monkeypatch):
    """Weights off by 1e-6 are an error where the multipliers would be wrong; the right ones agree to round-off."""
    chain = build_chain(mode_problem(12, 0.5))
    assert chain.march.disagreement(twelve.samples[:129:32]) <= 1e-11
    wrong = replace(chain.closed, weights=chain.closed.weights * (1 + 1e-6))
    monkeypatch.setattr(chain_march, "chain_lagrange", lambda model: wrong)
    with pytest.raises(OrbitfinderError, match="closed form of this chain's equations .* please report"):
        measured(build_chain(mode_problem(12, 0.5)), twelve.state[:12], twelve.period)


def test_halving_stops_where_it_no_longer_helps(monkeypatch):
    """With an agreement that round-off cannot reach, steps are halved until the change is round-off, not for ever."""
    known = ClosedChain(chain(12), np.zeros(24, bool))
    counts, states = [], ClosedChain.states

    def counted(self, nodes, mesh, tail):
        counts.append(mesh.size - 1)
        return states(self, nodes, mesh, tail)

    monkeypatch.setattr(ClosedChain, "states", counted)
    monkeypatch.setattr(chain_march, "AGREEMENT", 0.0)
    state, second = np.concatenate([np.linspace(0.1, 0.5, 12), np.zeros(12)]), (uniform(1.0, 1, 16), np.ones(1))
    fine = known.refined(state, *second)
    assert counts[-1] < 16 * 2**MOST_DOUBLINGS
    monkeypatch.undo()
    assert np.abs(fine[-1] - known.refined(state, *second)[-1]).max() <= 1e-10


def test_the_march_of_a_chain_is_the_ordinary_one_up_to_what_is_held():
    """Two segments from rest: states, ends and derivatives of one eighth-order march, columns by held rates left 0."""
    model, held = chain(12), np.arange(24) >= 12
    nodes = np.random.default_rng(5).normal(0, 0.2, (2, 24)) * ~held
    place = nodes, uniform(0.25, 2, 64), np.array([1.5])
    found, wanted = (march.varied(*place, states=True) for march in (
        ClosedChain(model, held), March(vector_field(model))))  # fmt: skip
    np.testing.assert_allclose(found.ends, wanted.ends, atol=1e-12)
    np.testing.assert_allclose(found.states, wanted.states, atol=1e-12)
    np.testing.assert_allclose(found.columns, wanted.columns, atol=1e-11)
    np.testing.assert_allclose(found.transitions[:, :, ~held], wanted.transitions[:, :, ~held], atol=1e-9)
    assert not found.transitions[:, :, held].any() and wanted.transitions[:, :, held].any()


# --- against the ordinary search -------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("links", "amplitude"), [(8, 0.5), (10, 0.6)])
def test_agrees_with_the_ordinary_search(links, amplitude):
    """Chains short enough for multiple shooting by IPOPT: the same orbit and the same multipliers."""
    problem = mode_problem(links, amplitude)
    assert not suits(problem)
    ordinary, found = find_orbit(problem), certified(*find_long_chain(problem, SolveSettings(), None, 0.0))
    assert ordinary.certificate.passed and found.certificate.passed, found.certificate.failures
    assert found.period == pytest.approx(ordinary.period, abs=1e-10)
    assert np.abs(found.state - ordinary.state).max() <= 1e-10
    assert found.energy == pytest.approx(ordinary.energy, rel=1e-12)
    assert found.action == pytest.approx(ordinary.action, rel=1e-11)
    assert (found.symmetry, found.stability) == (ordinary.symmetry, ordinary.stability)
    assert largest_difference(found.floquet_multipliers, ordinary.floquet_multipliers) <= 1e-7
    assert found.pair_defect <= 1e-8


def test_evidence_agrees_with_hamiltons_equations(monkeypatch):
    """Closed form and generic Hamiltonian certificate say the same of one orbit of eight links."""
    problem = mode_problem(8, 0.5)
    orbit = find_long_chain(problem, BARE, None, 0.0)[0]
    turns = np.zeros(8, int)
    generic = gather(problem.model, orbit.state, orbit.period, turns)
    monkeypatch.setattr(chain_motion, "is_long", lambda _: True)
    found = gather(problem.model, orbit.state, orbit.period, turns)
    assert max(generic.closure, found.closure) <= 1e-12
    assert found.action == pytest.approx(generic.action, rel=1e-11)
    assert found.energy == pytest.approx(generic.energy, rel=1e-13)
    assert largest_difference(found.floquet.multipliers, generic.floquet.multipliers) <= 1e-7
    assert found.tour.asymplectic <= 1e-10 and found.tour.trivial <= 1e-10
    assert "Lagrange" in found.motion.formulation and "Hamilton" in generic.motion.formulation


def test_closure_of_a_long_chain_is_that_of_its_certificate(twelve, monkeypatch):
    """Hamilton's equations of many links are dear: the closed form says by itself whether an orbit closes."""
    monkeypatch.setattr(evidence, "hamilton", None)
    check, turns = evidence.ClosureCheck(chain(12)), np.zeros(12, int)
    assert check(twelve.state, twelve.period, turns) <= 1e-11
    assert check(twelve.state, twelve.period * (1 + 1e-6), turns) > 1e-8


def test_a_part_of_the_period_gives_the_multipliers_of_the_whole(twelve, monkeypatch):
    """A quarter of a motion from rest that is at -x(0) after T/2, half of it from elsewhere, all of another."""
    lengths, transitions = [], chain_motion._chain_pieces

    def noted(closed, state, duration, units, count):
        lengths.append(duration / twelve.period)
        return transitions(closed, state, duration, units, count)

    monkeypatch.setattr(chain_motion, "_chain_pieces", noted)
    turns = np.zeros(12, int)
    quarter = gather(chain(12), twelve.state, twelve.period, turns)
    half = gather(chain(12), twelve.samples[64], twelve.period, turns)
    assert lengths == [0.25, 0.5]
    monkeypatch.setattr(chain_motion, "REFLECTED", -1.0)
    whole = gather(chain(12), twelve.state, twelve.period, turns)
    assert lengths == [0.25, 0.5, 1.0]
    for part in (quarter, half):
        assert largest_difference(part.floquet.multipliers, whole.floquet.multipliers) <= 1e-8
        assert part.tour.asymplectic <= 1e-9 and part.tour.trivial <= 1e-9
    monkeypatch.undo()
    monkeypatch.setattr(chain_motion, "_chain_pieces", noted)
    gather(chain(12), twelve.samples[64] * 1.0001, twelve.period, turns)
    assert lengths[-1] == pytest.approx(1.0)


def test_evidence_without_gravity_knows_the_angular_momentum():
    """Four trivial multipliers are removed, two where the flow is the rotation itself."""
    model, turning = chain(11, gravity=0.0), np.concatenate([np.zeros(11), np.full(11, 0.7)])
    rigid = gather(model, turning, 0.1, np.zeros(11, int))
    assert rigid.tour.trivial <= 1e-9 and rigid.tour.asymplectic <= 1e-10
    assert rigid.floquet.multipliers.size == 20
    bent = gather(model, turning + np.linspace(0, 0.3, 22), 0.1, np.zeros(11, int))
    assert bent.floquet.multipliers.size == 18 and bent.tour.asymplectic <= 1e-10


# --- the whole -------------------------------------------------------------------------------------


def test_long_chain_is_certified(twelve):
    """find_orbit takes the long way by itself and says in the certificate on which equations it was judged."""
    assert is_long(chain(12)) and twelve.certificate.passed, twelve.certificate.failures
    assert twelve.state[11] == pytest.approx(0.5, abs=1e-14) and twelve.symmetry == "brake+reflection"
    assert twelve.floquet_multipliers.size == 22 and twelve.stability == "elliptic"
    assert twelve.pair_defect <= 1e-8 and twelve.closure <= 1e-12
    assert "harmonic balance" in twelve.provenance["method"] and "ipopt_tolerance" not in twelve.provenance
    note = {check.name: check.note for check in twelve.certificate.checks}["closure"]
    assert "Lagrange's equations" in note
    assert len(twelve.samples) == 513 and len(twelve.nodes) == 8


@pytest.mark.parametrize("name", ["energy", "period"])
def test_other_pins_find_the_same_orbit(twelve, name):
    """The orbit's own energy or period, from the linear mode."""
    found = find_orbit(mode_problem(12, 0.5, **{name: getattr(twelve, name)}), BARE)
    assert found.period == pytest.approx(twelve.period, abs=1e-9)
    assert np.abs(found.state - twelve.state).max() <= 1e-7


def test_a_good_guess_is_corrected_without_following_the_family(twelve):
    stages = []
    guess = Guess(twelve.state * 1.002, twelve.period * 1.001)
    problem = Problem(chain(12), guess, pin(theta12=0.5), symmetry="brake+reflection")
    found = find_orbit(problem, BARE, lambda event: stages.append(event.stage))
    assert found.period == pytest.approx(twelve.period, abs=1e-11)
    assert stages and not any("harmonic" in stage for stage in stages)


@pytest.mark.parametrize(
    "change",
    [{"symmetry": "none"}, {"symmetry": "brake"}, {"pin": ()}, {"bounds": {"period": (1.0, 9.0)}}],
    ids=["none", "brake", "nearest", "bounds"],
)
def test_other_problems_go_the_ordinary_way(change):
    problem = mode_problem(12, 0.5)
    assert suits(problem)
    assert not suits(replace(problem, **change))


# --- what fails ------------------------------------------------------------------------------------


def test_a_pin_on_a_rate_is_refused():
    with pytest.raises(InputError, match="theta12dot is 0 where a brake orbit starts"):
        find_orbit(mode_problem(12, 0.5, theta12dot=0.3))


def test_a_lost_family_is_said_to_be_lost():
    """The tip of four links cannot swing in the first mode to 3.3 rad, beyond upright."""
    known = build_chain(mode_problem(4, 3.3))
    with pytest.raises(ConvergenceError, match=r"could not be followed to theta4 = 3.3; give a smaller value"):
        balanced(known, lambda *_: None)


def test_shooting_that_stalls_is_an_error():
    """Far from any orbit the residual grows and the message says what to do."""
    known = build_chain(mode_problem(12, 0.5))
    with pytest.raises(ConvergenceError, match="stalled with"):
        shot(known, np.linspace(0.0, 2.0, 12), 2.0, lambda *_: None)


def test_states_that_overflow_are_an_integration_error():
    known = ClosedChain(chain(12), np.zeros(24, bool))
    wild = np.concatenate([np.zeros(12), np.full(12, 1e200) * np.arange(12)])
    with pytest.raises(IntegrationError, match="the state is not finite"):
        known.states(wild[None], uniform(1.0, 1, 8), np.ones(1))
    with pytest.raises(IntegrationError, match="the variations are not finite"):
        known.variations(np.zeros(24), 1.0, np.full((24, 2), 1e308))


def test_a_falsified_long_orbit_fails_its_certificate(twelve):
    """Each falsified number is caught by the check that is about it."""
    model = chain(12)
    late = certify(replace(twelve, period=twelve.period + 1e-9), model)
    assert not late.passed and "closure" in late.failures
    claims = {
        "floquet_multipliers": twelve.floquet_multipliers * 1.001,
        "action": twelve.action * (1 + 1e-8),
        "energy": twelve.energy + 1e-6,
        "stability": "unstable",
        "symmetry": "none",
    }
    assert set(certify(replace(twelve, **claims), model).failures) == claims.keys()


# --- the sizes -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("links", [20, 50, 100])
def test_problem_file_of_a_long_chain(links, tmp_path):
    """`orbitfinder run` on the shipped file, all 2n - 2 multipliers; `verify` on what it wrote."""
    from click.testing import CliRunner

    from orbitfinder.cli.group import cli

    done = CliRunner().invoke(cli, ["run", str(PROBLEMS / f"chain-{links}.toml"), "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    file = tmp_path / f"chain-{links}" / "orbit.json"
    document = json.loads(file.read_text())
    assert document["certificate"]["passed"] and len(document["floquet_multipliers"]) == 2 * links - 2
    assert document["state"][links - 1] == pytest.approx(1.0, abs=1e-14)
    assert document["pair_defect"] <= 1e-8
    assert file.stat().st_size < 200_000 and file.with_suffix(".npz").stat().st_size < 2_000_000
    if links == 20:
        assert CliRunner().invoke(cli, ["verify", str(file)]).exit_code == 0


def set_small(monkeypatch, small):
    """What is small as said, wherever it is asked for."""
    for name, module in list(sys.modules.items()):
        if name.startswith("orbitfinder.loops.") and getattr(module, "SMALL", None) == SMALL:
            monkeypatch.setattr(module, "SMALL", small)


@pytest.fixture
def decomposed(monkeypatch):
    """Shapes of the matrices that are decomposed by singular values."""
    svd, shapes = np.linalg.svd, []
    monkeypatch.setattr(np.linalg, "svd", lambda matrix, **how: shapes.append(np.shape(matrix)) or svd(matrix, **how))
    return shapes


def direction():
    """That of the family of ten links' first mode at its first orbit."""
    with compiling("off"):
        return begin(mode_problem(10, 0.3), symmetry="brake+reflection").direction


@pytest.mark.parametrize("nearly", [None, 0.0, 1e-12])
def test_the_direction_of_a_large_family_is_the_kernel_of_its_rows(nearly, monkeypatch, decomposed):
    """By inverse iteration as by singular values, which it leaves rows to that depend on each other: so that they have
    no factors, and so that these are worth nothing."""
    known = direction()
    rows, bordered = max(decomposed), Linearised.bordered
    set_small(monkeypatch, 0)

    def dependent(given, row):
        parts = {name: np.array(getattr(given, name)) for name in ("first", "last", "tail")}
        for name, part in parts.items():
            part[1] = (1 + nearly) * part[0] + nearly * getattr(given, name)[1]
        looked = np.count_nonzero(row) > row.size / 2  # an aim is of few unknowns
        return bordered(replace(given, **parts) if looked else given, row)

    if nearly is not None:
        monkeypatch.setattr(Linearised, "bordered", dependent)
    decomposed.clear()
    np.testing.assert_allclose(direction(), known, atol=1e-9 * np.abs(known).max())
    assert (rows in decomposed) == (nearly is not None)


@pytest.mark.parametrize("small", [0, SMALL])
def test_a_large_family_marches_variations_once_a_point(monkeypatch, small):
    """Its points are those of Newton's method all the way, and the action is integrated without variations; so they are
    of rows in parts. With its rows in one matrix each point looks once more for a family that comes near.
    """
    set_small(monkeypatch, small)
    marched, varied = [], March.varied_each
    monkeypatch.setattr(March, "varied_each", lambda *given: marched.append(1) or varied(*given))

    def counted():
        """Points after the first, and how often variations are marched for each of them."""
        marched.clear()
        settings, each = FamilySettings(events=False, certify=False, directions="forward", points=4), []
        problem = mode_problem(10, 0.3)
        with compiling("off"):
            family = follow_family(problem, settings=settings, progress=lambda batch: each.append(len(marched)))
        return family.points[1:], each

    points, count = counted()
    monkeypatch.setattr(March, "wide", False)
    known, slow = counted()
    assert np.diff(count[:4]).max() <= (2 if small else 1) < np.diff(slow[:4]).min()
    for point, other in zip(points, known, strict=True):
        assert point.value == pytest.approx(other.value, rel=1e-11)
        assert point.action == pytest.approx(other.action, rel=1e-9)
        assert point.period == pytest.approx(other.period, rel=1e-11)
        np.testing.assert_allclose(point.state, other.state, atol=1e-9)


def test_a_first_mesh_on_which_numbers_overflow_is_made_finer(monkeypatch):
    """Of a large system, whose fast modes its steps are too long for; elsewhere it is one of the steps of DOP853."""
    with compiling("off"):
        start = begin(mode_problem(10, 0.3), symmetry="brake+reflection")
        curve, place, varied = start.curve, start.solution.place, type(start.curve.equations).varied

        def overflowing(equations, w, states=False):
            if w.mesh.size < 30:
                raise IntegrationError("the state is not finite")
            return varied(equations, w, states)

        monkeypatch.setattr(type(curve.equations), "varied", overflowing)
        coarse = place.on(uniform(0.25, len(place.nodes), 4))
        assert fitted(curve, coarse).mesh.size > 30
        monkeypatch.setattr(March, "wide", False)
        assert fitted(curve, coarse).mesh.size > 30
