"""Importing the package is cheap, and everything it promises is there."""

import copy
import functools
import importlib
import pickle
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import EXTRAS

import orbitfinder
from orbitfinder.loops.conditions import Variables
from orbitfinder.problemfile.read import load_problem_file

ROOT = Path(__file__).parents[1]
SKIPPED = re.compile(r"^( *)(?:\w+ = )?pytest\.importorskip\(\"([\w.]+)\"", re.MULTILINE)
HEAVY = ("casadi", "numpy", "scipy", "matplotlib", "rich", "pydantic", "click")


def fresh(code: str) -> str:
    """Standard output of a new interpreter that ran `code`."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    return done.stdout.strip()


def test_import_loads_nothing_heavy():
    """`import orbitfinder` pulls in none of its dependencies."""
    loaded = fresh(f"import sys, orbitfinder; print([m for m in {HEAVY!r} if m in sys.modules])")
    assert loaded == "[]"


@pytest.mark.parametrize("name", orbitfinder.__all__)
def test_every_exported_name_resolves_and_is_documented(name):
    """Each public name exists and, unless it is the version, has a docstring."""
    value = getattr(orbitfinder, name)
    assert name == "__version__" or (value.__doc__ or "").strip()


def test_a_name_whose_extra_is_missing_exists_and_says_what_to_install_when_it_is_called():
    """No extra is installed here: everything is there, is documented and shows itself; only a call is refused."""
    hidden = sorted({module for extra in EXTRAS.values() for module in extra} | {"imageio_ffmpeg", "traitlets"})
    said = fresh(
        f"import sys; sys.modules |= dict.fromkeys({hidden!r})\n"
        "import inspect, pydoc, orbitfinder as of\n"
        "from orbitfinder import *\n"
        "names = set(of.__all__)\n"
        "assert all(hasattr(of, name) for name in names) and names <= dict(inspect.getmembers(of)).keys()\n"
        "assert 'Needs the extra `[proof]`' in pydoc.render_doc(of) and inspect.signature(of.prove)\n"
        "orbit = of.load_orbit('results/orbits/triple-1/orbit.json')\n"
        "for call in (lambda: of.prove(orbit), lambda: of.robot('problems/robots/iiwa.urdf'), orbit.widget):\n"
        "    try: call()\n"
        "    except of.errors.InputError as error: print(error)\n"
    ).splitlines()
    assert [re.search(r"pip install '?orbitfinder\[(\w+)\]", line)[1] for line in said] == [
        "proof",
        "robot",
        "notebook",
    ]


def test_tests_say_which_extra_they_need():
    """A marker, never a silent importorskip: `.ci/run` selects by it what it runs once the extras are installed."""
    modules = {module for extra in EXTRAS.values() for module in extra}
    for path in sorted(Path(__file__).parent.glob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        asked = [(indent, name.partition(".")[0]) for indent, name in SKIPPED.findall(text)]
        wanted = [(indent, name) for indent, name in asked if name in modules]
        marked = re.search(r"^pytestmark = (?:\[\s*)?pytest\.mark\.needs\(", text, re.MULTILINE)
        assert not wanted or (marked and not any(indent for indent, _ in wanted)), path.name
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(EXTRAS) == set(project) - {"test", "mp4"}


@pytest.mark.parametrize("room", ["flows", "guesses", "linkages"])
def test_namespaces_offer_checked_documented_functions(room):
    """As at the front door: each name has a docstring, its functions belong to the namespace."""
    offered = getattr(orbitfinder, room)
    for name in offered.__all__:
        value = getattr(offered, name)
        assert value.__doc__.strip() and (isinstance(value, type) or value.__module__ == f"orbitfinder.{room}")
    with pytest.raises(AttributeError):
        _ = offered.nonsense


@pytest.mark.parametrize("name", orbitfinder._MOVED)
def test_a_name_of_the_last_version_says_where_it_is_now(name):
    with pytest.raises(AttributeError, match=rf"orbitfinder\.{name} (is now|has gone)") as caught:
        getattr(orbitfinder, name)
    if "is now" in str(caught.value):
        room, found = str(caught.value).split(".")[-2:]
        assert found == name and hasattr(getattr(orbitfinder, room), name)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'chian'"):
        _ = orbitfinder.chian


def test_a_misspelt_name_is_answered_with_the_one_that_was_meant():
    said = subprocess.run([sys.executable, "-c", "import orbitfinder; orbitfinder.find_orbti"], capture_output=True)
    assert said.stderr.strip().endswith(b"has no attribute 'find_orbti', did you mean 'find_orbit'?")  # and only once
    with pytest.raises(AttributeError, match="did you mean 'normal_mode'"):
        _ = orbitfinder.orbits.guesses.normal_mod


def test_a_misspelt_attribute_is_answered_with_the_one_that_was_meant(pendulum_orbit):
    """Also what is only a part of the name; with none near, what there is; a copy and a pickle are what they were."""
    meant = {"multipliers": "floquet_multipliers", "Period": "period", "certificat": "certificate"}
    for name, right in meant.items():
        with pytest.raises(AttributeError, match=f"'Orbit' object has no attribute '{name}', did you mean '{right}'"):
            getattr(pendulum_orbit, name)
    with pytest.raises(AttributeError, match="'Model' object has no attribute 'dof'; it has system, dynamics,"):
        _ = orbitfinder.chain(1).dof
    assert not hasattr(pendulum_orbit, "_repr_png_")
    again = pickle.loads(pickle.dumps(copy.deepcopy(pendulum_orbit)))
    assert again.period == pendulum_orbit.period and np.array_equal(again.state, pendulum_orbit.state)


def test_dir_lists_unloaded_names():
    assert set(orbitfinder.__all__) <= set(dir(orbitfinder))


def test_versions_agree():
    """The version in pyproject.toml is the one the package reports."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert importlib.import_module("orbitfinder._runtime").__version__ == project["version"]


@functools.cache
def values():
    """One value of every public type by its name, and of what they are made of."""
    of, q, v = orbitfinder, ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    model = of.chain(3)
    problem = of.Problem(model, of.guesses.normal_mode(model, 2, 0.3), of.pin(energy=-40.0))
    orbit = of.load_orbit(ROOT / "results" / "orbits" / "triple-1" / "orbit.json")
    family = of.load_family(ROOT / "results" / "families" / "triple-mode-2" / "family.json")
    linkage = of.linkage([0.5, 1.2, 1.0], ground=[0.2, 1.0])
    refiner = of.Refiner(of.Problem(of.chain(1), of.Guess([1.0, 0.0], 1.8), of.pin(theta1=1.0)))
    walker = of.systems.simplest_walker().hybrid
    pace = of.FrequencyMap(np.zeros((2, 4)), 9.0, np.ones((2, 2)), np.ones((2, 2)))
    ring = of.Torus(np.zeros((17, 2)), 1.0, 0.3, -1.0, 1e-12, 1.0)
    atlas = of.Atlas(next((ROOT / "results" / "atlas").glob("*.sqlite")))
    found = [
        model, problem, problem.guess, problem.pin[0], orbit, orbit.certificate, orbit.certificate.checks[0], family,
        family.points[0], family.events[0], family.ends[0], of.FamilySettings(), linkage.constraint,
        linkage.constraint.baumgarte, of.systems.planar_oscillator().invariants[0], of.Symbols(q, v), atlas,
        of.Control("torque1**2"), of.Task("theta1", 0.5, equals=1.0),
        of.Constraint(lambda v: v.period), of.Filter(), refiner, refiner.refine(), of.SolveSettings(),
        of.flows.build_flow(model), of.flows.IntegratorSettings(), of.linkages.DaeSettings(),
        of.simulate(model, [0.1] * 6, 0.1), of.stabilise(orbit, ["torque1"]),
        of.orbit_clip(orbit), walker.modes[0], walker.transitions[0],
        Variables(model, problem.boundary, (), (), ca.MX.sym("T"), {}, ca.MX.sym("p"), list),
        load_problem_file(ROOT / "problems" / "report" / "triple-1.toml"), ring, pace,
        of.Tori("around", model.system, "rotation", {"energy": -1.0}, (ring,)), of.TorusSettings(),
        of.Equilibria("rest", {}, "b", (of.Equilibrium(np.zeros(2), 1.0, np.zeros(2, complex), "neutral"),)),
        of.Equilibrium(np.zeros(2), 1.0, np.zeros(2, complex), "neutral"),
        of.BifurcationDiagram("tree", {}, "b", (0.0, 1.0), 2, "x", ()),
        of.ParameterMap("plane", {}, ("a", "b"), "period", ("x",), {}, 0, {}, *np.ones((2, 2)), *np.zeros((8, 2, 2)),
                        np.zeros((0, 3))),
        of.Optima("kept", "damping", (orbit,), np.zeros(1), (0,)),
        of.PhaseResponse("clock", {}, 1.0, (0, 0), np.zeros(1), ring.curve[:1], ring.curve[:1], 0.0, np.zeros(0), ""),
    ]  # fmt: skip
    return {type(one).__name__: one for one in found}


def test_every_public_type_has_a_value_here():
    public = {name for name in orbitfinder.__all__ if isinstance(getattr(orbitfinder, name), type)}
    assert public <= set(values())


def test_every_value_shows_itself_in_one_line():
    """An Orbit printed 9,669 characters once, a Family 103,434."""
    for name, value in values().items():
        shown = repr(value)
        assert shown.startswith(f"{name}(") and "\n" not in shown and len(shown) <= 300 and "=nan" not in shown, shown
