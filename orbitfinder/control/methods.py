"""The method for controlled motions, for the table of methods."""

from orbitfinder.control.find import find_controlled
from orbitfinder.orbits.method import METHODS, Method

METHODS["optimal control"] = Method(lambda problem: problem.control is not None, find_controlled)
