"""Families of every kind of system and every kind of end, against independent numbers."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from orbitfinder.errors import InputError
from orbitfinder.families.folder import follow_family
from orbitfinder.families.members import motions
from orbitfinder.families.minimal import dead_point, minimal_problem, native_state
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.stability import spectrum
from orbitfinder.families.start import begin
from orbitfinder.integrate.cvodes import build_flow, end_state
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.constrained import minimal_states
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.mechanisms.linkage import linkage
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.guesses.modes import linkage_mode, mode_problem
from orbitfinder.problemfile.read import load_problem
from orbitfinder.systems import henon_heiles, pendulum_on_cart

FAMILIES = Path(__file__).parents[1] / "problems" / "families"
QUIET = FamilySettings(events=False, certify=False)
ONWARD = FamilySettings(events=False, certify=False, directions="forward")


# ---- the double pendulum by other means: NumPy equations written from the textbook, SciPy, own Newton ----

GRAVITY, INERTIA = 9.8, 1.0 / 12.0


def double_pendulum(_, x):
    """Two uniform rods of 1 m and 1 kg: 4/3 a1 + 1/2 c a2 = -1/2 s w2^2 - 3/2 g sin q1, and so on."""
    q1, q2, w1, w2 = x
    c, s = np.cos(q1 - q2), np.sin(q1 - q2)
    a, b, d = 1.0 + 0.25 + INERTIA, 0.5 * c, 0.25 + INERTIA
    f1 = -0.5 * s * w2**2 - 1.5 * GRAVITY * np.sin(q1)
    f2 = 0.5 * s * w1**2 - 0.5 * GRAVITY * np.sin(q2)
    determinant = a * d - b * b
    return [w1, w2, (d * f1 - b * f2) / determinant, (a * f2 - b * f1) / determinant]


def quarter(start, period):
    """Angles after a quarter of the period from rest."""
    options = {"method": "DOP853", "rtol": 2.3e-14, "atol": 1e-15, "max_step": period / 400}
    return solve_ivp(double_pendulum, (0.0, period / 4), [*start, 0.0, 0.0], **options).y[:2, -1]


def period_at(level, start, period):
    """Newton on (q1, q2, T): both angles vanish after a quarter period, and the energy at rest."""
    w = np.array([*start, period])

    def rows(w):
        potential = -GRAVITY * (1.5 * np.cos(w[0]) + 0.5 * np.cos(w[1]))
        return np.array([*quarter(w[:2], w[2]), potential - level])

    for _ in range(6):
        value = rows(w)
        slope = np.stack([(rows(w + h) - rows(w - h)) / 2e-5 for h in 1e-5 * np.eye(3)], axis=1)
        w -= np.linalg.solve(slope, value)
    return w[2]


@pytest.mark.parametrize(("mode", "levels"), [(1, (-18.0, -10.0)), (2, (-18.0, -12.0))])
def test_double_pendulum_modes_by_a_second_implementation(mode, levels, tmp_path):
    """Both normal modes up to 9.6 J above hanging: periods agree to 1e-10 with equations and Newton of our own."""
    family = follow_family(mode_problem(chain(2), mode, 0.05), at=levels, out=tmp_path, settings=QUIET)
    for level in levels:
        point = min(family.points, key=lambda one: abs(one.energy - level))
        assert abs(point.energy - level) < 1e-12
        found = period_at(level, point.state[:2] + 1e-4, point.period * (1 + 1e-5))
        assert abs(found - point.period) < 1e-10


# ---- linkages -------------------------------------------------------------------------------------------

FIVE_BAR = {"length": [0.6, 0.9, 0.8, 0.5], "ground": [0.1, 1.2]}


@pytest.mark.slow
def test_five_bar_family_agrees_with_the_native_dae(tmp_path):
    """A point of the family, mapped back to all bars, closes on the DAE; shooting over IDAS finds its period."""
    problem = load_problem(FAMILIES / "five-bar-slow.toml")
    model = linkage(**FIVE_BAR)
    guess = linkage_mode(model, 1, 0.3)
    level = energy(model, guess.state)
    family = follow_family(problem, at=(level,), out=tmp_path, settings=QUIET)
    point = family.points[-1]
    assert family.system["independent"] == [1, 4] and point.symmetry == "brake"
    state = native_state(family.system, point.state)
    assert abs(energy(model, state) - point.energy) < 1e-11
    assert np.abs(end_state(build_flow(model), state, point.period) - state).max() < 1e-8
    orbit = find_orbit(Problem(model, guess, pin(energy=level)))
    assert orbit.certificate.passed and abs(orbit.period - point.period) < 1e-9
    assert np.abs(np.sum(orbit.floquet_multipliers) - np.sum(point.floquet_multipliers)) < 1e-8
    assert abs(begin(orbit).solution.place.period - point.period) < 1e-9  # from the linkage's own orbit.json
    rebuilt = build_model(family.system)
    assert ClosureCheck(rebuilt)(point.state, point.period, np.zeros(2)) < 1e-11


def longer_third_bar(family, length, point):
    """The orbit of the five-bar with another third bar, by shooting over IDAS from a point of the family."""
    model = linkage([0.6, 0.9, length, 0.5], ground=FIVE_BAR["ground"])
    state = native_state(family.system, point.state, {"length3": length})
    return find_orbit(Problem(model, Guess(state, point.period), pin(energy=-23.0)))


@pytest.mark.slow
def test_five_bar_family_in_a_length(tmp_path):
    """The loop closes at every length: dT/d(length) is that of orbits found alone on the DAE, as is the last."""
    problem = load_problem(FAMILIES / "five-bar-length.toml")
    family = follow_family(problem, "length3", until=0.9, out=tmp_path, settings=QUIET)
    first, last = family.points[0], family.points[-1]
    assert family.ends[0].kind == "target" and last.free == {"length3": pytest.approx(0.9, abs=1e-13)}
    alone = longer_third_bar(family, 0.9, last)
    assert alone.certificate.passed and abs(alone.period - last.period) < 1e-10
    assert abs(np.sum(alone.floquet_multipliers) - np.sum(last.floquet_multipliers)) < 1e-8
    size, h = first.state.size, 2e-3
    slope = first.tangent[size] / first.tangent[size + 1]
    far, low, high, beyond = (longer_third_bar(family, 0.8 + k * h, first).period for k in (-2, -1, 1, 2))
    assert slope == pytest.approx((8 * (high - low) - (beyond - far)) / (12 * h), abs=2e-9)


@pytest.mark.parametrize(("name", "until", "hold"), [
    pytest.param("mass2", 1.1, "energy", marks=pytest.mark.slow), ("length1", 0.605, "period"),
])  # fmt: skip
def test_linkage_families_in_other_parameters(name, until, hold, tmp_path):
    """Masses and lengths, at constant energy or period; the last orbit closes on the linkage built anew; resumed."""
    problem = load_problem(FAMILIES / "five-bar-length.toml")
    settings = FamilySettings(events=False, hold=hold)
    family = follow_family(problem, name, until=until, out=tmp_path, settings=settings)
    assert [end.kind for end in family.ends] == ["target"]
    last = max(family.points, key=lambda point: abs(point.arclength))
    kept = "energy" if hold == "energy" else "period"
    assert getattr(last, kept) == pytest.approx(getattr(family.points[0], kept), rel=1e-12)
    changed = build_model(with_parameters(build_model(family.system), last.free).system)
    assert ClosureCheck(changed)(last.state, last.period, np.zeros(2)) < 1e-11 * last.scale
    joints = motions(family, build_model(family.system), 3)[-1].joints
    assert np.allclose(joints[:, :, -1], FIVE_BAR["ground"], atol=1e-10)  # drawn with the point's own lengths
    again = follow_family(problem, name, until=until, out=tmp_path, settings=settings)
    assert [point.period for point in again.points] == [point.period for point in family.points]


@pytest.mark.slow
def test_family_in_a_length_ends_at_a_dead_point(tmp_path):
    """A bar too short for the motion at this energy: the bars beside it come into line, and the end says so."""
    walk = FamilySettings(events=False, certify=False, shortest_step=1e-3)
    problem = load_problem(FAMILIES / "five-bar-length.toml")
    high = follow_family(problem, until=-16.0, out=tmp_path / "up", settings=walk)
    point, model = high.points[-1], build_model(high.system)
    origin = Problem(model, Guess(point.state, point.period), pin(energy=point.energy), name="swing")
    family = follow_family(origin, "length2", until=0.15, out=tmp_path, settings=walk)
    (end,) = family.ends
    assert end.kind == "dead point" and end.reason.startswith("bars 2 and 3 come into line")
    swept = motions(family, model, 2)[0]  # the shortest bar
    theta = np.array([native_state(family.system, one, swept.point.free)[2:12:3] for one in swept.states])
    assert np.abs(np.sin(theta[:, 2] - theta[:, 1])).min() < 0.05
    assert dead_point(chain(2), np.zeros((1, 4))) == ""


def test_bar_states_close_the_linkage():
    """All four bars end at the ground pivot, and their rates keep them there."""
    model = linkage(**FIVE_BAR)
    problem = minimal_problem(load_problem(FAMILIES / "five-bar-fast.toml"))
    system = problem.model.system
    theta, rates = np.split(minimal_states(model, native_state(system, np.array([0.3, 3.0, 0.4, -0.7]))), 2)
    lengths = np.array(FIVE_BAR["length"])
    tip = lengths @ np.stack([np.cos(theta), np.sin(theta)], axis=1)
    assert np.allclose(tip, FIVE_BAR["ground"], atol=1e-12)
    assert np.allclose((lengths * rates) @ np.stack([-np.sin(theta), np.cos(theta)], axis=1), 0.0, atol=1e-12)
    assert model.degrees_of_freedom == 12 and theta[0] == pytest.approx(0.3)
    with pytest.raises(InputError, match="not a linkage in minimal coordinates"):
        native_state(model.system, np.zeros(4))


def test_motion_through_a_dead_point_is_refused():
    """A parallelogram's bars all come into line in one turn: no two bars can be left out."""
    model = linkage([0.5, 1.0, 0.5], ground=(0.0, 1.0))
    start = np.array([0.3, np.pi / 2, 0.3 + np.pi, 9.0, 0.0, 9.0])
    from orbitfinder.mechanics.constrained import maximal_states

    problem = Problem(model, Guess(maximal_states(model, start), 1.0))
    with pytest.raises(InputError, match="dead point"):
        minimal_problem(problem)


# ---- Henon-Heiles, cyclic coordinates -------------------------------------------------------------------


def test_henon_heiles_straight_line_by_quadrature(tmp_path):
    """T = sqrt(2) int dy / sqrt(E - y^2/2 + y^3/3) between the turning points, along the family."""
    problem = load_problem(FAMILIES / "henon-heiles-straight.toml")
    levels = (0.1, 0.15, 0.16)
    family = follow_family(problem, at=levels, out=tmp_path, settings=QUIET)
    for level in levels:
        point = min(family.points, key=lambda one: abs(one.energy - level))
        low, high = np.sort(np.roots([1 / 3, -0.5, 0.0, level]).real)[:2]
        third = 1.5 - low - high  # the roots of y^3/3 - y^2/2 + E add up to 3/2

        def rate(a, low=low, high=high, third=third):
            y = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(a)
            return 1.0 / np.sqrt((third - y) / 3.0)

        exact = np.sqrt(2.0) * quad(rate, 0.0, np.pi, epsabs=1e-13, epsrel=1e-13)[0]
        assert abs(point.period - exact) < 1e-10


@pytest.mark.slow
def test_straight_line_ends_at_equilibrium_and_saddle(tmp_path):
    """Both ends have their names: the centre at E = 0 and the saddle at E = 1/6."""
    problem = load_problem(FAMILIES / "henon-heiles-straight.toml")
    family = follow_family(problem, out=tmp_path, settings=FamilySettings(events=False))
    assert [end.kind for end in family.ends] == ["equilibrium", "homoclinic"]
    assert family.points[-1].energy == pytest.approx(1 / 6, abs=1e-6)


def test_momentum_is_no_second_condition_on_a_brake_orbit(tmp_path):
    """A pendulum on a cart: its momentum vanishes with the rates, so that the symmetric system stays square."""
    problem = load_problem(FAMILIES.parent / "gallery" / "pendulum-on-cart.toml")
    family = follow_family(problem, points=4, out=tmp_path, settings=ONWARD)
    assert family.points[0].symmetry == "brake" and len(family.points) == 5


SWINGING, ROUND = 1.85404041, 2.55995496
"""Rate (rad/s) at which a bead released at 1.2 rad turns its hoop once in one swing, and the period (s) of that."""


def hoop(inertia=1.0):
    """A bead on a hoop of radius 1 that spins freely: the spin's angle is absent, its momentum kept."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    kinetic = (v[0] ** 2 + (inertia + ca.sin(q[0]) ** 2) * v[1] ** 2) / 2
    return lagrange(kinetic, -9.8 * ca.cos(q[0]), Symbols(q, v), names=["theta", "spin"], angles=[True, True])


RUNNING = {
    "cart": lambda: Problem(pendulum_on_cart(), Guess([0.0, 0.0, -4.5, 9.0], 0.9), pin(energy=10.45), "reversal",
                            winding=(0, 1), name="cart"),
    "hoop": lambda: Problem(hoop(), Guess([1.2, 0.0, 0.0, SWINGING], ROUND), winding=(0, 1), name="hoop"),
    "spherical": lambda: Problem(hoop(0.0), Guess([1.1433, 0.0, 0.0, 1.602], 5.4616), pin(energy=-3.0),
                                 winding=(0, 3), name="spherical"),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNNING)
def test_families_of_orbits_with_momentum(name, tmp_path):
    """Momentum is neither held nor unfolded twice: it varies along the family, and every orbit closes."""
    orbit = find_orbit(RUNNING[name]())
    model = RUNNING[name]().model
    family = follow_family(orbit, points=6, out=tmp_path, settings=ONWARD, model=model)
    assert orbit.certificate.passed and len(family.points) == 7
    kept = model.invariants[1].value
    momenta = [float(kept(*np.split(point.state, 2), model.parameter_values)) for point in family.points]
    assert name == "cart" or np.ptp(momenta) > 1e-3  # the cart must not drift away
    last = family.points[-1]
    again = find_orbit(Problem(model, Guess(last.state, last.period), pin(energy=last.energy), winding=orbit.winding))
    assert again.certificate.passed and again.period == pytest.approx(last.period, rel=1e-10)


# ---- ends -------------------------------------------------------------------------


@pytest.mark.slow
def test_closed_family_returns_to_its_start(tmp_path):
    """Beyond its 7:1 resonance the slow mode of the quadruple pendulum is a closed curve, and is named so."""
    walk = FamilySettings(certify=False, directions="forward", events=False)
    family = follow_family(mode_problem(chain(4), 1, 0.3), points=200, out=tmp_path, settings=walk)
    (end,) = family.ends
    assert end.kind == "returned" and "back at its start" in end.reason
    assert all(one.energy > -77.46 for one in family.points)  # beyond the resonance
    levels = family.values("energy")
    assert levels.min() == pytest.approx(-77.4508241, abs=1e-3) and levels.max() == pytest.approx(-39.9079777, abs=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "narrowest"), [(1, 2e-4), (2, 0.2), (3, 0.2), (4, 0.2)])
def test_quadruple_modes_to_45_joules(mode, narrowest, tmp_path):
    """Every mode goes on to 45 J above hanging, through every symmetry-breaking point, in the symmetric formulation."""
    settings = FamilySettings(directions="forward", narrowest=narrowest)
    family = follow_family(mode_problem(chain(4), mode), until=-33.4, points=600, out=tmp_path, settings=settings)
    assert family.ends[0].kind == "target"
    assert all(point.symmetry == "brake+reflection" for point in family.points)
    assert all(point.closure <= 1e-11 * point.scale for point in family.points)
    assert mode == 1 or any(event.kind == "branch_point" for event in family.events)


def test_gallery_of_motions(tmp_path):
    """Eight whole periods along a family, each closing, with the joints that a system has."""
    model = henon_heiles()
    problem = load_problem(FAMILIES / "henon-heiles-loop.toml")
    family = follow_family(problem, points=20, out=tmp_path, settings=ONWARD)
    shown = motions(family, model)
    assert len(shown) == 8 and shown[0].joints.shape[1:] == (2, 1)
    assert max(np.abs(one.states[-1] - one.states[0]).max() for one in shown) < 1e-10
    swept = follow_family(mode_problem(chain(2), 1), points=9, out=tmp_path, settings=ONWARD)
    assert motions(swept, chain(2))[0].joints.shape[1:] == (2, 3)


def test_custom_model_is_continued_from_its_orbit(tmp_path):
    """An orbit of a Model that no file describes is continued with the model beside it."""
    from orbitfinder.mechanics.lagrange import Symbols, lagrange
    from orbitfinder.orbits.find import find_orbit

    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(v**2 / 2, q**2 / 2 + q**4 / 4, Symbols(q, v), names=["x"])
    orbit = find_orbit(Problem(model, Guess(np.array([1.0, 0.0]), 4.7), pin(x=1.0), name="duffing"))
    family = follow_family(orbit, points=4, out=tmp_path, settings=ONWARD, model=model)
    assert len(family.points) == 5
    again = follow_family(orbit, points=6, out=tmp_path, settings=ONWARD, model=model)
    assert len(again.points) == 7
    with pytest.raises(InputError, match="model"):
        follow_family(orbit, points=4, out=tmp_path / "other", settings=QUIET)


def test_motion_more_symmetric_than_its_system():
    """x swings evenly on a line, but what happens beside it is not even in x: a quarter period does not tell it."""
    from orbitfinder.mechanics.lagrange import Symbols, lagrange
    from orbitfinder.orbits.find import find_orbit

    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    potential = q[0] ** 2 / 2 + 0.15 * q[1] ** 2 + 0.4 * q[0] * q[1] ** 2
    model = lagrange(ca.dot(v, v) / 2, potential, Symbols(q, v), names=["x", "y"])
    problem = Problem(model, Guess(np.array([0.5, 0.0, 0.0, 0.0]), 2 * np.pi), pin(energy=0.125), name="line")
    orbit, start = find_orbit(problem), begin(problem)
    assert orbit.symmetry == "brake+reflection" and start.curve.equations.symmetry.name == "brake"
    found = spectrum(start.curve, start.solution).floquet.multipliers
    assert np.sort(found.real) == pytest.approx(np.sort(orbit.floquet_multipliers.real), rel=1e-9)
    assert orbit.stability == "unstable"


@pytest.mark.slow
def test_events_do_not_depend_on_the_steps(tmp_path):
    """Long and short steps find the same events, a Krein collision and its end within 0.06 J of each other included."""
    found = []
    for step in (0.15, 0.05):
        settings = FamilySettings(longest_step=step, certify=False)
        start = mode_problem(chain(4), 2, 0.6)
        family = follow_family(start, until=-66.0, out=tmp_path / str(step), settings=settings)
        found.append([(event.kind, event.detail, event.energy) for event in family.events])
    assert [one[:2] for one in found[0]] == [one[:2] for one in found[1]]
    assert np.allclose([one[2] for one in found[0]], [one[2] for one in found[1]], rtol=0, atol=1e-7)
    collisions = [energy for kind, _, energy in found[0] if kind == "collision"]
    assert np.abs(np.diff(collisions)).min() < 0.06
