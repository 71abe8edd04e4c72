"""What finds the orbit that a Problem singles out: a table of methods, each of which knows which problems suit it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from orbitfinder._runtime.rooms import filled
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


METHODS: dict[str, Method] = {}
"""Every method by its name; others may join (`method_of` asks them all)"""
SHOOTING = "shooting"
"""The method for what suits no other"""


def method_of(problem: Problem) -> Method:
    """The method for a Problem: the latest entry that it suits, shooting where none does."""
    filled("methods")
    special = (method for name, method in reversed(METHODS.items()) if name != SHOOTING and method.suits(problem))
    return next(special, METHODS[SHOOTING])
