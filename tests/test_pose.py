"""Mechanisms that are pulled by a point, and thrown."""

from pathlib import Path

import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.families.minimal import minimal_problem
from orbitfinder.mechanics.model import altered, constraint_of, positions
from orbitfinder.mechanisms.chain import chain
from orbitfinder.mechanisms.pose import movable, pulled, thrown
from orbitfinder.problemfile.read import load_problem

PROBLEMS = Path(__file__).parents[1] / "problems"


def at(model, state, point):
    return positions(model, state[None])[0, :, point]


def test_a_tip_goes_where_it_is_pulled_and_no_further_than_its_links():
    model, start = chain(3), np.array([0.3, 0.5, 0.2, 1.0, 0.0, 0.0])
    near = pulled(model, start, 3, np.array([1.0, 1.6]))
    assert at(model, near, 3) == pytest.approx([1.0, 1.6], abs=1e-9) and np.all(near[3:] == 0)
    far = pulled(model, start, 3, np.array([5.0, 5.0]))  # all links in line towards it
    assert at(model, far, 3) == pytest.approx(3.0 * np.sqrt([0.5, 0.5]), abs=2e-3)


@pytest.mark.parametrize("file, point", [("linkages/five-bar-saddle", 2), ("mechanisms/delta", 3)])
def test_both_descriptions_of_a_mechanism_follow_the_hand_alike(file, point):
    native = load_problem(PROBLEMS / f"{file}.toml")
    least = minimal_problem(native)
    first, second = (np.asarray(one.guess.state, float) for one in (native, least))
    place = at(native.model, first, point) + 0.05 * np.abs(positions(native.model, first[None])).max() * np.array(
        [1, -1]
    )
    first, second = pulled(native.model, first, point, place), pulled(least.model, second, point, place)
    q = first[: native.model.degrees_of_freedom]
    assert np.abs(constraint_of(native.model).phi(q, native.model.parameter_values).full()).max() < 1e-14
    assert at(native.model, first, point) == pytest.approx(place, abs=1e-9)
    assert at(least.model, second, point) == pytest.approx(place, abs=1e-9)
    velocity = np.array([0.3, -0.2])
    for model, state in ((native.model, first), (least.model, second)):
        state, n = thrown(model, state, point, velocity), model.degrees_of_freedom
        later, before = (np.concatenate([state[:n] + s * 1e-6 * state[n:], state[n:]]) for s in (1, -1))
        assert (at(model, later, point) - at(model, before, point)) / 2e-6 == pytest.approx(velocity, abs=1e-5)
    assert point in movable(native.model, first)
    assert movable(native.model, first) == movable(least.model, second)


def test_a_point_goes_as_near_as_it_can_to_a_place_that_it_cannot_reach():
    model, start = minimal_problem(load_problem(PROBLEMS / "linkages" / "four-bar-rocking.toml")).model, [0.6, 0.0]
    place = np.array([0.428815223537083, 0.3126474931745504])  # steps that help in a row leave hardly any damping
    near = pulled(model, np.array(start), 2, place)
    far = [np.linalg.norm(at(model, np.array([near[0] + turn, 0.0]), 2) - place) for turn in (-0.03, 0.0, 0.03)]
    assert far[1] == min(far) < np.linalg.norm(at(model, np.array(start), 2) - place)


def test_what_moves_in_space_is_pulled_and_thrown_in_space():
    model, start = load_problem(PROBLEMS / "mechanisms" / "furuta.toml").model, np.array([0.0, 1.2, 0.0, 0.0])
    tip = positions(model, start[None], "space").shape[2] - 1
    wanted = positions(model, np.array([[0.7, 1.5, 0.0, 0.0]]), "space")[0, :, tip]
    near = pulled(model, start, tip, wanted)
    assert positions(model, near[None], "space")[0, :, tip] == pytest.approx(wanted, abs=1e-9)
    moving = np.array([0.0, 1.2, 1.0, -0.5])
    step = 1e-6 * np.array([*moving[2:], 0.0, 0.0])
    ahead, behind = (positions(model, (moving + sign * step)[None], "space")[0, :, tip] for sign in (1, -1))
    assert thrown(model, start, tip, (ahead - behind) / 2e-6) == pytest.approx(moving, abs=1e-6)


def test_points_without_picture_and_dead_points():
    model, straight = chain(2), np.zeros(4)
    assert movable(model, straight) == [1, 2] and movable(altered(model, points=None), straight) == []
    lifted = thrown(model, straight, 2, np.array([-1.0, 0.0]))  # along the links: nothing follows
    assert np.abs(lifted[2:]).max() < 10.0
    for function in (pulled, thrown):
        with pytest.raises(InputError, match="point: 3 is none; this system draws points 0 to 2"):
            function(model, straight, 3, np.zeros(2))
