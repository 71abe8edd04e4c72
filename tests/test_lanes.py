"""Marches in lanes: CasADi's numbers, the same bits whatever the registers, and never another's orbit certified."""

import ctypes
import os
import re
import shutil
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import PRINTED, printed_problem
from scipy.integrate import quad

import orbitfinder as of
from orbitfinder._runtime.caches import Kept
from orbitfinder.errors import OrbitfinderError
from orbitfinder.integrate import compiled
from orbitfinder.integrate.compiled import available, compiling, find_compiler, make_library, statistics
from orbitfinder.integrate.lanes import emit, kernel
from orbitfinder.integrate.lanes.emit import emitted, field_code, scalars
from orbitfinder.integrate.lanes.factors import sparse_slopes
from orbitfinder.integrate.march import March, uniform
from orbitfinder.integrate.rk8 import slopes_of, variational_field
from orbitfinder.loops import loop
from orbitfinder.mechanics.model import field_apart, vector_field
from orbitfinder.systems import FUNCTIONS

pytestmark = pytest.mark.skipif(not available()[0], reason="no C compiler: " + available()[1])

KERNEL, MARCH = kernel.source("kernel.c"), kernel.source("march.c")
LIBM = re.sub(r"TURNING\(v_(sin|cos), .*", r"EACH1(v_\1, \1)", KERNEL)
"""The kernel with sin and cos of the C library"""
CHAINS = {f"{links} links": lambda links=links: of.chain(links) for links in (1, 2, 3, 4)}
SYSTEMS = {**FUNCTIONS, **CHAINS}


def fields():
    """A field and its variations of every built-in system, by name."""
    for name, make in SYSTEMS.items():
        field = vector_field(make())
        yield name, scalars(field)
        yield f"{name}, variations", variational_field(scalars(field))


def built(code, folder):
    """A library of C; what it needs beside the kernel it includes itself."""
    return ctypes.CDLL(str(make_library(find_compiler(), "#define LEAST 1e-300\n" + code, folder)))


def called(library, name, inputs, count):
    """The numbers (lanes x count) of a function at several places, one in each lane."""
    given = [np.ascontiguousarray(np.reshape(numbers, (-1, LANES)), float) for numbers in inputs]
    result = aligned((count, LANES))
    buffers = [aligned(numbers.shape) for numbers in given]
    for buffer, numbers in zip(buffers, given, strict=True):
        buffer[...] = numbers
    getattr(library, name)(*(ctypes.c_void_p(array.ctypes.data) for array in (*buffers, result)))
    return result.T.copy()


LANES = 8


def aligned(shape):
    """Room for vectors of doubles, which begin at a multiple of their size."""
    room = np.zeros(int(np.prod(shape)) * 8 + 128, np.uint8)
    begin = -room.ctypes.data % 64
    return room[begin : begin + int(np.prod(shape)) * 8].view(float).reshape(shape)


def exported(function, name):
    return emitted(function, name).replace("static __attribute__((noinline)) void", "void")


# ---- what is emitted -------------------------------------------------------------------------------


def test_functions_of_every_system_are_casadis_to_the_last_bit(tmp_path):
    """With sin and cos of the C library; with those of lanes within 4 ulp, of the numbers or of their states."""
    every = dict(fields())
    heads = f"#define LANES {LANES}\n"
    body = "".join(exported(function, f"f{k}") for k, function in enumerate(every.values()))
    own, libm = (built(heads + source + body, tmp_path) for source in (KERNEL, LIBM))
    random = np.random.default_rng(5)
    for k, (name, function) in enumerate(every.items()):
        inputs = [random.normal(0.7, 0.4, (function.size1_in(i), LANES)) for i in range(4)]
        known = function(*inputs).full().T
        np.testing.assert_array_equal(called(libm, f"f{k}", inputs, function.numel_out(0)), known, err_msg=name)
        beside = [function(*(x + random.choice([-1, 1], x.shape) * np.spacing(x) for x in inputs)) for _ in range(4)]
        moved = np.max([np.abs(other.full().T - known) for other in beside], axis=(0, 2))[:, None]
        near, size = called(own, f"f{k}", inputs, function.numel_out(0)), np.abs(known).max(axis=1, keepdims=True)
        assert np.all(np.abs(near - known) <= 4 * (np.spacing(size) + moved)), name
    assert len(every) == 2 * len(SYSTEMS)


OPERATIONS = {
    "two": lambda x, y: [x + y, x - y, x * y, x / y, x**y, ca.fmod(x, y), ca.remainder(x, y), ca.copysign(x, y),
                         ca.fmin(x, y), ca.fmax(x, y), ca.atan2(x, y), ca.hypot(x, y), x < y, x <= y, x == y, x != y,
                         ca.logic_and(x, y), ca.logic_or(x, y), ca.if_else(x < y, x, y), ca.constpow(x, 1.5)],
    "one": lambda x, y: [-x, x**2, 2 * x, 1 / x, ca.logic_not(x), ca.fabs(x), ca.sqrt(x), ca.exp(x), ca.log(x),
                         ca.tan(x), ca.asin(x), ca.acos(x), ca.atan(x), ca.floor(x), ca.ceil(x), ca.erf(x),
                         ca.sinh(x), ca.cosh(x), ca.tanh(x), ca.asinh(x), ca.acosh(x), ca.atanh(x), ca.sign(x),
                         ca.log1p(x), ca.expm1(x), ca.sin(x), ca.cos(x)],
}  # fmt: skip


def test_every_operation_is_casadis(tmp_path):
    """Of zeros of both signs, infinities and what is not a number too."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    function = ca.Function("every", [x, y], [ca.vertcat(*OPERATIONS["two"](x, y), *OPERATIONS["one"](x, y))])
    library = built(f"#define LANES {LANES}\n{LIBM}" + exported(function, "every"), tmp_path)
    numbers = [0.0, -0.0, 0.3, -0.7, 1.0, 2.5, -3.5, 1e300, np.inf, -np.inf, np.nan]
    pairs = np.array([(a, b) for a in numbers for b in numbers] + [(0.5, 0.5)] * 7).T
    for k in range(0, pairs.shape[1], LANES):
        inputs = pairs[:, k : k + LANES]
        got = called(library, "every", inputs, function.numel_out(0))
        np.testing.assert_array_equal(got, function(*inputs[:, None]).full().T)


def test_by_what_several_are_divided_it_is_divided_once(tmp_path):
    """A quotient that stands alone is CasADi's to the last bit, the others are good to 1.5 ulp."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    z = x + y  # whose place something else may take between two quotients
    function = ca.Function("shares", [x, y], [ca.vertcat(x / z, y / z, y / x)])
    body = emitted(function, "shares", True).replace("static __attribute__((noinline)) void", "void")
    assert body.count("/ w") == 2 and exported(function, "shares").count("/ w") == 3
    inputs = np.random.default_rng(4).uniform(0.1, 9.0, (2, LANES))
    got = called(built(f"#define LANES {LANES}\n{LIBM}" + body, tmp_path), "shares", inputs, 3)
    known = function(*inputs[:, None]).full().T
    np.testing.assert_array_equal(got[:, 2], known[:, 2])
    assert np.any(got != known) and np.all(np.abs(got - known) <= np.spacing(known))
    fields = [vector_field(of.chain(3)), variational_field(scalars(vector_field(of.chain(3))))]
    plain, quick = ([field_code(field, inverses).count("/ w") for field in fields] for inverses in (False, True))
    assert min(plain) > 12 and quick == [3, 3]


def test_what_lanes_have_is_what_casadi_has():
    """Every scalar operation of this CasADi is emitted or refused by name."""
    scalar = set(range(ca.OP_ASSIGN, ca.OP_ATAN2 + 1)) | {ca.OP_LOG1P, ca.OP_EXPM1, ca.OP_HYPOT, ca.OP_REMAINDER}
    assert {*emit.BINARY, *emit.UNARY} == scalar
    x = ca.SX.sym("x")
    for expression, name in ((ca.erfinv(x), "OP_ERFINV"), (ca.SX(x).printme(1), "OP_PRINTME")):
        with pytest.raises(emit.Unknown, match=f"odd has {name}"):
            emitted(ca.Function("odd", [x], [expression]), "odd")


def spline():
    table = ca.interpolant("table", "bspline", [[0.0, 1.0, 2.0, 3.0, 4.0]], [0.0, 1.0, 0.0, 1.0, 0.0])
    return lambda q: table(q)


class Odd(ca.Callback):
    def __init__(self):
        ca.Callback.__init__(self)
        self.construct("odd", {"enable_fd": True})

    def eval(self, given):
        return [-given[0]]


def solved():
    unknown, q = ca.MX.sym("unknown"), ca.MX.sym("q")
    root = ca.rootfinder("root", "newton", {"x": unknown, "p": q, "g": unknown + unknown**3 + q})
    return lambda q: root(0.0, q)


def matrix_field(force):
    t, x, s, free = ca.MX.sym("t"), ca.MX.sym("x", 2), ca.MX.sym("s", 0), ca.MX.sym("free", 0)
    return ca.Function("swing", [t, x, s, free], [ca.vertcat(x[1], force(x[0]))])


@pytest.mark.parametrize("force", [spline, Odd, solved])
def test_what_is_no_expression_of_scalars_is_refused_by_name(force, monkeypatch):
    """Splines, callbacks and equations that are solved are marched as before."""
    monkeypatch.setattr(compiled, "_statistics", compiled.Statistics())
    law = force()  # CasADi does not keep callbacks alive
    field, given = matrix_field(law), (np.array([[0.5, 0.0]]), uniform(1.0, 1, 8), np.array([1.0]))
    with pytest.raises(emit.Unknown, match="swing"):
        field_code(field)
    assert kernel.kernel(field, None) is None and "swing" in statistics().reason
    np.testing.assert_array_equal(March(field).ends(*given), interpreted(field).ends(*given))


def interpreted(field, **how):
    with compiling("off"):
        march = March(field, **how)
        march.build()
        return march


def test_matrices_that_are_scalars_inside_are_expanded():
    field = matrix_field(lambda q: -ca.sin(q))
    assert field.is_a("MXFunction")
    march, given = March(field), (np.array([[0.5, 0.0], [0.1, 0.3]]), uniform(1.0, 2, 8), np.array([2.0]))
    march.build()
    assert all(march._kernels.values())
    known = interpreted(field).varied(*given)
    np.testing.assert_allclose(march.varied(*given).transitions, known.transitions, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(march.ends(*given), known.ends, rtol=1e-14)


# ---- sin and cos -----------------------------------------------------------------------------------


def test_sin_and_cos_far_out(tmp_path):
    """Within 1.5 ulp below the guard, the C library's beyond, whatever the neighbours in the register."""
    x = ca.SX.sym("x")
    function = ca.Function("both", [x], [ca.vertcat(ca.sin(x), ca.cos(x))])
    body = exported(function, "both")
    own, libm = (built(f"#define LANES {LANES}\n{source}{body}", tmp_path) for source in (KERNEL, LIBM))
    random = np.random.default_rng(3)
    near = np.concatenate([random.uniform(-r, r, 4000) for r in (1e-6, 1.0, 10.0, 1e3, 1e4, 1e5)])
    near = np.concatenate([near, np.arange(-4000, 4000) * np.pi / 2, [0.0, -0.0, 1e5, -1e5, 5e-324, 1e-300, 1e-9, 1.0]])
    for k in range(0, near.size, LANES):
        numbers = [near[k : k + LANES]]
        ours, known = (called(library, "both", numbers, 2) for library in (own, libm))
        assert np.all(np.abs(ours - known) <= np.spacing(np.abs(known))), numbers  # 1.5 ulp of the truth, libm 0.5
    far = np.array([1.0001e5, 1e8, -1e16, 1e22, 1e300, np.inf, np.nan, -np.inf])
    np.testing.assert_array_equal(called(own, "both", [far], 2), called(libm, "both", [far], 2))
    mixed = np.array([0.5, 1e300, -2.0, np.nan, 1e5, np.inf, 3.0, 1e9])
    alone = [called(own, "both", [np.full(LANES, number)], 2)[0] for number in mixed]
    np.testing.assert_array_equal(called(own, "both", [mixed], 2), alone)


# ---- the same bits ---------------------------------------------------------------------------------

WIDTHS = (8, 4, 2, 1)
OWN = ("march", "evaluated", "rates", "states", "columns", "product", "step", "within", "gathered", "BEGIN", "COLUMN")
SIZES = ("STATE", "OWN", "UNFOLDING", "FREE", "COLUMNS", "SLOPES", "INNER", "PLACED", "ROWS", "AHEAD", "HELD", "ROOM",
         "GIVEN", "STAGES")  # fmt: skip


def marches(forms, width, folder):
    """The marches of several fields in one library, each with names of its own."""
    parts = [f"#define LANES {width}\n", KERNEL]
    for k, form in enumerate(forms):
        part = field_code(form) + MARCH
        parts += [f"static void product_{k}(W *restrict, const V *restrict, const V *restrict, W *restrict, int);\n"]
        parts += [re.sub(rf"\b({'|'.join(OWN)})\b(?=[\s]*[\[(])", rf"\1_{k}", part)]
        parts += [f"#undef {name}\n" for name in SIZES]
    library = built("".join(parts), folder)
    found = [getattr(library, f"march_{k}") for k in range(len(forms))]
    for march in found:
        march.argtypes = kernel.SIGNATURE
    return found


def marched(march, starts, given, steps):
    ends, errors = np.empty(starts.shape), np.empty((len(starts), starts.shape[1] - 1))
    path = np.empty((len(given), 2))
    order = np.arange(len(starts) + 1, dtype=np.intp)
    begins = steps * order
    pointers = (array.ctypes.data for array in (begins, order, starts, given, ends, path))
    assert march(len(starts), *pointers, 2, errors.ctypes.data) == 0
    return ends, path, errors


def same(known, other):
    """All bits, but for which of the many nan."""
    whole = np.isfinite(known)
    np.testing.assert_array_equal(known, other)
    np.testing.assert_array_equal(known.view(np.int64)[whole], other.view(np.int64)[whole])


def mean_field(x):
    """Rates of components each of which acts on all others by their sum alone."""
    return ca.sin(ca.sum1(x)) * x - x**3


def field_of(rates, size):
    inputs = [ca.SX.sym(name, k) for name, k in (("t", 1), ("x", size), ("s", 0), ("free", 0))]
    return ca.Function("field", inputs, [rates(inputs[1])])


FEW = ("forced_duffing", "hodgkin_huxley", "impact_oscillator", "3 links")


@pytest.mark.parametrize("names", [FEW, pytest.param(tuple(SYSTEMS), marks=pytest.mark.slow)], ids=["few", "all"])
def test_all_widths_have_the_same_bits(names, tmp_path):
    """x and (x, Phi), df/dx written out and multiplied by hand, and errors of steps; of eleven a state is nan."""
    flat = [scalars(vector_field(SYSTEMS[name]())) for name in names]
    forms = [form for field in flat for form in (field, sparse_slopes(field, None))] + [
        variational_field(f) for f in flat
    ]
    forms.append(sparse_slopes(field_of(mean_field, 6), None))
    assert forms[-1].inner
    random, steps, finite = np.random.default_rng(1), 3, 0
    each = [marches(forms, width, tmp_path) for width in (8, 4, 2, 1)]
    for k, form in enumerate(forms):
        whole, form = not isinstance(form, ca.Function), getattr(form, "function", form)
        state, columns = form.size1_in(1), form.size1_in(1) + form.size1_in(2) + form.size1_in(3)
        starts = random.uniform(0.1, 0.9, (11, 1 + (state * (1 + columns) if whole else state)))
        starts[4, 1] = np.nan
        given = random.uniform(0.1, 0.9, (11 * steps, 1 + columns - state)) * 1e-2
        results = [marched(marching[k], starts, given, steps) for marching in each]
        for result in results[1:]:
            for known, other in zip(results[0], result, strict=True):
                same(known, other)
        finite += int(np.isfinite(np.delete(results[0][0], 4, 0)).all())
    assert finite == len(forms)


@pytest.mark.parametrize("links", [2, 8])
def test_any_number_of_segments_has_the_same_bits(links):
    """1 to 17, the first by code of one lane, and of steps of their own; columns of 2 links written out, of 8 not."""
    field = vector_field(of.chain(links))
    random, size = np.random.default_rng(2), 2 * links * (1 + 2 * links)
    starts, given = random.uniform(0.1, 0.5, (17, 1 + size)), random.uniform(0.5, 1.0, (17 * 4, 1)) * 1e-2
    lanes = kernel.varied_kernel(field, None, None)
    ends, path = lanes.marched(starts, given, 3)
    errors = lanes.errors(starts, given[:17])
    for count in range(1, 17):
        for known, other in zip((ends, path), lanes.marched(starts[:count], given[: 4 * count], 3), strict=True):
            same(known[: len(other)], other)
        same(errors[:count], lanes.errors(starts[:count], given[:count]))
    begins = np.append(0, np.cumsum(random.permutation(17) % 5 + 1))
    given = np.resize(given, (begins[-1], 1))
    ends, path = lanes.marched(starts, given, 3, begins)
    for k, (start, one, last) in enumerate(zip(starts, begins, begins[1:], strict=False)):
        alone = lanes.marched(start[None], given[one:last], 3)
        same(ends[k : k + 1], alone[0])
        same(path[one:last], alone[1])
    starts[3] = np.nan
    same(np.delete(lanes.marched(starts, given, 0, begins)[0], 3, 0), np.delete(ends, 3, 0))


@pytest.mark.parametrize("file", ["families/duffing-resonance", "report/triple-1", "gallery/brusselator"])
def test_rates_of_any_number_of_states_are_the_interpreted_ones(file):
    """At one time or at many, with parameters of all or of each; those of one state are the same to the last bit."""
    model = of.load_problem(f"problems/{file}.toml").model
    names = model.parameter_names[:2]
    field, random = vector_field(model, names), np.random.default_rng(5)
    lanes, known = March(field, forced=model.forced), interpreted(field, forced=model.forced)
    states, times = random.uniform(-0.5, 0.5, (19, field.size1_in(1))), random.uniform(0.0, 1.0, 19)
    tails = random.uniform(0.5, 1.5, (19, 1 + len(names)))
    for tail, moment in ((tails, times), (tails[0], times), (tails[0], 0.3)):
        rates = lanes.rates(states, tail, moment)
        np.testing.assert_allclose(rates, known.rates(states, tail, moment), rtol=1e-13, atol=1e-13)
        for k in (0, 18):
            own = tail[k] if tail.ndim > 1 else tail
            there = moment if isinstance(moment, float) else moment[k : k + 1]
            same(lanes.rates(states[k : k + 1], own, there), rates[k : k + 1])
    assert lanes._kernels[False]
    states[3] = np.nan
    same(
        np.delete(lanes.rates(states, tails, times), 3, 0),
        np.delete(lanes.rates(np.nan_to_num(states), tails, times), 3, 0),
    )


def springs(t, x, p):
    """The rates of seven masses in a row between springs that harden."""
    stretch = ca.diff(ca.vertcat(0, x[:7], 0))
    return ca.vertcat(x[7:], ca.diff(stretch + stretch**3))


def test_errors_of_steps_are_the_interpreted_ones():
    """Of states and of variations, with an integral that is carried along, written out and multiplied by hand."""
    inputs = [ca.SX.sym(name, size) for name, size in (("t", 1), ("x", 14), ("s", 0), ("free", 0))]
    for field in (vector_field(of.chain(2)), ca.Function("springs", inputs, [springs(*inputs[:3])])):
        inputs = field.sx_in()
        work = ca.Function("work", inputs, [ca.sumsqr(inputs[1])])
        given = (np.full((3, field.size1_in(1)), 0.3), uniform(1.0, 3, 4), np.array([1.5]))
        lanes, known = March(field, integrand=work), interpreted(field, integrand=work)
        whole, slow = lanes.varied(*given, states=True), known.varied(*given, states=True)
        assert all(lanes._kernels.values()) and not any(known._kernels.values())
        for name in ("ends", "transitions", "columns", "states", "integral"):
            np.testing.assert_allclose(getattr(whole, name), getattr(slow, name), rtol=1e-12, atol=1e-13)
        asked = (slow.states, *given[1:], np.ones(field.size1_in(1)), np.arange(12))
        for name in ("step_errors", "variation_errors"):
            np.testing.assert_allclose(
                getattr(lanes, name)(*asked), getattr(known, name)(*asked), rtol=1e-5, atol=1e-17
            )


def test_a_march_decides_once(monkeypatch):
    """A compiler that comes or goes changes nothing of a march that has begun, nor of one that has a kernel for one."""
    field, given = vector_field(of.chain(2)), (np.full((2, 4), 0.2), uniform(1.0, 2, 4), np.array([1.0]))
    begun = interpreted(field)
    slow = begun.ends(*given)
    fast = March(field)
    quick = fast.ends(*given)
    same(begun.ends(*given), slow)
    with compiling("off"):
        same(fast.ends(*given), quick)
    march = March(vector_field(of.chain(2)))
    march.ends(given[0][:1], uniform(0.5, 1, 4), given[2])  # a single segment comes first
    monkeypatch.setattr(kernel, "library", refused)
    same(march.ends(*given), quick)
    assert kernel.kernel(vector_field(of.chain(2)), None) is None


@contextmanager
def monkey(table, key, value):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(table, key, value)
        yield


def refused(*_):
    raise compiled.Unavailable("no compiler any more")


# ---- the certificate does not believe it ------------------------------------------------------------


@pytest.fixture
def flipped(tmp_path, monkeypatch):
    """A plus for a minus in `emit`, in libraries of its own."""
    monkeypatch.setenv("ORBITFINDER_CACHE", str(tmp_path))
    forgotten(monkeypatch)
    monkeypatch.setitem(emit.BINARY, ca.OP_SUB, "{} + {}")
    return monkeypatch


def forgotten(patch):
    """Neither kernels nor what marches by them are kept any more."""
    patch.setattr(kernel, "_kernels", Kept(32))
    patch.setattr(loop, "_marches", Kept(16))


def test_a_flipped_sign_is_seen_before_use(flipped):
    assert kernel.kernel(vector_field(of.chain(3)), None) is None
    assert "disagrees with the interpreted field" in statistics().reason


def verdict(problem):
    """Whether an orbit that lanes refined is certified; why there is none."""
    refiner = of.Refiner(problem)
    refiner.equations.march.build()
    assert all(refiner.equations.march._kernels.values())
    try:
        return refiner.orbit(refiner.refine()).certificate.passed
    except OrbitfinderError as error:
        return type(error).__name__


HENON = of.Guess([0.0, 0.25, 0.3, 0.0], 6.3)
ODES = {
    "duffing": of.Problem(FUNCTIONS["duffing"](), of.Guess([0.3, 0.0], 6.1), pin=of.pin(x=0.3)),
    "henon_heiles": of.Problem(FUNCTIONS["henon_heiles"](), HENON, pin=of.pin(energy=0.125)),
}


@pytest.mark.parametrize(
    "name", [*(pytest.param(name, marks=[pytest.mark.slow] * (name != "triple-1")) for name in PRINTED), *ODES]
)
def test_a_flipped_sign_turns_the_certificate_red(name, flipped):
    """Even where nobody compares the library with the interpreter."""
    problem = ODES[name] if name in ODES else printed_problem(name)
    if not subtracts(problem.model):
        pytest.skip("this CasADi makes the equations without a minus")
    turns_red(problem, flipped)


def subtracts(model):
    """Whether there is a sign to flip: CasADi 3.6 makes -x - x^3 a sum times -1."""
    field = scalars(vector_field(model))
    return ca.OP_SUB in [field.instruction_id(k) for k in range(field.n_instructions())]


def turns_red(problem, flipped):
    with flipped.context() as patch:
        patch.setitem(emit.BINARY, ca.OP_SUB, "{} - {}")
        assert verdict(problem) is True
    forgotten(flipped)
    flipped.setattr(kernel, "_agrees", lambda *_: True)
    assert verdict(problem) is not True


def test_an_orbit_of_the_flipped_equations_is_not_certified(flipped):
    """x'' = x - x^3 instead of -x - x^3: found, over both wells, by lanes that nobody compared, and seen."""
    largest = 1.6
    period = 4 * quad(lambda a: (largest**2 * (1 + np.sin(a) ** 2) / 2 - 1) ** -0.5, 0, np.pi / 2)[0]
    flipped.setattr(kernel, "_agrees", lambda *_: True)
    problem = of.Problem(FUNCTIONS["duffing"](), of.Guess([largest, 0.0], period), pin=of.pin(x=largest))
    if not subtracts(problem.model):
        pytest.skip("this CasADi makes the equations without a minus")
    assert of.Refiner(problem).refine().period == pytest.approx(period, rel=1e-12)
    assert verdict(problem) is False


SHIPPED = sorted(path for path in (Path(__file__).parents[1] / "problems").glob("*/*.toml") if path.stem != "beam")
"""without what is too stiff for explicit steps"""


@pytest.mark.slow
def test_a_flipped_sign_turns_all_shipped_orbits_red(flipped):
    """Of every problem file that can be refined as it stands and whose equations have a minus."""
    turned = 0
    for path in SHIPPED:
        try:
            problem = of.load_problem(path)
            minus = "{} - {}"
            with flipped.context() as patch:
                patch.setitem(emit.BINARY, ca.OP_SUB, minus)
                green = verdict(problem) is True
        except (OrbitfinderError, AssertionError, AttributeError):
            continue  # a search, an arc with controls, a machine with impacts
        if green and subtracts(problem.model):
            turns_red(problem, flipped)
            turned += 1
        forgotten(flipped)
    assert turned >= 20


# ---- a compiler in a wheel --------------------------------------------------------------------------


@pytest.mark.needs("compiler")
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc to compare with")
def test_the_compiler_of_the_extra_makes_the_same_bits(tmp_path, monkeypatch):
    """clang, where no other compiler is on the path; nothing is told of it but `doctor`'s line."""
    random, bits = np.random.default_rng(4), []
    starts, given = random.uniform(0.1, 0.5, (9, 43)), random.uniform(0.5, 1.0, (9 * 4, 1)) * 1e-2
    for name, path in (("gcc", os.environ["PATH"]), ("", "")):
        monkeypatch.setenv("CC", name)
        monkeypatch.setenv("PATH", path)
        monkeypatch.setenv("ORBITFINDER_CACHE", str(tmp_path / (name or "zig")))
        lanes = kernel.varied_kernel(vector_field(of.chain(3)), None, None)
        assert lanes and ("clang" in available()[1]) is not bool(name)
        bits.append([lanes.marched(starts, given)[0], lanes.marched(starts[:1], given[:4])[0]])
    for known, other in zip(*bits, strict=True):
        same(known, other)


def test_variations_of_a_chain_are_the_dense_ones_and_those_of_differences():
    """The balance of forces, with accelerations held, stands for df/dx: of 20 links by less than half its numbers."""
    model = of.chain(20, length=list(np.linspace(0.8, 1.2, 20)))
    unfolded, names = model.invariants[:1], ("length3", "gravity")
    field, apart = (make(model, names, unfolded) for make in (vector_field, field_apart))
    slopes, size = sparse_slopes(field, None, apart), 40
    assert slopes.inner and len(slopes.columns) < 2 * 20**2 and slopes.placed == 20
    random, free = np.random.default_rng(7), [1.1, 9.0]
    x = random.normal(0.0, 0.5, size)
    numbers, forcing = (slopes.function(0.0, x, 0.2, free)[k].full() for k in (1, 2))
    whole = np.zeros((slopes.inner + 20, size))
    for row, (begin, end) in enumerate(pairwise(slopes.begins)):
        below = np.vstack([np.eye(size), whole[:row]])
        whole[row] = numbers[begin:end, 0] @ below[slopes.columns[begin:end]]
    known = slopes_of(field)(0.0, x, 0.2, free)
    scale = np.abs(known[1].full()).max()
    np.testing.assert_array_equal(known[1].full()[:20], np.eye(20, size, 20))
    np.testing.assert_allclose(whole[slopes.inner :], known[1].full()[20:], atol=1e-12 * scale)
    np.testing.assert_allclose(forcing, known[2].full(), atol=1e-12 * scale)
    for k in (3, 27):
        beside = (x + 1e-6 * sign * np.eye(size)[k] for sign in (1, -1))
        late, early = (field(0.0, each, 0.2, free).full().ravel() for each in beside)
        np.testing.assert_allclose(whole[slopes.inner :, k], (late - early)[20:] / 2e-6, atol=1e-8 * scale)


def test_two_compilers_begin_with_a_large_march(tmp_path, monkeypatch):
    """With states and with derivatives, which are derived and compiled once; of a small one with neither."""
    monkeypatch.setenv("ORBITFINDER_CACHE", str(tmp_path))
    derived, forms = [], kernel.varied_forms
    monkeypatch.setattr(kernel, "varied_forms", lambda *given: derived.append(1) or forms(*given))
    before, made = len(compiled._begun), statistics().made
    march = March(vector_field(of.chain(14)))
    march.ahead()
    assert len(compiled._begun) == before + 2
    march.ends(np.full((1, 28), 0.1), uniform(0.1, 1, 4), np.ones(1))
    march.build()
    assert len(compiled._begun) == before and statistics().made == made + 2 and derived == [1]
    assert all(march._kernels.values())
    March(vector_field(of.chain(2))).ahead()
    assert len(compiled._begun) == before


def test_a_march_of_a_long_chain_is_the_interpreted_one():
    """Whose columns fill registers, with an integral that is carried along without variations too, and a parameter."""
    field, apart = (make(of.chain(15), ("gravity",)) for make in (vector_field, field_apart))
    inputs = field.sx_in()
    work = ca.Function("work", inputs, [ca.sumsqr(inputs[1])])
    given = np.random.default_rng(3).normal(0.0, 0.1, (2, 30)), uniform(0.1, 2, 4), np.array([1.0, 9.0])
    march, known = March(field, integrand=work, apart=apart), interpreted(field, integrand=work)
    assert march.wide
    quick, slow = march.varied(*given, states=True), known.varied(*given, states=True)
    assert all(march._kernels.values())
    for name in ("ends", "transitions", "columns", "states", "integral"):
        np.testing.assert_allclose(getattr(quick, name), getattr(slow, name), rtol=1e-11, atol=1e-11)
    assert march.integral(*given) == pytest.approx(slow.integral, rel=1e-13)
    assert known.integral(*given) == pytest.approx(slow.integral, rel=1e-13)
    np.testing.assert_allclose(march.ends(*given), slow.ends, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(march.rates(given[0], given[2]), known.rates(given[0], given[2]), rtol=1e-12, atol=1e-12)
    asked = (slow.states, *given[1:], np.ones(30), np.arange(8))
    np.testing.assert_allclose(march.step_errors(*asked), known.step_errors(*asked), rtol=1e-3, atol=1e-17)
    np.testing.assert_allclose(march.variation_errors(*asked), known.variation_errors(*asked), rtol=1e-3, atol=1e-17)
