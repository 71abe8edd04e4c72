"""docs/problem-file.md, written from the schema so that the two cannot disagree."""

from __future__ import annotations

import sys
from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from orbitfinder.problemfile.schema import (
    BodyTable,
    ControlTable,
    DamperTable,
    ElementTable,
    ExpectedNumber,
    ExpectedTable,
    FindTable,
    GuessTable,
    JointTable,
    LoadTable,
    MotionTable,
    MotorTable,
    ProblemTable,
    SearchTable,
    SimulateTable,
    SpringTable,
    TaskTable,
    systems,
)

TITLE = """# The problem file

Generated from `orbitfinder/problemfile/schema.py` by
`python docs/problem_file.py > docs/problem-file.md`; do not edit.

A problem file is TOML in UTF-8. All quantities are in SI units, angles in rad from the downward vertical, x down and
y to the right. Unknown keys, NaN and infinity are refused. `orbitfinder init NAME` writes a commented example. A system
that has no kind of its own is written as [equations in text](how-to/text.md); [XPPAUT's FILE.ode](how-to/xppaut.md) and
[SBML's FILE.xml](how-to/sbml.md) are taken as they are.

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

CHOOSING = """## Choosing among orbits

Pins and freed parameters are counted before anything is solved. What the count leaves free is chosen by `objective`,
within `bounds`; an orbit nearest to the guess is found first, and the objective is followed from there by IPOPT with
exact first derivatives and an L-BFGS Hessian, in steps that stay on the family. The result is a local optimum, polished
and certified like any other orbit. With two pairs of multipliers the least instability is usually a kink, where the
two indices are opposite; that is solved as an equation. At other kinks the search says where it stopped.

| objective | what is smallest (or largest) | remarks |
|---|---|---|
| `nearest` | the weighted distance from the guess | a freed parameter counts relative to its own size |
| `min_instability` | the largest stability index, abs(mu + 1/mu), which beyond 2 grows with the spectral radius | \
first derivatives from second-order variational equations: for a few degrees of freedom |
| `max_amplitude` | the largest value of `coordinate` (its size) along the orbit is as large as possible | t = 0 of \
the result is at that peak |
| `min_peak_rate` | the largest rate of `coordinate` along the orbit | t = 0 of the result is at that peak; symmetry \
none or reflection |

With the energy pinned and nothing free, orbits stand alone and no gradient leads from one to another. Then
`min_instability` with `bounds.period` is a choice: `starts` searches are made at that energy, and the orbit with the
smallest spectral radius among those found is taken (of several elliptic ones, that with the smallest
abs(mu + 1/mu)). More starts find more orbits; `provenance.choice` in orbit.json says how many there were, how often
the chosen one was met, and the runner-up.

From Python the objective is any callable that makes a CasADi expression of `orbitfinder.Variables` (node states,
segment ends, period, freed parameters, the monodromy); a vector r stands for abs(r)^2 / 2 and gets its Gauss-Newton
Hessian. `orbitfinder.Constraint` adds equations (which count) and inequalities (which do not).

```python
import orbitfinder as of

system = of.chain(3)
limit = of.Constraint(lambda v: v["length2"] + v["length3"], 1.8, 2.2, name="reach")
problem = of.Problem(
    system,
    of.guesses.normal_mode(system, 2, 0.9),
    pin=of.pin(period=1.5),
    symmetry="brake",
    free=("length2", "length3"),
    constraints=(limit,),
    objective=lambda v: (v.start[0] + 0.5) ** 2 + (v.start[2] - 1) ** 2 + (v["length2"] - 1) ** 2,
)
orbit = of.find_orbit(problem)
print(orbit.period, orbit.provenance["free"])
```
"""

PYTHON = """## The Python form

A file ending in `.py` that defines `problem()` returning an `orbitfinder` `Problem`. It is a program, so it is
executed only when the command is given `--trust`.
"""


def schema_markdown() -> str:
    """The reference of the problem file in Markdown."""
    kinds = ", ".join(f'"{kind}"' for kind in systems())
    parts = [TITLE, _section("Top level", ProblemTable, skip=_tables())]
    for kind, table in systems().items():
        parts.append(_section(f'`[system]` with `kind = "{kind}"`', table, note=f"Kinds: {kinds}."))
    sections: list[tuple[str, type[BaseModel]]] = [
        ("Each entry of `[system.bodies]`", BodyTable), ("Each entry of `[system.joints]`", JointTable),
        ("Each entry of `[system.springs]`", SpringTable), ("Each entry of `[system.dampers]`", DamperTable),
        ("Each entry of `[system.motors]` of a mechanism", MotorTable),
        ("Each entry of `[system.motions]`", MotionTable),
        ("Each entry of `[system.elements]`", ElementTable), ("`[system.forcing]`", LoadTable),
        ("`[guess]`", GuessTable), ("`[find]`", FindTable), ("`[control]`", ControlTable),
        ("Each `[[control.task]]`", TaskTable), ("`[search]`", SearchTable),
        ("`[simulate]`", SimulateTable), ("`[expected]`", ExpectedTable),
        ("Each entry of `[expected]`", ExpectedNumber),
    ]  # fmt: skip
    parts += [_section(title, table) for title, table in sections]
    return "\n".join([*parts, CHOOSING, PYTHON])


def _tables() -> set[str]:
    return {"system", "guess", "find", "control", "search", "simulate", "expected"}


def _section(
    title: str, table: type[BaseModel], skip: set[str] | None = None, note: str = ""
) -> str:
    said = " ".join((table.__doc__ or "").split())
    lines = [f"## {title}", "", " ".join(filter(None, [said, note])), ""]
    lines += ["| key | default | meaning |", "|---|---|---|"]
    for name, entry in table.model_fields.items():
        if name not in (skip or set()):
            lines.append(
                f"| `{name}` | {_default(entry.default)} | {_cell(entry.description or '')} |"
            )
    return "\n".join(lines) + "\n"


def _default(value: Any) -> str:
    if value is PydanticUndefined:
        return "required"
    if value is None or value == "":
        return "none"
    return f"`{value!r}`".replace("'", '"')


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    sys.stdout.write(schema_markdown())
