"""Points of families in blocks of compiled code: the same as one by one, whatever block they are in."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.families.start import begin
from orbitfinder.integrate.compiled import available, compiling
from orbitfinder.loops import block
from orbitfinder.loops.block import Blocks
from orbitfinder.loops.conditions import clock
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
        self.made.append((curve, self._pacing, tuple(ahead)))
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
    """Each is what NumPy's corrector makes of the step: orbit, tangent, action and how long the step is, to 1e-12 of
    what errors grow by, as long as both have one mesh; and at the values of all others it finds the same orbits."""
    orbit, parameter = family
    settings = of.FamilySettings(parameter, points=12, directions="forward", certify=False, events=False)
    start = begin(orbit, settings)
    points, made = followed(start, parameter, monkeypatch)
    assert any(ahead for *_, ahead in made)
    with compiling("off"):
        single = of.follow_family(start, settings=replace(settings, longest_step=0.1)).points
        known = of.follow_family(start, at=[point.value for point in points[1:]], settings=settings).points
    grown = max(point.scale for point in points)
    alike = [one.mesh.shape == two.mesh.shape and np.allclose(one.mesh, two.mesh, rtol=0, atol=1e-5)
             for one, two in zip(points, single, strict=True)]  # fmt: skip
    count = [*alike, False].index(False)
    count = next((k + 1 for k in range(1, count) if np.any(points[k].mesh != single[k].mesh)), count)
    assert count > 1
    for point, other in zip(points[:count], single, strict=False):
        sizes = np.abs(point.shooting_nodes).max(axis=0)
        assert np.abs((point.shooting_nodes - other.shooting_nodes) / sizes).max() <= 1e-12 * grown
        assert abs(point.period / other.period - 1) <= 1e-12 * grown
        assert np.abs(point.tangent - other.tangent).max() <= 1e-8 * grown * np.abs(point.tangent).max()
        assert point.action == pytest.approx(other.action, rel=1e-13 * grown)
        assert point.step == pytest.approx(other.step, rel=1e-6) and point.arclength == pytest.approx(other.arclength)
    exact = {point.value: point for point in known}
    for point in points[1:]:
        other = exact[min(exact, key=lambda value, point=point: abs(value - point.value))]
        for name in ("value", "period", "action"):
            one, two = getattr(point, name), getattr(other, name)
            assert (np.isnan(one) and np.isnan(two)) or abs(one - two) <= 1e-12 * grown * max(abs(two), 1e-3), name
        (rate, slope), (again, there) = ((each.tangent[point.state.size], each.tangent) for each in (point, other))
        if parameter in point.free:  # dT/dp, whatever the phase is
            assert rate / slope[-1] == pytest.approx(again / there[-1], rel=1e-8 * grown)


def test_steps_and_meshes_of_a_block_are_what_their_rules_say(family, monkeypatch):
    """The next length by the pace, and the mesh of an orbit by what its steps are off; where it is stale, or far too
    fine, the driver sees to it first."""
    _, made = followed(*family, monkeypatch)
    for curve, pacing, ahead in made:
        for point in ahead:
            wanted = pacing.next(point.length, point.turn, point.stretch, point.missed)
            assert point.next == pytest.approx(wanted, rel=1e-6)
            there, march = point.solution.place, curve.equations.march
            steps = np.arange(there.mesh.size - 1)
            errors = march.step_errors(point.solution.march.states, there.mesh, there.tail, curve.units, steps)
            stale, some = errors.max() / (MESH.stale * STEP_ERROR), errors[:: MESH.sampled]
            needed = MESH.spare * ((some / STEP_ERROR) ** 0.125).sum() / some.size
            if point.fits:
                assert stale < 1 + 1e-6 and needed > 1 - 1e-6
            else:
                assert point is ahead[-1] and (stale > 1 - 1e-6 or needed < 1 + 1e-6)


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
