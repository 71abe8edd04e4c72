"""What pydantic finds wrong with a problem file, as one sentence with field, value and remedy."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from orbitfinder.errors import closest
from orbitfinder.problemfile.schema import SYSTEMS, ProblemTable

PYDANTIC = re.compile(r"(constrained-|function-|list\[).*|float|int|bool|str")
"""What pydantic puts into the place of a fault where a value may be of several kinds."""


def sentence(fault: Mapping[str, Any], document: Mapping[str, Any]) -> str:
    """One pydantic fault as field, value and remedy."""
    names = [str(part) for part in fault["loc"] if not PYDANTIC.fullmatch(str(part))]
    table, description = _table_and_description(names, document)
    where = ".".join(names) or "file"
    if fault["type"] == "extra_forbidden":
        known = list(table.model_fields) if table else []
        return f"{where}: unknown key{closest(names[-1], known)}; use one of {', '.join(known)}"
    if fault["type"] == "missing":
        return f"{where}: missing; give {description}"
    if fault["type"] == "kind":
        return f"{where}.kind: {fault['msg']}"
    if fault["type"] == "name":
        return f"{where}: {fault['msg']}, got {_short(fault['input'])}; choose another name"
    if fault["type"] == "period":
        return f"{where}.{fault['msg']}"
    if fault["type"] == "guess" or not description:
        return f"{where}: {fault['msg']}" if names else str(fault["msg"]).replace(" is missing;", ": missing;")
    if fault["type"] == "finite_number":
        rule = fault["msg"] if str(fault["msg"]).startswith("must") else "must be finite"
        return f"{where}: {rule}, got {_short(fault['input'])}; replace NaN and infinity by numbers"
    reason = re.sub(r"^(Input|List|String|Dictionary) should", "must", str(fault["msg"]))
    if fault["type"] in ("model_type", "dict_type"):
        reason = "must be a table"
    return f"{where}: {reason[0].lower() + reason[1:]}, got {_short(fault['input'])}; expected {description}"


def _short(value: Any, limit: int = 60) -> str:
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _table_and_description(names: list[str], document: Mapping[str, Any]) -> tuple[type[BaseModel] | None, str]:
    """The table that the last key belongs to, and the description of the nearest described key."""
    table: type[BaseModel] | None = ProblemTable
    description = ""
    for depth, name in enumerate(names):
        if table is None or name not in table.model_fields:
            break
        entry = table.model_fields[name]
        description = entry.description or ""
        if depth + 1 < len(names):
            table = _nested(name, entry.annotation, document) or table
    return table, description


def _nested(name: str, annotation: Any, document: Mapping[str, Any]) -> type[BaseModel] | None:
    if name == "system":
        system = document.get("system")
        return SYSTEMS.get(str(system.get("kind"))) if isinstance(system, Mapping) else None
    candidates = [annotation, *getattr(annotation, "__args__", ())]
    tables = [one for one in candidates if isinstance(one, type) and issubclass(one, BaseModel)]
    return tables[0] if tables else None
