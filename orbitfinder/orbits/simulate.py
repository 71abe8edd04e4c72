"""Plain simulation of a system: samples by CVODES and what became of the energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.mechanics.model import Model, energies

SAMPLES_PER_SECOND = 100
MOST_SAMPLES = 100_000


@dataclass(frozen=True)
class Simulation:
    """Times (k) in s, states (k x 2n) and total energy (k) in J; `exchanged` is the range of the kinetic energy.

    What becomes of the energy is a drift, an error of the integration, only where it is `conserved`.
    """

    state_names: Sequence[str]
    times: np.ndarray
    states: np.ndarray
    energy: np.ndarray
    exchanged: float
    conserved: bool = True

    @property
    def change(self) -> float:
        """The largest difference from the energy at the start, in J."""
        return float(np.abs(self.energy - self.energy[0]).max())

    def __repr__(self) -> str:
        """One line."""
        kind = "drift" if self.conserved else "change"
        energy = f", energy {kind} {self.change:.2g} J" if np.isfinite(self.energy[0]) else ""
        return f"Simulation({self.times[-1]:g} s, {self.times.size} samples{energy})"

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
            "end": dict(zip(self.state_names, map(float, self.states[-1]), strict=True)),
        }


def simulate(
    model: Model, state: Sequence[float] | np.ndarray, duration: float, samples: int | None = None
) -> Simulation:
    """The motion of a Model from a state (2n) over `duration` s, at `samples` equal times (100 a second if None).

    Raises `InputError` or `IntegrationError`.
    """
    if not (np.isfinite(duration) and duration > 0):
        raise InputError(f"duration: must be positive and finite, got {duration}; give a time in s")
    count = samples or int(min(max(duration * SAMPLES_PER_SECOND, 100), MOST_SAMPLES)) + 1
    states = sample(build_flow(model), np.asarray(state, float), duration, count)
    kinetic, potential = energies(model, states)
    times = np.linspace(0.0, duration, count)
    return Simulation(model.state_names, times, states, kinetic + potential, float(np.ptp(kinetic)), model.conservative)
