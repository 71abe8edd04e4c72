"""Exports: what other programs make of our files is what we computed."""

import ctypes
import json
import math
import os
import re
import runpy
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import pendulum_period
from scipy.integrate import solve_ivp

import orbitfinder as of
from benchmarks.validation.literature import EIGHT_PERIOD, three_bodies
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.exports import source
from orbitfinder.exports.auto import ENERGY, PERIOD, auto_files
from orbitfinder.exports.formats import FORMATS, Format
from orbitfinder.exports.julia import julia_files
from orbitfinder.exports.source import FORTRAN, C, dense_states, fortran_number, source_of, straight_line, word_of
from orbitfinder.exports.write import export_orbit
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import altered, vector_field
from orbitfinder.problemfile.read import read_trajectory

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results" / "orbits"
GALLERY = sorted((ROOT / "results" / "gallery").glob("*/orbit.json"))
SYSTEMS = {
    "chain": {"kind": "chain", "links": 3},
    "long chain": {"kind": "chain", "links": 20},
    "four-bar": {"kind": "linkage", "length": [1.0, 1.0, 1.0], "ground": [0.0, 2.0]},
    **{
        name: {"kind": "python", "function": name}
        for name in ("forced_pendulum", "pendulum_on_cart", "van_der_pol", "vibrated_pendulum", "rotating_hoop")
    },
}
AUTO = Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p"))  # where Debian's package puts it
needs_auto = pytest.mark.skipif(
    not (AUTO / "cmds" / "@r").is_file() or shutil.which("gfortran") is None, reason="AUTO-07p is not installed"
)
PYTHON = source.Language(
    source.c_number,
    lambda name, k: f"{name}[{k}]",
    source.COMMON | {
        "INV": "1.0 / {0}", "POW": "{0} ** {1}", "CONSTPOW": "{0} ** {1}", "ATAN2": "atan2({0}, {1})",
        "FABS": "fabs({0})", "FMIN": "min({0}, {1})", "FMAX": "max({0}, {1})", "FLOOR": "floor({0})",
        "CEIL": "ceil({0})", "LOG1P": "log1p({0})", "EXPM1": "expm1({0})", "FMOD": "fmod({0}, {1})",
    },
)  # fmt: skip
"""What is executed here: the same statements in the language of the tests"""
needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) on the path")


def field_and_arguments(system, seed=0):
    """The exported function of a system and random arguments for it."""
    model, random = build_model(SYSTEMS[system]), np.random.default_rng(seed)
    field = vector_field(model, model.parameter_names, model.invariants)
    x, s = random.normal(size=len(model.state_names)), random.normal(size=len(model.invariants))
    p = model.parameter_values * random.uniform(0.9, 1.1, model.parameter_values.size)
    return field, (random.normal(), x, s, p)


def executed(lines, **arrays):
    """Run straight-line Python and return its arrays."""
    namespace = vars(math) | arrays
    exec("\n".join(lines), namespace)
    return namespace


@pytest.fixture(scope="module")
def triple():
    return of.load_orbit(RESULTS / "triple-1" / "orbit.json")


@pytest.mark.parametrize("system", SYSTEMS)
def test_straight_line_program_is_the_right_hand_side(system):
    """Emitted operations, run one after the other in Python, give CasADi's numbers."""
    field, (t, x, s, p) = field_and_arguments(system)
    lines, work = straight_line(field, PYTHON, ["t", "x", "s", "p"], ["dx"])
    found = executed(lines, t=[t], x=x, s=s, p=p, dx=[math.nan] * x.size, w=[math.nan] * work)["dx"]
    wanted = field(t, x, s, p).full().ravel()
    np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)


def test_structural_zeros_and_several_outputs_are_written():
    """A sparse output is complete, and every output has its own array."""
    x = ca.SX.sym("x", 2)
    sparse = ca.SX(3, 1)
    sparse[1] = x[0] * x[1]
    lines, work = straight_line(ca.Function("f", [x], [sparse, ca.sin(x)]), PYTHON, ["x"], ["a", "b"])
    found = executed(lines, x=[2.0, 3.0], a=[None] * 3, b=[None] * 2, w=[0.0] * work)
    assert found["a"] == [0.0, 6.0, 0.0] and found["b"] == [math.sin(2.0), math.sin(3.0)]


@pytest.mark.parametrize("name", ["ATAN2", "POW", "FABS", "FMIN", "HYPOT", "FMOD"])
def test_every_language_has_the_less_common_operations(name):
    for language in (C, FORTRAN, PYTHON, source.JULIA):
        assert "{0}" in source.operation(name, language)


def test_an_operation_without_counterpart_is_refused():
    x = ca.SX.sym("x")
    with pytest.raises(InputError, match=r"export: the equations use erf, .*try c or csv"):
        straight_line(ca.Function("f", [x], [ca.erf(x)]), FORTRAN, ["x"], ["y"])


def test_a_numerical_factorisation_is_refused():
    """More than 16 coordinates in dense form: the mass matrix is factorised by a routine, not by operations."""
    model = build_model({"kind": "chain", "links": 17, "formulation": "lagrange"})
    with pytest.raises(InputError, match=r"numerical factorisation .*formulation = \"recursive\""):
        straight_line(vector_field(model, (), ()), C, ["t", "x", "s", "p"], ["dx"])


@pytest.mark.parametrize("value", [0.1, 1e-300, 1e22, -2.5, 1 / 3])
def test_fortran_numbers_are_double_precision(value):
    text = fortran_number(value)
    assert "d" in text and float(text.replace("d", "e")) == value


@needs_cc
@pytest.mark.parametrize("system", ["chain", "forced_pendulum"])
def test_compiled_c_is_the_right_hand_side(tmp_path, triple, pendulum_orbit, system):
    """The C file compiles without warnings and computes what CasADi does."""
    field, (t, x, s, p) = field_and_arguments(system)
    orbit = replace(triple, system=SYSTEMS[system], name="it", state=x, samples=np.vstack([x, x]), times=np.arange(2.0))
    (path,) = export_orbit(orbit, "c", tmp_path)
    library = tmp_path / "it.so"
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run([*command, str(path), "-o", str(library), "-lm"], check=True)
    loaded, found = ctypes.CDLL(str(library)), np.full(x.size, np.nan)
    numbers = [one.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for one in (x, s, p, found)]
    loaded.it_rhs(ctypes.c_double(t), *numbers)
    np.testing.assert_allclose(found, field(t, x, s, p).full().ravel(), rtol=1e-13, atol=1e-13)
    assert ctypes.c_double.in_dll(loaded, "it_period").value == orbit.period


def test_csv_is_read_back_as_a_guess(tmp_path, triple):
    """Digits round-trip, and the table is what `[guess] csv` takes."""
    (path,) = export_orbit(triple, "csv", tmp_path)
    guess = read_trajectory(tmp_path, path.name, 6)
    assert path.read_text().startswith("t,theta1,theta2,theta3,theta1dot,")
    assert np.array_equal(guess.states, triple.samples) and guess.period == triple.times[-1]


def test_an_orbit_without_samples_is_sampled_again(tmp_path, triple):
    bare = replace(triple, times=np.zeros(0), samples=np.zeros((0, 6)))
    source = source_of(bare)
    assert np.abs(source.samples[-1] - triple.state).max() < 1e-10


def test_interpolated_samples_lie_on_the_orbit(triple):
    """Cubic Hermite through 401 samples: the midpoints agree with an integration."""
    times, states = dense_states(source_of(triple), 2001)
    flow = of.flows.build_flow(build_model(triple.system))
    for k in (7, 501, 1333):
        assert np.abs(of.flows.end_state(flow, triple.state, times[k]) - states[k]).max() < 1e-5


def julia_in_python(text, u, t=0.0):
    """Run the body of rhs! as Python: the same statements but for `^`, with 1-based arrays."""
    one_based = lambda values: [None, *values]  # noqa: E731
    par = dict(re.findall(r"(\w+) = ([^,()]+),?", re.search(r"const par = \((.*)\)", text).group(1)))
    values = {name: float(value) for name, value in par.items()}
    names = re.findall(r"par\.(\w+), ", re.search(r"    s = \((.*)\)", text).group(1))
    body = re.search(r"    w = similar\(du, (\d+)\)\n(.*?)    return du", text, re.DOTALL)
    lines = [line.strip().replace("^", "**").replace("(t,)[1]", "t") for line in body.group(2).splitlines()]
    arrays = {"s": one_based(values[n] for n in names), "p": one_based(values.values()), "u": one_based(u)}
    du, w = one_based([math.nan] * len(u)), one_based([math.nan] * int(body.group(1)))
    return executed(lines, **arrays, du=du, w=w, t=t, par=SimpleNamespace(**values))["du"][1:]


@pytest.mark.parametrize("system", ["chain", "four-bar", "forced_pendulum", "pendulum_on_cart", "van_der_pol"])
def test_julia_statements_are_the_right_hand_side(triple, system):
    """The statements of the written file, executed as Python, give CasADi's numbers."""
    field, (t, x, s, _) = field_and_arguments(system)
    model = build_model(SYSTEMS[system])
    orbit = replace(triple, system=SYSTEMS[system], state=x, samples=np.vstack([x, x]), times=np.arange(2.0))
    found = julia_in_python(*julia_files(source_of(orbit)).values(), x, t)
    wanted = field(t, x, 0 * s, model.parameter_values).full().ravel()
    np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)


def test_julia_file_is_julia(triple):
    """The grammar of tree-sitter finds no error in it (Julia itself was not run)."""
    grammar, tree_sitter = pytest.importorskip("tree_sitter_julia"), pytest.importorskip("tree_sitter")
    parser = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
    (text,) = julia_files(source_of(triple)).values()
    assert not parser.parse(text.encode()).root_node.has_error
    assert parser.parse(text.replace("return du\nend", "return du").encode()).root_node.has_error


def run_auto(folder, word):
    """Run AUTO on exported files: rows of the branch, and the state at t = 0 and PAR of its last point."""
    environment = os.environ | {"AUTO_DIR": str(AUTO), "OMP_NUM_THREADS": "1"}
    command = ["sh", str(AUTO / "cmds" / "@r"), word]
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
    rows = [line.split() for line in (folder / "fort.7").read_text().splitlines()]
    branch = [[float(entry) for entry in row] for row in rows if row[0] != "0" and len(row) > 6]
    lines = (folder / "fort.8").read_text().splitlines()
    heads = [k for k, line in enumerate(lines) if len(line.split()) in (12, 16)]
    return branch, lines, heads


@needs_auto
def test_auto_continues_the_pendulum_along_the_elliptic_integral(tmp_path, pendulum_orbit):
    """AUTO's first point is our orbit; after 20 steps its period is the exact one at its energy."""
    export_orbit(pendulum_orbit, "auto", tmp_path)
    branch, _, _ = run_auto(tmp_path, "pendulum")
    first, last = branch[0], branch[-1]
    assert first[-2] == pytest.approx(pendulum_orbit.period, rel=1e-9)
    amplitude = math.acos(-last[-1] / (0.5 * 9.8))
    assert len(branch) == 20 and abs(amplitude - 1.0) > 0.05
    assert last[-2] == pytest.approx(pendulum_period(amplitude), rel=1e-7)


@needs_auto
def test_auto_loads_the_triple_pendulum_and_follows_its_family(tmp_path, triple):
    """The period at the energy that AUTO reached is the one that we find there, to 1e-6."""
    export_orbit(triple, "auto", tmp_path)
    branch, lines, heads = run_auto(tmp_path, "triple_1")
    energy, period = branch[-1][-1], branch[-1][-2]
    state = [float(entry) for entry in " ".join(lines[heads[-1] + 1 : heads[-1] + 3]).split()[1:7]]
    problem = of.Problem(of.chain(3), of.Guess(state, period), of.pin(energy=energy))
    assert branch[0][-2] == pytest.approx(triple.period, abs=1e-8)
    assert abs(period - triple.period) > 1e-2
    assert of.find_orbit(problem).period == pytest.approx(period, abs=1e-6)


@needs_auto
def test_auto_runs_forced_systems_through_the_added_oscillator(tmp_path):
    """The driven Duffing orbit is AUTO's first point and its period stays locked to the forcing."""
    orbit = of.find_orbit(of.load_problem(ROOT / "problems" / "gallery" / "forced-duffing-upper.toml"))
    export_orbit(orbit, "auto", tmp_path)
    branch, _, _ = run_auto(tmp_path, "forced_duffing_upper")
    assert branch[0][-2] == pytest.approx(orbit.period, rel=1e-8)
    assert branch[-1][-2] == pytest.approx(2 * math.pi / branch[-1][4], rel=1e-8)  # the first parameter: frequency
    assert abs(branch[-1][4] / branch[0][4] - 1) > 0.01


@needs_auto
@pytest.mark.slow
@pytest.mark.parametrize("path", GALLERY, ids=lambda path: path.parent.name)
def test_auto_loads_every_orbit_of_the_gallery(tmp_path, path):
    """AUTO's first, corrected point has our period, and 20 steps are taken."""
    orbit = of.load_orbit(path)
    files = export_orbit(orbit, "auto", tmp_path)
    branch, _, _ = run_auto(tmp_path, files[0].stem)
    assert len(branch) == 20 and any(abs(value / orbit.period - 1) < 1e-7 for value in branch[0])


def test_auto_files_say_what_is_where(triple):
    """Equations, constants and data belong together."""
    files = auto_files(source_of(triple))
    assert set(files) == {"triple_1.f90", "c.triple_1", "triple_1.dat"}
    rows = np.array([line.split() for line in files["triple_1.dat"].splitlines()], float)
    assert rows.shape == (2001, 7) and rows[-1, 0] == triple.period and np.abs(rows[0, 1:] - triple.state).max() < 1e-15
    assert "dat = 'triple_1'" in files["c.triple_1"] and f"ICP = [1, {PERIOD}, {ENERGY}]" in files["c.triple_1"]
    assert f"PAR({PERIOD}) = {fortran_number(triple.period)}" in files["triple_1.f90"]


def test_names_of_parameters_that_auto_uses_itself_are_kept_apart(triple):
    """Van der Pol's damping is not the unfolding, and continues by itself."""
    x = np.ones(2)
    orbit = replace(triple, name="2 pol", system=SYSTEMS["van_der_pol"], state=x, samples=np.vstack([x, x]),
                    times=np.arange(2.0))  # fmt: skip
    files = auto_files(source_of(orbit))
    assert "15: 'damping'" in files["c.orbit_2_pol"] and "ICP = [15, 11, 2]" in files["c.orbit_2_pol"]
    assert "F(2) = F(2) + s(1) * U(2)" in files["orbit_2_pol.f90"]


@needs_auto
def test_auto_continues_a_system_with_two_first_integrals(tmp_path):
    """A pendulum on a free cart, as a boundary-value problem: the period at the energy reached is ours."""
    orbit = of.find_orbit(of.load_problem(ROOT / "problems" / "gallery" / "pendulum-on-cart.toml"))
    export_orbit(orbit, "auto", tmp_path)
    branch, _, _ = run_auto(tmp_path, "pendulum_on_cart")
    energy, period = branch[-1][-1], branch[-1][-3]
    model, amplitude = build_model(orbit.system), branch[-1][6]
    guess = of.Guess([0.0, amplitude, 0.0, 0.0], period)
    again = of.find_orbit(of.Problem(model, guess, of.pin(energy=energy)))
    assert branch[0][-3] == pytest.approx(orbit.period, rel=1e-8) and abs(period - orbit.period) > 0.1
    assert again.period == pytest.approx(period, abs=1e-6)


@needs_auto
def test_auto_follows_the_figure_eight_along_keplers_third_law(tmp_path):
    """Three bodies conserve energy and angular momentum, and T |E|^(3/2) is the same for every size."""
    model, period = three_bodies(), float(EIGHT_PERIOD)
    x1, v3 = np.array([0.97000436, -0.24308753]), np.array([-0.93240737, -0.86473146])
    state = np.concatenate([-2 * x1, np.zeros(4), 1.5 * v3])
    orbit = of.find_orbit(of.Problem(model, of.Guess(state, period), of.pin(period=period), name="eight"))
    export_orbit(orbit, "auto", tmp_path, model)
    branch, _, _ = run_auto(tmp_path, "eight")
    law = [row[-3] * abs(row[-1]) ** 1.5 for row in branch]
    assert abs(branch[-1][-3] / branch[0][-3] - 1) > 0.1
    assert np.ptp(law) < 1e-6 * law[0]


def test_what_the_auto_files_cannot_state_is_refused(triple, monkeypatch):
    x = np.ones(4)
    samples, times = np.vstack([x, x]), np.arange(2.0)
    cart = replace(triple, system=SYSTEMS["pendulum_on_cart"], state=x, samples=samples, times=times)
    source = source_of(cart)
    assert "IPS = 4" in auto_files(source)["c.triple_1"]
    many = replace(source, model=altered(source.model, invariants=source.model.invariants * 5))
    with pytest.raises(InputError, match="^to: more than 9 first integrals have no place in AUTO's PAR"):
        auto_files(many)
    forced = replace(source, model=altered(source.model, forcing_period=ca.Function("P", [ca.SX.sym("p", 4)], [1.0])))
    with pytest.raises(InputError, match="^to: a forced system that keeps a momentum is not covered for AUTO"):
        auto_files(forced)


def invoke(*arguments):
    return CliRunner().invoke(cli, [str(one) for one in arguments])


@pytest.mark.parametrize("to, names", [
    ("csv", ["triple-1.csv"]), ("c", ["triple_1.c"]), ("julia", ["triple_1.jl"]),
    ("auto", ["triple_1.f90", "c.triple_1", "triple_1.dat"]),
])  # fmt: skip
def test_command_writes_beside_or_where_told(tmp_path, to, names):
    result = invoke("export", RESULTS / "triple-1" / "orbit.json", "--to", to, "-o", tmp_path / "new")
    assert result.exit_code == 0
    assert result.stdout.split() == [str(tmp_path / "new" / name) for name in names]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(names)


@needs_cc
@pytest.mark.parametrize(
    "name", [pytest.param("compass-level", marks=pytest.mark.slow), "maintained-oscillator", "hopping-monopod"]
)
def test_controls_are_in_the_csv_and_drive_the_motion_from_c_and_python(tmp_path, name):
    """The first arc by SciPy under the exported Python ends where the record says; C and the table say the same."""
    orbit = of.load_orbit(ROOT / "docs" / "gallery" / "orbits" / f"control-{name}.json")
    model, control = build_model(orbit.system), orbit.control
    (table,), (source, script) = (export_orbit(orbit, to, tmp_path) for to in ("csv", "c"))
    assert table.read_text().splitlines()[0].split(",") == ["t", *model.state_names, *control["names"]]
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    back = read_trajectory(tmp_path, table.name, len(model.state_names), not model.smooth, model.controls)
    np.testing.assert_array_equal(back.states, rows[:, 1 : 1 + len(model.state_names)])
    program = runpy.run_path(str(script))
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", str(source), "-o", "u.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    act, found = ctypes.CDLL(str(tmp_path / "u.so"))[f"{word_of(orbit.name)}_control"], np.empty(len(control["names"]))
    inside = np.flatnonzero((np.diff(rows[:, 0], append=np.inf) > 0) & (rows[:, 0] < orbit.period))
    for row in rows[inside[::8]]:
        act(ctypes.c_double(row[0]), ctypes.c_void_p(found.ctypes.data))
        np.testing.assert_allclose(program["control"](row[0]), row[1 + len(model.state_names) :], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found, program["control"](row[0]), rtol=1e-12, atol=1e-12)
    last = np.flatnonzero(np.diff(rows[:, 0], append=0.0) <= 0)[0]  # of the first arc
    field = vector_field(model if model.smooth else model.arcs[0][0].model, control["names"])
    end = solve_ivp(
        lambda t, x: field(t, x, [], program["control"](t)).full().ravel(), (0.0, rows[last, 0] * (1 - 1e-12)),
        rows[0, 1 : 1 + len(model.state_names)], method="DOP853", rtol=1e-7, atol=1e-9, max_step=orbit.period / 40,
    ).y[:, -1]  # fmt: skip
    np.testing.assert_allclose(end, rows[last, 1 : 1 + len(model.state_names)], atol=1e-6)


def edited(tmp_path, **changes):
    document = json.loads((RESULTS / "triple-1" / "orbit.json").read_text()) | changes
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(document))
    return path


def test_command_refuses_what_it_cannot_do(tmp_path):
    """Exit code 2 and a sentence, and nothing is written."""
    one = RESULTS / "triple-1" / "orbit.json"
    assert "no such file" in invoke("export", "none.json", "--to", "csv").stderr
    assert invoke("export", one, "--to", "xml").exit_code == 2
    twin = edited(tmp_path)
    for verb in (["export", "--to", "csv"], ["plot"], ["animate"]):  # one would be written over the other
        result = invoke(*verb, one, twin, "-o", tmp_path / "both")
        assert result.exit_code == 2 and "are both named 'triple-1'; give them one at a time" in result.stderr
    result = invoke("export", edited(tmp_path, name="../escape"), "--to", "csv")
    assert result.exit_code == 2 and "name: must consist of letters" in result.stderr
    result = invoke("export", edited(tmp_path, state=[0.0, 1.0]), "--to", "csv")
    assert result.exit_code == 2 and "state: 2 numbers" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["orbit.json"]


def test_titles_cannot_break_out_of_comments(triple):
    """A title is one line of ASCII in every comment."""
    hostile = replace(triple, title="*/ int main(){} \n end module \u202e Ω")
    for name, text in auto_files(source_of(hostile)).items():
        assert "\n end module" not in text and (name.endswith(".dat") or text.isascii())
    heading = source_of(hostile).heading[0]
    assert heading == "* / int main(){} end module ? ?"


def test_a_format_is_one_entry(tmp_path, triple, monkeypatch):
    """What puts itself into the table is written, and what it has no place for refused, as of any other."""
    monkeypatch.setitem(FORMATS, "names", Format(lambda source: {"names.txt": " ".join(source.model.state_names)}))
    (path,) = export_orbit(triple, "names", tmp_path)
    assert path.read_text() == "theta1 theta2 theta3 theta1dot theta2dot theta3dot"
    with pytest.raises(InputError, match="^to: unknown format 'xml'; use one of csv, auto, julia, c, names"):
        export_orbit(triple, "xml", tmp_path)


def test_unknown_format_of_the_python_function(tmp_path, triple):
    with pytest.raises(InputError, match="^to: unknown format 'xml'; use one of csv, auto, julia, c"):
        export_orbit(triple, "xml", tmp_path)
