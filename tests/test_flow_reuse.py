"""A second search on the same Model reuses its integrators, and nothing that has changed is stale."""

import gc
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from conftest import pendulum_period

import orbitfinder as of
from orbitfinder.integrate import cvodes as flow
from orbitfinder.integrate.compiled import compiling
from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow, end_state
from orbitfinder.integrate.idas import DaeFlow, build_dae_flow
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.mechanics.kind import with_parameters

BARE = SolveSettings(with_certificate=False)


@pytest.fixture(autouse=True)
def empty():
    flow._small.clear()
    flow._large.clear()


def pendulum(model: of.Model, amplitude: float, **changes: object) -> of.Problem:
    problem = of.Problem(model, of.Guess([amplitude, 0.0], pendulum_period(amplitude)), of.pin(theta1=amplitude))
    return replace(problem, **changes)


def test_the_same_things_give_the_same_flow():
    model = of.chain(2)
    first = build_flow(model, ["length1"], model.invariants)
    assert build_flow(model, ("length1",), list(model.invariants), IntegratorSettings()) is first
    with compiling("off"):
        assert build_flow(model, ("length1",), model.invariants) is not first


@pytest.mark.parametrize(
    "change",
    [
        {"free": ("mass1",)},
        {"free": ()},
        {"unfolded": ()},
        {"settings": IntegratorSettings(relative_tolerance=1e-9)},
        {"settings": IntegratorSettings(max_steps=7)},
    ],
    ids=["free", "nothing free", "unfolded", "tolerance", "steps"],
)
def test_what_determines_a_flow_makes_another(change):
    model = of.chain(2)
    given = {"free": ("length1",), "unfolded": model.invariants, "settings": IntegratorSettings()}
    first, other = build_flow(model, **given), build_flow(model, **given | change)
    assert other is not first
    wanted = given | change
    assert (other.free, other.unfolded, other.settings) == tuple(wanted.values())
    assert build_flow(model, **given) is first


def test_models_are_told_apart():
    """Equal ones, ones with another number, ones whose numbers are overwritten in place."""
    one, two = of.chain(1), of.chain(1)
    assert build_flow(one) is not build_flow(two) and build_flow(two).model is two
    longer = with_parameters(one, {"length1": 2.0})
    assert build_flow(longer) is not build_flow(one)
    state = np.array([1.0, 0.0])
    before = end_state(build_flow(one), state, 0.5)
    assert np.abs(end_state(build_flow(longer), state, 0.5) - before).max() > 0.01
    one.parameter_values[:] = longer.parameter_values
    assert np.array_equal(end_state(build_flow(one), state, 0.5), end_state(build_flow(longer), state, 0.5))


def test_few_are_remembered_and_larger_ones_fewer():
    for _ in range(12):
        build_flow(of.chain(1))
    assert len(flow._small) == 2
    for links in (9, 10):
        build_flow(of.chain(links))
    assert len(flow._large) == 1
    del links
    gc.collect()
    assert len(flow._small) == 2


def test_kinds_of_flow_are_told_apart():
    """The native flow of a system under constraints and that of its eliminated form, of the same Model."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    model = of.constrained(ca.sumsqr(v) / 2, -9.8 * q[0], ca.sumsqr(q) - 1, of.Symbols(q, v), names=["x", "y"],
                           baumgarte=of.Baumgarte(10, 10))  # fmt: skip
    native = build_dae_flow(model, (), model.invariants)
    assert isinstance(native, DaeFlow) and build_dae_flow(model, (), model.invariants) is native
    assert not isinstance(build_flow(model, (), model.invariants), DaeFlow)


def test_searches_on_one_model_share_its_integrators():
    model = of.chain(1)
    for amplitude in (0.5, 1.0, 2.0):
        found = of.find_orbit(pendulum(model, amplitude), BARE)
        assert found.period == pytest.approx(pendulum_period(amplitude), rel=1e-12)
    assert len(flow._small) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"pin": of.pin(theta1=1.2)},
        {"pin": of.pin(period=1.95)},
        {"pin": ()},
        {"symmetry": "brake"},
        {"segments": 3},
        {"bounds": {"period": (1.0, 3.0)}},
        {"free": ("length1",), "pin": of.pin(theta1=1.0, period=2.0)},
        {"model": of.chain(1, length=2.0), "guess": of.Guess([1.0, 0.0], 2.6)},
    ],
    ids=["pin", "other pin", "nearest", "symmetry", "segments", "bounds", "free", "model"],
)
def test_a_changed_problem_finds_what_it_finds_alone(change):
    """After other searches on the same Model, to the last bit."""
    model = of.chain(1)
    problem = replace(pendulum(model, 1.0), **change)
    wanted = of.find_orbit(problem, BARE)
    for settings in (BARE, replace(BARE, integrator=IntegratorSettings(1e-10, 1e-10))):
        of.find_orbit(pendulum(model, 1.0), settings)
        of.find_orbit(pendulum(model, 0.4, symmetry="brake"), settings)
    found = of.find_orbit(problem, BARE)
    assert (found.period, found.energy) == (wanted.period, wanted.energy)
    assert np.array_equal(found.samples, wanted.samples)
    assert np.array_equal(found.floquet_multipliers, wanted.floquet_multipliers)
    assert found.provenance.get("free") == wanted.provenance.get("free")
