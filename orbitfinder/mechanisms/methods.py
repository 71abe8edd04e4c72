"""The method for long chains, for the table of methods."""

from orbitfinder.mechanisms.long_chain import find_long_chain, suits
from orbitfinder.orbits.method import METHODS, Method

METHODS["long chain"] = Method(suits, find_long_chain)
