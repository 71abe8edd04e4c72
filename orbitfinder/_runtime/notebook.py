"""How values are shown: a line in a terminal, and in a notebook orbits, certificates, families and atlases drawn.

Those classes live on lower floors than the pictures. So `orbitfinder/__init__.py` says here which module draws, the
classes are `Shown` and ask `html`, and the module is loaded when something is shown for the first time.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

_drawing: list[str] = []
"""Names of the modules whose `html(value)` draws and whose `stage(value)` makes a widget; empty until the package's
front door has said so."""


def drawn_by(module: str, staged: str) -> None:
    """Let `module.html` draw from now on, and `staged.stage` make widgets."""
    _drawing[:] = [module, staged]


def stage(value: Any) -> Any:
    """The widget of an orbit or a family. Raises `InputError` where the extra is missing."""
    return import_module(_drawing[1]).stage(value)


def html(value: Any) -> str | None:
    """HTML for a value, or None where nothing draws it: a notebook then shows the plain text."""
    if not _drawing:
        return None
    return import_module(_drawing[0]).html(value)  # type: ignore[no-any-return]


LONGEST = 60
"""characters of an attribute in a line"""


class Shown:
    """A value that users see: HTML in a notebook, and a misspelt attribute answered with what was meant."""

    __slots__ = ()

    def _repr_html_(self) -> str | None:
        """How a notebook shows it."""
        return html(self)

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if not TYPE_CHECKING:  # which dataclasses keep, and would compare arrays without
            cls.__eq__, cls.__hash__ = _equal, lambda self: hash(repr(self))  # which equal records share

    if not TYPE_CHECKING:  # type checkers know which attributes there are

        def __getattr__(self, name: str) -> Any:
            kind = type(self)
            fields = [field for field in getattr(kind, "__dataclass_fields__", ()) if not field.startswith("_")]
            known = [*fields, *(word for word in dir(kind) if not word.startswith("_") and word not in fields)]
            if name in known:  # Python comes here when a property fails, and has forgotten why
                raise AttributeError(f"{kind.__name__}: {name} could not be computed")
            said = f"{kind.__name__!r} object has no attribute {name!r}"
            if not name.startswith("_"):
                from orbitfinder.errors import closest  # noqa: PLC0415 - NumPy; importing must cost nothing

                whole = [word for word in known if name in word.split("_")]  # floquet_multipliers for multipliers
                said += closest(name, whole or known) or f"; it has {', '.join(known[:16])}"
            raise AttributeError(said, name=name, obj=None)


def _equal(self: Any, other: Any) -> Any:
    """Equality of records: of the same class, with equal entries, arrays number by number and nan being nan."""
    from numpy.testing import assert_equal  # noqa: PLC0415 - importing must cost nothing

    if type(self) is not type(other) or not hasattr(self, "__dataclass_fields__"):
        return NotImplemented
    names = [name for name, field in self.__dataclass_fields__.items() if field.compare]
    mine, others = ([getattr(each, name) for name in names] for each in (self, other))
    try:
        assert_equal(mine, others)
    except AssertionError:
        return False
    return True


_names: dict[Callable[[Any], str], tuple[str, ...]] = {}
"""The attributes that each `brief` shows"""


def chosen(value: Any) -> tuple[str, ...]:
    """The attributes that the line of a value shows."""
    return _names.get(getattr(type(value), "__repr__"), ())  # noqa: B009 - of the class, not bound


def facts(value: Any) -> list[tuple[str, str]]:
    """What the line of a value names, and the texts."""
    texts = [(name.replace("_", " "), _short(getattr(value, name, None)).strip("'")) for name in chosen(value)]
    return [(name, text) for name, text in texts if text not in ("", "nan")]


def brief(*names: str) -> Callable[[Any], str]:
    """A `__repr__` of a line: the class and these of its attributes, long ones by their size."""

    def text(self: Any) -> str:
        texts = {name: _short(getattr(self, name, None)) for name in names}
        said = ", ".join(f"{name}={value}" for name, value in texts.items() if value not in ("", "nan"))
        return f"{type(self).__name__}({said})"

    _names[text] = names
    return text


def _short(value: Any) -> str:
    """A value in at most `LONGEST` characters: numbers to nine digits, long lists by their size; nothing for none."""
    if value is None or (isinstance(value, (str, tuple)) and not value):
        return ""
    if isinstance(value, float):
        return f"{value:.9g}"
    size = " x ".join(map(str, getattr(value, "shape", None) or [len(value)])) if hasattr(value, "__len__") else ""
    said = " ".join(repr(value.tolist() if hasattr(value, "tolist") else value).split())
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        said = "[" + ", ".join(map(_short, value[:LONGEST])) + "]" if size else said
        return said if len(said) <= LONGEST else f"<{size}>"
    return said if len(said) <= LONGEST else said[: LONGEST - 3] + "..."
