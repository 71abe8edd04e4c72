"""Run the parts of the report, each once: finished ones are kept across interruptions."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from orbitfinder._runtime.version import __version__
from orbitfinder.errors import InputError
from orbitfinder.records.reading import write_atomically


@dataclass(frozen=True)
class Part:
    """One resumable piece of the report: a function of the output folder that returns numbers."""

    name: str
    says: str
    module: str
    function: str

    def compute(self, folder: Path) -> dict[str, Any]:
        """Run it; the module is imported only now."""
        chosen: Callable[[Path], dict[str, Any]] = getattr(import_module(self.module), self.function)
        return chosen(folder)


PARTS = (
    Part("schematics", "figures 1, 3, 9: schematics", "orbitfinder.reproduce.schematics", "schematic_part"),
    Part("energy", "figures 2, 4, 5: energy by each method", "orbitfinder.reproduce.runs", "energy_part"),
    Part("differences", "figures 6 to 8: methods compared", "orbitfinder.reproduce.runs", "difference_part"),
    Part("four_bar", "figure 10: four-bar linkages", "orbitfinder.reproduce.fourbar", "four_bar_part"),
    Part("orbits", "figures 11 to 13: periodic orbits", "orbitfinder.reproduce.orbits", "orbit_part"),
    Part("hundred", "100 links in motion", "orbitfinder.reproduce.chains", "hundred_part"),
    Part("derivation", "derivation of n links", "orbitfinder.reproduce.chains", "derivation_part"),
)
Report = Callable[[str, int, int], None]


def reproduce(folder: str | Path, fresh: bool = False, report: Report | None = None) -> dict[str, Any]:
    """Regenerate the report's results in `folder` and the page README.md beside them.

    Finished parts are recorded in numbers/<part>.json and not computed again unless `fresh` or the
    code changed; `report(what, done, of)` is told before each part. Returns all numbers by part.
    """
    from orbitfinder.reproduce.page import write_page

    out = Path(folder)
    try:
        (out / "numbers").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out: cannot write to {out} ({error.strerror}); choose a writable folder") from error
    numbers: dict[str, Any] = {}
    for k, part in enumerate(PARTS):
        if report:
            report(part.says, k, len(PARTS))
        numbers[part.name] = _once(part, out, fresh)
    write_page(out, numbers)
    if report:
        report("finished", len(PARTS), len(PARTS))
    return numbers


def _once(part: Part, out: Path, fresh: bool) -> dict[str, Any]:
    """A part's numbers, from its record when that was made by the same code."""
    record = out / "numbers" / f"{part.name}.json"
    key = fingerprint(part)
    if not fresh and record.is_file():
        try:
            known = json.loads(record.read_text(encoding="utf-8"))
            if known["key"] == key:
                return dict(known["numbers"])
        except (ValueError, KeyError, TypeError, OSError):
            pass  # a damaged record is no record
    numbers = part.compute(out)
    text = json.dumps({"key": key, "numbers": numbers}, indent=1, sort_keys=True)
    write_atomically(record, (text + "\n").encode())
    return dict(json.loads(text)["numbers"])  # as a later run will read it


def fingerprint(part: Part) -> str:
    """Digest of the version and of the source of the part's module."""
    module = import_module(part.module)
    assert module.__file__ is not None
    source = Path(module.__file__).read_bytes()
    return hashlib.sha256(__version__.encode() + part.function.encode() + source).hexdigest()[:16]
