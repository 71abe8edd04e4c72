"""Trajectories as CSV, in the form that `[guess] csv = ...` reads back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def csv_text(state_names: Sequence[str], times: np.ndarray, states: np.ndarray) -> str:
    """A header line, then t (s) and the states; digits that round-trip."""
    rows = np.column_stack([times, states]).tolist()
    return "\n".join([",".join(["t", *state_names]), *(",".join(map(repr, row)) for row in rows)]) + "\n"
