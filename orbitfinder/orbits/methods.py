"""The methods of this room, for the table of methods."""

from orbitfinder.orbits.method import METHODS, SHOOTING, Method
from orbitfinder.orbits.shoot import found, found_hybrid

METHODS[SHOOTING] = Method(lambda problem: problem.control is None and problem.model.hybrid is None, found)
METHODS["impacts"] = Method(lambda problem: problem.control is None and problem.model.hybrid is not None, found_hybrid)
