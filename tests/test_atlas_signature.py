"""Same orbit or another: images and phase shifts are the same, other orbits are not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from orbitfinder.atlas.attempt import Job, attempts
from orbitfinder.atlas.signature import (
    DISTANCE,
    LOOP_SAMPLES,
    Signature,
    distance,
    images,
    in_words,
    same_orbit,
    signature_of,
    turning_points,
)
from orbitfinder.atlas.starts import Target, context_of, make_start
from orbitfinder.integrate.cvodes import build_flow, end_state
from orbitfinder.mechanics.model import between
from orbitfinder.mechanisms.chain import chain


@pytest.fixture(scope="module")
def signatures(report_orbits):
    return {name: signature_of(orbit, chain(orbit.state.size // 2)) for name, orbit in report_orbits.items()}


def test_images_and_phase_shifts_are_the_same_orbit(signatures):
    """Reflection, time reversal, both, each from another point of the loop."""
    for one in signatures.values():
        for image in images(one.loop, len(one.angles)):
            assert same_orbit(one, replace(one, loop=np.roll(image, LOOP_SAMPLES // 3, axis=0)))


@pytest.mark.parametrize("share", [0.1234, 0.5017, 0.87654])
def test_the_phase_is_found_between_the_samples(report_orbits, share):
    """Found again from a point of the loop between two samples: the loops lie over each other far below `DISTANCE`."""
    for orbit in report_orbits.values():
        model = chain(orbit.state.size // 2)
        moved = end_state(build_flow(model), orbit.state, share * orbit.period)
        again = replace(orbit, state=moved, nodes=moved[None], times=np.zeros(0), samples=np.zeros((0, moved.size)))
        assert distance(signature_of(orbit, model), signature_of(again, model)) < DISTANCE / 4


def test_turning_points_are_counted(signatures):
    """A slow swing at twice, three times and never; every image from anywhere on the loop; noise does not turn."""
    t = np.arange(LOOP_SAMPLES) * 2 * np.pi / LOOP_SAMPLES
    noise = 1e-14 * np.random.default_rng(0).normal(size=t.size)
    q = np.array([np.cos(t), np.sin(2 * t) + 0.1, noise, t]).T
    v = np.array([-np.sin(t), 2 * np.cos(2 * t), noise, 1.0 + 0 * t]).T
    made = Signature(0.0, 2 * np.pi, 1.0, np.hstack([q, v]), (True,) * 4)
    assert turning_points(made) == (2, 4, 0, 0)
    assert turning_points(replace(made, loop=q[:, :3], angles=(False,) * 3))[:2] == (2, 4)
    for one in [made, *signatures.values()]:
        for image in images(one.loop, len(one.angles)):
            moved = replace(one, loop=np.roll(image, LOOP_SAMPLES // 3, axis=0))
            assert turning_points(moved) == turning_points(one)


def test_a_signature_in_words(report_orbits, signatures):
    """Turns of a running orbit are the same both ways; a hybrid orbit is its events, from the first in the alphabet."""
    orbit, one = report_orbits["triple-1"], signatures["triple-1"]
    told = " ".join(map(str, turning_points(one)))
    assert in_words(orbit, one) == told
    assert {in_words(replace(orbit, winding=k), one) for k in ((0, -1, 2), (0, 1, -2))} == {f"{told} turns 0 1 -2"}
    hybrid = replace(orbit, system={"cycle": ["strike", "knee", "strike"]})
    assert in_words(hybrid, replace(one, arcs=3)) == "knee strike strike"


def test_other_orbits_are_other(signatures):
    """No two of the report's orbits are the same, nor is a loop moved off itself."""
    names = list(signatures)
    assert not any(same_orbit(signatures[a], signatures[b]) for a in names for b in names if a != b)
    one = signatures["triple-1"]
    assert not same_orbit(one, replace(one, loop=one.loop * 1.01))


def test_starts_depend_on_seed_and_index_alone():
    """The same number makes the same start in another context; an orbit found keeps the energy."""
    target = Target(-30.0, (0.5, 6.0))
    first, second = context_of(chain(3), target), context_of(chain(3), target)
    one, other = make_start(first, 0, 2), make_start(second, 0, 2)
    assert np.array_equal(one.state, other.state) and one.period == other.period
    found = [attempts(first, 0, [Job(k, True)], ())[0].orbit for k in range(7)]
    assert any(found) and all(abs(orbit.energy + 30.0) < 1e-10 for orbit in found if orbit)


def test_states_between_samples_are_those_of_scipys_splines():
    """Coordinates by Hermite's cubics through places and rates, inside and at the ends; all by splines where n = d."""
    random, times = np.random.default_rng(0), np.array([0.0, 0.3, 0.4, 1.1])
    states, moments = random.normal(size=(4, 6)), np.array([[0.0, 0.3, 1.1], [0.05, 0.39, 0.8]])
    spline = CubicHermiteSpline(times, states[:, :3], states[:, 3:])
    wanted = np.concatenate([spline(moments), spline(moments, 1)], axis=-1)
    assert np.allclose(between(times, states, 3, moments), wanted, rtol=1e-12, atol=1e-13)
    assert np.allclose(between(times, states, 6, moments), CubicSpline(times, states)(moments), rtol=1e-12)
    assert between(times, states, 3, 0.35).shape == (6,)
