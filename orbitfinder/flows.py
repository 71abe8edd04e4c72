"""Integrating a system by hand: its flow, where it ends, samples along it, its state-transition matrix."""

from orbitfinder._runtime.front import fronted_all
from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow, end_state, sample, transition

__all__ = ["IntegratorSettings", "build_flow", "end_state", "sample", "transition"]
fronted_all(globals())
