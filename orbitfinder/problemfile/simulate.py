"""Plain simulation of a system: samples by CVODES and what became of the energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.mechanics.model import energies
from orbitfinder.problemfile.read import ProblemFile
from orbitfinder.records.reading import write_atomically

SAMPLES_PER_SECOND = 100
MOST_SAMPLES = 100_000


@dataclass(frozen=True)
class Simulation:
    """Times (k) in s, states (k x 2n) and total energy (k) in J; `exchanged` is the range of the kinetic energy.

    What becomes of the energy is a drift, an error of the integration, only where it is `conserved`.
    """

    name: str
    state_names: Sequence[str]
    times: np.ndarray
    states: np.ndarray
    energy: np.ndarray
    exchanged: float
    conserved: bool = True

    def document(self) -> dict[str, Any]:
        """The numbers of the run for `--json`."""
        change = float(np.abs(self.energy - self.energy[0]).max())
        kind = "drift" if self.conserved else "change"
        return {
            "name": self.name,
            "duration": float(self.times[-1]),
            "samples": int(self.times.size),
            "energy": float(self.energy[0]),
            "energy_conserved": self.conserved,
            f"energy_{kind}": change,
            f"relative_energy_{kind}": change / self.exchanged if self.exchanged else 0.0,
            "end": dict(zip(self.state_names, map(float, self.states[-1]), strict=True)),
        }


def simulate_file(loaded: ProblemFile, duration: float | None = None) -> Simulation:
    """Simulate a problem file's system. Raises `InputError` or `IntegrationError`."""
    span = loaded.duration if duration is None else duration
    if not (np.isfinite(span) and span > 0):
        raise InputError(f"--duration: must be positive and finite, got {span}; give a time in s")
    if loaded.start is None:
        raise InputError(f"{loaded.path}: simulate.state: missing; give it, or a [guess] to start from")
    count = int(min(max(span * SAMPLES_PER_SECOND, 100), MOST_SAMPLES)) + 1
    states = sample(build_flow(loaded.model), loaded.start, span, count)
    kinetic, potential = energies(loaded.model, states)
    return Simulation(
        loaded.name, loaded.model.state_names, np.linspace(0.0, span, count), states,
        kinetic + potential, float(np.ptp(kinetic)), loaded.model.conservative,
    )  # fmt: skip


def write_csv(result: Simulation, path: Path) -> Path:
    """Columns t and the states, with a header, in full digits."""
    lines = [",".join(["t", *result.state_names])]
    table = np.column_stack([result.times, result.states])
    lines += [",".join(map(repr, row)) for row in table.tolist()]
    write_atomically(path, ("\n".join(lines) + "\n").encode())
    return path
