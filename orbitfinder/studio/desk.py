"""What all parts of the studio's page share: the session, its processes, what is on the stage, and the line that says
what happens."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Any

import numpy as np
from nicegui import ui

from orbitfinder.errors import InputError, OrbitfinderError
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanics.scales import units
from orbitfinder.records.orbit import Orbit
from orbitfinder.studio.session import Session
from orbitfinder.studio.worker import StoppedError, TaskProcess


def button(label: str, then: Callable[..., Any] | None, name: str, look: str = "") -> Any:
    """A button of the page, found by its name; its `look` in Quasar's words."""
    return ui.button(label, on_click=then).props(f'no-caps dense {look or ROOMY} id="{name}"')


ROOMY = 'padding="4px 16px"'
"""The look of what is clicked most"""


@dataclass(frozen=True)
class Staged:
    """What is on the stage: a system, its state at t = 0, its energy (J, None without one), the orbit if it is one."""

    system: dict[str, Any]
    state: list[float]
    energy: float | None
    orbit: Orbit | None = None

    @classmethod
    def of(cls, orbit: Orbit) -> Staged:
        """Where an orbit starts."""
        level = orbit.energy if math.isfinite(orbit.energy) else None
        return cls(dict(orbit.system), [*map(float, orbit.state)], level)


class Desk:
    """One tab: a quick process for what the stage shows, another one for searches, which can be cancelled."""

    status: Any
    busy: Any
    cancel: Any

    def __init__(self, session: Session, taken: set[str]) -> None:
        self.session, self.taken = session, taken
        self.quick, self.long = TaskProcess(), TaskProcess()
        state = session.opened.state
        self.source = Staged(dict(session.model.system), [*map(float, state)], self.level(state))
        self.dark = False

    def unit(self, quantity: str) -> str:
        """A quantity's unit as the name of a field ends with it."""
        known = units(self.session.model.system)[quantity]
        return f", {known}" if known else ""

    def level(self, state: Sequence[float] | np.ndarray) -> float | None:
        """The energy (J) of a state of the system on the stage, None where there is none."""
        model = self.session.model
        known = model.constraint is None and model.conservative
        level = energy(model, np.asarray(state)) if known else math.nan
        return level if math.isfinite(level) else None

    def safe(self, work: Callable[..., Awaitable[Any] | None]) -> Callable[..., Awaitable[None]]:
        """The same, of which what is refused is a sentence on the page."""

        @wraps(work)
        async def spoken(*arguments: Any) -> None:
            try:
                waiting = work(*arguments)
                if waiting is not None:
                    await waiting
            except StoppedError as error:
                self.say(str(error).capitalize())
            except (OrbitfinderError, OSError) as error:
                self.say(f"{error}")
                ui.notify(str(error), type="warning", multi_line=True, timeout=8000)

        return spoken

    def say(self, sentence: str) -> None:
        """Put a sentence on the line of what happens."""
        self.status.set_text(sentence)

    def free(self, busy: bool = False) -> None:
        """Show whether a search can be cancelled."""
        self.busy.set_visibility(busy)
        self.cancel.set_visibility(busy)

    async def searched(self, task: str, *arguments: Any, said: Callable[[Any], None] | None = None) -> Any:
        """The answer of the process for searches, one at a time."""
        if self.long.busy:
            raise InputError("a search is under way; cancel it first")
        self.free(busy=True)
        try:
            return await self.long.do(task, *arguments, said=said)
        finally:
            self.free()
