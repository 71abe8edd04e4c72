"""Work shared between processors: the same numbers in the same order whatever the number of lanes."""

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate import parallel
from orbitfinder.integrate.compiled import compiling
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.integrate.march import uniform
from orbitfinder.integrate.rk8 import step_of, variational_field
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.symmetry import Symmetry
from orbitfinder.mechanisms.chain import chain


@pytest.fixture(scope="module")
def step():
    return step_of(variational_field(build_flow(chain(2)).field))


@pytest.mark.parametrize("segments", [1, 2, 5, 9])
def test_marches_do_not_depend_on_the_lanes(step, segments, monkeypatch):
    random, steps = np.random.default_rng(0), 12
    starts = random.normal(size=(segments, step.size1_in(0)))
    parameters = np.tile([0.01, *np.zeros(step.size1_in(1) - 1)], (segments * steps, 1))
    monkeypatch.setattr(parallel, "LANES", 1)
    alone = parallel.Lanes().marched(step, starts, parameters, True)
    monkeypatch.setattr(parallel, "LANES", 3)
    monkeypatch.setattr(parallel, "WORTH", 0.0)
    parallel._pool.cache_clear()
    for _ in range(20):
        shared = parallel.Lanes()
        np.testing.assert_array_equal(shared.marched(step, starts, parameters, True), alone)
        np.testing.assert_array_equal(shared.marched(step, starts, parameters, False), alone[steps - 1 :: steps])
    expected = step.mapaccum(steps)(starts[-1], parameters[:steps].T).full().T
    np.testing.assert_array_equal(alone[-steps:], expected)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 300])
def test_evaluations_do_not_depend_on_the_chunks(count, monkeypatch):
    x = ca.SX.sym("x", 3)
    function = ca.Function("f", [x], [ca.sin(x) * x[0]])
    places = np.random.default_rng(1).normal(size=(count, 3))
    monkeypatch.setattr(parallel, "LANES", 4)
    monkeypatch.setattr(parallel, "WORTH", 0.0)
    parallel._pool.cache_clear()
    found = parallel.Lanes().evaluated(function, 1, places)
    np.testing.assert_array_equal(found, function.map(count)(places.T).full().T)


def test_failure_in_a_lane_is_the_callers(monkeypatch):
    def task(lane):
        if lane == 1:
            raise IntegrationError("lane 1")
        return [np.zeros(1)]

    parallel._pool.cache_clear()
    with pytest.raises(IntegrationError, match="lane 1"):
        parallel._shared(task, 2, 2)


def test_little_work_stays_in_one_lane(step, monkeypatch):
    monkeypatch.setattr(parallel, "LANES", 4)
    assert parallel._lanes(step, 8, 1) == 1
    assert parallel._lanes(step, 8, 10_000) == 4 and parallel._lanes(step, 2, 10_000) == 2


@pytest.mark.parametrize("mode", ["on", "off"])
@pytest.mark.parametrize("segments", [1, 2, 8])
@pytest.mark.parametrize("system", ["forced", "autonomous", "two arcs"])
def test_loops_beside_each_other_are_those_one_after_another(system, segments, mode):
    """To the last bit, whatever is forced, linked or compiled; a failure names the segment's own state."""
    model, free = {
        "forced": (of.systems.forced_duffing(), ("frequency", "force")), "autonomous": (of.systems.van_der_pol(), ()),
        "two arcs": (of.systems.slip_walker(), ("stiffness",)),
    }[system]  # fmt: skip
    equations, random = Equations(model, Symmetry(), free, action=True), np.random.default_rng(0)
    segments *= max(1, equations.links.count)
    mesh, nodes = uniform(1.0, segments, 4), random.uniform(0.1, 0.4, (segments, equations.size))
    with compiling(mode):
        w = equations.unknowns(nodes, 1.3, mesh)
        places = [w.moved(random.uniform(0.0, 0.01, w.vector.size)) for _ in range(5)]
        for states in (True, False):
            for path, place in zip(equations.varied_each(places, states), places, strict=True):
                alone = equations.varied(place, states)
                for name in ("ends", "transitions", "columns", "states", "integral"):
                    np.testing.assert_array_equal(getattr(path, name), getattr(alone, name))
        places[3].nodes[-1] = np.inf
        with pytest.raises(IntegrationError) as raised:
            equations.varied_each(places)
        assert np.all(np.isinf(raised.value.state))
        assert raised.value.segment == segments // max(1, equations.links.count) - 1


@pytest.mark.parametrize("links", [3, 9])
def test_variations_are_those_of_the_field(links):
    """By columns of differences, whether the product with df/dx is written out (to 16 states) or sparse (beyond)."""
    field, random = build_flow(chain(links)).field, np.random.default_rng(1)
    size, extra = 2 * links, field.size1_in(2) + field.size1_in(3)
    x, columns = random.normal(size=size), random.normal(size=(size, size + extra))
    tail = [random.normal(size=field.size1_in(k)) for k in (2, 3)]
    found = variational_field(field)(0.1, np.concatenate([x, columns.ravel("F")]), *tail).full().ravel()
    rates, moving = found[:size], found[size : size + columns.size].reshape(columns.shape, order="F")
    np.testing.assert_array_equal(rates, field(0.1, x, *tail).full().ravel())
    for k in range(size + extra):
        ends = []
        for sign in (-1, 1):
            h = sign * 1e-6
            moved = [x + h * columns[:, k], *tail]
            if k >= size:
                own, place = (1, k - size) if k - size < tail[0].size else (2, k - size - tail[0].size)
                moved[own] = moved[own] + h * np.eye(moved[own].size)[place]
            ends.append(field(0.1, *moved).full().ravel())
        slope = (ends[1] - ends[0]) / 2e-6
        assert moving[:, k] == pytest.approx(slope, rel=1e-6, abs=1e-6 * np.abs(slope).max())
