"""The page a reader holds beside the report: its claims, ours beside them, in Markdown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from orbitfinder.records.reading import write_atomically
from orbitfinder.reproduce.facts import HOURS_FOR_100_LINKS, ORBITS, SEPARATION, TOLERANCE

Numbers = dict[str, Any]
SIZES = ["3", "10", "30", "100", "300", "1000"]
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
        sizes=SIZES, orbit_rows=_orbits(numbers["orbits"]), energy_rows=_energy(numbers["energy"]),
        difference_rows=_differences(numbers["differences"]), chain_rows=_chains(numbers["derivation"]),
        linkage_rows=_linkages(numbers["four_bar"]["linkages"]),
    )  # fmt: skip
    path = folder / "README.md"
    write_atomically(path, text.encode())
    return path


def _orbits(numbers: Numbers) -> list[list[str]]:
    rows = []
    for printed in ORBITS:
        one = numbers[printed.name]
        rows.append([
            f"[{printed.name}](orbits/{printed.name}/orbit.json)", str(printed.figure), f"{one['printed_closure']:.1e}",
            f"{one['closure']:.1e}", f"{printed.period_guess:.12g}", f"{one['period']:.14f}",
            f"{one['energy']:.9f}", one["stability"], one["symmetry"], "yes" if one["certified"] else "NO",
        ])  # fmt: skip
    return rows


def _energy(numbers: Numbers) -> list[list[str]]:
    return [
        [title, figure, *(f"{numbers[key][what]:.1e}" if what == "drift" or "dae" in key else ""
                          for what in ("drift", "phi", "phidot"))]
        for title, key, figure in METHODS
    ]  # fmt: skip


def _differences(numbers: Numbers) -> list[list[str]]:
    rows = []
    for pair in ("lagrange - newton-euler", "lagrange - dae", "dae - newton-euler"):
        one = numbers[pair]
        first = "never" if one["first_above_1_rad"] is None else f"{one['first_above_1_rad']:.2f}"
        rows.append([pair, str(one["figure"]), f"{one['largest_to_12_s']:.1e}", first, f"{one['rate']:.2f}"])
    return rows


def _linkages(linkages: list[Numbers]) -> list[list[str]]:
    return [
        [one["title"], f"{one['span']:g}", *(f"{one[what]:.1e}" for what in ("drift", "phi", "phidot")), one["motion"]]
        for one in linkages
    ]


def _chains(derivation: Numbers) -> list[list[str]]:
    rows = []
    for name in ("lagrange", "newton-euler", "dae", "recursive"):
        seconds, exponent = derivation[name]["seconds"], derivation[name]["exponent"]
        cells = [f"{seconds[n]:.3f}" if n in seconds else "left out" for n in SIZES]
        rows.append([name, *cells, f"{exponent:.1f}"])
    return rows
