"""DOP853 in C about CasADi's own C of a field: the interpreter's and SciPy's bits, what it refuses, what it raises."""

import gc
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder._runtime import limit
from orbitfinder.errors import IntegrationError, LimitError
from orbitfinder.integrate import compiled, field
from orbitfinder.integrate.compiled import compiling
from orbitfinder.integrate.dop853 import ReferenceSettings, integrate, integrate_in
from orbitfinder.integrate.equations import accelerations, expect, hamilton, with_variations
from orbitfinder.integrate.field import vector_field
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.orbits.between import curve

pytestmark = pytest.mark.skipif(not compiled.available()[0], reason="needs a C compiler")

PROBLEMS = Path(__file__).parent.parent / "problems"
SYSTEMS = ("report/triple-1", "families/duffing-resonance", "families/lyapunov-l1", "gallery/brusselator")
TOLERANCES = (1e-12, pytest.param(1e-8, marks=pytest.mark.slow), 1e-4)


@pytest.fixture(autouse=True)
def unknown(monkeypatch):
    """No function has been worked with."""
    monkeypatch.setattr(field, "_works", field.Kept(8))


def both(function, start, times, tolerance, units=None, free=None, longest=np.inf):
    """States and accepted steps, interpreted and compiled."""
    found = []
    for mode in ("off", "on"):
        traces, own = [], vector_field(function, free)
        with compiling(mode):
            assert (own.library() is None) == (mode == "off")
            given = start, times, ReferenceSettings(tolerance, tolerance), longest, traces
            states = integrate(own, *given) if units is None else integrate_in(units, own, *given)
        found.append((states, traces[0].moments, traces[0].states))
    return found


def cubic(name: str = "f") -> ca.Function:
    """x'' = -p x^3 + t x / 10 with p left free."""
    t, y, p = ca.SX.sym("t"), ca.SX.sym("y", 2), ca.SX.sym("p")
    return ca.Function(name, [t, y, p], [ca.vertcat(y[1], -p * y[0] ** 3 + 0.1 * t * y[0])])


def harmonic() -> ca.Function:
    t, y = ca.SX.sym("t"), ca.SX.sym("y", 2)
    return ca.Function("harmonic", [t, y], [ca.vertcat(y[1], -y[0])])


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("system", SYSTEMS)
def test_bits_are_those_of_the_interpreter_and_of_scipy(system, tolerance):
    """Motions of Hamilton's equations, their variations and the accelerations, every accepted step, in units or not."""
    problem = of.load_problem(PROBLEMS / f"{system}.toml")
    equations, random = hamilton(problem.model), np.random.default_rng(0)
    for function in (equations.field, equations.variational, accelerations(problem.model)):
        size = function.numel_in(1)
        for start in 0.3 * random.normal(size=(3, size)):
            for units in (None, random.uniform(0.3, 3.0, size)):
                for longest, times in ((np.inf, [0.1, 0.5, 0.6]), (0.01, [0.1, 0.6])):
                    slow, fast = both(function, start, np.array(times), tolerance, units, longest=longest)
                    for ours, scipys in zip(fast, slow, strict=True):
                        np.testing.assert_array_equal(ours, scipys)


@pytest.mark.parametrize("file", ["gallery/lorenz", "published/figure-eight", "families/coupled-pendula"])
def test_rates_are_the_interpreters_to_the_last_bit(file):
    """gcc 12 makes a fused multiply-add of a difference and a sum side by side, whatever it is told of contraction."""
    model, random = of.load_problem(PROBLEMS / f"{file}.toml").model, np.random.default_rng(1)
    for function in (hamilton(model).field, hamilton(model).variational, accelerations(model)):
        times, states = random.uniform(size=50), 0.3 * random.normal(size=(50, function.numel_in(1)))
        rates = []
        for mode in ("off", "on"):
            with compiling(mode):
                rates.append(vector_field(function).many(times, states))
                assert (vector_field(function).library() is None) == (mode == "off")
        np.testing.assert_array_equal(*rates)


def test_a_rate_outlives_its_field():
    """What evaluates it is kept by the function that is handed out."""
    rate = vector_field(harmonic()).rate
    gc.collect()
    np.testing.assert_array_equal(rate(0.0, np.array([1.0, 2.0])), [2.0, -1.0])


def test_bits_of_what_is_free_and_many_looks_at_the_clock():
    """A parameter that changes between two motions of one field; more steps than fit between two looks."""
    free = np.array([2.0])
    for value in (2.0, 0.5):
        free[:] = value
        slow, fast = both(cubic(), np.array([1.0, 0.0]), np.linspace(0.0, 30.0, 7), 1e-9, None, free, 0.02)
        assert len(fast[1]) > 5 * field.AT_A_TIME
        for ours, scipys in zip(fast, slow, strict=True):
            np.testing.assert_array_equal(ours, scipys)


def test_rates_of_many_states_have_the_same_bits():
    """Rates of 1, 5 and 2000 states at once, in units, with what is free."""
    random, free = np.random.default_rng(1), np.array([0.7])
    units = random.uniform(0.5, 2.0, 2)
    for count in (1, 5, 2000):
        times, states = random.normal(size=count), random.normal(size=(count, 2))
        answers = []
        for mode in ("off", "on"):
            with compiling(mode):
                answers.append(vector_field(cubic(), free).scaled(units).many(times, states))
        np.testing.assert_array_equal(*answers)


def test_between_steps_the_bits_are_the_interpreters():
    """States there by one step, and how far rates are off the curve through four; in units, at both ends, of a jump."""
    own_field = vector_field(hamilton(of.chain(2)).field).scaled(np.array([1.0, 2.0, 0.5, 3.0]))
    with compiling("on"):
        integrate(
            own_field, np.array([1.0, 0.4, -0.2, 0.1]), np.linspace(0, 2, 40), longest_step=0.05, traces=(made := [])
        )
        (trace,) = made
        own, moments = replace(trace, field=None), np.linspace(0, 2, 777)[:-1]
        step, slopes = (
            np.searchsorted(trace.moments, moments, side="right") - 1,
            trace.rates(trace.moments, trace.states),
        )
        np.testing.assert_array_equal(trace.at(moments), own.at(moments))
        jumping = replace(trace, states=trace.states + 1e-3 * (trace.moments > 1)[:, None])
        for one in (trace, jumping):
            off = one.strayed(slopes, step, moments)
            states, rates = curve(one.moments, one.states, slopes, step, moments)
            np.testing.assert_array_equal(off, np.abs(one.rates(moments, states) - rates).max(axis=1))
        assert off.max() > 1e-3 > trace.strayed(slopes, step, moments).max()
        assert own.strayed(slopes, step, moments) is None


def test_it_is_compiled_when_it_has_taken_as_long():
    """Interpreted at first, in the library once the work was worth one; at once where much is expected."""
    function = harmonic()
    own = vector_field(function)
    with compiling("auto"):
        integrate(own, np.array([1.0, 0.0]), np.array([0.0, 1.0]))
        assert own.library() is None and 0.0 < own._work.spent < field.LOOKED_FOR
        expect(function, 1e-3)
        assert own.library() is None
        expect(function, None)
        assert own.library() is not None
    with compiling("off"):
        assert own.library() is None


def test_nothing_is_compiled_without_a_compiler(monkeypatch):
    """The interpreter goes on, and it is said why; the compiler is not asked again and again."""
    monkeypatch.setenv("CC", "/nowhere/cc")
    own = vector_field(harmonic())
    with compiling("on"):
        before = compiled.statistics().left
        for _ in range(3):
            integrate(own, np.array([1.0, 0.0]), np.array([0.0, 1.0]))
        assert compiled.statistics().left == before + 1 and "not on the path" in compiled.statistics().reason


def test_a_library_that_lies_is_not_believed(monkeypatch):
    """C of x'' = +x in the place of x'' = -x: the motion is the interpreter's, and the library is used no more."""
    function, true = harmonic(), compiled.casadi_code
    t, y = function.sx_in()
    wrong = ca.Function("harmonic", [t, y], [ca.vertcat(y[1], y[0])])
    monkeypatch.setattr(field, "casadi_code", lambda _: true(wrong))
    slow, fast = both(function, np.array([1.0, 0.0]), np.array([0.0, 1.0, 2.0]), 1e-10)
    np.testing.assert_array_equal(slow[0], fast[0])
    with compiling("on"):
        assert vector_field(function).library() is None


def test_answers_are_compared_once_in_so_many(monkeypatch):
    """The first, and one of eight after it: both ends of an integration each."""
    compared, real = [], field.CasadiField._agrees
    monkeypatch.setattr(field.CasadiField, "_agrees", lambda own, *given: compared.append(given) or real(own, *given))
    with compiling("on"):
        own = vector_field(harmonic())
        for _ in range(17):
            integrate(own, np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    assert len(compared) == 3 and [len(times) for _, times, _ in compared] == [2, 2, 2]


def test_units_of_the_last_time_are_kept():
    own, units = vector_field(harmonic()), np.array([1.0, 2.0])
    scaled = own.scaled(units)
    assert own.scaled(units.copy()) is scaled and own.scaled(2 * units) is not scaled
    units[:] = 5.0  # the caller's own
    np.testing.assert_array_equal(scaled(0.0, np.array([1.0, 1.0])), [2.0, -0.5])


FAILING = {
    "too many evaluations": ("-1.0 * y", 1e-12, {"max_evaluations": 120}),
    "step size becomes too small": ("y * y", 1e-12, {}),
    "not finite": ("ca.sqrt(1.0 - t) * y", 1e-12, {}),
}


@pytest.mark.parametrize("name", ["rates", "dop853", "prepared", "sin_of"])
def test_a_field_may_have_any_name(name):
    """Names of functions in `dop853.c` too: the field of every first-order model is called `rates`."""
    slow, fast = both(cubic(name), np.array([1.0, 0.0]), np.array([0.0, 1.0, 2.0]), 1e-10, free=np.array([1.0]))
    np.testing.assert_array_equal(slow[0], fast[0])


@pytest.mark.parametrize("message", FAILING)
def test_failures_are_those_of_scipy(message):
    """Code, message and time of a motion that cannot be gone on with, interpreted and compiled."""
    rate, tolerance, more = FAILING[message]
    t, y = ca.SX.sym("t"), ca.SX.sym("y", 1)
    function = ca.Function("f", [t, y], [eval(rate, {"t": t, "y": y, "ca": ca})])
    errors = []
    for mode in ("off", "on"):
        with compiling(mode), pytest.raises(IntegrationError) as caught:
            settings = ReferenceSettings(tolerance, tolerance, **more)
            integrate(vector_field(function), np.array([1.0]), np.array([0.0, 10.0]), settings, 0.5)
        errors.append((str(caught.value), caught.value.time))
    assert errors[0] == errors[1] and (message in errors[0][0] or message == "not finite")


def test_what_is_stiff_is_gone_on_with_by_a_library_alone():
    """At the limit of stability: y follows cos(t) to 1e-5, the ratio of their rates."""
    t, y = ca.SX.sym("t"), ca.SX.sym("y", 1)
    function = ca.Function("f", [t, y], [-1e5 * (y - ca.cos(t))])
    given = np.array([1.0]), np.array([0.0, 10.0]), ReferenceSettings(1e-5, 1e-5), 0.5
    with compiling("off"), pytest.raises(IntegrationError, match="probably stiff"):
        integrate(vector_field(function), *given)
    with compiling("on"):
        assert abs(integrate(vector_field(function), *given)[-1, 0] - np.cos(10.0)) < 1e-4


def test_a_limit_of_time_ends_it():
    """A motion of a billion steps ends with the limit."""
    with compiling("on"):
        own = vector_field(harmonic())
        assert own.library() is not None
        with pytest.raises(LimitError), limit.limited(0.2):
            integrate(own, np.array([1.0, 0.0]), np.array([0.0, 1e6]), ReferenceSettings(max_evaluations=10**10), 1e-3)


def test_equations_of_a_mode_are_derived_once():
    """Automata of one hybrid system ask for the same functions, at all slopes, so that one library serves them."""
    model = of.load_problem(PROBLEMS / "hybrid" / "compass-gait.toml").model
    modes = [one.hybrid.modes[0].model for one in (model, with_parameters(model, {"slope": 0.06}))]
    for derived in (accelerations, with_variations):
        first, second = (derived(mode) for mode in modes)
        assert first.function is second.function and not np.array_equal(first.values, second.values)


def test_the_rule_of_refused_steps_is_that_of_this_scipy(monkeypatch):
    """The other rule (SciPy before 1.17, or since) gives another count of steps on a pendulum at 1e-6: it matters."""
    t, y = ca.SX.sym("t"), ca.SX.sym("y", 2)
    swing = ca.Function("swing", [t, y], [ca.vertcat(y[1], -ca.sin(y[0]))])
    given = np.array([1.0, 0.3]), np.array([0.0, 5.0, 10.0]), 1e-6
    slow, fast = both(swing, *given)
    assert len(slow[1]) == len(fast[1])
    rules = field._rules()
    other = rules | {"REFUSED": {"most_cut": "fmin", "fmin": "most_cut"}[rules["REFUSED"]]}
    monkeypatch.setattr(field, "_rules", lambda: other)
    monkeypatch.setattr(field, "_works", field.Kept(8))
    slow, fast = both(swing, *given)
    assert len(slow[1]) != len(fast[1])


def test_the_package_carries_the_integrator():
    """A wheel without the source in C would leave every certificate interpreted, unnoticed."""
    assert "int dop853(" in (files("orbitfinder.integrate") / "dop853.c").read_text()
