"""The methods of this room, for the table of methods."""

from orbitfinder.integrate.collocation import Collocation
from orbitfinder.orbits.collocate import by, settles, stiff
from orbitfinder.orbits.method import METHODS, SHOOTING, Method
from orbitfinder.orbits.shoot import found, found_hybrid

METHODS[SHOOTING] = Method(lambda problem: problem.control is None and problem.model.smooth, found)
METHODS["impacts"] = Method(lambda problem: problem.control is None and not problem.model.smooth, found_hybrid)
METHODS[Collocation.name] = by(Collocation, stiff, settles)
