"""Points of families in blocks of compiled code: the same as one by one, whatever block they are in."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.families.follow import PREDICTION
from orbitfinder.families.run import accepted
from orbitfinder.families.start import begin
from orbitfinder.integrate.compiled import available, compiling
from orbitfinder.loops import block
from orbitfinder.loops.block import Blocks, Pacing
from orbitfinder.loops.conditions import clock
from orbitfinder.loops.continued import advanced, correct, distance, plane, tangent
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.mesh import MESH, STEP_ERROR
from orbitfinder.loops.symmetry import NONE

pytestmark = pytest.mark.skipif(not available()[0], reason="no C compiler: " + available()[1])

PROBLEMS = {
    "duffing": ("problems/families/duffing-resonance.toml", "frequency"),
    "van der Pol": ("problems/gallery/van-der-pol.toml", "damping"),
    "triple": ("problems/report/triple-2.toml", "energy"),
    "a length held in energy": ("problems/report/triple-1.toml", "length1"),
}
PACING = Pacing(longest=0.1, sharpest=of.FamilySettings.sharpest_turn, stretch=of.FamilySettings.longest_stretch,
                prediction=PREDICTION)  # fmt: skip


@pytest.fixture(params=list(PROBLEMS))
def family(request):
    """An orbit and a parameter."""
    file, parameter = PROBLEMS[request.param]
    return of.find_orbit(of.load_problem(file)), parameter


class Counted(Blocks):
    """Blocks that are kept, each with where it began."""

    made: list[tuple]

    def _made(self, curve, start, length, count):
        ahead = super()._made(curve, start, length, count)
        self.made.append((curve, start, tuple(ahead)))
        return ahead


def followed(orbit, parameter, monkeypatch, points: int = 12, **how) -> tuple[list, list[tuple]]:
    """Points of a family, and the blocks that they came in."""
    made = Counted.made = []
    compiled = Blocks.of.__func__
    monkeypatch.setattr(Blocks, "of", classmethod(lambda cls, *given: compiled(Counted, *given)))
    how = {"longest_step": 0.1, **how}
    settings = of.FamilySettings(points=points, directions="forward", certify=False, events=False, **how)
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
            missed = distance(curve, guess, point.solution.place)
            turn = np.arccos(np.clip(np.sum(curve.scales.metric(w) * whole * point.whole), -1.0, 1.0))
            stretch = abs(point.solution.place.period / w.period - 1.0)
            assert point.next == pytest.approx(PACING.next(length, turn, stretch, missed), rel=1e-6)
            there, march = point.solution.place, curve.equations.march
            steps = np.arange(there.mesh.size - 1)
            errors = march.step_errors(point.solution.march.states, there.mesh, there.tail, curve.units, steps)
            stale, some = errors.max() / (MESH.stale * STEP_ERROR), errors[:: MESH.sampled]
            needed = MESH.spare * ((some / STEP_ERROR) ** 0.125).sum() / some.size
            if point.fits:
                assert stale < 1 + 1e-6 and needed > 1 - 1e-6
            else:  # the driver sees to its mesh first
                assert point is ahead[-1] and (stale > 1 - 1e-6 or needed < 1 + 1e-6)
            stands = point.accepted
            here = accepted(curve, w, point.solution, point.whole)
            assert stands.curve.scales.columns(w) == pytest.approx(here.curve.scales.columns(w), rel=1e-13)
            assert np.abs((stands.whole - here.whole) / columns).max() <= 1e-11 * grown
            assert np.abs((stands.bend - here.bend) / columns).max() <= 1e-8 * grown
            assert stands.solution.march.integral == pytest.approx(here.solution.march.integral, rel=1e-13)
            curve, w, whole, bend = stands.curve, stands.solution.place, stands.whole, stands.bend


def test_sharp_turns_and_long_stretches_are_the_drivers(monkeypatch):
    orbit = of.find_orbit(of.load_problem(PROBLEMS["duffing"][0]))
    for limit in ({"sharpest_turn": 0.02}, {"longest_stretch": 0.004}):
        _, made = followed(orbit, "frequency", monkeypatch, first_step=0.4, longest_step=0.5, **limit)
        points = [point for *_, ahead in made for point in ahead]
        assert points and not made[0][-1]
        assert all(point.turn <= limit.get("sharpest_turn", 1.0) for point in points)
        assert all(point.stretch <= limit.get("longest_stretch", 1.0) for point in points)


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


def test_conditions_of_another_name_or_number_of_cycles_are_others():
    """Two curves of the same equations, one of twice the forcing's period."""
    curve = begin(of.load_problem(PROBLEMS["duffing"][0]), of.FamilySettings(parameter="frequency")).curve
    twice = replace(curve, conditions=clock(curve.equations, 2))
    one, two = (block._compiled(each) for each in (curve, twice))
    assert one is not None and two is not None and one is not two
    assert block._compiled(curve) is one


def test_what_is_followed_again_derives_nothing_anew(monkeypatch):
    """Neither a family nor equilibria make a function of CasADi again; another thread has its own equations."""
    oscillator = of.systems.brusselator(rate=2.2)
    problem = of.Problem(oscillator, of.Guess([1.2, 1.9], 6.4))
    settings, made, function = of.FamilySettings(points=2, directions="forward"), [], ca.Function.__init__

    def follow():
        of.follow_family(problem, "rate", settings=settings)
        return of.follow_equilibria(oscillator, [1.0, 2.2], "rate", until=1.9)

    def counted(self, *how):
        made.extend(name for name in how[:1] if isinstance(name, str))
        function(self, *how)

    with compiling("off"):
        assert [event.kind for event in follow().events] == ["hopf"]
        monkeypatch.setattr(ca.Function, "__init__", counted)
        follow()
    assert not made
    own, given = Equations.of(oscillator, NONE, ("rate",)), (oscillator, NONE, ("rate",))
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(Equations.of, *given).result() is not own
    assert Equations.of(*given) is own


def test_conditions_on_more_than_the_head_are_left_to_newton():
    curve = begin(of.load_problem(PROBLEMS["duffing"][0]), of.FamilySettings(parameter="frequency")).curve
    (known,) = curve.conditions

    def everywhere(equations, nodes, period, free):
        return sum(node[0] for node in nodes) + 0 * period

    other = replace(curve, conditions=(replace(known, name="everywhere", expression=everywhere),))
    assert block._compiled(curve) is not None and block._compiled(other) is None
