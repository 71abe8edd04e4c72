"""What finds the orbit that a Problem singles out: a table of methods, each of which knows which problems suit it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from orbitfinder._runtime.arguments import Registry, shown
from orbitfinder._runtime.rooms import filled
from orbitfinder.errors import UNSOLVED, InputError, closest
from orbitfinder.integrate.march import March
from orbitfinder.loops.ipopt import Callback, SolveSettings
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.model import Model
from orbitfinder.records.certificate import Check
from orbitfinder.records.family import Family
from orbitfinder.records.orbit import Orbit


@dataclass(frozen=True)
class Method:
    """A method of finding orbits."""

    suits: Callable[[Problem], str | bool]
    """(problem) -> whether it is for this one, or why"""
    find: Callable[[Problem, SolveSettings, Callback | None, float], tuple[Orbit, Model]]
    """(problem, settings, what is told of progress, when the search began) -> the orbit without its certificate and its
    Model; raises `ConvergenceError`, `IntegrationError` and `InputError` with a sentence to act on"""
    refuses: Callable[[Problem], str] | None = None
    """(problem) -> why it cannot be asked for, or nothing; without it, where it suits alone"""
    rescues: Callable[[Problem], bool] = lambda problem: False
    """(problem) -> whether it is tried where another method has failed"""
    march: type[March] = March
    """What integrates the families of its orbits; one of its own has the method's `name`"""
    begin: Callable[[Problem, tuple[str, ...]], tuple[Equations, Unknowns]] | None = None
    """(problem, freed parameters) -> the equations of a family by its march and the orbit in their unknowns"""
    follow: Callable[..., Family] | None = None
    """what follows a family that no march does (`families.balance.followed`)"""
    verify: Callable[[Family, Model], Iterable[tuple[str, Check]]] | None = None
    """(family, model) -> the checks of its events and ends, where it has no equations of shooting"""
    remedy: str = ""
    """what to try where a certificate rejects its orbit"""


METHODS = Registry(Method)
"""Every method by its name; others may join (`method_of` asks them all)"""
SHOOTING = March.name
"""The method for what suits no other"""


def named(name: str) -> Method:
    """The method of a name. Raises `InputError` for an unknown one."""
    filled("methods")
    if name not in METHODS:
        known = [each for each, method in METHODS.items() if each == SHOOTING or begins(each)]
        raise InputError(f"method: unknown {name!r}{closest(name, METHODS)}; use {' or '.join(known)}")
    return METHODS[name]


def begins(name: str) -> bool:
    """Whether families begin by a method of this name, with a march of its own or none."""
    filled("methods")
    return name in METHODS and bool(METHODS[name].begin or METHODS[name].follow)


def rescuer(problem: Problem, failed: str = SHOOTING) -> str | None:
    """The name of the method that is tried where another has failed, if any is."""
    filled("methods")
    return next((key for key, each in METHODS.items() if key != failed and each.rescues(problem)), None)


def follower(problem: Problem) -> str | None:
    """The name of the method that suits a problem and follows families by itself, if any."""
    filled("methods")
    return next((key for key, each in METHODS.items() if each.follow and each.suits(problem)), None)


def method_of(problem: Problem, asked: str | None = None) -> tuple[str, Method, str]:
    """The method for a Problem, its name, and why: the one `asked` for, else the latest entry that it suits, shooting
    where none does. Raises `InputError` for one that is unknown or not for this problem."""
    if asked is None:
        filled("methods")
        for name, method in reversed(METHODS.items()):
            if name != SHOOTING and (why := method.suits(problem)):
                return name, method, why if isinstance(why, str) else ""
        return SHOOTING, METHODS[SHOOTING], ""
    method = named(asked)
    refused = method.refuses(problem) if method.refuses else "" if method.suits(problem) else "it is not of its kind"
    if refused:
        raise InputError(f"method: {asked} is not for this problem, {refused}; leave method out")
    return asked, method, "asked for"


def solved(problem: Problem, settings: SolveSettings, progress: Callback | None, began: float) -> tuple[Orbit, Model]:
    """What the method for a Problem finds. Raises `InputError` for a method that gives anything but it should."""
    asked = settings.method or problem.method
    name, method, why = method_of(problem, asked)
    try:
        given = method.find(problem, settings, progress, began)
    except UNSOLVED as error:
        other = rescuer(problem, name)
        if asked is not None or other is None:
            raise
        try:
            given = METHODS[other].find(problem, settings, progress, began)
        except UNSOLVED:
            raise error from None
        name, method, why = other, METHODS[other], f"{name} failed: {error}"
    kinds = [type(part) for part in given] if isinstance(given, tuple) else []
    if kinds != [Orbit, Model]:
        raise InputError(f"Method {name!r}, find: expected (Orbit, Model), got {shown(given)}; return both, the Model "
                         "without them being `problem.model`")  # fmt: skip
    orbit, size = given[0], len(given[1].state_names)
    if np.shape(orbit.state) != (size,) or np.shape(orbit.nodes)[1:] != (size,):
        raise InputError(f"Method {name!r}, find: expected a state ({size}) and nodes (N x {size}), got shapes "
                         f"{np.shape(orbit.state)} and {np.shape(orbit.nodes)}; `measure` makes them")  # fmt: skip
    told = {"method": name, "method_reason": why} if why else {}
    return replace(orbit, provenance={**orbit.provenance, **told}), given[1]
