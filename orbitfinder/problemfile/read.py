"""From a problem file (TOML, or trusted Python) to a Problem; every mistake is a sentence.

The tables and keys are in `schema.py`; this module reads the file, says what is wrong with it,
and builds the Model, the Guess and the Problem.
"""

from __future__ import annotations

import csv
import math
import runpy
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError, LimitError, closest, plural
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.control import Control, Task
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import declared, with_mirrors
from orbitfinder.mechanics.constrained import maximal_states
from orbitfinder.mechanics.kind import (
    OTHER,
    PROBLEM,
    build_model,
    described,
    loops_of,
    neighbours,
    system_kind,
    with_parameters,
)
from orbitfinder.mechanics.model import Model, constraint_of
from orbitfinder.mechanics.scales import with_units
from orbitfinder.mechanisms.robot import robot
from orbitfinder.orbits.guesses.linear import linear_response
from orbitfinder.orbits.guesses.modes import normal_mode, rest_near
from orbitfinder.orbits.guesses.returns import first_return, normal_mode_sum, recurrences
from orbitfinder.problemfile.sbml import sbml_document
from orbitfinder.problemfile.schema import (
    ControlTable,
    FindTable,
    GuessTable,
    ProblemTable,
    Table,
    check_name,
    sentence,
    systems,
)
from orbitfinder.problemfile.xpp import xpp_document
from orbitfinder.records.codec import outline
from orbitfinder.records.orbit import SHIFT
from orbitfinder.records.reading import Entries, bounded, file_beside, file_bytes, parted

MANUAL, TOML, MOST_ROWS = "docs/problem-file.md", ".toml", 1000


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
    duration: float = 10.0
    start: np.ndarray | None = None
    starts: int = 200
    seed: int = 0

    @property
    def title(self) -> str:
        """One line for people, where the file has it."""
        return self.problem.title if self.problem else str(self.document.get("title", ""))

    @property
    def facts(self) -> Entries:
        """What is understood of it, before anything is computed."""
        model, system = self.model, self.model.system or {}
        facts: Entries = outline({
            "title": self.title, "system": system_kind(system).words(system), "states": list(model.state_names),
            "parameters": dict(zip(model.parameter_names, model.parameter_values.tolist(), strict=True)),
            "forced": model.forced, "events": [each.name for each in model.hybrid.transitions] if model.hybrid else [],
            "invariants": [each.name for each in model.invariants],
            "symmetries": {each.name: each.in_words(model.coordinates) for each in declared(with_mirrors(model))},
            "rates": system.get("rates", {}),
            "left_out": system.get("left_out", []), "start": self.start,
        })  # fmt: skip
        return facts

    @property
    def wanted(self) -> Problem:
        """The Problem; `InputError` when the file has no guess."""
        if self.problem is None:
            if self.document.get("guess"):
                raise InputError(f"{self.path}: guess: state goes with period; alone it is where `equilibria` starts")
            raise InputError(
                f"{self.path}: guess: missing; add a [guess] table with state and period, mode and amplitude, or csv"
            )
        return self.problem


def load_problem(path: str | Path, trust: bool = False) -> Problem:
    """The Problem of a problem file.

    Args:
        path: a .toml file, or a .py file that defines `problem()`.
        trust: whether Python may be executed: that file, and functions that a .toml file names.

    Returns:
        A Problem.

    Raises:
        InputError: naming file, field, value and remedy.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("swing.toml").write_text('''
        ... system = { kind = "chain", links = 1 }
        ... guess = { state = [2.0, 0.0], period = 2.2 }
        ... ''')
        >>> of.find_orbit(of.load_problem("swing.toml")).certificate.passed
        True
    """
    return load_problem_file(path, trust).wanted


def load_problem_file(path: str | Path, trust: bool = False) -> ProblemFile:
    """A problem file with everything in it (see `ProblemFile`); FILE#NAME a row of its catalogue, else the first;
    FILE.ode#time=T0 and FILE.ode#period=T what `of.from_xpp` takes. Raises `InputError`."""
    source, row = parted(path)
    if row and source.suffix == ".ode":
        document, row = xpp_document(source, **_xpp_options(row, path)), ""
    elif row and source.suffix != TOML:
        raise InputError(f"{path}: only a {TOML} file has a catalogue with rows; give {source} alone")
    elif source.suffix == ".py":
        return _load_python(source, trust)
    else:
        others = {".ode": xpp_document, ".xml": sbml_document, ".sbml": sbml_document}
        document = others.get(source.suffix, read_toml)(source)
    table = parse(document, str(source))
    with _located(source):
        return _build(source, document, table, trust, row)


def _xpp_options(words: str, path: str | Path) -> Entries:
    name, _, value = words.partition("=")
    with suppress(ValueError):
        if (name == "period" and value) or (name == "time" and math.isfinite(float(value))):
            return {name: float(value) if name == "time" else value}
    raise InputError(f"{path}: {words!r} after the name; give #time=NUMBER or #period=NUMBER")


def rows_of(file: Path) -> list[Path]:
    """FILE#NAME of all rows of a problem file's catalogue, else the file. Raises `InputError`."""
    if file.suffix != TOML:
        return [file]
    guess = read_toml(file).get("guess")
    name = guess.get("catalogue") if isinstance(guess, dict) else None
    if not isinstance(name, str):
        return [file]
    with _located(file):
        return [Path(f"{file}#{row}") for row in read_catalogue(file.parent, name)]


def read_toml(source: Path) -> Entries:
    """The TOML document at a path, or `InputError`."""
    data = file_bytes(source, "problem file", limit=5_000_000)  # 2,000 links with a number each take 0.1 MB
    try:
        document = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        if data.startswith(b"SQLite format 3"):
            raise InputError(f"{source}: an atlas database; give one orbit of it by its id: {source}#1") from error
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
    """The checked tables of a document; `InputError` is about all that is wrong, unknown keys last."""
    try:
        return ProblemTable.model_validate(document)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        faults.sort(key=lambda fault: fault["type"] == "extra_forbidden")
        said = list(dict.fromkeys(sentence(fault, document) for fault in faults))
        more = f" ({len(said) - 5} more after this)" if len(said) > 5 else ""
        raise InputError(f"{where}: {'; also '.join(said[:5])}{more}") from None


@contextmanager
def _located(source: Path) -> Iterator[None]:
    """The file, and the table where the field alone is named, in front of the errors of the block."""
    try:
        yield
    except InputError as error:
        tables: dict[str, tuple[type[Table], ...]] = {"system": tuple(systems().values()), "find": (FindTable,)}
        known = {name: {field for table in several for field in table.model_fields} for name, several in tables.items()}
        within = (f"{name}." for name, fields in known.items() if error.field in fields)
        raise type(error)(f"{source}: {next(within, '')}{error}") from error


def _build(source: Path, document: Mapping[str, Any], table: ProblemTable, trust: bool, row: str = "") -> ProblemFile:
    name = table.name or checked_name(source.stem)
    system = table.system.model_dump(exclude_none=True)
    system = system_kind(system).with_content(system, source.parent)
    if "file" in system:
        options = {key: value for key, value in system.items() if key not in ("kind", "file")}
        model = robot(source.parent / system["file"], **options)
    else:
        model = build_model(system, source.parent if trust else None)
    model, problem = with_units(model, table.units), None
    start = table.guess
    if start and start.catalogue is not None:
        rows = read_catalogue(source.parent, start.catalogue)
        row = row or next(iter(rows))
        name, (model, start) = f"{name}-{row}", _catalogued(rows, row, model, start)
    elif row:
        raise InputError(f"guess.catalogue: missing, so there is no row {row!r}; give {source} alone")
    # a state alone is what equilibria start from: no period is given and nothing drives it
    if start and not (start.state is not None and start.period is start.duration is model.forcing_period is None):
        guess = replace(guess_from_table(start, model, source.parent), free=start.free)
        find: Entries = {key: tuple(value) if isinstance(value, list) else value for key, value in table.find}
        find |= {"pin": pin(**(find["pin"] or {})), "bounds": {key: (*ends,) for key, ends in find["bounds"].items()}}
        problem = Problem(
            model, guess, **{key: value for key, value in find.items() if key not in ("starts", "seed")},
            expected=_expected(table, model), control=_control(table.control), watch=table.watch, name=name,
            title=table.title, source=table.source,
        )  # fmt: skip
        problem.check_count()
    return ProblemFile(
        source, name, model, problem, document,
        search=(table.search.period[0], table.search.period[1]) if table.search else None,
        duration=table.simulate.duration or ProblemFile.duration, start=_start(table, model, problem),
        starts=table.find.starts, seed=table.find.seed,
    )  # fmt: skip


def _catalogued(
    rows: Mapping[str, Mapping[str, float]], row: str, model: Model, start: GuessTable
) -> tuple[Model, GuessTable]:
    """The model and the guess of a row of a catalogue."""
    if row not in rows:
        raise InputError(f"guess.catalogue: no row {row!r}{closest(row, rows)}; it has {', '.join([*rows][:20])}")
    values = dict(rows[row])
    period, known = values.pop("period", None), (*model.state_names, *model.parameter_names)
    if unknown := [name for name in values if name not in known]:
        hint = closest(unknown[0], known)
        raise InputError(
            f"guess.catalogue: column {unknown[0]!r} is unknown{hint}; use name, period, {', '.join(known)}"
        )
    state = [values.pop(name, 0.0) for name in model.state_names]
    if not (period or 0.0) > 0 and model.forcing_period is None:
        raise InputError(f"guess.catalogue: row {row!r} has no period; add a column period in s")
    model = with_parameters(model, values) if values else model
    return model, start.model_copy(update={"catalogue": None, "state": state, "period": period})


def _control(table: ControlTable | None) -> Control | None:
    """How controls are chosen."""
    if table is None:
        return None
    tasks = tuple(Task(**task.model_dump(exclude_none=True)) for task in table.task)
    return Control(**{key: value for key, value in table if key != "task"}, tasks=tasks)


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
    where, state, size = "simulate.state", table.simulate.state, len(model.state_names)
    if state is None and problem is None and table.guess is not None:
        where, state = "guess.state", table.guess.state
    if state is None:
        return None if problem is None else problem.guess.start
    if len(state) != size:
        raise InputError(
            f"{where}: {plural(len(state), 'number')} for {plural(size // 2, 'coordinate')}; "
            f"give {size} (angles, then rates)"
        )
    return np.asarray(state, float)


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
        with neighbours(source.parent):
            made = runpy.run_path(str(source))[PROBLEM]()
    except KeyError as error:
        raise InputError(f"{source}: problem: missing ({error}); define a function problem() in it") from error
    except LimitError:
        raise
    except Exception as error:
        raise InputError(f"{source}: problem() failed with {type(error).__name__}: {error}; fix the file") from error
    if not isinstance(made, Problem):
        raise InputError(f"{source}: problem() returned {type(made).__name__}; return an orbitfinder Problem")
    with _located(source):
        checked_name(made.name)
        made.check_count()
    if system_kind(made.model.system) is OTHER and source.stem.isidentifier():
        made = replace(made, model=replace(made.model, system=described(made.model.system, source.stem, PROBLEM)))
    return ProblemFile(source, made.name, made.model, made, start=made.guess.state)


# --------------------------------------------------------------------------------------------------
# The `[guess]` table of a problem file as a Guess: a state, modes, a simulation, a linkage's angles, a CSV file.


def guess_from_table(given: GuessTable, model: Model, folder: Path) -> Guess:
    """The starting point that a table stands for; `folder` is where its CSV file may be."""
    loops, state = loops_of(model.system), np.asarray(given.state or [], float)
    looped = model.constraint is not None or (system_kind(model.system).drawn and given.angles is not None)
    looped &= loops.minimal is not None
    forced = None if model.forcing_period is None else model.driving_period
    linkage_keys = [key for key in ("angles", "branch", "rates") if getattr(given, key) is not None]
    if linkage_keys and not looped:
        raise InputError(
            f"guess.{linkage_keys[0]}: is for linkages and mechanisms only; give state and period, mode or csv"
        )
    if given.csv is not None:
        return read_trajectory(folder, given.csv, len(model.state_names), not model.smooth, model.controls)
    if given.linear:
        return linear_response(model)
    if given.mode is not None and given.amplitude is not None:
        if isinstance(given.mode, int) and isinstance(given.amplitude, float):
            return normal_mode(model, given.mode, given.amplitude, _rest(model, given.equilibrium))
        if looped or model.rates is not None:
            what = "linkage" if looped else "first-order system"
            raise InputError(f"guess.mode: a {what} takes one mode with one amplitude; give numbers, not lists")
        modes = given.mode if isinstance(given.mode, list) else [given.mode]
        sizes = given.amplitude if isinstance(given.amplitude, list) else [given.amplitude]
        return normal_mode_sum(model, modes, sizes)
    if looped:
        if given.angles is not None:
            state = loops.state(model, given.angles, given.rates, branch=given.branch)
        elif constraint_of(model).lift is not None and state.size == 2 * (model.degrees_of_freedom // 3):
            state = maximal_states(model, state)
        return Guess(state, given.period or forced or first_return(model, state, given.duration))
    if given.duration is None:
        return Guess(state, float(given.period or forced or 0.0))
    passes = recurrences(model, state, given.duration, 1)
    if not passes:
        raise InputError(
            f"guess.duration: the motion never came back near itself in {given.duration:g} s; simulate longer"
        )
    return passes[0].guess


def _rest(model: Model, named: list[float] | str | None) -> np.ndarray | None:
    """The equilibrium at a landmark or near a place, None where none is given."""
    if named is None or not isinstance(named, str):
        return None if named is None else rest_near(model, named)
    if named not in model.landmarks:
        known = ", ".join(model.landmarks) or "none, give coordinates"
        raise InputError(f"guess.equilibrium: unknown {named!r}; the landmarks of this system are {known}")
    return rest_near(model, model.landmarks[named])


def read_catalogue(folder: Path, name: str) -> dict[str, dict[str, float]]:
    """The rows of a CSV file in `folder` or below by name, or by number where no column is `name`, by column."""
    lines = [line for line in _lines(folder, name, "guess.catalogue") if line.strip() and not line.startswith("#")]
    header, rows = [*map(str.strip, next(csv.reader(lines), []))], dict[str, dict[str, float]]()
    if twice := [column for column in header if header.count(column) > 1]:
        raise InputError(f"guess.catalogue: {name!r} has two columns {twice[0]!r}; rename the second")
    for number, entries in enumerate(csv.reader(lines[1:]), start=1):
        where = f"guess.catalogue: {name!r} row {number}"
        if len(entries) != len(header):
            raise InputError(f"{where}: {plural(len(entries), 'column')}; give {len(header)}, as the header names")
        values = dict(zip(header, map(str.strip, entries), strict=True))
        row = checked_name("-".join(values.pop("name", str(number)).split()), where, "rename it")
        if row in rows:
            raise InputError(f"{where}: a second {row!r}; rename it")
        try:
            rows[row] = {column: float(value) for column, value in values.items()}
        except ValueError as error:
            raise InputError(f"{where}: {error}; give numbers separated by commas") from error
        if not np.isfinite([*rows[row].values()]).all():
            raise InputError(f"{where} must be finite; replace NaN and infinity by numbers")
    if len(rows) > MOST_ROWS:
        raise InputError(f"guess.catalogue: {name!r} has {len(rows)} rows, the limit is {MOST_ROWS}; divide it")
    if not rows:
        raise InputError(f"guess.catalogue: {name!r} has no rows; give a header and a row for each orbit")
    return rows


def _lines(folder: Path, name: str, where: str) -> list[str]:
    """The lines of a CSV file that the field `where` names."""
    source = file_beside(folder, name, where)
    try:
        return file_bytes(source, "CSV file", 20_000_000).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: {name!r} is not UTF-8 text; save it as plain CSV") from error
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def read_trajectory(
    folder: Path, name: str, size: int, events: bool = False, controls: Sequence[str] = ()
) -> Guess:  # fmt: skip
    """A Guess from a CSV file in `folder` or below: columns t (twice at `events`) and `size` states, over a period; and
    `controls`, where the header names them, which are not read."""
    lines = _lines(folder, name, "guess.csv")
    if controls and lines and lines[0].replace(" ", "").endswith(f",{','.join(controls)}"):
        lines = [line.rsplit(",", len(controls))[0] for line in lines]
    table = _numbers(name, lines, size, events)
    times = table[:, 0] - table[0, 0]
    return Guess(table[0, 1:].copy(), float(times[-1]), times, table[:, 1:])


def _numbers(name: str, lines: list[str], size: int, events: bool) -> np.ndarray:
    rows = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            row = [*map(float, line.split(","))]
        except ValueError as error:
            if number == 1:
                continue
            raise InputError(f"guess.csv: {name!r} line {number}: {error}; give numbers separated by commas") from error
        if len(row) != size + 1:
            raise InputError(
                f"guess.csv: {name!r} line {number}: {plural(len(row), 'column')}; give {size + 1} (t, then states)"
            )
        rows.append(row)
    table = np.asarray(rows, float)
    if len(rows) < 2:
        raise InputError(
            f"guess.csv: {name!r} has {plural(len(rows), 'row')} of numbers; give one period with at least 2"
        )
    if not np.all(np.isfinite(table)):
        raise InputError(f"guess.csv: {name!r} must be finite; replace NaN and infinity by numbers")
    if np.any((spans := np.diff(table[:, 0])) < 0) or (np.any(spans == 0) and not events):
        raise InputError(f"guess.csv: {name!r}: times must increase from row to row; sort them")
    return table
