"""Who does the starts: this process, or spawned ones that talk over pipes and may die one at a time."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from typing import Protocol

from orbitfinder._runtime import processes
from orbitfinder.atlas.attempt import Attempt, Numbers
from orbitfinder.atlas.job import Known, Order, Task, perform, prepared
from orbitfinder.atlas.starts import Bench
from orbitfinder.errors import OrbitfinderError

MOST_TRIES = 2
"""A start whose worker died is tried once more; then it has cost itself and nothing else."""
DIED = "worker died"
MOST_FALSE_STARTS = 3


class Workers(Protocol):
    """Takes orders as long as `room` is positive, gives back attempts in the order in which they come."""

    @property
    def room(self) -> int:
        """How many more orders it takes now."""

    def submit(self, order: Order) -> None:
        """Begin a start."""

    def results(self, timeout: float) -> list[tuple[Order, Attempt]]:
        """What has ended, after at most `timeout` seconds."""

    def learn(self, numbers: Numbers) -> None:
        """Tell the workers of a new orbit."""

    def close(self) -> None:
        """Stop the workers."""


class Inline:
    """Starts in this process, one by one."""

    def __init__(self, one: Bench, task: Task) -> None:
        self._bench, self._seed, self._known = one, task.seed, Known()
        self._waiting: list[Order] = []

    @property
    def room(self) -> int:
        """One start at a time."""
        return 1 - len(self._waiting)

    def submit(self, order: Order) -> None:
        """Remember the start until somebody asks for results."""
        self._waiting.append(order)

    def results(self, timeout: float) -> list[tuple[Order, Attempt]]:
        """Do the start."""
        if not self._waiting:
            return []
        order = self._waiting.pop()
        return [(order, perform(self._bench, self._seed, order, self._known))]

    def learn(self, numbers: Numbers) -> None:
        """Know one more orbit."""
        self._known.learn([numbers])

    def close(self) -> None:
        """Nothing to stop."""


@dataclass(eq=False)
class Worker(processes.Hand):
    """A spawned process, the pipe to it, what it is doing and how much of the news it has heard."""

    order: Order | None = None
    heard: int = 0
    ready: bool = False


class Local:
    """Spawned processes on this machine."""

    def __init__(self, task: Task, count: int) -> None:
        self._task, self._news, self._false_starts = task, list[Numbers](), 0
        self._again: list[Order] = []
        self._workers: list[Worker] = []
        for _ in range(count):
            self._workers.append(self._hired())

    @property
    def room(self) -> int:
        """Idle workers."""
        return len(self._idle()) - len(self._again)

    def _idle(self) -> list[Worker]:
        return [one for one in self._workers if one.ready and one.order is None]

    def submit(self, order: Order) -> None:
        """Give a start to an idle worker, with the news that it has not heard."""
        worker = self._idle()[0]
        worker.order = order
        worker.tell((order, self._news[worker.heard :]))
        worker.heard = len(self._news)

    def results(self, timeout: float) -> list[tuple[Order, Attempt]]:
        """Attempts that have come in; dead workers are replaced, their starts repeated once."""
        found: list[tuple[Order, Attempt]] = []
        ready = wait([one.pipe for one in self._workers], timeout)
        for k, worker in enumerate(self._workers):
            if worker.pipe in ready:
                found += self._heard_from(k, worker)
        while self._again and self._idle():
            self.submit(self._again.pop(0))
        return found

    def learn(self, numbers: Numbers) -> None:
        """Every worker hears of it with its next start."""
        self._news.append(numbers)

    def close(self) -> None:
        """End them: they hold nothing that the parent does not have."""
        processes.dismissed(self._workers)

    def _heard_from(self, k: int, worker: Worker) -> list[tuple[Order, Attempt]]:
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):
            return self._replaced(k, worker)
        if message is None:
            worker.ready, self._false_starts = True, 0
            return []
        order, worker.order = worker.order, None
        assert order is not None
        return [(order, message)]

    def _replaced(self, k: int, worker: Worker) -> list[tuple[Order, Attempt]]:
        """A new process for a dead one, and its start once more or given up."""
        worker.pipe.close()
        worker.process.join(processes.LAST_WORDS)
        self._false_starts += not worker.ready
        if self._false_starts > MOST_FALSE_STARTS:
            raise OrbitfinderError(
                "search: worker processes die before they begin; a script must call search below "
                "if __name__ == '__main__', and --workers 0 searches without other processes"
            )
        self._workers[k] = self._hired()
        order = worker.order
        if order is None:
            return []
        if order.tries < MOST_TRIES:
            self._again.append(replace(order, tries=order.tries + 1))
            return []
        return [(order, Attempt(order.number, "", reason=DIED))]

    def _hired(self) -> Worker:
        hand = processes.hired(serve, self._task.text(), self._task.seed)
        return Worker(hand.process, hand.pipe)


def serve(pipe: Connection, text: str, seed: int) -> None:
    """The life of a worker: until the pipe is closed, one start after the other."""
    one, known = prepared(text), Known()
    with contextlib.suppress(EOFError, OSError):
        pipe.send(None)
        while True:
            order, news = pipe.recv()
            known.learn(news)
            pipe.send(perform(one, seed, order, known))
