"""Disturbed motions of a hybrid system under a controller: the automaton simulated, event after event.

It knows neither the saltation matrix nor the Riccati equation: guards are watched, the law is asked at every evaluation
of the rates. A motion has fallen where no event ends an arc in three periods, or what must hold in the mode does
not: a foot that leaves the ground.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.control.controller import Controller
from orbitfinder.control.export import law_of
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.automaton import Arc, Automaton
from orbitfinder.integrate.dop853 import ReferenceSettings
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.integrate.field import VectorField
from orbitfinder.mechanics.model import Model, altered, vector_field

Acting = Callable[[np.ndarray, float], tuple[np.ndarray, Any]]
"""(x, tau) -> controls, and the place of the orbit: a `Law`, or an exported one"""


class Striking(Automaton):
    """The automaton of a controller's Model, closed by its own law or by another that does the same."""

    def __init__(self, controller: Controller, model: Model, law: Acting | None = None) -> None:
        parts = replace(model.hybrid, modes=tuple(replace(mode, holds={}) for mode in model.hybrid.modes))
        plain = altered(model, hybrid=parts)  # what holds depends on the controls: asked along each arc instead
        super().__init__(plain, ReferenceSettings(1e-9, 1e-11), units=controller.units.tolist())
        self.period, self.names, self.law = controller.period, controller.actuators, law or law_of(controller)
        self.begun = 0.0
        self._rates = Buffered(vector_field(model, self.names))
        x, u = ca.MX.sym("x", controller.units.size), ca.MX.sym("u", len(self.names))
        p = model.parameters(self.names, u)
        held = [hold(x, p) for hold in model.arcs[0][0].holds.values()]
        self._holds = ca.Function("holds", [x, u], [ca.vertcat(*held, 1)])

    def field(self, mode: str) -> VectorField:
        """dx/dt (t, x) in a mode, t since it began."""
        del mode
        none = np.zeros(0)
        return lambda t, x: self._rates(t, x, none, self.law(x, self.begun + t)[0])[0].ravel()

    def after(self, state: np.ndarray, place: float, count: int) -> np.ndarray:
        """States (k x d) right after each of so many events from a state near a place (s) of the orbit; k < count of a
        motion that falls."""
        mode, transition = self.model.arcs[0]
        self.begun, by, states = place, "", [np.asarray(state, float)]
        try:
            while len(states) <= count:
                arc = next(self.arcs(states[-1], mode.name, 3.0 * self.period, 1, by))
                if arc.ended_by != transition.name or self._lifts(arc):
                    break
                states.append(arc.after)
                self.begun, by = 0.0, transition.name
        except IntegrationError:
            pass
        return np.array(states[1:]).reshape(-1, states[0].size)

    def _lifts(self, arc: Arc) -> bool:
        times = self.begun + arc.times - arc.times[0]
        controls = np.array([self.law(x, float(t))[0] for t, x in zip(times, arc.states, strict=True)])
        margins = self._holds.map(len(times))(arc.states.T, controls.T).full()
        return bool(np.any(margins < -1e-9 * np.abs(margins).max(axis=1, keepdims=True)))


def left(controller: Controller, model: Model, kicks: np.ndarray, places: np.ndarray, count: int,
         law: Acting | None = None) -> np.ndarray:  # fmt: skip
    """How far, in extents, motions from kicked states (k x d) near places (k) are from the orbit right after so many
    events (k); infinite where they fall."""
    striking, apart = Striking(controller, model, law), np.full(len(kicks), np.inf)
    for k, (state, place) in enumerate(zip(kicks, places, strict=True)):
        states = striking.after(state, float(place), count)
        if len(states) == count:
            gap = law_of(controller).gap(states[-1], controller.states[0])
            apart[k] = np.linalg.norm(gap / controller.units)
    return apart
