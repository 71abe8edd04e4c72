"""Prove orbits of an atlas, the quickest first, or events of families, and keep the records.

Each record is the orbit's document with its `proof` entry, so that

    orbitfinder verify --proof results/proofs/*.json

and the slow test tests/test_proof_records.py replay it. Orbits that could not be proved are listed
with the reason in the summary. Records that are there already are left alone, so a run can be stopped
and given again.

    python benchmarks/prove_atlas.py results/atlas/triple.sqlite --count 50 --jobs 2
    python benchmarks/prove_atlas.py --events
    python benchmarks/prove_atlas.py --others      gaits, linkages, equilibria, connections
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from orbitfinder.atlas.store import Atlas
from orbitfinder.families.equilibria import follow_equilibria
from orbitfinder.families.folder import follow_family
from orbitfinder.loops.problem import Guess
from orbitfinder.loops.symmetry import NONE, SYMMETRIES
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.orbits.find import find_orbit
from orbitfinder.problemfile.read import load_problem, load_problem_file
from orbitfinder.proof.bordered import events, prove_event, read_event
from orbitfinder.proof.branch import read_branch
from orbitfinder.proof.connections import CODEC as PROVED_CONNECTION
from orbitfinder.proof.connections import prove_connection, read_connection_proof
from orbitfinder.proof.equilibria import CODEC, prove_equilibria
from orbitfinder.proof.record import entry
from orbitfinder.proof.theorem import prove
from orbitfinder.records.family import Family, load_family
from orbitfinder.records.orbit import orbit_from_document, orbit_to_document
from orbitfinder.records.reading import write_atomically
from orbitfinder.structures.connections import connect

RATIONAL = {"length": 1.0, "mass": 1.0, "gravity": 2.25, "damping": 0.75, "frequency": 1.0}
"""J. R. Taylor's pendulum with 2 pi t as time, without an irrational number; the torque is 9/4 of his gamma"""
FOLLOWED: dict[str, tuple[Any, ...]] = {
    "duffing": ("duffing-resonance", {"force": 0.5}, ([0.5, 0.0], 7.85398163397), "frequency", 2.6, (0, 2)),
    "pendulum": ("driven-pendulum", {**RATIONAL, "torque": 2.385}, ([-0.25, 2.95], 2 * math.pi), "torque", 2.41, (0,)),
}
"""By name: a problem of `problems/families`, what of its system is changed, state and period, the parameter, until
where it is followed, the events that are proved"""
FAMILIES = {
    "triple-1": (5, 9), "triple-mode-2": (2, 13), "henon-heiles-straight": (5, 14), "henon-heiles-loop": (5,),
}  # fmt: skip
"""Events that are proved of `results/families`"""
GAITS = ("simplest-walker-long", "simplest-walker-short", "simplest-walker-period-2", "compass-gait", "rimless-wheel")
"""Of `problems/hybrid`"""
LOOPS = ("four-bar-crank-rocker", "slider-crank-spring", "watt-six-bar")
"""Of `problems/mechanisms`, beside all of `problems/linkages`"""
AT_REST = {
    "brusselator": ("b", 2.5), "fitzhugh-nagumo": ("I", 2.0), "lorenz": ("rho", 28.0), "morris-lecar": ("I", 250.0),
    "predator-prey": ("q", 1.0), "wing-flutter": ("U", 20.0),
}  # fmt: skip
"""Of `problems/equations`: the parameter, and until where equilibria are followed"""
CONNECTED = {
    "oterma-l1": ("oterma-l1", None, (-0.616, 0.0)), "oterma-l2": ("oterma-l2", None, (1.13, -0.1)),
    "oterma-l1-l2": ("oterma-l1", "oterma-l2", (0.9673, 0.0037)),
}  # fmt: skip
"""Orbits of `problems/gallery` that a motion leaves and comes to, and near what x, xdot it falls through y = 0"""


def event_families() -> Iterator[tuple[Family, tuple[int, ...]]]:
    """Families with the numbers of their events that are proved."""
    for name, (problem, changed, guess, parameter, until, numbers) in FOLLOWED.items():
        given = load_problem(Path("problems/families") / f"{problem}.toml")
        begun = replace(given, name=name, model=with_parameters(given.model, changed), guess=Guess(*guess))
        yield follow_family(begun, parameter, until=until), numbers
    walker = load_problem(Path("problems/hybrid/simplest-walker-long.toml"))
    yield follow_family(replace(walker, name="walker"), "slope", until=0.016), (0,)
    for name, numbers in FAMILIES.items():
        yield load_family(Path("results/families") / name / "family.json"), numbers


def prove_events(folder: Path) -> dict[str, str]:
    """Records of events, and the reasons of those that could not be proved."""
    failures = {}
    for family, numbers in event_families():
        for number in numbers:
            name, proof = f"{family.name}-{number}", prove_event(family, number)
            print(f"{name}: {proof.words[0][1] if proof.proved else proof.reason}", file=sys.stderr, flush=True)
            if proof.proved:
                events.save(proof, folder / f"{name}.json")
            else:
                failures[name] = proof.reason
    return failures


def prove_gaits(folder: Path) -> dict[str, str]:
    """Records of orbits with events, and the reasons of those that could not be proved."""
    return prove_problems(folder, [Path("problems/hybrid") / f"{name}.toml" for name in GAITS])


def prove_linkages(folder: Path) -> dict[str, str]:
    """Records of orbits under constraints, and the reasons of those that could not be proved."""
    others = [Path("problems/mechanisms") / f"{name}.toml" for name in LOOPS]
    return prove_problems(folder, [*sorted(Path("problems/linkages").glob("*.toml")), *others])


def prove_problems(folder: Path, files: Sequence[Path]) -> dict[str, str]:
    """Records of the orbits of problems, and the reasons of those that could not be proved."""
    failures = {}
    folder.mkdir(exist_ok=True)
    for name, file in ((file.stem, file) for file in files):
        orbit = find_orbit(load_problem(file))
        document = entry(prove(orbit))
        print(f"{name}: {document.get('stability') or document['reason']}", file=sys.stderr, flush=True)
        if document["proved"]:
            written = orbit_to_document(orbit) | {"proof": document}
            write_atomically(folder / f"{name}.json", (json.dumps(written, indent=1) + "\n").encode())
        else:
            failures[name] = document["reason"]
    return failures


def prove_rest(folder: Path) -> dict[str, str]:
    """Records of equilibria with their Hopf points, and the reasons of those that could not be proved."""
    failures = {}
    for name, (parameter, until) in AT_REST.items():
        given = load_problem_file(Path("problems/equations") / f"{name}.toml")
        proof = prove_equilibria(follow_equilibria(given.model, given.start, parameter, until=until, name=name))
        print(f"{name}: {len(proof.parts)} parts in {proof.wall_time} s", file=sys.stderr, flush=True)
        CODEC.save(proof, folder / f"{name}.json")
        failures |= {f"{name}: {part.place}": part.reason for part in proof.parts if not part.proved}
    return failures


def digits(ball: dict[str, Any]) -> str:
    """A recorded ball, short."""
    return f"{ball['value'][:20]} +- {ball['radius']:.0e}"


def other_tables(folder: Path) -> list[str]:
    """The tables of gaits, of linkages and of equilibria."""
    lines = [
        "", "Orbits with events (`gaits`):", "",
        "| record | arcs | period (s) | radius | contraction | stability | wall time (s) |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for file in sorted((folder / "gaits").glob("*.json")):
        proof = json.loads(file.read_text())["proof"]
        lines.append(
            f"| {file.stem} | {proof['segments']} | {digits(proof['period'])} | {proof['box_radius']:.0e} "
            f"| {proof['contraction']:.1e} | {proof['stability']} | {proof['wall_time']} |"
        )
    lines += [
        "", "Orbits under constraints, linkages and mechanisms with loops (`linkages`):", "",
        "| record | symmetry | coordinates | period (s) | radius | contraction | stability | wall time (s) |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for file in sorted((folder / "linkages").glob("*.json")):
        proof = json.loads(file.read_text())["proof"]
        lines.append(
            f"| {file.stem} | {proof['symmetry']} | {len(proof['state']) // 2} | {digits(proof['period'])} "
            f"| {proof['box_radius']:.0e} | {proof['contraction']:.1e} | {proof['stability']} | {proof['wall_time']} |"
        )
    lines += [
        "", "Equilibria and Hopf points (`equilibria`; the radius is in the sizes of the unknowns):", "",
        "| record | points | Hopf point at | frequency (rad/s) | first Lyapunov coefficient | radius | wall time (s) |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for file in sorted((folder / "equilibria").glob("*.json")):
        proof = CODEC.load(file)
        points = sum(not part.event for part in proof.parts)
        lines += [
            f"| {file.stem} | {points} | {proof.parameter} = {digits(dict(part.value or {}))} "
            f"| {digits(part.known['frequency'])} | {digits(part.known['lyapunov'])} | {part.radius:.0e} "
            f"| {proof.wall_time} |"
            for part in proof.parts if part.proved and part.known
        ]  # fmt: skip
    return lines


def prove_connections(folder: Path) -> dict[str, str]:
    """Records of connections, and the reasons of those that could not be proved."""
    failures = {}
    for name, (origin, goal, near) in CONNECTED.items():
        ends = [find_orbit(load_problem(Path("problems/gallery") / f"{end}.toml")) for end in (origin, goal) if end]
        (motion, *_) = connect(*ends, plane="y=0", axes=("x", "xdot"), direction=-1, near=near, most=1)
        proof = prove_connection(motion)
        print(f"{name}: {proof.words[0][1] if proof.proved else proof.reason}", file=sys.stderr, flush=True)
        if proof.proved:
            PROVED_CONNECTION.save(proof, folder / f"{name}.json")
        else:
            failures[name] = proof.reason
    return failures


def connection_table(folder: Path) -> list[str]:
    """Rows of the connections' records."""
    lines = [
        "", "Connections, transversal crossings of manifolds (`connections`):", "",
        "| record | | crossing | multipliers | radius | contraction | wall time (s) |", "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for file in sorted((folder / "connections").glob("*.json")):
        proof = read_connection_proof(file)
        said = dict(proof.words)
        at = ", ".join(f"{name} = {said[name]}" for name in proof.state_names if name in said)
        growth = ", ".join(said[name].partition("multiplier ")[2] for name in ("orbit", "from", "to") if name in said)
        lines.append(
            f"| {file.stem} | {proof.kind} | {at} | {growth} | {proof.radius:.0e} | {proof.contraction:.1e} "
            f"| {proof.wall_time} |"
        )
    return lines


def cost(document: dict[str, Any]) -> float:
    """A guess of how long a proof takes: the horizon, longer for unstable orbits."""
    largest = max((math.hypot(*mu) for mu in document["floquet_multipliers"]), default=1.0)
    return document["period"] / SYMMETRIES.get(document["symmetry"], NONE).parts * (1 + math.log10(max(largest, 1.0)))


def attempt(task: tuple[str, dict[str, Any]]) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """The proof of one document, in a process of its own."""
    name, document = task
    orbit = orbit_from_document(document)
    return name, document, entry(prove(orbit))


def mark(document: dict[str, Any]) -> tuple[float, ...]:
    """What two records of one orbit, or of its mirror images, have in common."""
    return tuple(round(document[name], 6) for name in ("energy", "period", "action"))


def tasks(atlas: Path, folder: Path, count: int) -> list[tuple[str, dict[str, Any]]]:
    """Names and documents of the cheapest orbits of an atlas that have no record yet, each orbit once."""
    with Atlas(atlas) as opened:
        listed = [(f"{atlas.stem}-{row.id}", opened.document(row.id)) for row in opened.rows()]
    missing = count - sum((folder / f"{name}.json").is_file() for name, _ in listed)
    known = {mark(json.loads(file.read_text())) for file in folder.glob("*.json")}
    todo = []
    for name, document in sorted(listed, key=lambda one: cost(one[1])):
        if mark(document) not in known:
            known.add(mark(document))
            todo.append((name, document))
    return todo[: max(0, missing)]


def summary(folder: Path, failures: dict[str, str]) -> str:
    """A table of all records in a folder, and what could not be proved in this run."""
    lines = [
        "# Proved orbits",
        "",
        "Written by `python benchmarks/prove_atlas.py`; replayed by `orbitfinder verify --proof results/proofs/*.json`",
        "and by the slow test `tests/test_proof_records.py`. What is proved: docs/proof.md.",
        "",
        "| record | symmetry proved | energy (J) | period (s) | radius | contraction | stability | wall time (s) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for file in sorted(folder.glob("*.json"), key=lambda one: (one.stem.rsplit("-", 1)[0], len(one.stem), one.stem)):
        document = json.loads(file.read_text())
        proof = document["proof"]
        lines.append(
            f"| {file.stem} | {proof['symmetry']} | {document['energy']:.9g} | {proof['period']['value'][:17]} "
            f"+- {proof['period']['radius']:.0e} | {proof['box_radius']:.0e} | {proof['contraction']:.1e} "
            f"| {proof['stability']} | {proof['wall_time']} |"
        )
    lines += [
        "", "Parts of families, without a gap (energies in J; the radius is the widest piece's):", "",
        "| record | symmetry | from | to | pieces | radius | contraction | wall time (s) |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for file in sorted(folder.glob("*/branch-proof.json")):
        part = read_branch(file)
        wide = max(max(piece.radius) for piece in part.pieces)
        most = max(piece.contraction for piece in part.pieces)
        lines.append(
            f"| {file.parent.name} | {part.symmetry} | {part.low} | {part.high} | {len(part.pieces)} | {wide:.0e} "
            f"| {most:.1e} | {part.wall_time} |"
        )
    lines += [
        "", "Events of families, as regular zeros of bordered systems (`events`, by family and number):", "",
        "| record | event | period | radius | contraction | wall time (s) |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for file in sorted((folder / "events").glob("*.json")):
        event = read_event(file)
        said = dict(event.words)
        lines.append(
            f"| {file.stem} | {said['event']} | {said['period']} | {event.radius:.0e} | {event.contraction:.1e} "
            f"| {event.wall_time} |"
        )
    lines += other_tables(folder) + connection_table(folder)
    for name, reason in failures.items():
        lines += ["", f"Not proved: {name}: {reason}"]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run the proofs side by side and write records and summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("atlas", type=Path, nargs="?")
    parser.add_argument("--events", action="store_true", help="prove events of families and no orbits")
    parser.add_argument("--others", action="store_true", help="prove all else, no orbits of an atlas")
    parser.add_argument("--count", type=int, default=50, help="records wanted in all")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results/proofs"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    todo, failures, began = [], {}, time.perf_counter()
    if options.events:
        failures = prove_events(options.out / "events")
    elif options.others:
        failures = prove_gaits(options.out / "gaits") | prove_linkages(options.out / "linkages")
        failures |= prove_rest(options.out / "equilibria") | prove_connections(options.out / "connections")
    elif options.atlas is not None:
        todo = tasks(options.atlas, options.out, options.count)
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for name, document, proof in pool.imap_unordered(attempt, todo):
            verdict = f"{proof.get('stability')}" if proof["proved"] else f"not proved: {proof['reason']}"
            print(f"{name}: {proof['symmetry']}, {verdict}, {proof['wall_time']} s", file=sys.stderr, flush=True)
            if proof["proved"]:
                text = json.dumps(document | {"name": name, "proof": proof}, indent=1, allow_nan=False)
                write_atomically(options.out / f"{name}.json", (text + "\n").encode())
            else:
                failures[name] = proof["reason"]
    write_atomically(options.out / "README.md", summary(options.out, failures).encode())
    records = len(list(options.out.glob("*.json")))
    print(f"{records} records in {options.out}, {len(failures)} not proved, {time.perf_counter() - began:.0f} s")
    return 0 if records >= options.count else 1


if __name__ == "__main__":
    sys.exit(main())
