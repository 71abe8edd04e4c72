"""The problem files that come with orbitfinder, in a wheel as in a clone: which there are, and copies of them."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError, closest
from orbitfinder.problemfile.read import read_toml
from orbitfinder.records.reading import write_atomically

KINDS = {
    "report": "the four orbits of the report that this began with",
    "examples": "small chains: modes, pins, symmetries, objectives",
    "gallery": "an orbit of most built-in systems",
    "equations": "equations as text: neurons, chemical clocks, convection, flutter",
    "linkages": "four-, five- and six-bars in any pose",
    "mechanisms": "mechanisms as drawn, in the plane and in space",
    "structures": "structures by the matrices of a finite-element program",
    "robots": "robots read from URDF files",
    "hybrid": "machines that step, hop and bounce",
    "control": "motions of least cost",
    "published": "orbits that others have published to many digits",
    "families": "starts of families, for orbitfinder continue",
    "maps": "planes of two parameters, for orbitfinder map",
    "search": "systems to search, for orbitfinder search",
    "chains": "twenty to a hundred links",
}
"""Folder -> what is in it, in the order in which they are listed"""
FORMS = (".toml", ".py")
"""Endings of problem files; other files lie beside those that name them"""


@dataclass(frozen=True)
class Shipped:
    """A problem file that comes with orbitfinder."""

    kind: str
    name: str
    path: Path

    @property
    def title(self) -> str:
        """What its orbit is, in a line: its title, of a Python file its docstring's first."""
        if self.path.suffix == ".py":
            text = ast.get_docstring(ast.parse(self.path.read_text(encoding="utf-8"))) or self.name
            return text.partition("\n")[0]
        return str(read_toml(self.path).get("title", self.name))

    @property
    def command(self) -> str:
        """The command that it is for."""
        resting = self.path.suffix == ".toml" and list(read_toml(self.path).get("guess", ())) == ["state"]
        return {"families": "continue", "maps": "map", "search": "search"}.get(
            self.kind, "equilibria" if resting else "run"
        )

    def files(self) -> Iterator[Path]:
        """The file itself, then those beside it that it names, such as the description of a robot."""
        yield self.path
        if self.path.suffix == ".py":
            return
        for word in sorted(set(_strings(read_toml(self.path)))):
            if Path(word).name == word and (beside := self.path.with_name(word)).is_file():
                yield beside


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _strings(part)


def folder() -> Path:
    """Where they lie: in the installed package, or beside it in a clone."""
    inside = Path(str(resources.files("orbitfinder"))) / "problems"
    place = inside if inside.is_dir() else inside.parents[1] / "problems"
    if not (place / "report").is_dir():
        raise InputError(f"{inside}: the problem files are missing from this installation; install orbitfinder again")
    return place


def shipped() -> list[Shipped]:
    """All of them, by kind."""
    return [
        Shipped(kind, path.stem, path)
        for kind in KINDS
        for path in sorted((folder() / kind).glob("*.*"))
        if path.suffix in FORMS
    ]


def chosen(words: Sequence[str]) -> list[Shipped]:
    """Those of the names, kinds or `all`, each once. Raises `InputError` for a word that is none or means two."""
    every = shipped()
    return list(dict.fromkeys(problem for word in words for problem in _meant(word, every)))


def _meant(word: str, every: Sequence[Shipped]) -> list[Shipped]:
    plain = word.removesuffix(".toml").removesuffix(".py").removeprefix("problems/").strip("/")
    if plain == "all" or plain in KINDS:
        return [problem for problem in every if plain in ("all", problem.kind)]
    meant = [problem for problem in every if plain in (problem.name, f"{problem.kind}/{problem.name}")]
    if len(meant) > 1:
        both = " and ".join(f"{problem.kind}/{problem.name}" for problem in meant)
        raise InputError(f"NAME: {word!r} means {both}; say which")
    if not meant:
        names = [*KINDS, *(problem.name for problem in every), *(f"{problem.kind}/{problem.name}" for problem in every)]
        hint = closest(plain, names) or "; see `orbitfinder problems list`"
        raise InputError(f"NAME: no problem file {word!r} is shipped{hint}")
    return meant


def copy(problems: Sequence[Shipped], out: Path, force: bool = False) -> list[Path]:
    """Write them to `out`/KIND/, with what they name; the paths of the problem files.

    A file that is there already and differs is left alone, with all the others, unless `force`.
    """
    pairs = {out / problem.kind / file.name: file for problem in problems for file in problem.files()}
    differing = [
        to for to, file in pairs.items() if to.exists() and not (to.is_file() and to.read_bytes() == file.read_bytes())
    ]
    if differing and not force:
        more = f" and {len(differing) - 1} more" if len(differing) > 1 else ""
        raise InputError(
            f"--out: {differing[0]}{more} exists already and differs; choose another folder, or --force to overwrite"
        )
    for to, file in pairs.items():
        to.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(to, file.read_bytes())
    return [to for to in pairs if to.suffix in FORMS]
