"""What is special to closed linkages: assembly, states, modes, joint forces, the native DAE's simulation."""

from orbitfinder._runtime.front import fronted_all
from orbitfinder.integrate.idas import DaeSettings, simulate_dae
from orbitfinder.mechanics.constrained import maximal_states, minimal_states
from orbitfinder.mechanisms.closing import mechanism_state, minimal_mechanism
from orbitfinder.mechanisms.linkage import assemble, joint_forces, linkage_rates, linkage_state, minimal_linkage
from orbitfinder.mechanisms.mechanism import body_point
from orbitfinder.orbits.guesses.modes import linkage_equilibrium, linkage_mode, linkage_modes
from orbitfinder.orbits.guesses.returns import first_return

__all__ = [
    "DaeSettings", "assemble", "body_point", "first_return", "joint_forces", "linkage_equilibrium", "linkage_mode",
    "linkage_modes", "linkage_rates", "linkage_state", "maximal_states", "mechanism_state", "minimal_linkage",
    "minimal_mechanism", "minimal_states", "simulate_dae",
]  # fmt: skip
fronted_all(globals())
