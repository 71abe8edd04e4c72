"""docs/problem-file.md, written from the schema so that the two cannot disagree."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from orbitfinder.schema import (
    SYSTEMS,
    ExpectedNumber,
    ExpectedTable,
    FindTable,
    GuessTable,
    ProblemTable,
    SearchTable,
    SimulateTable,
)

TITLE = """# The problem file

Generated from `orbitfinder/schema.py` by `python -m orbitfinder.problemfile > docs/problem-file.md`; do not edit.

A problem file is TOML in UTF-8. All quantities are in SI units, angles in rad from the downward vertical, x down and
y to the right. Unknown keys, NaN and infinity are refused. `orbitfinder init NAME` writes a commented example.

```toml
name = "pendulum-2rad"

[system]
kind = "chain"
links = 1

[guess]
state = [2.0, 0.0]    # rad, rad/s
period = 2.2          # s

[find]
pin = { theta1 = 2.0 }
```
"""

PYTHON = """## The Python form

A file ending in `.py` that defines `problem()` returning an `orbitfinder` `Problem`. It is a program, so it is
executed only when the command is given `--trust`.
"""


def schema_markdown() -> str:
    """The reference of the problem file in Markdown."""
    kinds = ", ".join(f'"{kind}"' for kind in SYSTEMS)
    parts = [TITLE, _section("Top level", ProblemTable, skip=_tables())]
    for kind, table in SYSTEMS.items():
        parts.append(_section(f'`[system]` with `kind = "{kind}"`', table, note=f"Kinds: {kinds}."))
    sections: list[tuple[str, type[BaseModel]]] = [
        ("`[guess]`", GuessTable), ("`[find]`", FindTable), ("`[search]`", SearchTable),
        ("`[simulate]`", SimulateTable), ("`[expected]`", ExpectedTable),
        ("Each entry of `[expected]`", ExpectedNumber),
    ]  # fmt: skip
    parts += [_section(title, table) for title, table in sections]
    return "\n".join([*parts, PYTHON])


def _tables() -> set[str]:
    return {"system", "guess", "find", "search", "simulate", "expected"}


def _section(title: str, table: type[BaseModel], skip: set[str] | None = None, note: str = "") -> str:
    said = " ".join((table.__doc__ or "").split())
    lines = [f"## {title}", "", " ".join(filter(None, [said, note])), ""]
    lines += ["| key | default | meaning |", "|---|---|---|"]
    for name, entry in table.model_fields.items():
        if name not in (skip or set()):
            lines.append(f"| `{name}` | {_default(entry.default)} | {_cell(entry.description or '')} |")
    return "\n".join(lines) + "\n"


def _default(value: Any) -> str:
    if value is PydanticUndefined:
        return "required"
    if value is None or value == "":
        return "none"
    return f"`{value!r}`".replace("'", '"')


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
