"""AUTO-07p's demos pen, lor, tor and r3b, run by AUTO itself: what it labels, and where.

The equations and constants are those of the demos (github.com/auto-07p/auto-07p, demos/), stated here in C, on finer
meshes (NTST) where that sharpens a label. Starting data, which the demos keep in files, are integrated here by SciPy.
Nothing of orbitfinder is used. `python -m benchmarks.validation.auto_demos` writes what AUTO prints to the entry
"auto" of tests/data/peers.json, for the validation page and for machines without AUTO.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

HOME = Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p"))
DATA = Path(__file__).parents[2] / "tests" / "data" / "peers.json"
PROGRAM = """
#include "auto_f2c.h"
#include <math.h>
int func(integer ndim, const doublereal *u, const integer *icp, const doublereal *p, integer ijac,
         doublereal *f, doublereal *dfdu, doublereal *dfdp) {{ {field} return 0; }}
int stpnt(integer ndim, doublereal t, doublereal *u, doublereal *p) {{ {start} return 0; }}
int pvls(integer ndim, const doublereal *u, doublereal *p) {{ {told} return 0; }}
int bcnd() {{ return 0; }}
int icnd() {{ return 0; }}
int fopt() {{ return 0; }}
"""
LORENZ = "f[0] = p[2]*(u[1]-u[0]); f[1] = p[0]*u[0]-u[1]-u[0]*u[2]; f[2] = u[0]*u[1]-p[1]*u[2];"
PENDULA = """
f[0] = u[2]; f[2] = -p[1]*u[2]-sin(u[0])+p[2]+p[0]*(u[1]-u[0]);
f[1] = u[3]; f[3] = -p[1]*u[3]-sin(u[1])+p[2]+p[0]*(u[0]-u[1]);"""
CIRCUIT = """
double d = p[5]*pow(u[1]-u[0], 3);
f[0] = (-(p[1]+p[0])*u[0]+p[1]*u[1]-p[4]*pow(u[0], 3)+d)/p[3];
f[1] = p[1]*u[0]-(p[1]+p[2])*u[1]-u[2]-d; f[2] = u[1];"""
DISTANCES = """
double m = p[1], x = u[0], y = u[1], z = u[2], a = x+m, b = x-1+m;
double A = 1/sqrt(a*a+y*y+z*z), B = 1/sqrt(b*b+y*y+z*z);"""
BODIES = f"""{DISTANCES}
double A3 = (1-m)*A*A*A, B3 = m*B*B*B;
f[0] = u[3]; f[3] = 2*u[4]+x-A3*a-B3*b+p[0]*u[3];
f[1] = u[4]; f[4] = -2*u[3]+y-(A3+B3)*y+p[0]*u[4];
f[2] = u[5]; f[5] = -(A3+B3)*z+p[0]*u[5];"""
ENERGY = f"""{DISTANCES}
p[2] = (u[3]*u[3]+u[4]*u[4]+u[5]*u[5])/2-(x*x+y*y)/2-(1-m)*A-m*B-m*(1-m)/2;"""
TYPES = {1: "BP", 2: "LP", 3: "HB", 4: "UZ", 5: "LP", 6: "BP", 7: "PD", 8: "TR", 9: "EP"}
COMMON: dict[str, Any] = {
    "NCOL": 4, "IAD": 3, "ISP": 2, "ISW": 1, "IPLT": 0, "NBC": 0, "NINT": 0, "NPR": 100000, "MXBF": 10, "IID": 2,
    "ITMX": 10, "ITNW": 7, "NWTN": 3, "JAC": 0, "IADS": 1, "NPAR": 36, "IPS": 2, "IRS": 0, "ILP": 0, "THL": {11: 0.0},
    "THU": {}, "EPSL": 1e-7, "EPSU": 1e-7,
}  # fmt: skip
MASS = 0.063
"""of the lighter body in r3b"""
PRECISION = {"pen": 1e-4, "lor": 1e-7, "tor": 1e-7, "r3b": 1e-5}
"""EPSS, to which AUTO locates a label, relative to 1 + its value: the demo's, or a smaller one where it still works."""
Rates = Callable[[float, np.ndarray], Sequence[float]]


@dataclass(frozen=True)
class Label:
    """A special solution of AUTO's: its type, its number, the numbers that fort.7 has of it."""

    kind: str
    number: int
    values: tuple[float, ...]

    def named(self, first: str) -> dict[str, float | str]:
        """As it stands in the data: the first free parameter, or its energy, and the period."""
        return {"kind": self.kind, first: self.values[0], "period": self.values[-1]}


class Demo:
    """One demo, compiled in a folder of its own."""

    def __init__(self, folder: Path, size: int, field: str, start: Sequence[float], told: str = "") -> None:
        self.folder, self.size = folder, size
        values = " ".join(f"p[{k}] = {value!r};" for k, value in enumerate(start))
        (folder / "demo.c").write_text(PROGRAM.format(field=field, start=values, told=told))
        objects = [str(path) for path in sorted((HOME / "lib").glob("*.o"))]
        link = ["gfortran", "-O2", "-fopenmp", "demo.o", "-o", "demo.exe", *objects, f"-L{HOME / 'lib'}", "-lauto_c"]
        for command in (["gcc", "-O2", "-c", "demo.c"], [*link, "-lm"]):
            subprocess.run(command, cwd=folder, check=True, capture_output=True)

    def orbit(self, rates: Rates, state: Sequence[float], period: float) -> dict[str, Any]:
        """Constants that start from a numerical orbit, which is written as demo.dat."""
        times = np.linspace(0.0, period, 400)
        path = solve_ivp(rates, (0.0, period), state, t_eval=times, method="DOP853", rtol=1e-11, atol=1e-12)
        np.savetxt(self.folder / "demo.dat", np.column_stack([times, path.y.T]))
        return {"dat": "demo"}

    def run(self, **asked: Any) -> list[Label]:
        """One run, from solution IRS of the last one or from the data; its labels."""
        if asked.get("IRS"):
            shutil.copy(self.folder / "fort.8", self.folder / "fort.3")
        table = COMMON | {"NDIM": self.size} | asked
        (self.folder / "c.demo").write_text("".join(f"{name} = {value!r}\n" for name, value in table.items()))
        with (self.folder / "c.demo").open() as stream:
            subprocess.run(
                ["./demo.exe"], cwd=self.folder, stdin=stream, check=True, capture_output=True, timeout=120,
                env=os.environ | {"OMP_NUM_THREADS": "1"},
            )  # fmt: skip
        rows = [row.split() for row in (self.folder / "fort.7").read_text().splitlines()]
        return [
            Label(TYPES.get(abs(int(row[2])) % 10, row[2]), int(row[3]), tuple(map(float, row[4:])))
            for row in rows
            if row[0] != "0" and int(row[3])
        ]


def first(labels: Sequence[Label], kind: str) -> Label:
    """The first label of a kind."""
    return next(one for one in labels if one.kind == kind)


def lor(folder: Path) -> list[dict[str, float | str]]:
    """Three doublings of Lorenz's cycle on the way down from rho = 280."""

    def rates(_: float, x: np.ndarray) -> Sequence[float]:
        return 10 * (x[1] - x[0]), 280 * x[0] - x[1] - x[0] * x[2], x[0] * x[1] - 8 / 3 * x[2]

    demo = Demo(folder, 3, LORENZ, (280.0, 8 / 3, 10.0))
    settled = solve_ivp(rates, (0.0, 100.0), [1.0, 1.0, 1.0], method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    steps = {"DS": -0.5, "DSMIN": 0.01, "DSMAX": 25.0, "NMX": 60, "UZSTOP": {1: [200.0, 400.0]}}
    asked = {"ICP": [1, 11], "NTST": 100, "EPSL": 1e-9, "EPSU": 1e-9, "EPSS": PRECISION["lor"]} | steps
    labels = demo.run(**asked, **demo.orbit(rates, settled, closed(rates, settled, 0.43)))
    found = [first(labels, "PD")]
    for _ in range(2):
        labels = demo.run(**asked | {"NTST": 200}, IRS=found[-1].number, ISW=-1)
        found.append(first(labels, "PD"))
    return [one.named("rho") for one in found]


def closed(rates: Rates, state: np.ndarray, about: float) -> float:
    """The time near `about` at which a motion is back where it began: where its velocity points past the start."""
    path = solve_ivp(rates, (0.0, 1.2 * about), state, method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True)
    along = np.asarray(rates(0.0, state))
    return float(brentq(lambda t: along @ (path.sol(t) - state), 0.9 * about, 1.1 * about, xtol=1e-14))


def pen(folder: Path) -> list[dict[str, float | str]]:
    """The doubling of two pendula that run round together, and the branch points of the doubled family."""

    def rates(_: float, x: np.ndarray) -> Sequence[float]:
        pull = 0.175 * (x[1] - x[0])
        return x[2], x[3], 0.4 - 0.1 * x[2] - math.sin(x[0]) + pull, 0.4 - 0.1 * x[3] - math.sin(x[1]) - pull

    demo = Demo(folder, 4, PENDULA, (0.175, 0.1, 0.4))
    path = solve_ivp(
        rates, (0.0, 400.0), [0.0, 0.0, 4.0, 4.0], method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True
    )
    turns = 2 * math.pi * math.floor(path.y[0, -1] / (2 * math.pi))
    times = [brentq(lambda t, k=k: path.sol(t)[0] - turns + k * math.pi, 0.0, 400.0) for k in (3, 1)]
    state = path.sol(times[0]) - (turns - 2 * math.pi) * np.array([1, 1, 0, 0])  # from -pi to pi, as in pen.dat
    steps = {"DS": -0.1, "DSMIN": 0.01, "DSMAX": 0.1, "NMX": 200, "UZSTOP": {11: 30.0, 3: [-0.1, 15.0]}}
    asked = {"ICP": [3, 11], "NTST": 60, "EPSS": PRECISION["pen"]} | steps
    labels = demo.run(**asked, **demo.orbit(rates, state, times[1] - times[0]))
    doubling = first(labels, "PD")
    branch = demo.run(**asked | {"DSMAX": 0.5}, IRS=doubling.number, ISW=-1)
    return [one.named("torque") for one in (doubling, *(one for one in branch if one.kind == "BP"))]


def tor(folder: Path) -> list[dict[str, float | str]]:
    """From the Hopf point of the circuit: a fold, a branch point, and on the branch a torus and a doubling."""
    demo = Demo(folder, 3, CIRCUIT, (-0.9, 0.5, -0.6, 0.6, 0.328578, 0.933578))
    steps = {"DS": 0.001, "DSMIN": 1e-4, "DSMAX": 0.01, "NMX": 125, "NTST": 50, "UZSTOP": {1: [-0.9, -0.4]}}
    equilibria = demo.run(**steps, IPS=1, ICP=[1], ILP=1)
    asked = {"ICP": [1, 11], "ILP": 1, "EPSS": PRECISION["tor"]} | steps
    cycles = demo.run(**asked, IRS=first(equilibria, "HB").number)
    lopsided = demo.run(**asked | {"NMX": 90}, IRS=first(cycles, "BP").number, ISW=-1)
    found = [first(cycles, "LP"), first(cycles, "BP"), first(lopsided, "TR"), first(lopsided, "PD")]
    return [one.named("nu") for one in found]


def r3b(folder: Path) -> list[dict[str, float | str]]:
    """The branch points of the planar Lyapunov family about L1, where the halos and the axial orbits leave."""

    def rates(_: float, x: np.ndarray) -> Sequence[float]:
        a, b = x[0] + MASS, x[0] - 1 + MASS
        heavy = (1 - MASS) / math.hypot(a, x[1], x[2]) ** 3
        light = MASS / math.hypot(b, x[1], x[2]) ** 3
        pull = heavy + light
        return x[3], x[4], x[5], 2 * x[4] + x[0] - heavy * a - light * b, -2 * x[3] + (1 - pull) * x[1], -pull * x[2]

    place = brentq(lambda x: rates(0.0, np.array([x, 0, 0, 0, 0, 0]))[3], 0.3, 0.9) + 0.005

    def missed(unknown: np.ndarray) -> np.ndarray:
        start = [place, 0, 0, 0, unknown[0], 0]
        return solve_ivp(rates, (0.0, unknown[1] / 2), start, method="DOP853", rtol=1e-12, atol=1e-13).y[[1, 3], -1]

    speed, period = fsolve(missed, [-0.05, 2.47], xtol=1e-12)
    demo = Demo(folder, 6, BODIES, (0.0, MASS), ENERGY)
    steps = {"DS": 0.05, "DSMIN": 1e-5, "DSMAX": 0.1, "NMX": 60, "NTST": 100, "UZSTOP": {3: -1.14}}
    asked = {"ICP": [11, 1, 3], "EPSS": PRECISION["r3b"], "EPSL": 1e-8, "EPSU": 1e-8, "ITNW": 5} | steps
    labels = demo.run(**asked, **demo.orbit(rates, [place, 0, 0, 0, speed, 0], period))
    return [{"kind": one.kind, "energy": one.values[-1], "period": one.values[0]} for one in labels if one.kind == "BP"]


DEMOS: dict[str, Callable[[Path], list[dict[str, float | str]]]] = {"pen": pen, "lor": lor, "tor": tor, "r3b": r3b}


def available() -> bool:
    """True when AUTO and the compilers that it needs are here."""
    return (HOME / "lib" / "main.o").is_file() and None not in (shutil.which("gfortran"), shutil.which("gcc"))


def captured() -> dict[str, list[dict[str, float | str]]]:
    """Every demo run now."""
    found = {}
    for name, demo in DEMOS.items():
        with tempfile.TemporaryDirectory(prefix="auto-") as folder:
            found[name] = demo(Path(folder))
    return found


def main() -> None:
    """Write the labels into the data."""
    document = json.loads(DATA.read_text(encoding="utf-8"))
    document["auto"] |= {"precision": PRECISION, "labels": captured()}
    DATA.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
