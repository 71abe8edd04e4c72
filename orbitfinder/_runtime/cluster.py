"""The workers behind a Dask scheduler: that they are what we are, what they are sent, and what is wrong with which.

Every task says which versions it wants, so that a worker that joins later answers with no other numbers, and brings the
modules that lie in a trusted folder. Dask gives the tasks of a lost worker to another.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import importlib
import itertools
import shutil
import socket
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError, LimitError, OrbitfinderError

CONNECTING, EACH, VERSIONED, SENT = 20.0, 2, ("orbitfinder", "casadi", "numpy", "scipy"), "sent:"
"""Seconds to wait for the scheduler; tasks under way for each thread, so that none waits; packages that must be the
same everywhere; what the name of a folder that was sent begins with"""
_alone = threading.Lock()


@dataclass(frozen=True)
class Luggage:
    """What a task brings: the versions that it wants, the name of a trusted folder and the modules in it."""

    versions: Mapping[str, str]
    folder: str | None = None
    modules: Mapping[str, str] = field(default_factory=dict)


class WorkerFault(OrbitfinderError):
    """What is wrong with a worker, which is named."""


def home(folder: str | None) -> Path | None:
    """A trusted folder here, also where it was sent."""
    if folder is None or not folder.startswith(SENT):
        return None if folder is None else Path(folder)
    return _own(folder)


@lru_cache(maxsize=16)
def _own(folder: str) -> Path:
    """A folder of this process's own for what was sent, gone with it; nobody else can put anything there."""
    del folder
    made = tempfile.mkdtemp(prefix="orbitfinder-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return Path(made)


def packed(folder: str | Path | None) -> Luggage:
    """The versions here, and the modules of a folder."""
    known = {name: str(getattr(importlib.import_module(name), "__version__", "")) for name in VERSIONED}
    if folder is None:
        return Luggage(known)
    modules = {file.name: file.read_text(encoding="utf-8") for file in sorted(Path(folder).glob("*.py"))}
    digest = hashlib.sha256(repr(sorted(modules.items())).encode()).hexdigest()[:16]
    return Luggage(known, SENT + digest, modules)


def performed(luggage: Luggage, work: Callable[..., Any], *arguments: Any) -> Any:
    """What a worker runs: task by task, as CasADi is not safe in threads. Raises `WorkerFault`, which names it."""
    with _alone:
        _checked(luggage.versions, packed(None).versions, _address())
        if (place := home(luggage.folder)) is not None and luggage.modules:
            for name, text in luggage.modules.items():
                (place / name).write_text(text, encoding="utf-8")
        try:
            return work(*arguments)
        except LimitError:
            raise
        except InputError as error:
            raise InputError(f"the worker {_address()} cannot read the problem: {error}") from error
        except Exception as error:
            raise WorkerFault(f"the worker {_address()} failed with {type(error).__name__}: {error}") from error


def _address() -> str:
    """What this worker is called."""
    with contextlib.suppress(ImportError, ValueError):
        from distributed import get_worker  # noqa: PLC0415  an extra

        return f"{get_worker().address} on {socket.gethostname()}"
    return socket.gethostname()


def _checked(wanted: Mapping[str, str], there: Mapping[str, Any], where: str) -> None:
    """Raises `WorkerFault` where versions are not those that are wanted."""
    other = [f"{name} {there.get(name) or 'missing'}" for name in wanted if there.get(name) != wanted[name]]
    if other:
        install = " ".join(f"{name}=={version}" for name, version in wanted.items())
        raise WorkerFault(
            f"the worker {where} has {', '.join(other)}, here it is "
            f"{', '.join(f'{name} {wanted[name]}' for name in wanted if there.get(name) != wanted[name])}, and its "
            f"numbers would be others; pip install {install} there and restart it"
        )


class Scheduler:
    """The threads of a cluster for tasks of something (`what`), `waiting` (s) for workers whenever none is left."""

    def __init__(self, address: str, what: str, folder: str | Path | None = None, waiting: float = 300.0) -> None:
        self._distributed, self._what, self._address, self._waiting = _distributed(), what, address, waiting
        self._names = (f"orbitfinder-{uuid.uuid4()}-{k}" for k in itertools.count())
        self.luggage, self.lost = packed(folder), (self._distributed.KilledWorker,)
        listening(address)
        try:
            self._client = self._distributed.Client(address, timeout=CONNECTING, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise _nobody(address, error) from error
        self._seen, self._threads, self._looked, self._alone_since = set[str](), 0, 0.0, time.monotonic()

    def room(self, under_way: int) -> int:
        """Tasks that the threads of the cluster can take on; looks at workers that are new."""
        if time.monotonic() - self._looked > 2.0:
            self._looked = time.monotonic()
            threads = self._client.nthreads()
            self._threads = sum(threads.values())
            if threads.keys() - self._seen:
                known = self._client.get_versions(check=False, packages=list(VERSIONED))["workers"]
                for worker, told in known.items():
                    try:
                        _checked(self.luggage.versions, told["packages"], worker)
                    except WorkerFault as error:
                        raise self.fault(error) from error
                self._seen |= known.keys()
            if self._threads:
                self._alone_since = time.monotonic()
            elif time.monotonic() - self._alone_since > self._waiting:
                raise OrbitfinderError(
                    f"{self._what}: the scheduler has had no workers for {self._waiting:g} s; start some and give the "
                    "same command again, which goes on from here"
                )
        return EACH * self._threads - under_way

    def begun(self, work: Callable[..., Any], *arguments: Any) -> Any:
        """The future of a task."""
        return self._client.submit(performed, self.luggage, work, *arguments, key=next(self._names), pure=False)

    def fault(self, error: BaseException) -> OrbitfinderError:
        """What an error of a future means, in a sentence with its remedy; what passes on is of our own."""
        again = "give the same command again, which goes on from here"
        if isinstance(error, LimitError):
            return error
        if isinstance(error, OrbitfinderError):
            return type(error)(f"{self._what}: {error}" + ("" if isinstance(error, InputError) else f"; then {again}"))
        try:
            if self._client.status != "running":
                raise OSError(f"connection {self._client.status}")
            listening(self._address)
        except (OSError, InputError) as gone:
            where = f"the scheduler at {self._address} is gone ({gone})"
            return OrbitfinderError(f"{self._what}: {where}; start it and its workers again, and {again}")
        if isinstance(error, CancelledError):
            return OrbitfinderError(f"{self._what}: the scheduler took its work back ({error}); {again}")
        if isinstance(error, ImportError | AttributeError):
            return OrbitfinderError(f"{self._what}: a worker has another orbitfinder ({error}); install this on all of "
                                    f"them, and {again}")  # fmt: skip
        return OrbitfinderError(f"{self._what}: the cluster failed with {type(error).__name__}: {error}; {again}")

    def taken_back(self, futures: Any) -> None:
        """Take back what has not been done."""
        with contextlib.suppress(OSError, TimeoutError, CancelledError):
            self._client.cancel(list(futures), force=True)

    def close(self, futures: Any = ()) -> None:
        """The end of it for us; the cluster stays up for others."""
        self.taken_back(futures)
        self._client.close()


@contextlib.contextmanager
def scheduler_at(address: str | None, what: str, folder: str | Path | None) -> Iterator[Scheduler | None]:
    """The scheduler at an address for as long as a block, or none."""
    if address is None:
        yield None
        return
    with contextlib.closing(Scheduler(address, what, folder)) as made:
        yield made


def listening(address: str | None) -> None:
    """Raises `InputError` unless somebody listens at the address of a scheduler, where there is any."""
    if address is None:
        return
    comm = _distributed().comm
    try:
        host, port = comm.get_address_host_port(address, strict=True)
        socket.create_connection((host, port), CONNECTING).close()
    except (OSError, ValueError) as error:
        raise _nobody(address, error) from error


def _nobody(address: str, error: Exception) -> InputError:
    return InputError(
        f"scheduler: no Dask scheduler answers at {address!r} ({error}); give its address, such as tcp://host:8786"
    )


def _distributed() -> Any:
    try:
        import distributed  # noqa: PLC0415  an extra
    except ImportError as error:
        raise InputError(
            "scheduler: needs Dask; pip install 'orbitfinder[cluster]', or use workers on this machine"
        ) from error
    return distributed
