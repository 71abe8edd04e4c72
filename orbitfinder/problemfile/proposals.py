"""The guesses that a problem file's system offers: normal modes, close returns of its motion, its own guess."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from orbitfinder.errors import FAILURES, InputError
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.kind import loops_of
from orbitfinder.mechanics.model import energy, wrapped
from orbitfinder.orbits.guesses.modes import linkage_equilibrium, normal_mode, normal_modes
from orbitfinder.orbits.guesses.returns import close_returns, recurrences
from orbitfinder.problemfile.read import ProblemFile
from orbitfinder.records.reading import Entries, Table


@dataclass(frozen=True)
class Proposal:
    """A starting point: `name` (own, mode-2, return-1), period (s), energy (J, None where none is conserved).

    `miss` is the largest gap after a period relative to the motion's extent (None: not simulated),
    `details` what is special to the kind, `table` the `[guess]` that makes it.
    """

    name: str
    period: float
    energy: float | None
    miss: float | None
    state: tuple[float, ...]
    table: Table
    details: Table = field(default_factory=dict)

    def document(self) -> Entries:
        """The entry of `--json`."""
        return {
            "name": self.name, "period": self.period, "energy": self.energy, "miss": self.miss,
            "state": list(self.state), **self.details, "guess": dict(self.table),
        }  # fmt: skip


@dataclass(frozen=True)
class Proposals:
    """All starting points of a file and, for each kind that there is none of, the reason."""

    name: str
    state_names: Sequence[str]
    guesses: Sequence[Proposal]
    notes: Sequence[str]
    system: Table

    def named(self, pick: str | None) -> Proposal:
        """The proposal of that name; the closest return, else the slowest mode, where none is given."""
        if not self.guesses:
            raise InputError("guess: nothing to propose; " + "; ".join(self.notes))
        order = {"return": 0, "mode": 1, "own": 2}
        if pick is None:
            return min(self.guesses, key=lambda proposal: order[proposal.name.split("-")[0]])
        known = {proposal.name: proposal for proposal in self.guesses}
        if pick in known:
            return known[pick]
        raise InputError(f"pick: there is no {pick!r}; use one of {', '.join(known)}")


def propose(loaded: ProblemFile, duration: float | None = None, count: int = 8, amplitude: float = 0.1) -> Proposals:
    """Every kind of starting point that a problem file allows: close returns in `duration` (s, or 12 periods of the
    guess), modes with an `amplitude` of their largest coordinate (rad or m). Raises `InputError` for wrong options."""
    guesses = []
    notes = []
    kinds: dict[str, Callable[[], list[Proposal]]] = {
        "own guess": lambda: own(loaded),
        "normal modes": lambda: modes(loaded, amplitude),
        "close returns": lambda: returns(loaded, duration, count),
    }
    for kind, make in kinds.items():
        try:
            guesses += make()
        except FAILURES as error:
            notes.append(f"{kind}: {error}")
    return Proposals(loaded.name, loaded.model.state_names, tuple(guesses), tuple(notes), loaded.model.system)


def own(loaded: ProblemFile) -> list[Proposal]:
    """What the file's `[guess]` stands for, and how far from closed it is."""
    if loaded.problem is None:
        raise InputError("the file has none")
    guess = loaded.problem.guess
    times, states = motion(loaded, guess)
    table = loaded.document.get("guess", {})
    details: Entries = {"source": next(iter(table), "python")}
    if _recorded(loaded, guess):
        details |= {"samples": int(times.size)}
    return [_proposal(loaded, "own", guess, missed(loaded, states), table, details)]


def modes(loaded: ProblemFile, amplitude: float) -> list[Proposal]:
    """The linear normal modes of the equilibrium at 0, or of a linkage's lowest, slowest first."""
    model = loaded.model
    if model.degrees_of_freedom > 60:
        raise InputError(f"{model.degrees_of_freedom} coordinates; give mode and amplitude in [guess]")
    if model.constraint is not None and loops_of(model.system).minimal is None:
        raise InputError("redundant coordinates; give a state and a period")
    place = None if model.constraint is None else linkage_equilibrium(model)
    (squared, shapes), proposals = normal_modes(model, place), []
    for k, (rate, shape) in enumerate(zip(squared, shapes.T, strict=True), start=1):
        if rate > 0:
            made = normal_mode(model, k, amplitude, place)
            given = {"mode": k, "amplitude": amplitude}
            largest = shape[np.abs(shape).argmax()]
            details = {"frequency": float(np.sqrt(rate) / (2 * np.pi)), "shape": (shape / largest).tolist()}
            proposals.append(_proposal(loaded, f"mode-{k}", made, None, given, details))
    if not proposals:
        raise InputError("the equilibrium at 0 is not a stable one; give a state and a period")
    return proposals


def returns(loaded: ProblemFile, duration: float | None, count: int) -> list[Proposal]:
    """Close returns of the file's recorded trajectory, or of the motion from its state, best first."""
    guess = None if loaded.problem is None else loaded.problem.guess
    if guess is not None and _recorded(loaded, guess) and duration is None:
        assert guess.times is not None and guess.states is not None
        span = float(guess.times[-1])
        passes = close_returns(guess.times, guess.states, loaded.model.angles, count)
        source = "trajectory"
    else:
        if loaded.start is None:
            raise InputError("nothing to simulate from; give simulate.state or a [guess]")
        asked = duration if duration is not None else loaded.document.get("simulate", {}).get("duration")
        span = float(asked) if asked else (12.0 * guess.period if guess is not None else loaded.duration)
        passes = recurrences(loaded.model, loaded.start, span, count)
        source = "simulation"
    if not passes:
        raise InputError(f"the motion never came back near itself in {span:g} s; simulate longer (duration)")
    return [
        _proposal(
            loaded, f"return-{k}", near.guess, near.distance,
            {"state": [float(x) for x in near.state], "period": float(near.period)},
            {"time": near.time, "span": span, "source": source},
        )
        for k, near in enumerate(passes, start=1)
    ]  # fmt: skip


def _recorded(loaded: ProblemFile, guess: Guess) -> bool:
    """True when the guess is somebody's trajectory, not simulated for it."""
    table = loaded.document.get("guess", {})
    return guess.times is not None and ("csv" in table or not table)


def motion(loaded: ProblemFile, guess: Guess) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of a guess over its period: as recorded, else simulated."""
    if guess.trajectory is not None:
        return guess.trajectory
    states = sample(build_flow(loaded.model), guess.start, guess.period, 401)
    return np.linspace(0.0, guess.period, 401), states


def missed(loaded: ProblemFile, states: np.ndarray) -> float:
    """The largest gap between end and start, each component relative to its extent, angles modulo 2 pi."""
    gaps = wrapped(states[-1] - states[0], loaded.model.angles)
    return float(np.abs(gaps / np.maximum(np.ptp(states, axis=0), 1e-12)).max())


def _proposal(
    loaded: ProblemFile, name: str, guess: Guess, miss: float | None, table: Table,
    details: Table,
) -> Proposal:  # fmt: skip
    state = guess.start
    level = energy(loaded.model, state) if loaded.model.conservative else None
    return Proposal(name, float(guess.period), level, miss, tuple(map(float, state)), table, details)
