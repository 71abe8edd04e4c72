"""Starts done by the workers of a Dask cluster: same orders, same attempts, judged and written here.

Dask's scheduler gives the starts of a lost worker to another one; the number of starts under way is
bounded by the number of threads, so neither side's memory grows with the search.
"""

from __future__ import annotations

import itertools
import queue
import threading
import time
import uuid
from typing import Any

import numpy as np

from orbitfinder.atlas.attempt import Attempt, Numbers
from orbitfinder.atlas.job import Known, Order, Task, perform, prepared
from orbitfinder.atlas.workers import DIED
from orbitfinder.errors import InputError, OrbitfinderError

CONNECTING = 20.0
"""Seconds to wait for the scheduler."""
WAITING = 300.0
"""Seconds to wait for workers, at the beginning and whenever none is left."""
EACH = 2
"""Starts under way for each thread: one in work, one waiting there."""
LOOK_EVERY = 2.0
"""Seconds between two looks at how many threads there are."""
_one_at_a_time = threading.Lock()


def remote(text: str, seed: int, order: Order, numbers: np.ndarray) -> Attempt:
    """What a Dask worker runs. CasADi is not safe in threads, so a process does one start at a time."""
    with _one_at_a_time:
        known = Known()
        known.learn([(float(a), float(b), float(c)) for a, b, c in numbers])
        return perform(prepared(text), seed, order, known)


class Cluster:
    """The workers behind a Dask scheduler (see `workers.Workers`)."""

    def __init__(self, task: Task, address: str, waiting: float = WAITING) -> None:
        distributed = _distributed()
        self._task, self._waiting = task, waiting
        self._news: list[Numbers] = []
        self._under_way: dict[Any, Order] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._names = (f"orbitfinder-{uuid.uuid4()}-{k}" for k in itertools.count())
        try:
            self._client = distributed.Client(address, timeout=CONNECTING, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"--scheduler: no Dask scheduler answers at {address!r} ({error}); give its address, such as "
                "tcp://host:8786"
            ) from error
        self._threads, self._looked, self._alone_since = 0, 0.0, time.monotonic()

    @property
    def room(self) -> int:
        """Starts that the threads of the cluster can take on."""
        if time.monotonic() - self._looked > LOOK_EVERY:
            self._looked = time.monotonic()
            self._threads = sum(self._client.nthreads().values())
            if self._threads:
                self._alone_since = time.monotonic()
            elif time.monotonic() - self._alone_since > self._waiting:
                raise OrbitfinderError(
                    f"search: the scheduler has had no workers for {self._waiting:g} s; start some and give the same "
                    "command again, which goes on from here"
                )
        return EACH * self._threads - len(self._under_way)

    def submit(self, order: Order) -> None:
        """Give a start to the scheduler."""
        future = self._client.submit(
            remote, self._task.text(), self._task.seed, order, np.asarray(self._news, float).reshape(-1, 3),
            key=next(self._names), pure=False,
        )  # fmt: skip
        self._under_way[future] = order
        future.add_done_callback(self._ended.put)

    def results(self, timeout: float) -> list[tuple[Order, Attempt]]:
        """Attempts that have come in."""
        try:
            future = self._ended.get(timeout=timeout)
        except queue.Empty:
            self.room  # noqa: B018  notices when no worker is left
            return []
        order = self._under_way.pop(future)
        try:
            return [(order, future.result(timeout=CONNECTING))]
        except _distributed().KilledWorker:
            return [(order, Attempt(order.number, "", reason=DIED))]
        except Exception as error:  # whatever a worker can raise: it lacks the package, or has another one
            raise OrbitfinderError(
                f"search: a worker of the cluster failed with {type(error).__name__}: {error}; install the same "
                "orbitfinder there, and give the same command again"
            ) from error

    def learn(self, numbers: Numbers) -> None:
        """Sent along with every later start."""
        self._news.append(numbers)

    def close(self) -> None:
        """Take back what has not been done; the cluster stays up for others."""
        self._client.cancel(list(self._under_way), force=True)
        self._client.close()


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise InputError(
            "--scheduler: needs Dask; pip install 'orbitfinder[cluster]', or use --workers for this machine"
        ) from error
    return distributed
