"""What a worker does: build the bench of a search once, then turn numbers of starts into attempts."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.atlas.attempt import Attempt, Numbers, attempt
from orbitfinder.atlas.continuing import CONTINUATION, continued
from orbitfinder.atlas.signature import among
from orbitfinder.atlas.starts import Bench, Target, bench, strategy_of
from orbitfinder.errors import LimitError
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.mechanics.catalogue import build_model

LONGEST_START = 120.0
"""s after which one start is given up, or a budget would be overrun without end; ordinary ones take 0.01 to 10"""


@dataclass(frozen=True)
class Task:
    """A search as plain values that travel: system, energy (J), range of periods (s), seed.

    `folder` is that of a trusted problem file whose Python function makes the system.
    """

    system: Mapping[str, Any]
    energy: float
    periods: tuple[float, float]
    seed: int
    folder: str | None = None

    @property
    def target(self) -> Target:
        """What is looked for."""
        return Target(self.energy, self.periods)

    def text(self) -> str:
        """The same as JSON."""
        return json.dumps(asdict(self), sort_keys=True)


@dataclass(frozen=True)
class Order:
    """One start to be made: its number, whether known orbits count as suspects, an orbit to continue from."""

    number: int
    certain: bool = False
    source: Mapping[str, Any] | None = None
    tries: int = field(default=1, compare=False)


class Known:
    """Energies, periods and actions of the orbits that a worker has heard of."""

    def __init__(self) -> None:
        self._numbers = np.zeros((0, 3))

    def learn(self, news: list[Numbers]) -> None:
        """Hear of more orbits."""
        if news:
            self._numbers = np.vstack([self._numbers, np.asarray(news, float)])

    def __call__(self, numbers: Numbers) -> bool:
        """True when an orbit with these numbers is among them."""
        return among(self._numbers, numbers)


@lru_cache(maxsize=4)
def prepared(text: str) -> Bench:
    """The bench of a task given as JSON, made once in a process."""
    task = json.loads(text)
    folder = None if task["folder"] is None else Path(task["folder"])
    return bench(build_model(task["system"], folder), Target(task["energy"], tuple(task["periods"])))


@one_thread()
def perform(one: Bench, seed: int, order: Order, known: Known) -> Attempt:
    """One start; whatever goes wrong in it is its reason."""
    began = time.process_time()
    asked = None if order.certain else known
    try:
        with limit.limited(LONGEST_START):
            if order.source is not None:
                found = continued(one, seed, order.number, order.source, asked)
            else:
                found = attempt(one, seed, order.number, asked)
    except (RuntimeError, ValueError, ArithmeticError, LimitError) as error:
        limit.check()  # that of the whole search ends the search
        name = CONTINUATION if order.source is not None else strategy_of(one, order.number)
        found = Attempt(order.number, name, reason=f"error: {type(error).__name__}")
    if found.orbit is not None:  # dense samples stay here: the nodes rebuild them
        light = replace(found.orbit, times=np.zeros(0), samples=np.zeros((0, found.orbit.state.size)))
        found = replace(found, orbit=light)
    return replace(found, seconds=time.process_time() - began)
