"""Orbits whose digits are printed in books and papers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import casadi as ca
import numpy as np

from benchmarks.validation.comparison import Comparison, Section, attempted, number
from orbitfinder.loops.conditions import Constraint, pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.find import find_orbit
from orbitfinder.records.orbit import Orbit
from orbitfinder.systems import henon_heiles, restricted_three_body, three_bodies, van_der_pol

VAN_DER_POL = {
    1.0: ("6.6632868593231301896996820305", "2.00861986087484313650940188"),
    5.0: ("11.6122306677195700345550662297", "2.02150806156232132383874202460"),
}
"""mu: period and amplitude"""
ARENSTORF = (
    ("-2.00158510637908252240537862224", "17.0652165601579625588917206249"),
    ("-2.0317326295573368357302057924", "11.124340337266085134999734047"),
)
EIGHT = {"x1": "0.97000436", "y1": "-0.24308753", "vx3": "-0.93240737", "vy3": "-0.86473146"}
EIGHT_PERIOD = "6.32591398"
CASCADE = (("0.969309", 0.9692), ("0.986709", 0.9867))
"""Bifurcation energies in units of the saddle's 1/6, as quoted, and where to start looking"""


def sections() -> list[Section]:
    """Van der Pol, Arenstorf, the figure eight."""
    return [
        Section(
            "Van der Pol oscillator",
            "mu = 1: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, stationary van der Pol test, as "
            "quoted in public test suites; the first 16 digits agree with P. Amore, arXiv 2111.12198. mu = 5: digits "
            "in the test code of a public course on differential equations, which names no origin (30 of 100).",
            tuple(row for mu in VAN_DER_POL for row in attempted(f"mu = {mu:g}", "", partial(cycle, mu))),
        ),
        Section(
            "Restricted three-body problem: Arenstorf orbits",
            "E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, section II.0, as quoted "
            "in public test suites. Start (0.994, 0, 0, y'), ratio 0.012277471; x is pinned, y' and the period are "
            "found. The orbit passes the Moon at 0.006 Earth-Moon distances: round-off grows 1e6 times in a period, "
            "the largest multiplier is 3e2.",
            tuple(row for one in ARENSTORF for row in arenstorf(*one)),
        ),
        Section(
            "Three equal masses: the figure eight",
            "A. Chenciner, R. Montgomery, Annals of Mathematics 152 (2000) 881-901, initial data by C. Simo. The "
            "period is pinned to the printed one. Allowed: one unit of the last printed digit.",
            tuple(attempted("figure eight", EIGHT_PERIOD, eight)),
        ),
        Section(
            "Henon-Heiles: bifurcations of the straight-line orbit",
            "M. Brack, Foundations of Physics 31 (2001), nlin/0006034; its table could not be opened, the digits are "
            "as quoted to us. Energies, in units of the saddle's 1/6, at which the orbit along x = 0 has a double "
            "multiplier 1, found by asking for that. Allowed: half a unit of the last digit.",
            tuple(row for one in CASCADE for row in attempted("e", one[0], partial(bifurcation, *one))),
        ),
    ]


def certified(orbit: Orbit) -> Comparison:
    """A row that counts the failed checks of an orbit's certificate."""
    failures: Sequence[str] = orbit.certificate.failures if orbit.certificate else ("no certificate",)
    count, named = len(failures), ", ".join(failures)
    return Comparison("failed checks of the certificate", "0", str(count), count, 0.0, named)


def cycle(mu: float) -> list[Comparison]:
    """The limit cycle found from a rough guess; its amplitude is x where x' = 0."""
    period, amplitude = VAN_DER_POL[mu]
    orbit = find_orbit(Problem(van_der_pol(mu), Guess([2.0, 0.0], 1.01 * float(period))))
    largest = abs(orbit.state[0]) if abs(orbit.state[1]) < 1e-12 else float("nan")
    return [
        number(f"mu = {mu:g}, period", period, orbit.period, 1e-13),
        number(f"mu = {mu:g}, amplitude", amplitude, largest, 1e-13),
        certified(orbit),
    ]


def arenstorf_orbit(rate: str, period: str) -> tuple[Orbit, Model]:
    """One Arenstorf orbit from the printed start, and its model."""
    guess, model = Guess([0.994, 0.0, 0.0, float(rate)], float(period)), restricted_three_body(0.012277471)
    return find_orbit(Problem(model, guess, pin(x=0.994))), model


def arenstorf(rate: str, period: str) -> list[Comparison]:
    """One Arenstorf orbit against its printed numbers."""

    def rows() -> list[Comparison]:
        orbit, _ = arenstorf_orbit(rate, period)
        return [
            number("period", period, orbit.period, 1e-9),
            number("y'(0)", rate, float(orbit.state[3]), 1e-9),
            certified(orbit),
        ]

    return attempted("period", period, rows)


def eight() -> list[Comparison]:
    """The figure eight from the eight printed digits: x1 = -x2, x3 = 0, v1 = v2 = -v3 / 2."""
    x1, v3 = (np.array([float(EIGHT[a]), float(EIGHT[b])]) for a, b in (("x1", "y1"), ("vx3", "vy3")))
    state = np.concatenate([-2 * x1, np.zeros(4), 1.5 * v3])
    period = float(EIGHT_PERIOD)
    orbit = find_orbit(Problem(three_bodies(), Guess(state, period), pin(period=period)))
    found = np.concatenate([-orbit.state[:2] / 2, orbit.state[6:] / 1.5])
    rows = [number(name, EIGHT[name], value, 1e-8) for name, value in zip(EIGHT, found, strict=True)]
    return [*rows, certified(orbit)]


def straight_line(scaled: float) -> tuple[float, float]:
    """Lower turning point y and period of the Henon-Heiles motion along x = 0 at the energy `scaled` / 6.

    2 (E - V) = (2/3) (y - y0) (y1 - y) (y2 - y) with the roots y0 < y1 < y2, so with y = m + h sin(a) the period
    is 2 int da / sqrt((2/3) (y2 - y)) from -pi/2 to pi/2: by the midpoint rule, enough for a guess.
    """
    lowest, middle, highest = np.sort(np.roots([-1 / 3, 0.5, 0.0, -scaled / 6]).real)
    angles = (np.arange(4000) + 0.5) / 4000 * np.pi - np.pi / 2
    place = (lowest + middle) / 2 + (middle - lowest) / 2 * np.sin(angles)
    return float(lowest), float(2 * np.mean(1 / np.sqrt((highest - place) / 1.5)) * np.pi)


def bifurcation(quoted: str, near: float) -> list[Comparison]:
    """The orbit whose monodromy matrix has the trace 4, all four multipliers being 1."""
    start, period = straight_line(near)
    double = Constraint(lambda variables: ca.trace(variables.monodromy) - 4, name="double multiplier 1")
    guess = Guess([0.0, start, 0.0, 0.0], period)
    orbit = find_orbit(Problem(henon_heiles(), guess, symmetry="brake", constraints=(double,)))
    return [number(f"bifurcation near {near:g}", quoted, 6 * orbit.energy, 5e-7), certified(orbit)]
