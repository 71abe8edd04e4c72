"""One problem file from start to finish, and many of them side by side.

Workers are spawned processes that get a path and send back an `Outcome`: CasADi's graphs do not
travel between processes, and IPOPT with MUMPS is not safe in threads.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orbitfinder._runtime import interrupt, processes, streams
from orbitfinder._runtime.limit import limited
from orbitfinder.cli.console import Display, Report
from orbitfinder.cli.options import trusted
from orbitfinder.errors import InputError, LimitError, OrbitfinderError, plural
from orbitfinder.records.certificate import Certificate, certified
from orbitfinder.records.orbit import Orbit, save_orbit
from orbitfinder.records.reading import parted
from orbitfinder.records.registry import kind_of, load, load_orbit, member, taken

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from orbitfinder.loops.ipopt import Progress as Iteration
    from orbitfinder.mechanics.model import Model
    from orbitfinder.problemfile.read import ProblemFile


@dataclass(frozen=True)
class ProblemJob:
    """What to run and where its results go; without what was read, it travels to a worker."""

    file: Path
    name: str
    out: Path
    figures: bool
    trust: bool
    limit: float | None = None
    spent: float = 0.0
    """s of the limit that the reading of the file has taken"""
    loaded: ProblemFile | None = None
    """the file as read in this process"""
    method: str | None = None


@dataclass(frozen=True)
class Outcome:
    """How a problem ended: `status` is certified, rejected (by the checks named in `failures`) or failed."""

    name: str
    file: str
    status: str
    message: str
    wall_time: float
    period: float | None = None
    energy: float | None = None
    closure: float | None = None
    stability: str | None = None
    symmetry: str | None = None
    chosen: dict[str, float] = field(default_factory=dict)
    """the freed physical parameters' values"""
    failures: tuple[str, ...] = ()
    written: tuple[str, ...] = ()
    reduction: str = ""
    """what the orbit is relative in, with the momenta held; or that it is a relative equilibrium"""
    units: dict[str, str] = field(default_factory=dict)
    """words for those of its numbers"""
    remedy: str = ""
    """what to try where it is rejected"""
    moved: float | None = None
    """the largest change of a catalogue's state or period, relative to the largest component or the period"""

    @property
    def passed(self) -> bool:
        """True for a certified orbit."""
        return self.status == "certified"


def prepare(
    files: Sequence[Path], out: Path, figures: bool, trust: bool, limit: float | None = None, method: str | None = None
) -> list[ProblemJob]:
    """Jobs for problem files, everything that can be checked before computing checked."""
    from orbitfinder.problemfile.read import load_problem_file, rows_of

    jobs: dict[str, ProblemJob] = {}
    for file in [row for given in files for row in rows_of(given)]:
        began, loaded, name = time.monotonic(), None, file.stem
        with contextlib.suppress(LimitError), limited(limit):  # the job tells that its time was over
            loaded = load_problem_file(file, trust)
            name = loaded.wanted.name
        if name in jobs:
            raise InputError(f"name: {name!r} is used by both {jobs[name].file} and {file}; rename one of them")
        jobs[name] = ProblemJob(file, name, out, figures, trust, limit, time.monotonic() - began, loaded, method)
    check_writable(out)
    for name in jobs:
        if (out / name).exists():
            check_writable(out / name)
    return list(jobs.values())


def check_writable(folder: Path, option: str = "--out") -> None:
    """`InputError` when files cannot be created in a folder, made if need be; what a command leaves empty goes."""
    context = click.get_current_context(silent=True)
    for made in reversed([parent for parent in (folder, *folder.parents) if context and not parent.exists()]):
        context.call_on_close(partial(_gone_if_empty, made))  # type: ignore[union-attr]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
        raise InputError(
            f"{option}: cannot write in {str(folder)!r} ({reason}); choose a folder that you can write to"
        ) from error


def folder_of(out: Path, name: str, *why: str) -> Path:
    """The folder in --out of what has a name; `InputError` unless it is a name and files can be created there."""
    from orbitfinder.problemfile.read import checked_name

    check_writable(folder := out / checked_name(name, *why))
    return folder


def model_of(record: Any, file: Path, trust: bool) -> Model:
    """The Model of the system of a record that was read from a file; with `trust` modules beside it may make it."""
    from orbitfinder.mechanics.kind import build_model

    return build_model(record.system, trusted(file, trust))


def _gone_if_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()


def run_job(job: ProblemJob, shown: Display | None = None) -> Outcome:
    """Find, certify and write one orbit. Raises `InputError` only; the rest is an Outcome."""
    from orbitfinder._runtime.sizes import relative
    from orbitfinder.atlas.choose import solve
    from orbitfinder.problemfile.read import load_problem_file

    began, system = time.perf_counter(), dict[str, Any]()
    report = None if shown is None else (lambda iteration: shown.show(progress(job.name, iteration, system)))
    try:
        with limited(job.limit, job.spent):
            loaded = job.loaded or load_problem_file(job.file, job.trust)
            problem = replace(loaded.wanted, method=job.method or loaded.wanted.method)
            system.update(problem.model.system)
            orbit = solve(problem, loaded.starts, loaded.seed, report)
    except InputError:
        raise
    except OrbitfinderError as error:
        return Outcome(job.name, str(job.file), "failed", one_line(error), time.perf_counter() - began)
    try:
        outcome, guess = _written(job, orbit, problem.model, began), problem.guess
        if not parted(job.file)[1]:
            return outcome
        off = relative(orbit.period - guess.period, guess.period) if guess.period else 0.0
        return replace(outcome, moved=max(relative(orbit.state - guess.start, guess.start), off))
    except OSError as error:
        raise InputError(
            f"--out: cannot write in {job.out / job.name} ({error}); free some space or choose another folder"
        ) from error


def progress(name: str, iteration: Iteration, system: Mapping[str, Any]) -> Report:
    """One step of a search."""
    from orbitfinder.mechanics.scales import lasting

    at, defect, period = iteration, f"{iteration.defect:.2e}", lasting(iteration.period, system, 9)
    line = f"{name}: {at.stage} {at.iteration}, defect {defect}, period {period}, {at.elapsed:.1f} s elapsed"
    return Report(line, [
        ("problem", "stage", "iteration", "defect", "period", "elapsed (s)"),
        (name, at.stage, str(at.iteration), defect, period, f"{at.elapsed:.1f}"),
    ])  # fmt: skip


def _written(job: ProblemJob, orbit: Orbit, model: Model, began: float) -> Outcome:
    """Write the result under the name it deserves; figures only of certified orbits."""
    from orbitfinder.mechanics.kind import with_parameters
    from orbitfinder.mechanics.scales import units
    from orbitfinder.orbits.method import named
    from orbitfinder.orbits.reduction import reduction

    certificate, folder = orbit.certificate, job.out / job.name
    passed = certified(orbit)
    written = [save_orbit(orbit, folder / ("orbit.json" if passed else "rejected.json"))]
    if passed:
        for stale in ("rejected.json", "rejected.npz"):
            (folder / stale).unlink(missing_ok=True)
        if job.figures:
            from orbitfinder.show.plot import save_figures

            written += save_figures(orbit, folder, model)
    failures = certificate.failures if certificate else ("no certificate",)
    remedy = "" if passed or not (by := orbit.provenance.get("method")) else named(by).remedy
    if "distance" in failures and not orbit.system.get("invariants"):
        remedy = remedy or "a multiplier too near 1 leaves it open: declare what is conserved in [system.invariants]"
    among, made = "", orbit.provenance.get("choice")
    if made:
        among = (
            f", the least unstable of {plural(made['orbits'], 'orbit')} found from {plural(made['starts'], 'start')}"
        )
    return Outcome(
        orbit.name, str(job.file), "certified" if passed else "rejected",
        f"certified{among}" if passed else f"not an orbit: {explained(certificate)}",
        time.perf_counter() - began,
        orbit.period, orbit.energy if orbit.energy == orbit.energy else None, orbit.closure, orbit.stability,
        orbit.symmetry,
        dict(orbit.provenance.get("free", {})), failures,
        tuple(str(path) for path in written),
        reduction(with_parameters(model, orbit.provenance.get("free", {})), orbit), units(orbit.system), remedy,
    )  # fmt: skip


def explained(certificate: Certificate | None) -> str:
    """The failing checks of a certificate with their numbers."""
    failing = [check for check in certificate.checks if not check.passed] if certificate else []
    return "; ".join(
        f"check {check.name} failed ({check.value:.3g}, allowed {check.tolerance:.3g}"
        + (f", {one_line(check.note)})" if check.note else ")")
        for check in failing
    )


def orbit_and_model(
    file: Path, trust: bool = False, pictured: bool = False, read: Callable[[Path], Any] = load_orbit
) -> tuple[Any, Model]:
    """The orbit of FILE or FILE#K, whose entries belong together, and its system's model; the way in of every command.

    `pictured`: with samples, also where an orbit of a file has none of its own. `read=load`: whatever record it is.
    `InputError` names the file.
    """
    from orbitfinder.families.equilibrium import Equilibria
    from orbitfinder.families.members import whole
    from orbitfinder.mechanics.model import check_state

    try:
        record = read(file)
        model: Any = model_of(record, file, trust) if hasattr(record, "system") else None  # it may be of no system
        names = tuple(getattr(record, "state_names", ()))
        if model is not None and names and names != model.state_names:
            raise InputError(f"state_names: {', '.join(names)} are not those of its system, "
                             f"{', '.join(model.state_names)}; the file was edited, make it again")  # fmt: skip
        if isinstance(record, Equilibria):
            check_state(model, record.points[0].state)
        if isinstance(record, Orbit):
            check_consistent(record, model)
            record = whole(record, model) if pictured and not file.exists() else record
    except InputError as error:
        raise error if str(file).split("#")[0] in str(error) else InputError(f"{file}: {error}") from error
    return record, model


def whole_family(file: Path) -> bool:
    """Whether a file is a family.json, and not FILE#K."""
    return file.suffix == ".json" and member(file)[1] is None and kind_of(file) == "family"


def named_orbits(
    files: Sequence[Path], trust: bool, pictured: bool = True, verb: str = "", out: Path | None = None
) -> list[tuple[Path, Any, Model]]:
    """What a command works on: all read, and named as files may be, before anything is written.

    Orbits, or what a `verb` takes. `InputError` for anything else, and for two of a name that go to the same folder,
    which is `out` or that of their file.
    """
    from orbitfinder.problemfile.read import checked_name

    records, seen = list[tuple[Path, Any, "Model"]](), dict[tuple[Path, str], Path]()
    for file in files:
        if verb:
            taken(verb, file)
        record, model = orbit_and_model(file, trust, pictured, load if verb else load_orbit)
        checked_name(record.name, f"{file}: name")
        if (other := seen.setdefault((out or file.parent, record.name), file)) != file:
            raise InputError(f"--out: {other} and {file} are both named {record.name!r}; give them one at a time")
        records.append((file, record, model))
    return records


def check_consistent(orbit: Orbit, model: Model) -> None:
    """`InputError` when the entries of an orbit do not belong together; a certificate is about those that do."""
    import numpy as np

    from orbitfinder.mechanics.model import counted

    size, n = len(model.state_names), model.degrees_of_freedom
    again = "the file was edited or damaged, run the problem again"
    if orbit.state.shape != (size,) or len(orbit.winding) != n:
        sizes = f"{plural(orbit.state.size, 'number')} in state and {len(orbit.winding)} in winding"
        raise InputError(f"state: {sizes} for a system of {counted(model)}; {again}")
    if np.abs(orbit.state).max() > 1e100:  # rad or rad/s; beyond it energies overflow
        raise InputError(f"state: {orbit.state.tolist()} is beyond 1e+100; {again}")


def one_line(text: object) -> str:
    """A message without line breaks or control characters."""
    return "".join(letter if letter.isprintable() else " " for letter in " ".join(str(text).split()))


def run_jobs(jobs: Sequence[ProblemJob], workers: int, shown: Display) -> Iterator[Outcome]:
    """Outcomes in the order in which they come, from this process or from spawned ones."""
    if workers == 1 or len(jobs) == 1:
        for job in jobs:
            yield run_job(job, shown)
        return
    hands, todo = list[processes.Hand](), list(jobs)
    doing: dict[processes.Hand, ProblemJob] = {}
    try:
        while todo or doing:
            while todo and len(doing) < workers:
                hand = next((free for free in hands if free not in doing), None) or processes.hired(_serve)
                hands += [] if hand in hands else [hand]
                doing[hand] = todo.pop(0)
                hand.tell(replace(doing[hand], loaded=None, spent=0.0))
            for hand in processes.ready(doing):
                job, answer = doing.pop(hand), hand.answer()
                if answer is None:
                    hands.remove(hand)
                    answer = Outcome(job.name, str(job.file), "failed", "the process that worked on it died", 0.0)
                if isinstance(answer, InputError):
                    raise answer
                yield answer
    finally:
        processes.dismissed(hands)


_stopped: list[int] = []
"""In a worker: the signals by which the parent has told it to stop."""


def _stop(number: int, _: object) -> None:
    if _stopped:
        os._exit(128 + number)
    _stopped.append(number)
    raise SystemExit(128 + number)


def _serve(pipe: Connection) -> None:
    """The life of a worker: jobs until the pipe is closed; told to stop, it cleans up after itself."""
    import signal

    signal.signal(signal.SIGTERM, _stop)
    streams.leave_current_folder_out()
    with contextlib.suppress(EOFError), interrupt.unheard():
        while not _stopped:
            pipe.send(_work(pipe.recv()))


def _work(job: ProblemJob) -> Outcome | InputError:
    """`run_job` in a worker; once told to stop it takes no further job, whatever became of the exception."""
    try:
        return run_job(job)
    except InputError as error:
        return error
    finally:
        if _stopped:
            os._exit(128 + _stopped[0])
