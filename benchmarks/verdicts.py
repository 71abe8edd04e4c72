"""Verdicts on stability, counted against own monodromies and eigenvalues, beside an earlier checkout's.

500 seeded cases: 100 driven structures of 10 to 80 coordinates by harmonic balance, at amplitudes where springs harden
by half; 200 cycles of two driven masses, of families by shooting, at given frequencies; 200 equilibria of random fields
of 2 to 6 components at given parameters. A verdict is "right" or "wrong" where it says stable or unstable; `undecided`,
`marginal`, `neutral`, `degenerate` and `unknown` say less, and a case is "lost" where an earlier checkout's was right.

    python benchmarks/verdicts.py                              this checkout's, writes results/benchmarks/verdicts.md
    python benchmarks/verdicts.py --against CHECKOUT|COMMIT    beside another's
    python benchmarks/verdicts.py --only structures --json     prints the rows
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from earlier import ROOT, checkout_of
from scipy.integrate import solve_ivp
from turns import arguments, conditions, progress, publish

import orbitfinder as of
from orbitfinder.errors import OrbitfinderError

SEED, FIELDS, MASSES = 58, 20, 10
"""Of all cases; curves of equilibria and families of cycles, of which so many cases each are taken"""
COUNTS = {"structures": 100, "cycles": 200, "equilibria": 200}
HARDER, STIFFER = 0.5, 1e-7
"""Share by which a spring is stiffer where it is most stretched; distance from the axis below which none is decided"""
LESS = ("undecided", "marginal", "neutral", "degenerate", "unknown", "no orbit")


@dataclass(frozen=True)
class Structure:
    """M u'' + c u' + K u + sum k3 (stretch of each spring)^3 = F cos w t at a mass; springs (i, j), j -1 a wall."""

    stiffness: np.ndarray
    damping: np.ndarray
    springs: tuple[tuple[int, int], ...]
    cubic: np.ndarray
    driven: int
    force: float
    frequency: float

    def stretches(self) -> np.ndarray:
        """What takes coordinates to stretches (s x n)."""
        rows = np.zeros((len(self.springs), len(self.stiffness)))
        for row, (i, j) in zip(rows, self.springs, strict=True):
            row[i] = 1.0
            if j >= 0:
                row[j] = -1.0
        return rows

    def model(self) -> of.Model:
        """By `of.structure`."""
        springs = dict[str, dict[str, Any]]()
        for k, ((i, j), k3) in enumerate(zip(self.springs, self.cubic, strict=True)):
            springs[f"s{k}"] = {"kind": "cubic", "at": f"q{i + 1}", "stiffness": float(k3)}
            springs[f"s{k}"] |= {"to": f"q{j + 1}"} if j >= 0 else {}
        load = {"at": f"q{self.driven + 1}", "amplitude": self.force, "frequency": self.frequency}
        return of.structure(np.eye(len(self.stiffness)), self.damping, self.stiffness, springs, load)

    def multipliers(self, state: np.ndarray) -> tuple[np.ndarray, float]:
        """By the variations of its own equations (SciPy's DOP853), and how far a state misses itself, relative."""
        n, rows = len(self.stiffness), self.stretches()
        load = self.force * np.eye(n)[self.driven]

        def rates(t: float, x: np.ndarray) -> np.ndarray:
            (q, v), whole = x[: 2 * n].reshape(2, n), x[2 * n :].reshape(2, n, -1)
            d = rows @ q
            forces = self.stiffness @ q + self.damping @ v + rows.T @ (self.cubic * d**3)
            slopes = self.stiffness + rows.T @ (3 * self.cubic[:, None] * d[:, None] ** 2 * rows)
            beside = -(slopes @ whole[0] + self.damping @ whole[1])
            return np.concatenate([v, load * np.cos(self.frequency * t) - forces, whole[1].ravel(), beside.ravel()])

        begin = np.concatenate([state, np.eye(2 * n).ravel()])
        end = solve_ivp(rates, (0, 2 * np.pi / self.frequency), begin, "DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
        gap = float(np.abs(end[: 2 * n] - state).max() / np.abs(state).max())
        return np.linalg.eigvals(end[2 * n :].reshape(2 * n, -1)), gap


def structure(seed: int, least: int = 10, most: int = 80) -> Structure:
    """A row of masses with springs to its neighbours and to walls, some of them cubic, driven near one of its modes."""
    random = np.random.default_rng((SEED, seed))
    n = int(random.integers(least, most + 1))
    spread = random.choice([0.02, 0.5])  # alike, so that motions go through all, or not
    own, walls = (
        10 ** random.uniform(-spread, spread, n - 1),
        10 ** random.uniform(-4.0, 0.5) * random.uniform(1, 1.5, n),
    )
    stiffness = np.diag(walls) + np.diag(np.append(own, 0.0)) + np.diag(np.append(0.0, own))
    stiffness -= np.diag(own, 1) + np.diag(own, -1)
    every = [*((k + 1, k) for k in range(n - 1)), *((k, -1) for k in range(n))]
    picked = random.permutation(len(every))[: int(random.choice([1, max(n // 3, 2), n, 2 * n - 1]))]
    springs = tuple(every[k] for k in picked)
    squares = np.linalg.eigvalsh(stiffness)
    frequency = float(np.sqrt(squares[int(n * random.uniform() ** 3)]) * random.uniform(0.4, 1.3))
    share = 10 ** random.uniform(-4.5, -2.0)  # of critical damping, at the frequency
    damping = share * frequency * np.eye(n) + random.choice([0.0, share / frequency]) * stiffness
    made = Structure(stiffness, damping, springs, np.ones(len(springs)), int(random.integers(0, n)), 1.0, frequency)
    answer = np.linalg.solve(stiffness + 1j * frequency * damping - frequency**2 * np.eye(n), np.eye(n)[made.driven])
    size = 1.0 / np.abs(answer).max()
    stretched = np.abs(made.stretches() @ answer) * size
    stiff = np.array([own[j] if j >= 0 else walls[i] for i, j in springs])
    # 3 k3 d^2 is the slope of a cubic spring: half of the linear one at the root mean square of all stretches
    cubic = HARDER / 3 * stiff / max(float((stretched**2).mean()), 1e-12)
    return Structure(stiffness, damping, springs, cubic, made.driven, size, frequency)


def structures(count: int) -> Iterator[tuple[str, float]]:
    """What is said of each, and the largest growth of its own multipliers."""
    for seed in range(count):
        made = structure(seed)
        model = made.model()
        try:
            problem = of.Problem(model, of.guesses.linear_response(model), method="balance")
            orbit = of.find_orbit(problem, of.SolveSettings(with_certificate=False))
        except OrbitfinderError:
            yield "no orbit", np.nan
            continue
        multipliers, gap = made.multipliers(orbit.state)
        yield orbit.stability, float(np.log(np.abs(multipliers).max())) if gap < 1e-4 else np.nan


def cycles(count: int) -> Iterator[tuple[str, float]]:
    """Orbits of families of two driven masses at given frequencies."""
    each = count // MASSES
    for seed in range(MASSES):
        made = structure(10_000 + seed, 2, 2)
        model, wanted = made.model(), made.frequency * np.linspace(1.005, 1.005 + 0.01 * each, each)
        settings = of.FamilySettings(points=100, events=False, certify=False)
        try:
            origin = of.Problem(model, of.guesses.linear_response(model))
            family = of.follow_family(origin, "frequency", until=wanted[-1], at=wanted, settings=settings)
            points = {point.value: point for point in reversed(family.points)}
        except OrbitfinderError:
            points = {}
        for frequency in wanted.tolist():
            if frequency in points:
                there, point = replace(made, frequency=frequency), points[frequency]
                yield point.stability, float(np.log(np.abs(there.multipliers(point.state)[0]).max()))
            else:
                yield "no orbit", np.nan


def equilibria(count: int) -> Iterator[tuple[str, float]]:
    """Equilibria at given p of random fields S (A x + p b + C x^2 - x^3), S of components that are fast and slow."""
    each = count // FIELDS
    for seed in range(FIELDS):
        random = np.random.default_rng((SEED, 20_000 + seed))
        n, wanted = int(random.integers(2, 7)), np.linspace(0.05, 1.0, each)
        a, b, c = random.normal(size=(n, n)), random.normal(size=n), random.normal(size=(n, n)) / 4
        a -= np.eye(n) * (np.linalg.eigvals(a).real.max() + random.uniform(-0.3, 0.6))
        fast = 10.0 ** random.uniform(0, seed % 4, n)

        def rates(t: Any, x: Any, p: Any, a: Any = a, b: Any = b, c: Any = c, fast: Any = fast) -> Any:
            every = [x[k] for k in range(len(b))]
            return [
                rate * (sum(a[k, j] * y + c[k, j] * y**2 for j, y in enumerate(every)) + p[0] * b[k] - every[k] ** 3)
                for k, rate in enumerate(fast)
            ]

        model = of.ode(rates, [f"x{k}" for k in range(n)], {"p": 0.0})
        try:
            curve = of.follow_equilibria(model, np.zeros(n), "p", until=1.0, at=wanted)
            points = {point.value: point for point in reversed(curve.points)}
        except OrbitfinderError:
            points = {}
        for value in wanted.tolist():
            if value in points:
                slopes = a + 2 * c * points[value].state - 3 * np.diag(points[value].state ** 2)
                yield points[value].stability, float(np.linalg.eigvals(fast[:, None] * slopes).real.max())
            else:
                yield "no orbit", np.nan


CASES: dict[str, Callable[[int], Iterator[tuple[str, float]]]] = {
    "structures": structures, "cycles": cycles, "equilibria": equilibria,
}  # fmt: skip


def sense(word: str, growth: float) -> str:
    """Whether a verdict is right, wrong, or says less, in its own word."""
    if word in LESS:
        return word
    if np.isnan(growth) or abs(growth) < STIFFER:
        return "not counted"
    return "right" if (word == "unstable") == (growth > 0) else "wrong"


def elsewhere(folder: Path, name: str, count: int) -> list[tuple[str, float]]:
    """What the checkout in a folder says."""
    words = [sys.executable, __file__, "--alone", "--only", name, "--cases", str(count)]
    surroundings = os.environ | {"PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1"}
    run = subprocess.run(words, env=surroundings, capture_output=True, text=True, check=True)
    return [(word, float(growth)) for word, growth in json.loads(run.stdout.splitlines()[-1])]


def row(name: str, who: str, said: list[tuple[str, float]], before: list[tuple[str, float]] | None) -> dict[str, Any]:
    """Counts, and the numbers of the cases that an earlier checkout decided rightly and this one does not."""
    senses = [sense(*each) for each in said]
    lost = [k for k, each in enumerate(before or ()) if sense(*each) == "right" and senses[k] in LESS]
    wrong = [k for k, each in enumerate(senses) if each == "wrong"]
    less = [k for k, (word, growth) in enumerate(said) if word in LESS[:-1] and abs(growth) > STIFFER]
    return {"cases": name, "by": who, **Counter(senses), "decidable": len(less), "wrong ones": wrong, "lost": lost}


def page(rows: list[Mapping[str, Any]]) -> str:
    """The report of a run."""
    names = ("right", "wrong", *LESS, "not counted")
    cells = [
        [each["cases"], each["by"], *(str(each.get(name, 0)) for name in names), str(each["decidable"]),
         ", ".join(map(str, each["lost"]))] for each in rows
    ]  # fmt: skip
    lines = "\n".join(f"| {' | '.join(line)} |" for line in cells)
    return f"""# Verdicts on stability

Written by `python benchmarks/verdicts.py --against COMMIT`; seeded cases of three kinds, each verdict beside the
multipliers (SciPy's DOP853) or eigenvalues of the case's own equations. "Could be decided" counts the verdicts that
say less although the truth is {STIFFER:g} or more from the axis; "lost" lists the cases that the earlier checkout
decided rightly and this one does not.

| cases | by | {" | ".join(names)} | could be decided | lost |
|{"---|" * (len(names) + 4)}
{lines}

{conditions()}.
"""


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--against", metavar="CHECKOUT|COMMIT", help="an earlier checkout to count beside")
    parser.add_argument("--only", nargs="+", choices=list(CASES), default=list(CASES), help="kinds of cases")
    parser.add_argument("--cases", type=int, default=0, help="number of cases of each kind; all of them by default")
    parser.add_argument("--alone", action="store_true", help="(for itself)")
    chosen = parser.parse_args()
    counts = {name: chosen.cases or COUNTS[name] for name in chosen.only}
    if chosen.alone:
        print(json.dumps([each for name, count in counts.items() for each in CASES[name](count)]))
        return
    rows = list[Mapping[str, Any]]()
    for name, count in counts.items():
        before = None
        if chosen.against:
            with checkout_of(chosen.against) as earlier:
                before = elsewhere(earlier, name, count)
            rows.append(row(name, "earlier", before, None))
            progress(str(rows[-1]))
        rows.append(row(name, "this", elsewhere(ROOT, name, count), before))
        progress(str(rows[-1]))
    publish("verdicts", page(rows), rows, chosen)


if __name__ == "__main__":
    main()
