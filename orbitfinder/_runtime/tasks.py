"""Tasks that do not depend on each other, done here, by spawned processes or by the workers of a Dask scheduler.

    with crew(work, workers=2) as answers:
        for number, answer in answers(requests):
            ...

`work` is a function of a module, requests are its arguments, both plain enough to travel. Answers come as they are
ready. A process that dies is replaced and its task done once more. On a cluster `cluster.home` says where a trusted
folder is that requests name.
"""

from __future__ import annotations

import contextlib
import math
import queue
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from orbitfinder._runtime import cluster, limit, processes
from orbitfinder.errors import InputError, OrbitfinderError

Work = Callable[..., Any]
Requests = Sequence[tuple[Any, ...]]
Answers = Callable[[Requests], Iterator[tuple[int, Any]]]


@contextlib.contextmanager
def crew(
    work: Work, workers: int = 1, what: str = "work", scheduler: cluster.Scheduler | None = None
) -> Iterator[Answers]:
    """Who does tasks: this process (`workers` 1), spawned ones, a cluster; `what` they are of is said in messages."""
    if scheduler is not None:
        yield partial(from_cluster, scheduler, work)
        return
    if not 1 <= workers <= 256:
        raise InputError(f"workers: must be between 1 and 256, got {workers}")
    if workers == 1:
        yield lambda requests: ((k, work(*request)) for k, request in enumerate(requests))
        return
    hired = _Processes(work, workers, what)
    try:
        yield hired.answers
    finally:
        processes.dismissed(hired.hands)


class _Processes:
    """Spawned processes, as many as there is work for at once."""

    def __init__(self, work: Work, most: int, what: str) -> None:
        self._work, self._most, self._what = work, most, what
        self.hands: list[processes.Hand] = []

    def answers(self, requests: Requests) -> Iterator[tuple[int, Any]]:
        """The answers with the numbers of their requests."""
        waiting, busy, tries = deque(range(len(requests))), dict[processes.Hand, int](), Counter[int]()
        while waiting or busy:
            idle = [hand for hand in self.hands if hand not in busy]
            while waiting and (idle or len(self.hands) < self._most):
                if not idle:
                    idle.append(processes.hired(_serve, self._work, limit.left()))
                    self.hands += idle
                hand = idle.pop()
                busy[hand] = waiting.popleft()
                hand.tell(requests[busy[hand]])
            for hand in processes.ready(busy):
                number, answer = busy.pop(hand), hand.answer()
                if isinstance(answer, BaseException):
                    raise answer
                if answer is not None:
                    yield number, answer[0]
                    continue
                self.hands.remove(hand)
                processes.dismissed([hand])
                tries[number] += 1
                if tries[number] > 1:
                    raise OrbitfinderError(f"{self._what}: processes die at task {number + 1} of {len(requests)}; "
                                           "run it again with workers = 1 to see where")  # fmt: skip
                waiting.appendleft(number)


def _serve(pipe: Connection, work: Work, left: float) -> None:
    """The life of a process: task after task."""
    bound, quiet = limit.limited(left if math.isfinite(left) else None), np.errstate(all="ignore")
    with contextlib.suppress(EOFError, OSError), bound, quiet:
        while True:
            request = pipe.recv()
            try:
                answer: Any = (work(*request),)
            except OrbitfinderError as error:
                answer = error
            except Exception as error:  # a traceback in a process of ours helps nobody
                answer = OrbitfinderError(f"a process failed with {type(error).__name__}: {error}")
            pipe.send(answer)


def from_cluster(scheduler: cluster.Scheduler, work: Work, requests: Requests) -> Iterator[tuple[int, Any]]:
    """The answers of a cluster's workers, no more of them under way than it has room for."""
    waiting, futures, ended = deque(range(len(requests))), dict[Any, int](), queue.SimpleQueue[Any]()
    try:
        while waiting or futures:
            limit.check()
            while waiting and scheduler.room(len(futures)) > 0:
                future = scheduler.begun(work, *requests[waiting[0]])
                futures[future] = waiting.popleft()
                future.add_done_callback(ended.put)
            with contextlib.suppress(queue.Empty):
                future = ended.get(timeout=0.2)  # s between two looks at the clock
                try:
                    answer = future.result(timeout=cluster.CONNECTING)
                except Exception as error:
                    raise scheduler.fault(error) from error
                yield futures.pop(future), answer
    finally:
        scheduler.taken_back(futures)
