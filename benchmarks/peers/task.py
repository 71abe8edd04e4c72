"""The task that all of them get: a chain, the report's printed digits, the energy of the printed state."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import orbitfinder as of

ROOT = Path(__file__).parents[2]
NAMES = ("triple-1", "triple-2", "quadruple-1", "quadruple-2")


@dataclass(frozen=True)
class Task:
    """One orbit to refine: the printed state (2n) and the period guessed from it."""

    name: str
    state: np.ndarray
    period: float

    @property
    def links(self) -> int:
        """Number of links."""
        return self.state.size // 2

    @property
    def energy(self) -> float:
        """Energy of the printed state in J."""
        return of.energy(of.chain(self.links), self.state)

    @property
    def problem(self) -> of.Problem:
        """The same for orbitfinder."""
        return of.Problem(of.chain(self.links), of.Guess(self.state, self.period), of.pin(energy=self.energy))


@dataclass(frozen=True)
class Answer:
    """What a method returned, and how long it took by its own or our clock; processor time where we know it."""

    seconds: float
    state: np.ndarray
    period: float
    processor: float = np.nan


class Unavailable(Exception):
    """The peer is not installed, or did not finish; the message says which."""


def tasks() -> list[Task]:
    """The four report orbits, as they stand in the problem files."""
    found = []
    for name in NAMES:
        table = tomllib.loads((ROOT / "problems" / "report" / f"{name}.toml").read_text())["guess"]
        found.append(Task(name, np.asarray(table["state"], float), float(table["period"])))
    return found


def closure(task: Task, answer: Answer) -> float:
    """The certificate's closure: Hamilton's equations by DOP853 at its tightest."""
    from orbitfinder.orbits.evidence import gather

    return gather(of.chain(task.links), answer.state, answer.period, np.zeros(task.links, int)).closure
