"""Orbits that papers print: found and certified from their digits by `of.find_orbit` with default settings.

Numbers with their sources are in published.csv:

- suvakov: the fifteen in table I of M. Suvakov, V. Dmitrasinovic, Physical Review Letters 110 (2013) 114301;
- li-liao: 40 of the 695 of X. Li, S. Liao, Science China Physics 60 (2017) 129511, drawn with seed 2026, cut to five
  digits after the point; free-fall: the first ten with equal masses of X. Li, S. Liao, New Astronomy 70 (2019) 22;
- spatial: the first ten with m3 = 0.1 of X. Li, S. Liao, arXiv 2508.08568, with eight digits after the point;
- earth-moon: D. Grebow, Generating periodic orbits in the circular restricted three-body problem with applications to
  lunar south pole coverage (Purdue University, 2006), as recomputed by others, six digits.

Orbits of the restricted three-body problem: six numbers of the state x, y, z, x', y', z' in the rotating frame, and as
`ratio` the share of the mass (mu) that the source itself has. All digits are kept that the source prints, and numbers
below 1e-8 of states at a perpendicular crossing, which the sources print as their round-off, are 0:

- jpl: NASA/JPL Three-Body Periodic Orbits (https://ssd.jpl.nasa.gov/tools/periodic_orbits.html), version 1.0 of its
  API, as four public repositories keep its answers: L2 halo south with its number in the catalog from
  oleksandr-valentirov/space_sim, data/jpl_halo/halo_l2_south.csv; from Bwooce/cyclers the L1 halo orbits with
  C = 3.0000036 (tests/search/fixtures/jpl_earth_moon_halo_l1n_c3.json) and with the least C
  (tests/verify/fixtures/jpl_earth_moon_l1_halo_sample.json), Saturn-Titan and Mars-Phobos (jpl_saturn_titan_dro_c3.json
  and jpl_mars_phobos_dro_c3.json beside the first); all others from ethanliii/selene, data/orbits/jpl_reference.json.
  anabelsoria/Explicit_Symplectic_Integrators, Example_CR3BP/CR3BPOrbit.m, has the near-rectilinear orbit mirrored;
- braik-ross: all 13 in table 2 of A. Braik, S. Ross, Orbital networks in the three-body problem (preprint, 2026), from
  the authors' BinBraik/cislunar_orbital_network, src/cr3bp_family_ic.m;
- grebow: four digits from D. Grebow (as above), those of the short-period orbit more, as in
  DhruvJ22/Astrodynamics_Research, example_L2_vertical_orb_fam.py, example_L3_halo_orb_fam.py,
  example_L3_axial_orb_fam.py, example_L4_Axial_orb_fam.py, src/example_L4_short_period_fam.py,
  src/example_L2_halo_orb_fam.py, with the ratio of its cr3bp_char_quant.py, 4902.8005821478 / (398600.4415 +
  4902.8005821478); three are planar orbits at which spatial ones branch off;
- scripts: jdclouse/AstroTools, ASEN6008_IMD/HW6/HW6_P3.m (x = 1.2); bhanson10/gbees-bst, examples/PCR3BP/plot_PCR3BP.m
  (Jupiter-Europa); bhanson10/gbees, examples/PCR3BP/plot_PCR3BP.m (Saturn-Enceladus).

    python benchmarks/published.py [TABLE ...]     writes results/validation/published.md of all
"""

from __future__ import annotations

import argparse
import csv
import statistics
import time
from pathlib import Path

import numpy as np

import orbitfinder as of
from orbitfinder.errors import OrbitfinderError

HERE = Path(__file__).parent
PAGE = HERE.parent / "results" / "validation" / "published.md"
LIMIT = 120.0
"""s that a search may take"""


def problem(table: str, numbers: list[float], period: float, ratio: str) -> of.Problem:
    """The Problem of a row."""
    if ratio:
        return of.Problem(of.systems.restricted_three_body(float(ratio), spatial=True), of.Guess(numbers, period))
    if table in ("suvakov", "li-liao"):
        a, b = numbers
        model = of.systems.three_bodies()
        return of.Problem(model, of.Guess([2.0, 0, 0, 0, 0, 0, -3 * a, -3 * b], period))
    if table == "free-fall":
        model, state = of.bodies([1, 1, 1], [[-0.5, 0], [0.5, 0], numbers], np.zeros((3, 2)))
        return of.Problem(model, of.Guess(state, period))
    z, u, v, w = numbers
    places, rates = [[-1, 0, 0], [1, 0, 0], [0, 0, z]], [[u, v, w], [u, v, -w], [-20 * u, -20 * v, 0]]
    model, state = of.bodies([1, 1, 0.1], places, rates)
    return of.Problem(model, of.Guess(state, period))


def row(table: str, name: str, asked: of.Problem) -> tuple[bool, float, str]:
    """Whether it was certified, in how much processor time (s), and its line of the page."""
    began, guess = time.process_time(), asked.guess
    try:
        with of.limited(LIMIT):
            orbit = of.find_orbit(asked)
    except OrbitfinderError as error:
        said = " ".join(str(error).split()).replace("|", "/")
        return False, time.process_time() - began, f"| {table} | {name} | no | {guess.period} | | | {said[:300]} |"
    passed, failed = orbit.certificate.passed, ", ".join(orbit.certificate.failures)
    moved = np.abs(orbit.state - guess.start).max() / np.abs(guess.start).max()
    line = (f"| {table} | {name} | {'yes' if passed else 'no'} | {guess.period} | {orbit.period:.9f} | {moved:.0e} | "
            f"{orbit.stability if passed else failed} |")  # fmt: skip
    return passed, time.process_time() - began, line


def main() -> None:
    """Go through the tables and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE")
    given = list(csv.DictReader((HERE / "published.csv").open(encoding="utf-8")))
    chosen = parser.parse_args().tables
    lines, counts, spent = list[str](), dict[str, list[bool]](), list[float]()
    for each in given:
        table, name = each["table"], each["name"]
        if chosen and table not in chosen:
            continue
        numbers = [float(each[column]) for column in ("one", "two", "three", "four", "five", "six") if each[column]]
        passed, seconds, line = row(table, name, problem(table, numbers, float(each["period"]), each["ratio"]))
        counts.setdefault(table, []).append(passed)
        spent.append(seconds)
        lines.append(line)
        print(f"{seconds:5.1f} s {line}", flush=True)
    told = [f"- {table}: {sum(passed)} of {len(passed)} certified" for table, passed in counts.items()]
    told.append(f"- processor time: median {statistics.median(spent):.1f} s, most {max(spent):.1f} s")
    print("\n".join(told))
    if not chosen:
        head = ["| table | orbit | certified | printed period | period | state moved | stability, or why not |",
                "|---|---|---|---|---|---|---|"]  # fmt: skip
        note = [
            "# Published orbits", "",
            "Found and certified from the digits that papers print, by `find_orbit` with default settings and without "
            "pins; what moved is relative to the largest component. Written by `benchmarks/published.py`, with the "
            "sources; the digits are in `benchmarks/published.csv`. A search takes at most two minutes.", "",
        ]  # fmt: skip
        PAGE.write_text("\n".join([*note, *told, "", *head, *lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
