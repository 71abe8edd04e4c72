"""The gallery of systems in the documentation: every problem file, its program, its equations, its orbit."""

import contextlib
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import orbitfinder as of

sympy = pytest.importorskip("sympy")
pytest.importorskip("urdf_parser_py")
pytestmark = pytest.mark.needs("docs")
ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))

import equations  # noqa: E402
import systems  # noqa: E402
from python_form import python_form  # noqa: E402

ENTRIES = {one.name: one for one in systems.entries()}
QUICK = (
    "chains-chain-20", "control-compass-level", "examples-double-least-unstable", "examples-triple-length-for-2s",
    "gallery-three-body-lyapunov", "hybrid-simplest-walker-period-2", "linkages-four-bar-drag-link",
    "mechanisms-sprung-platform",
)  # fmt: skip
SAME = ("symmetry", "winding", "segments", "tolerance", "free", "objective", "bounds", "relative", "control", "name")
FORMULAS = ("henon_heiles", "slip_walker", "wall_pendulum", "vibrated_pendulum", "lorenz")


def slow_unless(names, known):
    return [pytest.param(one, marks=[] if one in names else [pytest.mark.slow]) for one in known]


def test_every_problem_file_is_on_one_page():
    shown = [one.name for kind in systems.KINDS for one in systems.chosen(kind)]
    assert sorted(shown) == sorted(ENTRIES)
    stubs = {page.stem for page in (ROOT / "docs" / "gallery").glob("*.md")}
    assert stubs == {*systems.KINDS, "index", "diagrams", "newcomers"}


@pytest.mark.parametrize("name", [name for name, one in ENTRIES.items() if one.record is not None])
def test_orbit_is_certified_and_as_expected(name):
    """The record that the gallery draws is of this file: its title, its certificate, the period that it expects."""
    entry = ENTRIES[name]
    orbit = systems.record(entry)
    assert orbit.certificate.passed and orbit.title == entry.document["title"]
    expected = entry.document.get("expected", {}).get("period")
    if expected is not None:
        assert orbit.period == pytest.approx(expected["value"], abs=expected["tolerance"])
    for quantity, value in entry.document.get("find", {}).get("pin", {}).items():
        if quantity in ("energy", "period"):
            assert getattr(orbit, quantity) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("name", slow_unless(QUICK, [one for one in ENTRIES if not ENTRIES[one].program]))
def test_program_states_the_same_problem(name):
    """What stands in the file and what the program says are the same model, guess, pins and choices."""
    entry = ENTRIES[name]
    loaded, names = systems.loaded(entry), {}
    with contextlib.chdir(entry.path.parent):
        exec(python_form(loaded).split("orbit = ")[0], names)
    model = names["model"]
    assert model.state_names == loaded.model.state_names and model.parameter_names == loaded.model.parameter_names
    assert np.array_equal(model.parameter_values, loaded.model.parameter_values)
    assert model.controls == loaded.model.controls and model.limits == loaded.model.limits
    if loaded.problem is not None:
        made, wanted = names["problem"], loaded.problem
        assert np.array_equal(made.guess.state, wanted.guess.state) and made.guess.period == wanted.guess.period
        assert made.pin == wanted.pin and all(getattr(made, one) == getattr(wanted, one) for one in SAME)


@pytest.mark.parametrize("function", slow_unless(FORMULAS, of.systems.FUNCTIONS))
def test_formulas_are_the_models(function):
    """What is typeset has the value of the model's own function at a random place, before and after tidying."""
    model = of.systems.FUNCTIONS[function]()
    n, random = model.degrees_of_freedom, np.random.default_rng(0)
    groups = [("t",), model.state_names[:n], model.state_names[n:], model.parameter_names]
    here = [random.uniform(0.2, 0.9, len(one)) for one in groups]
    used = {"rates": (0, 1, 3), "kinetic": (1, 2, 3), "potential": (1, 3), "forces": (0, 1, 2, 3)}
    for name, places in used.items():
        formula = getattr(model, name)
        if formula is None or (model.rates is not None and name != "rates"):
            continue
        try:
            found = equations.expressions(formula, [groups[k] for k in places])
        except equations.TooLarge:
            continue
        values = {
            sympy.Symbol(symbol, real=True): value
            for k in places
            for symbol, value in zip(groups[k], here[k], strict=True)
        }
        wanted = np.asarray(formula(*(here[k] for k in places)).full()).ravel()
        for one, value in zip(found, wanted, strict=True):
            assert float(equations.tidy(one).subs(values)) == pytest.approx(value, rel=1e-9, abs=1e-12)
            assert float(one.subs(values)) == pytest.approx(value, rel=1e-9, abs=1e-12)


def test_letters():
    """Names as the field writes them."""
    letters = {"theta1dot": r"\dot{\theta}_{1}", "stiffness": "k", "length2": "l_{2}", "px": "p_{x}", "gravity": "g"}
    assert {name: equations.letter(name) for name in letters} == letters
    assert equations.letter("hip_mass") == r"m_{\mathrm{hip}}"


@pytest.mark.parametrize("function", of.systems.FUNCTIONS)
def test_no_letter_means_two_things(function):
    """FitzHugh and Nagumo's rate is not their b."""
    model = of.systems.FUNCTIONS[function]()
    found = equations.letters_of([*model.state_names, *model.parameter_names, "t"])
    assert len(set(found.values())) == len(found)


def test_what_is_too_large_is_described():
    """A walker's energies fit no line; its size and the law of its impact stand in their place."""
    rows, said = equations.equations(of.systems.five_link_walker())
    assert rows and any("elementary operations" in one for one in said) and any("M (v⁺ − v⁻)" in one for one in said)
    shown = equations.display(rows)
    assert shown.count("{") == shown.count("}") and "&amp;" in shown


def test_a_page_has_orbit_equations_file_and_program(monkeypatch):
    """What comes in place of a marker."""
    monkeypatch.setenv(systems.FEW, "few")
    monkeypatch.setattr(systems, "programs", lambda: dict.fromkeys(ENTRIES, "import orbitfinder as of"))
    text = systems.made("fields")
    entry = systems.chosen("fields")[0]
    assert f"{{: #{entry.name} }}" in text and "<animate" in text and "aligned" in text
    assert entry.text in text and "import orbitfinder" in text and "Source: " in text
    assert "<animate" not in systems.still(entry) and f"#{entry.name}" in systems.made("index")
    assert os.environ[systems.FEW] == "few"
