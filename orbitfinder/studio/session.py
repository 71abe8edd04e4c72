"""What one tab of the studio holds: a system, where its motion starts, what was found, and how to find it again.

Every result is written at once to the session's folder, by the same tasks as the commands, with a note of what it
came from: all tabs of a studio share it, and a studio that begins again, as after a crash, finds it there. Saving
copies it, whole files at a time, under names that nobody else has.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.locks import held
from orbitfinder.atlas.report import summarise
from orbitfinder.atlas.store import Atlas, AtlasRow
from orbitfinder.errors import InputError, plural
from orbitfinder.families.branches import left_at
from orbitfinder.families.minimal import minimal_problem
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.kind import build_model, loops_of, system_kind
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import lasting, unit_along
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.guesses.modes import normal_modes
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.problemfile.write import entries, orbit_text, toml
from orbitfinder.records.family import JOURNAL, Family, load_family, read_journal, save_family
from orbitfinder.records.family import assemble as assembled
from orbitfinder.records.orbit import Orbit, orbit_to_document
from orbitfinder.records.reading import Entries, file_bytes, json_file, read_as, write_atomically, write_json
from orbitfinder.records.registry import kind_of, load_orbit, member, taken
from orbitfinder.site.text import mechanism

SWINGS = 8.0
"""Periods of the slowest swing, or of the guess, that a simulation covers unless something else is asked for"""
DURATION = 20.0
"""s, where neither is known"""
AGAIN = "again"
"""Folder that the command lines which repeat the work write to"""
REFERENCE = re.compile(r'(?m)^(\s*(?:file|csv)\s*=\s*)"([^"\n]+)"')
"""Files that a problem file names: a robot's description, a trajectory"""


@dataclass(frozen=True)
class Opened:
    """What a FILE brings: a Model, a state (d), a duration (s), the orbit or family in it, a problem's own text."""

    model: Model
    state: np.ndarray
    duration: float
    name: str
    guess: tuple[float, str] | None = None
    """the period (s) that a problem file guesses, and its text"""
    orbit: Path | None = None
    family: Path | None = None
    atlas: Path | None = None

    @property
    def word(self) -> str:
        """Its name as files may be called."""
        return re.sub(r"[^A-Za-z0-9_-]+", "-", self.name).strip("-") or "orbit"


def opened(file: Path | None) -> Opened:
    """A problem file, orbit.json, family.json, atlas or FILE#K; without one a double pendulum. Raises `InputError`."""
    if file is None:
        return _hanging(chain(2), "double-pendulum", None)
    if file.suffix == ".py":
        raise InputError(f"{file}: the studio runs no Python files; give a TOML file, an orbit.json or a family.json")
    if member(file)[0].suffix == ".json" or kind_of(member(file)[0]) == "atlas":
        field = str(taken("studio", file))
        if field == "family":
            family = load_family(file)
            orbit: Orbit = family.points[0]
            name = family.name
        else:
            orbit = load_orbit(file if field == "orbit" else f"{file}#{_rows(file)[0].id}")
            name = orbit.name if field == "orbit" else file.stem
        place: Entries = {field: file}
        return Opened(build_model(orbit.system), orbit.state, SWINGS * orbit.period, name, **place)
    loaded = load_problem_file(file)
    build_model(loaded.model.system)  # as every process of the studio does; it says why where that cannot be
    if loaded.problem is None:
        start = None if loaded.start is None else np.asarray(loaded.start, float)
        return _hanging(loaded.model, loaded.name, start)
    problem = minimal_problem(loaded.problem) if loaded.model.constraint is not None else loaded.problem
    text = REFERENCE.sub(
        lambda at: f"{at[1]}{toml(str((file.parent / at[2]).resolve()))}", file_bytes(file).decode("utf-8-sig")
    )
    period = float(problem.guess.period)
    return Opened(problem.model, problem.guess.start, SWINGS * period, loaded.name, (period, text))


def _rows(atlas: Path) -> list[AtlasRow]:
    """The orbits of an atlas, in the order in which they were found. Raises `InputError` where there are none."""
    with Atlas(atlas) as book:
        rows = book.rows(order="id")
    if not rows:
        raise InputError(f"{atlas}: the atlas is empty; search into it first")
    return rows


def _hanging(model: Model, name: str, state: np.ndarray | None) -> Opened:
    """A system without a guess: from a state, or somewhere near where it starts by itself."""
    if model.constraint is not None:
        if state is None:  # put together somewhere
            loops = loops_of(model.system)
            if loops.minimal is None:
                raise InputError("system: has loops and says not how it starts; add [simulate] with a state")
            state = loops.state(model)
        problem = minimal_problem(Problem(model, Guess(state, 1.0)))
        return Opened(problem.model, problem.guess.start, DURATION, name)
    n, size = model.degrees_of_freedom, len(model.state_names)
    if state is None:
        state = np.zeros(size)
        state[: n if model.rates is None else size] = np.linspace(0.5, 1.0, n)  # rad, the last the most
    duration = DURATION
    if system_kind(model.system).pendulum:
        duration = SWINGS * 2 * np.pi / float(np.sqrt(normal_modes(model)[0].min()))
    return Opened(model, state, round(duration, 1), name)


@dataclass(frozen=True)
class Note:
    """What the session's folder says of an `Item`, in a file of its own."""

    name: str
    file: str
    place: str
    command: tuple[str, ...]
    files: tuple[str, ...]
    parent: str | None
    saved: bool


@contextmanager
def session_folder(out: Path, name: str) -> Iterator[Path]:
    """The first folder OUT/sessions/NAME-K that no studio has that runs, for this process alone in the block."""
    for number in count(1):
        folder = out / "sessions" / f"{name}-{number}"
        folder.mkdir(parents=True, exist_ok=True)
        with held(folder / ".lock") as ours:
            if ours:
                yield folder
                return


@dataclass
class Item:
    """Something found or opened: its name, its file, what it came from, and how a command line finds it again."""

    name: str
    file: Path
    place: str
    """the path that further commands name it by"""
    command: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    """what is saved, relative to the folder, in the order in which it is copied"""
    parent: str | None = None
    family: Family | None = None
    orbit: Orbit | None = None
    atlas: tuple[AtlasRow, ...] | None = None
    saved: bool = False


@dataclass
class Session:
    """One tab: what it opened, the session's `folder`, the folder `out` that is saved to, all results by name."""

    opened: Opened
    folder: Path
    out: Path
    model: Model = field(init=False)
    items: dict[str, Item] = field(default_factory=dict)
    searches: dict[Any, str] = field(default_factory=dict)
    """names of the atlases by what was searched for"""
    own: set[str] = field(default_factory=set)
    """names that were saved from here"""
    damaged: list[str] = field(default_factory=list)
    """sentences about files of the folder that could not be read, which are left alone"""
    energy: float | None = None
    """of the motion on the stage (J)"""

    def __post_init__(self) -> None:
        self.model = self.opened.model

    @property
    def title(self) -> str:
        """What system it is."""
        return mechanism(self.model.system)

    def problem(self, state: Any, period: float, taken: set[str]) -> tuple[str, Path]:
        """A problem file with a guess, at the energy that it has, and the name of the orbit that it asks for."""
        name = self.unused(taken)
        return name, self._written(
            name,
            self._guess(name, state, period, self.energy, pinned=self.energy is not None and self.model.conservative),
        )

    def _guess(self, name: str, state: Any, period: float, energy: float | None, pinned: bool) -> str:
        """The text of a problem file that begins at a state; its energy (J) is `pinned` or only known."""
        document = {
            "name": name, "title": "", "source": "orbitfinder studio", "system": dict(self.model.system),
            "state": [*map(float, state)], "period": float(period), "energy": energy,
            "provenance": {"invariants": ["energy"] if pinned else []},
        }  # fmt: skip
        return self._text(orbit_text(document, expected=False))

    def search(
        self, state: Any, periods: tuple[float, float], energy: float | None, taken: set[str]
    ) -> tuple[str, Path]:
        """The name and the atlas of a search, the same ones for the same search; its problem file is beside it.

        Both are in `out` at once: what a search finds is never only in a folder that ends with the page. Raises
        `InputError`.
        """
        asked = (repr(sorted(self.model.system.items())), periods, energy)
        if asked not in self.searches:
            name = self.unused(taken)
            wanted = {"period": list(periods)} | ({} if energy is None else {"energy": energy})
            guess = self._guess(name, state, periods[0], energy, pinned=False)
            text = guess + "\n".join(["", "[search]", *entries(wanted), ""])
            self.out.mkdir(parents=True, exist_ok=True)
            write_atomically(self.out / f"{name}.toml", text.encode())
            self.searches[asked] = name
        name = self.searches[asked]
        return name, self.out / f"{name}.sqlite"

    def keep_atlas(self, name: str) -> Item:
        """Remember what a search has found so far; an atlas that was opened has its own file."""
        if self.opened.atlas is not None and name == self.opened.name:
            rows, file = _rows(self.opened.atlas), self.opened.atlas
            return self._kept(Item(name, file, str(file), atlas=tuple(rows), saved=True))
        file, again = self.out / f"{name}.sqlite", f"{AGAIN}-{name}.sqlite"
        with Atlas(file) as book:
            rows, starts = book.rows(order="id"), summarise(book).starts
        how = ("--starts", str(starts), "--workers", "1", "--atlas", again)
        command = ("search", str(self.out / f"{name}.toml"), *how)
        return self._kept(Item(name, file, again, command, atlas=tuple(rows), saved=True))

    def keep_member(self, atlas: Item, number: int, orbit: Orbit) -> Item:
        """Remember an orbit of an atlas by its id."""
        place = f"{atlas.place}#{number}"
        return self._kept(
            Item(f"{atlas.name}-{number}", Path(f"{atlas.file}#{number}"), place, parent=atlas.name, orbit=orbit,
                 saved=True)
        )  # fmt: skip

    def problem_of(self, orbit: Orbit, taken: set[str]) -> tuple[str, Path]:
        """A problem file that finds an orbit that is known."""
        name = self.unused(taken)
        return name, self._written(name, orbit_text({**orbit_to_document(orbit), "name": name}))

    def own_problem(self, taken: set[str]) -> tuple[str, Path]:
        """The problem file that was opened, under a name of its own."""
        assert self.opened.guess is not None
        name, text = self.unused(taken), self.opened.guess[1]
        named, count = re.subn(r"(?m)^name\s*=.*$", f'name = "{name}"', text, count=1)
        return name, self._written(name, named if count else f'name = "{name}"\n{text}')

    def _written(self, name: str, text: str | None) -> Path:
        file = self.folder / f"{name}.toml"
        write_atomically(file, self._text(text).encode())
        return file

    @staticmethod
    def _text(text: str | None) -> str:
        if text is None:
            raise InputError("system: no problem file describes it; use `continue` on an orbit.json")
        return text

    def unused(self, taken: set[str]) -> str:
        """A name that no tab and no file in the folder has; it joins those `taken`."""
        number, folders = 1, (self.out, self.folder)
        while (name := f"{self.opened.word}-{number}") in taken or any(
            (folder / f"{name}{end}").exists() for folder in folders for end in ("", ".toml")
        ):
            number += 1
        taken.add(name)
        return name

    def keep_opened(self, orbit: Orbit | None = None) -> Item:
        """Remember what the file that was opened holds."""
        file = self.opened.orbit or self.opened.family
        assert file is not None
        family = load_family(file) if orbit is None else None
        return self._kept(Item(self.opened.name, file, str(file), family=family, orbit=orbit, saved=True))

    def keep_orbit(self, orbit: Orbit) -> Item:
        """Remember a certified orbit, found by the problem file of its name."""
        name, file = orbit.name, f"{orbit.name}/orbit.json"
        command = ("run", str(self.out / f"{name}.toml"), "--out", AGAIN)
        files = (f"{name}.toml", f"{name}/orbit.npz", file)
        return self._kept(Item(name, self.folder / file, f"{AGAIN}/{file}", command, files, orbit=orbit))

    def keep_family(self, family: Family, parent: str, points: int, event: int | None = None, branch: int = 1) -> Item:
        """Remember a family through an orbit, or the `branch`-th that leaves another one at an event."""
        name, file = family.name, f"{family.name}/family.json"
        switch = () if event is None else ("--switch", str(event), "--branch", str(branch))
        head = ("continue", self.items[parent].place, "--parameter", family.parameter, *switch)
        command = (*head, "--points", str(points), "--name", name, "--out", AGAIN)
        files = tuple(f"{name}/{path}" for path in (JOURNAL, "family.npz", "family.json"))
        return self._kept(Item(name, self.folder / file, f"{AGAIN}/{file}", command, files, parent, family=family))

    def rescued(self, name: str) -> Family | None:
        """What is there of a family whose process was stopped, as its own file; None where nothing is."""
        journal = read_journal(self.folder / name)
        if journal is None or not journal.batches:
            return None
        family = assembled(journal)
        save_family(family, self.folder / name)
        return family

    def _kept(self, item: Item) -> Item:
        self.items[item.name] = item
        if item.command or item.parent:  # what was opened is opened again
            self._note(item)
        return item

    def _note(self, item: Item) -> None:
        told = {part.name: getattr(item, part.name) for part in fields(Note)}
        write_json(self.folder / f"{item.name}.json", told | {"file": str(item.file.absolute())})

    def restore(self) -> None:
        """Bring back what the folder holds; what cannot be read is left alone and said in `damaged`."""
        again = "move it away, or search for the orbit again"
        for path in sorted(self.folder.glob("*.json"), key=lambda path: path.stat().st_mtime):
            try:
                note = read_as(Note, json_file(path, "note of the studio", again), str(path), again)
                item = Item(**vars(note) | {"file": Path(note.file)})
                if item.name != path.stem or not all(file.startswith(item.name) and ".." not in file
                                                     for file in item.files):  # fmt: skip
                    raise InputError(f"{path}: name or files: of another folder; {again}")
                if item.file.name == "family.json":
                    item.family = load_family(item.file)
                elif item.file.suffix == ".sqlite":
                    item.atlas = tuple(_rows(item.file))
                else:
                    item.orbit = load_orbit(item.file)
                self.items[item.name] = item
            except (InputError, OSError) as error:
                self.damaged.append(f"{error}; left alone")
        for journal in self.folder.glob(f"*/{JOURNAL}"):  # of a family that was cut off
            name, file = journal.parent.name, journal.with_name("family.json")
            if not file.exists() and (family := self.rescued(name)) is not None:
                files = tuple(f"{name}/{part}" for part in (JOURNAL, "family.npz", "family.json"))
                self.items[name] = Item(name, file, str(file), files=files, family=family)

    def save(self) -> list[Path]:
        """Copy everything found that is not saved yet into `out`; the files. Raises `InputError`, `OSError`."""
        written = []
        for item in [kept for kept in self.items.values() if not kept.saved]:
            target = self.out / item.name
            if target.exists() and item.name not in self.own:
                raise InputError(f"{target}: exists already and is left alone; start the studio with another --out")
            self.own.add(item.name)
            for name in item.files:
                (self.out / name).parent.mkdir(parents=True, exist_ok=True)
                write_atomically(self.out / name, file_bytes(self.folder / name))
                written.append(self.out / name)
            item.saved = True
            self._note(item)
        return written

    def commands(self) -> list[str]:
        """The command lines that find everything again, in a folder of their own."""
        return [shlex.join(("orbitfinder", *item.command)) for item in self.items.values() if item.command]

    def tree(self, parent: str | None = None) -> list[Entries]:
        """Orbits, the families through them, the families that leave these: nodes for a tree, below a parent."""
        return [
            {"id": item.name, "label": _label(item), "children": self.tree(item.name)}
            for item in self.items.values()
            if item.parent == parent
        ]


def _label(item: Item) -> str:
    mark = " (saved)" if item.saved else ""
    if item.family is not None:
        family = item.family
        return f"{item.name}: {len(family.points)} orbits, {len(family.events)} events{mark}"
    if item.atlas is not None:
        return f"{item.name}: an atlas of {plural(len(item.atlas), 'orbit')}{mark}"
    assert item.orbit is not None
    return f"{item.name}: T = {lasting(item.orbit.period, item.orbit.system, 6)}, {item.orbit.stability}{mark}"


def leaving(family: Family) -> dict[int, str]:
    """The events of a family that branches leave at, in words."""
    events, unit = family.events, unit_along(family.parameter, family.system)
    return {k: f"{k}: {events[k].words} at {events[k].parameter:.6g} {unit}" for k in left_at(family)}


def parameters(model: Model) -> Mapping[str, tuple[float, float, float]]:
    """Of each physical parameter: its value, and how far a slider goes down and up."""
    ranges = {}
    for name, value in model.named_parameters.items():
        low, high = model.limits.get(name, (0.5 * value, 1.5 * value) if value else (-1.0, 1.0))
        ranges[name] = value, min(low, high), max(low, high)
    return ranges


def rests(model: Model) -> bool:
    """Whether a system settles by itself, on equilibria or cycles, which parameters change."""
    by_itself = model.smooth and not model.forced and not model.controls and model.constraint is None
    return bool(by_itself and not model.conservative and model.parameter_names)
