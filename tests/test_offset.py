"""A constant added to the potential changes no motion: no orbit, no certificate, no family."""

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.families.point import FamilySettings
from orbitfinder.loops.loop import Equations, beyond
from orbitfinder.loops.problem import loop_of

SIZE, SMALL = 1e-3, 1e-5
"""of the planted orbits"""
OFFSETS = ((SIZE, 1e3), (SIZE, -1e6), (SIZE, 1e9), (SMALL, 1.0), (SMALL, -1e3))


def energy(size):
    """That of an orbit of so small a size, above its equilibrium."""
    return size**2 / 2 - size**3 / 3


def planted(offset, size=SIZE, **pins):
    """A small orbit in Hénon and Heiles' potential, steeper across, plus a constant."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    x, y = q[0], q[1]
    potential = offset + x**2 + y**2 / 2 + x**2 * y - y**3 / 3  # rounded at every sum
    model = of.lagrange(ca.sumsqr(v) / 2, potential, of.Symbols(q, v), names=["x", "y"])
    return of.Problem(model, of.Guess([0.0, size, size**2, 0.0], 2 * np.pi), of.pin(**pins))


@pytest.mark.parametrize(("size", "offset"), OFFSETS)
def test_found_and_refined(size, offset):
    """Nearest to the guess, at a place, and at an energy, which tells the size only to its own round-off."""
    told = 1e-14 + 4 * np.finfo(float).eps * abs(offset) / energy(size) * size**2  # the period changes with the energy
    plain = of.find_orbit(planted(0.0, size, y=size))
    pinned = planted(offset, size, y=size), planted(offset, size, energy=energy(size) + offset)
    for problem, known in zip((planted(offset, size), *pinned), (1e-13, 1e-14, told), strict=True):
        orbit = of.find_orbit(problem)
        assert orbit.certificate.passed, orbit.certificate.failures
        assert orbit.period == pytest.approx(plain.period, rel=known)
    for problem, known in zip(pinned, (1e-14, told), strict=True):
        refiner = of.Refiner(problem)
        refined = refiner.refine()
        assert refined.residual < 1e-13 and refined.jacobians <= 3
        assert refined.period == pytest.approx(plain.period, rel=known)
        assert refiner.orbit(refined).certificate.passed


def test_the_same_family():
    """Its points are the same to round-off, those at a given energy to what that is told to."""

    def family(offset):
        settings = FamilySettings(points=14, directions="forward")
        return of.follow_family(planted(offset, y=SIZE), "energy", until=4 * energy(SIZE) + offset, settings=settings)

    known, found = family(0.0), family(1e6)
    assert [end.kind for end in found.ends] == [end.kind for end in known.ends] == ["target"]
    assert len(found.points) == len(known.points)
    for one, other in zip(known.points[:-1], found.points[:-1], strict=True):
        assert other.period == pytest.approx(one.period, rel=1e-13)
        np.testing.assert_allclose(other.state, one.state, atol=1e-12 * SIZE)
    assert found.points[-1].period == pytest.approx(known.points[-1].period, rel=1e-9)
    assert abs(found.points[-1].energy - 1e6 - 4 * energy(SIZE)) <= 4 * np.finfo(float).eps * 1e6


def test_only_round_off_is_left_out():
    """What a pin may lose is some units in its last place, and nothing of the rows that close the loop."""
    problem = planted(1e6, energy=1e6 + energy(SIZE))
    equations = Equations(problem.model, problem.boundary)
    w = equations.unknowns(np.array([problem.guess.state]), 2 * np.pi, np.array([0.0, 1.0]))
    lost = loop_of(problem, equations, w, w.nodes[0], problem.pin).lost(w)
    assert 1e-10 < lost[-1] < 1e-9 and not lost[:-1].any()
    rows = np.array([1e-15, -1e-15, 0.0, 0.0, 0.0, 1.01 * lost[-1]])
    assert np.array_equal(beyond(rows, lost), rows)
    rows[-1] = -0.99 * lost[-1]
    assert np.array_equal(beyond(rows, lost), [1e-15, -1e-15, 0.0, 0.0, 0.0, 0.0])
