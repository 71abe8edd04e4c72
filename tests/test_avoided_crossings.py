"""Avoided crossings: x'' + x + x^3 + c y = 0, y'' + 3.1^2 y + c x = 0 at 3:1, and the quadruple pendulum's at 7:1.

Without the coupling c, y may swing by any amount where x swings at 3.1 / 3 rad/s: two families cross there. With c they
avoid each other across a gap that goes with sqrt(c), as y is forced by c times x's third harmonic.
"""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk

from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.verified import verified
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.records.family import load_family, save_family

FAST = 3.1
WIDTH = 0.0901
"""The gap at c = 0.1"""


def duffing_period(a: float) -> float:
    """Of x'' + x + x^3 = 0 from rest at a."""
    return 4 * ellipk(a * a / (2 * (1 + a * a))) / np.sqrt(1 + a * a)


RESONANT = brentq(lambda a: duffing_period(a) - 6 * np.pi / FAST, 0.1, 1.0)
"""Where x swings three times as slowly as y"""


def coupled(coupling: float):
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    potential = (q[0] ** 2 + FAST**2 * q[1] ** 2) / 2 + q[0] ** 4 / 4 + coupling * q[0] * q[1]
    return lagrange(ca.sumsqr(v) / 2, potential, Symbols(q, v), names=["x", "y"])


@pytest.fixture(scope="module")
def model():
    return coupled(0.1)


def followed(model, amplitude, folder, until=0.06, coupling=0.1, symmetry="brake+reflection", **settings):
    """The family of x's swing from an amplitude."""
    state = np.array([amplitude, -coupling * amplitude / (FAST**2 - 1), 0, 0])
    guess = Guess(state, duffing_period(amplitude))
    problem = Problem(model, guess, pin(x=amplitude), symmetry=symmetry, name="coupled")
    chosen = FamilySettings(**{"certify": False, "directions": "forward", "resonances": 2, **settings})
    return follow_family(problem, until=until, out=folder, settings=chosen, model=model)


def avoided(family):
    return [event for event in family.events if event.kind == "avoided_crossing"]


@pytest.mark.parametrize("amplitude", [0.1, 0.17, 0.2, 0.25])
@pytest.mark.parametrize(
    ("narrowest", "detail", "period"), [(0.2, "crossed", 6.03541977329796), (0.05, "followed", 6.0806527873487)]
)
def test_the_same_curve_from_every_first_amplitude(model, amplitude, narrowest, detail, period, tmp_path):
    """Which is crossed where the gap is narrower than what is asked for, and followed where it is wider."""
    family = followed(model, amplitude, tmp_path, narrowest=narrowest)
    (event,) = avoided(family)
    assert (event.detail, family.ends[-1].kind) == (detail, "target")
    assert event.gap == pytest.approx(WIDTH, rel=2e-3)
    assert family.points[-1].period == pytest.approx(period, rel=1e-11)
    assert abs(event.parameter - 0.046124) < event.error < 1e-4


@pytest.mark.parametrize("step", [0.02, 0.07, 0.2])
def test_the_same_curve_by_steps_of_every_length(model, step, tmp_path):
    """Of a tenth of the gap, of the gap, of twice the gap."""
    family = followed(model, 0.25, tmp_path, longest_step=step, first_step=step)
    assert [event.detail for event in avoided(family)] == ["crossed"]
    assert family.points[-1].period == pytest.approx(6.03541977329796, rel=1e-11)


def test_the_same_curve_backward(model, tmp_path):
    """Over to the family that the first orbits of the others are of, past the orbit nearest to it on this side."""
    family = followed(model, 0.4, tmp_path, until=0.03, directions="backward")
    (event,) = avoided(family)
    assert event.detail == "crossed" and event.gap == pytest.approx(WIDTH, rel=2e-3)
    assert abs(event.parameter - 0.050526) < event.error
    own = followed(model, 0.2, tmp_path / "forward", until=0.03)
    assert family.points[0].period == pytest.approx(own.points[-1].period, rel=1e-11)


@pytest.mark.parametrize("coupling", [0.1 / 4, 0.1 / 400])
def test_the_gap_goes_with_the_root_of_the_coupling(coupling, tmp_path):
    """And lies where the uncoupled oscillators resonate, by an elliptic integral."""
    (event,) = avoided(followed(coupled(coupling), 0.25, tmp_path, coupling=coupling))
    assert event.gap == pytest.approx(WIDTH * np.sqrt(coupling / 0.1), rel=1e-2)
    at = RESONANT**2 / 2 + RESONANT**4 / 4
    assert event.parameter == pytest.approx(at, abs=0.03 * event.gap)


@pytest.mark.parametrize("symmetry", ["brake", "none"])
def test_the_same_curve_in_formulations_of_less_symmetry(model, symmetry, tmp_path):
    family = followed(model, 0.25, tmp_path, symmetry=symmetry)
    (event,) = avoided(family)
    assert event.detail == "crossed" and event.gap == pytest.approx(WIDTH, rel=2e-3)
    assert family.points[-1].period == pytest.approx(6.03541977329796, rel=1e-11)


def test_families_that_cross_are_crossed_without_a_word(caplog, tmp_path):
    """Nothing is avoided where nothing is coupled."""
    family = followed(coupled(0.0), 0.25, tmp_path, coupling=0.0)
    assert not avoided(family) and not caplog.text
    assert family.points[-1].state[1] == 0.0


@pytest.fixture(scope="module", params=[0.2, 0.05])
def recorded(request, model, tmp_path_factory):
    """A family read from its file."""
    folder = tmp_path_factory.mktemp("recorded")
    family = followed(model, 0.25, folder / "run", narrowest=request.param)
    return load_family(save_family(family, folder / "kept"))


def event_checks(family, model, **changed):
    """Of the avoided crossing, with other entries."""
    family = replace(family, events=tuple(replace(event, **changed) for event in avoided(family)))
    return [check.passed for name, check in verified(family, model) if name.startswith("event")]


def test_a_recorded_avoided_crossing_verifies(recorded, model):
    """With the nodes beside family.json, and from its states alone."""
    alone = {"shooting_nodes": np.zeros((0, 0)), "mesh": np.zeros(0)}
    bare = replace(recorded, points=tuple(replace(point, **alone) for point in recorded.points))
    assert event_checks(recorded, model) == event_checks(bare, model, **alone) == [True]


@pytest.mark.parametrize("share", [0.5, 0.98, 1.02, 2.0, 0.0, np.inf, np.nan])
def test_another_gap_is_refused(recorded, model, share):
    (event,) = avoided(recorded)
    assert event_checks(recorded, model, gap=share * event.gap) == [False]


def test_another_side_is_refused(recorded, model):
    (event,) = avoided(recorded)
    other = {"crossed": "followed", "followed": "crossed"}[event.detail]
    assert event_checks(recorded, model, detail=other) == event_checks(recorded, model, gap=None) == [False]


def test_another_place_is_refused(recorded, model):
    """Another orbit of the family nearby, and one moved a little."""
    (event,) = avoided(recorded)
    near = recorded.points[event.index]
    place = {"state": near.state, "period": near.period, "energy": near.energy, "parameter": near.value}
    nodes = {"shooting_nodes": near.shooting_nodes, "mesh": near.mesh}
    assert event_checks(recorded, model, **place, **nodes) == [False]
    assert event_checks(recorded, model, state=event.state * [1 + 1e-6, 1, 1, 1]) == [False]


def test_no_other_event_passes_for_an_avoided_crossing(recorded, model):
    for kind in ("branch_point", "fold", "collision", "turn"):
        assert event_checks(recorded, model, kind=kind) == [False]


SWING = (0.01, 0.02, 0.03, 0.05, 0.07, 0.08, 0.1, 0.12, 0.15, 0.18, 0.2, 0.22)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("narrowest", "detail", "period"), [(0.2, "crossed", 3.33891567144982), (1e-3, "followed", 3.33886382333558)]
)
def test_the_slow_swing_of_four_links_is_one_curve(narrowest, detail, period, tmp_path):
    """From twelve first amplitudes (rad)."""
    for amplitude in SWING:
        problem, settings = (
            mode_problem(chain(4), 1, amplitude),
            FamilySettings(certify=False, directions="forward", narrowest=narrowest, resonances=2),
        )
        family = follow_family(problem, until=-77.2, out=tmp_path / str(amplitude), settings=settings)
        (event,) = avoided(family)
        assert event.detail == detail and event.gap == pytest.approx(0.03166, rel=2e-3)
        assert abs(event.parameter + 77.46422) < event.error
        assert family.points[-1].period == pytest.approx(period, rel=1e-11)


@pytest.mark.slow
def test_a_crossed_family_that_comes_back_is_closed(tmp_path):
    """The crossing that led to the closed family of four links is followed when it is met again."""
    settings = FamilySettings(certify=False, directions="forward", resonances=2)
    family = follow_family(mode_problem(chain(4), 1), points=200, out=tmp_path, settings=settings)
    assert [event.detail for event in avoided(family)] == ["crossed", "followed"]
    assert family.ends[-1].kind == "returned"
    assert min(event.parameter for event in family.events if event.kind == "fold") == pytest.approx(
        -77.45082410, abs=1e-8
    )
