"""Freeze what the package answers, and hold a later commit to it.

    python benchmarks/frozen.py record frozen.json          answers of this checkout, some ten minutes
    python benchmarks/frozen.py compare frozen.json         the answers now against them, exit 1 if they differ
    python benchmarks/frozen.py times OTHER                 four times as ratios to another checkout, run alternately

Answers: every problem file (period, energy, multipliers, stability, symmetry), every family of results/families
followed again by its documented command (points, events), 500 starts of two searches, four proofs, the chain of a
hundred links. All go through the command line, in folders of their own, so that nothing of the inside is known here.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
PERIOD, EVENT, OTHER = 1e-12, 1e-7, 1e-9
"""Relative differences allowed: of periods and energies, of the places of events, of everything else."""
REPORT = ("triple-1", "triple-2", "quadruple-1", "quadruple-2")
LIMIT = 3600
RATIO = 1.05


def command(*arguments: str, cwd: Path, checkout: Path = ROOT) -> str:
    """What `orbitfinder` of a checkout prints on stdout."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "PYTHONWARNINGS": "ignore"}
    line = [sys.executable, "-m", "orbitfinder", *arguments]
    done = subprocess.run(line, cwd=cwd, env=environment, capture_output=True, text=True, timeout=LIMIT)
    if done.returncode == 2:
        raise SystemExit(f"{' '.join(arguments)}\n{done.stderr}")
    return done.stdout


def orbit_of(document: dict[str, Any]) -> dict[str, Any]:
    names = ("period", "energy", "action", "stability", "symmetry", "winding", "floquet_multipliers")
    return {name: document[name] for name in names} | {"passed": document["certificate"]["passed"]}


def problems(folder: Path) -> dict[str, Any]:
    """The orbit of every problem file that names one."""
    chosen = [path for kind in ("report", "examples", "gallery", "linkages") for path in files(kind)]
    command("run", *map(str, [*chosen, ROOT / "problems/chains/chain-100.toml"]), "--no-figures", "--out", "orbits",
            cwd=folder)  # fmt: skip
    written = sorted([*folder.glob("orbits/*/orbit.json"), *folder.glob("orbits/*/rejected.json")])
    return {path.parent.name: orbit_of(json.loads(path.read_text())) for path in written}


def files(kind: str) -> list[Path]:
    return sorted((ROOT / "problems" / kind).glob("*.toml"))


def families(folder: Path) -> dict[str, Any]:
    """Every family by the commands that results/families/README.md names, in their order."""
    text = (ROOT / "results/families/README.md").read_text()
    for line in re.findall(r"^ +orbitfinder (continue .*)$", text, re.MULTILINE):
        words = [str(ROOT / word) if word.startswith("problems/") else word for word in line.split()]
        command(*words, cwd=folder)
    found = {}
    for path in sorted(folder.glob("families/*/family.json")):
        document = json.loads(path.read_text())
        events = [{key: one.get(key) for key in ("kind", "parameter", "period")} for one in document["events"]]
        ends = [{key: point[key] for key in ("period", "energy", "stability")} for point in document["points"][::10]]
        found[path.parent.name] = {"points": ends, "count": len(document["points"]), "events": events}
    return found


def searches(folder: Path) -> dict[str, Any]:
    """The catalogue that 500 starts of two searches make."""
    found = {}
    for name in ("triple", "henon-heiles"):
        file = str(ROOT / f"problems/search/{name}.toml")
        command("search", file, "--starts", "500", "--seed", "0", "--atlas", f"{name}.sqlite", cwd=folder)
        command("atlas", "export", f"{name}.sqlite", "--to", "json", "-o", f"{name}.json", cwd=folder)
        orbits = json.loads((folder / f"{name}.json").read_text())
        found[name] = in_order([one["energy"], one["period"], one["action"]] for one in orbits)
    return found


def in_order(orbits: Iterable[list[float]]) -> list[list[float]]:
    """Orbits by energy, period and size of action, which round-off must not bring out of order."""
    return sorted(orbits, key=lambda one: [round(abs(number), 7) for number in one])


def proofs(folder: Path) -> dict[str, Any]:
    """The four proofs of the report: proved or not, and the enclosure of the period."""
    found = {}
    for name in REPORT:
        said = json.loads(command("prove", str(ROOT / f"results/orbits/{name}/orbit.json"), "--json", cwd=folder))
        one = said[0] if isinstance(said, list) else said
        found[name] = {key: one[key] for key in ("proved", "symmetry", "stability") if key in one}
    return found


ANSWERS: dict[str, Callable[[Path], Any]] = {
    "problems": problems, "families": families, "searches": searches, "proofs": proofs,
}  # fmt: skip


def answers() -> dict[str, Any]:
    """Everything, each kind in a folder of its own."""
    found = {}
    for name, make in ANSWERS.items():
        with tempfile.TemporaryDirectory() as folder:
            found[name] = make(Path(folder))
        print(name, len(found[name]), file=sys.stderr, flush=True)
    return found


def differences(before: Any, now: Any, where: str = "") -> Iterator[str]:
    """Sentences about what differs by more than is allowed there."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in sorted(before.keys() | now.keys()):
            if key not in before or key not in now:
                yield f"{where}/{key}: {'gone' if key in before else 'new'}"
            else:
                yield from differences(before[key], now[key], f"{where}/{key}")
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for k, pair in enumerate(zip(before, now, strict=True)):
            yield from differences(*pair, f"{where}/{k}")
    elif isinstance(before, float) and isinstance(now, float):
        allowed = EVENT if "/events/" in where or "floquet" in where else PERIOD if "period" in where else OTHER
        if abs(now - before) > allowed * max(1.0, abs(before)):
            yield f"{where}: {before!r} -> {now!r}"
    elif before != now:
        told = (len(before), len(now)) if isinstance(before, list) and isinstance(now, list) else (before, now)
        yield f"{where}: {told[0]} -> {told[1]}"


TIMED = """
import sys, time, orbitfinder as of
from pathlib import Path
root, what = Path(sys.argv[1]), sys.argv[2]
orbit = of.load_orbit(root / "results/orbits/triple-1/orbit.json")
problem = of.Problem(of.chain(3), of.Guess(orbit.state, orbit.period), of.pin(energy=orbit.energy))
if what == "refine":
    refiner, off = of.Refiner(problem), of.Guess(orbit.state * (1 + 1e-6), orbit.period)
    refiner.refine(off)
    work, times = lambda: refiner.refine(off), 200
else:
    of.find_orbit(problem); work, times = lambda: of.find_orbit(problem), 5
best = []
for _ in range(times):
    began = time.process_time(); work(); best.append(time.process_time() - began)
print(sorted(best)[len(best) // 2])
"""


def seconds(what: str, checkout: Path) -> float:
    """Processor time of one refinement or find (median), of a family of 60 points, of 200 starts."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"}
    if what in ("refine", "find"):
        line = [sys.executable, "-c", TIMED, str(checkout), what]
        return float(subprocess.run(line, env=environment, capture_output=True, text=True, check=True).stdout)
    with tempfile.TemporaryDirectory() as folder:
        before = os.times()
        if what == "family":
            file = str(checkout / "problems/families/triple-mode-2.toml")
            command("continue", file, "--points", "60", "--direction", "forward", cwd=Path(folder), checkout=checkout)
        else:
            file = str(checkout / "problems/search/triple.toml")
            command("search", file, "--starts", "200", "--workers", "0", "--atlas", "a.sqlite", cwd=Path(folder),
                    checkout=checkout)  # fmt: skip
        after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def times(other: Path, repeats: int = 5) -> bool:
    """Ratios of processor time, this checkout to another, run alternately; True when none is above 1.05."""
    fine = True
    for what in ("refine", "find", "family", "search"):
        pairs = [(seconds(what, ROOT), seconds(what, other)) for _ in range(repeats)]
        mine, theirs = np.median(pairs, axis=0)
        fine &= bool(mine <= RATIO * theirs)
        print(f"{what:>8}: {mine:.4g} s against {theirs:.4g} s, ratio {mine / theirs:.3f}", flush=True)
    return fine


def main() -> None:
    """See the module."""
    verb, target = [*sys.argv[1:], "", ""][:2]
    if verb == "record":
        Path(target).write_text(json.dumps(answers(), indent=1) + "\n")
    elif verb == "compare":
        before = json.loads(Path(target).read_text())
        before["searches"] = {name: in_order(orbits) for name, orbits in before["searches"].items()}
        found = list(differences(before, json.loads(json.dumps(answers()))))
        print(*found, f"{len(found)} differences", sep="\n")
        raise SystemExit(1 if found else 0)
    elif verb == "times":
        raise SystemExit(0 if times(Path(target).resolve()) else 1)
    else:
        raise SystemExit(__doc__)


if __name__ == "__main__":
    main()
