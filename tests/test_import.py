"""Importing the package is cheap, and everything it promises is there."""

import importlib
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import orbitfinder

ROOT = Path(__file__).parents[1]
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


def test_dir_lists_unloaded_names():
    assert set(orbitfinder.__all__) <= set(dir(orbitfinder))


def test_versions_agree():
    """The version in pyproject.toml is the one the package reports."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert importlib.import_module("orbitfinder._runtime.version").__version__ == project["version"]
