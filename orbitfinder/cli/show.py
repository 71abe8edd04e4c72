"""The command `show`: what any record holds."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from orbitfinder.cli.options import FILES, finish, json_option, text
from orbitfinder.records.reading import parted
from orbitfinder.records.registry import answers_of, held, kinds, shown


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="FILE|FILE#K...")
@json_option
def show(files: tuple[Path, ...]) -> None:
    """Show what each FILE holds, whatever record it is: numbers, events with how each is followed, ends, counts.

    An orbit, a family, an atlas, optima, tori, equilibria, a section, a manifold, a connection, a controller, a proof
    of a branch. FILE#K is one of those in it. Nothing is computed: it is what the file says, and `verify` checks it.
    For a problem file, an XPPAUT file (.ode) or an SBML file (.xml) it shows what is understood and what is left out.

    \b
    Examples:
      orbitfinder show orbits/triple-1/orbit.json
      orbitfinder show families/triple-mode-2/family.json
      orbitfinder show sections/*/section.json --json
    """
    results = []
    for file in files:
        if parted(file)[0].suffix in (".toml", ".ode", ".xml", ".sbml"):
            from orbitfinder.problemfile.read import load_problem_file

            facts = load_problem_file(file).facts
            results.append({"file": str(file), "kind": "problem", **facts})
            text(f"{file}: a problem file")
            for line in _lines(facts):
                text(line)
            continue
        kind, facts = shown(file)
        if any("event" in row for row in facts.get("events", ())):  # what they are, and the commands that follow them
            told = [{**row["event"], **row} for row in facts["events"]]
            command = f"orbitfinder continue {shlex.quote(str(file))}"
            facts["events"] = [
                {name: entry for name, entry in row.items() if name != "event"}
                | {"follow": [f"{command} {way}" for way in row.get("follow", ())]} for row in told
            ]  # fmt: skip
        results.append({"file": str(file), "kind": kind, **facts})
        text(f"{file}: {kinds()[kind].words}")
        for line in _lines(facts):
            text(line)
        text(f"  for {_verbs(answers_of(held(file)[1]), facts.get('system'))}")
    finish("show", {"results": results})


def _verbs(answered: list[str], system: Any) -> str:
    """The verbs that a record answers; of a system that no file describes most ask for its Model."""
    from orbitfinder.mechanics.kind import system_kind

    if not isinstance(system, Mapping) or system_kind(system).rebuilt:
        return ", ".join(answered)
    alone = [verb for verb in answered if verb in ("show", "page")]
    others = [verb for verb in answered if verb not in alone]
    return f"{', '.join(alone)}; {', '.join(others)} need its Model, which no file describes: in Python give model="


def _lines(facts: Mapping[str, Any], margin: str = "  ") -> Iterator[str]:
    """A line for each entry, those of lists of tables below it, and what follows from events below these."""
    for name, value in facts.items():
        rows = value if isinstance(value, list) and any(isinstance(entry, Mapping) for entry in value) else ()
        yield f"{margin}{name.replace('_', ' '):<20}{'' if rows else _words(value)}".rstrip()
        for k, row in enumerate(rows):
            below = [row.get("what", ""), *row["follow"]] if isinstance(row, Mapping) and "follow" in row else []
            own = {name: entry for name, entry in row.items() if name not in ("what", "follow")} if below else row
            yield f"{margin}{k:>6}  {_words(own)}"
            yield from (f"{margin}{'':>8}{line}" for line in below if line)


def _words(value: Any) -> str:
    """A value in a line."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name.replace('_', ' ')} {_words(entry)}" for name, entry in value.items() if entry != [])
    if value and isinstance(value, list) and isinstance(value[0], Mapping):
        return f"{len(value)} of {', '.join(value[0])}"
    if isinstance(value, list):
        inner = ", ".join(map(_words, value))
        return f"[{inner}]" if value and isinstance(value[0], float) else inner
    return f"{value:.12g}" if isinstance(value, float) else str(value)
