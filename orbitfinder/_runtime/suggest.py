"""The nearest valid name, for messages about a misspelt one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def closest(name: str, known: Iterable[str]) -> str:
    """ ", did you mean 'x'?" when a known name is near, else an empty string."""
    found = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    return f", did you mean {found[0]!r}?" if found else ""
