"""What files hold: every kind of record, what reads it, what FILE#K is of it, and what answers each verb about it.

Rooms above this one enter theirs (`<room>/records.py`): kinds of their own, and what answers verbs about others'. An
answer is a function or its name, "module:function", which is loaded when it is asked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from orbitfinder._runtime.arguments import Registry, check
from orbitfinder._runtime.rooms import filled, loaded
from orbitfinder.errors import InputError
from orbitfinder.records.codec import outline
from orbitfinder.records.family import load_family
from orbitfinder.records.orbit import Orbit, orbit_from_document, read_orbit
from orbitfinder.records.reading import Entries, file_head, parted

DATABASES = (".sqlite", ".sqlite3", ".db")
OURS = re.compile(rb'\s*(?:(\[)\s*[{\]]|\{[^\[{]*?"format"\s*:\s*"orbitfinder/([\w-]+)")')
HEAD = 400
"""Bytes of a file in which its format is said"""
Answer = str | Callable[..., Any]


@dataclass(frozen=True)
class Kind:
    """A kind of record. What is "" has no answer, and is refused in a sentence.

    Args:
        words: what one is called.
        read: (path) -> the record.
        parts: (record) -> those that FILE#K names, counted from 0; or `one`, (path, K) -> that one.
        holds: the kind of these.
        first: the least K.
        apart: whether they are verified one by one.
        facts: (record) -> what is shown of it, where that is not what its entries say.
        verify: (record, model) -> its Certificate, or of a family each check with where it is made.
        plot: (record, folder, model) -> the pictures that were written.
        animate: (record, model, settings) -> a Clip.
        export: (record, to, folder, model) -> the files that were written.
        page: (what is gathered, path, filter), which adds it, or the name of the list there that it joins.
        studio: the field of what the studio opens that it is.
        prove: (what is asked) -> how proofs of this kind are made, or of orbits, which keep theirs.
        replay: (path, the folder that is trusted, progress) -> the proof made again, what it does not bear out, and
            what it says.
    """

    words: str
    read: Answer
    parts: Callable[[Any], Sequence[Any]] | None = None
    one: Answer = ""
    holds: str = "orbit"
    first: int = 0
    apart: bool = False
    facts: Answer = ""
    verify: Answer = ""
    plot: Answer = ""
    animate: Answer = ""
    export: Answer = ""
    page: Answer = ""
    studio: str = ""
    prove: Answer = ""
    replay: Answer = ""


VERBS = ("verify", "plot", "animate", "export", "page", "studio")
"""What not every kind answers, of what `show` names; every one is shown"""
ANSWERS = {"verify": "Certificate", "plot": "Sequence[Path]", "animate": "Clip", "export": "Sequence[Path]"}
"""What an answer is, if it does not come piece by piece"""


KINDS = Registry(Kind, {
    "orbit": Kind("an orbit", read_orbit, verify="orbits.certify:certify", studio="orbit"),
    "family": Kind(
        "a family", load_family, attrgetter("points"), verify="families.verified:verified", studio="family",
    ),
    "sweep": Kind("a sweep", "orbits.sweep:load_sweep"),
})  # fmt: skip
"""Every kind by its format; others may join (`kinds` has them all)"""


def kinds() -> Mapping[str, Kind]:
    """Every kind by its format."""
    filled("records")
    return KINDS


def answers(kind: str, **verbs: Answer) -> None:
    """Enter what answers verbs about a kind that a lower room has."""
    KINDS[kind] = replace(KINDS[kind], **verbs)  # type: ignore[arg-type]


def kind_of(file: Path) -> str:
    """What a file holds, by its name and its first bytes: one of `KINDS`, or nothing."""
    kind = _format(file)
    return kind if kind in kinds() else ""


def _format(file: Path) -> str:
    """What a file says that it holds, known or not."""
    if file.suffix in DATABASES:
        return "atlas"
    found = OURS.match(file_head(file, HEAD))
    return "" if found is None else "export" if found[1] else found[2].decode()


def member(path: str | Path) -> tuple[Path, int | None]:
    """The file and the number in FILE#K; no number where there is none, or where a file has that very name."""
    file, number = parted(path)
    if file == Path(path):
        return file, None
    if not (number.isascii() and number.isdigit()):
        raise InputError(f"{path}: #{number}: not a whole number from 0; give FILE#K, such as {file.name}#0")
    return file, int(number)


def held(path: str | Path) -> tuple[str, Kind]:
    """The kind of FILE or FILE#K and its name; what is no record of ours is read, and refused, as an orbit.

    Raises `InputError` for a format that nobody has entered.
    """
    file, number = member(path)
    name = _format(file) or "orbit"
    if name not in kinds():
        raise InputError(f"{path}: format: 'orbitfinder/{name}' is unknown to this installation, which knows "
                         f"{', '.join(kinds())}; install what wrote it, or import the module that enters it in "
                         "KINDS of orbitfinder/records/registry.py, in records.py of its room")  # fmt: skip
    if number is not None and not (kinds()[name].parts or kinds()[name].one):
        raise InputError(f"{path}: #{number}: not a family or an atlas, of which orbits have numbers; "
                         f"leave #{number} out")  # fmt: skip
    name = name if number is None else kinds()[name].holds
    return name, kinds()[name]


def load(path: str | Path) -> Any:
    """The record of FILE or FILE#K. Raises `InputError`."""
    held(path)
    file, number = member(path)
    kind = kinds()[_format(file) or "orbit"]
    if number is None:
        return loaded(kind.read)(file)
    if kind.parts is None:
        return loaded(kind.one)(file, number)
    parts = kind.parts(loaded(kind.read)(file))
    if number >= len(parts):
        what = "torus" if kind.holds == "tori" else kind.holds
        raise InputError(f"{path}: #{number}: no such {what} in the file; give a number from 0 to {len(parts) - 1}")
    return orbit_from_document(parts[number], str(path)) if isinstance(parts[number], dict) else parts[number]


def answer(verb: str, path: str | Path) -> Callable[..., Any]:
    """What answers one of `VERBS` about FILE or FILE#K. `InputError` says what takes the file where nothing does."""
    find = loaded(taken(verb, path))

    def checked(*given: Any) -> Any:
        made = find(*given)
        if not isinstance(made, Iterator):
            check(f"Kind {held(path)[0]!r}, {verb}", ANSWERS.get(verb, "Any"), made, "; return the files")
        return made

    return checked


def taken(verb: str, path: str | Path) -> Answer:
    """The same, as its kind names it."""
    _, kind = held(path)
    if found := getattr(kind, verb):
        return found  # type: ignore[no-any-return]
    several = kind.parts or kind.one
    one = f", or one orbit of the file: {path}#{kind.first}" if several and kind.holds == "orbit" else ""
    takes = ", ".join(each.words for each in kinds().values() if getattr(each, verb))
    raise InputError(f"{path}: {kind.words}, which `{verb}` does not take; give {takes}{one}; "
                     f"this file is for {', '.join(answers_of(kind))}")  # fmt: skip


def answers_of(kind: Kind) -> list[str]:
    """The verbs that a kind answers."""
    return ["show", *(verb for verb in VERBS if getattr(kind, verb))]


def shown(path: str | Path) -> tuple[str, Entries]:
    """The kind of FILE or FILE#K, and what it holds, in short (see `outline`)."""
    name, kind = held(path)
    record = load(path)
    found: Entries = outline(loaded(kind.facts)(record) if kind.facts else record)
    return name, found


def load_orbit(path: str | Path) -> Orbit:
    """Read an orbit.json, or one of many orbits in a file.

    Args:
        path: an orbit.json (and orbit.npz if it is there), or FILE#K: point K of a family.json or orbit K of an atlas
            export, counted from 0 as in the file's list, or orbit K of an atlas, by its id.

    Returns:
        An Orbit.

    Raises:
        InputError: on anything unreadable, edited or damaged.

    Examples:
        >>> _ = of.save_orbit(orbit, "orbit.json")
        >>> of.load_orbit("orbit.json").period == orbit.period
        True
    """
    file, number = member(path)
    if number is None and file.suffix in DATABASES and file.is_file():
        raise InputError(f"{path}: an atlas database; give one orbit of it by its id: {path}#1")
    kind = kinds().get(kind_of(file), KINDS["orbit"])
    if kind.holds != "orbit" and kind.parts:
        raise InputError(f"{path}: {kind.words}, not an orbit; give an orbit.json")
    found: Orbit = read_orbit(file) if number is None else load(path)
    return found
