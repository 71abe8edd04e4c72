"""Documents as JSON that every reader takes."""

from __future__ import annotations

import math
from typing import Any


def finite(value: Any) -> Any:
    """The same document with null for every NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
