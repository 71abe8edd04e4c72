"""For processes that replay proofs: whatever evaluates floats raises, graphs alone may be made."""

import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np

from orbitfinder.integrate import dop853
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.proof import connections, formulation

CALLED = ca.Function.__call__


def refuse(*given, **named):
    """What stands for an evaluator."""
    raise AssertionError("an evaluator was called")


def graphs_only(function, *given, **named):
    """A call of a CasADi function, of symbols alone."""
    made = CALLED(function, *given, **named)
    if any(isinstance(part, (ca.DM, float)) for part in (made if isinstance(made, (list, tuple)) else [made])):
        refuse()
    return made


def forbid():
    """From here on NumPy's functions, DOP853 and CasADi's evaluation of numbers raise."""
    ca.Function.__call__, Buffered.__call__ = graphs_only, refuse
    dop853.integrate = formulation.integrate = connections.integrated = refuse
    for name in ("sin", "cos", "exp", "log", "sqrt", "power", "tan", "tanh"):
        setattr(np, name, refuse)


def printed(script, *files):
    """What a script prints in a process of its own, that may import this file, and its errors after it."""
    done = subprocess.run([sys.executable, "-c", script, *map(str, files)], capture_output=True, text=True,
                          cwd=Path(__file__).parent, check=False)  # fmt: skip
    return done.stdout + done.stderr
