"""Plain simulation of a system: samples by CVODES and what became of the energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown
from orbitfinder.errors import InputError, IntegrationError, plural
from orbitfinder.integrate.automaton import MOST_EVENTS, Automaton
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.integrate.dop853 import integrate
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model, energies

SAMPLES_PER_SECOND = 100
MOST_SAMPLES = 100_000
FAR_MORE = 10.0
"""Times the events that are allowed, which a simulation that has only begun must promise to be given up"""
LONGEST = 1e100
"""s; beyond it the squares of what is integrated overflow"""
LEAST_STEPS = 64
"""Steps of a simulation of a hybrid system, at least"""


@dataclass(frozen=True)
class Simulation(Shown):
    """Times (k) in s, states (k x 2n) and total energy (k) in J; `exchanged` is the range of the kinetic energy.

    What becomes of the energy is a drift, an error of the integration, only where it is `conserved`.
    """

    state_names: Sequence[str]
    times: np.ndarray
    states: np.ndarray
    energy: np.ndarray
    exchanged: float
    conserved: bool = True
    events: tuple[tuple[float, str], ...] = ()
    """of a hybrid system: when (s) and which"""

    @property
    def change(self) -> float:
        """The largest difference from the energy at the start, in J."""
        return float(np.abs(self.energy - self.energy[0]).max())

    def __repr__(self) -> str:
        """One line."""
        kind = "drift" if self.conserved else "change"
        energy = f", energy {kind} {self.change:.2g} J" if np.isfinite(self.energy[0]) else ""
        events = f", {plural(len(self.events), 'event')}" if self.events else ""
        return f"Simulation({self.times[-1]:g} s, {self.times.size} samples{events}{energy})"

    def document(self) -> dict[str, Any]:
        """The numbers of the run for `--json`."""
        kind, known = "drift" if self.conserved else "change", bool(np.isfinite(self.energy[0]))
        return {
            "duration": float(self.times[-1]),
            "samples": int(self.times.size),
            "energy": float(self.energy[0]) if known else None,
            "energy_conserved": self.conserved,
            f"energy_{kind}": self.change if known else None,
            f"relative_energy_{kind}": (self.change / self.exchanged if self.exchanged else 0.0) if known else None,
            **({"events": [{"time": t, "name": name} for t, name in self.events]} if self.events else {}),
            "end": dict(zip(self.state_names, map(float, self.states[-1]), strict=True)),
        }


def simulate(
    model: Model, state: Sequence[float] | np.ndarray, duration: float, samples: int | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Simulation:  # fmt: skip
    """The motion of a Model from a state.

    A hybrid system begins in the first mode of its cycle and goes through its events; a sample at an event is after
    it.

    Args:
        model: the system.
        state: where it begins (2n).
        duration: s.
        samples: how many equal times, both ends included; 100 a second if None.
        parameters: values of physical parameters by name, the model's own where left out.

    Returns:
        `times` (k, s), `states` (k x 2n) and what the energy drifts by.

    Raises:
        InputError: for a state or a duration that cannot be.
        IntegrationError: where the motion cannot be continued, also where events accumulate (Zeno) or coincide.

    Examples:
        >>> motion = of.simulate(pendulum, [0.3, 0.3, 0.0, 0.0], 2.0, samples=5)
        >>> motion.times
        array([0. , 0.5, 1. , 1.5, 2. ])

    See Also:
        `of.guesses.close_returns` looks for near orbits in a motion; `of.flows` has the integrators.
    """
    if not 0 < duration < LONGEST:
        raise InputError(f"duration: must be positive and below {LONGEST:g} s, got {duration}; give a time in s")
    model = with_parameters(model, parameters or {})
    count = samples or int(min(max(duration * SAMPLES_PER_SECOND, 100), MOST_SAMPLES)) + 1
    if not model.smooth:
        return _simulated(model, checked_state(model, state), np.linspace(0.0, duration, count))
    states = sample(build_flow(model), np.asarray(state, float), duration, count)
    kinetic, potential = energies(model, states)
    times = np.linspace(0.0, duration, count)
    return Simulation(model.state_names, times, states, kinetic + potential, float(np.ptp(kinetic)), model.conservative)


def checked_state(model: Model, state: Sequence[float] | np.ndarray) -> np.ndarray:
    """The state as an array (d). Raises `InputError`."""
    found, names = np.asarray(state, float), model.state_names
    if found.shape != (len(names),) or not np.all(np.isfinite(found)):
        raise InputError(f"state: need {len(names)} finite numbers ({', '.join(names)}), got {found.tolist()}")
    return found


def _simulated(model: Model, state: np.ndarray, times: np.ndarray) -> Simulation:
    """The motion of a hybrid Model at equal times, arc by arc."""
    automaton = Automaton(model, longest=float(times[-1]) / LEAST_STEPS)
    rows, parts, events = [], [], []
    for arc in automaton.arcs(state, automaton.hybrid.first.name, float(times[-1])):
        own = times[(times >= arc.times[0]) & ((times < arc.times[-1]) | (arc.ended_by is None))]
        moments = np.concatenate([[arc.times[0]], own])
        rows.append(integrate(automaton.field(arc.mode), arc.states[0], moments - arc.times[0])[1:])
        if own.size:
            parts.append(np.array(energies(automaton.hybrid.mode(arc.mode).model, rows[-1])))
        if arc.ended_by is not None:
            events.append((float(arc.times[-1]), arc.ended_by))
            count, last, duration = len(events), events[-1][0], float(times[-1])  # or what it will be at this pace
            if count >= MOST_EVENTS or (count >= LEAST_STEPS and count * duration > FAR_MORE * MOST_EVENTS * last):
                raise IntegrationError(
                    f"more than {MOST_EVENTS} events in {duration:.4g} s, {count} of them in the first {last:.4g} s; "
                    "give a shorter duration", time=last,
                )  # fmt: skip
    kinetic, potential = np.hstack(parts)
    return Simulation(
        model.state_names, times, np.vstack(rows), kinetic + potential, float(np.ptp(kinetic)), model.conservative,
        tuple(events),
    )  # fmt: skip
