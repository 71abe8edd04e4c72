"""GNU Octave: `sqp` on single shooting with an ode45, the stand-in for the report's MATLAB and fmincon."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np

from peers.task import Answer, Task, Unavailable

SCRIPT = Path(__file__).with_name("refine_orbit.m")
LIMIT = 60.0
"""s after which it is ended"""


def refine(task: Task, limit: float = LIMIT) -> Answer:
    """One run, on Octave's own clock, start-up not counted. Raises `Unavailable` past the limit."""
    if shutil.which("octave") is None:
        raise Unavailable("Octave is not installed")
    numbers = [repr(float(value)) for value in (*task.state, task.period)]
    command = ["octave", "--no-gui", "--norc", "--quiet", str(SCRIPT), *numbers]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        raise Unavailable(f"not finished after {limit:g} s") from None
    found = np.array([float(line) for line in done.stdout.split()])
    if found.size != task.state.size + 2:
        raise Unavailable("Octave failed")
    return Answer(float(found[0]), found[1:-1], float(found[-1]))
