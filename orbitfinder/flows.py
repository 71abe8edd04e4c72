"""Integrating a system by hand: its flow, where it ends, samples along it, its state-transition matrix."""

from orbitfinder._runtime.front import fronted
from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow, end_state, sample, transition

__all__ = ["IntegratorSettings", "build_flow", "end_state", "sample", "transition"]
globals().update({name: fronted(globals()[name], __name__) for name in __all__})
