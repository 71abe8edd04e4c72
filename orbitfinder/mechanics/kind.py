"""From a plain description (the `system` entry of a file) back to a Model: the registry of the kinds of [system].

Systems made by Python functions are rebuilt too: the built-in ones for everybody, others only where the user vouches
for them. What makes other kinds registers itself (`mechanisms.kinds`).
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import get_ident
from typing import Any

import numpy as np

from orbitfinder._runtime.arguments import Registry, check
from orbitfinder._runtime.caches import Kept
from orbitfinder._runtime.rooms import filled
from orbitfinder.errors import InputError, LimitError, closest
from orbitfinder.mechanics.constrained import Loops
from orbitfinder.mechanics.controls import check_constant, with_controls
from orbitfinder.mechanics.hybrid import at_numbers, with_cycle
from orbitfinder.mechanics.model import Model, altered
from orbitfinder.mechanics.scales import with_scales, with_units
from orbitfinder.records.orbit import system_at
from orbitfinder.records.reading import Entries, Table

BUILT_IN = "orbitfinder.systems"
"""The module whose functions everybody may name"""
PROBLEM = "problem"
"""The function of a Python problem file, which returns a Problem and not a Model"""
FUNCTIONS: dict[str, Callable[..., Any]] = {}
"""What `BUILT_IN` has, by name"""
_models = Kept[Model](8)
"""The last Models that descriptions stand for, of each thread its own: what is derived from them is kept with them"""


@dataclass(frozen=True)
class SystemKind:
    """What a kind of [system] says of itself: every question about kinds is answered by an entry of this table."""

    build: Callable[[Table, Path | None], Model]
    """(system, folder that is trusted) -> the Model"""
    words: Callable[[Table], str] = lambda system: str(system.get("kind"))
    """the kind of mechanism in two or three words, for captions"""
    described: bool = True
    """whether the description is all that it is made of"""
    rebuilt: bool = True
    """whether a description makes a Model, given the modules that it names"""
    takes: Callable[..., Model] | None = None
    """the function whose arguments are the keys of a file's table"""
    reread: bool = False
    """whether its description is read again where a parameter changes"""
    pendulum: bool = False
    """whether links hang on each other: each coordinate enters V as -c cos theta, with c > 0 at rest"""
    joints: Callable[[Table], int] = lambda system: 0
    """how many joints may have motors by their number"""
    drawn: bool = False
    """whether it is drawn: bodies and joints, near a pose, at a pace of its own"""
    loops: Loops | None = None
    """how its loops are closed, where that is not as any constraint's are"""
    with_content: Callable[[Table, Path], Table] = lambda system, folder: system
    """(system, a problem file's folder) -> the same with the content of the files that it names"""
    motion: Callable[[Model], Callable[..., Any] | None] = lambda model: None
    """(model) -> what integrates it for certificates by equations of its own, as `orbits.evidence.canonical_motion`"""
    field: Callable[[Model], Callable[[float, np.ndarray], np.ndarray] | None] = lambda model: None
    """(model) -> the field (t, x) -> x' of those equations"""
    works: Callable[[Model], tuple[Any, ...]] = lambda model: ()
    """(model) -> what of them a compiler may begin with"""


def build_model(system: Table, trusted: Path | None = None) -> Model:
    """The Model that a description stands for; of a linkage the one in maximal coordinates, or (with
    `independent` bars and `branch`) the minimal one; of a mechanism with loops the native DAE, or (with
    `independent` coordinates) the minimal one; of a chain with `baumgarte` terms the native DAE.

    `trusted` is the folder of a file whose Python functions may be imported (see `python_model`).
    Raises `InputError` for an unknown or wrong description.
    """
    try:
        kind = system_kind(system)
        if trusted is not None or not kind.described:
            return _built(kind, system, trusted)
        return _models((json.dumps(system), get_ident()), lambda: _built(kind, system, trusted))
    except InputError:
        raise
    except (TypeError, ValueError, KeyError, IndexError, OverflowError, AttributeError) as error:
        raise InputError(f"system: {error}; compare with a freshly written orbit.json") from error


def _built(kind: SystemKind, system: Table, trusted: Path | None) -> Model:
    bare = {key: value for key, value in system.items() if key != "units"}
    model = kind.build(bare, trusted)
    check(f"SystemKind {system.get('kind')!r}, build", "Model", model)
    return with_units(model, system.get("units"))


def system_kind(system: Table) -> SystemKind:
    """What a description's kind says of itself."""
    return kinds().get(str(system.get("kind")), OTHER)


def kinds() -> Mapping[str, SystemKind]:
    """Every kind by its name."""
    filled("kinds")
    return KINDS


def loops_of(system: Table) -> Loops:
    """How the loops of a system under constraints are closed."""
    return system_kind(system).loops or CLOSING[""]


def _unknown(system: Table, _: Path | None) -> Model:
    raise InputError(
        f"system.kind: cannot rebuild {system.get('kind')!r} from a file; in Python give the Model itself (model=...), "
        "and for commands find the orbit by a program with problem() (run FILE.py --trust), or by a problem file "
        "of kind = " + " or ".join(map(repr, kinds()))
    )


def python_model(system: Table, trusted: Path | None = None) -> Model:
    """The Model of a `kind = "python"` description {module, function, arguments}.

    `orbitfinder.systems` is always allowed and only its registered functions are. With `trusted`
    (the folder of a file that the user vouches for) any other module is imported (see `module_file`). The function
    `problem` is that of a Python problem file: its Problem's Model, arguments being physical parameters.
    Raises `InputError`, also for whatever the function raises.
    """
    module, name = system.get("module", BUILT_IN), system.get("function")
    arguments = system.get("arguments", {})
    if not (isinstance(module, str) and isinstance(name, str) and isinstance(arguments, Mapping)):
        raise InputError("system: a python system needs module and function (text) and arguments (a table)")
    filled("kinds")
    if module == BUILT_IN and name not in FUNCTIONS:
        known = ", ".join(FUNCTIONS)
        raise InputError(f"system.function: {BUILT_IN} has no {name!r}{closest(name, FUNCTIONS)}; it has {known}")
    function = FUNCTIONS[name] if module == BUILT_IN else _foreign(module, name, trusted)
    try:
        with neighbours(trusted):
            model = with_parameters(function().model, arguments) if name == PROBLEM else function(**arguments)
    except (InputError, LimitError):
        raise
    except TypeError as error:
        raise InputError(f"system.arguments: {error}; compare with help({module}.{name})") from error
    except Exception as error:
        raise InputError(f"system.function: {module}.{name} failed with {type(error).__name__}: {error}") from error
    if not isinstance(model, Model):
        raise InputError(f"system.function: {module}.{name} returned {type(model).__name__}; return a Model")
    if module != BUILT_IN and name != PROBLEM:
        _check_arguments(f"{module}.{name}", function, arguments, model)
    scales = system.get("scales", model.scales)
    if module != BUILT_IN:
        told = {key: model.system[key] for key in ("units",) if key in model.system}
        model = replace(model, system=described(told, module, name, arguments))
    if not isinstance(scales, Mapping):
        raise InputError("system.scales: must be a table of names and sizes")
    if given := {name: system[name] for name in ("controls", "limits") if name in system}:  # its own without
        limits = {**model.limits, **given.get("limits", {})}
        model = with_controls(model, given.get("controls", model.controls), limits)
        model = replace(model, system={**model.system, **given})
    model = with_scales(model, scales)
    return with_cycle(model, system["cycle"]) if "cycle" in system else model


def _check_arguments(where: str, function: Callable[..., Any], given: Table, model: Model) -> None:
    """`InputError` for numbers under other names than the Model's parameters, which files could not give back."""
    taken = inspect.signature(function).parameters
    if any(each.kind is each.VAR_KEYWORD for each in taken.values()):
        return
    values = {name: given.get(name, each.default) for name, each in taken.items()}
    strange = [name for name, x in values.items() if isinstance(x, float) and name not in model.parameter_names]
    missing = [name for name in model.parameter_names if name not in taken]
    if strange and missing:
        raise InputError(
            f"system.arguments: {where} takes {strange[0]!r}, which is no parameter of its Model, and not the Model's "
            f"{missing[0]!r}, so that no file could give that back; call both the same"
        )


@contextmanager
def neighbours(folder: Path | None) -> Iterator[None]:
    """Modules of a trusted folder may be imported meanwhile, and are then forgotten: others may have the same names."""
    before, place = set(sys.modules), str(folder)
    if folder is not None:
        sys.path.insert(0, place)
    try:
        yield
    finally:
        if folder is not None:
            sys.path.remove(place)
        for name in set(sys.modules) - before:
            if folder and Path(getattr(sys.modules[name], "__file__", None) or ".").parent == folder:
                del sys.modules[name]


def described(system: Table, module: str, function: str, arguments: Table | None = None) -> Entries:
    """The description of a system that a module's function makes, with what else (a cycle) was said of it."""
    made = {"kind": "python", "module": module, "function": function, "arguments": dict(arguments or {})}
    return {**system, **made}


def _foreign(module: str, name: str, trusted: Path | None) -> Callable[..., Any]:
    """A function of a module that is not ours, imported only for a trusted file."""
    if trusted is None:
        raise InputError(
            f"system.module: {module!r} is a program that is not part of orbitfinder, so it was not run; read it, "
            f"then add --trust (in Python give the Model), or use module = {BUILT_IN!r}"
        )
    if not all(part.isidentifier() for part in module.split(".")):
        raise InputError(f"system.module: {module!r} is no module name; give one such as 'my_system' (my_system.py)")
    try:
        places = (trusted / f"{module}.py", Path.cwd() / f"{module}.py")  # an orbit.json is seldom beside its problem
        if (place := next((place for place in places if place.is_file()), None)) is not None:
            spec = importlib.util.spec_from_file_location(f"orbitfinder_trusted_{module}", place)
            assert spec is not None and spec.loader is not None
            imported = importlib.util.module_from_spec(spec)
            with neighbours(place.parent):
                spec.loader.exec_module(imported)
        else:
            imported = importlib.import_module(module)
    except LimitError:
        raise
    except Exception as error:
        raise InputError(
            f"system.module: {module!r} cannot be imported ({type(error).__name__}: {error}); "
            f"work in the folder of {module}.py, or put it beside the file"
        ) from error
    function = getattr(imported, name, None)
    if not callable(function):
        raise InputError(f"system.function: {module} has no function {name!r}; define it there")
    return function  # type: ignore[no-any-return]


def with_parameters(model: Model, values: Mapping[str, float]) -> Model:
    """The same Model with some physical parameters changed, its description included; itself where none is."""
    if not values:
        return model
    check_constant(model, values)
    numbers = model.parameter_values.copy()
    for name, value in values.items():
        numbers[model.parameter_index(name)] = value
    system = system_at(model.system, values)
    if system_kind(model.system).reread:
        return build_model(system)
    return altered(model, parameter_values=numbers, system=system, hybrid=at_numbers(model.hybrid, numbers))


def check_reachable(model: Model, name: str, goals: Mapping[str, Sequence[float]]) -> None:
    """`InputError` for values of what is followed, by argument, that the system cannot have: a period that is not
    positive, a forcing without one, a parameter that its description refuses.

    Loops that stay open there are left to the family, which ends where they do; a system that is not rebuilt says no
    more than its forcing. Descriptions refuse what is not positive: only values across 0 are asked of them, which takes
    a derivation.
    """
    own = model.named_parameters.get(name)
    for argument, numbers in goals.items():
        for number in {min(numbers), max(numbers)} if len(numbers) else ():
            if not np.isfinite(number):
                raise InputError(f"{argument}: must be a finite value of {name}, got {number}")
            if name == "period" and number <= 0:
                raise InputError(f"{argument}: period: must be positive, got {number:g}; check the sign and the unit")
            try:
                model.check_clock(name, [number])
                if own is not None and own * number <= 0:
                    build_model(system_at(model.system, {name: number}))
            except InputError as error:
                if error.field in ("joints", "linkage") or (error.field != name and not _rebuilt(model)):
                    continue
                raise InputError(f"{argument}: {name} cannot become {number:g}: {error}") from error


def _rebuilt(model: Model) -> bool:
    """Whether a model can be made again from its description."""
    try:
        build_model(model.system)
    except InputError:
        return False
    return True


NAMES = {"henon_heiles": "Hénon-Heiles", "van_der_pol": "Van der Pol", "duffing": "Duffing",
         "forced_duffing": "forced Duffing", "restricted_three_body": "restricted three-body"}  # fmt: skip


def _function(system: Table) -> str:
    name = str(system.get("function", "python"))
    name = str(system.get("module", name)) if name == PROBLEM else name  # the program of a Python problem file
    return NAMES.get(name, name.replace("_", " "))


def restricted(system: Table) -> bool:
    """Whether a system is a restricted three-body problem, whose Jacobi constant is C = -2 H."""
    here = system.get("module") == "orbitfinder.systems"
    return here and str(system.get("function")).startswith("restricted_three_body")


KINDS = Registry(SystemKind, {"python": SystemKind(python_model, _function, described=False)})
"""Every kind by its name; others may join (`kinds` has them all)"""
CLOSING: dict[str, Loops] = {}
"""How loops are closed of what has no entry of its own: that of ''"""
OTHER = SystemKind(_unknown, described=False, rebuilt=False)
"""Models that no file describes"""
