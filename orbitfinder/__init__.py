"""Find periodic orbits of mechanical systems and certify them by independent means.

    import orbitfinder as of

    orbit = of.find_orbit(of.Problem(of.chain(3), guess=of.Guess(state, period), pin=of.pin(energy=-38.35)))
    orbit.period, orbit.floquet_multipliers, of.certify(orbit).passed

Importing this package is cheap: each name below loads what it needs on first use (PEP 562).
"""

from __future__ import annotations

from importlib import import_module
from inspect import isfunction
from typing import TYPE_CHECKING, Any

from orbitfinder._runtime import __version__ as __version__
from orbitfinder._runtime import notebook as _display

_display.drawn_by("orbitfinder.show.html")

if TYPE_CHECKING:
    from orbitfinder import errors as errors
    from orbitfinder import systems as systems
    from orbitfinder._runtime.limit import limited as limited
    from orbitfinder.atlas.api import search as search
    from orbitfinder.atlas.choose import least_unstable as least_unstable
    from orbitfinder.atlas.store import Atlas as Atlas
    from orbitfinder.atlas.store import Filter as Filter
    from orbitfinder.exports.write import export_orbit as export_orbit
    from orbitfinder.guesses.equilibria import linkage_equilibrium as linkage_equilibrium
    from orbitfinder.guesses.modes import linkage_mode as linkage_mode
    from orbitfinder.guesses.modes import linkage_modes as linkage_modes
    from orbitfinder.guesses.modes import normal_mode as normal_mode
    from orbitfinder.guesses.modes import normal_modes as normal_modes
    from orbitfinder.guesses.returns import close_returns as close_returns
    from orbitfinder.guesses.returns import first_return as first_return
    from orbitfinder.guesses.returns import normal_mode_sum as normal_mode_sum
    from orbitfinder.guesses.returns import recurrences as recurrences
    from orbitfinder.integrate.cvodes import IntegratorSettings as IntegratorSettings
    from orbitfinder.integrate.cvodes import build_flow as build_flow
    from orbitfinder.integrate.cvodes import end_state as end_state
    from orbitfinder.integrate.cvodes import sample as sample
    from orbitfinder.integrate.cvodes import transition as transition
    from orbitfinder.integrate.idas import DaeSettings as DaeSettings
    from orbitfinder.integrate.idas import simulate_dae as simulate_dae
    from orbitfinder.loops.conditions import nearest as nearest
    from orbitfinder.loops.conditions import pin as pin
    from orbitfinder.loops.freedom import Constraint as Constraint
    from orbitfinder.loops.freedom import Variables as Variables
    from orbitfinder.loops.problem import Guess as Guess
    from orbitfinder.loops.problem import Problem as Problem
    from orbitfinder.mechanics.chain import chain as chain
    from orbitfinder.mechanics.constrained import constrained as constrained
    from orbitfinder.mechanics.lagrange import Symbols as Symbols
    from orbitfinder.mechanics.lagrange import lagrange as lagrange
    from orbitfinder.mechanics.linkage import assemble as assemble
    from orbitfinder.mechanics.linkage import joint_forces as joint_forces
    from orbitfinder.mechanics.linkage import linkage as linkage
    from orbitfinder.mechanics.linkage import linkage_rates as linkage_rates
    from orbitfinder.mechanics.linkage import linkage_state as linkage_state
    from orbitfinder.mechanics.linkage import minimal_linkage as minimal_linkage
    from orbitfinder.mechanics.maximal import chain_dae as chain_dae
    from orbitfinder.mechanics.maximal import maximal_states as maximal_states
    from orbitfinder.mechanics.maximal import minimal_states as minimal_states
    from orbitfinder.mechanics.model import Baumgarte as Baumgarte
    from orbitfinder.mechanics.model import Invariant as Invariant
    from orbitfinder.mechanics.model import Model as Model
    from orbitfinder.mechanics.model import energies as energies
    from orbitfinder.mechanics.model import energy as energy
    from orbitfinder.mechanics.model import positions as positions
    from orbitfinder.orbits.certify import certify as certify
    from orbitfinder.orbits.find import SolveSettings as SolveSettings
    from orbitfinder.orbits.find import find_orbit as find_orbit
    from orbitfinder.orbits.refine import Refined as Refined
    from orbitfinder.orbits.refine import Refiner as Refiner
    from orbitfinder.problemfile.read import load_problem as load_problem
    from orbitfinder.records.orbit import Certificate as Certificate
    from orbitfinder.records.orbit import Orbit as Orbit
    from orbitfinder.records.orbit import save_orbit as save_orbit
    from orbitfinder.records.store import load_orbit as load_orbit
    from orbitfinder.show.animate import orbit_clip as orbit_clip
    from orbitfinder.show.animate import save_animation as save_animation
    from orbitfinder.show.animate import simulation_clip as simulation_clip
    from orbitfinder.show.plot import save_figures as save_figures

# name -> the module that defines it; "" marks a module exported whole
_HOMES = {
    "errors": "",
    "search": "atlas.api",
    "Atlas": "atlas.store",
    "Filter": "atlas.store",
    "systems": "",
    "IntegratorSettings": "integrate.cvodes",
    "limited": "_runtime.limit",
    "build_flow": "integrate.cvodes",
    "end_state": "integrate.cvodes",
    "sample": "integrate.cvodes",
    "transition": "integrate.cvodes",
    "chain": "mechanics.chain",
    "Symbols": "mechanics.lagrange",
    "lagrange": "mechanics.lagrange",
    "Invariant": "mechanics.model",
    "Model": "mechanics.model",
    "energies": "mechanics.model",
    "energy": "mechanics.model",
    "positions": "mechanics.model",
    "certify": "orbits.certify",
    "nearest": "loops.conditions",
    "pin": "loops.conditions",
    "Certificate": "records.orbit",
    "Orbit": "records.orbit",
    "load_orbit": "records.store",
    "save_orbit": "records.orbit",
    "Guess": "loops.problem",
    "Problem": "loops.problem",
    "SolveSettings": "orbits.find",
    "find_orbit": "orbits.find",
    "export_orbit": "exports.write",
    "DaeSettings": "integrate.idas",
    "simulate_dae": "integrate.idas",
    "assemble": "mechanics.linkage",
    "linkage_rates": "mechanics.linkage",
    "Baumgarte": "mechanics.model",
    "constrained": "mechanics.constrained",
    "joint_forces": "mechanics.linkage",
    "linkage": "mechanics.linkage",
    "linkage_state": "mechanics.linkage",
    "chain_dae": "mechanics.maximal",
    "maximal_states": "mechanics.maximal",
    "minimal_states": "mechanics.maximal",
    "orbit_clip": "show.animate",
    "save_animation": "show.animate",
    "simulation_clip": "show.animate",
    "save_figures": "show.plot",
    "minimal_linkage": "mechanics.linkage",
    "first_return": "guesses.returns",
    "linkage_equilibrium": "guesses.equilibria",
    "linkage_mode": "guesses.modes",
    "linkage_modes": "guesses.modes",
    "Refined": "orbits.refine",
    "Refiner": "orbits.refine",
    "load_problem": "problemfile.read",
    "normal_mode_sum": "guesses.returns",
    "normal_modes": "guesses.modes",
    "normal_mode": "guesses.modes",
    "close_returns": "guesses.returns",
    "recurrences": "guesses.returns",
    "least_unstable": "atlas.choose",
    "Variables": "loops.freedom",
    "Constraint": "loops.freedom",
}

__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'orbitfinder' has no attribute {name!r}")
    home = _HOMES[name]
    module = import_module(f"orbitfinder.{home or name}")
    value = _public(getattr(module, name)) if home else module
    globals()[name] = value
    return value


def _public(value: Any) -> Any:
    """A function with its arguments checked, under this package's name so that it can be pickled; a class as it is."""
    if not isfunction(value):
        return value
    from orbitfinder._runtime.arguments import checked

    front = checked(value)
    front.__module__ = __name__
    return front


def __dir__() -> list[str]:
    """Every public name, loaded or not."""
    return sorted({*globals(), *__all__})
