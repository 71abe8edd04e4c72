"""Run the parts of the report, each once, and write the page: finished parts are kept across interruptions."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from orbitfinder._runtime import __version__
from orbitfinder.errors import InputError
from orbitfinder.records.reading import Entries, write_atomically
from orbitfinder.reproduce.facts import FORMULATIONS, HOURS_FOR_100_LINKS, ORBITS, SEPARATION, SIZES, TOLERANCE


@dataclass(frozen=True)
class Part:
    """One resumable piece of the report: a function of the output folder that returns numbers."""

    name: str
    says: str
    module: str
    function: str

    def compute(self, folder: Path) -> Entries:
        """Run it; the module is imported only now."""
        chosen: Callable[[Path], Entries] = getattr(import_module(self.module), self.function)
        return chosen(folder)


PARTS = (
    Part("schematics", "figures 1, 3, 9: schematics", "orbitfinder.reproduce.schematics", "schematic_part"),
    Part("energy", "figures 2, 4, 5: energy by each method", "orbitfinder.reproduce.runs", "energy_part"),
    Part("differences", "figures 6 to 8: methods gaps", "orbitfinder.reproduce.runs", "difference_part"),
    Part("four_bar", "figure 10: four-bar linkages", "orbitfinder.reproduce.runs", "four_bar_part"),
    Part("orbits", "figures 11 to 13: periodic orbits", "orbitfinder.reproduce.orbits", "orbit_part"),
    Part("hundred", "100 links in motion", "orbitfinder.reproduce.runs", "hundred_part"),
    Part("derivation", "derivation of n links", "orbitfinder.reproduce.runs", "derivation_part"),
)
Report = Callable[[str, int, int], None]


def reproduce(folder: str | Path, fresh: bool = False, report: Report | None = None) -> Entries:
    """Regenerate the report's results in `folder` and the page README.md beside them.

    Finished parts are recorded in numbers/<part>.json and not computed again unless `fresh` or the
    code changed; `report(what, done, of)` is told before each part. Returns all numbers by part.
    """
    out = Path(folder)
    try:
        (out / "numbers").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"out: cannot write to {out} ({error.strerror}); choose a writable folder") from error
    numbers = {}
    for k, part in enumerate(PARTS):
        if report:
            report(part.says, k, len(PARTS))
        numbers[part.name] = _once(part, out, fresh)
    write_page(out, numbers)
    if report:
        report("finished", len(PARTS), len(PARTS))
    return numbers


def _once(part: Part, out: Path, fresh: bool) -> Entries:
    """A part's numbers, from its record when that was made by the same code."""
    record = out / "numbers" / f"{part.name}.json"
    module = import_module(part.module)
    assert module.__file__ is not None
    source = Path(module.__file__).read_bytes()
    key = hashlib.sha256(__version__.encode() + part.function.encode() + source).hexdigest()[:16]
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


Numbers = Entries
METHODS = (
    ("Newton-Euler", "newton-euler", "2"), ("DAE, native, no stabilisation", "dae", "4"),
    ("DAE, native, Baumgarte", "dae with Baumgarte", "4"), ("Lagrange", "lagrange", "5"),
    ("O(n) recursion (ours)", "recursive", ""),
)  # fmt: skip
PAGES = Environment(  # Markdown, of our own numbers only: nothing to escape
    loader=PackageLoader(__package__, ""), autoescape=False, undefined=StrictUndefined,
    trim_blocks=True, keep_trailing_newline=True,
)  # fmt: skip


def write_page(folder: Path, numbers: Numbers) -> Path:
    """Write README.md from the parts' numbers."""
    text = PAGES.get_template("README.md.jinja").render(
        numbers, printed_orbits=ORBITS, tolerance=TOLERANCE, separation=SEPARATION, hours=HOURS_FOR_100_LINKS,
        sizes=[*map(str, SIZES)], orbit_rows=_orbits(numbers["orbits"]),
        energy_rows=[
            [title, figure, *(f"{numbers['energy'][key][what]:.1e}" if what == "drift" or "dae" in key else ""
                              for what in ("drift", "phi", "phidot"))]
            for title, key, figure in METHODS
        ],
        difference_rows=_differences(numbers["differences"]), chain_rows=_chains(numbers["derivation"]),
        linkage_rows=[
            [bar["title"], f"{bar['span']:g}", *(f"{bar[k]:.1e}" for k in ("drift", "phi", "phidot")), bar["motion"]]
            for bar in numbers["four_bar"]["linkages"]
        ],
    )  # fmt: skip
    path = folder / "README.md"
    write_atomically(path, text.encode())
    return path


def _orbits(numbers: Numbers) -> list[list[str]]:
    rows = []
    for printed in ORBITS:
        orbit = numbers[printed.name]
        rows.append([
            f"[{printed.name}](orbits/{printed.name}/orbit.json)", str(printed.figure),
            f"{orbit['printed_closure']:.1e}", f"{orbit['closure']:.1e}", f"{printed.period_guess:.12g}",
            f"{orbit['period']:.14f}", f"{orbit['energy']:.9f}", orbit["stability"], orbit["symmetry"],
            "yes" if orbit["certified"] else "NO",
        ])  # fmt: skip
    return rows


def _differences(numbers: Numbers) -> list[list[str]]:
    rows = []
    for pair in ("lagrange - newton-euler", "lagrange - dae", "dae - newton-euler"):
        gaps = numbers[pair]
        first = "never" if gaps["first_above_1_rad"] is None else f"{gaps['first_above_1_rad']:.2f}"
        rows.append([pair, str(gaps["figure"]), f"{gaps['largest_to_12_s']:.1e}", first, f"{gaps['rate']:.2f}"])
    return rows


def _chains(derivation: Numbers) -> list[list[str]]:
    rows = []
    for name in FORMULATIONS:
        seconds, exponent = derivation[name]["seconds"], derivation[name]["exponent"]
        cells = [f"{seconds[n]:.3f}" if n in seconds else "left out" for n in map(str, SIZES)]
        rows.append([name, *cells, f"{exponent:.1f}"])
    return rows
