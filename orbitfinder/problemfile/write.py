"""Problem files that `orbitfinder init` and `orbitfinder guess --out` write."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError
from orbitfinder.problemfile.proposals import Proposal, Proposals
from orbitfinder.problemfile.read import ProblemFile, checked_name

TEMPLATE = """# Every key is explained in docs/problem-file.md. SI units, angles in rad from the downward vertical.
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
    """Write a new problem file; never over an existing one."""
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError as error:
        raise InputError(f"{where}: {path} exists already and is left alone; choose another name") from error
    except OSError as error:
        raise InputError(f"{where}: cannot write {path} ({error}); {remedy} a folder that you can write to") from error
    return path


def problem_text(loaded: ProblemFile, proposals: Proposals, chosen: Proposal, name: str) -> str:
    """A problem file with the chosen `[guess]`, and the others as comments. Raises `InputError` for Python files."""
    system = loaded.document.get("system")
    if not isinstance(system, Mapping):
        raise InputError(f"{loaded.path}: has no [system] table to copy; write its state and period into problem()")
    lines = [f"name = {json.dumps(name)}", f'source = "orbitfinder guess, {chosen.name}"', "", "[system]"]
    lines += [f"{key} = {toml(value)}" for key, value in system.items()]
    lines += ["", f"[guess]  # {said(chosen)}", *_entries(chosen), ""]
    for one in proposals.found:
        if one is not chosen:
            lines += [f"# [guess]  # {said(one)}", *(f"# {line}" for line in _entries(one)), ""]
    return "\n".join(lines)


def said(one: Proposal) -> str:
    """A proposal in a few words."""
    missing = "" if one.miss is None else f", misses itself by {one.miss:.2g} of its extent"
    level = "" if one.energy is None else f", energy {one.energy:.6g} J"
    return f"{one.name}: period {one.period:.6g} s{level}{missing}"


def _entries(one: Proposal) -> list[str]:
    return [f"{key} = {toml(value)}" for key, value in one.table.items()]


def toml(value: Any) -> str:
    """A plain value in TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, str) else repr(value)
