"""The front doors: names that load what they need on first use, their functions with checked arguments.

A door's names are in the stub beside it (`__init__.pyi`), once, for type checkers and for `lazy_loader`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any

import lazy_loader


def door(
    package: str, file: str, moved: Mapping[str, str] | None = None, public: str = ""
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package with a stub; `moved`: what to say of names that have gone,
    `public`: by which name it is imported too."""
    load, _, names = lazy_loader.attach_stub(package, file)
    gone, module = moved or {}, sys.modules[package]

    def getattr_(name: str) -> Any:
        if name not in names:
            from orbitfinder.errors import closest  # noqa: PLC0415 - NumPy; names must cost nothing

            meant = "" if name.startswith("_") else closest(name, names)
            said = gone.get(name) or f"module {package!r} has no attribute {name!r}{meant}"
            raise AttributeError(said, name=name, obj=None)  # or Python says once more what may have been meant
        value = fronted(load(name), public or package)
        setattr(module, name, value)
        return value

    return getattr_, lambda: sorted({*vars(module), *names}), names


def fronted(value: Any, package: str) -> Any:
    """A function with its arguments checked, under the door's name so that it can be pickled; the rest as it is."""
    if not isinstance(value, FunctionType):
        return value
    from orbitfinder._runtime.arguments import checked  # noqa: PLC0415 - NumPy; names must cost nothing

    front = checked(value)
    front.__module__ = package
    return front


def fronted_all(module: dict[str, Any]) -> None:
    """Every name that a module's `__all__` lists, as `fronted` has it, in the module's own names."""
    module.update({name: fronted(module[name], module["__name__"]) for name in module["__all__"]})
