"""How the report's figures are written: PNG for the page and SVG for print, byte for byte the same again."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from orbitfinder.records.reading import write_atomically
from orbitfinder.show.style import RESOLUTION


def save_both(figure: Any, stem: Path) -> list[Path]:
    """Write a figure as PNG and as SVG, without dates or random identifiers."""
    import matplotlib

    stem.parent.mkdir(parents=True, exist_ok=True)
    written = []
    for suffix, metadata in ((".png", {"Software": None}), (".svg", {"Date": None, "Creator": None})):
        buffer = io.BytesIO()
        with matplotlib.rc_context({"svg.hashsalt": stem.name, "svg.fonttype": "none"}):
            figure.savefig(buffer, format=suffix[1:], dpi=RESOLUTION, metadata=metadata)
        path = stem.with_suffix(suffix)
        write_atomically(path, buffer.getvalue())
        written.append(path)
    return written
