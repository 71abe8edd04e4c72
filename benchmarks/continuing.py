"""Whether every certified orbit that is shipped starts a family by `of.follow_family` with default settings.

    python benchmarks/continuing.py [FILE ...]     writes results/validation/continuing.md of all

Two points each way, with their events: in the energy, else in the first physical parameter that one can be followed in.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import orbitfinder as of
from orbitfinder.errors import InputError, OrbitfinderError
from orbitfinder.mechanics.kind import build_model

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "results" / "validation" / "continuing.md"
LIMIT = 600.0
"""s that a start may take"""


def started(file: Path) -> tuple[str, str]:
    """The parameter of a family that starts at an orbit, and "" or why none does."""
    orbit = of.load_orbit(file)
    said = "no parameter"
    for name in ["energy", *build_model(orbit.system).parameter_names]:
        try:
            with of.limited(LIMIT):
                family = of.follow_family(orbit, name, points=2)
        except InputError as error:  # the energy of what has none, a number that cannot be changed
            said = f"{name}: {error}"
            continue
        except OrbitfinderError as error:
            return name, str(error)
        return name, "" if len(family.points) > 1 else "; ".join(end.reason for end in family.ends)
    return "", said


def main() -> None:
    """Start all and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE")
    chosen = parser.parse_args().files
    files = chosen or [
        *sorted((ROOT / "results").rglob("orbit.json")),
        *sorted((ROOT / "docs/gallery/orbits").glob("*.json")),
    ]
    rows, count = list[str](), 0
    for file in files:
        document = json.loads(file.read_text(encoding="utf-8"))
        certificate = document.get("certificate") if isinstance(document, dict) else None
        if "floquet_multipliers" not in document or not (certificate or {}).get("passed") or document.get("control"):
            continue
        if document["system"].get("kind") == "custom":  # a Model of Python, which no file can build again
            continue
        began = time.process_time()
        name, why = started(file)
        count += 1
        place = file.resolve().relative_to(ROOT) if file.resolve().is_relative_to(ROOT) else file.name
        print(f"{time.process_time() - began:6.1f} s {place} {name} {why[:300]}", flush=True)
        if why:
            rows.append(f"| {place} | {name} | {' '.join(why.split()).replace('|', '/')[:300]} |")
    told = f"{count - len(rows)} of {count} certified orbits start a family."
    print(told)
    if not chosen:
        head = ["# Families from every orbit", "", (__doc__ or "").split("\n")[0], "", told]
        table = ["", "| orbit | parameter | why not |", "|---|---|---|", *rows] if rows else []
        PAGE.write_text("\n".join([*head, *table, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
