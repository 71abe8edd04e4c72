"""The methods of this room, for the table of methods."""

from orbitfinder.orbits import collocate
from orbitfinder.orbits.method import COLLOCATION, METHODS, SHOOTING, Method
from orbitfinder.orbits.shoot import found, found_hybrid

METHODS[SHOOTING] = Method(lambda problem: problem.control is None and problem.model.smooth, found)
METHODS["impacts"] = Method(lambda problem: problem.control is None and not problem.model.smooth, found_hybrid)
METHODS[COLLOCATION] = Method(collocate.stiff, collocate.found, collocate.refused, collocate.settles)
