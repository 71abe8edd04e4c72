"""How notebooks show orbits, certificates, families and atlases.

Those classes live on lower floors than the pictures. So `orbitfinder/__init__.py` says here which module draws, the
classes ask `html` in their `_repr_html_`, and the module is loaded when something is shown for the first time.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_drawing: list[str] = []
"""Name of the module whose `html(value)` draws; empty until the package's front door has said so."""


def drawn_by(module: str) -> None:
    """Let `module.html` draw from now on."""
    _drawing[:] = [module]


def html(value: Any) -> str | None:
    """HTML for a value, or None where nothing draws it: a notebook then shows the plain text."""
    if not _drawing:
        return None
    return import_module(_drawing[0]).html(value)  # type: ignore[no-any-return]
