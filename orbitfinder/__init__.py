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

from orbitfinder import display as _display
from orbitfinder.version import __version__ as __version__

_display.drawn_by("orbitfinder.show.html")

if TYPE_CHECKING:
    from orbitfinder import errors as errors
    from orbitfinder import systems as systems
    from orbitfinder.atlas.api import search as search
    from orbitfinder.atlas.store import Atlas as Atlas
    from orbitfinder.atlas.store import Filter as Filter
    from orbitfinder.choosing import least_unstable as least_unstable
    from orbitfinder.dae_flow import DaeSettings as DaeSettings
    from orbitfinder.dae_flow import simulate_dae as simulate_dae
    from orbitfinder.exports.write import export_orbit as export_orbit
    from orbitfinder.flow import IntegratorSettings as IntegratorSettings
    from orbitfinder.flow import build_flow as build_flow
    from orbitfinder.flow import end_state as end_state
    from orbitfinder.flow import sample as sample
    from orbitfinder.flow import transition as transition
    from orbitfinder.limit import limited as limited
    from orbitfinder.mechanics.assembly import assemble as assemble
    from orbitfinder.mechanics.assembly import linkage_rates as linkage_rates
    from orbitfinder.mechanics.chain import chain as chain
    from orbitfinder.mechanics.constrained import Baumgarte as Baumgarte
    from orbitfinder.mechanics.constrained import ConstrainedModel as ConstrainedModel
    from orbitfinder.mechanics.constrained import constrained as constrained
    from orbitfinder.mechanics.lagrange import Symbols as Symbols
    from orbitfinder.mechanics.lagrange import lagrange as lagrange
    from orbitfinder.mechanics.linkage import joint_forces as joint_forces
    from orbitfinder.mechanics.linkage import linkage as linkage
    from orbitfinder.mechanics.linkage import linkage_state as linkage_state
    from orbitfinder.mechanics.maximal import chain_dae as chain_dae
    from orbitfinder.mechanics.maximal import maximal_states as maximal_states
    from orbitfinder.mechanics.maximal import minimal_states as minimal_states
    from orbitfinder.mechanics.model import Invariant as Invariant
    from orbitfinder.mechanics.model import Model as Model
    from orbitfinder.mechanics.model import energies as energies
    from orbitfinder.mechanics.model import energy as energy
    from orbitfinder.mechanics.model import positions as positions
    from orbitfinder.mechanics.partition import minimal_linkage as minimal_linkage
    from orbitfinder.periodic.certify import certify as certify
    from orbitfinder.periodic.conditions import nearest as nearest
    from orbitfinder.periodic.conditions import pin as pin
    from orbitfinder.periodic.dae_orbit import certify_dae as certify_dae
    from orbitfinder.periodic.dae_orbit import dae_problem as dae_problem
    from orbitfinder.periodic.dae_orbit import find_dae_orbit as find_dae_orbit
    from orbitfinder.periodic.freedom import Constraint as Constraint
    from orbitfinder.periodic.freedom import Variables as Variables
    from orbitfinder.periodic.guesses import normal_mode as normal_mode
    from orbitfinder.periodic.guesses import normal_modes as normal_modes
    from orbitfinder.periodic.linkage_guesses import first_return as first_return
    from orbitfinder.periodic.linkage_guesses import linkage_equilibrium as linkage_equilibrium
    from orbitfinder.periodic.linkage_guesses import linkage_mode as linkage_mode
    from orbitfinder.periodic.linkage_guesses import linkage_modes as linkage_modes
    from orbitfinder.periodic.orbit import Certificate as Certificate
    from orbitfinder.periodic.orbit import Orbit as Orbit
    from orbitfinder.periodic.orbit import load_orbit as load_orbit
    from orbitfinder.periodic.orbit import save_orbit as save_orbit
    from orbitfinder.periodic.problem import Guess as Guess
    from orbitfinder.periodic.problem import Problem as Problem
    from orbitfinder.periodic.recurrence import close_returns as close_returns
    from orbitfinder.periodic.recurrence import normal_mode_sum as normal_mode_sum
    from orbitfinder.periodic.recurrence import recurrences as recurrences
    from orbitfinder.periodic.solve import SolveSettings as SolveSettings
    from orbitfinder.periodic.solve import find_orbit as find_orbit
    from orbitfinder.periodic.warm import Refined as Refined
    from orbitfinder.periodic.warm import Refiner as Refiner
    from orbitfinder.problemfile import load_problem as load_problem
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
    "IntegratorSettings": "flow",
    "limited": "limit",
    "build_flow": "flow",
    "end_state": "flow",
    "sample": "flow",
    "transition": "flow",
    "chain": "mechanics.chain",
    "Symbols": "mechanics.lagrange",
    "lagrange": "mechanics.lagrange",
    "Invariant": "mechanics.model",
    "Model": "mechanics.model",
    "energies": "mechanics.model",
    "energy": "mechanics.model",
    "positions": "mechanics.model",
    "certify": "periodic.certify",
    "nearest": "periodic.conditions",
    "pin": "periodic.conditions",
    "Certificate": "periodic.orbit",
    "Orbit": "periodic.orbit",
    "load_orbit": "periodic.orbit",
    "save_orbit": "periodic.orbit",
    "Guess": "periodic.problem",
    "Problem": "periodic.problem",
    "SolveSettings": "periodic.solve",
    "find_orbit": "periodic.solve",
    "export_orbit": "exports.write",
    "DaeSettings": "dae_flow",
    "simulate_dae": "dae_flow",
    "assemble": "mechanics.assembly",
    "linkage_rates": "mechanics.assembly",
    "Baumgarte": "mechanics.constrained",
    "ConstrainedModel": "mechanics.constrained",
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
    "minimal_linkage": "mechanics.partition",
    "certify_dae": "periodic.dae_orbit",
    "dae_problem": "periodic.dae_orbit",
    "find_dae_orbit": "periodic.dae_orbit",
    "first_return": "periodic.linkage_guesses",
    "linkage_equilibrium": "periodic.linkage_guesses",
    "linkage_mode": "periodic.linkage_guesses",
    "linkage_modes": "periodic.linkage_guesses",
    "Refined": "periodic.warm",
    "Refiner": "periodic.warm",
    "load_problem": "problemfile",
    "normal_mode_sum": "periodic.recurrence",
    "normal_modes": "periodic.guesses",
    "normal_mode": "periodic.guesses",
    "close_returns": "periodic.recurrence",
    "recurrences": "periodic.recurrence",
    "least_unstable": "choosing",
    "Variables": "periodic.freedom",
    "Constraint": "periodic.freedom",
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
    from orbitfinder.arguments import checked

    front = checked(value)
    front.__module__ = __name__
    return front


def __dir__() -> list[str]:
    """Every public name, loaded or not."""
    return sorted({*globals(), *__all__})
