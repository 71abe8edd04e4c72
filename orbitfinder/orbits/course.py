"""The course of an orbit for the eye: smooth pieces one after another, in one frame that stays where it is.

A smooth orbit is one piece. A hybrid one jumps at its events, whose times come twice among its samples, and there the
origin of what is drawn moves on: the stance foot of a walker stays where it is until the other one has come down.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError
from orbitfinder.integrate.automaton import Automaton
from orbitfinder.integrate.dop853 import ReferenceSettings
from orbitfinder.mechanics.model import Model, between, energies, positions
from orbitfinder.orbits.closure import shift
from orbitfinder.orbits.hybrid import cycle_from, motion_of
from orbitfinder.orbits.simulate import LEAST_STEPS
from orbitfinder.records.orbit import Orbit

SEEN, BROKEN = ReferenceSettings(1e-9, 1e-11), 1e-3
"""Accuracy of a motion that is simulated to be drawn; how far what must hold in a mode is below 0, over its range,
where it is seen to be"""


@dataclass(frozen=True)
class Piece:
    """A smooth piece: times (k, s), states (k x d), the Model that draws it, where its origin is (down, right; m), and
    the event that ends it, empty where nothing does."""

    __repr__ = brief("event")

    times: np.ndarray
    states: np.ndarray
    model: Model
    origin: np.ndarray
    event: str = ""


@dataclass(frozen=True)
class Course:
    """The pieces of a period (s), how far it leads (`stride`: down, right; m), and what the machine stands on."""

    __repr__ = brief("pieces", "stride")

    pieces: tuple[Piece, ...]
    period: float
    stride: np.ndarray
    turned: np.ndarray
    """(d) what a period adds to the state, whole turns of angles"""
    ground: Callable[[np.ndarray], np.ndarray] | None = None
    """(d) -> a polyline (2 x k) that belongs to a state"""

    @property
    def jumps(self) -> bool:
        """True when the orbit is hybrid."""
        return bool(self.pieces[0].event)

    @property
    def walks(self) -> bool:
        """True when a period leads somewhere else."""
        return bool(np.abs(self.stride).max() > 0)

    @property
    def gained(self) -> np.ndarray:
        """(d) what a period adds to the coordinates of a smooth motion: whole turns, the shift of a relative orbit."""
        states, n = self.pieces[0].states, self.pieces[0].model.degrees_of_freedom
        moved = states[-1] - states[0]
        lasting = (np.abs(moved) > SEEN.relative_tolerance * np.abs(states).max(axis=0)) & (np.arange(moved.size) < n)
        return np.where(lasting & (not self.jumps), moved, 0.0)

    @property
    def events(self) -> list[tuple[float, str]]:
        """Times (s) and names of the events."""
        return [(float(one.times[-1]), one.event) for one in self.pieces if one.event]

    def states(self, moments: np.ndarray) -> np.ndarray:
        """States (k x d) at moments; beyond the period it goes on from where the period has led."""
        return self._each(moments, lambda one, states, _: states)

    def positions(self, moments: np.ndarray) -> np.ndarray:
        """What is drawn (k x 2 x m) at moments; beyond the period it goes on from where the period has led."""
        return self._each(moments, lambda one, states, origin: positions(one.model, states) + origin[:, :, None])

    def grounds(self, moments: np.ndarray) -> np.ndarray | None:
        """The ground (k x 2 x g) at moments, where one is declared."""
        if (line := self.ground) is None:
            return None
        return self._each(moments, lambda one, states, origin: np.stack([line(x) for x in states]) + origin[:, :, None])

    def _each(self, moments: np.ndarray, seen: Callable[[Piece, np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """What is seen of the pieces that moments fall into: of states and the places of their origins."""
        rounds = np.floor(np.asarray(moments, float) / self.period)
        within = moments - rounds * self.period
        ends = np.array([one.times[-1] for one in self.pieces])
        which, gained = np.minimum(np.searchsorted(ends, within, side="right"), len(self.pieces) - 1), self.gained
        found: Any = None
        for k in np.unique(which):
            one, here = self.pieces[k], slice(None) if len(ends) == 1 else which == k
            n = one.model.degrees_of_freedom
            states = between(one.times, one.states, n, np.minimum(within[here], one.times[-1]))
            states = states + rounds[here, None] * gained
            part = seen(one, states, one.origin + rounds[here, None] * self.stride)
            if len(ends) == 1:
                return part
            found = np.zeros((len(within), *part.shape[1:])) if found is None else found
            found[here] = part
        return np.asarray(found)

    def curve(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Rows of all pieces below each other, with a row of nan where the orbit jumps, so that lines break."""
        rows = [np.vstack([one, np.full((1, one.shape[1]), np.nan)]) for one in values]
        return np.vstack(rows)[:-1]

    @property
    def times(self) -> np.ndarray:
        """All times, broken by nan where the orbit jumps."""
        return self.curve([one.times[:, None] for one in self.pieces])[:, 0]

    @property
    def samples(self) -> np.ndarray:
        """All states, broken likewise."""
        return self.curve([one.states for one in self.pieces])

    @property
    def energies(self) -> tuple[np.ndarray, np.ndarray]:
        """Kinetic and potential energies (J), broken likewise."""
        both = self.curve([np.column_stack(energies(one.model, one.states)) for one in self.pieces])
        return both[:, 0], both[:, 1]

    @property
    def resets(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The states before and after each event of a hybrid orbit, the last of which leads to the first."""
        after = [*(one.states[0] for one in self.pieces[1:]), self.pieces[0].states[0] + self.turned]
        return list(zip((one.states[-1] for one in self.pieces), after, strict=True)) if self.jumps else []


def course_of(orbit: Orbit, model: Model) -> Course:
    """The Course of an orbit from its samples. Raises `InputError` where they are missing."""
    if len(orbit.samples) < 2:
        raise InputError(f"{orbit.name}: no samples to draw; keep orbit.npz beside orbit.json, or run it again")
    return course(model, orbit.times, orbit.samples, orbit.winding)


def course(model: Model, times: np.ndarray, states: np.ndarray, turns: Sequence[int] = ()) -> Course:
    """The Course of dense samples (k) of a period; those of a hybrid orbit have the times of its events twice.

    Raises `InputError` where these are not as many as its cycle asks for.
    """
    period, turned, origin = float(times[-1]), shift(turns, states.shape[1]), np.zeros(2)
    arcs = model.arcs
    cuts = np.flatnonzero(np.diff(times) == 0) + 1
    if len(cuts) != max(len(arcs), 1) - 1:
        raise InputError(
            f"samples: {len(cuts) + 1} arcs where the orbit has {max(len(arcs), 1)}; run the problem again"
        )
    if not arcs:
        return Course((Piece(times, states, model, origin),), period, origin, turned)
    found = []
    for (mode, one), own, here in zip(arcs, np.split(times, cuts), np.split(states, cuts), strict=True):
        found.append(Piece(own, here, mode.model, origin, one.name))
        if one.advance is not None:
            origin = origin + one.advance(here[-1], model.parameter_values).full().ravel()
    return Course(tuple(found), period, origin, turned, _ground(model))


def simulated_course(model: Model, state: np.ndarray, duration: float) -> tuple[Course, str]:
    """The Course of a hybrid Model from a state (d) over a time (s), whatever events it meets, and the name of what
    does not hold in an arc that it therefore ends before. Raises `IntegrationError`."""
    broken = ""
    automaton, origin, pieces = Automaton(model, SEEN, duration / LEAST_STEPS), np.zeros(2), list[Piece]()
    for arc in automaton.arcs(state, model.hybrid.first.name, duration):
        broken = next((name for name, least in arc.margins if pieces and least < -BROKEN), "")
        if broken:
            duration = float(arc.times[0])
            break
        pieces.append(Piece(arc.times, arc.states, model.hybrid.mode(arc.mode).model, origin, arc.ended_by or ""))
        ends = model.hybrid.transition(arc.ended_by) if arc.ended_by else None
        if ends is not None and ends.advance is not None:
            origin = origin + ends.advance(arc.states[-1], model.parameter_values).full().ravel()
    return Course(tuple(pieces), duration, origin, np.zeros(state.size), _ground(model)), broken


def _ground(model: Model) -> Callable[[np.ndarray], np.ndarray] | None:
    if (line := model.hybrid.ground) is None:
        return None
    p = model.parameter_values[: line.numel_in(1)]
    return lambda x: line(x, p).full()


def sampled(model: Model, state: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of a hybrid orbit's period from its state alone, by the automaton; `ConvergenceError`."""
    return motion_of(cycle_from(model, state, SEEN, 2 * period))
