"""From a problem file (TOML, or trusted Python) to a Problem; every mistake is one sentence.

The tables and keys are in `schema.py`; this module reads the file, says what is wrong with it,
and builds the Model, the Guess and the Problem.
"""

from __future__ import annotations

import runpy
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError, plural
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.problemfile.guess import guess_from_table
from orbitfinder.problemfile.schema import SYSTEMS, FindTable, ProblemTable, Table, check_name, sentence
from orbitfinder.records.orbit import SHIFT
from orbitfinder.records.reading import bounded, file_bytes

LARGEST_TOML = 5_000_000
"""Bytes; a larger problem file is refused before it is read (2,000 links with a number each take 0.1 MB)."""
MANUAL = "docs/problem-file.md"
DEFAULT_DURATION = 10.0
"""Seconds that `simulate` covers when nothing else is asked for."""


@dataclass(frozen=True)
class ProblemFile:
    """A problem file that has been read: its path, its tables and what they stand for.

    `problem` is None when the file has no `[guess]`; `search` is the range of periods in s;
    `duration` (s) and `start` (2n) are what `simulate` uses; `starts` and `seed` what a choice among
    separate orbits uses.
    """

    __repr__ = brief("path", "name", "model")

    path: Path
    name: str
    model: Model
    problem: Problem | None
    document: Mapping[str, Any] = field(default_factory=dict)
    search: tuple[float, float] | None = None
    duration: float = DEFAULT_DURATION
    start: np.ndarray | None = None
    starts: int = 200
    seed: int = 0

    @property
    def wanted(self) -> Problem:
        """The Problem; `InputError` when the file has no guess."""
        if self.problem is None:
            raise InputError(
                f"{self.path}: guess: missing; add a [guess] table with state and period, mode and amplitude, or csv"
            )
        return self.problem


def load_problem(path: str | Path, trust: bool = False) -> Problem:
    """The Problem of a file. Raises `InputError`; Python files are executed only with `trust`."""
    return load_problem_file(path, trust).wanted


def load_problem_file(path: str | Path, trust: bool = False) -> ProblemFile:
    """A problem file with everything in it (see `ProblemFile`). Raises `InputError`."""
    source = Path(path)
    if source.suffix == ".py":
        return _load_python(source, trust)
    document = read_toml(source)
    table = parse(document, str(source))
    with _located(source):
        return _build(source, document, table, trust)


def read_toml(source: Path) -> dict[str, Any]:
    """The TOML document at a path, or `InputError`."""
    data = file_bytes(source, "problem file", LARGEST_TOML)
    try:
        document = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{source}: not UTF-8 text (byte {error.start}); save it as UTF-8, or give a problem file"
        ) from error
    except ValueError as error:  # TOMLDecodeError, or what Python says of numbers of thousands of digits
        if source.suffix == ".json":
            raise InputError(
                f"{source}: not a problem file; orbits and families go to verify, continue, plot, animate or export"
            ) from error
        raise InputError(f"{source}: not TOML: {error}; see {MANUAL} for the format") from error
    except RecursionError as error:
        raise InputError(f"{source}: nested too deeply to be a problem file; see {MANUAL}") from error
    return bounded(document, str(source), f"see {MANUAL}", finite=False)  # type: ignore[no-any-return]


def parse(document: Mapping[str, Any], where: str) -> ProblemTable:
    """The checked tables of a document; `InputError` is about the first thing that is wrong."""
    try:
        declares = isinstance(system := document.get("system"), Mapping) and system.get("kind") == "python"
        return ProblemTable.model_validate(document, context={"declares": declares})
    except ValidationError as error:
        faults = error.errors(include_url=False)
        first = min(faults, key=lambda fault: fault["type"] != "extra_forbidden")
        more = f" ({len(faults) - 1} more after this)" if len(faults) > 1 else ""
        raise InputError(f"{where}: {sentence(first, document)}{more}") from None


@contextmanager
def _located(source: Path) -> Iterator[None]:
    """The file, and the table where the field alone is named, in front of the errors of the block."""
    try:
        yield
    except InputError as error:
        tables: dict[str, tuple[type[Table], ...]] = {"system": tuple(SYSTEMS.values()), "find": (FindTable,)}
        within = (f"{name}." for name, kinds in tables.items() if any(error.field in one.model_fields for one in kinds))
        raise type(error)(f"{source}: {next(within, '')}{error}") from error


def _build(source: Path, document: Mapping[str, Any], table: ProblemTable, trust: bool) -> ProblemFile:
    name = table.name or checked_name(source.stem)
    model = build_model(table.system.model_dump(exclude_none=True), source.parent if trust else None)
    problem = None
    if table.guess is not None:
        problem = _problem(name, model, guess_from_table(table.guess, model, source.parent), table)
        problem.check_count()
    return ProblemFile(
        path=source,
        name=name,
        model=model,
        problem=problem,
        document=document,
        search=(table.search.period[0], table.search.period[1]) if table.search else None,
        duration=table.simulate.duration or DEFAULT_DURATION,
        start=_start(table, model, problem),
        starts=table.find.starts,
        seed=table.find.seed,
    )


def _problem(name: str, model: Model, guess: Guess, table: ProblemTable) -> Problem:
    find = table.find
    return Problem(
        model=model,
        guess=guess,
        pin=pin(**(find.pin or {})),
        symmetry=find.symmetry,
        winding=None if find.winding is None else tuple(find.winding),
        relative=tuple(find.relative),
        segments=find.segments,
        tolerance=find.tolerance,
        free=tuple(find.free),
        objective=find.objective,
        coordinate=find.coordinate,
        bounds={key: (float(low), float(high)) for key, (low, high) in find.bounds.items()},
        expected=_expected(table, model),
        name=name,
        title=table.title,
        source=table.source,
    )


def _expected(table: ProblemTable, model: Model) -> dict[str, tuple[float, float]]:
    """Known numbers by name, physical parameters among them."""
    numbers = table.expected.model_dump(exclude_none=True)
    parameters = numbers.pop("parameters", {})
    shifts = {f"{SHIFT}{name}": number for name, number in numbers.pop("shift", {}).items()}
    if unknown := set(table.expected.shift) - set(table.find.relative):
        raise InputError(f"expected.shift: {sorted(unknown)[0]!r} is not in find.relative, which is what shifts")
    for name in parameters:
        if name not in model.parameter_names:
            known = ", ".join(model.parameter_names[:12])
            raise InputError(f"expected.parameters: unknown {name!r}; this system has {known}")
    return {
        key: (float(number["value"]), float(number["tolerance"]))
        for key, number in (numbers | parameters | shifts).items()
    }


def _start(table: ProblemTable, model: Model, problem: Problem | None) -> np.ndarray | None:
    if table.simulate.state is None:
        return None if problem is None else np.asarray(problem.guess.state, float)
    size = len(model.state_names)
    if len(table.simulate.state) != size:
        raise InputError(
            f"simulate.state: {plural(len(table.simulate.state), 'number')} for {plural(size // 2, 'coordinate')}; "
            f"give {size} (angles, then rates)"
        )
    return np.asarray(table.simulate.state, float)


def checked_name(name: str, where: str = "name", remedy: str = "rename it or give a name") -> str:
    """A name that is safe as a folder, or `InputError`."""
    try:
        return check_name(name)
    except PydanticCustomError as error:
        raise InputError(f"{where}: {error.message()}, got {name!r}; {remedy}") from error


def _load_python(source: Path, trust: bool) -> ProblemFile:
    """A Python problem file: executed, so only for files the user vouches for."""
    if not trust:
        raise InputError(
            f"{source}: a Python problem file runs as a program and {'was' if source.exists() else 'would be'} "
            "not executed; read it, then add --trust (in Python trust=True)"
        )
    file_bytes(source, "problem file")
    try:
        made = runpy.run_path(str(source))["problem"]()
    except KeyError as error:
        raise InputError(f"{source}: problem: missing ({error}); define a function problem() in it") from error
    except Exception as error:
        raise InputError(f"{source}: problem() failed with {type(error).__name__}: {error}; fix the file") from error
    if not isinstance(made, Problem):
        raise InputError(f"{source}: problem() returned {type(made).__name__}; return an orbitfinder Problem")
    with _located(source):
        checked_name(made.name)
        made.check_count()
    return ProblemFile(source, made.name, made.model, made, start=made.guess.state)
