"""The beam's response curve by pyHarm (`pip install pyharm-os`), run by a Python that has it; prints one JSON document.

pyHarm's own choices but for the solver's tolerance: arc length, dense matrices, of which the linear coordinates are
eliminated (`NLdofs`); secants for tangents, which take a QR factorisation of the whole matrix.

python benchmarks/peers/pyharm_beam.py FREQUENCY HIGHEST STEPS      odd harmonics to HIGHEST, steps of the arc
"""

from __future__ import annotations

import json
import logging
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pyHarm
from scipy.io import mmread

FOLDER = Path(__file__).parents[2] / "problems" / "structures"
LENGTH, PACE, LAST = 1e-3, 100.0, 300.0
"""m and rad/s that it measures in, rad/s where it would end"""


def given(first: float, highest: int) -> dict[str, Any]:
    """The problem file's system and a curve, in pyHarm's words."""
    system = tomllib.loads((FOLDER / "beam.toml").read_text(encoding="utf-8"))["system"]
    parts = {letter: mmread(FOLDER / system[name]).toarray()
             for letter, name in (("M", "mass"), ("C", "damping"), ("K", "stiffness"))}  # fmt: skip
    node, load, spring = int(system["forcing"]["at"][1:]) - 1, system["forcing"], system["elements"]["tip"]
    at = {"connect": [("beam", [node]), ("GROUND", [0])], "dirs": [0]}
    size = len(parts["M"])
    return {
        "system": {"type": "Base", "nh": list(range(1, highest + 1, 2)), "nti": 8 * (highest + 1),
                   "adim": {"status": True, "lc": LENGTH, "wc": PACE}},
        "substructures": {"beam": {"matrix": parts | {"G": 0 * parts["M"]}, "ndofs": 1, "nnodes": size}},
        "connectors": {"tip": {"type": "CubicSpring", "k": spring["stiffness"], **at},
                       "load": {"type": "CosinusForcing", "amp": load["amplitude"], **at}},
        "analysis": {"curve": {
            "study": "frf", "puls_inf": first, "puls_sup": LAST, "ds0": 0.01, "ds_max": 0.5, "ds_min": 1e-6,
            "verbose": False, "predictor": "secant", "reductors": [{"type": "NLdofs"}],
            "solver_options": {"root": {"method": "hybr", "options": {"xtol": 1e-9}},
                               "end_status_accepted": [1, 4, 5], "residual_tolerance": 1e-8},
        }},
    }  # fmt: skip


def main() -> None:
    first, highest, steps = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    logging.disable(logging.CRITICAL)
    maestro = pyHarm.Maestro(given(first, highest))
    curve, taken = maestro.nls["curve"], []
    curve.initialise()  # and compiles
    for k in range(steps):
        began = time.process_time()
        curve.makeStep(index_insolve=k + 1)
        curve.purge_jacobians()
        taken.append(time.process_time() - began)
    node = int(maestro.inputData["connectors"]["load"]["connect"][0][1][0])
    size = maestro.inputData["substructures"]["beam"]["nnodes"]
    kept = [each.x for each in curve.SolList if each.flag_accepted]
    points = [{"frequency": PACE * x[-1], "tip": LENGTH * np.hypot(x[node], x[size + node])} for x in kept]
    print(json.dumps({"seconds": sum(taken) / max(len(points) - 1, 1), "points": points, "steps": steps}))


if __name__ == "__main__":
    main()
