"""What finds the orbit that a Problem singles out: a table of methods, each of which knows which problems suit it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orbitfinder._runtime.arguments import Registry, shown
from orbitfinder._runtime.rooms import filled
from orbitfinder.errors import InputError
from orbitfinder.loops.ipopt import Callback, SolveSettings
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.model import Model
from orbitfinder.records.orbit import Orbit


@dataclass(frozen=True)
class Method:
    """A method of finding orbits."""

    suits: Callable[[Problem], bool]
    """(problem) -> whether it is for this one"""
    find: Callable[[Problem, SolveSettings, Callback | None, float], tuple[Orbit, Model]]
    """(problem, settings, what is told of progress, when the search began) -> the orbit without its certificate and its
    Model; raises `ConvergenceError`, `IntegrationError` and `InputError` with a sentence to act on"""


METHODS = Registry(Method)
"""Every method by its name; others may join (`method_of` asks them all)"""
SHOOTING = "shooting"
"""The method for what suits no other"""
COLLOCATION = "collocation"
"""The method for what is stiff"""


def method_of(problem: Problem) -> Method:
    """The method for a Problem: the latest entry that it suits, shooting where none does."""
    filled("methods")
    special = (method for name, method in reversed(METHODS.items()) if name != SHOOTING and method.suits(problem))
    return next(special, METHODS[SHOOTING])


def solved(problem: Problem, settings: SolveSettings, progress: Callback | None, began: float) -> tuple[Orbit, Model]:
    """What the method for a Problem finds. Raises `InputError` for a method that gives anything but it should."""
    method = method_of(problem)
    given = method.find(problem, settings, progress, began)
    kinds = [type(part) for part in given] if isinstance(given, tuple) else []
    name = next(name for name, each in METHODS.items() if each is method)
    if kinds != [Orbit, Model]:
        raise InputError(f"Method {name!r}, find: expected (Orbit, Model), got {shown(given)}; return both, the Model "
                         "without them being `problem.model`")  # fmt: skip
    orbit, size = given[0], len(given[1].state_names)
    if np.shape(orbit.state) != (size,) or np.shape(orbit.nodes)[1:] != (size,):
        raise InputError(f"Method {name!r}, find: expected a state ({size}) and nodes (N x {size}), got shapes "
                         f"{np.shape(orbit.state)} and {np.shape(orbit.nodes)}; `measure` makes them")  # fmt: skip
    return orbit, given[1]
