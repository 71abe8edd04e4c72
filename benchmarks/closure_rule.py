"""What separates true orbits from false ones; writes results/validation/closure_rule.md in two minutes.

Every shipped orbit, Arenstorf's, pendulums just below upright and the most unstable orbits of the atlases, as
they are and with the period or the state off by 1e-9 to 1e-7, and motions on tori that nearly close. For each the
gap g in extents of the motion against eps A, what round-off grows to, against the largest multiplier, and the
distance to the true orbit: the two numbers that a certificate asks about, and the one it asked about before.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import orbitfinder as of
from benchmarks.validation.literature import ARENSTORF, arenstorf_orbit
from orbitfinder.errors import IntegrationError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import LARGEST_SCALE, Tolerances
from orbitfinder.orbits.closure import EPSILON
from orbitfinder.orbits.evidence import gather

ROOT = Path(__file__).parents[1]
RULE = Tolerances()
OFF = (1e-9, 1e-8, 1e-7)


@dataclass(frozen=True)
class Case:
    """A state and a period of a model, true or not."""

    name: str
    model: Model
    state: np.ndarray
    period: float
    turns: np.ndarray


@dataclass(frozen=True)
class Found:
    """The gap in extents, A, the largest multiplier and the distance to the true orbit."""

    gap: float
    amplification: float
    multiplier: float
    distance: float

    @property
    def accepted(self) -> bool:
        """By the rule of the certificate."""
        grown = min(self.amplification, LARGEST_SCALE)
        return self.gap <= RULE.closure * grown and self.distance <= RULE.distance

    @property
    def accepted_before(self) -> bool:
        """By the multiplier alone, as in version 0.1.0 (there with the gap in the model's units)."""
        return self.gap <= RULE.closure * min(max(1.0, self.multiplier), LARGEST_SCALE)


def measured(case: Case) -> Found:
    """What the certificate's integration says; infinite gaps where it cannot go round."""
    try:
        evidence = gather(case.model, case.state, case.period, case.turns)
    except IntegrationError:
        return Found(np.inf, np.inf, np.inf, np.inf)
    largest = float(np.abs(evidence.floquet.multipliers).max(initial=1.0))
    return Found(evidence.closes.gap, evidence.closes.amplification, largest, evidence.closes.distance)


def of_orbit(orbit: of.Orbit, model: Model | None = None) -> Case:
    return Case(orbit.name, model or build_model(orbit.system), orbit.state, orbit.period, np.asarray(orbit.winding))


def shipped() -> Iterator[Case]:
    for folder in ("orbits", "gallery"):
        for file in sorted((ROOT / "results" / folder).glob("*/orbit.json")):
            yield of_orbit(of.load_orbit(file))


def unstable(count: int = 12) -> Iterator[Case]:
    """The most unstable orbits of the shipped atlases."""
    for name in ("triple", "quadruple"):
        with of.Atlas(ROOT / "results" / "atlas" / f"{name}.sqlite") as atlas:
            rows = sorted(atlas.rows(), key=lambda row: -row.instability)[:count]
            yield from (of_orbit(atlas.orbit(row.id)) for row in rows)


def arenstorf() -> Iterator[Case]:
    for speed, period in ARENSTORF:
        orbit, model = arenstorf_orbit(speed, period)
        yield of_orbit(orbit, model)


def upright() -> Iterator[Case]:
    """A rod whose swing turns so far (rad) below upright, started at the bottom and at the top: exact by K(k)."""
    from mpmath import mp, mpf  # for periods beyond the digits of SciPy's K near k = 1

    mp.dps = 40
    model = build_model({"kind": "chain", "links": 1})
    squared = mpf(3) / 2 * mpf("9.8")  # rad^2/s^2: m g l / 2 over m l^2 / 3
    for power in range(1, 9):
        below = mpf(10) ** -power
        period = float(4 * mp.ellipk(mp.cos(below / 2) ** 2) / mp.sqrt(squared))
        speed = float(2 * mp.sqrt(squared) * mp.cos(below / 2))
        name, still = f"pendulum 1e-{power} below upright, from the", np.zeros(1, int)
        yield Case(f"{name} bottom", model, np.array([0.0, speed]), period, still)
        yield Case(f"{name} top", model, np.array([float(mp.pi - below), 0.0]), period, still)


def tori(cases: list[Case]) -> Iterator[Case]:
    """Motions 1e-5 of the extents away from elliptic orbits, after the turns (up to 30) that nearly close them."""
    for case in cases:
        if case.model.constraint is not None or case.model.forced:
            continue
        evidence = gather(case.model, case.state, case.period, case.turns)
        found = evidence.floquet.multipliers
        turning = found[(np.abs(np.abs(found) - 1) < 1e-6) & (found.imag > 1e-3)]
        if not turning.size:
            continue
        angle = float(np.angle(turning[0]))
        count = min(range(2, 31), key=lambda k: abs((k * angle + np.pi) % (2 * np.pi) - np.pi))
        away = evidence.extents * np.random.default_rng(0).choice([-1.0, 1.0], case.state.size) * 1e-5
        name, turned = f"torus about {case.name}, {count} turns", count * case.turns
        yield Case(name, case.model, case.state + away, count * case.period, turned)


def false(case: Case, random: np.random.Generator) -> Iterator[Case]:
    evidence = gather(case.model, case.state, case.period, case.turns)
    for off in OFF:
        if not case.model.forced:
            yield Case(f"{case.name}: period {off:+.0e}", case.model, case.state, case.period * (1 + off), case.turns)
        nudge = evidence.extents * random.choice([-1.0, 1.0], case.state.size) * off
        if case.model.constraint is None:
            yield Case(f"{case.name}: state {off:+.0e}", case.model, case.state + nudge, case.period, case.turns)


def row(case: Case, found: Found) -> str:
    verdict = ["no", "yes"]
    ratios = (found.gap / (EPSILON * found.amplification), found.gap / (EPSILON * max(1.0, found.multiplier)))
    return (
        f"| {case.name} | {found.gap:.1e} | {found.amplification:.2g} | {ratios[0]:.2g} | {found.multiplier:.3g} | "
        f"{ratios[1]:.2g} | {found.distance:.1e} | {verdict[found.accepted]} | {verdict[found.accepted_before]} |"
    )


HEAD = (
    "| motion | gap | A | gap / eps A | largest multiplier | gap / eps mu | distance | accepted | by mu |\n"
    "|---|---|---|---|---|---|---|---|---|"
)
INTRODUCTION = f"""# The closure rule: true orbits against false ones

Written by `python benchmarks/closure_rule.py`. Gaps and distances are in extents of the motion. A certificate
asks for gap <= {RULE.closure:g} A, A at most {LARGEST_SCALE:g}, and for a true orbit within {RULE.distance:g}
(`orbitfinder/orbits/closure.py`). "By mu" is the rule of version 0.1.0, where the largest multiplier stood for A.
A distance of 0 says that the gap is within round-off.
"""


def main() -> None:
    """Measure everything and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    random = np.random.default_rng(0)
    true = [*shipped(), *arenstorf(), *unstable(), *upright()]
    found = [measured(case) for case in true]
    ratios = [one.gap / (EPSILON * one.amplification) for one in found if one.amplification <= 1e10]
    by_mu = [one.gap / (EPSILON * max(1.0, one.multiplier)) for one in found if one.amplification <= 1e10]
    planted = [*(wrong for one in true for wrong in false(one, random)), *tori(true[:41])]
    judged = [(case, measured(case)) for case in planted]
    passed = [pair for pair in judged if pair[1].accepted]
    text = [
        INTRODUCTION, f"## {len(true)} true orbits, {sum(one.accepted for one in found)} accepted "
        f"({sum(one.accepted_before for one in found)} by mu)\n",
        f"gap / eps A is {min(ratios):.2g} to {max(ratios):.2g}, gap / eps mu {min(by_mu):.2g} to {max(by_mu):.2g} "
        "(A up to 1e10). Refused are swings that pass so near to upright that no double "
        "holds them.\n", HEAD, *map(row, true, found),
        f"\n## {len(judged)} false ones, {len(passed)} accepted "
        f"({sum(one.accepted_before for _, one in judged)} by mu)\n",
        "Period or state off by 1e-9 to 1e-7, and motions on tori that nearly close. Those accepted have a true orbit "
        "within the distance shown: the period of an orbit that is unstable or near a saddle belongs to a "
        "neighbour.\n", HEAD, *(row(*pair) for pair in passed),
    ]  # fmt: skip
    target = ROOT / "results" / "validation" / "closure_rule.md"
    target.write_text("\n".join(text) + "\n")
    print(f"{target.relative_to(ROOT)}: {len(true)} true, {len(judged)} false, {len(passed)} of them accepted")


if __name__ == "__main__":
    main()
