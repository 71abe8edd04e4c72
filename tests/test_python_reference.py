"""The reference of Python: every public name on one page, every parameter in its table, every example executed."""

import doctest
import inspect
import re
from functools import cache
from pathlib import Path

import pytest

pytest.importorskip("griffe")

from griffe import Docstring, parse_google

import orbitfinder as of

pytestmark = pytest.mark.needs("docs")
ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs" / "reference" / "python").glob("*.md"))
NAMES = [name for name in of.__all__ if name != "__version__" and not inspect.ismodule(getattr(of, name))]
SLOW = {"connect", "manifold", "save_animation", "switch_branch"}
"""Names whose examples take more than a second"""
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def sections(name):
    """The sections of a docstring by kind."""
    text = inspect.getdoc(getattr(of, name))
    return {part.kind.value: part.value for part in parse_google(Docstring(text, lineno=1), warnings=False)}


BEGINNING = re.compile(r"```py(?:thon)?\n(.*?)```", re.DOTALL)


def home(name):
    """Where a name of the front door is defined."""
    front = (ROOT / "orbitfinder" / "__init__.pyi").read_text()
    return re.search(rf"^from \.(\S+) import {name} as", front, re.MULTILINE).group(1) + f".{name}"


@cache
def beginning(page=None):
    """What examples begin with, executed once: what all pages have in common, then a page's own."""
    text = (page or ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    names, own = dict(beginning()) if page else {}, BEGINNING.search(text)
    if own:
        exec(own.group(1), names)
    return names


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.slow] * (one in SLOW)) for one in NAMES])
def test_example(name, tmp_path, monkeypatch):
    """An example runs after the beginning of its page, in any folder, and prints what it says."""
    page = next(one for one in PAGES if f"::: orbitfinder.{home(name)}\n" in one.read_text(encoding="utf-8"))
    names = dict(beginning(page))
    monkeypatch.chdir(tmp_path)
    test = doctest.DocTestParser().get_doctest(inspect.getdoc(getattr(of, name)), names, name, None, 0)
    assert test.examples, "no example"
    said = []
    doctest.DocTestRunner(optionflags=OPTIONS, verbose=False).run(test, out=said.append)
    assert not said, "".join(said)


@pytest.mark.parametrize("name", NAMES)
def test_parameters(name):
    """The table names every parameter, in order, and nothing else; what is raised is one of our errors."""
    found = sections(name)
    wanted = [one for one in inspect.signature(getattr(of, name)).parameters.values() if one.name != "self"]
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    assert [one.name for one in found.get("parameters", [])] == [stars.get(one.kind, "") + one.name for one in wanted]
    assert all(one.description for one in found.get("parameters", []))
    for one in found.get("raises", []):
        assert isinstance(getattr(of.errors, one.annotation), type), one.annotation
    if inspect.isfunction(getattr(of, name)):
        assert "returns" in found


def test_every_name_is_on_one_page():
    """The front door's names and the namespaces' are described once each."""
    described = [home for page in PAGES for home in re.findall(r"^::: orbitfinder\.([\w.]+)", page.read_text(), re.M)]
    assert len(described) == len(set(described)), sorted(one for one in described if described.count(one) > 1)
    front = (ROOT / "orbitfinder" / "__init__.pyi").read_text()
    homes = {f"{home}.{name}" for home, name in re.findall(r"^from \.(\S+) import (\w+)", front, re.MULTILINE)}
    homes |= {f"{one.__module__.removeprefix('orbitfinder.')}.{one.__name__}" for one in offered_by_the_namespaces()}
    assert homes - {"_runtime.__version__", "orbits.guesses"} <= set(described)
    assert {"mechanisms.library", "mechanisms.machines", "mechanisms.driven", "errors"} <= set(described)


def offered_by_the_namespaces():
    """The functions and classes of the namespaces, as their own modules define them."""
    for room in (of.flows, of.guesses, of.linkages, of.sections):
        for name in room.__all__:
            yield inspect.unwrap(getattr(room, name))


def test_see_also_names_exist():
    """`of.name` in a docstring of the front door is there."""
    for name in NAMES:
        for said in re.findall(r"`of\.([\w.]+)", inspect.getdoc(getattr(of, name))):
            value = of
            for part in said.split("."):
                value = getattr(value, part)
