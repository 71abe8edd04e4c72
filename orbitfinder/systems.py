"""Built-in systems: each function returns a Model, and problem files name them with kind = "python"."""

from orbitfinder.mechanisms import driven, library, machines
from orbitfinder.mechanisms.driven import *  # noqa: F403  what their `__all__` lists
from orbitfinder.mechanisms.library import *  # noqa: F403
from orbitfinder.mechanisms.machines import *  # noqa: F403

FUNCTIONS = library.FUNCTIONS | machines.MACHINES | driven.DRIVEN

__all__ = ["FUNCTIONS"]
__all__ += library.__all__
__all__ += machines.__all__
__all__ += driven.__all__
