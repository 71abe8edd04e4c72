"""Motions whose equal steps are too long somewhere: past close encounters, along bursts."""

from dataclasses import replace

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import ConvergenceError
from orbitfinder.integrate.dop853 import integrate
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.mesh import stepped
from orbitfinder.loops.shooting import flow_of
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.newton import Settings, full, natural
from orbitfinder.orbits import refine
from orbitfinder.orbits.refine import uneven
from orbitfinder.systems import three_bodies

PRINTED = {
    "moth I": (0.464445, 0.396060, 14.893911), "yin-yang Ib": (0.282699, 0.327209, 10.962563),
    "goggles": (0.083300, 0.127889, 10.466818), "butterfly I": (0.306893, 0.125507, 6.235641),
    "moth II": (0.439166, 0.452968, 28.670278), "moth III": (0.383444, 0.377364, 25.840618),
    "bumblebee": (0.184279, 0.587188, 63.534541), "dragonfly": (0.080584, 0.588836, 21.270975),
    "yin-yang Ia": (0.513938, 0.304736, 17.328370), "butterfly II": (0.392955, 0.097579, 7.003707),
    "butterfly III": (0.405916, 0.230163, 13.865763),
}  # fmt: skip
"""The velocity of both outer bodies, and the period: M. Suvakov, V. Dmitrasinovic, Physical Review Letters 110 (2013)
114301"""


def printed(name: str, *digits: float) -> of.Problem:
    """Bodies at -1, 1 and 0, the outer ones with the same velocity, in the coordinates of `three_bodies`."""
    a, b, period = digits or PRINTED[name]
    return of.Problem(three_bodies(), of.Guess([2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -3 * a, -3 * b], period))


@pytest.mark.slow
@pytest.mark.parametrize("name", PRINTED)
def test_published_orbits_are_certified_from_their_printed_digits(name):
    """By Newton's method over half a period, since a mirror leaves the guess as it is; it moves in the sixth digit."""
    problem = printed(name)
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert np.abs(orbit.state - problem.guess.state).max() < 1e-5
    assert orbit.period == pytest.approx(problem.guess.period, rel=3e-4)
    assert "symmetry mirror-Rx-Ry" in orbit.provenance["start"]
    assert orbit.energy == pytest.approx(float(three_body_energy(orbit.state)), abs=1e-12)


def three_body_energy(x: np.ndarray) -> float:
    """Of unit masses, written by hand."""
    r, far, u, w = x[:2], x[2:4], x[4:6], x[6:]
    gaps = np.linalg.norm([r, far - r / 2, far + r / 2], axis=1)
    return u @ u / 4 + w @ w / 3 - (1 / gaps).sum()


@pytest.mark.slow
@pytest.mark.parametrize("name", PRINTED)
def test_families_begin_where_they_were_certified(name):
    """`continue` refused each: its equal steps lost the motion, and nodes between encounters lost Newton's method."""
    orbit = of.find_orbit(printed(name))
    family = of.follow_family(orbit, "energy", model=three_bodies(), points=2)
    assert len(family.points) == 5 and all(end.kind == "point limit" for end in family.ends)
    scaled = [point.period * abs(point.value) ** 1.5 for point in family.points]  # Kepler's third law
    assert scaled == pytest.approx([orbit.period * abs(orbit.energy) ** 1.5] * 5, rel=1e-9)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:invariants")  # two more are at 1 to 1e-4
def test_what_only_quadruple_precision_closes_is_certified():
    """Yin-yang IIb passes at 1e-4 of the distances: DOP853 closes it to 5e-7, long double to 6e-11, known to 1e-7."""
    orbit = of.find_orbit(printed("yin-yang IIb", 0.417343, 0.313100, 54.207599))
    assert orbit.period == pytest.approx(54.207599, rel=1e-5) and orbit.certificate.passed
    checks = {check.name: check.value for check in orbit.certificate.checks}
    assert checks["closure"] < 1e-12 and checks["trivial_multipliers"] < 1e-12
    moved = replace(orbit, state=orbit.state + 1e-8 * np.eye(8)[6])
    assert not of.certify(moved, three_bodies()).passed


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:invariants")
def test_what_is_recorded_is_known_in_long_double():
    """Li and Liao's II.Cic166 from five digits: double precision leaves it before it is over, so that nodes, samples
    and action were off by hundreds; its multipliers are known to five digits."""
    orbit = of.find_orbit(printed("II.Cic166", 0.36386, 0.37702, 191.67264))
    assert orbit.period == pytest.approx(191.67264, rel=1e-4)
    assert set(orbit.certificate.failures) <= {"trivial_multipliers", "floquet_multipliers"}
    energies = [three_body_energy(x) for x in orbit.samples]
    assert energies == pytest.approx([orbit.energy] * len(energies), abs=1e-9)


FREE_FALL = {
    "F1": (0.0207067154, 0.3133550361, 2.1740969264), "F2": (0.2053886532, 0.1952668419, 1.6896364928),
    "F3": (0.0562664280, 0.4691503375, 4.5419125588), "F4": (0.1846729355, 0.5753740774, 5.1586391029),
}  # fmt: skip
"""Where the third of three equal bodies begins at rest, and the period: X. Li, S. Liao, New Astronomy 70 (2019) 22"""


@pytest.mark.slow
@pytest.mark.parametrize("name", FREE_FALL)
def test_free_falls_are_certified_in_long_double(name):
    """From rest to rest and back; gradients where a motion ends were taken where double precision ends, 1e-5 beside."""
    x, y, period = FREE_FALL[name]
    model, state = of.bodies([1, 1, 1], [[-0.5, 0], [0.5, 0], [x, y]], np.zeros((3, 2)))
    orbit = of.find_orbit(of.Problem(model, of.Guess(state, period)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period == pytest.approx(period, abs=1e-9) and orbit.certificate.closure < 1e-8
    beside = replace(orbit, period=orbit.period * (1 + 1e-7))
    assert {"distance", "integration"} & set(of.certify(beside, model).failures)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:invariants")
def test_what_mirrors_tell_of_an_orbit_with_a_double_unit_multiplier():
    """Butterfly IV passes within 1e-9 of the period; without its mirrors a singular value of 8e-14 is left."""
    orbit = of.find_orbit(printed("butterfly IV", 0.350112, 0.079339, 79.475859))
    assert orbit.period == pytest.approx(79.475859, rel=2e-5) and orbit.certificate.passed
    checks = {check.name: check.value for check in orbit.certificate.checks}
    assert checks["distance"] < 1e-12 and checks["resolution"] < 1e-12
    for wrong in (replace(orbit, period=orbit.period * (1 + 1e-8)), replace(orbit, state=orbit.state + 1e-8)):
        assert not of.certify(wrong, three_bodies()).passed


@pytest.mark.slow
def test_a_motion_on_which_double_precision_collides_is_certified():
    """O_5(0.1) of X. Li, S. Liao, arXiv 2508.08568, from its eight digits; a hundred-millionth beside it nothing is."""
    z, u, v, w, period = 0.80799207, 0.00382796, 0.0598614, 0.00397612, 29.56748228
    places, rates = [[-1, 0, 0], [1, 0, 0], [0, 0, z]], [[u, v, w], [u, v, -w], [-20 * u, -20 * v, 0]]
    model, state = of.bodies([1, 1, 0.1], places, rates)
    orbit = of.find_orbit(of.Problem(model, of.Guess(state, period)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert not of.certify(replace(orbit, period=orbit.period * (1 + 1e-8)), model).passed


@pytest.mark.slow
def test_what_no_precision_closes_is_said(monkeypatch):
    """Errors on the way of butterfly IV grow to more than the motion; every method says why it stopped."""
    monkeypatch.setattr(refine, "wide", lambda *_: None)  # without a compiler
    said = r"(?s)mirror-Rx-Ry: .* grow \de\+1\d times, so double .*; Newton.s .*, symmetry none: .*; IPOPT: "
    with pytest.raises(ConvergenceError, match=said):
        of.find_orbit(printed("butterfly IV", 0.350112, 0.079339, 79.475859))


def test_what_is_uneven():
    """A swing and the figure eight are not."""
    tame = (
        of.Problem(of.chain(1), of.Guess([1.0, 0.0], 1.6)),
        of.Problem(three_bodies(), of.Guess([2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.041333, -1.598184], 6.324449)),
    )
    assert [uneven(problem, flow_of(problem)) for problem in (*tame, printed("moth I"))] == [False, False, True]


def test_a_mesh_of_the_steps_that_dop853_takes():
    """Past an encounter at a hundredth of the distances its march ends where DOP853 does, equal steps elsewhere."""
    problem = printed("moth I")
    equations, guess = Equations(problem.model, NONE), problem.guess
    march = equations.march
    equal = equations.unknowns(guess.start[None], guess.period, np.linspace(0.0, 1.0, 401))
    fitting = stepped(equations, equal, np.ones(8))
    known = integrate(lambda t, y: march.rates(y[None], equal.tail, np.array([t]))[0], guess.start,
                      np.array([0.0, guess.period]))[-1]  # fmt: skip
    off = [np.abs(march.ends(w.nodes, w.mesh, w.tail)[0] - known).max() for w in (fitting, equal)]
    steps = np.diff(fitting.mesh)
    assert off[0] < 1e-9 and off[1] > 1e-3 and steps.max() > 20 * steps.min() > 0


def test_steps_judged_by_their_corrections_leave_a_valley():
    """Rosenbrock's valley as equations, (x, 1e6 (y - x^2)): halving by the rows creeps along it, corrections do not see
    its walls."""

    def rows(w: np.ndarray) -> np.ndarray:
        return np.array([np.arctan(w[0]), 1e6 * (w[1] - w[0] ** 2)])

    def linearised(w: np.ndarray):
        slopes = np.array([[1 / (1 + w[0] ** 2), 0.0], [-2e6 * w[0], 1e6]])
        return rows(w), lambda right: np.linalg.solve(slopes, -right)

    start = np.array([3.0, 9.0])
    settings = Settings(converged=1e-10, most_evaluations=30)
    solved = natural(start, linearised, rows, settings, np.add, np.ones(2))
    crept = full(start, linearised, Settings(converged=1e-10, most_evaluations=30, halving=True))
    assert solved.converged and np.abs(solved.w).max() < 1e-10
    assert not crept.converged


def test_where_no_solution_is_damped_steps_end():
    """x^2 + 1 = 0: at the least step, or where there are no numbers."""

    def rows(w: np.ndarray) -> np.ndarray:
        return w**2 + 1 if w[0] < 2 else np.full(1, np.nan)

    solved = natural(np.array([1.5]), lambda w: (rows(w), lambda right: -right / (2 * w + 1e-12)), rows,
                     Settings(most_evaluations=40), np.add, np.ones(1))  # fmt: skip
    assert not solved.converged
