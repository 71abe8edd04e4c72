"""Points of families in blocks of compiled code: the same as one by one, whatever block they are in."""

from __future__ import annotations

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.families.run import accepted
from orbitfinder.integrate.compiled import compiling
from orbitfinder.loops import block
from orbitfinder.loops.block import Blocks
from orbitfinder.loops.continued import advanced, correct, plane, tangent

PROBLEMS = {
    "duffing": ("problems/families/duffing-resonance.toml", "frequency"),
    "van der Pol": ("problems/gallery/van-der-pol.toml", "damping"),
    "triple": ("problems/report/triple-2.toml", "energy"),
    "a length held in energy": ("problems/report/triple-1.toml", "length1"),
}


@pytest.fixture(params=list(PROBLEMS))
def family(request):
    """An orbit and a parameter."""
    file, parameter = PROBLEMS[request.param]
    return of.find_orbit(of.load_problem(file)), parameter


class Counted(Blocks):
    """Blocks that are kept, each with where it began."""

    made: list[tuple]

    def _made(self, curve, start, length):
        ahead = super()._made(curve, start, length)
        self.made.append((curve, start, tuple(ahead)))
        return ahead


def followed(orbit, parameter, monkeypatch, points: int = 12) -> tuple[list, list[tuple]]:
    """Points of a family, and the blocks that they came in."""
    made = Counted.made = []
    compiled = Blocks.of.__func__
    monkeypatch.setattr(Blocks, "of", classmethod(lambda cls, *given: compiled(Counted, *given)))
    settings = of.FamilySettings(points=points, directions="forward", certify=False, events=False, longest_step=0.1)
    points = of.follow_family(orbit, parameter, settings=settings).points
    monkeypatch.undo()
    return points, made


def test_points_are_those_of_newton(family, monkeypatch):
    """Every w of a block to 1e-12 of what errors grow by, and its tangents, by the corrector in NumPy."""
    points, made = followed(*family, monkeypatch)
    grown = max(point.scale for point in points)
    assert any(ahead for *_, ahead in made)
    for curve, (w, whole, bend), ahead in made:
        for point in ahead:
            length = point.length
            aim, guess = plane(curve, w, whole, length), advanced(w, whole, length, bend)
            solution = correct(curve, guess, aim, w, reach=0.5 * length + 1e-9)
            columns = curve.scales.columns(w)
            gap = (solution.place.vector - point.solution.place.vector) / columns
            assert np.abs(gap).max() <= 1e-12 * grown
            along = tangent(curve, solution, whole)
            assert np.abs((along - point.whole) / columns).max() <= 1e-8 * grown
            stands = point.accepted
            here = accepted(curve, w, point.solution, point.whole)
            assert stands.curve.scales.columns(w) == pytest.approx(here.curve.scales.columns(w), rel=1e-13)
            assert np.abs((stands.whole - here.whole) / columns).max() <= 1e-11 * grown
            assert np.abs((stands.bend - here.bend) / columns).max() <= 1e-8 * grown
            assert stands.solution.march.integral == pytest.approx(here.solution.march.integral, rel=1e-13)
            curve, w, whole, bend = stands.curve, stands.solution.place, stands.whole, stands.bend


def test_a_point_is_the_same_in_any_block(family, monkeypatch):
    points, _ = followed(*family, monkeypatch)
    monkeypatch.setattr(block, "FEWEST", 1)
    monkeypatch.setattr(block, "MOST", 1)
    others, made = followed(*family, monkeypatch)
    assert max(len(ahead) for *_, ahead in made) == 1
    for point, other in zip(points, others, strict=True):
        np.testing.assert_array_equal(point.shooting_nodes, other.shooting_nodes)
        assert point.period == other.period and point.arclength == other.arclength


def test_without_a_compiler_there_are_none():
    orbit = of.find_orbit(of.load_problem(PROBLEMS["duffing"][0]))
    settings = of.FamilySettings(points=2, directions="forward", certify=False, events=False)
    with compiling("off"):
        assert len(of.follow_family(orbit, "frequency", settings=settings).points) == 3
