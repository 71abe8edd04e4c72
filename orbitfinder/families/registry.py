"""What a kind of event is: one entry of `KINDS` says all of it, and nothing else asks for a kind by its name.

From its entry a kind is looked for, checked, recorded, verified, left, followed in two parameters, drawn (`Look`), put
on pages and told of in the docs. Those that there are stand in `families.entries`; one more, wherever it is written, is

    KINDS["on_time"] = EventKind(check, "the period is what it should be", Look("$T$"), test=tests)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, TypeAlias

import numpy as np

from orbitfinder._runtime.arguments import Registry, check
from orbitfinder.errors import ConvergenceError, InputError, closest
from orbitfinder.families.passages import Test
from orbitfinder.families.run import Interval, Sample
from orbitfinder.families.stability import Spectrum
from orbitfinder.loops.continued import Curve, Solution
from orbitfinder.records.family import Event, Reading

Marker: TypeAlias = str
Colour: TypeAlias = str


@dataclass(frozen=True)
class Look:
    """How a kind of event is drawn: Matplotlib's marker with its size (points), Plotly's symbol with its size (pixels)
    and its line, the colour of figures (none of them a family's) and the number of the page's, whether it is hollow.

    In figures it may be `numbered`, or have a line `across` the stability indices; of kinds that are `many` pages show
    what the others leave room for.
    """

    marker: Marker = "o"
    symbol: str = "circle"
    colour: Colour = "#000000"
    series: int = 1
    size: float = 5.5
    pixels: int = 10
    hollow: bool = False
    line: float = 1.5
    numbered: bool = False
    across: bool = False
    many: bool = False


@dataclass(frozen=True)
class Followed:
    """How a kind is followed while two parameters vary; `test` is the `codimension_two.Critical` of its curve.

    `vanishes(test, curve, orbits)`, a number of each, is 0 along the curve. Of codimension two are there the zeros of
    `tests(test, spectrum)`, and what is `special(interval)` besides, with its orbit. `margin(curve, orbit, event)`
    names what is grazed, `refused(curve, orbit)` says why an orbit is none of the curve, and `beyond` what is met where
    the multipliers become real, at which the curve ends.
    """

    vanishes: Callable[[Any, Curve, Sequence[Solution]], np.ndarray]
    tests: Callable[[Any, Spectrum], Iterable[Test]] = lambda test, spectrum: ()
    special: Callable[[Interval], Iterable[tuple[Sample, Test]]] = lambda interval: ()
    margin: Callable[[Curve, Solution, Event], tuple[int, str, str]] | None = None
    refused: Callable[[Curve, Solution], str] = lambda curve, orbit: ""
    beyond: str = ""


@dataclass(frozen=True)
class EventKind:
    """A kind of event: what its `check` of the orbits about it (`checks.Sides`) says, what happens there in `words`,
    how it looks, and what is done with it.

    `test`: what vanishes there within a step, of kinds that are looked for alone. `extremal`: something turns there.
    `crosses`: two families cross, by a multiplier at +1 that every fold has too. `critical`: the verdict on stability
    may change there. `verdict`: it does, and the detail says how. `branches`: other families leave there
    (`of.switch_branch`). `followed`: how a curve in two parameters leads through it (`of.follow_curve`). `second`: it
    is met on such curves only, and a pair that comes to +1 or -1 there `leaves` the unit circle. `side` says whether it
    is supercritical or subcritical, where that can be told.
    """

    check: Callable[[Any, Event], Reading]
    words: str = ""
    look: Look = Look()
    test: Callable[[Interval], Iterable[Test]] | None = None
    extremal: bool = False
    crosses: bool = False
    critical: bool = False
    verdict: bool = False
    branches: bool = False
    followed: Followed | None = None
    second: bool = False
    leaves: bool = False
    side: Callable[[Any, Event], str] = lambda sides, event: ""


KINDS = Registry(EventKind)
"""Every kind of event by its name; what is not here cannot be recorded"""


def kind_of(name: str) -> EventKind:
    """The kind of a recorded event; of one that is not known nothing is told."""
    return KINDS.get(name, EventKind(_unknown))


def is_kind(name: str) -> bool:
    """Whether there is such a kind of event."""
    return name in KINDS


def tests_of(interval: Interval, second: bool) -> Iterator[Test]:
    """What vanishes within a step at the kinds that are looked for alone, on families or (`second`) on curves.

    Raises `InputError` for a kind that makes anything but `Test`s of known kinds.
    """
    for name, tested in Told("test").items():
        if KINDS[name].second != second:
            continue
        tests = tested(interval)
        tests, where = list(tests) if isinstance(tests, Iterable) else tests, f"EventKind {name!r}, test"
        check(where, "Sequence[Test]", tests)
        for test in tests:
            if test.kind not in KINDS:
                hint = closest(test.kind, KINDS)
                raise InputError(f"{where}: a Test of {test.kind!r}, which is no kind of event{hint}; "
                                 f"write Test({name!r}, ...)")  # fmt: skip
            yield test


def _unknown(_: Any, event: Event) -> Reading:
    raise ConvergenceError(f"a {event.kind} has no check on such a family")


class Told(Mapping[str, Any]):
    """What the kinds say of one thing, by name, of those that say something."""

    def __init__(self, what: str) -> None:
        self.of = attrgetter(what)

    def __getitem__(self, name: str) -> Any:
        if said := self.of(kind_of(name)):
            return said
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return (name for name, kind in KINDS.items() if self.of(kind))

    def __len__(self) -> int:
        return sum(1 for _ in self)


LOOKS, SWITCHABLE, FOLLOWED = Told("look"), Told("branches"), Told("followed")
"""How each kind is drawn; those at which families leave; those that are followed in two parameters, and how"""
