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


def test_lazy_table_and_type_checking_imports_agree():
    """What mypy sees is what the lazy loader serves."""
    import ast

    tree = ast.parse((ROOT / "orbitfinder" / "__init__.py").read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.asname: (node.module or "").removeprefix("orbitfinder").removeprefix(".")
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == orbitfinder._HOMES


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'chian'"):
        _ = orbitfinder.chian


def test_dir_lists_unloaded_names():
    assert set(orbitfinder.__all__) <= set(dir(orbitfinder))


def test_versions_agree():
    """The version in pyproject.toml is the one the package reports."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert importlib.import_module("orbitfinder._runtime").__version__ == project["version"]
