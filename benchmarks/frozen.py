"""Freeze what the package answers, and hold a later commit to it; earlier.py does that to its times.

    python benchmarks/frozen.py record FILE [PART ...]      answers of this checkout into FILE, some ten minutes
    python benchmarks/frozen.py compare [FILE [PART ...]]   the answers now against them, exit 1 if they differ

FILE is benchmarks/frozen.json unless said: the answers of 0.2.0 (9bce99e). Parts: problems (every problem file: period,
energy, action, multipliers, stability, symmetry), families (of results/families, by their documented commands), further
(dissipative families), branches, searches (500 starts of two), proofs (four), followed (12 tori, ten optima, a curve of
folds, connections; recorded at the end of issue 28, not from 0.2.0). All go through the command line or the public
interface, in folders of their own, so that nothing of the inside is known here.

Which points a run takes is no answer: of families the orbits at pinned values of the parameter (`--at`) are compared,
numbers within max(1e-11, 1e-14 A) of their size, A what errors grow by there, and events, ends and branches as sets, by
kind and value. `problems`, `families` and `proofs` are not run to be recorded but read from results and docs, as
they were shipped. What 0.2.0 had wrong is listed under `known` in the file, each with why; it is printed and not
counted.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BASELINE = ROOT / "benchmarks" / "frozen.json"
NUMBER, GROWTH, MULTIPLIER, EVENT, OTHER = 1e-11, 1e-14, 1e-7, 1e-7, 1e-9
"""Relative differences allowed: of numbers of orbits, at least and a unit of amplification, of multipliers, of the
values of events and ends, and of everything else"""
PINNED = 1e-12
"""How near to a pinned value, relative to it, an orbit is that was asked for there"""
REPORT = ("triple-1", "triple-2", "quadruple-1", "quadruple-2")
SHARES = (0.2, 0.4, 0.6, 0.8)
"""Where along a shipped family the orbits are whose values are pinned"""
KINDS = ("report", "examples", "gallery", "linkages")
SAID = ("period", "energy", "action")
FURTHER = (
    "problems/gallery/hodgkin-huxley.toml --parameter current --points 150 --at 8,20,50",
    "problems/families/lorenz-doubling.toml --parameter rho --until 215 --at 240,230,220",
    "problems/families/duffing-resonance.toml --parameter frequency --until 2.5 --at 1.0,1.5,2.0",
    "problems/families/coupled-pendula.toml --parameter torque --until 0.17 --at 0.25,0.2,0.18",
    "problems/families/driven-pendulum.toml --parameter torque --until 1.3 --at 1.0,1.1,1.2",
)
BRANCHED = "problems/families/triple-mode-2.toml --direction forward --points 60"
LIMIT = 3600


def command(*arguments: str, cwd: Path, checkout: Path = ROOT) -> str:
    """What `orbitfinder` of a checkout prints on stdout."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "PYTHONWARNINGS": "ignore"}
    line = [sys.executable, "-m", "orbitfinder", *arguments]
    done = subprocess.run(line, cwd=cwd, env=environment, capture_output=True, text=True, timeout=LIMIT)
    if done.returncode == 2:
        raise SystemExit(f"{' '.join(arguments)}\n{done.stderr}")
    return done.stdout


def orbit_of(document: dict[str, Any]) -> dict[str, Any]:
    names = (*SAID, "stability", "symmetry", "winding", "floquet_multipliers")
    judged = document["certificate"]
    return {name: document[name] for name in names} | {"passed": judged["passed"], "scale": judged.get("scale", 1.0)}


def problems(folder: Path) -> dict[str, Any]:
    """The orbit of every problem file that names one."""
    chosen = [path for kind in KINDS for path in files(kind)]
    command("run", *map(str, [*chosen, ROOT / "problems/chains/chain-100.toml"]), "--no-figures", "--out", "orbits",
            cwd=folder)  # fmt: skip
    written = sorted([*folder.glob("orbits/*/orbit.json"), *folder.glob("orbits/*/rejected.json")])
    return {path.parent.name: orbit_of(read(path)) for path in written}


def shipped_problems(_: Path) -> dict[str, Any]:
    """The orbits of the same problem files as they were shipped."""
    found = {}
    for file in (*(path for kind in KINDS for path in files(kind)), ROOT / "problems/chains/chain-100.toml"):
        kept = [ROOT / "results" / kind / file.stem / "orbit.json" for kind in ("orbits", "gallery")]
        kept.append(ROOT / "docs/gallery/orbits" / f"{file.parent.name}-{file.stem}.json")
        for path in filter(Path.exists, kept):
            found[file.stem] = orbit_of(read(path))
    return found


def files(kind: str) -> list[Path]:
    return sorted((ROOT / "problems" / kind).glob("*.toml"))


def families(folder: Path, before: Mapping[str, Any]) -> dict[str, Any]:
    """Every family by the command that results/families/README.md names, in their order, at the pinned values."""
    found: dict[str, Any] = {}
    for words in commands():
        name = named(words)
        pins = [point["value"] for point in before[name]["points"]]
        if "--switch" in words:  # events are known by kind and value, not by their number in a run
            source, at = words[0].split("/")[1], words.index("--switch") + 1
            wanted = before[source]["numbered"][words[at]]
            words[at] = str(event_index(folder / words[0], wanted, before[source]["parameter"]))
        found[name] = followed(folder, words, name, pins)
    return found


def commands() -> list[list[str]]:
    """The words after `continue` of every command of results/families/README.md."""
    text = (ROOT / "results/families/README.md").read_text()
    return [line.split() for line in re.findall(r"^ +orbitfinder continue (.*)$", text, re.MULTILINE)]


def named(words: list[str]) -> str:
    """The name of a family by its command."""
    return words[words.index("--name") + 1] if "--name" in words else Path(words[0]).stem


def followed(folder: Path, words: list[str], name: str, pins: Iterable[float] = ()) -> dict[str, Any]:
    """What a command says of its family, exact points at pinned values added."""
    words = [str(ROOT / word) if word.startswith("problems/") else word for word in words]
    at = words.index("--at") + 1 if "--at" in words else 0
    values = sorted({*map(float, words[at].split(",") if at else []), *pins})
    if at:
        del words[at - 1 : at + 1]
    if "--out" in words:
        del words[words.index("--out") : words.index("--out") + 2]
    pinned = [*words, "--at=" + ",".join(map(repr, values))] if values else words
    if not {"--until", "--direction", "--switch"} & set(words):  # without these the outermost of --at is where it stops
        command("continue", *words, "--out", "families", cwd=folder)
        points = []
        for side in ("forward", "backward"):
            command("continue", *pinned, "--direction", side, "--out", side, cwd=folder)
            points += family_of(read(folder / side / name / "family.json"), values)["points"]
        return family_of(read(folder / "families" / name / "family.json"), []) | {"points": points}
    command("continue", *pinned, "--out", "families", cwd=folder)
    return family_of(read(folder / "families" / name / "family.json"), values)


def read(file: Path) -> Any:
    """A JSON document."""
    return json.loads(file.read_text(encoding="utf-8"))


def event_index(file: Path, wanted: Mapping[str, Any], parameter: str) -> int:
    """The number that an event has in a family now; -1, which no command takes, where it is gone."""
    events = [event_of(one, parameter) for one in read(file)["events"]]
    near = [k for k, one in enumerate(events) if same_event(wanted, one)]
    return near[0] if near else -1


def event_of(event: Mapping[str, Any], parameter: str) -> dict[str, Any]:
    """The name and value of an event. A turn of the period was a fold of the period in 0.2.0."""
    turn = event["kind"] == "fold" and event.get("detail") not in ("", None, parameter)
    return {"kind": "turn" if turn else event["kind"], "value": event["parameter"], "period": event["period"]}


def same_event(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two are one event: kind and value; the period, which moves with a fold's root, to tell branches apart."""
    near = abs(one["value"] - other["value"]) <= EVENT * max(1.0, abs(one["value"]))
    return one["kind"] == other["kind"] and near and abs(one["period"] - other["period"]) <= 1e-3 * one["period"]


def pinned(value: float, other: float) -> bool:
    """Whether an orbit is at a pinned value: as near as Newton's method meets it."""
    return abs(value - other) <= PINNED * max(1.0, abs(other))


def family_of(document: Mapping[str, Any], pins: Iterable[float]) -> dict[str, Any]:
    """The orbits at the pinned values, events and ends of a family.json; its events also by number."""
    names = ("value", *SAID, "floquet_multipliers", "stability", "scale")
    points = [{name: one[name] for name in names} for one in document["points"]
              if any(pinned(one["value"], value) for value in pins)]  # fmt: skip
    events = [event_of(one, document["parameter"]) for one in document["events"]]
    ends = [{"kind": one["kind"]} | ({"value": one["parameter"]} if one.get("parameter") is not None else {})
            for one in document["ends"]]  # fmt: skip
    numbered = {str(k): one for k, one in enumerate(events)}
    return {"parameter": document["parameter"], "points": points, "events": events, "ends": ends, "numbered": numbered}


def shipped(_: Path) -> dict[str, Any]:
    """The families of results/families as they are there, pinned at four of their orbits."""
    found = {}
    for words in commands():
        document = read(ROOT / "results" / "families" / named(words) / "family.json")
        steps = [one["value"] for one in document["points"] if one["role"] == "step"]
        pins = {steps[round(share * (len(steps) - 1))] for share in SHARES}
        if document["parameter"] in ("energy", "period") or len(set(steps)) == len(steps):
            found[named(words)] = family_of(document, pins)
    return found


def further(folder: Path) -> dict[str, Any]:
    """Dissipative families, whose energy is one of an instant and no answer."""
    found = {named(line.split()): followed(folder, line.split(), named(line.split())) for line in FURTHER}
    for family in found.values():
        family["points"] = [point | {"energy": None} for point in family["points"]]
    return found


BRANCHES = """
import json, sys
from orbitfinder.families.branches import SWITCHABLE, branches
from orbitfinder.records.family import load_family
family = load_family(sys.argv[1])
found = []
for k, event in enumerate(family.events):
    if event.kind in SWITCHABLE:
        try:
            for one in branches(sys.argv[1], k):
                found.append({"kind": event.kind + ": " + one.start.curve.equations.symmetry.name,
                              "value": event.parameter, "period": event.period})
        except Exception as error:
            found.append({"kind": event.kind + ": " + type(error).__name__, "value": event.parameter,
                          "period": event.period})
print(json.dumps(found))
"""


def branching(folder: Path) -> dict[str, Any]:
    """The branches that leave every event of one family, by the event's kind and value and their symmetry."""
    words = [str(ROOT / word) if word.startswith("problems/") else word for word in BRANCHED.split()]
    command("continue", *words, "--out", "families", cwd=folder)
    file = folder / "families" / named(words) / "family.json"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
    done = subprocess.run([sys.executable, "-c", BRANCHES, str(file)], env=environment, capture_output=True, text=True,
                          timeout=LIMIT, check=True)  # fmt: skip
    return {named(words): {"events": json.loads(done.stdout)}}


FOLLOWED = """
import json, sys, orbitfinder as of
from pathlib import Path
root = Path(sys.argv[1])

def problem(name):
    return of.load_problem(root / f"problems/{name}.toml")

loop = of.find_orbit(problem("gallery/henon-heiles-loop"))
turns = [0.3241 - k * (5**0.5 - 2) / 90 for k in range(1, 13)]
tori = of.follow_tori(loop, at=tuple(turns), until=turns[-1]).tori
found = [min(tori, key=lambda one: abs(one.rotation - turn)) for turn in turns]
optima = of.follow_optima(problem("control/maintained-oscillator"), "damping", [(20 - k) / 100 for k in range(10)])
family = of.follow_family(problem("families/duffing-resonance"), "frequency", until=2.0)
forces = [0.06, 0.2, 0.5, 1.0, 2.0]
folds = of.follow_curve(family, 0, ["force", "frequency"], at=forces)
lyapunov = of.find_orbit(problem("gallery/oterma-l1"))
where = {"plane": "y=0", "axes": ["x", "xdot"], "direction": -1, "near": [-0.616, 0], "most": 1}
first = of.connect(lyapunov, **where)
near = [lyapunov.energy + by for by in (-1e-5, 1e-5)]
further = [of.sections.follow_connection(first[0], lyapunov, [energy]) for energy in near]
print(json.dumps({
    "tori": [[one.rotation, one.period, one.energy, one.certificate.passed] for one in found],
    "optima": [[one.period, one.control["cost"], one.certificate.passed] for one in optima.points],
    "folds": [[one.free["force"], one.free["frequency"]] for one in folds.points if one.value in forces],
    "connections": [[one.kind, one.state.tolist(), one.angle, one.certificate.passed]
                    for some in (first, *further) for one in some],
}))
"""


def followed_otherwise(_: Path) -> dict[str, Any]:
    """Tori, optima, a curve in two parameters and connections, at pinned values."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
    done = subprocess.run([sys.executable, "-c", FOLLOWED, str(ROOT)], env=environment, capture_output=True, text=True,
                          timeout=LIMIT, check=True)  # fmt: skip
    return dict(json.loads(done.stdout))


def searches(folder: Path) -> dict[str, Any]:
    """The catalogue that 500 starts of two searches make."""
    found = {}
    for name in ("triple", "henon-heiles"):
        file = str(ROOT / f"problems/search/{name}.toml")
        command("search", file, "--starts", "500", "--seed", "0", "--atlas", f"{name}.sqlite", cwd=folder)
        command("atlas", "export", f"{name}.sqlite", "--to", "json", "-o", f"{name}.json", cwd=folder)
        orbits = read(folder / f"{name}.json")
        found[name] = in_order([one["energy"], one["period"], one["action"]] for one in orbits)
    return found


def in_order(orbits: Iterable[list[float]]) -> list[list[float]]:
    """Orbits by energy, period and size of action, which round-off must not bring out of order."""
    return sorted(orbits, key=lambda one: [round(abs(number), 7) for number in one])


def proofs(folder: Path) -> dict[str, Any]:
    """The four proofs of the report again: proved or not, and the period in its middle."""
    files = [str(ROOT / f"results/orbits/{name}/orbit.json") for name in REPORT]
    told = json.loads(command("prove", *files, "--no-record", "--json", cwd=folder))["results"]
    return {name: proof_of(one) for name, one in zip(REPORT, told, strict=True)}


def shipped_proofs(_: Path) -> dict[str, Any]:
    """The same as they were shipped."""
    return {name: proof_of(read(ROOT / f"results/orbits/{name}/orbit.json")["proof"]) for name in REPORT}


def proof_of(entry: Mapping[str, Any]) -> dict[str, Any]:
    """What a proof says, in a word each."""
    return {
        "proved": entry["proved"], "symmetry": entry["symmetry"], "stability": entry["stability"],
        "period": float(entry["period"]["value"]),
    }  # fmt: skip


AGAIN: dict[str, Callable[[Path], Any]] = {"problems": problems, "proofs": proofs}
"""How to compute again what is read from shipped files to be recorded"""
ANSWERS: dict[str, Callable[[Path], Any]] = {
    "problems": shipped_problems, "families": shipped, "further": further, "branches": branching, "searches": searches,
    "proofs": shipped_proofs, "followed": followed_otherwise,
}  # fmt: skip


def answers(parts: Iterable[str], before: Mapping[str, Any] | None = None) -> Iterator[tuple[str, Any]]:
    """The parts asked for, each in a folder of its own; with answers of before, families are followed at their pins."""
    for part in parts:
        with tempfile.TemporaryDirectory() as name:
            if before is not None and part == "families":
                found = families(Path(name), before[part])
            else:
                found = (AGAIN.get(part, ANSWERS[part]) if before is not None else ANSWERS[part])(Path(name))
        print(part, len(found), file=sys.stderr, flush=True)
        yield part, json.loads(json.dumps(found))


def differences(before: Any, now: Any, where: str = "") -> Iterator[str]:
    """Sentences about what differs by more than is allowed there."""
    if isinstance(before, dict) and isinstance(now, dict) and "floquet_multipliers" in before:
        yield from orbit_differences(before, now, where)
    elif isinstance(before, dict) and isinstance(now, dict):
        for key in sorted((before.keys() | now.keys()) - {"numbered"}):
            if key not in before or key not in now:
                yield f"{where}/{key}: {'gone' if key in before else 'new'}"
            elif key in ("events", "ends"):
                yield from set_differences(before[key], now[key], f"{where}/{key}")
            elif key == "points":
                yield from pinned_differences(before[key], now[key], f"{where}/{key}")
            else:
                yield from differences(before[key], now[key], f"{where}/{key}")
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for k, pair in enumerate(zip(before, now, strict=True)):
            yield from differences(*pair, f"{where}/{k}")
    elif isinstance(before, float) and isinstance(now, float):
        if not abs(now - before) <= OTHER * max(1.0, abs(before)):
            yield f"{where}: {before!r} -> {now!r}"
    elif before != now:
        sizes = (len(before), len(now)) if isinstance(before, list) and isinstance(now, list) else (before, now)
        yield f"{where}: {sizes[0]} -> {sizes[1]}"


def orbit_differences(before: Mapping[str, Any], now: Mapping[str, Any], where: str) -> Iterator[str]:
    """Of one orbit: numbers within max(1e-11, 1e-14 A), multipliers each against the nearest, words exactly."""
    share = max(NUMBER, GROWTH * before["scale"])
    for name in SAID:
        pair = before[name], now[name]
        if None in pair:
            if pair != (None, None):
                yield f"{where}/{name}: {pair[0]} -> {pair[1]}"
        elif not abs(pair[1] - pair[0]) <= share * max(1.0, abs(pair[0])):
            yield f"{where}/{name}: {pair[0]!r} -> {pair[1]!r}, allowed {share:.1e}"
    known, left = ([complex(*each) for each in one["floquet_multipliers"]] for one in (before, now))
    if len(known) != len(left):
        yield f"{where}/floquet_multipliers: {len(known)} -> {len(left)}"
        known = []
    allowed = max(MULTIPLIER, GROWTH * before["scale"])
    for mu in sorted(known, key=abs, reverse=True):
        nearest = left.pop(min(range(len(left)), key=lambda k: abs(left[k] - mu)))
        if not abs(nearest - mu) <= allowed * max(1.0, abs(mu)):
            yield f"{where}/floquet_multipliers: {mu} -> {nearest}"
    for name in ("stability", "symmetry", "winding", "passed"):
        if before.get(name) != now.get(name):
            yield f"{where}/{name}: {before.get(name)} -> {now.get(name)}"


def set_differences(before: list[Any], now: list[Any], where: str) -> Iterator[str]:
    """Of events, ends or branches: what is gone and what is new, whatever their order."""
    left = list(now)
    for one in before:
        same = [k for k, other in enumerate(left) if alike(one, other)]
        if same:
            left.pop(same[0])
        else:
            yield f"{where}: gone: {one['kind']} {one.get('value', '')}".rstrip()
    yield from (f"{where}: new: {one['kind']} {one.get('value', '')}".rstrip() for one in left)


def alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two entries of a set are the same; an end whose value 0.2.0 did not say is known by its kind."""
    if "period" in one:
        return same_event(one, other)
    values = one.get("value"), other.get("value")
    near = None in values or abs(values[0] - values[1]) <= EVENT * max(1.0, abs(values[0]))
    return one["kind"] == other["kind"] and near


def pinned_differences(before: list[Any], now: list[Any], where: str) -> Iterator[str]:
    """Of the orbits at pinned values: each against the orbit at the same value that differs in least."""
    for one in before:
        label = f"{where}/{one['value']!r}"
        there = [list(orbit_differences(one, other, label)) for other in now if pinned(one["value"], other["value"])]
        if not there:
            yield f"{label}: not met"
            continue
        yield from min(there, key=len)


def known(before: Mapping[str, Any], sentence: str) -> str:
    """Why a difference is right, "" when nobody said so."""
    return next((one["why"] for one in before.get("known", []) if re.fullmatch(one["what"], sentence)), "")


def compared(file: Path, parts: Iterable[str]) -> int:
    """Print every difference, those that are known apart; how many are not."""
    before = read(file)
    count = 0
    for part, now in answers(parts or [one for one in ANSWERS if one in before], before):
        old = before[part]
        if part == "searches":
            old = {name: in_order(orbits) for name, orbits in old.items()}
        for sentence in differences(old, now, part):
            why = known(before, sentence)
            count += not why
            print(f"{sentence}   (known: {why})" if why else sentence, flush=True)
    print(f"{count} differences")
    return count


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("verb", choices=("record", "compare"))
    parser.add_argument("file", type=Path, nargs="?", default=BASELINE)
    parser.add_argument("parts", nargs="*", metavar="PART")
    chosen = parser.parse_args()
    file, parts = chosen.file, chosen.parts
    if unknown := [part for part in parts if part not in ANSWERS]:
        parser.error(f"{unknown[0]}: no part; there are {', '.join(ANSWERS)}")
    if chosen.verb == "record":
        known = read(file) if file.exists() else {}
        for part, found in answers(parts or ANSWERS):
            known[part] = found
            file.write_text(json.dumps(known, separators=(",", ":")).replace("},", "},\n") + "\n")
    else:
        raise SystemExit(1 if compared(file, parts) else 0)


if __name__ == "__main__":
    main()
