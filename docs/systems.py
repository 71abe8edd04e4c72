"""The gallery of all systems, made from the problem files while the site is built.

A page of docs/gallery/ has a marker, `<!-- systems: KIND -->`, in place of which come the systems of that kind: for
each problem file what it is, its orbit moving, equations, the file, the program, the source. The orbit is that of
results/ or, of files that are not there, of docs/gallery/orbits/, which `python docs/systems.py` writes (ten minutes).
"""

from __future__ import annotations

import ast
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from equations import display, equations, letters_of
from python_form import python_form

ROOT = Path(__file__).parents[1]
PROBLEMS, RECORDS = ROOT / "problems", ROOT / "docs" / "gallery" / "orbits"
MARKER = re.compile(r"<!-- systems: (\w[\w-]*) -->")
FEW = "ORBITFINDER_DOCS"
"""Environment variable: with the value few, two systems of each kind are shown, which is what a quick test builds"""
RESULTS = {"gallery": "gallery", "linkages": "gallery", "report": "orbits"}
"""Where in results/ the orbits of a folder of problems/ are"""
SAMPLES, LARGE = 240, 20
"""Moments of a period that are kept of a smooth orbit with controls or with so many states"""
STIFF = (
    "published-steinmetz_larter",
    "equations-steinmetz-larter",
    "equations-oregonator",
    "equations-hindmarsh-rose",
)
"""Shown without an orbit: found by collocation, of which there is no record"""
MEASURED = ("chains", "pendulums", "linkages", "mechanisms", "robots")
"""Pages on which everything is in SI units; elsewhere systems have units of their own"""
PENDULA = ("pendulum", "pendula", "hoop", "swing")
KINDS = {
    "chains": "Pendulum chains",
    "pendulums": "Other pendulums",
    "linkages": "Linkages",
    "mechanisms": "Mechanisms",
    "robots": "Robots",
    "fields": "Particles and fields",
    "celestial": "Celestial mechanics",
    "forced": "Forced and damped",
    "first-order": "First-order systems",
    "hybrid": "Impacts and gaits",
    "control": "Motors and tasks",
}


@dataclass(frozen=True, eq=False)
class Entry:
    """A problem file: its place and its tables."""

    path: Path
    document: Mapping[str, Any]

    @property
    def name(self) -> str:
        """The name by which pages link it."""
        return f"{self.path.parent.name}-{self.path.stem}"

    @property
    def system(self) -> Mapping[str, Any]:
        """The table that says what moves."""
        return self.document["system"]

    @property
    def text(self) -> str:
        """The file."""
        return self.path.read_text(encoding="utf-8").strip()

    @property
    def program(self) -> bool:
        """Whether the file is a Python program."""
        return self.path.suffix == ".py"

    @property
    def head(self) -> list[str]:
        """The comment lines at its top."""
        lines = self.text.splitlines()
        if self.program:
            told = (ast.get_docstring(ast.parse(self.text)) or "").splitlines()
            return [line.strip() for line in told if not line.startswith("Source:")]
        return [
            line[1:].strip()
            for line in lines[: next(k for k, one in enumerate(lines) if one[:1] != "#")]
        ]

    @property
    def said(self) -> str:
        """What the top says, without commands."""
        return " ".join(line for line in self.head if not line.startswith("orbitfinder "))

    @property
    def shown(self) -> str:
        """The file as its page gives it."""
        return f"problems/{self.path.parent.name}/{self.path.name}"

    @property
    def record(self) -> Path | None:
        """Its orbit.json; None of a search, of a file that a family begins with, and where none is found."""
        folder, stem = self.path.parent.name, self.path.stem
        resting = "guess" not in self.document or list(self.document["guess"]) == ["state"]
        if folder == "families" or resting or self.name in STIFF:
            return None
        shipped = ROOT / "results" / RESULTS.get(folder, "none") / stem / "orbit.json"
        return shipped if shipped.is_file() else RECORDS / f"{self.name}.json"


@cache
def entries() -> tuple[Entry, ...]:
    """Every problem file that describes a system, by folder and name."""
    files = [one for one in PROBLEMS.rglob("*.*") if one.suffix in (".toml", ".py")]
    return tuple(Entry(one, document_of(one)) for one in sorted(files))


def document_of(path: Path) -> Mapping[str, Any]:
    """The tables of a problem file; of a program what stands for them."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".toml":
        return tomllib.loads(text)
    title = re.search(r'title="([^"]+)"', text)
    source = re.search(r"^Source: (.+?)\.?$", text, re.MULTILINE)
    told = {"source": source.group(1)} if source else {}
    named = title.group(1) if title else path.stem
    return {"title": named, "guess": {}, "system": {"kind": "program"}, **told}


def kind_of(entry: Entry) -> str:
    """Which page a problem file is on."""
    system, function = entry.system, str(entry.system.get("function", ""))
    if "control" in entry.document:
        return "control"
    if entry.program or system["kind"] == "equations":
        model = loaded(entry).model
        if model.rates is None and not model.hybrid:
            return "forced"
        return "hybrid" if model.hybrid else "fields" if model.hamiltonian else "first-order"
    if system["kind"] == "structure":
        return "forced"
    if system["kind"] != "python":
        return f"{system['kind']}s"
    from orbitfinder.mechanisms.machines import MACHINES

    if function in MACHINES:
        return "hybrid"
    if "three_bod" in function:
        return "celestial"
    made = plain_model(function)
    if made.rates is not None:
        return "first-order"
    if made.forces is not None:
        return "forced"
    return "pendulums" if any(part in function for part in PENDULA) else "fields"


@cache
def plain_model(function: str) -> Any:
    """A built-in system as it is without arguments."""
    from orbitfinder import systems

    return systems.FUNCTIONS[function]()


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """The hook of mkdocs: a marker is replaced by what it stands for."""
    return MARKER.sub(lambda found: made(found.group(1)), markdown)


def made(kind: str) -> str:
    """The systems of a kind, or for `index` a picture of each."""
    return "\n".join([STYLE, *(index() if kind == "index" else page(kind))])


STYLE = """<style>
.systems { display: flex; flex-wrap: wrap; gap: .6rem }
.systems a { width: 6.6rem; font-size: .6rem; line-height: 1.25; text-align: center; color: inherit }
.systems svg { display: block; margin: 0 auto .2rem }
.orbit { display: flex; flex-wrap: wrap; gap: .8rem; align-items: center }
.orbit svg { flex: 0 1 10rem; min-width: 8rem }
.orbit table { display: table !important; width: auto !important; border: 0 !important; font-size: .62rem !important }
.orbit th, .orbit td { padding: .05rem .5rem .05rem 0 !important; border: 0 !important; min-width: 0 !important }
.orbit th { font-weight: 400; opacity: .75 }
.arithmatex { overflow-x: auto; overflow-y: hidden }
.values { font-size: .7rem }
details pre code { white-space: pre-wrap; overflow-wrap: anywhere }
</style>
"""


def chosen(kind: str) -> list[Entry]:
    """The problem files of a page, those of one system together; in a quick build two."""
    found = [one for one in entries() if kind_of(one) == kind]
    order: dict[str, int] = {}
    for one in found:
        order.setdefault(group(one), len(order))
    found.sort(key=lambda one: (one.record is None, order[group(one)], bars(one)))
    return found[:2] if os.environ.get(FEW) == "few" else found


def group(entry: Entry) -> str:
    """What files of the same equations share."""
    kind = entry.system["kind"]
    return str(
        entry.system.get("function") or (kind if kind in ("chain", "linkage") else entry.name)
    )


# --------------------------------------------------------------------------------------------------


def bars(entry: Entry) -> int:
    """How many links a chain or linkage has, 0 of other systems: the smallest come first."""
    length = entry.system.get("length", ()) if entry.system["kind"] == "linkage" else ()
    return int(entry.system.get("links", len(length)))


def index() -> Iterator[str]:
    """Every system of every kind, its first frame linked to its place."""
    for kind, title in KINDS.items():
        found = [one for one in chosen(kind) if one.record is not None]
        yield f"\n## [{title}]({kind}.md)\n"
        yield '<div class="systems">'
        for one in found:
            label = escape(one.document["title"])
            yield f'<a href="{kind}.html#{one.name}">{still(one)}<span>{label}</span></a>'
        yield "</div>\n"


def still(entry: Entry) -> str:
    """The first frame of the picture of an orbit, small."""
    first = pictures(entry)[:1]
    plain = re.sub(r"<animate [^>]*/>", "", "".join(first))
    return re.sub(r'width="\d+" height="\d+"', 'width="132" height="132"', plain)


def page(kind: str) -> Iterator[str]:
    """The systems of a kind."""
    seen: set[str] = set()
    found = chosen(kind)
    for one in (one for one in found if one.record is not None):
        yield from section(one, group(one) not in seen)
        seen.add(group(one))
    if others := [one for one in found if one.record is None]:
        yield "\n## Families and searches {: #more }\n"
        yield "Files of these systems from which a family is followed or a search begins.\n"
        for one in others:
            yield from short(one, group(one) not in seen)
            seen.add(group(one))


def section(entry: Entry, fresh: bool) -> Iterator[str]:
    """A problem file: what it is, orbit, numbers, equations (where they are new), file, program, source."""
    yield f"\n## {plain(entry.document['title'])} {{: #{entry.name} }}\n"
    yield f"{plain(entry.said)}\n"
    yield f'<div class="orbit">{"".join(pictures(entry))}{numbers(entry)}</div>\n'
    yield from written_equations(entry, fresh)
    yield from files(entry)
    if "source" in entry.document:
        yield f"Source: {plain(entry.document['source'])}.\n"


def short(entry: Entry, fresh: bool) -> Iterator[str]:
    """A problem file whose orbit is not drawn: what it is and the command."""
    yield f"\n### {plain(entry.document.get('title', entry.path.stem))} {{: #{entry.name} }}\n"
    yield f"{plain(entry.said)}\n"
    if fresh:
        yield from written_equations(entry, True)
    commands = [line.replace("$ ", "") for line in entry.head if line.startswith("orbitfinder ")]
    if commands:
        yield "```sh\n" + "\n".join(commands) + "\n```\n"
    yield from files(entry)


def plain(text: str) -> str:
    """Text that Markdown leaves as it is, but for words in backquotes."""
    return re.sub(r"(`[^`]+`)|([\\`*_<>#|\[\]{}])", lambda m: m[1] or f"\\{m[2]}", text)


def files(entry: Entry) -> Iterator[str]:
    """The problem file and the program, folded away; of a program itself."""
    if entry.program:
        yield f'<details markdown="1"><summary>Problem file <code>{entry.shown}</code></summary>\n'
        yield f"```python\n{entry.text}\n```\n\n</details>\n"
        return
    yield f'<details markdown="1"><summary>Problem file <code>{entry.shown}</code></summary>\n'
    yield f"```toml\n{entry.text}\n```\n\n</details>\n"
    yield '<details markdown="1"><summary>The same in Python</summary>\n'
    yield f"```python\n{programs()[entry.name].strip()}\n```\n\n</details>\n"


def written_equations(entry: Entry, fresh: bool) -> Iterator[str]:
    """Equations of motion and the numbers that stand in them."""
    model = loaded(entry).model
    rows, said = equations(model)
    if rows and fresh:
        yield f"{display(rows)}\n"
    if fresh or entry.system["kind"] in ("chain", "linkage"):
        yield from (f"{plain(one)}\n" for one in said)
    from orbitfinder.records.orbit import SHARE

    values = dict(zip(model.parameter_names, model.parameter_values, strict=True))
    letters = letters_of([*model.state_names, *model.parameter_names, "t"])
    few = {name: value for name, value in values.items() if not name.startswith(SHARE)}
    if 0 < len(few) <= 12:
        told = ", ".join(
            f"{name} <span class='arithmatex'>\\({letters[name]}={value:.6g}\\)</span>"
            for name, value in few.items()
        )
        yield f"<p class='values'>{told}</p>\n"


def numbers(entry: Entry) -> str:
    """What is certified of an orbit, as a small table."""
    orbit = record(entry)
    sizes, measured = np.abs(orbit.floquet_multipliers), kind_of(entry) in MEASURED
    verdict = (
        "none" if orbit.certificate is None else "passed" if orbit.certificate.passed else "FAILED"
    )
    rows = {
        "period": f"{orbit.period:.12g}{' s' * measured}",
        "energy": f"{orbit.energy:.10g}{' J' * measured}"
        if np.isfinite(orbit.energy)
        else "none conserved",
        "stability": orbit.stability,
        "largest multiplier": f"{sizes.max():.5g}" if sizes.size else "only trivial ones",
        "symmetry": orbit.symmetry,
        "closure": f"{orbit.closure:.1e}",
        "certificate": verdict,
    }
    body = "".join(
        f"<tr><th>{name}</th><td>{escape(told)}</td></tr>" for name, told in rows.items()
    )
    return f"<table>{body}</table>"


@cache
def record(entry: Entry) -> Any:
    """The orbit of a problem file."""
    from orbitfinder.records.registry import load_orbit

    assert entry.record is not None
    return load_orbit(entry.record)


@cache
def pictures(entry: Entry) -> list[str]:
    """Mechanism and phase portrait, moving."""
    from orbitfinder.show.html import motions

    return motions(record(entry), loaded(entry).model if entry.program else None)


@cache
def loaded(entry: Entry) -> Any:
    """A problem file, read."""
    from orbitfinder.problemfile.read import load_problem_file

    return load_problem_file(entry.path, trust=entry.program)


@cache
def programs() -> dict[str, str]:
    """The Python form of every problem file, formatted."""
    with tempfile.TemporaryDirectory() as folder:
        for one in (each for kind in KINDS for each in chosen(kind)):
            if not one.program:
                (Path(folder) / f"{one.name}.py").write_text(
                    python_form(loaded(one)), encoding="utf-8"
                )
        command = ["ruff", "format", "--quiet", "--isolated", "--line-length", "84", folder]
        subprocess.run([sys.executable, "-m", *command], check=True)
        return {one.stem: one.read_text(encoding="utf-8") for one in Path(folder).glob("*.py")}


def write_records() -> None:
    """Run the program of every file that has no orbit in results/, and write what it finds."""
    for one in entries():
        if one.record is not None and not one.record.exists():
            write_record(one, found(one))


def found(entry: Entry) -> Any:
    """The orbit that the program of a problem file finds."""
    if entry.program:
        from orbitfinder import find_orbit

        return replace(find_orbit(loaded(entry).wanted), source=entry.document.get("source", ""))
    names: dict[str, Any] = {}
    with contextlib.chdir(entry.path.parent):  # a robot's file lies there
        exec(python_form(loaded(entry)), names)
    return replace(
        names["orbit"], title=entry.document["title"], source=entry.document.get("source", "")
    )


def write_record(entry: Entry, orbit: Any) -> None:
    """Write an orbit, with samples where it has events, controls or many links, which its state does not show soon."""
    from orbitfinder.records.orbit import save_orbit

    place, jumps = RECORDS / f"{entry.name}.json", np.any(np.diff(orbit.times) == 0)
    kept = slice(None, None, 1 if jumps else max(1, len(orbit.times) // SAMPLES))
    save_orbit(replace(orbit, times=orbit.times[kept], samples=orbit.samples[kept]), place)
    if not jumps and orbit.control is None and orbit.state.size < LARGE:
        place.with_suffix(".npz").unlink()


if __name__ == "__main__":
    write_records()
