"""Marching a state with its variations, this checkout against another: milliseconds and ratios, the same bits or not.

python benchmarks/variational.py [COMMIT|FOLDER]    a commit or a folder; 0.2.0 unless said
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

from earlier import ROOT, checkout_of

BEFORE = "9bce99e"
MEASURED = """
import hashlib, json, time
import casadi as ca, numpy as np, orbitfinder as of
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.symmetry import NONE

def masses(n):
    names = [f"{letter}{k}" for letter in "xv" for k in range(n)]
    def field(t, x, p):
        q, v = ([getattr(x, f"{letter}{k}") for k in range(n)] for letter in "xv")
        stretched = [q[0], *(b - a for a, b in zip(q, q[1:]))]
        forces = [*(one + 0.5 * one**3 for one in stretched), -0.1 * ca.cos(p.w * t)]
        return [*v, *(forces[k + 1] - forces[k] - 0.1 * v[k] for k in range(n))]
    return of.ode(field, tuple(names), {"w": 1.0}, forcing_period=lambda p: 2 * np.pi / p.w)

found = {}
for name, model in {"chain of 8": of.chain(8), "chain of 9": of.chain(9), "chain of 16": of.chain(16),
                    "10 forced masses": masses(10), "20 forced masses": masses(20)}.items():
    equations = Equations(model, NONE)
    start = 0.1 * np.random.default_rng(0).standard_normal((1, len(model.state_names)))
    asked = start, uniform(1.0, 1, 40), np.concatenate([[1.0], np.zeros(equations.march.unfolding)])
    taken = []
    for _ in range(9):
        began = time.perf_counter()
        path = equations.march.varied(*asked)
        taken.append(time.perf_counter() - began)
    bits = hashlib.sha256(path.transitions.tobytes() + path.ends.tobytes() + path.columns.tobytes()).hexdigest()
    found[name] = [1e3 * min(taken), bits]
print(json.dumps(found))
"""


def measured(checkout: Path) -> dict[str, tuple[float, str]]:
    """Milliseconds and the digest of what came out, by system; run there, where `orbitfinder` is that checkout's."""
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    line = [sys.executable, "-c", MEASURED]
    done = subprocess.run(line, env=environment, cwd=checkout, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", nargs="?", metavar="COMMIT|FOLDER", default=BEFORE)
    with checkout_of(parser.parse_args().before) as other:
        mine, theirs = (measured(one) for one in (ROOT, other))
    for name, (now, bits) in mine.items():
        before, same = theirs[name][0], "the same bits" if bits == theirs[name][1] else "other bits"
        print(f"{name:>17}: {now:.3g} ms against {before:.3g} ms, {before / now:.2f} times as fast, {same}")


if __name__ == "__main__":
    main()
