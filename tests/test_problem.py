"""Counting equations before solving, and refusing what cannot be solved."""

import casadi as ca
import numpy as np
import pytest

from orbitfinder.errors import CountError, InputError
from orbitfinder.loops.conditions import lowest_energy, pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.model import altered
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits import objectives
from orbitfinder.orbits.find import find_orbit


def problem(links=2, gravity=9.8, **changes) -> Problem:
    """A double pendulum from rest at 0.1 rad."""
    state = np.concatenate([np.full(links, 0.1), np.zeros(links)])
    return Problem(chain(links, gravity=gravity), **{"guess": Guess(state, 2.0), **changes})


def driven(period=np.pi):
    """A damped pendulum driven at 2 rad/s: no invariant."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    symbols = Symbols(q, v, time=t, forcing_period=period)
    return lagrange(0.5 * v**2, -ca.cos(q), symbols, forces=ca.cos(2 * t) - 0.1 * v)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@pytest.mark.parametrize("segments", [1, 2, 8])
@pytest.mark.parametrize("links", [1, 3])
def test_one_pin_makes_every_symmetry_square(symmetry, segments, links):
    """A conservative chain with one pin has as many equations as unknowns in every formulation."""
    count = problem(links, symmetry=symmetry, pin=pin(energy=1.0)).count(segments)
    assert count.freedom == 0
    assert count.unknowns["node states"] == 2 * links * segments
    assert count.equations["defects"] == 2 * links * (segments - 1)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_the_count_is_the_size_of_the_program(symmetry):
    """What count() says is what transcribe() builds: rows of g and length of w."""
    from orbitfinder.loops.shooting import transcribe

    one = problem(symmetry=symmetry, pin=pin(energy=1.0), free=("length2",))
    shooting = transcribe(one, np.tile(one.guess.state, (3, 1)))
    count = one.count(3)
    assert shooting.constraints.numel() == sum(count.equations.values())
    assert shooting.start.size == sum(count.unknowns.values())


def test_without_gravity_the_angular_momentum_is_unfolded_too():
    """With g = 0 the full formulation has two unfoldings, two phase conditions, and one pin is square."""
    count = problem(gravity=0.0, pin=pin(energy=1.0)).count(4)
    assert count.unknowns["unfolding"] == 2 and count.equations["phase conditions"] == 2
    assert count.freedom == 0


def test_no_pin_leaves_the_family_to_the_objective():
    """No pin leaves one unknown over, and freeing a parameter one more."""
    assert problem(pin=()).count().freedom == 1
    assert problem(free=("length2", "mass1")).count().freedom == 3
    assert problem(pin=pin(period=2.0), free=("length2",)).count().freedom == 1


@pytest.fixture
def no_solver(monkeypatch):
    """Any call of IPOPT or of an integrator fails the test."""

    def refuse(*_, **__):
        pytest.fail("solved before counting")

    monkeypatch.setattr(ca, "nlpsol", refuse)
    monkeypatch.setattr(ca, "integrator", refuse)
    monkeypatch.setattr(objectives, "solve_nlp", refuse)


def test_two_pins_are_refused_before_solving(no_solver):
    """An over-determined problem is a CountError with both counts, the room there is and the remedy."""
    with pytest.raises(CountError, match="over-determined") as caught:
        find_orbit(problem(pin=pin(energy=1.0, theta1=0.1)))
    message = str(caught.value)
    assert "7 equations (4 boundary + 1 phase conditions + 2 pins)" in message
    assert "6 unknowns (4 node states + 1 period + 1 unfolding)" in message
    assert "2 pins where the family has room for 1; remove 1" in message
    assert isinstance(caught.value, InputError)


def test_a_symmetric_problem_with_too_many_pins_is_refused(no_solver):
    """The count is made for the symmetric formulation as well."""
    with pytest.raises(CountError, match="remove 1 or free as many"):
        find_orbit(problem(symmetry="brake", pin=pin(energy=1.0, period=2.0)))


def test_freeing_a_parameter_makes_room_for_a_second_pin():
    """Two pins with one freed parameter are square; three are refused."""
    one = problem(pin=pin(energy=1.0, period=2.0), free=("length2",))
    assert one.check_count().freedom == 0
    with pytest.raises(CountError, match="over-determined"):
        problem(pin=pin(energy=1.0, period=2.0, theta1=0.1), free=("length2",)).check_count()


def test_an_under_determined_problem_is_refused_with_the_reason(no_solver):
    """A pin short of a two-parameter family is a CountError naming the invariants and the remedy."""

    free_fall = chain(2, gravity=0.0)
    model = altered(free_fall, invariants=(free_fall.invariants[0],) * 2)
    one = Problem(model, Guess([0.1, 0.1, 0.0, 0.0], 2.0), pin=pin(energy=1.0))
    assert one.count().freedom == 1
    with pytest.raises(CountError, match=r"under-determined.*2-parameter families.*energy.*add 1 pins"):
        find_orbit(one)


def test_a_driven_system_has_its_period_prescribed():
    """Without invariants nothing is unfolded; closure and the forcing's period are square without a pin."""
    one = Problem(driven(), Guess([0.1, 0.0], 6.0))
    count = one.count(3)
    assert count.unknowns["unfolding"] == 0 and count.equations["phase conditions"] == 0
    assert count.freedom == 0 and one.forcing_cycles == 2
    with pytest.raises(CountError, match="nothing is conserved, so its orbits stand alone"):
        Problem(driven(), Guess([0.1, 0.0], 3.0), pin=pin(q1=0.1)).check_count()


def test_a_system_driven_at_an_unknown_period_is_refused():
    """Equations that contain time without a declared forcing period are an InputError that says what to declare."""
    with pytest.raises(InputError, match="depend on time; declare .*forcing_period"):
        Problem(driven(None), Guess([0.1, 0.0], 3.0))


@pytest.mark.parametrize("symmetry", ["brake", "reflection", "reversal", "brake+reflection"])
def test_a_symmetry_that_the_equations_lack_is_refused(symmetry):
    """A damped, skewed pendulum has neither symmetry; asking for one is an InputError, not a wrong orbit."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(0.5 * v**2, -ca.cos(q) - 0.3 * ca.sin(2 * q), Symbols(q, v), forces=-0.1 * v)
    with pytest.raises(InputError, match="symmetry: this system's equations change under"):
        Problem(model, Guess([0.5, 0.0], 6.0), symmetry=symmetry)


GOOD = [0.1, 0.1, 0.0, 0.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(guess=Guess([0.1, 0.2, 0.3], 2.0)), r"guess.state: 3 numbers for 2 coordinates; give 4 \(theta1"),
        (dict(guess=Guess([[0.1, 0.2, 0.3, 0.4]], 2.0)), "guess.state"),
        (dict(guess=Guess([0.1, np.nan, 0, 0], 2.0)), "guess.state: must be finite, got .*nan"),
        (dict(guess=Guess([0.1, np.inf, 0, 0], 2.0)), "guess.state: must be finite, got .*inf"),
        (dict(symmetry="mirror"), "symmetry: unknown 'mirror'; use one of none, brake, reflection"),
        (dict(winding=(1,)), "winding: 1 numbers for 2 coordinates"),
        (dict(winding=(1, 0), symmetry="brake"), r"winding: a brake orbit comes back, so \[1, 0\] cannot hold"),
        (dict(winding=(1, 0), symmetry="reflection"), "winding: a reflection orbit comes back"),
        (dict(pin=pin(theta2=0.1), symmetry="reversal"), "pin: theta2 is a multiple of pi, or 0, where a reversal"),
        (dict(segments=0), "segments: must be at least 1, got 0"),
        (dict(segments=-4), "segments: must be at least 1, got -4"),
        (dict(tolerance=0.0), "tolerance: must be positive and at most 1e-06, got 0.0"),
        (dict(tolerance=1.0), "tolerance: must be positive and at most 1e-06, got 1.0"),
        (dict(tolerance=np.nan), "tolerance: must be positive and at most 1e-06, got nan"),
        (dict(free=("length7",)), "free: unknown physical parameter 'length7'; this system has length1"),
        (dict(pin=pin(thta1=0.1)), r"pin: unknown quantity 'thta1'.*theta1"),
        (dict(pin=pin(length7=0.1)), "pin: unknown quantity 'length7', did you mean 'length"),
        (dict(pin=pin(energy=-19.6)), "pin: energy -19.6 J cannot be reached, the lowest energy .* is -19.6 J"),
        (dict(pin=pin(energy=-1e3)), "pin: energy -1000 J cannot be reached"),
    ],
)
def test_bad_input_is_refused_where_the_problem_is_made(changes, message):
    """Each unusable entry of a Problem is an InputError with field, value and remedy."""
    with pytest.raises(InputError, match=message):
        problem(**changes)


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan, np.inf])
def test_a_guess_needs_a_period(period):
    with pytest.raises(InputError, match=f"guess.period: must be positive and finite, got {period}"):
        Guess(GOOD, period)


def test_a_coordinate_that_is_no_angle_cannot_wind():
    """Winding of a sliding coordinate is refused."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(v**2, q**2, Symbols(q, v))
    with pytest.raises(InputError, match=r"winding: \[1\] turns a coordinate that is not an angle"):
        Problem(model, Guess([0.1, 0.0], 2.0), winding=(1,))


def test_energy_cannot_be_pinned_where_it_is_not_conserved():
    """A driven system refuses an energy pin and says what to pin instead."""
    with pytest.raises(InputError, match="energy is not conserved .* pin the period or a state component"):
        Problem(driven(), Guess([0.1, 0.0], 3.0), pin=pin(energy=1.0))


@pytest.mark.parametrize(
    ("quantities", "message"),
    [
        (dict(energy=np.nan), "pin: energy must be finite, got nan"),
        (dict(theta1=np.inf), "pin: theta1 must be finite, got inf"),
        (dict(period=0.0), "pin: period must be positive, got 0"),
        (dict(period=-2.0), "pin: period must be positive, got -2"),
    ],
)
def test_a_pin_that_is_no_number_is_refused(quantities, message):
    """A pin at NaN, infinity or a period that is not positive is refused at once."""
    with pytest.raises(InputError, match=message):
        pin(**quantities)


@pytest.mark.parametrize(
    "changes",
    [dict(), dict(com=[-0.5, 0.5, 2.0]), dict(gravity=-3.0), dict(com=[-2.0, -1.0, 0.5]), dict(gravity=0.0)],
)
def test_the_lowest_energy_is_the_minimum_of_the_potential(changes):
    """The closed form is below 10 000 random configurations and reached by one of the 8 vertical ones."""
    model = chain(3, [1.0, 0.5, 2.0], [1.0, 3.0, 0.7], **changes)
    random = np.random.default_rng(0)
    values = np.tile(model.parameter_values[:, None], (1, 10_000))
    drawn = model.potential.map(10_000)(random.uniform(-np.pi, np.pi, (3, 10_000)), values).full()
    corners = [
        float(model.potential(np.pi * np.array([a, b, c]), model.parameter_values))
        for a in (0, 1) for b in (0, 1) for c in (0, 1)
    ]  # fmt: skip
    floor = lowest_energy(model)
    assert floor == pytest.approx(min(corners), abs=1e-12)
    assert floor <= drawn.min() + 1e-12


def test_the_lowest_energy_of_an_unknown_system_is_not_claimed():
    """For a custom model nothing is known and nothing is refused."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(v**2, q**2, Symbols(q, v))
    assert lowest_energy(model) is None
    Problem(model, Guess([0.1, 0.0], 2.0), pin=pin(energy=-5.0))
