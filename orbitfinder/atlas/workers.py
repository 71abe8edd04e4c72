"""Who does the starts: this process, spawned ones that talk over pipes and may die one at a time, any executor of
concurrent.futures, or a Dask cluster.

Dask's scheduler gives the starts of a lost worker to another one; the number of starts under way is
bounded by the number of threads, so neither side's memory grows with the search.
"""

from __future__ import annotations

import abc
import contextlib
import json
import queue
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from multiprocessing.connection import Connection, wait
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orbitfinder._runtime import cluster, limit, processes
from orbitfinder._runtime.cluster import CONNECTING, EACH
from orbitfinder.atlas.attempt import CONTINUATION, Attempt, Job, attempts
from orbitfinder.atlas.signature import Numbers
from orbitfinder.atlas.starts import Context, Target, context_of, strategy_of
from orbitfinder.errors import InputError, LimitError, OrbitfinderError
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.mechanics.kind import build_model

LONGEST_START = 120.0
"""s after which a start is given up, or a budget would be overrun without end; ordinary ones take 0.01 to 10"""
DIED = "worker died"
MOST_FALSE_STARTS, REMEDY = 3, "make it anew, with the same orbitfinder and system there"
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Request:
    """A search as plain values that travel.

    `folder` is that of a trusted problem file whose Python function makes the system.
    """

    system: Mapping[str, Any]
    target: Target
    seed: int
    folder: str | None = None

    def text(self) -> str:
        """The same as JSON."""
        return json.dumps(asdict(self), sort_keys=True)


@lru_cache(maxsize=4)
def prepared(text: str) -> Context:
    """The context of a request given as JSON, made once in a process."""
    request = json.loads(text)
    folder, target = request["folder"], request["target"]
    model = build_model(request["system"], cluster.home(folder))
    return context_of(model, Target(**target | {"periods": tuple(target["periods"])}))


@one_thread()
def perform(context: Context, seed: int, jobs: Sequence[Job], known: ArrayLike) -> list[Attempt]:
    """Starts side by side; whatever goes wrong in each is its reason."""
    began = time.process_time()
    try:
        with limit.limited(LONGEST_START):
            made = attempts(context, seed, jobs, known)
    except (RuntimeError, ValueError, ArithmeticError, LimitError) as error:
        limit.check()  # that of the whole search ends the search
        if len(jobs) > 1:  # whichever it was, it costs itself alone
            return [made for job in jobs for made in perform(context, seed, [job], known)]
        name = CONTINUATION if jobs[0].source is not None else strategy_of(context, jobs[0].number)
        spent = time.process_time() - began
        made = [Attempt(jobs[0].number, name, reason=f"error: {type(error).__name__}", seconds=spent)]
    processes.trim()
    for k, each in enumerate(made):
        if (orbit := each.orbit) is not None:  # dense samples stay here: the nodes rebuild them
            orbit = replace(orbit, times=np.zeros(0), samples=np.zeros((0, orbit.state.size)))
            made[k] = replace(each, orbit=orbit)
    return made


class Workers(abc.ABC):
    """Takes jobs to be done side by side as long as `room` is positive, gives back attempts in the order in which they
    come.

    Every start is told of the orbits that are known when it is handed out (`learn`).
    """

    def __init__(self, request: Request) -> None:
        self._request = request
        self._known: list[Numbers] = []

    @property
    @abc.abstractmethod
    def room(self) -> int:
        """How many more times it takes jobs now."""

    @abc.abstractmethod
    def submit(self, jobs: Sequence[Job]) -> None:
        """Begin some starts."""

    @abc.abstractmethod
    def results(self, timeout: float) -> list[tuple[Job, Attempt]]:
        """What has ended, after at most `timeout` seconds."""

    def learn(self, numbers: Numbers) -> None:
        """Know one more orbit."""
        self._known.append(numbers)

    @abc.abstractmethod
    def close(self) -> None:
        """Stop the workers."""


class Inline(Workers):
    """Starts in this process."""

    def __init__(self, context: Context, request: Request) -> None:
        super().__init__(request)
        self._context = context
        self._waiting: list[Sequence[Job]] = []

    @property
    def room(self) -> int:
        """Some at a time."""
        return 1 - len(self._waiting)

    def submit(self, jobs: Sequence[Job]) -> None:
        """Remember the starts until somebody asks for results."""
        self._waiting.append(jobs)

    def results(self, timeout: float) -> list[tuple[Job, Attempt]]:  # noqa: ARG002  that of the others
        """Do the starts."""
        if not self._waiting:
            return []
        jobs = self._waiting.pop()
        return list(zip(jobs, perform(self._context, self._request.seed, jobs, self._known), strict=True))

    def close(self) -> None:
        """Nothing to stop."""


@dataclass(eq=False)
class Worker(processes.Hand):
    """A spawned process, the pipe to it, what it is doing and of how many known orbits it has heard."""

    jobs: Sequence[Job] = ()
    heard: int = 0
    ready: bool = False


class LocalWorkers(Workers):
    """Spawned processes on this machine."""

    def __init__(self, request: Request, count: int) -> None:
        super().__init__(request)
        self._again: list[Job] = []
        self._workers = []
        self._false_starts = 0
        for _ in range(count):
            self._workers.append(self._started())

    @property
    def room(self) -> int:
        """Idle workers."""
        return len(self._idle()) - len(self._again)

    def _idle(self) -> list[Worker]:
        return [worker for worker in self._workers if worker.ready and not worker.jobs]

    def submit(self, jobs: Sequence[Job]) -> None:
        """Give starts to an idle worker, with the known orbits that it has not heard of."""
        worker = self._idle()[0]
        worker.jobs = jobs
        worker.tell((jobs, self._known[worker.heard :]))
        worker.heard = len(self._known)

    def results(self, timeout: float) -> list[tuple[Job, Attempt]]:
        """Attempts that have come in; dead workers are replaced, their starts repeated once."""
        ended = []
        ready = wait([hand.pipe for hand in self._workers], timeout)
        for k, worker in enumerate(self._workers):
            if worker.pipe in ready:
                ended += self._heard_from(k, worker)
        while self._again and self._idle():
            self.submit([self._again.pop(0)])
        return ended

    def close(self) -> None:
        """End them: they hold nothing that the parent does not have."""
        processes.dismissed(self._workers)

    def _heard_from(self, k: int, worker: Worker) -> list[tuple[Job, Attempt]]:
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):
            return self._replaced(k, worker)
        if message is None:
            worker.ready, self._false_starts = True, 0
            return []
        jobs, worker.jobs = worker.jobs, ()
        return list(zip(jobs, message, strict=True))

    def _replaced(self, k: int, worker: Worker) -> list[tuple[Job, Attempt]]:
        """A new process for a dead one, and its starts once more, each alone, or given up."""
        worker.pipe.close()
        worker.process.join(processes.LAST_WORDS)
        self._false_starts += not worker.ready
        if self._false_starts > MOST_FALSE_STARTS:
            raise OrbitfinderError(
                "search: worker processes die before they begin; a script must call search below "
                "if __name__ == '__main__', and workers = 0 searches without other processes"
            )
        self._workers[k] = self._started()
        self._again += [replace(job, tries=job.tries + 1) for job in worker.jobs if job.tries < 2]
        return [(job, Attempt(job.number, "", reason=DIED)) for job in worker.jobs if job.tries >= 2]

    def _started(self) -> Worker:
        begun = processes.hired(serve, self._request.text(), self._request.seed)
        return Worker(begun.process, begun.pipe)


def serve(pipe: Connection, text: str, seed: int) -> None:
    """The life of a worker: until the pipe is closed, some starts after the others."""
    context, known = prepared(text), list[Numbers]()
    with contextlib.suppress(EOFError, OSError):
        pipe.send(None)
        while True:
            jobs, news = pipe.recv()
            known += news
            pipe.send(perform(context, seed, jobs, known))


def remote(text: str, seed: int, jobs: Sequence[Job], known: np.ndarray) -> list[Attempt]:
    """What a worker elsewhere runs. CasADi is not safe in threads, so a process does one such call at a time."""
    with _one_at_a_time:
        return perform(prepared(text), seed, jobs, known)


class Futures(Workers):
    """Starts by what answers in futures: those under way, and what has ended in the order of that."""

    lost: tuple[type[BaseException], ...] = ()
    """what a future raises whose start has killed its worker"""

    def __init__(self, request: Request) -> None:
        super().__init__(request)
        self._under_way: dict[Any, Sequence[Job]] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()

    @abc.abstractmethod
    def begun(self, *arguments: Any) -> Any:
        """The future of `remote` with these arguments."""

    def submit(self, jobs: Sequence[Job]) -> None:
        """Give starts away."""
        known = np.reshape(self._known, (-1, 3))
        future = self.begun(self._request.text(), self._request.seed, jobs, known)
        self._under_way[future] = jobs
        future.add_done_callback(self._ended.put)

    def results(self, timeout: float) -> list[tuple[Job, Attempt]]:
        """Attempts that have come in."""
        try:
            future = self._ended.get(timeout=timeout)
        except queue.Empty:
            self.room  # noqa: B018  notices when no worker is left
            return []
        jobs = self._under_way.pop(future)
        try:
            return list(zip(jobs, future.result(timeout=CONNECTING), strict=True))
        except self.lost:
            if len(jobs) == 1:
                return [(jobs[0], Attempt(jobs[0].number, "", reason=DIED))]
            for job in jobs:  # whichever it was, it costs itself alone
                self.submit([job])
            return []
        except LimitError:
            raise
        except Exception as error:  # whatever a worker can raise
            raise self.fault(error) from error

    def fault(self, error: Exception) -> OrbitfinderError:
        """What an error of a start means, with its remedy."""
        if isinstance(error, CancelledError):
            why = (
                f"the executor is gone or took its work back ({error}); start it again and give the same command, which"
            )
            return OrbitfinderError(f"search: {why} goes on from here")
        if isinstance(error, InputError):  # of the problem, read there: a module or a file that only this machine has
            why = f"a worker of the executor cannot read the problem: {error}"
            return OrbitfinderError(f"search: {why}; what it imports and names must be where its workers run, too")
        why = (
            f"a worker of the executor failed with {type(error).__name__}: {error}; {REMEDY}, and give the same command"
        )
        return OrbitfinderError(f"search: {why} again")


class Pool(Futures):
    """The workers of an executor of concurrent.futures, or of what behaves like one (loky, MPI, ipyparallel)."""

    def __init__(self, request: Request, executor: Executor, workers: int) -> None:
        super().__init__(request)
        if not callable(getattr(executor, "submit", None)):
            raise InputError(f"executor: {type(executor).__name__} has no submit(); give one of concurrent.futures")
        self._executor = executor
        self._places = EACH * max(1, int(getattr(executor, "_max_workers", 0) or workers))

    @property
    def room(self) -> int:
        """Starts that may wait at the executor."""
        return self._places - len(self._under_way)

    def begun(self, *arguments: Any) -> Any:
        """Raises `OrbitfinderError` when the executor takes nothing any more."""
        try:
            return self._executor.submit(remote, *arguments)
        except (BrokenExecutor, RuntimeError) as error:
            raise OrbitfinderError(f"search: the executor takes no more starts ({error}); {REMEDY}") from error

    def close(self) -> None:
        """Take back what has not been begun; the executor is its owner's."""
        for future in self._under_way:
            future.cancel()


class Cluster(Futures):
    """The workers behind a Dask scheduler, `waiting` (s) for them at the beginning and whenever none is left."""

    def __init__(self, request: Request, address: str, waiting: float = 300.0) -> None:
        self._scheduler = cluster.Scheduler(address, "search", request.folder, waiting)
        super().__init__(replace(request, folder=self._scheduler.luggage.folder))
        self.lost = self._scheduler.lost

    @property
    def room(self) -> int:
        """Starts that the threads of the cluster can take on."""
        return self._scheduler.room(len(self._under_way))

    def begun(self, *arguments: Any) -> Any:
        """A start at the scheduler's."""
        return self._scheduler.begun(remote, *arguments)

    def fault(self, error: Exception) -> OrbitfinderError:
        """What an error of a start means, and of which worker."""
        return self._scheduler.fault(error)

    def close(self) -> None:
        """Take back what has not been done; the cluster stays up for others."""
        self._scheduler.close(self._under_way)
