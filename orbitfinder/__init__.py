"""Find periodic orbits of mechanical systems and certify them by independent means.

    import orbitfinder as of

    orbit = of.find_orbit(of.Problem(of.chain(3), guess=of.Guess(state, period), pin=of.pin(energy=-38.35)))
    orbit.period, orbit.floquet_multipliers, of.certify(orbit).passed

The names are in `__init__.pyi`. Importing this package is cheap: each loads what it needs on first use (SPEC 1).
"""

from sys import modules as _modules

from orbitfinder._runtime import __version__ as __version__
from orbitfinder._runtime import notebook as _notebook
from orbitfinder._runtime.front import door as _door
from orbitfinder.orbits import guesses as _guesses

_ROOMS = {
    "guesses": ("normal_mode", "normal_modes", "normal_mode_sum", "recurrences", "close_returns"),
    "linkages": (
        "assemble", "linkage_rates", "linkage_state", "joint_forces", "maximal_states", "minimal_states",
        "minimal_linkage", "linkage_equilibrium", "linkage_mode", "linkage_modes", "first_return", "simulate_dae",
        "DaeSettings",
    ),
    "flows": ("build_flow", "end_state", "sample", "transition", "IntegratorSettings"),
}  # fmt: skip
_MOVED = {name: f"orbitfinder.{name} is now orbitfinder.{room}.{name}" for room in _ROOMS for name in _ROOMS[room]}
_MOVED |= {
    "nearest": "orbitfinder.nearest has gone: without a pin the orbit nearest to the guess is found",
    "ConstrainedModel": "orbitfinder.ConstrainedModel has gone: it is a Model with a constraint",
    "find_dae_orbit": "orbitfinder.find_dae_orbit has gone: find_orbit takes Models with a constraint too",
    "dae_problem": "orbitfinder.dae_problem has gone: Problem takes Models with a constraint too",
    "Refined": "orbitfinder.Refined has gone: it is what Refiner.refine returns",
    "certify_dae": "orbitfinder.certify_dae has gone: certify takes orbits of Models with a constraint too",
}
"""Names of 0.1 that are elsewhere now; for one version"""

_modules[f"{__name__}.guesses"] = _guesses
_notebook.drawn_by("orbitfinder.show.html", "orbitfinder.studio.widget")
__getattr__, __dir__, __all__ = _door(__name__, __file__, _MOVED)
