"""What a caller gave against what the annotation asks for: a sentence, not an AttributeError ten calls further down.

The annotation is the rule, so that nothing is declared twice. The public functions are wrapped where
`orbitfinder/__init__.py` loads them, the frozen dataclasses that users fill in ask `check_fields`; what the house calls
inside is not checked.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import os
import re
from collections.abc import Callable, Iterable, Mapping
from numbers import Integral, Real
from typing import Any, Generic, ParamSpec, TypeVar

import numpy as np

from orbitfinder.errors import InputError, LimitError, closest

P = ParamSpec("P")
R = TypeVar("R")
Entry = TypeVar("Entry")

SEQUENCE = re.compile(r"(?:Sequence|tuple)\[(.+?)(?:, \.\.\.)?\]")
MAPPING = re.compile(r"Mapping\[str, (.+)\]")
MARKER, COLOUR = re.compile(r"[.,ov^<>12348spP*hH+xXDd|_]|\$.+\$"), re.compile("#[0-9A-Fa-f]{6}")


def _real(value: Any) -> bool:
    if isinstance(value, Real | np.bool_):
        return not isinstance(value, bool | np.bool_)
    return getattr(value, "shape", None) in ((), (1, 1)) and _numbers(value)


def _numbers(value: Any) -> bool:
    """Something that NumPy makes floats of, texts and None excepted."""
    try:
        return np.asarray(value).dtype.kind in "fiub"
    except LimitError:
        raise
    except Exception:  # whatever an object's own conversion raises: CasADi's symbols have four kinds
        return False


def _is_a(*names: str) -> Callable[[Any], bool]:
    """Whether a value is of a class of that name, which need not be imported for that."""
    return lambda value: any(base.__name__ in names for base in type(value).__mro__)


KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "float": (_real, "a number"),
    "int": (lambda value: isinstance(value, Integral) and not isinstance(value, bool), "a whole number"),
    "bool": (lambda value: isinstance(value, bool | np.bool_), "True or False"),
    "str": (lambda value: isinstance(value, str), "a text"),
    "Path": (lambda value: isinstance(value, str | os.PathLike), "a path"),
    "np.ndarray": (_numbers, "an array of numbers"),
    "Numbers": (_numbers, "a number, or one for each"),
    "Sequence[float]": (lambda value: _numbers(value) and np.ndim(value) > 0, "a list of numbers"),
    "tuple[float, float]": (
        lambda value: _numbers(value) and np.shape(value) == (2,),
        "two numbers, [smallest, largest]",
    ),
    "ca.SX": (lambda value: _is_a("SX", "DM")(value) or _numbers(value), "a CasADi SX expression"),
    "ca.MX": (lambda value: _is_a("MX", "DM")(value) or _numbers(value), "a CasADi MX expression"),
    "Answer": (lambda value: isinstance(value, str) or callable(value), "a function, or its name 'module:function'"),
    "Marker": (
        lambda value: isinstance(value, str) and bool(MARKER.fullmatch(value)),
        "'o', '^', '$T$' or another marker of Matplotlib",
    ),
    "Colour": (lambda value: isinstance(value, str) and bool(COLOUR.fullmatch(value)), "a colour such as '#00AA88'"),
    "Expression": (callable, "a function of the Variables"),
    "Callback": (callable, "a function"),
    "None": (lambda value: value is None, ""),
}
"""By annotation: the test, and what the message says is expected"""
MADE_BY = {
    "ca.SX": "write it in ca.SX.sym symbols, several rows as ca.vertcat(...)",
    "Model": "chain(...), lagrange(...) and the functions of orbitfinder.systems make one",
    "Problem": "Problem(model, guess) states one, load_problem(path) reads one",
    "Orbit": "find_orbit(problem) finds one, load_orbit(path) reads one",
    "Guess": "Guess(state, period) makes one, normal_mode(...) too",
    "Pin": "write pin=pin(energy=...)",
    "Constraint": "write (Constraint(expression),)",
    "Invariant": "Invariant(name, value, unfolding, generator) makes one",
    "Symbols": "Symbols(q, v) makes one of ca.SX.sym symbols",
    "Flow": "build_flow(model) makes one",
    "Clip": "orbit_clip(orbit) makes one",
    "Baumgarte": "Baumgarte(alpha, beta) makes one",
    "Family": "follow_family(origin) makes one, load_family(path) reads one",
    "Event": "family.events[k] is one",
    "Equilibria": "follow_equilibria(model, state, parameter) makes some, load_equilibria(path) reads some",
    "BifurcationDiagram": "diagram(model, state, parameter, until) makes one, load_diagram(path) reads one",
    "RestEvent": "equilibria.events[k] is one",
    "RestBranch": "switch_branch(equilibria, k) makes one at a branch point",
    "Optima": "follow_optima(problem) makes some, load_optima(path) reads some",
    "Tori": "follow_tori(orbit) makes some, load_tori(path) reads some",
    "Torus": "torus(orbit) makes one, tori.tori[k] is one",
    "Controller": "stabilise(orbit) designs one, load_controller(path) reads one",
    "FamilySettings": "FamilySettings(directions=...) makes them",
    "SolveSettings": "SolveSettings(max_iterations=...) makes them",
    "IntegratorSettings": "IntegratorSettings(relative_tolerance=...) makes them",
    "DaeSettings": "DaeSettings(relative_tolerance=...) makes them",
    "Test": "Test(kind, detail, measure) makes one",
    "Reading": "sides.zero(measure) makes one",
    "Look": "Look(marker, symbol, colour) makes one",
    "Followed": "Followed(vanishes) makes one",
    "Condition": "Condition(name, value, at, slope, expression) makes one",
    "Certificate": "Certificate((at_most(name, value, tolerance),)) makes one",
}
"""By class: where it comes from; the remedy in its message. Other names are aliases, and not looked into."""


def fits(annotation: str, value: Any) -> bool:
    """Whether a value is what any alternative of an annotation asks for; an unknown alternative takes everything."""
    return any(_fits(part, value) for part in _alternatives(annotation))


def _fits(part: str, value: Any) -> bool:
    if part in KINDS:
        return KINDS[part][0](value)
    if part.startswith("Callable["):
        return callable(value)
    if match := MAPPING.fullmatch(part):
        keyed = isinstance(value, Mapping) and all(isinstance(key, str) for key in value)
        return keyed and all(fits(match[1], entry) for entry in value.values())
    if match := SEQUENCE.fullmatch(part):
        listed = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
        return listed and all(fits(match[1], entry) for entry in value)
    return part not in MADE_BY or _is_a(part)(value)


@functools.lru_cache(maxsize=1024)
def _alternatives(annotation: str) -> tuple[str, ...]:
    """The parts of A | B[C | D] | None outside brackets."""
    return tuple(re.split(r" \| (?![^\[]*\])", annotation))


def _expected(part: str) -> str:
    if part in KINDS:
        return KINDS[part][1]
    if part.startswith("Callable["):
        return "a function"
    if part.endswith(", Any]"):
        return "a table, {name: ...}"
    if match := MAPPING.fullmatch(part):
        return f"names with {_expected(match[1])} each, {{name: ...}}"
    if match := SEQUENCE.fullmatch(part):
        return f"a list, each {_expected(match[1])}"
    return f"{'an' if re.match(r'[AEIO]|U(?!ni|se|til)', part) else 'a'} {part}"


def shown(value: Any) -> str:
    """A value in a message: itself where it is short and plain, else its type."""
    plain = isinstance(value, str | Real | list | tuple | dict) or value is None
    text = repr(value) if plain else ""
    return text if 0 < len(text) <= 60 else f"{type(value).__name__} {text[:60]}".strip()


def check(name: str, annotation: str, value: Any, remedy: str = "") -> None:
    """`InputError` naming the argument, what it should be, what was given and where it comes from, or a `remedy`."""
    if fits(annotation, value):
        return
    parts = [part for part in _alternatives(annotation) if part != "None"]
    expected = " or ".join(dict.fromkeys(_expected(part) for part in parts if (part, "Path") != ("str", parts[-1])))
    words = re.findall(r"ca\.SX|[A-Za-z]+", " ".join(part for part in parts if not part.startswith("Callable[")))
    made = next((f"; {MADE_BY[word]}" for word in words if word in MADE_BY), remedy)
    raise InputError(f"{name}: expected {expected}, got {shown(value)}{made}")


def check_fields(instance: Any, where: str = "", remedy: str = "") -> None:
    """`check` for every field of a dataclass whose annotations are texts; for its `__post_init__`, or, with what it is
    part of, for what it holds too."""
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        check(where + field.name, str(field.type), value, remedy)
        if where and dataclasses.is_dataclass(value):
            check_fields(value, f"{where}{field.name}.", remedy)


class Registry(dict[str, Entry], Generic[Entry]):
    """A table of entries of one class, in which others may enter theirs; each is looked at when it is entered."""

    def __init__(self, kind: type[Entry], entries: Mapping[str, Entry] | None = None) -> None:
        super().__init__()
        self.kind = kind
        self.update(entries)

    def __setitem__(self, name: str, entry: Entry) -> None:
        """Raises `InputError` with the names of the entry and of its field."""
        called = self.kind.__name__
        where, remedy = f"{called} {name!r}", f"; see {self.kind.__module__}.{called}"
        if not isinstance(entry, self.kind):
            raise InputError(f"{where}: expected {_expected(called)}, got {shown(entry)}{remedy}")
        check_fields(entry, f"{where}, ", remedy)
        super().__setitem__(name, entry)

    def update(self, entries: Mapping[str, Entry] | None = None, **more: Entry) -> None:  # type: ignore[override]
        """Enter several."""
        for name, entry in {**(entries or {}), **more}.items():
            self[name] = entry


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """A function that checks its arguments."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def front(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            given = signature.bind(*args, **kwargs)
        except TypeError as error:
            wrong = next((word for word in kwargs if word not in signature.parameters), "")
            hint = closest(wrong, list(signature.parameters)) if wrong else ""
            plain = (each.replace(annotation=inspect.Parameter.empty) for each in signature.parameters.values())
            usage = f"{function.__name__}({', '.join(map(str, plain))})"
            raise InputError(f"{function.__name__}: {error}{hint}; call it as {usage}") from error
        for name, value in given.arguments.items():
            parameter = signature.parameters[name]
            several = value if parameter.kind is inspect.Parameter.VAR_KEYWORD else {name: value}
            for each, entry in several.items():
                check(each, str(parameter.annotation), entry)
        return function(*given.args, **given.kwargs)

    return front
