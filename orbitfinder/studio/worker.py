"""Processes of the studio: each does one task at a time, tells how it gets on, and can be stopped at once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from orbitfinder._runtime.processes import Hand, dismissed, hired
from orbitfinder.errors import OrbitfinderError
from orbitfinder.studio.tasks import Tasks


class StoppedError(OrbitfinderError):
    """The task was cancelled, or its process has died."""


class RefusedError(OrbitfinderError):
    """The task ended with a sentence."""


def work(pipe: Any) -> None:
    """In the process: do the tasks that come through the pipe until it is closed."""
    tasks = Tasks(lambda what: pipe.send(("said", what)))
    while True:
        try:
            name, arguments = pipe.recv()
        except EOFError:
            return
        try:
            answer = "done", getattr(tasks, name)(*arguments)
        except OrbitfinderError as error:
            answer = "refused", str(error)
        except Exception as error:  # a page must not wait for ever
            answer = "refused", f"{type(error).__name__}: {error}; please report this"
        pipe.send(answer)


class TaskProcess:
    """One process and the thread that listens to it."""

    def __init__(self) -> None:
        self._listener = ThreadPoolExecutor(1)
        self._turn = asyncio.Lock()
        self._hand: Hand | None = None
        self._closed = False

    @property
    def busy(self) -> bool:
        """Whether a task is under way."""
        return self._turn.locked()

    @property
    def process(self) -> int | None:
        """The number of the process, where there is one."""
        return None if self._hand is None else self._hand.process.pid

    async def start(self) -> None:
        """Have the process ready before the first task."""
        async with self._turn:
            await self._ready()

    async def do(self, task: str, *arguments: Any, said: Callable[[Any], None] | None = None) -> Any:
        """The answer of a task of `Tasks`; `said` gets what it tells on the way.

        Raises `RefusedError` with its sentence, `StoppedError` when it was stopped; the next task has a new process.
        """
        async with self._turn:
            hand = await self._ready()
            hand.tell((task, arguments))
            while True:
                answer = await self._apart(hand.answer)
                if answer is None:
                    self._gone(hand)
                    raise StoppedError("stopped; nothing that is saved is lost")
                match answer:
                    case "refused", what:
                        raise RefusedError(what)
                    case "done", what:
                        return what
                    case _, what if said is not None:
                        said(what)

    def stop(self) -> None:
        """End the task under way at once."""
        if self._hand is not None:
            self._hand.process.kill()

    def close(self) -> None:
        """End the process; there is no other one."""
        self._closed = True
        self.stop()
        self._listener.shutdown(wait=False, cancel_futures=True)

    async def _ready(self) -> Hand:
        if self._closed:
            raise StoppedError("the page is closed")
        if self._hand is not None and not self._hand.process.is_alive():  # killed while it waited for a task
            self._gone(self._hand)
        if self._hand is None:
            self._hand = await self._apart(lambda: hired(work))
        return self._hand

    def _gone(self, hand: Hand) -> None:
        self._hand = None
        dismissed([hand])

    async def _apart(self, work: Callable[[], Any]) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._listener, work)
