"""Where a search may start: linear modes and responses, close returns. The names are in `__init__.pyi`."""

from orbitfinder._runtime.front import door as _door

__getattr__, __dir__, __all__ = _door(__name__, __file__, public="orbitfinder.guesses")
