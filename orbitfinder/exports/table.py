"""The samples of an orbit as CSV, in the form that `[guess] csv = ...` reads back."""

from __future__ import annotations

import numpy as np

from orbitfinder.exports.source import Source


def csv_file(source: Source) -> str:
    """The text of NAME.csv: a header line, then t (s) and the states, digits that round-trip."""
    rows = np.column_stack([source.times, source.samples])
    lines = [",".join(["t", *source.model.state_names]), *(",".join(repr(float(v)) for v in row) for row in rows)]
    return "\n".join(lines) + "\n"
