"""Problem files that we write: the template of `init`, a guess of `guess --out`, an orbit's own; TOML."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbitfinder._runtime.inert import inert
from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import OTHER, system_kind
from orbitfinder.problemfile.proposals import Proposal, Proposals
from orbitfinder.problemfile.read import ProblemFile, checked_name
from orbitfinder.records.reading import Entries, Table

TEMPLATE = """# The documentation's page "Problem file" (docs/problem-file.md) explains every key.
# SI units, angles in rad from the downward vertical.
name = "{name}"
title = "Triple pendulum, second normal mode"
source = "orbitfinder init"

[system]
kind = "chain"
links = 3
length = 1.0             # m; one number, or one per link: [1.0, 0.5, 1.0]
mass = 1.0               # kg
# inertia = 0.0833       # kg m^2 about the centre of mass; m l^2 / 12 when left out
# com = 0.5              # centre of mass as a fraction of the length
gravity = 9.8            # m/s^2

[guess]                  # one of three forms
mode = 2                 # linear normal mode of the hanging pendulum, the slowest is 1
amplitude = 0.2          # rad, the largest angle
# state = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0]   # n angles, then n rates
# period = 2.9                              # s
# csv = "trajectory.csv"                    # columns t, angles, rates over one period

[find]
pin = {{ energy = -43.9 }} # J, zero at the fixed joint; or period, or a state such as theta1; left out: nearest
symmetry = "none"        # none | brake | reflection | reversal | brake+reflection
# segments = 4           # shooting segments; chosen automatically when left out

# [expected]             # the certificate fails when the orbit disagrees
# period = {{ value = 1.18, tolerance = 1e-9 }}
"""


def write_template(name: str) -> Path:
    """Write `name`.toml in the current folder; never over an existing file."""
    path = Path(f"{checked_name(name, 'NAME', 'choose another')}.toml")
    return write_new(TEMPLATE.format(name=name), path, "NAME", "change to")


def write_new(text: str, path: Path, where: str, remedy: str = "choose") -> Path:
    """Write a new problem file; never over an existing file."""
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError as error:
        raise InputError(f"{where}: {path} exists already and is left alone; choose another name") from error
    except OSError as error:
        raise InputError(f"{where}: cannot write {path} ({error}); {remedy} a folder that you can write to") from error
    return path


def candidate_text(loaded: ProblemFile, proposals: Proposals, chosen: Proposal, name: str) -> str:
    """A problem file with the chosen `[guess]`, and the others as comments. Raises `InputError` for Python files."""
    system = loaded.document.get("system")
    if not isinstance(system, Mapping):
        raise InputError(f"{loaded.path}: has no [system] table to copy; write its state and period into problem()")
    lines = [*entries({"name": name, "source": f"orbitfinder guess, {chosen.name}"}), "", "[system]", *entries(system)]
    for proposal in (chosen, *(other for other in proposals.guesses if other is not chosen)):
        mark = "" if proposal is chosen else "# "
        lines += ["", *(f"{mark}{line}" for line in (f"[guess]  # {said(proposal)}", *entries(proposal.table)))]
    return "\n".join([*lines, ""])


def said(proposal: Proposal) -> str:
    """A proposal in a few words."""
    missing = "" if proposal.miss is None else f", misses itself by {proposal.miss:.2g} of its extent"
    level = "" if proposal.energy is None else f", energy {proposal.energy:.6g} J"
    return f"{proposal.name}: period {proposal.period:.6g} s{level}{missing}"


def orbit_name(document: Table) -> str:
    """The name of an orbit document as a problem file may have it."""
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", str(document["name"])).lstrip(".-")[:100]
    return re.sub(r"\.\.+", ".", name) or "orbit"


def orbit_text(document: Table, expected: bool = True) -> str | None:
    """A problem file whose guess is the orbit of a document; None where no file can describe the system.

    The pin is as recorded; of an orbit without any, the energy where it is conserved. Its period is
    `expected` again, unless the document has a guess only.
    """
    system, period = document["system"], float(document["period"])
    if system_kind(system) is OTHER:
        return None
    about = {  # a line without control characters, as the problem file takes it
        key: "".join(letter if letter.isprintable() else " " for letter in str(document[key]))[:300]
        for key in ("title", "source") if document.get(key)
    }  # fmt: skip
    provenance = document.get("provenance") or {}
    pin = provenance.get("pin")
    if not isinstance(pin, Mapping):
        kept = document["energy"] is not None and "energy" in provenance.get("invariants", ["energy"])
        pin = {"energy": float(document["energy"])} if kept else {}
    turns = [*map(int, document.get("winding") or ())]
    chosen = ({"pin": pin} if pin else {}) | ({"winding": turns} if any(turns) else {})
    if steered := document.get("control"):
        chosen |= {key: steered[key] for key in ("free", "bounds") if steered.get(key)}
        chosen |= {"symmetry": document["symmetry"]}
    if document.get("shift"):
        chosen["relative"] = list(document["shift"])
    tables = {
        "system": {key: value for key, value in system.items() if value is not None and key != "units"},
        **({"units": system["units"]} if system.get("units") else {}),
        "guess": {"state": document["state"], "period": period},
        "find": chosen | {"tolerance": float(document.get("tolerance", 1e-12))},
        **({"control": _control(document["control"])} if document.get("control") else {}),
    }
    if expected:
        tables["expected"] = {"period": {"value": period, "tolerance": 1e-9}}
    try:
        lines = entries({"name": orbit_name(document)} | about)
        for name, table in tables.items():
            lines += ["", f"[{name}]", *entries(table)]
    except TypeError:
        return None
    return "\n".join(lines) + "\n"


def _control(entry: Table) -> Entries:
    """The `[control]` of a controlled orbit, which begins at its own coefficients."""
    same = ("shape", "intervals", "harmonics", "average", "final", "method", "numbers")
    return {
        "cost": entry["cost_of"],
        **{key: entry[key] for key in same if key in entry and entry[key] != ""},
        "guess": dict(zip(entry["names"], entry["coefficients"], strict=True)),
        **({"task": entry["tasks"]} if entry["tasks"] else {}),
    }


def entries(table: Table) -> list[str]:
    """The lines of a TOML table."""
    return [
        f"{key if re.fullmatch('[A-Za-z0-9_-]+', str(key)) else inert(key, 'toml')} = {toml(value)}"
        for key, value in table.items()
    ]


def toml(value: Any) -> str:
    """A value in TOML: text, numbers, true and false, lists, inline tables. JSON strings are TOML strings."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return inert(value, "toml")
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return f"{{ {', '.join(entries(value))} }}" if value else "{}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml, value))}]"
    raise TypeError(f"{value!r} has no form in TOML")
