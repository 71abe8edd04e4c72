"""One Symmetry: its rows, the whole orbit from a part, the monodromy from a part's, and what it removes."""

from dataclasses import replace

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.families.start import begin
from orbitfinder.integrate.cvodes import build_flow, transition
from orbitfinder.integrate.rk8 import march
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import (
    BRAKE,
    BRAKE_MAP,
    NONE,
    QUARTER,
    REFLECTION,
    REFLECTION_MAP,
    REVERSAL,
    REVERSAL_MAP,
    SYMMETRIES,
    Involution,
    Symmetry,
    has,
    named,
    recognise,
    symmetries_of,
    undeclared_mirrors,
)
from orbitfinder.mechanics.model import altered, vector_field
from orbitfinder.mechanisms.library import (
    henon_heiles,
    pendulum_on_cart,
    planar_oscillator,
    restricted_three_body,
)
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.problemfile.read import load_problem

FORWARD = Involution("swap", 1, 1, order=(1, 0))
ODD_SWAP = Involution("odd swap", -1, (-1, -1), order=(1, 0))
HALF_TURNED = Symmetry((Involution("mirror", -1, (1, -1)),))
ALL = (*SYMMETRIES.values(), HALF_TURNED, Symmetry((FORWARD,)), Symmetry((ODD_SWAP,)),
       Symmetry((Involution("x", -1, (1, -1)), Involution("y", 1, (-1, 1)))))  # fmt: skip


SYSTEMS = (of.chain(1), of.chain(2), pendulum_on_cart(stiffness=2.0), planar_oscillator())


@pytest.fixture(scope="module")
def orbits():
    """(model, orbit) of motions from rest through q = 0, which have every usual symmetry."""
    return [(model, find_orbit(mode_problem(model, 1, 0.2))) for model in SYSTEMS]


def part(model, orbit, symmetry):
    """Times and states over the part of the period that a symmetry integrates, from where it must start."""
    field, steps, start = vector_field(model, (), ()), 800, np.asarray(orbit.state)
    if symmetry == REVERSAL:  # a quarter after rest
        start = march(field, start, orbit.period / 4, steps, np.zeros(0))[-1]
    end = orbit.period * symmetry.fraction
    return np.linspace(0.0, end, steps + 1), march(field, start, end, steps, np.zeros(0))


@pytest.mark.parametrize("symmetry", SYMMETRIES.values(), ids=lambda one: one.name)
def test_rows_vanish_and_the_part_makes_the_whole(orbits, symmetry):
    """On a found orbit B0 x(0) + B1 x(end) is the constant, and the part completed is the motion by integration."""
    for model, orbit in orbits:
        times, states = part(model, orbit, symmetry)
        n = model.degrees_of_freedom
        first, last = symmetry.rows(n)
        constant = symmetry.constants(np.asarray(model.angles), states[0], states[-1], orbit.winding)
        np.testing.assert_allclose(first @ states[0] + last @ states[-1], constant, atol=1e-10)
        assert not symmetry.turns(constant).any() and symmetry.closes(states, np.asarray(model.angles)) < 1e-9
        assert symmetry.held_by(model, states[0])
        made, whole = symmetry.whole(times, states, constant)
        truth = march(vector_field(model, (), ()), states[0], orbit.period, len(made) - 1, np.zeros(0))
        assert made[-1] == pytest.approx(orbit.period, rel=1e-14) and len(made) == symmetry.parts * (len(times) - 1) + 1
        np.testing.assert_allclose(whole, truth, atol=1e-9)
        np.testing.assert_allclose(symmetry.whole(times, states)[1], whole, atol=1e-9)


@pytest.mark.parametrize("symmetry", SYMMETRIES.values(), ids=lambda one: one.name)
def test_the_root_of_the_monodromy_makes_the_whole_one(orbits, symmetry):
    """root^power, of the part's state-transition matrix alone, is that of the period."""
    for model, orbit in orbits:
        _, states = part(model, orbit, symmetry)
        flow = build_flow(model)
        horizon, whole = (transition(flow, states[0], orbit.period * share, 0.0)[1] for share in (symmetry.fraction, 1))
        root, power = symmetry.root(horizon, lambda other, a=horizon: np.linalg.solve(a, other), len(horizon))
        np.testing.assert_allclose(np.linalg.matrix_power(root, power), whole, atol=1e-6 * np.abs(whole).max())


@pytest.mark.parametrize("symmetry", ALL, ids=lambda one: one.name)
def test_involutions_are_involutions_and_rows_hold_their_fixed_sets(symmetry):
    """Twice is once not at all; n rows at either end of a motion that reverses; the whole closes for any such ends."""
    n, random = 2, np.random.default_rng(1)
    for one in symmetry.both:
        np.testing.assert_array_equal(one.matrix(n) @ one.matrix(n), np.eye(2 * n))
    first, last = symmetry.rows(n)
    assert np.linalg.matrix_rank(np.hstack([first, last])) == 2 * n
    constant = np.zeros(2 * n)
    start = random.normal(size=2 * n)
    if symmetry.reverses:
        project = [np.eye(2 * n) - np.linalg.pinv(rows) @ rows for rows in (first, last)]
        states = np.vstack([project[0] @ start, random.normal(size=(3, 2 * n)), project[1] @ random.normal(size=2 * n)])
    else:
        states = np.vstack([start, random.normal(size=(3, 2 * n)), symmetry.displaced(constant)[0] @ start])
    times, whole = symmetry.whole(np.arange(5.0), states, constant)
    assert len(times) == len(whole) == 4 * symmetry.parts + 1 and times[-1] == 4 * symmetry.parts
    np.testing.assert_allclose(whole[-1], whole[0], atol=1e-12)


@pytest.mark.parametrize("symmetry", ALL, ids=lambda one: one.name)
def test_samples_tell_their_symmetry(symmetry):
    """Made of the harmonics that a symmetry leaves, and of no others, a motion is seen to have that symmetry."""
    n, random = 2, np.random.default_rng(3)
    times = np.linspace(0.0, 2 * np.pi, 513)
    q = np.zeros((times.size, n))
    v = np.zeros_like(q)
    for k in (1, 2, 3):
        cosine, sine = random.normal(size=(2, n)) / k**2
        q += np.outer(np.cos(k * times), cosine) + np.outer(np.sin(k * times), sine)
        v += k * (np.outer(np.cos(k * times), sine) - np.outer(np.sin(k * times), cosine))
    motion = np.hstack([q, v])
    for one in symmetry.maps:  # the mean of the motion and of its image has the symmetry
        image = motion[::-1] if one.sense < 0 else np.vstack([motion[256:], motion[1:257]])
        motion = (motion + image @ one.matrix(n).T) / 2
    rolled = np.vstack([motion[100:], motion[1:101]])
    for one in symmetry.maps:
        assert has(one, times, rolled, np.zeros(n, bool))
    others = {BRAKE_MAP, REFLECTION_MAP, REVERSAL_MAP} - {*symmetry.both, *symmetry.maps}
    assert not any(has(one, times, rolled, np.zeros(n, bool)) for one in others)
    model = altered(henon_heiles(), symmetries=(("mirror", -1, (1, -1)),))
    if symmetry in (*SYMMETRIES.values(), HALF_TURNED):
        assert recognise(times, rolled, model) == symmetry.name


def test_angles_count_in_half_turns_and_in_whole_ones():
    """Rows are displaced to the centre that a motion is nearest to; winding adds up over the period."""
    angles = np.array([True, False])
    near = np.array([np.pi + 0.1, 0.2, 1.0, 2.0])
    np.testing.assert_allclose(REVERSAL.constants(angles, near, near), [np.pi, 0, np.pi, 0])
    turning = REVERSAL.constants(angles, near, None, (2, 0))
    np.testing.assert_allclose(turning, [np.pi, 0, 3 * np.pi, 0])
    np.testing.assert_array_equal(REVERSAL.turns(turning), [2, 0])
    np.testing.assert_array_equal(NONE.turns(NONE.constants(angles, near, near, (1, 0))), [1, 0])
    np.testing.assert_allclose(QUARTER.constants(angles, near, near), [0, 0, np.pi, 0])
    np.testing.assert_allclose(REFLECTION.constants(angles, near, near), [2 * np.pi, 0, 0, 0])
    np.testing.assert_array_equal(BRAKE.constants(angles, near, near), np.zeros(4))
    assert [list(one.may_turn(2)) for one in (NONE, REFLECTION, BRAKE, REVERSAL, QUARTER)] == [
        [True, True], [False, False], [False, False], [True, True], [False, False]
    ]  # fmt: skip
    np.testing.assert_allclose(QUARTER.centre(np.array([0.0, 0, np.pi, 0])), [np.pi, 0])
    assert np.isnan(BRAKE.centre(np.zeros(4))).all()


def test_what_the_rows_hold_twice_is_unfolded():
    """By the parity of each invariant: the momentum of a free cart, which running backwards turns round."""
    cart = pendulum_on_cart()
    momentum = [one.name for one in cart.invariants if one.generator is not None]
    energy = [one.name for one in cart.invariants if one.generator is None]
    wanted = {
        NONE: {*energy, *momentum},
        REFLECTION: set(energy),
        BRAKE: set(momentum),
        REVERSAL: set(),
        QUARTER: set(),
    }
    for symmetry, names in wanted.items():
        assert {one.name for one in symmetry.unfolded(cart)} == names, symmetry.name
        assert len(symmetry.generators(cart)) == len(names & set(momentum))


def test_a_name_is_known_where_it_is_declared():
    model = restricted_three_body()
    assert symmetries_of(model).keys() == {*SYMMETRIES, "mirror", "mirror+reflection"}
    assert symmetries_of(of.chain(2)) == SYMMETRIES
    with pytest.raises(InputError, match="unknown 'mirror'; use one of none, brake, reflection, reversal, brake"):
        named("mirror", of.chain(2))
    with pytest.raises(InputError, match=r"change under y -> -y, running the film backwards, so 'mirror' cannot"):
        named("mirror", model).check(altered(henon_heiles(), symmetries=model.symmetries), np.array([0.1, 0.2, 0, 0]))
    with pytest.raises(InputError, match="unknown 'mirror'"):
        Problem(of.chain(2), Guess([0.1, 0.1, 0, 0], 1.0), symmetry="mirror")


def test_half_of_a_lyapunov_orbit_is_enough():
    """Planar orbits about L1 of Earth and Moon: the mirrored half gives what the whole gives, and says so."""
    model, guess = restricted_three_body(0.0121505856), Guess([0.8234, 0.0, 0.0, 0.1263], 2.743)
    whole, half = (find_orbit(Problem(model, guess, pin=pin(x=0.8234), symmetry=one)) for one in ("none", "mirror"))
    assert whole.symmetry == half.symmetry == "mirror"
    assert half.certificate.failures == () and half.period == pytest.approx(whole.period, rel=1e-10)
    np.testing.assert_allclose(half.state[[1, 2]], 0.0, atol=1e-20)
    np.testing.assert_allclose(half.floquet_multipliers, whole.floquet_multipliers, rtol=1e-6)
    start = begin(half, model=model)
    assert start.curve.equations.symmetry.name == "mirror"
    assert start.solution.place.period == pytest.approx(half.period, rel=1e-9)
    elsewhere = np.asarray(whole.samples[len(whole.samples) // 8])
    begun = begin(replace(half, state=elsewhere, record=None), model=model)
    assert begun.curve.equations.symmetry.name == "mirror"


MIRRORED = """
[system]
kind = "python"
function = "restricted_three_body"
arguments = { ratio = 0.0121505856 }
[guess]
state = [0.8234, 0.0, 0.0, 0.1263]
period = 2.743
[find]
pin = { x = 0.8234 }
symmetry = "mirror"
"""


def test_a_problem_file_names_what_its_system_declares(tmp_path):
    """And only that: another name, or that name with another system, is bad input with the known ones."""
    path = tmp_path / "lyapunov.toml"
    path.write_text(MIRRORED)
    assert load_problem(path).boundary == HALF_TURNED
    path.write_text(MIRRORED.replace('"mirror"', '"miror"'))
    with pytest.raises(InputError, match=r"unknown 'miror'; use one of none, .*, mirror"):
        load_problem(path)
    path.write_text(MIRRORED.split("[system]")[0] + '[system]\nkind = "chain"\nlinks = 2\n' + "[guess]" +
                    MIRRORED.split("[guess]")[1])  # fmt: skip
    with pytest.raises(InputError, match=r"find.symmetry: unknown 'mirror'; use one of none, .*"):
        load_problem(path)


@pytest.mark.needs("proof")
def test_a_declared_mirror_proves_a_lyapunov_orbit():
    """Half of it in ball arithmetic: its symmetry is read off the equations' graph, coordinate by coordinate."""
    from orbitfinder.proof.theorem import prove

    model, guess = restricted_three_body(0.0121505856), Guess([0.8234, 0.0, 0.0, 0.1263], 2.743)
    orbit = find_orbit(Problem(model, guess, pin=pin(x=0.8234), symmetry="mirror"))
    proof = prove(orbit)
    assert proof.proved and proof.symmetry == "mirror"
    assert proof.period.contains(orbit.period) or abs(float(proof.period.mid()) - orbit.period) < 1e-11


def test_unknown_mirrors_are_found_and_told_apart_from_usual_ones():
    """Henon and Heiles's potential is even in x: its one mirror that has no usual name."""
    (one,) = undeclared_mirrors(henon_heiles())
    assert one.signs == (-1, 1) and one.moves(("x", "y")) == "x -> -x" and not undeclared_mirrors(of.chain(2))
