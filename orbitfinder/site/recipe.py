"""How an orbit is found again: a problem file that starts from the recorded orbit, and the commands."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

KINDS = ("chain", "linkage", "python")


def problem_name(document: Mapping[str, Any]) -> str:
    """The orbit's name as a problem file may have it."""
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", str(document["name"])).lstrip(".-")[:100]
    return re.sub(r"\.\.+", ".", name) or "orbit"


def problem_text(document: Mapping[str, Any]) -> str | None:
    """A problem file (TOML) whose guess is the recorded orbit; None where no file can describe the system.

    The pin is the recorded one; of an orbit without one, the energy where energy is conserved.
    """
    system = document["system"]
    if system.get("kind") not in KINDS:
        return None
    try:
        return _written(document, system)
    except TypeError:
        return None


def _written(document: Mapping[str, Any], system: Mapping[str, Any]) -> str:
    lines = [f"name = {toml(problem_name(document))}"]
    lines += [f"{key} = {toml(_line(document[key]))}" for key in ("title", "source") if document.get(key)]
    lines += ["", "[system]", *(f"{key} = {toml(value)}" for key, value in system.items() if value is not None)]
    lines += ["", "[guess]", f"state = {toml(document['state'])}", f"period = {toml(float(document['period']))}"]
    lines += ["", "[find]", *_find(document)]
    lines += ["", "[expected]", f"period = {{ value = {toml(float(document['period']))}, tolerance = 1e-9 }}"]
    return "\n".join(lines) + "\n"


def _find(document: Mapping[str, Any]) -> list[str]:
    provenance = document.get("provenance") or {}
    pin = provenance.get("pin")
    if not isinstance(pin, Mapping):
        invariants = provenance.get("invariants", ["energy"])
        pin = {"energy": float(document["energy"])} if "energy" in invariants else {}
    lines = [f"pin = {toml(dict(pin))}"] if pin else []
    winding = [int(k) for k in document.get("winding") or ()]
    if any(winding):
        lines.append(f"winding = {toml(winding)}")
    return [*lines, f"tolerance = {toml(float(document.get('tolerance', 1e-12)))}"]


def commands(document: Mapping[str, Any]) -> str:
    """The commands that find the orbit again and that verify the downloaded file."""
    name = problem_name(document)
    return f"orbitfinder run {name}.toml\norbitfinder verify {name}.json\n"


def toml(value: Any) -> str:
    """A value in TOML: text, numbers, true and false, lists, inline tables. JSON strings are TOML strings."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(str(key))} = {toml(entry)}" for key, entry in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(toml(entry) for entry in value)}]"
    raise TypeError(f"{value!r} has no form in TOML")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)


def _line(text: Any) -> str:
    """Text as the problem file takes it: one line without control characters, at most 300."""
    return "".join(letter if letter.isprintable() else " " for letter in str(text))[:300]
